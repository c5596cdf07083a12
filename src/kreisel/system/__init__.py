"""The systems, one page each, found by themselves: each file here that states a `SYSTEM` is one."""

import importlib
import pkgutil
from collections.abc import Mapping

from kreisel.errors import InputError, hint, shown
from kreisel.record.contract import System

__all__ = ["NAMED", "REGISTRY", "find"]


def _found_systems() -> dict[str, System]:
    modules = [importlib.import_module(f"{__name__}.{page.name}") for page in pkgutil.iter_modules(__path__)]
    records = [module.SYSTEM for module in modules if hasattr(module, "SYSTEM")]
    return {system.name: system.remade_by(find, system.name) for system in records}


def _class_name(name: str) -> str:
    """LagrangeTopSU2 for lagrange-top-su2."""
    return "".join(part.upper() if part[-1].isdigit() else part.capitalize() for part in name.split("-"))


def find(name: str, known: Mapping[str, System] | None = None) -> System:
    """The system of that name.  Raises `InputError` with the nearest name."""
    known = REGISTRY if known is None else known
    if name not in known:
        raise InputError(f"No system is called {shown(name)}.{hint(name, known)} There are: {', '.join(known)}.")
    return known[name]


REGISTRY = _found_systems()
NAMED = {_class_name(name): system for name, system in REGISTRY.items()}  # as attributes of `kreisel`
