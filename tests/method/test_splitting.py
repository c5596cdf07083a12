"""method="splitting": orders in the step and in the perturbation, work, what stays, lanes, archives, bad input."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import kreisel as kr
from kreisel.algebra.reuse import forget
from kreisel.errors import RunError
from kreisel.graph.recording import Recording
from kreisel.method import METHODS, composition
from kreisel.method.composition import Splitting, conditions, splitting
from sizes import FULL

I = np.array([1.0, 1.3, 0.5])  # noqa: E741
MASS = I.sum() / 2 - I
FREE = kr.EulerTop(J=MASS)
TOP = kr.LagrangeTop(p=(0, 0, 1), alpha=0.5)
MOVING = kr.LagrangeTopMoving(A=(0, 0, 1), alpha=0.5)
Q = np.array([0.1, 0.2, 0.3, 0.4]) / np.sqrt(0.3)
M0, P0 = (0.3, 0.2, 1.1), (0.6, 0.0, 0.8)


def weight(g: Any, *, k: Any) -> Any:
    return k * g[2] @ np.array([0.3, 0.1, 1.0])


def shaken(g: Any, t: Any, *, k: Any) -> Any:
    return k * (1 + 2 * np.sin(1.3 * t)) * (g[2] @ np.array([0.3, 0.1, 1.0]))


def end(body: Any, dt: float, time: float, order: Any, **more: Any) -> np.ndarray:
    steps = round(time / dt)
    run = kr.simulate(body, body.state(M=M0), dt=dt, steps=steps, every=steps, orientation=Q, order=order, **more)
    return np.concatenate([run.M.values[-1], run.g.values[-1]])


def reference(body: Any, time: float) -> np.ndarray:
    """By the splitting of order 8 with steps so short that it is exact to 1e-13 or so; and not by this method."""
    found = end(body, time / 512, time, 8)
    run = kr.simulate(body, body.state(M=M0), dt=time, steps=1, orientation=Q, method="dop853", tol=1e-13)
    assert abs(run.M.values[-1] - found[:3]).max() < 1e-9  # 3e-12
    return found


def test_orders_of_several_stages_are_recorded_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """They differ in their stages alone; with two kinds of perturbations a third power divides the kicks."""
    recorded, record = list[Any](), Recording.__init__
    monkeypatch.setattr(Recording, "__init__", lambda *args: recorded.append(1) or record(*args))
    one = kr.perturbed(FREE, potential=weight, params={"k": 0.7})
    two = kr.perturbed(FREE, potential=weight, inertia=1.1 * I, params={"k": 0.7})
    for body, orders, most in ((one, ((4, 2), 4, (8, 2), (8, 6, 4), 6), 2), (two, ((4, 2), (8, 6, 4), (8, 2)), 4)):
        recorded.clear()
        shared = {order: end(body, 0.1, 1.0, order) for order in orders}
        assert 1 <= len(recorded) <= most  # with the projection and without it
        for order in reversed(orders):
            forget()
            assert (end(body, 0.1, 1.0, order) == shared[order]).all()


@pytest.mark.parametrize(
    ("order", "counts"),
    [((2, 2), (32, 64)), ((4, 2), (32, 64)), (4, (32, 64)), (6, (24, 32)), (8, (16, 24)), ((8, 6, 4), (24, 32))],
)
def test_order_in_the_step(order: Any, counts: tuple[int, int]) -> None:
    """For a perturbation that is not small, and depends on time, the order is that of its highest power."""
    time = 4.0
    body = kr.perturbed(FREE, potential=shaken, params={"k": 0.7})
    exact = reference(body, time)
    errors = [abs(end(body, time / n, time, order) - exact).max() for n in counts]
    slope = np.log(errors[0] / errors[1]) / np.log(counts[1] / counts[0])
    assert abs(slope - (order if isinstance(order, int) else order[-1])) < 0.3, (slope, errors)


def errors_by_powers(order: Any, count: int) -> tuple[float, float]:
    """The error in M by the first and by the second power of eps, over eps and eps^2."""
    time, eps = 4.0, 1e-4
    body = kr.perturbed(FREE, potential=shaken, params={"k": [[eps], [-eps], [0.0]]})
    runs = [
        kr.simulate(body, {"M": M0}, dt=time / n, steps=n, every=n, orientation=Q, order=how).M.values[-1]
        for n, how in ((count, order), (64, (8, 6, 4)))
    ]
    off, exact = ((x[0] - x[1], x[0] + x[1] - 2 * x[2]) for x in runs)
    first, second = (abs(x - y).max() for x, y in zip(off, exact, strict=True))
    return first / eps, second / eps**2


@pytest.mark.parametrize(
    ("order", "counts", "first", "second"),
    [((2, 2), (12, 16), 2, 2), ((4, 2), (10, 16), 4, 2), ((8, 2), (8, 10), 8, 2), ((8, 6, 4), (8, 10), 8, None)],
)
def test_orders_in_the_perturbation(order: Any, counts: tuple[int, int], first: int, second: int | None) -> None:
    """The error is O(eps dt^p_1) + O(eps^2 dt^p_2)."""
    coarse, fine = (errors_by_powers(order, n) for n in counts)
    slopes = [np.log(x / y) / np.log(counts[1] / counts[0]) for x, y in zip(coarse, fine, strict=True)]
    assert abs(slopes[0] - first) < 0.05 * first + 0.2, slopes
    assert second is None or abs(slopes[1] - second) < 0.4, slopes


def test_the_second_power_is_of_order_six() -> None:
    (_, leapfrog), (_, sixth) = errors_by_powers((8, 2), 6), errors_by_powers((8, 6, 4), 6)
    assert sixth < leapfrog / 30  # 190


@pytest.mark.parametrize("order", METHODS["splitting"].orders)
def test_a_coefficient_that_is_off_is_found(order: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    assert len(splitting(order).a) == len(splitting(order).b) + 1
    right = composition._fractions(order)
    off = ([right[0][0] + 1e-9, *right[0][1:]], right[1])
    monkeypatch.setattr(composition, "_fractions", lambda _: off)
    with pytest.raises(ArithmeticError, match="condition of eps"):
        splitting.__wrapped__(order)


def test_the_conditions_are_those_of_iterated_integrals() -> None:
    """Leapfrog is of order 2 and no more; a condition too many fails."""
    a, b = splitting((2, 2))
    for k, degrees in conditions((2, 2)):
        assert k + sum(degrees) <= 2
        found = composition.ordered_sum(list(a), list(b), degrees)
        assert abs(found - float(composition.ordered_integral(degrees))) < 1e-15
    off = [
        abs(composition.ordered_sum(list(a), list(b), d) - float(composition.ordered_integral(d)))
        for _, d in conditions((3, 3))
    ]
    assert max(off) > 0.01


def test_steps_back_undo_steps_forth() -> None:
    """The splitting is symmetric: from the end with M -> -M and the same potential the start comes back."""
    body = kr.perturbed(MOVING, potential=lambda P: 0.3 * P[0] ** 2, inertia=I)
    x = {"M": M0, "P": P0}
    there = kr.simulate(body, x, dt=0.2, steps=50, every=50)
    back = kr.simulate(body, {"M": -there.M.values[-1], "P": there.P.values[-1]}, dt=0.2, steps=50, every=50)
    assert abs(-back.M.values[-1] - M0).max() < 1e-12 and abs(back.P.values[-1] - P0).max() < 1e-12


def test_linear_damping_is_exact() -> None:
    """A body that spins about its axis: M_3 = exp(-c t) M_3, whatever the step; energy and work balance."""
    body = kr.perturbed(FREE, damping=(0.1, 0.2, 0.3))
    run = kr.simulate(body, {"M": (0, 0, 2.0)}, dt=0.5, steps=40)
    assert abs(run.M[:, 2] / (2 * np.exp(-0.3 * run.time)) - 1).max() < 1e-14
    assert abs(run.energy - 2 * np.exp(-0.6 * run.time) / I[2]).max() < 1e-13
    assert abs(run.balance - run.balance[0]).max() < 1e-13 and run.work[-1] < -3


def test_the_work_of_a_torque_and_of_a_shaken_weight() -> None:
    body = kr.perturbed(
        FREE, potential=shaken, torque=lambda M, g, t: 0.1 * np.cos(t) * g[0] - 0.05 * M, params={"k": 0.2}
    )
    run = kr.simulate(body, {"M": M0}, dt=0.05, steps=400, every=20, orientation=Q)
    other = kr.simulate(body, {"M": M0}, dt=0.05, steps=400, every=20, orientation=Q, method="dop853", tol=1e-12)
    assert abs(run.M - other.M).max() < 1e-7 and abs(run.work - other.work).max() < 1e-6
    assert abs(run.balance - run.balance[0]).max() < 1e-6 < abs(run.energy - run.energy[0]).max()
    assert abs(other.balance - other.balance[0]).max() < 1e-9


def test_the_energy_does_not_drift_and_casimirs_stand_still() -> None:
    body = kr.perturbed(TOP, potential=lambda a, *, k: k * (a[0] ** 2 + a[0] * a[2]), params={"k": 0.02})
    run = kr.simulate(body, {"m": (0.1, 0.2, 1.5), "a": (0.6, 0.0, 0.8)}, dt=0.2, steps=200_000, every=1000)
    table = kr.drift(run)
    assert table.loc["casimir[0]", "conserved"] and not table.loc["energy", "conserved"]
    assert table.loc[["casimir[0]", "casimir[1]"], "ulps"].max() < 8
    off = abs(run.energy - run.energy[0]).values
    assert off.max() < 1e-5 and off[100:].max() < 3 * off[:100].max()


def test_lanes_have_the_bits_of_single_runs() -> None:
    k = np.array([0.0, 0.01, 0.1, 0.2, 0.5])
    body = kr.perturbed(
        MOVING, potential=lambda P, t, *, k: k * P[0] * np.sin(t) * np.exp(-t), params={"k": k}, inertia=I
    )
    run = kr.simulate(body, {"M": M0, "P": P0}, dt=0.1, steps=50, every=10, order=(4, 2))
    for lane in (0, 3):
        one = kr.perturbed(
            MOVING, potential=lambda P, t, *, k: k * P[0] * np.sin(t) * np.exp(-t), params={"k": k[lane]}, inertia=I
        )
        single = kr.simulate(one, {"M": M0, "P": P0}, dt=0.1, steps=50, every=10, order=(4, 2))
        for name in ("M", "P", "work", "energy"):
            assert (single[name].values == run[name].values[:, lane]).all(), name


def test_an_archive_of_a_body_from_a_toml_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from typer.testing import CliRunner

    from kreisel.cli import app

    (tmp_path / "my.py").write_text(
        "import kreisel as kr\n"
        "body = kr.perturbed(kr.LagrangeTop(p=(0, 0, 1)), potential=lambda a, t, *, k: k * a[0] ** 2, params=dict(k=1))"
    )
    (tmp_path / "my.toml").write_text(
        '[system]\nfile = "my.py"\nname = "body"\nk = 0.02\n[state]\nm = [0.1, 0.2, 1.5]\na = [0.6, 0, 0.8]\n'
        '[run]\ndt = 0.3\nsteps = 100\nevery = 10\norder = [8, 2]\n[output]\npath = "my.zarr"\n'
    )
    monkeypatch.chdir(tmp_path)
    done = CliRunner().invoke(app, ["run", "my.toml"])
    assert done.exit_code == 0 and "(8, 2)" in done.output, done.output
    assert CliRunner().invoke(app, ["check", "my.zarr"]).exit_code == 0
    body = kr.perturbed(kr.LagrangeTop(p=(0, 0, 1)), potential=lambda a, t, *, k: k * a[0] ** 2, params={"k": 0.02})
    run = kr.simulate(body, {"m": (0.1, 0.2, 1.5), "a": (0.6, 0, 0.8)}, dt=0.3, steps=100, every=10, order=(8, 2))
    with kr.open_run(tmp_path / "my.zarr") as saved:
        assert (saved.m.values == run.m.values).all() and saved.attrs["system"] == "perturbed-lagrange-top"
        assert "laskar2001" in kr.cite(saved)


def test_a_run_goes_on_with_the_system_that_it_was_made_of(tmp_path: Path) -> None:
    def body(k: float) -> Any:
        return kr.perturbed(TOP, potential=lambda a, t, *, k: k * a[0] * np.sin(t), params={"k": k})

    start = {"m": (0.1, 0.2, 1.5), "a": (0.6, 0.0, 0.8)}
    kr.simulate(body(0.1), start, dt=0.2, steps=50, every=10, path=tmp_path / "short.zarr").close()
    with pytest.raises(kr.InputError, match="system="):
        kr.resume(tmp_path / "short.zarr", extend=100)
    with pytest.raises(kr.InputError, match="with the parameters"):
        kr.resume(tmp_path / "short.zarr", extend=100, system=body(0.2))
    longer = kr.simulate(body(0.1), start, dt=0.2, steps=100, every=10)
    with kr.resume(tmp_path / "short.zarr", extend=100, system=body(0.1)) as run:
        for name in ("m", "a", "work"):
            assert (run[name].values == longer[name].values).all()


@pytest.mark.parametrize("method", ["splitting", "dop853"])
def test_a_propagator_goes_on_at_the_time_it_is_given(method: str) -> None:
    body = kr.perturbed(TOP, potential=lambda a, t, *, k: k * a[0] * np.sin(t), params={"k": 0.3})
    p = kr.propagator(body, method=method, dt=0.1)
    x = np.array([0.1, 0.2, 1.5, 0.6, 0.0, 0.8])
    at_once = p.steps(x, 30, time=0.0)
    assert abs(p.steps(p.steps(x, 10, time=0.0), 20, time=1.0) - at_once).max() < 1e-8  # 1e-14 of the splitting
    assert abs(p.steps(p.steps(x, 10, time=0.0), 20, time=0.0) - at_once).max() > 1e-4
    with pytest.raises(kr.InputError, match="the time at the start"):
        p.steps(x, 10)
    with pytest.raises(kr.InputError, match="expected none"):
        kr.propagator(TOP, dt=0.1).steps(x, 10, time=0.0)


def test_a_force_that_becomes_nan_ends_the_run_at_its_step() -> None:
    body = kr.perturbed(TOP, potential=lambda a, t: a[0] * np.sqrt(1 - t))
    with pytest.raises(RunError, match="no longer finite at or before step 1"):
        kr.simulate(body, {"m": (0.1, 0.2, 1.5), "a": (0.6, 0.0, 0.8)}, dt=0.1, steps=20, every=1)


def test_a_step_too_long_for_the_closed_form_is_refused() -> None:
    body = kr.perturbed(FREE, potential=weight, params={"k": 0.1})
    warned = pytest.warns(kr.AccuracyWarning, match=r"4 steps from the start fail.* Use a dt of \d")
    with pytest.raises(RunError, match="A part of the step is longer"), warned:
        kr.simulate(body, {"M": M0}, dt=20.0, steps=5, orientation=Q)


def test_a_thin_top_spins_no_further_than_the_step_is_precise() -> None:
    thin = kr.perturbed(kr.LagrangeTopMoving(A=(0, 0, 1), alpha=0.003), potential=lambda P: 0 * P[0])
    warned = pytest.warns(kr.AccuracyWarning, match="1 step from the start fail")
    with pytest.raises(RunError, match="A part of the step is longer"), warned:
        kr.simulate(thin, {"M": (0.2, 0.1, 0.8), "P": P0}, dt=1.0, steps=1)


def test_a_torque_of_the_momentum_has_order_four() -> None:
    body = kr.perturbed(FREE, torque=lambda M: -0.1 * M * (M @ M))
    with pytest.raises(kr.InputError, match="to order 4"):
        kr.simulate(body, {"M": M0}, dt=0.1, steps=1, order=8)


IN_FOUR = {"lagrange-top-moving": (kr.LagrangeTopMoving(A=(0, 0, 0, 1)), {"P": (0, 0, 0, 1)})}
IN_FOUR |= {"euler-top": (kr.EulerTop(J=(1.0, 2.0, 3.0, 4.0)), {})} if FULL else {}  # more than a minute to compile


@pytest.mark.parametrize("name", IN_FOUR)
def test_damping_of_four_dimensions_by_lanes(name: str) -> None:
    system, more = IN_FOUR[name]
    body = kr.perturbed(system, damping=(0.1, 0.2, 0.3))
    start = np.zeros((4, 4))
    start[0, 1], start[1, 0] = 1.0, -1.0
    run = kr.simulate(body, {"M": start, **more}, dt=0.1, steps=4, every=4)
    assert abs(run.M.values[-1, :, 0, 1] - np.exp(-0.4 * np.array([0.1, 0.2, 0.3]))).max() < 1e-14


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ({"order": (8, 3)}, "one of its orders"),
        ({"order": (8, 2.5)}, "expected an integer"),
        ({"orientation": None}, "needs the orientation g"),
        ({"method": "suris"}, "expected"),
        ({"method": "dop853", "tol": 2.0}, "relative tolerance"),
        ({"tol": 1e-9}, "method='dop853'"),
    ],
)
def test_bad_settings_are_refused(more: dict[str, Any], words: str) -> None:
    body = kr.perturbed(FREE, potential=weight, params={"k": 0.1})
    with pytest.raises(kr.InputError, match=words):
        kr.simulate(body, {"M": M0}, **{"dt": 0.1, "steps": 5, "orientation": Q, **more})


def test_fractions_are_symmetric() -> None:
    for order in METHODS["splitting"].orders:
        found = splitting(order)
        assert isinstance(found, Splitting)
        a = found.a if found.a[-1] else tuple((x + y) / 2 for x, y in zip(found.a, found.a[::-1], strict=True))
        assert a == a[::-1] and found.b == found.b[::-1]  # of one with a corrector, but for half of A
        assert abs(sum(found.a) - 1) < 1e-15 * 8 and abs(sum(found.b) - 1) < 1e-15 * 8


def test_a_sweep_over_a_parameter_of_a_force(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from typer.testing import CliRunner

    from kreisel.cli import app

    (tmp_path / "my.py").write_text(
        "import kreisel as kr\n"
        "body = kr.perturbed(kr.LagrangeTop(p=(0, 0, 1)), potential=lambda a, *, k: k * a[0] ** 2, params=dict(k=1))"
    )
    (tmp_path / "sweep.toml").write_text(
        '[system]\nfile = "my.py"\nname = "body"\n[state]\nm = [0.1, 0.2, 1.5]\na = [0.6, 0, 0.8]\n'
        '[run]\ndt = 0.3\nsteps = 20\n[sweep]\nsave = ["drift"]\n[sweep.grid]\n"system.k" = [0.0, 0.02]\n'
        '[output]\npath = "sweep.zarr"\n'
    )
    monkeypatch.chdir(tmp_path)
    done = CliRunner().invoke(app, ["sweep", "sweep.toml", "--workers", "0"])
    assert done.exit_code == 0, done.output
    body = kr.perturbed(kr.LagrangeTop(p=(0, 0, 1)), potential=lambda a, *, k: k * a[0] ** 2, params={"k": 0.02})
    run = kr.simulate(body, {"m": (0.1, 0.2, 1.5), "a": (0.6, 0, 0.8)}, dt=0.3, steps=20)
    with kr.open_run(tmp_path / "sweep.zarr") as saved:
        assert float(saved.energy_drift[1]) == float(abs(run.energy - run.energy[0]).max())


@pytest.mark.parametrize(("inner", "few"), [(2, 12), (4, 12), (8, 5)])
def test_the_integrable_part_by_the_map(inner: int, few: int) -> None:
    """Its own error then shows: O(dt^inner), whatever the perturbation is."""
    top = kr.LagrangeTop(p=(0, 0, 1), alpha=0.6)
    more: dict[str, Any] = {"potential": lambda a: 1e-6 * a[0]}
    exact, mapped = kr.perturbed(top, **more), kr.perturbed(top, inner=inner, **more)
    x0 = {"m": (0.1, 0.2, 0.9), "a": (0.6, 0, 0.8)}
    off = []
    for steps in (few, 2 * few):
        asked: dict[str, Any] = {"dt": 6 / steps, "steps": steps, "every": steps, "order": (8, 2), "observe": ()}
        off.append(float(abs(kr.simulate(mapped, x0, **asked).m[-1] - kr.simulate(exact, x0, **asked).m[-1]).max()))
    assert off[0] > 1e-10 and abs(np.log2(off[0] / off[1]) - inner) < (0.3 if inner < 8 else 1.0)


def test_an_inner_order_that_is_none() -> None:
    for inner in (3, True, "exact"):
        with pytest.raises(kr.InputError, match="inner"):
            kr.perturbed(kr.LagrangeTop(p=(0, 0, 1)), inner=inner, damping=0.1)
    with pytest.raises(kr.InputError, match="no map of goryachev-chaplygin"):
        kr.perturbed(kr.GoryachevChaplygin(), inner=4, damping=0.1)
