"""Ready-made bodies under forces, found by themselves: each file here that states `BODIES` has some."""

import importlib
import pkgutil

from kreisel import system
from kreisel.record.contract import System
from kreisel.system import REGISTRY

__all__ = ["BODIES", "KNOWN", "find"]


def _found_bodies() -> dict[str, System]:
    modules = [importlib.import_module(f"{__name__}.{page.name}") for page in pkgutil.iter_modules(__path__)]
    found = [body for module in modules for body in getattr(module, "BODIES", ())]
    return {body.name: body.remade_by(find, body.name) for body in found}


def find(name: str) -> System:
    """The system or body of that name.  Raises `InputError` with the nearest name."""
    return system.find(name, KNOWN)


BODIES = _found_bodies()
KNOWN = REGISTRY | BODIES  # whatever a name stands for
