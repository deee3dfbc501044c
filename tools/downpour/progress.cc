// SPDX-License-Identifier: Apache-2.0
#include "tools/downpour/progress.h"

#include <fmt/format.h>
#include <sys/ioctl.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <nlohmann/json.hpp>

#include "engine/errors.h"

namespace downpour {
namespace {

constexpr std::chrono::milliseconds kLivePeriod(100);
constexpr std::chrono::seconds kPlainPeriod(5);
constexpr const char* kRow = "{:>7} {:>7} {:>6} {:>6} {:>6} {:>9} {:>10} {:>8} {:>9} {:>6} {:>6}\n";

double Seconds(std::chrono::steady_clock::duration duration) {
  return std::chrono::duration<double>(duration).count();
}

// Three digits or so: "0.12 s", "9.3 s", "127 s".
std::string SecondsText(double seconds) {
  return fmt::format("{:.{}f} s", seconds, seconds < 1 ? 2 : seconds < 100 ? 1 : 0);
}

// "19.2 M", "981 k"
std::string CountText(double count) {
  const char* unit = "";
  for (const char* next : {" k", " M", " G", " T"}) {
    if (count < 1000) break;
    count /= 1000;
    unit = next;
  }
  return fmt::format("{:.{}f}{}", count, count < 100 && *unit != 0 ? 1 : 0, unit);
}

// "120,032"
std::string Thousands(std::int64_t n) {
  if (n < 1000) return fmt::format("{}", n);
  return fmt::format("{},{:03}", Thousands(n / 1000), n % 1000);
}

std::string JsonLine(const EpisodeRecord& record) {
  nlohmann::ordered_json line;
  line["episode"] = record.episode;
  line["interaction_seconds"] = record.interaction_seconds;
  line["points"] = record.points;
  line["model_seconds"] = record.model_seconds;
  line["search_seconds"] = record.search_seconds;
  line["evaluations"] = record.evaluations;
  line["gp_queries"] = record.gp_queries;
  line["predicted_return"] = nullptr;
  if (!record.random) line["predicted_return"] = record.predicted_return;
  line["return"] = record.real_return;
  line["solved"] = record.solved;
  return line.dump() + "\n";
}

std::string TableHeader() {
  return fmt::format(kRow, "episode", "robot", "points", "model", "search", "rollouts",
                     "GP queries", "rate", "predicted", "return", "solved");
}

std::string TableRow(const EpisodeRecord& record) {
  const std::string interaction = fmt::format("{:.1f} s", record.interaction_seconds);
  const std::string real_return = fmt::format("{:.2f}", record.real_return);
  const char* solved = record.solved ? "yes" : "no";
  if (record.random) {
    return fmt::format(kRow, record.episode, interaction, "-", "-", "-", "-", "-", "-", "random",
                       real_return, solved);
  }
  const double rate = static_cast<double>(record.gp_queries) / record.search_seconds;
  return fmt::format(kRow, record.episode, interaction, record.points,
                     SecondsText(record.model_seconds), SecondsText(record.search_seconds),
                     Thousands(record.evaluations),
                     CountText(static_cast<double>(record.gp_queries)), CountText(rate) + "/s",
                     fmt::format("{:.2f}", record.predicted_return), real_return, solved);
}

// One line that names the outputs whose K took jitter; "" if there are none.
std::string JitterText(const Task& task, const EpisodeRecord& record) {
  std::string outputs;
  for (std::size_t e = 0; e < record.jitter.size(); ++e) {
    if (record.jitter[e] == 0) continue;
    outputs += fmt::format("{}{} ({:.1g})", outputs.empty() ? "" : ", ", task.states[e].name,
                           record.jitter[e]);
  }
  if (outputs.empty()) return "";
  return fmt::format("episode {}: the model needed jitter, as a share of the signal variance: {}",
                     record.episode, outputs);
}

// One line that tells how the rollouts queried each output; "" for a random episode.
std::string PlanText(const Task& task, const EpisodeRecord& record) {
  std::string outputs;
  for (std::size_t e = 0; e < record.plans.size(); ++e) {
    const PlanRecord& plan = record.plans[e];
    outputs += fmt::format("{}{} {} {}", outputs.empty() ? "" : ", ", task.states[e].name,
                           plan.points, plan.single_precision ? "fp32" : "fp64");
  }
  if (outputs.empty()) return "";
  return fmt::format("episode {}: queried with so many of {} points: {}", record.episode,
                     record.points, outputs);
}

// "solved at episode 4", "not solved".
std::string Outcome(const LearnerState& state) {
  for (const EpisodeRecord& record : state.episodes) {
    if (record.solved) return fmt::format("solved at episode {}", record.episode);
  }
  return fmt::format("not solved in {} episode{}", state.episodes.size(),
                     state.episodes.size() == 1 ? "" : "s");
}

// Progress that nobody can read is no reason to stop a run.
void WriteError(const std::string& text) { std::fputs(text.c_str(), stderr); }

void WriteOutput(const std::string& text) {
  if (std::fputs(text.c_str(), stdout) < 0 || std::fflush(stdout) != 0) {
    throw FileError(std::string("standard output: cannot write: ") + std::strerror(errno));
  }
}

int TerminalWidth() {
  winsize size{};
  if (ioctl(STDERR_FILENO, TIOCGWINSZ, &size) != 0 || size.ws_col == 0) return 80;
  return size.ws_col;
}

}  // namespace

Progress::Progress(const RunConfig& config)
    : quiet_(config.quiet), json_(config.json), terminal_(isatty(STDERR_FILENO) != 0) {}

Progress::~Progress() { ClearLive(); }

void Progress::Line(const std::string& text) {
  if (quiet_) return;
  ClearLive();
  WriteError(text + "\n");
}

void Progress::Live(const std::string& text) {
  if (quiet_) return;
  // A line that wraps could not be replaced, nor one that the terminal adds "^C" to.
  const std::size_t width = static_cast<std::size_t>(std::max(TerminalWidth() - 3, 1));
  WriteError(fmt::format("\r{}\x1b[K", text.substr(0, width)));
  live_ = true;
}

void Progress::Step(const std::string& text) {
  if (terminal_) {
    Live(text);
  } else {
    Line(text);
  }
}

void Progress::ClearLive() {
  if (!live_) return;
  WriteError("\r\x1b[K");
  live_ = false;
}

void Progress::Start(const Learner& learner, const std::string& directory) {
  const Task& task = learner.task();
  const std::size_t n_done = learner.state().episodes.size();
  Line(fmt::format(
      "{} ({} preset), seed {}, {} into {}", task.name, task.preset, learner.options().seed,
      n_done == 0 ? std::string("learning") : fmt::format("going on after episode {},", n_done),
      directory));
  if (quiet_ || json_ || learner.done()) return;
  WriteOutput(TableHeader());
}

void Progress::Phase(const Learner& learner, const std::string& phase) {
  episode_ = static_cast<int>(learner.state().episodes.size()) + 1;
  search_start_ = last_search_ = Clock::now();
  if (phase == "model") {
    Step(fmt::format("episode {}: learning the model from {} points", episode_,
                     learner.state().transitions.size()));
  } else if (phase == "search") {
    Step(fmt::format("episode {}: searching for a policy", episode_));
  } else if (terminal_) {
    Live(fmt::format("episode {}: running on the system", episode_));
  }
}

void Progress::Search(const PolicySearchProgress& progress) {
  const Clock::time_point now = Clock::now();
  const bool due =
      terminal_ ? now - last_search_ >= kLivePeriod : now - last_search_ >= kPlainPeriod;
  if (quiet_ || !due) return;
  last_search_ = now;
  const double share = std::min(
      1.0, static_cast<double>(progress.evaluations) / static_cast<double>(progress.budget));
  const double eta = Seconds(now - search_start_) * (1 - share) / std::max(share, 1e-6);
  const std::string figures =
      fmt::format("{}/{} evaluations  run {}  best {:.2f}  mean {:.2f}  {:.0f} s left",
                  Thousands(progress.evaluations), Thousands(progress.budget),
                  progress.runs_started, progress.best_return, progress.mean_return, eta);
  const std::string start = fmt::format("episode {}: search", episode_);
  if (!terminal_) return Line(fmt::format("{} {:.0f} %  {}", start, 100 * share, figures));
  // The bar takes what room the figures leave.
  const int room = TerminalWidth() - static_cast<int>(start.size() + figures.size()) - 12;
  const int width = std::clamp(room, 0, 24);
  const int filled = static_cast<int>(std::lround(share * width));
  const std::string bar = width < 4 ? ""
                                    : fmt::format("[{}{}] ", std::string(filled, '#'),
                                                  std::string(width - filled, '.'));
  Live(fmt::format("{} {}{:3.0f} %  {}", start, bar, 100 * share, figures));
}

void Progress::Episode(const Task& task, const EpisodeRecord& record) {
  ClearLive();
  const std::string jitter = JitterText(task, record);
  if (!jitter.empty()) Line(jitter);
  const std::string plan = PlanText(task, record);
  if (!plan.empty()) Line(plan);
  if (quiet_ && !json_) return;
  WriteOutput(json_ ? JsonLine(record) : TableRow(record));
}

void Progress::Finish(const Learner& learner, const std::string& directory) {
  const std::vector<EpisodeRecord>& episodes = learner.state().episodes;
  const auto best =
      std::max_element(episodes.begin(), episodes.end(),
                       [](const auto& a, const auto& b) { return a.real_return < b.real_return; });
  Line(fmt::format("{}: {}, best return {:.2f} at episode {}; files in {}", learner.task().name,
                   Outcome(learner.state()), best->real_return, best->episode, directory));
}

}  // namespace downpour
