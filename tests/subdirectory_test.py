#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""A project takes the sources in by add_subdirectory, builds what it needs of them, and runs.

    subdirectory_test.py SOURCE
"""
import os
import pathlib
import subprocess
import sys
import tempfile

SOURCE = pathlib.Path(sys.argv[1])


def run(*command):
    done = subprocess.run([str(part) for part in command], capture_output=True, text=True)
    assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"
    return done.stdout


def main():
    with tempfile.TemporaryDirectory() as temporary:
        tree = pathlib.Path(temporary)
        # Not optimised, and for the baseline instruction set alone: most of the time is the
        # compiler's.
        run("cmake", "-S", SOURCE / "tests" / "external_project", "-B", tree, "-G", "Ninja",
            f"-DDOWNPOUR_SOURCE_DIR={SOURCE}", "-DCMAKE_BUILD_TYPE=Debug",
            "-DCMAKE_CXX_FLAGS_DEBUG=-O0 -DHWY_COMPILE_ONLY_STATIC")
        run("cmake", "--build", tree, "--parallel", str(len(os.sched_getaffinity(0))))
        by_cpp = run(tree / "external")
        assert len(by_cpp.split()) == 8 and by_cpp == run(tree / "external_c"), by_cpp
        # The libraries and no more.
        built = {path.name for path in (tree / "downpour").glob("**/*") if os.access(path, os.X_OK)
                 and path.is_file() and path.suffix != ".sh"}
        assert all(name.startswith("libdownpour.so") for name in built), built


main()
