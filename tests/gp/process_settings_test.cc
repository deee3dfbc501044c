// SPDX-License-Identifier: Apache-2.0
#include "engine/gp/process_settings.h"

#include <doctest/doctest.h>

#include <cstdlib>

namespace downpour {
namespace {

TEST_CASE(
    "process_settings: the families OpenBLAS falls back to are weaker than the suitable ones") {
  for (const char* core : {"Prescott", "Core2", "Nehalem", "Sandybridge", "Unknown"}) {
    CAPTURE(core);
    CHECK(IsWeakerBlasCore(core, "Haswell"));
    CHECK(IsWeakerBlasCore(core, "SkylakeX"));
  }
  CHECK(IsWeakerBlasCore("Haswell", "SkylakeX"));
  CHECK(IsWeakerBlasCore("Zen", "SkylakeX"));
}

TEST_CASE("process_settings: an equal or wider family, or an unknown CPU, is left alone") {
  CHECK_FALSE(IsWeakerBlasCore("SkylakeX", "SkylakeX"));
  CHECK_FALSE(IsWeakerBlasCore("Cooperlake", "SkylakeX"));
  CHECK_FALSE(IsWeakerBlasCore("Zen", "Haswell"));
  CHECK_FALSE(IsWeakerBlasCore("SkylakeX", "Haswell"));
  CHECK_FALSE(IsWeakerBlasCore("Prescott", ""));
}

TEST_CASE("process_settings: the tests run on the suitable family unless the user chose another") {
  const bool chosen_by_user = std::getenv("OPENBLAS_CORETYPE") && !BlasCoreWasMended();
  CAPTURE(BlasCoreName());
  CAPTURE(SuitableBlasCore());
  CHECK((chosen_by_user || !IsWeakerBlasCore(BlasCoreName(), SuitableBlasCore())));
}

TEST_CASE(
    "process_settings: the tests' waiting OpenMP threads leave their core unless told to spin") {
  const char* policy = std::getenv("OMP_WAIT_POLICY");
  CHECK((policy != nullptr || std::getenv("GOMP_SPINCOUNT") != nullptr));
}

TEST_CASE("process_settings: preparing again changes nothing") {
  char name[] = "gp_tests";
  char* argv[] = {name, nullptr};
  const std::string core = BlasCoreName();
  CHECK_FALSE(PrepareProcess(argv));
  CHECK(BlasCoreName() == core);
}

}  // namespace
}  // namespace downpour
