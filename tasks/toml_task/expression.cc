// SPDX-License-Identifier: Apache-2.0
#include "tasks/toml_task/expression.h"

#include <muParser.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <numbers>

#include "engine/errors.h"
#include "engine/learner/suggest.h"

namespace downpour {
namespace {

constexpr const char* kNameCharacters =
    "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789_.";

double Negative(double x) { return -x; }
double Positive(double x) { return x; }
double Not(double x) { return x == 0 ? 1 : 0; }
double Sign(double x) { return x > 0 ? 1 : x < 0 ? -1 : 0; }
double Minimum(double x, double y) { return y < x ? y : x; }
double Maximum(double x, double y) { return y > x ? y : x; }
// The angle (rad) between -pi and pi.
double Wrap(double x) { return std::remainder(x, 2 * std::numbers::pi); }

template <double (*function)(double)>
void ForTile(double* x) {
  for (int lane = 0; lane < kTileLanes; ++lane) x[lane] = function(x[lane]);
}
template <double (*function)(double, double)>
void ForTile(double* x, const double* y) {
  for (int lane = 0; lane < kTileLanes; ++lane) x[lane] = function(x[lane], y[lane]);
}

struct Unary {
  const char* name;
  double (*scalar)(double);
  void (*tile)(double*);
};
constexpr Unary kPrefixes[] = {{"-", Negative, ForTile<Negative>},
                               {"+", Positive, ForTile<Positive>},
                               {"!", Not, ForTile<Not>}};
constexpr Unary kUnary[] = {
    {"sin", ::sin, ForTile<::sin>},    {"cos", ::cos, ForTile<::cos>},
    {"tan", ::tan, ForTile<::tan>},    {"asin", ::asin, ForTile<::asin>},
    {"acos", ::acos, ForTile<::acos>}, {"atan", ::atan, ForTile<::atan>},
    {"sinh", ::sinh, ForTile<::sinh>}, {"cosh", ::cosh, ForTile<::cosh>},
    {"tanh", ::tanh, ForTile<::tanh>}, {"exp", ::exp, ForTile<::exp>},
    {"log", ::log, ForTile<::log>},    {"sqrt", ::sqrt, ForTile<::sqrt>},
    {"abs", ::fabs, ForTile<::fabs>},  {"sign", Sign, ForTile<Sign>},
    {"wrap", Wrap, ForTile<Wrap>},
};
struct Binary {
  const char* name;
  double (*scalar)(double, double);
  void (*tile)(double*, const double*);
};
constexpr Binary kBinary[] = {{"atan2", ::atan2, ForTile<::atan2>},
                              {"hypot", ::hypot, ForTile<::hypot>},
                              {"min", Minimum, ForTile<Minimum>},
                              {"max", Maximum, ForTile<Maximum>}};

// The entry of a table whose function the byte code calls; null if none.
template <typename Entry, std::size_t n>
const Entry* Called(const Entry (&table)[n], const mu::SToken& token) {
  for (const Entry& entry : table) {
    if (token.Fun.cb._pRawFun == reinterpret_cast<mu::erased_fun_type>(entry.scalar)) return &entry;
  }
  return nullptr;
}

// muParser without an expression: names, functions and operators. The optimiser stays off: what is
// computed is what is written.
mu::Parser MakeParser(const std::vector<std::string>& names, std::vector<double>* values) {
  mu::Parser parser;
  parser.ClearFun();
  parser.ClearConst();
  parser.ClearInfixOprt();
  parser.EnableOptimizer(false);
  parser.DefineNameChars(kNameCharacters);
  for (const Unary& f : kPrefixes) parser.DefineInfixOprt(f.name, f.scalar);
  for (const Unary& f : kUnary) parser.DefineFun(f.name, f.scalar);
  for (const Binary& f : kBinary) parser.DefineFun(f.name, f.scalar);
  parser.DefineConst("pi", std::numbers::pi);
  values->assign(names.size() + 1, 1.0);
  for (std::size_t i = 0; i < names.size(); ++i) parser.DefineVar(names[i], values->data() + i);
  return parser;
}

std::string Reason(const mu::ParserError& error, const std::vector<std::string>& names) {
  std::string reason = error.GetMsg();
  while (!reason.empty() && reason.back() == '.') reason.pop_back();
  if (error.GetCode() != mu::ecUNASSIGNABLE_TOKEN) return reason;
  std::vector<std::string> allowed = names;
  for (const std::string& name : TileExpression::FunctionNames()) allowed.push_back(name);
  allowed.push_back("pi");
  const std::string& token = error.GetToken();
  const std::string name = token.substr(0, token.find_first_not_of(kNameCharacters));
  return "unknown name " + (name.empty() ? token : name) + "; " + Suggest(name, allowed);
}

}  // namespace

bool IsFormulaName(const std::string& name) {
  const auto is_letter = [](char c) {
    return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || c == '_';
  };
  const std::vector<std::string> taken = TileExpression::FunctionNames();
  return !name.empty() && is_letter(name.front()) && name != "pi" &&
         std::all_of(name.begin(), name.end(),
                     [&](char c) { return is_letter(c) || (c >= '0' && c <= '9'); }) &&
         std::find(taken.begin(), taken.end(), name) == taken.end();
}

std::vector<std::string> TileExpression::FunctionNames() {
  std::vector<std::string> names;
  for (const Unary& f : kUnary) names.push_back(f.name);
  for (const Binary& f : kBinary) names.push_back(f.name);
  return names;
}

TileExpression::TileExpression(const std::string& text, const std::vector<std::string>& names)
    : text_(text) {
  try {
    Compile(names);
  } catch (const mu::ParserError& error) {
    throw InvalidInput(Reason(error, names));
  }
}

int TileExpression::StackChange(Op op) {
  switch (op) {
    case Op::kRow:
    case Op::kConstant:
      return 1;
    case Op::kSquare:
    case Op::kUnary:
      return 0;
    case Op::kSelect:
      return -2;
    default:
      return -1;
  }
}

void TileExpression::Compile(const std::vector<std::string>& names) {
  static const std::map<mu::ECmdCode, Op> kOperators = {
      {mu::cmLT, Op::kLess},    {mu::cmLE, Op::kLessEqual},    {mu::cmGT, Op::kGreater},
      {mu::cmEQ, Op::kEqual},   {mu::cmGE, Op::kGreaterEqual}, {mu::cmNEQ, Op::kNotEqual},
      {mu::cmADD, Op::kAdd},    {mu::cmSUB, Op::kSubtract},    {mu::cmMUL, Op::kMultiply},
      {mu::cmDIV, Op::kDivide}, {mu::cmPOW, Op::kPower},       {mu::cmLAND, Op::kAnd},
      {mu::cmLOR, Op::kOr},     {mu::cmENDIF, Op::kSelect}};
  std::vector<double> values;
  mu::Parser parser = MakeParser(names, &values);
  parser.SetExpr(text_);
  parser.Eval();  // compiles
  std::vector<int> row_of(names.size(), -1);
  int depth = 0, deepest = 0;
  for (const mu::SToken* token = parser.GetByteCode().GetBase(); token->Cmd != mu::cmEND; ++token) {
    Instruction instruction{Op::kConstant};
    if (token->Cmd == mu::cmIF || token->Cmd == mu::cmELSE) continue;  // kSelect does it all
    if (token->Cmd == mu::cmVAR) {
      const std::size_t name = token->Val.ptr - values.data();
      if (row_of[name] < 0) {
        row_of[name] = static_cast<int>(used_.size());
        used_.push_back(names[name]);
      }
      instruction = {Op::kRow, row_of[name]};
    } else if (token->Cmd == mu::cmVAL) {
      instruction.value = token->Val.data2;
    } else if (token->Cmd == mu::cmFUNC) {
      const Unary* unary = Called(kUnary, *token);
      if (unary == nullptr) unary = Called(kPrefixes, *token);
      const Binary* const binary = Called(kBinary, *token);
      instruction.op = unary != nullptr ? Op::kUnary : Op::kBinary;
      if (unary != nullptr) instruction.unary = unary->tile;
      if (binary != nullptr) instruction.binary = binary->tile;
      if (unary == nullptr && binary == nullptr) throw InvalidInput("a function of no known kind");
    } else if (const auto found = kOperators.find(token->Cmd); found != kOperators.end()) {
      instruction.op = found->second;
    } else {
      throw InvalidInput("an operator that changes something, or a text: must be a number");
    }
    const bool square = instruction.op == Op::kPower && program_.back().op == Op::kConstant &&
                        program_.back().value == 2;
    if (square) {
      program_.back() = {Op::kSquare};
      --depth;
    } else {
      program_.push_back(instruction);
      depth += StackChange(instruction.op);
    }
    deepest = std::max(deepest, depth);
    if (depth < 1) throw InvalidInput("an operator lacks its numbers");
  }
  if (depth != 1) throw InvalidInput("a list: must be one number");
  if (deepest > kMaxDepth) {
    throw InvalidInput("nested too deeply: must need at most " + std::to_string(kMaxDepth) +
                       " numbers at once");
  }
}

void TileExpression::Run(const Instruction& instruction, const double* const* rows,
                         double (*stack)[kTileLanes], int top) {
  double* const x = stack[top];  // where the result goes
  const double* const y = stack[top + 1];
  const auto each = [x](const auto& function) {
    for (int lane = 0; lane < kTileLanes; ++lane) x[lane] = function(lane);
  };
  switch (instruction.op) {
    case Op::kRow:
      return each([row = rows[instruction.row]](int i) { return row[i]; });
    case Op::kConstant:
      return each([value = instruction.value](int) { return value; });
    case Op::kLess:
      return each([=](int i) { return x[i] < y[i] ? 1.0 : 0.0; });
    case Op::kLessEqual:
      return each([=](int i) { return x[i] <= y[i] ? 1.0 : 0.0; });
    case Op::kGreater:
      return each([=](int i) { return x[i] > y[i] ? 1.0 : 0.0; });
    case Op::kGreaterEqual:
      return each([=](int i) { return x[i] >= y[i] ? 1.0 : 0.0; });
    case Op::kEqual:
      return each([=](int i) { return x[i] == y[i] ? 1.0 : 0.0; });
    case Op::kNotEqual:
      return each([=](int i) { return x[i] != y[i] ? 1.0 : 0.0; });
    case Op::kAdd:
      return each([=](int i) { return x[i] + y[i]; });
    case Op::kSubtract:
      return each([=](int i) { return x[i] - y[i]; });
    case Op::kMultiply:
      return each([=](int i) { return x[i] * y[i]; });
    case Op::kDivide:
      return each([=](int i) { return x[i] / y[i]; });
    case Op::kPower:
      return each([=](int i) { return std::pow(x[i], y[i]); });
    case Op::kSquare:
      return each([=](int i) { return x[i] * x[i]; });
    case Op::kAnd:
      return each([=](int i) { return x[i] != 0 && y[i] != 0 ? 1.0 : 0.0; });
    case Op::kOr:
      return each([=](int i) { return x[i] != 0 || y[i] != 0 ? 1.0 : 0.0; });
    case Op::kSelect:
      return each([=, z = stack[top + 2]](int i) { return x[i] != 0 ? y[i] : z[i]; });
    case Op::kUnary:
      return instruction.unary(x);
    case Op::kBinary:
      return instruction.binary(x, y);
  }
}

void TileExpression::Evaluate(const double* const* rows, double* result) const {
  alignas(kAlignment) double stack[kMaxDepth][kTileLanes];
  int top = -1;
  for (const Instruction& instruction : program_) {
    top += StackChange(instruction.op);
    Run(instruction, rows, stack, top);
  }
  std::copy_n(stack[0], kTileLanes, result);
}

}  // namespace downpour
