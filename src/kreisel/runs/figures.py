"""kr.nutation: what a Lagrange top does, in closed form, without a simulation."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from kreisel.errors import InputError, explained
from kreisel.exact.motion import TopMotion
from kreisel.exact.nutation import Integrals, MpNumber, Nutation, mp_number
from kreisel.method.exact import motion
from kreisel.runs.settings import check_model, checked_state

if TYPE_CHECKING:
    from kreisel.record.model import Model, StateLike


@dataclass(frozen=True)
class Figures:
    """Physical figures of one motion of the Lagrange top, n = 3, in the system's units.

    kind        "nutating": the axis goes up and down, if it does not swing through the vertical;
                "steady": its height is constant, and stable: a small disturbance causes a small nutation;
                "free": without gravity, the axis goes round m in one period;
                "sleeping, critical": upright with just the spin that keeps it there, (alpha spin)^2 = 4 |a||p|;
                "sleeping, unstable": upright with less; "falling asleep": upright after an infinite time
    period      of nutation, 2 omega_1; of the small nutations about a steady motion; infinite for the last three
    lowest      least <a, p> (rest frame) or <P, A> (moving frame): |a||p| times the cosine of the tilt
    highest     greatest; for "falling asleep" never reached
    precession  the angle by which the axis goes round p in one period, right-handed about p, whole turns included.
                Where the axis goes exactly through +p or -p its azimuth jumps by pi, which is not counted.
                NaN where the axis stays on the vertical, without gravity, and where the period is infinite
    spin        angular velocity of the body about its axis, constant: <m, a>/(alpha |a|), axial m
    """

    kind: str
    period: float
    lowest: float
    highest: float
    precession: float
    spin: float

    @property
    def mean_precession(self) -> float:
        """The mean angular velocity of the axis about p."""
        return self.precession / self.period


@explained
def nutation(system: Model, x0: StateLike) -> Figures:
    """The figures of the motion through x0, for `kr.LagrangeTop`, `kr.LagrangeTopMoving`, `kr.SymmetricTop`, n = 3.

    From the closed form in extended digits.  The given doubles are taken as exact: a motion is steady or on a
    separatrix if they make it exactly so.  Raises `InputError` for other systems, n > 3 and ensembles.
    """
    check_model(system)
    if system.system.top is None or system.n != 3:
        raise InputError(f"kr.nutation is for Lagrange tops with n = 3, got {system.system.name}, n = {system.n}.")
    parts = tuple(checked_state(system, x0).values())
    if system.batch or parts[0].ndim > 2 or parts[1].ndim > 1:
        raise InputError("kr.nutation takes one motion, got an ensemble. Take one lane at a time.")
    try:
        return _figures(system, parts)
    except ZeroDivisionError:
        raise InputError(
            "expected a motion whose period a double can hold, got a slower one. Use other units."
        ) from None


def _figures(system: Model, parts: tuple[Any, ...]) -> Figures:
    here = motion(system, parts, system.constants, reach=0.0)
    top, kind = here.nutation, _kind(here)
    known, ctx, (x1, x2, _) = top.integrals, top.ctx, top.x
    height = mp_number(ctx, known.E)
    alpha = ctx.convert(float(system.constants.get("alpha", 1.0)))
    return Figures(
        kind=kind,
        period=math.inf if known.separatrix else float(2 * top.half_period),
        lowest=float((x2 if kind.startswith("sleeping") else x1) / 2 + height),
        highest=float(x2 / 2 + height),
        precession=float(_precession(ctx, known)),
        spin=float(mp_number(ctx, known.J) / ctx.sqrt(mp_number(ctx, known.A)) / alpha),
    )


def _kind(here: TopMotion) -> str:
    known = here.integrals
    if known.P2 == 0:
        return "free"
    if known.coincident is None:
        return "nutating"
    x1, x2, x3 = known.coincident
    if x2 < x3:
        return "steady"
    if x1 == x3:
        return "sleeping, critical"
    return "falling asleep" if math.isfinite(here.e_foldings()) else "sleeping, unstable"


def _precession(ctx: Any, known: Integrals) -> MpNumber:
    """The integral of |p| (c A - z J)/(A P2 - z^2) over a period, in two complete integrals of the third kind.

    z = z1 + (z2 - z1) sn^2 splits it into 1/(|b||p| - z) and 1/(|b||p| + z); a pole on the orbit has the weight 0.
    Where the orbit passes close to a pole, the distance is computed in more digits.
    """
    if known.P2 == 0 or known.separatrix:
        return ctx.nan
    vertical = known.c**2 * known.A == known.J**2 * known.P2  # the orbit reaches +p, -p, or both
    signs = [
        sign
        for sign in (1, -1)
        if not vertical or known.c * sign != abs(known.c) * (1 if known.J > 0 else -1 if known.J < 0 else 0)
    ]
    digits = ctx.dps
    while True:
        x1, x2, x3 = Nutation(ctx, known).x
        A, J, c, E = (mp_number(ctx, v) for v in (known.A, known.J, known.c, known.E))
        top_most, low, swing = ctx.sqrt(mp_number(ctx, known.A * known.P2)), x1 / 2 + E, (x2 - x1) / 2
        closest = min((top_most - sign * (low if sign < 0 else low + swing) for sign in signs), default=top_most)
        if closest > top_most * ctx.mpf(10) ** (-ctx.dps // 2):
            break
        ctx.dps *= 2
    m, weights = (x2 - x1) / (x3 - x1), [(c * A / top_most - sign * J) / 2 for sign in signs]
    gaps = [top_most - sign * low for sign in signs]
    poles = [sign * swing / gap for sign, gap in zip(signs, gaps, strict=True)]
    ctx.dps = digits
    total = sum(w / gap * ctx.ellippi(n, m) for w, gap, n in zip(weights, gaps, poles, strict=True))
    if vertical and x1 == x2:
        return ctx.nan  # asleep or hanging
    return 4 * ctx.sqrt(mp_number(ctx, known.P2)) / ctx.sqrt(x3 - x1) * total
