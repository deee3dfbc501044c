// SPDX-License-Identifier: Apache-2.0
#include "tools/downpour/prior.h"

#include <fmt/format.h>

#include "engine/errors.h"

namespace downpour {

void UsePrior(const RunConfig& config, Task* task) {
  const PriorConfig& prior = config.prior;
  if (prior.model.empty()) {
    if (prior.free.empty()) return;
    throw InvalidInput(fmt::format(
        "prior.free = {}: must be empty without a prior; --prior FILE names one", prior.free));
  }
  if (!task->make_prior) {
    throw InvalidInput(fmt::format("prior.model = {}: must be empty: the task {} has no simulator",
                                   prior.model, task->name));
  }
  task->prior = task->make_prior(prior.model, prior.free);
}

}  // namespace downpour
