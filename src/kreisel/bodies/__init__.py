"""Predefined bodies under forces: each file here states some records as `BODIES`."""

from __future__ import annotations

import importlib
from collections import ChainMap
from typing import TYPE_CHECKING

from kreisel import system
from kreisel.system import REGISTRY, Records

if TYPE_CHECKING:
    from collections.abc import Mapping

    from kreisel.record.contract import System

__all__ = ["BODIES", "KNOWN", "find"]

_PAGES = {
    "satellite": "satellite",
    "satellite-with-wheel": "satellite",
    "submerged-body": "submerged",
    "binary": "binary",
    "binary-with-third-body": "binary",
    "binary-with-moon": "binary",
}


def _stated(name: str) -> System:
    """The record of a page, which pickle and copy find by its name."""
    page = importlib.import_module(f"{__name__}.{_PAGES[name]}")
    return next(body.remade_by(find, name) for body in page.BODIES if body.name == name)


def find(name: str) -> System:
    """The system or body of that name.  Raises `InputError` with the nearest name."""
    return system.find(name, KNOWN)


BODIES = Records(_PAGES, _stated)
KNOWN: Mapping[str, System] = ChainMap(BODIES, REGISTRY)  # type: ignore[arg-type]  # REGISTRY first
