// SPDX-License-Identifier: Apache-2.0
#include "engine/pilco/gp_moments.h"

#include <cmath>
#include <cstddef>
#include <numbers>

#include "engine/errors.h"
#include "engine/parallel_for.h"
#include "engine/pilco/se_pair.h"
#include "kernels/se_product/se_product.h"

namespace downpour {
namespace {

Eigen::Index Padded(Eigen::Index n) {
  return (n + kSeProductPad - 1) / kSeProductPad * kSeProductPad;
}

// The aligned arrays of one SeProduct.
struct ProductArrays {
  using Vector = Eigen::Map<Eigen::VectorXd>;
  using Matrix = Eigen::Map<Eigen::MatrixXd>;
  int dim, ld;
  AlignedVector<double> numbers;
  double* scratch;
  Vector u, v, rows, columns;
  Matrix p, b, moments;  // D x ld, ld x D, D x ld: Eigen's are column by column

  ProductArrays(Eigen::Index n_inputs, Eigen::Index n_padded)
      : dim(static_cast<int>(n_inputs)),
        ld(static_cast<int>(n_padded)),
        numbers(SeProductScratch(ld) + static_cast<std::size_t>(ld) * (4 + 3 * dim)),
        scratch(numbers.data()),
        u(At(0), ld),
        v(At(1), ld),
        rows(At(2), ld),
        columns(At(3), ld),
        p(At(4), dim, ld),
        b(At(4 + dim), ld, dim),
        moments(At(4 + 2 * dim), dim, ld) {}

  double* At(int row) {
    return scratch + SeProductScratch(ld) + static_cast<std::size_t>(row) * ld;
  }
  SeProduct Product(int n) const {
    return {
        .n = n, .dim = dim, .ld = ld, .u = u.data(), .v = v.data(), .p = p.data(), .b = b.data()};
  }
  SeProductResult Result(bool all) {
    if (!all) return {.rows = rows.data()};
    return {rows.data(), columns.data(), moments.data()};
  }
};

}  // namespace

GpMoments::GpMoments(std::span<const ExactGp> model) {
  if (model.empty()) throw InvalidInput("GP moments: the model has no outputs");
  points_ = model[0].inputs().transpose();
  const Eigen::Index n = points_.cols();
  for (const ExactGp& gp : model) {
    if (gp.inputs().rows() != n || gp.inputs().cols() != points_.rows() ||
        gp.inputs() != model[0].inputs()) {
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
    const Eigen::MatrixXd weights =
        function.beta * function.beta.transpose() - root.transpose() * root;
    const Eigen::Index ld = Padded(n);
    weights_.emplace_back(static_cast<std::size_t>(ld * ld));
    betas_.emplace_back(static_cast<std::size_t>(ld));
    for (Eigen::Index i = 0; i < n; ++i) {
      betas_.back()[i] = function.beta[i];
      for (Eigen::Index j = 0; j < i; ++j) weights_.back()[i * ld + j] = weights(i, j);
      weights_.back()[i * ld + i] = weights(i, i) / 2;
    }
    functions_.push_back(std::move(function));
  }
  for (int a = 0; a < n_outputs(); ++a) {
    for (int b = a; b < n_outputs(); ++b) pairs_.push_back({a, b});
  }
}

// E[f_a f_b] = beta_a^T Q beta_b, less tr(K_a^-1 Q) where a = b (Deisenroth & Rasmussen 2011, Eq.
// 16-20, less what Predict adds).
double GpMoments::SecondMoment(const Pair& pair, const Eigen::MatrixXd& centred,
                               const Eigen::MatrixXd& covariance, Eigen::VectorXd* by_mean,
                               Eigen::MatrixXd* by_covariance) const {
  const SeFunction &fa = functions_[pair.a], &fb = functions_[pair.b];
  const SePair se = MakeSePair(fa.precisions, fb.precisions, covariance);
  if (!std::isfinite(se.scale)) return se.scale;
  const Eigen::MatrixXd a = fa.precisions.asDiagonal() * centred;
  const Eigen::MatrixXd b = fb.precisions.asDiagonal() * centred;
  ProductArrays arrays(centred.rows(), centred.cols());
  // -log2 Q_ij = u_i + v_j + p_i . b_j.
  const double log2_e = std::numbers::log2e;
  arrays.p = (-log2_e * se.g) * a;
  arrays.b = b.transpose();
  arrays.u = (arrays.p + log2_e * centred).cwiseProduct(a).colwise().sum().transpose() / 2;
  arrays.v =
      ((-log2_e * se.g) * b + log2_e * centred).cwiseProduct(b).colwise().sum().transpose() / 2;
  SeProduct product = arrays.Product(static_cast<int>(points_.cols()));
  if (pair.a == pair.b) {
    product.weights = weights_[pair.a].data();
  } else {
    product.row_weights = betas_[pair.a].data();
    product.column_weights = betas_[pair.b].data();
  }
  SeProductSums(product, arrays.scratch, arrays.Result(by_mean != nullptr));

  const double scale = se.scale * fa.signal_variance * fb.signal_variance;
  SePairSums sums{scale * arrays.rows, scale * arrays.columns,
                  scale * (a * arrays.moments.transpose())};
  // The lower triangle, the diagonal halved, stands for both.
  const bool triangle = pair.a == pair.b;
  const double value = (triangle ? 2 : 1) * sums.rows.sum();
  if (by_mean == nullptr) return value;
  if (triangle) {
    sums.rows += sums.columns;
    sums.columns = sums.rows;
    sums.products += sums.products.transpose().eval();
  }
  SePairDerivatives(se, sums, a, b, by_mean, by_covariance);
  return value;
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
  Eigen::MatrixXd padded = Eigen::MatrixXd::Zero(n_inputs(), Padded(points_.cols()));
  padded.leftCols(points_.cols()) = centred;
  ParallelFor(n_pairs, threads, [&](int p) {
    const auto [a, b] = pairs_[p];
    double moment = SecondMoment(pairs_[p], padded, covariance,
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
