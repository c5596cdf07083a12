"""Numbers put in for some names of a record, which is recorded once more and so gets shorter; the bits stay."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from fractions import Fraction
from functools import lru_cache
from typing import Any

from kreisel.kernels.printing import KEPT, Line, needed
from kreisel.kernels.tape import TRANSCENDENTAL, Scalar, Tape, source_of


def folded(lines: list[Line], new: list[str], values: Mapping[str, float], mark: str) -> tuple[list[Line], list[str]]:
    """The lines and the outputs `new` with numbers for some names: recorded once more, so folded, exactly."""
    found, outputs = _folded(tuple(lines), tuple(new), tuple(values.items()), mark)
    return list(found), list(outputs)


@lru_cache(KEPT)
def _folded(
    lines: tuple[Line, ...], new: tuple[str, ...], values: tuple[tuple[str, float], ...], mark: str
) -> tuple[tuple[Line, ...], tuple[str, ...]]:
    tape = Tape(mark)
    known: dict[str, Any] = {**FUNCTIONS, **dict(values)}
    try:
        for line in lines:
            for name in line.needs:
                known.setdefault(name, Scalar(tape, name))
            if "\n" in line.text:
                tape.lines += [_alias(name, known[name]) for name in line.needs if source_of(known[name]) != name]
                tape.lines.append(line)
                known |= {name: Scalar(tape, name) for name in line.names}
            else:
                exec(line.text, known)
        outputs = [source_of(_folded_value(output, known, tape)) for output in new]
    except ZeroDivisionError:  # 1/0 on a branch that is not taken, or a fault that the run will name
        return lines, new
    return tuple(needed(tape.lines, [output.strip("(-)") for output in outputs])), tuple(outputs)


def _folded_value(output: str, known: dict[str, Any], tape: Tape) -> Any:
    name = output.strip("(-)")
    if name.isidentifier():
        known.setdefault(name, Scalar(tape, name))
    return eval(output, known)


def _alias(name: str, value: Any) -> Line:
    return Line((name,), f"{name} = {source_of(value)}", (value.name,) if isinstance(value, Scalar) else ())


def _fma(x: Any, y: Any, z: Any) -> Any:
    if not isinstance(x, Scalar):
        x, y = y, x
    if isinstance(x, Scalar):
        return x.record_fma(y, z)
    if x in (0, 1, -1) or y in (0, 1, -1):
        return x * y + z
    if isinstance(z, Scalar):
        return z.record_sum_with(x, y)
    return float(Fraction(x) * Fraction(y) + Fraction(z))


def _either(method: str, plain: Callable[[float, float], Any]) -> Callable[[Any, Any], Any]:
    """A function of two recorded or plain numbers."""

    def function(x: Any, y: Any) -> Any:
        if isinstance(x, Scalar):
            return getattr(x, method)(y)
        return getattr(y, method)(x) if isinstance(y, Scalar) else plain(x, y)

    return function


def _of_one(name: str) -> Callable[[Any], Any]:
    """A function of a recorded or plain number."""
    return lambda x: getattr(x, name)() if isinstance(x, Scalar) else getattr(math, name)(x)


FUNCTIONS = {
    **{name: _of_one(name) for name in TRANSCENDENTAL},
    "fma": _fma,
    "sqrt": lambda x: x.sqrt() if isinstance(x, Scalar) else math.sqrt(x),
    "sign": lambda x: x.sign() if isinstance(x, Scalar) else (-1.0 if x < 0 else 1.0),
    "max": _either("maximum", max),
}
