// SPDX-License-Identifier: Apache-2.0
//
// Prints what main.c prints, by the C++ interface and without Eigen's types.
#include <cmath>
#include <cstdio>
#include <memory>
#include <vector>

#include "engine/gp/dataset.h"
#include "engine/gp/multi_output_gp.h"
#include "engine/gp/process_settings.h"
#include "engine/rollout/model_evaluator.h"
#include "engine/search/minimise.h"
#include "kernels/fma_peak/fma_peak.h"
#include "tasks/registry.h"

int main() {
  std::vector<double> inputs, targets, parameters;
  for (int i = 0; i < 50; ++i) {
    inputs.insert(inputs.end(), {std::sin(i), std::cos(2.0 * i), std::sin(3.0 * i), std::cos(i)});
    targets.insert(targets.end(), {0.1 * std::sin(i), 0.1 * std::cos(i)});
  }
  const std::vector<downpour::Hyperparameters> hyperparameters(2, {{1, 1, 1, 1}, 0.5, 0.05});
  const auto model =
      std::make_shared<downpour::MultiOutputGp>(downpour::MakeDataset(inputs, 4, targets, 2),
                                                hyperparameters, downpour::QueryPlanOptions{}, 1);
  double mean[2], variance[2];
  model->Predict({inputs.data() + 4, 4}, true, 1, mean, variance);

  const downpour::Task task = downpour::MakeTask("pendulum");
  const std::shared_ptr<const downpour::Policy> policy = downpour::MakePolicy(task, {});
  for (int i = 0; i < policy->n_parameters(); ++i) parameters.push_back(std::sin(i));
  const downpour::ModelEvaluator evaluator(model, task, policy, {}, 2, {});
  double returns[2];
  evaluator.Evaluate(parameters, policy->n_parameters(), 7, returns);

  downpour::Minimiser search({.lower = {-1, -1}, .upper = {1, 1}, .start = {0.5, 0.5}});
  std::printf("%s %a %a %a %a %a %a %a\n", downpour::SimdTargetName(), mean[0], mean[1],
              variance[0], variance[1], returns[0], returns[1], search.Ask()[1]);
}
