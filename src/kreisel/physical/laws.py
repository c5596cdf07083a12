"""Laws that are known, as controllers: B-dot, damping by magnets, pointing by wheels, pointing at the Sun.

Vectors are along the body axes, B is the field, b = B/|B|, w the angular velocity of the body, h the momentum of its
wheels.  A dipole m = B x T/|B|^2 exerts T - b (b.T), the part of a torque T that magnets can exert.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.algebra.gradient import exp
from kreisel.bodies.orbit import arcsine
from kreisel.errors import InputError, explained, shown
from kreisel.physical.control import Control, Wheels
from kreisel.physical.measures import attitude_quaternion, direction, si_number, si_numbers

ORBIT = "orbit"
MU_0 = 1.25663706127e-6  # N/A^2, CODATA 2022


def _along_rate(field: Array, before: Array, begun: Array, *, gain: Any, every: Any) -> dict[str, Array]:
    square = algebra.dot(field, field)
    return {"dipole": -gain * begun / every * (field - before) / square, "before": field, "begun": begun * 0 + 1.0}


@explained
def bdot(gain: Any, every: Any = 1.0, **options: Any) -> Control:
    """B-dot: the dipole -gain (dB/dt)/|B|^2, which brakes a tumbling satellite; only a magnetometer is needed.

    gain     N m s: the torque is about -gain (w - b (b.w)).  Advised: 2 n (1 + sin i) I, n the mean motion, i the
             inclination of the orbit to the magnetic equator, I the least moment of inertia
    every    s, between two samples, whose difference is dB/dt; the satellite rotates by less than pi in between
    options  arguments of `kr.Control`: limits={"dipole": 0.2}, noise={"field": 1e-7}

    [Stickler, Alfriend, J. Spacecraft Rockets 13 (1976) 282; gain: Avanzini, Giulietti, J. Guid. Control Dyn. 35
    (2012) 1326; Markley, Crassidis, Fundamentals of Spacecraft Attitude Determination and Control, 2014, section 7.5]
    """
    parameters = _numbers(gain=(gain, "N m s"), every=(every, "s"))
    return Control(_along_rate, parameters["every"], {"before": np.zeros(3), "begun": 0.0}, parameters, **options)


def _against_rates(field: Array, rates: Array, *, gain: Any) -> dict[str, Array]:
    return {"dipole": gain * algebra.cross(rates, field) / algebra.dot(field, field)}


@explained
def magnetic_damping(gain: Any, every: Any = 1.0, **options: Any) -> Control:
    """The dipole gain w x B/|B|^2, from measured rates: the torque -gain (w - b (b.w)); gain and options as for `bdot`.

    [Avanzini, Giulietti 2012]
    """
    return Control(_against_rates, every, {}, {"gain": si_number(gain, "N m s", "gain")}, **options)


@explained
def pointing(
    wheels: Wheels,
    stiffness: Any,
    damping: Any,
    *,
    target: Any = ORBIT,
    unloading: Any = 0.0,
    every: Any = 1.0,
    **options: Any,
) -> Control:
    """Wheels that hold an attitude: the torque -stiffness a - damping (w - w_0), with a the rotation from the target.

    wheels     `Wheels` of the satellite, at least three; each has its share of the torque by the pseudoinverse
    stiffness, damping   N m/rad and N m s: I f^2 and 2 z I f for a frequency f and a damping ratio z
    target     "orbit": the body axes x ahead, y against the normal of the orbit, z down; or an attitude in space,
               (w, x, y, z)
    unloading  1/s: the rate at which magnets remove momentum from the wheels, the dipole unloading h x B/|B|^2
    options    arguments of `kr.Control`

    [Wie, Weiss, Arapostathis, J. Guid. Control Dyn. 12 (1989) 375; Markley, Crassidis 2014, sections 7.2 and 7.5]
    """
    if not isinstance(wheels, Wheels) or np.linalg.matrix_rank(wheels.axes) < 3:
        raise InputError(f"wheels: expected Wheels with axes in all directions of space, got {shown(wheels)}.")
    if isinstance(target, str) and target != ORBIT:
        raise InputError(f"target: expected 'orbit' or an attitude (w, x, y, z), got {shown(target)}.")
    aim = None if isinstance(target, str) else attitude_quaternion(target, "target")
    parameters = _numbers(stiffness=(stiffness, "N m/rad"), damping=(damping, "N m s"), unloading=(unloading, "1/s"))
    return Control(_Pointing(wheels.axes, aim), every, {}, parameters, **options)


def _numbers(**values: tuple[Any, str]) -> dict[str, float]:
    return {name: si_number(value, unit, name) for name, (value, unit) in values.items()}


@dataclass(frozen=True, eq=False)
class _Pointing:
    """axes of the wheels (k, 3); aim: an attitude in space, None for the frame of the orbit."""

    axes: Array
    aim: Array | None

    def __call__(
        self,
        rates: Any,
        attitude: Any,
        position: Any,
        velocity: Any,
        wheels: Any,
        field: Any,
        *,
        stiffness: Any,
        damping: Any,
        unloading: Any,
    ) -> dict[str, Array]:
        if self.aim is None:
            turn, error = _from_orbit(position, velocity)
        else:  # 2 sin(a/2) about the axis of the rotation, by the shorter way
            off = algebra.quaternion_product(algebra.inverse_turn(self.aim), attitude)
            turn, error = 0 * rates, algebra.where_less(off[0], 0, -2.0, 2.0) * off[1:]
        torque = -stiffness * error - damping * (rates - turn)
        h = wheels @ self.axes
        dipole = unloading * algebra.cross(h, field) / algebra.dot(field, field)
        return {"wheel_torque": -np.linalg.pinv(self.axes.T) @ torque, "dipole": dipole}


def _from_orbit(r: Array, v: Array) -> tuple[Array, Array]:
    """The angular velocity of the frame of the orbit, and the rotation of the body from it: sin(a) about its axis."""
    w = algebra.cross(r, v) / algebra.dot(r, r)
    down, across = -algebra.unit(r), -algebra.unit(w)
    ahead = algebra.cross(across, down)
    error = sum(algebra.cross(to, axis) for to, axis in zip((ahead, across, down), np.eye(3), strict=True))
    return w, error / 2


def _towards_sun(
    rates: Array, sun: Array, light: Any, *, axis: Array, stiffness: Any, damping: Any
) -> dict[str, Array]:
    return {"torque": light * stiffness * algebra.cross(axis, sun) - damping * rates}


@explained
def sun_pointing(axis: Any, stiffness: Any, damping: Any, every: Any = 1.0, **options: Any) -> Control:
    """The torque stiffness axis x sun - damping w: a body axis points at the Sun; in the shadow it keeps its direction.

    stiffness, damping   N m/rad and N m s.  [Markley, Crassidis 2014, section 7.2]
    """
    parameters: dict[str, Any] = _numbers(stiffness=(stiffness, "N m/rad"), damping=(damping, "N m s"))
    return Control(_towards_sun, every, {}, {**parameters, "axis": direction(axis, "axis")}, **options)


@explained
def hysteresis_rods(
    axes: Any, volume: Any, coercivity: Any, remanence: Any, saturation: Any, every: Any = 1.0
) -> Control:
    """Rods of soft magnetic material, which damp a satellite passively: dipoles V B/mu_0 along their axes.

        dB/dH = (2 k B_s/pi) cos^2(pi B/(2 B_s)) u^2,  u = (H - y + H_c)/(2 H_c),  k H_c = tan(pi B_r/(2 B_s))

    if H rises, with y = tan(pi B/(2 B_s))/k; if it falls, H and y have the other sign.  u is the place between the
    sides of the loop, y = H + H_c and H - H_c.  Between two samples u = tanh(H/(2 H_c) + constant), exactly.

    axes       (k, 3), directions along the body axes
    volume     V, m^3;  coercivity H_c, A/m;  remanence B_r < saturation B_s, T, of the rods, not of their material:
               each one value or (k,)
    every      s, between two samples, in which H changes monotonically; the rods begin in the middle of their loops

    The field of other magnets at the rods is left out.  A run has y as `inner`.  [Flatley, Henretty, Flight Mechanics
    Estimation Theory Symposium, NASA CP-3299, 1995, 405]
    """
    directions = si_numbers(axes, "1", "axes")
    directions = np.atleast_2d(directions) / np.linalg.norm(np.atleast_2d(directions), axis=-1, keepdims=True)
    count = len(directions)
    names = ("volume", "m^3"), ("coercivity", "A/m"), ("remanence", "T"), ("saturation", "T")
    pairs = zip((volume, coercivity, remanence, saturation), names, strict=True)
    sizes = {k: si_numbers(value, unit, k, ((), (count,))) + np.zeros(count) for value, (k, unit) in pairs}
    for name, value in {**sizes, "saturation - remanence": sizes["saturation"] - sizes["remanence"]}.items():
        if not (value > 0).all() or not np.isfinite(directions).all():
            raise InputError(f"hysteresis_rods: expected {name} > 0 and axes with directions, got {shown(value)}.")
    memory = {"inner": np.zeros(count), "before": np.zeros(count), "begun": 0.0}
    return Control(_Rods(directions, *sizes.values()), every, memory)


@dataclass(frozen=True, eq=False)
class _Rods:
    """Rods: axes (k, 3), and (k,) of each quantity."""

    axes: Array
    volume: Array
    coercivity: Array
    remanence: Array
    saturation: Array

    def __call__(self, field: Array, inner: Array, before: Array, begun: Any) -> dict[str, Any]:
        H, Hc, Bs = self.axes @ field / MU_0, self.coercivity, self.saturation
        before, y = (begun * value + (1 - begun) * H for value in (before, inner))
        s = algebra.where_less(H - before, 0 * H, -1.0 + 0 * H, 1.0 + 0 * H)
        u = (s * (before - y) + Hc) / (2 * Hc)
        E = exp(-s * (H - before) / Hc)
        T = (1 - E) / (1 + E)
        y = H - s * Hc * (2 * (u + T) / (1 + u * T) - 1)
        x = np.tan(np.pi * self.remanence / (2 * Bs)) / Hc * y
        r = algebra.sqrt(1 + x * x)
        B = 2 * Bs / np.pi * arcsine(x / r, 1 / r)
        return {"dipole": (self.volume * B / MU_0) @ self.axes, "inner": y, "before": H, "begun": begun * 0 + 1.0}
