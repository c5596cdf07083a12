"""Lagrange top, rest frame, n = 3, on SU(2): the map of 1999.  State (m, a) as in `lagrange_top`.

Vectors represent 2 x 2 matrices x = sum x_i e_i, e_i = sigma_i/(2i): [x, y] is the cross product, <x, y> = -2 tr xy
and x^2 = -|x|^2/4.  With w = g_(k+1) g_k^-1 in SU(2), on the branch tr w > 0 where w is near 1,

    m_(k+1) = m_k + eps [p, a_k],   a_(k+1) = (1 + eps m_(k+1)) a_k (1 + eps m_(k+1))^-1,
    L = -(4 alpha/eps) log tr w - (2 (1 - alpha)/eps) log(|a|^2 + <a_k, a_(k+1)>) - eps <p, a_k>.

It is the case n = 3 of the map of 2001: there tr log(2 + R + R^T) = 4 log |tr w| + log 4 represents log tr w, which
has no meaning in SO(n); and (1 + x) y (1 + x)^-1 is cay(x/2) y, so that the steps are those of `lagrange_top`
(`kreisel verify su2`).  [Bobenko, Suris, Comm. Math. Phys. 204 (1999).  Its text was not at hand: the attribution of
the formulas is open, the formulas themselves are tested]
"""

from dataclasses import replace

from kreisel.algebra import act, axial, dot, identity, log
from kreisel.algebra.invariants import stack, su2, trace
from kreisel.record.contract import Relation, named
from kreisel.system import lagrange_top


def squares(m, a, *, p, eps=0):
    """The coefficients of -2 tr l^2: <b, b>, <m, b>, <m, m> + 2 <b, p>, <m, p>, with b as in `lax_matrix`."""
    b, u = lagrange_top.shifted(m, a, p=p, eps=eps), axial(m)
    return stack([dot(b, b), dot(u, b), dot(u, u) + 2 * dot(b, p), dot(u, p)])


def lax_matrix(m, a, *, p, lam, eps=0):  # l = lambda b + m + p/lambda,   b = a + (eps/2) [a, m] + (eps^2/4) |a|^2 p
    return su2(lam * lagrange_top.shifted(m, a, p=p, eps=eps) + axial(m) + p / lam)


def lax(m, a, *, p, lam):  # l' = [l, lambda a]
    return lax_matrix(m, a, p=p, lam=lam), su2(lam * a)


def conjugator(m, a, *, lam, eps):  # v = 1 + eps lambda a
    return identity(2) + su2(eps * lam * a)


def lagrangian(g, h, A, *, p, alpha, eps):  # (tr w)^2 = 1 + tr R for the rotation R that w covers
    a, a1 = act(g, A), act(h, A)
    kinetic = 2 * alpha / eps * log(1 + trace(h @ g.mT))
    return -kinetic - 2 * (1 - alpha) / eps * log(dot(A, A) + dot(a, a1)) - eps * dot(p, a)


def of_1999(top, same, *formulas):
    """The record of a top on SU(2), from that of 2001 in the same frame; `same` are its state and parameters."""
    squares, lax, lax_matrix, *of_map = formulas
    name, frame = top.SYSTEM.name, top.SYSTEM.frame.value
    return replace(
        top.SYSTEM,
        name=name.replace("lagrange-top", "lagrange-top-su2"),
        title=f"Lagrange top on SU(2), {frame} frame",
        source="Bobenko, Suris 1999",
        n=3,
        integrals={"squares": squares},
        commuting=("squares",),
        lax=lax,
        map=replace(top.MAP, **named(*of_map), lax=lax_matrix, source="Bobenko, Suris 1999"),
        baecklund=None,
        relations=(Relation(name, same, "step", "the map is the case n = 3 of the map of 2001"),),
        notes=f"The 1999 paper was not at hand: whether it has these very formulas is open. All else is in {name}.",
    )


def same(m, a, g, *, p, alpha):
    return (m, a), {"p": p, "alpha": alpha}


SYSTEM = of_1999(lagrange_top, same, squares, lax, lax_matrix, conjugator, lagrangian)
