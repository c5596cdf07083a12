"""Lagrange tops on which closed forms are tried: random ones, and those where the formulas degenerate."""

from __future__ import annotations

import numpy as np

import kreisel as kr
from kreisel import algebra
from taylor import taylor

DOUBLE = 4e-15  # relative: some twenty roundings
UP = (0, 0, 1)
SPECIAL = {  # m, b, p; where the formulas degenerate
    "generic": ((0.1, 0.2, 1.5), (0.6, 0, 0.8), UP),
    "fast, hanging": ((0.3, -0.2, 4), (0.6, 0, -0.8), UP),
    "very fast": ((3, 5, 80), (0.6, 0, 0.8), UP),
    "slow": ((1e-3, 2e-3, 5e-4), (0.6, 0, 0.8), (0, 0, 1e-5)),
    "no gravity": ((0.3, 0.7, -1.1), (0.2, 0.5, -0.4), (0, 0, 0)),
    "pendulum released": ((0, 0, 0), (1, 0, 0), UP),
    "pendulum released near the top": ((0, 0, 0), (1e-3, 0, 1), UP),
    "pendulum going round": ((0, 3, 0), (0.6, 0, 0.8), UP),
    "pendulum on the separatrix": ((2, 0, 0), (0, 0, -1), UP),
    "pendulum off the separatrix by an ulp": ((2 + 4e-16, 0, 0), (0, 0, -1), UP),
    "pendulum near the separatrix": ((2 + 1e-6, 0, 0), (0, 0, -1), UP),
    "spherical pendulum": ((0.5, 0.25, -0.5), (1, 0, 1), UP),
    "c = 0": ((0.5, 0.25, 0), (0.6, 0, 0.8), UP),
    "sleeping, unstable": ((0, 0, 1), UP, UP),
    "sleeping, critical": ((0, 0, 2), UP, UP),
    "sleeping, stable": ((0, 0, 3), UP, UP),
    "sleeping, unstable, disturbed": ((1e-6, 0, 1), UP, UP),
    "sleeping, critical, disturbed": ((1e-3, 0, 2), UP, UP),
    "sleeping, stable, disturbed": ((1e-3, 0, 3), UP, UP),
    "falling asleep": ((1, 3, 3), (3, 0, 4), (0, 0, 5)),
    "hanging asleep": ((0, 0, 1.5), (0, 0, -1), UP),
    "through the top": ((0.5, 0.3, 1.5), UP, UP),
    "through the bottom": ((0.5, 0.3, 1.5), (0, 0, -1), UP),
    "steady precession": ((1, 0, 2), (0.5, 0, 0.75), UP),
    "at rest, up": ((0, 0, 0), UP, UP),
    "at rest, down": ((0, 0, 0), (0, 0, -1), UP),
}


def random_tops(count: int) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    draw = np.random.default_rng(11)
    return [tuple(draw.normal(size=(3, 3)) * [[2], [1], [1]]) for _ in range(count)]


def off(got: np.ndarray, want: np.ndarray) -> float:
    """The largest difference, relative to the larger of 1 and the largest entry."""
    return max(float(abs(w - float(g))) for g, w in zip(got.flat, want.flat, strict=True)) / max(1.0, abs(got).max())


def off_turn(got: np.ndarray, want: np.ndarray) -> float:
    return min(off(got, want), off(got, -want))


def error(m: object, b: object, p: object, time: float, alpha: float = 0.7, digits: int = 20) -> float:
    """Of kr.at in both frames, orientation included, against the Taylor series."""
    m1, b1, q = taylor(m, b, p, time, alpha=alpha, digits=digits)
    back = algebra.rotation_matrix(q).T
    rest, body = kr.LagrangeTop(p=p, alpha=alpha), kr.LagrangeTopMoving(A=b, alpha=alpha)
    run = kr.at(rest, {"m": m, "a": b}, time, orientation=(1, 0, 0, 0))
    seen = kr.at(body, {"M": m, "P": p}, time, orientation=(1, 0, 0, 0))
    p_in_digits = np.array([type(m1[0])(float(v)) for v in p], dtype=object)
    return max(
        off(run.m.values, m1),
        off(run.a.values, b1),
        off_turn(run.g.values, q),
        off(seen.M.values, back @ m1),
        off(seen.P.values, back @ p_in_digits),
        off_turn(seen.g.values, q),
    )
