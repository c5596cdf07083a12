"""One motion of the Lagrange top, n = 3, at any times: set up once in extended digits, then cheap in doubles.

A time t is n d + h with d a part of the nutation period and |h| <= d/2, by exact integer arithmetic; n = k parts + j.
The state at j d comes from the closed form in extended digits, once; from there D_eps takes h in doubles, with eps(h)
and theta(h) from their power series; k theta_P is reduced mod 2 pi in integers.  No error grows with t.
"""

from __future__ import annotations

import math
from dataclasses import astuple
from fractions import Fraction

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.errors import InputError
from kreisel.methods.nutation import Integrals, Number, Nutation, darboux, number, rationals, squared_length

TERMS = 28  # of the power series in h^2
TAIL = 1e-19  # what they leave out, by the size of their last terms
DIGITS = 32  # of the set-up, beyond those that the number of periods and close roots use up
SETTLED = 50  # e-foldings after which a separatrix motion is taken for the steady one that it tends to
LARGEST = 1e150  # of an integral: products of two must not overflow
FRACTION = 62  # bits of a reduced time or turn

NONE = Fraction(0)

Series = list[Number]


def _product(f: Series, g: Series) -> Series:
    return [sum(f[i] * g[k - i] for i in range(k + 1)) for k in range(len(f))]


def _power(f: Series, exponent: Number) -> Series:
    """f^exponent for f[0] = 1."""
    out = [f[0]]
    for k in range(1, len(f)):
        out.append(sum((i * (exponent + 1) - k) * f[i] * out[k - i] for i in range(1, k + 1)) / k)
    return out


def _weierstrass(nutation: Nutation) -> Series:
    """Y with 4/eps^2 = x0 = 4 Y(h^2)/h^2: x0 = 4 wp(h) - 4E/3, wp'^2 = 4 wp^3 - g2 wp - g3."""
    ctx, known = nutation.ctx, nutation.integrals
    u, v = (number(ctx, w) for w in known.depressed)
    wp = [ctx.one, ctx.zero, -u / 80, -v / 448]  # 1, 0, g2/20, g3/28 with g2 = -u/4, g3 = -v/16
    for k in range(4, TERMS):
        wp.append(3 * sum(wp[i] * wp[k - i] for i in range(2, k - 1)) / ((2 * k + 1) * (k - 3)))
    wp[1] = -number(ctx, known.E) / 3
    return wp


def _theta_series(nutation: Nutation, known: Integrals, Y: Series, eps: Series) -> Series:
    """Powers of h^2 in theta(h)/h: theta' = c/(2|p|) (eps'/(1 + s c^2/P2) - 1) + |p| K/(2 P2) s/(1 + s c^2/P2)."""
    ctx = nutation.ctx
    if known.P2 == 0:
        return [ctx.zero] * TERMS
    P2, c, K = (number(ctx, w) for w in (known.P2, known.c, known.K))
    p = ctx.sqrt(P2)
    shifted = [Y[0], Y[1] + c * c / (4 * P2), *Y[2:]]  # Y (1 + s c^2/P2),  s = h^2/(4Y)
    inverse = _power(shifted, ctx.mpf(-1))
    turn = _product([(2 * k + 1) * e for k, e in enumerate(eps)], _product(Y, inverse))  # eps'/(1 + s c^2/P2)
    lag = [ctx.zero, *inverse[:-1]]  # 4 s/(1 + s c^2/P2)
    rate = [c / (2 * p) * t + p * K / (8 * P2) * v for t, v in zip(turn, lag, strict=True)]
    rate[0] -= c / (2 * p)
    return [r / (2 * k + 1) for k, r in enumerate(rate)]


class Motion:
    """The motion through (m, b), axial vectors, under p: state and orientation at times M 2^e.

    `reach` is the largest |time| that will be asked; the body turns about its axis b by spin_factor (m.b)/|b| more than
    m says, without an effect on m and b.
    """

    def __init__(self, m: Array, b: Array, p: Array, *, reach: float, spin_factor: Fraction = NONE):
        import mpmath

        self.ctx = ctx = mpmath.MPContext()
        self.m, self.b, self.p = (rationals(v) for v in (m, b, p))
        self.integrals = known = Integrals.of(self.m, self.b, self.p)
        if max(abs(v) for v in astuple(known)) > LARGEST:
            raise InputError(
                f"The integrals |a|^2, |p|^2, <m, a>, <m, p> and energy must be at most {LARGEST:g} in size for the "
                "closed form, so that their products do not overflow; larger ones came. Use other units."
            )
        ctx.dps = self._digits(reach)
        self.nutation = Nutation(ctx, known)
        self._mp = tuple(np.array([number(ctx, v) for v in w], dtype=object) for w in (self.m, self.b, self.p))
        self._series()
        self._clock(reach, spin_factor)
        self._anchors: dict[int, Array] = {}

    def _digits(self, reach: float) -> int:
        """Digits for the set-up: number of periods, closeness of roots, e-foldings along a separatrix."""
        ctx, known = self.ctx, self.integrals
        scale = max(
            number(ctx, abs(known.E)),
            ctx.sqrt(number(ctx, known.A * known.P2)),
            ctx.sqrt(abs(number(ctx, known.J * known.c))),
        )
        if scale == 0:
            return DIGITS
        periods = max(0, int(ctx.log10(1 + reach * ctx.sqrt(scale))) + 1)
        if known.separatrix:
            away = self.e_foldings()
            return DIGITS + periods + (int(2 * (SETTLED + away) / math.log(10)) if math.isfinite(away) else 0)
        if known.discriminant == 0:
            return DIGITS + periods
        closeness = ctx.log10((4 * scale) ** 6 / number(ctx, known.discriminant))
        return int(DIGITS + periods + max(0, closeness))

    def e_foldings(self) -> float:
        """How far a separatrix motion is from the steady one that it tends to, x = x3; infinite if it is that."""
        ctx, known = self.ctx, self.integrals
        if known.coincident is None:
            return 0.0
        x1, _, x3 = known.coincident
        gap = x3 - 2 * (algebra.dot(self.b, self.p) - known.E)
        return float(ctx.log(number(ctx, 4 * (x3 - x1) / gap)) / 2) if gap else math.inf

    def _series(self) -> None:
        """The series of eps and the two thetas, and the |h| up to which they hold."""
        ctx, nutation, known = self.ctx, self.nutation, self.integrals
        Y = _weierstrass(nutation)
        eps = _power(Y, ctx.mpf(-0.5))
        series = [eps, _theta_series(nutation, known, Y, eps), _theta_series(nutation, known.dual, Y, eps)]
        tail = [(k, f[k]) for f in series for k in range(TERMS - 4, TERMS) if f[k] != 0]
        rate = ctx.sqrt(algebra.dot(self._mp[0], self._mp[0])) + ctx.sqrt(ctx.sqrt(number(ctx, known.A * known.P2)))
        most = [1 / rate] if rate else [ctx.one]
        self.longest = min(most + [(TAIL / abs(v)) ** (ctx.one / (2 * k)) for k, v in tail])
        self.series = [np.array([float(v * self.longest ** (2 * k)) for k, v in enumerate(f)]) for f in series]

    def _clock(self, reach: float, spin_factor: Fraction) -> None:
        """Parts of the period, and all rates as integers of `bits` binary places."""
        ctx, nutation, known = self.ctx, self.nutation, self.integrals
        if known.separatrix:
            self.parts, self.part = 0, 2 * self.longest
        else:
            self.parts = int(ctx.ceil(nutation.half_period / self.longest))
            self.part = 2 * nutation.half_period / self.parts
        spread = max(0, *(int(ctx.mag(ctx.mpf(reach) / unit)) for unit in (1, self.part)) if reach else (0,))
        self.bits = 64 + FRACTION + 53 + spread
        self.per_part = self._fixed(1 / self.part)
        turn = 2 * ctx.pi
        self.turns = [self._fixed(nutation.period_turn(dual) / turn) if self.parts else 0 for dual in (False, True)]
        spin = number(ctx, spin_factor * known.J) / ctx.sqrt(number(ctx, known.A))
        self.spin = self._fixed(spin / turn)
        self.settled = self._settled() if known.separatrix else None
        self.sleeping = self._fixed(number(ctx, known.J) / ctx.sqrt(number(ctx, known.A)) * self.part / turn)

    def _settled(self) -> int:
        """The number of parts after which a motion on the separatrix is steady: asleep with b parallel to p.

        For x3 = 2 (|b||p| - E) then: C <= 0 at b.p = |b||p|, so x2 <= 2 (|b||p| - E) <= x3 always.
        """
        away, (x1, _, x3) = self.e_foldings(), self.nutation.x
        if not math.isfinite(away):
            return 0
        return int(self.ctx.ceil((SETTLED + away) / (self.ctx.sqrt(x3 - x1) / 2 * self.part)))

    def _fixed(self, x: Number) -> int:
        return int(self.ctx.floor(self.ctx.ldexp(x, self.bits)))

    # -- in extended digits --------------------------------------------------------------------------

    def anchor(self, j: int) -> Array:
        """m, b (axial) and the orientation from time 0, a unit quaternion, at time j parts, as 10 doubles."""
        if j not in self._anchors:
            m, b, q = self.jump(j * self.part)
            self._anchors[j] = np.array([float(v) for v in (*m, *b, *q)])
        return self._anchors[j]

    def jump(self, h: Number) -> tuple[Array, Array, Array]:
        """The flow over |h| <= omega_1: m, b (axial), orientation (unit quaternion), in extended digits."""
        ctx, nutation, known = self.ctx, self.nutation, self.integrals
        m, b, p = self._mp
        q = np.array([ctx.one, ctx.zero, ctx.zero, ctx.zero], dtype=object)
        if h == 0:
            return m, b, q
        count = 2 if abs(h) > nutation.half_period / 2 else 1
        while ctx.isnan(eps := nutation.epsilon(h / count)):
            count += 1
        r, axis, hat_m = nutation.length(eps), b, algebra.hat(m)
        for _ in range(count):
            old = b
            hat_m, b, a = darboux(hat_m, b, p, eps, r)
            q = algebra.quaternion_product(half_turns(a, old), q)
        A = ctx.sqrt(number(ctx, known.A))
        left = -count * nutation.theta(eps)
        right = count * (2 * ctx.atan(eps * number(ctx, known.J) / (2 * A)) + nutation.theta(eps, dual=True))
        turn = self._about(p, left)
        q = algebra.quaternion_product(algebra.quaternion_product(turn, q), self._about(axis, right))
        R = algebra.rotation_matrix(turn)
        return R @ algebra.axial(hat_m), R @ b, q / ctx.sqrt(algebra.dot(q, q))

    def _about(self, axis: Array, angle: Number) -> Array:
        ctx = self.ctx
        length = ctx.sqrt(algebra.dot(axis, axis))
        along = axis / length if length else axis
        return np.concatenate([[ctx.cos(angle / 2)], ctx.sin(angle / 2) * along])

    # -- in doubles ------------------------------------------------------------------------------------

    def at(self, M: Array, e: Array, oriented: bool = False) -> tuple[Array, ...]:
        """The axial m and b, (times, 3), and, if asked, the orientation (times, 4) at times M 2^e.

        M are Python integers in an object array, e small integers; both of shape (times,).
        """
        if len(M) == 1:  # NumPy sums a lone matrix product in another order: numbers must not depend on the batch
            return tuple(v[:1] for v in self.at(np.repeat(M, 2), np.repeat(e, 2), oriented))
        low = int(e.min(initial=0))
        scaled, bits = M << (e - low).astype(object), self.bits - low  # times in units of 2^low
        spun = _turns(scaled * self.spin, bits)
        return self._at_parts(scaled * self.per_part, bits, 0.0, spun, oriented)

    def iterate(self, k: Array, tau: Number, theta: Number) -> tuple[Array, ...]:
        """The axial m and b after k steps (integers) of a map: the flow over tau, then the turn theta about p."""
        if len(k) == 1:
            return tuple(v[:1] for v in self.iterate(np.repeat(k, 2), tau, theta))
        turned = _turns(k * self._fixed(theta / (2 * self.ctx.pi)), self.bits)
        return self._at_parts(k * self._fixed(tau / self.part), self.bits, turned, 0.0, oriented=False)

    def _at_parts(self, v: Array, bits: int, left: Array, right: Array, oriented: bool) -> tuple[Array, ...]:
        """At times v in parts, integers with `bits` binary places, and with further turns about p and b."""
        n = (v + (1 << (bits - 1))) >> bits
        k, j = 0 * n, n
        if self.parts:
            k = (n + self.parts // 2) // self.parts
            j = n - k * self.parts
        left, right = left + _turns(k * self.turns[0], self.bits), right - _turns(k * self.turns[1], self.bits)
        rest = v - (n << bits)
        if self.settled is not None:
            j = np.minimum(np.maximum(n, -self.settled), self.settled)
            beyond = np.where(j == n, 0, v - (j << bits))
            rest = np.where(j == n, rest, 0)
            right = right + _turns(beyond * self.sleeping, bits + self.bits)
        h = (rest >> (bits - FRACTION)).astype(np.float64) * 2.0**-FRACTION * float(self.part)
        places, which = np.unique(j.astype(np.int64), return_inverse=True)
        start = np.array([self.anchor(int(place)) for place in places])[which]
        return self._ahead(start, h, left, right, oriented)

    def _ahead(self, start: Array, h: Array, left: Array, right: Array, oriented: bool) -> tuple[Array, ...]:
        """D_eps(h) from the anchors, with its turns and those of the periods."""
        polyval = np.polynomial.polynomial.polyval
        y = (h / float(self.longest)) ** 2
        eps, theta, theta_dual = (h * polyval(y, f) for f in self.series)
        known = self.integrals
        A, J, c, E = (float(v) for v in (known.A, known.J, known.c, known.E))
        x = [float(v) for v in self.nutation.x]
        m, b, p = algebra.hat(start[:, :3]), start[:, 3:6], self.p.astype(np.float64)
        m1, b1, a = darboux(m, b, p, eps, squared_length(np.sqrt, eps * eps / 4, x, A, J, c, E))
        turn = rotation(p, left - theta)
        R = algebra.rotation_matrix(turn)
        out = algebra.act(R, algebra.axial(m1)), algebra.act(R, b1)
        if not oriented:
            return out
        spun = rotation(self.b.astype(np.float64), right + theta_dual + 2 * np.arctan(eps * J / (2 * math.sqrt(A))))
        q = start[:, 6:]
        for left_factor in (half_turns(a, b), turn):
            q = algebra.quaternion_product(left_factor, q)
        q = algebra.quaternion_product(q, spun)
        return (*out, q / np.sqrt(algebra.dot(q, q))[..., None])


def half_turns(a: Array, b: Array) -> Array:
    """The turn R_a R_b, R_x = 2 x x^T/|x|^2 - 1, as a quaternion of length |a| |b|."""
    return np.concatenate([(a * b).sum(-1, keepdims=True), np.cross(b, a)], -1)


def _turns(scaled: Array, bits: int) -> Array:
    """The fraction of a turn in integers of `bits` binary places, as an angle in doubles."""
    part = (scaled & ((1 << bits) - 1)) >> (bits - FRACTION)
    return part.astype(np.float64) * (2.0**-FRACTION * 2 * np.pi)


def rotation(axis: Array, angle: Array) -> Array:
    """The turn about an axis, of any length, as a unit quaternion."""
    length = math.sqrt(algebra.dot(axis, axis))
    along = np.sin(angle / 2)[..., None] * (axis / length if length else axis)
    return np.concatenate([np.cos(angle / 2)[..., None], along], -1)


def dyadic(times: Array) -> tuple[Array, Array]:
    """Doubles as M 2^e, exactly."""
    fraction, exponent = np.frexp(times)
    return (fraction * 2.0**53).astype(np.int64).astype(object), exponent.astype(np.int64) - 53
