// SPDX-License-Identifier: Apache-2.0
#include "engine/gp/query_timing.h"

#include <algorithm>
#include <chrono>
#include <cstddef>
#include <limits>
#include <variant>

#include "kernels/aligned.h"

namespace downpour {

std::vector<double> TimeQueries(std::span<const QueryFactor> factors,
                                const Eigen::MatrixXd& inputs) {
  using Clock = std::chrono::steady_clock;
  constexpr std::chrono::milliseconds kEnough(1);
  AlignedVector<double> x(static_cast<std::size_t>(inputs.cols()) * kTileLanes);
  for (Eigen::Index d = 0; d < inputs.cols(); ++d) {
    for (int lane = 0; lane < kTileLanes; ++lane) {
      x[d * kTileLanes + lane] = inputs(lane * inputs.rows() / kTileLanes, d);
    }
  }
  std::size_t bytes = 0;
  for (const QueryFactor& factor : factors) {
    std::visit([&](const auto& f) { bytes = std::max(bytes, GpQueryScratchBytes(f)); }, factor);
  }
  AlignedVector<char> scratch(bytes);
  AlignedVector<double> means(kTileLanes), variances(kTileLanes);
  std::vector<double> best(factors.size(), std::numeric_limits<double>::infinity());
  const Clock::time_point first = Clock::now();
  for (int round = 0; round < 2 || Clock::now() - first < kEnough; ++round) {
    for (std::size_t e = 0; e < factors.size(); ++e) {
      const Clock::time_point start = Clock::now();
      std::visit(
          [&](const auto& f) {
            GpQueryTile(f, kTileLanes, x.data(), scratch.data(), means.data(), variances.data());
          },
          factors[e]);
      const std::chrono::duration<double, std::nano> elapsed = Clock::now() - start;
      best[e] = std::min(best[e], elapsed.count() / kTileLanes);
    }
  }
  return best;
}

}  // namespace downpour
