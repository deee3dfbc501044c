// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <string>
#include <vector>

#include "kernels/aligned.h"

struct mjModel_;

namespace downpour {

// Where sites of a MuJoCo model are, from the joint positions in a state: mj_kinematics along the
// bodies from the world to the site, for a tile of lanes. Rollouts know states only, so that every
// joint on that way must be a state. Immutable: calls are thread-safe.
class SitePositions {
 public:
  // `state_of_joint[j]`: the state that is the position of the model's joint j; -1: none. Throws
  // InvalidInput, without the file's name, unless each of `sites` is a site of the model that
  // hangs on such joints, slides and hinges, alone.
  SitePositions(const mjModel_& model, const std::vector<int>& state_of_joint,
                const std::vector<std::string>& sites);

  // x, y and z (m) in the world, 3 x kTileLanes, of sites[site]; states E x kTileLanes. Does not
  // allocate. Within 1e-12 of the model's extent of MuJoCo's own numbers.
  void Evaluate(int site, const double* states, double* positions) const;

 private:
  enum class Kind { kShift, kTurn, kSlide, kHinge };
  // One link of the way, in the frame that the links before it lead to.
  struct Link {
    Kind kind;
    double vector[3];         // shift (m), or the joint's axis
    double rotation[9] = {};  // kTurn, row-major
    int state = -1;           // of a joint: the angle (rad) or way (m) is state - reference
    double reference = 0;
  };

  void AppendBody(const mjModel_& model, const std::vector<int>& state_of_joint, int body,
                  const std::string& site, std::vector<Link>* way);

  std::vector<std::vector<Link>> ways_;
};

}  // namespace downpour
