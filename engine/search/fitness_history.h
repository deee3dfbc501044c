// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <span>
#include <vector>

namespace downpour {

// Best and median cost of every generation of one CMA-ES run, and the stopping criteria that read
// them (Hansen, arXiv 1604.00772, appendix B.3). Smaller is better. Not thread-safe.
class FitnessHistory {
 public:
  FitnessHistory(int dimension, int population);

  // Appends a generation with these costs (population of them, any order, none NaN). Allocates
  // only as the history grows.
  void Append(std::span<const double> costs);

  // TolHistFun: the best costs of the last 10 + ceil(30 P / lambda) generations and all costs of
  // the last generation span less than `tolerance`.
  bool IsFlat(double tolerance) const;
  // EqualFunValues: the best costs of those generations are all the same.
  bool HasEqualBest() const;
  // Stagnation: over the last 20 % of the generations, but at least 120 + 30 P / lambda and at
  // most 20000 of them, neither the median of the best nor the median of the median costs of the
  // newest 30 % is better than that of the oldest 30 %.
  bool IsStagnant();

  template <typename Archive>
  void Visit(Archive& archive) {
    archive(best_);
    archive(median_);
    archive(last_worst_);
  }

 private:
  // Whether the median of n numbers at `a` is less than that at `b`. Selecting a median takes long:
  // *between, any number, is tried as one that separates the two, and replaced if it does not.
  bool MedianIsLess(const double* a, const double* b, int n, double* between);

  int short_window_;
  int long_window_;
  std::vector<double> best_;
  std::vector<double> median_;
  double last_worst_ = 0;
  std::vector<double> scratch_;
  // Costs that lay between the medians IsStagnant compared last, of best_ and of median_.
  double between_[2] = {0, 0};
};

}  // namespace downpour
