"""Search: the paper's constants come out of their families, and nothing else does."""

from __future__ import annotations

import os
from fractions import Fraction

import numpy as np
import pytest

import kreisel as kr
from kreisel.lab import controls, dynamics, search
from kreisel.lab.numerical import integrals_in_floats
from kreisel.lab.subject import subject
from kreisel.system import clebsch, symmetric_top

F = Fraction
EXACT = {"steps": 0, "iterates": 5}
FULL = pytest.mark.skipif("KREISEL_FULL" not in os.environ, reason="`make test-full` runs it")


def verdicts(ranking: search.Ranking, name: str) -> dict[object, str]:
    return {s.parameters[name]: s.verdict for s in ranking.scores}


def test_the_constant_of_clebsch() -> None:
    """2/eps, and not the printed 4/eps (erratum E1)."""
    found = search.search(search.logarithmic, {"c": [4, F(3, 2), 2]}, **EXACT)
    assert verdicts(found, "c") == {4: "not integrable", F(3, 2): "not integrable", 2: "integrable"}
    assert found.scores[0].parameters["c"] == 2
    assert found.table["verdict"].iloc[0] == "integrable"


def test_the_potential_of_lagrange() -> None:
    found = search.search(search.axial_potential, {"beta": [0, 1], "kappa": [0, F(1, 4)]}, **EXACT)
    assert found.scores[0].parameters == {"beta": 0, "kappa": 0}
    assert [s.verdict for s in found.scores] == ["integrable"] + ["not integrable"] * 3
    assert [s.on_leaf for s in found.scores] == [2, 1, 1, 1]  # the axis stays a symmetry


def test_members_are_the_maps_of_the_registry() -> None:
    rng = np.random.default_rng(0)
    M, P, eps = kr.algebra.hat(rng.normal(size=3)), rng.normal(size=3), 0.3
    for member, system, known in (
        (search.logarithmic(2), clebsch, {"b": np.array([1.0, 2, 4])}),
        (search.axial_potential(), symmetric_top, {"A": np.array([0.0, 0, 1])}),
    ):
        ours, theirs = member.step(M, P, eps=eps), system.SYSTEM.map.step(M, P, eps=eps, **known)
        assert all(np.allclose(a.astype(float), b, atol=1e-14) for a, b in zip(ours, theirs, strict=True))
    ours = search.veselov_with_potential().step(M, P, eps=eps)[0]
    top = kr.EulerTop(J=(1.0, 2.0, 4.0))
    assert np.allclose(ours, top.step(M, eps=eps)[0], atol=1e-13)


@FULL
def test_veselov_is_found_and_gravity_spoils_it() -> None:
    found = search.search(search.veselov_with_potential, {"gravity": [0, 1]}, steps=4000, orbits=2)
    assert verdicts(found, "gravity") == {0: "integrable", 1: "not integrable"}


@FULL
def test_a_lagrangian_in_jax() -> None:
    """Section 6.2's kinetic part: the JAX map has the exponents of a regular orbit, and is the registry's adjoint."""
    what = subject(search.modified_kinetic(2.0, 0.5), eps=F(1, 3))
    x = np.array([0.3, -0.2, 0.7, 0.6, 0.0, 0.8])
    top = subject(kr.LagrangeTopMoving(A=(0, 0, 1), alpha=F(1, 2)), eps=F(1, 3))
    ours, theirs = dynamics.points(what, x, 3), dynamics.points(top, x, 3)
    assert np.allclose(ours, theirs, atol=1e-11)


def test_integrals_in_floats() -> None:
    """As many as the record has; those of a map that lost them are not seen."""
    good = integrals_in_floats(subject(kr.LagrangeTop(p=(0, 0, 1)), eps=F(1, 3)))
    assert (good.count, good.on_leaf, good.leaf, good.enough) == (4, 2, 4, True)
    assert good.largest < 1e-14 and good.next > 1e-3
    _, perturbed, options = controls.controls()[1]
    from kreisel.lab.investigation import _subject

    bad = integrals_in_floats(_subject(perturbed, 3, "rest", F(1, 3), None, {}))
    assert (bad.count, bad.on_leaf, bad.enough) == (2, 0, False) and options["frame"] == "rest"


@FULL
def test_veselov_comes_out_of_a_family_of_kinetic_parts() -> None:
    found = search.search(search.mixed_kinetic, {"theta": [1.0, 0.5]}, steps=0)
    assert verdicts(found, "theta") == {1.0: "integrable", 0.5: "undecided"}


def test_trouble_is_scored_and_the_search_goes_on() -> None:
    def family(c):
        return search.logarithmic(c) if c else subject(lambda x: x**0.5, names=("x", "y"))

    found = search.search(family, {"c": [0, 2]}, **EXACT)
    assert [s.rank for s in found.scores] == [0, 3] and "rational" in found.scores[1].trouble
    with pytest.raises(kr.InputError, match="members"):
        search.search(search.logarithmic, {})
    with pytest.raises(kr.InputError, match="workers"):
        search.search(search.logarithmic, {"c": [2]}, workers=-1)


def test_on_dask() -> None:
    pytest.importorskip("distributed")
    grid = {"c": [2, 3]}
    here, there = (search.search(search.logarithmic, grid, workers=w, steps=0, iterates=3) for w in (0, 1))
    assert [repr(s) for s in here.scores] == [repr(s) for s in there.scores]
