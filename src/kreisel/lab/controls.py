"""Maps that are not integrable, for the instruments to tell: each is a good map with one thing wrong."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np

from kreisel.algebra import Array, act, cayley_act, wedge
from kreisel.method.variational import stage
from kreisel.record.contract import Map
from kreisel.record.model import Model
from kreisel.system import heavy_top


def naive_heavy_top(M: Array, P: Array, *, eps: Any) -> tuple[Array, Array]:
    """The equations of a heavy top of equal moments by Euler's method: M' = A ^ P, P' = -M P."""
    A = 0 * P + _axis(P)
    return M + eps * wedge(A, P), P - eps * act(M, P)


def perturbed_lagrange_top(m: Array, a: Array, *, eps: Any) -> tuple[Array, Array]:
    """Suris's map with gravity that grows with height, V = a_3 + a_3^2/2 + a_1^2/2: Poisson, and no symmetry."""
    force = 0 * a + _axis(a)
    force = force + a * _axis(a) + a * _axis(a)[::-1]
    m = m + eps * wedge(a, force)
    return m, cayley_act(eps / 2 * m, a)


def _axis(x: Array) -> Array:
    out = np.zeros(x.shape[-1], dtype=np.int8)
    out[-1] = 1
    return out


def variational_step(M: Array, P: Array, *, A: Array, R: Array, c: Array, W: Array, eps: Any) -> tuple[Array, Array]:
    """The symmetric variational step of `kreisel.method.variational`: Poisson, of order 2."""
    state, _, _ = stage(heavy_top.SYSTEM, (M, P), eps, {"A": A, "R": R, "c": c, "W": W})
    return state


def variational_heavy_top() -> Model:
    """A heavy top with three unequal moments, its centre of mass off the axes, and that step."""
    rule = Map(step=variational_step, rational=False, order=2)
    system = replace(heavy_top.SYSTEM, name="variational-heavy-top", map=rule)
    return system(J=[0.4, 1.0, 1.7], A=[0.6, 0.3, 0.9])


THIRD = Fraction(1, 3)


def controls() -> list[tuple[str, Any, dict[str, Any]]]:
    """Title, map and options of each."""
    return [
        ("heavy top of equal moments, Euler's method", naive_heavy_top, {"n": 3, "eps": THIRD}),
        ("Lagrange top, perturbed", perturbed_lagrange_top, {"n": 3, "frame": "rest", "eps": THIRD}),
        ("heavy top, variational", variational_heavy_top(), {"eps": THIRD}),
    ]
