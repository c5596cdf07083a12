"""Steklov's case of a body in a fluid, n = 3.  State (M, P) in e(3)*, axial vectors, body frame.

H = (1/2) sum [b_i M_i^2 + 2 nu b_j b_k M_i P_i + nu^2 b_i (b_j - b_k)^2 P_i^2], (i, j, k) cyclic; Lyapunov's H is its
fourth integral.  Plus bracket, F' = {H, F}.  [Steklov 1893; named in Suris 2001, Introduction.  Lax pair: that of
`steklov_lyapunov` with b_i -> nu (b_i - b_j - b_k)]
"""

from dataclasses import replace

from kreisel.algebra import SECOND, THIRD, hat, vec
from kreisel.algebra.invariants import stack
from kreisel.record.contract import Parameter, Relation
from kreisel.record.values import refused
from kreisel.system import kirchhoff_case, steklov_lyapunov


def coefficients(*, b, nu):
    j, k, nu = b[..., SECOND], b[..., THIRD], vec(nu)
    return {"x": b, "y": nu * j * k, "z": nu * nu * b * (j - k) * (j - k)}


def lyapunov_case(*, b, nu):
    """The coefficients of Lyapunov's H."""
    j, k, nu = b[..., SECOND], b[..., THIRD], vec(nu)
    return {"x": 1 + 0 * b, "y": -nu * b, "z": nu * nu * (j - k) * (j - k)}


def lyapunov(M, P, *, b, nu):
    return stack([kirchhoff_case.energy(M, P, **lyapunov_case(b=b, nu=nu))])


def matrix_b(b, nu):
    """The matrix B of the n-dimensional system: its b_i + b_j is -2 nu b_k."""
    return 2 * vec(nu) * (b - b.sum(-1, keepdims=True) / 2)


def lax(M, P, *, b, nu, lam):
    """L and U of `steklov_lyapunov`, whose Steklov's H is -2 nu times this one."""
    constants = {"b": matrix_b(b, nu), "s": -1 / (2 * nu), "l": 0 * nu}
    constants |= {k: v for k, v in steklov_lyapunov.coefficients(**constants).items() if k != "z"}
    return steklov_lyapunov.lax(M, hat(P), lam=lam, **constants)


SYSTEM = replace(
    kirchhoff_case.SYSTEM,
    name="steklov",
    title="Steklov's case of a body in a fluid",
    source="Steklov 1893; Suris 2001, Conclusions",
    parameters=(
        Parameter("b", "vector", "H has b_i M_i^2/2", diagonal=True),
        Parameter(
            "nu",
            "scalar",
            "strength of the mixed terms, not 0",
            refused(lambda nu: nu == 0, "Not 0.", "{letter} must not be 0: without the mixed terms it is Euler's top."),
        ),
    ),
    derive=coefficients,
    integrals={"lyapunov": lyapunov},
    commuting=("lyapunov",),
    lax=lax,
    pairs=steklov_lyapunov.axial_pairs(matrix_b),
    notes="No explicit map is known; method='exact'.",
    relations=(
        Relation(
            "steklov-lyapunov",
            lambda M, P, g, *, b, nu: ((M, hat(P)), {"b": matrix_b(b, nu), "s": -1 / (2 * nu), "l": 0 * nu}),
            meaning="the case n = 3, P a skew matrix there",
        ),
    ),
)
