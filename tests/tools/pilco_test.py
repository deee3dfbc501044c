# SPDX-License-Identifier: Apache-2.0
"""PILCO by the command: runs, their files, resume, threads, studies, refusals."""
import csv
import json
import tomllib

from command import Claims, contents, downpour, results, scratch_directory

# A run of seconds' fractions.
TINY = ["--algorithm", "pilco", "--policy-points", "4", "--set", "pilco.evaluations=12", "--set",
        "model.max_evaluations=30", "--episodes", "4", "--threads", "2"]

claims = Claims()
scratch = scratch_directory()
whole = scratch / "whole"


def rows(run, name):
    with open(run / name, newline="") as file:
        return list(csv.DictReader(file))


def plain():
    result = downpour("learn", "pendulum", "--out", whole, *TINY)
    claims.check("learns", result.returncode == 0, result)
    lines = result.stdout.splitlines()
    claims.check("the table: values in place of rollouts, no GP queries",
                 "values" in lines[0] and len({len(line) for line in lines}) == 1 and
                 all(line.split()[6] == "-" for line in lines[1:]), result.stdout)
    config = tomllib.loads((whole / "config.toml").read_text())
    claims.check("config.toml: algorithm, the gp policy, and no setting that is not used",
                 config["learn"]["algorithm"] == "pilco" and config["policy"]["kind"] == "gp" and
                 config["pilco"] == {"restarts": 2, "evaluations": 12, "start_std": 0.1} and
                 config["search"] == {"bound": 5.0} and "rollout" not in config and
                 "prior" not in config and "tolerance" not in config["model"], config)
    claims.check("episodes.csv: evaluations, no queries",
                 all(int(row["evaluations [rollouts]"]) >= 3 and row["gp_queries"] == "0" and
                     float(row["predicted_return"]) > 0
                     for row in rows(whole, "episodes.csv")[1:]))
    claims.check("plans.csv is empty", rows(whole, "plans.csv") == [])
    claims.check("timing.csv: no rollouts", all(
        row["rollout_seconds [s]"] == "0" and row["lane_fill"] == "" and
        row["rollout_time_per_gp_query [ns]"] == "" and
        row["gp_query_time.angle [ns]"] == "" for row in rows(whole, "timing.csv")))
    claims.check("policy.json: the gp policy", json.loads((whole / "policy.json").read_text())
                 ["kind"] == "gp")
    again = scratch / "again"
    downpour("learn", "--config", whole / "config.toml", "--out", again, "--quiet")
    claims.check("config.toml: read again, the same run", results(again) == results(whole))
    other = downpour("learn", "pendulum", "--out", scratch / "linear", "--policy", "linear",
                     "--json", *TINY)
    last = json.loads(other.stdout.splitlines()[-1])
    claims.check("--policy linear, --json", other.returncode == 0 and last["gp_queries"] == 0 and
                 last["rollout_ns_per_gp_query"] is None and last["lane_fill"] is None, other)


def same_bits():
    short = scratch / "short"
    tiny = ["2" if word == "4" and TINY[i - 1] == "--episodes" else word
            for i, word in enumerate(TINY)]
    downpour("learn", "pendulum", "--out", short, "--quiet", *tiny)
    resumed = downpour("learn", "--resume", short, "--episodes", "4", "--quiet")
    claims.check("a resumed run ends with the same bits", resumed.returncode == 0 and
                 results(short)["episodes.csv"] == results(whole)["episodes.csv"] and
                 results(short)["checkpoint.json"] == results(whole)["checkpoint.json"], resumed)
    for threads in ("1", "5"):
        run = scratch / f"threads-{threads}"
        downpour("learn", "pendulum", "--out", run, "--quiet", *TINY[:-1], threads)
        claims.check(f"{threads} threads: the same bits as 2",
                     results(run)["checkpoint.json"] == results(whole)["checkpoint.json"])


def commands():
    for command in (["evaluate", whole, "--starts", "3"], ["predict", whole],
                    ["export", whole, "-o", scratch / "policy.h"]):
        result = downpour(*command)
        claims.check(f"{command[0]} takes a run", result.returncode == 0, result)


def study():
    settings = "".join(f"{key}\n" for key in ("policy.points = 3", "model.max_evaluations = 20"))
    (scratch / "s.toml").write_text(
        'tasks = ["pendulum"]\nreplicates = 2\n[settings]\nlearn.episodes = 3\n' + settings +
        '[variant.rival]\nlearn.algorithm = "pilco"\npilco.evaluations = 10\n'
        '[variant.ours]\nsearch.evaluations = 300\nsearch.final_rollouts = 8\n')
    result = downpour("study", "s.toml", "--jobs", "2", cwd=scratch)
    claims.check("a study has it as one more variant", result.returncode == 0 and
                 all((scratch / f"s.runs/pendulum/{name}/1/policy.json").exists()
                     for name in ("rival", "ours")), result)
    report = downpour("report", "s.db", "-o", "s.html", cwd=scratch)
    if report.returncode != 0 and "matplotlib is missing" in report.stderr:
        print("skipped: no matplotlib")
        return
    success = {row["variant"]: row for row in rows(scratch / "s_files", "success.csv")}
    page = (scratch / "s.html").read_text()
    claims.check("a report sets the paper's PILCO beside it, and not in a row of its own",
                 success["rival"]["paper_percent_within_15"] == "89.16" and
                 "<th>PILCO</th>" not in page, success)
    (scratch / "s.toml").write_text(
        (scratch / "s.toml").read_text().replace("learn.episodes = 3",
                                                 "learn.episodes = 3\nsearch.rollouts = 2"))
    refuse("study: a common setting that PILCO does not use", ["study", "s.toml"],
           "search.rollouts = 2: must be left out with learn.algorithm = pilco")


def refuse(claim, arguments, *words):
    before = contents(scratch)
    result = downpour(*arguments, cwd=scratch)
    lines = result.stderr.splitlines()
    claims.check(claim, result.returncode == 2 and len(lines) == 1 and
                 all(word in lines[0] for word in words) and contents(scratch) == before, result)


def bad_input():
    pilco = ["learn", "pendulum", "--algorithm", "pilco"]
    unused = "must be left out with learn.algorithm = pilco, which does not use it"
    refuse("an algorithm that is none", ["learn", "pendulum", "--algorithm", "pilko"],
           "--algorithm: learn.algorithm = pilko: must be one of black-drops, pilco; did you mean "
           "pilco?")
    for kind in ("nn", "dmp"):
        refuse(f"--policy {kind}", [*pilco, "--policy", kind], f"policy.kind = {kind}: must be gp "
               "or linear with learn.algorithm = pilco")
    refuse("--learn-reward", [*pilco, "--learn-reward"],
           "learn.learn_reward = true: must be false with learn.algorithm = pilco")
    for option, key in [(["--evaluations", "500"], "search.evaluations = 500"),
                        (["--rollouts", "2"], "search.rollouts = 2"),
                        (["--no-variance"], "rollout.variance = false"),
                        (["--tolerance", "0"], "model.tolerance = 0"),
                        (["--backend", "blas"], "model.backend = blas"),
                        (["--prior", "x.xml"], "prior.model = x.xml"),
                        (["--set", "search.restarts=bipop"], "search.restarts = bipop")]:
        refuse(" ".join(option), [*pilco, *option], f"{key}: {unused}")
    refuse("pilco.restarts without PILCO", ["learn", "pendulum", "--set", "pilco.restarts=3"],
           "pilco.restarts = 3: must be left out with learn.algorithm = black-drops")
    for setting, allowed in [("restarts=-1", "an integer in [0, 1000]"),
                             ("evaluations=0", "an integer in [1, 1000000]"),
                             ("start_std=nan", "a number in [0, 1000]")]:
        refuse(f"pilco.{setting}", [*pilco, "--set", f"pilco.{setting}"], allowed)
    refuse("--resume with another algorithm",
           ["learn", "--resume", "whole", "--algorithm", "black-drops"], "--algorithm cannot be")
    text = (whole / "config.toml").read_text()
    changed = text.replace('"pilco"', '"black-drops"').split("[pilco]")[0]
    (whole / "config.toml").write_text(changed + "[system]" + text.split("[system]")[1])
    refuse("a run whose config.toml names another algorithm", ["learn", "--resume", "whole"],
           'the run was made with learn.algorithm = "pilco", the configuration says "black-drops"')
    (whole / "config.toml").write_text(text)


plain()
same_bits()
commands()
study()
bad_input()
claims.exit()
