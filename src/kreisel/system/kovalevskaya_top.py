"""Kovalevskaya top in two fields, in n dimensions: the gyrostat without its rotor.  State (M, P, Q), body frame.

For n = 3 and Q = 0 this is Kovalevskaya's top of 1889.  [as `kovalevskaya_gyrostat`]
"""

from kreisel.algebra import act
from kreisel.record.contract import TWO_FIELDS_SPACE, Parameter, Relation, System
from kreisel.system import kovalevskaya_gyrostat as gyrostat


def inverse_inertia(M, *, c):  # Omega = M, but twice M_12
    return c * M


def velocity(M, P, Q, *, c):
    return inverse_inertia(M, c=c)


def flow(M, P, Q, *, c, e, h):
    Omega = inverse_inertia(M, c=c)
    return M @ Omega - Omega @ M + gyrostat.torque(P, Q, e, h), -act(Omega, P), -act(Omega, Q)


def energy(M, P, Q, *, c):
    return gyrostat.energy(M, P, Q, gamma=0, c=c)


def spectrum(M, P, Q):
    return gyrostat.spectrum(M, P, Q, gamma=0)


def lax(M, P, Q, *, c, e, h, lam):
    return gyrostat.lax(M, P, Q, gamma=0, c=c, e=e, h=h, lam=lam)


SYSTEM = System(
    name="kovalevskaya-top",
    title="Kovalevskaya top in two fields",
    equations="M' = [M, Omega] + e_1 ^ P + e_2 ^ Q,  P' = -Omega P,  Q' = -Omega Q",
    source="Kovalevskaya 1889; Reyman, Semenov-Tian-Shansky 1987; Suris 2001, Introduction",
    space=TWO_FIELDS_SPACE,
    parameters=(Parameter("n", "dimension", "the dimension of the space"),),
    flow=flow,
    energy=energy,
    velocity=velocity,
    inverse_inertia=inverse_inertia,
    derive=gyrostat.shape,
    scaling="The moments of inertia of all planes are 1, that of the plane (1, 2) is 1/2; for n = 3 (1, 1, 1/2).",
    integrals={"spectrum": spectrum, "noether": gyrostat.noether},
    commuting=("spectrum",),
    lax=lax,
    relations=(
        Relation(
            "kovalevskaya-gyrostat",
            lambda M, P, Q, g: ((M, P, Q), {"n": M.shape[-1], "gamma": 0 * M[..., 0, 0]}),
            meaning="the rotor gamma = 0",
        ),
    ),
    notes="Q = 0 is the top in one field. For n = 3 there is an integrable map: kovalevskaya-top-e3 in one field, "
    "kovalevskaya-top-so3 in two. For n >= 4 the same map conserves a deformed energy; its integrability is open.",
)
