# SPDX-License-Identifier: Apache-2.0
"""Tasks from TOML files: learning, the run's own copy of them, and the other commands."""
import json
import pathlib
import shutil
import struct
import subprocess

from command import PROGRAM, TINY, Claims, contents, downpour, learn, results, scratch_directory

TASKS = pathlib.Path(__file__).parents[2] / "tasks"
claims = Claims()
scratch = scratch_directory()


def copied(name, folder):
    """tasks/<name> in a folder of the test's own: its TOML file."""
    path = scratch / folder
    path.mkdir()
    for ending in (".toml", ".xml"):
        shutil.copy(TASKS / name / (name + ending), path)
    return path / f"{name}.toml"


def refused(claim, result, *words):
    lines = result.stderr.splitlines()
    claims.check(claim, result.returncode == 2 and len(lines) == 1 and result.stdout == "" and
                 all(word in lines[0] for word in words), result)


def begin(directory, task, episodes):
    """The same run as learn() makes, with fewer episodes."""
    options = [str(episodes) if option == "4" else option for option in TINY]
    result = downpour("learn", task, "--out", directory, "--quiet", *options)
    claims.check(f"{directory.name} begins", result.returncode == 0, result)


def like_built_in():
    for name in ("cartpole", "pendulum"):
        learn(scratch / f"built-in {name}", task=name)
        learn(scratch / f"file {name}", task=TASKS / name / f"{name}.toml")
        mine, its = results(scratch / f"file {name}"), results(scratch / f"built-in {name}")
        claims.check(f"{name} from its file learns to the same bits", all(
            mine[file] == its[file] for file in ("episodes.csv", "transitions.csv",
                                                 "hyperparameters.csv", "plans.csv")))


def copies_in_runs():
    """The run goes on with its own copy, wherever it is, and with nothing else."""
    toml = copied("cartpole", "mine")
    run, whole = scratch / "run", scratch / "whole"
    learn(whole, task=toml)
    begin(run, toml, 3)
    config = (run / "config.toml").read_text()
    claims.check("config.toml names the copy from its own folder, and the original",
                 '\ntask = "task/cartpole.toml"\n' in config and
                 f'\ntask_source = "{toml}"\n' in config, config[:600])
    claims.check("the copies are the files", all(
        (run / "task" / file.name).read_bytes() == file.read_bytes()
        for file in toml.parent.iterdir()))
    before = contents(run)
    for file, old, new in [(toml, "limit = 10", "limit = 9"),
                           (toml.with_suffix(".xml"), 'mass="0.5"', 'mass="0.6"')]:
        text = file.read_text()
        file.write_text(text.replace(old, new, 1))
        refused(f"resume refuses when {file.name} has changed since",
                downpour("learn", "--resume", run, "--episodes", "4"), str(file),
                "differs from the copy that the run began with", str(run / "task"))
        file.write_text(text)
    refused("resume with the file of another task", downpour(
        "learn", TASKS / "pendulum/pendulum.toml", "--resume", run), "TASK = ", "pendulum.toml: must")
    refused("resume with a built-in task", downpour("learn", "cartpole", "--resume", run),
            "TASK = cartpole: must be", str(toml))
    other = copied("cartpole", "other")
    other.write_text(other.read_text() + "# changed\n")
    refused("resume with a changed file of that name", downpour("learn", other, "--resume", run),
            str(other), "differs")
    copy = run / "task/cartpole.toml"
    text = copy.read_text()
    copy.write_text(text.replace("width = 0.25", "width = 0.26"))
    toml.unlink()  # the original cannot tell
    refused("resume when the copy has changed", downpour("learn", "--resume", run, "--episodes",
                                                         "4"), "checkpoint.json", "task.")
    copy.write_text(text)
    claims.check("nothing was written", contents(run) == before)
    shutil.rmtree(toml.parent)
    moved = scratch / "moved" / "run"
    moved.parent.mkdir()
    run.rename(moved)
    result = downpour("learn", "--resume", moved, "--episodes", "4", "--quiet")
    claims.check("it goes on where it was moved to, without the original, to the same bits",
                 result.returncode == 0 and
                 all(results(moved)[file] == results(whole)[file]
                     for file in results(whole) if file != "config.toml"), result)
    again = scratch / "again"
    result = downpour("learn", "--config", moved / "config.toml", "--out", again, "--quiet")
    claims.check("a run's config.toml repeats it", result.returncode == 0 and
                 results(again)["episodes.csv"] == results(whole)["episodes.csv"], result)
    return moved


def with_meshes():
    """Files that a model names, beside and above it, are part of the copy."""
    folder = scratch / "meshes"
    for below in ("tasks", "models/parts"):
        (folder / below).mkdir(parents=True)
    text = (TASKS / "pendulum/pendulum.xml").read_text()
    toml = (TASKS / "pendulum/pendulum.toml").read_text()
    (folder / "models/parts/motor.xml").write_text(
        '<mujoco><actuator><motor name="torque" joint="pole"/></actuator></mujoco>')
    start, end = text.index("<actuator>"), text.index("</actuator>") + len("</actuator>")
    text = text[:start] + '<include file="parts/motor.xml"/>' + text[end:]
    text = text.replace("<compiler ", '<compiler meshdir="parts" ', 1)
    text = text.replace("</asset>", '<mesh name="tetrahedron" file="mesh.stl"/></asset>', 1)
    (folder / "models/pendulum.xml").write_text(text)
    corners = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]
    faces = [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)]
    (folder / "models/parts/mesh.stl").write_bytes(
        bytes(80) + struct.pack("<I", 4) + b"".join(
            struct.pack("<12fH", 0, 0, 0, *(x for i in face for x in corners[i]), 0)
            for face in faces))
    (folder / "tasks/pendulum.toml").write_text(toml.replace(
        '"pendulum.xml"', '"../models/pendulum.xml"'))
    run = scratch / "meshes run"
    begin(run, folder / "tasks/pendulum.toml", 2)
    files = sorted(str(path.relative_to(run / "task")) for path in (run / "task").rglob("*")
                   if path.is_file())
    claims.check("included files and meshes are copied, too", files == [
        "models/parts/mesh.stl", "models/parts/motor.xml", "models/pendulum.xml",
        "tasks/pendulum.toml"], files)
    part = folder / "models/parts/motor.xml"
    part.write_text(part.read_text().replace('"pole"/>', '"pole" gear="2"/>'))
    refused("resume refuses when an included file has changed since",
            downpour("learn", "--resume", run, "--episodes", "3"), str(part), "differs")
    shutil.rmtree(folder)
    result = downpour("learn", "--resume", run, "--episodes", "3", "--quiet")
    claims.check("and the copy is enough", result.returncode == 0, result)


def other_commands(run):
    result = downpour("evaluate", run, "--starts", "3", "--json")
    claims.check("evaluate uses the run's copy", result.returncode == 0 and
                 json.loads(result.stdout)["task"] == "cartpole", result)
    result = downpour("act", run, input="0 0 0 0\n")
    claims.check("act", result.returncode == 0 and abs(float(result.stdout)) <= 10, result)
    result = downpour("export", run)
    claims.check("export", result.returncode == 0 and "pole_angle" in result.stdout, result)
    file = TASKS / "examples/pusher.toml"
    result = downpour("tasks", file)
    claims.check("tasks shows one from a file", result.returncode == 0 and
                 result.stdout.startswith("pusher: ") and "puck_x" in result.stdout, result)
    result = downpour("simulate", file, input='{"type":"reset","episode":1,"start":[0,0,5,5]}\n')
    start = json.loads(result.stdout)["observation"]
    claims.check("simulate starts where the joints are", abs(start[2] - 0.15) < 0.01, result)
    built_in, own = (downpour("learn", task, "--out", scratch / f"robot {i}", "--quiet", *TINY,
                              "--system", f"exec:'{PROGRAM}' simulate '{task}'")
                     for i, task in enumerate(("cartpole", TASKS / "cartpole/cartpole.toml")))
    claims.check("--system", built_in.returncode == own.returncode == 0 and
                 results(scratch / "robot 0")["episodes.csv"] ==
                 results(scratch / "robot 1")["episodes.csv"], (built_in, own))
    refused("a preset", downpour("learn", file, "--preset", "original-code"), "preset",
            "must be left out")
    result = subprocess.run([PROGRAM, "learn", TASKS / "examples/reacher.toml", "--quiet", *TINY],
                            cwd=scratch, capture_output=True, text=True)
    claims.check("a run's default directory has the task's name", result.returncode == 0 and
                 (scratch / "runs/reacher-seed0/policy.json").exists(), result)


like_built_in()
other_commands(copies_in_runs())
with_meshes()
claims.exit()
