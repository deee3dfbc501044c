# SPDX-License-Identifier: Apache-2.0
"""The package within a process: threads, Ctrl-C, memory, and what other libraries loaded before."""
import json
import os
import signal
import subprocess
import sys
import threading
import time
import unittest

import downpour as dp
import numpy as np
from models import cartpole_data, cartpole_model, cartpole_reward, network, smooth_data, thetas


def resident_bytes():
    with open("/proc/self/statm", encoding="ascii") as file:
        return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")


def together(function, count=4):
    """The results of function(i) in `count` threads at once."""
    results, barrier = [None] * count, threading.Barrier(count)

    def work(i):
        barrier.wait()
        results[i] = function(i)
    workers = [threading.Thread(target=work, args=(i,)) for i in range(count)]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join()
    return results


class ThreadsTest(unittest.TestCase):
    def test_four_threads_at_once_share_objects_and_get_the_same_bits(self):
        model, rows = cartpole_model(), thetas(100)
        x, y = cartpole_data()
        built_in = dp.Evaluator(model, task="cartpole")
        own = dp.Evaluator(model, task="cartpole", policy=network, reward=cartpole_reward)

        def work(_):
            return (model.predict(x)[1], built_in.evaluate(rows, seed=1), own.evaluate(rows, seed=1),
                    dp.GaussianProcess.fit(x[:40], y[:40]).noise_std)
        alone = work(0)
        for _ in range(5):
            for result in together(work):
                for got, wanted in zip(result, alone):
                    self.assertTrue(np.array_equal(got, wanted))

    def test_learning_in_four_threads_has_the_bits_of_one(self):
        def work(seed):
            return dp.learn("pendulum", seed=seed, episodes=2, threads=1, settings={
                "search.evaluations": 600, "search.final_rollouts": 24}).transitions["action"]
        for seed, actions in enumerate(together(work)):
            self.assertTrue(np.array_equal(actions, work(seed)))

    def test_errors_in_some_threads_do_not_reach_the_others(self):
        model, rows = cartpole_model(), thetas(100)
        good = dp.Evaluator(model, task="cartpole", reward=cartpole_reward)
        wanted = good.evaluate(rows)

        def raises(states, actions, t):
            raise LookupError("mine")
        bad = [(raises, LookupError, "mine"),
               (lambda s, a, t: s, ValueError, "result of reward: shape"),
               (lambda s, a, t: s[:, 0] * np.nan, ValueError, "reward: gave nan")]

        def work(i):
            if i == 3:
                return [good.evaluate(rows) for _ in range(20)]
            reward, exception, message = bad[i]
            evaluator = dp.Evaluator(model, task="cartpole", reward=reward)
            for _ in range(20):
                with self.assertRaisesRegex(exception, message):
                    evaluator.evaluate(rows)
            return []
        results = together(work)
        self.assertEqual([result == [] for result in results], [True, True, True, False])
        self.assertTrue(all(np.array_equal(result, wanted) for result in results[3]))

    def test_other_threads_run_during_long_calls(self):
        model = cartpole_model(0)
        queries = np.tile(cartpole_data()[0], (500, 1))
        x, y, hyper = smooth_data(n=500, dim=6, outputs=4)
        evaluator = dp.Evaluator(model, task="cartpole", threads=1)
        many = dp.Evaluator(model, task="cartpole", threads=1, rollouts=2000)
        calls = (lambda: model.predict(queries, threads=1),
                 lambda: evaluator.evaluate(thetas(2000)),
                 lambda: many.rollout(thetas(1)[0]),
                 lambda: dp.GaussianProcess(x, y, *hyper, threads=1),
                 lambda: dp.GaussianProcess.fit(x, y, threads=1),
                 lambda: dp.learn("pendulum", episodes=2, threads=1,
                                  settings={"search.evaluations": 20000}))
        for i, call in enumerate(calls):
            ticks, done = [], threading.Event()

            def tick():
                while not done.is_set():
                    ticks.append(time.monotonic())
                    time.sleep(0.001)
            ticker = threading.Thread(target=tick)
            ticker.start()
            start = time.monotonic()
            call()
            end = time.monotonic()
            done.set()
            ticker.join()
            # With the lock held there would be none, but one at either end.
            during = [t for t in ticks if start + 0.002 < t < end - 0.002]
            with self.subTest(call=i, seconds=end - start):
                self.assertGreater(end - start, 0.02)
                self.assertGreater(len(during), 2)


class InterruptTest(unittest.TestCase):
    def interrupt(self, function, after=0.2):
        """Calls function, which runs on, and sends Ctrl-C; the seconds until it ended."""
        sent = []

        def send():
            sent.append(time.monotonic())
            os.kill(os.getpid(), signal.SIGINT)
        timer = threading.Timer(after, send)
        timer.start()
        with self.assertRaises(KeyboardInterrupt):
            while True:
                function()
        timer.join()
        return time.monotonic() - sent[0]

    def test_ctrl_c_ends_evaluation_fit_and_learning(self):
        model = cartpole_model(0)
        rows = np.tile(thetas(5000), (40, 1))
        evaluator = dp.Evaluator(model, task="cartpole")
        own = dp.Evaluator(model, task="cartpole", reward=cartpole_reward)
        x, y, _ = smooth_data(n=800, dim=6, outputs=4)
        for function in (lambda: evaluator.evaluate(rows), lambda: own.evaluate(rows),
                         lambda: dp.GaussianProcess.fit(x, y),
                         lambda: dp.learn("cartpole", threads=2)):
            self.assertLess(self.interrupt(function), 2.5)
        # All goes on, and Ctrl-C is Python's again.
        self.assertTrue(np.isfinite(evaluator.evaluate(rows[:10])).all())
        self.assertIs(signal.getsignal(signal.SIGINT), signal.default_int_handler)
        self.assertLess(self.interrupt(lambda: time.sleep(0.01)), 1)

    def test_a_handler_of_ones_own_is_called_and_raises_what_it_raises(self):
        def handler(number, frame):
            raise TimeoutError("mine")
        before = signal.signal(signal.SIGINT, handler)
        try:
            timer = threading.Timer(0.2, os.kill, (os.getpid(), signal.SIGINT))
            timer.start()
            with self.assertRaisesRegex(TimeoutError, "mine"):
                dp.learn("cartpole", threads=2)
            timer.join()
        finally:
            signal.signal(signal.SIGINT, before)


class MemoryTest(unittest.TestCase):
    def test_memory_does_not_grow(self):
        x, y, hyper = smooth_data(n=24, dim=3, outputs=2)
        rows = thetas(60)

        def fails(theta, features, t):
            raise RuntimeError

        def cycle(i):
            n = 4 + i % 20
            gp = dp.GaussianProcess(x[:n], y[:n], *hyper, tolerance=0.02 * (i % 2))
            gp.predict(x)
            gp.plan if i % 50 == 0 else None
            dp.CMAES(np.zeros(1 + i % 9), 1.0, seed=i).ask()
            if i % 20 == 0:
                model = cartpole_model()
                dp.Evaluator(model, task="cartpole", policy=network).evaluate(rows)
                dp.Evaluator(model, task="cartpole").rollout(rows[0])
                self.assertRaises(RuntimeError, dp.Evaluator(model, task="cartpole",
                                                             policy=fails).evaluate, rows)
            self.assertRaises(ValueError, gp.predict, x[:, :2])
            self.assertRaises(ValueError, dp.GaussianProcess, x, y[:3], *hyper)
        for i in range(400):
            cycle(i)
        before = resident_bytes()
        for i in range(1600):
            cycle(i)
        # The pages of a thousand cycles' smallest objects would be more.
        self.assertLess(resident_bytes() - before, 1 << 20)

    def test_references_of_callables_do_not_grow(self):
        rewards = np.zeros(5)

        def reward(states, actions, t):
            return rewards
        before = sys.getrefcount(rewards), sys.getrefcount(reward)
        evaluator = dp.Evaluator(cartpole_model(), task="cartpole", reward=reward)
        for _ in range(10):
            evaluator.evaluate(thetas(5))
        del evaluator
        self.assertEqual((sys.getrefcount(rewards), sys.getrefcount(reward)), before)


def python(program, **environment):
    """What a program in a process of its own prints, as JSON."""
    inherited = {name: value for name, value in os.environ.items()
                 if name not in ("OPENBLAS_CORETYPE", "OMP_WAIT_POLICY", "GOMP_SPINCOUNT")}
    result = subprocess.run([sys.executable, "-c", program], env={**inherited, **environment},
                            capture_output=True, text=True, check=False)
    if result.returncode != 0:
        raise AssertionError(result.stderr)
    return json.loads(result.stdout)


class LoadingTest(unittest.TestCase):
    def test_settings_are_made_before_the_libraries_load_and_the_users_stay(self):
        program = """if True:
            import json, os
            import downpour as dp
            print(json.dumps([dp.doctor(), os.environ.get("GOMP_SPINCOUNT")]))"""
        doctor, spins = python(program)
        self.assertFalse(doctor["openmp_loaded_before"] or doctor["blas_loaded_before"])
        self.assertEqual(spins, "2000")
        self.assertEqual(doctor["warnings"], [])
        doctor, spins = python(program, GOMP_SPINCOUNT="7", OPENBLAS_CORETYPE="Prescott")
        self.assertEqual((spins, doctor["blas_core"]), ("7", "Prescott"))

    def test_a_weak_choice_of_openblas_is_mended(self):
        # As if this CPU deserved better kernels than OpenBLAS chooses, once it is let go again.
        doctor = python("""if True:
            import importlib.util, json, pathlib, sys
            for path in sys.path:
                if (pathlib.Path(path) / "downpour" / "_process.py").is_file():
                    break
            source = (pathlib.Path(path) / "downpour" / "_process.py").read_text()
            spec = importlib.util.spec_from_file_location("process", path + "/downpour/_process.py")
            process = importlib.util.module_from_spec(spec)
            spec.loader.exec_module(process)
            process._WIDTH = {"Haswell": 4}
            process._suitable_core = lambda: "Haswell"
            process.prepare()
            import os
            import downpour as dp
            x = dp.GaussianProcess([[0.0]], [[1.0]], [[1]], [1], [1]).predict([[0.0]])[0][0, 0]
            print(json.dumps([process._notes, dp.doctor(), os.environ["OPENBLAS_CORETYPE"], x]))""")
        self.assertTrue(doctor[0]["blas_core_mended"])
        self.assertEqual(doctor[2:], ["Haswell", 0.5])
        if doctor[1]["simd"] in ("AVX2", "AVX3"):
            self.assertEqual(doctor[1]["blas_core"], "Haswell")

    def test_slow_kernels_are_told_where_they_matter(self):
        warned = python("""if True:
            import json, warnings
            import numpy as np
            np.dot(np.ones((2, 2)), np.ones((2, 2)))
            import downpour as dp
            def make(backend):
                with warnings.catch_warnings(record=True) as caught:
                    warnings.simplefilter("always")
                    dp.GaussianProcess([[0.0]], [[1.0]], [[1]], [1], [1], backend=backend)
                return [str(w.message) for w in caught]
            print(json.dumps([dp.doctor(), make("blas"), make("auto")]))""",
                        OPENBLAS_CORETYPE="Prescott")
        self.assertEqual(warned[2], [])
        self.assertEqual(warned[1], warned[0]["warnings"])
        if warned[0]["simd"] in ("AVX2", "AVX3"):
            self.assertEqual(len(warned[1]), 1)
            self.assertIn("Prescott", warned[1][0])

    def test_importing_does_not_take_numpys_threads(self):
        before, after = python("""if True:
            import ctypes, json
            import numpy as np
            np.dot(np.ones((2, 2)), np.ones((2, 2)))
            omp = ctypes.CDLL("libgomp.so.1")
            before = omp.omp_get_max_threads()
            import downpour as dp
            x = np.arange(20.0)[:, None]
            dp.GaussianProcess.fit(x, np.sin(x), backend="blas").predict(x)
            dp.CMAES(np.zeros(30), 1.0).ask()
            print(json.dumps([before, omp.omp_get_max_threads()]))""")
        self.assertEqual(before, after)


if __name__ == "__main__":
    unittest.main()
