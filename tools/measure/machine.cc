// SPDX-License-Identifier: Apache-2.0
#include "tools/measure/machine.h"

#include <fmt/format.h>
#include <sys/utsname.h>
#include <unistd.h>

#include <cstdlib>
#include <fstream>
#include <set>

#include "engine/gp/process_settings.h"
#include "kernels/fma_peak/fma_peak.h"
#include "tools/measure/ceilings.h"

namespace downpour {
namespace {

// A short process that is just over leaves this much behind.
constexpr double kIdleLoad = 0.5;

// The first line of /proc/cpuinfo that begins with `name`, what follows its colon.
std::string CpuInfo(const char* name) {
  std::ifstream info("/proc/cpuinfo");
  for (std::string line; std::getline(info, line);) {
    const std::size_t colon = line.find(": ");
    if (line.starts_with(name) && colon != std::string::npos) return line.substr(colon + 2);
  }
  return "unknown";
}

std::string FirstLine(const std::string& path) {
  std::ifstream file(path);
  std::string line;
  return std::getline(file, line) ? line : "unknown";
}

// Hyper-threads of one core count once.
std::string PhysicalCores() {
  std::set<std::string> cores;
  for (int cpu = 0; cpu < sysconf(_SC_NPROCESSORS_CONF); ++cpu) {
    const std::string topology = fmt::format("/sys/devices/system/cpu/cpu{}/topology/", cpu);
    const std::string core = FirstLine(topology + "core_id");
    if (core == "unknown") return core;
    cores.insert(FirstLine(topology + "physical_package_id") + ":" + core);
  }
  return std::to_string(cores.size());
}

std::string Kibibytes(std::size_t bytes) {
  return bytes == 0 ? "unknown" : fmt::format("{} KiB", bytes / 1024);
}

}  // namespace

std::string CpuModel() { return CpuInfo("model name"); }

std::string CpuFlags() { return CpuInfo("flags"); }

std::string Compiler() {
#if defined(__clang__)
  return fmt::format("Clang {}.{}.{}", __clang_major__, __clang_minor__, __clang_patchlevel__);
#else
  return fmt::format("GCC {}.{}.{}", __GNUC__, __GNUC_MINOR__, __GNUC_PATCHLEVEL__);
#endif
}

std::vector<std::pair<std::string, std::string>> DescribeMachine() {
  const CacheSizes caches = ReadCacheSizes();
  utsname system = {};
  const bool named = uname(&system) == 0;
  return {{"cpu", CpuModel()},
          {"processors", std::to_string(sysconf(_SC_NPROCESSORS_ONLN))},
          {"cores", PhysicalCores()},
          {"cache_l1d", Kibibytes(caches.level1)},
          {"cache_l2", Kibibytes(caches.level2)},
          {"cache_l3", Kibibytes(caches.level3)},
          {"simd", SimdTargetName()},
          {"blas_core", BlasCoreName()},
          {"compiler", Compiler()},
          {"flags", DOWNPOUR_CXX_FLAGS},
          {"kernel", named ? fmt::format("{} {}", system.sysname, system.release) : "unknown"},
          {"governor", FirstLine("/sys/devices/system/cpu/cpu0/cpufreq/scaling_governor")}};
}

double LoadAverage() {
  double load = -1;
  return getloadavg(&load, 1) == 1 ? load : -1;
}

std::string LoadWarning() {
  const double load = LoadAverage();
  if (load < kIdleLoad) return "";
  return fmt::format("load average {:.1f}: other work slows this machine, figures may mislead",
                     load);
}

}  // namespace downpour
