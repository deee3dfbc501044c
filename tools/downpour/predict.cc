// SPDX-License-Identifier: Apache-2.0
#include <fmt/format.h>

#include <CLI/App.hpp>
#include <CLI/Config.hpp>
#include <CLI/Formatter.hpp>
#include <memory>
#include <string>
#include <vector>

#include "engine/learner/atomic_file.h"
#include "tools/downpour/commands.h"
#include "tools/downpour/option_help.h"
#include "tools/downpour/read_run.h"

namespace downpour {
namespace {

struct PredictArguments {
  std::string run;
  std::string output;
  int episode = 0;  // 0: the last
  int rollouts = 200;
};

std::vector<Field> PredictFields(PredictArguments& arguments) {
  return {
      EpisodeField(&arguments.episode, "Policy and model of this episode; 0: the last one."),
      {.key = "rollouts",
       .option = "--rollouts",
       .target = &arguments.rollouts,
       .min = 1,
       .max = 100000,
       .description = "Number of rollouts."},
  };
}

void Predict(const PredictArguments& arguments) {
  const ReadRun run = ReadRunDirectory(arguments.run);
  const EpisodeRecord& record = FindLearntEpisode(run, arguments.episode);
  const Prediction prediction = PredictSavedEpisode(run, record, arguments.rollouts);
  if (!arguments.output.empty()) {
    WriteFileAtomically(arguments.output, PredictionCsv(run.resolved.task, prediction));
  }
  fmt::print("{}, episode {}, {} rollouts on its model of {} points\n", run.resolved.task.name,
             record.episode, arguments.rollouts, record.points);
  fmt::print("return   predicted {:.2f} +- {:.2f} (std of rollouts)   real {:.2f}\n",
             prediction.mean_return, prediction.return_std, record.real_return);
  if (prediction.n_diverged == 0) return;
  fmt::print("diverged {} of {}, not counted\n", prediction.n_diverged, arguments.rollouts);
}

}  // namespace

void AddPredictCommand(CLI::App* app) {
  CLI::App* command = app->add_subcommand(
      "predict",
      "What the model of an episode expected of its policy: rollouts, as a table of every step");
  auto arguments = std::make_shared<PredictArguments>();
  command->add_option("RUN", arguments->run, "Run directory")->required()->check(NotEmpty());
  command->add_option("-o,--output", arguments->output, "CSV file of all steps")
      ->type_name("FILE")
      ->check(NotEmpty());
  RunWithFields(command, arguments, PredictFields, Predict);
}

}  // namespace downpour
