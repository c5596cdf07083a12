"""A scheme's functions recorded for one n: what the kernels for CPU and GPU are printed from."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping
from typing import Any, NamedTuple

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.kernels.folding import folded
from kreisel.kernels.layout import Floats
from kreisel.kernels.printing import Line, arranged, split
from kreisel.kernels.recorded_array import RecordedMatrix
from kreisel.kernels.tape import Scalar, Tape, source_of
from kreisel.method.scheme import Part, Scheme

# A conjugate pair of Clebsch's system, n = 10, in 6700 lines: compiled in 35 s, run in 2.3 us; array code 28 s, 10 us.
STRAIGHT_LINE_N, STRAIGHT_LINES = 10, 7000
MIRRORS = {"skew": "mirror", "symmetric": "mirror_symmetric"}
LOADERS = {"skew": "skew", "symmetric": "symmetric", "matrix": "matrix", "vector": "vector", "scalar": "number"}
STORERS = {
    "skew": "store_skew",
    "symmetric": "store_symmetric",
    "matrix": "store",
    "vector": "store",
    "scalar": "store_number",
}


class RecordedFunction(NamedTuple):
    """A recorded function: its part, its lines, and the names of the new state."""

    part: Part
    lines: list[Line]
    new: list[str]

    @property
    def words(self) -> set[str]:
        """All names that lines and new state need."""
        return {n for line in self.lines for n in line.needs} | {n.strip("(-)") for n in self.new}

    def source(self, state: list[str], indent: int) -> str:
        """The lines, and the new state in place of the old."""
        lines = [part for line in self.lines for part in line.text.splitlines()]
        return indented([*lines, f"{', '.join(state)}, = {', '.join(self.new)},"], indent)


class Varying(NamedTuple):
    """Straight-line pieces in the order in which kernels do them: what does not vary with the step comes first.

    `early` and `late` are constants to be loaded before all steps and for each stage, `fixed` and `of_stage` the lines
    that need nothing else.
    """

    by_stage: bool
    early: list[str]
    fixed: list[Line]
    late: list[str]
    of_stage: list[Line]
    pieces: list[RecordedFunction]


class Recording:
    """A scheme's step and `close`, or its rate, on recording numbers: source for loading, the pieces and storing.

    Constants are called c, those that vary with the stage s.
    """

    def __init__(
        self,
        scheme: Scheme,
        constants: Floats,
        columns: Mapping[str, slice],
        stage_columns: Mapping[str, slice] | None = None,
    ):
        self.scheme, self.n = scheme, scheme.n
        self.columns = {"c": columns, "s": stage_columns or {}}
        self.kinds = scheme.kinds
        self.places: list[tuple[str, slice, str]] = []
        self.work = 0  # about how many operations a step is, whatever the numbers
        parts = scheme.parts
        straight = scheme.n <= STRAIGHT_LINE_N
        if straight:
            self._straight_line(parts, constants)
            straight = scheme.n == 3 or self._length() <= STRAIGHT_LINES
        if not straight:
            self._array_code(parts)

    def _length(self) -> int:
        return sum(len(line.text.splitlines()) for piece in self.pieces for line in piece.lines)

    def names(self, part: Part) -> list[str]:
        """The names of the state, and of what a part takes behind it, in straight-line code."""
        more = algebra.coordinate_count(part.more, self.n)
        return [*self.state, *(f"z{len(self.state) + i}" for i in range(more))]

    @property
    def straight(self) -> bool:
        """Whether it is scalar code without a loop, which can run on many lanes at once."""
        return not self.places and not any("\n" in line.text for piece in self.pieces for line in piece.lines)

    def used(self, letter: str) -> list[str]:
        """The constants of that letter that straight-line code needs."""
        return sorted((n for n in self.words if n[0] == letter and n[1:].isdigit()), key=lambda n: int(n[1:]))

    def count(self, letter: str) -> int:
        """How many constants of that letter there are."""
        return count_of(self.columns[letter])

    def varying(self) -> Varying:
        """The pieces without what does not vary from step to step."""
        by_stage = self.scheme.stage_count > 1
        constants, of_stages = self.used("c"), self.used("s")
        early, late = (constants, of_stages) if by_stage else ([*constants, *of_stages], [])
        fixed, pieces = _without(self.pieces, early)
        of_stage, pieces = _without(pieces, {*early, *late, *names_of(fixed)})
        return Varying(by_stage, early, fixed, late, of_stage, pieces)

    def _straight_line(self, parts: list[Part], constants: Floats) -> None:
        """Record scalar code."""
        count = algebra.coordinate_count(self.kinds, self.n)
        self.state = [f"z{i}" for i in range(count)]
        self.pieces: list[RecordedFunction] = []
        self.words: set[str] = set()
        numbers = special_constants(constants)
        for k, part in enumerate(parts):
            mark = "e" * k
            tape = Tape(mark)
            letters = {letter: self.columns[letter] for letter in part.letters}
            given, known = recorded_arguments(self.scheme, tape, letters, part.more)
            values = list(algebra.flatten(part.function(*given, **known), self.kinds))
            lines, new = recorded_values(tape, values)
            self.work += sum(len(line.text.splitlines()) for line in lines)
            if numbers:
                lines, new = folded(lines, new, numbers, f"f{mark}")
            self.pieces.append(RecordedFunction(part, lines, new))
            self.words |= self.pieces[-1].words

    def _array_code(self, parts: list[Part]) -> None:
        square = (self.n, self.n)
        shapes = {"skew": square, "symmetric": square, "matrix": square, "vector": (self.n,), "scalar": ()}
        self.state = [f"z{i}" for i in range(len(self.kinds))]
        self.pieces, self.work = [], 0
        for k, part in enumerate(parts):
            tape = Tape("e" * k)
            tape.shapes = {} if set(self.kinds) <= {"vector", "scalar"} else None
            given = [
                RecordedMatrix(tape, name, shapes[kind]) for name, kind in zip(self.state, self.kinds, strict=True)
            ]
            known = {
                name: RecordedMatrix(tape, f"{letter}_{name}", (self.n,) * self.scheme.axes[name])
                for letter in part.letters
                for name in self.columns[letter]
            }
            new = part.function(*given, **known)
            names = [
                f"{MIRRORS[kind]}({v.name})" if kind in MIRRORS else v.name
                for v, kind in zip(new, self.kinds, strict=True)
            ]
            outputs = [v.name for v in new]
            lines = tape.needed(outputs) if tape.shapes is None else tape.finished(outputs)
            self.pieces.append(RecordedFunction(part, lines, names))
            self.work += len(self.pieces[-1].lines) * self.n**2
        self.places = list(zip(self.kinds, algebra.slices(self.kinds, self.n), self.state, strict=True))

    def load(self, source: str, indent: int) -> str:
        """The state of array code from a row."""
        lines = [
            f"{name} = {LOADERS[kind]}({source}{place.start}:{place.stop}], {self.n})"
            for kind, place, name in self.places
        ]
        return indented(lines, indent)

    def load_constants(self, letter: str, source: str, indent: int) -> str:
        """The constants of that letter of array code from a row."""
        loaders = "number", "vector", "matrix"
        lines = [
            f"{letter}_{name} = {loaders[self.scheme.axes[name]]}({source}{place.start}:{place.stop}], {self.n})"
            for name, place in self.columns[letter].items()
        ]
        return indented(lines, indent)

    def body(self, indent: int) -> str:
        """The step or the rate."""
        return self.pieces[0].source(self.state, indent)

    def close(self, indent: int) -> str:
        """What ends a step with stages."""
        return "\n".join(piece.source(self.state, indent) for piece in self.pieces[1:])

    def save(self, target: str, indent: int) -> str:
        """The state of array code into a row."""
        lines = [f"{STORERS[kind]}({name}, {target}{place.start}:{place.stop}])" for kind, place, name in self.places]
        return indented(lines, indent)


def count_of(columns: Mapping[str, slice]) -> int:
    """How many numbers a row has in which constants stand like this."""
    return max((place.stop for place in columns.values()), default=0)


def names_of(lines: list[Line]) -> list[str]:
    """What the lines compute."""
    return [name for line in lines for name in line.names]


def _without(pieces: list[RecordedFunction], known: Collection[str]) -> tuple[list[Line], list[RecordedFunction]]:
    """The lines that need nothing but `known` names, and the pieces without them."""
    parts = [split(piece.lines, known) for piece in pieces]
    rest = [piece._replace(lines=others) for piece, (_, others) in zip(pieces, parts, strict=True)]
    return [line for lines, _ in parts for line in lines], rest


def indented(lines: list[str], indent: int) -> str:
    """Lines of source."""
    return "\n".join(" " * indent + line for line in lines)


def recorded_arguments(
    scheme: Scheme, tape: Tape, columns: Mapping[str, Mapping[str, slice]], more: tuple[str, ...] = ()
) -> tuple[tuple[Array, ...], dict[str, Array]]:
    """Recorded numbers in place of the state and of the constants, which are called by their letter.

    `more`: the kinds of what stands behind the state.
    """
    kinds = [*(kind for _, kind in scheme.components), *more]
    count = algebra.coordinate_count(kinds, scheme.n)
    flat = np.array([Scalar(tape, f"z{i}") for i in range(count)], dtype=object)
    known = {
        name: recorded_numbers(tape, letter, place, _shape(scheme, letter, name))
        for letter, places in columns.items()
        for name, place in places.items()
    }
    return algebra.restore(flat, kinds, scheme.n), known


def recorded_numbers(tape: Tape, letter: str, place: slice, shape: tuple[int, ...]) -> Any:
    """The numbers of a letter at a place, as an array of that shape."""
    return _shaped([Scalar(tape, f"{letter}{j}") for j in range(place.start, place.stop)], shape)


def _shape(scheme: Scheme, letter: str, name: str) -> tuple[int, ...]:
    """The shape of a constant, without the axes of lane and stage."""
    shape = np.shape(scheme.known[name] if letter == "c" else scheme.stages[name])
    return shape[len(shape) - scheme.axes[name] :]


def recorded_values(tape: Tape, values: list[Any]) -> tuple[list[Line], list[str]]:
    """The lines that these numbers depend on, and the source of each."""
    outputs = [v.name for v in values if isinstance(v, Scalar)]
    return arranged(tape.needed(outputs), outputs), [source_of(v) for v in values]


class Outputs(NamedTuple):
    """Recorded variables: lines, the source of each number, and of each variable its place and shape."""

    lines: list[Line]
    values: list[str]
    places: dict[str, tuple[slice, tuple[int, ...]]]


def recorded_outputs(
    scheme: Scheme, function: Callable[..., Mapping[str, Array]], constants: Mapping[str, slice]
) -> Outputs:
    """`function(parts, **constants)`, which returns variables by name, on recorded numbers."""
    tape = Tape()
    parts, known = recorded_arguments(scheme, tape, {"c": constants})
    values: list[Any] = []
    places = {}
    for name, value in function(parts, **known).items():
        array = np.asarray(value, dtype=object)
        places[name] = slice(len(values), len(values) + array.size), array.shape
        values += list(array.flat)
    return Outputs(*recorded_values(tape, values), places)


def recorded_function(
    function: Callable[..., Array], inputs: Mapping[str, tuple[int, ...]], constants: Mapping[str, tuple[int, ...]]
) -> tuple[list[Line], list[str], int]:
    """A function of arrays on recorded numbers, z... for the inputs, c... for the constants, by their shapes.

    Its lines, the source of each number of the result, and how many numbers go in.
    """
    tape = Tape()

    def recorded(letter: str, shapes: Mapping[str, tuple[int, ...]]) -> tuple[dict[str, Array], int]:
        out, start = {}, 0
        for name, shape in shapes.items():
            size = int(np.prod(shape))
            out[name] = _shaped([Scalar(tape, f"{letter}{j}") for j in range(start, start + size)], shape)
            start += size
        return out, start

    (given, count), (known, _) = recorded("z", inputs), recorded("c", constants)
    return *recorded_values(tape, list(function(**given, **known))), count


def _shaped(entries: list[Any], shape: tuple[int, ...]) -> Any:
    array: Any = np.array(entries, dtype=object).reshape(shape)
    return array[()]


def special_constants(constants: Floats) -> dict[str, float]:
    """The constants that are 0, 1 or -1 in every lane."""
    firsts = constants[0] if len(constants) else constants.sum(0)
    found = ((firsts == 0) | (abs(firsts) == 1)) & (constants == firsts).all(0)
    return {f"c{j}": float(firsts[j]) for j in found.nonzero()[0]}


def flat_constants(scheme: Scheme, lanes: int) -> tuple[Floats, dict[str, slice]]:
    """All constants as rows (lanes, count), and where each stands."""
    return columns_of(scheme.constants, scheme.axes, (lanes,))


def flat_stages(scheme: Scheme, lanes: int) -> tuple[Floats, dict[str, slice]]:
    """The constants of the stages as rows (lanes, stages, count), and where each stands."""
    return columns_of(scheme.stages, scheme.axes, (lanes, scheme.stage_count))


def columns_of(
    values: Mapping[str, Array], axes: Mapping[str, int], lead: tuple[int, ...]
) -> tuple[Floats, dict[str, slice]]:
    """Values with these axes of their own as rows (*lead, count), and where each stands."""
    columns, start = {}, 0
    for name, value in values.items():
        count = math.prod(np.shape(value)[np.ndim(value) - axes[name] :])
        columns[name] = slice(start, start + count)
        start += count
    rows = np.empty((*lead, start))
    fill(rows, columns, values, axes)
    return rows, columns


def fill(rows: Floats, columns: Mapping[str, slice], values: Mapping[str, Array], axes: Mapping[str, int]) -> None:
    """Write values with these axes of their own where they stand in `rows`."""
    for name, value in values.items():
        array = np.asarray(value)
        rows[..., columns[name]] = array.reshape((*array.shape[: array.ndim - axes[name]], -1))
