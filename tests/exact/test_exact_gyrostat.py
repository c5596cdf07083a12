"""method="exact" of the gyrostat: integrals over Q, Taylor series in 40 digits, special motions, long runs, mutants."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from typing import Any

import mpmath
import numpy as np
import pytest

import kreisel as kr
from kreisel import algebra
from kreisel.exact import gyrostat, quadrics
from kreisel.exact.nutation import rationals
from sizes import full

J, H, M0 = (0.7, 1.1, 1.6), (0.3, -0.5, 0.8), (0.9, -0.4, 1.3)
UPRIGHT = (1.0, 0.0, 0.0, 0.0)
EPS = np.finfo(float).eps
EXTENDED = np.finfo(np.longdouble).eps < EPS / 1000  # set-up in 64 bits and more; else its error is seen too


# -- integrals, exactly ---------------------------------------------------------------------------------


def left_of_the_integrals(seed: int) -> list[Any]:
    """Both quadrics at E e_4 + sqrt(-D)/2 O e_4, as numbers of Q and of sqrt(-D); from rationals, for any wp."""
    draw = np.random.default_rng(seed)
    r = rationals(draw.integers(-30, 30, 12)) / 7
    L, w, b, p = r[0] + 9, r[1:4], r[4:7], r[7]
    below = 1 + r[8] ** 2 + r[9] ** 2
    x = np.array([2 * r[8], 2 * r[9], below - 2, below], dtype=object) / below  # on the sphere
    K = rational_curve(L * x[:3], L, w, b)
    even, odd = (np.array([x @ form @ x for form in forms]) for forms in quadrics.addition(K, p))
    g2, g3 = quadrics.invariants(*quadrics.quartic(K))
    square = 4 * p**3 - g2 * p - g3
    C = quadrics.METRIC
    return [
        v for S in (C, C @ K) for v in (even @ S @ even + square * (odd @ S @ odd) / 4, even @ S @ odd, odd @ S @ even)
    ] + [Fraction(0) if (odd != 0).any() else Fraction(1)]


def rational_curve(M: Any, L: Any, w: Any, b: Any) -> Any:
    energy = (w * M) @ M - 2 * (b @ M)
    K = np.diag([*(L * w), energy / L])
    K[:3, 3], K[3, :3] = -b, b
    return K - np.diag([K.trace() / 4] * 4)


@pytest.mark.parametrize("seed", range(5))
def test_both_integrals_are_conserved_exactly(seed: int) -> None:
    assert left_of_the_integrals(seed) == [0] * 7


# -- against Taylor series --------------------------------------------------------------------------------


def truth(J: Any, h: Any, M: Any, time: float, orders: int = 40) -> np.ndarray:
    """M and the orientation after `time`, by Taylor series in 40 digits; the doubles are taken as exact."""
    with mpmath.workdps(40):
        moments = [mpmath.mpf(float(J[i - 2])) + mpmath.mpf(float(J[i - 1])) for i in range(3)]
        w, h = [1 / v for v in moments], [mpmath.mpf(float(v)) for v in h]
        z = [*(mpmath.mpf(float(v)) for v in M), *map(mpmath.mpf, UPRIGHT)]
        return np.array([float(v) for v in flown(z, w, h, mpmath.mpf(float(time)), orders)])


def flown(z: list[Any], w: list[Any], h: list[Any], time: Any, orders: int = 40) -> list[Any]:
    rate = float(max(w) * (mpmath.norm(z[:3]) + max(abs(v) for v in h)))
    parts = max(1, int(np.ceil(abs(float(time)) * 3 * rate)))
    for _ in range(parts):
        z = advanced(z, w, h, time / parts, orders)
    return z


def after_periods(J: Any, h: Any, M: Any, about: float, counts: tuple[int, ...]) -> list[tuple[float, np.ndarray]]:
    """A double next to so many periods, and M and the orientation there: the turn of one, by Taylor series, repeated.

    The period is where M comes back, near the time `about`, by Newton's method.
    """
    with mpmath.workdps(50):
        w = [1 / (mpmath.mpf(float(J[i - 2])) + mpmath.mpf(float(J[i - 1]))) for i in range(3)]
        h, period = [mpmath.mpf(float(v)) for v in h], mpmath.mpf(about)
        start = [*(mpmath.mpf(float(v)) for v in M), *map(mpmath.mpf, UPRIGHT)]
        z = flown(start, w, h, period, 60)
        for _ in range(4):
            Omega = [w[i] * (z[i] - h[i]) for i in range(3)]
            slope = [z[j] * Omega[k] - z[k] * Omega[j] for j, k in ((1, 2), (2, 0), (0, 1))]
            lack = mpmath.fdot(slope, [start[i] - z[i] for i in range(3)]) / mpmath.fdot(slope, slope)
            z, period = flown(z, w, h, lack, 60), period + lack
        assert max(abs(z[i] - start[i]) for i in range(3)) < mpmath.mpf(10) ** -40
        length = mpmath.norm(z[4:])
        half, rows = mpmath.atan2(length, z[3]), []
        for count in counts:
            time = float(count * period)
            turn = [mpmath.cos(count * half), *(mpmath.sin(count * half) / length * v for v in z[4:])]
            there = flown([*start[:3], *turn], w, h, time - count * period, 60)
            rows.append((time, np.array([float(v) for v in there])))
        return rows


def advanced(z: list[Any], w: list[Any], h: list[Any], time: Any, orders: int) -> list[Any]:
    series = [[v] for v in z]
    M, (q0, *q) = series[:3], series[3:]
    Omega = [[w[i] * (M[i][0] - h[i])] for i in range(3)]

    def times(x: list[Any], y: list[Any]) -> Any:
        return mpmath.fdot(x, y[::-1])

    for k in range(1, orders):
        new = [times(M[i], Omega[j]) - times(M[j], Omega[i]) for i, j in ((1, 2), (2, 0), (0, 1))]
        lean = [-sum(times(q[i], Omega[i]) for i in range(3)) / 2]
        lean += [
            (times(q0, Omega[i]) + times(q[i - 2], Omega[i - 1]) - times(q[i - 1], Omega[i - 2])) / 2 for i in range(3)
        ]
        for x, v in zip(series, [*new, *lean], strict=True):
            x.append(v / k)
        for i in range(3):
            Omega[i].append(w[i] * M[i][k])
    return [mpmath.polyval(x[::-1], time) for x in series]


def off(run: Any, want: np.ndarray) -> tuple[float, float]:
    """Of M, relative to its length, and of the orientation."""
    size = np.linalg.norm(want[:3]) or 1.0
    return float(abs(run.M.values - want[:3]).max() / size), float(abs(run.g.values - want[3:]).max())


def simulated(J: Any, h: Any, M: Any, dt: float, steps: int, **more: Any) -> Any:
    body = kr.ZhukovskyVolterra(J=J, h=h)
    options = {"dt": dt, "steps": steps, "every": steps, "method": "exact", "progress": False, **more}
    return kr.simulate(body, {"M": np.array(M, float)}, **options).isel(time=-1)


def stepped(J: Any, h: Any, M: Any, time: float) -> tuple[float, float]:
    """The errors of a step of `kreisel.exact.quadrics`."""
    w = kr.ZhukovskyVolterra(J=J, h=h).constants["w"]
    N, q = quadrics.step(np.array(M, float), np.array(UPRIGHT), h=np.float64(time), w=w, b=w * np.array(h, float))
    want = truth(J, h, M, time)
    size = np.linalg.norm(want[:3]) or 1.0
    return float(abs(N - want[:3]).max() / size), float(min(abs(q - s * want[3:]).max() for s in (1, -1)))


@pytest.mark.parametrize("seed", range(4))
def test_a_step_against_taylor(seed: int) -> None:
    """With a light and a heavy wheel, forwards and backwards, up to half of its reach and to all of it."""
    draw = np.random.default_rng(seed)
    J, h, M = draw.uniform(0.3, 2, 3), draw.normal(size=3) * 10 ** draw.uniform(-2, 1), draw.normal(size=3)
    w, time = kr.ZhukovskyVolterra(J=J, h=h).constants["w"], np.float64(1e-2)
    while quadrics.reach(M, 1.05 * time, w=w, b=w * h) <= 1:
        time = 1.05 * time
    for length, bound in ((0.5, 1e-12), (-1.0, 1e-7)):
        assert max(stepped(J, h, M, length * time)) < bound


@pytest.mark.parametrize(
    ("J", "h", "M"),
    [
        ((1, 1, 1), H, (1, 2, 0.5)),  # a sphere
        (J, H, (0, 0, 0)),  # the body turns against its wheel
        (J, (0, 0, 0), M0),
        ((1, 2, 3), (0, 0, 0.7), (0, 0, 2.0)),  # both about an axis
        ((1, 2, 3), (0, 0, 0.7), (0, 0, 0.7)),  # the body at rest
        ((1, 2, 3), (0, 0, 0.7), (0, 1e-9, 0.7)),
        ((1, 1 + 1e-12, 1), (1e-200, 0, 0), (0.3, -0.4, 1.2)),
    ],
)
def test_a_step_without_special_cases(J: Any, h: Any, M: Any) -> None:
    assert max(stepped(J, h, M, 0.6)) < 30 * EPS


def test_a_step_of_a_gyrostat_keeps_its_integrals(monkeypatch: pytest.MonkeyPatch) -> None:
    """|M|^2, the energy and the momentum in space; the nodes of Gauss's rule and the restoring are needed."""
    w, b = np.array([0.7, 0.9, 1.2]), np.array([0.3, -0.5, 0.8])
    start = np.array(M0) * (1 + 1e-3 * np.random.default_rng(0).normal(size=(64, 1)))

    def left() -> tuple[float, float]:
        M, g = start, np.tile(UPRIGHT, (64, 1))
        for _ in range(100):
            M, g = quadrics.step(M, g, h=np.full(64, 1.0), w=w, b=b)
        energy = [(z * (w * z / 2 - b)).sum(-1) for z in (start, M)]
        turned = algebra.act(algebra.rotation_matrix(g), M)
        return float(abs((energy[1] - energy[0]).mean())), float(abs(turned - start).max())

    assert left()[0] < 2e-15 and left()[1] < 1e-13
    monkeypatch.setattr(quadrics, "restored", lambda N, *_: N)
    assert left()[0] > 2e-15


@pytest.mark.parametrize("name", ["weights", "NODES"])
def test_a_wrong_step_is_seen(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The mutants: a weight of the addition theorem off by 1e-9, and a third of the nodes."""
    if name == "NODES":
        monkeypatch.setattr(quadrics, name, 4)
    else:
        right = quadrics.weights
        monkeypatch.setattr(quadrics, name, lambda p, *s: (right(p * (1 + 1e-9), *s)[0], *right(p, *s)[1:]))
    assert max(stepped(J, H, M0, 1.8)) > 1e-12


@pytest.mark.parametrize("seed", [0, 1, 2, *full(3, 4, 5, 6, 7)])
@pytest.mark.parametrize("dt", [0.1, 2.0])
def test_against_taylor(seed: int, dt: float) -> None:
    draw = np.random.default_rng(seed)
    J, h, M = draw.uniform(0.3, 2, 3), draw.normal(size=3) * 10 ** draw.uniform(-2, 0.5), draw.normal(size=3)
    want = truth(J, h, M, 3 * dt)
    state, turn = off(simulated(J, h, M, dt, 3, orientation=UPRIGHT), want)
    assert state < 64 * EPS
    assert turn < 128 * EPS
    there = kr.at(kr.ZhukovskyVolterra(J=J, h=h), {"M": M}, 3 * dt)
    assert abs(there.M.values - want[:3]).max() < (4 if EXTENDED else 64) * EPS * np.linalg.norm(M)


SPECIAL = [
    ((1, 1, 1), H, (1, 2, 0.5)),  # a sphere with a wheel turns about it
    ((1, 1, 1), (0, 0, 0), (1, 2, 0.5)),
    ((1, 2, 3), (0, 0, 0), (1, 2, 0.5)),  # Euler's top
    ((1, 2, 3), H, (0, 0, 0)),  # the body turns against its wheel
    ((1, 2, 3), (0, 0, 0.7), (0.1, 0.2, 1.0)),  # the wheel along an axis
    ((1, 2, 3), (0, 0.7, 0), (0, 1, 0)),  # at rest, along the second axis
    ((1, 2, 3), (0, 0, 0), (1e-9, 1, 1e-9)),  # beside the separatrix
    ((1, 2, 3), H, (1e-9, 1e-9, 0)),
    ((1, 1, 2), (0, 0, 0.5), (0.3, 0.4, 0.5)),
    ((1, 1, 2), (0.5, 0, 0), (0.3, 0.4, 0.5)),
    ((1, 1, 1 + 1e-12), (0.5, 0, 0), (0.3, 0.4, 0.5)),
    ((1, 2, 3), H, (1e-200, 1e-200, 0)),
    ((1e3, 2e3, 3e3), H, (1, 2, 3)),
]


@pytest.mark.parametrize(("J", "h", "M"), SPECIAL)
@pytest.mark.parametrize("dt", [0.25, *full(3.0)])
def test_special_motions(J: Any, h: Any, M: Any, dt: float) -> None:
    want = truth(J, h, M, 4 * dt)
    state, turn = off(simulated(J, h, M, dt, 4, orientation=UPRIGHT), want)
    assert state < 64 * EPS
    assert turn < (2000 if J[2] == 1 + 1e-12 else 64) * EPS  # turns are fitted to a motion, here almost a plane one


def test_permanent_rotations_stand_still() -> None:
    moments = sum(J) - np.array(J)
    for nu in (-0.8, 0.1):
        M = np.array(H) / (1 - nu * moments)
        assert abs(simulated(J, H, M, 0.5, 1000).M - M).max() < 64 * EPS * np.linalg.norm(M)


# -- long times ---------------------------------------------------------------------------------------------


def test_integrals_over_ten_million_steps() -> None:
    body = kr.ZhukovskyVolterra(J=J, h=H)
    run = kr.simulate(body, {"M": M0}, dt=0.05, steps=10**7, every=10**5, progress=False)
    assert run.attrs["method"] == "exact"
    scale = {"casimir": float(np.dot(M0, M0)), "energy": float(np.dot(M0, M0) / 2)}  # of the sums, which cancel
    for name, size in scale.items():
        assert abs(run[name] - run[name][0]).max() < 8 * EPS * size
    there = kr.at(body, {"M": M0}, run.time.values[[1, -1]])
    assert abs(run.M.values[1] - there.M.values[0]).max() < 1e-16 * 10**5
    assert abs(run.M.values[-1] - there.M.values[1]).max() < 1e-17 * 10**7


@pytest.mark.parametrize("time", [-37.5, 1e4, 1e9, 1e12])
def test_at_any_time(time: float) -> None:
    """Against the top without a wheel, and a body of revolution with its wheel along the axis, which turns evenly."""
    state = {"M": np.array(M0)}
    body, top = kr.ZhukovskyVolterra(J=J, h=(0, 0, 0)), kr.EulerTop(J=J)
    assert abs(kr.at(body, state, time).M - kr.at(top, state, time).M).max() < 16 * EPS
    body = kr.ZhukovskyVolterra(J=(1.0, 1.0, 0.5), h=(0, 0, 0.75))
    with mpmath.workdps(50):
        rate = (1 / mpmath.mpf(1.5) - mpmath.mpf(0.5)) * mpmath.mpf(M0[2]) + mpmath.mpf(0.375)
        want = complex(mpmath.mpc(M0[0], M0[1]) * mpmath.expj(rate * mpmath.mpf(time)))
    found = kr.at(body, state, time).M.values
    assert abs(complex(*found[:2]) - want) < 16 * EPS
    assert abs(found[2] - M0[2]) < 16 * EPS


def test_a_step_of_many_periods() -> None:
    body = kr.ZhukovskyVolterra(J=J, h=H)
    run = kr.simulate(body, {"M": [M0, (1.0, 0.2, -0.3)]}, dt=1e5, steps=3, method="exact", progress=False)
    for lane, M in enumerate((M0, (1.0, 0.2, -0.3))):
        assert abs(run.M.isel(lane=lane).values - kr.at(body, {"M": M}, run.time.values).M.values).max() < 64 * EPS


def test_without_a_period() -> None:
    """On the separatrix of Euler's top, I = (3, 4, 6), M tends to the second axis, by a step of any length."""
    J, M = (3.5, 2.5, 0.5), (1.0, 0.5, 1.0)
    assert abs(simulated(J, (0, 0, 0), M, 12.0, 1).M - truth(J, (0, 0, 0), M, 12.0)[:3]).max() < 64 * EPS
    end = np.sign(truth(J, (0, 0, 0), M, 12.0)[1]) * 1.5
    for time in (1e3, 1e15):
        there = kr.at(kr.ZhukovskyVolterra(J=J, h=(0, 0, 0)), {"M": M}, time).M.values
        assert abs(there - (0, end, 0)).max() < 16 * EPS
        assert abs(simulated(J, (0, 0, 0), M, time, 1).M.values - (0, end, 0)).max() < 1e-8


def test_orientation_at_any_time() -> None:
    body, times = kr.ZhukovskyVolterra(J=J, h=H), [-3.0, 0.0, 7.25]
    run = kr.at(body, {"M": M0}, times, orientation=UPRIGHT)
    for k, time in enumerate(times):
        state, turn = off(run.isel(time=k), truth(J, H, M0, time))
        assert max(state, turn) < (16 if EXTENDED else 128) * EPS
    with pytest.raises(kr.InputError, match="long step with the orientation"):
        simulated(J, H, M0, 1e9, 1, orientation=UPRIGHT)


def test_a_fast_body_is_a_slow_one_at_another_time() -> None:
    """M and h times s, at the time t/s: the same orientation; at 2^20 kr.at asked for fewer maps in a step."""
    M, h, J, times, s = np.array([0.9, -0.4, 1.3]), np.array([0.3, -0.5, 0.8]), (0.7, 1.1, 1.6), [0.3, 40.0], 2.0**20
    slow, fast = (
        kr.at(
            kr.ZhukovskyVolterra(J=J, h=k * h), {"M": k * M}, np.array(times) / k, orientation=(1, 0, 0, 0), observe=()
        )
        for k in (1.0, s)
    )
    assert abs(fast.M.values / s - slow.M.values).max() < 1e-13
    assert abs(fast.g.values - slow.g.values).max() < 1e-13


def test_orientation_after_many_periods(monkeypatch: pytest.MonkeyPatch) -> None:
    """No error grows with time; the mutant's angle of a period is off by 1e-14."""
    J, h, M = (0.5, 0.6, 0.7), (-1.0, 1.5, 0.5), (1.5, -0.5, 0.25)
    far = after_periods(J, h, M, 4.14107, (8, 250, 1_250, 250_000, 10**11))
    body, times = kr.ZhukovskyVolterra(J=J, h=h), [time for time, _ in far]

    def errors() -> list[float]:
        run = kr.at(body, {"M": M}, times, orientation=UPRIGHT)
        return [max(off(run.isel(time=k), want)) for k, (_, want) in enumerate(far)]

    assert max(errors()[: None if EXTENDED else 2]) < (8 if EXTENDED else 500) * EPS
    right = gyrostat.turn_of_a_period
    monkeypatch.setattr(gyrostat, "turn_of_a_period", lambda *given: right(*given) + 1e-14)
    assert errors()[3] > 1e-11


@pytest.mark.skipif(not EXTENDED, reason="in doubles what is left of a long period is not exact")
@pytest.mark.parametrize(
    ("J", "M", "times"),
    [
        (J, M0, (-1e6, 1e12)),
        ((1, 1 + 1e-9, 1 + 3e-9), M0, (1e6, 1e12)),  # 10^9 turns in a period
        ((1, 2, 3), (1e-9, 1, 1e-9), (1e6, 1e12)),  # beside the separatrix
        ((3.5, 2.5, 0.5), (1.0, 0.5, 1.0), (12.0, 60.0, 1e3)),  # and on it, where the motion ends
        ((1, 1, 2), (0, 0, 0.5), (1e9,)),  # it stands still in the body
    ],
)
def test_orientation_of_a_free_body_at_any_time(J: Any, M: Any, times: Any) -> None:
    """Against Euler's top in closed form, which has other formulas."""
    one, other = (
        kr.at(body, {"M": M}, times, orientation=UPRIGHT)
        for body in (kr.ZhukovskyVolterra(J=J, h=(0, 0, 0)), kr.EulerTop(J=J))
    )
    assert abs(one.M - other.M).max() < 16 * EPS
    assert abs(one.g - other.g).max() < 16 * EPS


def test_a_body_that_turns_against_its_wheel_for_long() -> None:
    found = kr.at(kr.ZhukovskyVolterra(J=J, h=H), {"M": (0, 0, 0)}, 1e9, orientation=UPRIGHT).g.values
    with mpmath.workdps(40):
        Omega = [-mpmath.mpf(H[i]) / (mpmath.mpf(J[i - 2]) + mpmath.mpf(J[i - 1])) for i in range(3)]
        rate = mpmath.norm(Omega)
        half = rate * mpmath.mpf(10) ** 9 / 2
        want = [mpmath.cos(half), *(mpmath.sin(half) * v / rate for v in Omega)]
    assert abs(found - np.array([float(v) for v in want])).max() < 16 * EPS


def test_lanes_are_single_runs() -> None:
    wheels, states = np.array([H, (0.1, 0.2, 0.0)]), np.array([M0, (0.0, 1.0, -2.0)])
    together = simulated(J, wheels, states, 0.3, 50, orientation=UPRIGHT)
    for lane in range(2):
        alone = simulated(J, wheels[lane], states[lane], 0.3, 50, orientation=UPRIGHT)
        assert abs(together.M.isel(lane=lane) - alone.M).max() < 64 * EPS
        assert abs(together.g.isel(lane=lane) - alone.g).max() < 128 * EPS


# -- mutants -------------------------------------------------------------------------------------------------


def _lost_square(c: tuple[Any, ...], s2: Any) -> tuple[Any, ...]:
    return INTACT["_in_powers"]((*c[:2], 0 * c[2]), s2)


def _opposite(s2: Any, s3: Any, s4: Any) -> tuple[Any, ...]:
    g2, g3 = INTACT["invariants"](s2, s3, s4)
    return g2, -g3


def _quartic_of_other_sign(K: Any) -> tuple[Any, ...]:
    s2, s3, s4 = INTACT["quartic"](K)
    return s2, -s3, s4


INTACT: dict[str, Callable[..., Any]] = {
    name: getattr(quadrics, name) for name in ("_in_powers", "invariants", "quartic", "weierstrass")
}


@pytest.mark.parametrize(
    ("name", "mutant"),
    [("_in_powers", _lost_square), ("invariants", _opposite), ("quartic", _quartic_of_other_sign)],
)
def test_mutants_lose_an_integral(name: str, mutant: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(quadrics, name, mutant)
    assert left_of_the_integrals(0) != [0] * 7


@pytest.mark.filterwarnings("ignore:.*not conserved")
@pytest.mark.parametrize("factors", [(1.0, -1.0), (1.001, 1.0), (1.0, 1.001)])
def test_mutants_are_late(factors: tuple[float, float], monkeypatch: pytest.MonkeyPatch) -> None:
    """Another wp or wp' of the same curve conserves the integrals or not, and is not the flow."""

    def mutant(g2: Any, g3: Any) -> tuple[Any, ...]:
        return tuple(f * v for f, v in zip(factors, INTACT["weierstrass"](g2, g3), strict=True))

    monkeypatch.setattr(quadrics, "weierstrass", mutant)
    run = simulated(J, H, M0, 0.5, 1, project=False)
    assert abs(run.M - truth(J, H, M0, 0.5)[:3]).max() > 1e-5
