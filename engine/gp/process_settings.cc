// SPDX-License-Identifier: Apache-2.0
#include "engine/gp/process_settings.h"

#include <cblas.h>
#include <omp.h>
#include <sched.h>
#include <unistd.h>

#include <cstdlib>
#include <string>
#include <vector>

#include "hwy/targets.h"

namespace downpour {
namespace {

constexpr char kCoreVariable[] = "OPENBLAS_CORETYPE";
constexpr char kMendedVariable[] = "DOWNPOUR_BLAS_MENDED";
constexpr char kWaitVariable[] = "OMP_WAIT_POLICY";
constexpr char kSpinVariable[] = "GOMP_SPINCOUNT";
constexpr char kSpins[] = "2000";

// Doubles in a vector of the family's kernels: 8 for AVX-512, 4 for AVX2, 2 or less for the rest.
int VectorWidth(const std::string& core) {
  if (core == "SkylakeX" || core == "Cooperlake" || core == "SapphireRapids") return 8;
  if (core == "Haswell" || core == "Zen") return 4;
  return 2;
}

// OMP_PROC_BIND has bound this thread to one of its places by now, and a program keeps the
// processors of the one that executes it: all its threads would share that place.
void UnbindThread() {
  cpu_set_t processors;
  CPU_ZERO(&processors);
  for (int place = 0; place < omp_get_num_places(); ++place) {
    std::vector<int> ids(static_cast<std::size_t>(omp_get_place_num_procs(place)));
    omp_get_place_proc_ids(place, ids.data());
    for (const int id : ids) CPU_SET(id, &processors);
  }
  // Without places no thread is bound. A failure leaves it as it is: slower, but right.
  if (CPU_COUNT(&processors) > 0) sched_setaffinity(0, sizeof(processors), &processors);
}

}  // namespace

std::string BlasCoreName() { return openblas_get_corename(); }

std::string SuitableBlasCore() {
  const auto targets = hwy::SupportedTargets();
  if (targets & HWY_AVX3) return "SkylakeX";
  if (targets & HWY_AVX2) return "Haswell";
  return "";
}

bool IsWeakerBlasCore(const std::string& core, const std::string& suitable) {
  return VectorWidth(core) < VectorWidth(suitable);
}

bool BlasCoreWasMended() { return std::getenv(kMendedVariable) != nullptr; }

bool PrepareProcess(char** argv) {
  openblas_set_num_threads(1);
  const std::string suitable = SuitableBlasCore();
  const bool mend_core = !std::getenv(kCoreVariable) && IsWeakerBlasCore(BlasCoreName(), suitable);
  const bool set_waiting = !std::getenv(kWaitVariable) && !std::getenv(kSpinVariable);
  if (!mend_core && !set_waiting) return false;
  if (mend_core) {
    setenv(kCoreVariable, suitable.c_str(), 1);
    setenv(kMendedVariable, "1", 1);
  }
  if (set_waiting) {
    setenv(kWaitVariable, "passive", 1);
    setenv(kSpinVariable, kSpins, 1);
  }
  UnbindThread();
  execv("/proc/self/exe", argv);
  // Not executed: the variables would tell a state that is not there.
  if (mend_core) {
    unsetenv(kCoreVariable);
    unsetenv(kMendedVariable);
  }
  if (set_waiting) {
    unsetenv(kWaitVariable);
    unsetenv(kSpinVariable);
  }
  return false;
}

}  // namespace downpour
