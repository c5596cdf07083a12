"""REBOUND, loaded when it is needed."""

from __future__ import annotations

from functools import cache
from types import ModuleType

from kreisel.errors import InputError

OFFSETS = {"x": 0, "y": 8, "z": 16, "vx": 24, "vy": 32, "vz": 40, "m": 72}  # bytes, of a particle


@cache
def rebound() -> ModuleType:
    """The module.  Raises `InputError` where it is not installed or keeps its particles otherwise."""
    try:
        import rebound as library
    except ImportError as error:
        raise InputError("expected REBOUND, got none. Install it: pip install 'kreisel[rebound]'.") from error
    found = {name: getattr(library.Particle, name).offset for name in OFFSETS}
    if found != OFFSETS:
        raise InputError(
            f"expected REBOUND 5, whose particles begin with x, v, a, m, got {library.__version__}. Usual cause: "
            "another version than the one that kreisel[rebound] asks for."
        )
    return library
