"""Ensembles of bodies: each lane is the run of its body; a bad lane is named."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import kreisel as kr
from kreisel.physical import EddyCurrents, Ensemble, FreeBody, Orbit, Plate, Satellite, bdot

MOMENTS = [(0.01, 0.02, 0.022), (0.012, 0.02, 0.025), (0.3, 0.2, 0.4)]
ORBITS = [Orbit.circular("500 km", "97 deg"), Orbit(7e6, 0.02, 0.9, 0.1, 0.2), Orbit.circular("700 km")]
DIPOLES = [(0.0, 0.0, 0.1), (0.02, 0.0, 0.0), (0.0, 0.3, 0.1)]
SPINS = np.array([[0.01, 0.02, 0.03], [0.0, -0.02, 0.01], [0.005, 0.0, 0.0]])
SETTINGS: dict[str, Any] = {"dt": "10 s", "t_end": "10 min", "every": "1 min", "progress": False}


def drag(Omega: Any, v: Any, *, k: Any) -> Any:
    return -k * Omega + 1e-12 * np.cross(v, Omega)


def spin_down(Omega: Any) -> Any:
    return -Omega


def test_lanes_are_the_runs_of_the_bodies() -> None:
    each = {
        "inertia": MOMENTS,
        "orbit": ORBITS,
        "magnetic_moment": DIPOLES,
        "params": [{"k": k} for k in (0, 1e-4, 2e-4)],
    }
    many = Ensemble.of(Satellite, 3, torque=drag, **each)
    run = kr.simulate(many, many.state(SPINS), **SETTINGS)
    for lane, body in enumerate(many.bodies):
        alone = kr.simulate(body, body.state(SPINS[lane]), **SETTINGS)
        for name in ("momentum", "attitude", "angular_velocity", "energy", "position", "pitch"):
            close = np.allclose(run[name].values[:, lane], alone[name].values, rtol=1e-12, atol=1e-14)
            assert close, (name, lane)
    assert abs(run.momentum[-1, 0] - run.momentum[-1, 1]).max() > 1e-5
    assert run.attrs["title"].startswith("3 of Satellite")


def test_controllers_and_numbers_in_lanes() -> None:
    gains = [1e-5, 2e-5, 5e-5, 1e-4]
    many = Ensemble.of(
        Satellite, 4, inertia=MOMENTS[0], orbit=ORBITS[0], control=[bdot(gain, every=10) for gain in gains]
    )
    run = kr.simulate(many, many.state((0.02, 0.01, 0.03)), **{**SETTINGS, "t_end": "30 min"})
    left = np.linalg.norm(run.momentum[-1].values, axis=-1)
    assert (np.diff(left) < 0).all()


def test_one_attitude_is_for_all_of_four_lanes() -> None:
    """A quaternion has four entries too."""
    many = Ensemble.of(Satellite, 4, inertia=MOMENTS[0], orbit=ORBITS[0], density=[0.0, 1e-12, 2e-12, 3e-12])
    assert [body.density for body in many.bodies] == [0.0, 1e-12, 2e-12, 3e-12]
    start = many.state(attitude=(0.8, 0.0, 0.6, 0.0)).orientation
    assert start is not None and np.allclose(start, (0.8, 0.0, 0.6, 0.0), atol=1e-15) and start.shape == (4, 4)


BAD: dict[str, tuple[Any, str]] = {
    "a tensor": (
        lambda: Ensemble.of(Satellite, 3, inertia=[*MOMENTS[:2], (1, 1, 3)], orbit=ORBITS[0]),
        "Lane 2: .*body",
    ),
    "an orbit": (lambda: Ensemble.of(Satellite, 3, inertia=MOMENTS, orbit=[*ORBITS[:2], None]), "Lane 2: orbit"),
    "axes": (
        lambda: Ensemble.of(Satellite, 2, inertia=[np.diag(MOMENTS[0]), np.eye(3) + 0.1], orbit=ORBITS[0]),
        "Lane 1: expected the principal axes",
    ),
    "plates": (
        lambda: Ensemble.of(
            Satellite, 2, inertia=MOMENTS[0], orbit=ORBITS[0], plates=[[], [Plate((1, 0, 0), (0, 0, 0.1), 0.1)]]
        ),
        "Lane 1: expected the plates",
    ),
    "units": (lambda: Ensemble.of(FreeBody, 2, inertia=[(1, 2, 2.5), (2, 3, 4)]), "Lane 1: .*units"),
    "a force": (
        lambda: Ensemble.of(
            Satellite, 2, inertia=MOMENTS[0], orbit=ORBITS[0], torque=[EddyCurrents(1), EddyCurrents(2)]
        ),
        "Lane 1: expected the functions of lane 0",
    ),
    "a force by a closure": (
        lambda: Ensemble.of(FreeBody, 2, inertia=(1, 2, 2.5), torque=[lambda Omega: -Omega, lambda Omega: -2 * Omega]),
        "Lane 1: expected the functions of lane 0",
    ),
    "damping of one": (
        lambda: Ensemble([FreeBody((1, 2, 2.5), torque=spin_down), FreeBody((1, 2, 2.5), torque=spin_down, damping=1)]),
        "Lane 1: expected the functions of lane 0",
    ),
    "samples": (
        lambda: Ensemble.of(
            Satellite, 2, inertia=MOMENTS[0], orbit=ORBITS[0], control=[bdot(1e-5, every=each) for each in (1, 2)]
        ),
        "Lane 1: expected the functions of lane 0",
    ),
    "a kind": (lambda: Ensemble([Satellite(MOMENTS[0], ORBITS[0]), FreeBody((1, 2, 2.5))]), "Lane 1: .*euler-top"),
    "no lanes": (lambda: Ensemble.of(Satellite, 3, inertia=MOMENTS[0], orbit=ORBITS[0]), "3 entries"),
    "no bodies": (lambda: Ensemble([]), "a list of bodies"),
}


def test_as_many_plates_as_lanes_are_a_value_for_each() -> None:
    sides = [Plate(sign * axis, (0, 0, 0.1), 0.1) for axis in np.eye(3) for sign in (1, -1)]
    with pytest.raises(kr.InputError, match="Lane 0: plates"):
        Ensemble.of(Satellite, 6, inertia=MOMENTS[0], orbit=ORBITS[0], plates=sides)


def test_functions_that_do_the_same_are_functions_of_all_lanes() -> None:
    many = Ensemble.of(FreeBody, 2, inertia=(1, 2, 2.5), torque=[lambda Omega: -Omega, lambda Omega: -Omega])
    assert len(many.bodies) == 2


@pytest.mark.parametrize("case", BAD)
def test_a_bad_lane_is_named(case: str) -> None:
    make, message = BAD[case]
    with pytest.raises(kr.InputError, match=message):
        make()
