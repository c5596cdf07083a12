"""kr.lab.search: families of maps, their members looked at one by one and ranked.

The map of -(1/eps) tr log(2I + W + W^T) + U(P), U minus the potential energy of a step, is explicit, and rational if
grad U is:

    M' = M + P ^ grad U(P),   P' = cay(-(eps/2) M') P.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array, act, cayley, cayley_act, dot, identity, mat, objects, vec, wedge
from kreisel.algebra.gradient import value_and_jacobian
from kreisel.algebra.invariants import cross
from kreisel.errors import InputError, RunError, explained, shown
from kreisel.lab import dynamics
from kreisel.lab.exact import fraction, fractions, rational_random
from kreisel.lab.questions import QUESTIONS, Clues, filled
from kreisel.lab.subject import Subject, coordinate_names, coordinates, subject
from kreisel.method.kahan import eliminate
from kreisel.record.contract import FIELD_SPACE, MOVING_SPACE, TWO_FIELDS_SPACE, Map, PhaseSpace, System
from kreisel.record.model import Model
from kreisel.sweeps.workers import check_workers, pool
from kreisel.system.quadratic_field import potential

if TYPE_CHECKING:
    import pandas as pd


Gradient = Callable[[Array, Any], Array]  # (P, eps) -> grad U(P)
MOST = 10_000  # members


def explicit(gradient: Gradient, name: str = "explicit", n: int = 3) -> Model:
    """The map of -(1/eps) tr log(2I + W + W^T) + U(P)."""

    def step(M: Array, P: Array, *, eps: Any) -> tuple[Array, Array]:
        M = M + wedge(P, gradient(P, eps))
        return M, cayley_act(-eps / 2 * M, P)

    return model_of(name, n, Map(step=step))


def model_of(name: str, n: int, mapped: Map, space: PhaseSpace = MOVING_SPACE) -> Model:
    """A map on e*(n) as a model."""
    title = "a member of a family of discrete Lagrangians"
    return System(name, title=title, equations="", source="", space=space, scaling="", map=mapped, n=n)()


# -- families ---------------------------------------------------------------------------------------


def logarithmic(
    c: Any, kappa: Any = Fraction(1, 4), gravity: Any = 0, b: Sequence[Any] = (1, 2, 4), gamma: Any = 0, place: int = -1
) -> Model:
    """U = (c/eps) log(1 + kappa eps^2 (<P, BP> + 2 gamma P_i)) - eps gravity <P, e_n>, i = `place`.

    The paper's: c = 2 (printed 4), kappa = 1/4.
    """
    B, (inside, axis) = fractions(b), (fractions(np.eye(len(b), dtype=int)[i]) for i in (place, -1))
    c, kappa, gravity, gamma = (fractions(v) for v in (c, kappa, gravity, gamma))

    def gradient(P: Array, eps: Any) -> Array:
        den = 1 + kappa * (eps * eps) * (dot(P, B * P) + 2 * gamma * dot(P, inside + 0 * P))
        return vec(2 * c * kappa * eps / den) * (B * P + gamma * inside) - gravity * eps * axis + 0 * P

    return explicit(gradient, "logarithmic", len(b))


# -- judging ----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Score:
    """Results for a member of a family; `rank` sorts: 0 integrable, 1 not condemned, 2 condemned.

    entropy    algebraic, exact where `power` is given; NaN for members in floats
    on_leaf, needed   independent integrals found on a leaf, and half its dimension
    exponent   the largest of Lyapunov's exponents a step, `chaotic` of `orbits` orbits
    """

    parameters: Mapping[str, Any]
    degrees: tuple[int, ...]
    power: int | None
    entropy: float
    on_leaf: int
    needed: int
    exponent: float
    chaotic: int
    orbits: int
    integrable: bool
    condemned: bool
    trouble: str = ""

    @property
    def rank(self) -> int:
        """0 integrable, 1 not condemned, 2 condemned, 3 failed."""
        return 3 if self.trouble else 0 if self.integrable else 2 if self.condemned else 1

    @property
    def verdict(self) -> str:
        """In words."""
        return ("integrable", "undecided", "not integrable", self.trouble)[self.rank]


def _member(family: Callable[..., Any], parameters: Mapping[str, Any]) -> Any:
    try:
        return explained(family)(**parameters)  # a name that it does not have is a verdict
    except (InputError, RunError):
        raise
    except Exception as error:  # whatever a user's code raises
        raise InputError(f"The family failed: {type(error).__name__}: {error}.") from error


@explained
def judge(
    family: Callable[..., Any],
    parameters: Mapping[str, Any],
    eps: Any = Fraction(1, 3),
    degree: int | None = None,
    iterates: int = 9,
    steps: int = 4000,
    orbits: int = 2,
) -> Score:
    """One member.  An error goes into the score, so that a search continues."""
    try:
        member = _member(family, parameters)
        member = member if isinstance(member, Subject) else subject(member, eps=eps)
        clues = Clues(member, degree, iterates, steps, 0)
        labels = ("period", "Poisson", *(["volume"] if member.dim < 5 else []), "degree growth", "integrals")
        for label in labels if not member.implicit else ("Poisson", "integrals"):
            QUESTIONS[label](clues)
        runs = dynamics.several(member, steps, orbits if steps else 0)[0]
    except (InputError, RunError) as error:
        return Score(parameters, (), None, math.nan, 0, 0, math.nan, 0, 0, False, False, str(error))
    growth, ranks, numeric = clues.growth, clues.ranks, clues.numeric
    chaotic = sum(o.chaotic for o in runs)
    exponential = growth is not None and growth.exponential
    complete = filled(clues) or (numeric is not None and numeric.enough)
    return Score(
        parameters=parameters,
        degrees=growth.degrees if growth else (),
        power=growth.power if growth else None,
        entropy=growth.entropy if growth else math.nan,
        on_leaf=ranks.with_more if ranks else numeric.on_leaf if numeric else len(clues.integrals),
        needed=ranks.needed if ranks else numeric.leaf // 2 if numeric else member.dim - 1,
        exponent=max((float(o.exponents[0]) for o in runs), default=math.nan),
        chaotic=chaotic,
        orbits=len(runs),
        integrable=complete and not exponential and not chaotic,
        condemned=exponential or chaotic > 0,
    )


@dataclass(frozen=True)
class Ranking:
    """The members, best first."""

    scores: tuple[Score, ...]

    @property
    def table(self) -> pd.DataFrame:
        """One row a member."""
        import pandas as pd

        rows = []
        for s in self.scores:
            power = "" if math.isnan(s.entropy) else f"{s.entropy:.3g}"
            cells = {
                "verdict": s.verdict,
                "growth": power if s.power is None else f"k^{s.power}",
                "integrals": f"{s.on_leaf} of {s.needed}" if s.needed else "",
                "exponent": s.exponent,
                "chaotic": f"{s.chaotic} of {s.orbits}",
            }
            rows.append({**{k: str(v) for k, v in s.parameters.items()}, **cells})
        return pd.DataFrame(rows)


@explained
def search(
    family: Callable[..., Any],
    grid: Mapping[str, Sequence[Any]],
    *,
    workers: int | None = 0,
    scheduler: str | None = None,
    **options: Any,
) -> Ranking:
    """Judge every member of a family and rank them.

    family     parameters -> a model, or a `Subject`: `logarithmic`, `spinning`, ... of this module, or a
               function of yours
    grid       name -> values; all combinations
    workers    processes of Dask, as in `kr.sweep`; 0: this one.  `scheduler`: the address of one
    options    of `judge`: eps, degree, iterates, steps (0: no orbits in floats), orbits

    Raises `InputError` for an empty grid, values that are not lists, too many members, and as `kr.sweep` does.
    """
    check_workers(workers, scheduler)
    if single := [name for name, values in grid.items() if np.ndim(np.asarray(values, dtype=object)) == 0]:
        raise InputError(f"grid: expected a list of values of {single[0]}, got {shown(grid[single[0]])}.")
    members = [dict(zip(grid, values, strict=True)) for values in itertools.product(*grid.values())]
    if not 1 <= len(members) <= MOST or not grid:
        raise InputError(f"A grid of 1 to {MOST:,} members was expected, got {len(members):,}.")
    work = partial(judge, family, **options)
    scores: list[Any] = [None] * len(members)
    with pool(workers, scheduler, False) as who:
        for place, score in who.map(work, members):
            scores[place] = score

    def key(s: Score) -> tuple[float, ...]:
        entropy, exponent = (math.inf if math.isnan(v) else v for v in (s.entropy, s.exponent))
        return (s.rank, s.needed - s.on_leaf, entropy, s.power or 0, exponent)

    return Ranking(tuple(sorted(scores, key=key)))


# -- further families: other potentials, spinning bodies, Kahan's maps ------------------------------------
#
# All are rational, so that members are judged exactly.  Those on e*(n) are Poisson for every value of the parameters.


def sum_of_logarithms(c: Any = 2, b: Sequence[Any] = (1, 2, 4), gravity: Any = 0) -> Model:
    """U = (c/eps) sum_i log(1 + (eps^2/4) b_i P_i^2) - eps gravity P_n: one logarithm for each axis."""
    B, axis = fractions(b), fractions([0] * (len(b) - 1) + [1])
    c, gravity = fractions(c), fractions(gravity)

    def gradient(P: Array, eps: Any) -> Array:
        return c * eps / 2 * (B * P) / (1 + eps * eps / 4 * (B * P * P)) - gravity * eps * axis

    return explicit(gradient, "sum-of-logarithms", len(b))


def spinning(s: Any = 0, tilt: Sequence[Any] = (1, 0, 0), kappa: Any = 0, b: Any = 0) -> Model:
    """A body of revolution, Omega = M + s pi M pi, pi across e_n, with its centre of mass anywhere.

    A kick by U = -eps <P, tilt> + (2/eps) log(1 + (eps^2/4) b P_n^2), divided by 1 + kappa eps^2 <P, tilt>; the paper's
    drift P -> cay(-(eps/2) M) P; and the rotation of M and P by cay((eps s/2) pi M pi).  s = 1 and tilt across the
    axis: Kovalevskaya's moments, integrable for kappa = -1/4; s = 3: Goryachev's and Chaplygin's; tilt = e_n:
    Lagrange's.
    """
    A, n = fractions(tilt), len(tilt)
    s, kappa, b = (fractions(v) for v in (s, kappa, b))

    def step(M: Array, P: Array, *, eps: Any) -> tuple[Array, Array]:
        axis = np.arange(n) == n - 1
        pull = vec(-eps / (1 + kappa * (eps * eps) * dot(P, A + 0 * P))) * A
        well = vec(eps * b / (1 + eps * eps / 4 * b * (P[..., -1] * P[..., -1]))) * (P * axis)
        M = M + wedge(P, pull + well)
        P = cayley_act(-eps / 2 * M, P)
        W = cayley(eps * s / 2 * M * (1 - axis[:, None]) * (1 - axis)) if n > 3 else _turn(M, eps * s / 2)
        return W.mT @ M @ W, act(W.mT, P)

    return model_of("spinning", n, Map(step=step))


def _turn(M: Array, t: Any) -> Array:
    """cay(t M) of only the block of the plane (1, 2): without a linear solve."""
    unit = identity(M.shape[-1])
    flat = np.arange(len(unit)) < 2
    q, plane = t * t * (M[..., 0, 1] * M[..., 0, 1]), unit * flat
    turned = mat(1 - q) * plane + mat(2 * t + 0 * q) * (M * (flat[:, None] & flat))
    return unit - plane + mat(1 / (1 + q)) * turned


def quadratic_field(c: Any = 2, b: Sequence[Any] = (1, 2, 4)) -> Model:
    """U = (c/eps) tr log(1 + (eps^2/4) B F), B = diag(b), on so(n) <x Sym(n): that of the theorem for c = 2."""
    B, c = fractions(np.diag(b)), fractions(c)

    def step(M: Array, F: Array, *, eps: Any) -> tuple[Array, Array]:
        X = potential(F, eps * eps / 4 * B)
        M = M + c * eps / 2 * (X @ B - B @ X)
        return M, algebra.KINDS["symmetric"].turned(-eps / 2 * M, F)

    return model_of("quadratic-field", len(b), Map(step=step), FIELD_SPACE)


def kovalevskaya(c: Any = 4, coupling: Any = 1, n: int = 3, gamma: Any = 0, apart: Any = 0) -> Model:
    """A body with Omega = M, but twice M_12, in two fields, in n dimensions: Kovalevskaya's, for c = 4, coupling = 1.

    U = (c/eps) log(1 - (eps^2/4) (P_1 + Q_2) + coupling (eps^2/4)^2 (P_1 Q_2 - P_2 Q_1)): for c = 4 and coupling = 1 it
    is 4/eps times the logarithm of the determinant of 1 - (eps^2/4) (P, Q) in the plane (1, 2).  A rotor of momentum
    gamma is subtracted from M_12 in the rotation; with apart = 1 it rotates the body separately.
    """
    c, coupling, gamma, apart = (fractions(v) for v in (c, coupling, gamma, apart))
    first, second = np.eye(2, n, dtype=np.int8)
    wheel = gamma * wedge(first, second)

    def step(M: Array, P: Array, Q: Array, *, eps: Any) -> tuple[Array, ...]:
        k = eps * eps / 4
        (p1, p2), (q1, q2) = ((v[..., 0], v[..., 1]) for v in (P, Q))
        scale = -c * k / eps / (1 - k * (p1 + q2) + coupling * k * k * (p1 * q2 - p2 * q1))
        on_P = vec(scale * (1 - coupling * k * q2)) * first + vec(scale * coupling * k * q1) * second
        on_Q = vec(scale * coupling * k * p2) * first + vec(scale * (1 - coupling * k * p1)) * second
        M = M + wedge(P, on_P + 0 * P) + wedge(Q, on_Q + 0 * Q)
        P, Q = (cayley_act(-eps / 2 * M, v) for v in (P, Q))
        W = _turn(M - (1 - apart) * wheel, eps / 2) @ _turn(-apart * wheel + 0 * M, eps / 2)
        return W.mT @ M @ W, act(W.mT, P), act(W.mT, Q)

    return model_of("kovalevskaya", n, Map(step=step), TWO_FIELDS_SPACE)


def kahan(flow: Any, names: Sequence[str], eps: Any = Fraction(1, 3), adjustment: Any = None) -> Subject:
    """Kahan's map of a quadratic flow x' = flow(x) on values of any field; adjustment(x) adds to eps/2 flow'(x).

    Raises `InputError` for flows that are not quadratic.
    """
    eps = fraction(eps)
    start, along = fractions(rational_random(np.random.default_rng(0))((2, len(names))))
    try:
        rates = [objects(flow(start + k * along)) for k in range(4)]
    except Exception as error:  # whatever a user's code raises
        raise InputError(f"flow failed at fractions: {type(error).__name__}: {error}.") from error
    if len(rates[0]) != len(names) or any(rates[3] - 3 * rates[2] + 3 * rates[1] - rates[0]):
        raise InputError(
            f"flow: expected {len(names)} rates of degree 2 or less in {', '.join(names)}, as Kahan's method needs, "
            f"got {len(rates[0])}{' of a higher degree' * (len(rates[0]) == len(names))}. Usual cause: powers above 2; "
            "with a new variable for each square a flow may become quadratic."
        )

    def step(x: Array) -> Array:
        rates, slopes = value_and_jacobian(lambda y: list(flow(objects(y))), list(x), [])
        matrix = [[(i == j) - eps / 2 * v for j, v in enumerate(row)] for i, row in enumerate(slopes)]
        if adjustment is not None:
            matrix = [[v - w for v, w in zip(*rows, strict=True)] for rows in zip(matrix, adjustment(x), strict=True)]
        change, _ = eliminate(matrix, [eps * v for v in rates])
        return objects(y + z for y, z in zip(x, change, strict=True))

    return subject(step, names=tuple(names))


def kahan_map(model: Model, eps: Any = Fraction(1, 3)) -> Subject:
    """Kahan's map of a model whose flow is quadratic in the state."""
    model = Model(model.system, {k: fractions(v) for k, v in model.params.items()})  # derived parameters are exact too
    unpacked, packed = coordinates(model.system.space.kinds, model.n)
    names = coordinate_names(model.system.space.components, model.n)
    kahans = kahan(lambda x: packed(model.flow(*unpacked(x))), names, eps)
    return replace(kahans, name=f"Kahan's map of {model.system.name}")


def kahan_gyrostat(h: Sequence[Any] = (0, 0, 0), J: Sequence[Any] = (1, 2, 4), eps: Any = Fraction(1, 3)) -> Subject:
    """Kahan's map of M' = (M + h) x Omega, Omega_i = M_i/J_i."""
    wheel, w = _wheel_and_rates(h, J)
    return kahan(lambda M: _cross(M + wheel, w * M), ("M1", "M2", "M3"), eps)


def _wheel_and_rates(h: Sequence[Any], J: Sequence[Any]) -> tuple[Array, Array]:
    wheel, moments = fractions(h), fractions(J)
    if np.shape(wheel) != (3,) or np.shape(moments) != (3,) or not all(moments):
        raise InputError(f"Expected three values h and three moments J that are not 0, got h = {h}, J = {J}.")
    return wheel, 1 / moments


def adjusted_gyrostat(
    h: Sequence[Any] = (2, 3, 0), J: Sequence[Any] = (1, 2, 4), eps: Any = Fraction(1, 3), share: Any = 1
) -> Subject:
    """Kahan's map of M' = (M + h) x Omega, Omega_i = M_i/J_i, h_3 = 0, adjusted so that it is integrable.

    With w = 1/J and c = (h_1 w_3/(w_1 - w_3), h_2 w_3/(w_2 - w_3), 0) the third equation has one more term,

        (eps^2/4) (u(M) M3' - u(M') M3),   u(M) = h_1 w_1 (w_2 - w_3) (M - c)_1 + h_2 w_2 (w_1 - w_3) (M - c)_2,

    of the third order in eps, `share` times.  (F(M) - F(c))/(1 - (eps^2/4) (w_1 - w_3) (w_3 - w_2) M_3^2) is conserved
    for F = |M + h|^2 and F = <M, w M>.  Raises `InputError` unless h_3 = 0 and J_3 differs from J_1 and J_2.
    """
    wheel, w = _wheel_and_rates(h, J)
    if wheel[2] != 0 or w[2] in (w[0], w[1]):
        raise InputError(f"Expected h_3 = 0 and J_3 other than J_1 and J_2, got h = {tuple(h)}, J = {tuple(J)}.")
    slope = wheel[:2] * w[:2] * (w[1::-1] - w[2]) * fraction(share) * fraction(eps) ** 2 / 4
    c = wheel[:2] * w[2] / (w[:2] - w[2])

    def adjustment(M: Array) -> list[list[Any]]:
        u = slope[0] * (M[0] - c[0]) + slope[1] * (M[1] - c[1])
        return [[0, 0, 0], [0, 0, 0], [-M[2] * slope[0], -M[2] * slope[1], u]]

    return kahan(lambda M: _cross(M + wheel, w * M), ("M1", "M2", "M3"), eps, adjustment)


def kahan_heavy_top(I3: Any = 1, tilt: Sequence[Any] = (0, 0, 1), I2: Any = 1, eps: Any = Fraction(1, 3)) -> Subject:
    """Kahan's map of M' = M x Omega + P x A, P' = P x Omega, with moments (1, I2, I3)."""
    A, w = fractions(tilt), 1 / fractions((1, I2, I3))

    def flow(x: Array) -> Array:
        M, P = x[:3], x[3:]
        return np.concatenate([_cross(M, w * M) + _cross(P, A), _cross(P, w * M)])

    return kahan(flow, ("M1", "M2", "M3", "P1", "P2", "P3"), eps)


def _cross(a: Array, b: Array) -> Array:
    return objects(cross(a, b))
