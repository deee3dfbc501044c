/* SPDX-License-Identifier: Apache-2.0 */
#ifndef DOWNPOUR_H_
#define DOWNPOUR_H_

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/*
 * The C interface of Downpour: Gaussian processes, rollouts of policies on them in large batches,
 * CMA-ES, and learning from scratch. Plain types only, so that other languages can call it: int is
 * 32 bits, arrays are contiguous float64, row-major where nothing else is said, owned by the caller
 * and read or written during the call alone; arrays that are written alias nothing.
 *
 * Every function that can fail returns a status, DOWNPOUR_OK = 0; of another one
 * downpour_last_error() tells the reason, outputs are unspecified and objects are as before. No
 * exception leaves the library. NULL is refused wherever it is not said to be allowed.
 *
 * Objects are made by *_create, *_fit and *_learn and released by *_destroy (NULL allowed). A GP,
 * an evaluator and a policy never change: any number of threads may use one. A CMA-ES serves one
 * thread at a time. Results depend on the arguments alone, never on `threads` (0: all cores).
 *
 * Options: structures whose first member is their size, as the caller was compiled with it, set by
 * *_options_init together with the defaults. Later versions add members at the end and keep what is
 * here as long as DOWNPOUR_ABI_VERSION, the number in the library's name, is the same.
 *
 * OpenBLAS reads OPENBLAS_CORETYPE when it is loaded: see downpour_platform_warning.
 */

#define DOWNPOUR_ABI_VERSION 1

/* Status codes. */
enum {
  DOWNPOUR_OK = 0,
  DOWNPOUR_INVALID_INPUT = 1,   /* an argument is wrong; the message says which and how */
  DOWNPOUR_CALLBACK_FAILED = 2, /* a callback returned another number than 0 */
  DOWNPOUR_OUT_OF_MEMORY = 3,
  DOWNPOUR_INTERNAL_ERROR = 4 /* a defect of the library */
};

/* What answers queries. */
enum {
  DOWNPOUR_BACKEND_FUSED = 0, /* own kernels, within the tolerances */
  DOWNPOUR_BACKEND_BLAS = 1   /* OpenBLAS, exact float64 */
};

typedef struct downpour_gp downpour_gp;
typedef struct downpour_evaluator downpour_evaluator;
typedef struct downpour_cmaes downpour_cmaes;
typedef struct downpour_policy downpour_policy;

/* --- The library. Strings live as long as it does; these cannot fail. --- */

/* DOWNPOUR_ABI_VERSION of the library; programs compare it with that of their header. */
int downpour_abi_version(void);
/* As "0.1.0". */
const char* downpour_version(void);
/* One line: why the last failure on this thread failed; "" before any. Valid until the next call on
 * this thread that fails. */
const char* downpour_last_error(void);
/* The instruction set that the kernels run on, e.g. "AVX3". */
const char* downpour_simd_target(void);
/* The kernels that OpenBLAS runs, e.g. "SkylakeX". */
const char* downpour_blas_core(void);
/* One line that says what slows this process down and what mends it; "" if nothing. */
const char* downpour_platform_warning(void);

/* --- Gaussian processes: E outputs on D shared inputs, squared-exponential covariances. ---
 * k(x, x') = signal_std^2 exp(-1/2 sum_d ((x_d - x'_d) / lengthscale_d)^2) for each output, prior
 * mean zero, observations with noise of standard deviation noise_std. */

typedef struct downpour_gp_options {
  size_t size;
  /* Largest error of a variance, |error| / (variance + noise variance), and of a mean, |error| /
   * sqrt(variance + noise variance), on inputs like the data; in [0, 1], 0: exact float64. */
  double variance_tolerance; /* 0.02 */
  double mean_tolerance;     /* 0.05 */
  int backend;               /* DOWNPOUR_BACKEND_FUSED */
  int threads;               /* 1; that prepare outputs side by side */
  uint64_t seed;             /* 0; of the starts of downpour_gp_fit */
} downpour_gp_options;

int downpour_gp_options_init(downpour_gp_options* options);

/* A GP with the hyper-parameters of highest likelihood. inputs n x D, targets n x E, finite.
 * options may be NULL: the defaults. */
int downpour_gp_fit(const double* inputs, const double* targets, int n, int n_inputs, int n_outputs,
                    const downpour_gp_options* options, downpour_gp** gp);

/* One with given ones: lengthscales E x D, signal_std (E), noise_std (E), in [1e-150, 1e150].
 * Jitter is added where the covariance matrix has no Cholesky factor (downpour_gp_plan tells);
 * DOWNPOUR_INVALID_INPUT if signal_std^2 is not enough. */
int downpour_gp_create(const double* inputs, const double* targets, int n, int n_inputs,
                       int n_outputs, const double* lengthscales, const double* signal_std,
                       const double* noise_std, const downpour_gp_options* options,
                       downpour_gp** gp);

/* Evaluators that were made with it keep what they need. */
void downpour_gp_destroy(downpour_gp* gp);

/* Each of n (points), n_inputs, n_outputs may be NULL. */
int downpour_gp_sizes(const downpour_gp* gp, int* n, int* n_inputs, int* n_outputs);

/* Means (n_queries x E) and variances (n_queries x E; NULL: not wanted, and faster) at queries
 * (n_queries x D). with_noise != 0 adds the noise variance, as of an observation. A row that is not
 * finite gives NaN in its answers alone. A row's bits depend on that row alone (with OpenBLAS on
 * its place, too). */
int downpour_gp_predict(const downpour_gp* gp, const double* queries, int64_t n_queries,
                        int with_noise, int threads, double* means, double* variances);

/* lengthscales E x D, signal_std (E), noise_std (E); each may be NULL. */
int downpour_gp_hyperparameters(const downpour_gp* gp, double* lengthscales, double* signal_std,
                                double* noise_std);

/* Log marginal likelihood of each output (E). */
int downpour_gp_log_likelihood(const downpour_gp* gp, double* log_likelihood);

/* How one output's queries are answered. The caller sets `size`. */
typedef struct downpour_plan {
  size_t size;
  int backend;           /* DOWNPOUR_BACKEND_* */
  int single_precision;  /* 1: float32 */
  int points;            /* of the factor: fewer than the data's if it is compressed */
  double tau;            /* of the compression, 0: none */
  double variance_error; /* worst on probes, in the units of the tolerances */
  double mean_error;
  double relative_cost; /* modelled, exact float64 = 1 */
  double jitter;        /* added to the diagonal of the covariance matrix; mostly 0 */
} downpour_plan;

/* output in [0, E). */
int downpour_gp_plan(const downpour_gp* gp, int output, downpour_plan* plan);

/* --- Rollouts. The model's inputs are (features, action), its outputs the differences of the state
 * over a step: D = F + A. Lanes are rollouts; blocks are COLUMN-major: variable v of lane l is at
 * [v * lanes + l]. Callbacks are called once a time step for all lanes together, one at a time, on
 * the thread that calls; what they are given is valid for the call. They return 0, or anything else
 * to end the evaluation with DOWNPOUR_CALLBACK_FAILED; numbers that they write must be finite. ---
 */

/* Actions (lanes x A), which are then clipped to the limits, from parameters (lanes x P) and
 * features (lanes x F). step counts from 0. */
typedef int (*downpour_policy_function)(void* user_data, int step, int lanes,
                                        const double* parameters, const double* features,
                                        double* actions);

/* Rewards (lanes) of the states (lanes x E) to which the actions (lanes x A) of `step` led. */
typedef int (*downpour_reward_function)(void* user_data, int step, int lanes, const double* states,
                                        const double* actions, double* rewards);

typedef struct downpour_evaluator_options {
  size_t size;
  /* A built-in task, e.g. "cartpole": its features, reward, start, limits and horizon. NULL, the
   * default: none; features are the states, and reward, start and horizon must be given. */
  const char* task;
  const char* preset; /* "paper" or "original-code"; NULL: the task's own */
  /* "nn", "linear", "gp" or "dmp" (docs/policies.md); NULL: "nn". */
  const char* policy;
  int hidden_units;                         /* 10; nn: of its one hidden layer */
  int policy_points;                        /* 0: the task's; of gp and dmp */
  downpour_policy_function policy_function; /* NULL; if set, in place of `policy` */
  downpour_reward_function reward_function; /* NULL: the task's reward */
  void* user_data;                          /* NULL; handed to both */
  int horizon;                              /* steps; 0: the task's */
  const double* start;                      /* (E); NULL: the task's */
  const double* start_std;                  /* (E); NULL: the task's, or 0 without a task */
  const double* action_limits;              /* (A) > 0; NULL: the task's, or none without a task */
  int rollouts;                             /* 1; of each parameter vector */
  int threads;                              /* 1 */
  int use_variance;                         /* 1; 0: no sampling, means only */
  int predict_noise;                        /* 1: samples have the noise variance, too */
  double sample_clamp; /* 0; > 0: samples within that many standard deviations */
} downpour_evaluator_options;

int downpour_evaluator_options_init(downpour_evaluator_options* options);

/* Copies what options point to, but for user_data. */
int downpour_evaluator_create(const downpour_gp* gp, const downpour_evaluator_options* options,
                              downpour_evaluator** evaluator);

void downpour_evaluator_destroy(downpour_evaluator* evaluator);

typedef struct downpour_evaluator_size {
  size_t size; /* set by the caller */
  int n_states, n_features, n_actions, horizon, rollouts;
  int n_parameters;       /* of a built-in policy; 0 with policy_function */
  double parameter_bound; /* the learner searches parameters in +- this */
  double diverged_return; /* of a rollout that left +-30000 or had no reward within +-1e6 */
} downpour_evaluator_size;

int downpour_evaluator_sizes(const downpour_evaluator* evaluator, downpour_evaluator_size* sizes);

/* Sums of rewards (n x rollouts) of parameter vectors (n x n_parameters). Rollout r of a seed meets
 * the same random numbers whatever the parameters, so that vectors compare on equal terms. */
int downpour_evaluator_evaluate(const downpour_evaluator* evaluator, const double* parameters,
                                int64_t n, int n_parameters, uint64_t seed, double* returns);

/* The rollouts of one parameter vector as they go there: states (rollouts x (H + 1) x E), actions
 * (rollouts x H x A), rewards (rollouts x H); NaN from where one has diverged. */
int downpour_evaluator_rollout(const downpour_evaluator* evaluator, const double* parameters,
                               int n_parameters, uint64_t seed, double* states, double* actions,
                               double* rewards);

/* --- CMA-ES with restarts, ask and tell: MINIMISES. --- */

enum {
  DOWNPOUR_RESTARTS_BIPOP = 0,
  DOWNPOUR_RESTARTS_SMALL = 1,
  DOWNPOUR_RESTARTS_IPOP = 2,
  DOWNPOUR_RESTARTS_NONE = 3
};

typedef struct downpour_cmaes_options {
  size_t size;
  /* (P) both or neither (NULL, the default): candidates stay within, and so must the start.
   * Restarts begin at points drawn between them, or within sigma of the start. */
  const double* lower;
  const double* upper;
  int restarts;        /* DOWNPOUR_RESTARTS_BIPOP */
  int population;      /* of the first run; 0: 4 + floor(3 ln P), else >= 2 */
  int64_t evaluations; /* 1000000; the most that it may take */
  double target;       /* -infinity; a lower cost ends the search */
  uint64_t seed;       /* 0 */
} downpour_cmaes_options;

int downpour_cmaes_options_init(downpour_cmaes_options* options);

/* start (P), finite; sigma > 0. options may be NULL. */
int downpour_cmaes_create(const double* start, int n_parameters, double sigma,
                          const downpour_cmaes_options* options, downpour_cmaes** cmaes);

void downpour_cmaes_destroy(downpour_cmaes* cmaes);

/* Candidates of the next ask: restarts change it. */
int downpour_cmaes_population(const downpour_cmaes* cmaes, int* population);

/* Writes a population (population x P), the same until it is told; `population` must be that of
 * downpour_cmaes_population. DOWNPOUR_INVALID_INPUT once the search has stopped. */
int downpour_cmaes_ask(downpour_cmaes* cmaes, int population, double* candidates);

/* Their costs (population); NaN counts as +infinity. Once an ask. */
int downpour_cmaes_tell(downpour_cmaes* cmaes, int population, const double* costs);

/* *stop: "" while the search should go on, else "target", "budget" or, without restarts, what ended
 * the run. Valid until the next tell. */
int downpour_cmaes_stop(const downpour_cmaes* cmaes, const char** stop);

/* The candidate (P) of the lowest cost so far, its cost, and the evaluations; each may be NULL.
 * DOWNPOUR_INVALID_INPUT before the first tell. */
int downpour_cmaes_best(const downpour_cmaes* cmaes, double* candidate, double* cost,
                        int64_t* evaluations);

/* --- Learning: the whole of Black-DROPS on the simulator of a task, as the command's `learn`. ---
 */

/* What became of an episode. */
typedef struct downpour_episode {
  size_t size;
  int episode; /* from 1 */
  int random;  /* 1: random actions, no model; what is said of model and search is then 0 */
  int solved;  /* 1: the episode solved the task */
  int points;  /* that the model was learnt from */
  double interaction_seconds; /* on the simulator, so far */
  double real_return;
  double predicted_return; /* by the model; NaN if random */
  int64_t evaluations;     /* rollouts on the model */
  int64_t gp_queries;
  double model_seconds; /* that the computer took */
  double search_seconds;
} downpour_episode;

/* Called after each episode, on the thread that calls; what it is given is valid for the call.
 * Returns 0, or anything else to end the learning with DOWNPOUR_CALLBACK_FAILED. */
typedef int (*downpour_episode_function)(void* user_data, const downpour_episode* episode);

typedef struct downpour_learn_options {
  size_t size;
  int episodes;  /* 15; random ones (the first) included, in [2, 1000] */
  int threads;   /* 1 */
  uint64_t seed; /* 0; below 2^63 */
  /* Other settings as the command's --set has them, e.g. "search.evaluations=50000"; the names are
   * those of the config.toml of its runs. */
  const char* const* settings;                /* NULL */
  int n_settings;                             /* 0 */
  downpour_episode_function episode_function; /* NULL */
  void* user_data;                            /* NULL; handed to it */
} downpour_learn_options;

int downpour_learn_options_init(downpour_learn_options* options);

/* The policy of the last episode of learning `task`, a built-in one or the path of a TOML file.
 * *policy is NULL if settings end the learning once the task is solved and the random episode did.
 * options may be NULL. Takes seconds to minutes; bits are those of the command and of Python. */
int downpour_learn(const char* task, const downpour_learn_options* options,
                   downpour_policy** policy);

void downpour_policy_destroy(downpour_policy* policy);

/* Each of n_states (E), n_actions (A), n_parameters (P) may be NULL. */
int downpour_policy_sizes(const downpour_policy* policy, int* n_states, int* n_actions,
                          int* n_parameters);

/* (P), as downpour_evaluator_evaluate takes them for the same task and policy. */
int downpour_policy_parameters(const downpour_policy* policy, double* parameters);

/* The action (A) within the task's limits, for a state (E), finite, in the task's units. step
 * counts from 0; the policies that depend on it say so (docs/policies.md). */
int downpour_policy_act(const downpour_policy* policy, int step, const double* state,
                        double* action);

#ifdef __cplusplus
}
#endif

#endif /* DOWNPOUR_H_ */
