# SPDX-License-Identifier: Apache-2.0
"""A run that is killed or interrupted, however often, ends with the bits of one that is not."""
import json
import os
import random
import shlex
import signal
import subprocess
import time

from command import PROGRAM, TINY, Claims, downpour, learn, results, scratch_directory

KILLS = 24  # at least

claims = Claims()
scratch = scratch_directory()


def start(run):
    """Begins the run, or goes on with what is there of it."""
    if (run / "config.toml").exists():
        arguments = ["--resume", run]
    else:
        arguments = ["pendulum", "--out", run, *TINY]
    return subprocess.Popen([PROGRAM, "learn", *arguments], stdout=subprocess.DEVNULL,
                            stderr=subprocess.PIPE, text=True)


def killed_run(run, longest, generator):
    """Kills the run at random moments until it gets to its end; returns the number of kills."""
    kills = 0
    while True:
        process = start(run)
        # Half of the kills early, so that a run gets several.
        time.sleep(longest * generator.uniform(0, generator.choice([0.3, 1])))
        process.kill()
        _, error = process.communicate()
        if process.returncode == 0:
            return kills
        if process.returncode != -signal.SIGKILL:
            claims.check("a killed run can be resumed", False, error)
            claims.exit()
        kills += 1


def random_kills():
    reference = scratch / "reference"
    begin = time.monotonic()
    learn(reference)
    longest = time.monotonic() - begin
    expected = results(reference)
    generator = random.Random(1)
    kills = 0
    runs = 0
    while kills < KILLS:
        run = scratch / f"run{runs}"
        kills += killed_run(run, longest, generator)
        runs += 1
        found = results(run)
        differing = [name for name in sorted(expected.keys() | found.keys())
                     if expected.get(name) != found.get(name)]
        if differing:
            claims.check(f"run {runs} has the same bits", False, f"differing: {differing}")
    claims.check(f"{runs} runs killed {kills} times end with the bits of one that was not "
                 "(episodes, transitions, hyper-parameters, policies, checkpoint)",
                 claims.failures == 0)


def interrupt(number):
    """Ctrl-C in the search of episode 3."""
    name = number.name
    options = ["--episodes", "3", "--evaluations", "20000", "--threads", "2"]
    run = scratch / f"it's a run, {name}"
    process = subprocess.Popen([PROGRAM, "learn", "pendulum", "--out", run, *options],
                               stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    for line in process.stderr:
        if line.startswith("episode 3: search"):
            break
    process.send_signal(number)
    output, error = process.communicate()
    last = error.splitlines()[-1]
    claims.check(f"{name}: exit code {128 + number}", process.returncode == 128 + number,
                 process.returncode)
    claims.check(f"{name}: says what is kept and how to go on",
                 last == f"downpour: interrupted; episodes 1 to 2 are kept in {run}; "
                 f"go on with: {shlex.join([PROGRAM])} learn --resume '" +
                 str(run).replace("'", "'\\''") + "'", error)
    claims.check(f"{name}: the finished episodes were reported", len(output.splitlines()) == 3,
                 output)
    pasted = last.split("go on with: ")[1] + " --json"
    resumed = subprocess.run(pasted, shell=True, capture_output=True, text=True)
    claims.check(f"{name}: pasted into a shell, the line goes on with the next episode",
                 resumed.returncode == 0 and resumed.stdout.startswith('{"episode":3,') and
                 len(resumed.stdout.splitlines()) == 1, resumed)
    reference = scratch / f"{name}-reference"
    learn_arguments = ["learn", "pendulum", "--out", reference, "--quiet", *options]
    claims.check(f"{name}: ends with the bits of a run that was not interrupted",
                 downpour(*learn_arguments).returncode == 0 and
                 results(run) == results(reference))


def more_episodes():
    reference = scratch / "reference"
    run = scratch / "longer"
    tiny = [argument if argument != "4" else "2" for argument in TINY]
    downpour("learn", "pendulum", "--out", run, "--quiet", *tiny)
    downpour("learn", "--resume", run, "--episodes", "4", "--threads", "3", "--quiet")
    same = {name: text for name, text in results(run).items() if name != "config.toml"}
    expected = {name: text for name, text in results(reference).items() if name != "config.toml"}
    claims.check("a finished run takes more episodes, with the bits of a longer run",
                 same == expected)
    claims.check("config.toml has the new number of episodes",
                 "\nepisodes = 4\n" in (run / "config.toml").read_text())
    again = downpour("learn", "--resume", run)
    claims.check("a run that is done stays as it is", again.returncode == 0 and
                 again.stdout == "" and again.stderr.startswith(
                     f"{run} already has 4 episodes; --episodes M for more\n") and results(run)["episodes.csv"] == expected["episodes.csv"],
                 again)


def kept_backend():
    tiny = [argument if argument != "4" else "3" for argument in TINY]
    whole, resumed = scratch / "blas", scratch / "blas-resumed"
    learn(whole, "--backend", "blas")
    downpour("learn", "pendulum", "--out", resumed, "--quiet", *tiny, "--backend", "blas")
    again = downpour("learn", "--resume", resumed, "--episodes", "4")
    claims.check("progress names OpenBLAS", "of 120 points by OpenBLAS\n" in again.stderr, again)
    claims.check("a run by OpenBLAS goes on by OpenBLAS, with the bits of an uninterrupted one",
                 results(resumed) == results(whole))
    plans = [row.split(",") for row in (resumed / "plans.csv").read_text().splitlines()]
    claims.check("plans.csv names the backend: exact fp64 by OpenBLAS throughout",
                 plans[0][2] == "backend" and len(plans) == 1 + 3 * 2 and
                 all(row[2] == "blas" and row[3] == row[4] and row[5] == "fp64"
                     for row in plans[1:]), plans)


def one_writer():
    run = scratch / "locked"
    options = ["--episodes", "3", "--evaluations", "200000", "--threads", "2"]
    process = subprocess.Popen([PROGRAM, "learn", "pendulum", "--out", run, *options],
                               stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    for line in process.stderr:
        if line.startswith("episode 3: search"):
            break
    second = downpour("learn", "--resume", run)
    claims.check("a second process is refused in one line", second.returncode == 2 and
                 second.stderr == f"downpour: {run}: another process is writing this run: wait for "
                 "its end, or stop it\n", second)
    claims.check("a run that is being written can be evaluated",
                 downpour("evaluate", run, "--starts", "1").returncode == 0)
    process.kill()
    process.communicate()
    claims.check("once the first one is killed, the run goes on",
                 downpour("learn", "--resume", run, "--quiet").returncode == 0)


def other_kernels():
    """A run that goes on with other OpenBLAS kernels than it began with."""
    run = scratch / "kernels"
    learn(run)
    core = json.loads((run / "checkpoint.json").read_text())["payload"]["episodes"][0]["blas_core"]
    other = "Nehalem" if core == "Haswell" else "Haswell"
    environment = dict(os.environ, OPENBLAS_CORETYPE=other)
    for episodes in ("5", "6"):  # the second time, too: the first episodes stay what they are
        result = downpour("learn", "--resume", run, "--episodes", episodes, "--quiet",
                          env=environment)
        claims.check(f"other OpenBLAS kernels, episode {episodes}: one line says that bits differ",
                     result.returncode == 0 and len(result.stderr.splitlines()) == 1 and
                     "not be bit-identical" in result.stderr and
                     f"OpenBLAS kernels {core}, now {other}" in result.stderr, result)


random_kills()
one_writer()
other_kernels()
interrupt(signal.SIGINT)
interrupt(signal.SIGTERM)
more_episodes()
kept_backend()
claims.exit()
