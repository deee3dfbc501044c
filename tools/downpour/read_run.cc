// SPDX-License-Identifier: Apache-2.0
#include "tools/downpour/read_run.h"

#include <fmt/format.h>

#include <memory>

#include "engine/errors.h"
#include "engine/learner/run_directory.h"
#include "engine/learner/saved_policy.h"
#include "tools/downpour/prior.h"

namespace downpour {

ReadRun ReadRunDirectory(const std::string& path) {
  const RunDirectory directory = RunDirectory::Open(path);
  const std::string config = (directory.path() / "config.toml").string();
  ReadRun run{directory.path(), ResolveConfig(ReadConfigFile(config)), {}};
  // A robot's run was with no model (UseRobot).
  if (!run.resolved.config.system.program.empty()) run.resolved.task.model_digest.clear();
  UsePrior(run.resolved.config, &run.resolved.task);
  run.state = directory.ReadState(run.resolved.task, run.resolved.config.learner);
  if (run.state.episodes.empty()) {
    throw InvalidInput(fmt::format("{}: no finished episode; must have one at least", path));
  }
  return run;
}

const EpisodeRecord& FindEpisode(const ReadRun& run, int number) {
  const std::vector<EpisodeRecord>& episodes = run.state.episodes;
  if (number > static_cast<int>(episodes.size())) {
    throw InvalidInput(fmt::format("--episode: {} is not in {}; must be in [1, {}]", number,
                                   run.path.string(), episodes.size()));
  }
  return number == 0 ? episodes.back() : episodes[number - 1];
}

const EpisodeRecord& FindLearntEpisode(const ReadRun& run, int number) {
  const EpisodeRecord& record = FindEpisode(run, number);
  if (!record.random) return record;
  throw InvalidInput(
      fmt::format("--episode: {} of {} was random, without a policy; must be a learnt episode",
                  record.episode, run.path.string()));
}

Prediction PredictSavedEpisode(const ReadRun& run, const EpisodeRecord& record, int n_rollouts) {
  const SavedPolicy saved = ReadPolicy(run.path / fmt::format("policy_{}.json", record.episode));
  const std::unique_ptr<Policy> policy = MakePolicy(saved, run.resolved.task);
  return PredictEpisode(run.resolved.task, run.resolved.config.learner, *policy,
                        run.state.transitions, record, n_rollouts);
}

}  // namespace downpour
