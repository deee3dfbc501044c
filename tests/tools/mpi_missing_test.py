# SPDX-License-Identifier: Apache-2.0
"""Without MPI, a run that mpirun starts several times is refused."""
import os

from command import TINY, Claims, downpour, scratch_directory

claims = Claims()
scratch = scratch_directory()
for size, rank in (("OMPI_COMM_WORLD_SIZE", "OMPI_COMM_WORLD_RANK"), ("PMI_SIZE", "PMI_RANK")):
    for command in (["learn", "pendulum", "--out", scratch / "run"], ["study", scratch / "a.toml"]):
        result = downpour(*command, env=os.environ | {size: "2", rank: "0"})
        claims.check(f"{command[0]} with {size} = 2 is refused in one line",
                     result.returncode == 2 and result.stderr.startswith(
                         f"downpour: {command[0]} was started 2 times by mpirun, but built without "
                         "MPI") and result.stderr.count("\n") == 1 and
                     not (scratch / "run").exists(), result)
    other = downpour(*command, env=os.environ | {size: "2", rank: "1"})
    claims.check("by each process", other.returncode == 2, other)
one = downpour("learn", "pendulum", "--out", scratch / "run", "--quiet", *TINY,
               env=os.environ | {"OMPI_COMM_WORLD_SIZE": "1"})
claims.check("one process is as good as without mpirun", one.returncode == 0, one)
claims.exit()
