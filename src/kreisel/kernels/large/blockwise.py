"""The kernel of a step in a form of `kreisel.kernels.large.forms`, printed level by level.

A loop over the entries stands for each stretch between two sums over them, or products with a dense matrix.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import NamedTuple

from kreisel.kernels.large import products
from kreisel.kernels.large.basis import AXIS_NAME, TURN_NAME
from kreisel.kernels.large.forms import INVERSE, LargeForm, LargeFunction, recorded_large
from kreisel.kernels.large.levels import Levels, beyond, is_total
from kreisel.kernels.large.matrix_products import MatrixProducts
from kreisel.kernels.large.products import Upkeep
from kreisel.kernels.large.workspace import Workspace, WorkspaceRows
from kreisel.kernels.printing import Line, split
from kreisel.kernels.recording import indented
from kreisel.method.scheme import Scheme

VECTOR = 8  # entries of loops that are not sums: they go on up to a multiple, where what is beyond stays 0
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


class Places(NamedTuple):
    """Where the state stands in a row of z, and in the kernel."""

    blocks: list[tuple[int, int]]  # row of w and place in z
    numbers: list[tuple[str, int]]  # name and place in z
    matrices: list[tuple[str, int, int]]  # name, and first and last place in z, where they stay


class Printer:
    """The kernel of a scheme in a form, from the scheme as it was before it was put in this form."""

    def __init__(self, form: LargeForm, scheme: Scheme):
        self.form, self.scheme = form, scheme
        self.kinds = scheme.kinds
        self.names = form.names(self.kinds)
        self.end = form.h  # of the loops over the entries
        self.work = Workspace(form.h)
        self.products = MatrixProducts(self.work, f"z{self.kinds.index('skew')}" if "skew" in self.kinds else "")

    def __call__(
        self, columns: Mapping[str, slice], stage_columns: Mapping[str, slice], head: str, options: str
    ) -> str:
        """The source; `columns` say where each constant stands in its row."""
        pieces = [recorded_large(self.form, self.kinds, part) for part in self.scheme.parts]
        if "matrix" not in self.kinds and all(self._stays_zero(piece) for piece in pieces):
            self.end = -(-self.form.h // VECTOR) * VECTOR
        places = self._places()
        load = self._load(places, columns) + self.products.wait(pieces[0].upkeep) + self._views(places)
        fixed, varying = _constant_lines_apart(pieces, {f"c_{name}" for name in columns})
        once = self._printed(fixed, {name for piece in varying for name in _names_taken(piece)}, {})
        body, *close = [self._piece(piece) for piece in varying]
        stage = [f"s_{name} = s[lane, stage, {where.start}]" for name, where in stage_columns.items()]
        saved = [f"out[row, lane, {at}:{end}] = z[lane, {at}:{end}]" for _, at, end in places.matrices]
        save = [*self._put(places, "out[row, lane, "), *self.products.done(), *saved]
        imports = [f"from {module} import {name}\n" for name, module in self.products.functions.items()]
        return (
            head
            + "".join(imports)
            + KERNEL.format(
                total=SUM,
                options=options,
                room=self.work.size,
                load=indented(load, 8),
                once=indented(once, 8),
                stage=indented(stage, 20),
                body=indented(body, 20),
                close=indented([line for lines in close for line in lines], 16),
                save=indented(save, 12),
                store=indented(self._put(places, "z[lane, "), 8),
            )
        )

    def _places(self) -> Places:
        places, at, h = Places([], [], []), 0, self.form.h
        for i, kind in enumerate(self.kinds):
            if kind == "matrix" or not self.form.blocks(kind):
                places.matrices.append((f"z{i}", at, at + self.form.size(kind)))
                at += self.form.size(kind)
            for block in self.form.blocks(kind) if kind != "matrix" else ():
                if block == "t":
                    places.numbers.append((f"z{i}t", at))
                    at += 1
                else:
                    places.blocks.append((self.work.keep(f"z{i}{block}"), at))
                    at += h
        for k in range(self.form.inverses):
            places.matrices.append((f"{INVERSE}{k}", at, at + h * h))
            at += h * h
        return places

    def _load(self, places: Places, columns: Mapping[str, slice]) -> list[str]:
        """The state and the constants from their rows."""
        load = [f"    {self.work.entry(row)} = z[lane, {at} + k]" for row, at in places.blocks]
        numbers = [f"{name} = z[lane, {at}]" for name, at in places.numbers]
        for name, where in columns.items():
            if self._is_number(name):
                numbers.append(f"c_{name} = c[lane, {where.start}]")
            else:
                load.append(f"    {self.work.entry(self.work.keep(f'c_{name}'))} = c[lane, {where.start} + k]")
        return [f"for k in range({self.form.h}):", *load, *numbers]

    def _views(self, places: Places) -> list[str]:
        """The matrices, which stay in z."""
        square = f".reshape(({self.form.h}, {self.form.h}))"
        return [f"{name} = z[lane, {at}:{end}]{square * name.startswith(INVERSE)}" for name, at, end in places.matrices]

    def _put(self, places: Places, target: str) -> list[str]:
        """The state back into a row."""
        blocks = [f"    {target}{at} + k] = {self.work.entry(row)}" for row, at in places.blocks]
        return [f"for k in range({self.form.h}):", *blocks, *(f"{target}{at}] = {name}" for name, at in places.numbers)]

    def _stays_zero(self, piece: LargeFunction) -> bool:
        """Whether entries beyond the last, where state and constants are 0, change neither sums nor the state."""
        if piece.upkeep:
            return False
        blocks = [name for name in self.names if name[-1] != "t"]
        known: dict[str, float | None] = dict.fromkeys(blocks, 0.0)
        known |= {f"c_{name}": 0.0 for name in self.form.roles if not self._is_number(name)}
        known[f"c_{TURN_NAME}"] = 0.0
        try:
            for line in piece.lines:
                if is_total(line):
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

    def _piece(self, piece: LargeFunction) -> list[str]:
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
            (self.work.entry(self.work.keep(name)), f"{g}[column + {at * h} + k]") for at, name in enumerate(blocks[:2])
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
        """Numbers, then a loop over the entries, level by level.

        Entries that are `wanted` afterwards stay; the new state, `outputs`, is written in the last loop.  Where there
        is something `within`, which needs those names, its place is before that loop.
        """
        ends = {name: value for name, value in outputs.items() if name[-1] != "t" and value != name}
        levels = Levels(lines, self.work.stay, upkeep.vectors if upkeep else within, ends)
        rows, touched = WorkspaceRows(self.work, levels.used), set[str]()
        out: list[str] = []
        for at in range(levels.last + 1):
            here, is_last = levels.at(at), at == levels.last
            out += self.products.calls([line for line in here if products.matrix_of(line)], rows, touched)
            out += self._numbers(here, levels, rows)
            if upkeep:
                out += self.products.tests(upkeep, {n for line in here for n in line.names})
                out += self.products.put_off(upkeep, rows) if is_last else []
            out += [WITHIN] if within and is_last else []
            rows.release(at)
            out += self._loop(here, levels, rows, wanted, ends if is_last else {})
        numbers = {name: value for name, value in outputs.items() if name[-1] == "t" and value != name}
        if numbers:
            out.append(f"{', '.join(numbers)}, = {', '.join(numbers.values())},")
        return ["for attempt in range(2):", *(f"    {line}" for line in (*out, "break"))] if upkeep else out

    def _numbers(self, here: list[Line], levels: Levels, rows: WorkspaceRows) -> list[str]:
        """The lines of a level that are not in the loop: sums over the entries, and what comes from them."""
        out = []
        for line in here:
            if is_total(line):
                (source,) = line.needs
                first = rows.of(source) * self.work.length
                out.append(f"{line.names[0]} = total(w, {first}, {self.work.length})")
            elif line.names[0] not in levels.entry:
                out.append(line.text)
        return out

    def _loop(
        self, here: list[Line], levels: Levels, rows: WorkspaceRows, wanted: Collection[str], ends: Mapping[str, str]
    ) -> list[str]:
        """The loop of a level, which reads entries from w and leaves there what is needed later."""
        lines = [line for line in here if line.names[0] in levels.made]
        if not lines and not ends:
            return []
        inside = {line.names[0] for line in lines}
        needs = {n for line in lines for n in line.needs} | {v.strip("(-)") for v in ends.values()}
        block = [f"{n} = {rows.entry(n)}" for n in sorted(needs - inside) if n in levels.entry]
        block += [line.text for line in lines]
        for n in sorted(inside):
            if n in wanted or levels.outlives(n):
                row = self.work.keep(n) if n in wanted else rows.take(n)
                block.append(f"{self.work.entry(row)} = {n}")
        block += [f"{self.work.entry(self.work.stay[name])} = {value}" for name, value in ends.items()]
        return [f"for k in range({self.end}):", *(f"    {line}" for line in block)]


def _constant_lines_apart(
    pieces: list[LargeFunction], constant: Collection[str]
) -> tuple[list[Line], list[LargeFunction]]:
    """The lines that need constants only, and the pieces without them."""
    fixed: list[Line] = []
    varying = []
    for piece in pieces:
        once, rest = split(piece.lines, constant)
        fixed += once
        varying.append(piece._replace(lines=rest))
    return fixed, varying


def _names_taken(piece: LargeFunction) -> set[str]:
    """All names that a piece takes."""
    taken = {n for line in piece.lines for n in line.needs} | {v.strip("(-)") for v in piece.new}
    return taken | (piece.upkeep.words if piece.upkeep else set())
