"""Symmetric compositions and splittings: stages of a step, and their fractions.

A composition takes a symmetric step of order 2 in stages, which makes a step of order 4, 6 or 8.

S(gamma_s dt) ... S(gamma_1 dt) with gamma_(s+1-i) = gamma_i; the coefficients as collected in Hairer, Lubich and
Wanner, Geometric Numerical Integration, second edition, section V.3.2.

A splitting of H = A + eps B is A for a_1 h, B for b_1 h, A for a_2 h, ... B for b_s h, A for a_(s+1) h, symmetric.  In
the picture that moves with A, B acts at the times c_i h, c_i = a_1 + ... + a_i, with the weights b_i; the exact
solution is the series of integrals of products of eps B over ordered times.  So the terms of eps^k are right up to h^p
if the sums over ordered products of the b_i are the integrals for all monomials in k times of degree at most p - k:

    sum_(i_1 <= ... <= i_k) w b_(i_1) c_(i_1)^(p_1) ... = int_(0 <= t_1 <= ... <= t_k <= 1) t_1^(p_1) ...,

w = 1/m! for m equal indices.  A splitting is of the order (p_1, p_2, ...) with p_k that of eps^k, the last one that of
all further powers too: its error is O(eps h^(p_1) + eps^2 h^(p_2) + ...).

A corrector C, of the same parts, makes of the step K the step C K C^-1, which is K in other variables: many steps are
C K^N C^-1, so that C^-1 is needed at the start and C where the state is seen.  It is A and B at the times +-h/2, +-h,
... +-m h/2 around that time, with weights of B that are odd in the time, and then A back to that time.  The
conditions are those of the sequence C^-1, K, C; those of eps^1 are linear in the m weights.
[Laskar, Robutel 2001; Blanes et al. 2013; Wisdom, Holman, Touma 1996]
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import cache, reduce
from itertools import pairwise, product
from typing import Any, NamedTuple

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.method.scheme import (
    Guard,
    Observed,
    Scheme,
    State,
    Steps,
    held_by_orientation,
    scheme_of,
    with_orientation,
)
from kreisel.record.model import Model

DEFECT = "defect"
SUZUKI = 4 ** (1 / 3)
FIRST_HALVES = {  # gamma_1 ... up to the middle one
    2: (1.0,),
    4: (1 / (4 - SUZUKI), 1 / (4 - SUZUKI), -SUZUKI / (4 - SUZUKI)),  # Suzuki 1990
    6: (  # Kahan and Li 1997, nine stages
        0.39216144400731413927925056,
        0.33259913678935943859974864,
        -0.70624617255763935980996482,
        0.08221359629355080023149045,
        0.79854399093482996339895035,
    ),
    8: (  # Kahan and Li 1997, seventeen stages
        0.13020248308889008087881763,
        0.56116298177510838456196441,
        -0.38947496264484728640807860,
        0.15884190655515560089621075,
        -0.39590389413323757733623154,
        0.18453964097831570709183254,
        0.25837438768632204729397911,
        0.29501172360931029887096624,
        -0.60550853383003451169892108,
    ),
}


def symmetric_composition(order: int) -> Array:
    """The fractions gamma_i of the stages."""
    half = FIRST_HALVES[order]
    return np.array(half + half[-2::-1])


Stage = Callable[[State, State, Array, Mapping[str, Array]], tuple[State, Iterable[Array], Iterable[Array]]]


def composed(
    name: str,
    model: Model,
    dt: float,
    order: int,
    oriented: bool,
    stage: Stage,
    observed: Observed,
    guard: Guard | None,
    bound: bool = True,
    **fields: Any,
) -> Scheme:
    """The scheme of a symmetric step of order 2, composed to the order; `fields` as in `scheme_of`.

    `bound`: whether an orientation rotates as the carried vectors do, as in `held_by_orientation`.

    stage(state, turned, eps, constants) -> state, turned, defects, with the orientations `turned`.  The largest defect
    so far is carried along as the component "defect" for the guard; there is none without a guard.
    """
    space, (observe, _) = model.system.space, observed
    count, last = len(space.letters), None if guard is None else -1

    def step(*z: Array, eps: Array, **constants: Array) -> State:
        state, turned, defects = stage(z[:count], z[count:last], eps, constants)
        return (*state, *turned, *(reduce(algebra.maximum, defects, defect) for defect in z[len(z[:last]) :]))

    def reopen(x: State) -> State:
        return x if guard is None else (*x, 0 * algebra.KINDS[space.kinds[0]].pack(x[0])[..., 0])

    components = with_orientation(model, oriented)
    usual: dict[str, Any] = {
        "held": None if bound else held_by_orientation(model, components, bound=False),
        "components": components + (() if guard is None else ((DEFECT, "scalar"),)),
        "axes": {**model.axes, "eps": 0},
        "stages": {"eps": symmetric_composition(order) * dt},
        "prepare": reopen,
        "reopen": reopen,
        "observe": lambda z, only=None, /, **constants: observe(z[:last], only, **constants),
        "options": {"order": order},
        "guard": guard,
        "dt_in_constants": True,
    }
    return scheme_of(name, model, Steps(step), observed, oriented, **(usual | fields))


# -- splittings ---------------------------------------------------------------------------------------

DIGITS = 40
HOLDS = 1e-14  # tolerance of a condition: published digits have 16 and more

# a_1 ... and b_1 ... up to the middle one; Blanes, Casas, Farres, Laskar, Makazaga, Murua 2013
PUBLISHED = {
    (8, 6, 4): (
        (
            "0.0711334264982231177779387300061549964174",
            "0.241153427956640098736487795326289649618",
            "0.521411761772814789212136078067994229991",
            "-0.333698616227678005726562603400438876027",
        ),
        (
            "0.183083687472197221961703757166430291072",
            "0.310782859898574869507522291054262796375",
            "-0.0265646185119588006972121379164987592663",
            "0.0653961422823734184559721793911134363710",
        ),
    ),
    (10, 6, 4): (
        (
            "0.03809449742241219545697532230863756534060",
            "0.1452987161169137492940200726606637497442",
            "0.2076276957255412507162056113249882065158",
            "0.4359097036515261592231548624010651844006",
            "-0.6538612258327867093807117373907094772607",
        ),
        (
            "0.09585888083707521061077150377145884776921",
            "0.2044461531429987806805077839164344779763",
            "0.2170703479789911017143385924306336714532",
            "-0.01737538195906509300561788011852699719871",
        ),
    ),
}


class Splitting(NamedTuple):
    """The fractions of a step: a has one more than b."""

    a: tuple[float, ...]
    b: tuple[float, ...]


BETWEEN = Splitting((1.0, 0.0), (1.0,))  # a step with a corrector: A after a kick is merged with A before the next
CORRECTED = {(10, 2): 4, (18, 2): 8}  # weights m of the corrector of a single kick, which leaves O(eps h^(2 m + 2))


@cache
def splitting(order: Any) -> Splitting:
    """The splitting of that order: (2 n, 2) of n kicks, a published one, or one order for all powers of eps.

    Of one with a corrector the step `BETWEEN`.  Raises `ArithmeticError` where an order condition does not hold.
    """
    import mpmath

    with mpmath.workdps(DIGITS):
        a, b = _fractions(order)
        require_conditions((2, 2) if order in CORRECTED else order, a, b)
        return BETWEEN if order in CORRECTED else Splitting(tuple(map(float, a)), tuple(map(float, b)))


@cache
def corrector(order: Any) -> Splitting | None:
    """Half of A, then C of a splitting of that order, in fractions of a step; None without.

    Raises `ArithmeticError` where an order condition of the inverse, a step, and this does not hold.
    """
    import mpmath

    if order not in CORRECTED:
        return None
    with mpmath.workdps(DIGITS):
        result = _correcting(Splitting(*map(tuple, _fractions(order))), CORRECTED[order])
        require_conditions(order, *joined(inverse(result), BETWEEN, result))
        return Splitting(tuple(map(float, result.a)), tuple(map(float, result.b)))


def inverse(parts: Splitting) -> Splitting:
    """The parts backwards, with the other sign."""
    return Splitting(tuple(-x for x in parts.a[::-1]), tuple(-x for x in parts.b[::-1]))


def joined(*splittings: Splitting) -> Splitting:
    """One after the other; where two meet, both of their A."""
    a, b = splittings[0]
    for splitting in splittings[1:]:
        a, b = (*a[:-1], a[-1] + splitting.a[0], *splitting.a[1:]), (*b, *splitting.b)
    return Splitting(a, b)


def require_conditions(order: Any, a: Sequence[Any], b: Sequence[Any]) -> None:
    """Raises `ArithmeticError` where parts do not have that order."""
    for k, degrees in conditions(order if isinstance(order, tuple) else (order,)):
        off = abs(ordered_sum(a, b, degrees) - ordered_integral(degrees))
        if off > HOLDS:
            raise ArithmeticError(f"splitting {order}: the condition of eps^{k} on {degrees} is off by {off}")


def _correcting(leapfrog: Splitting, count: int) -> Splitting:
    """Half of A, and kicks by `count` weights w at the times t_j = j/2 behind and before.

    sum b c^p + sum_j w_j ((1 + t_j)^p - t_j^p) = 1/(p + 1) for p <= 2 count + 1.
    """
    import mpmath

    half, step = mpmath.mpf(1) / 2, mpmath.mpf(1)  # no motion is longer than a step
    places = [half * j for j in range(1, count + 1)]
    powers = range(2, 2 * count + 1, 2)  # odd ones follow, by symmetry
    left = [[(1 + t) ** p - (1 - t) ** p for t in places] for p in powers]
    right = [ordered_integral((p,)) - ordered_sum(leapfrog.a, leapfrog.b, (p,)) for p in powers]
    weights = list(mpmath.lu_solve(mpmath.matrix(left), mpmath.matrix(right)))
    steps = count // 2
    nothing = [0 * step] * (steps - 1)  # on the way there and back
    b = [*nothing, *(-w for w in weights[::-1]), 0 * step, *weights, *nothing]
    return Splitting((*[-step] * (steps - 1), -half, *[half] * (2 * count), *[-step] * steps), tuple(b))


def _fractions(order: Any) -> tuple[list[Any], list[Any]]:
    import mpmath

    if order in PUBLISHED:
        a, b = ([mpmath.mpf(text) for text in half] for half in PUBLISHED[order])
        odd = len(a) > len(b)  # the middle one is an a
        return a + (a[-2::-1] if odd else a[::-1]), b + (b[::-1] if odd else b[-2::-1])
    if isinstance(order, tuple):  # kicks at the nodes of Gauss and Legendre, with their weights
        count = 1 if order in CORRECTED else order[0] // 2
        legendre = mpmath.taylor(lambda x: mpmath.legendre(count, x), 0, count)[::-1]
        nodes = sorted(mpmath.polyroots(legendre), key=mpmath.re)
        weights = [2 / ((1 - x * x) * mpmath.diff(lambda t: mpmath.legendre(count, t), x) ** 2) for x in nodes]
        times = [mpmath.mpf(0), *((1 + x) / 2 for x in nodes), mpmath.mpf(1)]
        return [y - x for x, y in pairwise(times)], [w / 2 for w in weights]
    half = [mpmath.mpf(gamma) for gamma in FIRST_HALVES[order]]
    half[-1] = 1 - 2 * sum(half[:-1])
    b = half + half[-2::-1]
    ends = [0, *b, 0]
    return [(x + y) / 2 for x, y in pairwise(ends)], b


def conditions(orders: tuple[int, ...]) -> Iterator[tuple[int, tuple[int, ...]]]:
    """(k, degrees) of all conditions: monomials t_1^p_1 ... t_k^p_k with k + sum p <= the order in eps^k."""
    for k in range(1, max(orders) + 1):
        most = orders[min(k, len(orders)) - 1] - k
        for degrees in product(range(most + 1), repeat=k):
            if sum(degrees) <= most:
                yield k, degrees


def ordered_sum(a: Sequence[Any], b: Sequence[Any], degrees: tuple[int, ...]) -> Any:
    """sum_(i_1 <= ... <= i_k) w b_(i_1) c_(i_1)^(p_1) ..., w = 1/m! for m equal indices."""
    totals = [1, *(0 for _ in degrees)]  # of the first j factors, over the kicks so far
    time = 0
    for step, weight in zip(a, b, strict=False):
        time += step
        factors = [weight * time**degree for degree in degrees]
        for last in range(len(degrees), 0, -1):
            term: Any = 1
            for m in range(1, last + 1):  # the last m of the factors fall on this kick
                term = term * factors[last - m] / m
                totals[last] += totals[last - m] * term
    return totals[-1]


def ordered_integral(degrees: tuple[int, ...]) -> Any:
    """int_(0 <= t_1 <= ... <= t_k <= 1) t_1^p_1 ... t_k^p_k = prod_j 1/(p_1 + ... + p_j + j)."""
    import mpmath

    out, total = mpmath.mpf(1), 0
    for j, degree in enumerate(degrees, 1):
        total += degree
        out /= total + j
    return out
