// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <Eigen/Core>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "engine/pilco/feature_moments.h"
#include "engine/pilco/gp_moments.h"
#include "engine/pilco/policy_moments.h"
#include "engine/pilco/squash_moments.h"
#include "kernels/gp_policy/gp_policy.h"
#include "tests/pilco/monte_carlo.h"
#include "tests/pilco/pilco_fixture.h"

namespace downpour {

inline Eigen::MatrixXd RandomColumns(int rows, int columns, std::uint32_t stream) {
  const std::vector<double> x = RandomNumbers(rows * columns, stream);
  return Eigen::Map<const Eigen::MatrixXd>(x.data(), rows, columns);
}

// A covariance of that rank, 0 included.
inline Eigen::MatrixXd RandomCovariance(int size, int rank, double scale, std::uint32_t stream) {
  if (rank == 0) return Eigen::MatrixXd::Zero(size, size);
  const Eigen::MatrixXd root = scale * RandomColumns(size, rank, stream);
  return root * root.transpose();
}

// One stage of the chain: what it claims, its reverse mode, and the function that it is about.
struct Stage {
  std::string name;
  int n_inputs;
  double spread;  // of inputs, for RandomCovariance
  std::function<Moments(const Eigen::VectorXd&, const Eigen::MatrixXd&)> moments;
  std::function<void(const Eigen::VectorXd&, const Eigen::MatrixXd&, const Moments&,
                     GaussianAdjoint*)>
      backward;
  // Writes values and, of GPs, posterior variances.
  std::function<void(const Eigen::VectorXd&, Eigen::VectorXd*, Eigen::VectorXd*)> function;
};

// Two angles and two values, one variable with all of its features.
inline Stage FeatureStage() {
  const std::vector<Feature> features = {{FeatureKind::kSine, 1},   {FeatureKind::kIdentity, 0},
                                         {FeatureKind::kCosine, 1}, {FeatureKind::kIdentity, 2},
                                         {FeatureKind::kCosine, 2}, {FeatureKind::kSine, 2}};
  return {"features",
          3,
          0.7,
          [=](const Eigen::VectorXd& m, const Eigen::MatrixXd& s) {
            return FeatureMoments(features, m, s);
          },
          [=](const Eigen::VectorXd& m, const Eigen::MatrixXd& s, const Moments& out,
              GaussianAdjoint* in) { FeatureMomentsBackward(features, m, s, out, in); },
          [=](const Eigen::VectorXd& x, Eigen::VectorXd* y, Eigen::VectorXd*) {
            for (std::size_t f = 0; f < features.size(); ++f) {
              const double v = x[features[f].state_index];
              (*y)[static_cast<Eigen::Index>(f)] =
                  features[f].kind == FeatureKind::kSine     ? std::sin(v)
                  : features[f].kind == FeatureKind::kCosine ? std::cos(v)
                                                             : v;
            }
          }};
}

inline Stage SquashStage() {
  const std::vector<double> limits = {2.5, 0.7};
  return {"squash",
          2,
          0.6,
          [=](const Eigen::VectorXd& m, const Eigen::MatrixXd& s) {
            return SquashMoments(limits, m, s);
          },
          [=](const Eigen::VectorXd& m, const Eigen::MatrixXd& s, const Moments& out,
              GaussianAdjoint* in) { SquashMomentsBackward(limits, m, s, out, in); },
          [=](const Eigen::VectorXd& x, Eigen::VectorXd* y, Eigen::VectorXd*) {
            for (int i = 0; i < 2; ++i) {
              (*y)[i] = limits[i] * (9 * std::sin(x[i]) + std::sin(3 * x[i])) / 8;
            }
          }};
}

// An SE-ARD mean function, point by point.
inline double KernelSum(const Eigen::MatrixXd& points, const Eigen::VectorXd& lengthscales,
                        const Eigen::VectorXd& x, const Eigen::VectorXd& weights) {
  double sum = 0;
  for (Eigen::Index i = 0; i < points.rows(); ++i) {
    double distance = 0;
    for (Eigen::Index d = 0; d < x.size(); ++d) {
      const double delta = (points(i, d) - x[d]) / lengthscales[d];
      distance += delta * delta;
    }
    sum += weights[i] * std::exp(-distance / 2);
  }
  return sum;
}

// Three outputs with different hyper-parameters on 11 random points of 3 inputs.
inline std::vector<ExactGp> RandomModel() {
  const Eigen::MatrixXd inputs = RandomColumns(11, 3, 30), targets = RandomColumns(11, 3, 31);
  return {ExactGp(inputs, targets.col(0), {{1.1, 0.7, 2.0}, 1.3, 0.2}),
          ExactGp(inputs, targets.col(1), {{0.8, 1.5, 1.0}, 0.6, 0.1}),
          ExactGp(inputs, targets.col(2), {{3.0, 2.0, 0.9}, 1.0, 0.4})};
}

inline Stage GpStage() {
  const auto model = std::make_shared<std::vector<ExactGp>>(RandomModel());
  const auto gps = std::make_shared<GpMoments>(*model);
  std::vector<Eigen::MatrixXd> inverses;
  for (const ExactGp& gp : *model) {
    const Eigen::MatrixXd l = gp.cholesky();
    inverses.push_back((l * l.transpose()).inverse());
  }
  return {"gp",
          3,
          0.5,
          [=](const Eigen::VectorXd& m, const Eigen::MatrixXd& s) {
            return gps->Predict(m, s, 1, nullptr);
          },
          [=](const Eigen::VectorXd& m, const Eigen::MatrixXd& s, const Moments& out,
              GaussianAdjoint* in) {
            GpMoments::Record record;
            const Moments result = gps->Predict(m, s, 1, &record);
            gps->Backward(record, result, out, in);
          },
          [=](const Eigen::VectorXd& x, Eigen::VectorXd* y, Eigen::VectorXd* variance) {
            double k[11];
            for (int e = 0; e < 3; ++e) {
              const ExactGp& gp = (*model)[e];
              const Hyperparameters& hyper = gp.hyperparameters();
              const double signal = hyper.signal_std * hyper.signal_std;
              double mean = 0, explained = 0;
              for (int i = 0; i < 11; ++i) {
                double distance = 0;
                for (int d = 0; d < 3; ++d) {
                  const double delta = (gp.inputs()(i, d) - x[d]) / hyper.lengthscales[d];
                  distance += delta * delta;
                }
                k[i] = signal * std::exp(-distance / 2);
                mean += k[i] * gp.alpha()[i];
                for (int j = 0; j <= i; ++j) {
                  explained += (i == j ? 1 : 2) * k[i] * inverses[e](i, j) * k[j];
                }
              }
              (*y)[e] = mean;
              (*variance)[e] = signal - explained;
            }
          }};
}

// Policies of three features with scales, two actions.
inline Task PolicyTask() {
  Task task;
  task.features.resize(3);
  task.actions.resize(2);
  task.action_limits = {1, 1};
  task.policy_input_scale = {2, 1, 0.5};
  return task;
}

inline Stage PolicyStage(PolicyKind kind) {
  const Task task = PolicyTask();
  const std::shared_ptr<PolicyMoments> policy =
      MakePolicyMoments(task, {.kind = kind, .points = 5});
  const std::vector<double> theta = RandomNumbers(policy->n_parameters(), 40);
  policy->SetParameters(theta);
  // Another way to the weights of the gp policy: K + 0.01 I inverted.
  Eigen::MatrixXd points(5, 3), lengthscales(3, 2), weights(5, 2);
  if (kind == PolicyKind::kGp) {
    points = Eigen::Map<const Eigen::MatrixXd>(theta.data(), 3, 5).transpose();
    const Eigen::Map<const Eigen::MatrixXd> targets(theta.data() + 15, 5, 2);
    lengthscales = Eigen::Map<const Eigen::ArrayXXd>(theta.data() + 25, 3, 2).exp();
    for (int a = 0; a < 2; ++a) {
      Eigen::MatrixXd k(5, 5);
      for (int i = 0; i < 5; ++i) {
        for (int j = 0; j < 5; ++j) {
          k(i, j) = KernelSum(points.row(i), lengthscales.col(a), points.row(j).transpose(),
                              Eigen::VectorXd::Ones(1)) +
                    (i == j ? kGpPolicyNoise : 0);
        }
      }
      weights.col(a) = k.inverse() * targets.col(a);
    }
  }
  return {kind == PolicyKind::kGp ? "gp policy" : "linear policy",
          3,
          0.6,
          [=](const Eigen::VectorXd& m, const Eigen::MatrixXd& s) { return policy->Predict(m, s); },
          [=](const Eigen::VectorXd& m, const Eigen::MatrixXd& s, const Moments& out,
              GaussianAdjoint* in) { policy->Backward(m, s, out, in); },
          [=](const Eigen::VectorXd& x, Eigen::VectorXd* y, Eigen::VectorXd*) {
            Eigen::VectorXd scaled(3);
            for (int f = 0; f < 3; ++f) scaled[f] = x[f] / task.policy_input_scale[f];
            for (int a = 0; a < 2; ++a) {
              if (kind == PolicyKind::kGp) {
                (*y)[a] = KernelSum(points, lengthscales.col(a), scaled, weights.col(a));
              } else {
                (*y)[a] = theta[6 + a];
                for (int f = 0; f < 3; ++f) (*y)[a] += theta[3 * a + f] * scaled[f];
              }
            }
          }};
}

inline std::vector<Stage> AllStages() {
  return {FeatureStage(), SquashStage(), GpStage(), PolicyStage(PolicyKind::kLinear),
          PolicyStage(PolicyKind::kGp)};
}

// Worst deviation of the stage's moments from `n` samples, in standard errors, at an input whose
// covariance has that rank.
inline double StageDeviation(const Stage& stage, int rank, std::int64_t n) {
  const auto stream = static_cast<std::uint32_t>(50 + rank);
  const Eigen::VectorXd mean = 0.5 * RandomColumns(stage.n_inputs, 1, stream);
  const Eigen::MatrixXd covariance =
      RandomCovariance(stage.n_inputs, rank, stage.spread, stream + 10);
  return WorstDeviation(mean, covariance, stage.moments(mean, covariance), n, stage.function);
}

}  // namespace downpour
