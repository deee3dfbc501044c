# SPDX-License-Identifier: Apache-2.0
"""A run that gets no memory ends with one line and keeps what it has."""
import resource

from command import PROGRAM, Claims, contents, downpour, scratch_directory

claims = Claims()
run = scratch_directory() / "run"
LIMIT = 4 << 30  # bytes; a generation of a thousand million rollouts takes more
result = downpour("learn", "pendulum", "--out", run, "--quiet", "--threads", "2", "--population",
                  "100000", "--rollouts", "10000", "--evaluations", "1000000000000",
                  preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (LIMIT, LIMIT)))
claims.check("out of memory: one line that says what is kept and how to go on, exit code 1",
             result.returncode == 1 and result.stderr ==
             "downpour: out of memory; what is finished is kept: episode 1 is kept in "
             f"{run}; go on with: {PROGRAM} learn --resume {run}\n", result)
claims.check("out of memory: the checkpoint is there", "checkpoint.json" in contents(run))
claims.exit()
