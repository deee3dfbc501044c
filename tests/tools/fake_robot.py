# SPDX-License-Identifier: Apache-2.0
"""A pendulum that answers by the protocol of docs/robot.md and misbehaves as its arguments say.

usage: fake_robot.py FAULT WHERE [LOG]
FAULT happens once, at WHERE: "hello", "start", or a step of the second episode, counted from 0 (or
"1:7", step 7 of the first one). LOG gets a line for every message received, and the process number.
"""
import json
import math
import os
import signal
import sys
import time

fault, where = sys.argv[1:3]
log = open(sys.argv[3], "a") if len(sys.argv) > 3 else None


def send(message):
    print(json.dumps(message), flush=True)


def misbehave(answer):
    """The fault in place of, or besides, `answer`."""
    if fault == "hang":
        time.sleep(100)
    elif fault == "stubborn":  # hears nothing but SIGKILL
        for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
            signal.signal(number, signal.SIG_IGN)
        while True:
            time.sleep(100)
    elif fault == "family":  # its child outlives it, if nobody kills it
        if os.fork() == 0:
            signal.signal(signal.SIGTERM, signal.SIG_IGN)
            print("pid", os.getpid(), file=log, flush=True)
            time.sleep(100)
        os._exit(4)
    elif fault == "die":
        sys.exit(3)
    elif fault == "killed":
        os.kill(os.getpid(), signal.SIGKILL)
    elif fault == "closed":
        os.close(1)
        time.sleep(100)
    elif fault == "garbage":
        print("motor \x1b[31mready\x1b[0m, 42", flush=True)
    elif fault == "binary":
        sys.stdout.buffer.write(b"\xff\xfe\x00\x80\n")
        sys.stdout.buffer.flush()
    elif fault == "array":
        print("[1, 2]", flush=True)
    elif fault == "deep":
        print('{"type":' + "[" * 500000 + "]" * 500000 + "}", flush=True)
    elif fault == "partial":
        print('{"type":"observ', end="", flush=True)
        time.sleep(100)
    elif fault == "huge":
        print("x" * (3 << 20), flush=True)
    elif fault == "flood":
        while True:
            print("x" * 4095, flush=True)
    elif fault == "nan":
        send({**answer, "observation": [float("nan"), 0]})
    elif fault == "nan-text":
        send({**answer, "observation": ["nan", 0]})
    elif fault == "range":
        send({**answer, "observation": [0, -2e6]})
    elif fault == "infinite":
        print(json.dumps({**answer, "observation": [0, 7]}).replace("7", "1e999"), flush=True)
    elif fault == "dimension":
        send({**answer, "observation": [0, 0, 0]})
    elif fault == "reward":
        send({**answer, "reward": "much"})
    elif fault == "error":
        send({"type": "error", "message": "the operator pressed \"stop\" \x1b[1m\u00fc\n, now"})
    elif fault == "silent-error":
        send({"type": "error"})
    elif fault == "done":
        send({**answer, "done": True})
    elif fault == "extra":
        print(json.dumps(answer) + '\n{"type": "log"}', flush=True)
    elif fault == "stale":
        send({**answer, "step": answer["step"] - 1})
    elif fault == "slow":
        time.sleep(0.3)
        send(answer)
    else:  # a hello of another robot: key=value
        key, value = fault.split("=")
        send({**answer, key: json.loads(value)})


def main():
    episode, resets, velocity, angle = 0, 0, 0.0, 0.0
    for line in sys.stdin:
        message = json.loads(line)
        if log is not None:
            print(line.strip(), "pid", os.getpid(), file=log, flush=True)
        kind = message["type"]
        place = kind
        if kind == "hello":
            answer = {"type": "hello", "protocol": 1, "n_states": 2, "n_actions": 1,
                      "control_period": 0.1, "action_limits": [2.5]}
        elif kind == "reset":
            episode, velocity, angle = message["episode"], 0.0, 0.0
            answer = {"type": "start", "episode": episode, "observation": [velocity, angle]}
            place = "start" if episode == 2 else f"{episode}:start"
        elif kind == "step":
            velocity += 0.1 * (message["action"][0] - 10 * math.sin(angle))
            angle += 0.1 * velocity
            answer = {"type": "observation", "step": message["step"],
                      "observation": [velocity, angle]}
            place = str(message["step"]) if episode == 2 else f"{episode}:{message['step']}"
        elif kind == "end":
            continue
        else:
            return
        if place == where:
            misbehave(answer)
        else:
            send(answer)


main()
