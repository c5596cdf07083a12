"""The systems, one page each: the file `lagrange_top.py` states as `SYSTEM` the record of lagrange-top.

A page is imported when its system is first asked for.
"""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import TYPE_CHECKING

from kreisel.errors import InputError, hint, shown

if TYPE_CHECKING:
    from kreisel.record.contract import System

__all__ = ["NAMED", "REGISTRY", "Records", "find"]


class Records(Mapping[str, "System"]):
    """Systems by name; load(name) is called when one is asked for."""

    def __init__(self, names: Iterable[str], load: Callable[[str], System]):
        self._names, self._load = dict.fromkeys(names), load

    def __getitem__(self, name: str) -> System:
        if name not in self._names:
            raise KeyError(name)
        return self._load(name)

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)

    def __contains__(self, name: object) -> bool:
        return name in self._names


def _stated(name: str) -> System:
    """The record of a page, which pickle and copy find again by its name."""
    system: System = importlib.import_module(f"{__name__}.{name.replace('-', '_')}").SYSTEM
    return system.remade_by(find, name)


def find(name: str, registry: Mapping[str, System] | None = None, bodies: Iterable[str] = ()) -> System:
    """The system of that name.  Raises `InputError` with the nearest name, also of `bodies` of `kr.physical`."""
    registry = REGISTRY if registry is None else registry
    if name not in registry:
        names = list(dict.fromkeys([*registry, *bodies]))
        raise InputError(f"No system is called {shown(name)}.{hint(name, names)} There are: {', '.join(names)}.")
    return registry[name]


REGISTRY = Records((page.name.replace("_", "-") for page in pkgutil.iter_modules(__path__)), _stated)
_NAMES = {  # LagrangeTopSU2 for lagrange-top-su2
    "".join(word.upper() if word[-1].isdigit() else word.capitalize() for word in name.split("-")): name
    for name in REGISTRY
}
NAMED = Records(_NAMES, lambda name: REGISTRY[_NAMES[name]])  # as attributes of `kreisel`
