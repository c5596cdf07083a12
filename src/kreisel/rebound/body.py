"""Extended bodies in a REBOUND simulation, and pairs of particles, of which one at least is a body.

A particle without mass feels others and does not act: in its pairs it has mass 1, and the other stays unchanged.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.bodies.binary import G
from kreisel.errors import InputError, explained, shown
from kreisel.exact import rotor_step
from kreisel.physical.free_body import FreeBody
from kreisel.physical.measures import si_numbers
from kreisel.rebound.compiled import PAIR, ROTOR, Kind
from kreisel.record.body import UPRIGHT

SAME_MASS = 1e-6  # relative: a particle and its body


@explained
@dataclass(frozen=True, eq=False)
class Body:
    """An extended body, in the units of the simulation.

    inertia      moments of inertia about the centre of mass: one value for a ball, (3,) along the principal axes, or a
                 tensor (3, 3) in any body axes; or a body of `kreisel.physical` if the simulation is in SI units, of a
                 `GravityBody` its tides and integrals of degrees 3 and 4 too; per mass for a particle without mass
    spin         angular velocity (3,) in the frame of the simulation
    orientation  unit quaternion (w, x, y, z), body axes to the frame of the simulation
    love         potential Love number k_2 of the tides; a ball is a fluid that its rotation flattens with the same k_2
    radius       R, for tides; default: the radius of the particle
    lag          time lag of the tides
    degree_3     (7,), m R^3 (C_30, C_31, S_31, ... S_33) along the principal axes, not normalized
    degree_4     (9,), m R^4 (C_40, C_41, S_41, ... S_44)

    Bodies other than balls keep their figure, which the moments determine.  In REBOUNDx, `tau` of `tides_spin` is half
    the lag.  Raises `InputError` for impossible moments of inertia.
    """

    inertia: Any
    spin: Any = (0.0, 0.0, 0.0)
    orientation: Any = UPRIGHT
    love: float = 0.0
    radius: float | None = None
    lag: float = 0.0
    degree_3: Any = None
    degree_4: Any = None

    def __post_init__(self) -> None:
        self.state()
        for name in ("love", "lag"):
            self._not_negative(name)
        self._higher()

    def principal(self) -> tuple[Array, Array]:
        """The moments (3,), and the orientation of the principal axes.  Raises `InputError`."""
        body = self._free()
        moments = body.principal.moments
        g = body.orientation(self.orientation)
        if g.shape != (4,):
            raise InputError(f"orientation: expected one unit quaternion (w, x, y, z), got {shown(self.orientation)}.")
        return moments, g

    def _axes(self) -> Array:
        """The unit quaternion (4,) that maps components along the body axes to components along the principal axes."""
        return self._free().orientation(UPRIGHT) * (1, -1, -1, -1)

    def _free(self) -> FreeBody:
        inertia = getattr(self.inertia, "inertia", self.inertia)
        number = isinstance(inertia, int | float | np.number)
        return FreeBody(np.full(3, inertia) if number else inertia)

    def angular_velocity(self) -> Array:
        """The angular velocity (3,).  Raises `InputError`."""
        return si_numbers(self.spin, "rad/s", "spin, an angular velocity in the frame of the simulation,", ((3,),))

    def state(self) -> Array:
        """L and g, (7,)."""
        moments, g = self.principal()
        R = algebra.rotation_matrix(g)
        return np.concatenate([R @ (moments * (R.T @ self.angular_velocity())), g])

    def _of_particle(self, particle: Any) -> tuple[Array, Array]:
        """L, g and the constants: moments, integrals of degrees 3 and 4, k_2 R^5, lag.  Raises `InputError`."""
        if not isinstance(self.radius, int | float | np.number | None):
            raise InputError(f"radius: expected a number, got {shown(self.radius)}.")
        love, lag = (self._not_negative(name) or getattr(self.inertia, name, 0.0) for name in ("love", "lag"))
        if lag and not love:
            raise InputError(
                f"lag: expected 0 for a body without tides, got {shown(self.lag)}. Usual cause: no love=, the Love "
                "number k_2 of the tides."
            )
        default = getattr(self.inertia, "size", 0.0) or particle.r
        size = default if self.radius is None else self._not_negative("radius")
        if love and not size > 0:
            raise InputError(
                f"radius: expected a number > 0 for a body with tides, got {shown(self.radius)} and a particle of "
                f"radius {particle.r}. Usual cause: sim.add(..., r=...) is missing."
            )
        mass, scale = getattr(self.inertia, "mass", None), 1.0
        if mass and not particle.m:
            scale = 1 / mass
        elif mass and abs(particle.m / mass - 1) > SAME_MASS:
            raise InputError(
                f"inertia: expected a body with the mass {particle.m} of its particle, got {mass}. Usual cause: a "
                "simulation in other units than SI; set sim.units = ('m', 's', 'kg')."
            )
        state, tide = self.state(), love * size**5 if love else 0.0
        state[:3] *= scale
        return state, np.concatenate([scale * np.concatenate([self.principal()[0], *self._higher()]), [tide, lag]])

    def _higher(self) -> list[Array]:
        """The inertia integrals of degrees 3 and 4.  Raises `InputError` unless they are along the principal axes."""
        out = []
        for name, count in (("degree_3", 7), ("degree_4", 9)):
            value = getattr(self, name)
            value = getattr(self.inertia, name, np.zeros(count)) if value is None else value
            out.append(si_numbers(value, f"kg m^{name[-1]}", name, ((count,),)))
        inertia = np.asarray(getattr(self.inertia, "inertia", self.inertia))
        if any(x.any() for x in out) and inertia.ndim == 2 and (inertia - np.diag(np.diag(inertia))).any():
            raise InputError(
                f"degree_3, degree_4: expected principal axes, got inertia={shown(inertia.tolist())}. Usual cause: a "
                "tensor in other axes; kr.physical.GravityBody.points and mesh compute all of them in principal axes."
            )
        return out

    def _not_negative(self, name: str) -> float:
        value = getattr(self, name)
        if isinstance(value, bool) or not isinstance(value, int | float | np.number) or not 0 <= value < math.inf:
            raise InputError(f"{name}: expected a finite number >= 0, got {shown(value)}.")
        return float(value)


# -- pairs: their kinds and the factors of their interaction ---------------------------------------------


CONSTANTS = {"moments": 3, "degree_3": 7, "degree_4": 9, "tide": 1, "lag": 1}  # of a body, in a row
ENDS = np.cumsum([*CONSTANTS.values()])


def is_ball(moments: Array) -> bool:
    """Whether moments are equal up to rounding."""
    return bool(np.ptp(moments) <= 1e-12 * np.max(moments))


def rotor(row: Array) -> Array:
    """The constants of the free rotation of a body."""
    moments = row[:3]
    constants = rotor_step.constants(np.full(3, moments.mean()) if is_ball(moments) else moments)
    return np.concatenate([constants[name] for name in ROTOR])


class Side(NamedTuple):
    """A particle in a pair.

    particle, body   its places
    mass             1 for particles without mass
    source           the mass that acts on the other particle, or 0
    on               1, or 0 if the other does not act on it
    row              `CONSTANTS` of a body, 0 of a point
    """

    particle: int
    body: int
    mass: float
    source: float
    on: float
    row: Array

    @property
    def degree(self) -> int:
        """The degree of its figure."""
        moments, *higher = np.split(self.row, ENDS[:3])[:3]
        return 4 if any(x.any() for x in higher) else 0 if is_ball(moments) else 2

    @property
    def fluid(self) -> bool:
        """Whether rotation flattens it: a ball with tides."""
        return bool(self.row[-2] and not self.degree)

    def factors(self, n: str, partner: Side, h: float, scale: float) -> dict[str, Any]:
        """The factors of this side, which is number `n` of the pair."""
        moments, third, fourth, tide, lag = np.split(self.row, ENDS[:-1])
        inverse = 1 / moments if moments.any() else moments
        return {
            f"D{n}": (moments.mean() - moments) / self.mass if self.degree else 0 * moments,
            f"degree_3_{n}": third / self.mass,
            f"degree_4_{n}": fourth / self.mass,
            f"fluid{n}": h * partner.mass * tide[0] if self.fluid else 0.0,
            f"inverse{n}": inverse,
            f"lag{n}": scale * partner.source**2 * tide[0] * lag[0],
            f"into{n}": self.on / self.mass,
            f"on{n}": self.on,
        }


class Row(NamedTuple):
    """An interaction: its kind, the places of both particles and bodies, its factors."""

    kind: Kind
    places: tuple[int, int, int, int]
    factors: dict[str, Any]


def interactions(left: Side, right: Side, h: float, gravity: float) -> list[Row]:
    """The kick of a pair for a time h, and the friction of its tides, as far as there are any."""
    scale, rows = h * gravity / G, []
    tides = [(x, partner.source**2 * x.row[ENDS[2]]) for x, partner in ((left, right), (right, left))]
    for lags in (False, True):
        active = [bool(x.row[-1] and tide) if lags else x.fluid for x, tide in tides]
        order = [(x.degree if not lags else active[k], active[k], x.row[0] > 0) for k, x in enumerate((left, right))]
        first, second = (left, right) if order[0] >= order[1] else (right, left)
        count = 0 if not any(active) else 2 if all(active) or active != [first is left, first is right] else 1
        raised = sum(tide for _, tide in tides) / (left.mass * right.mass)
        factors = {"strength": scale * left.mass * right.mass, "raised": raised}
        factors |= first.factors("1", second, h, scale) | second.factors("2", first, h, scale)
        places = first.particle, second.particle, first.body, second.body
        if lags and count:
            degrees = [min(x.degree, 2) * on for x, on in ((first, 1), (second, count == 2))]
            rows.append(Row(Kind(degrees[0], degrees[1], lags=count), places, factors))
        elif not lags and any((first.degree, count, raised)):
            rows.append(Row(Kind(first.degree, second.degree, fluids=count), places, factors))
    return rows


class Pairs(NamedTuple):
    """The interactions of a simulation, the values that they depend on, and the arrays of the kernels."""

    key: tuple[float, float, int, int, bytes]
    kinds: tuple[Kind, ...]
    rows: list[Row]
    places: Array
    factors: Array

    @classmethod
    def of(cls, key: Any, masses: Array, index: Array, constants: Array) -> Pairs:
        """Interactions of particles, of which `index` are bodies; `key`: h, G, active, testparticle_type, masses."""
        h, gravity, active, mutual, _ = key
        bodies, points = {int(i): k for k, i in enumerate(index)}, np.zeros(constants.shape[1])

        def acts(i: int, j: int) -> bool:
            return bool(masses[i] > 0 and (i < active or (mutual and j < active)))

        def side(i: int, j: int) -> Side:
            row = constants[bodies[i]] if i in bodies else points
            return Side(i, bodies.get(i, len(bodies)), masses[i] or 1.0, acts(i, j) * masses[i], acts(j, i) * 1.0, row)

        pairs = [(i, j) for i in sorted(bodies) for j in range(len(masses)) if j not in bodies or i < j]
        rows = [row for i, j in pairs for row in interactions(side(i, j), side(j, i), h, gravity)]
        rows.sort(key=lambda row: row.kind.lags > 0)  # frictions last: kicks do not wait for the results of each other
        kinds = tuple(sorted({row.kind for row in rows}))
        places = np.array([[kinds.index(row.kind), *row.places] for row in rows], dtype=np.int64)
        factors = [np.concatenate([np.ravel(row.factors[name]) for name in PAIR]) for row in rows]
        return cls(key, kinds, rows, places, np.array(factors))
