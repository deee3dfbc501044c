// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "engine/learner/directory_lock.h"
#include "engine/learner/learner.h"

namespace downpour {

// A text file; the path is from the folder that it is to lie in.
struct FileCopy {
  std::filesystem::path path;
  std::string text;
};

// The folder of a run directory that a task's own files are in.
inline constexpr const char* kTaskFolder = "task";

// The directory of one run. Every file is text and replaced atomically; numbers have the digits
// that give the same double back, a NaN in a CSV file is an empty field. Files:
//   config.toml              the resolved configuration, as the caller handed it in
//   task/                    copies of a task's own files, if it is made of any
//   episodes.csv             one row an episode; no clock in it: the same bytes for any thread
//                            count and after a resume
//   timing.csv               one row an episode: seconds of model learning and search, queries/s,
//                            ns a query
//   transitions.csv          one row a step on the real system, names and units in the header
//   policy_<episode>.json    a learnt policy with all that running it takes (saved_policy.h)
//   policy.json              the last of them
//   hyperparameters.csv      one row an episode, output and hyper-parameter
//   plans.csv                one row an episode and output: how rollouts queried the model
//   prior.csv                with a prior only: its parameters, one row an episode
//   prior_timing.csv         with a prior only: what it cost
//   checkpoint.json          the state (checkpoint.h), written last: what it holds is kept
// Not thread-safe. One process at a time writes a directory, others may read it.
class RunDirectory {
 public:
  // Makes `path`, parents included, takes its lock and writes the copies and config.toml, last.
  // Throws InvalidInput if `path` is a directory with files in it (an existing run is never
  // overwritten) or no directory, or if another process holds its lock; FileError if it cannot be
  // made or written.
  static RunDirectory Create(const std::filesystem::path& path, const std::string& config_toml,
                             const std::vector<FileCopy>& task_files = {});

  // An existing run, to be read only. Throws InvalidInput if `path` is no directory with a
  // config.toml.
  static RunDirectory Open(const std::filesystem::path& path);

  // An existing run that this process goes on with: also takes the lock, for as long as the object
  // lives. Throws as Open does, and InvalidInput if another process holds the lock.
  static RunDirectory OpenForWriting(const std::filesystem::path& path);

  const std::filesystem::path& path() const { return path_; }

  // Text of config.toml. Throws FileError.
  std::string ReadConfig() const;

  // The state to go on from: that of checkpoint.json, or an empty one if the run was stopped before
  // its first checkpoint. Throws as ReadCheckpoint does (checkpoint.h).
  LearnerState ReadState(const Task& task, const LearnerOptions& options) const;

  // Writes all files for the learner's state, except config.toml and the policies of earlier
  // episodes. To be called after every episode, and once after a resume: a crash between two files
  // may have left the others one episode ahead of checkpoint.json. Not for what Open returned.
  // Throws FileError; what checkpoint.json held before is then still there.
  void Write(const Learner& learner) const;

 private:
  RunDirectory(std::filesystem::path path, std::optional<DirectoryLock> lock)
      : path_(std::move(path)), lock_(std::move(lock)) {}
  std::filesystem::path path_;
  std::optional<DirectoryLock> lock_;
};

}  // namespace downpour
