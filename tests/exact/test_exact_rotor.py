"""The free body, n = 3, in closed form: state and orientation against other formulas in many digits, both ways."""

from __future__ import annotations

from fractions import Fraction
from functools import cache
from typing import Any

import mpmath as mp
import numpy as np
import pytest

import kreisel as kr
from kreisel import algebra
from kreisel.exact.nutation import mp_number
from kreisel.exact.rotor import Rotor
from kreisel.kernels.exact import jumps
from kreisel.kernels.exact.engine import ClosedForm
from kreisel.kernels.exact.jumps import Jumps
from kreisel.method import scheme
from kreisel.method.scheme import Spin
from rotors import by_taylor, closed_form
from sizes import FULL, full

ULP = 2.0**-52
STATE, TURN, KEPT = 8 * ULP, 16 * ULP, 4 * ULP  # 2.4, 5.8 and 1.6 measured
KINDS, DIGITS = ["skew", "quaternion"], 60
START = np.array([0.5, -0.7, 0.1, 0.5])
TIMES = np.array([0.37, -11.3, 1e3, -2e6, 1e12])

CASES = {  # J, M
    "about the third axis": ((1, 2, 3), (0.3, -0.5, 2.0)),
    "about the first axis": ((1, 2, 3), (2.0, -0.5, 0.3)),
    "axes in another order": ((3, 1, 2), (0.3, -1.5, 0.7)),
    "backwards": ((2, 3, 1), (-0.3, 0.5, -0.7)),
    "no first momentum": ((1, 2, 3), (0.0, 0.5, 0.7)),
    "no second": ((1, 2, 3), (0.5, 0.0, 0.7)),
    "no third": ((1, 2, 3), (0.5, 0.7, 0.0)),
    "prolate": ((1, 1, 0.25), (0.3, -0.5, 0.7)),
    "oblate": ((1, 1, 3), (0.3, -0.5, 0.7)),
    "symmetric about the first axis": ((1, 2, 2), (0.3, -0.5, 0.7)),
    "almost symmetric": ((1, 1 + 1e-12, 2), (0.3, -0.5, 0.7)),
    "almost symmetric, almost no spin": ((1, 1 + 1e-12, 2), (0.3, -0.5, 1e-9)),
    "symmetric, hardly any spin": ((1, 1, 2), (0.3, -0.5, 1e-200)),
    "almost a ball": ((1, 1 + 1e-12, 1 - 2e-12), (0.3, -0.5, 0.7)),
    "almost flat": ((1, 1.1, 1e-10), (0.1, 1.0, 0.4)),
    "a rod": ((1, 1e-12, 2e-12), (1e-6, 0.7, -0.7)),
    "tiny": ((1, 2, 3), (1e-160, 2e-160, -1e-160)),
    "beside the first axis": ((1, 2, 3), (1.0, -1e-9, 1e-9)),
    "beside the second, by 1e-3": ((1, 2, 3), (5e-4, 1.0, -1e-3)),
    "beside the second, by 1e-9": ((1, 2, 3), (1e-9, 1.0, 5e-10)),
    "beside the third": ((1, 2, 3), (1e-12, 5e-13, 1.0)),
    "beside the separatrix, by 1e-3": ((3.5, 2.5, 0.5), (0.501, 0.25, 0.5)),  # I = (3, 4, 6)
    "beside the separatrix, by 1e-6": ((3.5, 2.5, 0.5), (0.5 - 1e-6, 0.25, 0.5)),
    "beside the separatrix, by 1e-15": ((3.5, 2.5, 0.5), (0.5 + 1e-15, 0.25, 0.5)),
}
WITHOUT_PERIOD = {
    "on the separatrix": ((3.5, 2.5, 0.5), (0.5, 0.25, 0.5)),
    "on it, to the other side": ((3.5, 2.5, 0.5), (-0.5, -0.25, 0.5)),
    "steady about the first axis": ((1, 2, 3), (-1.0, 0.0, 0.0)),
    "about the second": ((1, 2, 3), (0.0, 1.0, 0.0)),
    "about the third": ((1, 2, 3), (0.0, 0.0, -1.0)),
    "about an axis across": ((1, 1, 3), (1.0, 0.5, 0.0)),
    "a ball": ((2, 2, 2), (0.3, -0.5, 0.7)),
}


def moments(J: Any) -> list[Any]:
    """Of the doubles J, exactly."""
    a, b, c = (Fraction(float(v)) for v in J)
    return [mp.mpf(v.numerator) / v.denominator for v in (b + c, c + a, a + b)]


def engine_of(J: Any, M: Any, reach: float, dt: float = 1.0, oriented: bool = True) -> ClosedForm:
    top, M = kr.EulerTop(J=J), np.asarray(M, dtype=float)
    plan = scheme(top, "exact", dt, None, oriented)
    start = np.broadcast_to(START / np.linalg.norm(START), (*M.shape[:-1], 4))
    z = algebra.flatten((algebra.hat(M), start)[: 1 + oriented], KINDS[: 1 + oriented])
    return ClosedForm(plan, np.atleast_2d(z), dt, reach)


def parted(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """M, axial, and g."""
    M, g = algebra.restore(rows, KINDS, 3)
    return algebra.axial(M), g


def in_parts(J: Any, M: Any, times: Any, monkeypatch: pytest.MonkeyPatch) -> tuple[np.ndarray, np.ndarray]:
    """By polynomials, never by jumps."""
    with monkeypatch.context() as patch:
        patch.setattr(jumps, "TOLERANCE", -1.0)
        M, g = parted(engine_of(J, M, float(abs(times).max())).at(np.asarray(times, dtype=float)))
    return M[:, 0], g[:, 0]


def jumped(J: Any, M: Any, times: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """By jumps alone, and which of them are right."""
    form = engine_of(J, M, 1.0)
    rows, right = Jumps(form._scheme, len(form._start)).at(form._start, np.asarray(times, dtype=float))
    return *parted(rows), right


@cache
def truth(reference: Any, J: tuple[Any, ...], M: tuple[float, ...], t: float) -> tuple[Any, Any]:
    """(M, g) at time t by a reference."""
    with mp.workdps(DIGITS):
        return reference(moments(J), M, [mp.mpf(float(v)) for v in START / np.linalg.norm(START)], t, DIGITS)


def off(got: tuple[np.ndarray, np.ndarray], J: Any, M: Any, times: Any, reference: Any) -> tuple[float, float]:
    """The largest errors of M, over |M|, and of g up to its sign."""
    state, turn = 0.0, 0.0
    with mp.workdps(DIGITS):
        size = mp.sqrt(mp.fsum(mp.mpf(float(v)) ** 2 for v in M))
        for M1, g1, t in zip(*got, np.asarray(times, dtype=float), strict=True):
            want, q = truth(reference, tuple(J), tuple(map(float, M)), float(t))
            state = max(state, *(float(abs(mp.mpf(float(x)) - y) / size) for x, y in zip(M1, want, strict=True)))
            near = [[mp.mpf(float(x)) - sign * y for x, y in zip(g1, q, strict=True)] for sign in (1, -1)]
            turn = max(turn, min(float(max(map(abs, v))) for v in near))
    return state, turn


def energy(J: Any, M: Any) -> Fraction:
    a, b, c = (Fraction(float(v)) for v in J)
    return sum(Fraction(float(m)) ** 2 / i for m, i in zip(M, (b + c, c + a, a + b), strict=True))


def bodies(count: int) -> tuple[np.ndarray, np.ndarray]:
    draw = np.random.default_rng(12)
    return draw.uniform(0.2, 2, (count, 3)), draw.normal(size=(count, 3))


def test_the_reference_against_taylor_series() -> None:
    with mp.workdps(50):
        given = moments((0.5, 0.75, 1.25)), [0.3, -0.5, 0.9], [mp.mpf(v) for v in (1, 0, 0, 0)], 3.1
        for one, other in zip(closed_form(*given), by_taylor(*given), strict=True):
            assert max(abs(x - y) for x, y in zip(one, other, strict=True)) < mp.mpf(10) ** -40


def test_random_bodies(monkeypatch: pytest.MonkeyPatch) -> None:
    for J, M in zip(*bodies(6), strict=True):
        state, turn = off(in_parts(J, M, TIMES, monkeypatch), J, M, TIMES, closed_form)
        assert state < STATE and turn < TURN, (J, M)


def test_random_bodies_in_jumps() -> None:
    J, M = bodies(30)
    rows, turns, right = jumped(J, M, TIMES)
    assert right.mean() > 0.95
    for k in range(len(J)):
        fine = right[:, k]
        state, turn = off((rows[fine, k], turns[fine, k]), J[k], M[k], TIMES[fine], closed_form)
        assert state < STATE and turn < TURN, (J[k], M[k])


ALIKE = ("about the first axis", "no second", "almost a ball", "beside the first axis", "beside the second, by 1e-3")
ALIKE += ("beside the separatrix, by 1e-3", "axes in another order")  # they go the way of others


@pytest.mark.parametrize("name", [*(name for name in CASES if name not in ALIKE), *full(*ALIKE)])
def test_beside_what_is_degenerate(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Both ways; a time whose phases doubles do not hold is not jumped to."""
    J, M = CASES[name]
    times = np.array([0.0, 0.37, -1.03, 25.0]) / np.abs(M).max()
    reference = lambda *given: closed_form(*given[:-1], 480 if "hardly" in name else 150)  # noqa: E731
    if name.startswith("no"):  # at u = K the arctangent of the reference jumps
        reference = lambda *given: by_taylor(*given[:-1], 30)  # noqa: E731
    state, turn = off(in_parts(J, M, times, monkeypatch), J, M, times, reference)
    assert state < STATE and turn < TURN
    rows, turns, right = jumped(J, M, times)
    fine = right[:, 0]
    if fine.any():
        state, turn = off((rows[fine, 0], turns[fine, 0]), J, M, times[fine], reference)
        assert state < STATE and turn < TURN


@pytest.mark.parametrize("name", WITHOUT_PERIOD)
def test_without_a_period(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    J, M = WITHOUT_PERIOD[name]
    times = np.array([0.0, 0.37, -1.03, 6.6])
    for got in (in_parts(J, M, times, monkeypatch), _at(J, M, times)):
        state, turn = off(got, J, M, times, lambda *given: by_taylor(*given[:-1], 30))
        assert state < STATE and turn < TURN


def _at(J: Any, M: Any, times: Any) -> tuple[np.ndarray, np.ndarray]:
    got = parted(engine_of(J, M, float(abs(times).max())).at(times))
    return got[0][:, 0], got[1][:, 0]


def test_on_the_separatrix_it_comes_to_rest(monkeypatch: pytest.MonkeyPatch) -> None:
    """In the end a turn about the second axis at the rate L/I_2."""
    J, M = WITHOUT_PERIOD["on the separatrix"]
    far = np.array([1e4, 1e4 + 1.0])
    rows, turns = in_parts(J, M, far, monkeypatch)
    assert abs(abs(rows[:, 1]) - 0.75).max() < 2 * ULP and abs(rows[:, ::2]).max() < 1e-20
    between = algebra.quaternion_product(algebra.inverse_turn(turns[0]), turns[1])
    assert abs(between[0]) == pytest.approx(np.cos(0.75 / 4 / 2), abs=4 * ULP)


@pytest.mark.parametrize("name", ["about the third axis", "almost a ball", "beside the separatrix, by 1e-6", "a rod"])
def test_energy_and_momentum_stay(name: str) -> None:
    J, M = CASES[name]
    form, rows = engine_of(J, M, 1e5, dt=0.37), np.empty((300, 1, 7))
    form.advance(rows, 77)
    exact, size = energy(J, M), energy((0.5, 0.5, 0.5), M)
    for row in parted(rows)[0][:, 0]:
        assert abs(float(energy(J, row) / exact) - 1) < KEPT
        assert abs(float(energy((0.5, 0.5, 0.5), row) / size) - 1) < 2 * KEPT  # |M|^2


@pytest.mark.parametrize("name", [*CASES, *WITHOUT_PERIOD])
def test_the_quaternion_does_not_flip(name: str) -> None:
    """Over many turns, by rows and by jumps; it starts with the sign that is given."""
    J, M = (np.array(v, dtype=float) for v in {**CASES, **WITHOUT_PERIOD}[name])
    dt = 0.25 * min(J[[1, 2, 0]] + J[[2, 0, 1]]) / np.linalg.norm(M)
    count = 40 if "rod" in name else 400
    form, rows = engine_of(J, M, count * dt, dt), np.empty((count, 1, 7))
    form.advance(rows, 1)
    for g in (parted(rows)[1][:, 0], _at(J, M, dt * np.arange(1, count + 1))[1]):
        whole = np.concatenate([[START / np.linalg.norm(START)], g])
        assert ((whole[1:] * whole[:-1]).sum(-1) > 0.9).all()


def test_rows_are_those_at_their_times(monkeypatch: pytest.MonkeyPatch) -> None:
    J, M = CASES["about the first axis"]
    rows, dt = np.empty((500, 1, 7)), 0.125
    with monkeypatch.context() as patch:
        patch.setattr(jumps, "ROWS", {})
        engine_of(J, M, 1e4, dt).advance(rows, 3)
    there = engine_of(J, M, 1e4).at(3 * dt * np.arange(1.0, 501))
    assert abs(rows - there).max() < 16 * ULP * 2.1
    with monkeypatch.context() as patch:
        patch.setattr(jumps, "TOLERANCE", -1.0)
        assert (rows == engine_of(J, M, 1e4).at(3 * dt * np.arange(1.0, 501))).all()


def rows_of(J: Any, M: Any, cuts: list[int], monkeypatch: pytest.MonkeyPatch, jumps_first: int = 10**6) -> np.ndarray:
    """Every third state of dt = 0.1, in calls of so many rows."""
    with monkeypatch.context() as patch:
        patch.setattr(jumps, "ROWS", {Spin: jumps_first})
        top, M = kr.EulerTop(J=J), np.atleast_2d(np.asarray(M, dtype=float))
        z = algebra.flatten((algebra.hat(M), np.broadcast_to(STILL, (len(M), 4))), KINDS)
        form = ClosedForm(scheme(top, "exact", 0.1, None, True), z, 0.1, 1e4, every=3)
    out = np.empty((sum(cuts), len(M), 7))
    for first, count in zip(np.cumsum([0, *cuts]), cuts, strict=False):
        form.advance(out[first : first + count], 3)
    return out


STILL = (1.0, 0.0, 0.0, 0.0)
MANY = np.array([(0.5, 0.25, 0.5), (0.3, -0.5, 0.7), (0.5 + 1e-15, 0.25, 0.5), (0, 1, 0), (0.2, 0, 2)])


def beside(j: int, M: tuple[float, ...]) -> tuple[tuple[float, ...], Any, float]:
    """J with k' of some 2^-j, k' in many digits and the time of a quarter of the period.

    L^2 - 2T I_2 = 8 z^2 (M_1^2 + ...) for M_1 = M_3: first orders cancel.
    """
    z = 2.0**-j
    J = (3.5 + z, 2.5 + z, 0.5 + 3 * z)
    with mp.workdps(80):
        I, squares = moments(J), [mp.mpf(v) ** 2 for v in M]  # noqa: E741
        L2, T2 = sum(squares), sum(v / i for v, i in zip(squares, I, strict=True))
        a, b, c = sorted(I, reverse=bool(L2 < T2 * sorted(I)[1]))
        square = (c - a) * (L2 - T2 * b) / ((c - b) * (L2 - T2 * a))
        rate = mp.sqrt((c - b) * (L2 - T2 * a) / (a * b * c))
        return J, mp.sqrt(square), float(mp.log(4 / mp.sqrt(square)) / rate)


@pytest.mark.parametrize("j", [8, 12, 20, 26, 33, 40, 45, 48] if FULL else [8, 26, 48])
def test_jumps_beside_the_separatrix(j: int) -> None:
    """k' from 4e-3 to 4e-18, from anywhere, also from beside the steady motion, over some periods."""
    for M in ((0.5, 0.25, 0.5), (-0.5, 3.0, 0.5), (0.5, -700.0, 0.5), (0.3, 0.1, -0.3)):
        J, small, quarter = beside(j, M)
        times = np.array([0.1, -0.3, 0.5, 0.9, 1.3, -1.9, 2.5, -3.7]) * quarter
        rows, turns, right = jumped(J, M, times)
        assert right.all() and small < 0.01
        state, turn = off((rows[:, 0], turns[:, 0]), J, M, times, lambda *given: closed_form(*given[:-1], 120))
        assert state < STATE and turn < 1.5 * TURN  # 5.9 and 15.2 ulp measured


def test_jumps_on_the_separatrix() -> None:
    """For 18 e-foldings; later, and where it starts as near to the steady motion, many digits are asked for."""
    J, M = WITHOUT_PERIOD["on the separatrix"]
    times = np.array([0.37, -1.03, 40.0, 300.0, -300.0])
    rows, turns, right = jumped(J, M, times)
    assert right[:, 0].tolist() == [True] * 3 + [False] * 2
    some = right[:, 0]
    state, turn = off((rows[some, 0], turns[some, 0]), J, M, times[some], lambda *given: by_taylor(*given[:-1], 30))
    assert state < 2 * ULP and turn < 4 * ULP
    assert not jumped(J, (1e-9, 1.0, 1e-9), [0.37])[2].any()
    rows, _, right = jumped((1, 2, 3), (0, 1.3, 0), [1e3])
    assert right.all() and (rows[0, 0] == (0, 1.3, 0)).all()


def test_first_rows_are_jumps(monkeypatch: pytest.MonkeyPatch) -> None:
    """At the exact times k dt; where jumps are not right, and after them, by parts: the same numbers."""
    J = (3.5, 2.5, 0.5)
    by_jumps, by_parts = (rows_of(J, MANY, [400], monkeypatch, first) for first in (10**6, 0))
    assert abs(by_jumps - by_parts).max() < 16 * ULP
    whole = rows_of(J, MANY, [400], monkeypatch, 150)
    assert (whole[:150] == by_jumps[:150]).all() and (whole[150:] == by_parts[150:]).all()


def test_no_cut_and_no_other_lane_changes_a_bit(monkeypatch: pytest.MonkeyPatch) -> None:
    J = (3.5, 2.5, 0.5)
    whole = rows_of(J, MANY, [40], monkeypatch, 30)
    assert (rows_of(J, MANY, [1, 7, 23, 9], monkeypatch, 30) == whole).all()
    for lane in range(len(MANY)):
        assert (rows_of(J, MANY[lane], [40], monkeypatch, 30)[:, 0] == whole[:, lane]).all()


def test_it_is_the_default() -> None:
    """Of n = 3, where neither an order nor an engine for steps is asked for."""
    top, x0, g = kr.EulerTop(J=(1, 2, 3)), {"M": (1.0, -0.5, 0.75)}, STILL
    run = kr.simulate(top, x0, dt=0.1, steps=20, orientation=g)
    assert run.attrs["method"] == "exact" and run.attrs["engine"] == "cpu"
    p = kr.propagator(top, orientation=True)
    assert p.steps(np.array([*x0["M"], *g]), 20).shape == (7,) and "exact" in repr(p)
    assert (p.at({**x0, "g": g}, 2.0)["M"] == kr.at(top, x0, 2.0, orientation=g).M.values).all()
    assert "veselov" in kr.simulate(top, x0, dt=0.1, steps=2, order=4).attrs["method"]
    assert kr.simulate(kr.EulerTop(J=(1, 0, 3)), x0, dt=0.1, steps=2).attrs["method"] == "exact"
    flat = kr.EulerTop(J=(1, 2, 3, 4))
    assert kr.simulate(flat, {"M": np.eye(4) * 0}, dt=0.1, steps=2).attrs["method"] == "veselov"
    many = kr.simulate(top, {"M": np.ones((5, 3)) * x0["M"]}, dt=0.1, steps=20)
    assert many.attrs["method"] == "exact" and (many.M.values == run.M.values[:, None]).all()


@pytest.mark.parametrize("oriented", [False, True])
def test_steps_of_a_propagator_are_at_k_dt(oriented: bool) -> None:
    J, M = bodies(4)
    top = kr.EulerTop(J=J[0])
    state = {"M": M, **({"g": np.broadcast_to(STILL, (4, 4))} if oriented else {})}
    p = kr.propagator(top, dt=0.1, orientation=oriented)
    orientation = {"orientation": state["g"]} if oriented else {}
    run = kr.simulate(top, {"M": M}, dt=0.1, steps=25, every=10, **orientation)
    found = p.steps(state, 25, every=10)
    assert all((found[name] == run[name].values).all() for name in state)
    assert (p.steps(state, 25)["M"] == run.M.values[-1]).all()


def test_lanes_have_the_bits_of_one() -> None:
    J, M = bodies(11)
    times = np.array([0.3, 40.0])
    rows, turns, _ = jumped(J, M, times)
    for k in range(11):
        for i, t in enumerate(times):
            one, turn, _ = jumped(J[k], M[k], [t])
            assert (one[0, 0] == rows[i, k]).all() and (turn[0, 0] == turns[i, k]).all()


def test_without_an_orientation() -> None:
    J, M = bodies(5)
    with_it = engine_of(J, M, 10.0).at(np.array([0.7, 8.0]))[..., :3]
    assert abs(engine_of(J, M, 10.0, oriented=False).at(np.array([0.7, 8.0])) - with_it).max() < 4 * ULP * abs(M).max()


def test_moser_and_veselov_s_map_tends_to_it() -> None:
    top = kr.EulerTop(J=(1, 2, 3))
    x0, g = top.state(M=(1.0, -0.5, 0.75)), START / np.linalg.norm(START)
    run = kr.simulate(top, x0, dt=0.05, steps=200, every=20, method="veselov", order=8, orientation=g)
    exact = kr.simulate(top, x0, dt=0.05, steps=200, every=20, method="exact", orientation=g)
    assert abs(run.M.values - exact.M.values).max() < 1e-12
    assert abs(abs((run.g.values * exact.g.values).sum(-1)) - 1).max() < 1e-12
    turned = algebra.act(algebra.rotation_matrix(exact.g.values), exact.M.values)
    assert abs(turned - turned[0]).max() < 1e-15 * 8
    assert kr.drift(exact).conserved.all()


def test_moser_veselov_is_the_flow_over_a_constant_time() -> None:
    """M_k at k s for one s, which is not eps."""
    from scipy.optimize import brentq

    top = kr.EulerTop(J=(1, 2, 3))
    x0 = top.state(M=(1.0, -0.5, 0.75))
    run = kr.simulate(top, x0, dt=0.3, steps=1000, every=1, method="veselov")
    off = lambda t: float(kr.at(top, x0, [t]).M.values[0, 1] - run.M.values[1, 1])  # noqa: E731
    shift = brentq(off, 0.25, 0.35, xtol=1e-15)
    assert abs(shift - 0.3) > 1e-4
    there = kr.at(top, x0, shift * np.arange(1001.0))
    assert abs(there.M.values - run.M.values).max() < 1e-11


def test_a_body_at_rest_and_more_dimensions() -> None:
    top = kr.EulerTop(J=(1, 2, 3))
    still = kr.at(top, top.state(M=(0, 0, 0)), [0.0, 5.0], orientation=(1, 0, 0, 0))
    assert (still.M == 0).all() and (still.g.values == [1, 0, 0, 0]).all()
    M = {"M": algebra.skew(np.ones(15), 6)}
    with pytest.raises(kr.InputError, match=r"n = 3: .* n = 4, 5: .* got euler-top with n = 6"):
        kr.simulate(kr.EulerTop(J=(1, 2, 3, 4, 5, 6)), M, dt=0.5, steps=100, method="exact")


@pytest.mark.parametrize("mutant", ["ripple", "slope", "beta", "complete"])
def test_a_wrong_factor_shows(mutant: str, monkeypatch: pytest.MonkeyPatch) -> None:
    original = Rotor._constants

    def wrong(self: Rotor) -> None:
        original(self)
        setattr(self, mutant, getattr(self, mutant) * (1 + self.ctx.mpf(10) ** -8))
        self.mean = self.L / mp_number(self.ctx, self.I[2]) + self.lam * self.slope

    monkeypatch.setattr(Rotor, "_constants", wrong)
    J, M = CASES["beside the separatrix, by 1e-3"]
    assert off(in_parts(J, M, TIMES[:3], monkeypatch), J, M, TIMES[:3], closed_form)[1] > TURN


def test_a_propagator_of_many_bodies() -> None:
    """Each with its own J: as one by one."""
    J, M = bodies(9)
    rows = kr.propagator(kr.EulerTop(J=J), method="exact").at(M, [0.7, -3.0])
    for k in range(9):
        one = kr.propagator(kr.EulerTop(J=J[k]), method="exact").at(M[k], [0.7, -3.0])
        assert (one == rows[:, k]).all()
