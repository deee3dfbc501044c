#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""What the Python package costs, each figure one subcommand:

    PYTHONPATH=build/release/python bench/python_bench.py predict    100,000 queries, and by C++
    PYTHONPATH=build/release/python bench/python_bench.py sklearn    20,000 queries, and by scikit-learn
    PYTHONPATH=build/release/python bench/python_bench.py evaluator  4,096 lanes, built in and in NumPy

All on a cart-pole model of n = 320 points of random actions (D = 6, E = 4), hyper-parameters learnt;
best of some repetitions. Run them alone on the machine.
"""
import argparse
import json
import pathlib
import subprocess
import sys
import tempfile
import time

import downpour as dp
import numpy as np

# Data, policy and reward are those of the tests.
sys.path.append(str(pathlib.Path(__file__).resolve().parents[1] / "tests" / "python"))
from models import cartpole_data, cartpole_reward, network  # noqa: E402

PROGRAM = pathlib.Path(dp.__file__).parents[2] / "bin" / "engine_answers"


def queries_like(inputs, count, seed=1):
    """Points between pairs of the inputs."""
    rng = np.random.default_rng(seed)
    a, b = inputs[rng.integers(len(inputs), size=(2, count))]
    share = rng.uniform(size=(count, 1))
    return a + share * (b - a)


def learnt_model(tolerance):
    """The data, a model of them, and the arguments that make it again."""
    x, y = cartpole_data(8)
    fit = dp.GaussianProcess.fit(x, y)
    hyper = fit.lengthscales, fit.signal_std, fit.noise_std
    return x, y, hyper, dp.GaussianProcess(x, y, *hyper, tolerance=tolerance)


def best_seconds(function, repetitions):
    best = np.inf
    for _ in range(repetitions):
        start = time.perf_counter()
        function()
        best = min(best, time.perf_counter() - start)
    return best


def write_problem(path, x, y, hyper, queries, thetas=np.zeros((0, 71))):
    """The file that engine_answers reads."""
    sizes = [*x.shape, y.shape[1], len(queries), *thetas.shape]
    with open(path, "wb") as file:
        np.array(sizes, dtype=np.int64).tofile(file)
        for array in (x, y, *hyper, queries, thetas):
            np.ascontiguousarray(array, dtype=float).tofile(file)


def predict(repetitions):
    x, y, hyper, gp = learnt_model(tolerance=0)
    queries = queries_like(x, 100_000)
    with tempfile.TemporaryDirectory() as directory:
        problem = pathlib.Path(directory) / "problem"
        write_problem(problem, x, y, hyper, queries)
        for threads in (1, 2):
            cpp = json.loads(subprocess.run(
                [PROGRAM, problem, "--threads", str(threads), "--repetitions", str(repetitions)],
                check=True, capture_output=True, text=True).stdout)
            python = best_seconds(lambda: gp.predict(queries, threads=threads), repetitions)
            print(f"{threads} threads: Python {python:.3f} s, C++ {cpp['predict_seconds']:.3f} s, "
                  f"kernel on tiles {cpp['tiles_seconds']:.3f} s; Python / kernel "
                  f"{python / cpp['tiles_seconds']:.3f}")


def sklearn(repetitions):
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import RBF, ConstantKernel
    x, y, hyper, exact = learnt_model(tolerance=0)
    planned = dp.GaussianProcess(x, y, *hyper)
    queries = queries_like(x, 20_000)
    regressors = []
    for e, (lengthscales, signal, noise) in enumerate(zip(*hyper)):
        kernel = ConstantKernel(signal**2, "fixed") * RBF(lengthscales, "fixed")
        regressors.append(GaussianProcessRegressor(kernel, alpha=noise**2, optimizer=None)
                          .fit(x, y[:, e]))
    answers = []

    def theirs():
        answers[:] = [r.predict(queries, return_std=True) for r in regressors]

    theirs_seconds = best_seconds(theirs, repetitions)
    mean, var = exact.predict(queries, include_noise=False)
    their_mean = np.stack([mean for mean, _ in answers], axis=1)
    their_std = np.stack([std for _, std in answers], axis=1)
    scale = np.abs(y).max(axis=0)
    print(f"differences at tolerance 0: mean {np.max(np.abs(mean - their_mean) / scale):.2g} of the "
          f"largest output, std {np.max(np.abs(np.sqrt(var) / their_std - 1)):.2g} relative")
    print(f"scikit-learn {theirs_seconds:.3f} s for mean and std of {len(queries)} queries, 4 outputs")
    for name, gp in (("tolerance 0", exact), ("tolerance 0.02", planned)):
        seconds = best_seconds(lambda: gp.predict(queries, threads=2), 10 * repetitions)
        points = [plan["m"] for plan in gp.plan]
        print(f"{name}, 2 threads: {seconds:.4f} s, {theirs_seconds / seconds:.0f} x; m = {points}")


def evaluator(repetitions):
    for tolerance in (0.02, 0):
        gp = learnt_model(tolerance)[-1]
        built_in = dp.Evaluator(gp, task="cartpole")
        own = dp.Evaluator(gp, task="cartpole", policy=network, reward=cartpole_reward)
        thetas = np.random.default_rng(0).normal(size=(4096, built_in.n_parameters))
        difference = np.max(np.abs(own.evaluate(thetas) - built_in.evaluate(thetas)))
        seconds = [np.inf, np.inf]
        for _ in range(repetitions):
            for i, each in enumerate((built_in, own)):
                seconds[i] = min(seconds[i], best_seconds(lambda: each.evaluate(thetas), 1))
        print(f"tolerance {tolerance}: built in {seconds[0]:.4f} s, callables {seconds[1]:.4f} s, "
              f"ratio {seconds[1] / seconds[0]:.2f}; returns differ by {difference:.1g}")


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("figure", choices=["predict", "sklearn", "evaluator"])
    parser.add_argument("--repetitions", type=int, default=5)
    arguments = parser.parse_args()
    globals()[arguments.figure](arguments.repetitions)


if __name__ == "__main__":
    main()
