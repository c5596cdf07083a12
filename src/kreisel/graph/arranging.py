"""Graphs made ready for a compiler: fusing, order and reuse are decided here, once.

Kernels are compiled without leave to fuse or to reorder, so all that are made from one step, for one trajectory, for
an ensemble or with some constants folded in, give the same bits.
"""

from __future__ import annotations

import heapq
import math
from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from functools import partial
from itertools import chain
from typing import Any, NamedTuple

import numpy as np

from kreisel.algebra import gradient, identity, solve
from kreisel.graph import graph as ops
from kreisel.graph.graph import Graph, Loop, Number, Operand, depending, evaluated, if_positive, operands_of, where_less

SAME, LOOPING = "same", 6
CYCLES = 4  # of an operation; one begins in each.  A quotient of 13 makes no step faster, two at once one 14 % slower


class _Step(NamedTuple):
    """An operation to be recorded again: its place in the old graph, or ("1/", place) for a reciprocal."""

    place: Any
    operation: str
    operands: tuple[Any, ...]  # Numbers of the old graph, floats, ("1/", place)


def arranged(
    graph: Graph, outputs: Sequence[Operand], values: Mapping[tuple[str, int], float] | None = None
) -> tuple[Graph, list[Operand]]:
    """The graph recorded once more, with `values` in place of some inputs (letter, index); and its outputs.

    A product that only one sum needs is fused into it, of two the one whose node is older.  Several quotients by one
    number use its reciprocal.  Loops of one iteration are written out.
    """
    if any(loop.most == 1 for loop in graph.loops):
        graph, outputs = _written_out(graph, outputs)
    try:
        return _Arranging(graph, values or {}).outputs(outputs)
    except (ArithmeticError, ValueError):  # 1/0, log 0 on a branch that is not taken, or a fault that the run names
        return _Arranging(graph, {}).outputs(outputs)


def _written_out(graph: Graph, outputs: Sequence[Operand]) -> tuple[Graph, list[Operand]]:
    new = Graph()

    def repeat(body: Callable[[list[Any]], Sequence[Any]], start: list[Any], small: float, most: int) -> Sequence[Any]:
        return body(start) if most == 1 else new.repeat(body, start, small, most)

    return new, evaluated(graph, outputs, new.input, ops.APPLIED | {ops.LOOP: repeat})


def length(graph: Graph, outputs: Sequence[Operand]) -> int:
    """How many operations the outputs need when they are arranged; a body a few more."""
    count = 0
    for place, operation, _ in _fused(graph, graph.needed(outputs), outputs):
        if operation in (ops.LOOP, ops.BRANCH) and (body := graph.body_of(place)) is not None:
            count += len(_fused(graph, graph.needed_inside(body), body.new)) + LOOPING
        elif operation not in (ops.IN, ops.RESULT):
            count += 1
    return count


class _Arranging:
    def __init__(self, graph: Graph, values: Mapping[tuple[str, int], float]):
        self._old, self._values, self._new = graph, values, Graph()
        self._results: dict[Any, Operand] = {}

    def outputs(self, outputs: Sequence[Operand]) -> tuple[Graph, list[Operand]]:
        self._record(_fused(self._old, self._old.needed(outputs), outputs))
        return self._new, [self._value(x) for x in outputs]

    def _value(self, x: Any) -> Operand:
        if not isinstance(x, Number):
            return self._results[x] if isinstance(x, tuple) else x
        value = self._results[x.at]
        return -value if x.negative else value

    def _record(self, steps: Sequence[_Step]) -> None:
        for place, operation, operands in steps:
            if operation == ops.IN:
                letter, index = operands
                value = self._values.get((letter, index))
                self._results[place] = self._new.input(letter, index) if value is None else value
            elif operation == ops.LOOP:
                self._loop(place, operands)
            elif operation == ops.BRANCH:
                self._branch(place, operands)
            elif operation == SAME:
                self._results[place] = self._value(operands[0])
            elif operation == ops.RESULT:
                self._results[place] = self._results[operands[0].at, operands[1]]
            else:
                apply = ops.APPLIED.get(operation, partial(_linear, operation))
                self._results[place] = apply(*map(self._value, operands))

    def _loop(self, place: int, operands: tuple[Any, ...]) -> None:
        loop = self._old.loops[operands[0]]
        members = _fused(self._old, self._old.needed_inside(loop), loop.new)

        def body(variables: list[Number]) -> tuple[list[Operand], Operand]:
            self._results.update({x.at: variable for x, variable in zip(loop.variables, variables, strict=True)})
            self._record(members)
            *new, defect = map(self._value, loop.new)
            return new, defect

        start = [self._value(x) for x in operands[1 : 1 + len(loop.variables)]]
        x, defect = self._new.loop(body, start, loop.small, loop.most)
        self._results.update({(place, i): value for i, value in enumerate((*x, defect))})

    def _branch(self, place: int, operands: tuple[Any, ...]) -> None:
        branch = self._old.branches[operands[0]]
        test, *values = map(self._value, operands[1 : 2 + len(branch.new)])

        def body() -> list[Operand]:
            self._record(_fused(self._old, self._old.needed_inside(branch), branch.new))
            return [self._value(x) for x in branch.new]

        self._results.update({(place, i): value for i, value in enumerate(if_positive(test, body, values))})


def _linear(operation: str, *operands: Any) -> Number:
    """An operation of an engine's own, such as a sum over all places: linear in its last operand."""
    *first, x = operands
    result: Number = x.record(operation, *first, x.positive, negative=x.negative)
    return result


def _key(x: Any) -> Any:
    return x.at if type(x) is Number else x if type(x) is tuple else None


def _fused(graph: Graph, nodes: Sequence[int], outputs: Sequence[Operand]) -> list[_Step]:
    steps = _with_reciprocals([_Step(at, graph.nodes[at][0], graph.nodes[at][1:]) for at in nodes])
    uses = Counter(chain.from_iterable(map(_read, steps)))
    uses.update({x.at for x in outputs if isinstance(x, Number)})
    products = {step.place: step.operands for step in steps if step.operation == ops.TIMES and uses[step.place] == 1}
    out, gone = list[_Step](), set[Any]()
    for step in steps:
        if step.operation not in (ops.PLUS, ops.MINUS):
            out.append(step)
            continue
        x, y = step.operands
        apart = [v for v in (x, y) if _key(v) in products]
        if not apart:
            out.append(step)
            continue
        inner = min(apart, key=_key)
        first = inner is x
        p, q = products[_key(inner)]
        addend = y if first else x
        if step.operation == ops.MINUS and first:
            addend = -addend
        elif step.operation == ops.MINUS:
            p = -p
        out.append(_Step(step.place, ops.FMA, (p, q, addend)))
        gone.add(_key(inner))
    return [step for step in out if step.place not in gone]


def _read(step: _Step) -> list[Any]:
    """Keys of the operands, as often as they are read; of a body once."""
    read = [_key(x) for x in step.operands if type(x) in (Number, tuple)]
    return list(dict.fromkeys(read)) if step.operation in (ops.LOOP, ops.BRANCH) else read


def _with_reciprocals(steps: list[_Step]) -> list[_Step]:
    divisors = Counter(x.operands[1].at for x in steps if x.operation == ops.OVER and isinstance(x.operands[1], Number))
    out, inverted = list[_Step](), set[int]()
    for step in steps:
        x, y = step.operands if step.operation == ops.OVER else (None, None)
        if not isinstance(y, Number) or divisors[y.at] < 2:
            out.append(step)
            continue
        inverse = ("1/", y.at)
        if y.at not in inverted:
            out.append(_Step(inverse, ops.OVER, (1.0, y)))
            inverted.add(y.at)
        alone = not isinstance(x, Number) and x == 1
        out.append(_Step(step.place, SAME, (inverse,)) if alone else _Step(step.place, ops.TIMES, (x, inverse)))
    return out


class Formula:
    """A function of arrays of these shapes, recorded and arranged; called on scalars of any kind.

    Its result is flat: `count` scalars.
    """

    def __init__(self, function: Callable[..., Any], *shapes: tuple[int, ...]):
        graph, arguments, first = Graph(), list[Any](), 0
        for shape in shapes:
            arguments.append(graph.inputs("x", math.prod(shape), first).reshape(shape)[()])
            first += math.prod(shape)
        values = [x if isinstance(x, Number) else float(x) for x in np.asarray(function(*arguments), dtype=object).flat]
        self._graph, self._outputs = arranged(graph, values)
        self.count = len(values)

    def __call__(self, *arguments: Any) -> list[Any]:
        numbers = [x for argument in arguments for x in np.ravel(np.asarray(argument, dtype=object))]
        return evaluated(self._graph, self._outputs, lambda _, i: numbers[i])

    def digest(self) -> str:
        """SHA-256 of its operations."""
        return self._graph.digest(self._outputs)


# -- graphs whose loops stay loops, for languages ------------------------------------------------------

ROW, ENTRY = "row", "each"  # letters of the columns of a table, and of the results of its rows


def of_a_row(letter: str) -> bool:
    """Whether an input is a column of a table."""
    return letter.startswith(ROW)


class Rolled(Graph):
    """A graph whose loops over tables stay loops.

    maps    (rows, results) of each loop: its columns are inputs `row`, its results outside inputs `each`
    values  of inputs (letter, index) that are constants
    tables  whether loops over tables stay loops, or are written out
    """

    def __init__(self, tables: bool) -> None:
        super().__init__()
        self._tables = tables
        self.maps: list[tuple[Sequence[Sequence[float]], list[Operand]]] = []
        self.values = dict[tuple[str, int], float]()

    def for_rows(self, body: Callable[..., Any], rows: Sequence[Sequence[float]]) -> list[Any]:
        if not self._tables:
            return super().for_rows(body, rows)
        place = len(self.maps)
        columns = [self.input(f"{ROW}{place}", j) for j in range(len(rows[0]))]
        self.maps.append((rows, [body(*columns)]))
        return [self.input(f"{ENTRY}{place}", k) for k in range(len(rows))]

    def times(self, body: Callable[[list[Any]], Sequence[Any]], start: Sequence[Any], count: int) -> Sequence[Any]:
        """The result of `count` applications of the body to `start`, recorded once."""
        return self.loop(lambda x: (body(x), 0.0), start, -1.0, count)[0]

    def arranged(self, outputs: Sequence[Operand]) -> tuple[Graph, list[Operand], list[Operand]]:
        """The graph made ready: its outputs, and the results of the loops.

        Values that a loop reads count as used often, as they are in a graph without loops.
        """
        results = [x for _, new in self.maps for x in new]
        inside = depending(self, self.needed(results), of_a_row)
        read = [x for at in inside for x in operands_of(self.nodes[at]) if x.at not in inside]
        read_there = {x.at: x.positive for x in read}.values()
        graph, values = arranged(self, [*outputs, *results, *read_there], self.values)
        return graph, values[: len(outputs)], values[len(outputs) : len(outputs) + len(results)]


# -- the order of operations ---------------------------------------------------------------------------


def latest(graph: Graph, nodes: Sequence[int]) -> list[int]:
    """The nodes in the order in which a processor that begins one of them in a cycle would begin them at the latest.

    Compilers keep near to it.  The oldest node comes first, and no result is computed long before it is needed: two
    steps on separate scalars, one after the other, then overlap in the processor.
    """
    places = {at: i for i, at in enumerate(nodes)}
    needs = [
        [places[y] for y in dict.fromkeys(x.at for x in operands_of(graph.nodes[at])) if y in places] for at in nodes
    ]
    before, users = [0] * len(nodes), [0] * len(nodes)
    for i, needed in enumerate(needs):
        before[i] = 1 + max((before[j] for j in needed), default=0)
        for j in needed:
            users[j] += 1
    after = [CYCLES] * len(nodes)  # from the beginning of an operation to the end of the step, backwards
    waiting = [(CYCLES, i) for i in range(len(nodes)) if not users[i]]
    heapq.heapify(waiting)
    ready: list[tuple[int, int]] = []
    order: list[int] = []
    time = CYCLES
    while waiting or ready:
        while waiting and waiting[0][0] <= time:
            _, i = heapq.heappop(waiting)
            heapq.heappush(ready, (-before[i], -i))
        i = -heapq.heappop(ready)[1]
        order.append(i)
        for j in needs[i]:
            after[j] = max(after[j], time + CYCLES)
            users[j] -= 1
            if not users[j]:
                heapq.heappush(waiting, (after[j], j))
        time = time + 1 if ready or not waiting else max(time + 1, waiting[0][0])
    return [nodes[i] for i in reversed(order)]


def independent(graph: Graph, nodes: Sequence[int], letters: Collection[str], loops: bool = False) -> set[int]:
    """The nodes that depend on inputs of these letters only, and, unless `loops`, on no loop or branch."""
    out = set[int]()
    for at in nodes:
        operation, *operands = graph.nodes[at]
        if operation == ops.IN:
            fixed = operands[0] in letters
        else:
            plain = loops or operation not in (ops.LOOP, ops.BRANCH, ops.RESULT, ops.VARIABLE)
            fixed = plain and all(x.at in out for x in operands_of(graph.nodes[at]))
        if fixed:
            out.add(at)
    return out


# -- derivatives of graphs, of loops 0 -----------------------------------------------------------------


CHOICES = (ops.WHERE, ops.MAX)  # the derivative of the other value does not count, even if it is not finite
# Derivatives of an operation by its operands: slopes(value, *operands).
SLOPES: dict[str, Callable[..., tuple[Operand, ...]]] = gradient.SLOPES | {
    ops.FMA: lambda value, x, y, z: (y, x, 1),
    ops.MAX: lambda value, x, y: (where_less(x, y, 0, 1), where_less(x, y, 1, 0)),
    ops.WHERE: lambda value, x, y, a, b: (0, 0, where_less(x, y, 1, 0), where_less(x, y, 0, 1)),
    ops.SIZE: lambda value, x: (x.sign(),),
    ops.SIGN: lambda value, x: (0,),
    ops.NEAREST: lambda value, x: (0,),
    ops.ENTRY: lambda value, *operands: (0,) * len(operands),
}


def pushed(graph: Graph, outputs: Sequence[Operand], fixed: str = "") -> tuple[Graph, list[Operand]]:
    """A new graph, with the outputs and then their tangents J v; its inputs "vz" are the tangents of "z".

    Inputs of the letters `fixed` have none.
    """
    graph, new, moving = _copy(graph, outputs, fixed)
    inputs = (at for at in moving if graph.nodes[at][0] == ops.IN)
    along = {at: graph.input(f"v{graph.nodes[at][1]}", graph.nodes[at][2]) for at in inputs}
    return graph, [*new, *_tangents(graph, moving, along, new)]


def _tangents(
    graph: Graph, nodes: Sequence[int], along: Mapping[int, Operand], outputs: Sequence[Operand]
) -> list[Operand]:
    """Tangents of outputs, recorded in the same graph, from those `along` some nodes, of the nodes in order."""
    tangents = dict(along)

    def of(x: Operand) -> Operand:
        tangent = tangents.get(x.at, 0.0) if isinstance(x, Number) else 0.0
        return -tangent if isinstance(x, Number) and x.negative else tangent

    for at in nodes:
        operation, *operands = graph.nodes[at]
        if at in along:
            continue
        if operation in CHOICES:
            x, y = operands[:2]
            yes, no = (y, x) if operation == ops.MAX else operands[2:]
            tangents[at] = where_less(x, y, of(yes), of(no))
        else:
            tangents[at] = sum((slope * of(x) for x, slope in _slopes(graph, at)), 0.0)
    return [*map(of, outputs)]


def with_roots(graph: Graph, outputs: Sequence[Operand], steps: int, most: float) -> tuple[Graph, list[Operand]]:
    """A new graph with steps of Newton's method behind each loop, for the derivatives of its root x = body(x).

    Each step, all with the slopes at the first x, makes derivatives of one more order right.  Raises `TooLong` beyond
    `most` operations.
    """
    new, nodes, places = Graph(most), graph.needed(outputs), {x.at for x in outputs if isinstance(x, Number)}
    for at in reversed(nodes):
        if at in places:
            body = graph.body_of(at)
            start = 2 + len(body.variables) if isinstance(body, Loop) else 0  # where a loop starts does not count
            places |= {x.at for x in operands_of(graph.nodes[at][start:])}
    in_outputs = iter([at in places for at in nodes if graph.nodes[at][0] == ops.LOOP])

    def solved(body: Callable[[list[Any]], Sequence[Any]], start: Sequence[Any], small: float, count: int) -> list[Any]:
        *x, defect = new.repeat(body, start, small, count)
        if not next(in_outputs):
            return [*x, defect]
        *image, _ = body(x)
        at_x = {v.at for v in x}
        moving = sorted(depending(new, new.needed(image), lambda _: False, at_x) - at_x)
        slopes = identity(len(x)) - np.array([_tangents(new, moving, {v.at: 1.0}, image) for v in x], dtype=object).T
        for _ in range(steps):
            miss = ops.array_of([v - y for v, y in zip(x, body(x), strict=False)])
            x = [v - change for v, change in zip(x, solve(slopes, miss[:, None])[:, 0], strict=True)]
        return [*x, defect]

    return new, evaluated(graph, outputs, new.input, ops.APPLIED | {ops.LOOP: solved})


def pulled(graph: Graph, outputs: Sequence[Operand], fixed: str = "") -> tuple[Graph, dict[tuple[str, int], Operand]]:
    """A new graph, with the slopes J^T w by inputs (letter, index); its inputs "w" are the slopes by the outputs.

    Inputs of the letters `fixed`, and those on which no output depends, have none.
    """
    graph, new, moving = _copy(graph, outputs, fixed)
    slopes: dict[int, Any] = dict.fromkeys(moving, 0.0)

    def add(x: Operand, slope: Operand) -> None:
        if isinstance(x, Number) and x.at in slopes:
            slopes[x.at] = slopes[x.at] + (-slope if x.negative else slope)

    plain = {x.at for x in new if isinstance(x, Number)}  # nodes that do not only go into choices
    for i, x in enumerate(new):
        add(x, graph.input("w", i))
    for at in reversed(moving):
        if graph.nodes[at][0] != ops.IN and isinstance(slopes[at], Number):
            free = at in plain
            for x, slope in _slopes(graph, at):
                gain = slopes[at] * slope
                kept = free or not isinstance(slope, Number)
                add(x, gain if kept else where_less(abs(slopes[at]), gradient.LEAST, 0.0, gain))
                if free and graph.nodes[at][0] not in CHOICES:
                    plain.add(x.at)
    return graph, {graph.nodes[at][1:]: slopes[at] for at in moving if graph.nodes[at][0] == ops.IN}


def _copy(graph: Graph, outputs: Sequence[Operand], fixed: str) -> tuple[Graph, list[Operand], list[int]]:
    new = Graph()
    copies = new.copy(graph, outputs)
    nodes = new.needed(copies)
    still = independent(new, nodes, fixed)
    return new, copies, [at for at in nodes if at not in still and new.nodes[at][0] not in (ops.LOOP, ops.RESULT)]


def _slopes(graph: Graph, at: int) -> list[tuple[Number, Operand]]:
    operation, *operands = graph.nodes[at]
    slopes = SLOPES[operation](Number(graph, at), *operands)
    return [(x, slope) for x, slope in zip(operands, slopes, strict=True) if isinstance(x, Number)]
