"""Steps of a propagator to any times, and to where a quantity changes its sign."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from kreisel.errors import InputError, shown
from kreisel.kernels.layout import Floats
from kreisel.runs.settings import MOST_STEPS, SHORTEST_STEP, WHOLE, finite_number

if TYPE_CHECKING:
    from kreisel.runs.propagation.propagator import Propagator

FEWEST, MOST_ROWS = 8, 256  # steps that are made before the quantity is looked at: more and more of them
AT_ZERO = 1e-10  # of the largest value in the first block: a start that is where the last search ended
EXACT = 4 * float(np.finfo(float).eps)  # relative, of the time within a step; the least that SciPy takes


class Crossing(NamedTuple):
    """Where a search ended: the state, the time, and whether the quantity changed its sign there."""

    state: Any
    time: float
    crossed: bool


class Walk:
    """States of a propagator as they are stepped, rows z (lanes, d), at the time t."""

    def __init__(self, propagator: Propagator, x: Floats, time: float):
        self._propagator, self._start, self.time = propagator, x, time
        self.z = propagator.prepared(x)

    def to(self, time: float) -> None:
        """Go to a later time, in equal steps of at most dt."""
        gap = time - self.time
        require_reach(self._propagator.dt, self.time, time)
        if gap > SHORTEST_STEP:
            count = max(1, math.ceil(gap / self._propagator.dt * (1 - WHOLE)))
            self.z, self.time = self.rows(gap / count, count, count)[-1], time

    def rows(self, h: float, count: int, every: int) -> Floats:
        """The states 0, every, ... of so many steps of length h from here; the walk itself stays."""
        return self._propagator.stepped(self._start, self.z, self.time, h, count, every)

    def one_step(self, z: Floats, time: float, h: float) -> Floats:
        """The state after a single step of length h from z at that time; the walk itself stays."""
        return self._propagator.stepped(self._start, z, time, h, 1, 1)[-1] if h > SHORTEST_STEP else z


def first_crossing(
    p: Propagator, x: Floats, quantity: Callable[[Floats], float], rising: bool | None, time: float, end: float
) -> tuple[Floats, float, bool]:
    """The state where `quantity` of a state first changes its sign after `time`, or that at `end`."""
    require_reach(p.dt, time, end)
    walk, block = Walk(p, x, time), FEWEST
    value = _value(p, quantity, walk.z, time)
    side = np.sign(value) if abs(value) > AT_ZERO * _size(p, quantity, walk) else 0.0
    while walk.time < end:
        left = (end - walk.time) / p.dt * (1 - WHOLE)
        count, h = (min(block, math.floor(left)), p.dt) if left >= 1 else (1, end - walk.time)
        rows, block = walk.rows(h, count, 1), min(2 * block, MOST_ROWS)
        for k, row in enumerate(rows[1:]):
            begun, value = walk.time + k * h, _value(p, quantity, row, walk.time + (k + 1) * h)
            new = np.sign(value)
            if side * new < 0 and rising in (None, new > 0):
                at = _root(p, quantity, walk, rows[k], begun, h, side)
                return p.returned(walk.one_step(rows[k], begun, at), begun + at), begun + at, True
            side = new or side
        walk.z, walk.time = rows[-1], end if left < 1 else walk.time + count * h
    return p.returned(walk.z, walk.time), walk.time, False


def require_reach(dt: float, time: float, end: float) -> None:
    """Raises `InputError` for an end that steps of dt do not reach."""
    if not (end - time) / dt <= MOST_STEPS or (end > time and not end - dt < end):
        raise InputError(
            f"times: expected at most {MOST_STEPS:,} steps of dt = {dt:g}, which are not lost in the time, got "
            f"{end:g} from {time:g} on."
        )


def _value(p: Propagator, quantity: Callable[[Floats], float], z: Floats, time: float) -> float:
    return quantity(p.returned(z, time))


def _size(p: Propagator, quantity: Callable[[Floats], float], walk: Walk) -> float:
    """The size of a quantity within a step: a search may begin where the last one ended, at a value of rounding."""
    states = (walk.z, walk.time), (walk.one_step(walk.z, walk.time, p.dt), walk.time + p.dt)
    return max(abs(_value(p, quantity, z, t)) for z, t in states)


def _root(
    p: Propagator, quantity: Callable[[Floats], float], walk: Walk, z: Floats, begun: float, h: float, side: float
) -> float:
    """How long after z the quantity changes its sign, within a step of length h."""
    return root_within(lambda s: _value(p, quantity, walk.one_step(z, begun, s), begun + s), side, h)


def root_within(value: Callable[[float], float], side: float, h: float) -> float:
    """Where a function leaves the sign `side` between 0 and h: to rounding, by Brent's method."""
    from scipy.optimize import brentq

    if value(0.0) * side <= 0:
        return 0.0
    return h if value(h) * side >= 0 else float(brentq(value, 0.0, h, xtol=EXACT * h, rtol=EXACT))


def number_of(quantity: Any, state: Any) -> float:
    """The value of a user's function.  Raises `InputError` where it is no finite number."""
    try:
        value = np.asarray(quantity(state))
    except (TypeError, ValueError, LookupError, AttributeError) as error:
        raise InputError(
            f"until: expected a function of the state, such as lambda x: x['a'][2], got one that raises "
            f"{type(error).__name__}: {error}."
        ) from error
    if value.size != 1 or value.dtype.kind not in "iuf":
        raise InputError(f"until: expected a quantity that is one number, got {shown(value)}.")
    return finite_number(value.item(), "until: the quantity")
