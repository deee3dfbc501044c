# SPDX-License-Identifier: Apache-2.0
"""Priors of the dynamics, by the command: options, files, threads, resume, refusals."""
import csv
import pathlib
import sys
import tomllib

from command import (Claims, contents, downpour, learn, PROGRAM, results, scratch_directory,
                     TINY)

TOP = pathlib.Path(__file__).resolve().parents[2]
FREE = "pole:mass=0.2..2, pole:damping=0..0.1"
SHORT = ["--set", "prior.evaluations=8"]

claims = Claims()
scratch = scratch_directory()


def prior_file(mass="0.6", name="prior.xml"):
    """The built-in pendulum with another mass and a coarse timestep."""
    text = (TOP / "tasks" / "pendulum" / "pendulum.xml").read_text()
    for old, new in (('timestep="0.0025"', 'timestep="0.05"'), ('mass="1"', f'mass="{mass}"')):
        assert old in text
        text = text.replace(old, new)
    path = scratch / name
    path.write_text(text)
    return path


def refused(claim, result, *parts):
    claims.check(claim, result.returncode != 0 and result.stderr.count("\n") == 1 and
                 all(part in result.stderr for part in parts), result)


def files():
    learn(scratch / "plain")
    claims.check("without a prior a run has no file of one",
                 not any("prior" in name for name in contents(scratch / "plain")) and
                 '"prior"' not in (scratch / "plain" / "checkpoint.json").read_text())
    learn(scratch / "run", "--prior", prior_file(), "--prior-free", FREE, *SHORT)
    with open(scratch / "run" / "prior.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    claims.check("prior.csv: a row an episode with a model, its parameters within their ranges",
                 [row["episode"] for row in rows] == ["2", "3", "4"] and
                 all(0.2 <= float(row["pole:mass [kg]"]) <= 2 and
                     0 <= float(row["pole:damping [N m s/rad]"]) <= 0.1 and
                     int(row["evaluations"]) == 16 for row in rows), rows)
    with open(scratch / "run" / "prior_timing.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    claims.check("prior_timing.csv: what a prediction took, and its share",
                 len(rows) == 3 and all(float(row["step_time [ns]"]) > 0 and
                                        0 < float(row["rollout_share"]) < 1 for row in rows), rows)
    config = tomllib.loads((scratch / "run" / "config.toml").read_text())["prior"]
    claims.check("config.toml keeps the prior", config["free"] == FREE and
                 config["model"] == str(scratch / "prior.xml"), config)


def log():
    result = downpour("learn", "pendulum", "--out", scratch / "log", "--prior", prior_file(),
                      "--prior-free", FREE, *SHORT, *TINY)
    claims.check("the log names parameters with units, the likelihood and what a step costs",
                 "episode 2: prior pole:mass " in result.stderr and " kg, " in result.stderr and
                 "log likelihood" in result.stderr and "ns a step" in result.stderr, result.stderr)


def example():
    result = downpour("learn", "cartpole", "--out", scratch / "example", "--prior",
                      TOP / "docs" / "cartpole_prior.xml", "--prior-free",
                      "pole:mass=0.1..1, cart:damping=0..0.5", "--episodes", "2", "--evaluations",
                      "600", "--set", "search.final_rollouts=24", "--quiet")
    with open(scratch / "example" / "prior.csv", newline="") as file:
        row = list(csv.DictReader(file))[0]
    # 4 s of random actions with observation noise; the tolerance is a tenth of the ranges.
    claims.check("the example of docs/priors.md: the truth is found from one random episode",
                 result.returncode == 0 and abs(float(row["pole:mass [kg]"]) - 0.5) < 0.09 and
                 abs(float(row["cart:damping [N s/m]"]) - 0.1) < 0.05, row)


def predict():
    result = downpour("predict", scratch / "run", "--rollouts", "3")
    claims.check("predict: rollouts of the model with its prior", result.returncode == 0, result)


def threads():
    five = [*TINY[:-1], "5"]
    result = downpour("learn", "pendulum", "--out", scratch / "five", "--quiet", "--prior",
                      prior_file(), "--prior-free", FREE, *SHORT, *five)
    ours, theirs = results(scratch / "five"), results(scratch / "run")
    for one in (ours, theirs):
        del one["config.toml"]  # names the threads
    claims.check("five threads give the files of two", result.returncode == 0 and ours == theirs,
                 result)


def robot():
    program = f"exec:{sys.executable} {TOP / 'tools' / 'robot_example.py'} {PROGRAM}"
    learn(scratch / "robot", "--prior", prior_file(), "--prior-free", FREE, *SHORT, "--system",
          program)
    same = [(scratch / run / "prior.csv").read_text() for run in ("robot", "run")]
    claims.check("a robot may have a prior: the same as on the simulator", same[0] == same[1])


def resume():
    cut = scratch / "cut"
    two = ["2" if word == "4" else word for word in TINY]  # of the episodes
    prior_file()
    result = downpour("learn", "pendulum", "--out", cut, "--quiet", "--prior", "prior.xml",
                      "--prior-free", FREE, *SHORT, *two, cwd=scratch)
    claims.check("a run of two episodes ends well", result.returncode == 0, result)
    result = downpour("learn", "--resume", cut, "--episodes", "4", "--quiet", cwd="/")
    claims.check("resumed from another folder, it ends with the files of the uninterrupted run",
                 result.returncode == 0 and results(cut) == results(scratch / "run"), result)
    before = contents(cut)
    resumed = ["learn", "--resume", cut, "--episodes", "5", "--quiet"]
    prior_file("0.7")
    refused("resumed with a prior whose file has changed, it is refused", downpour(*resumed),
            "task.prior", "must be equal to resume")
    (scratch / "prior.xml").unlink()
    refused("resumed without the file, it is refused", downpour(*resumed), "prior.xml",
            "cannot be read")
    prior_file()
    refused("--resume takes no --prior", downpour(*resumed, "--prior", "x.xml"), "--prior")
    config = (cut / "config.toml").read_text()
    for line in config.splitlines():
        if line.startswith(("model = ", "free = ")):
            config = config.replace(line, line.split(" = ")[0] + ' = ""')
    (cut / "config.toml").write_text(config)
    refused("a run with a prior is not resumed without", downpour(*resumed), "with a prior")
    after = contents(cut)
    del before["config.toml"], after["config.toml"]
    claims.check("what was refused changed nothing", before == after)
    evaluated = downpour("evaluate", scratch / "run", "--starts", "2")
    claims.check("evaluate needs no prior", evaluated.returncode == 0, evaluated)


def refusals():
    def refuse(claim, *arguments):
        *options, part = arguments
        out = scratch / "none"
        result = downpour("learn", "pendulum", "--out", out, *options)
        refused(claim, result, part)
        claims.check("nothing written", not out.exists())

    path = prior_file()
    refuse("a prior that is not there", "--prior", scratch / "no.xml", "no.xml: cannot be read")
    refuse("a prior of another robot", "--prior", TOP / "docs" / "cartpole_prior.xml",
           "exactly the joints pole")
    refuse("an unknown quantity", "--prior", path, "--prior-free", "pole:colour",
           "unknown quantity colour; allowed: mass")
    refuse("an unknown body", "--prior", path, "--prior-free", "rod:mass", "no body named rod")
    refuse("a range upside down", "--prior", path, "--prior-free", "pole:mass=2..1", "LOW < HIGH")
    refuse("a range without the file's value", "--prior", path, "--prior-free", "pole:mass=1..2",
           "must contain")
    refuse("free parameters of nothing", "--prior-free", FREE, "prior.free")
    refuse("no tries", "--prior", path, "--set", "prior.evaluations=0", "prior.evaluations")


files()
log()
example()
predict()
threads()
robot()
resume()
refusals()
claims.exit()
