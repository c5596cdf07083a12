"""Euler top with Manakov's metrics.  State M in so(n)*: M (..., n, n) skew, body frame.

Omega_jk = c_jk M_jk with c_jk = (b_j - b_k)/(a_j - a_k); plus bracket, F' = {H, F}.  [Manakov 1976; named in
Suris 2001, Introduction]
"""

from kreisel.algebra.invariants import diagonal, metric_spectrum
from kreisel.baecklund.conjugate import MANAKOV
from kreisel.record.contract import FREE_SPACE, Parameter, System, named
from kreisel.record.values import distinct
from kreisel.system.clebsch_general import quotients
from kreisel.system.euler_top import energy, flow, inverse_inertia


def spectrum(M, *, a):  # coefficients of det(lambda A + M - mu)
    return metric_spectrum(M, diagonal(a))


def lax(M, *, a, b, c, lam):  # L = lambda A + M,   U = lambda B + Omega
    return lam * diagonal(a) + M, lam * diagonal(b) + inverse_inertia(M, c=c)


SYSTEM = System(
    name="manakov-top",
    title="Euler top with Manakov's metrics",
    equations="M' = [M, Omega],  Omega_jk = (b_j - b_k)/(a_j - a_k) M_jk",
    source="Manakov 1976; Suris 2001, Introduction",
    space=FREE_SPACE,
    parameters=(
        Parameter("a", "vector", "diagonal of A, distinct entries", distinct, distinct=True, diagonal=True),
        Parameter("b", "vector", "diagonal of B", diagonal=True),
    ),
    **named(flow, energy, inverse_inertia, lax),
    derive=quotients,
    integrals={"spectrum": spectrum},
    commuting=("spectrum",),
    pairs=MANAKOV,
    notes="Only the metric of a body, a = J^2, b = J, has a map here: euler-top. All have method='exact', n = 3 to 5.",
)
