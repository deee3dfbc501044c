/* SPDX-License-Identifier: Apache-2.0 */
/* Prints what main.cc prints, by the C interface. */
#include <downpour.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

static void check(int status) {
  if (status == DOWNPOUR_OK) return;
  fprintf(stderr, "%s\n", downpour_last_error());
  exit(1);
}

int main(void) {
  double inputs[50][4], targets[50][2], parameters[200], lengthscales[8], mean[2], variance[2],
      returns[2], candidates[100];
  const double signal[2] = {0.5, 0.5}, noise[2] = {0.05, 0.05}, start[2] = {0.5, 0.5};
  downpour_gp* gp = NULL;
  downpour_evaluator* evaluator = NULL;
  downpour_cmaes* cmaes = NULL;
  downpour_evaluator_options options;
  downpour_evaluator_size sizes;
  int population = 0;
  for (int i = 0; i < 50; ++i) {
    inputs[i][0] = sin(i);
    inputs[i][1] = cos(2.0 * i);
    inputs[i][2] = sin(3.0 * i);
    inputs[i][3] = cos(i);
    targets[i][0] = 0.1 * sin(i);
    targets[i][1] = 0.1 * cos(i);
  }
  for (int i = 0; i < 8; ++i) lengthscales[i] = 1;
  check(downpour_gp_create(&inputs[0][0], &targets[0][0], 50, 4, 2, lengthscales, signal, noise,
                           NULL, &gp));
  check(downpour_gp_predict(gp, inputs[1], 1, 1, 1, mean, variance));

  downpour_evaluator_options_init(&options);
  options.task = "pendulum";
  options.rollouts = 2;
  check(downpour_evaluator_create(gp, &options, &evaluator));
  sizes.size = sizeof sizes;
  check(downpour_evaluator_sizes(evaluator, &sizes));
  for (int i = 0; i < sizes.n_parameters; ++i) parameters[i] = sin(i);
  check(downpour_evaluator_evaluate(evaluator, parameters, 1, sizes.n_parameters, 7, returns));

  check(downpour_cmaes_create(start, 2, 1, NULL, &cmaes));
  check(downpour_cmaes_population(cmaes, &population));
  check(downpour_cmaes_ask(cmaes, population, candidates));
  printf("%s %a %a %a %a %a %a %a\n", downpour_simd_target(), mean[0], mean[1], variance[0],
         variance[1], returns[0], returns[1], candidates[1]);
  downpour_cmaes_destroy(cmaes);
  downpour_evaluator_destroy(evaluator);
  downpour_gp_destroy(gp);
  return 0;
}
