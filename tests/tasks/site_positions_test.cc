// SPDX-License-Identifier: Apache-2.0
#include "tasks/toml_task/site_positions.h"

#include <doctest/doctest.h>
#include <mujoco/mujoco.h>

#include <cmath>
#include <memory>
#include <string>
#include <vector>

#include "engine/errors.h"
#include "kernels/philox/philox.h"
#include "tasks/mujoco_system.h"

namespace downpour {
namespace {

// Turned frames, an anchor off the origin, two joints of one body, a slide, references, a branch.
constexpr const char* kModel = R"(<mujoco><worldbody>
  <site name="fixed" pos="1 2 3"/>
  <body name="a" pos="0.1 0.2 0.3" euler="20 30 40">
    <joint name="yaw" axis="0 0 1" pos="0.05 -0.1 0.2"/>
    <joint name="pitch" axis="1 1 0" ref="15"/>
    <geom size="0.1"/>
    <body name="b" pos="0 0 0.5" quat="0.5 0.5 -0.5 0.5">
      <joint name="slide" type="slide" axis="0.6 0 0.8" ref="0.1"/>
      <geom size="0.1"/>
      <site name="tip" pos="0.3 -0.2 0.1"/>
    </body>
    <body name="c" pos="0 1 0"><geom size="0.1"/>
      <body name="d" pos="0 1 0"><joint name="ball" type="ball"/><geom size="0.1"/>
        <site name="loose"/></body>
      <site name="side"/>
    </body>
  </body></worldbody></mujoco>)";

std::string Refusal(const mjModel& model, const std::vector<int>& states, const std::string& site) {
  try {
    const SitePositions positions(model, states, {site});
  } catch (const InvalidInput& error) {
    return error.what();
  }
  return "";
}

TEST_CASE("site positions: those of mj_kinematics, for every lane") {
  const auto model = LoadMujocoModel({.name = "test", .mjcf = kModel});
  const std::unique_ptr<mjData, decltype(&mj_deleteData)> data(mj_makeData(model.get()),
                                                               &mj_deleteData);
  const std::vector<std::string> sites = {"fixed", "tip", "side"};
  const std::vector<int> states = {2, 0, 3, -1};  // yaw, pitch, slide, ball
  const SitePositions positions(*model, states, sites);
  AlignedVector<double> tile(4 * kTileLanes), found(3 * kTileLanes);
  FillUniforms(StreamKey{2, 2}, 0, tile.data(), tile.size());
  for (double& value : tile) value = 8 * value - 4;
  for (std::size_t site = 0; site < sites.size(); ++site) {
    CAPTURE(sites[site]);
    positions.Evaluate(static_cast<int>(site), tile.data(), found.data());
    for (int lane = 0; lane < kTileLanes; ++lane) {
      for (int joint = 0; joint < 3; ++joint) {
        data->qpos[model->jnt_qposadr[joint]] = tile[states[joint] * kTileLanes + lane];
      }
      mj_kinematics(model.get(), data.get());
      const double* const place =
          data->site_xpos + 3 * mj_name2id(model.get(), mjOBJ_SITE, sites[site].c_str());
      // Lengths of at most 10 m, some dozen roundings.
      for (int i = 0; i < 3; ++i) CHECK(std::abs(found[i * kTileLanes + lane] - place[i]) < 1e-13);
    }
  }
}

TEST_CASE("site positions: sites that the states do not determine are refused by name") {
  const auto model = LoadMujocoModel({.name = "test", .mjcf = kModel});
  CHECK(Refusal(*model, {0, 1, 2, -1}, "tip") == "");
  CHECK(Refusal(*model, {0, -1, 2, -1}, "tip").find("site tip hangs on joint pitch") !=
        std::string::npos);
  CHECK(Refusal(*model, {-1, -1, -1, -1}, "fixed") == "");
  CHECK(Refusal(*model, {0, 1, 2, 3}, "loose").find("hangs on joint ball") != std::string::npos);
  CHECK(Refusal(*model, {0, 1, 2, -1}, "tpi") ==
        "the model has no site tpi; allowed: fixed, tip, "
        "side, loose");
}

}  // namespace
}  // namespace downpour
