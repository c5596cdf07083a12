"""kr.differentiable: its values are those of the kernels, its derivatives those of the definition."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import kreisel as kr
from kreisel import algebra, reduction as red
from kreisel.algebra import invariants
from kreisel.algebra.iteration import repeat
from kreisel.baecklund import lagrange_top
from kreisel.bodies import BODIES, KNOWN
from kreisel.kernels import jax_numbers as by
from kreisel.kernels.jax_numbers import numbers
from kreisel.method import scheme
from kreisel.method.baecklund import Product
from kreisel.method.scheme import Steps
from kreisel.runs.differentiable import constants_of
from kreisel.runs.examples import example
from sizes import FULL, PAPER, full

TOP = kr.LagrangeTop(p=(0, 0, 1))
START = {"m": np.array([0.1, 0.2, 1.5]), "a": np.array([0.6, 0, 0.8])}
HEAVY = kr.HeavyTop(J=(1, 1.3, 0.6), A=(0.1, 0, 1))
MOVING = {"M": np.array([0.1, 0.2, 1.5]), "P": np.array([0.6, 0, 0.8])}
M4 = algebra.skew(np.array([0.3, -0.2, 0.5, 0.1, 0.4, -0.3]), 4)


def fluttering(a, *, k):  # a potential of a Lagrange top
    return k * a[0] * np.sin(a[1])


CASES = [
    (TOP, START, "baecklund", 2),
    (TOP, START, "baecklund", 6),
    (TOP, START, "suris", 2),
    (TOP, START, "exact", None),
    (kr.LagrangeTopMoving(A=(0, 0, 1), alpha=1.8), MOVING, "baecklund", 4),
    (kr.EulerTop(J=(1, 2, 3)), {"M": MOVING["M"]}, "veselov", 4),
    (kr.EulerTop(J=(1, 2, 3)), {"M": MOVING["M"]}, "exact", None),
    (HEAVY, MOVING, "variational", 2),
    (HEAVY, MOVING, "kahan", 2),
    (kr.perturbed(TOP, potential=fluttering, params={"k": 0.1}), START, "splitting", 4),
    (kr.EulerTop(J=(1, 2, 3, 4)), {"M": M4}, "variational", 2),
    (kr.EulerTop(J=(1, 2, 3)), {"M": MOVING["M"]}, "midpoint", 2),
    (kr.Clebsch(b=(1, 2, 3.5)), MOVING, "suris", 2),
    (kr.EulerTop(J=(1, 2, 3, 4)), {"M": M4}, "veselov", 2),
]


@pytest.mark.parametrize(("model", "start", "method", "order"), CASES, ids=lambda v: getattr(v, "system", v) and str(v))
def test_a_step_is_that_of_the_kernel(model: Any, start: Any, method: str, order: Any) -> None:
    shown = {k: algebra.hat(v) if k.lower() == "m" and model.n == 3 else v for k, v in start.items()}
    run = kr.simulate(model, model.state(**shown), dt=0.1, steps=1, method=method, order=order, project=False)
    with jax.disable_jit():
        found = kr.differentiable(model, method=method, order=order)(start, dt=0.1, steps=1)
    for letter in start:
        assert found[letter].dtype == np.float64
        assert abs(np.asarray(found[letter]) - run[letter][-1].values).max() < 4e-15
        assert abs(np.asarray(found[letter]) - start[letter]).max() > 1e-3


def test_rows_are_those_of_a_run() -> None:
    f = kr.differentiable(TOP, method="suris", order=1)
    rows = f(START, dt=0.1, steps=60, every=20)
    run = kr.simulate(TOP, TOP.state(**START), dt=0.1, steps=60, every=20, method="suris", order=1, project=False)
    assert rows["m"].shape == (4, 3) and np.allclose(rows["m"], run.m, rtol=0, atol=1e-13)
    with red.double():
        many = jax.vmap(lambda s: f({**START, "m": s}, dt=0.1, steps=60))(jnp.array([START["m"], 2 * START["m"]]))
    assert np.allclose(many["a"][0], run.a[-1], rtol=0, atol=1e-13)


def test_a_batch_may_be_empty() -> None:
    f = kr.differentiable(TOP, method="suris", order=1)
    with red.double():
        for derivative, shape in ((lambda f: f, (0, 3)), (jax.jacfwd, (0, 3, 3)), (jax.jacrev, (0, 3, 3))):
            one = derivative(lambda s: f({**START, "m": s}, dt=0.1, steps=4)["a"])
            assert jax.vmap(one)(jnp.zeros((0, 3))).shape == shape


def along(f: Any, x: np.ndarray, v: np.ndarray) -> np.ndarray:
    """The derivative by differences of order 4."""
    h = 1e-3
    return (8 * (f(x + h * v) - f(x - h * v)) - f(x + 2 * h * v) + f(x - 2 * h * v)) / (12 * h)


def slopes(model: Any, start: Any, letter: str, method: str, order: Any, **more: Any) -> tuple[Any, Any]:
    """Of a step by one component or parameter or dt: by JAX, forward, and by differences."""
    f = kr.differentiable(model, method=method, order=order)

    def end(x: Any) -> Any:
        state = {k: x if k == letter else v for k, v in start.items()}
        given = {**more, **({letter: x} if letter not in start else {})}
        out = f(state, **{"dt": 0.1, "steps": 1, **given})
        return jnp.concatenate([jnp.ravel(v) for v in out.values()])

    x = start.get(letter, more.get(letter))
    x = np.asarray({"dt": 0.1}[letter] if x is None else x, dtype=np.float64)
    v = np.ones(x.shape) if x.shape != (4, 4) else algebra.skew(np.ones(6), 4)
    with red.double(), jax.disable_jit():
        _, found = jax.jvp(end, (jnp.asarray(x),), (jnp.asarray(v),))
        return np.asarray(found), along(lambda y: np.asarray(end(jnp.asarray(y))), x, v)


@pytest.mark.parametrize(
    ("case", "letter", "more"),
    [
        (0, "m", {}),
        (0, "dt", {}),
        *full((0, "p", {"p": np.array([0.1, 0.2, 0.9])}), (2, "dt", {})),
        (3, "m", {}),
        (4, "alpha", {"alpha": np.array(1.7)}),
        (5, "M", {}),
        (8, "A", {"A": np.array([0.2, 0.1, 0.9])}),
        (10, "J", {"J": np.array([1.0, 2, 3, 4])}),
        (11, "M", {}),
        (13, "M", {}),
        *full((13, "dt", {})),
    ],
)
def test_derivatives_are_those_of_differences(case: int, letter: str, more: Any) -> None:
    model, start, method, order = CASES[case]
    found, expected = slopes(model, start, letter, method, order, **more)
    assert abs(expected).max() > 1e-3 and abs(found - expected).max() < 1e-8


SPREAD = np.random.default_rng(1).normal(size=(6, 6))
OFF_ITS_BOUNDS: dict[str, dict[str, Any]] = {  # where differences have room
    "satellite": {"eccentricity": 0.01, "density": 1e-13, "pressure": 5e-6, "mirror": 0.2, "diffuse": 0.3,
                  "field": -7.6e15, "dipole": (0.01, -0.02, 0.01), "torque": (1e-8, 2e-8, -1e-8), "degree_3": [1] * 7,
                  "degree_4": np.ones(9), "plates": [[0.0, 0.6, 0.8, 0.1, 0.2, 0.3, 0.01]], "inclination": 1.7,
                  "node": 0.4, "perigee": 0.7, "sun": (0.6, 0.0, 0.8),
                  "air": [[4.5e5, 1.0, 1.5], [5.5e5, 0.3, 0.5]], "air_rate": 7.3e-5},
    "submerged-body": {"mass_matrix": SPREAD @ SPREAD.T + np.diag([30.0, 40, 50, 10, 20, 35]),
                       "linear_drag": np.ones(6), "quadratic_drag": np.ones(6), "center_of_buoyancy": (0.1, 0.2, 0.3)},
}  # fmt: skip
for _name in ("binary", "binary-with-third-body", "binary-with-moon"):
    OFF_ITS_BOUNDS[_name] = {"tide1": 1e10, "tide2": 1e9, "lag1": 10.0, "lag2": 20.0}


def varied(system: Any) -> tuple[Any, Any, Any]:
    """An example with all of its parameters that are real numbers, and a direction for them."""
    given = OFF_ITS_BOUNDS.get(system.name, {})
    made = example(system, None if system.n else 3, given)
    rng, kinds = np.random.default_rng(3), {p.letter: p.kind for p in system.parameters}
    x = {
        k: np.asarray(v, dtype=np.float64)
        for k, v in made.model.params.items()
        if kinds[k] not in ("dimension", "table")
    }
    v = {k: 0.1 * rng.normal(size=y.shape) * np.where(y == 0, 1, abs(y)) for k, y in x.items()}
    v |= {k: y + y.T for k, y in v.items() if kinds[k] == "symmetric" or k == "mass_matrix"}
    if "sun" in x:  # of length 1
        v["sun"] = v["sun"] - v["sun"] @ x["sun"] * x["sun"]
    return made, x, v


def moved(x: Any, v: Any, h: float) -> Any:
    out = {k: x[k] + h * v[k] for k in x}
    return out | ({"sun": algebra.unit(out["sun"])} if "sun" in x else {})


def by_differences(f: Any) -> Any:
    """The derivative at 0, of order 4."""
    h = 1e-3
    return (8 * (f(h) - f(-h)) - f(2 * h) + f(-2 * h)) / (12 * h)


NAMES = [name for name, s in KNOWN.items() if any(p.kind != "dimension" for p in s.parameters)]


DERIVED = [name for name in NAMES if FULL or name in (*PAPER, *BODIES, "rubanovskii", "ratiu-bitop", "euler-top")]


@pytest.mark.parametrize("name", DERIVED)
def test_constants_have_derivatives_by_every_parameter(name: str) -> None:
    """Those that a record derives from its parameters, by all of them together."""
    made, x, v = varied(KNOWN[name])

    def constants(y: Any) -> Any:
        return {k: by.values(c) for k, c in constants_of(by, made.model, y).items()}

    with red.double():
        value, found = jax.jvp(constants, (x,), (v,))
    for letter in value:

        def other(h: float, letter: str = letter) -> Any:
            return KNOWN[name](**{**made.model.params, **moved(x, v, h)}).constants[letter]

        expected = by_differences(other)
        if expected.shape == value[letter].shape:  # W of a heavy top is another one if J is known to be diagonal
            assert abs(np.asarray(found[letter]) - expected).max() <= 1e-7 * max(abs(expected).max(), 1e-9), letter


def of_a_run(model: Any, method: str, start: Any, dt: float, orientation: Any) -> Any:
    """The end of two steps."""
    shown = {k: algebra.hat(x) if k in "mM" and model.n == 3 else x for k, x in start.items()}
    run = kr.simulate(model, shown, dt=dt, steps=2, method=method, orientation=orientation, project=False)
    return np.concatenate([np.ravel(run[k].values[-1]) for k in model.system.space.letters])


KAHAN = (
    "clebsch-general heavy-top hess-appelrot kirchhoff manakov-top ratiu-top clebsch-body quadratic-potential "
    "kovalevskaya-top goryachev-chaplygin kirchhoff-case lyapunov steklov steklov-lyapunov kovalevskaya-gyrostat "
    "zhukovsky-volterra heisenberg-chain spin-chain uniaxial-chain komarov rubanovskii"
).split()
STEPPED = dict.fromkeys(KAHAN, "kahan")  # system: method, if not the default
FEW = ("heavy-top",)  # a kernel each


@pytest.mark.parametrize("name", NAMES if FULL else FEW)
def test_a_motion_has_derivatives_by_every_parameter(name: str) -> None:
    """One by one, or by all together, from a start where some parameters are 0, 1 or equal."""
    made, x, v = varied(KNOWN[name])
    method = STEPPED.get(name) or made.method
    g = None if made.orientation is None or KNOWN[name].perturbation is None else np.array([0.5, -0.5, 0.5, 0.5])
    dt = 1.0 if name == "satellite" else made.dt  # its harmonics of 1 kg m^3 and fields of 1 T speed it up
    start = {k: np.asarray(y) for k, y in made.model.state(**made.state).axial.items()}
    f = kr.differentiable(made.model, method=method, orientation=False if g is None else g)

    def end(y: Any) -> Any:
        out = f(start, dt=dt, steps=2, **y)
        return jnp.concatenate([jnp.ravel(out[k]) for k in made.model.system.space.letters])

    for letters in [[k] for k in x] if FULL else [list(x)]:
        one, by_one = {k: x[k] for k in letters}, {k: v[k] for k in letters}

        def other(h: float, one: Any = one) -> Any:
            model = KNOWN[name](**{**made.model.params, **moved(one, v, h)})
            return of_a_run(model, method, start, dt, g)

        with red.double():
            value, found = jax.jvp(end, (one,), (by_one,))
        expected = by_differences(other)
        scale = max(abs(expected).max(), 1e-6 * abs(np.asarray(value)).max())  # rounding in differences
        assert abs(np.asarray(found) - expected).max() <= 1e-5 * scale, letters


DAMPED = kr.perturbed(kr.EulerTop(J=(1, 2, 3)), damping=(0.2, 0.3, 0.1))


def test_damping_is_no_linear_constant() -> None:
    """The factors exp(-gamma dt) of a damped body follow dt, gamma and the moments."""
    f = kr.differentiable(DAMPED, method="splitting", order=(2, 2))

    def end(x: Any) -> Any:
        return f({"M": MOVING["M"]}, dt=x[0], steps=3, damping=x[1:4], J=x[4:])["M"]

    x, v = np.array([0.1, 0.2, 0.3, 0.1, 1, 2, 3]), np.array([0.1, 1, -1, 0.5, 1, 0.3, -0.4])
    with red.double():
        made = jax.jit(end)
        _, found = jax.jvp(made, (jnp.asarray(x),), (jnp.asarray(v),))
        expected, value = along(lambda y: np.asarray(made(jnp.asarray(y))), x, v), np.asarray(made(jnp.asarray(x)))
    assert abs(expected).max() > 1e-3 and abs(np.asarray(found) - expected).max() < 1e-8
    run = kr.simulate(DAMPED, {"M": MOVING["M"]}, dt=0.1, steps=3, method="splitting", order=(2, 2), project=False)
    assert abs(value - run.M.values[-1]).max() < 1e-14


@pytest.mark.parametrize("n", [4, 5])
def test_gradients_in_higher_dimensions_are_those_of_complex_steps(n: int) -> None:
    """By one entry of m after twelve steps; a gradient that forgets the steps before the last is seen."""
    rng, model = np.random.default_rng(n), kr.LagrangeTop(p=np.eye(n)[-1])
    m, a = algebra.skew(rng.normal(size=n * (n - 1) // 2), n) / 2, np.eye(n)[0]
    f = kr.differentiable(model, method="suris", order=1)
    with red.double():
        made = jax.jit(
            jax.grad(lambda m, steps: f({"m": m, "a": a}, dt=0.1, steps=steps)["a"] @ np.arange(1.0, n + 1), 0),
            static_argnums=1,
        )
        found, short = (np.asarray(made(jnp.asarray(m), steps)) for steps in (12, 1))
    step, z = scheme(model, "suris", 0.1, 1, False), (m.astype(complex), a.astype(complex))
    z[0][0, 1] += 1e-30j
    z[0][1, 0] -= 1e-30j
    for _ in range(12):
        z = step.advance(*z)
    expected = (z[1] @ np.arange(1, n + 1)).imag / 1e-30
    assert abs(found[0, 1] - found[1, 0] - expected) < 1e-12
    assert abs(short[0, 1] - short[1, 0] - expected) > 1e-2


def test_a_derivative_without_that_of_rho_is_seen() -> None:
    """Only with its step of Newton's method may the eigenvector take a rho without a derivative."""

    def frozen(m, a, *, p, mu, rho):
        return 2 * algebra.shifted_resolvent(mu, m, a - algebra.vec(rho) * p)

    record = replace(TOP.system, baecklund=replace(lagrange_top.BAECKLUND, vector=frozen))
    for model, right in ((TOP, True), (record(p=(0, 0, 1)), False)):
        found, expected = slopes(model, START, "m", "baecklund", 2, dt=1.0)
        assert bool(abs(found - expected).max() < 1e-8) is right


def test_the_gradient_is_that_of_complex_steps() -> None:
    """Of fifty steps of the definition on complex numbers; the reverse sweep goes through parts made again."""
    f = kr.differentiable(TOP, method="suris", order=1)
    with red.double():
        found = jax.jit(jax.grad(lambda s: f(s, dt=0.1, steps=50)["a"] ** 2 @ np.array([1.0, 2, 3])))(START)
        found = {k: np.asarray(v) for k, v in found.items()}
    made = scheme(TOP, "suris", 0.1, 1, False)
    for letter in START:
        for i in range(3):
            state = {k: v + 0j for k, v in START.items()}
            state[letter][i] += 1e-30j
            z: Any = (algebra.hat(state["m"]), state["a"])
            for _ in range(50):
                z = made.advance(*z)
            assert abs(found[letter][i] - (z[1] ** 2 @ np.array([1, 2, 3])).imag / 1e-30) < 1e-11


def test_the_jacobian_is_poisson_and_another_is_not() -> None:
    f = kr.differentiable(TOP, method="suris", order=1)

    def end(x: Any) -> Any:
        out = f({"m": x[:3], "a": x[3:]}, dt=0.1, steps=40)
        return jnp.concatenate([out["m"], out["a"]])

    def tensor(x: np.ndarray) -> np.ndarray:  # of axial vectors
        m, a = algebra.hat(x[:3]), algebra.hat(x[3:])
        return -np.block([[m, a], [a, np.zeros((3, 3))]])

    x = np.concatenate([START["m"], START["a"]])
    with red.double():
        J, y = (np.asarray(v) for v in (jax.jit(jax.jacfwd(end))(x), end(x)))
    plus = invariants.lie_poisson(("skew", "vector"), algebra.hat(x[:3]), x[3:])
    sign = np.diag([-1.0, 1, -1])[::-1]  # coordinates of a skew matrix from its axial vector
    turn = np.block([[sign, np.zeros((3, 3))], [np.zeros((3, 3)), np.eye(3)]])
    assert np.allclose(abs(turn @ tensor(x) @ turn.T), abs(plus), atol=1e-15)
    size = abs(J).max() ** 2
    assert size > 2 and abs(J @ tensor(x) @ J.T - tensor(y)).max() < 1e-13 * size
    assert abs((J + 1e-6 * np.eye(6)) @ tensor(x) @ (J + 1e-6 * np.eye(6)).T - tensor(y)).max() > 1e-10 * size


def test_a_gradient_needs_room_like_the_root_of_the_steps() -> None:
    f = kr.differentiable(TOP, method="suris", order=1)

    def room(steps: int) -> int:
        with red.double():
            made = jax.jit(jax.grad(lambda s: f(s, dt=0.1, steps=steps)["a"][0]))
            return int(made.lower(START).compile().memory_analysis().temp_size_in_bytes)

    assert room(1_000_000) < 300_000 and room(1_000_000) < 20 * room(10_000)


def test_a_loop_has_the_derivative_of_its_fixed_point() -> None:
    """X = c + X X/4, by sweeps, whose own derivative the last sweep does not have."""

    def step(x: Any, *, c: Any) -> Any:
        def improved(X: Any) -> Any:
            new = c.reshape(1, 1) + X @ X / 4
            return (new,), ((new - X) * (new - X)).sum(-1).sum(-1)

        (X,), _ = repeat(improved, (0 * x.reshape(1, 1) + x[0],), 1e-30, 200, ("matrix",))
        return (X[0],)

    def fixed(c: Any) -> Any:
        return by.orbit(Steps(step), ["R^1"], 1, jnp.zeros(1), {"c": numbers(c)}, {}, 1, 1)[1, 0]

    with red.double():
        c = jnp.array([0.6])
        assert abs(fixed(c) - 2 * (1 - np.sqrt(0.4))) < 1e-14
        for derivative in (jax.grad, jax.jacfwd):
            assert abs(derivative(fixed)(c)[0] - 1 / np.sqrt(0.4)) < 1e-13
        second, third = jax.hessian(fixed), jax.jacfwd(jax.hessian(fixed))
        assert abs(second(c)[0, 0] - 0.4**-1.5 / 2) < 1e-12 and abs(third(c)[0, 0, 0] - 0.4**-2.5 * 3 / 4) < 1e-11


@pytest.mark.parametrize("engine", ["kernels", "XLA"])
def test_a_loop_that_only_finds_where_another_starts_has_no_derivative(
    engine: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """(x, d) -> (x (1 + d), d^2) ends at d = 0 with any x; the loop after it solves x^2 = c."""

    def step(x: Any, *, c: Any) -> Any:
        def product(X: Any, d: Any) -> Any:
            return (X + X * d, d * d), (d * d).sum(-1).sum(-1)

        def newton(X: Any) -> Any:
            change = (X * X - c.reshape(1, 1)) / (2 * X)
            return (X - change,), (change * change).sum(-1).sum(-1)

        first = x.reshape(1, 1)
        (X, _), _ = repeat(product, (first, c.reshape(1, 1) / 4), 1e-30, 20, ("matrix", "matrix"))
        (X,), _ = repeat(newton, (X,), 1e-30, 20, ("matrix",))
        return (X[0],)

    if engine == "XLA":
        monkeypatch.setattr(jax, "default_backend", lambda: "another")
    with red.double():
        root = jax.grad(lambda c: by.orbit(Steps(step), ["R^1"], 1, jnp.ones(1), {"c": numbers(c)}, {}, 1, 1)[1, 0])
        assert abs(root(jnp.array([2.0]))[0] - 2**-1.5) < 1e-14


def test_a_map_whose_eigenvalue_needs_no_search() -> None:
    """Goryachev-Chaplygin's top by "baecklund": z depends only on dt, and w is a root in closed form."""
    top, M, P, h = kr.GoryachevChaplygin(gamma=0.3), np.array([0.8, 0.5, -0.6]), np.array([0.6, 0.0, 0.8]), 1e-6
    f = kr.differentiable(top, method="baecklund", order=4)

    def end(M: Any, dt: float = 0.1) -> Any:
        run = kr.simulate(top, {"M": M, "P": P}, dt=dt, steps=3, method="baecklund", order=4, project=False)
        return run.M.values[-1]

    with red.double():
        of_both = jax.jacfwd(lambda M, dt: f({"M": M, "P": P}, dt=dt, steps=3)["M"], argnums=(0, 1))
        J, rate = map(np.asarray, of_both(M, 0.1))
    along = np.cross(P, np.cross(M, P))  # keeps <M, P> = 0
    assert abs(J @ along - (end(M + h * along) - end(M - h * along)) / (2 * h)).max() < 1e-7
    assert abs(rate - (end(M, 0.1 + h) - end(M, 0.1 - h)) / (2 * h)).max() < 1e-7


@pytest.mark.parametrize("order", [*full(2, 4), 6])  # with a real stage, a pair, both
def test_a_negative_step_goes_back(order: int) -> None:
    """Weight -p at a: m' = a x (-p), a' = m x a, ten steps back by SciPy; of Clebsch's case, back and forth."""

    def rates(_: float, y: np.ndarray) -> np.ndarray:
        return np.concatenate([np.cross(y[3:], [0, 0, -1.0]), np.cross(y[:3], y[3:])])

    start = np.concatenate([START["m"], START["a"]])
    past = solve_ivp(rates, (0, -1.0), start, method="DOP853", rtol=1e-12, atol=1e-12).y[:, -1]
    back = kr.differentiable(TOP, method="baecklund", order=order)(START, dt=-0.1, steps=10)
    error = np.concatenate([np.asarray(back["m"]), np.asarray(back["a"])]) - past
    assert abs(error).max() < {2: 5e-3, 4: 1e-5, 6: 1e-8}[order]
    f = kr.differentiable(kr.Clebsch(b=(1, 2, 3.5)), method="baecklund", order=order)
    with red.double():
        there_and_back = jax.jit(lambda x: f(f(x, dt=-0.1, steps=10), dt=0.1, steps=10))
        assert all(abs(v - MOVING[k]).max() < 1e-13 for k, v in there_and_back(MOVING).items())
        J = jax.jacfwd(lambda M: there_and_back({**MOVING, "M": M})["M"])(MOVING["M"])
        assert abs(J - np.eye(3)).max() < 1e-12


def test_derivatives_by_the_moments_of_a_free_body() -> None:
    moments, spin = np.array([0.03, 0.05, 0.07]), np.array([1.0, 2.0, 0.1])
    motion = kr.differentiable(kr.physical.FreeBody(moments))

    def end(moments: Any) -> Any:
        return (motion({"momentum": moments * spin}, dt=0.02, steps=100, moments=moments)["momentum"] / moments)[0]

    def simulated(moments: Any) -> float:
        body = kr.physical.FreeBody(moments)
        return float(kr.simulate(body, body.state(spin), dt=0.02, steps=100, progress=False).angular_velocity[-1, 0])

    with red.double():
        slope = jax.grad(end)(jnp.array(moments))
    near = [(simulated(moments + h) - simulated(moments - h)) / 2e-6 for h in 1e-6 * np.eye(3)]
    assert np.allclose(slope, near, rtol=1e-5)
    with pytest.raises(kr.InputError, match="three principal moments"):
        motion({"momentum": spin}, dt=0.1, steps=1, moments=[1.0, 2.0])
    with pytest.raises(kr.InputError, match="expected moments="):
        motion({"momentum": spin}, dt=0.1, steps=1, inertia=moments)


ROCK, TUMBLING = kr.physical.FreeBody((1.0, 2.0, 2.5)), {"momentum": np.array([0.3, 2.0, 0.5])}


def test_durations_with_units() -> None:
    """dt="20 ms" for 3 s, of Euler's equations by SciPy."""
    I = np.array([1.0, 2.0, 2.5])  # noqa: E741
    M = solve_ivp(lambda t, M: np.cross(M, M / I), (0, 3), TUMBLING["momentum"], "DOP853", rtol=1e-11, atol=1e-12)
    motion = kr.differentiable(ROCK)
    last = np.asarray(motion(TUMBLING, dt="20 ms", steps=150, time="1 min")["momentum"])
    assert abs(last - M.y[:, -1]).max() < 1e-9
    assert (last == np.asarray(motion(TUMBLING, dt=0.02, steps=150)["momentum"])).all()


ON_SPHERE = kr.Neumann(b=(1.0, 2, -0.7))
BAD = [
    (lambda: kr.differentiable(TOP, method="dop853"), "makes steps"),
    (lambda: kr.differentiable(kr.LagrangeTop(p=np.ones(11)), method="suris"), "n of at most 10"),
    (lambda: kr.differentiable(kr.LagrangeTop(p=np.ones((2, 3)))), "jax.vmap"),
    (lambda: kr.differentiable(kr.Clebsch(b=(1, 2, 3)), method="exact"), "method='exact', got clebsch"),
    (lambda: kr.differentiable(kr.Komarov(), method="baecklund"), "no search for branches"),
    (lambda: kr.differentiable(TOP)({"m": START["m"]}, dt=0.1, steps=1), "expected the components m, a"),
    (lambda: kr.differentiable(TOP)({**START, "m": np.eye(3)}, dt=0.1, steps=1), "x0.axial"),
    (lambda: kr.differentiable(TOP)({**START, "a": np.zeros(3)}, dt=0.1, steps=1), "a must not be the zero vector"),
    (
        lambda: kr.differentiable(ON_SPHERE)({"x": (2.0, 0, 0), "q": np.zeros(3)}, dt=0.1, steps=1),
        "lie on .*but it is 3",
    ),
    (lambda: kr.differentiable(TOP)(START, dt=0.1, steps=1.5), "an integer"),
    (lambda: kr.differentiable(TOP)({**START, "m": [0, np.nan, 1]}, dt=0.1, steps=1), "m: expected finite values"),
    (lambda: kr.differentiable(HEAVY, method="kahan")(MOVING, dt=0.1, steps=1, J=(1, 2, -1.5)), "J"),
    (lambda: kr.differentiable(TOP, orientation=np.eye(3)), "Derivatives of the orientation: expected another method"),
    (lambda: kr.differentiable(HEAVY, orientation=True, method="kahan")(MOVING, dt=0.1, steps=1), "M, P, g, got"),
    (
        lambda: kr.differentiable(HEAVY, method="kahan")({**MOVING, "g": [1.0, 0, 0, 0]}, dt=0.1, steps=1),
        "gives a start",
    ),
    (lambda: kr.differentiable(TOP)(START, dt=0.1, steps=3, every=2), "multiple of every"),
    (
        lambda: kr.differentiable(TOP)(START, dt=0.1, steps=1, q=1.0),
        "of lagrange-top that are real: p, alpha",
    ),
    (lambda: kr.differentiable(TOP)(START, dt=0.1, steps=1, p=1.0), r"expected the shape \(3,\)"),
    (lambda: kr.differentiable(TOP)({**START, "a": np.float32([1, 0, 0])}, dt=0.1, steps=1), "float32"),
    (lambda: kr.differentiable(TOP)({**START, "a": jnp.ones(3)}, dt=0.1, steps=1), "float32"),
    (lambda: jax.jit(lambda n: kr.differentiable(TOP)(START, dt=0.1, steps=n))(3), "static_argnames"),
    (lambda: kr.differentiable(TOP)(START, dt="1 ms", steps=1), "dt: expected a finite number, got '1 ms'"),
    (lambda: kr.differentiable(TOP)(START, dt=None, steps=1), "dt: expected a finite number, got None"),
    (lambda: kr.differentiable(TOP)(START, dt=0, steps=1), "dt: expected a step, which may be negative, got 0"),
    (lambda: kr.differentiable(TOP)(START, dt=0.1, steps=1, time=(0, 1)), "time: expected a finite number"),
    (lambda: kr.differentiable(ROCK)(TUMBLING, dt=0, steps=1), "dt: expected a step"),
    (lambda: kr.differentiable(ROCK)(TUMBLING, dt="1 m", steps=1), "dt must have the dimension of s"),
    (
        lambda: kr.differentiable(ROCK)(TUMBLING, dt=0.1, steps=1, time=None),
        "time: expected values in s, or a quantity",
    ),
    (lambda: kr.differentiable(ROCK)({"momentum": 1.0}, dt=0.1, steps=1), "momentum: expected a vector, got one value"),
    (lambda: kr.differentiable(ROCK)({"momentun": (1, 2, 3)}, dt=0.1, steps=1), "components momentum, got"),
]


@pytest.mark.parametrize(("call", "message"), BAD)
def test_bad_input_is_named(call: Any, message: str) -> None:
    with pytest.raises(kr.InputError, match=message):
        call()


def test_a_matrix_that_is_not_skew_is_refused_and_its_gradient_is_skew() -> None:
    """Steps along the gradient stay in so(4), as optax takes them; a triangle is not a state."""
    euler = kr.EulerTop(J=(1, 2, 3, 4))
    f = kr.differentiable(euler, method="kahan", order=2)
    matrices = (np.tril(M4), np.triu(M4), abs(M4), np.ones((4, 4)))
    for wrong in matrices:
        with pytest.raises(kr.InputError, match="M must be skew"):
            f({"M": wrong}, dt=0.1, steps=1)

    def entry(M: Any) -> Any:
        return f({"M": M}, dt=0.1, steps=5)["M"][0, 1]

    with red.double():
        slope = np.asarray(jax.grad(entry)(M4))
        v = algebra.skew(np.arange(1.0, 7.0), 4)
        differences = [float(entry(M4 + h * v)) for h in (1e-5, -1e-5)]
        traced = jax.jit(entry)
        parts = [(np.asarray(traced(wrong)), np.asarray(traced(wrong / 2 - wrong.T / 2))) for wrong in matrices]
    assert (slope == -slope.T).all()
    assert (slope * v).sum() == pytest.approx((differences[0] - differences[1]) / 2e-5, rel=1e-7)
    assert all(one == part for one, part in parts)


def test_what_ends_a_run_ends_a_call_and_is_nan_in_a_trace() -> None:
    f = kr.differentiable(HEAVY, method="kahan", order=2)
    with pytest.raises(kr.RunError, match="singular"), jax.disable_jit():
        f(MOVING, dt=3.0, steps=1)
    with red.double():
        last = jax.jit(lambda s: f(s, dt=3.0, steps=1)["M"])
        assert np.isnan(last(MOVING)).all()
        for derivatives in (jax.jacfwd(last)(MOVING), jax.jacrev(last)(MOVING)):  # zeros end a search in silence
            assert np.isnan(derivatives["M"]).all()


@pytest.mark.parametrize(("model", "start", "method"), [(TOP, START, "baecklund"), (TOP, START, "suris")])
def test_the_tangent_of_a_run_is_poisson(model: Any, start: Any, method: str) -> None:
    run = kr.simulate(model, model.state(**start), dt=0.1, steps=100, every=50, method=method)
    J = kr.tangent(run)
    first, last = ((algebra.hat(run.m[i].values), run.a[i].values) for i in (0, -1))
    T, there = model.system.space.tensor(*first), model.system.space.tensor(*last)
    assert abs(J).max() > 2 and abs(J @ T @ J.T - there).max() < 1e-13 * abs(J).max() ** 2
    assert abs(1.001 * J @ T @ J.T - there).max() > 1e-5
    moved = kr.simulate(model, model.state(m=start["m"] + [0, 0, 1e-6], a=start["a"]), dt=0.1, steps=100, method=method)
    assert np.allclose((moved.a[-1] - run.a[-1]) / 1e-6, -J[3:, 0], atol=1e-4)  # m_12 = -(axial m)_3
    with pytest.raises(kr.InputError, match="some steps"):
        kr.tangent(run.isel(time=[1]))


def test_the_tangent_of_an_attitude_is_symplectic() -> None:
    """Of a body whose force takes g: on T* SO(3) with {M, M} of so(3)* and dX/dt = Omega, by a splitting."""
    body = kr.perturbed(kr.EulerTop(J=(1, 2, 3)), potential=lambda g, t: g[2, 0] * np.cos(t) + g[0, 1])
    run = kr.simulate(body, {"M": MOVING["M"]}, dt=0.1, steps=12, orientation=(0.5, 0.5, -0.5, 0.5), order=(2, 2))
    J, one, none = kr.tangent(run, system=body), np.eye(3), np.zeros((3, 3))
    first, then = (kr.tangent(run.isel(time=part), system=body) for part in (slice(0, 6), slice(5, None)))
    assert abs(then @ first - J).max() < 1e-11 * abs(J).max() and abs(first @ then - J).max() > 1e-4
    with pytest.warns(kr.InputWarning, match="begins at 0"):
        kr.simulate(body, run.isel(time=5), dt=0.1, steps=1, orientation=run.g.values[5], order=(2, 2))

    def tensor(row: int) -> np.ndarray:
        return np.block([[body.system.space.tensor(algebra.hat(run.M.values[row])), one], [-one, none]])

    assert J.shape == (6, 6) and abs(J @ tensor(0) @ J.T - tensor(-1)).max() < 1e-12 * abs(J).max() ** 2
    assert abs(1.001 * J @ tensor(0) @ J.T - tensor(-1)).max() > 1e-4
    f = kr.differentiable(body, order=(2, 2), orientation=(0.5, 0.5, -0.5, 0.5))
    first = f({"M": MOVING["M"]}, dt=0.1, steps=5)
    then = f(first, dt=0.1, steps=7, time=0.5)  # from a state that has g, at its time
    assert abs(np.asarray(then["g"]) - run.g.values[-1]).max() < 1e-13
    assert abs(np.asarray(f(first, dt=0.1, steps=7)["g"]) - run.g.values[-1]).max() > 1e-3


def test_a_turn_that_has_no_effect_has_a_derivative() -> None:
    """By moments of inertia that are those of the integrable part, whose turns a run leaves out."""
    body = kr.perturbed(kr.LagrangeTopMoving(A=(0, 0, 1), alpha=1.0), inertia=(1.0, 1.0, 1.0))
    f = kr.differentiable(body, order=(2, 2))

    def end(x: Any) -> Any:
        return f(MOVING, dt=0.1, steps=3, inertia=x)["P"]

    x, v = np.ones(3), np.array([0.3, -0.2, 0.1])
    with red.double():
        made = jax.jit(end)
        _, found = jax.jvp(made, (jnp.asarray(x),), (jnp.asarray(v),))
        expected = along(lambda y: np.asarray(made(jnp.asarray(y))), x, v)
    assert abs(expected).max() > 1e-3 and abs(np.asarray(found) - expected).max() < 1e-8


def test_a_tangent_of_an_ensemble_is_refused() -> None:
    run = kr.simulate(TOP, TOP.state(m=np.ones((2, 3)), a=START["a"]), dt=0.1, steps=2)
    with pytest.raises(kr.InputError, match="one trajectory"):
        kr.tangent(run)


@pytest.mark.parametrize("order", [2, 4])
def test_constants_of_a_trajectory_are_those_of_a_run(order: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Compiled, so that they do not depend on the extended precision of a processor; with other parameters too."""
    monkeypatch.setattr(Product, "_wide_rho", None)
    p = np.array([0.1, 0.2, 0.9])
    with red.double():
        end = kr.differentiable(TOP, method="baecklund", order=order)(START, dt=0.1, steps=20, p=p)
    other = type(TOP)(TOP.system, {**TOP.params, "p": p})
    run = kr.simulate(other, other.state(**START), dt=0.1, steps=20, method="baecklund", order=order, project=False)
    for letter in START:
        assert np.asarray(end[letter]) == pytest.approx(run[letter].values[-1], rel=1e-13, abs=1e-14)
