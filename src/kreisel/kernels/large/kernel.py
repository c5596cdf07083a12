"""The kernel of a step in a form of `kreisel.kernels.large.forms`, written level by level.

A level is a loop over complete vectors of entries; sums over all entries and products with matrices lie between two.
Vectors have the same width on every processor, and so sums the same bits.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any, NamedTuple

from llvmlite import ir

from kreisel.graph.graph import IN, Graph, Number, Operand, depending, operands_of
from kreisel.graph.llvm import DOUBLE, INTEGER, Function, Integer, Memory, Value, constant, kind_of
from kreisel.graph.machine import kernel
from kreisel.kernels.large.forms import LargeForm, LargeFunction, Solve
from kreisel.kernels.large.structured import KEPT, MOMENTUM, TOTAL, TURNED
from kreisel.kernels.steps import FRAME, Steps

# Rows of 4096 bytes fall on the same places of the first cache: at n = 1000 a step took three times as long.
ALIASED = 64
# The largest residual of a solve, relative and squared.  A solve is corrected by its residual, once, so the remainder
# of an error of 1e-9 is below round-off.  An inverse that follows the changes loses sqrt(steps) ulp: its residuals are
# 1e-14 after 65,000 steps (n = 10, eps = 0.05 to 5).
NEAR = 1e-18
WIDTH = 8  # entries at once
VECTOR = kind_of(WIDTH)
PRODUCTS = (MOMENTUM, KEPT, TURNED)


def compiled_large(form: LargeForm, columns: Mapping[str, slice], stage_columns: Mapping[str, slice]) -> Steps:
    """The kernel of a form; `columns` say where each constant is in its row."""
    pieces = form.pieces
    place = {f"{letter}_{name}": at for letter, of in (("c", columns), ("s", stage_columns)) for name, at in of.items()}
    length = -(-form.h // WIDTH) * WIDTH
    length += 2 * WIDTH if length > ALIASED and length % ALIASED == 0 else 0
    # An upper bound: a row for each entry, and for changes that wait.
    operations = sum(len(piece.graph.nodes) + 2 * len(piece.outputs) for piece in pieces)
    room = length * (operations + len(place) + 5 * len(form.kinds))
    digests = [
        (piece.graph.digest(piece.outputs), len(piece.new), repr((piece.changes, piece.solves))) for piece in pieces
    ]

    def write(f: Function) -> None:
        frame, out, rows, every, _, first, last = f.arguments
        words = dict(zip(FRAME, f.integers(frame).get(len(FRAME)), strict=True))
        f.vectors(WIDTH)
        counts = [max((at.stop for name, at in place.items() if name[0] == letter), default=0) for letter in "cs"]
        with f.loop(first, last) as lane:
            z = f.doubles(words["z"]).beyond(lane * form.size)
            s = f.doubles(words["s"]).beyond(lane * words["stages"] * counts[1])
            code = _Lane(f, form, pieces, place, (z, f.doubles(words["room"]), length))
            code.load(f.doubles(words["c"]).beyond(lane * counts[0]))
            with f.loop(0, rows) as row:
                with f.loop(0, every):
                    with f.loop(0, words["stages"]) as stage:
                        code.run(0, s.beyond(stage * counts[1]))
                    for number in range(1, len(pieces)):
                        code.run(number, s)
                code.settle()
                code.store(f.doubles(out).beyond((row * words["lanes"] + lane) * form.size), complete=True)
            code.store(z)

    return Steps(kernel(("large", NEAR, repr(form), digests, repr(place)), 7, write), room, False)


class Sum:
    """A sum of vectors and of scalars, which begins if it is made."""

    def __init__(self, f: Function):
        self._f, self._parts = f, [f.variable(0.0, VECTOR), f.variable(0.0, DOUBLE)]

    def add(self, x: Value) -> None:
        register = self._parts[0 if isinstance(x.type, ir.VectorType) else 1]
        register[0] = self._f.builder.fadd(register[0], x)

    def value(self) -> Value:
        vector, number = (register[0] for register in self._parts)
        places = [self._f.builder.extract_element(vector, ir.IntType(32)(k)) for k in range(WIDTH)]
        while len(places) > 1:
            half = len(places) // 2
            places = [self._f.builder.fadd(x, y) for x, y in zip(places[:half], places[half:], strict=True)]
        return self._f.builder.fadd(places[0], number)


class Values(NamedTuple):
    """Computed values of a graph: rows of entries, and scalars."""

    graph: Graph
    rows: dict[int, Memory]
    numbers: dict[int, Value]

    def copy(self) -> Values:
        """A copy, to which values are added."""
        return Values(self.graph, {**self.rows}, {**self.numbers})

    def bind(self, nodes: Sequence[int], rows: Mapping[str, Memory], numbers: Mapping[str, Value]) -> None:
        """Inputs by their names."""
        for at in nodes:
            operation, name, *_ = self.graph.nodes[at]
            if operation == IN and name in rows:
                self.rows[at] = rows[name]
            elif operation == IN and name in numbers:
                self.numbers[at] = numbers[name]


class _Lane:
    """The code of one lane: its state, rows of entries, and changes that wait to be made to its matrices.

    values  of each piece, those that do not vary, and entries of the state
    """

    def __init__(
        self,
        f: Function,
        form: LargeForm,
        pieces: Sequence[LargeFunction],
        place: Mapping[str, slice],
        memory: tuple[Memory, Memory, int],
    ):
        self.f, self.form, self.pieces, self.place, self.h = f, form, pieces, place, form.h
        (self.z, self.room, self.length), self._count = memory, 0
        self.values = [Values(piece.graph, {}, {}) for piece in pieces]
        self.state = {name: self.row() for name in form.places if name[-1] in "xy"}
        self.numbers = {name: f.variables(1)[0] for name in form.places if name[-1] == "t"}
        self.waiting: dict[Any, list[Any]] = {MOMENTUM: [], **{k: [] for k in range(form.inverses)}}
        for name, _ in pieces[0].changes:
            self.waiting[name].append((*f.variables(1), self.row(), self.row()))

    # -- rows and the state ------------------------------------------------------------------------

    def row(self) -> Memory:
        """A row of the workspace."""
        self._count += 1
        return self.room.beyond((self._count - 1) * self.length)

    def fill(self, row: Memory, source: Memory | None = None) -> Memory:
        """A row with entries from memory, and 0 beyond them."""
        count = self.h if source else 0
        if source:
            self.copy(source, row, count)
        with self.f.loop(count, self.length) as k:
            row[k] = 0.0
        return row

    def copy(self, source: Memory, target: Memory, count: int) -> None:
        with self.f.loop(0, count) as k:
            target[k] = source[k]

    def store(self, row: Memory, complete: bool = False) -> None:
        """The state into a row; `complete`: also the matrices, which are in z."""
        for name, at in self.form.places.items():
            if name in self.numbers:
                row[at.start] = self.numbers[name][0]
            elif name in self.state or complete:
                source = self.state.get(name) or self.z.beyond(at.start)
                self.copy(source, row.beyond(at.start), at.stop - at.start)

    def load(self, c: Memory) -> None:
        """The state from z, the constants, and what depends only on them."""
        for name, row in self.state.items():
            self.fill(row, self.z.beyond(self.form.places[name].start))
        for name, number in self.numbers.items():
            number[0] = self.z[self.form.places[name].start]
        for scale, *vectors in (change for changes in self.waiting.values() for change in changes):
            scale[0] = 0.0
            for vector in vectors:
                self.fill(vector)
        constants = {name: at.start for name, at in self.place.items() if name[0] == "c"}
        entries = [name for name in constants if self.form.has_entries(name)]
        rows = {name: self.fill(self.row(), c.beyond(constants[name])) for name in entries}
        numbers = {name: c[at] for name, at in constants.items() if name not in entries}
        for piece, values in zip(self.pieces, self.values, strict=True):
            values.bind(piece.nodes, self.state | rows, numbers)
            read = {x.at for at in piece.nodes if at not in piece.fixed for x in operands_of(piece.graph.nodes[at])}
            read |= {x.at for x in piece.outputs if isinstance(x, Number)}
            fixed = [at for at in sorted(piece.fixed) if piece.graph.nodes[at][0] != IN]
            self.compute(values, fixed, keep=read.intersection(fixed))

    # -- levels ------------------------------------------------------------------------------------

    def compute(
        self,
        constants: Values,
        nodes: Sequence[int],
        stores: Sequence[tuple[Memory, Operand]] = (),
        early: Collection[int] = (),
        keep: Collection[int] = (),
        before_last: Callable[[], None] = lambda: None,
    ) -> None:
        """Nodes into `constants`, each in the last level that is possible.

        stores  are written in the last loop; `early` nodes are computed before it, when `before_last` is called
        keep    entries that stay in their rows
        """
        graph, rows, numbers = constants
        operation = {at: graph.nodes[at][0] for at in nodes}
        needs = {at: [x.at for x in operands_of(graph.nodes[at])] for at in nodes}
        entries, rank = {*rows}, dict.fromkeys(nodes, 0) | dict.fromkeys(early, 1)  # levels up to the last
        for at in nodes:
            if operation[at] != TOTAL and not entries.isdisjoint(needs[at]):
                entries.add(at)
        for at in reversed(nodes):
            for x in needs[at]:
                rank[x] = max(rank.get(x, 0), rank[at] + (operation[at] in (TOTAL, *PRODUCTS)))
        for at in (at for at in nodes if operation[at] == TURNED):  # with W x in one way through W
            rank[at] = max(rank[x] for x in nodes if operation[x] in (KEPT, TURNED) and needs[x] == needs[at])
        elementwise = {at for at in nodes if at in entries and operation[at] not in PRODUCTS}
        outlive = {x for at in nodes if operation[at] != TOTAL for x in needs[at] if rank[at] < rank[x]}
        outlive |= {*keep, *early, *(x.at for _, x in stores if isinstance(x, Number) and rank.get(x.at))}
        sums = {
            at: rank[x] if x in elementwise else rank[at] + 1
            for at in nodes
            if operation[at] == TOTAL
            for x in needs[at]
        }
        totals, touched = dict[int, Sum](), set[Any]()
        for level in range(max(rank.values(), default=0), -1, -1):
            present = [at for at in nodes if rank[at] == level]
            self._products(constants, [at for at in present if operation[at] in PRODUCTS], touched)
            for at in present:
                if operation[at] == TOTAL:
                    numbers[at] = totals[at].value()
                elif at not in entries:
                    self.f.emit(graph, [at], numbers, DOUBLE)
            if level == 0:
                before_last()
            loop = [at for at in present if at in elementwise]
            targets = [(rows.setdefault(at, self.row()), Number(graph, at)) for at in loop if at in outlive]
            added = {at: Sum(self.f) for at in sums if sums[at] == level}
            self._loop(constants, loop, added, [*targets, *(stores if level == 0 else ())])
            totals |= added

    def _loop(
        self, constants: Values, nodes: Sequence[int], sums: Mapping[int, Sum], stores: Sequence[tuple[Memory, Operand]]
    ) -> None:
        """The loop of a level: the entries that it makes, sums of entries, and stores."""
        (graph, rows, numbers), f = constants, self.f
        summed = {at: graph.nodes[at][1] for at in sums}
        read = [x for at in nodes for x in operands_of(graph.nodes[at])]
        read += [*summed.values(), *(x for _, x in stores if isinstance(x, Number))]
        if not read and not stores:
            return
        with f.loop(0, -(-self.h // WIDTH)) as block:
            k = block * WIDTH
            local = {
                at: rows[at].beyond(k).of(VECTOR)[0] if at in rows else f.spread(numbers[at], VECTOR)
                for at in dict.fromkeys(x.at for x in read)
                if at not in nodes
            }
            f.emit(graph, nodes, local, VECTOR)
            for at, x in summed.items():
                sums[at].add(self._within(k, local[x.at]))
            for row, value in [(row, f.value(x, local, VECTOR)) for row, x in stores]:
                row.beyond(k).of(VECTOR)[0] = value

    def _within(self, k: Integer, value: Value) -> Value:
        """A vector with 0 beyond the last entry."""
        f, kind = self.f, ir.VectorType(INTEGER, WIDTH)
        if self.h % WIDTH == 0:
            return value
        places = f.builder.add(f.spread(k.value, kind), ir.Constant(kind, [*range(WIDTH)]))
        inside = f.builder.icmp_signed("<", places, ir.Constant(kind, [self.h] * WIDTH))
        return f.builder.select(inside, value, constant(VECTOR, 0.0))

    # -- steps -------------------------------------------------------------------------------------

    def run(self, number: int, s: Memory) -> None:
        """A step, or what closes it."""
        piece, f, values = self.pieces[number], self.f, self.values[number].copy()
        graph, nodes = piece.graph, piece.nodes
        again = f.builder.append_basic_block("again")
        attempt = f.variable(0)
        f.builder.branch(again)
        f.builder.position_at_end(again)
        of_stage = {name: s[at.start] for name, at in self.place.items() if name[0] == "s"}
        values.bind(nodes, {}, of_stage | {name: variable[0] for name, variable in self.numbers.items()})
        varying = [at for at in nodes if graph.nodes[at][0] != IN and at not in piece.fixed]
        of_columns = depending(graph, nodes, lambda name: name.startswith(self.form.letter_of("matrix")))
        inner, new = [at for at in varying if at in of_columns], dict(zip(self.form.names, piece.new, strict=True))
        stores = [(self.state[name], x) for name, x in new.items() if name in self.state]
        scalars = [(variable, new[name]) for name, variable in self.numbers.items()]
        waiting = {name: iter(changes) for name, changes in self.waiting.items()}
        for name, change in piece.changes:
            scale, x, y = next(waiting[name])
            stores += [(x, change.x), (y, change.y)]
            scalars.append((scale, change.scale))
        early = [x for solve in piece.solves for x in (solve.residual, solve.size)]
        early += [x for at in inner for x in operands_of(graph.nodes[at]) if x.at not in of_columns]

        def before_last() -> None:
            for solve in piece.solves:
                residual, size = (f.value(x, values.numbers, DOUBLE) for x in (solve.residual, solve.size))
                poor = f.builder.fcmp_unordered(">", residual, f.builder.fmul(constant(DOUBLE, NEAR), size))
                with f.where(f.builder.and_(poor, attempt[0].compared("==", 0))):
                    for k, renewed in enumerate(piece.solves):
                        self._renew(k, renewed, values)
                    attempt[0] = 1
                    f.builder.branch(again)
            if inner:
                self._turn_columns(values, nodes, inner, new)

        left = [at for at in varying if at not in of_columns]
        self.compute(values, left, stores, [x.at for x in early if isinstance(x, Number)], before_last=before_last)
        for target, x in scalars:
            target[0] = f.value(x, values.numbers, DOUBLE)

    def _turn_columns(
        self, outer: Values, nodes: Sequence[int], inner: Sequence[int], new: Mapping[str, Operand]
    ) -> None:
        """All vectors of an orientation, one after the other, in place."""
        letter, h, f = self.form.letter_of("matrix"), self.h, self.f
        vectors, values = {f"{letter}{block}": self.row() for block in "xy"}, outer.copy()
        with f.loop(0, self.form.n) as column:
            g = self.z.beyond(column * (2 * h + 1) + self.form.places[letter].start)
            for i, row in enumerate(vectors.values()):
                self.fill(row, g.beyond(i * h))
            values.bind(nodes, vectors, {f"{letter}t": g[2 * h]})
            self.compute(values, inner, [(row, new[name]) for name, row in vectors.items()])
            for i, row in enumerate(vectors.values()):
                self.copy(row, g.beyond(i * h), h)
            g[2 * h] = f.value(new[f"{letter}t"], values.numbers, DOUBLE)

    # -- a dense momentum M, its entries i < j, and its inverses W -----------------------------------

    def _matrix(self, name: Any) -> Memory:
        return self.z.beyond(
            self.form.places[self.form.letter_of("skew") if name == MOMENTUM else f"inverse{name}"].start
        )

    def _products(self, constants: Values, products: Sequence[int], touched: set[Any]) -> None:
        """The products of a level, one way through each matrix, the first one with the changes that wait."""
        groups: dict[Any, tuple[list[Any], list[Any]]] = {}
        for at in products:
            operation, _, *numbers, x = constants.graph.nodes[at]
            constants.rows[at] = self.row()
            group = groups.setdefault(numbers[0] if numbers else MOMENTUM, ([], []))
            group[operation == TURNED].append((constants.rows[x.at], constants.rows[at]))
        for name, (plain, turned) in groups.items():
            self.times(name, name not in touched, plain, turned)
            touched.add(name)

    def settle(self) -> None:
        """Make the changes that wait."""
        for name, changes in self.waiting.items():
            if changes:
                self.times(name, True, [], [])

    def _along(self, count: Integer, body: Callable[[Integer, ir.Type], None]) -> None:
        """`body(j, kind)` for vectors of entries, and for those that are left one by one."""
        with self.f.loop(0, count - count % WIDTH, WIDTH) as j:
            body(j, VECTOR)
        with self.f.loop(count - count % WIDTH, count) as j:
            body(j, DOUBLE)

    def times(
        self, name: Any, changed: bool, plain: Sequence[tuple[Memory, Memory]], turned: Sequence[tuple[Memory, Memory]]
    ) -> None:
        """y = M x or W x for pairs (x, y), v = W^T u for others; first the changes that wait, if they are to be made.

        The changes of a step wait for its first product in the next one: that saves a way through the matrix.
        """
        f, h, changes, momentum = self.f, self.h, self.waiting[name] if changed else [], name == MOMENTUM
        matrix, builder = self._matrix(name), self.f.builder
        place = f.variable(0)
        for _, y in plain if momentum else turned:
            self.fill(y, None)
        with f.loop(0, h - 1 if momentum else h) as i:
            start = i + 1 if momentum else f.integer(0)
            row, count = matrix.beyond(place[0]), f.integer(h) - start
            heads = [(builder.fmul(scale[0], x[i]), builder.fmul(scale[0], y[i])) for scale, x, y in changes]
            later = [(x.beyond(start), y.beyond(start)) for _, x, y in changes]
            inputs = [(x[i], x.beyond(start), y.beyond(start)) for x, y in plain]
            backs = [(u[i], v) for u, v in turned]
            sums = [Sum(f) for _ in plain]

            def entries(j: Integer, kind: ir.Type) -> None:
                m = row.beyond(j).of(kind)
                entry = m[0]
                for (e, g), (x, y) in zip(heads, later, strict=True):
                    entry = builder.fadd(entry, builder.fmul(f.spread(e, kind), y.beyond(j).of(kind)[0]))
                    if momentum:
                        entry = builder.fsub(entry, builder.fmul(f.spread(g, kind), x.beyond(j).of(kind)[0]))
                if changes:
                    m[0] = entry
                for total, (head, x, y) in zip(sums, inputs, strict=True):
                    total.add(builder.fmul(entry, x.beyond(j).of(kind)[0]))
                    if momentum:
                        back = y.beyond(j).of(kind)
                        back[0] = builder.fsub(back[0], builder.fmul(entry, f.spread(head, kind)))
                for head, v in backs:
                    back = v.beyond(j).of(kind)
                    back[0] = builder.fadd(back[0], builder.fmul(entry, f.spread(head, kind)))

            self._along(count, entries)
            for total, (_, y) in zip(sums, plain, strict=True):
                y[i] = builder.fadd(y[i], total.value()) if momentum else total.value()
            place[0] = place[0] + count
        for scale, _, _ in changes:
            scale[0] = 0.0

    def _renew(self, k: int, solve: Solve, constants: Values) -> None:
        """W = (D + theta M)^-1; a state that is no longer finite is reported elsewhere.

        By elimination without pivoting, which is safe for a positive diagonal, as in `kreisel.algebra.solve`.
        """
        f, h, builder, M, W = self.f, self.h, self.f.builder, self._matrix(MOMENTUM), self._matrix(k)
        D, theta = solve.diagonal, f.value(solve.turn, constants.numbers, DOUBLE)
        place = f.variable(0)
        with f.loop(0, h) as i:
            entries = {at: row[i] for at, row in constants.rows.items() if isinstance(D, Number) and D.at == at}
            W[i * h + i] = f.value(D, constants.numbers | entries, DOUBLE)
            with f.loop(i + 1, h) as j:
                entry = builder.fmul(theta, M[place[0]])
                W[i * h + j], W[j * h + i] = entry, builder.fneg(entry)
                place[0] = place[0] + 1
        with f.loop(0, h) as p:
            pivot = W.beyond(p * h)
            scale = builder.fdiv(constant(DOUBLE, 1.0), pivot[p])
            pivot[p] = 1.0

            def scaled(j: Integer, kind: ir.Type) -> None:
                at = pivot.beyond(j).of(kind)
                at[0] = builder.fmul(at[0], f.spread(scale, kind))

            self._along(f.integer(h), scaled)
            with f.loop(0, h) as i, f.where(i.compared("!=", p)):
                row = W.beyond(i * h)
                factor = row[p]
                row[p] = 0.0

                def eliminated(j: Integer, kind: ir.Type) -> None:
                    at = row.beyond(j).of(kind)
                    at[0] = builder.fsub(at[0], builder.fmul(f.spread(factor, kind), pivot.beyond(j).of(kind)[0]))

                self._along(f.integer(h), eliminated)
