// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <chrono>
#include <filesystem>
#include <string>
#include <vector>

#include "tools/downpour/mpi_world.h"

namespace downpour {

// In the words of a run's command line, its directory, which each rank has elsewhere.
inline constexpr const char* kRunDirectoryWord = "{run}";

// Rank 0's side of a study whose runs the other ranks learn. Each has its runs' directories to
// itself, below its temporary directory; after every episode their files come to rank 0.
class StudyRanks {
 public:
  explicit StudyRanks(MpiWorld* world);

  // What a run that another rank learns has come to.
  struct News {
    int run = 0;
    bool ended = false;
    std::string end_text;  // as RunProcess::EndText
    bool lost = false;     // its rank was
  };

  // Ranks that help and are not lost.
  std::vector<int> Helpers() const;
  // A rank is to learn a run. Files of its directory that are there go with it; what comes back is
  // written there, and what it says into `log`.
  void Start(int rank, int run, const std::vector<std::string>& words,
             const std::filesystem::path& directory, const std::filesystem::path& log);
  // What has come in. Does not wait.
  std::vector<News> Poll();
  // All runs are to end at once, with what they have.
  void Terminate();

 private:
  using Clock = std::chrono::steady_clock;
  struct Run {
    int run;
    std::filesystem::path directory, log;
  };
  struct Helper {
    std::vector<Run> runs;
    Clock::time_point heard;
    bool lost = false;
  };
  void Read(const MpiMessage& message, std::vector<News>* news);
  MpiWorld* world_;
  std::vector<Helper> helpers_;  // [rank], that of rank 0 unused
  Clock::time_point polled_;
};

// The other ranks' side, until rank 0 ends it.
void HelpWithStudy(MpiWorld* world);

}  // namespace downpour
