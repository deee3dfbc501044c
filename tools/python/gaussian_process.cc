// SPDX-License-Identifier: Apache-2.0
#include "tools/python/gaussian_process.h"

#include <algorithm>
#include <functional>
#include <string>

#include "engine/errors.h"
#include "engine/gp/dataset.h"
#include "tools/python/calls.h"
#include "tools/python/interrupt.h"

namespace downpour::python {
namespace {

constexpr char kDoc[] =
    R"(Exact Gaussian processes with squared-exponential covariances, one an output, on shared inputs.

GaussianProcess(X, Y, lengthscales, signal_std, noise_std, tolerance=0.02, backend="auto", threads=2)

For output e, k(x, x') = signal_std[e]**2 exp(-0.5 sum_d ((x_d - x'_d) / lengthscales[e, d])**2), the
prior mean is zero, and observations carry noise of standard deviation noise_std[e].

X             (n, D) inputs, Y (n, E) outputs
lengthscales  (E, D), in the units of the inputs; signal_std, noise_std (E,), in those of the outputs
tolerance     in [0, 1]: largest error of a variance, as a share of variance + noise variance; means
              may err by 2.5 times that share of the predictive standard deviation. Queries then use
              the cheapest of exact and compressed posteriors in double and single precision that
              keeps half of it on inputs like the data (see plan); 0: exact, double precision
backend       "fused": own kernels; "blas": OpenBLAS, always exact; "auto": the faster, "fused"
threads       that prepare the outputs side by side; 0: all cores. Never changes a result

Objects do not change; threads may share them. Raises TypeError or ValueError that names the argument
and what it must be: for dtypes that do not convert to float64 without loss, shapes that disagree,
numbers that are not finite, and hyper-parameters that are not positive or leave no covariance matrix
with a Cholesky factor (jitter of up to signal_std**2 is tried first; plan tells it).)";

constexpr char kFitDoc[] =
    R"(fit(X, Y, seed=0, threads=2, tolerance=0.02, backend="auto") -> GaussianProcess

Maximum-likelihood hyper-parameters for X (n, D), Y (n, E), by L-BFGS from a start by the data's
spread and another drawn by `seed`. Ctrl-C ends it.)";

constexpr char kPredictDoc[] =
    R"(predict(Xq, include_noise=True, threads=2) -> (mean, var)

Posterior mean and variance, (B, E) each, at Xq (B, D). include_noise adds noise_std**2, as for a new
observation. A row's answer depends on that row alone, to the bit ("blas": on its place, too).)";

// `sized` is (E,), in messages "E".
std::vector<Hyperparameters> ToHyperparameters(py::handle lengthscales, py::handle signal_std,
                                               py::handle noise_std, const Dataset& data) {
  const py::ssize_t n_outputs = data.n_outputs(), dim = data.n_inputs();
  const Doubles l = ToArray(lengthscales, "lengthscales", {{"E", n_outputs}, {"D", dim}});
  const Doubles f = ToArray(signal_std, "signal_std", {{"E", n_outputs}});
  const Doubles s = ToArray(noise_std, "noise_std", {{"E", n_outputs}});
  const auto check = [](const Doubles& array, const char* name) {
    for (const double x : Span(array)) {
      if (x >= 1e-150 && x <= 1e150) continue;
      throw py::value_error(std::string(name) + ": " + std::to_string(x) +
                            ", must be in [1e-150, 1e150]");
    }
  };
  check(l, "lengthscales");
  check(f, "signal_std");
  check(s, "noise_std");
  std::vector<Hyperparameters> hyperparameters;
  for (py::ssize_t e = 0; e < n_outputs; ++e) {
    hyperparameters.push_back({{l.data(e, 0), l.data(e, 0) + dim}, f.at(e), s.at(e)});
  }
  return hyperparameters;
}

Dataset ToDataset(py::handle inputs, py::handle targets) {
  const Doubles x = ToArray(inputs, "X", {{"n"}, {"D"}});
  if (x.size() == 0) throw py::value_error("X: empty, must have n, D >= 1");
  const Doubles y = ToArray(targets, "Y", {{"n", x.shape(0)}, {"E"}});
  if (y.size() == 0) throw py::value_error("Y: empty, must have E >= 1");
  return MakeDataset(Span(x), static_cast<int>(x.shape(1)), Span(y), static_cast<int>(y.shape(1)));
}

QueryPlanOptions ToPlanOptions(py::handle tolerance, py::handle backend) {
  QueryPlanOptions options;
  options.variance_tolerance = ToNumber(tolerance, "tolerance");
  if (!(options.variance_tolerance >= 0 && options.variance_tolerance <= 1)) {
    throw py::value_error("tolerance = " + std::string(py::repr(tolerance)) +
                          ": must be in [0, 1]");
  }
  options.mean_tolerance = std::min(1.0, 2.5 * options.variance_tolerance);
  const bool blas = ToChoice(backend, "backend", {"auto", "fused", "blas"}) == 2;
  options.backend = blas ? QueryBackend::kBlas : QueryBackend::kFused;
  if (blas) py::module_::import("downpour._process").attr("warn_of_slow_blas")();
  return options;
}

GaussianProcess Make(py::handle inputs, py::handle targets, py::handle lengthscales,
                     py::handle signal_std, py::handle noise_std, py::handle tolerance,
                     py::handle backend, py::handle n_threads) {
  const Dataset data = ToDataset(inputs, targets);
  const auto hyperparameters = ToHyperparameters(lengthscales, signal_std, noise_std, data);
  const QueryPlanOptions options = ToPlanOptions(tolerance, backend);
  const int threads = ToThreads(n_threads);
  const py::gil_scoped_release release;
  return {std::make_shared<MultiOutputGp>(data, hyperparameters, options, threads), {}};
}

GaussianProcess Fit(py::handle inputs, py::handle targets, py::handle seed, py::handle n_threads,
                    py::handle tolerance, py::handle backend) {
  const Dataset data = ToDataset(inputs, targets);
  const QueryPlanOptions options = ToPlanOptions(tolerance, backend);
  const std::uint64_t the_seed = ToSeed(seed);
  const int threads = ToThreads(n_threads);
  GaussianProcess gp;
  RunInterruptibly([&](const std::atomic<bool>* stop) {
    gp.model =
        std::make_shared<MultiOutputGp>(MultiOutputGp::Fit(data, options, the_seed, threads, stop));
  });
  return gp;
}

py::tuple Predict(const GaussianProcess& gp, py::handle inputs, py::handle include_noise,
                  py::handle n_threads) {
  // Keeps the model for the time of the call.
  const std::shared_ptr<const MultiOutputGp> model = gp.model;
  const py::ssize_t n_outputs = model->n_outputs();
  const Doubles x = ToArray(inputs, "Xq", {{"B"}, {"D", model->n_inputs()}});
  const bool with_noise = ToFlag(include_noise, "include_noise");
  const int threads = ToThreads(n_threads);
  py::array_t<double> mean({x.shape(0), n_outputs}), var({x.shape(0), n_outputs});
  const std::span<const double> queries = Span(x);
  const std::span<double> means = MutableSpan(&mean), variances = MutableSpan(&var);
  if (!queries.empty()) {
    const py::gil_scoped_release release;
    model->Predict(queries, with_noise, threads, means, variances);
  }
  return py::make_tuple(mean, var);
}

py::list Plan(GaussianProcess* gp) {
  if (!gp->query_nanoseconds) {
    const py::gil_scoped_release release;
    std::vector<double> measured = gp->model->TimeQueries();
    const py::gil_scoped_acquire acquire;
    gp->query_nanoseconds = std::move(measured);
  }
  py::list plans;
  for (std::size_t e = 0; e < gp->model->plans().size(); ++e) {
    const OutputPlan& plan = gp->model->plans()[e];
    py::dict row;
    row["output"] = e;
    row["method"] = plan.compressed ? "compressed" : "exact";
    row["precision"] = plan.single_precision ? "fp32" : "fp64";
    row["backend"] = QueryBackendName(std::holds_alternative<BlasFactor>(gp->model->factors()[e])
                                          ? QueryBackend::kBlas
                                          : QueryBackend::kFused);
    row["n"] = plan.n;
    row["m"] = plan.points;
    row["tau"] = plan.tau;
    row["variance_error"] = plan.probe_errors.variance;
    row["mean_error"] = plan.probe_errors.mean;
    row["relative_cost"] = plan.relative_cost;
    row["jitter"] = gp->model->exact()[e].jitter();
    row["ns_per_query"] = (*gp->query_nanoseconds)[e];
    plans.append(row);
  }
  return plans;
}

py::array_t<double> EachOutput(const GaussianProcess& gp,
                               const std::function<double(const ExactGp&)>& number) {
  std::vector<double> numbers;
  for (const ExactGp& exact : gp.model->exact()) numbers.push_back(number(exact));
  return FromVector(numbers);
}

py::array_t<double> Lengthscales(const GaussianProcess& gp) {
  std::vector<double> rows;
  for (const ExactGp& exact : gp.model->exact()) {
    const std::vector<double>& row = exact.hyperparameters().lengthscales;
    rows.insert(rows.end(), row.begin(), row.end());
  }
  return FromRows(rows, gp.model->n_inputs());
}

}  // namespace

void AddGaussianProcess(py::module_* module) {
  using py::arg;
  py::class_<GaussianProcess> type(*module, "GaussianProcess", kDoc);
  type.def(py::init(&Make), arg("X"), arg("Y"), arg("lengthscales"), arg("signal_std"),
           arg("noise_std"), arg("tolerance") = 0.02, arg("backend") = "auto", arg("threads") = 2)
      .def_static("fit", &Fit, arg("X"), arg("Y"), arg("seed") = 0, arg("threads") = 2,
                  arg("tolerance") = 0.02, arg("backend") = "auto", kFitDoc)
      .def_static("fit",
                  [](const py::args& positional, const py::kwargs& named) {
                    RefuseCall(kFitDoc, "GaussianProcess.fit", false, positional, named);
                  })
      .def("predict", &Predict, arg("Xq"), arg("include_noise") = true, arg("threads") = 2,
           kPredictDoc)
      .def_property_readonly("plan", &Plan,
                             "How queries are answered: a list of dicts, one an output.\n\n"
                             "method 'exact' or 'compressed' to m of the n points, with tau; "
                             "precision 'fp64' or 'fp32'; backend; variance_error and mean_error, "
                             "the worst measured on probes, as shares of variance + noise variance "
                             "and of its root; relative_cost by the model of costs, exact fp64 = "
                             "1; jitter added to the covariance's diagonal; ns_per_query of mean "
                             "and variance, measured on one thread when first asked for.")
      .def_property_readonly(
          "log_marginal_likelihood",
          [](const GaussianProcess& gp) {
            return EachOutput(gp, [](const ExactGp& e) { return e.log_marginal_likelihood(); });
          },
          "(E,) log p(Y[:, e] | X), of the exact posteriors.")
      .def_property_readonly("lengthscales", &Lengthscales, "(E, D), in the units of the inputs.")
      .def_property_readonly(
          "signal_std",
          [](const GaussianProcess& gp) {
            return EachOutput(gp, [](const ExactGp& e) { return e.hyperparameters().signal_std; });
          },
          "(E,), in the units of the outputs.")
      .def_property_readonly(
          "noise_std",
          [](const GaussianProcess& gp) {
            return EachOutput(gp, [](const ExactGp& e) { return e.hyperparameters().noise_std; });
          },
          "(E,), in the units of the outputs.")
      .def_property_readonly(
          "n_points", [](const GaussianProcess& gp) { return gp.model->n_points(); }, "n")
      .def_property_readonly(
          "n_inputs", [](const GaussianProcess& gp) { return gp.model->n_inputs(); }, "D")
      .def_property_readonly(
          "n_outputs", [](const GaussianProcess& gp) { return gp.model->n_outputs(); }, "E")
      .def("__repr__", [](const GaussianProcess& gp) {
        return "<downpour.GaussianProcess n=" + std::to_string(gp.model->n_points()) +
               " D=" + std::to_string(gp.model->n_inputs()) +
               " E=" + std::to_string(gp.model->n_outputs()) + ">";
      });
  RefuseOtherConstruction(&type, kDoc);
  RefuseOtherCalls(&type, "predict", kPredictDoc);
}

}  // namespace downpour::python
