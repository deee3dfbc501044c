// SPDX-License-Identifier: Apache-2.0
#include "engine/gp/likelihood.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include "engine/gp/checks.h"
#include "engine/gp/triangle.h"
#include "engine/lapack.h"
#include "engine/single_threaded_blas.h"
#include "kernels/se_ard/se_ard.h"

namespace downpour {

LogLikelihood::LogLikelihood(const Eigen::MatrixXd& inputs, const Eigen::VectorXd& targets) {
  CheckTrainingData(inputs, targets);
  const Eigen::Index n = inputs.rows(), dim = inputs.cols();
  inputs_.resize(n, dim + 1);
  inputs_.leftCols(dim) = inputs.rowwise() - inputs.colwise().mean();
  inputs_.col(dim).setOnes();
  targets_ = targets;
  scaled_.resize(n, dim);
  covariance_.resize(n, n);
  factor_.resize(n, n);
  alpha_.resize(n);
  product_.resize(n, dim + 1);
}

double LogLikelihood::operator()(const double* log_parameters, double* gradient) {
  const SingleThreadedBlas single_threaded;
  const Eigen::Index n = scaled_.rows(), n_parameters = scaled_.cols() + 2;
  if (gradient != nullptr) std::fill_n(gradient, n_parameters, 0.0);
  constexpr double kFailure = -std::numeric_limits<double>::infinity();
  if (!Factorise(log_parameters)) return kFailure;

  const double half_log_determinant = factor_.diagonal().array().log().sum();
  const double value = -0.5 * targets_.dot(alpha_) - half_log_determinant -
                       0.5 * static_cast<double>(n) * std::log(2 * std::numbers::pi);
  if (!std::isfinite(value)) return kFailure;
  if (gradient == nullptr) return value;

  Gradient(log_parameters, gradient);
  if (!Eigen::Map<Eigen::VectorXd>(gradient, n_parameters).allFinite()) {
    std::fill_n(gradient, n_parameters, 0.0);
    return kFailure;
  }
  return value;
}

// Leaves K in covariance_, L in factor_ and K^-1 y in alpha_; false where there is no L.
bool LogLikelihood::Factorise(const double* log_parameters) {
  const int n = static_cast<int>(scaled_.rows()), dim = static_cast<int>(scaled_.cols());
  for (int d = 0; d < dim; ++d) {
    scaled_.col(d) = inputs_.col(d) * std::exp(-log_parameters[d]);
  }
  const double signal_variance = std::exp(2 * log_parameters[dim]);
  const double noise_variance = std::exp(2 * log_parameters[dim + 1]);
  if (!scaled_.allFinite() || !std::isfinite(signal_variance + noise_variance)) return false;
  SeArdCovarianceLower(n, dim, scaled_.data(), n, signal_variance, covariance_.data(), n);
  for (int j = 0; j < n; ++j) {
    factor_.col(j).tail(n - j) = covariance_.col(j).tail(n - j);
    factor_(j, j) += noise_variance;
  }
  int info = 0;
  dpotrf_("L", &n, factor_.data(), &n, &info);
  if (info != 0) return false;
  alpha_ = targets_;
  const int one = 1;
  dpotrs_("L", &n, &one, factor_.data(), &n, alpha_.data(), &n, &info);
  return true;
}

// dL/dlog p = 1/2 tr((alpha alpha^T - K^-1) dK/dlog p) (Rasmussen & Williams, Eq. 5.9), with
// W = (alpha alpha^T - K^-1) o K_noise-free and, X' = [X 1],
//   sum_ij W_ij (x_i - x_j)^2 = 2 (sum_i (W 1)_i x_i^2 - x^T W x), both from the product W X'.
void LogLikelihood::Gradient(const double* log_parameters, double* gradient) {
  const int n = static_cast<int>(scaled_.rows()), dim = static_cast<int>(scaled_.cols());
  int info = 0;
  InvertLowerTriangle(n, factor_.data(), n);
  dlauum_("L", &n, factor_.data(), &n, &info);  // K^-1 = L^-T L^-1
  const double noise_variance = std::exp(2 * log_parameters[dim + 1]);
  gradient[dim + 1] = noise_variance * (alpha_.squaredNorm() - factor_.trace());

  double diagonal_sum = 0;
  for (int j = 0; j < n; ++j) {
    auto column = factor_.col(j).tail(n - j);
    column = (alpha_.tail(n - j) * alpha_[j] - column).cwiseProduct(covariance_.col(j).tail(n - j));
    diagonal_sum += column[0];
    // The diagonal cancels in the sum above; left out, its rounding does not swamp the rest.
    column[0] = 0;
  }
  const double one = 1, zero = 0;
  const int columns = dim + 1;
  dsymm_("L", "L", &n, &columns, &one, factor_.data(), &n, inputs_.data(), &n, &zero,
         product_.data(), &n);
  const auto row_sums = product_.col(dim).array();
  gradient[dim] = diagonal_sum + row_sums.sum();
  for (int d = 0; d < dim; ++d) {
    const auto x = inputs_.col(d).array();
    gradient[d] =
        (x * (row_sums * x - product_.col(d).array())).sum() * std::exp(-2 * log_parameters[d]);
  }
}

}  // namespace downpour
