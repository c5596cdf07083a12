"""Derivatives of graphs without loops, as graphs: forwards along tangents, in reverse for slopes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from kreisel.algebra import gradient
from kreisel.graph import graph as ops
from kreisel.graph.arranging import independent
from kreisel.graph.graph import Graph, Number, Operand, evaluated, where_less

CHOICES = (ops.WHERE, ops.MAX)  # the derivative of the other value does not count, even if it is not finite
# Derivatives of an operation by its operands: slopes(value, *operands).
SLOPES: dict[str, Callable[..., tuple[Operand, ...]]] = gradient.SLOPES | {
    ops.FMA: lambda value, x, y, z: (y, x, 1),
    ops.MAX: lambda value, x, y: (where_less(x, y, 0, 1), where_less(x, y, 1, 0)),
    ops.WHERE: lambda value, x, y, a, b: (0, 0, where_less(x, y, 1, 0), where_less(x, y, 0, 1)),
    ops.SIZE: lambda value, x: (x.sign(),),
    ops.SIGN: lambda value, x: (0,),
    ops.NEAREST: lambda value, x: (0,),
    ops.ENTRY: lambda value, *operands: (0,) * len(operands),
}


def pushed(graph: Graph, outputs: Sequence[Operand], fixed: str = "") -> tuple[Graph, list[Operand]]:
    """A new graph, with the outputs and then their tangents J v; its inputs "vz" are the tangents of "z".

    Inputs of the letters `fixed` have none.
    """
    along: dict[int, Operand] = {}

    def of(x: Operand) -> Operand:
        tangent = along.get(x.at, 0.0) if isinstance(x, Number) else 0.0
        return -tangent if isinstance(x, Number) and x.negative else tangent

    graph, new, moving = _copy(graph, outputs, fixed)
    for at in moving:
        operation, *operands = graph.nodes[at]
        if operation == ops.IN:
            letter, index = operands
            along[at] = graph.input(f"v{letter}", index)
        elif operation in CHOICES:
            x, y = operands[:2]
            yes, no = (y, x) if operation == ops.MAX else operands[2:]
            along[at] = where_less(x, y, of(yes), of(no))
        else:
            along[at] = sum((slope * of(x) for x, slope in _slopes(graph, at)), 0.0)
    return graph, [*new, *map(of, new)]


def pulled(graph: Graph, outputs: Sequence[Operand], fixed: str = "") -> tuple[Graph, dict[tuple[str, int], Operand]]:
    """A new graph, with the slopes J^T w by inputs (letter, index); its inputs "w" are the slopes by the outputs.

    Inputs of the letters `fixed`, and those on which no output depends, have none.
    """
    graph, new, moving = _copy(graph, outputs, fixed)
    slopes: dict[int, Any] = dict.fromkeys(moving, 0.0)

    def add(x: Operand, slope: Operand) -> None:
        if isinstance(x, Number) and x.at in slopes:
            slopes[x.at] = slopes[x.at] + (-slope if x.negative else slope)

    plain = {x.at for x in new if isinstance(x, Number)}  # nodes that do not only go into choices
    for i, x in enumerate(new):
        add(x, graph.input("w", i))
    for at in reversed(moving):
        if graph.nodes[at][0] != ops.IN and isinstance(slopes[at], Number):
            free = at in plain
            for x, slope in _slopes(graph, at):
                gain = slopes[at] * slope
                kept = free or not isinstance(slope, Number)
                add(x, gain if kept else where_less(abs(slopes[at]), gradient.LEAST, 0.0, gain))
                if free and graph.nodes[at][0] not in CHOICES:
                    plain.add(x.at)
    return graph, {graph.nodes[at][1:]: slopes[at] for at in moving if graph.nodes[at][0] == ops.IN}


def _copy(graph: Graph, outputs: Sequence[Operand], fixed: str) -> tuple[Graph, list[Operand], list[int]]:
    new = Graph()
    copies = evaluated(graph, outputs, new.input)
    nodes = new.needed(copies)
    still = independent(new, nodes, fixed)
    return new, copies, [at for at in nodes if at not in still]


def _slopes(graph: Graph, at: int) -> list[tuple[Number, Operand]]:
    operation, *operands = graph.nodes[at]
    slopes = SLOPES[operation](Number(graph, at), *operands)
    return [(x, slope) for x, slope in zip(operands, slopes, strict=True) if isinstance(x, Number)]
