"""Kirchhoff's case of a body of revolution in a fluid, n = 3.  State (M, P) in e(3)*, axial vectors, body frame.

H = (a_1 (M_1^2 + M_2^2) + a_3 M_3^2)/2 + b_1 (M_1 P_1 + M_2 P_2) + b_3 M_3 P_3 + (c_1 (P_1^2 + P_2^2) + c_3 P_3^2)/2;
M_3 is conserved.  Plus bracket, F' = {H, F}.  [Kirchhoff 1870; named in Suris 2001, Introduction]

For b_1 = b_3 the mixed terms are a Casimir.  The flow over t is then that of Clebsch's case with b = (0, 0, b),
b = (c_1 - c_3)/a_1, over a_1 t, followed by the rotation of M and P about the axis by (a_1 - a_3) M_3 t, in the body
frame.

The formulas hold for any diagonal matrices, as in `steklov` and `lyapunov`:
H = (1/2) sum [x_i M_i^2 + 2 y_i M_i P_i + z_i P_i^2];  M' = M x dH/dM + P x dH/dP,  P' = P x dH/dM.
"""

import numpy as np

from kreisel.algebra import axial, cross, dot, hat
from kreisel.record.contract import MOVING_SPACE, Parameter, System, named


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


def twice(first, third):
    return np.stack([first + 0 * third, first + 0 * third, third + 0 * first], -1)


def coefficients(*, a1, a3, b1, b3, c1, c3):
    return {"x": twice(a1, a3), "y": twice(b1, b3), "z": twice(c1, c3)}


def noether(M, P):  # M_3
    return axial(M)[..., 2]


SYSTEM = System(
    name="kirchhoff-case",
    title="Kirchhoff's case of a body of revolution in a fluid",
    equations="M' = M x dH/dM + P x dH/dP,  P' = P x dH/dM",
    source="Kirchhoff 1870",
    space=MOVING_SPACE,
    parameters=tuple(
        Parameter(letter + i, "scalar", f"coefficient of {term} in H")
        for letter, pair, third in (
            ("a", "(M_1^2 + M_2^2)/2", "M_3^2/2"),
            ("b", "M_1 P_1 + M_2 P_2", "M_3 P_3"),
            ("c", "(P_1^2 + P_2^2)/2", "P_3^2/2"),
        )
        for i, term in (("1", pair), ("3", third))
    ),
    **named(flow, energy, velocity, translation),
    derive=coefficients,
    integrals={"noether": noether},
    commuting=("noether",),
    n=3,
    notes="For b1 = b3 the mixed terms are a Casimir; M and P move as in kirchhoff-revolution, which has maps. "
    "For b1 and b3 that differ a Lax pair and an integrable discretization are open. It runs by dop853, or kahan.",
)
