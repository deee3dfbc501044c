// SPDX-License-Identifier: Apache-2.0
#include "tasks/toml_task/site_positions.h"

#include <mujoco/mujoco.h>

#include <algorithm>
#include <cmath>

#include "engine/errors.h"
#include "engine/learner/suggest.h"

namespace downpour {
namespace {

// A frame in the world for every lane: origin and row-major rotation.
struct Frames {
  alignas(kAlignment) double origin[3][kTileLanes];
  alignas(kAlignment) double rotation[9][kTileLanes];
};

// origin += scale * rotation * vector; no scale: 1.
void Shift(const double* vector, const double* scale, Frames* frames) {
  for (int row = 0; row < 3; ++row) {
    const double* const r = frames->rotation[3 * row];
    for (int lane = 0; lane < kTileLanes; ++lane) {
      const double way = r[lane] * vector[0] + r[kTileLanes + lane] * vector[1] +
                         r[2 * kTileLanes + lane] * vector[2];
      frames->origin[row][lane] += scale == nullptr ? way : scale[lane] * way;
    }
  }
}

// rotation = rotation * turn, one matrix a lane.
void Turn(const double (*turn)[kTileLanes], Frames* frames) {
  for (int row = 0; row < 3; ++row) {
    double(*const r)[kTileLanes] = frames->rotation + 3 * row;
    for (int lane = 0; lane < kTileLanes; ++lane) {
      const double old[3] = {r[0][lane], r[1][lane], r[2][lane]};
      for (int c = 0; c < 3; ++c) {
        r[c][lane] =
            old[0] * turn[c][lane] + old[1] * turn[3 + c][lane] + old[2] * turn[6 + c][lane];
      }
    }
  }
}

// Rodrigues: cos I + sin [a]x + (1 - cos) a a^T for the unit axis a.
void AxisTurn(const double* a, const double* angles, double (*turn)[kTileLanes]) {
  for (int lane = 0; lane < kTileLanes; ++lane) {
    const double c = std::cos(angles[lane]), s = std::sin(angles[lane]), t = 1 - c;
    const double all[9] = {
        c + t * a[0] * a[0],        t * a[0] * a[1] - s * a[2], t * a[0] * a[2] + s * a[1],
        t * a[1] * a[0] + s * a[2], c + t * a[1] * a[1],        t * a[1] * a[2] - s * a[0],
        t * a[2] * a[0] - s * a[1], t * a[2] * a[1] + s * a[0], c + t * a[2] * a[2]};
    for (int i = 0; i < 9; ++i) turn[i][lane] = all[i];
  }
}

std::vector<std::string> SiteNames(const mjModel& model) {
  std::vector<std::string> names;
  for (int site = 0; site < model.nsite; ++site) {
    const char* const name = mj_id2name(&model, mjOBJ_SITE, site);
    if (name != nullptr) names.push_back(name);
  }
  return names;
}

}  // namespace

void SitePositions::AppendBody(const mjModel& model, const std::vector<int>& state_of_joint,
                               int body, const std::string& site, std::vector<Link>* way) {
  if (body == 0) return;  // the world
  AppendBody(model, state_of_joint, model.body_parentid[body], site, way);
  Link shift{Kind::kShift, {}}, turn{Kind::kTurn, {}};
  std::copy_n(model.body_pos + 3 * body, 3, shift.vector);
  mju_quat2Mat(turn.rotation, model.body_quat + 4 * body);
  way->push_back(shift);
  way->push_back(turn);
  const int first = model.body_jntadr[body];
  for (int joint = first; joint < first + model.body_jntnum[body]; ++joint) {
    const bool slide = model.jnt_type[joint] == mjJNT_SLIDE;
    if (state_of_joint[joint] < 0 || (!slide && model.jnt_type[joint] != mjJNT_HINGE)) {
      const char* const name = mj_id2name(&model, mjOBJ_JOINT, joint);
      throw InvalidInput("site " + site + " hangs on joint " +
                         (name == nullptr ? "number " + std::to_string(joint) : name) +
                         "; the position of every joint that it hangs on must be a state");
    }
    Link link{slide ? Kind::kSlide : Kind::kHinge, {}};
    std::copy_n(model.jnt_axis + 3 * joint, 3, link.vector);
    link.state = state_of_joint[joint];
    link.reference = model.qpos0[model.jnt_qposadr[joint]];
    // A hinge turns about its anchor.
    Link there{Kind::kShift, {}}, back{Kind::kShift, {}};
    for (int i = 0; i < 3; ++i) {
      there.vector[i] = model.jnt_pos[3 * joint + i];
      back.vector[i] = -there.vector[i];
    }
    if (!slide) way->push_back(there);
    way->push_back(link);
    if (!slide) way->push_back(back);
  }
}

SitePositions::SitePositions(const mjModel& model, const std::vector<int>& state_of_joint,
                             const std::vector<std::string>& sites) {
  for (const std::string& name : sites) {
    const int site = mj_name2id(&model, mjOBJ_SITE, name.c_str());
    if (site < 0) {
      const std::vector<std::string> names = SiteNames(model);
      throw InvalidInput("the model has no site " + name +
                         (names.empty() ? " or any other" : "; " + Suggest(name, names)));
    }
    std::vector<Link> way;
    AppendBody(model, state_of_joint, model.site_bodyid[site], name, &way);
    Link last{Kind::kShift, {}};
    std::copy_n(model.site_pos + 3 * site, 3, last.vector);
    way.push_back(last);
    ways_.push_back(std::move(way));
  }
}

void SitePositions::Evaluate(int site, const double* states, double* positions) const {
  Frames frames;
  for (int row = 0; row < 3; ++row) std::fill_n(frames.origin[row], kTileLanes, 0.0);
  for (int i = 0; i < 9; ++i) std::fill_n(frames.rotation[i], kTileLanes, i % 4 == 0 ? 1.0 : 0.0);
  for (const Link& link : ways_[site]) {
    alignas(kAlignment) double amount[kTileLanes], turn[9][kTileLanes];
    if (link.state >= 0) {
      const double* const state = states + link.state * kTileLanes;
      for (int lane = 0; lane < kTileLanes; ++lane) amount[lane] = state[lane] - link.reference;
    }
    switch (link.kind) {
      case Kind::kShift:
        Shift(link.vector, nullptr, &frames);
        break;
      case Kind::kSlide:
        Shift(link.vector, amount, &frames);
        break;
      case Kind::kHinge:
        AxisTurn(link.vector, amount, turn);
        Turn(turn, &frames);
        break;
      case Kind::kTurn:
        for (int i = 0; i < 9; ++i) std::fill_n(turn[i], kTileLanes, link.rotation[i]);
        Turn(turn, &frames);
        break;
    }
  }
  std::copy_n(frames.origin[0], 3 * kTileLanes, positions);
}

}  // namespace downpour
