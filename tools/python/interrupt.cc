// SPDX-License-Identifier: Apache-2.0
#include "tools/python/interrupt.h"

#include <unistd.h>

#include <csignal>

namespace downpour::python {
namespace {

// A signal handler reaches nothing but globals. Only the main thread writes them otherwise.
std::atomic<bool> interrupted{false};
const std::atomic<bool> never{false};
struct sigaction previous {};
static_assert(std::atomic<bool>::is_always_lock_free);

void Handle(int signal) {
  interrupted = true;
  previous.sa_handler(signal);
}

bool IsOurs(const struct sigaction& action) { return action.sa_handler == Handle; }

}  // namespace

InterruptScope::InterruptScope() {
  if (gettid() != getpid()) return;
  struct sigaction present {};
  sigaction(SIGINT, nullptr, &present);
  // Whoever ignores Ctrl-C, or dies of it, shall go on doing so; in an outer scope it is ours.
  const bool chains = !(present.sa_flags & SA_SIGINFO) && present.sa_handler != SIG_IGN &&
                      present.sa_handler != SIG_DFL;
  if (!chains || IsOurs(present)) return;
  interrupted = false;
  previous = present;
  struct sigaction action = present;
  action.sa_handler = Handle;
  sigaction(SIGINT, &action, nullptr);
  installed_ = true;
}

InterruptScope::~InterruptScope() {
  if (!installed_) return;
  struct sigaction present {};
  sigaction(SIGINT, nullptr, &present);
  // Unless a callback has put another one there.
  if (IsOurs(present)) sigaction(SIGINT, &previous, nullptr);
}

const std::atomic<bool>* InterruptScope::flag() const {
  return gettid() == getpid() ? &interrupted : &never;
}

}  // namespace downpour::python
