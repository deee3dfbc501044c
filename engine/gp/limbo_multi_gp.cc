// SPDX-License-Identifier: Apache-2.0
#include "engine/gp/limbo_multi_gp.h"

#include <string>
#include <utility>

#include "engine/errors.h"
#include "engine/gp/checks.h"

namespace downpour {
namespace {

using RowMajor = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

void RequireSize(const char* name, Eigen::Index size, Eigen::Index wanted) {
  if (size == wanted) return;
  throw InvalidInput("GP: " + std::string(name) + " has " + std::to_string(size) +
                     " entries, must have " + std::to_string(wanted));
}

}  // namespace

LimboMultiGp::LimboMultiGp(int dim_in, int dim_out, const LimboMultiGpOptions& options)
    : options_(options) {
  SetDimensions(dim_in, dim_out);
}

void LimboMultiGp::SetDimensions(Eigen::Index dim_in, Eigen::Index dim_out) {
  if (dim_in < 1 || dim_out < 1) {
    throw InvalidInput("GP: " + std::to_string(dim_in) + " inputs and " + std::to_string(dim_out) +
                       " outputs, must be at least 1 of each");
  }
  if (dim_in == dim_in_ && dim_out == dim_out_) return;
  dim_in_ = static_cast<int>(dim_in);
  dim_out_ = static_cast<int>(dim_out);
  const Hyperparameters prior{std::vector<double>(dim_in_, options_.lengthscale),
                              options_.signal_std, options_.noise_std};
  CheckHyperparameters(prior, dim_in_);
  hyperparameters_.assign(dim_out_, prior);
}

Dataset LimboMultiGp::Data() const {
  if (samples_.empty()) throw InvalidInput("GP: no samples: compute or add_sample must come first");
  Dataset data{Eigen::MatrixXd(nb_samples(), dim_in_), observations_matrix()};
  for (int i = 0; i < nb_samples(); ++i) data.inputs.row(i) = samples_[i];
  return data;
}

void LimboMultiGp::compute(const std::vector<Eigen::VectorXd>& samples,
                           const std::vector<Eigen::VectorXd>& observations, bool compute_kernel) {
  if (samples.empty() || samples.size() != observations.size()) {
    throw InvalidInput("GP: " + std::to_string(samples.size()) + " samples and " +
                       std::to_string(observations.size()) +
                       " observations, must be as many and at least 1");
  }
  for (const Eigen::VectorXd& sample : samples) {
    RequireSize("sample", sample.size(), samples.front().size());
  }
  for (const Eigen::VectorXd& observation : observations) {
    RequireSize("observation", observation.size(), observations.front().size());
  }
  SetDimensions(samples.front().size(), observations.front().size());
  samples_ = samples;
  observations_ = observations;
  model_.reset();
  if (compute_kernel) recompute();
}

void LimboMultiGp::recompute() {
  model_ =
      std::make_shared<MultiOutputGp>(Data(), hyperparameters_, options_.plan, options_.threads);
}

void LimboMultiGp::optimize_hyperparams() {
  model_ = std::make_shared<MultiOutputGp>(
      MultiOutputGp::Fit(Data(), options_.plan, options_.seed, options_.threads));
  hyperparameters_.clear();
  for (const ExactGp& gp : model_->exact()) hyperparameters_.push_back(gp.hyperparameters());
}

void LimboMultiGp::set_hyperparameters(std::vector<Hyperparameters> hyperparameters) {
  RequireSize("hyperparameters", static_cast<Eigen::Index>(hyperparameters.size()), dim_out_);
  for (const Hyperparameters& one : hyperparameters) CheckHyperparameters(one, dim_in_);
  hyperparameters_ = std::move(hyperparameters);
  if (model_) recompute();
}

void LimboMultiGp::add_sample(const Eigen::VectorXd& sample, const Eigen::VectorXd& observation) {
  if (dim_in_ < 0) SetDimensions(sample.size(), observation.size());
  RequireSize("sample", sample.size(), dim_in_);
  RequireSize("observation", observation.size(), dim_out_);
  samples_.push_back(sample);
  observations_.push_back(observation);
  recompute();
}

std::tuple<Eigen::MatrixXd, Eigen::MatrixXd> LimboMultiGp::query_batch(
    const Eigen::MatrixXd& v) const {
  if (dim_in_ < 0) throw InvalidInput("GP: dimensions not known: compute must come first");
  RequireSize("query", v.cols(), dim_in_);
  RowMajor means = RowMajor::Zero(v.rows(), dim_out_), variances(v.rows(), dim_out_);
  if (!model_) {
    if (!samples_.empty()) {
      throw InvalidInput("GP: no model: optimize_hyperparams or recompute must come first");
    }
    for (int e = 0; e < dim_out_; ++e) {
      const Hyperparameters& prior = hyperparameters_[e];
      variances.col(e).setConstant(prior.signal_std * prior.signal_std +
                                   prior.noise_std * prior.noise_std);
    }
    return {means, variances};
  }
  const RowMajor rows = v;
  const auto n = static_cast<std::size_t>(means.size());
  model_->Predict({rows.data(), static_cast<std::size_t>(rows.size())}, /*with_noise=*/true,
                  options_.threads, {means.data(), n}, {variances.data(), n});
  return {means, variances};
}

std::tuple<Eigen::VectorXd, Eigen::VectorXd> LimboMultiGp::query(const Eigen::VectorXd& v) const {
  const auto [means, variances] = query_batch(v.transpose());
  return {means.row(0), variances.row(0)};
}

Eigen::VectorXd LimboMultiGp::mu(const Eigen::VectorXd& v) const { return std::get<0>(query(v)); }

Eigen::VectorXd LimboMultiGp::sigma(const Eigen::VectorXd& v) const {
  return std::get<1>(query(v));
}

Eigen::MatrixXd LimboMultiGp::observations_matrix() const {
  Eigen::MatrixXd matrix(nb_samples(), dim_out_ < 0 ? 0 : dim_out_);
  for (int i = 0; i < nb_samples(); ++i) matrix.row(i) = observations_[i];
  return matrix;
}

Eigen::VectorXd LimboMultiGp::mean_observation() const {
  if (dim_out_ < 0) throw InvalidInput("GP: dimensions not known: compute must come first");
  if (observations_.empty()) return Eigen::VectorXd::Zero(dim_out_);
  return observations_matrix().colwise().mean();
}

}  // namespace downpour
