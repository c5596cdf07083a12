"""The kernel of a step in a form of `kreisel.kernels.large.forms`, written level by level.

Entries lie in rows of a workspace, in complete vectors.  A loop over them represents each stretch between two sums over
all entries, or products with a dense matrix.  Vectors have the same width on every processor, and so sums the same
bits.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from llvmlite import ir

from kreisel.graph.arranging import independent
from kreisel.graph.graph import IN, Graph, Number, Operand, depending, operands_of
from kreisel.graph.llvm import DOUBLE, INTEGER, Function, Integer, Memory, Value, constant, kind_of
from kreisel.graph.machine import kernel
from kreisel.kernels.large.forms import AXIS_NAME, Change, LargeForm, LargeFunction, recorded_large
from kreisel.kernels.large.structured import KEPT, MOMENTUM, TOTAL, TURNED
from kreisel.kernels.steps import FRAME, Steps
from kreisel.method.scheme import Scheme

# Rows of 4096 bytes fall on the same places of the first cache: at n = 1000 a step took three times as long.
ALIASED = 64
# The largest residual of a solve, relative and squared.  A solve is corrected by its residual, once, so what is left of
# an error of 1e-9 is below round-off.  An inverse that follows the changes loses sqrt(steps) ulp: its
# residuals are 1e-14 after 65,000 steps (n = 10, eps = 0.05 to 5).
NEAR = 1e-18


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


class Large(NamedTuple):
    """A form, and the scheme as it was before it was put in this form."""

    form: LargeForm
    scheme: Scheme


def compiled_large(large: Large, columns: Mapping[str, slice], stage_columns: Mapping[str, slice]) -> Steps:
    """The kernel of a scheme in a form; `columns` say where each constant is in its row."""
    form, parts, kinds = large.form, large.scheme.parts, large.scheme.kinds
    pieces = [recorded_large(form, part) for part in parts]
    place = {f"c_{name}": ("c", at) for name, at in columns.items()}
    place |= {f"s_{name}": ("s", at) for name, at in stage_columns.items()}
    code = _Code(form, kinds, pieces, place)
    digests = tuple(
        (piece.graph.digest([*piece.new, *piece.upkeep]), len(piece.new), repr(piece[2:])) for piece in pieces
    )
    return Steps(
        kernel(("large", NEAR, repr(form), tuple(kinds), digests, repr(place)), 7, code.write), code.room, False
    )


class _Code:
    """The written code, and the places of the state: blocks of entries in rows of the workspace, matrices in z."""

    def __init__(
        self, form: LargeForm, kinds: Sequence[str], pieces: Sequence[LargeFunction], place: Mapping[str, Any]
    ):
        self.form, self.kinds, self.pieces, self.place = form, kinds, pieces, place
        self.h = form.h
        self.length = -(-self.h // WIDTH) * WIDTH
        if self.length > ALIASED and self.length % ALIASED == 0:
            self.length += 2 * WIDTH
        self.blocks, self.numbers, self.matrices = dict[str, int](), dict[str, int](), dict[str, tuple[int, int]]()
        at = 0
        for i, kind in enumerate(kinds):
            if kind == "matrix" or not form.blocks(kind):
                self.matrices[f"z{i}"] = at, form.size(kind)
                at += form.size(kind)
                continue
            for block in form.blocks(kind):
                (self.numbers if block == "t" else self.blocks)[f"z{i}{block}"] = at
                at += 1 if block == "t" else self.h
        for k in range(form.inverses):
            self.matrices[f"inverse{k}"] = at, self.h**2
            at += self.h**2
        self.size = at
        self.counts = {
            letter: max((where.stop for of, where in place.values() if of == letter), default=0) for letter in "cs"
        }
        # An upper bound: the rows of all entries, and of changes that wait.
        operations = sum(len(piece.graph.nodes) + 2 * len(piece.new + piece.upkeep) for piece in pieces)
        self.room = self.length * (operations + len(place) + 3 * len(kinds))

    def is_entry(self, letter: str) -> bool:
        """Whether an input is known entry by entry."""
        if letter[0] == "z":
            return letter[-1] != "t"
        name = letter.removeprefix("c_")
        return letter[0] == "c" and name != AXIS_NAME and self.form.roles.get(name, ("c", "turn"))[1] != "number"

    def write(self, f: Function) -> None:
        """The function of `Steps`."""
        frame, out, rows, every, _, first, last = f.arguments
        words = dict(zip(FRAME, f.integers(frame).get(len(FRAME)), strict=True))
        f.vectors(WIDTH)
        with f.loop(first, last) as lane:
            z = f.doubles(words["z"]).beyond(lane * self.size)
            c = f.doubles(words["c"]).beyond(lane * self.counts["c"])
            s = f.doubles(words["s"]).beyond(lane * words["stages"] * self.counts["s"])
            step = _Step(f, self, z, f.doubles(words["room"]))
            step.load(c)
            with f.loop(0, rows) as row:
                with f.loop(0, every):
                    with f.loop(0, words["stages"]) as stage:
                        step.run(0, s.beyond(stage * self.counts["s"]))
                    for number in range(1, len(self.pieces)):
                        step.run(number, s)
                step.settle()
                step.store(f.doubles(out).beyond((row * words["lanes"] + lane) * self.size), matrices=True)
            step.store(z)


def _inputs(graph: Graph, nodes: Sequence[int]) -> Iterator[tuple[int, str]]:
    """The inputs among nodes, and their letters."""
    return ((at, graph.nodes[at][1]) for at in nodes if graph.nodes[at][0] == IN)


def _changes(piece: LargeFunction) -> dict[Any, Sequence[Change]]:
    return {MOMENTUM: piece.pairs, **{k: inverse.changes for k, inverse in enumerate(piece.inverses)}}


class _Step:
    """The code of one lane: its rows, the scalars of its state, and what waits to be done to its matrices."""

    def __init__(self, f: Function, code: _Code, z: Memory, room: Memory):
        self.f, self.code, self.z, self._room, self._count = f, code, z, room, 0
        self.rows: list[dict[int, Memory]] = [{} for _ in code.pieces]
        self.fixed: list[dict[int, Value]] = [{} for _ in code.pieces]
        self.done: list[set[int]] = [set() for _ in code.pieces]  # the nodes that do not vary
        self.state = {letter: self.row() for letter in code.blocks}
        self.numbers = dict(zip(code.numbers, f.variables(len(code.numbers)), strict=True))
        self.waiting = {
            name: [(*f.variables(1), self.row(), self.row()) for _ in changes]
            for name, changes in _changes(code.pieces[0]).items()
        }

    def row(self) -> Memory:
        """A row of the workspace."""
        self._count += 1
        return self._room.beyond((self._count - 1) * self.code.length)

    def filled(self, source: Memory) -> Memory:
        """A row with the entries from memory, and 0 beyond them."""
        row = self.row()
        self.copy(source, row)
        with self.f.loop(self.code.h, self.code.length) as k:
            row[k] = 0.0
        return row

    def copy(self, source: Memory, target: Memory) -> None:
        """The h entries of a row."""
        with self.f.loop(0, self.code.h) as k:
            target[k] = source[k]

    def load(self, c: Memory) -> None:
        """The state from z, the constants, and what depends only on them."""
        for letter, at in self.code.blocks.items():
            self.copy(self.z.beyond(at), self.state[letter])
        for letter, at in self.code.numbers.items():
            self.numbers[letter][0] = self.z[at]
        for row in self.state.values():
            with self.f.loop(self.code.h, self.code.length) as k:
                row[k] = 0.0
        for changes in self.waiting.values():
            for scale, *vectors in changes:
                scale[0] = 0.0
                for vector in vectors:
                    with self.f.loop(0, self.code.length) as k:
                        vector[k] = 0.0
        known = {
            letter: self.filled(c.beyond(where.start)) if self.code.is_entry(letter) else c[where.start]
            for letter, (of, where) in self.code.place.items()
            if of == "c"
        }
        for number, piece in enumerate(self.code.pieces):
            self.done[number] = self._constants(piece, known, self.rows[number], self.fixed[number])

    def _constants(
        self, piece: LargeFunction, known: Mapping[str, Any], rows: dict[int, Memory], values: dict[int, Value]
    ) -> set[int]:
        graph = piece.graph
        nodes = graph.needed([*piece.new, *piece.upkeep])
        fixed = independent(graph, nodes, {*known})
        for at, letter in _inputs(graph, nodes):
            if letter in known:
                (rows if self.code.is_entry(letter) else values)[at] = known[letter]
            elif letter in self.state:
                rows[at] = self.state[letter]
        read = {x.at for at in nodes if at not in fixed for x in operands_of(graph.nodes[at])}
        read |= {x.at for x in [*piece.new, *piece.upkeep] if isinstance(x, Number)}
        stretch = Stretch(self, graph, [at for at in nodes if at in fixed and graph.nodes[at][0] != IN], rows, values)
        stretch.run(keep=[at for at in fixed if at in read])
        rows.update({at: row for at, row in stretch.rows.items() if at in read})
        values.update(stretch.values)
        return fixed

    def run(self, number: int, s: Memory) -> None:
        """A step, or what closes it."""
        piece, f, code = self.code.pieces[number], self.f, self.code
        graph, values, rows = piece.graph, dict(self.fixed[number]), self.rows[number]
        again = f.builder.append_basic_block("again")
        (attempt,) = f.variables(1, INTEGER)
        attempt[0] = 0
        f.builder.branch(again)
        f.builder.position_at_end(again)
        nodes = graph.needed([*piece.new, *piece.upkeep])
        for at, letter in _inputs(graph, nodes):
            if letter in self.numbers:
                values[at] = self.numbers[letter][0]
            elif letter[:2] == "s_":
                values[at] = s[code.place[letter][1].start]
        new = dict(zip(code.form.names, piece.new, strict=True))
        left = [at for at in nodes if graph.nodes[at][0] != IN and at not in self.done[number]]
        columns = f"z{code.kinds.index('matrix')}" if "matrix" in code.kinds else "none"
        of_columns = depending(graph, nodes, lambda letter: letter.startswith(columns))
        stretch = Stretch(self, graph, [at for at in left if at not in of_columns], rows, values)
        inner = [at for at in left if at in of_columns]
        late = [x.at for x in piece.upkeep if isinstance(x, Number)]
        late += [x.at for at in inner for x in operands_of(graph.nodes[at])]
        late += [x.at for name, x in new.items() if name not in self.state and isinstance(x, Number)]

        def at_last() -> None:
            self._put_off(_changes(piece), stretch)
            if inner:
                self._turn_columns(graph, nodes, inner, new, stretch)

        def test(done: Collection[int]) -> None:
            for k, inverse in enumerate(piece.inverses):
                if isinstance(inverse.residual, Number) and inverse.residual.at in done:
                    most = f.builder.fmul(constant(DOUBLE, NEAR), stretch.number(inverse.size))
                    poor = f.builder.fcmp_unordered(">", stretch.number(inverse.residual), most)
                    with f.where(f.builder.and_(poor, attempt[0].compared("==", 0))):
                        self._renew(k, stretch.entries_of(inverse.diagonal), stretch.number(inverse.turn))
                        attempt[0] = 1
                        f.builder.branch(again)

        stores = [(self.state[name], x) for name, x in new.items() if name in self.state]
        stretch.run({*late}, stores, at_last, test)
        for name, number_of_state in self.numbers.items():
            number_of_state[0] = stretch.number(new[name])

    def store(self, row: Memory, matrices: bool = False) -> None:
        """The state into a row."""
        for letter, at in self.code.blocks.items():
            self.copy(self.state[letter], row.beyond(at))
        for letter, at in self.code.numbers.items():
            row[at] = self.numbers[letter][0]
        for at, count in self.code.matrices.values() if matrices else ():
            with self.f.loop(at, at + count) as k:
                row[k] = self.z[k]

    # -- an orientation, by its vectors --------------------------------------------------------------

    def _turn_columns(
        self, graph: Graph, nodes: Sequence[int], inner: Sequence[int], new: Mapping[str, Operand], outer: Stretch
    ) -> None:
        code, f, h = self.code, self.f, self.code.h
        letter = f"z{code.kinds.index('matrix')}"
        at, _ = code.matrices[letter]
        size = code.form.size("vector")
        vectors = {f"{letter}{block}": self.row() for block in "xy"}
        with f.loop(0, code.form.n) as column:
            g = self.z.beyond(column * size + at)
            for i, row in enumerate(vectors.values()):
                self.copy(g.beyond(i * h), row)
            rows, values = dict(outer.rows), dict(outer.values)
            for node, name in _inputs(graph, nodes):
                if name in vectors:
                    rows[node] = vectors[name]
                elif name == f"{letter}t":
                    values[node] = g[2 * h]
            stretch = Stretch(self, graph, inner, rows, values)
            tail = new[f"{letter}t"]
            late = {tail.at} if isinstance(tail, Number) else set[int]()
            stretch.run(late, [(row, new[name]) for name, row in vectors.items()])
            for i, row in enumerate(vectors.values()):
                self.copy(row, g.beyond(i * h))
            g[2 * h] = stretch.number(tail)

    # -- a dense momentum M, its entries i < j, and kept inverses W ----------------------------------

    def times(
        self, name: Any, changed: bool, plain: Sequence[tuple[Memory, Memory]], turned: Sequence[tuple[Memory, Memory]]
    ) -> None:
        """y = M x or W x for pairs (x, y), v = W^T u for others; first the changes that wait, if they are to be made.

        The changes of a step wait for its first product in the next one: that saves a way through the matrix.
        """
        f, h, changes = self.f, self.code.h, self.waiting[name] if changed else []
        momentum = name == MOMENTUM
        matrix = self._matrix(name)
        (place,) = f.variables(1, INTEGER)
        place[0] = 0
        scattered = [y for _, y in plain] if momentum else [v for _, v in turned]
        for y in scattered:
            with f.loop(0, self.code.length) as k:
                y[k] = 0.0
        with f.loop(0, h - 1 if momentum else h) as i:
            start = i + 1 if momentum else f.integer(0)
            row, count = matrix.beyond(place[0]), f.integer(h) - start
            fmul = f.builder.fmul
            products = [(fmul(scale[0], x[i]), fmul(scale[0], y[i])) for scale, x, y in changes]
            later = [(x.beyond(start), y.beyond(start)) for _, x, y in changes]
            inputs = [(x[i], x.beyond(start), y.beyond(start)) for x, y in plain]
            backs = [(u[i], v) for u, v in turned]
            sums = [Sum(f) for _ in plain]

            def entries(j: Integer, kind: ir.Type) -> None:
                builder = f.builder
                m = row.beyond(j).of(kind)
                entry = m[0]
                for (e, g), (x, y) in zip(products, later, strict=True):
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

            along(f, count, entries)
            for total, (_, y) in zip(sums, plain, strict=True):
                y[i] = f.builder.fadd(y[i], total.value()) if momentum else total.value()
            place[0] = place[0] + count
        for scale, _, _ in changes:
            scale[0] = 0.0

    def _matrix(self, name: Any) -> Memory:
        letter = f"z{self.code.kinds.index('skew')}" if name == MOMENTUM else f"inverse{name}"
        return self.z.beyond(self.code.matrices[letter][0])

    def _put_off(self, changes: Mapping[Any, Sequence[Change]], stretch: Stretch) -> None:
        for name, each in changes.items():
            for change, (scale, x, y) in zip(each, self.waiting[name], strict=True):
                value = stretch.number(change.scale)
                scale[0] = self.f.builder.fneg(value) if change.x.negative != change.y.negative else value
                self.copy(stretch.entries_of(change.x), x)
                self.copy(stretch.entries_of(change.y), y)

    def settle(self) -> None:
        """Make the changes that wait."""
        for name, changes in self.waiting.items():
            if changes:
                self.times(name, True, [], [])

    def _renew(self, k: int, diagonal: Memory, turn: Value) -> None:
        """W = (diagonal + turn M)^-1; a state that is no longer finite is reported elsewhere.

        By elimination without pivoting, which is safe for a positive diagonal, as in `kreisel.algebra.solve`.
        """
        f, h, builder = self.f, self.code.h, self.f.builder
        M, W = self._matrix(MOMENTUM), self._matrix(k)
        (place,) = f.variables(1, INTEGER)
        place[0] = 0
        with f.loop(0, h) as i:
            W[i * h + i] = diagonal[i]
            with f.loop(i + 1, h) as j:
                entry = builder.fmul(turn, M[place[0]])
                W[i * h + j], W[j * h + i] = entry, builder.fneg(entry)
                place[0] = place[0] + 1
        with f.loop(0, h) as p:
            pivot = W.beyond(p * h)
            scale = builder.fdiv(constant(DOUBLE, 1.0), pivot[p])
            pivot[p] = 1.0

            def scaled(j: Integer, kind: ir.Type) -> None:
                at = pivot.beyond(j).of(kind)
                at[0] = builder.fmul(at[0], f.spread(scale, kind))

            along(f, f.integer(h), scaled)
            with f.loop(0, h) as i, f.where(i.compared("!=", p)):
                row = W.beyond(i * h)
                factor = row[p]
                row[p] = 0.0

                def eliminated(j: Integer, kind: ir.Type) -> None:
                    at = row.beyond(j).of(kind)
                    at[0] = builder.fsub(at[0], builder.fmul(f.spread(factor, kind), pivot.beyond(j).of(kind)[0]))

                along(f, f.integer(h), eliminated)
