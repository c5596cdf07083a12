"""One motion of the Lagrange top, n = 3, at any times: set up once in extended digits, then cheap in doubles.

Three phases grow like the time: nutation, and the mean rotations about p and about the axis.  The period of nutation
is cut into 2^k parts.  The state at the middle of each, freed of the mean rotations, comes from the closed
form in extended digits, once, and from the equations of motion the polynomials that it follows within the part.
The phases are integers, mod one rotation: no error grows with t.

Beside the critical sleeping top the period of nutation is long, and within it the top rotates many times about p and
about its axis at rates

    phi' = (c - J z)/(1 - z^2),   psi' = (J - c z)/(1 - z^2)

(|p| = |b| = 1, z = b.p).  Freed of all these rotations, not only of their fractions, the state changes as slowly as z.
Series of slow variables in fast equations lose digits: as many more are computed.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import astuple, dataclass
from fractions import Fraction
from functools import partial
from operator import mul
from typing import Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.errors import InputError
from kreisel.exact.nutation import Integrals, MpNumber, Nutation, darboux, mp_number, rationals, squared_length
from kreisel.exact.parts import (
    BINARY,
    LEAST_PLACES,
    ORDERS,
    PHASE_BITS,
    SETTLED,
    TAIL,
    convolved,
    cos_sin,
    crossed,
    doubles,
    from_middle,
    left_out,
    orbit_in_parts,
    polynomials,
)
from kreisel.record.contract import Orbit

SAMPLES = 64  # of z in half a period, for the complete rotations of a slow top
PLACES = 4  # its first parts, as a power of two: where the series are made that say how many there must be
MARGIN = 1e-2  # between them the series may converge more slowly
DIGITS = 32  # of the set-up, beyond those that the number of periods and close roots use up
LARGEST = 1e150  # of an integral: products of two must not overflow
SHORT = 2.0**-60  # of half a period: shorter motions have a clock that ends with them, not one of 128 places
SMALL = 40  # binary places: smaller sizes and rates, relative to a part, have as many more
LEAPT = 8  # as a power of two
MOST_HALVINGS = 4  # of half a period, until D_eps makes the flow over it

MotionState = tuple[Array, Array, Array]
NONE, UNTURNED = Fraction(0), np.array([1.0, 0.0, 0.0, 0.0])


@dataclass(frozen=True)
class Leap:
    """`count` times D_eps with the constant r, then rotations about p and the axis, as quaternions."""

    count: int
    eps: MpNumber
    r: MpNumber
    turn: Array
    spin: Array


class TopMotion:
    """The motion through (m, b), axial vectors, under p.

    `reach` is the largest |time| that will be asked; the body rotates about its axis b by spin_factor (m.b)/|b|
    more than m states, without an effect on m and b.
    """

    def __init__(self, m: Array, b: Array, p: Array, *, reach: float, spin_factor: Fraction = NONE):
        import mpmath

        self.ctx = ctx = mpmath.MPContext()
        self.m, self.b, self.p = (rationals(v) for v in (m, b, p))
        self.integrals = integrals = Integrals.of(self.m, self.b, self.p)
        if max(abs(v) for v in astuple(integrals)) > LARGEST:
            raise InputError(
                f"The integrals |a|^2, |p|^2, <m, a>, <m, p> and energy must be at most {LARGEST:g} in size for the "
                "closed form, so that their products do not overflow, got larger ones. Use other units."
            )
        three = self.m, self.b, self.p  # along one line, the top is asleep, or hangs, and spins
        steady = integrals.A > 0 and not any(algebra.cross(v, self.b).any() for v in three)
        self.apart = integrals.separatrix or steady  # without a period: it tends to a steady motion, or is one
        self.steady = steady
        self.places, self.interval = LEAST_PLACES, ctx.one
        ctx.dps, self.binary = self._digits(reach), BINARY
        self.nutation = Nutation(ctx, integrals)
        self.begin()
        fastest = self._clock(reach, spin_factor)
        self.binary += self._small()
        if self.places > LEAPT and not self.endless and integrals.A and integrals.P2:
            self._take_fewer_parts(fastest)

    def begin(self) -> None:
        """The state at time 0 in the digits that there are, and no other yet."""
        ctx = self.ctx
        self._mp = tuple(np.array([mp_number(ctx, v) for v in w], dtype=object) for w in (self.m, self.b, self.p))
        m0, b0, _ = self._mp
        self._places: dict[int, MotionState] = {0: (m0, b0, np.array([ctx.one, ctx.zero, ctx.zero, ctx.zero]))}
        self._leaps: dict[int, Leap] = {}

    def refine(self, halvings: int) -> None:
        """Halve all parts so often; their data are kept."""
        self._places = {j << halvings: state for j, state in self._places.items()}
        self._leaps = {j << halvings: leap for j, leap in self._leaps.items()}
        self.places, self.interval = self.places + halvings, self.interval / (1 << halvings)

    def _digits(self, reach: float) -> int:
        """Digits for the set-up: number of periods, closeness of roots, e-foldings along a separatrix."""
        ctx, integrals = self.ctx, self.integrals
        scale = max(
            mp_number(ctx, abs(integrals.E)),
            ctx.sqrt(mp_number(ctx, integrals.A * integrals.P2)),
            ctx.sqrt(abs(mp_number(ctx, integrals.J * integrals.c))),
        )
        if scale == 0:
            return DIGITS
        periods = max(0, int(ctx.log10(1 + reach * ctx.sqrt(scale))) + 1)
        if self.steady:
            return DIGITS + periods
        if integrals.separatrix:
            away = self.e_foldings()
            return DIGITS + periods + (int(2 * (SETTLED + away) / math.log(10)) if math.isfinite(away) else 0)
        if integrals.discriminant == 0:
            return DIGITS + periods
        closeness = ctx.log10((4 * scale) ** 6 / mp_number(ctx, integrals.discriminant))
        return int(DIGITS + periods + max(0, closeness))

    def e_foldings(self) -> float:
        """How far a separatrix motion is from the steady one that it tends to, x = x3; infinite if it is that."""
        ctx, integrals = self.ctx, self.integrals
        if integrals.coincident is None:
            return 0.0
        x1, _, x3 = integrals.coincident
        gap = x3 - 2 * (algebra.dot(self.b, self.p) - integrals.E)
        return float(ctx.log(mp_number(ctx, 4 * (x3 - x1) / gap)) / 2) if gap else math.inf

    def _clock(self, reach: float, spin_factor: Fraction) -> float:
        """Parts of the period and mean rotations; on the separatrix, without a period, parts up to if it is steady.

        Returns a bound of the rates of the equations.
        """
        ctx, nutation, integrals = self.ctx, self.nutation, self.integrals
        turn = 2 * ctx.pi
        self.settled = 0
        self.endless = self.apart or 0 < reach < SHORT * nutation.half_period
        turns = [0, 0] if self.apart else [nutation.period_turn(dual) / turn for dual in (False, True)]
        self.means = [t and (t - ctx.nint(t)) / (2 * nutation.half_period) for t in turns]
        bp = ctx.sqrt(mp_number(ctx, integrals.A * integrals.P2))
        most = list[tuple[MpNumber, ...]]()  # of the sizes of m less the mean rotation, and of the mean rotations
        for seen, turning, spinning in zip((integrals, integrals.dual), self.means, self.means[::-1], strict=True):
            w = turn * turning  # |m - w p/|p||^2, m^2 <= -x1
            along = 2 * w * mp_number(ctx, seen.c) / ctx.sqrt(mp_number(ctx, seen.P2)) if seen.P2 else 0
            most.append((ctx.sqrt(max(w * w - along - nutation.x[0], 0)), abs(w), abs(turn * spinning)))
        rate = max(ctx.sqrt(bp), *(v for three in most for v in three)) or ctx.one
        scaled = [tuple(float(v / rate) for v in three) for three in most]
        bounds = np.max([_majorants(m, w, spin, float(bp / rate**2)) for m, w, spin in scaled], 0)
        unit = 1 / rate if self.apart else ctx.mpf(2 * reach) if self.endless else nutation.half_period
        halvings = 0
        while (h := float(unit * rate / 2**halvings)) > 1 or left_out(bounds, h) > TAIL:
            halvings += 1
        if self.apart:
            self.interval = 2 * unit / 2**halvings
            self.settled = self._settled()
            self.places = max(LEAST_PLACES, (2 * self.settled + 1).bit_length())
        else:
            self.places = max(LEAST_PLACES, halvings)
            self.interval = 2 * unit / 2**self.places
        spread = max(0, *(int(ctx.mag(ctx.mpf(reach) / unit)) for unit in (1, self.interval)) if reach else (0,))
        self.bits = 64 + PHASE_BITS + 53 + spread
        self.spin = mp_number(ctx, spin_factor * integrals.J) / ctx.sqrt(mp_number(ctx, integrals.A)) / turn
        self.sleeping = mp_number(ctx, integrals.J) / ctx.sqrt(mp_number(ctx, integrals.A)) / turn
        return float(rate)

    def _small(self) -> int:
        """Binary places of the series beyond `BINARY`, for a state that is almost at rest or almost steady."""
        m, b, p = self._mp
        half, A = self.interval / 2, mp_number(self.ctx, self.integrals.A)
        rates = (m, 0), (algebra.cross(p, b), 1), (algebra.cross(m, b) / (self.ctx.sqrt(A) or 1), 0)
        sizes = [self.ctx.sqrt(algebra.dot(v, v)) * half ** (1 + k) for v, k in rates]
        return max(0, -SMALL - min((int(self.ctx.mag(v)) for v in sizes if v), default=0))

    def _settled(self) -> int:
        """The number of parts after which a motion on the separatrix is steady: asleep with b parallel to p.

        For x3 = 2 (|b||p| - E) then: C <= 0 at b.p = |b||p|, so x2 <= 2 (|b||p| - E) <= x3 always.
        """
        away, (x1, _, x3) = math.inf if self.steady else self.e_foldings(), self.nutation.x
        if not math.isfinite(away):
            return 0
        return int(self.ctx.ceil((SETTLED + away) / (self.ctx.sqrt(x3 - x1) / 2 * self.interval)))

    # -- slow tops -----------------------------------------------------------------------------------

    def _whole_turns(self) -> tuple[int, int]:
        """The rotations about p and about the axis, in a period, beyond the fractions that the integrals tell."""
        ctx, integrals, nutation = self.ctx, self.integrals, self.nutation
        x1, x2, x3 = nutation.x
        A, p = (ctx.sqrt(mp_number(ctx, v)) for v in (integrals.A, integrals.P2))
        c, J, E = mp_number(ctx, integrals.c) / p, mp_number(ctx, integrals.J) / A, mp_number(ctx, integrals.E)
        plus, minus = ctx.zero, ctx.zero
        for k in range(SAMPLES):
            t = nutation.half_period * (k + ctx.mpf(1) / 2) / SAMPLES
            u = ctx.sqrt(x3 - x1) * t / 2
            x = x1 + (x2 - x1) * ctx.ellipfun("sn", u=u, m=(x2 - x1) / (x3 - x1)) ** 2
            z = (x / 2 + E) / (A * p)
            plus, minus = plus + (c + J) / (1 + z), minus + (c - J) / (1 - z)
        # of a rate, in rotations a period: (plus + minus)/2 is phi'
        unit = nutation.half_period / (SAMPLES * 2 * ctx.pi)
        return int(ctx.nint((plus + minus) * unit)), int(ctx.nint((plus - minus) * unit))

    def _take_fewer_parts(self, fastest: float) -> None:
        """Leave out all complete rotations, where that makes fewer parts do; `fastest`, a rate of the equations."""
        ctx, integrals = self.ctx, self.integrals
        before = ctx.dps, self.binary, self.nutation, self.means, self.places, self.interval
        lost = ORDERS * math.log10(max(10.0, fastest * float(self.nutation.half_period)))
        ctx.dps += int(lost)
        self.binary += int(lost * math.log2(10))
        self.nutation = Nutation(ctx, integrals)
        self.begin()
        period, turn = 2 * self.nutation.half_period, 2 * ctx.pi
        fractions = [self.nutation.period_turn(dual) / turn for dual in (False, True)]
        turns = self._whole_turns()
        means = [f + ctx.nint(n - f) for f, n in zip(fractions, (turns[0], -turns[1]), strict=True)]
        self.means = [v / period for v in means]
        self.places, self.interval = PLACES, period / (1 << PLACES)
        halvings = self._halvings()
        if halvings is not None and PLACES + halvings < before[4]:
            self.refine(halvings)
            return
        ctx.dps, self.binary, self.nutation, self.means, self.places, self.interval = before
        self.begin()

    def _halvings(self) -> int | None:
        """How often the parts must be halved."""
        worst = np.zeros(ORDERS)
        for j in range(1 << PLACES):
            for inside in (False, True):
                result, _ = self.series(j, inside)
                sizes = abs(doubles(result, self.binary))
                for first, last in ((0, 3), (3, 6), (6, 10)):
                    terms = sizes[:, first:last].sum(1)
                    worst = np.maximum(worst, terms / max(terms[0], np.finfo(float).tiny))
        for halvings in range(12):
            if left_out(worst, 0.5**halvings) < MARGIN * TAIL:
                return halvings
        return None

    # -- in extended digits --------------------------------------------------------------------------

    def place(self, j: int, inside: bool = False) -> Array:
        """The polynomials (TERMS, 10) of part j in the time from its middle, in halves of the part.

        Of m, b (axial) and the orientation from time 0, a unit quaternion, freed of the mean rotations; `inside`: of
        -M, P and the inverse orientation, which obey the same equations with (m, b, p) -> (-M, P, A).
        """
        series, units = self.series(j, inside)
        return polynomials(series, self.binary, self.ctx, units)

    def series(self, j: int, inside: bool) -> tuple[Array, Array]:
        """The power series of part j, (ORDERS, 10), integers of `binary` places, and the units of the ten."""
        ctx = self.ctx
        m, b, q = self._at(from_middle(j, self.places))
        p, axis = self._mp[2], self._mp[1]
        turning, spinning = (self._along(v) * (2 * ctx.pi * w) for w, v in zip(self.means, (p, axis), strict=True))
        if inside:
            back = algebra.rotation_matrix(q).T
            m, b, p, q = -(back @ m), back @ p, axis, algebra.inverse_turn(q)
            turning, spinning = spinning, turning
        half, size = self.interval / 2, ctx.sqrt(algebra.dot(b, b)) or ctx.one
        scaled = (m * half, b / size, q, p * (half * half * size), turning * half, spinning * half)  # arrays first
        fixed = [np.array([int(ctx.ldexp(v, self.binary)) for v in w], dtype=object) for w in scaled]
        units = np.array([1 / half] * 3 + [size] * 3 + [ctx.one] * 4, dtype=object)
        return _taylor(self.binary, *fixed), units

    def _at(self, j: int) -> MotionState:
        """The state at time j parts, freed of the mean rotations: by leaps of 2^k parts, of which few are needed.

        If few of many parts are asked for, by one leap.
        """
        if self.places > LEAPT:
            return self.jump(j * self.interval)
        if j not in self._places:
            low, sign = j & -j, 1 if j > 0 else -1
            if low not in self._leaps:
                self._leaps[low] = self._leap(low * self.interval)
            self._places[j] = self._leapt(self._at(j - sign * low), self._leaps[low], sign)
        return self._places[j]

    def jump(self, h: MpNumber) -> MotionState:
        """The flow over |h| <= omega_1 without its mean rotations: m, b (axial), orientation, in extended digits."""
        return self._leapt(self._places[0], self._leap(abs(h)), 1 if h > 0 else -1) if h else self._places[0]

    def _leapt(self, state: MotionState, leap: Leap, sign: int) -> MotionState:
        m, b, q = state
        hat_m = algebra.hat(m)
        for _ in range(leap.count):
            old = b
            hat_m, b, a = darboux(hat_m, b, self._mp[2], sign * leap.eps, leap.r)
            q = algebra.quaternion_product(leap.eps * half_turns(a, old), q)  # eps: the sign is continuous in h
        turn, spin = (v if sign > 0 else algebra.inverse_turn(v) for v in (leap.turn, leap.spin))
        q = algebra.quaternion_product(algebra.quaternion_product(turn, q), spin)
        R = algebra.rotation_matrix(turn)
        result = R @ algebra.axial(hat_m), R @ b, q / self.ctx.sqrt(algebra.dot(q, q))
        m, b, q = (np.array([self.ctx.re(v) for v in vector], dtype=object) for vector in result)
        return m, b, q

    def _leap(self, h: MpNumber) -> Leap:
        """Steps of the flow over h > 0: `count` times D_eps, then rotations about p and the axis."""
        ctx, nutation, integrals = self.ctx, self.nutation, self.integrals
        count = 2 if h > nutation.half_period / 2 else 1
        while ctx.isnan(eps := nutation.epsilon(h / count)):
            count += 1
        A = ctx.sqrt(mp_number(ctx, integrals.A))
        along, across = (2 * ctx.pi * mean * h for mean in self.means)
        left = -count * nutation.theta(eps) - along
        right = (
            count * (nutation.theta(eps, dual=True) + 2 * nutation.angle(eps, mp_number(ctx, integrals.J) / A)) + across
        )
        turn, spin = self._about(self._mp[2], left), self._about(self._mp[1], right)
        return Leap(count, eps, nutation.length(eps), turn, spin)

    def _along(self, axis: Array) -> Array:
        length = self.ctx.sqrt(algebra.dot(axis, axis))
        return axis / length if length else axis

    def _about(self, axis: Array, angle: MpNumber) -> Array:
        ctx = self.ctx
        return np.concatenate([[ctx.cos(angle / 2)], self._along(axis) * ctx.sin(angle / 2)])

    def _other_sign(self) -> int:
        """Whether the quaternion, freed of the mean rotations, has the other sign after a period."""
        if self.endless:
            return 0
        before, after = (self.jump(side * self.interval * (1 << (self.places - 1)))[2] for side in (-1, 1))
        return int(algebra.dot(before, after) < 0)

    def _place_of_two(self, j: int, inside: bool) -> Array:
        """`place` of part j of two periods, after the first of which the quaternion has the other sign."""
        out = self.place(j, inside)
        odd = (j + (1 << (self.places - 1))) >> self.places & 1
        out[:, 6:] *= 1 - 2 * odd
        return out

    # -- phases, in integers ---------------------------------------------------------------------------

    def orbit(
        self,
        finish: Callable[..., tuple[Array, ...]],
        constants: Mapping[str, Array],
        step: tuple[MpNumber, MpNumber] | None = None,
        inside: bool = False,
        start: Array = UNTURNED,
    ) -> Orbit:
        """The states that `finish(m, b, q, **constants)` makes of axial m, b and the orientation, `start` at time 0.

        `inside`: of -M, P and the inverse orientation.  The clock counts times; with `step` = (tau, theta), the steps
        of a map: the flow over tau, then a rotation about p.
        """
        tau, theta = (self.ctx.one, self.ctx.zero) if step is None else step
        turns = tau * self.means[0] + theta / (2 * self.ctx.pi), tau * (self.spin - self.means[1])
        units = (tau / self.interval, *(v / 2 for v in turns))  # of half the angles
        nutating, left, right = (int(self.ctx.floor(self.ctx.ldexp(v, self.bits))) for v in units)
        twice = self._other_sign()
        up, axis = (_unit_vector(v) for v in ((self.b, self.p) if inside else (self.p, self.b)))
        asleep = int(self.ctx.floor(self.ctx.ldexp(self.sleeping * self.interval / 2, self.bits)))

        def row(
            place: Array, left: Array, right: Array, *, up: Array, axis: Array, start: Array, **constants: Array
        ) -> tuple[Array, ...]:
            return finish(*turned(place, left, right, up=up, axis=axis, start=start), **constants)

        return orbit_in_parts(
            partial(self._place_of_two if twice else self.place, inside=inside),
            row,
            {"up": up, "axis": axis, "start": np.asarray(start, dtype=np.float64), **constants},
            moving=nutating,
            turns=(-right, -left) if inside else (left, right),
            places=self.places + twice,
            bits=self.bits,
            settled=self.settled if self.apart else None,
            asleep=(-asleep, 0) if inside else (0, asleep),
        )


def turned(
    place: Array, left: Array, right: Array, *, up: Array, axis: Array, start: Array
) -> tuple[Array, Array, Array]:
    """The m, b and q of a place, (..., 10), turned: about `up` from the left, and q about `axis` from the right.

    `left` and `right`, (..., 3), are half-angles: cos, sin and the remainder of the angle.  q follows on `start`.
    """
    (cos, sin), (c, s), H = cos_sin(left), cos_sin(right), algebra.hat(up)
    R = algebra.identity(3) + algebra.mat(2 * sin * cos) * H + algebra.mat(2 * sin * sin) * (H @ H)
    turn = algebra.quaternion(cos, algebra.vec(sin) * up)
    first = algebra.vec(c) * start + algebra.vec(s) * algebra.quaternion_product(
        algebra.quaternion(0 * axis[..., 0], axis), start
    )
    q = algebra.quaternion_product(turn, algebra.quaternion_product(place[..., 6:], first))
    return algebra.act(R, place[..., :3]), algebra.act(R, place[..., 3:6]), q


def half_turns(a: Array, b: Array) -> Array:
    """The rotation R_a R_b, R_x = 2 x x^T/|x|^2 - 1, as a quaternion of length |a| |b|."""
    return algebra.quaternion((a * b).sum(-1), algebra.cross(b, a - b))


def periods_of(m: Array, b: Array, p: Array) -> tuple[Array, Array]:
    """The periods 2 omega_1 of tops, from axial m, b, p (..., 3), and the signs that a period gives the quaternions.

    The flow over omega_1 is N times D_eps and rotations about p and b; that over -omega_1 has -eps; a period carries
    one to the other, by Rot_p(theta_P) and its dual.  By the duplication of R_F and R_J x0 is reached from x3, and the
    angles over omega_1 and N times omega_1/N differ by arctangents.  In doubles; the sign is 0 where no real eps leads
    so far.  [docs/exact.md]
    """
    from scipy.special import elliprf

    integrals: Any = Integrals.of(m, b, p)  # of arrays
    U, V = integrals.depressed
    size = np.sqrt(-U / 3)
    angle = np.arccos(np.clip(-V / (2 * size**3), -1, 1))
    roots = tuple(2 * size * np.cos((angle - 2 * np.pi * k) / 3) - 4 * integrals.E / 3 for k in (2, 1, 0))
    sign = _sign_of_period(1, roots, integrals, m, b, p)
    if (sign == 0).any():
        sign = np.where(sign == 0, _sign_of_period(MOST_HALVINGS, roots, integrals, m, b, p), sign)
    x1, x2, x3 = roots
    return 4 * elliprf(0, x3 - x1, x3 - x2), sign


def _sign_of_period(halvings: int, roots: tuple[Array, ...], integrals: Any, m: Array, b: Array, p: Array) -> Array:
    count, x3, (A, P2, J, c, E) = 2**halvings, roots[2], astuple(integrals)
    x0, sums = x3, []  # and for each duplication what is to be added to x0, and two sums over the roots of x0 - x_i
    for _ in range(halvings):
        f, g, h = (np.sqrt(np.maximum(x0 - x, 0)) for x in roots)
        sums.append((x0, f + g + h, f * g * h))
        x0 = x0 + f * g + g * h + h * f
    eps, s = 2 / np.sqrt(x0), 1 / x0
    x1, x2, x3 = roots
    r = squared_length(s, np.sqrt((1 - s * x1) * (1 - s * x2) * (1 - s * x3)), A, J, c, E)

    def half(P2: Array, c: Array, K: Array) -> Array:
        """Half of `count` times twice theta and of theta_P, with the other sign."""
        beyond = sum(
            2**k * np.arctan2(K / np.sqrt(P2), (x + c * c / P2) * added + product)
            for k, (x, added, product) in enumerate(sums)
        )
        return np.asarray(beyond - np.pi / 2 - count * np.arctan(eps * c / np.sqrt(4 * P2)))

    def turn(axis: Array, angle: Array) -> Array:
        return algebra.quaternion(np.cos(angle), algebra.vec(np.sin(angle)) * algebra.unit(axis))

    def mapped(eps: Array) -> Array:
        hat_m, old, q = algebra.hat(m), b, UNTURNED
        for _ in range(count):
            hat_m, new, a = darboux(hat_m, old, p, eps, r)
            q, old = algebra.quaternion_product(half_turns(a, old), q), new
        return algebra.unit(q)

    right = 2 * count * np.arctan(eps * J / np.sqrt(4 * A)) - half(A, -J, integrals.dual.K)
    before = algebra.quaternion_product(turn(p, half(P2, c, integrals.K)), mapped(eps))
    alike = algebra.dot(algebra.quaternion_product(before, turn(b, right)), mapped(-eps))
    return np.where(abs(alike) > 0.9, np.sign(alike), 0.0)


def _unit_vector(x: Array) -> Array:
    x = x * 2.0 ** -min(max(math.frexp(float(abs(x).max()))[1], -1000), 1000)  # exactly; the square may underflow
    length = math.sqrt(algebra.dot(x, x))
    return np.asarray(x / length if length else x, dtype=np.float64)


def _majorants(rates: float, turning: float, spinning: float, bp: float) -> Array:
    """Bounds of the Taylor coefficients of m, b and q, relative to the size of each: `_taylor` of lengths, (ORDERS,).

    From the greatest |m - turning|, |b||p| and the mean rotations.
    """
    ws, bs, qs = np.zeros((3, ORDERS))
    ws[0], bs[0], qs[0] = rates, 1.0, 1.0
    for k in range(ORDERS - 1):
        back = slice(k, None, -1)
        ws[k + 1] = (bp * bs[k] + turning * ws[k]) / (k + 1)
        bs[k + 1] = ws[: k + 1] @ bs[back] / (k + 1)
        qs[k + 1] = (ws[: k + 1] @ qs[back] + spinning * qs[k]) / (2 * (k + 1))
    return np.max([ws / (max(rates, math.sqrt(bp)) or 1.0), bs, qs], 0)  # a body at rest without gravity: 0


def _taylor(binary: int, m: Array, b: Array, q: Array, p: Array, turning: Array, spinning: Array) -> Array:
    """The m, b and q as power series, (ORDERS, 10), from integers of `binary` binary places.

    m' = p x b - turning x m,  b' = (m - turning) x b,  2 q' = (m - turning) q + q spinning.
    """
    w, b, q = ([[x] for x in v] for v in (m - turning, b, q))  # w = m - turning: of each coordinate its series
    for k in range(1, ORDERS):
        (now, b_now, (scalar, *u)), (q0, *qs) = ([x[-1] for x in v] for v in (w, b, q)), q
        forces = zip(crossed(p, b_now), crossed(turning, now), strict=True)
        rates = crossed(w, b, convolved)
        lean = -sum(map(convolved, w, qs)) - sum(map(mul, u, spinning))
        leans = zip(
            (convolved(x, q0) for x in w), crossed(w, qs, convolved), crossed(u, spinning), spinning, strict=True
        )
        turns = [lean, *(x + y + z + scalar * s for x, y, z, s in leans)]
        for series, new in zip((*w, *b, *q), [x - y for x, y in forces] + rates + turns, strict=True):
            series.append((new >> binary) // k)
        for series in q:
            series[-1] >>= 1
    out = np.array([*w, *b, *q], dtype=object).T
    out[0, :3] += turning
    return out
