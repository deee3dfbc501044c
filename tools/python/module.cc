// SPDX-License-Identifier: Apache-2.0
#include <exception>

#include "engine/errors.h"
#include "engine/gp/process_settings.h"
#include "kernels/fma_peak/fma_peak.h"
#include "tools/python/arguments.h"
#include "tools/python/cmaes.h"
#include "tools/python/env.h"
#include "tools/python/evaluator.h"
#include "tools/python/gaussian_process.h"
#include "tools/python/learn.h"

namespace downpour::python {
namespace {

void Translate(std::exception_ptr error) {
  try {
    if (error) std::rethrow_exception(error);
  } catch (const InvalidInput& invalid) {
    PyErr_SetString(PyExc_ValueError, invalid.what());
  } catch (const FileError& file) {
    PyErr_SetString(PyExc_OSError, file.what());
  }
}

}  // namespace

PYBIND11_MODULE(_core, module) {
  py::options options;
  options.disable_function_signatures();
  py::register_exception_translator(&Translate);
  AddGaussianProcess(&module);
  AddEvaluator(&module);
  AddCmaEs(&module);
  AddLearn(&module);
  AddEnv(&module);
  module.attr("__version__") = DOWNPOUR_VERSION;
  // For downpour.doctor().
  module.def("blas_core", &BlasCoreName);
  module.def("suitable_blas_core", &SuitableBlasCore);
  module.def("is_weaker_blas_core", &IsWeakerBlasCore);
  module.def("simd_target", [] { return std::string(SimdTargetName()); });
}

}  // namespace downpour::python
