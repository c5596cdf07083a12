"""Bodies from plain tables, such as sections of a TOML file: the keys are the arguments of the constructors in Python.

    {"kind": "satellite", "inertia": [[...]], "orbit": {"altitude": "500 km", "inclination": "97 deg"}}

`kind` is a class of `kr.physical`, "heavy-body" for `HeavyBody`.  `shape` names one of its class methods, "cubesat"; it
is not needed if the table has an argument that only this method has.  Inner tables are records, for arguments of such a
type, or `kind` names a class or function of `kr.physical`, "bdot"; names are constants, "saturn".  Instead of inertia
and mass there may be a file, `mesh` or `robot`.
"""

from __future__ import annotations

import inspect
import re
import sys
import types
import typing
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, is_dataclass
from pathlib import Path
from typing import Any

from kreisel import physical
from kreisel.errors import Faults, InputError, hint, shown
from kreisel.physical.body import Varied
from kreisel.record.body import Body
from kreisel.record.model import State
from kreisel.record.units import QUANTITY, si

READERS = (physical.read_mesh, physical.read_robot)
ABOUT_CENTRE = "about_centre"
Table = Mapping[str, Any]


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
