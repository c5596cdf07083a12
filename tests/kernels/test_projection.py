"""Round-off in one place: the state is put back on the invariants of the start, every K steps."""

from __future__ import annotations

import dataclasses
import warnings
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import kreisel as kr
from kreisel import algebra
from kreisel.algebra import invariants
from kreisel.graph import project
from kreisel.graph.graph import TooLong
from kreisel.graph.invariants import gradients, program_of
from kreisel.graph.project import CompiledProjection
from kreisel.graph.recording import flat_constants
from kreisel.kernels import projection, traced
from kreisel.kernels.projection import Observed
from kreisel.kernels.traced import Traced, gradient
from kreisel.lab import exact
from kreisel.method import default_method, scheme
from kreisel.method.scheme import held_by_orientation
from kreisel.physical import Ellipsoid
from kreisel.runs.planning import make_plan
from kreisel.sweeps.sweep import check_archive
from kreisel.system import REGISTRY
from sizes import FULL, costly, full
from support import cpu_engine

EPS = float(np.finfo(float).eps)
STEPPED = [name for name, system in REGISTRY.items() if system.map or system.baecklund or system.inverse_inertia]
MAPPED = [name for name in STEPPED if REGISTRY[name].map or REGISTRY[name].inverse_inertia]
CASES = [
    ("lagrange-top", "suris", 1),
    ("lagrange-top", "baecklund", 4),
    ("clebsch", "suris", 2),
    ("clebsch", "baecklund", 2),
]


@pytest.fixture
def often(monkeypatch: pytest.MonkeyPatch) -> int:
    """K = 100, so that short runs are projected."""
    for module in ("cpu", "projection"):
        monkeypatch.setattr(f"kreisel.kernels.{module}.interval", lambda cost, work, most=0: 100)
    return 100


def random_plan(
    name: str, n: int, method: str, order: int | None, lanes: int = 1, seed: int = 5, **options: Any
) -> Any:
    draw = exact.float_random(np.random.default_rng([seed, n]))
    models = [exact.random_model(REGISTRY[name], n, draw) for _ in range(lanes)]
    states = [REGISTRY[name].space.point(n, draw) for _ in range(lanes)]
    system, together = REGISTRY[name], lambda parts: np.stack(parts) if lanes > 1 else parts[0]
    kinds = {p.letter: p.kind for p in system.parameters}
    params = {
        k: v if kinds[k] in ("array", "dimension") else together([m.params[k] for m in models])
        for k, v in models[0].params.items()
    }
    state = {k: together([z[i] for z in states]) for i, k in enumerate(system.space.letters)}
    settings = {
        "dt": 0.1,
        "steps": 10_000,
        "every": 1,
        "orientation": None,
        "method": method,
        "order": order,
        **options,
    }
    return make_plan(system(**params), system(**params).state(**state), **settings)


def fraction(x: Any) -> np.ndarray:
    return np.vectorize(lambda v: Fraction(float(v)), otypes=[object])(x)


def exactly(plan: Any, z: np.ndarray) -> dict[str, Fraction]:
    """What the method conserves, in rational numbers, by label."""
    parts = algebra.restore(fraction(z), plan.kinds, plan.model.n)
    known = {k: fraction(v)[()] for k, v in plan.scheme.constants.items()}
    out = {}
    for name, value in plan.scheme.observe(parts, **known).items():
        if plan.scheme.outcomes[name].conserved:
            entries = np.asarray(value, dtype=object)
            out |= {f"{name}[{i}]" if entries.ndim else name: v for i, v in enumerate(entries.flat)}
    return out


@pytest.mark.parametrize(("name", "method", "order"), CASES)
@pytest.mark.parametrize("n", [3, 4])
def test_values_have_twice_the_digits(name: str, method: str, order: int, n: int) -> None:
    plan = random_plan(name, n, method, order)
    projection = plan.engine.projection
    known, digits = exactly(plan, plan.engine.z[0]), 0
    for label, (high, low, size, _) in zip(projection.labels, projection.targets[0], strict=True):
        found, true = Fraction(float(high)) + Fraction(float(low)), known[label]
        if label.startswith("noether") and n == 3:  # without its constant factor p_i
            true /= fraction(plan.scheme.constants["p"])[int(label[8:-1])]
        twice = isinstance(true, Fraction)  # where eps stands in it, it is computed in doubles
        assert min(abs(found - true), abs(found + true)) < (1e-28 if twice else 1e-15) * size, label
        assert abs(float(true)) <= size * (1 + 1e-12)
        digits += twice
    assert digits >= 2 or (name, method) == ("clebsch", "suris")


@pytest.mark.parametrize(("name", "method", "order"), CASES)
@pytest.mark.parametrize("lanes", [1, 5])
def test_a_state_is_put_back_by_the_least_change(name: str, method: str, order: int, lanes: int) -> None:
    plan = random_plan(name, 3, method, order, lanes)
    start, projection = plan.engine.z.copy(), plan.engine.projection
    draw = np.random.default_rng(0)
    plan.engine.z[:] += 1e-8 * draw.normal(size=start.shape)
    moved = plan.engine.z.copy()
    lack = projection.peek(moved)
    assert (lack.max(1) * EPS > 1e-10).all() and (projection.worst == 0).all() and (plan.engine.z == moved).all()
    for _ in range(1600):  # each leaves 1e-6 of what was there, and 63/64 of how far the one before went beyond
        projection.apply()
    assert (projection.peek(plan.engine.z) == projection.worst).all()
    left = projection.worst.copy()
    projection.worst[:] = 0
    assert (projection.peek(plan.engine.z) < 8).all() and (left > 1e4).any()
    change, apart = abs(plan.engine.z - moved).max(), abs(plan.engine.z - start).max()
    assert 1e-10 < change < 1e-7 and apart < 1e-7


def projected(name: str, n: int, method: str, lanes: int, **options: Any) -> tuple[Any, ...]:
    """A state off its invariants, projected once: its change, the values at the start, the lead, the corrections."""
    engine = random_plan(name, n, method, None, lanes, **options).engine
    engine.z[:] += 1e-10 * np.random.default_rng(0).normal(size=engine.z.shape)
    before = engine.z.copy()
    engine.projection.apply()
    start, lead = engine.projection.targets[..., :3], engine.projection.targets[..., 3]
    return engine.z - before, start, lead, engine.projection.worst


# With quotients and roots (the first two), an orientation, many invariants.
WRITTEN_OUT = [
    ("rosochatius", 3, "veselov", None),
    ("lagrange-top-su2", 3, "suris", None),
    ("lagrange-top", 3, "suris", "g"),
    ("clebsch", 4, "baecklund", None),
]


@pytest.mark.parametrize(
    ("lanes", "name", "n", "method", "orientation"),
    [
        *((lanes, *each) for lanes, each in zip((1, 11, 11, 1), WRITTEN_OUT, strict=True)),
        *full(*((lanes, *each) for lanes, each in zip((11, 1, 1, 11), WRITTEN_OUT, strict=True))),
    ],
)
def test_a_projection_written_out_is_that_of_its_program(
    lanes: int, name: str, n: int, method: str, orientation: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The bits are those of the loops that go through any program."""
    options: dict[str, Any] = {"orientation": None if orientation is None else np.eye(3)}
    monkeypatch.setattr("kreisel.graph.project.GAIN_STRAIGHT", project.GAIN)
    out = projected(name, n, method, lanes, **options)
    monkeypatch.setattr("kreisel.graph.invariants.MOST_STRAIGHT", 0)
    through = projected(name, n, method, lanes, **options)
    assert abs(out[0]).max() > 1e-12
    for what, other in zip(out, through, strict=True):
        assert (what == other).all()


@pytest.mark.parametrize(("what", "tau"), [("pair_product", 1.5e-6), ("pair_sum", 1.6e-6)])
def test_mutants_of_numbers_in_pairs(what: str, tau: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without the second double of a product or a sum values have no more digits than the state."""
    whole = getattr(project, what)
    monkeypatch.setattr(project, what, lambda *operands: (whole(*operands)[0], 0.0))
    monkeypatch.setattr(project, "TAU", tau)  # another kernel than that of the cache
    with pytest.raises(AssertionError):
        test_values_have_twice_the_digits("lagrange-top", "baecklund", 4, 3)


# Straight-line code, kernels of O(n), of O(n^2), the definition on arrays; those that take seconds.
BEYOND = [("lagrange-top", 9), ("clebsch", 11), ("lagrange-top", 40), ("neumann", 12)]
BEYOND += [
    *[("neumann", 10), ("lagrange-top-moving", 13), ("clebsch", 12)] * FULL,
    *[("euler-top", 12), ("ratiu-top", 12), ("quadratic-potential", 11)] * FULL,
]


@pytest.mark.parametrize(
    ("name", "n"), [(name, n) for name in MAPPED for n in (3, 4) if n == 3 or not costly(name)] + BEYOND
)
def test_what_is_conserved_does_not_walk(name: str, n: int, often: int) -> None:
    """Of every system, by its own method: the change is that of one interval, whatever the length of the run."""
    draw = exact.float_random(np.random.default_rng([7, n]))
    model = exact.random_model(REGISTRY[name], n, draw)
    z = model.system.space.point(n, draw)
    method = default_method(model, stepped=True)
    dt = {"rosochatius": 0.02}.get(name, 0.1 if n < 9 else 0.03)
    state = dict(zip(model.system.space.letters, z, strict=True))
    run = kr.simulate(model, state, dt=dt, steps=30 * often, every=often, method=method)
    assert run.attrs["projection"] == often
    table = kr.drift(run)
    assert table.conserved.any() and not table.broken.any()
    still = table[table.conserved & (table.start.abs() > 1e-3)]
    assert (still.ulps < 40).all(), still.to_string()
    assert (table.correction[table.conserved].dropna() < 2e3).all(), table.to_string()


def drifting(plan: Any) -> np.ndarray:
    """How far the middle of an interval is from the values at the start, over what they drift by in one (lanes, I).

    Steps that push the state by the same in each interval stand for rounding errors with a mean.
    """
    engine, draw = plan.engine, np.random.default_rng(0)
    push = 1e-8 * draw.normal(size=engine.z.shape)
    before = {name: value[0] for name, value in plan.observe(engine.z[None]).items()}
    for _ in range(600 if isinstance(engine.projection, CompiledProjection) else 150):
        engine.projection.apply()
        engine.z[:] += push
    high, low = (plan.observe(z[None]) for z in (engine.z, engine.z - push))
    found = []
    for name, outcome in plan.scheme.outcomes.items():
        if outcome.conserved:
            at = [np.reshape(x[name][0], (len(push), -1)) for x in (low, high)]
            drift = at[1] - at[0]
            off = (at[0] + at[1]) / 2 - np.reshape(before[name], at[0].shape)
            known = abs(drift) > 1e-11 * np.maximum(abs(at[0]), 1)
            found += [*(off[known] / drift[known])]
    return np.array(found)


IN_STRAIGHT_LINES = [(3, 1, "cpu"), (3, 5, "cpu"), (12, 1, "large"), *[(12, 1, "cpu")] * FULL]


@pytest.mark.parametrize(("n", "lanes", "engine"), IN_STRAIGHT_LINES)
def test_the_mean_of_an_interval_is_that_of_the_start(n: int, lanes: int, engine: str) -> None:
    """An invariant that drifts goes half a drift beyond its value at the start: the frequencies have no error of K."""
    plan = random_plan("lagrange-top", n, "suris", 1, lanes, engine=engine)
    found = drifting(plan)
    assert len(found) >= 5 and (abs(found) < 1e-2).all()


@pytest.mark.parametrize("stored", [False, True])
def test_arrays_go_back_to_the_start_of_the_run(stored: bool) -> None:
    """Invariants of the start are computed no sooner than a projection or a checkpoint needs them."""
    plan = random_plan("clebsch", 12, "suris", 1, lanes=2, engine="cpu")
    engine, before = plan.engine, plan.observe(plan.engine.z[None])
    if stored:
        snapshot = {name: value.copy() for name, value in engine.snapshot().items()}
        elsewhere = plan.model.state(**{name: -value[0] / 2 for name, value in before.items() if name in "MP"})
        settings = {"dt": 0.1, "steps": 10, "every": 1, "orientation": None, "method": "suris", "order": 1}
        engine = make_plan(plan.model, elsewhere, **settings, engine="cpu").engine
        engine.restore(snapshot)
    engine.z += 1e-7 * np.random.default_rng(0).normal(size=engine.z.shape)
    displaced = plan.observe(engine.z[None])
    engine.projection.apply()
    after = plan.observe(engine.z[None])
    conserved = [name for name, outcome in plan.scheme.outcomes.items() if outcome.conserved]
    changes = {name: (abs(x[name] - before[name]) / abs(before[name])).max() for name in conserved for x in [displaced]}
    assert max(changes.values()) > 1e-8
    for name in conserved:  # it leads by half of what is lacking, then by Newton's remainder of (1e-7)^2
        assert abs(after[name] - before[name]).max() < 0.6 * abs(displaced[name] - before[name]).max() + 1e-10, name


def test_an_interrupt_leaves_the_state_where_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    """Invariants of the start are computed with the rows of the start in place."""
    engine = random_plan("clebsch", 12, "suris", 1, engine="cpu").engine
    engine.z += 1e-7
    before = engine.z.copy()

    def interrupted(z: Any) -> Any:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(engine.projection, "_values", interrupted)
        with pytest.raises(KeyboardInterrupt):
            engine.projection.apply()
    assert (engine.z == before).all()
    engine.projection.apply()
    assert 0 < abs(engine.z - before).max() < 1e-5


def test_an_invariant_whose_gradient_vanishes() -> None:
    """(M.P)^2 at M.P = 0, which is at least 0: to lead it by what it drifted at another state threw the state away."""
    body = Ellipsoid.of_density((0.30, 0.15, 0.10), density=1000.0, fluid_density=1000.0)
    x0 = body.state((1.0, 1e-3, 1e-3), (0.0, 0.0, 0.0))
    run = kr.simulate(body.model(), x0, dt=0.005, steps=12_000, every=100, order=4)
    assert 0 < kr.drift(run).correction.max() < 100  # 14 measured, 4e4 with such leads


def test_mutant_of_the_lead(monkeypatch: pytest.MonkeyPatch) -> None:
    """Back to the values at the start and no further."""
    for name in ("graph.project.GAIN_STRAIGHT", "kernels.projection.GAIN"):
        monkeypatch.setattr(f"kreisel.{name}", 0.0)
    for n, engine in ((3, "cpu"), (12, "large")):
        found = drifting(random_plan("lagrange-top", n, "suris", 1, engine=engine))
        assert abs(found - 0.5).max() < 1e-2


def test_the_error_grows_like_the_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of iterates against their closed form; without a projection it grows like steps^1.5 and more."""
    draw, lanes, steps = np.random.default_rng(5), 16, 200_000
    top = kr.LagrangeTop(p=draw.normal(size=(lanes, 3)))
    x0 = top.state(m=draw.normal(size=(lanes, 3)), a=draw.normal(size=(lanes, 3)))
    true = kr.at(top, x0, float(steps), method="suris", dt=0.1, order=1)
    error = {}
    for projected in (True, False):
        options = {"dt": 0.1, "steps": steps, "every": steps, "method": "suris", "order": 1, "project": projected}
        end = kr.simulate(top, x0, **options).isel(time=-1)
        error[projected] = np.max([abs(end[k] - true[k]).max(end[k].dims[-1]).values for k in "ma"], 0)
    assert np.median(error[True]) < 1e-16 * steps  # 1e-17 measured
    assert np.median(error[False]) > 10 * np.median(error[True])  # 100 measured


@pytest.mark.parametrize("where", ["step", "integral"])
def test_a_map_that_does_not_conserve_ends_with_an_error(where: str, often: int, tmp_path: Path) -> None:
    """One coefficient off by 1e-9."""
    system = REGISTRY["lagrange-top"]
    phi = system.map

    def off(m: Any, a: Any, *, p: Any, eps: Any) -> Any:
        m1, a1 = phi.step(m, a, p=p, eps=eps)
        return m1, a1 * (1 + 1e-9)

    def energy(m: Any, a: Any, *, p: Any, eps: Any = 0) -> Any:
        return system.energy(m, a, p=p, eps=eps) + 1e-9 * (m * m).sum(-1).sum(-1) / 2

    changed = {"map": dataclasses.replace(phi, step=off)} if where == "step" else {"energy": energy}
    model = dataclasses.replace(system, **changed)(p=(0, 0, 1))
    x0 = model.state(m=(0.1, 0.2, 1.5), a=(0.6, 0, 0.8))
    options = {"dt": 0.1, "steps": 1000, "every": 100, "method": "suris", "order": 1}
    what = "casimir|energy|spectrum|noether" if where == "step" else "energy_eps"
    with pytest.raises(kr.RunError, match=rf"({what})[^ ]* is not conserved, although the method conserves it"):
        kr.simulate(model, x0, **options)
    with warnings.catch_warnings(category=kr.ConservationWarning, action="ignore"):
        raw = kr.simulate(model, x0, **options, project=False)
    assert kr.drift(raw).ulps[lambda table: table.index.str.contains(what)].max() > 1e4
    assert raw.attrs["projection"] == 0


@pytest.mark.filterwarnings("ignore:Lane .* more than half a revolution")
def test_a_lane_that_does_not_conserve_fails_alone(often: int, tmp_path: Path) -> None:
    """dt = 40 of order 8 is far too long for one of the lanes."""
    top = kr.LagrangeTop(p=(0, 0, 1))
    values = {"state.m": [(0.1, 0.2, 1.5), (1e5, 2e5, -3e6)]}
    given = {"dt": 40.0, "steps": 2000, "every": 2000, "order": 8, "workers": 0}
    x0 = top.state(m=(0.1, 0.2, 1.5), a=(0.6, 0, 0.8))
    sweep = kr.sweep(top, x0, kr.Design(together=values), path=tmp_path / "s.zarr", **given)
    assert sweep.sizes["lane"] == 2  # the long lane is right, or it is named as failed
    change = sweep["energy_drift"].values / abs(sweep["energy_start"].values)
    assert ((change < 1e-9) | (sweep["failed"].values == 1)).all()


DEGENERATE = {
    "asleep": ((0, 0, 3.0), (0, 0, 1)),
    "nearly asleep": ((1e-8, 0, 3.0), (0, 0, 1)),
    "hanging at rest": ((0, 0, 0), (0, 0, -1)),
    "upright at rest": ((0, 0, 0), (0, 0, 1)),
    "no momentum": ((0, 0, 0), (0.6, 0, 0.8)),
    "plane": ((0, 1.0, 0), (0.6, 0, 0.8)),
    "orthogonal": ((0.8, 0.3, -0.6), (0.6, 0, 0.8)),
    "steady": ((0.6, 0, 1.8), (0.6, 0, 0.8)),
    "huge": ((1e8, -2e8, 3e8), (0.6, 0, 0.8)),
    "tiny": ((1e-8, -2e-8, 3e-8), (0.6e-9, 0, 0.8e-9)),
}


@pytest.mark.parametrize("what", DEGENERATE)
@pytest.mark.parametrize(("method", "order"), [("suris", 1), ("baecklund", 2)])
def test_degenerate_states_are_no_special_case(what: str, method: str, order: int, often: int) -> None:
    m, a = DEGENERATE[what]
    top = kr.LagrangeTop(p=(0, 0, 1))
    dt = 0.1 / max(1.0, float(np.abs(m).max()))
    x0 = top.state(m=m, a=a)
    options = {"dt": dt, "steps": 5000, "every": 100, "method": method, "order": order}
    run = kr.simulate(top, x0, **options)
    table = kr.drift(run)
    assert not table.broken.any() and (table.ulps[table.conserved] < 60).all(), table.to_string()
    raw = kr.simulate(top, x0, **options, project=False)
    for letter in "ma":
        apart = float(abs(run[letter] - raw[letter]).max())
        assert apart < 1e-9 * float(abs(raw[letter]).max() + abs(raw["a"]).max())


@pytest.mark.parametrize(("n", "method", "steps"), [(12, "suris", 200_000), (60, "baecklund", 400_000)])
def test_large_n_does_not_walk_where_the_map_does(n: int, method: str, steps: int, often: int) -> None:
    """The tops' maps as they are have a trend there: 0.01 to 0.1 ulp a step."""
    name = "lagrange-top"
    plan = random_plan(name, n, method, 1 if method == "suris" else 2)
    raw = random_plan(name, n, method, 1 if method == "suris" else 2, project=False)
    start = {k: v for k, v in plan.observe(plan.engine.z[None].copy()).items() if plan.scheme.outcomes[k].conserved}
    off = {}
    for what, engine in (("projected", plan.engine), ("raw", raw.engine)):
        engine.advance(np.empty((1, *engine.z.shape)), steps)
        end = plan.observe(engine.z[None].copy())
        off[what] = max(np.max(abs(end[k] - start[k]) / np.max(abs(start[k])), initial=0) for k in start)
    assert off["projected"] < 200 * EPS  # 1 to 30 measured, which is rounding in the values themselves
    assert off["raw"] > 5 * off["projected"]  # 40 to 4000 measured


@pytest.mark.parametrize(("name", "method", "n"), [("lagrange-top", "suris", 12), ("euler-top", "veselov", 11)])
def test_the_bits_of_large_n_do_not_depend_on_rows_or_cuts(name: str, method: str, n: int, often: int) -> None:
    whole, parts = (random_plan(name, n, method, None, lanes=2).engine for _ in range(2))
    whole.advance(np.empty((1, *whole.z.shape)), 350)
    parts.advance(np.empty((99, *parts.z.shape)), 1)
    kept = {key: value.copy() for key, value in parts.snapshot().items()}
    again = random_plan(name, n, method, None, lanes=2).engine
    again.restore(kept)
    again.advance(np.empty((251, *parts.z.shape)), 1)
    assert (again.z == whole.z).all() and (again.projection.worst == whole.projection.worst).all()
    assert (whole.projection.worst > 0).any()


@pytest.mark.parametrize("name", ["lagrange-top", "lagrange-top-moving", "symmetric-top"])
@pytest.mark.parametrize(("method", "order"), [("suris", 1), ("suris", 2), ("baecklund", 2)])
@pytest.mark.parametrize("n", [4, *[9] * FULL, 30])
def test_the_form_of_a_kernel_has_the_same_invariants(name: str, method: str, order: int, n: int) -> None:
    plan = random_plan(name, n, method, order, engine="large", project=False)
    z = plan.engine.z
    found = Observed(plan.scheme, z)
    assert found.function is plan.scheme.conserved
    known = plan.observe(z[None])
    inner = found.at(z[0, : found.size], 0)
    assert {"energy", "energy_eps"} & inner.keys() and "casimir" in inner and not np.size(inner["noether"])
    for family in inner.keys() - {"noether"}:
        value = np.ravel(known[family])
        assert np.ravel(inner[family]).astype(float) == pytest.approx(value, rel=1e-10, abs=1e-13 * abs(value).max())
        assert len(found.members[family]) >= len(value) / 2  # some are constants


def of_arrays(x: Any) -> Any:
    """Everything that a traced array can do, on a row of 16 numbers."""
    X = x.reshape((4, 4))
    v = x[:4]
    parts = [X @ X.mT, 3.0 * X - X * X, 1 / (2 + X * X), (X.mT @ v[..., None]) / (1 + algebra.sqrt(1 + v * v))]
    scalars = [part.sum(-1).sum(-1) for part in parts] + [(-(X[..., [0, 1, 1], [2, 3, 3]] ** 3)).sum(-1)]
    mixed = algebra.skew(x[:6], 4) @ np.concatenate([v, 2.0 - v], -1)[..., 2:6][..., None]
    return invariants.stack([*scalars, (mixed[..., 0] * v).sum(-1), v[2] * 5 - v[0] / v[1]])


@pytest.mark.parametrize("seed", range(3))
def test_gradients_of_arrays(seed: int) -> None:
    draw = np.random.default_rng(seed)
    x, h = draw.normal(size=16), 1e-5
    z = Traced(x)
    y = of_arrays(z)
    assert (y.value == of_arrays(x)).all()
    differences = np.stack([(of_arrays(x + h * e) - of_arrays(x - h * e)) / (2 * h) for e in np.eye(16)], -1)
    assert gradient(y, z) == pytest.approx(differences, rel=1e-6, abs=1e-6)


NUMPY: dict[str, Any] = {  # of an array of 12 numbers
    "sum": lambda x, X: (
        np.sum(x * x) + np.sum(X, axis=0)[1] + np.sum(X * X, axis=(0, 1)) + X.sum(1, keepdims=True)[0, 0]
    ),
    "mean": lambda x, X: np.mean(x**3) + X.mean(0)[2] * x[1],
    "prod": lambda x, X: np.prod(x[:3]) + np.prod(X, axis=1)[1],
    "norm": lambda x, X: np.linalg.norm(x) * np.linalg.norm(X, axis=1)[0] * np.linalg.norm(X),
    "einsum": lambda x, X: np.einsum("ij,jk,k->", X, X.T, x[:3]) * np.einsum("i,i", x, np.arange(12.0)),
    "diagonal": lambda x, X: np.einsum("ii->i", X[:, :3] @ X.T[:3])[1] + np.einsum("ij->i", X)[0] * np.trace(X[:, :3]),
    "roll": lambda x, X: np.dot(x, np.roll(x, 1)) + np.vdot(np.roll(X, 1, axis=0)[0], X[2]),
    "products": lambda x, X: x[:3] @ X @ x[:4] + (X @ np.ones(4))[1] * (np.ones(3) @ X)[2] + np.outer(x, x)[3, 4],
    "functions": lambda x, X: np.sum(
        np.sin(x) * np.cosh(x) - np.tanh(x) / np.exp(x) + 2.0**x + np.square(np.arctan(x))
    ),
    "sizes": lambda x, X: (
        np.sqrt(abs(x)).sum() / len(X) + np.log(np.abs(x)).sum() * np.size(x) + (np.tan(x) * np.cos(x)).sum()
    ),
    "shapes": lambda x, X: (
        np.sum(np.stack([x[:4], X[1]]).transpose() @ np.ravel(X)[:2]) + np.reshape(x, (2, 6))[1, 1] ** 0.5
    ),
    "branch": lambda x, X: x[0] * x[1] if x[0] > x[1] and (x != 0).all() else x[2] / x[0],
    "reflected": lambda x, X: sum(np.ones(12) - x / 3) * (2 / (1 + x * x))[2] + np.add(1.5, x)[3] * np.sinh(x)[1],
}


@pytest.mark.parametrize("name", NUMPY)
def test_gradients_of_functions_of_numpy(name: str) -> None:
    def function(x: Any) -> Any:
        return NUMPY[name](x, x.reshape((3, 4)))

    x, h = np.random.default_rng(len(name)).uniform(0.4, 1.6, 12), 1e-6
    z = Traced(x)
    y = function(z)
    assert y.value == pytest.approx(function(x), rel=1e-14)
    differences = [(function(x + h * e) - function(x - h * e)) / (2 * h) for e in np.eye(12)]
    assert gradient(y.reshape((1,)), z)[0] == pytest.approx(differences, rel=1e-7, abs=1e-7)


@pytest.mark.parametrize("function", [np.sin, np.exp, np.cosh])
def test_mutants_of_slopes(function: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(traced.SLOPES, function, lambda g, x, y: -traced.SLOPES[np.square](g, x, y))
    with pytest.raises(AssertionError):
        test_gradients_of_functions_of_numpy("functions")


@pytest.mark.parametrize("place", [0, 1])
@pytest.mark.parametrize("function", [*traced.SLOPES_OF_TWO])
def test_mutants_of_slopes_of_two(function: Any, place: int, monkeypatch: pytest.MonkeyPatch) -> None:
    slopes = [*traced.SLOPES_OF_TWO[function]]
    right = slopes[place]
    slopes[place] = lambda *values: 1.01 * right(*values)
    monkeypatch.setitem(traced.SLOPES_OF_TWO, function, tuple(slopes))
    with pytest.raises(AssertionError):
        test_gradients_of_arrays(0)


@pytest.mark.parametrize(
    ("function", "message"),
    [
        (lambda a: np.sort(a)[0], "np.sort.*Use .*np.einsum"),
        (lambda a: np.maximum(a, 0).sum(), "np.maximum"),
        (lambda a: np.add.reduce(a), "np.add"),
        (lambda a: float(a[0]), "a conversion to a float"),
        (lambda a: np.array([a[0], a[1]]).sum(), "np.stack"),
        (lambda a: (1 + a[0] * a[0]) ** a[1], r"the power x\*\*y"),
        (lambda a: np.linalg.norm(a, 1), "the order 1"),
    ],
)
def test_a_function_without_slopes_is_named(function: Any, message: str) -> None:
    model, x0 = own_top(12, own=lambda m, a, *, p: function(a))
    with pytest.warns(kr.ConservationWarning, match=rf"<lambda> \(test_projection.py, line \d+: .*{message}"):
        kr.simulate(model, x0, dt=0.05, steps=2, method="suris", order=1, engine="cpu", observe=())


def test_determinants_and_linear_equations_have_gradients() -> None:
    """Against differences; solutions of several systems at once, as the energy of quadratic-field has."""
    x = np.random.default_rng(0).normal(size=72)

    def values(z: Any) -> Any:
        A, B = z[:36].reshape((6, 6)), z[36:].reshape((6, 6))
        rows = algebra.identity(6) + np.stack([A, B]), algebra.identity(6) + 0 * A
        several = algebra.solve(rows[0], (A @ B)[None]), algebra.solve(rows[1], A), algebra.solve(A, B)
        return np.concatenate([np.ravel(y) for y in (invariants.determinant(A), *several)])

    z, h = Traced(x), 1e-6
    differences = np.stack([(values(x + h * e) - values(x - h * e)) / (2 * h) for e in np.eye(72)], -1)
    assert abs(gradient(values(z), z) - differences).max() < 1e-7 * abs(differences).max()
    A = np.random.default_rng(1).integers(-9, 9, (7, 7))
    expected = int(invariants.determinant(A.astype(object)))
    assert abs(invariants.determinant(A.astype(float)) - expected) < 1e-12 * abs(expected)


def test_determinants_of_bodies_beyond_ten_dimensions_are_projected(often: int) -> None:
    """By minors a run of twenty steps needed minutes with n = 12, and it was not projected.

    Determinants in doubles have errors of their own, which a projection gives to all invariants: 50 to 110 last places.
    """
    draw = np.random.default_rng(0)
    X, G = draw.normal(size=(2, 14, 14)) / 14
    top, state = kr.RatiuTop(n=14, a=1, b=2, chi=0.5), {"M": X - X.T, "G": G - G.T}
    run = kr.simulate(top, state, dt=0.05, steps=400, every=often, method="suris")
    table = kr.drift(run)
    assert run.attrs["projection"] == often
    assert table.ulps[table.conserved].max() < 500
    assert abs(run.spectrum - run.spectrum[0]).max() > 1e-3  # not deformed


OWN = {
    "exponential": lambda m, a, *, p: np.exp((a * a).sum(-1)),
    "of NumPy": lambda m, a, *, p: sum(np.array(a)[..., i] ** 2 for i in range(a.shape[-1])),
}


def own_top(n: int, **integrals: Any) -> tuple[Any, Any]:
    """A top with integrals of a user's own, and a state."""
    system, draw = REGISTRY["lagrange-top"], np.random.default_rng(1)
    phi = dataclasses.replace(system.map, conserves=None)
    model = dataclasses.replace(system, integrals={**system.integrals, **integrals}, map=phi)(p=draw.normal(size=n))
    return model, model.state(m=algebra.skew(draw.normal(size=n * (n - 1) // 2), n), a=draw.normal(size=n) / n)


@pytest.mark.parametrize(("n", "engine"), [(3, "cpu"), *[(12, "cpu")] * FULL, (12, "large")])
@pytest.mark.parametrize("what", OWN)
def test_an_integral_that_takes_no_recorded_numbers(what: str, n: int, engine: str) -> None:
    """The run is as it would be without projection, and says so."""
    model, x0 = own_top(n, own=OWN[what])
    options = {"dt": 0.05, "steps": 20, "method": "suris", "order": 1, "engine": engine}
    if (what, n) == ("of NumPy", 3) or (what, n, engine) == ("exponential", 12, "cpu"):  # recorded; on arrays
        assert kr.simulate(model, x0, **options).attrs["projection"] > 0
        return
    with pytest.warns(kr.ConservationWarning, match="does not accept recorded numbers"):
        run = kr.simulate(model, x0, **options)
    assert run.attrs["projection"] == 0
    assert run.drop_attrs().equals(kr.simulate(model, x0, **options, project=False).drop_attrs())


def reduced_top(name: str, integral: Any) -> Any:
    """A Lagrange top by its Lagrangian, for arrays of JAX, with an integral that is to be conserved."""
    from kreisel import reduction as red

    return red.system(
        "own", group=red.SO(3), lagrangian=lambda w, a: -(w * w.T).sum() / 4 - a[2], frame="rest",
        integrals={name: integral}, conserved=[name],
    )()  # fmt: skip


def test_an_integral_that_jax_cannot_differentiate() -> None:
    """A function of NumPy that JAX calls back, which has values and no derivative."""
    import jax

    def called_back(m: Any, a: Any) -> Any:
        scalar = jax.ShapeDtypeStruct((), np.float64)
        return jax.pure_callback(lambda x: np.exp(np.asarray(x)), scalar, a @ a, vmap_method="sequential")

    with pytest.warns(kr.ConservationWarning, match="does not accept arrays of JAX"):
        run = kr.simulate(reduced_top("own", called_back), {"m": (0.1, 0.2, 1.5), "a": (0.6, 0, 0.8)}, dt=0.1, steps=5)
    assert run.attrs["projection"] == 0


def test_a_correction_that_was_not_looked_at_is_none() -> None:
    """n = 12, where K is far longer than the run."""
    model, x0 = own_top(12)
    table = kr.drift(kr.simulate(model, x0, dt=0.05, steps=20, method="suris", order=1, engine="cpu"))
    assert table.conserved.any() and table.correction.isna().all()


def test_a_projection_that_costs_too_much_is_left_out_and_recorded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(projection, "MOST_WORK", 100)
    model, x0 = own_top(12)
    assert kr.simulate(model, x0, dt=0.05, steps=1, method="suris", order=1, engine="cpu").attrs["projection"] == 0


def test_an_integral_of_jax_whose_name_comes_first() -> None:
    """JAX sorts names: targets and values have one order, whatever the names are."""
    model, x0 = reduced_top("about", lambda m, a: m[1, 0]), {"m": (0.1, 0.2, 1.5), "a": (0.6, 0, 0.8)}
    run = kr.simulate(model, x0, dt=0.1, steps=2100, every=100)
    assert run.attrs["projection"] == 1000 and kr.drift(run).correction.max() < 1e3


def test_an_integral_without_a_gradient_leaves_the_state(often: int) -> None:
    """sqrt(<m, m>) at rest: 0/0."""
    system = REGISTRY["lagrange-top"]
    phi = dataclasses.replace(system.map, conserves=("own",))
    own = {"own": lambda m, a, *, p: algebra.sqrt((m * m).sum(-1).sum(-1))}
    model = dataclasses.replace(system, integrals=own, map=phi)(p=(0, 0, 1))
    with warnings.catch_warnings(category=kr.ConservationWarning, action="ignore"):
        run = kr.simulate(model, {"m": (0, 0, 0), "a": (0, 0, -1)}, dt=0.1, steps=300, method="suris", order=1)
    assert run.attrs["projection"] == often and (run.a == (0, 0, -1)).all()


def test_an_integral_that_is_not_defined_everywhere(often: int) -> None:
    """sqrt(1 - <a, a>) is none for the states that give the size of its terms."""
    model, x0 = own_top(12, own=lambda m, a, *, p: algebra.sqrt(1 - (a * a).sum(-1)))
    run = kr.simulate(model, x0, dt=0.05, steps=300, every=100, method="suris", order=1, engine="cpu")
    table = kr.drift(run)
    assert run.attrs["projection"] == often and table.ulps["own"] < 40 and not table.broken.any()


def test_the_entries_of_a_constant_matrix_are_not_nothing() -> None:
    """A step of a user's own that adds up the entries of T = pi m pi, which a kernel of O(n) has not."""
    system = REGISTRY["lagrange-top"]

    def step(m: Any, a: Any, *, p: Any, eps: Any) -> Any:
        m = m + eps * algebra.wedge(a, p)
        T = algebra.coordinates(algebra.project_out(m, p))
        return m, algebra.cayley_act(eps / 2 * (1 + (T * T).sum(-1)) * m, a)

    model = dataclasses.replace(system, map=dataclasses.replace(system.map, step=step, conserves=()))(
        p=np.arange(1.0, 10)
    )
    draw = np.random.default_rng(3)
    x0 = model.state(m=0.1 * algebra.skew(draw.normal(size=36), 9), a=draw.normal(size=9))
    options = {"dt": 0.01, "steps": 50, "method": "suris", "order": 1, "project": False}
    one, other = (kr.simulate(model, x0, **options, **more) for more in ({}, {"engine": "cpu"}))
    assert abs(one.a - other.a).max() < 1e-12

    odd, x0 = own_top(12, own=lambda m, a, *, p: (a * a).sum(-1) * entries_of_T(m, p))
    plan = make_plan(odd, x0, dt=0.05, steps=10, every=1, orientation=None, method="suris", order=1, engine="large")
    assert "own" in plan.engine.projection.labels


def entries_of_T(m: Any, p: Any) -> Any:
    T = algebra.coordinates(algebra.project_out(m, p))
    return (T * T).sum(-1)


@pytest.mark.parametrize(("name", "n"), [("neumann", 11), *[("lagrange-top", 12), ("clebsch", 12)] * FULL])
def test_a_degenerate_lane_takes_nothing_from_the_others(name: str, n: int) -> None:
    draw = exact.float_random(np.random.default_rng(6))
    one = exact.random_model(REGISTRY[name], n, draw)
    state = dict(zip(one.system.space.letters, one.system.space.point(n, draw), strict=True))
    letter = "p" if name == "lagrange-top" else "b"
    flat = {"p": np.eye(n)[0], "b": np.zeros(n)}[letter]
    both = REGISTRY[name](**{**one.params, letter: np.stack([flat, one.params[letter]])})
    options = {"dt": 0.05, "steps": 10, "every": 1, "orientation": None, "method": "suris", "order": 1}
    labels = [make_plan(model, state, **options).engine.projection.labels for model in (one, both)]
    assert labels[0] == labels[1]


def test_a_short_spectrum_is_projected_by_compiled_code() -> None:
    """Neumann's is of O(n): on arrays its projection costs 250 times as much, and K is 10^7."""
    plan = random_plan("neumann", 40, "suris", 1, 1)
    assert isinstance(plan.engine.projection, CompiledProjection) and plan.engine.projection.every <= 50_000


@pytest.mark.parametrize(("n", "engine"), [*[(5, "large")] * FULL, (9, "cpu"), (12, "large")])
def test_orientations_of_large_n_stay_orthogonal(n: int, engine: str, often: int) -> None:
    draw = np.random.default_rng(2)
    top = kr.LagrangeTop(p=draw.normal(size=n))
    x0 = top.state(m=algebra.skew(draw.normal(size=n * (n - 1) // 2), n), a=draw.normal(size=n))
    run = kr.simulate(
        top, x0, dt=0.05, steps=5000, every=5000, method="suris", order=1, orientation=np.eye(n), engine=engine
    )
    g = run["g"].values[-1]
    assert abs(g @ g.T - np.eye(n)).max() < 20 * EPS
    raw = kr.simulate(top, x0, dt=0.05, steps=5000, method="suris", order=1, orientation=np.eye(n), project=False)
    assert abs(raw["g"].values[-1] - g).max() < 1e-9


def test_the_bits_do_not_depend_on_lanes_rows_or_cuts(often: int) -> None:
    many = random_plan("lagrange-top", 3, "baecklund", 2, lanes=11)
    start = many.engine.z.copy()
    rows = np.empty((4, *start.shape))
    many.engine.advance(rows, 175)
    for lane in (0, 7, 10):
        scheme_of_lane = many.scheme
        one = cpu_engine(scheme_of_lane, start[[lane]], project=True) if many.scheme.trajectory else None
        alone = random_lane(many, start, lane)
        each = np.empty((700, 1, start.shape[1]))
        for first, stop in ((0, 1), (1, 130), (130, 700)):
            alone.advance(each[first:stop], 1)
        assert one is None and (each[174::175, 0] == rows[:, lane]).all()
        assert (alone.projection.worst[0] == many.engine.projection.worst[lane]).all()
    cut = random_plan("lagrange-top", 3, "baecklund", 2, lanes=11).engine
    cut.advance(np.empty((1, *start.shape)), 99)
    kept = {name: value.copy() for name, value in cut.snapshot().items()}
    again = random_plan("lagrange-top", 3, "baecklund", 2, lanes=11).engine
    again.restore(kept)
    again.advance(np.empty((1, *start.shape)), 601)
    assert (again.z == many.engine.z).all() and (again.projection.worst == many.engine.projection.worst).all()


def random_lane(plan: Any, start: np.ndarray, lane: int) -> Any:
    """One lane of a plan as a kernel of its own."""
    axes = plan.scheme.axes
    parts: dict[str, Any] = {
        part: {
            k: v[lane] if np.ndim(v) > axes[k] + (part == "stages") else v
            for k, v in getattr(plan.scheme, part).items()
        }
        for part in ("constants", "stages")
    }
    return cpu_engine(dataclasses.replace(plan.scheme, **parts), start[[lane]], project=True)


def test_enough_invariants_are_chosen() -> None:
    """5 of the 11 of the Lagrange top in the flow's variables; of each n the gradients span those of all."""
    plan = scheme(kr.LagrangeTop(p=(0.3, 0.4, 1.2)), "baecklund", 0.1, 2, False)
    _, columns = flat_constants(plan, 1)
    program = program_of(plan, columns)
    assert program is not None and len(program.labels) == 5
    assert program.labels == ("casimir[0]", "casimir[1]", "spectrum[1]", "spectrum[3]", "noether[0]")


@pytest.mark.parametrize("n", [3, 4])
def test_sums_of_logarithms_are_projected_as_products(n: int, monkeypatch: pytest.MonkeyPatch) -> None:
    plan = random_plan("lattice-landau-lifshitz", n, "brickwork", 1)
    projection = plan.engine.projection
    assert isinstance(projection, CompiledProjection) and projection.every < 10**4
    high = projection.targets[0, projection.labels.index("energy_eps"), 0]
    energy = plan.scheme.observe(algebra.restore(plan.engine.z[0], plan.kinds, n), **plan.scheme.constants)[
        "energy_eps"
    ]
    assert abs(abs(np.log(high)) - abs(energy)) < 1e-12 * abs(energy)
    monkeypatch.setattr("kreisel.graph.invariants._without_logarithms", lambda x, varying: x)  # the mutant
    _, columns = flat_constants(plan.scheme, 1)
    with pytest.raises(TooLong):
        program_of(plan.scheme, columns)


def left_out(monkeypatch: pytest.MonkeyPatch, most: float) -> float:
    """The largest weight of the chosen gradients in one that is left out; Clebsch's case, n = 5, at random states."""
    found = random_plan("clebsch", 5, "suris", 1).scheme
    _, columns = flat_constants(found, 1)
    monkeypatch.setattr("kreisel.graph.invariants.MOST_WEIGHT", most)
    some = program_of(found, columns)
    monkeypatch.setattr("kreisel.graph.invariants.MOST_CHOSEN", 0)
    everything = program_of(found, columns)
    assert some is not None and everything is not None and len(some.labels) < len(everything.labels)
    J = gradients(everything, np.random.default_rng(9).normal(size=(50, everything.base)))
    J /= np.sqrt((J * J).sum(-1, keepdims=True))
    chosen = [everything.labels.index(label) for label in some.labels]
    weight = J @ np.linalg.pinv(J[:, chosen], rcond=1e-7)
    return float(np.median(np.sqrt((weight * weight).sum(-1)), 0).max())


def test_what_is_left_out_is_well_determined(monkeypatch: pytest.MonkeyPatch) -> None:
    """By few digits only, an invariant walks: that of n = 5 by 243 ulp in 1e8 steps."""
    assert left_out(monkeypatch, 10.0) < 20
    monkeypatch.undo()
    assert left_out(monkeypatch, np.inf) > 50  # the mutant


def test_nothing_to_conserve_costs_nothing() -> None:
    heavy = kr.HeavyTop(J=(1.0, 2.0, 2.5), A=(0.1, 0.2, 1.0))
    run = kr.simulate(heavy, {"M": (0.1, 0.2, 1.5), "P": (0.6, 0, 0.8)}, dt=0.1, steps=10, method="dop853")
    assert run.attrs["projection"] == 0 and kr.drift(run).correction.isna().all()


def test_the_correction_is_stored_and_shown(often: int, top: Any, x0: Any, tmp_path: Path) -> None:
    run = kr.simulate(top, x0, dt=0.1, steps=1000, every=7, path=tmp_path / "run.zarr")
    table = kr.drift(run)
    assert run.attrs["projection"] == often
    assert (table.correction[table.conserved].dropna() > 0).all() and table.correction.max() < 100
    memory = kr.simulate(top, x0, dt=0.1, steps=1000, every=7)
    assert sorted(table.index) == sorted(kr.drift(memory).index)
    assert kr.drift(memory).loc[table.index].equals(table)
    assert check_archive(tmp_path / "run.zarr")[1] == []
    longer = kr.resume(tmp_path / "run.zarr", extend=1400)
    whole = kr.simulate(top, x0, dt=0.1, steps=1400, every=7)
    assert longer.equals(whole)
    assert kr.drift(longer).loc[table.index].equals(kr.drift(whole).loc[table.index])


def test_the_interval_is_a_small_share(top: Any) -> None:
    assert project.interval(1, 10) == 10
    assert project.interval(12, 10) == 125
    assert project.interval(1200, 50) == 2500
    assert all(10**9 % k == 0 for k in project.INTERVALS if k < 10**5)


@pytest.mark.parametrize("name", ["euler-top", *["lagrange-top"] * FULL])
def test_a_lane_at_rest_stays_there(name: str, often: int) -> None:
    """Without momentum, and for the Euler top without anything, beside a lane that moves; n = 11."""
    draw = exact.float_random(np.random.default_rng(4))
    model = exact.random_model(REGISTRY[name], 11, draw)
    letters = model.system.space.letters
    state = dict(zip(letters, model.system.space.point(11, draw), strict=True))
    still = {k: 0 * v if k in "Mm" else v for k, v in state.items()}
    both = {k: np.stack([still[k], state[k]]) for k in letters}
    run = kr.simulate(model, both, dt=0.02, steps=300, every=100, method=default_method(model))
    assert run.attrs["projection"] == often and not kr.drift(run).broken.any()
    assert all(np.isfinite(run[k]).all() for k in letters)
    if name != "lagrange-top":  # gravity moves it
        assert all((run[k].isel(lane=0) == still[k]).all() for k in letters)


BINDING = [("heavy-top", "kahan"), ("euler-top", "midpoint"), ("euler-top", "kahan"), ("heavy-top", "variational")]


@pytest.mark.parametrize(("name", "method"), [*BINDING, ("lagrange-top", "suris"), ("euler-top", "veselov")])
def test_an_orientation_is_bound_where_the_map_binds_it(name: str, method: str) -> None:
    """What a projection puts back stays by the map itself; kahan and midpoint bind to their order alone."""
    draw = exact.float_random(np.random.default_rng(8))
    model = exact.random_model(REGISTRY[name], 3, draw)
    x0 = dict(zip(model.system.space.letters, model.system.space.point(3, draw), strict=True))
    made = scheme(model, method, 0.1, 2, True)
    run = kr.simulate(model, x0, dt=0.1, steps=100, method=method, order=2, orientation=(1, 0, 0, 0), project=False)
    letters = model.system.space.letters
    parts = [
        algebra.hat(run[k].values) if run[k].values.shape[-1] == 3 and k in "Mm" else run[k].values for k in letters
    ]
    rows = [
        (*(p[t] for p in parts), run.g.values[t], *[0.0] * (len(made.components) > len(parts) + 1)) for t in (0, -1)
    ]

    def change(held: Any) -> float:
        first, last = (np.concatenate([np.ravel(v) for v in held(row)]) for row in rows)
        return float(np.abs(last - first).max())

    assert made.held is not None and change(made.held) < 1e-12
    bound = held_by_orientation(model, made.components)
    assert bound is not None and (change(bound) > 1e-7) == (method in ("kahan", "midpoint"))
