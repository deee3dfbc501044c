// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <chrono>
#include <string>

#include "engine/learner/learner.h"
#include "tools/downpour/config.h"

namespace downpour {

// What a person sees of a run. Standard output: a table or JSON lines, one line an episode.
// Standard error: what the run is doing, as a live line if it is a terminal, else as plain lines.
class Progress {
 public:
  explicit Progress(const RunConfig& config);
  ~Progress();  // leaves the terminal's line empty
  Progress(const Progress&) = delete;
  Progress& operator=(const Progress&) = delete;

  // Before the first episode of this process; `directory` is the run's.
  void Start(const Learner& learner, const std::string& directory);
  // Learner::Callbacks.
  void Phase(const Learner& learner, const std::string& phase);
  void Search(const PolicySearchProgress& progress, const EvaluatorStatistics& batch, int threads);
  void Search(const GradientSearchProgress& progress);
  // Throws FileError if standard output cannot be written.
  void Episode(const Learner& learner, const EpisodeRecord& record);
  void Finish(const Learner& learner, const std::string& directory);

 private:
  using Clock = std::chrono::steady_clock;
  void Line(const std::string& text);  // a line that stays
  void Live(const std::string& text);  // a line that the next one replaces
  void Step(const std::string& text);  // a live line, or a plain one if there is no terminal
  void ClearLive();
  bool SearchDue();  // whether it is time for another line about the search
  void SearchLine(double share, const std::vector<std::string>& figures);

  std::string robot_;  // RunConfig::system.program
  bool quiet_;
  bool json_;
  bool pilco_;         // LearnerOptions::algorithm
  bool terminal_;      // standard error is one
  bool live_ = false;  // a live line is on the screen
  int episode_ = 0;
  Clock::time_point search_start_;
  Clock::time_point last_search_;
};

}  // namespace downpour
