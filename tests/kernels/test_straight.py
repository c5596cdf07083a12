"""Text that goes to LLVM as it is computes what Python computes from it."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from math import exp, sqrt
from typing import Any

import numpy as np
import pytest
from numba import njit
from numba.core.errors import TypingError

from kreisel.kernels._numba.double_double import pair, upper
from kreisel.kernels._numba.straight import straight
from kreisel.kernels._numba.vector_type import gather, numbers, put_numbers, scatter

PARTS = (0.25, -2.0)
X = np.array([[0.3, -0.7, 2.0, 5.0, -1.5], [1.1, 0.2, -0.4, 3.0, 0.9]])


def operations(x: Any, y: Any) -> Any:
    part = x * 3 - y / 2.0
    other, both = sqrt(part * part + 1), (x, (part, -y))
    return both[1][0] + PARTS[0] * other, max(x, y) - both[1][1], exp(-other), 1.5


def root(x: Any) -> Any:
    y, steps = x, 0.0
    for _ in range(30):
        new = 0.5 * (y + x / y)
        change, y, steps = (new - y) * (new - y), new, steps + 1.0
        if change <= 1e-20:
            break
    return y, steps, change


def most(x: Any) -> Any:
    total = 0.0 * x
    for k in range(7):  # noqa: B007
        total = total + x
    return total, x


def beyond(x: Any) -> Any:
    y, z = x, 2.0 * x
    if x > 1.0:
        y = z * z
        z = y + 1.0
    return y, z


def exactly(x: Any, y: Any) -> Any:
    x, y = pair(x, 0.0), pair(y, 0.0)
    value = (x + y) * (x - y) / (3 * y)
    return upper(value), upper(value - upper(value)), upper(-sqrt(x * x))


def of_rows(function: Callable[..., Any], count: int) -> Callable[[np.ndarray], np.ndarray]:
    """`function` of the numbers of a row, compiled."""
    made = straight(function)

    @njit
    def call(x: Any, out: Any) -> None:
        put_numbers(out, (), made(*numbers(x, (), count, ())), ())

    def run(x: np.ndarray) -> np.ndarray:
        out = np.empty(len(function(*x)))
        call(np.ascontiguousarray(x), out)
        return out

    return run


@pytest.mark.parametrize(("function", "count"), [(operations, 2), (root, 1), (most, 1), (beyond, 1)])
def test_numbers_are_those_of_python(function: Callable[..., Any], count: int) -> None:
    compiled = of_rows(function, count)
    for column in np.abs(X[:count]).T if function is root else X[:count].T:
        assert np.allclose(compiled(column), function(*column.tolist()), rtol=1e-15, atol=0)


def test_a_place_of_a_vector_has_the_bits_of_a_number() -> None:
    made, alone = straight(operations), of_rows(operations, 2)

    @njit
    def call(x: Any, out: Any) -> None:
        for lane in range(0, len(x), 4):
            scatter(out, (), lane, len(x), made(*gather(x, 2, lane, len(x), 4)))

    out = np.empty((5, 4))
    call(np.ascontiguousarray(X.T), out)
    assert np.array_equal(out, [alone(row) for row in X.T])


def test_double_doubles_have_31_digits() -> None:
    made = straight(exactly)

    @njit
    def call(x: Any, out: Any) -> None:
        put_numbers(out, (), made(x[0], x[1]), ())

    for x, y in X.T:
        out, (a, b) = np.empty(3), (Fraction(x), Fraction(y))
        call(np.array([x, y]), out)
        value = (a + b) * (a - b) / (3 * b)
        assert abs(Fraction(out[0]) + Fraction(out[1]) - value) < abs(value) * Fraction(1, 10**29)
        assert abs(Fraction(out[0]) - value) > 0 and out[2] == -abs(x)


def a_list(x: Any) -> Any:
    return [x]


def added(x: Any) -> Any:
    x += 1.0
    return x


def a_power(x: Any) -> Any:
    return x**2


def otherwise(x: Any) -> Any:
    y = x
    if x > 0.0:
        y = 2.0 * x
    else:
        y = 3.0 * x
    return y


def within(x: Any) -> Any:
    y = x
    for _ in range(3):
        if x > 0.0:
            y = 2.0 * y
        y = y + 1.0
    return y


def at_the_end(x: Any) -> Any:
    y = x
    for _ in range(3):
        y = y + 1.0
        if x > 0.0:
            y = 2.0 * y
    return y


def counted(x: Any) -> Any:
    y = x
    for k in range(3):
        y = y + k
    return y


def unknown(x: Any) -> Any:
    return abs(x)


@pytest.mark.parametrize("function", [a_list, added, a_power, otherwise, within, at_the_end, counted, unknown])
def test_what_is_no_such_text_is_refused(function: Callable[..., Any]) -> None:
    made = straight(function)

    @njit
    def call(x: Any) -> Any:
        return made(x)

    with pytest.raises((TypingError, TypeError), match="straight` knows"):
        call(1.0)
