// SPDX-License-Identifier: Apache-2.0
#include "tools/downpour/profile_output.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <functional>

#include "kernels/fma_peak/fma_peak.h"
#include "tools/measure/machine.h"

namespace downpour {
namespace {

// Columns of models side by side: 24 + 6 x 9 = 78.
constexpr std::size_t kColumns = 6;

using Cell = std::function<std::string(const ProfiledModel&)>;
using Models = std::span<const ProfiledModel>;

void PrintRow(const std::string& name, Models models, const Cell& cell) {
  std::string line = fmt::format("{:<24}", name);
  for (const ProfiledModel& model : models) line += fmt::format("{:>9}", cell(model));
  fmt::print("{}\n", line);
}

std::string Nanoseconds(double ns) { return fmt::format("{:.2f}", ns); }
std::string Percent(double share) { return fmt::format("{:.1f} %", 100 * share); }

Roof TopRoof(const ProfiledModel& model, const Ceilings& ceilings) {
  return RoofOf(model.profile.work[model.profile.Top()], ceilings, LevelOf(model));
}

// What of the FMA peak the queries reach; outputs in fp32 count by its own.
double ShareOfPeak(const ProfiledModel& model, const Ceilings& ceilings) {
  Work work = SumOfQueryCosts(model.profile).work;
  work.bytes = 0;
  return RoofOf(work, ceilings, kLevel2).ns / SumOfQueryCosts(model.profile).ns;
}

// "fp64": all of its factors; "mixed".
std::string Precision(const ProfiledModel& model) {
  const Work work = SumOfQueryCosts(model.profile).work;
  return work.fp32_operations == 0 ? "fp64" : work.fp64_operations == 0 ? "fp32" : "mixed";
}

void PrintBlock(Models models, const Ceilings& ceilings) {
  fmt::print("\n");
  if (models.front().episode > 0) {
    PrintRow("episode", models, [](const auto& m) { return std::to_string(m.episode); });
  }
  PrintRow("training points n", models, [](const auto& m) { return std::to_string(m.points); });
  PrintRow("precision of the plan", models, Precision);
  for (int cost = 0; cost < kCosts; ++cost) {
    const auto ns = [cost](const ProfiledModel& m) { return m.profile.ns[cost]; };
    // OpenBLAS or the fused kernel, with deflation or without.
    if (std::all_of(models.begin(), models.end(), [&](const auto& m) { return ns(m) == 0; })) {
      continue;
    }
    PrintRow(fmt::format("{} [ns]", kCostNames[cost]), models,
             [&](const auto& m) { return Nanoseconds(ns(m)); });
  }
  PrintRow("measured in all [ns]", models,
           [](const auto& m) { return Nanoseconds(m.profile.measured_ns); });
  PrintRow("accounted for", models, [](const auto& m) { return Percent(m.profile.Accounted()); });
  PrintRow("queries, GFLOP/s", models, [](const auto& m) {
    const QueryCosts costs = SumOfQueryCosts(m.profile);
    return fmt::format("{:.1f}", costs.work.operations() / costs.ns);
  });
  PrintRow("queries, of FMA peak", models,
           [&](const auto& m) { return Percent(ShareOfPeak(m, ceilings)); });
  PrintRow("bytes read, a query", models, [](const auto& m) {
    return fmt::format("{:.0f}", SumOfQueryCosts(m.profile).work.bytes);
  });
  PrintRow("factors, KiB", models, [](const auto& m) {
    return fmt::format("{:.0f}", static_cast<double>(m.profile.packed_bytes) / 1024);
  });
  PrintRow("they fit in", models, [](const auto& m) { return kMemoryLevelNames[LevelOf(m)]; });
  PrintRow("top cost", models, [](const auto& m) -> std::string {
    const std::string name = kCostNames[m.profile.Top()];
    return name.substr(0, 8);
  });
  PrintRow("its roofline [ns]", models, [&](const auto& m) -> std::string {
    const Roof roof = TopRoof(m, ceilings);
    return roof.ns > 0 ? Nanoseconds(roof.ns) : "-";
  });
  PrintRow("time / roofline", models, [&](const auto& m) -> std::string {
    const Roof roof = TopRoof(m, ceilings);
    return roof.ns > 0 ? fmt::format("{:.2f}", m.profile.ns[m.profile.Top()] / roof.ns) : "-";
  });
  for (int i = 0; i < kPerfEvents; ++i) {
    const auto events = [i](const ProfiledModel& m) { return m.profile.events[i]; };
    if (std::isnan(events(models.front()))) continue;
    PrintRow(fmt::format("{}, a query", kPerfEventNames[i]), models,
             [&](const auto& m) { return fmt::format("{:.2f}", events(m)); });
  }
}

// "2 x 134 of 320 points, fp32; 2 x ..." in order, equal neighbours together.
std::string PlanSummary(const std::vector<std::string>& plans) {
  std::string text;
  for (std::size_t i = 0, end = 0; i < plans.size(); i = end) {
    while (end < plans.size() && plans[end] == plans[i]) ++end;
    if (!text.empty()) text += "; ";
    text += end - i > 1 ? fmt::format("{} x {}", end - i, plans[i]) : plans[i];
  }
  return text;
}

// Words of `text` in lines of at most 80 columns, further ones indented.
void PrintWrapped(const std::string& text) {
  std::string line;
  std::size_t at = 0;
  while (at < text.size()) {
    const std::size_t end = std::min(text.find(' ', at), text.size());
    const std::string word = text.substr(at, end - at);
    if (!line.empty() && line.size() + 1 + word.size() > 80) {
      fmt::print("{}\n", line);
      line.assign(1, ' ');  // further lines are indented
    }
    line += (line.empty() ? "" : " ") + word;
    at = end + 1;
  }
  fmt::print("{}\n", line);
}

void PrintTop(const ProfiledModel& model, const Ceilings& ceilings) {
  const Cost top = model.profile.Top();
  const double ns = model.profile.ns[top];
  const Roof roof = TopRoof(model, ceilings);
  std::string text = fmt::format("n = {}: top cost {}, {:.2f} ns, {} of the time", model.points,
                                 kCostNames[top], ns, Percent(ns / model.profile.measured_ns));
  text += roof.ns > 0
              ? fmt::format(": {:.2f} x its roofline, which is {}", ns / roof.ns,
                            roof.memory_bound ? fmt::format("the reading of {}",
                                                            kMemoryLevelNames[LevelOf(model)])
                                              : std::string("the FMA peak"))
              : std::string(": no roofline, as its arithmetic is not counted");
  PrintWrapped(text);
  PrintWrapped("  outputs: " + PlanSummary(model.plans));
}

}  // namespace

QueryCosts SumOfQueryCosts(const RolloutProfile& profile) {
  QueryCosts sum;
  for (const Cost cost : {kCovariance, kExponential, kDeflation, kMean, kTriangle, kBlasQueries}) {
    const Work& work = profile.work[cost];
    sum.ns += profile.ns[cost];
    sum.work.fp64_operations += work.fp64_operations;
    sum.work.fp32_operations += work.fp32_operations;
    sum.work.bytes += work.bytes;
  }
  return sum;
}

MemoryLevel LevelOf(const ProfiledModel& model) {
  return LevelOf(model.profile.packed_bytes, ReadCacheSizes(), model.profile.threads);
}

void PrintProfile(const ProfileReport& report) {
  const RolloutProfile& first = report.models.front().profile;
  PrintWrapped(fmt::format("{}; {}, {}; {} thread{}, {} lanes in {} tiles", report.subject,
                           CpuModel(), SimdTargetName(), first.threads,
                           first.threads == 1 ? "" : "s", first.lanes, first.tiles));
  std::string bandwidths;
  for (int level = 0; level < kMemoryLevels; ++level) {
    const double rate = report.ceilings.gigabytes_per_second[level];
    bandwidths += fmt::format(", {} {}", kMemoryLevelNames[level],
                              rate > 0 ? fmt::format("{:.0f} GB/s", rate) : "not measured");
  }
  PrintWrapped(fmt::format("ceilings now: FMA {:.1f} GFLOP/s fp64, {:.1f} fp32{}",
                           report.ceilings.fp64_gflops, report.ceilings.fp32_gflops, bandwidths));
  PrintWrapped(
      "thread time of one GP query (one output, one lane); parts by a clock between the kernels "
      "(its own time taken off), the query's by ablation: pass after pass added");
  if (!first.missing_events.empty()) PrintWrapped(first.missing_events);
  const Models models(report.models);
  for (std::size_t at = 0; at < models.size(); at += kColumns) {
    PrintBlock(models.subspan(at, std::min(kColumns, models.size() - at)), report.ceilings);
  }
  fmt::print("\n");
  for (const ProfiledModel& model : models) PrintTop(model, report.ceilings);
}

namespace {

nlohmann::ordered_json CostsJson(const ProfiledModel& model, const Ceilings& ceilings) {
  nlohmann::ordered_json costs;
  for (int cost = 0; cost < kCosts; ++cost) {
    const Work& work = model.profile.work[cost];
    const double ns = model.profile.ns[cost];
    nlohmann::ordered_json& json = costs[kCostNames[cost]];
    json["ns"] = ns;
    json["fp64_operations"] = work.fp64_operations;
    json["fp32_operations"] = work.fp32_operations;
    json["bytes"] = work.bytes;
    const Roof roof = RoofOf(work, ceilings, LevelOf(model));
    json["roofline_ns"] = roof.ns > 0 ? nlohmann::ordered_json(roof.ns) : nullptr;
    json["memory_bound"] = roof.memory_bound;
  }
  return costs;
}

nlohmann::ordered_json ModelJson(const ProfiledModel& model, const Ceilings& ceilings) {
  const RolloutProfile& profile = model.profile;
  const QueryCosts queries = SumOfQueryCosts(profile);
  nlohmann::ordered_json json;
  json["episode"] = model.episode > 0 ? nlohmann::ordered_json(model.episode) : nullptr;
  json["points"] = model.points;
  json["inputs"] = model.n_inputs;
  json["outputs"] = model.n_outputs;
  json["plans"] = model.plans;
  json["lanes"] = profile.lanes;
  json["tiles"] = profile.tiles;
  json["queries"] = profile.queries;
  json["factor_bytes"] = profile.packed_bytes;
  json["factors_in"] = kMemoryLevelNames[LevelOf(model)];
  json["measured_ns"] = profile.measured_ns;
  json["accounted_for"] = profile.Accounted();
  json["costs"] = CostsJson(model, ceilings);
  json["query"] = {{"ns", queries.ns},
                   {"operations", queries.work.operations()},
                   {"bytes", queries.work.bytes},
                   {"gflops", queries.work.operations() / queries.ns},
                   {"of_fma_peak", ShareOfPeak(model, ceilings)}};
  json["top_cost"] = kCostNames[profile.Top()];
  const Roof roof = TopRoof(model, ceilings);
  json["top_over_roofline"] =
      roof.ns > 0 ? nlohmann::ordered_json(profile.ns[profile.Top()] / roof.ns) : nullptr;
  for (int i = 0; i < kPerfEvents; ++i) {
    json["events"][kPerfEventNames[i]] = std::isnan(profile.events[i])
                                             ? nlohmann::ordered_json(nullptr)
                                             : nlohmann::ordered_json(profile.events[i]);
  }
  return json;
}

}  // namespace

nlohmann::ordered_json ProfileJson(const ProfileReport& report) {
  nlohmann::ordered_json json;
  json["subject"] = report.subject;
  for (const auto& [name, value] : DescribeMachine()) json["machine"][name] = value;
  json["machine"]["load_average"] = LoadAverage();
  json["threads"] = report.ceilings.threads;
  json["ceilings"] = {{"fp64_gflops", report.ceilings.fp64_gflops},
                      {"fp32_gflops", report.ceilings.fp32_gflops}};
  for (int level = 0; level < kMemoryLevels; ++level) {
    const double rate = report.ceilings.gigabytes_per_second[level];
    json["ceilings"][std::string(kMemoryLevelNames[level]) + "_gigabytes_per_second"] =
        rate > 0 ? nlohmann::ordered_json(rate) : nullptr;
  }
  json["method"] = {{"parts", "clock between kernels"}, {"query", "ablation"}};
  const std::string& missing = report.models.front().profile.missing_events;
  json["hardware_counters"] = missing.empty() ? "available" : missing;
  for (const ProfiledModel& model : report.models) {
    json["models"].push_back(ModelJson(model, report.ceilings));
  }
  return json;
}

}  // namespace downpour
