"""Arrays that may be read in two ways: lanes, or components and sites."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import xarray as xr

import kreisel as kr
from kreisel import algebra

THREE = np.array([[0.1, 0.2, 1.5], [1.0, 0.3, -0.2], [0.4, -0.8, 0.6]])
TURNS = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])  # skew: three axial vectors too
BODY, TOP = kr.EulerTop(J=(1, 2, 3)), kr.LagrangeTop(p=(0, 0, 1))
EVEN = np.array([[2.0, 0.1, 0.1], [0.1, 3.0, 0.1], [0.1, 0.1, 1.0]])


def of_lanes(values: Any) -> xr.DataArray:
    return xr.DataArray(values, dims=("lane", "axis"))


def test_numbers_for_sites_are_asked_for() -> None:
    for field in ([1, 2, 3], np.arange(3.0), [0, 0, 0]):
        with pytest.raises(kr.InputError, match=r"3 values for 3 sites may be one for each lane, or one for each site"):
            kr.SpinChain(n=3, Bz=field)
    for given in (
        {"Bz": [[1], [2], [3]]},
        {"Bz": xr.DataArray([1, 2, 3], dims="lane")},
        {"Bz": [1, 2, 3], "n": [3] * 3},
    ):
        made = kr.SpinChain(**{"n": 3, **given})
        assert made.batch == (3,) and made.n == 3 and made.params["Bz"].tolist() == [1, 2, 3]
        assert made.lanes(np.array([0, 2, 1])).params["Bz"].tolist() == [1, 3, 2]
    assert kr.SpinChain(n=4, Bz=[1, 2, 3]).batch == (3,)
    assert kr.LagrangeTop(p=(0, 0, 1), alpha=[1.0, 2.0, 3.0]).batch == (3,)  # no sites
    assert kr.LagrangeTop(p=(0, 0, 1), alpha=[[1.0], [2.0]]).batch == (2,)


def test_axial_vectors_of_three_lanes() -> None:
    for refused in (THREE, THREE.tolist()):
        with pytest.raises(
            kr.InputError, match=r"may be a skew matrix, or the axial vectors of three lanes; M \+ M\^T"
        ):
            BODY.state(M=refused)
    for given in (of_lanes(THREE), algebra.hat(THREE)):
        state = BODY.state(M=given).axial.M
        assert np.array_equal(state.reshape(3, 3), THREE)
    assert BODY.state(M=of_lanes(TURNS)).M.shape == (3, 3, 3)
    assert BODY.state(M=TURNS).M.shape == (3, 3) and np.array_equal(BODY.state(M=TURNS).M, TURNS)
    assert kr.EulerTop(J=[(1, 2, 3), (1, 2, 4), (1, 2, 5)]).state(M=THREE).axial.M.tolist() == THREE.tolist()


def test_the_lanes_of_another_component_tell() -> None:
    assert np.array_equal(TOP.state(m=THREE, a=THREE).axial.m, THREE)
    assert TOP.state(m=np.zeros((3, 3)), a=THREE).m.shape == (3, 3)  # in either reading
    with pytest.raises(kr.InputError, match="is skew, and there are three lanes"):
        TOP.state(m=TURNS, a=THREE)
    assert TOP.state(m=(0, 0, 1.0), a=THREE).m.shape == (3, 3)
    with pytest.raises(kr.InputError, match=r"its skew part \(m - m\^T\)/2"):
        TOP.state(m=THREE, a=(0, 0, 1))


def test_a_row_of_three_lanes_is_a_start() -> None:
    run = kr.simulate(BODY, {"M": of_lanes(THREE)}, dt=0.1, steps=4, every=2)
    assert run.M.shape == (3, 3, 3)
    more = kr.simulate(BODY, run.isel(time=-1), dt=0.1, steps=4, every=2)
    whole = kr.simulate(BODY, {"M": of_lanes(THREE)}, dt=0.1, steps=8, every=2)
    assert abs(more.M.values[-1] - whole.M.values[-1]).max() < 1e-14


@pytest.mark.parametrize("name", ["EulerTop", "Clebsch", "Neumann", "ClebschBody", "SteklovLyapunov"])
def test_a_matrix_for_its_diagonal_is_asked_for(name: str) -> None:
    system = getattr(kr, name)
    letter, more = system.parameters[0].letter, {"s": 1.0, "l": 0.0} if name == "SteklovLyapunov" else {}
    for value in (EVEN, np.diag([1.0, 2, 3])):
        with pytest.raises(kr.InputError, match=r"may be a matrix, or the diagonals of 3 lanes"):
            system(**{letter: value}, **more)
    assert system(**{letter: of_lanes(EVEN)}, **more).batch == (3,)
    assert system(**{letter: abs(THREE) + 1}, **more).batch == (3,)
    assert kr.LagrangeTop(p=np.eye(3)).batch == (3,)  # no diagonal of a matrix


def test_matrices_of_forces_are_asked_for() -> None:
    with pytest.raises(kr.InputError, match="damping: a symmetric array"):
        kr.perturbed(BODY, damping=EVEN)
    with pytest.raises(kr.InputError, match="inertia: a symmetric array"):
        kr.perturbed(BODY, inertia=EVEN + np.diag([3.0, 2, 4]))
    assert kr.perturbed(BODY, damping=[[0.1], [0.2], [0.3]]).batch == (3,)
    assert kr.perturbed(BODY, damping=(0.1, 0.2, 0.3)).batch == ()


def test_diagonals_of_lanes_are_told_how() -> None:
    for value in (np.ones((5, 3)), [[1, 2, 3], [1, 2, 4], [1, 2, 5]]):
        with pytest.raises(kr.InputError, match=r"give \(lanes, n, n\)"):
            kr.HeavyTop(J=value, A=(0, 0, 1))


def test_bodies_take_three_spins() -> None:
    orbit = kr.physical.Orbit.circular(500e3)
    for body in (kr.physical.FreeBody((2.0, 3.0, 4.0)), kr.physical.Satellite((2.0, 3.0, 4.0), orbit)):
        each = [body.state(spin=spin).M for spin in THREE]
        assert np.array_equal(body.state(spin=THREE).M, each)


def test_a_state_that_was_changed_is_checked_again() -> None:
    """Arrays of a state may be written: the next run sees what is in them."""
    top = kr.LagrangeTop(p=(0, 0, 1))

    def changed(entry: Any, value: float) -> Any:
        state = top.state(m=(0.1, -0.2, 0), a=(0.6, 0, 0.8))
        state["a"][entry] = value
        return state

    whole = slice(None)
    for entry, value, message in ((0, np.nan, "finite"), (1, np.inf, "finite"), (whole, 0.0, "zero vector")):
        with pytest.raises(kr.InputError, match=message):
            kr.simulate(top, changed(entry, value), dt=0.1, steps=1)
    moved = kr.simulate(top, changed(1, 0.5), dt=0.1, steps=9)
    assert moved.equals(kr.simulate(top, {"m": (0.1, -0.2, 0), "a": (0.6, 0.5, 0.8)}, dt=0.1, steps=9))


def test_lanes_by_name_at_any_place() -> None:
    """A product of arrays of xarray may have the lanes last; exp(-rate) is the decay of a momentum at rest in space."""
    speeds = xr.DataArray([1.0, 2.0, 3.0], dims="lane")
    products = [xr.DataArray(v, dims="axis") * speeds for v in ([0.6, 0.0, 0.8], [1.0, 2.0, 2.5])]
    assert products[0].dims == ("axis", "lane")
    spun, body = BODY.state(M=products[0]), kr.EulerTop(J=products[1])
    for lane in range(3):
        assert np.allclose(spun.axial.M[lane], np.array((0.6, 0.0, 0.8)) * (1 + lane), rtol=1e-15)
        assert np.allclose(body.params["J"][lane], np.array((1.0, 2.0, 2.5)) * (1 + lane), rtol=1e-15)
    assert kr.physical.FreeBody(products[1]).state(products[0]).M.shape == (3, 3, 3)
    rates = xr.DataArray([0.1, 0.2, 0.4], dims="lane")
    sphere, falling = kr.EulerTop(J=(1, 1, 1)), np.exp(-rates.values)[:, None] * (0.6, 0.0, 0.8)
    for braked in (
        kr.perturbed(sphere, damping=rates),
        kr.perturbed(sphere, torque=lambda M, *, rate: -rate * M, params={"rate": rates}),
    ):
        run = kr.simulate(braked, {"M": (0.6, 0.0, 0.8)}, dt=0.05, steps=20)
        assert np.allclose(run.M[-1], falling, rtol=0, atol=1e-8)
    of_bodies = (
        kr.physical.FreeBody((2, 2, 2), damping=rates),
        kr.physical.FreeBody((2, 2, 2), torque=lambda M, *, rate: -rate * M, params={"rate": rates}),
    )
    for many in of_bodies:
        run = kr.simulate(many, many.state((0.3, 0.0, 0.4)), dt=0.05, t_end=1.0)
        assert np.allclose(run.momentum[-1], falling, rtol=0, atol=1e-8)
