"""Trajectories in the files of any simulator: columns recognised by their names and by the start of a case.

Each recognised quantity, unit and convention is stated in a sentence, and each can be specified instead.
"""

from __future__ import annotations

import csv
import itertools
import math
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from kreisel.algebra import Array, floats
from kreisel.checkcases.catalogue import records
from kreisel.checkcases.grade import LARGEST, NORM, checked, increasing
from kreisel.checkcases.mistakes import FACTOR, differences, size
from kreisel.errors import InputError, explained, shown

if TYPE_CHECKING:
    from kreisel.checkcases.catalogue import Case

RATES = {"rad/s": 1.0, "deg/s": math.pi / 180, "rpm": math.pi / 30}
ANGLES = {"rad": 1.0, "deg": math.pi / 180}
TIMES = {"s": 1.0, "ms": 1e-3, "min": 60.0}
LENGTHS = {"m": 1.0, "ft": 0.3048}
FACTORS = {**RATES, **ANGLES, **TIMES, **LENGTHS}
UNITS = {  # words at the end of a name -> unit
    **dict.fromkeys(("deg s", "deg sec", "deg per s", "degrees s", "degs", "dps"), "deg/s"),
    **dict.fromkeys(("rad s", "rad sec", "rad per s", "radians s", "rads"), "rad/s"),
    **{
        "kg m 2 s": "SI",
        "n m s": "SI",
        "j": "SI",
        "rpm": "rpm",
        "m": "m",
        "m s": "m",
        "ft": "ft",
        "ft s": "ft",
        "feet": "ft",
    },
    **{"deg": "deg", "degrees": "deg", "rad": "rad", "radians": "rad"},
}
UNITS_OF_TIME = {"s": "s", "sec": "s", "seconds": "s", "ms": "ms", "msec": "ms", "min": "min", "minutes": "min"}
TIME = {"t", "time", "timestamp", "elapsed", "seconds"}
TURNING = {"omega", "om", "w", "gyro", "rate", "rates", "angular", "ang", "angvel"}
ATTITUDE = {"q", "quat", "quaternion", "attitude", "orientation", "rotation", "rot", "dcm", "r", "matrix"}
POSITION = {"position", "pos", "com", "p"}
ELSE = set("dot linear accel acceleration torque moment force error des cmd ref kinetic potential".split())
FRAMES = {"body": "body", "b": "body", "local": "body"} | dict.fromkeys(("space", "world", "inertial", "lab"), "space")
COMPONENTS = (
    *(tuple(a + b for a in axes for b in axes) for axes in ("012", "123", "xyz")), tuple("012345678"), tuple("wxyz"),
    tuple("sxyz"), tuple("0123"), tuple("1234"), tuple("xyz"), tuple("012"), tuple("123"), tuple("pqr"),
    ("roll", "pitch", "yaw"), ("phi", "theta", "psi"),
)  # fmt: skip
SYMBOL = re.compile(r"(w|om|omega|q|quat|r|rot|dcm|l|h|p|pos|v|vel|gyro|angvel)([xyzw]|[xyz]{2})|(q|quat)(s)")
WORD = re.compile(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])|\d+")
ALL, EARLY = slice(None), slice(3)  # rows that decide between conventions
BETTER = 3  # factor by which they do
CLOSE, FAR = 1e-3, 0.2  # relative: the start matches; it does not
MOST = 12  # names in a sentence
LEAST = 0.02  # part of the duration of a case; runs 20 times as long as the case are in ms


class Trajectory(NamedTuple):
    """Times (rows,), s; the quantities of `Case.grade`; sentences on columns recognised or left out; the step, s."""

    times: Array
    quantities: dict[str, Array]
    reading: list[str]
    step: float | None = None


class Group(NamedTuple):
    """Columns of one quantity, their unit and frame if the names state them, the components in the names."""

    role: str
    columns: list[str]
    unit: str | None
    frame: str | None
    components: tuple[str, ...]


class Option(NamedTuple):
    """A reading of columns: the quantity, its values in SI, and their description."""

    name: str
    values: Array
    text: str


@explained
def read(
    source: Any,
    case: Case,
    *,
    units: str | None = None,
    quaternion: str | None = None,
    direction: str | None = None,
    frame: str | None = None,
    time: str | None = None,
    columns: Mapping[str, Any] | None = None,
    step: float | None = None,
) -> Trajectory:
    """The trajectory in a file (CSV, NetCDF), an xarray Dataset, or a mapping of names to columns.

    units      of the angular velocity or of Euler angles: "rad/s", "deg/s", "rpm"; "rad", "deg"
    quaternion "wxyz" or "xyzw";  direction "body to space" or "space to body"
    frame      of the angular velocity: "body" or "space";  time "s", "ms" or "min"
    columns    names of columns by quantity: "time", "rates" (3), "attitude" (4 of a quaternion, or 9 of a rotation
               matrix by rows), "euler" (roll, pitch, yaw of the sequence 3-2-1), "momentum", "position", "energy"
    step       of the simulator, s, if it saves fewer rows

    Anything not specified is recognised by the names of columns, then by the exact motion.  Raises `InputError`.
    """
    specified = {"units": units, "quaternion": quaternion, "direction": direction, "frame": frame, "time": time}
    allowed = ({**RATES, **ANGLES}, ("wxyz", "xyzw"), ("body to space", "space to body"), ("body", "space"), TIMES)
    for (name, value), words in zip(specified.items(), allowed, strict=True):
        if value is not None and value not in words:
            raise InputError(f"{name}: expected one of {', '.join(words)}, got {shown(value)}.")
    table = _table(source)
    groups = _specified(columns, table) if columns else _groups(table)
    sentences = list[str]()
    times = _times(table, groups, case, time, sentences)
    reference = case.reference(times)
    exact = {str(name): reference[name].values for name in reference}
    if not columns:
        named = {name for group in groups for name in group.columns}
        if unnamed := [name for name in table.columns if name not in named]:
            surplus = f" and {len(unnamed) - MOST} more" * (len(unnamed) > MOST)
            sentences.append(f"columns {', '.join(unnamed[:MOST])}{surplus}: left out, not recognised or incomplete")
        groups = [group for group in groups if not _left_out(group, table, exact, sentences)]
    quantities = _quantities(table, groups, specified, exact, sentences)
    _check_start(case, quantities, exact, table.source)
    return Trajectory(times, quantities, sentences, step)


def _quantities(
    table: _Table,
    groups: list[Group],
    specified: Mapping[str, str | None],
    exact: Mapping[str, Array],
    sentences: list[str],
) -> dict[str, Array]:
    """The quantities of the groups, with a sentence each.  Raises `InputError`."""
    quantities = dict[str, Array]()
    for group in groups:
        listed = f"columns {', '.join(group.columns)}"
        values, rows = table.numbers(group.columns), len(exact["attitude"])
        if len(values) != rows:
            raise InputError(f"{table.source}, {listed}: expected {rows} rows, as many as times, got {len(values)}.")
        options = [option for option in _options(values, group, specified) if option.name in exact]
        if not options and group.role != "time":
            sentences.append(f"{listed}: left out, the case has no {group.role}")
        if not options:
            continue
        option, reason = _chosen(options, exact, f"{table.source}, {listed}", group.unit)
        if option.name in quantities:
            raise InputError(
                f"{table.source}: expected one set of columns for {option.name}, got another, "
                f"{', '.join(group.columns)}. Specify which: columns={{'{group.role}': [...]}}."
            )
        quantities[option.name] = checked(option.name, option.values, len(option.values))
        sentences.append(f"{listed}: {option.text}{reason}")
    if not quantities:
        raise InputError(
            f"{table.source}: expected columns such as wx, wy, wz or qw, qx, qy, qz with one of {', '.join(exact)}, "
            f"got {'; '.join(sentences)}. Specify them: columns={{'rates': [...]}}."
        )
    return quantities


def _left_out(group: Group, table: _Table, exact: Mapping[str, Array], sentences: list[str]) -> bool:
    """Whether a group is of no use, with a sentence."""
    listed = f"columns {', '.join(group.columns)}: left out"
    if group.role == "euler" and "longitude" in " ".join(table.columns):
        sentences.append(f"{listed}, angles to the Earth's local frame, which rotates by 7e-5 rad/s")
        return True
    if group.role in ("energy", "momentum") and group.role in exact:
        values = table.numbers(group.columns)
        option = Option(group.role, values[:, 0] if group.role == "energy" else values, "")
        if _error(option, exact, slice(1)) > CLOSE:
            sentences.append(f"{listed}, not the {group.role} of the case at the start (another zero or unit)")
            return True
    return False


class _Table:
    """Columns by name: texts of a file, or arrays."""

    def __init__(self, source: str, columns: Mapping[str, Any], lines: list[int] | None = None):
        self.source, self.columns, self.lines = source, columns, lines

    def numbers(self, names: list[str]) -> Array:
        """The values (rows, names).  Raises `InputError`."""
        return np.stack([self._column(name) for name in names], -1)

    def _column(self, name: str) -> Array:
        if name not in self.columns:
            raise InputError(f"{self.source}: expected a column {shown(name)}, got {', '.join(self.columns)}.")
        values = []
        for row, text in enumerate(self.columns[name]):
            try:
                values.append(float(text))
            except (TypeError, ValueError):
                values.append(math.nan)
            if not abs(values[-1]) < LARGEST:
                place = f"line {self.lines[row]}" if self.lines else f"row {row + 1}"
                advice = "Leave out the rows from there on if the simulation failed."
                if not _is_number(str(text)):
                    advice = "Usual cause: a line of units or a second line of names, or values with a decimal comma."
                raise InputError(
                    f"{self.source}, {place}, column {name}: expected a finite number, got {shown(text)}. {advice}"
                )
        return np.array(values)


def _table(source: Any) -> _Table:
    import xarray as xr

    if isinstance(source, str | os.PathLike):
        path = Path(source).expanduser()
        if not path.is_file():
            raise InputError(f"{path}: expected a file, got none of that name.")
        if path.suffix in (".nc", ".h5"):
            try:
                return _arrays(xr.load_dataset(path), path.name)
            except (OSError, ValueError) as error:
                raise InputError(f"{path.name}: expected a NetCDF file, got {error}.") from error
        return _text(path)
    if not hasattr(source, "keys"):
        raise InputError(
            f"read: expected a path, an xarray Dataset or a mapping of names to arrays, got {shown(source)}."
        )
    return _arrays(source, "the Dataset" if isinstance(source, xr.Dataset) else "the mapping")


def _arrays(source: Any, title: str) -> _Table:
    """Columns of arrays (rows, ...); a unit in the attributes is appended to the name."""
    columns = dict[str, Any]()
    for name in source.variables if hasattr(source, "variables") else source:
        array = floats(getattr(source[name], "values", source[name]))
        unit = str(getattr(source[name], "attrs", {}).get("units", ""))
        unit = f" [{unit}]" if " ".join(_split(unit)) in {**UNITS, **UNITS_OF_TIME} else ""
        if array.ndim == 1 and name not in ("axis", "component"):
            columns[f"{name}{unit}"] = array
        for place in np.ndindex(array.shape[1:] if array.ndim > 1 else (0,)):
            columns[f"{name}[{','.join(map(str, place))}]{unit}"] = array[:, *place]
    return _Table(title, columns)


def _text(path: Path) -> _Table:
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except UnicodeDecodeError:
        lines = ["\0"]
    if any("\0" in line for line in lines):
        raise InputError(
            f"{path.name}: expected a text of comma-separated columns, got a binary file. Export it as CSV."
        )
    rows = [(number, line) for number, line in enumerate(lines, 1) if line.strip()]
    data = [(number, line) for number, line in rows if not line.lstrip().startswith("#")]
    if not data:
        raise InputError(f"{path.name}: expected a line of names of columns and rows of values, got an empty file.")
    if _is_number(re.split(r"[,;\s]+", data[0][1].strip())[0]):  # the names are in a comment, as NumPy writes them
        comments = [(number, line.lstrip("# ")) for number, line in rows if line.lstrip().startswith("#")]
        data = [*comments[-1:], *data]
    delimiter = next((c for c in ",;\t" if c in data[0][1]), " ")
    table = [next(csv.reader([line.strip()], delimiter=delimiter, skipinitialspace=True)) for _, line in data]
    names = [name.strip() for name in table[0]]
    if any(_is_number(name) for name in names):
        raise InputError(
            f"{path.name}: expected names of columns in the first line, such as t,wx,wy,wz, got values. Add the names."
        )
    if twice := next((name for name in names if name and names.count(name) > 1), ""):
        raise InputError(f"{path.name}: expected columns with different names, got {twice} twice. Rename one.")
    for (number, _), row in zip(data, table, strict=True):
        if len(row) != len(names):
            raise InputError(
                f"{path.name}, line {number}: expected {len(names)} columns as in the first line, got {len(row)}. "
                "Usual cause: the file was cut off, or values with a decimal comma."
            )
    columns = (
        dict(zip(names, zip(*table[1:], strict=True), strict=False)) if len(table) > 1 else dict.fromkeys(names, ())
    )
    return _Table(path.name, columns, [number for number, _ in data[1:]])


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _split(text: str) -> list[str]:
    for symbol, word in (("\N{GREEK SMALL LETTER OMEGA}", "omega_"), ("\N{DEGREE SIGN}", "deg")):
        text = text.replace(symbol, word)
    words = [word.lower() for word in WORD.findall(re.sub(r"(?<=\d)[_, ]+(?=\d)", "", text))]
    matches = [(word, SYMBOL.fullmatch(word)) for word in words]
    return [text for word, match in matches for text in (filter(None, match.groups()) if match else [word])]


def _parsed(name: str) -> tuple[tuple[str, ...], str | None, str]:
    """The words of a name, its unit, and its component."""
    index = re.search(r"[\[(]([\d, ]+)[\])]", name)
    words, unit = _without_unit(_split(name.replace(index[0], " ") if index else name))
    component = re.sub(r"\D", "", index[1]) if index else ""
    places = [k for k, word in enumerate(words) if any(word in symbols for symbols in COMPONENTS)]
    if places and not index:
        component = words.pop(places[-1])
    if unit is None:
        words, unit = _without_unit(words)
    return tuple(words), unit, component


def _without_unit(words: list[str]) -> tuple[list[str], str | None]:
    units = {**UNITS, **UNITS_OF_TIME} if TIME & set(words[:-1]) else UNITS
    for count in (4, 3, 2, 1):
        if len(words) > count and (unit := units.get(" ".join(words[-count:]))):
            return words[:-count], unit
    return words, None


def _groups(table: _Table) -> list[Group]:
    """The quantities in the columns, by their names."""
    result = dict[tuple[tuple[str, ...], str | None], dict[str, str]]()
    for name in table.columns:
        words, unit, component = _parsed(name)
        result.setdefault((words, unit), {}).setdefault(component, name)
    groups = []
    for (words, unit), members in result.items():
        for components in (("",), *COMPONENTS):
            role = _role(set(words), components)
            if role and all(c in members for c in components):
                groups.append(Group(role, [members.pop(c) for c in components], unit, _frame(words), components))
    return groups


def _frame(words: Sequence[str]) -> str | None:
    return next((FRAMES[word] for word in words if word in FRAMES), None)


def _role(words: set[str], components: tuple[str, ...]) -> str:
    """The quantity that the words of its columns and their components mean, or nothing."""
    count = len(components)
    if words & ELSE:
        return ""
    if count == 1:
        return "time" if words and words <= TIME else "energy" if words & {"energy", "e"} else ""
    if count in (4, 9):
        return "attitude" if not words or words & ATTITUDE else ""
    if components[0] in ("roll", "phi") and not words & TURNING:
        return "euler"
    names = {"momentum": {"momentum", "l", "h"}, "rates": TURNING, "position": POSITION, "velocity": {"velocity", "v"}}
    bare = "rates" if components == tuple("pqr") else "position"
    return next((role for role, meanings in names.items() if words & meanings), "" if words else bare)


def _specified(columns: Mapping[str, Any], table: _Table) -> list[Group]:
    """The columns that are specified by name, and the column of the time."""
    groups, counts = [group for group in _groups(table) if group.role == "time" and "time" not in columns], {
        **dict.fromkeys(("time", "energy"), (1,)), "attitude": (4, 9),
        **dict.fromkeys(("rates", "euler", "momentum", "position", "velocity"), (3,)),
    }  # fmt: skip
    for role, value in columns.items():
        names = [value] if isinstance(value, str) else list(value) if isinstance(value, list | tuple) else []
        if len(names) not in counts.get(role, ()) or not all(isinstance(name, str) for name in names):
            roles = "; ".join(f"{key} ({' or '.join(map(str, sizes))})" for key, sizes in counts.items())
            raise InputError(f"columns: expected names for {roles}, got {shown(value)} for {shown(role)}.")
        parsed = [_parsed(name) for name in names]
        groups.append(Group(role, names, parsed[0][1], _frame(parsed[0][0]), tuple(p[2] for p in parsed)))
    return groups


def _times(table: _Table, groups: list[Group], case: Case, specified: str | None, sentences: list[str]) -> Array:
    """The times, s.  Raises `InputError`."""
    group = next((group for group in groups if group.role == "time"), None)
    if group is None:
        raise InputError(
            f"{table.source}: expected a column of times, named t or time, got {', '.join(table.columns)}."
        )
    times = increasing(table.numbers(group.columns)[:, 0], f"{table.source}, column {group.columns[0]}")
    unit, duration, reason = specified or group.unit, float(case.duration), ""
    if unit is None:
        unit = "ms" if LEAST < times[-1] * 1e-3 / duration <= 1 + 1e-9 else "s"
        reason = " (recognised by the case's duration)"
    sentences.append(f"column {group.columns[0]}: time, {unit}{reason}")
    return times * FACTORS[unit]


def _options(values: Array, group: Group, specified: Mapping[str, str | None]) -> Iterator[Option]:
    """The readings of the columns of a group."""
    units, frame = specified["units"] or group.unit, specified["frame"] or group.frame
    if group.role == "rates":
        for name, axes in (("angular_velocity", "the body"), ("angular_velocity_space", "space")):
            for unit in [units] if units in RATES else RATES:
                if frame is None or frame in axes:
                    yield Option(name, values * RATES[unit], f"angular velocity along the axes of {axes}, {unit}")
    elif group.role == "euler":
        for unit in [units.removesuffix("/s")] if units and units.removesuffix("/s") in ANGLES else ANGLES:
            q = _quaternions("from_euler", "ZYX", values[:, ::-1] * ANGLES[unit])
            yield from _directions(q, f"Euler angles roll, pitch, yaw (3-2-1), {unit}", specified)
    elif group.role == "attitude" and len(group.columns) == 9:
        yield from _directions(_of_matrix(values.reshape(-1, 3, 3)), "rotation matrix, by rows", specified)
    elif group.role == "attitude":
        orders = ["wxyz"] if group.components[0] in ("w", "s") else ["wxyz", "xyzw"]
        if specified["quaternion"]:
            orders = [specified["quaternion"]]
        for order in orders:
            q = values if order == "wxyz" else np.roll(values, 1, -1)
            yield from _directions(q, f"quaternion ({', '.join(order)})", specified)
    elif group.role != "time":
        standard = {"energy": "J", "momentum": "kg m^2/s"}.get(group.role)
        for unit in [standard] if standard else [group.unit] if group.unit in LENGTHS else LENGTHS:
            array = values[:, 0] if group.role == "energy" else values * LENGTHS.get(unit, 1.0)
            yield Option(group.role, array, f"{group.role}, {unit}{'/s' * (group.role == 'velocity')}")


def _directions(q: Array, text: str, specified: Mapping[str, str | None]) -> Iterator[Option]:
    for direction, signs in (("body to space", 1), ("space to body", -1)):
        if specified["direction"] in (None, direction):
            yield Option("attitude", q * [1, signs, signs, signs], f"attitude, {text}, {direction}")


def _of_matrix(R: Array) -> Array:
    """Quaternions from rotation matrices (rows, 3, 3).  Raises `InputError`."""
    off = np.maximum(abs(R @ R.transpose(0, 2, 1) - np.eye(3)).max((1, 2)), np.linalg.det(R) < 0)
    if (off > NORM).any():
        at = int(np.argmax(off > NORM))
        raise InputError(
            f"attitude: expected rotation matrices, got {shown(R[at].tolist())} in row {at + 1}, for which R R^T "
            f"differs from 1 by {off[at]:.2g}, or which mirrors. Usual cause: columns that are not the matrix."
        )
    return _quaternions("from_matrix", R)


def _quaternions(make: str, *values: Any) -> Array:
    from scipy.spatial.transform import Rotation

    return np.asarray(getattr(Rotation, make)(*values).as_quat(scalar_first=True))


def _error(option: Option, exact: Mapping[str, Array], rows: slice) -> float:
    truth = exact[option.name]
    return float(differences(option.name, option.values[rows], truth[rows]).max()) / size(option.name, truth)


def _chosen(options: list[Option], exact: Mapping[str, Array], place: str, unit: str | None) -> tuple[Option, str]:
    """The option that agrees with the exact motion: in the first rows, or everywhere if it is another frame."""
    option, start = options[0], slice(1)
    best = min((o for o in options if o.name == option.name), key=lambda o: _error(o, exact, EARLY))
    if _error(best, exact, EARLY) * BETTER < _error(option, exact, EARLY):
        option = best
    for candidate in options:
        if candidate.name != option.name and _error(candidate, exact, ALL) * FACTOR < _error(option, exact, ALL):
            option = candidate
    if unit in RATES and _error(option, exact, start) > FAR:
        for name, factor in RATES.items():
            candidate = Option(option.name, option.values * (factor / RATES[unit]), "")
            if _error(candidate, exact, start) < CLOSE:
                raise InputError(
                    f"{place}: expected {unit}, as the names state, got values of which the first row, "
                    f"{shown((option.values[0] / RATES[unit]).tolist())}, is the start of the case in {name}. Correct "
                    f"the names, or specify units={name!r}."
                )
    return option, " (recognised by the exact motion)" if len(options) > 1 else ""


def _check_start(case: Case, quantities: Mapping[str, Array], exact: Mapping[str, Array], source: str) -> None:
    """Raises `InputError` if the rates at first are the start of another case, in any unit."""
    name = "angular_velocity"
    if name not in quantities or _error(Option(name, quantities[name], ""), exact, slice(1)) < CLOSE:
        return
    w, fits = quantities[name][0], set[str]()
    for rival, factor in itertools.product(records().values(), {a / b for a in RATES.values() for b in RATES.values()}):
        start = np.array([float(v) for v in rival.angular_velocity])
        if np.linalg.norm(w * factor - start) < CLOSE * np.linalg.norm(start):
            fits.add(rival.name)
    if fits:
        raise InputError(
            f"{source}: expected the start of the case {case.name}, rates {shown(exact[name][0].tolist())} rad/s, got "
            f"{shown(w.tolist())}, the start of {' or '.join(sorted(fits))}. Grade the file against that case."
        )
