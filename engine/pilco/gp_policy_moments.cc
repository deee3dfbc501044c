// SPDX-License-Identifier: Apache-2.0
#include "engine/pilco/gp_policy_moments.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "engine/pilco/se_pair.h"
#include "kernels/gp_policy/gp_policy.h"

namespace downpour {
namespace {

// N_ij = weight beta_a,i beta_b,j Q_ij and what it is made of.
struct PolicyPair {
  SePair se;
  Eigen::MatrixXd a, b;  // F x n
  Eigen::MatrixXd q;     // n x n, with the pair's scale

  PolicyPair(const SeFunction& fa, const SeFunction& fb, const Eigen::MatrixXd& centred,
             const Eigen::MatrixXd& covariance)
      : se(MakeSePair(fa.precisions, fb.precisions, covariance)),
        a(fa.precisions.asDiagonal() * centred),
        b(fb.precisions.asDiagonal() * centred) {
    const Eigen::MatrixXd ga = se.g * a, gb = se.g * b;
    q = ga.transpose() * b;
    q.colwise() += (ga - centred).cwiseProduct(a).colwise().sum().transpose() / 2;
    q.rowwise() += (gb - centred).cwiseProduct(b).colwise().sum() / 2;
    // The exponent of tiny length-scales is a difference of large numbers; its true sign is known.
    q = se.scale * q.array().min(0.0).exp();
  }
};

}  // namespace

GpPolicyMoments::GpPolicyMoments(Eigen::VectorXd input_factors, int n_points, int n_actions)
    : input_factors_(std::move(input_factors)), n_points_(n_points), n_actions_(n_actions) {}

int GpPolicyMoments::n_parameters() const {
  const int dim = static_cast<int>(input_factors_.size());
  return n_points_ * dim + n_actions_ * (n_points_ + dim);
}

void GpPolicyMoments::SetParameters(std::span<const double> parameters) {
  const Eigen::Index dim = input_factors_.size();
  const double* const targets = parameters.data() + n_points_ * dim;
  points_ = Eigen::Map<const Eigen::MatrixXd>(parameters.data(), dim, n_points_);
  log_lengthscales_ =
      Eigen::Map<const Eigen::MatrixXd>(targets + n_actions_ * n_points_, dim, n_actions_);
  functions_.assign(n_actions_, {});
  kernels_.assign(n_actions_, Eigen::MatrixXd(n_points_, n_points_));
  factors_.clear();
  for (int a = 0; a < n_actions_; ++a) {
    functions_[a].precisions = (-2 * log_lengthscales_.col(a)
                                         .array()
                                         .cwiseMax(-kMaxLogLengthscale)
                                         .cwiseMin(kMaxLogLengthscale))
                                   .exp();
    for (int i = 0; i < n_points_; ++i) {
      const Eigen::MatrixXd differences = points_.colwise() - points_.col(i);
      kernels_[a].col(i) =
          (-0.5 * (functions_[a].precisions.transpose() * differences.cwiseAbs2()).array())
              .exp()
              .transpose();
    }
    factors_.emplace_back(kernels_[a] +
                          kGpPolicyNoise * Eigen::MatrixXd::Identity(n_points_, n_points_));
    functions_[a].beta =
        factors_[a].solve(Eigen::Map<const Eigen::VectorXd>(targets + a * n_points_, n_points_));
  }
  adjoints_.assign(n_actions_, {Eigen::VectorXd::Zero(n_points_),
                                Eigen::MatrixXd::Zero(dim, n_points_), Eigen::VectorXd::Zero(dim)});
}

// The moments of GpMoments without tr(K^-1 Q): beta_a^T Q beta_b - mean_a mean_b.
Moments GpPolicyMoments::Predict(const Eigen::VectorXd& mean,
                                 const Eigen::MatrixXd& covariance) const {
  const Eigen::MatrixXd centred = points_.colwise() - input_factors_.cwiseProduct(mean);
  const Eigen::MatrixXd scaled =
      input_factors_.asDiagonal() * covariance * input_factors_.asDiagonal();
  Moments result = ZeroMoments(mean.size(), n_actions_);
  for (int a = 0; a < n_actions_; ++a) {
    const SeMean expected = ExpectSe(functions_[a], centred, scaled);
    result.mean[a] = expected.mean;
    result.slope.col(a) = input_factors_.cwiseProduct(expected.slope);
    for (int b = 0; b <= a; ++b) {
      const PolicyPair pair(functions_[a], functions_[b], centred, scaled);
      const double moment = functions_[a].beta.dot(pair.q * functions_[b].beta);
      result.covariance(a, b) = moment - result.mean[a] * result.mean[b];
      result.covariance(b, a) = result.covariance(a, b);
    }
  }
  return result;
}

void GpPolicyMoments::Backward(const Eigen::VectorXd& mean, const Eigen::MatrixXd& covariance,
                               const Moments& output, GaussianAdjoint* input) {
  const Eigen::MatrixXd centred = points_.colwise() - input_factors_.cwiseProduct(mean);
  const Eigen::MatrixXd scaled =
      input_factors_.asDiagonal() * covariance * input_factors_.asDiagonal();
  GaussianAdjoint scaled_input(mean.size());
  std::vector<SeMean> expected;
  Eigen::VectorXd means(n_actions_);
  for (int a = 0; a < n_actions_; ++a) {
    expected.push_back(ExpectSe(functions_[a], centred, scaled));
    means[a] = expected[a].mean;
  }
  const Eigen::MatrixXd both = output.covariance + output.covariance.transpose();
  const Eigen::VectorXd by_mean = output.mean - both * means;
  for (int a = 0; a < n_actions_; ++a) {
    const Eigen::VectorXd slope = input_factors_.cwiseProduct(output.slope.col(a));
    ExpectSeBackward(functions_[a], expected[a], by_mean[a], slope, &scaled_input, &adjoints_[a]);
    for (int b = 0; b <= a; ++b) {
      BackwardPair(a, b, a == b ? both(a, a) / 2 : both(a, b), centred, scaled, &scaled_input);
    }
  }
  input->mean += input_factors_.cwiseProduct(scaled_input.mean);
  input->covariance +=
      input_factors_.asDiagonal() * scaled_input.covariance * input_factors_.asDiagonal();
}

// weight d(beta_a^T Q beta_b). With z_ij = a_i + b_j, precisions l^-2 = p and the pair's G:
//   d log Q_ij / d nu_i = p_a (G z_ij - nu_i),
//   d log Q_ij / d p_a = -1/2 (nu_i - G z_ij)^2 - 1/2 diag G, and so on for b.
void GpPolicyMoments::BackwardPair(int a, int b, double weight, const Eigen::MatrixXd& centred,
                                   const Eigen::MatrixXd& covariance, GaussianAdjoint* input) {
  const SeFunction &fa = functions_[a], &fb = functions_[b];
  const PolicyPair pair(fa, fb, centred, covariance);
  adjoints_[a].beta += weight * (pair.q * fb.beta);
  adjoints_[b].beta += weight * (pair.q.transpose() * fa.beta);
  const Eigen::MatrixXd n = weight * (fa.beta.asDiagonal() * pair.q * fb.beta.asDiagonal());
  const SePairSums sums{n.rowwise().sum(), n.colwise().sum().transpose(),
                        pair.a * n * pair.b.transpose()};
  Eigen::VectorXd by_mean;
  Eigen::MatrixXd by_covariance;
  SePairDerivatives(pair.se, sums, pair.a, pair.b, &by_mean, &by_covariance);
  input->mean += by_mean;
  input->covariance += by_covariance;

  // Column i: sum_j N_ij G z_ij, and of b: sum_i.
  const Eigen::MatrixXd gz_a =
      pair.se.g * (pair.a * sums.rows.asDiagonal() + pair.b * n.transpose());
  const Eigen::MatrixXd gz_b = pair.se.g * (pair.b * sums.columns.asDiagonal() + pair.a * n);
  const Eigen::MatrixXd nu_a = centred * sums.rows.asDiagonal();
  const Eigen::MatrixXd nu_b = centred * sums.columns.asDiagonal();
  adjoints_[a].points += fa.precisions.asDiagonal() * (gz_a - nu_a);
  adjoints_[b].points += fb.precisions.asDiagonal() * (gz_b - nu_b);
  // sum_ij N_ij (G z_ij)^2 = diag of G sum_ij N_ij z z^T G.
  const Eigen::MatrixXd gz_z = gz_a * pair.a.transpose() + gz_b * pair.b.transpose();
  const Eigen::VectorXd squares =
      (gz_z * pair.se.g).diagonal() + sums.rows.sum() * pair.se.g.diagonal();
  const auto by_precisions = [&](const Eigen::MatrixXd& nu, const Eigen::MatrixXd& gz) {
    return Eigen::VectorXd((gz - nu / 2).cwiseProduct(centred).rowwise().sum() - squares / 2);
  };
  adjoints_[a].log_lengthscales -= 2 * fa.precisions.cwiseProduct(by_precisions(nu_a, gz_a));
  adjoints_[b].log_lengthscales -= 2 * fb.precisions.cwiseProduct(by_precisions(nu_b, gz_b));
}

// beta = (K + 0.01 I)^-1 p: dp = K^-1 dbeta, dK = -dp beta^T.
void GpPolicyMoments::Gradient(std::span<double> gradient) const {
  const Eigen::Index dim = input_factors_.size();
  Eigen::Map<Eigen::MatrixXd> points(gradient.data(), dim, n_points_);
  double* const targets = gradient.data() + n_points_ * dim;
  points.setZero();
  for (int a = 0; a < n_actions_; ++a) {
    const Eigen::VectorXd& precisions = functions_[a].precisions;
    Eigen::Map<Eigen::VectorXd> by_targets(targets + a * n_points_, n_points_);
    by_targets = factors_[a].solve(adjoints_[a].beta);
    const Eigen::MatrixXd by_kernel = -by_targets * functions_[a].beta.transpose();
    const Eigen::MatrixXd t = (by_kernel + by_kernel.transpose()).cwiseProduct(kernels_[a]);
    points += adjoints_[a].points;
    Eigen::VectorXd by_log_lengthscales = adjoints_[a].log_lengthscales;
    for (int i = 0; i < n_points_; ++i) {
      const Eigen::MatrixXd differences = points_.colwise() - points_.col(i);  // z_j - z_i
      points.col(i) += precisions.cwiseProduct(differences * t.col(i));
      by_log_lengthscales += precisions.cwiseProduct(differences.cwiseAbs2() * t.col(i)) / 2;
    }
    for (Eigen::Index d = 0; d < dim; ++d) {
      const bool clipped = std::abs(log_lengthscales_(d, a)) > kMaxLogLengthscale;
      targets[n_actions_ * n_points_ + a * dim + d] = clipped ? 0 : by_log_lengthscales[d];
    }
  }
}

}  // namespace downpour
