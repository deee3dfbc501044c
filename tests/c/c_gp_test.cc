// SPDX-License-Identifier: Apache-2.0
#include <limits>
#include <thread>

#include "engine/gp/dataset.h"
#include "engine/gp/multi_output_gp.h"
#include "tests/c/c_fixture.h"

namespace downpour {
namespace {

MultiOutputGp ToCpp(const CData& d, const QueryPlanOptions& plan) {
  const Dataset data = MakeDataset(d.inputs, 4, d.targets, 2);
  std::vector<Hyperparameters> hyperparameters;
  for (int e = 0; e < 2; ++e) {
    const auto row = d.lengthscales.begin() + 4 * e;
    hyperparameters.push_back({{row, row + 4}, d.signal_std[e], d.noise_std[e]});
  }
  return MultiOutputGp(data, hyperparameters, plan, 1);
}

TEST_CASE("C GP: answers, likelihood and plan are the bits of the C++ model") {
  const CData data(60);
  const CData queries(101);
  for (const int backend : {DOWNPOUR_BACKEND_FUSED, DOWNPOUR_BACKEND_BLAS}) {
    for (const double tolerance : {0.0, 0.02}) {
      CAPTURE(backend);
      CAPTURE(tolerance);
      downpour_gp_options options;
      downpour_gp_options_init(&options);
      options.backend = backend;
      options.variance_tolerance = options.mean_tolerance = tolerance;
      const CGp gp = MakeCGp(data, &options);
      const MultiOutputGp cpp =
          ToCpp(data, {tolerance, tolerance, static_cast<QueryBackend>(backend)});
      std::vector<double> mean(202), variance(202), mean_cpp(202), variance_cpp(202);
      for (const int noise : {0, 1}) {
        cpp.Predict(queries.inputs, noise != 0, 1, mean_cpp, variance_cpp);
        CHECK(downpour_gp_predict(gp.get(), queries.inputs.data(), 101, noise, 2, mean.data(),
                                  variance.data()) == DOWNPOUR_OK);
        CHECK(mean == mean_cpp);
        CHECK(variance == variance_cpp);
      }
      double likelihood[2];
      CHECK(downpour_gp_log_likelihood(gp.get(), likelihood) == DOWNPOUR_OK);
      for (int e = 0; e < 2; ++e) {
        CHECK(likelihood[e] == cpp.exact()[e].log_marginal_likelihood());
        downpour_plan plan;
        plan.size = sizeof plan;
        CHECK(downpour_gp_plan(gp.get(), e, &plan) == DOWNPOUR_OK);
        CHECK(plan.backend == backend);
        CHECK(plan.points == cpp.plans()[e].points);
        CHECK(plan.variance_error == cpp.plans()[e].probe_errors.variance);
        CHECK(plan.relative_cost == cpp.plans()[e].relative_cost);
      }
    }
  }
}

TEST_CASE("C GP: fit learns the hyper-parameters of the C++ fit") {
  const CData data(30);
  downpour_gp_options options;
  downpour_gp_options_init(&options);
  options.seed = 7;
  options.threads = 2;
  downpour_gp* made = nullptr;
  REQUIRE(downpour_gp_fit(data.inputs.data(), data.targets.data(), 30, 4, 2, &options, &made) ==
          DOWNPOUR_OK);
  const CGp gp(made, &downpour_gp_destroy);
  const MultiOutputGp cpp =
      MultiOutputGp::Fit(MakeDataset(data.inputs, 4, data.targets, 2), {}, 7, 1);
  double lengthscales[8], signal[2], noise[2];
  CHECK(downpour_gp_hyperparameters(gp.get(), lengthscales, signal, noise) == DOWNPOUR_OK);
  for (int e = 0; e < 2; ++e) {
    const Hyperparameters& wanted = cpp.exact()[e].hyperparameters();
    for (int d = 0; d < 4; ++d) CHECK(lengthscales[4 * e + d] == wanted.lengthscales[d]);
    CHECK(signal[e] == wanted.signal_std);
    CHECK(noise[e] == wanted.noise_std);
  }
  int n = 0, dim = 0, outputs = 0;
  CHECK(downpour_gp_sizes(gp.get(), &n, &dim, &outputs) == DOWNPOUR_OK);
  CHECK(n == 30);
  CHECK(dim == 4);
  CHECK(outputs == 2);
}

TEST_CASE("C GP: what is wrong with data or hyper-parameters is told") {
  CData d(10);
  downpour_gp* gp = nullptr;
  const auto create = [&](int n = 10, const downpour_gp_options* options = nullptr) {
    return downpour_gp_create(d.inputs.data(), d.targets.data(), n, 4, 2, d.lengthscales.data(),
                              d.signal_std.data(), d.noise_std.data(), options, &gp);
  };
  const int bad = DOWNPOUR_INVALID_INPUT;
  CheckFailure(create(0), bad, "n = 0: must be in [1, 1e+06]");
  CheckFailure(downpour_gp_fit(nullptr, d.targets.data(), 10, 4, 2, nullptr, &gp), bad,
               "inputs: NULL");
  CheckFailure(downpour_gp_fit(d.inputs.data(), nullptr, 10, 4, 2, nullptr, &gp), bad,
               "targets: NULL");
  CheckFailure(downpour_gp_fit(d.inputs.data(), d.targets.data(), 10, 0, 2, nullptr, &gp), bad,
               "n_inputs = 0");
  CheckFailure(downpour_gp_fit(d.inputs.data(), d.targets.data(), 10, 4, -1, nullptr, &gp), bad,
               "n_outputs = -1");
  CheckFailure(downpour_gp_fit(d.inputs.data(), d.targets.data(), 10, 4, 2, nullptr, nullptr), bad,
               "gp: NULL");
  CheckFailure(downpour_gp_create(d.inputs.data(), d.targets.data(), 10, 4, 2, nullptr,
                                  d.signal_std.data(), d.noise_std.data(), nullptr, &gp),
               bad, "lengthscales: NULL");
  downpour_gp_options options;
  downpour_gp_options_init(&options);
  options.variance_tolerance = std::numeric_limits<double>::quiet_NaN();
  CheckFailure(create(10, &options), bad, "options.variance_tolerance = nan: must be in [0, 1]");
  downpour_gp_options_init(&options);
  options.backend = 5;
  CheckFailure(create(10, &options), bad, "options.backend = 5");
  downpour_gp_options_init(&options);
  options.threads = -1;
  CheckFailure(create(10, &options), bad, "threads = -1");
  options.size = 3;
  CheckFailure(create(10, &options), bad, "options: size = 3");
  d.noise_std[1] = 0;
  CheckFailure(create(), bad, "1e-150");
  d.noise_std[1] = 0.02;
  d.inputs[5] = std::numeric_limits<double>::quiet_NaN();
  CheckFailure(create(), bad, "nan");
  CHECK(gp == nullptr);
}

TEST_CASE("C GP: a covariance matrix without Cholesky factor gets jitter or is refused") {
  CData d(20);
  std::fill(d.inputs.begin(), d.inputs.end(), 1.0);
  d.noise_std = {1e-150, 1e-150};
  const CGp gp = MakeCGp(d);
  downpour_plan plan;
  plan.size = sizeof plan;
  CHECK(downpour_gp_plan(gp.get(), 0, &plan) == DOWNPOUR_OK);
  CHECK(plan.jitter > 0);
  // No jitter helps where inputs / lengthscales overflow.
  CData wild(3);
  std::fill(wild.lengthscales.begin(), wild.lengthscales.end(), 1e-150);
  for (double& x : wild.inputs) x *= 1e200;
  downpour_gp* refused = nullptr;
  const int status =
      downpour_gp_create(wild.inputs.data(), wild.targets.data(), 3, 4, 2, wild.lengthscales.data(),
                         wild.signal_std.data(), wild.noise_std.data(), nullptr, &refused);
  CheckFailure(status, DOWNPOUR_INVALID_INPUT, "divided by its lengthscale is not finite");
  CHECK(refused == nullptr);
}

TEST_CASE("C GP: queries that are wrong are refused and leave the model as it was") {
  const CData d(20);
  const CGp gp = MakeCGp(d);
  double mean[2], variance[2], before[2];
  const int bad = DOWNPOUR_INVALID_INPUT;
  REQUIRE(downpour_gp_predict(gp.get(), d.inputs.data(), 1, 1, 1, before, nullptr) == 0);
  const auto predict = [&](const downpour_gp* of, const double* queries, std::int64_t n,
                           int threads, double* means) {
    return downpour_gp_predict(of, queries, n, 1, threads, means, variance);
  };
  CheckFailure(predict(nullptr, d.inputs.data(), 1, 1, mean), bad, "gp: NULL");
  CheckFailure(predict(gp.get(), nullptr, 1, 1, mean), bad, "queries: NULL");
  CheckFailure(predict(gp.get(), d.inputs.data(), 1, 1, nullptr), bad, "means: NULL");
  CheckFailure(predict(gp.get(), d.inputs.data(), -1, 1, mean), bad, "n_queries = -1");
  CheckFailure(predict(gp.get(), d.inputs.data(), 1, -2, mean), bad, "threads = -2");
  CheckFailure(downpour_gp_log_likelihood(gp.get(), nullptr), bad, "log_likelihood: NULL");
  downpour_plan plan;
  plan.size = sizeof plan;
  CheckFailure(downpour_gp_plan(gp.get(), 2, &plan), bad, "output = 2: must be in [0, 1]");
  CheckFailure(downpour_gp_plan(gp.get(), 0, nullptr), bad, "plan: NULL");
  CHECK(predict(gp.get(), nullptr, 0, 0, nullptr) == DOWNPOUR_OK);
  const double nan = std::numeric_limits<double>::quiet_NaN();
  const double queries[] = {nan, 0, 0, 0};
  CHECK(predict(gp.get(), queries, 1, 1, mean) == DOWNPOUR_OK);
  CHECK(std::isnan(mean[0]));
  CHECK(predict(gp.get(), d.inputs.data(), 1, 1, mean) == DOWNPOUR_OK);
  CHECK(mean[0] == before[0]);
  CHECK(mean[1] == before[1]);
}

TEST_CASE("C library: messages belong to a thread") {
  CheckFailure(downpour_gp_sizes(nullptr, nullptr, nullptr, nullptr), DOWNPOUR_INVALID_INPUT, "gp");
  std::string other = "unset";
  std::thread([&] { other = downpour_last_error(); }).join();
  CHECK(other.empty());
  CheckFailure(downpour_gp_options_init(nullptr), DOWNPOUR_INVALID_INPUT, "options: NULL");
  CheckFailure(downpour_evaluator_options_init(nullptr), DOWNPOUR_INVALID_INPUT, "options: NULL");
  CheckFailure(downpour_cmaes_options_init(nullptr), DOWNPOUR_INVALID_INPUT, "options: NULL");
  downpour_gp_destroy(nullptr);
  downpour_evaluator_destroy(nullptr);
  downpour_cmaes_destroy(nullptr);
}

TEST_CASE("C library: version, ABI and platform are told") {
  CHECK(downpour_abi_version() == DOWNPOUR_ABI_VERSION);
  CHECK(std::string(downpour_version()) == DOWNPOUR_VERSION);
  CHECK(std::string(downpour_simd_target()) != "");
  CHECK(std::string(downpour_blas_core()) != "");
  // The tests start themselves again with the right kernels of OpenBLAS.
  CHECK(std::string(downpour_platform_warning()) == "");
}

}  // namespace
}  // namespace downpour
