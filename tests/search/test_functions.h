// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cmath>
#include <cstddef>
#include <functional>
#include <span>

// Standard functions to minimise; the minimum is 0.
namespace downpour {

using TestFunction = std::function<double(std::span<const double>)>;

inline double Sphere(std::span<const double> x) {
  double sum = 0;
  for (const double v : x) sum += v * v;
  return sum;
}

inline double Ellipsoid(std::span<const double> x) {
  double sum = 0;
  for (std::size_t i = 0; i < x.size(); ++i) {
    sum += std::pow(1e6, static_cast<double>(i) / static_cast<double>(x.size() - 1)) * x[i] * x[i];
  }
  return sum;
}

inline double Rosenbrock(std::span<const double> x) {
  double sum = 0;
  for (std::size_t i = 0; i + 1 < x.size(); ++i) {
    sum += 100 * std::pow(x[i] * x[i] - x[i + 1], 2) + std::pow(x[i] - 1, 2);
  }
  return sum;
}

inline double Cigar(std::span<const double> x) { return 1e6 * Sphere(x.subspan(1)) + x[0] * x[0]; }

inline double Tablet(std::span<const double> x) { return 1e6 * x[0] * x[0] + Sphere(x.subspan(1)); }

inline double DifferentPowers(std::span<const double> x) {
  double sum = 0;
  for (std::size_t i = 0; i < x.size(); ++i) {
    const double share = static_cast<double>(i) / static_cast<double>(x.size() - 1);
    sum += std::pow(std::abs(x[i]), 2 + 10 * share);
  }
  return sum;
}

// Schwefel's problem 1.2.
inline double Schwefel(std::span<const double> x) {
  double sum = 0, partial = 0;
  for (const double v : x) {
    partial += v;
    sum += partial * partial;
  }
  return sum;
}

inline double Griewank(std::span<const double> x) {
  double sum = 0, product = 1;
  for (std::size_t i = 0; i < x.size(); ++i) {
    sum += x[i] * x[i] / 4000;
    product *= std::cos(x[i] / std::sqrt(static_cast<double>(i + 1)));
  }
  return sum - product + 1;
}

inline double Rastrigin(std::span<const double> x) {
  double sum = 10 * static_cast<double>(x.size());
  for (const double v : x) sum += v * v - 10 * std::cos(2 * M_PI * v);
  return sum;
}

}  // namespace downpour
