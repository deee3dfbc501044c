# SPDX-License-Identifier: Apache-2.0
"""observation_std: the noise of what policy and learner see."""
import csv
import math

from command import Claims, downpour, learn, scratch_directory

claims = Claims()
scratch = scratch_directory()


def noise(run):
    """observed - true state of every variable and step."""
    with open(run / "transitions.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    observed = [name for name in rows[0] if name.startswith("next_observation.")]
    return [float(row[name]) - float(row[name.replace("observation", "state")])
            for row in rows for name in observed]


def std(values):
    return math.sqrt(sum(x * x for x in values) / len(values))


learn(scratch / "own", task="cartpole")
own = noise(scratch / "own")
claims.check("left out, the task's own noise: 0.01 on the cart-pole", 0.008 < std(own) < 0.012,
             std(own))
learn(scratch / "none", "--set", "observation_std=0", task="cartpole")
claims.check("0: what is observed is the state", set(noise(scratch / "none")) == {0.0})
learn(scratch / "more", "--set", "observation_std=0.05")
more = noise(scratch / "more")
claims.check("0.05 on a task without noise", 0.04 < std(more) < 0.06, std(more))
result = downpour("learn", "--resume", scratch / "more", "--episodes", "5", "--quiet")
claims.check("a resumed run keeps it",
             result.returncode == 0 and 0.04 < std(noise(scratch / "more")[320:]) < 0.06, result)
result = downpour("learn", "pendulum", "--set", "observation_std=-2")
claims.check("bad values are refused in one line",
             result.returncode == 2 and "observation_std" in result.stderr and
             len(result.stderr.splitlines()) == 1, result)
claims.exit()
