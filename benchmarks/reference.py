"""The recorded map in double-double in C++: the states that a kernel would have without rounding errors.

It shares the formulas with the kernel, and nothing of its arithmetic: the difference of the two is rounding.
"""

from __future__ import annotations

import hashlib
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from kreisel.graph.recording import Piece, Recording, flat_constants, flat_stages
from kreisel.languages.dialects import C
from kreisel.languages.writer import Writer

NUMBERS = replace(
    C,
    once="const dd {} = {};",
    calls={
        **C.calls,
        "max": "max({0}, {1})",
        "sign": "sign({0})",
        "size": "size({0})",
        "where": "where_less({0}, {1}, {2}, {3})",
    },
)
PLACES = {"z": "x[{}]", "c": "c[{}]", "s": "s[stage * OF_STAGE + {}]"}
HERE = Path(__file__).parent
FLAGS = ["-O2", "-march=native", "-ffp-contract=off", "-std=c++17"]
SOURCE = """#include "double_double.hpp"
#include <cstdint>
#include <cstdio>
#include <vector>
static const int OF_STAGE = {of_stage};
static std::vector<double> read(FILE *f, size_t n) {{
    std::vector<double> x(n);
    if (fread(x.data(), 8, n, f) != n) throw 1;
    return x;
}}
int main(int, char **argv) {{
    FILE *in = fopen(argv[1], "rb"), *out = fopen(argv[2], "wb");
    std::vector<double> rows = read(in, 1);
    std::vector<double> counts = read(in, (size_t)rows[0]), z = read(in, {size}), c = read(in, {constants});
    std::vector<double> s = read(in, {stages} * {of_stage});
    std::vector<dd> x(z.begin(), z.end());
    int64_t done = 0;
    for (double count : counts) {{
        for (; done < (int64_t)count; done++) {{
            for (int stage = 0; stage < {stages}; stage++) {{
{step}
            }}
{close}
        }}
        for (dd v : x) fwrite(&v, 8, 2, out);
    }}
    fclose(out);
}}
"""


class Reference:
    """The map of a plan of one lane, compiled."""

    def __init__(self, plan: Any):
        scheme = plan.scheme
        self.z = plan.engine.z[0].copy()
        constants, columns = flat_constants(scheme, 1)
        stages, of_stages = flat_stages(scheme, 1)
        record = Recording(scheme, np.full_like(constants, np.nan), columns, of_stages)
        if not record.straight:
            raise ValueError(f"{scheme.name}, n = {scheme.n}: expected straight-line code, got loops or arrays")
        self.constants, self.stages = constants[0], stages[0]
        step, *close = (_statements(piece) for piece in record.pieces)
        self.text = SOURCE.format(
            size=len(self.z),
            constants=constants.shape[1],
            stages=scheme.stage_count,
            of_stage=stages.shape[2],
            step=step,
            close="\n".join(close),
        )

    def states(self, counts: list[int], folder: Path) -> np.ndarray:
        """The states (rows, d, 2) after n steps, as sums of two doubles; compiled once in a folder."""
        program = folder / hashlib.sha256(self.text.encode()).hexdigest()[:16]
        if not program.exists():
            source = program.with_suffix(".cpp")
            source.write_text(self.text)
            subprocess.run(["g++", *FLAGS, f"-I{HERE}", str(source), "-o", str(program)], check=True)
        given, found = program.with_suffix(".in"), program.with_suffix(".out")
        numbers = [[float(len(counts))], np.array(counts, float), self.z, self.constants, self.stages.ravel()]
        given.write_bytes(np.concatenate(numbers).tobytes())
        subprocess.run([program, given, found], check=True)
        return np.fromfile(found).reshape(len(counts), -1, 2)


def _statements(piece: Piece) -> str:
    """A recorded function as a block of C++, on the arrays x, c and s."""
    writer = Writer(NUMBERS, lambda letter, i: PLACES[letter].format(i))
    for i, value in enumerate(writer.values(piece.graph, piece.outputs)):
        writer.assign(f"x[{i}]", value)
    return "\n".join(["{", *writer.lines, "}"])
