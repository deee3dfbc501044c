# SPDX-License-Identifier: Apache-2.0
"""The numbers of a report are those of an independent computation, and its page needs no other."""
import contextlib
import csv
import html.parser
import random
import sqlite3
import statistics
import subprocess
import sys

from command import Claims, downpour, scratch_directory

if subprocess.run(["/usr/bin/python3", "-c", "import matplotlib"], check=False,
                  stderr=subprocess.DEVNULL).returncode:
    print("skipped: no matplotlib")
    sys.exit(0)
try:
    import scipy.stats
except ImportError:
    scipy = None
    print("without the comparison with SciPy, which is not there")

# Name -> settings, and the paper's rate.
VARIANTS = {
    "NN & co": ({"policy.kind": '"nn"', "rollout.variance": "true"}, "100"),
    "GP <b>": ({"policy.kind": '"gp"', "rollout.variance": "true"}, "100"),
    "mean": ({"policy.kind": '"nn"', "rollout.variance": "false"}, "100"),
    "PILCO": ({"policy.kind": '"gp"', "learn.algorithm": '"pilco"'}, "89.16"),
    "PILCO, linear": ({"policy.kind": '"linear"', "learn.algorithm": '"pilco"'}, "")}
EPISODES = 5

claims = Claims()
scratch = scratch_directory()


def made_up(path, runs, digits):
    """A study's database with made-up returns; few `digits` make ties. Returns the rows by
    variant and seed."""
    study = scratch / "empty.toml"
    study.write_text('tasks = ["pendulum"]\nreplicates = 1\n[settings]\nlearn.episodes = 2\n'
                     'search.evaluations = 100\nsearch.final_rollouts = 1\nmodel.max_evaluations = '
                     '5\n[variant.x]\n')
    downpour("study", study, "--database", path)
    generator = random.Random(runs)
    returns = {}
    with contextlib.closing(sqlite3.connect(path)) as database, database:
        for name in ("variant", "setting", "episode", "timing"):
            database.execute(f"DELETE FROM {name}")
        for position, (name, (settings, _)) in enumerate(VARIANTS.items()):
            database.execute("INSERT INTO variant VALUES('pendulum', ?, ?, ?, 40, 0.1)",
                             (name, position, EPISODES))
            for key, value in [*settings.items(), ("preset", '"paper"'),
                               ("learn.until_solved", "false")]:
                database.execute("INSERT INTO setting VALUES('pendulum', ?, ?, ?)",
                                 (name, key, value))
            for seed in range(runs + position):
                returns[name, seed] = []
                for k in range(1, EPISODES + 1):
                    value = round(generator.uniform(0, 4 * k + 2 * position), digits)
                    solved = value > 12
                    returns[name, seed].append((value, solved))
                    database.execute("INSERT INTO episode VALUES('pendulum', ?, ?, ?, ?, ?, ?, ?, "
                                     "40, 'complete', ?, 0, 0, 0)",
                                     (name, seed, k, k == 1, value, None, solved, 4.0 * k))
                    database.execute("INSERT INTO timing VALUES('pendulum', ?, ?, ?, ?, ?, NULL, 2, "
                                     "1, 'made up', 'AVX3')", (name, seed, k, 0.25 * k, seed + k))
    return returns


def read(folder, name):
    with open(folder / f"{name}.csv", newline="") as file:
        return list(csv.DictReader(file))


def best(returns, name, k):
    return [max(value for value, _ in rows[:k]) for (variant, _), rows in returns.items()
            if variant == name]


def close(text, value):
    return abs(float(text) - value) <= 1e-9 * max(1, abs(value))


def check_numbers(label, folder, returns):
    curve = read(folder, "pendulum_best_return")
    expected = [(name, k, *statistics.quantiles(best(returns, name, k), n=4, method="inclusive"))
                for name in VARIANTS for k in range(1, EPISODES + 1)]
    claims.check(f"{label}: medians and quartiles of the best return so far",
                 len(curve) == len(expected) and
                 all((row["variant"], int(row["episode"])) == (name, k) and
                     close(row["percentile_25"], low) and close(row["median"], middle) and
                     close(row["percentile_75"], high)
                     for row, (name, k, low, middle, high) in zip(curve, expected)), curve)
    boxes = read(folder, "pendulum_after_4")
    claims.check(f"{label}: the best returns after episode 4, the paper's",
                 [(row["variant"], float(row["best_return"])) for row in boxes] ==
                 [(name, value) for name in VARIANTS for value in best(returns, name, 4)], boxes)
    first = {key: next((4.0 * (k + 1) for k, (_, solved) in enumerate(rows) if solved), None)
             for key, rows in returns.items()}
    seconds = read(folder, "pendulum_seconds_to_solve")
    claims.check(f"{label}: seconds of interaction to solve, empty where not solved",
                 sorted((row["variant"], row["interaction_seconds"]) for row in seconds) ==
                 sorted((name, "" if s is None else str(s)) for (name, _), s in first.items()))
    success = read(folder, "success")
    claims.check(f"{label}: the success table",
                 [(row["variant"], int(row["runs"]), int(row["solved"])) for row in success] ==
                 [(name, sum(key[0] == name for key in first),
                   sum(key[0] == name and s is not None for key, s in first.items()))
                  for name in VARIANTS] and
                 [row["paper_percent_within_15"] for row in success] ==
                 [rate for _, rate in VARIANTS.values()],
                 success)
    times = read(folder, "pendulum_optimisation_time")
    claims.check(f"{label}: optimisation times",
                 all(close(row["model_seconds"], 2.5) and
                     close(row["search_seconds"], 4 * int(row["seed"]) + 10) for row in times), times)


def check_tests(label, folder, returns, method):
    if scipy is None:
        return
    rows = read(folder, "pendulum_after_4_tests")
    good = len(rows) == len(VARIANTS) * (len(VARIANTS) - 1) // 2
    for row in rows:
        x, y = (best(returns, row[key], 4) for key in ("variant", "other_variant"))
        u, p = scipy.stats.mannwhitneyu(x, y, alternative="two-sided", method=method)
        good &= close(row["u"], u) and abs(float(row["p"]) - p) <= 1e-12 + 1e-9 * p
        good &= len(row["stars"]) == sum(p < level for level in (0.05, 0.01, 0.001, 0.0001))
    claims.check(f"{label}: Mann-Whitney U and p are SciPy's ({method}), with stars", good, rows)


class PageReader(html.parser.HTMLParser):
    """What a page refers to, and its tags that do not close."""

    def __init__(self, text):
        super().__init__()
        self.ids, self.references, self.open, self.wrong = set(), [], [], []
        self.figures = 0
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        if tag not in ("meta",):
            self.open.append(tag)
        self.figures += tag == "svg"
        for key, value in attributes:
            if key == "id":
                self.ids.add(value)
            if key in ("src", "href", "xlink:href"):
                self.references.append(value)
            if value and "url(#" in value:
                self.references.append("#" + value.split("url(#")[1].split(")")[0])

    def handle_startendtag(self, tag, attributes):
        self.handle_starttag(tag, attributes)
        self.open.pop()

    def handle_endtag(self, tag):
        if not self.open or self.open.pop() != tag:
            self.wrong.append(tag)


def check_page(page, folder):
    text = page.read_text()
    reader = PageReader(text)
    claims.check("the page has every figure in it, well-formed", reader.figures == 4 and
                 not reader.wrong and not reader.open, (reader.figures, reader.wrong, reader.open))
    claims.check("the page refers to nothing but itself",
                 all(r.startswith("#") and r[1:] in reader.ids for r in reader.references),
                 [r for r in reader.references if r[1:] not in reader.ids][:3])
    claims.check("names are text, not markup", "<b>" not in text and "GP &lt;b&gt;" in text)
    success = text.split("</table>", maxsplit=1)[0]
    claims.check("the paper's PILCO stands beside ours",
                 success.count("<th>PILCO</th>") == 1 and "<td>89.16 %</td>" in success, success)
    claims.check("every figure is a PNG, too", len(list(folder.glob("*.png"))) == 4)
    before = text
    downpour("report", scratch / "ties.db", "-o", page)
    claims.check("the same database gives the same page", page.read_text() == before)


def refusals():
    for arguments, *words in [
            (["no.db"], "no.db: must be the database of a study"),
            (["text.db"], "text.db: ", "not a database"),
            (["ties.db", "-o", "page.pdf"], "page.pdf: must end in .html"),
            (["ties.db", "--after", "-1"], "after = -1", "[0, 1000]")]:
        (scratch / "text.db").write_text("no database, but a text of some length\n" * 20)
        result = downpour("report", *arguments, cwd=scratch)
        claims.check(f"refused: {' '.join(arguments)}", result.returncode == 2 and
                     len(result.stderr.splitlines()) == 1 and
                     all(word in result.stderr for word in words), result)


for label, runs, digits, method in [("exact", 12, 15, "exact"), ("ties", 20, 0, "asymptotic")]:
    returns = made_up(scratch / f"{label}.db", runs, digits)
    result = downpour("report", scratch / f"{label}.db")
    claims.check(f"{label}: a report is made", result.returncode == 0 and
                 result.stdout == f"{scratch / label}.html\n", result)
    check_numbers(label, scratch / f"{label}_files", returns)
    check_tests(label, scratch / f"{label}_files", returns, method)
check_page(scratch / "ties.html", scratch / "ties_files")
refusals()
claims.exit()
