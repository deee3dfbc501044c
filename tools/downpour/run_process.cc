// SPDX-License-Identifier: Apache-2.0
#include "tools/downpour/run_process.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <csignal>
#include <cstring>
#include <system_error>
#include <utility>

#include "engine/errors.h"

namespace downpour {
namespace {

// In the child: only functions that are safe in a signal handler.
[[noreturn]] void Execute(char* const* words, pid_t parent, int input, int output, int log) {
  // The parent may have died before this line.
  prctl(PR_SET_PDEATHSIG, SIGKILL);
  if (getppid() != parent) _exit(1);
  signal(SIGINT, SIG_DFL);
  signal(SIGTERM, SIG_DFL);
  dup2(input, STDIN_FILENO);
  dup2(output, STDOUT_FILENO);
  dup2(log, STDERR_FILENO);
  execv("/proc/self/exe", words);
  _exit(127);
}

}  // namespace

RunProcess::RunProcess(const std::vector<std::string>& words, const std::string& log) {
  std::vector<char*> argv;
  for (const std::string& word : words) argv.push_back(const_cast<char*>(word.c_str()));
  argv.push_back(nullptr);
  const int log_file = open(log.c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0666);
  if (log_file < 0) throw FileError(fmt::format("{}: {}", log, std::strerror(errno)));
  const int input = open("/dev/null", O_RDONLY | O_CLOEXEC);
  int ends[2] = {-1, -1};
  int error = pipe2(ends, O_CLOEXEC) == 0 ? 0 : errno;
  const pid_t parent = getpid();
  if (error == 0) {
    pid_ = fork();
    if (pid_ == 0) Execute(argv.data(), parent, input, ends[1], log_file);
    if (pid_ < 0) error = errno;
  }
  output_ = ends[0];
  for (const int fd : {log_file, input, ends[1]}) {
    if (fd >= 0) close(fd);
  }
  if (error != 0) {
    if (output_ >= 0) close(output_);
    throw std::system_error(error, std::generic_category(), "cannot start a run");
  }
}

RunProcess::RunProcess(RunProcess&& other) noexcept
    : pid_(std::exchange(other.pid_, -1)),
      output_(std::exchange(other.output_, -1)),
      status_(other.status_) {}

RunProcess::~RunProcess() {
  if (pid_ >= 0) {
    kill(pid_, SIGKILL);
    while (waitpid(pid_, &status_, 0) < 0 && errno == EINTR) {
    }
  }
  if (output_ >= 0) close(output_);
}

int RunProcess::ReadLines() {
  char buffer[4096];
  const ssize_t n = read(output_, buffer, sizeof(buffer));
  if (n > 0) return static_cast<int>(std::count(buffer, buffer + n, '\n'));
  if (n < 0 && errno == EINTR) return 0;
  while (waitpid(pid_, &status_, 0) < 0 && errno == EINTR) {
  }
  pid_ = -1;
  return 0;
}

std::string RunProcess::EndText() const {
  if (WIFSIGNALED(status_)) return fmt::format("signal {}", WTERMSIG(status_));
  return WEXITSTATUS(status_) == 0 ? "" : fmt::format("exit code {}", WEXITSTATUS(status_));
}

void RunProcess::Terminate() {
  if (pid_ >= 0) kill(pid_, SIGTERM);
}

}  // namespace downpour
