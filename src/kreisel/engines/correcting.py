"""The projection at work: its compiled code, for one state, vectors of lanes and GPUs, and how kernels call it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from kreisel.algebra import Array
from kreisel.engines.layout import Floats
from kreisel.engines.projection import Program

TAU = 1e-6  # of a row of length 1: what depends on the others to less is left as it is
GAIN = 0.25  # of the mean that is found of what an invariant drifts by from one projection to the next
FLAT = 2.0**-30  # a gradient so small beside the terms of its invariant tells no direction
WIDTH = 8  # lanes at once
FAR = 1e3  # times what a random walk of rounding errors makes of a state that turns by a radian in a step
NUMBERS = 20  # in the table
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
def block(ops, outs, cones, ends, literals, columns, targets, worst, z, c, room, lane, last, begin, free):
    d, k = {size_of_state}, len(outs)
    base = d + len(columns) + len(literals)
    count = base + len(ops)
    S = 2 * count
    J = S + count
    G = J + k * d
    R = G + k * k
    for w in range({width}):
        at = min(lane + w, last - 1)
        for i in range(d):
            set_entry(room, i, w, {z})
        for i in range(len(columns)):
            set_entry(room, d + i, w, {c})
        for i in range(len(literals)):
            set_entry(room, d + len(columns) + i, w, literals[i])
        for i in range(base):
            set_entry(room, count + i, w, 0.0)
    for i in range(len(ops)):
        o, x, y = base + i, ops[i, 1], ops[i, 2]
        a, b, la, lb = get(room, x), get(room, y), get(room, count + x), get(room, count + y)
        if ops[i, 0] == 2:
            p = times(a, b)
            put_sum(room, o, count + o, p, fma(a, b, -p) + fma(a, lb, times(la, b)))
        elif ops[i, 0] == 0:
            p = a + b
            t = p - a
            put_sum(room, o, count + o, p, ((a - (p - t)) + (b - t)) + (la + lb))
        elif ops[i, 0] == 1:
            p = a - b
            t = p - a
            put_sum(room, o, count + o, p, ((a - (p - t)) - (b + t)) + (la - lb))
        elif ops[i, 0] == 3:
            p = a / b
            put_sum(room, o, count + o, p, (fma(-p, b, a) + fma(-p, lb, la)) / b)
        else:
            p = sqrt(a)
            put_sum(room, o, count + o, p, (fma(-p, p, a) + la) / (p + p))
    if begin:
        for w in range({width}):
            at = min(lane + w, last - 1)
            for j in range(k):
                targets[at, j, 0] = entry(room, outs[j], w)
                targets[at, j, 1] = entry(room, count + outs[j], w)
        for i in range(base):
            put(room, i, size(get(room, i)))
        for i in range(len(ops)):  # the terms of each sum, all with one sign
            a, b, o = get(room, ops[i, 1]), get(room, ops[i, 2]), base + i
            if ops[i, 0] == 2:
                put(room, o, times(a, b))
            elif ops[i, 0] < 2:
                put(room, o, a + b)
            elif ops[i, 0] == 3:
                put(room, o, a / b)
            else:
                put(room, o, sqrt(a))
        for w in range({width}):
            at = min(lane + w, last - 1)
            for j in range(k):
                targets[at, j, 2] = entry(room, outs[j], w)
        return
    for i in range(count):
        for w in range({width}):
            set_entry(room, S + i, w, 0.0)
    start = 0
    for j in range(k):
        for w in range({width}):
            set_entry(room, S + outs[j], w, 1.0)
        for n in range(start, ends[j]):
            i = cones[n]
            o, x, y = base + i, ops[i, 1], ops[i, 2]
            g = get(room, S + o)
            put(room, S + o, times(g, 0.0))
            if ops[i, 0] == 2:
                put(room, S + x, fma(g, get(room, y), get(room, S + x)))
                put(room, S + y, fma(g, get(room, x), get(room, S + y)))
            elif ops[i, 0] == 0:
                put(room, S + x, get(room, S + x) + g)
                put(room, S + y, get(room, S + y) + g)
            elif ops[i, 0] == 1:
                put(room, S + x, get(room, S + x) + g)
                put(room, S + y, get(room, S + y) - g)
            elif ops[i, 0] == 3:
                g = g / get(room, y)
                put(room, S + x, get(room, S + x) + g)
                put(room, S + y, fma(-g, get(room, o), get(room, S + y)))
            else:
                g = g / (get(room, o) + get(room, o))
                put(room, S + x, get(room, S + x) + g)
        start = ends[j]
        for i in range(d):
            g = get(room, S + i)
            put(room, J + j * d + i, g if i >= free else times(g, 0.0))
            put(room, S + i, times(g, 0.0))
    nothing = times(get(room, 0), 0.0)
    total = nothing
    for i in range(d):
        total = fma(get(room, i), get(room, i), total)
    length = sqrt(total)
    for j in range(k):
        for w in range({width}):
            at = min(lane + w, last - 1)
            for i in range(4):
                set_entry(room, R + k + i, w, targets[at, j, i])
            set_entry(room, R + k + 4, w, worst[at, j])
        total = nothing
        for i in range(d):
            total = fma(get(room, J + j * d + i), get(room, J + j * d + i), total)
        flat = times(get(room, R + k + 2), FLAT) / length
        total = sqrt(fma(flat, flat, total))
        scale = where_less(nothing, total, 1.0 / total, nothing)
        for i in range(d):
            put(room, J + j * d + i, times(scale, get(room, J + j * d + i)))
        lack = get(room, outs[j]) - get(room, R + k)
        lack = lack + (get(room, count + outs[j]) - get(room, R + k + 1))
        lead = get(room, R + k + 3)
        moved = lack + lead
        lead = fma(GAIN, fma(0.5, moved, -lead), lead)
        put(room, R + k + 3, lead)
        put(room, R + j, times(lack + lead, scale))
        put(room, R + k + 4, max(get(room, R + k + 4), size(times(moved, scale)) / times(length, EPS)))
        for w in range({width}):
            at = min(lane + w, last - 1)
            targets[at, j, 3] = entry(room, R + k + 3, w)
            worst[at, j] = entry(room, R + k + 4, w)
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
            {z} = entry(room, i, w)
"""

HEAD = '''"""Made by kreisel.engines.correcting; not to be edited."""
from math import sqrt

import numpy as np
from numba import carray, cfunc, njit

from kreisel.engines.fused import fma, size, where_less
from kreisel.engines.pointers import doubles, integers, longs
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
    return room[row, w]


@njit({exact})
def set_entry(room, row, w, value):
    room[row, w] = value


@njit({exact})
def times(x, y):
    return x * y

'''

TABLE = '''

@cfunc("void(i8, i8, i8, i8, i8)", cache=True, error_model="numpy")
def project(table, place, first, last, begin):
    """The lanes from first to last; `table` has the numbers below and where the next one is, `place` is room."""
    while table != 0:
        t = carray(longs(table), ({numbers},))
        lanes, d, constants, k, columns_used, literals_used, length_of_ops, length_of_cones = t[:8]
        ops = carray(integers(t[8]), (length_of_ops, 3))
        outs, ends = carray(integers(t[9]), (k,)), carray(integers(t[10]), (k,))
        cones, columns = carray(integers(t[11]), (length_of_cones,)), carray(integers(t[12]), (columns_used,))
        literals = carray(doubles(t[13]), (literals_used,))
        targets, worst = carray(doubles(t[14]), (lanes, k, 4)), carray(doubles(t[15]), (lanes, k))
        z, c = carray(doubles(t[16]), (lanes, d)), carray(doubles(t[17]), (lanes, constants))
        count = d + columns_used + literals_used + length_of_ops
        room = carray(doubles(place), (3 * count + k * (d + k + 1) + 5, {width}))
        for lane in range(first, last, {width}):
            block(ops, outs, cones, ends, literals, columns, targets, worst, z, c, room, lane, last, begin, t[18])
        table = t[19]
'''


def source(width: int) -> str:
    """The text of the projection of so many states at once."""
    one, exact = width == 1, 'error_model="numpy", forceinline=True'
    head = HEAD.format(
        reading="" if one else "from kreisel.engines.vector_type import load, store\n",
        get="room[row, 0]" if one else f"load(room, row, 1, {width})[0]",
        put="room[row, 0] = value" if one else "store(room, row, (value,))",
        exact=exact,
        tau=TAU,
        flat=FLAT,
        gain=GAIN,
        eps=float(np.finfo(np.float64).eps),
    )
    states = block(f"@njit({exact})", '@njit(error_model="numpy")', "z[at, i]", "c[at, columns[i]]", width)
    return head + states + TABLE.format(numbers=NUMBERS, width=width)


def block(inline: str, compiled: str, z: str, c: str, width: int) -> str:
    """The text of the projection of `width` states, by decorators, and by how a number of z and c is read."""
    size = f"z.shape[{int(z == 'z[at, i]')}]"
    return BLOCK.format(inline=inline, compiled=compiled, size_of_state=size, z=z, c=c, width=width)


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
    head = "from kreisel.engines.pointers import call\n\n"

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
        from kreisel.engines.cpu import load

        super().__init__(program.labels, every, len(z), 0 if also is None else len(also.outs))
        self._z, self._compiled = z, load(source(width)).project
        self._room = width * max(program.rows, 0 if also is None else also.rows)
        self._held: list[np.ndarray] = []  # as long as their addresses are used
        second = 0 if also is None else self._table(also, self.bound, np.zeros(self.bound.shape[:2]), z, constants, 0)
        self._first = self._table(program, self.targets, self.worst, z, constants, second)
        self._call(1)

    def _table(
        self, program: Program, targets: Floats, worst: Floats, z: Floats, constants: Floats, following: int
    ) -> int:
        """The address of a table of all that is needed for a program."""
        sizes = [*z.shape, constants.shape[1], len(program.outs), len(program.columns), len(program.literals)]
        arrays = (*program.arrays, targets, worst, z, constants)
        addresses = [array.ctypes.data for array in arrays]
        table = [*sizes, len(program.ops), len(program.cones), *addresses, program.first, following]
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
