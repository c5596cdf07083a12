"""Kovalevskaya gyrostat in two fields, in n dimensions.  State (M, P, Q), body frame.

M (..., n, n) skew, P and Q (..., n): two constant fields in the body frame.  With M_11 the upper left 2 x 2 block,
H = <M, M>/2 + <M_11, M_11>/2 - gamma M_12 + P_1 + Q_2.  Q = 0 is Kovalevskaya's top in the field P; for n = 3 it has
the moments of inertia (1, 1, 1/2).  Plus bracket, F' = {H, F}.  [Reyman, Semenov-Tian-Shansky 1987; Bobenko, Reyman,
Semenov-Tian-Shansky, Comm. Math. Phys. 122 (1989); named in Suris 2001, Introduction]
"""

import numpy as np

from kreisel.algebra import act, identity, mat, pairing, wedge
from kreisel.algebra.invariants import laurent_spectrum
from kreisel.record.contract import TWO_FIELDS_SPACE, Parameter, System


def shape(*, n):
    """e = e_1, h = e_2, and c_jk = 1, but 2 in their plane."""
    lanes = (0 * np.asarray(n)).astype(np.int8)
    one = identity(int(np.asarray(n).flat[0])) + mat(lanes)
    corner = 1 * (np.arange(one.shape[-1]) < 2)
    return {"c": 1 + one * 0 + corner[:, None] * corner, "e": one[..., 0], "h": one[..., 1]}


def velocity(M, P, Q, *, gamma, c, e, h):  # Omega = dH/dM
    return c * M - mat(gamma) * wedge(e, h)


def torque(P, Q, e, h):  # E F^T - F E^T
    return wedge(e, P) + wedge(h, Q)


def flow(M, P, Q, *, gamma, c, e, h):  # M' = [M, Omega] + E F^T - F E^T,   F' = -Omega F
    Omega = velocity(M, P, Q, gamma=gamma, c=c, e=e, h=h)
    return M @ Omega - Omega @ M + torque(P, Q, e, h), -act(Omega, P), -act(Omega, Q)


def energy(M, P, Q, *, gamma, c):
    return pairing(M, c * M) / 2 - gamma * M[..., 0, 1] + P[..., 0] + Q[..., 1]


def bordered(X, F, Y):
    """[[X, F], [-F^T, Y]] of size n + 2."""
    return np.concatenate([np.concatenate([X, F], -1), np.concatenate([-F.mT, Y], -1)], -2)


def pieces(M, P, Q, *, gamma):
    """The coefficients of lambda, 1 and 1/lambda of the Lax matrix."""
    n = M.shape[-1]
    F, small = np.stack([P, Q], -1), (mat(gamma) * wedge(identity(n)[0], identity(n)[1]) - M)[..., :2, :2]
    zero = 0 * small
    return bordered(0 * M, identity(n)[:, :2] + 0 * F, zero), bordered(M, 0 * F, small), bordered(0 * M, F, zero)


def spectrum(M, P, Q, *, gamma):  # coefficients of det(L(lambda) - mu)
    A, middle, F = pieces(M, P, Q, gamma=gamma)
    return laurent_spectrum(middle, A, F, odd=False)


def noether(M, P, Q):  # M_22, for the turns of the other directions
    ends = np.diag([0, 0] + [1] * (M.shape[-1] - 2))
    return ends @ M @ ends


def lax(M, P, Q, *, gamma, c, e, h, lam):
    """L = [[M, v], [-v^T, Gamma - M_11]], v = lambda E + F/lambda, and U = [[Omega, lambda E], [-lambda E^T, 0]]."""
    A, middle, F = pieces(M, P, Q, gamma=gamma)
    turning = bordered(velocity(M, P, Q, gamma=gamma, c=c, e=e, h=h), 0 * M[..., :, :2], 0 * M[..., :2, :2])
    return lam * A + middle + F / lam, lam * A + turning


SYSTEM = System(
    name="kovalevskaya-gyrostat",
    title="Kovalevskaya gyrostat in two fields",
    equations="M' = [M, Omega] + e_1 ^ P + e_2 ^ Q,  P' = -Omega P,  Q' = -Omega Q",
    source="Reyman, Semenov-Tian-Shansky 1987; Suris 2001, Introduction",
    space=TWO_FIELDS_SPACE,
    parameters=(
        Parameter("n", "dimension", "the dimension of the space"),
        Parameter("gamma", "scalar", "the momentum of the rotor, in the plane of e_1 and e_2"),
    ),
    flow=flow,
    energy=energy,
    velocity=velocity,
    derive=shape,
    scaling="The moments of inertia of all planes are 1, that of the plane (1, 2) is 1/2.",
    integrals={"spectrum": spectrum, "noether": noether},
    commuting=("spectrum",),
    lax=lax,
    notes="No integrable discretization is known: open. Q = 0 is the gyrostat in one field.",
)
