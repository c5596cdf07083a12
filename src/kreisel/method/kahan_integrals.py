"""Integrals of Kahan's map of order 2, in closed form: deformed Casimirs, energy and more, exact over Q."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.algebra.invariants import stack
from kreisel.algebra.skew import cross
from kreisel.method.kahan_step import advance
from kreisel.record.contract import Frame, call
from kreisel.record.model import Model


def one_lane(value: Array, axes: int, rng: np.random.Generator) -> Any:
    """A constant of one lane, or a random mean over lanes: what holds for it holds for each."""
    flat = np.asarray(value)
    exact = np.vectorize(Fraction, otypes=[object])(flat) if flat.dtype != object else flat
    if flat.ndim == axes:
        return exact if axes else exact[()]
    lanes = exact.reshape((-1, *flat.shape[flat.ndim - axes :]))
    weights = [Fraction(int(w), 1000) for w in rng.integers(1, 1000, len(lanes))]
    return sum(w * lane for w, lane in zip(weights, lanes, strict=True)) / sum(weights)


# -- Euler's top -----------------------------------------------------------------------------------------


def is_euler_top(model: Model) -> bool:
    """Whether the flow is x_i' = alpha_i x_j x_k, with an energy: exactly, in one lane."""
    if model.n != 3 or model.system.space.kinds != ("skew",) or model.system.energy is None:
        return False
    rng = np.random.default_rng(2)
    known = {name: one_lane(value, model.axes[name], rng) for name, value in model.constants.items()}
    x = np.array([Fraction(int(v), 7) for v in rng.integers(1, 99, 3)], dtype=object)
    rate = algebra.axial(call(model.system.flow, (algebra.hat(x),), known)[0])
    energy = [call(model.system.energy, (algebra.hat(sign * x),), known) for sign in (1, -1, 0)]
    return bool(
        all(v == w for v, w in zip(rate, _alphas(model, known) * _others(x), strict=True))
        and energy[0] == energy[1]
        and energy[2] == 0
    )


def _others(x: Array) -> Array:
    return x[..., algebra.SECOND] * x[..., algebra.THIRD]


def _alphas(model: Model, known: Mapping[str, Array]) -> Array:
    """The alpha_i: the rate of x_i at x = (1, 1, 1)."""
    ones = algebra.hat(np.ones(3, dtype=np.int8))
    return algebra.axial(call(model.system.flow, (ones,), known)[0])


def euler_integrals(model: Model, seen: Mapping[str, Array], dt: Any, known: Mapping[str, Array]) -> dict[str, Array]:
    """|M|^2/D and H/D, D = 1 - dt^2/12 sum alpha_j alpha_k x_i^2."""
    x = algebra.axial(seen[model.system.space.letters[0]])
    own = {name: value for name, value in known.items() if name in model.axes}
    D = 1 - dt * dt / 12 * (_others(_alphas(model, own)) * x * x).sum(-1)
    return {"casimir_eps": seen["casimir"] / algebra.vec(D), "energy_eps": seen["energy"] / D}


# -- Lagrange's top of equal moments ---------------------------------------------------------------------


def is_lagrange_top(model: Model) -> bool:
    """Whether the flow is m' = a ^ p, a' = m a with m = M at rest and -M in the moving frame: exactly, in one lane."""
    if model.n != 3 or model.system.space.kinds != ("skew", "vector") or model.system.energy is None:
        return False
    rng = np.random.default_rng(2)
    known = {name: one_lane(value, model.axes[name], rng) for name, value in model.constants.items()}
    name = _field(model)
    if name is None:
        return False
    a, x = (np.array([Fraction(int(v), 7) for v in rng.integers(1, 99, 3)], dtype=object) for _ in range(2))
    M, sign = algebra.hat(x), _sign(model)
    rates = call(model.system.flow, (M, a), known)
    return bool(
        (rates[0] == sign * algebra.wedge(a, known[name])).all() and (rates[1] == sign * algebra.act(M, a)).all()
    )


def _field(model: Model) -> str | None:
    return next((name for name in ("p", "A") if name in model.constants), None)


def _sign(model: Model) -> int:
    return 1 if model.system.frame is Frame.REST else -1


def lagrange_integrals(
    model: Model, seen: Mapping[str, Array], dt: Any, known: Mapping[str, Array]
) -> dict[str, Array]:
    """C = (|a|^2 + k l^2)/(1 + k (|m|^2 + 2 k <m, p> l + k^2 |p|^2 l^2)), l^2, and the energy; k = dt^2/4.

    l = <m, a>/(1 - k <p, a>), and |m|^2/2 + (<p, a> + k <p, a>^2/2)/(1 - k^2 |p|^2 C) is the energy.
    """
    m, a = (seen[letter] for letter in model.system.space.letters)
    m, p, k = _sign(model) * algebra.axial(m), known[_field(model) or ""], dt * dt / 4
    u, p2 = algebra.dot(p, a), algebra.dot(p, p)
    length = algebra.dot(m, a) / (1 - k * u)
    whole = algebra.dot(m, m) + 2 * k * algebra.dot(m, p + 0 * m) * length + k * k * p2 * length * length
    C = (algebra.dot(a, a) + k * length * length) / (1 + k * whole)
    energy = algebra.dot(m, m) / 2 + (u + k * u * u / 2) / (1 - k * k * p2 * C)
    return {"casimir_eps": np.stack([C, length * length], -1), "energy_eps": energy}


# -- Clebsch's case --------------------------------------------------------------------------------------


def is_clebsch(model: Model) -> bool:
    """Whether the flow is M' = P ^ BP, P' = -M P with B = diag(b), n = 3: exactly, in one lane."""
    if model.n != 3 or model.system.space.kinds != ("skew", "vector") or "b" not in model.constants:
        return False
    rng = np.random.default_rng(2)
    known = {name: one_lane(value, model.axes[name], rng) for name, value in model.constants.items()}
    x, P = (np.array([Fraction(int(v), 7) for v in rng.integers(1, 99, 3)], dtype=object) for _ in range(2))
    M = algebra.hat(x)
    rates = call(model.system.flow, (M, P), known)
    return bool((rates[0] == algebra.wedge(P, known["b"] * P)).all() and (rates[1] == -algebra.act(M, P)).all())


def clebsch_integrals(model: Model, seen: Mapping[str, Array], dt: Any, known: Mapping[str, Array]) -> dict[str, Array]:
    """(J, (J l)^2), the energy, and <M, BM> + <P, adj(B) P> deformed.  Axial M = m, P = p, and k = dt^2/4.

    With the next state (m', p'): J = |p|^2/(1 + k <p, Bp>), J' = <p, p'>/(1 - k <p, Bp'>) and
    l = <m, (1 + k J' B) p>/|p|^2.  J/J' = 1 + 4 k (H - J l^2/2) defines the energy H; it is divided by 4 k by hand.
    With C = 1 - k J B, r = B/C, s = k (J + J'), v = J l/(J + J'), n = m - v p and w_i = r_j + r_k - r_i + s r_j r_k the
    fourth is half of

        sum C_i (r_i (2 + s r_i) (n_i^2 + v^2 p_i^2) - 2 v w_i n_i p_i + det(C) J/(J + J') w_i^2 p_i^2)

    and J (tr adj(B) + (l^2 - tr B) tr(B)/4), so that at dt = 0 they are those of the flow.  Found from Hirota-Kimura
    bases: with D = 1 + k J' B the orbits lie on <p, Cp> = J, <m, Dp> = l |p|^2 and two more quadrics.
    """
    M, p = (seen[letter] for letter in model.system.space.letters)
    new = advance(model, (M, p), dt, {name: value for name, value in known.items() if name in model.axes})[0]
    b, k, m = known["b"], dt * dt / 4, algebra.axial(M)
    q, D = new[1], 1 + k * algebra.dot(p, b * p)
    J = algebra.dot(p, p) / D
    across, ahead = algebra.dot(p, b * q), algebra.dot(p, q)
    J1 = ahead / (1 - k * across)
    pitch = algebra.dot(m, p + k * algebra.vec(J1) * b * p) / algebra.dot(p, p)
    rate = (cross(q, m) + cross(p, algebra.axial(new[0]))) / 2
    work = algebra.dot(rate, cross(p, m)) / 2
    change = (work - (algebra.dot(p, p) * across + algebra.dot(p, b * p) * ahead) / 4) / (ahead * D)
    return {
        "casimir_eps": stack([J, J * J * pitch * pitch]),
        "energy_eps": change + J * pitch * pitch / 2,
        "clebsch_eps": _fourth(m, p, b, k, J, J1, pitch),
    }


def _fourth(m: Array, p: Array, b: Array, k: Any, J: Array, J1: Array, pitch: Array) -> Array:
    C = 1 - k * algebra.vec(J) * b
    r, share, whole = b / C, J / (J + J1), C[..., 0] * C[..., 1] * C[..., 2]
    v = algebra.vec(share * pitch)
    n, s = m - v * p, k * algebra.vec(J + J1)
    second, third = r[..., algebra.SECOND], r[..., algebra.THIRD]
    w = second + third - r + s * second * third
    terms = r * (2 + s * r) * (n * n + v * v * p * p) - 2 * v * w * n * p + algebra.vec(whole * share) * w * w * p * p
    trace, pairs = b.sum(-1), (b * b[..., algebra.SECOND]).sum(-1)
    return algebra.dot(C, terms) / 2 + J * (pairs + (pitch * pitch - trace) * trace / 4)


# -- which of them ---------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Deformed:
    """Integrals of the map of order 2: what they are, and their values from what a run shows."""

    applies: Callable[[Model], bool]
    values: Callable[[Model, Mapping[str, Array], Any, Mapping[str, Array]], dict[str, Array]]
    meanings: Mapping[str, str]


BOTH = {"casimir_eps": "Casimirs", "energy_eps": "energy"}
KNOWN = (
    Deformed(is_euler_top, euler_integrals, BOTH),
    Deformed(is_lagrange_top, lagrange_integrals, BOTH),
    Deformed(is_clebsch, clebsch_integrals, BOTH | {"clebsch_eps": "<M, BM> + <P, adj(B) P>"}),
)


def deformed_integrals(model: Model) -> Deformed | None:
    """Those of the map of order 2, where they are known in closed form."""
    return next((known for known in KNOWN if known.applies(model)), None)
