"""The lanes of a sweep: a grid, a list and random draws over the values of a configuration.

A quantity has its name in the TOML file: `system.alpha`, `state.m`, `run.dt`, or one entry, `state.m[2]`.  The values
of a lane depend only on the description and the index of the lane, not on how lanes are cut into blocks.
"""

from __future__ import annotations

import json
import math
import re
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from kreisel.algebra import Array
from kreisel.algebra.random import GENERATOR, streams_from
from kreisel.errors import InputError, explained, hint, shown

MOST_LANES = 10**7
LARGEST_DESCRIPTION = 32 << 20  # bytes of JSON
DRAWN_AT_ONCE = 1024  # lanes that share a generator
SECTIONS = ("system", "state", "run")
GRIDS = ("grid", "list", "random", "draws", "rng")
RANGES: dict[str, Callable[..., Any]] = {"linear": np.linspace, "log": np.geomspace}
KEY = re.compile(r"([A-Za-z_][A-Za-z_0-9]*(?:\.[A-Za-z_][A-Za-z_0-9]*)*)(?:\[([0-9]+(?:\s*,\s*[0-9]+)*)\])?")


@explained
@dataclass(frozen=True, eq=False)
class Design:
    """Quantities that vary in a sweep; the lanes are grid x together x draws, the last fastest.

    grid      quantity -> values: every combination, e.g. {"system.alpha": np.linspace(0.5, 2, 20)}
    together  quantity -> values that vary together, of equal count; [sweep.list] in a TOML file
    random    quantity -> {"uniform": [a, b]}, {"loguniform": [a, b]}, {"normal": [mean, deviation]} or
              {"sphere": radius}: `draws` of them with the seed `rng`

    A quantity is `system.`, `state.` or `run.` with a letter, or one entry, "state.m[2]"; `state.orientation` too.
    """

    grid: Mapping[str, Any] | None = None
    together: Mapping[str, Any] | None = None
    random: Mapping[str, Any] | None = None
    draws: int | None = None
    rng: int | None = None

    def __post_init__(self) -> None:
        for name in ("grid", "together", "random"):
            value = getattr(self, name)
            if value is not None and not isinstance(value, Mapping):
                raise InputError(f"{name}: expected a dict, quantity -> values, got {shown(value)}.")

    @property
    def table(self) -> dict[str, Any]:
        """The section [sweep] of a TOML file."""
        tables = {"grid": self.grid, "list": self.together, "random": self.random}
        plain: dict[str, Any] = {name: {} if table is None else table for name, table in tables.items()}
        return {**plain, "draws": self.draws, "rng": self.rng}


@dataclass(frozen=True)
class Varied:
    """A quantity that varies: `section`.`letter`, or its entry at `index`."""

    section: str
    letter: str
    index: tuple[int, ...] = ()

    @property
    def name(self) -> str:
        """The name in the user's notation."""
        entry = f"[{','.join(map(str, self.index))}]" if self.index else ""
        return f"{self.section}.{self.letter}{entry}"


NOISE = Varied("state", GENERATOR)


def _on_sphere(rng: np.random.Generator, shape: tuple[int, ...], radius: Array) -> Array:
    normal = rng.standard_normal(shape)
    return np.asarray(radius * normal / np.sqrt((normal * normal).sum(-1, keepdims=True)))


# the number of bounds, and values by a generator, their shape, bounds
DRAWS: dict[str, tuple[int, Callable[..., Any]]] = {
    "uniform": (2, lambda rng, shape, a, b: a + (b - a) * rng.random(shape)),
    "loguniform": (2, lambda rng, shape, a, b: np.exp(np.log(a) + (np.log(b) - np.log(a)) * rng.random(shape))),
    "normal": (2, lambda rng, shape, mean, deviation: mean + deviation * rng.standard_normal(shape)),
    "sphere": (1, _on_sphere),
}


class Lanes:
    """All lanes of a sweep.

    base    the sections system, state and run that every lane starts from
    spec    the section sweep: grid, list, random, draws, rng
    noisy   whether the state has the generator of the noise of a controller
    words   whether quantities are values of a body, as by `kreisel.sweeps.ensemble.of_body_in_si`; then `base` is
            not needed

    A sweep of a body has in `spec` what it shows: `shown`, values of each lane, and `axes`, as `folded` has them.

    The lanes are the product of the grid, the list and the draws, the last varying fastest; every lane draws separate
    random values.  Raises `InputError`.
    """

    def __init__(
        self, base: Mapping[str, Mapping[str, Any]], spec: Mapping[str, Any], noisy: bool = False, words: bool = False
    ):
        self.noisy, self._words = noisy, words
        self._shown = {_varied(k, "shown", True): np.asarray(v) for k, v in spec.get("shown", {}).items()}
        self._axes = spec.get("axes")
        self.base = {section: dict(base.get(section, {})) for section in SECTIONS}
        quantities = {kind: [*_quantities(spec.get(kind, {}), kind, words)] for kind in ("grid", "list", "random")}
        self.grid, self.listed = ({k: _values(k, v, words) for k, v in quantities[kind]} for kind in ("grid", "list"))
        self.draws = {k: self._draw(k, v) for k, v in quantities["random"]}
        self._check_names()
        lengths = {k.name: len(v) for k, v in self.listed.items()}
        if len(set(lengths.values())) > 1:
            raise InputError(f"All quantities of [sweep.list] need the same number of values, got {lengths}.")
        self.seed, count = _seed_and_count(spec.get("rng"), spec.get("draws"), bool(self.draws))
        self.axes: list[tuple[tuple[Varied, ...], int]] = [((k,), len(v)) for k, v in self.grid.items()]
        if self.listed:
            self.axes.append((tuple(self.listed), next(iter(lengths.values()))))
        self.axes.append(((), count))
        self.total = math.prod(size for _, size in self.axes)
        if self.total > MOST_LANES:
            raise InputError(f"The sweep has {self.total:,} lanes; at most {MOST_LANES:,} are possible.")
        if not self.quantities:
            raise InputError(
                "Nothing varies in the sweep. Name a quantity in [sweep.grid], [sweep.list] or [sweep.random], such as "
                'system.alpha = { from = 0.5, to = 2.0, count = 10 } or state."m[2]" = [1.0, 1.5].'
            )

    @property
    def quantities(self) -> tuple[Varied, ...]:
        """All quantities that vary."""
        stated = (*self.grid, *self.listed, *self.draws)
        return (*stated, NOISE) if self.noisy and stated and NOISE not in stated else stated

    def inputs(self, first: int, stop: int) -> dict[Varied, Array]:
        """The values of lanes first to stop - 1 that a sweep shows."""
        shown = {quantity: value[first:stop] for quantity, value in self._shown.items()}
        return shown or self.values(first, stop)

    @property
    def folded(self) -> list[tuple[str, int, dict[Varied, Array]]]:
        """Name and size of each axis of the result, with the values of its quantities; no axis for a single draw."""
        if self._axes is not None:
            named = {quantity.name: quantity for quantity in self._shown}
            return [
                (axis, size, {named[k]: np.asarray(v) for k, v in values.items()}) for axis, size, values in self._axes
            ]
        out = []
        for quantities, size in self.axes:
            axis = "draw" if not quantities else "list" if quantities[0] in self.listed else quantities[0].name
            if quantities and axis != "list" and self.tables[quantities[0]].ndim > 1:
                axis = f"{axis}_index"
            if quantities or self.draws:
                out.append((axis, size, {quantity: self.tables[quantity] for quantity in quantities}))
        return out

    @property
    def tables(self) -> dict[Varied, Array]:
        """The values of the grid and of the list."""
        return {**self.grid, **self.listed}

    def _check_names(self) -> None:
        names = [k.name for k in (*self.grid, *self.listed, *self.draws)]
        twice = {name for name in names if names.count(name) > 1}
        if twice:
            raise InputError(f"{', '.join(sorted(twice))} varies twice; name each quantity once in [sweep].")
        for quantity in self.quantities:
            if quantity.index and not self._words:
                value = self.base[quantity.section].get(quantity.letter)
                if value is None:
                    raise InputError(
                        f"{quantity.name} varies, but [{quantity.section}] has no {quantity.letter} to start from."
                    )
                shape = np.shape(_number_array(value, f"{quantity.section}.{quantity.letter}"))
                if len(quantity.index) != len(shape) or any(i >= k for i, k in zip(quantity.index, shape, strict=True)):
                    raise InputError(
                        f"{quantity.name} names no entry of {quantity.section}.{quantity.letter}, which has the shape "
                        f"{shape}; entries count from 0."
                    )
            if quantity.section == "run" and quantity in self.draws:
                raise InputError(f"{quantity.name} cannot be drawn at random; vary it in [sweep.grid] or [sweep.list].")

    def _draw(self, quantity: Varied, spec: Any) -> Callable[[np.random.Generator], Array]:
        """A function that draws values (1024, ...) of a quantity."""
        if not isinstance(spec, Mapping) or len(spec) != 1 or next(iter(spec)) not in DRAWS:
            raise InputError(
                f"{quantity.name} in [sweep.random] must be one of {{ uniform = [a, b] }}, {{ loguniform = [a, b] }}, "
                f"{{ normal = [mean, deviation] }}, {{ sphere = radius }}, got {shown(spec)}."
            )
        ((kind, values),) = spec.items()
        listed = list(values) if isinstance(values, Sequence) and not isinstance(values, str) else [values]
        if len(listed) != DRAWS[kind][0]:
            raise InputError(f"{quantity.name}: {kind} needs {DRAWS[kind][0]} values, got {shown(values)}.")
        bounds = tuple(_number_array(v, quantity.name) for v in listed)
        usual = self.base[quantity.section].get(quantity.letter)
        start = () if quantity.index or usual is None else _number_array(usual, quantity.name).shape
        try:
            shape = np.broadcast_shapes(start, *(b.shape for b in bounds))
        except ValueError:
            raise InputError(f"{quantity.name}: the shapes of its value and of the bounds do not fit.") from None
        if kind == "sphere" and self._words and shape == () and not quantity.index:
            shape = (4,) if "attitude" in quantity.letter else (3,)
        if kind == "sphere" and len(shape) != 1:
            raise InputError(f"{quantity.name}: sphere draws a vector; give the vector in [{quantity.section}] too.")
        if kind == "loguniform" and not all((b > 0).all() for b in bounds):
            raise InputError(f"{quantity.name}: loguniform needs positive bounds, got {shown(values)}.")
        if quantity.index and shape:
            raise InputError(f"{quantity.name} is a scalar, got bounds of shape {shape}.")
        return lambda rng: np.asarray(DRAWS[kind][1](rng, (DRAWN_AT_ONCE, *shape), *bounds))

    def values(self, first: int, stop: int) -> dict[Varied, Array]:
        """The values of lanes first to stop - 1 (lanes, ...), for every quantity that varies.

        Random values are drawn by one generator for each quantity and each 1024 lanes, whatever else varies.
        """
        places = np.unravel_index(np.arange(first, stop), [size for _, size in self.axes])
        out = {
            quantity: self.tables[quantity][place]
            for (quantities, _), place in zip(self.axes, places, strict=True)
            for quantity in quantities
        }
        chunks = range(first // DRAWN_AT_ONCE, -(-stop // DRAWN_AT_ONCE))
        for quantity, draw in self.draws.items():
            keys = ((zlib.crc32(quantity.name.encode()), chunk) for chunk in chunks)
            seeds = (np.random.SeedSequence(self.seed, spawn_key=key) for key in keys)
            values = np.concatenate([draw(np.random.Generator(np.random.PCG64(seed))) for seed in seeds])
            out[quantity] = values[first - chunks.start * DRAWN_AT_ONCE :][: stop - first]
        if self.noisy and NOISE not in out:  # each generator of a controller has its stream, the first for [state]
            begin = [int(v) for v in _number_array(self.base[NOISE.section][NOISE.letter], NOISE.name)]
            out[NOISE] = streams_from(begin, stop - first, first)
        return out

    def filled(self, values: Mapping[Varied, Array]) -> dict[str, dict[str, Any]]:
        """The sections with these values in place: arrays with an axis of lanes if a quantity varies."""
        out: dict[str, dict[str, Any]] = {section: dict(table) for section, table in self.base.items()}
        varied: set[tuple[str, str]] = set()
        for quantity in sorted(values, key=lambda q: len(q.index)):  # an entry replaces part of a varying quantity
            value, table = values[quantity], out[quantity.section]
            if quantity.index:
                entries = table[quantity.letter]
                if (quantity.section, quantity.letter) not in varied:
                    entries = np.broadcast_to(_number_array(entries, quantity.name), (len(value), *np.shape(entries)))
                array: Any = np.array(entries, dtype=np.float64)
                array[(slice(None), *quantity.index)] = value
                value = array
            table[quantity.letter] = value
            varied.add((quantity.section, quantity.letter))
        return out


def _quantities(spec: Any, where: str, words: bool, prefix: str = "") -> Iterator[tuple[Varied, Any]]:
    """Pairs of [sweep.grid] and the others; `system.p`, `[sweep.grid.system]` and `"system.p"` are equivalent."""
    if not isinstance(spec, Mapping):
        raise InputError(f"[sweep.{where}] must be a table of quantities and their values, got {shown(spec)}.")
    for key, value in spec.items():
        if isinstance(value, Mapping) and not value.keys() & {"from", *DRAWS} and "[" not in key:
            yield from _quantities(value, where, words, f"{prefix}{key}.")
        else:
            yield _varied(prefix + key, where, words), value


def _varied(key: str, where: str, words: bool) -> Varied:
    section, _, remainder = key.partition(".")
    match = KEY.fullmatch(remainder)
    nested = match is not None and "." in match[1] and section != "body"
    if section not in (*SECTIONS, *("body",) * words) or match is None or nested:
        usual = "body.mass, body.inertia[2,2], run.dt" if words else "system.alpha, state.m, state.m[2] or run.dt"
        raise InputError(
            f"[sweep.{where}] names {shown(key)}; expected are names such as {usual}.{hint(section, SECTIONS)}"
        )
    index = tuple(int(i) for i in match[2].split(",")) if match[2] else ()
    return Varied(section, match[1], index)


def _values(quantity: Varied, spec: Any, words: bool) -> Array:
    """The values of a grid axis or a list (count, ...)."""
    if isinstance(spec, Mapping):
        return _range(quantity, spec)
    if isinstance(spec, str) or not isinstance(spec, Sequence | np.ndarray) or len(spec) == 0:
        raise InputError(f"{quantity.name} needs a list or {{ from = a, to = b, count = k }}, got {shown(spec)}.")
    text = all(isinstance(v, str) for v in spec)
    if text and not words and (quantity.section != "run" or quantity.index):
        raise InputError(f"{quantity.name} must be numeric, got {shown(spec)}.")
    if text or (words and np.asarray(spec).dtype.kind == "U"):
        return np.asarray(spec)
    table = _number_array(spec, quantity.name)
    if quantity.index and table.ndim != 1:
        raise InputError(f"{quantity.name} is a scalar, got values of shape {table.shape[1:]}.")
    return table


def _range(quantity: Varied, spec: Mapping[str, Any]) -> Array:
    if not {"from", "to", "count"} <= set(spec) <= {"from", "to", "count", "spacing"}:
        raise InputError(f"{quantity.name}: a range needs from, to, count (and spacing = 'log'), got {shown(spec)}.")
    count, spacing = spec["count"], spec.get("spacing", "linear")
    if isinstance(count, bool) or not isinstance(count, int) or not 1 <= count <= MOST_LANES:
        raise InputError(f"{quantity.name}: count must be an integer, 1 to {MOST_LANES:,}, got {shown(count)}.")
    if spacing not in RANGES:
        raise InputError(f"{quantity.name}: spacing is 'linear' or 'log', got {shown(spacing)}.")
    low, high = _number_array(spec["from"], quantity.name), _number_array(spec["to"], quantity.name)
    if spacing == "log" and not ((low > 0).all() and (high > 0).all()):
        raise InputError(f"{quantity.name}: a logarithmic range needs positive ends, got {shown(spec)}.")
    if low.shape != high.shape or low.size * count > 8 * MOST_LANES:
        raise InputError(f"{quantity.name}: expected from and to of the same shape, at most {8 * MOST_LANES:,} values.")
    return np.asarray(RANGES[spacing](low, high, count))


def _number_array(value: Any, name: str) -> Array:
    try:
        array = np.asarray(value)
    except (ValueError, OverflowError):
        raise InputError(f"{name}: all values need the same shape, got {shown(value)}.") from None
    if array.dtype.kind not in "iuf":
        raise InputError(f"{name} must be numeric, got {shown(value)}.")
    if not np.isfinite(array).all():
        raise InputError(f"{name} must be finite, got {shown(value)}.")
    return array if array.dtype.kind != "f" else array.astype(np.float64)


def _seed_and_count(rng: Any, draws: Any, random: bool) -> tuple[int, int]:
    """The seed and the number of random draws, 0 and 1 without any.  Raises `InputError`."""
    if not random:
        for name, value in (("rng", rng), ("draws", draws)):
            if value is not None:
                raise InputError(f"{name} is given, but nothing is drawn in [sweep.random].")
        return 0, 1
    if isinstance(rng, bool) or not isinstance(rng, int) or not 0 <= rng < 2**128:
        raise InputError(f"Random draws need a seed, rng = 1 or another integer below 2^128, got {shown(rng)}.")
    if isinstance(draws, bool) or not isinstance(draws, int) or not 1 <= draws <= MOST_LANES:
        raise InputError(f"draws must be the number of random draws, 1 to {MOST_LANES:,}, got {shown(draws)}.")
    return rng, draws


def described(value: Any, place: str = "") -> Any:
    """The description as plain data that JSON preserves bit for bit.  Raises `InputError` with the place."""
    if isinstance(value, Mapping):
        return {str(k): described(v, f"{place}.{k}".lstrip(".")) for k, v in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        plain = (value.astype(np.float64) if value.dtype.kind == "f" else value).tolist()
        return plain if value.dtype.kind in "biufU" else described(plain, place)
    if isinstance(value, list | tuple):
        return [described(v, place) for v in value]
    if isinstance(value, range):
        return list(value)
    if value is None or isinstance(value, bool | int | float | str):
        return value
    raise InputError(
        f"{place or 'sweep'}: expected values, words and lists, got {shown(value)}. Write dates as text, in quotes."
    )


def as_json(description: Mapping[str, Any]) -> str:
    """The description as text, in its order, which is the order of the lanes.

    Raises `InputError` if it is too long for the attributes of an archive.
    """
    text = json.dumps(description)
    if len(text) > LARGEST_DESCRIPTION:
        raise InputError(
            f"The description of the sweep has {len(text):,} characters, more than {LARGEST_DESCRIPTION >> 20} MiB. "
            "Use ranges or random draws, or several sweeps."
        )
    return text
