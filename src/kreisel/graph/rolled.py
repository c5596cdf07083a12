"""Graphs whose loops over tables of constants stay loops, for languages that have them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from kreisel.graph.arranging import arranged
from kreisel.graph.graph import Graph, Operand, depending, operands_of

ROW, ENTRY = "row", "each"  # letters of the columns of a table, and of the results of its rows


def of_a_row(letter: str) -> bool:
    """Whether an input is a column of a table."""
    return letter.startswith(ROW)


class Rolled(Graph):
    """A graph whose loops over tables stay loops.

    maps    (rows, results) of each loop: its columns are inputs `row`, its results outside inputs `each`
    tables  whether loops over tables stay loops, or are written out
    """

    def __init__(self, tables: bool) -> None:
        super().__init__()
        self._tables = tables
        self.maps: list[tuple[Sequence[Sequence[float]], list[Operand]]] = []

    def for_rows(self, body: Callable[..., Any], rows: Sequence[Sequence[float]]) -> list[Any]:
        if not self._tables:
            return super().for_rows(body, rows)
        place = len(self.maps)
        columns = [self.input(f"{ROW}{place}", j) for j in range(len(rows[0]))]
        self.maps.append((rows, [body(*columns)]))
        return [self.input(f"{ENTRY}{place}", k) for k in range(len(rows))]

    def times(self, body: Callable[[list[Any]], Sequence[Any]], start: Sequence[Any], count: int) -> Sequence[Any]:
        """The result of `count` applications of the body to `start`, recorded once."""
        return self.loop(lambda x: (body(x), 0.0), start, -1.0, count)[0]

    def arranged(self, outputs: Sequence[Operand]) -> tuple[Graph, list[Operand], list[Operand]]:
        """The graph made ready: its outputs, and the results of the loops.

        Values that a loop reads count as used often, as they are in a graph without loops.
        """
        results = [x for _, new in self.maps for x in new]
        inside = depending(self, self.needed(results), of_a_row)
        read = [x for at in inside for x in operands_of(self.nodes[at]) if x.at not in inside]
        graph, values = arranged(self, [*outputs, *results, *({x.at: x.positive for x in read}.values())])
        return graph, values[: len(outputs)], values[len(outputs) : len(outputs) + len(results)]
