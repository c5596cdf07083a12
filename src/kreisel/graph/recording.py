"""A scheme's functions on recorded scalars: the graphs that every engine reads.

Inputs are called by a letter: z the state, c the constants of a scheme, s of its stages, p of a pair.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.graph.arranging import arranged, independent, length
from kreisel.graph.graph import IN, LOOP, NEVER, Graph, Number, Operand, TooLong
from kreisel.kernels.layout import Floats
from kreisel.method.scheme import Part, Scheme

# A conjugate pair of Clebsch's system, n = 10, of 6700 operations: compiled in 35 s, run in 2.3 us; on arrays 180 us.
STRAIGHT_LINE_N, STRAIGHT_LINES = 10, 7000
OF_VECTORS = 15_000  # operations of a chain: of 200 sites, compiled in 7 s, where the definition on arrays needs 3.5 ms
MOST = 40_000  # nodes before they are arranged


class Piece(NamedTuple):
    """A part of a step, recorded: its graph, unchanged to be compiled, and the new state."""

    part: Part
    graph: Graph
    outputs: list[Operand]

    @property
    def nodes(self) -> list[int]:
        """The nodes that the new state depends on, in order, inputs among them."""
        return self.graph.needed(self.outputs)


class Recording:
    """The functions of a scheme's motion, as straight-line code: loops are the only nodes with a graph inside.

    state   how many entries the state has
    columns where the constants of each letter are
    work    about how many operations a step is, whatever the constants
    Raises `TooLong` unless it is straight-line code of a moderate length.
    """

    def __init__(
        self,
        scheme: Scheme,
        constants: Floats,
        columns: Mapping[str, slice],
        stage_columns: Mapping[str, slice] | None = None,
    ):
        if scheme.n > STRAIGHT_LINE_N and not {*scheme.kinds} <= {"vector", "scalar"}:
            raise TooLong
        self.scheme = scheme
        self.columns = {"c": columns, "s": stage_columns or {}}
        self.state = algebra.coordinate_count(scheme.kinds, scheme.n)
        special = {("c", j): value for j, value in special_constants(constants).items()}
        self.work, self.pieces = 0, list[Piece]()
        for part in scheme.parts:
            graph, outputs = self._recorded(part)
            self.work += length(graph, outputs)
            self.pieces.append(Piece(part, *arranged(graph, outputs, special)))
        if scheme.n > 3 and self.length > (OF_VECTORS if scheme.n > STRAIGHT_LINE_N else STRAIGHT_LINES):
            raise TooLong

    def _recorded(self, part: Part) -> tuple[Graph, list[Operand]]:
        graph = Graph(MOST if self.scheme.n > 3 else math.inf)
        letters = {letter: self.columns[letter] for letter in part.letters}
        state, constants = recorded_arguments(self.scheme, graph, letters, part.arguments)
        return graph, list(algebra.flatten(part.function(*state, **constants), self.scheme.kinds))

    @property
    def length(self) -> int:
        """How many operations the graphs have."""
        return sum(operation_count(piece.graph, piece.outputs) for piece in self.pieces)

    @property
    def straight(self) -> bool:
        """Whether no loop ends earlier in some lanes, so that it can run on many lanes at once."""
        loops = ((piece.graph, piece.graph.nodes[at]) for piece in self.pieces for at in piece.nodes)
        return all(node[0] != LOOP or graph.loops[node[1]].small == NEVER for graph, node in loops)

    @property
    def stages(self) -> bool:
        """Whether a step has several stages."""
        return self.scheme.stage_count > 1

    def fixed(self, piece: Piece) -> set[int]:
        """The nodes of a piece that do not vary from step to step."""
        return independent(piece.graph, piece.nodes, "c" if self.stages else "cs")

    def of_stage(self, piece: Piece) -> set[int]:
        """The nodes of a piece that vary from stage to stage, and not from step to step."""
        return independent(piece.graph, piece.nodes, "cs") - self.fixed(piece) if self.stages else set()

    def count(self, letter: str) -> int:
        """How many constants of that letter there are."""
        return count_of(self.columns[letter])

    def digest(self) -> tuple[Any, ...]:
        """The operations, as a part of a kernel's key."""
        return tuple((piece.part.name, piece.graph.digest(piece.outputs)) for piece in self.pieces)


def operation_count(graph: Graph, outputs: Sequence[Operand]) -> int:
    """How many operations there are, inside loops and branches too."""
    nodes = graph.needed(outputs)
    bodies = [body for at in nodes if (body := graph.body_of(at)) is not None]
    return sum(graph.nodes[at][0] != IN for at in nodes) + sum(len(graph.needed_inside(body)) for body in bodies)


def count_of(columns: Mapping[str, slice]) -> int:
    """How many entries a row of constants with this layout has."""
    return max((place.stop for place in columns.values()), default=0)


def recorded_arguments(
    scheme: Scheme, graph: Graph, columns: Mapping[str, Mapping[str, slice]], arguments: tuple[str, ...] = ()
) -> tuple[tuple[Array, ...], dict[str, Array]]:
    """Recorded scalars in place of the state and of the constants, which are called by their letter.

    `arguments`: the kinds of the arguments after the state.
    """
    kinds = [*(kind for _, kind in scheme.components), *arguments]
    count = algebra.coordinate_count(kinds, scheme.n)
    constants = {
        name: recorded_numbers(graph, letter, place, _shape(scheme, letter, name))
        for letter, places in columns.items()
        for name, place in places.items()
    }
    return algebra.restore(graph.inputs("z", count), kinds, scheme.n), constants


def recorded_numbers(graph: Graph, letter: str, place: slice, shape: tuple[int, ...]) -> Any:
    """The entries of a letter at a place, as an array of that shape."""
    return graph.inputs(letter, place.stop - place.start, place.start).reshape(shape)[()]


def _shape(scheme: Scheme, letter: str, name: str) -> tuple[int, ...]:
    shape = np.shape(scheme.keywords[name] if letter == "c" else scheme.stages[name])
    return shape[len(shape) - scheme.axes[name] :]


class Outputs(NamedTuple):
    """Recorded variables: their entries, and the place and shape of each variable."""

    graph: Graph
    values: list[Operand]
    places: dict[str, tuple[slice, tuple[int, ...]]]


def recorded_outputs(
    scheme: Scheme, function: Callable[..., Mapping[str, Array]], constants: Mapping[str, slice]
) -> Outputs:
    """`function(parts, **constants)`, which returns variables by name, on recorded scalars."""
    graph = Graph()
    parts, scalars = recorded_arguments(scheme, graph, {"c": constants})
    values: list[Any] = []
    places = {}
    for name, value in function(parts, **scalars).items():
        array = np.asarray(value, dtype=object)
        places[name] = slice(len(values), len(values) + array.size), array.shape
        values += list(array.flat)
    return Outputs(*arranged(graph, as_operands(values)), places)


def recorded_function(
    function: Callable[..., Array], inputs: Mapping[str, tuple[int, ...]], constants: Mapping[str, tuple[int, ...]]
) -> tuple[Graph, list[Operand], int]:
    """A function of arrays on recorded scalars, z for the inputs, c for the constants, by their shapes.

    Its graph, the entries of the result, and how many entries go in.
    """
    graph = Graph()

    def recorded(letter: str, shapes: Mapping[str, tuple[int, ...]]) -> tuple[dict[str, Array], int]:
        out, start = {}, 0
        for name, shape in shapes.items():
            size = math.prod(shape)
            out[name] = recorded_numbers(graph, letter, slice(start, start + size), shape)
            start += size
        return out, start

    (arguments, count), (values, _) = recorded("z", inputs), recorded("c", constants)
    return *arranged(graph, as_operands(function(**arguments, **values))), count


def as_operands(values: Sequence[Any]) -> list[Operand]:
    """Numbers as they are, all else as floats."""
    return [x if isinstance(x, Number) else float(x) for x in values]


def special_constants(constants: Floats) -> dict[int, float]:
    """The constants that are 0, 1 or -1 in every lane, by their column."""
    firsts = constants[0] if len(constants) else constants.sum(0)
    special = ((firsts == 0) | (abs(firsts) == 1)) & (constants == firsts).all(0)
    return {int(j): float(firsts[j]) for j in special.nonzero()[0]}


def flat_constants(scheme: Scheme, lanes: int) -> tuple[Floats, dict[str, slice]]:
    """All constants as rows (lanes, count), and the place of each."""
    return columns_of(scheme.constants, scheme.axes, (lanes,))


def flat_stages(scheme: Scheme, lanes: int) -> tuple[Floats, dict[str, slice]]:
    """The constants of the stages as rows (lanes, stages, count), and the place of each."""
    return columns_of(scheme.stages, scheme.axes, (lanes, scheme.stage_count))


def constants_of(scheme: Scheme, row: Any, columns: Mapping[str, slice]) -> dict[str, Any]:
    """The constants of a row by name."""
    shapes = {name: (scheme.n,) * scheme.axes[name] for name in columns}
    return {name: row[place].reshape(shapes[name])[()] for name, place in columns.items()}


def columns_of(
    values: Mapping[str, Array], axes: Mapping[str, int], lead: tuple[int, ...]
) -> tuple[Floats, dict[str, slice]]:
    """Values with these axes as rows (*lead, count), and the place of each."""
    columns, start, arrays = {}, 0, [np.asarray(value) for value in values.values()]
    for name, array in zip(values, arrays, strict=True):
        outer = array.ndim - axes[name]
        count = math.prod(array.shape[outer:]) if outer else array.size
        columns[name] = slice(start, start + count)
        start += count
    rows = np.empty((*lead, start))
    fill(rows, columns, dict(zip(values, arrays, strict=True)), axes)
    return rows, columns


def fill(rows: Floats, columns: Mapping[str, slice], values: Mapping[str, Array], axes: Mapping[str, int]) -> None:
    """Write values with these axes to their places in `rows`."""
    for name, value in values.items():
        array = np.asarray(value)
        rows[..., columns[name]] = array.reshape((*array.shape[: array.ndim - axes[name]], -1))
