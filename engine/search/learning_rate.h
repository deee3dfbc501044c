// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <span>

namespace downpour {

// Learning rate of one part of the distribution, kept proportional to the signal-to-noise ratio
// of its updates: M. Nomura, Y. Akimoto and I. Ono, "CMA-ES with Learning Rate Adaptation: Can
// CMA-ES with Default Population Size Solve Multimodal and Noisy Problems?" (GECCO 2023, arXiv
// 2304.03473), section 3. Not thread-safe.
class AdaptiveRate {
 public:
  static constexpr double kMeanDecay = 0.1;         // beta_m
  static constexpr double kCovarianceDecay = 0.03;  // beta_Sigma

  AdaptiveRate(Eigen::Index size, double decay)
      : decay_(decay), average_(Eigen::VectorXd::Zero(size)) {}

  double rate() const { return rate_; }

  // Takes the change (size) that a whole update would make, in the coordinates where the old
  // distribution is N(0, I), and returns the rate for it, in (0, 1].
  double Adapt(std::span<const double> change) {
    const Eigen::Map<const Eigen::VectorXd> delta(change.data(), average_.size());
    average_ = (1 - decay_) * average_ + decay_ * delta;
    square_ = (1 - decay_) * square_ + decay_ * delta.squaredNorm();
    const double signal = average_.squaredNorm(), noise = square_ - signal;
    if (!(noise > 0)) return rate_;  // as long as nothing has changed
    const double ratio = (signal - decay_ / (2 - decay_) * square_) / noise;
    const double relative = std::clamp(ratio / (kTarget * rate_) - 1, -1.0, 1.0);
    rate_ = std::min(1.0, rate_ * std::exp(std::min(kSpeed * rate_, decay_) * relative));
    return rate_;
  }

  template <typename Archive>
  void Visit(Archive& archive) {
    archive(average_);
    archive(square_);
    archive(rate_);
  }

 private:
  static constexpr double kTarget = 1.4;  // alpha: wanted signal-to-noise ratio / rate
  static constexpr double kSpeed = 0.1;   // gamma

  double decay_;             // beta
  Eigen::VectorXd average_;  // E: moving average of the changes
  double square_ = 0;        // V: of their squared norms
  double rate_ = 1;          // eta
};

}  // namespace downpour
