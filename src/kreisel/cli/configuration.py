"""A run as a TOML file: sections [system] or [body], [state], [run] and [output].

A body is a table whose keys are the arguments of the constructors in Python:

    {"kind": "satellite", "inertia": [[...]], "orbit": {"altitude": "500 km", "inclination": "97 deg"}}

`kind` is a class of `kr.physical`, "heavy-body" for `HeavyBody`.  `shape` names one of its class methods, "cubesat"; it
is not needed if the table has an argument that only this method has.  Inner tables are records, for arguments of such a
type, or `kind` names a class or function of `kr.physical`, "bdot"; names are constants, "saturn".  Instead of inertia
and mass there may be a file, `mesh` or `robot`.
"""

from __future__ import annotations

import copy
import inspect
import re
import sys
import tomllib
import types
import typing
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, is_dataclass
from pathlib import Path
from typing import Any

import msgspec

from kreisel import physical
from kreisel.errors import Faults, InputError, hint, shown
from kreisel.files import place, shallow
from kreisel.physical import Ensemble, FreeBody
from kreisel.physical.body import Varied
from kreisel.record.body import Body
from kreisel.record.contract import System
from kreisel.record.model import Model, State
from kreisel.record.units import QUANTITY, si
from kreisel.runs.in_si import scaled_settings
from kreisel.runs.operations import executed, load_system
from kreisel.runs.settings import Settings
from kreisel.sweeps.ensemble import of_body_in_si, of_scaled_system, user_defined

SWEEP = ("grid", "list", "random", "draws", "rng", "save", "block", "memory")
VARIED = ("body", "state", "system", "run")
SECTIONS = ("system", "body", "state", "run", "output")
SETTINGS = tuple(field.name for field in msgspec.structs.fields(Settings) if field.name != "asked_dt")
DEPTHS = {"sweep": 3, "body": -1, "state": -1}  # of the tables in a section, for --set; -1: any
OUTPUT = ("path", "figure")
LARGEST_FILE = 16 << 20
FIGURES = (".png", ".pdf", ".svg")
READERS = (physical.read_mesh, physical.read_robot)
ABOUT_CENTRE = "about_centre"
Table = Mapping[str, Any]


@dataclass(frozen=True)
class Config:
    """A checked configuration: the name of a system or of a kind of body, its model, its start, and the run.

    For a body, everything is in the form of the state, and the run of the model is in SI.
    """

    name: str
    model: Model
    state: State
    orientation: Any
    run: Settings
    path: Path
    figure: Path
    body: Body | None = None

    @property
    def doubts(self) -> Sequence[str]:
        """Sentences on models of the body that do not hold until the end of the run."""
        end = self.run.t_start + self.run.time
        return () if self.body is None else self.body._doubts(end * self.model.body_frame.time_unit)


def read(path: Path, changes: Sequence[str] = ()) -> Config:
    """Read and check a TOML file, after `changes` such as "run.dt=0.01".

    Relative output paths are relative to the current folder, files that it names to the TOML file.
    """
    return parse(changed(_load(path), changes), str(path), path.parent)


def changed(data: dict[str, Any], changes: Sequence[str]) -> dict[str, Any]:
    """The configuration with each "SECTION.KEY=VALUE" in place, VALUE as in TOML; a bare word is a string."""
    for text in changes:
        place, sign, value = (word.strip() for word in text.partition("="))
        section, *keys = place.split(".", DEPTHS.get(place.partition(".")[0], 1))
        if section == "sweep" and len(keys) > 1:  # sweep.grid.state.m[2] is one quantity
            keys = [keys[0], ".".join(keys[1:])]
        if not sign or not value or not keys or not all(keys):
            near = f" Did you mean run.{place}?" if sign and place in SETTINGS else ""
            raise InputError(f"--set: expected SECTION.KEY=VALUE, such as run.dt=0.01, got {shown(text)}.{near}")
        table = data
        for key in (section, *keys[:-1]):
            table = table.setdefault(key, {})
            if not isinstance(table, dict):
                raise InputError(f"--set {place}: expected a section {section}, got the value {shown(table)} there.")
        try:
            (table[keys[-1]],) = tomllib.loads(f"value = {value}").values()
        except (ValueError, RecursionError):
            if any(c in value for c in "[]{}=\n\"'"):
                raise InputError(
                    f"--set: expected a value as in TOML, such as 0.01 or [0, 0, 1], got {shown(value)}."
                ) from None
            table[keys[-1]] = value
    return data


def _load(path: Path) -> dict[str, Any]:
    try:
        if path.stat().st_size > LARGEST_FILE:
            raise InputError(f"{path} is larger than {LARGEST_FILE >> 20} MiB: it is not a configuration.")
        return tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except FileNotFoundError:
        raise InputError(f"No file {path}. Examples are in the folder examples/.") from None
    except IsADirectoryError:
        raise InputError(f"{path} is a folder; a TOML file was expected.") from None
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}.") from None
    except UnicodeDecodeError:
        raise InputError(f"{path} is not text in UTF-8; a TOML file was expected.") from None
    except (ValueError, RecursionError) as error:  # neither TOML, nor integers of thousands of digits
        twice = " The key is there twice; remove one." * ("overwrite a value" in str(error))
        raise InputError(f"{path} is not valid TOML: {error}.{twice}") from None


def read_sweep(path: Path, changes: Sequence[str] = ()) -> tuple[dict[str, Any], Path | System | None, Path]:
    """The description of a sweep in a TOML file, a user-defined system or its file, and the output path of the sweep.

    The section [sweep] is checked when the sweep begins.  Raises `InputError`.
    """
    return parse_sweep(changed(_load(path), changes), str(path), path.parent)


def parse_sweep(
    data: Mapping[str, Any], source: str = "the configuration", folder: Path = Path()
) -> tuple[dict[str, Any], Path | System | None, Path]:
    """The sweep of a configuration that is already a dict, as by `read_sweep`."""
    faults = Faults()
    tables = _tables(shallow(data, source), (*SECTIONS, "sweep"), faults)
    spec = dict(tables["sweep"])
    varied = {name: spec.pop(name) for name in [*spec] if name.partition(".")[0] in VARIED}
    if varied:  # [sweep] body.mass = [...] is a grid
        spec["grid"] = {**spec.get("grid", {}), **varied}
    tables["sweep"] = spec
    for section, names in (("sweep", SWEEP), ("run", SETTINGS), ("output", OUTPUT)):
        _check_keys(tables[section], names, section, faults)
    if "figure" in tables["output"]:
        faults.add("a sweep draws no figure; leave figure out of [output].")
    path = _output_path(tables["output"], "path", faults)
    description = {k: dict(tables[k]) for k in ("state", "run", "sweep")}
    code: Path | System | None = None
    if "body" in tables:
        subject = _body(tables, folder, faults)
        if subject.model is not None and not faults.messages:
            sections, model = _described(subject, tables, folder)
            description |= sections
            code = user_defined(model, description)
    else:
        _, code, description["system"] = _system(tables["system"], folder, faults)
    faults.report(source)
    return description, code, path


def _described(subject: Subject, tables: Mapping[str, Mapping[str, Any]], folder: Path) -> tuple[dict[str, Any], Model]:
    """The sections of a sweep that begins from a body, in the form of its system, and the model of all lanes."""
    model, state, run = subject.model, subject.state, tables["run"]
    assert model is not None and state is not None and subject.body is not None
    if not of_scaled_system(model, tables["sweep"]):

        def bodies(changes: list[dict[str, Any]]) -> Body:
            members = dict[int, Any]()
            for lane, changes_of_lane in enumerate(changes):
                if id(changes_of_lane) in members:  # equal to the body of an earlier lane
                    continue
                table, faults = copy.deepcopy(dict(tables["body"])), Faults()
                for name, change in changes_of_lane.items():
                    *sections, key = name.split(".")
                    inner = table
                    for section in sections:
                        inner = inner.setdefault(section, {})
                    inner[key] = change(inner.get(key))
                members[id(changes_of_lane)] = _body({**tables, "body": table}, folder, faults).body
                faults.report(f"Lane {lane}")
            return Ensemble([members[id(changes_of_lane)] for changes_of_lane in changes])

        return of_body_in_si(subject.body, tables["state"], run, tables["sweep"], bodies)
    frame = {"body": model.body_frame.table} if model.body_frame else {}
    start = {**state.axial, **({} if state.orientation is None else {"orientation": state.orientation})}
    system = {"name": model.system.name, **model.params}
    return {**frame, "system": system, "state": start, "run": scaled_settings(model, run)}, model


def parse(data: Mapping[str, Any], source: str = "the configuration", folder: Path = Path()) -> Config:
    """Check a configuration that is already a dict; files named in it are looked for in `folder`.

    Raises `InputError`, with all mistakes that were found.
    """
    faults = Faults()
    tables = _tables(shallow(data, source), SECTIONS, faults)
    subject = _body(tables, folder, faults) if "body" in tables else _of_system(tables, folder, faults)
    run = _settings(tables["run"], subject, faults)
    _check_keys(tables["output"], OUTPUT, "output", faults)
    path = _output_path(tables["output"], "path", faults)
    drawn = "figure" in tables["output"]
    figure = _output_path(tables["output"], "figure", faults) if drawn else path.with_suffix(".png")
    if figure.suffix.lower() not in FIGURES:
        faults.add(f"[output] figure must end in {', '.join(FIGURES)}, got {shown(str(figure))}.")
    if path.absolute() in (figure.absolute(), *figure.absolute().parents):
        faults.add(
            f"[output] expected a figure next to the archive, got {shown(str(figure))} in or instead of "
            f"{shown(str(path))}. Choose another figure."
        )
    faults.report(source)
    assert subject.model is not None and subject.state is not None and run is not None
    return Config(subject.name, subject.model, subject.state, subject.orientation, run, path, figure, subject.body)


@dataclass(frozen=True)
class Subject:
    """A model and its start, None after a mistake; orientation: in the form of the state."""

    name: str
    model: Model | None = None
    state: State | None = None
    orientation: Any = None
    body: Body | None = None


def _body(tables: Mapping[str, Mapping[str, Any]], folder: Path, faults: Faults) -> Subject:
    table = dict(tables["body"])
    names: dict[str, Any] = {}
    if (file := _python_file(table.pop("file", None), "body", folder, faults)) is not None:
        with faults.noted("[body] file"):
            names = executed(file)
    reader = Reader(faults, folder, names)
    kind = reader.kind_of(table, "body")
    if kind is None:
        return Subject("")
    body = reader.body(table, "body")
    if isinstance(body, Ensemble):
        faults.add(
            f"[body] expected the values of one body, got lists for {len(body.members)}. Usual cause: a list for a "
            "number, or rows for a vector. For several bodies, use `kreisel sweep` with [sweep.grid]."
        )
        return Subject("")
    state = reader.state(kind, body, tables["state"], "state")
    name = str(table["kind"])
    if body is None or state is None:
        return Subject(name)
    with faults.noted("[body]"):
        return Subject(name, body.in_si(), state, state.orientation, body)
    return Subject(name)


def _of_system(tables: Mapping[str, Mapping[str, Any]], folder: Path, faults: Faults) -> Subject:
    name, file, parameters = _system(tables["system"], folder, faults)
    parameters.pop("name", None)
    start = dict(tables["state"])
    orientation = start.pop("orientation", None)
    subject = Subject(name)
    if name:
        with faults.noted("[system]"):
            subject = Subject(name, load_system(name, file, parameters)(**parameters))
    if subject.model is not None:
        with faults.noted("[state]"):
            return Subject(name, subject.model, subject.model.state(**start), orientation)
    return subject


def _settings(run: Mapping[str, Any], subject: Subject, faults: Faults) -> Settings | None:
    _check_keys(run, SETTINGS, "run", faults)
    asked, model = {k: v for k, v in run.items() if k in SETTINGS}, subject.model
    if "dt" not in asked:
        faults.add("[run] needs dt, a step, got nothing.")
        return None
    if model is None or model.body_frame:  # durations in the unit of the model; without one, to check them
        usual, requested = model or FreeBody((1.0, 1.0, 1.0)).in_si(), dict(asked)
        step, before = 1.0, len(faults.messages)
        for key in [k for k in ("dt", "t_start", "t_end", "times", "every", "impulses") if k in asked]:
            unit = 1.0 if key == "dt" else asked["dt"]
            harmless = {"dt": unit, "t_start": 0.0, "t_end": 1e6 * unit, "times": (unit,), "every": 1, "impulses": ()}
            asked[key] = harmless[key]  # after a mistake, so that the others can be checked
            with faults.noted("[run]"):
                asked[key] = scaled_settings(usual, {"dt": step, key: requested[key]})[key]
                step = requested["dt"] if key == "dt" else step
        if len(faults.messages) > before and asked.get("t_end", 0) > 0:  # not in steps of another size
            asked["t_end"] = 1e6 * asked["dt"]
    try:
        return Settings.checked(**asked)
    except InputError as error:
        messages: list[str] = []
        for name in [name for name in asked if name != "tol"]:  # the mistakes of each among others that are usual
            among = {"dt": 1.0} if name in ("t_end", "times") else {"dt": 1.0, "steps": 10**9}
            try:
                Settings.checked(**{**among, name: asked[name]})
            except InputError as alone:
                messages += alone.args
        for message in messages or error.args:
            faults.add(f"[run] {message}")
    return None


def _tables(data: Mapping[str, Any], names: Sequence[str], faults: Faults) -> dict[str, Mapping[str, Any]]:
    """The sections of a configuration, each a table; either `system` or `body`."""
    for section in data:
        if section not in names:
            advice = " A file with [sweep] is for `kreisel sweep`." if section == "sweep" else hint(section, names)
            faults.add(f"unknown section or key {shown(section)}; expected {', '.join(names)}.{advice}")
    subject = "body" if "body" in data else "system"
    if {"body", "system"} <= data.keys():
        faults.add("expected a section [system] or [body], got both. A body of kr.physical is in [body].")
    out: dict[str, Mapping[str, Any]] = {}
    for section in names:
        table = data.get(section, {} if (section, subject) == ("state", "body") else None)
        if section in ("system", "body") and section != subject:
            continue
        if not isinstance(table, Mapping):
            got = "nothing" if table is None else shown(table)
            faults.add(f"needs a section [{section}], got {got}. `kreisel new NAME` writes a file with all sections.")
            table = {}
        out[section] = table
    return out


def _system(table: Mapping[str, Any], folder: Path, faults: Faults) -> tuple[str, Path | None, dict[str, Any]]:
    """The name of the system, the file that defines it, and the section without that file."""
    system = dict(table)
    name, file = system.get("name"), _python_file(system.pop("file", None), "system", folder, faults)
    if not isinstance(name, str) or not name:
        faults.add(f'[system] needs `name = "..."`, got {shown(name)}. `kreisel systems` lists the names.')
        name = ""
    return name, file, system


def _python_file(file: Any, section: str, folder: Path, faults: Faults) -> Path | None:
    if file is None:
        return None
    if not isinstance(file, str) or not file.endswith(".py") or "\0" in file:
        faults.add(f'[{section}] file must name a Python file, such as "my_top.py", got {shown(file)}.')
        return None
    return folder / Path(file).expanduser()


def _output_path(output: Mapping[str, Any], key: str, faults: Faults) -> Path:
    """A path of the section [output]; after a mistake one that may be used in its place."""
    if key not in output:
        if output or not faults.messages:  # else the section is missing
            faults.add(f'[output] needs {key}, such as {key} = "top.zarr", got nothing.')
    else:
        with faults.noted("[output]"):
            return place(output[key], f"{key} must name a file or folder to make")
    return Path("top.zarr" if key == "path" else "top.png")


def _check_keys(table: Mapping[str, Any], names: Sequence[str], section: str, faults: Faults) -> None:
    for key in table:
        if key not in names:
            faults.add(f"[{section}] has the key {shown(key)}; expected are {', '.join(names)}.{hint(key, names)}")


# -- bodies from plain tables ----------------------------------------------------------------------


def kinds() -> dict[str, type[Body]]:
    """The classes of bodies by their names in a file."""
    bodies = {name: value for name, value in parts().items() if isinstance(value, type) and issubclass(value, Varied)}
    return {name: value for name, value in bodies.items() if is_dataclass(value)}


def parts() -> dict[str, Callable[..., Any]]:
    """Classes and functions of `kr.physical` by their names in a file: "heavy-body", "bdot", "eddy-currents"."""
    named = {name: getattr(physical, name) for name in physical.__all__}
    callables = {name: value for name, value in named.items() if inspect.isclass(value) or inspect.isfunction(value)}
    return {re.sub(r"(?<=[a-z])(?=[A-Z])|_", "-", name).lower(): value for name, value in callables.items()}


@dataclass(frozen=True)
class Reader:
    """Builds bodies and their states; mistakes are noted in `faults`.

    folder   of the TOML file, to which paths of files are relative
    names    values of a user's Python file, for texts that name them
    """

    faults: Faults
    folder: Path = Path()
    names: Table = field(default_factory=dict)

    def kind_of(self, table: Table, where: str, names: Mapping[str, Any] | None = None) -> Any:
        """The class or function that a table names, among `names`, by default those of bodies; None after a mistake."""
        names, name = kinds() if names is None else names, table.get("kind")
        if isinstance(name, str) and name in names:
            return names[name]
        self.faults.add(f"[{where}] kind: expected one of {', '.join(names)}, got {shown(name)}.{hint(name, names)}")
        return None

    def body(self, table: Table, where: str = "body", names: Mapping[str, Any] | None = None) -> Any:
        """The body, or another part, of a table; None after a mistake."""
        kind = self.kind_of(table, where, names)
        return kind and self.record(kind, {k: v for k, v in table.items() if k != "kind"}, where)

    def state(self, kind: type[Body], body: Body | None, table: Table, where: str = "state") -> State | None:
        """The state of a body; without it, only the names of the arguments are checked."""
        before = len(self.faults.messages)
        call = kind.state if body is None else body.state
        self._check_names(call, table, where)
        values = {k: self._quantity(v, f"{where}.{k}") for k, v in table.items()}
        if body is None or len(self.faults.messages) > before:
            return None
        with self.faults.noted(f"[{where}]"):
            return body.state(**values)
        return None

    def record(self, kind: Callable[..., Any], arguments: Table, where: str) -> Any:
        """The record of a table; None after a mistake."""
        before, table = len(self.faults.messages), dict(arguments)
        measures = self._measures(kind, table, where)
        call = self._constructor(kind, table, measures, where)
        if call is None:
            return None
        names = {k: v for k, v in measures.items() if k in inspect.signature(call).parameters and k not in table}
        self._check_names(call, {**names, **table}, where)
        hints = {**types_of(kind), **types_of(call)}
        values = {k: self._value(v, hints.get(k), f"{where}.{k}") for k, v in table.items()}
        if len(self.faults.messages) > before:
            return None
        with self.faults.noted(f"[{where}]"):
            return call(**names, **values)
        return None

    def _measures(self, kind: Callable[..., Any], table: dict[str, Any], where: str) -> dict[str, Any]:
        """Mass, inertia and centre of mass from the file that a table names, whose arguments are removed from it."""
        for reader in READERS:
            first, *_ = names = list(inspect.signature(reader).parameters)
            if first not in table or kind not in kinds().values():
                continue
            values = {k: table.pop(k) for k in names if k in table}
            if "inertia" not in inspect.signature(kind).parameters:
                self.faults.add(f"[{where}] {first}: expected a body with an inertia tensor, such as heavy-body.")
                return {}
            with self.faults.noted(f"[{where}]"):
                path = values.pop(first)
                measures = reader(self.folder / path if isinstance(path, str) else path, **values)
                return {**measures._asdict(), "arm": measures.center_of_mass}
            return dict.fromkeys(("mass", "inertia", "center_of_mass", "arm"))
        return {}

    def _constructor(self, kind: Any, table: dict[str, Any], measures: Table, where: str) -> Callable[..., Any] | None:
        """The class, or the class method that `shape` names or that the keys of a table belong to."""
        methods = _class_methods(kind)
        if "shape" in table:
            shape = table.pop("shape")
            name = shape.replace("-", "_") if isinstance(shape, str) else ""
            if name not in methods:
                got = f"{shown(shape)}.{hint(name, methods)}"
                self.faults.add(f"[{where}] shape: expected one of {', '.join(methods)}, got {got}")
            return methods.get(name)
        if measures and ABOUT_CENTRE in methods:
            return methods[ABOUT_CENTRE]
        common = set(inspect.signature(kind).parameters)
        fits = {
            k: len((inspect.signature(call).parameters.keys() - common) & table.keys()) for k, call in methods.items()
        }
        best = max(methods, key=lambda name: fits[name], default="")
        return methods[best] if best and fits[best] else kind

    def _check_names(self, call: Callable[..., Any], table: Table, where: str) -> None:
        """Note unknown keys, and arguments that are missing."""
        parameters = {k: p for k, p in inspect.signature(call).parameters.items() if k != "self"}
        needed = [k for k, p in parameters.items() if p.default is p.empty and p.kind is not p.VAR_KEYWORD]
        names = [k for k, p in parameters.items() if p.kind is not p.VAR_KEYWORD]
        if len(names) < len(parameters):  # **options are arguments of the class
            options = inspect.signature(_type_of(call, inspect.signature(call).return_annotation)).parameters
            names += [k for k, p in options.items() if p.default is not p.empty and k not in names]
        for key in table:
            if key not in names:
                self.faults.add(f"[{where}] expected {', '.join(names)}, got {shown(key)}.{hint(key, names)}")
        missing = [k for k in needed if k not in table]
        if missing:
            shapes = ", ".join(_class_methods(call)) if isinstance(call, type) else ""
            instead = f" Or give what one of these needs: shape = {shapes}." if shapes else ""
            self.faults.add(f"[{where}] expected {', '.join(missing)} too, got none.{instead}")

    def _value(self, value: Any, kind: Any, where: str) -> Any:
        """The value of an argument of this type: records from tables and names, paths, functions of the user's file."""
        records = list(records_of(kind))
        if isinstance(value, str) and value in self.names:
            return self.names[value]
        if isinstance(value, Mapping) and "kind" in value:  # a part, {kind = "bdot", gain = 1e-4}
            return self.body(value, where, parts())
        if isinstance(value, str) and "PathLike" in str(kind):
            return self.folder / value
        if records and isinstance(value, Mapping):  # of Orbit | ThirdBody, the one with most of these arguments
            return self.record(max(records, key=lambda record: len(types_of(record).keys() & value)), value, where)
        if isinstance(value, list) and (records or any(isinstance(v, Mapping) for v in value)):
            record = next(iter(records), None)
            return [self._value(v, record, where) if isinstance(v, Mapping) or not records else v for v in value]
        for record in records if isinstance(value, str) else ():
            constants = {k.lower(): v for k, v in vars(physical).items() if isinstance(v, record)}
            if value.lower() in constants:
                return constants[value.lower()]
            expected = f"one of {', '.join(constants)}, or a table" if constants else "a table"
            self.faults.add(f"[{where}] expected {expected}, got {shown(value)}.{hint(value, constants)}")
        if isinstance(value, Mapping):  # coefficients, {"3,1" = [C, S]}
            return {tuple(map(int, k.split(","))) if re.fullmatch(r"\d+,\d+", k) else k: v for k, v in value.items()}
        return self._quantity(value, where)

    def _quantity(self, value: Any, where: str) -> Any:
        """The value; texts that begin like a quantity must have a known unit."""
        for entry in value if isinstance(value, list) else ():
            self._quantity(entry, where)
        if isinstance(value, str) and (match := QUANTITY.fullmatch(value)):
            with self.faults.noted(f"[{where}]"):
                try:
                    si(value, match["unit"], "the quantity")
                except InputError as error:
                    if "pint" in str(error):
                        raise
                    text = f"expected a quantity such as '5 deg/s', got {shown(value)}: its unit is not known."
                    raise InputError(text) from None
        return value


def _class_methods(kind: Callable[..., Any]) -> dict[str, Callable[..., Any]]:
    """The class methods of a record, each a constructor."""
    names = [name for name in sorted(dir(kind)) if not name.startswith("_")]
    return {k: getattr(kind, k) for k in names if isinstance(inspect.getattr_static(kind, k), classmethod)}


def types_of(call: Callable[..., Any]) -> dict[str, Any]:
    """The types of the arguments of a function or class."""
    return {name: _type_of(call, p.annotation) for name, p in inspect.signature(call).parameters.items()}


def _type_of(call: Callable[..., Any], annotation: Any) -> Any:
    """The type that an annotation names, Any if the module of the function does not know it."""
    names = {**vars(physical), **vars(sys.modules[call.__module__])}
    try:
        return Any if annotation is inspect.Parameter.empty else eval(str(annotation), names)
    except NameError:
        return Any


def records_of(kind: Any) -> Iterator[type[Any]]:
    """The records in a type, such as Plate in tuple[Plate, ...]."""
    if isinstance(kind, types.UnionType) or typing.get_origin(kind) is not None:
        for argument in typing.get_args(kind):
            yield from records_of(argument)
    elif isinstance(kind, type) and kind.__module__.startswith("kreisel."):
        yield kind
