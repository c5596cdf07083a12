"""Kernels of straight-line code: the step on numbers, or on vectors of lanes; the state stays in registers.

In an ensemble each number of the record becomes a vector (`kernels/_llvm/numbers.py`); lane i has the bits of a
run on its own.  A short step takes two or four vectors, one after the other in the same loop: while one waits for a
result, the others go on.  At a ragged end the last lane stands in the places that are left.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from kreisel.kernels._llvm.machine import register_width
from kreisel.kernels.array_code import Weave
from kreisel.kernels.printing import Line, latest
from kreisel.kernels.recording import Recording, indented, names_of

# Nanoseconds a lane-step with 1, 2, 4, 8 vectors, AVX2, n = 3: lagrange-top (32 lines) 1.9, 0.94, 0.61, 0.66; its
# moving frame (90) 2.5, 1.3, 0.89, -; clebsch (43) 3.9, 2.0, 1.4, 1.5; neumann (65) -, 3.2, 3.4, 3.6; baecklund of
# order 2 (93) -, 3.3, 3.2, 3.8, of order 8 (233 a stage) 24, 18, 16, -; n = 5: lagrange-top (143) 9.0, 8.8, 7.5, -.
# Each more takes longer to compile.
FOUR_VECTORS, TWO_VECTORS = 100, 300  # lines of a step up to which it takes so many; beyond, in the order of the record

HEAD = '''"""Made by kreisel.kernels by recording {name}; not to be edited."""
from math import cos, exp, log, sin, sqrt

from kreisel.kernels._llvm.machine import compiled
from kreisel.kernels._llvm.operations import (
    call_at_address, fma, gather, load, numbers, put_numbers, scatter, sign, store,
)
from kreisel.kernels._llvm.functions import straight

'''

FUNCTION = """
@straight
def {name}({arguments}):
{body}
    return {result}

"""

KERNEL = """
LANES = {lanes}  # at once


@compiled("f8[:,::1], f8[:,::1], f8[:,:,::1], f8[:,:,::1], f8[:,::1], i8, i8, i8{types}")
def kernel(z, c, s, out, v, every, first, last{arguments}):
    for lane in range(first, last, LANES):
        end = lane + min(LANES, last - lane)
{begin}
        for row in range(out.shape[0]):
{steps}
{save}
{store}
"""
STAGES = "for stage in range(s.shape[1]):"


class Source(NamedTuple):
    """Text, and the shape of the room `v` for what of a stage does not vary: the first number for each stage."""

    text: str
    room: tuple[int, int]


def simd_source(record: Recording, weave: Weave, lanes: int) -> Source:
    """The functions of a step, and the kernel: what does not vary from step to step comes before the first."""
    width = register_width() if lanes > 1 and record.straight else 1
    functions = Functions.of(record, width > 1)
    vectors = 1 if width == 1 else 4 if functions.lines <= FOUR_VECTORS else 2 if functions.short else 1
    while vectors > 1 and (vectors - 1) * width >= lanes:  # one of them would have no lane of its own
        vectors //= 2
    text = functions.text + _kernel_source(record, functions, weave, width, vectors)
    return Source(text, (vectors * len(functions.staged), width))


class Functions(NamedTuple):
    """The functions of a step.

    text     their source
    known    what is computed before the first step
    staged   what of the stages is computed before the first step
    by_stage whether a step has several stages
    closes   whether there is something at the end of a step
    lines    of a step
    """

    text: str
    known: list[str]
    staged: list[str]
    by_stage: bool
    closes: bool
    lines: int

    @property
    def short(self) -> bool:
        """Whether the lines are put in an order for several vectors."""
        return self.lines <= TWO_VECTORS

    @classmethod
    def of(cls, record: Recording, overlap: bool = True) -> Functions:
        """Those of a recorded step; `overlap`: in the order for several of them at a time, if it is short."""
        by_stage, early, fixed, late, of_stage, pieces = record.varying()
        constants, varying = record.used("c"), record.used("s")
        words = {name for piece in pieces for name in piece.words}
        staged = [name for name in (*late, *names_of(of_stage)) if name in words]
        words |= {name for line in of_stage for name in line.needs}
        known = [name for name in (*early, *names_of(fixed)) if name in words]

        lines = sum(len(piece.lines) for piece in pieces)
        rows = [("c", constants), ("s", [] if by_stage else varying)]
        text = function_of_tuples("known", {letter: names for letter, names in rows if names}, fixed, known)
        if staged:
            text += function_of_tuples("staged", {"k": known, "s": varying}, of_stage, staged)
        for piece in pieces:
            given = {"z": record.names(piece.part), "k": known}
            given |= {"v": staged} if piece.part.staged and staged else {}
            ordered = latest(piece.lines) if overlap and lines <= TWO_VECTORS else piece.lines
            text += function_of_tuples(piece.part.name, given, ordered, piece.new)
        return cls(text, known, staged, by_stage, pieces[-1].part.name == "close", lines)


def _kernel_source(record: Recording, functions: Functions, weave: Weave, width: int, vectors: int) -> str:
    """The loops, `vectors` of them side by side."""
    count = len(functions.staged)
    kept = vectors * count

    def each(indent: int, text: str) -> str:
        """A line for each vector."""
        lines = []
        for k in range(vectors):
            here, there = f"lane + {k * width}, end", f"v, stage * {kept} + {k * count}"
            lines.append(text.format(k=k, here=here, there=there))
        return indented(lines, indent)

    varying = record.used("s") and not functions.by_stage
    rows = [gathered("c", record.count("c"), width)] * bool(record.used("c"))
    rows += [gathered("s[:, 0]", record.count("s"), width)] * bool(varying)
    load = each(0, "z{k} = " + gathered("z", len(record.state), width))
    begin = [indented([*load.splitlines(), *weave.begin], 8), each(8, f"k{{k}} = known({', '.join(rows)})")]
    loaded = ""
    if functions.staged:
        of = f"staged(k{{k}}, {gathered('s[:, stage]', record.count('s'), width)})"
        begin += [indented([STAGES], 8), each(12, f"store({{there}}, {of}, {width})")]
        loaded = f", load({{there}}, {count}, {width})"
    step = f"z{{k}} = step(z{{k}}, k{{k}}{loaded})"
    steps = [STAGES, each(4, step)] if functions.by_stage else [each(0, step)]
    steps += [each(0, "z{k} = close(z{k}, k{k})")] if functions.closes else []
    back = each(0, f"scatter(z, (), {{here}}, z{{k}}, {width})")
    return KERNEL.format(
        types=weave.types,
        arguments=weave.arguments,
        lanes=vectors * width,
        begin="\n".join(begin),
        steps=indented(weave.steps("\n".join(steps), load, back, "end"), 12),
        save=each(12, f"scatter(out, (row,), {{here}}, z{{k}}, {width})"),
        store=indented(back.splitlines(), 8),
    )


def gathered(array: str, count: int, width: int) -> str:
    """The columns of the rows {here} of an array, as text."""
    return f"gather({array}, {count}, {{here}}, {width})"


def function_of_tuples(name: str, given: Mapping[str, list[str]], lines: list[Line], result: list[str]) -> str:
    """A function of tuples of numbers: c, s and p have all columns, not only those that are listed."""
    unpacked = [
        f"{', '.join(names)}, = {', '.join(f'{letter}[{n[1:]}]' for n in names)},"
        if letter in "csp"
        else f"{', '.join(names)}, = {letter}"
        for letter, names in given.items()
        if names
    ]
    return FUNCTION.format(
        name=name,
        arguments=", ".join(given),
        body=indented([*unpacked, *(part for line in lines for part in line.text.splitlines())], 4),
        result=f"({', '.join(result)}{',' * (len(result) == 1)})",
    )
