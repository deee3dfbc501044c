# SPDX-License-Identifier: Apache-2.0
"""The live line fits the terminal and always has the share done and the time left."""
import fcntl
import os
import pty
import re
import struct
import subprocess
import termios

from command import PROGRAM, Claims, scratch_directory

claims = Claims()
scratch = scratch_directory()


def terminal_output(columns, evaluations):
    """What a run writes to a terminal of that width."""
    master, slave = pty.openpty()
    fcntl.ioctl(slave, termios.TIOCSWINSZ, struct.pack("HHHH", 24, columns, 0, 0))
    process = subprocess.Popen(
        [PROGRAM, "learn", "pendulum", "--out", scratch / f"{columns}-{evaluations}",
         "--episodes", "2", "--evaluations", str(evaluations), "--threads", "2"],
        stdout=slave, stderr=slave)
    os.close(slave)
    text = b""
    while True:
        try:
            part = os.read(master, 65536)
        except OSError:  # the other end is closed
            break
        if not part:
            break
        text += part
    claims.check(f"{columns} columns: the run ends well", process.wait() == 0)
    return text.decode()


for columns in (20, 40, 80, 120):
    # There is a line every 0.1 s of the search, of which fast machines need more to take so long.
    for evaluations in (40000, 400000):
        output = terminal_output(columns, evaluations)
        live = [part for part in re.findall("\\r([^\\r\\n]*)\x1b\\[K", output) if " %" in part]
        if live:
            break
    claims.check(f"{columns} columns: live lines, all narrower than the terminal",
                 live and all(len(line) < columns for line in live), live)
    claims.check(f"{columns} columns: the time left comes right after the share",
                 all(re.search(r"\d+ %  \d+ s left", line) for line in live), live)
    if columns >= 80:
        claims.check(f"{columns} columns: and the rollouts",
                     all(f"/{evaluations:,} rollouts" in line for line in live), live)
claims.exit()
