"""Derivatives of a recorded step, compiled: many steps, their tangent map on columns, and its transpose.

A step is recorded once.  Its lines run again on numbers that remember what they were made of, whose local derivatives
are recorded too: forwards for the tangent map, all columns in one loop, backwards for the transpose.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cached_property, lru_cache
from math import isqrt
from typing import Any, NamedTuple

import numpy as np

from kreisel.algebra import gradient
from kreisel.algebra.gradient import TracedNumber
from kreisel.kernels import layout
from kreisel.kernels.cpu import EXACT, HEAD, load_kernel
from kreisel.kernels.layout import Floats
from kreisel.kernels.printing import Line, arranged, split
from kreisel.kernels.recording import indented, recorded_values
from kreisel.kernels.tape import TRANSCENDENTAL, Scalar, Tape, TooLong, source_of
from kreisel.kernels.threads import on_threads

MOST_LINES = 2500  # of a stage; its transpose has four times as many, compiled in some ten seconds
VECTOR = 4  # columns that a processor takes at once
PLAIN = (0.0, 1.0, -1.0)  # constants that are folded into the code

FORWARD = """
@njit("void(f8[::1], f8[::1], f8[:,::1], f8[:,::1], i8, i8)", {options})
def forward(z, c, s, marks, every, part):
{load}
    parts = (every + part - 1) // part
    for mark in range(marks.shape[0]):
        for _ in range(part if (mark + 1) % parts else every - part * (parts - 1)):
{steps}
{save}
"""

PULL = """
@njit("void(f8[::1], f8[::1], f8[:,::1], f8[:,::1], f8[::1], f8[::1], f8[:,::1], i8)", {options})
def pull(z, c, s, path, g, gc, gs, steps):
{load}
    i = 0
    for _ in range(steps):
{steps}
{slopes}
    for _ in range(steps):
{back}
{store}
"""

PUSH = """
@njit("void(f8[::1], f8[::1], f8[:,::1], f8[:,::1], f8[:,::1], f8[:,:,::1], f8[:,:,::1], i8)", {options})
def push(z, c, s, dz, dc, ds, out, every):
{load}
    for row in range(out.shape[0]):
        for _ in range(every):
{steps}
        out[row] = dz
"""


class Record(NamedTuple):
    """Lines of z..., c... and s..., as recorded, and the source of each number of the new state."""

    lines: tuple[Line, ...]
    new: tuple[str, ...]


class Slopes(NamedTuple):
    """Lines, and the sources of what they give by name."""

    lines: list[Line]
    outputs: dict[str, str]


def recorded(
    function: Callable[..., Any], kinds: Sequence[str], n: int, known: Mapping[str, Any], most: int = MOST_LINES
) -> Record | None:
    """A step on recorded numbers, None where it has a loop, is too long or cannot be recorded.

    `known`: constants with the name of each recorded entry, a string, in place of its number.
    """
    tape = Tape(most=most)
    count = sum(layout.coordinate_count(kind, n) for kind in kinds)
    flat = np.array([Scalar(tape, f"z{i}") for i in range(count)], dtype=object)
    try:
        given = {k: _named(tape, v) for k, v in known.items()}
        values = list(layout.flatten(function(*layout.restore(flat, kinds, n), **given), kinds))
    except (TooLong, TypeError, AttributeError):
        return None
    lines = tape.needed([v.name for v in values if isinstance(v, Scalar)])
    if any("\n" in line.text for line in lines):
        return None
    return Record(tuple(lines), tuple(source_of(v) for v in values))


def _named(tape: Tape, x: Any) -> Any:
    array: Any = np.asarray(x)
    if array.dtype != object:
        return x
    out = np.empty(array.shape, dtype=object)
    for place in np.ndindex(array.shape):
        out[place] = Scalar(tape, array[place]) if isinstance(array[place], str) else array[place]
    return out[()]


@lru_cache(64)
def code_of(stage: Record, close: Record | None, constants: int, of_stage: int) -> Code:
    """The same object for the same step, so that JAX compiles what calls it once."""
    return Code(stage, close, constants, of_stage)


class Code:
    """Kernels of a step: `stage` once for each row of s, then `close`.  Compiled when they are first used."""

    def __init__(self, stage: Record, close: Record | None, constants: int, of_stage: int):
        self.stage, self.close, self.sizes = stage, close, (len(stage.new), constants, of_stage)
        self._made: dict[tuple[str, bool], Any] = {}

    @property
    def dim(self) -> int:
        """How many numbers a state has."""
        return self.sizes[0]

    @cached_property
    def forward(self) -> Any:
        """(z, c, s, marks, every, part): the state at the ends of parts of every so many steps."""
        return self._kernel(
            FORWARD.format(
                options=EXACT,
                load=self._load("z", 4) + "\n" + self._load("c", 4),
                steps=self._steps(12, ""),
                save=indented([f"marks[mark, {i}] = z{i}" for i in range(self.dim)], 8),
            )
        ).forward

    def _kernel(self, text: str) -> Any:
        return load_kernel(HEAD.format(name=f"a step of {self.dim} numbers and its derivative") + text)

    def _load(self, letter: str, indent: int, source: str = "{}[{}]") -> str:
        count = self.sizes["zcs".index(letter)]
        return indented([f"{letter}{i} = {source.format(letter, i)}" for i in range(count)], indent)

    def _steps(self, indent: int, keep: str) -> str:
        """A step, with `keep` before each part of it."""
        kept = keep.splitlines()

        def piece(record: Record, indent: int) -> str:
            lines = arranged(list(record.lines), [v.strip("(-)") for v in record.new])
            new = f"{_state(self.dim)} = {', '.join(record.new)},"
            return indented([*kept, *(line.text for line in lines), new], indent)

        text = [" " * indent + "for stage in range(s.shape[0]):", self._load("s", indent + 4, "{}[stage, {}]")]
        text.append(piece(self.stage, indent + 4))
        return "\n".join([*text, *([piece(self.close, indent)] if self.close else [])])

    def pull(self, wide: bool) -> Any:
        """(z, c, s, path, g, gc, gs, steps): g <- J^T g of some steps, gc and gs with it where `wide`.

        path (parts of all steps, d) is room.
        """
        if ("pull", wide) not in self._made:
            self._made["pull", wide] = self._kernel(self._pull_text(wide)).pull
        return self._made["pull", wide]

    def _pull_text(self, wide: bool) -> str:
        keep = "\n".join([*(f"path[i, {i}] = z{i}" for i in range(self.dim)), "i += 1"])
        constants = range(self.sizes[1] if wide else 0)
        h = [f"h{j}" for j in constants]

        def piece(record: Record, indent: int, staged: bool) -> str:
            found = backward(record, self.sizes, wide)
            lines = ["i -= 1", *(f"z{i} = path[i, {i}]" for i in range(self.dim)), *(line.text for line in found.lines)]
            new = [f"w{i}" for i in range(self.dim)]
            values = [found.outputs[f"z{i}"] for i in range(self.dim)]
            for j in constants:
                if found.outputs[f"c{j}"] != "0.0":
                    new.append(h[j])
                    values.append(f"{h[j]} + {found.outputs[f'c{j}']}")
            if staged and wide:
                lines += [f"gs[stage, {j}] += {found.outputs[f's{j}']}" for j in range(self.sizes[2])]
            return indented([*lines, f"{', '.join(new)}, = {', '.join(values)},"], indent)

        back = [piece(self.close, 8, False)] if self.close else []
        back += ["        for stage in range(s.shape[0] - 1, -1, -1):", self._load("s", 12, "{}[stage, {}]")]
        back.append(piece(self.stage, 12, True))
        slopes = [*(f"w{i} = g[{i}]" for i in range(self.dim)), *(f"{v} = gc[{j}]" for j, v in enumerate(h))]
        store = [*(f"g[{i}] = w{i}" for i in range(self.dim)), *(f"gc[{j}] = {v}" for j, v in enumerate(h))]
        return PULL.format(
            options=EXACT,
            load=self._load("z", 4) + "\n" + self._load("c", 4),
            steps=self._steps(8, keep),
            slopes=indented(slopes, 4),
            back="\n".join(back),
            store=indented(store, 4),
        )

    def push(self, wide: bool) -> Any:
        """(z, c, s, dz, dc, ds, out, every): columns dz (d, k) -> J dz + ..., and those at the rows of `out`."""
        if ("push", wide) not in self._made:
            self._made["push", wide] = self._kernel(self._push_text(wide)).push
        return self._made["push", wide]

    def _push_text(self, wide: bool) -> str:
        def piece(record: Record, indent: int, staged: bool) -> str:
            found = forward(record, self.sizes, wide)
            slopes = [f"v{letter}{i}" for letter, size in zip("zcs", self.sizes, strict=True) for i in range(size)]
            names = {n for line in found.lines for n in (*line.names, *line.needs)} - {*slopes}
            moving: set[str] = {*slopes}
            for line in found.lines:
                if not moving.isdisjoint(line.needs):
                    moving.update(line.names)
            fixed, rest = split(found.lines, names - moving)
            used = {n for line in rest for n in line.needs} | {v.strip("(-)") for v in found.outputs.values()}
            where = {"z": "dz[{}, k]", "c": "dc[{}, k]", "s": "ds[stage, {}, k]"}
            loads = [f"{n} = {where[n[1]].format(n[2:])}" for n in slopes if n in used]
            stores = [f"dz[{i}, k] = {found.outputs[f'dz{i}']}" for i in range(self.dim)]
            inner = indented([*loads, *(line.text for line in rest), *stores], indent + 4)
            new = f"{_state(self.dim)} = {', '.join(found.outputs[f'z{i}'] for i in range(self.dim))},"
            head = indented([*(line.text for line in fixed), "for k in range(dz.shape[1]):"], indent)
            return "\n".join([head, inner, " " * indent + new])

        steps = ["            for stage in range(s.shape[0]):", self._load("s", 16, "{}[stage, {}]")]
        steps.append(piece(self.stage, 16, True))
        steps += [piece(self.close, 12, False)] if self.close else []
        load = self._load("z", 4) + "\n" + self._load("c", 4)
        return PUSH.format(options=EXACT, load=load, steps="\n".join(steps))

    # -- rows of lanes -----------------------------------------------------------------------------

    def marks(self, z: Floats, c: Floats, s: Floats, rows: int, every: int, part: int) -> Floats:
        """The states (lanes, rows * parts, d) at the ends of parts."""
        out, kernel = np.empty((len(z), rows * -(-every // part), self.dim)), self.forward

        def work_on(first: int, last: int) -> None:
            for i in range(first, last):
                kernel(z[i], c[i], s[i], out[i], every, part)

        on_threads(len(z), len(z) * rows * every, work_on)
        return out

    def pushed(
        self, z: Floats, c: Floats, s: Floats, dz: Floats, dc: Floats, ds: Floats, rows: int, every: int
    ) -> Floats:
        """The tangents (lanes, k, rows, d) of the rows for those (lanes, k, ...) of the arguments."""
        kernel = self.push(dc.size + ds.size > 0)
        out = np.empty((*dz.shape[:2], rows, self.dim))
        for i in range(len(z)):
            columns = [_columns(v[i]) for v in (dz, dc, ds)]
            room = np.empty((rows, *columns[0].shape))
            kernel(z[i], c[i], s[i], *columns, room, every)
            out[i] = np.moveaxis(room, -1, 0)[: dz.shape[1]]
        return out

    def pulled(
        self, z: Floats, c: Floats, s: Floats, marks: Floats, g: Floats, every: int, part: int, wide: bool
    ) -> tuple[Floats, Floats, Floats]:
        """The slopes (lanes, k, ...) by z, c and s from those g (lanes, k, rows, d) by the rows."""
        kernel, parts = self.pull(wide), -(-every // part)
        gz, rows = np.zeros((*g.shape[:2], self.dim)), g.shape[2]
        gc, gs = np.zeros((*g.shape[:2], c.shape[1])), np.zeros((*g.shape[:2], *s.shape[1:]))
        path = np.empty((part * (s.shape[1] + (self.close is not None)), self.dim))
        for i, j in np.ndindex(*g.shape[:2]):
            starts = np.concatenate([z[i][None], marks[i]])
            for row in range(rows - 1, -1, -1):
                gz[i, j] += g[i, j, row]
                for k in range(parts - 1, -1, -1):
                    steps = part if k < parts - 1 else every - part * (parts - 1)
                    kernel(starts[row * parts + k], c[i], s[i], path, gz[i, j], gc[i, j], gs[i, j], steps)
        return gz, gc, gs


def part_of(every: int) -> int:
    """How many steps lie between two states that the reverse sweep keeps."""
    return max(1, isqrt(every))


def _columns(v: Floats) -> Floats:
    """Tangents (k, ...) as columns (..., k); where there are several, zeros fill the vectors of the processor."""
    more = -len(v) % VECTOR if len(v) > 1 else 0
    return np.ascontiguousarray(np.moveaxis(np.concatenate([v, np.zeros((more, *v.shape[1:]))]), 0, -1))


def _state(count: int) -> str:
    return "".join(f"z{i}, " for i in range(count)).rstrip()


# -- derivatives of a record -----------------------------------------------------------------------


def _max(x: Any, y: Any) -> Any:
    a, b = (v.value if isinstance(v, TracedNumber) else v for v in (x, y))
    first = (1 + (a - b).sign()) / 2
    return first * x + (1 - first) * y


FUNCTIONS: dict[str, Any] = {
    **{name: getattr(gradient, name) for name in TRANSCENDENTAL},
    "sqrt": lambda x: x.sqrt(),
    "fma": lambda x, y, z: x * y + z,
    "sign": lambda x: (x.value if isinstance(x, TracedNumber) else x).sign(),
    "max": _max,
}


def _traced(record: Record, sizes: Sequence[int], wide: bool) -> tuple[Tape, list[TracedNumber], list[Any]]:
    """The record on numbers that remember what they were made of; the first of them are z, and c and s if `wide`."""
    tape, nodes = Tape(), list[TracedNumber]()
    known: dict[str, Any] = dict(FUNCTIONS)
    for letter, size in zip("zcs", sizes, strict=True):
        for i in range(size):
            x = Scalar(tape, f"{letter}{i}")
            known[x.name] = TracedNumber(nodes, x) if wide or letter == "z" else x
    for line in record.lines:
        exec(line.text, known)
    return tape, nodes, [eval(v, known) for v in record.new]


def backward(record: Record, sizes: Sequence[int], wide: bool) -> Slopes:
    """The slopes by z, c, s from those w... by the new state."""
    tape, nodes, new = _traced(record, sizes, wide)
    slopes: list[Any] = [0] * len(nodes)
    for i, value in enumerate(new):
        if isinstance(value, TracedNumber):
            slopes[value.place] = slopes[value.place] + Scalar(tape, f"w{i}")
    for node in reversed(nodes):
        here = slopes[node.place]
        if isinstance(here, Scalar):
            for parent, slope in node.parents:
                slopes[parent.place] = slopes[parent.place] + here * slope
    names = [f"{letter}{i}" for letter, size in zip("zcs", sizes, strict=True) for i in range(size)]
    count = len(names) if wide else sizes[0]
    lines, sources = recorded_values(tape, slopes[:count])
    return Slopes(lines, dict(zip(names[:count], sources, strict=True)))


def forward(record: Record, sizes: Sequence[int], wide: bool) -> Slopes:
    """The new state z..., and its tangent dz... for those vz..., vc..., vs... of z, c and s."""
    tape, nodes, new = _traced(record, sizes, wide)
    letters = [f"v{letter}{i}" for letter, size in zip("zcs", sizes, strict=True) for i in range(size)]
    count = len(letters) if wide else sizes[0]
    tangents: list[Any] = [Scalar(tape, name) for name in letters[:count]]
    for node in nodes[count:]:
        tangents.append(sum((slope * tangents[parent.place] for parent, slope in node.parents), 0))
    own = [v.value if isinstance(v, TracedNumber) else v for v in new]
    slopes = [tangents[v.place] if isinstance(v, TracedNumber) else 0.0 for v in new]
    lines, sources = recorded_values(tape, [*own, *slopes])
    names = [f"{d}z{i}" for d in ("", "d") for i in range(sizes[0])]
    return Slopes(lines, dict(zip(names, sources, strict=True)))
