// SPDX-License-Identifier: Apache-2.0
// Moments of every stage of PILCO's policy evaluation against 10^7 samples, covariances of every
// rank, and of three steps of the chain: the worst deviation of any mean, covariance and
// cross-covariance in standard errors of the sample. tests/pilco checks the same with fewer.
//   pilco_samples [--samples N]
#include <CLI/CLI.hpp>
#include <cstdint>
#include <cstdio>

#include "bench/program.h"
#include "tests/pilco/chain_case.h"

namespace downpour {
namespace {

int Main(int argc, char** argv) {
  std::int64_t samples = 10'000'000;
  CLI::App app("PILCO's moments against samples");
  app.add_option("--samples", samples)->check(CLI::PositiveNumber);
  CLI11_PARSE(app, argc, argv);
  for (const Stage& stage : AllStages()) {
    for (int rank = 0; rank <= stage.n_inputs; ++rank) {
      std::printf("%-14s rank %d  %.2f\n", stage.name.c_str(), rank,
                  StageDeviation(stage, rank, samples));
    }
  }
  for (int rank = 0; rank <= 3; ++rank) {
    std::printf("%-14s rank %d  %.2f\n", "reward", rank, RewardDeviation(rank, samples));
  }
  std::printf("three steps, gp policy      %.2f\n", ChainDeviation(PolicyKind::kGp, samples));
  std::printf("three steps, linear policy  %.2f\n", ChainDeviation(PolicyKind::kLinear, samples));
  return 0;
}

}  // namespace
}  // namespace downpour

int main(int argc, char** argv) {
  return downpour::RunProgram("pilco_samples", downpour::Main, argc, argv);
}
