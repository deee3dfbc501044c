// SPDX-License-Identifier: Apache-2.0
#include <limits>
#include <thread>

#include "engine/gp/dataset.h"
#include "engine/rollout/model_evaluator.h"
#include "tasks/registry.h"
#include "tests/c/c_fixture.h"

namespace downpour {
namespace {

// u = theta_0 features_0 + theta_1, in [-2.5, 2.5] by the limits; P = 2.
int LinearPolicy(void* user_data, int step, int lanes, const double* parameters,
                 const double* features, double* actions) {
  if (user_data != nullptr && step == *static_cast<const int*>(user_data)) return 42;
  for (int l = 0; l < lanes; ++l) actions[l] = parameters[l] * features[l] + parameters[lanes + l];
  return 0;
}

int QuadraticReward(void* user_data, int /*step*/, int lanes, const double* states,
                    const double* actions, double* rewards) {
  for (int l = 0; l < lanes; ++l) {
    rewards[l] = user_data == nullptr ? -states[l] * states[l] - 0.1 * actions[l] * actions[l]
                                      : std::numeric_limits<double>::quiet_NaN();
  }
  return 0;
}

int FailingReward(void* /*user_data*/, int /*step*/, int /*lanes*/, const double* /*states*/,
                  const double* /*actions*/, double* /*rewards*/) {
  return -1;
}

downpour_evaluator_options Pendulum() {
  downpour_evaluator_options options;
  downpour_evaluator_options_init(&options);
  options.task = "pendulum";
  return options;
}

std::shared_ptr<const MultiOutputGp> ToCpp(const CData& d) {
  const std::vector<double>& l = d.lengthscales;
  const std::vector<Hyperparameters> hyperparameters = {
      {{l.begin(), l.begin() + 4}, d.signal_std[0], d.noise_std[0]},
      {{l.begin() + 4, l.end()}, d.signal_std[1], d.noise_std[1]}};
  return std::make_shared<MultiOutputGp>(MakeDataset(d.inputs, 4, d.targets, 2), hyperparameters,
                                         QueryPlanOptions{}, 1);
}

TEST_CASE("C evaluator: returns and rollouts are the bits of the C++ evaluator") {
  const CData data(40);
  const CGp gp = MakeCGp(data);
  for (const bool own : {false, true}) {
    CAPTURE(own);
    downpour_evaluator_options options = Pendulum();
    options.rollouts = 3;
    options.threads = 2;
    BlockFunctions functions;
    if (own) {
      options.policy_function = &LinearPolicy;
      options.reward_function = &QuadraticReward;
      functions.policy = [](int step, int lanes, const double* p, const double* f, double* a) {
        LinearPolicy(nullptr, step, lanes, p, f, a);
      };
      functions.reward = [](int step, int lanes, const double* s, const double* a, double* r) {
        QuadraticReward(nullptr, step, lanes, s, a, r);
      };
    }
    const CEvaluator evaluator = MakeCEvaluator(gp.get(), options);
    const Task task = MakeTask("pendulum");
    const ModelEvaluator cpp(ToCpp(data), task, MakePolicy(task, {}), functions, 3, {});
    downpour_evaluator_size sizes;
    sizes.size = sizeof sizes;
    REQUIRE(downpour_evaluator_sizes(evaluator.get(), &sizes) == DOWNPOUR_OK);
    CHECK(sizes.n_parameters == (own ? 0 : MakePolicy(task, {})->n_parameters()));
    CHECK(sizes.horizon == task.horizon);
    CHECK(sizes.diverged_return == cpp.diverged_return());
    const int dim = own ? 2 : sizes.n_parameters;
    const int n = 70;
    std::vector<double> parameters(n * dim), returns(n * 3), wanted(n * 3);
    FillNormals({1, 2}, 0, parameters.data(), parameters.size());
    cpp.Evaluate(parameters, dim, 5, wanted);
    CHECK(downpour_evaluator_evaluate(evaluator.get(), parameters.data(), n, dim, 5,
                                      returns.data()) == DOWNPOUR_OK);
    CHECK(returns == wanted);

    const int h = sizes.horizon;
    std::vector<double> states(3 * (h + 1) * 2), actions(3 * h), rewards(3 * h);
    CHECK(downpour_evaluator_rollout(evaluator.get(), parameters.data(), dim, 5, states.data(),
                                     actions.data(), rewards.data()) == DOWNPOUR_OK);
    for (int r = 0; r < 3; ++r) {
      double sum = 0;
      for (int t = 0; t < h; ++t) sum += rewards[r * h + t];
      CHECK(sum == wanted[r]);
    }
  }
}

TEST_CASE("C evaluator: without a task, features are the states") {
  CData data(40);
  const CGp gp = MakeCGp(data);  // E = 2 states, so 2 actions
  downpour_evaluator_options options;
  downpour_evaluator_options_init(&options);
  const double start[] = {0.5, -0.5}, limits[] = {1, 2};
  options.policy = "linear";
  options.reward_function = &QuadraticReward;
  options.horizon = 4;
  options.start = start;
  options.action_limits = limits;
  const CEvaluator evaluator = MakeCEvaluator(gp.get(), options);
  downpour_evaluator_size sizes;
  sizes.size = sizeof sizes;
  REQUIRE(downpour_evaluator_sizes(evaluator.get(), &sizes) == DOWNPOUR_OK);
  CHECK(sizes.n_features == 2);
  CHECK(sizes.n_actions == 2);
  CHECK(sizes.n_parameters == 6);
  const std::vector<double> parameters(6, 0.3);
  double states[10], actions[8], rewards[4];
  CHECK(downpour_evaluator_rollout(evaluator.get(), parameters.data(), 6, 0, states, actions,
                                   rewards) == DOWNPOUR_OK);
  CHECK(states[0] == 0.5);
  CHECK(states[1] == -0.5);
  // u = limit kappa(W x + b), kappa(a) = 9/8 sin a + 1/8 sin 3a.
  const double a = 0.3 * 0.5 - 0.3 * 0.5 + 0.3;
  const double squashed = 9. / 8 * std::sin(a) + 1. / 8 * std::sin(3 * a);
  CHECK(actions[0] == doctest::Approx(squashed).epsilon(1e-14));
  CHECK(actions[1] == doctest::Approx(2 * squashed).epsilon(1e-14));
}

TEST_CASE(
    "C evaluator: a callback that fails ends the evaluation, and the evaluator stays usable") {
  const CData data(20);
  const CGp gp = MakeCGp(data);
  int fail_at = 3;
  downpour_evaluator_options options = Pendulum();
  options.policy_function = &LinearPolicy;
  options.user_data = &fail_at;
  const CEvaluator evaluator = MakeCEvaluator(gp.get(), options);
  const double parameters[] = {0.1, 0.2};
  double result = 0;
  const auto evaluate = [&](const downpour_evaluator* of) {
    return downpour_evaluator_evaluate(of, parameters, 1, 2, 0, &result);
  };
  CheckFailure(evaluate(evaluator.get()), DOWNPOUR_CALLBACK_FAILED,
               "policy_function: returned 42 at step 3");
  fail_at = -1;
  CHECK(evaluate(evaluator.get()) == DOWNPOUR_OK);
  options.reward_function = &QuadraticReward;
  CheckFailure(evaluate(MakeCEvaluator(gp.get(), options).get()), DOWNPOUR_INVALID_INPUT,
               "reward: gave nan at step 0, lane 0: must be finite");
  options.reward_function = &FailingReward;
  CheckFailure(evaluate(MakeCEvaluator(gp.get(), options).get()), DOWNPOUR_CALLBACK_FAILED,
               "reward_function: returned -1 at step 0");
}

TEST_CASE("C evaluator: every option that is wrong is told") {
  const CData data(20);
  const CGp gp = MakeCGp(data);
  downpour_evaluator* made = nullptr;
  const double nan = std::numeric_limits<double>::quiet_NaN();
  const double bad_start[] = {0, nan}, bad_limits[] = {0};
  const auto fails = [&](const char* message, const auto& change) {
    downpour_evaluator_options options = Pendulum();
    change(&options);
    CheckFailure(downpour_evaluator_create(gp.get(), &options, &made), DOWNPOUR_INVALID_INPUT,
                 message);
    CHECK(made == nullptr);
  };
  using Options = downpour_evaluator_options;
  fails("options: size = 1", [](Options* o) { o->size = 1; });
  fails("swingup", [](Options* o) { o->task = "swingup"; });
  fails("preset", [](Options* o) { o->preset = "other"; });
  fails("the model has 2 outputs", [](Options* o) { o->task = "cartpole"; });
  fails("options.policy = \"mlp\"", [](Options* o) { o->policy = "mlp"; });
  fails("hidden", [](Options* o) { o->hidden_units = 0; });
  fails("points", [](Options* o) { o->policy = "gp", o->policy_points = -1; });
  fails("options.horizon = -1", [](Options* o) { o->horizon = -1; });
  fails("options.start = nan", [&](Options* o) { o->start = bad_start; });
  fails("options.start_std = nan", [&](Options* o) { o->start_std = bad_start; });
  fails("options.action_limits = 0", [&](Options* o) { o->action_limits = bad_limits; });
  fails("options.rollouts = 0", [](Options* o) { o->rollouts = 0; });
  fails("threads = -1", [](Options* o) { o->threads = -1; });
  fails("options.sample_clamp = -1", [](Options* o) { o->sample_clamp = -1; });
  fails("reward_function, without a task", [](Options* o) { o->task = nullptr; });
  fails("start, without a task",
        [](Options* o) { o->task = nullptr, o->reward_function = &QuadraticReward; });
  downpour_evaluator_options options = Pendulum();
  CheckFailure(downpour_evaluator_create(nullptr, &options, &made), DOWNPOUR_INVALID_INPUT, "gp");
  CheckFailure(downpour_evaluator_create(gp.get(), nullptr, &made), DOWNPOUR_INVALID_INPUT,
               "options: NULL");
  CheckFailure(downpour_evaluator_create(gp.get(), &options, nullptr), DOWNPOUR_INVALID_INPUT,
               "evaluator: NULL");
}

TEST_CASE("C evaluator: arguments of an evaluation that are wrong are told") {
  const CData data(20);
  const CGp gp = MakeCGp(data);
  const CEvaluator evaluator = MakeCEvaluator(gp.get(), Pendulum());
  std::vector<double> parameters(51, 0.1);
  double result = 0;
  const int bad = DOWNPOUR_INVALID_INPUT;
  const auto evaluate = [&](const double* rows, std::int64_t n, int dim, double* to) {
    return downpour_evaluator_evaluate(evaluator.get(), rows, n, dim, 0, to);
  };
  CheckFailure(evaluate(parameters.data(), 1, 7, &result), bad, "parameter vectors of 7");
  CheckFailure(evaluate(nullptr, 1, 51, &result), bad, "parameters: NULL");
  CheckFailure(evaluate(parameters.data(), 1, 51, nullptr), bad, "returns: NULL");
  CheckFailure(evaluate(parameters.data(), -1, 51, &result), bad, "n = -1");
  CheckFailure(evaluate(parameters.data(), 1, 0, &result), bad, "n_parameters = 0");
  CheckFailure(downpour_evaluator_evaluate(nullptr, parameters.data(), 1, 51, 0, &result), bad,
               "evaluator: NULL");
  CheckFailure(downpour_evaluator_rollout(evaluator.get(), parameters.data(), 51, 0, nullptr,
                                          &result, &result),
               bad, "states: NULL");
  parameters[4] = std::numeric_limits<double>::infinity();
  CheckFailure(evaluate(parameters.data(), 1, 51, &result), bad, "parameters[4] = inf");
  CHECK(evaluate(nullptr, 0, 51, nullptr) == DOWNPOUR_OK);
}

TEST_CASE("C evaluator: it outlives the GP that it was made of, and threads may share it") {
  const CData data(20);
  CGp gp = MakeCGp(data);
  downpour_evaluator_options options = Pendulum();
  options.policy_function = &LinearPolicy;
  const CEvaluator evaluator = MakeCEvaluator(gp.get(), options);
  gp.reset();
  const double parameters[] = {0.1, 0.2};
  double wanted = 0;
  REQUIRE(downpour_evaluator_evaluate(evaluator.get(), parameters, 1, 2, 9, &wanted) == 0);
  std::vector<double> results(4);
  std::vector<std::thread> threads;
  for (double& result : results) {
    threads.emplace_back([&] {
      for (int i = 0; i < 20; ++i) {
        downpour_evaluator_evaluate(evaluator.get(), parameters, 1, 2, 9, &result);
      }
    });
  }
  for (std::thread& thread : threads) thread.join();
  for (const double result : results) CHECK(result == wanted);
}

}  // namespace
}  // namespace downpour
