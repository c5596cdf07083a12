"""Two rigid bodies that orbit each other and rotate each other, in SI units."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.algebra.reuse import cached_property
from kreisel.bodies import BODIES
from kreisel.bodies.binary import G
from kreisel.errors import InputError, explained, shown
from kreisel.physical.gravity_body import GravityBody
from kreisel.physical.measures import RATE, attitude_quaternion, si_number, si_numbers
from kreisel.physical.orbit import Orbit, Primary
from kreisel.record.body import Body
from kreisel.record.model import Model, State
from kreisel.runs.in_si import in_state_form

if TYPE_CHECKING:
    import xarray as xr


@explained
class PointMass(NamedTuple):
    """A third body: mass, kg; position, m, and velocity, m/s, (3,), relative to the barycentre of a binary at t = 0."""

    mass: Any
    position: Any
    velocity: Any


@explained
@dataclass(frozen=True, eq=False)
class Binary(Body):
    """Two rigid bodies of any shape: the full two-body problem, with a third point mass and tides.

        pair = Binary.didymos()
        run = kr.simulate(pair, pair.state(), dt="1 h", t_end="1 year")

    primary, secondary   `GravityBody`s; their tides lag if they have `love` and `lag`
    third                None; an `Orbit` of the barycentre around the Sun or a planet; or a `PointMass` that flies by

    A run has position and velocity of the secondary relative to the primary, the angular momentum and the attitude of
    each body, all in space, with a third body also its position and velocity.  The mutual potential has all terms of
    the fourth degree in size over distance.  The equations: `kreisel.bodies.binary`.  Raises `InputError`.
    """

    primary: GravityBody
    secondary: GravityBody
    third: Any = None

    def __post_init__(self) -> None:
        for name in ("primary", "secondary"):
            if not isinstance(getattr(self, name), GravityBody):
                raise InputError(
                    f"{name}: expected kr.physical.GravityBody(...), such as GravityBody.ellipsoid(mass, diameters), "
                    f"got {shown(getattr(self, name))}."
                )
        if not isinstance(self.third, Orbit | PointMass | None):
            raise InputError(f"third: expected an Orbit around the Sun, a PointMass or None, got {shown(self.third)}.")
        self.model()

    @property
    def mu(self) -> float:
        """G (m1 + m2), m^3/s^2."""
        return G * (self.primary.mass + self.secondary.mass)

    def model(self) -> Model:
        """The system "binary", or "binary-with-third-body", in SI units and principal axes."""
        return self._built

    @cached_property
    def _built(self) -> Model:
        values: dict[str, Any] = {}
        for i, body in ((1, self.primary), (2, self.secondary)):
            values |= {f"m{i}": body.mass, f"moments{i}": body.inertia, f"lag{i}": body.lag}
            values |= {f"degree_3_{i}": body.degree_3, f"degree_4_{i}": body.degree_4}
            values[f"tide{i}"] = body.love * body.size**5
        if self.third is None:
            return BODIES["binary"](**values)
        return BODIES["binary-with-third-body"](**values, m3=self._point_mass.mass)

    @cached_property
    def _point_mass(self) -> PointMass:
        """The third body at t = 0."""
        if isinstance(self.third, Orbit):
            position, velocity = self.third.at(0.0)
            return PointMass(self.third.primary.mu / G, -np.asarray(position), -np.asarray(velocity))
        mass, position, velocity = self.third
        return PointMass(
            si_number(mass, "kg", "mass of the third body", positive=True),
            si_numbers(position, "m", "position of the third body", ((3,),)),
            si_numbers(velocity, "m/s", "velocity of the third body", ((3,),)),
        )

    @property
    def words(self) -> dict[str, str]:
        """The names of the variables of a run in SI, by the letters of the state."""
        names = {"r": "position", "v": "velocity", "R": "third_position", "V": "third_velocity"}
        return names | {f"{k}{i}": f"{word}_{i}" for i in "12" for k, word in (("L", "momentum"), ("q", "attitude"))}

    def state(
        self,
        position: Any = None,
        velocity: Any = None,
        spin1: Any = None,
        spin2: Any = None,
        attitude1: Any = None,
        attitude2: Any = None,
        orbit: Orbit | None = None,
        unbound: bool = False,
    ) -> State:
        """The initial state.

        position, velocity     of the secondary relative to the primary, m and m/s, (..., 3)
        orbit                  instead of these the mutual orbit, an `Orbit` whose `primary` is `pair.centre`
        spin1, spin2           angular velocities along the body axes, rad/s, (..., 3); default: that of the orbit
        attitude1, attitude2   unit quaternions (..., 4), body to space; default: the first axis along the line between
                               the bodies, the third along the normal of the orbit
        unbound                whether the orbit may be a flyby

        Raises `InputError` for bodies that touch at the pericentre, and for an orbit that is not bound.
        """
        if (orbit is None) == (position is None) or (position is None) != (velocity is None):
            raise InputError("state: expected position and velocity, or orbit=Orbit(...), got both or neither.")
        r, v = self._from_orbit(orbit) if orbit is not None else (position, velocity)
        r, v = np.broadcast_arrays(si_numbers(r, "m", "position"), si_numbers(v, "m/s", "velocity"))
        self._require_apart(r, v, unbound)
        normal = np.cross(r, v)
        rate = np.linalg.norm(normal, axis=-1, keepdims=True) / (r * r).sum(-1, keepdims=True)
        parts = {"r": r, "v": v}
        bodies = (self.primary, spin1, attitude1), (self.secondary, spin2, attitude2)
        for i, (body, spin, attitude) in enumerate(bodies, 1):
            if attitude is None:
                q = algebra.unit_quaternion(_towards(r, normal))
            else:
                q = attitude_quaternion(attitude, f"attitude{i}")
            Omega = rate * np.array([0.0, 0.0, 1.0]) if spin is None else si_numbers(spin, RATE, f"spin{i}")
            parts[f"L{i}"], parts[f"q{i}"] = algebra.act(algebra.rotation_matrix(q), body.inertia * Omega), q
        if self.third is not None:
            parts |= {"R": self._point_mass.position, "V": self._point_mass.velocity}
        batch = np.broadcast_shapes(*(x.shape[:-1] for x in parts.values()))
        return self.model().state(**{k: np.broadcast_to(x, (*batch, x.shape[-1])) for k, x in parts.items()})

    @property
    def centre(self) -> Primary:
        """The central body of mutual orbits: mu = G (m1 + m2), and as radius the distance at which the bodies touch."""
        return Primary("binary", self.mu, self.primary.size + self.secondary.size)

    def _from_orbit(self, orbit: Any) -> tuple[Array, Array]:
        if not isinstance(orbit, Orbit) or not math.isclose(orbit.primary.mu, self.mu, rel_tol=1e-9):
            raise InputError(
                f"orbit: expected Orbit(..., primary=pair.centre), whose mu is {self.mu:g} m^3/s^2, got {shown(orbit)}."
            )
        return orbit.at(0.0)

    def _require_apart(self, r: Array, v: Array, unbound: bool) -> None:
        """Raises `InputError` for orbits that the expansion or the caller excludes."""
        distance, square = np.linalg.norm(r, axis=-1), (v * v).sum(-1)
        energy = square / 2 - self.mu / distance
        momentum = (np.cross(r, v) ** 2).sum(-1) / self.mu
        e = np.sqrt(np.maximum(1 + 2 * energy * momentum / self.mu, 0))
        least = np.min(np.where(e < 1, momentum / (1 + e), distance) if unbound else momentum / (1 + e))
        touch = self.primary.size + self.secondary.size
        if not unbound and not (energy < 0).all():
            raise InputError(
                f"state: expected a bound orbit, got a velocity of {np.sqrt(square).max():g} m/s, where "
                f"{np.sqrt(2 * self.mu / distance).min():g} m/s escape. Usual cause: km/s or a sum of both velocities. "
                "For a flyby give unbound=True."
            )
        if not (least > touch).all():
            raise InputError(
                f"state: expected bodies apart, {touch:g} m or more between their centres, got a pericentre of "
                f"{least:g} m: they touch. Usual cause: a diameter for a radius, or km for m."
            )

    # -- what a run shows ----------------------------------------------------------------------------------

    def spins(self, run: xr.Dataset) -> tuple[Array, Array]:
        """Angular velocities of the two bodies along their axes, rad/s, (..., 3), at each row of a run."""
        run, out = in_state_form(run), []
        for i, body in ((1, self.primary), (2, self.secondary)):
            Q = algebra.rotation_matrix(run[f"q{i}"].values)
            out.append(algebra.act(Q.mT, run[f"L{i}"].values) / body.inertia)
        return out[0], out[1]

    def angles(self, run: xr.Dataset, body: int = 2) -> tuple[Array, Array, Array]:
        """Roll, pitch and yaw of a body relative to the orbit, rad, at each row: rotations R_z R_y R_x of its axes.

        The frame has its first axis along the line between the bodies and the third along the normal of the orbit.
        """
        run = in_state_form(run)
        frame = _towards(run["r"].values, np.cross(run["r"].values, run["v"].values))
        C = frame.mT @ algebra.rotation_matrix(run[f"q{body}"].values)
        return (
            np.arctan2(C[..., 2, 1], C[..., 2, 2]),
            np.arcsin(np.clip(-C[..., 2, 0], -1, 1)),
            np.arctan2(C[..., 1, 0], C[..., 0, 0]),
        )


def _towards(r: Array, normal: Array) -> Array:
    """The axes along r, ahead and along the normal, as columns (..., 3, 3)."""
    x, z = (u / np.linalg.norm(u, axis=-1, keepdims=True) for u in (r, normal))
    return np.stack([x, np.cross(z, x), z], -1)
