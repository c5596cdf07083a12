"""Clebsch's case, the special flow c_jk = 1, and its discretization.  State (M, P) in e(n)*.

M (..., n, n) skew, P (..., n), body frame; B = diag(b).  Plus bracket, F' = {H, F}.
[Suris 2001, section 7; Lagrangian with 2/eps (erratum E1), Lax pair for any |P| (E10)]
"""

import numpy as np

from kreisel.algebra import (
    act,
    cayley_act,
    cayley_plane,
    close_sum,
    complex_number,
    diagonal_resolvent,
    dot,
    dot_less,
    half_turn,
    identity,
    log,
    mat,
    moebius,
    pairing,
    parts,
    project_out,
    quotient,
    remainder,
    shifted_residual,
    skew,
    solve,
    together,
    trace_log,
    vec,
    wedge,
)
from kreisel.contract import MOVING_SPACE, Baecklund, Frame, Map, Parameter, Relation, System
from kreisel.invariants import pencil_spectrum
from kreisel.systems.matrices import border, diagonal


def flow(M, P, *, b):  # (Clebsch spec)   M' = P ^ BP,   P' = -M P
    return wedge(P, b * P), -act(M, P)


def denominator(P, *, b, eps):
    return 1 + eps * eps / 4 * dot(P, b * P)


def kick(P, *, b, eps):  # the change of M in a step
    return eps * wedge(P, b * P) / mat(denominator(P, b=b, eps=eps))


def step(M, P, *, b, eps):  # (dClebsch spec)
    M = M + kick(P, b=b, eps=eps)
    return M, cayley_act(-eps / 2 * M, P)


def inverse(M, P, *, b, eps):
    P = cayley_act(eps / 2 * M, P)
    return M - kick(P, b=b, eps=eps), P


def adjoint(M, P, *, b, eps):
    P = cayley_act(-eps / 2 * M, P)
    return M + kick(P, b=b, eps=eps), P


def involution(M, P, *, b, eps):
    return -(M + kick(P, b=b, eps=eps)), P


def half_kick(M, P, *, b, eps):  # K^(1/2), with the denominator of the whole step
    return M + kick(P, b=b, eps=eps) / 2, P


def half_kick_back(M, P, *, b, eps):
    return M - kick(P, b=b, eps=eps) / 2, P


def shifted(M, P, *, eps):  # Pt
    return P + eps * act(M, P) / 2


def energy(M, P, *, b, eps=0):  # -(1/2) sum b_i F_i
    Pt = shifted(M, P, eps=eps)
    trace = -(M * M * b[..., None, :]).sum(-1).sum(-1)  # tr(M B M)
    return pairing(M, M) / 2 - eps * eps * dot(P, P) * trace / 8 - dot(Pt, b * Pt) / 2


def spectrum(M, P, *, b, eps=0):  # coefficients of det(L(lambda) - mu), up to constants and det S
    return pencil_spectrum(M, diagonal(b), shifted(M, P, eps=eps), eps * eps * dot(P, P) / 4)


def pencil(M, Q, b, lam):
    return lam * diagonal(b) + M + Q[..., :, None] * Q[..., None, :] / lam


def lax(M, P, *, b, lam):  # L' = [L, U+],   U+ = lambda B + M
    return pencil(M, P, b, lam), lam * diagonal(b) + M


def lax_matrix(M, P, *, b, lam, eps):  # S^-1 (lambda B + M + Pt Pt^T / lambda),   S = I + eps^2 |P|^2/4 B
    S = 1 + eps * eps / 4 * vec(dot(P, P)) * b
    return pencil(M, shifted(M, P, eps=eps), b, lam) / S[..., :, None]


def conjugator(M, P, *, b, lam, eps):  # V^-1 = cay(-eps/(2 lambda) Q),   Q = P P^T S / den
    S = 1 + eps * eps / 4 * vec(dot(P, P)) * b
    Q = P[..., :, None] * (P * S)[..., None, :] / mat(denominator(P, b=b, eps=eps))
    return moebius(-eps / (2 * lam) * Q)


def shifted_diagonal(*, b):
    """c = b - max b: the same flow and the same maps, labelled so that they exist for every eps."""
    return {"c": b - b.max(-1, keepdims=True)}


def eigenvector(M, P, *, c, mu, rho):
    """Q, dQ, drho with (mu - rho C + M) Q = P/rho and <P, Q> = 1: (-rho C + M - PP^T/rho + mu) Q = 0.

    dQ and drho are what Q and rho lack, by the residual and by a step of Newton's method for this very state.
    """
    d = vec(mu) - vec(rho) * c
    R = diagonal_resolvent(d, M, P)  # rho Q
    H = diagonal_resolvent(d, M, c * R)
    dR = diagonal_resolvent(d, M, shifted_residual(mu, -M, R, (1, P), (rho, c, R)))
    change = (dot_less(P, R, rho) + dot(P, dR)) / (1 - dot(P, H))
    inverse = 1 / rho
    Q = vec(inverse) * R
    return Q, vec(inverse) * ((dR + remainder(R, rho, Q)) + vec(change) * (H - Q)), change


def curve(M, P, *, c, mu):
    """rho with <P, Q> = rho: the one root with Re rho > 0, since c <= 0; from a pencil, then by Newton's method."""
    alive = dot(P, P) > 0
    rho = _root(M, np.where(vec(alive), P, 1), c, mu).astype(np.result_type(M.dtype, mu))
    for _ in range(4):
        d = vec(mu) - vec(rho) * c
        Q, Y = diagonal_resolvent(d, M, P), diagonal_resolvent(d, -M, P)
        rho = rho - (dot(P, Q) - rho) / (dot(Y, c * Q) - 1)
    return np.where(alive, rho, np.nan)


def _root(M, P, c, mu):
    """kappa = -1/rho are the eigenvalues of -A^-1 diag(c, -1), A = [[M + mu, P], [P^T, 0]]."""
    A = border(M + mat(mu) * identity(M.shape[-1]), P).astype(complex if np.iscomplexobj(mu) else float)
    ends = np.concatenate([np.broadcast_to(c, P.shape), -1 + 0 * P[..., :1]], -1).astype(float)
    kappa = np.linalg.eigvals(np.linalg.solve(A, -ends[..., None] * identity(M.shape[-1] + 1)))
    least = np.take_along_axis(kappa, kappa.real.argmin(-1)[..., None], -1)[..., 0]
    return -1 / (least if np.iscomplexobj(mu) else least.real)


def baecklund_step(M, P, Q, dQ, change, *, c, rho):
    """M += (2 rho/<Q, Q>) Q ^ CQ, and P turns to 2 Q/<Q, Q> - P."""
    s, ds = quotient(2 * rho, 2 * change, dot(Q, Q), 2 * dot(Q, dQ))
    kick, small = wedge(Q, c * Q), wedge(dQ, c * Q) + wedge(Q, c * dQ)
    return close_sum(M, mat(s) * kick, mat(ds) * kick + mat(s) * small), half_turn(Q, dQ, P)


def baecklund_pair(M, P, Q, dQ, change, *, c, rho):
    """M += sum K_ij Q_i ^ CQ_j, K the inverse of <Q_i, Q_j>/(rho_i + rho_j); P turns in the plane of the Q_i."""
    (u, w), (r, i) = parts(Q + dQ), parts(rho + change)
    uu, ww, uw = dot(u, u), dot(w, w), dot(u, w)
    both, squares = uu + ww, 2 * r * r + i * i
    scale = 4 * r / (both * both * i * i + 4 * r * r * (uu * ww - uw * uw))
    kuu = scale * (uu * i * i - 2 * uw * i * r + ww * squares)
    kww = scale * (uu * squares + 2 * uw * i * r + ww * i * i)
    kuw = scale * r * ((uu - ww) * i - 2 * uw * r)
    kick = mat(kuu) * wedge(u, c * u) + mat(kww) * wedge(w, c * w) + mat(kuw) * (wedge(u, c * w) + wedge(w, c * u))
    return M + kick, cayley_plane(vec(-2 * r / (i * both)) * u, w, P)


def arc(M, P, Q):
    return P, Q


def arc_of_pair(M, P, Q, *, rho):
    (u, w), (r, i) = parts(Q), parts(rho)
    uu, ww, uw = dot(u, u), dot(w, w), dot(u, w)
    return u, vec(i * (uu + ww) - 2 * r * uw) * u + vec(2 * r * uu) * w


def darboux(M, P, Q, *, rho, lam):  # N L = L_new N,  N = lambda' - rho (1 - 2 QQ^T/QQ)
    n = M.shape[-1]
    return mat(lam - rho) * identity(n) + mat(2 * rho / dot(Q, Q)) * Q[..., :, None] * Q[..., None, :]


def block(M, P):  # pi M pi,  pi = I - PP^T / |P|^2
    return project_out(M, P) / mat(dot(P, P))


def rational_case(n, draw):
    """b, M, Q and rho at random; then mu rho <Q, Q> = 1 + rho^2 <Q, CQ> and P = rho (mu - rho C + M) Q."""
    b, M, Q, rho = draw((n,)), skew(draw((n * (n - 1) // 2,)), n), draw((n,)), abs(draw((1,)))[0]
    c = shifted_diagonal(b=b)["c"]
    mu = (1 + rho * rho * dot(Q, c * Q)) / (rho * dot(Q, Q))
    return (M, rho * (mu * Q - rho * c * Q + act(M, Q))), {"b": b}, Q, mu, rho


def gaussian_case(n, draw):
    """Q = u + iw, rho and the direction of b at random; then mu and the size of b, P and M from their equations.

    With D = mu - rho C: M skew and (D + M) Q = P/rho, <P, Q> = 1 need <Q, DQ> = 1/rho and <w, Im DQ> = 0.
    """
    b, u, w, (r, i), K = draw((n,)), draw((n,)), draw((n,)), draw((2,)), skew(draw((n * (n - 1) // 2,)), n)
    c, rho = shifted_diagonal(b=b)["c"], complex_number(r, i)
    one = parts(1 / rho)

    def conditions(x, y, t):  # of mu = x + iy, tC: linear
        re, im = (x - t * r * c) * u - (y - t * i * c) * w, (x - t * r * c) * w + (y - t * i * c) * u
        return np.array([dot(u, re) - dot(w, im), dot(u, im) + dot(w, re), dot(w, im)])

    units = np.stack([conditions(*e) for e in identity(3).tolist()], -1)
    x, y, t = solve(units, np.array([[one[0]], [one[1]], [0 * r]]))[:, 0]
    uu, ww, uw = dot(u, u), dot(w, w), dot(u, w)
    size = uu * ww - uw * uw
    u1, w1 = (ww * u - uw * w) / size, (uu * w - uw * u) / size  # dual to u, w
    P = u1 + K[0] - u1 * dot(u, K[0]) - w1 * dot(w, K[0])
    alpha = one[0] * P - ((x - t * r * c) * u - (y - t * i * c) * w)  # M u and M w
    beta = one[1] * P - ((x - t * r * c) * w + (y - t * i * c) * u)
    free = identity(n) - u[:, None] * u1 - w[:, None] * w1
    M = wedge(alpha, u1) + wedge(beta, w1) - dot(beta, u) * wedge(u1, w1) + free.T @ K @ free
    return (M, P), {"b": t * b}, together(u, w), complex_number(x, y) - rho * (t * c).max(), rho


def inverse_inertia(M):  # Omega = M
    return M


def velocity(M, P):
    return inverse_inertia(M)


def generator(M, P, M1, P1, *, eps):  # g_(k+1) = g_k cay(eps/2 M_(k+1))
    return eps / 2 * M1


def lagrangian(g, h, p, *, b, eps):  # (dClebsch spec Lagr) with 2/eps for 4/eps
    W, P = g.mT @ h, act(g.mT, p)
    kinetic = trace_log(2 * identity(W.shape[-1]) + W + W.mT) / eps
    return -kinetic + 2 / eps * log(denominator(P, b=b, eps=eps))


def largest_step(M, P, *, b):
    """The denominator 1 + eps^2/4 <P, BP> stays positive on |P| = const for smaller |eps|."""
    with np.errstate(divide="ignore"):
        return 2 / np.sqrt(dot(P, P) * np.maximum(-b.min(-1), 0))


SYSTEM = System(
    name="clebsch",
    title="Clebsch's case, the special flow c = 1",
    equations="M' = P ^ BP,  P' = -M P",
    source="Suris 2001, section 7, (Clebsch spec)",
    frame=Frame.MOVING,
    space=MOVING_SPACE,
    parameters=(
        Parameter("b", "vector", "diagonal of B: H has -<P, BP>/2. Adding a constant to b leaves the flow as it is"),
    ),
    flow=flow,
    energy=energy,
    velocity=velocity,
    inverse_inertia=inverse_inertia,
    scaling="The one moment of inertia is 1.",
    integrals={"spectrum": spectrum},
    commuting=("spectrum",),
    lax=lax,
    map=Map(
        step=step,
        inverse=inverse,
        adjoint=adjoint,
        involution=involution,
        to_symmetric=half_kick,
        from_symmetric=half_kick_back,
        generator=generator,
        lagrangian=lagrangian,
        lax=lax_matrix,
        conjugator=conjugator,
        largest_step=largest_step,
        source="Suris 2001, section 7, (dClebsch spec)",
    ),
    baecklund=Baecklund(
        point=curve,
        vector=eigenvector,
        defect=lambda M, P, Q: dot(P, Q) - 1,
        step=baecklund_step,
        pair=baecklund_pair,
        arc=arc,
        arc_of_pair=arc_of_pair,
        darboux=darboux,
        block=block,
        case=rational_case,
        pair_case=gaussian_case,
        odd=-1,
        source="the Lax matrix of Suris 2001, section 7; derivation in docs/baecklund.md",
    ),
    derive=shifted_diagonal,
    relations=(
        Relation("clebsch-general", lambda M, P, g, *, b: ((M, P), {"a": b, "b": b}), meaning="the flow a = b"),
    ),
    notes="The spectrum is complete for distinct b (and for n = 4 with one equal pair).",
)
