"""The paper, statement by statement; and that statements can fail."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest
from typer.testing import CliRunner

from kreisel.cli import app
from kreisel.errors import InputError
from kreisel.lab import paper
from kreisel.lab.paper import statements
from sizes import FULL
from support import ROOT, docs_tool

DOCS = ROOT / "docs"


@pytest.mark.parametrize("name", paper.STATEMENTS)
def test_statement(name: str) -> None:
    sizes = [n for n in paper.STATEMENTS[name].dimensions if FULL or n < 5]  # `make verify` proves all for the page
    finding = paper.tested(paper.STATEMENTS[name], sizes)
    assert finding.holds, f"{finding.statement.text}: {finding.over_q} over Q, {finding.in_floats} in floats"
    assert finding.dimensions == sizes != []


@pytest.mark.parametrize("name", [name for name, statement in paper.STATEMENTS.items() if statement.printed])
def test_a_misprint_in_the_place_of_the_statement_is_found(name: str) -> None:
    statement = paper.STATEMENTS[name]
    spoiled = replace(statement, sides=statement.printed, printed=None, numbers=statement.numbers[-1:])
    assert paper.tested(spoiled).verdict == "FAILS"


def test_a_correct_form_said_to_be_a_misprint_is_found() -> None:
    statement = paper.STATEMENTS["theorem-7.1"]
    assert not paper.tested(replace(statement, printed=statement.sides), (3,)).holds


def test_every_erratum_has_a_statement() -> None:
    named = {word for s in paper.STATEMENTS.values() for word in s.erratum.replace(",", " ").split()}
    assert named == {f"E{i}" for i in range(1, 18)}
    assert all(s.printed for s in paper.STATEMENTS.values() if s.erratum)


def test_every_numbered_statement_is_there() -> None:
    names = " ".join(s.place for s in paper.STATEMENTS.values())
    numbered = [f"Theorem {t}" for t in ("2.1", "3.1", "6.1", "6.2", "6.3", "6.4", "7.1")]
    assert all(text in names for text in [*numbered, "Proposition 5.1", "Proposition 5.2", "Lemma 6.1"])


def test_the_page_of_the_docs_has_these_statements_and_verdicts() -> None:
    page = (DOCS / "verified.md").read_text(encoding="utf-8")
    findings = [
        statements.StatementResult(
            s,
            over_q=0.0 if "exact" in s.numbers else None,
            in_floats=0.0 if "float" in s.numbers else None,
            dimensions=list(s.dimensions),
        )
        for s in paper.STATEMENTS.values()
    ]
    made = [line for line in docs_tool("verified").markdown(findings).splitlines() if line.startswith("| `")]
    shown = [line for line in page.splitlines() if line.startswith("| `")]
    for mine, theirs in zip(made, shown, strict=True):
        mine, theirs = (line.replace("\\|", "/").split(" | ") for line in (mine, theirs))
        assert mine[:6] == theirs[:6]
        assert theirs[7].startswith(mine[7].removesuffix(" |"))


def test_command() -> None:
    out = CliRunner().invoke(app, ["verify", "pairing-identity", "--json"])
    assert out.exit_code == 0
    (result,) = json.loads(out.stdout)
    assert result["holds"] and result["exact"] == 0 and result["n"] == [3, 4, 5, 6]
    listed = CliRunner().invoke(app, ["verify", "theorem", "--list"]).stdout.splitlines()
    assert len(listed) == sum(name.startswith("theorem") for name in paper.STATEMENTS)
    assert len(json.loads(CliRunner().invoke(app, ["verify", "theorem", "--list", "--json"]).stdout)) == len(listed)
    with pytest.raises(InputError, match=r"theorem-6\.1"):
        statements.chosen("theorm-6.1")
