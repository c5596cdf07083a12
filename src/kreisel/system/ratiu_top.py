"""Ratiu's Lagrange top, on so(n) <x so(n).  State (M, G), body frame: M, G (..., n, n) skew.

J = diag(a, a, b, ..., b), M = J Omega + Omega J, chi = chi_12 e_1 ^ e_2, H = <M, Omega>/2 + <G, chi>; G turns with the
body.  For n = 3 it is the Lagrange top.  Plus bracket, F' = {H, F}.  [Ratiu, Amer. J. Math. 104 (1982); named in
Suris 2001, Conclusions]
"""

import numpy as np

from kreisel.algebra import bracket, identity, mat, pairing, wedge
from kreisel.algebra.invariants import laurent_spectrum
from kreisel.errors import InputError
from kreisel.record.contract import ADJOINT_SPACE, Parameter, System


def positive(a, letter):
    if np.asarray(a <= 0).any():
        raise InputError(f"{letter} must be positive, since J = diag(a, a, b, ..., b), got {np.asarray(a).tolist()}.")


def planes(*, n, a, b, chi):
    """c_jk = 1/(J_j + J_k) and the matrix X = chi e_1 ^ e_2."""
    one = identity(int(np.asarray(n).flat[0]))
    ends, plane = one[0] + one[1], wedge(one[0], one[1])
    both, none = ends[:, None] * ends, (1 - ends)[:, None] * (1 - ends)
    mixed = 1 - both - none
    c = both * mat(1 / (2 * a)) + none * mat(1 / (2 * b)) + mixed * mat(1 / (a + b))
    return {"c": (1 - one) * c, "X": mat(chi) * plane, "C": mat((a + b) * chi) * plane}


def inverse_inertia(M, *, c):
    return c * M


def velocity(M, G, *, c):
    return inverse_inertia(M, c=c)


def flow(M, G, *, c, X):  # M' = [M, Omega] + [G, chi],   G' = [G, Omega]
    Omega = inverse_inertia(M, c=c)
    return bracket(M, Omega) + bracket(G, X), bracket(G, Omega)


def energy(M, G, *, c, X):
    return pairing(M, inverse_inertia(M, c=c)) / 2 + pairing(G, X)


def spectrum(M, G, *, C):  # coefficients of det(L(lambda) - mu)
    return laurent_spectrum(M, C, G, odd=False, step=1)


def noether(M, G):  # the block M_ij, i, j >= 3
    ends = np.diag([0, 0] + [1] * (M.shape[-1] - 2))
    return ends @ M @ ends


def lax(M, G, *, c, X, C, lam):  # L = lambda^2 C + lambda M + G with C = (a + b) chi,   U = lambda chi + Omega
    return lam * lam * C + lam * M + G, lam * X + inverse_inertia(M, c=c)


SYSTEM = System(
    name="ratiu-top",
    title="Ratiu's Lagrange top",
    equations="M' = [M, Omega] + [G, chi],  G' = [G, Omega],  M = J Omega + Omega J,  J = diag(a, a, b, ..., b)",
    source="Ratiu 1982; Suris 2001, Conclusions",
    space=ADJOINT_SPACE,
    parameters=(
        Parameter("n", "dimension", "the dimension of the space"),
        Parameter("a", "scalar", "J_1 = J_2, positive", positive, positive=True),
        Parameter("b", "scalar", "J_3 = ... = J_n, positive", positive, positive=True),
        Parameter("chi", "scalar", "chi_12, the strength of the field"),
    ),
    flow=flow,
    energy=energy,
    velocity=velocity,
    inverse_inertia=inverse_inertia,
    derive=planes,
    scaling="Any consistent units: <G, chi> is the potential energy.",
    integrals={"spectrum": spectrum, "noether": noether},
    commuting=("spectrum",),
    lax=lax,
    notes="The block M_ij, i, j >= 3, is conserved too. An integrable discretization for n >= 5 is not known: open.",
)
