"""Two rigid bodies, by inertia integrals up to the fourth degree, that orbit and rotate each other, in SI units."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.algebra.gradient import value_and_gradient
from kreisel.algebra.reuse import cached_property
from kreisel.bodies import BODIES, binary as formulas_of_pairs, satellite
from kreisel.bodies.binary import G
from kreisel.errors import InputError, doubt, explained, shown
from kreisel.physical.body import Varied
from kreisel.physical.measures import (
    attitude_quaternion,
    convert_fields,
    finite_floats,
    in_range,
    inertia_tensor,
    principal,
    require_thickness,
    si_number,
    si_numbers,
)
from kreisel.physical.orbit import ASTRONOMICAL_UNIT, SUN, Orbit, Primary
from kreisel.physical.shapes import solid
from kreisel.record.model import Model, State
from kreisel.runs.geometry import orbit_frame, require_of_body, tait_bryan
from kreisel.runs.in_si import in_state_form

if TYPE_CHECKING:
    import xarray as xr

ELEMENTS = ("semi_major_axis", "eccentricity", "inclination", "node", "perigee", "mean_anomaly")
formulas = cast("Any", formulas_of_pairs)  # of a page, without types
expansion = cast("Any", satellite)  # of a page, without types
WEIGHTS = {l: [(2 - (m == 0)) * math.factorial(l - m) / math.factorial(l + m) for m in range(l + 1)] for l in (3, 4)}  # noqa: E741
DENSEST = 22_600.0  # kg/m^3, osmium
CONTACT, TINY = 1e-6, 1e-150  # relative, of bodies that an event stopped there; m, instead of a size of 0
VALUES = 1 << 20  # of a distance, at once: an archive may be longer than memory
NODES = 4  # of Gauss's rules: exact for polynomials of degree 7


@explained
@dataclass(frozen=True, eq=False)
class GravityBody:
    """A rigid body of a `Binary`: mass, inertia integrals up to the fourth degree, tides.

    mass      kg
    inertia   classical inertia tensor about the centre of mass, (3, 3) in principal axes, or its diagonal, kg m^2
    degree_3  (7,), mass times R^3 (C_30, C_31, S_31, ... S_33) of its gravity field, not normalized, kg m^3
    degree_4  (9,), mass times R^4 (C_40, C_41, S_41, ... S_44), kg m^4
    size      the largest distance of its surface from the centre of mass, m
    love      its Love number k_2 for a sphere of that size; 0 for no tides
    lag       the time by which its tides lag, s: 1/(Q n) for a dissipation factor Q of tides of the frequency n

    `ellipsoid`, `mesh` and `points` compute the integrals.  Raises `InputError` for values that no body has.
    """

    mass: float
    inertia: Any
    degree_3: Any = (0.0,) * 7
    degree_4: Any = (0.0,) * 9
    size: float = 0.0
    love: float = 0.0
    lag: float = 0.0

    def __post_init__(self) -> None:
        convert_fields(self, positive=True, mass="kg")
        convert_fields(self, least=0.0, size="m", love="1", lag="s")
        object.__setattr__(self, "inertia", diagonal_inertia(self.inertia))
        convert_fields(self, shapes=((7,),), degree_3="kg m^3")
        convert_fields(self, shapes=((9,),), degree_4="kg m^4")
        if self.love and not self.size:
            raise InputError("love: expected size=... too, the radius of the body that tides deform, got none.")
        if self.lag and not self.love:
            raise InputError("lag: expected love=... too, the Love number k_2 of the tides that lag, got none.")

    @classmethod
    def ellipsoid(cls, mass: Any, diameters: Any, love: Any = 0.0, lag: Any = 0.0) -> GravityBody:
        """The homogeneous ellipsoid with these principal diameters, m, the body axes along them.

        Warns with `InputWarning` if it is denser than any element.
        """
        halves = si_numbers(diameters, "m", "diameters", ((3,),)) / 2
        if not (halves > 0).all():
            raise InputError(f"diameters: expected three values > 0, got {shown(diameters)}.")
        density = si_number(mass, "kg", "mass", positive=True) / (4 / 3 * math.pi * halves.prod())
        if density > DENSEST:
            doubt(f"diameters: expected at most {DENSEST:g} kg/m^3, got {density:.3g}. Usual cause: km for m.")
        directions, weights = _sphere()
        radii, of_radii = np.polynomial.legendre.leggauss(NODES)
        radii, of_radii = (radii + 1) / 2, of_radii / 2 * 3 * ((radii + 1) / 2) ** 2
        points = radii[:, None, None] * directions * halves
        masses = si_number(mass, "kg", "mass", positive=True) * of_radii[:, None] * weights
        return cls._of(points.reshape(-1, 3), masses.ravel(), float(halves.max()), love, lag)

    @classmethod
    def mesh(
        cls,
        mesh: str | os.PathLike[str],
        length: Any = None,
        density: Any = None,
        mass: Any = None,
        love: Any = 0.0,
        lag: Any = 0.0,
    ) -> GravityBody:
        """The homogeneous body whose closed surface is in a mesh file, as `read_mesh` has it, in its principal axes."""
        measures, triangles = solid(mesh, length, density, mass)
        centred = triangles - measures.center_of_mass
        nodes, weights = _tetrahedron()
        volumes = np.linalg.det(centred) / 6
        points = nodes @ centred
        masses = weights * (measures.mass / volumes.sum() * volumes)[:, None]
        size = float(np.sqrt((centred**2).sum(-1).max()))
        return cls._of(points.reshape(-1, 3), masses.ravel(), size, love, lag)

    @classmethod
    def points(cls, masses: Any, positions: Any, love: Any = 0.0, lag: Any = 0.0) -> GravityBody:
        """The body of point masses (k,), kg, at positions (k, 3), m, such as grains, in principal axes."""
        m, x = finite_floats(masses, "kg", "masses"), finite_floats(positions, "m", "positions")
        if m.ndim != 1 or x.shape != (len(m), 3) or not (m > 0).all():
            raise InputError(
                f"points: expected masses (k,) > 0 and positions (k, 3), got shapes {m.shape} and {x.shape}."
            )
        x = x - m @ x / m.sum()
        return cls._of(x, m, float(np.sqrt((x**2).sum(-1).max())), love, lag)

    @classmethod
    def _of(cls, x: Array, m: Array, size: float, love: Any, lag: Any) -> GravityBody:
        """The body with the integrals of masses m at x about their centre, along the principal axes."""
        second = np.einsum("k,ki,kj->ij", m, x, x)
        if abs(second - np.diag(np.diag(second))).max() < 1e-13 * abs(second).max():
            second = np.diag(np.diag(second))
        moments, axes = principal(in_range("The inertia", lambda: np.trace(second) * np.eye(3) - second))
        third, fourth = in_range("The inertia integrals", lambda: tuple(_field(x @ axes, m, k) for k in (3, 4)))
        return cls(float(m.sum()), moments, third, fourth, size, love, lag)


def diagonal_inertia(inertia: Any) -> Array:
    """The diagonal of an inertia tensor in principal axes, kg m^2, (3,).  Raises `InputError`."""
    tensor = inertia_tensor(inertia)
    if (tensor - np.diag(np.diag(tensor))).any():
        raise InputError(
            f"inertia: expected a diagonal tensor, along the principal axes, got {tensor.tolist()}. Rotate the "
            "body to them, or use GravityBody.points or GravityBody.mesh, which do so."
        )
    require_thickness(tensor)
    return np.diag(tensor).copy()


def _field(x: Array, m: Array, degree: int) -> Array:
    """m R^l (C_l0, C_l1, S_l1, ...) of point masses: sums of the solid harmonics."""
    distance = np.sqrt((x**2).sum(-1)) + 1e-300
    basis = expansion.harmonics_3 if degree == 3 else expansion.harmonics_4
    sums = (basis((x / distance[:, None]).T) * distance**degree) @ m
    orders = np.repeat(range(degree + 1), [1] + [2] * degree)
    sums[abs(sums) < 1e-14 * (m @ distance**degree)] = 0  # rounding of symmetric bodies
    return np.asarray(sums * np.array(WEIGHTS[degree])[orders])


def _sphere() -> tuple[Array, Array]:
    """Directions and weights whose sums are means over the sphere, up to degree 5."""
    z, of_z = np.polynomial.legendre.leggauss(NODES)
    angles = 2 * np.pi * np.arange(6) / 6
    across = np.sqrt(1 - z**2)[:, None]
    directions = np.stack([across * np.cos(angles), across * np.sin(angles), z[:, None] + 0 * angles], -1)
    return directions.reshape(-1, 3), np.repeat(of_z / 2, 6) / 6


def _tetrahedron() -> tuple[Array, Array]:
    """Barycentric nodes of three corners, the fourth at the origin, and weights: means up to degree 4."""
    from scipy.special import roots_jacobi

    rules = []
    for power in range(3):
        x, w = roots_jacobi(NODES, power, 0)
        rules.append(((1 + x) / 2, w / w.sum()))
    (a, of_a), (b, of_b), (c, of_c) = rules[::-1]
    grid = np.meshgrid(a, b, c, indexing="ij")
    left = np.cumprod([np.ones_like(grid[0]), 1 - grid[0], 1 - grid[1]], axis=0)
    nodes = np.moveaxis(left * grid, 0, -1).reshape(-1, 3)
    return nodes, np.einsum("i,j,k->ijk", of_a, of_b, of_c).ravel()


# -- two bodies ------------------------------------------------------------------------------------


@explained
@dataclass(frozen=True, eq=False)
class ThirdBody:
    """A third body of a binary.

    mass, inertia        kg; kg m^2, its classical inertia tensor in principal axes, or the diagonal, None for a point
    position, velocity   relative to the barycentre of the two at t = 0, (3,), m and m/s
    """

    mass: Any
    position: Any
    velocity: Any
    inertia: Any = None

    def __post_init__(self) -> None:
        if self.inertia is not None:
            object.__setattr__(self, "inertia", diagonal_inertia(self.inertia))
        convert_fields(self, positive=True, mass="kg")
        for name, unit in (("position", "m"), ("velocity", "m/s")):
            value = si_numbers(getattr(self, name), unit, f"{name} of the third body", ((3,),))
            object.__setattr__(self, name, value)


@explained
@dataclass(frozen=True, eq=False)
class Binary(Varied):
    """Two rigid bodies of any shape: the full two-body problem, with a third point mass and tides.

        pair = Binary.didymos()
        run = kr.simulate(pair, pair.state(), dt="1 h", t_end="1 year")

    primary, secondary   `GravityBody`s; their tides lag if they have `love` and `lag`
    third                None; an `Orbit` of the barycentre around the Sun or a planet; or a `ThirdBody`: a point or a
                         body that rotates

    start                what `state()` has by default: separation and spin1 of a ready pair

    A run has position and velocity of the secondary relative to the primary, the angular momentum and the attitude of
    each body, all in space, with a third body also its variables.  The mutual potential has all terms of
    the fourth degree in size over distance.  The equations: `kreisel.bodies.binary`.  Raises `InputError`.
    """

    primary: GravityBody
    secondary: GravityBody
    third: Orbit | ThirdBody | None = None
    start: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in ("primary", "secondary"):
            if not isinstance(getattr(self, name), GravityBody):
                raise InputError(
                    f"{name}: expected kr.physical.GravityBody(...), such as GravityBody.ellipsoid(mass, diameters), "
                    f"got {shown(getattr(self, name))}."
                )
        if not isinstance(self.third, Orbit | ThirdBody | None):
            raise InputError(f"third: expected an Orbit around the Sun, a ThirdBody or None, got {shown(self.third)}.")
        if isinstance(self.third, Orbit) and (self.third.J2 or self.third.path is not None):
            raise InputError(
                "third: expected an Orbit on Kepler's ellipse, whose primary acts as a point mass, got one with J2 or "
                "with a table of its path. Give its position and velocity at t = 0: ThirdBody(mu/G, -r, -v)."
            )
        self.model()

    @property
    def mu(self) -> float:
        """G (m1 + m2), m^3/s^2."""
        return G * (self.primary.mass + self.secondary.mass)

    def model(self) -> Model:
        """The system "binary", "binary-with-third-body" or "binary-with-moon", in SI units and principal axes."""
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
        third = self._third_body
        if third.inertia is None:
            return BODIES["binary-with-third-body"](**values, m3=third.mass)
        return BODIES["binary-with-moon"](**values, m3=third.mass, moments3=third.inertia)

    @cached_property
    def _third_body(self) -> ThirdBody:
        """The third body at t = 0."""
        if isinstance(self.third, Orbit):
            position, velocity = self.third.at(0.0)
            return ThirdBody(self.third.primary.mu / G, -np.asarray(position), -np.asarray(velocity))
        return cast("ThirdBody", self.third)

    @property
    def words(self) -> dict[str, str]:
        """The names of the variables of a run in SI, by the letters of the state."""
        names = {"r": "position", "v": "velocity", "R": "third_position", "V": "third_velocity"}
        return names | {f"{k}{i}": f"{word}_{i}" for i in "123" for k, word in (("L", "momentum"), ("q", "attitude"))}

    def state(
        self,
        position: Any = None,
        velocity: Any = None,
        spin1: Any = None,
        spin2: Any = None,
        attitude1: Any = None,
        attitude2: Any = None,
        separation: Any = None,
        unbound: bool = False,
        semi_major_axis: Any = None,
        eccentricity: Any = None,
        inclination: Any = None,
        node: Any = None,
        perigee: Any = None,
        mean_anomaly: Any = None,
        spin3: Any = None,
        attitude3: Any = None,
    ) -> State:
        """The initial state.

        position, velocity     of the secondary relative to the primary, m and m/s, (..., 3)
        spin1, spin2, spin3    angular velocities along the body axes, rad/s, (..., 3); default: the rate of the orbit,
                               of the third body: around the barycentre
        attitude1, ...         unit quaternions (..., 4), body to space; default: the first axis along the line between
                               the bodies, or to the barycentre, the third along the normal of the orbit
        separation             instead of a position the distance in a circular orbit in the plane of the first two
                               axes, m
        unbound                whether the orbit may be a flyby
        semi_major_axis, ...   instead of a position the osculating mutual orbit, in words of `Orbit`

        Ready pairs have values for all of these.  Raises `InputError` for bodies that touch at the pericentre, and for
        orbits that are not bound.
        """
        values = semi_major_axis, eccentricity, inclination, node, perigee, mean_anomaly
        elements = {name: value for name, value in zip(ELEMENTS, values, strict=True) if value is not None}
        if position is None and separation is None and not elements:
            separation = self.start.get("separation")
        spin1 = self.start.get("spin1") if spin1 is None else spin1
        if spin3 is None and attitude3 is None:
            spin3, attitude3 = self.start.get("spin3"), self.start.get("attitude3")
        ways = (position is not None) + (separation is not None) + bool(elements)
        if (position is None) != (velocity is None) or ways != 1:
            raise InputError(
                "state: expected position and velocity, or separation=..., or elements such as semi_major_axis=..., "
                "got none or several of these."
            )
        if elements:
            position, velocity = Orbit(**elements, primary=Primary("binary", self.mu, 0.0)).at(0.0)
        if separation is not None:
            position, velocity = self._circular(si_number(separation, "m", "separation", positive=True))
        r, v = si_numbers(position, "m", "position"), si_numbers(velocity, "m/s", "velocity")
        if not r.size or r.shape != v.shape:
            raise InputError(f"state: expected as many positions as velocities, got shapes {r.shape} and {v.shape}.")
        self._require_apart(r, v, unbound)
        parts = {"r": r, "v": v}
        parts |= _rotation(1, self.primary.inertia, spin1, attitude1, r, v)
        parts |= _rotation(2, self.secondary.inertia, spin2, attitude2, r, v)
        if self.third is not None:
            R, V, inertia = self._third_body.position, self._third_body.velocity, self._third_body.inertia
            total = self.primary.mass + self.secondary.mass
            for body, share in ((self.primary, -self.secondary.mass), (self.secondary, self.primary.mass)):
                distance = np.linalg.norm(R - share / total * r, axis=-1).min()
                if distance <= body.size:
                    raise InputError(
                        f"third: expected a body apart from both, got one {distance:g} m from the centre of one of "
                        f"{body.size:g} m. Usual cause: a position relative to the primary for one to the barycentre, "
                        "or km for m."
                    )
            parts |= {"R": R / formulas.FAR, "V": V}
            parts |= {} if inertia is None else _rotation(3, inertia, spin3, attitude3, R, V)
        if not (spin3 is attitude3 is None or "L3" in parts):
            raise InputError("state: expected spin3 and attitude3 for a third body with inertia, got one without.")
        batch = np.broadcast_shapes(*(x.shape[:-1] for x in parts.values()))
        return self.model().state(**{k: np.broadcast_to(x, (*batch, x.shape[-1])) for k, x in parts.items()})

    def _circular(self, distance: float) -> tuple[Array, Array]:
        """Position and velocity with which both bodies in their default attitudes stay at this distance."""
        r, constants = np.array([distance, 0.0, 0.0]), self.model().constants
        upright = np.array([1.0, 0.0, 0.0, 0.0])
        values = {name: constants[name] for name in formulas.LOADED}
        _, (slope,) = value_and_gradient(lambda x: formulas.potential(x, upright, upright, **values), [(r, 1)])
        inward = self.mu / distance**2 + slope[0] / float(constants["reduced"])
        return r, np.array([0.0, math.sqrt(max(inward * distance, 0.0)), 0.0])

    def _require_apart(self, r: Array, v: Array, unbound: bool) -> None:
        """Raises `InputError` for orbits that the expansion or the caller excludes."""
        distance, square = np.linalg.norm(r, axis=-1), (v * v).sum(-1)
        energy = square / 2 - self.mu / distance
        momentum = (np.cross(r, v) ** 2).sum(-1) / self.mu
        e = np.sqrt(np.maximum(1 + 2 * energy * momentum / self.mu, 0))
        leaves = unbound & (energy >= 0) & ((r * v).sum(-1) > 0)
        least = np.min(np.where(leaves, distance, momentum / (1 + e)))
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

    @staticmethod
    def _doubts_of(bodies: Sequence[Any], run: Any) -> Sequence[str]:
        sizes = np.array([[pair.primary.size, pair.secondary.size] for pair in bodies]).T + TINY
        share = np.array([[pair.secondary.mass / (pair.primary.mass + pair.secondary.mass)] for pair in bodies])
        gaps: list[float] = []
        for first in range(0, run.sizes["time"], count := max(1, VALUES // run.sizes.get("lane", 1))):
            rows = run.isel(time=slice(first, first + count))
            r = rows["position"].values
            gaps.append((np.linalg.norm(r, axis=-1) / sizes.sum(0)).min())
            if "third_position" in run:
                places = rows["third_position"].values + np.stack([share * r, (share - 1) * r])
                gaps += [(np.linalg.norm(x, axis=-1) / size).min() for x, size in zip(places, sizes, strict=True)]
        if not (least := min(gaps)) < 1 - CONTACT:
            return ()
        return (
            f"expected bodies apart, got rows at {least:.3g} of the distance at which they touch; the motion then "
            "has no meaning. Usual cause: a third body or an event. Stop the run at the contact by an event.",
        )

    # -- ready pairs ---------------------------------------------------------------------------------------

    @classmethod
    def didymos(
        cls, sun: bool = False, diameters: Any = (177.0, 174.0, 116.0), love: Any = 0.0, lag: Any = 0.0
    ) -> Binary:
        """(65803) Didymos and Dimorphos before the impact; `sun`: with the Sun, on the orbit around it.

        diameters   of Dimorphos, m, of 4.3e9 kg;  love and lag: of the tides of both bodies
        Sizes, masses of equal density, 1206 m, 2.26 h [Daly et al. 2023]; the period is 11.9215 h [Scheirich, Pravec
        2024].  The third axis of space is the pole of the mutual orbit, at 169 degrees to the heliocentric orbit.
        """
        orbit = Orbit(1.6443 * ASTRONOMICAL_UNIT, 0.3839, math.radians(169.0), primary=SUN) if sun else None
        first = GravityBody.ellipsoid(5.6e11 - 4.3e9, (849.0, 851.0, 620.0), love, lag)
        return cls(first, GravityBody.ellipsoid(4.3e9, diameters, love, lag), orbit, _spinning(1206.0, 2.26))

    @classmethod
    def moshup(cls) -> Binary:
        """(66391) 1999 KW4, Moshup and Squannit: 2548 m, 17.42 h, the first rotates in 2.7645 h [Ostro et al. 2006].

        The ellipsoids have the volumes and the ratios of moments of the shapes, whose extents are up to 14 % larger.
        """
        first = GravityBody.ellipsoid(2.353e12, (1417.0, 1361.0, 1183.0))
        second = GravityBody.ellipsoid(0.135e12, (595.0, 450.0, 343.0))
        return cls(first, second, start=_spinning(2548.0, 2.7645))

    @classmethod
    def patroclus(cls) -> Binary:
        """(617) Patroclus and Menoetius, of equal density and both synchronous.

        G m = 0.0950 km^3/s^2, 692.5 km, 4.282753 days [Brozovic et al. 2024]; diameters [Buie et al. 2015]
        """
        diameters, mass = ((127e3, 117e3, 98e3), (117e3, 108e3, 90e3)), 0.0950e9 / G
        share = math.prod(diameters[1]) / (math.prod(diameters[0]) + math.prod(diameters[1]))
        first, second = (GravityBody.ellipsoid(m * mass, d) for m, d in zip((1 - share, share), diameters, strict=True))
        return cls(first, second, start=_spinning(692.5e3))

    @classmethod
    def pluto(cls) -> Binary:
        """Pluto and Charon, balls, both synchronous: 19596 km, 6.3872 days.

        G m = 869.3 and 106.1 km^3/s^2 [Brozovic, Jacobson 2024], radii 1188.3 and 606.0 km [Nimmo et al. 2017]
        """
        masses, radii = (869.3e9 / G, 106.1e9 / G), (1188.3e3, 606.0e3)
        first, second = (GravityBody.ellipsoid(m, (2 * R,) * 3) for m, R in zip(masses, radii, strict=True))
        return cls(first, second, start=_spinning(19_596e3))

    @classmethod
    def nix(cls) -> Binary:
        """Pluto and Charon with their moon Nix, an ellipsoid, which by default rotates as in 2015.

        G m = 1.50e-3 km^3/s^2 [Brozovic, Jacobson 2024]; axes of 50, 35 and 33 km, rotation in 1.829 days at an
        obliquity of 132 degrees [Weaver et al. 2016].  A nearly circular orbit, of 48 694 km and 24.8546 days on
        average [Showalter, Hamilton 2015], begins farther out and slower in line with Charon.
        """
        pair, mass, (a, b, c) = cls.pluto(), 1.50e6 / G, (25e3, 17.5e3, 16.5e3)
        inertia = mass / 5 * np.array([b * b + c * c, a * a + c * c, a * a + b * b])
        third = ThirdBody(mass, (48_836e3, 0.0, 0.0), (0.0, 141.10, 0.0), inertia)
        tilt = math.radians(132.0) / 2
        spin = {
            "spin3": (0.0, 0.0, 2 * math.pi / (1.829 * 86_400)),
            "attitude3": (math.cos(tilt), math.sin(tilt), 0, 0),
        }
        return cls(pair.primary, pair.secondary, third, {**pair.start, **spin})

    # -- what a run shows ----------------------------------------------------------------------------------

    def spins(self, run: xr.Dataset) -> tuple[Array, ...]:
        """Angular velocities of the bodies along their axes, rad/s, (..., 3), at each row of a run."""
        run, moments = _of_binary(run), {k: v for k, v in self.model().params.items() if k.startswith("moments")}
        require_of_body(run, moments)
        return tuple(
            algebra.act(algebra.rotation_matrix(run[f"q{i}"].values).mT, run[f"L{i}"].values) / moments[f"moments{i}"]
            for i in "123"
            if f"L{i}" in run
        )

    def angles(self, run: xr.Dataset, body: int = 2) -> tuple[Array, Array, Array]:
        """Roll, pitch and yaw of a body relative to the orbit, rad, at each row: rotations R_z R_y R_x of its axes.

        The frame has its first axis along the line between the bodies, or from the barycentre to the third body, and
        its third axis along the normal of the orbit.
        """
        run = _of_binary(run)
        if body not in (1, 2, 3) or f"q{body}" not in run:
            raise InputError(
                f"body: expected 1, the primary, 2, the secondary, or 3, a third body with inertia, got {shown(body)}."
            )
        frame = orbit_frame(*(run[letter].values for letter in ("RV" if body == 3 else "rv")))
        yaw, pitch, roll = tait_bryan(frame.mT @ algebra.rotation_matrix(run[f"q{body}"].values))
        return roll, pitch, yaw


def _of_binary(run: Any) -> Any:
    """A run with the letters of the state.  Raises `InputError` for anything but a run of a binary."""
    rows = in_state_form(run)
    if not all(name in getattr(rows, "data_vars", ()) for name in ("r", "v", "L1", "q1", "L2", "q2")):
        raise InputError(f"run: expected a run of a Binary, or rows of it, got {shown(type(run).__name__)} of another.")
    return rows


def _spinning(distance: float, hours: float | None = None) -> dict[str, Any]:
    """A circular orbit of this radius, and the spin of the primary."""
    return {"separation": distance} | ({} if hours is None else {"spin1": (0.0, 0.0, 2 * math.pi / 3600 / hours)})


def _rotation(i: int, inertia: Array, spin: Any, attitude: Any, r: Array, v: Array) -> dict[str, Array]:
    """L and q of body i on an orbit.  Raises `InputError`."""
    normal = np.cross(r, v)
    if attitude is None and not normal.any(-1).all():
        raise InputError(
            f"state: expected attitude{i} for a body that moves along a line, got none: its orbit has no normal."
        )
    q = (
        algebra.unit_quaternion(orbit_frame(r, v))
        if attitude is None
        else attitude_quaternion(attitude, f"attitude{i}")
    )
    rate = np.linalg.norm(normal, axis=-1, keepdims=True) / (r * r).sum(-1, keepdims=True)
    Omega = rate * np.array([0.0, 0.0, 1.0]) if spin is None else si_numbers(spin, "rad/s", f"spin{i}")
    return {f"L{i}": algebra.act(algebra.rotation_matrix(q), inertia * Omega), f"q{i}": q}
