"""method="exact" of the Euler top, n = 3: mu' = mu x mu/I in Jacobi's elliptic functions, at any time.

With I_1 <= I_2 <= I_3 (the axes put in order, with mu -> -mu for an odd order), L = |mu|^2, T = sum mu_i^2/I_i and
u = lambda t + u_0, the motion about the third axis (L > T I_2) is mu = (a_1 cn u, s a_2 sn u, s a_3 dn u), s = sign
mu_3; about the first axis the same with 1 and 3 exchanged.  For it the moments are taken in the opposite order.
[Jacobi 1849; Whittaker, Analytical Dynamics, section 69]
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.errors import InputError
from kreisel.exact.nutation import rationals
from kreisel.method.observing import observer
from kreisel.method.scheme import Scheme, States
from kreisel.record.contract import call
from kreisel.record.model import Model

DIGITS = 40
CLOSE = 1e-3  # 1 - m below which doubles do not tell m well enough: then every time in extended digits


class Jacobi:
    """The motion through mu (3,) of a body with the moments I (3,), floats taken as exact."""

    def __init__(self, mu: Array, moments: list[Fraction], reach: float):
        import mpmath

        self.ctx = ctx = mpmath.MPContext()
        mus = [Fraction(float(v)) for v in mu]
        L, T = sum(v * v for v in mus), sum(v * v / i for v, i in zip(mus, moments, strict=True))
        order = sorted(range(3), key=lambda i: moments[i])
        if L < T * moments[order[1]]:
            order.reverse()
        self.order, odd = order, order in ([0, 2, 1], [1, 0, 2], [2, 1, 0])
        self.sign = -1 if odd else 1
        x = [self.sign * mus[i] for i in order]
        p, q, r = (moments[i] for i in order)  # the motion is about the axis of r
        self.still = p == r or L == T * r
        if self.still:
            self.start = mu
            return
        across = q * (T * r - L) / (r - q) if q != r else Fraction(0)
        squares = [p * (T * r - L) / (r - p), across, r * (L - T * p) / (r - p)]
        rate = (r - q) * (L - T * p) / (p * q * r)
        m = (q - p) * (T * r - L) / ((r - q) * (L - T * p)) if rate else Fraction(0)
        ctx.dps = DIGITS + int(math.log10(1 + reach * float(rate) ** 0.5 if rate else 1)) + 1
        number = self._number
        self.a = [ctx.sqrt(number(v)) for v in squares]
        self.side = 1 if x[2] >= 0 else -1
        if m == 1 and x[0] == 0:
            self.still, self.start = True, mu
            return
        self.m, self.lam = number(m), ctx.sqrt(number(rate)) * (1 if r >= p else -1)
        cn, sn = number(x[0]) / self.a[0], self.side * number(x[1]) / self.a[1]
        self.u0 = ctx.ellipf(ctx.atan2(sn, cn), self.m) if m < 1 else ctx.asinh(sn / cn)
        self.period = 4 * ctx.ellipk(self.m) / abs(self.lam) if m < 1 else None

    def _number(self, v: Fraction) -> Any:
        return self.ctx.mpf(v.numerator) / v.denominator

    def at(self, M: Array, e: Array) -> Array:
        """Axial vectors (times, 3) at the times M 2^e."""
        if self.still:
            return np.broadcast_to(self.start, (len(M), 3))
        cn, sn, dn = (v[:, None] for v in (self._near if self.m > 1 - CLOSE else self._usual)(M, e))
        a = [float(v) for v in self.a]
        x = np.concatenate([a[0] * cn, self.side * a[1] * sn, self.side * a[2] * dn], -1)
        out = np.empty_like(x)
        out[:, self.order] = self.sign * x
        return out

    def _usual(self, M: Array, e: Array) -> tuple[Array, ...]:
        """Reduced by whole periods in integers, then in doubles."""
        from scipy.special import ellipj

        bits = max(0, -int(np.min(e))) + 64 + max(0, -int(self.ctx.mag(self.period)))
        whole = int(self.ctx.nint(self.ctx.ldexp(self.period, bits + 64)))
        t = M.astype(object) << (np.asarray(e, dtype=object) + (bits + 64))
        rest = (t + whole // 2) % whole - whole // 2
        short = np.array([math.copysign(math.ldexp(abs(int(v)) >> 64, -bits), v) for v in rest])
        sn, cn, dn, _ = ellipj(float(self.lam) * short + float(self.u0), float(self.m))
        return cn, sn, dn

    def _near(self, M: Array, e: Array) -> tuple[Array, ...]:
        """Close to the separatrix, in extended digits."""
        ctx, out = self.ctx, []
        for k, shift in zip(M, e, strict=True):
            u = self.lam * ctx.ldexp(ctx.mpf(int(k)), int(shift)) + self.u0
            if self.period is None:
                out.append((1 / ctx.cosh(u), ctx.tanh(u), 1 / ctx.cosh(u)))
            else:
                out.append(tuple(ctx.ellipfun(name, u, m=self.m) for name in ("cn", "sn", "dn")))
        return tuple(np.array(out, dtype=np.float64).reshape(-1, 3).T)


def jacobi(model: Model, oriented: bool) -> Scheme:
    """The exact flow of the Euler top, n = 3.  Raises `InputError` for an orientation, which it does not carry."""
    if oriented:
        raise InputError(
            f"method='exact' of {model.system.name} does not carry the orientation. Use method='veselov' with order=8."
        )
    observe, outcomes = observer(model, None, None)

    def orbit(z0: tuple[Array, ...], constants: Mapping[str, Array], reach: float) -> States:
        exactly = {p.letter: rationals(constants[p.letter]) for p in model.system.parameters}
        motion = Jacobi(algebra.axial(z0[0]), list(call(model.system.moments, (), exactly)), reach)
        return lambda M, e: (algebra.hat(motion.at(M, e)),)

    return Scheme(
        name="exact",
        components=model.system.space.components,
        constants=dict(model.constants),
        axes=model.axes,
        n=3,
        prepare=tuple,
        observe=observe,
        reopen=tuple,
        orbit=orbit,
        outcomes={k: replace(o, conserved=o.kind in ("casimir", "integral")) for k, o in outcomes.items()},
    )
