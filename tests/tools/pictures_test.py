# SPDX-License-Identifier: Apache-2.0
"""downpour predict, plot and render: right numbers, files that hold a picture, one line for what
cannot be drawn."""
import csv
import math
import os
import shutil
import struct
import xml.etree.ElementTree
import zlib

from command import PROGRAM, Claims, downpour, learn, scratch_directory

claims = Claims()
scratch = scratch_directory()
run = scratch / "run"
learn(run)
# No display, as on a server. The OpenGL driver of a sanitizer's build is not ours to check.
environment = {name: value for name, value in os.environ.items() if "DISPLAY" not in name}
environment["ASAN_OPTIONS"] = environment.get("ASAN_OPTIONS", "") + ":detect_leaks=0"


def refuse(claim, arguments, *words, **changes):
    result = downpour(*arguments, env={**environment, **changes})
    claims.check(f"refused in one line: {claim}",
                 result.returncode == 2 and result.stdout == "" and
                 result.stderr.startswith("downpour: ") and result.stderr.count("\n") == 1 and
                 all(str(word) in result.stderr for word in words), result)


def read_png(path):
    """Width, height and RGB or RGBA rows; filters as in the PNG standard, section 9."""
    data = path.read_bytes()
    assert data[:8] == b"\x89PNG\r\n\x1a\n", path
    at, packed = 8, b""
    while at < len(data):
        size, kind = struct.unpack(">I4s", data[at:at + 8])
        body = data[at + 8:at + 8 + size]
        if kind == b"IHDR":
            width, height, depth, colour = struct.unpack(">IIBB", body[:10])
            assert depth == 8 and colour in (2, 6), path
            pixel = 3 if colour == 2 else 4
        packed += body if kind == b"IDAT" else b""
        at += 12 + size
    raw, rows, stride = zlib.decompress(packed), [], width * pixel
    before = bytearray(stride)
    for y in range(height):
        kind, row = raw[y * (stride + 1)], bytearray(raw[y * (stride + 1) + 1:(y + 1) * (stride + 1)])
        if kind == 1:
            for i in range(pixel, stride):
                row[i] = (row[i] + row[i - pixel]) & 255
        elif kind == 2:
            for i in range(stride):
                row[i] = (row[i] + before[i]) & 255
        elif kind == 3:
            for i in range(stride):
                row[i] = (row[i] + ((row[i - pixel] if i >= pixel else 0) + before[i]) // 2) & 255
        elif kind == 4:
            for i in range(stride):
                a, b = row[i - pixel] if i >= pixel else 0, before[i]
                c = before[i - pixel] if i >= pixel else 0
                p = a + b - c
                near = min((abs(p - a), 0, a), (abs(p - b), 1, b), (abs(p - c), 2, c))
                row[i] = (row[i] + near[2]) & 255
        rows.append(row)
        before = row
    return width, height, pixel, rows


def table(path):
    with open(path, newline="") as file:
        return list(csv.DictReader(file))


def prediction():
    result = downpour("predict", run, "--rollouts", "50", "-o", scratch / "predicted.csv")
    rows = table(scratch / "predicted.csv")
    claims.check("predict: a row a rollout and step", result.returncode == 0 and
                 [(int(row["rollout"]), int(row["step"])) for row in rows] ==
                 [(r, step) for r in range(50) for step in range(40)] and
                 all(math.isclose(float(row["time [s]"]), 0.1 * int(row["step"])) for row in rows),
                 result)
    returns = [sum(float(row["reward"]) for row in rows[40 * r:40 * r + 40]) for r in range(50)]
    mean = sum(returns) / 50
    std = math.sqrt(sum((x - mean) ** 2 for x in returns) / 49)
    claims.check("predict: prints mean and standard deviation of the returns in the table",
                 f"predicted {mean:.2f} +- {std:.2f} " in result.stdout, result.stdout)
    claims.check("predict: rewards are those of the next states, states go on from each other",
                 all(math.isclose(float(row["reward"]),
                                  math.exp(-(1 + math.cos(float(row["next_state.angle [rad]"])))
                                           / 0.0625), rel_tol=1e-9, abs_tol=1e-12)
                     for row in rows) and
                 all(a["next_state.angle [rad]"] == b["state.angle [rad]"]
                     for a, b in zip(rows, rows[1:]) if a["rollout"] == b["rollout"]))
    real = table(run / "transitions.csv")[-40:]
    claims.check("predict: starts where the real episode starts, by the same first action",
                 all(rows[40 * r]["action.torque [N m]"] == real[0]["action.torque [N m]"]
                     for r in range(50)), rows[0])
    again = downpour("predict", run, "--rollouts", "2", "-o", scratch / "few.csv")
    claims.check("predict: the same rollouts however many", again.returncode == 0 and
                 table(scratch / "few.csv") == rows[:80], again)
    refuse("predict: a random episode", ["predict", run, "--episode", "1"], "--episode: 1 of", "random")
    refuse("predict: an episode that is not there", ["predict", run, "--episode", "9"],
           "--episode: 9", "[1, 4]")


def plots():
    result = downpour("plot", run, env=environment)
    claims.check("plot: writes a PNG and an SVG into the run, and names them",
                 result.returncode == 0 and
                 result.stdout.split() == [str(run / "run.png"), str(run / "run.svg")], result)
    data = (run / "run.png").read_bytes()
    width, height = struct.unpack(">II", data[16:24])
    claims.check("plot: the PNG is whole and of a README's width",
                 data[:8] == b"\x89PNG\r\n\x1a\n" and data[-8:-4] == b"IEND" and
                 1200 <= width <= 2000 and height >= 600, (width, height))
    svg = xml.etree.ElementTree.parse(run / "run.svg")
    claims.check("plot: the SVG is XML with paths", svg.getroot().tag.endswith("svg") and
                 len(svg.findall(".//{http://www.w3.org/2000/svg}path")) > 50)
    again = scratch / "again.svg"
    downpour("plot", run, "-o", again, env=environment)
    claims.check("plot: the same run gives the same bytes",
                 again.read_bytes() == (run / "run.svg").read_bytes())
    random = downpour("plot", run, "--episode", "1", "-o", scratch / "random.png", env=environment)
    claims.check("plot: a random episode has its real trajectory",
                 random.returncode == 0 and (scratch / "random.png").stat().st_size > 10000, random)
    fake = scratch / "fake"
    fake.mkdir()
    (fake / "matplotlib.py").write_text("raise ModuleNotFoundError(name='matplotlib')\n")
    refuse("plot: without matplotlib", ["plot", run], "matplotlib is missing", "tools/setup",
           PYTHONPATH=str(fake))
    refuse("plot: another ending", ["plot", run, "-o", "x.bmp"], "--output: x.bmp: must end in .png")
    refuse("plot: a folder that is not there", ["plot", run, "-o", scratch / "no/x.png"], "no/x.png",
           "No such file")


def same_for_all():
    empty = shutil.copytree(run, scratch / "empty")
    (empty / "checkpoint.json").unlink()
    text = (run / "config.toml").read_text()
    other = shutil.copytree(run, scratch / "other")
    (other / "config.toml").write_text(text.replace('task = "pendulum"', 'task = "cartpole"'))
    for command in ("predict", "plot", "render"):
        refuse(f"{command}: no run", [command, scratch / "none"], "none: no run here")
        refuse(f"{command}: without a finished episode", [command, empty], "no finished episode")
        refuse(f"{command}: a run of another task", [command, other], "checkpoint.json", "task")
        refuse(f"{command}: --episode of no number", [command, run, "--episode", "x"], "--episode")


def colours(rows, pixel, left, right, top, bottom):
    return {bytes(rows[y][x * pixel:x * pixel + 3])
            for y in range(top, bottom) for x in range(left, right)}


def renderings():
    strip = scratch / "strip.png"
    result = downpour("render", run, "-o", strip, env=environment)
    width, height, pixel, rows = read_png(strip)
    claims.check("render: a filmstrip without a display, of two rows of four pictures",
                 result.returncode == 0 and result.stdout == f"{strip}\n" and
                 (width, height) == (4 * 400 + 3 * 4, 2 * 300 + 4), result)
    first = colours(rows, pixel, 0, 400, 0, 300)
    claims.check("render: it shows something: many colours, none of them most of it black",
                 len(first) > 200 and sum(map(sum, rows)) > 100 * 3 * width * height, len(first))
    last = [rows[304 + y][1212 * pixel:1612 * pixel] for y in range(40, 260)]
    moved = sum(a != b for y, row in enumerate(last)
                for a, b in zip(row, rows[40 + y][:400 * pixel]))
    claims.check("render: the last picture differs from the first", moved > 1000, moved)
    downpour("render", run, "-o", scratch / "alone.png", "--rollouts", "0", env=environment)
    alone = read_png(scratch / "alone.png")[3]
    # Ghosts show where they leave the real body: not at the start.
    differs = [sum(a != b for y in range(top + 40, top + 260)
                   for a, b in zip(rows[y][left * pixel:(left + 400) * pixel],
                                   alone[y][left * pixel:(left + 400) * pixel]))
               for top in (0, 304) for left in (0, 404, 808, 1212)]
    claims.check("render: rollouts of the model are drawn over the real episode",
                 differs[0] < max(differs) and max(differs) > 300, differs)
    result = downpour("render", run, "--episode", "1", cwd=scratch, env=environment)
    claims.check("render: a random episode is drawn by itself, into the run if no file is named",
                 result.returncode == 0 and (run / "episode_1.png").exists(), result)
    refuse("render: another ending", ["render", run, "-o", "x.avi"], "x.avi",
           ".png, .gif or .mp4")
    refuse("render: an episode that is not there", ["render", run, "--episode", "9"],
           "--episode: 9", "[1, 4]")
    refuse("render: a folder that is not there", ["render", run, "-o", scratch / "no/x.png"],
           "no/x.png", "No such file")
    refuse("render: EGL without a driver", ["render", run], "OpenGL", "tools/setup --pictures",
           __EGL_VENDOR_LIBRARY_DIRS="/nonexistent")


def films():
    refuse("render: a film without ffmpeg", ["render", run, "-o", scratch / "x.gif"], "ffmpeg",
           "tools/setup --pictures", PATH="/nonexistent")
    claims.check("render: no file is left of a film without ffmpeg",
                 not (scratch / "x.gif").exists())
    if shutil.which("ffmpeg") is None:
        print("skipped: films, as ffmpeg is not installed")
        return
    film = scratch / "film.gif"
    result = downpour("render", run, "-o", film, env=environment)
    data = film.read_bytes()
    claims.check("render: a GIF of 640 x 360 that repeats",
                 result.returncode == 0 and data[:6] == b"GIF89a" and
                 struct.unpack("<HH", data[6:10]) == (640, 360) and b"NETSCAPE2.0" in data and
                 data.count(b"\x00\x21\xf9\x04") > 50, result)


def robots():
    robot = scratch / "robot"
    learn(robot, "--system", f"exec:{PROGRAM} simulate pendulum")
    result = downpour("plot", robot, env=environment)
    claims.check("plot: a run on a robot", result.returncode == 0, result)
    refuse("render: a run on a robot", ["render", robot], "of a robot", "simulated")


prediction()
plots()
robots()
same_for_all()
doctor = downpour("doctor", env=environment).stdout
if "EGL," in doctor:
    renderings()
    films()
else:
    print("skipped: rendering, as there is no EGL: " +
          next(line for line in doctor.splitlines() if line.startswith("pictures")))
claims.exit()
