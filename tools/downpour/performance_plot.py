# SPDX-License-Identifier: Apache-2.0
"""Draws what `downpour profile` and `downpour scaling` measured, behind pictures.py: KIND
PICTURE...

KIND is profile or scaling. On standard input: the command's JSON.
"""
import json
import sys

DARK, MODEL, GREY = "#22303c", "#2878d6", "#6b7785"
COSTS = {"covariance": "#1f5fa8", "exponential": "#2878d6", "deflation": "#7fb2e8",
         "mean": "#b9d4f1", "triangle": "#e76f51", "openblas": "#e76f51", "prior": "#b56576", "sampling": "#2a9d8f",
         "features": "#8ccfc4", "policy": "#e9c46a", "reward": "#f2dfb0",
         "bookkeeping": "#a9b4c2"}


def describe(report):
    machine = report["machine"]
    return f"{machine['cpu']}, {machine['simd']}"


def model_name(model):
    n = str(model["points"])
    return n if model["episode"] is None else f"{n}\nep. {model['episode']}"


def draw_costs(axes, report):
    models = report["models"]
    place, bottom = np.arange(len(models)), np.zeros(len(models))
    for name, colour in COSTS.items():
        share = 100 * np.array([m["costs"][name]["ns"] / m["measured_ns"] for m in models])
        if (share > 0.05).any():
            axes.bar(place, share, 0.75, bottom=bottom, color=colour, label=name)
        bottom += share
    for i, m in enumerate(models):
        shown = float(f"{m['measured_ns']:.3g}")
        axes.text(i, max(bottom[i], 100) + 1, f"{shown:g} ns",
                  ha="center", fontsize=8)
    axes.axhline(100, color=GREY, lw=0.8, ls=":")
    axes.set(title="Where the time of a GP query goes", ylabel="share of the measured time (%)",
             xlabel="training points n", ylim=(0, 1.1 * max(100, bottom.max())), xticks=place,
             xticklabels=[model_name(m) for m in models])
    axes.grid(axis="x", visible=False)
    handles, names = axes.get_legend_handles_labels()
    axes.legend(handles[::-1], names[::-1], loc="upper left", bbox_to_anchor=(1, 1), handlelength=1)


def draw_roofline(axes, report):
    """Arithmetic against bytes read; a dot a cost, a line a ceiling."""
    threads, ceilings = report["threads"], report["ceilings"]
    peak = {"fp64": ceilings["fp64_gflops"], "fp32": ceilings["fp32_gflops"]}
    bandwidths = [(name.split("_")[0], rate) for name, rate in ceilings.items()
                  if name.endswith("per_second") and rate]
    intensity = np.logspace(-1.5, 2.5, 200)
    lowest, slope = peak["fp64"] / 60, 52  # of the vertical axis; of a line of bandwidth, degrees
    for precision, style in (("fp64", "-"), ("fp32", "--")):
        axes.axhline(peak[precision], color=DARK, lw=1, ls=style)
        axes.text(intensity[-1], peak[precision], f"FMA peak {precision}, {peak[precision]:.0f}",
                  ha="right", va="bottom", fontsize=8)
    for name, rate in bandwidths:
        line = np.minimum(rate * intensity, peak["fp32"])
        axes.plot(intensity, line, color=GREY, lw=0.9)
        at = max(intensity[8], 1.3 * lowest / rate)
        axes.text(at, 1.12 * rate * at, f"{name}, {rate:.0f} GB/s", fontsize=8, color=GREY,
                  rotation=slope, rotation_mode="anchor", clip_on=True)
    sizes = np.linspace(25, 110, len(report["models"]))
    for name in ("covariance", "exponential", "deflation", "mean", "triangle", "openblas"):
        label = name
        for model, size in zip(report["models"], sizes):
            cost = model["costs"][name]
            operations = cost["fp64_operations"] + cost["fp32_operations"]
            # What takes less than a hundredth is lost in the noise of the ablation.
            if not operations or cost["ns"] < 0.01 * model["measured_ns"]:
                continue
            # What reads nothing of the factor stands at the right.
            x = operations / cost["bytes"] if cost["bytes"] else intensity[-1]
            axes.scatter(min(x, intensity[-1]), threads * operations / cost["ns"], size,
                         color=COSTS[name], edgecolors="white", label=label, zorder=3)
            label = None
    axes.set(xscale="log", yscale="log", title="Roofline",
             xlabel="operations a byte of the packed factors read",
             ylabel=f"GFLOP/s, {threads} thread{'s' * (threads > 1)}",
             ylim=(lowest, 1.6 * peak["fp32"]))
    axes.legend(loc="lower right", title="larger dots: more points", title_fontsize=8)


def draw_profile(report):
    figure, (left, right) = plt.subplots(1, 2, figsize=(12, 4.8), layout="constrained")
    draw_costs(left, report)
    draw_roofline(right, report)
    least = min(m["accounted_for"] for m in report["models"])
    figure.suptitle(f"{report['subject']}, {report['models'][0]['lanes']} lanes; "
                    f"{describe(report)}; at least {100 * least:.1f} % accounted for", x=0.01,
                    ha="left", fontsize=10)
    return figure


def draw_speed_up(axes, task):
    rows = task["strong"]
    threads = [row["threads"] for row in rows]
    expected = task["expected"]
    axes.plot([e["threads"] for e in expected], [e["threads"] for e in expected], color=GREY,
              lw=0.8, ls=":", label="ideal")
    axes.plot([e["threads"] for e in expected], [e["speed_up"] for e in expected], color=MODEL,
              lw=1.4, ls="--", label="expected")
    axes.fill_between(threads, [r["speed_up_quartile_1"] for r in rows],
                      [r["speed_up_quartile_3"] for r in rows], color=DARK, alpha=0.2, lw=0)
    axes.plot(threads, [r["speed_up"] for r in rows], "o-", color=DARK, ms=5,
              label="measured, median and quartiles")
    paper = task["paper"]
    if paper:
        axes.plot(paper["cores"], paper["speed_up"], "*", color="#e76f51", ms=13,
                  label=f"paper: {paper['speed_up']:g}x on {paper['cores']} cores")
    axes.set(title=f"{task['task'].capitalize()}: strong scaling", xlabel="threads",
             ylabel="speed-up of the search")
    axes.legend(loc="upper left")


def draw_efficiency(axes, task):
    for rows, colour, name in ((task["strong"], DARK, "strong: the same search"),
                               (task["weak"], "#2a9d8f", "weak: as many searches as threads")):
        if not rows:
            continue
        threads = [row["threads"] for row in rows]
        axes.fill_between(threads, [100 * r["efficiency_quartile_1"] for r in rows],
                          [100 * r["efficiency_quartile_3"] for r in rows], color=colour,
                          alpha=0.2, lw=0)
        axes.plot(threads, [100 * r["efficiency"] for r in rows], "o-", color=colour, ms=5,
                  label=name)
    rows = task["strong"]
    threads = [row["threads"] for row in rows]
    axes.plot(threads, [100 * r["idle_share"] for r in rows], "s--", color="#e76f51", ms=4,
              label="threads without a tile")
    axes.plot(threads, [100 * r["lane_fill"] for r in rows], "^--", color=MODEL, ms=4,
              label="lanes filled")
    axes.set(title=f"{task['task'].capitalize()}: efficiency", xlabel="threads", ylabel="%",
             ylim=(0, 140), xticks=threads, yticks=range(0, 101, 20))
    axes.legend(loc="upper left", ncols=2)


def draw_scaling(report):
    tasks = report["tasks"]
    figure, panels = plt.subplots(len(tasks), 2, figsize=(12, 4.2 * len(tasks)), squeeze=False,
                                  layout="constrained")
    for (left, right), task in zip(panels, tasks):
        draw_speed_up(left, task)
        draw_efficiency(right, task)
    pinned = "pinned to cores" if report["pinned"] else "not pinned"
    figure.suptitle(f"{describe(report)}; threads {pinned}; {report['replicates']} replicates. "
                    "Expected: measured serial share, runs and tiles, and the FMA peak of as "
                    "many threads", x=0.01, ha="left", fontsize=9)
    return figure


def main():
    kind, *pictures = sys.argv[1:]
    report = json.load(sys.stdin)
    figure = {"profile": draw_profile, "scaling": draw_scaling}[kind](report)
    figure.draw_without_rendering()
    figure.set_layout_engine("none")  # each drawing would move things a little further
    for picture in pictures:
        try:
            figure.savefig(picture, dpi=130, metadata={"Date": None} if picture.endswith(".svg")
                           else None)
        except OSError as error:
            fail(f"{picture}: {error.strerror}")
        print(picture, file=sys.stderr)


main()
