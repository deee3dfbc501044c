// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <doctest/doctest.h>

#include <Eigen/Core>
#include <filesystem>
#include <fstream>
#include <sstream>
#include <string>
#include <vector>

#include "engine/gp/hyperparameters.h"

namespace downpour {

// tests/gp/cartpole_reference.csv: 160 points of a cart-pole run (x, x', theta', cos, sin, u ->
// differences of x, x', theta', theta), hyper-parameters learnt by another program, and posterior
// mean and latent variance at 50 inputs computed in 80-bit long double.
struct CartpoleReference {
  Dataset data;
  std::vector<Hyperparameters> hyper;     // one an output
  Eigen::MatrixXd query, mean, variance;  // 50 x 6, 50 x 4, 50 x 4

  CartpoleReference() {
    std::vector<std::vector<double>> points, queries;
    std::ifstream file(std::filesystem::path(__FILE__).parent_path() / "cartpole_reference.csv");
    for (std::string line; std::getline(file, line);) {
      if (line[0] == '#') continue;
      std::istringstream fields(line);
      std::string kind, field;
      std::getline(fields, kind, ',');
      std::vector<double> values;
      while (std::getline(fields, field, ',')) values.push_back(std::stod(field));
      if (kind == "hyper") {
        hyper.push_back({{values.begin() + 1, values.begin() + 7}, values[7], values[8]});
      } else {
        (kind == "point" ? points : queries).push_back(values);
      }
    }
    REQUIRE(hyper.size() == 4);
    REQUIRE(points.size() == 160);
    REQUIRE(queries.size() == 50);
    data = {Columns(points, 0, 6), Columns(points, 6, 4)};
    query = Columns(queries, 0, 6);
    mean = Columns(queries, 6, 4);
    variance = Columns(queries, 10, 4);
  }

 private:
  static Eigen::MatrixXd Columns(const std::vector<std::vector<double>>& rows, int first,
                                 int count) {
    Eigen::MatrixXd matrix(rows.size(), count);
    for (std::size_t i = 0; i < rows.size(); ++i) {
      for (int j = 0; j < count; ++j) matrix(i, j) = rows[i].at(first + j);
    }
    return matrix;
  }
};

}  // namespace downpour
