"""A motion of the free rigid body in closed form, in SI units.

With the momentum L = 1, moments and axes relabelled so that the motion goes round the third axis with M_3 > 0, and
D = 2T I3 - 1, E = 1 - 2T I1:

    M = (a1 cn u, s a2 sn u, a3 dn u),   u = u0 + lambda t,   s = sign(I3 - I1),   lambda^2 = (I3 - I2) E/(I1 I2 I3),
    a1^2 = I1 D/(I3 - I1),   a2^2 = I2 D/(I3 - I2),   a3^2 = I3 E/(I3 - I1),
    k'^2 = (I3 - I1)(1 - 2T I2)/((I3 - I2) E),   nu = -I3 (I2 - I1)/(I1 (I3 - I2)),   c^2 = 1 - nu.

The body's attitude is g = g0 p(M0)^-1 z(psi) p(M), where p(M) is the shortest turn of M onto the third axis and z(psi)
the turn about it by

    psi = t/I3 + (I3 - I1)/(I1 I3 lambda) [Pi(nu; am u | k^2)] - s [atan(c tan am u)],   [f] = f(u) - f(u0).

[Jacobi 1849; Landau, Lifshitz, Mechanics, section 37; Carlson, Numerical Algorithms 10 (1995)]
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, NamedTuple

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.algebra.computed import cached_property
from kreisel.errors import InputError, explained, shown
from kreisel.physical.elliptic import (
    LEAST,
    amplitude,
    complete,
    first,
    stretched,
    third,
    third_below_first,
    third_over_first,
)
from kreisel.physical.inertia import Principal
from kreisel.physical.measures import finite_floats, in_range, si_number

MOST_FLIPS = 10**7
LEAST_POINTS = 2
SHORT = 0.5  # u - u0 below which psi is a quadrature of its rate: differences of elliptic integrals lose digits
NODES, WEIGHTS = np.polynomial.legendre.leggauss(8)


class Relabelled(NamedTuple):
    """The relabelled motion; moments in tr(I)/3, L = 1."""

    turn: Array  # (3, 3), from the body axes to the relabelled axes
    moments: Array  # I1, I2, I3
    M: Array  # (3,) at time 0
    gap: float  # 1/I1 - 1/I3
    twice_energy: float
    amplitudes: Array  # a1, a2, a3
    side: float  # s
    lam: float
    kc: float  # k'
    nu: float
    steady: bool


@explained
@dataclass(frozen=True, eq=False)
class FreeRotation:
    """The motion of a free body that begins with the angular velocity `spin`; `FreeBody.rotation` makes it.

    inertia (3, 3), kg m^2;  principal, its moments and axes;  spin (3,), rad/s, along the body axes
    """

    inertia: Array
    principal: Principal
    spin: Array

    @cached_property
    def momentum(self) -> Array:
        """The vector M = I Omega at time 0, (3,), kg m^2/s, along the body axes."""
        return np.asarray(in_range("The momentum", lambda: self.inertia @ self.spin))

    @cached_property
    def energy(self) -> float:
        """The kinetic energy, J."""
        return float(in_range("The energy", lambda: self.spin @ self.momentum / 2))

    @cached_property
    def _rate(self) -> float:
        """|M|/(tr(I)/3), rad/s: the inverse of the unit of time of `Relabelled`."""
        scale = float(abs(self.momentum).max())
        length = in_range("|M|", lambda: scale * np.linalg.norm(self.momentum / scale))
        return si_number(
            in_range("3 |M|/tr(I)", lambda: length / (np.trace(self.inertia) / 3)), "rad/s", "rate", positive=True
        )

    @property
    def _pace(self) -> float:
        """The rate of u, rad/s."""
        return self._form.lam * self._rate

    @cached_property
    def _form(self) -> Relabelled:
        return _relabelled(self.principal, self.spin, float(np.trace(self.inertia)) / 3)

    @property
    def kind(self) -> str:
        """Where the motion lies.

        "steady": about an axis that stands still in body and space;  "short-axis mode": M goes round the axis of the
        largest moment in the body;  "long-axis mode": round that of the smallest;  "separatrix": between the two.
        """
        form = self._form
        if form.steady:
            return "steady"
        if form.kc == 0:
            return "separatrix"
        return "short-axis mode" if form.side > 0 else "long-axis mode"

    @property
    def axis(self) -> Array:
        """The principal axis (3,) in the body that M goes round, on the side of M."""
        return self._form.turn[2].copy()

    @property
    def modulus(self) -> float:
        """The square k^2 of the modulus of the elliptic functions, in [0, 1]."""
        return 1 - self._form.kc**2

    @cached_property
    def _quarter(self) -> float:
        """K(k), from k'."""
        return complete(self._form.kc)

    @property
    def period(self) -> float:
        """4 K/lambda, s: the momentum's turn round `axis` in the body.

        Of a rotation about a stable axis: that of a small disturbance.  Inf on the separatrix, about the middle axis
        and where nothing brings the momentum back.
        """
        return 4 * self._quarter / self._pace if self._pace and self._form.kc else math.inf

    @property
    def nutation_period(self) -> float:
        """2 K/lambda, s: of the angle between `axis` and the momentum; also the time between two `flips`."""
        return self.period / 2

    @cached_property
    def precession(self) -> float:
        """The mean rate of `axis` about the momentum fixed in space, rad/s.

        With Pi = Pi(nu | k^2) it is L (1/I3 + (1/I1 - 1/I3) Pi/K), and L/I2 on the separatrix.
        """
        form, (i1, i2, i3) = self._form, self._form.moments
        if form.kc == 0:
            return float(self._rate / i2)
        k = max(form.kc, LEAST)
        if form.gap < 0:
            return float(self._rate * (1 / i1 - form.gap * third_below_first(form.nu, k)))
        return float(self._rate * (1 / i3 + form.gap * third_over_first(form.nu, k)))

    @property
    def precession_period(self) -> float:
        """The time in which `axis` goes round the momentum, on average, s."""
        return 2 * math.pi / self.precession

    @property
    def tilts(self) -> tuple[float, float]:
        """The least and the largest angle between `axis` and the momentum, rad."""
        form = self._form
        if form.steady:
            angle = math.atan2(math.hypot(form.M[0], form.M[1]), form.M[2])
            return angle, angle
        a1, a2, a3 = form.amplitudes
        ends = math.atan2(a1, a3), math.atan2(a2, a3 * form.kc)
        return min(ends), max(ends)

    def flips(self, duration: float) -> Array:
        """The times (k,) from 0 to `duration`, s, at which M changes sides along the axis of the middle moment.

        They are the zeros of sn u.  Raises `InputError`.
        """
        reach = si_number(duration, "s", "duration", positive=True)
        step = self.nutation_period
        if self._form.steady or not self._pace:
            return np.empty(0)
        begin = -self._start[1] / self._pace
        if math.isinf(step):
            return np.array([begin]) if 0 < begin <= reach else np.empty(0)
        begin %= step
        count = in_range("The number of flips", lambda: math.floor((reach - begin) / step) + 1)
        if count > MOST_FLIPS:
            raise InputError(
                f"duration: expected at most {MOST_FLIPS:,} flips, got {shown(duration)}, {count:,} flips."
            )
        return begin + step * np.arange(max(0, count))

    @cached_property
    def _start(self) -> tuple[float, float]:
        """(am u0, u0), for a motion that is not steady."""
        a, M = self._form.amplitudes, self._form.M
        phi = math.atan2(self._form.side * M[1] * a[0], M[0] * a[1])
        whole = round(phi / math.pi)
        part = float(first(np.array(phi - whole * math.pi), self._form.kc))
        return phi, part + (2 * whole * self._quarter if whole else 0.0)

    def at(self, seconds: Any, attitude: Any = (1.0, 0.0, 0.0, 0.0)) -> tuple[Array, Array]:
        """The angular velocity (..., 3), rad/s, along the body axes, and the attitude (..., 4) at times (...), s.

        The attitude is a unit quaternion (w, x, y, z), body to space, at time 0 the one given.  Digits are lost in
        proportion to the number of periods.  Raises `InputError`.
        """
        times, g0 = finite_floats(seconds, "s", "seconds"), finite_floats(attitude, "1", "attitude")
        if g0.shape != (4,) or not abs(g0 @ g0 - 1) < 1e-6:
            raise InputError(f"attitude: expected a unit quaternion (w, x, y, z), got {shown(attitude)}.")
        M, psi = in_range("The motion at these times", lambda: self._motion(times))
        turn = algebra.unit_quaternion(self._form.turn)
        onto = algebra.quaternion_product(_about_third(psi), _onto_third(M))
        back = algebra.quaternion_product(algebra.inverse_turn(turn), algebra.inverse_turn(_onto_third(self._form.M)))
        g = algebra.quaternion_product(algebra.quaternion_product(algebra.unit(g0), back), onto)
        return self._velocity(M), algebra.unit(algebra.quaternion_product(g, turn))

    def polhode(self, points: int = 400) -> Array:
        """The angular velocity's path in the body, (points, 3), rad/s: closed, but on the separatrix half of it."""
        form = self._form
        if form.steady:
            return np.tile(self.spin, (_points(points), 1))
        reach = math.pi if form.kc else math.pi / 2
        phi = self._start[0] * (form.kc > 0) + np.linspace(-reach, reach, _points(points))
        return self._velocity(self._momentum(phi))

    def herpolhode(self, duration: float, points: int = 2000) -> Array:
        """The angular velocity's path in space over a duration, s: (points, 3), rad/s, the third axis along M.

        Its third component is constant, 2T/|M|: the path lies in the invariable plane.  Raises `InputError`.
        """
        reach = si_number(duration, "s", "duration", positive=True)
        times = np.linspace(0.0, reach, _points(points))
        M, psi = in_range("The motion at these times", lambda: self._motion(times))
        turn = algebra.rotation_matrix(algebra.quaternion_product(_about_third(psi), _onto_third(M)))
        return algebra.act(turn, self._rate * M / self._form.moments)

    def _velocity(self, M: Array) -> Array:
        """Omega along the body axes."""
        return np.asarray(self._rate * M / self._form.moments @ self._form.turn)

    def _momentum(self, phi: Array) -> Array:
        """M (..., 3) of length 1 at the amplitudes am u = phi."""
        cn, sn = np.cos(phi), np.sin(phi)
        sides = np.stack([cn, self._form.side * sn, np.hypot(cn, self._form.kc * sn)], -1)
        return np.asarray(self._form.amplitudes * sides)

    def _motion(self, seconds: Array) -> tuple[Array, Array]:
        """M (..., 3) of length 1 and psi (...)."""
        form, t = self._form, seconds * self._rate
        if form.steady:
            turning = (form.twice_energy + form.M[2] / form.moments[2]) / (1 + form.M[2])
            return np.broadcast_to(form.M, (*t.shape, 3)), turning * t
        start, u0 = self._start
        phi = amplitude(u0 + form.lam * t, form.kc, self._quarter)
        c = math.sqrt(1 - form.nu)
        whole = third(phi, form.nu, form.kc) - third(np.array(start), form.nu, form.kc)
        angle = stretched(phi, c) - stretched(np.array(start), c)
        with np.errstate(all="ignore"):  # of a lambda so small that only the quadrature counts
            psi = t / form.moments[2] + form.gap / form.lam * whole - form.side * angle
        return self._momentum(phi), np.where(abs(form.lam * t) < SHORT, self._short(t), psi)

    def _short(self, t: Array) -> Array:
        """The angle psi, of psi' = (2T + M_3/I3)/(1 + M_3), over a part of a period."""
        form = self._form
        nodes = np.clip(t, -SHORT / form.lam, SHORT / form.lam)[..., None] * (1 + NODES) / 2
        z = self._momentum(amplitude(self._start[1] + form.lam * nodes, form.kc, self._quarter))[..., 2]
        rates = (form.twice_energy + z / form.moments[2]) / (1 + z)
        return np.asarray(t * (rates @ WEIGHTS) / 2)


def _relabelled(body: Principal, spin: Array, unit: float) -> Relabelled:
    """The relabelled motion of a spin along the body axes.  Exact in moments and spin: k' then has all its digits."""
    moments = np.array([Fraction(float(v)) / Fraction(unit) for v in body.moments])
    M = moments * [Fraction(float(v)) for v in body.axes.T @ np.ldexp(spin, -math.frexp(abs(spin).max())[1])]
    order = np.argsort(moments, kind="stable")
    excess = (M * M * (1 - moments[order[1]] / moments)).sum()  # L^2 - 2T I2
    if excess < 0 or (excess == 0 and moments[order[1]] == moments[order[2]]):
        order = order[::-1]
    turn = np.eye(3)[order]
    turn[1] *= round(np.linalg.det(turn))
    if M[order[2]] < 0:
        turn[1:] *= -1
    (i1, i2, i3), M = moments[order], M[order] * turn.sum(1).astype(int)
    x, y, z = M * M
    D, E = x * (i3 - i1) / i1 + y * (i3 - i2) / i2, y * (i2 - i1) / i2 + z * (i3 - i1) / i3
    L2, slow = x + y + z, E * (i3 - i2) == 0
    return Relabelled(
        turn=turn @ body.axes.T,
        moments=moments[order].astype(float),
        M=np.array([math.copysign(_fraction_sqrt(v * v / L2), v) for v in M]),
        gap=float(1 / i1 - 1 / i3),
        twice_energy=float((M * M / moments[order]).sum() / L2),
        amplitudes=np.array(
            [
                _fraction_sqrt(i1 * D / (i3 - i1) / L2),
                _fraction_sqrt(i2 * D / (i3 - i2) / L2),
                _fraction_sqrt(i3 * E / (i3 - i1) / L2),
            ]
            if not slow
            else [1.0, 1.0, 1.0]
        ),
        side=1.0 if i3 > i1 else -1.0,
        lam=_fraction_sqrt((i3 - i2) * E / (i1 * i2 * i3) / L2),
        kc=1.0 if slow else _fraction_sqrt((i3 - i1) * excess / ((i3 - i2) * E)),
        nu=0.0 if i2 == i1 else float(-i3 * (i2 - i1) / (i1 * (i3 - i2))),
        steady=not (np.roll(M, 1) * M * (moments[order] - np.roll(moments[order], 1))).any(),
    )


def _fraction_sqrt(x: Fraction) -> float:
    """The root of x >= 0, also where x leaves the range of doubles."""
    e = (x.numerator.bit_length() - x.denominator.bit_length()) // 2 if x else 0
    return math.ldexp(math.sqrt(x / Fraction(4) ** e), e)


def _onto_third(M: Array) -> Array:
    """The quaternion of the shortest turn of M (..., 3), |M| = 1 and M_3 >= 0, onto the third axis."""
    q = np.stack([1 + M[..., 2], M[..., 1], -M[..., 0], 0 * M[..., 0]], -1)
    return np.asarray(algebra.unit(q))


def _about_third(psi: Array) -> Array:
    return np.stack([np.cos(psi / 2), 0 * psi, 0 * psi, np.sin(psi / 2)], -1)


def _points(points: int) -> int:
    if isinstance(points, bool) or not isinstance(points, int | np.integer) or not LEAST_POINTS <= points <= 10**7:
        raise InputError(f"points: expected a whole number from {LEAST_POINTS} to 10,000,000, got {shown(points)}.")
    return int(points)
