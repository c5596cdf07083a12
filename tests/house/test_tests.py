"""The tests themselves: each of them asserts something, and what is skipped has a reason that is written down."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from pathlib import Path

import pytest

import skips
from support import ROOT

TESTS = ROOT / "tests"
HELPERS = ("require", "check", "assert")  # how the names of functions begin that assert for a test


def asserts(test: ast.AST) -> bool:
    """Whether a test has an `assert`, `pytest.raises`, `pytest.warns`, or a call of a helper."""
    for node in ast.walk(test):
        if isinstance(node, ast.Assert):
            return True
        if isinstance(node, ast.Call):
            name = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
            if name in ("raises", "warns") or name.startswith(HELPERS):
                return True
    return False


def without_assertion(source: str) -> list[str]:
    """The names of tests that assert nothing."""
    tests = [n for n in ast.walk(ast.parse(source)) if isinstance(n, ast.FunctionDef) and n.name.startswith("test_")]
    return [test.name for test in tests if not asserts(test)]


@pytest.mark.parametrize("path", sorted(TESTS.rglob("test_*.py")), ids=lambda path: path.stem)
def test_every_test_asserts_something(path: Path) -> None:
    assert without_assertion(path.read_text(encoding="utf-8")) == []


def test_a_test_without_an_assertion_is_seen() -> None:
    source = "def test_a():\n    f()\n\ndef test_b():\n    with pytest.raises(E):\n        f()\n"
    source += "\ndef test_c():\n    check_all()\n"
    assert without_assertion(source) == ["test_a"]


def written_reasons(source: str) -> list[str]:
    """The reasons of `pytest.skip` and `skipif` in a file, up to their first variable part."""
    found = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr in ("skip", "skipif"):
            given = [k.value for k in node.keywords if k.arg == "reason"] or node.args
            text = given[0].values[0] if isinstance(given[0], ast.JoinedStr) else given[0]
            found.append(str(ast.literal_eval(text)))
    return found


def test_what_is_skipped_has_a_reason_of_the_list() -> None:
    """Beside these there is `pytest.importorskip`, whose reasons are not in the list, and compilers."""
    reasons = {r for path in TESTS.rglob("*.py") for r in written_reasons(path.read_text(encoding="utf-8"))}
    assert reasons - {"no g++"} and skips.counted(reasons)[1] == ["no g++"]


def test_other_reasons_are_seen() -> None:
    counts, unknown = skips.counted(["Skipped: no browser: none of chrome", "Skipped: could not import 'jax'"] * 2)
    assert counts.total() == 4 and unknown == ["could not import 'jax'"]


@pytest.mark.parametrize(("how", "code"), [("listed", 1), ("", 0)])
def test_skips_are_counted_and_refused_where_all_must_run(how: str, code: int, tmp_path: Path) -> None:
    path = tmp_path / "test_lazy.py"
    path.write_text("import pytest\n\ndef test_it():\n    pytest.skip('too lazy')\n")
    env = {**os.environ, "PYTHONPATH": str(TESTS), "KREISEL_SKIPS": how}
    run = [sys.executable, "-m", "pytest", "-q", "-p", "skips", "-p", "no:cacheprovider", path.name]
    done = subprocess.run(run, cwd=tmp_path, env=env, capture_output=True, text=True, check=False, timeout=60)
    assert done.returncode == code, done.stdout + done.stderr
    assert "1 skipped: too lazy; not in tests/skips.py" in done.stdout
