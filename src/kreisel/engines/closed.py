"""Schemes that know the state at any time, behind the same two names as a compiled kernel: `z` and `advance`."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from kreisel.algebra import Array
from kreisel.engines import layout
from kreisel.engines.layout import Floats
from kreisel.methods.scheme import Orbit, Scheme

ROWS = 4096  # at once


def orbits(scheme: Scheme, z0: Floats, reach: float) -> list[Orbit]:
    """The orbit of each lane of z0 (lanes, d), up to |time| = reach.  Raises `InputError` if the scheme knows none."""
    if scheme.orbit is None:
        raise TypeError(f"the scheme {scheme.name} states no orbit")
    kinds = [kind for _, kind in scheme.components]
    starts = layout.restore(z0.copy(), kinds, scheme.n)  # an engine goes on changing its rows
    lanes = len(z0)
    constants = {}
    for name, value in scheme.constants.items():
        array = np.asarray(value, dtype=np.float64)
        constants[name] = np.broadcast_to(array, (lanes, *array.shape[array.ndim - scheme.axes[name] :]))
    return [
        scheme.orbit(tuple(part[lane] for part in starts), {k: v[lane] for k, v in constants.items()}, reach)
        for lane in range(lanes)
    ]


def dyadic(times: Floats) -> tuple[Array, Array]:
    """Doubles as M 2^e, exactly: M Python integers in an object array."""
    fraction, exponent = np.frexp(times)
    return (fraction * 2.0**53).astype(np.int64).astype(object), exponent.astype(np.int64) - 53


class ClosedForm:
    """Rows at the times k dt, exactly these; steps between two rows cost nothing.  `reach`: the largest |time|."""

    def __init__(self, scheme: Scheme, z0: Floats, dt: float, reach: float):
        self.z = np.array(z0, dtype=np.float64)
        self._kinds, self._done = [kind for _, kind in scheme.components], 0
        (self._dt,), self._exponent = dyadic(np.array([dt]))
        self._orbits = orbits(scheme, self.z, reach)

    def advance(self, out: Floats, every: int) -> None:
        k = self._done + every * np.arange(1, len(out) + 1).astype(object)
        self._rows(out, k * self._dt, np.broadcast_to(self._exponent, k.shape))
        self._done += every * len(out)
        self.z[:] = out[-1]

    def snapshot(self) -> dict[str, Floats]:
        return {"steps": np.asarray(self._done, dtype=np.float64), "z": self.z}

    def restore(self, snapshot: Mapping[str, Floats]) -> None:
        self._done, self.z[:] = int(snapshot["steps"]), snapshot["z"]

    def at(self, times: Floats) -> Floats:
        """The states (times, lanes, d) at times in any order."""
        out = np.empty((len(times), *self.z.shape))
        self._rows(out, *dyadic(times))
        return out

    def _rows(self, out: Floats, M: Array, e: Array) -> None:
        for first in range(0, len(out), ROWS):
            here = slice(first, first + ROWS)
            for lane, orbit in enumerate(self._orbits):
                out[here, lane] = layout.flatten(orbit(M[here], e[here]), self._kinds)
