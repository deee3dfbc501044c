// SPDX-License-Identifier: Apache-2.0
#include "tools/measure/perf_counters.h"

#include <fmt/format.h>
#include <sys/ioctl.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>

namespace downpour {
namespace {

int SystemCall(perf_event_attr* attributes, pid_t pid, int cpu, int group, unsigned long flags) {
  return static_cast<int>(syscall(SYS_perf_event_open, attributes, pid, cpu, group, flags));
}

std::string Reason(const std::string& events, int error) {
  const char* const advice = error == EACCES || error == EPERM
                                 ? "; lower kernel.perf_event_paranoid, or run with CAP_PERFMON"
                             : error == ENOENT || error == EOPNOTSUPP || error == ENODEV
                                 ? "; virtual machines often have none"
                                 : "";
  return fmt::format("no hardware counters for {}: {}{}", events, std::strerror(error), advice);
}

}  // namespace

PerfCounters::PerfCounters() : PerfCounters(SystemCall) {}

PerfCounters::PerfCounters(const OpenEvent& open_event) {
  constexpr std::uint64_t kEvents[] = {PERF_COUNT_HW_CPU_CYCLES, PERF_COUNT_HW_INSTRUCTIONS,
                                       PERF_COUNT_HW_CACHE_MISSES};
  std::string missing;
  int error = 0;
  for (int event = 0; event < kPerfEvents; ++event) {
    perf_event_attr attributes = {};
    attributes.type = PERF_TYPE_HARDWARE;
    attributes.size = sizeof(attributes);
    attributes.config = kEvents[event];
    attributes.disabled = 1;
    attributes.exclude_kernel = 1;
    attributes.exclude_hv = 1;
    files_[event] = open_event(&attributes, 0, -1, -1, PERF_FLAG_FD_CLOEXEC);
    if (files_[event] >= 0) continue;
    error = errno;
    missing += (missing.empty() ? "" : ", ") + std::string(kPerfEventNames[event]);
  }
  if (!missing.empty()) reason_ = Reason(missing, error);
}

PerfCounters::~PerfCounters() {
  for (const int file : files_) {
    if (file >= 0) close(file);
  }
}

bool PerfCounters::any() const {
  for (const int file : files_) {
    if (file >= 0) return true;
  }
  return false;
}

void PerfCounters::Start() {
  for (const int file : files_) {
    if (file < 0) continue;
    ioctl(file, PERF_EVENT_IOC_RESET, 0);
    ioctl(file, PERF_EVENT_IOC_ENABLE, 0);
  }
}

std::array<std::int64_t, kPerfEvents> PerfCounters::Stop() {
  std::array<std::int64_t, kPerfEvents> counts;
  for (int event = 0; event < kPerfEvents; ++event) {
    counts[event] = -1;
    if (files_[event] < 0) continue;
    ioctl(files_[event], PERF_EVENT_IOC_DISABLE, 0);
    if (read(files_[event], &counts[event], sizeof(counts[event])) != sizeof(counts[event])) {
      counts[event] = -1;
    }
  }
  return counts;
}

}  // namespace downpour
