# SPDX-License-Identifier: Apache-2.0
"""The runs of a study's database, and their statistics: the first part of report.py."""
import csv
import html
import io
import itertools
import math
import os
import sqlite3

# What the paper says in words and in Table I. Rates: (policy.kind, rollout.variance) -> %.
PAPER = {
    "pendulum": {
        "after": 4, "seconds": 12, "seconds_text": "paper: about 3 episodes", "speed_up": 8,
        "rates": {("nn", True): 100, ("gp", True): 100, ("nn", False): 100, ("gp", False): 100},
        "pilco_rate": 89.16,
        "time_text": "Paper: with 12 cores 1.25 to 3.3 times faster than PILCO; no seconds given."},
    "cartpole": {
        "after": 8, "seconds": 20, "seconds_text": "paper: 5 episodes", "speed_up": 6,
        "rates": {("nn", True): 93.33, ("gp", True): 90.83, ("nn", False): 90, ("gp", False): 85},
        "pilco_rate": 92.5, "minutes": 25,
        "time_text": "Paper: about 25 minutes for 8 episodes with 12 cores, 1.6 times faster than "
                     "PILCO."},
    "arm": {"seconds": 20, "seconds_text": "paper: 5 episodes (without variance 6)"}}


class Run:
    """One replicate: its finished episodes in order."""

    def __init__(self, variant):
        self.variant, self.rows = variant, []

    def finished(self):
        until_solved = self.variant.settings.get("learn.until_solved") == "true"
        return (len(self.rows) >= self.variant.episodes or
                until_solved and self.solved_row() is not None)

    def solved_row(self):
        return next((row for row in self.rows if row["solved"]), None)

    def best_after(self, k):
        """None if it is not so far yet; a run that ended because it was solved keeps its best."""
        if len(self.rows) < k and not self.finished():
            return None
        return max(row["real_return"] for row in self.rows[:k])

    def seconds_after(self, k, *columns):
        return None if len(self.rows) < k else sum(row[c] for row in self.rows[:k] for c in columns)


class Variant:
    """A variant on one task, with its runs."""

    def __init__(self, row, settings):
        self.task, self.name, self.episodes = row["task"], row["variant"], row["episodes"]
        self.episode_seconds = row["horizon"] * row["control_period"]
        self.settings, self.runs = settings, []
        self.n_left_out = 0

    def is_pilco(self):
        """Of the paper's setting: its GP policy."""
        return (self.settings.get("learn.algorithm") == '"pilco"' and
                self.settings.get("policy.kind") == '"gp"')

    def paper_rate(self):
        """Of Table I; None where it has nothing that corresponds."""
        if self.settings.get("preset") != '"paper"':
            return None
        if self.is_pilco():
            return PAPER.get(self.task, {}).get("pilco_rate")
        if self.settings.get("policy.hidden_units", "[10]") != "[10]":
            return None
        kind = self.settings.get("policy.kind", "").strip('"')
        rates = PAPER.get(self.task, {}).get("rates", {})
        return rates.get((kind, self.settings.get("rollout.variance") == "true"))

    def leave_out_unfinished(self):
        """Else medians would fall where a run ends for the time being."""
        finished = [run for run in self.runs if run.finished()]
        if finished:
            self.n_left_out = len(self.runs) - len(finished)
            self.runs = finished

    def values(self, of_run):
        return [value for value in map(of_run, self.runs) if value is not None]

    def judged(self):
        """Runs of which it is known whether they solve the task within their episodes."""
        return [run for run in self.runs if run.finished() or run.solved_row() is not None]

    def seconds_to_solve(self):
        return [run.solved_row()["interaction_seconds"] if run.solved_row() else math.inf
                for run in self.judged()]


def read(path):
    try:
        database = sqlite3.connect(f"file:{path}?mode=rw", uri=True, timeout=60)
        database.row_factory = sqlite3.Row
        if database.execute("PRAGMA application_id").fetchone()[0] != 0x64707374:
            fail(f"{path}: must be the database of a study")
        variants = {}
        for row in database.execute("SELECT * FROM variant ORDER BY position, task, variant"):
            key = (row["task"], row["variant"])
            settings = database.execute(
                "SELECT key, value FROM setting WHERE task = ? AND variant = ?", key)
            variants[key] = Variant(row, dict(map(tuple, settings)))
        runs = {}
        for row in database.execute("SELECT * FROM episode JOIN timing USING(task, variant, seed, "
                                    "episode) ORDER BY task, variant, seed, episode"):
            variant = variants[row["task"], row["variant"]]
            run = runs.get((variant, row["seed"]))
            if run is None:
                run = runs[variant, row["seed"]] = Run(variant)
                variant.runs.append(run)
            run.rows.append(row)
    except sqlite3.Error as error:
        fail(f"{path}: {error}")
    tasks = {}
    for variant in variants.values():
        variant.leave_out_unfinished()
        if variant.runs:
            tasks.setdefault(variant.task, []).append(variant)
    if not tasks:
        fail(f"{path}: no finished episode; must have one at least")
    return tasks


def mann_whitney(x, y):
    """U of `x` and its two-sided p: exact without ties, else the normal approximation with its
    corrections for ties and continuity."""
    n, m = len(x), len(y)
    u = sum((a > b) + 0.5 * (a == b) for a in x for b in y)
    extreme = max(u, n * m - u)
    _, counts = np.unique(np.concatenate([x, y]), return_counts=True)
    if (counts == 1).all():
        # Coefficients of the Gaussian binomial, i.e. how many orders give each U.
        orders = [1] + [0] * (n * m)
        for i in range(1, m + 1):
            for j in range(n * m, n + i - 1, -1):
                orders[j] -= orders[j - n - i]
            for j in range(i, n * m + 1):
                orders[j] += orders[j - i]
        return u, min(1.0, 2 * sum(orders[int(extreme):]) / math.comb(n + m, n))
    ties = float(sum(int(t) ** 3 - int(t) for t in counts))
    variance = n * m / 12 * (n + m + 1 - ties / ((n + m) * (n + m - 1)))
    if variance <= 0:
        return u, 1.0
    return u, min(1.0, math.erfc((extreme - n * m / 2 - 0.5) / math.sqrt(2 * variance)))


def stars(p):
    return "*" * sum(p < level for level in (0.05, 0.01, 0.001, 0.0001))


def quartiles(values):
    return np.percentile(values, [25, 50, 75])


def quantile(values, share):
    """As np.quantile, of values that may be infinite; NaN of none."""
    if not values:
        return math.nan
    ordered = sorted(values)
    position = share * (len(ordered) - 1)
    low, high = ordered[math.floor(position)], ordered[math.ceil(position)]
    return low if low == high else low + (position % 1) * (high - low)


def number(value, digits=3):
    return "–" if not math.isfinite(value) else f"{value:.{digits}g}"
