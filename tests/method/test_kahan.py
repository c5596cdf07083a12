"""method="kahan": its equation, inverse and integrals over Q, its orders, its errors; spoiled steps are caught."""

from __future__ import annotations

import functools
import operator
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import kreisel as kr
from kreisel import algebra
from kreisel.lab import exact
from kreisel.method import METHODS, composition, default_method, kahan, scheme
from kreisel.record.model import Model
from kreisel.system import REGISTRY

CUBIC = {"lattice-landau-lifshitz", "neumann", "neumann-veselov", "rosochatius"}  # and what is not polynomial
QUADRATIC = sorted(set(REGISTRY) - CUBIC)
WITH_NOETHER = {
    *("kirchhoff-case", "kirchhoff-revolution", "kovalevskaya-gyrostat", "kovalevskaya-top", "lagrange-top"),
    *("lagrange-top-moving", "ratiu-top", "symmetric-top", "symmetric-top-logarithmic"),
}
EPS, HALF = exact.rational(2, 7), exact.rational(1, 2)
J = (1.0, 2.0, 3.5)
M = (0.3, 0.5, 1.1)

State = tuple[np.ndarray, ...]
DEFORMED = {name for known in kahan.KNOWN for name in known.meanings}


def start(name: str, n: int = 3, numbers: str = "exact") -> tuple[Model, State]:
    rng = np.random.default_rng([3, n])
    draw = exact.rational_random(rng) if numbers == "exact" else exact.float_random(rng)
    model = exact.random_model(REGISTRY[name], n, draw)
    return model, REGISTRY[name].space.point(n, draw)


def step(model: Model, z: State, eps: Any) -> State:
    return kahan.advance(model, z, eps, model.constants)[0]


def flat(model: Model, z: State) -> np.ndarray:
    return algebra.flatten(z, model.system.space.kinds)


def off_equation(name: str, n: int, share: Any = HALF) -> list[Any]:
    """(x' - x)/eps - Q(x, x') - B (x + x')/2 - c, where 2 Q(x, y) = f(x + y) - f(x) - f(y) + f(0)."""
    model, z = start(name, n)
    kinds = model.system.space.kinds
    x, y = flat(model, z), flat(model, step(model, z, EPS))
    f = lambda v: flat(model, tuple(model.flow(*algebra.restore(v, kinds, n))))  # noqa: E731
    B = lambda v: (f(v) - f(-v)) / 2  # noqa: E731
    c = f(0 * x)
    Q = share * (f(x + y) - f(x) - f(y) + c)
    return list((y - x) / EPS - Q - B(x + y) / 2 - c)


@pytest.mark.parametrize("name", QUADRATIC)
def test_the_step_solves_its_equation_over_q_and_its_inverse_has_minus_dt(name: str) -> None:
    fixed = REGISTRY[name].n
    for n in (3, 4) if fixed is None else (fixed,):
        assert all(v == 0 for v in off_equation(name, n))
        model, z = start(name, n)
        back = step(model, step(model, z, EPS), -EPS)
        assert all(v == 0 for v in flat(model, back) - flat(model, z))


def test_a_wrong_coefficient_and_a_wrong_inverse_are_seen() -> None:
    assert any(v != 0 for v in off_equation("heavy-top", 3, exact.rational(1, 3)))
    model, z = start("heavy-top")
    assert any(v != 0 for v in flat(model, step(model, step(model, z, EPS), -EPS * 2 / 3)) - flat(model, z))


def change_of_euler(share: int = 12, name: str = "euler-top") -> list[Any]:
    """Of the deformed Casimir and energy in a step over Q; `share` as in dt^2/12."""
    model, z = start(name)

    def seen(z: State) -> list[Any]:
        x = algebra.axial(z[0])
        own = {"M": z[0], "casimir": algebra.dot(x, x), "energy": model.call(model.system.energy, *z)}
        eps2 = EPS * EPS * 12 / share
        a = kahan._alphas(model, model.constants)
        if share == 12:
            out = kahan.euler_integrals(model, own, EPS, model.constants)
            return [out["casimir_eps"], out["energy_eps"]]
        D = 1 - eps2 / 12 * (kahan._others(a) * x * x).sum()
        return [own["casimir"] / D, own["energy"] / D]

    return [x - y for x, y in zip(seen(step(model, z, EPS)), seen(z), strict=True)]


def test_the_integrals_of_the_euler_top_over_q() -> None:
    assert change_of_euler() == [0, 0]
    assert change_of_euler(name="manakov-top") == [0, 0]
    assert all(v != 0 for v in change_of_euler(share=6))
    assert all(v != 0 for v in change_of_euler(share=10**9))  # the integrals of the flow are not conserved


def off_density(share: int = 4) -> Any:
    """det(dx'/dx) - phi(x')/phi(x), phi = product over two i of (1 - dt^2/4 alpha_j alpha_k x_i^2)."""
    model, z = start("euler-top")
    new, slopes = exact.jacobian(lambda *z: step(model, z, EPS), z, ("skew",), 3)
    a = kahan._others(kahan._alphas(model, model.constants))

    def phi(x: np.ndarray) -> Any:
        numbers = 1 - EPS * EPS / share * a * x * x
        return numbers[0] * numbers[1]

    after = algebra.axial(algebra.skew(np.array([v.value for v in new], dtype=object), 3))
    p = slopes
    det = (
        p[0, 0] * (p[1, 1] * p[2, 2] - p[1, 2] * p[2, 1])
        - p[0, 1] * (p[1, 0] * p[2, 2] - p[1, 2] * p[2, 0])
        + p[0, 2] * (p[1, 0] * p[2, 1] - p[1, 1] * p[2, 0])
    )
    return det - phi(after) / phi(algebra.axial(z[0]))


def test_the_density_of_the_euler_top_over_q() -> None:
    assert off_density() == 0
    assert off_density(5) != 0


def product(values: Any) -> Any:
    return functools.reduce(operator.mul, values)


def density_off(model: Model, z: State, density: Any) -> Any:
    """det(dx'/dx) - phi(x')/phi(x)."""
    kinds = model.system.space.kinds
    _, slopes = exact.jacobian(lambda *z: step(model, z, EPS), z, kinds, model.n)
    det = product(kahan.eliminate(slopes.tolist(), [0] * len(slopes))[1])
    return det - density(step(model, z, EPS)) / density(z)


@pytest.mark.parametrize("name", ["clebsch", "euler-top"])
def test_densities_of_clebschs_case_and_of_so4(name: str) -> None:
    """det(1 - dt/2 f'(x)) <P, P'>, and the same with Z_p(M, M'), over Q; with another form it is none."""
    model, z = start(name, 4 if name == "euler-top" else 3)
    if name == "euler-top":
        s, t, p = kahan._partings(model.constants["J"])

    def density(z: State, sign: int = 1) -> Any:
        new, pivots = kahan.advance(model, z, EPS, model.constants)
        if name == "clebsch":
            return product(pivots) * (z[1] * new[1] * (1, 1, sign)).sum()
        (a, d), (e, g) = (kahan._halves(x) for x in (z[0], new[0]))
        return product(pivots) * (p * (t / s * a * e - sign * s / t * d * g)).sum()

    assert density_off(model, z, density) == 0
    assert density_off(model, z, lambda z: density(z, -1)) != 0


def test_the_density_of_a_gyrostat() -> None:
    """The product of both denominators, for a wheel along an axis; for another wheel it is none."""
    J = start("zhukovsky-volterra")[0].params["J"]
    z = start("zhukovsky-volterra")[1]
    for h, holds in (((0, 3, 0), True), ((0, 3, 1), False)):
        wheel = np.array([exact.rational(v, 7) for v in h], dtype=object)
        model = Model(REGISTRY["zhukovsky-volterra"], {"J": J, "h": wheel})
        w = model.constants["w"]

        def density(z: State, w: np.ndarray = w) -> Any:
            x, k = algebra.axial(z[0]), EPS * EPS / 4
            return product(1 + k * (w[i] - w[i - 1]) * (w[i] - w[i - 2]) * x[i] * x[i] for i in (0, 2))

        assert (density_off(model, z, density) == 0) == holds


def linear_integrals(model: Model) -> set[str]:
    outcomes = scheme(model, "kahan", 0.1, None, False).outcomes
    return {name for name, outcome in outcomes.items() if outcome.conserved}


@pytest.mark.parametrize("name", QUADRATIC)
def test_linear_integrals_are_conserved_over_q(name: str) -> None:
    n = REGISTRY[name].n or 3
    model, z = start(name, n)
    linear = linear_integrals(start(name, n, numbers="float")[0]) - DEFORMED
    new = step(model, z, EPS)
    for integral in linear:
        function = model.system.integrals[integral]
        assert np.all(model.call(function, *new) - model.call(function, *z) == 0)
    assert ("noether" in linear) == (name in WITH_NOETHER)


@pytest.mark.parametrize("order", composition.FIRST_HALVES)
@pytest.mark.parametrize("name", ["euler-top", "zhukovsky-volterra", "heavy-top"])
def test_orders(name: str, order: int) -> None:
    model, z = start(name, numbers="float")
    kinds = model.system.space.kinds
    end = {"euler-top": 20.0, "zhukovsky-volterra": 8.0, "heavy-top": 1.6}[name]
    rate = lambda t, y: algebra.flatten(model.flow(*algebra.restore(y, kinds, 3)), kinds)  # noqa: E731
    truth = solve_ivp(rate, (0, end), flat(model, z), method="DOP853", rtol=1e-13, atol=1e-15).y[:, -1]
    given = dict(zip(model.system.space.letters, z, strict=True))
    errors, counts = [], (6, 7, 8) if order == 8 else (12, 16, 24)
    for count in counts:
        made = model.state(**kr.propagator(model, method="kahan", order=order, dt=end / count).steps(given, count))
        errors.append(abs(flat(model, tuple(made[k] for k in given)) - truth).max())
    assert abs(-np.polyfit(np.log(counts), np.log(errors), 1)[0] - order) < 0.2


@pytest.mark.parametrize("order", composition.FIRST_HALVES)
def test_a_lane_is_the_run_of_its_own(order: int) -> None:
    """Parameters and states with lanes, orientations with them; one of the lanes has no rotor."""
    h = np.array([(0.1, 0.2, 0.3), (0.0, 0.0, 0.5), (0.0, 0.0, 0.0), (0.2, 0.0, 0.1)])
    states = np.array([M, (0.2, -0.1, 1.0), (1.0, 0.3, 0.2), (0.5, 0.5, 0.1)])
    options = {"dt": 0.1, "steps": 50, "every": 10, "method": "kahan", "order": order, "orientation": (1, 0, 0, 0)}
    lanes = kr.ZhukovskyVolterra(J=J, h=h)
    run = kr.simulate(lanes, {"M": states}, progress=False, **options)
    for lane in range(4):
        own = kr.simulate(kr.ZhukovskyVolterra(J=J, h=h[lane]), {"M": states[lane]}, progress=False, **options)
        for letter in ("M", "g"):
            assert np.array_equal(run[letter].isel(lane=lane).values, own[letter].values)


def test_the_orientation_is_of_the_same_order() -> None:
    top, x0 = kr.EulerTop(J=J), {"M": M}
    options = {"orientation": (1, 0, 0, 0), "progress": False}
    right = kr.simulate(top, x0, dt=4.0, steps=1, method="exact", **options).g.values[-1]
    for order, counts in {2: (80, 160), 4: (40, 80), 6: (20, 40)}.items():
        off = []
        for count in counts:
            run = kr.simulate(top, x0, dt=4.0 / count, steps=count, method="kahan", order=order, **options)
            off.append(abs(run.g.values[-1] - right).max())
        assert abs(np.log2(off[0] / off[1]) - order) < 0.2


def test_the_integrals_of_the_euler_top_do_not_walk() -> None:
    run = kr.simulate(kr.EulerTop(J=J), {"M": M}, dt=0.3, steps=200_000, every=2000, method="kahan", progress=False)
    table = kr.drift(run)
    assert list(table.index[table.conserved]) == ["casimir_eps[0]", "energy_eps"]
    assert (table.ulps[table.conserved] < 8).all()
    assert table.max_change["energy"] > 1e-6


def test_lanes_are_looked_at_together() -> None:
    """No lane but one has a rotor: none of them is an Euler top with the integrals of one."""
    h = np.zeros((4, 3))
    assert linear_integrals(kr.ZhukovskyVolterra(J=J, h=h)) == {"casimir_eps", "energy_eps"}
    h[2, 1] = 1e-3  # and then across the first and the third axis
    assert linear_integrals(kr.ZhukovskyVolterra(J=J, h=h)) == {"gyrostat_eps"}
    h[1, ::2] = 1e-3
    assert linear_integrals(kr.ZhukovskyVolterra(J=J, h=h)) == set()


def test_where_it_applies() -> None:
    for name in REGISTRY:
        model, _ = start(name, REGISTRY[name].n or 3, "float")
        assert METHODS["kahan"].applies(model) == (name in QUADRATIC)
        assert default_method(model) != "kahan"
    assert METHODS["kahan"].applies(kr.LagrangeTop(p=np.eye(5)[0]))
    assert not METHODS["kahan"].applies(kr.LagrangeTop(p=np.eye(6)[0]))  # 21 coordinates


def test_bad_input() -> None:
    top = kr.EulerTop(J=J)
    with pytest.raises(kr.InputError, match="one of its orders"):
        kr.simulate(top, {"M": M}, dt=0.1, steps=10, method="kahan", order=3)
    with pytest.raises(kr.InputError, match="expected P != 0"):
        kr.simulate(kr.Clebsch(b=J), {"M": M, "P": (0, 0, 0)}, dt=0.1, steps=10, method="kahan")
    neumann = kr.Neumann(b=(0.1, 0.2, 0.4))
    with pytest.raises(kr.InputError, match="quadratic in a state of at most 15 coordinates, got neumann"):
        kr.simulate(neumann, {"x": (1, 0, 0), "q": (0, 1, 0)}, dt=0.1, steps=10, method="kahan")


@pytest.mark.parametrize("lanes", [1, 4])
def test_a_step_near_a_singular_one_ends_the_run(lanes: int) -> None:
    """From M = x (1, 1, 1) some pivot changes its sign where dt x is large."""
    states = np.outer([1e3, 1.0, 2.0, 0.5][:lanes], (1.0, 1.0, 1.0))
    with pytest.raises(kr.RunError, match="singular, or close to it"):
        kr.simulate(kr.EulerTop(J=J), {"M": states}, dt=0.1, steps=10, method="kahan", progress=False)


def test_elimination_over_q_and_its_pivots() -> None:
    rows = [[Fraction(2), Fraction(1)], [Fraction(1), Fraction(1, 4)]]
    found, pivots = kahan.eliminate(rows, [Fraction(5), Fraction(1)])
    assert found == [Fraction(-1, 2), Fraction(6)]
    assert pivots == [2, Fraction(-1, 4)]


@pytest.mark.parametrize("name", ["lagrange-top", "lagrange-top-su2", "symmetric-top"])
def test_deformed_integrals_of_lagranges_top(name: str) -> None:
    """Exactly over Q; with another denominator, or undeformed, none is conserved."""
    model, z = start(name)
    assert kahan.is_lagrange_top(start(name, numbers="float")[0])

    def values(state: State, eps: Any = EPS) -> list[Any]:
        seen = dict(zip(model.system.space.letters, state, strict=True))
        found = kahan.lagrange_integrals(model, seen, eps, model.constants)
        return [*found["casimir_eps"], found["energy_eps"]]

    new = step(model, z, EPS)
    assert values(new) == values(z)
    for eps in (0 * EPS, 2 * EPS):
        assert all(x != y for x, y in zip(values(new, eps), values(z, eps), strict=True))
    undeformed = [*model.system.space.casimirs(*z), model.call(model.system.energy, *z)]
    assert values(z, 0 * EPS) == undeformed


def test_deformed_integrals_of_clebschs_case() -> None:
    """Exactly over Q: four, independent, at dt = 0 those of the flow; with any other dt none is conserved."""
    model, z = start("clebsch")
    b, (M, P) = model.constants["b"], z
    assert kahan.is_clebsch(start("clebsch", numbers="float")[0])

    def values(state: State, eps: Any = EPS) -> list[Any]:
        seen = dict(zip("MP", state, strict=True))
        found = kahan.clebsch_integrals(model, seen, eps, model.constants)
        return [*found["casimir_eps"], found["energy_eps"], found["clebsch_eps"]]

    new = step(model, z, EPS)
    assert values(new) == values(z)
    for eps in (0 * EPS, 2 * EPS):
        assert all(x != y for x, y in zip(values(new, eps), values(z, eps), strict=True))
    adjugate = np.array([b[1] * b[2], b[2] * b[0], b[0] * b[1], None], dtype=object)[:-1]
    second = algebra.dot(algebra.axial(M), b * algebra.axial(M)) + algebra.dot(P, adjugate * P)
    assert values(z, 0 * EPS) == [*model.system.space.casimirs(*z), model.call(model.system.energy, *z), second]


def test_orbits_of_clebschs_case_lie_on_four_quadrics() -> None:
    """Those of the page, with constants from the first state; the last with another sign is not constant."""
    model, z = start("clebsch")
    b, k, new = model.constants["b"], EPS * EPS / 4, step(model, z, EPS)
    J = z[1] @ z[1] / (1 + k * (z[1] @ (b * z[1])))
    J1 = z[1] @ new[1] / (1 - k * (z[1] @ (b * new[1])))
    C, D = 1 - k * J * b, 1 + k * J1 * b
    slope = algebra.axial(z[0]) @ (D * z[1]) / (z[1] @ z[1])
    v, r, far = J * slope / (J + J1), D / C, J * product(C) / (k * (J + J1) * (J + J1))

    def quadrics(z: State, sign: int = 1) -> list[Any]:
        m, p = algebra.axial(z[0]), z[1]
        n, w = m - v * p, product(r) / r
        third = C @ (n * n - far * r * r * p * p)
        fourth = C @ (r * r * (n * n + v * v * p * p) - 2 * v * w * n * p + sign * far * w * w * p * p)
        return [p @ (C * p) - J, m @ (D * p) - slope * (p @ p), third, fourth]

    assert quadrics(z)[:2] == [0, 0]
    for other in (new, step(model, new, EPS)):
        assert quadrics(other) == quadrics(z)
        assert quadrics(other, -1)[3] != quadrics(z, -1)[3]


def changes(values: Any, model: Model, z: State, eps: Any = EPS) -> np.ndarray:
    """Of deformed integrals with eps, in a step with EPS."""
    states = (dict(zip(model.system.space.letters, state, strict=True)) for state in (z, step(model, z, EPS)))
    new, old = (np.concatenate([np.ravel(v) for v in values(model, s, eps, model.constants).values()]) for s in states)
    return new - old


def test_deformed_integrals_of_the_euler_top_in_so4() -> None:
    """Exactly over Q; with another dt, or undeformed, none.  Two more are quotients of values at two states."""
    model, z = start("euler-top", 4)
    assert kahan.is_euler_top_of_four(start("euler-top", 4, "float")[0])
    assert not kahan.is_euler_top_of_four(start("manakov-top", 4, "float")[0])
    assert (changes(kahan.so4_integrals, model, z) == 0).all()
    for eps in (0 * EPS, 2 * EPS):
        assert (changes(kahan.so4_integrals, model, z, eps) != 0).all()
    orbit = [z]
    for _ in range(4):
        orbit.append(step(model, orbit[-1], EPS))
    s, t, _ = kahan._partings(model.constants["J"])

    def combination(one: State, other: State) -> list[Any]:  # tau, lambda: T + tau T_s + lambda X = 0 at both states
        rows = []
        for (M,) in (one, other):
            a, d = M[[1, 2, 0], [2, 0, 1]], M[:3, 3]
            rows.append(((a * d).sum(), (a * d / (s * t)).sum(), (t / s * a * a + s / t * d * d).sum()))
        minors = np.cross(*np.array(rows))
        return [minors[1] / minors[0], minors[2] / minors[0]]

    assert combination(orbit[0], orbit[1]) == combination(orbit[1], orbit[2]) == combination(orbit[0], orbit[4])


@pytest.mark.parametrize("plane", [(0, 2, 1), (3, 0, 0), (0, 0, -1), (2, 3, 0)])
def test_deformed_integrals_of_gyrostats(plane: tuple[int, int, int]) -> None:
    """One of each axis across the wheel, exactly over Q; at dt = 0 w_i |M|^2 - 2 H + <h, w h>."""
    system, h = REGISTRY["zhukovsky-volterra"], np.array([exact.rational(v, 7) for v in plane], dtype=object)
    known, z = start("zhukovsky-volterra")
    model = Model(system, {"J": known.params["J"], "h": h})
    values = kahan.gyrostat_integrals
    assert kahan.is_gyrostat_in_a_plane(model) and not kahan.is_gyrostat_in_a_plane(known)
    assert (changes(values, model, z) == 0).all()
    for eps in (0 * EPS, 2 * EPS):
        assert (changes(values, model, z, eps) != 0).all()
    w, x = model.constants["w"], algebra.axial(z[0])
    right = [w[i] * (x @ x) - 2 * model.call(system.energy, *z) + h @ (w * h) for i in range(3) if plane[i] == 0]
    assert list(values(model, {"M": z[0]}, 0 * EPS, model.constants)["gyrostat_eps"]) == right


def test_lagranges_top_with_other_moments_is_not_taken_for_it() -> None:
    for name in ("lagrange-top-moving", "clebsch", "heavy-top", "kirchhoff-revolution"):
        assert not kahan.is_lagrange_top(start(name, numbers="float")[0])


@pytest.mark.parametrize(
    ("model", "start"),
    [
        (lambda: kr.Clebsch(b=(1.0, 2.0, 4.0)), {"M": M, "P": (0.6, 0, 0.8)}),
        (
            lambda: kr.EulerTop(J=(1.0, 2.0, 4.0, 7.0)),
            {"M": algebra.skew(np.array((0.3, 0.5, 1.1, -0.7, 0.2, 0.4)), 4)},
        ),
        (lambda: kr.ZhukovskyVolterra(J=J, h=(0.2, 0.5, 0)), {"M": M}),
    ],
)
def test_runs_conserve_what_is_deformed(model: Any, start: dict[str, Any]) -> None:
    table = kr.drift(kr.simulate(model(), start, dt=0.3, steps=5000, every=50, method="kahan", progress=False))
    deformed = table[[name.split("[")[0] in DEFORMED for name in table.index]]
    assert len(deformed) and deformed.conserved.all() and not deformed.broken.any()
    assert (deformed.max_change < 1e-11).all() and table.max_change["energy"] > 1e-6


def test_a_run_of_lagranges_top_conserves_them() -> None:
    top = kr.LagrangeTop(p=(0, 0, 1.5))
    run = kr.simulate(top, {"m": M, "a": (0.6, 0, 0.8)}, dt=0.3, steps=20_000, every=100, method="kahan")
    table = kr.drift(run)
    for label in ("casimir_eps[0]", "casimir_eps[1]", "energy_eps"):
        assert table.conserved[label] and table.ulps[label] < 1000 and not table.broken[label]
    assert table.max_change["energy"] > 1e-4


@pytest.mark.parametrize("method", ["kahan", "variational"])
def test_a_heavy_top_of_n_4_in_units_of_1e30(method: str) -> None:
    rng, ends = np.random.default_rng(3), []
    root, M, P, A = (rng.normal(size=shape) for shape in ((4, 4), (4, 4), 4, 4))
    for unit in (1.0, 2.0**100):
        top = kr.HeavyTop(J=unit * (root @ root.T + np.eye(4)), A=unit * A)
        run = kr.simulate(top, {"M": unit * (M - M.T), "P": P}, dt=0.01, steps=3, method=method, observe=())
        ends.append(run.P.values[-1])
    assert abs(ends[1] - ends[0]).max() < 1e-14
