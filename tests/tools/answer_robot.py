# SPDX-License-Identifier: Apache-2.0
"""A pendulum by the protocol of docs/robot.md that gives one answer from a file.

usage: answer_robot.py FILE
The bytes of a FILE whose name begins with "hello" are the answer to hello, of any other to the third
step of the first episode.
"""
import json
import sys

answer = open(sys.argv[1], "rb").read()
at_hello = sys.argv[1].rpartition("/")[2].startswith("hello")


def send(data):
    sys.stdout.buffer.write(data + b"\n")
    sys.stdout.buffer.flush()


for line in sys.stdin:
    message = json.loads(line)
    kind = message["type"]
    if kind == "hello":
        good = {"type": "hello", "protocol": 1, "n_states": 2, "n_actions": 1,
                "control_period": 0.1, "action_limits": [2.5]}
        send(answer if at_hello else json.dumps(good).encode())
    elif kind == "reset":
        send(json.dumps({"type": "start", "episode": message["episode"],
                         "observation": [0.0, 0.0]}).encode())
    elif kind == "step" and message["step"] == 2:
        send(answer)
    elif kind == "step":
        send(json.dumps({"type": "observation", "step": message["step"],
                         "observation": [0.0, 0.0]}).encode())
    elif kind == "close":
        break
