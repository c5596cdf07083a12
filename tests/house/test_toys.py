"""The toy system, method and engine of CONTRIBUTING.md, in a copy of the package: nothing else is to be changed."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import kreisel
from support import ROOT

PAGE = ROOT / "CONTRIBUTING.md"
DIFF = re.compile(r"<!-- (src/\S+) -->\n```diff\n(.*?)```", re.S)
USED = """
import json, numpy as np, kreisel as kr
from kreisel.method import METHODS
body = kr.ToyRotor(w=(0.5, 1.0, 1.5))
x0 = body.state(M=(1.0, 0.2, -1.5))
options = {"dt": 1e-3, "steps": 200, "progress": False}
runs = {e: kr.simulate(body, x0, method="toy-euler", engine=e, **options) for e in ("cpu", "toy")}
default = kr.simulate(body, x0, **options)
lanes = kr.simulate(body, body.state(M=[(1.0, 0.2, -1.5)] * 2), method="toy-euler", **options)
print(json.dumps({
    "file": kr.__file__,
    "systems": kr.systems(),
    "methods": [m.name for m in kr.methods()],
    "default": default.attrs["method"],
    "engines": float(abs(runs["cpu"].M - runs["toy"].M).max()),
    "lanes": float(abs(lanes.M.isel(lane=1) - runs["cpu"].M).max()),
    "error": float(abs(runs["toy"].M[-1] - default.M[-1]).max()),
    "moved": float(abs(default.M[-1] - default.M[0]).max()),
}))
"""


def apply(text: str, diff: str) -> str:
    """The hunks of a diff without line numbers, each of which must be found once."""
    for hunk in re.split(r"^@@\n", diff, flags=re.M):
        lines = hunk.splitlines(keepends=True)
        old = "".join(line[1:] for line in lines if line[0] in "- ")
        new = "".join(line[1:] for line in lines if line[0] in "+ ")
        assert text.count(old) == 1 or not text
        text = text.replace(old, new) if text else new
    return text


def test_a_toy_of_each_is_found_by_itself(tmp_path: Path) -> None:
    package = Path(kreisel.__file__).parent
    shutil.copytree(package, tmp_path / "src" / "kreisel", ignore=shutil.ignore_patterns("__pycache__"))
    found = DIFF.findall(PAGE.read_text(encoding="utf-8"))
    changed = [name for name, _ in found]
    assert [name.split("/")[2] for name in changed] == ["system", "method", "method", "kernels", "kernels"]
    for name, diff in found:
        path = tmp_path / name
        path.write_text(apply(path.read_text(encoding="utf-8") if path.exists() else "", diff), encoding="utf-8")
    env = {**os.environ, "PYTHONPATH": str(tmp_path / "src")}
    done = subprocess.run(
        [sys.executable, "-c", USED], env=env, cwd=tmp_path, capture_output=True, text=True, check=False, timeout=300
    )
    assert done.returncode == 0, done.stderr
    printed = json.loads(done.stdout)
    assert printed["file"].startswith(str(tmp_path))
    assert (
        "toy-rotor" in printed["systems"] and "toy-euler" in printed["methods"] and printed["default"] == "variational"
    )
    assert printed["engines"] < 1e-13 and printed["lanes"] < 1e-13
    assert 1e-6 < printed["error"] < 1e-2 < printed["moved"]
