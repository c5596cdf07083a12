"""Gradients by a reverse sweep: exact over Q, right in doubles and in batches, recordable; an `if` is refused."""

from __future__ import annotations

import math
from collections.abc import Callable
from fractions import Fraction
from typing import Any

import numpy as np
import pytest

import kreisel as kr
from kreisel.algebra.gradient import TracedNumber, value_and_gradient
from kreisel.graph.graph import Graph, evaluated


def everything(a: Any, g: Any, t: Any) -> Any:
    up = np.array([0.0, 0.0, 1.0])
    x = np.sin(t) * (a @ up) ** 2 + np.linalg.norm(a) * np.cos(g[0, 1]) + 1 / np.sqrt(1 + a @ a)
    return x + np.cross(a, g[2]) @ a[::-1] + np.exp(-t) * np.log(2 + a[0] ** 2) + np.tanh(a[1]) * np.tan(t) + 2**t


@pytest.mark.parametrize("batch", [(), (4,), (2, 3)])
def test_differences_say_the_same(batch: tuple[int, ...]) -> None:
    rng = np.random.default_rng(1)
    a, g, t = rng.random((*batch, 3)), rng.random((*batch, 3, 3)), rng.random(batch)
    da, dg, dt = rng.normal(size=a.shape), rng.normal(size=g.shape), rng.normal(size=t.shape)
    value, (A, G, T) = value_and_gradient(everything, [(a, 1), (g, 2), (t, 0)])
    assert np.shape(value) == batch and A.shape == a.shape and G.shape == g.shape
    h = 1e-6
    up, down = (value_and_gradient(everything, [(a + s * da, 1), (g + s * dg, 2), (t + s * dt, 0)])[0] for s in (h, -h))
    along = (A * da).sum(-1) + (G * dg).sum((-1, -2)) + T * dt
    assert abs((up - down) / (2 * h) - along).max() < 1e-7  # 2e-9


def test_rational_functions_are_exact() -> None:
    x = np.array([Fraction(1, 2), Fraction(2, 3), Fraction(3)], dtype=object)
    value, (slope,) = value_and_gradient(lambda a: (a @ a) ** 2 / a[0] - 3 * a[1] ** -2, [(x, 1)])
    a, b, c = x
    S = a * a + b * b + c * c
    assert value == S**2 / a - 3 / b**2
    assert slope.tolist() == [4 * S - S**2 / a**2, 4 * S * b / a + 6 / b**3, 4 * S * c / a]


def test_half_powers_have_their_derivative_at_zero() -> None:
    x = np.array([0.0, 4.0])
    value, (slope,) = value_and_gradient(
        lambda a: a[0] ** 1.5 + (a[1] ** 2) ** 1.5 + a[1] ** -0.5 + a[1] ** 0.5, [(x, 1)]
    )
    assert value == 64 + 0.5 + 2 and slope.tolist() == pytest.approx([0, 48 - 1 / 16 + 1 / 4])


def test_recorded_numbers_are_recorded() -> None:
    graph = Graph()
    x = graph.inputs("z", 2)
    _, (slope,) = value_and_gradient(lambda a: np.sin(a[0]) * a[1], [(x, 1)])
    values = evaluated(graph, list(slope), lambda _, i: (0.3, 0.7)[i])
    assert values == pytest.approx([math.cos(0.3) * 0.7, math.sin(0.3)], rel=1e-15)


def test_a_wrong_derivative_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    right = TracedNumber.__truediv__

    def wrong(self: TracedNumber, other: Any) -> Any:
        out = right(self, other)
        return TracedNumber(out.tape, out.value, tuple((x, abs(slope)) for x, slope in out.parents))

    monkeypatch.setattr(TracedNumber, "__truediv__", wrong)
    x = np.array([Fraction(1, 2), Fraction(2, 3)], dtype=object)
    _, (slope,) = value_and_gradient(lambda a: a[0] / a[1], [(x, 1)])
    assert slope.tolist() != [Fraction(3, 2), Fraction(-9, 8)]


@pytest.mark.parametrize("place", [1, (..., 1)])
def test_an_entry_without_axes_is_a_number(place: Any) -> None:
    """x[..., 1] of an array of objects is an array without axes: its derivative counts too."""
    x = np.array([0.5, 0.25, 2.0])
    for function, expected in (
        (lambda a: 3 * a[0] + a[place], (3, 1)),
        (lambda a: a[0] - a[place], (1, -1)),
        (lambda a: a[0] * a[place], (0.25, 0.5)),
        (lambda a: a[0] / a[place], (4, -8)),
    ):
        assert value_and_gradient(function, [(x, 1)])[1][0].tolist() == [*expected, 0]


@pytest.mark.parametrize(
    "branch",
    [lambda a: max(a), lambda a: math.sin(a[0]), lambda a: a[0] if a[0] > 0 else 0, lambda a: a],
)
def test_what_cannot_be_recorded_is_refused(branch: Callable[..., Any]) -> None:
    with pytest.raises(kr.InputError, match="expected"):
        value_and_gradient(branch, [(np.array([0.1, 0.2, 0.3]), 1)])
