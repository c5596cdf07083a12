"""No piece of the source stands twice, whatever its names and constants are."""

from __future__ import annotations

import ast
from collections import defaultdict
from collections.abc import Iterator, Mapping
from functools import cache
from typing import Any

from support import ROOT

LONGEST = 4  # statements in a row that are compared
LEAST_LINES, LEAST_NODES = 3, 30  # of such a piece; fewer are idioms, as an early return is
MOST = 120  # lines that stand somewhere else too, of about 68,000
FREE = ("ctx", "type_comment")


@cache
def shape(node: Any) -> tuple[int, int]:
    """A hash of a tree without its names and constants, and the count of its statements and expressions."""
    counted = isinstance(node, ast.stmt | ast.expr)
    if not isinstance(node, ast.AST):
        return hash(type(node).__name__), 0
    parts, size = list[Any]([type(node).__name__]), int(counted)
    for name, value in ast.iter_fields(node):
        if name not in FREE:
            below = [shape(x) for x in value] if isinstance(value, list) else [shape(value)]
            parts.append(tuple(part for part, _ in below))
            size += sum(count for _, count in below)
    return hash(tuple(parts)), size


def blocks(tree: ast.AST) -> Iterator[list[ast.stmt]]:
    """The statements of each block, without docstrings, imports and declarations."""
    for node in ast.walk(tree):
        for name in ("body", "orelse", "finalbody"):
            block = getattr(node, name, None)
            if isinstance(block, list):
                yield [
                    x for x in block if not isinstance(x, ast.Import | ast.ImportFrom | ast.AnnAssign) and not plain(x)
                ]


def plain(statement: ast.stmt) -> bool:
    return isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant)


def repeated(sources: Mapping[str, str]) -> set[tuple[str, int]]:
    """Lines of pieces whose shape stands before them, in this file or another."""
    places = defaultdict[Any, list[tuple[str, range]]](list)
    for file, source in sources.items():
        for block in blocks(ast.parse(source)):
            shapes, sizes = zip(*map(shape, block), strict=True) if block else ((), ())
            for length in range(1, LONGEST + 1):
                for i in range(len(block) - length + 1):
                    piece = slice(i, i + length)
                    lines = range(block[i].lineno, (block[piece][-1].end_lineno or 0) + 1)
                    if len(lines) >= LEAST_LINES and sum(sizes[piece]) >= LEAST_NODES:
                        places[shapes[piece]].append((file, lines))
    return {(file, line) for found in places.values() for file, lines in found[1:] for line in lines}


def package() -> dict[str, str]:
    return {str(path): path.read_text(encoding="utf-8") for path in sorted((ROOT / "src").rglob("*.py"))}


def test_no_piece_stands_twice() -> None:
    lines = repeated(package())
    assert len(lines) <= MOST, sorted(lines)


def test_a_copy_with_other_names_is_seen() -> None:
    sources = package()
    file = next(name for name in sources if name.endswith("double.py") and "graph" in name)
    copy = sources[file].replace("upper", "first").replace("lower", "second").replace("1", "2")
    more = repeated({file: sources[file], "copy.py": copy})
    assert len({line for name, line in more if name == "copy.py"}) > 30
