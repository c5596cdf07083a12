"""Schemes that know the state at any time, behind the same two names as a compiled kernel: `z` and `advance`.

A row depends on its own phases alone, so neither the cut into calls nor the number of threads changes a bit of it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import Any

import numpy as np
from numba import njit

from kreisel.algebra import Array
from kreisel.engines import layout
from kreisel.engines.cpu import EXACT, HEAD, WIDTH, load, shares
from kreisel.engines.layout import Floats
from kreisel.engines.lines import split
from kreisel.engines.recording import indented, recorded_function
from kreisel.methods.scheme import Orbit, Scheme

MOST_PLACES = 12  # as a power of two, kept for all rows; of more only those that are asked for
CIRCLE_BITS = 8  # half-turns in a table, as a power of two
WORD = (1 << 64) - 1
CHUNK = 8192  # rows at once, whose phases stay in the second cache
ROW_WORK = 8  # a row is worth so many steps of a map in an ensemble

ROWS = """
@njit("void(u8[:,::1], i8[::1], f8[:,::1], f8[:,::1], f8[::1], i8, f8, f8[:,:,::1], i8, i8)", {options})
def kernel(phases, where, table, circle, c, places, unit, out, lane, first):
{constants}
    w = np.empty({rows})
    for start in range(0, len(where), {width}):
        count = min({width}, len(where) - start)
        for i in range(count):
            row = start + i
            j = where[row]
{place}
            w[{h} + i] = np.float64(np.int64(phases[row, 0] << np.uint64(places))) * unit
{turns}
        for i in range(count):
{begin}
{body}
{save}
        for i in range(count):
{store}
"""


TURN = """
            phase = phases[row, {phase}]
            j = np.int64((phase + np.uint64({half})) >> np.uint64({shift}))
            w[{at} + i] = circle[j, 0]
            w[{at} + {width} + i] = circle[j, 1]
            w[{at} + 2 * {width} + i] = np.float64(np.int64(phase << np.uint64({bits}))) * {rest!r}
"""


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


Phases = Callable[[int, int], Array]  # of the rows from the first to the one before the last, (rows, 3)


class ClosedForm:
    """Rows at the times k dt, exactly these; steps between two rows cost nothing.  `reach`: the largest |time|."""

    def __init__(self, scheme: Scheme, z0: Floats, dt: float, reach: float):
        self.z = np.array(z0, dtype=np.float64)
        self._done = 0
        (self._dt,), (self._exponent,) = dyadic(np.array([dt]))
        kinds = [kind for _, kind in scheme.components]
        self._lanes = [Rows(orbit, kinds, scheme.name) for orbit in orbits(scheme, self.z, reach)]

    def advance(self, out: Floats, every: int) -> None:
        for lane, rows in enumerate(self._lanes):
            rows.fill(out, lane, self._progression(rows.orbit, every))
        self._done += every * len(out)
        self.z[:] = out[-1]

    def _progression(self, orbit: Orbit, every: int) -> Phases:
        """The phases of every so many steps from here on."""
        done, rates = self._done, orbit.rates
        if rates is None:

            def phases(first: int, last: int) -> Array:
                k = done + every * np.arange(first + 1, last + 1).astype(object)
                return orbit.phases(k * self._dt, np.broadcast_to(self._exponent, k.shape))

            return phases
        shift = 128 - orbit.bits + int(self._exponent)
        steps = [rate * self._dt << shift if shift >= 0 else rate * self._dt >> -shift for rate in rates]
        each = [every * s for s in steps]
        return lambda first, last: progression([(done + every * (first + 1)) * s for s in steps], each, last - first)

    def snapshot(self) -> dict[str, Floats]:
        return {"steps": np.asarray(self._done, dtype=np.float64), "z": self.z}

    def restore(self, snapshot: Mapping[str, Floats]) -> None:
        self._done, self.z[:] = int(snapshot["steps"]), snapshot["z"]

    def at(self, times: Floats) -> Floats:
        """The states (times, lanes, d) at times in any order."""
        out = np.empty((len(times), *self.z.shape))
        for lane, rows in enumerate(self._lanes):
            at = rows.orbit.phases
            rows.fill(out, lane, lambda first, last, at=at: at(*dyadic(times[first:last])))  # type: ignore[misc]
        return out


def progression(first: list[int], step: list[int], count: int) -> Array:
    """Phases (count, len(first)): the upper words of first + k step, all of 128 binary places and mod 1."""
    begin, more = (np.array([[v >> 64 & WORD, v & WORD] for v in values], dtype=np.uint64) for values in (first, step))
    out = np.empty((count, len(first)), dtype=np.uint64)
    _sum_up(begin, more, out)
    return out


@njit("void(u8[:,::1], u8[:,::1], u8[:,::1])", cache=True, nogil=True)
def _sum_up(first: Any, step: Any, out: Any) -> None:
    for i in range(out.shape[1]):
        high, low = first[i, 0], first[i, 1]
        more, less = step[i, 0], step[i, 1]
        for row in range(out.shape[0]):
            out[row, i] = high
            low += less
            high += more + np.uint64(low < less)


@njit("void(u8[:,::1], i8, i8[::1], b1[::1])", cache=True, nogil=True)
def _locate(phases: Any, places: Any, where: Any, seen: Any) -> None:
    """The part that the first phase is nearest to, and which parts there are."""
    half, shift = np.uint64(1) << np.uint64(63 - places), np.uint64(64 - places)
    for row in range(len(where)):
        where[row] = np.int64((phases[row, 0] + half) >> shift)
        if len(seen):
            seen[where[row]] = True


@cache
def circle() -> Floats:
    """Cos and sin of the multiples of pi/2^CIRCLE_BITS below pi, (2^CIRCLE_BITS, 2)."""
    import mpmath

    angles = [mpmath.mpf(i) / 2**CIRCLE_BITS for i in range(2**CIRCLE_BITS)]
    with mpmath.workdps(30):
        return np.array([[float(mpmath.cospi(a)), float(mpmath.sinpi(a))] for a in angles])


class Rows:
    """The states of one orbit, by a kernel made of its `row`."""

    def __init__(self, orbit: Orbit, kinds: list[str], name: str):
        self.orbit = orbit
        values = [np.asarray(v, dtype=np.float64) for v in orbit.constants.values()]
        self._constants = np.concatenate([v.ravel() for v in values])
        dense = orbit.places <= MOST_PLACES
        self._numbers = len(orbit.place(0))
        self._table = np.empty((1 << orbit.places if dense else 0, self._numbers))
        self._known = np.zeros(len(self._table), dtype=bool)
        self._sparse: dict[int, Array] = {}
        self.source = _source(orbit, kinds, name, self._numbers)
        self._kernel = load(self.source).kernel

    def fill(self, out: Floats, lane: int, phases: Phases) -> None:
        """The states at these phases into out[:, lane]."""

        def share(first: int, last: int) -> None:
            for start in range(first, last, CHUNK):
                self._fill(out, lane, phases(start, min(start + CHUNK, last)), start)

        parts = list(shares(len(out), ROW_WORK * len(out)))
        if len(parts) < 2:
            share(0, len(out))
            return
        with ThreadPoolExecutor(len(parts)) as pool:
            for done in [pool.submit(share, *part) for part in parts]:
                done.result()

    def _fill(self, out: Floats, lane: int, phases: Array, start: int) -> None:
        places, table = self.orbit.places, self._table
        where, seen = np.empty(len(phases), dtype=np.int64), np.zeros(len(table), dtype=bool)
        _locate(phases, places, where, seen)
        if len(table):
            for j in np.flatnonzero(seen & ~self._known).tolist():
                table[j], self._known[j] = self.orbit.place(j), True
        else:
            needed, where = np.unique(where, return_inverse=True)
            self._sparse |= {j: self.orbit.place(j) for j in needed.tolist() if j not in self._sparse}
            table = np.array([self._sparse[j] for j in needed.tolist()])
        unit = self.orbit.part * 2.0**-64
        self._kernel(phases, where, table, circle(), self._constants, places, unit, out, lane, start)


def _source(orbit: Orbit, kinds: list[str], name: str, numbers: int) -> str:
    """Straight-line code of `row` in blocks of rows, which LLVM vectorises; what all rows share comes first."""
    shapes = {"place": (numbers,), "h": (), "left": (3,), "right": (3,)}

    def function(place: Array, h: Array, left: Array, right: Array, **known: Array) -> Array:
        return layout.flatten(orbit.row(place, h, left, right, **known), kinds)

    fixed_shapes = {k: np.shape(v) for k, v in orbit.constants.items()}
    lines, values, count = recorded_function(function, shapes, fixed_shapes)
    used = {name for line in lines for name in line.needs} | {value.strip("(-)") for value in values}
    constants = sorted((n for n in used if n[0] == "c" and n[1:].isdigit()), key=lambda n: int(n[1:]))
    fixed, varying = split(lines, constants)
    inputs = sorted((n for n in used if n[0] == "z" and n[1:].isdigit()), key=lambda n: int(n[1:]))
    begin = count * WIDTH
    turns = "".join(
        TURN.format(
            phase=1 + side,
            at=first * WIDTH,
            width=WIDTH,
            bits=CIRCLE_BITS,
            shift=64 - CIRCLE_BITS,
            half=1 << (63 - CIRCLE_BITS),
            rest=float(np.pi) * 2.0 ** -(64 + CIRCLE_BITS),
        )
        for side, first in enumerate((numbers + 1, numbers + 4))
        if f"z{first}" in used
    )
    return HEAD.format(name=f"{name} in closed form") + ROWS.format(
        options=EXACT,
        width=WIDTH,
        rows=(count + len(values)) * WIDTH,
        h=numbers * WIDTH,
        turns=turns.strip("\n"),
        constants=indented([*(f"{n} = c[{n[1:]}]" for n in constants), *(line.text for line in fixed)], 4),
        place=indented([f"w[{d * WIDTH} + i] = table[j, {d}]" for d in range(numbers) if f"z{d}" in used], 12),
        begin=indented([f"{n} = w[{int(n[1:]) * WIDTH} + i]" for n in inputs], 12),
        body=indented([line.text for line in varying], 12),
        save=indented([f"w[{begin + d * WIDTH} + i] = {value}" for d, value in enumerate(values)], 12),
        store=indented(
            [f"out[first + start + i, lane, {d}] = w[{begin + d * WIDTH} + i]" for d in range(len(values))], 12
        ),
    )
