// SPDX-License-Identifier: Apache-2.0
// Mean and variance of one GP output on one thread: the tile kernel in both precisions, one query
// at a time as GP libraries do it, and OpenBLAS on a batch: the backend (blas_dtrmm) and what other
// calls and single precision make of it. As in rollouts, four outputs take turns, so that a factor
// has left the nearer caches when its turn comes again. Names: variant/n/D/lanes; triangle_* is a
// tile's variance without its covariances.
// Counters, work counted as n (n + 8) operations a query (the zeros that fill a block of eight rows
// at the diagonal count, though the tile kernel skips them): ns_per_query, queries_per_s, gflops,
// peak_fraction of the multiply-add peak of the same precision, measured around each run, and
// over_floor, its inverse: time over n (n + 8)/peak. On a shared machine take the best of
// interleaved repetitions:
//   gp_query_bench --benchmark_repetitions=9 --benchmark_enable_random_interleaving=true
//                  --benchmark_filter=/320/6/
#include <benchmark/benchmark.h>
#include <cblas.h>

#include <Eigen/Dense>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstddef>
#include <cstdlib>
#include <limits>
#include <map>
#include <memory>
#include <string>
#include <tuple>
#include <utility>
#include <vector>

#include "bench/baseline_per_query.h"
#include "engine/gp/blas_query.h"
#include "engine/gp/compression.h"
#include "engine/gp/gp_model.h"
#include "engine/gp/process_settings.h"
#include "kernels/dense_query/dense_query.h"
#include "kernels/fma_peak/fma_peak.h"
#include "kernels/gp_query/gp_query.h"
#include "tools/measure/machine.h"

namespace downpour {
namespace {

constexpr int kBlasBatch = 10 * kTileLanes;
constexpr int kOutputs = 4;

// Deterministic numbers in [-1, 1) (Weyl sequence).
class Numbers {
 public:
  double operator()() {
    state_ += 0.6180339887498949;
    if (state_ >= 1) state_ -= 1;
    return 2 * state_ - 1;
  }

 private:
  double state_ = 0.5;
};

// One (n, D): an exact GP, and what every variant makes of it, once for each output.
struct Models {
  Models(int n, int dim) : gp(RandomGp(n, dim)), queries(dim, kTileLanes), x(dim * kTileLanes) {
    const ReducedPosterior posterior = ExactPosterior(gp);
    for (int output = 0; output < kOutputs; ++output) {
      double_factors.push_back(PackPosterior<double>(gp, posterior));
      float_factors.push_back(PackPosterior<float>(gp, posterior));
      per_query.push_back(std::make_unique<PerQueryGp>(
          n, dim, gp.inputs().data(), gp.hyperparameters().lengthscales.data(),
          gp.hyperparameters().signal_std, gp.cholesky().data(), gp.alpha().data()));
    }
    blas_factors.assign(kOutputs, MakeBlasFactor(gp));
    Numbers numbers;
    for (int d = 0; d < dim; ++d) {
      for (int lane = 0; lane < kTileLanes; ++lane) {
        queries(d, lane) = x[d * kTileLanes + lane] = 2 * numbers();
      }
    }
  }

  static ExactGp RandomGp(int n, int dim) {
    Numbers numbers;
    const auto number = [&] { return numbers(); };
    Hyperparameters h;
    h.lengthscales.assign(dim, 2.0);
    h.signal_std = 1;
    h.noise_std = 0.1;
    return ExactGp(2 * Eigen::MatrixXd::NullaryExpr(n, dim, number),
                   Eigen::VectorXd::NullaryExpr(n, number), h);
  }

  template <typename T>
  const GpFactorT<T>& Factor(int output) const {
    if constexpr (sizeof(T) == 8) {
      return double_factors[output];
    } else {
      return float_factors[output];
    }
  }

  ExactGp gp;
  std::vector<GpFactor> double_factors;
  std::vector<GpFactor32> float_factors;
  std::vector<BlasFactor> blas_factors;
  std::vector<std::unique_ptr<PerQueryGp>> per_query;
  Eigen::MatrixXd queries;  // D x kTileLanes
  AlignedVector<double> x;  // the same as a tile
};

const Models& ModelsOf(int n, int dim) {
  static std::map<std::pair<int, int>, Models> all;
  return all.try_emplace({n, dim}, n, dim).first->second;
}

using Clock = std::chrono::steady_clock;

// Time of a run, and the multiply-add peak around it (mean of before and after): the clock of a
// shared machine changes by a fifth within seconds. Starts at its construction.
template <typename T>
class Run {
 public:
  void Report(benchmark::State& state, int n, int lanes) const {
    Report(state, n, lanes, std::chrono::duration<double>(Clock::now() - start_).count());
  }
  // The same where `seconds` of the run count.
  void Report(benchmark::State& state, int n, int lanes, double seconds) const {
    const double queries = static_cast<double>(state.iterations()) * lanes;
    const double gflops = queries * n * (n + 8.0) * 1e-9 / seconds;
    state.counters["ns_per_query"] = seconds / queries * 1e9;
    state.counters["queries_per_s"] = queries / seconds;
    state.counters["gflops"] = gflops;
    const double peak = 0.5 * (peak_before_ + Peak());
    state.counters["peak_fraction"] = gflops / peak;
    state.counters["over_floor"] = peak / gflops;
  }

 private:
  static double Peak() { return FmaPeakGflops(sizeof(T) == 4, 0.003); }
  double peak_before_ = Peak();
  Clock::time_point start_ = Clock::now();
};

template <typename T>
void Tile(benchmark::State& state, int n, int dim, int lanes, bool variance) {
  const Models& m = ModelsOf(n, dim);
  AlignedVector<char> scratch(GpQueryScratchBytes(m.Factor<T>(0)));
  AlignedVector<double> means(kTileLanes), variances(kTileLanes);
  int output = 0;
  const Run<T> run;
  for (auto _ : state) {
    GpQueryTile(m.Factor<T>(output), lanes, m.x.data(), scratch.data(), means.data(),
                variance ? variances.data() : nullptr);
    benchmark::ClobberMemory();
    output = (output + 1) % kOutputs;
  }
  run.Report(state, n, lanes);
}

// What the variance adds to the mean: whole and mean-only queries take turns.
template <typename T>
void Triangle(benchmark::State& state, int n, int dim) {
  const Models& m = ModelsOf(n, dim);
  AlignedVector<char> scratch(GpQueryScratchBytes(m.Factor<T>(0)));
  AlignedVector<double> means(kTileLanes), variances(kTileLanes);
  const auto seconds_of = [&](int output, double* variance) {
    const Clock::time_point start = Clock::now();
    GpQueryTile(m.Factor<T>(output), kTileLanes, m.x.data(), scratch.data(), means.data(),
                variance);
    benchmark::ClobberMemory();
    return std::chrono::duration<double>(Clock::now() - start).count();
  };
  int output = 0;
  double seconds = 0;
  const Run<T> run;
  for (auto _ : state) {
    const double triangle = seconds_of(output, variances.data()) - seconds_of(output, nullptr);
    state.SetIterationTime(triangle);
    seconds += triangle;
    output = (output + 1) % kOutputs;
  }
  run.Report(state, n, kTileLanes, seconds);
}

void PerQuery(benchmark::State& state, int n, int dim) {
  const Models& m = ModelsOf(n, dim);
  double mean = 0, variance = 0;
  int count = 0;
  const Run<double> run;
  for (auto _ : state) {
    const int lane = count / kOutputs % kTileLanes, output = count % kOutputs;
    m.per_query[output]->Query(m.queries.col(lane).data(), &mean, &variance);
    benchmark::DoNotOptimize(mean);
    benchmark::DoNotOptimize(variance);
    ++count;
  }
  run.Report(state, n, 1);
}

template <typename T>
struct Cblas;
template <>
struct Cblas<double> {
  static constexpr auto gemv = cblas_dgemv;
  static constexpr auto gemm = cblas_dgemm;
  static constexpr auto trmm = cblas_dtrmm;
  static constexpr auto trsm = cblas_dtrsm;
};
template <>
struct Cblas<float> {
  static constexpr auto gemv = cblas_sgemv;
  static constexpr auto gemm = cblas_sgemm;
  static constexpr auto trmm = cblas_strmm;
  static constexpr auto trsm = cblas_strsm;
};

enum class BlasCall { kGemm, kPanels, kTrmm, kTrsm };

// Rows of W at a time in kPanels: what the micro-kernel of OpenBLAS's dgemm takes.
constexpr int kPanelRows = 24;

// The matrix that a call multiplies by or solves with: W, L / signal_variance, or W's panels one
// after the other, each column-major up to its last row.
template <typename T>
std::vector<T> MatrixFor(BlasCall call, const Models& m) {
  const int n = m.blas_factors[0].n;
  const double signal_variance = m.blas_factors[0].signal_variance;
  Eigen::MatrixXd matrix =
      Eigen::Map<const Eigen::MatrixXd>(m.blas_factors[0].triangle.data(), n, n);
  if (call == BlasCall::kTrsm) matrix = m.gp.cholesky() / signal_variance;
  std::vector<T> values;
  for (int row = 0; call == BlasCall::kPanels && row < n; row += kPanelRows) {
    const int end_row = std::min(n, row + kPanelRows);
    for (const double w : matrix.block(row, 0, end_row - row, end_row).reshaped()) {
      values.push_back(static_cast<T>(w));
    }
  }
  if (call != BlasCall::kPanels) {
    for (const double w : matrix.reshaped()) values.push_back(static_cast<T>(w));
  }
  return values;
}

// V = E W^T panel by panel, in calls of m n k <= 10^6: on AVX-512 OpenBLAS multiplies such small
// matrices where they are, without packing them first.
template <typename T>
void MultiplyPanels(int lanes, int n, const T* w, const T* e, T* v) {
  constexpr int kDepth = 160;
  for (int row = 0; row < n; row += kPanelRows) {
    const int rows = std::min(kPanelRows, n - row);
    for (int k = 0; k < row + rows; k += kDepth) {
      const int depth = std::min(kDepth, row + rows - k);
      Cblas<T>::gemm(CblasColMajor, CblasNoTrans, CblasTrans, lanes, rows, depth, 1,
                     e + static_cast<std::size_t>(k) * lanes, lanes, w, rows, k == 0 ? 0 : 1,
                     v + static_cast<std::size_t>(row) * lanes, lanes);
      w += static_cast<std::size_t>(rows) * depth;
    }
  }
}

// The variance of query `lane` by a triangular solve.
double Variance(const Models& m, int lane) {
  double mean = 0, variance = 0;
  m.gp.Predict(m.queries.col(lane), &mean, &variance);
  return variance;
}

// V = E W^T; returns where it is: v, or e itself.
template <typename T>
T* Multiply(BlasCall call, int lanes, int n, const T* matrix, T* e, T* v) {
  if (call == BlasCall::kPanels) {
    MultiplyPanels(lanes, n, matrix, e, v);
    return v;
  }
  if (call == BlasCall::kGemm) {
    Cblas<T>::gemm(CblasColMajor, CblasNoTrans, CblasTrans, lanes, n, n, 1, e, lanes, matrix, n, 0,
                   v, lanes);
    return v;
  }
  const auto multiply = call == BlasCall::kTrmm ? Cblas<T>::trmm : Cblas<T>::trsm;
  multiply(CblasColMajor, CblasRight, CblasLower, CblasTrans, CblasNonUnit, lanes, n, 1, matrix, n,
           e, lanes);
  return e;
}

// The BLAS backend's query with other calls and in other precision than its own.
template <typename T>
void Blas(benchmark::State& state, int n, int dim, int lanes, BlasCall call) {
  const Models& m = ModelsOf(n, dim);
  const std::vector<std::vector<T>> matrices(kOutputs, MatrixFor<T>(call, m));
  const BlasFactor& first = m.blas_factors[0];
  const std::vector<T> points(first.inputs.begin(), first.inputs.end());
  const std::vector<T> weights(first.weights.begin(), first.weights.end());
  const std::size_t size = lanes;
  AlignedVector<T> queries(dim * size), e(n * size), v(n * size), means(size);
  AlignedVector<double> variances(size);
  int output = 0;
  const Run<T> run;
  for (auto _ : state) {
    const BlasFactor& f = m.blas_factors[output];
    for (int d = 0; d < dim; ++d) {
      for (int lane = 0; lane < lanes; ++lane) {
        const double x = m.x[d * kTileLanes + lane % kTileLanes];
        queries[d * size + lane] = static_cast<T>(f.scale[d] * x - f.centre[d]);
      }
    }
    QueryCovariances(lanes, n, dim, queries.data(), points.data(), e.data());
    Cblas<T>::gemv(CblasColMajor, CblasNoTrans, lanes, n, 1, e.data(), lanes, weights.data(), 1, 0,
                   means.data(), 1);
    const T* const product = Multiply(call, lanes, n, matrices[output].data(), e.data(), v.data());
    QueryVariances(lanes, n, f.signal_variance, product, variances.data());
    benchmark::ClobberMemory();
    output = (output + 1) % kOutputs;
  }
  run.Report(state, n, lanes);
  const double error = std::abs(variances[lanes - 1] - Variance(m, (lanes - 1) % kTileLanes));
  if (!(error <= 100 * n * std::numeric_limits<T>::epsilon())) {
    state.SkipWithError("the answers are wrong");
  }
}

// The backend itself.
void BlasBackend(benchmark::State& state, int n, int dim, int tiles) {
  const Models& m = ModelsOf(n, dim);
  AlignedVector<char> scratch(BlasQueryScratchBytes(m.blas_factors[0], tiles));
  AlignedVector<double> x, means(tiles * dim * kTileLanes), variances(tiles * dim * kTileLanes);
  for (int tile = 0; tile < tiles; ++tile) x.insert(x.end(), m.x.begin(), m.x.end());
  int output = 0;
  const Run<double> run;
  for (auto _ : state) {
    BlasQuery(m.blas_factors[output], tiles, dim * kTileLanes, x.data(), scratch.data(),
              means.data(), variances.data());
    benchmark::ClobberMemory();
    output = (output + 1) % kOutputs;
  }
  run.Report(state, n, tiles * kTileLanes);
}

void RegisterAll() {
  for (const int n : {40, 80, 160, 320, 600, 640, 1280, 2560}) {
    for (const int dim : {4, 6, 12}) {
      const auto add_row = [&](const std::string& variant, int lanes, const auto& run) {
        const std::string name = variant + "/" + std::to_string(n) + "/" + std::to_string(dim) +
                                 "/" + std::to_string(lanes);
        return benchmark::RegisterBenchmark(name.c_str(), run)->MinTime(0.05);
      };
      const auto add = [&](const std::string& variant, int lanes, const auto& run) {
        add_row(variant, lanes, run)->UseRealTime();
      };
      for (const int lanes : {1, 8, 16, 24, 40, 48}) {
        add("tile_fp64", lanes, [=](auto& s) { Tile<double>(s, n, dim, lanes, true); });
        add("tile_fp32", lanes, [=](auto& s) { Tile<float>(s, n, dim, lanes, true); });
      }
      add("tile_fp64_mean_only", 48, [=](auto& s) { Tile<double>(s, n, dim, 48, false); });
      add("tile_fp32_mean_only", 48, [=](auto& s) { Tile<float>(s, n, dim, 48, false); });
      add_row("triangle_fp64", kTileLanes, [=](auto& s) {
        Triangle<double>(s, n, dim);
      })->UseManualTime();
      add_row("triangle_fp32", kTileLanes, [=](auto& s) {
        Triangle<float>(s, n, dim);
      })->UseManualTime();
      add("per_query", 1, [=](auto& s) { PerQuery(s, n, dim); });
      for (const int tiles : {1, kBlasTiles, kBlasBatch / kTileLanes}) {
        add("blas_dtrmm", tiles * kTileLanes, [=](auto& s) { BlasBackend(s, n, dim, tiles); });
      }
      add("blas_strmm", kBlasBatch,
          [=](auto& s) { Blas<float>(s, n, dim, kBlasBatch, BlasCall::kTrmm); });
      for (const auto& [name, call, lanes] :
           {std::tuple("gemm", BlasCall::kGemm, kBlasBatch),
            std::tuple("gemm_panels", BlasCall::kPanels, 2 * kTileLanes),
            std::tuple("trsm", BlasCall::kTrsm, kBlasBatch)}) {
        const BlasCall c = call;
        const int l = lanes;
        add(std::string("blas_d") + name, l, [=](auto& s) { Blas<double>(s, n, dim, l, c); });
        add(std::string("blas_s") + name, l, [=](auto& s) { Blas<float>(s, n, dim, l, c); });
      }
    }
  }
}

}  // namespace
}  // namespace downpour

int main(int argc, char** argv) {
  downpour::PrepareProcess(argv);
  benchmark::Initialize(&argc, argv);
  if (benchmark::ReportUnrecognizedArguments(argc, argv)) return 2;
  for (const auto& [name, value] : downpour::DescribeMachine()) {
    benchmark::AddCustomContext(name, value);
  }
  // A build does not know it: it would differ from one commit to the next.
  const char* commit = std::getenv("DOWNPOUR_COMMIT");
  benchmark::AddCustomContext("commit", commit != nullptr ? commit : "unknown");
  downpour::RegisterAll();
  benchmark::RunSpecifiedBenchmarks();
  benchmark::Shutdown();
}
