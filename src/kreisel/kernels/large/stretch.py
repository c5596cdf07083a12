"""Nodes of a graph of entries, written level by level: loops over the entries, and what is between them."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any

from llvmlite import ir

from kreisel.graph.graph import Graph, Number, Operand, operands_of
from kreisel.graph.llvm import DOUBLE, INTEGER, Function, Integer, Memory, Value, constant, kind_of
from kreisel.kernels.large.structured import KEPT, MOMENTUM, TOTAL, TURNED

WIDTH = 8  # entries at once
VECTOR = kind_of(WIDTH)


def along(f: Function, count: Integer, body: Callable[[Integer, ir.Type], None]) -> None:
    """`body(j, kind)` for vectors of entries, and for those that are left one by one."""
    whole = count - count % WIDTH
    with f.loop(0, whole, WIDTH) as j:
        body(j, VECTOR)
    with f.loop(whole, count) as j:
        body(j, DOUBLE)


class Sum:
    """A sum of vectors and of scalars, which begins if it is made."""

    def __init__(self, f: Function):
        self._f, self._parts = f, [*f.variables(1, VECTOR), *f.variables(1)]
        for part in self._parts:
            part[0] = 0.0

    def add(self, x: Value) -> None:
        part = self._parts[0 if isinstance(x.type, ir.VectorType) else 1]
        part[0] = self._f.builder.fadd(part[0], x)

    def value(self) -> Value:
        vector, number = (part[0] for part in self._parts)
        places = [self._f.builder.extract_element(vector, ir.IntType(32)(k)) for k in range(WIDTH)]
        while len(places) > 1:
            half = len(places) // 2
            places = [self._f.builder.fadd(x, y) for x, y in zip(places[:half], places[half:], strict=True)]
        return self._f.builder.fadd(places[0], number)


class Stretch:
    """Nodes of a graph: scalars, and entries in rows; what is there before is in `rows` and `values`."""

    def __init__(
        self, step: Any, graph: Graph, nodes: Sequence[int], rows: Mapping[int, Memory], values: Mapping[int, Value]
    ):
        self._step, self._graph, self._nodes = step, graph, nodes
        self.rows, self.values = dict(rows), dict(values)
        self._entries, self._taken, self._free = {*rows}, list[int](), list[Memory]()
        for at in nodes:
            operation = graph.nodes[at][0]
            of_entries = any(x.at in self._entries for x in operands_of(graph.nodes[at]))
            if operation != TOTAL and of_entries:
                self._entries.add(at)
        self._totals = [at for at in nodes if graph.nodes[at][0] == TOTAL]
        self._sums: dict[int, Value] = {}

    def number(self, x: Operand) -> Value:
        """A number."""
        return self._step.f.value(x, self.values, DOUBLE)

    def entries_of(self, x: Operand) -> Memory:
        """The row of an entry; of a number one that it fills."""
        if isinstance(x, Number) and x.at in self.rows:
            return self.rows[x.at]
        row, value = self._step.row(), self.number(x)
        with self._step.f.loop(0, self._step.code.h) as k:
            row[k] = value
        return row

    def _ends(self, at: int) -> bool:
        return self._graph.nodes[at][0] in (TOTAL, MOMENTUM, KEPT, TURNED)

    def _matrix(self, at: int) -> Any:
        """The matrix of a product: MOMENTUM, or the number of an inverse; None for another node."""
        operation, *operands = self._graph.nodes[at]
        return MOMENTUM if operation == MOMENTUM else operands[1] if operation in (KEPT, TURNED) else None

    def _levels(self, late: Collection[int]) -> tuple[dict[int, int], int]:
        """The level of each node and the last one; `late` is needed in full at the last.

        Products with one matrix share a level where they can: one that may wait does, for one that may not.
        """
        free_to: dict[int, int] = {}  # no earlier than
        needs = {at: [x.at for x in operands_of(self._graph.nodes[at])] for at in self._nodes}
        level: dict[int, int] = {}
        last = 0
        for again in (True, False):
            level = {}
            for at in self._nodes:
                deep = max((level.get(x, 0) for x in needs[at]), default=0)
                level[at] = max(deep + self._ends(at), free_to.get(at, 0))
            last = max([*level.values(), *(level[x] + (x in self._entries) for x in late if x in level)], default=0)
            if again:
                latest = dict.fromkeys(level, last) | {x: last - (x in self._entries) for x in late}
                for at in reversed(self._nodes):
                    for x in needs[at]:
                        latest[x] = min(latest.get(x, last), latest[at] - self._ends(at))
                products = [at for at in self._nodes if self._matrix(at) is not None]
                for at in products:
                    same = [x for x in products if self._matrix(x) == self._matrix(at)]
                    fixed = [level[x] for x in same if level[x] == latest[x] and level[at] <= level[x] <= latest[at]]
                    free_to[at] = min(fixed, default=0)
        return level, last

    def run(
        self,
        late: Collection[int] = (),
        stores: Sequence[tuple[Memory, Operand]] = (),
        at_last: Callable[[], None] | None = None,
        test: Callable[[Collection[int]], None] | None = None,
        keep: Collection[int] = (),
    ) -> None:
        """Compute all nodes; `stores` are written in the last loop, `late` entries are known in full before it.

        `test` is called with the nodes of each level, and `keep` stay in their rows.
        """
        level, last = self._levels(late)
        used: dict[int, float] = {x: last - 0.5 for x in late} | dict.fromkeys(keep, last + 1)
        for at in self._nodes:
            for x in operands_of(self._graph.nodes[at]):
                used[x.at] = max(used.get(x.at, 0), level[at] - (0.5 if self._ends(at) else 0))
        used |= {x.at: last + 1 for _, x in stores if isinstance(x, Number)}
        touched = set[Any]()
        for now in range(last + 1):
            here = [at for at in self._nodes if level[at] == now]
            self._products([at for at in here if self._matrix(at) is not None], touched)
            for at in here:
                if at not in self._entries:
                    self._number(at)
            if test:
                test(here)
            if now == last and at_last:
                at_last()
            for at in [at for at in self._taken if used.get(at, 0) < now]:
                self._taken.remove(at)
                self._free.append(self.rows[at])
            made = [at for at in here if at in self._entries and self._matrix(at) is None]
            outlive = [at for at in made if used.get(at, 0) > now]
            totals = [at for at in self._totals if level[at] == now + 1]
            self._loop(made, outlive, totals, stores if now == last else ())

    def _number(self, at: int) -> None:
        if self._graph.nodes[at][0] == TOTAL:
            self.values[at] = self._sums.pop(at)
        else:
            self._step.f.emit(self._graph, [at], self.values, DOUBLE)

    def _row(self, at: int) -> Memory:
        self._taken.append(at)
        self.rows[at] = self._free.pop() if self._free else self._step.row()
        return self.rows[at]

    def _products(self, here: Sequence[int], touched: set[Any]) -> None:
        """The products of a level, one way through each matrix, the first with what waits."""
        for matrix in dict.fromkeys(map(self._matrix, here)):
            groups: tuple[list[Any], list[Any]] = [], []
            for at in here:
                if self._matrix(at) == matrix:
                    operation, *_, x = self._graph.nodes[at]
                    groups[operation == TURNED].append((self.rows[x.at], self._row(at)))
            self._step.times(matrix, matrix not in touched, *groups)
            touched.add(matrix)

    def _loop(
        self,
        made: Sequence[int],
        outlive: Sequence[int],
        totals: Sequence[int],
        stores: Sequence[tuple[Memory, Operand]],
    ) -> None:
        """The loop of a level: entries that it makes, sums of entries, and what is stored."""
        if not made and not totals and not stores:
            return
        f, graph, h = self._step.f, self._graph, self._step.code.h
        summed = {at: operands_of(graph.nodes[at])[0] for at in totals}
        sums = {at: Sum(f) for at in totals}
        reads = [x for at in made for x in operands_of(graph.nodes[at])] + [*summed.values()]
        reads += [x for _, x in stores if isinstance(x, Number)]
        targets = [(self._row(at), at) for at in outlive]
        with f.loop(0, -(-h // WIDTH)) as block:
            k = block * WIDTH
            values: dict[int, Value] = {}
            for x in reads:
                if x.at in self._entries and x.at not in made:
                    values.setdefault(x.at, self.rows[x.at].beyond(k).of(VECTOR)[0])
                elif x.at not in self._entries:
                    values.setdefault(x.at, f.spread(self.values[x.at], VECTOR))
            f.emit(graph, made, values, VECTOR)
            for at, x in summed.items():
                sums[at].add(self._within(k, values[x.at]))
            results = [(row, f.value(x, values, VECTOR)) for row, x in stores]
            for row, at in targets:
                row.beyond(k).of(VECTOR)[0] = values[at]
            for row, value in results:
                row.beyond(k).of(VECTOR)[0] = value
        self._sums.update({at: total.value() for at, total in sums.items()})

    def _within(self, k: Integer, value: Value) -> Value:
        f, h = self._step.f, self._step.code.h
        if h % WIDTH == 0:
            return value
        kind = ir.VectorType(INTEGER, WIDTH)
        places = f.builder.add(f.spread(k.value, kind), ir.Constant(kind, [*range(WIDTH)]))
        inside = f.builder.icmp_signed("<", places, ir.Constant(kind, [h] * WIDTH))
        return f.builder.select(inside, value, constant(VECTOR, 0.0))
