"""Code with one fault breaks a check: graphs, their order, what is written from them for CPUs, GPUs and large n."""

from __future__ import annotations

import importlib
import inspect
import math
import re
import textwrap
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple
from weakref import WeakValueDictionary

import numpy as np
import pytest

import gpus
import kreisel as kr
from kreisel import algebra
from kreisel.graph import graph as operations, machine
from kreisel.graph.arranging import arranged, pulled, pushed
from kreisel.graph.graph import Graph, evaluated, fma, if_positive, maximum, repeated, where_less
from kreisel.kernels import gpu
from kreisel.kernels.gpu import ptx
from kreisel.method import scheme
from kreisel.runs.planning import make_plan
from support import compiled_outputs

EPS = float(np.finfo(float).eps)
LANES = 11  # a register of 8 and a ragged end


def floats(count: int) -> Any:
    return np.random.default_rng(count).uniform(0.3, 1.8, (LANES, count)) * np.resize([1, -1, 1], (LANES, 1))


# -- checks ------------------------------------------------------------------------------------------


def formulas(a: Any, b: Any, c: Any, d: Any) -> list[Any]:
    """Every operation, with signs; quotients by two numbers by turns; a product that two sums need."""
    once, twice = a * b, c * d
    return [
        *(a / c, b / d, b / c, a / d, a / (-b), (-a) / 2.0, a * -1.5, -a * 0.0, b * -1.0),
        *(a - c, c - a, -a + c, -a - b, b + (-d), once - c, c - d * a, twice + a, twice - b, a**4, a**-3),
        *(fma(a, b, c), fma(-a, 2.0, -d), where_less(a, b, c, -d), maximum(a, -b), operations.sign(b) * c, abs(a) + b),
    ]


def graph_of_formulas() -> tuple[Graph, list[Any]]:
    graph = Graph()
    return graph, formulas(*graph.inputs("x", 4))


def same(graph: Graph, outputs: list[Any], rows: Any, right: Any) -> None:
    """Machine code for a number and for vectors gives the right rows."""
    for width in (1, 4):
        np.testing.assert_allclose(compiled_outputs(graph, outputs, rows, width), right, rtol=1e-13, atol=1e-13)


def check_arithmetic() -> None:
    graph, outputs = graph_of_formulas()
    rows = floats(4)
    right = np.array([formulas(*row) for row in rows.tolist()])
    for each in (graph, outputs), arranged(graph, outputs):
        same(*each, rows, right)


def check_arranging() -> None:
    """A product that two sums need stays; values stand in the place of the inputs they are for."""
    graph = Graph()
    x, y, z = graph.inputs("x", 3)
    plain, outputs = arranged(graph, [x * y + z, y * z + x, y * z - x])
    assert [plain.nodes[at][0] for at in plain.needed(outputs) if plain.nodes[at][0] != "in"] == ["fma", "*", "+", "-"]
    plain, outputs = arranged(graph, [x - 2 * y], {("x", 1): 3.0})
    assert evaluated(plain, outputs, lambda _, i: float(i + 1)) == [-5.0]


def check_digest() -> None:
    graph = Graph()
    x, y = graph.inputs("x", 2)
    assert len({graph.digest([value]) for value in (x - y, y - x, -(x - y), x / y, y / x, x + y)}) >= 5
    assert graph.digest([(x - y) * x]) != graph.digest([(y + x) * x]) != graph.digest([(x + y) * -x])
    other = Graph()
    u, v = other.inputs("x", 2)
    assert other.digest([v - u]) != graph.digest([x - y])


def check_loops() -> None:
    """A loop of a fixed length, Newton's root of a, a branch that some lanes take."""

    def formula(a: Any, b: Any) -> list[Any]:
        (root,) = if_positive(a - 1.0, lambda: [where_less(1.0, a, a * b, b)], [b])
        return [*repeated(lambda v: [v[0] * b + v[1], 0.5 * v[1]], [a, 1.0], 5), root]

    graph, rows = Graph(), floats(2)
    same(graph, formula(*graph.inputs("x", 2)), rows, [formula(*row) for row in rows.tolist()])
    graph = Graph()
    a = graph.input("x", 0)
    values = abs(rows[:, :1])
    for close, error in ((1e-9, 1e-14), (1e-2, 1e-2)):
        roots, _ = graph.loop(lambda x: ([(x[0] + a / x[0]) / 2], abs(x[0] * x[0] - a)), [1.0], close, 20)
        by_one, by_four = (compiled_outputs(graph, roots, values, width) for width in (1, 4))
        np.testing.assert_allclose(by_one, np.sqrt(values), rtol=error)
        assert (by_one == by_four).all()  # although lanes end at different times


def check_nesting() -> None:
    """A branch within a loop, of lanes of which the first is no number."""

    def halved(v: Any) -> Any:
        return if_positive(v[0] - 1.0, lambda: [where_less(1.0, v[0], v[0] * 0.5 - v[1], v[0]), v[1]], v)

    graph, rows = Graph(), np.array([[math.nan, 0.0], [9.0, 0.25], [0.5, 2.0], [30.0, -0.5]])
    outputs = repeated(halved, [*graph.inputs("x", 2)], 4)[:1]
    right = [repeated(halved, row, 4)[:1] for row in rows.tolist()]
    for each in (graph, outputs), arranged(graph, outputs):
        same(*each, rows, right)


def check_sweeps() -> None:
    """Slopes and tangents against central differences."""
    graph = Graph()
    x = graph.inputs("z", 3)

    def formula(x: Any) -> list[Any]:
        return [x[0] * -x[1] / x[2] - x[2], (x[1] - x[0]) * abs(x[2])]

    outputs, z, h = formula(x), np.array([0.7, 1.3, -0.4]), 1e-6
    J = np.array([np.subtract(formula(z + e), formula(z - e)) / (2 * h) for e in h * np.eye(3)]).T
    v, w = np.array([0.3, -0.8, 0.5]), np.array([1.1, -0.6])
    values = {"z": z, "w": w, "vz": v}
    back, slopes = pulled(graph, outputs)
    found = evaluated(back, [slopes["z", i] for i in range(3)], lambda letter, i: float(values[letter][i]))
    np.testing.assert_allclose(found, w @ J, atol=1e-8)
    on, both = pushed(graph, outputs)
    np.testing.assert_allclose(evaluated(on, both[2:], lambda letter, i: float(values[letter][i])), J @ v, atol=1e-8)


def planned(model: Any, state: dict[str, Any], method: str, order: int | None, **options: Any) -> Any:
    asked = {"dt": 0.1, "steps": 6, "every": 2, "orientation": None, "project": False}
    return make_plan(model, model.state(**state), method=method, order=order, **asked | options)


def a_top(method: str, order: int, lanes: int = LANES, **options: Any) -> Any:
    """Lagrange's top with parameters by lane, some of which are 0 and 1 in the first lane alone."""
    draw = np.random.default_rng(3)
    p, m, a = draw.normal(size=(3, lanes, 3))
    p[0] = 0, 0, 1
    return planned(kr.LagrangeTop(p=p, alpha=0.7), {"m": m, "a": a}, method, order, **options)


def rows_of(plan: Any, rows: int = 3, every: int = 2) -> Any:
    out = np.empty((rows, *plan.engine.z.shape))
    plan.engine.advance(out, every)
    return out


def by_definition(plan: Any) -> Any:
    """The rows of `rows_of`."""
    z, out = algebra.restore(plan.engine.z, plan.kinds, plan.model.n), []
    for _ in range(3):
        z = plan.scheme.advance(*plan.scheme.advance(*z))
        out.append(algebra.flatten(z, plan.kinds))
    return np.array(out)


def as_defined(plan: Any) -> None:
    right = by_definition(plan)
    np.testing.assert_allclose(rows_of(plan), right, atol=1e-12)


def check_lanes() -> None:
    """Constants by lane, steps in overlapping order."""
    as_defined(a_top("suris", 1))


def check_stages() -> None:
    """Constants by stage."""
    as_defined(a_top("baecklund", 8, 1))


def check_close() -> None:
    """A part that closes each step."""
    as_defined(a_top("baecklund", 6, 1))


def check_weaving() -> None:
    """A projection every third step is that of the state after three steps."""
    woven, single = (a_top("suris", 1, project=True) for _ in range(2))
    start = woven.engine.z + 1e-7 * np.random.default_rng(1).normal(size=woven.engine.z.shape)
    for plan, every in ((woven, 3), (single, 1000)):
        plan.engine.projection.every = every
        plan.engine.z[:] = start
    right = []
    for k in range(1, 9):
        right.append(rows_of(single, 1, 1)[0])
        if k % 3 == 0:
            single.engine.projection.apply()
            right[-1] = single.engine.z.copy()
    assert (rows_of(woven, 8, 1) == right).all()


def gradients(plan: Any, z: Any) -> Any:
    """Those of all that the method conserves, by central differences."""

    def invariants(z: Any) -> Any:
        values = plan.scheme.observe(algebra.restore(z[None], plan.kinds, 3))
        return np.concatenate([np.ravel(v) for k, v in values.items() if plan.scheme.outcomes[k].conserved])

    h = 1e-5
    return np.array([invariants(z + e) - invariants(z - e) for e in h * np.eye(len(z))]).T / (2 * h)


def check_projection() -> None:
    """The least change that puts the invariants back: it lies along their gradients."""
    plan = a_top("suris", 1, 1, project=True)
    engine = plan.engine
    start, kick = engine.z[0].copy(), 1e-7 * np.random.default_rng(2).normal(size=6)
    J = gradients(plan, start)
    engine.z[0] += kick
    engine.projection.apply()
    left = engine.z[0] - start
    assert abs(J @ left).max() < 0.05 * abs(J @ kick).max()
    change = left - kick
    along = np.linalg.lstsq(J.T, change, rcond=1e-7)[0] @ J
    assert abs(along - change).max() < 1e-4 * abs(change).max()
    farthest = engine.projection.worst.max() * EPS * np.linalg.norm(start)
    assert 0.1 < farthest / np.linalg.norm(kick) < 1
    engine.projection.apply()
    assert engine.projection.worst.max() * EPS * np.linalg.norm(start) == farthest


def check_the_mean() -> None:
    """A state that drifts by the same in every interval has its invariants on both sides of those of the start."""
    engine = a_top("baecklund", 2, 1, project=True).engine
    start = engine.z[0].copy()
    for _ in range(600):
        before = engine.z[0].copy()
        engine.z[0, 3:] *= 1 + 1e-11
        after = engine.z[0].copy()
        engine.projection.apply()
    a_before, a_after, a_start = (x[3:] @ x[3:] for x in (before, after, start))
    assert abs(a_before + a_after - 2 * a_start) < 0.1 * abs(a_after - a_before)


def of_gpu(plan: Callable[..., Any], monkeypatch: pytest.MonkeyPatch, **options: Any) -> tuple[Any, Any]:
    """Plans for the CPU, and for the code of a GPU on this processor."""
    monkeypatch.setattr(gpu, "device", gpus.Here)
    return plan(**options), plan(engine="cuda", **options)


def check_gpu(monkeypatch: pytest.MonkeyPatch) -> None:
    cpu, cuda = of_gpu(lambda **options: a_top("baecklund", 8, 3, **options), monkeypatch)
    assert (rows_of(cpu) == rows_of(cuda)).all()


def check_tables(monkeypatch: pytest.MonkeyPatch) -> None:
    """A projection by tables, on GPUs, is the one that is written out, but for its gain."""
    cpu, cuda = of_gpu(lambda **options: a_top("suris", 1, 2, project=True, **options), monkeypatch)
    kick = 1e-9 * np.random.default_rng(1).normal(size=cpu.engine.z.shape)
    for plan in (cpu, cuda):
        plan.engine.restore(plan.engine.snapshot() | {"z": plan.engine.z + kick})
        plan.engine.projection.apply()
    state = cuda.engine._device.host(cuda.engine._state).T
    assert abs(state - cpu.engine.z).max() < 0.05 * abs(kick).max()
    np.testing.assert_allclose(cuda.engine.projection.worst, cpu.engine.projection.worst, rtol=1e-6)


def check_ptx() -> None:
    """The lane is block * size + thread, and threads beyond the last lane do nothing."""
    text = ptx(2, lambda f, lane, arguments: f.doubles(arguments[0]).beyond(lane).put([1.0]), "80")
    assert re.search(r"setp\.(le|ge)\.\w64", text)
    names = dict(re.findall(r"mov\.u32\s+(%r\d+), %(\w+\.x);", text))
    ((*multiplied,),) = re.findall(r"mul\.wide\.u32\s+%rd\d+, (%r\d+), (%r\d+);", text)
    (added,) = re.findall(r"cvt\.u64\.u32\s+%rd\d+, (%r\d+);", text)
    assert sorted(names[x] for x in multiplied) == ["ctaid.x", "ntid.x"]
    assert names[added] == "tid.x"


def check_large() -> None:
    """Kernels of O(n) and O(n^2): kept inverses, sums, entries that are no whole vectors."""
    draw = np.random.default_rng(7)
    X, P, b = draw.normal(size=(10, 10)) / 3, draw.normal(size=10) / 3, draw.uniform(0.1, 2, 10)
    x, q = np.eye(10)[3], np.where(np.arange(10) == 3, 0, P)
    asked: dict[str, Any] = {"method": "suris", "order": 1, "project": False, "progress": False}
    for model, state in (kr.Clebsch(b=b), {"M": X - X.mT, "P": P}), (kr.Neumann(b=b), {"x": x, "q": q}):
        with warnings.catch_warnings(action="ignore"):  # of mutants, which conserve nothing
            run = kr.simulate(model, state, dt=0.1, steps=6, every=2, engine="large", **asked)
        plan = scheme(model, "suris", 0.1, 1, False).on(tuple(state.values()))
        z = plan.prepare(tuple(state.values()))
        for row in range(1, 4):
            z = plan.advance(*plan.advance(*z))
            right = plan.observe(z)
            for letter in state:
                np.testing.assert_allclose(run[letter].values[row], right[letter], atol=1e-13)


CHECKS: dict[str, Callable[..., None]] = {
    name.removeprefix("check_"): function for name, function in globals().items() if name.startswith("check_")
}


# -- mutants -----------------------------------------------------------------------------------------


class Mutant(NamedTuple):
    """A fault: in the source of a function the text `right` becomes `wrong`, and the check fails."""

    check: str
    place: str
    right: str
    wrong: str
    error: type[Exception] = AssertionError

    @property
    def function(self) -> Any:
        """The function, without what decorates it."""
        module, _, names = self.place.partition(":")
        found: Any = importlib.import_module(f"kreisel.{module}")
        for name in names.split("."):
            found = inspect.getattr_static(found, name)
        return plain(found)

    def code(self) -> Any:
        """The code of the function with the fault."""
        source, function = textwrap.dedent(inspect.getsource(self.function)), self.function
        assert source.count(self.right) == 1, f"{self.place}: expected once {self.right!r}"
        namespace = dict(function.__globals__)
        text = "from __future__ import annotations\n" + source.replace(self.right, self.wrong)
        exec(compile(text, self.place, "exec"), namespace)
        return plain(namespace[function.__name__]).__code__


def plain(function: Any) -> Any:
    return inspect.unwrap(getattr(function, "fget", None) or getattr(function, "__func__", None) or function)


GRAPH, ARRANGING, LLVM, STEPS = "graph.graph:", "graph.arranging:", "graph.llvm:Function.", "kernels.steps:"
PROJECT, LARGE = "graph.project:Projection.", "kernels.large.kernel:_Lane."
SAVED = 'store(saved.beyond(row * words["lanes"] * count))'
MUTANTS = [
    # branches within loops
    Mutant("nesting", GRAPH + "Graph._added", "self._inside.add(at)", "pass", AttributeError),
    Mutant("nesting", LLVM + "largest", '"uno", b, b', '"uno", a, a'),
    Mutant("nesting", ARRANGING + "_Arranging._branch", "if_positive(test", "if_positive(-test"),
    # recorded arithmetic
    Mutant("arithmetic", GRAPH + "Number.__add__", "(b, a) if self.negative else (a, b)", "(a, b)"),
    Mutant("arithmetic", GRAPH + "Number.__add__", "negative=True", "negative=False"),
    Mutant("arithmetic", GRAPH + "Number.__mul__", "(other < 0)", "False"),
    Mutant("arithmetic", GRAPH + "Number.__mul__", "else -self", "else self"),
    Mutant("arithmetic", GRAPH + "Number.__truediv__", "!= other.negative", "!= False"),
    Mutant("arithmetic", GRAPH + "integer_power", "half * half", "half * x"),
    Mutant("digest", GRAPH + "Graph.digest", "in (PLUS, TIMES)", "in (PLUS, MINUS, TIMES)"),
    Mutant("digest", GRAPH + "Graph.digest", "{'-' * x.negative}{digests", "{digests"),
    # fusing, shared reciprocals, values in the place of inputs, order
    Mutant("arithmetic", ARRANGING + "_with_reciprocals", '("1/", y.at)', '("1/", 0)'),
    Mutant("arithmetic", ARRANGING + "_fused", "addend = -addend", "addend = addend"),
    Mutant("arithmetic", ARRANGING + "_fused", "p = -p", "p = p"),
    Mutant("arranging", ARRANGING + "_fused", "uses[step.place] == 1", "uses[step.place]"),
    Mutant("arranging", ARRANGING + "_Arranging._record", ".get((letter, index))", ".get((letter, 1))"),
    Mutant("lanes", ARRANGING + "latest", "reversed(order)", "order", KeyError),
    Mutant("lanes", "graph.recording:special_constants", ".all(0)", ".any(0)"),
    Mutant("stages", "graph.recording:Recording.fixed", '"c" if self.stages else "cs"', '"cs"'),
    # LLVM's operations
    Mutant("arithmetic", LLVM + "_operation", "INTRINSIC[operation], *x)", "INTRINSIC[operation], *x[::-1])"),
    Mutant("arithmetic", LLVM + "_operation", "*x[2:]", "*x[:1:-1]"),
    Mutant("arithmetic", LLVM + "_operation", "*x), x[1], x[0]", "*x), x[0], x[1]"),
    Mutant("arithmetic", LLVM + "value", 'self._arithmetic("fneg", value) if', "value if"),
    Mutant("arithmetic", LLVM + "lanes", "- 1", "- 2"),
    Mutant("arithmetic", LLVM + "loop", '"<" if', '"<=" if'),
    Mutant("arithmetic", "graph.llvm:Lanes.__setitem__", "INDEX(i)", "INDEX(0)"),
    Mutant("arithmetic", "graph.llvm:Lanes.__getitem__", "INDEX(i)", "INDEX(len(loaded) - 1 - i)"),
    Mutant("loops", LLVM + "_loop", 'compared("<"', 'compared("<="'),
    Mutant("loops", LLVM + "_loop", 'unordered(">", new', 'unordered("<=", new'),
    Mutant("loops", LLVM + "_loop", 'unordered(">", memory', 'unordered("<=", memory'),
    Mutant("loops", LLVM + "_loop", "select(active, x, room[0])", "select(active, x, x)"),
    Mutant("loops", LLVM + "largest", 'fcmp_ordered(">="', 'fcmp_ordered("<="'),
    # slopes and tangents
    Mutant("sweeps", "graph.arranging:pulled", "-slope if", "slope if"),
    Mutant("sweeps", "graph.arranging:_tangents", "-tangent if", "tangent if"),
    # the step of a map
    Mutant("stages", STEPS + "Constants.at", "stage * self._stride", "0"),
    Mutant("stages", STEPS + "Constants.begin", "s.beyond(stage * of_stages)", "s"),
    Mutant("lanes", STEPS + "_write", "constants[k].at", "constants[0].at"),
    Mutant(
        "stages",
        STEPS + "_write",
        f"else:\n                with f.loop(0, every):\n                    step()\n            {SAVED}",
        f"else:\n                {SAVED}\n                with f.loop(0, every):\n                    step()",
    ),
    Mutant("close", STEPS + "pieces_of_step", "range(1, len(", "range(2, len("),
    Mutant(
        "weaving",
        STEPS + "_woven",
        'steps = left[0].least(words["interval"]',
        'words = words | {"interval": words["interval"] + 1}\n        steps = left[0].least(words["interval"]',
    ),
    Mutant("weaving", STEPS + "_woven", "load()", "pass"),
    Mutant("weaving", STEPS + "_write", "(last - lane).least(vectors * width)", "1"),
    # the projection
    Mutant("projection", PROJECT + "correct", "fused(-self.x", "fused(self.x"),
    Mutant("projection", PROJECT + "gradients", "x[slopes + self.base + i] = 0.0", "pass"),
    Mutant("projection", PROJECT + "_solve", "factor = -(", "factor = ("),
    Mutant("projection", PROJECT + "_solve", "indices(k - 1, -1, -1)", "indices(k - 1, 0, -1)"),
    Mutant("projection", PROJECT + "_lack", "off, off, farthest", "off, farthest, off"),
    Mutant("the_mean", PROJECT + "_lack", "0.5 * (lack + lead) - lead", "0.5 * (lack - lead) - lead"),
    Mutant("tables", "graph.project:_Looping.only", '"=="', '"!="'),
    # large n
    Mutant("large", "kernels.large.kernel:Sum.value", "self._f.builder.fadd(places[0], number)", "places[0]"),
    Mutant("large", LARGE + "compute", "before_last()", "pass"),
    Mutant("large", LARGE + "times", "scale[0] = 0.0", "pass"),
    Mutant("large", LARGE + "times", "back[0] = builder.fsub(", "back[0] = builder.fadd("),
    Mutant("large", LARGE + "times", "(x[i], x.beyond(start)", "(x[0], x.beyond(start)"),
    Mutant("large", LARGE + "_renew", "builder.fneg(entry)", "entry"),
    # GPUs
    Mutant("gpu", "kernels.gpu:Column.__getitem__", "self._lanes * i + self._lane", "self._lane * i + self._lanes"),
    Mutant("gpu", "kernels.gpu:Column.beyond", "self._lanes * i", "i"),
    Mutant("gpu", "kernels.gpu:steps_of_a_lane", 's.beyond(stage * record.count("s"))', "s"),
    Mutant("ptx", "kernels.gpu:_Thread.lane", "block * size + thread", "block * thread + size"),
    Mutant("ptx", "kernels.gpu:ptx", 'lane.compared("<", f.arguments[-1])', 'lane.compared("==", lane)'),
]


@pytest.fixture
def checked(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Callable[[str], None]:
    """A check, by kernels of its own: keys of kernels tell files of code apart, not what was put in their place."""
    monkeypatch.setenv("KREISEL_CACHE", str(tmp_path))
    monkeypatch.setattr(machine, "_loaded", WeakValueDictionary())

    def check(name: str) -> None:
        function = CHECKS[name]
        function(*[monkeypatch] * len(inspect.signature(function).parameters))

    return check


@pytest.mark.parametrize("check", CHECKS)
def test_the_code_passes(check: str, checked: Callable[[str], None]) -> None:
    checked(check)


@pytest.mark.parametrize("mutant", MUTANTS, ids=lambda mutant: f"{mutant.place}: {mutant.wrong[:40]}")
def test_a_mutant_breaks_its_check(
    mutant: Mutant, checked: Callable[[str], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(mutant.function, "__code__", mutant.code())
    with pytest.raises(mutant.error):
        checked(mutant.check)
