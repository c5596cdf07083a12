"""Rigid bodies by their mass and inertia integrals up to the fourth degree, in SI units."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from typing import Any, cast

import numpy as np

from kreisel.algebra import Array
from kreisel.bodies import satellite
from kreisel.errors import InputError, explained, shown
from kreisel.physical.inertia import inertia_tensor, principal
from kreisel.physical.measures import convert_fields, finite_floats, in_range, si_number, si_numbers
from kreisel.physical.shapes import solid

formulas = cast("Any", satellite)  # of a page, without types
WEIGHTS = {l: [(2 - (m == 0)) * math.factorial(l - m) / math.factorial(l + m) for m in range(l + 1)] for l in (3, 4)}  # noqa: E741
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
    lag       the time by which its tides lag, s: 1/(2 Q n) for a dissipation factor Q at the mean motion n

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

    @classmethod
    def ellipsoid(cls, mass: Any, diameters: Any, love: Any = 0.0, lag: Any = 0.0) -> GravityBody:
        """The homogeneous ellipsoid with these principal diameters, m, the body axes along them."""
        halves = si_numbers(diameters, "m", "diameters", ((3,),)) / 2
        if not (halves > 0).all():
            raise InputError(f"diameters: expected three values > 0, got {shown(diameters)}.")
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
    return np.diag(tensor).copy()


def _field(x: Array, m: Array, degree: int) -> Array:
    """m R^l (C_l0, C_l1, S_l1, ...) of point masses: sums of the solid harmonics."""
    distance = np.sqrt((x**2).sum(-1)) + 1e-300
    basis = formulas.harmonics_3 if degree == 3 else formulas.harmonics_4
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
