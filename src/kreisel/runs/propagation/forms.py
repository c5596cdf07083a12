"""States as a propagator takes and returns them, and as its method steps them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.algebra.computed import cached_property
from kreisel.errors import InputError, shown
from kreisel.forces.pairs import pairs_of, require_bodies
from kreisel.kernels.correcting import corrections
from kreisel.kernels.cpu import compiled_rows
from kreisel.kernels.layout import Floats
from kreisel.method.observing import ORIENTATION, with_orientation
from kreisel.method.scheme import Flow, Scheme
from kreisel.record.model import Model
from kreisel.runs.plan import Plan
from kreisel.runs.settings import Settings, initial_orientation

Rows = Callable[[Floats], Floats]
DOUBLE = np.dtype(np.float64)


class StateForms:
    """States of a model as mappings or arrays (lanes, size), and as rows of the method's own variables."""

    def __init__(self, model: Model, made: Scheme, settings: Settings):
        self.model, self.settings, self._scheme = model, settings, made
        self._oriented = ORIENTATION in made.outcomes
        components = with_orientation(model, self._oriented)
        self.letters = tuple(letter for letter, _ in components)
        self._kinds = ["vector" if kind == "skew" and model.n == 3 else kind for _, kind in components]
        self._own_kinds = made.kinds
        self._places = dict(zip(self.letters, algebra.slices(self._kinds, model.n), strict=True))
        self.size = algebra.coordinate_count(self._kinds, model.n)
        self._axial = [letter for letter, kind in components if kind == "skew" and model.n == 3]
        alone = not model.batch and pairs_of(model) is None
        self._alone = (self.size,) if alone else None  # the shape of one state as it may be given
        self._converters: dict[int, tuple[Rows, Rows]] = {}
        self._back, self._out = corrections(made)

    def _plan(self, made: Scheme, z: Floats, steps: int = 1, every: int = 1) -> Plan:
        return Plan(self.model, made, self.settings.but(steps=steps, every=every), z, True, {})

    def _given(self, state: Any) -> tuple[Floats, bool]:
        """A state as rows (lanes, size), and whether it has lanes.  Raises `InputError`."""
        if type(state) is np.ndarray and state.shape == self._alone and state.dtype is DOUBLE and state.flags.carray:
            return state[None], False
        plain = type(state) is np.ndarray and state.dtype == np.float64
        if not plain or state.ndim > 2 or state.shape[-1:] != (self.size,) or not state.size:
            state = _numbers(self._flat(state) if isinstance(state, Mapping) else state, self)
        x = state if state.ndim > 1 else state[None]
        if self.model.batch and len(x) != self.model.batch[0]:
            if len(x) > 1:
                raise InputError(
                    f"The state of {self.model.system.name}: expected one, or {self.model.batch[0]} as the parameters "
                    f"have lanes, got {len(x)}."
                )
            x = np.broadcast_to(x, (self.model.batch[0], self.size))
        batched = state.ndim > 1 or bool(self.model.batch)
        require_bodies(self.model, (len(x),) if batched else ())
        return np.require(x, requirements=["C", "A", "W"]), batched  # kernels accept no others

    def _flat(self, state: Mapping[str, Any]) -> Floats:
        """A mapping as one array, checked as the start of a run is."""
        given = {name: value for name, value in state.items() if name not in (self.settings.observe or ())}
        g = given.pop(ORIENTATION, None)
        if (g is not None) != self._oriented:
            had = "none" if g is None else "one"
            raise InputError(
                f"g: expected {'an' if self._oriented else 'no'} orientation in the state, got {had}. "
                "kr.propagator(..., orientation=True) carries one along."
            )
        own = self.model.state(**{str(letter): value for letter, value in given.items()})
        parts = [own[letter] for letter in self.model.system.space.letters]
        parts += [] if g is None else [initial_orientation(g, self.model)]
        natural = [algebra.axial(p) if k in self._axial else p for k, p in zip(self.letters, parts, strict=True)]
        return np.asarray(algebra.flatten(natural, self._kinds))

    def _conversions(self, lanes: int) -> tuple[Rows, Rows]:
        """From rows (rows, lanes, size) of states to those of the method's own variables, and back to what is returned.

        Compiled where the functions can be recorded, else the definitions on arrays.
        """
        if lanes in self._converters:
            return self._converters[lanes]
        n, made, plan = self.model.n, self._scheme, self._plan(self._scheme, np.zeros((lanes, 0)))
        natural = tuple(zip(self.letters, self._kinds, strict=True))

        def prepared(parts: tuple[Array, ...], /, **_: Array) -> dict[str, Array]:
            own = [algebra.hat(p) if k in self._axial else p for k, p in zip(self.letters, parts, strict=True)]
            return {"z": algebra.flatten(made.prepare(tuple(own)), self._own_kinds)}

        def returned(parts: tuple[Array, ...], /, **known: Array) -> dict[str, Array]:
            return self._lines(plan.variables(parts, **known))

        given = replace(made, components=natural)
        into = None if self.model.batch else compiled_rows(given, prepared, lanes, ("prepare",))
        by_arrays = isinstance(made.motion, Flow)  # as the rows of a run
        out_of = None if by_arrays else compiled_rows(made, returned, lanes, ("return", self.settings.observe))
        found = (
            into[0]
            if into
            else _quiet(lambda x: np.ascontiguousarray(prepared(algebra.restore(x, self._kinds, n))["z"])),
            out_of[0]
            if out_of
            else lambda z: np.concatenate(
                [
                    np.broadcast_to(v, (*z.shape[:2], v.shape[-1]))
                    for v in returned(algebra.restore(z, self._own_kinds, n), **made.constants).values()
                ],
                -1,
            ),
        )
        self._converters[lanes] = found
        return found

    def _lines(self, outputs: Mapping[str, Array]) -> dict[str, Array]:
        """The state, the orientation, and what is observed beside, each as numbers along the last axis."""
        names = (*self.letters, *(name for name in outputs if name not in self.letters))
        return {name: self._line(name, outputs[name]) for name in names}

    def _line(self, name: str, value: Array) -> Array:
        """A variable as numbers along the last axis."""
        kind = self._scheme.outcomes[name].axes
        if kind in ("skew", "symmetric", "matrix") and name not in self._axial:
            return algebra.flatten([value], [kind])
        return value if kind or np.ndim(value) > 2 else value[..., None]

    def _returned(self, x: Floats, state: Any, batch: bool) -> Any:
        """Rows ([rows,] lanes, numbers) in the form that was given."""
        x = x if batch else x[..., 0, :]
        if type(state) is np.ndarray or not isinstance(state, Mapping):
            return x
        out = {}
        for letter, kind in zip(self.letters, self._kinds, strict=True):
            out[letter] = algebra.restore(x[..., self._places[letter]], [kind], self.model.n)[0]
        return out | {name: x[..., place] for name, place in self._beside.items()}

    @cached_property
    def _beside(self) -> dict[str, Any]:
        """Where what is observed beside the state stands."""
        if not self.settings.observe:
            return {}
        x = np.ones((*(self.model.batch or (1,)), self.size))
        if self._oriented:
            x[:, self._places[ORIENTATION]] = (1, 0, 0, 0) if self.model.n == 3 else np.eye(self.model.n).ravel()
        plan = self._plan(self._scheme, self._conversions(len(x))[0](x[None])[0])
        out, start = {}, self.size
        for name, value in plan.example.items():
            if name not in self.letters:
                width = self._line(name, value).shape[-1]
                out[name] = slice(start, start + width) if value.ndim > 2 else start
                start += width
        return out


def _quiet(convert: Rows) -> Rows:
    """Without NumPy's warnings of states that are not finite, which are refused afterwards."""

    def converted(x: Floats) -> Floats:
        with np.errstate(invalid="ignore"):
            return convert(x)

    return converted


def _numbers(state: Any, of: StateForms) -> Floats:
    x = algebra.floats(state)
    if not 1 <= x.ndim <= 2 or x.shape[-1] != of.size or not x.size:
        raise InputError(
            f"The state of {of.model.system.name}: expected a mapping of {', '.join(of.letters)}, or an array of these "
            f"{of.size} numbers, ({of.size},) or (lanes, {of.size}), got {shown(state)}."
        )
    return x
