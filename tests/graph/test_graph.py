"""Recorded arithmetic is exact in its foldings; what is arranged and compiled computes the same."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from kreisel.algebra.iteration import address_of, entry
from kreisel.graph.arranging import arranged, independent, latest, length
from kreisel.graph.graph import (
    APPLIED,
    Graph,
    Number,
    TooLong,
    array_of,
    evaluated,
    fma,
    if_positive,
    maximum,
    repeated,
    where_less,
)
from kreisel.graph.recording import operation_count
from support import compiled_outputs


def numbers(*letters: str) -> tuple[Graph, list[Number]]:
    graph = Graph()
    return graph, [graph.input(letter, 0) for letter in letters]


def operations(graph: Graph, outputs: list[Any]) -> list[str]:
    return [graph.nodes[at][0] for at in graph.needed(outputs) if graph.nodes[at][0] != "in"]


def test_foldings_are_exact() -> None:
    graph, (x, y) = numbers("x", "y")
    assert x + 0 is x
    assert x * 1 is x
    assert x * 0 == 0.0
    assert x - x == 0.0
    assert (-1 * (-x)).key == x.key
    assert ((y - x) + 0).key == (-(x - y)).key  # one difference, recorded once
    assert ((x + y) - x).key != y.key  # round-off is not simplified away
    assert (x * y).key == (y * x).key
    assert (-x * y).key == (-(x * y)).key
    assert operations(graph, [(x + y) - x, x * y, y - x]) == ["-", "+", "-", "*"]
    assert fma(-1e300, 1e300, 1.0) == -math.inf
    with pytest.raises(TypeError, match="unhashable"):  # a user's cache by arguments gives no number of another graph
        hash(x)


FORMULAS: list[Callable[[Any, Any], Any]] = [
    lambda a, b: a / b - 2 / a + (-a) * b - 3,
    lambda a, b: (a - b) * (b - a) / -2 + (1 - a),
    lambda a, b: -(a * -1.5) - (-b) / a + a**3 - 0.25,
    lambda a, b: 0 - a + b * -1 + (-a - b) - (0 - (-b)),
    lambda a, b: a**-2 + abs(-b) * 3,
    lambda a, b: fma(-a, b, -b) + fma(2.0, a, 1.0) - fma(a, 0.5, -0.75),
    lambda a, b: maximum(a, b) - maximum(-a, 0.25) + where_less(a, b, 2 * a, -b) * where_less(-a, 0.5, 1.0, b),
]


@pytest.mark.parametrize("formula", FORMULAS)
def test_recorded_arithmetic_is_that_of_python(formula: Callable[[Any, Any], Any]) -> None:
    """Run again on floats, arranged, and by machine code for a number and for vectors, whose bits are the same."""
    graph = Graph()
    result = formula(graph.input("x", 0), graph.input("x", 1))
    plain, outputs = arranged(graph, [result])
    rows = np.random.default_rng(3).normal(size=(11, 2))
    right = np.array([formula(a, b) for a, b in rows.tolist()])
    for a_graph, a_result in ((graph, [result]), (plain, outputs)):
        values = [evaluated(a_graph, a_result, lambda _, i, row=row: row[i])[0] for row in rows.tolist()]
        np.testing.assert_allclose(values, right, rtol=1e-14, atol=1e-14)
        assert (compiled_outputs(a_graph, a_result, rows)[:, 0] == values).all()
        assert (compiled_outputs(a_graph, a_result, rows, 4)[:, 0] == values).all()


@pytest.mark.parametrize("name", ["sin", "cos", "exp", "log", "sqrt", "sign", "nearest"])
def test_functions_of_one_number(name: str) -> None:
    graph = Graph()
    x = graph.input("x", 0)
    outputs = [getattr(x, name)(), -getattr(-(x * -1), name)()]
    values = np.random.default_rng(4).uniform(0.1, 3, (7, 1))
    values[0], values[1] = 0.5, 2.5
    right = [getattr(np, {"nearest": "rint"}.get(name, name))(v) for v in values[:, 0]]
    for width in (1, 2):
        found = compiled_outputs(graph, outputs, values, width)
        np.testing.assert_allclose(found, np.stack([right, -np.array(right)], 1), rtol=4e-16)


def test_a_sign_of_zero_is_positive() -> None:
    graph = Graph()
    outputs = [graph.input("x", 0).sign()]
    assert compiled_outputs(graph, outputs, np.array([[0.0], [-0.0], [-2.0], [3.0]])).tolist() == [[1], [1], [-1], [1]]


def test_products_are_fused_into_the_sums_that_alone_need_them() -> None:
    graph, (a, b, c, d) = numbers(*"abcd")
    once, twice = a * b, c * d
    values = [once + c, twice - a, twice + b, a / d, -b / d, c - once * 0.5]
    plain, outputs = arranged(graph, values[:5])
    assert operations(plain, outputs) == ["*", "fma", "-", "+", "/", "*", "*"]
    assert length(graph, values[:5]) == 7
    assert operations(*arranged(graph, [c - 2 * a])) == ["fma"]
    whole, outputs = arranged(graph, values[:5], {("b", 0): 1.0, ("d", 0): 0.0})
    assert operations(whole, outputs) == operations(plain, outputs)  # 1/0 stays for the run to find
    roots = [a.sqrt(), b.log()]
    assert operations(*arranged(graph, roots, {("a", 0): -1.0})) == operations(*arranged(graph, roots))
    short, outputs = arranged(graph, values[:5], {("b", 0): 1.0, ("c", 0): 0.0})
    assert repr(outputs[:3]) == "[a0, -a0, 1.0]"
    assert operations(short, outputs) == ["/", "*"]


def test_a_recorded_loop_is_the_loop() -> None:
    """Newton's square root of a: what does not vary stands before the loop, and nodes within end with it."""
    graph, (a,) = numbers("a")

    def improve(x: Any) -> tuple[Any, Any]:
        new = (x + (a / 3 * 3) / x) / 2
        change = (new - x)[0]
        return new, change * change

    (root,), defect = a.record_loop(improve, array_of([1.0]), 1e-20, 50)
    assert operations(graph, [root]) == ["/", "*", "loop", "result"]
    assert not graph.has("+", root, 1.0)
    plain, outputs = arranged(graph, [root * 2, defect])
    for values in (plain, outputs), (graph, [root * 2, defect]):
        twice, change = compiled_outputs(*values, np.array([[7.0]]))[0]
        assert twice == pytest.approx(2 * math.sqrt(7.0), abs=1e-15)
        assert change <= 1e-20
    (short,), few = a.record_loop(improve, array_of([1.0]), 1e-20, 2)
    assert compiled_outputs(graph, [short, few], np.array([[7.0]]))[0] == pytest.approx([2.875, 1.125**2])
    with pytest.raises(TypeError, match="loop within a loop"):
        a.record_loop(lambda x: improve(a.record_loop(improve, x, 0.0, 2)[0]), array_of([1.0]), 0.0, 2)


@pytest.mark.parametrize("width", [1, 4])
def test_a_branch_is_taken_if_a_lane_needs_it(width: int) -> None:
    """Nodes of it are not used elsewhere; other lanes keep what they have; plain numbers branch as Python does."""

    def formula(x: Any, y: Any) -> list[Any]:
        (root,) = if_positive(x, lambda: [where_less(0.0, x, (x * y + 1.0) / x, y)], [y])
        return [root * 2.0, x * y + 1.0]

    graph = Graph()
    x, y = graph.inputs("x", 2)
    outputs = formula(x, y)
    assert operations(graph, outputs) == ["branch", "result", "*", "*", "+"]
    assert graph.digest(outputs) != graph.digest([y * 2.0, *outputs[1:]])
    for rows in ([(-1.0, 3.0), (0.0, 2.0)], [(-1.0, 3.0), (0.5, 7.0), (0.0, 2.0), (-2.0, 1.0), (4.0, 1.0)]):
        values = np.array(rows)
        assert compiled_outputs(graph, outputs, values, width).tolist() == [formula(*row) for row in values.tolist()]


@pytest.mark.parametrize("width", [1, 4])
def test_a_branch_within_a_loop_and_a_loop_within_a_branch(width: int) -> None:
    """Each as Python runs it, arranged and evaluated too; nodes of a body are not used elsewhere."""

    def formula(x: Any, y: Any) -> list[Any]:
        def halved(v: Any) -> Any:
            return if_positive(
                v[0] - 1.0, lambda: [where_less(1.0, v[0], v[0] * 0.5 - y, v[0]), v[1] + 1], [v[0], v[1]]
            )

        def grown() -> list[Any]:
            return [where_less(0.0, y, repeated(lambda v: [v[0] * y + 1.0], [x], 3)[0], x)]

        return [*repeated(halved, [x, 0.0], 4), *if_positive(y, grown, [x]), x * 0.5 - y]

    graph = Graph()
    outputs = formula(*graph.inputs("x", 2))
    plain, arranged_outputs = arranged(graph, outputs)
    assert {"loop", "branch"} <= {*operations(plain, arranged_outputs)}
    assert plain.digest(arranged_outputs) != graph.digest(outputs)  # products are fused
    rows = np.array([[9.0, 0.25], [0.5, -2.0], [3.0, 0.5], [-1.0, 1.0], [40.0, -0.125]])
    right = [formula(*row) for row in rows.tolist()]
    if width == 1:
        assert [evaluated(plain, arranged_outputs, lambda _, i, row=row: row[i]) for row in rows.tolist()] == right
    for each in (graph, outputs), (plain, arranged_outputs):
        found = compiled_outputs(*each, rows, width)
        columns = [0, 2, 3] if width > 1 else [0, 1, 2, 3]  # v[1] counts the branches of any lane
        assert found[:, columns].tolist() == np.array(right)[:, columns].tolist()
    known, values = arranged(graph, outputs, {("x", 0): 9.0, ("x", 1): 0.25})
    assert evaluated(known, values, lambda _, i: math.nan) == right[0]
    assert length(graph, outputs) > operation_count(plain, arranged_outputs) / 2 > 5
    assert independent(graph, graph.needed(outputs), "x").isdisjoint(
        at for at in graph.needed(outputs) if graph.nodes[at][0] in ("branch", "result", "loop")
    )


@pytest.mark.parametrize("values", [*itertools.permutations([math.nan, -1.0, 2.0, 0.5])][::3])
def test_a_lane_that_is_no_number_does_not_hide_others(values: Any) -> None:
    """One lane of a vector takes the branch, wherever the lane that is NaN stands."""
    graph = Graph()
    x = graph.input("x", 0)
    outputs = if_positive(x, lambda: [where_less(0.0, x, x * 3.0, x)], [x])
    found = compiled_outputs(graph, outputs, np.array(values)[:, None], 4)[:, 0]
    assert np.array_equal(found, [3 * v if v > 0 else v for v in values], equal_nan=True)


@pytest.mark.parametrize("width", [1, 4])
def test_a_loop_of_a_fixed_length_takes_lanes(width: int) -> None:
    graph = Graph()
    x, y = graph.inputs("x", 2)
    outputs = list(repeated(lambda v: [v[0] * y + v[1], 0.5 * v[1]], [x, 1.0], 5))
    assert operations(graph, outputs) == ["loop", "result", "result"]
    values = np.array([(-1.0, 3.0), (0.5, 7.0), (0.0, 2.0), (-2.0, 1.0), (4.0, 1.0)])
    right = [list(repeated(lambda v, y=y: [v[0] * y + v[1], 0.5 * v[1]], [x, 1.0], 5)) for x, y in values.tolist()]
    assert compiled_outputs(graph, outputs, values, width).tolist() == right


def test_the_latest_order_computes_the_same() -> None:
    rng, graph = np.random.default_rng(5), Graph()
    values = list(graph.inputs("x", 4))
    for _ in range(60):
        i, j = rng.integers(len(values), size=2)
        values.append(values[i] * 0.3 + values[j] if rng.random() < 0.7 else values[i] * values[j] - 0.5)
    outputs = [v for v in values[-6:] if isinstance(v, Number)]
    nodes = graph.needed(outputs)
    order = latest(graph, nodes)
    assert sorted(order) == nodes
    assert order != nodes
    place = {at: k for k, at in enumerate(order)}
    assert all(place[x.at] < place[at] for at in nodes for x in graph.nodes[at][1:] if isinstance(x, Number))


def test_what_does_not_vary_is_told_from_what_does() -> None:
    graph = Graph()
    z, c, s = graph.input("z", 0), graph.input("c", 0), graph.input("s", 0)
    fixed, of_stage, step = c * c, c * s + 1, z * c
    nodes = graph.needed([fixed, of_stage, step])
    assert independent(graph, nodes, "c") == {c.at, fixed.at}
    assert independent(graph, nodes, "cs") == set(nodes) - {z.at, step.at}


def test_a_digest_is_of_the_operations_alone() -> None:
    def digest(function: Callable[[Any, Any], Any], first: bool = False) -> str:
        graph = Graph()
        x, y = graph.input("z", 0), graph.input("c", 1)
        if first:
            y * 3 + x  # which nothing needs
        return graph.digest([function(x, y)])

    assert digest(lambda x, y: x * y - 2) == digest(lambda x, y: x * y - 2, first=True)
    others = [lambda x, y: x * y - 3, lambda x, y: x * y + 2, lambda x, y: 2 - x * y, lambda x, y: x * x - 2]
    assert len({digest(f) for f in [lambda x, y: x * y - 2, *others]}) == 5


def test_a_graph_may_be_too_long() -> None:
    graph = Graph(most=10)
    x = graph.input("x", 0)
    with pytest.raises(TooLong):
        for k in range(20):
            x = x * x + k


def test_every_operation_is_known_to_all() -> None:
    """What evaluates, compiles and arranges knows the same operations."""
    graph = Graph()
    x = list(graph.inputs("x", 4))
    arity = {"fma": 3, "where": 4, "entry": 3, **dict.fromkeys(("+", "-", "*", "/", "max"), 2)}
    table = np.array([[5.0, 6.0], [7.0, 8.0]])
    for name in APPLIED:
        inputs = (address_of(table), 1.0, 1.0, 0.9) if name == "entry" else (0.3, 0.7, 0.2, 0.9)
        result = [x[0].record(name, *x[: arity.get(name, 1)], *((1, 2) if name == "entry" else ()))]
        again, outputs = arranged(graph, result)
        assert operations(again, outputs) == [name]
        value = compiled_outputs(graph, result, np.array([inputs]))[0, 0]
        right = evaluated(graph, result, lambda _, i, inputs=inputs: inputs[i])[0]
        assert value == pytest.approx(right, rel=1e-15)


def test_entries_of_a_table() -> None:
    """Rows outside are the first or the last, row 0 for NaN, 0 for no table; in lanes too, each with its table."""
    tables = [np.arange(6.0).reshape(3, 2), np.arange(10.0, 14.0).reshape(2, 2)]
    graph = Graph()
    x = graph.inputs("x", 3)
    result = [x[0].record_entry(*x, 1, 2)]
    cases = [(0, r, w) for r, w in ((-7, 1.0), (0, 1.0), (1, 3.0), (2, 5.0), (9, 5.0), (np.nan, 1.0), (np.inf, 5.0))]
    cases += [(1, 1, 13.0), (1, 5, 13.0), (None, 3, 0.0)]
    ends = {k: (address_of(x), len(x) - 1.0) for k, x in enumerate(tables)} | {None: (0.0, 0.0)}
    rows = [[ends[k][0], r, ends[k][1]] for k, r, _ in cases]
    want = [w for *_, w in cases]
    assert compiled_outputs(graph, result, np.array(rows))[:, 0].tolist() == want
    assert entry(*np.array(rows).T, 1, 2).tolist() == want


def test_a_loop_is_evaluated_until_it_has_settled() -> None:
    """Newton's method for a root of 2; twice only if it may not go on."""
    for most, root in ((20, 2**0.5), (2, 17 / 12)):
        graph = Graph()
        y, start = graph.inputs("x", 2)
        x, defect = graph.loop(lambda x, y=y: ([(x[0] + y / x[0]) / 2], abs(x[0] * x[0] - y)), [start], 1e-12, most)
        assert evaluated(graph, x, lambda _, i: (2.0, 1.0)[i]) == pytest.approx([root], rel=1e-15)
        assert (evaluated(graph, [defect], lambda _, i: (2.0, 1.0)[i])[0] <= 1e-12) == (most == 20)


def test_a_loop_of_one_iteration_is_written_out() -> None:
    """Next to a loop of more; the defect, which nothing needs, is left out."""

    def outputs(first: int) -> tuple[Graph, list[Any]]:
        graph = Graph()
        y, start = graph.inputs("x", 2)
        x = [start]
        for most in (first, 20):
            x, _ = graph.loop(lambda x: ([(x[0] + y / x[0]) / 2], abs(x[0] * x[0] - y)), x, 1e-12, most)
        return arranged(graph, x)

    graph, values = outputs(1)
    assert operations(graph, values) == ["/", "+", "/", "loop", "result"]
    assert evaluated(graph, values, lambda _, i: (2.0, 1.0)[i]) == pytest.approx([2**0.5], rel=1e-15)
    assert operations(*outputs(2)).count("loop") == 2
