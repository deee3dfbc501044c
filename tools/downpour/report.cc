// SPDX-License-Identifier: Apache-2.0
#include <fmt/format.h>

#include <CLI/App.hpp>
#include <CLI/Config.hpp>
#include <CLI/Formatter.hpp>
#include <filesystem>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "engine/errors.h"
#include "tools/downpour/commands.h"
#include "tools/downpour/option_help.h"
#include "tools/downpour/python_script.h"

namespace downpour {

// One script in two files.
extern const char* const k_report_data_py;
extern const char* const k_report_py;

namespace {

struct ReportArguments {
  std::string database;
  std::string output;
  int after = 0;  // 0: as in the paper, else the last
};

std::vector<Field> ReportFields(ReportArguments& arguments) {
  return {{.key = "after",
           .option = "--after",
           .target = &arguments.after,
           .min = 0,
           .max = 1000,
           .description = "Episode after which box plots compare; 0: as in the paper (pendulum 4, "
                          "cartpole 8), else the last one."}};
}

void Report(const ReportArguments& arguments) {
  namespace fs = std::filesystem;
  if (!fs::is_regular_file(arguments.database)) {
    throw InvalidInput(fmt::format("{}: must be the database of a study", arguments.database));
  }
  std::string output = arguments.output;
  if (output.empty()) output = fs::path(arguments.database).replace_extension(".html").string();
  if (!output.ends_with(".html")) {
    throw InvalidInput(fmt::format("--output: {}: must end in .html", output));
  }
  RunPythonScript(std::string(k_report_data_py) + k_report_py,
                  {arguments.database, std::move(output), std::to_string(arguments.after)});
}

}  // namespace

void AddReportCommand(CLI::App* app) {
  CLI::App* command =
      app->add_subcommand("report", "Draw the results of a study as a page, pictures and tables");
  auto arguments = std::make_shared<ReportArguments>();
  command->add_option("DATABASE", arguments->database, "Database of downpour study")
      ->type_name("FILE")
      ->required()
      ->check(NotEmpty());
  command
      ->add_option("-o,--output", arguments->output,
                   "Page; pictures and tables go to a folder beside it, PAGE_files (default "
                   "DATABASE with .html for .db)")
      ->type_name("FILE")
      ->check(NotEmpty());
  RunWithFields(command, arguments, ReportFields, Report);
}

}  // namespace downpour
