"""Faults of rows from an engine: values that are not finite, a guard, lost invariants."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.kernels.engines import Engine
from kreisel.kernels.layout import Floats
from kreisel.method.scheme import Scheme

FEW = 64  # entries


class Fault(NamedTuple):
    """Rows that violate a promise of a method, and the reason.

    good   (rows, lanes): which rows are good; the last row is the state of the engine
    text   the fault in words
    cause  the usual cause and the fix; "" for values that are not finite
    seen   whether the rows show it: it is then at the first bad row or before, else before
    """

    good: Array
    text: str
    cause: str
    seen: bool = True


def faults(scheme: Scheme, engine: Engine, rows: Floats, dt: float) -> Iterator[Fault]:
    """The faults of rows (rows, lanes, d) and of the state of the engine, in this order: see `Fault`."""
    good = None if is_finite(rows) and is_finite(engine.z) else _good(rows, engine.z, np.isfinite)
    if good is not None:
        yield Fault(good, "The state is no longer finite", "")
    guard, projection = scheme.guard, engine.projection
    if guard is not None and guard.component:
        good = _good(rows, engine.z, lambda z: scheme.guarded(algebra.restore(z, scheme.kinds, scheme.n)))
        if good is not None:
            yield Fault(good, guard.fault, guard.cause)
    if projection is not None and projection.worst.any():
        with np.errstate(all="ignore"):
            beyond = projection.beyond(dt * abs(engine.z).max(-1))
        if beyond.any():
            name = projection.labels[int(np.where(beyond, projection.worst, 0).max(0).argmax())]
            yield Fault(
                np.broadcast_to(~beyond.any(-1), (len(rows) + 1, len(engine.z))),
                f"{name} is not conserved, although the method conserves it",
                "a step far too long for this state, or a map or an integral that contradicts its record. Use a "
                "smaller dt; project=False (--no-project) shows the map without projection.",
                seen=False,
            )


def is_finite(x: Floats) -> bool:
    """Whether all entries are finite."""
    if x.size < FEW and math.isfinite(sum(x.ravel().tolist())):  # a tenth of the time of NumPy's sum
        return True
    with np.errstate(all="ignore"):  # the sum of finite entries may overflow
        return math.isfinite(np.add.reduce(x, None)) or bool(np.isfinite(x).all())


def _good(rows: Floats, z: Floats, holds: Callable[[Floats], Array]) -> Array | None:
    """The rows and lanes that are good; None if all are, which is decided without a copy."""
    of_rows, of_state = holds(rows), holds(z)
    if of_rows.all() and of_state.all():
        return None
    both = np.concatenate([np.broadcast_to(x, (len(x), len(z), *x.shape[2:])) for x in (of_rows, of_state[None])])
    return both.reshape((len(rows) + 1, len(z), -1)).all(-1)
