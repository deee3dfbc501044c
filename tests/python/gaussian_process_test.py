# SPDX-License-Identifier: Apache-2.0
"""downpour.GaussianProcess: its answers, against scikit-learn and a closed form."""
import tracemalloc
import unittest

import downpour as dp
import numpy as np
from models import cartpole_data, cartpole_model, smooth_data

try:
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import RBF, ConstantKernel
except ImportError:
    GaussianProcessRegressor = None


class GaussianProcessTest(unittest.TestCase):
    def test_one_point_has_the_closed_form(self):
        gp = dp.GaussianProcess([[0.5]], [[2.0]], [[0.7]], [1.5], [0.3], tolerance=0)
        mean, var = gp.predict([[1.1]], include_noise=False)
        k = 1.5**2 * np.exp(-0.5 * (0.6 / 0.7)**2)
        s = 1.5**2 + 0.3**2
        self.assertAlmostEqual(mean[0, 0], k / s * 2, delta=1e-14)
        self.assertAlmostEqual(var[0, 0], 1.5**2 - k**2 / s, delta=1e-14)
        self.assertAlmostEqual(gp.predict([[1.1]])[1][0, 0], var[0, 0] + 0.09, delta=1e-15)
        self.assertAlmostEqual(gp.log_marginal_likelihood[0],
                               -0.5 * (4 / s + np.log(s) + np.log(2 * np.pi)), delta=1e-13)

    @unittest.skipIf(GaussianProcessRegressor is None, "python3-sklearn is not installed")
    def test_scikit_learn_agrees_to_1e_8_at_tolerance_0(self):
        x, y, hyper = smooth_data(n=200)
        queries = np.random.default_rng(1).uniform(-2.5, 2.5, size=(500, 3))
        gp = dp.GaussianProcess(x, y, *hyper, tolerance=0)
        mean, var = gp.predict(queries, include_noise=False)
        for e, (lengthscales, signal, noise) in enumerate(zip(*hyper)):
            kernel = ConstantKernel(signal**2, "fixed") * RBF(lengthscales, "fixed")
            other = GaussianProcessRegressor(kernel, alpha=noise**2, optimizer=None)
            other.fit(x, y[:, e])
            their_mean, their_std = other.predict(queries, return_std=True)
            np.testing.assert_allclose(mean[:, e], their_mean, rtol=1e-8,
                                       atol=1e-8 * np.abs(y).max())
            np.testing.assert_allclose(np.sqrt(var[:, e]), their_std, rtol=1e-8)
            np.testing.assert_allclose(gp.log_marginal_likelihood[e],
                                       other.log_marginal_likelihood_value_, rtol=1e-8)

    def test_threads_and_batch_do_not_change_a_bit(self):
        x, y = cartpole_data()
        queries = np.concatenate([x, 0.5 * (x + x[::-1])] * 5)
        for gp in (cartpole_model(0.02), cartpole_model(0)):
            mean, var = gp.predict(queries, threads=1)
            for threads in (2, 5, 0):
                again = gp.predict(queries, threads=threads)
                self.assertTrue(np.array_equal(mean, again[0]) and np.array_equal(var, again[1]))
            one = gp.predict(queries[7:8])
            self.assertTrue(np.array_equal(one[0][0], mean[7]) and
                            np.array_equal(one[1][0], var[7]))
        blas = cartpole_model(0, "blas")
        self.assertTrue(np.array_equal(blas.predict(queries, threads=1)[1],
                                       blas.predict(queries, threads=5)[1]))

    def test_plan_keeps_the_tolerance_between_the_data_and_tells_what_it_does(self):
        x, _ = cartpole_data()
        rng = np.random.default_rng(3)
        share = rng.uniform(size=(2000, 1))
        a, b = x[rng.integers(len(x), size=(2, 2000))]
        queries = a + share * (b - a)
        planned, exact = cartpole_model(0.02), cartpole_model(0)
        (mean, var), (true_mean, true_var) = planned.predict(queries), exact.predict(queries)
        self.assertLess(np.max(np.abs(var - true_var) / true_var), 0.02)
        self.assertLess(np.max(np.abs(mean - true_mean) / np.sqrt(true_var)), 0.05)
        self.assertEqual(len(planned.plan), 4)
        for plan in planned.plan:
            self.assertIn(plan["method"], ("exact", "compressed"))
            self.assertIn(plan["precision"], ("fp32", "fp64"))
            self.assertEqual(plan["n"], len(x))
            self.assertLessEqual(plan["variance_error"], 0.01)
            self.assertGreater(plan["ns_per_query"], 1)
        self.assertTrue(any(plan["m"] < len(x) for plan in planned.plan))
        for plan in exact.plan:
            self.assertEqual((plan["method"], plan["precision"], plan["m"], plan["backend"]),
                             ("exact", "fp64", len(x), "fused"))

    def test_blas_is_exact(self):
        x, _ = cartpole_data()
        mean, var = cartpole_model(0.5, "blas").predict(x)
        true_mean, true_var = cartpole_model(0).predict(x)
        np.testing.assert_allclose(var, true_var, rtol=1e-6)
        np.testing.assert_allclose(mean, true_mean, atol=1e-6)
        self.assertTrue(all(p["backend"] == "blas" for p in cartpole_model(0.5, "blas").plan))

    def test_fit_depends_on_the_seed_alone_and_improves_on_a_guess(self):
        x, y, hyper = smooth_data()
        fits = [dp.GaussianProcess.fit(x, y, seed=3, threads=threads) for threads in (1, 2, 5)]
        for fit in fits[1:]:
            self.assertTrue(np.array_equal(fit.lengthscales, fits[0].lengthscales))
            self.assertTrue(np.array_equal(fit.noise_std, fits[0].noise_std))
        guess = dp.GaussianProcess(x, y, *hyper)
        self.assertTrue(np.all(fits[0].log_marginal_likelihood > guess.log_marginal_likelihood))
        again = dp.GaussianProcess(x, y, fits[0].lengthscales, fits[0].signal_std,
                                   fits[0].noise_std)
        self.assertTrue(np.array_equal(again.predict(x)[0], fits[0].predict(x)[0]))

    def test_arrays_of_any_layout_and_number_type_give_the_same_answer(self):
        x, y, hyper = smooth_data()
        x, y = x.astype(np.float32), y.astype(np.float32)
        x64, y64 = x.astype(float), y.astype(float)
        wanted = dp.GaussianProcess(x64, y64, *hyper).predict(x64)[0]
        wide = np.zeros((len(x), 6))
        wide[:, ::2] = x64
        misaligned = np.frombuffer(b"\0" + x64.tobytes(), dtype=np.uint8)[1:].view(float)
        for inputs in (x, np.asfortranarray(x64), x64.tolist(), wide[:, ::2], x64.astype(">f8"),
                       misaligned.reshape(x.shape), x64[::-1][::-1]):
            gp = dp.GaussianProcess(inputs, y, *hyper)
            self.assertTrue(np.array_equal(gp.predict(inputs)[0], wanted))
        x_int = np.arange(12).reshape(6, 2)
        gp = dp.GaussianProcess(x_int, x_int[:, :1], [[3, 3]], [2], [1])
        self.assertEqual(gp.predict(x_int)[0].shape, (6, 1))

    def test_contiguous_queries_go_in_without_a_copy(self):
        model = cartpole_model(0)
        queries = np.tile(cartpole_data()[0], (100, 1))
        answers = 2 * len(queries) * 4 * 8  # bytes

        def peak(of):
            tracemalloc.start()
            model.predict(of)
            bytes_ = tracemalloc.get_traced_memory()[1]
            tracemalloc.stop()
            return bytes_
        self.assertLess(peak(queries), answers + 0.1 * queries.nbytes)
        self.assertGreater(peak(np.asfortranarray(queries)), answers + queries.nbytes)

    def test_properties_are_copies(self):
        x, y, hyper = smooth_data()
        gp = dp.GaussianProcess(x, y, *hyper)
        queries = x.copy()
        before = gp.predict(queries)[0]
        gp.lengthscales[:] = 100
        x += 1
        y += 1
        self.assertTrue(np.array_equal(gp.predict(queries)[0], before))
        self.assertTrue(np.array_equal(gp.lengthscales, hyper[0]))
        self.assertEqual(before.shape, (60, 2))
        self.assertEqual((gp.n_points, gp.n_inputs, gp.n_outputs), (60, 3, 2))

    def test_a_covariance_without_a_factor_gets_jitter_that_the_plan_tells(self):
        x = np.zeros((20, 1))
        gp = dp.GaussianProcess(x, np.ones((20, 1)), [[1.0]], [1.0], [1e-100], tolerance=0)
        self.assertGreater(gp.plan[0]["jitter"], 0)
        self.assertTrue(np.all(np.isfinite(gp.predict(x)[0])))

    def test_no_queries_give_no_answers(self):
        mean, var = cartpole_model().predict(np.zeros((0, 6)))
        self.assertEqual((mean.shape, var.shape), ((0, 4), (0, 4)))


if __name__ == "__main__":
    unittest.main()
