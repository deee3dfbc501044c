// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <sys/types.h>

#include <string>
#include <vector>

namespace downpour {

// This program once more as a child process, which dies with us, however that happens. Its standard
// output is read here, its standard error goes to a file. One thread at a time; the thread that
// starts it must outlive it.
class RunProcess {
 public:
  // `words` are its command line, words[0] the program as it was typed. Throws FileError if `log`
  // cannot be made, std::system_error if there is no room for a process.
  RunProcess(const std::vector<std::string>& words, const std::string& log);
  // Kills it if it is still there.
  ~RunProcess();
  RunProcess(RunProcess&& other) noexcept;
  RunProcess& operator=(RunProcess&&) = delete;

  // Becomes readable when there is output, or no more of it to come.
  int output() const { return output_; }

  // The number of lines that came since the last call. At the end of the output it waits for the
  // end of the process; ended() is then true.
  int ReadLines();
  bool ended() const { return pid_ < 0; }

  // How it ended: "" for exit code 0, "exit code 2", "signal 9".
  std::string EndText() const;

  void Terminate();  // SIGTERM

 private:
  pid_t pid_ = -1;
  int output_ = -1;
  int status_ = 0;
};

}  // namespace downpour
