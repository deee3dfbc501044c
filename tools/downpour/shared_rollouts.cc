// SPDX-License-Identifier: Apache-2.0
#include "tools/downpour/shared_rollouts.h"

#include <fmt/format.h>
#include <omp.h>

#include <algorithm>
#include <chrono>
#include <memory>
#include <numeric>
#include <optional>
#include <stdexcept>
#include <utility>
#include <variant>

#include "engine/errors.h"
#include "engine/learner/platform.h"
#include "engine/rollout/tiling.h"
#include "tools/downpour/bytes.h"
#include "tools/downpour/file_tree.h"
#include "tools/downpour/pause.h"
#include "tools/downpour/prior.h"
#include "tools/downpour/stop.h"

namespace downpour {
namespace {

// What rank 0 says, and whether the helper could do it.
enum class Order : char { kRun, kFactor, kPrior, kBatch };
enum class Answer : char { kDone, kFailed };

double SecondsSince(std::chrono::steady_clock::time_point start) {
  return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
}

template <typename T>
void PutFactor(const GpFactorT<T>& factor, ByteWriter* message) {
  message->Put(factor.n);
  message->Put(factor.dim);
  message->Put(factor.n_padded);
  message->Put(factor.signal_variance);
  message->Put(factor.noise_variance);
  message->PutAll(factor.scale);
  message->PutAll(factor.centre);
  message->PutAll(factor.inputs);
  message->PutAll(factor.weights);
  message->PutAll(factor.triangle);
  message->PutAll(factor.deflation);
}

void PutFactor(const BlasFactor&, ByteWriter*) {
  throw std::logic_error("factors for OpenBLAS are not shared");
}

template <typename T>
GpFactorT<T> GetFactor(ByteReader* message) {
  GpFactorT<T> factor;
  message->Get(&factor.n);
  message->Get(&factor.dim);
  message->Get(&factor.n_padded);
  message->Get(&factor.signal_variance);
  message->Get(&factor.noise_variance);
  message->GetAll(&factor.scale);
  message->GetAll(&factor.centre);
  message->GetAll(&factor.inputs);
  message->GetAll(&factor.weights);
  message->GetAll(&factor.triangle);
  message->GetAll(&factor.deflation);
  return factor;
}

// Rollouts [first, last) of a batch, in the order of its returns.
struct Slice {
  int first = 0, last = 0;
  std::span<const double> parameters;
  std::span<const StreamKey> keys;
  std::vector<int> n_rollouts, first_rollout;
};

Slice Cut(const CandidateBatch& batch, int first, int last) {
  Slice slice = {first, last, {}, {}, {}, {}};
  const std::size_t n_parameters = batch.parameters.size() / batch.keys.size();
  std::size_t first_candidate = 0;
  int at = 0;
  for (std::size_t c = 0; c < batch.keys.size(); at += batch.n_rollouts[c++]) {
    const int begin = std::max(first - at, 0);
    const int end = std::min(last - at, batch.n_rollouts[c]);
    if (begin >= end) continue;
    if (slice.n_rollouts.empty()) first_candidate = c;
    slice.n_rollouts.push_back(end - begin);
    slice.first_rollout.push_back(batch.first_rollout[c] + begin);
  }
  const std::size_t n = slice.n_rollouts.size();
  slice.keys = batch.keys.subspan(first_candidate, n);
  slice.parameters = batch.parameters.subspan(first_candidate * n_parameters, n * n_parameters);
  return slice;
}

}  // namespace

void CheckShareable(const RunConfig& config) {
  if (config.learner.algorithm == Algorithm::kPilco) {
    throw InvalidInput(
        "learn.algorithm = pilco: must be black-drops with several processes, which share "
        "rollouts");
  }
  if (config.learner.search.stop_lost_causes) {
    throw InvalidInput(
        "search.stop_lost_causes = true: must be false with several processes, each of which sees "
        "only some of the candidates");
  }
  if (config.learner.plan.backend == QueryBackend::kBlas) {
    throw InvalidInput(
        "model.backend = blas: must be fused with several processes: OpenBLAS's bits depend on how "
        "candidates are packed");
  }
}

SharedRollouts::SharedRollouts(MpiWorld* world, const RunDirectory& run, int threads)
    : world_(world), first_thread_{0, threads} {
  std::vector<FileCopy> files = ReadTree(run.path() / kTaskFolder);
  for (FileCopy& file : files) file.path = kTaskFolder / file.path;
  files.push_back({"config.toml", run.ReadConfig()});
  ByteWriter message;
  message.Put(Order::kRun);
  PutFiles(files, &message);
  const std::string bytes = message.Take();
  for (int rank = 1; rank < world_->size(); ++rank) world_->Send(rank, bytes);
  const Platform mine = CurrentPlatform();
  const std::vector<std::string> answers = Answers();
  for (int rank = 1; rank < world_->size(); ++rank) {
    ByteReader answer(answers[rank]);
    const std::string simd_target = answer.GetText(), blas_core = answer.GetText();
    first_thread_.push_back(first_thread_.back() + answer.Get<int>());
    if (simd_target == mine.simd_target) continue;
    throw InvalidInput(
        fmt::format("rank {} runs on {}, rank 0 on {}: all machines must have the same SIMD "
                    "target, or results depend on who computes what",
                    rank, simd_target, mine.simd_target));
  }
}

std::vector<std::string> SharedRollouts::Answers() {
  std::vector<std::string> answers(world_->size());
  Pause pause;
  for (int left = world_->size() - 1; left > 0;) {
    std::optional<MpiMessage> message = world_->Poll();
    if (!message) {
      if (StopRequested()) throw Interrupted();
      pause.Wait();
      continue;
    }
    ByteReader answer(message->bytes);
    if (answer.Get<Answer>() == Answer::kFailed) {
      throw std::runtime_error(fmt::format("rank {}: {}", message->rank, answer.GetText()));
    }
    answers[message->rank] = message->bytes.substr(sizeof(Answer));
    --left;
  }
  return answers;
}

void SharedRollouts::SetModel(std::span<const QueryFactor> factors, std::span<const double> prior) {
  const auto send_to_all = [this](ByteWriter message) {
    const std::string bytes = message.Take();
    for (int rank = 1; rank < world_->size(); ++rank) world_->Send(rank, bytes);
  };
  for (std::size_t e = 0; e < factors.size(); ++e) {
    ByteWriter message;
    message.Put(Order::kFactor);
    message.Put(e);
    message.Put(factors.size());
    message.Put(std::holds_alternative<GpFactor32>(factors[e]));
    std::visit([&](const auto& factor) { PutFactor(factor, &message); }, factors[e]);
    send_to_all(std::move(message));
  }
  ByteWriter message;
  message.Put(Order::kPrior);
  message.PutAll(prior);
  send_to_all(std::move(message));
}

void SharedRollouts::Evaluate(const CandidateBatch& batch, Evaluator* evaluator,
                              std::span<double> returns) {
  const int unit = TileUnit(true);
  const auto start = std::chrono::steady_clock::now();
  const int n = static_cast<int>(returns.size());
  const std::int64_t n_units = (n + unit - 1) / unit;
  std::vector<Slice> slices;
  for (int rank = 0; rank < world_->size(); ++rank) {
    const auto bound = [&](int threads_before) {
      return static_cast<int>(
          std::min<std::int64_t>(n_units * threads_before / threads() * unit, n));
    };
    slices.push_back(Cut(batch, bound(first_thread_[rank]), bound(first_thread_[rank + 1])));
    if (rank == 0) continue;
    ByteWriter message;
    message.Put(Order::kBatch);
    message.PutAll(slices[rank].parameters);
    message.PutAll(slices[rank].keys);
    message.PutAll(slices[rank].n_rollouts);
    message.PutAll(slices[rank].first_rollout);
    message.Put(batch.relaxed);
    world_->Send(rank, message.Take());
  }
  const EvaluatorStatistics before = evaluator->statistics();
  const Slice& own = slices.front();
  evaluator->Evaluate(own.parameters, own.keys, own.n_rollouts, own.first_rollout,
                      returns.first(own.last), {}, batch.relaxed);
  const double own_seconds = evaluator->statistics().Since(before).seconds;
  const std::vector<std::string> answers = Answers();
  const double seconds = SecondsSince(start);
  EvaluatorStatistics others;
  for (int rank = 1; rank < world_->size(); ++rank) {
    const Slice& slice = slices[rank];
    ByteReader answer(answers[rank]);
    std::vector<double> part;
    answer.GetAll(&part);
    if (static_cast<int>(part.size()) != slice.last - slice.first) {
      throw std::runtime_error(fmt::format("rank {}: wrong number of returns", rank));
    }
    std::copy(part.begin(), part.end(), returns.begin() + slice.first);
    auto statistics = answer.Get<EvaluatorStatistics>();
    const int n_threads = first_thread_[rank + 1] - first_thread_[rank];
    statistics.idle_seconds += n_threads * (seconds - statistics.seconds);
    statistics.seconds = 0;
    others += statistics;
  }
  others.idle_seconds += first_thread_[1] * (seconds - own_seconds);
  others.seconds = seconds - own_seconds;
  evaluator->Count(others);
}

namespace {

// What a helper has of the run.
class Helper {
 public:
  // Returns the answer, or an empty text if rank 0 wants none.
  std::string Do(const std::string& bytes) {
    ByteReader order(bytes);
    ByteWriter answer;
    answer.Put(Answer::kDone);
    switch (order.Get<Order>()) {
      case Order::kRun:
        Begin(&order, &answer);
        break;
      case Order::kFactor:
        TakeFactor(&order);
        return {};
      case Order::kPrior:
        TakePrior(&order);
        return {};
      case Order::kBatch:
        Evaluate(&order, &answer);
        break;
    }
    return answer.Take();
  }

 private:
  void Begin(ByteReader* order, ByteWriter* answer) {
    const ScratchDirectory scratch;
    WriteTree(scratch.path(), GetFiles(order));
    ResolvedRun run = ResolveConfig(ReadConfigFile((scratch.path() / "config.toml").string()));
    UsePrior(run.config, &run.task);
    task_ = std::move(run.task);
    options_ = run.config.learner.rollout;
    const int threads = run.config.learner.threads;
    options_.threads = threads == 0 ? omp_get_num_procs() : threads;
    policy_ = MakePolicy(task_, run.config.learner.policy);
    const Platform platform = CurrentPlatform();
    answer->PutAll(platform.simd_target);
    answer->PutAll(platform.blas_core);
    answer->Put(options_.threads);
  }

  void TakeFactor(ByteReader* order) {
    const auto e = order->Get<std::size_t>();
    factors_.resize(order->Get<std::size_t>());
    if (order->Get<bool>()) {
      factors_.at(e) = GetFactor<float>(order);
    } else {
      factors_.at(e) = GetFactor<double>(order);
    }
  }

  // Comes after the factors.
  void TakePrior(ByteReader* order) {
    order->GetAll(&prior_);
    evaluator_.emplace(task_, *policy_, factors_, options_, prior_);
  }

  void Evaluate(ByteReader* order, ByteWriter* answer) {
    std::vector<double> parameters;
    std::vector<StreamKey> keys;
    std::vector<int> n_rollouts, first_rollout;
    order->GetAll(&parameters);
    order->GetAll(&keys);
    order->GetAll(&n_rollouts);
    order->GetAll(&first_rollout);
    const bool relaxed = order->Get<bool>();
    std::vector<double> returns(std::accumulate(n_rollouts.begin(), n_rollouts.end(), 0));
    const EvaluatorStatistics before = evaluator_.value().statistics();
    evaluator_->Evaluate(parameters, keys, n_rollouts, first_rollout, returns, {}, relaxed);
    answer->PutAll(returns);
    answer->Put(evaluator_->statistics().Since(before));
  }

  Task task_;
  EvaluatorOptions options_;
  std::unique_ptr<Policy> policy_;
  std::vector<QueryFactor> factors_;
  std::vector<double> prior_;
  std::optional<Evaluator> evaluator_;
};

}  // namespace

void HelpWithRollouts(MpiWorld* world) {
  Helper helper;
  Pause pause;
  while (!world->ended()) {
    const std::optional<MpiMessage> message = world->Poll();
    if (!message) {
      pause.Wait();
      continue;
    }
    pause = {};
    std::string answer;
    try {
      answer = helper.Do(message->bytes);
    } catch (const std::exception& error) {
      ByteWriter failed;
      failed.Put(Answer::kFailed);
      failed.PutAll(std::string(error.what()));
      answer = failed.Take();
    }
    if (!answer.empty()) world->Send(0, std::move(answer));
  }
}

}  // namespace downpour
