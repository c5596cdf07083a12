"""Instruments of the laboratory on maps with a known answer, and on the registry."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import pytest

import kreisel as kr
from kreisel.algebra.backend import Complex
from kreisel.lab import brackets, exact, growth, integrals, modular
from kreisel.lab.subject import Subject, subject
from kreisel.record.model import Model
from kreisel.system import REGISTRY
from support import ROOT

F = Fraction
THIRD, QUARTER, STRONG, WEAK = F(1, 3), F(1, 4), F(7, 5), F(3, 7)


def array(*entries: object) -> np.ndarray:
    out = np.empty(len(entries), dtype=object)
    out[:] = entries
    return out


def henon(x, a=STRONG):
    return array(1 + x[1] - a * x[0] * x[0], F(3, 10) * x[0])


def mcmillan(x, a=WEAK):  # integral x^2 y^2 - x^2 - y^2 + a x y
    return array(x[1], a * x[1] / (1 - x[1] * x[1]) - x[0])


def lyness(x, a=2):  # integral (1 + x)(1 + y)(a + x + y)/(x y)
    return array(x[1], (a + x[1]) / x[0])


def hietarinta_viallet(x, a=7):  # confined singularities, and yet entropy log((3 + sqrt 5)/2)
    return array(x[1], x[1] + a / (x[1] * x[1]) - x[0])


def plane(step: object) -> Subject:
    return subject(step, names=("x", "y"))


def naive(x, eps=QUARTER):  # the heavy top by Euler's method
    m, a = x[:3], x[3:]
    dm = array(a[1], -a[0], 0 * a[0])  # p x a turned: m' = a ^ p
    cross = array(m[1] * a[2] - m[2] * a[1], m[2] * a[0] - m[0] * a[2], m[0] * a[1] - m[1] * a[0])
    return np.concatenate([m + eps * dm, a + eps * cross])


def perturbed(x, eps=THIRD):
    """The Lagrange map with a term more in the kick."""
    model = kr.LagrangeTop(p=(0, 0, 1))
    whole = subject(model, eps=eps)
    y = whole.step(x, **whole.constants)
    y[0] = y[0] + eps * x[3] * x[3]
    return y


MODELS = {
    "lagrange-top": (lambda: kr.LagrangeTop(p=(0, 0, 1)), 2),
    "lagrange-top-moving": (lambda: kr.LagrangeTopMoving(A=(0, 0, 1), alpha=F(1, 2)), 2),
    "symmetric-top": (lambda: kr.SymmetricTop(A=(0, 0, 1)), 2),
    "clebsch": (lambda: kr.Clebsch(b=(1, 2, 4)), 4),
    "kirchhoff-revolution": (lambda: kr.KirchhoffRevolution(a1=1, a3=2, c1=1, c3=3), 4),
    "neumann": (lambda: kr.Neumann(b=(1, 2, 4)), 4),
}


def model(name: str) -> Model:
    return MODELS[name][0]()


def test_every_explicit_map_of_the_registry_is_here() -> None:
    maps = {name: system.map for name, system in REGISTRY.items() if system.map is not None}
    first = {known.step: name for name, known in reversed(maps.items()) if known.rational}  # SU(2) has known ones
    others = {*first.values()} - {*MODELS}  # whose investigation takes long: `make investigate`
    page = (ROOT / "docs" / "integrability-registry.md").read_text(encoding="utf-8")
    assert {*MODELS} <= {*first.values()} and "kovalevskaya-gyrostat" in others
    assert [name for name in others if f"`{name}`" not in page] == []


def test_an_implicit_map_is_not_rational() -> None:
    with pytest.raises(kr.InputError, match="implicit"):
        growth.growth(subject(kr.EulerTop(J=(1, 2, 3)), eps=THIRD), 2)


# -- numbers ----------------------------------------------------------------------------------------


def test_residues_are_a_field() -> None:
    p = modular.PRIMES[0]
    draw = modular.random_residues(np.random.default_rng(0), p, 5)
    a, b, c = draw((3,))
    assert ((a * (b + c) - a * b - a * c).v == 0).all()
    assert ((a / b * b - a).v == 0).all()
    assert ((1 / a - a ** (p - 2)).v == 0).all()
    assert ((a**-2 * a * a - 1).v == 0).all()
    assert ((a / F(2, 3) - a * F(3, 2)).v == 0).all()
    with pytest.raises(exact.Pole):
        1 / (a - a)
    for q in (F(3, 7), F(-22, 5), F(0), F(12)):
        assert modular.reconstructed(modular.residue(q, p), p) == q


# -- degrees ----------------------------------------------------------------------------------------


def test_growth_of_known_maps() -> None:
    found = growth.growth(plane(henon), 9)
    assert found.degrees == tuple(2**k for k in range(10))
    assert found.power is None
    assert found.entropy == pytest.approx(math.log(2), abs=1e-12)
    assert not found.drops
    found = growth.growth(plane(mcmillan), 12)
    assert (found.power, found.entropy) == (2, 0)
    assert found.drops[0] == 3
    found = growth.growth(plane(lyness), 24)
    assert (found.power, found.entropy) == (2, 0)


def test_confinement_is_not_enough() -> None:
    """Hietarinta and Viallet's map and its degrees, Phys. Rev. Lett. 81 (1998)."""
    found = growth.growth(plane(hietarinta_viallet), 6)
    assert found.degrees == (1, 3, 9, 27, 73, 195, 513)
    assert found.drops == (4, 5, 6)
    assert abs(found.entropy - math.log((3 + math.sqrt(5)) / 2)) < found.uncertainty < 0.2


@pytest.mark.parametrize("name", MODELS)
def test_degrees_of_integrable_maps_grow_like_squares(name: str) -> None:
    found = growth.growth(subject(model(name), eps=THIRD), 8)
    assert (found.power, found.entropy) == (2, 0)


def test_degrees_by_the_definition_of_degree() -> None:
    """Against numerators and denominators over Q[t] for the first iterates."""
    import sympy

    t = sympy.Symbol("t")
    for step in (mcmillan, lyness, henon):
        x, degrees = array(2 + 3 * t, 5 - 7 * t), growth.degrees(plane(step), 2)
        for k in range(1, 3):
            x = array(*(sympy.cancel(v) for v in step(array(*x))))
            top = sympy.cancel(3 * x[0] + 11 * x[1]).as_numer_denom()
            assert max(sympy.degree(part, t) for part in top) == degrees[k]


def test_negative_powers_are_quotients() -> None:
    """In every ring; on residues x**-1 never ended, and elsewhere it was 1."""

    def by_power(x, a=2):
        return array(x[1], (a + x[1]) * x[0] ** -1)

    assert growth.degrees(plane(by_power), 6) == growth.degrees(plane(lyness), 6)
    assert exact.slopes(exact.independent(array(F(2, 3))) ** -1, 1) == -F(9, 4)  # of 1/x
    number = Complex(F(3), F(4))
    product = number**-1 * number
    assert (product.re, product.im) == (1, 0)


@pytest.mark.parametrize(("step", "expected"), [(naive, math.log((1 + math.sqrt(5)) / 2)), (perturbed, 1.27)])
def test_negative_controls_grow_exponentially(step: object, expected: float) -> None:
    names = ("m1", "m2", "m3", "a1", "a2", "a3")
    found = growth.growth(subject(step, names=names), 6 if step is naive else 4)
    assert found.power is None
    assert found.entropy == pytest.approx(expected, abs=0.02)


def test_a_sequence_without_a_recurrence_is_estimated() -> None:
    found = growth.fitted_growth(tuple(math.floor(1.5**k + 3 * math.sin(k * k)) + 5 for k in range(12)))
    assert found.recurrence is None
    assert abs(found.entropy - math.log(1.5)) < found.uncertainty


# -- integrals --------------------------------------------------------------------------------------


def test_integrals_of_known_maps() -> None:
    (found,) = integrals.integrals(plane(mcmillan), 4)
    assert found.terms == {(2, 2): 7, (2, 0): -7, (0, 2): -7, (1, 1): 3}
    assert str(found) == "7 x^2 y^2 - 7 x^2 + 3 x y - 7 y^2"
    assert integrals.integrals(plane(henon), 5, quotients=True) == []
    assert integrals.integrals(plane(lyness), 3) == []
    (quotient,) = integrals.integrals(plane(lyness), 3, quotients=True)

    def known(x, y):
        return (1 + x) * (1 + y) * (2 + x + y) / (x * y)

    for x, y in ((F(2, 7), F(5, 3)), (F(-4), F(1, 9))):  # equal up to a constant
        assert quotient(array(x, y)) - known(x, y) == quotient(array(F(1), F(1))) - known(1, 1)


@pytest.mark.parametrize("name", MODELS)
def test_the_complete_set_is_found_unaided(name: str) -> None:
    """As many as the record claims, on fresh orbits over Q; those of the record are functions of them."""
    what, degree = subject(model(name), eps=THIRD), MODELS[name][1]
    found = integrals.integrals(what, degree)
    assert len(found) == 4
    draw = exact.rational_random(np.random.default_rng(1))
    x = np.vectorize(exact.fraction, otypes=[object])(what.point(draw))
    y = what.step(what.step(x, **what.constants), **what.constants)
    for f in found:
        assert f(x) == f(y) != f(x + 1)


def test_a_perturbed_map_has_fewer() -> None:
    names = ("m1", "m2", "m3", "a1", "a2", "a3")
    found = integrals.integrals(subject(perturbed, names=names), 3)
    assert [str(f) for f in found] == ["m3", "a1^2 + a2^2 + a3^2"]


def test_products_and_functions_of_integrals_are_left_out() -> None:
    found = integrals.integrals(subject(model("lagrange-top"), eps=THIRD), 4)
    assert [str(f) for f in found] == [
        "m3",
        "m1 a1 + m2 a2 + m3 a3",
        "a1^2 + a2^2 + a3^2",
        "3 m1^2 - m1 a2 + 3 m2^2 + m2 a1 + 6 a3",
    ]


# -- brackets and volumes ---------------------------------------------------------------------------


@pytest.mark.parametrize("name", [name for name in MODELS if name != "neumann"])
def test_the_bracket_is_found_and_is_poisson(name: str) -> None:
    chosen = model(name)
    what = subject(chosen, eps=THIRD)
    assert brackets.defect(what, what.tensor) == 0
    assert brackets.defect(what, lambda x: what.tensor(x) * x[0]) > 0
    found = brackets.brackets(what, 1)
    assert found[0].poisson
    assert "{" in str(found[0])
    assert {pair: str(f) for pair, f in found[0].entries.items()}[(0, 1)] in ("m3", "-m3", "M3", "-M3")
    assert [str(v) for v in brackets.volumes(what, 0)] == ["(1) dx"]


def test_areas_of_the_plane() -> None:
    assert [str(v) for v in brackets.volumes(plane(mcmillan), 1)] == ["(1) dx"]
    assert [str(v) for v in brackets.volumes(plane(lyness), 2)] == ["dx / (x y)"]
    assert brackets.volumes(plane(henon), 3) == []
    assert [str(b) for b in brackets.brackets(plane(lyness), 2)] == ["{x, y} = x y"]


# -- input ------------------------------------------------------------------------------------------


def test_maps_that_are_not_rational_are_named() -> None:
    for step in (lambda x: array(np.sqrt(x[0]), x[1]), lambda x: array(x[0] if x[0] > 1 else x[1], x[1])):
        with pytest.raises(kr.InputError, match="rational"):
            growth.growth(plane(step), 2)
    with pytest.raises(kr.InputError, match="must return 2 values"):
        growth.growth(plane(lambda x: x[:1]), 2)
    with pytest.raises(kr.InputError, match="names of its coordinates"):
        subject(lambda x: x)
    with pytest.raises(kr.InputError, match="divides by 0"):
        growth.growth(plane(lambda x: array(x[0] / (x[1] - x[1]), x[1])), 2)
    with pytest.raises(kr.InputError, match="monomials"):
        integrals.integrals(subject(model("clebsch")), 30)
    with pytest.raises(kr.InputError, match="too large to be found"):
        integrals.integrals(plane(lambda x: mcmillan(x, a=F(10**12 + 39, 10**13 + 37))), 4)
