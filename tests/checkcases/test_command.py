"""`kreisel checkcase` and `kreisel new checkcase`, as a user calls them."""

from __future__ import annotations

import csv
import json
import math
import runpy
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import kreisel as kr
from kreisel.cli import app

RUNNER = CliRunner()


def test_cases_are_listed_and_printed() -> None:
    listed = RUNNER.invoke(app, ["checkcase"]).output
    assert all(name in listed for name in kr.checkcases.cases())
    printed = RUNNER.invoke(app, ["checkcase", "tumbling-brick"]).output
    assert "12.618390775914219" in printed
    assert "0.00189422 0.006211019 0.007194665 slug ft^2" in printed
    data = json.loads(RUNNER.invoke(app, ["checkcase", "pole", "--at", "10", "--json"]).output)
    assert math.isclose(float(data["exact"][0]["attitude"][2]), math.sqrt(0.5), rel_tol=1e-15)


@pytest.mark.parametrize("time", ["nan", "inf", "-5", "31"])
def test_times_that_are_none_of_the_case(time: str) -> None:
    refused = RUNNER.invoke(app, ["checkcase", "tumbling-brick", f"--at={time}"])
    assert isinstance(refused.exception, kr.InputError)
    assert ("--at" if time in ("nan", "inf") else "0 to 30 s") in str(refused.exception)


def test_the_csv_is_the_exact_motion_and_is_not_lost(tmp_path: Path) -> None:
    path = tmp_path / "truth.csv"
    assert RUNNER.invoke(app, ["checkcase", "pole", "--csv", str(path), "--rows", "5"]).exit_code == 0
    rows = list(csv.DictReader(path.read_text().splitlines()))
    assert [float(row["time_s"]) for row in rows] == [0, 10, 20, 30, 40]
    assert math.isclose(float(rows[1]["attitude_y"]), math.sqrt(0.5), rel_tol=1e-15)
    refused = RUNNER.invoke(app, ["checkcase", "pole", "--csv", str(path)])
    assert isinstance(refused.exception, kr.InputError)
    assert RUNNER.invoke(app, ["checkcase", "pole", "--csv", str(path), "--overwrite"]).exit_code == 0
    foreign = tmp_path / "mine.csv"
    foreign.write_text("t,wx\n0,1\n")
    assert RUNNER.invoke(app, ["checkcase", "pole", "--csv", str(foreign), "--overwrite"]).exit_code != 0
    assert foreign.read_text() == "t,wx\n0,1\n"


def test_the_picture_is_written(tmp_path: Path) -> None:
    path = tmp_path / "case.png"
    assert RUNNER.invoke(app, ["checkcase", "pole", "--figure", str(path)]).exit_code == 0
    assert path.read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize("name", ["small-box", "gyrostat", "in-water", "needle"])
def test_a_new_case_runs_and_is_right(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """By Kreisel's own methods, which the exact motion of the case does not use."""
    monkeypatch.chdir(tmp_path)
    assert RUNNER.invoke(app, ["new", "checkcase", name]).exit_code == 0
    grades = []
    monkeypatch.setattr("builtins.print", grades.append)
    runpy.run_path(f"{name.replace('-', '_')}.py")
    (grade,) = grades
    assert max(row.largest for row in grade.rows if row.quantity == "attitude") < 1e-9


def test_the_toml_of_a_new_case_has_the_same_state(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert RUNNER.invoke(app, ["new", "checkcase", "small-box"]).exit_code == 0
    assert RUNNER.invoke(app, ["run", "small-box.toml", "--set", "run.steps=10"]).exit_code == 0
    run = kr.open_run("small-box.zarr")
    case = kr.checkcases.case("small-box")
    truth = case.reference(run.time.values)
    inertia = np.array(case.given()["inertia"])
    assert np.allclose(run.M.values, truth.angular_velocity.values @ inertia, rtol=0, atol=1e-15)


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["checkcase", "brick"], "tumbling-brick"),
        (["checkcase", "--at", "1"], "expected the name of a case"),
        (["checkcase", "pole", "--at", "99"], "0 to 40 s"),
        (["checkcase", "pole", "--units", "rpm"], "--units: expected a trajectory to grade"),
        (["checkcase", "pole", "--csv", "pole.csv", "--step", "0.1"], "--step: expected a trajectory to grade"),
        (["new", "checkcase"], "checkcase NAME"),
        (["new", "checkcase", "libration"], "a case that is a system of Kreisel"),
        (["new", "lagrange-top", "pole"], "checkcase NAME"),
    ],
)
def test_mistakes_get_one_message(arguments: list[str], expected: str) -> None:
    result = RUNNER.invoke(app, arguments)
    assert isinstance(result.exception, kr.InputError)
    assert expected in str(result.exception)
