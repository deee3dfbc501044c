# SPDX-License-Identifier: Apache-2.0
"""A run has the same bits for any number of threads, and bound threads have all processors."""
import os
import re
import shutil

from command import Claims, downpour, results, scratch_directory

TINY = ["--evaluations", "1500", "--set", "search.final_rollouts=30", "--set",
        "model.max_evaluations=40", "--set", "model.restarts=2", "--episodes", "4"]

claims = Claims()
scratch = scratch_directory()


def compare(claim, task, *options):
    files = {}
    for threads in (1, 2, 5):
        run = scratch / f"{task}-{threads}"
        result = downpour("learn", task, "--out", run, "--threads", threads, "--quiet", *TINY,
                          *options)
        if result.returncode != 0:
            claims.check(f"{claim}: runs", False, result.stderr)
            return
        files[threads] = results(run)
        del files[threads]["config.toml"]  # names the threads
        shutil.rmtree(run)
    claims.check(f"{claim}: the run says something", files[1]["episodes.csv"].count("\n") == 5)
    for name in files[1]:
        claims.check(f"{claim}: {name} is the same for 1, 2 and 5 threads",
                     files[1][name] == files[2][name] == files[5][name])


compare("pendulum", "pendulum")
compare("cart-pole, five rollouts, seed 7", "cartpole", "--rollouts", "5", "--seed", "7")
compare("cart-pole, rollouts that grow, small restarts", "cartpole", "--set",
        "search.uncertainty=rollouts", "--set", "search.restarts=small", "--set",
        "search.max_rollouts=8")
compare("pendulum, means only", "pendulum", "--no-variance")
compare("pendulum, by OpenBLAS", "pendulum", "--backend", "blas")

# The program starts itself again, where it may have been bound to one place already.
threads = [re.search(r"^threads +(\d+)", downpour("doctor", env={**os.environ, **env}).stdout, re.M)
           for env in ({}, {"OMP_PROC_BIND": "close", "OMP_PLACES": "cores"})]
claims.check("doctor: OMP_PROC_BIND leaves as many threads", all(threads) and
             threads[0].group(1) == threads[1].group(1), threads)
claims.exit()
