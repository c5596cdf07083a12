"""Maps with a known answer: verdicts of a part of them, the page of all, and Darboux polynomials over Q."""

from __future__ import annotations

import math
from fractions import Fraction as F

import numpy as np
import pytest

from kreisel.algebra import objects
from kreisel.errors import InputError
from kreisel.lab import darboux as darboux_module, growth, integrals
from kreisel.lab.darboux import darboux
from kreisel.lab.exact import independent, slopes
from kreisel.lab.growth import singularities
from kreisel.lab.subject import Subject, subject
from sizes import FULL
from support import ROOT, docs_tool

known_maps = docs_tool("known_maps")
SLOWER = ("Lyness, a = 2", "asymmetric QRT", "QRT, multiplicative", "Kahan, Lotka and Volterra", "Kahan, Lorenz")
SLOWER += ("Kovalevskaya", "Kovalevskaya, a neighbour")
PUBLISHED = ("Kahan, Nahm's equations", "Kahan, Volterra's chain", "Kahan, the dressing chain")
# tests/lab/test_published_maps.py has these
LEFT = SLOWER if FULL else SLOWER + PUBLISHED
QUICK = [known for known in known_maps.MAPS if known.name not in LEFT]


@pytest.mark.parametrize("known", QUICK, ids=lambda known: known.name)
def test_verdict(known) -> None:
    assert known_maps.looked_at(known, 1000)[0].verdict == known.answer


def test_the_page_has_all_maps_and_no_other_verdict() -> None:
    page = (ROOT / "docs" / "integrability-known.md").read_text(encoding="utf-8")
    rows = [line.split(" | ") for line in page.splitlines() if line.startswith("| ")][1:]
    assert [(row[0], row[4]) for row in rows] == [
        (f"| {known.name}", f"**{known.answer}**") for known in known_maps.MAPS
    ]
    assert len(rows) >= 30 and sum(known.answer == known_maps.OPEN for known in known_maps.MAPS) <= 5


def of_name(name: str) -> Subject:
    (known,) = (known for known in known_maps.MAPS if known.name == name)
    return subject(known.step, names=tuple(known.names))


def rational_point(dim: int, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    out = np.empty(dim, dtype=object)
    out[:] = [F(int(rng.integers(1, 20)), int(rng.integers(1, 9))) for _ in range(dim)]
    return out


def value(product, x):
    return math.prod((P(x) ** k for P, k in product.factors), start=F(1))


@pytest.mark.parametrize(
    ("name", "degree", "count"),
    [
        ("Kahan, Euler's top", 2, 2),
        ("Lyness, a = 2", 3, 1),
        ("linear, a saddle", 1, 1),
        ("Lyness, order 3, a = 2", 4, 2),
    ],
)
def test_darboux_polynomials_over_q(name: str, degree: int, count: int) -> None:
    what = of_name(name)
    found = darboux(what, degree)
    assert len(integrals.without_dependent(what, list(found.integrals))) == count and found.densities
    assert {type(k) for _, powers in found.cofactors for k in powers} <= {int}  # a Fraction has no powers of flint's
    for seed in (0, 1):
        x = rational_point(what.dim, seed)
        duals = what.step(independent(x))
        new = np.array([v.value for v in duals], dtype=object)
        (a, b, *c) = slopes(duals, what.dim).astype(object)
        det = a[0] * b[1] - a[1] * b[0] if not c else np.dot(a, np.cross(b, c[0]))
        for P, (number, powers) in zip(found.polynomials, found.cofactors, strict=True):
            assert P(new) == number * math.prod(f(x) ** k for f, k in zip(found.factors, powers, strict=True)) * P(x)
        assert all(value(f, new) == value(f, x) != value(f, x + 1) for f in found.integrals)
        assert all(abs(value(D, new)) == abs(det * value(D, x)) for D in found.densities)


def test_a_spoiled_map_has_no_darboux_integral() -> None:
    def spoiled(x):
        return np.array([x[1], (2 + x[1]) / x[0] + x[1] / 7], dtype=object)

    assert not darboux(subject(spoiled, names=("x", "y")), 3).integrals
    with pytest.raises(InputError, match="not invertible"):
        darboux(subject(lambda x: np.array([x[0], 2 * x[0]], dtype=object), names=("x", "y")), 2)


@pytest.mark.parametrize(
    ("name", "orbit", "confined"),
    [
        ("Hietarinta and Viallet", "y = 0: (*, 0) -> (0, oo) -> (oo, oo) -> (oo, 0) -> (0, *)", 4),
        ("McMillan, other sign", "y + 1 = 0: (*, -1) -> (-1, oo) -> (oo, 1) -> (1, *)", 3),
        ("Lyness, a = 1", "y + 1 = 0: (*, -1) -> (-1, 0) -> (0, -1) -> (-1, *)", 3),
        ("McMillan, spoiled", "y^4 + 1 = 0: (*, c) -> (c, oo) -> (oo, c)", 0),
    ],
)
def test_singularities_and_their_orbits(name: str, orbit: str, confined: int) -> None:
    found = {str(s): s.confined for s in singularities(of_name(name))}
    (text,) = (text for text in found if text.startswith(orbit))
    assert found[text] == confined
    assert text.endswith("not confined in 12 steps") == (confined == 0)


def test_singularities_of_a_map_whose_constants_have_names() -> None:
    """As of the map that contains their values; they are residues, which series did not accept."""

    def lyness(x, a=1):
        return objects([x[1], (a + x[1]) / x[0]])

    by_name = singularities(subject(lyness, names=("x", "y"), a=F(1)))
    assert [str(s) for s in by_name] == [str(s) for s in singularities(of_name("Lyness, a = 1"))]


def test_a_polynomial_automorphism_has_no_singularity() -> None:
    assert singularities(of_name("Hénon, area-preserving")) == []
    with pytest.raises(InputError, match="plane"):
        singularities(of_name("Kahan, Lorenz"))


def test_a_cubic_growth_is_not_exponential() -> None:
    cubic = tuple(1 + k * (k * k + 2) // 3 + (k % 5 == 0) for k in range(10))  # without a recurrence in so few
    found = growth.fitted_growth(cubic)
    assert found.recurrence is None and not found.exponential
    assert growth.fitted_growth(tuple(int(1.6**k) + k % 3 for k in range(14))).exponential
    assert growth.growth(of_name("skew product over McMillan's"), 14).power == 3


@pytest.mark.parametrize("after", [0, 1])
def test_six_degrees_tell_a_quadratic(after: int) -> None:
    """2k^2 + 1, as of many maps of the plane, has entropy 0; with one term less nothing is claimed."""
    d = (*(5,) * after, *(2 * k * k + 1 for k in range(6)))
    found = growth.fitted_growth(d)
    assert (found.power, found.entropy, found.uncertainty, found.after) == (2, 0.0, 0.0, after)
    assert "growth like k^2, entropy 0" in found.verdict
    few = growth.fitted_growth(d[:-1])
    assert few.recurrence is None and "entropy" not in few.verdict
    assert (
        growth.fitted_growth((1, 2, 4, 8, 16, 31)).power != 2
    )  # 16 regions of a circle: a polynomial of degree 4 later


def test_the_cofactor_det_f_is_tried_first(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every biquadratic of the pencil of a QRT map is an inverse density. [Quispel, Roberts, Thompson 1988]

    det f' has powers of five factors, more than the hundreds of smaller products: this map was undecided.
    """
    monkeypatch.setattr(darboux_module, "MOST_COFACTORS", 1)
    A, B = np.array([[0, 0, 0], [-1, 2, -1], [1, -1, 0]]), np.array([[2, -2, 1], [0, 1, 1], [-1, 1, 1]])

    def other_root(x, y, A, B):  # of (x^2, x, 1) (A + t B) (y^2, y, 1) for the same y and t
        Y = np.array([y * y, y, 1], dtype=object)
        f = np.cross(A.astype(object) @ Y, B.astype(object) @ Y)
        return (f[0] - x * f[1]) / (f[1] - x * f[2])

    def step(x):
        new = other_root(x[0], x[1], A, B)
        return objects([new, other_root(x[1], new, A.T, B.T)])

    found = darboux(subject(step, names=("x", "y")), 4)
    assert len(found.polynomials) == 2 and len(found.integrals) == 1 and found.densities
    for seed in (0, 1):
        x = rational_point(2, seed)
        duals = step(independent(x))
        new, (a, b) = np.array([v.value for v in duals], dtype=object), slopes(duals, 2).astype(object)
        det = a[0] * b[1] - a[1] * b[0]
        assert all(abs(P(new)) == abs(det * P(x)) for P in found.polynomials)
        assert all(value(f, new) == value(f, x) != value(f, x + 1) for f in found.integrals)
