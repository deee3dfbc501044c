// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <string>

#include "engine/gp/query_plan.h"
#include "engine/rollout/evaluator.h"
#include "tools/measure/ceilings.h"
#include "tools/measure/kept_batch.h"
#include "tools/measure/perf_counters.h"

namespace downpour {

// What rollouts cost, the queries' own costs first.
enum Cost {
  kCovariance,   // squared distances
  kExponential,  // powers of them
  kDeflation,    // of plans in single precision
  kMean,
  kTriangle,     // the variance
  kBlasQueries,  // all of the queries, by OpenBLAS
  kPrior,        // the prior mean of the dynamics
  kSampling,     // normal numbers and transition
  kFeatures,
  kPolicy,
  kReward,
  kBookkeeping,  // packing of tiles, returns; threads without a tile
  kCosts
};
inline constexpr std::array kCostNames = {"covariance", "exponential", "deflation", "mean",
                                          "triangle",   "openblas",    "prior",     "sampling",
                                          "features",   "policy",      "reward",    "bookkeeping"};

// Arithmetic of one query by one cost, mean of the outputs, and the bytes of packed factors that it
// reads: a factor is read once a tile.
struct Work {
  double fp64_operations = 0, fp32_operations = 0, bytes = 0;
  double operations() const { return fp64_operations + fp32_operations; }
};

// Where the time of a batch of rollouts goes, a GP query of one output: thread time, so that
// figures for several threads compare with those for one.
struct RolloutProfile {
  int threads = 1, lanes = 0, tiles = 0;
  std::int64_t queries = 0;            // of the batch
  std::size_t packed_bytes = 0;        // all factors
  double measured_ns = 0;              // Evaluator::Evaluate, best of the repetitions
  std::array<double, kCosts> ns = {};  // of each cost
  std::array<Work, kCosts> work = {};
  // Per query, NaN where the kernel offers no counter.
  std::array<double, kPerfEvents> events = {};
  std::string missing_events;  // why; empty if none is missing

  double Accounted() const;  // sum of `ns` / measured_ns
  Cost Top() const;          // the largest
};

// Runs `batch` by two evaluators in turns, one of which reads the clock between kernels, for about
// `seconds` or three times; the best counts. What the clock takes is measured and taken off. The
// queries are split by ablation: tiles of inputs that the batch meets, queried on one thread by the
// first pass of the kernel alone, the first two, and so on; what a pass adds is its share.
// `prior`: as the evaluator's.
RolloutProfile ProfileRollouts(const Task& task, const Policy& policy,
                               std::span<const QueryFactor> factors,
                               const EvaluatorOptions& options, const KeptBatch& batch,
                               double seconds, std::span<const double> prior = {});

// The work of one query by all of its costs, in tiles of `lanes` lanes.
Work QueryWork(std::span<const QueryFactor> factors, bool use_variance, double lanes);

// Bytes of all factors as they are packed.
std::size_t PackedBytes(std::span<const QueryFactor> factors);

// Least ns that `work` takes on one of the threads of `ceilings`, its data in `level` (0: not
// measured), and whether it is the reading that bounds it.
struct Roof {
  double ns = 0;
  bool memory_bound = false;
};
Roof RoofOf(const Work& work, const Ceilings& ceilings, MemoryLevel level);

}  // namespace downpour
