"""One motion of the Lagrange top, n = 3, at any times: set up once in extended digits, then cheap in doubles.

Three phases grow like the time: that of nutation, and those of the mean turns about p and about the axis.  The period
of nutation is cut into 2^k parts, and the state at the middle of each, freed of the mean turns, comes from the closed
form in extended digits, once; from there D_eps takes the rest h in doubles, with eps(h) and theta(h) from their
power series.  The phases are integers, mod one turn: no error grows with t.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import astuple
from fractions import Fraction

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.errors import InputError
from kreisel.methods.nutation import Integrals, Number, Nutation, darboux, number, rationals, squared_length
from kreisel.methods.scheme import Orbit

TERMS = 16  # of the power series in h^2, a multiple of four; with 28 a row took a tenth longer, the set-up half
TAIL = 1e-19  # what they leave out, by the size of their last terms
DIGITS = 32  # of the set-up, beyond those that the number of periods and close roots use up
SETTLED = 50  # e-foldings after which a separatrix motion is taken for the steady one that it tends to
LARGEST = 1e150  # of an integral: products of two must not overflow
PHASE_BITS = 64
LEAST_PLACES = 3  # so that the mean turns within a part stay small

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
    """The motion through (m, b), axial vectors, under p.

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
        rising = [(2 * k + 1) * e for k, e in enumerate(eps)]  # d eps/dh
        series = [eps, _theta_series(nutation, known, Y, eps), _theta_series(nutation, known.dual, Y, eps)]
        tail = [(k, f[k]) for f in series for k in range(TERMS - 4, TERMS) if f[k] != 0]
        rate = ctx.sqrt(algebra.dot(self._mp[0], self._mp[0])) + ctx.sqrt(ctx.sqrt(number(ctx, known.A * known.P2)))
        most = [1 / rate] if rate else [ctx.one]
        self.longest = min(most + [(TAIL / abs(v)) ** (ctx.one / (2 * k)) for k, v in tail])
        self.series = [
            np.array([float(v * self.longest ** (2 * k)) for k, v in enumerate(f)]) for f in (*series, rising)
        ]

    def _clock(self, reach: float, spin_factor: Fraction) -> None:
        """Parts of the period and mean turns; on the separatrix, without a period, parts up to where it is steady."""
        ctx, nutation, known = self.ctx, self.nutation, self.integrals
        turn = 2 * ctx.pi
        self.settled = 0
        if known.separatrix:
            self.part = 2 * self.longest
            self.settled = self._settled()
            self.places = max(LEAST_PLACES, (2 * self.settled + 1).bit_length())
            self.means = [ctx.zero, ctx.zero]
        else:
            self.places = max(LEAST_PLACES, int(ctx.ceil(ctx.log(nutation.half_period / self.longest, 2))))
            self.part = ctx.ldexp(nutation.half_period, 1 - self.places)
            turns = [nutation.period_turn(dual) / turn for dual in (False, True)]
            self.means = [(t - ctx.nint(t)) / (2 * nutation.half_period) for t in turns]
        for series, mean, sign in zip(self.series[1:3], self.means, (-1, 1), strict=True):
            series[0] += float(mean * turn)  # h turns on too
            series *= sign / 2  # half-angles
        spread = max(0, *(int(ctx.mag(ctx.mpf(reach) / unit)) for unit in (1, self.part)) if reach else (0,))
        self.bits = 64 + PHASE_BITS + 53 + spread
        self.spin = number(ctx, spin_factor * known.J) / ctx.sqrt(number(ctx, known.A)) / turn
        self.sleeping = number(ctx, known.J) / ctx.sqrt(number(ctx, known.A)) / turn

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

    def place(self, j: int) -> Array:
        """m, b (axial) and the orientation from time 0, a unit quaternion, at time j parts, as 10 doubles.

        They are freed of the mean turns.
        """
        j = (j + (1 << (self.places - 1))) % (1 << self.places) - (1 << (self.places - 1))
        m, b, q = self.jump(j * self.part)
        return np.array([float(v) for v in (*m, *b, *q)])

    def jump(self, h: Number) -> tuple[Array, Array, Array]:
        """The flow over |h| <= omega_1 without its mean turns: m, b (axial), orientation, in extended digits."""
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
        along, across = (2 * ctx.pi * mean * h for mean in self.means)
        left = -count * nutation.theta(eps) - along
        right = count * (nutation.theta(eps, dual=True) + 2 * ctx.atan(eps * number(ctx, known.J) / (2 * A))) + across
        turn = self._about(p, left)
        q = algebra.quaternion_product(algebra.quaternion_product(turn, q), self._about(axis, right))
        R = algebra.rotation_matrix(turn)
        return R @ algebra.axial(hat_m), R @ b, q / ctx.sqrt(algebra.dot(q, q))

    def _about(self, axis: Array, angle: Number) -> Array:
        ctx = self.ctx
        length = ctx.sqrt(algebra.dot(axis, axis))
        along = axis / length if length else axis
        return np.concatenate([[ctx.cos(angle / 2)], ctx.sin(angle / 2) * along])

    # -- phases, in integers ---------------------------------------------------------------------------

    def orbit(
        self,
        finish: Callable[..., tuple[Array, ...]],
        constants: Mapping[str, Array],
        step: tuple[Number, Number] | None = None,
    ) -> Orbit:
        """The states that `finish(m, b, q, **constants)` makes of axial m, b and the orientation from time 0.

        The clock counts times; with `step` = (tau, theta), the steps of a map: the flow over tau, then a turn about p.
        """
        tau, theta = (self.ctx.one, self.ctx.zero) if step is None else step
        units = (tau / self.part, tau * self.means[0] + theta / (2 * self.ctx.pi), tau * (self.spin - self.means[1]))
        nutating, left, right = (int(self.ctx.floor(self.ctx.ldexp(v, self.bits))) for v in units)
        rates = (nutating >> self.places, left, right)
        own = {
            "series": np.stack(self.series),
            "scale": np.asarray(float(1 / self.longest)),
            **{f"known_{k}": np.asarray(float(getattr(self.integrals, k))) for k in ("A", "J", "c", "E")},
            "p": self.p.astype(np.float64),
            "up": _unit(self.p),
            "axis": _unit(self.b),
            "lean": np.asarray(float(self.sleeping * self.ctx.pi)),
        }
        names = frozenset(own)

        def row(place: Array, h: Array, left: Array, right: Array, **known: Array) -> tuple[Array, ...]:
            mine = {k: known[k] for k in names}
            return finish(*ahead(place, h, left, right, **mine), **{k: v for k, v in known.items() if k not in names})

        def phases(M: Array, e: Array) -> Array:
            low = int(e.min(initial=0))
            scaled = M << (e - low).astype(object)
            return _fractions([scaled * rate for rate in rates], self.bits - low)

        def phases_to_rest(M: Array, e: Array) -> Array:
            low = int(e.min(initial=0))
            scaled = M << (e - low).astype(object)
            bits = self.bits - low
            most, at = self.settled << bits, scaled * nutating
            kept = np.minimum(np.maximum(at, -most), most)
            asleep = int(self.ctx.floor(self.ctx.ldexp(self.sleeping * self.part, self.bits)))
            beyond = ((at - kept) * asleep) >> self.bits
            return _fractions([kept >> self.places, scaled * left, scaled * right + beyond], bits)

        return Orbit(
            phases=phases_to_rest if self.integrals.separatrix else phases,
            rates=None if self.integrals.separatrix else rates,
            bits=self.bits,
            places=self.places,
            part=float(self.part),
            place=self.place,
            row=row,
            constants={**own, **constants},
        )


def ahead(
    place: Array,
    h: Array,
    left: Array,
    right: Array,
    *,
    series: Array,
    scale: Array,
    known_A: Array,
    known_J: Array,
    known_c: Array,
    known_E: Array,
    p: Array,
    up: Array,
    axis: Array,
    lean: Array,
) -> tuple[Array, Array, Array]:
    """D_eps(h) from a place, (..., 10), and its turns: axial m and b, and the orientation.

    `left` and `right`, (..., 3), are half-angles of mean turns: cos, sin and what is left of the angle.
    """
    y = h * scale * (h * scale)
    eps, turned, spun = (h * _polynomial(series[k], y) for k in range(3))
    s, root = eps * eps / 4, _polynomial(series[3], y)  # (1 - s x1)(1 - s x2)(1 - s x3) = (d eps/dh)^2
    m, b = algebra.hat(place[..., :3]), place[..., 3:6]
    r = squared_length(s, root, known_A, known_J, known_c, known_E)
    m1, b1, a = darboux(m, b, p, eps, r)
    turn = _turned(up, left, turned)
    R = algebra.rotation_matrix(turn)
    t = eps * lean  # tan of half the turn that D_eps makes about the axis
    q = algebra.quaternion_product(turn, algebra.quaternion_product(half_turns(a, b), place[..., 6:]))
    spin = np.concatenate([1 + 0 * algebra.vec(t) + 0 * axis[..., :1], algebra.vec(t) * axis], -1)
    for about_axis in (_turned(axis, right, spun), spin):
        q = algebra.quaternion_product(q, about_axis)
    return algebra.act(R, algebra.axial(m1)), algebra.act(R, b1), q / algebra.sqrt(algebra.vec(algebra.dot(q, q)))


def _polynomial(f: Array, y: Array) -> Array:
    """The sum of f[k] y^k by four sums in y^4, which a processor takes at once."""
    y2 = y * y
    y4 = y2 * y2
    a, b, c, d = f[-4:]
    for k in range(len(f) - 8, -1, -4):
        a, b, c, d = a * y4 + f[k], b * y4 + f[k + 1], c * y4 + f[k + 2], d * y4 + f[k + 3]
    return (a + b * y) + (c + d * y) * y2


def _turned(axis: Array, half: Array, more: Array) -> Array:
    """The turn about a unit vector as a quaternion, from its half-angle in parts."""
    c, s = algebra.cos_sin_small(half[..., 2] + more)
    cos, sin = half[..., 0] * c - half[..., 1] * s, half[..., 1] * c + half[..., 0] * s
    return np.concatenate([algebra.vec(cos) + 0 * axis[..., :1], algebra.vec(sin) * axis], -1)


def half_turns(a: Array, b: Array) -> Array:
    """The turn R_a R_b, R_x = 2 x x^T/|x|^2 - 1, as a quaternion of length |a| |b|."""
    return np.concatenate([(a * b).sum(-1, keepdims=True), algebra.cross(b, a - b)], -1)


def _fractions(scaled: list[Array], bits: int) -> Array:
    """Integers of `bits` binary places, mod 1, as 64-bit fractions (times, count)."""
    return np.stack([((v >> (bits - 64)) & (2**64 - 1)).astype(np.uint64) for v in scaled], -1)


def _unit(x: Array) -> Array:
    length = math.sqrt(algebra.dot(x, x))
    return np.asarray(x / length if length else x, dtype=np.float64)


def rotation(axis: Array, angle: Array) -> Array:
    """The turn about an axis, of any length, as a unit quaternion."""
    return np.concatenate([np.cos(angle / 2)[..., None], np.sin(angle / 2)[..., None] * _unit(axis)], -1)
