"""Lagrange top, rest frame.  State (m, a) in e(n)*: m (..., n, n) skew, a (..., n).

m is the angular momentum and a = gA the vector from the fixed point to the centre of mass, both in
the rest frame; p is the constant gravity vector (potential <p, a>).  Minus bracket, F' = {H, F}.
[Suris 2001, sections 5 and 6.1; any |a| by erratum E11, alpha != 0; integrals complete with noether, erratum E12]
"""

import numpy as np

from kreisel.algebra import (
    act,
    cayley_act,
    close_sum,
    complex_number,
    dot,
    dot_less,
    identity,
    impulse,
    increment_rest,
    log,
    mat,
    moebius,
    pairing,
    parts,
    project_out,
    quotient,
    shifted_residual,
    shifted_resolvent,
    skew,
    sqrt,
    together,
    trace_log,
    vec,
    wedge,
)
from kreisel.contract import REST_SPACE, Baecklund, Frame, Map, Parameter, Relation, System
from kreisel.invariants import bordered_spectrum
from kreisel.systems.checks import nonzero_alpha, nonzero_vector
from kreisel.systems.matrices import border


def flow(m, a, *, p):  # (mLT right)   m' = a ^ p,   a' = m a
    return wedge(a, p), act(m, a)


def step(m, a, *, p, eps):  # (dLT rest frame)
    m = m + impulse(eps, a, p)
    return m, cayley_act(eps / 2 * m, a)  # (I - eps/2 m)^-1 (I + eps/2 m) a


def inverse(m, a, *, p, eps):
    a = cayley_act(-eps / 2 * m, a)
    return m - impulse(eps, a, p), a


def adjoint(m, a, *, p, eps):
    a = cayley_act(eps / 2 * m, a)
    return m + impulse(eps, a, p), a


def involution(m, a, *, p, eps):
    return -(m + impulse(eps, a, p)), a


def half_kick(m, a, *, p, eps):  # A_(eps/2)
    return m + impulse(eps / 2, a, p), a


def half_kick_back(m, a, *, p, eps):
    return m - impulse(eps / 2, a, p), a


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


def eigenvector(m, a, *, p, mu, rho):  # (mu - m) e = 2 (a - rho p); then <e, e> = 4 rho, rho = 1/lambda^2
    """e, de, drho: what e and rho still lack, by the residual and by a step of Newton's method for this very state."""
    e, h = 2 * shifted_resolvent(mu, m, a - vec(rho) * p), 2 * shifted_resolvent(mu, m, p + 0 * a)
    de = shifted_resolvent(mu, m, shifted_residual(mu, m, e, (2, a), (-2 * rho, p)))
    change = (dot_less(e, e, 4 * rho) + 2 * dot(e, de)) / (4 + 2 * dot(e, h))
    return e, de - vec(change) * h, change


def curve(m, a, *, p, mu):  # <e, e> = 4 rho, the root of a quadratic equation with rho mu^2 -> |a|^2
    u, w = 2 * shifted_resolvent(mu, m, a), 2 * shifted_resolvent(mu, m, p + 0 * a)
    half, product = 2 + dot(u, w), dot(u, u) * dot(w, w)
    root = sqrt(half * half - product)
    near, far = dot(u, u) / (half + root), dot(u, u) / (half - root)
    if not np.iscomplexobj(near):
        return near
    right = (near.imag * mu.imag <= 0) | ~(far.imag * mu.imag < 0)  # Im rho and Im mu^-2 have one sign
    return np.where(right, near, far)


def pushed(m, e, de, p):  # m + (e + de) ^ p
    return close_sum(m, impulse(1, e, p), wedge(de - increment_rest(1, e) * e, p))


def baecklund_step(m, a, e, de, change, *, p):
    m1 = pushed(m, e, de, p)
    both = (m + m1) / 2
    return m1, close_sum(a, act(both, e), act(both, de))  # = 2 e <e, a> / <e, e> - a, unstable when iterated


def baecklund_pair(m, a, e, de, change, *, p, rho):
    (u, w), (du, dw) = parts(e), parts(de)
    f, df = quotient(4 * parts(rho)[1], 4 * parts(change)[1], dot(w, w), 2 * dot(w, dw))
    g, dg = vec(f) * w, vec(df) * w + vec(f) * dw
    m1 = pushed(m, g, dg, p)
    both = (m + m1) / 2

    def across(u, g):  # (u <g, p> - g <u, p>) / 2
        return (u * vec(dot(g, p)) - g * vec(dot(u, p))) / 2

    return m1, close_sum(a, act(both, g) + across(u, g), act(both, dg) + across(u, dg) + across(du, g))


def arc(m, a, e):
    return a, e


def arc_of_pair(m, a, e, *, rho):
    (u, w), (re, im) = parts(e), parts(4 * rho)
    ww = dot(w, w)
    return w, vec(im * im - re * ww) * w - vec(im * ww) * u


def darboux(m, a, e, *, rho, lam):  # N l = l_new N
    n, square = m.shape[-1], lam * lam
    corner = mat(1 - square * rho) * identity(n) + square / 2 * e[..., :, None] * e[..., None, :]
    out = border(corner, -lam * e)
    out[..., -1, -1] = 1 + square * rho
    return out


def block(m, a):  # pi m pi,  pi = I - a a^T / |a|^2
    return project_out(m, a) / mat(dot(a, a))


def spin(m, a, *, alpha):  # omega - m = (1/alpha - 1) pi m pi, turning with the body
    return mat((1 - alpha) / alpha) * block(m, a)


def largest_real_step(m, a, *, p):
    """The eps at which the two roots of the quadratic equation for rho meet; infinite if they never do."""

    def exists(eps):
        return np.isfinite(curve(m, a, p=p, mu=2 / eps))

    with np.errstate(all="ignore"):
        low = 1 / np.sqrt(np.sqrt(dot(a, a) * dot(p, p)))  # always reached
        high = 1e8 * low
        forever = exists(high)
        for _ in range(80):
            middle = np.sqrt(low * high)
            found = exists(middle)
            low, high = np.where(found, middle, low), np.where(found, high, middle)
    return np.where(forever, np.inf, low)


def rational_case(n, draw):
    """m, e, p and mu at random; then rho = <e, e>/4 and a = rho p + (mu - m) e / 2."""
    m, e, p, mu = skew(draw((n * (n - 1) // 2,)), n), draw((n,)), draw((n,)), abs(draw((1,)))[0]
    rho = dot(e, e) / 4
    return (m, rho * p + (mu * e - act(m, e)) / 2), {"p": p, "alpha": abs(draw((1,)))[0]}, e, mu, rho


def gaussian_case(n, draw):
    """m, mu and e = u + iw at random; then rho = <e, e>/4, and (mu - m) e = 2 (a - rho p) tells p and a."""
    m, u, w, (x, y, alpha) = skew(draw((n * (n - 1) // 2,)), n), draw((n,)), draw((n,)), abs(draw((3,)))
    rho = complex_number((dot(u, u) - dot(w, w)) / 4, dot(u, w) / 2)
    p = (act(m, w) - x * w - y * u) / dot(u, w)
    a = parts(rho)[0] * p + (x * u - y * w - act(m, u)) / 2
    return (m, a), {"p": p, "alpha": alpha}, together(u, w), complex_number(x, y), rho


def inverse_inertia(m):  # dH/dm
    return m


def velocity(m, a, *, alpha):
    return inverse_inertia(m) + spin(m, a, alpha=alpha)


def generator(m, a, m1, a1, *, alpha, eps):  # w_k = cay(X), from (dLT m expr)
    return eps / 2 * m1 / mat(alpha) + mat((1 - alpha) / alpha / (dot(a, a) + dot(a, a1))) * wedge(a, a1)


def lagrangian(g, h, A, *, p, alpha, eps):  # (dmLT Lagr 1), with |A|^2 for 1
    w, a, a1 = h @ g.mT, act(g, A), act(h, A)
    kinetic = alpha / eps * trace_log(2 * identity(w.shape[-1]) + w + w.mT)
    return -kinetic - 2 * (1 - alpha) / eps * log(dot(A, A) + dot(a, a1)) - eps * dot(p, a)


def to_moving_frame(m, a, g, *, p, alpha):
    return (g.mT @ m @ g, act(g.mT, p)), {"A": act(g.mT, a), "alpha": alpha}


MAP = Map(
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
    darboux=darboux_variables,
    source="Suris 2001, section 6.1, (dLT rest frame)",
)

SYSTEM = System(
    name="lagrange-top",
    title="Lagrange top, rest frame",
    equations="m' = a ^ p,  a' = m a",
    source="Suris 2001, sections 5 and 6.1",
    frame=Frame.REST,
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
    flow=flow,
    energy=energy,
    velocity=velocity,
    inverse_inertia=inverse_inertia,
    spin=spin,
    scaling="The transverse moment of inertia is 1: with body values I1, M g l take the time unit sqrt(I1/(M g l)), "
    "momenta in sqrt(I1 M g l), |a| = |p| = 1.",
    check_state=lambda m, a: nonzero_vector(a, "a"),
    integrals={"spectrum": spectrum, "noether": noether},
    commuting=("spectrum",),
    lax=lax,
    map=MAP,
    baecklund=Baecklund(
        point=curve,
        vector=eigenvector,
        defect=lambda m, a, e, *, rho: dot(e, e) - 4 * rho,
        step=baecklund_step,
        pair=baecklund_pair,
        arc=arc,
        arc_of_pair=arc_of_pair,
        darboux=darboux,
        block=block,
        spin=spin,
        largest_step=largest_real_step,
        case=rational_case,
        pair_case=gaussian_case,
        source="the Lax matrix of Suris 2001, section 5; derivation in docs/baecklund.md",
    ),
    top=lambda m, a, *, p: (m, a, p),
    relations=(Relation("lagrange-top-moving", to_moving_frame, "adjoint", "the same body seen in its own frame"),),
    notes="For n >= 4 the spectrum alone is not complete: noether, the block pi m pi, is needed too.",
)
