// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <filesystem>
#include <string>

#include "engine/learner/prediction.h"
#include "tools/downpour/config.h"

namespace downpour {

// A run directory, read to look at.
struct ReadRun {
  std::filesystem::path path;
  ResolvedRun resolved;
  LearnerState state;  // at least one finished episode
};

// Throws InvalidInput if no run is there or none of its episodes is finished, and what
// RunDirectory::ReadState throws.
ReadRun ReadRunDirectory(const std::string& path);

// Episode `number` of the run, 0 for the last. Throws InvalidInput that names those there.
const EpisodeRecord& FindEpisode(const ReadRun& run, int number);

// The same; throws InvalidInput also for a random episode, which has neither policy nor model.
const EpisodeRecord& FindLearntEpisode(const ReadRun& run, int number);

// PredictEpisode of a learnt episode, with the policy that the run saved.
Prediction PredictSavedEpisode(const ReadRun& run, const EpisodeRecord& record, int n_rollouts);

}  // namespace downpour
