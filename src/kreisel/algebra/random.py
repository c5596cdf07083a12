"""Random values by MRG32k3a, for any kind of number: integers in doubles, so every kernel draws the same ones.

The state (..., 6) of a generator is part of the state of a run.  Two recurrences of order 3,

    x_n = (1403580 x_(n-2) - 810728 x_(n-3)) mod m_1,   y_n = (527612 y_(n-1) - 1370589 y_(n-3)) mod m_2
    u_n = ((x_n - y_n) mod m_1)/(m_1 + 1), in (0, 1)

[P. L'Ecuyer, Operations Research 47 (1999) 159; streams: L'Ecuyer, Simard, Chen, Kelton, ibid. 50 (2002) 1073]
"""

from __future__ import annotations

from math import pi
from typing import Any

import numpy as np

from kreisel.algebra.backend import Array, joined, log, nearest, sqrt, vec, where_less
from kreisel.algebra.gradient import cos, sin

M1, M2 = 4294967087.0, 4294944443.0
NORM = 1 / (M1 + 1)
GENERATOR = "generator"  # the letter of a state that has one
STREAM = 127  # binary logarithm of the values in a stream
FIRST = [[0, 1, 0], [0, 0, 1], [-810728, 1403580, 0]]  # (x_(n-3), x_(n-2), x_(n-1)) -> one later
SECOND = [[0, 1, 0], [0, 0, 1], [-1370589, 0, 527612]]


def remainder(x: Any, m: float) -> Any:
    """x mod m, in [0, m), of integers |x| < 2^53."""
    remainder = x - nearest(x / m) * m
    return where_less(remainder, 0.0, remainder + m, remainder)


def uniform(state: Array) -> tuple[Any, Array]:
    """The next number of a generator, and its state."""
    x3, x2, x1, y3, y2, y1 = (state[..., i] for i in range(6))
    x = remainder(1403580.0 * x2 - 810728.0 * x3, M1)
    y = remainder(527612.0 * y1 - 1370589.0 * y3, M2)
    u = where_less(y, x, x - y, x - y + M1) * NORM
    return u, joined(*map(vec_of, (x2, x1, x, y2, y1, y)))


def normals(state: Array, count: int) -> tuple[Array, Array]:
    """Independent normal values of variance 1, (..., count), and the state.

    [G. E. P. Box, M. E. Muller, Ann. Math. Statist. 29 (1958) 610]
    """
    out: list[Any] = []
    while len(out) < count:
        u, state = uniform(state)
        v, state = uniform(state)
        size, angle = sqrt(-2 * log(u)), 2 * pi * v
        out += [size * cos(angle), size * sin(angle)]
    return joined(*map(vec_of, out[:count])), state


def vec_of(x: Any) -> Array:
    """A scalar (...) as an array (..., 1)."""
    return vec(x) if hasattr(x, "ndim") else np.array([x])


def streams(seed: int, count: int) -> Array:
    """The states (count, 6) of generators whose next 2^127 values do not overlap."""
    drawn = np.random.SeedSequence(seed).generate_state(6).tolist()
    return streams_from([int(v) % (int(m) - 1) + 1 for v, m in zip(drawn, (M1,) * 3 + (M2,) * 3, strict=True)], count)


def streams_from(state: list[int], count: int, first: int = 0) -> Array:
    """The states (count, 6) of the streams from this one on, without those before `first`."""
    matrices = [(np.array(step, dtype=object), int(m)) for step, m in ((FIRST, M1), (SECOND, M2))]
    jumps = [_power(step, 1 << STREAM, m) for step, m in matrices]
    out, parts = np.empty((count, 6)), [np.array(state[:3], dtype=object), np.array(state[3:], dtype=object)]
    ahead = [_power(jump, first, m) for jump, (_, m) in zip(jumps, matrices, strict=True)]
    parts = [jump @ half % m for jump, half, (_, m) in zip(ahead, parts, matrices, strict=True)]
    for row in out:
        row[:] = np.concatenate(parts)
        parts = [jump @ half % int(m) for jump, half, m in zip(jumps, parts, (M1, M2), strict=True)]
    return out


def _power(step: Array, exponent: int, m: int) -> Array:
    """step^exponent mod m."""
    out = np.array(np.eye(3, dtype=int), dtype=object)
    while exponent:
        out = step @ out % m if exponent % 2 else out
        step, exponent = step @ step % m, exponent // 2
    return out
