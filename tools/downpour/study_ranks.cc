// SPDX-License-Identifier: Apache-2.0
#include "tools/downpour/study_ranks.h"

#include <fmt/format.h>
#include <poll.h>

#include <algorithm>
#include <list>
#include <optional>
#include <utility>

#include "engine/errors.h"
#include "engine/learner/atomic_file.h"
#include "engine/learner/platform.h"
#include "tools/downpour/bytes.h"
#include "tools/downpour/file_tree.h"
#include "tools/downpour/run_process.h"

namespace downpour {
namespace {

namespace fs = std::filesystem;

enum class Order : char { kStart, kTerminate };
enum class Report : char { kAlive, kRun };

constexpr std::chrono::seconds kHeartbeat(1);
constexpr std::chrono::seconds kSilence(10);  // after which a rank is lost
constexpr int kPollMilliseconds = 20;

}  // namespace

StudyRanks::StudyRanks(MpiWorld* world) : world_(world), helpers_(world->size()) {}

std::vector<int> StudyRanks::Helpers() const {
  std::vector<int> ranks;
  for (int rank = 1; rank < world_->size(); ++rank) {
    if (!helpers_[rank].lost) ranks.push_back(rank);
  }
  return ranks;
}

void StudyRanks::Start(int rank, int run, const std::vector<std::string>& words,
                       const fs::path& directory, const fs::path& log) {
  ByteWriter message;
  message.Put(Order::kStart);
  message.Put(run);
  message.Put(words.size());
  for (const std::string& word : words) message.PutAll(word);
  PutFiles(ReadTree(directory), &message);
  world_->Send(rank, message.Take());
  helpers_[rank].runs.push_back({run, directory, log});
}

void StudyRanks::Terminate() {
  for (const int rank : Helpers()) world_->Send(rank, {static_cast<char>(Order::kTerminate)});
}

void StudyRanks::Read(const MpiMessage& message, std::vector<News>* news) {
  Helper& helper = helpers_[message.rank];
  if (helper.lost) return;  // it was given up, and its runs are others' now
  helper.heard = Clock::now();
  ByteReader report(message.bytes);
  if (report.Get<Report>() == Report::kAlive) {
    const std::string simd_target = report.GetText(), mine = CurrentPlatform().simd_target;
    if (simd_target == mine) return;
    throw InvalidInput(fmt::format(
        "rank {} runs on {}, rank 0 on {}: all machines must have the same SIMD target, or results "
        "depend on who learns what",
        message.rank, simd_target, mine));
  }
  News each;
  report.Get(&each.run);
  report.Get(&each.ended);
  each.end_text = report.GetText();
  const std::string said = report.GetText();
  const auto run = std::find_if(helper.runs.begin(), helper.runs.end(),
                                [&](const Run& r) { return r.run == each.run; });
  WriteTree(run->directory, GetFiles(&report));
  if (each.ended) {
    WriteFileAtomically(run->log, said);
    helper.runs.erase(run);
  }
  news->push_back(std::move(each));
}

std::vector<StudyRanks::News> StudyRanks::Poll() {
  std::vector<News> news;
  while (const std::optional<MpiMessage> message = world_->Poll()) Read(*message, &news);
  const Clock::time_point now = Clock::now();
  const bool listened = now - polled_ < kHeartbeat;
  polled_ = now;
  for (const int rank : Helpers()) {
    Helper& helper = helpers_[rank];
    if (!listened) helper.heard = now;  // the silence was ours
    if (now - helper.heard < kSilence) continue;
    helper.lost = true;
    world_->GiveUp(rank);
    for (const Run& run : std::exchange(helper.runs, {})) {
      news.push_back({run.run, true, fmt::format("rank {} is lost", rank), true});
    }
  }
  return news;
}

namespace {

// What a helper learns.
class LocalRuns {
 public:
  explicit LocalRuns(MpiWorld* world) : world_(world) {}

  void Do(const std::string& bytes) {
    ByteReader order(bytes);
    if (order.Get<Order>() == Order::kTerminate) {
      for (Local& local : runs_) local.process.Terminate();
    } else {
      Start(&order);
    }
  }

  // For output, for at most kPollMilliseconds.
  void Wait() {
    std::vector<pollfd> descriptors;
    for (const Local& local : runs_) descriptors.push_back({local.process.output(), POLLIN, 0});
    poll(descriptors.data(), descriptors.size(), kPollMilliseconds);
    auto local = runs_.begin();
    for (const pollfd& descriptor : descriptors) {
      const auto run = local++;
      if (descriptor.revents == 0) continue;
      if (run->process.ReadLines() == 0 && !run->process.ended()) continue;
      Tell(*run);
      if (!run->process.ended()) continue;
      std::error_code error;  // else it goes with the scratch directory
      fs::remove_all(run->directory, error);
      runs_.erase(run);
    }
  }

 private:
  struct Local {
    int run;
    fs::path directory, log;
    RunProcess process;
  };

  void Start(ByteReader* order) {
    const int run = order->Get<int>();
    const fs::path directory = scratch_.path() / std::to_string(run);
    const fs::path log = directory.string() + ".log";
    std::vector<std::string> words(order->Get<std::size_t>());
    for (std::string& word : words) {
      word = order->GetText();
      if (word == kRunDirectoryWord) word = directory.string();
    }
    WriteTree(directory, GetFiles(order));
    runs_.push_back({run, directory, log, RunProcess(words, log.string())});
  }

  void Tell(const Local& local) {
    ByteWriter report;
    report.Put(Report::kRun);
    report.Put(local.run);
    report.Put(local.process.ended());
    report.PutAll(local.process.ended() ? local.process.EndText() : std::string());
    report.PutAll(local.process.ended() ? ReadFile(local.log) : std::string());
    PutFiles(ReadTree(local.directory), &report);
    world_->Send(0, report.Take());
  }

  MpiWorld* world_;
  ScratchDirectory scratch_;
  std::list<Local> runs_;
};

}  // namespace

void HelpWithStudy(MpiWorld* world) {
  LocalRuns runs(world);
  ByteWriter writer;
  writer.Put(Report::kAlive);
  writer.PutAll(CurrentPlatform().simd_target);
  const std::string alive = writer.Take();
  std::optional<std::chrono::steady_clock::time_point> told;
  while (!world->ended()) {
    if (const auto now = std::chrono::steady_clock::now(); !told || now - *told > kHeartbeat) {
      world->Send(0, alive);
      told = now;
    }
    while (const std::optional<MpiMessage> message = world->Poll()) runs.Do(message->bytes);
    runs.Wait();
  }
}

}  // namespace downpour
