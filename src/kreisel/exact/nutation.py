"""The Lagrange top for n = 3 in closed form, in extended digits: formulas and letters of docs/exact.md.

m' = p x b, b' = m x b; vectors, p fixed.  The integrals are exact rationals of the given doubles; everything else is a
number of an mpmath context, which the caller gives the digits that it needs.  R_F and R_J are Carlson's.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.algebra.reuse import cached_property

MpNumber = Any  # of an mpmath context


def darboux(m: Array, b: Array, p: Array, eps: Array, r: Array) -> tuple[Array, Array, Array]:
    """D_eps at (m, b), and its a; r = |a|^2.  Matrices m, any kind of number."""
    a = algebra.resolvent(algebra.mat(eps) / 2 * m, (b - algebra.vec(eps * eps / 4 * r) * p)[..., None])[..., 0]
    m1 = m + algebra.mat(eps) * algebra.wedge(a, p)
    return m1, b + algebra.vec(eps) / 2 * algebra.act(m + m1, a), a


def rationals(x: Array) -> Array:
    """An array of doubles, or of rationals, as exact rationals."""
    return np.vectorize(Fraction, otypes=[object])(np.asarray(x))


@dataclass(frozen=True)
class Integrals:
    """The integrals of a motion, exact."""

    A: Fraction
    P2: Fraction
    J: Fraction
    c: Fraction
    E: Fraction

    @classmethod
    def of(cls, m: Array, b: Array, p: Array) -> Integrals:
        """From axial vectors of rationals."""
        dot = algebra.dot
        return cls(dot(b, b), dot(p, p), dot(m, b), dot(m, p), dot(m, m) / 2 + dot(b, p))

    @property
    def dual(self) -> Integrals:
        """The integrals of the body's view (m, b, p) -> (-M, P, A): the same cubic, other angles."""
        return Integrals(self.P2, self.A, -self.c, -self.J, self.E)

    @property
    def K(self) -> Fraction:
        """2 J P2 - 2 E c + c^3/P2, for p not 0; C(-c^2/P2) = -K^2/P2."""
        return 2 * self.J * self.P2 - 2 * self.E * self.c + self.c**3 / self.P2

    @cached_property
    def depressed(self) -> tuple[Fraction, Fraction]:
        """(u, v) with C = y^3 + u y + v in y = x + 4E/3."""
        E, Jc = self.E, self.J * self.c
        c1 = 4 * (E * E + Jc - self.A * self.P2)
        c0 = 4 * (2 * E * Jc - self.c**2 * self.A - self.J**2 * self.P2)
        return c1 - 16 * E * E / 3, 128 * E**3 / 27 - 4 * E / 3 * c1 + c0

    @property
    def discriminant(self) -> Fraction:
        """(x1 - x2)^2 (x2 - x3)^2 (x3 - x1)^2."""
        u, v = self.depressed
        return -4 * u**3 - 27 * v**2

    @cached_property
    def coincident(self) -> tuple[Fraction, Fraction, Fraction] | None:
        """The roots x1 <= x2 <= x3 where two or three coincide, exact; else None."""
        if self.discriminant != 0:
            return None
        u, v = self.depressed
        single, double = (3 * v / u, -3 * v / (2 * u)) if u else (Fraction(0), Fraction(0))
        x1, x2, x3 = sorted(y - 4 * self.E / 3 for y in (single, double, double))
        return x1, x2, x3

    @property
    def separatrix(self) -> bool:
        """x2 = x3: the motion tends to a steady one, or is one."""
        return self.coincident is not None and self.coincident[1] == self.coincident[2]


def mp_number(ctx: Any, x: Fraction) -> MpNumber:
    """A rational in the digits of the context."""
    return ctx.mpf(x.numerator) / x.denominator


class Nutation:
    """Values that the integrals determine: roots, half period, tau and theta of eps, eps of a time."""

    def __init__(self, ctx: Any, integrals: Integrals):
        self.ctx, self.integrals = ctx, integrals
        self.x = self._roots()

    def _roots(self) -> tuple[MpNumber, MpNumber, MpNumber]:
        """x1 <= x2 <= x3, in twice the digits if they are close; exact where two or three coincide."""
        ctx = self.ctx
        if self.integrals.coincident is not None:
            x1, x2, x3 = (mp_number(ctx, x) for x in self.integrals.coincident)
            return x1, x2, x3
        digits = ctx.dps
        ctx.dps = 2 * digits + 10
        try:
            U, V = (mp_number(ctx, w) for w in self.integrals.depressed)
            size = 2 * ctx.sqrt(-U / 3)
            angle = ctx.acos(3 * V / (U * size))
            shift = mp_number(ctx, 4 * self.integrals.E / 3)
            x = sorted(size * ctx.cos((angle - 2 * ctx.pi * k) / 3) - shift for k in range(3))
        finally:
            ctx.dps = digits
        return x[0], x[1], x[2]

    @cached_property
    def half_period(self) -> MpNumber:
        """omega_1 = 2 R_F(0, x3 - x1, x3 - x2); infinite on the separatrix."""
        x1, x2, x3 = self.x
        return self.ctx.inf if self.integrals.separatrix else 2 * self.ctx.elliprf(0, x3 - x1, x3 - x2)

    def tau(self, eps: MpNumber) -> MpNumber:
        """The time that D_eps needs, odd in eps; |eps| <= 2/sqrt(x3) where x3 > 0, imaginary beyond infinity."""
        eps = self.ctx.convert(eps)
        x0 = self.ctx.re(4 / eps**2)
        return self._direction(eps) * 2 * self.ctx.elliprf(*(x0 - x for x in self.x))

    def theta(self, eps: MpNumber, dual: bool = False) -> MpNumber:
        """The angle about p of D_eps beyond the flow, odd in eps; 0 if p = 0.  `dual`: about A in the body."""
        integrals, ctx = self.integrals.dual if dual else self.integrals, self.ctx
        if integrals.P2 == 0:
            return ctx.zero
        eps = ctx.convert(eps)
        P2, c, K, x0 = (
            mp_number(ctx, integrals.P2),
            mp_number(ctx, integrals.c),
            mp_number(ctx, integrals.K),
            ctx.re(4 / eps**2),
        )
        p = ctx.sqrt(P2)
        third = ctx.elliprj(*(x0 - x for x in self.x), x0 + c**2 / P2) if integrals.K else ctx.zero
        return turning(p, c, K, self.tau(eps), self._direction(eps) * third) + self.angle(eps, c / p)

    def _direction(self, eps: MpNumber) -> MpNumber:
        """The sign of the time."""
        return self.ctx.sign(self.ctx.re(eps) + self.ctx.im(eps))

    def angle(self, eps: MpNumber, slope: MpNumber) -> MpNumber:
        """The arctan(eps slope/2), for imaginary eps continued from large real ones."""
        ctx = self.ctx
        if ctx.im(eps) == 0:
            return ctx.atan(eps * slope / 2)
        return self._direction(eps) * ctx.sign(slope) * ctx.pi / 2 - ctx.atan(2 / (eps * slope))

    def period_turn(self, dual: bool = False) -> MpNumber:
        """theta_P: the flow over the period 2 omega_1 is Rot_p(theta_P), mod 2 pi; 0 if p = 0."""
        integrals, ctx = self.integrals.dual if dual else self.integrals, self.ctx
        if integrals.P2 == 0:
            return ctx.zero
        P2, c = mp_number(ctx, integrals.P2), mp_number(ctx, integrals.c)
        p, (x1, x2, x3) = ctx.sqrt(P2), self.x
        if integrals.K == 0:  # -c^2/P2 is a root
            nearest = min(self.x, key=lambda x: abs(x + c**2 / P2))
            return c * self.half_period / p + (ctx.pi if nearest == x2 else 0)
        third = ctx.elliprj(x3 - x1, x3 - x2, 0, x3 + c**2 / P2)
        return ctx.pi - 2 * turning(p, c, mp_number(ctx, integrals.K), self.half_period, third)

    def beyond(self, eps: MpNumber) -> tuple[MpNumber, MpNumber]:
        """(tau, theta) of the map on the other branch of r, where the square root in it is negative.

        With growing step the map comes there through x0 = x3, tau = omega_1; as eps -> 0 it becomes the half-turn
        about p.
        """
        ctx, integrals, eps = self.ctx, self.integrals, self.ctx.convert(eps)
        time = ctx.sign(eps) * 2 * self.half_period - self.tau(eps)
        if integrals.P2 == 0:
            return time, ctx.zero
        lean = 2 * ctx.atan(eps * mp_number(ctx, integrals.c) / (2 * ctx.sqrt(mp_number(ctx, integrals.P2))))
        return time, ctx.sign(eps) * (ctx.pi - self.period_turn()) - self.theta(eps) + lean

    def epsilon(self, h: MpNumber) -> MpNumber:
        """The eps with tau(eps) = h, for |h| <= omega_1: 4/eps^2 = x3 + (x3 - x1) cs^2(u, k).

        Imaginary where x0 = 4/eps^2 < 0: the map and the rotation by theta are complex then, their product, the flow,
        is real.  NaN where x0 <= 0 and theta has a pole on the way, x0 <= -c^2/P2 or x0 <= -J^2/A: take h in parts.
        """
        ctx, (x1, x2, x3), h = self.ctx, self.x, self.ctx.convert(h)
        if h == 0:
            return ctx.zero
        if x1 == x3:
            x0 = x3 + 4 / h**2
        else:
            u = ctx.sqrt(x3 - x1) * abs(h) / 2
            cs = 1 / ctx.sinh(u) if x2 == x3 else ctx.ellipfun("cs", u=u, m=(x2 - x1) / (x3 - x1))
            x0 = x3 + (x3 - x1) * cs**2
        seen = [v for v in (self.integrals, self.integrals.dual) if v.P2]
        least = min((mp_number(ctx, v.c**2 / v.P2) for v in seen), default=ctx.zero)
        if x0 < 0 < x0 + least:
            return ctx.mpc(0, 2 * ctx.sign(h) / ctx.sqrt(-x0))
        return 2 * ctx.sign(h) / ctx.sqrt(x0) if x0 > 0 else ctx.nan

    def length(self, eps: MpNumber) -> MpNumber:
        """The constant r = |a|^2 on the branch that is |b|^2 at eps = 0."""
        integrals, s = self.integrals, self.ctx.convert(eps) ** 2 / 4
        A, J, c, E = (mp_number(self.ctx, v) for v in (integrals.A, integrals.J, integrals.c, integrals.E))
        root = self.ctx.one
        for x in self.x:
            root = root * self.ctx.sqrt(1 - s * x)
        return squared_length(s, root, A, J, c, E)


def turning(p: Any, c: Any, K: Any, tau: Any, third: Any) -> Any:
    """|p| (-c/(2 P2) tau + K/(3 P2) third), |p|^2 = P2: of theta and theta_P what grows with tau; `third` is an R_J."""
    return (K * third / 3 - c * tau / 2) / p


def squared_length(s: Array, root: Array, A: Any, J: Any, c: Any, E: Any) -> Array:
    """The |a|^2 = 2 (A + s J^2)/(1 + 2sE + 2 s^2 Jc + root), root^2 = (1 - s x1)(1 - s x2)(1 - s x3)."""
    return 2 * (A + s * J * J) / (1 + 2 * s * E + 2 * s * s * J * c + root)
