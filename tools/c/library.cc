// SPDX-License-Identifier: Apache-2.0
#include <string>

#include "engine/gp/process_settings.h"
#include "kernels/fma_peak/fma_peak.h"
#include "tools/c/downpour.h"

namespace downpour::c {
namespace {

std::string PlatformWarning() {
  const std::string core = BlasCoreName(), suitable = SuitableBlasCore();
  if (!IsWeakerBlasCore(core, suitable)) return "";
  return "OpenBLAS runs its " + core +
         " kernels, which are slow on this CPU: set OPENBLAS_CORETYPE=" + suitable +
         " in the environment of the process";
}

}  // namespace
}  // namespace downpour::c

int downpour_abi_version(void) { return DOWNPOUR_ABI_VERSION; }

const char* downpour_version(void) { return DOWNPOUR_VERSION; }

const char* downpour_simd_target(void) { return downpour::SimdTargetName(); }

const char* downpour_blas_core(void) {
  static const std::string core = downpour::BlasCoreName();
  return core.c_str();
}

const char* downpour_platform_warning(void) {
  static const std::string warning = downpour::c::PlatformWarning();
  return warning.c_str();
}
