"""Kovalevskaya top in two fields, in n dimensions: the gyrostat without its rotor.  State (M, P, Q), body frame.

For n = 3 and Q = 0 this is Kovalevskaya's top of 1889.  [as `kovalevskaya_gyrostat`]
"""

from dataclasses import replace

from kreisel.algebra import act
from kreisel.baecklund.kovalevskaya import TOP
from kreisel.record.contract import TWO_FIELDS_SPACE, Parameter, Relation, System
from kreisel.system import kovalevskaya_gyrostat as gyrostat


def inverse_inertia(M, *, c):  # Omega = M, but twice M_12
    return c * M


def velocity(M, P, Q, *, c):
    return inverse_inertia(M, c=c)


def flow(M, P, Q, *, c, e, h):
    Omega = inverse_inertia(M, c=c)
    return M @ Omega - Omega @ M + gyrostat.torque(P, Q, e, h), -act(Omega, P), -act(Omega, Q)


def energy(M, P, Q, *, c, eps=0):
    return gyrostat.energy(M, P, Q, gamma=0, c=c, eps=eps)


def spectrum(M, P, Q, *, eps=0):
    return gyrostat.spectrum(M, P, Q, gamma=0, eps=eps)


def lax(M, P, Q, *, c, e, h, lam):
    return gyrostat.lax(M, P, Q, gamma=0, c=c, e=e, h=h, lam=lam)


def step(M, P, Q, *, e, h, eps):
    return gyrostat.step(M, P, Q, gamma=0, e=e, h=h, eps=eps)


def inverse(M, P, Q, *, e, h, eps):
    return gyrostat.inverse(M, P, Q, gamma=0, e=e, h=h, eps=eps)


def generator(M, P, Q, M1, P1, Q1, *, e, h, eps):
    return gyrostat.generator(M, P, Q, M1, P1, Q1, gamma=0, e=e, h=h, eps=eps)


def pencil(M, P, Q, *, lam, mu, eps):
    return gyrostat.pencil(M, P, Q, gamma=0, lam=lam, mu=mu, eps=eps)


def factors(M, P, Q, *, e, h, lam, eps):
    return gyrostat.factors(M, P, Q, gamma=0, e=e, h=h, lam=lam, eps=eps)


MAP = replace(gyrostat.MAP, step=step, inverse=inverse, generator=generator, pencil=pencil, factors=factors)

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
    map=MAP,
    pairs=TOP,
    relations=(
        Relation(
            "kovalevskaya-gyrostat",
            lambda M, P, Q, g: ((M, P, Q), {"n": M.shape[-1], "gamma": 0 * M[..., 0, 0]}),
            "step",
            "the rotor gamma = 0",
        ),
    ),
    notes="Q = 0 is the top in one field. For n = 3 kovalevskaya-top-e3 and kovalevskaya-top-so3 have the integrals of "
    "this map in closed form.",
)
