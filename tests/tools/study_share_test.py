# SPDX-License-Identifier: Apache-2.0
"""A study that the tasks of a job array learn ends with the table of one that one process learns."""
import contextlib
import os
import pathlib
import sqlite3
import subprocess

from command import PROGRAM, Claims, downpour, scratch_directory

SCRIPT = pathlib.Path(__file__).resolve().parents[2] / "docs/data/study/slurm_array.sh"
SHARES = 3
STUDY = """tasks = ["pendulum"]
replicates = 2
jobs = 2
threads = 1

[settings]
learn.episodes = 2
search.evaluations = 500
search.final_rollouts = 24
model.max_evaluations = 20

[variant."Black-DROPS (NN)"]
[variant."No Var (NN)"]
rollout.variance = false
"""

claims = Claims()
scratch = scratch_directory()
for name in ("alone", "array"):
    (scratch / f"{name}.toml").write_text(STUDY)
downpour("study", scratch / "alone.toml")


def table(name):
    """All that no clock has written."""
    with contextlib.closing(sqlite3.connect(scratch / f"{name}.db")) as database:
        return [database.execute(f"SELECT * FROM {each}").fetchall()
                for each in ("variant", "setting", "episode")]


def array_task(index):
    bin_directory = scratch / "bin"
    bin_directory.mkdir(exist_ok=True)
    if not (bin_directory / "downpour").exists():
        (bin_directory / "downpour").symlink_to(pathlib.Path(PROGRAM).resolve())
    return subprocess.run(
        ["bash", SCRIPT, scratch / "array.toml"], capture_output=True, text=True,
        env=os.environ | {"PATH": f"{bin_directory}:{os.environ['PATH']}",
                          "SLURM_ARRAY_TASK_ID": str(index),
                          "SLURM_ARRAY_TASK_COUNT": str(SHARES)})


for index, runs in ((1, 2), (2, 1), (3, 1), (1, 2)):
    result = array_task(index)
    claims.check(f"task {index} of {SHARES} finishes its {runs} runs and no other", result.returncode
                 == 0 and result.stderr == f"{runs} of {runs} runs of share {index}/{SHARES} are "
                 f"finished in {scratch}/array.runs\n", result)
claims.check("no task writes a database", not (scratch / "array.db").exists())
final = downpour("study", scratch / "array.toml")
claims.check("then nothing is left to learn", final.returncode == 0 and final.stdout == "" and
             "4 of 4 runs are finished" in final.stderr, final)
claims.check("and the table is that of one process", table("array") == table("alone"))
for share in ("0/3", "4/3", "1", "1/2x", ""):
    result = downpour("study", scratch / "array.toml", "--share", share)
    claims.check(f"--share '{share}' is refused", result.returncode == 2 and
                 result.stderr.count("\n") == 1 and "--share" in result.stderr, result)
claims.exit()
