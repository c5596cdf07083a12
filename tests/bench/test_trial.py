"""The trial: its harness sees what it should see, and what the page says of it is what the result says."""

from __future__ import annotations

import importlib.util
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from sizes import FULL
from support import ROOT

TRIAL, RESULT = ROOT / "benchmarks" / "trial", ROOT / "benchmarks" / "results" / "trial.json"
FAULTS = """
import json, os, signal, sys, time
from pathlib import Path
sys.path.insert(0, {trial!r})
import pool, sandbox

def case(rng, folder):
    number = int(folder.name.split("-")[1])
    pool.note(f"number {{number}}")
    if number == 1:
        raise ValueError("a fault")
    if number == 2:
        os.kill(os.getpid(), signal.SIGSEGV)
    if number == 3:
        time.sleep(60)
    if number == 4:
        signal.signal(signal.SIGALRM, signal.SIG_IGN)
        time.sleep(60)
    if number == 5:
        (folder.parent.parent / "sentinel" / "data.csv").write_text("lost")
    if number == 6:
        bytearray(9 << 30)
    return "fine"

pool.GRACE = 1.0
base = Path({base!r})
sandbox.enter(base, False)
sandbox.sentinel(base)
result = pool.carry_out(pool.Part("some", case, 9, 1.0, seconds=1), 9, 60, 1, base, 2)
print(json.dumps([result.done, dict(result.outcomes), result.faults]))
"""


def test_the_pool_sees_faults_deaths_hangs_and_files_that_are_touched(tmp_path: Path) -> None:
    code = FAULTS.format(trial=str(TRIAL), base=str(tmp_path))
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    count, outcomes, faults = json.loads(done.stdout)
    assert (count, outcomes) == (9, {"fine": 3, "fault": 6})
    words = {fault["case"]: fault["what"] for fault in faults}
    for case, expected in enumerate(("a fault", "died", "Hang", "obeys no signal", "touched", "MemoryError"), start=1):
        assert expected in words[case], words[case]


def parts_of(tmp_path: Path, minutes: float, *words: str) -> tuple[int, dict[str, Any]]:
    out = tmp_path / "trial.json"
    command = [sys.executable, str(TRIAL), "--minutes", str(minutes), "--workers", "1", "--out", str(out), *words]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=300, cwd=tmp_path)
    assert out.exists(), done.stderr
    return done.returncode, json.loads(out.read_text())["parts"]


@pytest.mark.skipif(not FULL, reason="`make test-full` runs it")
def test_one_case_can_be_repeated(tmp_path: Path) -> None:
    command = [sys.executable, str(TRIAL), "--part", "configurations", "--seed", "1", "--case", "1"]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=300, cwd=tmp_path)
    printed = json.loads(done.stdout)
    assert (printed["case"], printed["outcome"]) == (1, "run: refused"), printed


def test_the_trial_sees_a_check_that_accepts_everything(tmp_path: Path) -> None:
    """The mutant: `check_archive` finds no fault."""
    (tmp_path / "sitecustomize.py").write_text(
        "from kreisel.sweeps import sweep\n"
        "original = sweep.check_archive\n"
        "sweep.check_archive = lambda path: (original(path)[0], [])\n"
    )
    before = os.environ.get("PYTHONPATH", "")
    os.environ["PYTHONPATH"] = os.pathsep.join([str(tmp_path), *filter(None, [before])])
    try:
        code, parts = parts_of(tmp_path, 0.15, "--part", "corruptions")
    finally:
        os.environ["PYTHONPATH"] = before
    assert code == 1
    assert any("check accepts it" in fault["what"] for fault in parts["corruptions"]["faults"])


PUBLIC = """
import inspect, sys
sys.path.insert(0, {trial!r})
import surface
from kreisel import physical

def unexplained(call):
    function = call.function(None)
    made = "__new__" if inspect.isclass(function) and issubclass(function, tuple) else "__init__"
    function = getattr(function, made) if inspect.isclass(function) else function
    return not hasattr(getattr(function, "__func__", function), "__wrapped__")

calls = surface.surface()
assert not [call.name for call in calls if unexplained(call)], [call.name for call in calls if unexplained(call)]

def sink(tonnage):  # the control: neither explained, nor with a parameter that the trial knows
    pass

sink.__module__ = "kreisel.physical"
physical.sink = sink
physical.__all__ = [*physical.__all__, "sink"]
try:
    surface.surface()
except surface.Unknown as error:
    assert "tonnage" in str(error)
    surface.KIND_OF["tonnage"] = "mass"
    assert [call.name for call in surface.surface() if unexplained(call)] == ["physical.sink"]
    print(len(calls))
"""


def test_every_public_function_is_called_by_the_trial_and_explains_its_arguments(tmp_path: Path) -> None:
    code = PUBLIC.format(trial=str(TRIAL))
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, timeout=120)
    assert done.returncode == 0 and int(done.stdout) > 120, done.stderr


def test_the_page_says_what_the_result_says() -> None:
    spec = importlib.util.spec_from_file_location("telling", TRIAL / "telling.py")
    assert spec is not None and spec.loader is not None
    telling = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(telling)
    result = json.loads(RESULT.read_text(encoding="utf-8"))
    page = (ROOT / "docs" / "promises.md").read_text(encoding="utf-8")
    assert telling.entered(page, result) == page
    assert not any(part["do_not_hold"] for part in result["parts"].values())
