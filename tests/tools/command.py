# SPDX-License-Identifier: Apache-2.0
"""What the tests of the command share: running it, and reporting claims."""
import atexit
import hashlib
import json
import pathlib
import shutil
import subprocess
import sys
import tempfile

PROGRAM = sys.argv[1]

# A run of seconds' fractions that still learns models and searches.
TINY = ["--evaluations", "600", "--set", "search.final_rollouts=24", "--set",
        "model.max_evaluations=30", "--episodes", "4", "--threads", "2"]


def downpour(*arguments, **options):
    return subprocess.run([PROGRAM, *map(str, arguments)], capture_output=True, text=True,
                          **options)


def scratch_directory():
    """A new directory that goes when the test ends, however it ends."""
    path = pathlib.Path(tempfile.mkdtemp(prefix="downpour-test-"))
    atexit.register(shutil.rmtree, path, ignore_errors=True)
    return path


def learn(directory, *arguments, task="pendulum"):
    """A finished tiny run."""
    result = downpour("learn", task, "--out", directory, "--quiet", *TINY, *arguments)
    if result.returncode != 0:
        sys.exit(f"downpour learn failed: {result.stderr}")


def contents(directory):
    """Name -> digest of every file."""
    return {str(path.relative_to(directory)): hashlib.sha256(path.read_bytes()).hexdigest()
            for path in sorted(pathlib.Path(directory).rglob("*")) if path.is_file()}


def results(directory):
    """Name -> text of every file of a run, without what depends on times and threads."""
    files = {path.name: path.read_text() for path in pathlib.Path(directory).iterdir()
             if path.is_file()}
    del files["timing.csv"]
    files.pop("prior_timing.csv", None)
    payload = json.loads(files["checkpoint.json"])["payload"]
    for episode in payload["episodes"]:
        for timed in ("model_seconds", "search_seconds", "rollout_seconds", "lane_fill",
                      "idle_share", "query_nanoseconds"):
            del episode[timed]
        for timed in ("step_nanoseconds", "search_share"):
            episode.get("prior", {}).pop(timed, None)
    files["checkpoint.json"] = json.dumps(payload)
    return files


class Claims:
    """Prints each claim with its outcome; exit() fails if one did not hold."""

    def __init__(self):
        self.failures = 0

    def check(self, claim, holds, details=""):
        print(f"{'ok' if holds else 'FAILED'}: {claim}")
        if not holds:
            self.failures += 1
            print(f"        {details}")

    def exit(self):
        sys.exit(1 if self.failures else 0)
