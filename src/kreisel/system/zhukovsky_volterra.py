"""Zhukovsky-Volterra's gyrostat, n = 3: a free body with a wheel.  State M in so(3)*: M (..., 3, 3) skew, body frame.

M is the momentum of body and wheel together and h the constant momentum of the wheel relative to the body, along the
body axes.  With axial vectors and the principal moments I_i of the body, the wheel at rest in it,

    M' = M x Omega,   Omega_i = (M_i - h_i)/I_i,   H = sum (M_i - h_i)^2/(2 I_i).

A wheel that rotates freely has its momentum in space along its axis in h, and is without moment about that axis in I_i.
H and the Casimir |M|^2 are complete.  Plus bracket, F' = {H, F}.  The Lax pair, with S = lambda - diag(1/I_i), is

    L = S (lambda M - Omega),   U = S M,   -tr L^2/2 = det S sum (lambda M_i - Omega_i)^2/S_i.

[Zhukovsky 1885; Volterra, Acta Mathematica 22 (1899)]
"""

from kreisel.algebra import SECOND, THIRD, axial, dot, hat, identity
from kreisel.algebra.invariants import diagonal
from kreisel.record.contract import FREE_SPACE, ClosedForm, Parameter, System, named
from kreisel.record.values import check_positive_diagonal


def inverse_moments(*, J):
    """The 1/I_i, where I_i = J_j + J_k."""
    return {"w": 1 / (J[..., SECOND] + J[..., THIRD])}


def velocity(M, *, h, w):  # Omega_i = (M_i - h_i)/I_i
    return hat(w * (axial(M) - h))


def flow(M, *, h, w):  # M' = M x Omega
    Omega = velocity(M, h=h, w=w)
    return (M @ Omega - Omega @ M,)


def energy(M, *, h, w):
    u = axial(M) - h
    return dot(u, w * u) / 2


def gyrostat(*, J, h):  # w and b of M' = M x (w M - b)
    w = inverse_moments(J=J)["w"]
    return w, w * h


def lax(M, *, h, w, lam):  # L = S (lambda M - Omega),   U = S M,   S = lambda - diag(1/I_i)
    S = lam * identity(3) - diagonal(w)
    return S @ (lam * M - velocity(M, h=h, w=w)), S @ M


SYSTEM = System(
    name="zhukovsky-volterra",
    title="Zhukovsky-Volterra gyrostat",
    equations="M' = [M, Omega],  Omega_i = (M_i - h_i)/I_i",
    source="Zhukovsky 1885, Volterra 1899",
    space=FREE_SPACE,
    parameters=(
        Parameter(
            "J",
            "vector",
            "diagonal of the mass tensor of body and wheel (I_1 = J_2 + J_3, ...)",
            diagonal=True,
            check=check_positive_diagonal,
            positive=True,
        ),
        Parameter("h", "vector", "momentum of the wheel relative to the body"),
    ),
    **named(flow, energy, velocity, lax),
    derive=inverse_moments,
    closed_form=ClosedForm(gyrostat=gyrostat),
    n=3,
    notes="Its flow is known in elliptic functions [Volterra 1899]; method='exact' makes it a quotient of "
    "quadratic forms in M. h = 0 is the Euler top.",
)
