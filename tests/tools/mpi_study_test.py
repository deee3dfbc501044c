# SPDX-License-Identifier: Apache-2.0
"""A study that several processes learn ends with the table and the files of one that one process
learns, even if one of them is lost."""
import contextlib
import os
import signal
import sqlite3
import time

from command import Claims, downpour, results, scratch_directory
from mpi import ended, mpirun, process_of, start_mpirun

claims = Claims()
scratch = scratch_directory()

STUDY = """tasks = ["pendulum"]
replicates = 3
jobs = 1
threads = 1

[settings]
learn.episodes = 3
search.evaluations = 500
search.final_rollouts = 24
model.max_evaluations = 20

[variant."Black-DROPS (NN)"]
[variant."No Var (NN)"]
rollout.variance = false
"""


def write(name, text=STUDY):
    path = scratch / f"{name}.toml"
    path.write_text(text)
    return path


def rows(path, sql):
    with contextlib.closing(sqlite3.connect(path.with_suffix(".db"))) as database:
        return database.execute(sql).fetchall()


def table(path):
    """All that no clock has written."""
    return [rows(path, f"SELECT * FROM {name}") for name in ("variant", "setting", "episode")]


def runs(path):
    """What each run directory holds, and what else there is."""
    top = path.with_suffix(".runs")
    found = {str(run.parent.relative_to(top)): results(run.parent)
             for run in top.rglob("checkpoint.json")}
    return found, [str(log) for log in top.rglob("*.log")]


def same(claim, path, expected, result):
    claims.check(f"{claim}: the same table", result.returncode == 0 and
                 table(path) == table(expected), result)
    claims.check(f"{claim}: the same files", runs(path) == runs(expected))


def undisturbed():
    alone = write("alone")
    result = downpour("study", alone)
    claims.check("a study by one process", result.returncode == 0, result)
    path = write("ranks")
    result = mpirun(3, "study", path)
    same("three processes", path, alone, result)
    claims.check("three processes: a line for each run", len(result.stdout.splitlines()) == 6, result)
    result = mpirun(2, "study", path)
    claims.check("a finished study has nothing to do", result.returncode == 0 and
                 "6 of 6 runs" in result.stderr and result.stdout == "", result)
    result = mpirun(2, "study", scratch / "missing.toml")
    claims.check("a study that is not there is told once", result.returncode == 2 and
                 result.stderr.count("downpour: ") == 1, result)


def kill_rank_1(path, *options):
    process = start_mpirun(3, "study", path, options=options)
    while len(list(path.with_suffix(".runs").rglob("checkpoint.json"))) < 3:
        time.sleep(0.01)
        if process.poll() is not None:
            break
    os.kill(process_of(1, path), signal.SIGKILL)
    output, error = ended(process)
    return process.returncode, output, error


def lost_ranks():
    long = STUDY.replace("= 500", "= 20000")
    alone = write("long", long)
    downpour("study", alone)
    path = write("killed", long)
    code, output, error = kill_rank_1(path)
    claims.check("without recovery a lost rank ends the study", code != 0, (output, error))
    same("and the same command goes on, to the end of one that was left alone", path, alone,
         mpirun(3, "study", path))
    path = write("recovered", long)
    code, output, error = kill_rank_1(path, "--enable-recovery")
    claims.check("with recovery it costs the runs it was learning, which go on elsewhere",
                 "rank 1 is lost; it goes on elsewhere" in error and
                 f"6 of 6 runs are finished in {path.with_suffix('.db')}" in error,
                 (code, output, error))
    claims.check("with recovery: the same table and files",
                 table(path) == table(alone) and runs(path) == runs(alone))


undisturbed()
lost_ranks()
claims.exit()
