// SPDX-License-Identifier: Apache-2.0
#include <fmt/format.h>

#include <CLI/App.hpp>
#include <CLI/Config.hpp>
#include <CLI/Formatter.hpp>
#include <memory>
#include <string>

#include "engine/learner/atomic_file.h"
#include "engine/learner/c_header.h"
#include "tools/downpour/commands.h"
#include "tools/downpour/option_help.h"
#include "tools/downpour/policy_file.h"

namespace downpour {

void AddExportCommand(CLI::App* app) {
  struct Arguments {
    std::string policy, output;
  };
  CLI::App* command =
      app->add_subcommand("export", "Write a policy as a C header that depends on <math.h> alone");
  auto arguments = std::make_shared<Arguments>();
  command->add_option("POLICY", arguments->policy, "policy.json, or a run directory for its last")
      ->required()
      ->check(NotEmpty());
  command
      ->add_option("-o,--out", arguments->output,
                   "File to write, e.g. policy.h; left out: standard output")
      ->type_name("FILE")
      ->check(NotEmpty());
  command->callback([arguments] {
    const LoadedPolicy policy = LoadPolicy(arguments->policy);
    const std::string text = CHeader(policy.saved, policy.task);
    if (arguments->output.empty()) {
      fmt::print("{}", text);
    } else {
      WriteFileAtomically(arguments->output, text);
    }
  });
}

}  // namespace downpour
