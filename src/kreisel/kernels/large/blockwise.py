"""The kernel of a step in a form of `kreisel.kernels.large.forms`, printed level by level.

A loop over the entries stands for each stretch between two sums over them, or products with a dense matrix.
"""

from __future__ import annotations

import ast
from collections.abc import Collection, Iterable, Mapping

from kreisel.kernels.cpu import load
from kreisel.kernels.large import products
from kreisel.kernels.large.basis import AXIS_NAME, TURN_NAME
from kreisel.kernels.large.forms import INVERSE, Form, Piece, functions, recorded
from kreisel.kernels.large.products import Change, Function, Upkeep
from kreisel.kernels.printing import Line, split
from kreisel.kernels.recording import indented
from kreisel.method.scheme import Scheme

SUMMED = 16  # entries that a sum takes at a time: rows are filled with zeros, or what is left over costs most of it
# Rows of 4096 bytes fall on the same places of the first cache: at n = 1000 a step took three times as long.
ALIASED = 64
VECTOR = 8  # entries of the other loops likewise, where what is beyond stays 0
WITHIN = "# each vector of the orientation"

KERNEL = """
@njit("f8(f8[::1], i8, i8)", {total})  # or Numba would compile it anew for each number that it is called with
def total(w, first, count):
    out = 0.0
    for k in range(first, first + count):
        out += w[k]
    return out


@njit("void(f8[:,::1], f8[:,::1], f8[:,:,::1], f8[:,:,::1], i8, i8, i8)", {options})
def kernel(z, c, s, out, every, first, last):
    w = np.zeros({room})
    for lane in range(first, last):
{load}
{once}
        for row in range(out.shape[0]):
            for _ in range(every):
                for stage in range(s.shape[1]):
{stage}
{body}
{close}
{save}
{store}
"""
SUM = 'cache=True, nogil=True, error_model="numpy", fastmath={"reassoc", "nsz", "contract"}'


class Printer:
    """The kernel of a scheme in a form, from the scheme as it was before it was put in this form."""

    def __init__(self, form: Form, scheme: Scheme):
        self.form, self.scheme = form, scheme
        self.kinds = [kind for _, kind in scheme.components]
        self.names = form.names(self.kinds)
        self.end = form.h  # of the loops over the entries
        self.length = -(-form.h // SUMMED) * SUMMED  # of a row of w: beyond h stands 0
        if self.length > ALIASED and self.length % ALIASED == 0:
            self.length += SUMMED
        self.room: dict[str, int] = {}  # row of each entry that stays
        self.rows = 0
        self.entries: set[str] = set()
        self.functions: dict[str, str] = {}  # the modules of the products that are used, one for all n
        self.waiting: dict[str, tuple[Change, ...]] = {}  # what is still to be done to each dense matrix, by its name
        self.first: dict[str, tuple[Function, int, int]] = {}  # what does it in the next step, and how many products

    def __call__(
        self, columns: Mapping[str, slice], stage_columns: Mapping[str, slice], head: str, options: str
    ) -> str:
        """The source; `columns` say where each constant stands in its row."""
        pieces = [recorded(self.form, self.kinds, *function) for function in functions(self.scheme)]
        h, place = self.form.h, 0
        if "matrix" not in self.kinds and all(self._stays_zero(piece) for piece in pieces):
            self.end = -(-h // VECTOR) * VECTOR
        copies: list[tuple[int, int]] = []  # row of w and place in z of each block
        numbers: list[tuple[str, int]] = []
        matrices: list[tuple[str, int, int]] = []  # that stay in z
        for i, kind in enumerate(self.kinds):
            if kind == "matrix" or not self.form.blocks(kind):
                matrices.append((f"z{i}", place, place + self.form.size(kind)))
                place += self.form.size(kind)
            for block in self.form.blocks(kind) if kind != "matrix" else ():
                if block == "t":
                    numbers.append((f"z{i}t", place))
                    place += 1
                else:
                    copies.append((self._keep(f"z{i}{block}"), place))
                    place += h
        for k in range(self.form.inverses):
            matrices.append((f"{INVERSE}{k}", place, place + h * h))
            place += h * h
        load = [f"    w[{row * self.length} + k] = z[lane, {at} + k]" for row, at in copies]
        given = [f"{name} = z[lane, {at}]" for name, at in numbers]
        for name, where in columns.items():
            if self._is_number(name):
                given.append(f"c_{name} = c[lane, {where.start}]")
            else:
                load.append(f"    w[{self._keep(f'c_{name}') * self.length} + k] = c[lane, {where.start} + k]")

        self._wait(pieces[0].upkeep)
        for changes in self.waiting.values():
            given += [f"{c.scale} = 0.0" for c in changes]
            given += [f"{self._vector(name)} = 0.0" for c in changes for name in (c.x, c.y)]
        for name, at, end in matrices:
            given.append(f"{name} = z[lane, {at}:{end}]{f'.reshape(({h}, {h}))' * name.startswith(INVERSE)}")

        def put(target: str) -> list[str]:
            blocks = [f"    {target}{at} + k] = w[{row * self.length} + k]" for row, at in copies]
            return [f"for k in range({h}):", *blocks, *(f"{target}{at}] = {name}" for name, at in numbers)]

        stage = [f"s_{name} = s[lane, stage, {where.start}]" for name, where in stage_columns.items()]
        constant = {f"c_{name}" for name in columns}
        fixed: list[Line] = []
        bodies = []
        for piece in pieces:
            once, rest = split(piece.lines, constant)
            fixed += once
            bodies.append(piece._replace(lines=rest))
        wanted = {n for piece in bodies for line in piece.lines for n in line.needs}
        for piece in bodies:
            wanted |= {v.strip("(-)") for v in piece.new} | (piece.upkeep.words if piece.upkeep else set())
        first = self._printed(fixed, wanted, {})
        body, *close = [self._piece(piece) for piece in bodies]
        saved = self._done() + [f"out[row, lane, {at}:{end}] = z[lane, {at}:{end}]" for _, at, end in matrices]
        imports = [f"from {module} import {name}\n" for name, module in self.functions.items()]
        return (
            head
            + "".join(imports)
            + KERNEL.format(
                total=SUM,
                options=options,
                room=self.rows * self.length,
                load=indented([f"for k in range({h}):", *load, *given], 8),
                once=indented(first, 8),
                stage=indented(stage, 20),
                body=indented(body, 20),
                close=indented([line for lines in close for line in lines], 16),
                save=indented([*put("out[row, lane, "), *saved], 12),
                store=indented(put("z[lane, "), 8),
            )
        )

    def _stays_zero(self, piece: Piece) -> bool:
        """Whether entries beyond the last, where state and constants are 0, change neither sums nor the state."""
        if piece.upkeep:
            return False
        blocks = [name for name in self.names if name[-1] != "t"]
        known: dict[str, float | None] = dict.fromkeys(blocks, 0.0)
        known |= {f"c_{name}": 0.0 for name in self.form.roles if not self._is_number(name)}
        known[f"c_{TURN_NAME}"] = 0.0
        try:
            for line in piece.lines:
                if _is_total(line):
                    if known.get(line.needs[0], 0.0) != 0:
                        return False
                elif not known.keys().isdisjoint(line.needs):
                    known[line.names[0]] = beyond(line, known)
        except ValueError:
            return False
        ends = dict(zip(self.names, piece.new, strict=True))
        return all(known.get(ends[name].strip("(-)")) == 0 for name in blocks)

    def _is_number(self, name: str) -> bool:
        return name == AXIS_NAME or self.form.roles.get(name, ("c", "turn"))[1] == "number"

    def _keep(self, name: str) -> int:
        self.entries.add(name)
        self.room[name] = self.rows
        self.rows += 1
        return self.room[name]

    def _piece(self, piece: Piece) -> list[str]:
        """The source of a step or of `close`; what is done to each vector of an orientation stands in a loop."""
        outputs = dict(zip(self.names, piece.new, strict=True))
        if "matrix" not in self.kinds:
            return self._printed(piece.lines, set(), outputs, piece.upkeep)
        g = f"z{self.kinds.index('matrix')}"
        blocks = [f"{g}{block}" for block in self.form.blocks("matrix")]
        own, inner, lines = set(blocks), list[Line](), list[Line]()
        for line in piece.lines:
            (lines if own.isdisjoint(line.needs) else inner).append(line)
            own.update(() if own.isdisjoint(line.needs) else line.names)
        turned = {name: outputs.pop(name) for name in blocks}
        given = {n for line in inner for n in line.needs} | {v.strip("(-)") for v in turned.values()}
        out = self._printed(lines, given - own, outputs, within=given - own)
        h, size = self.form.h, self.form.size("vector")
        places = [
            (f"w[{self._keep(name) * self.length} + k]", f"{g}[column + {at * h} + k]")
            for at, name in enumerate(blocks[:2])
        ]
        text = [
            f"for column in range(0, {self.form.n * size}, {size}):",
            f"    for k in range({h}):",
            *(f"        {here} = {there}" for here, there in places),
            f"    {blocks[2]} = {g}[column + {2 * h}]",
            *(f"    {line}" for line in self._printed(inner, set(), turned)),
            f"    for k in range({h}):",
            *(f"        {there} = {here}" for here, there in places),
            f"    {g}[column + {2 * h}] = {blocks[2]}",
        ]
        at = out.index(WITHIN)
        return [*out[:at], *text, *out[at + 1 :]]

    def _printed(
        self,
        lines: list[Line],
        wanted: Collection[str],
        outputs: Mapping[str, str],
        upkeep: Upkeep | None = None,
        within: Collection[str] = (),
    ) -> list[str]:
        """Numbers, then a loop over the entries, level by level; a sum over the entries or a product ends a level.

        Entries that are `wanted` afterwards stay; the new state, `outputs`, is written in the last loop.  Where there
        is something `within`, which needs those names, its place is before that loop.
        """
        entry = set(self.entries)
        for line in lines:
            if not _is_total(line) and not entry.isdisjoint(line.needs):
                entry.add(line.names[0])
        late = upkeep.vectors if upkeep else {n for n in within if n in entry}
        level, last = _levels(lines, late)
        ends = {name: value for name, value in outputs.items() if name[-1] != "t" and value != name}
        used: dict[str, float] = dict.fromkeys(late, last - 0.5)  # the last level at which an entry is needed
        for line in lines:
            at = level[line.names[0]] - (0.5 if _ends_level(line) else 0)
            for n in line.needs:
                used[n] = max(used.get(n, 0), at)
        for value in ends.values():
            used[value.strip("(-)")] = last
        made = {name for line in lines for name in line.names if name in entry and not _ends_level(line)}
        kept = {n for n in made if used.get(n, 0) > level[n] or n in wanted}
        free: list[int] = []
        done: set[str] = set()
        held: dict[str, int] = {}
        out: list[str] = []
        touched: set[str] = set()
        for at in range(last + 1):
            here = [line for line in lines if level[line.names[0]] == at]
            out += self._products([line for line in here if products.matrix_of(line)], held, free, touched)
            for n in [n for n in held if n not in done and used.get(n, 0) < at]:
                free.append(held[n])  # a sum at this level still reads it, before the loop
                done.add(n)
            for line in here:
                if _is_total(line):
                    (source,) = line.needs
                    out.append(f"{line.names[0]} = total(w, {self._row(source, held) * self.length}, {self.length})")
                elif line.names[0] not in entry:
                    out.append(line.text)
            if upkeep:
                out += self._tests(upkeep, {n for line in here for n in line.names})
                out += self._upkeep(upkeep, held) if at == last else []
            out += [WITHIN] if within and at == last else []
            loop = [line for line in here if line.names[0] in made]
            here_ends = ends if at == last else {}
            if not loop and not here_ends:
                continue
            inside = {line.names[0] for line in loop}
            needs = {n for line in loop for n in line.needs} | {v.strip("(-)") for v in here_ends.values()}
            block = [f"{n} = w[{self._row(n, held) * self.length} + k]" for n in sorted(needs - inside) if n in entry]
            block += [line.text for line in loop]
            for n in sorted(inside & kept):
                if n in wanted:
                    row = self._keep(n)
                else:
                    row = held[n] = free.pop() if free else self._new_row()
                block.append(f"w[{row * self.length} + k] = {n}")
            block += [f"w[{self.room[name] * self.length} + k] = {value}" for name, value in here_ends.items()]
            out += [f"for k in range({self.end}):", *(f"    {line}" for line in block)]
        numbers = {name: value for name, value in outputs.items() if name[-1] == "t" and value != name}
        if numbers:
            out.append(f"{', '.join(numbers)}, = {', '.join(numbers.values())},")
        return ["for attempt in range(2):", *(f"    {line}" for line in (*out, "break"))] if upkeep else out

    def _vector(self, name: str, held: Mapping[str, int] | None = None) -> str:
        start = self._row(name, held or {}) * self.length
        return f"w[{start}:{start + self.form.h}]"

    def _call(self, function: Function, matrix: str, arguments: Iterable[str]) -> str:
        self.functions[function.name] = load(function.source).__name__
        return f"{function.name}({', '.join([matrix, *arguments])})"

    def _products(self, lines: list[Line], held: dict[str, int], free: list[int], touched: set[str]) -> list[str]:
        """The products of a level, one call for each matrix, the first with what waits; rows are made for them."""
        for line in lines:
            held[line.names[0]] = free.pop() if free else self._new_row()
        out = []
        for matrix in dict.fromkeys(map(products.matrix_of, lines)):
            own = [line for line in lines if products.matrix_of(line) == matrix]
            name = self._momentum if matrix == "M" else f"{INVERSE}{matrix}"
            changes = () if name in touched else self.waiting[name]
            touched.add(name)
            turned = [line for line in own if products.is_turned(line)]
            plain = [line for line in own if line not in turned]
            arguments = self._arguments(changes)
            for group in (plain, turned):
                arguments += [self._vector(line.needs[0], held) for line in group]
                arguments += [self._vector(line.names[0], held) for line in group]
            counts = len(changes), len(plain), len(turned)
            function = products.momentum_times(*counts[:2]) if matrix == "M" else products.inverse_times(*counts)
            out += [self._call(function, name, arguments), *(f"{c.scale} = 0.0" for c in changes)]
            if changes:
                self.first.setdefault(name, (function, len(plain), len(turned)))
        return out

    def _arguments(self, changes: tuple[Change, ...]) -> list[str]:
        vectors = [self._vector(name) for letter in "xy" for name in (getattr(c, letter) for c in changes)]
        return [*(c.scale for c in changes), *vectors]

    def _tests(self, upkeep: Upkeep, known: Collection[str]) -> list[str]:
        """Inverses that have become too poor are made anew, and the step is done again."""
        out = []
        for k, inverse in enumerate(upkeep.inverses):
            residual, size = inverse.check
            if residual in known:
                diagonal = inverse.diagonal
                full = self._vector(diagonal) if diagonal in self.room else f"full({self.form.h}, {diagonal})"
                renew = self._call(products.renewed(), self._momentum, [full, inverse.turn, f"{INVERSE}{k}"])
                out += [f"if attempt == 0 and not {residual} <= {products.NEAR!r} * {size}:"]
                out += [f"    {renew}", "    continue"]
        return out

    def _wait(self, upkeep: Upkeep | None) -> None:
        """Places for the changes of a step, which go with the next product: that saves a way through the matrix."""
        for name, changes in self._changes(upkeep).items():
            places = []
            for k in range(len(changes)):
                places.append(Change(*(f"{letter}{k}_{name}" for letter in "cxy")))
                for vector in places[-1][1:]:
                    self._keep(vector)
            self.waiting[name] = tuple(places)

    def _changes(self, upkeep: Upkeep | None) -> dict[str, tuple[Change, ...]]:
        if upkeep is None:
            return {}
        inverses = {f"{INVERSE}{k}": inverse.changes for k, inverse in enumerate(upkeep.inverses)}
        return {self._momentum: upkeep.pairs, **inverses}

    def _upkeep(self, upkeep: Upkeep, held: Mapping[str, int]) -> list[str]:
        """Put the changes of this step where they wait."""
        out, loop = [], []
        for name, changes in self._changes(upkeep).items():
            for change, place in zip(changes, self.waiting[name], strict=True):
                out.append(f"{place.scale} = {change.scale}")
                for source, to in zip(change[1:], place[1:], strict=True):
                    rows = (self.room[to] * self.length, self._row(source, held) * self.length)
                    loop.append("    w[{} + k] = w[{} + k]".format(*rows))
        return [*out, f"for k in range({self.form.h}):", *loop]

    def _done(self) -> list[str]:
        """What waits is done, by the function of the next step, whose bits they then are wherever the rows are cut."""
        out = []
        for name, changes in self.waiting.items():
            if changes:
                function, *counts = self.first[name]
                arguments, read = self._arguments(changes), self._vector(changes[0].x)
                for count in counts:
                    rows = [self._new_row() * self.length for _ in range(count)]
                    arguments += [read] * count + [f"w[{row}:{row + self.form.h}]" for row in rows]
                out += [self._call(function, name, arguments), *(f"{c.scale} = 0.0" for c in changes)]
        return out

    @property
    def _momentum(self) -> str:
        return f"z{self.kinds.index('skew')}"

    def _row(self, name: str, held: Mapping[str, int]) -> int:
        return held[name] if name in held else self.room[name]

    def _new_row(self) -> int:
        self.rows += 1
        return self.rows - 1


def beyond(line: Line, known: Mapping[str, float | None]) -> float | None:
    """The value of an entry where others have the `known` values, None for one that may be any finite number.

    Raises `ValueError` where it may be no number.
    """
    tree = ast.parse(line.text.partition(" = ")[2], mode="eval").body

    def value(node: ast.expr) -> tuple[float | None, bool]:
        """And whether it is an entry."""
        match node:
            case ast.Constant(float(number) | int(number)):
                return float(number), False
            case ast.Name(name):
                return (known[name], True) if name in known else (None, False)
            case ast.UnaryOp(ast.USub(), x):
                v, entry = value(x)
                return None if v is None else -v, entry
            case ast.BinOp(x, ast.Mult(), y):
                return times(value(x), value(y))
            case ast.BinOp(x, ast.Add() | ast.Sub() as operator, y):
                return plus(value(x), value(y), 1 if isinstance(operator, ast.Add) else -1)
            case ast.BinOp(x, ast.Div(), y):
                (a, one), (b, other) = value(x), value(y)
                if b == 0 or (b is None and other):
                    raise ValueError
                return (0.0 if a == 0 else None if a is None or b is None else a / b), one or other
            case ast.Call(ast.Name("fma"), [x, y, z]):
                return plus(times(value(x), value(y)), value(z), 1)
        raise ValueError

    def times(x: tuple[float | None, bool], y: tuple[float | None, bool]) -> tuple[float | None, bool]:
        (a, one), (b, other) = x, y
        return (0.0 if 0 in (a, b) else None if a is None or b is None else a * b), one or other

    def plus(x: tuple[float | None, bool], y: tuple[float | None, bool], sign: int) -> tuple[float | None, bool]:
        (a, one), (b, other) = x, y
        return (None if a is None or b is None else a + sign * b), one or other

    return value(tree)[0]


def _is_total(line: Line) -> bool:
    return " = total(" in line.text


def _ends_level(line: Line) -> bool:
    """A sum or a product, which needs all entries of what it takes."""
    return _is_total(line) or products.matrix_of(line) != ""


def _levels(lines: list[Line], late: Collection[str]) -> tuple[dict[str, int], int]:
    """The level of each line and the last one; `late` is needed in full at the last.

    Products with one matrix share a level where they can: one that may wait does, for one that may not.
    """
    free_to: dict[str, int] = {}  # no earlier than
    for again in (True, False):
        level: dict[str, int] = {}
        for line in lines:
            deep = max((level.get(n, 0) for n in line.needs), default=0)
            level[line.names[0]] = max(deep + _ends_level(line), free_to.get(line.names[0], 0))
        last = max([*level.values(), *(level.get(n, 0) + 1 for n in late)], default=0)
        if again:
            latest = dict.fromkeys(level, last) | dict.fromkeys(late, last - 1)
            for line in reversed(lines):
                for n in line.needs:
                    latest[n] = min(latest.get(n, last), latest[line.names[0]] - _ends_level(line))
            taken = [line for line in lines if products.matrix_of(line)]
            for line in taken:
                name, matrix = line.names[0], products.matrix_of(line)
                fixed = [other.names[0] for other in taken if products.matrix_of(other) == matrix]
                at = [level[n] for n in fixed if level[n] == latest[n] and level[name] <= level[n] <= latest[name]]
                free_to[name] = min(at, default=0)
    return level, last
