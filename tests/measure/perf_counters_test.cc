// SPDX-License-Identifier: Apache-2.0
#include "tools/measure/perf_counters.h"

#include <doctest/doctest.h>
#include <fcntl.h>
#include <unistd.h>

#include <cerrno>
#include <cstdint>
#include <string>
#include <vector>

namespace downpour {
namespace {

PerfCounters::OpenEvent Failing(int error) {
  return [error](perf_event_attr*, pid_t, int, int, unsigned long) {
    errno = error;
    return -1;
  };
}

TEST_CASE("perf_counters: a kernel that refuses is one line with advice, and counts are -1") {
  PerfCounters counters(Failing(EACCES));
  CHECK_FALSE(counters.any());
  CHECK(counters.reason() ==
        "no hardware counters for cycles, instructions, cache_misses: Permission denied; lower "
        "kernel.perf_event_paranoid, or run with CAP_PERFMON");
  counters.Start();
  for (const std::int64_t count : counters.Stop()) CHECK(count == -1);
}

TEST_CASE("perf_counters: a machine without counters is said to be one") {
  for (const int error : {ENOENT, EOPNOTSUPP, ENODEV}) {
    CHECK(PerfCounters(Failing(error)).reason().find("virtual machines") != std::string::npos);
  }
  CHECK(PerfCounters(Failing(EMFILE)).reason().find("Too many open files") != std::string::npos);
}

TEST_CASE("perf_counters: events that are offered count beside those that are not") {
  // Stands for a counter: a file whose first eight bytes are its count.
  char path[] = "/tmp/downpour-counter-XXXXXX";
  const int made = mkstemp(path);
  REQUIRE(made >= 0);
  const std::int64_t count = 12345;
  REQUIRE(write(made, &count, sizeof(count)) == sizeof(count));
  close(made);
  PerfCounters counters([&](perf_event_attr* attributes, pid_t pid, int, int, unsigned long) {
    CHECK(pid == 0);
    CHECK(static_cast<int>(attributes->exclude_kernel) == 1);
    if (attributes->config == PERF_COUNT_HW_INSTRUCTIONS) return open(path, O_RDONLY);
    errno = ENOENT;
    return -1;
  });
  CHECK(counters.any());
  CHECK(counters.available(kInstructions));
  CHECK_FALSE(counters.available(kCycles));
  CHECK(counters.reason().find("cycles, cache_misses:") != std::string::npos);
  counters.Start();
  const std::array<std::int64_t, kPerfEvents> counts = counters.Stop();
  CHECK(counts[kInstructions] == count);
  CHECK(counts[kCycles] == -1);
  unlink(path);
}

TEST_CASE("perf_counters: this kernel's count, or its reason") {
  PerfCounters counters;
  CHECK(counters.reason().empty() ==
        (counters.available(kCycles) && counters.available(kInstructions) &&
         counters.available(kCacheMisses)));
  counters.Start();
  volatile double x = 1;
  for (int i = 0; i < 100000; ++i) x = x * 1.0000001;
  const std::int64_t instructions = counters.Stop()[kInstructions];
  if (counters.available(kInstructions)) {
    CHECK(instructions > 100000);
  } else {
    CHECK(instructions == -1);
  }
}

}  // namespace
}  // namespace downpour
