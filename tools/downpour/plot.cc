// SPDX-License-Identifier: Apache-2.0
#include <fmt/format.h>

#include <CLI/App.hpp>
#include <CLI/Config.hpp>
#include <CLI/Formatter.hpp>
#include <memory>
#include <string>
#include <vector>

#include "tools/downpour/commands.h"
#include "tools/downpour/option_help.h"
#include "tools/downpour/python_script.h"
#include "tools/downpour/read_run.h"

namespace downpour {

extern const char* const k_plot_py;  // plot.py

namespace {

constexpr int kRollouts = 200;

struct PlotArguments {
  std::string run;
  std::vector<std::string> outputs;
  int episode = 0;  // 0: the last
};

std::vector<Field> PlotFields(PlotArguments& arguments) {
  return {EpisodeField(&arguments.episode, "Trajectories of this episode; 0: the last one.")};
}

void Plot(PlotArguments arguments) {
  CheckPictureNames(arguments.outputs);
  const ReadRun run = ReadRunDirectory(arguments.run);
  const Task& task = run.resolved.task;
  const EpisodeRecord& record = FindEpisode(run, arguments.episode);
  std::string prediction;
  if (!record.random) {
    prediction = PredictionCsv(task, PredictSavedEpisode(run, record, kRollouts));
  }
  if (arguments.outputs.empty()) {
    for (const char* name : {"run.png", "run.svg"}) {
      arguments.outputs.push_back((run.path / name).string());
    }
  }
  std::vector<std::string> words = {arguments.run, task.name, std::to_string(record.episode),
                                    fmt::format("{}", task.control_period)};
  words.insert(words.end(), arguments.outputs.begin(), arguments.outputs.end());
  RunPythonScript(k_plot_py, std::move(words), prediction);
}

}  // namespace

void AddPlotCommand(CLI::App* app) {
  CLI::App* command = app->add_subcommand(
      "plot", "Draw how a run went: returns, times, and an episode with its model's expectation");
  auto arguments = std::make_shared<PlotArguments>();
  command->add_option("RUN", arguments->run, "Run directory")->required()->check(NotEmpty());
  command
      ->add_option("-o,--output", arguments->outputs,
                   "Picture, .png or .svg; repeatable (default RUN/run.png and RUN/run.svg)")
      ->type_name("FILE")
      ->allow_extra_args(false)
      ->check(NotEmpty());
  RunWithFields(command, arguments, PlotFields, Plot);
}

}  // namespace downpour
