# SPDX-License-Identifier: Apache-2.0
"""What the tests of several processes share: starting them with mpirun, and finding them."""
import contextlib
import os
import pathlib
import subprocess

from command import PROGRAM, scratch_directory

# More processes than cores, as root, without a network.
ENVIRONMENT = os.environ | {"OMPI_ALLOW_RUN_AS_ROOT": "1", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1",
                            "OMPI_MCA_rmaps_base_oversubscribe": "1",
                            "OMPI_MCA_hwloc_base_binding_policy": "none",
                            "OMPI_MCA_btl": "self,vader", "TMPDIR": str(scratch_directory())}


def mpirun_words(n, *arguments, options=()):
    return ["mpirun", *options, "-n", str(n), PROGRAM, *map(str, arguments)]


PATIENCE = 300  # seconds; processes that wait for each other fail the test instead of hanging it


def mpirun(n, *arguments, options=()):
    process = start_mpirun(n, *arguments, options=options)
    output, error = ended(process)
    return subprocess.CompletedProcess(process.args, process.returncode, output, error)


def start_mpirun(n, *arguments, options=()):
    return subprocess.Popen(mpirun_words(n, *arguments, options=options), env=ENVIRONMENT,
                            stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
                            stderr=subprocess.PIPE, text=True)


def ended(process):
    """What it said, when it has ended."""
    try:
        return process.communicate(timeout=PATIENCE)
    except subprocess.TimeoutExpired:
        process.terminate()  # mpirun ends the others
        output, error = process.communicate()
        return output, f"{error}killed after {PATIENCE} s\n"


def process_of(rank, word):
    """The process of a rank whose command line has a word."""
    for path in pathlib.Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            words = (path / "cmdline").read_bytes().split(b"\0")
            variables = (path / "environ").read_bytes().split(b"\0")
            if str(word).encode() in words and \
                    f"OMPI_COMM_WORLD_RANK={rank}".encode() in variables:
                return int(path.name)
    return None


def said(result):
    """The lines that are not mpirun's own."""
    return [line for line in result.stderr.splitlines() if line.startswith("downpour: ")]
