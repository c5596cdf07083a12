"""kr.propagator and observe=: the bits of a run, arrays in and out, threads, errors."""

from __future__ import annotations

import gc
import os
import sys
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import kreisel as kr
from kreisel.algebra import reuse
from kreisel.lab import exact
from kreisel.sweeps.sweep import check_archive
from kreisel.system import REGISTRY
from sizes import FULL

CASES = [
    ("lagrange-top", 3, "suris", 1),
    ("lagrange-top", 3, "suris", 2),
    ("lagrange-top", 3, "baecklund", 2),
    ("lagrange-top", 4, "suris", 1),
    ("lagrange-top", 10, "suris", 1),  # engine="large" in a run
    ("lagrange-top-moving", 3, "suris", 1),
    ("clebsch", 3, "baecklund", 4),
    ("euler-top", 3, "veselov", 2),
    ("heavy-top", 3, "variational", 2),
    ("heavy-top", 3, "kahan", 4),
    ("heavy-top", 3, "dop853", None),
    ("neumann", 3, "suris", 1),
    ("lagrange-top", 3, "exact", None),
    ("euler-top", 3, "exact", None),
    ("clebsch", 3, "exact", None),
]
WITHOUT = CASES[2:3] + CASES[4:5] + CASES[10:11] + CASES[12:14]  # each kind of engine, without an orientation too


def case(name: str, n: int, seed: int = 1) -> tuple[Any, dict[str, np.ndarray]]:
    draw = exact.float_random(np.random.default_rng(seed))
    model = exact.random_model(REGISTRY[name], n, draw)
    state = model.system.space.point(n, draw)
    return model, dict(zip(model.system.space.letters, state, strict=True))


def flat(found: Any) -> np.ndarray:
    return np.concatenate([np.ravel(v) for v in found.values()])


@pytest.mark.parametrize(
    ("name", "n", "method", "order", "oriented"),
    [(*case, oriented) for case in CASES for oriented in (True, False) if oriented or FULL or case in WITHOUT],
)
def test_steps_are_those_of_a_run(name: str, n: int, method: str, order: int | None, oriented: bool) -> None:
    model, state = case(name, n)
    dt = 0.02
    p = kr.propagator(model, method=method, order=order, dt=dt, orientation=oriented)
    start = {**state, **({"g": np.eye(n)} if oriented else {})}
    run = kr.simulate(
        model, state, dt=dt, steps=250, every=100, method=method, order=order, orientation=start.get("g"),
        observe=[], progress=False,
    )  # fmt: skip
    rows = p.steps(start, 250, every=100)
    assert set(rows) == set(p.letters) == set(run.data_vars)
    for letter in p.letters:
        assert rows[letter].shape == run[letter].shape
        assert (rows[letter] == run[letter].values).all(), letter
    last = p.steps(start, 250)
    if (name, method) == ("lagrange-top", "exact"):  # as by `at`: other arithmetic than that of rows
        assert all(abs(last[k] - p.at(start, 250 * dt)[k]).max() < 1e-14 for k in p.letters)
        differences = {
            k: min(abs(last[k] - s * rows[k][-1]).max() for s in ((1, -1) if k == "g" else (1,))) for k in p.letters
        }
        assert max(differences.values()) < 1e-13
    else:
        assert all((last[k] == rows[k][-1]).all() for k in p.letters)
    x0 = p.steps(start, 1, every=1)  # the start as it comes back, as numbers
    if n == 3:
        x = np.concatenate([x0[k][0] for k in p.letters])
        assert x.shape == (p.size,)
        assert (p.steps(x, 250) == flat(last)).all()
        lanes = p.steps(np.array([x, x + 1e-3, x]), 250)
        assert lanes.shape == (3, p.size)
        assert (lanes[0] == lanes[2]).all() and (lanes[0] != lanes[1]).any()
        assert (p.steps(x, 250) == flat(last)).all()  # by an engine that was used before


def test_steps_in_other_variables_are_those_of_a_run() -> None:
    """Neumann's exact steps are in (M, P): their constants belong to the (x, q) that a call is given."""
    model, state = case("neumann", 3)
    start, p = np.concatenate([state[letter] for letter in ("x", "q")]), kr.propagator(model, method="exact", dt=0.02)
    run = kr.simulate(model, state, dt=0.01, steps=7, method="exact", observe=[])
    between = kr.simulate(model, state, dt=0.02, times=[0.05, 0.07], method="exact", observe=[])
    expected = np.concatenate([run.x.values, run.q.values], -1)
    assert abs(p.steps(start, 3) - expected[6]).max() < 1e-14
    assert abs(p.to(np.array([start, start]), 0.07) - expected[7]).max() < 1e-14
    assert abs(np.concatenate([between.x.values, between.q.values], -1) - expected[[5, 7]]).max() < 1e-14


def test_times_are_those_of_kr_at(top: Any) -> None:
    p = kr.propagator(top, method="exact", observe=["energy"])
    x, times = np.array([0.1, 0.2, 1.5, 0.6, 0.0, 0.8]), [0.0, -3.7, 1e6]
    run = kr.at(top, {"m": x[:3], "a": x[3:]}, times)
    got = p.at(x, times)
    assert got.shape == (3, 7)
    assert (got[:, :3] == run.m.values).all() and (got[:, 3:6] == run.a.values).all()
    assert abs(got[:, 6] - run.energy.values).max() < 1e-14
    assert p.at(x, -3.7).shape == (7,)
    mapped = p.at({"m": x[:3], "a": x[3:]}, -3.7)
    assert set(mapped) == {"m", "a", "energy"} and mapped["energy"] == got[1, 6]
    assert p.at(np.tile(x, (5, 1)), times).shape == (3, 5, 7)


@pytest.mark.parametrize("method", ["veselov", "dop853", "variational"])
def test_a_mapping_comes_back_with_what_is_observed(method: str) -> None:
    model, state = case("heavy-top", 3) if method == "variational" else case("euler-top", 3)
    p = kr.propagator(model, method=method, dt=0.02, orientation=True, observe=["energy"])
    start = {**state, "g": np.eye(3)}
    run = kr.simulate(
        model, state, dt=0.02, steps=3, method=method, orientation=np.eye(3), observe=["energy"], progress=False
    )
    rows = p.steps(start, 3, every=1)
    assert set(rows) == {*p.letters, "energy"}
    assert all((rows[k] == run[k].values).all() for k in p.letters)
    assert rows["energy"].shape == (4,)
    assert abs(rows["energy"] - run.energy.values).max() < 1e-14  # products are fused in another order


@pytest.mark.parametrize(
    "name", ["lagrange-top", "clebsch", "euler-top", "neumann", "kirchhoff", "heavy-top", "quadratic-field"]
)
@pytest.mark.parametrize("n", [3, 4])
@pytest.mark.parametrize("oriented", [False, True])
def test_every_form_of_a_state_has_the_bits_of_the_others(name: str, n: int, oriented: bool) -> None:
    """Of a `State`, matrices, axial vectors, lists and an array; -0.0 and 0.0 too."""
    if REGISTRY[name].n not in (None, n):
        return
    model, parts = case(name, n)
    if "vector" in model.system.space.kinds and not model.system.space.constraints:
        parts = {k: np.where(np.arange(v.shape[-1]) == 0, -0.0, v) if v.ndim == 1 else v for k, v in parts.items()}
        parts = {k: np.where(v == abs(v).max(), 0.0, v) if v.ndim == 2 else v for k, v in parts.items()}
        parts = {k: (v - v.T) / 2 if v.ndim == 2 else v for k, v in parts.items()}
    p = kr.propagator(model, method="dop853", dt=0.02, orientation=oriented and name != "neumann")
    g = {"g": np.array([0.6, 0.0, -0.8, 0.0])} if n == 3 else {"g": np.eye(n)}
    g = g if "g" in p.letters else {}
    state = model.state(**parts)
    arrays = {k: v.copy() for k, v in state.items()}
    forms = [state if not g else {**state, **g}, {**arrays, **g}, {**{k: v.tolist() for k, v in arrays.items()}, **g}]
    forms += [{**state.axial, **g}, {**{k: v.tolist() for k, v in state.axial.items()}, **g}]
    forms += [{k: np.stack([v, v]) for k, v in forms[1].items()}]  # lanes, which get every check
    found = [p.steps(x, 7) for x in forms]
    last = {k: v[1] for k, v in found.pop().items()}
    for form in found:
        assert {k: v.tobytes() for k, v in form.items()} == {k: v.tobytes() for k, v in last.items()}


X0 = {"m": np.array([0.1, 0.2, 1.5]), "a": np.array([0.6, 0.0, 0.8])}


@pytest.mark.parametrize(
    ("state", "words"),
    [
        ({**X0, "a": np.zeros(3)}, "a must not be the zero vector"),
        ({**X0, "a": [1e-200, 0.0, 0.0]}, "a must not be the zero vector"),
        ({**X0, "m": np.ones((3, 3))}, "may be a skew matrix|must be skew"),
        ({**X0, "m": np.diag([0.0, 0.0, 1e-3])}, "may be a skew matrix|must be skew"),
        ({**X0, "m": [0.1, np.nan, 1.5]}, "must be finite"),
        ({**X0, "m": [True, False, True]}, "must be real values"),
        ({**X0, "m": np.ones(4)}, "must be a skew matrix"),
        ({**X0, "b": np.ones(3)}, "has the components m, a"),
        ({"m": X0["m"]}, "needs a"),
    ],
)
def test_components_that_are_no_state_are_refused(state: Any, words: str, top: Any) -> None:
    p = kr.propagator(top, method="suris", dt=0.05)
    p.steps(X0, 3)
    with pytest.raises(kr.InputError, match=words):
        p.steps(state, 3)


def test_a_state_of_another_system_gets_the_checks_of_this_one(top: Any) -> None:
    other = kr.perturbed(kr.LagrangeTop(p=(0, 0, 1)), potential=lambda a: a[0])
    free = replace(other.system, checks=replace(other.system.checks, state={}))
    zero = type(other)(free, other.params).state(m=(1, 2, 3), a=(0, 0, 0))
    with pytest.raises(kr.InputError, match="a must not be the zero vector"):
        kr.propagator(top, method="suris", dt=0.05).steps(zero, 3)


def test_what_is_returned_is_not_changed_by_the_next_call(top: Any) -> None:
    p, exact = kr.propagator(top, method="suris", dt=0.05), kr.propagator(top, method="exact")
    x, y = p.steps(X, 3), exact.at(X, 2.0)
    before = x.tobytes(), y.tobytes()
    p.steps(2 * X, 3), exact.at(2 * X, 2.0)
    assert (x.tobytes(), y.tobytes()) == before


def test_other_threads_run_while_many_steps_are_made(top: Any) -> None:
    """Python never takes its lock from the caller here, so the other thread runs only if the call releases it."""
    p = kr.propagator(top, method="suris", dt=0.05)
    x, ticks, end, interval = np.array([0.1, 0.2, 1.5, 0.6, 0.0, 0.8]), [0], threading.Event(), sys.getswitchinterval()

    def tick() -> None:
        while not end.wait(1e-4):
            ticks[0] += 1

    p.steps(x, 10**4)
    sys.setswitchinterval(60.0)
    thread = threading.Thread(target=tick)
    thread.start()
    try:
        before = ticks[0]
        p.steps(x, 10**7)
        assert ticks[0] > before
    finally:
        end.set()
        sys.setswitchinterval(interval)
        thread.join()


def test_threads_share_a_propagator(top: Any) -> None:
    p = kr.propagator(top, method="baecklund", dt=0.05)
    starts = np.array([0.1, 0.2, 1.5, 0.6, 0.0, 0.8]) + 0.01 * np.arange(40)[:, None]
    alone = [p.steps(x, 3000) for x in starts]
    with ThreadPoolExecutor(8) as pool:
        together = list(pool.map(lambda x: p.steps(x, 3000), starts))
    assert all((a == b).all() for a, b in zip(alone, together, strict=True))


def test_a_projection_begins_anew_with_each_call(top: Any) -> None:
    """An engine that kept the invariants of the state before would pull the next one to them."""
    p = kr.propagator(top, method="suris", dt=0.05)
    x, y = np.array([0.1, 0.2, 1.5, 0.6, 0.0, 0.8]), np.array([0.3, -0.2, 2.5, 0.0, 0.6, 0.8])
    there = kr.propagator(top, method="suris", dt=0.05).steps(y, 10_000)
    p.steps(x, 10_000)
    assert (p.steps(y, 10_000) == there).all()


def test_a_map_that_does_not_conserve_ends_with_an_error() -> None:
    top = kr.LagrangeTop(p=(0, 0, 1))
    record = top.system
    off = replace(record.map, step=lambda m, a, *, p, eps: record.map.step(m * (1 + 1e-9), a, p=p, eps=eps))
    model = type(top)(replace(record, map=off), top.params)
    x, asked = np.array([0.1, 0.2, 1.5, 0.6, 0.0, 0.8]), {"method": "suris", "dt": 0.05}
    with pytest.raises(kr.RunError, match="is not conserved, although the method conserves it") as of_propagator:
        kr.propagator(model, **asked).steps(x, 100_000)
    with pytest.raises(kr.RunError, match="is not conserved, although the method conserves it, before") as of_run:
        kr.simulate(model, model.state(m=x[:3], a=x[3:]), steps=100_000, every=100_000, order=2, **asked)
    causes = {str(each.value).split("Usual cause: ")[1] for each in (of_propagator, of_run)}
    assert len(causes) == 1 and "contradicts its record" in causes.pop()


def heavy_top() -> Any:
    return kr.HeavyTop(J=(1, 2, 3), A=(0, 0, 1))


@pytest.mark.parametrize(
    ("use", "message"),
    [
        (lambda top, p: kr.propagator(top, method="suris"), "needs a step dt"),
        (lambda top, p: kr.propagator(top, dt=0.1, observe=["enrgy"]), "Did you mean 'energy'"),
        (lambda top, p: kr.propagator(top, dt=0.1, observe="energy"), "expected a list of names"),
        (lambda top, p: kr.propagator(3, dt=0.1), "A system with its parameters was expected"),
        (lambda top, p: p.steps(np.zeros(5), 1), "an array of these 6 values"),
        (lambda top, p: kr.propagator(top, dt=0.05).steps(np.full(6, np.nan), 1), "expected finite values"),
        (lambda top, p: p.steps({"m": (1, 2, 3)}, 1), "needs a"),
        (lambda top, p: p.steps({"m": (1, 2, 3), "a": (0, 0, 1), "g": (1, 0, 0, 0)}, 1), "expected no orientation"),
        (lambda top, p: p.steps(np.ones(6), 0), "n must be an integer from 1"),
        (lambda top, p: p.steps(np.ones(6), 2, every=3), "every must be an integer from 1 to 2"),
        (lambda top, p: kr.propagator(top, method="exact").at(np.ones(6), [[1.0]]), "times must be a finite number"),
        (lambda top, p: kr.propagator(heavy_top(), dt=0.1).at(np.ones(6), 1), "No closed form"),
    ],
)  # fmt: skip
def test_what_cannot_be_used_is_refused(use: Any, message: str, top: Any) -> None:
    with pytest.raises(kr.InputError, match=message):
        use(top, kr.propagator(top, method="suris", dt=0.05))


X = np.array([0.1, 0.2, 1.5, 0.6, 0.0, 0.8])
NOT_STATES = {
    "masked": np.ma.masked_array(X, [1, 0, 0, 0, 0, 0]),
    "dates": np.array(["2020-01-01"] * 6, "M8[D]"),
    "times that are none": np.array(["NaT"] * 6, "m8[s]"),
    "complex": X + 0j,
    "text": X.astype(str),
    "truth values": X > 0,
    "no lanes": np.empty((0, 6)),
    "nan": np.where(X == 1.5, np.nan, X),
    "infinity": np.where(X == 1.5, np.inf, X),
}


@pytest.mark.parametrize("kind", NOT_STATES)
def test_arrays_that_are_no_states_are_refused_by_every_method(kind: str, top: Any) -> None:
    """`exact` and `dop853` too, which set themselves up from the state; steps by one lane, rows, and times."""
    state = NOT_STATES[kind]
    exact, paced = kr.propagator(top, method="exact"), kr.propagator(top, method="exact", dt=0.1)
    calls = [
        lambda: kr.propagator(top, method="suris", dt=0.05).steps(state, 2),
        lambda: kr.propagator(top, method="dop853", dt=0.05).steps(state, 2, every=1),
        lambda: exact.at(state, 2.0),
        lambda: exact.at(state, np.linspace(0, 9, 30)),
        lambda: paced.steps(state, 2),
        lambda: paced.to(state, [0.2, 0.9]),
    ]
    for call in calls:
        with pytest.raises(kr.InputError):
            call()


def test_states_off_the_phase_space_and_other_numbers_of_lanes_are_refused(top: Any) -> None:
    exact, lanes = kr.propagator(top, method="exact"), kr.propagator(kr.LagrangeTop(p=[(0, 0, 1)] * 3), dt=0.05)
    for call, words in (
        (lambda: exact.at(np.zeros(6), 2.0), "a must not be the zero vector"),
        (lambda: exact.steps(np.zeros(6), 3), "a must not be the zero vector"),
        (lambda: lanes.steps(np.array([X, X]), 2), "expected one, or 3"),
    ):
        with pytest.raises(kr.InputError, match=words):
            call()


def test_a_state_is_the_same_however_it_lies_in_memory(top: Any) -> None:
    shifted = np.zeros(6 * 8 + 1, np.uint8)[1:].view(np.float64)
    shifted[:] = X
    assert not shifted.flags.aligned
    read_only = X.copy()
    read_only.flags.writeable = False
    p, exact = kr.propagator(top, method="suris", dt=0.05), kr.propagator(top, method="exact")
    for state in (shifted, read_only, X.astype(">f8"), X.tolist(), X.astype(object), np.ma.masked_array(X)):
        assert (np.asarray(p.steps(state, 5)) == p.steps(X, 5)).all()
        assert (np.asarray(exact.at(state, 2.0)) == exact.at(X, 2.0)).all()


def test_the_largest_times_that_doubles_have(top: Any) -> None:
    """The length of m - <m, p> p does not change: m of 10^308 is as long as at the start."""
    exact = kr.propagator(top, method="exact")
    found = exact.at(X, [1e308, -1e308])
    assert np.isfinite(found).all()
    assert abs(np.linalg.norm(found[:, 3:], axis=1) - 1).max() < 1e-15
    assert abs(found[:, 2] - X[2]).max() < 1e-15


def test_what_overflows_is_no_silent_nan(top: Any) -> None:
    with pytest.raises(kr.RunError, match="no longer finite"):
        kr.propagator(top, method="suris", dt=0.05).steps(np.full(6, 1e200), 10)


def test_an_ensemble_of_parameters() -> None:
    tops = kr.LagrangeTop(p=(0, 0, 1), alpha=[0.5, 1.0, 2.0])
    p = kr.propagator(tops, method="suris", dt=0.05)
    x = np.array([0.1, 0.2, 1.5, 0.6, 0.0, 0.8])
    got = p.steps(x, 20)
    for lane, alpha in enumerate((0.5, 1.0, 2.0)):
        one = kr.propagator(kr.LagrangeTop(p=(0, 0, 1), alpha=alpha), method="suris", dt=0.05)
        assert abs(got[lane] - one.steps(x, 20)).max() < 1e-14  # other code: what is 1 is folded


def test_a_run_keeps_what_is_observed(top: Any, x0: Any, tmp_path: Path) -> None:
    whole = kr.simulate(top, x0, dt=0.05, steps=300, every=7, progress=False)
    path = tmp_path / "run.zarr"
    run = kr.simulate(top, x0, dt=0.05, steps=150, every=7, observe=["energy"], path=path, progress=False)
    assert set(run.data_vars) == {"m", "a", "energy"}
    assert check_archive(path)[1] == []
    longer = kr.resume(path, extend=300, progress=False)
    assert set(longer.data_vars) == {"m", "a", "energy"}
    assert all((longer[k].values == whole[k].values).all() for k in longer.data_vars)
    assert check_archive(path)[1] == []
    assert list(kr.drift(longer).index) == ["energy"]
    assert set(kr.at(top, x0, 1.0, observe=[]).data_vars) == {"m", "a"}


def test_what_was_recorded_is_used_again(top: Any, x0: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a model with the same record and parameters, not of one in whose code a 1 is folded that differs in a bit."""
    from kreisel.graph.recording import Recording

    options = {"dt": 0.05, "steps": 10, "method": "suris", "progress": False}
    recorded = []
    record = Recording.__init__
    monkeypatch.setattr(Recording, "__init__", lambda *args: recorded.append(1) or record(*args))
    kr.simulate(top, x0, **options)
    assert recorded
    recorded.clear()
    kr.simulate(kr.LagrangeTop(p=(0, 0, 1)), x0, **options)
    assert not recorded
    other = kr.simulate(kr.LagrangeTop(p=(0, 0, np.nextafter(1.0, 2))), x0, **options)
    assert recorded and other.attrs["parameters"] != kr.simulate(top, x0, **options).attrs["parameters"]


def test_what_is_kept_is_bounded() -> None:
    for k in range(reuse.MOST + 10):
        assert reuse.reused(("number", k), lambda k=k: k) == k
    assert reuse.reused(("number", reuse.MOST), lambda: -1) == reuse.MOST
    assert reuse.reused(("number", 0), lambda: -1) == -1
    assert reuse.reused(None, lambda: 5) == 5


@pytest.fixture
def collecting() -> Iterator[None]:
    """Garbage is collected as in a process of a user; the suite has it off."""
    gc.enable()
    yield
    gc.disable()


@pytest.mark.usefixtures("collecting")
@pytest.mark.parametrize("key", [None, ("collecting", 1)])
def test_garbage_is_collected_after_a_recording_and_not_during_it(key: Any) -> None:
    assert reuse.reused(key, gc.isenabled) is False and gc.isenabled()
    with pytest.raises(ZeroDivisionError):
        reuse.reused(key and (*key, "error"), lambda: 1 // 0)
    assert gc.isenabled()
    gc.disable()
    try:
        assert reuse.reused(key and (*key, "off"), lambda: 1) == 1 and not gc.isenabled()
    finally:
        gc.enable()


@pytest.mark.usefixtures("collecting")
@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork and no flock")
@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning", "ignore:.*fork.*:RuntimeWarning")
def test_garbage_is_collected_in_a_child_of_a_recording() -> None:
    """As of a thread that is not in the child, and would never let it collect again."""
    child, collecting = reuse.reused(None, lambda: (os.fork(), gc.isenabled()))
    if child == 0:
        os._exit(3 * collecting)
    assert not collecting and os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 3


def test_a_model_of_many_bodies() -> None:
    """Lanes in the parameters: states are prepared by the definitions on arrays."""
    draw = np.random.default_rng(2)
    J, M = draw.uniform(0.2, 2, (5, 3)), draw.normal(size=(5, 3))
    found = kr.propagator(kr.EulerTop(J=J), method="exact").at(M, 3.1)
    for lane in range(5):
        alone = kr.propagator(kr.EulerTop(J=J[lane]), method="exact").at(M[lane], 3.1)
        assert (found[lane] == alone).all()


def test_an_array_that_may_only_be_read() -> None:
    p = kr.propagator(kr.LagrangeTop(p=(0, 0, 1)), method="exact")
    x = np.array([0.1, 0.2, 1.5, 0.6, 0.0, 0.8])
    want = p.at(x, 1.0)
    for given in (x, np.stack([x, x]).T[:, 0], np.broadcast_to(x, (3, 6))):
        given.flags.writeable = False
        found = p.at(given, 1.0)
        assert (found == want).all()
        assert found.shape == given.shape


@pytest.mark.parametrize("order", [(0, 1, 0, 1), (1, 0, 1, 0)])
def test_a_state_whose_constant_is_folded_into_code_leaves_no_trace(order: tuple[int, ...]) -> None:
    top = kr.LagrangeTop(p=(0, 0, 1))
    states = np.array([[0, 0, 0, 1.0, 0, 1], [0, 0, 0.5, 0.1, 0.2, 0.1]])
    p, other = (kr.propagator(top, method="baecklund", dt=2.0) for _ in range(2))
    for k in order:  # at rest |a - rho p|^2 = rho (2/dt)^2: rho = 1
        assert (p.steps(states[k], 3) == other.steps(states[[k]], 3)[0]).all()
        run = kr.simulate(top, top.state(m=states[k, :3], a=states[k, 3:]), dt=2.0, steps=3, method="baecklund")
        assert (p.steps(states[k], 3)[3:] == run["a"].values[-1]).all()


def test_a_call_may_have_parameters_of_its_own():
    """A motor of a tenth of a second is that of a body which has it always; others are not changed by the call."""
    body = kr.EulerTop(J=(1, 2, 3))
    with_motor = {
        torque: kr.perturbed(body, torque=lambda M, t, *, tau: tau * np.cos(t), params={"tau": torque})
        for torque in ((0.0, 0.0, 0.0), (0.1, -0.2, 0.3))
    }
    still, driven = (kr.propagator(model, dt=0.1) for model in with_motor.values())
    x, motor = np.array([0.3, -1.0, 0.5]), np.array([0.1, -0.2, 0.3])
    for calls in (
        (driven.steps(x, 7, time=0.5), still.steps(x, 7, time=0.5, tau=motor)),
        (driven.steps(x, 7, every=2, time=0.5), still.steps(x, 7, every=2, time=0.5, tau=motor)),
        (driven.to(x, 1.0, 0.3), still.to(x, 1.0, 0.3, tau=motor)),
        (driven.to(x, [0.37, 1.0], 0.3), still.to(x, [0.37, 1.0], 0.3, tau=motor)),
        (still.steps(x, 7, time=0.5), still.steps(x, 7, time=0.5, tau=0 * motor)),
    ):
        assert calls[1] == pytest.approx(calls[0], rel=1e-13)
    lanes = still.steps(np.stack([x, x]), 7, time=0.5, tau=np.stack([motor, 0 * motor]))
    assert lanes[0] == pytest.approx(driven.steps(x, 7, time=0.5), rel=1e-13)
    assert lanes[1] == pytest.approx(still.steps(x, 7, time=0.5), rel=1e-13)
    for parameters, said in (
        ({"tua": motor}, "Did you mean 'tau'"),
        ({"J": (1, 2, 3)}, "expected some of tau"),
        ({"tau": (1, 2)}, r"of the shape \(3,\)"),
        ({"tau": (1, np.nan, 3)}, "expected finite"),
    ):
        with pytest.raises(kr.InputError, match=said):
            still.steps(x, 1, time=0.0, **parameters)
