"""Compiled kernels for the CPU, made from a scheme's step by recording it.

Up to n = 10, if it is not too long, the record is straight-line scalar code; beyond, compiled array code with the
same operations.  An ensemble of straight-line code runs on vectors of lanes (`kreisel.kernels.simd`); lane i has the
bits of a run on its own.  Shares of the lanes go to threads (`kreisel.kernels.threads`).
Straight-line code goes to LLVM as it is (`kreisel.kernels._llvm`), array code by Numba.
Source and machine code are kept on disk (`kreisel.kernels.cache`), named by the hash of the source, of the operations
that it imports and of what it is compiled for.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.algebra.reuse import reused
from kreisel.kernels import dense, simd
from kreisel.kernels.cache import load_kernel as load_kernel
from kreisel.kernels.layout import Floats, Look, no_look
from kreisel.kernels.projection import arrays
from kreisel.kernels.projection.compiled import CompiledProjection, Weave, compiled, plain, woven
from kreisel.kernels.projection.corrections import ALONE, Corrections, interval
from kreisel.kernels.projection.program import MOST_N, Program, cost_of, program_of, program_of_orientation, recordable
from kreisel.kernels.projection.text import WIDTH as WIDE
from kreisel.kernels.recording import (
    Recording,
    count_of,
    flat_constants,
    flat_stages,
    indented,
    recorded_outputs,
    special_constants,
)
from kreisel.kernels.stepped import SteppedEngine
from kreisel.kernels.tape import TooLong
from kreisel.kernels.threads import on_threads
from kreisel.method.scheme import Scheme

if TYPE_CHECKING:
    from kreisel.kernels.large.blockwise import Printer

# Straight-line code has its fused products written out (`kreisel.kernels.printing`); a flag that lets LLVM choose would
# make it choose otherwise in scalar than in vector code.
EXACT = 'cache=True, nogil=True, error_model="numpy"'
FAST = f'{EXACT}, fastmath={{"contract", "nsz", "arcp"}}'  # array code: one kernel for a single run and for ensembles
OBSERVED_N, OBSERVED_LINES = 8, 1000  # as many lines compile in a second
MOST_LARGE_N = 500  # up to which kernels of O(n) are projected: recording takes a second
FEW = (
    20  # invariants of a position and a momentum that are recorded beyond MOST_N too: those of Rosochatius take minutes
)

NOTHING = np.empty((0, 1))

HEAD = '''"""Made by kreisel.kernels.cpu by recording {name}; not to be edited."""
from math import cos, exp, log, sin, sqrt

import numpy as np
from numba import njit
from numpy import ascontiguousarray, concatenate, empty, eye, full
from numpy.linalg import solve

from kreisel.kernels._numba.fused import fma, sign

'''

ADVANCE = """
@njit("void(f8[:,::1], f8[:,::1], f8[:,:,::1], f8[:,:,::1], i8, i8, i8{types})", {options})
def kernel(z, c, s, out, every, first, last{arguments}):
    for lane in range(first, last):
{load}
        for row in range(out.shape[0]):
{steps}
{save}
{store}
"""

STEP = """for stage in range(s.shape[1]):
{stage}
{body}
{close}"""

OBSERVE = """
@compiled("f8[:,:,::1], f8[:,::1], f8[:,:,::1]")
def kernel(z, c, out):
    for row in range(z.shape[0]):
        for lane in range(z.shape[1]):
            put_numbers(out, (row, lane), observe({given}), ())
"""

RATE = """
@{decorator}
def kernel(z, c, out):
{body}
"""


@dataclass(frozen=True)
class Code:
    """A step compiled, `work` operations a stage, and the programs of a projection that its kernel calls, if it does.

    `tried`: whether such programs were looked for.
    """

    source: str
    kernel: Any
    work: int
    room: tuple[int, int] | None = None  # as in `simd.Source`; None where lanes are arrays
    programs: tuple[Program, ...] = ()  # of the invariants, and of the orientation
    project: Any = None  # `compiled` of them
    every: int = 0  # steps between two projections
    width: int = 1  # lanes that are projected at once
    tried: bool = False


def code_of(
    scheme: Scheme, constants: Floats, columns: Mapping[str, slice], stage_columns: Mapping[str, slice], project: bool
) -> Code:
    """The code of a scheme's step for the lanes of `constants` (lanes, count)."""
    special = tuple(special_constants(constants).items())  # which are folded into the code
    key = None if scheme.kernel_key is None else (Code, scheme.kernel_key, len(constants), special, project)

    def make() -> Code:
        record = Recording(scheme, constants, columns, stage_columns)
        in_vectors, tried = len(constants) > 1 and record.straight, project and scheme.n <= MOST_N
        try:
            program = recordable(lambda: program_of(scheme, columns)) if tried else None
        except TooLong:
            tried, program = False, None
        programs = [part for part in (program, program and program_of_orientation(scheme)) if part is not None]
        width, every, weave, project_them = (WIDE if in_vectors else 1), 0, plain, None
        if programs:
            every = interval(cost_of(programs), record.work * scheme.stage_count, scheme.between)
            weave, project_them = woven, compiled(programs, width)
        source, room = _head(scheme, record), None
        if record.places:
            source += weave.head + _array_source(record, weave)
        else:
            text, room = simd.simd_source(record, weave, len(constants))
            source += text
        kernel = load_kernel(source, by_numba=True).kernel if room is None else load_kernel(source).kernel.call
        return Code(source, kernel, record.work, room, tuple(programs), project_them, every, width, tried)

    return reused(key, make)


class CpuEngine(SteppedEngine):
    """A compiled step, its state in rows (lanes, d), and its constants.

    `advance(out, every)` makes `every` steps for each row of `out` (rows, lanes, d) and stores the state there.
    With `project` the state is put back on its invariants now and then (`kreisel.kernels.projection.program`).
    """

    def __init__(self, scheme: Scheme, z0: Floats, printer: Printer | None = None, project: bool = False):
        super().__init__(scheme, z0)
        self._woven: CompiledProjection | None = None  # the projection, where the kernel calls it
        self._between: Corrections | None = None  # where it does not
        if printer is not None:
            code = self._printed(printer)
        else:
            code = code_of(scheme, self.constants, self.columns, self.stage_columns, project)
        self.source, self._kernel, self.work = code.source, code.kernel, code.work  # operations of a stage
        self._room = code.room
        if code.programs:
            parts = [*code.programs], code.project, code.every, self.z, self.constants, code.width
            self.projection = self._woven = CompiledProjection(*parts)
        elif project and not code.tried:
            work = scheme.stage_count * code.work
            self._between = recordable(lambda: projection_between(scheme, self.z, work, arrays_only=printer is None))
            self.projection = self._between

    def _printed(self, printer: Printer) -> Code:
        scheme = self.scheme

        def make() -> Code:
            head = HEAD.format(name=f"{scheme.name}, n = {scheme.n}")
            source = printer(self.columns, self.stage_columns, head, EXACT)
            return Code(source, load_kernel(source, by_numba=True).kernel, _large_work(scheme))

        return reused(None if scheme.kernel_key is None else (Code, scheme.kernel_key), make)

    def advance(self, out: Floats, every: int, look: Look = no_look) -> None:
        if self._between is not None:
            self._between.in_parts(out, every, self._advance, self._project)
        else:
            self._advance(out, every)
            if self._woven is not None:
                self._woven.count(len(out) * every)

    def _known(self) -> Floats:
        """Room for what of the stages does not vary; each thread has its own."""
        count, width = self._room or (0, 1)
        return np.empty((self.stages.shape[1] * count, width)) if count else NOTHING

    def _project(self) -> Floats:
        if self._between is not None:
            self._between.apply()
            arrays.orthogonal(self.scheme, self.z)
        return self.z

    def _advance(self, out: Floats, every: int) -> None:
        more = self._woven.arguments if self._woven else ()

        def work_on(first: int, last: int) -> None:
            room = (self._woven.room(first),) if self._woven else ()
            arrays: tuple[Floats, ...] = self.z, self.constants, self.stages, out
            if self._room is not None:
                arrays = *arrays, self._known()
            self._kernel(*arrays, every, first, last, *more, *room)

        on_threads(len(self.z), len(out) * every * len(self.z), work_on)

    def begin(self, z: Floats, scheme: Scheme, steps: int) -> bool:
        if self._between is not None or not self.adopts(scheme, z):
            return False
        if self._woven is not None:
            self._woven.begin(steps)
        return True


def compiled_step(
    scheme: Scheme, constants: Floats, columns: Mapping[str, slice]
) -> Callable[[Floats, Floats, int], None]:
    """`advance(z, constants, count)` for any number of rows z (lanes, d), with constants that are like these.

    One lane after the other: a kernel for vectors of lanes takes 4 s to compile where this one takes 0.6 s.
    """
    stages, stage_columns = flat_stages(scheme, 1)
    one_lane = np.where((constants == constants[:1]).all(0), constants[:1], np.nan)  # what varies is not folded
    code = code_of(scheme, one_lane, columns, stage_columns, False)
    count, width = code.room or (0, 1)

    def advance(z: Floats, c: Floats, steps: int) -> None:
        s, out = np.broadcast_to(stages, (len(z), *stages.shape[1:])).copy(), np.empty((1, *z.shape))
        room = (np.empty((stages.shape[1] * count, width)) if count else NOTHING,) if code.room is not None else ()
        code.kernel(z, c, s, out, *room, steps, 0, len(z))

    return advance


def projection_between(scheme: Scheme, z: Floats, work: float, arrays_only: bool = False) -> Corrections | None:
    """The projection of rows z for kernels that do not call it; None where nothing is conserved."""
    if scheme.n > (arrays.MOST_N if scheme.conserved is None else MOST_LARGE_N):
        return None
    observed = arrays.Observed(scheme, z)
    by_arrays = observed.function is scheme.observe
    if by_arrays and scheme.n > arrays.MOST_N:
        return None
    short = observed.own <= 2 * scheme.n and sum(map(len, observed.members.values())) <= FEW
    if not (by_arrays and (arrays_only or (scheme.n > MOST_N and not short))):
        more = scheme.basis if by_arrays else {}
        constants, columns = flat_constants(replace(scheme, constants={**scheme.constants, **more}), len(z))
        program, too_long = _program_between(scheme, columns, observed)
        if program is not None:
            width, every = WIDE if len(z) > 1 else 1, interval(cost_of([program]), ALONE * work)
            return CompiledProjection([program], compiled([program], width), every, z, constants, width)
        if not too_long:
            return None
    found = arrays.ArrayProjection(observed, work) if by_arrays else None
    return found if found and found.labels else None


def _program_between(
    scheme: Scheme, columns: Mapping[str, slice], observed: arrays.Observed
) -> tuple[Program | None, bool]:
    """The invariants on recorded numbers, None where there are none, and whether there would be too many lines."""
    members = tuple((name, tuple(chosen)) for name, chosen in observed.members.items())
    key = None if scheme.kernel_key is None else (_program_between, scheme.kernel_key, members)

    def make() -> tuple[Program | None, bool]:
        try:
            return program_of(scheme, columns, observed.function, observed.members), False
        except TooLong:
            return None, True

    return reused(key, make)


def _large_work(scheme: Scheme) -> int:
    """About how many operations a stage is in a kernel of O(n), or O(n^2) where it keeps a matrix."""
    n, dense = scheme.n, any(kind == f"R^{scheme.n**2}" for _, kind in scheme.components)
    return 200 * n + 4 * n * n if dense else 60 + 4 * n  # measured for n = 10 and 100


def _array_source(record: Recording, weave: Weave) -> str:
    """The kernel of array code, one lane after the other."""
    step = STEP.format(
        stage=record.load_constants("s", "s[lane, stage, ", 4), body=record.body(4), close=record.close(0)
    )
    load, store = record.load("z[lane, ", 0), record.save("z[lane, ", 0)
    return ADVANCE.format(
        options=FAST,
        types=weave.types,
        arguments=weave.arguments,
        load=indented([*load.splitlines(), *record.load_constants("c", "c[lane, ", 0).splitlines(), *weave.begin], 8),
        steps=indented(weave.steps(step, load, store, "lane + 1"), 12),
        save=record.save("out[row, lane, ", 12),
        store=indented(store.splitlines(), 8),
    )


def compiled_observe(
    scheme: Scheme, function: Callable[..., Mapping[str, Array]], lanes: int, chosen: tuple[str, ...] | None = None
) -> Callable[[Floats], dict[str, Floats]] | None:
    """`function(parts, **constants)` for rows z (rows, lanes, d), compiled; None where that would take too long.

    `chosen`: names of what it gives beside the state, where that is not all that the scheme observes.
    The definition itself, on NumPy arrays, takes 5 to 20 us a row, as long as hundreds of steps.
    """
    found = compiled_rows(scheme, function, lanes, ("observe", chosen))
    if found is None:
        return None
    rows, places = found

    def observe(z: Floats) -> dict[str, Floats]:
        out = rows(np.ascontiguousarray(z))
        return {name: out[..., place].reshape(*z.shape[:2], *shape) for name, (place, shape) in places.items()}

    return observe


def compiled_rows(
    scheme: Scheme, function: Callable[..., Mapping[str, Array]], lanes: int, name: tuple[Any, ...]
) -> tuple[Callable[[Floats], Floats], Mapping[str, tuple[slice, tuple[int, ...]]]] | None:
    """The same as rows of numbers (rows, lanes, count), and where those of each output are.

    `name` tells the functions of a scheme apart.
    """
    if scheme.n > OBSERVED_N or not scheme.recordable:
        return None
    constants, columns = flat_constants(scheme, lanes)
    key = None if scheme.definition_key is None else (*name, scheme.definition_key)
    found = reused(key, lambda: _observing(scheme, function, columns))
    if found is None:
        return None
    kernel, count, places = found

    def rows(z: Floats) -> Floats:
        out = np.empty((*z.shape[:2], count))
        kernel(z, constants, out)
        return out

    return rows, places


def _observing(
    scheme: Scheme, function: Callable[..., Mapping[str, Array]], columns: Mapping[str, slice]
) -> tuple[Any, int, Mapping[str, tuple[slice, tuple[int, ...]]]] | None:
    """The kernel of `compiled_observe`, how many numbers it gives, and where those of each output are."""
    try:
        found = recorded_outputs(scheme, function, columns)
    except (TypeError, AttributeError, ValueError):  # an integral of a user's own
        return None
    if len(found.lines) > OBSERVED_LINES:
        return None
    used = {name for line in found.lines for name in line.needs} | {value.strip("(-)") for value in found.values}
    size = algebra.coordinate_count(scheme.kinds, scheme.n)
    constants = sorted(name for name in used if name[0] == "c" and name[1:].isdigit())
    given = {"z": [f"z{i}" for i in range(size)], **({"c": constants} if constants else {})}
    rows = f"numbers(z, (row, lane), {size}, ())"
    rows += f", numbers(c, (lane,), {count_of(columns)}, ())" if constants else ""
    source = simd.HEAD.format(name=f"what {scheme.name} observes, n = {scheme.n}")
    source += simd.function_of_tuples("observe", given, found.lines, found.values)
    source += OBSERVE.format(given=rows)
    return load_kernel(source).kernel.call, len(found.values), found.places


def _head(scheme: Scheme, record: Recording) -> str:
    name = f"{scheme.name}, n = {scheme.n}"
    return HEAD.format(name=name) + dense.HELPERS.format(options=FAST) if record.places else simd.HEAD.format(name=name)


def compiled_rate(scheme: Scheme, lanes: int = 1) -> Callable[[float, Floats, Floats], Floats]:
    """The right-hand side y' = f(t, y, constants) of a scheme that states a rate, compiled; of one lane at a time."""
    constants, columns = flat_constants(scheme, lanes)
    record = Recording(scheme, np.full_like(constants, np.nan), columns)
    if record.places:
        load = [record.load("z[", 4), record.load_constants("c", "c[", 4)]
        functions, body = "", "\n".join([*load, record.body(4), record.save("out[", 4)])
    else:
        piece, known = record.pieces[0], record.used("c")
        given = {"z": record.state, **({"c": known} if known else {})}
        functions = simd.function_of_tuples("rate", given, piece.lines, piece.new)
        rows = f"numbers(z, (), {len(record.state)}, ())"
        rows += f", numbers(c, (), {count_of(columns)}, ())" if known else ""
        body = f"    put_numbers(out, (), rate({rows}), ())"
    arguments = "f8[::1], f8[::1], f8[::1]"
    decorator = f'njit("void({arguments})", {FAST})' if record.places else f'compiled("{arguments}")'
    source = _head(scheme, record) + functions + RATE.format(decorator=decorator, body=body)
    kernel = load_kernel(source, by_numba=bool(record.places)).kernel

    def rate(t: float, y: Floats, c: Floats) -> Floats:
        out = np.empty_like(y)
        kernel(np.ascontiguousarray(y), c, out)
        return out

    return rate
