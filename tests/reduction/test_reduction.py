"""Sections 2 and 3 of the paper for any group: conventions, equations, maps, derivatives, records, errors."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import kreisel as kr
import walks
from kreisel import algebra, reduction as red
from kreisel.algebra import invariants
from kreisel.lab import exact, laws
from kreisel.record.contract import System
from kreisel.reduction import numerics
from kreisel.reduction.groups import random_element
from kreisel.runs.operations import load_system
from kreisel.storage.simulate import resume
from kreisel.system import REGISTRY
from sizes import FULL, full

MOVING, REST = red.Frame.MOVING, red.Frame.REST
J3 = np.array([1.0, 1.6, 2.3])


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


# -- the groups -------------------------------------------------------------------------------------


@pytest.mark.parametrize("n", [3, 4, *full(5)])
def test_conventions_on_so_n(n: int) -> None:
    """diamond is wedge, ad* is [M, xi], Ad* is g^T M g, the tensor is that of e*(n)."""
    group = red.SO(n)
    rep, draw = red.standard(group), rng(n)
    x, M = draw.uniform(-1, 1, (2, group.dim))
    v, y = draw.uniform(-1, 1, (2, n))
    g = random_element(group, draw)
    X, skew_M = algebra.skew(x, n), algebra.skew(M, n)
    with red.double():
        assert np.allclose(group.matrix(jnp.asarray(x)), X)
        assert np.allclose(algebra.skew(np.asarray(rep.diamond(y, v)), n), algebra.wedge(v, y))
        assert np.allclose(rep.rate(x, v), X @ v)
        assert np.allclose(rep.rate_star(x, y), -X @ y)
        assert np.allclose(algebra.skew(np.asarray(group.ad_star(x, M)), n), skew_M @ X - X @ skew_M)
        assert np.allclose(algebra.skew(np.asarray(group.Ad_star(g, M)), n), g.T @ skew_M @ g)
        assert np.allclose(group.unretract(group.retract(jnp.asarray(x))), x)
        assert np.allclose(group.retract(jnp.asarray(x)), algebra.cayley(X / 2))
    assert np.allclose(rep.tensor(M, v), invariants.lie_poisson(("skew", "vector"), skew_M, v))
    assert red.casimir_count(rep) == (n + 1) // 2
    known = exact.jacobian(invariants.casimirs, (skew_M, v), ("skew", "vector"), n)[1].astype(float)
    kernel = red.casimir_gradients(rep, M, v)
    assert len(kernel) == (n + 1) // 2
    assert np.allclose(known @ kernel.T @ kernel, known)


def shear() -> red.Group:
    """The Heisenberg group: not quadratic, nilpotent."""
    E = np.zeros((3, 3, 3))
    E[0, 0, 1] = E[1, 1, 2] = E[2, 0, 2] = 1
    return red.matrix_group(E, "Heisenberg")


def special_linear() -> red.Group:
    """SL(3): the Cayley transform leaves it."""
    E = [np.eye(3)[:, [i]] @ np.eye(3)[[j]] for i in range(3) for j in range(3) if i != j]
    return red.matrix_group([*E, np.diag([1.0, -1, 0]), np.diag([0, 1.0, -1])], "SL(3)")


GROUPS = {
    "SO(3)": lambda: red.SO(3),
    "SO(4)": lambda: red.SO(4),
    "SU(2)": red.SU2,
    "SE(3)": red.SE3,
    "SO(3) x SO(4)": lambda: red.product(red.SO(3), red.SO(4)),
    "Heisenberg": shear,
    "SL(3)": special_linear,
}
ALGEBRAS = {
    "SO(3)": (3, 1),
    "SO(4)": (6, 2),
    "SU(2)": (3, 1),
    "SE(3)": (6, 2),
    "SO(3) x SO(4)": (9, 3),
    "Heisenberg": (3, 1),
    "SL(3)": (8, 2),
}


@pytest.mark.parametrize("name", ["SO(3)", "SO(3) x SO(4)", "Heisenberg", "SL(3)", *full("SO(4)", "SU(2)", "SE(3)")])
def test_groups(name: str) -> None:
    """Structure constants obey Jacobi's identity; retractions have the right derivative and their inverse."""
    group = GROUPS[name]()
    dimension, rank = ALGEBRAS[name]
    assert group.dim == dimension
    assert red.casimir_count(red.trivial(group)) == rank
    assert group.retraction == ("exponential" if name == "SL(3)" else "cayley")
    c = group.structure
    triple = np.einsum("ijl,lkm->ijkm", c, c)
    assert abs(triple + triple.transpose(1, 2, 0, 3) + triple.transpose(2, 0, 1, 3)).max() < 1e-12
    x = rng(1).uniform(-0.4, 0.4, group.dim)
    with red.double():
        g = np.asarray(group.retract(jnp.asarray(x)))
        assert np.allclose(group.unretract(jnp.asarray(g)), x, atol=1e-12)
        assert np.allclose(group.inverse(jnp.asarray(g)) @ g, np.eye(group.size))
        for i, E in enumerate(group.basis):
            slope = (group.retract(1e-5 * np.eye(group.dim)[i]) - group.retract(-1e-5 * np.eye(group.dim)[i])) / 2e-5
            assert np.allclose(slope, E, atol=1e-9)
        ad = np.asarray(group.Ad(jnp.asarray(g)))
        assert np.allclose(np.tensordot(ad, group.basis, (0, 0)), g @ group.basis @ np.linalg.inv(g))


def test_quadratic_casimirs() -> None:
    """<M, P> and <P, P> on so(3) <x so(3) and e(3)*; <l, p> and <p, p> on se(3)*."""
    pair, square = np.kron([[0, 1], [1, 0]], np.eye(3)) / 2, np.kron([[0, 0], [0, 1]], np.eye(3))
    for rep in (red.standard(red.SO(3)), red.adjoint(red.SO(3)), red.adjoint(red.SU2()), red.trivial(red.SE3())):
        Q = red.quadratic_casimirs(rep)
        assert len(Q) == red.casimir_count(rep) == 2
        for form in Q:
            known = np.stack([pair.ravel(), square.ravel()], 1)
            if rep.name == "standard":  # E_12, E_13, E_23 are the axial components 3, -2, 1
                known[:, 0] = np.kron([[0, 1], [0, 0]], [[0, 0, -1], [0, 1, 0], [-1, 0, 0]]).ravel() / 2
                known[:, 0] += np.kron([[0, 1], [0, 0]], [[0, 0, -1], [0, 1, 0], [-1, 0, 0]]).T.ravel() / 2
            weights, *_ = np.linalg.lstsq(known, form.ravel())
            assert np.allclose(known @ weights, form.ravel(), atol=1e-12)
    assert len(red.quadratic_casimirs(red.trivial(red.SU2()))) == 1


def test_a_basis_must_close() -> None:
    with pytest.raises(kr.InputError, match=r"does not close under the bracket: \[E_0, E_1\]"):
        red.matrix_group(red.SO(3).basis[:2])
    with pytest.raises(kr.InputError, match="independent"):
        red.matrix_group([*red.SO(3).basis, red.SO(3).basis[0]])
    with pytest.raises(kr.InputError, match="exponential"):
        red.matrix_group(special_linear().basis, retraction="cayley")


def test_a_representation_must_be_one() -> None:
    group = red.SO(3)
    twofold = red.representation(group, lambda g, v: jnp.concatenate([g @ v[:3], g @ v[3:]]), 6)
    assert np.allclose(twofold.phi, np.kron(np.eye(2), group.basis))
    assert red.casimir_count(twofold) == 3  # <P, P>, <P, Q>, <Q, Q>: the leaves are T*SO(3)
    with pytest.raises(kr.InputError, match="anti-representation"):
        red.representation(group, lambda g, v: g.T @ v, 3)
    with pytest.raises(kr.InputError, match="linear"):
        red.representation(group, lambda g, v: g @ v * (v @ v), 3)


# -- the paper's maps from their Lagrangians --------------------------------------------------------

EXPLICIT = ("lagrange-top", "lagrange-top-moving", "symmetric-top", "clebsch")
SOME = {("lagrange-top", 3), ("clebsch", 3), ("lagrange-top-moving", 4)}  # symmetric-top: intro()
PAPER = [(k, n) for n in (3, 4, 5, 6) for k in EXPLICIT if FULL or (k, n) in SOME]


def registered(name: str, n: int) -> tuple[System, object]:
    """The record with random parameters, and the same map from its discrete Lagrangian alone."""
    model = exact.random_model(REGISTRY[name], n, exact.float_random(rng(n)))

    def Lambda(W, P, *, eps):
        return model.call(model.map.lagrangian, jnp.eye(n), W, P, eps=eps)

    return model, red.system("copy", group=red.SO(n), discrete=Lambda, frame=model.system.frame)()


@pytest.mark.parametrize(("name", "n"), PAPER)
def test_the_papers_maps_follow_from_their_lagrangians(name: str, n: int) -> None:
    model, copy = registered(name, n)
    state = [
        np.stack(z)
        for z in zip(*(model.system.space.point(n, exact.float_random(rng(s))) for s in range(6)), strict=True)
    ]
    if name.startswith("lagrange-top-m"):
        state[0] = state[0] / 2
    ours, theirs = copy.step(*state, eps=0.1), model.step(*state, eps=0.1)
    for a, b in zip(ours, theirs, strict=True):
        assert abs(a - b).max() < 1e-13 * (1 + abs(b).max())


def test_neumanns_lagrangian_is_degenerate_on_the_group() -> None:
    model = kr.Neumann(b=(1, 2, 4))

    def Lambda(W, P, *, eps):
        return model.call(model.map.lagrangian, P / jnp.linalg.norm(P), W.T @ P / jnp.linalg.norm(P), P, eps=eps)

    with pytest.raises(kr.InputError, match="singular at W = I"):
        red.system("neumann-copy", group=red.SO(3), discrete=Lambda)()


# -- generic Lagrangians on many groups -------------------------------------------------------------


def own_kinetic(group: red.Group) -> np.ndarray:
    """A generic inertia operator."""
    A = rng(7).uniform(-1, 1, (group.dim, group.dim))
    return 2 * np.eye(group.dim) + A @ A.T / group.dim


def generic(group: red.Group, space: red.Representation) -> object:
    """A Lagrangian Lambda(W, P) with every kind of coupling, that nothing is special about."""
    K, (u, v) = own_kinetic(group), rng(8).uniform(-1, 1, (2, max(group.dim, space.dim)))

    def Lambda(W, P, *, eps):
        x = group.coordinates(W - jnp.eye(group.size)) / eps
        p = space.space.coordinates(P)
        kinetic = x @ K @ x / 2 + 0.05 * jnp.sin(x @ u[: group.dim]) + 0.1 * (x @ v[: group.dim]) * (p @ v[: space.dim])
        return eps * (kinetic - 0.3 * (p @ u[: space.dim]) ** 2 - jnp.cos(p @ v[: space.dim]))

    return Lambda


SETTINGS = {
    "so(3), R^3": (lambda: red.SO(3), red.standard, REST),
    "so(3), so(3)": (lambda: red.SO(3), red.adjoint, MOVING),
    "su(2), C^2": (red.SU2, red.standard, MOVING),
    "se(3), R^4": (red.SE3, red.standard, MOVING),
}


@pytest.mark.parametrize("name", SETTINGS if FULL else ("so(3), R^3",))
def test_generic_maps_are_poisson_and_solve_the_raw_equation(name: str) -> None:
    """Jacobian by JAX: J Pi J^T = Pi(step); inverse(step) = 1; D1 LL + D2 LL = 0 on G x G, reconstructed."""
    make, on, frame = SETTINGS[name]
    group = make()
    rep = on(group)
    Lambda, eps = generic(group, rep), 0.15
    model = red.system("generic", group=group, discrete=Lambda, representation=rep, frame=frame)()
    draw = rng(3)
    z = draw.uniform(-0.7, 0.7, group.dim + rep.dim)
    p0 = draw.uniform(-0.7, 0.7, rep.dim)
    d, space = group.dim, rep.space
    inner = red.Discrete(lambda W, P: Lambda(W, P, eps=eps), rep, frame)

    @jax.jit
    def derivative(z):
        def step(z):
            W = inner.turn(z[:d], z[d:])
            new = jnp.concatenate([inner.after(W, z[d:]), inner.carried(W, z[d:])])
            return new, (new, W)

        return jax.jacfwd(step, has_aux=True)(z)

    def raw(g, h):
        W = group.inverse(g) @ h if frame is MOVING else h @ group.inverse(g)
        return inner.value(W, rep.act(group.inverse(g) if frame is MOVING else g, p0))

    unreduced = red.Unreduced(raw, group)
    with red.double():
        J, (new, _) = derivative(z)
        back = jnp.concatenate(jax.jit(inner.inverse)(new[:d], new[d:]))
        g0 = group.retract(0.3 * jnp.arange(1.0, d + 1) / d)
        gs, here = [g0], jnp.concatenate([z[:d], rep.act(group.inverse(g0) if frame is MOVING else g0, p0)])
        for _ in range(2):
            _, (here, W) = derivative(here)
            gs.append(inner.reconstruct(gs[-1], W))
        assert abs(jax.jit(unreduced.defect)(*gs)).max() < 1e-12
        if name == "so(3), R^3":
            assert abs(jax.jit(unreduced.step)(*gs[:2])[1] - gs[2]).max() < 1e-12
        J, new, back = map(np.asarray, (J, new, back))
    before, after = rep.tensor(z[:d], z[d:]), rep.tensor(new[:d], new[d:])
    assert abs(new - z).max() > 1e-3
    assert abs(J @ before @ J.T - after).max() < 1e-12
    assert abs(back - z).max() < 1e-12
    shown = model.step(space_of(group.dual, z[:d]), space_of(space, z[d:]), eps=eps)
    assert np.allclose(group.dual.coordinates(shown[0]), new[:d], atol=1e-13)
    assert np.allclose(model.system.space.tensor(*shown), (1 if frame is MOVING else -1) * after)
    casimirs = model.system.space.casimirs
    start = (space_of(group.dual, z[:d]), space_of(space, z[d:]))
    assert np.allclose(casimirs(*shown), casimirs(*start), atol=1e-13)
    assert laws.test(laws.LAWS["casimirs"], laws.make_case(model, group.n, "float", 0)).holds


def space_of(space: object, x: np.ndarray) -> np.ndarray:
    return np.asarray(space.array(x))


# -- continuous -------------------------------------------------------------------------------------


def heavy(Omega, P, *, J, A):
    return -jnp.trace(Omega @ (J[:, None] * Omega)) / 2 - P @ A


@cache
def heavy_top() -> object:
    return red.system("own-top", group=red.SO(3), lagrangian=heavy, conserved=())(J=J3, A=(0.2, 0, 1))


def test_euler_poincare_is_the_registrys_heavy_top() -> None:
    ours, theirs = heavy_top(), kr.HeavyTop(J=J3, A=(0.2, 0, 1))
    M, P = algebra.hat(rng(4).uniform(-1, 1, (5, 3))), rng(5).uniform(-1, 1, (5, 3))
    for a, b in zip(ours.flow(M, P), theirs.flow(M, P), strict=True):
        assert np.allclose(a, b, atol=1e-14)
    for function in ("energy", "velocity"):
        a, b = (m.call(getattr(m.system, function), M, P) for m in (ours, theirs))
        assert np.allclose(a, b, atol=1e-14)


def test_the_rest_frame_is_the_registrys_lagrange_top() -> None:
    """L(omega, a) of section 5, the right equations."""
    alpha, p, A = 0.7, np.array([0.3, -0.1, 1.0]), np.array([0, 0, 1.0])

    def L(omega, a, *, p, alpha):
        return -alpha / 4 * jnp.trace(omega @ omega) + (1 - alpha) / 2 * jnp.sum((omega @ a) ** 2) - p @ a

    ours = red.system("rest", group=red.SO(3), lagrangian=L, frame="rest")(p=p, alpha=alpha)
    theirs = kr.LagrangeTop(p=p, alpha=alpha)
    m, a = algebra.hat(rng(6).uniform(-1, 1, 3)), algebra.cayley(algebra.hat(np.array([0.3, 0.1, -0.5]))) @ A
    for x, y in zip(ours.flow(m, a), theirs.flow(m, a), strict=True):
        assert np.allclose(x, y, atol=1e-14)
    assert np.allclose(ours.call(ours.system.velocity, m, a), theirs.call(theirs.system.velocity, m, a))


def test_acceleration_is_the_same_motion() -> None:
    """(Omega, P)' by the chain rule against M' by the Legendre transform."""
    rep = red.standard(red.SO(3))
    inner = red.Continuous(
        lambda X, P: heavy(X, P, J=J3, A=jnp.array([0.2, 0, 1])) + (P @ X @ J3) ** 2 / 9, rep, MOVING
    )
    with red.double():
        x, P = jnp.asarray(rng(9).uniform(-1, 1, 3)), jnp.asarray(rng(10).uniform(-1, 1, 3))

        @jax.jit
        def both(x, P):
            M, rates = inner.momentum(x, P), inner.acceleration(x, P)
            return inner.velocity(M, P), inner.flow(M, P), jax.jvp(inner.momentum, (x, P), rates)[1], rates[1]

        back, flow, along, dP = both(x, P)
        assert np.allclose(back, x, atol=1e-13)
        assert np.allclose(along, flow[0], atol=1e-13)
        assert np.allclose(dP, flow[1], atol=1e-13)


# -- records, laws, runs ----------------------------------------------------------------------------


def test_every_law_that_applies_holds_for_an_own_lagrangian() -> None:
    verdicts = laws.check(heavy_top())
    assert all(v.holds for v in verdicts), [v for v in verdicts if not v.holds]
    assert {v.law for v in verdicts} == {
        "hamiltonian-flow", "jacobi-identity", "casimirs", "integrals-of-the-flow", "velocity", "integrals-of-the-map",
        "poisson", "inverse", "adjoint", "reconstruction", "discrete-euler-lagrange", "order",
    }  # fmt: skip
    assert {v.numbers for v in verdicts} == {"float"}
    with pytest.raises(kr.InputError, match="only floats"):
        laws.make_case(heavy_top(), 3, "exact", 0)


def test_a_wrong_claim_is_caught() -> None:
    """The energy of the flow is not conserved by the map, and the rule has order 2, not 3."""
    top = heavy_top()
    wrong = replace(top.system, map=replace(top.system.map, conserves=("energy",), order=3))(J=J3, A=(0.2, 0, 1))
    case = laws.make_case(wrong, 3, "float", 0)
    assert not laws.test(laws.LAWS["integrals-of-the-map"], case).holds
    assert not laws.test(laws.LAWS["order"], case).holds


@cache
def intro() -> tuple[object, object]:
    def Lambda(W, P, *, A, eps):
        return kr.SymmetricTop.map.lagrangian(jnp.eye(3), W, P, A=A, eps=eps)

    return kr.SymmetricTop(A=(0, 0, 1)), red.system("intro", group=red.SO(3), discrete=Lambda)(A=(0, 0, 1))


def test_an_ensemble_is_that_of_the_compiled_map() -> None:
    theirs, ours = intro()
    x0 = {"M": rng(2).uniform(-1, 1, (4, 3)) * 1.5, "P": (0, 0.6, 0.8)}
    options = {"dt": 0.1, "steps": 300, "every": 7, "orientation": np.eye(3)}
    a, b = kr.simulate(theirs, x0, method="suris", order=1, **options), kr.simulate(ours, x0, **options)
    assert b.attrs["method"] == "lagrangian"
    for letter in ("M", "P", "g", "casimir"):
        assert abs(a[letter] - b[letter]).max() < 1e-11
    walks.assert_still(b)


def test_linear_algebra_of_small_matrices() -> None:
    """Against LAPACK, where a pivot is zero too; derivatives against differences."""
    A = np.stack([rng(3).normal(size=(4, 4)), np.eye(4)[[1, 2, 3, 0]]])
    with red.double():
        inverse, determinant = numerics.inverse_and_determinant(jnp.asarray(A))
        assert abs(inverse @ A - np.eye(4)).max() < 1e-13
        assert np.allclose(determinant, np.linalg.det(A), rtol=1e-13)
        spd, E = jnp.asarray(A[0] @ A[0].T), jnp.asarray(rng(4).normal(size=(4, 4)))
        for f in (
            lambda X: numerics.slogdet(X)[1],
            lambda X: numerics.inverse(X)[1, 2],
            lambda X: numerics.solve(X, E)[0, 3],
        ):
            slope = (f(spd + 1e-6 * E) - f(spd - 1e-6 * E)) / 2e-6
            assert jax.jvp(f, (spd,), (E,))[1] == pytest.approx(float(slope), rel=1e-7)
            assert (jax.grad(f)(spd) * E).sum() == pytest.approx(float(slope), rel=1e-7)


def test_no_call_of_lapack_waits_for_another() -> None:
    """Two of JAX's calls for batches at once stand still for good on two cores; the compiled maps make none."""
    _, copy = registered("lagrange-top", 4)

    def written(step) -> str:
        with red.double():
            M, P = jnp.zeros((5, 4, 4)), jnp.ones((5, 4))
            return jax.jit(jax.vmap(step)).lower(M, P).as_text()

    def step(M, P):
        return copy.step(M, P, eps=0.1)

    assert "lapack" in written(lambda M, P: jnp.linalg.inv(M))
    assert "lapack" not in written(step)
    assert "lapack" not in written(lambda M, P: jax.jacfwd(step)(M, P))
    assert "lapack" not in written(lambda M, P: kr.LagrangeTop(p=(0, 0, 0, 1)).step(M, P, eps=0.1))


def test_the_reference_runs_the_flow_of_an_own_lagrangian() -> None:
    options = {"dt": 0.01, "steps": 200, "every": 20}
    x0 = {"M": (1, 0, 2), "P": (0, 0.6, 0.8)}
    ours, theirs = heavy_top(), kr.HeavyTop(J=J3, A=(0.2, 0, 1))
    a, b = (kr.simulate(m, x0, method="dop853", **options) for m in (ours, theirs))
    c = kr.simulate(ours, x0, **options)
    assert abs(a.M - b.M).max() < 1e-9
    assert 1e-7 < abs(c.M - b.M).max() < 1e-3  # the map of order 2
    assert kr.drift(c).query("conserved").index.tolist() == ["casimir[0]", "casimir[1]"]


# -- the branch -------------------------------------------------------------------------------------


def moser_veselov(W, *, J, eps):  # M = (J W - W^T J)/eps: two real branches that meet at a fold
    return -jnp.sum(jnp.diagonal(W) * J) / eps


def test_the_branch_with_the_continuous_limit_ends_at_a_fold() -> None:
    group = red.SO(3)
    top = red.system("veselov", group=group, representation=red.trivial(group), discrete=moser_veselov)(J=J3)
    inner = red.Discrete(lambda W, P: moser_veselov(W, J=J3, eps=1.0), red.trivial(group), MOVING)
    axis = np.array([0, 0, 1.0])
    most = J3[0] + J3[1]  # about the third axis M = (J1 + J2) sin(angle)/eps
    turn = jax.jit(inner.turn)
    for share in (0.5, 0.9, 0.999):
        W_turn = np.arcsin(share)
        M = algebra.hat(axis * most * share)
        (new,) = top.step(M, eps=1.0)
        assert np.allclose(new, M, atol=1e-12)  # a steady turn
        with red.double():
            W = turn(jnp.asarray(algebra.coordinates(M)), jnp.zeros(0))
        assert np.arctan2(abs(W[1, 0]), W[0, 0]) == pytest.approx(W_turn, abs=1e-9)  # not pi - W_turn
    with pytest.raises(kr.RunError, match="smaller dt"):
        top.step(1.001 * algebra.hat(axis * most), eps=1.0)
    with pytest.raises(kr.RunError, match=r"Step 1 .*branch with the continuous limit.*Use dt = 0.5"):
        kr.simulate(top, {"M": 1.001 * axis * most}, dt=1.0, steps=10)


def test_a_run_names_the_step_at_which_the_branch_ends() -> None:
    """Falling from the unstable equilibrium, the momentum grows until the step has no solution."""

    def Lambda(W, P, *, eps):
        return -2 * jnp.trace(W) / eps - eps * 3 * P[2]

    model = red.system("falling", group=red.SO(3), discrete=Lambda)()
    x0 = {"M": [(0, 0, 0), (0.05, 0, 0)], "P": (0, 0, 1)}
    with pytest.raises(kr.RunError, match=r"Step \d+ of lane 1 \(time") as caught:
        kr.simulate(model, x0, dt=1.3, steps=200)
    step = int(str(caught.value).split()[1])
    assert step > 1
    assert kr.simulate(model, x0, dt=1.3, steps=step - 1).sizes["time"] == step


def test_the_path_is_followed_where_newton_alone_goes_astray() -> None:
    """atan: Newton's method from 0 diverges beyond 1.39; tan(x) is on the branch."""
    with red.double():
        root = jax.jit(lambda y: numerics.find_root(lambda x, y: jnp.arctan(x) - y, 1, y))
        for y in (0.3, 1.0, 1.4, 1.5):
            assert float(root(jnp.asarray([y]))[0]) == pytest.approx(np.tan(y), rel=1e-9)
        assert np.isnan(root(jnp.asarray([1.6])))


# -- derivatives ------------------------------------------------------------------------------------


def test_gradients_through_a_step() -> None:
    """By the implicit function theorem, against complex steps of the explicit map."""
    theirs, ours = intro()
    M, P, A = algebra.hat(np.array([0.3, -0.2, 1.5])), np.array([0.6, 0, 0.8]), np.array([0, 0, 1.0])
    step = ours.system.map.step

    def endpoint(A, eps):
        z = step(jnp.asarray(M), jnp.asarray(P), A=A, eps=eps)
        return (z[1] * jnp.array([1.0, 2, 3])).sum()

    def by_numpy(A, eps):
        z = theirs.system.map.step(M.astype(complex), P.astype(complex), A=A, eps=eps)
        return (z[1] * [1, 2, 3]).sum()

    with red.double():
        gradient, slope = jax.jit(jax.grad(endpoint, (0, 1)))(jnp.asarray(A), jnp.asarray(0.2))
    h = 1e-30
    for i in range(3):
        nudge = np.eye(3)[i] * 1j * h
        assert float(gradient[i]) == pytest.approx(by_numpy(A + nudge, 0.2).imag / h, rel=1e-11, abs=1e-12)
    assert float(slope) == pytest.approx(by_numpy(A, 0.2 + 1j * h).imag / h, rel=1e-11)


def test_gradients_of_an_implicit_map_against_finite_differences() -> None:
    """Of a step of the heavy top, along its inertia, its arm, the step and the momentum."""
    step = heavy_top().system.map.step
    known = {"J": J3, "A": np.array([0.2, 0, 1]), "eps": np.array(0.2), "M": np.array([0.3, -0.2, 1.5])}

    def endpoint(known):
        z = algebra.hat(known["M"]), jnp.array([0.6, 0, 0.8])
        for _ in range(1 + FULL):
            z = step(*z, J=known["J"], A=known["A"], eps=known["eps"])
        return ((z[0] + z[1]) * jnp.array([1.0, 2, 3])).sum()

    with red.double():
        both = jax.jit(jax.value_and_grad(endpoint))
        gradient = both({k: jnp.asarray(v) for k, v in known.items()})[1]
        h = 1e-3
        for name, value in known.items():
            for i in range(value.size):
                nudge = h * (np.arange(value.size) == i).reshape(value.shape)
                a, b, c, d = (float(both({**known, name: value + k * nudge})[0]) for k in (-2, -1, 1, 2))
                slope = (a - 8 * b + 8 * c - d) / (12 * h)  # wrong by O(h^4), and by round-off/h
                assert float(gradient[name].reshape(-1)[i]) == pytest.approx(slope, rel=1e-8, abs=1e-9), name


def test_the_symmetric_rule_is_the_variational_method() -> None:
    """One discrete Lagrangian by two ways: JAX and Newton's method, and the kicks and free steps of the kernels."""
    options = {"dt": 0.2, "steps": 200, "every": 10}
    x0 = {"M": rng(2).uniform(-1, 1, (4, 3)) * 1.5, "P": (0, 0.6, 0.8)}
    own = kr.simulate(heavy_top(), x0, **options)
    ours = kr.simulate(kr.HeavyTop(J=J3, A=(0.2, 0, 1)), x0, method="variational", order=2, **options)
    assert abs(own.M - ours.M).max() < 1e-11
    assert abs(own.P - ours.P).max() < 1e-11


def test_derivatives_of_a_root_to_second_order() -> None:
    def root(y):
        return numerics.find_root(lambda x, y: jnp.arctan(x) - y, 1, jnp.reshape(y, 1))[0]

    with red.double():
        first, second = (float(jax.jit(f)(jnp.asarray(1.4))) for f in (jax.grad(root), jax.grad(jax.grad(root))))
    t = np.tan(1.4)
    assert first == pytest.approx(1 + t**2, rel=1e-9)
    assert second == pytest.approx(2 * t * (1 + t**2), rel=1e-9)


def test_the_users_precision_is_left_alone() -> None:
    assert not jax.config.jax_enable_x64
    top = heavy_top()
    out = top.step(algebra.hat(np.array([1.0, 0, 2])), np.array([0, 0.6, 0.8]), eps=0.1)
    assert all(isinstance(z, np.ndarray) and z.dtype == np.float64 for z in out)
    assert jnp.ones(2).dtype == np.float32
    with pytest.raises(kr.InputError, match=r"with kreisel\.reduction\.double\(\)"):
        top.step(jnp.zeros((3, 3)), jnp.ones(3), eps=0.1)


# -- Lagrangians that cannot be used ----------------------------------------------------------------


def own(**lagrangian: object) -> object:
    return red.system("bad", group=red.SO(3), **lagrangian)()


BAD = {
    "one real number": lambda Omega, P: Omega @ P,
    "failed": lambda Omega, P: P @ jnp.ones(4),
    "numpy for jax.numpy": lambda Omega, P: float(P[0]),
    "an `if` on a value": lambda Omega, P: P @ P if P[0] > 0 else 0.0,
    "not finite at Omega = 0": lambda Omega, P: jnp.sqrt(jnp.sum(Omega**2)),
    "singular at Omega = 0": lambda Omega, P: jnp.sum((Omega @ P) ** 2),
    "complex128": lambda Omega, P: 1j * jnp.sum(Omega**2),
}


@pytest.mark.parametrize("message", BAD)
def test_bad_lagrangians_are_refused(message: str) -> None:
    with pytest.raises(kr.InputError, match=message):
        own(lagrangian=BAD[message])


def test_more_bad_input() -> None:
    with pytest.raises(kr.InputError, match="singular at W = I"):
        own(discrete=lambda W, P, *, eps: jnp.sum((W @ P) ** 2))
    with pytest.raises(kr.InputError, match="twice differentiable"):
        own(discrete=lambda W, P, *, eps: jnp.sqrt(3 - jnp.trace(W)) + P @ P)
    with pytest.raises(kr.InputError, match="needs a Lagrangian"):
        own()
    with pytest.raises(kr.InputError, match="'moving'"):
        own(lagrangian=heavy, frame="body")
    with pytest.raises(kr.InputError, match="needs the parameter A"):
        red.system("top", group=red.SO(3), lagrangian=heavy)(J=J3)
    with pytest.raises(kr.InputError, match="conserved: expected names of energy, got 'noether'"):
        red.system("top", group=red.SO(3), lagrangian=heavy, conserved=("noether",))
    with pytest.raises(kr.InputError, match="has the parameter"):
        red.system("top", group=red.SO(3), lagrangian=heavy, parameters=[red.Parameter("B", "vector", "")])
    with pytest.raises(kr.InputError, match="method='suris': expected a system with an explicit map"):
        kr.simulate(heavy_top(), {"M": (1, 0, 2), "P": (0, 0, 1)}, dt=0.1, steps=2, method="suris")
    with pytest.raises(kr.InputError, match=r"method='lagrangian': expected a system of kreisel\.reduction"):
        kr.simulate(kr.Clebsch(b=(1, 2, 3)), {"M": (1, 0, 2), "P": (0, 0, 1)}, dt=0.1, steps=2, method="lagrangian")


MISTAKES = {
    "groups such as": red.product,
    "dim must be an integer": lambda: red.representation(red.SO(3), lambda g, v: v, "3"),
    "failed for g .* division": lambda: red.representation(red.SO(3), lambda g, v: v / (1 // 0), 3),
    "as momentum": lambda: own(lagrangian=heavy, integrals={"momentum": 3}),
    "records such as": lambda: own(lagrangian=heavy, parameters=["J"]),
    "without eps": lambda: own(lagrangian=lambda Omega, P, *, eps: jnp.sum(Omega**2)),
    "must accept two group elements": lambda: red.reduce(lambda g, h: 0.0, red.standard(red.SO(3)), MOVING),
    "frame must be": lambda: red.Continuous(heavy, red.standard(red.SO(3)), "body"),
}


@pytest.mark.parametrize("message", MISTAKES)
def test_wrong_arguments_are_named(message: str) -> None:
    with pytest.raises(kr.InputError, match=message):
        MISTAKES[message]()


def test_a_frame_may_be_its_name() -> None:
    """Left is left: P' = P x Omega in the moving frame, M = Omega of a sphere; a' = omega x a in the rest frame."""

    def sphere(Omega, P):
        return -jnp.trace(Omega @ Omega) / 4

    rep, M, P = red.standard(red.SO(3)), (0.3, -0.5, 1.1), (0.6, 0.2, 0.8)
    with red.double():
        xi = rep.group.coordinates(jnp.asarray(algebra.hat(np.array(M))))
        rates = [red.Continuous(sphere, rep, name).flow(xi, jnp.asarray(P))[1] for name in ("moving", "rest")]
    assert np.allclose(rates, [np.cross(P, M), np.cross(M, P)], atol=1e-14)


def test_reduction_asks_for_invariance() -> None:
    """LL(g, h, p) of the Introduction reduces from the left, not from the right, and not with a fixed vector."""
    rep, A = red.standard(red.SO(3)), np.array([0.1, 0.2, 1.0])

    def LL(g, h, p):
        return kr.SymmetricTop.map.lagrangian(g, h, p, A=A, eps=0.1)

    Lambda = red.reduce(LL, rep, MOVING)
    g, h = (random_element(rep.group, rng(s)) for s in (1, 2))
    with red.double():
        p = jnp.asarray(rng(3).uniform(-1, 1, 3))
        assert float(Lambda(g.T @ h, g.T @ p)) == pytest.approx(float(LL(g, h, p)), rel=1e-13)
    with pytest.raises(kr.InputError, match=r"right translations by the isotropy group G\^\[A\]"):
        red.reduce(LL, rep, REST)
    with pytest.raises(kr.InputError, match=r"left translations by the isotropy group G\^\[p\]"):
        red.reduce(lambda g, h, p: LL(g, h, p) + (g @ A)[0], rep, MOVING)
    with pytest.raises(kr.InputError, match="moved together"):
        red.reduce(lambda g, h, p: LL(g, h, p) + p[0], rep, MOVING)


# -- the command line -------------------------------------------------------------------------------

FILE = """
import jax.numpy as jnp
from kreisel import reduction as red

def L(Omega, P, *, J):
    return -jnp.trace(Omega @ (J[:, None] * Omega)) / 2 - jnp.sum(P**4)

SYSTEM = red.system("quartic-top", group=red.SO(3), lagrangian=L)
"""
TOML = """
[system]
name = "{name}"
file = "{file}"
J = [1.0, 1.6, 2.3]
[state]
M = [1.0, 0.0, 2.0]
P = [0.0, 0.6, 0.8]
[run]
dt = 0.05
steps = 40
[output]
path = "{path}"
"""


def test_a_config_names_a_file_of_the_users_own(
    tmp_path: Path, kreisel: Callable[..., subprocess.CompletedProcess[str]]
) -> None:
    (tmp_path / "own.py").write_text(FILE)
    config, archive = tmp_path / "run.toml", tmp_path / "run.zarr"
    config.write_text(TOML.format(name="quartic-top", file="own.py", path=archive))
    ran = kreisel("run", str(config))
    assert (ran.returncode, ran.stderr) == (0, "")
    assert archive.with_suffix(".png").stat().st_size > 10_000
    (tmp_path / "own.py").write_text("raise RuntimeError('an archive is data: this must not run')")
    checked = kreisel("check", str(archive))
    assert checked.returncode == 0, checked.stderr
    assert "a user-defined system: its integrals were not computed again" in checked.stdout
    with pytest.raises(kr.InputError, match="holds no code"):
        resume(archive, extend=80)
    config.write_text(TOML.format(name="quartic-topp", file="own.py", path=archive))
    failed = kreisel("run", str(config))
    assert (failed.returncode, failed.stderr.count("Traceback")) == (2, 0)
    assert "line 1: RuntimeError: an archive is data" in failed.stderr


def test_files_that_cannot_be_used(tmp_path: Path) -> None:
    file = tmp_path / "own.py"
    with pytest.raises(kr.InputError, match="No file"):
        load_system("quartic-top", file)
    for text, message in (
        ("import nothing_like_it", "line 1: ModuleNotFoundError"),
        ("def f(:", "line 1: SyntaxError"),
        (FILE, "Did you mean 'quartic-top'?"),
        (
            FILE.replace('"quartic-top"', '"quartic-topp"').replace("group=red.SO(3)", "group=red.SO(1)"),
            "SO\\(n\\) needs",
        ),
    ):
        file.write_text(text)
        with pytest.raises(kr.InputError, match=message.replace("?", "[?]")):
            load_system("quartic-topp", file)
    file.write_text(FILE.replace("quartic-top", "clebsch"))
    with pytest.raises(kr.InputError, match="Choose another name"):
        load_system("clebsch", file)


def test_groups_are_compared_by_meaning() -> None:
    """The same group made twice is one group; another basis is another."""
    made = red.system(
        "alike", group=red.SO(3), lagrangian=lambda W: -jnp.trace(W @ W), representation=red.trivial(red.SO(3))
    )
    assert made.space.letters == ("M",)
    with pytest.raises(kr.InputError, match="expected one of the group SO"):
        red.system("unlike", group=red.SO(3), lagrangian=lambda W: 0.0, representation=red.trivial(red.SO(4)))
