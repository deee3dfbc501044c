// SPDX-License-Identifier: Apache-2.0
#include "tools/downpour/study_runner.h"

#include <fmt/format.h>
#include <omp.h>
#include <poll.h>
#include <unistd.h>

#include <algorithm>
#include <cstdio>
#include <fstream>
#include <map>
#include <stdexcept>
#include <thread>
#include <utility>

#include "engine/errors.h"
#include "engine/learner/run_directory.h"
#include "tools/downpour/stop.h"

namespace downpour {
namespace {

namespace fs = std::filesystem;

constexpr int kPollMilliseconds = 100;
constexpr int kRanksPollMilliseconds = 10;
constexpr std::chrono::milliseconds kLivePeriod(500);
// A process that was killed may take so long to let go of its run.
constexpr std::chrono::seconds kLockPatience(10);

fs::path Made(const fs::path& directory) {
  std::error_code error;
  fs::create_directories(directory, error);
  if (error) throw FileError(directory.string() + ": cannot create: " + error.message());
  return directory;
}

std::optional<DirectoryLock> StudyLock(const fs::path& directory, const std::string& database,
                                       const StudyShare& share) {
  Made(directory);
  if (share.count > 1) return std::nullopt;
  try {
    return DirectoryLock(directory);
  } catch (const InvalidInput&) {
    throw InvalidInput(fmt::format(
        "{}: another downpour study is writing it: wait for its end, or stop it", database));
  }
}

// Returns when no process has the run any more; after a while in any case.
void WaitForRun(const fs::path& directory) {
  const auto deadline = std::chrono::steady_clock::now() + kLockPatience;
  while (std::chrono::steady_clock::now() < deadline) {
    try {
      const DirectoryLock lock(directory);
      return;
    } catch (const InvalidInput&) {
      std::this_thread::sleep_for(std::chrono::milliseconds(20));
    }
  }
}

bool IsRun(const fs::path& directory) { return fs::exists(directory / "config.toml"); }

ResolvedRun ReadSettings(const fs::path& directory) {
  return ResolveConfig(ReadConfigFile((directory / "config.toml").string()));
}

// Throws InvalidInput if the run in a directory is not the study's.
void CheckSameSettings(const fs::path& directory, const StudyVariant& variant) {
  const auto settings = ResultSettings(ReadSettings(directory).config);
  for (const auto& [key, value] : ResultSettings(variant.config)) {
    const auto was = settings.find(key);
    if (was != settings.end() && was->second == value) continue;
    throw InvalidInput(fmt::format(
        "{}: variant {} on {}: {} is {}, but {} was run with {}; must be as it was, or remove that "
        "directory",
        variant.origin, variant.name, variant.task, key, value, directory.string(),
        was == settings.end() ? "another" : was->second));
  }
}

std::string LastLine(const fs::path& path) {
  std::ifstream file(path);
  std::string last;
  for (std::string line; std::getline(file, line);) {
    if (!line.empty()) last = line;
  }
  constexpr std::string_view kName = "downpour: ";
  return last.starts_with(kName) ? last.substr(kName.size()) : last;
}

std::string Name(const StudyRun& run) {
  return fmt::format("{}, {}, seed {}", run.variant->task, run.variant->name, run.seed);
}

std::string DurationText(double seconds) {
  if (seconds < 99.5) return fmt::format("{:.0f} s", seconds);
  if (seconds < 99.5 * 60) return fmt::format("{:.0f} min", seconds / 60);
  return fmt::format("{:.1f} h", seconds / 3600);
}

// Round after round of one seed of every variant, so that what there is can be compared at any time
// and the time that is left be told.
std::vector<StudyRun> Order(const Study& study) {
  int most = 0;
  for (const StudyVariant& variant : study.variants) most = std::max(most, variant.replicates);
  std::vector<StudyRun> runs;
  for (int i = 0; i < most; ++i) {
    for (const StudyVariant& variant : study.variants) {
      if (i < variant.replicates) {
        runs.push_back({&variant, study.first_seed + static_cast<std::uint64_t>(i)});
      }
    }
  }
  return runs;
}

}  // namespace

StudyRunner::StudyRunner(std::string program, Study study, const std::string& database,
                         const fs::path& runs, const StudyShare& share, MpiWorld* world)
    : program_(std::move(program)),
      study_(std::move(study)),
      directory_(runs),
      lock_(StudyLock(runs, database, share)),
      database_(share.count == 1 ? database : ":memory:"),
      ranks_(world),
      terminal_(isatty(STDERR_FILENO) != 0) {
  database_.Put(study_);
  const std::vector<StudyRun> runs_in_order = Order(study_);
  for (std::size_t i = share.index - 1; i < runs_in_order.size(); i += share.count) {
    runs_.push_back({runs_in_order[i]});
  }
  const int cores = omp_get_num_procs();
  jobs_ = std::clamp(study_.jobs > 0 ? study_.jobs : cores, 1, std::max(1, n_runs()));
  threads_ = study_.threads > 0 ? study_.threads : std::max(1, cores / jobs_);
  for (Replicate& replicate : runs_) {
    const StudyDatabase::Progress progress = database_.ReadProgress(replicate.run);
    replicate.episodes = progress.episodes;
    replicate.solved_episode = progress.solved_episode;
    const fs::path path = Directory(replicate.run);
    if (!Finished(replicate) && IsRun(path)) {
      CheckSameSettings(path, *replicate.run.variant);
      CatchUp(&replicate);
    }
    n_finished_ += Finished(replicate);
    if (!Finished(replicate) && !replicate.failed) waiting_.push_back(&replicate);
  }
  n_episodes_ = 0;
}

bool StudyRunner::Finished(const Replicate& replicate) const {
  const LearnerOptions& options = replicate.run.variant->config.learner;
  return replicate.episodes >= options.episodes ||
         (options.until_solved && replicate.solved_episode > 0);
}

int StudyRunner::Threads(const StudyVariant& variant) const {
  const bool own = std::any_of(variant.settings.begin(), variant.settings.end(),
                               [](const Setting& s) { return s.key == "learn.threads"; });
  return own ? variant.config.learner.threads : threads_;
}

fs::path StudyRunner::Directory(const StudyRun& run) const {
  return directory_ / run.variant->task / run.variant->name / std::to_string(run.seed);
}

LearnerState StudyRunner::ReadRun(const StudyRun& run, int* threads) const {
  const fs::path path = Directory(run);
  const ResolvedRun resolved = ReadSettings(path);
  *threads = resolved.config.learner.threads;
  if (*threads == 0) *threads = omp_get_num_procs();
  return RunDirectory::Open(path).ReadState(resolved.task, resolved.config.learner);
}

// Takes the episodes that the run directory has into the database.
void StudyRunner::CatchUp(Replicate* replicate) {
  if (!IsRun(Directory(replicate->run))) return;
  int threads = 0;
  LearnerState state;
  try {
    state = ReadRun(replicate->run, &threads);
  } catch (const InvalidInput& error) {
    return Fail(replicate, error.what());
  } catch (const FileError& error) {
    return Fail(replicate, error.what());
  }
  const int n = static_cast<int>(state.episodes.size());
  if (n <= replicate->episodes) return;
  database_.Add(replicate->run, state.episodes, threads, jobs_);
  n_episodes_ += n - replicate->episodes;
  replicate->episodes = n;
  replicate->solved_episode = 0;
  replicate->best_return = state.episodes.front().real_return;
  for (const EpisodeRecord& e : state.episodes) {
    if (e.solved && replicate->solved_episode == 0) replicate->solved_episode = e.episode;
    replicate->best_return = std::max(replicate->best_return, e.real_return);
  }
}

void StudyRunner::Fail(Replicate* replicate, const std::string& reason) {
  replicate->failed = true;
  failures_.push_back(Name(replicate->run) + ": " + reason);
  ClearLine();
  fmt::print(stderr, "{}\n", failures_.back());
}

// The command line that goes on with a run, or begins it, in a directory.
std::vector<std::string> StudyRunner::Words(const StudyRun& run,
                                            const std::string& directory) const {
  const StudyVariant& variant = *run.variant;
  const std::string episodes = std::to_string(variant.config.learner.episodes);
  std::vector<std::string> words = {program_, "learn"};
  if (IsRun(Directory(run))) {
    words.insert(words.end(), {"--resume", directory});
  } else {
    words.push_back(std::get<std::string>(variant.settings.front().value));
    words.insert(words.end(), {"--out", directory, "--seed", std::to_string(run.seed)});
    for (std::size_t i = 1; i < variant.settings.size(); ++i) {
      words.insert(words.end(), {"--set", Assignment(variant.settings[i])});
    }
  }
  words.insert(words.end(), {"--episodes", episodes, "--threads", std::to_string(Threads(variant)),
                             "--json", "--quiet"});
  return words;
}

// The rank with the fewest runs; -1 if all have enough.
int StudyRunner::FreeRank() const {
  const auto active = [this](int rank) {
    return std::count_if(active_.begin(), active_.end(),
                         [=](const Active& a) { return a.rank == rank; });
  };
  int least = 0;
  for (const int rank : ranks_.Helpers()) {
    if (active(rank) < active(least)) least = rank;
  }
  return active(least) < jobs_ ? least : -1;
}

void StudyRunner::Start(Replicate* replicate, int rank) {
  const fs::path path = Directory(replicate->run);
  Made(path.parent_path());
  if (IsRun(path)) WaitForRun(path);
  const fs::path log = path.string() + ".log";
  if (rank > 0) {
    ranks_.Start(rank, static_cast<int>(replicate - runs_.data()),
                 Words(replicate->run, kRunDirectoryWord), path, log);
    active_.push_back({replicate, rank, std::nullopt});
  } else {
    active_.push_back(
        {replicate, rank, RunProcess(Words(replicate->run, path.string()), log.string())});
  }
}

// Its process has said that an episode is finished, or has ended.
void StudyRunner::Follow(Active* active) {
  RunProcess& process = *active->process;
  if (process.ReadLines() == 0 && !process.ended()) return;
  CatchUp(active->replicate);
  if (process.ended()) End(active->replicate, process.EndText());
}

// The same of a run of another rank.
void StudyRunner::Follow(const StudyRanks::News& news) {
  Replicate* const replicate = &runs_[news.run];
  CatchUp(replicate);
  if (!news.ended) return;
  active_.erase(std::find_if(active_.begin(), active_.end(),
                             [&](const Active& a) { return a.replicate == replicate; }));
  if (!news.lost || Finished(*replicate)) return End(replicate, news.end_text);
  ClearLine();
  fmt::print(stderr, "{}: {}; it goes on elsewhere\n", Name(replicate->run), news.end_text);
  waiting_.push_back(replicate);
}

void StudyRunner::End(Replicate* ended, const std::string& end_text) {
  Replicate& replicate = *ended;
  const fs::path log = Directory(replicate.run).string() + ".log";
  if (Finished(replicate)) {
    ++n_finished_;
    fs::remove(log);
    const std::string solved = replicate.solved_episode == 0
                                   ? "not solved"
                                   : fmt::format("solved at episode {}", replicate.solved_episode);
    ClearLine();
    fmt::print("{}: {}, best return {:.2f}, {} episodes\n", Name(replicate.run), solved,
               replicate.best_return, replicate.episodes);
    if (std::fflush(stdout) != 0) throw FileError("standard output: cannot write");
  } else if (!StopRequested() && !replicate.failed) {
    const std::string said = LastLine(log);
    Fail(&replicate, end_text + (said.empty() ? "" : ": " + said));
  }
}

// For output, for at most kPollMilliseconds.
void StudyRunner::Wait() {
  std::vector<pollfd> descriptors;
  for (const Active& active : active_) {
    descriptors.push_back({active.process ? active.process->output() : -1, POLLIN, 0});
  }
  // Nobody wakes us for what other ranks send.
  const int milliseconds = ranks_.Helpers().empty() ? kPollMilliseconds : kRanksPollMilliseconds;
  if (poll(descriptors.data(), descriptors.size(), milliseconds) > 0) {
    auto active = active_.begin();
    for (const pollfd& descriptor : descriptors) {
      if (descriptor.revents != 0) Follow(&*active);
      ++active;
    }
    active_.remove_if([](const Active& a) { return a.process && a.process->ended(); });
  }
  for (const StudyRanks::News& news : ranks_.Poll()) Follow(news);
}

// Starts what ranks have room for.
void StudyRunner::Fill() {
  for (int rank = 0; !waiting_.empty() && !StopRequested() && (rank = FreeRank()) >= 0;) {
    Start(waiting_.front(), rank);
    waiting_.pop_front();
  }
}

bool StudyRunner::Run() {
  start_ = last_shown_ = Clock::now();
  bool terminated = false;
  while (true) {
    Fill();
    if (active_.empty()) break;
    if (StopRequested() && !std::exchange(terminated, true)) {
      for (Active& active : active_) {
        if (active.process) active.process->Terminate();
      }
      ranks_.Terminate();
    }
    Wait();
    Show();
  }
  ClearLine();
  if (StopRequested()) return false;
  if (failures_.empty()) return true;
  throw std::runtime_error(
      fmt::format("{} of {} runs failed, the first: {}; the same command goes on with them",
                  failures_.size(), n_runs(), failures_.front()));
}

// Runs that end once they have solved the task are expected to take as long as those of their
// variant did.
double StudyRunner::EpisodesLeft() const {
  struct Tally {
    double finished = 0;
    double episodes = 0;
  };
  std::map<const StudyVariant*, Tally> tallies;
  for (const Replicate& replicate : runs_) {
    if (!Finished(replicate)) continue;
    tallies[replicate.run.variant].finished += 1;
    tallies[replicate.run.variant].episodes += replicate.episodes;
  }
  double left = 0;
  for (const Replicate& replicate : runs_) {
    if (Finished(replicate)) continue;
    const Tally& tally = tallies[replicate.run.variant];
    const double expected = tally.finished > 0 ? tally.episodes / tally.finished
                                               : replicate.run.variant->config.learner.episodes;
    left += std::max(1.0, expected - replicate.episodes);
  }
  return left;
}

// The live line of a terminal.
void StudyRunner::Show() {
  if (!terminal_ || Clock::now() - last_shown_ < kLivePeriod) return;
  last_shown_ = Clock::now();
  const double elapsed = std::chrono::duration<double>(last_shown_ - start_).count();
  std::string text = fmt::format("{} of {} runs finished, {} running, {} so far", n_finished_,
                                 n_runs(), active_.size(), DurationText(elapsed));
  if (n_episodes_ > 0) {
    text += fmt::format(", about {} left", DurationText(elapsed / n_episodes_ * EpisodesLeft()));
  }
  if (!failures_.empty()) text += fmt::format(", {} failed", failures_.size());
  fmt::print(stderr, "\r\x1b[K{}", text);
  std::fflush(stderr);
  live_ = true;
}

void StudyRunner::ClearLine() {
  if (!std::exchange(live_, false)) return;
  fmt::print(stderr, "\r\x1b[K");
  std::fflush(stderr);
}

}  // namespace downpour
