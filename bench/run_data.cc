// SPDX-License-Identifier: Apache-2.0
#include "bench/run_data.h"

#include <cstdlib>
#include <fstream>
#include <map>
#include <sstream>
#include <stdexcept>
#include <string>
#include <vector>

#include "engine/errors.h"
#include "engine/rollout/evaluator.h"

namespace downpour {
namespace {

using Columns = std::map<std::string, std::vector<double>>;

// Columns of transitions.csv by header without unit; rows of episodes up to `last_episode`.
Columns ReadTransitions(const std::filesystem::path& path, int last_episode) {
  std::ifstream file(path);
  if (!file) throw std::runtime_error("cannot read " + path.string());
  Columns columns;
  std::vector<std::string> names;
  std::string line, field;
  std::getline(file, line);
  for (std::istringstream header(line); std::getline(header, field, ',');) {
    names.push_back(field.substr(0, field.find(" [")));
    columns[names.back()];
  }
  while (std::getline(file, line)) {
    std::istringstream row(line);
    std::vector<double> values;
    while (std::getline(row, field, ','))
      values.push_back(std::strtod(field.c_str(), nullptr));  // stod refuses denormals
    if (values.size() != names.size()) {
      throw InvalidInput(path.string() + ": a row has " + std::to_string(values.size()) +
                         " fields, its header " + std::to_string(names.size()));
    }
    if (values[0] > last_episode) break;
    for (std::size_t i = 0; i < names.size(); ++i) columns[names[i]].push_back(values[i]);
  }
  return columns;
}

// Writes one run's rows from row `first` on.
void FillRows(const Task& task, const Columns& columns, int first, Dataset* data) {
  const int n = static_cast<int>(columns.at("episode").size());
  std::vector<double> state(task.n_states()), features(task.n_features());
  for (int i = 0; i < n; ++i) {
    for (int e = 0; e < task.n_states(); ++e) {
      state[e] = columns.at("observation." + task.states[e].name)[i];
      data->targets(first + i, e) =
          columns.at("next_observation." + task.states[e].name)[i] - state[e];
    }
    ComputeFeatures(task, state, features);
    for (int f = 0; f < task.n_features(); ++f) data->inputs(first + i, f) = features[f];
    for (int a = 0; a < task.n_actions(); ++a) {
      data->inputs(first + i, task.n_features() + a) =
          columns.at("action." + task.actions[a].name)[i];
    }
  }
}

}  // namespace

Dataset ReadDataset(const Task& task, std::span<const std::filesystem::path> runs, int episodes) {
  std::vector<Columns> read;
  int n = 0;
  for (const std::filesystem::path& run : runs) {
    read.push_back(ReadTransitions(run / "transitions.csv", episodes));
    if (read.back().count("observation." + task.states[0].name) == 0) {
      throw InvalidInput(run.string() + ": not a run of " + task.name);
    }
    const int rows = static_cast<int>(read.back().at("episode").size());
    if (rows == 0) throw InvalidInput(run.string() + ": no transitions yet");
    n += rows;
  }
  Dataset data{Eigen::MatrixXd(n, task.n_inputs()), Eigen::MatrixXd(n, task.n_states())};
  int first = 0;
  for (const Columns& columns : read) {
    FillRows(task, columns, first, &data);
    first += static_cast<int>(columns.at("episode").size());
  }
  return data;
}

}  // namespace downpour
