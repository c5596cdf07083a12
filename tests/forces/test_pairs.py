"""Bodies that act on each other in pairs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import kreisel as kr
from kreisel.forces import kicks
from kreisel.forces.records import conserved, conserved_totals
from kreisel.kernels.coupled import CoupledEngine
from kreisel.method.splitting import Splitting
from kreisel.record.model import Model
from kreisel.runs.planning import make_plan
from kreisel.sweeps.sweep import check_archive
from support import cross

TOP = kr.LagrangeTop(p=(0, 0, 1), alpha=[0.5, 0.7, 1.1])
PAIRS = [(0, 1), (1, 2)]
START = {
    "m": [(0.1, 0.2, 1.5), (0.3, -0.2, 1.1), (0.0, 0.4, 2.0)],
    "a": [(0.6, 0, 0.8), (0, 0.6, 0.8), (1, 0, 0)],
}


def magnets(a1: Any, a2: Any, *, k: Any) -> Any:
    return -k * (a1 @ a2)


def chain(k: Any = 0.1, system: Any = TOP, pairs: Any = PAIRS) -> Any:
    return kr.perturbed(system, pair_potential=magnets, pairs=pairs, params={"k": k})


def wheels(**more: Any) -> tuple[Any, Any]:
    """Two free bodies whose orientations feel each other and the time, with friction and a torque."""
    body = kr.perturbed(
        kr.EulerTop(J=[(1, 2, 2.5), (1, 1.5, 2)]),
        pair_potential=lambda g1, g2, t, *, k, w: k * np.cos(w * t) * (g1[0] @ g2[1]) + k * g1[2, 2] * g2[2, 1],
        potential=lambda g, t: 0.05 * np.sin(t) * g[1, 1],
        damping=0.01,
        torque=lambda M: 0.01 * M[::-1],
        pairs=[(1, 0)],
        params={"k": 0.1, "w": 1.3},
        **more,
    )
    return body, body.state(M=[(0.1, 0.2, 1.5), (0.3, -0.2, 1.1)])


def by_vectors(k: np.ndarray, time: float) -> np.ndarray:
    """m_i' = p x a_i + a_i x f_i in the frame at rest, f_i = -dV/da_i, by another integrator: (3, 6) at that time."""

    def rates(t: float, y: np.ndarray) -> np.ndarray:
        z = y.reshape(3, 6)
        m, a, f = z[:, :3], z[:, 3:], np.zeros((3, 3))
        for (i, j), each in zip(PAIRS, k, strict=True):
            f[i] += each * a[j]
            f[j] += each * a[i]
        rows = zip(m, a, f, strict=True)
        return np.ravel([(cross((0, 0, 1), b) + cross(b, c), cross(n, b)) for n, b, c in rows])

    start = np.concatenate([START["m"], START["a"]], -1).ravel()
    return solve_ivp(rates, (0, time), start, method="DOP853", rtol=1e-12, atol=1e-13).y[:, -1].reshape(3, 6)


@pytest.mark.parametrize("k", [0.1, [0.1, -0.04]])
def test_a_chain_of_tops_is_that_of_its_equations(k: Any) -> None:
    body = chain(k)
    run = kr.simulate(body, body.state(**START), dt=0.125, steps=80, every=80)
    expected = by_vectors(np.broadcast_to(k, 2), 10.0)
    found = np.concatenate([run.m[-1], run.a[-1]], -1)
    assert abs(found - expected).max() < 1e-9
    assert abs(found - by_vectors(np.zeros(2), 10.0)).max() > 0.1


@pytest.mark.parametrize(("order", "slope"), [((4, 2), 2), ((8, 6, 4), 4)])
def test_order_with_all_that_there_is(order: Any, slope: int) -> None:
    body, x0 = wheels()
    more: dict[str, Any] = {"orientation": (1, 0, 0, 0), "progress": False}
    exact = kr.simulate(body, x0, dt=6.0, steps=1, method="dop853", tol=1e-13, **more)
    off, lost = [], []
    for steps in (12, 48):
        run = kr.simulate(body, x0, dt=6 / steps, steps=steps, order=order, **more)
        g, q = run.g[-1].values, exact.g[-1].values
        sign = np.sign((g * q).sum(-1, keepdims=True))
        apart = [abs(run[name][-1] - exact[name][-1]).max() for name in ("M", "work", "total_energy")]
        off.append(max(float(abs(sign * g - q).max()), *map(float, apart)))
        lost.append(float(abs(run.balance - run.balance[0]).max()))
    assert abs(np.log2(off[0] / off[1]) / 2 - slope) < 0.3
    assert off[0] < 1e-4 and lost[1] < lost[0] < 1e-4 < float(abs(exact.work[-1]).max())
    assert abs(exact.balance - exact.balance[0]).max() < 1e-9


def test_what_is_conserved_is_said() -> None:
    """Rotations of all tops about p leave a1.a2 alone, so the sum of m.p stays; each by itself does not."""
    body = chain()
    assert conserved(body) == ("casimir",)
    assert conserved_totals(body) == ("noether",)
    run = kr.simulate(body, body.state(**START), dt=0.2, steps=2000, every=10)
    assert run.total_noether.attrs["conserved"] and not run.noether.attrs["conserved"]
    scale = float(abs(run.total_noether).max())
    assert abs(run.total_noether - run.total_noether[0]).max() < 1e-12 * scale
    assert abs(run.noether - run.noether[0]).max() > 0.01
    assert abs(run.casimir - run.casimir[0]).max() < 1e-14
    assert 1e-12 < abs(run.total_energy - run.total_energy[0]).max() < 1e-7
    np.testing.assert_allclose(run.total_energy[:, 0], run.energy.sum("lane"), rtol=1e-14)
    assert abs(run.energy - run.energy[0]).max() > 0.01
    assert not kr.drift(run).broken.any()


def test_what_is_not_conserved_is_not_said() -> None:
    along = kr.perturbed(TOP, pair_potential=lambda a1, a2: a1[0] * a2[0], pairs=PAIRS)
    assert conserved_totals(along) == ()
    outside = kr.perturbed(TOP, potential=lambda a: a[0], pair_potential=lambda a1, a2: a1 @ a2, pairs=PAIRS)
    assert conserved_totals(outside) == ()
    weighted = kr.perturbed(
        TOP, pair_potential=lambda a1, a2, *, k: a1 @ a2 * k + 0 * a1[0], pairs=PAIRS, params={"k": 2}
    )
    assert conserved_totals(weighted) == ("noether",)


def test_a_mutant_without_reaction_is_caught(monkeypatch: pytest.MonkeyPatch) -> None:
    true = kicks.pulls

    def without_reaction(*given: Any) -> Any:
        first, second, power = true(*given)
        return first, tuple(0 * f for f in second), power

    monkeypatch.setattr(kicks, "pulls", without_reaction)
    body = kr.perturbed(TOP, pair_potential=lambda a1, a2: -0.2 * (a1 @ a2) - 0 * a1[0], pairs=PAIRS)
    assert conserved_totals(body) == ()
    run = kr.simulate(body, body.state(**START), dt=0.2, steps=100)
    assert abs(run.total_energy - run.total_energy[0]).max() > 0.01


def test_an_engine_that_adopts_another_step_projects_with_its_constants() -> None:
    """An invariant that depends on dt, as the deformed ones of maps do."""
    bodies = chain()

    def planned(dt: float) -> tuple[Any, Any]:
        plan = make_plan(bodies, START, dt=dt, steps=10, order=8)
        observe = plan.scheme.observe

        def deformed(parts: Any, *only: Any, **constants: Any) -> dict[str, Any]:
            return {name: value + constants["_last"] for name, value in observe(parts, *only, **constants).items()}

        return replace(plan.scheme, observe=deformed), plan.first

    (short, z), (long, _) = planned(0.1), planned(0.2)
    engine, fresh = CoupledEngine(short, z, project=True), CoupledEngine(long, z, project=True)
    assert (engine.projection.targets[..., 0] != fresh.projection.targets[..., 0]).any()
    assert engine.begin(z, long, 10**9)
    assert (engine.projection.targets[..., 0] == fresh.projection.targets[..., 0]).all()


def test_which_is_first_makes_no_difference() -> None:
    one = kr.perturbed(TOP, pair_potential=lambda a1, a2: a1[0] * a2[1], pairs=PAIRS)
    two = kr.perturbed(TOP, pair_potential=lambda a1, a2: a2[0] * a1[1], pairs=[(j, i) for i, j in PAIRS])
    runs = [kr.simulate(body, body.state(**START), dt=0.2, steps=30) for body in (one, two)]
    np.testing.assert_allclose(runs[0].m, runs[1].m, atol=1e-13)


def test_bodies_without_a_force_move_on_their_own() -> None:
    x0 = TOP.state(
        m=np.array(START["m"])[:, None] @ np.zeros((3, 3)) + kr.algebra.hat(np.array(START["m"])), a=START["a"]
    )
    alone = kr.perturbed(TOP, potential=lambda a: 0 * a[0])
    together = chain(0.0)
    free = kr.simulate(alone, x0, dt=0.2, steps=50)
    coupled = kr.simulate(together, together.state(**START), dt=0.2, steps=50)
    for name in ("m", "a"):
        np.testing.assert_array_equal(free[name], coupled[name])


def test_interrupted_and_lengthened(tmp_path: Path) -> None:
    body = chain()
    asked: dict[str, Any] = {"dt": 0.2, "every": 3, "progress": False}
    whole = kr.simulate(body, body.state(**START), steps=60, path=tmp_path / "whole.zarr", **asked).load()
    kr.simulate(body, body.state(**START), steps=21, path=tmp_path / "run.zarr", **asked)
    longer = kr.resume(tmp_path / "run.zarr", extend=60, system=body).load()
    for name in whole.data_vars:
        np.testing.assert_array_equal(whole[name], longer[name])
    assert check_archive(tmp_path / "run.zarr")[1] == []
    with pytest.raises(kr.InputError, match="parameters"):
        kr.resume(tmp_path / "run.zarr", extend=90, system=chain(pairs=[(0, 1), (0, 2)]))


def test_a_propagator_of_bodies() -> None:
    body = chain()
    p = kr.propagator(body, dt=0.2)
    x = np.concatenate([START["m"], START["a"]], -1)
    run = kr.simulate(body, body.state(**START), dt=0.2, steps=300)
    for n in (7, 300, 7):  # long enough to be projected, and begun again
        found = p.steps(x, n)
        np.testing.assert_array_equal(found, np.concatenate([run.m[n], run.a[n]], -1))


def test_what_is_observed_is_chosen() -> None:
    body = chain()
    run = kr.simulate(body, body.state(**START), dt=0.2, steps=4, observe=["total_energy"])
    assert set(run.data_vars) == {"m", "a", "total_energy"}
    every = kr.simulate(body, body.state(**START), dt=0.2, steps=4)
    np.testing.assert_allclose(run.total_energy, every.total_energy, rtol=1e-14)


def test_the_kernel_does_not_grow_with_the_bodies() -> None:
    sizes = []
    for count in (3, 40):
        top = kr.LagrangeTop(p=(0, 0, 1), alpha=np.linspace(0.5, 1.5, count))
        body = chain(system=top, pairs=[(i, i + 1) for i in range(count - 1)])
        rng = np.random.default_rng(count)
        x0 = body.state(m=rng.normal(size=(count, 3)), a=rng.normal(size=(count, 3)))
        sizes.append(make_plan(body, x0, dt=0.1, steps=1).engine.kernel.size)
    assert sizes[0] == sizes[1]


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"pairs": None}, "together"),
        ({"pair_potential": None}, "together"),
        ({"pairs": [(0, 0)]}, "two different bodies"),
        ({"pairs": [(0, 1.5)]}, "pairs of integers"),
        ({"pairs": [(0, -1)]}, "from 0"),
        ({"pairs": [0, 1]}, "pairs of integers"),
        ({"pairs": []}, "pairs of integers"),
        ({"pairs": [(0, 1), (0,)]}, "pairs of integers"),
        ({"pairs": "chain"}, "pairs of integers"),
        ({"params": {"k": [0.1, 0.2, 0.3, 0.4]}}, "one for each pair"),
        ({"pairs": [(0, 1), (1, 2), (2, 0)], "params": {"k": [0.1, 0.2, 0.3]}}, "values for one of each"),
        ({"pair_potential": lambda a1, b2: 0 * a1[0]}, "b2"),
        ({"pair_potential": lambda a, a2: a @ a2}, "'a'"),
        ({"pair_potential": lambda m1, a2: m1 @ a2}, "momentum"),
        ({"pair_potential": lambda a1, a2: a1}, "one number"),
        ({"pair_potential": lambda a1, a2, *, alpha: alpha * a1 @ a2}, "params"),
        ({"potential": lambda a, *, k: k * a[0], "params": {"k": [0.1, 0.2]}}, "one k for all"),
    ],
)
def test_what_is_wrong_is_said(given: dict[str, Any], said: str) -> None:
    asked = {"pair_potential": magnets, "pairs": PAIRS, "params": {"k": 0.1}, **given}
    with pytest.raises(kr.InputError, match=said):
        kr.perturbed(TOP, **asked)


def test_parameters_given_anew() -> None:
    """As a TOML file does that names a Python file."""
    by_pair = chain([0.1, 0.2])
    x0 = by_pair.state(**START)
    one = kr.simulate(Model(by_pair.system, {"k": 0.3}), x0, dt=0.1, steps=5)
    np.testing.assert_array_equal(one.m, kr.simulate(chain([0.3, 0.3]), x0, dt=0.1, steps=5).m)
    with pytest.raises(kr.InputError, match="one for each pair"):
        kr.simulate(Model(by_pair.system, {"k": [0.1, 0.2, 0.3]}), x0, dt=0.1, steps=5)


def test_where_pairs_do_not_go() -> None:
    body = chain(system=kr.LagrangeTop(p=(0, 0, 1)))
    with pytest.raises(kr.InputError, match="3 bodies"):
        kr.simulate(body, body.state(m=(0, 0, 1), a=(1, 0, 0)), dt=0.1, steps=1)
    with pytest.raises(kr.InputError, match="3 bodies"):
        kr.simulate(body, body.state(m=np.ones((4, 3)), a=(1, 0, 0)), dt=0.1, steps=1)
    x0 = body.state(**START)
    with pytest.raises(kr.InputError, match="got bodies that act on each other in pairs"):
        kr.simulate(body, x0, dt=0.1, steps=1, engine="cuda")
    with pytest.raises(kr.InputError, match="observe"):
        kr.propagator(body, dt=0.1, observe=["total_energy"])
    with pytest.raises(kr.InputError, match="3 bodies"):
        kr.propagator(body, dt=0.1).steps(np.ones((2, 6)), 1)
    large = kr.LagrangeTop(p=np.eye(12)[0])
    big = kr.perturbed(large, pair_potential=lambda a1, a2: a1 @ a2, pairs=[(0, 1)])
    rng = np.random.default_rng(0)
    X = rng.normal(size=(2, 12, 12))
    with pytest.raises(kr.InputError, match="straight-line"):
        kr.simulate(big, big.state(m=X - X.mT, a=rng.normal(size=(2, 12))), dt=0.01, steps=1)


MOMENTS = np.array([(1, 1.1, 0.5), (1, 0.9, 1 / 1.7)])
UNEQUAL = {"M": [(0.3, 0.2, 1.1), (0.1, -0.3, 0.8)], "P": [(0.6, 0, 0.8), (0, 0.6, 0.8)]}


def unequal(**more: Any) -> Any:
    tops = kr.LagrangeTopMoving(A=(0, 0, 1), alpha=[0.5, 0.7])
    return kr.perturbed(
        tops, inertia=MOMENTS, pair_potential=lambda P1, P2: 0.1 * (P1 @ P2 + P1[0] * P2[2]), pairs=[(0, 1)], **more
    )


def unequal_by_vectors(time: float, gamma: float) -> np.ndarray:
    """M' = M x Omega + P x (A + dV/dP) - gamma M, P' = P x Omega, by another integrator: (2, 6)."""

    def rates(t: float, y: np.ndarray) -> np.ndarray:
        M, P = y.reshape(2, 2, 3).swapaxes(0, 1)
        slopes = 0.1 * np.array([P[1] + (P[1, 2], 0, 0), P[0] + (0, 0, P[0, 0])])
        rows = zip(M, P, M / MOMENTS, slopes + np.array([0, 0, 1]), strict=True)
        return np.ravel([(cross(m, w) + cross(p, f) - gamma * m, cross(p, w)) for m, p, w, f in rows])

    start = np.stack([UNEQUAL["M"], UNEQUAL["P"]], 1).ravel()
    found = solve_ivp(rates, (0, time), start, method="DOP853", rtol=1e-13, atol=1e-14)
    return np.asarray(found.y[:, -1]).reshape(2, 6)


def errors(body: Any, order: Any, truth: np.ndarray) -> list[float]:
    out = []
    for steps in (50, 100):
        run = kr.simulate(body, UNEQUAL, dt=10 / steps, steps=steps, every=steps, order=order)
        out.append(float(abs(np.concatenate([run.M[-1], run.P[-1]], -1) - truth).max()))
    return out


def test_unequal_moments_in_pairs(monkeypatch: pytest.MonkeyPatch) -> None:
    """Against vectors, with the order of the scheme; a sum over the pairs from before the turns loses M.P."""
    for gamma, order, slope, bound in ((0.0, (2, 2), 2, 3e-3), (0.02, (8, 6, 4), 4, 1e-6)):
        body = unequal(**({"damping": gamma} if gamma else {}))
        coarse, fine = errors(body, order, unequal_by_vectors(10.0, gamma))
        assert abs(np.log2(coarse / fine) - slope) < 0.3 and fine < bound
    run = kr.simulate(body, UNEQUAL, dt=0.1, steps=300, every=10)
    assert abs(run.balance - run.balance[0]).max() < 1e-8 < 1e-2 < abs(run.work).max()
    whole = property(lambda self: False, lambda self, value: None)
    monkeypatch.setattr(Splitting, "divided", whole, raising=False)
    with pytest.raises(kr.RunError, match=r"casimir.* is not conserved"):
        kr.simulate(unequal(), UNEQUAL, dt=0.1, steps=300, order=(2, 2))
