// SPDX-License-Identifier: Apache-2.0
#pragma once

namespace downpour {

// Consecutive candidates of a batch that are compared with each other by their mean returns: the
// n_exact best of them and their order must be known, the others only to be worse.
struct CandidateGroup {
  int n_candidates = 0;
  int n_exact = 0;
};

}  // namespace downpour
