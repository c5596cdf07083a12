"""Lagrange top, moving frame.  State (M, P) in e(n)*: M (..., n, n) skew, P (..., n).

M is the angular momentum and P = g^T p the gravity vector, both in the body frame; A, constant there,
points from the fixed point to the centre of mass.  Plus bracket, F' = {H, F}.  Principal values of the
mass tensor: alpha/2, ..., alpha/2 and 1 - alpha/2 along A.
[Suris 2001, sections 5 and 6.2; U of the discrete Lax pair with +lambda A^T (erratum E2), any |A|]
"""

from kreisel.algebra import (
    act,
    cayley,
    cayley_act,
    cayley_conjugate,
    dot,
    identity,
    impulse,
    log,
    mat,
    moebius,
    pairing,
    project_out,
    resolvent,
    trace_log,
    vec,
    wedge,
)
from kreisel.contract import MOVING_SPACE, Baecklund, Frame, Map, Parameter, Relation, System
from kreisel.invariants import bordered_spectrum
from kreisel.systems import lagrange_top
from kreisel.systems.checks import nonzero_alpha, nonzero_vector
from kreisel.systems.matrices import border


def inverse_inertia(M, *, A, alpha):  # Omega, (mLT operator inv)
    return M / mat(alpha) + mat((1 - alpha) / alpha / dot(A, A)) * wedge(A, act(M, A))


def velocity(M, P, *, A, alpha):
    return inverse_inertia(M, A=A, alpha=alpha)


def flow(M, P, *, A, alpha):  # M' = [M, Omega] + A ^ P,   P' = -Omega P
    Omega = inverse_inertia(M, A=A, alpha=alpha)
    return M @ Omega - Omega @ M + wedge(A, P), -act(Omega, P)


def legendre(M, P, *, A, alpha, eps):  # X with W = cay(X), the inverse of (dmLT W thru M), any |A|
    U = eps / 2 * M  # X = U / alpha + (1/alpha - 1) A ^ y / <A, y> = U + (1/alpha - 1) pi U pi,  pi = I - y y^T / |y|^2
    y = resolvent(U, (A + 0 * P)[..., None])[..., 0]
    return U + mat((1 - alpha) / alpha / dot(y, y)) * project_out(U, y)


def spins(V, alpha):
    """Generators of turns with the product cay(-V) cay(V / alpha); one turn for n = 3, where V^3 = -<V, V> V."""
    if V.shape[-1] == 3:
        return [mat((1 - alpha) / (alpha + pairing(V, V))) * V]
    return [-V, V / mat(alpha)]


def turn(M, P, *, A, alpha, eps):  # W^T M W and W^T P with W = cay(U) cay(-V) cay(V / alpha) = cay(legendre)
    """The turn cay(U) leaves M alone, the others leave A alone.

    With W in one piece rounding errors of X tilt M from A: after 1e7 steps (n = 3, four states, eps = 0.05 to 1)
    integrals had changed by up to 175 bands of round-off.  After 1e8, with two turns about A up to 2.7 and |P|^2
    had a trend; with one, 1.2 and none.
    """
    U = eps / 2 * M
    P = cayley_act(-U, P)
    for S in spins(project_out(U, A) / mat(dot(A, A)), alpha):
        M, P = cayley_conjugate(-S, M), cayley_act(-S, P)
    return M, P


def step(M, P, *, A, alpha, eps):  # (dmLT body)
    M, P = turn(M, P, A=A, alpha=alpha, eps=eps)
    return M - impulse(eps, P, A), P


def inverse(M, P, *, A, alpha, eps):
    return turn(M + impulse(eps, P, A), P, A=A, alpha=alpha, eps=-eps)


def adjoint(M, P, *, A, alpha, eps):
    return turn(M - impulse(eps, P, A), P, A=A, alpha=alpha, eps=eps)


def involution(M, P, *, A, eps):
    return -(M + impulse(eps, P, A)), P


def half_kick_back(M, P, *, A, eps):  # A_(-eps/2)
    return M + impulse(eps / 2, P, A), P


def half_kick(M, P, *, A, eps):
    return M - impulse(eps / 2, P, A), P


def shifted(M, P, *, A, eps):  # B_k
    return A + eps * act(M, A) / 2 + eps * eps * vec(dot(A, A)) * P / 4


def energy(M, P, *, A, alpha, eps=0):  # Hbar_eps plus the conserved energy of the spin (erratum E16)
    N = project_out(M, A)
    spin = (1 - alpha) / alpha / dot(A, A) ** 2 * pairing(N, N) / 2
    return pairing(M, M) / 2 + dot(P, A) + eps * dot(P, act(M, A)) / 2 + spin


def spectrum(M, P, *, A, eps=0):  # coefficients of det(L(lambda) - mu)
    return bordered_spectrum(M, shifted(M, P, A=A, eps=eps), P)[..., _without_casimirs(M.shape[-1])]


def _without_casimirs(n):
    """The places of <b, B_k b> and c + 2 <b, B_k p> in `bordered_spectrum`; <P, B_k P> are Casimirs."""
    return [0, 1, *(2 + 3 * j + i for j in range((min(n, 8) - 1) // 2) for i in (0, 1))]


def noether(M, P, *, A):  # |A|^2 Pi M Pi,  Pi = I - A A^T / |A|^2
    return project_out(M, A)


def lax_matrix(M, P, *, A, lam, eps=0):  # L(lambda)
    return border(M, lam * shifted(M, P, A=A, eps=eps) - P / lam)


def lax(M, P, *, A, alpha, lam):  # L' = [L, U]
    return lax_matrix(M, P, A=A, lam=lam), border(velocity(M, P, A=A, alpha=alpha), lam * A + 0 * P)


def conjugator(M, P, *, A, alpha, lam, eps):  # V = diag(W, 1) cay(eps/2 U), U = [[0, lambda A], [+lambda A^T, 0]]
    W = cayley(legendre(M, P, A=A, alpha=alpha, eps=eps))
    turn = border(W, 0 * P)
    turn[..., -1, -1] = 1 + 0 * P[..., 0]
    return turn @ moebius(eps / 2 * border(0 * M, lam * A + 0 * P))


# The rest frame's maps under (m, a, p) = (-M, P, A); L(lambda) = -l(1/lambda).


def eigenvector(M, P, *, A, mu, rho):
    return lagrange_top.eigenvector(-M, P, p=A, mu=mu, rho=rho)


def curve(M, P, *, A, mu):
    return lagrange_top.curve(-M, P, p=A, mu=mu)


def baecklund_step(M, P, e, de, change, *, A):
    m, a = lagrange_top.baecklund_step(-M, P, e, de, change, p=A)
    return -m, a


def baecklund_pair(M, P, e, de, change, *, A, rho):
    m, a = lagrange_top.baecklund_pair(-M, P, e, de, change, p=A, rho=rho)
    return -m, a


def block(M, P):  # pi M pi,  pi = I - PP^T / |P|^2
    return project_out(M, P) / mat(dot(P, P))


def spin(M, P, *, A, alpha):  # Omega - M
    return mat((1 - alpha) / alpha / dot(A, A)) * project_out(M, A)


def rational_case(n, draw):
    (m, a), params, e, mu, rho = lagrange_top.rational_case(n, draw)
    return (-m, a), {"A": params["p"], "alpha": params["alpha"]}, e, mu, rho


def gaussian_case(n, draw):
    (m, a), params, e, mu, rho = lagrange_top.gaussian_case(n, draw)
    return (-m, a), {"A": params["p"], "alpha": params["alpha"]}, e, mu, rho


def generator(M, P, M1, P1, *, A, alpha, eps):
    return legendre(M, P, A=A, alpha=alpha, eps=eps)


def lagrangian(g, h, p, *, A, alpha, eps):  # (dmLT Lagr body), with |A|^2 for 1
    W = g.mT @ h
    kinetic = alpha / eps * trace_log(2 * identity(W.shape[-1]) + W + W.mT)
    WA = act(W, A)
    return -kinetic - 2 * (1 - alpha) / eps * log(dot(A, A) + dot(A, WA)) - eps * dot(p, act(h, A))


BAECKLUND = Baecklund(
    point=curve,
    vector=eigenvector,
    defect=lambda M, P, e, *, rho: dot(e, e) - 4 * rho,
    step=baecklund_step,
    pair=baecklund_pair,
    arc=lagrange_top.arc,
    arc_of_pair=lagrange_top.arc_of_pair,
    darboux=lambda M, P, e, *, rho, lam: lagrange_top.darboux(M, P, e, rho=rho, lam=1 / lam),
    block=block,
    spin=spin,
    largest_step=lambda M, P, *, A: lagrange_top.largest_real_step(-M, P, p=A),
    case=rational_case,
    pair_case=gaussian_case,
    source="lagrange-top under (m, a, p) = (-M, P, A)",
)

MAP = Map(
    step=step,
    inverse=inverse,
    adjoint=adjoint,
    involution=involution,
    to_symmetric=half_kick_back,
    from_symmetric=half_kick,
    generator=generator,
    lagrangian=lagrangian,
    lax=lax_matrix,
    conjugator=conjugator,
    source="Suris 2001, section 6.2, (dmLT body) and (dmLT W thru M) with the explicit inverse",
)

SYSTEM = System(
    name="lagrange-top-moving",
    title="Lagrange top, moving frame",
    equations="M' = [M, Omega] + A ^ P,  P' = -Omega P,  M = alpha Omega + (1 - alpha)(Omega AA^T + AA^T Omega)/|A|^2",
    source="Suris 2001, sections 5 and 6.2",
    frame=Frame.MOVING,
    space=MOVING_SPACE,
    parameters=(
        Parameter(
            "A",
            "vector",
            "from the fixed point to the centre of mass, in the body; its length multiplies the potential <P, A>",
            nonzero_vector,
            fixed="body",
        ),
        Parameter("alpha", "scalar", "axial over transverse moment of inertia, not 0", nonzero_alpha, 1.0),
    ),
    flow=flow,
    energy=energy,
    velocity=velocity,
    inverse_inertia=inverse_inertia,
    scaling="The transverse moment of inertia is 1; |A| |P| is M g l in that unit. See lagrange-top.",
    integrals={"spectrum": spectrum, "noether": noether},
    commuting=("spectrum",),
    lax=lax,
    map=MAP,
    baecklund=BAECKLUND,
    top=lambda M, P, *, A: (M, A, P),
    relations=(
        Relation(
            "heavy-top",
            lambda M, P, g, *, A, alpha: ((M, P), {"A": A, "J": _mass_tensor(A, alpha)}),
            meaning="a heavy top with equal transverse moments and its centre of mass on the axis",
            exact=False,  # its mass tensor is diagonal only if A is along an axis
        ),
    ),
    notes="For n >= 4 the spectrum alone is not complete: noether, the block Pi M Pi, is needed too. "
    "For n = 3 and alpha < 0, which no body has, the step divides by alpha + eps^2/4 <M_perp, M_perp>.",
)


def _mass_tensor(A, alpha):
    """alpha/2 across A and 1 - alpha/2 along it."""
    along = A[..., :, None] * A[..., None, :] / mat(dot(A, A))
    return mat(alpha / 2) * identity(A.shape[-1]) + mat(1 - alpha) * along
