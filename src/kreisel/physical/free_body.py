"""The free rigid body, in SI units, and its motion in closed form.

Periods and angles come from constants in many digits, states from the compiled jumps of method="exact".
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array, dot, vec
from kreisel.algebra.reuse import cached_property
from kreisel.errors import InputError, explained, shown
from kreisel.exact.nutation import rationals
from kreisel.exact.rotor import Rotor
from kreisel.method.scheme import Orbits, Scheme, Spin
from kreisel.physical.body import Forced
from kreisel.physical.measures import (
    Principal,
    convert_fields,
    direction,
    finite_floats,
    in_range,
    inertia_tensor,
    momentum_in_body,
    principal,
    require_thickness,
    si_number,
    si_numbers,
)
from kreisel.physical.shapes import read_mesh
from kreisel.record.body import UPRIGHT
from kreisel.record.contract import Orbit
from kreisel.record.model import Model, State
from kreisel.record.units import BodyFrame
from kreisel.record.values import CLOSE
from kreisel.system import REGISTRY

MOST_FLIPS = 10**7
LEAST_POINTS = 2
NEXT, LAST = np.array([1, 2, 0]), np.array([2, 0, 1])  # arrays, for JAX


class AxisStability(NamedTuple):
    """The effect of a small disturbance on the rotation about a principal axis."""

    axis: Array  # (3,), along the body axes
    moment: float  # kg m^2
    kind: str  # "stable", "unstable", or "neutral": its moment equals another axis's
    growth: float  # rad/s: the disturbance grows as exp(growth t); 0 unless unstable
    period: float  # s, of the disturbance in the body; inf unless stable


@explained
@dataclass(frozen=True, eq=False, repr=False)
class FreeBody(Forced):
    """A rigid body without torque, or under user-defined forces (`Forced`), in SI units.

    inertia     classical inertia tensor I about the centre of mass, (3, 3) in any body axes, or its diagonal, kg m^2
    mass        kg, not needed for the rotation
    time_unit   the unit of time of the scaled system, s

    Scaled as `EulerTop` in the principal axes: J = (I_j + I_k - I_i)/(2 I0) with I0 = tr(I)/3, time in `time_unit`,
    momentum in I0/time_unit.  A spin is a vector along the body axes, or a rate and an axis: ("300 rpm", (0, 0, 1)).
    Raises `InputError` for impossible moments of inertia.  [Landau, Lifshitz, Mechanics, section 37]
    """

    inertia: Any
    mass: float | None = None
    time_unit: float = 1.0

    def __post_init__(self) -> None:
        if self.mass is not None:
            convert_fields(self, positive=True, mass="kg")
        convert_fields(self, positive=True, time_unit="s")
        object.__setattr__(self, "inertia", inertia_tensor(self.inertia))
        require_thickness(self.inertia)
        for name in ("momentum_unit", "energy_unit"):
            si_number(in_range(name, lambda name=name: getattr(self, name)), "J", name, positive=True)  # type: ignore[misc]

    @classmethod
    def box(cls, mass: float, sides: Any, time_unit: float = 1.0, **forces: Any) -> FreeBody:
        """A homogeneous box with these sides, m.  Raises `InputError`."""
        lengths = si_numbers(sides, "m", "sides", ((3,),))
        return cls(*_homogeneous(mass, lengths, 12.0), time_unit, **forces).shaped("box", lengths / 2)

    @classmethod
    def ellipsoid(cls, mass: float, diameters: Any, time_unit: float = 1.0, **forces: Any) -> FreeBody:
        """A homogeneous ellipsoid with these principal diameters, m.  Raises `InputError`."""
        lengths = si_numbers(diameters, "m", "diameters", ((3,),))
        return cls(*_homogeneous(mass, lengths, 20.0), time_unit, **forces).shaped("ellipsoid", lengths / 2)

    @classmethod
    def from_mesh(
        cls,
        mesh: str | os.PathLike[str],
        length: Any = None,
        density: Any = None,
        mass: Any = None,
        time_unit: float = 1.0,
        **forces: Any,
    ) -> FreeBody:
        """The homogeneous body of a mesh file, with coordinates in `length` ("mm"), by its density or mass.

        See `read_mesh`, whose result other bodies accept too.  Raises `InputError`.
        """
        solid = read_mesh(mesh, length, density, mass)
        return cls(solid.inertia, solid.mass, time_unit, **forces)

    @cached_property
    def principal(self) -> Principal:
        """The principal moments, kg m^2, and axes: columns in body axes.  A diagonal tensor keeps its order."""
        return principal(self.inertia)

    @property
    def unit_moment(self) -> float:
        """I0 = tr(I)/3, kg m^2."""
        return float(np.trace(self.inertia)) / 3

    @property
    def momentum_unit(self) -> float:
        """I0/time_unit, kg m^2/s."""
        return self.unit_moment / self.time_unit

    @property
    def energy_unit(self) -> float:
        """I0/time_unit^2, J."""
        return self.momentum_unit / self.time_unit

    def model(self) -> Model:
        """The scaled system `EulerTop(J)`, in principal axes; a flat body, J_i = 0, moves by method="exact"."""
        J = _mass_moments(self.principal.moments, self.unit_moment)
        J[abs(J) < CLOSE] = 0
        frame = BodyFrame.in_units(self.time_unit, self.momentum_unit, self.principal.axes)
        return self.forced(REGISTRY["euler-top"](J=J).of_body(frame))

    @property
    def parameters_in_si(self) -> dict[str, Any]:
        """The principal moments, kg m^2, which determine J."""
        return {"moments": self.principal.moments}

    def _scaled(self, parameters: dict[str, Any]) -> dict[str, Any]:
        """J for the principal moments."""
        if wrong := parameters.keys() & {"J", "inertia"}:
            raise InputError(
                f"{', '.join(sorted(wrong))}: expected moments=..., its principal moments, kg m^2. Usual "
                "cause: J of the scaled system, which is in units of a third of the trace of the inertia tensor."
            )
        moments = parameters.get("moments")
        if moments is None:
            return parameters
        moments = moments if hasattr(moments, "shape") else np.array(moments, dtype=float)
        if moments.shape != (3,):
            raise InputError(f"moments: expected three principal moments, kg m^2, got {moments.shape}.")
        others = {name: value for name, value in parameters.items() if name != "moments"}
        return {**others, "J": _mass_moments(moments, self.unit_moment)}

    def state(self, spin: Any, axis: Any = None, attitude: Any = UPRIGHT) -> State:
        """The scaled state M = I Omega, in principal axes.

        Spin Omega (..., 3) in rad/s along the body axes; or a rate, with `axis` (3,) in the body.  The attitude of the
        body axes is that with which a run of the body begins.  Raises `InputError`.
        """
        Omega = angular_velocity_of(spin, axis)
        M = in_range("The momentum", lambda: Omega @ self.inertia @ self.principal.axes / self.momentum_unit)
        return self._started(self.orientation(attitude), M=M)

    def angular_velocity(self, M: Any) -> Array:
        """The inverse of `state`: Omega (..., 3) in rad/s along the body axes, from M (..., 3) axial.

        An array is read as M of a state of this body; the variable M of a run states its units and axes.  Raises
        `InputError`.
        """
        moments, axes = self.principal
        momentum = momentum_in_body(M, self._body_frame)
        return in_range("Omega", lambda: momentum @ axes / moments @ axes.T)

    def rotation(self, spin: Any, axis: Any = None) -> FreeRotation:
        """The motion that begins with this spin, in closed form: periods, precession, polhode.  Raises `InputError`."""
        Omega = angular_velocity_of(spin, axis)
        if Omega.shape != (3,) or not Omega.any():
            raise InputError(
                f"spin: expected one angular velocity that is not zero, got {shown(spin)}. Usual cause: several at a "
                "time; pass them one by one."
            )
        in_range("The square of the spin", lambda: 1 / (Omega @ Omega))
        motion = FreeRotation(self.inertia, self.principal, Omega)
        in_range("The precession", lambda: motion.precession)
        return motion

    def periods(self, spin: Any, axis: Any = None) -> Periods:
        """Both periods of motions that begin with the spins (..., 3), in doubles, for three different moments.

        NaN for steady rotations; near the separatrix digits are lost, which `rotation` keeps.  Raises `InputError`.
        """
        Omega = angular_velocity_of(spin, axis) @ self.principal.axes
        order = np.argsort(self.principal.moments)
        I = self.principal.moments[order]  # noqa: E741
        if not I[0] < I[1] < I[2]:
            raise InputError(f"periods: expected three different moments, got {I.tolist()}. rotation(spin) has both.")
        with np.errstate(all="ignore"):
            M = Omega[..., order] * I
            L = np.sqrt(dot(M, M))
            N = M / vec(L)
            short = N[..., 2] ** 2 * I[0] * (I[2] - I[1]) > N[..., 0] ** 2 * I[2] * (I[1] - I[0])
            N = np.where(short[..., None], N, N[..., ::-1])
            I = np.where(short[..., None], I, I[::-1])  # noqa: E741
            I1, I2, I3 = (I[..., i] for i in range(3))
            E = (1 - I1 / I2) * N[..., 1] ** 2 + (1 - I1 / I3) * N[..., 2] ** 2
            gap = (1 - I2 / I1) * N[..., 0] ** 2 + (1 - I2 / I3) * N[..., 2] ** 2
            period, rate = periods_of(I, E, (I3 - I1) * gap / ((I3 - I2) * E))
        tumbling = (N[..., :2] ** 2).sum(-1) > 0
        return Periods(
            np.where(tumbling, period / L, np.nan), np.where(tumbling, 2 * np.pi / (rate * L), np.nan), short
        )

    def stability(self, spin: float) -> tuple[AxisStability, ...]:
        """The rotation at this rate, rad/s, about each principal axis, in the order of `principal`.

        About the axis 1 a disturbance goes as exp(s t), s^2 = spin^2 (I1 - I2)(I3 - I1)/(I2 I3).  Raises `InputError`.
        """
        rate = abs(si_number(spin, "rad/s", "spin"))
        moments, axes = self.principal
        in_range("The growth", lambda: rate * moments.max() / moments.min())
        result = []
        for i in range(3):
            a, b, c = moments[[i, (i + 1) % 3, (i + 2) % 3]]
            square = (a / b - 1) * (1 - a / c)
            s = rate * math.sqrt(abs(square))
            kind = "neutral" if square == 0 else "unstable" if square > 0 else "stable"
            period = 2 * math.pi / s if kind == "stable" and s else math.inf
            result.append(AxisStability(axes[:, i].copy(), float(a), kind, s if kind == "unstable" else 0.0, period))
        return tuple(result)


def _mass_moments(moments: Any, unit: float) -> Any:
    """J of `EulerTop` for principal moments (..., 3), in `unit`, kg m^2; of NumPy or JAX."""
    return (moments[..., NEXT] + moments[..., LAST] - moments) / (2 * unit)


def angular_velocity_of(spin: Any, axis: Any) -> Array:
    """(..., 3) in rad/s along the body axes, from a vector, or from a rate and an axis.  Raises `InputError`."""
    if axis is not None:
        return si_number(spin, "rad/s", "spin") * direction(axis, "axis")
    if hasattr(spin, "data_vars"):
        raise InputError(
            "spin: expected an angular velocity, got a Dataset. With row = run.isel(time=-1), pass "
            "spin=row.angular_velocity, attitude=row.attitude, or begin a run of this body at the row."
        )
    if isinstance(spin, str) or (not isinstance(spin, list | tuple) and np.ndim(spin) == 0):
        raise InputError(
            f"spin: expected three components along the body axes, got {shown(spin)}. Usual cause: a rate without its "
            "axis; say axis=(0, 0, 1)."
        )
    return si_numbers(spin, "rad/s", "spin")


def _homogeneous(mass: Any, sizes: Array, divisor: float) -> tuple[Array, float]:
    """Moments I_1 = mass (b^2 + c^2)/divisor, and the mass."""
    mass = si_number(mass, "kg", "mass", positive=True)
    if sizes.min() < 0:
        raise InputError(f"expected lengths of at least 0, got {shown(sizes.tolist())}.")
    squares = in_range("The moments", lambda: mass * sizes**2 / divisor)
    return squares.sum() - squares, mass


# -- the motion in closed form: `kreisel.exact.rotor` has the formulas -----------------------------


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
