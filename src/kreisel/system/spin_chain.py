"""Classical spin chain of Heisenberg, XYZ, in a field.  State Sx, Sy, Sz: the components (..., n) of n spins, in space.

    H = -sum_i (Jx Sx_i Sx_(i+1) + Jy Sy_i Sy_(i+1) + Jz Sz_i Sz_(i+1)) - sum_i (B . S_i + K Sz_i^2/2),
    S_i' = S_i x B_i,   B_i = -dH/dS_i.

The bond of the sites n and 1 has the factor `closing`: 1 for a ring, 0 for an open chain.  The sign of the bracket is
that of the rest frame, F' = {H, F} with {Sx_i, Sy_i} = -Sz_i.  The lengths |S_i| are the Casimirs.  With the distance
of sites going to 0 and Jx = Jy = Jz this is the equation of Landau and Lifshitz, S' = S x S_xx.
[Landau, Lifshitz 1935; McLachlan, Modin, Verdier 2014]
"""

import numpy as np

from kreisel.algebra import dot, vec
from kreisel.algebra.invariants import cross, shifted
from kreisel.record.contract import Parameter, System, named
from kreisel.record.spheres import SPINS_SPACE


def ends(*, n, closing):
    """The factors of the bonds (i, i + 1): 1, and `closing` for the last one."""
    last = np.zeros(int(np.max(n)), dtype=np.int8)
    last[-1] = 1
    return {"bond": 1 + vec(closing - 1) * last}


def field(Sx, Sy, Sz, *, Jx, Jy, Jz, Bx, By, Bz, K, bond):  # B_i = J (S_(i-1) + S_(i+1)) + B + K Sz_i e_z
    def coupled(J, S):
        return vec(J) * (bond * shifted(S, 1) + shifted(bond, -1) * shifted(S, -1))

    return coupled(Jx, Sx) + vec(Bx), coupled(Jy, Sy) + vec(By), coupled(Jz, Sz) + vec(Bz) + vec(K) * Sz


def flow(Sx, Sy, Sz, *, Jx, Jy, Jz, Bx, By, Bz, K, bond):  # S_i' = S_i x B_i
    B = field(Sx, Sy, Sz, Jx=Jx, Jy=Jy, Jz=Jz, Bx=Bx, By=By, Bz=Bz, K=K, bond=bond)
    return cross((Sx, Sy, Sz), B)


def energy(Sx, Sy, Sz, *, Jx, Jy, Jz, Bx, By, Bz, K, bond):
    bonds = [J * dot(S, bond * shifted(S, 1)) for J, S in zip((Jx, Jy, Jz), (Sx, Sy, Sz), strict=True)]
    fields = [B * S.sum(-1) for B, S in zip((Bx, By, Bz), (Sx, Sy, Sz), strict=True)]
    return -sum(bonds) - sum(fields) - K * dot(Sz, Sz) / 2


PARAMETERS = (
    Parameter("n", "dimension", "the number of sites"),
    *(Parameter(f"J{a}", "scalar", f"coupling of the {a} components", default=1.0) for a in "xyz"),
    *(Parameter(f"B{a}", "scalar", f"{a} component of the field", default=0.0) for a in "xyz"),
    Parameter("K", "scalar", "anisotropy of a site: easy axis for K > 0, easy plane for K < 0", default=0.0),
    Parameter("closing", "scalar", "factor of the bond of last and first site: 1 ring, 0 open chain", default=1.0),
)

SYSTEM = System(
    name="spin-chain",
    title="Classical spin chain, XYZ, in a field",
    equations="S_i' = S_i x B_i,  B_i = J (S_(i-1) + S_(i+1)) + B + K Sz_i e_z",
    source="Landau, Lifshitz 1935; McLachlan, Modin, Verdier 2014",
    space=SPINS_SPACE,
    parameters=PARAMETERS,
    **named(flow, energy),
    derive=ends,
    scaling="Any consistent units: S is an angular momentum, H an energy.",
    notes="Not integrable. Where couplings are equal, `heisenberg-chain`, `uniaxial-chain` state the total spin.",
)
