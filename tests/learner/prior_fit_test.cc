// SPDX-License-Identifier: Apache-2.0
#include "engine/learner/prior_fit.h"

#include <doctest/doctest.h>

#include <atomic>
#include <cmath>
#include <fstream>
#include <limits>
#include <memory>
#include <string>
#include <vector>

#include "engine/learner/checkpoint.h"
#include "engine/learner/csv_tables.h"
#include "engine/learner/prediction.h"
#include "tasks/registry.h"
#include "tests/learner/test_run.h"

namespace downpour {

namespace cartpole {
const char* Mjcf();
}

namespace {

// The point mass as somebody believes it to be, `gain` times as light; `broken`: predicts nothing.
class PointMassPrior final : public DynamicsPrior {
 public:
  explicit PointMassPrior(bool broken = false) : broken_(broken) {}
  std::string Describe() const override { return "position += 0.1 velocity, velocity += gain u"; }
  const std::vector<PriorParameter>& parameters() const override { return parameters_; }
  std::unique_ptr<PriorPredictor> MakePredictor() const override {
    auto predictor = std::make_unique<Predictor>();
    predictor->broken = broken_;
    return predictor;
  }

 private:
  struct Predictor final : PriorPredictor {
    void SetParameters(std::span<const double> values) override { gain = values[0]; }
    void PredictTile(int n, const double* states, const double* actions, double* next) override {
      for (int lane = 0; lane < n; ++lane) {
        const double velocity = states[lane], position = states[kTileLanes + lane];
        next[lane] =
            broken ? std::numeric_limits<double>::quiet_NaN() : velocity + gain * actions[lane];
        next[kTileLanes + lane] = position + 0.1 * velocity;
      }
    }
    double gain = 0;
    bool broken = false;
  };
  std::vector<PriorParameter> parameters_ = {{"gain", "s/kg", 0.02, 0.5, 0.04}};
  bool broken_;
};

Task PointMassTaskWithPrior() {
  Task task = PointMassTask();
  task.prior = std::make_shared<PointMassPrior>();
  return task;
}

LearnerOptions Options(int episodes, int threads = 1) {
  LearnerOptions options = PointMassOptions();
  options.seed = 3;
  options.episodes = episodes;
  options.search.evaluations = 2000;
  options.threads = threads;
  return options;
}

bool SamePrior(const LearnerState& a, const LearnerState& b) {
  bool same = a.episodes.size() == b.episodes.size();
  for (std::size_t i = 0; same && i < a.episodes.size(); ++i) {
    const auto &x = a.episodes[i].prior, &y = b.episodes[i].prior;
    same = x.has_value() == y.has_value() &&
           (!x || (SameBits(x->parameters, y->parameters) && x->evaluations == y->evaluations &&
                   SameBits(x->log_likelihood, y->log_likelihood)));
  }
  return same;
}

// Two episodes with next to no search.
LearnerOptions HardlyAnySearch(int final_rollouts) {
  LearnerOptions options;
  options.episodes = 2;
  options.threads = 2;
  options.search.evaluations = 200;
  options.search.concurrent = 1;
  options.search.final_rollouts = final_rollouts;
  return options;
}

// A cart-pole without noise.
Task NoiselessCartpole() {
  Task task = MakeTask("cartpole");
  task.observation_std.assign(4, 0);
  return task;
}

// The built-in cart-pole as somebody might believe it to be: a lighter pole, no friction, and two
// timesteps a control period.
std::string WrongCartpole() {
  std::string text = cartpole::Mjcf();
  const auto replace = [&](const std::string& old, const std::string& now) {
    const std::size_t at = text.find(old);
    REQUIRE(at != std::string::npos);
    text.replace(at, old.size(), now);
  };
  replace("timestep=\"0.001\"", "timestep=\"0.05\"");
  replace("damping=\"0.1\"", "damping=\"0\"");
  replace("mass=\"0.5\"\n                  diaginertia=\"0.010416666666666667 0.010416666666666667",
          "mass=\"0.3\" diaginertia=\"0.00625 0.00625");
  return text;
}

TEST_CASE("prior_fit: a prior that is the real system leaves no residual, and rollouts are real") {
  LearnerOptions options = HardlyAnySearch(2);
  options.rollout.use_variance = false;
  Task task = MakeTask("pendulum");  // its observations have no noise
  task.prior = task.make_prior("", "");
  const LearnerState state = Run(task, options);
  const auto predictor = task.prior->MakePredictor();
  predictor->SetParameters({});
  const Eigen::MatrixXd residuals = PriorResiduals(state.transitions, predictor.get());
  REQUIRE(residuals.rows() == 80);
  CHECK(residuals.cwiseAbs().maxCoeff() == 0);
  const EpisodeRecord& learnt = state.episodes[1];
  CHECK(learnt.predicted_return == learnt.real_return);
  const auto policy = MakePolicy(task, options.policy);
  const Prediction prediction =
      PredictEpisode(task, options, *policy, state.transitions, learnt, 1);
  CHECK(prediction.mean_return == learnt.real_return);
  CHECK(prediction.trajectories.states[2 * 40 + 1] == state.transitions[79].next_state[1]);
  REQUIRE(learnt.prior.has_value());
  CHECK(learnt.prior->evaluations == 1);
}

TEST_CASE("prior_fit: a wrong mass and damping are recovered from one noise-free episode") {
  const TemporaryDirectory directory;
  const std::string file = (directory.path() / "wrong.xml").string();
  std::ofstream(file) << WrongCartpole();
  Task task = NoiselessCartpole();
  task.prior = task.make_prior(file, "pole:mass=0.1..1, cart:damping=0..0.5");
  const EpisodeRecord learnt = Run(task, HardlyAnySearch(1)).episodes[1];
  REQUIRE(learnt.prior.has_value());
  // The search ends within 1e-3 of the ranges; two timesteps a period are worth as much again, and
  // the residual's model may take a share of what its lengthscales can follow: 1 % of a range.
  CHECK(std::abs(learnt.prior->parameters[0] - 0.5) < 0.01 * 0.9);
  CHECK(std::abs(learnt.prior->parameters[1] - 0.1) < 0.01 * 0.5);
}

TEST_CASE("prior_fit: a gain is recovered from noisy data as well as least squares could") {
  const Task task = PointMassTaskWithPrior();
  const LearnerState state = Run(task, Options(8));
  // d velocity = gain u + noise of two observations: the least-squares error has this spread.
  double squares = 0;
  const std::size_t n = state.transitions.size() - 5;  // known to the last episode's model
  for (std::size_t i = 0; i < n; ++i) {
    squares += state.transitions[i].action[0] * state.transitions[i].action[0];
  }
  const double spread = std::sqrt(2.0) * task.observation_std[0] / std::sqrt(squares);
  const double gain = state.episodes.back().prior->parameters[0];
  CHECK(std::abs(gain - 0.1) < 4 * spread + 1e-3 * 0.48);
  CHECK(spread < 0.01);
}

TEST_CASE("prior_fit: the likelihood is no less than at the start, and that of the model") {
  const Task task = PointMassTaskWithPrior();
  const LearnerState state = Run(task, Options(4));
  LearnerState before = state;
  before.episodes.pop_back();
  before.transitions.resize(15);
  const EpisodeRecord& record = state.episodes.back();
  // The residuals' model once more, output by output.
  const auto predictor = task.prior->MakePredictor();
  const auto likelihood = [&](double gain, const std::vector<Hyperparameters>& parameters) {
    predictor->SetParameters(std::vector{gain});
    const Eigen::MatrixXd targets = PriorResiduals(before.transitions, predictor.get());
    double sum = 0;
    for (int e = 0; e < 2; ++e) {
      Eigen::MatrixXd inputs(15, 3);
      for (int i = 0; i < 15; ++i) {
        const Transition& t = before.transitions[i];
        inputs.row(i) << t.observation[0], t.observation[1], t.action[0];
      }
      sum += ExactGp(inputs, targets.col(e), parameters[e]).log_marginal_likelihood();
    }
    return sum;
  };
  const double found = likelihood(record.prior->parameters[0], record.hyperparameters);
  CHECK(found == doctest::Approx(record.prior->log_likelihood).epsilon(1e-9));
  CHECK(found > likelihood(0.04, record.hyperparameters));
}

TEST_CASE("prior_fit: a run has the same bits for any number of threads") {
  const Task task = PointMassTaskWithPrior();
  const LearnerState one = Run(task, Options(3, 1));
  for (const int threads : {2, 5}) {
    const LearnerState other = Run(task, Options(3, threads));
    CHECK(SameBits(other, one));
    CHECK(SamePrior(other, one));
  }
}

TEST_CASE("prior_fit: a run that is stopped and resumed has the bits of an uninterrupted one") {
  const Task task = PointMassTaskWithPrior();
  const LearnerState whole = Run(task, Options(4));
  LearnerState state;
  for (int episodes = 2; episodes <= 4; ++episodes) {
    const LearnerOptions options = Options(episodes);
    state = Run(task, options, std::move(state));
    state = ParseCheckpoint(task, options, FormatCheckpoint(task, options, state), "c.json");
  }
  CHECK(SameBits(state, whole));
  CHECK(SamePrior(state, whole));
  CHECK(PriorCsv(task, state) == PriorCsv(task, whole));
}

TEST_CASE("prior_fit: a checkpoint is refused with another prior, without one, and the reverse") {
  const Task with = PointMassTaskWithPrior(), without = PointMassTask();
  const LearnerOptions options = Options(2);
  const std::string text = FormatCheckpoint(with, options, Run(with, options));
  const auto error = [](const Task& task, const std::string& checkpoint) {
    return ErrorOf<InvalidInput>([&] { ParseCheckpoint(task, Options(2), checkpoint, "c.json"); });
  };
  CHECK(error(with, text).empty());
  CHECK(Contains(error(without, text), "was made with a prior"));
  const std::string plain = FormatCheckpoint(without, options, Run(without, options));
  CHECK_FALSE(Contains(plain, "prior"));
  CHECK(Contains(error(with, plain), "was made without a prior"));
  Task changed = without;
  changed.prior = MakeTask("cartpole").make_prior("", "");
  CHECK(Contains(error(changed, text), "task.prior"));
}

TEST_CASE("prior_fit: bad priors are refused in one line") {
  Task task = PointMassTask();
  task.prior = std::make_shared<PointMassPrior>(true);
  const std::string none = ErrorOf<InvalidInput>([&] { Run(task, Options(2)); });
  CHECK(Contains(none, "must be finite"));
  LearnerOptions options = Options(2);
  options.prior.evaluations = 0;
  const std::string range =
      ErrorOf<InvalidInput>([&] { Learner(PointMassTaskWithPrior(), options); });
  CHECK(range == "prior.evaluations = 0: must be in [1, 10000]");
}

TEST_CASE("prior_fit: a request to stop interrupts the fit") {
  const Task task = PointMassTaskWithPrior();
  Learner learner(task, Options(2));
  learner.RunEpisode({});
  std::atomic<bool> stop = false;
  Learner::Callbacks callbacks;
  callbacks.stop = &stop;
  callbacks.phase = [&](const std::string& phase) { stop = phase == "model"; };
  CHECK_THROWS_AS(learner.RunEpisode(callbacks), Interrupted);
  CHECK(learner.state().episodes.size() == 1);
}

}  // namespace
}  // namespace downpour
