"""method="kahan": Kahan's discretization of flows that are quadratic in the state, and compositions of it.

For x' = f(x) = Q(x, x) + B x + c, Q symmetric and bilinear, the step is

    (x' - x)/dt = Q(x, x') + B (x + x')/2 + c,   so   x' = x + dt (1 - dt/2 f'(x))^-1 f(x):

one linear equation.  It is birational and symmetric (the inverse is the step with -dt), of order 2.  Linear integrals
of the flow are integrals of the map.  For the Euler top, x_i' = alpha_i x_j x_k, the ratios of the numbers
1 - dt^2/4 alpha_j alpha_k x_i^2 are integrals too; for Lagrange's top with equal moments there are three beside <m, p>
(`lagrange_integrals`).  The orientation turns by the Cayley transform of dt/2 Omega((x + x')/2).
[Kahan, unpublished notes, 1993; Hirota, Kimura 2000; Petrera, Pfadler, Suris 2011]
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction
from typing import Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.algebra.gradient import value_and_jacobian
from kreisel.algebra.reuse import reused
from kreisel.errors import InputError
from kreisel.method.composition import COMPOSED, DEFECT, ORDERS, composed
from kreisel.method.observing import held_by_orientation, observer, turned, with_orientation
from kreisel.method.record import Method
from kreisel.method.scheme import Guard, Outcome, Scheme
from kreisel.record.contract import Frame, PhaseSpace, call
from kreisel.record.model import Model

MOST_COORDINATES = 15  # e(5); straight-line code of the elimination grows like their cube
SMALLEST_PIVOT = 0.01
POINTS = 3  # at which third differences are taken

State = tuple[Array, ...]


def kahan(model: Model, dt: float, order: int, oriented: bool) -> Scheme:
    """Kahan's step with dt, of order 2, or composed to order 4, 6 or 8.

    The largest 1 - (a pivot of the linear equation) is carried along as the component "defect" and guarded.
    """
    linear = tuple(name for name, function in model.system.integrals.items() if is_linear(model, function))
    energy = f"Hamiltonian H, not conserved by the map: its error is of order dt^{order}"
    observe_all, outcomes = observer(
        model, None, None, conserved=linear, meanings={"energy": energy}, oriented=oriented
    )
    integrals = _deformed_integrals(model) if order == 2 else None

    def stage(old: State, turned: State, eps: Array, consts: Mapping[str, Array]) -> tuple[Any, Any, Any]:
        new, pivots = advance(model, old, eps, consts)
        return new, (_followed(model, old, new, g, eps, consts) for g in turned), (1 - pivot for pivot in pivots)

    def observe(z: State, /, **constants: Array) -> dict[str, Array]:
        out = observe_all(z, **constants)
        return out | (integrals(model, out, dt, constants) if integrals is not None else {})

    if integrals is not None:
        outcomes |= {
            name + "_eps": Outcome("integral", f"deformed {name}, conserved exactly by the map", conserved=True)
            for name in ("casimir", "energy")
        }
    guard = Guard(
        DEFECT,
        1 - SMALLEST_PIVOT,
        "The linear equation of Kahan's step is singular, or close to it",
        "a step in which the state changes by more than itself. Use a smaller dt.",
    )
    held = held_by_orientation(model, with_orientation(model, oriented), bound=False)
    return composed("kahan", model, dt, order, oriented, stage, (observe, outcomes), guard, held=held)


def advance(model: Model, state: State, eps: Array, consts: Mapping[str, Array]) -> tuple[State, list[Any]]:
    """The step of order 2, and the pivots of its linear equation."""
    space = model.system.space
    numbers = _numbers(space, state)
    known = {name: value for name, value in consts.items() if name in model.axes}

    def rates(x: Sequence[Any], *values: Any) -> list[Any]:
        own = _components(space, x, model.n)
        return _numbers(space, tuple(call(model.system.flow, own, dict(zip(known, values, strict=True)))))

    f, slopes = value_and_jacobian(rates, numbers, [(value, model.axes[name]) for name, value in known.items()])
    matrix = [[(i == j) - eps / 2 * slope for j, slope in enumerate(row)] for i, row in enumerate(slopes)]
    change, pivots = eliminate(matrix, [eps * v for v in f])
    return _components(space, [x + y for x, y in zip(numbers, change, strict=True)], model.n), pivots


def eliminate(matrix: list[list[Any]], right: list[Any]) -> tuple[list[Any], list[Any]]:
    """The solution of a linear equation near the identity, and the pivots, none of which is moved."""
    rows = [[*row, b] for row, b in zip(matrix, right, strict=True)]
    pivots = []
    for k, row in enumerate(rows):
        pivots.append(row[k])
        inverse = 1 / row[k]
        row[k + 1 :] = [inverse * v for v in row[k + 1 :]]
        for other in rows[k + 1 :]:
            other[k + 1 :] = [v - other[k] * w for v, w in zip(other[k + 1 :], row[k + 1 :], strict=True)]
    found: list[Any] = []
    for k, row in reversed(list(enumerate(rows))):
        value = row[-1]
        for v, x in zip(row[k + 1 : -1], found, strict=True):
            value = value - v * x
        found.insert(0, value)
    return found, pivots


def _numbers(space: PhaseSpace, state: State) -> list[Any]:
    """The independent coordinates, each with its batch."""
    flat = [algebra.coordinates_of(kind, z) for kind, z in zip(space.kinds, state, strict=True)]
    return [z[..., i][()] for z in flat for i in range(z.shape[-1])]


def _components(space: PhaseSpace, numbers: Sequence[Any], n: int) -> State:
    parts, rest = [], list(numbers)
    for kind in space.kinds:
        count = _count(kind, n)
        own, rest = rest[:count], rest[count:]
        if all(isinstance(v, float | np.ndarray | np.floating) for v in own):
            x = np.stack(np.broadcast_arrays(*own), -1)
        else:
            x = np.empty(count, dtype=object)
            x[:] = own
        parts.append(algebra.skew(x, n) if kind == "skew" else algebra.symmetric(x, n) if kind == "symmetric" else x)
    return tuple(parts)


def _count(kind: str, n: int) -> int:
    if kind.startswith("R^"):
        return int(kind[2:])
    return {"skew": n * (n - 1) // 2, "symmetric": n * (n + 1) // 2, "vector": n}[kind]


def _followed(model: Model, old: State, new: State, g: Array, eps: Array, consts: Mapping[str, Array]) -> Array:
    middle = tuple((x + y) / 2 for x, y in zip(old, new, strict=True))
    X = eps / 2 * call(model.system.velocity, middle, consts)
    return turned(model.system.frame, X, g)


# -- what is known of a flow, over the rational numbers ------------------------------------------------


def is_quadratic(model: Model) -> bool:
    """Whether the flow is quadratic in the state, for these parameters: third differences vanish over Q."""
    return bool(reused((is_quadratic, model.key), lambda: _differences_vanish(model, model.system.flow, 3)))


def is_linear(model: Model, function: Callable[..., Any]) -> bool:
    """Whether a function is linear in the state, for these parameters: second differences vanish over Q."""
    return _differences_vanish(model, function, 2)


def _differences_vanish(model: Model, function: Callable[..., Any] | None, order: int) -> bool:
    """Whether differences of that order vanish at random points, where parameters that vary are mixed at random."""
    rng = np.random.default_rng(1)
    known = {name: _one_lane(value, model.axes[name], rng) for name, value in model.constants.items()}
    signs = {2: (1, -2, 1), 3: (-1, 3, -3, 1)}[order]
    for _ in range(POINTS):
        start, along = (_random_numbers(model, rng) for _ in range(2))
        total: Any = 0
        for k, sign in enumerate(signs):
            state = _components(model.system.space, [x + k * y for x, y in zip(start, along, strict=True)], model.n)
            try:
                value = call(function, state, known)
            except (TypeError, AttributeError, ZeroDivisionError, InputError):  # no rational function
                return False
            parts = value if isinstance(value, tuple) else (value,)
            total = total + sign * np.concatenate([np.ravel(np.asarray(v, dtype=object)) for v in parts])
        if any(v != 0 for v in total):
            return False
    return True


def _random_numbers(model: Model, rng: np.random.Generator) -> list[Fraction]:
    count = sum(_count(kind, model.n) for kind in model.system.space.kinds)
    return [
        Fraction(int(a), int(b)) for a, b in zip(rng.integers(-99, 99, count), rng.integers(1, 99, count), strict=True)
    ]


def _one_lane(value: Array, axes: int, rng: np.random.Generator) -> Any:
    """A constant of one lane, or a random mean over lanes: what holds for it holds for each."""
    flat = np.asarray(value)
    exact = np.vectorize(Fraction, otypes=[object])(flat) if flat.dtype != object else flat
    if flat.ndim == axes:
        return exact if axes else exact[()]
    lanes = exact.reshape((-1, *flat.shape[flat.ndim - axes :]))
    weights = [Fraction(int(w), 1000) for w in rng.integers(1, 1000, len(lanes))]
    return sum(w * lane for w, lane in zip(weights, lanes, strict=True)) / sum(weights)


def _has_a_quadratic_flow(model: Model) -> bool:
    system = model.system
    return (
        system.flow is not None
        and system.numbers == "any"
        and system.perturbation is None
        and sum(_count(kind, model.n) for kind in system.space.kinds) <= MOST_COORDINATES
        and is_quadratic(model)
    )


# -- Euler's top -----------------------------------------------------------------------------------------


def is_euler_top(model: Model) -> bool:
    """Whether the flow is x_i' = alpha_i x_j x_k, with an energy: exactly, in one lane."""
    if model.n != 3 or model.system.space.kinds != ("skew",) or model.system.energy is None:
        return False
    rng = np.random.default_rng(2)
    known = {name: _one_lane(value, model.axes[name], rng) for name, value in model.constants.items()}
    x = np.array([Fraction(int(v), 7) for v in rng.integers(1, 99, 3)], dtype=object)
    rate = algebra.axial(call(model.system.flow, (algebra.hat(x),), known)[0])
    energy = [call(model.system.energy, (algebra.hat(sign * x),), known) for sign in (1, -1, 0)]
    return bool(
        all(v == w for v, w in zip(rate, _alphas(model, known) * _others(x), strict=True))
        and energy[0] == energy[1]
        and energy[2] == 0
    )


def _others(x: Array) -> Array:
    return x[..., algebra.SECOND] * x[..., algebra.THIRD]


def _alphas(model: Model, known: Mapping[str, Array]) -> Array:
    """The alpha_i: the rate of x_i at x = (1, 1, 1)."""
    ones = algebra.hat(np.ones(3, dtype=np.int8))
    return algebra.axial(call(model.system.flow, (ones,), known)[0])


def euler_integrals(model: Model, seen: Mapping[str, Array], dt: Any, known: Mapping[str, Array]) -> dict[str, Array]:
    """|M|^2/D and H/D, D = 1 - dt^2/12 sum alpha_j alpha_k x_i^2."""
    x = algebra.axial(seen[model.system.space.letters[0]])
    own = {name: value for name, value in known.items() if name in model.axes}
    D = 1 - dt * dt / 12 * (_others(_alphas(model, own)) * x * x).sum(-1)
    return {"casimir_eps": seen["casimir"] / algebra.vec(D), "energy_eps": seen["energy"] / D}


# -- Lagrange's top of equal moments ---------------------------------------------------------------------


def is_lagrange_top(model: Model) -> bool:
    """Whether the flow is m' = a ^ p, a' = m a with m = M at rest and -M in the moving frame: exactly, in one lane."""
    if model.n != 3 or model.system.space.kinds != ("skew", "vector") or model.system.energy is None:
        return False
    rng = np.random.default_rng(2)
    known = {name: _one_lane(value, model.axes[name], rng) for name, value in model.constants.items()}
    name = _field(model)
    if name is None:
        return False
    a, x = (np.array([Fraction(int(v), 7) for v in rng.integers(1, 99, 3)], dtype=object) for _ in range(2))
    M, sign = algebra.hat(x), _sign(model)
    rates = call(model.system.flow, (M, a), known)
    return bool(
        (rates[0] == sign * algebra.wedge(a, known[name])).all() and (rates[1] == sign * algebra.act(M, a)).all()
    )


def _field(model: Model) -> str | None:
    return next((name for name in ("p", "A") if name in model.constants), None)


def _sign(model: Model) -> int:
    return 1 if model.system.frame is Frame.REST else -1


def lagrange_integrals(
    model: Model, seen: Mapping[str, Array], dt: Any, known: Mapping[str, Array]
) -> dict[str, Array]:
    """C = (|a|^2 + k l^2)/(1 + k (|m|^2 + 2 k <m, p> l + k^2 |p|^2 l^2)), l^2, and the energy; k = dt^2/4.

    l = <m, a>/(1 - k <p, a>), and |m|^2/2 + (<p, a> + k <p, a>^2/2)/(1 - k^2 |p|^2 C) is the energy.
    """
    m, a = (seen[letter] for letter in model.system.space.letters)
    m, p, k = _sign(model) * algebra.axial(m), known[_field(model) or ""], dt * dt / 4
    u, p2 = algebra.dot(p, a), algebra.dot(p, p)
    length = algebra.dot(m, a) / (1 - k * u)
    whole = algebra.dot(m, m) + 2 * k * algebra.dot(m, p + 0 * m) * length + k * k * p2 * length * length
    C = (algebra.dot(a, a) + k * length * length) / (1 + k * whole)
    energy = algebra.dot(m, m) / 2 + (u + k * u * u / 2) / (1 - k * k * p2 * C)
    return {"casimir_eps": np.stack([C, length * length], -1), "energy_eps": energy}


def _deformed_integrals(model: Model) -> Callable[..., dict[str, Array]] | None:
    """Those of the map of order 2, where they are known in closed form."""
    if is_euler_top(model):
        return euler_integrals
    return lagrange_integrals if is_lagrange_top(model) else None


METHOD = Method(
    name="kahan",
    title="Kahan's discretization of quadratic flows, and compositions of it",
    needs=f"a flow that is quadratic in a state of at most {MOST_COORDINATES} coordinates",
    applies=_has_a_quadratic_flow,
    orders=ORDERS,
    default=2,
    poisson="no",
    conserves="linear integrals; deformed integrals of the Euler top, and of Lagrange's of equal moments (order 2)",
    sources=("kahan1993", "hirota2000", "petrera2011"),
    make=kahan,
    composed=COMPOSED,
)
