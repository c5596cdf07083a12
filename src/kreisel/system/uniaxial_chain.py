"""Classical XXZ chain: `spin-chain` with Jx = Jy = J, field and anisotropy along z.  The total Sz is conserved.

[Landau, Lifshitz 1935; McLachlan, Modin, Verdier 2014]
"""

from dataclasses import replace

from kreisel.record.contract import Parameter, pullback
from kreisel.system import spin_chain


def general(Sx, Sy, Sz, g, *, J, Jz, Bz, K):
    return (Sx, Sy, Sz), {"Jx": J, "Jy": J, "Jz": Jz, "Bx": 0, "By": 0, "Bz": Bz, "K": K}


of_general = pullback(spin_chain.SYSTEM, general)


def magnetization(Sx, Sy, Sz):
    return Sz.sum(-1)


SYSTEM = replace(
    spin_chain.SYSTEM,
    name="uniaxial-chain",
    title="Classical XXZ chain, field along z",
    equations="S_i' = S_i x B_i,  B_i = diag(J, J, Jz) (S_(i-1) + S_(i+1)) + (Bz + K Sz_i) e_z",
    parameters=(
        spin_chain.PARAMETERS[0],
        Parameter("J", "scalar", "coupling of the x and y components", default=1.0),
        *(p for p in spin_chain.PARAMETERS if p.letter in ("Jz", "Bz", "K", "closing")),
    ),
    flow=of_general(spin_chain.flow),
    energy=of_general(spin_chain.energy),
    integrals={"magnetization": magnetization},
    notes="Not integrable.",
)
