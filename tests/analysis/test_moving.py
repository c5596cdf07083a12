"""kr.analysis: angular velocities, paths of bodies in a fluid, attitude messages."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

import kreisel as kr
from kreisel import algebra

START = {"M": np.array([0.3, -0.4, 1.2]), "P": np.array([0.5, 0.2, 0.9])}
ELLIPSOID = kr.Kirchhoff(C=[[0, 0.5, 0.8], [0.5, 0, 1.2], [0.8, 1.2, 0]], B=(-0.9, -0.7, -0.4))
BODIES = {
    "revolution": (kr.KirchhoffRevolution(a1=1.3, a3=0.4, c1=0.9, c3=0.25), {"method": "exact"}),
    "ellipsoid": (ELLIPSOID, {"method": "variational", "order": 8}),
    "mixed terms": (kr.KirchhoffCase(a1=1, a3=1.4, b1=0.2, b3=0.5, c1=0.3, c3=0.9), {"method": "dop853"}),
}


def solved(model: Any, start: dict[str, Any], times: np.ndarray) -> np.ndarray:
    """The positions by a Runge-Kutta method on (M, P, g, x)."""

    def rate(_: float, y: np.ndarray) -> np.ndarray:
        M, P, g = algebra.hat(y[:3]), y[3:6], y[6:15].reshape(3, 3)
        dM, dP = model.flow(M, P)
        Omega, U = (model.call(f, M, P) for f in (model.system.velocity, model.system.translation))
        return np.concatenate([algebra.axial(dM), dP, (g @ Omega).ravel(), g @ U])

    begin = np.concatenate([start["M"], start["P"], np.eye(3).ravel(), np.zeros(3)])
    found = solve_ivp(rate, (0, times[-1]), begin, method="DOP853", rtol=1e-11, atol=1e-12, t_eval=times)
    return np.asarray(found.y[15:].T)


def run_of(model: Any, start: dict[str, Any] = START, **options: Any) -> Any:
    asked = {"dt": 0.05, "steps": 200, "orientation": (1, 0, 0, 0), "progress": False}
    return kr.simulate(model, start, **(asked | options))


@pytest.mark.parametrize("name", BODIES)
def test_path(name: str) -> None:
    """Against a solver; the momenta in space are constant where the states are exact."""
    model, options = BODIES[name]
    run = run_of(model, **options)
    x = kr.analysis.path(run)
    assert x.dims == ("time", "axis")
    assert abs(x.values - solved(model, START, run.time.values)).max() < 1e-6 * abs(x.values).max()
    if name == "revolution":
        g, M = algebra.rotation_matrix(run.g.values), algebra.hat(run.M.values)
        momentum = g @ M @ g.mT - algebra.wedge(x.values, START["P"] + 0 * x.values)
        assert abs(momentum - momentum[0]).max() < 1e-13 * abs(x.values).max()


MAPS = {
    "baecklund": (BODIES["revolution"][0], {"method": "baecklund", "order": 2}),
    "suris": (BODIES["revolution"][0], {"method": "suris", "order": 1}),
    "clebsch": (kr.Clebsch(b=(-0.9, -0.6, -0.25)), {"method": "baecklund", "order": 2}),
    "variational": (ELLIPSOID, {"method": "variational", "order": 2}),
}


@pytest.mark.parametrize("name", MAPS)
def test_momenta_in_space_of_a_map(name: str) -> None:
    """Of its own orientation and path, for steps so long that the state is off: p = g P and g M g^T - x ^ p."""
    model, options = MAPS[name]
    run = run_of(model, dt=0.2, steps=2000, every=10, **options)
    x, g, M = kr.analysis.path(run).values, algebra.rotation_matrix(run.g.values), algebra.hat(run.M.values)

    def change(g: np.ndarray) -> tuple[float, float]:
        p = algebra.act(g, run.P.values)
        m = g @ M @ g.mT - algebra.wedge(x, p)
        return float(abs(p - p[0]).max()), float(abs(m - m[0]).max() / abs(x).max())

    assert max(change(g)) < 1e-12
    assert min(change(np.roll(g, 1, 0))) > 1e-3  # the mutant: an orientation of another row


def test_path_does_not_depend_on_the_rows() -> None:
    model, options = BODIES["revolution"]
    fine, *others = (kr.analysis.path(run_of(model, **options, every=every)) for every in (1, 20, 200))
    for every, coarse in zip((20, 200), others, strict=True):
        assert abs(fine.values[::every] - coarse.values).max() < 1e-13 * abs(fine.values).max()


def test_compiled_steps_are_those_of_the_arrays(monkeypatch: pytest.MonkeyPatch) -> None:
    driven = kr.perturbed(BODIES["revolution"][0], torque=lambda M: -0.1 * M)
    run = run_of(driven, dt=0.02, steps=500, every=50)
    compiled = kr.analysis.path(run, driven).values
    monkeypatch.setattr(sys.modules["kreisel.analysis.events"], "FASTER", 2)
    assert abs(kr.analysis.path(run, driven).values - compiled).max() < 1e-13 * abs(compiled).max()


def test_an_impulse_between_rows_is_refused() -> None:
    """The flow from the row before does not lead to the next one."""
    driven = kr.perturbed(BODIES["revolution"][0], torque=lambda M: -0.1 * M)
    run = run_of(driven, dt=0.02, steps=500, every=50, impulses={"time": 0.5, "P": (0.0, 1.0, 0.0)})
    with pytest.raises(kr.InputError, match="an impulse or an action between two rows"):
        kr.analysis.path(run, driven)
    with pytest.raises(kr.InputError, match="an impulse or an action between two rows"):
        kr.analysis.events(run.isel(time=[0, 1]), "P[1]", float(run.P[:2, 1].mean()), system=driven)


def test_path_of_lanes_and_its_start() -> None:
    speeds = np.array([0.9, 0.5])
    together = run_of(kr.KirchhoffRevolution(a1=1.3, a3=0.4, c1=speeds, c3=0.25))
    x = kr.analysis.path(together, start=(1.0, 2.0, 3.0))
    assert x.dims == ("time", "lane", "axis")
    for lane, c1 in enumerate(speeds):
        alone = kr.analysis.path(run_of(kr.KirchhoffRevolution(a1=1.3, a3=0.4, c1=c1, c3=0.25)))
        assert abs(x.values[:, lane] - [1, 2, 3] - alone.values).max() < 1e-12


def test_path_in_four_dimensions_and_under_a_torque() -> None:
    draw = np.random.default_rng(2)
    X = draw.normal(size=(4, 4))
    body, start = kr.Clebsch(b=(-0.3, -0.5, -0.9, -1.1)), {"M": X - X.T, "P": draw.normal(size=4)}
    run = run_of(body, start, orientation=np.eye(4), order=8)
    x, g = kr.analysis.path(run).values, run.g.values
    momentum = g @ run.M.values @ g.mT - algebra.wedge(x, start["P"] + 0 * x)
    assert abs(momentum - momentum[0]).max() < 1e-12 * abs(x).max()

    driven = kr.perturbed(BODIES["revolution"][0], torque=lambda M: -0.1 * M)
    slow = run_of(driven, dt=0.02, steps=500)
    assert abs(kr.analysis.path(slow, driven).values - solved(driven, START, slow.time.values)).max() < 1e-6


def test_a_body_without_momentum_rests() -> None:
    run = run_of(ELLIPSOID, {"M": START["M"], "P": (0, 0, 0)})
    assert not kr.analysis.path(run).values.any()


@pytest.mark.parametrize(
    "model", [kr.LagrangeTop(p=(0, 0, 1), alpha=0.6), kr.LagrangeTopMoving(A=(0, 0, 1), alpha=0.6)]
)
def test_angular_velocity(model: Any) -> None:
    """omega by differences of the orientation, in both frames."""
    letters = model.system.space.letters
    run = run_of(model, dict(zip(letters, ((0.1, 0.2, 1.5), (0.6, 0, 0.8)), strict=True)), dt=1e-3)
    g = Rotation.from_quat(run.g.values, scalar_first=True)
    middle = (g[2:] * g[:-2].inv()).as_rotvec() / 2e-3
    inside = (g[:-2].inv() * g[2:]).as_rotvec() / 2e-3
    assert abs(kr.analysis.angular_velocity(run, frame="space").values[1:-1] - middle).max() < 1e-5
    assert abs(kr.analysis.angular_velocity(run).values[1:-1] - inside).max() < 1e-5


def test_angular_velocity_in_four_dimensions() -> None:
    top = kr.LagrangeTopMoving(A=(0, 0, 0, 1), alpha=0.5)
    X = np.triu(np.arange(16.0).reshape(4, 4) / 10, 1)
    run = kr.simulate(top, {"M": X - X.T, "P": (0.6, 0, 0, 0.8)}, dt=0.1, steps=3, progress=False)
    found = kr.analysis.angular_velocity(run)
    assert found.dims == ("time", "row", "column")
    assert abs(found.values - top.call(top.system.velocity, run.M.values, run.P.values)).max() == 0


def test_orientation_from_scipy() -> None:
    turn = Rotation.from_euler("zyx", [0.3, -0.5, 1.1])
    run = run_of(ELLIPSOID, orientation=turn, steps=1)
    assert abs(kr.analysis.rotations(run)[0].as_matrix() - turn.as_matrix()).max() < 1e-15


def test_attitude_message(tmp_path: Path) -> None:
    """The header of the standard, and its matrix, which takes components in space to those along the body."""
    run = run_of(BODIES["revolution"][0], steps=3)
    out = tmp_path / "body.aem"
    kr.export(run, out, epoch="2026-01-01T00:00:00", name="DISC", time_unit=10.0)
    lines = out.read_text(encoding="ascii").splitlines()
    assert lines[0] == "CCSDS_AEM_VERS = 1.0"
    assert {"OBJECT_NAME = DISC", "ATTITUDE_DIR = A2B", "QUATERNION_TYPE = LAST"} < set(lines)
    rows = [line.split() for line in lines[lines.index("DATA_START") + 1 : lines.index("DATA_STOP")]]
    assert len(rows) == 4
    assert rows[3][0] == "2026-01-01T00:00:01.500000"
    q1, q2, q3, qc = map(float, rows[3][1:])
    first_row = [q1 * q1 - q2 * q2 - q3 * q3 + qc * qc, 2 * (q1 * q2 + q3 * qc), 2 * (q1 * q3 - q2 * qc)]
    assert np.allclose(first_row, algebra.rotation_matrix(run.g.values[3]).T[0], atol=1e-15)
    with pytest.raises(kr.InputError, match="exists already"):
        kr.export(run, out, epoch="2026-01-01")
    kr.export(run, out, epoch="2026-01-01", overwrite=True)


def test_attitude_message_has_its_date_of_creation(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The clock, or the variable of reproducible-builds.org; `date -u -d @1700000000`."""
    run, out = run_of(BODIES["revolution"][0], steps=1), tmp_path / "body.aem"

    def created() -> str:
        kr.export(run, out, epoch="2001-01-01", overwrite=True)
        return next(line for line in out.read_text(encoding="ascii").splitlines() if line.startswith("CREATION_DATE"))

    monkeypatch.delenv("SOURCE_DATE_EPOCH", raising=False)
    made = np.datetime64(created().removeprefix("CREATION_DATE = "))
    assert abs(made - np.datetime64("now")) < np.timedelta64(60, "s")
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1700000000")
    assert created() == "CREATION_DATE = 2023-11-14T22:13:20"
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "soon")
    with pytest.raises(kr.InputError, match="SOURCE_DATE_EPOCH: expected seconds"):
        created()


def test_attitude_message_from_the_command_line(tmp_path: Path, kreisel: Any) -> None:
    archive, out = tmp_path / "body.zarr", tmp_path / "body.aem"
    run_of(BODIES["revolution"][0], steps=3, path=archive)
    command = "export", str(archive), str(out)
    assert "epoch: expected the date of time 0" in kreisel(*command).stderr
    assert kreisel(*command, "--epoch", "2026-01-01").returncode == 0
    assert out.read_text(encoding="ascii").count("2026-01-01T00:00:00.") == 6  # two in the header, four rows
    other = kreisel(*command[:-1], str(tmp_path / "b.csv"), "--epoch", "2026-01-01")
    assert other.returncode == 2
    assert "ends in .aem" in other.stderr


BAD = {
    "top": (lambda: kr.analysis.path(run_of(kr.EulerTop(J=(1, 2, 3)), {"M": (1, 2, 3)})), "only rotates"),
    "no orientation": (lambda: kr.analysis.path(run_of(ELLIPSOID, orientation=None)), "no orientation"),
    "start": (lambda: kr.analysis.path(run_of(ELLIPSOID), start=(1, 2)), "start: expected 3 values"),
    "nan": (lambda: kr.analysis.path(run_of(ELLIPSOID), start=(1, 2, np.nan)), "finite"),
    "frame": (lambda: kr.analysis.angular_velocity(run_of(ELLIPSOID), frame="orbit"), "'body' or 'space'"),
    "other frame": (
        lambda: kr.analysis.angular_velocity(run_of(ELLIPSOID, orientation=None), frame="space"),
        "no orientation",
    ),
    "epoch": (lambda: kr.export(run_of(ELLIPSOID), "x.aem", epoch="soon"), "epoch: expected the date"),
    "suffix": (lambda: kr.export(run_of(ELLIPSOID), "x.txt", epoch="2026-01-01"), "must end in .*.aem"),
    "name": (lambda: kr.export(run_of(ELLIPSOID), "x.aem", epoch="2026-01-01", name="a\nb"), "a word"),
    "lanes": (
        lambda: kr.export(
            run_of(kr.Clebsch(b=xr.DataArray(np.eye(3) - 2, dims=("lane", "axis")))), "x.aem", epoch="2026-01-01"
        ),
        "several lanes",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_input(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    call, words = BAD[name]
    with pytest.raises(kr.InputError, match=words):
        call()
