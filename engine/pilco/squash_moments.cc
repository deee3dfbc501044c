// SPDX-License-Identifier: Apache-2.0
#include "engine/pilco/squash_moments.h"

#include <vector>

#include "engine/pilco/feature_moments.h"

namespace downpour {
namespace {

// u = mix sin(spread a): the sines of (a, 3a) are features of a Gaussian of twice the size.
struct Sines {
  Eigen::MatrixXd spread, mix;  // 2A x A, A x 2A
  std::vector<Feature> features;
  Eigen::VectorXd mean;
  Eigen::MatrixXd covariance;

  Sines(std::span<const double> limits, const Eigen::VectorXd& m, const Eigen::MatrixXd& s) {
    const Eigen::Index n = m.size();
    spread = Eigen::MatrixXd::Zero(2 * n, n);
    mix = Eigen::MatrixXd::Zero(n, 2 * n);
    for (Eigen::Index i = 0; i < n; ++i) {
      spread(i, i) = 1;
      spread(n + i, i) = 3;
      mix(i, i) = 9 * limits[i] / 8;
      mix(i, n + i) = limits[i] / 8;
    }
    for (int i = 0; i < 2 * n; ++i) features.push_back({FeatureKind::kSine, i});
    mean = spread * m;
    covariance = spread * s * spread.transpose();
  }
};

}  // namespace

Moments SquashMoments(std::span<const double> limits, const Eigen::VectorXd& mean,
                      const Eigen::MatrixXd& covariance) {
  const Sines sines(limits, mean, covariance);
  const Moments m = FeatureMoments(sines.features, sines.mean, sines.covariance);
  return {sines.mix * m.mean, sines.mix * m.covariance * sines.mix.transpose(),
          sines.spread.transpose() * m.slope * sines.mix.transpose()};
}

void SquashMomentsBackward(std::span<const double> limits, const Eigen::VectorXd& mean,
                           const Eigen::MatrixXd& covariance, const Moments& output,
                           GaussianAdjoint* input) {
  const Sines sines(limits, mean, covariance);
  const Moments m{sines.mix.transpose() * output.mean,
                  sines.mix.transpose() * output.covariance * sines.mix,
                  sines.spread * output.slope * sines.mix};
  GaussianAdjoint doubled(sines.mean.size());
  FeatureMomentsBackward(sines.features, sines.mean, sines.covariance, m, &doubled);
  input->mean += sines.spread.transpose() * doubled.mean;
  input->covariance += sines.spread.transpose() * doubled.covariance * sines.spread;
}

}  // namespace downpour
