# SPDX-License-Identifier: Apache-2.0
"""What the command prints and writes can be read by other programs."""
import csv
import json
import math
import os
import pathlib
import re
import shutil
import subprocess

from command import PROGRAM, TINY, Claims, downpour, learn, results, scratch_directory

KEYS = ["episode", "interaction_seconds", "points", "model_seconds", "search_seconds",
        "rollout_seconds", "evaluations", "gp_queries", "rollout_ns_per_gp_query", "lane_fill",
        "idle_share", "predicted_return", "return", "solved", "steps", "outcome"]

claims = Claims()
scratch = scratch_directory()
run = scratch / "run"


def json_lines():
    result = downpour("learn", "pendulum", "--out", run, "--json", *TINY)
    episodes = [json.loads(line) for line in result.stdout.splitlines()]
    claims.check("--json: one object a line and episode, nothing else",
                 result.returncode == 0 and [e["episode"] for e in episodes] == [1, 2, 3, 4],
                 result)
    claims.check("--json: exactly the documented keys, in their order",
                 all(list(e) == KEYS for e in episodes), episodes)
    claims.check("--json: predicted_return is null for the random episode only",
                 [e["predicted_return"] is None for e in episodes] == [True, False, False, False])
    claims.check("--json: 40 steps an episode and two outputs make the GP queries",
                 all(e["gp_queries"] == 80 * e["evaluations"] for e in episodes), episodes)
    claims.check("--json: the rollouts take a part of the search's time, and each query its share",
                 all(0 < e["rollout_seconds"] < e["search_seconds"] and
                     math.isclose(e["rollout_ns_per_gp_query"] * e["gp_queries"],
                                  1e9 * e["rollout_seconds"], rel_tol=1e-12)
                     for e in episodes[1:]), episodes)
    claims.check("--json: lanes are filled and threads idle by a share, null if no rollouts ran",
                 all(0 < e["lane_fill"] <= 1 and 0 <= e["idle_share"] < 1 for e in episodes[1:])
                 and episodes[0]["lane_fill"] is episodes[0]["idle_share"] is None, episodes)
    claims.check("--json: the search keeps its budget",
                 all(0 < e["evaluations"] <= 600 for e in episodes[1:]), episodes)
    claims.check("--json: the log is on standard error, without control characters",
                 "episode 2" in result.stderr and "% full, threads" in result.stderr and
                 all(c.isprintable() or c == "\n" for c in result.stderr), result.stderr)


def plain_output():
    result = downpour("learn", "pendulum", "--out", scratch / "plain", *TINY)
    lines = result.stdout.splitlines()
    claims.check("the table has a header and one line an episode",
                 len(lines) == 5 and lines[0].split()[0] == "episode" and
                 [line.split()[0] for line in lines[1:]] == ["1", "2", "3", "4"], result.stdout)
    claims.check("the table's lines are of one width, less than 80 columns",
                 len({len(line) for line in lines}) == 1 and len(lines[0]) < 80, result.stdout)
    claims.check("no control characters when the output is no terminal",
                 all(c.isprintable() or c == "\n" for c in result.stdout + result.stderr))
    claims.check("the last line says how it ended and where the files are",
                 "best return" in result.stderr.splitlines()[-1] and
                 str(scratch / "plain") in result.stderr.splitlines()[-1], result.stderr)
    quiet = downpour("learn", "pendulum", "--out", scratch / "quiet", "--quiet", *TINY)
    claims.check("--quiet: silent", quiet.returncode == 0 and quiet.stdout + quiet.stderr == "",
                 quiet)
    claims.check("how a run reports does not change it",
                 results(run) == results(scratch / "plain") == results(scratch / "quiet"))


def run_directory():
    def table(name):
        with open(run / name, newline="") as file:
            return list(csv.reader(file))

    for name, rows, columns in [("episodes.csv", 4, ["episode", "predicted_return", "solved"]),
                                ("timing.csv", 4, ["episode", "search_seconds [s]",
                                                   "lane_fill", "idle_share"]),
                                ("transitions.csv", 160, ["time [s]", "action.torque [N m]",
                                                          "observation.angle [rad]"]),
                                ("plans.csv", 3 * 2, ["output", "backend", "points", "precision"]),
                                ("hyperparameters.csv", 3 * 2 * 7, ["output", "unit", "value"])]:
        header, *body = table(name)
        claims.check(f"{name}: names and units in the header, {rows} rows as wide as it",
                     all(c in header for c in columns) and len(body) == rows and
                     all(len(row) == len(header) for row in body), header)
    _, *timing = table("timing.csv")
    claims.check("timing.csv: a query of every output took some time, but no second",
                 all(0 < float(field) < 1e9 for row in timing[1:] for field in row[-3:]), timing)
    policy = json.loads((run / "policy.json").read_text())
    claims.check("policy.json: the parameters of the last episode's network",
                 policy["episode"] == 4 and len(policy["parameters"]) == 3 * 10 + 10 + 10 + 1)
    claims.check("policy.json is the last of the policies of the episodes",
                 (run / "policy.json").read_bytes() == (run / "policy_4.json").read_bytes())
    claims.check("no temporary file is left", not list(run.glob("*.tmp")))


def configuration():
    again = scratch / "again"
    result = downpour("learn", "--config", run / "config.toml", "--out", again, "--quiet")
    claims.check("config.toml repeats the run by --config",
                 result.returncode == 0 and results(again) == results(run), result.stderr)
    file = scratch / "file.toml"
    file.write_text("task = 'pendulum'\n[learn]\nseed = 5\nepisodes = 3\nthreads = 1\n"
                    "[search]\nrollouts = 3\nevaluations = 1e3\n")
    downpour("learn", "--config", file, "--set", "learn.seed=6", "--set", "learn.episodes=2",
             "--episodes", "4", "--out", scratch / "order", "--quiet")
    text = (scratch / "order" / "config.toml").read_text()
    claims.check("options override --set, which overrides --config, which overrides the task's own",
                 all(f"\n{line}\n" in text for line in
                     ("episodes = 4", "seed = 6", "rollouts = 3", "evaluations = 1000")), text)
    learn(scratch / "seed0", "--seed", "0")
    learn(scratch / "seed1", "--seed", "1")
    claims.check("seed 0 is the default seed, seed 1 another",
                 results(scratch / "seed0") == results(run) and
                 results(scratch / "seed1")["episodes.csv"] != results(run)["episodes.csv"])


def default_directories():
    for _ in range(3):
        downpour("learn", "pendulum", "--quiet", *TINY, cwd=scratch)
    names = sorted(path.name for path in (scratch / "runs").iterdir())
    claims.check("a run without --out gets a directory of its own",
                 names == ["pendulum-seed0", "pendulum-seed0-2", "pendulum-seed0-3"], names)


def diverged_starts():
    """A pole that a damper of the wrong sign drives."""
    own = (pathlib.Path(__file__).parents[2] / "tasks/pendulum/pendulum.xml").read_text()
    model = scratch / "model.xml"
    model.write_text(own)
    learn(scratch / "driven", "--mjcf", model)
    model.write_text(re.sub('damping="[^"]*"', 'damping="-100"', own))
    result = downpour("evaluate", scratch / "driven", "--starts", "3", "--json")
    claims.check("evaluate: starts that diverge count as a return of 0 and not solved",
                 result.returncode == 0 and
                 [json.loads(result.stdout)[key] for key in ("mean", "solved_share", "diverged")] ==
                 [0, 0, 3], result)
    result = downpour("evaluate", scratch / "driven", "--starts", "3")
    claims.check("evaluate: says how many starts diverged",
                 "diverged 3 of 3" in result.stdout.splitlines()[-1], result)


def other_commands():
    result = downpour("evaluate", run, "--starts", "8", "--json")
    figures = json.loads(result.stdout)
    claims.check("evaluate --json: ordered quartiles, share solved",
                 figures["minimum"] <= figures["quartile_1"] <= figures["median"] <=
                 figures["quartile_3"] <= figures["maximum"] and
                 0 <= figures["solved_share"] <= 1 and figures["starts"] == 8, figures)
    exact = downpour("evaluate", run, "--starts", "1", "--start-std", "0", "--json")
    episode = list(csv.DictReader(open(run / "episodes.csv")))[-1]
    claims.check("evaluate without noise gives the return of the run itself",
                 json.loads(exact.stdout)["mean"] == float(episode["return"]), exact.stdout)
    strange = shutil.copytree(run, os.fsdecode(os.fsencode(scratch) + b"/\xff"))
    result = subprocess.run([PROGRAM, "evaluate", strange, "--starts", "1", "--json"],
                            capture_output=True)
    claims.check("evaluate --json: a path that is not UTF-8 gives valid JSON",
                 result.returncode == 0 and
                 json.loads(result.stdout.decode())["run"].endswith("/\ufffd"), result)
    help_text = downpour("learn", "--help").stdout
    claims.check("learn --help: --no-variance says what it does",
                 "Use means only (the paper's No Var)." in " ".join(help_text.split()), help_text)
    claims.check("learn --help and evaluate --help: the options' defaults",
                 "(default 300000)" in help_text and "default: the task's own" in " ".join(help_text.split()) and
                 "(default 100)" in downpour("evaluate", "--help").stdout, help_text)
    listing = downpour("tasks").stdout
    claims.check("tasks: every task with its units",
                 all(word in listing for word in ("pendulum", "cartpole", "[rad/s]", "[N m]")))
    doctor = downpour("doctor")
    claims.check("doctor: SIMD, threads, OpenBLAS, FMA peak, MuJoCo", doctor.returncode == 0 and
                 all(word in doctor.stdout for word in
                     ("CPU", "SIMD", "threads", "OpenBLAS", "fp64", "fp32", "MuJoCo")), doctor)
    for arguments in (["--help"], ["learn", "--help"], ["evaluate", "--help"], ["--version"]):
        result = downpour(*arguments)
        claims.check(f"{' '.join(arguments)}: on standard output, exit code 0",
                     result.returncode == 0 and result.stdout != "" and result.stderr == "")


json_lines()
plain_output()
run_directory()
configuration()
default_directories()
diverged_starts()
other_commands()
claims.exit()
