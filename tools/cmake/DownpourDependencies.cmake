# SPDX-License-Identifier: Apache-2.0
# What the libraries are linked with, for the build and for projects that use the installed package.
# Downpour_FIND_REQUIRED: a missing one is an error.
include(CMakeFindDependencyMacro)
find_dependency(OpenMP)
find_dependency(Eigen3 3.4 NO_MODULE)
find_dependency(hwy)
find_dependency(NLopt)
find_dependency(muparser)
find_dependency(tomlplusplus)

# An imported library that has no configuration of its own, or one that asks for too much.
macro(downpour_import target variable)
  if(NOT TARGET ${target})
    find_library(${variable} ${ARGN})
    mark_as_advanced(${variable})
    if(${variable})
      add_library(${target} UNKNOWN IMPORTED GLOBAL)
      set_target_properties(${target} PROPERTIES IMPORTED_LOCATION ${${variable}})
    elseif(Downpour_FIND_REQUIRED)
      message(FATAL_ERROR "Downpour: no library for ${target} (${ARGN})")
    endif()
  endif()
endmacro()

# The OpenMP build of OpenBLAS, so that BLAS and our own regions share one thread pool.
downpour_import(openblas::openmp OPENBLAS_LIBRARY openblas
                PATHS /usr/lib/${CMAKE_LIBRARY_ARCHITECTURE}/openblas-openmp NO_DEFAULT_PATH)
# Debian's mujoco configuration asks for OpenGL and qhull headers, which simulation does not need.
downpour_import(mujoco::mujoco MUJOCO_LIBRARY mujoco)
