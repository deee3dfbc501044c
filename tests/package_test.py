#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""The installed package serves projects in C++ and C that know nothing of the sources.

    package_test.py COMMAND BUILD SOURCE    COMMAND is the downpour command, BUILD its build tree
"""
import pathlib
import re
import shutil
import subprocess
import sys
import tempfile

COMMAND, BUILD, SOURCE = sys.argv[1], pathlib.Path(sys.argv[2]), pathlib.Path(sys.argv[3])
EXTERNAL = SOURCE / "tests" / "external_project"
# What a user of the package may call; the version's own symbol is the node's name.
VISIBLE = re.compile(r"(downpour_\w+@@DOWNPOUR_1|DOWNPOUR_1(@@DOWNPOUR_1)?)$")


def run(*command):
    done = subprocess.run([str(part) for part in command], capture_output=True, text=True)
    assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"
    return done.stdout


def configure(source, tree, *options):
    run("cmake", "-S", source, "-B", tree, "-G", "Ninja", *options)


def library_shows_its_interface_only(prefix):
    """Every function of downpour.h, and nothing else, by versioned symbols."""
    (library,) = prefix.glob("lib*/**/libdownpour.so.1")
    lines = run("nm", "-D", "--defined-only", library).splitlines()
    names = {line.split()[2] for line in lines}
    assert all(VISIBLE.match(name) for name in names), sorted(names)
    header = (prefix / "include" / "downpour.h").read_text()
    declared = set(re.findall(r"^\w[\w *]* \*?(downpour_\w+)\(", header, re.MULTILINE))
    shown = {name.split("@")[0] for name in names} - {"DOWNPOUR_1"}
    assert declared == shown, declared ^ shown
    assert "libdownpour.so.1" in run("readelf", "-d", library)


def all_headers(prefix, folder):
    """A source file that includes each installed header of C++, which so need no other ones."""
    root = prefix / "include" / "downpour"
    headers = sorted(path.relative_to(root) for path in root.glob("**/*.h"))
    assert len(headers) > 30, headers
    source = folder / "all_headers.cc"
    source.write_text("".join(f'#include "{header}"\n' for header in headers))
    return source


def examples_run(prefix, folder):
    """The examples of docs/library.md: the first line of each names its file."""
    text = (SOURCE / "docs" / "library.md").read_text(encoding="utf-8")
    blocks = re.findall(r"^```(?:cmake|cpp|c)\n(?:#|//|/\*) (\S+).*?\n(.*?)^```$", text,
                        re.MULTILINE | re.DOTALL)
    assert [name for name, _ in blocks] == [
        "CMakeLists.txt", "evaluate.cc", "with_eigen.cc", "from_limbo.cc", "from_c.c",
        "learn_from_c.c"], blocks
    folder.mkdir()
    for name, block in blocks:
        (folder / name).write_text(block, encoding="utf-8")
    configure(folder, folder / "build", f"-DCMAKE_PREFIX_PATH={prefix}")
    run("cmake", "--build", folder / "build")
    for name, _ in blocks[1:]:
        assert run(folder / "build" / name.split(".")[0])


def without_cmake(prefix, folder, example):
    """The lines that docs/library.md gives for a C compiler alone, on its own example."""
    text = (SOURCE / "docs" / "library.md").read_text(encoding="utf-8")
    (block,) = re.findall(r"^Without CMake:\n\n```sh\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    lines = block.replace("/opt/downpour", str(prefix)).splitlines()
    assert len(lines) == 3, lines
    folder.mkdir()
    (folder / "from_c.c").write_text(example.read_text())
    run("sh", "-c", f"cd {folder} && {lines[0]} && {lines[1]}")
    if shutil.which("pkg-config"):
        (folder / "from_c").unlink()
        run("sh", "-c", f"cd {folder} && {lines[2]} && {lines[1]}")


def main():
    with tempfile.TemporaryDirectory() as temporary:
        folder = pathlib.Path(temporary)
        prefix = folder / "prefix"
        run("cmake", "--install", BUILD, "--prefix", prefix)
        library_shows_its_interface_only(prefix)
        configure(EXTERNAL, folder / "found", f"-DCMAKE_PREFIX_PATH={prefix}",
                  f"-DALL_HEADERS={all_headers(prefix, folder)}")
        run("cmake", "--build", folder / "found")
        by_cpp = run(folder / "found" / "external")
        by_c = run(folder / "found" / "external_c")
        assert by_cpp == by_c, f"{by_cpp}{by_c}"
        # Kernels are still chosen when a program runs: it has the command's instruction set.
        simd = re.search(r"^SIMD +(\S+)", run(COMMAND, "doctor"), re.MULTILINE).group(1)
        assert by_cpp.split()[0] == simd, (by_cpp, simd)
        examples_run(prefix, folder / "examples")
        without_cmake(prefix, folder / "without_cmake", folder / "examples" / "from_c.c")


main()
