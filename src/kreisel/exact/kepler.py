"""A step of two point masses in closed form, for ellipses, parabolas and hyperbolas.

r'' = -mu r/|r|^3.  With s' = 1/|r| and G_k(s), s^k/k! - s^(k+2) beta/(k+2)! + ... for beta = 2 mu/|r| - v^2,

    h = |r| G_1 + (r.v) G_2 + mu G_3,   |r(h)| = |r| G_0 + (r.v) G_1 + mu G_2,
    r(h) = r + (-mu G_2/|r|) r + (h - mu G_3) v,   v(h) = v - mu G_1/(|r| |r(h)|) r - (mu G_2/|r(h)|) v.

The first equation is solved for s by Laguerre's method, which bisects where it leaves the bracket.  [Stumpff 1959;
Conway, Celest. Mech. 39 (1986) 199; Wisdom, Hernandez, MNRAS 453 (2015) 3015]
"""

from __future__ import annotations

from math import factorial, pi
from typing import Any

from kreisel import algebra
from kreisel.algebra import Array, dot, vec
from kreisel.algebra.invariants import stack
from kreisel.algebra.iteration import repeat

FAST, FULL = (3, 7), (4, 9)  # halvings of s and terms of the series: to rounding for |beta| s^2 up to 30, 500
SMALL = 1e-12  # (the last change of s)^2 relative to s^2: the next one would be below rounding
FEW, MOST = 3, 16  # iterations: for steps that are a small part of a nearly circular orbit, and for all others
TINY = 1e-290
ALMOST_PARABOLIC = 1e-10  # beta |r|/mu: its period has no meaning
ROOTS = 4  # Newton's steps to a bound above a cube root


def step(r: Array, v: Array, *, mu: Any, h: Any) -> tuple[Array, Array]:
    """(r, v) after the time h, of either sign; r, v (..., 3)."""
    distance, radial = algebra.sqrt(dot(r, r)), dot(r, v)
    beta = 2 * mu / distance - dot(v, v)
    size = algebra.maximum(beta, ALMOST_PARABOLIC * mu / distance)
    period = 2 * pi * mu / (size * algebra.sqrt(size))
    h = h + 0 * distance  # without complete revolutions
    h = h - algebra.where_less(beta, size, 0 * h, algebra.nearest(h / period)) * period
    sign = algebra.where_less(h, 0 * h, -1 + 0 * h, 1 + 0 * h)
    span, ahead = sign * h, sign * radial

    def improved(s: Any, size: tuple[int, int]) -> tuple[Any, Any]:
        """The correction of s, and the corrected s."""
        g0, g1, g2, g3 = series(beta, s, *size)
        miss = distance * g1 + ahead * g2 + mu * g3 - span
        slope = distance * g0 + ahead * g1 + mu * g2
        curvature = ahead * g0 + (mu - beta * distance) * g1
        square = 16 * slope * slope - 20 * miss * curvature
        return miss, s - 5 * miss / (slope + algebra.sqrt(algebra.maximum(square, -square)) + TINY)

    def bracketed(X: Array) -> tuple[tuple[Array], Array]:
        s, low, high, open_ = X[..., 0], X[..., 1], X[..., 2], X[..., 3]
        miss, new = improved(s, FULL)
        low, high = algebra.where_less(miss, 0 * miss, s, low), algebra.where_less(miss, 0 * miss, high, s)
        new = algebra.where_less((new - low) * (high - new), 0 * new, (low + high) / 2, new)
        new = algebra.where_less(0 * open_, open_, new, s)
        left = _unsettled(new, s) * open_
        return (stack([new, low, high, left]),), left

    s = before = span * algebra.maximum(beta, 0.1 * mu / distance) / mu
    for _ in range(FEW):
        before, (_, s) = s, improved(s, FAST)
    unsettled = _unsettled(s, before)

    def slowly() -> Array:
        first, most = _bounds(span, distance, ahead, beta, dot(v, v), mu)
        start = algebra.where_less(0 * unsettled, unsettled, first, s)
        (X,), _ = repeat(bracketed, (stack([start, 0 * first, most, unsettled]),), -1.0, MOST, ("R^4",))
        return X[..., :1]

    s = algebra.if_positive(unsettled, slowly, stack([s]))[..., 0]
    g0, g1, g2, g3 = series(beta, sign * s, *FULL)
    moved = distance * g0 + radial * g1 + mu * g2
    return (
        r + (vec(-mu * g2 / distance) * r + vec(h - mu * g3) * v),
        v - (vec(mu * g1 / (distance * moved)) * r + vec(mu * g2 / moved) * v),
    )


def _unsettled(new: Any, old: Any) -> Any:
    """1 where the last change of s was large, or not a number, else 0."""
    change = (new - old) * (new - old)
    return algebra.where_less(change, SMALL * (new * new) + TINY, 0.0, 1.0)


def series(beta: Any, s: Any, halvings: int, terms: int) -> tuple[Any, Any, Any, Any]:
    """G_0, G_1, G_2 and G_3."""
    u = s / 2**halvings
    x, c2, c3 = beta * u * u, 0 * s, 0 * s
    for k in range(terms - 1, -1, -1):
        c2, c3 = 1 / factorial(2 * k + 2) - x * c2, 1 / factorial(2 * k + 3) - x * c3
    g2, g3 = u * u * c2, u * u * u * c3
    g1, g0 = u - beta * g3, 1 - beta * g2
    for _ in range(halvings):
        g1, g2, g3 = 2 * g0 * g1, 2 * g1 * g1, 2 * (g3 + g1 * g2)
        g0 = 1 - beta * g2
    return g0, g1, g2, g3


def _bounds(span: Any, distance: Any, ahead: Any, beta: Any, square: Any, mu: Any) -> tuple[Any, Any]:
    """A first s for a time span >= 0, and an s that is too large.

    span >= s times the pericentre.  Ellipses: |E - E_0 - M + M_0| <= 2.  Others: span >= mu s^3/24, and for hyperbolas
    sinh(S/2) <= N/(2 (e - 1)) with S and N in units of theirs.
    """
    momentum = algebra.maximum(distance * distance * square - ahead * ahead, TINY) / mu
    e = algebra.sqrt(algebra.maximum(1 - momentum * beta / mu, 0 * beta))
    most = (1 + 1e-6) * span * (1 + e) / (momentum + TINY)
    root = algebra.sqrt(algebra.maximum(beta, TINY))

    def of_open() -> Array:
        above, size = algebra.sqrt(distance / mu), algebra.maximum(-beta, ALMOST_PARABOLIC * mu / distance)
        for _ in range(ROOTS):
            above = (2 * above + 24 * span / (mu * above * above)) / 3
        fast = algebra.sqrt(size)
        late = size * fast * span / (mu * algebra.maximum(e - 1, TINY))
        least = algebra.where_less(late, 1e-2 + 0 * late, above, 2.1 * algebra.log(1 + late) / fast)
        above = -algebra.maximum(-above, -least)
        return stack([-algebra.maximum(-span / distance, -above / 2), -algebra.maximum(-above, -most)])

    ellipse = span * beta / mu
    closed = stack([ellipse, -algebra.maximum(-most, -(ellipse + 2.5 / root))])
    bounds = algebra.if_positive(ALMOST_PARABOLIC * mu / distance - beta, of_open, closed)
    return bounds[..., 0], bounds[..., 1]
