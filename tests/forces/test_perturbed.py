"""Perturbed bodies: the forces against bodies whose equations are known, energy and work, what survives, bad input."""

from __future__ import annotations

import json
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import kreisel as kr
from kreisel import algebra
from kreisel.forces import kicks
from kreisel.forces.kicks import Body, turns_of
from kreisel.forces.records import conserved
from kreisel.method import auto
from kreisel.record.model import Model
from kreisel.runs import planning

I = np.array([1.0, 1.3, 0.5])  # noqa: E741
MASS = I.sum() / 2 - I
REST = kr.LagrangeTop(p=(0.1, -0.3, 1), alpha=0.7)
MOVING = kr.LagrangeTopMoving(A=(0, 0, 1), alpha=0.5)
FREE = kr.EulerTop(J=MASS)
FLUID = kr.Clebsch(b=(1.0, 0.5, -0.4))


def swing(a: Any, t: Any, *, k: Any) -> Any:
    return k * a[0] ** 2 * np.sin(t) + np.sqrt(1 + a[1] ** 2)


BODIES: dict[str, Model] = {
    "potential of a and t": kr.perturbed(REST, potential=swing, params={"k": 0.3}),
    "potential of g, at rest": kr.perturbed(REST, potential=lambda g, a: g[0, 1] * a[2] + g[2, 0] ** 2),
    "potential of P": kr.perturbed(MOVING, potential=lambda P, *, A: (P @ A) ** 3 + P[0]),
    "potential of g": kr.perturbed(FREE, potential=lambda g, t: np.cos(t) * g[2, 2] ** 2 + g[0, 1]),
    "potential in a fluid": kr.perturbed(FLUID, potential=lambda P: P[0] * P[1]),
    "torque in the body": kr.perturbed(MOVING, torque=lambda P, t: 0.1 * np.sin(t) * P),
    "torque of M": kr.perturbed(FREE, torque=lambda M, *, k: [k * M[1], M[0] * M[2], -k * M[2]], params={"k": 0.2}),
    "torque in space": kr.perturbed(REST, torque=lambda m, a: np.cross(m, a) - 0.1 * m),
    "damping": kr.perturbed(FREE, damping=(0.1, 0.2, 0.3)),
    "damping at rest": kr.perturbed(REST, damping=(0.1, 0.1, 0.3)),
    "inertia": kr.perturbed(MOVING, inertia=I),
    "all": kr.perturbed(
        MOVING,
        inertia=I,
        damping=0.1,
        potential=lambda P, g, t: P[0] * g[1, 1] * t,
        torque=lambda M, P: P - 0.1 * M,
    ),
}
ELLIPSOID = kr.Kirchhoff(C=[[0, 0.5, 0.8], [0.5, 0, 1.2], [0.8, 1.2, 0]], B=(-0.9, -0.7, -0.4))
COUPLING = np.array([[0.1, 0.05, -0.2], [0.05, 0.3, 0.12], [-0.2, 0.12, -0.07]])
BODIES |= {
    "coupling": kr.perturbed(ELLIPSOID, coupling=COUPLING),
    "force": kr.perturbed(ELLIPSOID, force=lambda g, t: 0.3 * g[2] * (1 + t)),
    "coupling and damping": kr.perturbed(ELLIPSOID, coupling=COUPLING, damping=(0.1, 0.2, 0.3)),
    "drag in a fluid": kr.perturbed(
        ELLIPSOID,
        coupling=COUPLING,
        potential=lambda P, g: g[2, 0] + 0.1 * P[0] ** 2,
        torque=lambda M, P: -0.1 * M - 0.2 * P,
        force=lambda M, P, g, *, k: g[2] - k * P * np.sqrt(P @ P) + 0.1 * M,
        params={"k": 0.3},
    ),
}
cases = pytest.mark.parametrize("name", BODIES)


def somewhere(model: Model, seed: int = 0) -> Body:
    rng = np.random.default_rng(seed)
    state = [algebra.hat(rng.normal(size=3)) if k == "skew" else rng.normal(size=3) for k in model.system.space.kinds]
    g = algebra.cayley(algebra.hat(rng.normal(size=3)))
    t = np.float64(rng.random())
    return Body(model.system, tuple(state), {**model.constants, "g": g, "t": t}, model.axes, g, t)


def rates(model: Model, body: Body) -> tuple[tuple[Any, ...], Any]:
    return kicks.rates(body)


def energy(model: Model, body: Body) -> float:
    return float(model.call(model.system.energy, *body.state, g=body.g, t=body.t))


def moved(model: Model, body: Body, h: float) -> Body:
    """By Euler's method along the flow, time and orientation too."""
    flow = model.call(model.system.flow, *body.state, g=body.g, t=body.t)
    omega = model.call(model.system.velocity, *body.state)
    g = (
        algebra.cayley(h / 2 * omega) @ body.g
        if model.system.frame.value == "rest"
        else body.g @ algebra.cayley(h / 2 * omega)
    )
    return body._replace(state=tuple(z + h * f for z, f in zip(body.state, flow, strict=True)), g=g, t=body.t + h)


@cases
def test_the_energy_changes_by_the_work(name: str) -> None:
    """H' = Omega.tau + dV/dt along the flow; so every sign of a force is that of its potential."""
    model = BODIES[name]
    for seed in range(3):
        body = somewhere(model, seed)
        h = 1e-5
        change = (energy(model, moved(model, body, h)) - energy(model, moved(model, body, -h))) / (2 * h)
        assert abs(change - rates(model, body)[1]) < 1e-6 * (1 + abs(change))  # up to 5e-9


def test_a_wrong_sign_of_a_force_changes_the_energy(monkeypatch: pytest.MonkeyPatch) -> None:
    right = kicks.force_of_potential
    monkeypatch.setattr(kicks, "force_of_potential", lambda *a: tuple(-f for f in right(*a)))
    for name in ("potential of P", "potential of g", "potential of g, at rest", "potential in a fluid"):
        with pytest.raises(AssertionError):
            test_the_energy_changes_by_the_work(name)


@cases
def test_the_flows_begin_as_the_rates(name: str) -> None:
    """Kick, damping and turns for a short time are the rates of state and work; the orientation turns along."""
    model = BODIES[name]
    body, h = somewhere(model), 1e-6
    record = kicks.perturbation_of(model.system)
    ends = []
    for time in (h, -h):
        state, work = body.state, 0.0
        if record.functions:
            state, work = kicks.kicked(body, time)
        if record.damping:
            state, gained = kicks.decayed(body._replace(state=state), time)
            work = work + gained
        for turn in turns_of(model).values():
            state, _ = turn(state, (), time, body.constants)
        ends.append((state, work))
    (up, gain), (down, loss) = ends
    wanted, power = rates(model, body)
    for x, y, want in zip(up, down, wanted, strict=True):
        assert abs((x - y) / (2 * h) - want).max() < 1e-7  # 1e-9
    assert abs((gain - loss) / (2 * h) - power) < 1e-7


def test_a_coupling_is_that_of_kirchhoff() -> None:
    """Mixed terms of Kirchhoff's case; the state of any coupling against a Runge-Kutta method, Casimirs conserved."""
    case = kr.KirchhoffCase(a1=1.0, a3=1.4, b1=0.2, b3=0.5, c1=0.3, c3=0.9)
    plain = kr.Kirchhoff(C=[[0, 1.4, 1.0], [1.4, 0, 1.0], [1.0, 1.0, 0]], B=(-0.3, -0.3, -0.9))
    body = kr.perturbed(plain, coupling=(0.2, 0.2, 0.5))
    x = somewhere(body)
    for got, want in zip(body.flow(*x.state), case.flow(*x.state), strict=True):
        assert abs(got - want).max() < 1e-14
    assert abs(energy(body, x) - case.call(case.system.energy, *x.state)) < 1e-14
    start = {"M": (0.3, -0.4, 1.2), "P": (0.5, 0.2, 0.9)}
    asked = {"dt": 0.2, "steps": 50, "every": 50, "progress": False, "orientation": (1, 0, 0, 0)}
    for model in (body, BODIES["coupling"]):
        run, like = kr.simulate(model, start, order=8, **asked), kr.simulate(model, start, method="dop853", **asked)
        for name in ("M", "P"):
            assert abs(run[name][-1] - like[name][-1]).max() < 1e-7
        turns = [algebra.rotation_matrix(r.g.values[-1]) for r in (run, like)]
        assert abs(turns[0] - turns[1]).max() < 1e-7
        assert kr.drift(run).conserved["casimir[0]"]


@pytest.mark.parametrize("name", ["force", "drag in a fluid"])
def test_order_of_forces_in_a_fluid(name: str) -> None:
    """The balance and the state of (2, 2) against steps that are a quarter as long, and of (8, 6, 4)."""
    start = {"M": (0.3, -0.4, 1.2), "P": (0.5, 0.2, 0.9)}
    ends = [
        kr.simulate(
            BODIES[name], start, t_end=4.0, dt=dt, order=order, orientation=(1, 0, 0, 0), progress=False
        ).P.values[-1]
        for dt, order in ((0.1, (2, 2)), (0.05, (2, 2)), (0.2, (8, 6, 4)), (0.1, (8, 6, 4)), (0.025, (8, 6, 4)))
    ]
    off = [abs(end - ends[-1]).max() for end in ends[:-1]]
    assert 1.8 < np.log2(off[0] / off[1]) < 2.2
    assert 3.5 < np.log2(off[2] / off[3])


def test_a_heavy_top_is_a_perturbed_lagrange_top() -> None:
    heavy = kr.HeavyTop(J=MASS, A=(0.2, 0, 1))
    body = kr.perturbed(MOVING, inertia=I, potential=lambda P: 0.2 * P[0])
    x = somewhere(body)
    for got, want in zip(body.flow(*x.state), heavy.flow(*x.state), strict=True):
        assert abs(got - want).max() < 1e-14
    assert abs(energy(body, x) - heavy.call(heavy.system.energy, *x.state)) < 1e-14


def test_a_free_body_with_a_weight_is_a_heavy_top() -> None:
    heavy = kr.HeavyTop(J=MASS, A=(0.2, 0, 1))
    body = kr.perturbed(FREE, potential=lambda g: g[2] @ np.array([0.2, 0, 1]))
    x = somewhere(body)
    P = x.g[2]  # type: ignore[index]
    got = body.call(body.system.flow, *x.state, g=x.g)[0]
    assert abs(got - heavy.flow(x.state[0], P)[0]).max() < 1e-14


@pytest.mark.parametrize(
    ("body", "stays"),
    [
        (kr.perturbed(kr.LagrangeTop(p=(0, 0, 1)), potential=lambda a: a[2] ** 2), {"casimir", "noether"}),
        (kr.perturbed(kr.LagrangeTop(p=(0, 0, 1)), potential=lambda a: np.sqrt(3 + a[2])), {"casimir", "noether"}),
        (kr.perturbed(kr.LagrangeTop(p=(0, 0, 1)), potential=lambda a: a[0]), {"casimir"}),
        (kr.perturbed(kr.LagrangeTop(p=(0, 0, 1)), torque=lambda a: 0.1 * a), {"casimir"}),
        (kr.perturbed(MOVING, inertia=(1.2, 1.2, 0.5)), {"casimir", "noether"}),
        (kr.perturbed(MOVING, inertia=I), {"casimir"}),
        (kr.perturbed(FREE, potential=lambda g: g[2, 2]), set()),
        (kr.perturbed(FREE, inertia=2 * I), {"casimir", "spectrum"}),
        (kr.perturbed(FREE, inertia=I[::-1]), {"casimir"}),
        (kr.perturbed(MOVING, potential=lambda P, *, k: k * P[0], params={"k": [[0.0], [0.1], [0.2]]}), {"casimir"}),
        (kr.perturbed(kr.LagrangeTop(p=(0, 0, 0, 1)), potential=lambda a: a[3] ** 2), {"casimir", "noether"}),
    ],
)
def test_what_survives(body: Model, stays: set[str]) -> None:
    assert set(conserved(body)) == stays


def test_what_survives_in_some_lanes_alone_does_not() -> None:
    k = np.zeros(100)
    k[7] = 1e-9
    top = kr.LagrangeTop(p=(0, 0, 1), alpha=0.5)
    assert conserved(kr.perturbed(top, potential=lambda a, *, k: k * a[0], params={"k": k})) == ("casimir",)
    tilted = kr.LagrangeTop(p=np.array([[0, 0, 1.0], [0, 0, 2], [0.1, 0, 1]]))
    assert conserved(kr.perturbed(tilted, potential=lambda a: a[2] ** 2)) == ("casimir",)


def test_a_small_asymmetry_beside_a_large_force_is_seen() -> None:
    top = kr.LagrangeTop(p=(0, 0, 1))
    assert conserved(kr.perturbed(top, potential=lambda a, t: 1e3 * np.cos(3 * t) * a[2] + 3e-7 * a[0])) == ("casimir",)
    assert conserved(kr.perturbed(top, potential=lambda a: np.exp(a[2]) + 1e-10 * a[0])) == ("casimir",)


def test_casimirs_that_a_torque_changes_are_left_out() -> None:
    body = kr.perturbed(kr.LagrangeTop(p=(0, 0, 1)), torque=lambda a: 0.1 * a)
    state = body.state(m=(0.1, 0.2, 1.5), a=(0.6, 0, 0.8))
    assert body.call(body.system.space.casimirs, *state.values()).tolist() == [1.0]  # |a|^2 without (m.a)^2


def test_without_forces_nothing_changes() -> None:
    assert kr.perturbed(MOVING) is MOVING


BAD: dict[str, tuple[Callable[[], Any], str]] = {
    "no system": (lambda: kr.perturbed(3, damping=0.1), "a system with its parameters"),
    "a perturbed one": (lambda: kr.perturbed(BODIES["damping"], damping=0.1), "an integrable system"),
    "no function": (lambda: kr.perturbed(REST, potential=3), "expected a function"),
    "a wrong letter": (lambda: kr.perturbed(REST, potential=lambda b: b[0]), "among m, a, g, t"),
    "a wrong parameter": (lambda: kr.perturbed(REST, potential=lambda a, *, k: k), "p, alpha"),
    "stars": (lambda: kr.perturbed(REST, potential=lambda *a: 0), "got 'a'"),
    "of the momentum": (lambda: kr.perturbed(REST, potential=lambda m: m @ m), "inertia="),
    "a vector": (lambda: kr.perturbed(REST, potential=lambda a: a), "expected one number"),
    "a list": (lambda: kr.perturbed(REST, potential=lambda a: [1, 2]), "expected one number"),
    "a branch": (lambda: kr.perturbed(REST, potential=lambda a: max(a[0], 0)), "np.maximum"),
    "an error": (lambda: kr.perturbed(REST, potential=lambda a: a[7]), "IndexError"),
    "a torque of two": (lambda: kr.perturbed(REST, torque=lambda a: a[:2]), "3 values"),
    "inertia at rest": (lambda: kr.perturbed(REST, inertia=I), "LagrangeTopMoving"),
    "ragged inertia": (lambda: kr.perturbed(MOVING, inertia=(1, 1, [0.5, 0.7])), "ragged"),
    "inertia below 0": (lambda: kr.perturbed(MOVING, inertia=(1, 1, -1)), "> 0"),
    "no numbers": (lambda: kr.perturbed(MOVING, damping="much"), "real values"),
    "params of no dict": (lambda: kr.perturbed(REST, potential=lambda a: a[0], params=3), "a dict"),
    "a taken name": (lambda: kr.perturbed(REST, potential=lambda a: a[0], params={"p": 1}), "other than"),
    "an own name": (lambda: kr.perturbed(REST, damping=0.1, name=""), "a name"),
    "axes": (lambda: kr.perturbed(kr.LagrangeTopMoving(A=(0, 1, 1), alpha=0.5), inertia=I), "principal axes"),
    "a name of the record": (lambda: kr.perturbed(REST, potential=lambda a: a[0], params={"eps": 1}), "other than"),
    "a name of another record": (
        lambda: kr.perturbed(kr.SymmetricTop(A=(0, 0, 1)), potential=lambda P: P[0], params={"alpha": 0.5}),
        "other than",
    ),
    "a name of ours": (lambda: kr.perturbed(REST, potential=lambda a: a[0], params={"_dt": 1}), "begin with a letter"),
    "a name that Python takes": (
        lambda: kr.perturbed(REST, potential=lambda a: a[0], params={"self": 1}),
        "other than",
    ),
    "a system's name": (lambda: kr.perturbed(REST, damping=0.1, name="clebsch"), "no system of Kreisel"),
    "a force on a top": (lambda: kr.perturbed(MOVING, force=lambda P: P), "moves through space"),
    "a coupling of a top": (lambda: kr.perturbed(MOVING, coupling=(1, 2, 3)), "moves through space"),
    "a coupling that is not symmetric": (lambda: kr.perturbed(ELLIPSOID, coupling=np.eye(3, k=1)), "symmetric"),
    "a force of two numbers": (lambda: kr.perturbed(ELLIPSOID, force=lambda P: P[:2]), "force: expected 3 values"),
    "axes that are not principal": (
        lambda: kr.simulate(
            kr.perturbed(kr.HeavyTop(J=[[2, 0.5, 0], [0.5, 2, 0], [0, 0, 1]], A=(0, 0, 1)), torque=lambda M: -M),
            {"M": (1, 2, 3), "P": (0, 0, 1)},
            dt=0.1,
            steps=1,
            progress=False,
        ),
        "principal axes",
    ),
    "a matrix that is not skew": (lambda: kr.perturbed(FREE, torque=lambda g: g), "not skew"),
    "damping across the axis": (lambda: kr.perturbed(REST, damping=(0.1, 0.2, 0.3)), "are alike"),
    "an equality": (lambda: kr.perturbed(REST, potential=lambda a: a[0] if a[0] == 0.5 else a[1]), "no `if`"),
    "nothing": (lambda: kr.perturbed(REST, potential=lambda a: None), "expected one number"),
    "a complex potential": (lambda: kr.perturbed(REST, potential=lambda a: 1j * a[0]), "real values"),
    "a complex torque": (lambda: kr.perturbed(FREE, torque=lambda M: 1j * M), "real values"),
    "no momentum": (lambda: kr.perturbed(kr.Neumann(b=(1, 2, 3)), damping=0.1), "only a potential"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_refused(case: str) -> None:
    make, words = BAD[case]
    with pytest.raises(kr.InputError, match=words):
        make()


def test_a_thin_body_in_fast_rotation_for_a_million_steps() -> None:
    """The body of MuJoCo's issue 3553, which ended there after 4294 steps of 1 ms, here with a weak torque beside."""
    inertia = np.array([1.7231e-4, 6.58e-6, 1.7243e-4])
    body = kr.perturbed(kr.EulerTop(J=inertia.sum() / 2 - inertia), potential=lambda g: 1e-6 * g[2, 2])
    run = kr.simulate(
        body,
        body.state(M=inertia * (20, 300, 10)),
        dt=1e-3,
        steps=10**6,
        every=10**4,
        order=(2, 2),
        orientation=(1, 0, 0, 0),
    )
    off = abs(run.energy - run.energy[0]).values / float(run.energy[0])
    assert off.max() < 1e-6
    assert off[-10:].max() < 5 * off[1:11].max()
    assert abs((run.g.values**2).sum(-1) - 1).max() < 1e-11


@pytest.mark.parametrize("middle", [5.0, 20.0, 95.0])
def test_a_pulse_changes_what_it_changes(middle: float) -> None:
    """A force that is nothing but for a while: seen at many times, not at one."""
    top = kr.LagrangeTop(p=(0, 0, 1))
    pulse = kr.perturbed(top, potential=lambda a, t: 0.1 * a[2] ** 2 + 0.1 * a[0] * np.exp(-(((t - middle) / 2) ** 2)))
    assert conserved(pulse) == ("casimir",)
    even = kr.perturbed(top, potential=lambda a, t: 0.1 * a[2] ** 2 * np.exp(-(((t - middle) / 2) ** 2)))
    assert set(conserved(even)) == {"casimir", "noether"}


@pytest.mark.filterwarnings("ignore:invalid value:RuntimeWarning")  # inf - inf, when the torque is tried
def test_nothing_is_claimed_of_a_force_that_overflows_at_all_times() -> None:
    assert conserved(kr.perturbed(FREE, torque=lambda M, t: M * np.exp(1e4 * (6 + t)))) == ()


def swinging(**forces: Any) -> Any:
    return kr.perturbed(kr.LagrangeTop(p=(0, 0, 1)), **forces)


SWING = {"m": (0.1, 0.2, 0.5), "a": (0.6, 0, 0.8)}


def test_a_force_that_is_no_number_is_named_as_the_cause() -> None:
    """The root of a negative number, in runs, propagators and DOP853."""
    body, named = swinging(potential=lambda a: (a[2] - 0.7) ** 1.5), "a force that is not a number there"
    for method in ("splitting", "dop853"):
        with pytest.raises(kr.RunError, match=named):
            kr.simulate(body, SWING, dt=0.05, steps=100, method=method)
    low = np.array([0.1, 0.2, 0.5, 0.8, 0, 0.6])
    with pytest.raises(kr.RunError, match=named):
        kr.propagator(body, dt=0.05).steps(low, 10)


def test_a_gyrostat_under_gravity() -> None:
    """Its closed form is the integrable part: by DOP853, and the energy, with steps of a radian."""
    body = kr.perturbed(
        kr.ZhukovskyVolterra(J=(0.7, 1.1, 1.6), h=(0.3, -0.5, 0.8)), potential=lambda g: 0.01 * g[2, 0] * g[2, 1]
    )
    options = {"dt": 1.0, "steps": 60, "every": 20, "orientation": (1, 0, 0, 0), "progress": False}
    run, truth = (kr.simulate(body, {"M": (0.9, -0.4, 1.3)}, **options, **m) for m in ({}, REFERENCE))
    assert abs(run.M - truth.M).max() < 1e-7 and abs(abs((run.g * truth.g).sum("quaternion")) - 1).max() < 1e-7
    assert abs(run.energy - run.energy[0]).max() < 1e-9


REFERENCE: dict[str, Any] = {"method": "dop853", "tol": 1e-12}
HEAVY = kr.EulerTop(J=(7, 5, 3))  # moments 8, 10, 12
LONG_KICKS = {  # a body, a step too long for its kicks, one that is not
    "a torque of the momentum": (
        kr.perturbed(HEAVY, torque=lambda M: np.array([-M[2] / 12, 0 * M[1], M[0] / 8])),  # a wheel of -1 about e_2
        30.0,
        4.0,
    ),
    "a potential of the orientation": (kr.perturbed(HEAVY, potential=lambda g: 5 * g[0, 1] ** 2), 30.0, 0.25),
    "a force that swings": (kr.perturbed(HEAVY, torque=lambda t: np.array([np.sin(t), 0 * t, 0 * t])), 30.0, 0.5),
}


@pytest.mark.parametrize("name", LONG_KICKS)
def test_a_step_too_long_for_its_kicks_is_warned_of_before(name: str) -> None:
    """Whatever the kick comes from; a run that fails names that cause, and neither roots nor logarithms."""
    body, long, short = LONG_KICKS[name]
    options = {"steps": 400, "every": 400, "orientation": (1, 0, 0, 0), "observe": [], "progress": False}
    start = {"M": (0.01, -0.02, 0.03)}
    with pytest.warns(kr.AccuracyWarning, match=r"4 steps from the start .* a torque, a force or .* Use a dt of"):
        try:
            kr.simulate(body, start, dt=long, **options)
        except kr.RunError as error:
            swings = name == "a force that swings"  # the closed form follows until its guard ends the run
            cause = "a perturbation that sped the body up" if swings else "a step too long for its kicks"
            assert cause in str(error) and "negative number" not in str(error)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        kr.simulate(body, start, dt=short, **options)


def test_a_perturbation_too_large_for_its_step_is_warned_of() -> None:
    def run(k: float, dt: float = 0.3) -> Any:
        body = swinging(potential=lambda a, *, k: k * a[0] ** 2, params={"k": k})
        return kr.simulate(body, SWING, dt=dt, steps=100, order=(2, 2))

    late = pytest.warns(kr.AccuracyWarning, match="energy oscillates by .* the step is too long")
    with pytest.warns(kr.AccuracyWarning, match="too long for the forces"), late:
        run(5.0, 0.4)
    for k, dt in ((0.1, 0.3), (5.0, 0.02)):
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            run(k, dt)


def test_a_lane_of_a_large_ensemble_needs_a_smaller_step(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(planning, "MOST_NUMBERS", 100)
    monkeypatch.setattr(planning, "SAMPLE", 3)
    for k in (0.1, 5.0):
        body = swinging(potential=lambda a, *, k: k * a[0] ** 2, params={"k": np.r_[np.full(17, 0.1), k, 0.1, 0.1]})
        with warnings.catch_warnings(record=True) as seen:
            warnings.simplefilter("always")
            kr.simulate(body, SWING, dt=0.4, steps=1, order=(2, 2))
        assert ["too long for the forces" in str(w.message) for w in seen] == [True] * (k > 1)


CHAOTIC = swinging(potential=lambda a: 0.1 * a[0] ** 2)


def test_chaos_is_warned_of_where_a_step_is_chosen(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the motion is longer than what is run of it before."""
    monkeypatch.setattr(auto, "CHAOTIC", 1)
    asked = {"dt": 1.0, "steps": 200, "every": 10, "order": "auto", "tol": 1e-3}
    with pytest.warns(kr.AccuracyWarning, match="neighbours part much faster, as in chaos"):
        kr.simulate(CHAOTIC, SWING, **asked)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        kr.simulate(swinging(potential=lambda a: 0.1 * a[2] ** 2), SWING, **asked)


@pytest.mark.parametrize("tol", [1e-3, 1e-5])
def test_a_chaotic_motion_is_run_to_its_end_before(tol: float) -> None:
    """Nothing is warned of, and the error is below the tolerance."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        run = kr.simulate(CHAOTIC, SWING, dt=200.0, steps=1, order="auto", tol=tol)
    truth = kr.simulate(CHAOTIC, SWING, dt=1 / 64, steps=12800, every=12800, order=8)
    off = max(abs(run[k][-1] - truth[k][-1]).max() / abs(truth[k][-1]).max() for k in SWING)
    assert off <= json.loads(run.attrs["options"])["expected_error"] <= tol
