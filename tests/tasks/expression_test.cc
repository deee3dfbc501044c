// SPDX-License-Identifier: Apache-2.0
#include "tasks/toml_task/expression.h"

#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <numbers>
#include <string>
#include <vector>

#include "engine/errors.h"
#include "kernels/philox/philox.h"

namespace downpour {
namespace {

constexpr double kPi = std::numbers::pi;
const std::vector<std::string> kNames = {"x", "y", "tip.z"};

// The formula of a tile of x, y and tip.z, kTileLanes each.
std::vector<double> Evaluate(const std::string& text, const AlignedVector<double>& tile) {
  const TileExpression expression(text, kNames);
  std::vector<const double*> rows;
  for (const std::string& name : expression.used()) {
    const auto row = std::find(kNames.begin(), kNames.end(), name) - kNames.begin();
    rows.push_back(tile.data() + row * kTileLanes);
  }
  AlignedVector<double> result(kTileLanes);
  expression.Evaluate(rows.data(), result.data());
  return {result.begin(), result.end()};
}

AlignedVector<double> RandomTile() {
  AlignedVector<double> tile(3 * kTileLanes);
  FillUniforms(StreamKey{1, 9}, 0, tile.data(), tile.size());
  for (double& value : tile) value = 4 * value - 2;
  tile[7] = tile[kTileLanes + 7];  // x == y somewhere
  return tile;
}

std::string Refusal(const std::string& text) {
  try {
    const TileExpression expression(text, kNames);
  } catch (const InvalidInput& error) {
    return error.what();
  }
  return "";
}

TEST_CASE("expression: every operator and function is that of double, lane for lane") {
  using F = std::function<double(double, double, double)>;
  const std::vector<std::pair<std::string, F>> cases = {
      {"x", [](double x, double, double) { return x; }},
      {"3", [](double, double, double) { return 3; }},
      {"2*pi", [](double, double, double) { return 2 * kPi; }},
      {"x + y*tip.z", [](double x, double y, double z) { return x + y * z; }},
      {"(x - y)/tip.z", [](double x, double y, double z) { return (x - y) / z; }},
      {"x - y - tip.z", [](double x, double y, double z) { return x - y - z; }},
      {"-x^2", [](double x, double, double) { return -(x * x); }},
      {"(x + y)^2", [](double x, double y, double) { return (x + y) * (x + y); }},
      {"x^3", [](double x, double, double) { return std::pow(x, 3); }},
      {"2^x", [](double x, double, double) { return std::pow(2, x); }},
      {"+x - -y", [](double x, double y, double) { return x + y; }},
      {"x < y", [](double x, double y, double) { return x < y; }},
      {"x <= y", [](double x, double y, double) { return x <= y; }},
      {"x > y", [](double x, double y, double) { return x > y; }},
      {"x >= y", [](double x, double y, double) { return x >= y; }},
      {"x == y", [](double x, double y, double) { return x == y; }},
      {"x != y", [](double x, double y, double) { return x != y; }},
      {"x > 0 && y > 0", [](double x, double y, double) { return x > 0 && y > 0; }},
      {"x > 0 || y > 0", [](double x, double y, double) { return x > 0 || y > 0; }},
      {"!(x > 0)", [](double x, double, double) { return !(x > 0); }},
      {"x > 0 ? y : tip.z", [](double x, double y, double z) { return x > 0 ? y : z; }},
      {"x > 0 ? (y > 0 ? 1 : 2) : (y > 0 ? 3 : 4)",
       [](double x, double y, double) { return x > 0 ? (y > 0 ? 1 : 2) : (y > 0 ? 3 : 4); }},
      {"1 + (x > 0 ? y : 2) * 3",
       [](double x, double y, double) { return 1 + (x > 0 ? y : 2) * 3; }},
      {"sin(x)", [](double x, double, double) { return std::sin(x); }},
      {"cos(x)", [](double x, double, double) { return std::cos(x); }},
      {"tan(x)", [](double x, double, double) { return std::tan(x); }},
      {"asin(x/2)", [](double x, double, double) { return std::asin(x / 2); }},
      {"acos(x/2)", [](double x, double, double) { return std::acos(x / 2); }},
      {"atan(x)", [](double x, double, double) { return std::atan(x); }},
      {"sinh(x)", [](double x, double, double) { return std::sinh(x); }},
      {"cosh(x)", [](double x, double, double) { return std::cosh(x); }},
      {"tanh(x)", [](double x, double, double) { return std::tanh(x); }},
      {"exp(-x*x)", [](double x, double, double) { return std::exp(-x * x); }},
      {"log(abs(x))", [](double x, double, double) { return std::log(std::abs(x)); }},
      {"sqrt(x^2 + y^2)", [](double x, double y, double) { return std::sqrt(x * x + y * y); }},
      {"sign(x)", [](double x, double, double) { return x > 0 ? 1 : -1; }},
      {"wrap(5*x)", [](double x, double, double) { return std::remainder(5 * x, 2 * kPi); }},
      {"atan2(x, y)", [](double x, double y, double) { return std::atan2(x, y); }},
      {"hypot(x, y)", [](double x, double y, double) { return std::hypot(x, y); }},
      {"min(x, y)", [](double x, double y, double) { return std::min(x, y); }},
      {"max(x, max(y, 0))",
       [](double x, double y, double) {
         return std::max({x, y, 0.0});
       }},
  };
  const AlignedVector<double> tile = RandomTile();
  for (const auto& item : cases) {
    CAPTURE(item.first);
    const std::vector<double> found = Evaluate(item.first, tile);
    for (int i = 0; i < kTileLanes; ++i) {
      const double* const x = tile.data() + i;
      const double expected = item.second(x[0], x[kTileLanes], x[2 * kTileLanes]);
      // The compiler of this test may contract a product and a sum: one rounding.
      CHECK(found[i] == doctest::Approx(expected).epsilon(1e-15));
    }
  }
}

TEST_CASE("expression: a branch that is not taken may be no number") {
  const AlignedVector<double> tile = RandomTile();
  for (const double value : Evaluate("x > 5 ? log(-1) : 2", tile)) CHECK(value == 2);
}

TEST_CASE("expression: what is wrong is said, with the closest name") {
  CHECK(Refusal("") != "");
  CHECK(Refusal("x +").find("Unexpected end") != std::string::npos);
  CHECK(Refusal("tipp.z").find("unknown name tipp.z; did you mean tip.z?") != std::string::npos);
  CHECK(Refusal("sqr(x)").find("did you mean sqrt?") != std::string::npos);
  CHECK(Refusal("q").find("allowed: x, y, tip.z, sin") != std::string::npos);
  CHECK(Refusal("x = 3") != "");
  CHECK(Refusal("x, y") != "");
  CHECK(Refusal("\"text\"") != "");
  CHECK(Refusal("(x") != "");
  CHECK(Refusal("x)") != "");
  CHECK(Refusal("sin(x, y)") != "");
  CHECK(Refusal("min(x)") != "");
  CHECK(Refusal("x ? y") != "");
  CHECK(Refusal("rnd()") != "");
  CHECK(Refusal("2 x") != "");
  std::string deep = "x";
  for (int i = 0; i < 60; ++i) deep = "x + (" + deep + ")";
  CHECK(Refusal(deep).find("nested too deeply") != std::string::npos);
}

TEST_CASE("expression: names that formulas can hold") {
  for (const std::string name : {"x", "_1", "cos_angle", "X2"}) CHECK(IsFormulaName(name));
  for (const std::string name : {"", "1x", "a b", "a.b", "pi", "sin", "ä"}) {
    CHECK_FALSE(IsFormulaName(name));
  }
}

}  // namespace
}  // namespace downpour
