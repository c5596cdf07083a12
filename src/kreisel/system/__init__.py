"""The registry: one line a system."""

from kreisel.errors import InputError, nearest, shown
from kreisel.record.contract import System
from kreisel.system.clebsch import SYSTEM as Clebsch
from kreisel.system.clebsch_body import SYSTEM as ClebschBody
from kreisel.system.clebsch_general import SYSTEM as ClebschGeneral
from kreisel.system.euler_top import SYSTEM as EulerTop
from kreisel.system.goryachev_chaplygin import SYSTEM as GoryachevChaplygin
from kreisel.system.heavy_top import SYSTEM as HeavyTop
from kreisel.system.hess_appelrot import SYSTEM as HessAppelrot
from kreisel.system.kirchhoff import SYSTEM as Kirchhoff
from kreisel.system.kirchhoff_case import SYSTEM as KirchhoffCase
from kreisel.system.kovalevskaya_gyrostat import SYSTEM as KovalevskayaGyrostat
from kreisel.system.kovalevskaya_top import SYSTEM as KovalevskayaTop
from kreisel.system.lagrange_top import SYSTEM as LagrangeTop
from kreisel.system.lagrange_top_moving import SYSTEM as LagrangeTopMoving
from kreisel.system.lagrange_top_su2 import SYSTEM as LagrangeTopSU2
from kreisel.system.lagrange_top_su2_moving import SYSTEM as LagrangeTopSU2Moving
from kreisel.system.lyapunov import SYSTEM as Lyapunov
from kreisel.system.manakov_top import SYSTEM as ManakovTop
from kreisel.system.neumann import SYSTEM as Neumann
from kreisel.system.neumann_veselov import SYSTEM as NeumannVeselov
from kreisel.system.quadratic_potential import SYSTEM as QuadraticPotential
from kreisel.system.ratiu_bitop import SYSTEM as RatiuBitop
from kreisel.system.ratiu_top import SYSTEM as RatiuTop
from kreisel.system.rosochatius import SYSTEM as Rosochatius
from kreisel.system.steklov import SYSTEM as Steklov
from kreisel.system.steklov_lyapunov import SYSTEM as SteklovLyapunov
from kreisel.system.symmetric_top import SYSTEM as SymmetricTop

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
