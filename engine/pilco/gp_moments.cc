// SPDX-License-Identifier: Apache-2.0
#include "engine/pilco/gp_moments.h"

#include <cmath>

#include "engine/errors.h"
#include "engine/parallel_for.h"
#include "engine/pilco/se_pair.h"

namespace downpour {

GpMoments::GpMoments(std::span<const ExactGp> model) {
  if (model.empty()) throw InvalidInput("GP moments: the model has no outputs");
  points_ = model[0].inputs().transpose();
  const Eigen::Index n = points_.cols();
  for (const ExactGp& gp : model) {
    if (gp.inputs() != model[0].inputs()) {
      throw InvalidInput("GP moments: the outputs' models must have the same inputs");
    }
    SeFunction function;
    function.beta = gp.alpha();
    const auto& hyper = gp.hyperparameters();
    function.precisions =
        Eigen::Map<const Eigen::ArrayXd>(hyper.lengthscales.data(), points_.rows())
            .square()
            .inverse();
    function.signal_variance = hyper.signal_std * hyper.signal_std;
    const auto l = gp.cholesky().triangularView<Eigen::Lower>();
    const Eigen::MatrixXd root = l.solve(Eigen::MatrixXd::Identity(n, n));
    weights_.push_back(function.beta * function.beta.transpose() - root.transpose() * root);
    functions_.push_back(std::move(function));
  }
  for (int a = 0; a < n_outputs(); ++a) {
    for (int b = a; b < n_outputs(); ++b) pairs_.push_back({a, b});
  }
}

// E[f_a f_b] = beta_a^T Q beta_b, less tr(K_a^-1 Q) where a = b.
double GpMoments::SecondMoment(const Pair& pair, const Eigen::MatrixXd& centred,
                               const Eigen::MatrixXd& covariance, Eigen::VectorXd* by_mean,
                               Eigen::MatrixXd* by_covariance) const {
  const SeFunction &fa = functions_[pair.a], &fb = functions_[pair.b];
  const SePair se = MakeSePair(fa.precisions, fb.precisions, covariance);
  const Eigen::MatrixXd a = fa.precisions.asDiagonal() * centred;
  const Eigen::MatrixXd b = fb.precisions.asDiagonal() * centred;
  const Eigen::MatrixXd ga = se.g * a, gb = se.g * b;
  const Eigen::VectorXd u =
      (ga.cwiseProduct(a) - centred.cwiseProduct(a)).colwise().sum().transpose() / 2;
  const Eigen::VectorXd v =
      (gb.cwiseProduct(b) - centred.cwiseProduct(b)).colwise().sum().transpose() / 2;
  Eigen::MatrixXd n = ga.transpose() * b;
  n.colwise() += u;
  n.rowwise() += v.transpose();
  n = n.array().exp() * (se.scale * fa.signal_variance * fb.signal_variance);
  if (pair.a == pair.b) {
    n.array() *= weights_[pair.a].array();
  } else {
    n = fa.beta.asDiagonal() * n * fb.beta.asDiagonal();
  }
  const SePairSums sums{n.rowwise().sum(), n.colwise().sum().transpose(), a * n * b.transpose()};
  if (by_mean != nullptr) SePairDerivatives(se, sums, a, b, by_mean, by_covariance);
  return sums.rows.sum();
}

Moments GpMoments::Predict(const Eigen::VectorXd& mean, const Eigen::MatrixXd& covariance,
                           int threads, Record* record) const {
  const Eigen::MatrixXd centred = points_.colwise() - mean;
  Moments result = ZeroMoments(n_inputs(), n_outputs());
  std::vector<SeMean> outputs;
  for (int e = 0; e < n_outputs(); ++e) {
    outputs.push_back(ExpectSe(functions_[e], centred, covariance));
    result.mean[e] = outputs[e].mean;
    result.slope.col(e) = outputs[e].slope;
  }
  const int n_pairs = static_cast<int>(pairs_.size());
  if (record != nullptr) {
    record->by_mean.resize(pairs_.size());
    record->by_covariance.resize(pairs_.size());
  }
  ParallelFor(n_pairs, threads, [&](int p) {
    const auto [a, b] = pairs_[p];
    double moment = SecondMoment(pairs_[p], centred, covariance,
                                 record == nullptr ? nullptr : &record->by_mean[p],
                                 record == nullptr ? nullptr : &record->by_covariance[p]);
    if (a == b) moment += functions_[a].signal_variance;
    result.covariance(a, b) = moment - result.mean[a] * result.mean[b];
    result.covariance(b, a) = result.covariance(a, b);
  });
  if (record != nullptr) record->outputs = std::move(outputs);
  return result;
}

void GpMoments::Backward(const Record& record, const Moments& result, const Moments& output,
                         GaussianAdjoint* input) const {
  // covariance_ab = E[f_a f_b] - mean_a mean_b.
  const Eigen::VectorXd mean =
      output.mean - (output.covariance + output.covariance.transpose()) * result.mean;
  for (std::size_t p = 0; p < pairs_.size(); ++p) {
    const auto [a, b] = pairs_[p];
    const double weight =
        a == b ? output.covariance(a, a) : output.covariance(a, b) + output.covariance(b, a);
    input->mean += weight * record.by_mean[p];
    input->covariance += weight * record.by_covariance[p];
  }
  for (int e = 0; e < n_outputs(); ++e) {
    ExpectSeBackward(functions_[e], record.outputs[e], mean[e], output.slope.col(e), input,
                     nullptr);
  }
}

}  // namespace downpour
