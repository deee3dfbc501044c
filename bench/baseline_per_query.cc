// SPDX-License-Identifier: Apache-2.0
// Compiled for this machine, as the authors' program is. Eigen's alignment then differs from that
// of all other files: under a name of its own, its functions cannot be mixed up with theirs.
#define Eigen EigenNative
#include "bench/baseline_per_query.h"

#include <Eigen/Cholesky>
#include <Eigen/Dense>
#include <cmath>
#include <limits>
#include <vector>

namespace downpour {

struct PerQueryGp::Model {
  std::vector<Eigen::VectorXd> points;
  Eigen::VectorXd lengthscales;
  double signal_variance;
  Eigen::MatrixXd cholesky;
  Eigen::VectorXd alpha;

  double Kernel(const Eigen::VectorXd& a, const Eigen::VectorXd& b) const {
    const double z = (a - b).cwiseQuotient(lengthscales).squaredNorm();
    return signal_variance * std::exp(-0.5 * z);
  }
};

PerQueryGp::PerQueryGp(int n, int dim, const double* inputs, const double* lengthscales,
                       double signal_std, const double* cholesky, const double* alpha) {
  auto model = std::make_unique<Model>();
  const Eigen::Map<const Eigen::MatrixXd> points(inputs, n, dim);
  for (int i = 0; i < n; ++i) model->points.push_back(points.row(i).transpose());
  model->lengthscales = Eigen::Map<const Eigen::VectorXd>(lengthscales, dim);
  model->signal_variance = signal_std * signal_std;
  model->cholesky = Eigen::Map<const Eigen::MatrixXd>(cholesky, n, n);
  model->alpha = Eigen::Map<const Eigen::VectorXd>(alpha, n);
  model_ = std::move(model);
}

PerQueryGp::~PerQueryGp() = default;

void PerQueryGp::Query(const double* x, double* mean, double* variance) const {
  const Model& m = *model_;
  const Eigen::VectorXd query = Eigen::Map<const Eigen::VectorXd>(x, m.lengthscales.size());
  Eigen::VectorXd k(m.points.size());
  for (Eigen::Index i = 0; i < k.size(); ++i) k[i] = m.Kernel(m.points[i], query);
  *mean = k.dot(m.alpha);
  const Eigen::VectorXd z = m.cholesky.triangularView<Eigen::Lower>().solve(k);
  const double left = m.Kernel(query, query) - z.squaredNorm();
  *variance = left <= std::numeric_limits<double>::epsilon() ? 0 : left;
}

}  // namespace downpour
