"""Every output of a body speaks of the axes in which it was given, against equations of motion in those axes.

The judges: Euler's equations with the whole tensor by DOP853, `scipy.spatial.transform`, `ccsds_ndm`, `csv`, h5netcdf.
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
import xarray as xr
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

import kreisel as kr
from kreisel import analysis, units
from kreisel.physical import Asteroid, Ellipsoid, FreeBody, Gyroscope, HeavyBody, Orbit, Satellite, SubmergedBody
from kreisel.record.units import BodyFrame
from kreisel.viewer.bodies import Body
from kreisel.viewer.scene import scene
from support import cross, rotation_matrix

TENSOR = np.array([[0.05, 0.01, -0.004], [0.01, 0.04, 0.006], [-0.004, 0.006, 0.03]])
RATE = np.deg2rad([5.0, -3.0, 2.0])
TYPED = np.array([0.8, 0.2, -0.4, 0.4])  # an attitude (w, x, y, z)
ROWS, LONG, SHORT = 30, 30.0, 3.0  # and seconds; short for motions that depend much on where they begin
ADDED = np.diag([0.4, 0.9, 0.6, 0.002, 0.004, 0.001])
CENTRE = np.array([0.02, -0.01, 0.015])
HEIGHT, MU = 7.0e6, 3.986004418e14
GRAVITY = 9.80665


def hat(v: np.ndarray) -> np.ndarray:
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


def moved(rate: Callable[[float, np.ndarray, np.ndarray], np.ndarray], seconds: float, more: Any = ()) -> Any:
    """Omega (k, 3) and the attitude (k, 4) at times, in the axes given; `rate` is that of (Omega, ...)."""

    def flow(t: float, y: np.ndarray) -> np.ndarray:
        w, x, y_, z = y[:4]
        p, q, r = y[4:7]
        turn = np.array(
            [-x * p - y_ * q - z * r, w * p + y_ * r - z * q, w * q + z * p - x * r, w * r + x * q - y_ * p]
        )
        return np.concatenate([turn / 2, rate(t, rotation_matrix(y[:4]), y[4:])])

    begun = np.concatenate([TYPED, RATE, more])
    times = np.linspace(0, seconds, ROWS + 1)
    found = solve_ivp(flow, (0, seconds), begun, "DOP853", times, rtol=1e-12, atol=1e-14)
    return found.y[4:7].T, found.y[:4].T / np.linalg.norm(found.y[:4].T, axis=-1, keepdims=True)


def euler(torque: Callable[[float, np.ndarray], np.ndarray], tensor: np.ndarray = TENSOR) -> Any:
    back = np.linalg.inv(tensor)
    return lambda t, g, w: back @ (cross(tensor @ w, w) + torque(t, g))


def free(t: float, g: np.ndarray) -> np.ndarray:
    return np.zeros(3)


def gravity_gradient(tensor: np.ndarray) -> Any:
    """3 mu/r^3 u x I u on a circular orbit in the plane of the first two axes."""
    n = np.sqrt(MU / HEIGHT**3)

    def torque(t: float, g: np.ndarray) -> np.ndarray:
        u = g.T @ np.array([np.cos(n * t), np.sin(n * t), 0.0])
        return np.asarray(3 * n * n * cross(u, tensor @ u))

    return torque


def swimming(t: float, g: np.ndarray, nu: np.ndarray) -> np.ndarray:
    """Kirchhoff's equations for (Omega, U) with the whole mass matrix about the centre of the body."""
    S = hat(CENTRE)
    A = ADDED + np.block([[np.eye(3), -S], [S, TENSOR - S @ S]])
    w, U = nu[:3], nu[3:]
    P, M = np.split(A @ np.concatenate([U, w]), 2)
    weight = GRAVITY * g.T @ np.array([0, 0, -1.0])
    rate = np.linalg.solve(A, np.concatenate([cross(P, w), cross(M, w) + cross(P, U) + cross(CENTRE, weight)]))
    return np.concatenate([rate[3:], rate[:3]])


class Case(NamedTuple):
    run: xr.Dataset
    Omega: np.ndarray
    attitude: np.ndarray
    momentum: np.ndarray  # at time 0, along the axes given
    body: Any


ORBIT = Orbit.circular(HEIGHT - 6_378_137.0)
TWELVE = 1e12


def simulated(body: Any, x0: Any, seconds: float, every: int = 10, **options: Any) -> xr.Dataset:
    """Rows at even times, in `every` steps each."""
    dt = body.dt(seconds / ROWS / every)
    return kr.simulate(body.model(), x0, dt=dt, steps=ROWS * every, every=every, **options)


@cache
def case(name: str) -> Case:
    if name == "free":
        body: Any = FreeBody(TENSOR, time_unit=2.0)
        want = moved(euler(free), LONG)
    elif name == "satellite":
        body = Satellite(TENSOR, ORBIT)
        want = moved(euler(gravity_gradient(TENSOR)), LONG)
    elif name == "asteroid":
        body = Asteroid(TENSOR * TWELVE, ORBIT)
        want = moved(euler(gravity_gradient(TENSOR)), LONG)
    elif name == "heavy":
        body = HeavyBody(1.0, TENSOR, CENTRE)
        want = moved(euler(lambda t, g: cross(CENTRE, GRAVITY * g.T @ np.array([0, 0, -1.0]))), SHORT)
        run = simulated(body, body.state(RATE, rotation_matrix(TYPED)[2]), SHORT, order=8, orientation=TYPED)
        return Case(run, *want, TENSOR @ RATE, body)
    else:
        body = SubmergedBody(1.0, TENSOR, ADDED, center_of_mass=CENTRE)
        want = moved(swimming, SHORT, np.zeros(3))
        x0 = body.state(angular_velocity=RATE, attitude=TYPED)
        run = simulated(body, x0, SHORT, 20, order=(8, 6, 4), orientation=body.orientation(TYPED))
        return Case(run, *want, np.full(3, np.nan), body)
    run = simulated(body, body.state(RATE), LONG, orientation=body.orientation(TYPED))
    return Case(run, *want, body.inertia @ RATE, body)


NAMES = ("free", "satellite", "asteroid", "submerged", "heavy")


def same(found: Any, want: Any, tolerance: float = 2e-8) -> bool:
    return bool(np.shape(found) == np.shape(want) and abs(np.asarray(found) - want).max() < tolerance)


def alike(q: Any, want: np.ndarray) -> bool:
    """Attitudes, in the first row with the sign that was typed and then without jumps."""
    q = np.asarray(q)
    return (
        same(q[0], TYPED, 1e-12)
        and (q[1:] * q[:-1]).sum(-1).min() > 0.9
        and same(abs((q * want).sum(-1)), 1 + 0 * q[:, 0])
    )


def of_csv(path: Path, *names: str) -> list[np.ndarray]:
    with path.open(newline="", encoding="utf-8") as file:
        heads, *lines = csv.reader(file)
    rows = [dict(zip([head.partition(" (")[0] for head in heads], line, strict=True)) for line in lines]
    width = {"g": 4}
    return [np.array([[float(row[f"{n}[{i}]"]) for i in range(width.get(n, 3))] for row in rows]) for n in names]


def outputs(run: xr.Dataset, want: Case, folder: Path) -> Iterator[tuple[str, bool]]:
    """Each output, and whether it is right."""
    from ccsds_ndm.ndm_io import NdmIo

    g, seconds = Rotation.from_quat(want.attitude, scalar_first=True), LONG if want.body.__class__ in SLOW else SHORT
    yield "angular_velocity", same(analysis.angular_velocity(run), want.Omega)
    yield "degrees at first", same(np.rad2deg(analysis.angular_velocity(run)[0]), np.array([5.0, -3.0, 2.0]), 1e-10)
    yield "quaternions", alike(analysis.quaternions(run), want.attitude)
    yield "rotations", same(analysis.rotations(run).as_matrix(), g.as_matrix())
    if want.body.__class__ is not HeavyBody:  # of a top the angles are those of its axis
        angles = analysis.euler_angles(run)
        turns = Rotation.from_euler("ZXZ", np.stack([angles.phi, angles.theta, angles.psi], -1)).as_matrix()
        yield "euler_angles", same(turns, g.as_matrix())
    kr.export(run, folder / "a.aem", epoch="2026-01-01", overwrite=True)
    segment = NdmIo().from_path(folder / "a.aem").body.segment[0]
    states = [s.quaternion_state for s in segment.data.attitude_state]
    rows = np.array([[float(getattr(s.quaternion, k)) for k in ("qc", "q1", "q2", "q3")] for s in states])
    yield "aem", alike(rows, want.attitude) and states[-1].epoch == f"2026-01-01T00:00:{seconds:09.6f}"
    (folder / "a.csv").unlink(missing_ok=True)
    kr.export(run, folder / "a.csv")
    M, q, Omega = of_csv(folder / "a.csv", "M", "g", "Omega")
    yield "csv attitude", alike(q, want.attitude)
    yield "csv rate", same(Omega, want.Omega) and same(np.rad2deg(Omega[0]), np.array([5.0, -3.0, 2.0]), 1e-10)
    if np.isfinite(want.momentum).all():
        yield "csv momentum", same(M[0] / np.linalg.norm(want.momentum), want.momentum / np.linalg.norm(want.momentum))
    for end in ("nc", "parquet"):
        kr.export(run, folder / f"a.{end}", overwrite=True)
    with xr.open_dataset(folder / "a.nc", engine="h5netcdf") as back:
        yield "netcdf", alike(back.g, want.attitude) and same(back.Omega, want.Omega) and back.Omega.units == "rad/s"
        yield "netcdf time", same(back.time, np.linspace(0, seconds, ROWS + 1), 1e-12)
    import pandas as pd

    table = pd.read_parquet(folder / "a.parquet")
    yield "parquet", same(table[[f"Omega[{i}]" for i in range(3)]].to_numpy(), want.Omega)
    si = units.measured(run)
    yield "measured", alike(si.g, want.attitude) and same(si.Omega, want.Omega)
    yield "picture", same(tip_in_picture(run), g.as_matrix() @ MARK, 2e-4)


SLOW = (FreeBody, Satellite, Asteroid)
MARK = np.array([0.36, 0.48, 0.8])  # a corner of a mesh


def tip_in_picture(run: xr.Dataset) -> np.ndarray:
    """Where the page puts a corner of a mesh at each row, in space."""
    import base64

    mesh = Body(np.array([MARK, [0.1, 0, 0], [0, 0.1, 0]]), np.array([[0, 1, 2]]), np.zeros(1, dtype=int))
    found = scene(run, body=mesh)
    (shown,) = found["bodies"]
    q = np.frombuffer(base64.b64decode(shown["turn"]), "<i2").reshape(-1, 4) / 32767
    corner = np.frombuffer(base64.b64decode(found["meshes"][0]["points"]), "<f4").reshape(-1, 3)[0]
    placed = Rotation.from_quat(q, scalar_first=True).as_matrix() @ (corner / np.linalg.norm(corner))
    return np.asarray(placed @ np.array(found["frame"]).T)


def skipped(monkeypatch: pytest.MonkeyPatch) -> None:
    """A mutant: nothing is turned from the axes of the state."""
    monkeypatch.setattr(BodyFrame, "_along", lambda self, v, matrix: v)
    monkeypatch.setattr(BodyFrame, "attitude", lambda self, g: g)


@pytest.mark.parametrize("name", NAMES)
def test_every_output_is_in_the_axes_given(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    want = case(name)
    assert [what for what, right in outputs(want.run, want, tmp_path) if not right] == []
    if name == "heavy":  # whose state is along the axes given
        return
    skipped(monkeypatch)
    passed = {what for what, right in outputs(want.run, want, tmp_path) if right}
    assert passed == {"netcdf time"}


def first_rate(run: xr.Dataset) -> np.ndarray:
    return np.asarray(np.rad2deg(analysis.angular_velocity(run)[0]))


DEGREES = np.array([5.0, -3.0, 2.0])


def test_bodies_without_products_of_inertia() -> None:
    """A gyroscope released with a spin about its axis alone; an ellipsoid in water."""
    wheel = Gyroscope.flat(3.0, 0.17, 0.15)
    run = kr.simulate(
        wheel.model(), wheel.state("40 deg", "20 rad/s"), dt=0.01, steps=2, orientation=wheel.orientation("40 deg")
    )
    assert same(analysis.angular_velocity(run)[0], np.array([0, 0, 20.0]), 1e-12)
    up = np.array([np.sin(np.deg2rad(40)), 0, np.cos(np.deg2rad(40))])
    assert same(analysis.angular_velocity(run, frame="space")[0], 20.0 * up, 1e-12)
    assert same(units.measured(run).omega[0], 20.0 * up, 1e-12)
    disc = Ellipsoid((0.15, 0.1, 0.05), 3.0, 998.2)
    run = kr.simulate(disc.model(), disc.state((0.1, 0, 0), RATE), dt=0.03, steps=2, order=4)
    assert same(first_rate(run), DEGREES, 1e-12) and units.measured(run).time[-1] == pytest.approx(0.06)


def test_what_is_drawn_of_a_body() -> None:
    """The ellipsoid of inertia, its long axis, and M on its sphere are along the axes given."""
    run, least = case("free").run, np.linalg.eigh(TENSOR)[1][:, 0]
    (shown,) = scene(run)["bodies"]
    assert abs(np.array(shown["axis"]) @ least) == pytest.approx(np.linalg.norm(shown["axis"]), rel=1e-12)
    (lines,) = [a.lines for a in kr.plot(run).axes if a.name == "3d"]
    (begun,) = [np.ravel(line.get_data_3d()) for line in lines if line.get_label() == "start"]
    assert same(begun / np.linalg.norm(begun), TENSOR @ RATE / np.linalg.norm(TENSOR @ RATE), 1e-12)


def test_the_axes_survive(tmp_path: Path) -> None:
    """Archives, resumed ones, rows and lanes, sweeps, forces, states at times."""
    body, path = case("free").body, tmp_path / "run.zarr"
    model, turned = body.model(), body.orientation(TYPED)
    first = {"orientation": turned, "dt": 0.05}
    kr.simulate(model, body.state(RATE), steps=4, path=path, **first)
    kr.resume(path, extend=8)
    many = kr.simulate(model, body.state([RATE, 2 * RATE]), steps=3, **first)
    held = kr.perturbed(model, torque=lambda M, *, k: -k * M, params={"k": 1e-3})
    own = tmp_path / "own.zarr"
    damped = kr.simulate(held, body.state(RATE), steps=3, path=own, **first)
    other = kr.perturbed(FreeBody(TENSOR).model(), torque=lambda M, *, k: -k * M, params={"k": 1e-3})
    with pytest.raises(kr.InputError, match="body of the run"):
        kr.resume(own, system=other, extend=5)
    damped = kr.resume(own, system=held, extend=5)
    runs = {
        "archive": kr.open_run(path),
        "rows": kr.open_run(path).isel(time=slice(0, 3)),
        "nearest": kr.open_run(path).sel(time=slice(0, 0.2)),
        "lane": many.isel(lane=0),
        "at": kr.at(model, body.state(RATE), [0.0, 1.0], orientation=turned),
    }
    for name, run in runs.items():
        assert same(first_rate(run), DEGREES, 1e-10), name
        assert same(analysis.quaternions(run)[0], TYPED, 1e-12), name
    assert kr.open_run(path).sizes["time"] == 9
    assert same(analysis.angular_velocity(many)[0], np.array([RATE, 2 * RATE]), 1e-14)
    assert same(units.measured(many).Omega[0], np.array([RATE, 2 * RATE]), 1e-14)
    assert same(np.rad2deg(analysis.angular_velocity(damped, held)[0]), DEGREES, 1e-10)
    assert same(analysis.quaternions(damped)[0], TYPED, 1e-12)
    design = kr.Design(grid={"state.M[0]": [0.0, 1e-3]})
    swept = kr.sweep(
        model, body.state(RATE), design, path=tmp_path / "s.zarr", workers=0, steps=3, save=["trajectories"], **first
    )
    one = kr.open_run(tmp_path / "s.zarr").isel(lane=1)
    assert same(analysis.quaternions(one)[0], TYPED, 1e-12) and swept.attrs["body"] == many.attrs["body"]
    kr.export(tmp_path / "s.zarr", tmp_path / "s.csv")
    (q,) = of_csv(tmp_path / "s.csv", "g")
    assert same(q[0], TYPED, 1e-12) and same(q[1], TYPED, 1e-12)


def test_a_sweep_is_exported_in_si(tmp_path: Path) -> None:
    """The momentum I Omega and the energy Omega I Omega/2 at the start, of a body with another unit of time."""
    body, energy = case("free").body, np.full(2, RATE @ TENSOR @ RATE / 2)
    state = body.state(RATE)
    design = kr.Design(grid={"state.M[0]": [float(state.axial.M[0])] * 2})
    save = ["trajectories", "drift", "extremes", "frequencies"]
    made: Any = {"path": tmp_path / "s.zarr", "workers": 0, "steps": 32, "dt": 0.1, "save": save}
    swept = kr.sweep(body.model(), state, design, orientation=body.orientation(TYPED), **made)
    kr.export(swept, tmp_path / "s.nc")
    with xr.open_dataset(tmp_path / "s.nc", engine="h5netcdf") as si:
        assert same(si.M[0], np.array(2 * [TENSOR @ RATE]), 1e-14) and si.M.units == "kg m^2/s" and si.M.axes == "body"
        assert same(si.energy[0], energy, 1e-14) and same(si.energy_start, energy, 1e-14)
        assert si.energy_start.units == si.energy_drift.units == "J" and si.M_frequency.units == "rad/s"
        principal = TENSOR @ RATE @ body.principal.axes
        near = (si.M_min <= principal + 1e-12) & (principal - 1e-12 <= si.M_max)
        assert near.all() and si.M_max.units == "kg m^2/s" and si.M_max.axes == si.M_frequency.axes == "state"
        assert "kreisel_sweep" in si.attrs


def test_models_of_the_same_moments_have_axes_of_their_own() -> None:
    """Kernels are kept by parameters; axes are not among them."""
    moments, axes = np.linalg.eigh(TENSOR)
    for turn in (axes, axes[:, [1, 2, 0]], np.eye(3)):
        body = FreeBody(turn @ np.diag(moments) @ turn.T)
        run = kr.simulate(body.model(), body.state(RATE), dt=0.1, steps=1, orientation=body.orientation(TYPED))
        assert same(first_rate(run), DEGREES, 1e-10) and same(analysis.quaternions(run)[0], TYPED, 1e-12)


def test_nothing_is_turned_twice() -> None:
    """Variables state their axes and units; arrays are those of a state."""
    want, other = case("free"), case("satellite")
    si = units.measured(want.run)
    for M in (want.run.M, want.run.M.values, si.M):
        assert same(want.body.angular_velocity(M), want.Omega)
    for M in (other.run.M, other.run.M.values, units.measured(other.run).M):
        assert same(other.body.angular_velocity(M), other.Omega)
        assert same(other.body.body.angular_velocity(M), other.Omega)
    assert same(want.body.angular_velocity(other.run.M), other.Omega)  # in kg m^2/s, as it says
    for g in (want.run.g, want.run.g.values, si.g):
        assert same(abs((want.body.attitude(g) * want.attitude).sum(-1)), np.ones(ROWS + 1))
    assert same(analysis.quaternions(si), analysis.quaternions(want.run), 1e-15)
    for read in (analysis.angular_velocity, units.measured, kr.plot):
        with pytest.raises(kr.InputError):
            read(si)
    for case_ in (want, other):
        with pytest.raises(kr.InputError, match=r"row of units\.measured"):
            kr.simulate(case_.body.model(), units.measured(case_.run).isel(time=-1), dt=0.1, steps=1)
        kr.simulate(case_.body.model(), case_.run.isel(time=0), dt=0.1, steps=1, orientation=TYPED)


def test_a_fit_of_rates_in_the_axes_given() -> None:
    """Rates by Euler's equations, in rad/s and seconds: the momentum comes back, along the axes of the state."""
    pytest.importorskip("jax")
    want = case("free")
    Omega = xr.DataArray(want.Omega[:9], dims=("time", "axis"), attrs={"units": "rad/s"})
    time = xr.DataArray(np.linspace(0, 8, 9), dims="time", attrs={"units": "s"})
    stars = xr.DataArray(want.attitude[:9], dims=("time", "quaternion"))
    data = xr.Dataset({"Omega": Omega, "g": stars}, {"time": time})
    begun = {"M": 1.05 * want.body.state(RATE).axial.M}
    asked: dict[str, Any] = {"free": ["M"], "x0": begun, "dt": want.body.dt(0.5)}
    asked["orientation"] = want.body.orientation(TYPED)
    found = kr.fit(want.body.model(), data, **asked)
    assert same(found.state.axial.M, want.body.state(RATE).axial.M, 1e-7) and found.chi2 < 1e-12
    assert same(first_rate(found.run), DEGREES, 1e-5) and "along the axes of the state" in repr(found)
    axes = np.linalg.eigh(TENSOR)[1]
    along_principal = data.assign(Omega=data.Omega.copy(data=data.Omega.values @ axes))
    assert kr.fit(want.body.model(), along_principal, **asked).chi2 > 1e-4
    degrees = data.assign(Omega=np.rad2deg(Omega).assign_attrs(units="deg/s"))
    degrees = degrees.assign_coords(time=(1000 * time).assign_attrs(units="ms"))
    assert same(kr.fit(want.body.model(), degrees, **asked).state.axial.M, found.state.axial.M, 1e-7)
    unnamed = data.assign(Omega=np.rad2deg(Omega).drop_attrs(), sigma_Omega=1e-3, sigma_g=1e-2)
    with pytest.warns(kr.InputWarning, match="other units"):
        kr.fit(want.body.model(), unnamed, **asked)
    with pytest.raises(kr.InputError, match="dimension of rad/s"):
        kr.fit(want.body.model(), data.assign(Omega=Omega.assign_attrs(units="m/s")), **asked)


def test_an_impulse_in_the_axes_given() -> None:
    """I (Omega after - Omega before) = J, with J taken to the axes of the state as units.md says."""
    body, J = case("satellite").body, np.array([1e-3, -2e-3, 3e-4])
    asked: dict[str, Any] = {"dt": 0.1, "steps": 1, "orientation": body.orientation(TYPED)}
    impulse = {"time": 0.1, "M": J @ body.body.principal.axes}
    runs = [kr.simulate(body.model(), body.state(RATE), **asked, **more) for more in ({}, {"impulses": impulse})]
    before, after = (analysis.angular_velocity(run)[1].values for run in runs)
    assert same(TENSOR @ (after - before), J, 1e-14)


def test_bodies_by_name() -> None:
    """A satellite by its moments is in principal axes; a submerged body is given in any axes."""
    moments = np.linalg.eigvalsh(TENSOR)
    model = kr.bodies.find("satellite")(moments=moments, semi_major_axis=HEIGHT)
    run = kr.simulate(model, {"M": moments * RATE}, dt=0.1, steps=1, orientation=TYPED)
    assert same(first_rate(run), DEGREES, 1e-12) and same(analysis.quaternions(run)[0], TYPED, 1e-15)
    body = case("submerged").body
    named = kr.bodies.find("submerged-body")(**body.model().params)
    run = kr.simulate(
        named, body.state(angular_velocity=RATE), dt=0.1, steps=1, orientation=body.orientation(TYPED), order=(8, 6, 4)
    )
    assert same(first_rate(run), DEGREES, 1e-10) and same(analysis.quaternions(run)[0], TYPED, 1e-12)


def test_a_plain_system_has_no_body() -> None:
    run = kr.simulate(kr.EulerTop(J=(1, 2, 3)), {"M": (1, 2, 0.3)}, dt=0.1, steps=2, orientation=TYPED)
    assert "body" not in run.attrs and "axes" not in run.M.attrs and run.time.units == "1"
    assert analysis.angular_velocity(run).units == "1"


def test_damaged_axes_are_refused() -> None:
    run = case("free").run
    for text in ("{}", "[1]", "?", run.attrs["body"].replace("[[", "[[1"), '{"axes": [[1]], "along": [], "units": {}}'):
        with pytest.raises(kr.InputError, match="attribute body"):
            analysis.quaternions(run.assign_attrs(body=text))
