"""`kreisel bench`: its figures on a machine with and without g++; the bound that benchmarks/ensemble.py computes."""

import importlib
import json
import os
from pathlib import Path
from typing import Any

import pytest

from kreisel import bench
from kreisel.cli import subjects
from kreisel.graph.machine import register_width
from sizes import full
from support import ROOT

RATIOS = ("step_to_cpp", "lane_step_to_cpp")


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    only = bench.cases(generic=True)[:1]
    monkeypatch.setattr(bench, "cases", lambda generic: only)
    for name, value in (("SINGLE_STEPS", 2000), ("ENSEMBLE_STEPS", 1), ("SHARE", 10_000), ("LANES", 64 * 6)):
        monkeypatch.setattr(bench, name, value)


@pytest.mark.usefixtures("quick")
def test_without_a_compiler_the_comparison_is_left_out(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("PATH", "")
    subjects.bench(as_json=True)
    result = json.loads(capsys.readouterr().out)
    assert result["note"] == bench.MISSING
    (row,) = result["maps"].values()
    assert all(value > 0 for value in row.values())
    assert not row.keys() & set(RATIOS)
    subjects._print_bench(result)
    printed = capsys.readouterr().out
    assert "lagrange-top" in printed
    assert "g++ is not on the PATH" in printed


@pytest.mark.parametrize("name", ["memory", *full("code_single")])
def test_a_short_run_of_a_benchmark_is_only_printed(
    name: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """The committed results of 10^9 steps stay; a complete run, of as few, writes them."""
    if name == "code_single" and bench.compiler() is None:
        pytest.skip("no g++")
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    script = importlib.import_module(name)
    monkeypatch.setattr(script, "RESULTS", tmp_path)
    monkeypatch.setattr("sys.argv", [name, "10000"])
    script.main()
    assert "10000" in capsys.readouterr().out and not [*tmp_path.iterdir()]
    monkeypatch.setattr(script, "STEPS" if name == "memory" else "FRAMES", 10_000)
    script.main()
    assert len([*tmp_path.iterdir()]) == 1


@pytest.mark.skipif(bench.compiler() is None, reason="no g++")
@pytest.mark.usefixtures("quick")
def test_with_a_compiler_the_kernels_are_compared() -> None:
    result = bench.bench()
    (row,) = result["maps"].values()
    assert all(row[name] > 0 for name in RATIOS)
    assert "note" not in result


@pytest.mark.skipif(bench.compiler() is None, reason="no g++")
@pytest.mark.parametrize("lanes", [None, 96])
def test_another_map_is_no_opponent(lanes: int | None, tmp_path) -> None:
    """Kernel and C++ are compared before they are timed; the mutant makes another step."""
    (case,) = bench.cases(generic=True)[:1]
    contest = bench.Contest(case, bench.build("single" if lanes is None else "ensemble", tmp_path), lanes)
    assert contest.agreement(1000) < 1e-12
    steps = contest.steppers["cpp" if lanes is None else "cpp 1"]
    contest.steppers["mutant"] = lambda count: steps(count + 1)
    with pytest.raises(AssertionError, match="apart from the kernel"):
        contest.agreement(1000)


def test_saving_is_measured_for_the_rows_asked_for() -> None:
    (case,) = bench.cases(generic=True)[:1]
    row = bench.saving_ratios(case, "suris", 1, 10_000, (10, 100))
    assert [key for key in row if key.startswith("every")] == ["every 10", "every 100"]


@pytest.fixture(scope="module")
def ensemble() -> Any:
    """The script benchmarks/ensemble.py."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(ROOT / "benchmarks"))
        return importlib.import_module("ensemble")


@pytest.fixture(scope="module")
def kernel(ensemble: Any) -> Any:
    if register_width() == 2:
        pytest.skip("the loop is looked for in registers of AVX")
    (case,) = [case for case in bench.cases(generic=True) if case.name == "clebsch"]
    return ensemble.code_of(case, 64)


def tool(folder: Path, name: str, does: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """A program of that name before all others."""
    folder.mkdir(exist_ok=True)
    (folder / name).write_text(f"#!/bin/sh\n{does}\n")
    (folder / name).chmod(0o755)
    monkeypatch.setenv("PATH", f"{folder}{os.pathsep}{os.environ['PATH']}")


def test_the_bound_is_that_of_the_loop_over_steps(
    ensemble: Any, kernel: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An analyser that works is given the loop; the mutant counts a vector too many."""
    seen = tmp_path / "seen"
    tool(tmp_path / "bin", "llvm-mca", f"cat > {seen}; echo 'Block RThroughput: 96.0'", monkeypatch)
    bound = ensemble.bound(kernel)
    assert bound is not None
    assert bound["vectors"] == 4
    assert bound["instructions"] == len(seen.read_text().splitlines()) > 4 * 20
    assert bound["cycles_a_lane_step"] == 96 / kernel.lanes
    with pytest.raises(AssertionError, match="divisions in the loop"):
        ensemble.bound(kernel._replace(lanes=3 * kernel.lanes // 2))


def test_the_bound_by_the_analyser_that_is_there(ensemble: Any, kernel: Any) -> None:
    bound = ensemble.bound(kernel)
    if bound is None:
        pytest.skip("no llvm-mca that reads this assembly")
    assert bound["cycles_a_lane_step"] > 0.5 * bound["instructions"] / bound["vectors"] / 8 / 6


@pytest.mark.parametrize(
    "does",
    [
        "echo 'error: invalid operand' >&2; exit 1",
        "echo nothing of use",
        "echo 'Block RThroughput: 96.0'; exit 1",
        "echo 'Block RThroughput: nan'",
        "echo 'Block RThroughput: 96.0'; echo \"'znver9' is not a recognized processor for this target\" >&2",
        r"printf '\377\376'",
    ],
)
def test_an_analyser_that_does_not_work_is_as_good_as_none(
    does: str, ensemble: Any, kernel: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tool(tmp_path / "bin", "llvm-mca", does, monkeypatch)
    assert ensemble.bound(kernel) is None


@pytest.mark.parametrize("does", ["exit 1", "exit 0", "no-such-program"])
def test_a_compiler_that_does_not_work_is_as_good_as_none(
    does: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tool(tmp_path / "bin", "g++", does, monkeypatch)
    assert bench.compiler() is None
    with pytest.raises(FileNotFoundError, match="does not work"):
        bench.build("single", tmp_path)
