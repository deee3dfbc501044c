# SPDX-License-Identifier: Apache-2.0
"""Bad input gives an exception that names the argument and what was expected; all goes on after."""
import unittest

import downpour as dp
import numpy as np
from models import cartpole_model, cartpole_reward, network, smooth_data, thetas

X, Y, HYPER = smooth_data(n=20)
GP = dp.GaussianProcess(X, Y, *HYPER)


def with_nan(array):
    array = np.array(array, dtype=float)
    array.flat[4] = np.nan
    return array


def gp(**changes):
    arguments = dict(X=X, Y=Y, lengthscales=HYPER[0], signal_std=HYPER[1], noise_std=HYPER[2])
    return dp.GaussianProcess(**{**arguments, **changes})


def evaluator(**changes):
    return dp.Evaluator(**{"model": cartpole_model(), "task": "cartpole", **changes})


def own(**changes):
    arguments = dict(model=GP, policy=lambda theta, x, t: x[:, :1], start=[0, 0],
                     reward=lambda s, a, t: s[:, 0])
    return dp.Evaluator(**{**arguments, **changes})


def evaluate(**changes):
    return evaluator(**changes).evaluate(thetas(3))


def cmaes(**changes):
    return dp.CMAES(**{"x0": [0, 0], "sigma0": 1, **changes})


def tell(x=lambda x: x, f=lambda f: f):
    search = cmaes()
    asked = search.ask()
    search.tell(x(asked), f(np.zeros(len(asked))))


ENV = dp.make("pendulum")


def step(u):
    ENV.reset(seed=0)
    return ENV.step(u)


# (what is called, the exception, what its message must say)
TABLE = [
    # Gaussian processes: dtypes, shapes, numbers.
    (lambda: gp(X=X.astype(complex)), TypeError, "X: dtype complex128, must convert to float64"),
    (lambda: gp(X=X.astype(object)), TypeError, "X: dtype object"),
    (lambda: gp(X=X.astype(np.longdouble)), TypeError, "X: dtype float128"),
    (lambda: gp(X=X.astype(str)), TypeError, "X: dtype <U"),
    (lambda: gp(X=None), TypeError, "X: dtype object"),
    (lambda: gp(X=[[1, 2], [3]]), TypeError, "X: list, must be an array of numbers (n, D)"),
    (lambda: gp(X=X[0]), ValueError, "X: shape (3,), must be (n, D)"),
    (lambda: gp(X=X[:0]), ValueError, "X: empty, must have n, D >= 1"),
    (lambda: gp(X=with_nan(X)), ValueError, "X: nan at [1, 1], must be finite"),
    (lambda: gp(X=X * np.inf), ValueError, "X: "),
    (lambda: gp(Y=Y[:, 0]), ValueError, "Y: shape (20,), must be (n, E) with n = 20"),
    (lambda: gp(Y=Y[1:]), ValueError, "Y: shape (19, 2), must be (n, E) with n = 20"),
    (lambda: gp(Y=Y[:, :0]), ValueError, "Y: empty"),
    (lambda: gp(Y=with_nan(Y)), ValueError, "Y: nan at [2, 0], must be finite"),
    (lambda: gp(lengthscales=HYPER[0][0]), ValueError,
     "lengthscales: shape (3,), must be (E, D) with E = 2, D = 3"),
    (lambda: gp(lengthscales=-HYPER[0]), ValueError, "lengthscales: -"),
    (lambda: gp(signal_std=[1, 0]), ValueError, "signal_std: 0.0"),
    (lambda: gp(signal_std=1.0), ValueError, "signal_std: shape (), must be (E,) with E = 2"),
    (lambda: gp(noise_std=[0.1, np.nan]), ValueError, "noise_std: nan at [1]"),
    (lambda: gp(noise_std=[0.1, 0]), ValueError, "noise_std: 0.0"),
    (lambda: gp(lengthscales=HYPER[0] * 1e-149, X=X * 1e200), ValueError, "not finite"),
    (lambda: gp(tolerance=-0.1), ValueError, "tolerance = -0.1: must be in [0, 1]"),
    (lambda: gp(tolerance="0.1"), TypeError, "tolerance = '0.1': must be a number"),
    (lambda: gp(backend="cuda"), ValueError,
     "backend = 'cuda': must be one of 'auto', 'fused', 'blas'"),
    (lambda: gp(threads=-1), ValueError, "threads = -1: must be in [0, 4096]"),
    (lambda: gp(threads=1.5), TypeError, "threads = 1.5: must be an integer"),
    (lambda: dp.GaussianProcess.fit(X, Y, seed=-1), ValueError, "seed = -1: must be in"),
    (lambda: dp.GaussianProcess.fit(X, Y, seed="a"), TypeError, "seed = 'a': must be an integer"),
    (lambda: dp.GaussianProcess.fit(X, Y * 1e200), ValueError, ""),
    (lambda: GP.predict(X[:, :2]), ValueError, "Xq: shape (20, 2), must be (B, D) with D = 3"),
    (lambda: GP.predict(X[0]), ValueError, "Xq: shape (3,)"),
    (lambda: GP.predict(with_nan(X)), ValueError, "Xq: nan at [1, 1], must be finite"),
    # Calls that do not fit.
    (lambda: dp.GaussianProcess(X, Y), TypeError,
     "GaussianProcess: argument lengthscales is missing; the arguments are X, Y, lengthscales, "
     "signal_std, noise_std, tolerance, backend, threads"),
    (lambda: gp(noise=1), TypeError, "GaussianProcess: unknown argument noise; the arguments are"),
    (lambda: dp.GaussianProcess.fit(X), TypeError, "GaussianProcess.fit: argument Y is missing"),
    (lambda: GP.predict(X, True, 2, 3), TypeError, "GaussianProcess.predict: 4 positional"),
    (lambda: GP.predict(X, Xq=X), TypeError, "GaussianProcess.predict: argument Xq is given twice"),
    (lambda: GP.predict(X, noise=True), TypeError,
     "GaussianProcess.predict: unknown argument noise; the arguments are Xq, include_noise"),
    (lambda: dp.GaussianProcess.predict(3, X), TypeError, "must be called on an object"),
    (lambda: GP.predict(X, include_noise="no"), TypeError,
     "include_noise = 'no': must be True or False"),
    (lambda: evaluator(use_variance=None), TypeError, "use_variance = None: must be True or False"),
    (lambda: evaluator(hidden=3), TypeError,
     "Evaluator: unknown argument hidden; the arguments are model, task, features, policy, reward, "
     "rollouts, horizon, start, action_limit, start_std, hidden_units, activation, points, "
     "use_variance, predict_noise, sample_clamp, preset, threads"),
    (lambda: dp.Evaluator(), TypeError, "Evaluator: argument model is missing"),
    (lambda: evaluator().evaluate(), TypeError, "Evaluator.evaluate: argument thetas is missing"),
    (lambda: evaluator().rollout(thetas(1)[0], sed=1), TypeError, "Evaluator.rollout: unknown"),
    (lambda: cmaes(popsize=5), TypeError, "CMAES: unknown argument popsize; the arguments are x0"),
    (lambda: cmaes().ask(3), TypeError, "CMAES.ask: 1 positional arguments; there are none"),
    (lambda: cmaes().tell(X), TypeError, "CMAES.tell: argument f is missing"),
    (lambda: ENV.step(), TypeError, "Env.step: argument u is missing; the arguments are u"),
    (lambda: dp.make(), TypeError, "make: argument task is missing"),
    (lambda: dp.learn(), TypeError, "learn: argument task is missing; the arguments are task"),
    # Evaluators.
    (lambda: evaluator(model=GP), ValueError, "the model has 2 outputs"),
    (lambda: evaluator(model=None), TypeError, "model = None: must be a GaussianProcess"),
    (lambda: evaluator(task="cart"), ValueError, "task: unknown task 'cart'; allowed: pendulum"),
    (lambda: evaluator(task=3), TypeError, "task = 3: must be a string"),
    (lambda: evaluator(preset="x"), ValueError, "preset"),
    (lambda: evaluator(features=[0]), ValueError, "features: must be None with a task"),
    (lambda: evaluator(policy="rbf"), ValueError, "policy = 'rbf': must be one of 'nn'"),
    (lambda: evaluator(policy=None), ValueError, "policy = None: must be one of 'nn'"),
    (lambda: evaluator(reward=3), TypeError, "reward = 3: must be None or a callable"),
    (lambda: evaluator(rollouts=0), ValueError, "rollouts = 0: must be in [1, 1000000]"),
    (lambda: evaluator(horizon=0), ValueError, "horizon = 0: must be in [1, 1000000]"),
    (lambda: evaluator(start=[0, 0]), ValueError, "start: shape (2,), must be (E,) with E = 4"),
    (lambda: evaluator(start=[0, 0, 0, 1e6]), ValueError, "start: must be within"),
    (lambda: evaluator(start_std=[0, 0, 0, -1]), ValueError, "start_std: must be >= 0"),
    (lambda: evaluator(action_limit=-1), ValueError, "action_limit: must be > 0"),
    (lambda: evaluator(action_limit=[1, 2]), ValueError, "action_limit: shape (2,)"),
    (lambda: evaluator(hidden_units=0), TypeError, "hidden_units = 0: must be a list"),
    (lambda: evaluator(hidden_units=[0]), ValueError, "hidden_units = 0: must be in [1, 256]"),
    (lambda: evaluator(activation="elu"), ValueError, "activation = 'elu': must be one of 'tanh'"),
    (lambda: evaluator(sample_clamp=-1), ValueError, "sample_clamp: must be >= 0"),
    (lambda: evaluator().evaluate(thetas(3)[:, :70]), ValueError,
     "thetas: shape (3, 70), must be (N, P) with P = 71"),
    (lambda: evaluator().evaluate(thetas(1)[0]), ValueError, "thetas: shape (71,)"),
    (lambda: evaluator().evaluate(with_nan(thetas(3))), ValueError, "thetas: nan at [0, 4]"),
    (lambda: evaluator().evaluate(thetas(3) * 1j), TypeError, "thetas: dtype complex128"),
    (lambda: evaluator().evaluate(thetas(3), seed=2**64), ValueError, "seed = "),
    (lambda: evaluator().rollout(thetas(3)), ValueError, "theta: shape (3, 71), must be (P,)"),
    (lambda: own(start=None), TypeError, "start: must be given without a task, (E,) with E = 2"),
    (lambda: own(reward=None), TypeError, "reward: must be a callable without a task"),
    (lambda: own(features=3), TypeError, "features = 3: must be None, a list or a callable"),
    (lambda: own(features=[0, 1, 0]), ValueError, "features: 3 features leave 0"),
    (lambda: own(features=[2]), ValueError, "features[0] = 2: must be in [0, 1]"),
    (lambda: own(features=[("tan", 0)]), ValueError, "features[0][0] = 'tan': must be one of"),
    (lambda: own(features=[("sin", 0, 1)]), ValueError, "features[0]: must be i"),
    (lambda: own(features=lambda s: s), TypeError, "action_limit: must be given with a callable"),
    (lambda: own(policy="linear"), TypeError, "action_limit: must be given with a built-in policy"),
    # Callables: results of another shape, dtype or value.
    (lambda: evaluate(policy=lambda p, x, t: np.zeros((len(x), 2))), ValueError,
     "result of policy: shape (3, 2), must be (lanes, A) with lanes = 3, A = 1"),
    (lambda: evaluate(policy=lambda p, x, t: np.zeros(len(x))), ValueError,
     "result of policy: shape (3,)"),
    (lambda: evaluate(policy=lambda p, x, t: None), TypeError, "result of policy: dtype object"),
    (lambda: evaluate(policy=lambda p, x, t: np.full((len(x), 1), np.nan)), ValueError,
     "policy: gave nan at step 0, lane 0, column 0: must be finite"),
    (lambda: evaluate(policy=lambda p, x, t: np.full((len(x), 1), 1j)), TypeError,
     "result of policy: dtype complex128"),
    (lambda: evaluate(reward=lambda s, a, t: s), ValueError,
     "result of reward: shape (3, 4), must be (lanes,) with lanes = 3"),
    (lambda: evaluate(reward=lambda s, a, t: 1.0), ValueError, "result of reward: shape ()"),
    (lambda: evaluate(reward=lambda s, a, t: s[:, 0] + np.nan), ValueError,
     "reward: gave nan at step 0, lane 0: must be finite"),
    (lambda: own(features=lambda s: s[:, :1], action_limit=1).evaluate([[0.0]]), ValueError,
     "result of features: shape (1, 1), must be (lanes, F) with lanes = 1, F = 2"),
    (lambda: evaluate(policy=lambda: 0), TypeError, "takes 0 positional arguments"),
    (lambda: evaluate(reward=lambda s, a, t: {}["key"]), KeyError, "key"),
    # CMA-ES.
    (lambda: cmaes(x0=[]), ValueError, "x0: empty"),
    (lambda: cmaes(x0=[0, np.inf]), ValueError, "x0: inf at [1]"),
    (lambda: cmaes(sigma0=0), ValueError, "sigma0: must be > 0"),
    (lambda: cmaes(sigma0=np.nan), ValueError, "sigma0 = nan: must be finite"),
    (lambda: cmaes(lower=-1), TypeError, "lower, upper: must both be given"),
    (lambda: cmaes(lower=1, upper=2), ValueError, "x0[0]: must be between"),
    (lambda: cmaes(lower=[-1, 1], upper=[1, 1]), ValueError, "lower[1]: must be below upper[1]"),
    (lambda: cmaes(lower=[-1] * 3, upper=1), ValueError, "lower: shape (3,), must be (P,)"),
    (lambda: cmaes(restarts="pop"), ValueError, "restarts = 'pop': must be one of 'bipop'"),
    (lambda: cmaes(population=1), ValueError, "population = 1: must be 0 or at least 2"),
    (lambda: cmaes(max_evaluations=0), ValueError, "max_evaluations = 0: must be in"),
    (lambda: tell(x=lambda x: x + 1), ValueError, "X: not what ask() gave"),
    (lambda: tell(x=lambda x: x[:3]), ValueError, "X: shape (3, 2), must be (lambda, P)"),
    (lambda: tell(f=lambda f: f[:3]), ValueError, "f: shape (3,), must be (lambda,)"),
    # Learning and simulators.
    (lambda: dp.learn("cart"), ValueError, "cart"),
    (lambda: dp.learn("pendulum", episodes=1), ValueError, "learn.episodes = 1: must be"),
    (lambda: dp.learn("pendulum", callback=3), TypeError, "callback = 3: must be None or a"),
    (lambda: dp.learn("pendulum", settings=[]), TypeError, "settings = []: must be a dict"),
    (lambda: dp.learn("pendulum", settings={"search.evals": 5}), ValueError,
     "settings: unknown key search.evals"),
    (lambda: dp.learn("pendulum", settings={"search.evaluations": -5}), ValueError,
     "settings: search.evaluations = -5: must be an integer in [100, "),
    (lambda: dp.learn("pendulum", settings={"output.json": True}), ValueError, "output.json"),
    (lambda: dp.make("cart"), ValueError, "unknown task 'cart'"),
    (lambda: step([1, 2]), ValueError, "u: shape (2,), must be (A,) with A = 1"),
    (lambda: step([np.nan]), ValueError, "u: nan at [0]"),
    (lambda: dp.make("pendulum").step([0]), RuntimeError, "call reset first"),
    (lambda: ENV.features([1, 2, 3]), ValueError, "states: shape (3,), must be (E,) with E = 2"),
]


class ErrorsTest(unittest.TestCase):
    def test_the_exception_names_the_argument_and_what_was_expected(self):
        for i, (call, exception, message) in enumerate(TABLE):
            with self.subTest(row=i, message=message):
                with self.assertRaises(exception) as caught:
                    call()
                self.assertIs(type(caught.exception), exception)
                self.assertIn(message, str(caught.exception))
                self.assertNotIn("\n", str(caught.exception))

    def test_what_a_callable_raises_is_raised_itself(self):
        error = LookupError("mine")

        def fails(*arguments):
            raise error
        for arguments in ({"policy": fails}, {"reward": fails}):
            with self.assertRaises(LookupError) as caught:
                evaluate(**arguments)
            self.assertIs(caught.exception, error)
        with self.assertRaises(LookupError) as caught:
            dp.learn("pendulum", episodes=2, settings={"search.evaluations": 600}, callback=fails)
        self.assertIs(caught.exception, error)

    def test_an_evaluator_goes_on_after_an_error(self):
        trouble = [True]

        def reward(states, actions, t):
            if trouble and t == 20:
                raise RuntimeError("trouble")
            return cartpole_reward(states, actions, t)
        tried = evaluator(policy=network, reward=reward)
        for _ in range(3):
            self.assertRaises(RuntimeError, tried.evaluate, thetas(100))
        trouble.clear()
        np.testing.assert_allclose(tried.evaluate(thetas(100)), evaluator().evaluate(thetas(100)),
                                   atol=1e-6)

    def test_a_search_that_has_stopped_says_so(self):
        search = cmaes(max_evaluations=10)
        search.tell(search.ask(), np.zeros(search.population))
        self.assertEqual(search.stop(), {"budget": search.result.evaluations})
        self.assertRaisesRegex(RuntimeError, "CMAES.ask: the search has stopped", search.ask)


if __name__ == "__main__":
    unittest.main()
