// SPDX-License-Identifier: Apache-2.0
// What the plan of GP queries costs and how far it errs, on the models of runs: for each model, the
// plan that the learner would choose, its errors on inputs of fresh rollouts of the exact model,
// and the time a query takes exactly, by plan and one query at a time. A line an output, a summary
// at the end; exit status 1 if an error is above its tolerance or an answer is not sound.
//   plan_study cartpole RUN ...                        models of the first 1, 2, ... 15 episodes
//   plan_study cartpole RUN ... --concatenate --points 320,640,1280,2560 --fit-points 640
// Times count only on a machine that does nothing else.
#include <CLI/CLI.hpp>
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <limits>
#include <memory>
#include <numeric>
#include <string>
#include <utility>
#include <vector>

#include "bench/program.h"
#include "bench/run_data.h"
#include "bench/tile_queries.h"
#include "engine/errors.h"
#include "engine/learner/plan_probes.h"
#include "engine/learner/planned_model.h"
#include "engine/learner/saved_policy.h"
#include "engine/parallel_for.h"
#include "tasks/registry.h"

namespace downpour {
namespace {

constexpr int kMaxEpisodes = 15;

struct Arguments {
  std::string task;
  std::vector<std::filesystem::path> runs;
  std::vector<int> episodes;
  std::vector<int> points;
  int fit_points = 0;
  bool concatenate = false;
  int inputs = 100000;
  QueryPlanOptions plan;
  int threads = 2;
  bool no_timing = false, no_baseline = false;
  std::string csv;
};

// What one model is learnt from.
struct Source {
  std::string name;
  std::filesystem::path run;  // the last one
  Dataset data;
  int episodes = 0;
  SavedPolicy last;   // the search for the next policy starts from it; no parameters: the origin
  SavedPolicy found;  // what it found
};

// One output of one model.
struct Row {
  std::string model, output;
  int n = 0;
  double ratio = 0;  // sigma_f / sigma_n
  int points = 0;
  const char* precision = "";
  double tau = 0;
  PlanErrors probe, fresh;
  int unsound = 0;
  double exact_ns = NAN, plan_ns = NAN, per_query_ns = NAN;
};

int EpisodesOf(const Task& task, const std::filesystem::path& run) {
  return ReadDataset(task, {&run, 1}, std::numeric_limits<int>::max()).n_points() / task.horizon;
}

// The policies before and after the search on the model of the first `episodes` episodes.
void ReadPolicies(const std::filesystem::path& run, int episodes, Source* source) {
  const auto read = [&](int episode, SavedPolicy* policy) {
    const auto file = run / ("policy_" + std::to_string(episode) + ".json");
    if (std::filesystem::exists(file)) *policy = ReadPolicy(file);
  };
  read(episodes, &source->last);
  source->found = source->last;
  read(episodes + 1, &source->found);
  if (source->found.parameters.empty()) {
    throw InvalidInput(run.string() + ": no policy of episode " + std::to_string(episodes) +
                       " or the next");
  }
}

std::vector<Source> Sources(const Task& task, const Arguments& arguments) {
  std::vector<Source> sources;
  std::vector<int> points = arguments.points;
  if (points.empty()) points.push_back(std::numeric_limits<int>::max());
  const auto add = [&](std::span<const std::filesystem::path> runs, int episodes) {
    const Dataset all = ReadDataset(task, runs, episodes);
    for (const int wanted : points) {
      const int n = std::min(wanted, all.n_points());
      Source source{.name = runs.back().filename().string() + "/" + std::to_string(episodes),
                    .run = runs.back(),
                    .data = {all.inputs.topRows(n), all.targets.topRows(n)},
                    .episodes = episodes};
      ReadPolicies(runs.back(), episodes, &source);
      sources.push_back(std::move(source));
    }
  };
  std::vector<int> episodes = arguments.episodes;
  if (arguments.concatenate) {
    if (episodes.empty()) episodes.push_back(EpisodesOf(task, arguments.runs.back()));
    for (const int k : episodes) add(arguments.runs, k);
    return sources;
  }
  for (const auto& run : arguments.runs) {
    const int n_episodes = std::min(kMaxEpisodes, EpisodesOf(task, run));
    std::vector<int> list = episodes;
    if (list.empty()) {
      list.resize(n_episodes);
      std::iota(list.begin(), list.end(), 1);
    }
    for (const int k : list) add({&run, 1}, k);
  }
  return sources;
}

// Inputs that fresh rollouts meet: a third by the policy found, a third by policies around it, as
// the search's first run draws them, and a third by random ones.
Eigen::MatrixXd FreshInputs(const Task& task, const PolicySearchOptions& search,
                            const std::vector<double>& found, std::uint32_t model, int n_inputs,
                            Evaluator* evaluator) {
  const int n_rollouts = (n_inputs + task.horizon - 1) / task.horizon;
  std::vector<double> parameters;
  std::vector<StreamKey> keys;
  for (std::uint32_t c = 0; c < static_cast<std::uint32_t>(n_rollouts); ++c) {
    keys.push_back(DeriveKey(0, StreamPurpose::kEvaluate, {model, c, 0}));
    const StreamKey policy_key = DeriveKey(0, StreamPurpose::kEvaluate, {model, c, 1});
    std::vector<double> row = found;
    if (c % 3 == 1) PerturbPolicy(search, policy_key, row);
    if (c % 3 == 2) DrawRandomPolicy(search, policy_key, row);
    parameters.insert(parameters.end(), row.begin(), row.end());
  }
  return MetInputs(evaluator, parameters, keys, task.n_inputs());
}

struct LearntModel {
  std::vector<Hyperparameters> hyperparameters;
  std::vector<std::unique_ptr<PerQueryGp>> per_query;  // empty: not to be timed
  PlannedModel planned;
};

// Without plans yet. `warm`: the optimum before, or empty.
LearntModel Learn(const Arguments& arguments, const Source& source,
                  const std::vector<Hyperparameters>& warm) {
  const Dataset& data = source.data;
  const int n = data.n_points();
  const int fitted = arguments.fit_points == 0 ? n : std::min(arguments.fit_points, n);
  const auto fits =
      FitHyperparameters({data.inputs.topRows(fitted), data.targets.topRows(fitted)}, warm, {}, 0,
                         static_cast<std::uint32_t>(source.episodes) + 1, arguments.threads);
  std::vector<Hyperparameters> hyperparameters;
  std::vector<std::unique_ptr<PerQueryGp>> per_query;
  std::vector<ExactGp> gps;
  for (int e = 0; e < data.n_outputs(); ++e) {
    const Hyperparameters& h = hyperparameters.emplace_back(fits[e].hyperparameters);
    const ExactGp& gp = gps.emplace_back(data.inputs, data.targets.col(e), h);
    if (arguments.no_timing || arguments.no_baseline) continue;
    per_query.push_back(std::make_unique<PerQueryGp>(n, data.n_inputs(), data.inputs.data(),
                                                     h.lengthscales.data(), h.signal_std,
                                                     gp.cholesky().data(), gp.alpha().data()));
  }
  return {std::move(hyperparameters), std::move(per_query),
          PlannedModel(std::move(gps), arguments.plan, arguments.threads)};
}

// Chooses the plans as the learner does; then inputs of fresh rollouts. `index` numbers the model's
// random streams.
Eigen::MatrixXd ChooseAndMeet(const Task& task, const Arguments& arguments, const Source& source,
                              std::uint32_t index, PlannedModel* model) {
  const std::unique_ptr<Policy> policy = MakePolicy(source.found, task);
  PolicySearchOptions search;
  search.bound = task.parameter_bound;
  search.first_sigma = task.search_first_sigma;
  search.restart_sigma = task.search_restart_sigma;
  search.restart_decades = task.search_restart_decades;
  EvaluatorOptions rollout;
  rollout.threads = arguments.threads;
  Evaluator evaluator(task, *policy, model->exact_factors(), rollout);
  std::vector<double> last = source.last.parameters;
  last.resize(policy->n_parameters(), 0.0);
  const Eigen::MatrixXd met = ProbeInputs(search, last, 0, index, task.n_inputs(), &evaluator);
  Eigen::MatrixXd probes(source.data.n_points() + met.rows(), source.data.n_inputs());
  probes << source.data.inputs, met;
  model->Choose(std::move(probes));
  return FreshInputs(task, search, source.found.parameters, index, arguments.inputs, &evaluator);
}

// Measures the chosen plans on `fresh`.
std::vector<Row> Measure(const Task& task, const Arguments& arguments, const Source& source,
                         const LearntModel& model, const Eigen::MatrixXd& fresh) {
  std::vector<Row> rows(task.n_states());
  ParallelFor(task.n_states(), arguments.threads, [&](int e) {
    const OutputPlan& plan = model.planned.plans()[e];
    const Hyperparameters& h = model.hyperparameters[e];
    const GpFactor& exact = std::get<GpFactor>(model.planned.exact_factors()[e]);
    rows[e] = {.model = source.name,
               .output = task.states[e].name,
               .n = plan.n,
               .ratio = h.signal_std / h.noise_std,
               .points = plan.points,
               .precision = plan.single_precision ? "fp32" : "fp64",
               .tau = plan.tau,
               .probe = plan.probe_errors,
               .fresh = MeasurePlan(plan, exact, fresh),
               .unsound = CountUnsound(plan.factor, fresh)};
  });
  if (arguments.no_timing) return rows;
  const QueryTimes times =
      TimeQueries(model.planned.exact_factors(), model.planned.factors(), model.per_query, fresh);
  for (std::size_t e = 0; e < rows.size(); ++e) {
    rows[e].exact_ns = times.exact[e];
    rows[e].plan_ns = times.plan[e];
    if (!times.per_query.empty()) rows[e].per_query_ns = times.per_query[e];
  }
  return rows;
}

void Print(const Row& r) {
  std::printf("%-18s %-14s %4d %6.0f %5d %s %6g  %.4f %.4f  %.4f %.4f %2d  %8.1f %7.1f %8.0f\n",
              r.model.c_str(), r.output.c_str(), r.n, r.ratio, r.points, r.precision, r.tau,
              r.probe.variance, r.probe.mean, r.fresh.variance, r.fresh.mean, r.unsound, r.exact_ns,
              r.plan_ns, r.per_query_ns);
  std::fflush(stdout);
}

// The lines as CSV; "": no file.
class CsvFile {
 public:
  explicit CsvFile(const std::string& path) : path_(path) {
    if (path.empty()) return;
    file_.open(path);
    file_ << "model,output,n,ratio,points,precision,tau,probe_variance,probe_mean,fresh_variance,"
             "fresh_mean,unsound,exact_ns [ns],plan_ns [ns],per_query_ns [ns]\n";
    Flush();
  }
  void Write(const Row& r) {
    if (path_.empty()) return;
    file_ << r.model << ',' << r.output << ',' << r.n << ',' << r.ratio << ',' << r.points << ','
          << r.precision << ',' << r.tau << ',' << r.probe.variance << ',' << r.probe.mean << ','
          << r.fresh.variance << ',' << r.fresh.mean << ',' << r.unsound << ',' << r.exact_ns << ','
          << r.plan_ns << ',' << r.per_query_ns << '\n';
    Flush();
  }

 private:
  void Flush() {
    file_.flush();
    if (!file_) throw FileError("cannot write " + path_);
  }
  std::string path_;
  std::ofstream file_;
};

// Mean over the outputs of the model at rows [first, first + E).
double MeanOf(const std::vector<Row>& rows, std::size_t first, int n_outputs, double Row::*value) {
  double sum = 0;
  for (int e = 0; e < n_outputs; ++e) sum += rows[first + e].*value;
  return sum / n_outputs;
}

// Least-squares slope of the logarithm of the models' mean plan time over that of n.
double CostExponent(const std::vector<Row>& rows, int n_outputs) {
  double x = 0, y = 0, xx = 0, xy = 0;
  for (std::size_t i = 0; i < rows.size(); i += n_outputs) {
    const double log_n = std::log(rows[i].n);
    const double log_ns = std::log(MeanOf(rows, i, n_outputs, &Row::plan_ns));
    x += log_n, y += log_ns, xx += log_n * log_n, xy += log_n * log_ns;
  }
  const double models = static_cast<double>(rows.size()) / n_outputs;
  return (models * xy - x * y) / (models * xx - x * x);
}

void PrintTimes(const char* what, const std::vector<Row>& rows, int n_outputs,
                double Row::*reference) {
  double least = HUGE_VAL, most = 0, sum = 0;
  for (std::size_t i = 0; i < rows.size(); i += n_outputs) {
    const double ratio =
        MeanOf(rows, i, n_outputs, reference) / MeanOf(rows, i, n_outputs, &Row::plan_ns);
    least = std::min(least, ratio), most = std::max(most, ratio), sum += ratio;
  }
  const double models = static_cast<double>(rows.size()) / n_outputs;
  std::printf("plan against %s: %.1f times faster (%.1f to %.1f)\n", what, sum / models, least,
              most);
}

// Returns whether all errors are within their tolerances and all answers sound.
bool PrintSummary(const Arguments& arguments, const std::vector<Row>& rows, int n_outputs) {
  PlanErrors worst;
  int above = 0, unsound = 0;
  for (const Row& r : rows) {
    worst.variance = std::max(worst.variance, r.fresh.variance);
    worst.mean = std::max(worst.mean, r.fresh.mean);
    above += r.fresh.variance > arguments.plan.variance_tolerance ||
             r.fresh.mean > arguments.plan.mean_tolerance;
    unsound += r.unsound;
  }
  std::printf(
      "%zu models, %zu outputs: worst error on fresh inputs variance %.4f (tolerance %g), mean "
      "%.4f (%g); %d outputs above, %d unsound answers\n",
      rows.size() / n_outputs, rows.size(), worst.variance, arguments.plan.variance_tolerance,
      worst.mean, arguments.plan.mean_tolerance, above, unsound);
  if (!arguments.no_timing) {
    PrintTimes("exact fp64", rows, n_outputs, &Row::exact_ns);
    if (!arguments.no_baseline) {
      PrintTimes("one query at a time", rows, n_outputs, &Row::per_query_ns);
    }
    if (arguments.points.size() > 1) {
      std::printf("time by plan ~ n^%.2f\n", CostExponent(rows, n_outputs));
    }
  }
  return above == 0 && unsound == 0;
}

std::vector<Row> StudyAll(const Task& task, const Arguments& arguments) {
  std::vector<Row> rows;
  std::vector<Hyperparameters> warm;
  std::filesystem::path last_run;
  std::uint32_t index = 0;
  const std::vector<Source> sources = Sources(task, arguments);
  CsvFile csv(arguments.csv);
  std::printf("%-18s %-14s %4s %6s %5s %4s %6s  %-13s  %-13s %2s  %8s %7s %8s\n", "run/episodes",
              "output", "n", "sf/sn", "m", "", "tau", "probes: v, m", "fresh: v, m", "!",
              "exact ns", "plan ns", "1-by-1");
  for (const Source& source : sources) {
    if (source.run != last_run) warm.clear();
    last_run = source.run;
    LearntModel model = Learn(arguments, source, warm);
    warm = model.hyperparameters;
    const Eigen::MatrixXd fresh = ChooseAndMeet(task, arguments, source, index++, &model.planned);
    for (const Row& row : Measure(task, arguments, source, model, fresh)) {
      Print(row);
      csv.Write(row);
      rows.push_back(row);
    }
  }
  return rows;
}

int Main(int argc, char** argv) {
  Arguments arguments;
  CLI::App app("Costs and errors of query plans on the models of runs");
  app.add_option("task", arguments.task)->required();
  app.add_option("runs", arguments.runs, "run directories")->required();
  app.add_option("--episodes", arguments.episodes,
                 "models of the first so many episodes (all up to 15)")
      ->delimiter(',')
      ->check(CLI::Range(1, 1000));
  app.add_option("--points", arguments.points, "models of the first so many transitions (all)")
      ->delimiter(',')
      ->check(CLI::PositiveNumber);
  app.add_option("--fit-points", arguments.fit_points,
                 "learn hyper-parameters from the first so many transitions (all)")
      ->check(CLI::PositiveNumber);
  app.add_flag("--concatenate", arguments.concatenate, "one data set of all runs");
  app.add_option("--inputs", arguments.inputs, "fresh inputs a model")->check(CLI::PositiveNumber);
  app.add_option("--tolerance", arguments.plan.variance_tolerance);
  app.add_option("--mean-tolerance", arguments.plan.mean_tolerance);
  app.add_option("--threads", arguments.threads, "of everything but the timing")
      ->check(CLI::PositiveNumber);
  app.add_flag("--no-timing", arguments.no_timing);
  app.add_flag("--no-baseline", arguments.no_baseline, "do not time one query at a time");
  app.add_option("--csv", arguments.csv, "file for the lines");
  CLI11_PARSE(app, argc, argv);

  const Task task = MakeTask(arguments.task);
  const std::vector<Row> rows = StudyAll(task, arguments);
  return PrintSummary(arguments, rows, task.n_states()) ? 0 : 1;
}

}  // namespace
}  // namespace downpour

int main(int argc, char** argv) {
  return downpour::RunProgram("plan_study", downpour::Main, argc, argv);
}
