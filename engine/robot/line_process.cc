// SPDX-License-Identifier: Apache-2.0
#include "engine/robot/line_process.h"

#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cmath>
#include <cstring>
#include <system_error>
#include <utility>

#include "engine/errors.h"
#include "engine/learner/text_format.h"

extern "C" char** environ;

namespace downpour {
namespace {

constexpr std::size_t kLongestLine = std::size_t{1} << 20;
constexpr std::chrono::milliseconds kStopPeriod(50);  // between looks at `stop`
constexpr std::chrono::milliseconds kEndPeriod(5);    // between looks for the end of the process
constexpr int kDropped = 256;                         // reads between those looks
constexpr double kCloseSeconds = 2;                   // after its standard input was closed
constexpr double kTerminateSeconds = 1;               // after SIGTERM
constexpr double kExitSeconds = 0.2;                  // from the end of its output to its own

std::chrono::steady_clock::time_point After(double seconds) {
  return std::chrono::steady_clock::now() +
         std::chrono::duration_cast<std::chrono::steady_clock::duration>(
             std::chrono::duration<double>(seconds));
}

void CloseDescriptor(int* fd) {
  if (*fd >= 0) ::close(*fd);
  *fd = -1;
}

void Check(int error, const char* what) {
  if (error != 0) throw std::system_error(error, std::generic_category(), what);
}

// A pipe that no other program inherits; `ours` never blocks.
struct Pipe {
  int ends[2] = {-1, -1};
  explicit Pipe(int ours) {
    if (::pipe2(ends, O_CLOEXEC) != 0) Check(errno, "pipe2");
    ::fcntl(ends[ours], F_SETFL, O_NONBLOCK);
  }
  ~Pipe() {
    CloseDescriptor(&ends[0]);
    CloseDescriptor(&ends[1]);
  }
  Pipe(const Pipe&) = delete;
  Pipe& operator=(const Pipe&) = delete;
  int Release(int end) { return std::exchange(ends[end], -1); }
};

// Starts the program with default signals in a process group of its own; an error number, or 0.
int Spawn(const std::vector<std::string>& command, int input, int output, pid_t* pid) {
  std::vector<char*> arguments;
  for (const std::string& word : command) arguments.push_back(const_cast<char*>(word.c_str()));
  arguments.push_back(nullptr);
  posix_spawn_file_actions_t actions;
  posix_spawnattr_t attributes;
  Check(posix_spawn_file_actions_init(&actions), "posix_spawn");
  Check(posix_spawnattr_init(&attributes), "posix_spawn");
  posix_spawn_file_actions_adddup2(&actions, input, STDIN_FILENO);
  posix_spawn_file_actions_adddup2(&actions, output, STDOUT_FILENO);
  sigset_t defaults, none;
  sigfillset(&defaults);
  sigemptyset(&none);
  posix_spawnattr_setsigdefault(&attributes, &defaults);
  posix_spawnattr_setsigmask(&attributes, &none);
  posix_spawnattr_setpgroup(&attributes, 0);
  posix_spawnattr_setflags(&attributes,
                           POSIX_SPAWN_SETPGROUP | POSIX_SPAWN_SETSIGDEF | POSIX_SPAWN_SETSIGMASK);
  const int error =
      posix_spawnp(pid, arguments[0], &actions, &attributes, arguments.data(), environ);
  posix_spawnattr_destroy(&attributes);
  posix_spawn_file_actions_destroy(&actions);
  return error;
}

// write() whose SIGPIPE, if any, is taken back: how the program treats that signal is its own
// affair.
ssize_t WriteWithoutSignal(int fd, const char* data, std::size_t size) {
  sigset_t pipe, old;
  sigemptyset(&pipe);
  sigaddset(&pipe, SIGPIPE);
  pthread_sigmask(SIG_BLOCK, &pipe, &old);
  const ssize_t written = ::write(fd, data, size);
  const int error = errno;
  const timespec now = {0, 0};
  if (written < 0 && error == EPIPE) sigtimedwait(&pipe, nullptr, &now);
  pthread_sigmask(SIG_SETMASK, &old, nullptr);
  errno = error;
  return written;
}

}  // namespace

LineProcess::LineProcess(const std::vector<std::string>& command, const std::atomic<bool>* stop)
    : stop_(stop) {
  Pipe input(1), output(0);
  const int error = Spawn(command, input.ends[0], output.ends[1], &pid_);
  if (error != 0) {
    throw InvalidInput("cannot start " + command[0] + ": " +
                       std::generic_category().message(error));
  }
  to_ = input.Release(1);
  from_ = output.Release(0);
}

LineProcess::~LineProcess() { Close(); }

// False at the deadline, true too once the process has ended: what it left behind may hold the
// other end.
bool LineProcess::Poll(int fd, short events, Clock::time_point deadline) const {
  while (true) {
    if (stop_ != nullptr && *stop_) throw Interrupted();
    const auto left = deadline - Clock::now();
    const auto slice = std::clamp<Clock::duration>(left, Clock::duration(0), kStopPeriod);
    pollfd descriptor{fd, events, 0};
    const auto milliseconds = std::chrono::ceil<std::chrono::milliseconds>(slice).count();
    if (::poll(&descriptor, 1, static_cast<int>(milliseconds)) > 0 || Ended()) return true;
    if (left <= Clock::duration(0)) return false;
  }
}

void LineProcess::WriteLine(const std::string& line, double timeout) {
  const std::string text = line + "\n";
  const Clock::time_point deadline = After(timeout);
  for (std::size_t done = 0; done < text.size();) {
    const ssize_t written = WriteWithoutSignal(to_, text.data() + done, text.size() - done);
    if (written > 0) done += static_cast<std::size_t>(written);
    if (written >= 0 || errno == EINTR) continue;
    if (errno != EAGAIN || Ended()) return;  // ReadLine tells more
    if (!Poll(to_, POLLOUT, deadline)) {
      throw SystemFailure("the robot's program read nothing for " + FormatNumber(timeout) + " s");
    }
  }
}

// Reads what is there; false if that is nothing.
bool LineProcess::ReceiveSome() {
  char buffer[4096];
  const ssize_t n = ::read(from_, buffer, sizeof(buffer));
  if (n > 0) received_.append(buffer, static_cast<std::size_t>(n));
  if (n == 0 || (n < 0 && errno != EAGAIN && errno != EINTR)) end_of_output_ = true;
  return n > 0;
}

std::string LineProcess::ReadLine(double timeout) {
  const Clock::time_point deadline = After(timeout);
  std::size_t searched = 0;
  while (true) {
    const std::size_t end = received_.find('\n', searched);
    if (end != std::string::npos) {
      std::string line = received_.substr(0, end);
      received_.erase(0, end + 1);
      return line;
    }
    searched = received_.size();
    if (searched > kLongestLine) {
      throw SystemFailure("the robot's program sent a line of more than 1 MiB");
    }
    if (end_of_output_) throw SystemFailure(EndText());
    if (!Poll(from_, POLLIN, deadline)) {
      throw SystemFailure(std::string("the robot's program gave ") +
                          (received_.empty() ? "no answer" : "only a part of a line") + " within " +
                          FormatNumber(timeout) + " s");
    }
    const bool ended = Ended();  // before the last look for what it wrote
    if (!ReceiveSome() && ended) end_of_output_ = true;
  }
}

bool LineProcess::HasOutput() {
  if (received_.empty() && !end_of_output_) ReceiveSome();
  return !received_.empty() || end_of_output_;
}

// True once the process has ended; it stays a zombie, which keeps its number from other processes.
bool LineProcess::Ended() const {
  siginfo_t info{};
  const int result = ::waitid(P_PID, static_cast<id_t>(pid_), &info, WEXITED | WNOHANG | WNOWAIT);
  return (result == 0 && info.si_pid == pid_) || (result < 0 && errno == ECHILD);
}

// Waits for the end; what the process writes meanwhile is dropped, so that it does not block.
bool LineProcess::WaitForEnd(double seconds) {
  for (const Clock::time_point deadline = After(seconds); !Ended();) {
    if (Clock::now() >= deadline) return false;
    for (int i = 0; i < kDropped && !end_of_output_ && ReceiveSome(); ++i) received_.clear();
    ::poll(nullptr, 0, static_cast<int>(kEndPeriod.count()));
  }
  return true;
}

// Why there is no more output.
std::string LineProcess::EndText() {
  siginfo_t info{};
  if (!WaitForEnd(kExitSeconds) ||
      ::waitid(P_PID, static_cast<id_t>(pid_), &info, WEXITED | WNOHANG | WNOWAIT) != 0) {
    return "the robot's program closed its standard output";
  }
  const std::string status = std::to_string(info.si_status);
  if (info.si_code == CLD_EXITED) return "the robot's program exited with status " + status;
  return "the robot's program was killed by signal " + status + " (" + strsignal(info.si_status) +
         ")";
}

void LineProcess::Close() noexcept {
  if (pid_ < 0) return;
  CloseDescriptor(&to_);
  if (!WaitForEnd(kCloseSeconds)) {
    ::kill(-pid_, SIGTERM);
    WaitForEnd(kTerminateSeconds);
  }
  ::kill(-pid_, SIGKILL);  // what it started and left behind goes, too
  while (::waitpid(pid_, nullptr, 0) < 0 && errno == EINTR) {
  }
  pid_ = -1;
  CloseDescriptor(&from_);
}

}  // namespace downpour
