// SPDX-License-Identifier: Apache-2.0
#include "engine/search/cma_es.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>
#include <numeric>
#include <string>
#include <type_traits>
#include <utility>

#include "engine/errors.h"
#include "engine/search/state_archive.h"

// Equation numbers are those of the tutorial (arXiv 1604.00772).
namespace downpour {
namespace {

constexpr std::uint32_t kMaxPopulation = 1 << 24;
// Every value of stop().
constexpr std::array<std::string_view, 10> kStops = {
    "",           "EqualFunValues", "TolHistFun",   "TolX",
    "TolXUp",     "ConditionCov",   "NoEffectAxis", "NoEffectCoord",
    "Stagnation", "MaxEvaluations"};

}  // namespace

double CmaEs::DefaultPopulation(int dimension) { return 4 + 3 * std::log(dimension); }

CmaEs::CmaEs(std::span<const double> mean, double sigma, int population,
             const CmaEsOptions& options)
    : dimension_(static_cast<int>(mean.size())),
      population_(population),
      tolerances_(options.tolerances),
      form_(ResolveForm(options.covariance, dimension_)),
      parameters_(MakeStrategyParameters(form_, dimension_, population)),
      initial_sigma_(sigma),
      sigma_(sigma),
      mean_(Eigen::Map<const Eigen::VectorXd>(mean.data(), dimension_)),
      path_sigma_(Eigen::VectorXd::Zero(dimension_)),
      path_c_(Eigen::VectorXd::Zero(dimension_)),
      covariance_(MakeCovariance()),
      history_(dimension_, population_),
      z_(dimension_, population_),
      y_(dimension_, population_),
      step_(dimension_),
      step_z_(dimension_),
      costs_(population_),
      ranking_(population_) {
  if (!options.adapt_rates) return;
  std::visit(
      [&]<typename Form>(const Form&) {
        if constexpr (std::is_same_v<Form, LimitedMemory>) {
          throw InvalidInput("CMA-ES: rates adapt with a full or diagonal covariance only");
        } else {
          rates_ = AdaptiveRates{
              AdaptiveRate(dimension_, AdaptiveRate::kMeanDecay),
              AdaptiveRate(Form::ChangeSize(dimension_), AdaptiveRate::kCovarianceDecay)};
        }
      },
      covariance_);
}

CmaEs::Covariance CmaEs::MakeCovariance() const {
  switch (form_) {
    case CovarianceForm::kDiagonal:
      return DiagonalCovariance(parameters_, dimension_, population_);
    case CovarianceForm::kLimitedMemory:
      return LimitedMemory(parameters_, dimension_, population_);
    default:
      return FullCovariance(parameters_, dimension_, population_);
  }
}

template <typename Archive>
void CmaEs::Visit(Archive& archive) {
  archive(initial_sigma_);
  archive(generation_);
  archive(sigma_);
  auto stop = std::find(kStops.begin(), kStops.end(), stop_) - kStops.begin();
  archive(stop);
  stop_ = kStops.at(static_cast<std::size_t>(stop) % kStops.size());
  archive(mean_);
  archive(path_sigma_);
  archive(path_c_);
  std::visit([&](auto& covariance) { covariance.Visit(archive); }, covariance_);
  if (rates_) {
    rates_->mean.Visit(archive);
    rates_->covariance.Visit(archive);
  }
  history_.Visit(archive);
}

std::vector<double> CmaEs::Save() const {
  StateWriter writer;
  int form = static_cast<int>(form_), dimension = dimension_, population = population_;
  bool adapts = rates_.has_value();
  writer(form);
  writer(dimension);
  writer(population);
  writer(adapts);
  CmaEs(*this).Visit(writer);
  return writer.Take();
}

CmaEs CmaEs::Restore(std::span<const double> state, const CmaEsTolerances& tolerances) {
  StateReader reader(state, "CMA-ES: a state");
  std::uint32_t form = 0, dimension = 0, population = 0;
  bool adapts = false;
  reader(form);
  reader(dimension);
  reader(population);
  reader(adapts);
  // The mean alone has P numbers, each generation's costs are lambda evaluations.
  if (form > static_cast<std::uint32_t>(CovarianceForm::kLimitedMemory) || form == 0 ||
      dimension == 0 || dimension > state.size() || population < 2 || population > kMaxPopulation) {
    throw InvalidInput("CMA-ES: a state with form " + std::to_string(form) +
                       ", P = " + std::to_string(dimension) +
                       ", lambda = " + std::to_string(population) + ": must be one that was saved");
  }
  CmaEs cma(std::vector<double>(dimension), 1, static_cast<int>(population),
            {tolerances, static_cast<CovarianceForm>(form), adapts});
  cma.Visit(reader);
  reader.End();
  return cma;
}

void CmaEs::Ask(StreamKey key, std::span<double> candidates) {
  FillNormalColumns(key, 0, static_cast<std::uint32_t>(population_), z_.data(),
                    static_cast<std::size_t>(dimension_));  // Eq. 38
  std::visit([&](const auto& covariance) { covariance.Transform(z_, &y_); },
             covariance_);  // Eq. 39
  Eigen::Map<Eigen::MatrixXd> x(candidates.data(), dimension_, population_);
  x = (sigma_ * y_).colwise() + mean_;  // Eq. 40
}

void CmaEs::Tell(std::span<const double> costs) {
  std::iota(ranking_.begin(), ranking_.end(), 0);
  const auto cost = [&](int c) {
    return std::isnan(costs[c]) ? std::numeric_limits<double>::infinity() : costs[c];
  };
  std::sort(ranking_.begin(), ranking_.end(), [&](int a, int b) {
    const double cost_a = cost(a), cost_b = cost(b);
    return cost_a != cost_b ? cost_a < cost_b : a < b;
  });
  Tell(costs, ranking_);
}

void CmaEs::Tell(std::span<const double> costs, std::span<const int> ranking) {
  ++generation_;
  const StrategyParameters& p = parameters_;
  step_.setZero();
  step_z_.setZero();
  for (int i = 0; i < p.parents; ++i) {
    step_ += p.weights[i] * y_.col(ranking[i]);  // Eq. 41
    step_z_ += p.weights[i] * z_.col(ranking[i]);
  }
  path_sigma_ = (1 - p.c_sigma) * path_sigma_ +
                std::sqrt(p.c_sigma * (2 - p.c_sigma) * p.mu_eff) * step_z_;  // Eq. 43
  // The tutorial's g + 1 is generation_, which counts this generation already.
  const double settled = std::sqrt(1 - std::pow(1 - p.c_sigma, 2.0 * generation_));
  const bool h_sigma =
      path_sigma_.norm() / settled < (1.4 + 2.0 / (dimension_ + 1)) * p.expected_norm;
  if (form_ != CovarianceForm::kLimitedMemory) {
    path_c_ *= 1 - p.c_c;
    if (h_sigma) path_c_ += std::sqrt(p.c_c * (2 - p.c_c) * p.mu_eff) * step_;  // Eq. 45
  }
  const double delta = h_sigma ? 0 : p.c_c * (2 - p.c_c);
  const double decay = 1 + p.c_1 * delta - p.c_1 - p.c_mu * p.weights.sum();
  UpdateDistribution({p, z_, y_, ranking.data(), path_c_, step_z_, decay, generation_});

  std::transform(costs.begin(), costs.end(), costs_.begin(), [](double cost) {
    return std::isnan(cost) ? std::numeric_limits<double>::infinity() : cost;
  });
  history_.Append(costs_);
  stop_ = FindStop();
}

// Mean, step size and covariance.
void CmaEs::UpdateDistribution(const CovarianceUpdate& update) {
  const double old_sigma = sigma_;
  sigma_ *= StepSizeFactor();
  if (!rates_) {
    mean_ += old_sigma * step_;  // Eq. 42
    std::visit([&](auto& covariance) { covariance.Update(update); }, covariance_);
    return;
  }
  const double old_rate = rates_->mean.rate();
  const double rate =
      rates_->mean.Adapt({step_z_.data(), static_cast<std::size_t>(step_z_.size())});
  mean_ += rate * old_sigma * step_;
  std::visit(
      [&]<typename Form>(Form& covariance) {
        if constexpr (!std::is_same_v<Form, LimitedMemory>) {
          covariance.AdaptedUpdate(update, old_sigma, &sigma_, &rates_->covariance);
        }
      },
      covariance_);
  // The best step size is about inverse to the mean's rate.
  sigma_ *= old_rate / rate;
}

double CmaEs::StepSizeFactor() const {
  const StrategyParameters& p = parameters_;
  if (form_ == CovarianceForm::kLimitedMemory) {
    // The step size of LM-MA-ES; the bound is for large populations.
    const double excess = path_sigma_.squaredNorm() / dimension_ - 1;
    return std::exp(std::min(1.0, p.c_sigma / 2 * excess));
  }
  return std::exp(p.c_sigma / p.d_sigma * (path_sigma_.norm() / p.expected_norm - 1));  // Eq. 44
}

std::string_view CmaEs::FindStop() {
  if (history_.HasEqualBest()) return "EqualFunValues";
  if (history_.IsFlat(tolerances_.hist_fun)) return "TolHistFun";
  if (IsBelowTolX()) return "TolX";
  const auto [largest, condition] = std::visit(
      [](const auto& c) { return std::pair(c.LargestStd(), c.condition()); }, covariance_);
  if (sigma_ * largest > tolerances_.x_up * initial_sigma_) return "TolXUp";
  if (!(condition <= tolerances_.condition_cov)) return "ConditionCov";
  if (HasNoEffectAxis()) return "NoEffectAxis";
  if (HasNoEffectCoord()) return "NoEffectCoord";
  if (history_.IsStagnant()) return "Stagnation";
  if (std::int64_t{generation_} * population_ >= tolerances_.max_evaluations) {
    return "MaxEvaluations";
  }
  return {};
}

bool CmaEs::IsBelowTolX() const {
  const double tolerance = tolerances_.x * initial_sigma_;
  return std::visit(
      [&](const auto& covariance) {
        for (int i = 0; i < dimension_; ++i) {
          if (sigma_ * covariance.CoordinateStd(i) >= tolerance) return false;
          if (sigma_ * std::abs(path_c_[i]) >= tolerance) return false;
        }
        return true;
      },
      covariance_);
}

// A tenth of a standard deviation along the principal axis of this generation changes nothing.
bool CmaEs::HasNoEffectAxis() const {
  const int axis = generation_ % dimension_;
  return std::visit(
      [&](const auto& covariance) {
        for (int i = 0; i < dimension_; ++i) {
          if (mean_[i] != mean_[i] + 0.1 * sigma_ * covariance.AxisComponent(axis, i)) return false;
        }
        return true;
      },
      covariance_);
}

// A fifth of a standard deviation in some coordinate changes nothing.
bool CmaEs::HasNoEffectCoord() const {
  return std::visit(
      [&](const auto& covariance) {
        for (int i = 0; i < dimension_; ++i) {
          if (mean_[i] == mean_[i] + 0.2 * sigma_ * covariance.CoordinateStd(i)) return true;
        }
        return false;
      },
      covariance_);
}

}  // namespace downpour
