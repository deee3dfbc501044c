// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <Eigen/Core>
#include <span>
#include <vector>

#include "engine/gp/query_plan.h"

namespace downpour {

// Nanoseconds that one query of mean and variance takes by each factor, on this thread and in full
// tiles of `inputs` (rows x D, one at least; an output of fewer inputs sees the leading columns):
// the best of some rounds in which the factors take turns, as in rollouts. Takes about a
// millisecond, or two rounds. Allocates.
std::vector<double> TimeQueries(std::span<const QueryFactor> factors,
                                const Eigen::MatrixXd& inputs);

}  // namespace downpour
