"""Vectors of lanes: the bits of numbers, ragged ends, and what changed operations do to the cache of kernels."""

from __future__ import annotations

import math
import os
from pathlib import Path

import numpy as np
import pytest

from kreisel.bench import compiled, ensemble, short
from kreisel.kernels import cache, simd
from kreisel.kernels._llvm.machine import register_width
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


@pytest.fixture(scope="module")
def kernel() -> str:
    if register_width() == 2:
        pytest.skip("the loop is looked for in registers of AVX")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ensemble, "LANES", 64)
        (case,) = [case for case in short.cases(generic=True) if case.name == "clebsch"]
        return ensemble.source_of(case)


def tool(folder: Path, name: str, does: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """A program of that name before all others."""
    folder.mkdir(exist_ok=True)
    (folder / name).write_text(f"#!/bin/sh\n{does}\n")
    (folder / name).chmod(0o755)
    monkeypatch.setenv("PATH", f"{folder}{os.pathsep}{os.environ['PATH']}")


def test_the_bound_is_that_of_the_loop_over_steps(kernel: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An analyser that works is given the loop; the mutant counts a vector too many."""
    seen = tmp_path / "seen"
    tool(tmp_path / "bin", "llvm-mca", f"cat > {seen}; echo 'Block RThroughput: 96.0'", monkeypatch)
    bound = ensemble.bound(kernel)
    assert bound is not None
    assert bound["vectors"] == 4
    assert bound["instructions"] == len(seen.read_text().splitlines()) > 4 * 20
    lanes = int(kernel.partition("\nLANES = ")[2].split()[0])
    assert bound["cycles_a_lane_step"] == 96 / lanes
    monkeypatch.setattr(ensemble, "assembly_of", lambda source, of=ensemble.assembly_of: of(kernel))
    with pytest.raises(AssertionError, match="divisions in the loop"):
        ensemble.bound(kernel.replace(f"\nLANES = {lanes}", f"\nLANES = {3 * lanes // 2}"))


def test_the_bound_by_the_analyser_that_is_there(kernel: str) -> None:
    bound = ensemble.bound(kernel)
    if bound is None:
        pytest.skip("no llvm-mca that reads this assembly")
    assert bound["cycles_a_lane_step"] > 0.5 * bound["instructions"] / bound["vectors"] / 8 / 6


@pytest.mark.parametrize(
    "does",
    [
        "echo 'error: invalid operand' >&2; exit 1",
        "echo nothing of use",
        "echo 'Block RThroughput: 96.0'; exit 1",
        "echo 'Block RThroughput: nan'",
        r"printf '\377\376'",
    ],
)
def test_an_analyser_that_does_not_work_is_as_good_as_none(
    does: str, kernel: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tool(tmp_path / "bin", "llvm-mca", does, monkeypatch)
    assert ensemble.bound(kernel) is None


@pytest.mark.parametrize("does", ["exit 1", "exit 0", "no-such-program"])
def test_a_compiler_that_does_not_work_is_as_good_as_none(
    does: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tool(tmp_path / "bin", "g++", does, monkeypatch)
    assert compiled.compiler() is None
    with pytest.raises(FileNotFoundError, match="does not work"):
        compiled.build("single", tmp_path)
