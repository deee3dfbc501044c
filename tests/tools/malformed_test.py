# SPDX-License-Identifier: Apache-2.0
"""Malformed task files, MJCF files and robots' answers: one line that says what, and nothing lost.

malformed/expected.txt has a line for each file: its name and, behind tabs, what the message says.
"""
import concurrent.futures
import csv
import pathlib
import shlex
import sys

from command import TINY, Claims, contents, downpour, learn, scratch_directory

HERE = pathlib.Path(__file__).parent
FOLDER = HERE / "malformed"
claims = Claims()
scratch = scratch_directory()
run = scratch / "run"
learn(run)


def command(name, out):
    """What reads the file."""
    file = FOLDER / name
    if name.startswith("tasks/"):
        return ["learn", file, "--out", out, *TINY]
    if name.startswith("models/"):
        return ["learn", "pendulum", "--mjcf", file, "--out", out, *TINY]
    player = shlex.join([sys.executable, "-S", "-E", str(HERE / "answer_robot.py"), str(file)])
    return ["learn", "pendulum", "--out", out, "--quiet", *TINY, "--system", f"exec:{player}",
            "--set", "system.timeout=60"]


def kept_steps(out):
    with open(out / "transitions.csv", newline="") as file:
        return len(list(csv.DictReader(file)))


def check(name, *words):
    """The claim that the file is refused in the right words, with what was wrong if it was not."""
    out = scratch / name.replace("/", "-")
    result = downpour(*command(name, out))
    lines = result.stderr.splitlines()
    at_a_step = name.startswith("answers/step")
    codes = [3] if at_a_step else [2, 3] if name.startswith("answers/") else [2]
    holds = (result.returncode in codes and result.stdout == "" and len(lines) == 1 and
             lines[0].startswith("downpour: ") and all(word in lines[0] for word in words))
    if at_a_step:  # the third one: two are kept
        holds = holds and "aborted at step 2" in lines[0] and kept_steps(out) == 2
    else:
        holds = holds and not out.exists()
    return name, holds, f"exit code {result.returncode}, wanted {words}: {result.stderr[:600]!r}"


expected = [line.split("\t") for line in (FOLDER / "expected.txt").read_text().splitlines()]
before = contents(run)
with concurrent.futures.ThreadPoolExecutor(4) as pool:
    for outcome in pool.map(lambda line: check(*line), expected):
        claims.check(*outcome)
names = {str(path.relative_to(FOLDER)) for path in FOLDER.glob("*/*")}
claims.check("every file has its expectation, and there are 100 at least",
             names - {"tasks/good.toml", "tasks/good.xml"} == {line[0] for line in expected} and
             len(expected) >= 100)
claims.check("the task that the malformed ones are made of is fine",
             downpour("tasks", FOLDER / "tasks/good.toml").returncode == 0)
claims.check("a run beside them is what it was", contents(run) == before)
claims.exit()
