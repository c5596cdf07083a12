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
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.errors import InputError, shown
from kreisel.physical.inertia import Principal
from kreisel.physical.measures import in_range, number
from kreisel.units import si

LEAST_POINTS = 2
NEAR, LEAST = 1e-8, 1e-150  # k' so near the separatrix that K = log(4/k'), and the least whose square is a double
SHORT = 0.5  # u - u0 below which psi is a quadrature of its rate: differences of elliptic integrals lose digits
NODES, WEIGHTS = np.polynomial.legendre.leggauss(8)


class Form(NamedTuple):
    """The relabelled motion; moments in tr(I)/3, L = 1."""

    turn: Array  # (3, 3), from the body axes to the relabelled axes
    moments: Array  # I1, I2, I3
    M: Array  # (3,) at time 0
    twice_energy: float
    amplitudes: Array  # a1, a2, a3
    side: float  # s
    lam: float
    kc: float  # k'
    nu: float
    steady: bool


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
        """M = I Omega at time 0, (3,), kg m^2/s, along the body axes."""
        return np.asarray(in_range("The momentum", lambda: self.inertia @ self.spin))

    @cached_property
    def energy(self) -> float:
        """The kinetic energy, J."""
        return float(in_range("The energy", lambda: self.spin @ self.momentum / 2))

    @cached_property
    def _rate(self) -> float:
        """|M|/(tr(I)/3), rad/s: the inverse of the unit of time of `Form`."""
        return float(in_range("The rate", lambda: np.linalg.norm(self.momentum) / (np.trace(self.inertia) / 3)))

    @cached_property
    def _form(self) -> Form:
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
        return _complete(self._form.kc)

    @property
    def period(self) -> float:
        """4 K/lambda, s: the momentum's turn round `axis` in the body.

        Of a rotation about a stable axis: that of a small disturbance.  Inf on the separatrix, about the middle axis
        and where nothing brings the momentum back.
        """
        form = self._form
        return 4 * self._quarter / (form.lam * self._rate) if form.lam and form.kc else math.inf

    @property
    def nutation_period(self) -> float:
        """2 K/lambda, s: of the angle between `axis` and the momentum; also the time between two `flips`."""
        return self.period / 2

    @cached_property
    def precession(self) -> float:
        """The mean rate of `axis` about the momentum fixed in space, rad/s.

        With Pi = Pi(nu | k^2) it is L (1/I3 + (1/I1 - 1/I3) Pi/K), and L/I2 on the separatrix.
        """
        (i1, i2, i3), nu = self._form.moments, self._form.nu
        if self._form.kc == 0:
            return float(self._rate / i2)
        kc = max(self._form.kc, LEAST)
        if i3 < i1:
            return float(self._rate * (1 / i1 + (1 / i3 - 1 / i1) * _excess(nu, kc * kc, _complete(kc))))
        return float(self._rate * (1 / i3 + (1 / i1 - 1 / i3) * _ratio(nu, kc * kc, _complete(kc))))

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
        first, second = math.atan2(a1, a3), math.atan2(a2, a3 * form.kc)
        return min(first, second), max(first, second)

    def flips(self, duration: float) -> Array:
        """The times (k,) up to `duration`, s, at which M changes sides along the axis of the middle moment: sn u = 0.

        Raises `InputError`.
        """
        reach = number(duration, "s", "duration", positive=True)
        form, step = self._form, self.nutation_period
        if form.steady or math.isinf(step):
            through = -self._start[1] / (form.lam * self._rate) if form.lam and not form.steady else -1.0
            return np.array([through]) if 0 < through <= reach else np.empty(0)
        first = -self._start[1] / (form.lam * self._rate) % step
        count = in_range("The number of flips", lambda: math.floor((reach - first) / step) + 1)
        return first + step * np.arange(max(0, count))

    @cached_property
    def _start(self) -> tuple[float, float]:
        """(am u0, u0), for a motion that is not steady."""
        a, M = self._form.amplitudes, self._form.M
        phi = math.atan2(self._form.side * M[1] * a[0], M[0] * a[1])
        whole = round(phi / math.pi)
        part = float(_first(np.array(phi - whole * math.pi), self._form.kc))
        return phi, part + (2 * whole * self._quarter if whole else 0.0)

    def at(self, seconds: Any, attitude: Any = (1.0, 0.0, 0.0, 0.0)) -> tuple[Array, Array]:
        """The angular velocity (..., 3), rad/s, along the body axes, and the attitude (..., 4) at times (...), s.

        The attitude is a unit quaternion (w, x, y, z), body to space, at time 0 the one given.  Digits are lost in
        proportion to the number of periods.  Raises `InputError`.
        """
        times, g0 = _floats(si(seconds, "s", "seconds"), "seconds"), _floats(attitude, "attitude")
        if g0.shape != (4,) or not abs(g0 @ g0 - 1) < 1e-6:
            raise InputError(f"attitude: expected a unit quaternion (w, x, y, z), got {shown(attitude)}.")
        M, psi = self._motion(times)
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
        reach = number(duration, "s", "duration", positive=True)
        M, psi = self._motion(np.linspace(0.0, reach, _points(points)))
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
        i1, i2, i3 = form.moments
        if form.steady:
            turning = (form.twice_energy + form.M[2] / i3) / (1 + form.M[2])
            return np.broadcast_to(form.M, (*t.shape, 3)), turning * t
        start, u0 = self._start
        phi = _amplitude(u0 + form.lam * t, form.kc, self._quarter)
        c = math.sqrt(i2 * (i3 - i1) / (i1 * (i3 - i2)))
        third = _third(phi, form.nu, form.kc) - _third(np.array(start), form.nu, form.kc)
        angle = _stretched(phi, c) - _stretched(np.array(start), c)
        psi = t / i3 + (i3 - i1) / (i1 * i3 * form.lam) * third - form.side * angle
        return self._momentum(phi), np.where(abs(form.lam * t) < SHORT, self._short(t), psi)

    def _short(self, t: Array) -> Array:
        """The angle psi, of psi' = (2T + M_3/I3)/(1 + M_3), over a part of a period."""
        form = self._form
        nodes = np.clip(t, -SHORT / form.lam, SHORT / form.lam)[..., None] * (1 + NODES) / 2
        z = self._momentum(_amplitude(self._start[1] + form.lam * nodes, form.kc, self._quarter))[..., 2]
        rates = (form.twice_energy + z / form.moments[2]) / (1 + z)
        return np.asarray(t * (rates @ WEIGHTS) / 2)


def _relabelled(body: Principal, spin: Array, unit: float) -> Form:
    """The `Form` of a spin along the body axes: exact in the given moments and spin, so that k' has all its digits."""
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
    return Form(
        turn=turn @ body.axes.T,
        moments=moments[order].astype(float),
        M=np.array([math.copysign(_root(v * v / L2), v) for v in M]),
        twice_energy=float((M * M / moments[order]).sum() / L2),
        amplitudes=np.array(
            [_root(i1 * D / (i3 - i1) / L2), _root(i2 * D / (i3 - i2) / L2), _root(i3 * E / (i3 - i1) / L2)]
            if not slow
            else [1.0, 1.0, 1.0]
        ),
        side=1.0 if i3 > i1 else -1.0,
        lam=_root((i3 - i2) * E / (i1 * i2 * i3) / L2),
        kc=1.0 if slow else _root((i3 - i1) * excess / ((i3 - i2) * E)),
        nu=0.0 if i2 == i1 else float(-i3 * (i2 - i1) / (i1 * (i3 - i2))),
        steady=not (np.roll(M, 1) * M * (moments[order] - np.roll(moments[order], 1))).any(),
    )


def _root(x: Fraction) -> float:
    """The root of x >= 0, also where x leaves the range of doubles."""
    e = (x.numerator.bit_length() - x.denominator.bit_length()) // 2 if x else 0
    return math.ldexp(math.sqrt(x / Fraction(4) ** e), e)


def _complete(kc: float) -> float:
    """The complete integral K from k'; log(4/k') where the next term is below rounding."""
    from scipy.special import ellipkm1

    if kc == 0:
        return math.inf
    return math.log(4 / kc) if kc < NEAR else float(ellipkm1(kc * kc))


def _excess(nu: float, kc2: float, quarter: float) -> float:
    """1 - Pi(nu | k^2)/K for nu <= 0, without cancellation: -nu R_J(0, k'^2, 1, 1 - nu)/(3 K)."""
    from scipy.special import elliprj

    return float(-nu * elliprj(0.0, kc2, 1.0, 1 - nu) / (3 * quarter))


def _ratio(nu: float, kc2: float, quarter: float) -> float:
    """Pi(nu | k^2)/K for nu <= 0, as a sum of positive numbers by the parameter N = (k^2 - nu)/(1 - nu) > 0."""
    if nu == 0:
        return 1.0
    k2, N = 1 - kc2, (1 - kc2 - nu) / (1 - nu)
    from scipy.special import elliprj

    raised = 1 + N * float(elliprj(0.0, kc2, 1.0, kc2 / (1 - nu))) / (3 * quarter)
    return (-nu * kc2 / (1 - nu) * raised + k2) / (k2 - nu)


def _split(phi: Array) -> tuple[Array, Array]:
    """(n, phi - n pi), the latter in [-pi/2, pi/2]."""
    whole = np.round(phi / math.pi)
    return whole, phi - whole * math.pi


def _first(phi: Array, kc: float) -> Array:
    """F(phi | k) for |phi| <= pi/2."""
    from scipy.special import elliprf

    cos, sin = np.cos(phi), np.sin(phi)
    return np.asarray(sin * elliprf(cos * cos, cos * cos + (kc * sin) ** 2, 1.0))


def _third(phi: Array, nu: float, kc: float) -> Array:
    """Pi(nu; phi | k), continuous in phi."""
    from scipy.special import elliprf, elliprj

    whole, part = _split(phi)
    cos2, sin, kc2 = np.cos(part) ** 2, np.sin(part), kc * kc
    delta = cos2 + kc2 * sin * sin
    rest = sin * elliprf(cos2, delta, 1.0) + nu / 3 * sin**3 * elliprj(cos2, delta, 1.0, 1 - nu * sin * sin)
    if not whole.any():
        return np.asarray(rest)
    return np.asarray(rest + 2 * whole * (elliprf(0.0, kc2, 1.0) + nu / 3 * elliprj(0.0, kc2, 1.0, 1 - nu)))


def _stretched(phi: Array, c: float) -> Array:
    """The angle atan(c tan phi), continuous in phi."""
    whole, part = _split(phi)
    return np.asarray(np.arctan2(c * np.sin(part), np.cos(part)) + whole * math.pi)


def _amplitude(u: Array, kc: float, quarter: float) -> Array:
    """The amplitude am u from k', by descending Landen transformations: Abramowitz and Stegun, section 16.4."""
    if kc == 0:
        return np.asarray(np.arctan(np.sinh(np.clip(u, -700, 700))))
    whole = np.round(u / (4 * quarter))
    a, b, ratios = 1.0, kc, [1.0]
    while ratios[-1] > 1e-8:  # what the last one leaves out is of the order of its square
        a, b, c = (a + b) / 2, math.sqrt(a * b), (a - b) / 2
        ratios.append(c / a)
    phi = 2.0 ** (len(ratios) - 1) * a * (u - 4 * quarter * whole)
    for ratio in ratios[:0:-1]:
        phi = (phi + np.arcsin(np.clip(ratio * np.sin(phi), -1, 1))) / 2
    return np.asarray(phi + 2 * math.pi * whole)


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


def _floats(value: Any, name: str) -> Array:
    """Finite floats of any shape.  Raises `InputError`."""
    try:
        array = np.asarray(value)
        array = array.astype(np.float64) if array.dtype.kind in "iufO" else np.array(np.nan)
    except (TypeError, ValueError, OverflowError):
        array = np.array(np.nan)
    if not np.isfinite(array).all():
        raise InputError(f"{name}: expected finite numbers, got {shown(value)}.")
    return array
