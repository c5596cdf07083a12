"""Kirchhoff's equations with diagonal matrices and mixed terms, n = 3: what its integrable cases share.

H = (1/2) sum [x_i M_i^2 + 2 y_i M_i P_i + z_i P_i^2] with axial vectors;  M' = M x dH/dM + P x dH/dP,  P' = P x dH/dM.
"""

from kreisel.algebra import axial, cross, dot, hat
from kreisel.record.contract import MOVING_SPACE, Frame, System


def velocity(M, P, *, x, y):  # Omega = dH/dM
    return hat(x * axial(M) + y * P)


def translation(M, P, *, y, z):  # U = dH/dP
    return y * axial(M) + z * P


def flow(M, P, *, x, y, z):
    u, omega = axial(M), x * axial(M) + y * P
    return hat(cross(u, omega) + cross(P, translation(M, P, y=y, z=z))), cross(P, omega)


def energy(M, P, *, x, y, z):
    u = axial(M)
    return (dot(u, x * u + y * P) + dot(P, translation(M, P, y=y, z=z))) / 2


def around(b):
    """(b_2, b_3, b_1) and (b_3, b_1, b_2)."""
    return b[..., [1, 2, 0]], b[..., [2, 0, 1]]


CASE = System(
    name="kirchhoff-case",
    title="Kirchhoff's equations",
    equations="M' = M x dH/dM + P x dH/dP,  P' = P x dH/dM",
    source="Kirchhoff 1870",
    frame=Frame.MOVING,
    space=MOVING_SPACE,
    parameters=(),
    flow=flow,
    energy=energy,
    velocity=velocity,
    translation=translation,
    scaling="Any consistent units.",
    n=3,
    notes="No integrable discretization is known here. H has mixed terms, so that it runs by dop853.",
)
