// SPDX-License-Identifier: Apache-2.0
#include "engine/gp/multi_output_gp.h"

#include <algorithm>
#include <cstddef>
#include <optional>
#include <string>
#include <utility>
#include <variant>

#include "engine/errors.h"
#include "engine/gp/blas_query.h"
#include "engine/gp/checks.h"
#include "engine/gp/query_timing.h"
#include "engine/parallel_for.h"
#include "kernels/aligned.h"
#include "kernels/philox/philox.h"

namespace downpour {
namespace {

// Tiles that an output takes in one turn: enough that its factor stays in the cache for a while.
constexpr int kChunkTiles = 10;
constexpr int kMinMixed = 256;

// The training inputs, and as many points x_i + u (x_j - x_i), u in [-0.25, 1.25), of pairs of
// them: what lies between the data, and a little beyond.
Eigen::MatrixXd Probes(const Eigen::MatrixXd& inputs) {
  const auto n = static_cast<int>(inputs.rows());
  const int n_mixed = std::max(n, kMinMixed);
  std::vector<double> u(static_cast<std::size_t>(n_mixed) * 2);
  FillUniforms(DeriveKey(0, StreamPurpose::kPlanProbe, {}), 0, u.data(), u.size());
  Eigen::MatrixXd probes(n + n_mixed, inputs.cols());
  probes.topRows(n) = inputs;
  for (int k = 0; k < n_mixed; ++k) {
    const auto other = static_cast<Eigen::Index>(u[2 * k] * n);
    const double share = 1.5 * u[2 * k + 1] - 0.25;
    probes.row(n + k) = (1 - share) * inputs.row(k % n) + share * inputs.row(other);
  }
  return probes;
}

void CheckSize(const char* name, std::size_t size, std::size_t wanted) {
  if (size == wanted) return;
  throw InvalidInput("GP: " + std::string(name) + " has " + std::to_string(size) +
                     " numbers, must have " + std::to_string(wanted));
}

// Doubles that `bytes` take.
std::size_t InDoubles(std::size_t bytes) { return (bytes + sizeof(double) - 1) / sizeof(double); }

}  // namespace

// Queries [first, first + n) of a batch.
struct MultiOutputGp::Chunk {
  std::span<const double> inputs;
  bool with_noise;
  std::span<double> means, variances;
  std::size_t first;
  int n;
};

MultiOutputGp::MultiOutputGp(const Dataset& data, std::span<const Hyperparameters> hyperparameters,
                             const QueryPlanOptions& options, int threads) {
  CheckTrainingData(data.inputs, data.targets);
  const int n_outputs = data.n_outputs();
  if (static_cast<int>(hyperparameters.size()) != n_outputs) {
    throw InvalidInput(
        "GP: " + std::to_string(hyperparameters.size()) +
        " sets of hyper-parameters, must be one an output = " + std::to_string(n_outputs));
  }
  const Eigen::MatrixXd probes = Probes(data.inputs);
  std::vector<std::optional<ExactGp>> gps(n_outputs);
  plans_.resize(n_outputs);
  ParallelFor(n_outputs, threads, [&](int e) {
    gps[e].emplace(data.inputs, data.targets.col(e), hyperparameters[e]);
    plans_[e] = ChoosePlan(*gps[e], probes, options);
  });
  for (int e = 0; e < n_outputs; ++e) {
    exact_.push_back(std::move(*gps[e]));
    factors_.push_back(std::move(plans_[e].factor));
  }
}

MultiOutputGp MultiOutputGp::Fit(const Dataset& data, const QueryPlanOptions& options,
                                 std::uint64_t seed, int threads, const std::atomic<bool>* stop) {
  std::vector<Hyperparameters> hyperparameters;
  for (GpFit& fit : FitHyperparameters(data, {}, {}, seed, 0, threads, stop)) {
    hyperparameters.push_back(std::move(fit.hyperparameters));
  }
  return MultiOutputGp(data, hyperparameters, options, threads);
}

void MultiOutputGp::Predict(std::span<const double> inputs, bool with_noise, int threads,
                            std::span<double> means, std::span<double> variances) const {
  const std::size_t n_queries = inputs.size() / n_inputs();
  CheckSize("inputs", inputs.size(), n_queries * n_inputs());
  CheckSize("means", means.size(), n_queries * n_outputs());
  if (!variances.empty()) CheckSize("variances", variances.size(), means.size());
  // OpenBLAS's bits may depend on the packing, which must not depend on the threads.
  const bool blas = std::any_of(factors_.begin(), factors_.end(), [](const QueryFactor& factor) {
    return std::holds_alternative<BlasFactor>(factor);
  });
  const std::size_t n_tiles = (n_queries + kTileLanes - 1) / kTileLanes;
  const std::size_t share = (n_tiles + threads - 1) / threads;
  const std::size_t tiles = blas ? kChunkTiles : std::clamp<std::size_t>(share, 1, kChunkTiles);
  const std::size_t size = tiles * kTileLanes;
  const auto n_chunks = static_cast<int>((n_queries + size - 1) / size);
  ParallelFor(n_chunks, threads, [&](int i) {
    const std::size_t first = i * size;
    const auto n = static_cast<int>(std::min(size, n_queries - first));
    PredictChunk({inputs, with_noise, means, variances, first, n});
  });
}

void MultiOutputGp::PredictChunk(const Chunk& chunk) const {
  const std::size_t dim = n_inputs(), n_out = n_outputs();
  const int n_tiles = (chunk.n + kTileLanes - 1) / kTileLanes;
  // A tile's rows: inputs (D), means (E), variances (E).
  const std::size_t stride = (dim + 2 * n_out) * kTileLanes;
  std::size_t bytes = 0;
  for (const QueryFactor& factor : factors_) {
    if (const auto* f = std::get_if<BlasFactor>(&factor)) {
      bytes = std::max(bytes, BlasQueryScratchBytes(*f, n_tiles));
    } else {
      std::visit([&](const auto& f) { bytes = std::max(bytes, GpQueryScratchBytes(f)); }, factor);
    }
  }
  AlignedVector<double> tiles(n_tiles * stride);
  AlignedVector<double> scratch(InDoubles(bytes));
  for (int i = 0; i < chunk.n; ++i) {
    double* const column = &tiles[i / kTileLanes * stride + i % kTileLanes];
    const double* const row = &chunk.inputs[(chunk.first + i) * dim];
    for (std::size_t d = 0; d < dim; ++d) column[d * kTileLanes] = row[d];
  }
  const bool variance_too = !chunk.variances.empty();
  for (std::size_t e = 0; e < n_out; ++e) {
    double* const mean = tiles.data() + (dim + e) * kTileLanes;
    double* const variance = variance_too ? mean + n_out * kTileLanes : nullptr;
    if (const auto* blas = std::get_if<BlasFactor>(&factors_[e])) {
      BlasQuery(*blas, n_tiles, stride, tiles.data(), scratch.data(), mean, variance);
      continue;
    }
    for (int t = 0; t < n_tiles; ++t) {
      const int lanes = std::min(kTileLanes, chunk.n - t * kTileLanes);
      std::visit(
          [&](const auto& f) {
            GpQueryTile(f, lanes, tiles.data() + t * stride, scratch.data(), mean + t * stride,
                        variance_too ? variance + t * stride : nullptr);
          },
          factors_[e]);
    }
  }
  for (int i = 0; i < chunk.n; ++i) {
    const double* const column = &tiles[i / kTileLanes * stride + i % kTileLanes];
    for (std::size_t e = 0; e < n_out; ++e) {
      const std::size_t to = (chunk.first + i) * n_out + e;
      chunk.means[to] = column[(dim + e) * kTileLanes];
      if (!variance_too) continue;
      const double noise_std = exact_[e].hyperparameters().noise_std;
      chunk.variances[to] =
          column[(dim + n_out + e) * kTileLanes] + (chunk.with_noise ? noise_std * noise_std : 0);
    }
  }
}

std::vector<double> MultiOutputGp::TimeQueries() const {
  return downpour::TimeQueries(factors_, exact_.front().inputs());
}

}  // namespace downpour
