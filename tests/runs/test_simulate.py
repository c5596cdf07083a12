"""kr.simulate and kr.drift: what is saved, what stands still, what the reference loses."""

from __future__ import annotations

import gc
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
from scipy.integrate import solve_ivp

import kreisel as kr
import walks
from kreisel import algebra
from kreisel.algebra.reuse import forget
from kreisel.lab import exact
from kreisel.runs import integration as runs
from kreisel.runs.plan import Plan
from kreisel.system import REGISTRY
from sizes import FULL, costly

MAPS = [name for name, system in REGISTRY.items() if system.map is not None and system.map.to_symmetric is not None]
SYMMETRIC = [name for name, system in REGISTRY.items() if system.map is not None and system.map.symmetric]
REFERENCE = [name for name, system in REGISTRY.items() if system.map is None and system.inverse_inertia is None]


def random_run(name: str, n: int, **options: object) -> xr.Dataset:
    draw = exact.float_random(np.random.default_rng([7, n]))
    model = exact.random_model(REGISTRY[name], n, draw)
    state = model.system.space.point(n, draw)
    return kr.simulate(model, dict(zip(model.system.space.letters, state, strict=True)), **options)


@pytest.mark.parametrize(
    ("name", "n", "order"),
    [(name, 3, 2) for name in MAPS]
    + [(name, 4, 1) for name in MAPS if not costly(name)]
    + [("lagrange-top", 5, 2), ("lagrange-top", 9, 1)]
    + [(name, n, order) for name in MAPS for n, order in ((3, 1), (4, 2), (5, 1), (5, 2), (9, 1), (9, 2))] * FULL,
)
def test_integrals_stand_still(name: str, n: int, order: int) -> None:
    steps = 20_000 if n < 9 else 300
    run = random_run(name, n, dt=0.1, steps=steps, every=steps // 100, method="suris", order=order)
    table = kr.drift(run)
    assert table.conserved.sum() >= 4
    walks.assert_still(run)
    assert table.loc["energy", "ulps"] > 100  # the true energy is not kept: the test can fail


@pytest.mark.parametrize(
    ("name", "n", "order"),
    [(name, 3, order) for name in SYMMETRIC for order in (2, 4)]
    + [(name, 4, 2) for name in (SYMMETRIC if FULL else ("euler-top", "neumann-veselov"))],
)
def test_integrals_of_the_flow_stand_still(name: str, n: int, order: int) -> None:
    steps = 20_000
    dt = {"rosochatius": 0.02}.get(name, 0.1)  # close to its walls
    run = random_run(name, n, dt=dt, steps=steps, every=steps // 100, method="veselov", order=order)
    table = kr.drift(run)
    assert table.conserved.all()
    walks.assert_still(run)
    reference = kr.drift(random_run(name, n, dt=dt, steps=steps, every=steps // 100, method="variational"))
    assert reference.loc["energy", "ulps"] > 100  # the energy is not kept there: the test can fail


@pytest.mark.parametrize("name", SYMMETRIC)
def test_a_step_beyond_the_map_is_refused(name: str) -> None:
    draw = exact.float_random(np.random.default_rng(3))
    model = exact.random_model(REGISTRY[name], 4, draw)
    z = model.system.space.point(4, draw)
    state = dict(zip(model.system.space.letters, z, strict=True))
    largest = model.largest_step(*z)
    run = kr.simulate(model, state, dt=0.97 * largest, steps=20, every=1, method="veselov")
    walks.assert_still(run, size=10)  # so long a step amplifies its errors
    with pytest.raises(kr.InputError, match=f"expected a step below {largest:.6g}"):
        kr.simulate(model, state, dt=1.001 * largest, steps=20, every=1, method="veselov")


ONE = {"m": (0.1, 0.2, 1.5), "a": (0.6, 0, 0.8)}
STARTS = (ONE, {"m": (-0.7, 0.4, 0.9), "a": (0.0, 0.8, 0.6)}, {k: np.array([v, v]) for k, v in ONE.items()}, ONE)
RUNS: dict[str, dict[str, Any]] = {
    "suris": {"method": "suris"},
    "baecklund": {"method": "baecklund", "order": 4, "every": 7},  # constants of each trajectory, a projection
    "with an orientation": {"method": "suris", "orientation": (1, 0, 0, 0)},
    "exact": {"method": "exact", "observe": ["energy"]},
}


@pytest.mark.parametrize("case", RUNS)
def test_a_run_that_reuses_the_last_has_its_own_bits(case: str, top: object) -> None:
    def all_runs(between: Any) -> list[xr.Dataset]:
        runs = []
        for start in STARTS:
            between()
            runs.append(kr.simulate(top, start, dt=0.05, steps=100, **RUNS[case]))
            if case == "exact":
                runs.append(kr.at(top, start, [3.0, 1.0]))
        return runs

    new, again = all_runs(forget), all_runs(lambda: None)
    for x, y in zip(new, again, strict=True):
        assert x.drop_attrs(deep=False).identical(y.drop_attrs(deep=False))
        assert x.attrs | {"created": ""} == y.attrs | {"created": ""}
    with pytest.raises(kr.InputError, match="finite"):
        kr.simulate(top, ONE | {"m": (0.1, np.nan, 1.5)}, dt=0.05, steps=100, **RUNS[case])
    with pytest.raises(kr.InputError, match="project"):
        kr.simulate(top, ONE, dt=0.05, steps=100, project=1, **RUNS[case])


def test_plans_that_no_run_reuses_are_not_kept(top: object) -> None:
    """The states and constants of an ensemble may be a large part of memory."""

    def kept(lanes: int) -> int:
        gc.collect()
        return sum(type(each) is Plan and each.lanes == lanes for each in gc.get_objects())

    start = {name: np.tile(value, (77, 1)) for name, value in ONE.items()}
    kr.simulate(top, start, dt=0.05, steps=1, method="suris")
    kr.at(top, start, [1.0])
    assert kept(77) == 0
    kr.simulate(top, ONE, dt=0.05, steps=1, method="suris")
    assert kept(1) > 0


def test_reference_drifts_and_agrees(top: object, x0: object) -> None:
    options = {"dt": 0.005, "steps": 2000, "every": 200, "orientation": np.eye(3)}
    ours, theirs = kr.simulate(top, x0, order=2, **options), kr.simulate(top, x0, method="dop853", **options)
    assert abs(ours.a - theirs.a).max() < 2e-4
    assert abs(ours.g - theirs.g).max() < 2e-4
    walks.assert_still(ours)
    assert kr.drift(theirs).ulps.max() > 100
    assert not kr.drift(theirs).conserved.any()


def solved(M: Any, P: Any, A: Any, J: Any, end: float) -> np.ndarray:
    """M' = M x w + P x A, P' = P x w, w_1 = M_1/(J_2 + J_3) ..., to 1e-13 of each component."""
    inertia = np.sum(J) - J

    def rates(t: float, z: np.ndarray) -> np.ndarray:
        w = z[:3] / inertia
        return np.concatenate([np.cross(z[:3], w) + np.cross(z[3:], A), np.cross(z[3:], w)])

    return solve_ivp(rates, (0, end), np.concatenate([M, P]), "DOP853", rtol=1e-13, atol=1e-18).y[:, -1]


@pytest.mark.parametrize("M", [(0.3, 0.2, 0.5), (0, 0, 0), (0, 0.4, 0)])
def test_dop853_is_as_good_for_small_states(M: Any) -> None:
    """The motion with the momenta c M, the vector c^2 P and the time t/c, alone and in lanes with larger ones."""
    M, P, A, J = np.array(M), np.array([0.6, 0, 0.8]), np.array([0.0, 0.3, 1]), np.array([1.0, 1.5, 2])
    expected, body = solved(M, P, A, J, 20), kr.HeavyTop(J=J, A=A)
    errors = []
    sizes = (1, 1e-4, 1e-8)
    asked = {"steps": 100, "every": 100, "method": "dop853"}
    for c in sizes:
        run = kr.simulate(body, {"M": c * M, "P": c * c * P}, dt=0.2 / c, **asked)
        errors.append(abs(np.concatenate([run.M[-1] / c, run.P[-1] / c / c]) - expected).max())
        light = kr.simulate(kr.HeavyTop(J=J, A=c * c * A), {"M": c * M, "P": P}, dt=0.2 / c, **asked)
        errors.append(abs(np.concatenate([light.M[-1] / c, light.P[-1]]) - expected).max())
    assert max(errors) < 3e-8
    c = np.array(sizes)[:, None]
    lanes = kr.simulate(body, {"M": c * M, "P": c * c * P}, dt=0.2, **asked)
    for i, size in enumerate(sizes):
        alone = kr.simulate(body, {"M": size * M, "P": size**2 * P}, dt=0.2, **asked)
        assert (lanes.M.isel(lane=i).values == alone.M.values).all()


def test_dop853_of_a_body_almost_at_rest_in_equilibrium_ends() -> None:
    A = np.array([0.6, 0, 0.8])
    run = kr.simulate(
        kr.HeavyTop(J=(1, 1.5, 2), A=A), {"M": 1e-13 * A[::-1], "P": A}, dt=0.1, steps=50, method="dop853"
    )
    assert abs(run.M.values).max() < 1e-12


@pytest.mark.parametrize(
    ("n", "name"),
    [
        (n, name)
        for name, s in REGISTRY.items()
        if name not in REFERENCE and s.velocity is not None
        for n in (3, 4)
        if n == 3 or FULL or name in ("heavy-top", "lagrange-top", "clebsch")
    ],
)
def test_orientation_turns_what_is_carried(name: str, n: int) -> None:
    """g is orthogonal; g A = a (rest frame), g^T p = P or g^T A g = P (moving frame); without such, g M g^T stays."""
    run = random_run(name, n, dt=0.05, steps=200, every=10, orientation=np.eye(n))
    g = algebra.rotation_matrix(run.g.values) if n == 3 else run.g.values
    assert abs(g @ g.mT - np.eye(n)).max() < 1e-12
    space, h = REGISTRY[name].space, g if run.attrs["frame"] == "rest" else g.mT
    for i in space.carried or (0,):
        letter, kind = space.components[i]
        value = run[letter].values
        value = algebra.hat(value) if kind == "skew" and n == 3 else value
        turned = algebra.act(h, value[0]) if kind == "vector" else h @ value[0] @ h.mT
        assert abs(turned - value).max() < 1e-12


@pytest.mark.parametrize(("a1", "a3", "b", "c1", "c3"), [(1.3, 0.7, 0.4, 0.9, 2.1), (0.6, 1.9, -0.3, 1.1, 0.2)])
def test_kirchhoffs_case_is_clebschs_and_a_turn(a1: float, a3: float, b: float, c1: float, c3: float) -> None:
    """With b1 = b3, as its page says; to the tolerance of dop853."""
    state = {"M": [0.3, -0.5, 0.8], "P": [0.6, 0.2, -0.7]}
    time = 2.7
    body = kr.simulate(
        kr.KirchhoffCase(a1=a1, a3=a3, b1=b, b3=b, c1=c1, c3=c3), state, dt=time / 100, steps=100, every=100
    )
    clebsch = kr.simulate(kr.Clebsch(b=(0, 0, (c1 - c3) / a1)), state, dt=a1 * time / 10, steps=10, method="exact")
    angle = (a1 - a3) * state["M"][2] * time
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    for letter in "MP":
        assert abs(turn @ clebsch[letter].values[-1] - body[letter].values[-1]).max() < 1e-8
        assert abs(clebsch[letter].values[-1] - body[letter].values[-1]).max() > 1e-2  # the turn is needed


def test_saved_steps_and_times(top: object, x0: object) -> None:
    run = kr.simulate(top, x0, dt=0.5, steps=10, every=4)
    assert run.time.values.tolist() == [0.0, 2.0, 4.0, 5.0]
    all_steps = kr.simulate(top, x0, dt=0.5, steps=10, every=1)
    assert (run.a.values == all_steps.a.values[[0, 4, 8, 10]]).all()
    assert np.allclose(run.a[0], [0.6, 0, 0.8])


def test_blocks_do_not_change_the_numbers(top: object, x0: object, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = kr.simulate(top, x0, dt=0.1, steps=1003, every=3)
    monkeypatch.setattr(runs, "BLOCK_BYTES", 6 * 8 * 5)
    monkeypatch.setattr(runs, "TICK_SECONDS", 0.0)  # shortest calls of the engine
    pieces = kr.simulate(top, x0, dt=0.1, steps=1003, every=3)
    xr.testing.assert_identical(whole.drop_attrs(), pieces.drop_attrs())


def test_lanes_equal_single_runs_bitwise(top: object) -> None:
    m = np.array([[0.1, 0.2, 1.5], [0.3, -0.2, 4.0]])
    a = np.array([[0.6, 0, 0.8], [0.6, 0, -0.8]])
    together = kr.simulate(top, top.state(m=m, a=a), dt=0.1, steps=50, every=5)
    assert together.sizes["lane"] == 2
    for lane in (0, 1):
        alone = kr.simulate(top, top.state(m=m[lane], a=a[lane]), dt=0.1, steps=50, every=5)
        for name in ("m", "a", "energy", "spectrum", "casimir"):
            assert (together[name].isel(lane=lane).values == alone[name].values).all()


def test_lanes_over_parameters(x0: object) -> None:
    many = kr.LagrangeTop(p=[(0, 0, 1), (0, 0.6, 0.8)], alpha=[1.0, 0.5])
    run = kr.simulate(many, many.state(m=(0.1, 0.2, 1.5), a=(0.6, 0, 0.8)), dt=0.1, steps=20, orientation=(1, 0, 0, 0))
    one = kr.LagrangeTop(p=(0, 0.6, 0.8), alpha=0.5)
    alone = kr.simulate(one, x0, dt=0.1, steps=20, orientation=(1, 0, 0, 0))
    assert np.allclose(run.a.isel(lane=1), alone.a, atol=1e-14)
    assert np.allclose(run.g.isel(lane=1), alone.g, atol=1e-14)


def test_order_two_is_the_conjugate_map(top: object, x0: object) -> None:
    """chi phi chi^-1 by hand, chi half a kick."""
    eps, phi = 0.2, top.system.map
    z = top.call(phi.from_symmetric, *x0.values(), eps=eps)
    for _ in range(3):
        z = top.step(*z, eps=eps)
    m, a = top.call(phi.to_symmetric, *z, eps=eps)
    run = kr.simulate(top, x0, dt=eps, steps=3, method="suris", order=2)
    assert np.allclose(run.m[-1], algebra.axial(m), atol=1e-14)
    assert np.allclose(run.a[-1], a, atol=1e-14)


def test_axial_and_matrix_states_are_the_same(top: object) -> None:
    v = np.array([0.1, 0.2, 1.5])
    x = top.state(m=algebra.hat(v), a=(0.6, 0, 0.8))
    assert (x.m == top.state(m=v, a=(0.6, 0, 0.8)).m).all()
    assert (x.axial.m == v).all()


def test_drift_measures_change_and_slope() -> None:
    time = np.linspace(0, 10, 11)
    attrs = {"kind": "integral", "conserved": 1, "roundoff_scale": [2.0], "evaluation_scale": [5.0]}
    run = xr.Dataset({"I": ("time", 5 + 0.5 * time, attrs)}, {"time": time}, {"dt": 0.1, "system": "mine"})
    row = kr.drift(run).loc["I"]
    assert (row.start, row.max_change) == (5.0, 5.0)
    assert row.slope == pytest.approx(0.5)
    assert row.ulps == pytest.approx(5 / (5 * np.finfo(float).eps))
    assert np.isnan(row.correction)
    run.I.attrs["largest_correction"] = 3.5
    assert kr.drift(run).loc["I"].correction == 3.5


def test_a_small_lane_is_measured_by_its_own_scale(top: object) -> None:
    large, small = (
        top.state(m=size * np.array([0.1, 0.2, 1.5]), a=size * np.array([0.6, 0, 0.8])) for size in (1, 1e-4)
    )
    both = top.state(m=np.stack([large.m, small.m]), a=np.stack([large.a, small.a]))
    options = {"dt": 0.1, "steps": 1000, "every": 10}
    run = kr.simulate(top, both, **options)
    for lane, state in enumerate((large, small)):
        mine, alone = kr.drift(run.isel(lane=lane)), kr.drift(kr.simulate(top, state, **options))
        assert np.allclose(mine.ulps, alone.ulps, rtol=0.5, atol=0.1)
    run["casimir"][-1, 1] *= 1 + 1e-9
    assert kr.drift(run).ulps["casimir[1]"] > 1e4


@pytest.mark.parametrize(("order", "text"), [(1, "O(dt)"), (2, "O(dt^2)")])
def test_the_energy_of_the_flow_oscillates_by_the_order(top: object, x0: object, order: int, text: str) -> None:
    runs_ = [kr.simulate(top, x0, dt=dt, steps=round(5 / dt), method="suris", order=order) for dt in (0.01, 0.005)]
    widths = [float(np.ptp(run.energy.values)) for run in runs_]
    assert np.log2(widths[0] / widths[1]) == pytest.approx(order, abs=0.1)
    assert runs_[0].energy.attrs["long_name"].endswith(text)


def test_default_method_and_names() -> None:
    assert kr.systems() == list(REGISTRY)
    assert random_run("kirchhoff", 3, dt=0.1, steps=2).attrs["method"] == "variational"
    assert random_run("clebsch", 3, dt=0.1, steps=2).attrs["method"] == "baecklund"


def test_plot_draws_both_panels(top: object, x0: object) -> None:
    run = kr.simulate(top, x0, dt=0.05, steps=2000, every=5, method="suris")
    figure = kr.plot(run, compare=kr.simulate(top, x0, dt=0.05, steps=200, method="dop853"))
    sphere, drift = (sub.axes[0] for sub in figure.subfigs)
    path = np.array(sphere.lines[0].get_data_3d()).T
    assert np.allclose(path[::6], run.a.values[: len(path[::6])])
    assert np.allclose(np.linalg.norm(path, axis=-1), 1)
    strips = {axes.texts[0].get_text(): axes for axes in figure.subfigs[1].axes}
    labels = [line.get_label() for line in strips["energy of the map"].lines]
    assert labels[0] == "suris" and "dop853" in [line.get_label() for line in drift.lines]
    other = kr.plot(random_run("clebsch", 4, dt=0.05, steps=50))
    assert len(other.subfigs[0].axes[0].lines) == 4


def test_sources_that_were_not_used_are_not_cited() -> None:
    """Moser and Veselov's map is cited by a run that steps it alone, Suris's of Clebsch's case by none of another."""

    def cited(method: str) -> str:
        body = kr.EulerTop(J=(1, 2, 3))
        return kr.cite(kr.simulate(body, {"M": (1.0, 2.0, 0.3)}, dt=0.1, steps=2, method=method))

    assert "moser1991" in cited("veselov")
    for method in ("exact", "dop853"):
        assert "moser1991" not in cited(method) and "@software{kreisel" in cited(method)
    assert "moser1991" not in kr.cite(kr.EulerTop(J=(1, 2, 3))) and "moser1991" not in kr.cite(kr.EulerTop)


def test_a_long_run_whose_step_is_not_compiled_says_what_it_costs(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Once, in memory and on disk; a short one, and one of compiled steps, say nothing."""
    options: dict[str, Any] = {"dt": 0.01, "steps": 3, "method": "variational", "progress": False, "observe": ()}
    random_run("clebsch", 12, **options)
    monkeypatch.setattr("kreisel.runs.planning.PATIENCE", 0.0)
    for path in (None, tmp_path / "run"):
        with pytest.warns(kr.InputWarning, match=r"clebsch, n = 12, has no compiled step.* ms a step") as caught:
            random_run("clebsch", 12, **options, path=path)
        assert len(caught) == 1
        assert Path(caught[0].filename) == Path(__file__)
    random_run("clebsch", 3, **options)
