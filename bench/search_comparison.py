#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""Which setting finds a good policy for the fewest rollouts: compares searches on models of runs.

usage: bench/search_comparison.py TASK --runs RUN [RUN ...] [--tables fixed,restarts,allocation]
         [--seeds 1] [--evaluations 120000] [--jobs 2] [--out runs/search_study] [--plot FILE]

A model is learnt from all episodes of a run but its last one, and searched again with every
setting of the tables and every seed (build/release/bin/search_study). The measure is the expected
number of rollouts until the mean of a CMA-ES run is within --share of the best return known on
that model, by any search here, both by 2,000 fresh rollouts: rollouts of all searches (those that
fail with all they spent) over the number of searches that succeed. Intervals are bootstrapped over
models (90 %). Finished searches are kept in OUT and not run again: the command may be killed and
repeated. Also printed: the mean over searches of the best true return so far after some numbers of
rollouts (--looks); a rollout of H steps is H E queries, those of a setting with R rollouts too.
"""
import argparse
import csv
import os
import random
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

TOP = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
PROGRAM = os.path.join(TOP, "build/release/bin/search_study")


def product(**choices):
    """All combinations, as dictionaries."""
    rows = [{}]
    for key, values in choices.items():
        rows = [{**row, key.replace("_", "-"): value} for row in rows for value in values]
    return rows


def tables(task):
    usual = {"cartpole": 0.5, "pendulum": 1}[task]  # first_sigma before this study
    best = {"cartpole": 0.25, "pendulum": 1}[task]
    population = {"cartpole": 32, "pendulum": 24}[task]
    fixed, sigma = {"cartpole": (32, 0.5), "pendulum": (16, 1)}[task]
    sigmas = [0.1, 0.25, 0.5, 1, 2.5, 5]
    restarts = ["single", "ipop", "bipop", "small"]
    one = {"exploration": 1, "concurrent": 1}
    twice = {"cartpole": 32, "pendulum": 30}[task]  # the default population of CMA-ES
    best_fixed = {**one, "restarts": "small", "population": fixed, "start": "uniform",
                  "first-sigma": sigma, "restart-sigma": sigma, "restart-decades": 0}
    all_alike = {"restarts": "small", "exploration": 1, "population": twice}
    widths = {"cartpole": [(2.5, 1)], "pendulum": [(2.2, 0.2), (5, 1.3)]}[task]
    present = {"common-random-numbers": "generation", "covariance": "diagonal", "population": 12}
    halving = [{"restarts": "small", "exploration": 0.55, "promotions": 2, "population": twice},
               {"restarts": "small", "exploration": 0.3, "promotions": 3, "population": twice}]
    return {
        # One run, no restart: lambda x sigma_0 x start.
        "fixed": [{**one, "restarts": "single", **row} for row in product(
            population=[16, 32], first_sigma=sigmas, start=["last", "zero", "uniform"])],
        # Restart strategies one run at a time, and what they do about noise.
        "restarts": [{**one, "population": 16, **row} for row in
                     product(restarts=restarts, uncertainty=["off", "rollouts"])
                     + product(restarts=["single", "small"], uncertainty=["sigma", "lra"])
                     + product(restarts=restarts, rollouts=[5, 20])
                     + product(restarts=["single", "small"],
                               common_random_numbers=["generation", "search"])],
        # Fixed settings as a prototype had them (lambda, sigma_0), run again and again from
        # uniform starts; and its rule: the first run from the last policy, restarts that draw sigma.
        "prototype": [{**one, "restarts": "small", "population": population, "start": "uniform",
                       "first-sigma": sigma, "restart-sigma": sigma, "restart-decades": 0}
                      for population, sigma in [(16, 5), (16, 1), (32, 1), (32, 0.5), (64, 1)]]
                     + [{**one, "restarts": "small", "population": population,
                         "first-sigma": usual}],
        "refined": [{"restarts": "small", "exploration": 0.3, "promotions": 3,
                     "population": twice, **row} for row in
                    product(concurrent=[4, 8], local_share=[0.5], first_sigma=[best],
                            population=[twice, 16])
                    + product(concurrent=[4, 8], local_share=[0.75], first_sigma=[best])
                    + product(concurrent=[4], local_share=[0.5], first_sigma=[best / 2])]
                   + [{**one, "restarts": "small", "local-share": 0.5, "first-sigma": best,
                       "population": 16}],
        "common": [{"restarts": "small", "exploration": 0.3, "promotions": 3, "local-share": 0.5,
                    "first-sigma": best, "common-random-numbers": "generation", **row}
                   for row in product(concurrent=[4, 8], population=[twice])
                   + product(concurrent=[8], population=[16])],
        # What of the covariance to adapt, and populations; and the best fixed setting of either task.
        "covariance": [{"common-random-numbers": "generation", "covariance": covariance,
                        **({"population": population} if population else {})}
                       for covariance, population in [("full", 0), ("diagonal", 0),
                                                      ("diagonal", 8), ("diagonal", 12),
                                                      ("diagonal", 20)]]
                      + [{"common-random-numbers": "generation", "covariance": "diagonal",
                          "exploration": 0.15}]
                      + [best_fixed],
        # Exploring by relaxed rollouts where there is no last policy, and the restarts' widths.
        "relaxed": [{**present, "relaxed": relaxed, "restart-sigma": sigma,
                     "restart-decades": decades}
                    for relaxed in [1, 0] for sigma, decades in widths]
                   + [best_fixed],
        # The halving with full covariances: runs side by side, share of exploration, promotions;
        # and the best fixed setting of either task.
        "halving": [{"common-random-numbers": "generation", "concurrent": concurrent,
                     "exploration": exploration, "promotions": promotions}
                    for concurrent, exploration, promotions in
                    [(8, 0.3, 3), (8, 0.15, 3), (6, 0.3, 3), (5, 0.2, 2), (5, 0.15, 2),
                     (4, 0.3, 3), (4, 0.2, 2), (4, 0.15, 2)]]
                   + [best_fixed],
        # Who gets the budget: so many runs side by side, some of them from the last policy, and
        # successive halving or not.
        "allocation": [{**all_alike, **row} for row in
                       product(concurrent=[1, 4, 8], local_share=[0, 0.5],
                               first_sigma=[0.25, usual])]
                      + [{**selection, **row} for selection in halving for row in
                         product(concurrent=[4, 8], local_share=[0.5], first_sigma=[0.25])
                         + product(concurrent=[8], local_share=[0], first_sigma=[usual])],
    }


# What all tables but "relaxed" were taken with, unless they say otherwise.
FORMER = {"common-random-numbers": "off", "covariance": "full", "population": 0, "relaxed": 0}
FORMER_RESTARTS = {"pendulum": {"restart-sigma": 5, "restart-decades": 1.3}, "cartpole": {}}


def name_of(setting):
    return " ".join(f"{key}={value}" for key, value in sorted(setting.items()))


def n_episodes(run):
    with open(os.path.join(run, "episodes.csv"), newline="") as file:
        return sum(1 for _ in csv.DictReader(file))


def search(task, run, setting, seed, evaluations, out):
    """One search's lines [(rollouts, true return, what)], run or read."""
    folder = os.path.join(out, task, name_of(setting).replace(" ", ","))
    path = os.path.join(folder, f"{os.path.basename(os.path.normpath(run))}-{seed}.csv")
    if not os.path.exists(path):
        os.makedirs(folder, exist_ok=True)
        command = [PROGRAM, task, run, "--episodes", str(n_episodes(run) - 1), "--first-seed",
                   str(seed), "--evaluations", str(evaluations)]
        for key, value in {**FORMER, **FORMER_RESTARTS[task], **setting}.items():
            command += [f"--{key}", str(value)]
        result = subprocess.run(command, capture_output=True, text=True)
        if result.returncode:
            sys.exit(f"search_comparison: {' '.join(command)}: {result.stderr.strip()}")
        with open(path + ".part", "w") as file:
            file.write(result.stdout)
        os.replace(path + ".part", path)
    with open(path, newline="") as file:
        return [(int(row["rollouts"]), float(row["true_return"]), row["what"])
                for row in csv.DictReader(file)]


def cost(lines, wanted):
    """(rollouts spent, found) of one search."""
    for rollouts, value, what in lines:
        if what == "mean" and value >= wanted:
            return rollouts, True
    return next(rollouts for rollouts, _, what in lines if what == "end"), False


def best_after(lines, rollouts):
    """The best true return that one search's means had reached after so many rollouts."""
    return max([value for spent, value, what in lines if what == "mean" and spent <= rollouts],
               default=0)


def expected(costs):
    """Expected rollouts to success of [(rollouts, found)]; infinite if none succeeded."""
    found = sum(success for _, success in costs)
    return sum(rollouts for rollouts, _ in costs) / found if found else float("inf")


def interval(costs_by_model, draws=1000):
    """90 % bootstrap interval of `expected` over models."""
    generator = random.Random(0)
    models = list(costs_by_model.values())
    values = sorted(expected([c for costs in generator.choices(models, k=len(models)) for c in costs])
                    for _ in range(draws))
    return values[draws // 20], values[-draws // 20 - 1]


def summarise(settings, results, runs, seeds, share, looks):
    """Rows of the table, best first."""
    best = {}
    for (run, _, _), lines in results.items():
        best[run] = max([best.get(run, 0)] + [value for _, value, _ in lines])
    rows = []
    for setting in settings:
        name = name_of(setting)
        by_model = {run: [cost(results[run, name, seed], share * best[run]) for seed in seeds]
                    for run in runs}
        costs = [c for model in by_model.values() for c in model]
        low, high = interval(by_model)
        returned = [next(v for _, v, what in results[run, name, seed] if what == "returned") / best[run]
                    for run in runs for seed in seeds]
        reached = {f"return_after_{look}": sum(best_after(results[run, name, seed], look)
                                               for run in runs for seed in seeds) / len(costs)
                   for look in looks}
        rows.append({"setting": name, "expected_rollouts": expected(costs), "low": low, "high": high,
                     "found": sum(success for _, success in costs) / len(costs),
                     "returned_share_of_best": sum(returned) / len(returned), **reached})
    return sorted(rows, key=lambda row: row["expected_rollouts"])


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("task")
    parser.add_argument("--runs", nargs="+", required=True)
    parser.add_argument("--tables", default="fixed,restarts,allocation")
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--evaluations", type=int, default=120000)
    parser.add_argument("--share", type=float, default=0.9)
    parser.add_argument("--looks", default="10000,30000,60000,120000",
                        type=lambda text: [int(word) for word in text.split(",")])
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--out", default="runs/search_study")
    arguments = parser.parse_args()
    settings, seen = [], set()
    for table in arguments.tables.split(","):
        for setting in tables(arguments.task)[table]:
            if name_of(setting) not in seen:
                seen.add(name_of(setting))
                settings.append(setting)
    seeds = range(arguments.seeds)
    work = [(run, setting, seed) for seed in seeds for setting in settings for run in arguments.runs]
    with ThreadPoolExecutor(arguments.jobs) as pool:
        lines = pool.map(lambda w: search(arguments.task, *w, arguments.evaluations, arguments.out), work)
        results = {(run, name_of(setting), seed): found for (run, setting, seed), found in zip(work, lines)}
    rows = summarise(settings, results, arguments.runs, seeds, arguments.share,
                     arguments.looks)
    path = os.path.join(arguments.out, f"{arguments.task}.csv")
    with open(path, "w", newline="") as file:
        writer = csv.DictWriter(file, rows[0].keys())
        writer.writeheader()
        writer.writerows(rows)
    for row in rows:
        print(f"{row['expected_rollouts']:10.0f} ({row['low']:.0f}-{row['high']:.0f}) "
              f"{row['found']:6.2f} {row['returned_share_of_best']:6.2f}  "
              + " ".join(f"{row[f'return_after_{look}']:5.1f}" for look in arguments.looks)
              + f"  {row['setting']}")


if __name__ == "__main__":
    main()
