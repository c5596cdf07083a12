"""kr.compare, and maps of users that are not Poisson: Runge-Kutta and the midpoint rule on a body in a cubic field."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import kreisel as kr
from kreisel.algebra import act, dot, pairing, wedge
from kreisel.lab import laws
from kreisel.record.contract import MOVING_SPACE, Map, Parameter, System


def force(P, c):
    return c * P * P * P


def flow(M, P, *, c):
    return wedge(force(P, c), P), -act(M, P)


def energy(M, P, *, c):
    return pairing(M, M) / 2 + dot(P, force(P, c)) / 4


def runge_kutta(M, P, *, c, eps):
    def at(rate, part):
        return flow(M + eps / part * rate[0], P + eps / part * rate[1], c=c)

    first = flow(M, P, c=c)
    second = at(first, 2)
    third = at(second, 2)
    rates = zip((M, P), first, second, third, at(third, 1), strict=True)
    return tuple(z + eps / 6 * (r + 2 * s + 2 * t + u) for z, r, s, t, u in rates)


def euler(M, P, *, c, eps):
    return tuple(z + eps * rate for z, rate in zip((M, P), flow(M, P, c=c), strict=True))


RK4 = System(
    name="cubic-body",
    title="Body in a cubic field",
    equations="M' = grad V ^ P,  P' = -M P",
    source="this test",
    space=MOVING_SPACE,
    parameters=(Parameter("c", "vector", "strength"),),
    flow=flow,
    energy=energy,
    velocity=lambda M, P: M,
    inverse_inertia=lambda M: M,
    scaling="1",
    map=Map(step=runge_kutta, order=4, poisson=False, conserves=()),
)
BODY, START = RK4(c=(1.0, 2.0, 3.0)), {"M": (0.3, 0.1, 0.9), "P": (0.6, 0.0, 0.8)}


def test_claims_of_a_map_that_is_not_poisson_are_believed_and_tested() -> None:
    run = kr.simulate(BODY, START, dt=0.2, steps=2_000, progress=False)
    table = kr.drift(run)
    assert run.attrs["method"] == "map" and not table.conserved.any()
    assert table.max_change["casimir[1]"] > 1e-7  # no projection hides the change
    verdicts = laws.check(RK4, dimensions=[3])
    assert all(v.holds for v in verdicts) and {"order", "continuous-limit"} < {v.law for v in verdicts}
    wrong = {"order": {"order": 3}, "integrals-of-the-map": {"conserves": ("energy",)}, "poisson": {"poisson": True}}
    for name, claim in wrong.items():
        false = laws.check(replace(RK4, map=replace(RK4.map, **claim)), dimensions=[3])
        assert name in {v.law for v in false if not v.holds}


def test_order_drift_and_poisson_defect_of_methods() -> None:
    """The Poisson defect of a method of order p that is not Poisson falls as dt^(p + 1)."""
    subjects = {"RK4": BODY, "variational": (BODY, {"method": "variational", "order": 2})}
    coarse, fine = (kr.compare(subjects, START, dt=dt, t_end=100.0) for dt in (0.1, 0.05))
    table = coarse.table
    assert np.allclose(table.order, [4, 2], atol=0.1) and list(table.index) == [*subjects]
    assert np.log2(table.poisson_defect["RK4"] / fine.table.poisson_defect["RK4"]) == pytest.approx(5, abs=0.3)
    assert table.poisson_defect["variational"] < 1e-11 < 1e-8 < table.poisson_defect["RK4"]
    assert (table.worst == "energy").all() and (table.cost > 0).all()
    assert coarse.drifts[0, -1] == table["drift"]["RK4"] and (np.diff(coarse.drifts) >= 0).all()
    assert "RK4" in coarse._repr_html_() and len(coarse.plot().axes) == 2


def test_a_function_replaces_the_step_of_a_system() -> None:
    """As a record of the user with the same map, and not the default method of the system."""
    table = kr.compare({"RK4": BODY, "Euler": (BODY, euler)}, START, dt=0.05, t_end=5.0).table
    assert np.allclose(table.order, [4, 1], atol=0.1) and table.poisson_defect["Euler"] > 1e-6
    top = kr.LagrangeTopMoving(A=(0, 0, 1))

    def explicit(M, P, *, A, alpha, eps):
        return tuple(z + eps * v for z, v in zip((M, P), top.system.flow(M, P, A=A, alpha=alpha), strict=True))

    table = kr.compare({"mine": (top, explicit), "default": top}, START, dt=0.05, t_end=5.0).table
    assert np.allclose(table.order, [1, 2], atol=0.15)


def test_other_flows_and_variables_are_refused() -> None:
    with pytest.raises(kr.InputError, match="one flow"):
        kr.compare([BODY, RK4(c=(1.0, 2.0, 4.0))], START, dt=0.1, t_end=1.0)
    with pytest.raises(kr.InputError, match="the same variables"):
        kr.compare([BODY, kr.EulerTop(J=(1, 2, 3))], START, dt=0.1, t_end=1.0)
    with pytest.raises(kr.InputError, match="got 'RK4'"):
        kr.compare(["RK4"], START, dt=0.1, t_end=1.0)


def test_a_figure_compares_systems_with_the_same_variables() -> None:
    known = kr.LagrangeTopMoving(A=(0, 0, 1))
    runs = [kr.simulate(body, START, dt=0.1, steps=50, progress=False) for body in (BODY, known)]
    assert "Body in a cubic field" in kr.plot(runs[1], compare=runs[0]).get_suptitle()
    with pytest.raises(kr.InputError, match="with the variables M, P"):
        free = kr.simulate(kr.EulerTop(J=(1, 2, 3)), {"M": (0.3, 0.1, 0.9)}, dt=0.1, steps=50, progress=False)
        kr.plot(runs[1], compare=free)


def test_bodies_are_compared_in_seconds() -> None:
    """As its system in units of its time."""
    body = kr.physical.FreeBody((1.0, 2.0, 3.0))
    start, unit = body.state((0.3, 0.1, 0.9)), body.model().body_frame.time_unit
    found = kr.compare([body, (body, {"method": "dop853"})], start, dt="0.1 s", t_end="2 s", halvings=1)
    scaled = kr.compare([body.model()], start, dt=0.1 / unit, t_end=2.0 / unit, halvings=1)
    assert found.errors.dt.values.tolist() == pytest.approx([0.1, 0.05]) and found.drifts.time.values[
        -1
    ] == pytest.approx(2.0)
    assert found.table.error.iloc[0] == scaled.table.error.iloc[0]
    with pytest.raises(kr.InputError, match="either bodies or systems"):
        kr.compare([body, body.model()], start, dt="0.1 s", t_end="2 s")


@pytest.mark.parametrize("step", [lambda m, a, *, eps: (m,), lambda m, a, *, eps: a, lambda m, a, *, eps: (m, a, a)])
def test_a_step_must_return_the_components_of_the_state(step):
    top = kr.LagrangeTop(p=(0, 0, 1))
    start = top.state(m=(0.1, 0.2, 1.5), a=(0.6, 0, 0.8))
    with pytest.raises(kr.InputError, match=r"step: expected .*components"):
        kr.compare({"mine": (top, step)}, start, dt=0.1, t_end=1)


def test_the_subject_that_fails_is_named() -> None:
    """Explicit Euler's rule with such steps goes to infinity."""
    subjects = [(BODY, {"method": "dop853"}), (BODY, euler)]
    with pytest.raises(kr.RunError, match=r"^subjects\[1\]: .* finite"):
        kr.compare(subjects, START, dt=0.5, t_end=100, halvings=1)
    with pytest.raises(kr.RunError, match=r"^Euler: .* finite"):
        kr.compare(dict(zip(("DOP853", "Euler"), subjects, strict=True)), START, dt=0.5, t_end=100, halvings=1)
