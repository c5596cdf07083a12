"""Recording: run a definition once on recording scalars or arrays, print straight-line Python.

A `Tape` holds each value once.  `Scalar` is a recorded number, for small n; `RecordedMatrix`, of
`kreisel.kernels.recorded_array`, is a recorded array, for n beyond straight-line code.  Foldings are exact in floating
point (0, 1, signs, x - x), so a record with numbers put in for some parameters (`kreisel.kernels.folding`) computes the
same as one without.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from fractions import Fraction
from typing import Any, ClassVar

import numpy as np

from kreisel.kernels.fusing import fused
from kreisel.kernels.printing import Line, arranged, needed

TRANSCENDENTAL = ("sin", "cos", "exp", "log")  # functions of one number, beside sqrt


class TooLong(Exception):
    """More lines than a tape may have."""


class Tape:
    """Operations in order, each with a key; the same key is recorded once.  `mark` keeps two tapes' names apart.

    Raises `TooLong` beyond `most` lines.
    """

    def __init__(self, mark: str = "", most: float = math.inf) -> None:
        self.mark, self._most = mark, most
        self.lines: list[Line] = []
        self._names: dict[str, str] = {}
        self._count = 0
        self._loop: tuple[list[Line], set[str]] | None = None  # the lines of an open loop, and what they compute
        self.complex_names: set[str] = set()  # of recorded arrays
        self.shapes: dict[str, tuple[int, ...]] | None = None  # of those, where all are real vectors

    def record(self, expression: str, needs: tuple[str, ...]) -> str:
        if expression not in self._names:
            name = self._names[expression] = self._fresh("t")
            lines = self.lines
            if self._loop is not None and not self._loop[1].isdisjoint(needs):  # what does not vary goes before
                lines = self._loop[0]
                self._loop[1].add(name)
            lines.append(Line((name,), f"{name} = {expression}", needs))
            if len(lines) > self._most:
                raise TooLong
        return self._names[expression]

    def _fresh(self, letter: str) -> str:
        self._count += 1
        return f"{letter}{self.mark}{self._count - 1}"

    def knows(self, expression: str) -> str | None:
        return self._names.get(expression)

    def loop(
        self, body: Callable[[list[str]], tuple[list[Any], Any]], start: list[Any], small: float, most: int
    ) -> tuple[list[str], str]:
        """Record `x, defect = body(x)` from `start` until defect <= small, at most `most` times; the names of both.

        The numbers of `start` and of `body` are recorded or plain; the body is recorded once.
        """
        if self._loop is not None:
            raise TypeError("a loop within a loop cannot be recorded")
        names = [self._fresh("v") for _ in start]
        inner: list[Line] = []
        self._loop = (inner, {*names})
        new, defect = body(names)
        local, self._loop = self._loop[1], None
        for expression in [e for e, name in self._names.items() if name in local]:
            del self._names[expression]
        last = self._fresh("d")
        wanted = [v.name for v in (*new, defect) if not _is_plain(v)]
        block = [part for line in self._finished(inner, wanted) for part in line.text.splitlines()]
        block += [f"{', '.join(names)}, = {', '.join(map(source_of, new))},", f"{last} = {source_of(defect)}"]
        lines = [f"{', '.join(names)}, = {', '.join(map(source_of, start))},", f"for _ in range({most}):"]
        lines += [f"    {line}" for line in (*block, f"if {last} <= {small!r}:", "    break")]
        needs = [v.name for v in start if not _is_plain(v)] + wanted + [n for line in inner for n in line.needs]
        outer = tuple(dict.fromkeys(n for n in needs if n not in local))
        self.lines.append(Line((*names, last), "\n".join(lines), outer))
        return names, last

    def needed(self, outputs: list[str]) -> list[Line]:
        """The lines that the outputs depend on, in order."""
        return needed(self.lines, outputs)

    def finished(self, outputs: list[str]) -> list[Line]:
        """The same, as they are to be printed."""
        return self._finished(self.lines, outputs)

    def _finished(self, lines: list[Line], outputs: list[str]) -> list[Line]:
        chosen = needed(lines, outputs)
        return arranged(chosen, outputs) if self.shapes is None else fused(chosen, outputs, self.shapes)


def _is_plain(x: Any) -> bool:
    return not hasattr(x, "tape")


def _plain_value(x: Any) -> float | None:
    """The value of a plain number, or None for a recorded one."""
    return None if isinstance(x, Scalar) else float(x)


class Scalar:
    """A recorded real number: `name` on the tape, with a sign kept apart so that -x costs nothing."""

    __slots__ = ("name", "negative", "tape")
    inexact: ClassVar[bool] = True

    def __init__(self, tape: Tape, name: str, negative: bool = False):
        self.tape, self.name, self.negative = tape, name, negative

    def _new(self, expression: str, *needs: str, negative: bool = False) -> Scalar:
        return Scalar(self.tape, self.tape.record(expression, needs), negative)

    def __neg__(self) -> Scalar:
        return Scalar(self.tape, self.name, not self.negative)

    def __add__(self, other: Any) -> Any:
        if not _is_number(other):
            return NotImplemented
        value = _plain_value(other)
        if value == 0:
            return self
        if value is None and other.name == self.name and other.negative != self.negative:
            return 0.0
        b, b_negative = (other.name, other.negative) if value is None else (literal(abs(value)), value < 0)
        a, needs = self.name, (self.name,) + ((b,) if value is None else ())
        if self.negative == b_negative:
            first, second = sorted((a, b))
            return self._new(f"{first} + {second}", *needs, negative=self.negative)
        plus, minus = (b, a) if self.negative else (a, b)
        known = self.tape.knows(f"{minus} - {plus}")
        if known is not None:
            return Scalar(self.tape, known, True)
        return self._new(f"{plus} - {minus}", *needs)

    __radd__ = __add__

    def __sub__(self, other: Any) -> Any:
        return self + (-other) if _is_number(other) else NotImplemented

    def __rsub__(self, other: Any) -> Any:
        return (-self) + other if _is_number(other) else NotImplemented

    def __mul__(self, other: Any) -> Any:
        if not _is_number(other):
            return NotImplemented
        value = _plain_value(other)
        if value is not None:
            if value in (0, 1, -1):
                return 0.0 if value == 0 else (self if value == 1 else -self)
            return self._new(f"{self.name} * {literal(abs(value))}", self.name, negative=self.negative != (value < 0))
        first, second = sorted((self.name, other.name))
        return self._new(f"{first} * {second}", first, second, negative=self.negative != other.negative)

    __rmul__ = __mul__

    def __truediv__(self, other: Any) -> Any:
        if not _is_number(other):
            return NotImplemented
        value = _plain_value(other)
        if value is not None:
            if value in (1, -1):
                return self if value == 1 else -self
            return self._new(f"{self.name} / {literal(abs(value))}", self.name, negative=self.negative != (value < 0))
        return self._new(f"{self.name} / {other.name}", self.name, other.name, negative=self.negative != other.negative)

    def __rtruediv__(self, other: Any) -> Any:
        if not _is_number(other):
            return NotImplemented
        value = float(other)
        if value == 0:
            return 0.0
        return self._new(f"{literal(abs(value))} / {self.name}", self.name, negative=self.negative != (value < 0))

    def __pow__(self, exponent: int) -> Any:
        return whole_power(self, exponent)

    def sqrt(self) -> Scalar:
        return self._new(f"sqrt({self.signed})", self.name)

    def sin(self) -> Scalar:
        return self._new(f"sin({self.name})", self.name, negative=self.negative)

    def cos(self) -> Scalar:
        return self._new(f"cos({self.name})", self.name)

    def exp(self) -> Scalar:
        return self._new(f"exp({self.signed})", self.name)

    def log(self) -> Scalar:
        return self._new(f"log({self.signed})", self.name)

    def sign(self) -> Scalar:
        return self._new(f"sign({self.signed})", self.name)

    def maximum(self, other: Any) -> Scalar:
        needs = (self.name,) if _is_plain(other) else (self.name, other.name)
        return self._new(f"max({self.signed}, {source_of(other)})", *needs)

    def record_loop(
        self, body: Callable[..., tuple[Any, Any]], start: Any, small: float, most: int
    ) -> tuple[Any, Scalar]:
        """`x, defect = body(x)`, repeated, for an array x (d,) of recorded numbers."""

        def on_names(names: list[str]) -> tuple[list[Any], Any]:
            new, defect = body(self._array(names))
            return list(new), defect

        names, defect = self.tape.loop(on_names, list(start), small, most)
        return self._array(names), Scalar(self.tape, defect)

    def _array(self, names: list[str]) -> Any:
        return np.array([Scalar(self.tape, name) for name in names], dtype=object)

    def record_fma(self, other: Any, addend: Any) -> Any:
        """self * other + addend, rounded once."""
        if not isinstance(other, Scalar) and other in (0, 1, -1):
            return self * other + addend
        if not isinstance(addend, Scalar) and addend == 0:
            return self * other
        needs = (x.name for x in (self, other, addend) if isinstance(x, Scalar))
        return self._new(f"fma({self.signed}, {source_of(other)}, {source_of(addend)})", *needs)

    def record_sum_with(self, x: float, y: float) -> Any:
        """x * y + self for plain x, y, rounded once."""
        return self._new(f"fma({literal(x)}, {literal(y)}, {self.signed})", self.name)

    @property
    def signed(self) -> str:
        return f"(-{self.name})" if self.negative else self.name

    def __repr__(self) -> str:
        return self.signed


def whole_power(x: Any, exponent: Any) -> Any:
    """x^k by products, for a whole number k."""
    if not isinstance(exponent, int | float | np.integer | np.floating) or exponent != int(exponent):
        raise TypeError(f"recorded numbers know whole powers, not {exponent!r}")
    k = int(exponent)
    if k < 2:
        return 1 / whole_power(x, -k) if k < 0 else x if k else 1.0
    if k % 2:
        return whole_power(x, k - 1) * x
    half = whole_power(x, k // 2)
    return half * half


def _is_number(x: Any) -> bool:
    return isinstance(x, Scalar | int | float | Fraction | np.integer | np.floating)


def literal(x: float) -> str:
    """A number as source: infinity has no name there, and a step of 1e300 makes it."""
    if math.isfinite(x):
        return repr(x)
    return "(1e999 - 1e999)" if math.isnan(x) else f"{'-' * (x < 0)}1e999"


def source_of(x: Any) -> str:
    """A recorded or plain number, or a recorded array, as source."""
    return literal(float(x)) if _is_plain(x) else x.signed
