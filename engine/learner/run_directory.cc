// SPDX-License-Identifier: Apache-2.0
#include "engine/learner/run_directory.h"

#include <string>
#include <system_error>

#include "engine/errors.h"
#include "engine/learner/atomic_file.h"
#include "engine/learner/checkpoint.h"
#include "engine/learner/csv_tables.h"
#include "engine/learner/saved_policy.h"

namespace downpour {
namespace {

namespace fs = std::filesystem;

constexpr const char* kConfig = "config.toml";
constexpr const char* kCheckpoint = "checkpoint.json";

// True if nothing is there but what Create, killed before config.toml was whole, left behind.
bool IsEmpty(const fs::path& directory, std::error_code* error) {
  const std::string leftover = kConfig + std::string(kTemporarySuffix);
  for (fs::directory_iterator entry(directory, *error), end; !*error && entry != end;
       entry.increment(*error)) {
    const fs::path name = entry->path().filename();
    if (name != leftover && name != kTaskFolder) return false;
  }
  return true;
}

void WriteCopies(const fs::path& folder, const std::vector<FileCopy>& copies) {
  for (const FileCopy& copy : copies) {
    const fs::path path = folder / copy.path;
    std::error_code error;
    fs::create_directories(path.parent_path(), error);
    if (error) {
      throw FileError(path.parent_path().string() + ": cannot create: " + error.message());
    }
    WriteFileAtomically(path, copy.text);
  }
}

void WritePolicies(const fs::path& directory, const Learner& learner) {
  const EpisodeRecord& last = learner.state().episodes.back();
  if (last.random) return;
  const std::string text =
      FormatPolicy(MakeSavedPolicy(learner.task(), learner.options(), learner.policy(), last));
  WriteFileAtomically(directory / ("policy_" + std::to_string(last.episode) + ".json"), text);
  WriteFileAtomically(directory / "policy.json", text);
}

}  // namespace

RunDirectory RunDirectory::Create(const fs::path& path, const std::string& config_toml,
                                  const std::vector<FileCopy>& task_files) {
  std::error_code error;
  const fs::file_status status = fs::status(path, error);
  if (fs::exists(status) && !fs::is_directory(status)) {
    throw InvalidInput(path.string() + ": is not a directory: use another --out");
  }
  fs::create_directories(path, error);
  if (error) throw FileError(path.string() + ": cannot create: " + error.message());
  DirectoryLock lock(path);
  const bool empty = IsEmpty(path, &error);
  if (error) throw FileError(path.string() + ": cannot read: " + error.message());
  if (!empty) {
    throw InvalidInput(path.string() + ": is not empty: use --resume " + path.string() +
                       " to go on with the run in it, or another --out");
  }
  WriteCopies(path / kTaskFolder, task_files);
  WriteFileAtomically(path / kConfig, config_toml);
  return RunDirectory(path, std::move(lock));
}

RunDirectory RunDirectory::Open(const fs::path& path) {
  std::error_code error;
  if (!fs::is_regular_file(path / kConfig, error)) {
    throw InvalidInput(path.string() + ": no run here: must be a directory with a " + kConfig);
  }
  return RunDirectory(path, std::nullopt);
}

RunDirectory RunDirectory::OpenForWriting(const fs::path& path) {
  RunDirectory run = Open(path);
  run.lock_.emplace(path);
  return run;
}

std::string RunDirectory::ReadConfig() const { return ReadFile(path_ / kConfig); }

LearnerState RunDirectory::ReadState(const Task& task, const LearnerOptions& options) const {
  std::error_code error;
  if (fs::status(path_ / kCheckpoint, error).type() == fs::file_type::not_found) return {};
  return ReadCheckpoint(path_ / kCheckpoint, task, options);
}

void RunDirectory::Write(const Learner& learner) const {
  const LearnerState& state = learner.state();
  WriteFileAtomically(path_ / "episodes.csv", EpisodesCsv(state));
  const std::vector<Variable> outputs = ModelOutputs(learner.task(), learner.options());
  WriteFileAtomically(path_ / "timing.csv", TimingCsv(outputs, state));
  WriteFileAtomically(path_ / "transitions.csv", TransitionsCsv(learner.task(), state));
  WriteFileAtomically(path_ / "hyperparameters.csv",
                      HyperparametersCsv(learner.task(), outputs, state));
  WriteFileAtomically(path_ / "plans.csv", PlansCsv(outputs, state));
  if (learner.task().prior != nullptr) {
    WriteFileAtomically(path_ / "prior.csv", PriorCsv(learner.task(), state));
    WriteFileAtomically(path_ / "prior_timing.csv", PriorTimingCsv(state));
  }
  if (!state.episodes.empty()) WritePolicies(path_, learner);
  WriteCheckpoint(path_ / kCheckpoint, learner.task(), learner.options(), state);
}

}  // namespace downpour
