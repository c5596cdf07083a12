"""Sums of two doubles have twice the digits, ordered and as pairs, of floats and of recorded numbers."""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable
from fractions import Fraction
from functools import partial
from typing import Any

import numpy as np
import pytest

from kreisel import algebra
from kreisel.algebra.backend import Complex
from kreisel.graph import double
from kreisel.graph.double import DoubleDouble, pair_difference, pair_product, pair_quotient, pair_root, pair_sum
from kreisel.graph.graph import Graph, evaluated

Two = tuple[Any, Any]
ORDERED: dict[str, Callable[[DoubleDouble, DoubleDouble], DoubleDouble]] = {
    "sum": lambda x, y: x + y,
    "difference": lambda x, y: x - y,
    "product": lambda x, y: x * y,
    "quotient": lambda x, y: x / y,
    "root": lambda x, y: x.sqrt(),
}
PAIRS: dict[str, Callable[[Two, Two], Two]] = {
    "sum": pair_sum,
    "difference": pair_difference,
    "product": pair_product,
    "quotient": lambda x, y: pair_quotient(x, y)[0],
    "root": lambda x, y: pair_root(x)[0],
}
EXACT: dict[str, Callable[[Fraction, Fraction], Fraction]] = {
    "sum": lambda x, y: x + y,
    "difference": lambda x, y: x - y,
    "product": lambda x, y: x * y,
    "quotient": lambda x, y: x / y,
    "root": lambda x, y: Fraction(math.isqrt(int(x * 4**150)), 2**150),
}


def ordered(operation: str, x: Two, y: Two) -> Two:
    value = ORDERED[operation](DoubleDouble(*x), DoubleDouble(*y))
    return value.upper, value.lower


def paired(operation: str, x: Two, y: Two) -> Two:
    return PAIRS[operation](x, y)


def error(kind: Callable[[str, Two, Two], Two], operation: str) -> float:
    """The largest error on recorded numbers, over result or operands; ordered floats have the same bits."""
    draw, graph = np.random.default_rng(2), Graph()
    u, v, a, b = graph.inputs("x", 4)
    recorded = list(kind(operation, (u, v), (a, b)))
    largest = 0.0
    for upper in draw.uniform(0.5, 2, (200, 2)).tolist():
        x, y = ((h, h * float(draw.uniform(-1, 1)) * 2.0**-54) for h in upper)
        numbers = [*x, *y]
        value = evaluated(graph, recorded, partial(entry, numbers))
        assert kind is paired or [*ordered(operation, x, y)] == value
        p, q, r = (Fraction(h) + Fraction(e) for h, e in (x, y, value))
        exact = EXACT[operation](p, q)
        largest = max(largest, float(abs(r - exact) / max(abs(exact), p, q)))
    return largest


def entry(numbers: list[float], letter: str, i: int) -> float:
    return numbers[i]


@pytest.mark.parametrize("operation", EXACT)
@pytest.mark.parametrize("kind", [ordered, paired])
def test_twice_the_digits(kind: Callable[[str, Two, Two], Two], operation: str) -> None:
    assert error(kind, operation) < 2.0**-102


def test_mutants(monkeypatch: pytest.MonkeyPatch) -> None:
    """A fused product that is rounded twice; a sum whose error is lost."""
    monkeypatch.setattr(double, "fma", lambda x, y, z: x * y + z)
    assert min(error(kind, operation) for kind in (ordered, paired) for operation in ("product", "root")) > 2.0**-60
    monkeypatch.undo()
    monkeypatch.setattr(double, "two_sum", lambda x, y: (x + y, 0.0))
    assert min(error(kind, "sum") for kind in (ordered, paired)) > 2.0**-60


@pytest.mark.parametrize("z", [3 + 4j, 3 - 4j, -3 + 4j, -3 - 4j, 4 + 0j, -4 + 0j])
def test_the_root_of_a_complex_number_is_to_the_right(z: complex) -> None:
    root = algebra.sqrt(Complex(DoubleDouble(z.real), DoubleDouble(z.imag)))
    assert complex(root.re.upper, root.im.upper) == cmath.sqrt(z)
    remainder = root * root - Complex(z.real, z.imag)
    assert max(abs(v.upper + v.lower) for v in (remainder.re, remainder.im)) < 1e-30
