# SPDX-License-Identifier: Apache-2.0
"""downpour scaling: every search is there, the summary is that of the table, bad input refused."""
import csv
import json
import os
import statistics
import struct

from command import Claims, downpour, scratch_directory

TINY = ["pendulum", "--threads", "2,3", "--replicates", "3", "--evaluations", "600", "--episodes",
        "2"]
ROW_KEYS = ["threads", "seconds", "seconds_quartile_1", "seconds_quartile_3", "speed_up",
            "speed_up_quartile_1", "speed_up_quartile_3", "efficiency", "efficiency_quartile_1",
            "efficiency_quartile_3", "lane_fill", "idle_share"]

claims = Claims()
scratch = scratch_directory()


def refuse(claim, arguments, *words):
    result = downpour("scaling", *arguments, cwd=scratch)
    claims.check(f"refused in one line: {claim}",
                 result.returncode == 2 and result.stdout == "" and
                 result.stderr.startswith("downpour: ") and result.stderr.count("\n") == 1 and
                 all(word in result.stderr for word in words), result)


def figures():
    table = scratch / "x.csv"
    result = downpour("scaling", *TINY, "--json", "--csv", table)
    claims.check("runs", result.returncode == 0, result)
    report = json.loads(result.stdout)
    task = report["tasks"][0]
    claims.check("JSON: machine with flags and load, replicates, pinned or not",
                 all(word in report["machine"] for word in
                     ("cpu", "cores", "cache_l2", "cpu_flags", "kernel", "governor", "load_average"))
                 and report["replicates"] == 3 and report["pinned"] is False, report)
    claims.check("JSON: strong and weak rows by threads, one thread among them",
                 all([row["threads"] for row in task[kind]] == [1, 2, 3] and
                     all(list(row) == ROW_KEYS for row in task[kind]) for kind in ("strong", "weak")),
                 task)
    with open(table, newline="") as file:
        rows = list(csv.DictReader(file))
    order = [(int(r["replicate"]), int(r["threads"]), r["scaling"]) for r in rows]
    claims.check("CSV: a row a search, replicates in turns", order == [
        (r, t, s) for r in range(3) for t, s in
        ((1, "strong"), (2, "strong"), (2, "weak"), (3, "strong"), (3, "weak"))], order)
    seconds = {key: float(r["seconds [s]"]) for key, r in zip(order, rows)}
    for t in (2, 3):
        ratios = [seconds[r, 1, "strong"] / seconds[r, t, "strong"] for r in range(3)]
        weak = [seconds[r, 1, "strong"] / seconds[r, t, "weak"] for r in range(3)]
        strong_row = next(row for row in task["strong"] if row["threads"] == t)
        weak_row = next(row for row in task["weak"] if row["threads"] == t)
        claims.check(f"{t} threads: speed-up and efficiencies are medians of the replicates' own",
                     abs(strong_row["speed_up"] / statistics.median(ratios) - 1) < 1e-3 and
                     abs(strong_row["efficiency"] * t / strong_row["speed_up"] - 1) < 1e-9 and
                     abs(weak_row["efficiency"] / statistics.median(weak) - 1) < 1e-3,
                     (ratios, strong_row, weak_row))
        claims.check(f"{t} threads: quartiles enclose the median",
                     strong_row["speed_up_quartile_1"] <= strong_row["speed_up"] <=
                     strong_row["speed_up_quartile_3"])
    claims.check("one thread is the measure", all(task[kind][0]["speed_up"] == 1 and
                                                  task[kind][0]["efficiency"] == 1
                                                  for kind in ("strong", "weak")), task)
    budgets = {(int(r["threads"]), r["scaling"]): int(r["evaluations"]) for r in rows}
    claims.check("a strong search keeps its budget, a weak one that of its threads",
                 budgets[2, "strong"] == budgets[1, "strong"] <= 600 and
                 1.5 * budgets[1, "strong"] < budgets[2, "weak"] <= 1200 and
                 2.5 * budgets[1, "strong"] < budgets[3, "weak"] <= 1800, budgets)
    claims.check("expected speed-ups from 1 to 16 threads, with what bounds them, from the measured "
                 "serial share", [e["threads"] for e in task["expected"]] == list(range(1, 17)) and
                 abs(task["expected"][0]["speed_up"] - 1) < 1e-9 and
                 all(e["bound"] in ("FMA", "tiles", "bandwidth") for e in task["expected"]) and
                 0 <= task["serial_share"] < 1, task)
    claims.check("the paper's figure stands beside", task["paper"] == {"cores": 12, "speed_up": 8})


def table_and_pictures():
    png = scratch / "x.png"
    result = downpour("scaling", *TINY[:-4], "--evaluations", "400", "--episodes", "2", "--no-weak",
                      "--pin", "-o", png, env={k: v for k, v in os.environ.items()
                                               if not k.startswith("OMP_P")})
    claims.check("--pin: threads are bound", result.returncode == 0 and
                 "threads pinned" in result.stdout, result)
    claims.check("the table keeps to 80 columns",
                 max(map(len, result.stdout.splitlines())) <= 80, result.stdout)
    data = png.read_bytes()
    claims.check("-o: a picture", data[:8] == b"\x89PNG\r\n\x1a\n" and
                 struct.unpack(">I", data[16:20])[0] >= 1200, result)


def bad_input():
    refuse("an unknown task", ["pendulim"], "pendulim", "did you mean pendulum?")
    for option, value, allowed in [("--threads", "0", "[1, 1024]"), ("--threads", "x", "integer"),
                                   ("--replicates", "0", "[1, 1000]"),
                                   ("--evaluations", "5", "[100, 1000000000]"),
                                   ("--episodes", "1", "[2, 100]"), ("--expect", "0", "[1, 1024]")]:
        refuse(f"{option} {value}", ["pendulum", option, value], option, allowed)
    refuse("a picture of another kind", ["-o", "x.pdf"], "x.pdf", ".png or .svg")
    refuse("an empty table", ["--csv", ""], "--csv", "must not be empty")


figures()
table_and_pictures()
bad_input()
claims.exit()
