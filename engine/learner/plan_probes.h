// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <span>
#include <vector>

#include "engine/rollout/evaluator.h"
#include "engine/search/policy_search.h"
#include "engine/search/search_run.h"

namespace downpour {

// Fills `parameters` (P) with a random policy, drawn from `key` as the search's restarts are:
// uniform in +-sigma, sigma = restart_sigma 10^(-restart_decades U), within the bound.
void DrawRandomPolicy(const PolicySearchOptions& search, const StreamKey& key,
                      std::span<double> parameters);

// Moves a policy (P) by first_sigma z, z standard normal from `key`, within the bound: as the
// search's first run draws its first candidates.
void PerturbPolicy(const PolicySearchOptions& search, const StreamKey& key,
                   std::span<double> parameters);

// Inputs (n horizon x D, features and action) that one rollout of each of the n candidates meets:
// Evaluator::Trace's as a matrix.
Eigen::MatrixXd MetInputs(Evaluator* evaluator, std::span<const double> parameters,
                          std::span<const StreamKey> keys, int n_inputs);

// Inputs like those that a search will meet (rows x D), to choose plans on: 96 rollouts of the
// evaluator's model, a third by `last_policy` (P), a third by policies around it and a third by
// random ones. The streams are those of (seed, episode).
Eigen::MatrixXd ProbeInputs(const PolicySearchOptions& search,
                            const std::vector<double>& last_policy, std::uint64_t seed,
                            std::uint32_t episode, int n_inputs, Evaluator* evaluator);

// Inputs that a sample of the candidates of the runs' next generation meets (rows x D), to check
// plans on during a search: some 32 rollouts, all runs' alike.
Eigen::MatrixXd NextInputs(std::span<const SearchRun> runs, int n_inputs, Evaluator* evaluator);

}  // namespace downpour
