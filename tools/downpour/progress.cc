// SPDX-License-Identifier: Apache-2.0
#include "tools/downpour/progress.h"

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <sys/ioctl.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <nlohmann/json.hpp>
#include <vector>

#include "engine/errors.h"
#include "engine/rollout/dynamics_prior.h"

namespace downpour {
namespace {

constexpr std::chrono::milliseconds kLivePeriod(100);
constexpr std::chrono::seconds kPlainPeriod(5);
// 79 columns; the count of GP queries and their rate are under one heading.
constexpr const char* kRow = "{:>7} {:>5} {:>6} {:>5} {:>6} {:>8} {:>12} {:>9} {:>6} {:>6}\n";

double Seconds(std::chrono::steady_clock::duration duration) {
  return std::chrono::duration<double>(duration).count();
}

// Five characters at most: "0.12s", "9.3s", "127s", "2.8h".
std::string SecondsText(double seconds) {
  if (seconds < 9999.5) {
    return fmt::format("{:.{}f}s", seconds, seconds < 0.995 ? 2 : seconds < 99.95 ? 1 : 0);
  }
  const double hours = seconds / 3600;
  return fmt::format("{:.{}f}h", hours, hours < 99.95 ? 1 : 0);
}

// Four characters at most: "9.2M", "981k".
std::string CountText(double count) {
  const char* unit = "";
  for (const char* next : {"k", "M", "G", "T", "P"}) {
    if (count < 999.5) break;
    count /= 1000;
    unit = next;
  }
  return fmt::format("{:.{}f}{}", count, count < 9.95 && *unit != 0 ? 1 : 0, unit);
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
  line["rollout_seconds"] = record.rollout_seconds;
  line["evaluations"] = record.evaluations;
  line["gp_queries"] = record.gp_queries;
  line["rollout_ns_per_gp_query"] = nullptr;
  if (!record.random) line["rollout_ns_per_gp_query"] = RolloutNanosecondsPerQuery(record);
  line["lane_fill"] = nullptr;
  line["idle_share"] = nullptr;
  if (!record.random) {
    line["lane_fill"] = record.lane_fill;
    line["idle_share"] = record.idle_share;
  }
  line["predicted_return"] = nullptr;
  if (!record.random) line["predicted_return"] = record.predicted_return;
  line["return"] = record.real_return;
  line["solved"] = record.solved;
  line["steps"] = record.steps;
  line["outcome"] = record.outcome;
  return line.dump() + "\n";
}

std::string TableHeader(bool pilco) {
  return fmt::format(kRow, "episode", "robot", "points", "model", "search",
                     pilco ? "values" : "rollouts", "GP queries", "predicted", "return", "solved");
}

std::string TableRow(const EpisodeRecord& record) {
  const std::string interaction = SecondsText(record.interaction_seconds);
  const std::string real_return = fmt::format("{:.2f}", record.real_return);
  const char* solved = record.solved ? "yes" : "no";
  if (record.random) {
    return fmt::format(kRow, record.episode, interaction, "-", "-", "-", "-", "-", "random",
                       real_return, solved);
  }
  const double rate = static_cast<double>(record.gp_queries) / record.search_seconds;
  const std::string queries =
      record.gp_queries == 0
          ? "-"
          : fmt::format("{} {:>6}", CountText(static_cast<double>(record.gp_queries)),
                        CountText(rate) + "/s");
  return fmt::format(kRow, record.episode, interaction, record.points,
                     SecondsText(record.model_seconds), SecondsText(record.search_seconds),
                     record.evaluations < 1000000
                         ? Thousands(record.evaluations)
                         : CountText(static_cast<double>(record.evaluations)),
                     queries, fmt::format("{:.2f}", record.predicted_return), real_return, solved);
}

// One line that names the outputs whose K took jitter; "" if there are none.
std::string JitterText(const std::vector<Variable>& outputs, const EpisodeRecord& record) {
  std::string listed;
  for (std::size_t e = 0; e < record.jitter.size(); ++e) {
    if (record.jitter[e] == 0) continue;
    listed +=
        fmt::format("{}{} ({:.1g})", listed.empty() ? "" : ", ", outputs[e].name, record.jitter[e]);
  }
  if (listed.empty()) return "";
  return fmt::format("episode {}: the model needed jitter, as a share of the signal variance: {}",
                     record.episode, listed);
}

// One line that tells with how many points the rollouts queried each output; "" where there were
// none.
std::string PlanText(const EpisodeRecord& record) {
  std::string outputs;
  for (const PlanRecord& plan : record.plans) {
    outputs += fmt::format("{}{} {}", outputs.empty() ? "" : ", ", plan.points,
                           plan.single_precision ? "fp32" : "fp64");
  }
  if (outputs.empty()) return "";
  const bool by_blas = record.plans.front().backend == QueryBackend::kBlas;
  return fmt::format("episode {}: plan {} of {} points{}", record.episode, outputs, record.points,
                     by_blas ? " by OpenBLAS" : "");
}

// One line that tells what became of the task's prior; "" if there is none.
std::string PriorText(const Task& task, const EpisodeRecord& record) {
  if (!record.prior) return "";
  std::string listed;
  for (std::size_t i = 0; i < record.prior->parameters.size(); ++i) {
    const PriorParameter& parameter = task.prior->parameters()[i];
    listed +=
        fmt::format("{} {:.4g}{}{}, ", parameter.name, record.prior->parameters[i],
                    parameter.unit == "1" ? "" : " ", parameter.unit == "1" ? "" : parameter.unit);
  }
  return fmt::format(
      "episode {}: prior {}log likelihood {:.1f} ({} tried); {:.0f} ns a step, {:.0f} % of the "
      "rollouts",
      record.episode, listed, record.prior->log_likelihood, record.prior->evaluations,
      record.prior->step_nanoseconds, 100 * record.prior->search_share);
}

// One line that tells how an episode was cut short; "" for a whole one.
std::string OutcomeText(const Task& task, const EpisodeRecord& record) {
  if (record.outcome == kComplete) return "";
  return fmt::format("episode {}: {} of {} steps, {}", record.episode, record.steps, task.horizon,
                     record.outcome);
}

// One line that tells what the queries cost; "" where there were none.
std::string QueryTimeText(const EpisodeRecord& record) {
  if (record.gp_queries == 0) return "";
  std::string outputs;
  for (const double nanoseconds : record.query_nanoseconds) {
    outputs += fmt::format("{}{:.0f}", outputs.empty() ? "" : ", ", nanoseconds);
  }
  return fmt::format(
      "episode {}: {} GP queries in {} of rollouts, {:.0f} ns each; one thread: {}; lanes {:.1f} % "
      "full, threads {:.1f} % idle",
      record.episode, CountText(static_cast<double>(record.gp_queries)),
      SecondsText(record.rollout_seconds), RolloutNanosecondsPerQuery(record), outputs,
      100 * record.lane_fill, 100 * record.idle_share);
}

// "solved at episode 4", "not solved".
std::string Outcome(const LearnerState& state) {
  for (const EpisodeRecord& record : state.episodes) {
    if (record.solved) return fmt::format("solved at episode {}", record.episode);
  }
  return fmt::format("not solved in {} episode{}", state.episodes.size(),
                     state.episodes.size() == 1 ? "" : "s");
}

// Why a run that is resumed has nothing to do, and what would give it more.
std::string DoneText(const Learner& learner, const std::string& directory) {
  const std::size_t n_episodes = learner.state().episodes.size();
  const bool all_run = n_episodes >= static_cast<std::size_t>(learner.options().episodes);
  return fmt::format("{} already has {} episodes; {}", directory, n_episodes,
                     all_run ? "--episodes M for more" : "--until-solved ended it");
}

// Progress that nobody can read is no reason to stop a run.
void WriteError(const std::string& text) { std::fputs(text.c_str(), stderr); }

void WriteOutput(const std::string& text) {
  if (std::fputs(text.c_str(), stdout) < 0 || std::fflush(stdout) != 0) {
    throw FileError(std::string("standard output: cannot write: ") + std::strerror(errno));
  }
}

// Columns that a live line may take.
std::size_t LiveWidth() {
  winsize size{};
  int width = 80;
  if (ioctl(STDERR_FILENO, TIOCGWINSZ, &size) == 0 && size.ws_col != 0) width = size.ws_col;
  // A line that wraps could not be replaced, nor one that the terminal adds "^C" to.
  return static_cast<std::size_t>(std::max(width - 3, 1));
}

// `left` in any case, then as much as fits of: start, figures (the first ones first), a bar.
std::string FittedLine(const std::string& start, double share, const std::string& left,
                       const std::vector<std::string>& figures, std::size_t width) {
  if (start.size() + left.size() > width) return left.substr(left.find_first_not_of(' '));
  std::string end = left;
  for (const std::string& figure : figures) {
    if (start.size() + end.size() + 2 + figure.size() > width) break;
    end += "  " + figure;
  }
  const std::size_t room = width - start.size() - end.size();
  if (room < 7) return start + end;
  const std::size_t length = std::min<std::size_t>(room - 3, 24);
  const auto filled = static_cast<std::size_t>(std::lround(share * static_cast<double>(length)));
  return fmt::format("{}[{}{}] {}", start, std::string(filled, '#'),
                     std::string(length - filled, '.'), end);
}

}  // namespace

Progress::Progress(const RunConfig& config)
    : robot_(config.system.program),
      quiet_(config.quiet),
      json_(config.json),
      pilco_(config.learner.algorithm == Algorithm::kPilco),
      terminal_(isatty(STDERR_FILENO) != 0) {}

Progress::~Progress() { ClearLive(); }

void Progress::Line(const std::string& text) {
  if (quiet_) return;
  ClearLive();
  WriteError(text + "\n");
}

void Progress::Live(const std::string& text) {
  if (quiet_) return;
  WriteError(fmt::format("\r{}\x1b[K", text.substr(0, LiveWidth())));
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
  if (learner.done()) return Line(DoneText(learner, directory));
  Line(fmt::format(
      "{} ({} preset), seed {}, {} into {}", task.name, task.preset, learner.options().seed,
      n_done == 0 ? std::string("learning") : fmt::format("going on after episode {},", n_done),
      directory));
  if (!robot_.empty()) Line(fmt::format("the real system is {}", robot_));
  if (quiet_ || json_) return;
  WriteOutput(TableHeader(pilco_));
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

bool Progress::SearchDue() {
  const Clock::time_point now = Clock::now();
  const bool due =
      terminal_ ? now - last_search_ >= kLivePeriod : now - last_search_ >= kPlainPeriod;
  if (quiet_ || !due) return false;
  last_search_ = now;
  return true;
}

void Progress::Search(const PolicySearchProgress& progress, const EvaluatorStatistics& batch,
                      int threads) {
  if (!SearchDue()) return;
  SearchLine(
      static_cast<double>(progress.evaluations) / static_cast<double>(progress.budget),
      {fmt::format("{}/{} rollouts", Thousands(progress.evaluations), Thousands(progress.budget)),
       fmt::format("run {}", progress.runs_started),
       fmt::format("{} {:.2f}", progress.relaxed ? "relaxed best" : "best", progress.best_return),
       fmt::format("mean {:.2f}", progress.mean_return),
       fmt::format("lanes {:.0f} % full", 100 * batch.LaneFill()),
       fmt::format("threads {:.0f} % idle", 100 * batch.IdleShare(threads))});
}

void Progress::Search(const GradientSearchProgress& progress) {
  if (!SearchDue()) return;
  SearchLine(
      static_cast<double>(progress.evaluations) / static_cast<double>(progress.budget),
      {fmt::format("{}/{} values", Thousands(progress.evaluations), Thousands(progress.budget)),
       fmt::format("{} starts done", progress.starts_done),
       fmt::format("best {:.2f}", progress.best_value)});
}

void Progress::SearchLine(double share, const std::vector<std::string>& figures) {
  share = std::min(share, 1.0);
  const double eta = Seconds(last_search_ - search_start_) * (1 - share) / std::max(share, 1e-6);
  const std::string start = fmt::format("episode {}: search ", episode_);
  const std::string left = fmt::format("{:3.0f} %  {:.0f} s left", 100 * share, eta);
  if (!terminal_) return Line(fmt::format("{}{}  {}", start, left, fmt::join(figures, "  ")));
  Live(FittedLine(start, share, left, figures, LiveWidth()));
}

void Progress::Episode(const Learner& learner, const EpisodeRecord& record) {
  ClearLive();
  for (const std::string& text :
       {JitterText(ModelOutputs(learner.task(), learner.options()), record),
        PriorText(learner.task(), record), PlanText(record), QueryTimeText(record),
        OutcomeText(learner.task(), record)}) {
    if (!text.empty()) Line(text);
  }
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
