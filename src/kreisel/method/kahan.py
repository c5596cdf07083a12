"""method="kahan": Kahan's discretization of flows that are quadratic in the state, and compositions of it.

For x' = f(x) = Q(x, x) + B x + c, Q symmetric and bilinear, the step is

    (x' - x)/dt = Q(x, x') + B (x + x')/2 + c,   so   x' = x + dt (1 - dt/2 f'(x))^-1 f(x):

one linear equation.  It is birational and symmetric (the inverse is the step with -dt), of order 2.  Linear integrals
of the flow are integrals of the map.  For the Euler top, x_i' = alpha_i x_j x_k, the ratios of the values
1 - dt^2/4 alpha_j alpha_k x_i^2 are integrals too; they are below, in closed form and exact over Q, and those of
Lagrange's top with equal moments, of Clebsch's case, of the Euler top in so(4) and of gyrostats.  The orientation
rotates by the Cayley transform of dt/2 Omega((x + x')/2).
[Kahan, unpublished notes, 1993; Hirota, Kimura 2000; Petrera, Pfadler, Suris 2011]
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array, cross
from kreisel.algebra.gradient import value_and_jacobian
from kreisel.algebra.invariants import stack
from kreisel.algebra.reuse import reused
from kreisel.errors import InputError
from kreisel.method.composition import DEFECT, composed
from kreisel.method.scheme import Guard, Only, Outcome, Scheme, State, observer, turned_by_velocity
from kreisel.record.calling import call
from kreisel.record.contract import Frame, PhaseSpace
from kreisel.record.model import Model

MOST_COORDINATES = 15  # e(5); straight-line code of the elimination grows like their cube
SMALLEST_PIVOT = 0.01
POINTS = 3  # at which third differences are taken

Values = Mapping[str, Array]


def kahan(model: Model, dt: float, order: int, oriented: bool) -> Scheme:
    """Kahan's step with dt, of order 2, or composed to order 4, 6 or 8.

    The largest 1 - (a pivot of the linear equation) is carried along as the component "defect" and guarded.
    """
    energy = f"Hamiltonian H, not conserved by the map: its error is of order dt^{order}"
    observe_all, outcomes = observer(model, oriented, conserved=linear_integrals(model), meanings={"energy": energy})
    integrals = next((candidate for candidate in KNOWN if candidate.applies(model)), None) if order == 2 else None

    def stage(old: State, turned: State, eps: Array, constants: Values) -> tuple[Any, Any, Any]:
        new, pivots = advance(model, old, eps, constants)
        middle = tuple((x + y) / 2 for x, y in zip(old, new, strict=True))
        gs = (turned_by_velocity(model, middle, g, eps, constants) for g in turned)
        return new, gs, (1 - pivot for pivot in pivots)

    def observe(z: State, only: Only = None, /, **constants: Array) -> dict[str, Array]:
        out = observe_all(z, only if integrals is None else None, **constants)
        return out | (integrals.values(model, out, dt, constants) if integrals is not None else {})

    guard = Guard(
        "The linear equation of Kahan's step is singular, or close to it",
        "a step in which the state changes by more than itself. Use a smaller dt.",
        DEFECT,
        1 - SMALLEST_PIVOT,
    )
    scheme = composed("kahan", model, dt, order, oriented, stage, (observe, outcomes), guard, bound=False)
    if integrals is None:
        return scheme

    def prepare(x: State) -> State:
        integrals.check(model, x)
        return scheme.reopen(x)

    deformed = {
        name: Outcome("integral", f"deformed {meaning}, conserved exactly by the map", conserved=True)
        for name, meaning in integrals.meanings.items()
    }
    # these integrals may depend on which parameters are 0
    return replace(scheme, prepare=prepare, outcomes=outcomes | deformed, parameters_in_motion=None)


# -- the step ---------------------------------------------------------------------------------------------


def advance(model: Model, state: State, eps: Array, constants: Values) -> tuple[State, list[Any]]:
    """The step of order 2, and the pivots of its linear equation."""
    space = model.system.space
    numbers = numbers_of(space, state)
    parameters = {name: value for name, value in constants.items() if name in model.axes}

    def rates(x: Sequence[Any], *values: Any) -> list[Any]:
        state = state_of(space, x, model.n)
        return numbers_of(space, tuple(call(model.system.flow, state, dict(zip(parameters, values, strict=True)))))

    f, slopes = value_and_jacobian(rates, numbers, [(value, model.axes[name]) for name, value in parameters.items()])
    matrix = [[(i == j) - eps / 2 * slope for j, slope in enumerate(row)] for i, row in enumerate(slopes)]
    change, pivots = eliminate(matrix, [eps * v for v in f])
    return state_of(space, [x + y for x, y in zip(numbers, change, strict=True)], model.n), pivots


def eliminate(matrix: list[list[Any]], right: list[Any]) -> tuple[list[Any], list[Any]]:
    """The solution of a linear equation near the identity, and the pivots, none of which is moved."""
    rows = [[*row, b] for row, b in zip(matrix, right, strict=True)]
    pivots = []
    for k, row in enumerate(rows):
        pivots.append(row[k])
        inverse = 1 / row[k]
        row[k + 1 :] = [inverse * v for v in row[k + 1 :]]
        for lower in rows[k + 1 :]:
            lower[k + 1 :] = [v - lower[k] * w for v, w in zip(lower[k + 1 :], row[k + 1 :], strict=True)]
    result: list[Any] = []
    for k, row in reversed(list(enumerate(rows))):
        value = row[-1]
        for v, x in zip(row[k + 1 : -1], result, strict=True):
            value = value - v * x
        result.insert(0, value)
    return result, pivots


def numbers_of(space: PhaseSpace, state: State) -> list[Any]:
    """The independent coordinates, each with its batch."""
    flat = [algebra.KINDS[kind].pack(z) for kind, z in zip(space.kinds, state, strict=True)]
    return [z[..., i][()] for z in flat for i in range(z.shape[-1])]


def state_of(space: PhaseSpace, numbers: Sequence[Any], n: int) -> State:
    """The state with these coordinates."""
    parts = []
    for kind, place in zip(space.kinds, algebra.slices(space.kinds, n), strict=True):
        values = numbers[place]
        plain = all(isinstance(v, float | np.ndarray | np.floating) for v in values)
        x = np.stack(np.broadcast_arrays(*values), -1) if plain else algebra.objects(values)
        parts.append(algebra.KINDS[kind].unpack(x, n))
    return tuple(parts)


# -- properties of a flow, over the rationals ------------------------------------------------


def is_quadratic(model: Model) -> bool:
    """Whether the flow is quadratic in the state, for these parameters: third differences vanish over Q."""
    return bool(reused((is_quadratic, model.key), lambda: _differences_vanish(model, model.system.flow, 3)))


def linear_integrals(model: Model) -> list[str]:
    """The integrals that are linear in the state, for these parameters: second differences vanish over Q."""
    return [name for name, function in model.system.integrals.items() if _differences_vanish(model, function, 2)]


def _differences_vanish(model: Model, function: Callable[..., Any] | None, order: int) -> bool:
    """Whether differences of that order vanish at random points, where parameters that vary are mixed at random."""
    rng = np.random.default_rng(1)
    constants, count = _of_one_lane(model, rng), algebra.coordinate_count(model.system.space.kinds, model.n)
    signs = {2: (1, -2, 1), 3: (-1, 3, -3, 1)}[order]
    for _ in range(POINTS):
        start, along = (
            [
                Fraction(int(a), int(b))
                for a, b in zip(rng.integers(-99, 99, count), rng.integers(1, 99, count), strict=True)
            ]
            for _ in range(2)
        )
        total: Any = 0
        for k, sign in enumerate(signs):
            state = state_of(model.system.space, [x + k * y for x, y in zip(start, along, strict=True)], model.n)
            try:
                value = call(function, state, constants)
            except (TypeError, AttributeError, ZeroDivisionError, InputError):  # no rational function
                return False
            parts = value if isinstance(value, tuple) else (value,)
            total = total + sign * np.concatenate([np.ravel(np.asarray(v, dtype=object)) for v in parts])
        if any(v != 0 for v in total):
            return False
    return True


def has_a_small_quadratic_flow(model: Model) -> bool:
    """Whether the flow is quadratic, in few coordinates."""
    return algebra.coordinate_count(model.system.space.kinds, model.n) <= MOST_COORDINATES and is_quadratic(model)


def _of_one_lane(model: Model, rng: np.random.Generator) -> dict[str, Any]:
    """The constants of one lane, exactly."""
    return {name: one_lane(value, model.axes[name], rng) for name, value in model.constants.items()}


def _moves_as(model: Model, kinds: tuple[str, ...], rate: Callable[..., Sequence[Array]]) -> bool:
    """Whether n = 3, these are the kinds, and the flow is rate(constants, *state): exactly, in one lane."""
    if model.n != 3 or model.system.space.kinds != kinds:
        return False
    rng = np.random.default_rng(2)
    constants = _of_one_lane(model, rng)
    x, y = (np.array([Fraction(int(v), 7) for v in rng.integers(1, 99, 3)], dtype=object) for _ in range(2))
    state = (algebra.hat(x), y)[: len(kinds)]
    pairs = zip(call(model.system.flow, state, constants), rate(constants, *state), strict=True)
    return all(bool((result == expected).all()) for result, expected in pairs)


def one_lane(value: Array, axes: int, rng: np.random.Generator) -> Any:
    """A constant of one lane, or a random mean over lanes: a statement true of it is true of each."""
    flat = np.asarray(value)
    exact = np.vectorize(Fraction, otypes=[object])(flat) if flat.dtype != object else flat
    if flat.ndim == axes:
        return exact if axes else exact[()]
    lanes = exact.reshape((-1, *flat.shape[flat.ndim - axes :]))
    weights = [Fraction(int(w), 1000) for w in rng.integers(1, 1000, len(lanes))]
    return sum(w * lane for w, lane in zip(weights, lanes, strict=True)) / sum(weights)


# -- Euler's top -----------------------------------------------------------------------------------------


def is_euler_top(model: Model) -> bool:
    """Whether the flow is x_i' = alpha_i x_j x_k, with an energy: exactly, in one lane."""

    def rate(constants: Values, M: Array) -> Sequence[Array]:
        ahead, back, remainder = (call(model.system.energy, (sign * M,), constants) for sign in (1, -1, 0))
        even = int(ahead == back and remainder == 0)  # else no quadratic form
        return (algebra.hat(even * _alphas(model, constants) * _others(algebra.axial(M))),)

    return model.system.energy is not None and _moves_as(model, ("skew",), rate)


def _others(x: Array) -> Array:
    return x[..., algebra.SECOND] * x[..., algebra.THIRD]


def _alphas(model: Model, constants: Values) -> Array:
    """The alpha_i: the rate of x_i at x = (1, 1, 1)."""
    ones = algebra.hat(np.ones(3, dtype=np.int8))
    return algebra.axial(call(model.system.flow, (ones,), constants)[0])


def euler_integrals(model: Model, seen: Values, dt: Any, constants: Values) -> dict[str, Array]:
    """|M|^2/D and H/D, D = 1 - dt^2/12 sum alpha_j alpha_k x_i^2."""
    x = algebra.axial(seen[model.system.space.letters[0]])
    D = 1 - dt * dt / 12 * (_others(_alphas(model, constants)) * x * x).sum(-1)
    return {"casimir_eps": seen["casimir"] / algebra.vec(D), "energy_eps": seen["energy"] / D}


# -- Lagrange's top of equal moments ---------------------------------------------------------------------


def is_lagrange_top(model: Model) -> bool:
    """Whether the flow is m' = a ^ p, a' = m a with m = M at rest and -M in the moving frame: exactly, in one lane."""
    name, sign = _field_and_sign(model)

    def rate(constants: Values, M: Array, a: Array) -> Sequence[Array]:
        return sign * algebra.wedge(a, constants[name]), sign * algebra.act(M, a)

    return bool(name) and model.system.energy is not None and _moves_as(model, ("skew", "vector"), rate)


def _field_and_sign(model: Model) -> tuple[str, int]:
    """The name of the constant vector, "" if there is none, and the sign of m = M."""
    name = next((name for name in ("p", "A") if name in model.constants), "")
    return name, 1 if model.system.frame is Frame.REST else -1


def lagrange_integrals(model: Model, seen: Values, dt: Any, constants: Values) -> dict[str, Array]:
    """C = (|a|^2 + k l^2)/(1 + k (|m|^2 + 2 k <m, p> l + k^2 |p|^2 l^2)), l^2, and the energy; k = dt^2/4.

    l = <m, a>/(1 - k <p, a>), and |m|^2/2 + (<p, a> + k <p, a>^2/2)/(1 - k^2 |p|^2 C) is the energy.
    """
    (m, a), (name, sign) = (seen[letter] for letter in model.system.space.letters), _field_and_sign(model)
    m, p, k = sign * algebra.axial(m), constants[name], dt * dt / 4
    u, p2 = algebra.dot(p, a), algebra.dot(p, p)
    length = algebra.dot(m, a) / (1 - k * u)
    square = algebra.dot(m, m) + 2 * k * algebra.dot(m, p + 0 * m) * length + k * k * p2 * length * length
    C = (algebra.dot(a, a) + k * length * length) / (1 + k * square)
    energy = algebra.dot(m, m) / 2 + (u + k * u * u / 2) / (1 - k * k * p2 * C)
    return {"casimir_eps": np.stack([C, length * length], -1), "energy_eps": energy}


# -- Clebsch's case --------------------------------------------------------------------------------------


def is_clebsch(model: Model) -> bool:
    """Whether the flow is M' = P ^ BP, P' = -M P with B = diag(b), n = 3: exactly, in one lane."""

    def rate(constants: Values, M: Array, P: Array) -> Sequence[Array]:
        return algebra.wedge(P, constants["b"] * P), -algebra.act(M, P)

    return "b" in model.constants and _moves_as(model, ("skew", "vector"), rate)


def clebsch_integrals(model: Model, seen: Values, dt: Any, constants: Values) -> dict[str, Array]:
    """(J, (J l)^2), the energy, and <M, BM> + <P, adj(B) P> deformed.  Axial M = m, P = p, and k = dt^2/4.

    With the next state (m', p'): J = |p|^2/(1 + k <p, Bp>), J' = <p, p'>/(1 - k <p, Bp'>) and
    l = <m, (1 + k J' B) p>/|p|^2.  J/J' = 1 + 4 k (H - J l^2/2) defines the energy H; it is divided by 4 k by hand.
    With C = 1 - k J B, r = B/C, s = k (J + J'), v = J l/(J + J'), n = m - v p and w_i = r_j + r_k - r_i + s r_j r_k the
    fourth is half of

        sum C_i (r_i (2 + s r_i) (n_i^2 + v^2 p_i^2) - 2 v w_i n_i p_i + det(C) J/(J + J') w_i^2 p_i^2)

    and J (tr adj(B) + (l^2 - tr B) tr(B)/4), so that at dt = 0 they are those of the flow.  Found from Hirota-Kimura
    bases: with D = 1 + k J' B the orbits lie on <p, Cp> = J, <m, Dp> = l |p|^2 and two more quadrics.
    """
    M, p = (seen[letter] for letter in model.system.space.letters)
    new = advance(model, (M, p), dt, constants)[0]
    b, k, m = constants["b"], dt * dt / 4, algebra.axial(M)
    q, D = new[1], 1 + k * algebra.dot(p, b * p)
    J = algebra.dot(p, p) / D
    across, ahead = algebra.dot(p, b * q), algebra.dot(p, q)
    J1 = ahead / (1 - k * across)
    pitch = algebra.dot(m, p + k * algebra.vec(J1) * b * p) / algebra.dot(p, p)
    rate = (cross(q, m) + cross(p, algebra.axial(new[0]))) / 2
    work = algebra.dot(rate, cross(p, m)) / 2
    change = (work - (algebra.dot(p, p) * across + algebra.dot(p, b * p) * ahead) / 4) / (ahead * D)
    C = 1 - k * algebra.vec(J) * b
    r, share, det = b / C, J / (J + J1), C[..., 0] * C[..., 1] * C[..., 2]
    v = algebra.vec(share * pitch)
    n, s = m - v * p, k * algebra.vec(J + J1)
    second, third = r[..., algebra.SECOND], r[..., algebra.THIRD]
    w = second + third - r + s * second * third
    terms = r * (2 + s * r) * (n * n + v * v * p * p) - 2 * v * w * n * p + algebra.vec(det * share) * w * w * p * p
    trace, pairs = b.sum(-1), (b * b[..., algebra.SECOND]).sum(-1)
    return {
        "casimir_eps": stack([J, J * J * pitch * pitch]),
        "energy_eps": change + J * pitch * pitch / 2,
        "clebsch_eps": algebra.dot(C, terms) / 2 + J * (pairs + (pitch * pitch - trace) * trace / 4),
    }


# -- the Euler top in so(4) ------------------------------------------------------------------------------


def is_euler_top_of_four(model: Model) -> bool:
    """Whether it is the Euler top with n = 4, M = J Omega + Omega J."""
    return model.n == 4 and model.system.name == "euler-top"


def so4_integrals(model: Model, seen: Values, dt: Any, constants: Values) -> dict[str, Array]:
    """I = Z_p(M, M)/(1 + k Z_q(M, M)) and (I - I')/(4 k), I' = Z_p(M, M')/(1 - k Z_q(M, M')), M' the next state.

    k = dt^2/4.  Over the three ways to part 1, 2, 3, 4 into ij and l4: s = J_i + J_j, t = J_l + J_4,
    p = J_i J_j - J_l J_4, q the product of the other two p by that of all s t, and
    Z_c(x, y) = sum c (t/s x_ij y_ij - s/t x_l4 y_l4).
    """
    M = seen[model.system.space.letters[0]]
    (new,) = advance(model, (M,), dt, constants)[0]
    J, k = constants["J"], dt * dt / 4
    s, t, p = _partings(J)
    q = (
        p[..., algebra.SECOND]
        * p[..., algebra.THIRD]
        / algebra.vec((s * t)[..., 0] * (s * t)[..., 1] * (s * t)[..., 2])
    )

    def form(c: Array, x: Array, y: Array) -> Array:
        (a, d), (e, g) = _halves(x), _halves(y)
        return algebra.dot(c, t / s * a * e - s / t * d * g)

    def polar(x: Array, y: Array) -> Array:  # 2 Q(x, y) of the flow Q(x, x)
        total, first, second = (call(model.system.flow, (z,), constants)[0] for z in (x + y, x, y))
        return total - first - second

    rate = polar(M, new) / 2
    value, ahead = form(p, M, M), form(p, M, new)
    D, across = 1 + k * form(q, M, M), form(q, M, new)
    change = -form(p, M, polar(M, rate)) / 2 - (value * across + form(q, M, M) * ahead) / 4
    return {"integral_eps": stack([value / D, change / (D * (1 - k * across))])}


def _halves(M: Array) -> tuple[Array, Array]:
    """M_23, M_31, M_12, each but for its sign, and M_14, M_24, M_34."""
    return algebra.axial(M[..., :3, :3]), M[..., :3, 3]


def _partings(J: Array) -> tuple[Array, Array, Array]:
    a, last = J[..., :3], J[..., 3:]
    b, c = a[..., algebra.SECOND], a[..., algebra.THIRD]
    return b + c, a + last, b * c - a * last


# -- gyrostats -------------------------------------------------------------------------------------------


def is_gyrostat_in_a_plane(model: Model) -> bool:
    """Whether it is a gyrostat whose wheel is across some principal axis, the same in all lanes."""
    return model.system.closed_form.gyrostat is not None and bool(_across(model.constants["h"]).any())


def _across(h: Array) -> Array:
    return (h == 0).reshape(-1, 3).all(0)


def gyrostat_integrals(model: Model, seen: Values, dt: Any, constants: Values) -> dict[str, Array]:
    """For each axis i with h_i = 0: w_i |M|^2 - 2 H + <h, w h>, deformed; w = 1/I, b = w h, d = w_i - w, k = dt^2/4.

    (d_j x_j^2 + d_k x_k^2 + 2 b_j x_j + 2 b_k x_k - k x_i^2 (d_k b_j^2 + d_j b_k^2))/(1 + k d_j d_k x_i^2), x = M.
    """
    x, w = algebra.axial(seen["M"]), constants["w"]
    b, k, out = w * constants["h"], dt * dt / 4, []
    for i in np.flatnonzero(_across(model.constants["h"])):
        square = x[..., i] * x[..., i]
        d = algebra.vec(w[..., i]) - w
        second, third = ((i + 1) % 3, (i + 2) % 3)
        lost = d[..., third] * b[..., second] ** 2 + d[..., second] * b[..., third] ** 2
        above = algebra.dot(d, x * x) + 2 * algebra.dot(b, x) - k * square * lost
        out.append(above / (1 + k * d[..., second] * d[..., third] * square))
    return {"gyrostat_eps": stack(out)}


# -- which of them ---------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Deformed:
    """Integrals of the map of order 2: their definitions, and their values on the rows of a run."""

    applies: Callable[[Model], bool]
    values: Callable[[Model, Values, Any, Values], dict[str, Array]]
    meanings: Mapping[str, str]
    divides_by: str = ""

    def check(self, model: Model, state: tuple[Array, ...]) -> None:
        """Raises `InputError` for states at which they divide by 0."""
        for letter, x in zip(model.system.space.letters, state, strict=False):  # and g
            if letter == self.divides_by and (algebra.dot(x, x) == 0).any():
                raise InputError(
                    f"method='kahan' of {model.system.name}: expected {letter} != 0, got 0. Its integrals divide by "
                    f"|{letter}|, and nothing moves without it. Use another method, or leave this state out."
                )


BOTH = {"casimir_eps": "Casimirs", "energy_eps": "energy"}
KNOWN = (
    Deformed(is_euler_top, euler_integrals, BOTH),
    Deformed(is_lagrange_top, lagrange_integrals, BOTH),
    Deformed(is_euler_top_of_four, so4_integrals, {"integral_eps": "quadratic integral, and one more"}),
    Deformed(
        is_gyrostat_in_a_plane, gyrostat_integrals, {"gyrostat_eps": "w_i |M|^2 - 2 H of each axis i across the wheel"}
    ),
    Deformed(is_clebsch, clebsch_integrals, BOTH | {"clebsch_eps": "<M, BM> + <P, adj(B) P>"}, "P"),
)
