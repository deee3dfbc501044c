# SPDX-License-Identifier: Apache-2.0
"""Rewards that the learner does not know, by the command: options, tables, resume, refusals."""
import csv
import tomllib

from command import Claims, downpour, learn, results, scratch_directory, TINY

claims = Claims()
scratch = scratch_directory()


def setting(run, table, key):
    return tomllib.loads((run / "config.toml").read_text())[table][key]


def outputs(run):
    """Outputs that plans.csv names."""
    with open(run / "plans.csv", newline="") as file:
        return sorted({row["output"] for row in csv.DictReader(file)})


def plain():
    learn(scratch / "known")
    learn(scratch / "unknown", "--learn-reward")
    claims.check("the pendulum's reward is known unless --learn-reward is given",
                 setting(scratch / "known", "learn", "learn_reward") is False and
                 setting(scratch / "unknown", "learn", "learn_reward") is True)
    claims.check("plans.csv: a learnt reward is one more output",
                 outputs(scratch / "known") == ["angle", "angular_velocity"] and
                 outputs(scratch / "unknown") == ["angle", "angular_velocity", "reward"],
                 outputs(scratch / "unknown"))
    header = (scratch / "unknown" / "timing.csv").read_text().splitlines()[0]
    claims.check("timing.csv: the reward's queries are timed",
                 header.endswith(",gp_query_time.reward [ns]"), header)
    table = (scratch / "unknown" / "hyperparameters.csv").read_text()
    claims.check("hyperparameters.csv: the reward's inputs are the features, not the action",
                 ",reward,lengthscale.sin_angle," in table and
                 ",reward,lengthscale.torque," not in table, table)


def arm():
    learn(scratch / "arm", task="arm")
    claims.check("the arm's reward is unknown by default",
                 setting(scratch / "arm", "learn", "learn_reward") is True and
                 "reward" in outputs(scratch / "arm"))
    learn(scratch / "told", "--set", "learn.learn_reward=false", task="arm")
    claims.check("--set learn.learn_reward=false tells the arm's reward",
                 outputs(scratch / "told") == [f"joint_{i}" for i in range(4)])
    evaluated = downpour("evaluate", scratch / "arm", "--starts", "3")
    claims.check("evaluate: runs a policy of the arm", evaluated.returncode == 0 and
                 "solved" in evaluated.stdout, evaluated)
    listing = downpour("tasks").stdout
    claims.check("tasks: says that the arm's reward is unknown",
                 "unknown to the learner" in listing, listing)


def resume():
    whole = scratch / "arm"
    cut = scratch / "cut"
    two = ["2" if word == "4" else word for word in TINY]  # of the episodes
    result = downpour("learn", "arm", "--out", cut, "--quiet", *two)
    claims.check("a run of two episodes of the arm ends well", result.returncode == 0, result)
    result = downpour("learn", "--resume", cut, "--episodes", "4", "--quiet")
    claims.check("resumed, it ends with the files of the uninterrupted run",
                 result.returncode == 0 and results(cut) == results(whole), result)
    text = (cut / "config.toml").read_text()
    (cut / "config.toml").write_text(text.replace("learn_reward = true", "learn_reward = false"))
    result = downpour("learn", "--resume", cut, "--episodes", "5", "--quiet")
    claims.check("resumed with a reward that is known, it is refused in one line",
                 result.returncode != 0 and "learn.learn_reward = true" in result.stderr and
                 result.stderr.count("\n") == 1, result)


def refusals():
    result = downpour("learn", "arm", "--out", scratch / "none", "--set",
                      "search.stop_lost_causes=true")
    claims.check("stop_lost_causes with a learnt reward is refused in one line, nothing written",
                 result.returncode != 0 and "search.stop_lost_causes = true" in result.stderr and
                 "learn.learn_reward" in result.stderr and result.stderr.count("\n") == 1 and
                 not (scratch / "none").exists(), result)


plain()
arm()
resume()
refusals()
claims.exit()
