# SPDX-License-Identifier: Apache-2.0
"""A run that several processes share ends with the bits of one process."""
import os
import pathlib
import signal
import time

from command import TINY, Claims, downpour, learn, results, scratch_directory
from mpi import ended, mpirun, process_of, said, start_mpirun

claims = Claims()
scratch = scratch_directory()

TASKS = pathlib.Path(__file__).resolve().parents[2] / "tasks"


def same_bits(name, *arguments, task="pendulum", ranks=(2, 4)):
    alone = scratch / f"{name}1"
    learn(alone, *arguments, task=task)
    for n in ranks:
        path = scratch / f"{name}{n}"
        result = mpirun(n, "learn", task, "--out", path, "--quiet", *TINY[:-1], "1",
                        *arguments)
        if result.returncode != 0:
            claims.check(f"{name}: {n} processes learn", False, result)
            continue
        expected, got = (results(directory) for directory in (alone, path))
        for files in (expected, got):
            files["config.toml"] = files["config.toml"].replace("threads = 2", "threads = 1")
        differ = [file for file in expected if expected[file] != got.get(file)]
        claims.check(f"{name}: {n} processes learn the bits of one",
                     not differ and len(got) == len(expected),
                     (differ, result))


def lost_rank():
    """The job ends, and its run can be gone on with."""
    long = ["--evaluations", "30000"]
    alone, path = scratch / "whole", scratch / "lost"
    downpour("learn", "pendulum", "--out", alone, "--quiet", *TINY[2:], *long)
    process = start_mpirun(2, "learn", "pendulum", "--out", path, "--quiet", *TINY[2:], *long)
    while not (path / "policy_2.json").exists() and process.poll() is None:
        time.sleep(0.01)
    os.kill(process_of(1, path), signal.SIGKILL)
    _, error = ended(process)
    told = [line for line in error.splitlines() if line.startswith("downpour: ")]
    claims.check("a lost rank ends the run with what is kept and how to go on",
                 process.returncode != 0 and len(told) == 1 and "go on with: " in told[0] and
                 "are kept in" in told[0], error)
    resumed = mpirun(3, "learn", "--resume", path, "--quiet")
    claims.check("which other processes do, to the same end",
                 resumed.returncode == 0 and results(alone) == results(path), resumed)


def refused():
    for arguments, reason in (
            (["--set", "search.stop_lost_causes=true"], "search.stop_lost_causes = true: must be "
             "false with several processes"),
            (["--backend", "blas"], "model.backend = blas: must be fused with several processes"),
            (["--algorithm", "pilco"], "learn.algorithm = pilco: must be black-drops with several"),
            (["--evaluation", "9"], "unknown option --evaluation"),
            (["--seed", "-1"], "--seed")):
        path = scratch / "refused"
        result = mpirun(2, "learn", "pendulum", "--out", path, *arguments)
        claims.check(f"{' '.join(arguments)} is refused once, before there is a run",
                     result.returncode == 2 and len(said(result)) == 1 and
                     reason in result.stderr and not path.exists(), result)
    result = mpirun(2, "learn", "pendulum", "--out", scratch / "pendulum1", *TINY)
    claims.check("a run that is there is left alone",
                 result.returncode == 2 and "is not empty" in result.stderr, result)


same_bits("pendulum")
same_bits("rollouts", "--set", "search.rollouts=3", "--set", "learn.learn_reward=true", ranks=(3,))
coarse = scratch / "prior.xml"
coarse.write_text((TASKS / "pendulum/pendulum.xml").read_text().replace(
    'timestep="0.0025"', 'timestep="0.05"'))
same_bits("prior", "--prior", coarse, "--set", "prior.evaluations=8", ranks=(3,))
same_bits("file", task=TASKS / "cartpole/cartpole.toml", ranks=(2,))
lost_rank()
refused()
claims.exit()
