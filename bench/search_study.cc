// SPDX-License-Identifier: Apache-2.0
// What a search finds on one fixed model, and for how many rollouts. Learns the dynamics model of a
// run's first episodes, searches with several seeds, and watches the means of the CMA-ES runs: each
// time one is better than all before, a line
//   seed,rollouts,true_return,what
// says after how many rollouts of the search, and its mean return by 2,000 fresh rollouts of the
// model. `what` is mean, end (the search has spent its budget; the best mean again) or returned
// (the policy that the search returns). Watching is not counted. search_study.py compares settings.
#include <CLI/CLI.hpp>
#include <algorithm>
#include <array>
#include <cstdio>
#include <filesystem>
#include <map>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "bench/program.h"
#include "bench/run_data.h"
#include "engine/gp/gp_model.h"
#include "engine/learner/plan_probes.h"
#include "engine/learner/planned_model.h"
#include "engine/learner/saved_policy.h"
#include "engine/rollout/evaluator.h"
#include "engine/search/policy_search.h"
#include "engine/search/search_options.h"
#include "engine/search/search_run.h"
#include "tasks/registry.h"

namespace downpour {
namespace {

// Search rollouts from one look at the means to the next.
constexpr std::int64_t kLookEvery = 1000;
// Fresh rollouts of a look: first of all means, then of the best of them, at last of what may be a
// new best.
constexpr std::array kLookRollouts = {48, 400, 2000};
// Rollout numbers of the looks' streams, so that a policy meets new numbers at every stage.
constexpr int kStageStride = 1 << 20;

enum class Start { kLast, kZero, kUniform };

struct Arguments {
  std::string task;
  std::filesystem::path run;
  int episodes = 4, first_seed = 0, seeds = 1;
  Start start = Start::kLast;
  PolicySearchOptions search;
};

template <typename Enum>
void AddChoice(CLI::App* app, const std::string& name, Enum* target,
               const std::map<std::string, Enum>& values, const std::string& description) {
  app->add_option(name, *target, description)->transform(CLI::CheckedTransformer(values));
}

void AddOptions(CLI::App* app, Arguments* arguments) {
  PolicySearchOptions& search = arguments->search;
  app->add_option("task", arguments->task)->required();
  app->add_option("run", arguments->run, "run directory that holds the data")->required();
  app->add_option("--episodes", arguments->episodes, "the model learns from so many")
      ->check(CLI::Range(1, 1000));
  app->add_option("--first-seed", arguments->first_seed)->check(CLI::NonNegativeNumber);
  app->add_option("--seeds", arguments->seeds, "searches")->check(CLI::Range(1, 100000));
  AddChoice(app, "--start", &arguments->start,
            {{"last", Start::kLast}, {"zero", Start::kZero}, {"uniform", Start::kUniform}},
            "of the first run: the last episode's policy, the origin, or uniform in +-first sigma");
  app->add_option("--threads", search.threads)->check(CLI::Range(1, 1024));
  // The search checks the ranges of the rest.
  app->add_option("--evaluations", search.evaluations, "rollouts of a search");
  app->add_option("--population", search.population, "lambda; 0: the default");
  app->add_option("--rollouts", search.rollouts, "a candidate");
  app->add_option("--max-rollouts", search.max_rollouts, "of --uncertainty rollouts");
  app->add_option("--concurrent", search.concurrent, "CMA-ES runs side by side");
  app->add_option("--first-sigma", search.first_sigma, "default: the task's");
  app->add_option("--restart-sigma", search.restart_sigma, "default: the task's");
  app->add_option("--restart-decades", search.restart_decades, "default: the task's");
  app->add_option("--exploration", search.exploration, "share before the selection; 1: none");
  app->add_option("--relaxed", search.relaxed_exploration, "exploration without a last policy");
  app->add_option("--promotions", search.promotions, "stages after exploration");
  app->add_option("--local-share", search.local_share, "of restarts at the first run's start");
  AddChoice(app, "--restarts", &search.restarts,
            {{"bipop", RestartStrategy::kBipop},
             {"small", RestartStrategy::kSmall},
             {"ipop", RestartStrategy::kIpop},
             {"single", RestartStrategy::kSingle}},
            "");
  AddChoice(app, "--uncertainty", &search.uncertainty,
            {{"off", UncertaintyHandling::kOff},
             {"sigma", UncertaintyHandling::kSigma},
             {"rollouts", UncertaintyHandling::kRollouts},
             {"lra", UncertaintyHandling::kLra}},
            "");
  AddChoice(app, "--covariance", &search.covariance,
            {{"auto", CovarianceForm::kAuto},
             {"full", CovarianceForm::kFull},
             {"diagonal", CovarianceForm::kDiagonal},
             {"limited-memory", CovarianceForm::kLimitedMemory}},
            "");
  AddChoice(app, "--common-random-numbers", &search.common_random_numbers,
            {{"off", CommonRandomNumbers::kOff},
             {"generation", CommonRandomNumbers::kGeneration},
             {"search", CommonRandomNumbers::kSearch}},
            "");
}

// The model as the learner makes it, its plan included.
PlannedModel LearnModel(const Task& task, const Arguments& arguments, const Policy& policy,
                        const std::vector<double>& last_policy) {
  const Dataset data = ReadDataset(task, {&arguments.run, 1}, arguments.episodes);
  const int threads = arguments.search.threads;
  const auto episode = static_cast<std::uint32_t>(arguments.episodes + 1);
  const std::vector<GpFit> fits = FitHyperparameters(data, {}, {}, 0, episode, threads);
  std::vector<ExactGp> gps;
  for (int e = 0; e < data.n_outputs(); ++e) {
    gps.emplace_back(data.inputs, data.targets.col(e), fits[e].hyperparameters);
  }
  PlannedModel model(std::move(gps), {}, threads);
  EvaluatorOptions options;
  options.threads = threads;
  Evaluator evaluator(task, policy, model.exact_factors(), options);
  const Eigen::MatrixXd met =
      ProbeInputs(arguments.search, last_policy, 0, episode, task.n_inputs(), &evaluator);
  Eigen::MatrixXd probes(data.inputs.rows() + met.rows(), data.inputs.cols());
  probes << data.inputs, met;
  model.Choose(std::move(probes));
  return model;
}

// Mean returns by fresh rollouts; the numbers of each look and stage are used once.
class Watcher {
 public:
  Watcher(Evaluator* evaluator, std::uint32_t seed) : evaluator_(*evaluator), seed_(seed) {}

  // Looks at the means of the runs under way; whether there is a new best.
  bool Look(std::span<const SearchRun> runs) {
    std::vector<std::vector<double>> means;
    for (const SearchRun& run : runs) means.push_back(run.Mean());
    if (means.empty()) return false;
    ++looks_;
    const std::vector<double> returns = MeanReturns(means, 0);
    const auto at = std::max_element(returns.begin(), returns.end()) - returns.begin();
    if (returns[static_cast<std::size_t>(at)] < kWorthALook * best_) return false;
    const std::vector<double>& mean = means[static_cast<std::size_t>(at)];
    if (MeanReturns({mean}, 1)[0] <= best_) return false;
    const double value = TrueReturn(mean);
    if (value <= best_) return false;
    best_ = value;
    return true;
  }
  double TrueReturn(const std::vector<double>& parameters) {
    return MeanReturns({parameters}, 2)[0];
  }
  double best() const { return best_; }

 private:
  static constexpr double kWorthALook = 0.9;

  std::vector<double> MeanReturns(const std::vector<std::vector<double>>& policies, int stage) {
    const int n = kLookRollouts[static_cast<std::size_t>(stage)];
    std::vector<double> parameters, means;
    for (const auto& policy : policies) {
      parameters.insert(parameters.end(), policy.begin(), policy.end());
    }
    const std::vector<StreamKey> keys(policies.size(),
                                      DeriveKey(seed_, StreamPurpose::kEvaluate, {looks_}));
    const std::vector<int> n_rollouts(policies.size(), n);
    const std::vector<int> first(policies.size(), stage * kStageStride);
    std::vector<double> returns(policies.size() * static_cast<std::size_t>(n));
    evaluator_.Evaluate(parameters, keys, n_rollouts, first, returns);
    for (auto sum = returns.begin(); sum != returns.end(); sum += n) {
      double total = 0;
      for (auto value = sum; value != sum + n; ++value) total += *value;
      means.push_back(total / n);
    }
    return means;
  }

  Evaluator& evaluator_;
  std::uint32_t seed_, looks_ = 0;
  double best_ = 0;
};

std::vector<double> StartOf(const Arguments& arguments, const std::vector<double>& last, int seed) {
  std::vector<double> start(last.size(), 0.0);
  if (arguments.start == Start::kLast) start = last;
  if (arguments.start == Start::kUniform) {
    FillUniforms(DeriveKey(static_cast<std::uint64_t>(seed), StreamPurpose::kEvaluate, {0, 0}), 0,
                 start.data(), start.size());
    for (double& value : start) value = arguments.search.first_sigma * (2 * value - 1);
  }
  return start;
}

void Search(const Task& task, const Arguments& arguments, const Policy& policy,
            const std::vector<double>& last, PlannedModel& model, int seed) {
  EvaluatorOptions options;
  options.threads = arguments.search.threads;
  Evaluator evaluator(task, policy, model.factors(), options);
  Watcher watcher(&evaluator, static_cast<std::uint32_t>(seed));
  const auto print = [seed](std::int64_t rollouts, double value, const char* what) {
    std::printf("%d,%lld,%.4f,%s\n", seed, static_cast<long long>(rollouts), value, what);
  };
  std::int64_t spent = 0, next_look = 0;
  const PolicySearchResult result = SearchPolicy(
      arguments.search, StartOf(arguments, last, seed), static_cast<std::uint64_t>(seed), 1,
      [&](const CandidateBatch& batch, std::span<double> returns) {
        evaluator.Evaluate(batch.parameters, batch.keys, batch.n_rollouts, batch.first_rollout,
                           returns, {}, batch.relaxed);
      },
      [&](const PolicySearchProgress& now) {
        if (now.runs.empty() && spent > 0) return;  // the final comparison is not part of it
        spent = now.evaluations;
        if (spent < next_look) return;
        next_look = spent + kLookEvery;
        if (watcher.Look(now.runs)) print(spent, watcher.best(), "mean");
      },
      nullptr);
  print(spent, watcher.best(), "end");
  print(result.evaluations, watcher.TrueReturn(result.parameters), "returned");
  std::fflush(stdout);
}

int Main(int argc, char** argv) {
  Arguments arguments;
  CLI::App app("Searches on one fixed model, over seeds");
  AddOptions(&app, &arguments);
  CLI11_PARSE(app, argc, argv);
  const Task task = MakeTask(arguments.task);
  PolicySearchOptions& search = arguments.search;
  if (app.count("--first-sigma") == 0) search.first_sigma = task.search_first_sigma;
  if (app.count("--restart-sigma") == 0) search.restart_sigma = task.search_restart_sigma;
  if (app.count("--restart-decades") == 0) search.restart_decades = task.search_restart_decades;
  search.bound = task.parameter_bound;
  // The policy that ran in the last of the episodes; the origin if that was a random one.
  const auto file = arguments.run / ("policy_" + std::to_string(arguments.episodes) + ".json");
  std::unique_ptr<Policy> policy = MakePolicy(task, PolicyOptions{});
  std::vector<double> last(static_cast<std::size_t>(policy->n_parameters()), 0.0);
  if (std::filesystem::exists(file)) {
    const SavedPolicy saved = ReadPolicy(file);
    policy = MakePolicy(saved, task);
    last = saved.parameters;
  }
  AdaptToStart(last != std::vector<double>(last.size(), 0.0), &search);
  CheckPolicySearchOptions(search, last);
  CheckSearchBudget(search, last, static_cast<std::uint64_t>(arguments.first_seed), 1);
  PlannedModel model = LearnModel(task, arguments, *policy, last);
  std::printf("seed,rollouts,true_return,what\n");
  for (int k = 0; k < arguments.seeds; ++k) {
    Search(task, arguments, *policy, last, model, arguments.first_seed + k);
  }
  return 0;
}

}  // namespace
}  // namespace downpour

int main(int argc, char** argv) {
  return downpour::RunProgram("search_study", downpour::Main, argc, argv);
}
