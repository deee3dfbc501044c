// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <Eigen/Core>
#include <span>
#include <vector>

#include "engine/gp/gp_model.h"
#include "engine/pilco/moments.h"
#include "engine/pilco/se_mean.h"
#include "kernels/aligned.h"

namespace downpour {

// Exact moments of E GPs' latent functions, prior mean zero, at an input N(mean, covariance)
// (Deisenroth & Rasmussen 2011, section 2.2; Deisenroth 2010, section 2.3.2): mean (E), covariance
// with all cross-covariances, slope D x E.
class GpMoments {
 public:
  // What Backward needs of one prediction.
  struct Record {
    std::vector<SeMean> outputs;
    // Derivatives of each pair's E[f_a f_b], a <= b row by row.
    std::vector<Eigen::VectorXd> by_mean;
    std::vector<Eigen::MatrixXd> by_covariance;
  };

  // The model's outputs must share their inputs' number D and, point by point, their inputs. Throws
  // InvalidInput otherwise. Copies what it needs.
  explicit GpMoments(std::span<const ExactGp> model);

  int n_inputs() const { return static_cast<int>(points_.rows()); }
  int n_outputs() const { return static_cast<int>(functions_.size()); }

  // Pairs of outputs are shared out among `threads` OpenMP threads; the numbers do not depend on
  // them. `record` may be nullptr. NaN where rounding left a covariance far from positive
  // semi-definite (SePair). Allocates.
  Moments Predict(const Eigen::VectorXd& mean, const Eigen::MatrixXd& covariance, int threads,
                  Record* record) const;

  // Reverse mode: adds to `input` what `output` (derivatives with respect to Predict's result)
  // comes to. Thread-safe, allocates.
  void Backward(const Record& record, const Moments& result, const Moments& output,
                GaussianAdjoint* input) const;

 private:
  struct Pair {
    int a, b;
  };

  // `centred`: D x n padded with zeros. Derivatives unless they are nullptr.
  double SecondMoment(const Pair& pair, const Eigen::MatrixXd& centred,
                      const Eigen::MatrixXd& covariance, Eigen::VectorXd* by_mean,
                      Eigen::MatrixXd* by_covariance) const;

  Eigen::MatrixXd points_;             // D x n
  std::vector<SeFunction> functions_;  // (E), beta = K^-1 y
  // For SeProductSums: (E) beta; (E) lower triangles of beta beta^T - K^-1, the diagonals halved.
  std::vector<AlignedVector<double>> betas_, weights_;
  std::vector<Pair> pairs_;
};

}  // namespace downpour
