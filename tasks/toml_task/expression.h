// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>
#include <vector>

#include "kernels/aligned.h"

namespace downpour {

// True if formulas can have the name: letters, digits and _, no digit first, and no function or pi.
bool IsFormulaName(const std::string& name);

// A formula of named numbers, e.g. "exp(-x^2) * (cos_angle > 0)", for a tile of lanes at a time.
// Syntax: that of muParser: + - * / ^, comparisons, && || !, a ? b : c, numbers, pi, and the
// functions of FunctionNames(). Names may hold a dot. Conditions are 1 or 0; both branches of
// a ? b : c are computed. muParser compiles the text; its own bulk mode would parse it at every
// call and open a parallel region in ours, so that the byte code runs here, one instruction for all
// lanes after the other. Immutable: calls are thread-safe.
class TileExpression {
 public:
  // Throws InvalidInput that says what is wrong with the text; an unknown name comes with the
  // closest one of `names`.
  TileExpression(const std::string& text, const std::vector<std::string>& names);

  const std::string& text() const { return text_; }
  // The names, of those given, that the text has.
  const std::vector<std::string>& used() const { return used_; }

  // rows[i] has kTileLanes numbers of used()[i]; result kTileLanes; aligned. Every operation rounds
  // as that of double does; functions are those of the C library. Does not allocate.
  void Evaluate(const double* const* rows, double* result) const;

  static std::vector<std::string> FunctionNames();

 private:
  enum class Op {
    kRow,
    kConstant,
    kLess,
    kLessEqual,
    kGreater,
    kGreaterEqual,
    kEqual,
    kNotEqual,
    kAdd,
    kSubtract,
    kMultiply,
    kDivide,
    kPower,
    kSquare,
    kAnd,
    kOr,
    kSelect,
    kUnary,
    kBinary
  };
  struct Instruction {
    Op op;
    int row = 0;
    double value = 0;
    void (*unary)(double* x) = nullptr;
    void (*binary)(double* x, const double* y) = nullptr;
  };
  // Numbers on the stack that formulas may need; 18 KiB of the thread's own.
  static constexpr int kMaxDepth = 48;

  void Compile(const std::vector<std::string>& names);
  static int StackChange(Op op);
  static void Run(const Instruction& instruction, const double* const* rows,
                  double (*stack)[kTileLanes], int top);

  std::string text_;
  std::vector<std::string> used_;
  std::vector<Instruction> program_;
};

}  // namespace downpour
