"""Derivatives of a recorded step, compiled: many steps, their tangent map on columns, and its transpose.

A step is recorded once.  Its lines run again on numbers that remember what they were made of, whose local derivatives
are recorded too: forwards for the tangent map, all columns in one loop, backwards for the transpose.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from math import isqrt
from typing import Any, NamedTuple

import numpy as np

from kreisel import algebra
from kreisel.algebra import gradient
from kreisel.algebra.gradient import TracedNumber
from kreisel.algebra.reuse import cached_property
from kreisel.kernels.cache import load_kernel
from kreisel.kernels.layout import Floats
from kreisel.kernels.printing import Line, arranged, split
from kreisel.kernels.recording import indented, recorded_values
from kreisel.kernels.simd import HEAD, function_of_tuples
from kreisel.kernels.tape import TRANSCENDENTAL, Scalar, Tape, TooLong, source_of
from kreisel.kernels.threads import on_threads

MOST_LINES = 2500  # of a stage; its transpose has four times as many, compiled in some ten seconds
VECTOR = 4  # columns that a processor takes at once
PLAIN = (0.0, 1.0, -1.0)  # constants that are folded into the code

FORWARD = """
@compiled("f8[::1], f8[::1], f8[:,::1], f8[:,::1], i8, i8")
def forward(z, c, s, marks, every, part):
    x, known = numbers(z, (), {d}, ()), numbers(c, (), {constants}, ())
    parts = (every + part - 1) // part
    for mark in range(marks.shape[0]):
        for _ in range(part if (mark + 1) % parts else every - part * (parts - 1)):
{steps}
        put_numbers(marks, (mark,), x, ())
"""

PULL = """
@compiled("f8[::1], f8[::1], f8[:,::1], f8[:,::1], f8[::1], f8[::1], f8[:,::1], i8")
def pull(z, c, s, path, g, gc, gs, steps):
    x, known = numbers(z, (), {d}, ()), numbers(c, (), {constants}, ())
    w = numbers(g, (), {d}, ())
{begin}    i = 0
    for _ in range(steps):
{steps}
    for _ in range(steps):
{back}
    put_numbers(g, (), w, ())
{end}"""

PUSH = """
@compiled("f8[::1], f8[::1], f8[:,::1], f8[:,::1], f8[:,::1], f8[:,:,::1], f8[:,:,::1], i8")
def push(z, c, s, dz, dc, ds, out, every):
    x, known = numbers(z, (), {d}, ()), numbers(c, (), {constants}, ())
    for row in range(out.shape[0]):
        for _ in range(every):
{steps}
        for k in range(dz.shape[1]):
            put_numbers(out, (row,), numbers(dz, (), {d}, (k,)), (k,))
"""
STAGES = "for stage in range(s.shape[0]):"


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
    count = algebra.coordinate_count(kinds, n)
    flat = np.array([Scalar(tape, f"z{i}") for i in range(count)], dtype=object)
    try:
        given = {k: _named(tape, v) for k, v in known.items()}
        values = list(algebra.flatten(function(*algebra.restore(flat, kinds, n), **given), kinds))
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
        functions, steps = self._steps(())
        return self._kernel(functions, FORWARD, 12, steps).forward

    def _kernel(self, functions: str, text: str, indent: int, steps: list[str], **more: Any) -> Any:
        head = HEAD.format(name=f"a step of {self.dim} numbers and its derivative")
        sizes = {"d": self.dim, "constants": self.sizes[1]}
        kernel = text.format(**sizes, steps=indented(steps, indent), **more)
        return load_kernel(head + functions + kernel)

    @property
    def _parts(self) -> list[tuple[str, Record, dict[str, list[str]]]]:
        """The parts of a step by name, and what they take."""
        names = {letter: [f"{letter}{i}" for i in range(n)] for letter, n in zip("zcs", self.sizes, strict=True)}
        parts = [("step", self.stage, names)]
        return parts if self.close is None else [*parts, ("close", self.close, {**names, "s": []})]

    def _arguments(self, part: str) -> str:
        return f"x, known, numbers(s, (stage,), {self.sizes[2]}, ())" if part == "step" else "x, known, ()"

    def _steps(self, keep: Sequence[str]) -> tuple[str, list[str]]:
        """The functions of a step, and its lines, with `keep` before each part of it."""
        functions, text = "", []
        for name, record, given in self._parts:
            lines = arranged(list(record.lines), [v.strip("(-)") for v in record.new])
            functions += function_of_tuples(name, given, lines, list(record.new))
            block = [*keep, f"x = {name}({self._arguments(name)})"]
            text += [STAGES, *(f"    {line}" for line in block)] if name == "step" else block
        return functions, text

    def pull(self, wide: bool) -> Any:
        """(z, c, s, path, g, gc, gs, steps): g <- J^T g of some steps, gc and gs with it where `wide`.

        path (parts of all steps, d) is room.
        """
        if ("pull", wide) not in self._made:
            self._made["pull", wide] = self._pull(wide).pull
        return self._made["pull", wide]

    def _pull(self, wide: bool) -> Any:
        d, constants, of_stage = self.dim, self.sizes[1] * wide, self.sizes[2] * wide
        functions, steps = self._steps(("put_numbers(path, (i,), x, ())", "i += 1"))
        back: list[str] = []
        for name, record, given in reversed(self._parts):
            staged, found = name == "step", backward(record, self.sizes, wide)
            sums = [f"h{j}" for j in range(constants)] + [f"q{j}" for j in range(of_stage * staged)]
            old = [v.replace("h", "c").replace("q", "s") for v in sums]
            new = [found.outputs[f"z{i}"] for i in range(d)]
            new += [f"{v} + {found.outputs[slope]}" for v, slope in zip(sums, old, strict=True)]
            more = {"w": [f"w{i}" for i in range(d)], "h": sums[:constants], "q": sums[constants:]}
            given = {**given, **{letter: names for letter, names in more.items() if names}}
            functions += function_of_tuples(f"{name}_back", given, found.lines, new)
            own = staged and of_stage > 0
            slopes = (", h" if constants else "") + (f", numbers(gs, (stage,), {of_stage}, ())" if own else "")
            block = ["i -= 1", f"x = numbers(path, (i,), {d}, ())"]
            block += [f"v = {name}_back({self._arguments(name)}, w{slopes})", f"w = v[:{d}]"]
            block += [f"h = v[{d}:{d + constants}]"] if constants else []
            block += [f"put_numbers(gs, (stage,), v[{d + constants}:], ())"] if own else []
            back += ["for stage in range(s.shape[0] - 1, -1, -1):", *(f"    {v}" for v in block)] if staged else block
        begin = f"    h = numbers(gc, (), {constants}, ())\n" if constants else ""
        end = "    put_numbers(gc, (), h, ())\n" if constants else ""
        return self._kernel(functions, PULL, 8, steps, back=indented(back, 8), begin=begin, end=end)

    def push(self, wide: bool) -> Any:
        """(z, c, s, dz, dc, ds, out, every): columns dz (d, k) -> J dz + ..., and those at the rows of `out`."""
        if ("push", wide) not in self._made:
            self._made["push", wide] = self._push(wide).push
        return self._made["push", wide]

    def _push(self, wide: bool) -> Any:
        d, functions, text = self.dim, "", []
        for name, record, given in self._parts:
            found, staged = forward(record, self.sizes, wide), name == "step"
            slopes = {f"v{letter}": [f"v{v}" for v in given[letter]] for letter in ("zcs" if wide else "z")}
            moving = {v for group in slopes.values() for v in group}
            names = {v for line in found.lines for v in (*line.names, *line.needs)} - moving
            for line in found.lines:
                if not moving.isdisjoint(line.needs):
                    moving.update(line.names)
            fixed, rest = split(found.lines, names - moving)
            new = {d: [found.outputs[f"{d}z{i}"] for i in range(self.dim)] for d in ("", "d")}
            used = {v for line in rest for v in line.needs} | {v.strip("(-)") for v in new["d"]}
            handed = sorted(v for v in used - moving if v.isidentifier())
            functions += function_of_tuples(f"{name}_fixed", given, fixed, [*new[""], *handed])
            functions += function_of_tuples(f"{name}_moving", {"f": handed, **slopes}, rest, new["d"])
            columns = [f"numbers(dz, (), {d}, (k,))"]
            if wide:
                columns.append(f"numbers(dc, (), {self.sizes[1]}, (k,))")
                columns.append(f"numbers(ds, (stage,), {self.sizes[2]}, (k,))" if staged else "()")
            block = [
                f"y = {name}_fixed({self._arguments(name)})",
                f"x, f = y[:{d}], y[{d}:]",
                "for k in range(dz.shape[1]):",
                f"    put_numbers(dz, (), {name}_moving(f, {', '.join(columns)}), (k,))",
            ]
            text += [STAGES, *(f"    {line}" for line in block)] if staged else block
        return self._kernel(functions, PUSH, 12, text)

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
