// SPDX-License-Identifier: Apache-2.0
#include <fmt/format.h>
#include <mujoco/mujoco.h>
#include <omp.h>
#include <openblas_config.h>

#include <CLI/App.hpp>
#include <CLI/Config.hpp>
#include <CLI/Formatter.hpp>
#include <cstdlib>
#include <string>
#include <vector>

#include "engine/errors.h"
#include "engine/gp/process_settings.h"
#include "kernels/fma_peak/fma_peak.h"
#include "tools/downpour/commands.h"
#include "tools/downpour/offscreen.h"
#include "tools/measure/machine.h"

namespace downpour {
namespace {

// Long enough for the best of many repetitions.
constexpr double kPeakSeconds = 0.2;
// Below this, one core has no AVX2 or shares its time with others.
constexpr double kSlowGflops = 20;

// Why this build is slow; empty if it is not.
std::string SlowBuild() {
#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
  return "built with a sanitizer";
#elif !defined(__OPTIMIZE__)
  return "built without optimisation";
#else
  return "";
#endif
}

// The macro has spaces and a name around the number.
std::string OpenBlasVersion() {
  const std::string text = OPENBLAS_VERSION;
  const std::size_t begin = text.find_first_of("0123456789");
  return text.substr(begin, text.find_last_not_of(' ') + 1 - begin);
}

// What downpour render and downpour plot find.
std::string Pictures() {
  const auto found = [](const char* command) { return std::system(command) == 0; };
  std::string text;
  try {
    text = OffscreenDescription();
  } catch (const FileError& error) {
    text = error.what();
  }
  text += found("command -v ffmpeg >/dev/null") ? "; ffmpeg" : "; no ffmpeg, for films";
  text += found("/usr/bin/python3 -P -c 'import matplotlib' 2>/dev/null")
              ? "; matplotlib"
              : "; no python3-matplotlib, for plots";
  return text;
}

void Row(const char* name, const std::string& text) { fmt::print("{:<13} {}\n", name, text); }

void Examine() {
  std::vector<std::string> warnings;
  Row("downpour", DOWNPOUR_VERSION);
  const std::string slow_build = SlowBuild();
  Row("build", fmt::format("{}, {}", Compiler(), slow_build.empty() ? "optimised" : slow_build));
  if (!slow_build.empty()) warnings.push_back(slow_build + ": use the release preset");
  Row("CPU", CpuModel());
  const int cores = omp_get_num_procs();
  Row("threads", fmt::format("{} (--threads 0)", cores));
  Row("SIMD", SimdTargetName());
  const double fp64 = FmaPeakGflops(false, kPeakSeconds);
  const double fp32 = FmaPeakGflops(true, kPeakSeconds);
  Row("FMA peak", fmt::format("{:.1f} GFLOP/s fp64, {:.1f} GFLOP/s fp32, one thread", fp64, fp32));
  if (fp64 < kSlowGflops) {
    warnings.push_back(fmt::format(
        "FMA peak of {:.1f} GFLOP/s fp64: no AVX2, or the core is shared with other work", fp64));
  }
  const std::string core = BlasCoreName();
  const std::string suitable = SuitableBlasCore();
  const char* chosen = std::getenv("OPENBLAS_CORETYPE");
  Row("OpenBLAS", fmt::format("{}, {} kernels{}", OpenBlasVersion(), core,
                              BlasCoreWasMended() ? ", corrected from what it chose itself"
                              : chosen != nullptr ? ", by OPENBLAS_CORETYPE"
                                                  : ", its own choice"));
  if (IsWeakerBlasCore(core, suitable)) {
    warnings.push_back(
        fmt::format("OpenBLAS runs its {} kernels: set OPENBLAS_CORETYPE={}", core, suitable));
  }
  Row("MuJoCo", mj_versionString());
  Row("pictures", Pictures());
  for (const std::string& warning : warnings) Row("warning", warning);
  if (warnings.empty()) Row("verdict", "nothing slows this machine down");
}

}  // namespace

void AddDoctorCommand(CLI::App* app) {
  CLI::App* command =
      app->add_subcommand("doctor", "Show what this machine gives the program, and what slows it");
  command->callback(Examine);
}

}  // namespace downpour
