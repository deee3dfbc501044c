// SPDX-License-Identifier: Apache-2.0
#include "tools/python/block_callbacks.h"

#include <algorithm>
#include <memory>
#include <string>

namespace downpour::python {
namespace {

using Columns = py::array_t<double, py::array::f_style | py::array::forcecast>;

Columns FromBlock(const double* block, py::ssize_t lanes, py::ssize_t variables) {
  Columns array({lanes, variables});
  std::copy_n(block, lanes * variables, array.mutable_data());
  return array;
}

// What a callable returned, into `block` (lanes x variables).
void ToBlock(const py::object& result, const char* callable, py::ssize_t lanes,
             py::ssize_t variables, const char* variables_name, double* block) {
  const std::string name = std::string("result of ") + callable;
  // Without a copy where the layout is a row's; columns are what most callables return.
  const py::array array = py::array::ensure(result);
  if (array && Columns::check_(array) && array.ndim() == 2 && array.shape(0) == lanes &&
      array.shape(1) == variables) {
    std::copy_n(static_cast<const double*>(array.data()), lanes * variables, block);
    return;
  }
  const Doubles rows =
      ToArray(result, name, {{"lanes", lanes}, {variables_name, variables}}, /*finite=*/false);
  for (py::ssize_t lane = 0; lane < lanes; ++lane) {
    for (py::ssize_t v = 0; v < variables; ++v) block[v * lanes + lane] = *rows.data(lane, v);
  }
}

// A reference that may go from any thread: the last one is dropped with the GIL.
std::shared_ptr<py::object> Share(py::object object) {
  return {new py::object(std::move(object)), [](py::object* held) {
            const py::gil_scoped_acquire acquire;
            delete held;
          }};
}

}  // namespace

BlockFunctions MakeBlockFunctions(const BlockCallables& callables, const Task& task,
                                  py::ssize_t n_parameters) {
  const py::ssize_t n_states = task.n_states(), n_features = task.n_features(),
                    n_actions = task.n_actions();
  BlockFunctions functions;
  if (!callables.features.is_none()) {
    functions.features = [callable = Share(callables.features), n_states, n_features](
                             int, int lanes, const double* states, double* features) {
      const py::gil_scoped_acquire acquire;
      const py::object result = (*callable)(FromBlock(states, lanes, n_states));
      ToBlock(result, "features", lanes, n_features, "F", features);
    };
  }
  if (!callables.policy.is_none()) {
    functions.policy = [callable = Share(callables.policy), thetas = Share(py::none()),
                        n_parameters, n_features,
                        n_actions](int step, int lanes, const double* parameters,
                                   const double* features, double* actions) {
      const py::gil_scoped_acquire acquire;
      if (thetas->is_none()) {
        *thetas = FromBlock(parameters, lanes, n_parameters);
        thetas->attr("flags").attr("writeable") = false;
      }
      const py::object result = (*callable)(*thetas, FromBlock(features, lanes, n_features), step);
      ToBlock(result, "policy", lanes, n_actions, "A", actions);
    };
  }
  if (!callables.reward.is_none()) {
    functions.reward = [callable = Share(callables.reward), n_states, n_actions](
                           int step, int lanes, const double* states, const double* actions,
                           double* rewards) {
      const py::gil_scoped_acquire acquire;
      const py::object result = (*callable)(FromBlock(states, lanes, n_states),
                                            FromBlock(actions, lanes, n_actions), step);
      const Doubles values =
          ToArray(result, "result of reward", {{"lanes", lanes}}, /*finite=*/false);
      std::copy_n(values.data(), lanes, rewards);
    };
  }
  return functions;
}

}  // namespace downpour::python
