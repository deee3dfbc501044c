// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <numeric>
#include <vector>

namespace downpour {

// Active CMA-ES in long double, written line by line from the tutorial (arXiv 1604.00772) with the
// inverse of a factor of C formed, its Cholesky factor as in CmaEs; `diagonal` by Ros and Hansen
// 2008, `adapts` the rates by Nomura, Akimoto and Ono (arXiv 2304.03473). It takes the steps y_k =
// (x_k - m) / sigma of given candidates.
class CmaEsReference {
 public:
  using Vector = Eigen::Matrix<long double, Eigen::Dynamic, 1>;
  using Matrix = Eigen::Matrix<long double, Eigen::Dynamic, Eigen::Dynamic>;

  CmaEsReference(const Vector& mean, long double initial_sigma, int lambda,
                 bool diagonal_only = false, bool adapts_rates = false)
      : m(mean),
        sigma(initial_sigma),
        C(Matrix::Identity(mean.size(), mean.size())),
        factorised_C(C),
        axes_C(C),
        p_sigma(Vector::Zero(mean.size())),
        p_c(Vector::Zero(mean.size())),
        diagonal(diagonal_only),
        adapts(adapts_rates),
        weights(lambda),
        E_m(Vector::Zero(mean.size())),
        E_Sigma(Vector::Zero(mean.size() * mean.size())) {
    const long double n = m.size();
    mu = lambda / 2;
    long double sum = 0, squares = 0, negative_sum = 0, negative_squares = 0;
    for (int i = 1; i <= lambda; ++i) {
      const long double w = std::log((lambda + 1) / 2.0L) - std::log(1.0L * i);
      weights[i - 1] = w;
      (i <= mu ? sum : negative_sum) += w;
      (i <= mu ? squares : negative_squares) += w * w;
    }
    mu_eff = sum * sum / squares;
    const long double mu_eff_minus = negative_sum * negative_sum / negative_squares;
    c_1 = 2 / (std::pow(n + 1.3L, 2) + mu_eff);
    c_mu = std::min(1 - c_1, 2 * (mu_eff - 2 + 1 / mu_eff) / (std::pow(n + 2, 2) + mu_eff));
    if (diagonal) c_1 *= (n + 2) / 3, c_mu = std::min(1 - c_1, c_mu * (n + 2) / 3);
    const long double scale =
        std::min(std::min(1 + c_1 / c_mu, 1 + 2 * mu_eff_minus / (mu_eff + 2)),
                 (1 - c_1 - c_mu) / (n * c_mu));
    for (int i = 0; i < lambda; ++i) weights[i] *= i < mu ? 1 / sum : scale / -negative_sum;
  }

  // L with L L^T = C as it was factorised last.
  Matrix Factor() const { return factorised_C.llt().matrixL(); }

  // Steps and costs of the candidates.
  void Update(const std::vector<Vector>& y, const std::vector<double>& costs) {
    const long double n = m.size();
    std::vector<int> order(costs.size());
    std::iota(order.begin(), order.end(), 0);
    std::sort(order.begin(), order.end(), [&](int a, int b) { return costs[a] < costs[b]; });
    Vector y_w = Vector::Zero(m.size());
    for (int i = 0; i < mu; ++i) y_w += weights[i] * y[order[i]];
    const Vector old_m = m;
    const long double old_sigma = sigma;
    const Matrix old_C = C;
    m += sigma * y_w;
    const long double c_sigma = (mu_eff + 2) / (n + mu_eff + 5);
    const long double d_sigma =
        1 + 2 * std::max(0.0L, std::sqrt((mu_eff - 1) / (n + 1)) - 1) + c_sigma;
    const long double c_c = (4 + mu_eff / n) / (n + 4 + 2 * mu_eff / n);
    const Matrix inverse_factor = Factor().inverse();
    p_sigma = (1 - c_sigma) * p_sigma +
              std::sqrt(c_sigma * (2 - c_sigma) * mu_eff) * (inverse_factor * y_w);
    const long double chi = std::sqrt(n) * (1 - 1 / (4 * n) + 1 / (21 * n * n));
    const long double norm = p_sigma.norm();
    // h_sigma of appendix A, of p_sigma^(g+1); the first generation is g = 0.
    const bool h =
        norm / std::sqrt(1 - std::pow(1 - c_sigma, 2 * (g + 1))) < (1.4L + 2 / (n + 1)) * chi;
    p_c = (1 - c_c) * p_c + (h ? 1 : 0) * std::sqrt(c_c * (2 - c_c) * mu_eff) * y_w;
    long double weight_sum = 0;
    for (const long double w : weights) weight_sum += w;
    Matrix next = (1 + c_1 * (h ? 0 : c_c * (2 - c_c)) - c_1 - c_mu * weight_sum) * C +
                  c_1 * p_c * p_c.transpose();
    for (std::size_t i = 0; i < weights.size(); ++i) {
      const Vector& step = y[order[i]];
      const long double w =
          weights[i] >= 0 ? weights[i] : weights[i] * n / (inverse_factor * step).squaredNorm();
      next += c_mu * w * step * step.transpose();
    }
    if (diagonal) next = Vector(next.diagonal()).asDiagonal();
    C = next;
    sigma *= std::exp(c_sigma / d_sigma * (norm / chi - 1));
    if (adapts) AdaptRates(old_m, old_sigma, old_C, inverse_factor);
    ++g;
    const auto interval = [&](long double share) {
      return std::max(1, static_cast<int>(share / (c_1 + c_mu)));
    };
    if (g % interval(1 / n) == 0 || diagonal || adapts) factorised_C = C;
    if (g % interval(0.5L) == 0) axes_C = C;
  }

  Vector m;
  long double sigma;
  Matrix C, factorised_C, axes_C;  // axes_C: as the stopping criteria see it
  Vector p_sigma, p_c;

 private:
  static long double Rate(const Vector& delta, long double beta, Vector* E, long double* V,
                          long double* eta) {
    *E = (1 - beta) * *E + beta * delta;
    *V = (1 - beta) * *V + beta * delta.squaredNorm();
    const long double snr = (E->squaredNorm() - beta / (2 - beta) * *V) / (*V - E->squaredNorm());
    const long double change = std::min(1.0L, std::max(-1.0L, snr / (1.4L * *eta) - 1));
    *eta *= std::exp(std::min(0.1L * *eta, beta) * change);
    return *eta = std::min(1.0L, *eta);
  }

  void AdaptRates(const Vector& old_m, long double old_sigma, const Matrix& old_C,
                  const Matrix& inverse_factor) {
    const Matrix whitening = inverse_factor / old_sigma;
    const Matrix old_Sigma = old_sigma * old_sigma * old_C;
    const Matrix d_Sigma = sigma * sigma * C - old_Sigma;
    const Vector d_m = m - old_m;
    const Matrix local = whitening * d_Sigma * whitening.transpose() / std::sqrt(2.0L);
    const long double old_eta = eta_m;
    m = old_m + Rate(whitening * d_m, 0.1L, &E_m, &V_m, &eta_m) * d_m;
    const Vector flat = Eigen::Map<const Vector>(local.data(), local.size());
    const Matrix Sigma = old_Sigma + Rate(flat, 0.03L, &E_Sigma, &V_Sigma, &eta_Sigma) * d_Sigma;
    sigma = std::pow(Sigma.determinant(), 1 / (2.0L * m.size()));
    C = Sigma / (sigma * sigma);
    sigma *= old_eta / eta_m;
  }

  bool diagonal, adapts;
  std::vector<long double> weights;
  int mu = 0, g = 0;
  long double mu_eff = 0, c_1 = 0, c_mu = 0;
  Vector E_m, E_Sigma;
  long double V_m = 0, V_Sigma = 0, eta_m = 1, eta_Sigma = 1;
};

}  // namespace downpour
