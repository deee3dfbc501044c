# SPDX-License-Identifier: Apache-2.0
"""A disk that fills during a run costs no finished episode, and the run can go on."""
import os
import resource
import shutil
import subprocess

from command import PROGRAM, TINY, Claims, downpour, learn, results, scratch_directory

claims = Claims()
scratch = scratch_directory()
reference = scratch / "reference"
learn(reference)


def one_line(result):
    return result.returncode == 2 and len(result.stderr.splitlines()) == 1


def file_size_limit():
    """The checkpoint of two episodes fits, that of three does not."""
    run = scratch / "limited"
    limit = 30000
    result = downpour("learn", "pendulum", "--out", run, "--quiet", *TINY, preexec_fn=lambda:
                      resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit)))
    claims.check("a file-size limit gives one line and exit code 2", one_line(result) and
                 "File too large" in result.stderr and str(run) in result.stderr, result)
    claims.check("the line says what is kept and how to go on",
                 f"episodes 1 to 2 are kept in {run}" in result.stderr and
                 f"go on with: {PROGRAM} learn --resume {run}" in result.stderr, result.stderr)
    resumed = downpour("learn", "--resume", run, "--quiet")
    claims.check("resumed with room, it ends as if nothing had been",
                 resumed.returncode == 0 and results(run) == results(reference), resumed.stderr)


def small_disk():
    """The same on a file system of 80 KB, where the tests may mount one."""
    disk = scratch / "disk"
    disk.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=80k", "downpour-test", disk]
    if os.geteuid() != 0 or subprocess.run(mount, capture_output=True).returncode != 0:
        print("left out: a full disk (mounting one takes root)")
        return
    try:
        run = disk / "run"
        result = downpour("learn", "pendulum", "--out", run, "--quiet", *TINY)
        claims.check("a full disk gives one line and exit code 2", one_line(result) and
                     "No space left on device" in result.stderr and "kept" in result.stderr, result)
        moved = scratch / "moved"
        shutil.copytree(run, moved)
        claims.check("a full disk leaves no half-written file", not list(moved.glob("*.tmp")))
        resumed = downpour("learn", "--resume", moved, "--quiet")
        claims.check("moved to a larger disk, it ends as if nothing had been",
                     resumed.returncode == 0 and results(moved) == results(reference),
                     resumed.stderr)
        blocked = disk / "filler"
        with open(blocked, "wb") as filler:
            try:
                filler.write(bytes(1 << 20))
                filler.flush()
            except OSError:
                pass
        result = downpour("learn", "pendulum", "--out", disk / "new", "--quiet", *TINY)
        claims.check("a disk that is full from the start gives one line and exit code 2",
                     one_line(result) and str(disk / "new") in result.stderr, result)
    finally:
        subprocess.run(["umount", disk], check=True)


def full_output():
    run = scratch / "output"
    with open("/dev/full", "w") as full:
        result = subprocess.run([PROGRAM, "learn", "pendulum", "--out", run, "--json", *TINY],
                                stdout=full, stderr=subprocess.PIPE, text=True)
    claims.check("standard output on a full disk gives exit code 2 and names what is kept",
                 result.returncode == 2 and "standard output" in result.stderr.splitlines()[-1] and
                 f"episode 1 is kept in {run}" in result.stderr, result)


file_size_limit()
small_disk()
full_output()
claims.exit()
