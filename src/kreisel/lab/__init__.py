"""kr.lab: the laws, and instruments that tell whether a map is integrable.

kr.lab.investigate(kr.Clebsch(b=(1, 2, 4)))          # one page: every instrument, its evidence, a verdict
kr.lab.investigate(step, names=("x", "y"))           # a user-defined rational map
kr.lab.search                                        # families of discrete Lagrangians, ranked
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from kreisel.lab.investigation import investigate

_MODULES = tuple(
    "brackets certified darboux dynamics exact growth integrals laws modular paper questions search subject".split()
)

__all__ = ["investigate"]


def __getattr__(name: str) -> Any:
    if name == "investigate":
        from kreisel.lab.investigation import investigate

        return investigate
    if name in _MODULES:
        return importlib.import_module(f"kreisel.lab.{name}")
    raise AttributeError(f"module 'kreisel.lab' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__, *_MODULES})
