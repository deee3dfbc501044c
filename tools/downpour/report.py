# SPDX-License-Identifier: Apache-2.0
"""Draws the database of a study. `downpour report` runs it behind report_data.py, as one script, with
DATABASE PAGE AFTER.

PAGE is one HTML file; its pictures (PNG) and their numbers (CSV) go to the folder PAGE_files.
"""
# Colours that the colour-blind can tell apart; lines differ in their dashes, too.
COLOURS = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#4d4d4d", "#8c6d31"]
DASHES = ["-", "--", "-.", ":", (0, (5, 1)), (0, (3, 1, 1, 1)), (0, (1, 1)), (0, (7, 2))]
PAPER_COLOUR = "#6b7785"
plt.rcParams.update({
    "font.size": 9, "axes.titlesize": 10, "axes.titleweight": "bold", "axes.titlelocation": "left",
    "axes.spines.top": False, "axes.spines.right": False, "axes.edgecolor": "#6b7785",
    "axes.grid": True, "axes.axisbelow": True, "grid.color": "#e6e9ee", "legend.fontsize": 8,
    "legend.frameon": True, "legend.framealpha": 0.85, "legend.edgecolor": "none",
    "figure.figsize": (4.8, 3.6), "figure.constrained_layout.use": True})

class Page:
    """Figures as they are drawn, each with its PNG and CSV, and the HTML of them."""

    def __init__(self, path):
        self.path, self.parts = path, []
        self.folder = path.removesuffix(".html") + "_files"

    def write_csv(self, name, header, rows):
        with open(os.path.join(self.folder, name + ".csv"), "w", newline="") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(header)
            writer.writerows(["" if x is None or x == math.inf else x for x in row] for row in rows)

    def add(self, text):
        self.parts.append(text)

    def figure(self, name, figure, caption):
        figure.savefig(os.path.join(self.folder, name + ".png"), dpi=160)
        with plt.rc_context({"svg.hashsalt": name}):
            svg = io.StringIO()
            figure.savefig(svg, format="svg", metadata={"Date": None})
        plt.close(figure)
        text = svg.getvalue()
        text = text[text.index("<svg"):]
        start = text.index(">")
        view = text[text.index('viewBox="'):].split('"')[1]
        title = html.escape(figure.axes[0].get_title("left"))
        # Every figure has ids of its own in the page.
        body = text[start:].replace('id="', f'id="{name}-').replace('"#', f'"#{name}-')
        body = body.replace("url(#", f"url(#{name}-")
        self.add(f'<figure><svg xmlns="http://www.w3.org/2000/svg" '
                 f'xmlns:xlink="http://www.w3.org/1999/xlink" viewBox="{view}" role="img" '
                 f'aria-label="{title}"{body}<figcaption>{html.escape(caption)}</figcaption></figure>')

    def table(self, header, rows, caption):
        cells = ["<tr>" + "".join(f"<th>{html.escape(cell)}</th>" for cell in header) + "</tr>"]
        for first, *rest in rows:
            cells.append(f"<tr><th>{html.escape(first)}</th>" +
                         "".join(f"<td>{html.escape(cell)}</td>" for cell in rest) + "</tr>")
        self.add(f'<p>{html.escape(caption)}</p><div class="table"><table>{"".join(cells)}'
                 "</table></div>")

    def write(self, title):
        style = (
            "body{font:16px/1.45 system-ui,sans-serif;color:#22303c;max-width:1100px;"
            "margin:0 auto;padding:1rem}h1{font-size:1.5rem}h2{font-size:1.2rem;margin-top:2rem}"
            ".figures{display:grid;grid-template-columns:repeat(auto-fit,minmax(min(100%,27rem),"
            "1fr));gap:1.5rem}figure{margin:0;break-inside:avoid}figure svg{width:100%;height:auto}"
            "figcaption,p{font-size:.9rem;color:#4a5866}"
            ".table{overflow-x:auto;margin:1rem 0;break-inside:avoid}"
            "table{border-collapse:collapse}th,td{padding:.25rem .7rem;border-bottom:1px solid "
            "#e6e9ee;text-align:right}td,th:first-child{white-space:nowrap}"
            "th:first-child{text-align:left}"
            "@media print{body{max-width:none;font-size:11pt}.figures{grid-template-columns:1fr "
            "1fr}}")
        with open(self.path, "w") as file:
            file.write('<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
                       '<meta name="viewport" content="width=device-width,initial-scale=1">'
                       f"<title>{html.escape(title)}</title><style>{style}</style></head><body>\n"
                       f"<h1>{html.escape(title)}</h1>\n" + "\n".join(self.parts) +
                       "\n</body></html>\n")
        print(self.path)


class TaskReport:
    """The figures of one task."""

    def __init__(self, page, task, variants, after):
        self.page, self.task, self.variants = page, task, variants
        self.paper = PAPER.get(task, {})
        self.longest = max(len(run.rows) for v in variants for run in v.runs)
        self.after = min(after or self.paper.get("after", self.longest), self.longest)
        self.title = task.capitalize()

    def style(self, variant):
        i = self.variants.index(variant)
        return {"color": COLOURS[i % len(COLOURS)], "ls": DASHES[i % len(DASHES)]}

    def mark_paper(self, axes, x):
        axes.axvline(x, color=PAPER_COLOUR, lw=1, ls=":")
        low, high = axes.get_xlim()
        right = x < low + 0.7 * (high - low)
        axes.annotate(self.paper["seconds_text"], (x, 1.0), (4 if right else -4, 0),
                      xycoords=axes.get_xaxis_transform(), textcoords="offset points", fontsize=7,
                      color=PAPER_COLOUR, va="top", ha="left" if right else "right")

    def curves(self):
        figure, axes = plt.subplots()
        rows = []
        for v in self.variants:
            known = [(k, v.values(lambda run, k=k: run.best_after(k)))
                     for k in range(1, self.longest + 1)]
            known = [(k, values) for k, values in known if values]
            low, middle, high = np.array([quartiles(values) for _, values in known]).T
            episodes = [k for k, _ in known]
            axes.fill_between(episodes, low, high, color=self.style(v)["color"], alpha=0.15, lw=0)
            axes.plot(episodes, middle, lw=1.8, marker="o", ms=3, label=v.name, **self.style(v))
            rows += [(v.name, k, len(values), *q)
                     for (k, values), q in zip(known, zip(middle, low, high))]
        axes.set(title=f"{self.title}: best return so far", xlabel="episode (the first is random)",
                 ylabel="best real return")
        if "seconds" in self.paper:
            self.mark_paper(axes, self.paper["seconds"] / self.variants[0].episode_seconds)
        axes.xaxis.set_major_locator(matplotlib.ticker.MaxNLocator(integer=True))
        axes.legend(loc="lower right")
        name = f"{self.task}_best_return"
        self.page.write_csv(name, ["variant", "episode", "runs", "median", "percentile_25",
                                   "percentile_75"], rows)
        self.page.figure(name, figure, "Median over runs and the range from the 25th to the 75th "
                         "percentile (the paper's Fig. 3A, 5A).")

    def draw_boxes(self, axes, groups):
        """`groups`: (variant, values); dots are runs."""
        for i, (v, values) in enumerate(groups):
            colour = self.style(v)["color"]
            axes.boxplot([values], positions=[i], widths=0.5, showfliers=False,
                         medianprops={"color": "black"}, boxprops={"color": colour, "lw": 1.4},
                         whiskerprops={"color": colour}, capprops={"color": colour})
            # Spread by the golden ratio: the same picture each time.
            offsets = [0.3 * ((0.618 * j) % 1 - 0.5) for j in range(len(values))]
            axes.plot(np.add(i, offsets), values, ".", color=colour, alpha=0.5, ms=4)
        axes.set_xticks(range(len(groups)))
        labels = [v.name for v, _ in groups]
        long = sum(map(len, labels)) > 50
        axes.set_xticklabels(labels, rotation=20 if long else 0, ha="right" if long else "center")
        axes.grid(axis="x", visible=False)

    def boxes(self):
        groups = [(v, v.values(lambda run: run.best_after(self.after))) for v in self.variants]
        groups = [(v, values) for v, values in groups if values]
        figure, axes = plt.subplots()
        self.draw_boxes(axes, groups)
        top = max(max(values) for _, values in groups)
        step = 0.07 * max(top - min(min(values) for _, values in groups), 1e-9)
        tests = []
        for (i, (v, x)), (j, (w, y)) in itertools.combinations(enumerate(groups), 2):
            u, p = mann_whitney(x, y)
            tests.append((v.name, w.name, len(x), len(y), u, p, stars(p)))
            if stars(p):
                top += step
                axes.plot([i, i, j, j], [top - step / 4, top, top, top - step / 4], color="black",
                          lw=0.8)
                axes.text((i + j) / 2, top - step / 5, stars(p), ha="center", va="bottom")
        axes.set(title=f"{self.title}: best return after episode {self.after}",
                 ylabel="best real return")
        name = f"{self.task}_after_{self.after}"
        self.page.write_csv(name, ["variant", "best_return"],
                            [(v.name, value) for v, values in groups for value in values])
        self.page.write_csv(f"{name}_tests", ["variant", "other_variant", "runs", "other_runs", "u",
                                              "p", "stars"], tests)
        self.page.figure(name, figure, "Boxes: median and quartiles; whiskers: the farthest run "
                         "within 1.5 times their distance; dots: runs. Stars: p of the two-sided "
                         "Mann-Whitney U test below 0.05, 0.01, 0.001, 0.0001; none: not below "
                         "0.05 (the paper's Fig. 3B, 5B).")
        self.tests = tests

    def solved(self):
        figure, axes = plt.subplots()
        rows, end = [], max(v.episodes * v.episode_seconds for v in self.variants)
        for v in self.variants:
            seconds = sorted(v.seconds_to_solve())
            if not seconds:
                continue
            rows += [(v.name, s) for s in seconds]
            reached = [s for s in seconds if s < math.inf]
            shares = 100 * np.arange(len(reached) + 1) / len(seconds)
            axes.plot([0, *reached, end], [*shares, shares[-1]], drawstyle="steps-post", lw=1.8,
                      label=v.name, **self.style(v))
            if v.paper_rate() is not None:
                axes.plot([end], [v.paper_rate()], "<", color=self.style(v)["color"], ms=5,
                          clip_on=False)
        if "rates" in self.paper:
            axes.plot([], [], "<", color=PAPER_COLOUR, label="paper, within 15 episodes")
        axes.set(title=f"{self.title}: runs that solved the task", ylabel="share of runs (%)",
                 xlabel="interaction time (s)", ylim=(0, 108), xlim=(0, end))
        if self.paper.get("seconds", math.inf) <= end:
            self.mark_paper(axes, self.paper["seconds"])
        axes.legend(loc="upper left")
        name = f"{self.task}_seconds_to_solve"
        self.page.write_csv(name, ["variant", "interaction_seconds"], rows)
        self.page.figure(name, figure, "Share of runs that had solved the task by then, the random "
                         "episode included; an empty field of the CSV: not within the run's "
                         "episodes.")

    def times(self):
        groups = [(v, v.values(lambda run: run.seconds_after(self.after, "model_seconds",
                                                             "search_seconds")))
                  for v in self.variants]
        groups = [(v, values) for v, values in groups if values]
        if not groups or self.after < 2:
            return
        figure, axes = plt.subplots()
        self.draw_boxes(axes, groups)
        axes.set(title=f"{self.title}: optimisation time of {self.after} episodes", ylabel="s")
        axes.set_ylim(bottom=0)
        if self.paper.get("after") == self.after and "minutes" in self.paper:
            minutes = self.paper["minutes"]
            axes.axhline(60 * minutes, color=PAPER_COLOUR, lw=1, ls=":")
            axes.text(-0.45, 60 * minutes, f"paper, 12 cores: about {minutes} min", fontsize=7,
                      color=PAPER_COLOUR, va="bottom")
            axes.set(yscale="log", ylim=(0.5 * min(map(min, (x for _, x in groups))), 120 * minutes))
            axes.yaxis.set_major_formatter(matplotlib.ticker.FuncFormatter(lambda y, _: f"{y:g}"))
        rows = [(v.name, run.rows[0]["seed"], run.rows[-1]["threads"], run.rows[-1]["jobs"],
                 run.rows[-1]["processor"], run.seconds_after(self.after, "model_seconds"),
                 run.seconds_after(self.after, "search_seconds"))
                for v, _ in groups for run in v.runs if len(run.rows) >= self.after]
        name = f"{self.task}_optimisation_time"
        self.page.write_csv(name, ["variant", "seed", "threads", "jobs", "processor",
                                   "model_seconds", "search_seconds"], rows)
        machines = ", ".join(sorted({f"{row[4]}, {row[2]} thread{'s' * (row[2] != 1)} a run, "
                                     f"{row[3]} runs side by side" for row in rows}))
        self.page.figure(name, figure, f"Learning the models and searching the policies ({machines})"
                         f". {self.paper.get('time_text', '')}")

    def speed_up(self):
        """Of variants that differ by nothing but threads."""
        groups = {}
        for v in self.variants:
            for run in v.runs:
                seconds = run.seconds_after(self.after, "search_seconds")
                if seconds:
                    by_threads = groups.setdefault(tuple(sorted(v.settings.items())), {})
                    by_threads.setdefault(run.rows[-1]["threads"], []).append((v, seconds))
        groups = [group for group in groups.values() if len(group) > 1]
        if not groups:
            return
        figure, axes = plt.subplots()
        rows = []
        for group in groups:
            threads = sorted(group)
            variant = group[threads[0]][0][0]
            alone = np.median([seconds for _, seconds in group[threads[0]]])
            points = [quartiles([alone / s for _, s in group[n]]) for n in threads]
            low, middle, high = np.array(points).T
            axes.fill_between(threads, low, high, color=self.style(variant)["color"], alpha=0.15)
            axes.plot(threads, middle, marker="o", label=variant.name, **self.style(variant))
            rows += [(variant.name, n, len(group[n]), *q)
                     for n, q in zip(threads, zip(middle, low, high))]
        most = max(row[1] for row in rows)
        if "speed_up" in self.paper:
            axes.plot([12], [self.paper["speed_up"]], "*", color=PAPER_COLOUR, ms=9,
                      label=f"paper: up to {self.paper['speed_up']}x with 12 cores")
            most = max(most, 12)
        axes.plot([1, most], [1, most], ":", color=PAPER_COLOUR, lw=1, label="linear")
        axes.set(title=f"{self.title}: speed-up of the search", xlabel="threads",
                 ylabel="times as fast as with the fewest")
        axes.legend(loc="upper left")
        name = f"{self.task}_speed_up"
        self.page.write_csv(name, ["variant", "threads", "runs", "median", "percentile_25",
                                   "percentile_75"], rows)
        self.page.figure(name, figure, f"Search time of {self.after} episodes, of variants that "
                         "differ by nothing but threads (the paper's Fig. 4A, 6A).")

    def add(self):
        page = self.page
        page.add(f'<h2>{html.escape(self.title)}</h2><div class="figures">')
        for draw in (self.curves, self.boxes, self.solved, self.times, self.speed_up):
            draw()
        page.add("</div>")
        page.table(["variant", "runs", "episodes at most", "solved", "median episode",
                    "interaction (s), quartiles", f"best return after {self.after}, quartiles"],
                   [self.summary(v) for v in self.variants],
                   "Medians over runs, an unsolved one counted as never; quartiles in brackets.")
        page.table(["Mann-Whitney U", "", "U", "p", ""],
                   [(a, b, f"{u:g}", f"{p:.2g}", mark) for a, b, _, _, u, p, mark in self.tests],
                   f"Best return after episode {self.after}, two-sided; exact without ties, else "
                   "the normal approximation; not corrected for the number of tests.")

    def summary(self, v):
        seconds = v.seconds_to_solve()
        n_solved = sum(s < math.inf for s in seconds)
        low, middle, high = (quantile(seconds, share) for share in (0.25, 0.5, 0.75))
        best = v.values(lambda run: run.best_after(self.after))
        spread = "–"
        if best:
            a, b, c = quartiles(best)
            spread = f"{number(b)} ({number(a)} to {number(c)})"
        return (v.name, str(len(v.runs)), str(v.episodes), f"{n_solved} of {len(seconds)}",
                number(middle / v.episode_seconds),
                f"{number(middle)} ({number(low)} to {number(high)})", spread)


def rate_text(rate):
    return "–" if rate is None else f"{rate:g} %"


def success_table(page, tasks):
    """The paper's Table I beside ours."""
    header, rows = ["success rate"], []
    for task in tasks:
        header += [task, "paper"]
    names = list(dict.fromkeys(v.name for variants in tasks.values() for v in variants))
    numbers = []
    for name in names:
        row = [name]
        for task, variants in tasks.items():
            v = next((v for v in variants if v.name == name), None)
            seconds = [] if v is None else v.seconds_to_solve()
            solved = sum(s < math.inf for s in seconds)
            row += [f"{round(1000 * solved / len(seconds)) / 10:g} % ({solved} of {len(seconds)})"
                    if seconds else "–", rate_text(v.paper_rate() if v else None)]
            if v:
                numbers.append((task, name, len(seconds), solved, v.episodes, v.paper_rate()))
        rows.append(row)
    pilco = [PAPER.get(task, {}).get("pilco_rate") for task in tasks]
    beside_ours = [any(v.is_pilco() and v.paper_rate() for v in variants)
                   for variants in tasks.values()]
    if any(rate and not shown for rate, shown in zip(pilco, beside_ours)):
        rows.append(["PILCO", *itertools.chain(*(("–", rate_text(rate)) for rate in pilco))])
    budgets = ", ".join(f"{task} {max(v.episodes for v in variants)}"
                        for task, variants in tasks.items())
    page.table(header, rows, f"Runs that solved the task within so many episodes: {budgets}; the "
               "paper's Table I: within 15, 120 replicates.")
    page.write_csv("success", ["task", "variant", "runs", "solved", "episodes",
                               "paper_percent_within_15"], numbers)


def main():
    database, path, after = sys.argv[1], sys.argv[2], int(sys.argv[3])
    tasks = read(database)
    page = Page(path)
    try:
        os.makedirs(page.folder, exist_ok=True)
        every = [v for variants in tasks.values() for v in variants]
        left_out = sum(v.n_left_out for v in every)
        going = f"; {left_out} more are not finished yet and left out" if left_out else ""
        page.add(f"<p>{sum(len(v.runs) for v in every)} runs{going}."
                 " What the paper gives is that of Chatzilygeroudis et al., Black-Box Data-efficient "
                 "Policy Search for Robotics, IROS 2017.</p>")
        success_table(page, tasks)
        for task, variants in tasks.items():
            TaskReport(page, task, variants, after).add()
        page.write(os.path.basename(database).removesuffix(".db"))
    except OSError as error:
        fail(f"{error.filename or path}: {error.strerror}")


main()
