// SPDX-License-Identifier: Apache-2.0
// One value of PILCO's expected return with and without its gradient, on a cart-pole model learnt
// from a run's transitions, gp policy of 20 points.
//   pilco_bench RUN [Google Benchmark's options]
// RUN is a run directory of cart-pole; its first 4 and 8 episodes are the data (40 points each).
// Rates are evaluations and pairs of points (E (E + 1) / 2 pairs of outputs, n^2 each, 40 steps).
#include <benchmark/benchmark.h>

#include <cmath>
#include <filesystem>
#include <span>
#include <stdexcept>
#include <string>
#include <vector>

#include "bench/program.h"
#include "bench/run_data.h"
#include "engine/gp/gp_model.h"
#include "engine/pilco/expected_return.h"
#include "kernels/philox/philox.h"
#include "tasks/registry.h"

namespace downpour {
namespace {

constexpr std::uint64_t kSeed = 1;

std::vector<ExactGp> LearnModel(const Dataset& data) {
  const std::vector<GpFit> fits = FitHyperparameters(data, {}, {.restarts = 0}, kSeed, 0, 2);
  std::vector<ExactGp> model;
  for (int e = 0; e < data.n_outputs(); ++e) {
    model.emplace_back(data.inputs, data.targets.col(e), fits[e].hyperparameters);
  }
  return model;
}

// Every evaluation at other parameters, so that none can be left out.
void Evaluate(benchmark::State& state, const Task& task, const std::vector<ExactGp>& model,
              int threads, bool with_gradient) {
  ExpectedReturn expected(task, {.kind = PolicyKind::kGp}, model, threads);
  std::vector<double> theta(static_cast<std::size_t>(expected.n_parameters()));
  std::vector<double> gradient(with_gradient ? theta.size() : 0);
  FillNormals({1, 5}, 0, theta.data(), theta.size());
  double sum = 0;
  for (auto _ : state) {
    theta[0] += 1e-3;
    sum += expected.Evaluate(theta, gradient);
    benchmark::ClobberMemory();
  }
  if (!std::isfinite(sum) || sum < 0) throw std::runtime_error("the chain broke off");
  const double pairs = task.horizon * 10.0 * std::pow(model[0].inputs().rows(), 2);
  state.counters["point_pairs/s"] = benchmark::Counter(
      pairs * static_cast<double>(state.iterations()), benchmark::Counter::kIsRate);
}

int Main(int argc, char** argv) {
  benchmark::Initialize(&argc, argv);
  if (argc != 2) throw std::runtime_error("usage: pilco_bench RUN [--benchmark_...]");
  const std::filesystem::path run = argv[1];
  const Task task = MakeTask("cartpole");
  std::vector<std::vector<ExactGp>> models;
  for (const int episodes : {4, 8}) {
    models.push_back(LearnModel(ReadDataset(task, std::span(&run, 1), episodes)));
  }
  for (const std::vector<ExactGp>& model : models) {
    for (const bool with_gradient : {false, true}) {
      for (const int threads : {1, 2}) {
        const std::string name = std::string(with_gradient ? "value_and_gradient" : "value") +
                                 "/n=" + std::to_string(model[0].inputs().rows()) +
                                 "/threads=" + std::to_string(threads);
        benchmark::RegisterBenchmark(name.c_str(), Evaluate, task, model, threads, with_gradient)
            ->Unit(benchmark::kMillisecond)
            ->UseRealTime();
      }
    }
  }
  benchmark::RunSpecifiedBenchmarks();
  return 0;
}

}  // namespace
}  // namespace downpour

int main(int argc, char** argv) {
  return downpour::RunProgram("pilco_bench", downpour::Main, argc, argv);
}
