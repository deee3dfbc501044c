// SPDX-License-Identifier: Apache-2.0
// Mean and variance of one GP output on one thread: the tile kernel in both precisions, one query
// at a time as GP libraries do it, and OpenBLAS on the whole batch. As in rollouts, four outputs
// take turns, so that a factor has left the nearer caches when its turn comes again. Names:
// variant/n/D/lanes.
// Counters, work counted as n (n + 8) operations a query: ns_per_query, queries_per_s, gflops, and
// peak_fraction of the multiply-add peak of the same precision, measured around each run. On a
// shared machine take the best of interleaved repetitions:
//   gp_query_bench --benchmark_repetitions=9 --benchmark_enable_random_interleaving=true
//                  --benchmark_filter=/320/6/
#include <benchmark/benchmark.h>
#include <cblas.h>

#include <Eigen/Dense>
#include <chrono>
#include <map>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "bench/baseline_per_query.h"
#include "engine/gp/compression.h"
#include "engine/gp/gp_model.h"
#include "engine/gp/process_settings.h"
#include "kernels/fma_peak/fma_peak.h"
#include "kernels/gp_query/gp_query.h"

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
    inverse = posterior.root;
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
  std::vector<std::unique_ptr<PerQueryGp>> per_query;
  Eigen::MatrixXd inverse;  // L^-1
  Eigen::MatrixXd queries;  // D x kTileLanes
  AlignedVector<double> x;  // the same as a tile
};

const Models& ModelsOf(int n, int dim) {
  static std::map<std::pair<int, int>, Models> all;
  return all.try_emplace({n, dim}, n, dim).first->second;
}

// Time of a run, and the multiply-add peak around it (mean of before and after): the clock of a
// shared machine changes by a fifth within seconds. Starts at its construction.
template <typename T>
class Run {
 public:
  void Report(benchmark::State& state, int n, int lanes) const {
    const double seconds = std::chrono::duration<double>(Clock::now() - start_).count();
    const double queries = static_cast<double>(state.iterations()) * lanes;
    const double gflops = queries * n * (n + 8.0) * 1e-9 / seconds;
    state.counters["ns_per_query"] = seconds / queries * 1e9;
    state.counters["queries_per_s"] = queries / seconds;
    state.counters["gflops"] = gflops;
    state.counters["peak_fraction"] = gflops / (0.5 * (peak_before_ + Peak()));
  }

 private:
  using Clock = std::chrono::steady_clock;
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

enum class BlasCall { kGemm, kTrmm, kTrsm };

void Multiply(BlasCall call, int n, const double* w, const double* l, const double* k, double* v) {
  if (call == BlasCall::kGemm) {
    cblas_dgemm(CblasColMajor, CblasNoTrans, CblasNoTrans, n, kBlasBatch, n, 1, w, n, k, n, 0, v,
                n);
  } else if (call == BlasCall::kTrmm) {
    cblas_dtrmm(CblasColMajor, CblasLeft, CblasLower, CblasNoTrans, CblasNonUnit, n, kBlasBatch, 1,
                w, n, v, n);
  } else {
    cblas_dtrsm(CblasColMajor, CblasLeft, CblasLower, CblasNoTrans, CblasNonUnit, n, kBlasBatch, 1,
                l, n, v, n);
  }
}
void Multiply(BlasCall call, int n, const float* w, const float* l, const float* k, float* v) {
  if (call == BlasCall::kGemm) {
    cblas_sgemm(CblasColMajor, CblasNoTrans, CblasNoTrans, n, kBlasBatch, n, 1, w, n, k, n, 0, v,
                n);
  } else if (call == BlasCall::kTrmm) {
    cblas_strmm(CblasColMajor, CblasLeft, CblasLower, CblasNoTrans, CblasNonUnit, n, kBlasBatch, 1,
                w, n, v, n);
  } else {
    cblas_strsm(CblasColMajor, CblasLeft, CblasLower, CblasNoTrans, CblasNonUnit, n, kBlasBatch, 1,
                l, n, v, n);
  }
}

// Kernel matrix and means by the tile kernel's own pass, V = L^-1 K by one BLAS call for the batch,
// squared norms of its columns.
template <typename T>
void Blas(benchmark::State& state, int n, int dim, BlasCall call) {
  using Matrix = Eigen::Matrix<T, Eigen::Dynamic, Eigen::Dynamic>;
  const Models& m = ModelsOf(n, dim);
  const GpFactorT<T>& factor = m.Factor<T>(0);
  const Matrix inverse = m.inverse.cast<T>(), cholesky = m.gp.cholesky().cast<T>();
  // The pass keeps its covariances to itself: these are copied in its place.
  const Matrix k = Matrix::Constant(n, kBlasBatch, T(0.5));
  Matrix v(n, kBlasBatch);
  Eigen::Matrix<T, 1, Eigen::Dynamic> norms(kBlasBatch);
  AlignedVector<char> scratch(GpQueryScratchBytes(factor));
  AlignedVector<double> means(kTileLanes);
  const Run<T> run;
  for (auto _ : state) {
    for (int first = 0; first < kBlasBatch; first += kTileLanes) {
      GpQueryTile(factor, kTileLanes, m.x.data(), scratch.data(), means.data(), nullptr);
    }
    if (call != BlasCall::kGemm) v = k;
    Multiply(call, n, inverse.data(), cholesky.data(), k.data(), v.data());
    norms = v.colwise().squaredNorm();
    benchmark::ClobberMemory();
  }
  run.Report(state, n, kBlasBatch);
}

void RegisterAll() {
  for (const int n : {40, 80, 160, 320, 640, 1280, 2560}) {
    for (const int dim : {4, 6, 12}) {
      const auto add = [&](const std::string& variant, int lanes, const auto& run) {
        const std::string name = variant + "/" + std::to_string(n) + "/" + std::to_string(dim) +
                                 "/" + std::to_string(lanes);
        benchmark::RegisterBenchmark(name.c_str(), run)->MinTime(0.05)->UseRealTime();
      };
      for (const int lanes : {1, 8, 24, 48}) {
        add("tile_fp64", lanes, [=](auto& s) { Tile<double>(s, n, dim, lanes, true); });
        add("tile_fp32", lanes, [=](auto& s) { Tile<float>(s, n, dim, lanes, true); });
      }
      add("tile_fp64_mean_only", 48, [=](auto& s) { Tile<double>(s, n, dim, 48, false); });
      add("tile_fp32_mean_only", 48, [=](auto& s) { Tile<float>(s, n, dim, 48, false); });
      add("per_query", 1, [=](auto& s) { PerQuery(s, n, dim); });
      for (const auto& [name, call] :
           {std::pair("gemm", BlasCall::kGemm), std::pair("trmm", BlasCall::kTrmm),
            std::pair("trsm", BlasCall::kTrsm)}) {
        const BlasCall c = call;
        add(std::string("blas_d") + name, kBlasBatch, [=](auto& s) { Blas<double>(s, n, dim, c); });
        add(std::string("blas_s") + name, kBlasBatch, [=](auto& s) { Blas<float>(s, n, dim, c); });
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
  benchmark::AddCustomContext("simd", downpour::SimdTargetName());
  benchmark::AddCustomContext("blas_core", downpour::BlasCoreName());
  downpour::RegisterAll();
  benchmark::RunSpecifiedBenchmarks();
  benchmark::Shutdown();
}
