// SPDX-License-Identifier: Apache-2.0
#include "engine/rollout/movement_primitive.h"

#include <cmath>

namespace downpour {
namespace {

constexpr double kOmega = 12.5;
const double kPhaseRate = std::log(100.0);

// What each weight adds to f at phase x.
std::vector<double> Forcing(double x, int n_basis) {
  const auto centre = [n_basis](int i) {
    return n_basis == 1 ? 1.0 : std::exp(-kPhaseRate * i / (n_basis - 1));
  };
  std::vector<double> forcing(n_basis);
  double sum = 0;
  for (int i = 0; i < n_basis; ++i) {
    const int gap = i + 1 < n_basis ? i : i - 1;
    const double width = n_basis == 1 ? 1.0 : centre(gap) - centre(gap + 1);
    const double distance = (x - centre(i)) / width;
    forcing[i] = std::exp(-distance * distance);
    sum += forcing[i];
  }
  for (double& f : forcing) f *= x / sum;
  return forcing;
}

}  // namespace

std::vector<double> MovementPrimitiveResponse(int horizon, int n_basis) {
  const int n = n_basis + 1;
  const double step = 1.0 / horizon;
  const double decay = std::exp(-kOmega * step);
  std::vector<double> response(static_cast<std::size_t>(horizon) * n);
  std::vector<double> y(n, 0.0), velocity(n, 0.0);
  for (int t = 0; t < horizon; ++t) {
    std::vector<double> target = Forcing(std::exp(-kPhaseRate * step * t), n_basis);
    target.insert(target.begin(), 1.0);
    for (int i = 0; i < n; ++i) {
      // Critically damped: y - target = (e + (v + w0 e) s) exp(-w0 s).
      const double e = y[i] - target[i];
      const double slope = velocity[i] + kOmega * e;
      y[i] = target[i] + (e + slope * step) * decay;
      velocity[i] = (velocity[i] - kOmega * slope * step) * decay;
      response[static_cast<std::size_t>(t) * n + i] = y[i];
    }
  }
  return response;
}

}  // namespace downpour
