"""The paper, row by row: every numbered theorem, proposition, lemma and displayed identity, tested.

    from kreisel.lab import paper
    list(paper.verify("theorem-6.1"))  # one row, or every row whose name begins so
    list(paper.verify())               # all, n = 3, 4, 5, 6, exactly over Q and in floats

A row is a place in the paper, a statement, and pairs of sides that it says are equal at random points.  In rational
arithmetic they must be equal exactly, a randomized identity test; in floats up to round-off.  A row of an erratum
also has the printed form, which must fail.
"""

from kreisel.lab.paper import reduction, tops, top_rest_frame, top_moving_frame  # noqa: F401, I001  - each registers its rows, in this order
from kreisel.lab.paper import clebsch, clebsch_proof, neumann, named  # noqa: F401
from kreisel.lab.paper.rows import ROWS, Finding, Row, test, verify

__all__ = ["ROWS", "Finding", "Row", "test", "verify"]
