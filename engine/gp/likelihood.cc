// SPDX-License-Identifier: Apache-2.0
#include "engine/gp/likelihood.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "engine/gp/checks.h"
#include "kernels/gp_likelihood/gp_likelihood.h"

namespace downpour {

LogLikelihood::LogLikelihood(const Eigen::MatrixXd& inputs, const Eigen::VectorXd& targets)
    : targets_(targets) {
  CheckTrainingData(inputs, targets);
  inputs_ = inputs.rowwise() - inputs.colwise().mean();
  scaled_ = Eigen::MatrixXd::Zero((inputs.rows() + 7) / 8 * 8, inputs.cols());
  scratch_.resize(GpLikelihoodScratch(static_cast<int>(inputs.rows())));
}

double LogLikelihood::operator()(const double* log_parameters, double* gradient) {
  constexpr double kFailure = -std::numeric_limits<double>::infinity();
  const int n = static_cast<int>(inputs_.rows()), dim = static_cast<int>(inputs_.cols());
  if (gradient != nullptr) std::fill_n(gradient, dim + 2, 0.0);
  for (int d = 0; d < dim; ++d) {
    scaled_.col(d).head(n) = inputs_.col(d) * std::exp(-log_parameters[d]);
  }
  const double signal_variance = std::exp(2 * log_parameters[dim]);
  const double noise_variance = std::exp(2 * log_parameters[dim + 1]);
  if (!scaled_.allFinite() || !std::isfinite(signal_variance + noise_variance)) return kFailure;
  const double value =
      GpLikelihood(n, dim, scaled_.data(), static_cast<int>(scaled_.rows()), targets_.data(),
                   signal_variance, noise_variance, scratch_.data(), gradient);
  const auto is_finite = [](double x) { return std::isfinite(x); };
  if (std::isfinite(value) &&
      (gradient == nullptr || std::all_of(gradient, gradient + dim + 2, is_finite))) {
    return value;
  }
  if (gradient != nullptr) std::fill_n(gradient, dim + 2, 0.0);
  return kFailure;
}

}  // namespace downpour
