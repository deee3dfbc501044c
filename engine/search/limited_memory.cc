// SPDX-License-Identifier: Apache-2.0
#include "engine/search/limited_memory.h"

#include <algorithm>
#include <cmath>

// Algorithm 1 of arXiv 1705.06693.
namespace downpour {

LimitedMemory::LimitedMemory(const StrategyParameters&, int dimension, int population)
    : std_(Eigen::VectorXd::Ones(dimension)) {
  const int m = 4 + static_cast<int>(std::floor(3 * std::log(dimension)));
  directions_.setZero(dimension, m);
  c_d_.resize(m);
  c_c_.resize(m);
  for (int i = 0; i < m; ++i) {
    // The rules are for P far above lambda and above 10; the bounds hold the rates elsewhere.
    c_d_[i] = std::min(1 / (std::pow(1.5, i) * dimension), 0.1);
    c_c_[i] = std::min(population / (std::pow(4.0, i) * dimension), 0.5);
  }
}

void LimitedMemory::Transform(const Eigen::MatrixXd& z, Eigen::MatrixXd* y) const {
  *y = z;
  // Directions that no generation has reached yet are left out.
  const auto used = std::min<Eigen::Index>(n_updates_, directions_.cols());
  for (Eigen::Index c = 0; c < z.cols(); ++c) {
    auto step = y->col(c);
    for (Eigen::Index i = 0; i < used; ++i) {
      const auto direction = directions_.col(i);
      step = (1 - c_d_[i]) * step + c_d_[i] * direction.dot(step) * direction;
    }
  }
}

void LimitedMemory::Update(const CovarianceUpdate& update) {
  ++n_updates_;
  for (Eigen::Index i = 0; i < directions_.cols(); ++i) {
    directions_.col(i) =
        (1 - c_c_[i]) * directions_.col(i) +
        std::sqrt(update.parameters.mu_eff * c_c_[i] * (2 - c_c_[i])) * update.step_z;
  }
  std_ = (update.y.rowwise().squaredNorm() / static_cast<double>(update.y.cols())).cwiseSqrt();
}

}  // namespace downpour
