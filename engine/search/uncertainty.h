// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <span>
#include <vector>

namespace downpour {

// Uncertainty handling of N. Hansen, A. Niederberger, L. Guzzella and P. Koumoutsakos, "A Method
// for Handling Uncertainty in Evolutionary Optimization With an Application to Feedback Control of
// Combustion" (IEEE TEVC 2009).

// How many candidates of a population to re-evaluate: floor(r lambda) plus one with the
// probability of the fraction that is left, r = max(0.1, 2 / lambda); at least 1, at most lambda.
// `uniform` is the draw in [0, 1) that decides.
int ReevaluationCount(int population, double uniform);

// Delta_lim(R): the 10th percentile (theta 50, theta = 0.2) of the rank changes
// {|1 - R|, ..., |2 lambda - 1 - R|} that chance alone would give; the percentile of sorted
// x_1..x_N interpolates x_k as the (k - 1/2) / N quantile. R in [1, 2 lambda - 1].
double RankChangeLimit(int rank, int population);

// Factor of the step size when the measure is positive: alpha_sigma = 1 + 2 / (P + 10).
double SigmaFactor(int dimension);

// Rollouts a candidate in the next generation, a real number, from those of this one: 1.5 times
// as many, at most `max`, when the measure is positive; 1.5 times fewer, at least `min`, when it
// is negative.
double AdaptedRollouts(double rollouts, double measure, double min, double max);

// Compares the first and the second evaluation of a population. Not thread-safe.
class UncertaintyMeasure {
 public:
  explicit UncertaintyMeasure(int population);

  // costs (lambda, none NaN, smaller is better); reevaluated (1 to lambda of them): second costs
  // of candidates 0, 1, ... (candidates are independent draws, so the first ones are a random
  // choice). Writes `ranking` (lambda), candidates by the sum of both ranks, best first; ties by
  // the smaller rank change (the mean one for candidates evaluated once), then by the mean cost.
  // Returns s, positive when noise scrambles the ranking more than chance allows. Equal costs of
  // different candidates are ranked by candidate, so that they count as no change. Does not
  // allocate.
  double Measure(std::span<const double> costs, std::span<const double> reevaluated,
                 std::span<int> ranking);

 private:
  void RankJointly(std::span<const double> costs, std::span<const double> reevaluated);

  int population_;
  std::vector<int> order_;         // (2 lambda)
  std::vector<int> rank_;          // (2 lambda) from 1: first evaluations, then second ones
  std::vector<double> change_;     // (lambda) |Delta_i|
  std::vector<double> mean_cost_;  // (lambda)
};

}  // namespace downpour
