"""A record with its parameters filled in, states of it, and the checks of what a user gives.

Raises `InputError` with what was expected, what was given and the fix.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator, Mapping
from datetime import timedelta
from decimal import Decimal
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.algebra.reuse import Identity
from kreisel.display import show
from kreisel.errors import InputError, hint, shown
from kreisel.record.contract import (
    PARAMETER_AXES,
    SKEW_TOLERANCE,
    Function,
    Map,
    Parameter,
    PhaseSpace,
    System,
    call,
    check_dimension,
    component_axes,
    require_names,
)

if TYPE_CHECKING:
    import xarray as xr
    from numpy.typing import ArrayLike
    from scipy.spatial.transform import Rotation

    StateLike: TypeAlias = "State | Mapping[str, ArrayLike] | xr.Dataset"  # a state, its components, a row of a run
    OrientationLike: TypeAlias = ArrayLike | Rotation  # a rotation matrix, a quaternion (w, x, y, z), a Rotation


class State(Mapping[str, Array]):
    """Named components of a state, e.g. `x["m"]` or `x.m`; skew matrices are (..., n, n).

    `.axial` gives the same with axial vectors (..., 3) in place of skew 3 x 3 matrices.
    """

    def __init__(self, components: Mapping[str, Array], kinds: Mapping[str, str]):
        self._components, self._kinds = dict(components), dict(kinds)

    def __getitem__(self, letter: str) -> Array:
        if letter not in self._components:
            raise KeyError(f"this state has the components {', '.join(self._components)}, not {letter!r}")
        return self._components[letter]

    def __getattr__(self, letter: str) -> Array:
        if letter.startswith("_") or letter not in self._components:
            raise AttributeError(f"this state has the components {', '.join(self._components)}, not {letter!r}")
        return self._components[letter]

    def __iter__(self) -> Iterator[str]:
        return iter(self._components)

    def __len__(self) -> int:
        return len(self._components)

    def __dir__(self) -> list[str]:
        return [*super().__dir__(), *self._components]

    def __repr__(self) -> str:
        return "State(" + ", ".join(f"{k}={v.tolist()}" for k, v in self._components.items()) + ")"

    def _repr_html_(self) -> str:
        return str(show("state", self))

    @property
    def axial(self) -> State:
        """The same state with axial vectors (..., 3) for skew matrices when n = 3."""
        parts = {
            k: algebra.axial(v) if self._kinds[k] == "skew" and v.shape[-1] == 3 else v
            for k, v in self._components.items()
        }
        return State(parts, {**self._kinds, **{k: "vector" for k in parts}})


class Model:
    """A system with its parameters: what a run, a law or a user works with.

    Attributes: `system` (the record), `params` (arrays by letter), `n`.
    Raises `InputError` for unknown, missing or unusable parameters.
    """

    def __init__(self, system: System, params: Mapping[str, Any]):
        self.system = system
        known = [p.letter for p in system.parameters]
        for letter in params:
            if letter not in known:
                raise InputError(
                    f"{system.name} has {'the parameters ' if known else 'no parameters'}{', '.join(known)}, got "
                    f"{shown(letter)}.{hint(letter, known)}"
                )
        self.params: dict[str, Array] = {}
        for p in system.parameters:
            value = params.get(p.letter, p.default)
            if value is None:
                raise InputError(
                    f"{system.name} needs the parameter {p.letter} ({p.kind}): {p.meaning}, got none; "
                    f"give {p.letter}=..."
                )
            self.params[p.letter] = _parameter(p, value, system.name)
        self.n = self._dimension()
        for p in system.parameters:
            if p.check is not None:
                with np.errstate(all="ignore"):
                    p.check(self.params[p.letter], p.letter)
        batches = [
            v.shape[: v.ndim - axes_of(p, v)] for p, v in zip(system.parameters, self.params.values(), strict=True)
        ]
        try:
            self.batch = np.broadcast_shapes(*batches)
        except ValueError:
            given = ", ".join(f"{k} {b}" for k, b in zip(self.params, batches, strict=True))
            raise InputError(f"The batch axes of the parameters of {system.name} do not fit: {given}.") from None
        spread = {
            k: np.broadcast_to(v, self.batch + v.shape[len(b) :])
            for (k, v), b in zip(self.params.items(), batches, strict=True)
        }
        self.constants: dict[str, Array] = dict(spread)
        if system.derive is not None:
            self.constants.update(self._derived(spread))
        self.axes = {k: v.ndim - len(self.batch) for k, v in self.constants.items()}
        for p in system.parameters:
            if p.kind == "array":  # the same in every lane
                self.constants[p.letter] = self.params[p.letter]
                self.axes[p.letter] = self.params[p.letter].ndim

    def _derived(self, spread: Mapping[str, Array]) -> dict[str, Array]:
        """Further constants, computed once.  Raises `InputError` where they leave the range of doubles."""
        with np.errstate(all="ignore"):
            found = dict(call(self.system.derive, (), spread))
        lost = [k for k, v in found.items() if np.asarray(v).dtype.kind == "f" and not np.isfinite(v).all()]
        if lost and not self.batch:  # of an ensemble the lanes fail that do
            raise InputError(
                f"{self.system.name}: expected parameters whose products and ratios a double can hold, got some with "
                f"which {', '.join(lost)} is not finite. Use other units."
            )
        return found

    def __getattr__(self, name: str) -> Any:
        system = None if name.startswith("_") else self.__dict__.get("system")
        if system is None:
            raise AttributeError(name)
        if name in self.params:
            raise AttributeError(f"the parameter {name} of {system.name} is .params[{name!r}]")
        raise AttributeError(
            f"{system.name} has no attribute {name!r}.{hint(name, dir(self))} Functions take it as their first "
            "argument: kr.simulate(system, x0, dt=..., steps=...)."
        )

    @property
    def key(self) -> tuple[Any, ...]:
        """The same for models of the same record with the same parameters, bit for bit."""
        return Identity(self.system), tuple((k, v.dtype.str, v.shape, v.tobytes()) for k, v in self.params.items())

    def lanes(self, ids: Array) -> Model:
        """The model of some lanes of a batch; itself where it has no batch axes."""
        if not self.batch:
            return self
        own = {p.letter: axes_of(p, self.params[p.letter]) for p in self.system.parameters}
        return Model(self.system, {k: v if v.ndim == own[k] else v[ids] for k, v in self.params.items()})

    def _dimension(self) -> int:
        if self.system.n is not None:
            for p in self.system.parameters:
                shape = self.params[p.letter].shape
                if p.kind in ("vector", "symmetric") and shape[-1] != self.system.n:
                    raise InputError(
                        f"{self.system.name}'s parameter {p.letter}: expected n = {self.system.n}, got {shape}."
                    )
            return self.system.n
        stated = [p.letter for p in self.system.parameters if p.kind == "dimension"]
        if stated:
            return _whole_dimension(self.params[stated[0]], stated[0], self.system.name)
        sizes = {
            p.letter: self.params[p.letter].shape[-1]
            for p in self.system.parameters
            if p.kind in ("vector", "symmetric")
        }
        if len(set(sizes.values())) != 1:
            given = ", ".join(f"{k} has n = {v}" for k, v in sizes.items())
            raise InputError(f"All parameters of {self.system.name} live in the same R^n, but {given}.")
        letter, n = next(iter(sizes.items()))
        if n < 3:
            raise InputError(
                f"{self.system.name} needs n >= 3, but {letter} has length {n}. "
                "A body in the plane has no gyroscopic motion; embed it with n = 3."
            )
        return n

    def __repr__(self) -> str:
        given = ", ".join(f"{k}={v.tolist()}" for k, v in self.params.items())
        return f"{self.system.name}({given})"

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
            return self._state(components)

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

    def _state(self, components: Mapping[str, Any]) -> State:
        space = self.system.space
        for letter in components:
            if letter not in space.letters:
                raise InputError(
                    f"A state of {self.system.name} has the components {', '.join(space.letters)} "
                    f"({self.system.frame.value} frame), got {shown(letter)}.{hint(letter, space.letters)}"
                )
        parts = {}
        for letter, kind in space.components:
            if letter not in components:
                raise InputError(f"The state of {self.system.name} needs {letter} ({kind}), got none.")
            parts[letter] = _component(letter, kind, components[letter], self.n, self._in_pairs)
        with np.errstate(all="ignore"):  # squares of what is that large overflow, and are refused where they matter
            _on_phase_space(space, parts)
            if self.system.check_state is not None:
                self.system.check_state(*parts.values())
        return State(parts, dict(space.components))

    def call(self, function: Function | None, *state: Array, **extra: Any) -> Any:
        """A function of the record at a state, with this model's parameters."""
        return call(function, state, {**self.constants, **extra})

    def flow(self, *state: Array) -> tuple[Array, ...]:
        """The right-hand side of the equations of motion.  Raises `InputError` for bodies that act on each other."""
        if self._in_pairs:
            raise InputError(
                f"{self.system.name}: expected a body that moves by itself, got bodies in pairs, whose rates depend on "
                "each other. method='dop853' integrates them."
            )
        return tuple(self.call(self.system.flow, *state))

    def step(self, *state: Array, eps: Array) -> tuple[Array, ...]:
        """One step of the system's map."""
        return tuple(self.call(self.map.step, *state, eps=eps))

    def largest_step(self, *state: Array, enough: float = np.inf) -> float:
        """The step beyond which the map may be singular on one of these orbits, or a shorter one beyond `enough`.

        Raises `InputError` where that is no number: products of the state or the parameters overflow.
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
        """The system's map.  Raises `InputError` where none is known."""
        if self.system.map is None:
            raise InputError(
                f"No integrable discretization of {self.system.name} is known here. "
                "Use method='variational', or a system with a map (kreisel systems)."
            )
        return self.system.map


def _whole_dimension(value: Array, letter: str, system: str) -> int:
    found = np.unique(value)
    n = int(found[0]) if len(found) == 1 else 0
    if n < 3 or n != found[0]:
        raise InputError(
            f"{system}'s parameter {letter} is the dimension, a whole number from 3 on, got {value.tolist()}."
        )
    check_dimension(n, f"{system}'s parameter {letter}")
    return n


def _array(value: Any, name: str) -> Array:
    try:
        array = np.asarray(value)
    except (ValueError, TypeError):
        raise InputError(f"{name} must be an array of numbers, got a ragged list: {shown(value)}.") from None
    if array.dtype == object and all(isinstance(v, int | float | Decimal) for v in array.flat):  # some beyond 64 bits
        try:
            array = array.astype(np.float64)
        except OverflowError:
            raise InputError(f"{name} must be numbers that a double can hold, got {shown(value)}.") from None
    if array.dtype == object and all(
        hasattr(v, "__mul__") and not isinstance(v, str | list | timedelta) for v in array.flat
    ):
        return array
    if array.dtype.kind not in "iuf":
        hint = (
            " Units are left out here: `kreisel systems NAME` says which they are." if array.dtype.kind == "U" else ""
        )
        raise InputError(f"{name} must be real numbers, got {shown(value)}.{hint}")
    array = array.astype(np.promote_types(array.dtype, np.float64))
    if not np.isfinite(array).all():
        raise InputError(f"{name} must be finite, got {shown(value)}. Look for NaN or infinity in the input.")
    return array


def axes_of(p: Parameter, value: Array) -> int:
    """The axes of a parameter, without those of lanes."""
    return value.ndim if p.kind == "array" else PARAMETER_AXES[p.kind]


def _parameter(p: Parameter, value: Any, system: str) -> Array:
    name = f"{system}'s parameter {p.letter}"
    array = _array(value, name)
    if not array.size:
        raise InputError(f"{name}: expected numbers, got none. Check how a batch was made.")
    axes = axes_of(p, array)
    if p.kind in ("vector", "symmetric") and array.ndim:
        check_dimension(array.shape[-1], name)
    if p.kind == "symmetric" and array.ndim == 1:
        array = array[..., None] * np.eye(array.shape[-1], dtype=np.int8)
    if array.ndim < axes or array.ndim > axes + 1:
        shapes = {
            "scalar": "a number",
            "dimension": "a whole number",
            "vector": "n numbers",
            "symmetric": "an n x n matrix or its diagonal",
        }
        raise InputError(f"{name} must be {shapes[p.kind]} (a batch axis may stand in front), got shape {array.shape}.")
    if p.kind == "symmetric":
        _check_symmetric(array, name)
    return array


def _check_symmetric(array: Array, name: str) -> None:
    if array.shape[-1] != array.shape[-2]:
        raise InputError(f"{name} must be square, got shape {array.shape}.")
    worst = algebra.magnitude(array - array.mT)
    if worst > SKEW_TOLERANCE * algebra.magnitude(array):
        raise InputError(f"{name} must be symmetric; {name.split()[-1]} - {name.split()[-1]}^T is up to {worst:.3g}.")


def _component(letter: str, kind: str, value: Any, n: int, of_bodies: bool) -> Array:
    """A component of a state; `of_bodies`: with an axis of bodies, so that 3 x 3 numbers are three axial vectors."""
    name = f"state component {letter}"
    array = _array(value, name)
    if of_bodies and kind == "skew" and array.shape in ((3,), (3, 3)):
        return algebra.hat(np.atleast_2d(array))
    if kind == "symmetric":
        if array.ndim < 2 or array.shape[-2:] != (n, n):
            raise InputError(f"{name} must be a symmetric matrix (..., {n}, {n}), got shape {array.shape}.")
        _check_symmetric(array, name)
        return array / 2 + array.mT / 2
    if kind != "skew":
        count, expected = (n, f"n = {n}") if kind == "vector" else (int(kind[2:]), kind[2:])
        if array.ndim < 1 or array.shape[-1] != count:
            raise InputError(f"{name} must be {expected} numbers (..., {count}), got shape {array.shape}.")
        return array
    if array.ndim >= 2 and array.shape[-2:] == (n, n):
        off = algebra.magnitude(array + array.mT)
        if off <= SKEW_TOLERANCE * max(algebra.magnitude(array), 1):
            return array / 2 - array.mT / 2  # halved first: the difference may overflow
        if n != 3 or array.ndim == 2:
            raise InputError(
                f"{name} must be skew ({letter}^T = -{letter}); {letter} + {letter}^T is up to {off:.3g}. "
                f"Usual cause: a full matrix where its skew part ({letter} - {letter}^T)/2 was meant."
            )
    if n == 3 and array.ndim >= 1 and array.shape[-1] == 3:
        X = algebra.hat(array)
        return X / 2 - X.mT / 2  # the same signs of zeros as for a matrix
    axial = ", or an axial vector (..., 3)" if n == 3 else ""
    raise InputError(
        f"{name} must be a skew matrix (..., {n}, {n}){axial}, with n = {n} as in the parameters, "
        f"got shape {array.shape}."
    )


def _on_phase_space(space: PhaseSpace, parts: Mapping[str, Array]) -> None:
    batches = [v.shape[: v.ndim - component_axes(k)] for v, k in zip(parts.values(), space.kinds, strict=True)]
    try:
        np.broadcast_shapes(*batches)
    except ValueError:
        raise InputError(f"The batch axes of the components do not fit: {batches}.") from None
    for formula, constraint in space.constraints.items():
        off = algebra.magnitude(constraint(*parts.values()))
        if off > SKEW_TOLERANCE:
            raise InputError(
                f"The state must lie on {space.name}: {formula} = 0, but it is {off:.3g}. "
                "Normalise x, then take the part of q orthogonal to x."
            )
