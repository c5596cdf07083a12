"""The FMU of a free body: validated, run and compiled by FMPy, against SciPy's solution of Euler's equations."""

from __future__ import annotations

import io
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import kreisel as kr
from kreisel.languages.source import fmu
from support import cross

fmpy = pytest.importorskip("fmpy")
TENSOR = np.array([[2.0, 0.3, -0.2], [0.3, 3.0, 0.4], [-0.2, 0.4, 4.0]])  # kg m^2
TORQUE, RATE, ATTITUDE = np.array([0.2, -0.1, 0.3]), np.array([0.3, 2.0, 0.5]), np.array([0.5, 0.5, -0.1, 0.7])
TIME = 2.0  # s
START = {
    **{f"torque.{k}": x for k, x in zip("xyz", TORQUE, strict=True)},
    **{f"angular_velocity.{k}": x for k, x in zip("xyz", RATE, strict=True)},
    **{f"attitude.{k}": x for k, x in zip("wxyz", ATTITUDE, strict=True)},
}


@pytest.fixture(scope="module")
def archive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("fmu") / "rock.fmu"
    text = kr.code(kr.physical.FreeBody(TENSOR), name="rock")
    path.write_bytes(fmu("rock", text, TENSOR, 1e-3))
    return path


def simulated(archive: Path, **start: Any) -> np.ndarray:
    """Attitude and angular velocity at the end."""
    run = fmpy.simulate_fmu(str(archive), start_values=START | start, stop_time=TIME, output_interval=0.05)
    return np.array(run[-1].tolist())[1:]


def solution() -> np.ndarray:
    """Euler's equations by DOP853."""

    def rates(t: float, y: Any) -> Any:
        q, w = y[:4], y[4:]
        turned = [-q[1:] @ w / 2, *(q[0] * w + cross(q[1:], w)) / 2]
        return [*turned, *np.linalg.solve(TENSOR, TORQUE - cross(w, TENSOR @ w))]

    return solve_ivp(rates, (0, TIME), [*ATTITUDE, *RATE], method="DOP853", rtol=1e-12, atol=1e-13).y[:, -1]


def test_it_is_valid_and_reproducible(archive: Path) -> None:
    from fmpy.validation import validate_fmu

    assert validate_fmu(str(archive)) == []
    described = fmpy.read_model_description(str(archive))
    units = {v.name: v.unit for v in described.modelVariables}
    assert units["torque.x"] == "N.m" and units["angular_velocity.z"] == "rad/s" and units["inertia.yz"] == "kg.m2"
    bases = {u.name: u.baseUnit for u in described.unitDefinitions}
    assert (bases["N.m"].kg, bases["N.m"].m, bases["N.m"].s) == (1, 2, -2)
    text = kr.code(kr.physical.FreeBody(TENSOR), name="rock")
    assert fmu("rock", text, TENSOR, 1e-3) == archive.read_bytes()
    with zipfile.ZipFile(archive) as z:
        assert "sources/rock.c" in z.namelist()


def test_a_constant_torque_is_of_second_order_in_the_step(archive: Path) -> None:
    wanted = solution()
    coarse, fine = (np.abs(simulated(archive, step=step) - wanted).max() for step in (0.01, 0.005))
    assert coarse < 1e-5 and abs(np.log2(coarse / fine) - 2) < 0.05
    assert np.abs(simulated(archive, step=0.01, **{"inertia.yz": 0.5}) - wanted).max() > 1e-3


def test_without_torque_a_step_is_the_closed_form(archive: Path) -> None:
    still = dict.fromkeys(("torque.x", "torque.y", "torque.z"), 0.0)
    body = kr.physical.FreeBody(TENSOR)
    later = kr.at(body.model(), body.state(RATE), [body.dt(TIME)], orientation=body.orientation(ATTITUDE))
    wanted = np.concatenate([body.attitude(later.g.values[0]), body.angular_velocity(later.M.values[0])])
    got = simulated(archive, step=0.05, **still)
    assert (
        min(np.abs(got - sign * wanted).max() for sign in (np.array([1.0] * 7), np.array([-1.0] * 4 + [1] * 3))) < 1e-12
    )


def test_it_passes_a_check_case(archive: Path) -> None:
    """With the tensor of the case, products of inertia included."""
    case = kr.checkcases.case("tilted-box")
    given = case.given()
    tensor, start = np.array(given["inertia"]), {}
    for j, row in enumerate("xyz"):
        start |= {f"torque.{row}": 0.0, f"angular_velocity.{row}": given["angular_velocity"][j]}
        start |= {
            f"inertia.{row}{column}": tensor[j, k] for k, column in enumerate("xyz") if k >= j and row + column != "xz"
        }
    start |= {f"attitude.{k}": x for k, x in zip("wxyz", given["attitude"], strict=True)}
    start |= {"inertia.zx": tensor[2, 0], "step": 0.05}
    run = fmpy.simulate_fmu(str(archive), start_values=start, stop_time=given["duration"], output_interval=5.0)
    table = np.array(run.tolist())
    assert len(table) == 13
    assert case.grade(table[:, 0], attitude=table[:, 1:5], angular_velocity=table[:, 5:]).relative < 1e-11


@pytest.mark.parametrize(
    ("start", "words"),
    [
        ({"inertia.xx": 9.0}, "larger than the sum of the two others"),
        ({"step": 0.0}, "the time step dt is finite and not 0"),
        ({"step": -0.1}, "step: expected a time > 0"),
        ({"attitude.w": 0.9}, "expected a unit quaternion"),
        ({"step": 0.05, "angular_velocity.x": 1e4}, "decrease `step`"),
        ({"torque.x": float("nan")}, "expected a finite number"),
    ],
)
def test_bad_input_ends_with_a_message(
    start: Any, words: str, archive: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(Exception, match="status 3"):
        simulated(archive, **start)
    assert words in capfd.readouterr().out


def test_a_state_is_restored(archive: Path) -> None:
    """fmi3GetFMUState and fmi3SetFMUState, which masters of co-simulation use to repeat a step."""
    from fmpy.fmi3 import FMU3Slave

    described = fmpy.read_model_description(str(archive))
    folder = fmpy.extract(str(archive))
    names = {v.name: v.valueReference for v in described.modelVariables}
    body = FMU3Slave(
        guid=described.guid, unzipDirectory=folder, instanceName="one",
        modelIdentifier=described.coSimulation.modelIdentifier,
    )  # fmt: skip
    outputs = [names[f"attitude.{k}"] for k in "wxyz"]
    try:
        body.instantiate()
        body.setFloat64([names[k] for k in START], list(START.values()))
        body.enterInitializationMode()
        body.exitInitializationMode()
        saved = body.getFMUState()
        ends = []
        for _ in range(2):
            body.doStep(currentCommunicationPoint=0.0, communicationStepSize=0.5)
            ends.append(body.getFloat64(outputs))
            body.setFMUState(saved)
        body.freeFMUState(saved)
        body.terminate()
    finally:
        body.freeInstance()
        shutil.rmtree(folder, ignore_errors=True)
    assert ends[0] == ends[1] and np.abs(np.array(ends[0]) - ATTITUDE).max() > 0.1


def test_the_command_writes_the_archive(tmp_path: Path) -> None:
    words = [sys.executable, "-m", "kreisel", "code", "free-body", "--set", "I=1,2,2.5", "--language", "fmu"]
    done = subprocess.run(words, capture_output=True, cwd=tmp_path, timeout=300, check=True)
    with zipfile.ZipFile(io.BytesIO(done.stdout)) as z:
        assert b'start="2.5"' in z.read("modelDescription.xml")
