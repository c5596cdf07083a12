"""Bäcklund transformations of a body of revolution in a fluid, state (M, P).

Its flow is that of Clebsch's case, B = diag(0, ..., 0, beta), over a1 t, and a turn about the axis that commutes with
it, `spin`.  So the maps are those of Clebsch's case at mu/a1.
"""

from kreisel.algebra import mat, project_out
from kreisel.baecklund import clebsch, lagrange_top
from kreisel.record.contract import Baecklund


def eigenvector(M, P, *, c, a1, mu, rho):
    return clebsch.eigenvector(M, P, c=c, mu=mu / a1, rho=rho)


def curve(M, P, *, c, a1, mu):
    return clebsch.curve(M, P, c=c, mu=mu / a1)


def pair(M, P, Q, *, c, a1, mu):
    return clebsch.pair(M, P, Q, c=c, mu=mu / a1)


def block(M, P, *, a1):
    return mat(a1) * lagrange_top.block(M, P)


def spin(M, P, *, a1, a3, e):  # Omega - a1 M
    return mat(a3 - a1) * project_out(M, e)


def with_its_parameters(case, a1):
    """A case of Clebsch's system with B = diag(0, ..., 0, beta) as one of this, with a3 = 1 and c1 = 0."""
    state, params, Q, mu, rho = case
    given = {"a1": a1, "a3": a1 / a1, "c1": 0 * a1, "c3": -a1 * params["b"][-1], "n": len(params["b"])}
    return state, given, Q, a1 * mu, rho


def rational_case(n, draw):
    a1 = 1 + abs(draw((1,)))[0]
    return with_its_parameters(clebsch.rational_case(n, draw, along_axis), a1)


def gaussian_case(n, draw):
    a1 = 1 + abs(draw((1,)))[0]
    return with_its_parameters(clebsch.gaussian_case(n, draw, along_axis), a1)


def along_axis(n, draw):
    b = draw((n,))
    return b * ([0] * (n - 1) + [1])


BAECKLUND = Baecklund(
    point=curve,
    vector=eigenvector,
    defect=clebsch.BAECKLUND.defect,
    step=clebsch.step,
    pair=pair,
    arc=clebsch.arc,
    arc_of_pair=clebsch.arc_of_pair,
    darboux=clebsch.darboux,
    block=block,
    spin=spin,
    case=rational_case,
    pair_case=gaussian_case,
    odd=-1,
    source="clebsch, over a1 t",
)
