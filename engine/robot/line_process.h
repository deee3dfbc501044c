// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <sys/types.h>

#include <atomic>
#include <chrono>
#include <string>
#include <vector>

namespace downpour {

// A child process that is spoken to in lines over its standard input and output; its standard error
// is ours. It runs in a process group of its own, so that a Ctrl-C at the terminal reaches us alone
// (and it cannot read from the terminal). One thread at a time.
class LineProcess {
 public:
  // Starts command[0], looked up in PATH, without a shell. `stop`, if any, ends every wait with
  // Interrupted within 50 ms. Throws InvalidInput if the program cannot be started.
  LineProcess(const std::vector<std::string>& command, const std::atomic<bool>* stop);
  // As Close().
  ~LineProcess();
  LineProcess(const LineProcess&) = delete;
  LineProcess& operator=(const LineProcess&) = delete;

  // Writes `line` and a line end. If the process reads no more, that is no error here: ReadLine
  // gives what it still said, and then why it ended. Throws SystemFailure after `timeout` seconds.
  void WriteLine(const std::string& line, double timeout);

  // The next line, without its end. Throws SystemFailure after `timeout` seconds, for a line longer
  // than 1 MiB, and when the process has closed its output or ended, with its exit status or
  // signal.
  std::string ReadLine(double timeout);

  // True if ReadLine would not have to wait.
  bool HasOutput();

  // Closes its standard input, waits for its end for 2 s, then sends SIGTERM to its process group,
  // waits for 1 s and sends SIGKILL. Nothing of the group is left after it, and no zombie. A second
  // call does nothing.
  void Close() noexcept;

 private:
  using Clock = std::chrono::steady_clock;

  bool Poll(int fd, short events, Clock::time_point deadline) const;
  bool ReceiveSome();
  bool Ended() const;
  bool WaitForEnd(double seconds);
  std::string EndText();

  const std::atomic<bool>* stop_;
  pid_t pid_ = -1;
  int to_ = -1;    // its standard input
  int from_ = -1;  // its standard output
  std::string received_;
  bool end_of_output_ = false;
};

}  // namespace downpour
