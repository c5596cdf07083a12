"""Every test that docs/promises.md names exists, and every line names one."""

from __future__ import annotations

import ast
import re

from support import ROOT

PAGE = ROOT / "docs" / "promises.md"


def test_every_promise_names_a_test_that_exists() -> None:
    text = PAGE.read_text(encoding="utf-8").split("## Shown by a trial")[0]
    lines = [line for line in text.splitlines() if line.startswith("| ")]
    promises = [line for line in lines if "promise | test" not in line]
    assert len(promises) > 20
    for line in promises:
        named = re.findall(r"\[`(\w+)`\]\((\.\./tests/\w+/\w+\.py)\)", line)
        assert named, f"no test stands beside: {line}"
        assert line.count("](") == len(named)
        for name, path in named:
            tree = ast.parse((PAGE.parent / path).read_text(encoding="utf-8"))
            functions = [node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)]
            assert name in functions, f"{path} has no {name}"
