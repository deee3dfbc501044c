#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""Draws the learning curves of several runs of one task into one picture.

usage: bench/curves_plot.py RUN... -o docs/images/double_pendulum.png [--best 60] [--title TEXT]

A line for each run: real return of every episode, a mark where it solved the task. Writes the same
numbers beside the picture, as CSV.
"""
import argparse
import csv
import pathlib

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt


def read(run):
    """(seconds of interaction, return, solved) of every episode."""
    with open(pathlib.Path(run) / "episodes.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    key = {name.split(" ")[0]: name for name in rows[0]}
    return [(float(row[key["interaction_seconds"]]), float(row[key["return"]]),
             row[key["solved"]] == "true") for row in rows]


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("runs", nargs="+", metavar="RUN")
    parser.add_argument("-o", "--out", required=True)
    parser.add_argument("--best", type=float, help="most that an episode can return")
    parser.add_argument("--title", default="")
    options = parser.parse_args()
    curves = {pathlib.Path(run).name.rpartition("-")[2]: read(run) for run in options.runs}
    figure, axes = plt.subplots(figsize=(7, 3.6))
    for number, (name, curve) in enumerate(curves.items()):
        episodes = range(1, len(curve) + 1)
        axes.plot(episodes, [value for _, value, _ in curve], f"C{number}.-", label=name)
        solved = [(i, value) for i, (_, value, is_solved) in zip(episodes, curve) if is_solved]
        if solved:
            axes.plot(*zip(*solved), f"C{number}o", markersize=9, markerfacecolor="none")
    per_episode = max(curves.values(), key=len)[0][0]
    axes.set_xlabel(f"episode ({per_episode:g} s each, the first one random)")
    best = f" (at most {options.best:g})" if options.best else ""
    axes.set_ylabel("return" + best)
    axes.set_title(options.title)
    axes.set_ylim(bottom=0)
    axes.xaxis.get_major_locator().set_params(integer=True)
    axes.grid(alpha=0.3)
    axes.legend(frameon=False)
    figure.savefig(options.out, dpi=110, bbox_inches="tight")
    with open(pathlib.Path(options.out).with_suffix(".csv"), "w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["run", "episode", "interaction_seconds", "return", "solved"])
        for name, curve in curves.items():
            for episode, (seconds, value, solved) in enumerate(curve, 1):
                writer.writerow([name, episode, seconds, value, str(solved).lower()])


if __name__ == "__main__":
    main()
