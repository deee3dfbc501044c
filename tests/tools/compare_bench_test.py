# SPDX-License-Identifier: Apache-2.0
"""tools/compare_bench: ratios with intervals that cover, refusals, exit codes."""
import json
import math
import pathlib
import random
import subprocess
import sys

from command import Claims, scratch_directory

SCRIPT = pathlib.Path(__file__).parents[2] / "tools/compare_bench"
CONTEXT = {"cpu": "A", "processors": "4", "num_cpus": 4, "mhz_per_cpu": 2700, "simd": "AVX3",
           "blas_core": "SkylakeX", "compiler": "GCC 12", "flags": "-O3", "commit": "1"}

claims = Claims()
scratch = scratch_directory()


def write(name, times, unit="ns", **context):
    path = scratch / name
    rows = [{"name": benchmark, "run_type": "iteration", "real_time": time, "time_unit": unit}
            for benchmark, values in times.items() for time in values]
    rows.append({"name": "a_mean", "run_type": "aggregate", "real_time": 1, "time_unit": "ns"})
    path.write_text(json.dumps({"context": {**CONTEXT, **context}, "benchmarks": rows}))
    return path


def compare(*arguments):
    return subprocess.run([sys.executable, SCRIPT, *map(str, arguments)], capture_output=True,
                          text=True)


def row(result, name):
    """Ratio and interval that the command printed for a benchmark."""
    words = next(line for line in result.stdout.splitlines() if line.split()[0] == name).split()
    return float(words[5]), float(words[6]), float(words[8])


def refuse(claim, arguments, *words):
    result = compare(*arguments)
    claims.check(f"refused in one line: {claim}",
                 result.returncode == 2 and result.stdout == "" and
                 result.stderr.startswith("compare_bench: ") and result.stderr.count("\n") == 1 and
                 all(word in result.stderr for word in words), result)


def intervals():
    # Welch's interval of these logarithms by hand: means 0 and ln 1.1, variances 0.01^2 / 3 each
    # of 3 repetitions, 4 degrees of freedom, t = 2.776445.
    old = [100 * math.exp(x) for x in (-0.01, 0, 0.01)]
    result = compare(write("old.json", {"a": old}), write("new.json", {"a": [1.1 * t for t in old]}))
    half = 2.776445 * 0.01 * math.sqrt(2 / 3)
    expected = (1.1, 1.1 * math.exp(-half), 1.1 * math.exp(half))
    claims.check("the interval is Welch's", all(abs(a - b) < 6e-4 for a, b in
                                                zip(row(result, "a"), expected)), result)
    claims.check("a significant slow-down: exit code 1, named", result.returncode == 1 and
                 "slower" in result.stdout and "1 of 1 slower" in result.stdout, result)
    draw = random.Random(1)
    names = [f"b{i}" for i in range(300)]
    def sample():
        return {name: [draw.lognormvariate(5, 0.05) for _ in range(5)] for name in names}
    result = compare(write("old.json", sample()), write("new.json", sample()), "--threshold", 10)
    covered = sum(low <= 1 <= high for _, low, high in (row(result, name) for name in names))
    # 285 of 300 expected, standard deviation 3.8.
    claims.check("95 % intervals cover the truth 95 % of the time", 270 <= covered <= 298, covered)


def verdicts():
    steady = {"a": [100, 101, 99], "b": [10, 10.1, 9.9]}
    old = write("old.json", steady)
    result = compare(old, write("new.json", steady, commit="2"))
    claims.check("the same times at another commit: exit code 0", result.returncode == 0 and
                 "0 of 2 slower" in result.stdout, result)
    slower = write("slower.json", {"a": [104, 105, 103], "b": steady["b"], "c": [1]})
    result = compare(old, slower)
    claims.check("slower by less than the threshold: exit code 0", result.returncode == 0 and
                 "only in NEW: c" in result.stdout, result)
    claims.check("the same above a lower one: exit code 1",
                 compare(old, slower, "--threshold", "0.02").returncode == 1)
    noisy = write("noisy.json", {"a": [80, 100, 170], "b": steady["b"]})
    claims.check("slower by chance: exit code 0", compare(old, noisy).returncode == 0)
    once = write("once.json", {"a": [200]})
    result = compare(old, once)
    claims.check("one repetition is no evidence, and says so", result.returncode == 0 and
                 "one repetition" in result.stdout, result)
    faster = compare(slower, write("faster.json", {"a": [50, 51, 52]}))
    claims.check("a speed-up is named", faster.returncode == 0 and "faster" in faster.stdout, faster)
    unit = compare(old, write("unit.json", {"a": [.1, .101, .099]}, unit="us"))
    claims.check("units are converted", abs(row(unit, "a")[0] - 1) < 1e-9, unit)


def refusals():
    old = write("old.json", {"a": [1, 1]})
    other = write("other.json", {"a": [2, 2]}, cpu="B", flags="-O2")
    refuse("different machines", [old, other], "cpu A and B", "flags -O3 and -O2", "--force")
    forced = compare(old, other, "--force")
    claims.check("--force shows them anyway", forced.returncode == 1 and "cpu A and B" in
                 forced.stdout and "2.000" in forced.stdout, forced)
    claims.check("a clock that is measured 1 % apart is the same machine",
                 compare(old, write("clock.json", {"a": [1, 1]}, mhz_per_cpu=2725)).returncode == 0)
    refuse("a missing file", [old, scratch / "none.json"], "none.json", "No such file")
    text = scratch / "text.json"
    text.write_text("x")
    refuse("no JSON", [old, text], "text.json", "Google Benchmark")
    text.write_text("{}")
    refuse("other JSON", [old, text], "text.json", "Google Benchmark")
    refuse("aggregates only", [old, write("empty.json", {})], "empty.json", "repetitions")
    refuse("nothing in common", [old, write("b.json", {"b": [1]})], "common")
    refuse("a time of zero", [old, write("zero.json", {"a": [0]})], "real_time = 0", "> 0")
    refuse("a negative threshold", [old, old, "--threshold=-1"], "--threshold", ">= 0")


intervals()
verdicts()
refusals()
claims.exit()
