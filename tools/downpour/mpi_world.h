// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <optional>
#include <string>

namespace downpour {

struct MpiMessage {
  int rank = 0;  // who sent it
  std::string bytes;
};

// The processes that mpirun started together; a world of one if it did not start this process.
// Rank 0 leads, the others help: messages go between rank 0 and a helper, and those of one sender
// arrive in order. One object a process, for the main thread. Processes that we start are not of
// this world.
class MpiWorld {
 public:
  // `command` is what runs, "learn". Throws InvalidInput if there are other processes and the
  // program was built without MPI.
  explicit MpiWorld(const char* command);
  // Rank 0 tells the helpers to end, and waits for those that it has not given up.
  ~MpiWorld();
  MpiWorld(const MpiWorld&) = delete;
  MpiWorld& operator=(const MpiWorld&) = delete;

  int rank() const { return rank_; }
  int size() const { return size_; }

  // Does not wait until it has arrived.
  void Send(int rank, std::string bytes);
  // The next message that is there, if any. Does not wait.
  std::optional<MpiMessage> Poll();
  // Of a helper: rank 0 has told it to end.
  bool ended() const { return ended_; }
  // Rank 0 does not wait for this one any more.
  void GiveUp(int rank);

 private:
  struct State;
  State* state_ = nullptr;  // none in a world of one
  int rank_ = 0;
  int size_ = 1;
  bool ended_ = false;
};

// Whether an error is this process's to tell: of those that mpirun started with one command line,
// the first does.
bool TellsCommandLineErrors();

}  // namespace downpour
