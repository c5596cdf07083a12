"""Text that goes to LLVM as it is computes what Python computes from it."""

from __future__ import annotations

import itertools
import linecache
from collections.abc import Callable
from fractions import Fraction
from math import exp, sqrt
from typing import Any

import numpy as np
import pytest

from kreisel.kernels._llvm import machine
from kreisel.kernels._llvm.functions import straight
from kreisel.kernels._llvm.machine import Code, compiled, loaded, object_code
from kreisel.kernels._llvm.operations import (
    call_at_address,
    carry,
    gather,
    numbers,
    pair,
    put_numbers,
    scatter,
    shifted_left,
    shifted_right,
    upper,
)

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


def counted(x: Any) -> Any:
    total, most = 0.0 * x, 0
    for k in range(7):
        total = total + x * k
        for _ in range(k, 1, -2):
            most += k
    return total, float(most), x


def blocks(x: Any) -> Any:
    y, z, w = x, 2.0 * x, (0.0, x)
    for k in range(4):
        if x > 1.0:
            y = z * z
            z = y + 1.0
        elif not x > 0.0:
            y, w = -y, (w[1], y)
        else:
            w = (w[0] + 1.0, float(k))
        if k == 2:
            y = y - 1.0
    return y, z, w[0] if x < 3.0 else w[1], w[1]


def both(x: Any) -> Any:
    known, y = 1, 0.0
    if x > 0.5 and known:
        y = y + 1.0
    if x > 0.5 and not known:
        y = y + 2.0
    if x < 0.0 or x > 4.0:
        y = y + 4.0
    if known or x < 1.0:
        y = y + 8.0
    return (y, 1.0 if x > 0.0 and x < 1.0 else 2.0)


def wholes(x: Any) -> Any:
    i = int(x * 10.0)
    j = i % 7 - 4
    return float(i // 7), float(i % 7), float(j // 2), float(j % 3), float(min(i, -j)), i / 2.0


def words(x: Any) -> Any:
    i = int(x * 10.0)
    j = shifted_right(-i, 60)
    return float(shifted_left(i, 3)), float(j), float(carry(i, -1)), float(carry(-1, i) + carry(i, i))


def exactly(x: Any, y: Any) -> Any:
    x, y = pair(x, 0.0), pair(y, 0.0)
    value = (x + y) * (x - y) / (3 * y)
    return upper(value), upper(value - upper(value)), upper(-sqrt(x * x))


def code_of(function: Any, form: str) -> Code:
    """A function that is called from outside."""
    entry = compiled(form)(function)
    return loaded(object_code({function.__name__: entry}), {function.__name__: form})[function.__name__]


def of_rows(function: Any, count: int) -> Callable[[np.ndarray], np.ndarray]:
    """`function` of the numbers of a row, compiled; what it gives, as a row."""
    name = next(f"made{k}" for k in itertools.count() if f"made{k}" not in globals())
    globals()[name] = straight(function)
    text = f"def call_{name}(x, out):\n    put_numbers(out, (), {name}(*numbers(x, (), {count}, ())), ())\n"
    linecache.cache[f"<{name}>"] = (len(text), None, text.splitlines(keepends=True), f"<{name}>")
    exec(compile(text, f"<{name}>", "exec"), globals())
    call = code_of(globals()[f"call_{name}"], "f8[::1], f8[::1]")

    def run(x: np.ndarray) -> np.ndarray:
        out = np.full(9, np.nan)
        call(np.ascontiguousarray(x), out)
        return out[~np.isnan(out)]

    return run


@pytest.mark.parametrize(
    ("function", "count"), [(operations, 2), (root, 1), (counted, 1), (blocks, 1), (both, 1), (wholes, 1)]
)
def test_numbers_are_those_of_python(function: Callable[..., Any], count: int) -> None:
    run = of_rows(function, count)
    for column in np.abs(X[:count]).T if function is root else X[:count].T:
        assert np.allclose(run(column), function(*column.tolist()), rtol=1e-15, atol=0)


def of_lanes(x: Any, out: Any) -> None:
    for lane in range(0, len(x), 4):
        scatter(out, (), lane, len(x), vectors(*gather(x, 2, lane, len(x), 4)), 4)


vectors = straight(operations)


def test_a_place_of_a_vector_has_the_bits_of_a_number() -> None:
    alone, out = of_rows(operations, 2), np.empty((5, 4))
    code_of(of_lanes, "f8[:,::1], f8[:,::1]")(np.ascontiguousarray(X.T), out)
    assert np.array_equal(out, [alone(row) for row in X.T])


def test_double_doubles_have_31_digits() -> None:
    run = of_rows(exactly, 2)
    for x, y in X.T:
        out, (a, b) = run(np.array([x, y])), (Fraction(x), Fraction(y))
        value = (a + b) * (a - b) / (3 * b)
        assert abs(Fraction(out[0]) + Fraction(out[1]) - value) < abs(value) * Fraction(1, 10**29)
        assert abs(Fraction(out[0]) - value) > 0 and out[2] == -abs(x)


def test_whole_numbers_without_a_sign() -> None:
    """Zeros come in from both sides, and -1 is the largest."""
    run = of_rows(words, 1)
    assert run(np.array([0.5])).tolist() == [40, 15, 1, 0]
    assert run(np.array([-0.5])).tolist() == [-40, 0, 1, 0]


def of_arrays(x: Any, places: Any, out: Any, count: int, unit: float) -> None:
    if count < 0:
        return
    row = 0
    while row < x.shape[0]:
        plane = x[row, :, 1]
        for k in range(len(plane)):
            out[row, places[k]] = out[row, places[k]] + plane[k] * unit
        row += 1
        if row == count:
            break
    put_numbers(out, (0,), (*numbers(x, (0,), 2, (0,)), unit), ())


def test_arrays_are_those_of_numpy() -> None:
    """Views, indices that are numbers of an array, loops that are left, and a return before the end."""
    x, places = np.arange(24.0).reshape(3, 4, 2), np.array([2, 0, 2, 1])
    code = code_of(of_arrays, "f8[:,:,::1], i8[::1], f8[:,::1], i8, f8")
    for count, expected in ((-1, np.zeros((3, 3))), (2, [[0, 2, 0.5], [5.5, 7.5, 4.5 + 6.5 + 0.0], [0, 0, 0]])):
        out = np.zeros((3, 3))
        code(x, places, out, count, 0.5)
        assert np.array_equal(out, expected)
    for wrong in (x.astype(np.float32), x.astype(">f8"), x[:, ::2], x[0], x.view(np.int64), x.tolist()):
        with pytest.raises(TypeError, match=r"expected (contiguous )?arrays and numbers f8\["):
            code(wrong, places, np.zeros((3, 3)), 1, 0.5)
    other = np.zeros((3, 3))
    code(x.view(np.memmap), places.astype(np.longlong), other, 2, 0.5)  # a subclass; the same numbers by another name
    assert np.array_equal(other, expected)


def from_behind(x: Any) -> None:
    x[0, 0] = x[-1, 0]


def of_a_part(x: Any) -> None:
    y = x[1:, 0]
    x[0, 0] = y[0]


def taken_apart(x: Any) -> None:
    a, b = x
    x[0, 0] = a[0] + b[0]


def guarded(x: Any) -> None:
    x[0, 0] = x[5, 0] if len(x) > 5 else 0.0


@pytest.mark.parametrize("function", [from_behind, of_a_part, taken_apart, guarded])
def test_what_would_read_beside_an_array_is_refused(function: Callable[..., Any]) -> None:
    with pytest.raises(TypeError, match="text` knows"):
        code_of(function, "f8[:,::1]")


def test_a_function_that_takes_names_of_another_is_refused() -> None:
    factor = 7.0

    def inner(x: Any) -> None:
        x[0] = factor

    with pytest.raises(TypeError, match="stands alone"):
        code_of(inner, "f8[::1]")


@pytest.mark.parametrize("numbers", [(1.0, 1), (1, None), (1,), (1, 2, 3)])
def test_numbers_that_are_none_are_refused(numbers: tuple[Any, ...]) -> None:
    code = code_of(by_address, "i8, i8")
    with pytest.raises(TypeError):
        code(*numbers)
    with pytest.raises(TypeError):
        code_of(of_first, "f8[::1], f8")(np.zeros(3), "1")


def of_first(x: Any, y: Any) -> None:
    x[0] = y


def test_an_array_that_is_not_aligned_is_refused() -> None:
    odd = np.zeros(33, dtype=np.uint8)[1:25].view(np.float64)
    code = code_of(of_first, "f8[::1], f8")
    if not odd.flags.aligned:
        with pytest.raises(TypeError, match="contiguous"):
            code(odd, 1.0)
    even = np.zeros(3)
    code(even, 1)
    assert even.tolist() == [1, 0, 0]


def by_address(address: int, x: int) -> None:
    call_at_address(address, (x, 3))


@pytest.mark.parametrize("what", ["DATA", "COUNT", "LENGTHS", "KIND", "FLAGS"])
def test_arrays_that_lie_otherwise_in_memory_are_no_arrays(what: str, monkeypatch: pytest.MonkeyPatch) -> None:
    machine._require_layout()
    monkeypatch.setattr(machine, what, machine.DATA + 3)  # strides
    with pytest.raises(ImportError, match="as NumPy's C interface says"):
        machine._require_layout()


def test_code_calls_other_code() -> None:
    import ctypes

    seen = []
    told = ctypes.CFUNCTYPE(None, ctypes.c_int64, ctypes.c_int64)(lambda *given: seen.append(given))
    code_of(by_address, "i8, i8")(ctypes.cast(told, ctypes.c_void_p).value, 2**40)
    assert seen == [(2**40, 3)]


def a_list(x: Any) -> Any:
    return ([x],)


def a_power(x: Any) -> Any:
    return (x**2,)


def of_each(x: Any) -> Any:
    y = x
    for part in (x, 2.0 * x):
        y = y + part
    return (y,)


def of_a_double(x: Any) -> Any:
    return (x // 2.0,)


def another_kind(x: Any) -> Any:
    y = 0
    for _ in range(3):
        y = y + x
    return (y,)


def early(x: Any) -> Any:
    if x > 0.0:
        return (x,)
    return (2.0 * x,)


def carried(x: Any) -> Any:
    for k in range(3):
        if k == 0:
            y = x
        y = y + 1.0
    return (y,)


def after_its_loop(x: Any) -> Any:
    k = 9
    for k in range(3):
        x = x + k
    return (x * k,)


def of_another_form(x: Any) -> Any:
    w = ((x, x), 1.0)
    if x > 0.0:
        w = (x, (x, 1.0))
    return (w[1],)


def by_zero(x: Any) -> Any:
    i = int(x)
    return (float(7 // i if i != 0 else 7),)


def a_stride(x: Any) -> Any:
    return (x, 2.0 * x, 3.0 * x)[::2]


def unknown(x: Any) -> Any:
    return (abs(x),)


@pytest.mark.parametrize(
    "function",
    [
        a_list,
        a_power,
        of_each,
        of_a_double,
        another_kind,
        early,
        carried,
        after_its_loop,
        of_another_form,
        by_zero,
        a_stride,
        unknown,
    ],
)
def test_what_is_no_such_text_is_refused(function: Callable[..., Any]) -> None:
    with pytest.raises(TypeError, match=r"text` knows|expected i64|y to be known|of one form"):
        of_rows(function, 1)
