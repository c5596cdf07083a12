"""Euler top in n dimensions and Moser and Veselov's map.  State M in so(n)*: M (..., n, n) skew, body frame.

M = J Omega + Omega J with J = diag(J_i) > 0, the mass tensor sum m x x^T.  Plus bracket, F' = {H, F}.  The map,

    W J - J W^T = eps M,   M_(k+1) = W^T M W,   g_(k+1) = g_k W,

keeps all integrals of the flow as they are.  With W = cay(X) its equation is 2 (X J + J X) = eps (1 - X) M (1 + X).
[Veselov 1988; Moser, Veselov, Comm. Math. Phys. 139 (1991); named in Suris 2001, Introduction]
"""

import numpy as np

from kreisel.algebra import (
    axial,
    cayley,
    cayley_conjugate,
    cross,
    dot,
    hat,
    identity,
    increment,
    pairing,
    product_error,
    vec,
)
from kreisel.contract import FREE_SPACE, Frame, Map, Parameter, Relation, System
from kreisel.invariants import metric_spectrum
from kreisel.systems import implicit
from kreisel.systems.checks import positive
from kreisel.systems.matrices import diagonal

SCALAR_STEPS, ROOT_STEPS = 4, 12
SECOND, THIRD = np.array([1, 2, 0]), np.array([2, 0, 1])


def sums(*, J):
    """c_jk = 1/(J_j + J_k) off the diagonal."""
    one = identity(J.shape[-1])
    pairs = J[..., :, None] + J[..., None, :]
    return {"c": (1 - one) / (pairs + one * (1 - pairs))}


def inverse_inertia(M, *, c):  # Omega_jk = M_jk / (J_j + J_k)
    return c * M


def velocity(M, *, c):
    return inverse_inertia(M, c=c)


def flow(M, *, c):  # M' = [M, Omega]
    Omega = inverse_inertia(M, c=c)
    return (M @ Omega - Omega @ M,)


def energy(M, *, c):
    return pairing(M, inverse_inertia(M, c=c)) / 2


def spectrum(M, *, J):  # coefficients of det(lambda J^2 + M - mu)
    return metric_spectrum(M, diagonal(J * J))


def lax(M, *, J, c, lam):  # L = lambda J^2 + M,   U = lambda J + Omega
    return lam * diagonal(J * J) + M, lam * diagonal(J) + inverse_inertia(M, c=c)


def turn(M, *, J, c, eps, sigma=None, weight=None, bend=None):
    """X with W = cay(X), and the square of what is left of its error, as estimated."""
    return turn_in_space(M, J, eps, sigma, weight, bend) if M.shape[-1] == 3 else turn_by_doubling(M, J, c, eps)


def trajectory(M, *, J, eps):
    """What `turn` takes beside, once for all steps: for n = 3 the root of its quartic equation."""
    if M.shape[-1] > 3:
        return {}
    moments, m, b = quartic(M, J, eps)
    sigma, slope, curvature, _ = root(moments, m, b, ROOT_STEPS)
    return {"sigma": sigma, "weight": 1 / slope, "bend": curvature / (slope * moments.sum(-1))}


def quartic(M, J, eps):
    """For n = 3 with X = hat(x), h = eps/2, I the moments: (I - sigma) x + h x x mu = h mu, sigma = h <x, mu>.

    Hence x as a function of sigma, and h <x, mu> = sigma says

        0 = p(sigma) = sigma det(I - sigma) - m (m + sigma (2 sigma - tr I)) - b,   m = h^2 |mu|^2,

    b = h^2 sum I_j I_k mu_i^2, whose coefficients are integrals of the map.
    """
    h, u = eps / 2, axial(M)
    moments = J[..., SECOND] + J[..., THIRD]
    square = u * u * vec(h * h)
    return moments, square.sum(-1), dot(moments[..., SECOND] * moments[..., THIRD], square)


def root(moments, m, b, steps):
    """The least root of p, p' and p''/2 beside it, and the square of the last correction over (tr I)^2.

    Halley's method from h^2 sum mu_i^2/I_i, which is below the root: each correction is of the order of the cube of
    that before.  With the step in percent of the longest that has a solution, forty random bodies: after four the
    square of the last correction is below 1e-30 up to 90, 1e-13 at 99.
    """
    total = moments.sum(-1)
    s = b / (moments[..., 0] * moments[..., 1] * moments[..., 2])
    for _ in range(steps):
        d = moments - vec(s)
        minors = d[..., SECOND] * d[..., THIRD]
        second, product = minors.sum(-1), d[..., 0] * minors[..., 0]
        value = s * product - m * (m + s * (2 * s - total)) - b
        slope = product - s * second - m * (4 * s - total)
        curvature = s * d.sum(-1) - second - 2 * m  # p''/2
        change = value * slope / (slope * slope - value * curvature)
        s = s - change
    return s, slope, curvature, change * change / (total * total)


def turn_in_space(M, J, eps, sigma, weight, bend):
    """The turn from the root: found here, or known for the trajectory and corrected once by Newton's method.

    x solves (d + h [., mu]) x = h mu with d = I - sigma; p is sigma (det d + <d, h^2 mu^2>) - m^2 - <minors, h^2 mu^2>.
    The correction follows what rounding does to the integrals; what it leaves is p''/(2 p') of its square.

    An error of d shifts the moments, and does no harm while it stays the same; but x must solve its equation far beyond
    round-off.  So h^2, det d and its minors, which stand still, are taken in two doubles: without, an integral drifted
    by 1.9 times a walk in 2e6 steps of 0.2, by 3 bands of round-off in 1e6 steps of 0.999 of the longest.
    """
    h, u, known = eps / 2, axial(M), sigma is not None
    if not known:
        moments, m, b = quartic(M, J, eps)
        sigma, _, _, last = root(moments, m, b, SCALAR_STEPS)
    d, hh = J[..., SECOND] + J[..., THIRD] - vec(sigma), h * h
    square, minors = u * u * vec(hh) + u * u * vec(product_error(h, h, hh)), d[..., SECOND] * d[..., THIRD]
    first, rest = d[..., 0] * minors[..., 0], product_error(d[..., SECOND], d[..., THIRD], minors)
    small = product_error(d[..., 0], minors[..., 0], first) + d[..., 0] * rest[..., 0]
    if known:
        m = square.sum(-1)
        change = (sigma * (first + dot(d, square)) - (m * m + dot(minors, square))) * weight
        last = bend * (change * change)
        rest = rest + vec(change) * (d[..., SECOND] + d[..., THIRD])  # of d + change
        small = small + change * (minors.sum(-1) + m)
    x = rest * u + vec(h) * cross(d * u, u)
    for k in range(3):  # the smallest first: each sum then has low bits that vary, also where <u, u> stands still
        small, x = small + d[..., k] * square[..., k], x + square[..., k : k + 1] * u
    x = vec(h / (first + small)) * (minors * u + x)
    return hat(x), last * last if known else last * last * last


def turn_by_doubling(M, J, c, eps):
    """For n > 3: X J + J X = (eps/2)(M - [X, M] - X M X)."""
    one = identity(M.shape[-1]) + 0 * M

    def residual(X):
        XM = X @ M
        return (X * J[..., :, None] + X * J[..., None, :]) - increment(eps / 2, M - (XM - XM.mT) - XM @ X)

    return implicit.corrected(implicit.branch(M, J, one, one, eps), residual, c)


def move(M, X):
    return (cayley_conjugate(-X, M),)


def step(M, *, J, c, eps):
    return move(M, turn(M, J=J, c=c, eps=eps)[0])


def inverse(M, *, J, c, eps):
    return step(M, J=J, c=c, eps=-eps)


def involution(M):
    return (-M,)


def generator(M, M1, *, J, c, eps):
    return turn(M, J=J, c=c, eps=eps)[0]


def lagrangian(g, h, *, J, eps):  # -(1/eps) tr(W J)
    return -(g * h * J[..., None, :]).sum(-1).sum(-1) / eps


def lax_matrix(M, *, J, lam, eps):  # (J W^T + l)(W J - l)
    return diagonal(J * J) + lam * eps * M - lam * lam * identity(M.shape[-1])


def conjugator(M, *, J, c, lam, eps):
    return diagonal(J) + lam * cayley(turn(M, J=J, c=c, eps=eps)[0])


def largest_step(M, *, J):
    return implicit.largest_step(M, J, 0 * M)


MAP = Map(
    step=step,
    inverse=inverse,
    adjoint=step,
    involution=involution,
    generator=generator,
    lagrangian=lagrangian,
    lax=lax_matrix,
    conjugator=conjugator,
    turn=turn,
    trajectory=trajectory,
    move=move,
    largest_step=largest_step,
    rational=False,
    commutes=True,
    order=2,
    source="Veselov 1988; Moser, Veselov 1991",
)

SYSTEM = System(
    name="euler-top",
    title="Euler top, moving frame",
    equations="M' = [M, Omega],  M = J Omega + Omega J",
    source="Suris 2001, Introduction; Frahm 1874, Manakov 1976",
    frame=Frame.MOVING,
    space=FREE_SPACE,
    parameters=(
        Parameter(
            "J", "vector", "diagonal of the mass tensor (n = 3: I_1 = J_2 + J_3, ...)", check=positive, positive=True
        ),
    ),
    flow=flow,
    energy=energy,
    velocity=velocity,
    inverse_inertia=inverse_inertia,
    scaling="Any consistent units.",
    integrals={"spectrum": spectrum},
    commuting=("spectrum",),
    lax=lax,
    map=MAP,
    moments=lambda *, J: np.stack([J[1] + J[2], J[2] + J[0], J[0] + J[1]]),
    derive=sums,
    relations=(
        Relation("manakov-top", lambda M, g, *, J: ((M,), {"a": J * J, "b": J}), meaning="the metric a = J^2, b = J"),
    ),
    notes="The map commutes with the flow and with itself at other steps. The spectrum is complete for distinct J.",
)
