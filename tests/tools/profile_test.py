# SPDX-License-Identifier: Apache-2.0
"""downpour profile: costs that add up, complete JSON, a table that fits, bad input refused."""
import json
import os
import pathlib
import shutil
import struct
import xml.etree.ElementTree

from command import Claims, downpour, learn, scratch_directory

QUERY = ["covariance", "exponential", "deflation", "mean", "triangle"]
COSTS = [*QUERY, "openblas", "prior", "sampling", "features", "policy", "reward", "bookkeeping"]
MODEL_KEYS = ["episode", "points", "inputs", "outputs", "plans", "lanes", "tiles", "queries",
              "factor_bytes", "factors_in", "measured_ns", "accounted_for", "costs", "query",
              "top_cost", "top_over_roofline", "events"]
SHORT = ["--seconds", "0.02", "--points", "40,160"]

claims = Claims()
scratch = scratch_directory()
run = scratch / "run"


def profile(*arguments):
    result = downpour("profile", "--json", *arguments)
    claims.check(f"profile {' '.join(map(str, arguments))}: runs", result.returncode == 0, result)
    return json.loads(result.stdout)


def refuse(claim, arguments, *words):
    result = downpour("profile", *arguments, cwd=scratch)
    claims.check(f"refused in one line: {claim}",
                 result.returncode == 2 and result.stdout == "" and
                 result.stderr.startswith("downpour: ") and result.stderr.count("\n") == 1 and
                 all(str(word) in result.stderr for word in words), result)


def accounting():
    # Other work on the machine can slow one of the two measurements: the best of some attempts.
    shares = {80: [], 320: []}
    for _ in range(10):
        report = profile("--plan", "exact", "--seconds", "0.2", "--points", "80,320")
        for model in report["models"]:
            shares[model["points"]].append(model["accounted_for"])
        if all(any(0.95 <= share <= 1.05 for share in each) for each in shares.values()):
            break
    claims.check("the costs account for 95 % of the measured time at least, and for no more than it",
                 all(any(0.95 <= share <= 1.05 for share in each) for each in shares.values()), shares)
    for model in report["models"]:
        total = sum(cost["ns"] for cost in model["costs"].values())
        claims.check(f"n = {model['points']}: costs add up to the share that is printed",
                     abs(total / model["measured_ns"] - model["accounted_for"]) < 1e-9, model)
        claims.check("the top cost is the largest, its roofline below its time",
                     max(COSTS, key=lambda name: model["costs"][name]["ns"]) == model["top_cost"] and
                     model["top_over_roofline"] > 0.9, model)
    small, large = report["models"]
    claims.check("the triangle is the top cost of 320 exact points, and grows with their square",
                 large["top_cost"] == "triangle" and
                 10 < large["costs"]["triangle"]["ns"] / small["costs"]["triangle"]["ns"] < 32, report)


def arithmetic():
    report = profile("--plan", "exact", *SHORT)
    claims.check("JSON: machine, ceilings and how it was measured",
                 all(word in report["machine"] for word in ("cpu", "simd", "flags", "load_average"))
                 and report["ceilings"]["fp64_gflops"] > 0 and
                 report["method"] == {"parts": "clock between kernels", "query": "ablation"} and
                 (report["hardware_counters"] == "available" or
                  "no hardware counters for" in report["hardware_counters"]), report)
    claims.check("JSON: every key of every model, in order",
                 all(list(m) == MODEL_KEYS and list(m["costs"]) == COSTS for m in report["models"]),
                 report)
    for model in report["models"]:
        n, dim = model["points"], 6
        costs, lanes = model["costs"], model["lanes"] / model["tiles"]
        # n is a multiple of the kernel's eight rows: the triangle is panels of eight rows up to
        # the diagonal's end, n (n + 8) / 2 values, of which the zeros above it are skipped.
        values = n * (n + 8) / 2
        claims.check(f"n = {n}: operations and bytes are those of the packed triangle",
                     costs["triangle"]["fp64_operations"] == n * (n + 1) + 2 * n and
                     abs(costs["triangle"]["bytes"] - 8 * values / lanes) < 1e-6 and
                     costs["covariance"]["fp64_operations"] == 3 * n * dim and
                     abs(costs["covariance"]["bytes"] - 8 * n * dim / lanes) < 1e-6 and
                     model["factor_bytes"] == 4 * 8 * (values + n * (dim + 1)), costs)
        claims.check(f"n = {n}: rollouts of 40 steps, 4 outputs and 192 lanes",
                     model["queries"] == 192 * 40 * 4 and model["plans"] ==
                     4 * [f"{n} of {n} points, fp64"], model)
        claims.check(f"n = {n}: a part of the FMA peak is reached",
                     0 < model["query"]["of_fma_peak"] < 1.1, model["query"])
    single = profile("--plan", "exact", "--precision", "single", *SHORT)["models"][0]
    claims.check("--precision single: half of the bytes, all operations in fp32",
                 single["costs"]["triangle"]["bytes"] ==
                 report["models"][0]["costs"]["triangle"]["bytes"] / 2 and
                 single["costs"]["triangle"]["fp64_operations"] == 0 and
                 single["costs"]["triangle"]["fp32_operations"] > 0, single)
    blas = profile("--backend", "blas", "--points", "40", "--seconds", "0.02")["models"][0]
    claims.check("--backend blas: its queries are one cost", blas["costs"]["openblas"]["ns"] > 0 and
                 not any(blas["costs"][name]["ns"] for name in QUERY), blas)
    other = profile("--points", "9", "--inputs", "3", "--outputs", "7", "--lanes", "5", "--policy",
                    "gp", "--threads", "2", "--seconds", "0")["models"][0]
    claims.check("odd sizes: n = 9, D = 3, E = 7, 5 lanes, 2 threads",
                 (other["points"], other["inputs"], other["outputs"], other["lanes"],
                  other["queries"]) == (9, 3, 7, 5, 5 * 40 * 7), other)


def tables():
    result = downpour("profile", "--points", "8,16,24,32,40,48,56", "--seconds", "0")
    lines = result.stdout.splitlines()
    claims.check("the table keeps to 80 columns, with a block of models below the other",
                 result.returncode == 0 and max(map(len, lines)) <= 80 and
                 sum(line.startswith("accounted for") for line in lines) == 2, result)
    claims.check("it says how it was measured and names the top cost", "ablation" in result.stdout
                 and "by a clock" in result.stdout and result.stdout.count("top cost ") >= 7, result)


def runs():
    learn(run)
    report = profile(run, "--seconds", "0")
    claims.check("RUN: the models of all learnt episodes", [(m["episode"], m["points"], m["outputs"])
                 for m in report["models"]] == [(2, 40, 2), (3, 80, 2), (4, 120, 2)], report)
    table = downpour("profile", run, "--episodes", "3", "--seconds", "0")
    claims.check("RUN --episodes: one of them", "episode" in table.stdout and
                 table.stdout.count("top cost ") >= 1 and "n = 80:" in table.stdout, table)
    refuse("a random episode", [run, "--episodes", "1"], "random")
    refuse("an episode that is not there", [run, "--episodes", "9"], "9", "[1, 4]")
    refuse("no run", [scratch / "none"], "none", "no run here")
    refuse("a run with --points", [run, "--points", "40"], "--points", "left out")
    empty = pathlib.Path(shutil.copytree(run, scratch / "empty"))
    (empty / "checkpoint.json").unlink()
    refuse("a run without an episode", [empty], "no finished episode")


def bad_input():
    for option, value, allowed in [("--points", "0", "[1, 20000]"), ("--points", "x", "integer"),
                                   ("--points", "40,,80", "integer"), ("--inputs", "1", "[2, 100]"),
                                   ("--outputs", "0", "[1, 100]"), ("--lanes", "0", "[1, 100000]"),
                                   ("--lanes", "100001", "[1, 100000]"),
                                   ("--threads", "0", "[1, 1024]"), ("--seconds", "nan", "[0, 100]"),
                                   ("--plan", "best", "auto, exact"),
                                   ("--backend", "blis", "fused, blas"),
                                   ("--precision", "half", "double, single")]:
        refuse(f"{option} {value}", [option, value], option, allowed)
    refuse("--precision single of a plan", ["--precision", "single"], "--precision single", "exact")
    refuse("--episodes without a run", ["--episodes", "2"], "--episodes", "without RUN")
    refuse("a picture of another kind", ["-o", "x.bmp"], "--output: x.bmp: must end in .png or .svg")


def pictures():
    png, svg = scratch / "x.png", scratch / "x.svg"
    result = downpour("profile", *SHORT, "-o", png, "-o", svg)
    data = png.read_bytes()
    width, height = struct.unpack(">II", data[16:24])
    claims.check("-o: PNG and SVG beside the table", result.returncode == 0 and
                 data[:8] == b"\x89PNG\r\n\x1a\n" and width >= 1200 and height >= 500 and
                 xml.etree.ElementTree.parse(svg).getroot().tag.endswith("svg") and
                 "accounted for" in result.stdout, result)
    fake = scratch / "fake"
    fake.mkdir()
    (fake / "matplotlib.py").write_text("raise ModuleNotFoundError(name='matplotlib')\n")
    result = downpour("profile", *SHORT, "-o", png, env={**os.environ, "PYTHONPATH": str(fake)})
    claims.check("-o without matplotlib: says what to do, after the table", result.returncode == 2 and
                 "tools/setup --pictures" in result.stderr and "accounted for" in result.stdout, result)


accounting()
arithmetic()
tables()
runs()
bad_input()
pictures()
claims.exit()
