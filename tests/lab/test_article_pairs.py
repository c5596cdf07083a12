"""Formulas of paper/maps.tex: pairs of maps as flows, Poisson maps, the bound of branch points, the r-matrix."""

from __future__ import annotations

import json
from typing import Any

import mpmath
import numpy as np
import pytest
import scipy.integrate
import scipy.linalg

import kreisel as kr
from article import (
    J,
    komarov_matrix,
    lax_matrix,
    normal,
    null_vector,
)
from kreisel import algebra
from kreisel.method import conjugate, scheme
from support import ROOT

PAIRS = (
    "clebsch-general",
    "quadratic-potential",
    "steklov-lyapunov",
    "rubanovskii",
    "kovalevskaya-gyrostat",
    "komarov",
)


def _body(name: str) -> tuple[Any, Any, Any]:
    """A model, its state, and the factor of the Hamiltonian of `rates`: of alpha/lam, of mu for Steklov's case."""
    rng = np.random.default_rng(43)
    M, P, Q = rng.normal(size=(3, 3))
    b = {"b": (0.3, 0.7, 1.9), "s": 0.4, "l": 0.7}
    model, state, factor = {
        "clebsch-general": (kr.ClebschGeneral(a=(1, 2, -0.7), b=(1, 4, 0.49)), {"M": M, "P": P}, 2),
        "quadratic-potential": (kr.QuadraticPotential(J=(1, 1.6, 2.3)), {"M": M, "P": np.outer(P, P) + np.diag(Q)}, 2),
        "steklov-lyapunov": (kr.SteklovLyapunov(**b), {"M": M, "P": P}, 2j),
        "rubanovskii": (kr.Rubanovskii(h=Q, **b), {"M": M, "P": P}, 2j),
        "komarov": (kr.Komarov(kappa=-0.4, beta=0.6, c=1.3, gamma=0.3), {"M": M, "P": P}, 4),
        "kovalevskaya-gyrostat": (kr.KovalevskayaGyrostat(n=3, gamma=0.7), {"M": M, "P": P, "Q": Q}, 4),
    }[name]
    return model, tuple(model.state(**state)[k] for k in model.system.space.letters), factor


def _levels(model: Any, z: Any, lam: Any) -> tuple[Any, Any, Any]:
    """Eigenvalues but those at infinity, left and right vectors as rows."""
    record, L = model.system.pairs, model.call(model.system.pairs.matrix, *z, lam=np.array([lam], complex))[0]
    S = np.eye(len(L)) if record.metric is None else np.diag(model.call(record.metric))
    values, left, right = scipy.linalg.eig(L.astype(complex), S, left=True)
    left, right, values = (x.T[np.isfinite(values)] for x in (left.conj(), right, values))
    return values, left / np.einsum("ij,jk,ik->i", left, S, right)[:, None], right


def _at(model: Any, z: Any, lam: Any, near: Any) -> tuple[Any, Any]:
    """The eigenvalue next to a value, and the field of the pairs there."""
    values, left, right = _levels(model, z, lam)
    place = abs(values - near).argmin()
    Pi = right[place][None, :, None] * left[place][None, None, :]
    field, _ = model.call(model.system.pairs.rates, *z, lam=np.array([lam]), Pi=Pi)
    return values[place], algebra.flatten(field, model.system.space.kinds)[0]


@pytest.mark.parametrize("name", PAIRS)
def test_pairs_are_flows(name: str) -> None:
    """The Hamiltonian of `rates`, by Poisson's tensor, at the start; and d/dx of a pair is that field at its end."""
    model, z, factor = _body(name)
    kinds, lam, h = model.system.space.kinds, 0.3 + 2.1j, 1e-5
    x, mu = algebra.flatten(z, kinds), _levels(model, z, lam)[0]
    near = mu[mu.imag.argmax()]
    slope = np.array(
        [
            (
                _at(model, algebra.restore(x + h * e, kinds, 3), lam, near)[0]
                - _at(model, algebra.restore(x - h * e, kinds, 3), lam, near)[0]
            )
            / (2 * h)
            for e in np.eye(len(x))
        ]
    )
    tensor = -np.asarray(model.call(model.system.space.tensor, *z), float)  # F' = {H, F}
    energy = np.array(
        [
            (
                model.call(model.system.energy, *algebra.restore(x + h * e, kinds, 3))
                - model.call(model.system.energy, *algebra.restore(x - h * e, kinds, 3))
            )
            / (2 * h)
            for e in np.eye(len(x))
        ]
    )
    flow = algebra.flatten(model.flow(*z), kinds)
    assert abs(tensor @ energy - flow).max() < 1e-7 * abs(flow).max()  # the sign of the bracket
    field = _at(model, z, lam, near)[1]
    right = tensor @ slope * (factor if factor == 2j else factor / lam)
    assert abs(field - right).max() < 1e-7 * abs(field).max()
    assert abs(field - 1.001 * right).max() > 1e-4 * abs(field).max()

    def moved(step: float) -> Any:
        at = lam + step
        return model.call(model.system.pairs.pair, *z, lam=np.complex128(at), mu=_at(model, z, at, near)[0])[0]

    rate = (algebra.flatten(moved(h), kinds) - algebra.flatten(moved(-h), kinds)) / (2 * h)
    expected = _at(model, moved(0.0), lam, near)[1].real
    assert abs(rate - expected).max() < 1e-7 * abs(expected).max()


@pytest.mark.parametrize("name", PAIRS)
def test_step_condition(name: str) -> None:
    """The points of a step, by 40 nodes of Gauss and Legendre, which the software does not use."""
    model, z, _ = _body(name)
    points, _ = conjugate.constants(model, z, 0.2)
    nodes, weights = np.polynomial.legendre.leggauss(40)
    total = 0.0
    for x, y, real, imaginary in points:
        near = complex(real, imaginary)
        for node, weight in zip(nodes[::-1], weights[::-1], strict=True):  # from the end of the path
            near, field = _at(model, z, 1j * y + x * (node + 1) / 2, near)
            total = total + x * weight / 2 * field.real
    flow = 0.2 * algebra.flatten(model.flow(*z), model.system.space.kinds)
    assert abs(total - flow).max() < 1e-12 * abs(flow).max()


def _images(case: str, rng: np.random.Generator) -> tuple[int, Any, Any]:
    """The dimension, the map (x, lam, near, strength) -> x' and Poisson's tensor; `near` holds the eigenvalue."""

    def level(L: Any, near: list[Any]) -> Any:
        values = mpmath.eig(mpmath.matrix(L.tolist()), left=False, right=False)
        near[:] = [near[0] if near else values[0]]
        return null_vector(L, min(values, key=lambda v: abs(v - near[0])))

    if case in ("unequal", "steklov"):
        model: Any = (
            kr.QuadraticPotential(J=(1, 1.6, 2.3))
            if case == "unequal"
            else kr.Rubanovskii(b=(0.3, 0.7, 1.9), s=1, l=1, h=(0, 0, 0))
        )
        kinds, A, square = model.system.space.kinds, np.diag(normal(rng, 3)), _square(3)

        def image(x: Any, lam: Any, near: list[Any], strength: int) -> Any:
            M, F = algebra.restore(x, kinds, 3)
            C = square if case == "unequal" else lam * square - A
            L = lam * A + M + F / lam if case == "unequal" else M - (A @ F + F @ A) / 2 + lam * F
            q = level(_inverse(C) @ L, near)
            P = np.outer(q, q) / sum(q * q)
            R = square - 2 * P
            if case == "unequal":
                return algebra.flatten((M - 2 * strength * lam * (P @ A - A @ P), R @ F @ R), kinds)
            W, F1 = -2 * strength * P @ C, R @ F @ R
            M0 = R @ (M - (A @ F + F @ A) / 2) @ R + W.T @ F @ R + R @ F @ W
            return algebra.flatten((M0 + (A @ F1 + F1 @ A) / 2, F1), kinds)

        size = 9 if case == "unequal" else 6
        return size, image, lambda x: model.call(model.system.space.tensor, *algebra.restore(x, kinds, 3))

    if case == "top":  # so(3) x so(2) and two fields, N free: Gamma = N + E^T M E is not 0

        def parts(x: Any) -> tuple[Any, Any, Any]:
            return algebra.hat(x[:3]), x[3] * J, x[4:].reshape(3, 2)

        def packed(M: Any, N: Any, F: Any) -> Any:
            return np.array([M[2, 1], M[0, 2], M[1, 0], N[0, 1], *F.ravel()], dtype=object)

        def moved(x: Any, lam: Any, near: list[Any], strength: int) -> Any:
            M, N, F = parts(x)
            v = level(lax_matrix(M, N, F, lam), near)
            x1, y1, E, norm = v[:3], v[3:], _square(3)[:, :2], sum(v[3:] * v[3:])
            left, right = (np.outer(w, z) / norm for w, z in ((E @ y1, x1), (E.T @ x1, y1)))
            M, N = M + 2 * strength * lam * (left - left.T), N + 2 * strength * lam * (right - right.T)
            first, second = (_square(len(w)) - 2 * np.outer(w, w) / norm for w in (x1, y1))
            return packed(M, N, first @ F @ second)

        def bracket(x: Any) -> Any:  # M' = [M, U], N' = [N, V], F' = F V - U F for the linear Hamiltonians of U and V
            M, N, F = parts(x)
            out = np.zeros((10, 10), dtype=object)
            for i, axis in enumerate(_square(10)[:4]):
                U, V, _ = parts(axis)
                out[:, i] = packed(M @ U - U @ M, N @ V - V @ N, F @ V - U @ F)
            out[:4, 4:] = -out[4:, :4].T
            return out

        return 10, moved, bracket

    places = [(0, 1), (0, 2), (1, 2), (0, 5), (1, 5), (2, 5), (3, 4), (3, 6), (4, 6)]  # even under J
    _, weights, S = komarov_matrix(normal(rng, 3), normal(rng, 3), mpmath.mpf("-0.4"), mpmath.mpf("0.6"), 1, 1)

    def full(x: Any) -> Any:
        m = np.zeros((7, 7), dtype=object)
        for value, (i, k) in zip(x, places, strict=True):
            m[i, k], m[k, i] = value, -value
        return m

    def single(x: Any, lam: Any, near: list[Any], strength: int) -> Any:
        q = level(_inverse(S) @ (lam * weights + full(x)), near)
        Jq = q * np.array([1, 1, 1, -1, -1, 1, -1])
        T = (np.outer(q, q) - np.outer(Jq, Jq)) @ S / (q @ S @ q)
        new = full(x) + 2 * strength * lam * (weights @ T - T.T @ weights)
        return np.array([new[place] for place in places], dtype=object)

    def manakov(x: Any) -> Any:
        m = full(x)
        return np.array(
            [
                [m[a, d] * S[b, c] - m[c, b] * S[d, a] - m[a, c] * S[b, d] + m[d, b] * S[c, a] for c, d in places]
                for a, b in places
            ],
            dtype=object,
        )

    return 9, single, manakov


def _square(n: int) -> Any:
    return np.array([[mpmath.mpf(i == j) for j in range(n)] for i in range(n)], object)


def _inverse(A: Any) -> Any:
    return np.array(mpmath.inverse(mpmath.matrix(A.tolist())).tolist(), dtype=object)


@pytest.mark.parametrize("case", ["unequal", "steklov", "top", "komarov"])
def test_a_single_map_is_poisson(case: str) -> None:
    """J Pi J^T = Pi for a single complex map, by differences in 40 digits; not for a stronger one."""
    with mpmath.workdps(40):
        size, image, tensor = _images(case, rng := np.random.default_rng(47))
        x, lam, h, near = normal(rng, size), mpmath.mpc("0.4", "1.3"), mpmath.mpf(10) ** -14, list[Any]()
        for strength in (1, 2):
            new = image(x, lam, near, strength)
            ends = ([image(x + s * e, lam, near, strength) for s in (1, -1)] for e in h * _square(size))
            slope = np.stack([(forward - back) / (2 * h) for forward, back in ends], -1)
            miss = abs(slope @ tensor(x) @ slope.T - tensor(new)).max()
            assert (miss < 1e-20) == (strength == 1)


@pytest.mark.parametrize("field", ["none", "rank one"])
def test_pairs_make_steps_for_n_6(field: str) -> None:
    """Fields of pairs on the axis span half of a leaf, and so many pairs are the flow; not at points 1 + 1e-6 times."""
    n, h, rng = 6, 0.02, np.random.default_rng(3)
    a = np.linspace(0.5, 2, n)
    A, c = np.diag(a), 1 / np.add.outer(np.sqrt(a), np.sqrt(a))  # Omega = c M for B = sqrt(A)
    M, P = algebra.skew(rng.normal(size=15), n), rng.normal(size=n) * (field != "none")
    F, nodes, weights = np.outer(P, P), *np.polynomial.legendre.leggauss(16)

    def level(M: Any, F: Any, lam: Any, near: Any) -> tuple[Any, Any, Any]:
        values, vectors = np.linalg.eig(lam * A + M + F / lam)
        k = abs(values - near).argmin()
        q, p = vectors[:, k], np.linalg.inv(vectors)[k]
        Pi = np.outer(q, p)
        Omega = -2 / lam * (Pi - Pi.T)
        change = (-2 * ((Pi + Pi.T) @ A - A @ (Pi + Pi.T)), F @ Omega - Omega @ F)
        return values[k], np.concatenate([v.ravel() for v in change]), q

    axis = [(y, mu) for y in np.geomspace(0.4, 6, 8) for mu in np.linalg.eigvals(1j * y * A + M + F / (1j * y))]
    fields = np.stack([level(M, F, 1j * y, mu)[1].real for y, mu in axis], -1)
    fields = fields / np.linalg.norm(fields, axis=0)
    count = 6 if field == "none" else 9
    assert np.linalg.matrix_rank(fields, 1e-9) == count
    chosen = scipy.linalg.qr(fields, mode="r", pivoting=True)[1][:count]

    def rate(t: float, z: Any) -> Any:
        M, F = z.reshape(2, n, n)
        B = np.diag(np.sqrt(a))
        return np.concatenate([v.ravel() for v in (M @ (c * M) - c * M @ M + F @ B - B @ F, F @ (c * M) - c * M @ F)])

    start = np.concatenate([M.ravel(), F.ravel()])
    x, ends = np.zeros(count), np.zeros(count, complex)
    for _ in range(8):  # Newton's method for (conditions)
        total, slopes = -h * rate(0.0, start), np.empty((len(start), count))
        for j, (y, near) in enumerate(axis[i] for i in chosen):
            for node, weight in zip(nodes, weights, strict=True):
                near, v, _ = level(M, F, 1j * y + x[j] * (node + 1) / 2, near)
                total = total + weight / 2 * x[j] * v.real
            ends[j], v, _ = level(M, F, 1j * y + x[j], near)
            slopes[:, j] = v.real
        x = x - np.linalg.lstsq(slopes, total, rcond=None)[0]
    truth = scipy.integrate.solve_ivp(rate, (0, h), start, method="DOP853", rtol=1e-13, atol=1e-14).y[:, -1]
    for stretch, holds in ((1.0, True), (1 + 1e-6, False)):
        state = M.astype(complex), F.astype(complex)
        for j, i in enumerate(chosen):
            for sign in (1, -1):
                lam, mu = (v if sign > 0 else v.conjugate() for v in (stretch * x[j] + 1j * axis[i][0], ends[j]))
                q = level(*state, lam, mu)[2]
                Q = np.outer(q, q) / (q @ q)
                R = np.eye(n) - 2 * Q
                state = state[0] - 2 * lam * (Q @ A - A @ Q), R @ state[1] @ R
        miss = abs(np.concatenate([v.ravel() for v in state]) - truth).max()
        assert (miss < 1e-9) == holds


def test_branch_points_are_beyond_the_bound() -> None:
    """Zeros of the discriminant of det(L - mu), n = 3, are beyond (bound); some are not twice as far."""
    rng, near = np.random.default_rng(59), list[float]()
    for _ in range(60):
        M, P, a, y = *rng.normal(size=(3, 3)), 10 ** rng.uniform(-1, 1)
        A, M, F = np.diag(a), algebra.hat(M), np.outer(P, P) + np.diag(rng.normal(size=3))
        # lam^6 times the discriminant is a polynomial of degree 12 in lam: from its values at 13 roots of 1
        circle = np.exp(2j * np.pi * np.arange(13) / 13)
        levels = (np.linalg.eigvals(lam * A + M + F / lam) for lam in circle)
        values = circle**6 * [np.prod(np.subtract.outer(mu, mu)[np.triu_indices(3, 1)] ** 2) for mu in levels]
        branches = np.roots((np.fft.fft(values) / 13)[::-1])
        half = [np.ptp(np.linalg.eigvalsh(X)) / 2 for X in (A, F)]
        gap = (
            np.diff(np.linalg.eigvalsh(y * A - 1j * M - F / y)).min() / 2
        )  # a r + f r/(y (y - r)) = gap: a quadratic equation
        roots = np.roots([-half[0] * y, half[0] * y * y + half[1] + gap * y, -gap * y * y])
        radius = min(r.real for r in roots if 0 < r.real < y)
        near.append(abs(branches - 1j * y).min() / radius)
    assert 1 <= min(near) < 2


def test_r_matrix() -> None:
    """Of both factors, by differences, for <M, P> = 0; not off that leaf, nor with the other sign of {p, b}."""
    permutation = np.zeros((4, 4))
    permutation[[0, 1, 2, 3], [0, 2, 1, 3]] = 1
    rng, h = np.random.default_rng(53), 1e-5
    M, P = rng.normal(size=(2, 3))
    P = P - M * (M @ P) / (M @ M)

    def top(x: Any, u: complex) -> Any:
        plus, minus = (x[0] + s * 1j * x[1] for s in (1, -1))
        corner = u * u - 2 * x[2] * u - plus * minus
        upper, lower = u * (x[3] - 1j * x[4]) - x[5] * minus, u * (x[3] + 1j * x[4]) - x[5] * plus
        return np.array([[corner, upper], [lower, -(x[5] ** 2)]])

    def toda(x: Any, u: complex) -> Any:
        return np.array([[u - x[0], -x[1]], [-1 / x[1], 0]])

    def misses(T: Any, x: Any, bracket: Any, u: complex = 0.7 + 0.2j, v: complex = -1.1 + 0.5j) -> bool:
        slopes = [np.array([(T(x + h * e, w) - T(x - h * e, w)) / (2 * h) for e in np.eye(len(x))]) for w in (u, v)]
        both = np.einsum("iab,ij,jcd->acbd", slopes[0], bracket, slopes[1]).reshape(4, 4)
        product = np.kron(T(x, u), T(x, v))
        want = -2j / (u - v) * (permutation @ product - product @ permutation)
        return bool(abs(both - want).max() > 1e-7 * abs(want).max())

    def bracket(M: Any, P: Any) -> Any:  # {M_1, M_2} = M_3
        return -np.block([[algebra.hat(M), algebra.hat(P)], [algebra.hat(P), np.zeros((3, 3))]])

    assert not misses(top, np.append(M, P).astype(complex), bracket(M, P))
    assert misses(top, np.append(M, P + M).astype(complex), bracket(M, P + M))
    for sign in (1, -1):
        site = np.array([0.3 + 0.1j, 0.8 - 0.4j])
        assert misses(toda, site, sign * 2j * site[1] * np.array([[0, 1], [-1, 0]])) == (sign < 0)


def test_goryachev_chaplygin_step() -> None:
    """The point of a step solves (gcflow), by 60 nodes in 1/u; the point of another does not."""
    model = kr.GoryachevChaplygin(gamma=0.3)
    M, P = (0.8, 0.5, -0.6), (0.6, 0.0, 0.8)
    z = tuple(model.state(M=M, P=P)[k] for k in model.system.space.letters)
    H = (M[0] ** 2 + M[1] ** 2) / 2 + 2 * M[2] ** 2 + 0.3 * M[2] + P[0]
    G = (M[2] + 0.15) * (M[0] ** 2 + M[1] ** 2) - M[0] * P[2]
    nodes, weights = np.polynomial.legendre.leggauss(60)
    for step, holds in ((0.1, True), (0.2, False)):
        stages = scheme(model, "exact", step, None, False).on(z).stages
        X = complex(stages["z_re"][0], stages["z_im"][0])
        x = X * (nodes + 1) / 2
        t = 1 + 0.3 * x - 2 * H * x**2 - 2 * G * x**3  # y u^-3 is the root of t^2 - 4 |P|^2 x^4
        root = np.sqrt(t - 2 * x * x) * np.sqrt(t + 2 * x * x)
        first, second = (-(X / 2 * (weights * f).sum()).imag for f in (2 / root, 2 * x / root))
        assert (abs(first - 0.1) < 1e-14) == holds
        assert abs(second) < 1e-14


MEASURED = {  # first words of a row: those of a system in the results of the benchmark
    "Clebsch": "clebsch-general",
    "Manakov": "manakov-top",
    "Brun": "quadratic-potential",
    "Kovalevskaya &": "kovalevskaya-top-e3",
    "Kovalevskaya, two": "kovalevskaya-gyrostat",
    "Komarov": "komarov(kappa=-0.4",
    "Rubanovskii": "rubanovskii",
    "Steklov": "steklov-lyapunov",
    "Goryachev": "goryachev-chaplygin",
}


def test_the_table_of_exact_steps_is_that_of_the_benchmark() -> None:
    text = (ROOT / "paper" / "maps.tex").read_text(encoding="utf-8")
    results = json.loads((ROOT / "benchmarks" / "results" / "exact_pairs.json").read_text(encoding="utf-8"))["rows"]
    table = text[text.index("\\label{tab:exact}") :]
    lines = [line for line in table[: table.index("\\bottomrule")].splitlines() if line.count("&") == 5][1:]
    assert len(lines) == len(MEASURED)
    for line in lines:
        name = next(v for k, v in MEASURED.items() if line.startswith(k))
        row = next(row for row in results if row["system"].startswith(name))
        _, pairs, *values = line.rstrip("\\").split("&")
        printed = [float(v.strip(" $").replace("\\cdot10^{", "e").rstrip("}")) for v in values]
        assert "one map" in pairs or int(pairs) == row["pairs"]
        assert printed == pytest.approx([row[key] for key in ("error", "ulps", "a step", "ns")], rel=0.03, abs=0)
