"""Kirchhoff's equations of a rigid body in an ideal fluid.  State (M, P) in e(n)*: M (..., n, n) skew, P (..., n).

M and P are the impulsive moment and force in the body frame.  H = (1/2) sum_(j<k) c_jk M_jk^2 - (1/2) <P, BP>;
for a body in a fluid B = -diag(1/(mass + added mass)).  Plus bracket, F' = {H, F}.  [Suris 2001, section 7]
"""

from kreisel.algebra import act, dot, pairing, wedge
from kreisel.record.contract import MOVING_SPACE, Parameter, System, named
from kreisel.record.values import off_diagonal


def inverse_inertia(M, *, C):  # Omega_jk = c_jk M_jk
    return C * M


def flow(M, P, *, C, B):  # (Kirch)   M' = [M, Omega] + P ^ BP,   P' = -Omega P
    Omega = inverse_inertia(M, C=C)
    return M @ Omega - Omega @ M + wedge(P, act(B, P)), -act(Omega, P)


def translation(M, P, *, B):  # U = dH/dP
    return -act(B, P)


def energy(M, P, *, C, B, eps=0):
    return pairing(M, inverse_inertia(M, C=C)) / 2 - dot(P, act(B, P)) / 2


SYSTEM = System(
    name="kirchhoff",
    title="Kirchhoff's rigid body in an ideal fluid",
    equations="M' = [M, Omega] + P ^ BP,  P' = -Omega P,  Omega_jk = c_jk M_jk",
    source="Suris 2001, section 7, (Kirch)",
    space=MOVING_SPACE,
    parameters=(
        Parameter(
            "C", "symmetric", "inverse moments c_jk, one for each plane (j, k); the diagonal is not used", off_diagonal
        ),
        Parameter("B", "symmetric", "H has -<P, BP>/2: minus the inverse masses; a matrix or its diagonal"),
    ),
    **named(flow, energy, translation, inverse_inertia),
    scaling="Any consistent units. `kreisel.physical.Ellipsoid` gives C and B of an ellipsoid from SI data.",
    notes="Integrable only for special C and B: Clebsch's case is clebsch-general.",
)
