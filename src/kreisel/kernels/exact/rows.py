"""Rows of one orbit in closed form: a kernel made of its `row`, which it computes in blocks of rows.

The words of a frame, which is all that the kernel gets: three phases, their upper and their lower words; the same of
their steps; then `ARGUMENTS`.  Each row has the phases before it and a step, or those at `phases` (rows, 3) if that is
no null; its place is then in `where`.  It stops before a row whose place is not in the table, and sets `done`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from llvmlite import ir

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.graph.arranging import independent
from kreisel.graph.graph import IN, Graph
from kreisel.graph.llvm import DOUBLE, INDEX, INTEGER, Function, Integer, Memory, Value
from kreisel.graph.machine import Kernel, kernel
from kreisel.graph.recording import recorded_function
from kreisel.kernels.layout import LANES
from kreisel.record.contract import Orbit

WIDTH = 16  # rows in a block, a multiple of LANES: with 64 the table of polynomials does not stay in the first cache
CIRCLE_BITS = 9  # angles in a table, as a power of two
SIZE = 1 << CIRCLE_BITS
LINE = 8  # numbers in a line of the cache
VECTOR = ir.VectorType(DOUBLE, LANES)
WORDS = 12  # in front of the arguments
ARGUMENTS = (
    "phases", "where", "known", "table", "circle", "constants", "places", "out",
    "lane", "lanes", "first", "last", "done",
)  # fmt: skip


class RowKernel:
    """The kernel of an orbit and of others like it: there are no numbers of a lane in it.

    used  the numbers of a place that it needs
    """

    def __init__(self, orbit: Orbit, kinds: Sequence[str]):
        self._terms, numbers = orbit.place(0).shape
        shapes = {"place": (numbers,), "left": (3,), "right": (3,)}

        def function(place: Array, left: Array, right: Array, **constants: Array) -> Array:
            return algebra.flatten(orbit.row(place, left, right, **constants), kinds)

        constants = {k: np.shape(v) for k, v in orbit.constants.items()}
        self._graph, self._outputs, count = recorded_function(function, shapes, constants)
        self._nodes = self._graph.needed(self._outputs)
        inputs = sorted(node[2] for node in map(self._graph.nodes.__getitem__, self._nodes) if node[:2] == (IN, "z"))
        self.used = [k for k in inputs if k < numbers]
        places = [*self.used, *range(numbers, count)]
        self._at = {k: place * WIDTH for place, k in enumerate(places)}  # of each input, in the room of a block
        self._begin = len(places) * WIDTH  # of what comes out
        self._turns = {1 + side: self._at[k] for side, k in enumerate((numbers, numbers + 3)) if k in inputs}

    def kernel(self) -> Kernel:
        """Compiled, or from the disk."""
        key = "rows", self._graph.digest(self._outputs), self._terms, self._at, self._turns
        return kernel(key, 1, lambda f: _Rows(f, self._terms, len(self.used)).write(self))


class _Rows:
    """The function under construction: `room` of a block, values of its rows one after the other."""

    def __init__(self, f: Function, terms: int, numbers: int):
        self._f, self._builder, self._terms, self._numbers = f, f.builder, terms, numbers
        self._frame = f.integers(f.arguments[0])
        words = dict(zip(ARGUMENTS, self._frame.get(len(ARGUMENTS), WORDS), strict=True))
        self._words: dict[str, Integer] = words
        self._phases, self._where, self._known = (f.integers(words[name]) for name in ("phases", "where", "known"))
        self._table, self._circle, self._out = (f.doubles(words[name]) for name in ("table", "circle", "out"))

    def write(self, record: RowKernel) -> None:
        f, words = self._f, self._words
        graph, outputs, turns = record._graph, record._outputs, record._turns
        count, start, stopped = f.variables(3, INTEGER)
        used = [0, *turns]
        self._room = f.room(record._begin + len(outputs) * WIDTH)
        self._u, self._x, self._part = f.room(len(used) * WIDTH, INTEGER), f.room(WIDTH), f.room(WIDTH, INTEGER)
        for row in range(WIDTH):  # rows that a last block does not have are computed too
            self._x[row], self._part[row] = 0.0, 0
        constants = f.doubles(words["constants"])
        fixed, values = independent(graph, record._nodes, "c"), dict[int, Value]()
        for at in fixed:
            if graph.nodes[at][0] == IN:
                values[at] = constants[graph.nodes[at][2]]
        f.emit(graph, [at for at in record._nodes if at in fixed], values, DOUBLE)
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
                    self._part[i] = self._where[start[0] + i]
                    for place, k in enumerate(used):
                        self._u[i + place * WIDTH] = self._phases[(start[0] + i) * 3 + k]
                with evenly:
                    for place, ((upper, k), low) in enumerate(zip(phases, lower, strict=True)):
                        self._march(place, k, upper, low, count[0])
                    self._find(count, stopped)
            self._block(start[0], count[0], turns, values, graph, record)
            start[0] = start[0] + count[0]
        self._frame[WORDS + len(ARGUMENTS) - 1] = start[0]

    def _march(self, place: int, k: int, upper: Memory, lower: Memory, count: Integer) -> None:
        step = self._frame[9 + k]
        with self._f.loop(0, count) as i:
            self._u[i + place * WIDTH] = upper[0]
            lower[0] = lower[0] + step
            upper[0] = upper[0] + (self._frame[6 + k] + lower[0].below(step))

    def _find(self, count: Memory, stopped: Memory) -> None:
        """The places of the rows, up to one that is not known."""
        f, places = self._f, self._words["places"]
        half, shift = f.integer(1) << (63 - places), 64 - places
        (row,) = f.variables(1, INTEGER)
        row[0] = 0

        def unfinished() -> Value:
            return f.builder.and_(row[0].compared("<", count[0]), stopped[0].compared("==", 0))

        with f.while_(unfinished):
            j = (self._u[row[0]] + half) >> shift
            with f.otherwise(self._known[j].compared("==", 0)) as (missing, there):
                with missing:
                    count[0], stopped[0] = row[0], 1
                with there:
                    self._part[row[0]] = j
                    row[0] = row[0] + 1

    def _block(
        self,
        start: Integer,
        count: Integer,
        turns: dict[int, int],
        values: dict[int, Value],
        graph: Graph,
        record: RowKernel,
    ) -> None:
        """So many rows: polynomials, turns, what the graph makes of them, and the store."""
        f, room, multiply = self._f, self._room, self._builder.fmul
        with f.loop(0, count) as i:
            self._x[i] = multiply((self._u[i] << self._words["places"]).double(), DOUBLE(2.0**-63))
        for place, at in enumerate(turns.values()):
            with f.loop(0, count) as i:
                phase = self._u[i + (1 + place) * WIDTH]
                j = (phase + (1 << (63 - CIRCLE_BITS))) >> (64 - CIRCLE_BITS)
                room[i + at], room[i + (at + WIDTH)] = self._circle[j], self._circle[j + SIZE]
                angle = DOUBLE(float(np.pi) * 2.0 ** -(63 + CIRCLE_BITS))
                room[i + (at + 2 * WIDTH)] = multiply((phase << CIRCLE_BITS).double(), angle)
        size = len(record._outputs)
        with f.loop(0, count, LANES) as i:
            self._expect(start + i, size)
            self._polynomials(i)
        with f.loop(0, count) as i:
            inside = dict(values)
            for at in record._nodes:
                if graph.nodes[at][:2] == (IN, "z"):
                    inside[at] = room[i + record._at[graph.nodes[at][2]]]
            f.emit(graph, record._nodes, inside, DOUBLE)
            for d, value in enumerate([f.value(x, inside, DOUBLE) for x in record._outputs]):
                room[i + (record._begin + d * WIDTH)] = value
        whole = count - count % LANES
        with f.loop(0, whole, LANES) as i:
            self._store(start + i, i + record._begin, size)
        with f.loop(whole, count) as i:
            for d in range(size):
                self._out[self._row(start + i, size) + d] = room[i + (record._begin + d * WIDTH)]

    # -- LANES rows at once: one array in numbers first, the other in rows ------------------------------

    def _row(self, row: Integer, size: int) -> Integer:
        """Where a row of the lane begins."""
        return (row * self._words["lanes"] + self._words["lane"]) * size

    def _expect(self, row: Integer, size: int) -> None:
        """Fetch rows into the cache, to be written."""
        builder, pointer = self._builder, self._out.pointer
        kind, name = ir.FunctionType(ir.VoidType(), [pointer.type, INDEX, INDEX, INDEX]), "llvm.prefetch.p0"
        fetch = builder.module.globals.get(name) or ir.Function(builder.module, kind, name)
        for r in range(LANES):
            for place in range(0, size + LINE - 1, LINE):
                at = self._row(row + r, size) + min(place, size - 1)
                builder.call(fetch, [self._out.beyond(at).pointer, INDEX(1), INDEX(3), INDEX(1)])

    def _polynomials(self, i: Integer) -> None:
        """Of the numbers of the places of rows i, i + 1, ..., by Horner's rule with fused products."""
        groups = -(-self._numbers // LANES)
        starts = [self._part[i + r] * (self._terms * groups * LANES) for r in range(LANES)]
        arguments = [self._f.spread(self._x[i + r], VECTOR) for r in range(LANES)]

        def numbers(row: int, k: int, group: int) -> Value:
            return self._table.beyond(starts[row] + (k * groups + group) * LANES).of(VECTOR)[0]

        sums = [[numbers(row, self._terms - 1, group) for row in range(LANES)] for group in range(groups)]
        for k in reversed(range(self._terms - 1)):
            sums = [
                [self._f.intrinsic("fma", s, arguments[row], numbers(row, k, group)) for row, s in enumerate(four)]
                for group, four in enumerate(sums)
            ]
        for group, four in enumerate(sums):
            for d, column in enumerate(self._transposed(four)[: self._numbers - group * LANES]):
                self._room.beyond(i + (group * LANES + d) * WIDTH).of(VECTOR)[0] = column

    def _store(self, row: Integer, begin: Integer, size: int) -> None:
        """Rows of the output from columns of the room."""
        for group in range(0, size, LANES):
            many = min(LANES, size - group)
            columns = [self._room.beyond(begin + (group + d) * WIDTH).of(VECTOR)[0] for d in range(many)]
            columns += [VECTOR(ir.Undefined)] * (LANES - many)
            for r, numbers in enumerate(self._transposed(columns)):
                kept = self._shuffled(numbers, numbers, *range(many))
                self._out.beyond(self._row(row + r, size) + group).of(kept.type)[0] = kept

    def _shuffled(self, a: Value, b: Value, *places: int) -> Value:
        return self._builder.shuffle_vector(a, b, ir.VectorType(INDEX, len(places))(list(places)))

    def _transposed(self, four: list[Value]) -> list[Value]:
        """Four vectors of four: the others of the same matrix."""
        pairs = [[self._shuffled(v, w, 0, 4, 2, 6), self._shuffled(v, w, 1, 5, 3, 7)] for v, w in (four[:2], four[2:])]
        halves = (0, 1, 4, 5), (2, 3, 6, 7)
        return [self._shuffled(v, w, *half) for half in halves for v, w in zip(*pairs, strict=True)]
