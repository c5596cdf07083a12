"""Heavy top, moving frame, any mass tensor.  State (M, P) in e(n)*: M (..., n, n) skew, P (..., n).

M is the angular momentum and P = g^T p the gravity vector in the body frame.  J is the mass tensor
sum m x x^T, symmetric, diagonal or not; A points from the fixed point to the centre of mass.
Plus bracket, F' = {H, F}.  Not integrable in general.  [Suris 2001, section 4]
"""

import numpy as np

from kreisel.algebra import act, coordinates, dot, identity, is_known_zero, pairing, skew, solve, wedge
from kreisel.record.contract import MOVING_SPACE, Parameter, System, named
from kreisel.record.values import check_mass_tensor


def principal(*, J):
    """W, the inverse of Omega -> J Omega + Omega J on the entries j < k, or R and c; the rest is 0.

    W is large for n > 3.  There floats have R and c with J = R diag(d) R^T and c_jk = 1/(d_j + d_k) off the diagonal;
    principal axes have no derivative where two moments are equal, and are not rational: JAX and exact values use W.
    """
    n = J.shape[-1]
    unit, zero = identity(n), 0 * J
    diagonal = is_known_zero(J * (1 - unit))
    if n > 3 and (diagonal or (isinstance(J, np.ndarray) and J.dtype.kind == "f")):
        d, R = (np.diagonal(J, axis1=-2, axis2=-1), unit + zero) if diagonal else np.linalg.eigh(J)
        pairs = d[..., :, None] + d[..., None, :]
        return {"R": R, "c": (1 - unit) / (pairs * (1 - unit) + unit), "W": zero}
    planes, J = skew(identity(n * (n - 1) // 2), n), J[..., None, :, :]
    return {"R": zero, "c": zero, "W": solve(coordinates(J @ planes + planes @ J), identity(len(planes)))}


def inverse_inertia(M, *, R, c, W):  # Omega, where M = J Omega + Omega J
    n = M.shape[-1]
    if W.shape[-1] == n > 3:
        return R @ (c * (R.mT @ M @ R)) @ R.mT
    return skew(act(W, coordinates(M)), n)


def flow(M, P, *, A, R, c, W):  # M' = [M, Omega] + A ^ P,   P' = -Omega P
    Omega = inverse_inertia(M, R=R, c=c, W=W)
    return M @ Omega - Omega @ M + wedge(A, P), -act(Omega, P)


def energy(M, P, *, A, R, c, W, eps=0):
    return pairing(M, inverse_inertia(M, R=R, c=c, W=W)) / 2 + dot(P, A)


SYSTEM = System(
    name="heavy-top",
    title="Heavy top, moving frame",
    equations="M' = [M, Omega] + A ^ P,  P' = -Omega P,  M = J Omega + Omega J",
    source="Suris 2001, section 4",
    space=MOVING_SPACE,
    parameters=(
        Parameter(
            "J",
            "symmetric",
            "mass tensor sum m x x^T (n = 3: J = tr(I)/2 - I from the classical inertia tensor I)",
            check_mass_tensor,
        ),
        Parameter("A", "vector", "from the fixed point to the centre of mass, in the body", fixed="body"),
    ),
    **named(flow, energy, inverse_inertia),
    derive=principal,
    scaling="Any consistent units: <P, A> is the potential energy, so |A| |P| = M g l.",
    notes="Not integrable for general J and A: no map conserves more than the energy and the Casimirs.",
)
