// SPDX-License-Identifier: Apache-2.0
#include <fmt/format.h>
#include <fmt/ranges.h>

#include "tasks/registry.h"
#include "tasks/toml_task/toml_task.h"
#include "tools/downpour/config.h"
#include "tools/downpour/config_search.h"

namespace downpour {
namespace {

std::vector<Field> RunFields(RunConfig& config) {
  LearnerOptions& learner = config.learner;
  return {
      {.key = "task",
       .option = "",
       .target = &config.task,
       .choices = TaskNames(),
       .ending = ".toml",
       .description = "Task to learn, downpour tasks lists them, or the file of one's own."},
      {.key = "task_source",
       .option = "",
       .target = &config.task_source,
       .description = "What task, as a file of a run, is a copy of: --resume refuses if it has "
                      "changed since; empty: nothing."},
      {.key = "preset",
       .option = "--preset",
       .target = &config.preset,
       .choices = {"paper", "original-code"},
       .description = "Reward and noise as in the paper or as in the authors' later code; default: "
                      "the task's own.",
       .saved = !IsTaskFile(config.task)},
      {.key = "mjcf",
       .option = "--mjcf",
       .target = &config.mjcf,
       .description = "MJCF file to use in place of the task's own; empty: the task's own.",
       .option_help = "MJCF file to use in place of the task's own."},
      {.key = "observation_std",
       .option = "",
       .target = &config.observation_std,
       .min = -1,
       .max = 1000,
       .description = "Noise std of every observed state variable, in its own unit; negative: the "
                      "task's own."},
      {.key = "learn.algorithm",
       .option = "--algorithm",
       .target = &learner.algorithm,
       .choices = {kAlgorithmNames.begin(), kAlgorithmNames.end()},
       .description = "black-drops: CMA-ES on rollouts of the model; pilco: gradients of the "
                      "expected return (docs/pilco.md)."},
      {.key = "learn.episodes",
       .option = "--episodes",
       .target = &learner.episodes,
       .min = 2,
       .max = 1000,
       .description = "Episodes on the real system, random ones included."},
      {.key = "learn.random_episodes",
       .option = "--random-episodes",
       .target = &learner.random_episodes,
       .min = 1,
       .max = 999,
       .description = "Episodes of random actions before the first model; fewer than episodes."},
      {.key = "learn.until_solved",
       .option = "--until-solved",
       .target = &learner.until_solved,
       .description = "Stop as soon as an episode solves the task."},
      {.key = "learn.learn_reward",
       .option = "--learn-reward",
       .target = &learner.learn_reward,
       .description = "The reward is unknown to the learner: a Gaussian process learns it from "
                      "observed rewards.",
       .option_help = "The reward is unknown to the learner (the arm's default): a Gaussian "
                      "process learns it from observed rewards."},
      {.key = "learn.seed",
       .option = "--seed",
       .target = &learner.seed,
       .min = 0,
       .max = kMaxSeed,
       .description = "Seed that all random numbers derive from."},
      {.key = "learn.threads",
       .option = "--threads",
       .target = &learner.threads,
       .min = 0,
       .max = 1024,
       .description = "Threads; results do not depend on it; 0: all cores."},
      {.key = "policy.kind",
       .option = "--policy",
       .target = &learner.policy.kind,
       .choices = {kPolicyKindNames.begin(), kPolicyKindNames.end()},
       .description = "nn: neural network; linear: squashed; gp: Gaussian process (PILCO's "
                      "default); dmp: movement primitives, open-loop."},
      {.key = "policy.hidden_units",
       .option = "--hidden",
       .target = &learner.policy.hidden_units,
       .min = 1,
       .max = 256,
       .description = "Units of each hidden layer of the nn policy, e.g. 10 or [16, 16].",
       .option_help = "Units of each hidden layer of the nn policy, e.g. 10 or 16,16."},
      {.key = "policy.activation",
       .option = "",
       .target = &learner.policy.activation,
       .choices = {kActivationNames.begin(), kActivationNames.end()},
       .description = "Activation of the nn policy's hidden layers."},
      {.key = "policy.points",
       .option = "--policy-points",
       .target = &learner.policy.points,
       .min = 0,
       .max = kMaxPolicyPoints,
       .description = "Pseudo-inputs of the gp policy, basis functions of dmp; 0: the task's own "
                      "number."},
      {.key = "model.restarts",
       .option = "",
       .target = &learner.model.restarts,
       .min = 0,
       .max = 100,
       .description = "Random starts of hyper-parameter learning besides the first."},
      {.key = "model.max_evaluations",
       .option = "",
       .target = &learner.model.max_evaluations,
       .min = 1,
       .max = 100000,
       .description = "Likelihood evaluations a start may take."},
      {.key = "model.tolerance",
       .option = "--tolerance",
       .target = &learner.plan.variance_tolerance,
       .min = 0,
       .max = 1,
       .description = "Error that a query's variance may have, a share of it; 0: exact fp64."},
      {.key = "model.mean_tolerance",
       .option = "",
       .target = &learner.plan.mean_tolerance,
       .min = 0,
       .max = 1,
       .description = "Error that a query's mean may have, in standard deviations; 0: exact fp64."},
      {.key = "model.backend",
       .option = "--backend",
       .target = &learner.plan.backend,
       .choices = {kQueryBackendNames.begin(), kQueryBackendNames.end()},
       .description =
           "fused: own kernels within the tolerances; blas: OpenBLAS, always exact fp64."},
  };
}

std::vector<Field> SystemFields(SystemConfig& system) {
  return {
      {.key = "system.program",
       .option = "--system",
       .target = &system.program,
       .description = "\"exec:PROGRAM ARGS\": a program that drives a robot (docs/robot.md); "
                      "empty: the task's simulator.",
       .option_help = "\"exec:PROGRAM ARGS\": a program that drives a robot (docs/robot.md), in "
                      "place of the simulator."},
      {.key = "system.timeout",
       .option = "",
       .target = &system.timeout,
       .min = 0,
       .max = 3600,
       .description =
           "Seconds that a robot may take to answer an action; 0: five control periods."},
      {.key = "system.setup_timeout",
       .option = "",
       .target = &system.setup_timeout,
       .min = 0,
       .max = 86400,
       .above_min = true,
       .description = "Seconds that it may take to get ready for an episode."},
  };
}

std::vector<Field> PriorFields(RunConfig& config) {
  return {
      {.key = "prior.model",
       .option = "--prior",
       .target = &config.prior.model,
       .description = "MJCF file of a simulator that the dynamics are expected to follow "
                      "(docs/priors.md); empty: none.",
       .option_help =
           "MJCF file of a simulator that the dynamics are expected to follow; the model "
           "learns the rest (docs/priors.md)."},
      {.key = "prior.free",
       .option = "--prior-free",
       .target = &config.prior.free,
       .description = "Its parameters to be learnt, e.g. \"pole:mass=0.1..1, cart:damping=0..1\"; "
                      "empty: none."},
      {.key = "prior.evaluations",
       .option = "",
       .target = &config.learner.prior.evaluations,
       .min = 1,
       .max = 10000,
       .description = "Values of its parameters that a start of their search may try."},
  };
}

std::vector<Field> OutputFields(RunConfig& config) {
  return {
      {.key = "output.directory",
       .option = "--out",
       .target = &config.output_directory,
       .description = "New directory for the run; empty: runs/TASK-seedSEED.",
       .option_help = "New directory for the run; left out: runs/TASK-seedSEED.",
       .saved = false},
      {.key = "output.quiet",
       .option = "--quiet",
       .target = &config.quiet,
       .description = "No progress and no table.",
       .saved = false},
      {.key = "output.json",
       .option = "--json",
       .target = &config.json,
       .description = "One JSON object a line and episode on standard output.",
       .saved = false},
  };
}

struct RangeText {
  const Field& field;
  std::string Range(const char* kind) const {
    const bool seed = field.max == kMaxSeed;
    return fmt::format("{} in {}{}, {}]", kind, field.above_min ? '(' : '[', field.min,
                       seed ? "9223372036854775807" : fmt::format("{}", field.max));
  }
  std::string operator()(bool*) const { return "true or false"; }
  std::string operator()(int*) const { return Range("an integer"); }
  std::string operator()(std::int64_t*) const { return Range("an integer"); }
  std::string operator()(std::uint64_t*) const { return Range("an integer"); }
  std::string operator()(double*) const { return Range("a number"); }
  std::string operator()(std::vector<int>*) const { return Range("integers"); }
  std::string operator()(void*) const {
    if (field.choices.empty()) return "a string";
    return fmt::format("one of {}{}", fmt::join(field.choices, ", "),
                       field.ending.empty() ? "" : ", or a file NAME" + field.ending);
  }
};

}  // namespace

std::vector<Field> ConfigFields(RunConfig& config) {
  std::vector<Field> fields = RunFields(config);
  for (const auto& part :
       {SearchFields(config.learner.search), RolloutFields(config.learner.rollout),
        PilcoFields(config.learner.pilco), SystemFields(config.system), PriorFields(config),
        OutputFields(config)}) {
    fields.insert(fields.end(), part.begin(), part.end());
  }
  for (Field& field : fields) {
    field.saved = field.saved && UsesSetting(config.learner.algorithm, field.key);
  }
  return fields;
}

std::string Allowed(const Field& field) { return std::visit(RangeText{field}, field.target); }

}  // namespace downpour
