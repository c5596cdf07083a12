"""Orbits in the laboratory: certified enclosures, heights, cycles modulo primes, proofs, tangent maps, sections."""

from __future__ import annotations

import itertools
import math
from fractions import Fraction

import numpy as np
import pytest

import kreisel as kr
from kreisel.lab import certified, dynamics, growth
from kreisel.lab.exact import independent, slopes
from kreisel.lab.subject import Subject, subject

F = Fraction
QUARTER = F(1, 4)
TOP = subject(kr.LagrangeTop(p=(0, 0, 1)), eps=F(1, 4))
START = [F(1, 10), F(1, 5), F(3, 2), F(3, 5), F(0), F(4, 5)]


def array(*entries: object) -> np.ndarray:
    out = np.empty(len(entries), dtype=object)
    out[:] = entries
    return out


def mcmillan(x):  # integral x^2 y^2 + x^2 + y^2 - (3/2) x y
    return array(x[1], F(3, 2) * x[1] / (1 + x[1] * x[1]) - x[0])


def area(x):  # Henon's, area-preserving
    return array(1 + x[1] - 2 * x[0] * x[0], -x[0])


def cat(x):  # linear, exponents +- log((3 + sqrt 5)/2)
    return array(2 * x[0] + x[1], x[0] + x[1])


def plane(step) -> Subject:
    return subject(step, names=("x", "y"))


# -- certified ----------------------------------------------------------------------------------------


def escaped(steps: int, radius: Fraction = QUARTER) -> int:
    """How many corners of a box about START, mapped exactly, are not in the enclosures claimed for them."""
    import flint

    enclosures = [
        certified.certify(TOP, START, k, radius=radius, tolerance=100, precision=64) for k in range(1, steps + 1)
    ]
    assert all(t.steps == k for k, t in enumerate(enclosures, 1))
    lost = 0
    for corner in itertools.product((-1, 1), repeat=6):
        orbit = growth.exact_orbit(TOP, [v + s * radius for v, s in zip(START, corner, strict=True)], steps)
        for k, enclosed in enumerate(enclosures, 1):
            exact = [flint.arb(flint.fmpq(v.numerator, v.denominator)) for v in orbit[k]]
            lost += not all(ball.contains(v) for ball, v in zip(enclosed.enclosure, exact, strict=True))
    return lost


def test_enclosures_contain_what_they_enclose(monkeypatch: pytest.MonkeyPatch) -> None:
    assert escaped(2) == 0
    middle = certified.slopes  # an instrument that takes the derivative at the middle only must be caught
    monkeypatch.setattr(
        certified, "slopes", lambda images, d: np.array([[v.mid() for v in row] for row in middle(images, d)])
    )
    monkeypatch.setattr(certified, "_intersection", lambda a, b: a)
    assert escaped(2) > 0


def test_certified_steps_and_integrals() -> None:
    few = certified.certify(TOP, START, 400, precision=40, tolerance=1e-6, plain=True)
    assert few.plain is not None and few.plain < few.steps < 400 and "wider" in few.stopped
    many = certified.certify(TOP, START, 400, precision=128)
    assert many.steps == 400 and many.radius < 1e-30
    low, high = many.integrals["energy"]
    energy = float(TOP.energy(np.array(START, dtype=object), **TOP.constants))
    assert low <= energy <= high and high - low < 1e-14
    point = dynamics.points(TOP, np.array(START, dtype=float), 400)[-1]
    assert abs(point - many.middle).max() < 1e-11
    assert "certified" in str(many)


def test_an_integral_that_is_none_is_seen() -> None:
    enclosure = certified.certify(TOP, START, 30, functions={"m1": lambda x: x[0]})
    assert enclosure.integrals["m1"][1] - enclosure.integrals["m1"][0] > 0.1


def test_certified_complains() -> None:
    with pytest.raises(kr.InputError, match="implicit"):
        certified.certify(subject(kr.EulerTop(J=(1, 2, 3))), [1, 2, 3])
    with pytest.raises(kr.InputError, match="shape"):
        certified.certify(TOP, [1, 2])
    with pytest.raises(kr.InputError, match="precision"):
        certified.certify(TOP, START, precision=3)
    with pytest.raises(kr.InputError, match="steps must be an integer"):  # 1.5 steps were any number
        certified.certify(TOP, START, 1.5)
    for radius, tolerance in ((-1, 1), (1, QUARTER), (0, 0)):
        with pytest.raises(kr.InputError, match="a radius from 0"):
            certified.certify(TOP, START, 2, radius=radius, tolerance=tolerance)
    pole = certified.certify(plane(lambda x: array(1 / (x[0] - 1), x[1])), [F(1), F(1)], 5)
    assert pole.steps == 0 and "pole" in pole.stopped


# -- exact fields ---------------------------------------------------------------------------------------


def test_heights() -> None:
    found = growth.heights(TOP, START, 16)
    assert 1.5 < found.power < 2.3
    assert abs(growth.heights(plane(area), [F(1, 2), F(1, 3)], 12).entropy - math.log(2)) < 0.01
    with pytest.raises(kr.InputError, match="pole at step 1"):
        growth.heights(plane(lambda x: array(1 / x[0], x[1])), [0, 1], 3)


def test_cycles_modulo_primes() -> None:
    """On curves of genus 1 they obey Hasse and Weil; those of Henon's area-preserving map are those of a random one."""
    for p in (101, 211):
        good, bad = (growth.cycles(plane(step), p, 200, limit=p * p) for step in (mcmillan, area))
        assert good.longest <= good.hasse_weil < 2 * p < bad.longest
        assert good.open == bad.open == 0 and good.poles + len(good.lengths) == 200
    with pytest.raises(kr.InputError, match="prime"):
        growth.cycles(plane(area), 100)
    with pytest.raises(kr.InputError, match="another prime"):
        growth.cycles(subject(kr.LagrangeTop(p=(0, 0, 1)), eps=F(1, 101)), 101)


def test_proofs() -> None:
    for proof in certified.prove(kr.LagrangeTop(p=(0, 0, 1)), ("casimir", "energy", "noether")):
        assert proof.holds and "eps" in proof.unknowns
    from dataclasses import replace

    top = kr.LagrangeTop(p=(0, 0, 1))
    plain = replace(top.system, energy=lambda m, a, *, p: top.system.energy(m, a, p=p))
    assert [p.holds for p in certified.prove(plain(p=(0, 0, 1)))] == [True, False]  # the undeformed energy is not kept
    with pytest.raises(kr.InputError, match="states no"):
        certified.prove(kr.LagrangeTop, ("spin",))
    with pytest.raises(kr.InputError, match="rational"):
        certified.prove(kr.EulerTop)


# -- floats ---------------------------------------------------------------------------------------------


def test_the_recorded_tangent_map_is_the_jacobian() -> None:
    x = dynamics.float_start(TOP, 1)
    orbit = dynamics.CompiledOrbit(TOP, x, np.eye(6))
    new = orbit.advance(1)[0]
    images = TOP.step(independent(x), **TOP.floats)
    assert np.allclose(orbit.vectors.T, np.asarray(slopes(images, 6), dtype=float), rtol=1e-13, atol=1e-14)
    assert np.allclose(new, [v.value for v in images], rtol=1e-13)


def test_the_tangent_map_of_a_lagrangian_in_jax_is_a_difference_of_runs() -> None:
    jnp = pytest.importorskip("jax.numpy")
    from kreisel import reduction as red

    def lagrangian(Omega, P, *, c):
        return -jnp.trace(Omega @ (jnp.array([0.3, 0.9, 1.5])[:, None] * Omega)) / 2 - c * (P[2] + P[0])

    model = red.system("jax-body", group=red.SO(3), lagrangian=lagrangian)(c=1.0)
    x, dt = np.array([0.1, 0.2, 0.5, 0.6, 0.0, 0.8]), 0.1

    h = 1e-5
    starts = np.concatenate([[x], x + h * np.eye(6), x - h * np.eye(6)])
    last = kr.simulate(model, model.state(M=starts[:, :3], P=starts[:, 3:]), dt=dt, steps=5).isel(time=-1)
    end, *ends = np.concatenate([last.M, last.P], -1)
    orbit = dynamics.CompiledOrbit(subject(model, eps=F(1, 10)), x, np.eye(6))
    assert orbit.advance(5)[-1] == pytest.approx(end, abs=1e-12)
    above, below = np.reshape(ends, (2, 6, 6))
    assert orbit.vectors == pytest.approx((above - below) / (2 * h), abs=1e-7)


def test_lyapunov_exponents_with_a_known_answer() -> None:
    whole = Subject("cat", lambda x: cat(x), ("x", "y"), start=None)
    found = dynamics.dynamics(whole, np.zeros(2), 2000)
    assert np.allclose(
        found.exponents, [math.log((3 + math.sqrt(5)) / 2), -math.log((3 + math.sqrt(5)) / 2)], atol=1e-12
    )
    assert found.chaotic and found.sali < 1e-12


def test_henon_attractor() -> None:
    """Exponents 0.41922 and log 0.3 - 0.41922; their sum is log |det J| = log 0.3."""
    henon = plane(lambda x: array(1 + x[1] - F(7, 5) * x[0] * x[0], F(3, 10) * x[0]))
    found = dynamics.dynamics(henon, np.array([0.1, 0.1]), 8000)
    assert found.chaotic and abs(found.exponents[0] - 0.4192) < 4 * found.errors[0] < 0.03
    assert abs(found.exponents.sum() - math.log(0.3)) < 1e-8


def test_regular_orbits_are_not_called_chaotic() -> None:
    for what, x in ((plane(mcmillan), np.array([0.4, 0.1])), (TOP, None)):
        found = dynamics.dynamics(what, x, 4000)
        assert found.regular and not found.chaotic
        assert abs(found.exponents.sum()) < 1e-6


def test_gali_of_a_regular_orbit_falls_by_known_powers() -> None:
    """On a torus of N = 2 dimensions in 4 GALI_j is constant for j <= N, t^(-2 (j - N)) beyond (Skokos 2007)."""
    twist = Subject("twist", lambda x: array(x[0] + x[1], x[1], x[2] + x[3], x[3]), ("q", "p", "r", "s"), start=None)
    first, last = (dynamics.dynamics(twist, np.zeros(4), steps).gali for steps in (2000, 16_000))
    assert np.allclose(np.log(first / last) / np.log(8), [0, 2, 4], atol=0.01) and first[0] > 0.1


def test_gali_of_a_hyperbolic_orbit_falls_by_its_exponents() -> None:
    """Like exp(-k sum_i (s_1 - s_i)): here the exponents are s, 0, -s with s = log(51/50)."""
    saddle = Subject("saddle", lambda x: array(F(51, 50) * x[0], x[1], F(50, 51) * x[2]), ("x", "y", "z"), start=None)
    first, last = (dynamics.dynamics(saddle, np.zeros(3), steps).gali for steps in (1000, 1100))
    assert np.allclose(np.log(first / last) / (100 * math.log(1.02)), [1, 3], atol=1e-3)


def test_an_orbit_that_escapes_is_named() -> None:
    with pytest.raises(kr.RunError, match="escapes"):
        dynamics.dynamics(plane(area), np.array([3.0, 3.0]), 2000)
    with pytest.raises(kr.InputError, match="finite values"):
        dynamics.dynamics(plane(area), np.array([np.nan, 0]), 2000)
    with pytest.raises(kr.InputError, match="recorded"):
        dynamics.dynamics(plane(lambda x: array(np.arctan(x[0]), x[1])), np.array([0.1, 0.2]), 2000)


def test_a_step_may_have_sines() -> None:
    """Chirikov's standard map at K = 5: Lyapunov's exponent is near log(K/2), and areas stay."""

    def standard(x):
        p = x[1] + 5 * np.sin(x[0])
        return array(x[0] + p, p)

    found = dynamics.dynamics(plane(standard), np.array([0.1, 0.2]), 4000)
    assert found.chaotic and abs(found.exponents[0] - math.log(2.5)) < 0.25
    assert abs(found.exponents.sum()) < 1e-4


def test_frequencies_of_a_rotation() -> None:
    turn = plane(lambda x: array(F(3, 5) * x[0] - F(4, 5) * x[1], F(4, 5) * x[0] + F(3, 5) * x[1]))
    lines = dynamics.frequencies(turn, np.array([1.0, 0.0]), 4096, lines=1)
    assert abs(lines.frequency[0] - math.acos(0.6)) < 1e-12


def test_sections_keep_the_integrals_of_the_map() -> None:
    """Points of the section lie where the integrals have their values, and on the section."""
    what = subject(kr.LagrangeTop(p=(0, 0, 1)), eps=F(1, 10))
    x = np.array(START, dtype=float)
    times, found = dynamics.section(what, lambda x: x[..., 3], x, 4000)
    assert len(times) > 20 and abs(found[:, 3]).max() < 1e-13
    known = what.floats
    energy = np.array([what.energy(point, **known) for point in found])
    assert abs(energy - what.energy(x, **known)).max() < 1e-11
    with pytest.raises(kr.InputError, match="too far apart"):
        dynamics.section(subject(kr.LagrangeTop(p=(0, 0, 1)), eps=F(3, 2)), lambda x: x[..., 3], x, 400)
