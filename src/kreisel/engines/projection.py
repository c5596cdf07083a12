"""Round-off, in one place: every K steps the state goes back to the values that its invariants had at the start.

    r = I(z) - I(z_0)                           in double-double
    J = dI/dz                                   in double, by a reverse sweep
    z <- z - J^T (J J^T + tau)^-1 r             one step of Gauss and Newton; rows of J, and r with them, of length 1

I are the Casimirs, integrals and momenta of symmetries that the method conserves, by their definitions in the record,
redundant as they stand.  They are recorded once for a system and n, as a list of operations (`Program`), which compiled
code goes through for one state or for a vector of lanes; a lane has the bits of a state on its own.  K counts from step
0 of a trajectory, so the bits do not depend on `every`, nor on where a run was interrupted.

A correction is of the size of rounding errors, or the map does not conserve what it claims: the largest one is kept.
[Hairer, Lubich, Wanner, Geometric Numerical Integration, section IV.4]
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from kreisel.algebra import Array
from kreisel.engines import layout
from kreisel.engines.layout import Floats
from kreisel.engines.lines import Line, operation
from kreisel.engines.recording import recorded_arguments
from kreisel.engines.trace import Scalar, Tape
from kreisel.methods.scheme import Scheme

TAU = 1e-6  # of the largest eigenvalue 1 of a row: less than that of a direction is left as it is
FLAT = 2.0**-30  # a gradient so small beside the terms of its invariant tells no direction
MOST_CHOSEN = 6000  # operations of all gradients, up to which redundant invariants are left out
SAMPLES, INDEPENDENT = 256, 1e-7
WIDTH = 8  # lanes at once
OPERATIONS = {"+": 0, "-": 1, "*": 2, "/": 3, "sqrt": 4}
APPLIED: list[Callable[..., Array]] = [np.add, np.subtract, np.multiply, np.divide, lambda x, y: np.sqrt(x)]
SLOPES: list[Callable[..., tuple[Any, Any]]] = [  # of x o y = v
    lambda x, y, v: (1, 1),
    lambda x, y, v: (1, -1),
    lambda x, y, v: (y, x),
    lambda x, y, v: (1 / y, -v / y),
    lambda x, y, v: (0.5 / v, 0),
]
ROOT = re.compile(r"sqrt\((\w+)\)")


@dataclass(frozen=True)
class Program:
    """Invariants as operations on registers: z, then constants, then literals, then the results in order.

    names    of the invariants as recorded, and `labels` as a user knows them
    ops      (L, 3): what is done (`OPERATIONS`), and the registers of both operands
    outs     the registers of the invariants
    cones    the operations that each invariant depends on and that depend on z, the last one first; `ends` of each
    """

    names: tuple[str, ...]
    labels: tuple[str, ...]
    size: int
    ops: np.ndarray
    outs: np.ndarray
    cones: np.ndarray
    ends: np.ndarray
    literals: Floats
    columns: np.ndarray

    @property
    def registers(self) -> int:
        """How many there are."""
        return self.size + len(self.columns) + len(self.literals) + len(self.ops)

    @property
    def rows(self) -> int:
        """Numbers that a projection of one state needs as room."""
        return 3 * self.registers + len(self.outs) * (self.size + len(self.outs) + 1) + 4

    @property
    def cost(self) -> float:
        """About how many multiplications a projection is."""
        k, d = len(self.outs), self.size
        return 12 * len(self.ops) + 4 * len(self.cones) + k * k * d / 2 + k**3 / 6

    @cached_property
    def arrays(self) -> tuple[np.ndarray, ...]:
        """All numbers of it."""
        return self.ops, self.outs, self.ends, self.cones, self.columns, self.literals


def program_of(scheme: Scheme, columns: Mapping[str, slice]) -> Program | None:
    """The invariants that a scheme conserves, on recorded numbers; None where there is nothing to project."""
    tape = Tape()
    parts, known = recorded_arguments(scheme, tape, {"c": columns})
    size = sum(layout.size(kind, scheme.n) for _, kind in scheme.components)
    found: dict[str, str] = {}  # by the recorded name, without factors that are constant
    for name, value in scheme.observe(parts, **known).items():
        entries = np.asarray(value, dtype=object)
        for place, entry in enumerate(entries.flat if scheme.outcomes[name].kept else ()):
            if isinstance(entry, Scalar):
                label = f"{name}[{place}]" if entries.ndim else name
                found.setdefault(_without_factors(tape, entry.name, size), label)
    program = _program(tape, found, size)
    if program is None or len(program.cones) > MOST_CHOSEN:
        return program
    return _program(tape, {name: found[name] for name in _enough(program)}, size)


def _varying(lines: list[Line], size: int) -> set[str]:
    """The names that depend on the state."""
    names = {f"z{i}" for i in range(size)}
    for line in lines:
        names.update(line.names if not names.isdisjoint(line.needs) else ())
    return names


def _without_factors(tape: Tape, name: str, size: int) -> str:
    """The name of x for c x, c constant: where c x is conserved for every c, so is x."""
    lines, varying = {line.names[0]: line for line in tape.lines}, _varying(tape.lines, size)
    while name in lines:
        x, what, y = operation(lines[name])
        if what == "*" and (x in varying) != (y in varying):
            name = x if x in varying else y
        elif what == "/" and y not in varying:
            name = x
        else:
            break
    return name


def _program(tape: Tape, found: Mapping[str, str], size: int) -> Program | None:
    lines = tape.needed([*found])
    varying = _varying(lines, size)
    chosen = [name for name in found if name in varying]
    if not chosen:
        return None
    words = [_words(line) for line in lines]
    constants = sorted({w for line in lines for w in line.needs if w[0] == "c"}, key=lambda w: int(w[1:]))
    literals = sorted({w for _, x, y in words for w in (x, y) if not w[0].isalpha()})
    names = [*(f"z{i}" for i in range(size)), *constants, *literals, *(line.names[0] for line in lines)]
    place = {name: i for i, name in enumerate(names)}
    cones = []
    for name in chosen:
        wanted, cone = {name}, []
        for i in reversed(range(len(lines))):
            if lines[i].names[0] in wanted and lines[i].names[0] in varying:
                wanted.update(lines[i].needs)
                cone.append(i)
        cones.append(cone)
    return Program(
        names=tuple(chosen),
        labels=tuple(found[name] for name in chosen),
        size=size,
        ops=np.array([(OPERATIONS[o], place[x], place[y]) for o, x, y in words], dtype=np.int32).reshape(-1, 3),
        outs=np.array([place[name] for name in chosen], dtype=np.int32),
        cones=np.array([i for cone in cones for i in cone], dtype=np.int32),
        ends=np.cumsum([len(cone) for cone in cones], dtype=np.int32),
        literals=np.array([float(w) for w in literals]),
        columns=np.array([int(w[1:]) for w in constants], dtype=np.int32),
    )


def _enough(program: Program) -> list[str]:
    """The names of invariants, short ones first, whose gradients span those of all of them, degenerate states included.

    Looked for at states and constants of 0, 1, -1 and at random ones.  For the Lagrange top, n = 3: 5 of 11.
    """
    rng = np.random.default_rng(0)
    x = rng.normal(size=(SAMPLES, program.registers))
    x[: SAMPLES // 2] *= rng.random((SAMPLES // 2, 1)) < rng.random((SAMPLES // 2, x.shape[1]))
    x[: SAMPLES // 4] = np.sign(x[: SAMPLES // 4])
    J = _gradients(program, x)
    J = J[np.isfinite(J).all((1, 2))]
    length = np.sqrt((J * J).sum(-1, keepdims=True))
    J = np.where(length > INDEPENDENT, J / np.maximum(length, INDEPENDENT), 0)  # or 0 but for rounding
    spanned = np.zeros((len(J), J.shape[-1], J.shape[-1]))
    chosen = []
    lengths = np.diff(program.ends, prepend=0)
    for j in np.argsort(lengths, kind="stable").tolist():
        rest = J[:, j]
        for _ in range(2):
            rest = rest - (spanned @ rest[..., None])[..., 0]
        size = np.sqrt((rest * rest).sum(-1))
        new = size > INDEPENDENT
        if new.any():
            chosen.append(j)
            u = np.where(new[:, None], rest / np.where(new, size, 1)[:, None], 0)
            spanned += u[:, :, None] * u[:, None, :]
    return [program.names[j] for j in sorted(chosen)]


def _gradients(program: Program, x: Array) -> Array:
    """dI/dz (samples, invariants, d) for registers x (samples, registers), of which those of results are written."""
    base, d = program.registers - len(program.ops), program.size
    x[:, d + len(program.columns) : base] = program.literals
    with np.errstate(all="ignore"):
        for i, (what, a, b) in enumerate(program.ops.tolist()):
            x[:, base + i] = APPLIED[what](x[:, a], x[:, b])
        out, start = np.zeros((len(x), len(program.outs), d)), 0
        for j, end in enumerate(program.ends.tolist()):
            slope = np.zeros_like(x)
            slope[:, program.outs[j]] = 1
            for i in program.cones[start:end].tolist():
                what, a, b = program.ops[i].tolist()
                left, right = SLOPES[what](x[:, a], x[:, b], x[:, base + i])
                slope[:, a] += left * slope[:, base + i]
                slope[:, b] += right * slope[:, base + i]
            out[:, j], start = slope[:, :d], end
    return out


def _words(line: Line) -> tuple[str, str, str]:
    """(operation, x, y) of a line; x again in place of y where there is one operand."""
    x, what, y = operation(line)
    if what:
        return what, x, y
    root = ROOT.fullmatch(line.text.partition(" = ")[2])
    if root is None:
        raise TypeError(f"an invariant with {line.text!r} has no gradient here")
    return "sqrt", root[1], root[1]


SOURCE = '''"""Made by kreisel.engines.projection; not to be edited."""
from math import sqrt

import numpy as np
from numba import carray, cfunc, njit

from kreisel.engines.fused import fma, size, where_less
from kreisel.engines.pointers import doubles, integers, longs
{reading}
TAU, FLAT, EPS = {tau!r}, {flat!r}, {eps!r}
FAST = {{"error_model": "numpy", "forceinline": True}}


@njit(**FAST)
def get(room, row):
    return {get}


@njit(**FAST)
def put(room, row, value):
    {put}


@njit(**FAST)
def put_sum(room, high, low, p, e):
    s = p + e
    put(room, high, s)
    put(room, low, e - (s - p))


@cfunc("void(i8, i8, i8, i8, i8)", cache=True, error_model="numpy")
def project(table, place, first, last, begin):
    """The lanes from first to last; `table` has the numbers below, `place` is room for them."""
    t = carray(longs(table), ({numbers},))
    lanes, d, constants, k, columns_used, literals_used, length_of_ops, length_of_cones = t[:8]
    ops = carray(integers(t[8]), (length_of_ops, 3))
    outs, ends = carray(integers(t[9]), (k,)), carray(integers(t[10]), (k,))
    cones, columns = carray(integers(t[11]), (length_of_cones,)), carray(integers(t[12]), (columns_used,))
    literals = carray(doubles(t[13]), (literals_used,))
    targets, worst = carray(doubles(t[14]), (lanes, k, 3)), carray(doubles(t[15]), (lanes, k))
    z, c = carray(doubles(t[16]), (lanes, d)), carray(doubles(t[17]), (lanes, constants))
    base = d + len(columns) + len(literals)
    count = base + len(ops)
    room = carray(doubles(place), (3 * count + k * (d + k + 1) + 4, {width}))
    S = 2 * count  # rows of room: values, their lower parts, slopes, J, G, r and what is put back
    J = S + count
    G = J + k * d
    R = G + k * k
    for lane in range(first, last, {width}):
        for w in range({width}):
            at = min(lane + w, last - 1)
            for i in range(d):
                room[i, w] = z[at, i]
            for i in range(len(columns)):
                room[d + i, w] = c[at, columns[i]]
            for i in range(len(literals)):
                room[d + len(columns) + i, w] = literals[i]
            for i in range(base):
                room[count + i, w] = 0.0
        for i in range(len(ops)):
            o, x, y = base + i, ops[i, 1], ops[i, 2]
            a, b, la, lb = get(room, x), get(room, y), get(room, count + x), get(room, count + y)
            if ops[i, 0] == 2:
                p = a * b
                put_sum(room, o, count + o, p, fma(a, b, -p) + (a * lb + la * b))
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
                put_sum(room, o, count + o, p, (fma(-p, b, a) + (la - p * lb)) / b)
            else:
                p = sqrt(a)
                put_sum(room, o, count + o, p, (fma(-p, p, a) + la) / (p + p))
        if begin:
            for w in range({width}):
                at = min(lane + w, last - 1)
                for j in range(k):
                    targets[at, j, 0], targets[at, j, 1] = room[outs[j], w], room[count + outs[j], w]
            for i in range(base):
                put(room, i, size(get(room, i)))
            for i in range(len(ops)):  # the terms of each sum, all with one sign
                a, b, o = get(room, ops[i, 1]), get(room, ops[i, 2]), base + i
                if ops[i, 0] == 2:
                    put(room, o, a * b)
                elif ops[i, 0] < 2:
                    put(room, o, a + b)
                elif ops[i, 0] == 3:
                    put(room, o, a / b)
                else:
                    put(room, o, sqrt(a))
            for w in range({width}):
                at = min(lane + w, last - 1)
                for j in range(k):
                    targets[at, j, 2] = room[outs[j], w]
            continue
        start = 0
        for j in range(k):
            for w in range({width}):
                room[S + outs[j], w] = 1.0
            for n in range(start, ends[j]):
                i = cones[n]
                o, x, y = base + i, ops[i, 1], ops[i, 2]
                g = get(room, S + o)
                put(room, S + o, 0.0 * g)
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
                    put(room, S + y, get(room, S + y) - g * get(room, o))
                else:
                    g = g / (get(room, o) + get(room, o))
                    put(room, S + x, get(room, S + x) + g)
            start = ends[j]
            for i in range(d):
                g = get(room, S + i)
                put(room, J + j * d + i, g)
                put(room, S + i, 0.0 * g)
        total = 0.0 * get(room, 0)
        for i in range(d):
            total = fma(get(room, i), get(room, i), total)
        length = sqrt(total)
        for j in range(k):
            for w in range({width}):
                at = min(lane + w, last - 1)
                for i in range(3):
                    room[R + k + i, w] = targets[at, j, i]
                room[R + k + 3, w] = worst[at, j]
            total = 0.0 * length
            for i in range(d):
                total = fma(get(room, J + j * d + i), get(room, J + j * d + i), total)
            flat = FLAT * get(room, R + k + 2) / length
            total = sqrt(fma(flat, flat, total))
            scale = where_less(0.0 * total, total, 1.0 / total, 0.0 * length)
            for i in range(d):
                put(room, J + j * d + i, scale * get(room, J + j * d + i))
            lack = get(room, outs[j]) - get(room, R + k)
            lack = (lack + (get(room, count + outs[j]) - get(room, R + k + 1))) * scale
            put(room, R + j, lack)
            put(room, R + k + 3, max(get(room, R + k + 3), size(lack) / (EPS * length)))
            for w in range({width}):
                worst[min(lane + w, last - 1), j] = room[R + k + 3, w]
        for j in range(k):
            for q in range(j, k):
                total = 0.0 * length
                for i in range(d):
                    total = fma(get(room, J + j * d + i), get(room, J + q * d + i), total)
                put(room, G + j * k + q, total + TAU if q == j else total)
        for j in range(k):
            pivot = 1.0 / get(room, G + j * k + j)
            for q in range(j + 1, k):
                f = -(get(room, G + j * k + q) * pivot)
                for i in range(q, k):
                    put(room, G + q * k + i, fma(f, get(room, G + j * k + i), get(room, G + q * k + i)))
                put(room, R + q, fma(f, get(room, R + j), get(room, R + q)))
            put(room, G + j * k + j, pivot)
        for j in range(k - 1, -1, -1):
            total = get(room, R + j)
            for q in range(j + 1, k):
                total = fma(-get(room, G + j * k + q), get(room, R + q), total)
            put(room, R + j, total * get(room, G + j * k + j))
        for i in range(d):
            total = get(room, i)
            for j in range(k):
                total = fma(-get(room, J + j * d + i), get(room, R + j), total)
            put(room, i, total)
        for w in range(min({width}, last - lane)):
            for i in range(d):
                z[lane + w, i] = room[i, w]
'''


def source(width: int) -> str:
    """The text of the projection of so many states at once."""
    one = width == 1
    return SOURCE.format(
        width=width,
        reading="" if one else "from kreisel.engines.vector_type import load, store\n",
        get="room[row, 0]" if one else f"load(room, row, 1, {width})[0]",
        put="room[row, 0] = value" if one else "store(room, row, (value,))",
        numbers=NUMBERS,
        tau=TAU,
        flat=FLAT,
        eps=float(np.finfo(np.float64).eps),
    )


NUMBERS = 18  # in the table
FAR = 1e3  # times what a random walk of rounding errors makes of a state of size 1 that turns by a radian in a step
INTERVALS = tuple(int(m * 10**e) for e in range(2, 12) for m in (1, 2, 5))
SHARE = 0.01  # of an operation of a step: with it projections take 1 to 3 % of the time, measured for n = 3, 5, 10


def interval(cost: float, work: float) -> int:
    """K: the first of 100, 200, 500, ... steps between two projections that makes them a small share of the time."""
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
    """And every `often` steps a projection."""

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


class Projection:
    """The projection of a scheme at work: what it takes beside the state, for rows z (lanes, d).

    `targets` are the values of the invariants at the start, in two doubles each, and the size of their terms; `worst`
    the largest correction of each yet, as a distance in state space in units of eps_machine |z|.
    """

    def __init__(self, program: Program, every: int, z: Floats, constants: Floats, width: int):
        from kreisel.engines.cpu import load

        self.program, self.every, self.done = program, every, 0
        self.targets = np.zeros((len(z), len(program.outs), 3))
        self.worst = np.zeros((len(z), len(program.outs)))
        self._room, self._project, self._lanes = program.rows * width, load(source(width)).project, len(z)
        sizes = [*z.shape, constants.shape[1], len(program.outs), len(program.columns), len(program.literals)]
        self._held = (*program.arrays, self.targets, self.worst, z, constants)  # as long as their addresses are used
        addresses = [array.ctypes.data for array in self._held]
        self._table = np.array([*sizes, len(program.ops), len(program.cones), *addresses], dtype=np.int64)
        self._call(1)

    @property
    def weave(self) -> Woven:
        """How it is written into a kernel."""
        return Woven(self._room)

    @property
    def arguments(self) -> tuple[int, ...]:
        """What a kernel takes for it."""
        return self.done, self.every, self._project.address, self._table.ctypes.data

    def _call(self, begin: int) -> None:
        room = np.zeros(self._room)
        self._project.ctypes(self._table.ctypes.data, room.ctypes.data, 0, self._lanes, begin)

    def apply(self) -> None:
        """Project the state, in place."""
        self._call(0)

    def final(self) -> Floats:
        """`worst` with what the state lacks at this moment; nothing changes."""
        z, worst = self._held[-2].copy(), self.worst.copy()
        self._call(0)
        found = self.worst.copy()
        self._held[-2][:], self.worst[:] = z, worst
        return found

    def beyond(self, worst: Floats, dt: float) -> Array:
        """Which corrections (lanes, invariants) are more than roundings of `every` steps can explain."""
        turn = dt * abs(self._held[-2]).max(-1, keepdims=True)  # about the angle of a step
        return worst > FAR * np.sqrt(self.every) * (1 + turn)

    def names(self, worst: Floats, dt: float) -> str:
        """The invariant whose correction is the worst of those."""
        place = int(np.where(self.beyond(worst, dt), worst, 0).argmax())
        return self.program.labels[place % len(self.program.labels)]

    def corrections(self) -> dict[str, float]:
        """The largest correction of each variable, at the end of a run."""
        out: dict[str, float] = {}
        for label, value in zip(self.program.labels, self.final().max(0), strict=True):
            name = label.partition("[")[0]
            out[name] = max(out.get(name, 0.0), float(value))
        return out

    def count(self, steps: int) -> None:
        """So many steps were made."""
        self.done = (self.done + steps) % self.every

    def snapshot(self) -> dict[str, Floats]:
        """All that the next steps depend on."""
        return {"targets": self.targets, "worst": self.worst, "done": np.array(float(self.done))}

    def restore(self, snapshot: Mapping[str, Floats]) -> None:
        """Go on from a snapshot."""
        self.targets[:], self.worst[:] = snapshot["targets"], snapshot["worst"]
        self.done = int(snapshot["done"])
