"""Heavy top, moving frame, any mass tensor.  State (M, P) in e(n)*: M (..., n, n) skew, P (..., n).

M is the angular momentum and P = g^T p the gravity vector in the body frame.  J is the mass tensor
sum m x x^T, symmetric, diagonal or not; A points from the fixed point to the centre of mass.
Plus bracket, F' = {H, F}.  Not integrable in general.  [Suris 2001, section 4]
"""

import numpy as np

from kreisel.algebra import act, dot, identity, is_exact, pairing, wedge
from kreisel.errors import InputError
from kreisel.record.checks import check_mass_tensor
from kreisel.record.contract import MOVING_SPACE, Frame, Parameter, System


def principal(*, J):
    """R and c with J = R diag(d) R^T and c_jk = 1/(d_j + d_k) off the diagonal."""
    n = J.shape[-1]
    if all((v == 0) for v in (J * (1 - identity(n))).flat):
        d, R = np.diagonal(J, axis1=-2, axis2=-1), identity(n) + 0 * J
    elif is_exact(J):
        raise InputError("An exact mass tensor J must be diagonal: turn the body frame to principal axes.")
    else:
        d, R = np.linalg.eigh(J)
    pairs = d[..., :, None] + d[..., None, :]
    return {"R": R, "c": (1 - identity(n)) / (pairs + identity(n) * (1 - pairs))}


def inverse_inertia(M, *, R, c):  # Omega, where M = J Omega + Omega J
    return R @ (c * (R.mT @ M @ R)) @ R.mT


def velocity(M, P, *, R, c):
    return inverse_inertia(M, R=R, c=c)


def flow(M, P, *, A, R, c):  # M' = [M, Omega] + A ^ P,   P' = -Omega P
    Omega = inverse_inertia(M, R=R, c=c)
    return M @ Omega - Omega @ M + wedge(A, P), -act(Omega, P)


def energy(M, P, *, A, R, c, eps=0):
    return pairing(M, inverse_inertia(M, R=R, c=c)) / 2 + dot(P, A)


SYSTEM = System(
    name="heavy-top",
    title="Heavy top, moving frame",
    equations="M' = [M, Omega] + A ^ P,  P' = -Omega P,  M = J Omega + Omega J",
    source="Suris 2001, section 4",
    frame=Frame.MOVING,
    space=MOVING_SPACE,
    parameters=(
        Parameter(
            "J",
            "symmetric",
            "mass tensor sum m x x^T (n = 3: J = tr(I)/2 - I from the classical inertia tensor I)",
            check_mass_tensor,
            exact_diagonal=True,
        ),
        Parameter("A", "vector", "from the fixed point to the centre of mass, in the body", fixed="body"),
    ),
    flow=flow,
    energy=energy,
    velocity=velocity,
    inverse_inertia=inverse_inertia,
    derive=principal,
    scaling="Any consistent units: <P, A> is the potential energy, so |A| |P| = M g l.",
    notes="Not integrable for general J and A: no map conserves more than the energy and the Casimirs.",
)
