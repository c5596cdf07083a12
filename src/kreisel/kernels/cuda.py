"""Ensembles on an NVIDIA GPU: the kernel of `kreisel.kernels.cpu`, one thread a trajectory, the time loop inside.

It is printed from the same record.  Products go through an intrinsic that is rounded on its own, since the compiler
would otherwise fuse those that the record leaves apart; what the record fuses is fused here too.  In float64 each
operation is then that of the CPU; float32 is for those who ask for it.
"""

from __future__ import annotations

import importlib
import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from kreisel.errors import InputError
from kreisel.graph.graph import TooLong
from kreisel.graph.invariants import Program, program_of, program_of_orientation, recordable
from kreisel.graph.project import FLAT
from kreisel.kernels.cache import load_kernel
from kreisel.kernels.layout import Floats, Look, no_look
from kreisel.kernels.projection.corrections import EPS, GAIN, TAU, Corrections, interval
from kreisel.kernels.projection.text import block_arrays, block_sizes, projection_block
from kreisel.kernels.recording import Recording, flat_constants, flat_stages, indented
from kreisel.method.scheme import Scheme

THREADS = 128  # in a block
STAGES = "for stage in range(s.shape[0]):"
PRECISIONS = {"cuda": "float64", "cuda-float32": "float32"}
PRODUCT = re.compile(r"^(\s*\w+) = (\S+) \* (\S+)$", re.MULTILINE)
LITERAL = re.compile(r"(?<![\w.])(\d+\.\d*(?:e[+-]?\d+)?|\d+e[+-]?\d+)")

SOURCE = '''"""Made by kreisel.kernels.cuda by recording {name}; not to be edited."""
from math import cos, exp, log, sin, sqrt

from numba import config, cuda
from numpy import {real} as real

if config.ENABLE_CUDASIM:

    def multiply(x, y):
        return x * y

else:
    from numba.cuda.libdevice import {multiply} as multiply


@cuda.jit(device=True, inline="always")
def sign(x):
    return -1.0 if x < 0.0 else 1.0


@cuda.jit
def kernel(z, c, s, out, every):
    lane = cuda.grid(1)
    if lane < z.shape[1]:
{load}
        for row in range(out.shape[0]):
            for _ in range(every):
{steps}
{save}
{store}
'''


INLINE = '@cuda.jit(device=True, inline="always")'
ROOM = 1 << 30  # bytes on the GPU for projections
PROJECTION = '''"""Made by kreisel.kernels.cuda; not to be edited."""
from math import cos, exp, log, sin, sqrt

from numba import config, cuda

TAU, FLAT, EPS, GAIN, HUGE = {tau!r}, {flat!r}, {eps!r}, {gain!r}, 1e300

if config.ENABLE_CUDASIM:

    @cuda.jit(device=True, inline="always")
    def times(x, y):
        return x * y

else:
    from numba.cuda.libdevice import dmul_rn as times


@cuda.jit(device=True, inline="always")
def fma(x, y, z):
    return cuda.fma(x, y, z)


@cuda.jit(device=True, inline="always")
def size(x):
    return abs(x)


@cuda.jit(device=True, inline="always")
def where_less(x, y, yes, no):
    return yes if x < y else no


@cuda.jit(device=True, inline="always")
def get(room, row):
    return room[row, cuda.grid(1)]


@cuda.jit(device=True, inline="always")
def put(room, row, value):
    room[row, cuda.grid(1)] = value


@cuda.jit(device=True, inline="always")
def entry(room, row, w):
    return room[row, cuda.grid(1)]


@cuda.jit(device=True, inline="always")
def set_entry(room, row, w, value):
    room[row, cuda.grid(1)] = value


@cuda.jit(device=True, inline="always")
def number(array, i):
    return array[i]


@cuda.jit(device=True, inline="always")
def set_number(array, i, value):
    array[i] = value


@cuda.jit(device=True, inline="always")
def whole(array, i):
    return array[i]

{block}

@cuda.jit
def project(sizes, ops, runs, outs, ends, cones, columns, literals, targets, worst, z, c, room, first, begin):
    place = cuda.grid(1)
    lane = first + place
    if place < room.shape[1] and lane < sizes[2]:
        block(
            sizes, ops, runs, outs, ends, cones, columns, literals, targets, worst, z, c, room, lane, lane + 1, begin
        )
'''


def _gpu() -> Any:
    """The module numba.cuda.  Raises `InputError` where there is none, or no GPU."""
    try:
        cuda: Any = importlib.import_module("numba.cuda")
        found = cuda.is_available()
    except ImportError:
        found = False
    if not found:
        raise InputError(
            "engine='cuda' needs an NVIDIA GPU with its driver and the package numba-cuda (pip install "
            "'kreisel[cuda]'), and none was found here. Use engine='cpu', the default."
        )
    return cuda


def recorded_for_gpu(scheme: Scheme, constants: Floats, columns: Any, stage_columns: Any) -> Recording:
    """The record of a step.  Raises `InputError` where it is too long to be written out."""
    record = Recording(scheme, constants, columns, stage_columns)
    if record.places:
        raise InputError(
            f"engine='cuda' takes steps that can be written out, n <= 10 or so, got n = {scheme.n}. Use engine='cpu'."
        )
    return record


def cuda_source(record: Recording, precision: str) -> str:
    """The kernel's text."""
    state, varying = record.state, record.varying()
    pieces = [piece.source(state, 16) for piece in varying.pieces]
    if varying.by_stage:
        stage = [*_loaded(varying.late, "stage"), *(line.text for line in varying.of_stage)]
        pieces[0] = "\n".join([" " * 16 + STAGES, indented(stage, 20), varying.pieces[0].source(state, 20)])
    text = SOURCE.format(
        name=f"{record.scheme.name}, n = {record.n}, {precision}",
        real=precision,
        multiply={"float64": "dmul_rn", "float32": "fmul_rn"}[precision],
        load=indented(
            [
                *(f"{name} = z[{j}, lane]" for j, name in enumerate(state)),
                *_loaded(varying.early, "0"),
                *(line.text for line in varying.fixed),
            ],
            8,
        ),
        steps="\n".join(pieces),
        save=indented([f"out[row, {j}, lane] = {name}" for j, name in enumerate(state)], 12),
        store=indented([f"z[{j}, lane] = {name}" for j, name in enumerate(state)], 8),
    )
    head, mark, body = text.partition("def kernel(")
    body = PRODUCT.sub(r"\1 = multiply(\2, \3)", body).replace(" fma(", " cuda.fma(")
    if precision == "float32":
        body = LITERAL.sub(r"real(\1)", body)
    return head + mark + body


def _loaded(constants: list[str], stage: str) -> list[str]:
    places = {"c": "", "s": f"{stage}, "}
    return [f"{name} = {name[0]}[{places[name[0]]}{name[1:]}, lane]" for name in constants]


class CudaProjection(Corrections):
    """The projection on a GPU, one thread a state, of z (d, lanes) and constants (count, lanes) that lie there."""

    def __init__(self, program: Program, also: Program | None, every: int, cuda: Any, z: Any, constants: Any):
        super().__init__(program.labels, every, z.shape[1], len(also.outs) if also else 0)
        text = PROJECTION.format(
            tau=TAU,
            flat=FLAT,
            gain=GAIN,
            eps=EPS,
            block=projection_block(INLINE, "@cuda.jit(device=True)", "i * lanes + at", "j * lanes + at", 1),
        )
        self._kernel, self._cuda, self._z, self._constants = (
            load_kernel(text, by_numba=True).project,
            cuda,
            z,
            constants,
        )
        self._known = cuda.to_device(self.targets), cuda.to_device(self.worst)
        self._bound = cuda.to_device(self.bound)
        self._programs = [(*self._there(program), *(array.ravel() for array in self._known))]
        if also is not None:
            scratch = cuda.to_device(np.zeros(self.bound.shape[:2]))
            self._programs.append((*self._there(also), self._bound.ravel(), scratch.ravel()))
        rows = max(program.rows, also.rows if also else 0)
        self._room = rows, min(z.shape[1], max(THREADS, ROOM // (8 * rows)))
        self._call(1)
        self._read()

    def _call(self, begin: int) -> None:
        room = self._cuda.to_device(np.zeros(self._room))
        blocks = -(-self._room[1] // THREADS)
        for program in self._programs:
            for first in range(0, len(self.targets), self._room[1]):
                z, c = self._z.ravel(), self._constants.ravel()
                self._kernel[blocks, THREADS](*program, z, c, room, first, begin)

    def _there(self, program: Program) -> tuple[Any, ...]:
        arrays = (self._cuda.to_device(array.ravel()) for array in block_arrays(program))
        return block_sizes(program, self._z.shape[1], self._constants.shape[0]), *arrays

    def _read(self) -> None:
        arrays = (*self._known, self._bound)
        self.targets, self.worst, self.bound = (array.copy_to_host() for array in arrays)

    def apply(self) -> None:
        """Project the state on the GPU, in place."""
        self._call(0)
        self._read()

    def peek(self, z: Floats) -> Floats:
        before = self._z.copy_to_host()
        self._z.copy_to_device(np.ascontiguousarray(z.T))
        self._call(0)
        found = self._known[1].copy_to_host()
        self._z.copy_to_device(before)
        self._there_again()
        return np.asarray(found)

    def restore(self, snapshot: Mapping[str, Floats]) -> None:
        super().restore(snapshot)
        self._there_again()

    def _there_again(self) -> None:
        """What the GPU knows becomes what the host does."""
        for array, value in zip((*self._known, self._bound), (self.targets, self.worst, self.bound), strict=True):
            array.copy_to_device(value)


class CudaEngine:
    """The step on a GPU; `advance` as in `kreisel.kernels.cpu.CpuEngine`.  One number of all lanes lies in one row.

    float32 is not projected: what rounding does to it is far more.
    """

    def __init__(self, scheme: Scheme, z0: Floats, engine: str, project: bool = False):
        self._cuda, self._real = _gpu(), np.dtype(PRECISIONS[engine])
        self.z = np.asarray(z0).astype(self._real).astype(np.float64)
        constants, columns = flat_constants(scheme, len(self.z))
        stages, stage_columns = flat_stages(scheme, len(self.z))
        record = recorded_for_gpu(scheme, constants, columns, stage_columns)
        self.source = cuda_source(record, PRECISIONS[engine])
        self._kernel = load_kernel(self.source, by_numba=True).kernel
        self._constants = self._on_gpu(constants.T)
        self._stages = self._on_gpu(stages.transpose(1, 2, 0))
        self._state = self._on_gpu(self.z.T)
        try:
            program = recordable(lambda: program_of(scheme, columns)) if project and engine == "cuda" else None
        except TooLong:
            program = None
        also = program_of_orientation(scheme) if program else None
        self.projection: CudaProjection | None = None
        if program is not None:
            cost = program.cost + (also.cost if also else 0)
            every = interval(cost, record.work * scheme.stage_count, scheme.between)
            self.projection = CudaProjection(program, also, every, self._cuda, self._state, self._constants)

    def _on_gpu(self, values: Floats) -> Any:
        return self._cuda.to_device(np.ascontiguousarray(values, dtype=self._real))

    def advance(self, out: Floats, every: int, look: Look = no_look) -> None:
        if not len(self.z):
            return
        if self.projection is None:
            self._advance(out, every)
        else:
            self.projection.in_parts(out, every, self._advance, self._project)

    def _project(self) -> Floats:
        if self.projection is not None:
            self.projection.apply()
            self.z[:] = self._state.copy_to_host().T
        return self.z

    def _advance(self, out: Floats, every: int) -> None:
        rows = self._cuda.device_array((len(out), *self.z.shape[::-1]), dtype=self._real)
        blocks = -(-len(self.z) // THREADS)
        self._kernel[blocks, THREADS](self._state, self._constants, self._stages, rows, every)
        out[:] = rows.copy_to_host().transpose(0, 2, 1)
        self.z[:] = out[-1]

    def begin(self, z: Floats, scheme: Scheme, steps: int) -> bool:
        return False

    def snapshot(self) -> dict[str, Floats]:
        return {"z": self.z, **(self.projection.snapshot() if self.projection else {})}

    def restore(self, snapshot: Mapping[str, Floats]) -> None:
        self.z[:] = snapshot["z"]
        self._state.copy_to_device(np.ascontiguousarray(self.z.T, dtype=self._real))
        if self.projection:
            self.projection.restore(snapshot)
