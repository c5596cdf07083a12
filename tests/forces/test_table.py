"""Tables in time: against SciPy's interpolation, in kernels against formulas, in lanes and archives; bad input."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.polynomial import Polynomial
from scipy.interpolate import BPoly, CubicHermiteSpline, CubicSpline, PchipInterpolator

import kreisel as kr
from kreisel.algebra import iteration
from kreisel.record.model import Model

EVEN = np.linspace(-2.0, 12.0, 29)
RNG = np.random.default_rng(0)
UNEVEN = np.sort(np.concatenate([[-2.0, 12.0], RNG.uniform(-2.0, 12.0, 40)]))
BETWEEN = np.concatenate([RNG.uniform(-2.0, 12.0, 300), EVEN, UNEVEN])
TIMES = {"equally spaced": EVEN, "at any times": UNEVEN}


@pytest.mark.parametrize("times", TIMES)
@pytest.mark.parametrize("columns", [None, 1, 4])
def test_values_are_those_of_scipy(times: str, columns: int | None) -> None:
    """Splines, monotone ones, and Hermite's of degree 3 and 5, with their first and second derivatives."""
    t = TIMES[times]
    y, m, s = RNG.normal(size=(3, len(t)) if columns is None else (3, len(t), columns))
    pairs = [
        (kr.Table(t, y), CubicSpline(t, y)),
        (kr.Table(t, y, kind="pchip"), PchipInterpolator(t, y)),
        (kr.Table(t, y, m), CubicHermiteSpline(t, y, m)),
        (kr.Table(t, y, (m, s)), BPoly.from_derivatives(t, np.stack([y, m, s], 1))),
    ]
    inside = BETWEEN[(abs(BETWEEN[:, None] - t) > 1e-9).all(1)]  # at a knot the second derivative may jump
    for table, judge in pairs:
        want = judge(BETWEEN)
        assert table(BETWEEN).shape == want.shape
        assert abs(table(BETWEEN) - want).max() < 1e-11 * abs(want).max()
        for order in (1, 2):
            want = judge.derivative(order)(inside)
            assert abs(table(inside, order) - want).max() < 1e-9 * abs(want).max()


def test_a_row_too_far_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    """Negative control of the row that is read, near the end of an interval."""
    right = iteration.entry
    monkeypatch.setattr(iteration, "entry", lambda address, row, *more: right(address, row + 1, *more))
    values = RNG.normal(size=len(EVEN))
    assert abs(kr.Table(EVEN, values)(BETWEEN) - CubicSpline(EVEN, values)(BETWEEN)).max() > 0.1


# -- in kernels ------------------------------------------------------------------------------------

TOP = kr.LagrangeTop(p=(0, 0, 1))
START = TOP.state(m=(0.1, 0.2, 1.5), a=(0.6, 0, 0.8))
RUN: dict[str, Any] = {"dt": 0.05, "steps": 200, "every": 20}
PUSH = Polynomial([0.3, 0.1, -0.02, 0.001])
LOAD = (Polynomial([0.1, 0.05, -0.01]), Polynomial([-0.2, 0.02, 0.0, 0.0005]), Polynomial([0.05]))


def pushed(a: Any, t: Any, *, push: Any) -> Any:
    return push(t) * a[0]


def loaded(t: Any, *, load: Any) -> Any:
    return load(t)


def by_tables(scale: Any = 1.0, hold: bool = False) -> Model:
    """With cubic polynomials of time, which tables have exactly."""
    load = [kr.Table(EVEN, k * np.stack([p(EVEN) for p in LOAD], -1), hold=hold) for k in np.atleast_1d(scale)]
    push = kr.Table(UNEVEN, PUSH(UNEVEN), hold=hold)
    params = {"push": push, "load": load if np.ndim(scale) else load[0]}
    return kr.perturbed(TOP, potential=pushed, torque=loaded, params=params)


MOTOR = kr.Table(UNEVEN, PUSH(UNEVEN))


def pushed_about(t: Any, motor: Any) -> Any:
    return np.stack([0.0 * t, 0.0 * t, motor(t)])


def by_formulas() -> Model:
    return kr.perturbed(TOP, potential=lambda a, t: PUSH(t) * a[0], torque=lambda t: np.stack([p(t) for p in LOAD]))


def test_a_run_by_tables_is_that_by_formulas() -> None:
    """State and work, which has the derivative of the table by time; another table gives another motion."""
    run, want = kr.simulate(by_tables(), START, **RUN), kr.simulate(by_formulas(), START, **RUN)
    for name in ("m", "a", "work"):
        assert abs(run[name] - want[name]).max() < 1e-12 * max(1.0, abs(want[name]).max())
    assert abs(kr.simulate(by_tables(1.01), START, **RUN).m - want.m).max() > 1e-3
    independent = kr.simulate(by_tables(), START, method="dop853", **RUN)
    assert abs(run.m - independent.m).max() < 1e-5


def test_a_lane_is_a_single_run() -> None:
    """Lanes with tables of their own, bit for bit; one that is refused by name."""
    scales = [1.0, -2.0, 0.5, 3.0, 1.5]
    lanes = kr.simulate(by_tables(scales), START, **RUN)
    for i in (1, 4):
        assert (kr.simulate(by_tables(scales[i]), START, **RUN).m.values == lanes.m.values[:, i]).all()


def test_archives_hold_the_table(tmp_path: Path) -> None:
    """A run is resumed bit for bit; in another process the addresses are others; another table is refused."""
    path, model = tmp_path / "run.zarr", by_tables()
    whole = kr.simulate(model, START, **RUN)
    kr.simulate(model, START, path=path, **{**RUN, "steps": 100})
    again = pickle.loads(pickle.dumps(model))
    with pytest.raises(kr.InputError, match="expected perturbed-lagrange-top with the parameters"):
        kr.resume(path, extend=200, system=by_tables(1.01))
    kr.resume(path, extend=200, system=again)
    assert (kr.open_run(path).m.values == whole.m.values).all()


def test_a_table_must_cover_the_run() -> None:
    """One message before the first step; a table that holds its ends continues, here constant."""
    with pytest.raises(kr.InputError, match=r"(push|load): expected a table for all times of the run, 0 to 12.05, got"):
        kr.simulate(by_tables(), START, **{**RUN, "steps": 241})
    p = kr.propagator(by_tables(), dt=0.05)
    assert p.steps(START, 200, time=0.0)["m"] == pytest.approx(kr.simulate(by_tables(), START, **RUN).m[-1].values)
    late, early = (lambda: p.steps(START, 1, time=12.0)), (lambda: p.steps(START, 1, time=-3.0))
    for beyond in (late, early, lambda: p.to(START, 13.0)):
        with pytest.raises(kr.InputError, match="expected a table for all times of the run"):
            beyond()
    held = kr.Table([0.0, 1.0], [2.0, 5.0], hold=True)
    assert held([-9.0, 0.5, 9.0]).tolist() == [2.0, 3.5, 5.0]
    assert held([-9.0, 0.5, 9.0], 1).tolist() == [0.0, 3.0, 0.0]
    kr.simulate(by_tables(hold=True), START, **{**RUN, "steps": 300})


def test_a_run_to_the_last_time_of_a_table() -> None:
    """Three steps of 0.1 end an ulp behind 0.3.  A ball has M' = tau; times that JAX traces give NaN outside."""
    jax = pytest.importorskip("jax")
    from kreisel.reduction import double

    table = kr.Table([0.0, 0.1, 0.2, 0.3], np.outer([0.0, 0.1, 0.2, 0.3], [1.0, 0.0, 0.0]))
    ball = kr.perturbed(kr.EulerTop(J=(1, 1, 1)), torque=lambda t, *, load: load(t), params={"load": table})
    still = {"M": np.zeros(3)}
    assert 3 * 0.1 > 0.3
    assert kr.simulate(ball, still, dt=0.1, steps=3).M.values[-1] == pytest.approx([0.045, 0, 0], abs=1e-15)
    motion = kr.differentiable(ball)
    with double():
        first = jax.value_and_grad(lambda t: motion(still, dt=0.1, steps=1, time=t)["M"][0])
        assert np.allclose(first(0.2), (0.025, 0.1), rtol=1e-12)  # of t^2/2, from time to time + 0.1
        assert np.isnan(first(0.21)).all() and np.isnan(first(-0.01)).all()
    with pytest.raises(kr.InputError, match=r"for all times of the run, 0 to 0\.4"):
        kr.simulate(ball, still, dt=0.1, steps=4)


def test_a_body_in_si() -> None:
    """A measured torque about the axis of a symmetric wheel, whose unit of time is not 1 s: M = integral of it."""
    wheel = kr.physical.FreeBody((2.0, 2.0, 4.0), time_unit=0.1, torque=pushed_about, params={"motor": MOTOR})
    run = kr.simulate(wheel, wheel.state(spin=(0.0, 0.0, 1.0)), dt="50 ms", t_end="8 s", every="1 s")
    want = 4.0 + np.array([PUSH.integ()(t) for t in run.time.values])
    assert (run.momentum if "momentum" in run else run.M).values[:, 2] == pytest.approx(want, rel=1e-9)
    with pytest.raises(kr.InputError, match=r"for all times of the run, 0 to 12\.05, got one from -2 to 12"):
        kr.simulate(wheel, wheel.state(spin=(0.0, 0.0, 1.0)), dt="50 ms", t_end="12.05 s")


def test_derivatives_and_languages() -> None:
    jax = pytest.importorskip("jax")
    from kreisel.reduction import double

    f, p = kr.differentiable(by_tables()), kr.propagator(by_tables(), dt=0.05)
    states = [{**START.axial, "m": np.array([0.1 + x, 0.2, 1.5])} for x in (-1e-6, 0.0, 1e-6)]
    before, _, after = (p.steps(x, 40, time=0.0)["m"][2] for x in states)
    with double():
        slope = jax.jit(jax.grad(lambda x: f(x, dt=0.05, steps=40)["m"][2]))
        left, at, right = (slope(x)["m"] for x in states)
        second = jax.jvp(slope, (states[1],), ({"m": np.eye(3)[0], "a": np.zeros(3)},))[1]["m"]
    assert float(at[0]) == pytest.approx((after - before) / 2e-6, rel=1e-6)
    assert np.asarray(second) == pytest.approx(np.asarray(right - left) / 2e-6, rel=1e-5, abs=1e-7)
    run = kr.simulate(by_tables(), START, **RUN)
    with pytest.raises(kr.InputError, match=r"free: expected parameters or components of .*, got 'load'"):
        kr.fit(by_tables(), run, free=["load"])
    with pytest.raises(kr.InputError, match=r"got the table push.* Write the force as a formula"):
        kr.code(by_tables(), START, dt=0.05)


BAD: dict[str, tuple[Callable[[], object], str]] = {
    "not increasing": (lambda: kr.Table([0, 1, 1, 2], [1, 2, 3, 4]), "got 1 and then 1 at index 2"),
    "backwards": (lambda: kr.Table([0, 2, 1], [1, 2, 3]), "times that increase, got 2 and then 1"),
    "NaN": (lambda: kr.Table([0, 1, 2], [1, np.nan, 3]), "expected finite values, got nan at index 1"),
    "shapes": (lambda: kr.Table([0, 1, 2], [1, 2]), r"times of shape \(3,\) and values of shape \(2,\)"),
    "one time": (lambda: kr.Table([0], [1]), "at least two times"),
    "derivatives": (lambda: kr.Table([0, 1], [1, 2], [1, 2, 3]), r"of the shape \(2,\) of the values"),
    "kind": (lambda: kr.Table([0, 1], [1, 2], kind="linear"), "kind='spline' or 'pchip'"),
    "outside": (lambda: kr.Table([0, 1], [1, 2])(1.5), "expected times from 0 to 1, got 1.5"),
    "lanes": (
        lambda: kr.perturbed(TOP, torque=loaded, params={"load": [kr.Table(range(k), range(k)) for k in (2, 3)]}),
        "the same number of times",
    ),
    "another form": (lambda: by_tables().system(load=kr.Table([0, 1], [1, 2])), "expected a table of the form"),
    "a number": (lambda: by_tables().system(load=(1.0, 2.0, 3.0)), "expected kr.Table"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_tables(name: str) -> None:
    call, message = BAD[name]
    with pytest.raises(kr.InputError, match=message):
        call()
