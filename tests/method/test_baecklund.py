"""method="baecklund": coefficients, domain, high orders, round-off; the laws test the maps themselves."""

from __future__ import annotations

import sys
from dataclasses import replace

import mpmath
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import kreisel as kr
import walks
from kreisel import algebra
from kreisel.kernels.cpu import points
from kreisel.lab import exact
from kreisel.lab.law import baecklund_orders
from kreisel.method import scheme
from kreisel.method.baecklund import pade_denominator, pade_zeros, spin_turns, stage_points
from kreisel.record.model import Model
from kreisel.system import REGISTRY
from sizes import FULL, full
from support import cpu_engine

METHOD = sys.modules["kreisel.method.baecklund"]  # the package has a function of that name
SYSTEMS = [name for name, system in REGISTRY.items() if system.baecklund is not None]


@pytest.mark.parametrize("stages", [1, 2, 3, 6, 12])
def test_order_conditions(stages: int) -> None:
    zeros = [complex(z) for z in pade_zeros(stages)]
    eps = [2 / z for zeta in zeros for z in ([zeta, zeta.conjugate()] if zeta.imag else [zeta])]
    assert len(eps) == stages
    assert all(e.real > 0 for e in eps)
    for power in range(1, 2 * stages, 2):
        assert abs(sum(e**power for e in eps) - (power == 1)) < 1e-13
    assert abs(sum(e ** (2 * stages + 1) for e in eps)) > 1e-12 ** (stages / 4)


@pytest.mark.parametrize("stages", [1, 2, 3, 6, 12])
def test_a_wrong_sign_of_any_coefficient_is_caught(stages: int, monkeypatch: pytest.MonkeyPatch) -> None:
    for place in range(stages + 1):
        wrong = [-c if j == place else c for j, c in enumerate(pade_denominator(stages))]
        monkeypatch.setattr(METHOD, "pade_denominator", lambda k, wrong=wrong: wrong)
        with pytest.raises(ArithmeticError, match="the sum of eps"):
            pade_zeros.__wrapped__(stages)


@pytest.mark.parametrize(("order", "which"), [(6, 0), (6, 1), (8, 0), (8, 1)])  # pair and real stage; two pairs
@pytest.mark.parametrize("name", SYSTEMS)
def test_a_dropped_stage_is_caught_by_the_order(
    name: str, order: int, which: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    model, state = start(name, 3, 1)
    counts = (4, 6, 8)
    assert min(baecklund_orders(model, state, order, counts, 1.0)) > order - 1

    def dropped(order: int, dt: float) -> list[complex | float]:
        return [mu for i, mu in enumerate(stage_points(order, dt)) if i != which]

    monkeypatch.setattr(METHOD, "stage_points", dropped)
    assert max(baecklund_orders(model, state, order, counts, 1.0)) < 1


def start(name: str, n: int, seed: int = 0) -> tuple[object, tuple[np.ndarray, ...]]:
    draw = exact.float_random(np.random.default_rng([seed, n]))
    return exact.random_model(REGISTRY[name], n, draw), REGISTRY[name].space.point(n, draw)


def growth(model: object, z: tuple[np.ndarray, ...]) -> float:
    """The change of Casimirs and spectrum over 40 steps of 2, from a state 1e-9 off the level set of rho, over 1e-9."""
    off = (z[0], z[1] * (1 + 1e-9)) if model.system.space.constraints else (z[0] * (1 + 1e-9), *z[1:])
    plan, w = scheme(model, "baecklund", 2.0, 4, False).on(z), off
    with np.errstate(all="ignore"):
        for _ in range(40):
            w = plan.advance(*w)
    functions = (model.system.space.casimirs, *model.system.integrals.values())
    before, after = (np.concatenate([np.ravel(model.call(f, *x)) for f in functions]) for x in (off, w))
    return float((abs(after - before) / 1e-9 / (1 + abs(before))).max())


@pytest.mark.parametrize("seed", range(3, 7))
@pytest.mark.parametrize("name", SYSTEMS)
def test_nothing_grows_across_the_level_sets(name: str, seed: int) -> None:
    assert growth(*start(name, 3, seed)) < 1e-3


def test_with_rho_fixed_it_does() -> None:
    top = REGISTRY["lagrange-top"]

    def fixed(m, a, *, p, mu, rho):
        return 2 * algebra.shifted_resolvent(mu, m, a - rho * p)

    mutant = replace(top, baecklund=replace(top.baecklund, vector=fixed))
    model, z = start("lagrange-top", 3, 3)
    assert not growth(mutant(**model.params), z) < 10


@pytest.mark.parametrize(("n", "order", "oriented"), [(3, 2, True), (3, 4, False), (3, 10, True), (4, 2, False)])
@pytest.mark.parametrize("name", SYSTEMS)
def test_kernel_equals_definition(name: str, n: int, order: int, oriented: bool) -> None:
    model, z = start(name, n)
    z += (np.array([1.0, 0, 0, 0]),) if oriented else ()
    plan = scheme(model, "baecklund", 0.1, order, oriented).on(z)
    kinds = [kind for _, kind in plan.components]
    kernel = cpu_engine(plan, algebra.flatten(z, kinds)[None])
    out = np.empty((1, 1, kernel.z.shape[1]))
    kernel.advance(out, 3)
    for _ in range(3):
        z = plan.advance(*z)
    assert abs(out[0, 0] - algebra.flatten(z, kinds)).max() < 1e-12


@pytest.mark.parametrize(("n", "revolution"), [(6, False), (7, True), *full((6, True), (7, False))])
def test_large_bodies_with_a_real_stage_follow_the_equations_of_motion(n: int, revolution: bool) -> None:
    draw = np.random.default_rng(n)
    i, j = np.triu_indices(n, 1)
    b, c, start = draw.normal(size=n), np.ones(len(i)), draw.normal(size=len(i) + n)
    body = kr.Clebsch(b=b)
    if revolution:  # a1 of the planes with the axis, a3 of the others
        body = kr.KirchhoffRevolution(a1=1.3, a3=0.8, c1=0.9, c3=0.4, n=n)
        b, c = -np.array([0.9] * (n - 1) + [0.4]), np.where(j == n - 1, 1.3, 0.8)

    def rate(_: float, z: np.ndarray) -> np.ndarray:  # M' = [M, Omega] + P ^ BP, P' = -Omega P
        M, Omega, P = np.zeros((n, n)), np.zeros((n, n)), z[len(i) :]
        M[i, j], Omega[i, j] = z[: len(i)], c * z[: len(i)]
        M, Omega = M - M.T, Omega - Omega.T
        change = M @ Omega - Omega @ M + np.outer(P, b * P) - np.outer(b * P, P)
        return np.append(change[i, j], -Omega @ P)

    right = solve_ivp(rate, (0, 0.5), start, method="DOP853", rtol=1e-13, atol=1e-13).y[:, -1]
    for order in (2, 6):  # the default, and one with pairs too
        off = [
            abs(kr.propagator(body, method="baecklund", order=order, dt=0.5 / k).steps(start, k) - right).max()
            for k in (4, 8)
        ]
        assert off[1] < 0.1 and abs(np.log2(off[0] / off[1]) - order) < 0.3, (order, off)


@pytest.mark.parametrize("name", SYSTEMS)
@pytest.mark.parametrize(("order", "counts", "time"), [(8, (2, 3, 4), 1.0), (12, (2, 3, 4), 2.5)])
def test_high_orders(name: str, order: int, counts: tuple[int, ...], time: float) -> None:
    model, state = start(name, 3, 1)
    for slope in baecklund_orders(model, state, order, counts, time):
        assert abs(slope - order) < 0.1 * order


@pytest.mark.parametrize("order", [2, 4, 8])
@pytest.mark.parametrize("name", SYSTEMS)
def test_integrals_of_the_flow_stay_at_round_off(name: str, order: int) -> None:
    model, z = start(name, 3)
    run = kr.simulate(
        model,
        dict(zip(REGISTRY[name].space.letters, z, strict=True)),
        dt=0.1,
        steps=100_000,
        every=1000,
        order=order,
        progress=False,
    )
    table = kr.drift(run)
    assert table["conserved"].all()
    assert {"energy", "spectrum[0]"} <= set(table.index)
    walks.assert_still(run)


@pytest.mark.parametrize("size", [1e160, 1e308])
@pytest.mark.parametrize("order", [2, 4])
def test_states_whose_squares_overflow_are_refused(size: float, order: int) -> None:
    body = kr.Neumann(b=(1.0, 2.0, 3.5))
    with pytest.raises(kr.InputError, match="so large that its square overflows"):
        kr.simulate(body, {"x": (1, 0, 0), "q": (0, size, 0.1)}, dt=0.05, steps=4, order=order)


def test_a_step_that_overflows_is_not_told_to_be_below_infinity() -> None:
    state = {"m": (0.3, 0.4, 0.5), "a": (0.6, 0, 0.8)}
    with pytest.raises(kr.InputError, match="so large that its square overflows"):
        kr.simulate(kr.LagrangeTop(p=(0, 0, 1)), state, dt=1e300, steps=2, method="baecklund", order=2)


def test_a_step_beyond_the_domain_says_how_far_it_goes() -> None:
    top = kr.LagrangeTop(p=(0, 0, 1))
    x0 = top.state(m=(0.1, 0, 0.2), a=(0.3, 0, -0.95))
    with pytest.raises(kr.InputError, match="does not reach as far as dt = 50") as caught:
        kr.simulate(top, x0, dt=50, steps=1, order=2)
    largest = float(str(caught.value).partition("dt < ")[2].split()[0])
    with pytest.raises(kr.InputError):
        kr.simulate(top, x0, dt=1.001 * largest, steps=1, order=2)
    for order, dt in ((2, 0.999 * largest), (6, 1.5 * largest), (4, 50)):
        run = kr.simulate(top, x0, dt=dt, steps=3, order=order)
        walks.assert_still(run, size=10)  # so close to it an error of the root is felt more


@pytest.mark.parametrize("order", [1, 3, 0, 26, True, 2.5])
def test_orders_that_there_are_not(order: object) -> None:
    top = kr.LagrangeTop(p=(0, 0, 1))
    with pytest.raises(kr.InputError, match=r"expected one of its orders|order: expected an integer"):
        kr.simulate(top, top.state(m=(0, 0, 1), a=(1, 0, 0)), dt=0.1, steps=1, method="baecklund", order=order)


def test_a_body_without_a_field_and_one_without_a_state() -> None:
    free = kr.LagrangeTop(p=(0, 0, 0))
    run = kr.simulate(free, free.state(m=(0.1, 0.2, 1), a=(1, 0, 0)), dt=0.1, steps=100, order=4)
    walks.assert_still(run)
    body = kr.Clebsch(b=(1, 2, 3))
    with pytest.raises(kr.InputError, match="a state or a field that is zero"):
        kr.simulate(body, body.state(M=(0, 0, 1), P=(0, 0, 0)), dt=0.1, steps=1)


def test_lanes_have_constants_of_their_own() -> None:
    top = kr.LagrangeTop(p=(0, 0, 1))
    m = np.array([(0.1, 0.2, 1.5), (0.3, -0.2, 4.0)])
    a = np.array([(0.6, 0, 0.8), (0.6, 0, -0.8)])
    both = kr.simulate(top, top.state(m=m, a=a), dt=0.2, steps=50, order=4)
    for lane in (0, 1):
        one = kr.simulate(top, top.state(m=m[lane], a=a[lane]), dt=0.2, steps=50, order=4)
        assert abs(one["m"].values - both["m"].values[:, lane]).max() < 1e-12


def newton_step(model: Model, state: tuple[np.ndarray, ...], mu: complex, rho: complex) -> mpmath.mpc:
    """How far rho is from the root of <e, e> = 4 rho, (mu - m) e = 2 (a - rho p), of the top.

    Of Clebsch's body: of <P, Q> = rho, (mu - rho C + M) Q = P, C = B - max b.
    """
    X, v, w = (mpmath.matrix(x.tolist()) for x in (*state, *model.params.values()) if x.ndim)
    one, mu, rho = mpmath.eye(len(v)), mpmath.mpmathify(mu), mpmath.mpmathify(rho)

    def dot(x: mpmath.matrix, y: mpmath.matrix) -> mpmath.mpc:
        return sum(x[i] * y[i] for i in range(len(v)))

    if model.system.name == "lagrange-top":
        e, h = (mpmath.lu_solve(mu * one - X, 2 * x) for x in (v - rho * w, w))
        return (dot(e, e) - 4 * rho) / (4 + 2 * dot(e, h))
    C = mpmath.diag([float(x - max(w)) for x in w])  # rounded, as parameters are
    Q, Y = (mpmath.lu_solve(mu * one - rho * C + s * X, v) for s in (1, -1))
    return (dot(v, Q) - rho) / (1 - dot(Y, C * Q))


def near(model: Model, state: tuple[np.ndarray, ...], mu: complex, rho: complex) -> bool:
    """Whether rho is the root, rounded once."""
    off = newton_step(model, state, mu, rho)
    return all(
        abs(x) < 0.501 * np.spacing(abs(y)) for x, y in ((off.real, rho.real), (mpmath.im(off), rho.imag)) if x or y
    )


@pytest.mark.parametrize(
    ("name", "n", "dt", "order"),
    [
        ("lagrange-top", 3, 0.1, 2),
        ("lagrange-top", 3, 0.1, 8),
        ("lagrange-top", 5, 0.1, 8),
        ("clebsch", 3, 0.1, 2),
        ("clebsch", 3, 300.0, 4),
        ("clebsch", 5, 0.1, 8),
    ],
)
def test_constants_of_a_trajectory_are_those_of_their_curve_rounded_once(
    name: str, n: int, dt: float, order: int
) -> None:
    for seed in range((20 if FULL else 6) if n == 3 else 4):
        model, state = start(name, n, seed)
        made = scheme(model, "baecklund", dt, order, False)
        plan = made.on(state, points)
        mus, rhos = (
            (np.array([plan.constants[k]]) if order == 2 else plan.stages[f"{k}_re"] + 1j * plan.stages[f"{k}_im"])
            for k in ("mu", "rho")
        )
        with mpmath.workdps(50):
            for mu, rho in zip(mus.tolist(), rhos.tolist(), strict=True):
                assert near(model, state, mu, rho) and (name != "clebsch" or rho.real > 0)
                assert not near(model, state, mu, rho * (1 + 4e-16))
        for lanes in (5, 64):
            many = made.on(tuple(np.stack([x * (1 + 0.1 * k) for k in range(lanes)]) for x in state), points)
            for key, value in ({**plan.constants, **plan.stages}).items():
                if key.startswith("rho"):
                    assert (({**many.constants, **many.stages})[key][0] == value).all()


@pytest.mark.parametrize("name", ["lagrange-top", "clebsch"])
def test_constants_of_long_steps_are_those_by_arrays(name: str) -> None:
    for seed in range(20):
        model, state = start(name, 3, seed)
        made = scheme(model, "baecklund", 20.0, 8, False)
        by_arrays, compiled = made.on(state).stages, made.on(state, points).stages
        for key in ("rho_re", "rho_im"):
            assert abs(by_arrays[key] - compiled[key]).max() < 1e-12 * abs(by_arrays["rho_re"] + 1j).max()


RATES = {
    "different": (3.0, 1.3),
    "equal": (2.0, 2.0),
    "nearly equal": (2.0, 2.0 * (1 + 1e-9)),
    "to the last digits": (2.0, 2.0 * (1 + 4e-16)),
    "one small": (3.0, 1e-9),
    "one zero": (3.0, 0.0),
    "both zero": (0.0, 0.0),
}


@pytest.mark.parametrize("rates", RATES.values(), ids=RATES)
@pytest.mark.parametrize("n", [3, 4, 5])
def test_the_constant_rotation_of_a_body_is_the_exponential_in_extended_digits(
    n: int, rates: tuple[float, float]
) -> None:
    for seed in range(5 if FULL else 2):
        frame = np.linalg.qr(np.random.default_rng([seed, n]).normal(size=(n, n)))[0]
        planes = sum(
            x * (np.outer(u, v) - np.outer(v, u)) for x, u, v in zip(rates, frame[::2], frame[1::2], strict=False)
        )
        for dt in (1e-3, 0.9, 1.0, np.pi / 2, 7.0):  # at pi/2 a rate of 2 makes half a revolution
            with mpmath.workdps(40):
                one, turn = mpmath.eye(n), mpmath.eye(n)
                for V in spin_turns(planes, dt):
                    assert (V == -V.T).all() and abs(V).max() < 3
                    X = mpmath.matrix(V.tolist())
                    turn = turn * mpmath.inverse(one - X) * (one + X)
                exact = mpmath.expm(mpmath.matrix(planes.tolist()) * mpmath.mpf(dt), method="taylor")
                assert mpmath.mnorm(turn - exact, "f") < 4e-15 * (1 + dt * rates[0])


@pytest.mark.parametrize("n", [3, *full(4), 5])  # rates about the axis: one for n = 3 and 4, two for n = 5
def test_constants_of_a_spinning_top_are_the_same_for_every_number_of_lanes(n: int) -> None:
    """Some lanes rotate by more than one factor makes, and others do not; a call may follow one of the other kind."""
    axis = np.eye(n)[-1]
    top = kr.LagrangeTopMoving(A=axis, alpha=0.3)
    x = np.random.default_rng(n).normal(size=(9, n * (n - 1) // 2 + n)) * 0.5
    p = kr.propagator(top, method="baecklund", order=4, dt=2.0)
    rows = p.steps(x, 3)
    assert all((p.steps(one, 3) == row).all() for one, row in zip(x, rows, strict=True))
    assert all((p.steps(one, 3, every=3)[-1] == row).all() for one, row in zip(x, rows, strict=True))
    made = scheme(top, "baecklund", 2.0, 4, False)
    V1 = made.on(tuple(algebra.restore(x, top.system.space.kinds, n)), points).constants["spin1"]
    assert 0 < np.count_nonzero(V1.any((-1, -2))) < len(x)


def test_orientations_of_lanes_are_those_of_single_runs() -> None:
    """A body that spins fast next to a slow one: only the constant rotation of the fast one needs two factors."""
    M, P = np.array([(0.1, 0.2, 0.3), (3.0, 4.0, 5.0)]), np.array([(0.6, 0.0, 0.8)] * 2)
    top, options = kr.SymmetricTop(A=(0, 0, 1.0)), {"dt": 0.5, "steps": 20, "method": "baecklund", "order": 4}
    run = kr.simulate(top, {"M": M, "P": P}, orientation=np.eye(3), progress=False, **options)
    for lane in (0, 1):
        single = kr.simulate(top, {"M": M[lane], "P": P[lane]}, orientation=np.eye(3), progress=False, **options)
        np.testing.assert_array_equal(run.g.isel(lane=lane).values, single.g.values)


@pytest.mark.parametrize("options", [{"order": 4}, {"order": 2, "orientation": (1, 0, 0, 0)}])
def test_a_top_without_gravity_in_its_frame_is_named(options: dict[str, object]) -> None:
    """Also by a model that has stepped another state, whose plan is used again."""
    top, P = kr.LagrangeTopMoving(A=(0, 0, 0.9)), np.zeros((2, 3))
    for _ in range(2):
        with pytest.raises(kr.InputError, match="a vector P that is not zero, got 0"):
            kr.simulate(top, {"M": (0.4, -0.3, 0.8), "P": P[0]}, dt=0.1, steps=1, method="baecklund", **options)
        kr.simulate(top, {"M": (0.4, -0.3, 0.8), "P": (0.6, 0, 0)}, dt=0.1, steps=1, method="baecklund", **options)
    P[0] = 0.6
    with pytest.raises(kr.InputError, match="not zero in lane 1"):
        kr.simulate(top, {"M": (0.4, -0.3, 0.8), "P": P}, dt=0.1, steps=1, method="baecklund", **options)
