"""Hirota-Kimura bases: what the literature has of Kahan's maps comes out, and nothing where there is nothing."""

from __future__ import annotations

from fractions import Fraction as F
from typing import Any

import numpy as np
import pytest

import kreisel as kr
from kreisel.lab import search
from kreisel.lab.darboux import bases
from kreisel.lab.subject import subject
from sizes import FULL

# combinations of degree 2, and the integrals that their coefficients are
KNOWN = [
    (lambda: kr.EulerTop(J=(1, 2, 4)), 2, 2),
    (lambda: kr.EulerTop(J=(1, 2, 4, 7)), 4, 4),  # so(4): four quadrics
    (lambda: kr.ZhukovskyVolterra(J=(1, 2, 4), h=(0, 1, 0)), 2, 2),
    (lambda: kr.ZhukovskyVolterra(J=(1, 2, 4), h=(1, 2, 3)), 0, 0),  # not integrable without an adjustment
    (lambda: kr.LagrangeTop(p=(0, 0, 1)), 10, 4),  # 7 of them are multiples of a linear one
    (lambda: kr.KovalevskayaTopE3(), 0, 0),
]
KNOWN += [  # Clebsch, n = 3, has four in an investigation below
    (lambda: kr.ZhukovskyVolterra(J=(1, 2, 4), h=(1, 2, 0)), 1, 1),
    (lambda: kr.Clebsch(b=(1, 2, 4)), 4, 4),  # four quadrics
    (lambda: kr.LagrangeTopMoving(A=(0, 0, 1), alpha=F(1, 2)), 10, 4),
    (lambda: kr.ClebschGeneral(a=(1, 4, 9), b=(1, 2, 3)), 4, 4),  # a flow that commutes with Clebsch's
    (lambda: kr.KirchhoffRevolution(a1=1, a3=2, c1=1, c3=3), 10, 4),
    (lambda: kr.LagrangeTop(p=(0, 0, 0, 1)), 32, 6),
    (lambda: kr.Clebsch(b=(1, 2, 4, 7)), 1, 1),
] * FULL


@pytest.mark.parametrize(("make", "combinations", "count"), KNOWN)
def test_bases_of_degree_2(make: Any, combinations: int, count: int) -> None:
    found = bases(search.kahan_map(make()), 2)
    assert (found.combinations, found.integrals) == (combinations, count)
    assert f"{count} independent integrals" in str(found)


def test_investigations_count_them_where_others_are_too_few() -> None:
    """Four in six dimensions do not decide; two in three, with a volume, do."""
    page = kr.lab.investigate(search.kahan_map(kr.Clebsch(b=(1, 2, 4))), iterates=6, steps=1000)
    assert page.verdict == "undecided" and "4 as coefficients of Hirota-Kimura bases" in page.reason
    page = kr.lab.investigate(search.kahan_map(kr.ZhukovskyVolterra(J=(1, 2, 4), h=(0, 1, 0))), steps=1000)
    assert page.verdict == "integrable"


def test_coefficients_in_involution_fill_the_leaves_of_a_bracket() -> None:
    """V = (x^2 + y^2)/2 + x^2 y + c y^3/3 of Henon and Heiles separates in x + y and x - y for c = 1, not for c = 2.

    Kahan's method commutes with linear changes of the coordinates.
    """

    def family(c: int) -> Any:
        return search.kahan(
            lambda z: [z[2], z[3], -z[0] - 2 * z[0] * z[1], -z[1] - z[0] * z[0] - c * z[1] * z[1]], ("x", "y", "p", "q")
        )

    first, second = search.search(family, {"c": [2, 1]}, degree=1, iterates=6, steps=0).scores
    assert (first.parameters["c"], first.verdict, first.on_leaf, first.needed) == (1, "integrable", 2, 2)
    assert not second.integrable and second.entropy > 0.5


@pytest.mark.parametrize("h", [(2, 3, 0), (0, -3, 0), (F(-1, 2), 5, 0)])
@pytest.mark.parametrize("eps", [F(1, 3), F(-5, 2)])
def test_the_adjusted_map_of_a_gyrostat_is_integrable(h: Any, eps: F) -> None:
    """Two integrals, exactly over Q, and the step back; with another share of the adjustment they change."""
    rng, w, k = np.random.default_rng(4), np.array([F(1), F(1, 2), F(1, 4)], dtype=object), eps * eps / 4
    wheel = np.array([F(v) for v in h], dtype=object)
    base = np.array([wheel[i] * w[2] / (w[i] - w[2]) for i in (0, 1)] + [F(0)], dtype=object)

    def integrals(M: Any) -> list[F]:
        D = 1 - k * (w[0] - w[2]) * (w[2] - w[1]) * M[2] * M[2]
        forms = (lambda x: (x + wheel) @ (x + wheel), lambda x: x @ (w * x))
        return [(f(M) - f(base)) / D for f in forms]

    M = np.array([F(int(v), 7) for v in rng.integers(1, 9, 3)], dtype=object)
    for share, holds in ((1, True), (F(1, 2), False), (-1, False)):
        adjusted = search.adjusted_gyrostat(h, eps=eps, share=share)
        new = adjusted.step(M)
        assert (integrals(new) == integrals(M)) == holds
        assert (search.adjusted_gyrostat(h, eps=-eps, share=share).step(new) == M).all()
    rate = search.kahan_gyrostat(h, eps=F(1, 10**9)).step(M) - search.adjusted_gyrostat(h, eps=F(1, 10**9)).step(M)
    assert 0 < max(abs(rate)) < F(1, 10**24)


def test_bases_of_the_adjusted_map() -> None:
    found = bases(search.adjusted_gyrostat())
    assert (found.combinations, found.integrals) == (2, 2)
    assert bases(search.adjusted_gyrostat(share=0)).integrals == 1
    with pytest.raises(kr.InputError, match="h_3 = 0"):
        search.adjusted_gyrostat((1, 2, 3))


def test_integrals_of_a_polynomial_and_none_of_a_spoiled_map() -> None:
    """McMillan's map has one integral of degree 4; Euler's method of the Euler top has no combination of degree 2."""
    found = bases(subject(lambda x: np.array([x[1], 2 * x[1] / (1 - x[1] * x[1]) - x[0]]), names=("x", "y")), 4)
    assert (found.combinations, found.integrals) == (1, 1)

    def euler(x: Any) -> Any:
        return np.array([x[0] + x[1] * x[2], x[1] - 2 * x[0] * x[2], x[2] + 3 * x[0] * x[1], None], dtype=object)[:-1]

    assert bases(subject(euler, names=("x", "y", "z")), 2).combinations == 0
    with pytest.raises(kr.InputError, match="monomials"):
        bases(search.kahan_map(kr.Clebsch(b=(1, 2, 4))), 9)
