"""Bäcklund transformations of the Lagrange top, moving frame, state (M, P).

Those of the rest frame under (m, a, p) = (-M, P, A); L(lambda) = -l(1/lambda).
"""

from kreisel.algebra import dot, mat, project_out
from kreisel.baecklund import lagrange_top as rest_frame
from kreisel.record.contract import Baecklund


def inside(state):
    m, a = state
    return -m, a


def spin(M, P, *, A, alpha):  # Omega - M
    return mat((1 - alpha) / alpha / dot(A, A)) * project_out(M, A)


def case_of(case):
    def drawn(n, draw):
        state, params, e, mu, rho = case(n, draw)
        return inside(state), {"A": params["p"], "alpha": params["alpha"]}, e, mu, rho

    return drawn


BAECKLUND = Baecklund(
    point=lambda M, P, *, A, mu: rest_frame.curve(-M, P, p=A, mu=mu),
    vector=lambda M, P, *, A, mu, rho: rest_frame.eigenvector(-M, P, p=A, mu=mu, rho=rho),
    defect=rest_frame.BAECKLUND.defect,
    step=lambda M, P, e, *, A: inside(rest_frame.step(-M, P, e, p=A)),
    pair=lambda M, P, e, *, A: inside(rest_frame.pair(-M, P, e, p=A)),
    spin=spin,
    arc=rest_frame.arc,
    arc_of_pair=rest_frame.arc_of_pair,
    darboux=lambda M, P, e, *, rho, lam: rest_frame.darboux(M, P, e, rho=rho, lam=1 / lam),
    block=rest_frame.block,
    axis="A",
    largest_step=lambda M, P, *, A: rest_frame.largest_step(-M, P, p=A),
    case=case_of(rest_frame.rational_case),
    pair_case=case_of(rest_frame.gaussian_case),
    source="lagrange-top under (m, a, p) = (-M, P, A)",
)
