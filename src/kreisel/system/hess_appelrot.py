"""Hess and Appelrot's heavy top, n = 3: an invariant relation, not an integral.  State (M, P) in e(3)*, body frame.

The inverse moments are (a, a + k x^2, a + k (x^2 + z^2)) and the centre of mass is (x, 0, z), on the normal of a
circular section of the gyration ellipsoid: x^2 (a_3 - a_2) = z^2 (a_2 - a_1).  Then f = x M_1 + z M_3 obeys
f' = k x z M_2 f, so that f = 0 stays.  Plus bracket, F' = {H, F}.  [Hess 1890; Appelrot 1894; named in Suris
2001, Introduction]
"""

import numpy as np

from kreisel.algebra import act, axial, dot, hat, wedge
from kreisel.record.contract import MOVING_SPACE, Parameter, System, named
from kreisel.record.values import positive


def body(*, a, k, x, z):
    """The inverse moments and the centre of mass."""
    zero = 0 * (a + k + x + z)
    moments = np.stack([a + zero, a + k * x * x + zero, a + k * (x * x + z * z)], -1)
    return {"c": moments, "A": np.stack([x + zero, zero, z + zero], -1)}


def inverse_inertia(M, *, c):
    return hat(c * axial(M))


def flow(M, P, *, c, A):  # M' = [M, Omega] + A ^ P,   P' = -Omega P
    Omega = inverse_inertia(M, c=c)
    return M @ Omega - Omega @ M + wedge(A, P), -act(Omega, P)


def energy(M, P, *, c, A):
    u = axial(M)
    return dot(u, c * u) / 2 + dot(A, P)


def hess(M, P, *, A):  # <A, M>
    return dot(A, axial(M))


def rate(M, P, *, k, x, z):
    return k * x * z * axial(M)[..., 1]


SYSTEM = System(
    name="hess-appelrot",
    title="Hess and Appelrot's heavy top",
    equations="M' = [M, Omega] + A ^ P,  P' = -Omega P",
    source="Hess 1890, Appelrot 1894; Suris 2001, Introduction",
    space=MOVING_SPACE,
    parameters=(
        Parameter("a", "scalar", "the least of the inverse moments", positive, positive=True),
        Parameter("k", "scalar", "the others are a + k x^2 and a + k (x^2 + z^2)", positive, positive=True),
        Parameter("x", "scalar", "first coordinate of the centre of mass (x, 0, z)"),
        Parameter("z", "scalar", "third coordinate of the centre of mass"),
    ),
    **named(flow, energy, inverse_inertia),
    derive=body,
    scaling="Any consistent units: <P, A> is the potential energy.",
    invariant={"hess": (hess, rate)},
    n=3,
    notes="Not integrable: on f = 0 the motion reduces to a Riccati equation. A map that keeps f = 0 is open.",
)
