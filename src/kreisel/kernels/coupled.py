"""Bodies that act on each other in pairs: lanes that meet between the parts of a step.

A stage is `drift` of all lanes, in vectors of lanes; a loop over the pairs, which sums what acts on each lane; `kick`
of all lanes.  The record is of one lane and of one pair, so what is compiled does not grow with their number.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from kreisel import algebra
from kreisel.kernels._llvm.machine import register_width
from kreisel.kernels.cpu import load_kernel, projection_between
from kreisel.kernels.layout import Floats, Look, no_look
from kreisel.kernels.projection.compiled import CompiledProjection
from kreisel.kernels.projection.program import recordable
from kreisel.kernels.recording import (
    Recording,
    columns_of,
    count_of,
    flat_constants,
    indented,
    recorded_arguments,
    recorded_numbers,
    recorded_values,
)
from kreisel.kernels.simd import HEAD, Functions, function_of_tuples, gathered
from kreisel.kernels.stepped import SteppedEngine
from kreisel.kernels.tape import Tape
from kreisel.method.scheme import Coupling, Scheme, too_large_to_couple

PULL = """
@compiled("f8[:,::1], f8[:,::1], f8[:,:,::1], f8[:,::1], i8[:,::1], f8[:,::1], i8")
def pull_all(z, c, s, p, pairs, forces, stage):
    for lane in range(len(forces)):
        for k in range({count}):
            forces[lane, k] = 0.0
    for pair in range(len(pairs)):
        i, j = pairs[pair, 0], pairs[pair, 1]
        f = numbers(forces, (i,), {count}, ()) + numbers(forces, (j,), {count}, ())
        f = pull(f, numbers(z, (i,), {size}, ()) + numbers(z, (j,), {size}, ()){more})
        put_numbers(forces, (i,), f[:{count}], ())
        put_numbers(forces, (j,), f[{count}:], ())

"""

KERNEL = """
WIDTH = {width}  # lanes at once


@compiled(
    "f8[:,::1], f8[:,::1], f8[:,:,::1], f8[:,::1], i8[:,::1], f8[:,:,::1], f8[:,::1], f8[:,::1], f8[:,::1], i8"
)
def kernel(z, c, s, p, pairs, out, forces, k, v, every):
    lanes, stages = len(z), s.shape[1]
    blocks = (lanes + WIDTH - 1) // WIDTH
    for block in range(blocks):
        lane = block * WIDTH
{begin}
    for row in range(out.shape[0]):
        for _ in range(every):
            for stage in range(stages):
                for block in range(blocks):
                    lane = block * WIDTH
                    scatter(z, (), lane, lanes, drift({state}{of_known}{of_stage}), WIDTH)
                pull_all(z, c, s, p, pairs, forces, stage)
                for block in range(blocks):
                    lane = block * WIDTH
                    scatter(z, (), lane, lanes, kick({state} + {pulled}{of_known}{of_stage}), WIDTH)
{close}
        for lane in range(lanes):
            put_numbers(out, (row, lane), numbers(z, (lane,), {size}, ()), ())
"""


class CoupledEngine(SteppedEngine):
    """Lanes that act on each other, advanced together on one core; `projection` as in `kreisel.kernels.cpu`."""

    def __init__(self, scheme: Scheme, z0: Floats, project: bool):
        super().__init__(scheme, z0)
        coupling = of(scheme)
        self._pairs, (self._of_pairs, pair_columns) = coupling.pairs, constants_of(coupling)
        record = Recording(scheme, self.constants, self.columns, self.stage_columns)
        if not record.straight:
            raise too_large_to_couple(scheme.name, scheme.n)
        columns = {"c": self.columns, "s": self.stage_columns, "p": pair_columns}
        self.source, self._room = source_of(record, scheme, columns, self.stages.shape[:2])
        self._kernel = load_kernel(self.source).kernel
        self.work = record.work
        if project:
            self.projection = recordable(lambda: projection_between(scheme, self.z, scheme.stage_count * record.work))

    def advance(self, out: Floats, every: int, look: Look = no_look) -> None:
        if self.projection is None:
            self._advance(out, every)
        else:
            self.projection.in_parts(out, every, self._advance, self._project)

    def _advance(self, out: Floats, every: int) -> None:
        room = [np.empty(shape) for shape in self._room]
        self._kernel(self.z, self.constants, self.stages, self._of_pairs, self._pairs, out, *room, every)

    def _project(self) -> Floats:
        if self.projection is not None:
            self.projection.apply()
        return self.z

    def begin(self, z: Floats, scheme: Scheme, steps: int) -> bool:
        if not isinstance(self.projection, CompiledProjection | None) or not self.adopts(scheme, z):
            return False
        if self.projection is not None:
            self.projection.begin(steps)
        return True


def of(scheme: Scheme) -> Coupling:
    """What the lanes of a scheme do to each other.  Raises `TypeError` where that is nothing."""
    if scheme.coupling is None:
        raise TypeError(f"the lanes of {scheme.name} are independent")
    return scheme.coupling


def constants_of(coupling: Coupling) -> tuple[Floats, dict[str, slice]]:
    """The constants of the pairs as rows (pairs, count), and where each stands."""
    return columns_of(coupling.constants, coupling.axes, (len(coupling.pairs),))


def compiled_pulls(scheme: Scheme, lanes: int) -> Callable[[Floats], Floats]:
    """z (lanes, d) -> what acts on each lane (lanes, forces), for a flow."""
    coupling = of(scheme)
    (constants, columns), (of_pairs, pair_columns) = flat_constants(scheme, lanes), constants_of(coupling)
    source = HEAD.format(name=f"{scheme.name} in pairs, n = {scheme.n}")
    source += _pull_source(scheme, {"c": columns, "s": {}, "p": pair_columns})
    pull_all = load_kernel(source).pull_all
    count, no_stages = _count_of_forces(scheme), np.zeros((lanes, 1, 0))

    def pulls(z: Floats) -> Floats:
        out = np.empty((lanes, count))
        pull_all(z, constants, no_stages, of_pairs, coupling.pairs, out, 0)
        return out

    return pulls


def source_of(
    record: Recording, scheme: Scheme, columns: Mapping[str, Mapping[str, slice]], size: tuple[int, ...]
) -> tuple[str, list[tuple[int, int]]]:
    """The functions of a step and a pair, and the kernel; and the shapes of forces, k, v for `size` lanes, stages."""
    functions, width = Functions.of(record), register_width()
    count, forces = len(record.state), _count_of_forces(scheme)
    known, staged = len(functions.known), len(functions.staged)

    here, varying = "lane, lanes", record.used("s") and not functions.by_stage
    rows = [gathered("c", record.count("c"), width)] * bool(record.used("c"))
    rows += [gathered("s[:, 0]", record.count("s"), width)] * bool(varying)
    begin = [f"here = known({', '.join(rows).format(here=here)})"]
    begin += [f"store(k, block * {known}, here, WIDTH)"] if known else []
    if staged:
        of_stage = f"staged(here, {gathered('s[:, stage]', record.count('s'), width).format(here=here)})"
        begin += [
            "for stage in range(stages):",
            f"    store(v, (block * stages + stage) * {staged}, {of_stage}, WIDTH)",
        ]
    of_known = f", load(k, block * {known}, {known}, {width})" if known else ", ()"
    state = gathered("z", count, width).format(here=here)
    close = [
        "for block in range(blocks):",
        "    lane = block * WIDTH",
        f"    scatter(z, (), lane, lanes, close({state}{of_known}), WIDTH)",
    ]
    lanes, stages = size
    blocks = -(-lanes // width)
    room = [(lanes, forces), (blocks * known, width), (blocks * stages * staged, width)]
    source = (
        HEAD.format(name=f"{scheme.name} in pairs, n = {scheme.n}")
        + functions.text
        + _pull_source(scheme, columns)
        + KERNEL.format(
            width=width,
            size=count,
            begin=indented(begin, 8),
            state=state,
            pulled=gathered("forces", forces, width).format(here=here),
            of_known=of_known,
            of_stage=f", load(v, (block * stages + stage) * {staged}, {staged}, {width})" if staged else "",
            close=indented(close if functions.closes else [], 12),
        )
    )
    return source, room


def _count_of_forces(scheme: Scheme) -> int:
    return algebra.coordinate_count(of(scheme).forces, scheme.n)


def _pull_source(scheme: Scheme, columns: Mapping[str, Mapping[str, slice]]) -> str:
    """The function of a pair: it adds what acts on both."""
    coupling, tape = of(scheme), Tape("p")
    kinds = scheme.kinds
    z, known = recorded_arguments(scheme, tape, {k: v for k, v in columns.items() if k != "p"}, tuple(kinds))
    for name, place in columns["p"].items():
        known[name] = recorded_numbers(tape, "p", place, np.shape(coupling.constants[name])[1:])
    found = coupling.pull(*z, **known)
    values: list[Any] = list(algebra.flatten(found, [*coupling.forces, *coupling.forces]))
    lines, sources = recorded_values(tape, values)
    size = algebra.coordinate_count(kinds, scheme.n)
    used = {name for line in lines for name in line.needs} | {source.strip("(-)") for source in sources}
    given = {"f": [f"f{k}" for k in range(len(values))], "z": [f"z{k}" for k in range(2 * size)]}
    more = ""
    for letter, at in (("c", "(i,)"), ("s", "(i, stage)"), ("p", "(pair,)")):
        if names := sorted(name for name in used if name[0] == letter and name[1:].isdigit()):
            given[letter] = names
            more += f", numbers({letter}, {at}, {count_of(columns[letter])}, ())"
    sums = [f if source == "0.0" else f"{f} + {source}" for f, source in zip(given["f"], sources, strict=True)]
    return function_of_tuples("pull", given, lines, sums) + PULL.format(size=size, count=len(values) // 2, more=more)
