// SPDX-License-Identifier: Apache-2.0
#include "engine/learner/platform.h"

#include "engine/gp/process_settings.h"
#include "kernels/fma_peak/fma_peak.h"

namespace downpour {

Platform CurrentPlatform() {
  return {.simd_target = SimdTargetName(), .blas_core = BlasCoreName()};
}

std::string PlatformDifference(const LearnerState& state, const Platform& current) {
  for (const EpisodeRecord& record : state.episodes) {
    const Platform& other = record.platform;
    std::string reasons;
    const auto compare = [&](const char* what, const std::string& was, const std::string& is) {
      if (was == is) return;
      reasons += std::string(reasons.empty() ? "" : " and ") + what + " " + was + ", now " + is;
    };
    compare("SIMD target", other.simd_target, current.simd_target);
    compare("OpenBLAS kernels", other.blas_core, current.blas_core);
    if (reasons.empty()) continue;
    return "results will not be bit-identical to those of an uninterrupted run, because episode " +
           std::to_string(record.episode) + " was made with " + reasons;
  }
  return "";
}

}  // namespace downpour
