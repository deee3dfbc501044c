// SPDX-License-Identifier: Apache-2.0
#include "engine/search/strategy_parameters.h"

#include <algorithm>
#include <cmath>

namespace downpour {

CovarianceForm ResolveForm(CovarianceForm form, int dimension) {
  if (form != CovarianceForm::kAuto) return form;
  return dimension <= kMaxFullDimension ? CovarianceForm::kFull : CovarianceForm::kLimitedMemory;
}

StrategyParameters MakeStrategyParameters(CovarianceForm form, int dimension, int population) {
  StrategyParameters p;
  const double n = dimension;
  p.parents = population / 2;
  const int others = population - p.parents;
  p.weights.resize(population);
  for (int i = 0; i < population; ++i) {
    p.weights[i] = std::log((population + 1) / 2.0) - std::log(i + 1.0);  // Eq. 49
  }
  auto good = p.weights.head(p.parents);
  auto bad = p.weights.tail(others);
  p.mu_eff = good.sum() * good.sum() / good.squaredNorm();  // Eq. 8
  const double mu_eff_minus = bad.sum() * bad.sum() / bad.squaredNorm();
  p.c_sigma = (p.mu_eff + 2) / (n + p.mu_eff + 5);                                         // Eq. 55
  p.d_sigma = 1 + 2 * std::max(0.0, std::sqrt((p.mu_eff - 1) / (n + 1)) - 1) + p.c_sigma;  // Eq. 55
  p.c_c = (4 + p.mu_eff / n) / (n + 4 + 2 * p.mu_eff / n);                                 // Eq. 56
  const double faster = form == CovarianceForm::kDiagonal ? (n + 2) / 3 : 1;
  p.c_1 = faster * 2 / ((n + 1.3) * (n + 1.3) + p.mu_eff);                   // Eq. 57
  p.c_mu = std::min(1 - p.c_1, faster * 2 * (p.mu_eff - 2 + 1 / p.mu_eff) /  // Eq. 58
                                   ((n + 2) * (n + 2) + p.mu_eff));
  const double alpha = std::min({1 + p.c_1 / p.c_mu,                     // Eq. 50
                                 1 + 2 * mu_eff_minus / (p.mu_eff + 2),  // Eq. 51
                                 (1 - p.c_1 - p.c_mu) / (n * p.c_mu)});  // Eq. 52
  const double good_sum = good.sum(), bad_sum = bad.cwiseAbs().sum();
  good /= good_sum;  // Eq. 53
  bad *= alpha / bad_sum;
  p.expected_norm = std::sqrt(n) * (1 - 1 / (4 * n) + 1 / (21 * n * n));
  if (form == CovarianceForm::kLimitedMemory) {
    // 2 lambda / n is for n far above lambda; at c_sigma = 1 nothing is left to accumulate.
    p.c_sigma = std::min(2.0 * population / n, 0.5);
  }
  return p;
}

double ScaledWeight(const CovarianceUpdate& update, int i) {
  const double weight = update.parameters.weights[i];
  if (i < update.parameters.parents) return weight;
  const auto z = update.z.col(update.ranking[i]);
  return weight * static_cast<double>(z.size()) / z.squaredNorm();
}

}  // namespace downpour
