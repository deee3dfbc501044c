// SPDX-License-Identifier: Apache-2.0
#include "engine/pilco/feature_moments.h"

#include <cmath>

namespace downpour {
namespace {

// cos(angle + quarters pi/2) without rounding the quarter turns.
double Cosine(double angle, int quarters) {
  switch (quarters & 3) {
    case 0:
      return std::cos(angle);
    case 1:
      return -std::sin(angle);
    case 2:
      return -std::cos(angle);
    default:
      return std::sin(angle);
  }
}

// Both trigonometric features are sin(x + quarters pi/2).
int Quarters(const Feature& feature) { return feature.kind == FeatureKind::kCosine ? 1 : 0; }

bool IsTrigonometric(const Feature& feature) { return feature.kind != FeatureKind::kIdentity; }

// exp(h + s) - exp(h), without cancellation for small s and without overflow for large ones.
double ExpDifference(double h, double s) {
  return std::abs(s) < 1 ? std::exp(h) * std::expm1(s) : std::exp(h + s) - std::exp(h);
}

struct OneFeature {
  double mean, slope;            // E g(x), E g'(x)
  double curvature;              // d slope / d mean(x)
  double mean_by_s, slope_by_s;  // derivatives with respect to the variance of x
};

// E exp(i x) = exp(i m - s/2).
OneFeature Expect(const Feature& feature, double m, double s) {
  if (!IsTrigonometric(feature)) return {m, 1, 0, 0, 0};
  const double damping = std::exp(-s / 2);
  const int quarters = Quarters(feature);
  const double mean = damping * Cosine(m, quarters - 1), slope = damping * Cosine(m, quarters);
  return {mean, slope, -mean, -mean / 2, -slope / 2};
}

// Covariance of two trigonometric features, and its derivatives; those with respect to both
// variances are -value / 2.
struct TrigonometricPair {
  double value, by_m1, by_m2, by_s12;
};

// With sines' phases: cov = 1/2 (exp(h + s12) - exp(h)) cos(m1 - m2) - 1/2 (exp(h - s12) - exp(h))
// cos(m1 + m2), h = -(s11 + s22) / 2.
TrigonometricPair Pair(int quarters1, int quarters2, double m1, double m2, double h, double s12) {
  const double difference = m1 - m2, sum = m1 + m2;
  const int q_difference = quarters1 - quarters2, q_sum = quarters1 + quarters2;
  const double plus = ExpDifference(h, s12) / 2, minus = -ExpDifference(h, -s12) / 2;
  const double a = Cosine(difference, q_difference), b = Cosine(sum, q_sum);
  const double by_difference = plus * Cosine(difference, q_difference + 1);
  const double by_sum = minus * Cosine(sum, q_sum + 1);
  return {plus * a + minus * b, by_sum + by_difference, by_sum - by_difference,
          (std::exp(h + s12) * a + std::exp(h - s12) * b) / 2};
}

}  // namespace

Moments FeatureMoments(std::span<const Feature> features, const Eigen::VectorXd& mean,
                       const Eigen::MatrixXd& covariance) {
  const auto n = static_cast<Eigen::Index>(features.size());
  Moments out = ZeroMoments(mean.size(), n);
  for (Eigen::Index f = 0; f < n; ++f) {
    const int i = features[f].state_index;
    const OneFeature one = Expect(features[f], mean[i], covariance(i, i));
    out.mean[f] = one.mean;
    out.slope(i, f) = one.slope;
  }
  for (Eigen::Index f = 0; f < n; ++f) {
    const int i = features[f].state_index;
    for (Eigen::Index g = 0; g <= f; ++g) {
      const int j = features[g].state_index;
      if (IsTrigonometric(features[f]) && IsTrigonometric(features[g])) {
        const double h = -(covariance(i, i) + covariance(j, j)) / 2;
        out.covariance(f, g) = Pair(Quarters(features[f]), Quarters(features[g]), mean[i], mean[j],
                                    h, covariance(i, j))
                                   .value;
      } else {
        // Stein's lemma; the slope of a value is 1.
        out.covariance(f, g) = out.slope(i, f) * covariance(i, j) * out.slope(j, g);
      }
      out.covariance(g, f) = out.covariance(f, g);
    }
  }
  return out;
}

void FeatureMomentsBackward(std::span<const Feature> features, const Eigen::VectorXd& mean,
                            const Eigen::MatrixXd& covariance, const Moments& output,
                            GaussianAdjoint* input) {
  const auto n = static_cast<Eigen::Index>(features.size());
  for (Eigen::Index f = 0; f < n; ++f) {
    const int i = features[f].state_index;
    const OneFeature one = Expect(features[f], mean[i], covariance(i, i));
    double slope = output.slope(i, f);
    for (Eigen::Index g = 0; g < n; ++g) {
      const int j = features[g].state_index;
      const double pair = output.covariance(f, g) + (g == f ? 0 : output.covariance(g, f));
      if (IsTrigonometric(features[f]) && IsTrigonometric(features[g])) {
        if (g > f) continue;
        const double h = -(covariance(i, i) + covariance(j, j)) / 2;
        const TrigonometricPair p = Pair(Quarters(features[f]), Quarters(features[g]), mean[i],
                                         mean[j], h, covariance(i, j));
        input->mean[i] += pair * p.by_m1;
        input->mean[j] += pair * p.by_m2;
        input->covariance(i, j) += pair * p.by_s12;
        input->covariance(i, i) -= pair * p.value / 2;
        input->covariance(j, j) -= pair * p.value / 2;
      } else {
        const OneFeature other = Expect(features[g], mean[j], covariance(j, j));
        // Either feature of the pair takes the share that goes through its own slope.
        slope += pair * covariance(i, j) * other.slope;
        if (g <= f) input->covariance(i, j) += pair * one.slope * other.slope;
      }
    }
    input->mean[i] += output.mean[f] * one.slope + slope * one.curvature;
    input->covariance(i, i) += output.mean[f] * one.mean_by_s + slope * one.slope_by_s;
  }
}

}  // namespace downpour
