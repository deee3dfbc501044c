# SPDX-License-Identifier: Apache-2.0
"""The examples of docs/evaluator.md run as they stand; docstrings and stubs tell what there is."""
import ast
import inspect
import pathlib
import re
import subprocess
import sys
import unittest

import downpour as dp

ROOT = pathlib.Path(__file__).resolve().parents[2]
# Fewer evaluations than a reader's, so that the test takes seconds.
QUICKER = {"max_evaluations=20_000": "max_evaluations=3_000"}


def examples():
    """Heading -> program of the Python blocks of docs/evaluator.md that are whole programs."""
    text = (ROOT / "docs" / "evaluator.md").read_text(encoding="utf-8")
    found = {}
    for section in re.split(r"^## ", text, flags=re.M)[1:]:
        blocks = re.findall(r"^```python\n(.*?)^```", section, flags=re.M | re.S)
        if blocks and "import downpour" in blocks[0]:
            found[section.splitlines()[0]] = blocks[0]
    return found


def public_names(owner):
    return {name for name in vars(owner) if not name.startswith("_")}


class DocumentationTest(unittest.TestCase):
    def test_every_example_runs(self):
        programs = examples()
        self.assertEqual(len(programs), 3, list(programs))
        for heading, program in programs.items():
            with self.subTest(example=heading):
                for whole, part in QUICKER.items():
                    program = program.replace(whole, part)
                result = subprocess.run([sys.executable, "-W", "error", "-c", program],
                                        capture_output=True, text=True, check=False)
                self.assertEqual(result.returncode, 0, result.stderr)
                self.assertNotEqual(result.stdout, "")

    def test_everything_public_has_a_docstring(self):
        for name in dp.__all__:
            thing = getattr(dp, name)
            if not (inspect.isclass(thing) or callable(thing)):
                continue
            self.assertTrue(thing.__doc__, name)
            if not inspect.isclass(thing):
                continue
            for member in public_names(thing):
                if member in ("task", "rollouts", "state_names", "feature_names", "action_names"):
                    continue  # say it all by their names
                self.assertTrue(vars(thing)[member].__doc__ or
                                isinstance(vars(thing)[member], staticmethod), f"{name}.{member}")

    def test_stubs_name_what_there_is(self):
        stubs = ast.parse((pathlib.Path(dp.__file__).parent / "__init__.pyi").read_text())
        self.assertTrue((pathlib.Path(dp.__file__).parent / "py.typed").exists())
        classes = {node.name: node for node in stubs.body if isinstance(node, ast.ClassDef)}
        functions = {node.name for node in stubs.body if isinstance(node, ast.FunctionDef)}
        for name in set(dp.__all__) - {"__version__"}:
            if name not in classes:
                self.assertIn(name, functions)
                continue
            members = {node.name for node in classes[name].body
                       if isinstance(node, ast.FunctionDef) and not node.name.startswith("_")}
            self.assertEqual(members, public_names(getattr(dp, name)), name)

    def test_docstrings_and_stubs_have_the_same_arguments(self):
        stubs = ast.parse((pathlib.Path(dp.__file__).parent / "__init__.pyi").read_text())
        for node in stubs.body:
            if not isinstance(node, ast.ClassDef) or not hasattr(dp, node.name):
                continue
            for init in node.body:
                if isinstance(init, ast.FunctionDef) and init.name == "__init__":
                    doc = getattr(dp, node.name).__doc__
                    call = re.search(re.escape(node.name) + r"\((.*?)\)\n\n", doc, flags=re.S)[1]
                    told = re.findall(r"(\w+)(?:=|,|$)", re.sub(r"=\([^)]*\)|=[^,]+", "=", call))
                    self.assertEqual(told, [a.arg for a in init.args.args[1:]], node.name)


if __name__ == "__main__":
    unittest.main()
