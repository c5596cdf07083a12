"""Wrong arguments of the laboratory are named; a model with its parameters is tested exactly too."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np
import pytest

import kreisel as kr
from kreisel.lab import certified, laws, search as families
from kreisel.lab.brackets import brackets, lax, volumes
from kreisel.lab.darboux import darboux
from kreisel.lab.dynamics import dynamics
from kreisel.lab.growth import cycles, growth, heights, singularities
from kreisel.lab.integrals import integrals
from kreisel.lab.search import logarithmic, search
from kreisel.lab.subject import subject

pytest.importorskip("flint")


def henon(x: Any) -> Any:
    return np.array([1 + x[1] - 2 * x[0] * x[0], -x[0]], dtype=object)


MAP = subject(henon, names=("x", "y"))
BODY: Any = kr.Clebsch(b=(1, 2, 4))
MISTAKES: dict[str, tuple[Callable[[], Any], str]] = {
    "iterates as text": (lambda: growth(MAP, "3"), "iterates must be an integer"),  # type: ignore[arg-type]
    "half an iterate": (lambda: growth(MAP, 2.5), "iterates must be an integer"),  # type: ignore[arg-type]
    "iterates before 0": (lambda: growth(MAP, -1), "iterates must be an integer from 0"),
    "a model for a subject": (lambda: growth(BODY, 3), "expected subject of the type Subject, got clebsch"),
    "a function for a subject": (lambda: integrals(henon, 2), "expected subject of the type Subject"),  # type: ignore[arg-type]
    "singularities": (lambda: singularities(BODY), "expected subject of the type Subject"),
    "lax": (lambda: lax(BODY), "expected subject of the type Subject"),
    "dynamics": (lambda: dynamics(BODY), "expected subject of the type Subject"),
    "a degree below 0": (lambda: integrals(MAP, -1), "degree must be an integer from 0"),
    "brackets": (lambda: brackets(MAP, -1), "degree must be an integer from 0"),
    "volumes": (lambda: volumes(MAP, "2"), "degree must be an integer from 0"),  # type: ignore[arg-type]
    "no degree": (lambda: darboux(MAP, 0), "degree must be an integer from 1"),
    "a name twice": (lambda: subject(henon, names=("x", "x")), "names: expected each coordinate once"),
    "a Greek name": (lambda: subject(henon, names=("φ", "p")), "names: expected names in ASCII letters"),
    "one height": (lambda: heights(MAP, [1, 2], 1), "steps must be an integer from 2"),
    "a name too few": (lambda: growth(subject(henon, names=("x",)), 3), "a name for each coordinate .* got x: index"),
    "lanes": (lambda: subject(kr.LagrangeTop(p=[(0, 0, 1), (0, 0, 2)])), r"one body, got a batch \(2,\)"),
    "a grid of a number": (lambda: search(logarithmic, {"c": 2}), "grid: expected a list of values of c, got 2"),  # type: ignore[dict-item]
    "half a prime": (lambda: cycles(MAP, 7.5), "p must be an integer from 3"),  # type: ignore[arg-type]
    "no steps": (lambda: singularities(MAP, 0), "steps must be an integer from 1"),
    "a start in words": (lambda: dynamics(MAP, ["a", 1]), r"A start is 2 finite values, x, y, got \['a', 1\]"),
    "no step": (lambda: subject(BODY, eps=0), "eps: expected a step of clebsch that is not 0, got 0"),
    "a cubic flow": (lambda: families.kahan(lambda x: [x[0] ** 3, x[1]], ("x", "y")), "2 rates of degree 2 or less"),
    "a missing rate": (lambda: families.kahan(lambda x: [x[0]], ("x", "y")), "expected 2 rates .* got 1"),
    "a flow with roots": (lambda: families.kahan_map(kr.LatticeLandauLifshitz(n=3)), "flow failed at fractions"),
    "a moment of 0": (lambda: families.kahan_gyrostat(J=(1, 0, 2)), "three moments J that are not 0"),
    "an option of no judge": (lambda: search(logarithmic, {"c": [2]}, step=5), "judge has no argument 'step'"),
    "no grid": (lambda: search(logarithmic), r"expected grid, got none. Write search\(family, grid\)"),  # type: ignore[call-arg]
    "a map to prove": (lambda: certified.prove(henon), "expected claimed of the type System | Model"),  # type: ignore[arg-type]
    "a name for a record": (lambda: laws.check("clebsch"), "expected system of the type System | Model"),  # type: ignore[arg-type]
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_mistakes_are_named(mistake: str) -> None:
    call, said = MISTAKES[mistake]
    with pytest.raises(kr.InputError, match=said):
        call()


def test_a_member_that_fails_leaves_the_others() -> None:
    def family(c: int) -> Any:
        a = Fraction(1, c)
        return subject(lambda x: (x[1], a - x[0]), names=("x", "y"))

    good, bad = search(family, {"c": [0, 1]}, steps=0, iterates=3).scores
    assert good.verdict == "integrable"
    assert bad.verdict.startswith("The family failed: ZeroDivisionError")


def test_a_family_without_the_parameter_of_the_grid() -> None:
    (score,) = search(logarithmic, {"b": [2]}, steps=0).scores
    assert score.verdict == "logarithmic: expected c, got none. Write logarithmic(c, b=2)."


def test_a_family_of_maps_of_the_plane() -> None:
    """McMillan's map is integrable, Henon's x' = 1 - a x^2 + y has the entropy log 2 of its degrees 2^k."""

    def family(a: Any, cubic: bool) -> Any:
        def mcmillan(z: Any) -> Any:
            x, y = z
            return y, -x + 2 * a * y / (1 + y * y)

        return subject(mcmillan if cubic else lambda z: (1 - a * z[0] ** 2 + z[1], z[0] / 3), names=("x", "y"))

    best, worst = search(family, {"a": [Fraction("1.4")], "cubic": [False, True]}, steps=0).scores
    assert best.parameters["cubic"] and best.verdict == "integrable" and best.power == 2
    assert worst.verdict == "not integrable" and worst.entropy == pytest.approx(np.log(2), rel=1e-9)


def test_a_model_is_tested_over_the_rationals() -> None:
    """With its parameters, floats, as exact values; a flow of twice the speed is seen."""
    verdicts = laws.check(BODY, numbers=["exact"])
    assert len(verdicts) > 10 and all(v.holds and v.residual == 0 for v in verdicts)
    twice = replace(kr.Clebsch, flow=lambda *z, b: tuple(2 * x for x in kr.Clebsch.flow(*z, b=b)))  # type: ignore[misc]
    assert "hamiltonian-flow" in {v.law for v in laws.check(twice(b=(1, 2, 4)), numbers=["exact"]) if not v.holds}
