"""kr.lab.search: a family of discrete Lagrangians, its members looked at one by one and ranked.

For the kinetic part -(1/eps) tr log(2I + W + W^T) and any potential U(P) the discrete Euler-Poincare equations are
explicit: with M' = d'_W Lambda = (2/eps) (W - I)(W + I)^-1 and W M' W^T = M',

    M' = M + P ^ grad U(P),   P' = cay(-(eps/2) M') P,

rational where grad U is.  Such members are judged exactly: degrees of the iterates over finite fields, and the
integrals that the finder finds.  For -(1/eps) tr(WJ) the step is Moser and Veselov's root after the same kick; other
kinetic parts are Lagrangians in JAX.  Those are judged in floats: by what stands still to round-off, and by chaos.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from kreisel.algebra import Array, cayley_act, dot, trace_log, vec, wedge
from kreisel.errors import InputError, RunError
from kreisel.lab import dynamics
from kreisel.lab.fields import fraction
from kreisel.lab.questions import QUESTIONS as _QUESTIONS
from kreisel.lab.questions import Clues
from kreisel.lab.subject import Subject, subject
from kreisel.lab.verdicts import filled
from kreisel.record.contract import MOVING_SPACE, Map, PhaseSpace, System
from kreisel.record.model import Model
from kreisel.sweeps.workers import check_workers, pool
from kreisel.system import euler_top

if TYPE_CHECKING:
    import pandas as pd

Gradient = Callable[[Array, Any], Array]  # (P, eps) -> grad U(P)
LABELS = {question.__name__.strip("_"): question for question in _QUESTIONS}
MOST = 10_000  # members


def explicit(gradient: Gradient, name: str = "explicit", n: int = 3) -> Model:
    """The map of -(1/eps) tr log(2I + W + W^T) + U(P)."""

    def step(M: Array, P: Array, *, eps: Any) -> tuple[Array, Array]:
        M = M + wedge(P, gradient(P, eps))
        return M, cayley_act(-eps / 2 * M, P)

    return model_of(name, n, Map(step=step))


def veselov(gradient: Gradient, J: Sequence[Any], name: str = "veselov") -> Model:
    """The map of -(1/eps) tr(WJ) + U(P), n = 3, on the branch W -> 1 as eps -> 0."""
    body = np.array([float(v) for v in J])
    c = euler_top.sums(J=body)["c"]

    def step(M: Array, P: Array, *, eps: Any) -> tuple[Array, Array]:
        N = M + wedge(P, gradient(P, eps))
        X = euler_top.turn(N, J=body, c=c, eps=eps)[0]
        return euler_top.move(N, X)[0], cayley_act(-X, P)

    return model_of(name, len(J), Map(step=step, rational=False))


def model_of(name: str, n: int, mapped: Map, space: PhaseSpace = MOVING_SPACE) -> Model:
    """A map on e*(n) as a model."""
    system = System(
        name=name,
        title="a member of a family of discrete Lagrangians",
        equations="",
        source="",
        space=space,
        scaling="",
        map=mapped,
        n=n,
    )
    return system()


# -- families ---------------------------------------------------------------------------------------


def logarithmic(c: Any, kappa: Any = Fraction(1, 4), gravity: Any = 0, b: Sequence[Any] = (1, 2, 4)) -> Model:
    """U = (c/eps) log(1 + kappa eps^2 <P, BP>) - eps gravity <P, e_n>.  The paper's: c = 2 (printed 4), kappa = 1/4."""
    B, axis = exact_constants(b), exact_constants([0] * (len(b) - 1) + [1])
    c, kappa, gravity = (exact_constants(v) for v in (c, kappa, gravity))

    def gradient(P: Array, eps: Any) -> Array:
        den = 1 + kappa * (eps * eps) * dot(P, B * P)
        return vec(2 * c * kappa * eps / den) * (B * P) - gravity * eps * axis + 0 * P

    return explicit(gradient, "logarithmic", len(b))


def quadratic(c: Any = Fraction(1, 2), b: Sequence[Any] = (1, 2, 4)) -> Model:
    """U = c eps <P, BP>: the potential of the flow itself."""
    B, c = exact_constants(b), exact_constants(c)
    return explicit(lambda P, eps: 2 * c * eps * (B * P), "quadratic", len(b))


def axial_potential(beta: Any = 0, kappa: Any = 0, mu: Any = 0) -> Model:
    """The potential U = -eps V(<P, e_3>), V' = (1 + beta u + mu u^2)/(1 + kappa eps^2 u).  The paper's: all 0."""
    axis = exact_constants([0, 0, 1])
    beta, kappa, mu = (exact_constants(v) for v in (beta, kappa, mu))

    def gradient(P: Array, eps: Any) -> Array:
        u = P[..., 2]
        slope = (1 + beta * u + mu * (u * u)) / (1 + kappa * (eps * eps) * u)
        return vec(-eps * slope) * axis + 0 * P

    return explicit(gradient, "axial")


def veselov_with_potential(gravity: Any = 0, quadratic: Any = 0, J: Sequence[Any] = (1, 2, 4)) -> Model:
    """-(1/eps) tr(WJ) - eps gravity <P, e_3> + eps quadratic <P, JP>/2.  Veselov's: both 0."""
    axis, B, g, q = np.array([0.0, 0.0, 1.0]), np.array([float(v) for v in J]), float(gravity), float(quadratic)
    return veselov(lambda P, eps: -g * eps * axis + q * eps * (B * P), J)


def modified_kinetic(sigma: float = 2.0, alpha: float = 0.5) -> Model:
    """-(alpha/eps) tr log(2I + W + W^T) - (sigma (1 - alpha)/eps) log(1 + <A, WA>) - eps <P, WA>, A = e_3.

    A Lagrangian in JAX.  The paper's (section 6.2): sigma = 2, for any alpha.
    """
    import jax.numpy as jnp

    from kreisel import reduction as red

    def discrete(W: Array, P: Array, *, sigma: float, alpha: float, eps: float) -> Any:
        kinetic = alpha / eps * trace_log(2 * jnp.eye(3) + W + W.T)
        return -kinetic - sigma * (1 - alpha) / eps * jnp.log(1 + W[2, 2]) - eps * (P @ W)[2]

    system = red.system("modified-kinetic", group=red.SO(3), discrete=discrete)
    return system(sigma=float(sigma), alpha=float(alpha))


def mixed_kinetic(theta: float = 1.0, J: Sequence[float] = (0.4, 1.0, 1.7)) -> Model:
    """-(1/eps) (tr(WJ) + (1 - theta) tr(WJWJ)/4), no potential; in JAX.  Veselov's: theta = 1."""
    import jax.numpy as jnp

    from kreisel import reduction as red

    def discrete(W: Array, P: Array, *, theta: float, eps: float) -> Any:
        WJ = W * jnp.array(J)
        return -(jnp.trace(WJ) + (1 - theta) * jnp.trace(WJ @ WJ) / 4) / eps

    return red.system("mixed-kinetic", group=red.SO(3), discrete=discrete)(theta=float(theta))


def exact_constants(v: Any) -> Any:
    """Fractions; a scalar as itself."""
    return fraction(v) if np.ndim(v) == 0 else np.array([fraction(w) for w in v], dtype=object)


# -- judging ----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Score:
    """What was found of a member; `rank` sorts: 0 integrable, 1 not condemned, 2 condemned.

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


def judge(
    family: Callable[..., Any],
    parameters: Mapping[str, Any],
    eps: Any = Fraction(1, 3),
    degree: int | None = None,
    iterates: int = 9,
    steps: int = 4000,
    orbits: int = 2,
) -> Score:
    """One member.  An error goes into the score, so that a search goes on."""
    try:
        made = family(**parameters)
        what = made if isinstance(made, Subject) else subject(made, eps=eps)
        clues = Clues(what, degree, iterates, steps, 0)
        names = ("period", "poisson", *(["volume"] if what.dim < 5 else []), "growth", "integrals")
        for name in names if not what.implicit else ("poisson", "integrals"):
            LABELS[name](clues)
        found = _orbits(clues, steps, orbits)
    except (InputError, RunError) as error:
        return Score(parameters, (), None, math.nan, 0, 0, math.nan, 0, 0, False, False, str(error))
    growth, ranks, numeric = clues.growth, clues.ranks, clues.numeric
    chaotic = sum(o.chaotic for o in found)
    exponential = growth is not None and growth.exponential
    complete = filled(clues) or (numeric is not None and numeric.enough)
    return Score(
        parameters=parameters,
        degrees=growth.degrees if growth else (),
        power=growth.power if growth else None,
        entropy=growth.entropy if growth else math.nan,
        on_leaf=ranks.with_more if ranks else numeric.on_leaf if numeric else len(clues.found),
        needed=ranks.needed if ranks else numeric.leaf // 2 if numeric else what.dim - 1,
        exponent=max((float(o.exponents[0]) for o in found), default=math.nan),
        chaotic=chaotic,
        orbits=len(found),
        integrable=complete and not exponential and not chaotic,
        condemned=exponential or chaotic > 0,
    )


def _orbits(clues: Clues, steps: int, orbits: int) -> list[dynamics.Dynamics]:
    out = []
    slow = clues.what.model is not None and clues.what.model.system.numbers == "jax"
    for k in range(orbits if steps else 0):
        try:
            out.append(dynamics.dynamics(clues.what, steps=steps, count=1 if slow else None, seed=10 * k))
        except RunError:
            continue  # it escapes: no answer
    return out


@dataclass(frozen=True)
class Ranking:
    """The members, best first."""

    scores: tuple[Score, ...]

    @property
    def table(self) -> pd.DataFrame:
        """One row a member."""
        import pandas as pd

        rows = [
            {
                **{k: str(v) for k, v in s.parameters.items()},
                "verdict": s.verdict,
                "growth": f"k^{s.power}"
                if s.power is not None
                else ""
                if math.isnan(s.entropy)
                else f"{s.entropy:.3g}",
                "integrals": f"{s.on_leaf} of {s.needed}" if s.needed else "",
                "exponent": s.exponent,
                "chaotic": f"{s.chaotic} of {s.orbits}",
            }
            for s in self.scores
        ]
        return pd.DataFrame(rows)


def search(
    family: Callable[..., Any],
    grid: Mapping[str, Sequence[Any]],
    *,
    workers: int | None = 0,
    scheduler: str | None = None,
    **options: Any,
) -> Ranking:
    """Judge every member of a family and rank them.

    family     parameters -> a model, or a `Subject`: `logarithmic`, `axial_potential`, ... of this module, or a
               function of yours
    grid       name -> values; all combinations
    workers    processes of Dask, as in `kr.sweep`; 0: this one.  `scheduler`: the address of one
    options    of `judge`: eps, degree, iterates, steps (0: no orbits in floats), orbits

    Raises `InputError` for an empty grid, too many members, and as `kr.sweep` does.
    """
    check_workers(workers, scheduler)
    members = [dict(zip(grid, values, strict=True)) for values in itertools.product(*grid.values())]
    if not 1 <= len(members) <= MOST or not grid:
        raise InputError(f"A grid of 1 to {MOST:,} members was expected, got {len(members):,}.")
    work = partial(_judged, family, options)
    scores: list[Any] = [None] * len(members)
    with pool(workers, scheduler, False) as who:
        for place, score in who.map(work, members):
            scores[place] = score
    return Ranking(tuple(sorted(scores, key=_sort_key)))


def _judged(family: Callable[..., Any], options: Mapping[str, Any], parameters: Mapping[str, Any]) -> Score:
    return judge(family, parameters, **options)


def _sort_key(s: Score) -> tuple[float, ...]:
    entropy = math.inf if math.isnan(s.entropy) else s.entropy
    exponent = math.inf if math.isnan(s.exponent) else s.exponent
    return (s.rank, s.needed - s.on_leaf, entropy, s.power or 0, exponent)


__all__ = [
    "Ranking",
    "Score",
    "axial_potential",
    "explicit",
    "judge",
    "logarithmic",
    "mixed_kinetic",
    "modified_kinetic",
    "quadratic",
    "search",
    "veselov",
    "veselov_with_potential",
]
