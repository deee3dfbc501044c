// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cstddef>
#include <utility>
#include <vector>

#include "engine/gp/dataset.h"
#include "engine/gp/multi_output_gp.h"
#include "tools/c/downpour.h"
#include "tools/c/handles.h"
#include "tools/c/status.h"

namespace downpour::c {
namespace {

struct GpSettings {
  QueryPlanOptions plan;
  std::uint64_t seed;
  int threads;
};

GpSettings ToSettings(const downpour_gp_options* given) {
  const downpour_gp_options options = OptionsOr(downpour_gp_options_init, given);
  RequireRange("options.variance_tolerance", options.variance_tolerance, 0, 1);
  RequireRange("options.mean_tolerance", options.mean_tolerance, 0, 1);
  RequireRange("options.backend", options.backend, DOWNPOUR_BACKEND_FUSED, DOWNPOUR_BACKEND_BLAS);
  return {{options.variance_tolerance, options.mean_tolerance,
           static_cast<QueryBackend>(options.backend)},
          options.seed,
          Threads(options.threads)};
}

Dataset ToDataset(const double* inputs, const double* targets, int n, int n_inputs, int n_outputs) {
  RequireRange("n", n, 1, 1e6);
  RequireRange("n_inputs", n_inputs, 1, 1e6);
  RequireRange("n_outputs", n_outputs, 1, 1e6);
  const auto rows = static_cast<std::size_t>(n);
  return MakeDataset(Numbers(inputs, rows * n_inputs, "inputs"), n_inputs,
                     Numbers(targets, rows * n_outputs, "targets"), n_outputs);
}

const MultiOutputGp& Model(const downpour_gp* gp) {
  RequireSet(gp, "gp");
  return *gp->model;
}

}  // namespace
}  // namespace downpour::c

using namespace downpour;     // NOLINT: the functions are C's
using namespace downpour::c;  // NOLINT

int downpour_gp_options_init(downpour_gp_options* options) {
  return InitOptions(options, [](downpour_gp_options& to) {
    const QueryPlanOptions plan;
    to.variance_tolerance = plan.variance_tolerance;
    to.mean_tolerance = plan.mean_tolerance;
    to.backend = DOWNPOUR_BACKEND_FUSED;
    to.threads = 1;
  });
}

int downpour_gp_fit(const double* inputs, const double* targets, int n, int n_inputs, int n_outputs,
                    const downpour_gp_options* options, downpour_gp** gp) {
  return Guard([&] {
    RequireSet(gp, "gp");
    const GpSettings settings = ToSettings(options);
    const Dataset data = ToDataset(inputs, targets, n, n_inputs, n_outputs);
    *gp = new downpour_gp{std::make_shared<const MultiOutputGp>(
        MultiOutputGp::Fit(data, settings.plan, settings.seed, settings.threads))};
  });
}

int downpour_gp_create(const double* inputs, const double* targets, int n, int n_inputs,
                       int n_outputs, const double* lengthscales, const double* signal_std,
                       const double* noise_std, const downpour_gp_options* options,
                       downpour_gp** gp) {
  return Guard([&] {
    RequireSet(gp, "gp");
    const GpSettings settings = ToSettings(options);
    const Dataset data = ToDataset(inputs, targets, n, n_inputs, n_outputs);
    RequireSet(lengthscales, "lengthscales");
    RequireSet(signal_std, "signal_std");
    RequireSet(noise_std, "noise_std");
    std::vector<Hyperparameters> hyperparameters;
    for (int e = 0; e < n_outputs; ++e) {
      const double* const row = lengthscales + static_cast<std::size_t>(e) * n_inputs;
      hyperparameters.push_back({{row, row + n_inputs}, signal_std[e], noise_std[e]});
    }
    *gp = new downpour_gp{std::make_shared<const MultiOutputGp>(data, hyperparameters,
                                                                settings.plan, settings.threads)};
  });
}

void downpour_gp_destroy(downpour_gp* gp) { delete gp; }

int downpour_gp_sizes(const downpour_gp* gp, int* n, int* n_inputs, int* n_outputs) {
  return Guard([&] {
    const MultiOutputGp& model = Model(gp);
    Set(model.n_points(), n);
    Set(model.n_inputs(), n_inputs);
    Set(model.n_outputs(), n_outputs);
  });
}

int downpour_gp_predict(const downpour_gp* gp, const double* queries, int64_t n_queries,
                        int with_noise, int threads, double* means, double* variances) {
  return Guard([&] {
    const MultiOutputGp& model = Model(gp);
    RequireRange("n_queries", static_cast<double>(n_queries), 0, 1e10);
    const auto n = static_cast<std::size_t>(n_queries);
    const std::size_t n_answers = n * model.n_outputs();
    model.Predict(Numbers(queries, n * model.n_inputs(), "queries"), with_noise != 0,
                  Threads(threads), Room(means, n_answers, "means"),
                  {variances, variances == nullptr ? 0 : n_answers});
  });
}

int downpour_gp_hyperparameters(const downpour_gp* gp, double* lengthscales, double* signal_std,
                                double* noise_std) {
  return Guard([&] {
    for (const ExactGp& exact : Model(gp).exact()) {
      const Hyperparameters& of_output = exact.hyperparameters();
      if (lengthscales != nullptr) {
        lengthscales =
            std::copy(of_output.lengthscales.begin(), of_output.lengthscales.end(), lengthscales);
      }
      if (signal_std != nullptr) *signal_std++ = of_output.signal_std;
      if (noise_std != nullptr) *noise_std++ = of_output.noise_std;
    }
  });
}

int downpour_gp_log_likelihood(const downpour_gp* gp, double* log_likelihood) {
  return Guard([&] {
    const MultiOutputGp& model = Model(gp);
    RequireSet(log_likelihood, "log_likelihood");
    for (const ExactGp& exact : model.exact()) *log_likelihood++ = exact.log_marginal_likelihood();
  });
}

int downpour_gp_plan(const downpour_gp* gp, int output, downpour_plan* plan) {
  return Guard([&] {
    const MultiOutputGp& model = Model(gp);
    RequireRange("output", output, 0, model.n_outputs() - 1);
    RequireSize(plan, "plan");
    const OutputPlan& of_output = model.plans()[output];
    const bool blas = std::holds_alternative<BlasFactor>(model.factors()[output]);
    *plan = {sizeof *plan,
             blas ? DOWNPOUR_BACKEND_BLAS : DOWNPOUR_BACKEND_FUSED,
             of_output.single_precision ? 1 : 0,
             of_output.points,
             of_output.tau,
             of_output.probe_errors.variance,
             of_output.probe_errors.mean,
             of_output.relative_cost,
             model.exact()[output].jitter()};
  });
}
