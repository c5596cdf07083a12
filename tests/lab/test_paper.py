"""The paper, row by row; and that rows can fail."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest
from typer.testing import CliRunner

from kreisel.cli import app
from kreisel.errors import InputError
from kreisel.lab import paper
from kreisel.lab.paper import rows
from support import ROOT

DOCS = ROOT / "docs"


@pytest.mark.parametrize("name", paper.ROWS)
def test_row(name: str) -> None:
    finding = paper.test(paper.ROWS[name])
    assert finding.holds, f"{finding.row.statement}: {finding.over_q} over Q, {finding.in_floats} in floats"
    assert finding.dimensions == list(finding.row.dimensions)


@pytest.mark.parametrize("name", [name for name, row in paper.ROWS.items() if row.printed])
def test_a_misprint_in_the_place_of_the_statement_is_found(name: str) -> None:
    row = paper.ROWS[name]
    spoiled = replace(row, sides=row.printed, printed=None, in_rationals=False)
    assert paper.test(spoiled).verdict == "FAILS"


def test_a_correct_form_said_to_be_a_misprint_is_found() -> None:
    row = paper.ROWS["theorem-7.1"]
    assert not paper.test(replace(row, printed=row.sides), (3,)).holds


def test_every_erratum_has_a_row() -> None:
    named = {word for row in paper.ROWS.values() for word in row.erratum.replace(",", " ").split()}
    assert named == {f"E{i}" for i in range(1, 18)}
    assert all(row.printed for row in paper.ROWS.values() if row.erratum)


def test_every_numbered_statement_has_a_row() -> None:
    names = " ".join(row.place for row in paper.ROWS.values())
    numbered = [f"Theorem {t}" for t in ("2.1", "3.1", "6.1", "6.2", "6.3", "6.4", "7.1")]
    assert all(text in names for text in [*numbered, "Proposition 5.1", "Proposition 5.2", "Lemma 6.1"])


def test_the_page_of_the_docs_has_these_rows_and_verdicts() -> None:
    page = (DOCS / "verified.md").read_text(encoding="utf-8")
    findings = [
        rows.Finding(row, over_q=0.0 if row.in_rationals else None, in_floats=0.0, dimensions=list(row.dimensions))
        for row in paper.ROWS.values()
    ]
    told = [line for line in rows.markdown(findings).splitlines() if line.startswith("| `")]
    shown = [line for line in page.splitlines() if line.startswith("| `")]
    for mine, theirs in zip(told, shown, strict=True):
        mine, theirs = (line.replace("\\|", "/").split(" | ") for line in (mine, theirs))
        assert mine[:5] == theirs[:5]
        assert theirs[6].startswith(mine[6].removesuffix(" |"))


def test_command() -> None:
    out = CliRunner().invoke(app, ["verify", "pairing-identity", "--json"])
    assert out.exit_code == 0
    (told,) = json.loads(out.stdout)
    assert told["holds"] and told["exact"] == 0 and told["n"] == [3, 4, 5, 6]
    listed = CliRunner().invoke(app, ["verify", "theorem", "--list"]).stdout.splitlines()
    assert len(listed) == sum(name.startswith("theorem") for name in paper.ROWS)
    with pytest.raises(InputError, match=r"theorem-6\.1"):
        rows.chosen("theorm-6.1")
