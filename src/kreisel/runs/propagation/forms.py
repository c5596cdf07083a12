"""States in the form of a propagator's user, and as rows of the variables that its method steps."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.algebra.reuse import cached_property
from kreisel.errors import InputError, shown
from kreisel.kernels.cpu import RowFunction, row_function
from kreisel.kernels.layout import Floats
from kreisel.method.scheme import ORIENTATION, Flow, Scheme, with_orientation
from kreisel.record.model import Model, State
from kreisel.record.perturbation import pairs_of, require_bodies
from kreisel.record.values import in_lane
from kreisel.runs.plan import Plan, is_finite
from kreisel.runs.settings import ORTHOGONAL_TOLERANCE, Settings, initial_orientation

Rows = Callable[[Floats], Floats]
Reader = Callable[[Any], Sequence[float] | None]
DOUBLE = np.dtype(np.float64)
MODERATE = 1e75  # a length whose products do not overflow


class StateForms:
    """States of a model as mappings or arrays (lanes, size), and as rows of a scheme's variables (lanes, d).

    letters  of the components of a state, the orientation last
    places   of each component among the `size` entries of a state
    """

    def __init__(self, model: Model, scheme: Scheme, settings: Settings):
        self.model, self.scheme, self.settings = model, scheme, settings
        self.oriented = ORIENTATION in scheme.outcomes
        components = with_orientation(model, self.oriented)
        self.letters = tuple(letter for letter, _ in components)
        self._stored = [algebra.KINDS[kind] for _, kind in components]
        self._kinds = [kind.shown(model.n).name for kind in self._stored]
        self.size = algebra.coordinate_count(self._kinds, model.n)
        self.places = dict(zip(self.letters, algebra.slices(self._kinds, model.n), strict=True))
        single = not model.batch and pairs_of(model) is None
        self.single = (self.size,) if single else None  # the shapes of one state that are accepted
        self._checks = model.system.checks.state
        vectors = all(dict(components)[letter] == "vector" for letter in self._checks)
        free = single and vectors and not model.system.space.constraints
        self._readers = [(k, _reader(kind, model.n)) for k, kind in components] if free else []
        several = [algebra.KINDS[kind].unpack if algebra.KINDS[kind].axes != 1 else None for kind in self._kinds]
        self._unpack = list(zip(self.letters, self.places.values(), several, strict=True))
        self._converters: dict[int, tuple[Rows, Rows]] = {}

    def plan(self, scheme: Scheme, z: Floats, steps: int = 1, every: int = 1) -> Plan:
        """The plan of `steps` steps by a scheme from rows z."""
        return Plan(self.model, scheme, self.settings.but(steps=steps, every=every), z, True, {})

    def rows_of(self, state: Any) -> tuple[Floats, bool]:
        """A state as rows (lanes, size), and whether it has lanes.  Raises `InputError`."""
        if type(state) is np.ndarray and state.shape == self.single and state.dtype is DOUBLE and state.flags.carray:
            if not math.isfinite(sum(state.tolist())):
                require_finite(state[None])
            return state[None], False
        if type(state) is dict or isinstance(state, Mapping):
            entries = self._entries(state)
            if entries is not None:
                return np.array((entries,), DOUBLE), False
            numbers = self._checked(state)
        else:
            numbers = algebra.floats(state)
        if not 1 <= numbers.ndim <= 2 or numbers.shape[-1] != self.size or not numbers.size:
            raise InputError(
                f"The state of {self.model.system.name}: expected a mapping of {', '.join(self.letters)}, or an array "
                f"of these {self.size} values, ({self.size},) or (lanes, {self.size}), got {shown(state)}."
            )
        x = numbers if numbers.ndim > 1 else numbers[None]
        if self.model.batch and len(x) != self.model.batch[0]:
            if len(x) > 1:
                raise InputError(
                    f"The state of {self.model.system.name}: expected one, or {self.model.batch[0]} as the parameters "
                    f"have lanes, got {len(x)}."
                )
            x = np.broadcast_to(x, (self.model.batch[0], self.size))
        batched = numbers.ndim > 1 or bool(self.model.batch)
        require_bodies(self.model, (len(x),) if batched else ())
        require_finite(x)
        return np.require(x, requirements=["C", "A", "W"]), batched  # kernels accept no others

    def _entries(self, state: Mapping[str, Any]) -> list[float] | None:
        """The entries of one state whose components are plain arrays or floats; None if it needs the other checks."""
        if len(state) != len(self._readers):
            return None
        numbers: list[float] = []
        for letter, read in self._readers:
            entries = read(state.get(letter))
            if entries is None:
                return None
            numbers += entries
        if not math.hypot(*numbers) < MODERATE:
            return None
        if self._checks and not (type(state) is State and state.is_of(self.model.system)):
            for letter, check in self._checks.items():
                check(np.asarray(state[letter]), letter)
        return numbers

    def _checked(self, state: Mapping[str, Any]) -> Floats:
        """A mapping as one array, checked like the start of a run."""
        components = {name: value for name, value in state.items() if name not in (self.settings.observe or ())}
        g = components.pop(ORIENTATION, None)
        if (g is not None) != self.oriented:
            raise InputError(
                f"g: expected {'an' if self.oriented else 'no'} orientation in the state, got "
                f"{'none' if g is None else 'one'}. kr.propagator(..., orientation=True) carries one along."
            )
        checked = self.model.checked({str(letter): value for letter, value in components.items()})
        parts = [checked[letter] for letter in self.model.system.space.letters]
        parts += [] if g is None else [initial_orientation(g, self.model)]
        natural = [kind.for_user(z) for kind, z in zip(self._stored, parts, strict=True)]
        return np.asarray(algebra.flatten(natural, self._kinds))

    def components(self, x: Array) -> tuple[Array, ...]:
        """The components of states (..., size) in the form of the system."""
        with np.errstate(invalid="ignore"):
            parts = algebra.restore(x, self._kinds, self.model.n)
        return self._from_user(parts)

    def _from_user(self, parts: tuple[Array, ...]) -> tuple[Array, ...]:
        return tuple(kind.from_user(x, self.model.n) for kind, x in zip(self._stored, parts, strict=True))

    def require_on_phase_space(self, x: Floats) -> None:
        """Raises `InputError` for states off the phase space, which is not otherwise checked for arrays."""
        self.model.checked(dict(zip(self.model.system.space.letters, self.components(x), strict=False)))

    def prepared(self, x: Floats) -> Floats:
        """States (lanes, size) in the method's variables (lanes, d)."""
        rows = self._conversions(len(x))[0](x[None])[0]
        return rows if is_finite(rows) else self._prepared_arrays(x)  # which states that it refuses

    def observed(self, rows: Floats) -> Floats:
        """Rows (rows, lanes, d) of the method's variables as states, followed by the observed quantities."""
        return self._conversions(rows.shape[1])[1](rows)

    def compiled(self, lanes: int) -> tuple[RowFunction, RowFunction] | None:
        """Both conversions, of states and of the method's variables, if both are compiled."""
        into, out = self._conversions(lanes)
        return (into, out) if isinstance(into, RowFunction) and isinstance(out, RowFunction) else None

    def _conversions(self, lanes: int) -> tuple[Rows, Rows]:
        """Maps from rows (rows, lanes, size) of states to rows of the method's variables, and back to returned rows.

        Compiled if the functions can be recorded, else the definitions on arrays.
        """
        if lanes in self._converters:
            return self._converters[lanes]
        n, scheme, plan = self.model.n, self.scheme, self.plan(self.scheme, np.zeros((lanes, 0)))

        def prepared(parts: tuple[Array, ...], /, **_: Array) -> dict[str, Array]:
            return {"z": self._prepared(parts)}

        def returned(parts: tuple[Array, ...], /, **constants: Array) -> dict[str, Array]:
            return self._lines(plan.variables(parts, **constants))

        def returned_arrays(z: Floats) -> Floats:
            lines = returned(algebra.restore(z, scheme.kinds, n), **scheme.constants).values()
            return np.concatenate([np.broadcast_to(v, (*z.shape[:2], v.shape[-1])) for v in lines], -1)

        kinds = tuple(zip(self.letters, self._kinds, strict=True))
        natural = replace(scheme, components=kinds, structure=None)  # `prepare` has values of the model
        into = None if self.model.batch else row_function(natural, prepared, lanes, ("prepare",))
        by_arrays = isinstance(scheme.motion, Flow)  # as the rows of a run
        out = None if by_arrays else row_function(scheme, returned, lanes, ("return", self.settings.observe))
        converters: tuple[Rows, Rows] = into or self._prepared_arrays, out or returned_arrays
        self._converters[lanes] = converters
        return converters

    def _prepared(self, parts: tuple[Array, ...]) -> Array:
        return algebra.flatten(self.scheme.prepare(self._from_user(parts)), self.scheme.kinds)

    def _prepared_arrays(self, x: Floats) -> Floats:
        with np.errstate(invalid="ignore"):  # of states that are refused afterwards
            return np.ascontiguousarray(self._prepared(algebra.restore(x, self._kinds, self.model.n)))

    def _lines(self, outputs: Mapping[str, Array]) -> dict[str, Array]:
        """The state, the orientation, and the observed quantities, each as entries along the last axis."""
        names = (*self.letters, *(name for name in outputs if name not in self.letters))
        return {name: self._line(name, outputs[name]) for name in names}

    def _line(self, name: str, value: Array) -> Array:
        kind = self.scheme.outcomes[name].axes
        if kind:
            return algebra.KINDS[kind].shown(self.model.n).pack(value)
        return value if np.ndim(value) > 2 else value[..., None]

    def of_plan(self, outputs: Mapping[str, Array]) -> Floats:
        """The outputs of a plan as rows ([rows,] lanes, entries)."""
        return np.concatenate(list(self._lines(outputs).values()), -1)

    def returned(self, x: Floats, state: Any, batched: bool) -> Any:
        """Rows ([rows,] lanes, entries) in the form in which a state was given."""
        if not batched:
            x = x[0] if x.ndim == 2 else x[..., 0, :]
        if type(state) is np.ndarray:
            return x
        return self.mapping(x) if type(state) is dict or isinstance(state, Mapping) else x

    def mapping(self, x: Floats) -> dict[str, Any]:
        """Entries (..., entries) as the components of a state and the observed quantities."""
        single, n = x.ndim == 1, self.model.n
        out: dict[str, Any] = {}
        for letter, place, unpack in self._unpack:
            entries = x[place] if single else x[..., place]
            out[letter] = entries if unpack is None else unpack(entries, n)
        if not self.settings.observe:
            return out
        return out | {name: x[..., place] for name, place in self.observed_places.items()}

    @cached_property
    def observed_places(self) -> dict[str, Any]:
        """The places of the observed quantities after the state."""
        if not self.settings.observe:
            return {}
        x = np.ones((*(self.model.batch or (1,)), self.size))
        if self.oriented:
            x[:, self.places[ORIENTATION]] = (1, 0, 0, 0) if self.model.n == 3 else np.eye(self.model.n).ravel()
        plan = self.plan(self.scheme, self._conversions(len(x))[0](x[None])[0])
        out, start = {}, self.size
        for name, value in plan.example.items():
            if name not in self.letters:
                width = self._line(name, value).shape[-1]
                out[name] = slice(start, start + width) if value.ndim > 2 else start
                start += width
        return out


def require_finite(x: Floats) -> None:
    """Raises `InputError` for states (lanes, size) that are not finite."""
    if not is_finite(x):
        where = in_lane(~np.isfinite(x).all(-1))
        raise InputError(f"The state: expected finite values, got NaN or infinity{where}.")


# -- components of one state that need few checks: the entries as from the full checks, or None for the full checks


def _reader(kind: str, n: int) -> Reader:
    if kind == "quaternion":
        return _quaternion
    width = algebra.KINDS[kind].count(n)
    if kind == "skew" and n == 3:
        return _axial
    if kind in ("skew", "symmetric"):
        return lambda value: _square(value, n, kind)
    return lambda value: None if kind == "matrix" else _vector(value, width)


def _vector(value: Any, width: int) -> Sequence[float] | None:
    if type(value) is np.ndarray and value.dtype is DOUBLE and value.shape == (width,):
        numbers: list[float] = value.tolist()
        return numbers
    plain = type(value) in (tuple, list) and len(value) == width and all(type(v) in (float, int) for v in value)
    return value if plain and all(abs(v) < 1 << 53 for v in value if type(v) is int) else None


def _axial(value: Any) -> Sequence[float] | None:
    if not (type(value) is np.ndarray and value.dtype is DOUBLE and value.shape == (3, 3)):
        return _vector(value, 3)
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = value.tolist()
    if xx or yy or zz or xy + yx or xz + zx or yz + zy:
        return None
    return [-(yz / 2 - zy / 2), xz / 2 - zx / 2, -(xy / 2 - yx / 2)]  # with the signs of its zeros


def _square(value: Any, n: int, kind: str) -> Sequence[float] | None:
    if not (type(value) is np.ndarray and value.dtype is DOUBLE and value.shape == (n, n)):
        return None
    mirrored = -value.T if kind == "skew" else value.T
    if (value - mirrored).any():
        return None
    numbers: list[float] = algebra.KINDS[kind].pack(value / 2 + mirrored / 2).tolist()
    return numbers


def _quaternion(value: Any) -> Sequence[float] | None:
    numbers = _vector(value, 4)
    if numbers is None:
        return None
    w, x, y, z = numbers
    length = math.sqrt(w * w + x * x + y * y + z * z)
    return [w / length, x / length, y / length, z / length] if abs(length - 1) < ORTHOGONAL_TOLERANCE else None
