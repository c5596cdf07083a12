"""A record with its parameters filled in, and states of it."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.algebra.reuse import Identity
from kreisel.display import show
from kreisel.errors import InputError, hint, shown
from kreisel.record.calling import Function, call, require_names
from kreisel.record.table import handles
from kreisel.record.units import OF_SYSTEM, BodyFrame
from kreisel.record.values import (
    SKEW_TOLERANCE,
    axes_of,
    by_lane,
    common_batch,
    component,
    of_axial,
    parameter,
    require_on_phase_space,
    shape_of,
    text_of,
    whole_dimension,
)

if TYPE_CHECKING:
    import xarray as xr
    from numpy.typing import ArrayLike
    from scipy.spatial.transform import Rotation

    from kreisel.record.contract import Map, Parameter, System

    StateLike: TypeAlias = "State | Mapping[str, ArrayLike] | xr.Dataset"  # a state, its components, a row of a run
    OrientationLike: TypeAlias = ArrayLike | Rotation  # a rotation matrix, a quaternion (w, x, y, z), a Rotation


class State(Mapping[str, Array]):
    """Named components of a state, e.g. `x["m"]` or `x.m`; skew matrices are (..., n, n).

    `.axial` is the state with axial vectors (..., 3) in place of skew 3 x 3 matrices, `.orientation` the orientation g
    with which a run of a body of `kr.physical` begins, else None.
    """

    orientation: Array | None = None
    frame: BodyFrame = OF_SYSTEM  # axes and units of the body that made the state

    def __init__(self, components: Mapping[str, Array], kinds: Mapping[str, str], system: System | None = None):
        self._components, self._kinds, self._system = dict(components), dict(kinds), system

    def __getstate__(self) -> dict[str, Any]:  # a record may hold functions that cannot be pickled
        return {**self.__dict__, "_system": None}

    def started(self, orientation: Array | None, frame: BodyFrame) -> State:
        """The state with the orientation with which its run begins, and the axes and units of its body."""
        out = State(self._components, self._kinds, self._system)
        out.orientation, out.frame = orientation, frame
        return out

    def is_of(self, system: System) -> bool:
        """Whether a model of this record has checked the state."""
        return self._system is system

    def __getitem__(self, letter: str) -> Array:
        if letter not in self._components:
            raise KeyError(f"this state has the components {', '.join(self._components)}, not {letter!r}")
        return self._components[letter]

    def __getattr__(self, letter: str) -> Array:
        components = self.__dict__.get("_components", {})  # not yet set in a copy created by pickle
        if letter not in components:
            raise AttributeError(f"this state has the components {', '.join(components)}, not {letter!r}")
        return components[letter]

    def __iter__(self) -> Iterator[str]:
        return iter(self._components)

    def __len__(self) -> int:
        return len(self._components)

    def __dir__(self) -> list[str]:
        return [*super().__dir__(), *self._components]

    def __repr__(self) -> str:
        return "State(" + ", ".join(f"{k}={text_of(v)}" for k, v in self._components.items()) + ")"

    def _repr_html_(self) -> str:
        return str(show("state", self))

    @property
    def axial(self) -> State:
        """The state with axial vectors (..., 3) for skew matrices if n = 3."""
        kinds = {k: algebra.KINDS[kind] for k, kind in self._kinds.items()}
        components = {k: kinds[k].for_user(v) for k, v in self._components.items()}
        return State(
            components, {k: kind.shown((self._components[k].shape or (0,))[-1]).name for k, kind in kinds.items()}
        )


class Model:
    """A system with its parameters, as used by runs, laws and users.

    Attributes: `system` (the record), `params` (arrays by letter), `n`, and `body_frame`: axes and units of its body of
    `kr.physical`, which are false for another model.  Raises `InputError` for unknown, missing or unusable parameters.
    """

    def __init__(self, system: System, params: Mapping[str, Any], body_frame: BodyFrame = OF_SYSTEM):
        self.system = system
        names = [p.letter for p in system.parameters]
        for letter in params:
            if letter not in names:
                raise InputError(
                    f"{system.name} has {'the parameters ' if names else 'no parameters'}{', '.join(names)}, got "
                    f"{shown(letter)}.{hint(letter, names)}"
                )
        self.params: dict[str, Array] = {}
        for p in system.parameters:
            value = params.get(p.letter, p.default)
            if value is None:
                raise InputError(
                    f"{system.name} needs the parameter {p.letter} ({p.kind}): {p.meaning}, got none; "
                    f"give {p.letter}=..."
                )
            self.params[p.letter] = by_lane(partial(parameter, p, system.name), value, single=partial(_single, p))
        self.n = self._dimension()
        for p in system.parameters:
            if p.check is not None:
                check, array = partial(_check, p), self.params[p.letter]
                by_lane(check, array, single=partial(axes_of, p))
        items = zip(system.parameters, self.params.items(), strict=True)
        batches = {letter: v.shape[: v.ndim - axes_of(p, v)] for p, (letter, v) in items}
        self.batch = common_batch(f"the parameters of {system.name}", batches)
        spread = {
            k: np.broadcast_to(v, self.batch + v.shape[len(b) :])
            for (k, v), b in zip(self.params.items(), batches.values(), strict=True)
        }
        if system.checks.parameters is not None:
            call(system.checks.parameters, (), spread)
        self.constants: dict[str, Array] = dict(spread)
        if system.derive is not None:
            self.constants.update(self._derived(spread))
        self.axes = {k: v.ndim - len(self.batch) for k, v in self.constants.items()}
        self._rows = []  # of tables, whose addresses are constants
        for p in system.parameters:
            if p.kind == "array" and self.params[p.letter].ndim == axes_of(p, self.params[p.letter]):  # of all lanes
                self.constants[p.letter] = self.params[p.letter]
                self.axes[p.letter] = self.params[p.letter].ndim
            elif p.kind == "table":
                values, rows = handles(self.params[p.letter])
                self.constants[p.letter] = np.broadcast_to(values, (*self.batch, values.shape[-1]))
                self.axes[p.letter] = 1
                self._rows.append(rows)
        if not body_frame and system.body_frame is not None:
            body_frame = call(system.body_frame, (), self.constants)
        self.body_frame = body_frame

    def _derived(self, spread: Mapping[str, Array]) -> dict[str, Array]:
        """Further constants, computed once.  Raises `InputError` if they leave the range of doubles."""
        try:
            with np.errstate(all="ignore"):
                result = dict(call(self.system.derive, (), spread))
        except np.linalg.LinAlgError:  # of a matrix that is singular after rounding
            result = {"an inverse matrix": np.asarray(np.nan)}
        lost = [k for k, v in result.items() if np.asarray(v).dtype.kind == "f" and not np.isfinite(v).all()]
        if lost and not self.batch:  # in an ensemble, the failing lanes
            raise InputError(
                f"{self.system.name}: expected parameters whose products and ratios a double can hold, got some with "
                f"which {', '.join(lost)} is not finite. Use other units."
            )
        return result

    def __getattr__(self, name: str) -> Any:
        system = None if name.startswith("_") else self.__dict__.get("system")
        if system is None:
            raise AttributeError(name)
        if name in self.params:
            raise AttributeError(f"the parameter {name} of {system.name} is .params[{name!r}]")
        message = (
            f"{system.name} has no attribute {name!r}.{hint(name, dir(self))} Functions take it as their first "
            "argument: kr.simulate(system, x0, dt=..., steps=...)."
        )
        raise AttributeError(message, name=name, obj=None)  # without an object Python adds no second hint

    def __reduce__(self) -> Any:
        return Model, (self.system, self.params, self.body_frame)

    @property
    def key(self) -> tuple[Any, ...]:
        """A key, equal for models of the same record with the same parameters, bit for bit."""
        return Identity(self.system), tuple((k, v.dtype.str, v.shape, v.tobytes()) for k, v in self.params.items())

    def lanes(self, ids: Array) -> Model:
        """The model of some lanes of a batch; the model itself if it has no batch axes."""
        if not self.batch:
            return self
        axes = {p.letter: axes_of(p, self.params[p.letter]) for p in self.system.parameters}
        params = {k: v if v.ndim == axes[k] else v[ids] for k, v in self.params.items()}
        return Model(self.system, params, self.body_frame.of_lanes(ids))

    def of_body(self, frame: BodyFrame) -> Model:
        """The model, marked as belonging to a body with these axes and units."""
        moving = self.system.frame.value == "moving"
        shown = {k: algebra.KINDS[kind].shown(self.n).name for k, kind in self.system.space.components}
        along = [k for k, kind in shown.items() if moving and kind == "vector"]
        model = object.__new__(Model)  # a copy by `__reduce__` would check all parameters again
        model.__dict__.update(self.__dict__)
        model.body_frame = replace(frame, along=along)
        return model

    def _dimension(self) -> int:
        name, kinds = self.system.name, {p.letter: p.kind for p in self.system.parameters}
        sizes = {k: v.shape[-1] for k, v in self.params.items() if kinds[k] in ("vector", "symmetric")}
        if self.system.n is not None:
            if wrong := [letter for letter, size in sizes.items() if size != self.system.n]:
                shape = self.params[wrong[0]].shape
                raise InputError(f"{name}'s parameter {wrong[0]}: expected n = {self.system.n}, got {shape}.")
            return self.system.n
        if stated := [letter for letter, kind in kinds.items() if kind == "dimension"]:
            return whole_dimension(self.params[stated[0]], stated[0], name)
        if len(set(sizes.values())) != 1:
            listed = ", ".join(f"{k} has n = {v}" for k, v in sizes.items())
            raise InputError(f"All parameters of {name} live in the same R^n, but {listed}.")
        letter, n = next(iter(sizes.items()))
        if n < 3:
            raise InputError(
                f"{name} needs n >= 3, but {letter} has length {n}. "
                "A body in the plane has no gyroscopic motion; embed it with n = 3."
            )
        return n

    def __repr__(self) -> str:
        listed = ", ".join(f"{k}={text_of(v)}" for k, v in self.params.items())
        return f"{self.system.name}({listed})"

    def _repr_html_(self) -> str:
        return str(show("model", self))

    @property
    def state(self) -> Callable[..., State]:
        """A checked state, e.g. `top.state(m=(0.1, 0.2, 1.5), a=(0.6, 0, 0.8))`.

        Skew components are (..., n, n), or axial (..., 3) when n = 3; vectors (..., n); leading axes
        are batch axes; lists, and arrays of NumPy, xarray or JAX.  The keywords complete in a notebook.  Raises
        `InputError` on unknown or missing components, wrong shapes, matrices that are not skew, NaN or infinity,
        and states off the phase space.
        """

        def state(*unnamed: Any, **components: Any) -> State:
            require_names(unnamed, f"A state of {self.system.name}", self.system.space.letters)
            return self.checked(components)

        keyword = inspect.Parameter.KEYWORD_ONLY
        letters = [inspect.Parameter(letter, keyword) for letter in self.system.space.letters]
        state.__doc__ = type(self).state.__doc__
        state.__dict__["__signature__"] = inspect.Signature(letters)
        return state

    @property
    def _in_pairs(self) -> bool:
        """Whether lanes are bodies that act on each other."""
        record = self.system.perturbation
        return record is not None and record.pair is not None

    def checked(self, components: Mapping[str, Any]) -> State:
        """The state with these components, as `state` returns it."""
        space = self.system.space
        for letter in components:
            if letter not in space.letters:
                raise InputError(
                    f"A state of {self.system.name} has the components {', '.join(space.letters)} "
                    f"({self.system.frame.value} frame), got {shown(letter)}.{hint(letter, space.letters)}"
                )
        for letter, kind in space.components:
            if letter not in components:
                raise InputError(f"The state of {self.system.name} needs {letter} ({kind}), got none.")
        values = [components[letter] for letter in space.letters]
        if self._in_pairs:  # an axis of bodies, which are not lanes
            return self._of_values(*values)
        return by_lane(self._of_values, *values, single=lambda a: 2 if a.shape[-2:] == (self.n, self.n) else 1)

    def _of_values(self, *values: Any) -> State:
        """The state with these components, in order.  Raises `InputError`."""
        space, parts = self.system.space, {}
        vectors = [shape_of(v) for kind, v in zip(space.kinds, values, strict=True) if kind == "vector"]
        three_lanes = self.batch == (3,) or (3, 3) in vectors
        for (letter, kind), value in zip(space.components, values, strict=True):
            parts[letter] = component(letter, kind, value, self.n, self._in_pairs, three_lanes)
        self.require_sound(parts)
        return State(parts, dict(space.components), self.system)

    def again(self, state: State) -> State | None:
        """A single state that a model of this record has checked, checked again: its arrays may have been changed.

        None if it needs all checks.
        """
        if not state.is_of(self.system) or self._in_pairs:
            return None
        space, parts = self.system.space, {}
        for letter, kind in space.components:
            value, of_kind = state[letter], algebra.KINDS[kind]
            axial = of_kind.axes > 1
            if (axial and (kind, self.n) != ("skew", 3)) or value.shape != of_kind.shape(self.n):
                return None
            if value.dtype != np.float64 or not math.isfinite(sum(value.ravel().tolist())):
                return None
            parts[letter] = of_axial(algebra.axial(value)) if axial else value.copy()
        self.require_sound(parts)
        return State(parts, dict(space.components), self.system)

    def require_sound(self, parts: Mapping[str, Array], off: float = SKEW_TOLERANCE) -> None:
        """Raises `InputError` for components off the phase space by more than `off`, or refused by the record."""
        with np.errstate(all="ignore"):  # squares of such large values overflow, and are refused where they matter
            require_on_phase_space(self.system.space, parts, off)
            for letter, check in self.system.checks.state.items():
                check(parts[letter], letter)

    def call(self, function: Function | None, *state: Array, **extra: Any) -> Any:
        """A function of the record at a state, with this model's parameters."""
        return call(function, state, {**self.constants, **extra})

    def flow(self, *state: Array) -> tuple[Array, ...]:
        """The right-hand side of the equations of motion.  Raises `InputError` for bodies that act on each other."""
        if self._in_pairs:
            raise InputError(
                f"{self.system.name}: expected a single body, got bodies in pairs, whose rates depend on "
                "each other. method='dop853' integrates them."
            )
        return tuple(self.call(self.system.flow, *state))

    def step(self, *state: Array, eps: Array) -> tuple[Array, ...]:
        """One step of the system's map."""
        return tuple(self.call(self.map.step, *state, eps=eps))

    def largest_step(self, *state: Array, enough: float = np.inf) -> float:
        """The step beyond which the map may be singular on one of these orbits, or a shorter one beyond `enough`.

        Raises `InputError` if it is not finite: products of the state or the parameters overflow.
        """
        try:
            with np.errstate(all="ignore"):
                largest = float(np.min(self.call(self.map.largest_step, *state, enough=enough)))
        except np.linalg.LinAlgError:
            largest = np.nan
        if np.isnan(largest):
            raise InputError(
                f"{self.system.name}: expected a state and parameters whose products a double can hold, got larger or "
                "smaller ones. Use other units."
            )
        return largest

    @property
    def map(self) -> Map:
        """The system's map.  Raises `InputError` if none is known."""
        if self.system.map is None:
            raise InputError(
                f"No integrable discretization of {self.system.name} is known here. "
                "Use method='variational', or a system with a map (kreisel systems)."
            )
        return self.system.map


def _check(p: Parameter, value: Array) -> None:
    if p.check is not None:
        with np.errstate(all="ignore"):
            for entry in value if p.rank is not None and value.ndim > p.rank else (value,):
                p.check(entry, p.letter)


def _single(p: Parameter, value: Array) -> int:
    """The axes of a parameter in the user's form, without axes of lanes: a matrix may be given by its diagonal."""
    diagonals = p.kind == "symmetric" and value.ndim == 2 and value.shape[0] != value.shape[1]
    return 1 if diagonals else axes_of(p, value)
