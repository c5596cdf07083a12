"""The compiled projection, and how kernels call it."""

from __future__ import annotations

from typing import Any

import numpy as np

from kreisel.algebra.reuse import Identity, reused
from kreisel.kernels.cache import load_kernel
from kreisel.kernels.layout import Floats
from kreisel.kernels.projection.corrections import Corrections
from kreisel.kernels.projection.program import Program, written_out
from kreisel.kernels.projection.text import LINE, projection_source, straight_source


class Weave:
    """How steps are written into a kernel: one after the other."""

    types = arguments = head = ""
    begin: tuple[str, ...] = ()  # lines before the first step

    def steps(self, step: str, load: str, store: str, end: str) -> list[str]:
        """The lines for `every` steps of the lanes from `lane` to `end`."""
        return ["for _ in range(every):", *(f"    {line}" for line in step.splitlines())]


plain = Weave()


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


woven = Woven()


def room_of(programs: list[Program], width: int) -> int:
    """Numbers that projections of `width` lanes at once need as room."""
    return LINE // 8 + (0 if written_out(programs) else width * max(program.rows for program in programs))


def compiled(programs: list[Program], width: int) -> Any:
    """The compiled projection of `width` lanes at once by these programs, one after the other."""

    def made() -> Any:
        source = straight_source(programs, width) if written_out(programs) else projection_source(width)
        return load_kernel(source).project

    return reused(("projection", width, *map(Identity, programs)), made)


class CompiledProjection(Corrections):
    """The compiled projection of rows z (lanes, d), which kernels call by its address.

    programs  of the invariants, and of what binds an orientation to the state
    project   `compiled` of them, `width` lanes at once
    """

    def __init__(self, programs: list[Program], project: Any, every: int, z: Floats, constants: Floats, width: int):
        super().__init__(programs[0].labels, every, len(z), sum(len(program.outs) for program in programs[1:]))
        self._z, self._compiled, self._room = z, project, room_of(programs, width)
        self._held: list[np.ndarray] = []  # as long as their addresses are used
        self._rooms: dict[int, int] = {}
        make, following = self._short_table if written_out(programs) else self._table, 0
        for program in reversed(programs):
            first = program is programs[0]
            targets, worst = (self.targets, self.worst) if first else (self.bound, np.zeros(self.bound.shape[:2]))
            following = make(program, targets, worst, constants, following)
        self._first = following
        self._call(1)

    def _short_table(self, program: Program, targets: Floats, worst: Floats, constants: Floats, following: int) -> int:
        """The address of a table of all that a projection needs that is written out."""
        arrays = targets, worst, self._z, constants
        return self._hold(arrays, [*(array.ctypes.data for array in arrays), constants.shape[1], following])

    def _table(self, program: Program, targets: Floats, worst: Floats, constants: Floats, following: int) -> int:
        """The address of a table of all that is needed for a program."""
        arrays = (*program.arrays, targets, worst, self._z, constants)
        addresses = [array.ctypes.data for array in arrays]
        return self._hold(arrays, [*program.sizes(len(self._z), constants.shape[1]), *addresses, following])

    def _hold(self, arrays: tuple[np.ndarray, ...], table: list[int]) -> int:
        self._held += [*arrays, np.array(table, dtype=np.int64)]
        return self._held[-1].ctypes.data

    @property
    def arguments(self) -> tuple[int, ...]:
        """What a kernel takes for it before the address of `room`."""
        return self.done, self.every, self._compiled.address, self._first

    def room(self, first: int) -> int:
        """The address of room for the thread whose lanes begin with this one."""
        if first not in self._rooms:
            room = np.zeros(self._room)
            self._held.append(room)  # threads ask at once: the last of these may be that of another one
            self._rooms[first] = room.ctypes.data
        return self._rooms[first]

    def _call(self, begin: int) -> None:
        self._compiled(self._first, self.room(0), 0, len(self._z), begin)

    def begin(self, steps: int) -> None:
        """Take the values at the start from the rows z as they are now, if that many steps are projected at all."""
        self.done = 0
        self.worst[:] = 0
        if steps >= self.every:
            self.targets[:] = self.bound[:] = 0
            self._call(1)

    def apply(self) -> None:
        """Project the state, in place."""
        self._call(0)

    def peek(self, z: Floats) -> Floats:
        arrays = self._z, self.worst, self.targets, self.bound
        before = [array.copy() for array in arrays]
        self._z[:] = z
        self._call(0)
        found = self.worst.copy()
        for array, value in zip(arrays, before, strict=True):
            array[:] = value
        return found
