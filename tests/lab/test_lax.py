"""The Lax tester: FORMULAS' table of ranks, and pairs that are wrong."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

import kreisel as kr
from kreisel import algebra
from kreisel.algebra import skew
from kreisel.lab.brackets import lax
from kreisel.lab.paper.clebsch import printed_pencil
from kreisel.lab.paper.tops import printed_conjugator
from kreisel.lab.subject import Subject, subject
from kreisel.record.calling import call

F = Fraction
EPS = F(2, 3)


def clebsch(n: int) -> Subject:
    return subject(kr.Clebsch(b=tuple(2**i for i in range(n))), eps=EPS)


def axis(n: int) -> tuple[int, ...]:
    return (0,) * (n - 1) + (1,)


def rest(n: int) -> Subject:
    return subject(kr.LagrangeTop(p=axis(n)), eps=EPS)


def moving(n: int) -> Subject:
    return subject(kr.LagrangeTopMoving(A=axis(n), alpha=F(7, 10)), eps=EPS)


def manakov(n: int):
    """Traces of powers of the block pi m pi + t D in so(n-1): a commuting family."""

    def family(x, **known):
        m = x[: n * (n - 1) // 2] if n > 3 else np.array([-x[2], x[1], -x[0]], dtype=object)
        block, D, out = skew(m, n)[:-1, :-1], np.diag(np.arange(1, n)).astype(object), []
        for t in (2, 3, 4):
            A = power = block + t * D
            for _ in range(n - 2):
                power = power @ A
                out.append(np.trace(power))
        return np.array(out, dtype=object)

    return family


# n, dimension, Casimirs, leaf, needed, Clebsch, Lagrange, with Noether's, torus, with Manakov's family
TABLE = [(3, 6, 2, 4, 2, 2, 2, 2, 2, 2), (4, 10, 2, 8, 4, 4, 3, 5, 3, 4), (5, 15, 3, 12, 6, 6, 4, 8, 4, 6)]
TABLE += [(6, 21, 3, 18, 9, 9, 5, 13, 5, 9)]


@pytest.mark.parametrize("row", TABLE, ids=lambda row: f"n={row[0]}")
def test_the_table_of_ranks(row: tuple[int, ...]) -> None:
    n, dimension, casimirs, leaf, needed, *ranks = row
    result = lax(clebsch(n))
    sizes = result.dimension, result.dimension - result.leaf, result.leaf, result.needed
    assert sizes == (dimension, casimirs, leaf, needed)
    assert (result.equation, result.isospectral, result.involution, result.complete) == (True, True, True, True)
    assert result.on_leaf == ranks[0] and result.rank == ranks[0] + casimirs
    for top in (rest(n), moving(n)):
        result = lax(top)
        assert (result.equation, result.isospectral, result.involution) == (True, True, True)
        assert [result.on_leaf, result.with_more, result.torus] == ranks[1:4]
        assert result.complete == (n == 3)
        assert result.superintegrable == (n > 3)
        family = lax(top, more=manakov(n))
        assert (family.with_more, family.torus) == (ranks[4], needed)


def test_three_equal_parameters_are_not_complete() -> None:
    """Erratum E17."""
    assert lax(subject(kr.Clebsch(b=(1, 1, 2, 3)), eps=EPS)).complete
    assert not lax(subject(kr.Clebsch(b=(1, 1, 1, 2)), eps=EPS)).complete


def of_record(function, kinds=("skew", "vector"), n=3):
    def wrapped(x, lam, **known):
        flip = np.array([-x[2], x[1], -x[0]], dtype=object)
        state = algebra.restore(np.concatenate([flip, x[3:]]), kinds, n)
        return call(function, state, {**known, "lam": lam})

    return wrapped


def test_printed_pairs_fail() -> None:
    """Erratum E2: V of section 6.2 spoils the equation; E10: L of section 7 the spectrum for |P| != 1."""
    top = moving(3)
    ranks = lax(top, L=top.lax, V=of_record(printed_conjugator))
    assert ranks.isospectral and ranks.equation is False and not ranks.conserved
    printed = of_record(lambda M, P, *, b, lam, eps: printed_pencil(M, P, b=b, lam=lam, eps=eps))
    ranks = lax(clebsch(3), L=printed)
    assert ranks.isospectral is False and ranks.equation is None and not ranks.complete


def test_a_pair_of_ones_own() -> None:
    """A rotation of the plane: a matrix with the determinant lam^2 - x^2 - y^2, and one that knows x alone."""

    def turn(x):
        return np.array([F(3, 5) * x[0] - F(4, 5) * x[1], F(4, 5) * x[0] + F(3, 5) * x[1]], dtype=object)

    own = Subject("turn", turn, ("x", "y"), tensor=lambda x: np.array([[0, 1], [-1, 0]], dtype=object))

    def L(x, lam):
        return np.array([[x[0], x[1] + lam], [x[1] - lam, -x[0]]], dtype=object)

    ranks = lax(own, L=L)
    assert ranks.isospectral and ranks.complete and ranks.on_leaf == 1
    ranks = lax(own, L=lambda x, lam: np.array([[x[0], lam], [x[1], 0 * x[0]]], dtype=object))
    assert ranks.isospectral is False and ranks.involution is False


def test_what_cannot_be_tested_is_unknown() -> None:
    own = Subject("own", lambda x: x, ("x", "y"))
    with pytest.raises(kr.InputError, match="no Lax matrix"):
        lax(own)
    with pytest.raises(kr.InputError, match="square"):
        lax(own, L=lambda x, lam: np.array([[x[0], x[1]]], dtype=object))
    with pytest.raises(kr.InputError, match="in exact arithmetic"):
        lax(own, L=lambda x, lam: np.array([[np.sqrt(x[0])]], dtype=object))


def test_implicit_maps_keep_their_ranks() -> None:
    ranks = lax(subject(kr.EulerTop(J=(1, 2, 3, 5)), eps=EPS))
    assert ranks.equation is None and ranks.isospectral is None
    assert (ranks.involution, ranks.on_leaf, ranks.needed) == (True, 2, 2)
