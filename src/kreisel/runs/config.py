"""A run as a TOML file: sections [system], [state], [run] and [output]."""

from __future__ import annotations

import runpy
import tomllib
import traceback
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec

from kreisel.bodies import KNOWN, find
from kreisel.errors import InputError, hint, shown
from kreisel.files import place, shallow
from kreisel.record.contract import System
from kreisel.record.model import Model
from kreisel.runs.settings import Settings

SWEEP = ("grid", "list", "random", "draws", "rng", "save", "block", "memory")
SECTIONS = ("system", "state", "run", "output")
SETTINGS = tuple(field.name for field in msgspec.structs.fields(Settings) if field.name != "asked_dt")
OUTPUT = ("path", "figure")
LARGEST_FILE = 16 << 20
FIGURES = (".png", ".pdf", ".svg")


@dataclass(frozen=True)
class Config:
    """A checked configuration; parameters and state are checked by the system itself.

    file: the Python file that defines the system, if it is user-defined.
    """

    name: str
    file: Path | None
    parameters: dict[str, Any]
    state: dict[str, Any]
    orientation: Any
    run: Settings
    path: Path
    figure: Path


def read(path: Path, changes: Sequence[str] = ()) -> Config:
    """Read and check a TOML file, after `changes` such as "run.dt=0.01".

    Relative output paths are relative to the current folder, the file of [system] to the TOML file.
    """
    return parse(changed(_load(path), changes), str(path), path.parent)


def changed(data: dict[str, Any], changes: Sequence[str]) -> dict[str, Any]:
    """The configuration with each "SECTION.KEY=VALUE" in place, VALUE as in TOML; a bare word is a string."""
    for text in changes:
        place, sign, value = (part.strip() for part in text.partition("="))
        section, *keys = place.split(".", 3 if place.startswith("sweep.") else 1)
        if section == "sweep" and len(keys) > 1:  # sweep.grid.state.m[2] is one quantity
            keys = [keys[0], ".".join(keys[1:])]
        if not sign or not value or not keys or not all(keys):
            near = f" Did you mean run.{place}?" if sign and place in SETTINGS else ""
            raise InputError(f"--set takes SECTION.KEY=VALUE, such as run.dt=0.01, got {shown(text)}.{near}")
        table = data
        for key in (section, *keys[:-1]):
            table = table.setdefault(key, {})
            if not isinstance(table, dict):
                raise InputError(f"--set {place}: expected a section {section}, got the value {shown(table)} there.")
        table[keys[-1]] = _toml_value(value)
    return data


def _toml_value(text: str) -> Any:
    try:
        (found,) = tomllib.loads(f"value = {text}").values()
    except (ValueError, RecursionError):
        if any(c in text for c in "[]{}=\n\"'"):
            raise InputError(
                f"--set: expected a value as in TOML, such as 0.01 or [0, 0, 1], got {shown(text)}."
            ) from None
        return text
    return found


def _load(path: Path) -> dict[str, Any]:
    try:
        if path.stat().st_size > LARGEST_FILE:
            raise InputError(f"{path} is larger than {LARGEST_FILE >> 20} MiB: that is no configuration.")
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InputError(f"There is no file {path}. Examples are in the folder examples/.") from None
    except IsADirectoryError:
        raise InputError(f"{path} is a folder; a TOML file was expected.") from None
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}.") from None
    except UnicodeDecodeError:
        raise InputError(f"{path} is not text in UTF-8; a TOML file was expected.") from None
    except (ValueError, RecursionError) as error:  # neither TOML, nor integers of thousands of digits
        raise InputError(f"{path} is not valid TOML: {error}") from None


def read_sweep(path: Path, changes: Sequence[str] = ()) -> tuple[dict[str, Any], Path | None, Path]:
    """The description of a sweep in a TOML file, the file of a user-defined system, and the output path of the sweep.

    The section [sweep] is checked when the sweep begins.  Raises `InputError`.
    """
    return parse_sweep(changed(_load(path), changes), str(path), path.parent)


def parse_sweep(
    data: Mapping[str, Any], source: str = "the configuration", folder: Path = Path()
) -> tuple[dict[str, Any], Path | None, Path]:
    """The sweep of a configuration that is already a dict, as by `read_sweep`."""
    _check_sections(shallow(data, source), (*SECTIONS, "sweep"), source)
    tables = {section: _section(data, section, source) for section in (*SECTIONS, "sweep")}
    _check_keys(tables["sweep"], SWEEP, "sweep", source)
    _check_keys(tables["run"], SETTINGS, "run", source)
    _, file, system = _system(tables["system"], source, folder)
    _check_keys(tables["output"], OUTPUT, "output", source)
    if "figure" in tables["output"]:
        raise InputError(f"{source}: a sweep draws no figure; leave figure out of [output].")
    description = {**{k: dict(tables[k]) for k in ("state", "run", "sweep")}, "system": system}
    return description, file, _output_path(tables["output"], "path", source)


def parse(data: Mapping[str, Any], source: str = "the configuration", folder: Path = Path()) -> Config:
    """Check a configuration that is already a dict; a file named in [system] is looked for in `folder`."""
    _check_sections(shallow(data, source), SECTIONS, source)
    tables = {section: _section(data, section, source) for section in SECTIONS}
    name, file, system = _system(tables["system"], source, folder)
    del system["name"]
    state = dict(tables["state"])
    orientation = state.pop("orientation", None)
    _check_keys(tables["run"], SETTINGS, "run", source)
    if "dt" not in tables["run"]:
        raise InputError(f"{source}: [run] needs dt, a step in the system's unit of time, got nothing.")
    try:
        run = Settings.checked(**tables["run"])
    except InputError as error:
        raise InputError(f"{source}: in [run], {error}") from None
    _check_keys(tables["output"], OUTPUT, "output", source)
    path = _output_path(tables["output"], "path", source)
    drawn = "figure" in tables["output"]
    figure = _output_path(tables["output"], "figure", source) if drawn else path.with_suffix(".png")
    if figure.suffix.lower() not in FIGURES:
        raise InputError(f"{source}: figure must end in {', '.join(FIGURES)}, got {shown(str(figure))}.")
    if path.absolute() in (figure.absolute(), *figure.absolute().parents):
        raise InputError(
            f"{source}: expected a figure beside the archive, got {shown(str(figure))} in or instead of "
            f"{shown(str(path))}. Choose another figure in [output]."
        )
    return Config(name, file, system, state, orientation, run, path, figure)


def _check_sections(data: Mapping[str, Any], known: Sequence[str], source: str) -> None:
    for section in data:
        if section not in known:
            raise InputError(
                f"{source} has a section or key {shown(section)}; expected are {', '.join(known)}."
                f"{hint(section, known)}"
            )


def _system(table: Mapping[str, Any], source: str, folder: Path) -> tuple[str, Path | None, dict[str, Any]]:
    """The name of the system, the file that defines it, and the section without that file."""
    system = dict(table)
    name = system.get("name")
    if not isinstance(name, str):
        raise InputError(
            f'{source} needs `name = "..."` in [system], got {shown(name)}. `kreisel systems` lists the names.'
        )
    file = system.pop("file", None)
    if file is not None and (not isinstance(file, str) or not file.endswith(".py") or "\0" in file):
        raise InputError(f'{source}: file in [system] must name a Python file, such as "my_top.py", got {shown(file)}.')
    return name, folder / Path(file).expanduser() if file else None, system


def _output_path(output: Mapping[str, Any], key: str, source: str) -> Path:
    if key not in output:
        raise InputError(f'{source}: [output] needs {key}, such as {key} = "top.zarr", got nothing.')
    return place(output[key], f"{source}: {key} in [output] must name a file or folder to make")


def _section(data: Mapping[str, Any], section: str, source: str) -> Mapping[str, Any]:
    table = data.get(section)
    if not isinstance(table, Mapping):
        got = "nothing" if table is None else repr(table)
        raise InputError(f"{source} needs a section [{section}], got {got}. See examples/lagrange-top.toml.")
    return table


def _check_keys(table: Mapping[str, Any], names: Sequence[str], section: str, source: str) -> None:
    for key in table:
        if key not in names:
            raise InputError(
                f"{source}: [{section}] has the key {shown(key)}; expected are {', '.join(names)}.{hint(key, names)}"
            )


def load_system(name: str, file: Path | None) -> System:
    """The system of that name: from the registry, or from the top level of `file`.  Raises `InputError`."""
    if file is None:
        return find(name)
    if not file.is_file():
        raise InputError(f"There is no file {file}, which [system] names; it is looked for beside the TOML file.")
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
