"""Steps of a propagator to any times, and to where a quantity changes its sign."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from kreisel.errors import InputError, shown
from kreisel.kernels.layout import Floats
from kreisel.runs.settings import WHOLE, finite_number

if TYPE_CHECKING:
    from kreisel.runs.propagator import Propagator

BLOCK = 256  # steps between two looks at a quantity
AT_ZERO = 1e-10  # of the largest value in the first block: a start that is where the last search ended
EXACT = 4 * float(np.finfo(float).eps)  # relative, of the time within a step; the least that SciPy takes


class Crossing(NamedTuple):
    """Where a search ended: the state, the time, and whether the quantity changed its sign there."""

    state: Any
    time: float
    crossed: bool


class Walk:
    """States of a propagator as they are stepped, rows z (lanes, d), at the time t."""

    def __init__(self, p: Propagator, x: Floats, time: float):
        self._p, self._x, self.time = p, x, time
        self.z = p.prepared(x)

    def to(self, time: float) -> None:
        """Go to a later time, in equal steps of at most dt."""
        gap = time - self.time
        if gap > 0:
            count = max(1, math.ceil(gap / self._p.dt * (1 - WHOLE)))
            self.z, self.time = self.rows(gap / count, count, count)[-1], time

    def rows(self, h: float, count: int, every: int) -> Floats:
        """The states 0, every, ... of so many steps of length h from here; the walk itself stays."""
        return self._p.stepped(self._x, self.z, self.time, h, count, every)

    def after(self, z: Floats, time: float, h: float) -> Floats:
        """The state a single step of length h after z."""
        return self._p.stepped(self._x, z, time, h, 1, 1)[-1] if h > 0 else z


def first_crossing(
    p: Propagator, x: Floats, quantity: Callable[[Floats], float], rising: bool | None, time: float, end: float
) -> tuple[Floats, float, bool]:
    """The state where `quantity` of a state first changes its sign after `time`, or that at `end`."""
    walk = Walk(p, x, time)
    side = None
    while walk.time < end:
        left = (end - walk.time) / p.dt * (1 - WHOLE)
        count = min(BLOCK, math.floor(left)) or 1
        h = p.dt if left >= 1 else end - walk.time
        rows = walk.rows(h, count, 1)
        values = np.array([quantity(p.returned(z, walk.time + k * h)[0]) for k, z in enumerate(rows)])
        if side is None:
            side = np.sign(values[0]) if abs(values[0]) > AT_ZERO * abs(values).max() else 0.0
        for k in range(count):
            new = np.sign(values[k + 1])
            if side * new < 0 and rising in (None, new > 0):
                z, begun = rows[k], walk.time + k * h
                if side * np.sign(values[k]) <= 0:  # the row is at the value itself
                    return p.returned(z, begun)[0], begun, True
                at = _root(lambda s, z=z, begun=begun: quantity(p.returned(walk.after(z, begun, s), begun + s)[0]), h)  # type: ignore[misc]
                return p.returned(walk.after(z, begun, at), begun + at)[0], begun + at, True
            side = new or side
        walk.z, walk.time = rows[-1], end if left < 1 else walk.time + count * h
    return p.returned(walk.z, walk.time)[0], walk.time, False


def _root(f: Callable[[float], float], h: float) -> float:
    """Where f changes its sign between 0 and h, to rounding, by Brent's method."""
    from scipy.optimize import brentq

    return float(brentq(f, 0.0, h, xtol=EXACT * h, rtol=EXACT))


def number_of(quantity: Any, state: Any) -> float:
    """The value of a user's function.  Raises `InputError` where it is no finite number."""
    value = np.asarray(quantity(state))
    if value.size != 1 or value.dtype.kind not in "iuf":
        raise InputError(f"until: expected a quantity that is one number, got {shown(value)}.")
    return finite_number(value.item(), "until: the quantity")
