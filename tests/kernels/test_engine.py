"""Kernels equal the definition; one lane equals a single run; the recorded arithmetic is exact in its foldings."""

from __future__ import annotations

import math
import warnings
from dataclasses import replace

import numpy as np
import pytest

import kreisel as kr
from kreisel import algebra
from kreisel.graph import recording
from kreisel.graph.graph import TooLong
from kreisel.graph.recording import Recording, flat_constants
from kreisel.kernels import cpu, layout
from kreisel.kernels.cpu import compiled_rate
from kreisel.lab import exact
from kreisel.method import Scheme, scheme
from kreisel.record.contract import Frame
from kreisel.record.model import Model
from kreisel.runs.planning import make_plan
from kreisel.system import REGISTRY
from sizes import costly
from support import cpu_engine

MAPS = {name: system.map for name, system in REGISTRY.items() if system.map is not None}
BODIES = {name for name, system in REGISTRY.items() if system.velocity is not None}  # what has an orientation
ON_ARRAYS = ("clebsch", "lattice-landau-lifshitz", "spin-chain")  # of n = 11, where definitions run on arrays: a few
FLOPS_TOLERANCE = 2.0**12 * float(np.finfo(float).eps)


def random_start(name: str, n: int, seed: int = 0) -> tuple[Model, tuple[np.ndarray, ...]]:
    draw = exact.float_random(np.random.default_rng([seed, n]))
    model = exact.random_model(REGISTRY[name], n, draw)
    return model, REGISTRY[name].space.point(n, draw)


def own_method(name: str) -> tuple[str, int]:
    """The method that is the system's map itself."""
    if name not in BODIES:
        return "brickwork", 1
    return ("veselov", 2) if MAPS[name].symmetric else ("suris", 1)


def first_scheme(model: Model, oriented: bool) -> Scheme:
    """The system's map itself."""
    method, order = own_method(model.system.name)
    return scheme(model, method, 0.05, order, oriented)


@pytest.mark.parametrize(
    ("name", "n", "oriented"),
    [
        (name, n, oriented)
        for name in MAPS
        for n, oriented in ((3, False), (3, True), (4, True), (5, False), (11, True))
        if n < 5 or (name in ON_ARRAYS if n == 11 else not costly(name))
        if name in BODIES or not oriented
    ],
)
def test_kernel_equals_definition(name: str, n: int, oriented: bool) -> None:
    model, x0 = random_start(name, n)
    if oriented:
        x0 += (np.array([1.0, 0, 0, 0]) if n == 3 else np.eye(n),)
    plan = first_scheme(model, oriented)
    kinds = [kind for _, kind in plan.components]
    kernel = cpu_engine(plan, algebra.flatten(plan.prepare(x0), kinds)[None])
    out = np.empty((4, 1, kernel.z.shape[1]))
    kernel.advance(out, 2)
    z = plan.prepare(x0)
    for row in out:
        for _ in range(2):
            z = plan.advance(*z)
        flat = algebra.flatten(z, kinds)
        assert abs(row[0] - flat).max() < FLOPS_TOLERANCE * (1 + abs(flat).max())


@pytest.mark.parametrize(("name", "n"), [(s, n) for s in REGISTRY for n in (3, 4, 11) if n < 11 or s in ON_ARRAYS])
def test_compiled_rate_equals_flow(name: str, n: int) -> None:
    model, x0 = random_start(name, n)
    plan = scheme(model, "dop853", 0.1, None, name in BODIES)
    kinds = [kind for _, kind in plan.components]
    turns = name in BODIES
    g = exact.random_rotation(n, exact.float_random(np.random.default_rng(1)))
    state = (*x0, *[algebra.unit_quaternion(g) if n == 3 else g] * turns)
    rate = compiled_rate(plan)(0.0, algebra.flatten(state, kinds), flat_constants(plan, 1)[0][0])
    flow = algebra.flatten(plan.motion.rate(*state, **plan.constants), kinds)
    assert abs(rate - flow).max() < FLOPS_TOLERANCE * (1 + abs(flow).max())
    if not turns:
        return
    omega = model.call(model.system.velocity, *x0)
    turn = omega @ g if model.system.frame is Frame.REST else g @ omega
    if n > 3:
        assert abs(flow[-n * n :] - turn.ravel()).max() == 0
        return
    ahead, behind = (algebra.rotation_matrix(algebra.unit(state[-1] + h * flow[-4:])) for h in (1e-5, -1e-5))
    assert abs((ahead - behind) / 2e-5 - turn).max() < 1e-7 * (1 + abs(turn).max())


def one_of_each(
    name: str, method: str, order: int, n: int, lanes: int
) -> tuple[Scheme, np.ndarray, Scheme, np.ndarray]:
    """An ensemble with parameters and states of its own in each lane, many numbers special; its last lane."""
    draw = np.random.default_rng([5, n])
    models, states = zip(*(random_start(name, n, seed) for seed in range(lanes)), strict=True)
    params = {k: np.stack([model.params[k] for model in models]) for k in models[0].params}
    free = {p.letter for p in REGISTRY[name].parameters if not (p.distinct or p.positive)} - {"alpha"}
    for k, value in params.items():
        if k in free and value.ndim == 2:
            params[k] = np.where(draw.random(value.shape) < 0.3, 1.0, value)
    turned = tuple(np.stack([np.eye(1, 4)[0] if n == 3 else np.eye(n)] * k) for k in (lanes, 1))
    starts = [
        tuple(np.stack(parts) for parts in zip(*states[at], strict=True)) for at in (slice(None), slice(-1, None))
    ]
    out = []
    for start, g, at in zip(starts, turned, (slice(None), slice(-1, None)), strict=True):
        model = REGISTRY[name](**{k: v[at] for k, v in params.items()})
        start = (*start, *[g] * (name in BODIES))
        plan = scheme(model, method, 0.05, order, name in BODIES).on(start)
        kinds = [kind for _, kind in plan.components]
        out += [plan, algebra.flatten(plan.prepare(start), kinds)]
    return tuple(out)


@pytest.mark.parametrize(
    ("name", "method", "order", "n"),
    [
        *((name, *own_method(name), 3) for name, phi in MAPS.items() if phi.turn is None or phi.trajectory is not None),
        ("lagrange-top", "suris", 1, 4),
        ("clebsch", "baecklund", 6, 3),
    ],
)
def test_lane_equals_single_run_bitwise(name: str, method: str, order: int, n: int) -> None:
    """Ragged blocks, shares of threads, parameters that are folded into the code of the single run alone."""
    lanes = 71
    plan, rows, single, row = one_of_each(name, method, order, n, lanes)
    together, alone = np.empty((3, *rows.shape)), np.empty((3, *row.shape))
    kernel = cpu_engine(plan, rows)
    kernel.advance(together, 7)
    cpu_engine(single, row).advance(alone, 7)
    assert np.isfinite(alone).all()
    assert (together[:, -1] == alone[:, 0]).all()
    threaded = np.empty_like(together)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(layout, "LEAST_WORK", 1)
        other = cpu_engine(plan, rows)
        other.advance(threaded, 7)
    assert (threaded == together).all()
    assert (other.z == together[-1]).all()


def test_a_recorded_loop_is_the_same_in_every_lane() -> None:
    """Loops stop where each lane has converged: such kernels take lane by lane."""
    plan, rows, single, row = one_of_each("kirchhoff", "variational", 2, 4, 5)
    together, alone = np.empty((2, *rows.shape)), np.empty((2, *row.shape))
    cpu_engine(plan, rows).advance(together, 3)
    cpu_engine(single, row).advance(alone, 3)
    assert (together[:, -1] == alone[:, 0]).all()


def test_zero_lanes_are_no_work() -> None:
    model, x0 = random_start("lagrange-top", 3)
    plan = scheme(model, "suris", 0.1, 1, False)
    row = algebra.flatten(x0, ["skew", "vector"])
    kernel = cpu_engine(plan, row[None][:0])
    kernel.advance(np.empty((2, 0, 6)), 3)
    assert kernel.z.shape == (0, 6)


@pytest.mark.parametrize(("lanes", "many"), [(1, 2), (2, 2), (71, 2), (1000, 3), (64 * 64, 2)])
def test_shares_are_all_the_lanes_once(lanes: int, many: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("KREISEL_NUM_THREADS", str(many))
    shares = list(layout.shares(lanes, many * layout.LEAST_WORK))
    assert [lane for first, last in shares for lane in range(first, last)] == list(range(lanes))
    assert len(shares) >= min(many, lanes)
    assert len(list(layout.shares(lanes, 2 * layout.LEAST_WORK - 1))) == 1


def test_folding_leaves_the_bits(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every value of a record with 0, 1 and -1 put in is that of the record without."""
    _, _, single, row = one_of_each("lagrange-top-moving", "suris", 1, 3, 1)
    special = replace(
        single, constants={**single.constants, "A": np.array([[0.0, -1.0, 0.0]]), "alpha": np.array([1.0])}
    )
    short, long = cpu_engine(special, row), None
    monkeypatch.setattr("kreisel.graph.recording.special_constants", lambda constants: {})
    monkeypatch.setattr("kreisel.kernels.cpu.special_constants", lambda constants: {0: math.nan})
    long = cpu_engine(special, row)
    assert short.code.steps.kernel.size < long.code.steps.kernel.size
    one, two = np.empty((20, *row.shape)), np.empty((20, *row.shape))
    short.advance(one, 1)
    long.advance(two, 1)
    assert (one == two).all()


def test_stages_are_one_step_each() -> None:
    """A step of three stages is three steps with the constants of each, also one lane beside another."""
    model, x0 = random_start("lagrange-top", 3)
    plan = scheme(model, "suris", 0.1, 1, False)
    fractions = np.array([[0.1, 0.25, -0.05], [0.2, 0.05, 0.3]])
    fixed = {k: v for k, v in plan.constants.items() if k != "eps"}
    staged = replace(plan, constants=fixed, stages={"eps": fractions})
    row = algebra.flatten(x0, ["skew", "vector"])
    kernel, out = cpu_engine(staged, np.stack([row, row])), np.empty((1, 2, 6))
    kernel.advance(out, 2)
    for lane, steps in enumerate(fractions):
        z = x0
        for eps in (*steps, *steps):
            z = plan.motion.step(*z, **{**plan.constants, "eps": eps})
        assert abs(out[0, lane] - algebra.flatten(z, ["skew", "vector"])).max() < FLOPS_TOLERANCE
    one = replace(plan, constants=fixed, stages={"eps": fractions[0]})
    z = one.advance(*x0)
    for eps in fractions[0][::-1]:
        z = model.call(model.map.inverse, *z, eps=eps)
    assert abs(algebra.flatten(z, ["skew", "vector"]) - row).max() < FLOPS_TOLERANCE


@pytest.mark.parametrize(
    ("name", "n", "oriented"),
    [*((name, 3, True) for name in ("lagrange-top", "lagrange-top-moving", "clebsch")), ("lagrange-top", 4, False)],
)
def test_compiled_observe_equals_the_definition(name: str, n: int, oriented: bool) -> None:
    """Every variable of a run, two lanes with parameters of their own, against NumPy."""
    models, states = zip(*(random_start(name, n, seed) for seed in range(2)), strict=True)
    model = REGISTRY[name](**{k: np.stack([m.params[k] for m in models]) for k in models[0].params})
    start = dict(zip(REGISTRY[name].space.letters, map(np.stack, zip(*states, strict=True)), strict=True))
    g = (-0.5, 0.5, -0.5, 0.5) if oriented else None
    plan = make_plan(model, start, dt=0.1, steps=9, every=1, method="suris", order=2, orientation=g)
    rows = np.empty((9, *plan.engine.z.shape))
    plan.engine.advance(rows, 1)
    compiled = cpu.row_function(plan.scheme, plan.variables, 2, ("observe", None))
    assert compiled is not None
    found, wanted = compiled.named(rows), plan.variables(algebra.restore(rows, plan.kinds, n))
    assert set(found) == set(wanted) == set(plan.scheme.outcomes)
    for variable, value in wanted.items():
        assert found[variable].shape == (9, 2, *np.shape(value)[2:])
        assert abs(found[variable] - value).max() < FLOPS_TOLERANCE * (1 + abs(value).max())
    assert oriented == ("g" in found)
    assert not oriented or (found["g"][0, :, 0] < 0).all()  # of the two signs the one that goes on


def test_what_is_too_long_to_compile_is_observed_by_numpy(monkeypatch: pytest.MonkeyPatch) -> None:
    model, x0 = random_start("lagrange-top", 3)
    start = dict(zip("ma", x0, strict=True))
    plan = make_plan(model, start, dt=0.1, steps=9, every=1, method="suris", order=2, orientation=None)
    monkeypatch.setattr(cpu, "OBSERVED_LINES", 10)
    assert cpu.row_function(plan.scheme, plan.variables, 1, ("observe", None)) is None
    assert set(plan.observe(np.zeros((2, 1, 6)) + plan.engine.z)) == set(plan.scheme.outcomes)


def test_rows_within_the_first_step_of_dop853() -> None:
    """SciPy's solver interpolates from the start that it was given: the rows must not be written there."""
    top, x0 = kr.LagrangeTop(p=(0, 0, 1)), {"m": (0.1, 0.2, 1.5), "a": (0.6, 0, 0.8)}
    fine = kr.simulate(top, x0, dt=2.0**-12, steps=512, method="dop853")
    flow = kr.at(top, x0, fine.time.values)
    assert abs(fine.a - flow.a).max() < 1e-8
    assert abs(fine.m - flow.m).max() < 1e-8
    coarse = kr.simulate(top, x0, dt=2.0**-6, steps=8, method="dop853")
    assert (coarse.a.values == fine.a.values[::64]).all()


@pytest.mark.parametrize("method", ["dop853", "variational", "baecklund", "suris", "exact"])
def test_parameters_that_vary_by_lane(method: str) -> None:
    """Lane i is the single run with its parameters."""
    x0 = {"M": (0.1, 0.2, 1.5), "P": (0.6, 0, 0.8)}
    alpha = [0.5, 0.8, 1.3]
    options = {"dt": 0.1, "steps": 20, "method": method}
    lanes = kr.simulate(kr.LagrangeTopMoving(A=(0, 0, 1), alpha=alpha), x0, **options)
    for lane, value in enumerate(alpha):
        one = kr.simulate(kr.LagrangeTopMoving(A=(0, 0, 1), alpha=value), x0, **options)
        np.testing.assert_allclose(lanes.M.values[:, lane], one.M.values, atol=1e-14)


def test_a_step_beyond_all_bounds_ends_with_an_error() -> None:
    """Its constants are infinite, for which a kernel has no name."""
    top = kr.LagrangeTopSU2Moving(A=(-0.48, -1.24, 0.41), alpha=0.45)
    x0 = top.state(M=(-0.86, 0.52, -1.16), P=(1.06, -0.99, -1.21))
    for n in (1, 2):
        with warnings.catch_warnings(), pytest.raises(kr.RunError, match="no longer finite"):
            warnings.simplefilter("ignore")
            kr.simulate(top, x0 if n == 1 else {k: np.stack([v, v]) for k, v in x0.items()}, dt=1e300, steps=2)


def test_steps_of_bodies_in_space_are_written_out_however_long(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recording, "MOST", 20)  # a potential of 2000 points has more than the limit
    body, beyond = (
        scheme(kr.LagrangeTop(p=np.eye(n)[-1], alpha=1.0), "suris", 0.01, 1, False, kept=False) for n in (3, 4)
    )
    assert Recording(body, *flat_constants(body, 1)).length > recording.MOST
    with pytest.raises(TooLong):
        Recording(beyond, *flat_constants(beyond, 1))
