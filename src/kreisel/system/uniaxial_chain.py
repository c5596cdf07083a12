"""Classical XXZ chain: `spin-chain` with Jx = Jy = J, field and anisotropy along z.  The total Sz is conserved.

[Landau, Lifshitz 1935; McLachlan, Modin, Verdier 2014]
"""

from dataclasses import replace

from kreisel.record.contract import Parameter
from kreisel.system import spin_chain


def general(J, Jz, Bz, K, bond):
    return {"Jx": J, "Jy": J, "Jz": Jz, "Bx": 0, "By": 0, "Bz": Bz, "K": K, "bond": bond}


def flow(Sx, Sy, Sz, *, J, Jz, Bz, K, bond):
    return spin_chain.flow(Sx, Sy, Sz, **general(J, Jz, Bz, K, bond))


def energy(Sx, Sy, Sz, *, J, Jz, Bz, K, bond):
    return spin_chain.energy(Sx, Sy, Sz, **general(J, Jz, Bz, K, bond))


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
    flow=flow,
    energy=energy,
    integrals={"magnetization": magnetization},
    notes="Not integrable.",
)
