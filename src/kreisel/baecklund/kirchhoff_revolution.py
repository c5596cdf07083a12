"""Bäcklund transformations of a body of revolution in a fluid, state (M, P).

(a1 M, P) moves as in Clebsch's case with B = diag(0, ..., 0, beta), and rotates about the axis besides, by `spin`,
which commutes with that.  So the maps are those of Clebsch's case for (a1 M, P).
"""

from kreisel.algebra import act, mat, project_out
from kreisel.baecklund import clebsch, lagrange_top
from kreisel.record.contract import Baecklund, named


def step(M, P, Q, *, c, a1):
    M1 = M + clebsch.kick(P, Q, c=c) / mat(a1)
    return M1, P - act(mat(a1) * (M + M1), Q)


def pair(M, P, Q, *, c, a1, mu):
    K, P1 = clebsch.kick_and_turn(mat(a1) * M, P, Q, c=c, mu=mu)
    return M + K / mat(a1), P1


def spin(M, P, *, a1, a3, e):  # Omega - a1 M
    return mat(a3 - a1) * project_out(M, e)


def with_its_parameters(case, draw):
    """A case of Clebsch's system with B = diag(0, ..., 0, beta) as one of this, with a3 = 1 and c1 = 0."""
    (M, P), params, Q, mu, rho = case
    a1 = 1 + abs(draw((1,)))[0]
    parameters = {"a1": a1, "a3": a1 / a1, "c1": 0 * a1, "c3": -params["b"][-1] / a1, "n": len(params["b"])}
    return (M / a1, P), parameters, Q, mu, rho


def along_axis(n, draw):
    return draw((n,)) * ([0] * (n - 1) + [1])


BAECKLUND = Baecklund(
    point=lambda M, P, *, c, a1, mu: clebsch.curve(mat(a1) * M, P, c=c, mu=mu),
    vector=lambda M, P, *, c, a1, mu, rho: clebsch.eigenvector(mat(a1) * M, P, c=c, mu=mu, rho=rho),
    defect=clebsch.BAECKLUND.defect,
    **named(step, pair, spin),
    arc_of_pair=lambda M, P, Q, *, a1: clebsch.arc_of_pair(mat(a1) * M, P, Q),
    block=lambda M, P, *, a1: lagrange_top.block(mat(a1) * M, P),
    arc=clebsch.arc,
    darboux=clebsch.darboux,
    axis="e",
    case=lambda n, draw: with_its_parameters(clebsch.rational_case(n, draw, along_axis), draw),
    pair_case=lambda n, draw: with_its_parameters(clebsch.gaussian_case(n, draw, along_axis), draw),
    odd=-1,
    source="clebsch, for (a1 M, P)",
)
