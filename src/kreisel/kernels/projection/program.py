"""Round-off, in one place: every K steps the state goes back to the values that its invariants had at the start.

    r = I(z) - I(z_0)                           in double-double
    J = dI/dz                                   in double, by a reverse sweep
    d <- d + g (r - r_0 - d)                    r_0 of just after the last projection: the mean drift in K steps
    z <- z - J^T (J J^T + tau)^-1 (r + d/2)     one step of Gauss and Newton; rows of J, and r with them, of length 1

Rounding errors have a mean, and so I drifts.  By d/2 the mean of I over an interval, and not its start, is I(z_0): else
the frequencies would be off by d/2, and the phase by that times N.  g = 1/16, 1/64 where K is short: a mean of few
intervals is as uncertain as their random walks, which 7 ulp at n = 3 and K = 1250 showed.

I are the Casimirs, integrals and momenta of symmetries that the method conserves, by their definitions in the record,
redundant as they stand.  They are recorded once for a system and n, as a list of operations (`Program`), which is
written out as compiled code or which such code goes through, with the same bits, for one state or for a vector of
lanes; a lane has the bits of a state on its own.  K counts from step 0 of a trajectory, so the bits do not depend on
`every`, nor on where a run was interrupted.

A correction is of the size of rounding errors, or the map does not conserve what it claims: the largest one is kept.
[Hairer, Lubich, Wanner, Geometric Numerical Integration, section IV.4]
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.errors import ConservationWarning
from kreisel.kernels.layout import Floats
from kreisel.kernels.printing import Line, operation
from kreisel.kernels.recording import recorded_arguments
from kreisel.kernels.tape import Scalar, Tape, TooLong
from kreisel.method.observing import ORIENTATION
from kreisel.method.scheme import Scheme

MOST_N, MOST_LINES = 10, 120_000  # beyond, `kreisel.kernels.projection.arrays`: recording takes seconds
MOST_STRAIGHT = 28_000  # instructions of a projection that is written out; it is then compiled in less than 2 s
STRAIGHT = 0.3  # of the time of a multiplication that one of them takes
MOST_CHOSEN = 6000  # operations of all gradients, up to which redundant invariants are left out
SAMPLES, INDEPENDENT = 256, 1e-7
MOST_WEIGHT = 10.0  # of the gradients, of length 1, of the others, in that of an invariant that is left out
OPERATIONS = {"+": 0, "-": 1, "*": 2, "/": 3, "sqrt": 4}
APPLIED: list[Callable[..., Array]] = [np.add, np.subtract, np.multiply, np.divide, lambda x, y: np.sqrt(x)]
SLOPES: list[Callable[..., tuple[Any, Any]]] = [  # of x o y = v
    lambda x, y, v: (1, 1),
    lambda x, y, v: (1, -1),
    lambda x, y, v: (y, x),
    lambda x, y, v: (1 / y, -v / y),
    lambda x, y, v: (0.5 / v, 0),
]
FIRST = ("0.0", "1.0", "-1.0")
Made = TypeVar("Made")
ROOT, LOG = re.compile(r"sqrt\((\w+)\)"), re.compile(r"log\((-?)(\w+)\)")


@dataclass(frozen=True)
class Program:
    """Invariants as operations on registers: z, then constants, then literals (0, 1 and -1 first), then the results.

    names    of the invariants as recorded, and `labels` as a user knows them
    ops      (L, 4): the registers of both operands, and where the slopes of the result in each of them stand
    runs     (R, 2): what is done (`OPERATIONS`), and up to which operation: the same for as many as possible
    outs     the registers of the invariants
    first    the first number of z that may change
    cones    the operations that each invariant depends on and that depend on z, the last one first; `ends` of each
    """

    names: tuple[str, ...]
    labels: tuple[str, ...]
    size: int
    ops: np.ndarray
    runs: np.ndarray
    outs: np.ndarray
    cones: np.ndarray
    ends: np.ndarray
    literals: Floats
    columns: np.ndarray
    first: int = 0

    @property
    def registers(self) -> int:
        """How many there are."""
        return self.size + len(self.columns) + len(self.literals) + len(self.ops)

    @property
    def rows(self) -> int:
        """Numbers that a projection of one state needs as room."""
        return max(_room(self.registers, len(self.outs), self.size), 1 + int(self.ops[:, 2:].max(initial=0)))

    def sizes(self, lanes: int, constants: int) -> tuple[int, ...]:
        """How many there are of all that compiled code looks at, and `first`."""
        used, known = len(self.columns), len(self.literals)
        return self.size, len(self.outs), lanes, constants, used, known, len(self.ops), len(self.runs), self.first

    @property
    def cost(self) -> float:
        """About how many multiplications a projection is."""
        k, d = len(self.outs), self.size
        return 12 * len(self.ops) + 4 * len(self.cones) + k * k * d / 2 + k**3 / 6

    @property
    def instructions(self) -> float:
        """About how many a projection is that is written out."""
        k, d = len(self.outs), self.size
        return 9 * len(self.ops) + 2 * len(self.cones) + k * k * d / 2 + k**3 / 6 + 25 * k

    def operations(self) -> list[tuple[int, int, int]]:
        """(what is done, and the registers of both operands) of each."""
        kinds = np.repeat(self.runs[:, 0], np.diff(self.runs[:, 1], prepend=0)).tolist()
        return [(what, x, y) for what, (x, y, *_) in zip(kinds, self.ops.tolist(), strict=True)]

    @property
    def arrays(self) -> tuple[np.ndarray, ...]:
        """All numbers of it."""
        return self.ops, self.runs, self.outs, self.ends, self.cones, self.columns, self.literals


def written_out(programs: Sequence[Program]) -> bool:
    """Whether the projection by these programs is."""
    return sum(program.instructions for program in programs) <= MOST_STRAIGHT


def cost_of(programs: Sequence[Program]) -> float:
    """About how many multiplications the projection by these programs takes as long as."""
    if written_out(programs):
        return STRAIGHT * sum(program.instructions for program in programs)
    return sum(program.cost for program in programs)


def _room(registers: int, invariants: int, size: int) -> int:
    """Numbers that a projection needs as room, without slopes."""
    return 3 * registers + invariants * (size + invariants + 6)


def recordable(make: Callable[[], Made | None], numbers: str = "recorded numbers") -> Made | None:
    """What `make` gives; None, with a warning, where an integral of a user's own does not take such numbers."""
    try:
        return make()
    except TooLong:
        raise
    except Exception as error:  # whatever a function that expects arrays of NumPy makes of others
        warnings.warn(
            "Round-off adds up in this run, which is not projected: expected integrals of +, -, *, /, square roots and "
            f"products of arrays, got one that takes no {numbers} ({error}). project=False says so.",
            ConservationWarning,
            stacklevel=2,
        )
        return None


def program_of_orientation(scheme: Scheme) -> Program | None:
    """What binds an orientation to the state, of which the orientation alone gives way; None where there is none."""
    if scheme.held is None:
        return None
    tape = Tape()
    parts, _ = recorded_arguments(scheme, tape, {})
    entries = [entry for value in scheme.held(parts) for entry in np.ravel(value)]
    sizes = [algebra.KINDS[kind].count(scheme.n) for _, kind in scheme.components]
    first = [letter for letter, _ in scheme.components].index(ORIENTATION)
    program = _program(tape, {entry.name: ORIENTATION for entry in entries if isinstance(entry, Scalar)}, sum(sizes))
    return None if program is None else replace(program, first=sum(sizes[:first]))


def program_of(
    scheme: Scheme,
    columns: Mapping[str, slice],
    function: Callable[..., Mapping[str, Array]] | None = None,
    members: Mapping[str, Array] | None = None,
) -> Program | None:
    """The invariants that a scheme conserves, on recorded numbers; None where there is nothing to project.

    By another `function` than its `observe`, and only these `members` of each family.  Raises `TooLong`.
    """
    tape = Tape(most=MOST_LINES)
    parts, known = recorded_arguments(scheme, tape, {"c": columns})
    size = algebra.coordinate_count(scheme.kinds, scheme.n)
    found: dict[str, str] = {}  # by the recorded name, without constant factors and logarithms
    outputs = (function or scheme.observe)(parts, **known)
    lines, varying = {line.names[0]: line for line in tape.lines}, _varying(tape.lines, size)
    for name, value in outputs.items():
        if not scheme.outcomes[name].conserved:
            continue
        entries = np.asarray(value, dtype=object)
        for place, entry in enumerate(entries.flat):
            if isinstance(entry, Scalar) and (members is None or place in members.get(name, ())):
                label = f"{name}[{place}]" if entries.ndim else name
                plain = _without_factors(lines, varying, entry.name)
                found.setdefault(_without_logarithms(tape, lines, varying, plain), label)
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


def _without_factors(lines: Mapping[str, Line], varying: set[str], name: str) -> str:
    """The name of x for c x, c constant: where c x is conserved for every c, so is x."""
    while name in lines:
        x, what, y = operation(lines[name])
        if what == "*" and (x in varying) != (y in varying):
            name = x if x in varying else y
        elif what == "/" and y not in varying:
            name = x
        else:
            break
    return name


def _without_logarithms(tape: Tape, lines: Mapping[str, Line], varying: set[str], name: str) -> str:
    """The name of x y/z for log x + log y - log z + const: where that is conserved, so is the product.

    There are no logarithms in double-double.  Any other sum keeps its name.
    """
    product: Any = 1
    waiting = [(name, 1)]
    while waiting:
        term, power = waiting.pop()
        if term not in varying:
            continue
        line = lines.get(term, Line((term,), "", ()))
        x, what, y = operation(line)
        logarithm = LOG.fullmatch(line.text.partition(" = ")[2])
        if what in ("+", "-"):
            waiting += [(y, power if what == "+" else -power), (x, power)]
        elif logarithm:
            factor = Scalar(tape, logarithm[2])  # its sign is constant
            product = product * factor if power > 0 else product / factor
        else:
            return name
    return product.name if isinstance(product, Scalar) else name


def _program(tape: Tape, found: Mapping[str, str], size: int) -> Program | None:
    lines = tape.needed([*found])
    varying = _varying(lines, size)
    chosen = [name for name in found if name in varying]
    if not chosen:
        return None
    lines, runs = _in_runs(lines)
    words = [_operation_and_operands(line) for line in lines]
    constants = sorted({w for line in lines for w in line.needs if w[0] == "c"}, key=lambda w: int(w[1:]))
    literals = [*FIRST, *sorted({w for _, x, y in words for w in (x, y) if not w[0].isalpha()} - {*FIRST})]
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
        ops=_operands(words, place, _room(len(names), len(chosen), size)),
        runs=runs,
        outs=np.array([place[name] for name in chosen], dtype=np.int32),
        cones=np.array([i for cone in cones for i in cone], dtype=np.int32),
        ends=np.cumsum([len(cone) for cone in cones], dtype=np.int32),
        literals=np.array([np.nan if w.startswith("(") else float(w) for w in literals]),
        columns=np.array([int(w[1:]) for w in constants], dtype=np.int32),
    )


def _in_runs(lines: list[Line]) -> tuple[list[Line], np.ndarray]:
    """The lines in an order in which the same operation is done many times on end, and `runs`."""
    made = {line.names[0]: i for i, line in enumerate(lines)}
    kinds = [OPERATIONS[_operation_and_operands(line)[0]] for line in lines]
    waiting, followers = [0] * len(lines), [[] for _ in lines]  # type: tuple[list[int], list[list[int]]]
    ready: list[list[int]] = [[] for _ in OPERATIONS]
    for i, line in enumerate(lines):
        needs = {made[name] for name in line.needs if name in made}
        waiting[i] = len(needs)
        for j in needs:
            followers[j].append(i)
        if not needs:
            ready[kinds[i]].append(i)
    order: list[Line] = []
    runs: list[tuple[int, int]] = []
    while len(order) < len(lines):
        kind = max(range(len(ready)), key=lambda what: len(ready[what]))
        queue = ready[kind]
        for i in queue:  # grows
            order.append(lines[i])
            for j in followers[i]:
                waiting[j] -= 1
                if waiting[j] == 0:
                    ready[kinds[j]].append(j)
        ready[kind] = []
        runs.append((kind, len(order)))
    return order, np.array(runs, dtype=np.int32).reshape(-1, 2)


def _operands(words: list[tuple[str, str, str]], place: Mapping[str, int], free: int) -> np.ndarray:
    """`ops`; slopes that are no register are written to the rows from `free` on."""
    zero, one, minus = (place[name] for name in FIRST)
    out = []
    for what, x, y in words:
        if what in "/sqrt":
            slopes = free, free + 1 if what == "/" else zero
            free += 2
        else:
            slopes = {"*": (place[y], place[x]), "+": (one, one), "-": (one, minus)}[what]
        out.append((place[x], place[y], *slopes))
    return np.array(out, dtype=np.int32).reshape(-1, 4)


def _enough(program: Program) -> list[str]:
    """The names of invariants, short ones first, whose gradients span those of all of them, degenerate states included.

    Looked for at states and constants of 0, 1, -1 and at random ones.  For the Lagrange top, n = 3: 5 of 11.
    """
    rng = np.random.default_rng(0)
    x = rng.normal(size=(SAMPLES, program.registers))
    x[: SAMPLES // 2] *= rng.random((SAMPLES // 2, 1)) < rng.random((SAMPLES // 2, x.shape[1]))
    x[: SAMPLES // 4] = np.sign(x[: SAMPLES // 4])
    J = _register_gradients(program, x)
    there = np.isfinite(J).all((1, 2))
    generic, J = there[there].cumsum() > there[: SAMPLES // 4].sum(), J[there]
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
    left = [j for j in range(len(lengths)) if j not in chosen]
    while left and generic.any():  # those that the others determine to few digits only
        weights = J[generic][:, left] @ np.linalg.pinv(J[generic][:, chosen], rcond=INDEPENDENT)
        sizes = np.median(np.sqrt((weights * weights).sum(-1)), 0)
        if sizes.max() < MOST_WEIGHT:
            break
        chosen.append(left.pop(int(sizes.argmax())))
    return [program.names[j] for j in sorted(chosen)]


def _register_gradients(program: Program, x: Array) -> Array:
    """dI/dz (samples, invariants, d) for registers x (samples, registers), of which those of results are written."""
    base, d = program.registers - len(program.ops), program.size
    x[:, d + len(program.columns) : base] = program.literals
    with np.errstate(all="ignore"):
        operations = program.operations()
        for i, (what, a, b) in enumerate(operations):
            x[:, base + i] = APPLIED[what](x[:, a], x[:, b])
        out, start = np.zeros((len(x), len(program.outs), d)), 0
        for j, end in enumerate(program.ends.tolist()):
            slope = np.zeros_like(x)
            slope[:, program.outs[j]] = 1
            for i in program.cones[start:end].tolist():
                what, a, b = operations[i]
                left, right = SLOPES[what](x[:, a], x[:, b], x[:, base + i])
                slope[:, a] += left * slope[:, base + i]
                slope[:, b] += right * slope[:, base + i]
            out[:, j], start = slope[:, :d], end
    return out


def _operation_and_operands(line: Line) -> tuple[str, str, str]:
    """(operation, x, y) of a line; x again in place of y where there is one operand."""
    x, what, y = operation(line)
    if what:
        return what, x, y
    root = ROOT.fullmatch(line.text.partition(" = ")[2])
    if root is None and " = log(" in line.text:  # not in two doubles: by arrays
        raise TooLong
    if root is None:
        raise TypeError(f"an invariant with {line.text!r} has no gradient here")
    return "sqrt", root[1], root[1]
