// SPDX-License-Identifier: Apache-2.0
// What the engine answers to a file that bench/python_bench.py or tests/python wrote, and how long
// it takes, to compare the Python package with in bits and in time:
//   engine_answers FILE [--out ANSWERS] [--threads 2] [--repetitions 5]
// FILE: int64 n, D, E, B, N, P, then float64, row-major: X (n x D), Y (n x E), length-scales (E x
// D), signal_std (E), noise_std (E), queries (B x D), thetas (N x P), N = 0: none. ANSWERS: means
// and latent variances (B x E) of exact fp64 queries, then returns (N) of cart-pole by the default
// network, seed 0, on that model. Prints the best seconds of the queries: by tiles laid out
// beforehand, as rollouts have them, and by MultiOutputGp::Predict.
#include <CLI/App.hpp>
#include <CLI/Config.hpp>
#include <CLI/Formatter.hpp>
#include <algorithm>
#include <chrono>
#include <cstdint>
#include <cstdio>
#include <fstream>
#include <limits>
#include <string>
#include <vector>

#include "bench/program.h"
#include "engine/errors.h"
#include "engine/gp/multi_output_gp.h"
#include "engine/parallel_for.h"
#include "engine/rollout/evaluator.h"
#include "kernels/philox/philox.h"
#include "tasks/registry.h"

namespace downpour {
namespace {

using RowMajor = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

struct Problem {
  std::int64_t n = 0, dim = 0, n_outputs = 0, n_queries = 0, n_thetas = 0, n_parameters = 0;
  Dataset data;
  std::vector<Hyperparameters> hyperparameters;
  std::vector<double> queries, thetas;
};

Problem ReadProblem(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  Problem p;
  for (std::int64_t* number :
       {&p.n, &p.dim, &p.n_outputs, &p.n_queries, &p.n_thetas, &p.n_parameters}) {
    file.read(reinterpret_cast<char*>(number), sizeof(*number));
  }
  const auto read = [&file](std::int64_t rows, std::int64_t columns) {
    RowMajor matrix(rows, columns);
    file.read(reinterpret_cast<char*>(matrix.data()),
              static_cast<std::streamsize>(matrix.size() * sizeof(double)));
    return matrix;
  };
  p.data.inputs = read(p.n, p.dim);
  p.data.targets = read(p.n, p.n_outputs);
  const RowMajor lengthscales = read(p.n_outputs, p.dim);
  const RowMajor signal = read(p.n_outputs, 1), noise = read(p.n_outputs, 1);
  for (Eigen::Index e = 0; e < p.n_outputs; ++e) {
    const double* row = lengthscales.data() + e * p.dim;
    p.hyperparameters.push_back({{row, row + p.dim}, signal(e), noise(e)});
  }
  const RowMajor queries = read(p.n_queries, p.dim), thetas = read(p.n_thetas, p.n_parameters);
  p.queries.assign(queries.data(), queries.data() + queries.size());
  p.thetas.assign(thetas.data(), thetas.data() + thetas.size());
  if (!file) throw InvalidInput(path + ": shorter than it says, or no such file");
  return p;
}

template <typename Body>
double BestSeconds(int repetitions, const Body& body) {
  using Clock = std::chrono::steady_clock;
  double best = std::numeric_limits<double>::infinity();
  for (int i = 0; i < repetitions; ++i) {
    const Clock::time_point start = Clock::now();
    body();
    best = std::min(best, std::chrono::duration<double>(Clock::now() - start).count());
  }
  return best;
}

// Every tile by every output, from tiles laid out beforehand.
double TileSeconds(const MultiOutputGp& gp, const Problem& p, int threads, int repetitions) {
  const auto n_tiles = static_cast<int>((p.n_queries + kTileLanes - 1) / kTileLanes);
  const std::size_t size = static_cast<std::size_t>(p.dim) * kTileLanes;
  AlignedVector<double> x(n_tiles * size);
  for (std::int64_t i = 0; i < p.n_queries; ++i) {
    for (std::int64_t d = 0; d < p.dim; ++d) {
      x[i / kTileLanes * size + d * kTileLanes + i % kTileLanes] = p.queries[i * p.dim + d];
    }
  }
  const std::size_t answers = static_cast<std::size_t>(p.n_outputs) * kTileLanes;
  AlignedVector<double> means(n_tiles * answers), variances(n_tiles * answers);
  return BestSeconds(repetitions, [&] {
    ParallelFor(threads, threads, [&](int thread) {
      AlignedVector<char> scratch;
      for (int t = thread; t < n_tiles; t += threads) {
        for (std::int64_t e = 0; e < p.n_outputs; ++e) {
          const GpFactor& factor = std::get<GpFactor>(gp.factors()[e]);
          scratch.resize(GpQueryScratchBytes(factor));
          const std::size_t at = t * answers + e * kTileLanes;
          GpQueryTile(factor, kTileLanes, x.data() + t * size, scratch.data(), means.data() + at,
                      variances.data() + at);
        }
      }
    });
  });
}

std::vector<double> CartpoleReturns(const MultiOutputGp& gp, const Problem& p, int threads) {
  const Task task = MakeTask("cartpole");
  const std::unique_ptr<Policy> policy = MakePolicy(task, PolicyOptions{});
  EvaluatorOptions options;
  options.threads = threads;
  Evaluator evaluator(task, *policy, gp.factors(), options);
  const std::vector<StreamKey> keys(p.n_thetas, DeriveKey(0, StreamPurpose::kEvaluate, {}));
  const std::vector<int> one(p.n_thetas, 1), zero(p.n_thetas, 0);
  std::vector<double> returns(p.n_thetas);
  evaluator.Evaluate(p.thetas, keys, one, zero, returns);
  return returns;
}

void Answer(const std::string& path, const std::string& out, int threads, int repetitions) {
  const Problem p = ReadProblem(path);
  const QueryPlanOptions exact{.variance_tolerance = 0, .mean_tolerance = 0};
  const MultiOutputGp gp(p.data, p.hyperparameters, exact, threads);
  std::vector<double> means(p.n_queries * p.n_outputs), variances(means.size());
  const double batch = BestSeconds(
      repetitions, [&] { gp.Predict(p.queries, /*with_noise=*/false, threads, means, variances); });
  std::printf("{\"tiles_seconds\": %.6g, \"predict_seconds\": %.6g}\n",
              TileSeconds(gp, p, threads, repetitions), batch);
  if (out.empty()) return;
  std::vector<double> returns;
  if (p.n_thetas > 0) returns = CartpoleReturns(gp, p, threads);
  std::ofstream file(out, std::ios::binary);
  for (const std::vector<double>* part : {&means, &variances, &returns}) {
    file.write(reinterpret_cast<const char*>(part->data()),
               static_cast<std::streamsize>(part->size() * sizeof(double)));
  }
}

int Run(int argc, char** argv) {
  CLI::App app("The engine's answers to a file.");
  std::string path, out;
  int threads = 2, repetitions = 5;
  app.add_option("FILE", path)->required();
  app.add_option("--out", out);
  app.add_option("--threads", threads);
  app.add_option("--repetitions", repetitions);
  CLI11_PARSE(app, argc, argv);
  Answer(path, out, threads, repetitions);
  return 0;
}

}  // namespace
}  // namespace downpour

int main(int argc, char** argv) {
  return downpour::RunProgram("engine_answers", downpour::Run, argc, argv);
}
