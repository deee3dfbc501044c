// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "engine/learner/learner.h"
#include "tools/downpour/study_file.h"

struct sqlite3;

namespace downpour {

// One replicate of a variant.
struct StudyRun {
  const StudyVariant* variant = nullptr;
  std::uint64_t seed = 0;
};

// The results of a study in an SQLite file (docs/studies.md has the schema). Every change is one
// transaction, on the disk when the function returns. All functions throw FileError if the file
// cannot be read or written.
class StudyDatabase {
 public:
  // Makes the file if it is not there. Throws InvalidInput if it is something else.
  explicit StudyDatabase(const std::string& path);

  // Adds what is new of the study. Throws InvalidInput, with nothing written, if settings of a
  // variant with results differ from those it was run with, or if its episodes are fewer.
  void Put(const Study& study);

  // How many episodes of the run are there, and the first that solved the task, 0: none.
  struct Progress {
    int episodes = 0;
    int solved_episode = 0;
  };
  Progress ReadProgress(const StudyRun& run);

  // Adds the episodes that are not there yet. `threads` and `jobs` go with their times.
  void Add(const StudyRun& run, const std::vector<EpisodeRecord>& episodes, int threads, int jobs);

 private:
  void Check(int result) const;
  void Execute(const char* sql);
  void CheckVariant(const StudyVariant& variant);
  void PutVariant(const StudyVariant& variant, int position);

  std::string path_;
  std::unique_ptr<sqlite3, int (*)(sqlite3*)> database_;
};

}  // namespace downpour
