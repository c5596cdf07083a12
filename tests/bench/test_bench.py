"""`kreisel bench`: its figures on a machine with and without g++."""

import json

import pytest

from kreisel.bench import compiled, ensemble, saving, short, single
from kreisel.cli import subjects

RATIOS = ("step_to_cpp", "lane_step_to_cpp")


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    only = short.cases(generic=True)[:1]
    monkeypatch.setattr(short, "cases", lambda generic: only)
    for module, name, value in (
        (short, "SINGLE_STEPS", 2000),
        (short, "ENSEMBLE_STEPS", 1),
        (short, "PART", 10_000),
        (ensemble, "LANES", 64 * 6),
    ):
        monkeypatch.setattr(module, name, value)


@pytest.mark.usefixtures("quick")
def test_without_a_compiler_the_comparison_is_left_out(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("PATH", "")
    subjects.bench(as_json=True)
    result = json.loads(capsys.readouterr().out)
    assert result["note"] == compiled.MISSING
    (row,) = result["maps"].values()
    assert all(value > 0 for value in row.values())
    assert not row.keys() & set(RATIOS)
    subjects._print_bench(result)
    printed = capsys.readouterr().out
    assert "lagrange-top" in printed
    assert "g++ is not on the PATH" in printed


@pytest.mark.skipif(compiled.compiler() is None, reason="no g++")
@pytest.mark.usefixtures("quick")
def test_with_a_compiler_the_kernels_are_compared() -> None:
    result = short.bench()
    (row,) = result["maps"].values()
    assert all(row[name] > 0 for name in RATIOS)
    assert "note" not in result


@pytest.mark.skipif(compiled.compiler() is None, reason="no g++")
def test_another_map_is_no_opponent(tmp_path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Kernel and C++ are compared before they are timed; the mutant takes another step."""
    (case,) = short.cases(generic=True)[:1]
    library = compiled.build("single", tmp_path)
    start, steppers = single.contenders(case, library)
    assert max(single.agreement(start, steppers, case.name).values()) < single.TOLERANCE
    wrong = {**steppers, "cpp": lambda row, steps: steppers["cpp"](row, steps + 1)}
    with pytest.raises(AssertionError, match="apart after"):
        single.agreement(start, wrong, case.name)


def test_saving_is_measured_for_the_rows_asked_for() -> None:
    (case,) = short.cases(generic=True)[:1]
    row = saving.ratios(case, "suris", 1, 10_000, (10, 100))
    assert [key for key in row if key.startswith("every")] == ["every 10", "every 100"]
