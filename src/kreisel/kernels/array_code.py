"""Array code for n beyond straight-line code, compiled by Numba: one lane after the other."""

from __future__ import annotations

from typing import Any

from kreisel.kernels import dense
from kreisel.kernels.cache import load_kernel
from kreisel.kernels.recording import Recording, indented
from kreisel.method.scheme import Scheme

EXACT = 'cache=True, nogil=True, error_model="numpy"'
FAST = f'{EXACT}, fastmath={{"contract", "nsz", "arcp"}}'  # one kernel for a single run and for ensembles

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

RATE = """
@njit("void(f8[::1], f8[::1], f8[::1])", {options})
def kernel(z, c, out):
{body}
"""


class Weave:
    """How steps are written into a kernel: one after the other."""

    types = arguments = head = ""
    begin: tuple[str, ...] = ()  # lines before the first step

    def steps(self, step: str, load: str, store: str, end: str) -> list[str]:
        """The lines for `every` steps of the lanes from `lane` to `end`."""
        return ["for _ in range(every):", *(f"    {line}" for line in step.splitlines())]


class Woven(Weave):
    """And every `often` steps a projection, with room for it at the address `room`."""

    types = ", i8, i8, i8, i8, i8"
    arguments = ", begun, often, project, table, room"
    begin = ("done = begun",)
    head = "from kreisel.kernels._numba.pointers import call_at_address\n\n"  # of array code

    def steps(self, step: str, load: str, store: str, end: str) -> list[str]:
        return [
            "left = every",
            "while left > 0:",
            "    count = min(left, often - done)",
            "    for _ in range(count):",
            *(f"        {line}" for line in step.splitlines()),
            "    left, done = left - count, done + count",
            "    if done == often:",
            "        done = 0",
            *(f"        {line}" for line in store.splitlines()),
            f"        call_at_address(project, (table, room, lane, {end}, 0))",
            *(f"        {line}" for line in load.splitlines()),
        ]


def head(scheme: Scheme) -> str:
    """What all array code begins with."""
    return HEAD.format(name=f"{scheme.name}, n = {scheme.n}") + dense.HELPERS.format(options=FAST)


def compiled_arrays(record: Recording, project: bool) -> Any:
    """kernel(z, c, s, out, every, first, last, ...) of array code, with projections between steps."""
    weave = Woven() if project else Weave()
    source = head(record.scheme) + weave.head + _array_source(record, weave)
    return load_kernel(source, by_numba=True).kernel


def compiled_array_rate(record: Recording) -> Any:
    """kernel(z, c, out) of a rate."""
    load = [record.load("z[", 4), record.load_constants("c", "c[", 4)]
    body = "\n".join([*load, record.body(4), record.save("out[", 4)])
    return load_kernel(head(record.scheme) + RATE.format(options=FAST, body=body), by_numba=True).kernel


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


def compiled_large(scheme: Scheme, printer: Any, columns: Any, stage_columns: Any) -> Any:
    """kernel(z, c, s, out, every, first, last) of O(n), as it is printed."""
    source = printer(columns, stage_columns, HEAD.format(name=f"{scheme.name}, n = {scheme.n}"), EXACT)
    return load_kernel(source, by_numba=True).kernel
