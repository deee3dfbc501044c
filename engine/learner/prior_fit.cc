// SPDX-License-Identifier: Apache-2.0
#include "engine/learner/prior_fit.h"

#include <nlopt.h>

#include <algorithm>
#include <cmath>
#include <exception>
#include <limits>
#include <memory>
#include <new>
#include <string>

#include "engine/errors.h"
#include "kernels/aligned.h"
#include "kernels/philox/philox.h"

namespace downpour {
namespace {

// Likelihoods that hyper-parameters may take at each try: they start at the best ones so far.
constexpr int kInnerEvaluations = 50;
// Shares of a range: the search's first step, and the change at which it ends.
constexpr double kFirstStep = 0.2, kTolerance = 1e-3;

// One fit, as the callback of NLopt sees it; points are shares of the ranges.
struct PriorSearch {
  const DynamicsPrior& prior;
  const std::vector<Transition>& transitions;
  const LearnerOptions& options;
  std::uint32_t episode;
  int threads;
  const std::atomic<bool>* stop;
  std::unique_ptr<PriorPredictor> predictor;
  Dataset data;
  PriorFit best;
  double best_likelihood = -std::numeric_limits<double>::infinity();
  nlopt_opt optimiser = nullptr;
  std::exception_ptr error;
};

std::vector<double> FromShares(const std::vector<PriorParameter>& parameters,
                               std::span<const double> shares) {
  std::vector<double> values;
  for (std::size_t i = 0; i < parameters.size(); ++i) {
    const PriorParameter& p = parameters[i];
    values.push_back(std::clamp(p.low + shares[i] * (p.high - p.low), p.low, p.high));
  }
  return values;
}

// Log likelihood at the parameters, with the best hyper-parameters for them; -infinity if there is
// none.
double Try(const std::vector<double>& parameters, PriorSearch* search) {
  constexpr double kNone = -std::numeric_limits<double>::infinity();
  ++search->best.evaluations;
  search->predictor->SetParameters(parameters);
  search->data.targets = PriorResiduals(search->transitions, search->predictor.get());
  const Eigen::MatrixXd& targets = search->data.targets;
  if (!targets.allFinite() || targets.cwiseAbs().maxCoeff() > Evaluator::kStateLimit) return kNone;
  const GpFitOptions inner = {
      .restarts = 0,
      .max_evaluations = std::min(kInnerEvaluations, search->options.model.max_evaluations)};
  const std::vector<GpFit> fits =
      FitHyperparameters(search->data, search->best.hyperparameters, inner, search->options.seed,
                         search->episode, search->threads, search->stop);
  double likelihood = 0;
  for (const GpFit& fit : fits) likelihood += fit.log_likelihood;
  if (!(likelihood > search->best_likelihood)) return likelihood;
  search->best_likelihood = likelihood;
  search->best.parameters = parameters;
  search->best.hyperparameters.clear();
  for (const GpFit& fit : fits) search->best.hyperparameters.push_back(fit.hyperparameters);
  return likelihood;
}

// No exception may pass through NLopt.
double Objective(unsigned n, const double* shares, double*, void* data) {
  auto& search = *static_cast<PriorSearch*>(data);
  try {
    const double likelihood = Try(FromShares(search.prior.parameters(), {shares, n}), &search);
    return std::isfinite(likelihood) ? -likelihood : HUGE_VAL;
  } catch (...) {
    search.error = std::current_exception();
    nlopt_force_stop(search.optimiser);
    return HUGE_VAL;
  }
}

void SearchFrom(std::vector<double> shares, PriorSearch* search) {
  const auto n = static_cast<unsigned>(shares.size());
  const std::unique_ptr<nlopt_opt_s, decltype(&nlopt_destroy)> optimiser(
      nlopt_create(NLOPT_LN_SBPLX, n), &nlopt_destroy);
  if (optimiser == nullptr) throw std::bad_alloc();
  search->optimiser = optimiser.get();
  nlopt_set_lower_bounds1(optimiser.get(), 0);
  nlopt_set_upper_bounds1(optimiser.get(), 1);
  nlopt_set_initial_step1(optimiser.get(), kFirstStep);
  nlopt_set_xtol_abs1(optimiser.get(), kTolerance);
  nlopt_set_maxeval(optimiser.get(), search->options.prior.evaluations);
  nlopt_set_min_objective(optimiser.get(), Objective, search);
  double minimum = 0;
  nlopt_optimize(optimiser.get(), shares.data(), &minimum);  // `search` has the best point
  if (search->error) std::rethrow_exception(search->error);
}

std::vector<double> Start(const PriorSearch& search, const PriorFit& last, int start) {
  const std::vector<PriorParameter>& parameters = search.prior.parameters();
  std::vector<double> shares(parameters.size());
  if (start > 0) {
    const StreamKey key = DeriveKey(search.options.seed, StreamPurpose::kPriorRestart,
                                    {search.episode, static_cast<std::uint32_t>(start)});
    FillUniforms(key, 0, shares.data(), shares.size());
    return shares;
  }
  for (std::size_t i = 0; i < shares.size(); ++i) {
    const PriorParameter& p = parameters[i];
    const double value = last.parameters.empty() ? p.initial : last.parameters[i];
    shares[i] = std::clamp((value - p.low) / (p.high - p.low), 0.0, 1.0);
  }
  return shares;
}

}  // namespace

Eigen::MatrixXd PriorResiduals(std::span<const Transition> transitions, PriorPredictor* predictor) {
  const std::size_t n_states = transitions.front().observation.size();
  const std::size_t n_actions = transitions.front().action.size();
  const auto n = static_cast<int>(transitions.size());
  AlignedVector<double> states(n_states * kTileLanes), actions(n_actions * kTileLanes);
  Eigen::MatrixXd residuals(n, static_cast<Eigen::Index>(n_states));
  for (int first = 0; first < n; first += kTileLanes) {
    const int n_lanes = std::min(kTileLanes, n - first);
    for (int lane = 0; lane < n_lanes; ++lane) {
      const Transition& t = transitions[first + lane];
      for (std::size_t e = 0; e < n_states; ++e) states[e * kTileLanes + lane] = t.observation[e];
      for (std::size_t a = 0; a < n_actions; ++a) actions[a * kTileLanes + lane] = t.action[a];
    }
    predictor->PredictTile(n_lanes, states.data(), actions.data(), states.data());
    for (int lane = 0; lane < n_lanes; ++lane) {
      const Transition& t = transitions[first + lane];
      for (std::size_t e = 0; e < n_states; ++e) {
        residuals(first + lane, static_cast<Eigen::Index>(e)) =
            t.next_observation[e] - states[e * kTileLanes + lane];
      }
    }
  }
  return residuals;
}

PriorFit FitPrior(const DynamicsPrior& prior, const std::vector<Transition>& transitions,
                  const Eigen::MatrixXd& inputs, const PriorFit& last,
                  const LearnerOptions& options, std::uint32_t episode, int threads,
                  const std::atomic<bool>* stop) {
  PriorSearch search{prior, transitions, options, episode, threads, stop, prior.MakePredictor()};
  search.data.inputs = inputs;
  search.best.hyperparameters = last.hyperparameters;
  if (prior.parameters().empty()) {
    Try({}, &search);
  } else {
    for (int start = 0; start <= options.model.restarts; ++start) {
      SearchFrom(Start(search, last, start), &search);
    }
  }
  if (!std::isfinite(search.best_likelihood)) {
    throw InvalidInput("prior: it predicts a state that is not finite for an observed one, with " +
                       std::to_string(search.best.evaluations) +
                       " parameters tried; must be finite");
  }
  return std::move(search.best);
}

}  // namespace downpour
