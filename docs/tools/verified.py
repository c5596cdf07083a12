"""The paper, verified: docs/verified.md, by `make verify`."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from kreisel.lab import paper
from kreisel.lab.paper.statements import StatementResult, cells

PAGE = Path(__file__).parents[1] / "verified.md"
PAGE_HEAD = """# The paper, verified

Every numbered theorem, proposition and lemma, and the displayed identities, of Yu. B. Suris, *Integrable
discretizations of some cases of the rigid body dynamics* (2001), tested at random points: exactly over the rationals,
where the residual must be 0, and in floats. Labels in brackets come from the source text. Statements with errata
([list](errata.md)) also test the printed form, which must fail; the number states by how much, in the n where it fails least.
A random point is not a proof for all n: it makes an identity of rational functions that is false very unlikely to pass.
Another `--seed` tests every statement at other points; steps and parameters have both signs where the formulas allow it.
The last statements concern further maps, beyond the paper.

The column *computed* names the comparison: the two sides of the formulas; ranks of differentials with the counts of the
statement; or the [laws](laboratory.md) of the record. That a wrong statement fails is tested too (`tests/lab/test_statements_fail.py`):
signs, coefficients and transposes of its formulas are changed one at a time until it fails, or the flow and the step of the
record are spoiled; of errata the printed form must fail.

Made by `make verify`; one statement: `kreisel verify theorem-6.1`.

| name | where | statement | computed | n | over Q | floats | verdict |
|---|---|---|---|---|---|---|---|"""


def markdown(findings: Iterable[StatementResult]) -> str:
    """The docs page: one line for each statement."""
    lines = [PAGE_HEAD]
    for finding in findings:
        statement = finding.statement
        n, over_q, floats, verdict = cells(finding)
        text, place = (words.replace("|", "\\|") for words in (statement.text, statement.place))
        lines.append(
            f"| `{statement.name}` | {place} | {text} | {finding.computed} | {n} | {over_q} | {floats} | {verdict} |"
        )
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    findings = list(paper.verify())
    if failing := [finding.statement.name for finding in findings if not finding.holds]:
        raise SystemExit(f"these statements fail: {', '.join(failing)}")
    PAGE.write_text(markdown(findings), encoding="utf-8")
