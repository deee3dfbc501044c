# SPDX-License-Identifier: Apache-2.0
"""A study that is killed, interrupted or extended ends with the table of one that is not."""
import contextlib
import os
import pathlib
import random
import shutil
import signal
import sqlite3
import subprocess
import time

from command import PROGRAM, Claims, downpour, scratch_directory

KILLS = 20

claims = Claims()
scratch = scratch_directory()

TINY = """
[settings]
learn.episodes = 3
search.evaluations = 500
search.final_rollouts = 24
model.max_evaluations = 20
"""
VARIANTS = """
[variant."Black-DROPS (NN)"]
[variant."No Var (GP)"]
policy.kind = "gp"
rollout.variance = false
"""
STUDY = 'tasks = ["pendulum", "cartpole"]\nreplicates = 2\njobs = 2\nthreads = 1\n' + TINY + VARIANTS


def write(name, text):
    path = scratch / f"{name}.toml"
    path.write_text(text)
    return path


def rows(path, sql):
    with contextlib.closing(sqlite3.connect(path.with_suffix(".db"))) as database:
        return database.execute(sql).fetchall()


def table(path):
    """All that no clock has written."""
    return [rows(path, f"SELECT * FROM {name}") for name in ("variant", "setting", "episode")]


def study(path, *options):
    return downpour("study", path, *options)


def undisturbed():
    path = write("reference", STUDY)
    start = time.monotonic()
    result = study(path)
    seconds = time.monotonic() - start
    lines = result.stdout.splitlines()
    claims.check("a study runs every variant on every task with every seed",
                 result.returncode == 0 and len(lines) == 8 and
                 rows(path, "SELECT count(*) FROM episode") == [(24,)] and
                 lines[0].startswith("pendulum, "), result)
    claims.check("each run is a run directory beside the database",
                 (scratch / "reference.runs/cartpole/No Var (GP)/2/policy.json").exists())
    claims.check("the setting of a variant is its runs'",
                 'kind = "gp"' in (scratch / "reference.runs/cartpole/No Var (GP)/2/config.toml")
                 .read_text())
    alone = scratch / "alone"
    downpour("learn", "cartpole", "--seed", "2", "--no-variance", "--policy", "gp", "--out", alone,
             "--quiet", "--threads", "2", "--episodes", "3", "--evaluations", "500", "--set",
             "search.final_rollouts=24", "--set", "model.max_evaluations=20")
    returns = [float(line.split(",")[header]) for line in
               (alone / "episodes.csv").read_text().splitlines()[1:]
               for header in [(alone / "episodes.csv").read_text().splitlines()[0].split(",")
                              .index("return")]]
    claims.check("the database has the bits of downpour learn",
                 returns == [row[0] for row in rows(
                     path, "SELECT real_return FROM episode WHERE task = 'cartpole' AND variant = "
                     "'No Var (GP)' AND seed = 2 ORDER BY episode")], returns)
    again = study(path)
    claims.check("a finished study has nothing to do",
                 again.returncode == 0 and again.stdout == "" and "8 of 8 runs" in again.stderr,
                 again)
    return table(path), seconds


# A quarter of a study is long enough for it to get on between two kills, however slow the build.
def killed(expected, longest):
    generator = random.Random(1)
    kills = studies = 0
    while kills < KILLS:
        path = write(f"killed{studies}", STUDY)
        studies += 1
        while True:
            process = subprocess.Popen([PROGRAM, "study", path], stdout=subprocess.DEVNULL,
                                       stderr=subprocess.PIPE, text=True)
            time.sleep(generator.uniform(0, longest))
            process.kill()
            _, error = process.communicate()
            if process.returncode == 0:
                break
            kills += process.returncode == -signal.SIGKILL
            if process.returncode != -signal.SIGKILL:
                claims.check("a killed study goes on", False, error)
                return
        if table(path) != expected:
            claims.check(f"study {studies} has the table of one that was not killed", False)
    claims.check(f"{studies} studies killed {kills} times end with the table of one that was not",
                 claims.failures == 0)


def interrupted_and_locked():
    path = write("long", STUDY.replace("500", "30000"))
    process = subprocess.Popen([PROGRAM, "study", path], stdout=subprocess.PIPE,
                               stderr=subprocess.PIPE, text=True)
    process.stdout.readline()
    second = study(path)
    claims.check("a second study of one database is refused", second.returncode == 2 and
                 second.stderr == f"downpour: {scratch}/long.db: another downpour study is writing "
                 "it: wait for its end, or stop it\n", second)
    process.send_signal(signal.SIGTERM)
    _, error = process.communicate()
    claims.check("SIGTERM ends a study with what is kept and how to go on",
                 process.returncode == 143 and len(error.splitlines()) == 1 and
                 "of 8 runs are finished; go on with: " in error and
                 error.endswith(f" study {path}\n"), error)


def processes_die():
    path = write("longest", STUDY.replace("500", "30000000"))
    process = subprocess.Popen([PROGRAM, "study", path], stdout=subprocess.DEVNULL,
                               stderr=subprocess.DEVNULL)
    # One that still writes would die of its broken pipe.
    while len(list(scratch.glob("longest.runs/*/*/*/checkpoint.json"))) < 2:
        time.sleep(0.02)
    time.sleep(0.2)
    process.kill()
    process.wait()
    deadline = time.monotonic() + 5
    while runs_of(path) and time.monotonic() < deadline:
        time.sleep(0.02)
    left = runs_of(path)
    claims.check("the runs of a killed study die with it", not left, left)
    for pid in left:
        os.kill(int(pid), signal.SIGKILL)


def runs_of(path):
    """Processes that learn for the study."""
    needle = str(path.with_suffix(".runs")).encode()
    found = []
    for command in pathlib.Path("/proc").glob("[0-9]*/cmdline"):
        with contextlib.suppress(OSError):
            if needle in command.read_bytes():
                found.append(command.parent.name)
    return found


def one_lost_run():
    path = write("lost", STUDY)
    (scratch / "lost.runs/pendulum/No Var (GP)").mkdir(parents=True)
    (scratch / "lost.runs/pendulum/No Var (GP)/1").write_text("in the way")
    result = study(path)
    claims.check("a run that fails costs only itself, and is said",
                 result.returncode == 1 and len(result.stdout.splitlines()) == 7 and
                 "1 of 8 runs failed, the first: pendulum, No Var (GP), seed 1: exit code 2: "
                 in result.stderr and "is not a directory" in result.stderr, result)
    (scratch / "lost.runs/pendulum/No Var (GP)/1").unlink()
    claims.check("the same command goes on with it", study(path).returncode == 0 and
                 rows(path, "SELECT count(*) FROM run WHERE episodes = 3") == [(8,)])


def changed(expected):
    path = scratch / "reference.toml"
    more = STUDY.replace("replicates = 2", "replicates = 3") + "[variant.linear]\npolicy.kind = " \
        "\"linear\"\n"
    path.write_text(more)
    result = study(path)
    claims.check("replicates and variants can be added",
                 result.returncode == 0 and len(result.stdout.splitlines()) == 10, result)
    claims.check("what was there stays as it was",
                 [row for row in rows(path, "SELECT * FROM episode")
                  if row[2] < 3 and row[1] != "linear"] == expected[2])
    before = table(path)
    for old, new, *words in [
            ("rollout.variance = false", "rollout.variance = true", "No Var (GP) on pendulum",
             "rollout.variance is true, but", "has results with false"),
            ("evaluations = 500", "evaluations = 600", "search.evaluations is 600", "with 500"),
            ("episodes = 3", "episodes = 2", "learn.episodes is 2", "with 3")]:
        path.write_text(more.replace(old, new))
        result = study(path)
        claims.check(f"{new} of a variant with results is refused",
                     result.returncode == 2 and len(result.stderr.splitlines()) == 1 and
                     all(word in result.stderr for word in [f"{path}:", *words]) and
                     table(path) == before, result)
    path.write_text(more.replace("episodes = 3", "episodes = 4"))
    claims.check("runs can be made longer", study(path).returncode == 0 and
                 rows(path, "SELECT min(episodes), count(*) FROM run") == [(4, 18)])


def task_of_a_file():
    for name in ("reacher.toml", "reacher.xml"):
        shutil.copy(pathlib.Path(__file__).parents[2] / "tasks/examples" / name, scratch)
    path = write("file", 'tasks = ["reacher.toml"]\nreplicates = 1\n' + TINY +
                 '[task."reacher.toml"]\nlearn.episodes = 2\n[variant.a]\n')
    result = downpour("study", path, cwd="/")
    claims.check("a task may be a file beside the study",
                 result.returncode == 0 and rows(path, "SELECT task, episodes FROM run") ==
                 [("reacher", 2)], result)
    path.write_text(path.read_text().replace("episodes = 2", "episodes = 3"))
    claims.check("a run of such a task goes on", study(path).returncode == 0 and
                 rows(path, "SELECT task, episodes FROM run") == [("reacher", 3)])


def malformed():
    head, last = 'tasks = ["pendulum"]\n', "[variant.a]\n"
    for text, *words in [
            ("", "tasks is missing", "must be a list of tasks"),
            ("tasks = 3\n" + last, ":1: tasks: must be a list of tasks"),
            ('tasks = ["pendulim"]\n' + last, ":1: task = 'pendulim'", "did you mean pendulum?"),
            ('tasks = ["pendulum", "pendulum"]\n' + last, ":1:", "pendulum is there twice"),
            (head, "no variant: must have a table [variant.NAME]"),
            (head + "replicats = 3\n" + last, ":2: unknown key replicats", "did you mean replicates?"),
            (head + "replicates = 0\n" + last, ":2: replicates = 0", "an integer in [1, 100000]"),
            (head + "jobs = \"two\"\n" + last, ":2: jobs = 'two'", "an integer in [0, 1024]"),
            (head + "variant = 3\n", ":2: variant: must be a table, [variant.NAME]"),
            (head + "search.evaluations = 500\n" + last, ":2: unknown key search",
             "settings of all runs stand in [settings]"),
            (head + last + "search.evalutions = 500\n", ":3: unknown key search.evalutions",
             "did you mean search.evaluations?"),
            (head + last + "search.evaluations = 5\n", ":3: search.evaluations = 5", "[100, "),
            (head + last + "learn.seed = 5\n", ":3: learn.seed is not to be set here",
             "first_seed"),
            (head + last + "output.directory = \"x\"\n", ":3: output.directory is not to be set"),
            (head + last + "[task.cartpole]\n", ":3: [task.cartpole]: not among the tasks"),
            (head + last + "[task.pendulum]\nreplicates = -1\n", ":4: replicates = -1"),
            (head + '[variant."../a"]\n', ':2: variant "../a": a name must begin with'),
            (head + last + "learn.random_episodes = 20\n", ":2: a on pendulum: ", "random_episodes"),
            (head + "[variant.a\n", ":2:", "no valid TOML")]:
        path = write("malformed", text)
        result = study(path)
        claims.check(f"malformed: {words[0]}", result.returncode == 2 and result.stdout == "" and
                     len(result.stderr.splitlines()) == 1 and
                     result.stderr.startswith("downpour: ") and
                     all(word in result.stderr for word in words) and
                     not path.with_suffix(".db").exists(), result.stderr)
    path = write("other", STUDY)
    path.with_suffix(".db").write_text("no database, but a text of some length\n" * 20)
    result = study(path)
    claims.check("a file that is no database is left alone", result.returncode == 2 and
                 "other.db: must be the database of a study" in result.stderr, result)
    result = study(scratch / "reference.toml", "--jobs", "-1")
    claims.check("--jobs out of range", result.returncode == 2 and result.stderr ==
                 "downpour: --jobs: jobs = -1: must be an integer in [0, 1024]\n", result)


table_of_reference, seconds_of_reference = undisturbed()
killed(table_of_reference, seconds_of_reference / 4)
interrupted_and_locked()
processes_die()
one_lost_run()
changed(table_of_reference)
task_of_a_file()
malformed()
claims.exit()
