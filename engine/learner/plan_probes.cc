// SPDX-License-Identifier: Apache-2.0
#include "engine/learner/plan_probes.h"

#include <algorithm>
#include <cmath>

namespace downpour {
namespace {

constexpr std::uint32_t kProbePolicies = 96;
// Candidates whose rollouts check the plan.
constexpr int kCheckedCandidates = 32;

}  // namespace

void DrawRandomPolicy(const PolicySearchOptions& search, const StreamKey& key,
                      std::span<double> parameters) {
  double u;
  FillUniforms(key, 0, &u, 1);
  const double sigma = search.restart_sigma * std::pow(10.0, -search.restart_decades * u);
  FillUniforms(key, 1, parameters.data(), parameters.size());
  for (double& value : parameters) {
    value = std::clamp(sigma * (2 * value - 1), -search.bound, search.bound);
  }
}

void PerturbPolicy(const PolicySearchOptions& search, const StreamKey& key,
                   std::span<double> parameters) {
  std::vector<double> z(parameters.size());
  FillNormals(key, 0, z.data(), z.size());
  for (std::size_t p = 0; p < z.size(); ++p) {
    parameters[p] =
        std::clamp(parameters[p] + search.first_sigma * z[p], -search.bound, search.bound);
  }
}

Eigen::MatrixXd MetInputs(Evaluator* evaluator, std::span<const double> parameters,
                          std::span<const StreamKey> keys, int n_inputs) {
  using RowMajor = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
  const std::vector<int> one(keys.size(), 1);
  const std::vector<double> met = evaluator->Trace(parameters, keys, one).inputs;
  return Eigen::Map<const RowMajor>(met.data(), static_cast<Eigen::Index>(met.size()) / n_inputs,
                                    n_inputs);
}

Eigen::MatrixXd ProbeInputs(const PolicySearchOptions& search,
                            const std::vector<double>& last_policy, std::uint64_t seed,
                            std::uint32_t episode, int n_inputs, Evaluator* evaluator) {
  const std::size_t n_parameters = last_policy.size();
  std::vector<double> parameters(kProbePolicies * n_parameters);
  std::vector<StreamKey> keys;
  for (std::uint32_t c = 0; c < kProbePolicies; ++c) {
    keys.push_back(DeriveKey(seed, StreamPurpose::kPlanProbe, {episode, c, 0}));
    const StreamKey policy_key = DeriveKey(seed, StreamPurpose::kPlanProbe, {episode, c, 1});
    const std::span<double> row(parameters.data() + c * n_parameters, n_parameters);
    if (c % 3 == 2) {
      DrawRandomPolicy(search, policy_key, row);
      continue;
    }
    std::copy(last_policy.begin(), last_policy.end(), row.begin());
    if (c % 3 == 1) PerturbPolicy(search, policy_key, row);
  }
  return MetInputs(evaluator, parameters, keys, n_inputs);
}

Eigen::MatrixXd NextInputs(std::span<const SearchRun> runs, int n_inputs, Evaluator* evaluator) {
  const SearchBatch batch = NextGeneration(runs);
  const std::size_t n_parameters = batch.parameters.size() / batch.n_candidates;
  const std::size_t every = std::max<std::size_t>(1, batch.n_candidates / kCheckedCandidates);
  std::vector<double> parameters;
  std::vector<StreamKey> keys;
  for (std::size_t c = 0; c < batch.n_candidates; c += every) {
    const auto row = std::span(batch.parameters).subspan(c * n_parameters, n_parameters);
    parameters.insert(parameters.end(), row.begin(), row.end());
    keys.push_back(batch.keys[c]);
  }
  return MetInputs(evaluator, parameters, keys, n_inputs);
}

}  // namespace downpour
