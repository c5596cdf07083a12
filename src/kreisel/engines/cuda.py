"""Ensembles on an NVIDIA GPU: the kernel of `kreisel.engines.cpu`, one thread a trajectory, the time loop inside.

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

from kreisel.engines.cpu import load
from kreisel.engines.layout import Floats, Look, no_look
from kreisel.engines.recording import Recording, flat_constants, flat_stages, indented
from kreisel.errors import InputError
from kreisel.methods.scheme import Scheme

THREADS = 128  # in a block
STAGES = "for stage in range(s.shape[0]):"
PRECISIONS = {"cuda": "float64", "cuda-float32": "float32"}
PRODUCT = re.compile(r"^(\s*\w+) = (\S+) \* (\S+)$", re.MULTILINE)
LITERAL = re.compile(r"(?<![\w.])(\d+\.\d*(?:e[+-]?\d+)?|\d+e[+-]?\d+)")

SOURCE = '''"""Made by kreisel.engines.cuda by recording {name}; not to be edited."""
from math import sqrt

from numba import config, cuda
from numpy import {real} as real

if config.ENABLE_CUDASIM:

    def multiply(x, y):
        return x * y

else:
    from numba.cuda.libdevice import {multiply} as multiply


@cuda.jit(device=True, inline="always")
def plain_sum(x, y):
    return x + y


@cuda.jit(device=True, inline="always")
def sum_error(x, y):
    total = x + y
    part = total - x
    return (x - (total - part)) + (y - part)


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


def source(scheme: Scheme, constants: Floats, columns: Any, stage_columns: Any, precision: str) -> str:
    """The kernel's text.  Raises `InputError` where the step is too long to be written out."""
    record = Recording(scheme, constants, columns, stage_columns)
    if record.places:
        raise InputError(
            f"engine='cuda' takes steps that can be written out, n <= 10 or so; n = {scheme.n} came. Use engine='cpu'."
        )
    state, varying = record.state, record.varying()
    pieces = [piece.source(state, 16) for piece in varying.pieces]
    if varying.by_stage:
        stage = [*_loaded(varying.late, "stage"), *(line.text for line in varying.of_stage)]
        pieces[0] = "\n".join([" " * 16 + STAGES, indented(stage, 20), varying.pieces[0].source(state, 20)])
    text = SOURCE.format(
        name=f"{scheme.name}, n = {scheme.n}, {precision}",
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


class Kernel:
    """The step on a GPU; `advance` as in `kreisel.engines.cpu.Kernel`.  One number of all lanes lies in one row."""

    projection = None

    def __init__(self, scheme: Scheme, z0: Floats, engine: str):
        self._cuda, self._real = _gpu(), np.dtype(PRECISIONS[engine])
        self.z = np.asarray(z0).astype(self._real).astype(np.float64)
        constants, columns = flat_constants(scheme, len(self.z))
        stages, stage_columns = flat_stages(scheme, len(self.z))
        self.source = source(scheme, constants, columns, stage_columns, PRECISIONS[engine])
        self._kernel = load(self.source).kernel
        self._constants = self._on_gpu(constants.T)
        self._stages = self._on_gpu(stages.transpose(1, 2, 0))
        self._state = self._on_gpu(self.z.T)

    def _on_gpu(self, values: Floats) -> Any:
        return self._cuda.to_device(np.ascontiguousarray(values, dtype=self._real))

    def advance(self, out: Floats, every: int, look: Look = no_look) -> None:
        if not len(self.z):
            return
        rows = self._cuda.device_array((len(out), *self.z.shape[::-1]), dtype=self._real)
        blocks = -(-len(self.z) // THREADS)
        self._kernel[blocks, THREADS](self._state, self._constants, self._stages, rows, every)
        out[:] = rows.copy_to_host().transpose(0, 2, 1)
        self.z[:] = out[-1]

    def snapshot(self) -> dict[str, Floats]:
        return {"z": self.z}

    def restore(self, snapshot: Mapping[str, Floats]) -> None:
        self.z[:] = snapshot["z"]
        self._state = self._on_gpu(self.z.T)
