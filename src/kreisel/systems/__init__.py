"""The registry: one line a system."""

from kreisel.errors import InputError, nearest, shown
from kreisel.record.contract import System
from kreisel.systems.clebsch import SYSTEM as Clebsch
from kreisel.systems.clebsch_body import SYSTEM as ClebschBody
from kreisel.systems.clebsch_general import SYSTEM as ClebschGeneral
from kreisel.systems.euler_top import SYSTEM as EulerTop
from kreisel.systems.goryachev_chaplygin import SYSTEM as GoryachevChaplygin
from kreisel.systems.heavy_top import SYSTEM as HeavyTop
from kreisel.systems.hess_appelrot import SYSTEM as HessAppelrot
from kreisel.systems.kirchhoff import SYSTEM as Kirchhoff
from kreisel.systems.kirchhoff_case import SYSTEM as KirchhoffCase
from kreisel.systems.kovalevskaya_gyrostat import SYSTEM as KovalevskayaGyrostat
from kreisel.systems.kovalevskaya_top import SYSTEM as KovalevskayaTop
from kreisel.systems.lagrange_top import SYSTEM as LagrangeTop
from kreisel.systems.lagrange_top_moving import SYSTEM as LagrangeTopMoving
from kreisel.systems.lagrange_top_su2 import SYSTEM as LagrangeTopSU2
from kreisel.systems.lagrange_top_su2_moving import SYSTEM as LagrangeTopSU2Moving
from kreisel.systems.lyapunov import SYSTEM as Lyapunov
from kreisel.systems.manakov_top import SYSTEM as ManakovTop
from kreisel.systems.neumann import SYSTEM as Neumann
from kreisel.systems.neumann_veselov import SYSTEM as NeumannVeselov
from kreisel.systems.quadratic_potential import SYSTEM as QuadraticPotential
from kreisel.systems.ratiu_bitop import SYSTEM as RatiuBitop
from kreisel.systems.ratiu_top import SYSTEM as RatiuTop
from kreisel.systems.rosochatius import SYSTEM as Rosochatius
from kreisel.systems.steklov import SYSTEM as Steklov
from kreisel.systems.steklov_lyapunov import SYSTEM as SteklovLyapunov
from kreisel.systems.symmetric_top import SYSTEM as SymmetricTop

__all__ = [
    "REGISTRY",
    "Clebsch",
    "ClebschBody",
    "ClebschGeneral",
    "EulerTop",
    "GoryachevChaplygin",
    "HeavyTop",
    "HessAppelrot",
    "Kirchhoff",
    "KirchhoffCase",
    "KovalevskayaGyrostat",
    "KovalevskayaTop",
    "LagrangeTop",
    "LagrangeTopMoving",
    "LagrangeTopSU2",
    "LagrangeTopSU2Moving",
    "Lyapunov",
    "ManakovTop",
    "Neumann",
    "NeumannVeselov",
    "QuadraticPotential",
    "RatiuBitop",
    "RatiuTop",
    "Rosochatius",
    "Steklov",
    "SteklovLyapunov",
    "SymmetricTop",
    "find",
]

REGISTRY: dict[str, System] = {
    system.name: system
    for system in (
        HeavyTop,
        LagrangeTop,
        LagrangeTopMoving,
        SymmetricTop,
        LagrangeTopSU2,
        LagrangeTopSU2Moving,
        Kirchhoff,
        ClebschGeneral,
        Clebsch,
        Neumann,
        NeumannVeselov,
        Rosochatius,
        EulerTop,
        ManakovTop,
        QuadraticPotential,
        ClebschBody,
        KovalevskayaTop,
        KovalevskayaGyrostat,
        GoryachevChaplygin,
        HessAppelrot,
        KirchhoffCase,
        Steklov,
        Lyapunov,
        SteklovLyapunov,
        RatiuTop,
        RatiuBitop,
    )
}


def find(name: str) -> System:
    """The system of that name.  Raises `InputError` with the nearest name."""
    if name not in REGISTRY:
        raise InputError(
            f"No system is called {shown(name)}.{nearest(name, REGISTRY)} There are: {', '.join(REGISTRY)}."
        )
    return REGISTRY[name]
