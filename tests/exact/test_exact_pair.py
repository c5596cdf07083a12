"""method="exact" for Clebsch's case and Neumann's system: against Taylor series, its own steps, and mutants."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import kreisel as kr
from kreisel import algebra
from kreisel.method import exact, scheme
from kreisel.runs.planning import make_plan
from sizes import FULL
from taylor import taylor_solution

B = (0.3, 0.7, 1.9)


def bodies(seed: int) -> list[tuple[Any, dict[str, np.ndarray]]]:
    draw = np.random.default_rng(seed)
    x, q = draw.normal(size=(2, 3))
    x = x / np.linalg.norm(x)
    body, particle = kr.Clebsch(b=np.sort(draw.normal(size=3))), kr.Neumann(b=np.sort(draw.normal(size=3)))
    return [
        (body, {"M": draw.normal(size=3), "P": draw.normal(size=3)}),
        (particle, {"x": x, "q": q - x * (x @ q)}),
    ]


def truth(model: Any, state: dict[str, np.ndarray], time: float, digits: int = 24) -> np.ndarray:
    """The state at that time by Taylor series, axial for n = 3."""
    b = np.broadcast_to(model.params["b"], 3)
    if "M" in state:
        X, v = taylor_solution(
            algebra.hat(np.asarray(state["M"], float)), np.asarray(state["P"]), b, time, clebsch=True, digits=digits
        )
        return np.concatenate([algebra.axial(X.astype(float)), v.astype(float)])
    x, q = state["x"], state["q"]
    X, v = taylor_solution(algebra.wedge(x, q), x, b, time, clebsch=True)
    return np.concatenate([v.astype(float), -(X @ v).astype(float)])


def off(run: Any, want: np.ndarray) -> float:
    letters = [name for name in ("M", "P", "x", "q") if name in run]
    return float(abs(np.concatenate([run[k].values[-1] for k in letters]) - want).max() / abs(want).max())


@pytest.mark.parametrize("seed", range(5 if FULL else 2))
@pytest.mark.parametrize(("dt", "steps"), [(0.125, 8), (1.0, 10), (7.0, 2)])
def test_against_taylor(seed: int, dt: float, steps: int) -> None:
    for model, state in bodies(seed):
        run = kr.simulate(model, state, dt=dt, steps=steps, every=steps, method="exact")
        error = off(run, truth(model, state, dt * steps))
        assert error < 3e-15 * max(1, steps * dt) or error < 16 * np.finfo(float).eps * grown(model, state, dt * steps)


@pytest.mark.parametrize(
    ("M", "P"),
    [
        ((0.3, -0.5, 0.8), (6e-10, -2e-10, 4e-10)),
        ((0.3, -0.5, 0.8), (6e-21, -2e-21, 4e-21)),
        ((3, -5, 8), (6e-4, -2e-4, 4e-4)),
        ((3e-14, -5e-14, 8e-14), (6e-14, -2e-14, 1.0)),  # almost at rest
        ((3e-13, -5e-13, 1.3), (6e-13, -2e-13, 1.0)),
    ],
)
def test_a_momentum_far_smaller_than_the_other_has_its_digits(M: Any, P: Any) -> None:
    model, state = kr.Clebsch(b=B), {"M": np.array(M), "P": np.array(P)}
    run = kr.simulate(model, state, dt=0.3, steps=3, every=3, method="exact", observe=())
    want = truth(model, state, 3 * 0.3, digits=60)
    for got, part in ((run.M.values[-1], want[:3]), (run.P.values[-1], want[3:])):
        assert abs(got - part).max() < 3e-15 * abs(part).max()


def grown(model: Any, state: dict[str, np.ndarray], time: float) -> float:
    """What a small change of the state has grown by at that time: 530 for one of the bodies."""
    want, most, small = truth(model, state, time), 0.0, 1e-9
    for name, j in ((name, j) for name in state for j in range(3)):
        other = {k: np.array(v, dtype=float) for k, v in state.items()}
        other[name][j] += small
        if "x" in other:
            other["x"] /= np.linalg.norm(other["x"])
            other["q"] -= other["x"] * (other["x"] @ other["q"])
        most = max(most, float(abs(truth(model, other, time) - want).max()) / small)
    return most


@pytest.mark.parametrize(
    ("M", "P", "b"),
    [
        ((0, 0, 1), (0, 0, 1), B),  # at rest but for a turn
        ((1e-6, 0, 1), (0, 1e-6, 1), B),
        ((0, 0, 0), (0.6, 0, 0.8), B),
        ((0.4, 0.2, 0.1), (0.6, 0, 0.8), (1.1, 1.1, 2.3)),  # symmetric
        ((0.4, 0.2, 0.1), (0.6, 0, 0.8), (1.1, 1.1, 1.1)),  # free
        ((3, 5, 8), (0.6, 0, 0.8), B),
        ((1e-3, 2e-3, 5e-4), (0.06, 0, 0.08), B),
    ],
)
def test_special_motions(M: tuple[float, ...], P: tuple[float, ...], b: tuple[float, ...]) -> None:
    model, state = kr.Clebsch(b=b), {"M": np.array(M, float), "P": np.array(P, float)}
    run = kr.simulate(model, state, dt=0.75, steps=20, every=20, method="exact")
    assert off(run, truth(model, state, 15.0)) < 1e-13


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("lanes", [0, 2])
def test_body_of_revolution(seed: int, lanes: int) -> None:
    """Against Clebsch's case by Taylor series over a1 t, turned about the axis; the orientation against order 24."""
    draw = np.random.default_rng([7, seed])
    a1, a3, c1, c3 = draw.uniform(0.3, 2, 4)
    state, time = {"M": draw.normal(size=3), "P": draw.normal(size=3)}, 4.5
    like = kr.Clebsch(b=(0, 0, (c1 - c3) / a1))
    angle = (a1 - a3) * state["M"][2] * time
    c, s = np.cos(angle), np.sin(angle)
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    want = (truth(like, state, a1 * time).reshape(2, 3) @ turn.T).ravel()
    body = kr.KirchhoffRevolution(a1=[a1, 2 * a1][:lanes] or a1, a3=a3, c1=c1, c3=c3)
    options = {"dt": 0.75, "steps": 6, "every": 6, "orientation": (1, 0, 0, 0), "progress": False}
    run, maps = (
        kr.simulate(body, state, **options, **method)
        for method in ({"method": "exact"}, {"method": "baecklund", "order": 24})
    )
    if lanes:
        run, maps = run.isel(lane=0), maps.isel(lane=0)
    assert off(run, want) < 1e-14
    assert off(maps, want) < 1e-12
    turns = [algebra.rotation_matrix(r.g.values[-1]) for r in (run, maps)]
    assert abs(turns[0] - turns[1]).max() < 1e-12
    P, p = (np.append(r, 0) for r in (run.P.values[-1], state["P"]))
    assert abs(turns[0] @ P[:3] - p[:3]).max() < 1e-13 * abs(p).max()


def growth(steps: int, orientation: Any = None) -> float:
    """Between steps of two lengths to the same time; each has its own rounding and its own mu."""
    body = kr.Clebsch(b=B)
    state = {"M": np.array([0.1, 0.2, 1.5]), "P": np.array([0.6, 0, 0.8])}
    ends = []
    for dt, count in ((0.25, steps), (0.3125, steps * 4 // 5)):
        plan = make_plan(
            body, state, dt=dt, steps=count, every=count, method="exact", order=None, orientation=orientation
        )
        out = np.empty((1, *plan.engine.z.shape))
        plan.engine.advance(out, count)
        ends.append(plan.observe(out))
    return float(max(abs(ends[0][k] - ends[1][k]).max() for k in ("M", "P", "g") if k in ends[0]))


@pytest.mark.parametrize("orientation", [None, (1, 0, 0, 0)])
def test_errors_grow_like_the_steps(orientation: Any) -> None:
    assert growth(10**6, orientation) < 1e-16 * 10**6


@pytest.mark.parametrize("which", [0, 1])
@pytest.mark.parametrize(("dt", "steps"), [(0.25, 24), (1.0, 6), (6.0, 1)])
def test_orientation(which: int, dt: float, steps: int) -> None:
    """Against order 24 of the maps with short steps, whose orders in g are measured, and against a solver."""
    start = np.array([0.5, -0.1, 0.7, 0.5])
    start /= np.linalg.norm(start)
    model, state = bodies(5)[which]
    turns = [
        algebra.rotation_matrix(kr.simulate(model, state, orientation=start, every=n, steps=n, **options).g.values[-1])
        for n, options in (
            (steps, {"dt": dt, "method": "exact"}),
            (48, {"dt": 0.125, "method": "baecklund", "order": 24}),
            (48, {"dt": 0.125, "method": "dop853"}),
        )
    ]
    assert abs(turns[0] - turns[1]).max() < 1e-13
    assert abs(turns[0] - turns[2]).max() < 1e-7


def test_a_wrong_turn_in_space_is_caught() -> None:
    """The block of M that does not touch P, left out of the reference."""
    right, state = bodies(5)[0]
    maps = replace(right.system.baecklund, block=lambda M, P: 0 * M)
    model = replace(right.system, baecklund=maps)(b=right.params["b"])
    turns = [
        algebra.rotation_matrix(kr.simulate(model, state, orientation=(1, 0, 0, 0), every=8, steps=8, **o).g.values[-1])
        for o in ({"dt": 0.5, "method": "exact"}, {"dt": 0.5, "method": "dop853"})
    ]
    assert abs(turns[0] - turns[1]).max() > 1e-2


def test_a_wrong_parameter_is_caught(monkeypatch: pytest.MonkeyPatch) -> None:
    model, state = bodies(1)[0]
    want = truth(model, state, 10.0)
    parameter = exact.parameter
    monkeypatch.setattr(exact, "parameter", lambda *a: (lambda n, mu: (n, mu * (1 + 1e-12)))(*parameter(*a)))
    run = kr.simulate(model, state, dt=1.0, steps=10, every=10, method="exact")
    assert off(run, want) > 1e-13


@pytest.mark.parametrize("which", [0, 1])
def test_kernel_equals_definition_and_lanes_equal_single_runs(which: int) -> None:
    model, state = bodies(3)[which]
    other = bodies(4)[which][1]
    both = {k: np.stack([v, other[k]]) for k, v in state.items()}
    run = kr.simulate(model, both, dt=0.25, steps=5, method="exact")
    for lane, start in enumerate((state, other)):
        alone = kr.simulate(model, start, dt=0.25, steps=5, method="exact")
        for k in start:
            assert abs(run[k].values[:, lane] - alone[k].values).max() < 1e-14
    parts = model.state(**state)
    z = tuple(parts[k] for k in model.system.space.letters)
    plan = scheme(model, "exact", 0.25, None, False).on(z)
    z = plan.prepare(z)
    for _ in range(5):
        z = plan.advance(*z)
    seen = plan.observe(tuple(x[None, None] for x in z))
    for k in state:
        got = algebra.axial(seen[k]) if k == "M" else seen[k]
        assert abs(got[0, 0] - alone_values(model, state, k)).max() < 1e-13


def alone_values(model: Any, state: dict[str, np.ndarray], name: str) -> np.ndarray:
    return kr.simulate(model, state, dt=0.25, steps=5, method="exact")[name].values[-1]


def test_integrals_stay_and_runs_go_on(tmp_path: Any) -> None:
    model, state = bodies(2)[1]
    path = tmp_path / "neumann.zarr"
    kr.simulate(model, state, dt=0.5, steps=1000, every=10, method="exact", path=path)
    whole = kr.simulate(model, state, dt=0.5, steps=2000, every=10, method="exact")
    longer = kr.resume(path, extend=2000)
    assert (longer.x.values == whole.x.values).all()
    table = kr.drift(whole)
    assert table.conserved.all()
    assert (table.max_change < 1e-13).all()


def test_parameters_with_lanes() -> None:
    b = np.array([B, (-0.5, 0.2, 1.1)])
    state = {"M": np.array([0.1, 0.2, 1.5]), "P": np.array([0.6, 0, 0.8])}
    run = kr.simulate(kr.Clebsch(b=b), state, dt=0.5, steps=20, every=20, method="exact")
    for lane in (0, 1):
        model = kr.Clebsch(b=b[lane])
        got = np.concatenate([run[k].values[-1, lane] for k in ("M", "P")])
        assert abs(got - truth(model, state, 10.0)).max() < 1e-13


def test_what_there_is_not() -> None:
    body = kr.Clebsch(b=B)
    with pytest.raises(kr.InputError, match="got clebsch with n = 6"):
        six = kr.Clebsch(b=(1, 2, 3, 4, 5, 6))
        kr.simulate(six, {"M": np.zeros((6, 6)), "P": (1, 0, 0, 0, 0, 0)}, dt=0.5, steps=1, method="exact")
    with pytest.raises(kr.InputError, match=r"a field P that is not zero, got 0.*suris.*exact as kr.ClebschGeneral"):
        kr.simulate(body, {"M": (0, 0, 1), "P": (0, 0, 0)}, dt=0.5, steps=1, method="exact")


def test_the_general_case_steps_a_body_without_a_field() -> None:
    """M is constant, and the body rotates about it by |M| in a unit of time."""
    body, steady = kr.ClebschGeneral(a=B, b=B), {"M": (0.6, 0, 0.8), "P": (0, 0, 0)}
    run = kr.simulate(body, steady, orientation=(1, 0, 0, 0), dt=0.5, steps=4, method="exact")
    assert abs(run.M.values[-1] - (0.6, 0, 0.8)).max() < 1e-14
    assert abs(run.g.values[-1] - (np.cos(1), 0.6 * np.sin(1), 0, 0.8 * np.sin(1))).max() < 1e-14


def test_neumann_stays_on_its_leaf() -> None:
    """<M, x> = 0 of the image is projected too: else the two runs are apart by 1e-10 and more."""
    ends = []
    for dt in (0.25, 0.5):
        count = int(1e4 / dt)
        run = kr.simulate(
            kr.Neumann(b=(0.3, 0.7, 1.9)),
            {"x": (0.6, 0, 0.8), "q": (0.3, 0.5, -0.225)},
            dt=dt,
            steps=count,
            every=count // 10,
            method="exact",
            progress=False,
        )
        assert abs(run.casimir[:, 1]).max() < 1e-13
        ends.append(np.concatenate([run.x.values[-1], run.q.values[-1]]))
    assert abs(ends[0] - ends[1]).max() < 3e-11


@pytest.mark.parametrize(
    ("method", "said"), [("exact", "a field P that is not zero in lane 3"), ("baecklund", r"in lane 3.* a field")]
)
def test_a_lane_without_a_field_is_named(method: str, said: str) -> None:
    body, P = kr.Clebsch(b=B), np.tile((0.6, 0, 0.8), (5, 1))
    P[3] = 0
    with pytest.raises(kr.InputError, match=said):
        kr.simulate(body, {"M": np.tile((0.1, 0.2, 0.3), (5, 1)), "P": P}, dt=0.1, steps=2, method=method)
    with pytest.raises(kr.InputError) as error:
        kr.simulate(body, {"M": (0.1, 0.2, 0.3), "P": (0, 0, 0)}, dt=0.1, steps=2, method=method)
    assert " lane" not in str(error.value)
