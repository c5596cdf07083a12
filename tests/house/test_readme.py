"""The README's code runs, and its output is what it prints: same rows and values, changes at round-off."""

from __future__ import annotations

import contextlib
import importlib
import io
import re
from pathlib import Path

import pytest

from kreisel.system import NAMED
from support import ROOT

README = ROOT / "README.md"


def test_first_example(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = README.read_text(encoding="utf-8")
    blocks = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    (shown,) = re.findall(r"```text\n(.*?)```", text, re.DOTALL)
    monkeypatch.chdir(tmp_path)
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        exec("".join(blocks), {})
    rows, claimed = ([line.split() for line in words.strip().splitlines()] for words in (printed.getvalue(), shown))
    assert rows[0] == claimed[0]
    assert [(row[0], row[1]) for row in rows[1:]] == [(row[0], row[1]) for row in claimed[1:]]
    for table in (rows, claimed):
        assert all(float(row[-1]) < 200 for row in table[1:])
    assert (tmp_path / "first.png").stat().st_size > 10_000
    assert (tmp_path / "first.zarr").is_dir()


def test_the_gallery_has_as_many_pictures_as_the_readme_says() -> None:
    scripts = list((README.parent / "examples" / "gallery").glob("[!_]*.py"))
    assert f"builds {len(scripts)} pictures" in README.read_text(encoding="utf-8")


def test_every_system_stands_in_the_table() -> None:
    table = (ROOT / "docs" / "systems.md").read_text(encoding="utf-8")
    assert len(NAMED) > 20
    for name in NAMED:
        assert f"`{name}`" in table, name


def test_every_link_of_the_readme_leads_somewhere() -> None:
    links = re.findall(r"\]\(([^)#]+)(?:#[^)]*)?\)", README.read_text(encoding="utf-8"))
    assert len(links) > 30
    for link in links:
        assert (ROOT / link).exists(), link


def test_every_file_that_contributors_read_of_is_there() -> None:
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    names = set(re.findall(r"`((?:\w+/)+\w+\.\w+)`", re.sub(r"```.*?```", "", text, flags=re.DOTALL)))
    assert len(names) > 15
    roots = (ROOT, ROOT / "src" / "kreisel")
    missing = {name for name in names if not any((root / name).is_file() for root in roots)}
    assert missing <= {"docs/generated/done.json"}, missing  # made by `make docs`


def test_the_readme_is_short() -> None:
    assert len(README.read_text(encoding="utf-8").splitlines()) <= 130


def test_two_cores_are_shown_of_an_idle_machine_only(monkeypatch: pytest.MonkeyPatch) -> None:
    """The committed results make every table; a figure by the clock taken under load is left out of it."""
    monkeypatch.syspath_prepend(str(README.parent / "benchmarks"))
    tables = importlib.import_module("tables")
    result = tables._result("ensemble")
    for load, shown in ((0.0, True), (9.0, False)):
        monkeypatch.setattr(tables, "_result", lambda name, load=load: result | {"load_average_before": load})
        rows = tables.ensembles().splitlines()[2:]
        assert len(rows) == len(result["maps"])
        assert all(("not measured" in row) != shown for row in rows)
