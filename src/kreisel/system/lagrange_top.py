"""Lagrange top, rest frame.  State (m, a) in e(n)*: m (..., n, n) skew, a (..., n).

m is the angular momentum and a = gA the vector from the fixed point to the centre of mass, both in
the rest frame; p is the constant gravity vector (potential <p, a>).  Minus bracket, F' = {H, F}.
[Suris 2001, sections 5 and 6.1; any |a| by erratum E11, alpha != 0; integrals complete with noether, erratum E12]
"""

from kreisel.algebra import act, dot, identity, log, mat, pairing, project_out, trace_log, vec, wedge
from kreisel.algebra.invariants import border, bordered_spectrum
from kreisel.algebra.rotations import cayley_act, moebius
from kreisel.baecklund.lagrange_top import BAECKLUND, spin
from kreisel.record.contract import REST_SPACE, Checks, ClosedForm, Parameter, Relation, System, kicked_map, named
from kreisel.record.values import nonzero_alpha, nonzero_vector


def flow(m, a, *, p):  # (mLT right)   m' = a ^ p,   a' = m a
    return wedge(a, p), act(m, a)


def kick(a, *, p, eps):  # (dLT rest frame)   m_(k+1) = m_k + kick
    return eps * wedge(a, p)


def turn(m, a, *, eps):  # a_(k+1) = (I - eps/2 m_(k+1))^-1 (I + eps/2 m_(k+1)) a_k
    return m, cayley_act(eps / 2 * m, a)


def shifted(m, a, *, p, eps):  # b_k of (bk), for any |a|
    return a - eps * act(m, a) / 2 + eps * eps * vec(dot(a, a)) * p / 4


def darboux_variables(m, a, *, p, eps):  # (m, b) and rho = eps^2 |a|^2/4: e = eps a is the eigenvector
    return m, shifted(m, a, p=p, eps=eps), eps * eps * dot(a, a) / 4


def energy(m, a, *, p, eps=0):  # (dLT rest H)
    return pairing(m, m) / 2 + dot(a, p) - eps * pairing(m, wedge(p, a)) / 2


def spectrum(m, a, *, p, eps=0):  # coefficients of det(l(lambda) - mu)
    return bordered_spectrum(m, shifted(m, a, p=p, eps=eps), p)


def noether(m, a, *, p):  # |p|^2 pi m pi,  pi = I - p p^T / |p|^2
    return project_out(m, p)


def lax_matrix(m, a, *, p, lam, eps=0):  # l(lambda)
    return border(m, lam * shifted(m, a, p=p, eps=eps) - p / lam)


def lax(m, a, *, p, lam):  # l' = [l, u]
    return lax_matrix(m, a, p=p, lam=lam), border(0 * m, lam * a)


def conjugator(m, a, *, p, lam, eps):  # v_k, from the old a_k
    return moebius(eps / 2 * border(0 * m, lam * a))


def generator(m, a, m1, a1, *, alpha, eps):  # w_k = cay(X), from (dLT m expr)
    return eps / 2 * m1 / mat(alpha) + mat((1 - alpha) / alpha / (dot(a, a) + dot(a, a1))) * wedge(a, a1)


def lagrangian(g, h, A, *, p, alpha, eps):  # (dmLT Lagr 1), with |A|^2 for 1
    w, a, a1 = h @ g.mT, act(g, A), act(h, A)
    kinetic = alpha / eps * trace_log(2 * identity(w.shape[-1]) + w + w.mT)
    return -kinetic - 2 * (1 - alpha) / eps * log(dot(A, A) + dot(a, a1)) - eps * dot(p, a)


def to_moving_frame(m, a, g, *, p, alpha):
    return (g.mT @ m @ g, act(g.mT, p)), {"A": act(g.mT, a), "alpha": alpha}


MAP = kicked_map(
    kick,
    turn,
    **named(generator, lagrangian, conjugator),
    lax=lax_matrix,
    darboux=darboux_variables,
    source="Suris 2001, section 6.1, (dLT rest frame)",
)

SYSTEM = System(
    name="lagrange-top",
    title="Lagrange top, rest frame",
    equations="m' = a ^ p,  a' = m a",
    source="Suris 2001, sections 5 and 6.1",
    space=REST_SPACE,
    parameters=(
        Parameter("p", "vector", "gravity vector in the rest frame: the potential energy is <p, a>", fixed="space"),
        Parameter(
            "alpha",
            "scalar",
            "axial over transverse moment of inertia, not 0; only the orientation feels it",
            nonzero_alpha,
            1.0,
        ),
    ),
    **named(flow, energy, lax),
    inverse_inertia=lambda m: m,
    spin=spin,
    scaling="The transverse moment of inertia is 1: with body values I1, M g l use the time unit sqrt(I1/(M g l)), "
    "momenta in sqrt(I1 M g l), |a| = |p| = 1.",
    checks=Checks(state={"a": nonzero_vector}),
    integrals={"spectrum": spectrum, "noether": noether},
    commuting=("spectrum",),
    map=MAP,
    baecklund=BAECKLUND,
    closed_form=ClosedForm(top=lambda m, a, *, p: (m, a, p)),
    relations=(Relation("lagrange-top-moving", to_moving_frame, "adjoint", "the body seen in the moving frame"),),
    notes="For n >= 4 the spectrum is not complete: noether, the block pi m pi, is needed too.",
)
