// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <memory>
#include <span>
#include <string>
#include <vector>

namespace downpour {

// A free parameter of a prior, learnt with the model. low < high; initial lies between them.
struct PriorParameter {
  std::string name;  // e.g. "pole:mass"
  std::string unit;  // e.g. "kg"
  double low = 0, high = 1;
  double initial = 0;
};

// One thread's copy of a prior.
class PriorPredictor {
 public:
  virtual ~PriorPredictor() = default;
  // The free parameters (as DynamicsPrior::parameters) of all predictions from now on.
  virtual void SetParameters(std::span<const double> values) = 0;
  // The state after one control period in which the action is held, for the first n lanes of a
  // tile:
  //   states, next  E x kTileLanes; may be the same array
  //   actions       A x kTileLanes, within the task's limits
  // What a lane gets depends on the parameters and on its column alone, bit for bit, whatever was
  // predicted before. A state that is not finite tells that there is no prediction. Does not
  // allocate, does not throw.
  virtual void PredictTile(int n, const double* states, const double* actions, double* next) = 0;
};

// A mean function of the dynamics with free parameters (Chatzilygeroudis & Mouret, ICRA 2018): the
// next state is what the prior predicts plus a residual that Gaussian processes learn (docs/
// priors.md). A user's own is a class derived from this one. Immutable: calls are thread-safe.
class DynamicsPrior {
 public:
  virtual ~DynamicsPrior() = default;
  // One line with all that predictions depend on besides the free parameters: a run is resumed only
  // with a prior of the same description.
  virtual std::string Describe() const = 0;
  // May be empty.
  virtual const std::vector<PriorParameter>& parameters() const = 0;
  // At the initial parameters. Allocates.
  virtual std::unique_ptr<PriorPredictor> MakePredictor() const = 0;
};

}  // namespace downpour
