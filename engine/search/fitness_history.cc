// SPDX-License-Identifier: Apache-2.0
#include "engine/search/fitness_history.h"

#include <algorithm>
#include <cstddef>

namespace downpour {
namespace {

constexpr int kMaxWindow = 20000;

double Median(std::vector<double>& values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

double MedianOf(const double* first, int n, std::vector<double>& scratch) {
  scratch.assign(first, first + n);
  return Median(scratch);
}

}  // namespace

FitnessHistory::FitnessHistory(int dimension, int population)
    : short_window_(10 + (30 * dimension + population - 1) / population),
      long_window_(std::min(kMaxWindow, 120 + 30 * dimension / population)) {
  best_.reserve(1024);
  median_.reserve(1024);
  scratch_.reserve(std::max(population, 1024));
}

void FitnessHistory::Append(std::span<const double> costs) {
  const auto [best, worst] = std::minmax_element(costs.begin(), costs.end());
  best_.push_back(*best);
  last_worst_ = *worst;
  median_.push_back(MedianOf(costs.data(), static_cast<int>(costs.size()), scratch_));
}

bool FitnessHistory::IsFlat(double tolerance) const {
  if (best_.size() < static_cast<std::size_t>(short_window_)) return false;
  const auto [low, high] = std::minmax_element(best_.end() - short_window_, best_.end());
  return std::max(*high, last_worst_) - *low < tolerance;
}

bool FitnessHistory::HasEqualBest() const {
  if (best_.size() < static_cast<std::size_t>(short_window_)) return false;
  const auto [low, high] = std::minmax_element(best_.end() - short_window_, best_.end());
  return *low == *high;
}

bool FitnessHistory::IsStagnant() {
  const int generations = static_cast<int>(best_.size());
  const int window = std::clamp(generations / 5, long_window_, kMaxWindow);
  if (generations < window) return false;
  const int part = 3 * window / 10;
  for (const bool best : {true, false}) {
    const double* const end = (best ? best_ : median_).data() + generations;
    if (MedianIsLess(end - part, end - window, part, &between_[best])) return false;
  }
  return true;
}

bool FitnessHistory::MedianIsLess(const double* a, const double* b, int n, double* between) {
  // More than half of the numbers below some value: the median is, too.
  const auto median_is_below = [n](const double* first, double value) {
    return std::count_if(first, first + n, [value](double x) { return x < value; }) > n / 2;
  };
  const bool a_is_below = median_is_below(a, *between), b_is_below = median_is_below(b, *between);
  if (a_is_below != b_is_below) return a_is_below;
  *between = MedianOf(b, n, scratch_);
  return median_is_below(a, *between);
}

}  // namespace downpour
