// SPDX-License-Identifier: Apache-2.0
#include "engine/gp/dataset.h"

#include <doctest/doctest.h>

#include <limits>
#include <vector>

#include "engine/errors.h"

namespace downpour {
namespace {

TEST_CASE("dataset: rows of numbers become rows of matrices") {
  const std::vector<double> inputs = {1, 2, 3, 4, 5, 6}, targets = {7, 8};
  const Dataset data = MakeDataset(inputs, 3, targets, 1);
  CHECK(data.n_points() == 2);
  CHECK(data.inputs == Eigen::MatrixXd{{1, 2, 3}, {4, 5, 6}});
  CHECK(data.targets == Eigen::MatrixXd{{7}, {8}});
}

TEST_CASE("dataset: sizes that disagree and numbers that are not finite are refused") {
  std::vector<double> inputs = {1, 2, 3, 4}, targets = {7, 8};
  CHECK_THROWS_AS(MakeDataset(inputs, 3, targets, 1), InvalidInput);
  CHECK_THROWS_AS(MakeDataset(inputs, 2, targets, 2), InvalidInput);
  CHECK_THROWS_AS(MakeDataset(inputs, 0, targets, 1), InvalidInput);
  CHECK_THROWS_AS(MakeDataset(inputs, 2, targets, -1), InvalidInput);
  CHECK_THROWS_AS(MakeDataset({}, 2, {}, 1), InvalidInput);
  inputs[3] = std::numeric_limits<double>::infinity();
  CHECK_THROWS_AS(MakeDataset(inputs, 2, targets, 1), InvalidInput);
}

}  // namespace
}  // namespace downpour
