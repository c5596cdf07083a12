"""The map of Kovalevskaya's top: its integrals proved for all states and steps, its orientation and Lagrangian."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction as F
from functools import partial
from typing import Any

import numpy as np
import pytest

import kreisel as kr
from kreisel import algebra
from kreisel.lab import exact, growth, laws, search
from kreisel.lab.darboux import Ratio
from kreisel.lab.exact import fraction
from kreisel.lab.subject import subject
from kreisel.record.calling import call
from kreisel.system import (
    kovalevskaya_gyrostat as gyrostat,
    kovalevskaya_top,
    kovalevskaya_top_e3,
    kovalevskaya_top_so3,
    kovalevskaya_top_sp4,
)

ONE, TWO, SECOND = kovalevskaya_top_e3.SYSTEM, kovalevskaya_top_so3.SYSTEM, kovalevskaya_top_sp4.SYSTEM


def unknowns(system: Any) -> tuple[tuple[np.ndarray, ...], dict[str, Any]]:
    """The state and eps as rational functions, each an unknown of its own."""
    flint = pytest.importorskip("flint")
    fields = len(system.space.letters) - 1
    ring = flint.fmpq_mpoly_ctx.get(("eps", *(f"x{i}" for i in range(3 + 3 * fields))), flint.Ordering.degrevlex)
    eps, *x = (Ratio(v, ring.constant(1)) for v in ring.gens())
    rows = np.array([*x, None], dtype=object)[:-1].reshape(-1, 3)
    known = {k: np.asarray(v, dtype=object) for k, v in system.derive().items()}
    return (algebra.hat(rows[0]), *rows[1:]), {**known, "eps": eps}


def vanishes(value: Any) -> bool:
    return all(v.n == 0 if isinstance(v, Ratio) else v == 0 for v in np.ravel(np.asarray(value, dtype=object)))


def one_field_kicked(M: Any, P: Any, e: Any, eps: Any) -> Any:
    return M + kovalevskaya_top_e3.kick(P, e=e, eps=eps)


def two_fields_turned(M: Any, P: Any, Q: Any, *, eps: Any) -> Any:
    return gyrostat.turn(M, P, Q, 0, eps)


@pytest.mark.parametrize(
    ("turn", "kicked", "system"),
    [
        (kovalevskaya_top_e3.turn, one_field_kicked, ONE),
        (two_fields_turned, gyrostat.kicked, TWO),
        (kovalevskaya_top_sp4.turn, lambda M, P, e, eps: M + kovalevskaya_top_sp4.kick(P, eps=eps), SECOND),
    ],
    ids=["one field", "two fields", "second map"],
)
def test_the_deformed_integrals_are_conserved_identically(turn: Any, kicked: Any, system: Any) -> None:
    """A proof: step = turn . kick, and I(turn(x)) = I(kick^-1(x)) as rational functions of the state and of eps."""
    (M, *F), known = unknowns(system)
    fields = [known[k] for k in "eh"[: len(F)]]
    after, before = turn(M, *F, eps=known["eps"]), (kicked(M, *F, *fields, -known["eps"]), *F)
    for function in (system.energy, *system.integrals.values()):
        assert vanishes(call(function, after, known) - call(function, before, known))
    spoiled = {**known, "eps": 2 * known["eps"]}
    assert not vanishes(call(system.energy, after, spoiled) - call(system.energy, before, spoiled))


@pytest.mark.parametrize("system", [ONE, TWO, SECOND])
def test_the_deformed_integrals_are_in_involution_identically(system: Any) -> None:
    """A proof, as polynomials in the state and in eps; with the squared lengths for one of them it fails."""
    state, known = unknowns(system)
    moving = exact.independent(np.array([known["eps"], *algebra.axial(state[0]), *np.ravel(state[1:])], dtype=object))
    there, moved = (algebra.hat(moving[1:4]), *moving[4:].reshape(-1, 3)), {**known, "eps": moving[0]}
    tensor = algebra.invariants.lie_poisson(system.space.kinds, *state)
    order = algebra.coordinates(algebra.hat(np.arange(1, 4)))  # entries i < j, with their signs

    def gradient(function: Any) -> np.ndarray:
        rows = exact.slopes(np.array([call(function, there, moved), None], dtype=object)[:-1], len(moving))[0, 1:]
        own = np.array([int(np.sign(v)) * rows[abs(int(v)) - 1] for v in order], dtype=object)
        return np.concatenate([own, rows[3:]])

    rows = [gradient(f) for f in (system.energy, *system.integrals.values())]
    assert all(vanishes(a @ tensor @ b) for i, a in enumerate(rows) for b in rows[:i])
    assert not vanishes(gradient(lambda M, *F: algebra.pairing(M, M)) @ tensor @ rows[0])


@pytest.mark.parametrize("n", [3, 4, 5])
def test_the_member_of_the_search_is_the_map_for_every_n(n: int) -> None:
    draw = exact.rational_random(np.random.default_rng(n))
    known = {**kovalevskaya_top.SYSTEM.derive(n=np.asarray(n)), "eps": draw((1,))[0] / 3}
    state = kovalevskaya_top.SYSTEM.space.point(n, draw)
    plain = [np.vectorize(fraction, otypes=[object])(x) for x in (*state, known["eps"])]
    found = search.kovalevskaya(n=n).step(*plain[:3], eps=plain[3][()])
    stated = call(gyrostat.step, tuple(plain[:3]), {**known, "eps": plain[3][()]})
    assert all((x == y).all() for x, y in zip(stated, found, strict=True))


@pytest.mark.parametrize(
    ("model", "degrees"),
    [
        (lambda: kr.KovalevskayaGyrostat(n=3, gamma=F(3, 7)), [12 * k * k + 2 * k + 1 for k in range(5)]),
        (lambda: kr.KovalevskayaTopSP4(), [18 * k * k + 1 for k in range(5)]),
        (lambda: kr.SymmetricTopLogarithmic(A=(1, 0, 0)), [1, 6, 17, 38, 65, 102]),
    ],
)
def test_the_degrees_of_further_maps_are_quadratic(model: Any, degrees: list[int]) -> None:
    assert list(growth.degrees(subject(model(), eps=2), len(degrees) - 1)) == degrees


def test_ratius_top_in_three_dimensions_is_lagranges_in_the_logarithm() -> None:
    """Its map for J = 1/2 with G = P and chi = A as axial vectors, exactly."""
    draw = exact.rational_random(np.random.default_rng(4))
    M, G = (algebra.hat(draw((3,))) for _ in range(2))
    (strength, eps), axis = draw((2,)), np.array([0, 0, -1])
    half = exact.rational(1, 2)
    ratiu = kr.RatiuTop(n=3, a=half, b=half, chi=strength).step(M, G, eps=eps)
    top = kr.SymmetricTopLogarithmic(A=strength * axis).step(M, algebra.axial(G), eps=eps)
    assert (ratiu[0] == top[0]).all() and (algebra.axial(ratiu[1]) == top[1]).all()


def test_the_curve_of_the_second_map_is_a_function_of_its_integrals() -> None:
    """The gradient of det L, 8 x 8, is in the span of those of H, K and the Casimirs, not of the first map."""
    case = laws.make_case(SECOND, 3, "float", 2)

    def curve(*state: Any) -> Any:
        return algebra.invariants.determinant(case.call(SECOND.map.pencil, *state, lam=1.3, mu=0.6))

    for system, rank in ((SECOND, 4), (ONE, 5)):
        known = (system.space.casimirs, system.energy, *system.integrals.values())
        rows = [np.atleast_2d(case.jacobian(f)[1]).astype(float) for f in (*known, curve)]
        scaled = np.concatenate([row / np.linalg.norm(row, axis=-1, keepdims=True) for row in rows])
        assert np.linalg.matrix_rank(scaled, 1e-9) == rank


@pytest.mark.parametrize(("system", "leaf"), [(ONE, 4), (TWO, 6)])
def test_the_investigation_finds_it_integrable(system: Any, leaf: int) -> None:
    """By the integrals that the record states, tested exactly; of a spoiled map it does not take them."""
    page = kr.lab.investigate(system(), iterates=4, steps=2000)
    assert (
        page.verdict == "integrable"
        and f"{leaf // 2} independent integrals on leaves of dimension {leaf}" in page.reason
    )

    def spoiled(M: Any, *F: Any, eps: Any, e: Any, h: Any = None) -> Any:
        return kovalevskaya_top_e3.turn(M + eps * algebra.wedge(e, F[0]), F[0], eps=eps)

    if system is ONE:
        wrong = replace(ONE, map=replace(ONE.map, step=spoiled))
        assert kr.lab.investigate(wrong(), iterates=4, steps=2000).verdict != "integrable"


def test_one_field_of_two() -> None:
    """With Q = 0 step, energy and K are those in two fields, K but for (eps^2/4) <M, P>^2; G is <M, P>^2."""
    draw = exact.rational_random(np.random.default_rng(1))
    known = {**TWO.derive(), "eps": draw((1,))[0]}
    M, P = ONE.space.point(3, draw)
    both = (M, P, 0 * P)
    for x, y in zip(call(ONE.map.step, (M, P), known), call(TWO.map.step, both, known), strict=False):
        assert (x == y).all()
    assert call(ONE.energy, (M, P), known) == call(TWO.energy, both, known)
    K, other = (call(s.integrals["kovalevskaya"], z, known) for s, z in ((ONE, (M, P)), (TWO, both)))
    area = algebra.dot(algebra.axial(M), P)
    assert K + known["eps"] ** 2 / 4 * area * area == other
    assert call(TWO.integrals["gram"], both, known) == area * area


def test_k_is_kovalevskayas_integral_at_eps_0() -> None:
    draw = exact.rational_random(np.random.default_rng(2))
    M, P, Q = TWO.space.point(3, draw)
    (x, y, _), (p, q, _), (u, v, _) = algebra.axial(M), P, Q
    K = ((x * x - y * y) / 2 - p + v) ** 2 + (x * y - q - u) ** 2
    assert call(TWO.integrals["kovalevskaya"], (M, P, Q), TWO.derive()) == K
    one = ((x * x - y * y) / 2 - p) ** 2 + (x * y - q) ** 2
    assert call(ONE.integrals["kovalevskaya"], (M, P), ONE.derive()) == one


def lagrangian(g: Any, h: Any, p: Any, *, eps: Any, sign: int = 1, parts: float = 2.0) -> Any:
    """-(4/eps) (log cos(theta/2) + 2 log cos(chi/4)) + (4/eps) log(1 - (eps^2/4) <g^T p, e_1>).

    cos^2(theta/2) = (1 + W_33)/2, cos^2(chi/2) = (1 + tr W)/(2 (1 + W_33)).
    """
    W, P = g.mT @ h, algebra.act(g.mT, p)
    tilt, trace = 1 + W[..., 2, 2], 1 + W[..., 0, 0] + W[..., 1, 1] + W[..., 2, 2]
    half = algebra.sqrt(trace / (2 * tilt))
    kinetic = 2 / eps * (algebra.log(tilt / 2) + parts * algebra.log((1 + half) / 2))
    return -kinetic + sign * 4 / eps * algebra.log(1 - eps * eps / 4 * P[..., 0])


def test_the_map_is_that_of_a_discrete_lagrangian() -> None:
    """With the turn of the orientation: discrete Euler-Lagrange equations, and the momentum; spoiled ones fail."""
    law = laws.LAWS["discrete-euler-lagrange"]
    for function, holds in (
        (lagrangian, True),
        (lambda g, h, p, *, eps: lagrangian(g, h, p, eps=eps, sign=-1), False),
        (lambda g, h, p, *, eps: lagrangian(g, h, p, eps=eps, parts=1.0), False),
    ):
        system = replace(ONE, map=replace(ONE.map, lagrangian=function))
        assert laws.test(law, laws.make_case(system, 3, "float", 1)).holds == holds


def second_lagrangian(g: Any, h: Any, p: Any, *, eps: Any, weight: float = 8.0) -> Any:
    """-(4/eps) log(((1 + w0)^2 + w3^2)/4) + (weight/eps) Re log(1 - (eps^2/8) (P_1 + i P_2)), w the quaternion of W."""
    W, P = g.mT @ h, algebra.act(g.mT, p)
    w0 = algebra.sqrt(1 + W[..., 0, 0] + W[..., 1, 1] + W[..., 2, 2]) / 2
    w3, u, v = (W[..., 1, 0] - W[..., 0, 1]) / (4 * w0), 1 - eps * eps / 8 * P[..., 0], eps * eps / 8 * P[..., 1]
    return weight / 2 / eps * algebra.log(u * u + v * v) - 4 / eps * algebra.log(((1 + w0) * (1 + w0) + w3 * w3) / 4)


def test_the_second_map_is_that_of_a_discrete_lagrangian() -> None:
    law = laws.LAWS["discrete-euler-lagrange"]
    for weight in (8.0, 4.0):
        function = partial(second_lagrangian, weight=weight)
        system = replace(SECOND, map=replace(SECOND.map, lagrangian=function))
        assert laws.test(law, laws.make_case(system, 3, "float", 1)).holds == (weight == 8.0)


def test_a_run_conserves_what_it_says_and_turns_the_body() -> None:
    run = kr.simulate(
        kr.KovalevskayaTopE3(), {"M": (0.3, 0.5, 1.1), "P": (0.6, 0, 0.8)}, dt=0.1, steps=2000, orientation=(1, 0, 0, 0)
    )
    table = kr.drift(run)
    assert list(table.query("conserved").index) == ["casimir[0]", "casimir[1]", "energy_eps", "kovalevskaya_eps"]
    assert not table.broken.any() and table.max_change["energy"] > 1e-4
    back = algebra.act(algebra.rotation_matrix(run.g.values), run.P.values)
    assert np.allclose(back, [0.6, 0, 0.8], atol=1e-12)
    for strong, model in ((9.0, kr.KovalevskayaTopE3()), (1.0, kr.KovalevskayaTopSO3())):  # det(1 - (eps^2/4) F_11) = 0
        fields = {"P": (strong, 0, 0)} | ({"Q": (0, 9.0, 0)} if model.system is TWO else {})
        with pytest.raises(kr.InputError, match=r"expected dt < 0\.666667"):
            kr.simulate(model, {"M": (0, 0, 1), **fields}, dt=0.7, steps=1)
    with pytest.raises(kr.InputError, match="no parameters"):
        kr.KovalevskayaTopE3(n=3)
    with pytest.raises(kr.InputError, match="no arguments"):
        kr.KovalevskayaTopE3((0, 0, 1))
    with pytest.raises(kr.InputError, match="kovalevskaya-top-e3"):
        kr.KovalevskayaTopSO3().state(M=(1, 0, 0), P=(1, 0, 0), Q=(0, 0, 0))
