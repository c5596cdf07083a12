"""The lattice Landau-Lifshitz model in discrete time: its gate over Q and in 60 digits, and what runs of it keep."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from fractions import Fraction
from math import isqrt
from typing import Any
from unittest import mock

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import kreisel as kr
from kreisel import algebra
from kreisel.lab import exact, laws
from kreisel.record.spheres import random_spins
from kreisel.system import lattice_landau_lifshitz as lattice

Spin = tuple[Any, ...]


def root(x: Any) -> Any:
    """Of the square of a rational number."""
    if isinstance(x, np.ndarray):
        return np.array([root(v) for v in x.flat], dtype=object).reshape(x.shape)
    v = Fraction(int(x.p), int(x.q)) if hasattr(x, "p") else Fraction(x)
    top, bottom = isqrt(v.numerator), isqrt(v.denominator)
    assert Fraction(top, bottom) ** 2 == v, "no square"
    return exact.rational(top, bottom)


@contextmanager
def over_q() -> Iterator[None]:
    with mock.patch.object(lattice, "sqrt", root):
        yield


def spins(count: int, seed: int = 0) -> list[Spin]:
    """Rational points of the sphere, each as x, y, z (1,)."""
    found = random_spins(count, exact.rational_random(np.random.default_rng(seed)))
    return [tuple(x[i : i + 1] for x in found) for i in range(count)]


def same(a: Spin, b: Spin) -> bool:
    return all((x == y).all() for x, y in zip(a, b, strict=True))


Gate = Callable[[Spin, Spin, Any, Any], tuple[Spin, Spin]]


def swapped(N: Spin, other: Spin, D: Any, eps: Any) -> tuple[Spin, Spin]:
    return lattice.gate(N, other, D, eps)[::-1]


def other_way(N: Spin, other: Spin, D: Any, eps: Any) -> tuple[Spin, Spin]:
    return lattice.gate(N, other, D, -eps)


def turns_about_the_sum(N: Spin, other: Spin, eps: Any) -> Spin:
    """Of Krajnik and Prosen: (s N + t N' + eps N x N')/(s + t), s = (1 + <N, N'>)/2, t = eps^2."""
    a = lattice.inner(N, other)
    s, t, c = (1 + a) / 2, eps * eps, lattice.cross(N, other)
    return tuple((s * x + t * y + eps * z) / (s + t) for x, y, z in zip(N, other, c, strict=True))


def test_the_isotropic_gate_over_q() -> None:
    N, other = spins(2)
    eps, D = exact.rational(2, 7), exact.rational(0, 1)
    with over_q():
        A, B = lattice.gate(N, other, D, eps)
    assert same(A, turns_about_the_sum(N, other, eps)) and same(B, turns_about_the_sum(other, N, eps))
    assert same(*(tuple(x + y for x, y in zip(*pair, strict=True)) for pair in ((A, B), (N, other))))
    assert not same(A, turns_about_the_sum(N, other, -eps))


def braided(gate: Gate) -> bool:
    """The braid relation of gates at u1 - u2, u1 - u3, u2 - u3, over Q: the set-theoretic Yang-Baxter equation."""
    u = [exact.rational(*v) for v in ((1, 3), (-2, 5), (3, 7))]
    D = exact.rational(0, 1)

    def through(places: tuple[int, int, int]) -> list[Spin]:
        state, angles = spins(3, seed=4), list(u)
        for i in places:
            state[i], state[i + 1] = gate(state[i], state[i + 1], D, (angles[i] - angles[i + 1]) / 2)
            angles[i], angles[i + 1] = angles[i + 1], angles[i]
        return state

    with over_q():
        return all(same(a, b) for a, b in zip(through((0, 1, 0)), through((1, 0, 1)), strict=True))


def test_the_set_theoretic_yang_baxter_equation_over_q() -> None:
    def halved(N: Spin, other: Spin, D: Any, eps: Any) -> tuple[Spin, Spin]:
        return lattice.gate(N, other, D, eps * eps)

    assert braided(lattice.gate)
    assert not braided(halved)
    assert not braided(swapped)


def test_the_total_spin_of_the_isotropic_model_over_q() -> None:
    draw = exact.rational_random(np.random.default_rng(2))
    z = (*random_spins(3, draw), *random_spins(3, draw))
    total = lambda z: [a.sum() + b.sum() for a, b in zip(z[:3], z[3:], strict=True)]  # noqa: E731
    with over_q():
        D, eps = exact.rational(0, 1), exact.rational(1, 3)
        new = lattice.step(*z, D=D, eps=eps)
        assert total(new) == total(z) and not same(new[:3], z[:3])
        alone = lattice.gate(z[:3], z[3:], D, eps)[0]
        assert total((*alone, *z[3:])) != total(z)


def off_refactorization(D: str, gate: Gate) -> float:
    """q(u + t; N) q(u - t; N') - q(u - t; A) q(u + t; B), in 60 digits."""
    flint = pytest.importorskip("flint")
    arb = flint.arb
    before, flint.ctx.dps = flint.ctx.dps, 60
    try:
        d, eps, mu = arb(D), arb(3) / 10, arb(2) / 5
        numbers = np.array([arb(int(v)) / 50 for v in np.random.default_rng(5).integers(1, 99, 4)]).reshape(2, 2)
        x = random_spins(2, lambda shape: numbers)
        N, other = (tuple(v[i : i + 1] for v in x) for i in range(2))
        c = (1 - d * mu * mu).sqrt()
        cos, sin = 1 / (1 + d * eps * eps).sqrt(), eps / (1 + d * eps * eps).sqrt()  # of t, sin over s

        def q(N: Spin, sign: int) -> Spin:
            return (
                (mu * cos + sign * c * sin) * lattice.height(N, d),
                N[0],
                N[1],
                (c * cos - sign * d * mu * sin) * N[2],
            )

        A, B = gate(N, other, d, eps)
        left, right = lattice.times(q(N, 1), q(other, -1)), lattice.times(q(A, -1), q(B, 1))
        return max(float(abs(a - b)[0].mid()) for a, b in zip(left, right, strict=True))
    finally:
        flint.ctx.dps = before


@pytest.mark.parametrize("D", ["0", "0.7", "3", "-0.6"])
def test_the_gate_refactorizes_the_lax_matrices(D: str) -> None:
    assert off_refactorization(D, lattice.gate) < 1e-50
    assert off_refactorization(D, swapped) > 1e-3
    assert off_refactorization(D, other_way) > 1e-3


@pytest.mark.parametrize("D", [0.0, -0.5, 0.8])
def test_the_laws_for_each_sign_of_the_anisotropy(D: float) -> None:
    verdicts = laws.check(kr.LatticeLandauLifshitz(n=3, D=D))
    assert {"poisson", "integrals-of-the-map", "involution", "inverse"} <= {v.law for v in verdicts}
    assert all(v.holds for v in verdicts)


def test_the_integrals_are_complete() -> None:
    """2n independent ones on the 4n-dimensional product of spheres."""
    n = 3
    model = kr.LatticeLandauLifshitz(n=n, D=0.3)
    z = model.system.space.point(n, exact.float_random(np.random.default_rng(1)))
    kinds = model.system.space.kinds
    found = [
        np.atleast_2d(exact.jacobian(lambda *z, f=f: model.call(f, *z), z, kinds, n)[1].astype(float))
        for f in (*model.system.integrals.values(), model.system.space.casimirs)
    ]
    values = np.linalg.svd(np.concatenate(found), compute_uv=False)
    assert (values > 1e-6 * values[0]).sum() == 2 * n + 2 * n


def test_the_variables_are_canonical_up_to_a_factor() -> None:
    """{angle, z~} is constant, sinh(h z~) = z sinh h."""
    D, n = 0.7, 3
    model = kr.LatticeLandauLifshitz(n=n, D=D)
    z = model.system.space.point(n, exact.float_random(np.random.default_rng(1)))
    tensor, (x, y, w) = model.call(model.system.space.tensor, *z), z[:3]
    angle = np.concatenate([np.diag(-y / (x * x + y * y)), np.diag(x / (x * x + y * y)), 0 * np.eye(3)], 1)
    height = np.concatenate([0 * np.eye(3), 0 * np.eye(3), np.diag(1 / np.sqrt(1 + D * w * w))], 1)  # dz~ h/s
    assert np.allclose(abs(angle @ tensor[:9, :9] @ height.T), np.eye(3))


def given(n: int, seed: int = 0) -> dict[str, np.ndarray]:
    draw = exact.float_random(np.random.default_rng(seed))
    return dict(zip(lattice.SYSTEM.space.letters, (*random_spins(n, draw), *random_spins(n, draw)), strict=True))


def test_its_order_is_1() -> None:
    model, start = kr.LatticeLandauLifshitz(n=4, D=-0.3), given(4)
    kinds = model.system.space.kinds
    rate = lambda t, y: algebra.flatten(model.flow(*algebra.restore(y, kinds, 4)), kinds)  # noqa: E731
    y0 = algebra.flatten(tuple(start.values()), kinds)
    truth = solve_ivp(rate, (0, 0.2), y0, method="DOP853", rtol=1e-8, atol=1e-10).y[:, -1]  # errors are 0.02 and more
    errors, counts = [], (400, 800, 1600)
    for count in counts:
        made = kr.propagator(model, dt=0.2 / count).steps(start, count)
        errors.append(abs(algebra.flatten(tuple(made[k] for k in start), kinds) - truth).max())
    assert abs(-np.polyfit(np.log(counts), np.log(errors), 1)[0] - 1) < 0.1


def test_runs_and_archives(tmp_path: Any) -> None:
    model, start = kr.LatticeLandauLifshitz(n=4, D=0.5), given(4)
    options = {"dt": 0.2, "every": 100, "progress": False}
    run = kr.simulate(model, start, steps=20_000, path=tmp_path / "a.zarr", **options)
    assert run.attrs["method"] == "brickwork"
    table = kr.drift(run)
    kept = {name.partition("[")[0] for name in table.index[table.conserved]}
    assert kept == {"casimir", "energy_eps", "transfer_eps", "magnetization"}
    assert (table.max_change[table.conserved] < 1e-10).all() and table.max_change["energy"] > 0.1
    assert kr.plot(run).axes
    first = run.Sx.values[:6]
    longer = kr.resume(tmp_path / "a.zarr", extend=30_000)
    whole = kr.simulate(model, start, steps=30_000, **options)
    assert all(np.array_equal(longer[k].values, whole[k].values) for k in start)
    many = kr.simulate(kr.LatticeLandauLifshitz(n=4, D=[0.5, -0.2]), start, steps=500, **options)
    assert np.array_equal(many.Sx.isel(lane=0).values, first)


def test_bad_input() -> None:
    start = given(3)
    with pytest.raises(kr.InputError, match="expected D > -1"):
        kr.LatticeLandauLifshitz(n=3, D=-1.0)
    with pytest.raises(kr.InputError, match="has no orientation"):
        kr.simulate(kr.LatticeLandauLifshitz(n=3), start, dt=0.1, steps=10, orientation=(1, 0, 0, 0))
    with pytest.raises(kr.InputError, match="from 3 on"):
        kr.SpinChain(n=2)
    with pytest.raises(kr.InputError, match=r"expected dt < 2, got 2\.5"):
        kr.simulate(kr.LatticeLandauLifshitz(n=3, D=-0.25), start, dt=2.5, steps=10)
    with pytest.raises(kr.InputError, match="must lie on"):
        kr.simulate(kr.LatticeLandauLifshitz(n=3), {**start, "Sx": 2 * start["Sx"]}, dt=0.1, steps=10)
    with pytest.raises(kr.InputError, match="brickwork"):
        kr.simulate(kr.SpinChain(n=3), {k: start[k] for k in ("Sx", "Sy", "Sz")}, dt=0.1, steps=10, method="brickwork")
