"""Bodies that act on each other in pairs: lanes that meet between the parts of a step.

A stage is `drift` of all lanes, in vectors of lanes; a loop over the pairs, which sums the forces on each lane; `kick`
of all lanes.  The record is of one lane and of one pair, so the code does not grow with their number.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from kreisel import algebra
from kreisel.algebra.reuse import reused
from kreisel.graph.arranging import arranged
from kreisel.graph.graph import Graph, Number, Operand, TooLong
from kreisel.graph.invariants import recordable
from kreisel.graph.llvm import Function, Integer, Lanes, kind_of
from kreisel.graph.machine import Kernel, address_of, kernel, register_width
from kreisel.graph.project import CompiledProjection
from kreisel.graph.recording import (
    Recording,
    as_operands,
    columns_of,
    count_of,
    flat_constants,
    recorded_arguments,
    recorded_numbers,
    special_constants,
)
from kreisel.kernels.cpu import SteppedEngine, projection_between
from kreisel.kernels.layout import Floats, Look
from kreisel.kernels.steps import Constants, Split
from kreisel.method.scheme import Coupling, Scheme, too_large_to_couple

# The words of a frame: addresses of z (lanes, d), c (lanes, constants), s (lanes, stages, constants), the constants and
# the lanes of pairs, and of room for forces (lanes, forces), for counts of lanes and of stages; three counts.
FRAME = ("z", "c", "s", "p", "pairs", "forces", "fixed", "staged", "lanes", "stages", "count")


class CoupledEngine(SteppedEngine):
    """Lanes that act on each other, advanced together on one core; `projection` as in `kreisel.kernels.cpu`."""

    def __init__(self, scheme: Scheme, z0: Floats, project: bool):
        super().__init__(scheme, z0)
        coupling = of(scheme)
        self._pairs, (self._of_pairs, pair_columns) = coupling.pairs, constants_of(coupling)
        special = tuple(special_constants(self.constants).items())  # which are folded into the code
        key = None if scheme.kernel_key is None else (CoupledEngine, scheme.kernel_key, self.stages.shape, special)
        self.kernel, room, self.work = reused(key, lambda: self._compiled(pair_columns))
        self._held = [np.empty(size) for size in room]
        arrays = self.z, self.constants, self.stages, self._of_pairs
        words = [*map(address_of, arrays), self._pairs.ctypes.data, *map(address_of, self._held)]
        self._frame = np.array([*words, *self.stages.shape[:2], len(self._pairs)], dtype=np.int64)
        if project:
            self.projection = recordable(lambda: projection_between(self, scheme.stage_count * self.work))

    def _compiled(self, pair_columns: Mapping[str, slice]) -> tuple[Kernel, tuple[int, int, int], int]:
        """The kernel, the sizes of its room, and the operations of a stage."""
        scheme = self.scheme
        try:
            record = Recording(scheme, self.constants, self.columns, self.stage_columns)
        except TooLong:
            raise too_large_to_couple(scheme.name, scheme.n) from None
        if not record.straight:
            raise too_large_to_couple(scheme.name, scheme.n)
        pull = Pull.of(scheme, {"c": self.columns, "s": self.stage_columns, "p": pair_columns})
        return *compiled_together(record, pull, *self.stages.shape[:2]), record.work

    def _advance(self, out: Floats, every: int, look: Look) -> None:
        self.kernel(self._frame.ctypes.data, address_of(out), len(out), every)

    def begin(self, z: Floats, scheme: Scheme, steps: int) -> bool:
        if not isinstance(self.projection, CompiledProjection | None) or self.scheme.basis:
            return False
        if not self.adopts(scheme, z):
            return False
        if self.projection is not None:
            self.projection.begin(steps)
        return True


def of(scheme: Scheme) -> Coupling:
    """Interactions of the lanes of a scheme.  Raises `TypeError` where that is nothing."""
    if scheme.coupling is None:
        raise TypeError(f"the lanes of {scheme.name} are independent")
    return scheme.coupling


def constants_of(coupling: Coupling) -> tuple[Floats, dict[str, slice]]:
    """The constants of the pairs as rows (pairs, count), and the place of each."""
    return columns_of(coupling.constants, coupling.axes, (len(coupling.pairs),))


def compiled_pulls(scheme: Scheme, lanes: int) -> Callable[[Floats], Floats]:
    """z (lanes, d) -> the forces on each lane (lanes, forces), for a flow."""
    coupling = of(scheme)
    (constants, columns), (of_pairs, pair_columns) = flat_constants(scheme, lanes), constants_of(coupling)
    pull = Pull.of(scheme, {"c": columns, "s": {}, "p": pair_columns})
    no_stages, pairs = np.zeros((lanes, 1, 0)), coupling.pairs

    def write(f: Function) -> None:
        frame, z, forces = f.arguments
        words = dict(zip(FRAME, f.integers(frame).get(len(FRAME)), strict=True))
        pull.write(f, {**words, "z": z, "forces": forces}, f.integer(0))

    pull_all = kernel(("pulls", *pull.key), 3, write)
    words = [0, *map(address_of, (constants, no_stages, of_pairs)), pairs.ctypes.data, 0, 0, 0, lanes, 1, len(pairs)]
    frame, held = np.array(words, dtype=np.int64), (constants, no_stages, of_pairs, pairs)

    def pulls(z: Floats) -> Floats:
        out = np.empty((len(held[0]), pull.forces))
        pull_all(frame.ctypes.data, address_of(z), address_of(out))
        return out

    return pulls


class Pull(NamedTuple):
    """The function of a pair, recorded: the forces on both.

    size, forces  how many entries a state has, and the forces on a lane
    counts        of the constants c, s and p
    """

    graph: Graph
    outputs: list[Operand]
    size: int
    forces: int
    counts: dict[str, int]

    @classmethod
    def of(cls, scheme: Scheme, columns: Mapping[str, Mapping[str, slice]]) -> Pull:
        """The pull of a scheme."""
        coupling, graph = of(scheme), Graph()
        kinds = scheme.kinds
        of_lanes = {letter: places for letter, places in columns.items() if letter != "p"}
        z, constants = recorded_arguments(scheme, graph, of_lanes, tuple(kinds))
        for name, place in columns["p"].items():
            constants[name] = recorded_numbers(graph, "p", place, np.shape(coupling.constants[name])[1:])
        values = list(algebra.flatten(coupling.pull(*z, **constants), [*coupling.forces, *coupling.forces]))
        size = algebra.coordinate_count(kinds, scheme.n)
        counts = {letter: count_of(places) for letter, places in columns.items()}
        return cls(*arranged(graph, as_operands(values)), size, len(values) // 2, counts)

    @property
    def key(self) -> tuple[Any, ...]:
        """The pull's part of a kernel's key."""
        return self.graph.digest(self.outputs), self.size, self.forces, tuple(self.counts.items())

    def write(self, f: Function, words: Mapping[str, Integer], stage: Any) -> None:
        """Sum the forces on each lane, over the pairs in order."""
        z, forces, pairs = f.doubles(words["z"]), f.doubles(words["forces"]), f.integers(words["pairs"])
        arrays = {letter: f.doubles(words[letter]) for letter in "csp"}
        with f.loop(0, words["lanes"] * self.forces) as k:
            forces[k] = 0.0
        with f.loop(0, words["count"]) as pair:
            i, j = pairs[pair * 2], pairs[pair * 2 + 1]
            places = {
                "c": i * self.counts["c"],
                "s": (i * words["stages"] + stage) * self.counts["s"],
                "p": pair * self.counts["p"],
            }

            def at(letter: str, k: int) -> Any:
                if letter == "z":
                    return z[(i if k < self.size else j) * self.size + k % self.size]
                return arrays[letter][places[letter] + k]

            sums = [forces.beyond(lane * self.forces) for lane in (i, j)]
            before = [x for lane in sums for x in lane.get(self.forces)]
            values = f.outputs(self.graph, self.outputs, at)
            silent = [not isinstance(x, Number) and x == 0 for x in self.outputs]
            after = [x if no else f.builder.fadd(x, y) for x, y, no in zip(before, values, silent, strict=True)]
            sums[0].put(after[: self.forces])
            sums[1].put(after[self.forces :])


def compiled_together(record: Recording, pull: Pull, lanes: int, stages: int) -> tuple[Kernel, tuple[int, int, int]]:
    """kernel(frame, out, rows, every): `every` steps of all lanes for each row of `out` (rows, lanes, d).

    And the sizes of the room for forces, and for counts of lanes and of stages.
    """
    width = register_width()
    splits = [Split.of(record, piece) for piece in record.pieces]
    counts = record.count("c"), record.count("s")
    fixed, staged = sum(len(split.kept_fixed) for split in splits), Constants.count(splits)
    blocks = -(-lanes // width)

    def write(f: Function) -> None:
        _write(f, record, splits, pull, width)

    key = "together", record.digest(), record.state, counts, record.stages, width, pull.key
    room = lanes * pull.forces, blocks * fixed * width, blocks * stages * staged * width
    return kernel(key, 4, write), room


def _write(f: Function, record: Recording, splits: list[Split], pull: Pull, width: int) -> None:
    frame, out, rows, every = f.arguments
    words = dict(zip(FRAME, f.integers(frame).get(len(FRAME)), strict=True))
    z, c, s, forces, saved = (f.doubles(x) for x in (*(words[name] for name in ("z", "c", "s", "forces")), out))
    lanes, stages, kind, size = words["lanes"], words["stages"], kind_of(width), record.state
    f.vectors(width)
    fixed, staged = (f.doubles(words[name]).of(kind) for name in ("fixed", "staged"))
    starts = [sum(len(split.kept_fixed) for split in splits[:number]) for number in range(len(splits) + 1)]
    count, blocks = Constants.count(splits), (lanes + (width - 1)) // width

    def constants_of(block: Integer) -> Constants:
        return Constants(f, record, splits, kind, staged.beyond(block * stages * count), count)

    with f.loop(0, blocks) as block:  # the values that do not vary with the step
        constants = constants_of(block)
        constants.begin(c, s, f.lanes(block * width, width, lanes), stages)
        kept = zip(splits, constants.fixed, strict=True)
        fixed.put([values[at] for split, values in kept for at in split.kept_fixed], block * starts[-1])

    def piece(number: int, block: Integer, stage: Any) -> None:
        """A piece, of the lanes of a block."""
        at, split, constants = f.lanes(block * width, width, lanes), splits[number], constants_of(block)
        values = fixed.get(len(split.kept_fixed), block * starts[-1] + starts[number])
        constants.fixed[number] = dict(zip(split.kept_fixed, values, strict=True))
        state = Lanes(z, at, size)
        old = state.get(range(size))
        if split.piece.part.arguments:
            old += Lanes(forces, at, pull.forces).get(range(pull.forces))
        state.put(split.outputs(f, [(constants.at(number, stage), old)], kind, overlap=True)[0])

    with f.loop(0, rows) as row:
        with f.loop(0, every):
            with f.loop(0, stages) as stage:
                with f.loop(0, blocks) as block:
                    piece(0, block, stage)
                pull.write(f, words, stage)
                with f.loop(0, blocks) as block:
                    piece(1, block, stage)
            if len(splits) > 2:
                with f.loop(0, blocks) as block:
                    piece(2, block, 0)
        with f.loop(0, lanes * size) as k:
            saved[row * lanes * size + k] = z[k]
