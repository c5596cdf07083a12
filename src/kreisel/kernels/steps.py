"""The kernel of a map: the step on scalars, or on vectors of lanes; the state stays in registers.

In an ensemble each number of the graph becomes a vector; lane i has the bits of a single run.  A short step needs
two or four vectors, one after the other in the same loop: while one waits for a result, the others continue.  At a
ragged end the last lane is in the places that are left.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from llvmlite import ir

from kreisel.graph.arranging import latest
from kreisel.graph.graph import IN, Graph, Number, Operand, operands_of
from kreisel.graph.llvm import Function, Integer, Lanes, Memory, Value, kind_of
from kreisel.graph.machine import Kernel, kernel, register_width
from kreisel.graph.recording import Piece, Recording

# Nanoseconds a lane-step with 1, 2, 4, 8 vectors, AVX2, n = 3: lagrange-top (32 operations) 1.9, 0.94, 0.61, 0.66; its
# moving frame (90) 2.5, 1.3, 0.89, -; clebsch (43) 3.9, 2.0, 1.4, 1.5; neumann (65) -, 3.2, 3.4, 3.6; baecklund of
# order 2 (93) -, 3.3, 3.2, 3.8, of order 8 (233 a stage) 24, 18, 16, -; n = 5: lagrange-top (143) 9.0, 8.8, 7.5, -.
# Each more needs longer to compile.  Operations of all four alternate, as a processor looks only some hundred of them
# ahead: kovalevskaya-gyrostat (67) 3.2 and 3.5 with two of them, ratiu-top (46) 2.4 and 2.7, kovalevskaya-top-e3 (56)
# 3.0 and 3.5; n = 5: lagrange-top (117) 7.0 and 7.6; shorter ones differ by 2 %.  1 and 2 vectors, Zen 3: moving frame,
# n = 6 (456) 40 and 36; baecklund, n = 5 (521) 52 and 51; a perturbed top by order (10, 2) (about 550) 56 and 50.
FOUR_VECTORS, TWO_VECTORS = 120, 600  # most operations of a step in this count of vectors; beyond, in recorded order

# The words of a frame, which an engine keeps: addresses of the rows z (lanes, d), c (lanes, constants) and
# s (lanes, stages, constants), and of room for scalars of the stages; how many lanes and stages; steps between two
# projections, the address of the projection, of its table and of its room.
FRAME = ("z", "c", "s", "room", "lanes", "stages", "interval", "project", "table", "project_room")


class Split(NamedTuple):
    """The nodes of a piece in three groups: constant, varying with the stage, varying with the step.

    kept_fixed, kept   of the first two those that varying ones read
    """

    piece: Piece
    fixed: list[int]
    of_stage: list[int]
    kept_fixed: list[int]
    kept: list[int]
    varying: list[int]

    @classmethod
    def of(cls, record: Recording, piece: Piece) -> Split:
        """The split of a piece of a record."""
        nodes, fixed, of_stage = piece.nodes, record.fixed(piece), record.of_stage(piece)
        varying = [at for at in nodes if at not in fixed and at not in of_stage]
        read = {x.at for at in varying for x in operands_of(piece.graph.nodes[at])}
        read |= {x.at for x in piece.outputs if isinstance(x, Number)}
        return cls(
            piece,
            [at for at in nodes if at in fixed],
            [at for at in nodes if at in of_stage],
            [at for at in nodes if at in fixed and at in read],
            [at for at in nodes if at in of_stage and at in read],
            varying,
        )

    @property
    def operations(self) -> int:
        """How many a step has."""
        return sum(self.piece.graph.nodes[at][0] != IN for at in self.varying)

    def values(self, f: Function, nodes: Sequence[int], rows: Any, kind: ir.Type, values: dict[int, Value]) -> None:
        """Compute nodes that do not vary with the step into `values`; rows: of each letter the `Lanes`."""
        f.compute(self.piece.graph, nodes, values, lambda letter, i: rows[letter][i], kind)

    def outputs(
        self,
        f: Function,
        vectors: Sequence[tuple[dict[int, Value], Sequence[Value]]],
        kind: ir.Type,
        overlap: bool,
        together: int = 1,
    ) -> list[list[Value]]:
        """The new states of vectors of lanes, from their values that do not vary and all inputs z.

        Operations of `together` vectors alternate.
        """
        graph, values = self.piece.graph, [dict(fixed) for fixed, _ in vectors]
        inputs = {at: graph.nodes[at][2] for at in self.varying if graph.nodes[at][0] == IN}
        for entries, (_, state) in zip(values, vectors, strict=True):
            entries.update({at: state[index] for at, index in inputs.items()})
        nodes = [at for at in self.varying if at not in inputs]
        nodes = latest(graph, nodes) if overlap else nodes
        for first in range(0, len(vectors), together):
            for at in nodes:
                for entries in values[first : first + together]:
                    f.emit(graph, [at], entries, kind)
        return [[f.value(x, entries, kind) for x in self.piece.outputs] for entries in values]


class Constants:
    """The values of the pieces that do not vary with the step, for one vector of lanes.

    Numbers of a stage are kept in `room`, the first vector of them for each stage.
    """

    def __init__(
        self, f: Function, record: Recording, splits: Sequence[Split], kind: ir.Type, room: Memory, stride: Any
    ):
        self._f, self._record, self._splits, self._kind, self._stride = f, record, splits, kind, stride
        self._room = room.of(kind)
        self.fixed: list[dict[int, Value]] = [{} for _ in splits]

    @staticmethod
    def count(splits: Sequence[Split]) -> int:
        """How many values of a stage are kept."""
        return sum(len(split.kept) for split in splits)

    def begin(self, c: Memory, s: Memory, lanes: list[Any], stages: Integer) -> None:
        """Compute all of it from the constants c (lanes, count) and s (lanes, stages, count)."""
        of_stages = self._record.count("s")
        rows = {"c": Lanes(c, lanes, self._record.count("c")), "s": Lanes(s, lanes, stages * of_stages)}
        for split, values in zip(self._splits, self.fixed, strict=True):
            split.values(self._f, split.fixed, rows, self._kind, values)
        if not self.count(self._splits):
            return
        with self._f.loop(0, stages) as stage:
            rows["s"] = Lanes(s.beyond(stage * of_stages), lanes, stages * of_stages)
            place = stage * self._stride
            for split, fixed in zip(self._splits, self.fixed, strict=True):
                values = dict(fixed)
                split.values(self._f, split.of_stage, rows, self._kind, values)
                self._room.put([values[at] for at in split.kept], place)
                place = place + len(split.kept)

    def at(self, number: int, stage: Any) -> dict[int, Value]:
        """All values that do not vary with the step, for a piece in a stage."""
        split = self._splits[number]
        if not split.kept:
            return self.fixed[number]
        place = stage * self._stride + sum(len(split.kept) for split in self._splits[:number])
        return {**self.fixed[number], **dict(zip(split.kept, self._room.get(len(split.kept), place), strict=True))}


class Steps(NamedTuple):
    """A compiled map.

    kernel(frame, out, rows, every, done, first, last)  `every` steps for each row of `out` (rows, lanes, d), of the
            lanes from first to last; `done` steps were made since the last projection
    room    doubles that it needs as room, for each stage or, not `by_stage`, in all
    """

    kernel: Kernel
    room: int
    by_stage: bool = True


class Writing(NamedTuple):
    """A kernel of 7 arguments to be compiled: its key, its writer, the lanes that it steps at once, its memory."""

    key: tuple[Any, ...]
    write: Callable[[Function], None]
    lanes: int
    room: int


def written_steps(record: Recording, lanes: int, projected: bool) -> Writing:
    """The kernel of a recorded map for `lanes` lanes."""
    width = register_width() if lanes > 1 and record.straight else 1
    splits = [Split.of(record, piece) for piece in record.pieces]
    operations = sum(split.operations for split in splits)
    vectors = 1 if width == 1 else 4 if operations <= FOUR_VECTORS else 2 if operations <= TWO_VECTORS else 1
    while vectors > 1 and (vectors - 1) * width >= lanes:  # one of them would have no separate lane
        vectors //= 2
    counts = record.count("c"), record.count("s")
    key = "steps", record.digest(), record.state, counts, record.stages, width, vectors, projected

    def write(f: Function) -> None:
        overlap = width > 1 and operations <= TWO_VECTORS
        together = 4 if vectors == 4 else 1
        _write(f, record, splits, (width, vectors, together), overlap, projected)

    return Writing(key, write, vectors * width, vectors * width * Constants.count(splits))


def compiled_steps(record: Recording, lanes: int, projected: bool) -> Steps:
    """The compiled function of `written_steps`."""
    writing = written_steps(record, lanes, projected)
    return Steps(kernel(writing.key, 7, writing.write), writing.room)


def _write(
    f: Function, record: Recording, splits: list[Split], widths: tuple[int, int, int], overlap: bool, projected: bool
) -> None:
    frame, out, rows, every, begun, first, last = f.arguments
    width, vectors, together = widths
    words = dict(zip(FRAME, f.integers(frame).get(len(FRAME)), strict=True))
    z, c, s, room = (f.doubles(words[name]) for name in FRAME[:4])
    saved, count, kept, kind = f.doubles(out), record.state, Constants.count(splits), kind_of(width)
    state = [f.variables(count, kind) for _ in range(vectors)]
    stages = words["stages"] if record.stages else f.integer(1)
    f.vectors(width)
    with f.loop(first, last, vectors * width) as lane:
        lanes = [f.lanes(lane + k * width, width, last) for k in range(vectors)]
        constants = [
            Constants(f, record, splits, kind, room.beyond(k * width * kept), vectors * kept) for k in range(vectors)
        ]
        for of_vector, at in zip(constants, lanes, strict=True):
            of_vector.begin(c, s, at, stages)

        def load() -> None:
            for of_vector, at in zip(state, lanes, strict=True):
                of_vector.put(Lanes(z, at, count).get(range(count)))

        def store(rows: Memory) -> None:
            for of_vector, at in zip(state, lanes, strict=True):
                Lanes(rows, at, count).put(of_vector.get())

        def piece(number: int, stage: Any) -> None:
            old = [(constants[k].at(number, stage), state[k].get()) for k in range(vectors)]
            for of_vector, new in zip(state, splits[number].outputs(f, old, kind, overlap, together), strict=True):
                of_vector.put(new)

        def step() -> None:
            pieces_of_step(f, record, stages, piece)

        load()
        done = f.variable(begun)
        with f.loop(0, rows) as row:
            if projected:
                end = lane + (last - lane).least(vectors * width)
                _woven(f, words, every, done, step, lambda: store(z), load, lane, end)
            else:
                with f.loop(0, every):
                    step()
            store(saved.beyond(row * words["lanes"] * count))
        store(z)


def pieces_of_step(f: Function, record: Recording, stages: Any, piece: Callable[[int, Any], None]) -> None:
    """Write the pieces of a step by `piece(number, stage)`: the first one for each stage."""
    if record.stages:
        with f.loop(0, stages) as stage:
            piece(0, stage)
    else:
        piece(0, 0)
    for number in range(1, len(record.pieces)):
        piece(number, 0)


def _woven(
    f: Function,
    words: dict[str, Integer],
    every: Integer,
    done: Memory,
    step: Any,
    store: Any,
    load: Any,
    lane: Any,
    end: Any,
) -> None:
    """`every` steps, and a projection of the lanes from `lane` to `end` whenever `interval` of them are done."""
    left = f.variable(every)
    with f.while_(lambda: left[0].compared(">", 0)):
        steps = left[0].least(words["interval"] - done[0])
        with f.loop(0, steps):
            step()
        left[0] = left[0] - steps
        done[0] = done[0] + steps
        with f.where(done[0].compared("==", words["interval"])):
            done[0] = 0
            store()
            f.call(words["project"], words["table"], words["project_room"], lane, end, 0)
            load()


def outputs_by_rows(graph: Graph, outputs: Sequence[Operand], inputs: dict[str, tuple[int, bool]]) -> Kernel:
    """kernel(z, c, out, rows, lanes): outputs of each row and lane, from z (rows, lanes, d) and c (lanes, constants).

    `inputs`: of each letter how many values a lane has, and whether rows differ.
    """

    def write(f: Function) -> None:
        *addresses, out, rows, lanes = f.arguments
        arrays = {letter: f.doubles(address) for letter, address in zip(inputs, addresses, strict=True)}
        with f.loop(0, rows) as row, f.loop(0, lanes) as lane:
            places = {
                letter: (row * lanes + lane if by_row else lane) * count for letter, (count, by_row) in inputs.items()
            }
            values = f.outputs(graph, outputs, lambda letter, i: arrays[letter][places[letter] + i])
            f.doubles(out).put(values, (row * lanes + lane) * len(outputs))

    return kernel(("rows", graph.digest(outputs), tuple(inputs.items())), 3 + len(inputs), write)
