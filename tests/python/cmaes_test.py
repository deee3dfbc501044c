# SPDX-License-Identifier: Apache-2.0
"""downpour.CMAES: ask and tell as users of pycma expect it."""
import unittest

import downpour as dp
import numpy as np


def rosenbrock(x):
    return np.sum(100 * (x[:, 1:] - x[:, :-1]**2)**2 + (1 - x[:, :-1])**2, axis=1)


def rastrigin(x):
    return 10 * x.shape[1] + np.sum(x**2 - 10 * np.cos(2 * np.pi * x), axis=1)


def minimise(function, search):
    asked = []
    while not search.stop():
        x = search.ask()
        asked.append(x)
        search.tell(x, function(x))
    return asked


class CmaEsTest(unittest.TestCase):
    def test_rosenbrock_is_solved_within_the_usual_evaluations(self):
        search = dp.CMAES(np.full(10, -1.0), 0.5, restarts="single", target=1e-8)
        minimise(rosenbrock, search)
        self.assertIn("target", search.stop())
        self.assertLess(search.result.evaluations, 9000)
        np.testing.assert_allclose(search.result.xbest, np.ones(10), atol=1e-3)
        self.assertEqual(rosenbrock(search.best.x[None])[0], search.best.f)

    def test_bipop_solves_rastrigin_and_tells_its_runs(self):
        search = dp.CMAES([3.0] * 5, 2, lower=-5, upper=5, restarts="bipop", seed=1, target=1e-8)
        asked = minimise(rastrigin, search)
        self.assertLess(search.result.fbest, 1e-8)
        self.assertEqual(sum(run["evaluations"] for run in search.runs),
                         search.result.evaluations)
        self.assertEqual(search.runs[0]["regime"], "first")
        self.assertIn("large", [run["regime"] for run in search.runs])
        self.assertEqual(len(search.runs), search.result.restarts + 1)
        self.assertTrue(all(np.all(np.abs(x) <= 5) for x in asked))
        np.testing.assert_allclose(asked[0].mean(axis=0), 3, atol=3)

    def test_seeds_repeat_and_differ(self):
        def first(seed):
            return dp.CMAES([0, 0, 0], 1, seed=seed).ask()
        self.assertTrue(np.array_equal(first(4), first(4)))
        self.assertFalse(np.array_equal(first(4), first(5)))
        self.assertFalse(np.array_equal(first(0), first(1)))

    def test_asking_again_changes_nothing_and_results_are_before_any_tell(self):
        search = dp.CMAES([0.5, 1.5], 1)
        self.assertIsNone(search.best.x)
        self.assertEqual(search.result.fbest, np.inf)
        np.testing.assert_array_equal(search.result.xfavorite, [0.5, 1.5])
        first = search.ask()
        first_copy = first.copy()
        first += 1  # the caller's own copy
        self.assertTrue(np.array_equal(search.ask(), first_copy))
        self.assertEqual(first.shape, (search.population, search.dimension))

    def test_lists_and_nan_costs_are_taken(self):
        search = dp.CMAES([1.0, 1.0], 0.3, restarts="single", max_evaluations=3000)
        while not search.stop():
            x = search.ask()
            costs = [float(np.sum(row**2)) if row[0] > -0.5 else float("nan") for row in x]
            search.tell(x.tolist(), costs)
        self.assertLess(search.best.f, 1e-9)

    def test_an_optimum_on_the_bound_is_reached(self):
        search = dp.CMAES([2, 2, 2], 0.5, lower=[1, 1, 1], upper=[4, 5, 6], restarts="single")
        minimise(lambda x: np.sum(x**2, axis=1), search)
        np.testing.assert_allclose(search.best.x, 1, atol=1e-6)


if __name__ == "__main__":
    unittest.main()
