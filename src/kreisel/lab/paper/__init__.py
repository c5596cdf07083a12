"""The paper, statement by statement: every numbered theorem, proposition, lemma and displayed identity, tested.

    from kreisel.lab import paper
    list(paper.verify("theorem-6.1"))  # one statement, or all whose names begin so
    list(paper.verify())               # all, n = 3, 4, 5, 6, exactly over Q and in floats

A statement has a place in the paper, a text, and pairs of sides that it states are equal at random points.  In rational
arithmetic they must be equal exactly, a randomized identity test; in floats up to round-off.  A statement with an erratum
also has the printed form, which must fail.
"""

from kreisel.lab.paper import clebsch, fields, records, reduction, tops  # noqa: F401  - they register
from kreisel.lab.paper.statements import STATEMENTS, Statement, StatementResult, section, tested, verify

__all__ = ["STATEMENTS", "Statement", "StatementResult", "tested", "verify"]

_ordered = sorted(STATEMENTS.items(), key=section)
STATEMENTS.clear()
STATEMENTS.update(_ordered)
