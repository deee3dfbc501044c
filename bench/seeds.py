#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""Learning results over seeds: runs `downpour learn` for each seed and prints a table.

usage: bench/seeds.py TASK [--seeds 1-20] [--jobs 2] [--out runs/seeds] [--program FILE] [-- ARGS]

ARGS go to `downpour learn`. Finished runs are not run again and interrupted ones are resumed, so
the command may be killed and repeated. The table goes to stdout and to OUT/TASK.csv.
"""
import argparse
import csv
import os
import statistics
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

TOP = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))


def read(run, name):
    path = os.path.join(run, name)
    if not os.path.exists(path):
        return []
    with open(path, newline="") as file:
        return [{k.split(" [")[0]: v for k, v in row.items()} for row in csv.DictReader(file)]


def learn(program, task, seed, run, arguments):
    """One seed's run, finished or resumed; returns its summary row."""
    done = os.path.join(run, "finished")
    if os.path.exists(done) and open(done).read() != " ".join(arguments):
        sys.exit(f"seeds: {run} was run with '{open(done).read()}': use another --out")
    if not os.path.exists(done):
        command = [program, "learn"]
        if os.path.exists(os.path.join(run, "config.toml")):
            command += ["--resume", run, "--quiet"]
        else:
            command += [task, "--seed", str(seed), "--out", run, "--quiet"] + arguments
        result = subprocess.run(command, capture_output=True, text=True)
        if result.returncode:
            sys.exit(f"seeds: {' '.join(command)}: {result.stderr.strip()}")
        with open(done, "w") as file:
            file.write(" ".join(arguments))
    episodes, timing = read(run, "episodes.csv"), read(run, "timing.csv")
    solved = [e for e in episodes if e["solved"] == "true"]
    return {
        "seed": seed,
        "episodes": len(episodes),
        "solved_episode": int(solved[0]["episode"]) if solved else "",
        "best_return": f"{max(float(e['return']) for e in episodes):.2f}",
        "real_returns": " ".join(f"{float(e['return']):.1f}" for e in episodes),
        "predicted_returns": " ".join(
            f"{float(e['predicted_return']):.1f}" if e["predicted_return"] else "-" for e in episodes),
        "rollouts": sum(int(e["evaluations"]) for e in episodes),
        "model_seconds": f"{sum(float(t['model_seconds']) for t in timing):.1f}",
        "search_seconds": f"{sum(float(t['search_seconds']) for t in timing):.1f}",
    }


def seed_list(text):
    first, _, last = text.partition("-")
    seeds = list(range(int(first), int(last or first) + 1))
    if not seeds:
        raise argparse.ArgumentTypeError(f"{text}: must be FIRST-LAST")
    return seeds


def main():
    own = sys.argv[1:]
    extra = []
    if "--" in own:
        own, extra = own[: own.index("--")], own[own.index("--") + 1 :]
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("task")
    parser.add_argument("--seeds", default="1-20", type=seed_list)
    parser.add_argument("--jobs", default=2, type=int, help="runs side by side")
    parser.add_argument("--out", default=os.path.join(TOP, "runs", "seeds"))
    parser.add_argument("--program", default=os.path.join(TOP, "build/release/bin/downpour"))
    arguments = parser.parse_args(own)
    os.makedirs(arguments.out, exist_ok=True)

    def one(seed):
        run = os.path.join(arguments.out, f"{arguments.task}-seed{seed}")
        row = learn(arguments.program, arguments.task, seed, run, extra)
        sys.stdout.write(f"seed {seed}: solved at {row['solved_episode'] or '-'}; real"
                         f" {row['real_returns']}; predicted {row['predicted_returns']}; model"
                         f" {row['model_seconds']} s, search {row['search_seconds']} s\n")
        sys.stdout.flush()
        return row

    with ThreadPoolExecutor(arguments.jobs) as pool:
        rows = list(pool.map(one, arguments.seeds))
    table = os.path.join(arguments.out, arguments.task + ".csv")
    with open(table, "w", newline="") as file:
        writer = csv.DictWriter(file, rows[0].keys())
        writer.writeheader()
        writer.writerows(rows)
    solved = sorted(r["solved_episode"] for r in rows if r["solved_episode"])
    never = len(rows) - len(solved)
    at = solved + [float("inf")] * never  # an unsolved seed counts as never in the median
    print(f"{arguments.task}: {len(solved)} of {len(rows)} solved, at episodes "
          f"{' '.join(map(str, solved))}; median {statistics.median(at)}; table in {table}")


if __name__ == "__main__":
    try:
        main()
    except KeyboardInterrupt:
        sys.exit("seeds: interrupted; the same command goes on")
