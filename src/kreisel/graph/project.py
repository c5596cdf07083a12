"""Round-off, in one place: every K steps the state goes back to the values that its invariants had at the start.

    r = I(z) - I(z_0)                           in double-double
    J = dI/dz                                   in double, by a reverse sweep
    d <- d + g (r - r_0 - d)                    r_0 of just after the last projection: the mean drift in K steps
    z <- z - J^T (J J^T + tau)^-1 (r + d/2)     one step of Gauss and Newton; rows of J, and r with them, of length 1

Rounding errors have a mean, and so I drifts.  By d/2 the mean of I over an interval, and not its start, is I(z_0): else
the frequencies would be off by d/2, and the phase by that times N.  g = 1/16, 1/64 where K is short: a mean of few
intervals is as uncertain as their random walks, which 7 ulp at n = 3 and K = 1250 showed.

The operations are here once, in loops: of a short program these are written out, and constants, scalars 0 and 1 above
all, are folded; code for long ones goes through the tables of any program.  The bits are those of a single state, also
for lanes.  K counts from step 0, so the bits do not depend on `every`, nor on where a run was interrupted.
A correction is of the size of rounding errors, or a claim of the map is false: the largest one is kept.  Components of
unlike units change in proportion to their sizes: else the J J^T of a binary in SI is singular, and d grows.
[Hairer, Lubich, Wanner, Geometric Numerical Integration, section IV.4]
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from llvmlite import ir

from kreisel.algebra import Array
from kreisel.algebra.reuse import Identity, reused
from kreisel.graph.double import fused, pair_difference, pair_product, pair_quotient, pair_root, pair_sum, root
from kreisel.graph.graph import IN, Graph, Number, Operand, where_less
from kreisel.graph.invariants import ADD, DIVIDE, MULTIPLY, OPERATIONS, SUBTRACT, Program, written_out
from kreisel.graph.llvm import Function, Integer, Lanes, Memory, kind_of
from kreisel.graph.machine import Kernel, address_of, kernel
from kreisel.kernels.layout import Floats, Look, no_look
from kreisel.method.scheme import Scheme

EPS = float(np.finfo(np.float64).eps)
TAU = 1e-6  # of a row of length 1: a row that depends less on the others is left unchanged
GAIN = 0.0625  # of the measured mean of an invariant's drift from one projection to the next
GAIN_STRAIGHT = 0.015625  # the same where projections are written out, and K is 5 to 8 times shorter
FAR = 1e3  # times the random walk of rounding errors of a state that rotates by a radian in a step
# K: parts of 10^k, from 10 on.  With SHARE projections of vectors of lanes need 2 to 4 % of the time, n = 3 to 5; those
# of a single trajectory, whose steps wait for each other, 1 %.
INTERVALS = tuple(
    m * 10**e // 100 for e in range(1, 12) for m in (100, 125, 200, 250, 400, 500, 800) if e > 1 or m != 125
)
FLAT = 2.0**-30  # a gradient so small next to the terms of its invariant tells no direction
HUGE = 1e300
WIDE = 8  # lanes at once
LINE = 64  # bytes of the cache; a vector that lies across two needs twice the time
SHARE = 0.011  # operations of a projection that an operation of a step may cost
ALONE = 3  # times as many where a lane is as slow as a single trajectory


# -- the data ------------------------------------------------------------------------------------------


def interval(cost: float, work: float, most: int = 0) -> int:
    """K: the first of 10, 20, 25, ... steps between two projections that makes them a small share of the time.

    `most`: at most so many, whatever they cost; 0 for no such bound.
    """
    return min(next(k for k in INTERVALS if k * SHARE * work >= cost), most or INTERVALS[-1])


class Corrections:
    """The data of a projection in a run: the values of the invariants at the start, and the size of its corrections.

    labels   of the invariants
    every    steps between two projections; `done` of them were made since the last one
    targets  the values at the start, in two doubles each, the size of their terms, and by how much a projection goes
             beyond them (lanes, invariants, 4)
    worst    the largest correction of each yet, as a distance in state space in units of eps_machine |z|
    bound    as `targets`, of the constraints between an orientation and the state
    woven    whether the kernel of the steps calls the projection
    """

    woven = False

    def __init__(self, labels: tuple[str, ...], every: int, lanes: int, bonds: int = 0):
        self.labels, self.every, self.done = labels, every, 0
        self.targets, self.worst = np.zeros((lanes, len(labels), 4)), np.zeros((lanes, len(labels)))
        self.bound = np.zeros((lanes, bonds, 4))

    def peek(self, z: Floats) -> Floats:
        """`worst` with the corrections of the state z (lanes, invariants), NaN where unknown; nothing changes."""
        raise NotImplementedError

    def apply(self) -> None:
        """Project the state, in place."""
        raise NotImplementedError

    def count(self, steps: int) -> None:
        """So many steps were made."""
        self.done = (self.done + steps) % self.every

    def in_parts(
        self, out: Floats, every: int, advance: Callable[[Floats, int], None], project: Callable[[], Floats]
    ) -> None:
        """`every` steps for each row of `out`, by calls of `advance(rows, steps)`, and a projection if it is due.

        `project` returns the state, which a row that ends there has.
        """
        row = into = 0
        while row < len(out):
            left = self.every - self.done
            rows = 0 if into else min(left // every, len(out) - row)
            steps = rows * every or min(left, every - into)
            advance(out[row : row + max(rows, 1)], every if rows else steps)
            into = (into + steps) % every
            row += rows or into == 0
            self.count(steps)
            if self.done == 0:
                state = project()
                if into == 0:
                    out[row - 1] = state

    def beyond(self, angle: Array) -> Array:
        """Which corrections (lanes, invariants) roundings of `every` steps, each a rotation by `angle`, cannot
        explain.
        """
        return self.worst > FAR * np.sqrt(self.every) * (1 + angle[:, None] ** 2)

    def largest(self, z: Floats) -> dict[str, float]:
        """The largest correction of each variable, at the end of a run in the state z."""
        out: dict[str, float] = {}
        for label, value in zip(self.labels, np.fmax.reduce(self.peek(z)), strict=True):
            if value == value:
                name = label.partition("[")[0]
                out[name] = max(out.get(name, 0.0), float(value))
        return out

    def snapshot(self) -> dict[str, Floats]:
        """All that the next steps depend on."""
        done = np.array(float(self.done))
        return {"targets": self.targets, "bound": self.bound, "worst": self.worst, "done": done}

    def restore(self, snapshot: Mapping[str, Floats]) -> None:
        """Go on from a snapshot."""
        for name in ("targets", "bound", "worst"):
            getattr(self, name)[:] = snapshot[name]
        self.done = int(snapshot["done"])


class Projected:
    """An engine whose state is projected between calls of `_advance(out, every, look)`, or by them."""

    z: Floats
    projection: Corrections | None = None

    def advance(self, out: Floats, every: int, look: Look = no_look) -> None:
        if self.projection is None or self.projection.woven:
            self._advance(out, every, look)
            if self.projection is not None:
                self.projection.count(len(out) * every)
        else:
            self.projection.in_parts(out, every, lambda rows, steps: self._advance(rows, steps, look), self._project)

    def _advance(self, out: Floats, every: int, look: Look) -> None:
        raise NotImplementedError

    def _project(self) -> Floats:
        """The state, projected."""
        if self.projection is not None:
            self.projection.apply()
        return self.z

    def begin(self, z: Floats, scheme: Scheme, steps: int) -> bool:
        return False

    def snapshot(self) -> dict[str, Floats]:
        return {"z": self.z, **(self.projection.snapshot() if self.projection else {})}

    def restore(self, snapshot: Mapping[str, Floats]) -> None:
        self.z[:] = snapshot["z"]
        if self.projection:
            self.projection.restore(snapshot)


# -- the projection ------------------------------------------------------------------------------------


class Projection:
    """The operations of a projection, on scalars that are recorded or written into a function.

    flow     loops, as of `Straight`
    tables   of a `Program`, and its `literals`
    form     of the program: whether it binds an orientation, and its parts
    x        room: of each register its two doubles, then its slope; J (k, d), J J^T (k, k), right-hand sides (k,)
    rows     z, constants, targets and worst as of `Corrections`
    """

    def __init__(
        self, flow: Any, tables: Sequence[Any], literals: Any, form: Any, gain: float, x: Any, rows: Sequence[Any]
    ):
        self.flow, self.literals, (self.bound, self.parts), self.gain, self.x = flow, literals, form, gain, x
        self.z, self.c, self.targets, self.worst = rows
        sizes, self.ops, self.runs, self.outs, self.ends, self.cones, self.columns = tables
        self.d, self.k, columns, literal_count, length, self.run_count, self.first = (sizes[i] for i in range(7))
        self.literal = self.d + columns
        self.base = self.literal + literal_count
        self.low = self.base + length
        self.slopes = 2 * self.low
        self.J = self.slopes + self.low
        self.G = self.J + self.k * self.d
        self.R = self.G + self.k * self.k

    def _operations(self) -> Iterator[tuple[int, Any, Any, Any, Any]]:
        """All operations of the program: the kind, the place, the registers of the result and of both operands."""
        for r in self.flow.indices(0, self.run_count):
            kind, first, last = (self.runs[3 * r + i] for i in range(3))
            for place in range(len(OPERATIONS)):
                for _ in self.flow.only(kind, place):
                    for i in self.flow.indices(first, last):
                        yield place, i, self.base + i, self.ops[4 * i], self.ops[4 * i + 1]

    def values(self) -> None:
        """All registers, and the slopes of quotients and roots."""
        x, low, indices = self.x, self.low, self.flow.indices
        for i in indices(0, self.d):
            x[i] = self.z[i]
        for i in indices(self.d, self.literal):
            x[i] = self.c[self.columns[i - self.d]]
        for i in indices(self.literal, self.base):
            x[i] = self.literals[i - self.literal]
        for i in indices(low, low + self.base):
            x[i] = 0.0
        for kind, i, result, a, b in self._operations():
            left, right = (x[a], x[low + a]), (x[b], x[low + b])
            if kind <= MULTIPLY:
                pair = {ADD: pair_sum, SUBTRACT: pair_difference, MULTIPLY: pair_product}[kind](left, right)
            else:
                pair, inverse = pair_quotient(left, right) if kind == DIVIDE else pair_root(left)
                x[self.ops[4 * i + 2]] = inverse
                if kind == DIVIDE:
                    x[self.ops[4 * i + 3]] = -(pair[0] * inverse)
            x[result], x[low + result] = pair

    def begin(self) -> None:
        """The values of the invariants and the sizes of their terms: each sum with all its terms of one sign."""
        x, size = self.x, self.slopes
        for i in self.flow.indices(0, self.base):
            x[size + i] = abs(x[i])
        for kind, _, result, a, b in self._operations():
            left, right = x[size + a], x[size + b]
            if kind <= SUBTRACT:
                x[size + result] = left + right
            elif kind == MULTIPLY:
                x[size + result] = left * right
            else:
                x[size + result] = left / right if kind == DIVIDE else root(left)
        for j in self.flow.indices(0, self.k):
            for i, row in enumerate((0, self.low, size)):
                self.targets[4 * j + i] = x[row + self.outs[j]]

    def gradients(self) -> None:
        """J, by a reverse sweep for each invariant."""
        x, ops, slopes, indices = self.x, self.ops, self.slopes, self.flow.indices
        for i in indices(slopes, slopes + self.low):
            x[i] = 0.0
        for j in indices(0, self.k):
            row = self.J + j * self.d
            x[slopes + self.outs[j]] = 1.0
            for place in indices(self.ends[j], self.ends[j + 1]):
                i = self.cones[place]
                slope = x[slopes + self.base + i]
                x[slopes + self.base + i] = 0.0
                for side in (0, 1):
                    into = slopes + ops[4 * i + side]
                    x[into] = fused(slope, x[ops[4 * i + 2 + side]], x[into])
            for i in indices(0, self.first):
                x[row + i] = 0.0
            for i in indices(self.first, self.d):
                x[row + i] = x[slopes + i]
            for i in indices(slopes, slopes + self.d):
                x[i] = 0.0

    def correct(self) -> None:
        """One step of Gauss and Newton, and the lead and the farthest correction of each invariant."""
        unit = len(self.parts) ** -0.5 if self.parts else 1.0 / root(self._dot(0, 0, self.d))
        self._weigh()
        for j in self.flow.indices(0, self.k):
            self._lack(j, unit)
        self._solve()
        self._weigh()
        for i in self.flow.indices(self.first, self.d):
            value = self.flow.cell(self.x[i])
            for j in self.flow.indices(0, self.k):
                value[0] = fused(-self.x[self.J + j * self.d + i], self.x[self.R + j], value[0])
            self.z[i] = value[0]

    def _weigh(self) -> None:
        """Multiply J by the sizes of components of unlike units."""
        for first, last in self.parts:
            size = root(self._dot(first, first, last - first))
            for j in self.flow.indices(0, self.k):
                for i in self.flow.indices(self.J + j * self.d + first, self.J + j * self.d + last):
                    self.x[i] = size * self.x[i]

    def _dot(self, a: Any, b: Any, count: Any) -> Any:
        total = self.flow.cell(0.0)
        for i in self.flow.indices(0, count):
            total[0] = fused(self.x[a + i], self.x[b + i], total[0])
        return total[0]

    def _lack(self, j: Any, unit: Any) -> None:
        """Make a row of J of length 1; by how much its invariant is to change, in that unit."""
        x, targets, row, out = self.x, self.targets, self.J + j * self.d, self.outs[j]
        flat = targets[4 * j + 2] * (unit * FLAT)
        total = root(fused(flat, flat, self._dot(row, row, self.d)))
        scale = where_less(total, HUGE, where_less(0.0, total, 1.0 / total, 0.0), 0.0)  # 0 if it is not finite
        for i in self.flow.indices(row, row + self.d):
            slope = x[i]
            if isinstance(slope, Number) or slope:
                x[i] = where_less(0.0, scale, scale * slope, 0.0)
        lack = (x[out] - targets[4 * j]) + (x[self.low + out] - targets[4 * j + 1])
        lack = where_less(abs(lack), HUGE, lack, 0.0)
        lead = targets[4 * j + 3]
        lead = fused(self.gain, 0.5 * (lack + lead) - lead, lead)
        distance = scale * (unit * (1.0 / EPS))
        farthest, off = self.worst[j], abs(lack) * distance
        farthest = where_less(farthest, off, off, farthest)
        if self.bound:  # the constraints of an orientation have no frequency
            lead = 0.0
        else:
            lead = targets[4 * j + 3] = where_less(farthest, abs(lead) * distance, 0.0, lead)
        self.worst[j] = farthest
        x[self.R + j] = (lack + lead) * scale

    def _solve(self) -> None:
        """(J J^T + tau) R = lack, by elimination."""
        x, k, G, R, indices = self.x, self.k, self.G, self.R, self.flow.indices
        for j in indices(0, k):
            for q in indices(j, k):
                x[G + j * k + q] = self._dot(self.J + j * self.d, self.J + q * self.d, self.d)
            x[G + j * k + j] = x[G + j * k + j] + TAU
        for j in indices(0, k):
            pivot = 1.0 / x[G + j * k + j]
            for q in indices(j + 1, k):
                factor = -(x[G + j * k + q] * pivot)
                for i in indices(q, k):
                    x[G + q * k + i] = fused(factor, x[G + j * k + i], x[G + q * k + i])
                x[R + q] = fused(factor, x[R + j], x[R + q])
            x[G + j * k + j] = pivot
        for j in indices(k - 1, -1, -1):
            total = self.flow.cell(x[R + j])
            for q in indices(j + 1, k):
                total[0] = fused(-x[G + j * k + q], x[R + q], total[0])
            x[R + j] = total[0] * x[G + j * k + j]


# -- written out ---------------------------------------------------------------------------------------


class Straight:
    """Loops that are run while operations are recorded."""

    indices = range

    @staticmethod
    def only(kind: int, place: int) -> range:
        """A loop that is run once where kind = place."""
        return range(kind == place)

    @staticmethod
    def cell(x: Any) -> list[Any]:
        """Room for a number that loops change."""
        return [x]


class _Inputs(dict[int, Any]):
    def __init__(self, graph: Graph, letter: str):
        super().__init__()
        self._graph, self._letter = graph, letter

    def __missing__(self, i: int) -> Number:
        return self._graph.input(self._letter, i)


Outputs = dict[tuple[str, int], Operand]


def recorded_projection(program: Program, gain: float) -> tuple[Graph, Outputs, Outputs]:
    """The graph of a projection, and by (letter, index) the outputs of the beginning of a run and of a projection.

    Letters: z and c, t for `Corrections.targets` (4 j + i of invariant j), w for `Corrections.worst`.
    """
    graph = Graph()
    rows = [_Inputs(graph, letter) for letter in "zctw"]
    tables, room = [table.ravel().tolist() for table in program.tables], defaultdict[int, Any](float)
    projection = Projection(Straight, tables, program.literals.tolist(), program.form, gain, room, rows)
    projection.values()
    projection.gradients()
    projection.correct()
    out = {(letter, i): x for letter, row in zip("zctw", rows, strict=True) for i, x in row.items()}
    rows[2].clear()
    projection.begin()
    return graph, {("t", i): x for i, x in rows[2].items()}, out


def _straight(
    f: Function, program: Program, gain: float, lanes: Mapping[str, Lanes], kind: ir.Type, begin: Integer
) -> None:
    graph, *results = recorded_projection(program, gain)
    needs = [graph.needed(list(outputs.values())) for outputs in results]
    values: dict[int, Any] = {}

    def load(letter: str, i: int) -> Any:
        return lanes[letter][i]

    f.compute(graph, sorted({*needs[0]} & {*needs[1]}), values, load, kind)
    with f.otherwise(begin.compared("!=", 0)) as blocks:
        for block, nodes, outputs in zip(blocks, needs, results, strict=True):
            with block:
                into = dict(values)
                f.compute(graph, nodes, into, load, kind)
                for (letter, i), x in outputs.items():
                    lanes[letter][i] = f.value(x, into, kind)


# -- in loops ------------------------------------------------------------------------------------------


class _Looping(Graph):
    """Loops of a function, and its scalars: operations go into it as they are recorded, each if it is."""

    def __init__(self, f: Function, kind: ir.Type):
        super().__init__()
        self._f, self._kind, self._values = f, kind, dict[int, Any]()

    def node(self, operation: str, *operands: Operand) -> int:
        at = len(self.nodes)
        self.nodes.append((operation, *operands))
        self._f.emit(self, [at], self._values, self._kind)
        return at

    def number(self, value: Any) -> Number:
        """A number of LLVM."""
        number = Number(self, self.node(IN))
        self._values[number.at] = value
        return number

    def value(self, x: Operand) -> Any:
        """And back."""
        return self._f.value(x, self._values, self._kind)

    def indices(self, first: Any, last: Any, step: int = 1) -> Iterator[Integer]:
        """The variable of a loop: the body is run once, to be written."""
        with self._f.loop(first, last, step) as i:
            yield i

    def only(self, kind: Integer, place: int) -> Iterator[None]:
        with self._f.where(kind.compared("==", place)):
            yield

    def cell(self, x: Operand) -> _Rows:
        cell = _Rows(self, self._f.variables(1, self._kind)[0])
        cell[0] = x
        return cell


class _Rows:
    def __init__(self, graph: _Looping, memory: Any):
        self._graph, self._memory = graph, memory

    def __getitem__(self, i: Any) -> Number:
        return self._graph.number(self._memory[i])

    def __setitem__(self, i: Any, x: Operand) -> None:
        self._memory[i] = self._graph.value(x)


def in_loops(
    f: Function, form: Any, gain: float, lanes: Mapping[str, Any], kind: ir.Type, begin: Integer,
    tables: Sequence[Memory], room: Any,
) -> None:  # fmt: skip
    """The projection by the tables of any program; lanes: z, c, t, w as of `recorded_projection`, and its literals."""
    flow = _Looping(f, kind)
    *rows, literals, x = (_Rows(flow, memory) for memory in (*lanes.values(), room))
    projection = Projection(flow, tables, literals, form, gain, x, rows)
    projection.values()
    with f.otherwise(begin.compared("!=", 0)) as (start, proceed):
        with start:
            projection.begin()
        with proceed:
            projection.gradients()
            projection.correct()


# -- compiled ------------------------------------------------------------------------------------------


def compiled(programs: Sequence[Program], width: int) -> Kernel:
    """The compiled projection of `width` lanes at once by these programs, one after the other.

    Called with the address of a table, of room, with the first lane, the last one, and whether a run begins.
    """
    return reused(("projection", width, *map(Identity, programs)), lambda: _compiled(programs, width))


def _compiled(programs: Sequence[Program], width: int) -> Kernel:
    straight, kind = written_out(programs), kind_of(width)
    gain = GAIN_STRAIGHT if straight else GAIN
    parts = [program.digest if straight else program.form for program in programs]

    def write(f: Function) -> None:
        table, room, first, last, begin = f.arguments
        f.vectors(width)
        rows = f.doubles((room + (LINE - 1)) // LINE * LINE).of(kind)
        for program in programs:
            words = f.integers(table)
            targets, worst, z, constants, literals, *tables = (words[i] for i in range(12))
            integers = [f.integers(address) for address in tables]
            size, count = (program.size, len(program.outs)) if straight else (integers[0][0], integers[0][1])
            strides = {"z": (z, size), "c": (constants, words[12]), "t": (targets, 4 * count), "w": (worst, count)}
            with f.loop(first, last, width) as lane:
                at = f.lanes(lane, width, last)
                lanes = {
                    name: Lanes(f.doubles(address), at, stride)
                    for name, (address, stride) in (strides | {"l": (literals, 0)}).items()
                }
                if straight:
                    _straight(f, program, gain, lanes, kind, begin)
                else:
                    in_loops(f, program.form, gain, lanes, kind, begin, integers, rows)
            table = words[13]

    return kernel(("projection", width, straight, gain, TAU, *parts), 5, write)


class CompiledProjection(Corrections):
    """The compiled projection of rows z (lanes, d), which kernels call by its address.

    programs  of the invariants, and of the constraints between an orientation and the state
    project   `compiled` of them, `width` lanes at once
    """

    def __init__(
        self,
        programs: Sequence[Program],
        project: Kernel,
        every: int,
        z: Floats,
        constants: Floats,
        width: int,
        woven: bool = False,
    ):
        super().__init__(programs[0].labels, every, len(z), sum(len(program.outs) for program in programs[1:]))
        self._z, self._compiled, self.woven = z, project, woven
        self._room = LINE // 8 + (0 if written_out(programs) else width * max(program.rows for program in programs))
        self._held: list[np.ndarray] = []  # as long as their addresses are used
        self._rooms, self._first = dict[int, int](), 0
        for program in reversed(programs):
            first = program is programs[0]
            targets, worst = (self.targets, self.worst) if first else (self.bound, np.zeros(self.bound.shape[:2]))
            arrays = targets, worst, z, constants, program.literals, *program.tables
            table = [*map(address_of, arrays), constants.shape[1], self._first]
            self._held += [*arrays, np.array(table, dtype=np.int64)]
            self._first = address_of(self._held[-1])
        self._call(1)

    @property
    def arguments(self) -> tuple[int, ...]:
        """Integers that a kernel needs for it before the address of `room`."""
        return self.done, self.every, self._compiled.address, self._first

    def room(self, first: int) -> int:
        """The address of room for the thread whose lanes begin with this one."""
        if first not in self._rooms:
            room = np.zeros(self._room)
            self._held.append(room)  # threads ask at once: the last of these may be that of another one
            self._rooms[first] = room.ctypes.data
        return self._rooms[first]

    def _call(self, begin: int) -> None:
        self._compiled(self._first, self.room(0), 0, len(self._z), begin)

    def begin(self, steps: int) -> None:
        """Take the values at the start from the rows z as they are now, if that many steps are projected at all."""
        self.done = 0
        self.worst[:] = 0
        if steps >= self.every:
            self.targets[:] = self.bound[:] = 0
            self._call(1)

    def apply(self) -> None:
        """Project the state, in place."""
        self._call(0)

    def peek(self, z: Floats) -> Floats:
        arrays = self._z, self.worst, self.targets, self.bound
        before = [array.copy() for array in arrays]
        self._z[:] = z
        self._call(0)
        worst = self.worst.copy()
        for array, value in zip(arrays, before, strict=True):
            array[:] = value
        return worst
