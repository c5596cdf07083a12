"""The tests themselves: each of them asserts something, and what is skipped has a reason that is written down."""

from __future__ import annotations

import ast
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

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
    """Those of `pytest.importorskip` are not in the list, nor the three programs that `.ci/run` requires."""
    reasons = {r for path in TESTS.rglob("*.py") for r in written_reasons(path.read_text(encoding="utf-8"))}
    assert len(reasons) > 9 and {r.split(":")[0] for r in skips.counted(reasons)[1]} == {
        "no browser",
        "no g++",
        "no Node",
    }


def test_other_reasons_are_seen() -> None:
    counts, unknown = skips.counted(["Skipped: no compiler: rustc", "Skipped: could not import 'jax'"] * 2)
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


@pytest.mark.parametrize(
    ("present", "code", "words"),
    [
        ("chromium node g++ clang rustc mcs pdflatex", 0, ""),
        ("google-chrome node g++ rustc pdflatex", 0, "== no clang, so what needs it is left out (Debian: clang)"),
        ("chromium g++ clang rustc mcs pdflatex", 1, "== no node"),
        ("node g++ clang rustc mcs pdflatex", 1, "the tests need a browser"),
    ],
)
def test_pages_and_compilers_are_not_silently_left_out(present: str, code: int, words: str, tmp_path: Path) -> None:
    """`.ci/programs` asks for each missing program by its package, and fails without a browser or Node."""
    script = TESTS.parent / ".ci" / "programs"
    if not script.is_file():  # not in the sdist
        return
    for name in ("bash", "sed", "id"):
        (tmp_path / name).symlink_to(str(shutil.which(name)))
    for name in (*present.split(), "apt-get", "sudo"):
        (tmp_path / name).write_text('#!/usr/bin/env bash\n[ "$1" = -n ] && shift && exec "$@"\necho "asked: $*;"\n')
        (tmp_path / name).chmod(0o755)
    asked: dict[str, Any] = {"env": {"PATH": str(tmp_path)}, "capture_output": True, "text": True, "timeout": 60}
    checked = subprocess.run([script, "check"], **asked)
    assert checked.returncode == code and words in checked.stdout and checked.stderr == ""
    installed = subprocess.run([script, "install"], **asked).stdout
    for name, packages in {
        "mcs": "mono-mcs mono-runtime",
        "clang": "clang",
        "node": "nodejs",
        "rustc": "rustc",
    }.items():
        assert (f" {packages};" in installed) == (name not in present.split())
