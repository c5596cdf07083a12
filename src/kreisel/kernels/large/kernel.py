"""The kernel of a step in a form of `kreisel.kernels.large.forms`, written level by level.

Entries lie in rows of a workspace, in complete vectors.  A loop over them represents each stretch between two sums over
all entries, or products with a dense matrix.  Vectors have the same width on every processor, and so sums the same
bits.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from llvmlite import ir

from kreisel.graph.arranging import independent
from kreisel.graph.graph import IN, Graph, Number, Operand, depending, operands_of
from kreisel.graph.llvm import DOUBLE, INTEGER, Function, Integer, Memory, Value, constant
from kreisel.graph.machine import kernel
from kreisel.kernels.large.forms import AXIS_NAME, Change, LargeForm, LargeFunction, recorded_large
from kreisel.kernels.large.stretch import WIDTH, Stretch, Sum, along
from kreisel.kernels.large.structured import MOMENTUM
from kreisel.kernels.steps import FRAME, Steps
from kreisel.method.scheme import Scheme

# Rows of 4096 bytes fall on the same places of the first cache: at n = 1000 a step took three times as long.
ALIASED = 64
# The largest residual of a solve, relative and squared.  A solve is corrected by its residual, once, so what is left of
# an error of 1e-9 is below round-off.  An inverse that follows the changes loses sqrt(steps) ulp: its
# residuals are 1e-14 after 65,000 steps (n = 10, eps = 0.05 to 5).
NEAR = 1e-18


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
