// SPDX-License-Identifier: Apache-2.0
#include "tools/measure/rollout_profile.h"

#include <algorithm>
#include <chrono>
#include <limits>
#include <numeric>
#include <stdexcept>
#include <variant>
#include <vector>

#include "engine/rollout/tiling.h"
#include "kernels/gp_query/covariance_passes.h"

namespace downpour {
namespace {

using Clock = std::chrono::steady_clock;
constexpr double kNever = std::numeric_limits<double>::infinity();
constexpr int kLeastRepetitions = 3;
// Passes of a query whose times telescope: distances, powers, deflation, mean, variance.
constexpr int kStages = 5;
constexpr std::array<Cost, kStages> kStageCosts = {kCovariance, kExponential, kDeflation, kMean,
                                                   kTriangle};

double SecondsSince(Clock::time_point start) {
  return std::chrono::duration<double>(Clock::now() - start).count();
}

// What one reading of the clock takes, best of some hundreds.
double ClockSeconds() {
  double best = kNever;
  for (int round = 0; round < 200; ++round) {
    PartTimes times;
    PartClock clock(&times);
    for (int i = 0; i < 100; ++i) clock.Charge(kPartPacking);
    best = std::min(best, times.seconds[kPartPacking] / 100);
  }
  return best;
}

// Passes 0 to `stage` of a tile's queries by one factor.
class StageRunner {
 public:
  explicit StageRunner(std::span<const QueryFactor> factors)
      : mean_(kTileLanes), variance_(kTileLanes), scratch_(QueryScratch(factors, 1)) {}

  template <typename T>
  void Run(const GpFactorT<T>& factor, int stage, const double* x) {
    switch (stage) {
      case 0:
        return CovariancePasses(factor, CovariancePass::kDistances, x, scratch_.data());
      case 1:
        return CovariancePasses(factor, CovariancePass::kExponentials, x, scratch_.data());
      case 2:
        return CovariancePasses(factor, CovariancePass::kDeflation, x, scratch_.data());
      default:
        return GpQueryTile(factor, kTileLanes, x, scratch_.data(), mean_.data(),
                           stage == 4 ? variance_.data() : nullptr);
    }
  }
  void Run(const BlasFactor&, int, const double*) {}

 private:
  AlignedVector<double> mean_, variance_, scratch_;
};

// Full tiles (D x kTileLanes) of inputs (rows x D, row-major) spread evenly over all of them.
std::vector<AlignedVector<double>> MakeTiles(const std::vector<double>& inputs, std::size_t dim) {
  constexpr std::size_t kTiles = 8;
  const std::size_t n = inputs.size() / dim;
  std::vector<AlignedVector<double>> tiles(kTiles, AlignedVector<double>(dim * kTileLanes));
  for (std::size_t i = 0; i < kTiles * kTileLanes; ++i) {
    const std::size_t row = i * n / (kTiles * kTileLanes);
    for (std::size_t d = 0; d < dim; ++d) {
      tiles[i % kTiles][d * kTileLanes + i / kTiles] = inputs[row * dim + d];
    }
  }
  return tiles;
}

// Share of each stage in a query of all outputs; sums to 1.
std::array<double, kStages> QueryShares(std::span<const QueryFactor> factors,
                                        const std::vector<AlignedVector<double>>& tiles,
                                        bool use_variance, double seconds) {
  StageRunner runner(factors);
  std::array<double, kStages> best;
  best.fill(kNever);
  const int n_stages = use_variance ? kStages : kStages - 1;
  const Clock::time_point begin = Clock::now();
  for (int round = 0; round < kLeastRepetitions || SecondsSince(begin) < seconds; ++round) {
    for (int stage = 0; stage < n_stages; ++stage) {
      const Clock::time_point start = Clock::now();
      for (const AlignedVector<double>& tile : tiles) {
        for (const QueryFactor& factor : factors) {
          std::visit([&](const auto& f) { runner.Run(f, stage, tile.data()); }, factor);
        }
      }
      best[stage] = std::min(best[stage], SecondsSince(start));
    }
  }
  std::array<double, kStages> shares = {};
  double before = 0;
  for (int stage = 0; stage < n_stages; ++stage) {
    shares[stage] = std::max(0.0, best[stage] - before);  // a pass of no work by noise
    before = std::max(before, best[stage]);
  }
  for (double& share : shares) share /= before;
  return shares;
}

template <typename T>
void AddWork(const GpFactorT<T>& f, bool use_variance, std::array<Work, kCosts>* work) {
  const double n = f.n_padded;
  const auto add = [&](Cost cost, double operations, std::size_t values) {
    constexpr bool kSingle = sizeof(T) == sizeof(float);
    Work& w = (*work)[cost];
    (kSingle ? w.fp32_operations : w.fp64_operations) += operations;
    w.bytes += static_cast<double>(values * sizeof(T));
  };
  add(kCovariance, 3 * n * f.dim, f.inputs.size());
  add(kExponential, n * ExponentialOperations(sizeof(T) == sizeof(float)), 0);
  if (!f.deflation.empty()) add(kDeflation, 2 * n * kRowBlock, f.deflation.size());
  add(kMean, 2 * n, f.weights.size());
  // The zeros above the diagonal are read, not multiplied.
  if (use_variance) add(kTriangle, n * (n + 1) + 2 * n, f.triangle.size());
}
void AddWork(const BlasFactor& f, bool use_variance, std::array<Work, kCosts>* work) {
  // The triangular product; covariances and mean are small beside it.
  const double n = f.n;
  Work& w = (*work)[kBlasQueries];
  w.fp64_operations += n * (3 * f.dim + ExponentialOperations(false) + 2);
  w.fp64_operations += use_variance ? n * (n + 1) + 2 * n : 0;
  w.bytes += sizeof(double) * (n * (f.dim + 1) + (use_variance ? n * (n + 1) / 2 : 0));
}

// The work of one query, mean of the outputs, in tiles of `lanes` lanes.
std::array<Work, kCosts> CountWork(std::span<const QueryFactor> factors, bool use_variance,
                                   double lanes) {
  std::array<Work, kCosts> all = {};
  for (const QueryFactor& factor : factors) {
    std::visit([&](const auto& f) { AddWork(f, use_variance, &all); }, factor);
  }
  const auto n_outputs = static_cast<double>(factors.size());
  for (Work& work : all) {
    work.fp64_operations /= n_outputs;
    work.fp32_operations /= n_outputs;
    work.bytes /= n_outputs * lanes;
  }
  return all;
}

// The best of the repetitions, seconds.
struct Times {
  double plain = kNever;  // wall time of the evaluator without clocks
  double idle = 0;        // thread time without a tile of that repetition
  double parts_sum = kNever;
  std::array<double, kRolloutParts> parts = {};  // thread time less the clock's own
  std::array<double, kPerfEvents> events = {};   // of the whole batch, mean
};

void Evaluate(const KeptBatch& batch, Evaluator* evaluator, std::vector<double>* returns) {
  evaluator->Evaluate(batch.parameters, batch.keys, batch.n_rollouts, batch.first_rollout,
                      *returns);
}

void RunPlain(const KeptBatch& batch, Evaluator* evaluator, std::vector<double>* returns,
              Times* times) {
  const EvaluatorStatistics before = evaluator->statistics();
  Evaluate(batch, evaluator, returns);
  const EvaluatorStatistics taken = evaluator->statistics().Since(before);
  if (taken.seconds >= times->plain) return;
  times->plain = taken.seconds;
  times->idle = taken.idle_seconds;
}

void RunTimed(const KeptBatch& batch, double clock_seconds, Evaluator* evaluator,
              std::vector<double>* returns, Times* times) {
  const EvaluatorStatistics before = evaluator->statistics();
  Evaluate(batch, evaluator, returns);
  const PartTimes taken = evaluator->statistics().Since(before).parts;
  std::array<double, kRolloutParts> parts;
  for (int part = 0; part < kRolloutParts; ++part) {
    const double clock = clock_seconds * static_cast<double>(taken.readings[part]);
    parts[part] = std::max(0.0, taken.seconds[part] - clock);
  }
  const double sum = std::accumulate(parts.begin(), parts.end(), 0.0);
  if (sum >= times->parts_sum) return;
  times->parts_sum = sum;
  times->parts = parts;
}

}  // namespace

double RolloutProfile::Accounted() const {
  return std::accumulate(ns.begin(), ns.end(), 0.0) / measured_ns;
}

Cost RolloutProfile::Top() const {
  return static_cast<Cost>(std::max_element(ns.begin(), ns.end()) - ns.begin());
}

RolloutProfile ProfileRollouts(const Task& task, const Policy& policy,
                               std::span<const QueryFactor> factors,
                               const EvaluatorOptions& options, const KeptBatch& batch,
                               double seconds, std::span<const double> prior) {
  Evaluator plain(task, policy, factors, options, prior);
  Evaluator timed(task, policy, factors, options, prior);
  timed.TimeParts();
  const double clock_seconds = ClockSeconds();
  std::vector<double> returns(batch.TotalRollouts()), again(returns.size());
  PerfCounters counters;
  std::array<std::int64_t, kPerfEvents> counts = {};
  Times times;
  int rounds = 0;
  const Clock::time_point start = Clock::now();
  for (; rounds < kLeastRepetitions || SecondsSince(start) < seconds; ++rounds) {
    counters.Start();
    RunPlain(batch, &plain, &returns, &times);
    const auto counted = counters.Stop();
    for (int i = 0; i < kPerfEvents; ++i) counts[i] += counted[i];
    RunTimed(batch, clock_seconds, &timed, &again, &times);
    if (again != returns) throw std::logic_error("the clock changed the rollouts");
  }

  RolloutProfile profile{.threads = options.threads, .lanes = static_cast<int>(returns.size())};
  profile.tiles = Tiling(profile.lanes, options.threads, TileUnit(factors)).count();
  profile.queries = plain.statistics().gp_queries / rounds;
  const double per_query = 1e9 / static_cast<double>(profile.queries);
  profile.measured_ns = options.threads * times.plain * per_query;
  const auto part = [&](RolloutPart p) { return times.parts[p] * per_query; };
  profile.ns[kPrior] = part(kPartPrior);
  profile.ns[kSampling] = part(kPartSampling) + part(kPartTransition);
  profile.ns[kFeatures] = part(kPartFeatures);
  profile.ns[kPolicy] = part(kPartPolicy);
  profile.ns[kReward] = part(kPartReward);
  profile.ns[kBookkeeping] = part(kPartPacking) + times.idle * per_query;
  if (std::holds_alternative<BlasFactor>(factors.front())) {
    profile.ns[kBlasQueries] = part(kPartQueries);
    profile.tiles = WholeTiles(profile.lanes);
  } else {
    const auto met = plain.Trace(batch.parameters, batch.keys, batch.n_rollouts).inputs;
    const auto shares = QueryShares(factors.first(task.n_states()), MakeTiles(met, task.n_inputs()),
                                    options.use_variance, seconds / 2);
    for (int stage = 0; stage < kStages; ++stage) {
      profile.ns[kStageCosts[stage]] = shares[stage] * part(kPartQueries);
    }
  }
  profile.packed_bytes = PackedBytes(factors);
  profile.work =
      CountWork(factors, options.use_variance, static_cast<double>(profile.lanes) / profile.tiles);
  for (int i = 0; i < kPerfEvents; ++i) {
    profile.events[i] =
        counters.available(static_cast<PerfEvent>(i))
            ? static_cast<double>(counts[i]) / rounds / static_cast<double>(profile.queries)
            : std::numeric_limits<double>::quiet_NaN();
  }
  profile.missing_events = counters.reason();
  return profile;
}

Work QueryWork(std::span<const QueryFactor> factors, bool use_variance, double lanes) {
  Work sum;
  for (const Work& work : CountWork(factors, use_variance, lanes)) {
    sum.fp64_operations += work.fp64_operations;
    sum.fp32_operations += work.fp32_operations;
    sum.bytes += work.bytes;
  }
  return sum;
}

std::size_t PackedBytes(std::span<const QueryFactor> factors) {
  const Work work = QueryWork(factors, true, 1);
  return static_cast<std::size_t>(work.bytes * static_cast<double>(factors.size()));
}

Roof RoofOf(const Work& work, const Ceilings& ceilings, MemoryLevel level) {
  // GFLOP/s and GB/s are operations and bytes in a nanosecond.
  const double arithmetic = ceilings.threads * (work.fp64_operations / ceilings.fp64_gflops +
                                                work.fp32_operations / ceilings.fp32_gflops);
  const double bandwidth = ceilings.gigabytes_per_second[level];
  const double reading = bandwidth > 0 ? ceilings.threads * work.bytes / bandwidth : 0;
  return {std::max(arithmetic, reading), reading > arithmetic};
}

}  // namespace downpour
