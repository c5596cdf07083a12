"""The projection at work: its compiled code, for one state, vectors of lanes and GPUs, and how kernels call it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from kreisel.algebra import Array
from kreisel.kernels.layout import Floats
from kreisel.kernels.projection.program import Program

TAU = 1e-6  # of a row of length 1: what depends on the others to less is left as it is
GAIN = 0.0625  # of the mean that is found of what an invariant drifts by from one projection to the next
FLAT = 2.0**-30  # a gradient so small beside the terms of its invariant tells no direction
WIDTH = 8  # lanes at once
FAR = 1e3  # times what a random walk of rounding errors makes of a state that turns by a radian in a step
LINE = 64  # bytes of the cache; a vector that lies across two takes twice the time
# K: parts of 10^k.  With SHARE projections take 1 to 5 % of the time, measured for n = 3, 5, 10, alone and in lanes.
INTERVALS = tuple(int(m * 10**e / 10) for e in range(2, 12) for m in (10, 20, 25, 40, 50, 80))
SHARE = 0.011  # operations of a projection that an operation of a step may cost

# For the lanes from `lane` on.  `room` has a row for each number: values, their lower parts, slopes, J, G, r.
BLOCK = """
{inline}
def put_sum(room, high, low, p, e):
    s = p + e
    put(room, high, s)
    put(room, low, e - (s - p))


{compiled}
def block(sizes, ops, runs, outs, ends, cones, columns, literals, targets, worst, z, c, room, lane, last, begin):
    d, k, lanes, constants, used, known, length, many, free = sizes
    base = d + used + known
    count = base + length
    S = 2 * count
    J = S + count
    G = J + k * d
    R = G + k * k
    T = R + k  # of each invariant the four numbers of `targets` and `worst`
    for w in range({width}):
        at = min(lane + w, last - 1)
        if not begin:
            for j in range(k):
                for i in range(4):
                    set_entry(room, T + 5 * j + i, w, number(targets, 4 * (at * k + j) + i))
                set_entry(room, T + 5 * j + 4, w, number(worst, at * k + j))
        for i in range(d):
            set_entry(room, i, w, number(z, {z}))
        for i in range(used):
            j = whole(columns, i)
            set_entry(room, d + i, w, number(c, {c}))
        for i in range(known):
            set_entry(room, d + used + i, w, number(literals, i))
    nothing = get(room, d + used)
    for i in range(count, count + base):
        put(room, i, nothing)
    i = 0
    for run in range(many):
        what, end = whole(runs, 2 * run), whole(runs, 2 * run + 1)
        if what == 2:
            while i < end:
                o, x, y = base + i, whole(ops, 4 * i), whole(ops, 4 * i + 1)
                a, b, la, lb = get(room, x), get(room, y), get(room, count + x), get(room, count + y)
                p = times(a, b)
                put_sum(room, o, count + o, p, fma(a, b, -p) + fma(a, lb, times(la, b)))
                i += 1
        elif what == 0:
            while i < end:
                o, x, y = base + i, whole(ops, 4 * i), whole(ops, 4 * i + 1)
                a, b, la, lb = get(room, x), get(room, y), get(room, count + x), get(room, count + y)
                p = a + b
                t = p - a
                put_sum(room, o, count + o, p, ((a - (p - t)) + (b - t)) + (la + lb))
                i += 1
        elif what == 1:
            while i < end:
                o, x, y = base + i, whole(ops, 4 * i), whole(ops, 4 * i + 1)
                a, b, la, lb = get(room, x), get(room, y), get(room, count + x), get(room, count + y)
                p = a - b
                t = p - a
                put_sum(room, o, count + o, p, ((a - (p - t)) - (b + t)) + (la - lb))
                i += 1
        elif what == 3:
            while i < end:
                o, x, y = base + i, whole(ops, 4 * i), whole(ops, 4 * i + 1)
                a, b, la, lb = get(room, x), get(room, y), get(room, count + x), get(room, count + y)
                p, q = a / b, 1.0 / b
                put_sum(room, o, count + o, p, times(fma(-p, b, a) + fma(-p, lb, la), q))
                put(room, whole(ops, 4 * i + 2), q)
                put(room, whole(ops, 4 * i + 3), -times(p, q))
                i += 1
        else:
            while i < end:
                o, x = base + i, whole(ops, 4 * i)
                a, la = get(room, x), get(room, count + x)
                p = sqrt(a)
                q = 0.5 / p
                put_sum(room, o, count + o, p, times(fma(-p, p, a) + la, q))
                put(room, whole(ops, 4 * i + 2), q)
                i += 1
    if begin:
        for w in range({width}):
            at = min(lane + w, last - 1)
            for j in range(k):
                set_number(targets, 4 * (at * k + j), entry(room, whole(outs, j), w))
                set_number(targets, 4 * (at * k + j) + 1, entry(room, count + whole(outs, j), w))
        for i in range(base):
            put(room, i, size(get(room, i)))
        i = 0
        for run in range(many):  # the terms of each sum, all with one sign
            what, end = whole(runs, 2 * run), whole(runs, 2 * run + 1)
            while i < end:
                a, b, o = get(room, whole(ops, 4 * i)), get(room, whole(ops, 4 * i + 1)), base + i
                if what == 2:
                    put(room, o, times(a, b))
                elif what < 2:
                    put(room, o, a + b)
                elif what == 3:
                    put(room, o, a / b)
                else:
                    put(room, o, sqrt(a))
                i += 1
        for w in range({width}):
            at = min(lane + w, last - 1)
            for j in range(k):
                set_number(targets, 4 * (at * k + j) + 2, entry(room, whole(outs, j), w))
        return
    for i in range(S, S + count):
        put(room, i, nothing)
    one = get(room, d + used + 1)
    start = 0
    for j in range(k):
        put(room, S + whole(outs, j), one)
        for n in range(start, whole(ends, j)):
            i = whole(cones, n)
            o, x, y = S + base + i, S + whole(ops, 4 * i), S + whole(ops, 4 * i + 1)
            g = get(room, o)
            put(room, o, nothing)
            put(room, x, fma(g, get(room, whole(ops, 4 * i + 2)), get(room, x)))
            put(room, y, fma(g, get(room, whole(ops, 4 * i + 3)), get(room, y)))
        start = whole(ends, j)
        for i in range(d):
            put(room, J + j * d + i, get(room, S + i) if i >= free else nothing)
            put(room, S + i, nothing)
    total = nothing
    for i in range(d):
        total = fma(get(room, i), get(room, i), total)
    unit = 1.0 / sqrt(total)
    for j in range(k):
        total = nothing
        for i in range(d):
            total = fma(get(room, J + j * d + i), get(room, J + j * d + i), total)
        flat = times(get(room, T + 5 * j + 2), times(unit, FLAT))
        total = sqrt(fma(flat, flat, total))
        scale = where_less(nothing, total, 1.0 / total, nothing)
        for i in range(d):
            put(room, J + j * d + i, times(scale, get(room, J + j * d + i)))
        lack = get(room, whole(outs, j)) - get(room, T + 5 * j)
        lack = lack + (get(room, count + whole(outs, j)) - get(room, T + 5 * j + 1))
        lead = get(room, T + 5 * j + 3)
        drift = lack + lead
        lead = fma(GAIN, fma(0.5, drift, -lead), lead)
        put(room, T + 5 * j + 3, lead)
        put(room, R + j, times(lack + lead, scale))
        distance = times(size(times(drift, scale)), times(unit, 1.0 / EPS))
        put(room, T + 5 * j + 4, max(get(room, T + 5 * j + 4), distance))
    for j in range(k):
        for q in range(j, k):
            total = nothing
            for i in range(d):
                total = fma(get(room, J + j * d + i), get(room, J + q * d + i), total)
            put(room, G + j * k + q, total + TAU if q == j else total)
    for j in range(k):
        pivot = 1.0 / get(room, G + j * k + j)
        for q in range(j + 1, k):
            f = -times(get(room, G + j * k + q), pivot)
            for i in range(q, k):
                put(room, G + q * k + i, fma(f, get(room, G + j * k + i), get(room, G + q * k + i)))
            put(room, R + q, fma(f, get(room, R + j), get(room, R + q)))
        put(room, G + j * k + j, pivot)
    for j in range(k - 1, -1, -1):
        total = get(room, R + j)
        for q in range(j + 1, k):
            total = fma(-get(room, G + j * k + q), get(room, R + q), total)
        put(room, R + j, times(total, get(room, G + j * k + j)))
    for i in range(d):
        total = get(room, i)
        for j in range(k):
            total = fma(-get(room, J + j * d + i), get(room, R + j), total)
        put(room, i, total)
    for w in range(min({width}, last - lane)):
        at = lane + w
        for i in range(d):
            set_number(z, {z}, entry(room, i, w))
        for j in range(k):
            set_number(targets, 4 * (at * k + j) + 3, entry(room, T + 5 * j + 3, w))
            set_number(worst, at * k + j, entry(room, T + 5 * j + 4, w))
"""

HEAD = '''"""Made by kreisel.kernels.projection.compiled; not to be edited."""
from math import sqrt

from numba import cfunc, njit

from kreisel.kernels._numba.fused import fma, size, where_less
from kreisel.kernels._numba.pointers import double_at as number
from kreisel.kernels._numba.pointers import integer_at as whole
from kreisel.kernels._numba.pointers import long_at, put_double as set_number
{reading}
TAU, FLAT, EPS, GAIN = {tau!r}, {flat!r}, {eps!r}, {gain!r}


@njit({exact})
def get(room, row):
    return {get}


@njit({exact})
def put(room, row, value):
    {put}


@njit({exact})
def entry(room, row, w):
    return number(room, {width} * row + w)


@njit({exact})
def set_entry(room, row, w, value):
    set_number(room, {width} * row + w, value)


@njit({exact})
def times(x, y):
    return x * y

'''

TABLE = '''

@cfunc("void(i8, i8, i8, i8, i8)", cache=True, error_model="numpy")
def project(table, place, first, last, begin):
    """The lanes from first to last; `table` has the numbers below and where the next one is, `place` is room."""
    place = (place + {line} - 1) // {line} * {line}
    while table != 0:
        sizes = (
            long_at(table, 0), long_at(table, 1), long_at(table, 2), long_at(table, 3), long_at(table, 4),
            long_at(table, 5), long_at(table, 6), long_at(table, 7), long_at(table, 8),
        )
        ops, runs, outs = long_at(table, 9), long_at(table, 10), long_at(table, 11)
        ends, cones, columns = long_at(table, 12), long_at(table, 13), long_at(table, 14)
        literals, targets, worst = long_at(table, 15), long_at(table, 16), long_at(table, 17)
        z, c = long_at(table, 18), long_at(table, 19)
        for lane in range(first, last, {width}):
            block(
                sizes, ops, runs, outs, ends, cones, columns, literals, targets, worst, z, c, place, lane, last, begin
            )
        table = long_at(table, 20)
'''


def source(width: int) -> str:
    """The text of the projection of so many states at once."""
    one, exact = width == 1, 'error_model="numpy", forceinline=True'
    head = HEAD.format(
        reading="" if one else "from kreisel.kernels._numba.vector_type import put_vector, vector_at\n",
        get="number(room, row)" if one else f"vector_at(room, row, {width})",
        put="set_number(room, row, value)" if one else "put_vector(room, row, value)",
        width=width,
        exact=exact,
        tau=TAU,
        flat=FLAT,
        gain=GAIN,
        eps=float(np.finfo(np.float64).eps),
    )
    states = block(f"@njit({exact})", '@njit(error_model="numpy")', "at * d + i", "at * constants + j", width)
    return head + states + TABLE.format(width=width, line=LINE)


def block(inline: str, compiled: str, z: str, c: str, width: int) -> str:
    """The text of the projection of `width` states, by decorators, and by where the numbers i of z and j of c stand."""
    return BLOCK.format(inline=inline, compiled=compiled, z=z, c=c, width=width)


def interval(cost: float, work: float) -> int:
    """K: the first of 100, 200, 250, ... steps between two projections that makes them a small share of the time."""
    return next(k for k in INTERVALS if k * SHARE * work >= cost)


class Weave:
    """How steps are written into a kernel: one after the other."""

    types = arguments = head = ""

    def begin(self, indent: int) -> str:
        """What comes before the first lane."""
        return ""

    def steps(self, step: str, load: str, store: str, end: str) -> list[str]:
        """The lines for `every` steps of the lanes from `lane` to `end`."""
        return ["for _ in range(every):", *(f"    {line}" for line in step.splitlines())]


plain = Weave()


@dataclass(frozen=True)
class Woven(Weave):
    """And every `often` steps a projection; `room` numbers for it."""

    room: int

    types = ", i8, i8, i8, i8"
    arguments = ", begun, often, project, table"
    head = "from kreisel.kernels._numba.pointers import call\n\n"

    def begin(self, indent: int) -> str:
        return " " * indent + f"room = np.zeros({self.room})"

    def steps(self, step: str, load: str, store: str, end: str) -> list[str]:
        return [
            "if row == 0:",
            "    done = begun",
            "left = every",
            "while left > 0:",
            "    count = min(left, often - done)",
            "    for _ in range(count):",
            *(f"        {line}" for line in step.splitlines()),
            "    left, done = left - count, done + count",
            "    if done == often:",
            "        done = 0",
            *(f"        {line}" for line in store.splitlines()),
            f"        call(project, (table, room.ctypes.data, lane, {end}, 0))",
            *(f"        {line}" for line in load.splitlines()),
        ]


class Corrections:
    """What a projection knows of a run: the values of the invariants at the start, and how much it had to correct.

    labels   of the invariants
    every    steps between two projections; `done` of them were made since the last one
    targets  the values at the start, in two doubles each, the size of their terms, and by how much a projection goes
             beyond them (lanes, invariants, 4)
    worst    the largest correction of each yet, as a distance in state space in units of eps_machine |z|
    bound    as `targets`, of what binds an orientation to the state
    """

    def __init__(self, labels: tuple[str, ...], every: int, lanes: int, bonds: int = 0):
        self.labels, self.every, self.done = labels, every, 0
        self.targets, self.worst = np.zeros((lanes, len(labels), 4)), np.zeros((lanes, len(labels)))
        self.bound = np.zeros((lanes, bonds, 4))

    def peek(self, z: Floats) -> Floats:
        """`worst` with what the state z lacks now (lanes, invariants), NaN where that is not known; nothing changes."""
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
        """`every` steps for each row of `out`, by calls of `advance(rows, steps)`, and a projection where it is due.

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
        """Which corrections (lanes, invariants) roundings of `every` steps, each a turn by `angle`, cannot explain."""
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


class Projection(Corrections):
    """The compiled projection of rows z (lanes, d), which kernels call by its address."""

    def __init__(self, program: Program, also: Program | None, every: int, z: Floats, constants: Floats, width: int):
        from kreisel.kernels.cpu import load

        super().__init__(program.labels, every, len(z), 0 if also is None else len(also.outs))
        self._z, self._compiled = z, load(source(width)).project
        self._room = LINE // 8 + width * max(program.rows, 0 if also is None else also.rows)
        self._held: list[np.ndarray] = []  # as long as their addresses are used
        second = 0 if also is None else self._table(also, self.bound, np.zeros(self.bound.shape[:2]), z, constants, 0)
        self._first = self._table(program, self.targets, self.worst, z, constants, second)
        self._call(1)

    def _table(
        self, program: Program, targets: Floats, worst: Floats, z: Floats, constants: Floats, following: int
    ) -> int:
        """The address of a table of all that is needed for a program."""
        arrays = (*program.arrays, targets, worst, z, constants)
        addresses = [array.ctypes.data for array in arrays]
        table = [*program.sizes(len(z), constants.shape[1]), *addresses, following]
        self._held += [*arrays, np.array(table, dtype=np.int64)]
        return self._held[-1].ctypes.data

    @property
    def weave(self) -> Woven:
        """How it is written into a kernel."""
        return Woven(self._room)

    @property
    def arguments(self) -> tuple[int, ...]:
        """What a kernel takes for it."""
        return self.done, self.every, self._compiled.address, self._first

    def _call(self, begin: int) -> None:
        room = np.zeros(self._room)
        self._compiled.ctypes(self._first, room.ctypes.data, 0, len(self._z), begin)

    def apply(self) -> None:
        """Project the state, in place."""
        self._call(0)

    def peek(self, z: Floats) -> Floats:
        arrays = self._z, self.worst, self.targets, self.bound
        before = [array.copy() for array in arrays]
        self._z[:] = z
        self._call(0)
        found = self.worst.copy()
        for array, value in zip(arrays, before, strict=True):
            array[:] = value
        return found
