# SPDX-License-Identifier: Apache-2.0
"""Bad input ends with exit code 2 and one line that says what is allowed, and loses nothing."""
import json
import pathlib
import re
import shutil

from command import TINY, Claims, contents, downpour, learn, scratch_directory

claims = Claims()
scratch = scratch_directory()
run = scratch / "run"
learn(run)


def refuse(claim, arguments, *words, kept=run, cwd=scratch):
    """The command refuses `arguments`, says all `words`, and leaves the files of `kept` alone."""
    before = contents(kept)
    listing = sorted(scratch.iterdir())
    result = downpour(*arguments, cwd=cwd)
    lines = result.stderr.splitlines()
    details = f"exit code {result.returncode}, stderr: {result.stderr!r}"
    claims.check(claim, result.returncode == 2 and len(lines) == 1 and
                 lines[0].startswith("downpour: ") and result.stdout == "" and
                 all(word in lines[0] for word in words), details)
    if contents(kept) != before or sorted(scratch.iterdir()) != listing:
        claims.check(f"{claim}: nothing is written", False)


def config_file(text):
    path = scratch / "config.toml"
    path.write_text(text)
    return path


def copy_of_run(name):
    path = scratch / name
    shutil.copytree(run, path)
    return path


def command_line():
    refuse("no command", [], "subcommand", "--help")
    refuse("unknown command", ["lern"], "lern", "did you mean learn?")
    refuse("no task", ["learn"], "task", "pendulum, cartpole, arm")
    refuse("unknown task", ["learn", "pendulim"], "pendulim", "pendulum, cartpole, arm",
           "did you mean pendulum?")
    refuse("a misspelt preset", ["learn", "pendulum", "--preset", "papr"], "did you mean paper?")
    for option in ("--config", "--out", "--resume", "--mjcf"):
        refuse(f'{option} ""', ["learn", "pendulum", option, ""], option, "must not be empty")
    refuse('learn ""', ["learn", ""], "TASK", "must not be empty")
    refuse('evaluate ""', ["evaluate", ""], "RUN", "must not be empty")
    refuse("--set task= of another task", ["learn", "pendulum", "--set", "task=cartpole"],
           "TASK: task = pendulum: must be cartpole, as --set has it")
    refuse("unknown option", ["learn", "pendulum", "--episods", "3"], "--episods", "--episodes?")
    refuse("unknown option of evaluate", ["evaluate", run, "--start", "3"], "--start", "--starts?")
    refuse("extra argument", ["learn", "pendulum", "more"], "more")
    refuse("option without its value", ["learn", "pendulum", "--seed"], "--seed", "required")
    refuse("option given twice", ["learn", "pendulum", "--seed", "1", "--seed", "2"], "--seed")
    refuse("--set without =", ["learn", "pendulum", "--set", "seed"], "seed", "KEY=VALUE")
    refuse("unknown key close to one", ["learn", "pendulum", "--set", "search.evalutions=500"],
           "--set", "search.evalutions", "did you mean search.evaluations?")
    refuse("unknown key far from any", ["learn", "pendulum", "--set", "x.y=1"], "x.y", "allowed: ",
           "learn.seed", "rollout.variance")
    refuse("unknown key of a known table", ["learn", "pendulum", "--set", "search.x=1"],
           "search.x; the closest is search.")
    refuse("key without its table", ["learn", "pendulum", "--set", "episodes=3"],
           "did you mean learn.episodes?")
    refuse("spaces round a key and its value",
           ["learn", "pendulum", "--set", " search.rollouts = 0 "],
           "--set: search.rollouts = 0: must be")
    for option, key, value, allowed in [
            ("--episodes", "learn.episodes", "nan", "an integer in [2, 1000]"),
            ("--episodes", "learn.episodes", "0", "an integer in [2, 1000]"),
            ("--episodes", "learn.episodes", "2.5", "an integer in [2, 1000]"),
            ("--episodes", "learn.episodes", "three", "an integer in [2, 1000]"),
            ("--episodes", "learn.episodes", "", "an integer in [2, 1000]"),
            ("--random-episodes", "learn.random_episodes", "1001", "an integer in [1, 999]"),
            ("--seed", "learn.seed", "-1", "an integer in [0, 9223372036854775807]"),
            ("--seed", "learn.seed", "9223372036854775808", "[0, 9223372036854775807]"),
            ("--threads", "learn.threads", "-2", "an integer in [0, 1024]"),
            ("--evaluations", "search.evaluations", "99", "an integer in [100, 1000000000000]"),
            ("--population", "search.population", "-4", "an integer in [0, 100000]"),
            ("--rollouts", "search.rollouts", "inf", "an integer in [1, 10000]"),
            ("--preset", "preset", "papr", "one of paper, original-code"),
            ("--backend", "model.backend", "cublas", "one of fused, blas; did you mean blas?"),
            ("--backend", "model.backend", "openblas", "one of fused, blas"),
            ("--backend", "model.backend", "", "one of fused, blas")]:
        refuse(f"{option} {value}", ["learn", "pendulum", option, value], f"{option}: ",
               f"{key} = {value}: must be ", allowed)
    refuse("a population of one", ["learn", "pendulum", "--population", "1"], "search.population",
           "[2, 100000]")
    refuse("a search that its budget does not hold",
           ["learn", "pendulum", "--population", "100000", "--rollouts", "10000"],
           "search.evaluations = 300000: must be at least", "search.population = 100000",
           "search.rollouts = 10000")
    refuse("as many random episodes as episodes",
           ["learn", "pendulum", "--episodes", "2", "--random-episodes", "2"],
           "learn.random_episodes = 2: must be less than learn.episodes = 2")
    for option, value, allowed in [("--starts", "0", "[1, 1000000]"), ("--starts", "nan", "integer"),
                                   ("--start-std", "nan", "[0, 1000]"),
                                   ("--start-std", "-0.1", "[0, 1000]"),
                                   ("--seed", "-1", "integer"), ("--episode", "1.5", "integer")]:
        refuse(f"evaluate {option} {value}", ["evaluate", run, option, value], option, value,
               allowed)


def config_files():
    def refuse_text(claim, text, *words):
        path = config_file(text)
        refuse(claim, ["learn", "pendulum", "--config", path], f"{path}:", *words)
        path.unlink()

    refuse("--config: missing file", ["learn", "pendulum", "--config", "none.toml"], "none.toml",
           "No such file")
    refuse("--config: a directory", ["learn", "pendulum", "--config", run], str(run), "directory")
    refuse_text("TOML syntax error, with its line", "[search]\nrollouts = = 3\n", ":2:")
    refuse_text("unknown key, with its line", "\n[search]\nrollout = 3\n", ":3: ",
                "search.rollout;", "did you mean search.rollouts?")
    refuse_text("a table for a value", "[learn.seed]\nx = 1\n", ":1: ", "unknown table learn.seed")
    refuse_text("an unknown table, though empty", "\n[serch]\n", ":2: ", "unknown table serch; ",
                "did you mean search?")
    refuse_text("an empty table far from any", "[x]\n", ":1: ", "unknown table x; ",
                "allowed: learn, policy, model, search, rollout, pilco, system, prior, output")
    for line, allowed in [("bound = nan", "a number in (0, 1000000]"),
                          ("bound = inf", "a number in (0, 1000000]"),
                          ("bound = 0.0", "a number in (0, 1000000]"),
                          ("first_sigma = -1.0", "a number in (0, 1000000]"),
                          ("rollouts = 0", "an integer in [1, 10000]"),
                          ("rollouts = '5'", "an integer in [1, 10000]"),
                          ("rollouts = 1979-05-27", "an integer in [1, 10000]"),
                          ("restarts = 'none'", "one of bipop, small, ipop, single"),
                          ("uncertainty = 1", "one of off, sigma, rollouts, lra"),
                          ("covariance = 'none'", "one of auto, full, diagonal, limited-memory")]:
        refuse_text(f"TOML: {line}", f"[search]\n{line}\n", ":2: ", f"search.{line}: must be ",
                    allowed)
    refuse_text("a file of another task", "task = 'cartpole'\n", "TASK: task = pendulum: must be ",
                "cartpole, as", ":1 has it")
    refuse_text("TOML: variance = 1", "[rollout]\nvariance = 1\n", "true or false")
    refuse_text("TOML: mjcf = 3", "mjcf = 3\n", ":1: mjcf = 3: must be a string")


def run_directories():
    refuse("--out that is not empty", ["learn", "pendulum", "--out", run, *TINY], str(run),
           "not empty", "--resume")
    refuse("--out that is a file", ["learn", "pendulum", "--out", run / "config.toml"],
           "config.toml", "not a directory")
    refuse("--out below a file", ["learn", "pendulum", "--out", run / "config.toml" / "x"],
           "config.toml/x", "Not a directory")
    refuse("--resume: no such run", ["learn", "--resume", "none"], "none", "config.toml")
    refuse("--resume: another task", ["learn", "cartpole", "--resume", run], "cartpole", "pendulum")
    for option in (["--seed", "3"], ["--evaluations", "1000"], ["--set", "search.rollouts=2"],
                   ["--out", "x"], ["--config", run / "config.toml"], ["--preset", "paper"],
                   ["--backend", "blas"]):
        refuse(f"--resume with {option[0]}", ["learn", "--resume", run, *option], option[0],
               "--resume", "allowed: --episodes")
    refuse("evaluate: no such run", ["evaluate", "none"], "none", "config.toml")
    refuse("evaluate: an episode that is not there", ["evaluate", run, "--episode", "99"],
           "policy_99.json")


def checkpoints():
    original = (run / "checkpoint.json").read_text()
    middle = len(original) // 2
    digit = next(i for i in range(middle, len(original)) if original[i] in "123456789")
    flipped = original[:digit] + str(10 - int(original[digit])) + original[digit + 1:]
    if flipped == original:  # a 5 stays itself
        flipped = original[:digit] + "6" + original[digit + 1:]
    for name, text, word in [
            ("truncated", original[:middle], f"truncated at byte {middle} of {middle}:"),
            ("empty", "", "JSON"),
            ("corrupted", flipped, "checksum"),
            ("future", re.sub('"version":[0-9]+', '"version":99', original), "99")]:
        damaged = copy_of_run(name)
        (damaged / "checkpoint.json").write_text(text)
        refuse(f"checkpoint: {name}", ["learn", "--resume", damaged, "--episodes", "5"],
               str(damaged / "checkpoint.json"), word, kept=damaged)
    damaged = copy_of_run("missing")
    (damaged / "checkpoint.json").unlink()
    refuse("checkpoint: missing", ["learn", "--resume", damaged], "checkpoint.json", "missing",
           kept=damaged)
    damaged = copy_of_run("other-seed")
    config = (damaged / "config.toml").read_text()
    (damaged / "config.toml").write_text(config.replace("seed = 0\n", "seed = 1\n"))
    refuse("checkpoint: of other settings", ["learn", "--resume", damaged], "checkpoint.json",
           "seed", kept=damaged)
    damaged = copy_of_run("policy")
    policy = (damaged / "policy.json").read_text()
    (damaged / "policy.json").write_text(policy[:len(policy) // 2])
    refuse("evaluate: truncated policy", ["evaluate", damaged], "policy.json", kept=damaged)
    changed = json.loads(policy)
    changed["parameters"][3] = "nan"
    (damaged / "policy.json").write_text(json.dumps(changed))
    refuse("evaluate: a policy with a NaN", ["evaluate", damaged], "policy.json: parameters[3]",
           "finite", kept=damaged)
    changed = json.loads(policy)
    changed["action_limits"] = [7]
    (damaged / "policy.json").write_text(json.dumps(changed))
    refuse("evaluate: a policy of other limits", ["evaluate", damaged], "policy.json: policy of",
           "action_limits", kept=damaged)


def mjcf_files():
    model = scratch / "model.xml"
    refuse("MJCF: missing", ["learn", "pendulum", "--mjcf", "none.xml"], "none.xml")
    for claim, text in [("no XML", "<mujoco><worldbody>"), ("unknown element", "<mujoco><x/></mujoco>"),
                        ("without joints", "<mujoco><worldbody/></mujoco>"), ("empty", "")]:
        model.write_text(text)
        refuse(f"MJCF: {claim}", ["learn", "pendulum", "--mjcf", model], str(model))
    own = (pathlib.Path(__file__).parents[2] / "tasks/pendulum/pendulum.xml").read_text()
    model.write_text(own)
    learn(scratch / "model", "--mjcf", model)
    model.write_text(own.replace("-9.82", "-5"))
    refuse("MJCF: changed since the run began", ["learn", "--resume", scratch / "model",
                                                 "--episodes", "5"],
           "checkpoint.json", "task.model_digest", kept=scratch / "model")
    model.write_text(own)
    resumed = downpour("learn", "--resume", scratch / "model", "--episodes", "5", "--quiet")
    claims.check("MJCF: put back, the run goes on",
                 resumed.returncode == 0 and resumed.stderr == "", resumed)
    model.unlink()


command_line()
config_files()
run_directories()
checkpoints()
mjcf_files()
claims.exit()
