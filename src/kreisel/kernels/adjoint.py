"""Derivatives of a recorded step, compiled: many steps, their tangent map on columns, and its transpose.

A step is recorded once; `kreisel.graph.arranging` has its derivatives, forwards for the tangent map, all columns in one
loop, in reverse for the transpose.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from math import inf
from typing import Any, NamedTuple

import numpy as np

from kreisel import algebra
from kreisel.algebra.reuse import cached_property
from kreisel.graph.arranging import arranged, independent, latest, pulled, pushed, with_roots
from kreisel.graph.graph import (
    APPLIED,
    BRANCH,
    LOOP,
    Graph,
    Number,
    Operand,
    TooLong,
    array_of,
    evaluated,
    where_less,
)
from kreisel.graph.llvm import DOUBLE, Function, Integer, Value, kind_of
from kreisel.graph.machine import Kernel, address_of, kernel
from kreisel.graph.recording import as_operands
from kreisel.kernels.layout import Floats, on_threads

MOST = 50_000  # operations recorded for the derivatives of a stage with a loop
MOST_NODES = 10_000  # of a stage; the transpose of 6100, a binary with tides and the Sun: 12 s, by XLA > 500 s
SCALAR = 4  # operations on lanes in the time of one of a scalar
VECTORS = 1, 4, 8  # columns that are taken at once
PLAIN = (0.0, 1.0, -1.0)  # constants that are folded into the code


class Part(NamedTuple):
    """A part of a step, recorded: its graph, and the entries of the new state."""

    graph: Graph
    outputs: list[Operand]


def recorded(
    function: Callable[..., Any], kinds: Sequence[str], n: int, constants: Mapping[str, Any], most: float = inf
) -> Part:
    """A step on recorded scalars.  `constants` may have inputs of any graph, which become inputs of the new graph.

    Raises `TooLong` beyond `most` operations.
    """
    graph = Graph(most=most)

    def inputs(x: Any) -> Any:
        array = np.asarray(x)
        if array.dtype != object:
            return x
        entries = [graph.input(*v.node[1:]) if isinstance(v, Number) else v for v in array.flat]
        return array_of(entries).reshape(array.shape)[()]

    z = graph.inputs("z", algebra.coordinate_count(kinds, n))
    new = function(*algebra.restore(z, kinds, n), **{name: inputs(x) for name, x in constants.items()})
    part = Part(graph, as_operands(list(algebra.flatten(new, kinds))))
    return _without_branches(part) if graph.branches else part


def _without_branches(part: Part) -> Part:
    """The part with values that are infinite if a branch would be taken: of a `Binary`, if its steps are too long."""
    graph = Graph()

    def branch(test: Any, _: Any, values: Sequence[Any]) -> list[Any]:
        return [where_less(0.0, test, inf, value) for value in values]

    outputs = evaluated(*part, graph.input, APPLIED | {BRANCH: branch})
    return Part(graph, as_operands(outputs))


class Code:
    """Kernels of a step: its first part for each row of s, then the second, if any, compiled when they are first used.

    constants, of_stage   how many entries c and a row of s have
    higher                () -> the parts for derivatives of the second order and beyond; None: the same
    rooted                whether Newton's steps follow the loops
    Codes of the same operations are equal, so JAX compiles their callers once.
    """

    def __init__(
        self,
        parts: Sequence[Part],
        constants: int,
        of_stage: int,
        higher: Callable[[], Sequence[Part]] | None = None,
        rooted: bool = False,
    ):
        self._higher, self.sizes = higher or (lambda: parts), (len(parts[0].outputs), constants, of_stage)
        self._rooted, self._recorded, self._parts = rooted, parts, [Part(*arranged(*part)) for part in parts]
        self._work = SCALAR * sum(len(part.graph.needed(part.outputs)) for part in self._parts)
        self._key = self.sizes, *(part.graph.digest(part.outputs) for part in self._parts)
        self._kernels: dict[Any, Kernel] = {}
        self._tangents: dict[bool, Code] = {}

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Code) and self._key == other._key

    def __hash__(self) -> int:
        return hash(self._key)

    @property
    def dim(self) -> int:
        """The count of the entries of a state."""
        return self.sizes[0]

    @cached_property
    def higher(self) -> Sequence[Part]:
        """The parts for derivatives of the second order and beyond, recorded when they are first needed."""
        return self._higher()

    def with_tangent(self, wide: bool) -> Code:
        """The code of (z, v) -> (step(z), J v), v a tangent of z; if `wide`, c and s are followed by tangents too."""
        result = self._tangents.get(wide)
        if result is None:
            parts, (_, c, s) = [self._with_tangent(part, wide) for part in self._smooth(self.higher, 3)], self.sizes
            result = self._tangents[wide] = Code(parts, c * (1 + wide), s * (1 + wide), rooted=True)
        return result

    def _with_tangent(self, part: Part, wide: bool) -> Part:
        graph, sizes = Graph(), dict(zip("zcs", self.sizes, strict=True))

        def inputs(letter: str, i: int) -> Number:
            return graph.input(letter[-1], i + sizes[letter[-1]] * (len(letter) - 1))

        return Part(graph, as_operands(graph.copy(*pushed(*part, "" if wide else "cs"), inputs)))

    def _smooth(self, parts: Sequence[Part], steps: int) -> Sequence[Part]:
        """The parts with derivatives of their loops, by steps of Newton's method."""
        if self._rooted or not any(part.graph.loops for part in parts):
            return parts
        return [Part(*with_roots(*part, steps, MOST)) for part in parts]

    @cached_property
    def _derived(self) -> Sequence[Part]:
        """The parts that are differentiated."""
        return [Part(*arranged(*part)) for part in self._smooth(self._recorded, 1)]

    @cached_property
    def compiled(self) -> bool:
        """Whether kernels of the derivatives can be made: the parts are short enough."""
        try:
            return all(len(part.graph.needed(part.outputs)) < MOST_NODES for part in self._derived)
        except TooLong:
            return False

    def _kernel(
        self, write: Callable[..., None], arguments: int, derive: Callable[..., Any] | None, *options: Any
    ) -> Any:
        """The kernel that write(function, derivatives, *options) writes, with derivatives from derive(part)."""
        result = self._kernels.get((write.__name__, *options))
        if result is None:
            parts = [Part(*arranged(*derive(part))) for part in self._derived] if derive else []
            key = write.__name__, *options, self._key, *(part.graph.digest(part.outputs) for part in parts)
            result = self._kernels[write.__name__, *options] = kernel(
                key, arguments, lambda f: write(f, parts, *options)
            )
        return result

    def _forward(self, f: Function, _: Sequence[Part]) -> None:
        """(z, c, s, stages, marks, count, every, length): the state after each `length` and `every` steps."""
        *start, marks, count, every, length = f.arguments
        motion, parts = _Motion(f, self, *start), (every + (length - 1)) // length
        with f.loop(0, count) as mark:
            with f.loop(0, length.least(every - length * (mark % parts))):
                motion.through(motion.advance)
            f.doubles(marks).put(motion.state, mark * self.dim)

    def _pull(self, f: Function, derivatives: Sequence[Part], wide: bool) -> None:
        """(starts of parts, c, s, stages, path, g, gc, gs, every, length): g <- J^T g, gc and gs with it if `wide`.

        path (parts of all steps, d) is room.
        """
        *start, path, g, gc, gs, every, length = f.arguments
        d, constants, of_stage = self.sizes
        motion, per_step = _Motion(f, self, *start), start[3] + (len(self._parts) - 1)
        slopes = f.variables(d + constants * wide)
        slopes.put(f.doubles(g).get(d) + (f.doubles(gc).get(constants) if wide else []))
        states, slopes_of_stages = f.doubles(path), f.doubles(gs)

        def back(k: int, stage: Integer) -> None:
            motion.state = states.get(d, (step * per_step + stage) * d)
            w, of_this = slopes.get(), slopes_of_stages.beyond(stage * of_stage)
            new = motion.outputs(derivatives[k], stage, w=w[:d], h=w[d:], q=of_this)
            slopes.put(new[: len(slopes)])
            of_this.put(new[len(slopes) :])

        def forth(k: int, stage: Integer) -> None:
            states.put(motion.state, (step * per_step + stage) * d)
            motion.advance(k, stage)

        with f.loop((every + (length - 1)) // length - 1, -1, -1) as k:
            motion.state = f.doubles(start[0]).get(d, k * d)
            steps = length.least(every - length * k)
            with f.loop(0, steps) as step:
                motion.through(forth)
            with f.loop(steps - 1, -1, -1) as step:
                motion.through(back, reverse=True)
        f.doubles(g).put(slopes.get()[:d])
        f.doubles(gc).put(slopes.get()[d:])

    def _slopes(self, part: Part, wide: bool) -> tuple[Graph, list[Operand]]:
        """Slopes by z; if `wide` also by c and s, added to h and q."""
        graph, slopes = pulled(*part, "" if wide else "cs")
        outputs = [slopes.get(("z", i), 0.0) for i in range(self.dim)]
        of_stage = self.sizes[2] if part is self._derived[0] else 0
        for old, letter, size in (("h", "c", self.sizes[1]), ("q", "s", of_stage)):
            outputs += [graph.input(old, i) + slopes.get((letter, i), 0.0) for i in range(size * wide)]
        return graph, outputs

    def _push(self, f: Function, derivatives: Sequence[Part], wide: bool, width: int) -> None:
        """(z, c, s, stages, dz, dc, ds, out, rows, every, blocks): blocks of `width` columns dz (d, ...) -> J dz + ...

        Those at the rows go to `out`.
        """
        *start, dz, dc, ds, out, rows, every, blocks = f.arguments
        f.vectors(width)
        motion, kind, size = _Motion(f, self, *start), kind_of(width), self.dim * blocks
        vz, vc, vs, rooms = (f.doubles(address).of(kind) for address in (dz, dc, ds, out))

        def through(k: int, stage: Integer) -> None:
            graph, outputs = derivatives[k]
            nodes = graph.needed(outputs)
            still = independent(graph, nodes, "zcs", loops=True)
            fixed, moving = ([at for at in nodes if (at in still) == chosen] for chosen in (True, False))
            values: dict[int, Value] = {}
            f.compute(graph, latest(graph, fixed), values, motion.inputs(stage), DOUBLE)
            motion.state = [f.value(x, values, DOUBLE) for x in outputs[: self.dim]]
            spread = {at: f.spread(values[at], kind) for at in fixed if graph.nodes[at][0] != LOOP}
            columns = [("z", vz), ("c", vc), ("s", vs.beyond(stage * self.sizes[2] * blocks))]
            with f.loop(0, blocks) as block:
                inputs = zip(columns, self.sizes if wide else self.sizes[:1], strict=False)
                along = {f"v{k}": [x[blocks * i + block] for i in range(count)] for (k, x), count in inputs}
                inside = dict(spread)
                f.compute(graph, latest(graph, moving), inside, lambda letter, i: along[letter][i], kind)
                for i, x in enumerate(outputs[self.dim :]):
                    vz[blocks * i + block] = f.value(x, inside, kind)

        with f.loop(0, rows) as row:
            with f.loop(0, every):
                motion.through(through)
            with f.loop(0, size) as i:
                rooms[row * size + i] = vz[i]

    # -- rows of lanes -----------------------------------------------------------------------------

    def marks(self, z: Floats, c: Floats, s: Floats, rows: int, every: int, length: int) -> Floats:
        """The states (lanes, rows * parts, d) after each `length` steps, and each `every` steps."""
        call = self._kernel(self._forward, 8, None)
        out = np.empty((len(z), rows * -(-every // length), self.dim))

        def work_on(first: int, last: int) -> None:
            for i in range(first, last):
                start = *map(address_of, (z[i], c[i], s[i])), s.shape[1]
                call(*start, address_of(out[i]), out.shape[1], every, length)

        on_threads(len(z), len(z) * rows * every * s.shape[1] * self._work, work_on)
        return out

    def pushed(
        self, z: Floats, c: Floats, s: Floats, dz: Floats, dc: Floats, ds: Floats, rows: int, every: int
    ) -> Floats:
        """The tangents (lanes, k, rows, d) of the rows for those (lanes, k, ...) of the arguments."""
        wide = dc.size + ds.size > 0
        width = next((width for width in VECTORS if width >= dz.shape[1]), VECTORS[-1])
        fixed = "" if wide else "cs"
        call = self._kernel(self._push, 11, lambda part: pushed(part.graph, part.outputs, fixed), wide, width)
        out = np.empty((*dz.shape[:2], rows, self.dim))
        for i in range(len(z)):
            columns = [_columns(v[i], width) for v in (dz, dc, ds)]
            room = np.empty((rows, *columns[0].shape))
            start = *map(address_of, (z[i], c[i], s[i])), s.shape[1]
            call(*start, *map(address_of, (*columns, room)), rows, every, room.shape[-1] // width)
            out[i] = np.moveaxis(room, -1, 0)[: dz.shape[1]]
        return out

    def pulled(
        self, z: Floats, c: Floats, s: Floats, marks: Floats, g: Floats, every: int, length: int, wide: bool
    ) -> tuple[Floats, Floats, Floats]:
        """The slopes (lanes, k, ...) by z, c and s from those g (lanes, k, rows, d) by the rows."""
        call = self._kernel(self._pull, 10, lambda part: self._slopes(part, wide), wide)
        parts, rows = -(-every // length), g.shape[2]
        gz = np.zeros((*g.shape[:2], self.dim))
        gc, gs = np.zeros((*g.shape[:2], c.shape[1])), np.zeros((*g.shape[:2], *s.shape[1:]))
        path = np.empty((length * (s.shape[1] + len(self._parts) - 1), self.dim))
        for i, j in np.ndindex(*g.shape[:2]):
            starts = np.concatenate([z[i][None], marks[i]])
            constants = [*map(address_of, (c[i], s[i])), s.shape[1]]
            room = [*map(address_of, (path, gz[i, j], gc[i, j], gs[i, j]))]
            for row in range(rows - 1, -1, -1):
                gz[i, j] += g[i, j, row]
                call(address_of(starts[row * parts :]), *constants, *room, every, length)
        return gz, gc, gs


class _Motion:
    def __init__(self, f: Function, code: Code, z: Integer, c: Integer, s: Integer, stages: Integer):
        d, constants, self._of_stage = code.sizes
        self._f, self._parts, self._stages, self._room = f, code._parts, stages, f.variables(d)
        self.state = f.doubles(z).get(d)
        self._c, self._s = f.doubles(c).get(constants), f.doubles(s)

    @property
    def state(self) -> list[Value]:
        """The entries of z."""
        return self._room.get()

    @state.setter
    def state(self, values: Sequence[Value]) -> None:
        self._room.put(values)

    def inputs(self, stage: Integer, **vectors: Any) -> Callable[[str, int], Value]:
        """The entries of each letter."""
        entries: dict[str, Any] = {"z": self.state, "c": self._c, "s": self._s.beyond(stage * self._of_stage)} | vectors
        return lambda letter, i: entries[letter][i]

    def outputs(self, part: Part, stage: Integer, **vectors: Any) -> list[Value]:
        """The values of the outputs of a graph."""
        nodes = part.graph.needed(part.outputs)
        values: dict[int, Value] = {}
        self._f.compute(part.graph, latest(part.graph, nodes), values, self.inputs(stage, **vectors), DOUBLE)
        return [self._f.value(x, values, DOUBLE) for x in part.outputs]

    def advance(self, k: int, stage: Integer) -> None:
        """The state after a part of the step."""
        self.state = self.outputs(self._parts[k], stage)

    def through(self, write: Callable[[int, Integer], None], reverse: bool = False) -> None:
        """write(part, place) for the parts of a step, in order: 0 for each stage, 1 for its end."""
        closes = len(self._parts) > 1
        if reverse and closes:
            write(1, self._stages)
        with self._f.loop(*((self._stages - 1, -1, -1) if reverse else (0, self._stages))) as stage:
            write(0, stage)
        if closes and not reverse:
            write(1, self._stages)


def _columns(v: Floats, width: int) -> Floats:
    """Tangents (k, ...) as columns (..., k), with zeros that fill vectors of that width."""
    zeros = np.zeros((-len(v) % width, *v.shape[1:]))
    return np.ascontiguousarray(np.moveaxis(np.concatenate([v, zeros]), 0, -1))
