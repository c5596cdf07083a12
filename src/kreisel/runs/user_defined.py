"""Systems that a user defines in a Python file."""

from __future__ import annotations

import runpy
import traceback
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from kreisel.bodies import KNOWN, known_system
from kreisel.errors import InputError, hint, shown
from kreisel.record.body_frame import BodyFrame
from kreisel.record.contract import System
from kreisel.record.model import Model


def load_system(
    name: str, file: Path | None, values: Mapping[str, Any] | None = None, frame: BodyFrame | None = None
) -> System:
    """The system of that name: a known one, with these parameters, or from `file`.  Raises `InputError`."""
    if file is None:
        return known_system(name, values or {}, frame)
    if not file.is_file():
        raise InputError(f"No file {file}, which [system] names; it is looked for next to the TOML file.")
    own = own_systems(executed(file))
    if name in own:
        if own[name].name in KNOWN:
            raise InputError(
                f"{file} calls its system {shown(own[name].name)}, as one of Kreisel's is called. Choose another name."
            )
        return own[name]
    raise InputError(
        f"{file} defines no system called {shown(name)} at its top level.{hint(name, own)} "
        f"There are: {', '.join(own) or 'none'}; make one with kreisel.reduction.system(name, ...) or "
        "kr.perturbed(...)."
    )


def executed(file: Path) -> dict[str, Any]:
    """The names that a Python file defines at its top level.  Raises `InputError` with the line of any exception."""
    try:
        return runpy.run_path(str(file))
    except InputError as error:
        raise InputError(f"{file}: {error}") from error
    except Exception as error:  # any exception of a user's code
        where = [f for f in traceback.extract_tb(error.__traceback__) if f.filename == str(file)]
        line = f", line {where[-1].lineno}" if where else f", line {getattr(error, 'lineno', '?')}"
        raise InputError(f"{file}{line}: {type(error).__name__}: {error}") from error


def own_systems(defined: dict[str, Any]) -> dict[str, System]:
    """The user-defined systems among them; perturbed systems also by the name of the variable."""
    systems = {value.name: value for value in defined.values() if isinstance(value, System)}
    perturbed = {
        name: value.system
        for variable, value in defined.items()
        if isinstance(value, Model) and value.system.perturbation is not None
        for name in (variable, value.system.name)
    }
    return {k: v for k, v in (systems | perturbed).items() if KNOWN.get(k) is not v}
