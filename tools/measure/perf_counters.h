// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <linux/perf_event.h>
#include <sys/types.h>

#include <array>
#include <cstdint>
#include <functional>
#include <string>

namespace downpour {

enum PerfEvent { kCycles, kInstructions, kCacheMisses, kPerfEvents };
inline constexpr std::array kPerfEventNames = {"cycles", "instructions", "cache_misses"};

// Hardware counters of the calling thread, in user mode, where the kernel offers them. An event
// that it does not offer stays unavailable; the others count.
class PerfCounters {
 public:
  // The system call perf_event_open(attributes, pid, cpu, group, flags), or what stands for it in
  // tests: a file descriptor, or -1 with errno.
  using OpenEvent = std::function<int(perf_event_attr*, pid_t, int, int, unsigned long)>;

  PerfCounters();
  explicit PerfCounters(const OpenEvent& open_event);
  ~PerfCounters();
  PerfCounters(const PerfCounters&) = delete;
  PerfCounters& operator=(const PerfCounters&) = delete;

  bool available(PerfEvent event) const { return files_[event] >= 0; }
  bool any() const;
  // One line that says why events are missing; empty if all are there.
  const std::string& reason() const { return reason_; }

  // Counts from Start to Stop; -1 where an event is not available.
  void Start();
  std::array<std::int64_t, kPerfEvents> Stop();

 private:
  std::array<int, kPerfEvents> files_;
  std::string reason_;
};

}  // namespace downpour
