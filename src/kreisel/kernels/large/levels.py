"""The lines of a step of large n by level: a sum over the entries or a product with a matrix ends one."""

from __future__ import annotations

import ast
from collections.abc import Collection, Iterable, Mapping

from kreisel.kernels.large import products
from kreisel.kernels.printing import Line


class Levels:
    """The lines of a function by level.

    entries  the names of lines that are known entry by entry
    late     what is needed in full at the last level
    ends     the new state, which is stored there: name -> value
    entry    all names that are known entry by entry
    used     the last level at which an entry is needed, less 1/2 where that is before the loop of the level
    made     the entries that loops make
    """

    def __init__(self, lines: list[Line], entries: Iterable[str], late: Iterable[str], ends: Mapping[str, str]):
        self.lines, self.entry = lines, set(entries)
        for line in lines:
            if not is_total(line) and not self.entry.isdisjoint(line.needs):
                self.entry.add(line.names[0])
        late = {n for n in late if n in self.entry}
        self.level, self.last = _levels(lines, late)
        self.used: dict[str, float] = dict.fromkeys(late, self.last - 0.5)
        for line in lines:
            at = self.level[line.names[0]] - (0.5 if _ends_level(line) else 0)
            for n in line.needs:
                self.used[n] = max(self.used.get(n, 0), at)
        for value in ends.values():
            self.used[value.strip("(-)")] = self.last
        self.made = {name for line in lines for name in line.names if name in self.entry and not _ends_level(line)}

    def at(self, level: int) -> list[Line]:
        """The lines of a level."""
        return [line for line in self.lines if self.level[line.names[0]] == level]

    def outlives(self, name: str) -> bool:
        """Whether an entry is needed at a later level."""
        return self.used.get(name, 0) > self.level[name]


def is_total(line: Line) -> bool:
    """Whether it is a sum over the entries."""
    return " = total(" in line.text


def _ends_level(line: Line) -> bool:
    """A sum or a product, which needs all entries of what it takes."""
    return is_total(line) or products.matrix_of(line) != ""


def _levels(lines: list[Line], late: Collection[str]) -> tuple[dict[str, int], int]:
    """The level of each line and the last one; `late` is needed in full at the last.

    Products with one matrix share a level where they can: one that may wait does, for one that may not.
    """
    free_to: dict[str, int] = {}  # no earlier than
    for again in (True, False):
        level: dict[str, int] = {}
        for line in lines:
            deep = max((level.get(n, 0) for n in line.needs), default=0)
            level[line.names[0]] = max(deep + _ends_level(line), free_to.get(line.names[0], 0))
        last = max([*level.values(), *(level.get(n, 0) + 1 for n in late)], default=0)
        if again:
            latest = dict.fromkeys(level, last) | dict.fromkeys(late, last - 1)
            for line in reversed(lines):
                for n in line.needs:
                    latest[n] = min(latest.get(n, last), latest[line.names[0]] - _ends_level(line))
            taken = [line for line in lines if products.matrix_of(line)]
            for line in taken:
                name, matrix = line.names[0], products.matrix_of(line)
                fixed = [other.names[0] for other in taken if products.matrix_of(other) == matrix]
                at = [level[n] for n in fixed if level[n] == latest[n] and level[name] <= level[n] <= latest[name]]
                free_to[name] = min(at, default=0)
    return level, last


def beyond(line: Line, known: Mapping[str, float | None]) -> float | None:
    """The value of an entry where others have the `known` values, None for one that may be any finite number.

    Raises `ValueError` where it may be no number.
    """
    tree = ast.parse(line.text.partition(" = ")[2], mode="eval").body

    def value(node: ast.expr) -> tuple[float | None, bool]:
        """And whether it is an entry."""
        match node:
            case ast.Constant(float(number) | int(number)):
                return float(number), False
            case ast.Name(name):
                return (known[name], True) if name in known else (None, False)
            case ast.UnaryOp(ast.USub(), x):
                v, entry = value(x)
                return None if v is None else -v, entry
            case ast.BinOp(x, ast.Mult(), y):
                return times(value(x), value(y))
            case ast.BinOp(x, ast.Add() | ast.Sub() as operator, y):
                return plus(value(x), value(y), 1 if isinstance(operator, ast.Add) else -1)
            case ast.BinOp(x, ast.Div(), y):
                (a, one), (b, other) = value(x), value(y)
                if b == 0 or (b is None and other):
                    raise ValueError
                return (0.0 if a == 0 else None if a is None or b is None else a / b), one or other
            case ast.Call(ast.Name("fma"), [x, y, z]):
                return plus(times(value(x), value(y)), value(z), 1)
        raise ValueError

    def times(x: tuple[float | None, bool], y: tuple[float | None, bool]) -> tuple[float | None, bool]:
        (a, one), (b, other) = x, y
        return (0.0 if 0 in (a, b) else None if a is None or b is None else a * b), one or other

    def plus(x: tuple[float | None, bool], y: tuple[float | None, bool], sign: int) -> tuple[float | None, bool]:
        (a, one), (b, other) = x, y
        return (None if a is None or b is None else a + sign * b), one or other

    return value(tree)[0]
