# SPDX-License-Identifier: Apache-2.0
"""A robot behind a program: learns to the bits of the simulator; no failure of it loses a step."""
import concurrent.futures
import csv
import json
import pathlib
import re
import shlex
import signal
import subprocess
import sys
import time

from command import PROGRAM, TINY, Claims, contents, downpour, learn, results, scratch_directory

HERE = pathlib.Path(__file__).parent
EXAMPLE = HERE.parents[1] / "tools" / "robot_example.py"
# A step's answer that is to come has long; one that is not to come has little.
PATIENT = ["--set", "system.timeout=60"]
HASTY = ["--set", "system.timeout=1"]

TWO = [argument if argument != "4" else "2" for argument in TINY]  # episodes

claims = Claims()
scratch = scratch_directory()


def command(*words):
    return "exec:" + shlex.join(map(str, words))


def fake(fault, where, *log):
    return command(sys.executable, HERE / "fake_robot.py", fault, where, *log)


def rows(run, table):
    with open(run / table, newline="") as file:
        return list(csv.DictReader(file))


def runs(pid):
    """Whether the process is there; an orphan that nobody has waited for yet is not."""
    try:
        stat = pathlib.Path(f"/proc/{pid}/stat").read_text()
    except OSError:
        return False
    return stat.rpartition(")")[2].split()[0] not in "ZX"


def left_over(log):
    pids = {int(pid) for pid in re.findall(r"pid (\d+)", log.read_text())}
    deadline = time.monotonic() + 5
    while any(map(runs, pids)) and time.monotonic() < deadline:
        time.sleep(0.02)
    return [pid for pid in pids if runs(pid)] if pids else ["no process at all"]


def same_bits():
    """The example's robot is the simulator itself, and Python stands in between."""
    options = ["--evaluations", "1500", "--episodes", "3", "--threads", "2", "--quiet"]
    for task in ("pendulum", "cartpole"):
        built_in, robot = scratch / f"{task}-built-in", scratch / f"{task}-robot"
        log = scratch / f"{task}.log"
        downpour("learn", task, "--out", built_in, *options)
        result = downpour("learn", task, "--out", robot, *options, *PATIENT, "--system",
                          command(EXAMPLE, PROGRAM, log))
        claims.check(f"{task}: the example's robot ends well", result.returncode == 0 and
                     result.stdout + result.stderr == "", result)
        expected, found = results(built_in), results(robot)
        claims.check(f"{task}: episodes.csv has the bits of the built-in simulator",
                     expected["episodes.csv"] == found["episodes.csv"])
        claims.check(f"{task}: so have the policies", all(
            expected[name] == found[name] for name in ("policy.json", "policy_2.json")))
        ours, theirs = rows(built_in, "transitions.csv"), rows(robot, "transitions.csv")
        noise_free = [key for key in ours[0] if key.startswith("next_state.")]
        observed = [key for key in ours[0] if key not in noise_free]
        claims.check(f"{task}: so has transitions.csv, noise-free states aside",
                     len(ours) == 120 and [[row[key] for key in observed] for row in ours] ==
                     [[row[key] for key in observed] for row in theirs])
        claims.check(f"{task}: for which a robot has its observations", all(
            row[key] == row[key.replace("next_state.", "next_observation.")]
            for row in theirs for key in noise_free))
        claims.check(f"{task}: the log of the example has every step",
                     len(log.read_text().splitlines()) == 120)
    claims.check("pendulum, which has no noise: all of transitions.csv",
                 (scratch / "pendulum-built-in" / "transitions.csv").read_bytes() ==
                 (scratch / "pendulum-robot" / "transitions.csv").read_bytes())


def failure(fault, what, step=7, timeout=PATIENT):
    """The fault at `step` of episode 2 ends the run; it goes on without the fault."""
    run, log = scratch / f"fault-{fault}", scratch / f"fault-{fault}.log"
    result = downpour("learn", "pendulum", "--out", run, "--quiet", *TINY, *timeout, "--system",
                      fake(fault, min(step, 7), log))
    outcome = f"aborted at step {step}: {what}"
    claims.check(f"{fault}: exit code 3, one line: how it failed, what is kept, how to go on",
                 result.returncode == 3 and result.stdout == "" and result.stderr ==
                 f"downpour: episode 2 {outcome}; episodes 1 to 2 are kept in {run}; go on with: "
                 f"{PROGRAM} learn --resume {run}\n", result)
    episode = rows(run, "episodes.csv")[-1]
    steps = rows(run, "transitions.csv")
    claims.check(f"{fault}: the episode is marked, and the steps before it are kept",
                 episode["episode"] == "2" and episode["outcome"] == outcome and
                 episode["steps"] == str(step) and episode["solved"] == "false" and
                 len(steps) == 40 + step and steps[-1]["step"] == str(step - 1), episode)
    claims.check(f"{fault}: no process is left", left_over(log) == [], left_over(log))
    before = contents(run)
    again = downpour("learn", "--resume", run, "--json", "--system", fake("none", "none"))
    lines = [json.loads(line) for line in again.stdout.splitlines()]
    claims.check(f"{fault}: resumed, the next episode learns from all of them",
                 again.returncode == 0 and [line["episode"] for line in lines] == [3, 4] and
                 lines[0]["points"] == 40 + step and
                 [line["outcome"] for line in lines] == ["complete", "complete"], again)
    claims.check(f"{fault}: and the marked episode stays what it was",
                 rows(run, "episodes.csv")[1] == episode and contents(run) != before)


def failures():
    """Three at a time: most of it is waiting."""
    pool = concurrent.futures.ThreadPoolExecutor(3)
    begun = []

    def begin(*arguments, **options):
        begun.append(pool.submit(*arguments, **options))

    none = "the robot's program sent no message of the protocol: "
    answer = "the robot's answer: "
    begin(failure, "hang", "the robot's program gave no answer within 1 s", timeout=HASTY)
    begin(failure, "partial", "the robot's program gave only a part of a line within 1 s",
          timeout=HASTY)
    begin(failure, "stubborn", "the robot's program gave no answer within 1 s", timeout=HASTY)
    begin(failure, "family", "the robot's program exited with status 4")
    begin(failure, "die", "the robot's program exited with status 3")
    begin(failure, "killed", "the robot's program was killed by signal 9 (Killed)")
    begin(failure, "closed", "the robot's program closed its standard output")
    begin(failure, "garbage", none + r'"motor \u001b[31mready\u001b[0m, 42"')
    begin(failure, "binary", none + '"\ufffd\ufffd\\u0000\ufffd"')
    begin(failure, "array", none + '"[1, 2]"')
    begin(failure, "deep", none + r'"{\"type\":' + 72 * "[" + '..."')
    begin(failure, "huge", "the robot's program sent a line of more than 1 MiB")
    begin(failure, "flood", none + '"' + 80 * "x" + '..."')
    begin(failure, "nan",
          none + r'"{\"type\": \"observation\", \"step\": 7, \"observation\": [NaN, 0]}"')
    begin(failure, "nan-text", answer + 'observation[0] = "nan": must be within +-1e+06')
    begin(failure, "range", answer + "observation[1] = -2000000.0: must be within +-1e+06")
    begin(failure, "dimension", answer + "observation = [0,0,0]: must be an array of 2 numbers")
    begin(failure, "reward", answer + 'reward = "much": must be a number')
    begin(failure, "error", r'the robot reports "the operator pressed \"stop\" \u001b[1mü\n, now"')
    begin(failure, "silent-error", answer + "message is missing")
    begin(failure, "extra", "the robot's program sent a line that nothing asked for: "
          r'"{\"type\": \"log\"}"', step=8)
    begin(failure, "stale", answer + "step = 6: must be 7")
    for each in begun:
        each.result()


def without_a_step():
    for fault, what, timeout in [
            ("die", "the robot's program exited with status 3", "60.0"),
            ("hang", "the robot's program gave no answer within 1.5 s", "1.5")]:
        run, log = scratch / f"start-{fault}", scratch / f"start-{fault}.log"
        downpour("learn", "pendulum", "--out", run, "--quiet", *TWO, "--system",
                 fake("none", "none"))
        before = (run / "checkpoint.json").read_text()
        setup = run / "config.toml"
        setup.write_text(setup.read_text().replace("setup_timeout = 60.0",
                                                   f"setup_timeout = {timeout}"))
        result = downpour("learn", "--resume", run, "--episodes", "4", "--quiet", "--system",
                          fake(fault, "3:start", log))
        claims.check(f"{fault} at the reset: one line, exit code 3, the episode is not counted",
                     result.returncode == 3 and result.stderr ==
                     f"downpour: episode 3 aborted before its first step: {what}; episodes 1 to 2 "
                     f"are kept in {run}; go on with: {PROGRAM} learn --resume {run}\n" and
                     (run / "checkpoint.json").read_text() == before, result)
        claims.check(f"{fault} at the reset: no process is left", left_over(log) == [])
        setup.write_text(setup.read_text().replace(f"setup_timeout = {timeout}",
                                                   "setup_timeout = 60.0"))
        downpour("learn", "--resume", run, "--quiet", "--system", fake("none", "none"))
        whole = scratch / "whole"
        if not whole.exists():
            learn(whole, "--system", fake("none", "none"))
        claims.check(f"{fault} at the reset: resumed, it has the bits of a run without the failure",
                     results(run)["episodes.csv"] == results(whole)["episodes.csv"] and
                     results(run)["transitions.csv"] == results(whole)["transitions.csv"])


def not_failures():
    for fault, steps in [("slow", 40), ("done", 8)]:
        run = scratch / f"fine-{fault}"
        learn(run, *PATIENT, "--system", fake(fault, 7))
        episodes = rows(run, "episodes.csv")
        claims.check(f"{fault}: the run goes on to its end", len(episodes) == 4 and
                     episodes[1]["steps"] == str(steps) and
                     episodes[1]["outcome"] == ("done" if fault == "done" else "complete") and
                     episodes[2]["points"] == str(40 + steps), episodes)
    run = scratch / "last"
    result = downpour("learn", "pendulum", "--out", run, "--quiet", *TWO, "--system",
                      fake("die", 7))
    claims.check("a failure in the last episode says how to have another one",
                 result.returncode == 3 and
                 result.stderr.endswith(f"learn --resume {run} --episodes 3\n"), result)


def refused():
    """Nothing is written, and no process stays."""
    listing = set(scratch.iterdir())

    def refuse(claim, system, code, *words, options=()):
        run = scratch / "refused"
        result = downpour("learn", "pendulum", "--out", run, "--system", system, *options, *TINY)
        lines = result.stderr.splitlines()
        claims.check(claim, result.returncode == code and len(lines) == 1 and
                     all(word in lines[0] for word in words) and not run.exists(), result)

    refuse("no exec:", "python3 robot.py", 2, "--system: system.program = python3 robot.py: must "
           "begin with exec:")
    refuse("an open quote", "exec:a 'b", 2, "system.program = exec:a 'b: a quote ' is open")
    refuse("no program", "exec: ", 2, "no program: must be a program and its arguments")
    refuse("a missing program", "exec:/no/such/robot", 2,
           "cannot start /no/such/robot: No such file or directory")
    refuse("a program that may not run", f"exec:{HERE / 'command.py'}", 2, "Permission denied")
    for hello, words in [("n_states=3", "n_states = 3: must be 2, as task pendulum has"),
                         ("n_actions=2", "n_actions = 2: must be 1"),
                         ("control_period=0.05", "control_period = 0.05: must be 0.1 s"),
                         ("action_limits=[2]", "must be at least 2.5, the task's limit of torque"),
                         ("protocol=2", "protocol = 2: must be 1")]:
        refuse(f"hello: {hello}", fake(hello, "hello"), 2, "the robot's hello: ", words)
    refuse("dies at hello", fake("die", "hello"), 3, "exited with status 3")
    refuse("hangs at hello", fake("hang", "hello"), 3, "no answer within 0.5 s",
           options=["--set", "system.setup_timeout=0.5"])
    refuse("with an MJCF file", fake("none", "none"), 2, "mjcf = ", "--system",
           options=["--mjcf", HERE.parents[1] / "tasks/pendulum/pendulum.xml"])
    refuse("with observation noise", fake("none", "none"), 2, "observation_std = 0.1: must be "
           "negative with --system", options=["--set", "observation_std=0.1"])
    for key in ("system.timeout=-1", "system.timeout=nan", "system.setup_timeout=0"):
        refuse(key, fake("none", "none"), 2, "must be a number in", options=["--set", key])
    witness = scratch / "witness"
    for shell in (f"exec:true ; touch {witness}", f"exec:true `touch {witness}`",
                  f"exec:true $(touch {witness})", f"exec:true | touch {witness}",
                  f"exec:true && touch {witness}", f"exec:true > {witness}",
                  f"exec:true\ntouch {witness}"):
        refuse(f"no shell: {shell.replace(str(witness), 'FILE')!r}", shell, 3, "status 0")
    claims.check("no shell has run", set(scratch.iterdir()) == listing)
    run = scratch / "fine-done"
    config = (run / "config.toml").read_text()
    (run / "config.toml").write_text(re.sub("\nprogram = .*\n", "\nprogram = ''\n", config))
    result = downpour("learn", "--resume", run, "--episodes", "5")
    claims.check("a robot's run cannot go on in the simulator", result.returncode == 2 and
                 "task.model_digest" in result.stderr and len(result.stderr.splitlines()) == 1,
                 result)
    learn(scratch / "simulated")
    result = downpour("learn", "--resume", scratch / "simulated", "--episodes", "5", "--system",
                      fake("none", "none"))
    claims.check("nor the other way round", result.returncode == 2 and
                 "task.model_digest" in result.stderr, result)


def interrupted(number, where, fault, steps):
    """Ctrl-C while the robot is at `where`, not answering."""
    name = f"{number.name} at {where}"
    run, log = scratch / name, scratch / f"{name}.log"
    process = subprocess.Popen(
        [PROGRAM, "learn", "pendulum", "--out", run, "--quiet", *TINY, *PATIENT, "--system",
         fake(fault, where, log)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    mark = {"hello": '"type":"hello"', "start": '"reset","episode":2'}.get(
        where, f'"step","step":{where}')
    count = 1 if where in ("hello", "start") else 2  # the second episode's
    while not log.exists() or log.read_text().count(mark) < count:
        time.sleep(0.01)
    process.send_signal(number)
    output, error = process.communicate()
    claims.check(f"{name}: exit code and one line", process.returncode == 128 + number and
                 output == "" and len(error.splitlines()) == 1 and
                 error.startswith("downpour: interrupted"), error)
    claims.check(f"{name}: no process is left", left_over(log) == [])
    if where == "hello":
        claims.check(f"{name}: nothing is written", not run.exists())
        return
    kept = "episodes 1 to 2 are" if steps else "episode 1 is"
    claims.check(f"{name}: says what is kept", f"{kept} kept in {run}" in error, error)
    claims.check(f"{name}: the steps made are kept",
                 len(rows(run, "transitions.csv")) == 40 + steps)
    if steps:
        claims.check(f"{name}: and the episode is marked", rows(run, "episodes.csv")[1]["outcome"]
                     == f"aborted at step {steps}: interrupted")
    again = downpour("learn", "--resume", run, "--quiet", "--system", fake("none", "none"))
    claims.check(f"{name}: the run goes on", again.returncode == 0 and
                 len(rows(run, "episodes.csv")) == 4, again)


def told_to_stop():
    """What the program hears, and that it may end in its own way."""
    log = scratch / "heard.log"
    learn(scratch / "heard", "--system", fake("none", "none", log))
    heard = [json.loads(line.rpartition(" pid ")[0]) for line in log.read_text().splitlines()]
    kinds = "".join({"hello": "h", "reset": "r", "step": "s", "end": "e", "close": "c"}[m["type"]]
                    for m in heard)
    claims.check("an end after every episode, a close at the end",
                 kinds == "h" + 4 * ("r" + 40 * "s" + "e") + "c", kinds)
    claims.check("one program for the whole run", len(set(re.findall(r"pid (\d+)",
                                                                      log.read_text()))) == 1)
    claims.check("actions are within the limits", all(
        len(m["action"]) == 1 and abs(m["action"][0]) <= 2.5 for m in heard if "action" in m))
    finished = downpour("learn", "--resume", scratch / "heard", "--system", "exec:/no/such/robot")
    claims.check("a run that is done starts no robot", finished.returncode == 0, finished)


def evaluate():
    run = scratch / "heard"
    log = scratch / "evaluate.log"
    simulated = downpour("evaluate", run, "--starts", "2", "--json")
    claims.check("evaluate runs on the simulator, whatever the run was learnt on",
                 simulated.returncode == 0 and json.loads(simulated.stdout)["starts"] == 2,
                 simulated)
    result = downpour("evaluate", run, "--system", fake("none", "none", log), "--json")
    line = json.loads(result.stdout)
    claims.check("evaluate --system: one start on the robot", result.returncode == 0 and
                 line["starts"] == 1 and line["mean"] == line["minimum"], result)
    claims.check("evaluate --system: 40 steps, no process left",
                 log.read_text().count('"step","step"') == 40 and left_over(log) == [])
    result = downpour("evaluate", run, "--starts", "3", "--json", "--system", fake("die", 7))
    claims.check("evaluate --system: what is finished is told before the failure",
                 result.returncode == 3 and json.loads(result.stdout)["starts"] == 1 and
                 result.stderr == "downpour: start 2 of 3 aborted at step 7: the robot's program "
                 "exited with status 3\n", result)
    # Pendulum has no observation noise, of which simulator and robot would draw their own.
    built_in = downpour("evaluate", run, "--json", "--starts", "1", "--start-std", "0")
    robot = downpour("evaluate", run, "--json", "--start-std", "0", "--system",
                     command(PROGRAM, "simulate", "pendulum"))
    claims.check("evaluate --system: the simulator as the robot has its returns, to the bit",
                 json.loads(built_in.stdout)["mean"] == json.loads(robot.stdout)["mean"] > 0,
                 (built_in, robot))


def simulate():
    def answers(*lines, arguments=("pendulum",)):
        result = subprocess.run([PROGRAM, "simulate", *arguments], input="".join(
            line + "\n" for line in lines), capture_output=True, text=True)
        return result.returncode, [json.loads(line) for line in result.stdout.splitlines()]

    reset = '{"type":"reset","episode":1,"start":[0,0]}'
    code, lines = answers(reset, "nonsense", '{"type":"step","step":0,"action":[1,2]}',
                          '{"type":"jump"}', '{"type":"step","step":0,"action":[1]}',
                          '{"type":"close"}', reset)
    claims.check("simulate: bad lines are answered by errors, and it goes on until the close",
                 code == 0 and [line["type"] for line in lines] ==
                 ["start", "error", "error", "error", "observation"], lines)
    code, lines = answers('{"type":"step","step":0,"action":[1]}')
    claims.check("simulate: no step before a reset", lines[0]["type"] == "error", lines)
    reset = '{"type":"reset","episode":2,"start":[0,0,0,0]}'
    seeds = [answers(reset, arguments=("cartpole", "--seed", seed))[1][0]["observation"]
             for seed in ("0", "0", "1")]
    claims.check("simulate: the sensors' noise is the seed's", seeds[0] == seeds[1] != seeds[2])
    result = downpour("simulate", "pendulim")
    claims.check("simulate: an unknown task is refused", result.returncode == 2 and
                 "pendulum, cartpole" in result.stderr, result)


def example_watchdog():
    """A learner that dies without a word: the example stops by itself."""
    process = subprocess.Popen([EXAMPLE, PROGRAM], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
                               text=True)
    process.stdin.write('{"type":"hello","task":"pendulum"}\n'
                        '{"type":"reset","episode":1,"start":[0,0]}\n')
    process.stdin.flush()
    said = [json.loads(process.stdout.readline()) for _ in range(3)]
    claims.check("the example's watchdog ends an episode without actions",
                 said[2]["type"] == "error" and "no action" in said[2]["message"] and
                 process.wait() == 1, said)
    process.stdin.close()
    process.stdout.close()


same_bits()
failures()
without_a_step()
not_failures()
told_to_stop()
refused()
interrupted(signal.SIGINT, "hello", "hang", 0)
interrupted(signal.SIGINT, "start", "hang", 0)
interrupted(signal.SIGINT, "7", "hang", 7)
interrupted(signal.SIGTERM, "7", "stubborn", 7)
evaluate()
simulate()
example_watchdog()
claims.exit()
