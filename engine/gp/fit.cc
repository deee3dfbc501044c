// SPDX-License-Identifier: Apache-2.0
#include <nlopt.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <memory>
#include <new>
#include <string>

#include "engine/errors.h"
#include "engine/gp/checks.h"
#include "engine/gp/gp_model.h"
#include "engine/gp/likelihood.h"
#include "engine/parallel_for.h"
#include "kernels/philox/philox.h"

namespace downpour {
namespace {

// Logarithms of the units in which one output's search is laid out.
struct LogScales {
  std::vector<double> input_std;  // (D)
  double output_rms = 0;
};

// One start's search, as the callback of NLopt sees it.
struct StartSearch {
  LogLikelihood* likelihood = nullptr;
  const LogScales* scales = nullptr;
  const std::atomic<bool>* stop = nullptr;
  nlopt_opt optimiser = nullptr;
  int evaluations = 0;
  double best_penalised = -std::numeric_limits<double>::infinity();
  double best_likelihood = 0;
  std::vector<double> best_parameters;
};

std::vector<double> LogInputStd(const Eigen::MatrixXd& inputs) {
  std::vector<double> log_std;
  for (Eigen::Index d = 0; d < inputs.cols(); ++d) {
    const Eigen::VectorXd centred = inputs.col(d).array() - inputs.col(d).mean();
    const double denominator = std::sqrt(std::max<double>(1, inputs.rows() - 1));
    const double std = centred.stableNorm() / denominator;
    // A spread within rounding of the values is that of a constant.
    const bool constant = std <= 1e-12 * inputs.col(d).cwiseAbs().maxCoeff();
    log_std.push_back(constant ? 0.0 : std::log(std));
  }
  return log_std;
}

double LogOutputRms(const Eigen::MatrixXd& targets, int output) {
  const double rms = targets.col(output).stableNorm() / std::sqrt(targets.rows());
  return std::log(std::max(rms, 1e-12));
}

// Subtracts one term ((log ratio) / log limit)^30 of the curb; adds the curb's derivative with
// respect to log ratio to *derivative.
double CurbTerm(double log_ratio, double limit, double* derivative) {
  constexpr int kPower = 30;
  const double slope = 1 / std::log(limit), x = log_ratio * slope;
  const double lower_power = std::pow(x, kPower - 1);
  *derivative = kPower * lower_power * slope;
  return lower_power * x;
}

// PILCO's curb (Deisenroth et al., hypCurb):
//   sum_d ((log l_d - log std x_d)/log 100)^30 + ((log sigma_f - log sigma_n)/log 500)^30.
// `gradient` is lowered by the curb's.
double Curb(const LogScales& scales, const double* parameters, double* gradient) {
  const std::size_t dim = scales.input_std.size();
  double curb = 0, derivative = 0;
  for (std::size_t d = 0; d < dim; ++d) {
    curb += CurbTerm(parameters[d] - scales.input_std[d], 100, &derivative);
    gradient[d] -= derivative;
  }
  curb += CurbTerm(parameters[dim] - parameters[dim + 1], 500, &derivative);
  gradient[dim] -= derivative;
  gradient[dim + 1] += derivative;
  return curb;
}

bool IsSet(const std::atomic<bool>* stop) { return stop != nullptr && stop->load(); }

// Minus the penalised log likelihood. Keeps the best point itself: NLopt loses it when it ends with
// a failure code. Where there is no likelihood it is infinite, and the line search backs off.
double Objective(unsigned n, const double* x, double* gradient, void* data) {
  auto& search = *static_cast<StartSearch*>(data);
  if (IsSet(search.stop)) {
    nlopt_force_stop(search.optimiser);
    std::fill_n(gradient, n, 0.0);
    return HUGE_VAL;
  }
  ++search.evaluations;
  const double likelihood = (*search.likelihood)(x, gradient);
  const double penalised = likelihood - Curb(*search.scales, x, gradient);
  for (unsigned i = 0; i < n; ++i) gradient[i] = -gradient[i];
  if (penalised > search.best_penalised) {
    search.best_penalised = penalised;
    search.best_likelihood = likelihood;
    search.best_parameters.assign(x, x + n);
  }
  return std::isfinite(penalised) ? -penalised : HUGE_VAL;
}

std::vector<double> DefaultStart(const LogScales& scales) {
  std::vector<double> start = scales.input_std;
  start.push_back(scales.output_rms);
  start.push_back(scales.output_rms - std::log(10.0));
  return start;
}

// The default times log-uniform factors: 1/10 to 10 for lengthscales and noise, a root of that for
// the signal.
std::vector<double> RandomStart(const LogScales& scales, StreamKey key) {
  std::vector<double> start = DefaultStart(scales);
  std::vector<double> uniforms(start.size());
  FillUniforms(key, 0, uniforms.data(), uniforms.size());
  const std::size_t signal = scales.input_std.size();
  for (std::size_t i = 0; i < start.size(); ++i) {
    const double decades = i == signal ? 0.5 : 1;
    start[i] += std::log(10.0) * decades * (2 * uniforms[i] - 1);
  }
  return start;
}

std::vector<double> LogParameters(const Hyperparameters& hyperparameters) {
  std::vector<double> parameters;
  for (const double l : hyperparameters.lengthscales) parameters.push_back(std::log(l));
  parameters.push_back(std::log(hyperparameters.signal_std));
  parameters.push_back(std::log(hyperparameters.noise_std));
  return parameters;
}

Hyperparameters FromLogParameters(const std::vector<double>& parameters) {
  const std::size_t dim = parameters.size() - 2;
  Hyperparameters hyperparameters;
  for (std::size_t d = 0; d < dim; ++d) {
    hyperparameters.lengthscales.push_back(std::exp(parameters[d]));
  }
  hyperparameters.signal_std = std::exp(parameters[dim]);
  hyperparameters.noise_std = std::exp(parameters[dim + 1]);
  return hyperparameters;
}

StartSearch Maximise(const Dataset& data, int output, const LogScales& scales,
                     std::vector<double> parameters, int max_evaluations,
                     const std::atomic<bool>* stop) {
  LogLikelihood likelihood(data.inputs, data.targets.col(output));
  StartSearch search;
  search.likelihood = &likelihood;
  search.scales = &scales;
  search.stop = stop;
  search.best_parameters = parameters;

  const double decade = std::log(10.0);
  std::vector<double> lower = scales.input_std, upper = lower;
  for (double& bound : lower) bound -= 3 * decade;
  for (double& bound : upper) bound += 3 * decade;
  lower.insert(lower.end(), {scales.output_rms - 4 * decade, scales.output_rms - 6 * decade});
  upper.insert(upper.end(), {scales.output_rms + 4 * decade, scales.output_rms + 2 * decade});
  for (std::size_t i = 0; i < parameters.size(); ++i) {
    parameters[i] = std::clamp(parameters[i], lower[i], upper[i]);
  }

  const std::unique_ptr<nlopt_opt_s, decltype(&nlopt_destroy)> optimiser(
      nlopt_create(NLOPT_LD_LBFGS, static_cast<unsigned>(parameters.size())), &nlopt_destroy);
  if (optimiser == nullptr) throw std::bad_alloc();
  search.optimiser = optimiser.get();
  nlopt_set_lower_bounds(optimiser.get(), lower.data());
  nlopt_set_upper_bounds(optimiser.get(), upper.data());
  nlopt_set_maxeval(optimiser.get(), max_evaluations);
  nlopt_set_ftol_abs(optimiser.get(), 1e-5);
  nlopt_set_min_objective(optimiser.get(), Objective, &search);
  double minimum = 0;
  nlopt_optimize(optimiser.get(), parameters.data(), &minimum);  // `search` has the best point
  return search;
}

void CheckRange(int value, int low, int high, const std::string& name) {
  if (value >= low && value <= high) return;
  throw InvalidInput("GP fit: " + name + " is " + std::to_string(value) + ", must be in [" +
                     std::to_string(low) + ", " + std::to_string(high) + "]");
}

void CheckArguments(const Dataset& data, const std::vector<Hyperparameters>& warm_start,
                    const GpFitOptions& options, int threads) {
  CheckTrainingData(data.inputs, data.targets);
  CheckRange(options.restarts, 0, 100, "restarts");
  CheckRange(options.max_evaluations, 1, 100000, "max_evaluations");
  CheckRange(threads, 1, std::numeric_limits<int>::max(), "threads");
  if (!warm_start.empty() && static_cast<int>(warm_start.size()) != data.n_outputs()) {
    throw InvalidInput("GP fit: warm_start has " + std::to_string(warm_start.size()) +
                       " entries, must have " + std::to_string(data.n_outputs()) +
                       ", one an output, or none");
  }
  for (const Hyperparameters& entry : warm_start) CheckHyperparameters(entry, data.n_inputs());
}

// The best of one output's searches; ties go to the first.
GpFit Best(const StartSearch* searches, int n_starts, int output) {
  GpFit fit;
  int best = 0;
  for (int s = 0; s < n_starts; ++s) {
    fit.evaluations += searches[s].evaluations;
    if (searches[s].best_penalised > searches[best].best_penalised) best = s;
  }
  if (!std::isfinite(searches[best].best_penalised)) {
    throw InvalidInput("GP fit: output " + std::to_string(output) +
                       " has no finite likelihood at any start; data must be of ordinary size");
  }
  fit.hyperparameters = FromLogParameters(searches[best].best_parameters);
  fit.log_likelihood = searches[best].best_likelihood;
  return fit;
}

}  // namespace

std::vector<GpFit> FitHyperparameters(const Dataset& data,
                                      const std::vector<Hyperparameters>& warm_start,
                                      const GpFitOptions& options, std::uint64_t seed,
                                      std::uint32_t episode, int threads,
                                      const std::atomic<bool>* stop, int first_output) {
  CheckArguments(data, warm_start, options, threads);
  const int n_outputs = data.n_outputs(), n_starts = options.restarts + 1;
  std::vector<LogScales> scales(n_outputs);
  for (int e = 0; e < n_outputs; ++e) {
    scales[e] = {LogInputStd(data.inputs), LogOutputRms(data.targets, e)};
  }

  const auto search = [&](int output, int start) {
    std::vector<double> parameters;
    if (start > 0) {
      const StreamKey key = DeriveKey(seed, StreamPurpose::kModelRestart,
                                      {episode, static_cast<std::uint32_t>(first_output + output),
                                       static_cast<std::uint32_t>(start)});
      parameters = RandomStart(scales[output], key);
    } else {
      parameters =
          warm_start.empty() ? DefaultStart(scales[output]) : LogParameters(warm_start[output]);
    }
    return Maximise(data, output, scales[output], std::move(parameters), options.max_evaluations,
                    stop);
  };

  const int n_tasks = n_outputs * n_starts;
  std::vector<StartSearch> searches(n_tasks);
  ParallelFor(n_tasks, std::min(threads, n_tasks),
              [&](int task) { searches[task] = search(task / n_starts, task % n_starts); });
  if (IsSet(stop)) throw Interrupted();

  std::vector<GpFit> fits;
  for (int e = 0; e < n_outputs; ++e) fits.push_back(Best(&searches[e * n_starts], n_starts, e));
  return fits;
}

}  // namespace downpour
