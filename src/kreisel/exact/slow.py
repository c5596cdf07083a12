"""Few parts for a Lagrange top, n = 3, that is slow but for whole turns: beside the critical sleeping top.

There the period of nutation is long, and within it the top turns many times about p and about its axis at rates

    phi' = (c - J z)/(1 - z^2),   psi' = (J - c z)/(1 - z^2)

(|p| = |b| = 1, z = b.p).  Freed of all these turns, not of their fractions alone, the state changes as slowly as z.
Series of what is slow, made of fast equations, lose digits: as many more are taken.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from kreisel.exact.nutation import Nutation, mp_number
from kreisel.exact.parts import ORDERS, TAIL, left_out

if TYPE_CHECKING:
    from kreisel.exact.motion import TopMotion

SAMPLES = 64  # of z in half a period, for the whole turns
PLACES = 4  # first parts, as a power of two: where the series are made that say how many there must be
MARGIN = 1e-2  # between them the series may converge more slowly


def whole_turns(motion: TopMotion) -> tuple[int, int]:
    """The turns about p and about the axis, in a period, beyond the fractions that the integrals tell."""
    ctx, known, nutation = motion.ctx, motion.integrals, motion.nutation
    x1, x2, x3 = nutation.x
    A, p = (ctx.sqrt(mp_number(ctx, v)) for v in (known.A, known.P2))
    c, J, E = mp_number(ctx, known.c) / p, mp_number(ctx, known.J) / A, mp_number(ctx, known.E)
    one, other = ctx.zero, ctx.zero
    for k in range(SAMPLES):
        t = nutation.half_period * (k + ctx.mpf(1) / 2) / SAMPLES
        u = ctx.sqrt(x3 - x1) * t / 2
        x = x1 + (x2 - x1) * ctx.ellipfun("sn", u=u, m=(x2 - x1) / (x3 - x1)) ** 2
        z = (x / 2 + E) / (A * p)
        one, other = one + (c + J) / (1 + z), other + (c - J) / (1 - z)
    unit = nutation.half_period / (SAMPLES * 2 * ctx.pi)  # of a rate, in turns a period: (one + other)/2 is phi'
    return int(ctx.nint((one + other) * unit)), int(ctx.nint((one - other) * unit))


def take_fewer_parts(motion: TopMotion, fastest: float) -> None:
    """Leave out all whole turns, where that makes fewer parts do; `fastest`, a rate of the equations."""
    ctx, known = motion.ctx, motion.integrals
    before = ctx.dps, motion.binary, motion.nutation, motion.means, motion.places, motion.part
    lost = ORDERS * math.log10(max(10.0, fastest * float(motion.nutation.half_period)))
    ctx.dps += int(lost)
    motion.binary += int(lost * math.log2(10))
    motion.nutation = Nutation(ctx, known)
    motion.begin()
    period, turn = 2 * motion.nutation.half_period, 2 * ctx.pi
    fractions = [motion.nutation.period_turn(dual) / turn for dual in (False, True)]
    whole = whole_turns(motion)
    means = [f + ctx.nint(n - f) for f, n in zip(fractions, (whole[0], -whole[1]), strict=True)]
    motion.means = [v / period for v in means]
    motion.places, motion.part = PLACES, period / (1 << PLACES)
    more = _halvings(motion)
    if more is not None and PLACES + more < before[4]:
        motion.refine(more)
        return
    ctx.dps, motion.binary, motion.nutation, motion.means, motion.places, motion.part = before
    motion.begin()


def _halvings(motion: TopMotion) -> int | None:
    """How often the parts must be halved."""
    worst = np.zeros(ORDERS)
    for j in range(1 << PLACES):
        for inside in (False, True):
            found, _ = motion.series(j, inside)
            sizes = abs(np.ldexp(found.astype(np.float64), -motion.binary))
            for first, last in ((0, 3), (3, 6), (6, 10)):
                own = sizes[:, first:last].sum(1)
                worst = np.maximum(worst, own / max(own[0], np.finfo(float).tiny))
    for more in range(12):
        if left_out(worst, 0.5**more) < MARGIN * TAIL:
            return more
    return None
