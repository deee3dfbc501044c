// SPDX-License-Identifier: Apache-2.0
#include "tools/python/cmaes.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "engine/search/minimise.h"
#include "tools/python/calls.h"

namespace downpour::python {
namespace {

constexpr char kDoc[] =
    R"(Active CMA-ES with restarts, ask and tell, that MINIMISES (tell negative returns to maximise).

CMAES(x0, sigma0, lower=None, upper=None, restarts="bipop", seed=0, population=0,
      max_evaluations=1000000, target=None, covariance="auto")

x0               (P,) start of the first run; sigma0 > 0 its step size
lower, upper     both or none; scalars or (P,): candidates stay within them by a smooth transformation,
                 x0 must too. Restarts begin at points drawn uniformly between them, or, without
                 bounds, within sigma0 of x0
restarts         "bipop" (Hansen 2009), "ipop", "small" (all of one size) or "single" (none)
seed             candidates depend on it and on what is told alone
population       lambda of the first run; 0: 4 + floor(3 ln P), else >= 2
max_evaluations  the search ends before a population that does not fit
target           a lower value ends the search
covariance       "auto", "full", "diagonal" or "limited-memory": what is adapted; auto: full up to P =
                 200

    opt = downpour.CMAES(x0, 0.5)
    while not opt.stop():
        X = opt.ask()
        opt.tell(X, [f(x) for x in X])
    opt.result.xbest

Not to be used by two threads at once.)";

// What pycma's users know as es.best.
struct Best {
  py::object x;
  double f;
  std::int64_t evaluations;
};

class CmaEsSearch {
 public:
  explicit CmaEsSearch(MinimiseOptions options) : search_(std::move(options)) {}

  py::array_t<double> Ask() {
    RequireRunning("ask");
    return FromRows(search_.Ask(), search_.dimension());
  }

  void Tell(py::handle candidates, py::handle costs) {
    RequireRunning("tell");
    const std::span<const double> asked = search_.Ask();
    const Doubles x =
        ToArray(candidates, "X", {{"lambda", search_.population()}, {"P", search_.dimension()}});
    const std::span<const double> told = Span(x);
    if (!std::equal(told.begin(), told.end(), asked.begin())) {
      throw py::value_error("X: not what ask() gave, must be");
    }
    const Doubles f = ToArray(costs, "f", {{"lambda", search_.population()}}, /*finite=*/false);
    search_.Tell(Span(f));
  }

  py::dict Stop() const {
    py::dict reasons;
    if (!search_.stop().empty()) {
      reasons[py::str(std::string(search_.stop()))] = search_.result().evaluations;
    }
    return reasons;
  }

  py::object BestX() const {
    if (search_.result().best.empty()) return py::none();
    return FromVector(search_.result().best);
  }

  // As pycma names them.
  py::object Result() const {
    const py::object type = py::module_::import("downpour._process").attr("CMAESResult");
    return type(BestX(), search_.result().best_cost, search_.result().evaluations,
                search_.generations(), FromVector(search_.mean()), search_.sigma(), search_.run(),
                Stop());
  }

  py::list Runs() const {
    static const char* const kRegimes[] = {"first", "large", "small"};
    py::list runs;
    for (const MinimiseRun& run : search_.result().runs) {
      py::dict row;
      row["regime"] = kRegimes[static_cast<int>(run.plan.regime)];
      row["population"] = run.plan.population;
      row["sigma0"] = run.plan.sigma;
      row["evaluations"] = run.evaluations;
      row["fbest"] = run.best_cost;
      row["stop"] = run.stop;
      runs.append(row);
    }
    return runs;
  }

  const Minimiser& search() const { return search_; }

 private:
  void RequireRunning(const char* call) const {
    if (search_.stop().empty()) return;
    throw std::runtime_error(std::string("CMAES.") + call + ": the search has stopped (" +
                             std::string(search_.stop()) + ")");
  }

  Minimiser search_;
};

// A bound from a scalar or (P,).
std::vector<double> ToBound(py::handle value, const char* name, std::size_t dimension) {
  const py::array array = py::array::ensure(value);
  if (array && array.ndim() == 0) return std::vector<double>(dimension, ToNumber(value, name));
  return ToVector(value, name, {"P", static_cast<py::ssize_t>(dimension)});
}

void SetBounds(py::handle lower, py::handle upper, MinimiseOptions* options) {
  const std::vector<double>& x0 = options->start;
  if (lower.is_none() != upper.is_none()) {
    throw py::type_error("lower, upper: must both be given, or none");
  }
  options->bounded = !lower.is_none();
  for (const double x : x0) {
    options->lower.push_back(x - options->sigma);
    options->upper.push_back(x + options->sigma);
  }
  if (!options->bounded) return;
  options->lower = ToBound(lower, "lower", x0.size());
  options->upper = ToBound(upper, "upper", x0.size());
  for (std::size_t i = 0; i < x0.size(); ++i) {
    std::string at = std::to_string(i);
    at = '[' + at + ']';
    if (!(options->lower[i] < options->upper[i])) {
      throw py::value_error("lower" + at + ": must be below upper" + at);
    }
    if (x0[i] < options->lower[i] || x0[i] > options->upper[i]) {
      throw py::value_error("x0" + at + ": must be between lower" + at + " and upper" + at);
    }
  }
}

std::unique_ptr<CmaEsSearch> Make(py::handle x0, py::handle sigma0, py::handle lower,
                                  py::handle upper, py::handle restarts, py::handle seed,
                                  py::handle population, py::handle max_evaluations,
                                  py::handle target, py::handle covariance) {
  MinimiseOptions options;
  options.start = ToVector(x0, "x0", {"P"});
  if (options.start.empty()) throw py::value_error("x0: empty, must have P >= 1");
  options.sigma = ToNumber(sigma0, "sigma0");
  if (!(options.sigma > 0)) throw py::value_error("sigma0: must be > 0");
  SetBounds(lower, upper, &options);
  options.restarts = static_cast<RestartStrategy>(
      ToChoice(restarts, "restarts", {"bipop", "small", "ipop", "single"}));
  options.covariance = static_cast<CovarianceForm>(
      ToChoice(covariance, "covariance", {"auto", "full", "diagonal", "limited-memory"}));
  options.seed = ToSeed(seed);
  options.population = static_cast<int>(ToInteger(population, "population", 0, 1 << 20));
  if (options.population == 1) throw py::value_error("population = 1: must be 0 or at least 2");
  options.evaluations =
      ToInteger(max_evaluations, "max_evaluations", 1, std::numeric_limits<std::int64_t>::max());
  if (!target.is_none()) options.target = ToNumber(target, "target");
  return std::make_unique<CmaEsSearch>(std::move(options));
}

}  // namespace

void AddCmaEs(py::module_* module) {
  using py::arg;
  const py::none none;
  py::class_<Best>(*module, "Best", "The best candidate so far.")
      .def_readonly("x", &Best::x, "(P,), None before the first tell.")
      .def_readonly("f", &Best::f, "Its cost, inf before the first tell.")
      .def(
          "get", [](const Best& best) { return py::make_tuple(best.x, best.f, best.evaluations); },
          "(x, f, evaluations so far)");
  py::class_<CmaEsSearch> type(*module, "CMAES", kDoc);
  type.def(py::init(&Make), arg("x0"), arg("sigma0"), arg("lower") = none, arg("upper") = none,
           arg("restarts") = "bipop", arg("seed") = 0, arg("population") = 0,
           arg("max_evaluations") = 1000000, arg("target") = none, arg("covariance") = "auto")
      .def("ask", &CmaEsSearch::Ask,
           "ask() -> X (lambda, P)\n\nA new population; the same until it is told.")
      .def("tell", &CmaEsSearch::Tell, arg("X"), arg("f"),
           "tell(X, f)\n\nThe costs f (lambda,) of X, which ask() gave; NaN counts as the worst.")
      .def("stop", &CmaEsSearch::Stop,
           "stop() -> dict\n\nEmpty while the search should go on, else {criterion: evaluations}: "
           "'target', 'budget' or, with restarts=\"single\", what ended the run.")
      .def_property_readonly(
          "best",
          [](const CmaEsSearch& search) {
            return Best{search.BestX(), search.search().result().best_cost,
                        search.search().result().evaluations};
          },
          "The best candidate so far: best.x (P,), best.f.")
      .def_property_readonly("result", &CmaEsSearch::Result,
                             "Named tuple xbest, fbest, evaluations, iterations, xfavorite (mean "
                             "of the present run), sigma, restarts, stop.")
      .def_property_readonly("runs", &CmaEsSearch::Runs,
                             "A dict for each run that has ended: regime, population, sigma0, "
                             "evaluations, fbest, stop.")
      .def_property_readonly(
          "population", [](const CmaEsSearch& search) { return search.search().population(); },
          "lambda of the present run.")
      .def_property_readonly(
          "dimension", [](const CmaEsSearch& search) { return search.search().dimension(); }, "P");
  RefuseOtherConstruction(&type, kDoc);
  RefuseOtherCalls(&type, "ask", "ask()");
  RefuseOtherCalls(&type, "tell", "tell(X, f)");
  RefuseOtherCalls(&type, "stop", "stop()");
}

}  // namespace downpour::python
