"""Ensembles of bodies: each lane is the run of its body; a bad lane is named."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import kreisel as kr
from kreisel import algebra
from kreisel.physical import (
    EddyCurrents,
    Ensemble,
    FreeBody,
    Gyroscope,
    HeavyBody,
    Orbit,
    Plate,
    Satellite,
    SubmergedBody,
    bdot,
)

MOMENTS = [(0.01, 0.02, 0.022), (0.012, 0.02, 0.025), (0.3, 0.2, 0.4)]
ORBITS = [Orbit.circular("500 km", "97 deg"), Orbit(7e6, 0.02, 0.9, 0.1, 0.2), Orbit.circular("700 km")]
DIPOLES = [(0.0, 0.0, 0.1), (0.02, 0.0, 0.0), (0.0, 0.3, 0.1)]
SPINS = np.array([[0.01, 0.02, 0.03], [0.0, -0.02, 0.01], [0.005, 0.0, 0.0]])
SETTINGS: dict[str, Any] = {"dt": "10 s", "t_end": "10 min", "every": "1 min", "progress": False}


def drag(Omega: Any, v: Any, *, k: Any) -> Any:
    return -k * Omega + 1e-12 * np.cross(v, Omega)


def spin_down(Omega: Any) -> Any:
    return -Omega


TENSORS = [np.diag(MOMENTS[0]), [[0.02, 0.001, 0.0], [0.001, 0.03, 0.002], [0.0, 0.002, 0.035]], np.diag(MOMENTS[2])]


def each_alone(many: Ensemble, settings: dict[str, Any], names: tuple[str, ...], **state: Any) -> Any:
    """The run of an ensemble, and the largest relative difference to the runs of its bodies."""
    run, worst = kr.simulate(many, many.state(**state), **settings), 0.0
    for lane, body in enumerate(many):
        alone = kr.simulate(body, body.state(**state), **settings)
        for name in names:
            worst = max(worst, float(abs(run[name].values[:, lane] - alone[name]).max() / abs(alone[name]).max()))
    return run, worst


def test_lanes_are_the_runs_of_the_bodies() -> None:
    each = {"inertia": TENSORS, "orbit": ORBITS, "magnetic_moment": DIPOLES}
    many = Satellite(torque=drag, params={"k": np.array([[0.0], [1e-4], [2e-4]])}, **each)
    names = ("momentum", "attitude", "angular_velocity", "position", "pitch")
    run, worst = each_alone(many, SETTINGS, names, spin=SPINS[0])
    assert worst < 1e-10
    assert abs(run.momentum[-1, 0] - run.momentum[-1, 1]).max() > 1e-5
    assert run.attrs["title"].startswith("3 of Satellite")
    assert many.inertia.shape == (3, 3, 3) and many[1].magnetic_moment[0] == 0.02
    spins = many.state(SPINS)
    assert np.allclose(algebra.axial(spins.M)[1] @ many.model().body_frame.axes[1].T, TENSORS[1] @ SPINS[1])


def test_lanes_differ_in_units_and_axes(tmp_path: Path) -> None:
    """In an archive too, whose rows are read when they are needed; lanes are selected by name."""
    many = Ensemble(FreeBody(inertia=TENSORS, mass=["1 kg", "2 kg", "3 kg"]), names=("a", "b", "c"))
    names = ("momentum", "attitude", "angular_velocity", "energy")
    run, worst = each_alone(many, {"dt": 0.05, "steps": 40, "progress": False}, names, spin=(0.3, 2.0, 0.1))
    assert worst < 1e-10 and list(run.lane.values) == ["a", "b", "c"]
    begun = run.momentum.isel(time=0).sel(lane="b").values
    assert np.allclose(begun, TENSORS[1] @ np.array([0.3, 2.0, 0.1]), rtol=1e-14)
    path = tmp_path / "run.zarr"
    kr.simulate(many, many.state((0.3, 2.0, 0.1)), dt=0.05, steps=40, progress=False, path=path)
    for name in names:
        chosen = kr.open_run(path)[name].isel(lane=[2, 1], time=slice(3, 9)).values
        assert np.array_equal(chosen, run[name].values[3:9, [2, 1]])
    again = kr.simulate(many[1], run.isel(time=20, lane=1), dt=0.05, steps=20, progress=False)
    assert np.allclose(again.momentum[-1], run.momentum[-1, 1], rtol=1e-12)
    motion = kr.propagator(many, dt=0.05)
    moved = motion.steps({"momentum": run.momentum.values[0]}, 40)
    assert np.allclose(moved["momentum"], run.momentum[-1], rtol=1e-12)


def test_tops_in_lanes() -> None:
    """Precession of fast tops, m g l/(I3 w3), each in its lane: the unit of time is common."""
    many = Gyroscope.flat(mass=[1.0, 2.0, 3.0], axial_moment=(["0.01 kg m^2"] * 3), lever=[0.1, 0.2, 0.15])
    state = many.state(tilt=np.radians([20.0, 30.0, 40.0]), spin="9000 rpm")
    run = kr.simulate(many, state, dt="1 ms", t_end="2 s", progress=False)
    rates = np.array([1.0, 2.0, 3.0]) * 9.80665 * np.array([0.1, 0.2, 0.15]) / (0.01 * 9000 * 2 * np.pi / 60)
    azimuth = np.unwrap(np.arctan2(run.axis[..., 1], run.axis[..., 0]), axis=0)
    assert np.allclose(azimuth[-1] / 2, rates, rtol=0.02)


def test_forces_along_the_axes_of_each_lane() -> None:
    many = HeavyBody(mass=[1.0, 2.0], inertia=TENSORS[:2], arm=(0.0, 0.01, 0.05), torque=lambda Omega: -1e-3 * Omega)
    settings = {"dt": 2e-3, "steps": 50, "progress": False}
    names = ("momentum", "up", "attitude", "energy")
    assert each_alone(many, settings, names, angular_velocity=(0.0, 1.0, 5.0))[1] < 1e-10


def test_bodies_in_water_in_lanes() -> None:
    many = SubmergedBody(
        mass=[20, 21], inertia=(0.4, 1.5, 1.6), center_of_mass=[(0.02, 0, -0.02), (0.01, 0.01, -0.03)],
        added_mass=(1.0, 18.0, 18.0, 0.0, 1.6, 1.6), quadratic_drag=[(1, 60, 60, 0.1, 5, 5), (2, 50, 60, 0.2, 5, 6)],
    )  # fmt: skip
    settings = {"dt": 0.02, "steps": 50, "progress": False}
    names = ("linear_momentum", "angular_momentum", "attitude")
    assert each_alone(many, settings, names, velocity=(1.5, 0.1, 0.0))[1] < 1e-10


def test_dates_air_and_plates_in_lanes() -> None:
    """The field and the Sun of each date, the air of all heights."""
    sides = [Plate(sign * axis, (0.01, 0, 0), 0.01 * (1 + sign / 2)) for axis in np.eye(3) for sign in (1, -1)]
    dates = ["2020-06-01", "2025-03-01", "2028-05-06"]
    orbits = [Orbit.circular(f"{300 + 100 * k} km", "97 deg", epoch=date) for k, date in enumerate(dates)]
    many = Satellite(
        MOMENTS[0], orbits, air="exponential", magnetic_field="tilted-dipole", plates=[sides, sides[::-1], sides]
    )
    run, worst = each_alone(many, SETTINGS, ("momentum", "field", "sun", "density"), spin=SPINS[0])
    assert worst < 1e-10 and (run.sun[0, 0] @ run.sun[0, 1]) < 0.5


def test_noise_differs_from_lane_to_lane() -> None:
    many = Satellite(MOMENTS, ORBITS[0], control=bdot(1e-6, every=10, noise={"field": 1e-6}))
    assert len(np.unique(many.state(SPINS)["generator"], axis=0)) == 3


def test_controllers_and_numbers_in_lanes() -> None:
    gains = [1e-5, 2e-5, 5e-5, 1e-4]
    many = Satellite(MOMENTS[0], ORBITS[0], control=[bdot(gain, every=10) for gain in gains])
    run = kr.simulate(many, many.state((0.02, 0.01, 0.03)), **{**SETTINGS, "t_end": "30 min"})
    left = np.linalg.norm(run.momentum[-1].values, axis=-1)
    assert (np.diff(left) < 0).all()


def test_one_attitude_is_for_all_of_four_lanes() -> None:
    """A quaternion has four entries too."""
    many = Satellite(MOMENTS[0], ORBITS[0], density=[0.0, 1e-12, 2e-12, 3e-12])
    assert many.density.tolist() == [0.0, 1e-12, 2e-12, 3e-12]
    start = many.state(attitude=(0.8, 0.0, 0.6, 0.0)).orientation
    assert start is not None and np.allclose(start, (0.8, 0.0, 0.6, 0.0), atol=1e-15) and start.shape == (4, 4)


BAD: dict[str, tuple[Any, str]] = {
    "a tensor": (lambda: Satellite([*TENSORS[:2], np.diag((1, 1, 3))], ORBITS[0]), "Lane 2: .*body"),
    "an orbit": (lambda: Satellite(TENSORS, [*ORBITS[:2], None]), "Lane 2: orbit"),
    "counts": (lambda: FreeBody(TENSORS[:2], mass=[1, 2, 3]), "2 of inertia, 3 of mass"),
    "plates": (
        lambda: Satellite(MOMENTS[0], ORBITS[0], plates=[[], [Plate((1, 0, 0), (0, 0, 0.1), 0.1)] * 2]),
        "Lane 1: expected plates",
    ),
    "a force": (
        lambda: Ensemble([Satellite(MOMENTS[0], ORBITS[0], torque=EddyCurrents(k)) for k in (1, 2)]),
        "Lane 1: expected the functions of lane 0",
    ),
    "a force by a closure": (
        lambda: Ensemble([FreeBody((1, 2, 2.5), torque=lambda Omega, k=k: -k * Omega) for k in (1, 2)]),
        "Lane 1: expected the functions of lane 0|params",
    ),
    "damping of one": (
        lambda: Ensemble([FreeBody((1, 2, 2.5), torque=spin_down), FreeBody((1, 2, 2.5), torque=spin_down, damping=1)]),
        "Lane 1: expected the functions of lane 0",
    ),
    "samples": (
        lambda: Satellite(MOMENTS[0], ORBITS[0], control=[bdot(1e-5, every=each) for each in (1, 2)]),
        "Lane 1: expected the functions of lane 0",
    ),
    "a kind": (
        lambda: Ensemble([Satellite(MOMENTS[0], ORBITS[0]), FreeBody((1, 2, 2.5))]),
        "Lane 1: expected a Satellite",
    ),
    "a matrix that is neither": (lambda: FreeBody([[1, 0.1, 0.2], [0.3, 2, 0], [0, 0, 2]]), "must be symmetric"),
    "names": (lambda: Ensemble([FreeBody((1, 2, 2.5))] * 2, names=["a", "a"]), "2 different names"),
    "no bodies": (lambda: Ensemble([]), "a list of bodies"),
}


def test_functions_that_do_the_same_are_functions_of_all_lanes() -> None:
    many = Ensemble([FreeBody((1, 2, 2.5), torque=each) for each in (lambda Omega: -Omega, lambda Omega: -Omega)])
    assert len(many) == 2


@pytest.mark.parametrize("case", BAD)
def test_a_bad_lane_is_named(case: str) -> None:
    make, message = BAD[case]
    with pytest.raises(kr.InputError, match=message):
        make()
