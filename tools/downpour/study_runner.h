// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <chrono>
#include <deque>
#include <filesystem>
#include <list>
#include <optional>
#include <string>
#include <vector>

#include "engine/learner/directory_lock.h"
#include "tools/downpour/mpi_world.h"
#include "tools/downpour/run_process.h"
#include "tools/downpour/study_database.h"
#include "tools/downpour/study_file.h"
#include "tools/downpour/study_ranks.h"

namespace downpour {

// Every count-th run of a study from the index-th on, counted from 1.
struct StudyShare {
  int index = 1;
  int count = 1;
};

// Runs what is missing of a study, each replicate as `downpour learn` in a process and a run
// directory of its own. The directories are what is known of the runs; the database follows them.
// With other ranks each takes as many runs side by side as this process; those of a rank that gets
// lost go on elsewhere.
class StudyRunner {
 public:
  // Takes `runs`, the directory of the run directories, for this process. Throws InvalidInput if
  // another one has it, or if the study does not go on with what is in it or in the database.
  // With a share of several, neither the directory is taken nor a database written: others run
  // theirs at the same time, and the whole study reads the directories later. `program` is this
  // program as it was typed. `world` must outlive the object, whose process has rank 0.
  StudyRunner(std::string program, Study study, const std::string& database,
              const std::filesystem::path& runs, const StudyShare& share, MpiWorld* world);

  // Returns true if all runs are finished, false if an end was asked for (stop.h). A run that fails
  // leaves the others alone; throws std::runtime_error at the end if there are any.
  bool Run();

  int n_runs() const { return static_cast<int>(runs_.size()); }
  int n_finished() const { return n_finished_; }

 private:
  using Clock = std::chrono::steady_clock;

  // One replicate, and how far it is.
  struct Replicate {
    StudyRun run;
    int episodes = 0;
    int solved_episode = 0;  // 0: none
    double best_return = 0;
    bool failed = false;
  };
  struct Active {
    Replicate* replicate;
    int rank;                           // that learns it
    std::optional<RunProcess> process;  // of rank 0
  };

  bool Finished(const Replicate& replicate) const;
  int Threads(const StudyVariant& variant) const;
  std::filesystem::path Directory(const StudyRun& run) const;
  LearnerState ReadRun(const StudyRun& run, int* threads) const;
  void CatchUp(Replicate* replicate);
  void Fail(Replicate* replicate, const std::string& reason);
  std::vector<std::string> Words(const StudyRun& run, const std::string& directory) const;
  int FreeRank() const;
  void Start(Replicate* replicate, int rank);
  void Follow(Active* active);
  void Follow(const StudyRanks::News& news);
  void End(Replicate* replicate, const std::string& end_text);
  void Fill();
  void Wait();
  double EpisodesLeft() const;
  void Show();
  void ClearLine();

  std::string program_;
  Study study_;
  std::filesystem::path directory_;
  std::optional<DirectoryLock> lock_;  // none of a share
  StudyDatabase database_;
  int jobs_;
  int threads_;
  StudyRanks ranks_;
  std::vector<Replicate> runs_;
  std::deque<Replicate*> waiting_;
  std::list<Active> active_;
  std::vector<std::string> failures_;
  int n_finished_ = 0;
  int n_episodes_ = 0;  // by this process
  bool terminal_;       // standard error is one
  bool live_ = false;   // a live line is on the screen
  Clock::time_point start_;
  Clock::time_point last_shown_;
};

}  // namespace downpour
