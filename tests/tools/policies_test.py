# SPDX-License-Identifier: Apache-2.0
"""Every kind of policy is learnt by the command, answers states, and is exported as C that agrees."""
import json
import math
import random
import subprocess
import sys
import threading

from command import PROGRAM, TINY, Claims, downpour, learn, results, scratch_directory

claims = Claims()
scratch = scratch_directory()
EPS = sys.float_info.epsilon
KINDS = {
    "nn": [],
    "nn-deep": ["--hidden", "6,4", "--set", "policy.activation=relu"],
    "linear": ["--policy", "linear"],
    "gp": ["--policy", "gp", "--policy-points", "6"],
    "dmp": ["--policy", "dmp", "--policy-points", "5"],
}
CALLER = """
#include <stdio.h>
#include "policy.h"
int main(void) {
  double state[%d], action[1];
  int step = 0, i;
  for (;; ++step) {
    for (i = 0; i < %d; ++i) if (scanf("%%lf", state + i) != 1) return 0;
    downpour_policy(state, %s action);
    printf("%%.17g\\n", action[0]);
  }
}
"""


def kappa(a):
    return (9 * math.sin(a) + math.sin(3 * a)) / 8


def solve(matrix, right):
    """Gaussian elimination of a positive definite system."""
    n = len(right)
    rows = [row[:] + [r] for row, r in zip(matrix, right)]
    for k in range(n):
        for i in range(n):
            if i != k:
                factor = rows[i][k] / rows[k][k]
                rows[i] = [a - factor * b for a, b in zip(rows[i], rows[k])]
    return [rows[i][n] / rows[i][i] for i in range(n)]


def reference(policy, x):
    """The action for features x by the formulas of docs/policies.md, and a bound of the rounding
    in it, both without the limit; one action."""
    theta, dim = policy["parameters"], len(x)
    x = [value / scale for value, scale in zip(x, policy["input_scale"])]
    if policy["kind"] == "linear":
        terms = [w * v for w, v in zip(theta, x)] + [theta[dim]]
        return kappa(sum(terms)), 1.5 * (dim + 3) * sum(map(abs, terms)) * EPS + 8 * EPS
    if policy["kind"] == "nn":
        y, error = x, 3 * EPS
        units = policy["hidden_units"] + [1]
        for layer, n in enumerate(units):
            m, out, sums = len(y), [], []
            for o in range(n):
                terms = [theta[o * m + i] * y[i] for i in range(m)] + [theta[n * m + o]]
                sums.append((m + 3) * sum(map(abs, terms)) * EPS +
                            sum(map(abs, theta[o * m:(o + 1) * m])) * error)
                relu = policy["activation"] == "relu" and layer + 1 < len(units)
                out.append(max(sum(terms), 0) if relu else math.tanh(sum(terms)))
            y, error, theta = out, max(sums) + 6 * EPS, theta[n * (m + 1):]
        return y[0], error
    n = policy["points"]
    z = [theta[i * dim:(i + 1) * dim] for i in range(n)]
    targets, logs = theta[n * dim:n * dim + n], theta[n * dim + n:]

    def k(a, b):
        return math.exp(-sum(((p - q) / math.exp(l)) ** 2 for p, q, l in zip(a, b, logs)) / 2)
    alpha = solve([[k(a, b) + (0.01 if a is b else 0) for b in z] for a in z], targets)
    norm = math.sqrt(sum(a * a for a in alpha))
    # As in tests/kernels/policy_kernels_test.cc; coordinates in length-scales.
    reach = max(max(abs(v) for v in a) for a in z + [x]) / math.exp(min(logs))
    kernel = EPS * (4 * dim * reach + 2 * dim + 8)
    bound = 1.5 * norm * (30 * n * ((n + 2) * EPS + kernel) + math.sqrt(n) * (n * EPS + kernel))
    return kappa(sum(a * k(x, b) for a, b in zip(alpha, z))), bound + 8 * EPS


def features(policy, state):
    functions = {"identity": lambda v: v, "cosine": math.cos, "sine": math.sin}
    return [functions[f["function"]](state[f["state"]]) for f in policy["feature_map"]]


def lines_of(states, separator=" "):
    return "".join(separator.join(map(repr, state)) + "\n" for state in states)


def compiled(directory, policy):
    """The exported header in a C99 program."""
    (directory / "caller.c").write_text(
        CALLER % (len(policy["states"]), len(policy["states"]),
                  "step," if policy["kind"] == "dmp" else ""))
    result = subprocess.run(
        ["cc", "-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "caller.c", "-o", "caller",
         "-lm"], cwd=directory, capture_output=True, text=True)
    claims.check(f"{directory.name}: the header compiles as C99 without a warning",
                 result.returncode == 0, result.stderr)
    return directory / "caller"


def check_kind(name, options, task):
    run = scratch / f"{task}-{name}"
    learn(run, *options, task=task)
    policy = json.loads((run / "policy.json").read_text())
    claims.check(f"{run.name}: the policy has its kind", policy["kind"] == name.split("-")[0])
    numbers = random.Random(1)
    states = [[numbers.uniform(-6, 6) for _ in policy["states"]] for _ in range(50)]
    acted = downpour("act", run / "policy.json", input=lines_of(states))
    actions = [float(line) for line in acted.stdout.splitlines()]
    claims.check(f"{run.name}: act gives an action a line", acted.returncode == 0 and
                 acted.stderr == "" and len(actions) == 50, acted)
    limit = policy["action_limits"][0]
    claims.check(f"{run.name}: actions keep the limit and differ",
                 max(map(abs, actions)) <= limit and len(set(actions)) > 1, actions)
    same = [downpour("act", run, input=lines_of(states, ", ")).stdout,
            downpour("act", run, input="".join(f"{state}\n" for state in states)).stdout]
    claims.check(f"{run.name}: commas and JSON arrays give the same", same == [acted.stdout] * 2)
    program = scratch / f"{run.name}-c"
    program.mkdir()
    exported = downpour("export", run, "-o", program / "policy.h")
    claims.check(f"{run.name}: export writes a header", exported.returncode == 0 and
                 exported.stdout + exported.stderr == "", exported)
    ran = subprocess.run([compiled(program, policy)], input=lines_of(states), capture_output=True,
                         text=True)
    by_c = [float(line) for line in ran.stdout.splitlines()]
    if policy["kind"] == "dmp":
        claims.check(f"{run.name}: the header gives the same actions", by_c == actions)
        return
    wanted = [reference(policy, features(policy, state)) for state in states]
    worst = max(abs(a - limit * u) - limit * e for a, (u, e) in zip(actions, wanted))
    claims.check(f"{run.name}: act follows the documented formula", worst <= 0, worst)
    # Both round; so twice the bound.
    worst = max(abs(a - c) - 2 * limit * e for a, c, (_, e) in zip(actions, by_c, wanted))
    claims.check(f"{run.name}: the header agrees up to rounding",
                 len(by_c) == 50 and worst <= 0, worst)


def resume(name, options):
    short, whole = scratch / f"{name}-short", scratch / f"pendulum-{name}"
    tiny = [*TINY]
    tiny[tiny.index("--episodes") + 1] = "3"
    downpour("learn", "pendulum", "--out", short, "--quiet", *tiny, *options)
    resumed = downpour("learn", "--resume", short, "--episodes", "4", "--quiet")
    claims.check(f"{name}: a resumed run ends with the same bits", resumed.returncode == 0 and
                 results(short)["episodes.csv"] == results(whole)["episodes.csv"], resumed)


def configuration():
    learn(scratch / "cart", "--policy", "gp", task="cartpole")
    config = (scratch / "cart" / "config.toml").read_text()
    claims.check("config.toml: the task's number of points", "\npoints = 20\n" in config)
    learn(scratch / "deep", "--set", "policy.hidden_units=[3, 2]")
    text = (scratch / "deep" / "config.toml").read_text()
    claims.check("config.toml: a list of layers", "\nhidden_units = [3, 2]\n" in text)
    learn(scratch / "again", "--config", scratch / "deep" / "config.toml")
    claims.check("config.toml: read again, the same run",
                 results(scratch / "again") == results(scratch / "deep"))


def refuse(claim, result, *words):
    lines = result.stderr.splitlines()
    claims.check(claim, result.returncode == 2 and len(lines) == 1 and
                 all(word in lines[0] for word in words), result)


def bad_input():
    for option, key, value, allowed in [
            ("--policy", "policy.kind", "nnn", "one of nn, linear, gp, dmp; did you mean nn?"),
            ("--hidden", "policy.hidden_units", "0", "integers in [1, 256]"),
            ("--hidden", "policy.hidden_units", "16,300", "integers in [1, 256]"),
            ("--hidden", "policy.hidden_units", "16,x", "integers in [1, 256]"),
            ("--hidden", "policy.hidden_units", "1.5", "integers in [1, 256]"),
            ("--hidden", "policy.hidden_units", "[]", "integers in [1, 256]"),
            ("--policy-points", "policy.points", "201", "an integer in [0, 200]"),
            ("--policy-points", "policy.points", "-1", "an integer in [0, 200]")]:
        refuse(f"{option} {value}", downpour("learn", "pendulum", f"{option}={value}", *TINY),
               f"{option}: {key} = {value}: must be ", allowed)
    refuse("nine hidden layers", downpour("learn", "pendulum", "--hidden", "1,1,1,1,1,1,1,1,1"),
           "number of policy.hidden_units = 9: must be in [1, 8]")
    refuse("an activation that is none", downpour("learn", "pendulum", "--set",
                                                  "policy.activation=elu"), "one of tanh, relu")
    run = scratch / "pendulum-gp"
    refuse("act: no such file", downpour("act", "none.json"), "none.json")
    refuse("act: a run without a policy", downpour("act", scratch), "policy.json")
    refuse("export: below a file", downpour("export", run, "-o", run / "policy.json" / "x"), "policy.json/x")
    for line in ["", "1", "1 2 3", "1,x", "nan 0", "inf 0", "1e5 0", "[1, 2", "[1, \"2\"]",
                 "{\"a\": [1, 2]}", "\x00", "1 2 \u00e9"]:
        result = downpour("act", run, input=f"0 0\n{line}\n0 0\n")
        refuse(f"act: {line!r}", result, "standard input:2: ", "2 numbers in [-30000, 30000] "
               "(angular_velocity, angle)")
        claims.check(f"act: {line!r} gets no action", len(result.stdout.splitlines()) == 1)
    policy = json.loads((run / "policy.json").read_text())
    policy["kind"] = "mine"
    (scratch / "mine.json").write_text(json.dumps(policy))
    for command in ("act", "export"):
        refuse(f"{command}: a user's own kind", downpour(command, scratch / "mine.json", input=""),
               "kind = \"mine\": must be one of nn, linear, gp, dmp")


def old_file():
    """As version 0.1 wrote it before there were other kinds: the task is known by its name."""
    policy = json.loads((scratch / "pendulum-nn" / "policy.json").read_text())
    for key in ("activation", "states", "feature_map", "control_period", "horizon"):
        del policy[key]
    policy["hidden_units"] = policy["hidden_units"][0]
    (scratch / "old.json").write_text(json.dumps(policy))
    old, new = (downpour("act", path, input="1 2\n")
                for path in (scratch / "old.json", scratch / "pendulum-nn"))
    claims.check("act: an old file acts as a new one", old.stdout == new.stdout != "", old)


def flushed():
    """The answer to a state comes before the next state is given."""
    process = subprocess.Popen([PROGRAM, "act", str(scratch / "pendulum-gp")], text=True,
                               stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    timer = threading.Timer(20, process.kill)  # an answer that never comes
    timer.start()
    answers = []
    for state in ("0 0", "1 1"):
        process.stdin.write(state + "\n")
        process.stdin.flush()
        answers.append(process.stdout.readline())
    process.stdin.close()
    timer.cancel()
    claims.check("act: answers at once, and ends with its input",
                 process.wait() == 0 and all(answers), answers)


for kind, arguments in KINDS.items():
    check_kind(kind, arguments, "pendulum")
    resume(kind, arguments)
check_kind("gp", KINDS["gp"], "cartpole")
configuration()
bad_input()
old_file()
flushed()
claims.exit()
