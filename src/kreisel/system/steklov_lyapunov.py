"""Steklov's and Lyapunov's cases of a rigid body in a fluid, in n dimensions.  State (M, P), body frame, both skew.

On so(n) <x so(n); for n = 3 these are cases of Kirchhoff's equations with mixed terms, P and M standing for vectors.
H = s H_S + l H_L is integrable for any s and l (s = 1, l = 0: Steklov; s = 0, l = 1: Lyapunov).  With B = diag(b),

    H_L = (1/2) sum_(i<j) [M_ij^2 + (b_i + b_j) M_ij P_ij + (b_i - b_j)^2 P_ij^2/4],
    H_S = (1/2) sum_(i<j) [(b_i + b_j) M_ij^2 + (b_i^2 + b_j^2) M_ij P_ij + (b_i + b_j)(b_i - b_j)^2 P_ij^2/4].

Plus bracket, F' = {H, F}.  [Steklov 1893; Lyapunov 1893; n dimensions: Bolsinov, Fedorov 1992; named in Suris 2001,
Conclusions.  The Lax pair was found from the requirement of involution; it was not compared with theirs]
"""

from dataclasses import replace

from kreisel.algebra import bracket, identity, mat, pairing, vec
from kreisel.algebra.invariants import diagonal, stack, trace
from kreisel.baecklund.steklov import STEKLOV_LYAPUNOV
from kreisel.record.contract import ADJOINT_PAIR_SPACE, Parameter, System, named


def coefficients(*, b, s, l):
    """The entries of H = (1/2) sum_(i<j) [x_ij M_ij^2 + 2 y_ij M_ij P_ij + z_ij P_ij^2]."""
    plus, minus = b[..., :, None] + b[..., None, :], b[..., :, None] - b[..., None, :]
    squares = (b * b)[..., :, None] + (b * b)[..., None, :]
    s, l = mat(s), mat(l)
    return {"x": s * plus + l, "y": (s * squares + l * plus) / 2, "z": (s * plus + l) * minus * minus / 4}


def velocity(M, P, *, x, y):  # Omega = dH/dM
    return x * M + y * P


def force(M, P, *, y, z):  # dH/dP
    return y * M + z * P


def flow(M, P, *, x, y, z):  # M' = [M, Omega] + [P, dH/dP],   P' = [P, Omega]
    Omega = velocity(M, P, x=x, y=y)
    return bracket(M, Omega) + bracket(P, force(M, P, y=y, z=z)), bracket(P, Omega)


def energy(M, P, *, x, y, z):
    return (pairing(M, velocity(M, P, x=x, y=y)) + pairing(P, force(M, P, y=y, z=z))) / 2


def pencil(M, P, b, lam):  # X = M - (BP + PB)/2 + lambda P
    return M + (lam - (b[..., :, None] + b[..., None, :]) / 2) * P


def constants(*, b, s, l):
    beyond = abs(b).sum(-1, keepdims=True)[..., 0]  # an array of exact values too
    return coefficients(b=b, s=s, l=l) | {"beyond": beyond}


def traces(M, P, *, b, beyond):
    """Tr (X(lambda) (lambda - B)^-1)^k, k = 2, 4, ..., at n values of lambda beyond the sum of all |b|."""
    n, out = M.shape[-1], []
    for j in range(n):
        lam = beyond + (j + 1)
        L = pencil(M, P, b, mat(lam)) / (vec(lam) - b)[..., None, :]
        square, power = L @ L, identity(n)
        for _ in range(2, n + 1, 2):
            power = power @ square
            out.append(trace(power))
    return stack(out)


def lax(M, P, *, b, s, l, x, y, lam):
    """The pair L = X C, U = K C with C = (lambda - B)^-1.

    K = lambda Omega less s (BMB + (B^2 P B + B P B^2)/2) + l BPB.
    """
    C, Bi, Bj = diagonal(1 / (lam - b)), b[..., :, None], b[..., None, :]
    K = lam * velocity(M, P, x=x, y=y) - Bi * Bj * (mat(s) * (M + (Bi + Bj) / 2 * P) + mat(l) * P)
    return pencil(M, P, b, lam) @ C, K @ C


SYSTEM = System(
    name="steklov-lyapunov",
    title="Steklov's and Lyapunov's cases of a body in a fluid",
    equations="M' = [M, Omega] + [P, dH/dP],  P' = [P, Omega],  Omega = dH/dM",
    source="Steklov 1893, Lyapunov 1893, Bolsinov, Fedorov 1992; Suris 2001, Conclusions",
    space=ADJOINT_PAIR_SPACE,
    parameters=(
        Parameter("b", "vector", "diagonal of B", diagonal=True),
        Parameter("s", "scalar", "how much of Steklov's H"),
        Parameter("l", "scalar", "how much of Lyapunov's H"),
    ),
    **named(flow, energy, velocity, lax),
    derive=constants,
    integrals={"traces": traces},
    commuting=("traces",),
    pairs=replace(STEKLOV_LYAPUNOV, between=8),
    notes="No explicit map is known; method='exact' for n = 3 to 5.",
)
