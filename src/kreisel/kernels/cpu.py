"""Compiled kernels for the CPU, made from a scheme's step by recording it.

Up to n = 10, if it is not too long, the record is a graph of scalars; beyond, the definition runs on arrays, one lane
after the other, except for the forms of `kreisel.kernels.large`.  An ensemble runs on vectors of lanes
(`kreisel.kernels.steps`); lane i has the bits of a single run.  Shares of the lanes go to threads
(`kreisel.kernels.layout`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.algebra.backend import Complex
from kreisel.algebra.reuse import reused
from kreisel.graph.double import DoubleDouble
from kreisel.graph.graph import Graph, Operand, TooLong, depending, where_less
from kreisel.graph.invariants import MOST_N, Program, cost_of, program_of, program_of_orientation, recordable
from kreisel.graph.llvm import Function, Lanes, kind_of
from kreisel.graph.machine import Kernel, Link, address_of, kernel, register_width
from kreisel.graph.project import ALONE, WIDE, CompiledProjection, Corrections, Projected, compiled, interval
from kreisel.graph.recording import (
    Recording,
    as_operands,
    constants_of,
    count_of,
    fill,
    flat_constants,
    flat_stages,
    operation_count,
    recorded_arguments,
    recorded_outputs,
    special_constants,
)
from kreisel.kernels import projection
from kreisel.kernels.layout import Floats, Look, no_look, on_threads
from kreisel.kernels.steps import FRAME, Steps, compiled_steps, outputs_by_rows
from kreisel.method.scheme import SPINS, Scheme

if TYPE_CHECKING:
    from kreisel.kernels.large.forms import LargeForm

WORK = 20_000  # operations in the time that NumPy needs to begin a step
OBSERVED_N, OBSERVED_LINES = 8, 1000  # as many operations compile in a second
MOST_LARGE_N = 500  # up to which kernels of O(n) are projected: recording needs a second
# Invariants of a position and a momentum that are recorded beyond MOST_N too: Rosochatius' need minutes.
FEW = 20


@dataclass(frozen=True)
class Code:
    """A step compiled, `work` operations a stage, and the programs of a projection that its kernel calls, if it does.

    steps    the kernel; None without straight-line code: then the definition runs on arrays
    tried    whether such programs were looked for
    """

    steps: Steps | None
    work: int
    programs: tuple[Program, ...] = ()  # of the invariants, and of the orientation
    project: Any = None  # `compiled` of them
    cost: float = 0.0  # operations of a projection
    width: int = 1  # lanes that are projected at once
    tried: bool = False


def code_of(
    scheme: Scheme, constants: Floats, columns: Mapping[str, slice], stage_columns: Mapping[str, slice], project: bool
) -> Code:
    """The code of a scheme's step for the lanes of `constants` (lanes, count)."""
    special = tuple(special_constants(constants).items())  # which are folded into the code
    of_step = scheme.of_structure(scheme.kernel_key)
    key = None if of_step is None else (Code, of_step, len(constants), special, project)

    def make() -> Code:
        try:
            record = Recording(scheme, constants, columns, stage_columns)
        except TooLong:
            return Code(None, WORK + 50 * scheme.n**3)
        programs = _programs(scheme, columns) if project and scheme.n <= MOST_N else None
        width = WIDE if len(constants) > 1 and record.straight else 1
        project_them = compiled(programs, width) if programs else None
        steps = compiled_steps(record, len(constants), bool(programs))
        tried = programs is not None
        return Code(steps, record.work, tuple(programs or ()), project_them, cost_of(programs or []), width, tried)

    return reused(key, make)


def _programs(scheme: Scheme, columns: Mapping[str, slice]) -> list[Program] | None:
    """Programs of the invariants and of the orientation; None if they would be too long."""
    try:
        program = recordable(lambda: program_of(scheme, columns))
    except TooLong:
        return None
    programs = [program, program and program_of_orientation(scheme)]
    return [program for program in programs if program is not None]


class SteppedEngine(Projected):
    """Rows of state `z` (lanes, d), the constants of a scheme and of its stages as rows, and a projection or None.

    Kernels have the addresses of the arrays: their scalars may be changed, and no other array replaces them.
    """

    def __init__(self, scheme: Scheme, z0: Floats):
        self.scheme, self.z = scheme, np.array(z0, dtype=np.float64, order="C")
        self.constants, self.columns = flat_constants(scheme, len(self.z))
        self.stages, self.stage_columns = flat_stages(scheme, len(self.z))

    def adopts(self, scheme: Scheme, z: Floats) -> bool:
        """Go on from z by a scheme of the same kernel, with other constants; whether that can be."""
        if scheme.kernel_key is None or scheme.kernel_key != self.scheme.kernel_key or len(z) != len(self.z):
            return False
        if scheme.stage_count != self.scheme.stage_count:
            return False
        if scheme is not self.scheme:
            changed = _changed(scheme.constants, self.scheme.constants)
            if changed:
                constants = self.constants.copy()
                fill(constants, self.columns, changed, scheme.axes)
                if special_constants(constants) != special_constants(self.constants):  # in the code of the kernel
                    return False
                self.constants[:] = constants
            fill(self.stages, self.stage_columns, _changed(scheme.stages, self.scheme.stages), scheme.axes)
            self.scheme = scheme
        self.z[:] = z
        return True


def _changed(new: Mapping[str, Array], old: Mapping[str, Array]) -> dict[str, Array]:
    return {name: value for name, value in new.items() if value is not old[name]}


class CpuEngine(SteppedEngine):
    """A compiled step, its state in rows (lanes, d), and its constants.

    `advance(out, every)` makes `every` steps for each row of `out` (rows, lanes, d) and stores the state there.
    With `project` the state is projected to its invariants now and then (`kreisel.graph.project`).
    """

    def __init__(self, scheme: Scheme, z0: Floats, large: LargeForm | None = None, project: bool = False):
        super().__init__(scheme, z0)
        self._woven: CompiledProjection | None = None  # the projection, if the kernel calls it
        if large is not None:
            code = self._large(large)
        else:
            code = code_of(scheme, self.constants, self.columns, self.stage_columns, project)
        self.code, self.work = code, code.work  # operations of a stage
        self._frames: dict[int, tuple[int, Any]] = {}
        if code.programs:
            every = interval(code.cost, self.work_of_step, scheme.between)
            parts = [*code.programs], code.project, every, self.z, self.constants, code.width
            self.projection = self._woven = CompiledProjection(*parts, woven=True)
        elif project and not code.tried:
            arrays_only = large is None
            self.projection = recordable(lambda: projection_between(self, self.work_of_step, arrays_only))

    @property
    def work_of_step(self) -> int:
        """Operations of a step."""
        return self.work * self.scheme.stage_count

    def _large(self, large: LargeForm) -> Code:
        from kreisel.kernels.large.kernel import compiled_large

        def make() -> Code:
            n, steps = self.scheme.n, compiled_large(large, self.columns, self.stage_columns)
            return Code(steps, 200 * n + 4 * n * n if large.inverses else 60 + 4 * n)  # measured: n = 10 and 100

        return reused(None if self.scheme.kernel_key is None else (Code, self.scheme.kernel_key), make)

    def _project(self) -> Floats:
        if self.projection is not None:
            self.projection.apply()
        projection.orthogonal(self.scheme, self.z)
        return self.z

    def _frame(self, first: int) -> int:
        if first not in self._frames:
            frame, held = frame_of(self.code, self.z, self.constants, self.stages, self._woven, first)
            self._frames[first] = frame.ctypes.data, (frame, held)  # threads ask at once, each for another one
        return self._frames[first][0]

    def _advance(self, out: Floats, every: int, look: Look = no_look) -> None:
        lanes, woven, steps = len(self.z), self._woven, self.code.steps
        if steps is None:
            self._by_definition(out, every, look)
            return
        if out.shape[1:] != self.z.shape:
            raise TypeError(f"expected rows (rows, {lanes}, {self.z.shape[1]}), got {out.shape}")
        call, address, rows, done = steps.kernel.call, address_of(out), len(out), woven.done if woven else 0

        def work_on(first: int, last: int) -> None:
            call(self._frame(first), address, rows, every, done, first, last)

        on_threads(lanes, len(out) * every * lanes * self.work_of_step, work_on)

    def _by_definition(self, out: Floats, every: int, look: Look) -> None:
        for lane, z in enumerate(self.z):
            for row in out:
                by_definition(self.scheme, self.columns, self.stage_columns)(
                    z, self.constants[lane], self.stages[lane], every, look
                )
                row[lane] = z

    def seconds_by_definition(self) -> float | None:
        """Time of a step of a lane that runs by its definition on arrays; None for a compiled step."""
        if self.code.steps is not None:
            return None
        advance, spent = by_definition(self.scheme, self.columns, self.stage_columns), list[float]()
        with np.errstate(all="ignore"):
            for _ in range(2):
                begun = perf_counter()
                advance(self.z[0].copy(), self.constants[0], self.stages[0], 1, no_look)
                spent.append(perf_counter() - begun)
        return min(spent)

    def begin(self, z: Floats, scheme: Scheme, steps: int) -> bool:
        if self.projection is not self._woven or not self.adopts(scheme, z):
            return False
        if self._woven is not None:
            self._woven.begin(steps)
        return True


def frame_of(
    code: Code, z: Floats, constants: Floats, stages: Floats, projection: CompiledProjection | None, first: int
) -> tuple[Any, Any]:
    """The words that a kernel of straight-line code works on, and the arrays that must live as long as they do."""
    steps = code.steps
    room = np.zeros(max(1, steps.room * (stages.shape[1] if steps.by_stage else 1)) if steps else 1)
    words = [address_of(array) for array in (z, constants, stages, room)] + [len(z), stages.shape[1]]
    if projection is not None:
        _, every, project, table = projection.arguments
        words += [every, project, table, projection.room(first)]
    words += [0] * (len(FRAME) - len(words))
    return np.array(words, dtype=np.int64), (z, constants, stages, room)


def by_definition(
    scheme: Scheme, columns: Mapping[str, slice], stage_columns: Mapping[str, slice]
) -> Callable[[Floats, Floats, Floats, int, Look], None]:
    """advance(z, c, s, steps, look): steps by the definition, of rows z (d,), c (constants,), s (stages, constants)."""
    kinds, n, parts = scheme.kinds, scheme.n, scheme.parts

    def advance(z: Floats, c: Floats, s: Floats, steps: int, look: Look) -> None:
        fixed = constants_of(scheme, c, columns)
        stages = [{**fixed, **constants_of(scheme, row, stage_columns)} for row in s]
        for _ in range(steps):
            look()
            for stage in stages:
                z[:] = algebra.flatten(parts[0].function(*algebra.restore(z, kinds, n), **stage), kinds)
            for part in parts[1:]:
                z[:] = algebra.flatten(part.function(*algebra.restore(z, kinds, n), **fixed), kinds)

    return advance


def compiled_step(
    scheme: Scheme, constants: Floats, columns: Mapping[str, slice]
) -> Callable[[Floats, Floats, int], None]:
    """`advance(z, constants, count)` for any number of rows z (lanes, d), with constants that are like these.

    One lane after the other: a kernel for vectors of lanes needs 4 s to compile where this one needs 0.6 s.
    """
    stages, stage_columns = flat_stages(scheme, 1)
    one_lane = np.where((constants == constants[:1]).all(0), constants[:1], np.nan)  # varying ones are not folded
    code = code_of(scheme, one_lane, columns, stage_columns, False)

    def advance(z: Floats, c: Floats, steps: int) -> None:
        s, out = np.broadcast_to(stages, (len(z), *stages.shape[1:])).copy(), np.empty((1, *z.shape))
        if code.steps is None:
            for row, of_row in zip(z, c, strict=True):
                by_definition(scheme, columns, stage_columns)(row, of_row, stages[0], steps, no_look)
        else:
            frame, held = frame_of(code, z, c, s, None, 0)
            code.steps.kernel(frame.ctypes.data, address_of(out), 1, steps, 0, 0, len(z))
            del held

    return advance


def projection_between(engine: SteppedEngine, work: float, arrays_only: bool = False) -> Corrections | None:
    """The projection of an engine's rows, for kernels that do not call it; None if nothing is conserved.

    Constants are the rows of the engine, which it may change, unless the invariants need a basis too.
    """
    scheme, z, constants, columns = engine.scheme, engine.z, engine.constants, engine.columns
    if scheme.n > (projection.MOST_N if scheme.conserved is None else MOST_LARGE_N):
        return None
    observed = projection.Observed(scheme, z)
    by_arrays = observed.function is scheme.observe
    if by_arrays and scheme.n > projection.MOST_N:
        return None
    short = observed.size <= 2 * scheme.n and sum(map(len, observed.members.values())) <= FEW
    if not (by_arrays and (arrays_only or (scheme.n > MOST_N and not short))):
        if by_arrays and scheme.basis:
            scheme_with_basis = replace(scheme, constants={**scheme.constants, **scheme.basis})
            constants, columns = flat_constants(scheme_with_basis, len(z))
        program, too_long = _program_between(scheme, columns, observed)
        if program is not None:
            width, every = WIDE if len(z) > 1 else 1, interval(cost_of([program]), ALONE * work)
            return CompiledProjection([program], compiled([program], width), every, z, constants, width)
        if not too_long:
            return None
    result = projection.ArrayProjection(observed, work) if by_arrays else None
    return result if result and result.labels else None


def _program_between(
    scheme: Scheme, columns: Mapping[str, slice], observed: projection.Observed
) -> tuple[Program | None, bool]:
    """The invariants on recorded scalars, None if there are none, and whether there would be too many lines."""
    members = tuple((name, tuple(chosen)) for name, chosen in observed.members.items())
    of_step = scheme.of_structure(scheme.kernel_key)
    key = None if of_step is None else (_program_between, of_step, members)

    def make() -> tuple[Program | None, bool]:
        try:
            return program_of(scheme, columns, observed.function, observed.members), False
        except TooLong:
            return None, True

    return reused(key, make)


class RowFunction:
    """Compiled function of rows z (rows, lanes, d), whose values are rows (rows, lanes, count).

    places  of each output by name, and its shape
    """

    def __init__(self, kernel: Kernel, constants: Floats, count: int, places: Mapping[str, tuple[slice, Any]]):
        self.count, self.places = count, places
        self._kernel, self.constants = kernel, constants
        self._addresses = (address_of(constants),) if constants.size else ()

    def __call__(self, z: Floats) -> Floats:
        """The values at rows z."""
        z, (rows, lanes, _) = np.ascontiguousarray(z), z.shape
        out = np.empty((rows, lanes, self.count))
        self._kernel.call(address_of(z), *self._addresses, address_of(out), rows, lanes)
        return out

    def named(self, z: Floats) -> dict[str, Floats]:
        """The outputs (rows, lanes, ...) at rows z, by name."""
        out, named = self(z), {}
        for name, (place, shape) in self.places.items():
            if len(shape) > 1:
                named[name] = out[..., place].reshape(*z.shape[:2], *shape)
            else:
                named[name] = out[..., place] if shape else out[..., place.start]
        return named

    def link(self, z: Floats, out: Floats) -> Link:
        """The call from one array to another."""
        constants = (self.constants,) if self._addresses else ()
        return self._kernel, (z, *constants, out, *z.shape[:2])


def row_function(
    scheme: Scheme, function: Callable[..., Mapping[str, Array]], lanes: int, name: tuple[Any, ...]
) -> RowFunction | None:
    """`function(parts, **constants)` of a scheme's components, compiled; None if that would be too slow.

    `name` tells the functions of a scheme apart.  On NumPy arrays one needs 5 to 20 us a row, as long as hundreds of
    steps.
    """
    if scheme.n > OBSERVED_N or not scheme.recordable:
        return None
    if lanes == 1 and name in scheme.compiled:
        result: RowFunction = scheme.compiled[name]
        return result
    constants, columns = flat_constants(scheme, lanes)

    def make() -> tuple[Kernel, int, Mapping[str, tuple[slice, Any]]] | None:
        try:
            outputs = recorded_outputs(scheme, function, columns)
        except (TypeError, AttributeError, ValueError, TooLong):  # a user-defined integral
            return None
        if operation_count(outputs.graph, outputs.values) > OBSERVED_LINES:
            return None
        inputs = {"z": (algebra.coordinate_count(scheme.kinds, scheme.n), True)}
        inputs |= {"c": (count_of(columns), False)} if columns else {}
        return outputs_by_rows(outputs.graph, outputs.values, inputs), len(outputs.values), outputs.places

    # the code has the places of the constants, which a scheme without constants of its trajectories lacks in part
    of_rows = scheme.of_structure(scheme.definition_key)
    code = reused(None if of_rows is None else (*name, tuple(columns), of_rows), make)
    if code is None:
        return None
    kernel, count, places = code
    result = RowFunction(kernel, constants if columns else np.empty(0), count, places)
    if scheme.definition_key is not None and lanes == 1:
        scheme.compiled[name] = result
    return result


def compiled_rate(scheme: Scheme, lanes: int = 1) -> Callable[[float, Floats, Floats], Floats]:
    """The right-hand side y' = f(t, y, constants) of a scheme that states a rate, compiled; of one lane at a time."""
    constants, columns = flat_constants(scheme, lanes)
    unknown = np.full_like(constants, np.nan)
    try:
        record = Recording(scheme, unknown, columns)
    except TooLong:
        return _rate_of_arrays(scheme, columns)
    piece = record.pieces[0]
    inputs = {"z": (record.state, True), "c": (record.count("c"), False)}
    kernel = outputs_by_rows(piece.graph, piece.outputs, inputs)

    def rate(t: float, y: Floats, c: Floats) -> Floats:
        y, c, out = np.ascontiguousarray(y), np.ascontiguousarray(c), np.empty(len(y))
        kernel.call(address_of(y), address_of(c), address_of(out), 1, 1)
        return out

    return rate


def _rate_of_arrays(scheme: Scheme, columns: Mapping[str, slice]) -> Callable[[float, Floats, Floats], Floats]:
    function, kinds, n = scheme.parts[0].function, scheme.kinds, scheme.n

    def rate(t: float, y: Floats, c: Floats) -> Floats:
        constants = constants_of(scheme, c, columns)
        return np.asarray(algebra.flatten(function(*algebra.restore(y, kinds, n), **constants), kinds))

    return rate


# -- constants rho of trajectories, compiled ---------------------------------------------------------

MOST = 6000  # operations; of a pair of Clebsch's case, n = 5: 5200
Folded = tuple[tuple[int, float], ...]


def compiled_point(
    scheme: Scheme, columns: Mapping[str, slice], name: str, pair: bool, width: int, folded: Folded = ()
) -> Kernel | None:
    """kernel(mu, z, c, out, points, lanes, of_c, of_out): mu and rho (points, 4 or 2) of lanes by mu (points, 2 or 1).

    name="spin": the entries of the scheme's `spin`, by mu.  of_c, of_out: the entries of a lane.  `folded`: outputs
    whose values are in the code of the step; with others there is NaN.  None if the definition cannot be recorded, or
    is too long.
    """

    def make() -> tuple[Kernel | None]:
        function, wanted = getattr(scheme, name), name == "point"
        graph, number = Graph(4 * MOST), DoubleDouble if scheme.wide and wanted else lambda x: x
        wide: Any = np.frompyfunc(number, 1, 1)
        try:
            state, constants = recorded_arguments(scheme, graph, {"c": columns})
            mu = graph.inputs("s", 1 + pair)
            x = Complex(*map(number, mu)) if pair else number(*mu)
            rho = function(*map(wide, state), mu=x, **{name: wide(value) for name, value in constants.items()})
            values = [*mu, *map(algebra.rounded, (rho.re, rho.im) if pair else (rho,))] if wanted else rho.ravel()
            outputs = as_operands(_marked([*values], folded))
        except (TypeError, AttributeError, ValueError, TooLong):  # by LAPACK
            return (None,)
        if operation_count(graph, outputs) > MOST:
            return (None,)
        count = algebra.coordinate_count(scheme.kinds, scheme.n)
        key = "points", graph.digest(outputs), count, len(mu), width
        return (kernel(key, 8, partial(_write_points, graph, outputs, (count, len(mu)), width)),)

    of_step = scheme.of_structure(scheme.kernel_key)
    key = None if of_step is None else (compiled_point, of_step, name, pair, width, folded)
    return reused(key, make)[0]


def _marked(values: list[Any], folded: Folded) -> list[Any]:
    """Values, the first of them NaN if one that is folded differs."""
    off = sum(abs(values[j] - value) for j, value in folded)
    return values if isinstance(off, float | int) else [values[0] + where_less(0, off, math.nan, 0.0), *values[1:]]


def _write_points(graph: Graph, outputs: list[Operand], counts: tuple[int, int], width: int, f: Function) -> None:
    """All that does not depend on mu first, for each vector of lanes."""
    (mu, z, c, out), (points, lanes, of_c, of_out) = map(f.doubles, f.arguments[:4]), f.arguments[4:]
    nodes, kind, size = graph.needed(outputs), kind_of(width), len(outputs)
    varying = depending(graph, nodes, "s".__eq__)
    f.vectors(width)
    with f.loop(0, lanes, width) as first:
        at, fixed = f.lanes(first, width, lanes), dict[int, Any]()
        rows = {"z": Lanes(z, at, counts[0]), "c": Lanes(c, at, of_c)}

        def load(letter: str, i: int) -> Any:
            return rows[letter][i]

        f.compute(graph, [i for i in nodes if i not in varying], fixed, load, kind)
        with f.loop(0, points) as point:
            values = dict(fixed)
            rows["s"] = Lanes(mu, [point] * width, counts[1])
            f.compute(graph, [i for i in nodes if i in varying], values, load, kind)
            Lanes(out.beyond(point * size), at, of_out).put([f.value(x, values, kind) for x in outputs])


def points(scheme: Scheme, x0: tuple[Array, ...], mus: Array, name: str = "point") -> Array | None:
    """rho (..., points), or the rotations `spin`, from states and orientations x0, not finite if there is none.

    None if they are not compiled.
    """
    z = np.ascontiguousarray(algebra.flatten(scheme.reopen(x0), scheme.kinds), dtype=np.float64)
    lead, lanes = z.shape[:-1], math.prod(z.shape[:-1])
    c, columns = flat_constants(scheme, lanes)
    code = compiled_point(scheme, columns, name, np.iscomplexobj(mus), register_width() if lanes > 1 else 1)
    if code is None:
        return None
    shape = (len(mus), 2) if name == "point" else (2, scheme.n, scheme.n)
    out = np.empty((*lead, *shape), mus.dtype)
    numbers = [x.view(np.float64) for x in (mus, z, c, out)]
    code(*map(address_of, numbers), len(mus), lanes, *(x.size // lanes for x in numbers[2:]))
    return out[..., 1] if name == "point" else out


def point_links(scheme: Scheme, engine: SteppedEngine, dt: float) -> tuple[list[Link], list[Floats]] | None:
    """The calls that put the constants of an engine's trajectories where its steps read them, and these places.

    With a constant that differs from the one that is folded into the code of the steps, one is NaN there.  None if
    other constants depend on the trajectory, and for code that is not compiled.
    """
    (lanes, count), stages, columns = engine.constants.shape, engine.stages, engine.columns
    if scheme.links is not None:
        return scheme.links(engine.z, stages), [stages.ravel()]
    if not {*columns} - {*scheme.constants} <= {"mu", "rho", *SPINS}:
        return None
    half = stages.shape[2] // 2
    rows = list[tuple[str, Floats, Floats, int, bool, Folded]]()
    if half:
        rows.append(("point", stages.ravel(), stages[0, :, :half], stages[0].size, half == 2, ()))
    special, entries = special_constants(engine.constants), engine.constants.ravel()
    for name, first, last in (("point", "mu", "rho"), ("spin", *SPINS)):  # which follow each other
        if first in columns:
            start, stop = columns[first].start, columns[last].stop
            folded = tuple((j - start, value) for j, value in special.items() if start <= j < stop)
            mu = np.array([[dt]]) if name == "spin" else engine.constants[:1, columns[first]]
            rows.append((name, entries[start:], mu, count, False, folded))
    links, width = list[Link](), register_width() if lanes > 1 else 1
    for name, out, mu, stride, pair, folded in rows:
        code = compiled_point(scheme, {key: columns[key] for key in scheme.constants}, name, pair, width, folded)
        if code is None:
            return None
        links.append((code, (mu.copy(), engine.z, engine.constants, out, len(mu), lanes, count, stride)))
    return links, [stages.ravel(), entries]
