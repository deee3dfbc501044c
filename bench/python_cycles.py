#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""A million models made, asked and dropped, of mixed size, and the memory that the process holds.

    PYTHONPATH=build/release/python bench/python_cycles.py [--cycles 1000000]

n = 2 ... 33 points, 1 to 4 inputs, 1 to 3 outputs, exact and planned; a small CMA-ES each; every
1000th cycle an evaluation with callables and one that raises. Prints resident memory ten times.
"""
import argparse
import os
import time

import downpour as dp
import numpy as np

POINTS = np.random.default_rng(0).uniform(-1, 1, size=(40, 4))


def resident_megabytes():
    with open("/proc/self/statm", encoding="ascii") as file:
        return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20


def fails(theta, features, t):
    raise RuntimeError


def cycle(i):
    n, dim, outputs = 2 + i % 32, 1 + i % 4, 1 + i % 3
    x = POINTS[:n, :dim]
    gp = dp.GaussianProcess(x, np.sin(3 * x[:, :1] + np.arange(outputs)), np.ones((outputs, dim)),
                            np.ones(outputs), np.full(outputs, 0.1), threads=1,
                            tolerance=0.02 if i % 50 == 0 else 0)
    gp.predict(POINTS[:7, :dim], threads=1)
    search = dp.CMAES(np.zeros(1 + i % 6), 1.0, seed=i)
    search.tell(search.ask(), np.zeros(search.population))
    if i % 1000 == 0:
        gp = dp.GaussianProcess(POINTS[:, :3], POINTS[:, :2], np.ones((2, 3)), [1, 1], [0.1, 0.1])
        arguments = dict(start=[0, 0], reward=lambda s, a, t: s[:, 0], threads=2)
        dp.Evaluator(gp, policy=lambda p, x, t: x[:, :1], **arguments).evaluate(np.ones((9, 1)))
        try:
            dp.Evaluator(gp, policy=fails, **arguments).evaluate(np.ones((9, 1)))
        except RuntimeError:
            pass


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cycles", type=int, default=1_000_000)
    cycles = parser.parse_args().cycles
    start = time.perf_counter()
    for i in range(cycles):
        cycle(i)
        if (i + 1) % max(1, cycles // 10) == 0:
            print(f"{i + 1:8d} cycles, {time.perf_counter() - start:6.1f} s, resident "
                  f"{resident_megabytes():.2f} MiB", flush=True)


if __name__ == "__main__":
    main()
