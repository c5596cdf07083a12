"""Every statement of the paper fails when a formula of it is spoiled: signs, numbers, operators, one at a time."""

from __future__ import annotations

import ast
import copy
import inspect
import sys
from collections.abc import Iterator
from dataclasses import replace
from types import ModuleType

import numpy as np
import pytest

from kreisel.lab import laws, paper
from kreisel.lab.paper import statements
from kreisel.record.contract import System
from kreisel.system import clebsch, clebsch_general, heavy_top, kirchhoff, lagrange_top, lagrange_top_moving, neumann

OWN = [s for s in paper.STATEMENTS.values() if not s.by_laws]
BY_LAWS = [s for s in paper.STATEMENTS.values() if s.by_laws]


class Spoiled(ast.NodeTransformer):
    """The formula with its k-th sign, number or operator changed; counts them too."""

    def __init__(self, k: int):
        self.k, self.seen = k, -1

    def _turn(self) -> bool:
        self.seen += 1
        return self.seen == self.k

    def visit_Subscript(self, node: ast.Subscript) -> ast.AST:
        node.value = self.visit(node.value)  # an index is no formula
        return node

    def visit_Attribute(self, node: ast.Attribute) -> ast.AST:
        self.generic_visit(node)
        return node.value if node.attr in ("T", "mT") and self._turn() else node

    def visit_Constant(self, node: ast.Constant) -> ast.AST:
        whole = type(node.value) is int and node.value > 0  # 0 x has the kind of number of x
        return ast.Constant(node.value + 1) if whole and self._turn() else node

    def visit_BinOp(self, node: ast.BinOp) -> ast.AST:
        self.generic_visit(node)
        if isinstance(node.op, ast.Add | ast.Sub) and self._turn():
            return ast.BinOp(node.left, ast.Sub() if isinstance(node.op, ast.Add) else ast.Add(), node.right)
        if isinstance(node.op, ast.Div) and self._turn():
            return ast.BinOp(node.left, ast.Mult(), node.right)
        return node

    def visit_UnaryOp(self, node: ast.UnaryOp) -> ast.AST:
        self.generic_visit(node)
        return node.operand if isinstance(node.op, ast.USub) and self._turn() else node

    def visit_Call(self, node: ast.Call) -> ast.AST:
        self.generic_visit(node)
        if isinstance(node.func, ast.Name) and node.func.id in ("wedge", "bracket", "cayley") and self._turn():
            return ast.UnaryOp(ast.USub(), node)
        return node


def sources(module: ModuleType) -> dict[str, ast.FunctionDef]:
    tree = ast.parse(inspect.getsource(module))
    found = {node.name: node for node in tree.body if isinstance(node, ast.FunctionDef)}
    for node in found.values():
        node.decorator_list = []
    return found


def formulas(name: str, known: dict[str, ast.FunctionDef]) -> list[str]:
    """The function of that name, and those of its module that it calls."""
    out = [name]
    for one in out:
        called = {n.id for n in ast.walk(known[one]) if isinstance(n, ast.Name)}
        out += [other for other in known if other in called and other not in out]
    return [one for one in out if not one.startswith("generic_")]  # functions with nothing special about them


def spoiled_forms(statement: statements.Statement) -> Iterator[statements.SidesOf]:
    module = sys.modules[statement.sides.__module__]
    known, places = sources(module), []
    for name in formulas(statement.sides.__name__, known):
        counter = Spoiled(-2)
        counter.visit(copy.deepcopy(known[name]))
        places += [(name, k) for k in range(counter.seen + 1)]
    for place in np.random.default_rng(1).permutation(len(places)):
        name, k = places[int(place)]
        space, tree = dict(vars(module)), copy.deepcopy(known)
        tree[name] = Spoiled(k).visit(tree[name])
        body = ast.fix_missing_locations(ast.Module(list(tree.values()), []))
        exec(compile(body, module.__file__ or "", "exec"), space)
        yield statements.drawn(space[statement.sides.__name__])


def fails(statement: statements.Statement) -> bool | None:
    """Whether it fails, None where it cannot be computed."""
    small = replace(statement, printed=None, numbers=statement.numbers[-1:])
    try:
        return not paper.tested(small, statement.dimensions[:1]).holds
    except (ValueError, TypeError, ArithmeticError, LookupError, RuntimeWarning, np.linalg.LinAlgError):
        return None


@pytest.mark.parametrize("statement", OWN, ids=lambda s: s.name)
def test_a_spoiled_formula_is_found(statement: statements.Statement) -> None:
    """One of them at least: those that change the random data only are no mutants.  Misprints have another test."""
    assert statement.printed or any(fails(replace(statement, sides=form)) for form in spoiled_forms(statement))


def spoiled_system(system: System) -> System:
    """Its flow and its step with the first component a little too large."""

    def larger(function):
        def spoiled(*state, **known):
            first, *others = function(*state, **known)
            return (first * 9 / 8, *others)

        names = {**inspect.signature(function).parameters}
        spoiled.__signature__ = inspect.Signature(list(names.values()))
        return spoiled

    flow = None if system.flow is None else larger(system.flow)
    rule = None if system.map is None else replace(system.map, step=larger(system.map.step))
    return replace(system, flow=flow, map=rule)


@pytest.mark.parametrize("statement", BY_LAWS, ids=lambda s: s.name)
def test_a_spoiled_system_is_found(statement: statements.Statement, monkeypatch: pytest.MonkeyPatch) -> None:
    drawn = laws.drawn_case

    def spoiled(system, *data):
        case = drawn(system, *data)
        return replace(case, model=spoiled_system(case.system)(**case.model.params))

    monkeypatch.setattr(laws, "drawn_case", spoiled)
    assert fails(statement)


# -- the functions of the records that the paper prints ------------------------------------------------

CONTINUOUS = ("flow", "energy")
DISCRETE = (*CONTINUOUS, "step", "lax", "lax_matrix", "conjugator")
PRINTED = {
    "record-heavy-top": [(heavy_top, (*CONTINUOUS, "inverse_inertia"))],
    "record-lagrange-top": [(lagrange_top, (*DISCRETE, "energy with eps"))],
    "record-lagrange-top-moving": [(lagrange_top_moving, (*DISCRETE, "energy with eps", "inverse_inertia"))],
    "record-kirchhoff": [(kirchhoff, CONTINUOUS), (clebsch_general, (*CONTINUOUS, "lax"))],
    "record-clebsch": [(clebsch, DISCRETE)],
    "record-clebsch-energy": [(clebsch, ("energy with eps",)), (neumann, ("energy with eps",))],
    "record-spectra": [(m, ("spectrum",)) for m in (lagrange_top, lagrange_top_moving, clebsch, clebsch_general)],
    "record-lagrangians": [(module, ("lagrangian",)) for module in (lagrange_top, lagrange_top_moving, clebsch)],
    "neumann-flow": [(neumann, ("flow",))],
}
CASES = [(name, module, f) for name, records in PRINTED.items() for module, own in records for f in own]


@pytest.mark.parametrize(("name", "module", "function"), CASES, ids=lambda x: getattr(x, "__name__", x))
def test_another_function_of_a_record_is_found(
    name: str, module: ModuleType, function: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By an eighth of a component; an energy by eps^2 |P|^2/7, which is conserved as well, with eps or without."""
    word, _, deformed = function.partition(" with ")
    by_map = word == "step" and not hasattr(module, word)
    right = getattr(module.MAP if by_map else module, word)

    def spoiled(*state, **known):
        value = right(*state, **known)
        if word == "energy":
            square = (state[-1] * state[-1]).sum()
            return value + (known.get("eps", 0) ** 2 if deformed else 1) * square / 7
        if isinstance(value, tuple):
            return (value[0] * 9 / 8, *value[1:])
        return value * 9 / 8

    statement = paper.STATEMENTS[name]
    assert not fails(statement)
    if by_map:
        monkeypatch.setattr(module, "MAP", replace(module.MAP, step=spoiled))
    else:
        monkeypatch.setattr(module, word, spoiled)
    assert fails(statement)


def test_another_multiplier_of_neumann_s_system_is_found() -> None:
    """q' = Bx - (<x, Bx> + 2 <q, q>) x, which is the same wedged with x."""
    module = sys.modules["kreisel.lab.paper.clebsch"]
    text = inspect.getsource(module.neumann_flow)
    text = text[text.index("def ") :]
    assert text.count("dot(q, q)) * x") == 1
    space = dict(vars(module))
    statement = paper.STATEMENTS["neumann-flow"]
    exec(text.replace("if sign > 0", "if False").replace("dot(q, q)) * x", "2 * dot(q, q)) * x"), space)
    assert fails(replace(statement, sides=statements.drawn(space["neumann_flow"])))


@pytest.mark.parametrize("statement", paper.STATEMENTS.values(), ids=lambda s: s.name)
def test_another_seed_draws_other_numbers(statement: statements.Statement) -> None:
    drawn = []
    for seed in (0, 1):
        s = statements.Setting(statement.dimensions[0], statement.numbers[-1], seed)
        draw, values = s.draw, []
        s.draw = lambda shape, draw=draw, values=values: values.append(draw(shape)) or values[-1]
        next(iter(statement.sides(s)))
        drawn.append([float(x) for value in values for x in np.ravel(value)])
    assert drawn[0] and drawn[1] and drawn[0] != drawn[1]
