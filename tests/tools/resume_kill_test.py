# SPDX-License-Identifier: Apache-2.0
"""A run that is killed or interrupted, however often, ends with the bits of one that is not."""
import random
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
    run = scratch / name
    process = subprocess.Popen([PROGRAM, "learn", "pendulum", "--out", run, *options],
                               stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    for line in process.stderr:
        if line.startswith("episode 3: search"):
            break
    process.send_signal(number)
    output, error = process.communicate()
    last = error.splitlines()[-1]
    claims.check(f"{name}: exit code 130", process.returncode == 130, process.returncode)
    claims.check(f"{name}: says what is kept and how to go on",
                 last == f"downpour: interrupted; episodes 1 to 2 are kept in {run}; "
                 f"go on with: downpour learn --resume {run}", error)
    claims.check(f"{name}: the finished episodes were reported", len(output.splitlines()) == 3,
                 output)
    resumed = downpour("learn", "--resume", run, "--json")
    claims.check(f"{name}: goes on with the next episode",
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
                 again.stdout == "" and results(run)["episodes.csv"] == expected["episodes.csv"],
                 again)


random_kills()
interrupt(signal.SIGINT)
interrupt(signal.SIGTERM)
more_episodes()
claims.exit()
