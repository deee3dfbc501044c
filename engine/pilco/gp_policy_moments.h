// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <Eigen/Cholesky>
#include <vector>

#include "engine/pilco/policy_moments.h"
#include "engine/pilco/se_mean.h"

namespace downpour {

// PolicyMoments of the `gp` policy. Its points are few: plain matrices.
class GpPolicyMoments final : public PolicyMoments {
 public:
  // input_factors (F) multiply the features.
  GpPolicyMoments(Eigen::VectorXd input_factors, int n_points, int n_actions);

  int n_parameters() const override;
  void SetParameters(std::span<const double> parameters) override;
  Moments Predict(const Eigen::VectorXd& mean, const Eigen::MatrixXd& covariance) const override;
  void Backward(const Eigen::VectorXd& mean, const Eigen::MatrixXd& covariance,
                const Moments& output, GaussianAdjoint* input) override;
  void Gradient(std::span<double> gradient) const override;

 private:
  void BackwardPair(int a, int b, double weight, const Eigen::MatrixXd& centred,
                    const Eigen::MatrixXd& covariance, GaussianAdjoint* input);

  Eigen::VectorXd input_factors_;
  int n_points_, n_actions_;
  Eigen::MatrixXd points_;                            // F x n
  Eigen::MatrixXd log_lengthscales_;                  // F x A, before they are clipped
  std::vector<SeFunction> functions_;                 // (A)
  std::vector<Eigen::MatrixXd> kernels_;              // (A) n x n, without noise
  std::vector<Eigen::LLT<Eigen::MatrixXd>> factors_;  // (A) of K + 0.01 I
  std::vector<SeFunctionAdjoint> adjoints_;           // (A)
};

}  // namespace downpour
