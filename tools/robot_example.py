#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""A robot's program for `downpour learn --system`: the protocol of docs/robot.md, and a robot.

usage: tools/robot_example.py DOWNPOUR [LOG]

The robot is the simulator of the learner's task, `DOWNPOUR simulate TASK`. To drive hardware, keep
main() and serve(), and write a class with the methods of Simulator. LOG gets every action with the
observation and reward after it.
"""
import json
import queue
import signal
import subprocess
import sys
import threading

WATCHDOG_SECONDS = 1.0  # without an action for so long, an episode ends


class Simulator:
    """Physics by `downpour simulate`; on hardware, each method talks to the motors and sensors."""

    def __init__(self, hello, downpour):
        self.process = subprocess.Popen([downpour, "simulate", hello["task"]], text=True,
                                        stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        answer = self.ask(hello)
        self.n_states = answer["n_states"]
        self.control_period = answer["control_period"]  # s
        self.action_limits = answer["action_limits"]

    def ask(self, message):
        print(json.dumps(message), file=self.process.stdin, flush=True)
        answer = json.loads(self.process.stdout.readline())
        if answer["type"] == "error":
            raise RuntimeError(answer["message"])
        return answer

    def reset(self, episode, start):
        """Brings the robot to its start (near `start`, if it can) and measures the state."""
        return self.ask({"type": "reset", "episode": episode, "start": start})["observation"]

    def step(self, step, action):
        """Holds `action` for one control period, then measures the state.

        Returns it, the reward (None: by the task's formula) and whether the episode is over.
        """
        answer = self.ask({"type": "step", "step": step, "action": action})
        return answer["observation"], answer.get("reward"), False

    def stop(self):
        """Takes all power off the motors. May be called at any time, more than once."""

    def close(self):
        self.process.stdin.close()
        self.process.wait()


def send(message):
    print(json.dumps(message), flush=True)  # Python prints every double so that it reads back


def serve(downpour, log):
    lines = queue.Queue()

    def read():
        for line in sys.stdin:
            lines.put(json.loads(line))
        lines.put({"type": "close"})  # the end of our input means the same

    threading.Thread(target=read, daemon=True).start()
    robot = None
    running = False
    try:
        while True:
            try:
                message = lines.get(timeout=WATCHDOG_SECONDS if running else None)
            except queue.Empty:
                raise RuntimeError(f"no action for {WATCHDOG_SECONDS} s") from None
            kind = message["type"]
            if kind == "hello":
                robot = Simulator(message, downpour)
                send({"type": "hello", "protocol": 1, "n_states": robot.n_states,
                      "n_actions": len(robot.action_limits),
                      "control_period": robot.control_period,
                      "action_limits": robot.action_limits})
            elif kind == "reset":
                observation = robot.reset(message["episode"], message["start"])
                running = True
                send({"type": "start", "episode": message["episode"], "observation": observation})
            elif kind == "step":
                # They come clipped; whoever moves hardware does not rely on it.
                action = [min(max(a, -limit), limit)
                          for a, limit in zip(message["action"], robot.action_limits)]
                observation, reward, done = robot.step(message["step"], action)
                answer = {"type": "observation", "step": message["step"],
                          "observation": observation, "done": done}
                if reward is not None:
                    answer["reward"] = reward
                send(answer)
                if log is not None:
                    print(message["step"], *action, *observation, reward, file=log, flush=True)
            elif kind == "end":
                robot.stop()
                running = False
            else:  # close
                return
    finally:
        if robot is not None:
            robot.stop()
            robot.close()


def main():
    if len(sys.argv) not in (2, 3):
        sys.exit(__doc__)
    # SIGTERM must stop the motors, too: it becomes an exception, and serve() ends in order.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit("terminated"))
    log = open(sys.argv[2], "a") if len(sys.argv) == 3 else None
    try:
        serve(sys.argv[1], log)
    except RuntimeError as error:  # an operator's stop, a watchdog, a motor that fails
        send({"type": "error", "message": str(error)})
        sys.exit(1)


if __name__ == "__main__":
    main()
