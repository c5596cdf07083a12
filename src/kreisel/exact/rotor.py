"""The free body, n = 3, with its orientation at any times: set up once in extended digits, then cheap in doubles.

Formulas and letters: docs/exact.md, "The free body".  Axes are numbered so that the motion goes round the third; s is
the sign of I_3 - I_1, chi = -1 where the new axes are left-handed.  [Jacobi 1849; Whittaker, Analytical Dynamics,
section 69; van Zon and Schofield, J. Comput. Phys. 225 (2007) 145 for the shortest rotation; Carlson 1995]
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.algebra.reuse import cached_property
from kreisel.exact.nutation import MpNumber, mp_number, rationals
from kreisel.exact.parts import (
    BINARY,
    LEAST_PLACES,
    ORDERS,
    PHASE_BITS,
    SETTLED,
    TAIL,
    TERMS,
    convolved,
    cos_sin,
    crossed,
    from_middle,
    left_out,
    orbit_in_parts,
    polynomials,
)
from kreisel.record.contract import Orbit

DIGITS = 32  # of the set-up, beyond the digits that rotations, a small k' and a small a_3 use up
STILL = np.array([1.0, 0.0, 0.0, 0.0])


@dataclass(frozen=True)
class Axes:
    """Axes i = (i_1, i_2, i_3) of the body in the order of the closed form; e = side e_(i_3), chi = -1: left-handed."""

    i: tuple[int, ...]
    side: int
    chi: int

    @classmethod
    def of(cls, mu: Array, moments: Array, L2: Fraction, T2: Fraction) -> Axes:
        """From rationals.  The third axis of a steady motion across the axis of a symmetric body is that axis."""
        i = sorted(range(3), key=lambda k: moments[k])
        gap = L2 - T2 * moments[i[1]]
        if gap < 0 or (gap == 0 and moments[i[1]] == moments[i[2]]):
            i.reverse()
        side = 1 if mu[i[2]] >= 0 else -1
        return cls(tuple(i), side, side if i in ([0, 1, 2], [1, 2, 0], [2, 0, 1]) else -side)

    def back(self, N: Array, turns: bool = False) -> Array:
        """Vectors (..., 3), or vector parts of rotations, in the order of the body."""
        out = np.empty_like(N)
        out[..., self.i] = N * (np.array([1, 1, self.side]) * (self.chi if turns else 1))
        return out

    def turn(self, q: Array) -> Array:
        """A quaternion (..., 4) in the order of the body."""
        return np.concatenate([q[..., :1], self.back(q[..., 1:], turns=True)], -1)


class Rotor:
    """The motion through mu (3,) of a body with the moments (3,), taken as exact; `reach`: the largest |time| asked.

    start     the orientation at time 0, a unit quaternion, or None if it is not asked for
    gap       L^2 - 2T I_2; 0 on the separatrix and about the middle axis
    quarter   K, infinite if gap = 0; of steady motions that of a small disturbance, as lam is
    mean      the mean rate of psi
    """

    def __init__(self, mu: Array, moments: Array, reach: float, start: Array | None = None):
        import mpmath

        self.ctx = mpmath.MPContext()
        mu, values = rationals(mu), rationals(moments)
        self.L2, self.T2 = (mu * mu).sum(), (mu * mu / values).sum()
        self.axes = Axes.of(mu, values, self.L2, self.T2)
        self.I, self.start = [Fraction(values[k]) for k in self.axes.i], start
        self.N = [mu[k] for k in self.axes.i]
        self.N[2] *= self.axes.side
        rates = [mu[j] * mu[k] * (1 / values[j] - 1 / values[k]) for j, k in ((1, 2), (2, 0), (0, 1))]
        self.steady = not any(rates)
        self.ctx.dps = DIGITS
        self._constants()
        fastest = max(self.L / min(self._numbers(self.I)), self.lam)
        spread = max(0, int(self.ctx.mag(self.ctx.mpf(reach) * fastest))) if reach and fastest else 0
        self.bits = 64 + PHASE_BITS + 53 + max(0, math.frexp(reach)[1])
        self.ctx.dps = DIGITS + int(spread * math.log10(2)) + self._lost + 1
        self._constants()

    @property
    def start_along(self) -> list[MpNumber]:
        """M/L at time 0 along the axes in the order of the closed form."""
        return [v / self.L for v in self._numbers(self.N)]

    def _numbers(self, values: list[Fraction]) -> list[MpNumber]:
        return [mp_number(self.ctx, v) for v in values]

    def _constants(self) -> None:
        """Values that the integrals determine."""
        ctx, (I1, I2, I3) = self.ctx, self.I
        self.L = ctx.sqrt(mp_number(ctx, self.L2))
        D, E, gap = self.T2 * I3 - self.L2, self.L2 - self.T2 * I1, self.L2 - self.T2 * I2
        self.gap, self.s, self._lost = gap, 1 if I3 > I1 else -1, 0
        self.lam = ctx.sqrt(mp_number(ctx, (I3 - I2) * E / (I1 * I2 * I3)))
        if self.steady:
            self.quarter = ctx.pi / 2 if gap else ctx.inf
            self.mean = mp_number(ctx, self.T2) / self.L if self.L else ctx.zero
            return
        squares = I1 * D / (I3 - I1), I2 * D / (I3 - I2), I3 * E / (I3 - I1)
        self.a = [ctx.sqrt(v) for v in self._numbers(list(squares))]
        self.k2 = (I2 - I1) * D / ((I3 - I2) * E)
        self.k_prime = ctx.sqrt(mp_number(ctx, (I3 - I1) * gap / ((I3 - I2) * E)))
        a3, total = self.a[2], self.L + self.a[2]
        B = mp_number(ctx, D / I3) / (self.lam * total)
        self.separatrix, self.quarter = gap == 0, ctx.inf
        if self.separatrix:  # the same half-plane of M_1 stays
            self.a[:2] = [a if self.N[0] > 0 else -a for a in self.a[:2]]
            self.slope = B * total / self.L  # psi' tends to L/I_2
        else:
            self._lost = max(0, -int(ctx.log10(self.k_prime))) - int(ctx.log10(a3 / self.L))
            self.k1 = mp_number(ctx, self.k2) / (1 + self.k_prime) ** 2
            self.k1_prime = 2 * ctx.sqrt(self.k_prime) / (1 + self.k_prime)
            self.K1 = ctx.pi / (2 * ctx.agm(1, self.k1_prime))
            self.quarter = (1 + self.k1) * self.K1
            self.beta = self.k1 * self.a[0] ** 2 / total**2
            self.complete = ctx.elliprj(0, self.k1_prime**2, 1, 1 + self.beta) / 3
            ripple = 2 * a3 * self.k1 / total
            self.slope = B * (1 + ripple * self.complete / self.K1)
            self.ripple = B * (1 + self.k1) * ripple
        self.mean = self.L / mp_number(ctx, I3) + self.lam * self.slope

    @cached_property
    def u0(self) -> MpNumber:
        """The u at time 0."""
        cn, sn, dn = (n / a for n, a in zip(self._numbers(self.N), self.a, strict=True))
        if self.separatrix:
            return self.ctx.asinh(sn / cn)
        u0 = sn * self.ctx.elliprf(cn**2, dn**2, 1)
        return u0 if cn >= 0 else (2 if sn >= 0 else -2) * self.quarter - u0

    def _clock(self) -> None:
        """The length of a part in u, and how many parts there are."""
        ctx = self.ctx
        self.places, self.settled = LEAST_PLACES, 0
        if self.steady:
            return
        self._inverse = [1 / i - 1 / self.I[2] for i in self.I]
        unit = ctx.one if self.separatrix else 2 * self.quarter
        self.psi0 = self._psi(self.u0)[1]
        bounds = abs(self._series(ctx.zero, ctx.one).astype(np.float64)).sum(1) * 2.0**-BINARY
        halvings = 0
        while left_out(bounds, float(unit / 2**halvings)) > TAIL:  # at u = 0, next to the poles
            halvings += 1
        if self.separatrix:
            self.interval = 2 * unit / 2**halvings
            self.settled = int(ctx.ceil((SETTLED + abs(self.u0)) / self.interval))
            halvings = (2 * self.settled + 1).bit_length()
        self.places = max(LEAST_PLACES, halvings)
        if not self.separatrix:
            self.interval = 2 * unit / 2**self.places

    def _psi(self, u: MpNumber) -> tuple[list[MpNumber], MpNumber]:
        """(cn, sn, dn) at u, and s (psi - mean t) from u = 0 on, which has the period 2 K."""
        ctx = self.ctx
        if self.separatrix:
            sech, tanh = ctx.sech(u), ctx.tanh(u)
            a1, a3 = abs(self.a[0]), self.a[2]
            factor = -2 * mp_number(ctx, (self.T2 * self.I[2] - self.L2) / self.I[2]) * a3 / (self.lam * self.L * a1)
            return [sech, tanh, sech], factor * ctx.atan(a1 / (self.L + a3) * ctx.tanh(u / 2))
        v = u / (1 + self.k1)
        turns = ctx.nint(v / (2 * self.K1))
        v, sign = v - 2 * self.K1 * turns, -1 if int(turns) % 2 else 1
        s, c, d = (ctx.ellipfun(name, v, m=self.k1**2) for name in ("sn", "cn", "dn"))
        denominator = 1 + self.k1 * s**2
        place = [sign * c * d / denominator, sign * (1 + self.k1) * s / denominator, (1 - self.k1 * s**2) / denominator]
        if self.start is None:
            return place, ctx.zero
        third = s**3 * ctx.elliprj(c**2, d**2, 1, 1 + self.beta * s**2) / 3
        return place, self.ripple * (third - v / self.K1 * self.complete)

    # -- parts ---------------------------------------------------------------------------------------------

    def _series(self, u: MpNumber, h: MpNumber) -> Array:
        """cn, sn, dn, and the quaternion z p of the closed form freed of the mean rotation, as power series, (ORDERS,
        7).

        In (u' - u)/h, integers of BINARY binary places; without an orientation the first three.

            cn' = -sn dn,  sn' = cn dn,  dn' = -k^2 cn sn,   2 q' = q w,   w = s (1/I - mean/L) M/lambda
        """
        ctx = self.ctx
        place, psi = self._psi(u)

        def fixed(x: MpNumber) -> int:
            return int(ctx.ldexp(x, BINARY))

        X, step, k2 = [[fixed(x)] for x in place], fixed(h), fixed(h * mp_number(ctx, self.k2))
        if self.start is not None:
            half, lift = self.s * (psi - self.psi0) / 2, self._lift([a * x for a, x in zip(self.a, place, strict=True)])
            turn = np.array([ctx.cos(half), 0, 0, ctx.sin(half)], dtype=object)
            q = [[fixed(x)] for x in algebra.quaternion_product(turn, lift)]
            inverse = (v / self.lam for v in self._numbers(self._inverse))
            weights = (v - self.slope / self.L for v in inverse)
            w = [fixed(self.s * h * a * v / 2) for a, v in zip(self.a, weights, strict=True)]
        for k in range(1, ORDERS):
            cn, sn, dn = X
            rates = [-step * (convolved(sn, dn) >> BINARY), step * (convolved(cn, dn) >> BINARY)]
            rates.append(-k2 * (convolved(cn, sn) >> BINARY))
            if self.start is not None:
                turning, (scalar, *vector) = [[(f * x) >> BINARY for x in of] for f, of in zip(w, X, strict=True)], q
                rates_of_q = [-sum(map(convolved, vector, turning))]
                along = (convolved(scalar, x) for x in turning)
                rates_of_q += [x + y for x, y in zip(along, crossed(vector, turning, convolved), strict=True)]
                for of, rate in zip(q, rates_of_q, strict=True):
                    of.append((rate >> BINARY) // k)
            for of, rate in zip(X, rates, strict=True):
                of.append((rate >> BINARY) // k)
        return np.array(X if self.start is None else [*X, *q], dtype=object).T

    def _lift(self, N: list[MpNumber]) -> Array:
        """The rotation p of M onto the third axis, in right-handed axes."""
        q = np.array([self.L + N[2], N[1], -N[0], self.ctx.zero], dtype=object)
        return q / self.ctx.sqrt(2 * self.L * (self.L + N[2]))

    def place(self, j: int) -> Array:
        """The polynomials (TERMS, 7) of part j in x, -1 ... 1: M, and the orientation freed of the mean rotation."""
        if self.steady:
            out = np.zeros((TERMS, 3 if self.start is None else 7))
            out[0, :3] = self.axes.back(np.array(self.N, dtype=object)).astype(np.float64)
            out[0, 3:] = STILL[: out.shape[1] - 3]
            return out
        j = from_middle(j, self.places)
        out = polynomials(self._series(self.u0 + j * self.interval, self.interval / 2), BINARY, self.ctx)
        out[:, :3] = self.axes.back(out[:, :3] * np.array([float(a) for a in self.a]))
        if not j:
            out[0, :3] = self.axes.back(np.array(self.N, dtype=object)).astype(np.float64)
        if self.start is not None:
            out[:, 3:] = self.axes.turn(out[:, 3:])
        return out

    # -- phases --------------------------------------------------------------------------------------------

    def orbit(self) -> Orbit:
        """The states (M,) or (M, g).  The second phase is half of psi, so that g is continuous in time."""
        self._clock()
        ctx, direction = self.ctx, 0 if self.steady else self.axes.chi * self.s
        parts = direction * self.lam / self.interval if direction else ctx.zero
        moving, turning = (int(ctx.floor(ctx.ldexp(v, self.bits))) for v in (parts, self.mean / (4 * ctx.pi)))
        return orbit_in_parts(
            self.place,
            _state if self.start is None else _oriented,
            {} if self.start is None else self._starts(),
            moving=moving,
            turns=(turning, 0),
            places=self.places,
            bits=self.bits,
            settled=self.settled if not self.steady and self.separatrix else None,
        )

    def _starts(self) -> dict[str, Array]:
        """The orientation before the first rotation, and the same times the axis of the mean rotation."""
        ctx, axis = self.ctx, np.zeros(4)
        start: Array = np.array([ctx.mpf(float(v)) for v in np.asarray(self.start)], dtype=object)
        if self.steady:
            M = self.axes.back(np.array(self._numbers(self.N), dtype=object))
            along = np.array([ctx.zero, *(M / self.L if self.L else M)], dtype=object)
        else:
            first = self.axes.turn(self._lift(self._numbers(self.N)))
            start = algebra.quaternion_product(start, algebra.inverse_turn(first))
            axis[1 + self.axes.i[2]] = self.axes.side
            along = axis.astype(object)
        turned = algebra.quaternion_product(start, along)
        return {"start": start.astype(np.float64), "turned": turned.astype(np.float64)}


def _state(place: Array, left: Array, right: Array) -> tuple[Array, ...]:
    return (algebra.hat(place[..., :3]),)


def _oriented(place: Array, left: Array, right: Array, *, start: Array, turned: Array) -> tuple[Array, ...]:
    cos, sin = cos_sin(left)
    before = algebra.vec(cos) * start + algebra.vec(sin) * turned
    return algebra.hat(place[..., :3]), algebra.quaternion_product(before, place[..., 3:])
