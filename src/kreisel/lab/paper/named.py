"""The systems that the Introduction and the Conclusions name, and their maps: what the records do not say by themselves."""

from __future__ import annotations

from kreisel.algebra import act, axial, bracket, dot, hat, identity, mat
from kreisel.invariants import faddeev_leverrier, trace
from kreisel.lab.laws import Sides
from kreisel.lab.paper.rows import Setting, law_row, row
from kreisel.systems import lagrange_top, lagrange_top_moving, lagrange_top_su2, lagrange_top_su2_moving
from kreisel.systems.matrices import su2

EARLIER = "Introduction, the map of Bobenko and Suris 1999"
ONE = identity(2)

# -- SU(2) -----------------------------------------------------------------------------------------------


@row(
    "su2-rest-frame",
    EARLIER,
    "in 2 x 2 matrices m1 = m + eps [p, a], a1 (1 + eps m1) = (1 + eps m1) a is the case n = 3 of (dLT rest frame)",
    dimensions=(3,),
)
def su2_rest(s: Setting) -> Sides:
    m, a, p = s.skew(), s.vector(), s.vector()
    m1, a1 = lagrange_top.step(m, a, p=p, eps=s.eps)
    yield su2(axial(m1)), su2(axial(m)) + s.eps * bracket(su2(p), su2(a))
    turn = ONE + su2(s.eps * axial(m1))
    yield su2(a1) @ turn, turn @ su2(a)


@row(
    "su2-moving-frame",
    EARLIER,
    "M = (alpha/eps) (W - W^-1)/tr W + (2(1 - alpha)/eps) [A, A1]/(|A|^2 + <A, A1>), A1 = W A W^-1; "
    "P1 = W^-1 P W, M1 = W^-1 M W + eps [P1, A] is the case n = 3 of (dmLT body)",
    dimensions=(3,),
)
def su2_moving(s: Setting) -> Sides:
    M, P, A, alpha = s.skew(), s.vector(), s.vector(), abs(s.scalar())
    M1, P1 = lagrange_top_moving.step(M, P, A=A, alpha=alpha, eps=s.eps)
    X = lagrange_top_moving.legendre(M, P, A=A, alpha=alpha, eps=s.eps)
    w = su2(2 * axial(X))
    W, A1 = ONE + w, act(lagrange_top_moving.cayley(X), A)  # up to a factor
    yield W @ su2(A), su2(A1) @ W
    force = bracket(su2(A), su2(A1)) * mat(2 * (1 - alpha) / (dot(A, A) + dot(A, A1)))
    yield s.eps * su2(axial(M)), alpha * w + force  # (W - W^-1)/tr W = w
    yield W @ su2(P1), su2(P) @ W
    yield W @ (su2(axial(M1)) - s.eps * bracket(su2(P1), su2(A))), su2(axial(M)) @ W


@row(
    "su2-trace",
    EARLIER,
    "for the rotation R that w in SU(2) covers, det(2 + R + R^T) = 4 (tr w)^4 and 1 + tr R = (tr w)^2",
    dimensions=(3,),
)
def su2_trace(s: Setting) -> Sides:
    v = s.vector()
    R, square = lagrange_top_moving.cayley(hat(v)), 4 / (1 + dot(v, v))  # w = (1 + 2v)/sqrt(1 + |v|^2) in su(2)
    yield 1 + trace(R), square
    yield -faddeev_leverrier(2 * identity(3) + R + R.mT)[0][3], 4 * square * square


for name, system in (
    ("su2-rest-frame-laws", lagrange_top_su2.SYSTEM),
    ("su2-moving-frame-laws", lagrange_top_su2_moving.SYSTEM),
):
    law_row(
        name,
        EARLIER,
        "Poisson, deformed integrals, Lax pair in 2 x 2 matrices, from the Lagrangian with log tr w",
        system,
        "poisson",
        "integrals-of-the-map",
        "discrete-lax-equation",
        "discrete-euler-lagrange",
        "relations",
        dimensions=(3,),
    )
