// SPDX-License-Identifier: Apache-2.0
#include "engine/robot/line_process.h"

#include <doctest/doctest.h>
#include <signal.h>
#include <sys/types.h>

#include <chrono>
#include <fstream>
#include <functional>
#include <string>
#include <thread>

#include "engine/errors.h"

namespace downpour {
namespace {

constexpr double kSoon = 0.1;   // s, for what is to time out
constexpr double kEnough = 60;  // s, for what is not

double Seconds(const std::function<void()>& action) {
  const auto start = std::chrono::steady_clock::now();
  action();
  return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
}

std::string FailureOf(const std::function<void()>& action) {
  try {
    action();
  } catch (const SystemFailure& failure) {
    return failure.what();
  }
  return "";
}

// False for a zombie, too: an orphan is one until its new parent takes notice.
bool Runs(pid_t pid) {
  std::ifstream file("/proc/" + std::to_string(pid) + "/stat");
  std::string text;
  std::getline(file, text);
  const std::size_t name_end = text.rfind(')');
  return name_end != std::string::npos && text[name_end + 2] != 'Z' && text[name_end + 2] != 'X';
}

// A signal takes a moment.
bool EndsSoon(pid_t pid) {
  for (int i = 0; i < 5000 && Runs(pid); ++i) {
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
  return !Runs(pid);
}

LineProcess Shell(const std::string& script) { return LineProcess({"sh", "-c", script}, nullptr); }

// Why the output of a shell script ends.
std::string EndOf(const std::string& script) {
  LineProcess process = Shell(script);
  return FailureOf([&] { process.ReadLine(kEnough); });
}

TEST_CASE("line process: lines go there and back whole, however they are cut into pieces") {
  LineProcess process({"cat"}, nullptr);
  const std::string longest(1 << 19, 'x');  // more than a pipe holds
  for (const std::string& line : {std::string("a"), std::string(), std::string("b c")}) {
    process.WriteLine(line, kEnough);
    CHECK(process.ReadLine(kEnough) == line);
  }
  process.WriteLine("one\ntwo", kEnough);
  CHECK(process.ReadLine(kEnough) == "one");
  CHECK(process.HasOutput());
  CHECK(process.ReadLine(kEnough) == "two");
  CHECK_FALSE(process.HasOutput());
  LineProcess speaker = Shell(
      "printf 'pie'; sleep 0.05; printf 'ces\\n'; head -c 524288 /dev/zero |"
      " tr '\\0' x; echo");
  CHECK(speaker.ReadLine(kEnough) == "pieces");
  CHECK(speaker.ReadLine(kEnough) == longest);
}

TEST_CASE("line process: arguments reach the program as they are") {
  LineProcess process({"printf", "%s|%s|%s|%s\\n", "a b", "$HOME", "", "`id`;"}, nullptr);
  CHECK(process.ReadLine(kEnough) == "a b|$HOME||`id`;");
}

TEST_CASE("line process: a program that cannot be started is named") {
  try {
    LineProcess process({"/no/such/program", "x"}, nullptr);
    FAIL("was started");
  } catch (const InvalidInput& error) {
    CHECK(std::string(error.what()) == "cannot start /no/such/program: No such file or directory");
  }
}

TEST_CASE("line process: the end of the output tells how the program ended") {
  CHECK(EndOf("exit 7") == "the robot's program exited with status 7");
  CHECK(EndOf("kill -9 $$") == "the robot's program was killed by signal 9 (Killed)");
  CHECK(EndOf("exec >&-; cat >/dev/null") == "the robot's program closed its standard output");
  CHECK(EndOf("sleep 100 & exit 4") == "the robot's program exited with status 4");
  CHECK(EndOf("head -c 2000000 /dev/zero") == "the robot's program sent a line of more than 1 MiB");
}

TEST_CASE("line process: no answer in time is a failure, and so is nobody who reads") {
  LineProcess silent = Shell("printf 'a part'; exec cat");
  CHECK(FailureOf([&] { silent.ReadLine(0.5); }) ==
        "the robot's program gave only a part of a line within 0.5 s");
  LineProcess deaf({"sleep", "60"}, nullptr);
  CHECK(FailureOf([&] { deaf.ReadLine(kSoon); }) ==
        "the robot's program gave no answer within 0.1 s");
  CHECK(FailureOf([&] { deaf.WriteLine(std::string(1 << 20, 'x'), kSoon); }) ==
        "the robot's program read nothing for 0.1 s");
}

TEST_CASE("line process: writing to a program that has ended raises no signal and no error") {
  LineProcess process = Shell("echo last words; exit 2");
  CHECK(process.ReadLine(kEnough) == "last words");
  for (int i = 0; i < 100; ++i) {
    process.WriteLine("anybody there?", kEnough);
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
  CHECK(FailureOf([&] { process.ReadLine(kEnough); }) ==
        "the robot's program exited with status 2");
}

TEST_CASE("line process: a request to stop ends a wait") {
  std::atomic<bool> stop{false};
  LineProcess process({"cat"}, &stop);
  std::thread later([&] {
    std::this_thread::sleep_for(std::chrono::milliseconds(20));
    stop = true;
  });
  CHECK_THROWS_AS(process.ReadLine(kEnough), Interrupted);
  later.join();
}

TEST_CASE("line process: a program that goes when its input ends is not signalled") {
  const double seconds = Seconds([&] {
    LineProcess process = Shell("trap 'exit 1' TERM; echo ready; cat >/dev/null");
    CHECK(process.ReadLine(kEnough) == "ready");
    process.Close();
    process.Close();  // does nothing
  });
  CHECK(seconds < 2);  // SIGTERM comes after 2 s
}

TEST_CASE("line process: nothing is left of a program that goes for no signal but SIGKILL") {
  LineProcess process =
      Shell("trap '' TERM; (trap '' TERM; sleep 60 & echo $! $$; wait) & wait; sleep 60");
  const std::string numbers = process.ReadLine(kEnough);
  const pid_t child = std::stoi(numbers);
  const pid_t parent = std::stoi(numbers.substr(numbers.find(' ')));
  CHECK(Runs(child));
  CHECK(Runs(parent));
  CHECK(Seconds([&] { process.Close(); }) > 2.9);
  CHECK(::kill(parent, 0) != 0);  // not even a zombie
  CHECK(EndsSoon(child));
}

TEST_CASE("line process: what a program leaves behind in its group ends with it") {
  LineProcess process = Shell("sleep 60 & echo $!; exit 0");
  const pid_t child = std::stoi(process.ReadLine(kEnough));
  CHECK(Runs(child));
  process.Close();
  CHECK(EndsSoon(child));
}

}  // namespace
}  // namespace downpour
