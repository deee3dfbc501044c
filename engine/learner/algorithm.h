// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <string_view>

namespace downpour {

// How a learnt episode's policy is found.
enum class Algorithm {
  kBlackDrops,  // CMA-ES on sampled rollouts of the model
  kPilco,       // L-BFGS on the expected return by moment matching and its gradient
};
inline constexpr std::array kAlgorithmNames = {"black-drops", "pilco"};

// Whether results of `algorithm` can depend on the setting `key`, e.g. "search.rollouts". Settings
// that no algorithm alone has, as learn.seed, are used.
bool UsesSetting(Algorithm algorithm, std::string_view key);

}  // namespace downpour
