# SPDX-License-Identifier: Apache-2.0
"""Draws a run directory. `downpour plot` runs it, behind pictures.py, with RUN TASK EPISODE
PERIOD PICTURE...

On standard input: rollouts of the episode's model (downpour predict); nothing for a random one.
"""
import csv
import math
import os
import sys

REAL, SOLVED, MODEL, PLAIN = "#22303c", "#2a9d8f", "#2878d6", "#a9b4c2"


class Table:
    """Columns of a CSV file by name; headers read `name [unit]`."""

    def __init__(self, lines):
        header, *rows = csv.reader(lines)
        self.columns, self.units = {}, {}
        for i, text in enumerate(header):
            name, _, unit = text.partition(" [")
            self.columns[name] = [row[i] for row in rows]
            self.units[name] = unit.rstrip("]")

    def numbers(self, name):
        return np.array([float(field or "nan") for field in self.columns[name]])

    def starting(self, prefix):
        return [name for name in self.columns if name.startswith(prefix)]


def read(run, name):
    path = os.path.join(run, name)
    try:
        with open(path, newline="") as file:
            return Table(file)
    except (OSError, ValueError) as error:
        fail(f"{path}: {getattr(error, 'strerror', None) or error}")


def label(variable, unit):
    """`pole_angle`, `rad` -> `pole angle (rad)`"""
    text = variable.replace("_", " ")
    return text if unit in ("", "1") else f"{text} ({unit})"


def episode_ticks(axes, episodes):
    axes.set_xticks(episodes if len(episodes) <= 15 else episodes[::math.ceil(len(episodes) / 15)])
    axes.set_xlabel("episode")
    axes.grid(axis="x", visible=False)


def draw_returns(axes, episodes, most):
    number, real = episodes.numbers("episode"), episodes.numbers("return")
    predicted = episodes.numbers("predicted_return")
    solved = np.array(episodes.columns["solved"]) == "true"
    for which, colour, name in ((~solved, PLAIN, "real"), (solved, SOLVED, "real, solved")):
        if which.any():
            axes.bar(number[which], real[which], 0.7, color=colour, label=name)
    short = np.array(episodes.columns.get("outcome", ["complete"] * len(number))) != "complete"
    if short.any():
        axes.bar(number[short], real[short], 0.7, color="none", hatch="////", edgecolor=REAL, lw=0,
                 label="cut short")
    if not np.isnan(predicted).all():
        axes.plot(number, predicted, "o", color=MODEL, ms=5, mec="white", label="predicted")
    axes.set(title="Learning curve", ylabel="return", ylim=(min(0, real.min()), 1.25 * most),
             yticks=np.linspace(0, most, 5))
    axes.axhline(most, color="#6b7785", lw=0.8, ls=":")
    axes.text(number[0] - 0.4, most, f"at most {most:g}", fontsize=8, color="#6b7785", va="bottom")
    axes.legend(loc="upper right", ncols=3, handlelength=1, columnspacing=1, borderpad=0)
    episode_ticks(axes, number)


def draw_agreement(axes, episodes, most):
    number, real = episodes.numbers("episode"), episodes.numbers("return")
    predicted = episodes.numbers("predicted_return")
    limits = (min(0, np.nanmin([real, predicted])) - 0.05 * most, 1.05 * most)
    axes.plot(limits, limits, color="#6b7785", lw=0.8, ls=":", label="equal")
    points = axes.scatter(predicted, real, c=number, cmap="viridis_r", s=45, edgecolors="white",
                          zorder=3)
    axes.set(title="Predicted against real return", xlabel="return predicted by the model",
             ylabel="real return", xlim=limits, ylim=limits)
    bar = axes.figure.colorbar(points, ax=axes, pad=0.02, shrink=0.85)
    bar.ax.set_title("episode", fontsize=9, fontweight="normal", loc="center")
    bar.ax.yaxis.set_major_locator(matplotlib.ticker.MaxNLocator(integer=True))
    bar.outline.set_visible(False)
    axes.legend(loc="upper left")


def draw_times(axes, timing):
    number = timing.numbers("episode")
    rollouts = np.nan_to_num(timing.numbers("rollout_seconds"))
    parts = [("rollouts on the model", rollouts, MODEL),
             ("rest of the search", timing.numbers("search_seconds") - rollouts, "#9cc3ee"),
             ("learning the model", timing.numbers("model_seconds"), "#e76f51")]
    bottom = np.zeros(len(number))
    for name, seconds, colour in parts:
        axes.bar(number, seconds, 0.7, bottom=bottom, color=colour, label=name)
        bottom += seconds
    axes.set(title="Where the time goes", ylabel="computing time (s)",
             ylim=(0, 1.45 * max(bottom.max(), 1e-9)))
    axes.legend(loc="upper left", handlelength=1, labelspacing=0.2, borderpad=0)
    episode_ticks(axes, number)


class Real:
    """The steps of one episode on the system."""

    def __init__(self, steps, episode, period):
        self.steps, self.period = steps, period
        self.rows = steps.numbers("episode") == episode

    def column(self, name):
        return self.steps.numbers(name)[self.rows]

    def state(self, variable):
        """Times and values, the start as it was observed and then the noise-free states."""
        values = np.append(self.column("observation." + variable)[:1],
                           self.column("next_state." + variable))
        return self.period * np.arange(len(values)), values


class Model:
    """Mean and standard deviation over rollouts at every step, in columns of `downpour predict`."""

    def __init__(self, table, period):
        self.table, self.period = table, period
        self.step = table.numbers("step").astype(int)

    def moments(self, name):
        values = self.table.numbers(name)
        groups = [values[self.step == step] for step in range(self.step.max() + 1)]
        return np.array([g.mean() for g in groups]), np.array([g.std() for g in groups])

    def draw(self, axes, time, mean, std, held=False):
        axes.fill_between(time, mean - 2 * std, mean + 2 * std, color=MODEL, alpha=0.2, lw=0,
                          step="post" if held else None, label="model ±2σ")
        axes.plot(time, mean, color=MODEL, lw=1.6, ls="--", label="model, mean",
                  drawstyle="steps-post" if held else None)

    def draw_state(self, axes, variable):
        next_mean, next_std = self.moments("next_state." + variable)
        start = self.table.numbers("state." + variable)[self.step == 0]
        time = self.period * np.arange(len(next_mean) + 1)
        self.draw(axes, time, np.append(start.mean(), next_mean), np.append(start.std(), next_std))

    def draw_action(self, axes, name):
        mean, std = self.moments(name)
        time = self.period * np.arange(len(mean) + 1)
        self.draw(axes, time, held(mean), held(std), held=True)

    def draw_reward(self, axes):
        mean, std = self.moments("reward")
        self.draw(axes, self.period * (np.arange(len(mean)) + 1), mean, std)


def held(values):
    """With the last one repeated, so that it is seen to hold for its whole step."""
    return np.append(values, values[-1:])


def draw_trajectories(panels, steps, episode, period, model):
    real = Real(steps, episode, period)
    line = {"color": REAL, "lw": 1.8, "label": "real"}
    for name in steps.starting("next_state."):
        axes, variable = next(panels), name.removeprefix("next_state.")
        if model:
            model.draw_state(axes, variable)
        axes.plot(*real.state(variable), **line)
        axes.set_ylabel(label(variable, steps.units[name]))
    for name in steps.starting("action."):
        axes, values = next(panels), real.column(name)
        if model:
            model.draw_action(axes, name)
        axes.plot(period * np.arange(len(values) + 1), held(values), drawstyle="steps-post", **line)
        axes.set_ylabel(label(name.removeprefix("action."), steps.units[name]))
    axes, values = next(panels), real.column("reward")
    if model:
        model.draw_reward(axes)
    axes.plot(period * (np.arange(len(values)) + 1), values, **line)
    axes.set_ylabel("reward")


def main():
    run, task, episode, period, *pictures = sys.argv[1:]
    episode, period = int(episode), float(period)
    episodes, steps, timing = (read(run, f"{name}.csv")
                               for name in ("episodes", "transitions", "timing"))
    predicted = sys.stdin.read().splitlines()
    model = Model(Table(predicted), period) if len(predicted) > 1 else None
    n_panels = len(steps.starting("next_state.")) + len(steps.starting("action.")) + 1
    columns = next((c for c in (3, 2, 4) if n_panels % c == 0), 3)
    rows = math.ceil(n_panels / columns)
    figure = plt.figure(figsize=(12, 3.4 + 2.1 * rows + 0.7), layout="constrained")
    top, bottom = figure.subfigures(2, 1, height_ratios=[3.4, 2.1 * rows + 0.7], hspace=0.03)
    first, second, third = top.subplots(1, 3)
    most = int(max(steps.numbers("step"))) + 1
    draw_returns(first, episodes, most)
    draw_agreement(second, episodes, most)
    draw_times(third, timing)
    panels = bottom.subplots(rows, columns, sharex=True, squeeze=False)
    draw_trajectories(iter(panels.flat), steps, episode, period, model)
    for axes in panels.flat[n_panels:]:
        axes.set_visible(False)
    for axes in panels[-1]:
        axes.set(xlabel="time (s)", xlim=(0, period * most))
    total = episodes.numbers("return")[episode - 1]
    kind = "random actions" if episodes.columns["random"][episode - 1] == "true" else "learnt policy"
    bottom.suptitle(f"{task.capitalize()}, episode {episode} ({kind}): return {total:.1f}", x=0.01,
                    ha="left", fontsize=11, fontweight="bold")
    bottom.legend(*panels.flat[0].get_legend_handles_labels(), loc="upper right", ncols=3)
    figure.draw_without_rendering()
    figure.set_layout_engine("none")  # each drawing would move things a little further
    for picture in pictures:
        try:
            figure.savefig(picture, dpi=130, metadata={"Date": None} if picture.endswith(".svg")
                           else None)
        except OSError as error:
            fail(f"{picture}: {error.strerror}")
        print(picture)


main()
