// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <Eigen/Dense>
#include <cmath>
#include <numbers>
#include <vector>

#include "engine/gp/hyperparameters.h"
#include "kernels/philox/philox.h"

namespace downpour {

using LongMatrix = Eigen::Matrix<long double, Eigen::Dynamic, Eigen::Dynamic>;
using LongVector = Eigen::Matrix<long double, Eigen::Dynamic, 1>;

// An SE-ARD GP in long double, written out entry by entry (paper Eq. 4-6; Rasmussen & Williams
// 2006, Eq. 5.8 and 5.9).
struct ReferenceGp {
  LongMatrix inputs, noise_free, inverse;
  LongVector targets, alpha;
  Hyperparameters hyper;
  long double log_likelihood = 0;

  ReferenceGp(const Eigen::MatrixXd& x, const Eigen::VectorXd& y, const Hyperparameters& h)
      : inputs(x.cast<long double>()), targets(y.cast<long double>()), hyper(h) {
    const Eigen::Index n = x.rows();
    noise_free.resize(n, n);
    for (Eigen::Index i = 0; i < n; ++i) {
      for (Eigen::Index j = 0; j < n; ++j) noise_free(i, j) = Kernel(inputs.row(i), inputs.row(j));
    }
    const long double noise_variance = static_cast<long double>(h.noise_std) * h.noise_std;
    const LongMatrix k = noise_free + noise_variance * LongMatrix::Identity(n, n);
    const Eigen::LLT<LongMatrix> factor(k);
    inverse = factor.solve(LongMatrix::Identity(n, n));
    alpha = inverse * targets;
    const LongMatrix l = factor.matrixL();
    log_likelihood = -targets.dot(alpha) / 2 - l.diagonal().array().log().sum() -
                     n * std::log(2 * std::numbers::pi_v<long double>) / 2;
  }

  template <typename A, typename B>
  long double Kernel(const A& a, const B& b) const {
    long double distance = 0;
    for (Eigen::Index d = 0; d < inputs.cols(); ++d) {
      const long double delta = (a[d] - b[d]) / hyper.lengthscales[d];
      distance += delta * delta;
    }
    const long double signal_variance =
        static_cast<long double>(hyper.signal_std) * hyper.signal_std;
    return signal_variance * std::exp(-distance / 2);
  }

  // dK_ij/dlog p: p = 0 ... D-1 the lengthscales, D the signal, D + 1 the noise.
  long double Derivative(Eigen::Index p, Eigen::Index i, Eigen::Index j) const {
    const Eigen::Index dim = inputs.cols();
    if (p == dim) return 2 * noise_free(i, j);
    if (p > dim) {
      return i == j ? 2 * static_cast<long double>(hyper.noise_std) * hyper.noise_std : 0;
    }
    const long double delta = (inputs(i, p) - inputs(j, p)) / hyper.lengthscales[p];
    return noise_free(i, j) * delta * delta;
  }

  // 1/2 sum_ij (alpha_i alpha_j - K^-1_ij) dK_ij/dlog p, and, in *magnitude, the sum of the terms'
  // absolute values with x_i^2 + x_j^2 for (x_i - x_j)^2: what rounding errors scale with.
  long double Gradient(Eigen::Index p, long double* magnitude) const {
    long double sum = 0;
    *magnitude = 0;
    for (Eigen::Index i = 0; i < inputs.rows(); ++i) {
      for (Eigen::Index j = 0; j < inputs.rows(); ++j) {
        sum += (alpha[i] * alpha[j] - inverse(i, j)) * Derivative(p, i, j) / 2;
        long double size = std::abs(Derivative(p, i, j));
        if (p < inputs.cols() && i != j) {
          const long double l = hyper.lengthscales[p];
          size = noise_free(i, j) * (inputs(i, p) * inputs(i, p) + inputs(j, p) * inputs(j, p)) /
                 (l * l);
        }
        *magnitude += (std::abs(alpha[i] * alpha[j]) + std::abs(inverse(i, j))) * size;
      }
    }
    return sum;
  }
};

// Bound of K's condition number, as trace(noise-free K) = n sigma_f^2.
inline double ConditionBound(const Hyperparameters& hyper, Eigen::Index n) {
  const double ratio = hyper.signal_std / hyper.noise_std;
  return 1 + n * ratio * ratio;
}

// n x D standard normal numbers, column by column.
inline Eigen::MatrixXd RandomMatrix(Eigen::Index n, Eigen::Index dim, std::uint32_t stream) {
  Eigen::MatrixXd x(n, dim);
  FillNormals({stream, 77}, 0, x.data(), static_cast<std::size_t>(x.size()));
  return x;
}

// Targets drawn from the GP's prior with noise.
inline Eigen::VectorXd DrawTargets(const Eigen::MatrixXd& x, const Hyperparameters& hyper,
                                   std::uint32_t stream) {
  const Eigen::Index n = x.rows();
  const ReferenceGp gp(x, Eigen::VectorXd::Zero(n), hyper);
  const LongMatrix k = gp.noise_free + static_cast<long double>(hyper.noise_std) * hyper.noise_std *
                                           LongMatrix::Identity(n, n);
  const LongMatrix l = Eigen::LLT<LongMatrix>(k).matrixL();
  return (l * RandomMatrix(n, 1, stream).cast<long double>()).cast<double>();
}

inline std::vector<double> LogParameters(const Hyperparameters& hyper) {
  std::vector<double> log_parameters;
  for (const double l : hyper.lengthscales) log_parameters.push_back(std::log(l));
  log_parameters.push_back(std::log(hyper.signal_std));
  log_parameters.push_back(std::log(hyper.noise_std));
  return log_parameters;
}

}  // namespace downpour
