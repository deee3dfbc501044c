// SPDX-License-Identifier: Apache-2.0
#include "engine/learner/checkpoint.h"

#include <algorithm>
#include <array>
#include <cstdint>
#include <limits>
#include <nlohmann/json.hpp>

#include "engine/errors.h"
#include "engine/learner/atomic_file.h"
#include "engine/learner/checksum.h"
#include "engine/learner/json_field.h"
#include "engine/learner/learner_checks.h"
#include "engine/rollout/dynamics_prior.h"
#include "engine/rollout/policy.h"
#include "engine/rollout/reward.h"

namespace downpour {
namespace {

using Json = nlohmann::json;

constexpr const char* kFormat = "downpour checkpoint";
constexpr const char* kPrior = "task.prior";           // a setting of runs with a prior
constexpr const char* kAlgorithm = "learn.algorithm";  // of runs by another than Black-DROPS
constexpr int kMaxInt = std::numeric_limits<int>::max();
constexpr std::int64_t kMaxInt64 = std::numeric_limits<std::int64_t>::max();

// What defines the task, as far as results depend on it.
Json TaskSettings(const Task& task) {
  Json features = Json::array();
  for (const Feature& feature : task.features) {
    features.push_back({static_cast<int>(feature.kind), feature.state_index});
  }
  return {{"task", task.name},
          {"preset", task.preset},
          {"task.model_digest", task.model_digest},
          {"task.features", features},
          {"task.horizon", task.horizon},
          {"task.control_period", JsonNumber(task.control_period)},
          {"task.action_limits", JsonNumbers(task.action_limits)},
          {"task.start_mean", JsonNumbers(task.start_mean)},
          {"task.start_std", JsonNumbers(task.start_std)},
          {"task.observation_std", JsonNumbers(task.observation_std)},
          {"task.policy_input_scale", JsonNumbers(task.policy_input_scale)},
          {"task.reward", task.reward->Describe()}};
}

// All settings that results depend on, by the name the user gives them.
Json Settings(const Task& task, const LearnerOptions& options) {
  static constexpr std::array kRestarts = {"bipop", "small", "ipop", "single"};
  static constexpr std::array kUncertainty = {"off", "sigma", "rollouts", "lra"};
  static constexpr std::array kCovariance = {"auto", "full", "diagonal", "limited-memory"};
  static constexpr std::array kCommonRandomNumbers = {"off", "generation", "search"};
  // Named one by one, so that a new option does not compile until it is here.
  const auto& [algorithm, episodes, random_episodes, until_solved, learn_reward, policy, seed,
               threads, model, prior, plan, search, rollout, pilco] = options;
  const auto& [kind, hidden_units, activation, points, make] = policy;
  const auto& [restarts, max_evaluations] = model;
  const auto& [prior_evaluations] = prior;
  const auto& [variance_tolerance, mean_tolerance, backend] = plan;
  const auto& [use_variance, predict_noise, sample_clamp, rollout_threads] = rollout;
  const auto& [pilco_restarts, pilco_evaluations, pilco_start_std] = pilco;
  const auto& [evaluations, population, rollouts, max_rollouts, concurrent, exploration,
               relaxed_exploration, promotions, local_share, final_rollouts, bound, first_sigma,
               restart_sigma, restart_decades, search_threads, restart_strategy, uncertainty,
               covariance, common_random_numbers, stop_lost_causes] = search;
  // Not compared: how long the run is, and threads.
  static_cast<void>(episodes), static_cast<void>(until_solved), static_cast<void>(threads);
  static_cast<void>(rollout_threads), static_cast<void>(search_threads);
  Json settings = {{"learn.seed", seed},
                   {"learn.random_episodes", random_episodes},
                   {"learn.learn_reward", learn_reward},
                   {"policy.kind", make ? MakePolicy(task, policy)->kind()
                                        : kPolicyKindNames.at(static_cast<std::size_t>(kind))},
                   {"policy.hidden_units", hidden_units},
                   {"policy.activation", kActivationNames.at(static_cast<std::size_t>(activation))},
                   {"policy.points", points},
                   {"model.restarts", restarts},
                   {"model.max_evaluations", max_evaluations},
                   {"model.tolerance", JsonNumber(variance_tolerance)},
                   {"model.mean_tolerance", JsonNumber(mean_tolerance)},
                   {"model.backend", QueryBackendName(backend)},
                   {"rollout.variance", use_variance},
                   {"rollout.predict_noise", predict_noise},
                   {"rollout.sample_clamp", JsonNumber(sample_clamp)},
                   {"search.evaluations", evaluations},
                   {"search.population", population},
                   {"search.rollouts", rollouts},
                   {"search.max_rollouts", max_rollouts},
                   {"search.concurrent", concurrent},
                   {"search.exploration", JsonNumber(exploration)},
                   {"search.relaxed_exploration", relaxed_exploration},
                   {"search.promotions", promotions},
                   {"search.local_share", JsonNumber(local_share)},
                   {"search.final_rollouts", final_rollouts},
                   {"search.bound", JsonNumber(bound)},
                   {"search.first_sigma", JsonNumber(first_sigma)},
                   {"search.restart_sigma", JsonNumber(restart_sigma)},
                   {"search.restart_decades", JsonNumber(restart_decades)},
                   {"search.restarts", kRestarts.at(static_cast<std::size_t>(restart_strategy))},
                   {"search.uncertainty", kUncertainty.at(static_cast<std::size_t>(uncertainty))},
                   {"search.covariance", kCovariance.at(static_cast<std::size_t>(covariance))},
                   {"search.common_random_numbers",
                    kCommonRandomNumbers.at(static_cast<std::size_t>(common_random_numbers))},
                   {"search.stop_lost_causes", stop_lost_causes}};
  if (algorithm != Algorithm::kBlackDrops) {
    settings[kAlgorithm] = kAlgorithmNames.at(static_cast<std::size_t>(algorithm));
    settings["pilco.restarts"] = pilco_restarts;
    settings["pilco.evaluations"] = pilco_evaluations;
    settings["pilco.start_std"] = JsonNumber(pilco_start_std);
    for (auto setting = settings.begin(); setting != settings.end();) {
      setting =
          UsesSetting(algorithm, setting.key()) ? std::next(setting) : settings.erase(setting);
    }
  }
  settings.update(TaskSettings(task));
  if (task.prior != nullptr) {
    settings[kPrior] = task.prior->Describe();
    settings["prior.evaluations"] = prior_evaluations;
  }
  return settings;
}

void CheckSettings(const Json& wanted, const JsonField& found, const std::string& file) {
  if (wanted.contains(kPrior) != found.value().contains(kPrior)) {
    throw InvalidInput(
        file + ": the run was made " + (wanted.contains(kPrior) ? "without" : "with") +
        " a prior, the configuration says " + (wanted.contains(kPrior) ? "with" : "without") +
        " one (prior.model): must be equal to resume");
  }
  const auto compare = [&](const std::string& name, const Json& old, const Json& value) {
    if (old == value) return;
    throw InvalidInput(file + ": the run was made with " + name + " = " + old.dump() +
                       ", the configuration says " + value.dump() + ": must be equal to resume");
  };
  compare(kAlgorithm, found.value().value(kAlgorithm, Json(kAlgorithmNames.front())),
          wanted.value(kAlgorithm, Json(kAlgorithmNames.front())));
  for (const auto& [name, value] : wanted.items()) {
    compare(name, found[name.c_str()].value(), value);
  }
}

Json PriorToJson(const PriorRecord& prior) {
  return {{"parameters", JsonNumbers(prior.parameters)},
          {"log_likelihood", JsonNumber(prior.log_likelihood)},
          {"evaluations", prior.evaluations},
          {"step_nanoseconds", JsonNumber(prior.step_nanoseconds)},
          {"search_share", JsonNumber(prior.search_share)}};
}

Json EpisodeToJson(const EpisodeRecord& record) {
  Json hyperparameters = Json::array();
  for (const Hyperparameters& h : record.hyperparameters) {
    hyperparameters.push_back({{"lengthscales", JsonNumbers(h.lengthscales)},
                               {"signal_std", JsonNumber(h.signal_std)},
                               {"noise_std", JsonNumber(h.noise_std)}});
  }
  Json runs = Json::array();
  for (const RunRecord& run : record.runs) {
    runs.push_back({{"run", run.run},
                    {"large", run.large},
                    {"population", run.population},
                    {"initial_sigma", JsonNumber(run.initial_sigma)},
                    {"evaluations", run.evaluations},
                    {"stop", run.stop},
                    {"mean_return", JsonNumber(run.mean_return)}});
  }
  Json plans = Json::array();
  for (const PlanRecord& plan : record.plans) {
    plans.push_back({{"backend", QueryBackendName(plan.backend)},
                     {"points", plan.points},
                     {"single_precision", plan.single_precision},
                     {"tau", JsonNumber(plan.tau)},
                     {"relative_cost", JsonNumber(plan.relative_cost)},
                     {"variance_error", JsonNumber(plan.variance_error)},
                     {"mean_error", JsonNumber(plan.mean_error)}});
  }
  Json json = {{"episode", record.episode},
               {"random", record.random},
               {"interaction_seconds", JsonNumber(record.interaction_seconds)},
               {"points", record.points},
               {"model_seconds", JsonNumber(record.model_seconds)},
               {"search_seconds", JsonNumber(record.search_seconds)},
               {"rollout_seconds", JsonNumber(record.rollout_seconds)},
               {"evaluations", record.evaluations},
               {"gp_queries", record.gp_queries},
               {"diverged", record.diverged},
               {"lane_fill", JsonNumber(record.lane_fill)},
               {"idle_share", JsonNumber(record.idle_share)},
               {"predicted_return", JsonNumber(record.predicted_return)},
               {"real_return", JsonNumber(record.real_return)},
               {"solved", record.solved},
               {"steps", record.steps},
               {"outcome", record.outcome},
               {"policy", JsonNumbers(record.policy)},
               {"hyperparameters", hyperparameters},
               {"jitter", JsonNumbers(record.jitter)},
               {"plans", plans},
               {"plan_changes", record.plan_changes},
               {"query_nanoseconds", JsonNumbers(record.query_nanoseconds)},
               {"runs", runs},
               {"simd_target", record.platform.simd_target},
               {"blas_core", record.platform.blas_core}};
  if (record.prior) json["prior"] = PriorToJson(*record.prior);
  return json;
}

Json TransitionToJson(const Transition& transition) {
  return {{"episode", transition.episode},
          {"step", transition.step},
          {"observation", JsonNumbers(transition.observation)},
          {"action", JsonNumbers(transition.action)},
          {"next_observation", JsonNumbers(transition.next_observation)},
          {"next_state", JsonNumbers(transition.next_state)},
          {"reward", JsonNumber(transition.reward)}};
}

RunRecord RunFromJson(const JsonField& field) {
  RunRecord run;
  run.run = field["run"].Int(0, kMaxInt);
  run.large = field["large"].Bool();
  run.population = field["population"].Int(0, kMaxInt);
  run.initial_sigma = field["initial_sigma"].Number();
  run.evaluations = field["evaluations"].Integer(0, kMaxInt64);
  run.stop = field["stop"].String();
  run.mean_return = field["mean_return"].Number();
  return run;
}

PlanRecord PlanFromJson(const JsonField& field) {
  PlanRecord plan;
  const std::string backend = field["backend"].String();
  const auto& names = kQueryBackendNames;
  const auto found = std::find(names.begin(), names.end(), backend);
  if (found == names.end()) field["backend"].Fail("one of fused, blas");
  plan.backend = static_cast<QueryBackend>(found - names.begin());
  plan.points = field["points"].Int(1, kMaxInt);
  plan.single_precision = field["single_precision"].Bool();
  plan.tau = field["tau"].Number();
  plan.relative_cost = field["relative_cost"].Number();
  plan.variance_error = field["variance_error"].Number();
  plan.mean_error = field["mean_error"].Number();
  return plan;
}

PriorRecord PriorFromJson(const JsonField& field) {
  PriorRecord prior;
  prior.parameters = field["parameters"].Numbers();
  prior.log_likelihood = field["log_likelihood"].Number();
  prior.evaluations = field["evaluations"].Int(1, kMaxInt);
  prior.step_nanoseconds = field["step_nanoseconds"].Number();
  prior.search_share = field["search_share"].Number();
  return prior;
}

EpisodeRecord EpisodeFromJson(const JsonField& field) {
  EpisodeRecord record;
  record.episode = field["episode"].Int(1, kMaxInt);
  record.random = field["random"].Bool();
  record.interaction_seconds = field["interaction_seconds"].Number();
  record.points = field["points"].Int(0, kMaxInt);
  record.model_seconds = field["model_seconds"].Number();
  record.search_seconds = field["search_seconds"].Number();
  record.rollout_seconds = field["rollout_seconds"].Number();
  record.evaluations = field["evaluations"].Integer(0, kMaxInt64);
  record.gp_queries = field["gp_queries"].Integer(0, kMaxInt64);
  record.diverged = field["diverged"].Integer(0, kMaxInt64);
  record.lane_fill = field["lane_fill"].Number();
  record.idle_share = field["idle_share"].Number();
  record.predicted_return = field["predicted_return"].Number();
  record.real_return = field["real_return"].Number();
  record.solved = field["solved"].Bool();
  record.steps = field["steps"].Int(1, kMaxInt);
  record.outcome = field["outcome"].String();
  record.policy = field["policy"].Numbers();
  for (const JsonField& item : field["hyperparameters"].Items()) {
    record.hyperparameters.push_back(
        {item["lengthscales"].Numbers(), item["signal_std"].Number(), item["noise_std"].Number()});
  }
  record.jitter = field["jitter"].Numbers();
  for (const JsonField& item : field["plans"].Items()) record.plans.push_back(PlanFromJson(item));
  record.plan_changes = field["plan_changes"].Int(0, kMaxInt);
  record.query_nanoseconds = field["query_nanoseconds"].Numbers();
  for (const JsonField& item : field["runs"].Items()) record.runs.push_back(RunFromJson(item));
  if (field.value().contains("prior")) record.prior = PriorFromJson(field["prior"]);
  record.platform = {field["simd_target"].String(), field["blas_core"].String()};
  return record;
}

Transition TransitionFromJson(const JsonField& field) {
  return {.episode = field["episode"].Int(1, kMaxInt),
          .step = field["step"].Int(0, kMaxInt),
          .observation = field["observation"].Numbers(),
          .action = field["action"].Numbers(),
          .next_observation = field["next_observation"].Numbers(),
          .next_state = field["next_state"].Numbers(),
          .reward = field["reward"].Number()};
}

// Throws unless the file is a checkpoint of a version this program reads, as it was written.
void CheckEnvelope(const JsonField& root, const std::string& file) {
  if (root["format"].String() != kFormat) {
    root["format"].Fail("\"" + std::string(kFormat) + "\"");
  }
  const int version = root["version"].Int(1, kMaxInt);
  if (version != kCheckpointVersion) {
    throw InvalidInput(file + ": version " + std::to_string(version) + ", this program reads " +
                       std::to_string(kCheckpointVersion));
  }
  const std::string found = root["checksum"].String();
  const std::string wanted = Checksum(root["payload"].value().dump());
  if (found != wanted) {
    throw InvalidInput(file + ": corrupted: checksum is \"" + wanted + "\", must be " +
                       root["checksum"].value().dump());
  }
}

}  // namespace

std::string FormatCheckpoint(const Task& task, const LearnerOptions& options,
                             const LearnerState& state) {
  Json payload = {{"settings", Settings(task, options)},
                  {"episodes", Json::array()},
                  {"transitions", Json::array()}};
  for (const EpisodeRecord& record : state.episodes) {
    payload["episodes"].push_back(EpisodeToJson(record));
  }
  for (const Transition& transition : state.transitions) {
    payload["transitions"].push_back(TransitionToJson(transition));
  }
  const std::string text = payload.dump();
  return "{\"format\":\"" + std::string(kFormat) +
         "\",\"version\":" + std::to_string(kCheckpointVersion) + ",\"checksum\":\"" +
         Checksum(text) + "\",\n\"payload\":" + text + "}\n";
}

LearnerState ParseCheckpoint(const Task& task, const LearnerOptions& options, std::string_view text,
                             const std::string& file) {
  const Json json = ParseJson(text, file);
  const JsonField root(json, file);
  CheckEnvelope(root, file);
  const JsonField payload = root["payload"];
  CheckSettings(Settings(task, options), payload["settings"], file);
  LearnerState state;
  for (const JsonField& item : payload["episodes"].Items()) {
    state.episodes.push_back(EpisodeFromJson(item));
  }
  for (const JsonField& item : payload["transitions"].Items()) {
    state.transitions.push_back(TransitionFromJson(item));
  }
  try {
    CheckState(task, options, MakePolicy(task, options.policy)->n_parameters(), state);
  } catch (const InvalidInput& error) {
    throw InvalidInput(file + ": " + error.what());
  }
  return state;
}

void WriteCheckpoint(const std::filesystem::path& path, const Task& task,
                     const LearnerOptions& options, const LearnerState& state) {
  WriteFileAtomically(path, FormatCheckpoint(task, options, state));
}

LearnerState ReadCheckpoint(const std::filesystem::path& path, const Task& task,
                            const LearnerOptions& options) {
  return ParseCheckpoint(task, options, ReadFile(path), path.string());
}

}  // namespace downpour
