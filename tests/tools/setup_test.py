# SPDX-License-Identifier: Apache-2.0
"""tools/setup with stand-ins for the package manager and for CMake."""

import os
import pathlib
import shutil
import subprocess
import sys
import tempfile
import unittest

ROOT = pathlib.Path(__file__).resolve().parents[2]
TOOLS = ["bash", "dirname", "env", "grep", "nproc"]
STAND_INS = {
    "apt-get": 'echo "apt-get [$DEBIAN_FRONTEND] $*" >>"$CALLS"',
    "cmake": 'echo "cmake $*" >>"$CALLS"; echo noise',
    "dpkg-query": """for package in "${@:4}"; do
      [[ " $MISSING " == *" $package "* ]] || echo "$package installed"
    done""",
    "id": 'echo "$FAKE_UID"',
    "sudo": 'echo sudo >>"$CALLS"; exec "$@"',
}


class SetupTest(unittest.TestCase):

  def setUp(self):
    scratch = tempfile.TemporaryDirectory()
    self.addCleanup(scratch.cleanup)
    self.root = pathlib.Path(scratch.name)
    self.bin = self.root / "bin"
    self.calls = self.root / "calls"
    self.calls.touch()
    (self.root / "tools").mkdir()
    shutil.copy(ROOT / "tools/setup", self.root / "tools/setup")
    shutil.copy(ROOT / "CMakePresets.json", self.root)
    self.bin.mkdir()
    for tool in TOOLS:
      (self.bin / tool).symlink_to(shutil.which(tool))
    for name, body in STAND_INS.items():
      (self.bin / name).write_text(f"#!{shutil.which('bash')}\n{body}\n")
      (self.bin / name).chmod(0o755)

  def run_setup(self, *arguments, missing="", uid=0):
    """Runs it from another directory, with no terminal; returns the result and the calls."""
    environment = {"PATH": str(self.bin), "CALLS": str(self.calls), "MISSING": missing,
                   "FAKE_UID": str(uid)}
    result = subprocess.run([self.root / "tools/setup", *arguments], cwd="/", env=environment,
                            stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False)
    return result, self.calls.read_text().splitlines()

  def test_nothing_is_installed_when_nothing_is_missing(self):
    result, calls = self.run_setup()
    self.assertEqual(result.returncode, 0, result.stderr)
    self.assertEqual([call.split()[0] for call in calls], ["cmake", "cmake"])
    self.assertEqual(calls[0], "cmake --preset release")

  def test_only_the_missing_packages_are_installed_in_one_call(self):
    result, calls = self.run_setup(missing="cmake libmujoco-dev clang")
    self.assertEqual(result.returncode, 0, result.stderr)
    self.assertEqual(calls[:2], [
        "apt-get [noninteractive] update -qq",
        "apt-get [noninteractive] install -y -qq --no-install-recommends cmake libmujoco-dev"])
    self.assertTrue(all(call.startswith("cmake") for call in calls[2:]))

  def test_ci_adds_its_packages_to_the_same_call(self):
    _, calls = self.run_setup("--ci", "asan", missing="cmake clang")
    self.assertEqual(calls[1].split()[-2:], ["cmake", "clang"])
    self.assertEqual(calls[2], "cmake --preset asan")

  def test_pictures_add_their_packages_and_configure_a_configured_tree_again(self):
    tree = self.root / "build/release"
    tree.mkdir(parents=True)
    (tree / "build.ninja").touch()
    _, calls = self.run_setup("--pictures", missing="ffmpeg libegl-dev")
    self.assertEqual(calls[1].split()[-2:], ["ffmpeg", "libegl-dev"])
    self.assertEqual(calls[2], "cmake --preset release")

  def test_sudo_is_used_without_root(self):
    result, calls = self.run_setup(missing="cmake", uid=1000)
    self.assertEqual(result.returncode, 0, result.stderr)
    self.assertEqual(calls[0], "sudo")
    self.assertIn("apt-get [noninteractive] install", calls[3])

  def test_neither_root_nor_sudo_gives_one_line_with_the_command_to_run(self):
    (self.bin / "sudo").unlink()
    result, calls = self.run_setup(missing="cmake libhwy-dev", uid=1000)
    self.assertEqual(result.returncode, 2)
    self.assertEqual(result.stderr, "tools/setup: neither root nor sudo here; as root, run: "
                                    "apt-get install cmake libhwy-dev\n")
    self.assertEqual(calls, [])

  def test_an_unknown_preset_is_refused_with_what_is_allowed(self):
    result, calls = self.run_setup("relese")
    self.assertEqual(result.returncode, 2)
    self.assertEqual(result.stderr, "tools/setup: unknown argument 'relese'; allowed: "
                                    "--ci, --pictures, release, debug, asan, tsan\n")
    self.assertEqual(calls, [])

  def test_standard_output_is_left_to_the_program(self):
    result, _ = self.run_setup(missing="cmake")
    self.assertEqual(result.stdout, "")

  def test_a_configured_tree_is_only_built(self):
    tree = self.root / "build/release"
    tree.mkdir(parents=True)
    (tree / "build.ninja").touch()
    _, calls = self.run_setup()
    self.assertEqual(len(calls), 1)
    self.assertTrue(calls[0].startswith("cmake --build --preset release"), calls)


if __name__ == "__main__":
  unittest.main(argv=sys.argv[:1])
