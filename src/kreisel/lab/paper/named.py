"""The systems that the Introduction and the Conclusions name, and their maps: what the records do not say by themselves."""

from __future__ import annotations

from kreisel.algebra import act, axial, bracket, cayley, dot, hat, identity, mat
from kreisel.algebra.invariants import characteristic, trace
from kreisel.algebra.matrices import su2
from kreisel.lab.law import Sides
from kreisel.lab.paper.statements import Setting, stated, stated_law
from kreisel.record.contract import System
from kreisel.system import REGISTRY, lagrange_top, lagrange_top_moving, lagrange_top_su2, lagrange_top_su2_moving

EARLIER = "Introduction, the map of Bobenko and Suris 1999"
ONE = identity(2)

# -- SU(2) -----------------------------------------------------------------------------------------------


@stated(
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


@stated(
    "su2-moving-frame",
    EARLIER,
    "M = (alpha/eps) (W - W^-1)/tr W + (2(1 - alpha)/eps) [A, A1]/(|A|^2 + <A, A1>), A1 = W A W^-1; "
    "P1 = W^-1 P W, M1 = W^-1 M W + eps [P1, A] is the case n = 3 of (dmLT body)",
    dimensions=(3,),
)
def su2_moving(s: Setting) -> Sides:
    M, P, A, alpha = s.skew(), s.vector(), s.vector(), -s.sign * abs(s.scalar())
    M1, P1 = lagrange_top_moving.step(M, P, A=A, alpha=alpha, eps=s.eps)
    X = lagrange_top_moving.legendre(M, P, A=A, alpha=alpha, eps=s.eps)
    w = su2(2 * axial(X))
    W, A1 = ONE + w, act(cayley(X), A)  # up to a factor
    yield W @ su2(A), su2(A1) @ W
    force = bracket(su2(A), su2(A1)) * mat(2 * (1 - alpha) / (dot(A, A) + dot(A, A1)))
    yield s.eps * su2(axial(M)), alpha * w + force  # (W - W^-1)/tr W = w
    yield W @ su2(P1), su2(P) @ W
    yield W @ (su2(axial(M1)) - s.eps * bracket(su2(P1), su2(A))), su2(axial(M)) @ W


@stated(
    "su2-trace",
    EARLIER,
    "for the rotation R that w in SU(2) covers, det(2 + R + R^T) = 4 (tr w)^4 and 1 + tr R = (tr w)^2",
    dimensions=(3,),
)
def su2_trace(s: Setting) -> Sides:
    v = s.vector()
    R, square = cayley(hat(v)), 4 / (1 + dot(v, v))  # w = (1 + 2v)/sqrt(1 + |v|^2) in su(2)
    yield 1 + trace(R), square
    yield -characteristic(2 * identity(3) + R + R.mT)[3], 4 * square * square


for name, system in (
    ("su2-rest-frame-laws", lagrange_top_su2.SYSTEM),
    ("su2-moving-frame-laws", lagrange_top_su2_moving.SYSTEM),
):
    stated_law(
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

# -- further systems -------------------------------------------------------------------------------------

FLOWS = ("hamiltonian-flow", "integrals-of-the-flow")
COMPLETE = (*FLOWS, "involution", "lax-equation")
CONTINUOUS = {
    "euler-top": ("Introduction, the Euler top in n dimensions", COMPLETE),
    "manakov-top": ("Introduction, the Euler top in n dimensions", COMPLETE),
    "quadratic-potential": ("Introduction, the rigid body in a quadratic potential", COMPLETE),
    "clebsch-body": ("Section 7, the other flow of Clebsch's case", COMPLETE),
    "kovalevskaya-top": ("Introduction, Kovalevskaya's top", COMPLETE),
    "kovalevskaya-gyrostat": ("Introduction, Kovalevskaya's top", COMPLETE),
    "goryachev-chaplygin": ("Introduction, Goryachev and Chaplygin", (*FLOWS, "involution")),
    "hess-appelrot": ("Introduction, Hess and Appelrot", (*FLOWS, "invariant-relations")),
    "kirchhoff-case": ("Introduction, Kirchhoff's case", (*FLOWS, "involution")),
    "kirchhoff-revolution": ("Introduction, Kirchhoff's case", COMPLETE),
    "steklov": ("Conclusions, Steklov's case", (*COMPLETE, "relations")),
    "lyapunov": ("Conclusions, Lyapunov's case", (*COMPLETE, "relations")),
    "steklov-lyapunov": ("Conclusions, Steklov's and Lyapunov's cases", COMPLETE),
    "ratiu-top": ("Conclusions, Ratiu's Lagrange top", COMPLETE),
    "ratiu-bitop": ("Conclusions, Ratiu's Lagrange top", COMPLETE),
    "rosochatius": ("Section 7, end, beside Neumann's system", COMPLETE),
}
MAPS = {
    "euler-top": ("Introduction, the discrete Euler top of Veselov, Moser and Veselov", True),
    "quadratic-potential": ("Introduction, the earlier paper's discretization", True),
    "clebsch-body": ("Conclusions, the other discretization of Clebsch's case", True),
    "neumann-veselov": ("Introduction, Veselov's discretization of Neumann's system", True),
    "rosochatius": ("Section 7, end, beside Neumann's system", True),
    "ratiu-bitop": ("Conclusions, a map for n = 4", False),
    "kirchhoff-revolution": ("Introduction, Kirchhoff's case", False),
}


def sizes(system: System) -> tuple[int, ...]:
    """The dimensions of a statement: two, since the laws of the registry go further."""
    return (3, 4) if system.n is None else (system.n,)


for name, (place, names) in CONTINUOUS.items():
    system = REGISTRY[name]
    claims = "Hamiltonian; integrals" + (" in involution; Lax pair" if "lax-equation" in names else "")
    stated_law(f"{name}-flow", place, f"{system.equations}: {claims}", system, *names, dimensions=sizes(system))
for name, (place, commutes) in MAPS.items():
    system = REGISTRY[name]
    stated_law(
        f"{name}-map",
        place,
        "the map is Poisson, conserves its integrals and has a Lax pair"
        + ("; it commutes with the flow and with itself at other steps" if commutes else ""),
        system,
        "poisson",
        "integrals-of-the-map",
        "discrete-lax-equation",
        *(["commuting-maps"] if commutes else []),
        numbers=("float",),
        dimensions=sizes(system),
    )
