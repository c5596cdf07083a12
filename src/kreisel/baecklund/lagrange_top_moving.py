"""Bäcklund transformations of the Lagrange top, moving frame, state (M, P).

Those of the rest frame under (m, a, p) = (-M, P, A); L(lambda) = -l(1/lambda).
"""

from kreisel.algebra import dot, mat, project_out
from kreisel.baecklund import lagrange_top as rest_frame
from kreisel.record.contract import Baecklund, named


def eigenvector(M, P, *, A, mu, rho):
    return rest_frame.eigenvector(-M, P, p=A, mu=mu, rho=rho)


def curve(M, P, *, A, mu):
    return rest_frame.curve(-M, P, p=A, mu=mu)


def step(M, P, e, *, A):
    m, a = rest_frame.step(-M, P, e, p=A)
    return -m, a


def pair(M, P, e, *, A):
    m, a = rest_frame.pair(-M, P, e, p=A)
    return -m, a


def spin(M, P, *, A, alpha):  # Omega - M
    return mat((1 - alpha) / alpha / dot(A, A)) * project_out(M, A)


def rational_case(n, draw):
    (m, a), params, e, mu, rho = rest_frame.rational_case(n, draw)
    return (-m, a), {"A": params["p"], "alpha": params["alpha"]}, e, mu, rho


def gaussian_case(n, draw):
    (m, a), params, e, mu, rho = rest_frame.gaussian_case(n, draw)
    return (-m, a), {"A": params["p"], "alpha": params["alpha"]}, e, mu, rho


BAECKLUND = Baecklund(
    point=curve,
    vector=eigenvector,
    defect=lambda M, P, e, *, rho: dot(e, e) - 4 * rho,
    **named(step, pair, spin),
    arc=rest_frame.arc,
    arc_of_pair=rest_frame.arc_of_pair,
    darboux=lambda M, P, e, *, rho, lam: rest_frame.darboux(M, P, e, rho=rho, lam=1 / lam),
    block=rest_frame.block,
    axis="A",
    largest_step=lambda M, P, *, A: rest_frame.largest_step(-M, P, p=A),
    case=rational_case,
    pair_case=gaussian_case,
    source="lagrange-top under (m, a, p) = (-M, P, A)",
)
