"""Predefined bodies under forces: each file here states some records as `BODIES`."""

from __future__ import annotations

import importlib
from collections import ChainMap
from typing import TYPE_CHECKING, Any

from kreisel import system
from kreisel.record.model import Model
from kreisel.record.perturbation import WITH_WHEELS
from kreisel.system import REGISTRY, Records

if TYPE_CHECKING:
    from collections.abc import Mapping

    from kreisel.record.contract import System
    from kreisel.record.units import BodyFrame

__all__ = ["BODIES", "KNOWN", "find", "known_system"]

_PAGES = {
    "satellite": "satellite",
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


def known_system(name: str, values: Mapping[str, Any], frame: BodyFrame) -> System:
    """The system of that name and of these parameters, which state wheels if it has some.  Raises `InputError`."""
    body = find(name.removesuffix(WITH_WHEELS))
    if body.name == name:
        return body
    from kreisel.forces.control import with_wheels

    letters = {p.letter for p in body.parameters}
    parameters, of_wheels = (
        {k: v for k, v in values.items() if (k in letters) == of_body} for of_body in (True, False)
    )
    return with_wheels(Model(body, parameters, frame), of_wheels).system


BODIES = Records(_PAGES, _stated)
KNOWN: Mapping[str, System] = ChainMap(BODIES, REGISTRY)  # type: ignore[arg-type]  # REGISTRY first
