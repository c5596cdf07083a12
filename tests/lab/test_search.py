"""Search: the paper's constants come out of their families, and nothing else does."""

from __future__ import annotations

import os
from collections.abc import Sequence
from fractions import Fraction
from typing import Any

import numpy as np
import pytest

import kreisel as kr
from kreisel.algebra import Array, cayley_act, trace_log, vec, wedge
from kreisel.lab import brackets, dynamics, exact, growth, integrals, search
from kreisel.lab.integrals import integrals_in_floats
from kreisel.lab.questions import liouville
from kreisel.lab.subject import subject
from kreisel.record.contract import Map
from kreisel.record.model import Model
from kreisel.system import clebsch, euler_top, kovalevskaya_top_e3, symmetric_top
from support import docs_tool

F = Fraction
EXACT = {"steps": 0, "iterates": 5}
FULL = pytest.mark.skipif("KREISEL_FULL" not in os.environ, reason="`make test-full` runs it")


# -- further families ------------------------------------------------------------------------------------


def veselov(gradient: search.Gradient, J: Sequence[Any], name: str = "veselov") -> Model:
    """The map of -(1/eps) tr(WJ) + U(P), n = 3, on the branch W -> 1 as eps -> 0."""
    body = np.array([float(v) for v in J])
    c = euler_top.sums(J=body)["c"]

    def step(M: Array, P: Array, *, eps: Any) -> tuple[Array, Array]:
        N = M + wedge(P, gradient(P, eps))
        X = euler_top.turn(N, J=body, c=c, eps=eps)[0]
        return euler_top.move(N, X)[0], cayley_act(-X, P)

    return search.model_of(name, len(J), Map(step=step, rational=False))


def axial_potential(beta: Any = 0, kappa: Any = 0, mu: Any = 0) -> Model:
    """The potential U = -eps V(<P, e_3>), V' = (1 + beta u + mu u^2)/(1 + kappa eps^2 u).  The paper's: all 0."""
    axis = exact.fractions([0, 0, 1])
    beta, kappa, mu = (exact.fractions(v) for v in (beta, kappa, mu))

    def gradient(P: Array, eps: Any) -> Array:
        u = P[..., 2]
        slope = (1 + beta * u + mu * (u * u)) / (1 + kappa * (eps * eps) * u)
        return vec(-eps * slope) * axis + 0 * P

    return search.explicit(gradient, "axial")


def veselov_with_potential(gravity: Any = 0, quadratic: Any = 0, J: Sequence[Any] = (1, 2, 4)) -> Model:
    """-(1/eps) tr(WJ) - eps gravity <P, e_3> + eps quadratic <P, JP>/2.  Veselov's: both 0."""
    axis, B, g, q = np.array([0.0, 0.0, 1.0]), np.array([float(v) for v in J]), float(gravity), float(quadratic)
    return veselov(lambda P, eps: -g * eps * axis + q * eps * (B * P), J)


def modified_kinetic(sigma: float = 2.0, alpha: float = 0.5) -> Model:
    """-(alpha/eps) tr log(2I + W + W^T) - (sigma (1 - alpha)/eps) log(1 + <A, WA>) - eps <P, WA>, A = e_3.

    A Lagrangian in JAX.  The paper's (section 6.2): sigma = 2, for any alpha.
    """
    import jax.numpy as jnp

    from kreisel import reduction as red

    def discrete(W: Array, P: Array, *, sigma: float, alpha: float, eps: float) -> Any:
        kinetic = alpha / eps * trace_log(2 * jnp.eye(3) + W + W.T)
        return -kinetic - sigma * (1 - alpha) / eps * jnp.log(1 + W[2, 2]) - eps * (P @ W)[2]

    system = red.system("modified-kinetic", group=red.SO(3), discrete=discrete)
    return system(sigma=float(sigma), alpha=float(alpha))


def mixed_kinetic(theta: float = 1.0, J: Sequence[float] = (0.4, 1.0, 1.7)) -> Model:
    """-(1/eps) (tr(WJ) + (1 - theta) tr(WJWJ)/4), no potential; in JAX.  Veselov's: theta = 1."""
    import jax.numpy as jnp

    from kreisel import reduction as red

    def discrete(W: Array, P: Array, *, theta: float, eps: float) -> Any:
        WJ = W * jnp.array(J)
        return -(jnp.trace(WJ) + (1 - theta) * jnp.trace(WJ @ WJ) / 4) / eps

    return red.system("mixed-kinetic", group=red.SO(3), discrete=discrete)(theta=float(theta))


# -- tests -------------------------------------------------------------------------------------------------


def verdicts(ranking: search.Ranking, name: str) -> dict[object, str]:
    return {s.parameters[name]: s.verdict for s in ranking.scores}


def test_the_constant_of_clebsch() -> None:
    """2/eps, and not the printed 4/eps (erratum E1)."""
    found = search.search(search.logarithmic, {"c": [4, F(3, 2), 2]}, **EXACT)
    assert verdicts(found, "c") == {4: "not integrable", F(3, 2): "not integrable", 2: "integrable"}
    assert found.scores[0].parameters["c"] == 2
    assert found.table["verdict"].iloc[0] == "integrable"


def test_the_potential_of_lagrange() -> None:
    found = search.search(axial_potential, {"beta": [0, 1], "kappa": [0, F(1, 4)]}, **EXACT)
    assert found.scores[0].parameters == {"beta": 0, "kappa": 0}
    assert [s.verdict for s in found.scores] == ["integrable"] + ["not integrable"] * 3
    assert [s.on_leaf for s in found.scores] == [2, 1, 1, 1]  # the axis stays a symmetry


def test_members_are_the_maps_of_the_registry() -> None:
    rng = np.random.default_rng(0)
    M, P, eps = kr.algebra.hat(rng.normal(size=3)), rng.normal(size=3), 0.3
    for member, system, known in (
        (search.logarithmic(2), clebsch, {"b": np.array([1.0, 2, 4])}),
        (axial_potential(), symmetric_top, {"A": np.array([0.0, 0, 1])}),
    ):
        ours, theirs = member.step(M, P, eps=eps), system.SYSTEM.map.step(M, P, eps=eps, **known)
        assert all(np.allclose(a.astype(float), b, atol=1e-14) for a, b in zip(ours, theirs, strict=True))
    ours = veselov_with_potential().step(M, P, eps=eps)[0]
    top = kr.EulerTop(J=(1.0, 2.0, 4.0))
    assert np.allclose(ours, top.step(M, eps=eps)[0], atol=1e-13)


@FULL
def test_veselov_is_found_and_gravity_spoils_it() -> None:
    found = search.search(veselov_with_potential, {"gravity": [0, 1]}, steps=4000, orbits=2)
    assert verdicts(found, "gravity") == {0: "integrable", 1: "not integrable"}


@FULL
def test_a_lagrangian_in_jax() -> None:
    """Section 6.2's kinetic part: the JAX map has the exponents of a regular orbit, and is the registry's adjoint."""
    what = subject(modified_kinetic(2.0, 0.5), eps=F(1, 3))
    x = np.array([0.3, -0.2, 0.7, 0.6, 0.0, 0.8])
    top = subject(kr.LagrangeTopMoving(A=(0, 0, 1), alpha=F(1, 2)), eps=F(1, 3))
    ours, theirs = dynamics.points(what, x, 3), dynamics.points(top, x, 3)
    assert np.allclose(ours, theirs, atol=1e-11)


def test_integrals_in_floats() -> None:
    """As many as the record has; those of a map that lost them are not seen."""
    good = integrals_in_floats(subject(kr.LagrangeTop(p=(0, 0, 1)), eps=F(1, 3)))
    assert (good.count, good.on_leaf, good.leaf, good.enough) == (4, 2, 4, True)
    assert good.largest < 1e-14 and good.next > 1e-3
    _, perturbed, options = docs_tool("investigated").controls()[1]
    from kreisel.lab.investigation import _subject

    bad = integrals_in_floats(_subject(perturbed, 3, "rest", F(1, 3), None, {}))
    assert (bad.count, bad.on_leaf, bad.enough) == (2, 0, False) and options["frame"] == "rest"


@FULL
def test_veselov_comes_out_of_a_family_of_kinetic_parts() -> None:
    found = search.search(mixed_kinetic, {"theta": [1.0, 0.5]}, steps=0)
    assert verdicts(found, "theta") == {1.0: "integrable", 0.5: "undecided"}


def test_kovalevskaya_comes_out_of_a_family_of_potentials() -> None:
    """kappa = -1/4 alone: degrees 9 k^2 + 1, two integrals in involution, of degrees 4 and 6, beside the Casimirs."""
    grid = {"s": [1], "tilt": [(1, 0, 0)], "kappa": [F(-1, 8), F(-1, 4)]}
    found = search.search(search.spinning, grid, **EXACT)
    assert verdicts(found, "kappa") == {F(-1, 8): "not integrable", F(-1, 4): "undecided"}
    what = subject(search.spinning(1, (1, 0, 0), F(-1, 4)), eps=2)  # of eps there is a scaling
    assert growth.degrees(what, 5) == tuple(9 * k * k + 1 for k in range(6))
    kept = integrals.integrals(what, 6)
    assert [f.degree for f in kept] == [2, 2, 4, 6]
    ranks = liouville(what, what.tensor, kept, 0)
    assert (ranks.leaf, ranks.on_leaf, ranks.involution) == (4, 2, True) and brackets.defect(what, what.tensor) == 0
    x = np.array([F(1, 3), F(-2, 5), F(1, 7), F(3, 4), F(-1, 2), F(2, 9)], dtype=object)
    orbit = [x, what.step(x, **what.constants)]
    orbit.append(what.step(orbit[1], **what.constants))
    assert all(f(orbit[0]) == f(orbit[1]) == f(orbit[2]) != f(x + 1) for f in kept)


def test_the_map_of_kovalevskaya_discretizes_kovalevskayas_top() -> None:
    """(step - 1)/eps against M' = [M, Omega] + A ^ P, P' = -Omega P, Omega = M + pi M pi, for n = 3 and 4."""
    rng = np.random.default_rng(3)
    for n in (3, 4):
        A = np.eye(n)[0]
        M, P = kr.algebra.skew(rng.normal(size=n * (n - 1) // 2), n), rng.normal(size=n)
        Omega = M.copy()
        Omega[:-1, :-1] *= 2
        rates = M @ Omega - Omega @ M + kr.algebra.wedge(A, P), -Omega @ P
        member, eps = search.spinning(1, A.astype(int), F(-1, 4)), 1e-6
        for new, old, rate in zip(member.step(M, P, eps=eps), (M, P), rates, strict=True):
            assert np.allclose((np.asarray(new, dtype=float) - old) / eps, rate, atol=1e-4)


def test_the_found_map_is_that_of_the_record_and_no_other_member_conserves_its_energy() -> None:
    rng, eps, record = np.random.default_rng(3), F(2, 5), kovalevskaya_top_e3
    known = record.SYSTEM.derive()
    for kappa, tilt in ((F(-1, 4), (1, 0, 0)), (F(-1, 8), (1, 0, 0)), (F(-1, 4), (1, 0, 1))):
        x, P = (np.array([F(int(v), 7) for v in rng.integers(-9, 10, 3)], dtype=object) for _ in range(2))
        M, ours = kr.algebra.hat(x), (kappa, tilt) == (F(-1, 4), (1, 0, 0))
        new = search.spinning(1, tilt, kappa).step(M, P, eps=eps)
        same = all(
            (a == b).all() for a, b in zip(new, record.SYSTEM.map.step(M, P, e=known["e"], eps=eps), strict=True)
        )
        before, after = (record.SYSTEM.energy(*z, c=known["c"], eps=eps) for z in ((M, P), new))
        assert (same, before == after) == (ours, ours)


def test_kovalevskayas_top_in_two_fields() -> None:
    """Degrees 12 k^2 + 2 k + 1 with the determinant, exponential without; it discretizes the record, n = 3 and 4."""
    what = subject(search.kovalevskaya(), eps=2)
    assert growth.degrees(what, 5) == tuple(12 * k * k + 2 * k + 1 for k in range(6))
    assert brackets.defect(what, what.tensor) == 0
    assert [f.degree for f in integrals.integrals(what, 4)] == [2, 2, 2, 4]
    assert growth.degrees(subject(search.kovalevskaya(coupling=0), eps=2), 3) == (1, 10, 47, 199)
    rng = np.random.default_rng(3)
    for n in (3, 4):
        top = kr.KovalevskayaTop(n=n)
        M, P, Q = kr.algebra.skew(rng.normal(size=n * (n - 1) // 2), n), rng.normal(size=n), rng.normal(size=n)
        rates = top.call(top.system.flow, M, P, Q)
        new = search.kovalevskaya(n=n).step(M, P, Q, eps=1e-6)
        for x, old, rate in zip(new, (M, P, Q), rates, strict=True):
            assert np.allclose((np.asarray(x, dtype=float) - old) / 1e-6, rate, atol=1e-4)


def test_quadratic_fields_and_a_rotor() -> None:
    """2/eps alone, and the turn by M_12 and the rotor together; the member is the map of the record."""
    found = search.search(search.quadratic_field, {"c": [2, 1]}, steps=0, iterates=4)
    assert verdicts(found, "c") == {2: "undecided", 1: "not integrable"}
    assert growth.degrees(subject(search.quadratic_field(), eps=2), 4) == (1, 20, 69, 148, 257)
    for apart, degrees in ((0, (1, 15, 53, 115)), (1, (1, 15, 73, 319))):
        rotor = search.kovalevskaya(gamma=F(3, 7), apart=apart)
        assert growth.degrees(subject(rotor, eps=2), 3) == degrees
    rng, top = np.random.default_rng(5), kr.QuadraticField(b=(1, 2, 4))
    M, A = kr.algebra.hat(rng.normal(size=3)), rng.normal(size=(3, 3))
    ours, theirs = search.quadratic_field().step(M, A + A.T, eps=0.3), top.step(M, A + A.T, eps=0.3)
    assert all(np.allclose(x.astype(float), y, atol=1e-13) for x, y in zip(ours, theirs, strict=True))


def test_kahans_gyrostat_needs_a_wheel_along_a_principal_axis() -> None:
    grid = {"h": [(0, 1, 0), (1, 2, 3)], "J": [(1, 2, 4)]}
    found = search.search(search.kahan_gyrostat, grid, steps=0, iterates=5)
    known = {(0, 1, 0): "integrable", (1, 2, 3): "not integrable"}
    assert {s.parameters["h"]: s.verdict for s in found.scores} == known


def test_members_of_the_further_families() -> None:
    """Clebsch's map in both families of logarithms, Lagrange's among spinning bodies, n = 3 and 4."""
    rng = np.random.default_rng(1)
    for n in (3, 4):
        M, P, eps = kr.algebra.skew(rng.normal(size=n * (n - 1) // 2), n), rng.normal(size=n), 0.3
        b, axis = [0] * (n - 1) + [3], [0] * (n - 1) + [1]
        for ours, system, known in (
            (search.logarithmic(2, b=b), clebsch, {"b": np.array(b, dtype=float)}),
            (search.sum_of_logarithms(2, b), clebsch, {"b": np.array(b, dtype=float)}),
            (search.spinning(0, axis), symmetric_top, {"A": np.array(axis, dtype=float)}),
        ):
            new, theirs = ours.step(M, P, eps=eps), system.SYSTEM.map.step(M, P, eps=eps, **known)
            assert all(np.allclose(x.astype(float), y, atol=1e-13) for x, y in zip(new, theirs, strict=True))
        spun = subject(search.spinning(1, axis[::-1]))
        assert brackets.defect(spun, spun.tensor) == 0
    top = subject(search.kahan_heavy_top(I3=2))
    assert len(integrals.integrals(top, 1)) == 1  # M3


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


def test_the_modules_of_the_laboratory_are_found() -> None:
    assert all(getattr(kr.lab, name) is not None for name in dir(kr.lab))
