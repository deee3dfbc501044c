// SPDX-License-Identifier: Apache-2.0
#include "tools/downpour/scaling_output.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <optional>

#include "tools/measure/machine.h"

namespace downpour {
namespace {

// Of sorted values, linear between them.
double Quantile(const std::vector<double>& sorted, double q) {
  const double at = q * static_cast<double>(sorted.size() - 1);
  const auto below = static_cast<std::size_t>(at);
  const double above = sorted[std::min(below + 1, sorted.size() - 1)];
  return sorted[below] + (at - std::floor(at)) * (above - sorted[below]);
}

void Quartiles(std::vector<double> values, double (&out)[3]) {
  std::sort(values.begin(), values.end());
  for (int i = 0; i < 3; ++i) out[i] = Quantile(values, 0.25 * (i + 1));
}

double Median(std::vector<double> values) {
  std::sort(values.begin(), values.end());
  return Quantile(values, 0.5);
}

// The authors' speed-ups (paper, Fig. 4A and 6A).
std::optional<double> PaperSpeedUp(const std::string& task) {
  if (task == "pendulum") return 8;
  if (task == "cartpole") return 6;
  return std::nullopt;
}
constexpr int kPaperCores = 12;

const ScalingRow* FindRow(const std::vector<ScalingRow>& rows, int threads) {
  const auto row = std::find_if(rows.begin(), rows.end(),
                                [=](const ScalingRow& r) { return r.threads == threads; });
  return row == rows.end() ? nullptr : &*row;
}

const ExpectedSpeedUp* FindExpected(const ScaledTask& task, int threads) {
  const auto found = std::find_if(task.expected.begin(), task.expected.end(),
                                  [=](const ExpectedSpeedUp& e) { return e.threads == threads; });
  return found == task.expected.end() ? nullptr : &*found;
}

nlohmann::ordered_json RowsJson(const std::vector<ScalingRow>& rows) {
  nlohmann::ordered_json json = nlohmann::ordered_json::array();
  for (const ScalingRow& row : rows) {
    json.push_back({{"threads", row.threads},
                    {"seconds", row.seconds[1]},
                    {"seconds_quartile_1", row.seconds[0]},
                    {"seconds_quartile_3", row.seconds[2]},
                    {"speed_up", row.speed_up[1]},
                    {"speed_up_quartile_1", row.speed_up[0]},
                    {"speed_up_quartile_3", row.speed_up[2]},
                    {"efficiency", row.efficiency[1]},
                    {"efficiency_quartile_1", row.efficiency[0]},
                    {"efficiency_quartile_3", row.efficiency[2]},
                    {"lane_fill", row.lane_fill},
                    {"idle_share", row.idle_share}});
  }
  return json;
}

void PrintTask(const ScaledTask& task) {
  const std::vector<ScalingRow> strong = Summarise(task.searches, false);
  const std::vector<ScalingRow> weak = Summarise(task.searches, true);
  fmt::print("\n{}, n = {}: {} rollouts a search; serial {:.1f} % of one thread's time\n",
             task.task, task.points, task.searches.front().evaluations, 100 * task.serial_share);
  fmt::print("{:>7} {:>8} {:>17} {:>8} {:>7} {:>7} {:>6} {:>6} {:>6}\n", "threads", "seconds",
             "quartiles", "speed-up", "effic.", "weak", "fill", "idle", "expect");
  for (const ScalingRow& row : strong) {
    const ScalingRow* weak_row = FindRow(weak, row.threads);
    const ExpectedSpeedUp* expected = FindExpected(task, row.threads);
    fmt::print("{:>7} {:>8.3f} {:>17} {:>8.2f} {:>5.1f} % {:>7} {:>4.0f} % {:>4.1f} % {:>6}\n",
               row.threads, row.seconds[1],
               fmt::format("{:.3f} - {:.3f}", row.seconds[0], row.seconds[2]), row.speed_up[1],
               100 * row.efficiency[1],
               weak_row ? fmt::format("{:.1f} %", 100 * weak_row->efficiency[1]) : "-",
               100 * row.lane_fill, 100 * row.idle_share,
               expected ? fmt::format("{:.2f}", expected->speed_up) : "-");
  }
  for (const int threads : {2, 4, 8, 12, 16, 32, 64}) {
    const ExpectedSpeedUp* expected = FindExpected(task, threads);
    if (expected == nullptr || FindRow(strong, threads) != nullptr) continue;
    fmt::print("expected on {} threads: {:.1f}, bound by {}\n", threads, expected->speed_up,
               expected->bound);
  }
  if (const auto paper = PaperSpeedUp(task.task)) {
    fmt::print("the authors' program: {:g} on {} cores\n", *paper, kPaperCores);
  }
}

}  // namespace

std::vector<ScalingRow> Summarise(const std::vector<TimedSearch>& searches, bool weak) {
  std::map<int, double> one_thread;  // by replicate
  std::map<int, std::vector<TimedSearch>> by_threads;
  for (const TimedSearch& search : searches) {
    // One thread's search is the first of both rows.
    if (search.threads == 1 && !search.weak) one_thread[search.replicate] = search.seconds;
    if (search.weak == weak || search.threads == 1) by_threads[search.threads].push_back(search);
  }
  std::vector<ScalingRow> rows;
  for (const auto& entry : by_threads) {
    std::vector<double> seconds, speed_ups, efficiencies, fills, idle;
    for (const TimedSearch& search : entry.second) {
      const double ratio = one_thread.at(search.replicate) / search.seconds;
      seconds.push_back(search.seconds);
      speed_ups.push_back(weak ? ratio * search.threads : ratio);
      efficiencies.push_back(weak ? ratio : ratio / search.threads);
      fills.push_back(search.lane_fill);
      idle.push_back(search.idle_share);
    }
    ScalingRow row{.threads = entry.first,
                   .lane_fill = Median(std::move(fills)),
                   .idle_share = Median(std::move(idle))};
    Quartiles(std::move(seconds), row.seconds);
    Quartiles(std::move(speed_ups), row.speed_up);
    Quartiles(std::move(efficiencies), row.efficiency);
    rows.push_back(row);
  }
  return rows;
}

void PrintScaling(const ScalingReport& report) {
  for (const auto& [name, value] : DescribeMachine()) {
    if (name == "cpu" || name == "processors" || name == "cores" || name == "simd") {
      fmt::print("{}{}: {}", name == "cpu" ? "" : "; ", name, value);
    }
  }
  fmt::print("\nthreads {}; {} replicate{} in turns; load average at the start {:.2f}\n",
             report.pinned ? "pinned" : "not pinned", report.replicates,
             report.replicates == 1 ? "" : "s", report.load_average);
  for (const ScaledTask& task : report.tasks) PrintTask(task);
}

nlohmann::ordered_json ScalingJson(const ScalingReport& report) {
  nlohmann::ordered_json json;
  for (const auto& [name, value] : DescribeMachine()) json["machine"][name] = value;
  json["machine"]["cpu_flags"] = CpuFlags();
  json["machine"]["load_average"] = report.load_average;
  json["pinned"] = report.pinned;
  json["replicates"] = report.replicates;
  for (const ScaledTask& task : report.tasks) {
    nlohmann::ordered_json entry;
    entry["task"] = task.task;
    entry["points"] = task.points;
    entry["plans"] = task.plans;
    entry["serial_share"] = task.serial_share;
    entry["strong"] = RowsJson(Summarise(task.searches, false));
    entry["weak"] = RowsJson(Summarise(task.searches, true));
    for (const ExpectedSpeedUp& e : task.expected) {
      entry["expected"].push_back(
          {{"threads", e.threads}, {"speed_up", e.speed_up}, {"bound", e.bound}});
    }
    const auto paper = PaperSpeedUp(task.task);
    entry["paper"] = nullptr;
    if (paper) entry["paper"] = {{"cores", kPaperCores}, {"speed_up", *paper}};
    json["tasks"].push_back(entry);
  }
  return json;
}

std::string ScalingCsv(const ScalingReport& report) {
  std::string csv =
      "task,scaling,pinned,replicate,threads,seconds [s],rollout_seconds [s],evaluations,"
      "lane_fill,idle_share\n";
  for (const ScaledTask& task : report.tasks) {
    for (const TimedSearch& s : task.searches) {
      csv += fmt::format("{},{},{},{},{},{:.6f},{:.6f},{},{:.4f},{:.4f}\n", task.task,
                         s.weak ? "weak" : "strong", report.pinned, s.replicate, s.threads,
                         s.seconds, s.rollout_seconds, s.evaluations, s.lane_fill, s.idle_share);
    }
  }
  return csv;
}

}  // namespace downpour
