// SPDX-License-Identifier: Apache-2.0
// How long does learning the model of a run's transitions take, and what comes of it? Prints, as
// JSON, the time of one likelihood and gradient of every output (best of repetitions, one thread),
// the time of a cold fit of all outputs, the optima, and with --data the data set itself, for
// bench/fit_comparison.py.
#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <span>
#include <string>
#include <vector>

#include "bench/program.h"
#include "bench/run_data.h"
#include "engine/gp/gp_model.h"
#include "engine/gp/likelihood.h"
#include "kernels/fma_peak/fma_peak.h"
#include "tasks/registry.h"

namespace downpour {
namespace {

double SecondsSince(std::chrono::steady_clock::time_point start) {
  return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
}

// Seconds of one likelihood and gradient at the optimum; repetitions fill about `seconds`.
double EvaluationSeconds(const Dataset& data, int output, const Hyperparameters& hyper,
                         double seconds) {
  LogLikelihood likelihood(data.inputs, data.targets.col(output));
  std::vector<double> parameters;
  for (const double l : hyper.lengthscales) parameters.push_back(std::log(l));
  parameters.push_back(std::log(hyper.signal_std));
  parameters.push_back(std::log(hyper.noise_std));
  std::vector<double> gradient(parameters.size());
  double best = HUGE_VAL, sink = 0;
  for (const auto begin = std::chrono::steady_clock::now(); SecondsSince(begin) < seconds;) {
    const auto start = std::chrono::steady_clock::now();
    sink += likelihood(parameters.data(), gradient.data()) + gradient[0];
    best = std::min(best, SecondsSince(start));
  }
  if (!std::isfinite(sink)) throw std::runtime_error("the likelihood is not finite");
  return best;
}

void PrintNumbers(const char* name, std::span<const double> numbers) {
  std::printf("\"%s\": [", name);
  for (std::size_t i = 0; i < numbers.size(); ++i) {
    std::printf("%s%.17g", i == 0 ? "" : ", ", numbers[i]);
  }
  std::printf("]");
}

// A row a line.
void PrintMatrix(const char* name, const Eigen::MatrixXd& matrix) {
  std::printf(",\n\"%s\": [\n", name);
  for (Eigen::Index i = 0; i < matrix.rows(); ++i) {
    for (Eigen::Index j = 0; j < matrix.cols(); ++j) {
      std::printf("%s%.17g", j == 0 ? "[" : ", ", matrix(i, j));
    }
    std::printf("]%s\n", i + 1 < matrix.rows() ? "," : "");
  }
  std::printf("]");
}

int Main(int argc, char** argv) {
  std::string task_name;
  std::vector<std::filesystem::path> runs;
  int episodes = 8, threads = 2, repetitions = 3;
  std::uint64_t seed = 1;
  bool print_data = false;
  GpFitOptions options;
  CLI::App app("Hyper-parameters of a run's transitions: time and likelihood");
  app.add_option("task", task_name)->required();
  app.add_option("run", runs, "run directories that hold the data")->required();
  app.add_option("--episodes", episodes, "the model learns from so many of each run");
  app.add_option("--threads", threads);
  app.add_option("--seed", seed, "of the restarts");
  app.add_option("--restarts", options.restarts);
  app.add_option("--repetitions", repetitions, "of the timed fit")->check(CLI::PositiveNumber);
  app.add_flag("--data", print_data, "prints the data set, too");
  CLI11_PARSE(app, argc, argv);

  const Task task = MakeTask(task_name);
  const Dataset data = ReadDataset(task, runs, episodes);
  std::vector<GpFit> fits;
  double fit_seconds = HUGE_VAL;
  for (int r = 0; r < repetitions; ++r) {
    const auto start = std::chrono::steady_clock::now();
    fits = FitHyperparameters(data, {}, options, seed, 0, threads);
    fit_seconds = std::min(fit_seconds, SecondsSince(start));
  }
  std::printf("{\"task\": \"%s\", \"points\": %d, \"threads\": %d, \"peak_gflops\": %.1f,\n",
              task_name.c_str(), data.n_points(), threads, FmaPeakGflops(false, 0.1));
  std::printf("\"cold_fit_seconds\": %.4f, \"outputs\": [\n", fit_seconds);
  for (int e = 0; e < data.n_outputs(); ++e) {
    const Hyperparameters& hyper = fits[e].hyperparameters;
    std::printf("{\"name\": \"%s\", \"evaluation_ms\": %.4f, \"evaluations\": %d,\n",
                task.states[e].name.c_str(), 1e3 * EvaluationSeconds(data, e, hyper, 0.3),
                fits[e].evaluations);
    std::printf(" \"log_likelihood\": %.17g, \"signal_std\": %.17g, \"noise_std\": %.17g,\n ",
                fits[e].log_likelihood, hyper.signal_std, hyper.noise_std);
    PrintNumbers("lengthscales", hyper.lengthscales);
    std::printf("}%s\n", e + 1 < data.n_outputs() ? "," : "");
  }
  std::printf("]");
  if (print_data) {
    PrintMatrix("inputs", data.inputs);
    PrintMatrix("targets", data.targets);
  }
  std::printf("}\n");
  return 0;
}

}  // namespace
}  // namespace downpour

int main(int argc, char** argv) {
  return downpour::RunProgram("fit_bench", downpour::Main, argc, argv);
}
