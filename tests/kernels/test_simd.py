"""Vectors of lanes: the bits of numbers, ragged ends, and what changed operations do to the cache of kernels."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from kreisel.kernels import cache, simd
from kreisel.kernels.folding import folded
from kreisel.kernels.printing import Line, latest
from kreisel.kernels.tape import Scalar, Tape, source_of

SPECIAL = (0.0, -0.0, 1.0, -1.0, math.inf, -math.inf, math.nan, 5e-324, 1e308, 0.1, -3.7)
OPERATIONS = (
    *("x + y", "x - y", "x * y", "x / y", "(-x) * y", "x * 0.3", "0.3 - x", "1.0 / x", "sqrt(x)", "sqrt((-y))"),
    *("fma(x, y, 0.7)", "fma((-x), y, (-y))", "fma(0.1, x, y)"),
    *("max(x, y)", "max((-x), 0.1)", "sign(x)", "sign((-y))"),
)  # fmt: skip
BOTH = f"""
@straight
def operations(x, y):
    return ({", ".join(OPERATIONS)})


@compiled("f8[:,::1], f8[:,:,::1]")
def of_numbers(z, out):
    for i in range(len(z)):
        put_numbers(out, (1, i), operations(z[i, 0], z[i, 1]), ())


@compiled("f8[:,::1], f8[:,:,::1]")
def vectors(z, out):
    for first in range(0, len(z), 4):
        x, y = gather(z, 2, first, len(z), 4)
        scatter(out, (1,), first, len(z), operations(x, y), 4)


@compiled("f8[:,::1], f8[:,::1], f8[:,::1]")
def through_scratch(z, out, w):
    for first in range(0, len(z), 4):
        store(w, 1, gather(z, 2, first, len(z), 4), 4)
        scatter(out, (), first, len(z), load(w, 1, 2, 4), 4)
"""


def test_vectors_have_the_bits_of_numbers() -> None:
    module = cache.load_kernel(simd.HEAD.format(name="every operation") + BOTH)
    z = np.array([(x, y) for x in SPECIAL for y in SPECIAL] + [(0.25, 3.0)])
    assert len(z) % 4 == 2
    found = {name: np.full((3, len(z), len(OPERATIONS)), 7.0) for name in ("of_numbers", "vectors")}
    for name, out in found.items():
        getattr(module, name)(z, out)
        assert (out[::2] == 7).all()
    one, other = (out[1] for out in found.values())
    assert ((one == other) | (np.isnan(one) & np.isnan(other))).all()
    known = ~np.isnan(one)
    assert (np.signbit(one) == np.signbit(other))[known].all()
    assert (one[-1, :3] == (3.25, -2.75, 0.75)).all()
    back = np.empty_like(z)
    module.through_scratch(z, back, np.empty((3, 4)))
    assert np.array_equal(back, z, equal_nan=True)


def test_other_operations_make_other_kernels(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("KREISEL_CACHE", str(tmp_path))
    source = f'"""{tmp_path.name}"""\n'
    first = cache.load_kernel(source)
    monkeypatch.setattr(cache, "_operations", lambda: b"another fma")
    assert cache.load_kernel(source).__name__ != first.__name__
    assert len(list(tmp_path.glob("*/*.py"))) == 2


def test_the_latest_order_computes_the_same() -> None:
    tape = Tape()
    a, b = (Scalar(tape, name) for name in "ab")
    early = a * 3.0
    quotient = 1.0 / (a + b)
    for _ in range(20):
        quotient = quotient * b + a
    out = source_of(quotient * early + early)
    values: list[dict[str, float]] = []
    for lines in (tape.lines, latest(tape.lines)):
        values.append({"a": 0.3, "b": 0.7})
        for line in lines:
            exec(line.text, {}, values[-1])
    assert values[0] == values[1]
    names = [line.names[0] for line in latest(tape.lines)]
    assert sorted(names) == sorted(line.names[0] for line in tape.lines)
    assert tape.lines[0].names[0] == early.name
    assert names.index(early.name) > len(names) - 5  # not needed before the end
    assert names[-1] == out
    assert latest([]) == []


def test_a_sign_is_folded() -> None:
    lines = [Line(("t0",), "t0 = sign(a)", ("a",)), Line(("t1",), "t1 = t0 * b", ("t0", "b"))]
    for value, expected in ((-2.0, "(-b)"), (0.0, "b"), (3.0, "b")):
        assert folded(lines, ["t1"], {"a": value}, "f")[1] == [expected]
    kept, new = folded(lines, ["t1"], {"b": 1.0}, "f")
    assert [line.text.partition(" = ")[2] for line in kept] == ["sign(a)"]
    assert new == [kept[0].names[0]]
