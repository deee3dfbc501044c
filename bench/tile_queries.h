// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <Eigen/Core>
#include <memory>
#include <span>
#include <vector>

#include "bench/baseline_per_query.h"
#include "engine/gp/query_plan.h"

namespace downpour {

// Answers of `factor` at `inputs` (rows x D) that no query may give: a mean that is not finite, a
// variance that is negative or not finite.
int CountUnsound(const QueryFactor& factor, const Eigen::MatrixXd& inputs);

// Nanoseconds that one query of mean and variance takes, for each of E outputs.
struct QueryTimes {
  std::vector<double> exact, plan;
  std::vector<double> per_query;  // one query at a time; empty without
};

// Times queries at rows of `inputs` (rows x D, at least one) on one thread: tiles of rows spread
// evenly over all of them, the outputs in turn for each tile as in rollouts, so that a factor has
// left the nearer caches when its turn comes again. Exact, plan and per-query repetitions alternate
// and the best of them counts. Two readings of the clock a tile are included, about 1 ns a query.
// `per_query` is empty or holds one model an output.
QueryTimes TimeQueries(std::span<const QueryFactor> exact, std::span<const QueryFactor> plan,
                       std::span<const std::unique_ptr<PerQueryGp>> per_query,
                       const Eigen::MatrixXd& inputs);

}  // namespace downpour
