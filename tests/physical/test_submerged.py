"""Bodies deep in water: against equations about O in the axes of the body, terminal speeds, files, bad input."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import kreisel as kr
from kreisel import algebra
from kreisel.bodies import BODIES
from kreisel.physical import STANDARD_GRAVITY, Ellipsoid, SubmergedBody, read_added_mass
from support import cross

X = np.random.default_rng(1).normal(size=(6, 6))
LOADED: dict[str, Any] = {
    "mass": 3.0,
    "inertia": (0.2, 0.3, 0.4),
    "added_mass": X @ X.T / 6,
    "displaced_mass": 2.9,
    "center_of_mass": (0.02, 0.0, -0.1),
    "center_of_buoyancy": (0.0, 0.01, 0.05),
    "linear_drag": (0.1, 0.2, 0.3, 0.01, 0.02, 0.03),
    "quadratic_drag": (0.3, 0.1, 0.2, 0.04, 0.05, 0.06),
}
UP = np.array([0.0, 0.0, 1.0])


def solved(body: SubmergedBody, U: Any, Omega: Any, end: float) -> np.ndarray:
    """Velocities, orientation and position at the end, in the water's frame, about O in the axes of the body."""
    matrix = np.asarray(body.added_mass).copy()
    arm = algebra.hat(body.center_of_mass)
    matrix += np.block(
        [[body.mass * np.eye(3), -body.mass * arm], [body.mass * arm, body.inertia - body.mass * arm @ arm]]
    )
    weight, buoyancy = body.mass * STANDARD_GRAVITY, body.displaced_mass * STANDARD_GRAVITY

    def rate(_: float, y: np.ndarray) -> np.ndarray:
        P, M, g = y[:3], y[3:6], y[6:15].reshape(3, 3)
        nu = np.linalg.solve(matrix, np.concatenate([P, M]))
        drag = -(body.linear_drag + body.quadratic_drag * abs(nu)) * nu
        up = g.T @ UP
        F = (buoyancy - weight) * up + drag[:3]
        tau = cross(body.center_of_buoyancy, buoyancy * up) - cross(body.center_of_mass, weight * up) + drag[3:]
        U, Omega = nu[:3], nu[3:]
        turning = (g @ algebra.hat(Omega)).ravel()
        return np.concatenate([cross(P, Omega) + F, cross(M, Omega) + cross(P, U) + tau, turning, g @ U])

    begin = np.concatenate([matrix @ np.concatenate([U, Omega]), np.eye(3).ravel(), np.zeros(3)])
    y = solve_ivp(rate, (0, end), begin, method="DOP853", rtol=1e-11, atol=1e-12).y[:, -1]
    return np.concatenate([np.linalg.solve(matrix, y[:6]), y[6:]])


def simulated(body: SubmergedBody, U: Any, Omega: Any, **asked: Any) -> Any:
    known = {"dt": 0.02, "orientation": body.orientation(), "progress": False} | asked
    return kr.simulate(body.model(), body.state(U, Omega), **known)


def test_against_equations_about_another_point() -> None:
    body = SubmergedBody(**LOADED)
    U, Omega = np.array([0.4, -0.2, 0.1]), np.array([0.3, 0.5, -0.8])
    run = simulated(body, U, Omega, steps=150)
    want, course = solved(body, U, Omega, 3.0), body.course(run)
    assert abs(course.velocity[0] - U).max() < 1e-14
    assert abs(course.angular_velocity[0] - Omega).max() < 1e-14
    assert abs(np.concatenate([course.velocity[-1], course.angular_velocity[-1]]) - want[:6]).max() < 1e-7
    assert abs(algebra.rotation_matrix(body.attitude(run.g.values[-1])).ravel() - want[6:15]).max() < 1e-7
    assert abs(course.position[-1] - want[15:]).max() < 1e-7
    assert float(abs(run.balance - run.balance[0]).max()) < 1e-7 * float(abs(run.energy[0]))


def test_a_current_carries_the_body() -> None:
    """In the frame of the water nothing changes: velocities and positions differ by those of the current."""
    current = np.array([0.3, -0.1, 0.05])
    still, carried = SubmergedBody(**LOADED), SubmergedBody(**LOADED, current=current)
    U, Omega = np.array([0.4, -0.2, 0.1]), np.array([0.3, 0.5, -0.8])
    first, second = (simulated(b, U + add, Omega, steps=20) for b, add in ((still, 0), (carried, current)))
    assert abs(first.P.values - second.P.values).max() < 1e-12
    moved = carried.course(second).position - still.course(first).position
    assert abs(moved - current * first.time.values[:, None]).max() < 1e-12
    with pytest.raises(kr.InputError, match="another current"):
        still.course(second)


def test_terminal_speed() -> None:
    """A heavy sphere sinks at the speed at which its drag is its weight in water."""
    sphere = SubmergedBody.ellipsoid((0.1, 0.1, 0.1), 6.0, 1000.0, quadratic_drag=(4.0, 4.0, 4.0, 0.1, 0.1, 0.1))
    run = simulated(sphere, (0, 0, 0), (0, 0, 0), steps=2000)
    speed = np.sqrt((6.0 - sphere.displaced_mass) * STANDARD_GRAVITY / 4.0)
    assert sphere.course(run).velocity[-1] == pytest.approx([0, 0, -speed], abs=1e-9)
    # m v' = F - k v^2 from rest: x = m/k log cosh(sqrt(k F) t/m), m with the added mass; the rows are 10 s apart
    moved = 6.0 + sphere.added_mass[0, 0]
    fall = moved / 4.0 * np.log(np.cosh(4.0 * speed / moved * 40.0))
    for every in (10, 500):
        position = sphere.course(run.isel(time=slice(None, None, every))).position
        assert position[-1] == pytest.approx([0, 0, -fall], abs=1e-9)


def test_the_course_of_a_disc_does_not_depend_on_the_rows() -> None:
    """Drag with corners, which an explicit method sees as stiff: the case of docs/guide-disc.md."""
    disc = SubmergedBody.ellipsoid(
        (0.05, 0.05, 0.005),
        0.058,
        1000.0,
        linear_drag=(0, 0, 0, 2e-4, 2e-4, 2e-5),
        quadratic_drag=(0.05, 0.05, 5.0, 2e-4, 2e-4, 2e-5),
    )
    tilted = np.array([np.cos(np.radians(47.5)), 0, np.sin(np.radians(47.5)), 0])
    run = kr.simulate(
        disc.model(),
        disc.state(attitude=tilted),
        dt=0.005,
        steps=400,
        orientation=disc.orientation(tilted),
        progress=False,
    )
    fine, coarse, ends = (disc.course(run.isel(time=slice(None, None, every))).position for every in (1, 100, 400))
    assert abs(fine[::100] - coarse).max() < 1e-6
    assert abs(fine[::400] - ends).max() < 1e-6


def test_more_added_mass_than_mass() -> None:
    """A body of 1 kg with 26 kg of added mass: nothing bounds the ratio.  Energy less work, for 10^5 steps."""
    body = SubmergedBody(1.0, (0.02, 0.02, 0.02), (5.0, 5.0, 26.0, 0.1, 0.2, 0.3))
    run = simulated(body, (0.2, 0.1, 0.3), (0.5, -0.3, 0.8), dt=0.05, steps=100_000, every=1000, order=(2, 2))
    assert float(abs(run.energy - run.energy[0]).max()) < 0.01 * float(run.energy[0])  # 2e-3, without a trend


def test_without_loads_an_ellipsoid_is_kirchhoffs() -> None:
    axes = (0.15, 0.10, 0.05)
    body = SubmergedBody.ellipsoid(axes, 3.0, 998.2, gravity=0.0)
    like = Ellipsoid(axes, 3.0, 998.2)
    U, Omega = (0.3, 0.1, 0.0), (0.4, -0.2, 0.9)
    run = simulated(body, U, Omega, steps=100)
    course = body.course(run)
    whole = kr.simulate(
        like.model(),
        like.state(U, Omega),
        dt=0.02,
        steps=100,
        method="dop853",
        orientation=(1, 0, 0, 0),
        progress=False,
    )
    assert abs(course.position - kr.analysis.path(whole).values).max() < 1e-7
    found = course.angular_velocity - kr.analysis.angular_velocity(whole).values
    assert abs(found).max() < 1e-6


def test_cylinder_of_strip_theory() -> None:
    rod = SubmergedBody.cylinder(0.05, 2.0, 16.0, 1000.0)
    fluid = np.pi * 1000 * 0.05**2 * 2
    assert rod.displaced_mass == pytest.approx(fluid)
    assert np.diag(rod.added_mass) == pytest.approx([0, fluid, fluid, 0, fluid / 3, fluid / 3])
    with pytest.warns(kr.InputWarning, match="length: expected at least 4 radii, for strip theory, got 0.5"):
        disc = SubmergedBody.cylinder(0.1, 0.05, 1.0, 1000.0)
    assert disc.added_mass[0, 0] == 0.0  # of a thin disc 8/3 rho r^3 = 2.7 kg [Lamb, article 108]


def test_by_name_and_ensembles() -> None:
    """The record by name; a sweep of the weight in lanes agrees with single runs."""
    body = SubmergedBody(**LOADED)
    given = {k: v for k, v in body.model().params.items() if k != "weight"}
    weights = np.array([28.0, 30.0])
    x0 = body.state((0.4, -0.2, 0.1), (0.3, 0.5, -0.8))
    asked = {"dt": 0.02, "steps": 20, "orientation": body.orientation(), "progress": False}
    together = kr.simulate(BODIES["submerged-body"](**given, weight=weights), x0, **asked)
    for lane, weight in enumerate(weights):
        alone = kr.simulate(BODIES["submerged-body"](**given, weight=weight), x0, **asked)
        assert abs(together.P.values[:, lane] - alone.P.values).max() < 1e-12


def test_the_course_of_a_lane_with_a_mass_matrix_of_its_own() -> None:
    """Each lane is read with its body; the lane of another body, and all lanes at once, are refused."""
    U, Omega = np.array([0.4, -0.2, 0.1]), np.array([0.3, 0.5, -0.8])
    many = SubmergedBody(**{**LOADED, "mass": [3.0, 2.0]})
    run = kr.simulate(many, many.state(U, Omega), dt=0.02, steps=50, progress=False)
    for lane in range(2):
        want, course = solved(many[lane], U, Omega, 1.0), many[lane].course(run.sel(lane=lane))
        assert abs(course.velocity[-1] - want[:3]).max() < 1e-7
        assert abs(course.position[-1] - want[15:]).max() < 1e-7
        for other in (run.sel(lane=1 - lane), run):
            with pytest.raises(kr.InputError, match="another mass_matrix"):
                many[lane].course(other)


def test_reads_a_matrix_and_wamit(tmp_path: Path) -> None:
    plain, wamit = tmp_path / "plain.txt", tmp_path / "hull.1"
    plain.write_text("# added mass\n" + "\n".join(" ".join(map(str, row)) for row in LOADED["added_mass"]), "utf-8")
    assert abs(read_added_mass(plain) - LOADED["added_mass"]).max() < 1e-15
    wamit.write_text("-1.0 1 1 0.7\n 0.0 1 1 0.5\n 0.0 1 5 0.2\n 0.0 5 5 0.1D+01\n 6.2 1 1 0.9 0.3\n", "utf-8")
    found = read_added_mass(wamit, density=1000, length=2)
    assert (found[0, 0], found[0, 4], found[4, 4]) == pytest.approx((0.5 * 8000, 0.2 * 16000, 32000))
    assert read_added_mass(wamit, density=1000, length=2, period=-1)[0, 0] == pytest.approx(5600)


def test_units_of_six_numbers() -> None:
    body = SubmergedBody(
        "1 kg",
        (1, 1, 1),
        added_mass=("2 kg", "2000 g", 2, "1 kg m^2", 1, "1e4 kg cm^2"),
        quadratic_drag=("3 N s^2/m^2", 3, 3, "0.5 N m s^2", 0.5, 0.5),
    )
    assert np.diag(body.added_mass) == pytest.approx([2, 2, 2, 1, 1, 1])
    assert body.quadratic_drag == pytest.approx([3, 3, 3, 0.5, 0.5, 0.5])


BAD = {
    "negative": (lambda p: SubmergedBody(1, (1, 1, 1), (-3, 0, 0, 0, 0, 0)), "expected a positive matrix"),
    "not symmetric": (lambda p: SubmergedBody(1, (1, 1, 1), np.eye(6) + np.eye(6, k=3)), "expected a symmetric"),
    "triangle": (lambda p: SubmergedBody(1, (1, 1, 3)), "sum of the other two"),
    "shape": (lambda p: SubmergedBody(1, (1, 1, 1), np.eye(3)), "added_mass must be"),
    "five": (lambda p: SubmergedBody(1, (1, 1, 1), (1, 1, 1, 1, 1)), r"six values, three .* \(kg m\^2\), or a 6 x 6"),
    "units of a matrix": (lambda p: SubmergedBody(1, (1, 1, 1), [["1 kg"] * 6] * 6), "matrix of plain values in SI"),
    "drag of all": (lambda p: SubmergedBody(1, (1, 1, 1), linear_drag=2.0), r"six values, three .* \(N s/m\)"),
    "density": (lambda p: SubmergedBody.cylinder(0.1, 1, 30, -1000), "fluid_density must be .* >= 0"),
    "drag": (lambda p: SubmergedBody(1, (1, 1, 1), linear_drag=(-1, 0, 0, 0, 0, 0)), ">= 0"),
    "units": (lambda p: SubmergedBody("3 m", (1, 1, 1)), "dimension of kg"),
    "units of drag": (lambda p: SubmergedBody(1, (1, 1, 1), linear_drag=("1 N s/m",) * 6), "dimension of N m s"),
    "displaced": (lambda p: SubmergedBody(1, (1, 1, 1), displaced_mass=-1), ">= 0"),
    "no file": (lambda p: read_added_mass(p / "none.1"), "text file of values"),
    "words": (lambda p: read_added_mass(_text(p, "a b c")), "text file of values"),
    "rows": (lambda p: read_added_mass(_text(p, "1 2 3")), "six rows of six"),
    "index": (lambda p: read_added_mass(_text(p, "0 7 1 3.0")), "I and J from 1 to 6"),
    "period": (lambda p: read_added_mass(_text(p, "5 1 1 3.0")), "rows of the period 0"),
}


DOUBTS = {
    "g/cm^3": (lambda: SubmergedBody.cylinder(0.1, 1.0, 30.0, 1.025), "Usual cause: g/cm"),
    "g/cm^3 of an ellipsoid": (lambda: SubmergedBody.ellipsoid((1, 0.1, 0.1), 40.0, 1.0), "Usual cause: g/cm"),
    "mm": (lambda: SubmergedBody.ellipsoid((1000, 100, 100), 40.0, 1000), "the body shoots up. .* mm for m"),
    "g": (lambda: SubmergedBody(20.0, (0.1, 1.6, 1.6), displaced_mass=20_000.0), "Usual cause: g for kg"),
    "mm of a centre": (lambda: SubmergedBody(20.0, (0.1, 1.6, 1.6), center_of_mass=(20, 0, -20)), "mm for m, or cen"),
}


@pytest.mark.parametrize("name", DOUBTS)
def test_unlikely_input_is_warned_of(name: str) -> None:
    make, words = DOUBTS[name]
    with pytest.warns(kr.InputWarning, match=words):
        make()


def test_likely_input_is_not_warned_of() -> None:
    """A bubble, a body in air with the unit of its density, a keel."""
    with warnings.catch_warnings(record=True) as doubts:
        warnings.simplefilter("always")
        SubmergedBody.ellipsoid((0.1, 0.1, 0.1), 0.1, 1000.0)
        SubmergedBody.ellipsoid((0.1, 0.1, 0.1), 0.1, "1 kg/m^3")
        SubmergedBody(20.0, (0.1, 1.6, 1.6), center_of_mass=(0, 0, -1.0))
    assert not doubts


def _text(folder: Path, text: str) -> Path:
    path = folder / "file.txt"
    path.write_text(text, "utf-8")
    return path


@pytest.mark.parametrize("name", BAD)
def test_bad_input(name: str, tmp_path: Path) -> None:
    make, words = BAD[name]
    with pytest.raises(kr.InputError, match=words):
        make(tmp_path)
