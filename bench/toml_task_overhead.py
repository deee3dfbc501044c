#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Search time of cart-pole from a TOML file beside the compiled task's.

    bench/toml_task_overhead.py build/release/bin/downpour

Compiled task, its file (the compiled reward kernel), and its file with the reward as a formula, run
in turn; all have the same data, of random episodes, and the same budget. Prints the best search time
of each and its ratio to the compiled task's.
"""
import argparse
import csv
import pathlib
import shutil
import subprocess
import sys
import tempfile

TASK = pathlib.Path(__file__).resolve().parents[1] / "tasks/cartpole"
FORMULA = ('expression = "exp(-(cart_position^2 + (cos_pole_angle + 1)^2 + sin_pole_angle^2)'
           ' / (2 * 0.25^2))"\nunit_interval = true\n')


def formula_task(folder):
    """The file with a formula for its residuals."""
    text = (TASK / "cartpole.toml").read_text()
    start, end = text.index("residuals"), text.index("[solved]")
    shutil.copy(TASK / "cartpole.xml", folder)
    path = folder / "cartpole.toml"
    path.write_text(text[:start] + FORMULA + "\n" + text[end:])
    return path


def search_seconds(program, task, options, run):
    subprocess.run([program, "learn", task, "--out", run, "--quiet", "--seed", "1", "--episodes",
                    str(options.random + 1), "--random-episodes", str(options.random),
                    "--evaluations", str(options.evaluations), "--threads", str(options.threads)],
                   check=True)
    with open(run / "timing.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    column = next(name for name in rows[0] if name.startswith("search_seconds"))
    shutil.rmtree(run)
    return float(rows[-1][column])


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("program")
    parser.add_argument("--random", type=int, default=4, help="random episodes of 40 points")
    parser.add_argument("--evaluations", type=int, default=30000)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--rounds", type=int, default=5)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name)
        tasks = {"compiled": "cartpole", "file": TASK / "cartpole.toml",
                 "formula": formula_task(folder)}
        seconds = {key: [] for key in tasks}
        for _ in range(options.rounds):
            for key, task in tasks.items():
                seconds[key].append(search_seconds(options.program, task, options, folder / "run"))
    for key, all_rounds in seconds.items():
        best = min(all_rounds)
        print(f"{key:9} {best:.3f} s, {best / min(seconds['compiled']):.3f} of compiled; rounds:",
              " ".join(f"{value:.3f}" for value in all_rounds))
    return 0


if __name__ == "__main__":
    sys.exit(main())
