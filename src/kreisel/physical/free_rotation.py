"""A motion of the free rigid body in closed form, in SI units: `kreisel.exact.rotor` has the formulas.

Periods and angles come from its constants in many digits, states from the compiled jumps of method="exact".
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.algebra.reuse import cached_property
from kreisel.errors import InputError, explained, shown
from kreisel.exact.nutation import rationals
from kreisel.exact.rotor import Rotor
from kreisel.method.scheme import Orbits, Scheme, Spin
from kreisel.physical.inertia import Principal
from kreisel.physical.measures import finite_floats, in_range, si_number
from kreisel.record.contract import Orbit

MOST_FLIPS = 10**7
LEAST_POINTS = 2
UPRIGHT = (1.0, 0.0, 0.0, 0.0)


@lru_cache(64)  # not kept in the body: floats of mpmath cannot be pickled
def _rotor_of(moments: tuple[float, ...], spin: tuple[float, ...]) -> Rotor:
    """The closed form of a body with these principal moments and this angular velocity along the principal axes."""
    exact = rationals(np.array(moments))
    return Rotor(exact * rationals(np.array(spin)), exact, 0.0, np.array(UPRIGHT))


@explained
@dataclass(frozen=True, eq=False)
class FreeRotation:
    """The motion of a free body that begins with the angular velocity `spin`; `FreeBody.rotation` returns it.

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

    @property
    def _rotor(self) -> Rotor:
        """The closed form, exact in moments and spin."""
        return _rotor_of(tuple(self.principal.moments.tolist()), tuple((self.spin @ self.principal.axes).tolist()))

    @property
    def kind(self) -> str:
        """The kind of the motion.

        "steady": about an axis at rest in body and space;  "short-axis mode": M goes round the axis of the
        largest moment in the body;  "long-axis mode": round the axis of the smallest;  "separatrix": between the two.
        """
        rotor = self._rotor
        if rotor.steady:
            return "steady"
        if rotor.separatrix:
            return "separatrix"
        return "short-axis mode" if rotor.s > 0 else "long-axis mode"

    @property
    def axis(self) -> Array:
        """The principal axis (3,) in the body that M goes round, on the side of M."""
        axes = self._rotor.axes
        return np.asarray(axes.side * self.principal.axes[:, axes.i[2]]) + 0.0

    @property
    def modulus(self) -> float:
        """The square k^2 of the modulus of the elliptic functions, in [0, 1]."""
        rotor = self._rotor
        return float(rotor.k2) if not rotor.steady else 0.0 if rotor.gap or not rotor.lam else 1.0

    @property
    def period(self) -> float:
        """4 K/lambda, s: one revolution of the momentum round `axis` in the body.

        For a rotation about a stable axis, the period of a small disturbance.  Inf on the separatrix, about the middle
        axis, and if the momentum does not return.
        """
        rotor = self._rotor
        return float(4 * rotor.quarter / rotor.lam) if rotor.lam else math.inf

    @property
    def nutation_period(self) -> float:
        """2 K/lambda, s: of the angle between `axis` and the momentum; also the time between two `flips`."""
        return self.period / 2

    @cached_property
    def precession(self) -> float:
        """The mean rate of `axis` about the momentum fixed in space, rad/s: of psi, and 2 pi in each `period`.

        On the separatrix L/I2.
        """
        rotor = self._rotor
        if not rotor.gap:
            return float(rotor.L * rotor.I[1].denominator / rotor.I[1].numerator)
        return float(rotor.mean + rotor.s * rotor.ctx.pi / 2 * rotor.lam / rotor.quarter)

    @property
    def precession_period(self) -> float:
        """The time in which `axis` goes round the momentum, on average, s."""
        return 2 * math.pi / self.precession

    @property
    def tilts(self) -> tuple[float, float]:
        """The least and the largest angle between `axis` and the momentum, rad."""
        rotor = self._rotor
        if rotor.steady:
            x, y, z = (float(v) for v in rotor.start_along)
            angle = math.atan2(math.hypot(x, y), z)
            return angle, angle
        a1, a2, a3 = self._amplitudes
        ends = math.atan2(abs(a1), a3), math.atan2(abs(a2), a3 * float(rotor.k_prime))
        return min(ends), max(ends)

    @property
    def _amplitudes(self) -> Array:
        """The a_i/L of a motion that is not steady."""
        return np.array([float(a / self._rotor.L) for a in self._rotor.a])

    def flips(self, duration: float) -> Array:
        """The times (k,) from 0 to `duration`, s, at which M changes sides along the axis of the middle moment.

        They are the zeros of sn u.  Raises `InputError`.
        """
        reach = si_number(duration, "s", "duration", positive=True)
        rotor, step = self._rotor, self.nutation_period
        if rotor.steady:
            return np.empty(0)
        begin = -rotor.u0 * rotor.axes.chi * rotor.s / rotor.lam
        if math.isinf(step):
            return np.array([float(begin)]) if 0 < begin <= reach else np.empty(0)
        begin = float(begin % (2 * rotor.quarter / rotor.lam))
        count = in_range("The number of flips", lambda: math.floor((reach - begin) / step) + 1)
        if count > MOST_FLIPS:
            raise InputError(
                f"duration: expected at most {MOST_FLIPS:,} flips, got {shown(duration)}, {count:,} flips."
            )
        return begin + step * np.arange(max(0, count))

    def at(self, seconds: Any, attitude: Any = UPRIGHT) -> tuple[Array, Array]:
        """The angular velocity (..., 3), rad/s, along the body axes, and the attitude (..., 4) at times (...), s.

        The attitude is a unit quaternion (w, x, y, z), body to space, at time 0 the given one.  Digits are not lost
        with time.  Raises `InputError`.
        """
        times, start = finite_floats(seconds, "s", "seconds"), finite_floats(attitude, "1", "attitude")
        if start.shape != (4,) or not abs(start @ start - 1) < 1e-6:
            raise InputError(f"attitude: expected a unit quaternion (w, x, y, z), got {shown(attitude)}.")
        frame = algebra.unit_quaternion(self.principal.axes)
        g = algebra.quaternion_product(algebra.unit(start), frame)
        velocity, g = in_range("The motion at these times", lambda: self._states(times, g))
        attitudes = algebra.quaternion_product(g, algebra.inverse_turn(frame))
        return velocity @ self.principal.axes.T, algebra.unit(attitudes)

    def _states(self, times: Array, g: Array) -> tuple[Array, Array]:
        """Omega (..., 3) along the principal axes and their orientation (..., 4), now g; moments in a power of two."""
        from kreisel.kernels.exact.engine import ClosedForm

        moments, kinds = self.principal.moments, ["skew", "quaternion"]
        moments = np.ldexp(moments, -math.frexp(moments.max())[1])
        z = algebra.flatten((algebra.hat(moments * (self.spin @ self.principal.axes)), g), kinds)
        form = ClosedForm(rotation_scheme(moments), z[None], 1.0, float(abs(times).max(initial=0.0)))
        M, g = algebra.restore(form.at(times.ravel())[:, 0], kinds, 3)
        return (algebra.axial(M) / moments).reshape((*times.shape, 3)), g.reshape((*times.shape, 4))

    def polhode(self, points: int = 400) -> Array:
        """The angular velocity's path in the body, (points, 3), rad/s: closed; on the separatrix, half of it."""
        rotor = self._rotor
        if rotor.steady:
            return np.tile(self.spin, (_points(points), 1))
        reach, a = math.pi / 2 if rotor.separatrix else math.pi, self._amplitudes
        x, y, _ = (float(v) for v in rotor.start_along)
        begin = 0.0 if rotor.separatrix else math.atan2(y * a[0], x * a[1])
        phi = begin + rotor.axes.chi * rotor.s * np.linspace(-reach, reach, _points(points))
        cn, sn = np.cos(phi), np.sin(phi)
        sides = np.stack([cn, sn, np.hypot(cn, float(rotor.k_prime) * sn)], -1)
        M = rotor.axes.back(float(rotor.L) * a * sides)
        return np.asarray(M / self.principal.moments @ self.principal.axes.T)

    def herpolhode(self, duration: float, points: int = 2000) -> Array:
        """The angular velocity's path in space over a duration, s: (points, 3), rad/s, the third axis along M.

        Its third component is constant, 2T/|M|: the path lies in the invariable plane.  Raises `InputError`.
        """
        reach = si_number(duration, "s", "duration", positive=True)
        x, y, z = (float(v) for v in rationals(self.momentum) / max(map(abs, rationals(self.momentum))))
        length = math.sqrt(x * x + y * y + z * z)
        upright = np.array([length + z, y, -x, 0.0] if z > -length / 2 else [y, length - z, 0.0, x])
        velocity, attitude = self.at(np.linspace(0.0, reach, _points(points)), algebra.unit(upright))
        return algebra.act(algebra.rotation_matrix(attitude), velocity)


class Periods(NamedTuple):
    """The two periods of motions, s, and whether M goes round the axis of the largest moment: short-axis modes."""

    rotation: Array  # of M round an axis in the body: `FreeRotation.period`
    precession: Array  # of this axis round M in space, on average: `FreeRotation.precession_period`
    short_axis: Array


def periods_of(moments: Array, E: Array, remainder: Array) -> tuple[Array, Array]:
    """P_psi |M| and 2 pi/(P_phi |M|) by moments (..., 3) in the order of the closed form, E/L^2 and k'^2, in doubles.

        P_psi = 4 K/lambda,   2 pi/P_phi = (L/I_3) (1 + (I_3 - I_1)/I_1 Pi(n, k)/K),
        n = -I_3 (I_2 - I_1)/(I_1 (I_3 - I_2))

    [Landau, Lifshitz, Mechanics, section 37; DLMF 19.25.2]
    """
    from scipy.special import ellipkm1, elliprf, elliprj

    I1, I2, I3 = (moments[..., i] for i in range(3))
    K, n = ellipkm1(remainder), -I3 * (I2 - I1) / (I1 * (I3 - I2))
    third = elliprf(0, remainder, 1) + n / 3 * elliprj(0, remainder, 1, 1 - n)
    return 4 * K * np.sqrt(I1 * I2 * I3 / ((I3 - I2) * E)), (1 + (I3 - I1) / I1 * third / K) / I3


def rotation_scheme(moments: Array) -> Scheme:
    """The flow of bodies with these moments (..., 3)."""

    def orbit(z0: tuple[Array, ...], constants: Mapping[str, Array], reach: float) -> Orbit:
        return Rotor(algebra.axial(z0[0]), constants["moments"], reach, z0[1]).orbit()

    spin = Spin(
        lambda M, g: (algebra.axial(M), g), lambda moments: np.asarray(moments), lambda M, g: (algebra.hat(M), g)
    )
    return Scheme(
        name="free rotation",
        components=(("M", "skew"), ("g", "quaternion")),
        constants={"moments": moments},
        axes={"moments": 1},
        n=3,
        prepare=tuple,
        observe=lambda *z, **constants: {},
        outcomes={},
        reopen=tuple,
        motion=Orbits(orbit, spin),
        definition_key=("free rotation",),
    )


def _points(points: int) -> int:
    if isinstance(points, bool) or not isinstance(points, int | np.integer) or not LEAST_POINTS <= points <= 10**7:
        raise InputError(f"points: expected an integer from {LEAST_POINTS} to 10,000,000, got {shown(points)}.")
    return int(points)
