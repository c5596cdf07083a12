"""The grade of a trajectory: errors, drifts, orders, and what it accuses of nothing."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

import kreisel as kr
from support import cross

BRICK = kr.checkcases.case("tumbling-brick")
MOMENTS = np.array([0.00189422, 0.006211019, 0.007194665]) * 14.593902937206364 * 0.3048**2  # kg m^2


def field(w: np.ndarray, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Euler's equations and the rate of a quaternion (x, y, z, w), body to space."""
    xyz, s = q[:3], q[3]
    return -cross(w, MOMENTS * w) / MOMENTS, np.append(s * w + cross(xyz, w), -xyz @ w) / 2


def runge_kutta(parts: int, rows: int = 61) -> SimpleNamespace:
    """The classical method with `parts` steps in a row."""
    times = BRICK.times(rows)
    h, z = times[1] / parts, np.concatenate([np.radians([10.0, 20, 30]), [0, 0, 0, 1]])
    out = [z]

    def rate(z: np.ndarray) -> np.ndarray:
        return np.concatenate(field(z[:3], z[3:]))

    for k in range(1, parts * (rows - 1) + 1):
        k1 = rate(z)
        k2 = rate(z + h / 2 * k1)
        k3 = rate(z + h / 2 * k2)
        z = z + h / 6 * (k1 + 2 * k2 + 2 * k3 + rate(z + h * k3))
        if k % parts == 0:
            out.append(z)
    states = np.array(out)
    quaternions = states[:, [6, 3, 4, 5]] / np.linalg.norm(states[:, 3:], axis=-1)[:, None]
    quantities = {"angular_velocity": states[:, :3], "attitude": quaternions}
    return SimpleNamespace(times=times, quantities=quantities, step=h)


def exact(rows: int = 61, case: Any = BRICK) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    times = case.times(rows)
    truth = case.reference(times)
    return times, {name: truth[name].values.copy() for name in ("angular_velocity", "attitude")}


def test_a_method_of_order_four_is_called_right_with_its_order() -> None:
    runs = [runge_kutta(parts) for parts in (2, 4, 8)]
    grade = BRICK.grade(runs[0].times, step=runs[0].step, runs=runs[1:], **runs[0].quantities)
    assert grade.orders == pytest.approx([4, 4], abs=0.15)
    assert grade.mistake is None
    assert "Right" in grade.verdict
    assert "order 4" in grade.verdict
    assert [h for h, _ in grade.steps] == pytest.approx([0.25, 0.125, 0.0625])


@pytest.mark.parametrize("name", ["tumbling-brick", "kovalevskaya"])
def test_a_right_trajectory_with_noise_is_accused_of_nothing(name: str) -> None:
    case = kr.checkcases.case(name)
    times, truth = exact(case=case)
    rng = np.random.default_rng(20)
    grade = case.grade(times, **{key: v + 1e-6 * rng.standard_normal(v.shape) for key, v in truth.items()})
    assert grade.mistake is None
    assert grade.verdict.startswith("Right: the trajectory agrees with the exact motion to 5 digits")


def test_errors_are_found_where_they_were_made() -> None:
    times, truth = exact()
    truth["angular_velocity"][17] += [0, 3e-3, 4e-3]
    turned = Rotation.from_quat(truth["attitude"][40][[1, 2, 3, 0]]) * Rotation.from_rotvec([0, 0.02, 0])
    truth["attitude"][40] = -turned.as_quat()[[3, 0, 1, 2]]
    grade = BRICK.grade(times, **truth)
    rates, attitude = grade.rows
    assert (rates.largest, rates.time, rates.last) == pytest.approx((5e-3, times[17], 0), abs=1e-12)
    assert (attitude.largest, attitude.time, attitude.last) == pytest.approx((0.02, times[40], 0), abs=1e-9)
    assert grade.errors["attitude"][40] == pytest.approx(0.02)
    assert grade.mistake is None
    assert "no listed mistake explains" in str(grade)


def test_drifts_are_those_of_the_trajectory() -> None:
    """Rates 1 % too large: the energy is off by 2.01 %, the momentum by 1 %; exact ones do not drift."""
    times, truth = exact()
    assert max(d.relative for d in BRICK.grade(times, **truth).drifts) < 1e-14
    truth["angular_velocity"][30] *= 1.01
    drifts = {d.quantity: d for d in BRICK.grade(times, **truth).drifts}
    assert drifts["energy"].relative == pytest.approx(0.0201)
    assert drifts["length of the momentum"].relative == pytest.approx(0.01)
    assert drifts["momentum"].relative == pytest.approx(0.01)
    assert drifts["momentum"].time == times[30]


def test_a_top_keeps_its_energy_and_vertical_momentum() -> None:
    case = kr.checkcases.case("kovalevskaya")
    times, truth = exact(case=case)
    drifts = {d.quantity: d.relative for d in case.grade(times, **truth).drifts}
    assert set(drifts) == {"energy", "vertical momentum"}
    assert max(drifts.values()) < 1e-13


def test_a_mistake_that_is_not_listed_is_not_named() -> None:
    """The first moment of inertia 3 % too large."""
    moments = MOMENTS * [1.03, 1, 1]
    start, times = np.radians([10.0, 20, 30]), BRICK.times(61)
    run = solve_ivp(lambda t, w: -cross(w, moments * w) / moments, (0, 30), start, "DOP853", times, rtol=1e-10)
    grade = BRICK.grade(times, angular_velocity=run.y.T)
    assert grade.relative > 1e-2
    assert grade.mistake is None
    assert "no listed mistake explains the error" in grade.verdict
    again = SimpleNamespace(times=times, quantities={"angular_velocity": run.y.T}, step=0.25)
    assert "does not decrease with the step" in BRICK.grade(times, runs=[again], angular_velocity=run.y.T).verdict


def test_few_digits_and_single_precision_are_stated() -> None:
    times, truth = exact()
    printed = BRICK.grade(times, angular_velocity=np.round(truth["angular_velocity"], 5))
    assert any("5 decimals" in note for note in printed.notes)
    short = BRICK.grade(times, **{name: v.astype(np.float32) for name, v in truth.items()})
    assert any("single precision" in note for note in short.notes)
    assert not BRICK.grade(times, **truth).notes
    assert printed.mistake is None
    assert short.mistake is None


def test_a_wrong_start_is_stated() -> None:
    times, _ = exact()
    moved = solve_ivp(lambda t, w: field(w, np.array([0, 0, 0, 1.0]))[0], (0, 30), [0.2, 0.35, 0.5], "DOP853", times)
    grade = BRICK.grade(times, angular_velocity=moved.y.T)
    assert any("first row differs" in note for note in grade.notes)
    assert grade.mistake is None


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda t, v: (t[:1], {"attitude": v["attitude"][:1]}), "at least two rows"),
        (lambda t, v: (np.append(t, 31.0)[:2], {}), "expected some of the case's quantities, angular_velocity"),
        (lambda t, v: (t + 1, v), "0 to 30 s, got 1.0 to 31.0"),
        (lambda t, v: (t[[*range(60), 59]], v), "row 61. Usual cause: the row is there twice"),
        (lambda t, v: (t[::-1], v), "several runs in one file"),
        (lambda t, v: (t, {"attitude": 2 * v["attitude"]}), "of norm 2"),
        (lambda t, v: (t, {"angular_velocity": np.full((61, 3), np.nan)}), "got [nan, nan, nan] in row 1"),
        (lambda t, v: (t, {"angular_velocity": v["angular_velocity"][:-1]}), "shape (61, 3)"),
        (lambda t, v: (t, {"velocity": v["angular_velocity"]}), "got velocity"),
        (lambda t, v: (t, {**v, "step": 0.6}), "at most 0.5, the spacing of the rows, got 0.6"),
        (lambda t, v: (t, {"spin": v["angular_velocity"]}), "got 'spin'"),
    ],
)  # fmt: skip
def test_bad_arrays_are_refused(change: Any, message: str) -> None:
    times, values = change(*exact())
    with pytest.raises(kr.InputError) as raised:
        BRICK.grade(times, **values)
    assert message in str(raised.value)
