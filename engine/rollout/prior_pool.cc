// SPDX-License-Identifier: Apache-2.0
#include "engine/rollout/prior_pool.h"

#include <omp.h>

#include <algorithm>
#include <chrono>
#include <string>

#include "engine/errors.h"

namespace downpour {

PriorPool::PriorPool(const Task& task, std::span<const double> parameters, int threads) {
  const DynamicsPrior* const prior = task.prior.get();
  const std::size_t wanted = prior == nullptr ? 0 : prior->parameters().size();
  if (parameters.size() != wanted) {
    throw InvalidInput("prior: " + std::to_string(parameters.size()) + " parameters: must be " +
                       std::to_string(wanted));
  }
  if (prior == nullptr) return;
  members_.resize(std::max(threads, 1));
  for (Member& member : members_) {
    member.predictor = prior->MakePredictor();
    member.predictor->SetParameters(parameters);
  }
}

void PriorPool::Advance(int n, const double* actions, double* states) {
  using Clock = std::chrono::steady_clock;
  Member& member = members_[omp_get_thread_num()];
  const Clock::time_point start = Clock::now();
  member.predictor->PredictTile(n, states, actions, states);
  member.seconds += std::chrono::duration<double>(Clock::now() - start).count();
}

double PriorPool::seconds() const {
  double sum = 0;
  for (const Member& member : members_) sum += member.seconds;
  return sum;
}

}  // namespace downpour
