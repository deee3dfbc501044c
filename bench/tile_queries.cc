// SPDX-License-Identifier: Apache-2.0
#include "bench/tile_queries.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <variant>

#include "kernels/aligned.h"
#include "kernels/gp_query/gp_query.h"

namespace downpour {
namespace {

constexpr int kRepetitions = 9;
constexpr int kTimedTiles = 16;
constexpr int kTimedSingleQueries = 96;

// The tile (D x kTileLanes) of rows first, first + stride, ...; the last one is repeated.
AlignedVector<double> MakeTile(const Eigen::MatrixXd& inputs, Eigen::Index first,
                               Eigen::Index stride) {
  AlignedVector<double> tile(inputs.cols() * kTileLanes);
  for (int lane = 0; lane < kTileLanes; ++lane) {
    const Eigen::Index row = std::min(first + lane * stride, inputs.rows() - 1);
    for (Eigen::Index d = 0; d < inputs.cols(); ++d) tile[d * kTileLanes + lane] = inputs(row, d);
  }
  return tile;
}

// Room for the answers of a tile by any of some factors.
struct TileAnswers {
  explicit TileAnswers(std::span<const QueryFactor> factors)
      : mean(kTileLanes), variance(kTileLanes) {
    std::size_t bytes = 0;
    for (const QueryFactor& factor : factors) {
      bytes =
          std::max(bytes, std::visit([](const auto& f) { return GpQueryScratchBytes(f); }, factor));
    }
    scratch = AlignedVector<char>(bytes);
  }
  void Ask(const QueryFactor& factor, const AlignedVector<double>& tile) {
    std::visit(
        [&](const auto& f) {
          GpQueryTile(f, kTileLanes, tile.data(), scratch.data(), mean.data(), variance.data());
        },
        factor);
  }
  AlignedVector<double> mean, variance;
  AlignedVector<char> scratch;
};

double NanosecondsSince(std::chrono::steady_clock::time_point start) {
  return std::chrono::duration<double, std::nano>(std::chrono::steady_clock::now() - start).count();
}

// Lowers each output's best time if this repetition is faster.
void KeepBest(const std::vector<double>& total, double queries, std::vector<double>* best) {
  best->resize(total.size(), HUGE_VAL);
  for (std::size_t e = 0; e < total.size(); ++e) {
    (*best)[e] = std::min((*best)[e], total[e] / queries);
  }
}

void TimeTiles(std::span<const QueryFactor> factors,
               const std::vector<AlignedVector<double>>& tiles, std::vector<double>* best) {
  TileAnswers answers(factors);
  std::vector<double> total(factors.size(), 0.0);
  for (const AlignedVector<double>& tile : tiles) {
    for (std::size_t e = 0; e < factors.size(); ++e) {
      const auto start = std::chrono::steady_clock::now();
      answers.Ask(factors[e], tile);
      total[e] += NanosecondsSince(start);
    }
  }
  KeepBest(total, static_cast<double>(tiles.size()) * kTileLanes, best);
}

void TimeSingleQueries(std::span<const std::unique_ptr<PerQueryGp>> gps,
                       const Eigen::MatrixXd& queries, std::vector<double>* best) {
  std::vector<double> total(gps.size(), 0.0);
  for (Eigen::Index i = 0; i < queries.cols(); ++i) {
    for (std::size_t e = 0; e < gps.size(); ++e) {
      double mean = 0, variance = 0;
      const auto start = std::chrono::steady_clock::now();
      gps[e]->Query(queries.col(i).data(), &mean, &variance);
      total[e] += NanosecondsSince(start);
    }
  }
  KeepBest(total, static_cast<double>(queries.cols()), best);
}

}  // namespace

int CountUnsound(const QueryFactor& factor, const Eigen::MatrixXd& inputs) {
  TileAnswers answers({&factor, 1});
  int count = 0;
  for (Eigen::Index first = 0; first < inputs.rows(); first += kTileLanes) {
    answers.Ask(factor, MakeTile(inputs, first, 1));
    const Eigen::Index lanes = std::min<Eigen::Index>(kTileLanes, inputs.rows() - first);
    for (Eigen::Index lane = 0; lane < lanes; ++lane) {
      const double variance = answers.variance[lane];
      if (!std::isfinite(answers.mean[lane]) || !std::isfinite(variance) || variance < 0) ++count;
    }
  }
  return count;
}

QueryTimes TimeQueries(std::span<const QueryFactor> exact, std::span<const QueryFactor> plan,
                       std::span<const std::unique_ptr<PerQueryGp>> per_query,
                       const Eigen::MatrixXd& inputs) {
  std::vector<AlignedVector<double>> tiles;
  const Eigen::Index stride = std::max<Eigen::Index>(1, inputs.rows() / kTileLanes);
  for (int t = 0; t < kTimedTiles; ++t)
    tiles.push_back(MakeTile(inputs, stride * t / kTimedTiles, stride));
  Eigen::MatrixXd queries(inputs.cols(), kTimedSingleQueries);
  for (Eigen::Index i = 0; i < queries.cols(); ++i) {
    queries.col(i) = inputs.row(inputs.rows() * i / queries.cols());
  }
  QueryTimes times;
  for (int repetition = 0; repetition < kRepetitions; ++repetition) {
    TimeTiles(exact, tiles, &times.exact);
    TimeTiles(plan, tiles, &times.plan);
    TimeSingleQueries(per_query, queries, &times.per_query);
  }
  return times;
}

}  // namespace downpour
