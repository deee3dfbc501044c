# SPDX-License-Identifier: Apache-2.0
"""downpour.learn, its policies, and the simulators of downpour.make.

With the command as argument: learning has the bits of its runs.
"""
import csv
import pathlib
import subprocess
import sys
import tempfile
import unittest

import downpour as dp
import numpy as np

COMMAND = sys.argv.pop(1) if len(sys.argv) > 1 and pathlib.Path(sys.argv[1]).is_file() else None
SETTINGS = {"search.evaluations": 600, "search.final_rollouts": 24, "model.max_evaluations": 30}


def tiny(seed=3, **changes):
    return dp.learn("pendulum", seed=seed, episodes=3, settings=SETTINGS, **changes)


class LearnTest(unittest.TestCase):
    def test_the_result_holds_episodes_transitions_and_a_policy(self):
        told = []
        result = tiny(callback=told.append)
        self.assertEqual(told, result.episodes)
        self.assertEqual([e["episode"] for e in result.episodes], [1, 2, 3])
        self.assertEqual([e["random"] for e in result.episodes], [True, False, False])
        self.assertEqual({k: v.shape for k, v in result.transitions.items()},
                         {"episode": (120,), "step": (120,), "observation": (120, 2),
                          "action": (120, 1), "next_observation": (120, 2), "reward": (120,)})
        rows = result.transitions["episode"] == 3
        self.assertAlmostEqual(result.transitions["reward"][rows].sum(),
                               result.episodes[2]["real_return"])
        for state, action in zip(result.transitions["observation"][rows],
                                 result.transitions["action"][rows]):
            self.assertTrue(np.array_equal(result.policy(state), action))
        self.assertEqual(result.policy.kind, "nn")
        self.assertTrue(np.array_equal(result.policy.parameters, told[2]["parameters"]))

    def test_threads_do_not_change_a_bit_and_seeds_do(self):
        one, two, other = tiny(threads=1), tiny(threads=2), tiny(seed=4)
        for name, array in one.transitions.items():
            self.assertTrue(np.array_equal(array, two.transitions[name]))
        self.assertFalse(np.array_equal(one.transitions["action"], other.transitions["action"]))

    @unittest.skipIf(COMMAND is None, "no command given")
    def test_the_command_learns_with_the_same_bits(self):
        result = tiny()
        with tempfile.TemporaryDirectory() as directory:
            run = pathlib.Path(directory) / "run"
            options = [o for key, value in SETTINGS.items() for o in ("--set", f"{key}={value}")]
            subprocess.run([COMMAND, "learn", "pendulum", "--seed", "3", "--episodes", "3",
                            "--quiet", "--out", run, *options], check=True)
            with open(run / "transitions.csv", newline="", encoding="utf-8") as file:
                rows = list(csv.DictReader(file))
        column = next(name for name in rows[0] if "torque" in name)
        self.assertEqual([float(row[column]) for row in rows],
                         result.transitions["action"][:, 0].tolist())

    def test_settings_reach_the_run(self):
        result = dp.learn("cartpole", episodes=2, settings={
            **SETTINGS, "policy.kind": "linear", "learn.until_solved": False,
            "observation_std": 0.0})
        self.assertEqual(result.policy.kind, "linear")
        self.assertEqual(result.policy.parameters.shape, (6,))

    def test_the_model_of_a_run_can_be_evaluated_further(self):
        result = tiny()
        env = dp.make("pendulum")
        data = result.transitions
        x = np.hstack([env.features(data["observation"]), data["action"]])
        model = dp.GaussianProcess.fit(x, data["next_observation"] - data["observation"])
        evaluator = dp.Evaluator(model, task="pendulum")
        returns = evaluator.evaluate(result.policy.parameters[None])
        self.assertAlmostEqual(returns[0, 0], result.episodes[-1]["real_return"], delta=5)


class EnvTest(unittest.TestCase):
    def test_an_episode_runs_to_its_horizon_and_repeats_by_seed(self):
        env = dp.make("cartpole")
        def episode(seed):
            observations, done = [env.reset(seed=seed)], False
            while not done:
                observation, reward, done, info = env.step([3.0])
                observations.append(observation)
                self.assertTrue(0 <= reward <= 1)
            self.assertIs(info["solved"], False)
            return np.array(observations)
        first = episode(2)
        self.assertEqual(first.shape, (env.horizon + 1, 4))
        self.assertTrue(np.array_equal(episode(2), first))
        self.assertFalse(np.array_equal(episode(3), first))
        self.assertFalse(np.array_equal(episode(None), first))
        self.assertRaisesRegex(RuntimeError, "the episode is over", env.step, [0.0])

    def test_actions_are_clipped_and_noise_is_only_in_the_observation(self):
        env = dp.make("cartpole")
        env.reset(seed=0)
        observation, _, _, info = env.step([1e6])
        self.assertEqual(info["action"], env.action_limit)
        self.assertEqual(info["step"], 1)
        self.assertLess(np.abs(observation - info["state"]).max(), 0.05)
        self.assertGreater(np.abs(observation - info["state"]).max(), 0)

    def test_the_pendulum_hangs_and_features_are_its_sines(self):
        env = dp.make("pendulum")
        np.testing.assert_array_equal(env.reset(seed=0), [0, 0])
        np.testing.assert_allclose(env.step([0.0])[0], 0, atol=1e-12)
        np.testing.assert_allclose(env.features([1.0, 0.5]), [1, np.cos(0.5), np.sin(0.5)])
        self.assertEqual(env.features(np.zeros((7, 2))).shape, (7, 3))
        self.assertEqual(dp.tasks()[0], env.task)
        self.assertEqual(len(env.state_names), 2)
        self.assertEqual(len(env.feature_names), 3)


if __name__ == "__main__":
    unittest.main()
