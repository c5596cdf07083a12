"""Invariants that a scheme conserves, recorded as operations on registers, and which of them are enough.

They are the Casimirs, integrals and momenta of symmetries by their definitions in the record; some are redundant.
They are recorded once for a system and n; `kreisel.graph.project` corrects states by them.
"""

from __future__ import annotations

import hashlib
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.errors import ConservationWarning
from kreisel.graph import graph as ops
from kreisel.graph.graph import Graph, Number, Operand, TooLong, depending, operands_of
from kreisel.graph.recording import recorded_arguments
from kreisel.kernels.layout import Floats
from kreisel.method.scheme import ORIENTATION, Scheme

MOST_N, MOST_NODES = 10, 120_000  # beyond, `kreisel.kernels.projection`: recording needs seconds
MOST_STRAIGHT = 28_000  # instructions of a projection that is written out; it is then compiled in less than 2 s
STRAIGHT = 0.3  # of the time of a multiplication that one of them needs
MOST_CHOSEN = 6000  # operations of all gradients, up to which redundant invariants are left out
SAMPLES, INDEPENDENT = 256, 1e-7
MOST_WEIGHT = 10.0  # of the gradients, of length 1, of the others, in that of an invariant that is left out
ADD, SUBTRACT, MULTIPLY, DIVIDE, ROOT = range(5)
OPERATIONS = {ops.PLUS: ADD, ops.MINUS: SUBTRACT, ops.TIMES: MULTIPLY, ops.OVER: DIVIDE, ops.SQRT: ROOT}
APPLIED: list[Callable[..., Array]] = [np.add, np.subtract, np.multiply, np.divide, lambda x, y: np.sqrt(x)]
FIRST = (0.0, 1.0, -1.0)  # of the literals
Result = TypeVar("Result")


@dataclass(frozen=True)
class Program:
    """Invariants as operations on registers: z, then constants, then literals (`FIRST` first), then the results.

    labels   of the invariants as a user knows them
    size     of the state; `first`: the first number of it that may change
    parts    (first, last) of its components, if their units are unlike and each changes in proportion to its size
    ops      (L, 4): the registers of both operands, and where the slopes of the result in each of them are
    runs     (R, 3): an operation, and from which place to which it is done: the same as many times on end as possible
    outs     the registers of the invariants
    cones    the operations that each invariant depends on and that depend on z, the last one first
    ends     (k + 1,): where the cone of each begins, and the end of the last one
    columns  of the constants
    """

    labels: tuple[str, ...]
    size: int
    ops: np.ndarray
    runs: np.ndarray
    outs: np.ndarray
    cones: np.ndarray
    ends: np.ndarray
    columns: np.ndarray
    literals: Floats
    first: int = 0
    parts: tuple[tuple[int, int], ...] = ()

    @property
    def form(self) -> tuple[bool, tuple[tuple[int, int], ...]]:
        """All of it on which the code for its tables depends: whether it binds an orientation, and its parts."""
        return self.first > 0, self.parts

    @property
    def base(self) -> int:
        """The register of the first result."""
        return self.size + len(self.columns) + len(self.literals)

    @property
    def rows(self) -> int:
        """Numbers that a projection of one state needs as room."""
        room = _room(self.base + len(self.ops), len(self.outs), self.size)
        return max(room, 1 + int(self.ops[:, 2:].max(initial=0)))

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

    @property
    def tables(self) -> tuple[np.ndarray, ...]:
        """All integers of it, the sizes first."""
        counts = [len(array) for array in (self.outs, self.columns, self.literals, self.ops, self.runs)]
        return (
            np.array([self.size, *counts, self.first]),
            self.ops,
            self.runs,
            self.outs,
            self.ends,
            self.cones,
            self.columns,
        )

    @property
    def digest(self) -> str:
        """SHA-256 of all values."""
        arrays = *self.tables, self.literals, np.array(self.parts)
        return hashlib.sha256(b"".join(np.ascontiguousarray(array).tobytes() for array in arrays)).hexdigest()


def written_out(programs: Sequence[Program]) -> bool:
    """Whether the projection by these programs is."""
    return sum(program.instructions for program in programs) <= MOST_STRAIGHT


def cost_of(programs: Sequence[Program]) -> float:
    """About how many multiplications the projection by these programs needs as long as."""
    if written_out(programs):
        return STRAIGHT * sum(program.instructions for program in programs)
    return sum(program.cost for program in programs)


def _room(registers: int, invariants: int, size: int) -> int:
    return 3 * registers + invariants * (size + invariants + 6)


def recordable(make: Callable[[], Result | None], numbers: str = "recorded numbers") -> Result | None:
    """The result of `make`; None, with a warning, if a user-defined integral does not accept such scalars."""
    try:
        return make()
    except TooLong:
        raise
    except Exception as error:  # whatever a function that expects arrays of NumPy makes of others
        warnings.warn(
            "Round-off adds up in this run, which is not projected: expected integrals of +, -, *, /, square roots and "
            f"products of arrays, got one that does not accept {numbers} ({error}). project=False leaves the "
            f"projection out.",
            ConservationWarning,
            stacklevel=2,
        )
        return None


def program_of_orientation(scheme: Scheme) -> Program | None:
    """Bonds of an orientation to the state, of which only the orientation changes; None if there are none."""
    if scheme.held is None:
        return None
    graph = Graph()
    parts, _ = recorded_arguments(scheme, graph, {})
    entries = [entry for value in scheme.held(parts) for entry in np.ravel(value)]
    sizes = [algebra.KINDS[kind].count(scheme.n) for _, kind in scheme.components]
    first = [letter for letter, _ in scheme.components].index(ORIENTATION)
    labels = {entry.at: ORIENTATION for entry in entries if isinstance(entry, Number)}
    program = _program(graph, sum(sizes), labels)
    return None if program is None else replace(program, first=sum(sizes[:first]))


def program_of(
    scheme: Scheme,
    columns: Mapping[str, slice],
    function: Callable[..., Mapping[str, Array]] | None = None,
    members: Mapping[str, Array] | None = None,
) -> Program | None:
    """The invariants that a scheme conserves, recorded; None if there is nothing to project.

    By another `function` than its `observe`, and only these `members` of each family.  Raises `TooLong`.
    """
    graph = Graph(most=MOST_NODES)
    parts, constants = recorded_arguments(scheme, graph, {"c": columns})
    size = algebra.coordinate_count(scheme.kinds, scheme.n)
    outputs = (function or scheme.observe)(parts, **constants)
    varying = depending(graph, range(len(graph.nodes)), "z".__eq__)
    labels: dict[int, str] = {}  # by the node, without constant factors and logarithms
    for name, value in outputs.items():
        if not scheme.outcomes[name].conserved:
            continue
        entries = np.asarray(value, dtype=object)
        for place, entry in enumerate(entries.flat):
            if isinstance(entry, Number) and (members is None or place in members.get(name, ())):
                plain = _without_factors(entry, varying)
                if isinstance(plain, Number):
                    label = f"{name}[{place}]" if entries.ndim else name
                    labels.setdefault(_without_logarithms(plain, varying).at, label)
    program = _program(graph, size, labels)
    if program is not None and len(program.cones) <= MOST_CHOSEN:
        enough = _enough(program)
        program = _program(graph, size, {at: label for at, label in labels.items() if label in enough})
    places = algebra.slices(scheme.kinds, scheme.n) if scheme.unlike else []
    return program and replace(program, parts=tuple((place.start, place.stop) for place in places))


def _without_factors(x: Operand, varying: set[int]) -> Operand:
    """x of c x, c constant: where c x is conserved for every c, so is x."""
    while isinstance(x, Number):
        operation, *operands = x.node
        changing = [y for y in operands if isinstance(y, Number) and y.at in varying]
        if operation == ops.TIMES and len(changing) == 1:
            x = changing[0]
        elif operation == ops.OVER and not (isinstance(operands[1], Number) and operands[1].at in varying):
            x = operands[0]
        else:
            break
    return x


def _without_logarithms(x: Number, varying: set[int]) -> Number:
    """x y/z of log x + log y - log z + const: where that is conserved, so is the product.

    There are no logarithms in double-double.  Any other sum is unchanged.
    """
    product: Any = 1
    terms: list[tuple[Operand, int]] = [(x, 1)]
    while terms:
        term, power = terms.pop()
        if not isinstance(term, Number) or term.at not in varying:
            continue
        operation, *operands = term.node
        if operation in (ops.PLUS, ops.MINUS):
            terms += [(operands[1], power if operation == ops.PLUS else -power), (operands[0], power)]
        elif operation == "log":
            factor = operands[0].positive  # its sign is constant
            product = product * factor if power > 0 else product / factor
        else:
            return x
    return product if isinstance(product, Number) else x


def _program(graph: Graph, size: int, labels: Mapping[int, str]) -> Program | None:
    """The program of nodes with labels; None if none of them depends on the state."""
    needed = graph.needed([Number(graph, at) for at in labels])
    varying = depending(graph, needed, "z".__eq__)
    chosen = [at for at in labels if at in varying]
    if not chosen:
        return None
    columns = sorted(node[2] for at in needed if (node := graph.nodes[at])[:2] == (ops.IN, "c"))
    order, runs = _in_runs(graph, [at for at in needed if graph.nodes[at][0] != ops.IN])
    nodes = [graph.nodes[at] for at in order]
    others = {x for node in nodes for x in node[1:] if not isinstance(x, Number)} - {*FIRST}
    literals, start = [*FIRST, *sorted(others)], size + len(columns)
    base = start + len(literals)
    registers: dict[Any, int] = {x: start + i for i, x in enumerate(literals)}  # by the literal or the node's place
    for at in needed:
        operation, *place = graph.nodes[at]
        if operation == ops.IN:
            registers["node", at] = place[1] if place[0] == "z" else size + columns.index(place[1])
    registers |= {("node", at): base + i for i, at in enumerate(order)}
    cones = []
    for at in chosen:
        wanted, cone = {at}, []
        for i in reversed(range(len(order))):
            if order[i] in wanted and order[i] in varying:
                wanted.update(x.at for x in operands_of(graph.nodes[order[i]]))
                cone.append(i)
        cones.append(cone)
    return Program(
        labels=tuple(labels[at] for at in chosen),
        size=size,
        ops=_ops(nodes, registers, _room(base + len(order), len(chosen), size)),
        runs=runs,
        outs=np.array([registers["node", at] for at in chosen]),
        cones=np.array([i for cone in cones for i in cone], dtype=np.int64),
        ends=np.cumsum([0, *map(len, cones)]),
        columns=np.array(columns, dtype=np.int64),
        literals=np.array(literals),
    )


def _kind(operation: str, *operands: Operand) -> int:
    """The place of an operation in `OPERATIONS`."""
    if operation == "log":  # not in two doubles: by arrays
        raise TooLong
    if operation not in OPERATIONS or (operation == ops.SQRT and operands[0].negative):
        raise TypeError(f"{operation} is not known in two doubles")
    return OPERATIONS[operation]


def _in_runs(graph: Graph, nodes: Sequence[int]) -> tuple[list[int], np.ndarray]:
    """The nodes in an order in which the same operation is done many times on end, and `Program.runs`."""
    kinds = {at: _kind(*graph.nodes[at]) for at in nodes}
    waiting: dict[int, int] = {}
    followers: dict[int, list[int]] = {at: [] for at in nodes}
    ready: list[list[int]] = [[] for _ in OPERATIONS]
    for at in nodes:
        needs = {x.at for x in operands_of(graph.nodes[at]) if x.at in kinds}
        waiting[at] = len(needs)
        for x in needs:
            followers[x].append(at)
        if not needs:
            ready[kinds[at]].append(at)
    order: list[int] = []
    runs: list[tuple[int, int, int]] = []
    while len(order) < len(nodes):
        kind = max(range(len(ready)), key=lambda operation: len(ready[operation]))
        queue, start = ready[kind], len(order)
        for at in queue:  # grows
            order.append(at)
            for x in followers[at]:
                waiting[x] -= 1
                if waiting[x] == 0:
                    ready[kinds[x]].append(x)
        ready[kind] = []
        runs.append((kind, start, len(order)))
    return order, np.array(runs, dtype=np.int64).reshape(-1, 3)


def _ops(nodes: Sequence[Any], registers: Mapping[Any, int], free: int) -> np.ndarray:
    """`Program.ops`; slopes that are no register are written to the rows from `free` on."""
    zero, unit, minus = (registers[number] for number in FIRST)
    out = []
    for operation, *operands in nodes:
        x, y = (registers[("node", v.at) if isinstance(v, Number) else v] for v in (operands[0], operands[-1]))
        slopes = {ops.PLUS: (unit, unit), ops.MINUS: (unit, minus), ops.TIMES: (y, x)}.get(operation)
        if slopes is None:
            slopes = free, free + 1 if operation == ops.OVER else zero
            free += 2
        out.append((x, y, *slopes))
    return np.array(out, dtype=np.int64).reshape(-1, 4)


def _enough(program: Program) -> set[str]:
    """Labels of invariants, short ones first, whose gradients span those of all, degenerate states included.

    Looked for at states and constants of 0, 1, -1 and at random ones.  For the Lagrange top, n = 3: 5 of 11.
    """
    rng = np.random.default_rng(0)
    x = rng.normal(size=(SAMPLES, program.base + len(program.ops)))
    x[: SAMPLES // 2] *= rng.random((SAMPLES // 2, 1)) < rng.random((SAMPLES // 2, x.shape[1]))
    x[: SAMPLES // 4] = np.sign(x[: SAMPLES // 4])
    J = gradients(program, x)
    finite = np.isfinite(J).all((1, 2))
    generic, J = finite[finite].cumsum() > finite[: SAMPLES // 4].sum(), J[finite]
    length = np.sqrt((J * J).sum(-1, keepdims=True))
    J = np.where(length > INDEPENDENT, J / np.maximum(length, INDEPENDENT), 0)  # or 0 but for rounding
    spanned = np.zeros((len(J), J.shape[-1], J.shape[-1]))
    chosen = []
    lengths = np.diff(program.ends)
    for j in np.argsort(lengths, kind="stable").tolist():
        beyond = J[:, j]
        for _ in range(2):
            beyond = beyond - (spanned @ beyond[..., None])[..., 0]
        size = np.sqrt((beyond * beyond).sum(-1))
        new = size > INDEPENDENT
        if new.any():
            chosen.append(j)
            u = np.where(new[:, None], beyond / np.where(new, size, 1)[:, None], 0)
            spanned += u[:, :, None] * u[:, None, :]
    left = [j for j in range(len(lengths)) if j not in chosen]
    while left and generic.any():  # those that the others determine to few digits only
        weights = J[generic][:, left] @ np.linalg.pinv(J[generic][:, chosen], rcond=INDEPENDENT)
        sizes = np.median(np.sqrt((weights * weights).sum(-1)), 0)
        if sizes.max() < MOST_WEIGHT:
            break
        chosen.append(left.pop(int(sizes.argmax())))
    return {program.labels[j] for j in chosen}


def gradients(program: Program, x: Floats) -> Array:
    """dI/dz (samples, invariants, d) at z and constants (samples, registers); other columns are not read."""
    d, base, ops = program.size, program.base, program.ops.tolist()
    room, slope = np.zeros((program.rows, len(x))), np.zeros((base + len(ops), len(x)))
    out = np.empty((len(program.outs), d, len(x)))
    room[: base - len(program.literals)] = x.T[: base - len(program.literals)]
    room[base - len(program.literals) : base] = program.literals[:, None]
    kinds = np.repeat(program.runs[:, 0], np.diff(program.runs[:, 1:]).ravel()).tolist()
    with np.errstate(all="ignore"):
        for i, (kind, (a, b, left, right)) in enumerate(zip(kinds, ops, strict=True)):
            room[base + i] = value = APPLIED[kind](room[a], room[b])
            if kind == DIVIDE:
                room[left], room[right] = 1 / room[b], -value / room[b]
            elif kind == ROOT:
                room[left] = 0.5 / value
        for j, result in enumerate(program.outs.tolist()):
            slope[:] = 0
            slope[result] = 1
            for i in program.cones[program.ends[j] : program.ends[j + 1]].tolist():
                a, b, left, right = ops[i]
                slope[a] += room[left] * slope[base + i]
                slope[b] += room[right] * slope[base + i]
            out[j] = slope[:d]
    return out.transpose(2, 0, 1)
