"""Trajectories in the files of any simulator: columns recognised by their names and by the start of a case.

Each recognised quantity, unit and convention is stated in a sentence, and each can be specified instead.
"""

from __future__ import annotations

import csv
import math
import os
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from kreisel.algebra import Array, floats
from kreisel.checkcases.grade import checked, increasing
from kreisel.checkcases.mistakes import FACTOR, differences, size
from kreisel.errors import InputError, explained, shown

if TYPE_CHECKING:
    from kreisel.checkcases.motion import Case

RATES = {"rad/s": 1.0, "deg/s": math.pi / 180, "rpm": math.pi / 30}
ANGLES = {"rad": 1.0, "deg": math.pi / 180}
TIMES = {"s": 1.0, "ms": 1e-3, "min": 60.0}
LENGTHS = {"m": 1.0, "ft": 0.3048}
FACTORS = {**RATES, **ANGLES, **TIMES, **LENGTHS}
UNITS = {  # words at the end of a name -> unit
    **dict.fromkeys(("deg s", "deg sec", "deg per s", "degrees s", "degs", "dps"), "deg/s"),
    **dict.fromkeys(("rad s", "rad sec", "rad per s", "radians s", "rads"), "rad/s"),
    **{"rpm": "rpm", "m": "m", "m s": "m", "ft": "ft", "ft s": "ft", "feet": "ft"},
    **{"deg": "deg", "degrees": "deg", "rad": "rad", "radians": "rad"},
}
UNITS_OF_TIME = {"s": "s", "sec": "s", "seconds": "s", "ms": "ms", "msec": "ms", "min": "min", "minutes": "min"}
TIME = {"t", "time", "timestamp", "elapsed", "seconds"}
TURNING = {"omega", "om", "w", "gyro", "rate", "rates", "angular", "ang", "angvel"}
ATTITUDE = {"q", "quat", "quaternion", "attitude", "orientation", "rotation", "rot", "dcm", "r", "matrix"}
ELSE = {
    "dot",
    "accel",
    "acceleration",
    "torque",
    "moment",
    "force",
    "error",
    "des",
    "cmd",
    "ref",
    "kinetic",
    "potential",
}
FRAMES = {"body": "body", "b": "body", "local": "body"} | dict.fromkeys(("space", "world", "inertial", "lab"), "space")
COMPONENTS = (
    *(tuple(a + b for a in axes for b in axes) for axes in ("012", "123", "xyz")), tuple("012345678"), tuple("wxyz"),
    tuple("sxyz"), tuple("0123"), tuple("1234"), tuple("xyz"), tuple("012"), tuple("123"), tuple("pqr"),
    ("roll", "pitch", "yaw"), ("phi", "theta", "psi"),
)  # fmt: skip
SYMBOL = re.compile(r"(w|om|omega|q|quat|r|rot|dcm|l|h|p|pos|v|vel|gyro|angvel)([xyzws]|\d|[xyz]{2})")
WORD = re.compile(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])|\d+")
EARLY = 3  # rows that decide between conventions
BETTER = 3  # factor by which they do
CLOSE = 1e-3  # relative: the start matches


class Trajectory(NamedTuple):
    """Times (rows,), s; the quantities of `Case.grade`; what was recognised or left out, in sentences; the step, s."""

    times: Array
    quantities: dict[str, Array]
    reading: list[str]
    step: float | None = None


class Group(NamedTuple):
    """Columns of one quantity, its components in the names, its unit and frame if the names state them."""

    role: str
    columns: list[str]
    components: tuple[str, ...] = ()
    unit: str | None = None
    frame: str | None = None


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

    What is not specified is recognised by the names of the columns, then by the exact motion.  Raises `InputError`.
    """
    specified = {"units": units, "quaternion": quaternion, "direction": direction, "frame": frame, "time": time}
    allowed = (FACTORS, ("wxyz", "xyzw"), ("body to space", "space to body"), ("body", "space"), TIMES)
    for (name, value), words in zip(specified.items(), allowed, strict=True):
        if value is not None and value not in words:
            raise InputError(f"{name}: expected one of {', '.join(words)}, got {shown(value)}.")
    table = _table(source)
    groups = _specified(columns, table) if columns else _groups(table)
    sentences = list[str]()
    times = _times(table, groups, case, time, sentences)
    reference = case.reference(times)
    exact = {str(name): reference[name].values for name in reference}
    quantities = dict[str, Array]()
    for group in groups:
        listed = f"columns {', '.join(group.columns)}"
        if group.role == "euler" and not columns and {"longitude", "latitude"} <= _words(table):
            sentences.append(f"{listed}: left out, angles to the Earth's local frame, which rotates by 7e-5 rad/s")
            continue
        options = list(_options(table.numbers(group.columns), group, specified, exact))
        if not options:
            continue
        option, reason = _chosen(options, exact, f"{table.source}, {listed}", group.unit)
        if option.name in quantities:
            raise InputError(
                f"{table.source}: expected one set of columns for {option.name}, got another, "
                f"{', '.join(group.columns)}. Specify which: columns={{'{group.role}': [...]}}."
            )
        quantities[option.name] = checked(option.name, option.values, len(times))
        sentences.append(f"{listed}: {option.text}{reason}")
    if not quantities:
        raise InputError(
            f"{table.source}: expected columns such as wx, wy, wz or qw, qx, qy, qz with one of {', '.join(exact)}, "
            f"got {', '.join(table.columns)}. Specify them: columns={{'rates': [...]}}."
        )
    _check_start(case, quantities, exact, times, table.source)
    return Trajectory(times, quantities, sentences, step)


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
            if not math.isfinite(values[-1]):
                place = f"line {self.lines[row]}" if self.lines else f"row {row + 1}"
                raise InputError(
                    f"{self.source}, {place}, column {name}: expected a finite number, got {shown(text)}. Leave out "
                    "the rows from there on if the simulation failed."
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
        raise InputError(f"{path.name}: expected a line of names of columns and rows of numbers, got an empty file.")
    if _is_number(re.split(r"[,;\s]+", data[0][1].strip())[0]):  # the names are in a comment, as NumPy writes them
        comments = [(number, line.lstrip("# ")) for number, line in rows if line.lstrip().startswith("#")]
        data = [*comments[-1:], *data]
    delimiter = next((c for c in ",;\t" if c in data[0][1]), " ")
    table = list(csv.reader((line.strip() for _, line in data), delimiter=delimiter, skipinitialspace=True))
    names = [name.strip() for name in table[0]]
    if any(_is_number(name) for name in names):
        raise InputError(
            f"{path.name}: expected names of columns in the first line, such as t,wx,wy,wz, got numbers. Add the names."
        )
    for (number, _), row in zip(data, table, strict=True):
        if len(row) != len(names):
            raise InputError(
                f"{path.name}, line {number}: expected {len(names)} columns as in the first line, got {len(row)}. "
                "Usual cause: the file was cut off, or numbers with a decimal comma."
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
    return [word.lower() for word in WORD.findall(text)]


def _words(table: _Table) -> set[str]:
    return {word for name in table.columns for word in _split(name)}


def _parsed(name: str) -> tuple[tuple[str, ...], str | None, str]:
    """The words of a name, its unit, and its component."""
    index = re.search(r"[\[(]([\d, ]+)[\])]", name)
    words, unit = _without_unit(_split(name.replace(index[0], " ") if index else name))
    component = re.sub(r"\D", "", index[1]) if index else ""
    if not index and words and (match := SYMBOL.fullmatch(words[-1])):
        words[-1:] = match.groups()
    symbols = {symbol for symbols in COMPONENTS for symbol in symbols}
    at = next((k for k in range(len(words) - 1, -1, -1) if words[k] in symbols), None)
    if (
        not component
        and at is not None
        and (at or len(words[0]) == 1 or words[0] in ("roll", "pitch", "yaw", "phi", "theta", "psi"))
    ):
        component = words.pop(at)
    if unit is None:
        words, unit = _without_unit(words)
    return tuple(words), unit, component


def _without_unit(words: list[str]) -> tuple[list[str], str | None]:
    units = {**UNITS, **UNITS_OF_TIME} if TIME & set(words[:-1]) else UNITS
    for count in (3, 2, 1):
        if len(words) > count and (unit := units.get(" ".join(words[-count:]))):
            return words[:-count], unit
    return words, None


def _groups(table: _Table) -> list[Group]:
    """The quantities in the columns, by their names."""
    found = dict[tuple[tuple[str, ...], str | None], dict[str, str]]()
    for name in table.columns:
        words, unit, component = _parsed(name)
        found.setdefault((words, unit), {}).setdefault(component, name)
    groups = []
    for (words, unit), members in found.items():
        frame = next((FRAMES[word] for word in words if word in FRAMES), None)
        for components in ((), *COMPONENTS):
            names = [members[c] for c in components or ("",) if c in members]
            role = _role(set(words), components)
            if len(names) == max(1, len(components)) and role:
                groups.append(Group(role, names, components, unit, frame))
                members = {c: name for c, name in members.items() if name not in names}
    return groups


def _role(words: set[str], components: tuple[str, ...]) -> str:
    if words & ELSE or "linear" in words:
        return ""
    if not components:
        return "time" if words and words <= TIME else "energy" if words & {"energy", "e"} else ""
    if len(components) in (4, 9):
        return "attitude" if not words or words & ATTITUDE else ""
    if words & {"momentum", "l", "h"}:
        return "momentum"
    if words & TURNING or components == tuple("pqr"):
        return "rates"
    if components[0] in ("roll", "phi"):
        return "euler"
    for role, names in (("position", {"position", "pos", "com", "p"}), ("velocity", {"velocity", "vel", "v"})):
        if words & names or (role == "position" and not words):
            return role
    return ""


def _specified(columns: Mapping[str, Any], table: _Table) -> list[Group]:
    groups = []
    for role, names in {"time": _time_column(table), **columns}.items():
        names = [names] if isinstance(names, str) else list(names)
        counts = {"time": (1,), "energy": (1,), "attitude": (4, 9)}.get(role, (3,))
        if (
            role not in ("time", "energy", "attitude", "rates", "euler", "momentum", "position", "velocity")
            or len(names) not in counts
        ):
            raise InputError(
                f"columns: expected {' or '.join(map(str, counts))} names for {shown(role)}, got {shown(names)}."
            )
        parsed = [_parsed(name) for name in names]
        frame = next((FRAMES[word] for word in parsed[0][0] if word in FRAMES), None)
        groups.append(Group(role, names, tuple(p[2] for p in parsed), parsed[0][1], frame))
    return groups


def _time_column(table: _Table) -> list[str]:
    return next((group.columns for group in _groups(table) if group.role == "time"), ["time"])


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
        unit = "ms" if times[-1] > 1.5 * duration and times[-1] * 1e-3 <= duration * (1 + 1e-9) else "s"
        reason = " (recognised by the case's duration)"
    sentences.append(f"column {group.columns[0]}: time, {unit}{reason}")
    return times * FACTORS[unit]


def _options(
    values: Array, group: Group, specified: Mapping[str, str | None], exact: Mapping[str, Array]
) -> Iterator[Option]:
    """The readings of the columns of a group."""
    units, frame = specified["units"] or group.unit, specified["frame"] or group.frame
    if group.role == "rates":
        for name, axes in (("angular_velocity", "the body"), ("angular_velocity_space", "space")):
            for unit in [units] if units in RATES else RATES:
                if frame is None or frame in axes:
                    yield Option(name, values * RATES[unit], f"angular velocity along the axes of {axes}, {unit}")
    elif group.role == "euler":
        for unit in [units.removesuffix("/s")] if units and units.removesuffix("/s") in ANGLES else ANGLES:
            q = _of_euler(values * ANGLES[unit])
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
    elif group.role in exact:
        lengths = group.role in ("position", "velocity")
        for unit in ([group.unit] if group.unit in LENGTHS else LENGTHS) if lengths else ["SI"]:
            array = values[:, 0] if group.role == "energy" else values * LENGTHS.get(unit, 1.0)
            yield Option(group.role, array, f"{group.role}, {unit}")


def _directions(q: Array, text: str, specified: Mapping[str, str | None]) -> Iterator[Option]:
    for direction, signs in (("body to space", 1), ("space to body", -1)):
        if specified["direction"] in (None, direction):
            yield Option("attitude", q * [1, signs, signs, signs], f"attitude, {text}, {direction}")


def _of_euler(angles: Array) -> Array:
    """Quaternions q = q_z(yaw) q_y(pitch) q_x(roll) from angles (rows, 3): roll, pitch, yaw."""
    c, s = np.cos(angles / 2).T, np.sin(angles / 2).T
    return np.stack(
        [
            c[0] * c[1] * c[2] + s[0] * s[1] * s[2],
            s[0] * c[1] * c[2] - c[0] * s[1] * s[2],
            c[0] * s[1] * c[2] + s[0] * c[1] * s[2],
            c[0] * c[1] * s[2] - s[0] * s[1] * c[2],
        ],
        -1,
    )


def _of_matrix(R: Array) -> Array:
    """Quaternions from rotation matrices (rows, 3, 3): the column of q q^T with the largest diagonal entry."""
    if (off := float(abs(R[0] @ R[0].T - np.eye(3)).max())) > CLOSE:
        raise InputError(
            f"attitude: expected rotation matrices, got {shown(R[0].tolist())} in row 1, for which R R^T differs from "
            f"1 by {off:.2g}. Usual cause: other columns than those of the matrix."
        )
    xx, yy, zz = R[:, 0, 0], R[:, 1, 1], R[:, 2, 2]
    w = [1 + xx + yy + zz, R[:, 2, 1] - R[:, 1, 2], R[:, 0, 2] - R[:, 2, 0], R[:, 1, 0] - R[:, 0, 1]]
    xy, xz, yz = R[:, 0, 1] + R[:, 1, 0], R[:, 0, 2] + R[:, 2, 0], R[:, 1, 2] + R[:, 2, 1]
    columns = np.array(
        [w, [w[1], 1 + xx - yy - zz, xy, xz], [w[2], xy, 1 - xx + yy - zz, yz], [w[3], xz, yz, 1 - xx - yy + zz]]
    )
    best = np.argmax(np.einsum("iir->ri", columns), -1)
    q = columns[best, :, np.arange(len(R))]
    return np.asarray(q / np.linalg.norm(q, axis=-1, keepdims=True))


def _chosen(options: list[Option], exact: Mapping[str, Array], place: str, unit: str | None) -> tuple[Option, str]:
    """The option that agrees with the exact motion: at the start, or everywhere if it is another frame."""

    def error(option: Option, rows: slice = slice(EARLY)) -> float:
        truth = exact[option.name]
        return float(differences(option.name, option.values[rows], truth[rows]).max()) / size(option.name, truth)

    options = [option for option in options if option.name in exact]
    option, reason = options[0], ""
    alike = [o for o in options if o.name == option.name]
    best = min(alike, key=error)
    if len(alike) > 1:
        option, reason = best if error(best) * BETTER < error(option) else option, " (recognised by the exact motion)"
    elsewhere = [o for o in options if o.name != option.name and o.text.split()[-1] == option.text.split()[-1]]
    if elsewhere:
        every = slice(None)
        if error(elsewhere[0], every) * FACTOR < error(option, every):
            option = elsewhere[0]
        reason = " (recognised by the exact motion)"
    if unit in RATES and error(option, slice(1)) > 0.2:
        first = slice(1)
        for other, factor in RATES.items():
            values = option.values / RATES[unit] * factor
            if error(Option(option.name, values, ""), first) < CLOSE:
                raise InputError(
                    f"{place}: expected {unit}, as the names state, got values of which the first row, "
                    f"{shown((option.values[0] / RATES[unit]).tolist())}, is the start of the case in {other}. Correct "
                    f"the names, or specify units={other!r}."
                )
    return option, reason


def _check_start(
    case: Case, quantities: Mapping[str, Array], exact: Mapping[str, Array], times: Array, source: str
) -> None:
    """Raises `InputError` if the first row is the start of another case."""
    from kreisel.checkcases.catalogue import records

    w = quantities.get("angular_velocity")
    if w is None or times[0] != 0:
        return
    truth = exact["angular_velocity"][0]
    if np.linalg.norm(w[0] - truth) < CLOSE * np.linalg.norm(truth):
        return
    starts = {name: np.array([float(v) for v in other.angular_velocity]) for name, other in records().items()}
    fits = [
        name
        for name, start in starts.items()
        for factor in {a / b for a in RATES.values() for b in RATES.values()}
        if np.linalg.norm(w[0] * factor - start) < CLOSE * np.linalg.norm(start)
    ]
    if fits:
        raise InputError(
            f"{source}: expected the start of the case {case.name}, rates {shown(truth.tolist())} rad/s, got "
            f"{shown(w[0].tolist())}, the start of {' or '.join(fits)}. Grade the file against that case."
        )
