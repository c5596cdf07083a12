"""Schemes that know the state at any time, behind the same two names as a compiled kernel: `z` and `advance`.

A row depends only on its phases, so neither the cut into calls nor the number of threads changes a bit of it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from threading import Lock
from typing import cast

import numpy as np
from llvmlite import ir

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.algebra.reuse import cached_property
from kreisel.exact.motion import periods_of
from kreisel.graph.arranging import independent
from kreisel.graph.graph import IN
from kreisel.graph.llvm import DOUBLE, INDEX, INTEGER, Function, Integer, Memory, Value
from kreisel.graph.machine import Kernel, address_of, kernel
from kreisel.graph.recording import recorded_function
from kreisel.kernels.exact import jumps
from kreisel.kernels.exact.jumps import Jumps, jumps_of
from kreisel.kernels.layout import LANES, Floats, Look, no_look, on_threads
from kreisel.method.scheme import ORIENTATION, Jump, Scheme
from kreisel.record.contract import Orbit, States

AT_ONCE = 4096  # times that a function is asked for
MOST_PLACES = 12  # as a power of two, kept for all rows; of more only those that are asked for
WORD = (1 << 64) - 1
WIDTH = 16  # rows in a block, a multiple of LANES: with 64 the table of polynomials does not stay in the first cache
CIRCLE_BITS = 9  # angles in a table, as a power of two
SIZE = 1 << CIRCLE_BITS
LINE = 8  # scalars in a line of the cache
VECTOR = ir.VectorType(DOUBLE, LANES)
WORDS = 12  # in front of the arguments
ARGUMENTS = (
    "phases", "where", "known", "table", "circle", "constants", "places", "out",
    "lane", "lanes", "first", "last", "done",
)  # fmt: skip
CLOSE = 1e-11  # of a period and of each: nearer to its end, doubles do not tell how many there were
ROW_WORK = 1000  # a row is worth this number of operations on lanes


def dyadic(times: Floats) -> tuple[Array, Array]:
    """Doubles as M 2^e, exactly: M Python integers in an object array."""
    fraction, exponent = np.frexp(times)
    return (fraction * 2.0**53).astype(np.int64).astype(object), exponent.astype(np.int64) - 53


class ClosedForm:
    """Rows at the times k dt, exactly these; steps between two rows cost nothing.  `reach`: the largest |time|.

    The first `jumps.ROWS`, one in `every` steps, of a free body or a top are jumps, each with a separate set-up.  All
    others share one in many digits, and so do those that need it.  Or at any times, by jumps: a separate set-up costs
    less than to find the place of a time in the shared one.
    """

    projection = None

    def __init__(self, scheme: Scheme, z0: Floats, dt: float, reach: float, every: int = 1):
        if scheme.orbits is None:
            raise TypeError(f"the scheme {scheme.name} states no orbit")
        self.z, self._orbits = np.array(z0, dtype=np.float64), scheme.orbits
        self._scheme, self._start, self._reach, self._unit = scheme, self.z.copy(), reach, dt
        self._done, self._jumped = 0, jumps.ROWS.get(type(self._orbits.jump), 0) * every
        self._rows_of_lanes: dict[int, OrbitRows | Samples] = {}
        self._compiled: tuple[list[int], Kernel] | None = None

    @cached_property
    def _dyadic(self) -> tuple[int, int]:
        """dt as M 2^e."""
        (integer,), (exponent,) = dyadic(np.array([self._unit]))
        return integer, int(exponent)

    @cached_property
    def _jumps(self) -> Jumps:
        return jumps_of(self._scheme, len(self._start))

    def _lanes(self, which: Iterable[int]) -> dict[int, OrbitRows | Samples]:
        """The orbits of some lanes, set up in many digits.  Raises `InputError` if there is no closed form."""
        which, scheme, lanes = list(which), self._scheme, len(self._start)
        new = [lane for lane in which if lane not in self._rows_of_lanes]
        if not new:  # of no lane 17 us too
            return {lane: self._rows_of_lanes[lane] for lane in which}
        kinds, constants = scheme.kinds, dict[str, Array]()
        starts = algebra.restore(self._start.copy(), kinds, scheme.n)
        for name, value in scheme.constants.items():
            array = np.asarray(value, dtype=np.float64)
            constants[name] = np.broadcast_to(array, (lanes, *array.shape[array.ndim - scheme.axes[name] :]))
        for lane in new:
            values = {name: value[lane] for name, value in constants.items()}
            orbit = self._orbits.orbit(tuple(component[lane] for component in starts), values, self._reach)
            self._rows_of_lanes[lane] = (
                OrbitRows(orbit, *self._kernel(orbit, kinds)) if isinstance(orbit, Orbit) else Samples(orbit, kinds)
            )
        return {lane: self._rows_of_lanes[lane] for lane in which}

    def _kernel(self, orbit: Orbit, kinds: list[str]) -> tuple[list[int], Kernel]:
        """The scalars of a place that are used, and the kernel of all lanes."""
        if self._compiled is None:
            rows = RowKernel(orbit, kinds)
            self._compiled = rows.used, rows.kernel()
        return self._compiled

    def ready(self) -> ClosedForm:
        """Set up before the first row is asked for."""
        _ = self._jumps if self._jumped else self._lanes(range(len(self.z)))
        return self

    def advance(self, out: Floats, every: int, look: Look = no_look) -> None:
        count = min(len(out), max(0, (self._jumped - self._done) // every))
        if count:
            look()
            out[:count] = self._leapt(self._done + every * np.arange(1.0, count + 1), self._unit)
            self._done += every * count
        if count < len(out):
            self._march(out[count:], every, look)
        self.z[:] = out[-1]

    def _leapt(self, times: Floats, unit: float = 1.0) -> Floats:
        """States at the products of times and unit, with the signs of quaternions in the continuous motion.

        By jumps, and in many digits where these are not right.
        """
        out, right = self._jumps.at(self._start, times, unit)
        if isinstance(self._orbits.jump, Jump) and ORIENTATION in dict(self._scheme.components):
            first, signs = self._scheme.column_of(ORIENTATION), self._signs(times * unit)
            out[..., first : first + 4] *= signs[..., None]
            right &= signs != 0
        for lane, rows in self._lanes(np.flatnonzero(~right.all(0)).tolist()).items():
            wrong, (factor, power) = np.flatnonzero(~right[:, lane]), dyadic(np.array([unit]))
            integers, exponents = dyadic(times[wrong])
            mended = np.empty((len(wrong), 1, out.shape[-1]))
            rows.at(mended, 0, integers * factor[0], exponents + power[0])
            out[wrong, lane] = mended[:, 0]
        return out

    @cached_property
    def _periods(self) -> tuple[Array, Array]:
        """Periods of the nutation of tops, and the signs that they give the quaternions."""
        scheme, jump = self._scheme, cast("Jump", self._orbits.jump)
        m, b, p, *_ = jump.begin(*algebra.restore(self._start, scheme.kinds, scheme.n), **scheme.constants)
        return periods_of(m, b, np.broadcast_to(p, b.shape))

    def _signs(self, times: Array) -> Array:
        """The signs of quaternions of jumps in the continuous motion; 0 where doubles cannot tell them."""
        with np.errstate(all="ignore"):  # of tops of other forms, as without gravity
            period, sign = self._periods
            phase = times[:, None] / period
        count = np.rint(phase)
        close = abs(abs(phase - count) - 0.5) < CLOSE * (1 + abs(count))
        signs = np.where(count % 2 == 1, sign, abs(sign))
        return np.where(close, 0.0, np.where(count == 0, 1.0, signs))

    def _march(self, out: Floats, every: int, look: Look) -> None:
        dt, exponent = self._dyadic
        for lane, rows in self._lanes(range(len(self.z))).items():
            look()
            steps = rows.steps(dt, exponent) if isinstance(rows, OrbitRows) else None
            if isinstance(rows, Samples) or steps is None:
                k = self._done + every * np.arange(1, len(out) + 1).astype(object)
                rows.at(out, lane, k * dt, np.broadcast_to(exponent, k.shape))
            else:
                rows.fill_evenly(out, lane, [self._done * s for s in steps], [every * s for s in steps])
        self._done += every * len(out)

    def begin(self, z: Floats, scheme: Scheme, steps: int) -> bool:
        return False

    def snapshot(self) -> dict[str, Floats]:
        return {"steps": np.asarray(self._done, dtype=np.float64), "z": self.z}

    def restore(self, snapshot: Mapping[str, Floats]) -> None:
        self._done, self.z[:] = int(snapshot["steps"]), snapshot["z"]

    def at(self, times: Floats) -> Floats:
        """The states (times, lanes, d) at times in any order."""
        if self._orbits.jump is not None:
            return self._leapt(times)
        out = np.empty((len(times), *self.z.shape))
        for lane, rows in self._lanes(range(len(self.z))).items():
            rows.at(out, lane, *dyadic(times))
        return out


def words(numbers: list[int]) -> Array:
    """Numbers of 128 binary places, mod 1, as their upper and lower words (2, count)."""
    return np.array([[v >> 64 & WORD for v in numbers], [v & WORD for v in numbers]], dtype=np.uint64)


@cache
def circle() -> Floats:
    """Cos and then sin of the multiples of 2 pi/SIZE below 2 pi."""
    import mpmath

    angles = [mpmath.mpf(2 * i) / SIZE for i in range(SIZE)]
    with mpmath.workdps(30):
        return np.array([float(f(a)) for f in (mpmath.cospi, mpmath.sinpi) for a in angles])


class Samples:
    """The states of one orbit that a function of the time states."""

    def __init__(self, states: States, kinds: list[str]):
        self._states, self._kinds = states, kinds

    def at(self, out: Floats, lane: int, M: Array, e: Array) -> None:
        """The states at the times M 2^e into out[:, lane]."""
        for first in range(0, len(out), AT_ONCE):
            rows = slice(first, first + AT_ONCE)
            out[rows, lane] = algebra.flatten(self._states(M[rows], e[rows]), self._kinds)


class OrbitRows:
    """The states of one orbit, by a kernel made of its `row`."""

    def __init__(self, orbit: Orbit, used: list[int], kernel: Kernel):
        self.orbit, self._used = orbit, used
        values = [np.asarray(v, dtype=np.float64) for v in orbit.constants.values()]
        self._constants = np.concatenate([np.empty(0), *(v.ravel() for v in values)])
        dense = orbit.places <= MOST_PLACES
        shape = 1 << orbit.places if dense else 0, *self._numbers(0).shape
        store = np.empty(math.prod(shape) + 7)
        first = -store.ctypes.data % 64 // 8  # with a line of the cache, 64 bytes
        self._table = store[first : first + math.prod(shape)].reshape(shape)
        self._computed = np.zeros(len(self._table), dtype=np.int64)  # 1 if it is
        self._sparse: dict[int, Array] = {}
        self._one_at_a_time = Lock()  # scalars in many digits change their context
        self._kernel = kernel

    def steps(self, M: int, e: int) -> list[int] | None:
        """The phases of a step M 2^e, of 128 binary places; None without rates, and if the first one has too few."""
        shift, rates = 128 - self.orbit.bits + e, self.orbit.rates or ()
        steps = [v * M << shift if shift >= 0 else v * M >> -shift for v in rates]
        return steps if rates and (abs(steps[0]) > WORD or rates[0] == 0) else None

    def fill_evenly(self, out: Floats, lane: int, before: list[int], step: list[int]) -> None:
        """The states at the phases before + step, before + 2 step, ..., of 128 binary places, into out[:, lane]."""
        if not len(self._table):
            at = np.array([[b + k * s for b, s in zip(before, step, strict=True)] for k in range(1, len(out) + 1)])
            self.fill(out, lane, (np.concatenate([at >> 64, at[:, :1]], 1) & WORD).astype(np.uint64))
            return

        def share(first: int, last: int) -> None:
            while first < last:
                at = words([b + (first + 1) * s for b, s in zip(before, step, strict=True)])
                self._place(at[0, 0])
                first = self._call(at, words(step), None, None, self._table, out, lane, first, last)

        on_threads(len(out), ROW_WORK * len(out), share)

    def at(self, out: Floats, lane: int, M: Array, e: Array) -> None:
        """The states at the times M 2^e into out[:, lane]."""
        self.fill(out, lane, self.orbit.phases(M, e))

    def fill(self, out: Floats, lane: int, phases: Array) -> None:
        """The states at these phases (rows, 4) into out[:, lane]."""
        needed, where = np.unique(self._nearest(phases[:, 0]), return_inverse=True)
        if len(self._table):
            for j in needed[self._computed[needed] == 0].tolist():
                self._place(np.uint64(j << (64 - self.orbit.places)))
            table, where = self._table, needed[where]
        else:
            self._sparse |= {j: self._numbers(j) for j in needed.tolist() if j not in self._sparse}
            table = np.array([self._sparse[j] for j in needed.tolist()])
        self._call(words([0] * 3), words([0] * 3), phases, where, table, out, lane, 0, len(out))

    def _nearest(self, phase: Array) -> Array:
        """The parts that phases are nearest to."""
        half, shift = np.uint64(1 << (63 - self.orbit.places)), np.uint64(64 - self.orbit.places)
        return ((phase + half) >> shift).astype(np.int64)

    def _place(self, phase: Array) -> None:
        j = int(self._nearest(np.asarray([phase]))[0])
        with self._one_at_a_time:
            if not self._computed[j]:
                self._table[j] = self._numbers(j)
                self._computed[j] = 1

    def _numbers(self, j: int) -> Array:
        """The polynomials of place j that the kernel needs, in multiples of LANES."""
        kept = self.orbit.place(j)[:, self._used]
        return np.pad(kept, ((0, 0), (0, -len(self._used) % LANES)))

    def _call(
        self,
        at: Array,
        step: Array,
        phases: Array | None,
        where: Array | None,
        table: Floats,
        out: Floats,
        lane: int,
        first: int,
        last: int,
    ) -> int:
        """The kernel, up to a row whose place is not known; its number."""
        listed = [np.empty(0) if v is None else np.ascontiguousarray(v) for v in (phases, where)]
        arrays = [*listed, self._computed, table, circle(), self._constants]
        addresses = [address_of(array) for array in arrays]
        words = [*addresses, self.orbit.places, address_of(out), lane, out.shape[1], first, last, 0]
        frame = np.array([*at.view(np.int64).flat, *step.view(np.int64).flat, *words])
        self._kernel(address_of(frame))
        return int(frame[-1])


# -- kernels of rows -----------------------------------------------------------------------------------


class RowKernel:
    """The kernel of an orbit and of others like it, made of its `row`: there are no scalars of a lane in it.

    It gets the words of a frame: three phases, their upper and their lower words; the same of their steps; then
    `ARGUMENTS`.  Each row has the phases before it and a step, or those at `phases` (rows, 4) if that is not a null;
    its place is then in `where`.  It stops before a row whose place is not in the table, and sets `done`.

    used  the scalars of a place that it needs
    """

    def __init__(self, orbit: Orbit, kinds: Sequence[str]):
        self.terms, numbers = orbit.place(0).shape
        shapes = {"place": (numbers,), "left": (3,), "right": (3,)}

        def function(place: Array, left: Array, right: Array, **constants: Array) -> Array:
            return algebra.flatten(orbit.row(place, left, right, **constants), kinds)

        constants = {k: np.shape(v) for k, v in orbit.constants.items()}
        self.graph, self.outputs, count = recorded_function(function, shapes, constants)
        self.nodes = self.graph.needed(self.outputs)
        inputs = sorted(node[2] for node in map(self.graph.nodes.__getitem__, self.nodes) if node[:2] == (IN, "z"))
        self.used = [k for k in inputs if k < numbers]
        places = [*self.used, *range(numbers, count)]
        self.at = {k: place * WIDTH for place, k in enumerate(places)}  # of each input, in the room of a block
        self.begin = len(places) * WIDTH  # of the results
        self.turns = {1 + side: self.at[k] for side, k in enumerate((numbers, numbers + 3)) if k in inputs}

    def kernel(self) -> Kernel:
        """Compiled, or from the disk."""
        key = "rows", self.graph.digest(self.outputs), self.terms, self.at, self.turns
        return kernel(key, 1, lambda f: _Rows(f, self).write())


class _Rows:
    """The function under construction; `room` has the scalars of a block of rows."""

    def __init__(self, f: Function, of: RowKernel):
        self._f, self._builder, self._of, self._size = f, f.builder, of, len(of.outputs)
        self._frame = f.integers(f.arguments[0])
        words = dict(zip(ARGUMENTS, self._frame.get(len(ARGUMENTS), WORDS), strict=True))
        self._words: dict[str, Integer] = words
        self._phases, self._where, self._computed = (f.integers(words[name]) for name in ("phases", "where", "known"))
        self._table, self._circle, self._out = (f.doubles(words[name]) for name in ("table", "circle", "out"))

    def write(self) -> None:
        f, words, graph, nodes = self._f, self._words, self._of.graph, self._of.nodes
        used, (count, start, stopped) = [0, *self._of.turns], f.variables(3, INTEGER)
        self._room = f.room(self._of.begin + self._size * WIDTH)
        self._u, self._x, self._part_index = f.room(len(used) * WIDTH, INTEGER), f.room(WIDTH), f.room(WIDTH, INTEGER)
        self._low = f.room(WIDTH, INTEGER)
        self._low_unit = f.builder.fmul((f.integer(1) << words["places"]).double(), DOUBLE(2.0**-126))
        for row in range(WIDTH):  # rows that a last block does not have are computed too
            self._x[row], self._part_index[row], self._low[row] = 0.0, 0, 0
        constants = f.doubles(words["constants"])
        fixed, values = independent(graph, nodes, "c"), dict[int, Value]()
        f.compute(graph, [at for at in nodes if at in fixed], values, lambda _, i: constants[i], DOUBLE)
        phases = [(h, k) for h, k in zip(f.variables(len(used), INTEGER), used, strict=True)]
        lower = f.variables(len(used), INTEGER)
        for (upper, k), low in zip(phases, lower, strict=True):
            upper[0], low[0] = self._frame[k], self._frame[3 + k]
        start[0], stopped[0] = words["first"], 0

        def unfinished() -> Value:
            return f.builder.and_(start[0].compared("<", words["last"]), stopped[0].compared("==", 0))

        with f.while_(unfinished):
            count[0] = (words["last"] - start[0]).least(WIDTH)
            with f.otherwise(words["phases"].compared("!=", 0)) as (listed, evenly):
                with listed, f.loop(0, count[0]) as i:
                    self._part_index[i] = self._where[start[0] + i]
                    self._low[i] = self._phases[(start[0] + i) * 4 + 3]
                    for place, k in enumerate(used):
                        self._u[i + place * WIDTH] = self._phases[(start[0] + i) * 4 + k]
                with evenly:
                    for place, ((upper, k), low) in enumerate(zip(phases, lower, strict=True)):
                        self._march(place, k, upper, low, count[0])
                    self._find(count, stopped)
            self._block(start[0], count[0], values)
            start[0] = start[0] + count[0]
        self._frame[WORDS + len(ARGUMENTS) - 1] = start[0]

    def _march(self, place: int, k: int, upper: Memory, lower: Memory, count: Integer) -> None:
        step = self._frame[9 + k]
        with self._f.loop(0, count) as i:
            self._u[i + place * WIDTH] = upper[0]
            if not place:
                self._low[i] = lower[0]
            lower[0] = lower[0] + step
            upper[0] = upper[0] + (self._frame[6 + k] + lower[0].below(step))

    def _find(self, count: Memory, stopped: Memory) -> None:
        """The places of the rows, up to one that is not known."""
        f, places = self._f, self._words["places"]
        half, shift = f.integer(1) << (63 - places), 64 - places
        row = f.variable(0)

        def unfinished() -> Value:
            return f.builder.and_(row[0].compared("<", count[0]), stopped[0].compared("==", 0))

        with f.while_(unfinished):
            j = (self._u[row[0]] + half) >> shift
            with f.otherwise(self._computed[j].compared("==", 0)) as (missing, present):
                with missing:
                    count[0], stopped[0] = row[0], 1
                with present:
                    self._part_index[row[0]] = j
                    row[0] = row[0] + 1

    def _block(self, start: Integer, count: Integer, values: dict[int, Value]) -> None:
        """`count` rows: polynomials, turns, the results of the graph, and the store."""
        f, of, room, multiply = self._f, self._of, self._room, self._builder.fmul
        with f.loop(0, count) as i:
            coarse = multiply((self._u[i] << self._words["places"]).double(), DOUBLE(2.0**-63))
            self._x[i] = f.builder.fadd(coarse, multiply((self._low[i] >> 1).double(), self._low_unit))
        for place, at in enumerate(of.turns.values()):
            with f.loop(0, count) as i:
                phase = self._u[i + (1 + place) * WIDTH]
                j = (phase + (1 << (63 - CIRCLE_BITS))) >> (64 - CIRCLE_BITS)
                room[i + at], room[i + (at + WIDTH)] = self._circle[j], self._circle[j + SIZE]
                angle = DOUBLE(float(np.pi) * 2.0 ** -(63 + CIRCLE_BITS))
                room[i + (at + 2 * WIDTH)] = multiply((phase << CIRCLE_BITS).double(), angle)
        with f.loop(0, count, LANES) as i:
            self._expect(start + i)
            self._polynomials(i)
        with f.loop(0, count) as i:
            inside = dict(values)
            f.compute(of.graph, of.nodes, inside, lambda _, k: room[i + of.at[k]], DOUBLE)
            for d, value in enumerate([f.value(x, inside, DOUBLE) for x in of.outputs]):
                room[i + (of.begin + d * WIDTH)] = value
        aligned = count - count % LANES
        with f.loop(0, aligned, LANES) as i:
            self._store(start + i, i + of.begin)
        with f.loop(aligned, count) as i:
            for d in range(self._size):
                self._out[self._row(start + i) + d] = room[i + (of.begin + d * WIDTH)]

    # -- LANES rows at once: one array in scalars first, the other in rows ------------------------------

    def _row(self, row: Integer) -> Integer:
        """Where a row of the lane begins."""
        return (row * self._words["lanes"] + self._words["lane"]) * self._size

    def _expect(self, row: Integer) -> None:
        """Fetch rows into the cache, to be written."""
        builder, pointer = self._builder, self._out.pointer
        kind, name = ir.FunctionType(ir.VoidType(), [pointer.type, INDEX, INDEX, INDEX]), "llvm.prefetch.p0"
        fetch = builder.module.globals.get(name) or ir.Function(builder.module, kind, name)
        for r in range(LANES):
            for place in range(0, self._size + LINE - 1, LINE):
                at = self._row(row + r) + min(place, self._size - 1)
                builder.call(fetch, [self._out.beyond(at).pointer, INDEX(1), INDEX(3), INDEX(1)])

    def _polynomials(self, i: Integer) -> None:
        """The scalars of the places of rows i, i + 1, ..., by Horner's rule with fused products."""
        count, terms = len(self._of.used), self._of.terms
        groups = -(-count // LANES)
        starts = [self._part_index[i + r] * (terms * groups * LANES) for r in range(LANES)]
        arguments = [self._f.spread(self._x[i + r], VECTOR) for r in range(LANES)]

        def numbers(row: int, k: int, group: int) -> Value:
            return self._table.beyond(starts[row] + (k * groups + group) * LANES).of(VECTOR)[0]

        sums = [[numbers(row, terms - 1, group) for row in range(LANES)] for group in range(groups)]
        for k in reversed(range(terms - 1)):
            sums = [
                [self._f.intrinsic("fma", s, arguments[row], numbers(row, k, group)) for row, s in enumerate(four)]
                for group, four in enumerate(sums)
            ]
        for group, four in enumerate(sums):
            for d, column in enumerate(self._transposed(four)[: count - group * LANES]):
                self._room.beyond(i + (group * LANES + d) * WIDTH).of(VECTOR)[0] = column

    def _store(self, row: Integer, begin: Integer) -> None:
        """Rows of the output from columns of the room."""
        for group in range(0, self._size, LANES):
            many = min(LANES, self._size - group)
            columns = [self._room.beyond(begin + (group + d) * WIDTH).of(VECTOR)[0] for d in range(many)]
            columns += [VECTOR(ir.Undefined)] * (LANES - many)
            for r, numbers in enumerate(self._transposed(columns)):
                kept = self._shuffled(numbers, numbers, *range(many))
                self._out.beyond(self._row(row + r) + group).of(kept.type)[0] = kept

    def _shuffled(self, a: Value, b: Value, *places: int) -> Value:
        return self._builder.shuffle_vector(a, b, ir.VectorType(INDEX, len(places))(list(places)))

    def _transposed(self, four: list[Value]) -> list[Value]:
        """Four vectors of four: the others of the same matrix."""
        pairs = [[self._shuffled(v, w, 0, 4, 2, 6), self._shuffled(v, w, 1, 5, 3, 7)] for v, w in (four[:2], four[2:])]
        halves = (0, 1, 4, 5), (2, 3, 6, 7)
        return [self._shuffled(v, w, *half) for half in halves for v, w in zip(*pairs, strict=True)]
