"""The exact motions, judged by SciPy on other equations, by closed forms, and by facts that anyone can check."""

from __future__ import annotations

import math
from collections.abc import Callable
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

import kreisel as kr
from kreisel.checkcases import taylor
from kreisel.checkcases.laws import PI, exact
from support import cross

FREE = ["tumbling-brick", "boxes", "thin-body", "small-box", "tilted-box", "wing-nut", "wing-nut-fine", "prolate"]
FREE += ["oblate", "on-the-separatrix", "pole"]
UNSTABLE = {"wing-nut": 1e-11, "wing-nut-fine": 1e-8, "boxes": 1e-11, "on-the-separatrix": 1e-11}  # growth of rounding
TORQUES: dict[str, Callable[[Any, float, Any, Any], Any]] = {  # in space, from R, t, the momentum, the numbers
    "heavy-top": lambda R, t, L, n: cross(R @ n["arm"], [0, 0, -n["mass"] * n["gravity"]]),
    "gyroscope": lambda R, t, L, n: cross(R @ n["arm"], [0, 0, -n["mass"] * n["gravity"]]),
    "sleeping-top": lambda R, t, L, n: cross(R @ n["arm"], [0, 0, -n["mass"] * n["gravity"]]),
    "cuspidal-top": lambda R, t, L, n: cross(R @ n["arm"], [0, 0, -n["mass"] * n["gravity"]]),
    "kovalevskaya": lambda R, t, L, n: cross(R @ n["arm"], [0, 0, -n["mass"] * n["gravity"]]),
    "needle": lambda R, t, L, n: cross(R @ [0, 0, 0.1], [0, 0, 50e-6]),
    "spin-down": lambda R, t, L, n: -0.1 * L,
    "rotating-field": lambda R, t, L, n: 2 * cross(L, [0.2 * np.cos(3 * t), -0.2 * np.sin(3 * t), 1.5]),
    "libration": lambda R, t, L, n: _gravity(R, t, np.array(n["inertia"])),
    "tumbling-brick": lambda R, t, L, n: np.zeros(3),
    "tilted-box": lambda R, t, L, n: np.zeros(3),
}


LONGEST = {"heavy-top": 0.5, "gyroscope": 1.0, "cuspidal-top": 1.0, "sleeping-top": 2.0}  # s


def _gravity(R: Any, t: float, inertia: Any) -> Any:
    """3 mu/r^5 r x (I r) with mu/r^3 = n^2 (Goldstein, section 5.8)."""
    n = 2 * math.pi / 5400
    r = np.array([math.cos(n * t), math.sin(n * t), 0])
    return 3 * n**2 * cross(r, R @ inertia @ R.T @ r)


@pytest.mark.parametrize("name", TORQUES)
def test_momentum_in_space_and_rotation_matrices_give_the_same_motion(name: str) -> None:
    """L' = torque, R' = hat(I_space^-1 L) R: no quaternion, no body axes, SciPy's DOP853."""
    case = kr.checkcases.case(name)
    numbers = case.given()
    inertia, R0 = np.array(numbers["inertia"]), Rotation.from_quat(np.roll(numbers["attitude"], -1)).as_matrix()
    end = min(float(case.duration), LONGEST.get(name, 2000.0))
    unit = inertia.max()

    def rates(t: float, y: Any) -> Any:
        L, R = y[:3] * unit, y[3:].reshape(3, 3)
        w = R @ np.linalg.solve(inertia, R.T @ L)
        return np.concatenate(
            [TORQUES[name](R, t, L, numbers) / unit, np.stack([cross(w, r) for r in R.T], -1).ravel()]
        )

    start = np.concatenate([R0 @ inertia @ numbers["angular_velocity"] / unit, R0.ravel()])
    y = solve_ivp(rates, (0, end), start, "DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
    truth = case.reference([end])
    R = Rotation.from_quat(np.roll(truth.attitude.values[0], -1)).as_matrix()
    assert np.allclose(R, y[3:].reshape(3, 3), rtol=0, atol=2e-8)
    assert np.allclose(truth.momentum.values[0], y[:3] * unit, rtol=0, atol=2e-8 * abs(y[:3]).max() * unit)


@pytest.mark.parametrize("name", FREE)
def test_free_bodies_move_as_their_closed_form(name: str) -> None:
    case = kr.checkcases.case(name)
    numbers = case.given()
    times = case.times(7)
    truth = case.reference(times)
    w, q = kr.physical.FreeBody(numbers["inertia"]).rotation(numbers["angular_velocity"]).at(times)
    close = UNSTABLE.get(name, 1e-13)
    assert np.allclose(truth.angular_velocity, w, rtol=0, atol=close * abs(w).max())
    assert np.allclose(abs((truth.attitude.values * q).sum(-1)), 1, rtol=0, atol=close)
    assert np.allclose(truth.attitude * np.sign((truth.attitude.values * q).sum(-1))[:, None], q, rtol=0, atol=close)


@pytest.mark.parametrize("name", ["gyrostat", "spin-down"])
def test_the_values_given_suffice(name: str) -> None:
    """Euler's equations with a wheel and damping, by DOP853; without the wheel the gyrostat is off by 2 rad/s."""
    case, end = kr.checkcases.case(name), 5.0
    body = case.given()
    inertia, wheel = np.array(body["inertia"]), np.array(body.get("wheel_momentum", [0, 0, 0]))

    def rates(_: float, w: Any) -> Any:
        return np.linalg.solve(inertia, cross(inertia @ w + wheel, w)) - body.get("damping", 0) * w

    w = solve_ivp(rates, (0, end), body["angular_velocity"], "DOP853", rtol=1e-11, atol=1e-12).y[:, -1]
    assert np.allclose(case.reference([end]).angular_velocity.values[0], w, rtol=0, atol=1e-8)


def test_the_brick_is_where_the_best_of_nasas_simulations_have_it() -> None:
    """Two of the five agree with these values, deg/s at 30 s, to 4e-10."""
    truth = kr.checkcases.case("tumbling-brick").reference([30.0])
    rates = np.degrees(truth.angular_velocity.values[0])
    assert np.allclose(rates, (12.61839078, -17.39747476, 31.11958889), rtol=0, atol=6e-9)


def test_the_heavy_top_is_a_lagrange_top() -> None:
    """By Kreisel's closed form of the top, about its axis; displacement of the centre of mass at 2 s."""
    truth = kr.checkcases.case("heavy-top").reference([2.0])
    displacement = truth.position.values[0] - (0, 1, 0)
    assert np.allclose(displacement, (-0.15041682, -1.72416559, -0.67302227), rtol=0, atol=6e-9)
    top = kr.physical.Gyroscope(15.0, 0.46875, 15.234375, 1.0, 9.81)
    m = np.array([0, 0.46875 * 150, -15.234375 * 4.61538]) / top.momentum_unit
    state = kr.at(top.model(), top.model().state(m=m, a=(0, 1, 0)), [0.0, top.dt(2.0)])
    assert np.allclose(state.a.values[1], truth.position.values[0], rtol=0, atol=1e-14)


def test_facts_that_anyone_can_check() -> None:
    """The pole, the inversion of a spin, the decay, the separatrix, the period of a pendulum, conserved momentum."""
    half = math.sqrt(0.5)
    assert np.allclose(kr.checkcases.case("pole").reference([10.0]).attitude.values[0], (half, 0, half, 0), atol=1e-15)

    rabi = kr.checkcases.case("rotating-field")
    inversion = rabi.answers(rabi)[0].value
    start, end = rabi.reference([0.0, inversion]).momentum.values
    assert math.isclose(end[2], -start[2], rel_tol=1e-12)

    damped = kr.checkcases.case("spin-down")
    start, end = np.linalg.norm(damped.reference([0.0, 30.0]).momentum.values, axis=-1)
    assert math.isclose(end, start * math.exp(-3), rel_tol=1e-13)

    separatrix = kr.checkcases.case("on-the-separatrix")
    rate, growth, crossing = (answer.value for answer in separatrix.answers(separatrix))
    times = np.array([1.0, crossing, 5.0])
    w2 = separatrix.reference(times).angular_velocity.values[:, 1]
    assert np.allclose(w2, rate * np.tanh(growth * (times - crossing)), rtol=0, atol=1e-14 * rate)

    satellite = kr.checkcases.case("libration")
    period = satellite.answers(satellite)[0].value
    times = np.array([0.0, period / 2, period])
    q = satellite.reference(times).attitude.values
    pitch = np.degrees(2 * np.arctan2(q[:, 3], q[:, 0])) - 360 * times / 5400
    assert np.allclose((pitch + 180) % 360 - 180, (40, -40, 40), rtol=0, atol=1e-10)

    water = kr.checkcases.case("in-water")
    momentum, inertia = [], np.diag([13.2, 13.2, 9.1])
    truth = water.reference([0.0, 5.0])
    for q, v, x, L in zip(
        truth.attitude.values, truth.velocity.values, truth.position.values, truth.momentum.values, strict=True
    ):
        impulse = Rotation.from_quat(np.roll(q, -1)).apply(inertia @ v)
        momentum.append([impulse, L + np.cross(x, impulse)])
    assert np.allclose(momentum[0], momentum[1], rtol=0, atol=1e-13)


@pytest.mark.parametrize("name", ["tumbling-brick", "kovalevskaya"])
def test_the_error_is_within_its_bound(name: str) -> None:
    """Against the series with 64 bits more.  A series that loses a term is beyond its bound."""
    case = kr.checkcases.case(name)
    state, bounds = case.exact(case.duration)
    finer, _ = _with_bits(case, case.bits + 64)
    errors = np.array([abs(float(a - b)) for a, b in zip(state, finer, strict=True)])
    assert (errors <= bounds).all()
    assert (errors > bounds * 1e-16).any(), "a bound that is never near the error says nothing"
    assert case.digits >= 14


def test_a_coefficient_that_is_wrong_exceeds_the_bound(monkeypatch: pytest.MonkeyPatch) -> None:
    case = kr.checkcases.case("tumbling-brick")
    state, bounds = case.exact(1)
    series = taylor.Solution._series

    def spoilt(self: Any, start: Any, length: Any) -> Any:
        out = series(self, start, length)
        out[0][5] += 1 << 30  # of 2^112
        return out

    monkeypatch.setattr(taylor.Solution, "_series", spoilt)
    wrong, _ = _with_bits(case, case.bits, Fraction(1))
    assert any(abs(float(a - b)) > bound for a, b, bound in zip(state, wrong, bounds, strict=True))


def _with_bits(case: Any, bits: int, time: Fraction | None = None) -> tuple[Any, Any]:
    from dataclasses import replace

    return replace(case, bits=bits).exact(case.duration if time is None else time)


def test_every_case_is_certain_to_fourteen_digits() -> None:
    """And its attitude stays of length 1, its numbers are printed with units that pint has."""
    pint = pytest.importorskip("pint")
    registry = pint.UnitRegistry()
    for name in kr.checkcases.cases():
        case = kr.checkcases.case(name)
        assert case.digits >= 14, name
        assert abs(sum(v * v for v in case.exact(case.duration)[0][3:7]) - 1) < 1e-18
        for text in case.numbers.values():
            words = text.split()
            first, unit = words[0], " ".join(w for w in words if not w[0].isdigit() and w[0] != "-")
            value = exact(text)
            value = value[0] if isinstance(value, list) else value
            quantity = registry.Quantity(float(Fraction(first)), unit.replace(" ", "*"))
            assert math.isclose(quantity.to_base_units().magnitude, float(value), rel_tol=1e-14), text


def test_pi_has_a_hundred_digits() -> None:
    """John Machin's formula, 1706."""
    machin = 4 * (4 * _arctan(Fraction(1, 5)) - _arctan(Fraction(1, 239)))
    assert abs(PI - machin) < Fraction(1, 10**100)


def _arctan(x: Fraction) -> Fraction:
    return sum((Fraction((-1) ** k, 2 * k + 1) * x ** (2 * k + 1) for k in range(80)), Fraction(0))


@pytest.mark.parametrize("times", [[31.0], [-1e-3], [math.nan], [], [math.inf]])
def test_times_outside_the_case_are_refused(times: list[float]) -> None:
    with pytest.raises(kr.InputError, match="expected times of the case tumbling-brick, 0 to 30 s"):
        kr.checkcases.case("tumbling-brick").reference(times)


def test_an_unknown_case_is_named() -> None:
    with pytest.raises(kr.InputError, match="heavy-top"):
        kr.checkcases.case("heavy-topp")
