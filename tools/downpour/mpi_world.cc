// SPDX-License-Identifier: Apache-2.0
#include "tools/downpour/mpi_world.h"

#include <fmt/format.h>
// C only.
#define OMPI_SKIP_MPICXX
#define MPICH_SKIP_MPICXX
#include <mpi.h>
#include <unistd.h>

#include <chrono>
#include <csignal>
#include <list>
#include <stdexcept>
#include <utility>
#include <vector>

#include "tools/downpour/mpi_launch.h"
#include "tools/downpour/pause.h"
#include "tools/downpour/stop.h"

namespace downpour {
namespace {

enum Tag { kData, kEnd, kBye };

// How long rank 0 waits for the helpers' ends, and all for MPI's; mpirun gives a second to a job
// that it ends.
constexpr std::chrono::milliseconds kPatience(20000), kStoppedPatience(300);

void Check(int code, const char* what) {
  if (code == MPI_SUCCESS) return;
  char text[MPI_MAX_ERROR_STRING];
  int length = 0;
  MPI_Error_string(code, text, &length);
  throw std::runtime_error(fmt::format("MPI cannot {}: {}", what, std::string(text, length)));
}

}  // namespace

struct MpiWorld::State {
  struct Outgoing {
    MPI_Request request;
    std::string bytes;
  };
  struct Incoming {
    MPI_Request request;
    int tag;
    MpiMessage message;
  };
  std::list<Outgoing> outgoing;
  std::list<Incoming> incoming;  // as they came
  std::vector<bool> gone;        // said bye, or given up
  bool complete = true;          // nobody was given up

  // Lets go of what has been sent.
  void Reap() {
    outgoing.remove_if([](Outgoing& message) {
      int sent = 0;
      return MPI_Test(&message.request, &sent, MPI_STATUS_IGNORE) != MPI_SUCCESS || sent != 0;
    });
  }
  void Send(int rank, Tag tag, std::string bytes) {
    Reap();
    Outgoing& message = outgoing.emplace_back(Outgoing{MPI_REQUEST_NULL, std::move(bytes)});
    Check(MPI_Isend(message.bytes.data(), static_cast<int>(message.bytes.size()), MPI_BYTE, rank,
                    tag, MPI_COMM_WORLD, &message.request),
          "send");
  }
  // Not all at once: a sender that dies leaves half a message, which must not keep us from others.
  void StartReceiving() {
    for (;;) {
      int there = 0, length = 0;
      MPI_Message handle;
      MPI_Status status;
      Check(MPI_Improbe(MPI_ANY_SOURCE, MPI_ANY_TAG, MPI_COMM_WORLD, &there, &handle, &status),
            "receive");
      if (there == 0) return;
      MPI_Get_count(&status, MPI_BYTE, &length);
      Incoming& next = incoming.emplace_back(
          Incoming{MPI_REQUEST_NULL, status.MPI_TAG, {status.MPI_SOURCE, std::string(length, 0)}});
      Check(MPI_Imrecv(next.message.bytes.data(), length, MPI_BYTE, &handle, &next.request),
            "receive");
    }
  }
  // The first message that is whole, after all earlier ones of its sender.
  std::optional<Incoming> NextReceived() {
    std::vector<bool> waits(gone.size(), false);
    for (auto each = incoming.begin(); each != incoming.end(); ++each) {
      const int rank = each->message.rank;
      int whole = 0;
      if (!waits[rank]) Check(MPI_Test(&each->request, &whole, MPI_STATUS_IGNORE), "receive");
      waits[rank] = true;
      if (whole == 0) continue;
      Incoming next = std::move(*each);
      incoming.erase(each);
      return next;
    }
    return std::nullopt;
  }
  bool AllGone() const {
    for (const bool each : gone) {
      if (!each) return false;
    }
    return true;
  }
};

MpiWorld::MpiWorld(const char*) {
  if (LaunchedProcesses() == 1) return;
  int level = 0;
  Check(MPI_Init_thread(nullptr, nullptr, MPI_THREAD_FUNNELED, &level), "start");
  // A helper may get lost; that is not the end of the others.
  MPI_Comm_set_errhandler(MPI_COMM_WORLD, MPI_ERRORS_RETURN);
  MPI_Comm_rank(MPI_COMM_WORLD, &rank_);
  MPI_Comm_size(MPI_COMM_WORLD, &size_);
  state_ = new State;
  state_->gone.assign(size_, false);
  state_->gone[0] = true;
  for (const char* name : kSizeVariables) unsetenv(name);
  if (rank_ == 0) return;
  // What mpirun sends to all when it is interrupted; rank 0 says when the end is.
  std::signal(SIGINT, SIG_IGN);
  std::signal(SIGTERM, SIG_IGN);
}

MpiWorld::~MpiWorld() {
  if (state_ == nullptr) return;
  try {
    // Also those given up: they may live.
    for (int r = 1; rank_ == 0 && r < size_; ++r) {
      state_->Send(r, kEnd, {static_cast<char>(state_->complete)});
    }
    if (rank_ > 0) state_->Send(0, kBye, {});
    const auto start = std::chrono::steady_clock::now();
    Pause pause;
    while (rank_ == 0 ? !state_->AllGone() : !state_->outgoing.empty()) {
      if (Poll()) continue;
      const auto patience = StopRequested() ? kStoppedPatience : kPatience;
      if (std::chrono::steady_clock::now() - start > patience) break;
      pause.Wait();
    }
  } catch (const std::exception&) {  // without a connection there is nobody to say goodbye to
  }
  // It waits for all ranks, also for one that is lost or that an mpirun is ending.
  if (state_->complete && (rank_ > 0 || (state_->AllGone() && !StopRequested()))) {
    alarm(kPatience.count() / 1000);  // the end of this process, if another is lost only now
    MPI_Finalize();
    alarm(0);
  }
  delete state_;
}

void MpiWorld::Send(int rank, std::string bytes) { state_->Send(rank, kData, std::move(bytes)); }

std::optional<MpiMessage> MpiWorld::Poll() {
  if (state_ == nullptr) return std::nullopt;
  state_->Reap();
  state_->StartReceiving();
  while (std::optional<State::Incoming> next = state_->NextReceived()) {
    if (next->tag == kData) return std::move(next->message);
    if (next->tag == kEnd) {
      ended_ = true;
      state_->complete = next->message.bytes.at(0) != 0;
    }
    if (next->tag == kBye) state_->gone[next->message.rank] = true;
  }
  return std::nullopt;
}

void MpiWorld::GiveUp(int rank) {
  state_->gone[rank] = true;
  state_->complete = false;
}

bool TellsCommandLineErrors() { return LaunchedRank() == 0; }

}  // namespace downpour
