"""Lyapunov's case of a body in a fluid, n = 3.  State (M, P) in e(3)*, axial vectors, body frame.

H = (1/2) sum [M_i^2 - 2 nu b_i M_i P_i + nu^2 (b_j - b_k)^2 P_i^2], (i, j, k) cyclic; Steklov's H is its fourth
integral.  Plus bracket, F' = {H, F}.  [Lyapunov 1893; named in Suris 2001, Introduction.  Lax pair as in `steklov`]
"""

from dataclasses import replace

from kreisel.algebra import hat
from kreisel.algebra.invariants import stack
from kreisel.record.contract import Relation
from kreisel.system import kirchhoff_case, steklov, steklov_lyapunov


def second(M, P, *, b, nu):
    return stack([kirchhoff_case.energy(M, P, **steklov.coefficients(b=b, nu=nu))])


def lax(M, P, *, b, nu, lam):
    constants = {"b": steklov.matrix_b(b, nu), "s": 0 * nu, "l": 1 + 0 * nu}
    constants |= {k: v for k, v in steklov_lyapunov.coefficients(**constants).items() if k != "z"}
    return steklov_lyapunov.lax(M, hat(P), lam=lam, **constants)


SYSTEM = replace(
    steklov.SYSTEM,
    name="lyapunov",
    title="Lyapunov's case of a body in a fluid",
    source="Lyapunov 1893; Suris 2001, Conclusions",
    derive=steklov.lyapunov_case,
    integrals={"steklov": second},
    commuting=("steklov",),
    lax=lax,
    relations=(
        Relation(
            "steklov-lyapunov",
            lambda M, P, g, *, b, nu: ((M, hat(P)), {"b": steklov.matrix_b(b, nu), "s": 0 * nu, "l": 1 + 0 * nu}),
            meaning="the case n = 3, P a skew matrix there",
        ),
    ),
)
