// SPDX-License-Identifier: Apache-2.0
#include "tools/downpour/stop.h"

#include <csignal>

namespace downpour {
namespace {

// A signal handler reaches nothing but globals; lock-free, so that it may write them.
std::atomic<bool> stop_requested{false};
std::atomic<int> stop_signal{0};
static_assert(std::atomic<bool>::is_always_lock_free && std::atomic<int>::is_always_lock_free);

void RequestStop(int signal) {
  stop_signal = signal;
  stop_requested = true;
}

}  // namespace

void InstallStopHandler() {
  struct sigaction action {};
  action.sa_handler = RequestStop;
  action.sa_flags = SA_RESETHAND | SA_RESTART;
  sigaction(SIGINT, &action, nullptr);
  sigaction(SIGTERM, &action, nullptr);
}

const std::atomic<bool>& StopRequested() { return stop_requested; }

int StopSignal() { return stop_signal; }

}  // namespace downpour
