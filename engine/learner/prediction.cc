// SPDX-License-Identifier: Apache-2.0
#include "engine/learner/prediction.h"

#include <cmath>
#include <limits>
#include <span>
#include <string_view>

#include "engine/learner/text_format.h"
#include "kernels/philox/philox.h"

namespace downpour {
namespace {

// Sums of rewards and their moments.
void Summarise(int horizon, Prediction* prediction) {
  const std::vector<double>& rewards = prediction->trajectories.rewards;
  double sum = 0;
  int n = 0;
  for (auto row = rewards.begin(); row != rewards.end(); row += horizon) {
    double total = 0;
    for (int step = 0; step < horizon; ++step) total += row[step];
    prediction->returns.push_back(total);
    if (std::isnan(total)) continue;
    sum += total;
    ++n;
  }
  prediction->n_diverged = static_cast<int>(prediction->returns.size()) - n;
  prediction->mean_return = n > 0 ? sum / n : std::numeric_limits<double>::quiet_NaN();
  double squares = 0;
  for (const double value : prediction->returns) {
    if (!std::isnan(value)) squares += std::pow(value - prediction->mean_return, 2);
  }
  prediction->return_std = n > 1 ? std::sqrt(squares / (n - 1)) : 0;
}

void AppendNames(std::string_view prefix, const std::vector<Variable>& variables,
                 std::string* csv) {
  for (const Variable& variable : variables) *csv += ',' + CsvField(ColumnName(prefix, variable));
}

void AppendNumbers(std::span<const double> values, std::string* csv) {
  for (const double value : values) *csv += ',' + CsvField(value);
}

}  // namespace

Prediction PredictEpisode(const Task& task, const LearnerOptions& options, const Policy& policy,
                          const std::vector<Transition>& transitions, const EpisodeRecord& record,
                          int n_rollouts) {
  std::vector<QueryFactor> factors;
  for (const ExactGp& gp : EpisodeModel(task, transitions, record)) factors.push_back(gp.Pack());
  EvaluatorOptions rollout = options.rollout;
  rollout.threads = 1;
  const std::vector<double> prior = record.prior ? record.prior->parameters : std::vector<double>();
  Evaluator evaluator(task, policy, factors, rollout, prior);
  const StreamKey key = DeriveKey(options.seed, StreamPurpose::kPrediction,
                                  {static_cast<std::uint32_t>(record.episode)});
  Prediction prediction;
  prediction.trajectories =
      evaluator.Trace(record.policy, std::span(&key, 1), std::span(&n_rollouts, 1));
  Summarise(task.horizon, &prediction);
  return prediction;
}

std::string PredictionCsv(const Task& task, const Prediction& prediction) {
  const std::size_t n_states = task.n_states(), n_actions = task.n_actions();
  const std::size_t n_inputs = task.n_inputs(), horizon = task.horizon;
  const std::span<const double> states = prediction.trajectories.states;
  const std::span<const double> inputs = prediction.trajectories.inputs;
  std::string csv = "rollout,step,time [s]";
  AppendNames("state.", task.states, &csv);
  AppendNames("action.", task.actions, &csv);
  AppendNames("next_state.", task.states, &csv);
  csv += ",reward\n";
  for (std::size_t r = 0; r < prediction.returns.size(); ++r) {
    for (std::size_t step = 0; step < horizon; ++step) {
      const std::size_t row = r * horizon + step;
      const double reward = prediction.trajectories.rewards[row];
      if (std::isnan(reward)) break;
      csv += std::to_string(r) + ',' + std::to_string(step) + ',' +
             CsvField(static_cast<double>(step) * task.control_period);
      AppendNumbers(states.subspan((row + r) * n_states, n_states), &csv);
      AppendNumbers(inputs.subspan(row * n_inputs + task.n_features(), n_actions), &csv);
      AppendNumbers(states.subspan((row + r + 1) * n_states, n_states), &csv);
      AppendNumbers(std::span(&reward, 1), &csv);
      csv += '\n';
    }
  }
  return csv;
}

}  // namespace downpour
