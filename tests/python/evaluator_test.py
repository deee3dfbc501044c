# SPDX-License-Identifier: Apache-2.0
"""downpour.Evaluator: returns and rollouts, built in and by callables."""
import gc
import unittest
import weakref

import downpour as dp
import numpy as np
from models import cartpole_model, cartpole_reward, network, smooth_data, thetas


def pairs_model():
    """State (2,), one action: differences of the state are 0.1 u and noise."""
    rng = np.random.default_rng(0)
    x = rng.uniform(-2, 2, size=(80, 3))
    y = 0.1 * x[:, 2:] * np.array([1.0, -1.0]) + 0.01 * rng.normal(size=(80, 2))
    return dp.GaussianProcess.fit(x, y, tolerance=0)


class EvaluatorTest(unittest.TestCase):
    def test_callables_give_what_the_built_in_policy_and_reward_give(self):
        model = cartpole_model(0)
        built_in = dp.Evaluator(model=model, task="cartpole", policy="nn", rollouts=3)
        wanted = built_in.evaluate(thetas(40), seed=5)
        self.assertEqual(wanted.shape, (40, 3))
        for arguments in ({"policy": network}, {"reward": cartpole_reward},
                          {"policy": network, "reward": cartpole_reward}):
            own = dp.Evaluator(model=model, task="cartpole", rollouts=3, **arguments)
            np.testing.assert_allclose(own.evaluate(thetas(40), seed=5), wanted, atol=1e-6)

    def test_without_a_task_features_and_limits_are_ones_own(self):
        model = cartpole_model(0)
        wanted = dp.Evaluator(model, task="cartpole", rollouts=2).evaluate(thetas(20))
        def features(states):
            return np.stack([states[:, 0], states[:, 1], states[:, 2], np.cos(states[:, 3]),
                             np.sin(states[:, 3])], axis=1)
        start = dp.make("cartpole").reset(seed=0) * 0
        for own in (features, [0, 1, 2, ("cos", 3), ("sin", 3)]):
            evaluator = dp.Evaluator(model=model, features=own, policy=network, horizon=40,
                                     reward=cartpole_reward, start=start, action_limit=10,
                                     rollouts=2)
            np.testing.assert_allclose(evaluator.evaluate(thetas(20)), wanted, atol=1e-6)

    def test_threads_do_not_change_a_bit(self):
        for arguments in ({}, {"policy": network}, {"reward": cartpole_reward}):
            results = [dp.Evaluator(cartpole_model(), task="cartpole", rollouts=2, threads=threads,
                                    **arguments).evaluate(thetas(300), seed=1)
                       for threads in (1, 2, 5)]
            self.assertTrue(np.array_equal(results[0], results[1]))
            self.assertTrue(np.array_equal(results[0], results[2]))

    def test_a_return_depends_on_its_row_its_seed_and_its_rollout_alone(self):
        evaluator = dp.Evaluator(cartpole_model(), task="cartpole", rollouts=4)
        one = dp.Evaluator(cartpole_model(), task="cartpole", rollouts=1)
        rows = thetas(70)
        returns = evaluator.evaluate(rows, seed=9)
        self.assertTrue(np.array_equal(evaluator.evaluate(rows[::-1], seed=9), returns[::-1]))
        self.assertTrue(np.array_equal(one.evaluate(rows, seed=9)[:, 0], returns[:, 0]))
        self.assertFalse(np.array_equal(evaluator.evaluate(rows, seed=10), returns))

    def test_a_rollout_is_what_evaluate_summed(self):
        for arguments in ({}, {"policy": network, "reward": cartpole_reward}):
            evaluator = dp.Evaluator(cartpole_model(), task="cartpole", rollouts=5, **arguments)
            theta = thetas(1)[0]
            states, actions, rewards = evaluator.rollout(theta, seed=2)
            self.assertEqual((states.shape, actions.shape, rewards.shape),
                             ((5, 41, 4), (5, 40, 1), (5, 40)))
            np.testing.assert_allclose(rewards.sum(axis=1),
                                       evaluator.evaluate(theta[None], seed=2)[0], rtol=1e-12)
            self.assertLessEqual(np.abs(actions).max(), 10)
            np.testing.assert_allclose(cartpole_reward(states[:, 5], None, None), rewards[:, 4],
                                       rtol=1e-12)
            self.assertGreater(np.std(states[:, 20], axis=0).min(), 0)

    def test_rollouts_sample_the_model(self):
        model = pairs_model()
        evaluator = dp.Evaluator(
            model, policy=lambda theta, x, t: np.ones((len(x), 1)), horizon=1, start=[0.3, -0.2],
            reward=lambda s, a, t: s[:, 0], rollouts=20000)
        states, _, _ = evaluator.rollout([0.0])
        mean, var = model.predict([[0.3, -0.2, 1.0]])
        steps = states[:, 1] - states[:, 0]
        error = np.sqrt(var[0] / len(steps))
        self.assertTrue(np.all(np.abs(steps.mean(axis=0) - mean[0]) < 5 * error))
        np.testing.assert_allclose(steps.var(axis=0), var[0], rtol=5 * np.sqrt(2 / len(steps)))

    def test_options_of_the_rollouts_do_what_they_say(self):
        model = pairs_model()
        common = dict(policy=lambda theta, x, t: 5 * np.ones((len(x), 1)), horizon=3,
                      start=[0, 0], reward=lambda s, a, t: a[:, 0], rollouts=50)
        states, actions, _ = dp.Evaluator(model, use_variance=False, action_limit=2,
                                          **common).rollout([0.0])
        self.assertEqual(np.ptp(states, axis=0).max(), 0)
        self.assertEqual((actions.min(), actions.max()), (2, 2))
        self.assertTrue(np.allclose(states[0, 1], model.predict([[0, 0, 2]])[0][0]))
        free = dp.Evaluator(model, **common)
        self.assertEqual(free.rollout([0.0])[1].max(), 5)
        spread = dp.Evaluator(model, start_std=[1, 0], **common).rollout([0.0])[0]
        self.assertAlmostEqual(spread[:, 0, 0].std(), 1, delta=0.5)
        self.assertEqual(np.ptp(spread[:, 0, 1]), 0)
        latent = dp.Evaluator(model, predict_noise=False, **common).rollout([0.0])[0]
        self.assertLess(latent[:, 1].std(), free.rollout([0.0])[0][:, 1].std())

    def test_callables_get_whole_blocks_once_a_step(self):
        calls = []
        def policy(theta, features, t):
            calls.append((theta, features.copy(), t))
            return np.zeros((len(features), 1))
        evaluator = dp.Evaluator(cartpole_model(), task="cartpole", policy=policy,
                                 reward=cartpole_reward, rollouts=2, horizon=7)
        evaluator.evaluate(thetas(500, parameters=3))
        self.assertEqual([t for _, _, t in calls], list(range(7)))
        for theta, features, _ in calls:
            self.assertEqual((theta.shape, features.shape), ((1000, 3), (1000, 5)))
            self.assertTrue(np.array_equal(theta, np.repeat(thetas(500, parameters=3), 2, axis=0)))
            self.assertFalse(theta.flags.writeable)
        self.assertIsNone(evaluator.n_parameters)

    def test_results_of_any_layout_and_number_type_are_taken(self):
        model = pairs_model()
        def returns(action):
            return dp.Evaluator(model, policy=lambda theta, x, t: action(len(x)), start=[0, 0],
                                reward=lambda s, a, t: s[:, 0], horizon=4).evaluate([[0.0]] * 30)
        wanted = returns(lambda n: np.ones((n, 1)))
        for action in (lambda n: np.ones((n, 1), dtype=int), lambda n: [[1]] * n,
                       lambda n: np.ones((n, 1), dtype=np.float32),
                       lambda n: np.ones((2 * n, 3))[::2, 1:2],
                       lambda n: np.ones((1, n), order="F").T):
            self.assertTrue(np.array_equal(returns(action), wanted))

    def test_arrays_that_a_callable_keeps_stay_as_they_were(self):
        kept = []
        def reward(states, actions, t):
            kept.append(states)
            return states[:, 1]
        evaluator = dp.Evaluator(cartpole_model(), task="cartpole", reward=reward)
        evaluator.evaluate(thetas(3))
        states, _, _ = evaluator.rollout(thetas(3)[1])
        for t in range(40):
            np.testing.assert_array_equal(kept[t][1], states[0, t + 1])

    def test_a_rollout_that_diverges_gets_the_lowest_return(self):
        def reward(states, actions, t):
            rewards = np.zeros(len(states))
            if t == 3:
                rewards[0] = 1e7
            return rewards
        evaluator = dp.Evaluator(cartpole_model(), task="cartpole", reward=reward)
        returns = evaluator.evaluate(thetas(3))
        self.assertEqual(returns[0, 0], evaluator.diverged_return)
        self.assertEqual(returns[1, 0], 0)
        _, _, rewards = evaluator.rollout(thetas(3)[0])
        self.assertTrue(np.isfinite(rewards[0, 2]) and np.isnan(rewards[0, 3:]).all())

    def test_other_policies_and_backends_are_evaluated(self):
        for policy, arguments in (("linear", {}), ("gp", {"points": 5}), ("dmp", {}),
                                  ("nn", {"hidden_units": [4, 3], "activation": "relu"})):
            evaluator = dp.Evaluator(cartpole_model(), task="cartpole", policy=policy, **arguments)
            rows = thetas(10, parameters=evaluator.n_parameters)
            self.assertTrue(np.isfinite(evaluator.evaluate(rows)).all())
        rows = thetas(60)
        exact = dp.Evaluator(cartpole_model(0), task="cartpole").evaluate(rows)
        blas = dp.Evaluator(cartpole_model(0, "blas"), task="cartpole").evaluate(rows)
        np.testing.assert_allclose(blas, exact, atol=1e-3)

    def test_an_evaluator_may_be_used_from_within_its_callables(self):
        inner = dp.Evaluator(cartpole_model(), task="cartpole", horizon=2)
        outer_calls = []
        def zeros(theta, features, t):
            outer_calls.append(inner.evaluate(theta[:1])[0, 0])
            return np.zeros((len(theta), 1))
        outer = dp.Evaluator(cartpole_model(), task="cartpole", policy=zeros)
        outer.evaluate(thetas(5))
        self.assertEqual(len(outer_calls), 40)
        self.assertEqual(len(set(outer_calls)), 1)

    def test_a_cycle_through_a_callable_is_collected(self):
        class Search:
            def __init__(self):
                self.evaluator = dp.Evaluator(cartpole_model(), task="cartpole", policy=self.act)

            def act(self, theta, features, t):
                return np.zeros((len(theta), 1))
        search = Search()
        search.evaluator.evaluate(thetas(2))
        gone = weakref.ref(search)
        del search
        gc.collect()
        self.assertIsNone(gone())

    def test_the_model_outlives_its_name(self):
        x, y, hyper = smooth_data(dim=3, outputs=2)
        model = dp.GaussianProcess(x, y, *hyper)
        evaluator = dp.Evaluator(model, policy="linear", action_limit=1, start=[0, 0],
                                 reward=lambda s, a, t: s[:, 0])
        wanted = evaluator.evaluate(thetas(4, parameters=3))
        del model
        gc.collect()
        self.assertTrue(np.array_equal(evaluator.evaluate(thetas(4, parameters=3)), wanted))


if __name__ == "__main__":
    unittest.main()
