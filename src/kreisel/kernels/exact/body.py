"""A free body between its steps, on recorded numbers: its integrals held, its principal axes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.algebra.iteration import times
from kreisel.exact import rotor_step
from kreisel.graph.double import DoubleDouble, upper
from kreisel.graph.graph import where_less

SWEEPS = 6  # of Jacobi: the last does not change a double


def held(
    M: Array, inverse: Array, first: Any, kept: Sequence[Any], *, near: float, tiny: float
) -> tuple[Array, list[Any]]:
    """M with |M|^2 and M . I^-1 M moved to their kept values, and these: two numbers each, a sum.

    If `first` is negative, they are taken from M.  The corrections are in double-doubles.
    """
    squares = [DoubleDouble(x) * x for x in M]
    now = [squares[0] + squares[1] + squares[2], sum((x * v for x, v in zip(squares, inverse, strict=True)), 0.0)]
    before = [
        DoubleDouble.where_less(first, 0.0, value, DoubleDouble(*pair))
        for value, pair in zip(now, (kept[:2], kept[2:]), strict=True)
    ]
    square, energy = (upper(old - new) for old, new in zip(before, now, strict=True))
    share = 1 / (upper(before[0]) + tiny)
    power = algebra.dot(M, inverse * M)
    M = rotor_step.corrected(M, share, power, square, energy - power * share * square, inverse, near=near, tiny=tiny)
    return M, [x for pair in before for x in (pair.upper, pair.lower)]


def principal_axes(T: Sequence[Any], tiny: float = rotor_step.TINY) -> dict[str, Array]:
    """Moments I (3,) and axes, a unit quaternion (4,), of a tensor (xx, yy, zz, yz, zx, xy); nearest to its own axes.

    Jacobi's rotations in a fixed number, on scalars of any kind.  The rotation about axis r by phi, tan phi = t, is the
    quaternion (1 + cos phi, -sin phi e_r) of any length; `tiny` keeps 0/0 away.
    """

    def swept(x: list[Any]) -> list[Any]:
        d, o, q = x[:3], x[3:6], algebra.objects(x[6:])
        for r, p, s in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
            gap = d[s] - d[p]
            size = abs(gap) + (gap * gap + 4 * o[r] * o[r] + tiny).sqrt()
            t = where_less(gap, 0.0, -2.0, 2.0) * o[r] / size
            cos = 1 / (1 + t * t).sqrt()
            sin = t * cos
            d[p], d[s] = d[p] - t * o[r], d[s] + t * o[r]
            o[r], o[s], o[p] = 0.0 * o[r], cos * o[s] - sin * o[p], sin * o[s] + cos * o[p]
            turn = [1 + cos, *(-sin if k == r else 0.0 for k in range(3))]
            q = algebra.quaternion_product(q, algebra.objects(turn)) * 0.5
        return [*d, *o, *q]

    x = times(swept, [*T, 1.0, 0.0, 0.0, 0.0], SWEEPS)
    return {"I": algebra.objects(x[:3]), "axes": algebra.unit(algebra.objects(x[6:]))}
