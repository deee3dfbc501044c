// SPDX-License-Identifier: Apache-2.0
#include "engine/learner/c_header.h"

#include <span>
#include <vector>

#include "engine/learner/text_format.h"
#include "engine/rollout/one_lane.h"
#include "kernels/gp_policy/gp_policy.h"
#include "kernels/squash/squash.h"

namespace downpour {
namespace {

// A double literal.
std::string Literal(double value) {
  const std::string text = FormatNumber(value);
  return text.find_first_of(".e") == std::string::npos ? text + ".0" : text;
}

std::string Index(std::size_t size) { return std::string("[").append(std::to_string(size)) + "]"; }

// "  static const double name[rows][columns] = {{...}, ...};", one row a line.
std::string Matrix(const std::string& name, std::span<const double> values, std::size_t columns) {
  const std::size_t rows = values.size() / columns;
  std::string text = "  static const double " + name + Index(rows) + Index(columns) + " = {\n";
  for (std::size_t r = 0; r < rows; ++r) {
    text += "    {";
    for (std::size_t c = 0; c < columns; ++c) {
      text += (c == 0 ? "" : ", ") + Literal(values[r * columns + c]);
    }
    text += r + 1 < rows ? "},\n" : "}};\n";
  }
  return text;
}

std::string Vector(const std::string& name, std::span<const double> values) {
  std::string text = "  static const double " + name + Index(values.size()) + " = {";
  for (std::size_t i = 0; i < values.size(); ++i) {
    text += (i == 0 ? "" : ", ") + Literal(values[i]);
  }
  return text + "};\n";
}

// Names as a comment may hold them.
std::string Names(const std::vector<Variable>& variables) {
  std::string text;
  for (const Variable& variable : variables) {
    text += text.empty() ? "" : ", ";
    for (const char c : variable.name) {
      const bool plain = (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') ||
                         (c >= '0' && c <= '9') || c == '_' || c == ' ' || c == '-';
      text += plain ? c : '_';
    }
  }
  return text;
}

// x: the features of the state, times 1 / input_scale.
std::string Features(const Task& task) {
  std::string text;
  for (int f = 0; f < task.n_features(); ++f) {
    const Feature& feature = task.features[f];
    const std::string state = "state" + Index(feature.state_index);
    const std::string value = feature.kind == FeatureKind::kCosine ? "cos(" + state + ")"
                              : feature.kind == FeatureKind::kSine ? "sin(" + state + ")"
                                                                   : state;
    text +=
        "  x" + Index(f) + " = " + Literal(1 / task.policy_input_scale[f]) + " * " + value + ";\n";
  }
  return text;
}

// "  for (name = 0; name < n; ++name) "
std::string Loop(const char* name, std::size_t n) {
  const std::string i = name;
  return "for (" + i + " = 0; " + i + " < " + std::to_string(n) + "; ++" + i + ") ";
}

// y_l of every layer, then the action.
std::string Network(const SavedPolicy& saved, const Task& task) {
  std::vector<int> units = saved.hidden_units;
  units.insert(units.begin(), task.n_features());
  units.push_back(task.n_actions());
  std::string tables, layers, before = "x";
  std::span<const double> rest = saved.parameters;
  for (std::size_t l = 1; l < units.size(); ++l) {
    const auto n = static_cast<std::size_t>(units[l]), m = static_cast<std::size_t>(units[l - 1]);
    const std::string number = std::to_string(l), y = "y" + number;
    tables += Matrix("w" + number, rest.first(n * m), m);
    tables += Vector("b" + number, rest.subspan(n * m, n));
    tables += "  double " + y + Index(n) + ";\n";
    rest = rest.subspan(n * (m + 1));
    const bool relu = saved.activation == Activation::kRelu && l + 1 < units.size();
    layers += "  " + Loop("i", n) + "{\n    double sum = b" + number + "[i];\n    " + Loop("j", m) +
              "sum += w" + number + "[i][j] * " + before + "[j];\n    " + y +
              (relu ? "[i] = sum > 0.0 ? sum : 0.0;\n  }\n" : "[i] = tanh(sum);\n  }\n");
    before = y;
  }
  return tables + "  int i, j;\n" + Features(task) + layers + "  " +
         Loop("i", task.actions.size()) + "action[i] = limit[i] * " + before + "[i];\n";
}

std::string Linear(const SavedPolicy& saved, const Task& task) {
  const std::size_t m = task.features.size(), n = task.actions.size();
  const std::span<const double> parameters = saved.parameters;
  return Matrix("w", parameters.first(n * m), m) + Vector("b", parameters.subspan(n * m, n)) +
         "  int i, j;\n" + Features(task) + "  " + Loop("i", n) +
         "{\n    double sum = b[i];\n    " + Loop("j", m) +
         "sum += w[i][j] * x[j];\n    action[i] = limit[i] * downpour_squash(sum);\n  }\n";
}

// The prepared numbers of the policy's tile kernel (kernels/gp_policy).
std::string Gp(const SavedPolicy& saved, const Task& task) {
  const GpPolicyShape shape{task.n_features(), saved.points, task.n_actions()};
  const AlignedVector<double> parameters = ToOneLane(saved.parameters);
  AlignedVector<double> scratch(static_cast<std::size_t>(shape.scratch_rows()) * kTileLanes);
  GpPolicyPrepareTile(shape, 1, parameters.data(), scratch.data());
  const std::size_t m = task.features.size(), n = static_cast<std::size_t>(saved.points);
  std::string tables, outputs;
  for (int o = 0; o < shape.n_outputs; ++o) {
    std::vector<double> prepared(static_cast<std::size_t>(shape.prepared_rows()));
    for (std::size_t i = 0; i < prepared.size(); ++i) {
      prepared[i] = scratch[(o * prepared.size() + i) * kTileLanes];
    }
    const std::span<const double> all = prepared;
    const std::string number = std::to_string(o);
    tables += Vector("c" + number, all.first(m)) + Matrix("z" + number, all.subspan(m, n * m), m) +
              Vector("alpha" + number, all.subspan(m + n * m, n));
    outputs += "  mean = 0.0;\n  " + Loop("i", n) + "{\n    double s = 0.0;\n    " + Loop("j", m) +
               "{\n      const double d = c" + number + "[j] * x[j] - z" + number +
               "[i][j];\n      s += d * d;\n    }\n    mean += alpha" + number +
               "[i] * exp2(-s);\n  }\n  action[" + number + "] = limit[" + number +
               "] * downpour_squash(mean);\n";
  }
  return tables + "  double mean;\n  int i, j;\n" + Features(task) + outputs;
}

// The actions themselves: they depend on the step alone.
std::string Primitives(const SavedPolicy& saved, const Task& task, const Policy& policy) {
  const std::size_t n = task.actions.size();
  std::vector<double> actions(static_cast<std::size_t>(task.horizon) * n);
  const std::vector<double> features(task.features.size());
  for (int t = 0; t < task.horizon; ++t) {
    policy.Act(t, saved.parameters, features, std::span(actions).subspan(t * n, n));
  }
  const std::string last = std::to_string(task.horizon - 1);
  return Matrix("actions", actions, n) + "  const int row = step < 0 ? 0 : step > " + last + " ? " +
         last + " : step;\n  int i;\n  (void)state;\n  " + Loop("i", n) +
         "action[i] = actions[row][i];\n";
}

std::string Body(const SavedPolicy& saved, const Task& task, const Policy& policy) {
  if (saved.kind == "dmp") return Primitives(saved, task, policy);
  const std::string common =
      Vector("limit", task.action_limits) + "  double x" + Index(task.features.size()) + ";\n";
  if (saved.kind == "linear") return common + Linear(saved, task);
  if (saved.kind == "gp") return common + Gp(saved, task);
  return common + Network(saved, task);
}

}  // namespace

std::string CHeader(const SavedPolicy& saved, const Task& task) {
  const std::unique_ptr<Policy> policy = MakePolicy(saved, task);
  const std::string limit = Literal(kSquashLimit);
  const bool dmp = saved.kind == "dmp", squashes = saved.kind == "linear" || saved.kind == "gp";
  return "/* A control policy written by Downpour: task " + Names({{saved.task, ""}}) +
         ", episode " + std::to_string(saved.episode) + ", kind " + saved.kind +
         ".\n   state: " + Names(task.states) + "; action: " + Names(task.actions) +
         ".\n   To be called every " + FormatNumber(task.control_period) + " s" +
         (dmp ? "; steps count from 0, and after the last its action stays" : "") +
         ". */\n#ifndef DOWNPOUR_POLICY_H_\n#define DOWNPOUR_POLICY_H_\n\n#include <math.h>\n\n" +
         (squashes ? "static inline double downpour_squash(double a) {\n  const double s = "
                     "sin(fmin(fmax(a, -" +
                         limit + "), " + limit + "));\n  return 0.5 * s * (3.0 - s * s);\n}\n\n"
                   : "") +
         "static inline void downpour_policy(const double state" + Index(task.states.size()) +
         (dmp ? ", int step" : "") + ", double action" + Index(task.actions.size()) + ") {\n" +
         Body(saved, task, *policy) + "}\n\n#endif\n";
}

}  // namespace downpour
