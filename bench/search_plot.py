#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""Draws how soon searches find a good policy, from what search_comparison.py has kept.

usage: bench/search_plot.py [--out runs/search_study] [--share 0.9] [-o docs/images/search.png]

Share of the models on which a policy within --share of the best known return was found, against the
rollouts spent, for some of the settings; one panel a task.
"""
import argparse
import csv
import glob
import os

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt

from search_comparison import cost, name_of

ONE = {"exploration": 1, "concurrent": 1}


def lines(task):
    """(label, setting, colour, line style) of the curves, the default first."""
    best = {"cartpole": 0.25, "pendulum": 1}[task]
    usual = {"cartpole": 0.5, "pendulum": 1}[task]
    twice = {"cartpole": 32, "pendulum": 30}[task]
    plain = {**ONE, "population": 16}
    return [
        ("default: halving, half of the restarts from the last policy, common random numbers",
         {"restarts": "small", "exploration": 0.3, "promotions": 3, "concurrent": 8, "population": 16,
          "local_share": 0.5, "first_sigma": best, "common_random_numbers": "generation"}, "C3", "-"),
        ("the same, independent random numbers, twice the population",
         {"restarts": "small", "exploration": 0.3, "promotions": 3, "concurrent": 8,
          "local_share": 0.5, "first_sigma": best, "population": twice}, "C3", "--"),
        ("former default: halving, restarts from random starts",
         {"restarts": "small", "exploration": 0.55, "promotions": 2, "concurrent": 8,
          "local_share": 0, "first_sigma": usual, "population": twice}, "C1", "-"),
        ("small restarts, $\\lambda$ = 16, one run at a time", {**plain, "restarts": "small", "uncertainty": "off"}, "C0", "-"),
        ("BIPOP", {**plain, "restarts": "bipop", "uncertainty": "off"}, "C0", "--"),
        ("IPOP", {**plain, "restarts": "ipop", "uncertainty": "off"}, "C0", ":"),
        ("single run from the last policy", {**plain, "restarts": "single", "uncertainty": "off"}, "C7", "-"),
        ("small restarts, more rollouts under noise",
         {**plain, "restarts": "small", "uncertainty": "rollouts"}, "C2", "--"),
        ("fixed $\\lambda$ = 16, $\\sigma_0$ = 5, random starts",
         {**ONE, "restarts": "small", "population": 16, "start": "uniform", "first-sigma": 5,
          "restart-sigma": 5, "restart-decades": 0}, "C7", "--"),
    ]


def read(out, task):
    """{(setting, run and seed): lines} of all searches kept, and the best return of each run."""
    results, best = {}, {}
    for path in glob.glob(os.path.join(out, task, "*", "*.csv")):
        setting = os.path.basename(os.path.dirname(path))
        key = os.path.basename(path)[:-4]
        with open(path, newline="") as file:
            found = [(int(r["rollouts"]), float(r["true_return"]), r["what"]) for r in csv.DictReader(file)]
        results[setting, key] = found
        run = key.rsplit("-", 1)[0]
        best[run] = max([best.get(run, 0)] + [value for _, value, _ in found])
    return results, best


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--out", default="runs/search_study")
    parser.add_argument("--share", type=float, default=0.9)
    parser.add_argument("-o", default="docs/images/search.png")
    arguments = parser.parse_args()
    figure, axes = plt.subplots(1, 2, figsize=(11, 4.6), sharey=True)
    for axis, task, title in zip(axes, ["cartpole", "pendulum"], ["cart-pole", "pendulum"]):
        results, best = read(arguments.out, task)
        for label, setting, colour, style in lines(task):
            name = name_of({k.replace("_", "-"): v for k, v in setting.items()}).replace(" ", ",")
            costs = [cost(found, arguments.share * best[key.rsplit("-", 1)[0]])
                     for (folder, key), found in results.items() if folder == name]
            if not costs:
                raise SystemExit(f"search_plot: {task} has no searches of {name}: run search_comparison.py")
            hits = sorted(rollouts for rollouts, success in costs if success)
            share = [(k + 1) / len(costs) for k in range(len(hits))]
            axis.step(hits + [120000], share + [share[-1] if share else 0], where="post",
                      color=colour, linestyle=style, label=label,
                      linewidth=2.5 if style == "-" and colour == "C3" else 1.5)
        axis.set_xscale("log")
        axis.set_xlim(500, 120000)
        axis.set_ylim(0, 1.02)
        axis.set_xlabel("rollouts spent")
        axis.set_title(f"{title}, {len(best)} models", loc="left")
        axis.spines[["top", "right"]].set_visible(False)
    axes[0].set_ylabel(f"share of searches that have found\na policy within {1 - arguments.share:.0%} of the best")
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="lower center", ncol=2, frameon=False)
    figure.tight_layout(rect=(0, 0.24, 1, 1))
    figure.savefig(arguments.o, dpi=110)


if __name__ == "__main__":
    main()
