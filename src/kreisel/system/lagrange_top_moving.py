"""Lagrange top, moving frame.  State (M, P) in e(n)*: M (..., n, n) skew, P (..., n).

M is the angular momentum and P = g^T p the gravity vector, both in the body frame; A, constant there,
points from the fixed point to the centre of mass.  Plus bracket, F' = {H, F}.  Principal values of the
mass tensor: alpha/2, ..., alpha/2 and 1 - alpha/2 along A.
[Suris 2001, sections 5 and 6.2; U of the discrete Lax pair with +lambda A^T (erratum E2), any |A|]
"""

from kreisel.algebra import act, dot, identity, log, mat, pairing, project_out, trace_log, vec, wedge
from kreisel.algebra.invariants import border, bordered_spectrum
from kreisel.algebra.rotations import cayley, cayley_act, cayley_conjugate, moebius, resolvent
from kreisel.baecklund.lagrange_top import MOVING
from kreisel.record.contract import MOVING_SPACE, ClosedForm, Map, Parameter, Relation, System, named
from kreisel.record.values import nonzero_alpha, nonzero_vector


def inverse_inertia(M, *, A, alpha):  # Omega, (mLT operator inv)
    return M / mat(alpha) + mat((1 - alpha) / alpha / dot(A, A)) * wedge(A, act(M, A))


def flow(M, P, *, A, alpha):  # M' = [M, Omega] + A ^ P,   P' = -Omega P
    Omega = inverse_inertia(M, A=A, alpha=alpha)
    return M @ Omega - Omega @ M + wedge(A, P), -act(Omega, P)


def legendre(M, P, *, A, alpha, eps):  # X with W = cay(X), the inverse of (dmLT W thru M), any |A|
    U = eps / 2 * M  # X = U / alpha + (1/alpha - 1) A ^ y / <A, y> = U + (1/alpha - 1) pi U pi,  pi = I - y y^T / |y|^2
    y = resolvent(U, (A + 0 * P)[..., None])[..., 0]
    return U + mat((1 - alpha) / alpha / dot(y, y)) * project_out(U, y)


def turn(M, P, *, A, alpha, eps):  # W^T M W and W^T P with W = cay(U) cay(-V) cay(V / alpha) = cay(legendre)
    """The rotation cay(U) leaves M unchanged, cay of V leaves A unchanged: one for n = 3, where V^3 = -<V, V> V."""
    U = eps / 2 * M
    V, P = project_out(U, A) / mat(dot(A, A)), cayley_act(-U, P)
    spins = [mat((1 - alpha) / (alpha + pairing(V, V))) * V] if M.shape[-1] == 3 else [-V, V / mat(alpha)]
    for S in spins:
        M, P = cayley_conjugate(-S, M, A), cayley_act(-S, P)
    return M, P


def step(M, P, *, A, alpha, eps):  # (dmLT body)
    M, P = turn(M, P, A=A, alpha=alpha, eps=eps)
    return M - eps * wedge(P, A), P


def inverse(M, P, *, A, alpha, eps):
    return turn(M + eps * wedge(P, A), P, A=A, alpha=alpha, eps=-eps)


def involution(M, P, *, A, eps):
    return -(M + eps * wedge(P, A)), P


def half_kick(M, P, *, A, eps):  # A_(eps/2)
    return M - eps / 2 * wedge(P, A), P


def shifted(M, P, *, A, eps):  # B_k
    return A + eps * act(M, A) / 2 + eps * eps * vec(dot(A, A)) * P / 4


def energy(M, P, *, A, alpha, eps=0):  # Hbar_eps plus the conserved energy of the spin (erratum E16)
    N = project_out(M, A)
    spin = (1 - alpha) / alpha / dot(A, A) ** 2 * pairing(N, N) / 2
    return pairing(M, M) / 2 + dot(P, A) + eps * dot(P, act(M, A)) / 2 + spin


def spectrum(M, P, *, A, eps=0):  # coefficients of det(L(lambda) - mu) but the Casimirs <P, B_k P>
    places = [0, 1, *(2 + 3 * j + i for j in range((min(M.shape[-1], 8) - 1) // 2) for i in (0, 1))]
    return bordered_spectrum(M, shifted(M, P, A=A, eps=eps), P)[..., places]


def noether(M, P, *, A):  # |A|^2 Pi M Pi,  Pi = I - A A^T / |A|^2
    return project_out(M, A)


def lax_matrix(M, P, *, A, lam, eps=0):  # L(lambda)
    return border(M, lam * shifted(M, P, A=A, eps=eps) - P / lam)


def lax(M, P, *, A, alpha, lam):  # L' = [L, U]
    return lax_matrix(M, P, A=A, lam=lam), border(inverse_inertia(M, A=A, alpha=alpha), lam * A + 0 * P)


def conjugator(M, P, *, A, alpha, lam, eps):  # V = diag(W, 1) cay(eps/2 U), U = [[0, lambda A], [+lambda A^T, 0]]
    turn = border(cayley(legendre(M, P, A=A, alpha=alpha, eps=eps)), 0 * P)
    turn[..., -1, -1] = 1 + 0 * P[..., 0]
    return turn @ moebius(eps / 2 * border(0 * M, lam * A + 0 * P))


def generator(M, P, M1, P1, *, A, alpha, eps):
    return legendre(M, P, A=A, alpha=alpha, eps=eps)


def lagrangian(g, h, p, *, A, alpha, eps):  # (dmLT Lagr body), with |A|^2 for 1
    W = g.mT @ h
    kinetic = alpha / eps * trace_log(2 * identity(W.shape[-1]) + W + W.mT)
    return -kinetic - 2 * (1 - alpha) / eps * log(dot(A, A) + dot(A, act(W, A))) - eps * dot(p, act(h, A))


def to_heavy_top(M, P, g, *, A, alpha):  # J is alpha/2 across A and 1 - alpha/2 along it
    along = A[..., :, None] * A[..., None, :] / mat(dot(A, A))
    return (M, P), {"A": A, "J": mat(alpha / 2) * identity(A.shape[-1]) + mat(1 - alpha) * along}


MAP = Map(
    **named(step, inverse, involution, generator, lagrangian, conjugator),
    to_symmetric=lambda M, P, *, A, eps: half_kick(M, P, A=A, eps=-eps),
    lax=lax_matrix,
    source="Suris 2001, section 6.2, (dmLT body) and (dmLT W thru M) with the explicit inverse",
)

SYSTEM = System(
    name="lagrange-top-moving",
    title="Lagrange top, moving frame",
    equations="M' = [M, Omega] + A ^ P,  P' = -Omega P,  M = alpha Omega + (1 - alpha)(Omega AA^T + AA^T Omega)/|A|^2",
    source="Suris 2001, sections 5 and 6.2",
    space=MOVING_SPACE,
    parameters=(
        Parameter(
            "A", "vector", "from the fixed point to the centre of mass; |A| scales <P, A>", nonzero_vector, fixed="body"
        ),
        Parameter("alpha", "scalar", "axial over transverse moment of inertia, not 0", nonzero_alpha, 1.0),
    ),
    **named(flow, energy, inverse_inertia, lax),
    scaling="The transverse moment of inertia is 1; |A| |P| is M g l in that unit. See lagrange-top.",
    integrals={"spectrum": spectrum, "noether": noether},
    commuting=("spectrum",),
    map=MAP,
    baecklund=MOVING,
    closed_form=ClosedForm(top=lambda M, P, *, A: (M, A, P)),
    relations=(
        Relation(
            "heavy-top",
            to_heavy_top,
            meaning="a heavy top with equal transverse moments and its centre of mass on the axis",
            exact=False,  # its mass tensor is diagonal only if A is along an axis
        ),
    ),
    notes="For n >= 4 the spectrum is not complete: noether, the block Pi M Pi, is needed too. "
    "For n = 3 and alpha < 0, which no body has, the step divides by alpha + eps^2/4 <M_perp, M_perp>.",
)
