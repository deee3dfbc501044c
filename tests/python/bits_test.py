# SPDX-License-Identifier: Apache-2.0
"""Python's answers are those of C++, bit by bit. Argument: bench/engine_answers, built."""
import pathlib
import subprocess
import sys
import tempfile
import unittest

import downpour as dp
import numpy as np
from models import cartpole_data, thetas

PROGRAM = sys.argv.pop(1)


def engine_answers(x, y, hyper, queries, rows):
    """Means, latent variances (B, E) and returns (N,) by the program."""
    with tempfile.TemporaryDirectory() as directory:
        problem, out = pathlib.Path(directory) / "problem", pathlib.Path(directory) / "answers"
        with open(problem, "wb") as file:
            np.array([*x.shape, y.shape[1], len(queries), *rows.shape], dtype=np.int64).tofile(file)
            for array in (x, y, *hyper, queries, rows):
                np.ascontiguousarray(array, dtype=float).tofile(file)
        subprocess.run([PROGRAM, problem, "--out", out, "--repetitions", "1"], check=True,
                       stdout=subprocess.DEVNULL)
        answers = np.fromfile(out)
    size = len(queries) * y.shape[1]
    return (answers[:size].reshape(len(queries), -1),
            answers[size:2 * size].reshape(len(queries), -1), answers[2 * size:])


class BitsTest(unittest.TestCase):
    def test_queries_and_returns_have_the_bits_of_the_engine(self):
        x, y = cartpole_data()
        fit = dp.GaussianProcess.fit(x, y)
        hyper = fit.lengthscales, fit.signal_std, fit.noise_std
        gp = dp.GaussianProcess(x, y, *hyper, tolerance=0)
        queries = np.concatenate([x, 0.5 * (x + x[::-1]), x + 0.1])
        mean, var, returns = engine_answers(x, y, hyper, queries, thetas(100))
        got_mean, got_var = gp.predict(queries, include_noise=False)
        self.assertTrue(np.array_equal(got_mean, mean))
        self.assertTrue(np.array_equal(got_var, var))
        evaluator = dp.Evaluator(gp, task="cartpole")
        self.assertTrue(np.array_equal(evaluator.evaluate(thetas(100), seed=0)[:, 0], returns))


if __name__ == "__main__":
    unittest.main()
