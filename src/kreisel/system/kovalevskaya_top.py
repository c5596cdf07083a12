"""Kovalevskaya top in two fields, in n dimensions: the gyrostat without its rotor.  State (M, P, Q), body frame.

For n = 3 and Q = 0 this is Kovalevskaya's top of 1889.  [as `kovalevskaya_gyrostat`]
"""

from dataclasses import replace

import numpy as np

from kreisel.record.contract import Relation
from kreisel.system import kovalevskaya_gyrostat as gyrostat


def shape(*, n):
    return {**gyrostat.shape(n=n), "gamma": (0 * np.asarray(n)).astype(np.int8)}


def inverse_inertia(M, *, c):  # Omega = M, but twice M_12
    return c * M


SYSTEM = replace(
    gyrostat.SYSTEM,
    name="kovalevskaya-top",
    title="Kovalevskaya top in two fields",
    source="Kovalevskaya 1889; Reyman, Semenov-Tian-Shansky 1987; Suris 2001, Introduction",
    parameters=gyrostat.SYSTEM.parameters[:1],
    inverse_inertia=inverse_inertia,
    derive=shape,
    scaling="The moments of inertia of all planes are 1, except for 1/2 in the plane (1, 2); for n = 3 (1, 1, 1/2).",
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
