# SPDX-License-Identifier: Apache-2.0
# Targets that other projects link, their public headers, and the installed package.

# The whole engine in one name.
add_library(downpour_engine INTERFACE)
target_link_libraries(downpour_engine INTERFACE downpour_gp downpour_rollout downpour_pilco
                      downpour_search downpour_learner)

# Public headers: those to be included, and what these include.
file(GLOB kernels_headers CONFIGURE_DEPENDS kernels/*/*.h)
list(FILTER kernels_headers EXCLUDE REGEX "(_ref|-inl)\\.h$")
list(APPEND kernels_headers kernels/aligned.h)
set(gp_headers
    engine/eigen.h engine/errors.h engine/gp/blas_query.h engine/gp/dataset.h engine/gp/gp_model.h
    engine/gp/hyperparameters.h engine/gp/limbo_multi_gp.h engine/gp/multi_output_gp.h
    engine/gp/process_settings.h engine/gp/query_plan.h engine/single_threaded_blas.h)
set(rollout_headers
    engine/candidate_group.h engine/rollout/block_functions.h engine/rollout/block_rollouts.h
    engine/rollout/dynamics_prior.h engine/rollout/evaluator.h
    engine/rollout/evaluator_statistics.h engine/rollout/lost_causes.h
    engine/rollout/model_evaluator.h engine/rollout/policy.h engine/rollout/prior_pool.h
    engine/rollout/reward.h engine/rollout/rollout_parts.h
    engine/rollout/task.h engine/rollout/trajectories.h)
set(pilco_headers engine/pilco/expected_return.h engine/pilco/gradient_search.h)
set(search_headers
    engine/search/bipop.h engine/search/bounds.h engine/search/cma_es.h
    engine/search/diagonal_covariance.h engine/search/fitness_history.h
    engine/search/full_covariance.h engine/search/learning_rate.h engine/search/limited_memory.h
    engine/search/minimise.h engine/search/policy_search.h engine/search/strategy_parameters.h)
set(learner_headers
    engine/learner/algorithm.h engine/learner/directory_lock.h engine/learner/learner.h
    engine/learner/learnt_policy.h engine/learner/platform.h engine/learner/rollout_helpers.h
    engine/learner/run_directory.h engine/learner/saved_policy.h)
set(tasks_headers tasks/mujoco_system.h tasks/registry.h tasks/solved.h)

include(GNUInstallDirs)
set(libraries kernels gp rollout pilco search learner tasks)
foreach(library ${libraries})
  list(TRANSFORM ${library}_headers PREPEND ${PROJECT_SOURCE_DIR}/ REGEX "^[a-z]")
  target_sources(downpour_${library} PUBLIC FILE_SET HEADERS BASE_DIRS ${PROJECT_SOURCE_DIR}
                 FILES ${${library}_headers})
  target_compile_features(downpour_${library} PUBLIC cxx_std_20)
endforeach()
target_sources(downpour_c PUBLIC FILE_SET HEADERS BASE_DIRS ${PROJECT_SOURCE_DIR}/tools/c
               FILES ${PROJECT_SOURCE_DIR}/tools/c/downpour.h)
foreach(library ${libraries} engine c)
  add_library(Downpour::${library} ALIAS downpour_${library})
  set_target_properties(downpour_${library} PROPERTIES EXPORT_NAME ${library})
endforeach()

# Reference pages of these headers (docs/Doxyfile).
find_program(DOXYGEN doxygen)
mark_as_advanced(DOXYGEN)
if(DOXYGEN)
  set(headers tools/c/downpour.h)
  foreach(library ${libraries})
    list(APPEND headers ${${library}_headers})
  endforeach()
  list(JOIN headers " " headers)
  file(MAKE_DIRECTORY ${PROJECT_BINARY_DIR}/docs)
  set(docs_command ${CMAKE_COMMAND} -E env DOWNPOUR_HEADERS=${headers}
      DOWNPOUR_VERSION=${PROJECT_VERSION} DOWNPOUR_DOCS=${PROJECT_BINARY_DIR}/docs
      ${DOXYGEN} docs/Doxyfile)
  add_custom_target(downpour_docs COMMAND ${docs_command} WORKING_DIRECTORY ${PROJECT_SOURCE_DIR}
                    COMMENT "Reference pages in ${PROJECT_BINARY_DIR}/docs/html" VERBATIM)
endif()

if(DOWNPOUR_INSTALL)
  set(libraries_installed ${libraries})
  list(TRANSFORM libraries_installed PREPEND downpour_)
  # Headers name each other from the root of the sources, so that this root is a folder of ours.
  install(TARGETS ${libraries_installed} downpour_engine EXPORT DownpourTargets
          FILE_SET HEADERS DESTINATION ${CMAKE_INSTALL_INCLUDEDIR}/downpour)
  install(TARGETS downpour_c EXPORT DownpourTargets FILE_SET HEADERS)
  include(CMakePackageConfigHelpers)
  set(config_dir ${CMAKE_INSTALL_LIBDIR}/cmake/Downpour)
  install(EXPORT DownpourTargets NAMESPACE Downpour:: DESTINATION ${config_dir})
  configure_package_config_file(tools/cmake/DownpourConfig.cmake.in
                                ${PROJECT_BINARY_DIR}/DownpourConfig.cmake
                                INSTALL_DESTINATION ${config_dir})
  # Before 1.0 a minor version may change the C++ interface.
  write_basic_package_version_file(${PROJECT_BINARY_DIR}/DownpourConfigVersion.cmake
                                   COMPATIBILITY SameMinorVersion)
  install(FILES ${PROJECT_BINARY_DIR}/DownpourConfig.cmake
          ${PROJECT_BINARY_DIR}/DownpourConfigVersion.cmake
          ${PROJECT_SOURCE_DIR}/tools/cmake/DownpourDependencies.cmake DESTINATION ${config_dir})
  # For builds without CMake; of the C interface, as that alone is one file to link.
  file(RELATIVE_PATH DOWNPOUR_INCLUDES_FROM_PKGCONFIG /${CMAKE_INSTALL_LIBDIR}/pkgconfig
       /${CMAKE_INSTALL_INCLUDEDIR})
  configure_file(tools/cmake/downpour.pc.in ${PROJECT_BINARY_DIR}/downpour.pc @ONLY)
  install(FILES ${PROJECT_BINARY_DIR}/downpour.pc DESTINATION ${CMAKE_INSTALL_LIBDIR}/pkgconfig)
endif()
