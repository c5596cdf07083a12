"""Euler top in n dimensions and Moser and Veselov's map.  State M in so(n)*: M (..., n, n) skew, body frame.

M = J Omega + Omega J with J = diag(J_i) > 0, the mass tensor sum m x x^T.  Plus bracket, F' = {H, F}.  The map,

    W J - J W^T = eps M,   M_(k+1) = W^T M W,   g_(k+1) = g_k W,

conserves all integrals of the flow as they are.  With W = cay(X) its equation is 2 (X J + J X) = eps (1 - X) M (1 + X).
[Veselov 1988; Moser, Veselov, Comm. Math. Phys. 139 (1991); named in Suris 2001, Introduction]
"""

from math import inf

import numpy as np

from kreisel import implicit
from kreisel.algebra import cayley, cayley_conjugate, identity, pairing
from kreisel.algebra.invariants import diagonal, metric_spectrum
from kreisel.baecklund.conjugate import MANAKOV, of_body
from kreisel.errors import InputError
from kreisel.record.contract import FREE_SPACE, ClosedForm, Parameter, Relation, System, implicit_map, named
from kreisel.record.values import check_diagonal


def sums(*, J):
    """c_jk = 1/(J_j + J_k) off the diagonal."""
    unit = identity(J.shape[-1])
    pairs = J[..., :, None] + J[..., None, :]
    return {"c": (1 - unit) / (pairs * (1 - unit) + unit)}


def inverse_inertia(M, *, c):  # Omega_jk = M_jk / (J_j + J_k)
    return c * M


def flow(M, *, c):  # M' = [M, Omega]
    Omega = inverse_inertia(M, c=c)
    return (M @ Omega - Omega @ M,)


def energy(M, *, c):
    return pairing(M, inverse_inertia(M, c=c)) / 2


def spectrum(M, *, J):  # coefficients of det(lambda J^2 + M - mu)
    return metric_spectrum(M, diagonal(J * J))


def lax(M, *, J, c, lam):  # L = lambda J^2 + M,   U = lambda J + Omega
    return lam * diagonal(J * J) + M, lam * diagonal(J) + inverse_inertia(M, c=c)


def turn(M, *, J, c, eps, sigma=None):
    """X with W = cay(X), and the square of its estimated error."""
    return implicit.turn_by_quartic(M, J, eps, sigma) if M.shape[-1] == 3 else turn_by_doubling(M, J, c, eps)


def trajectory(M, *, J, eps):
    """Argument of `turn` that is the same for all steps, n = 3: the root of its quartic equation."""
    return implicit.root(M, J, eps)[0]


def turn_by_doubling(M, J, c, eps):
    """For n > 3: X J + J X = (eps/2)(M - [X, M] - X M X)."""
    unit = identity(M.shape[-1]) + 0 * M

    def residual(X):
        XM = X @ M
        return (X * J[..., :, None] + X * J[..., None, :]) - eps / 2 * (M - (XM - XM.mT) - XM @ X)

    return implicit.corrected(implicit.turn(M, J, unit, unit, eps), residual, c)


def move(M, X):
    return (cayley_conjugate(-X, M),)


def involution(M):
    return (-M,)


def lagrangian(g, h, *, J, eps):  # -(1/eps) tr(W J)
    return -(g * h * J[..., None, :]).sum(-1).sum(-1) / eps


def lax_matrix(M, *, J, lam, eps):  # (J W^T + l)(W J - l)
    return diagonal(J * J) + lam * eps * M - lam * lam * identity(M.shape[-1])


def conjugator(M, *, J, c, lam, eps):
    return diagonal(J) + lam * cayley(turn(M, J=J, c=c, eps=eps)[0])


def largest_step(M, *, J, enough=inf):
    if np.asarray(J == 0).any():
        raise InputError(
            "method='veselov' of euler-top: expected J > 0, got a flat body, one J_i = 0: Moser and Veselov's map is "
            "not known for it here. Use method='exact' (n = 3), or 'dop853'."
        )
    return implicit.largest_step(M, J, 0 * M, enough)


MAP = implicit_map(
    turn,
    move,
    **named(involution, lagrangian, conjugator, trajectory, largest_step),
    lax=lax_matrix,
    source="Veselov 1988; Moser, Veselov 1991",
)

SYSTEM = System(
    name="euler-top",
    title="Euler top, moving frame",
    equations="M' = [M, Omega],  M = J Omega + Omega J",
    source="Suris 2001, Introduction; Frahm 1874, Manakov 1976",
    space=FREE_SPACE,
    parameters=(
        Parameter(
            "J",
            "vector",
            "diagonal of the mass tensor (n = 3: I_1 = J_2 + J_3, ...)",
            diagonal=True,
            check=check_diagonal,
            positive=True,
        ),
    ),
    **named(flow, energy, inverse_inertia, lax),
    integrals={"spectrum": spectrum},
    commuting=("spectrum",),
    map=MAP,
    pairs=of_body(MANAKOV),
    closed_form=ClosedForm(moments=lambda *, J: np.stack([J[1] + J[2], J[2] + J[0], J[0] + J[1]])),
    derive=sums,
    relations=(
        Relation("manakov-top", lambda M, g, *, J: ((M,), {"a": J * J, "b": J}), meaning="the metric a = J^2, b = J"),
    ),
    notes="The map commutes with the flow and with itself at other steps. The spectrum is complete for distinct J.",
)
