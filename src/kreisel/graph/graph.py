"""Graphs of operations: a definition is run once on `Number`s, and each operation becomes a node.

A node is (operation, operands); an operand is a `Number`, which is a node with a sign, or a float.  Numbers are in
NumPy's object arrays, so formulas run on them as they are.  Foldings are exact in floating point (0, 1, signs, x - x),
so a graph with values put in for some inputs computes the same as one without.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Container, Iterable, Mapping, Sequence
from fractions import Fraction
from typing import Any, NamedTuple

import numpy as np

from kreisel.algebra.backend import Ring
from kreisel.algebra.iteration import entry
from kreisel.algebra.recorded import POWER, NotRecorded, Recorded

# Operations: arithmetic; MAX (x unless y > x), SIGN (-1 where x < 0, else 1), SIZE (|x|), NEAREST (the
# integer next to x, of two the even one) and WHERE (of x, y, a, b: a where x < y, else b).
# ENTRY (address, row, last, column, stride): the entry of a table in memory (`kreisel.algebra.iteration`).
PLUS, MINUS, TIMES, OVER, FMA, SQRT, MAX, SIGN = "+", "-", "*", "/", "fma", "sqrt", "max", "sign"
SIZE, NEAREST, WHERE, ENTRY = "size", "nearest", "where", "entry"
TRANSCENDENTAL = ("sin", "cos", "exp", "log")
# Inputs (letter, index); a loop (its place in `Graph.loops`, start values, outer operands), a variable of its body, and
# a result (loop or branch, index); a branch (its place in `Graph.branches`, test, values without it, outer operands).
IN, LOOP, VARIABLE, RESULT, BRANCH = "in", "loop", "variable", "result", "branch"

NEVER = -1.0  # `small` of a loop that always ends after `most` times

Node = tuple[Any, ...]
Operand = Any  # a Number or a float


class TooLong(Exception):
    """More nodes than a graph may have."""


class Loop(NamedTuple):
    """x, defect = body(x), until defect <= small, at most `most` times.

    variables  x, as the body has it
    body       the nodes that depend on x, in order
    new        x after the body, and the defect
    """

    variables: tuple[Number, ...]
    body: tuple[int, ...]
    new: tuple[Operand, ...]
    small: float
    most: int


class Branch(NamedTuple):
    """Values `new` of the nodes `body`, which are computed only if a test is positive, of a vector somewhere."""

    body: tuple[int, ...]
    new: tuple[Operand, ...]


class Graph:
    """Nodes, each made once.  Raises `TooLong` beyond `most` nodes."""

    def __init__(self, most: float = math.inf) -> None:
        self.nodes: list[Node] = []
        self.loops: list[Loop] = []
        self.branches: list[Branch] = []
        self._index: dict[Node, int] = {}
        self._most = most
        self._inside: set[int] | None = None  # the nodes of an open loop

    def node(self, operation: str, *operands: Operand) -> int:
        """The place of a node."""
        key = _key(operation, operands)
        at = self._index.get(key)
        return self._added((operation, *operands), key) if at is None else at

    def _added(self, node: Node, key: Node | None = None) -> int:
        at = self._index[key or _key(node[0], node[1:])] = len(self.nodes)
        self.nodes.append(node)
        if at > self._most:
            raise TooLong
        if self._inside is not None and not self._inside.isdisjoint(x.at for x in operands_of(node)):
            self._inside.add(at)
        return at

    def _forget(self, members: Iterable[int]) -> None:
        """Later operations do not find these nodes, which are inside a body."""
        for at in members:
            operation, *operands = self.nodes[at]
            self._index.pop(_key(operation, operands), None)

    def has(self, operation: str, *operands: Operand) -> bool:
        """Whether there is such a node."""
        return _key(operation, operands) in self._index

    def input(self, letter: str, index: int) -> Number:
        """The input of that letter and index."""
        return Number(self, self.node(IN, letter, index))

    def inputs(self, letter: str, count: int, first: int = 0) -> Any:
        """Inputs of a letter, in order, as an array (count,)."""
        return array_of([self.input(letter, i) for i in range(first, first + count)])

    def loop(
        self,
        body: Callable[[list[Number]], tuple[Sequence[Operand], Operand]],
        start: Sequence[Operand],
        small: float,
        most: int,
    ) -> tuple[list[Number], Number]:
        """Record `Loop` from `start`: the last x and the last defect.  The body is recorded once."""
        if self._inside is not None:
            raise TypeError("a loop within a loop cannot be recorded")
        place = len(self.loops)
        variables = [Number(self, self._added((VARIABLE, place, i))) for i in range(len(start))]
        self._inside = {x.at for x in variables}
        try:
            values, defect = body(variables)
            inside = self._inside
        finally:
            self._inside = None
        self._forget(inside)
        new = (*values, defect)
        members = tuple(sorted(inside - {x.at for x in variables}))
        self.loops.append(Loop(tuple(variables), members, new, small, most))
        loop = Number(self, self._added((LOOP, place, *start, *self._outer(members, new, inside))))
        results = [Number(self, self._added((RESULT, loop, i))) for i in range(len(new))]
        return results[:-1], results[-1]

    def repeat(
        self, body: Callable[[list[Any]], Sequence[Any]], start: Sequence[Operand], small: float, most: int
    ) -> list[Operand]:
        """The loop with the arguments and the result of `looped`."""
        x, defect = self.loop(lambda variables: ((new := body(variables))[:-1], new[-1]), start, small, most)
        return [*x, defect]

    def copy(
        self, graph: Graph, outputs: Sequence[Operand], inputs: Callable[[str, int], Any] | None = None
    ) -> list[Operand]:
        """The outputs of a graph, recorded in this one, of inputs(letter, index)."""
        return evaluated(graph, outputs, inputs or self.input, APPLIED | {LOOP: self.repeat})

    def for_rows(self, body: Callable[..., Any], rows: Sequence[Sequence[float]]) -> list[Any]:
        """body(*row) for rows of constants, written out."""
        return [body(*map(float, row)) for row in rows]

    def times(self, body: Callable[[list[Any]], Sequence[Any]], start: Sequence[Any], count: int) -> Sequence[Any]:
        """The result of `count` applications of the body to `start`, written out."""
        for _ in range(count):
            start = body([*start])
        return start

    def branch(self, test: Number, body: Callable[[], Sequence[Operand]], values: Sequence[Operand]) -> list[Number]:
        """Record `Branch`: body() if test > 0, of a vector somewhere, else `values`."""
        first = len(self.nodes)
        new = tuple(body())
        members = range(first, len(self.nodes))
        self._forget(members)
        place = len(self.branches)
        self.branches.append(Branch(tuple(members), new))
        branch = Number(self, self._added((BRANCH, place, test, *values, *self._outer(members, new, members))))
        return [Number(self, self._added((RESULT, branch, i))) for i in range(len(new))]

    def _outer(self, members: Iterable[int], new: Iterable[Operand], inside: Container[int]) -> list[Number]:
        reads = [x for at in members for x in operands_of(self.nodes[at])] + [x for x in new if isinstance(x, Number)]
        return list({x.at: x.positive for x in reads if x.at not in inside}.values())

    def body_of(self, at: int) -> Loop | Branch | None:
        """The body of a node that is a loop or a branch; None for another one."""
        operation, *operands = self.nodes[at]
        bodies: dict[str, Sequence[Loop | Branch]] = {LOOP: self.loops, BRANCH: self.branches}
        return bodies[operation][operands[0]] if operation in bodies else None

    def needed(self, outputs: Iterable[Operand], members: Container[int] | None = None) -> list[int]:
        """The nodes that the outputs depend on, in order, of all or of those in `members`; not those inside loops."""
        nodes, reached = self.nodes, set[int]()
        waiting = [x.at for x in outputs if isinstance(x, Number)]
        while waiting:
            at = waiting.pop()
            if at not in reached and (members is None or at in members):
                reached.add(at)
                for x in nodes[at]:
                    if type(x) is Number and x.at not in reached:
                        waiting.append(x.at)
        return sorted(reached)

    def needed_inside(self, body: Loop | Branch) -> list[int]:
        """The nodes of a body that its results depend on, in order."""
        return self.needed(body.new, frozenset(body.body))

    def digest(self, outputs: Sequence[Any]) -> str:
        """SHA-256 of the operations that the outputs depend on, in whatever order they were recorded.

        Texts may be among the outputs.
        """
        digests = dict[int, str]()

        def text(x: Any) -> str:
            if isinstance(x, Number):
                return f"{'-' * x.negative}{digests[x.at]}"
            return x.hex() if isinstance(x, float) else repr(x)

        def add(at: int) -> None:
            operation, *operands = self.nodes[at]
            inner = self.body_of(at)
            if inner is not None:
                variables = inner.variables if isinstance(inner, Loop) else ()
                digests.update({x.at: f"variable {i}" for i, x in enumerate(variables)})
                for member in self.needed_inside(inner):
                    add(member)
                settings = [inner.small, inner.most] if isinstance(inner, Loop) else []
                operands = [*settings, *inner.new, *operands[1 : 1 + len(variables or (None, *inner.new))]]
            texts = sorted(map(text, operands)) if operation in (PLUS, TIMES) else [*map(text, operands)]
            digests[at] = sealed([operation, *texts])

        def sealed(texts: Iterable[str]) -> str:
            return hashlib.sha256(" ".join(texts).encode()).hexdigest()

        for at in self.needed(outputs):
            add(at)
        return sealed(map(text, outputs))


def operands_of(node: Node) -> list[Number]:
    """The operands of a node that are nodes."""
    return [x for x in node if type(x) is Number]


def _key(operation: str, operands: Sequence[Operand]) -> tuple[Any, ...]:
    if len(operands) == 2:
        x, y = operands
        if type(x) is Number and type(y) is Number:  # most nodes; pairs within the key need twice as long
            return operation, x.at, y.at, x.negative, y.negative
    return (operation, *[(x.at, x.negative) if type(x) is Number else x for x in operands])


def array_of(entries: Sequence[Any]) -> Any:
    """Numbers and floats as an object array (count,)."""
    out = np.empty(len(entries), dtype=object)
    out[:] = entries
    return out


def _recording(operation: str, even: bool = False, odd: bool = False) -> Callable[[Number], Number]:
    """The function of a recorded number."""

    def applied(x: Number) -> Number:
        return x.record(operation, x.positive if even or odd else x, negative=odd and x.negative)

    return applied


class Number(Ring, Recorded):
    """A recorded real number: the node `at` of a graph; the sign is kept apart, so that -x costs nothing.

    Comparisons are refused, as a definition may not branch: `key` is equal for the same number of a graph.
    """

    __slots__ = ("at", "graph", "negative")

    def __init__(self, graph: Graph, at: int, negative: bool = False):
        self.graph, self.at, self.negative = graph, at, negative

    @property
    def key(self) -> tuple[int, bool]:
        """The place of the node, and the sign."""
        return self.at, self.negative

    @property
    def positive(self) -> Number:
        """The node without the sign."""
        return Number(self.graph, self.at) if self.negative else self

    @property
    def node(self) -> Node:
        """(operation, operands)."""
        return self.graph.nodes[self.at]

    def record(self, operation: str, *operands: Operand, negative: bool = False) -> Number:
        """The number that an operation of this graph makes."""
        return Number(self.graph, self.graph.node(operation, *operands), negative)

    def __neg__(self) -> Number:
        return Number(self.graph, self.at, not self.negative)

    def __add__(self, other: Any) -> Any:
        b: Operand
        if isinstance(other, Number):
            if other.at == self.at and other.negative != self.negative:
                return 0.0
            b, b_negative = other.positive, other.negative
        elif not is_number(other):
            return NotImplemented
        else:
            if other == 0:
                return self
            b, b_negative = abs(float(other)), other < 0
        a = self.positive
        if self.negative == b_negative:
            operands = _older_first(a, b) if isinstance(b, Number) else (a, b)
            return self.record(PLUS, *operands, negative=self.negative)
        plus, minus = (b, a) if self.negative else (a, b)
        if self.graph.has(MINUS, minus, plus):
            return self.record(MINUS, minus, plus, negative=True)
        return self.record(MINUS, plus, minus)

    def __mul__(self, other: Any) -> Any:
        if isinstance(other, Number):
            return self.record(TIMES, *_older_first(self, other), negative=self.negative != other.negative)
        if not is_number(other):
            return NotImplemented
        if other in (0, 1, -1):
            return 0.0 if other == 0 else (self if other == 1 else -self)
        return self.record(TIMES, self.positive, abs(float(other)), negative=self.negative != (other < 0))

    def __truediv__(self, other: Any) -> Any:
        if isinstance(other, Number):
            return self.record(OVER, self.positive, other.positive, negative=self.negative != other.negative)
        if not is_number(other):
            return NotImplemented
        if other in (1, -1):
            return self if other == 1 else -self
        return self.record(OVER, self.positive, abs(float(other)), negative=self.negative != (other < 0))

    def __rtruediv__(self, other: Any) -> Any:
        if not is_number(other):
            return NotImplemented
        if other == 0:
            return 0.0
        return self.record(OVER, abs(float(other)), self.positive, negative=self.negative != (other < 0))

    def __pow__(self, exponent: Any) -> Any:
        return integer_power(self, exponent)

    sqrt, exp, log, sign = (_recording(name) for name in (SQRT, "exp", "log", SIGN))
    cos, __abs__ = _recording("cos", even=True), _recording(SIZE, even=True)
    sin, nearest = _recording("sin", odd=True), _recording(NEAREST, odd=True)

    def maximum(self, operand: Any) -> Number:
        return self.record(MAX, self, operand if isinstance(operand, Number) else float(operand))

    @staticmethod
    def where_less(x: Any, y: Any, yes: Any, no: Any) -> Any:
        return where_less(x, y, yes, no)

    def record_rows(self, body: Callable[..., Any], rows: Sequence[Sequence[float]]) -> list[Any]:
        """body(*row) for rows of constants, as the graph keeps them."""
        return self.graph.for_rows(body, rows)

    def record_times(
        self, body: Callable[[list[Any]], Sequence[Any]], start: Sequence[Any], count: int
    ) -> Sequence[Any]:
        """`count` applications of the body to `start`, as the graph keeps them."""
        return self.graph.times(body, start, count)

    def record_branch(self, body: Callable[[], Sequence[Any]], values: Sequence[Any]) -> Sequence[Any]:
        """body() if the number is positive, of a vector somewhere, else `values`."""
        return self.graph.branch(self, body, values)

    def record_entry(self, address: Any, row: Any, last: Any, column: int, stride: int) -> Any:
        """`kreisel.algebra.iteration.entry`; 0 for the address 0."""
        if not isinstance(address, Number):
            if address == 0:
                return 0.0
            raise TypeError("a table is a parameter: its address is not a constant of a kernel")
        operands = (x if isinstance(x, Number) else float(x) for x in (row, last))
        return self.record(ENTRY, address, *operands, column, stride)

    def record_loop(
        self, body: Callable[..., tuple[Any, Any]], start: Any, small: float, most: int
    ) -> tuple[Any, Number]:
        """`x, defect = body(x)`, repeated until defect <= small, for an array x (d,) of scalars."""

        def on_variables(variables: list[Number]) -> tuple[list[Any], Any]:
            new, defect = body(array_of(variables))
            return list(new), defect

        x, defect = self.graph.loop(on_variables, list(start), small, most)
        return array_of(x), defect

    def __repr__(self) -> str:
        operation, *operands = self.node
        return f"{'-' * self.negative}{''.join(map(str, operands)) if operation == IN else f't{self.at}'}"


def is_number(x: Any) -> bool:
    """Whether it is a recorded number or a real one."""
    return isinstance(x, Number | int | float | Fraction | np.integer | np.floating)


def _older_first(x: Number, y: Number) -> tuple[Number, Number]:
    return (y.positive, x.positive) if y.at < x.at else (x.positive, y.positive)


def integer_power(x: Any, exponent: Any) -> Any:
    """x^k by products, for an integer k."""
    if not isinstance(exponent, int | float | np.integer | np.floating) or exponent != int(exponent):
        raise NotRecorded(f"the power x**{exponent!r}", POWER)
    k = int(exponent)
    if k < 2:
        return 1 / integer_power(x, -k) if k < 0 else x if k else 1.0
    if k % 2:
        return integer_power(x, k - 1) * x
    half = integer_power(x, k // 2)
    return half * half


# -- operations on scalars of any kind -----------------------------------------------------------------


def fma(x: Any, y: Any, z: Any) -> Any:
    """x y + z, rounded once, of recorded scalars or floats."""
    if not isinstance(x, Number):
        x, y = y, x
    if isinstance(x, Number):
        if not isinstance(y, Number) and y in (0, 1, -1):
            return x * y + z
        if not isinstance(z, Number) and z == 0:
            return x * y
        return x.record(FMA, x, y if isinstance(y, Number) else float(y), z if isinstance(z, Number) else float(z))
    if x in (0, 1, -1) or y in (0, 1, -1):
        return x * y + z
    if isinstance(z, Number):
        return z.record(FMA, float(x), float(y), z)
    if not all(map(math.isfinite, (x, y, z))):
        return x * y + z
    try:
        return float(Fraction(x) * Fraction(y) + Fraction(z))
    except OverflowError:
        return x * y + z


def where_less(x: Any, y: Any, yes: Any, no: Any) -> Any:
    """`yes` where x < y, else `no`."""
    numbers = [v for v in (x, y) if isinstance(v, Number)]
    if not numbers:
        return yes if x < y else no
    if not isinstance(yes, Number) and not isinstance(no, Number) and yes == no:
        return yes
    return numbers[0].record(WHERE, *(v if isinstance(v, Number) else float(v) for v in (x, y, yes, no)))


def maximum(x: Any, y: Any) -> Any:
    """Python's max(x, y): x unless y > x."""
    if isinstance(x, Number) or isinstance(y, Number):
        graph = x if isinstance(x, Number) else y
        return graph.record(MAX, *(v if isinstance(v, Number) else float(v) for v in (x, y)))
    return max(x, y)


def depending(
    graph: Graph, nodes: Sequence[int], changes: Callable[[str], bool], places: Iterable[int] = ()
) -> set[int]:
    """The nodes among these, in order, that depend on an input whose letter `changes`, or on a node at the places."""
    out = set(places)
    for at in nodes:
        node = graph.nodes[at]
        if (node[0] == IN and changes(node[1])) or not out.isdisjoint(x.at for x in operands_of(node)):
            out.add(at)
    return out


def if_positive(test: Any, body: Callable[[], Sequence[Any]], values: Sequence[Any]) -> Sequence[Any]:
    """body() if test > 0, else `values`; recorded as a branch, taken if test > 0 in some place of a vector."""
    if isinstance(test, Number):
        return test.graph.branch(test, body, values)
    return body() if test > 0 else values


def looped(body: Callable[[list[Any]], Sequence[Any]], start: Sequence[Any], small: float, most: int) -> Sequence[Any]:
    """The last x and defect of `*x, defect = body(x)` from `start`, until defect <= small, at most `most` times."""
    new: Sequence[Any] = [*start, math.inf]
    for _ in range(most):
        new = body([*new[:-1]])
        if new[-1] <= small:
            break
    return new


def repeated(body: Callable[[list[Any]], Sequence[Any]], start: Sequence[Any], count: int) -> Sequence[Any]:
    """`body` applied `count` times, from `start`; a loop for recorded scalars."""
    graph = next((x.graph for x in start if isinstance(x, Number)), None)
    if graph is not None:
        return graph.loop(lambda variables: (body(variables), 0.0), start, NEVER, count)[0]
    values = list(start)
    for _ in range(count):
        values = list(body(values))
    return values


def _method(name: str, plain: Callable[[float], float]) -> Callable[[Any], Any]:
    return lambda x: getattr(x, name)() if isinstance(x, Number) else plain(x)


nearest = _method("nearest", lambda x: float(round(x)))
sign = _method("sign", lambda x: -1.0 if x < 0 else 1.0)

APPLIED: dict[str, Callable[..., Any]] = {
    PLUS: lambda x, y: x + y,
    MINUS: lambda x, y: x - y,
    TIMES: lambda x, y: x * y,
    OVER: lambda x, y: x / y,
    FMA: fma,
    MAX: maximum,
    WHERE: where_less,
    SIGN: sign,
    SIZE: abs,
    NEAREST: nearest,
    ENTRY: entry,
    SQRT: _method("sqrt", math.sqrt),
    **{name: _method(name, getattr(math, name)) for name in TRANSCENDENTAL},
}


def evaluated(
    graph: Graph,
    outputs: Sequence[Operand],
    inputs: Callable[[str, int], Any],
    operations: Mapping[str, Callable[..., Any]] = APPLIED,
) -> list[Any]:
    """The outputs of a graph on scalars of any kind: inputs(letter, index), and functions by name.

    LOOP as `looped`, BRANCH as `if_positive`.
    """
    values: dict[int, Any] = {}

    def of(x: Operand) -> Any:
        return x if not isinstance(x, Number) else -values[x.at] if x.negative else values[x.at]

    def repeated(loop: Loop, *operands: Operand) -> Sequence[Any]:
        def body(x: list[Any]) -> list[Any]:
            values.update({variable.at: value for variable, value in zip(loop.variables, x, strict=True)})
            compute(graph.needed_inside(loop))
            return [of(x) for x in loop.new]

        start = [of(x) for x in operands[: len(loop.variables)]]
        repeat: Callable[..., Sequence[Any]] = operations.get(LOOP, looped)
        return repeat(body, start, loop.small, loop.most)

    def branched(branch: Branch, test: Operand, *operands: Operand) -> Sequence[Any]:
        def body() -> list[Any]:
            compute(graph.needed_inside(branch))
            return [of(x) for x in branch.new]

        choose: Callable[..., Sequence[Any]] = operations.get(BRANCH, if_positive)
        return choose(of(test), body, [of(x) for x in operands[: len(branch.new)]])

    def compute(nodes: Iterable[int]) -> None:
        for at in nodes:
            operation, *operands = graph.nodes[at]
            if operation == IN:
                values[at] = inputs(*operands)
            elif operation == BRANCH:
                values[at] = branched(graph.branches[operands[0]], *operands[1:])
            elif operation == LOOP:
                values[at] = repeated(graph.loops[operands[0]], *operands[1:])
            elif operation == RESULT:
                values[at] = values[operands[0].at][operands[1]]
            else:
                values[at] = operations[operation](*map(of, operands))

    compute(graph.needed(outputs))
    return [of(x) for x in outputs]
