"""The table of docs/outside.md: its tests exist, and every quantity of the bodies in SI units is on it."""

from __future__ import annotations

import ast
import dataclasses
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from kreisel import physical
from kreisel.bodies import BODIES
from support import DOCS, ROOT

PAGE = DOCS / "outside.md"
TEXT = PAGE.read_text(encoding="utf-8")
CONVERSIONS = {"si_number": 1, "si_numbers": 1, "three": 1}  # the place of the unit among the arguments


def rows(text: str) -> list[str]:
    return [line for line in text.splitlines() if line.startswith("| ") and "outside source" not in line]


def missing_tests(row: str) -> list[str]:
    """Tests that a row names and that are not there; the row itself if it names none."""
    named = re.findall(r"\[`(\w+)`\]\((\.\./tests/\w+/\w+\.py)\)", row)
    found = []
    for name, path in named:
        tree = ast.parse((DOCS / path).read_text(encoding="utf-8"))
        if name not in {node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)}:
            found.append(f"{path}::{name}")
    return found if named and row.count("](") == len(named) else [row]


def quantities() -> Iterator[str]:
    """Constants of `kr.physical`, fields of its records, parameters of the bodies by name."""
    for name in physical.__all__:
        record = getattr(physical, name)
        if isinstance(record, physical.Primary | float):
            yield name
        elif isinstance(record, type) and record is not physical.Asteroid:  # a Satellite
            fields = dataclasses.fields(record) if dataclasses.is_dataclass(record) else ()
            letters = [f.name for f in fields if f.init] or getattr(record, "_fields", ())
            yield from (f"{name}.{letter}" for letter in letters)
    for name, body in BODIES.items():
        yield from (f"{name.partition('-with-')[0]}.{p.letter}" for p in body.parameters)


def units(path: Path) -> Iterator[str]:
    """Units that a file of `kr.physical` converts to, where they are literals."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
            place = CONVERSIONS.get(node.func.id)
            given = node.args[place : place + 1] if place is not None else []
            given += [k.value for k in node.keywords if node.func.id == "convert_fields" and k.arg != "positive"]
            yield from (v.value for v in given if isinstance(v, ast.Constant) and isinstance(v.value, str))


def test_every_row_names_tests_that_exist() -> None:
    assert len(rows(TEXT)) > 30
    assert [fault for row in rows(TEXT) for fault in missing_tests(row)] == []


def test_every_quantity_is_on_the_page() -> None:
    there = set(re.findall(r"`([\w.-]+)`", TEXT))
    assert {name for name in quantities() if name not in there} == set()
    known = {*quantities(), "kr.physical"}
    assert {name for name in there if re.fullmatch(r"(?!test)[\w-]+\.\w+", name)} - known == set()


def test_every_unit_is_judged() -> None:
    source = (ROOT / "tests" / "outside" / "test_constants.py").read_text(encoding="utf-8")
    used = {unit for path in Path(physical.__file__).parent.glob("*.py") for unit in units(path)} - {"1"}
    assert len(used) > 8
    assert {unit for unit in used if f'("{unit}",' not in source} == set()


@pytest.mark.parametrize(
    "row", ["| mass | a scale |  |", "| mass | a scale | [`test_no`](../tests/outside/test_table.py) |"]
)
def test_a_row_without_a_test_is_seen(row: str) -> None:
    assert missing_tests(row)
