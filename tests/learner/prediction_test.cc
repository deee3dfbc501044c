// SPDX-License-Identifier: Apache-2.0
#include "engine/learner/prediction.h"

#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <numeric>
#include <sstream>

#include "engine/rollout/reward.h"
#include "kernels/aligned.h"
#include "kernels/philox/philox.h"
#include "tests/learner/test_run.h"

namespace downpour {
namespace {

// A finished run of one random and two learnt episodes, whose rollouts queried the exact model.
const Learner& Finished() {
  static const Learner learner = [] {
    LearnerOptions options = PointMassOptions();
    options.episodes = 3;
    options.threads = 1;
    options.plan.variance_tolerance = options.plan.mean_tolerance = 0;
    Learner run(PointMassTask(), options);
    while (!run.done()) run.RunEpisode({});
    return run;
  }();
  return learner;
}

Prediction Predict(int episode, int n_rollouts) {
  const Learner& learner = Finished();
  return PredictEpisode(learner.task(), learner.options(), learner.policy(),
                        learner.state().transitions, learner.state().episodes[episode - 1],
                        n_rollouts);
}

// Standard normal numbers (n) of rollout `rollout` at `step`.
std::vector<double> Normals(StreamKey key, std::uint32_t rollout, std::uint32_t step, int n) {
  const AlignedVector<std::uint32_t> keys0(kTileLanes, key.word0), keys1(kTileLanes, key.word1),
      rollouts(kTileLanes, rollout);
  AlignedVector<double> tile(static_cast<std::size_t>(n) * kTileLanes);
  NormalTile(kTileLanes, keys0.data(), keys1.data(), rollouts.data(), step, n, tile.data());
  std::vector<double> z(n);
  for (int i = 0; i < n; ++i) z[i] = tile[i * kTileLanes];
  return z;
}

TEST_CASE(
    "prediction: the episode's model gives the return that the search predicted, to the bit") {
  const Learner& learner = Finished();
  for (int episode = 2; episode <= 3; ++episode) {
    const EpisodeRecord& record = learner.state().episodes[episode - 1];
    std::vector<QueryFactor> factors;
    for (const ExactGp& gp : EpisodeModel(learner.task(), learner.state().transitions, record)) {
      factors.push_back(gp.Pack());
    }
    Evaluator evaluator(learner.task(), learner.policy(), factors, learner.options().rollout);
    const int n = static_cast<int>(std::min<std::int64_t>(
        learner.options().search.final_rollouts, learner.options().search.evaluations / 45));
    const int first = 0;
    std::vector<double> returns(n);
    const StreamKey key = DeriveKey(learner.options().seed, StreamPurpose::kFinalEvaluation,
                                    {static_cast<std::uint32_t>(episode), 0xFFFFFFFF});
    evaluator.Evaluate(record.policy, {&key, 1}, {&n, 1}, {&first, 1}, returns);
    CHECK(SameBits(std::accumulate(returns.begin(), returns.end(), 0.0) / n,
                   record.predicted_return));
  }
}

TEST_CASE("prediction: trajectories are those of the exact posterior, one step after the other") {
  const Learner& learner = Finished();
  const Task& task = learner.task();
  const EpisodeRecord& record = learner.state().episodes[2];
  const std::vector<ExactGp> model = EpisodeModel(task, learner.state().transitions, record);
  CHECK(model[0].inputs().rows() == 10);
  const StreamKey key = DeriveKey(learner.options().seed, StreamPurpose::kPrediction, {3});
  const Trajectories got = Predict(3, 30).trajectories;
  for (std::uint32_t r = 0; r < 30; ++r) {
    const std::vector<double> z0 = Normals(key, r, 0xFFFFFFFF, 2);
    std::vector<double> state = {task.start_mean[0] + task.start_std[0] * z0[0],
                                 task.start_mean[1] + task.start_std[1] * z0[1]};
    for (int step = 0; step <= task.horizon; ++step) {
      const double* const recorded = &got.states[(r * (task.horizon + 1) + step) * 2];
      // The fused query and the triangular solve round differently; n and a few steps of it.
      for (int e = 0; e < 2; ++e) CHECK(std::abs(recorded[e] - state[e]) <= 1e-9);
      if (step > 0) {
        const double reward = got.rewards[r * task.horizon + step - 1];
        const double* const action = &got.inputs[(r * task.horizon + step - 1) * 3 + 2];
        CHECK(SameBits(reward, ComputeReward(task, step - 1, {recorded, 2}, {action, 1})));
      }
      if (step == task.horizon) break;
      Eigen::VectorXd input(3);
      input << state[0], state[1], 0;
      learner.policy().Act(step, record.policy, state, {&input[2], 1});
      CHECK(std::abs(got.inputs[(r * task.horizon + step) * 3 + 2] - input[2]) <= 1e-9);
      const std::vector<double> z = Normals(key, r, static_cast<std::uint32_t>(step), 2);
      for (int e = 0; e < 2; ++e) {
        double mean, variance;
        model[e].Predict(input, &mean, &variance);
        const double noise = model[e].hyperparameters().noise_std;
        state[e] += mean + std::sqrt(variance + noise * noise) * z[e];
      }
    }
  }
}

TEST_CASE("prediction: rollouts are the same however many there are, and returns are their sums") {
  const Prediction few = Predict(2, 3), many = Predict(2, 200);
  CHECK(std::equal(few.returns.begin(), few.returns.end(), many.returns.begin()));
  CHECK(many.n_diverged == 0);
  const Learner& learner = Finished();
  double sum = 0, squares = 0;
  for (int r = 0; r < 200; ++r) {
    double total = 0;
    for (int step = 0; step < 5; ++step) total += many.trajectories.rewards[r * 5 + step];
    CHECK(SameBits(total, many.returns[r]));
    sum += total;
    squares += total * total;
  }
  CHECK(many.mean_return == doctest::Approx(sum / 200).epsilon(1e-12));
  CHECK(many.return_std ==
        doctest::Approx(std::sqrt((squares - sum * sum / 200) / 199)).epsilon(1e-6));
  // Two samples of the same mean.
  CHECK(std::abs(many.mean_return - learner.state().episodes[1].predicted_return) <=
        5 * many.return_std * std::sqrt(1.0 / 200 + 1.0 / 111));
}

TEST_CASE("prediction: the table ends a rollout that diverged at the step before") {
  const Task task = PointMassTask();
  Prediction prediction = Predict(2, 2);
  const double nan = std::numeric_limits<double>::quiet_NaN();
  for (int step = 3; step < 5; ++step) prediction.trajectories.rewards[step] = nan;
  std::istringstream csv(PredictionCsv(task, prediction));
  std::string line;
  std::getline(csv, line);
  CHECK(line ==
        "rollout,step,time [s],state.velocity [m/s],\"state.position, \"\"x\"\" [m]\","
        "action.force [N],next_state.velocity [m/s],\"next_state.position, \"\"x\"\" [m]\",reward");
  std::vector<std::string> starts;
  while (std::getline(csv, line)) starts.push_back(line.substr(0, 4));
  CHECK(starts ==
        std::vector<std::string>{"0,0,", "0,1,", "0,2,", "1,0,", "1,1,", "1,2,", "1,3,", "1,4,"});
}

}  // namespace
}  // namespace downpour
