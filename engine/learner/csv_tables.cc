// SPDX-License-Identifier: Apache-2.0
#include "engine/learner/csv_tables.h"

#include <limits>
#include <string_view>

#include "engine/learner/text_format.h"
#include "engine/rollout/dynamics_prior.h"

namespace downpour {
namespace {

// Appends a row of fields that are ready to write.
void AppendRow(const std::vector<std::string>& fields, std::string* csv) {
  for (std::size_t i = 0; i < fields.size(); ++i) {
    if (i > 0) *csv += ',';
    *csv += fields[i];
  }
  *csv += '\n';
}

void AppendNumbers(const std::vector<double>& values, std::vector<std::string>* row) {
  for (const double value : values) row->push_back(CsvField(value));
}

void AppendNames(std::string_view prefix, const std::vector<Variable>& variables,
                 std::vector<std::string>* row) {
  for (const Variable& variable : variables) {
    row->push_back(CsvField(ColumnName(prefix, variable)));
  }
}

const char* Boolean(bool value) { return value ? "true" : "false"; }

}  // namespace

std::string EpisodesCsv(const LearnerState& state) {
  std::string csv =
      "episode,random,interaction_seconds [s],points,evaluations [rollouts],gp_queries,"
      "diverged [rollouts],predicted_return,return,solved,steps,outcome\n";
  for (const EpisodeRecord& record : state.episodes) {
    AppendRow({std::to_string(record.episode), Boolean(record.random),
               CsvField(record.interaction_seconds), std::to_string(record.points),
               std::to_string(record.evaluations), std::to_string(record.gp_queries),
               std::to_string(record.diverged), CsvField(record.predicted_return),
               CsvField(record.real_return), Boolean(record.solved), std::to_string(record.steps),
               CsvField(record.outcome)},
              &csv);
  }
  return csv;
}

std::string TimingCsv(const std::vector<Variable>& outputs, const LearnerState& state) {
  constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
  std::vector<std::string> header = {"episode",
                                     "model_seconds [s]",
                                     "search_seconds [s]",
                                     "gp_queries_per_second [1/s]",
                                     "rollout_seconds [s]",
                                     "lane_fill",
                                     "idle_share",
                                     "rollout_time_per_gp_query [ns]"};
  for (const Variable& output : outputs) {
    header.push_back(CsvField(ColumnName("gp_query_time.", {output.name, "ns"})));
  }
  std::string csv;
  AppendRow(header, &csv);
  for (const EpisodeRecord& record : state.episodes) {
    const auto queries = static_cast<double>(record.gp_queries);
    const double rate = record.gp_queries > 0 ? queries / record.search_seconds : kNaN;
    std::vector<std::string> row = {
        std::to_string(record.episode),   CsvField(record.model_seconds),
        CsvField(record.search_seconds),  CsvField(rate),
        CsvField(record.rollout_seconds), CsvField(record.lane_fill),
        CsvField(record.idle_share),      CsvField(RolloutNanosecondsPerQuery(record))};
    AppendNumbers(record.query_nanoseconds.empty() ? std::vector<double>(outputs.size(), kNaN)
                                                   : record.query_nanoseconds,
                  &row);
    AppendRow(row, &csv);
  }
  return csv;
}

std::string TransitionsCsv(const Task& task, const LearnerState& state) {
  std::vector<std::string> header = {"episode", "step", "time [s]"};
  AppendNames("observation.", task.states, &header);
  AppendNames("action.", task.actions, &header);
  AppendNames("next_observation.", task.states, &header);
  AppendNames("next_state.", task.states, &header);
  header.push_back("reward");
  std::string csv;
  AppendRow(header, &csv);
  for (const Transition& transition : state.transitions) {
    std::vector<std::string> row = {std::to_string(transition.episode),
                                    std::to_string(transition.step),
                                    CsvField(transition.step * task.control_period)};
    AppendNumbers(transition.observation, &row);
    AppendNumbers(transition.action, &row);
    AppendNumbers(transition.next_observation, &row);
    AppendNumbers(transition.next_state, &row);
    row.push_back(CsvField(transition.reward));
    AppendRow(row, &csv);
  }
  return csv;
}

std::string HyperparametersCsv(const Task& task, const std::vector<Variable>& outputs,
                               const LearnerState& state) {
  std::vector<Variable> inputs = task.feature_names;
  inputs.insert(inputs.end(), task.actions.begin(), task.actions.end());
  std::string csv = "episode,output,hyperparameter,unit,value\n";
  for (const EpisodeRecord& record : state.episodes) {
    for (std::size_t e = 0; e < record.hyperparameters.size(); ++e) {
      const Hyperparameters& parameters = record.hyperparameters[e];
      const Variable& output = outputs[e];
      const auto append = [&](const std::string& name, const std::string& unit, double value) {
        AppendRow({std::to_string(record.episode), CsvField(output.name), CsvField(name),
                   CsvField(unit), CsvField(value)},
                  &csv);
      };
      for (std::size_t d = 0; d < parameters.lengthscales.size(); ++d) {
        append("lengthscale." + inputs[d].name, inputs[d].unit, parameters.lengthscales[d]);
      }
      append("signal_std", output.unit, parameters.signal_std);
      append("noise_std", output.unit, parameters.noise_std);
      append("jitter", "1", record.jitter[e]);
    }
  }
  return csv;
}

std::string PlansCsv(const std::vector<Variable>& outputs, const LearnerState& state) {
  std::string csv =
      "episode,output,backend,n,points,precision,tau,relative_cost,variance_error,mean_error,"
      "changes\n";
  for (const EpisodeRecord& record : state.episodes) {
    for (std::size_t e = 0; e < record.plans.size(); ++e) {
      const PlanRecord& plan = record.plans[e];
      AppendRow({std::to_string(record.episode), CsvField(outputs[e].name),
                 QueryBackendName(plan.backend), std::to_string(record.points),
                 std::to_string(plan.points), plan.single_precision ? "fp32" : "fp64",
                 CsvField(plan.tau), CsvField(plan.relative_cost), CsvField(plan.variance_error),
                 CsvField(plan.mean_error), std::to_string(record.plan_changes)},
                &csv);
    }
  }
  return csv;
}

std::string PriorCsv(const Task& task, const LearnerState& state) {
  std::vector<std::string> header = {"episode", "points", "log_likelihood", "evaluations"};
  for (const PriorParameter& parameter : task.prior->parameters()) {
    header.push_back(CsvField(ColumnName("", {parameter.name, parameter.unit})));
  }
  std::string csv;
  AppendRow(header, &csv);
  for (const EpisodeRecord& record : state.episodes) {
    if (!record.prior) continue;
    std::vector<std::string> row = {std::to_string(record.episode), std::to_string(record.points),
                                    CsvField(record.prior->log_likelihood),
                                    std::to_string(record.prior->evaluations)};
    AppendNumbers(record.prior->parameters, &row);
    AppendRow(row, &csv);
  }
  return csv;
}

std::string PriorTimingCsv(const LearnerState& state) {
  std::string csv = "episode,step_time [ns],rollout_share\n";
  for (const EpisodeRecord& record : state.episodes) {
    if (!record.prior) continue;
    AppendRow({std::to_string(record.episode), CsvField(record.prior->step_nanoseconds),
               CsvField(record.prior->search_share)},
              &csv);
  }
  return csv;
}

}  // namespace downpour
