"""Classical Heisenberg chain, isotropic: `spin-chain` with Jx = Jy = Jz = J, without a field.

The total spin is conserved.  A field B only rotates all spins about it.  [Heisenberg; McLachlan, Modin, Verdier 2014]
"""

from dataclasses import replace

from kreisel.algebra.invariants import stack
from kreisel.record.contract import Parameter, pullback
from kreisel.system import spin_chain


def general(Sx, Sy, Sz, g, *, J):
    return (Sx, Sy, Sz), {"Jx": J, "Jy": J, "Jz": J, "Bx": 0, "By": 0, "Bz": 0, "K": 0}


of_general = pullback(spin_chain.SYSTEM, general)


def total_spin(Sx, Sy, Sz):
    return stack([S.sum(-1) for S in (Sx, Sy, Sz)])


SYSTEM = replace(
    spin_chain.SYSTEM,
    name="heisenberg-chain",
    title="Classical Heisenberg chain",
    equations="S_i' = J S_i x (S_(i-1) + S_(i+1))",
    parameters=(
        spin_chain.PARAMETERS[0],
        Parameter("J", "scalar", "coupling of neighbours: ferromagnet for J > 0", default=1.0),
        spin_chain.PARAMETERS[-1],
    ),
    flow=of_general(spin_chain.flow),
    energy=of_general(spin_chain.energy),
    integrals={"total_spin": total_spin},
    notes="Rings of 3 and 4 sites are integrable, as H is a sum of squares of sums of spins. Longer ones are not; "
    "`lattice-landau-lifshitz` is, with another H.",
)
