// SPDX-License-Identifier: Apache-2.0
#include <fmt/format.h>

#include <CLI/App.hpp>
#include <CLI/Config.hpp>
#include <CLI/Formatter.hpp>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "engine/errors.h"
#include "tools/downpour/commands.h"
#include "tools/downpour/option_help.h"
#include "tools/downpour/profile_model.h"
#include "tools/downpour/profile_output.h"
#include "tools/downpour/python_script.h"
#include "tools/measure/machine.h"

namespace downpour {

extern const char* const k_performance_plot_py;  // performance_plot.py

namespace {

struct ProfileArguments {
  std::string run;
  std::vector<std::string> outputs;
  std::vector<int> points = {40, 80, 160, 320, 640};
  std::vector<int> episodes;  // empty: all learnt ones
  int n_inputs = 6, n_outputs = 4;
  int threads = 1;
  double seconds = 0.4;
  ProfileSettings settings;
  bool json = false;
};

std::vector<Field> SyntheticFields(ProfileArguments& arguments) {
  return {{.key = "points",
           .option = "--points",
           .target = &arguments.points,
           .min = 1,
           .max = 20000,
           .description = "Training points n of synthetic models, a list."},
          {.key = "inputs",
           .option = "--inputs",
           .target = &arguments.n_inputs,
           .min = 2,
           .max = 100,
           .description = "Inputs D of synthetic models, an action among them."},
          {.key = "outputs",
           .option = "--outputs",
           .target = &arguments.n_outputs,
           .min = 1,
           .max = 100,
           .description = "Outputs E of synthetic models."},
          {.key = "policy",
           .option = "--policy",
           .target = &arguments.settings.policy,
           .choices = {kPolicyKindNames.begin(), kPolicyKindNames.end()},
           .description = "Policy on synthetic models."}};
}

std::vector<Field> CommonFields(ProfileArguments& arguments) {
  return {{.key = "episodes",
           .option = "--episodes",
           .target = &arguments.episodes,
           .min = 1,
           .max = 1000,
           .description = "Episodes of RUN whose models to profile, a list; all learnt ones if "
                          "left out."},
          {.key = "lanes",
           .option = "--lanes",
           .target = &arguments.settings.lanes,
           .min = 1,
           .max = 100000,
           .description = "Rollouts of the batch."},
          {.key = "threads",
           .option = "--threads",
           .target = &arguments.threads,
           .min = 1,
           .max = 1024,
           .description = "Threads."},
          {.key = "plan",
           .option = "--plan",
           .target = &arguments.settings.plan,
           .choices = {"auto", "exact"},
           .description = "auto: by tolerances, the run's or the default; exact: all points."},
          {.key = "precision",
           .option = "--precision",
           .target = &arguments.settings.precision,
           .choices = {"double", "single"},
           .description = "Of the exact plan."},
          {.key = "backend",
           .option = "--backend",
           .target = &arguments.settings.backend,
           .choices = {kQueryBackendNames.begin(), kQueryBackendNames.end()},
           .description = "The project's kernel or OpenBLAS."},
          {.key = "seconds",
           .option = "--seconds",
           .target = &arguments.seconds,
           .min = 0,
           .max = 100,
           .description = "Measuring time of each model; three repetitions at least."}};
}

std::vector<Field> ProfileFields(ProfileArguments& arguments) {
  std::vector<Field> fields = SyntheticFields(arguments);
  for (Field& field : CommonFields(arguments)) fields.push_back(std::move(field));
  return fields;
}

void CheckArguments(const ProfileArguments& arguments, const std::vector<Setting>& given) {
  ProfileArguments defaults;
  for (const Setting& setting : given) {
    for (const Field& field : SyntheticFields(defaults)) {
      if (arguments.run.empty() || setting.origin != field.option) continue;
      throw InvalidInput(
          fmt::format("{}: a run has its own; must be left out with RUN", field.option));
    }
    if (setting.key == "episodes" && arguments.run.empty()) {
      throw InvalidInput("--episodes: of a run; must be left out without RUN");
    }
  }
  if (arguments.settings.precision == "single" &&
      (arguments.settings.plan != "exact" || arguments.settings.backend != QueryBackend::kFused)) {
    throw InvalidInput("--precision single: must come with --plan exact and --backend fused");
  }
  CheckPictureNames(arguments.outputs);
}

// Adds the model's profile; the model itself goes before the next one is made.
void AddProfile(ProfileModel model, const ProfileArguments& arguments, ProfileReport* report) {
  model.rollout.threads = arguments.threads;
  report->models.push_back(
      {.episode = model.episode,
       .points = model.points,
       .n_inputs = model.task->n_inputs(),
       .n_outputs = static_cast<int>(model.factors.size()),
       .plans = model.plans,
       .profile = ProfileRollouts(*model.task, *model.policy, model.factors, model.rollout,
                                  model.batch, arguments.seconds, model.prior)});
}

// The episodes of the run to profile.
std::vector<EpisodeRecord> FindEpisodes(const ReadRun& run, const ProfileArguments& arguments) {
  std::vector<EpisodeRecord> records;
  for (const int episode : arguments.episodes) records.push_back(FindLearntEpisode(run, episode));
  for (const EpisodeRecord& record : run.state.episodes) {
    if (arguments.episodes.empty() && !record.random) records.push_back(record);
  }
  if (records.empty()) {
    throw InvalidInput(fmt::format(
        "{}: all episodes were random, without a model; must have a learnt one", arguments.run));
  }
  return records;
}

void ProfileSynthetic(const ProfileArguments& arguments, ProfileReport* report) {
  const Task task = SyntheticTask(arguments.n_inputs, arguments.n_outputs);
  report->subject =
      fmt::format("synthetic models, D = {}, E = {}", arguments.n_inputs, arguments.n_outputs);
  for (const int n : arguments.points) {
    AddProfile(SyntheticModel(task, n, arguments.settings), arguments, report);
  }
}

void Profile(const ProfileArguments& arguments) {
  ProfileReport report;
  std::optional<ReadRun> run;
  std::vector<EpisodeRecord> records;
  if (!arguments.run.empty()) {
    run = ReadRunDirectory(arguments.run);
    records = FindEpisodes(*run, arguments);
    report.subject = fmt::format("{} ({})", arguments.run, run->resolved.task.name);
  }
  const std::string warning = LoadWarning();
  if (!warning.empty()) fmt::print(stderr, "downpour: warning: {}\n", warning);
  report.ceilings = MeasureCeilings(arguments.threads);
  if (!run) ProfileSynthetic(arguments, &report);
  for (const EpisodeRecord& record : records) {
    AddProfile(SavedModel(*run, record, arguments.settings), arguments, &report);
  }
  // Paths need not be UTF-8.
  const std::string json =
      ProfileJson(report).dump(2, ' ', false, nlohmann::json::error_handler_t::replace);
  if (arguments.json) {
    fmt::print("{}\n", json);
  } else {
    PrintProfile(report);
  }
  if (arguments.outputs.empty()) return;
  std::vector<std::string> words = {"profile"};
  words.insert(words.end(), arguments.outputs.begin(), arguments.outputs.end());
  RunPythonScript(k_performance_plot_py, std::move(words), json);
}

}  // namespace

void AddProfileCommand(CLI::App* app) {
  CLI::App* command = app->add_subcommand(
      "profile", "Measure what a GP query in rollouts costs, part by part, against the machine");
  auto arguments = std::make_shared<ProfileArguments>();
  auto settings = std::make_shared<std::vector<Setting>>();
  command->add_option("RUN", arguments->run, "Run directory; synthetic models if left out")
      ->check(NotEmpty());
  command
      ->add_option("-o,--output", arguments->outputs,
                   "Picture of the costs and the roofline, .png or .svg; repeatable")
      ->type_name("FILE")
      ->allow_extra_args(false)
      ->check(NotEmpty());
  command->add_flag("--json", arguments->json, "Print JSON in place of tables");
  AddFieldOptions(command, ProfileFields(*arguments), settings);
  command->footer(
      "Examples:\n"
      "  downpour profile                             n = 40 to 640, D = 6, E = 4\n"
      "  downpour profile --plan exact --points 320,1280 -o roofline.png\n"
      "  downpour profile runs/cartpole-seed0         the models of a run's episodes");
  command->callback([arguments, settings] {
    ApplySettings(ProfileFields(*arguments), *settings);
    CheckArguments(*arguments, *settings);
    Profile(*arguments);
  });
}

}  // namespace downpour
