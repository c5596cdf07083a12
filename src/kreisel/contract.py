"""What a system states about itself: the records, and a record with its parameters filled in.

A `System` is data: pure functions of named state components, and claims about them.  Laws
(`kreisel.lab.laws`) test the claims; engines compile the functions; nothing else is known of a system.
Every function takes the components of the state in order, then by keyword the parameters it names and,
where it depends on them, `eps` (the step) and `lam` (the spectral parameter lambda).
"""

from __future__ import annotations

import enum
import inspect
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.errors import InputError, nearest

Function = Callable[..., Any]
COMPONENT_AXES = {"skew": 2, "vector": 1, "matrix": 2, "quaternion": 1}
PARAMETER_AXES = {"scalar": 0, "vector": 1, "symmetric": 2}
SKEW_TOLERANCE = 1e-12


class Frame(enum.Enum):
    """Where the state is expressed, and how the orientation g (body to space) is carried along."""

    REST = "rest"  # minus bracket; a = g A with A fixed in the body; g_(k+1) = cay(X) g_k
    MOVING = "moving"  # plus bracket; P = g^T p with p fixed in space; g_(k+1) = g_k cay(X)


@dataclass(frozen=True)
class PhaseSpace:
    """A Poisson manifold in coordinates: components, Poisson tensor, Casimirs.

    `tensor(*state)` is the matrix of brackets of the independent coordinates (skew matrices count by
    their entries i < j); the field of H is F' = {H, F}.  `constraints` names functions that vanish on
    the phase space when it is a submanifold of its coordinate space.
    """

    name: str
    components: tuple[tuple[str, str], ...]
    tensor: Function
    casimirs: Function
    sign: int
    constraints: Mapping[str, Function] = field(default_factory=dict)

    @property
    def letters(self) -> tuple[str, ...]:
        """The letters of the components, in order."""
        return tuple(letter for letter, _ in self.components)

    @property
    def kinds(self) -> tuple[str, ...]:
        """The kinds of the components: "skew" or "vector"."""
        return tuple(kind for _, kind in self.components)


def dual_euclidean(skew: str, vector: str, sign: int) -> PhaseSpace:
    """e*(n) with the plus (moving frame) or minus (rest frame) Lie-Poisson bracket."""
    return PhaseSpace(
        name="e*(n)",
        components=((skew, "skew"), (vector, "vector")),
        tensor=lambda M, P: sign * algebra.lie_poisson(M, P),
        casimirs=algebra.casimirs,
        sign=sign,
    )


REST_SPACE = dual_euclidean("m", "a", -1)
MOVING_SPACE = dual_euclidean("M", "P", +1)
SPHERE_SPACE = PhaseSpace(
    name="T*S^(n-1)",
    components=(("x", "vector"), ("q", "vector")),
    tensor=algebra.sphere_poisson,
    casimirs=lambda x, q: algebra.stack([algebra.dot(x, x), algebra.dot(x, q)]),
    sign=+1,
    constraints={"|x|^2 - 1": lambda x, q: algebra.dot(x, x) - 1, "<x, q>": lambda x, q: algebra.dot(x, q)},
)


@dataclass(frozen=True)
class Parameter:
    """A parameter: its letter, kind ("scalar", "vector" or "symmetric"), meaning and valid range.

    A symmetric matrix may be given by its diagonal.  `check(value, name)` raises `InputError`.
    """

    letter: str
    kind: str
    meaning: str
    check: Function | None = None
    default: Any = None
    exact_diagonal: bool = False  # in exact numbers the matrix must be diagonal
    distinct: bool = False  # the entries must be distinct


@dataclass(frozen=True)
class Map:
    """A discretization of a flow, with all that is known of it.  Each entry is a claim that a law tests.

    step, inverse, adjoint   (*state, eps) -> state; the adjoint is the inverse of the step with -eps
    involution               R with R step R = inverse, anti-Poisson
    to_symmetric             chi with chi step chi^-1 of order 2 and symmetric; from_symmetric is chi^-1
    generator                X(*old, *new, eps) with the turn of the body w = cay(X)
    lagrangian               (q0, q1, carried, eps): q = g in SO(n) and the carried vector A (rest frame) or
                             p (moving frame), or q = x on the sphere; only its differences matter
    lax                      L(*state, lam, eps);  conjugator V(*state, lam, eps) with V L_(k+1) = L_k V
    largest_step             (*state) -> the |eps| beyond which the map may be singular on the orbit
    """

    step: Function
    inverse: Function
    adjoint: Function
    involution: Function
    to_symmetric: Function
    from_symmetric: Function
    generator: Function
    lagrangian: Function
    lax: Function | None
    conjugator: Function | None
    largest_step: Function | None = None
    second_order: Function | None = None
    order: int = 1
    source: str = ""


@dataclass(frozen=True)
class Relation:
    """The same motion in another system: (state, params, g) -> (state, params) of `target`.

    A law compares the flows and, where `map` names "step" or "adjoint" of the target, the maps; in floats
    only where `exact` is False.
    """

    target: str
    carry: Function
    map: str | None = None
    meaning: str = ""
    exact: bool = True


@dataclass(frozen=True)
class System:
    """The record of a system.  Call it with parameters to get a `Model`: `LagrangeTop(p=(0, 0, 1))`.

    energy(*state, eps=0)    at eps = 0 the Hamiltonian H, with F' = {H, F}; else the energy of the map
    integrals                name -> function; those that name `eps` are deformed by the map
    commuting                the integrals that are in involution with each other and the energy
    lax(*state, lam)         the pair (L, U) with L' = [L, U]
    velocity(*state)         the angular velocity: g' = omega g (rest frame), g' = g Omega (moving frame)
    derive(params)           further constants computed once from the parameters
    """

    name: str
    title: str
    equations: str
    source: str
    frame: Frame
    space: PhaseSpace
    parameters: tuple[Parameter, ...]
    flow: Function
    energy: Function
    velocity: Function
    scaling: str
    integrals: Mapping[str, Function] = field(default_factory=dict)
    commuting: tuple[str, ...] = ()
    lax: Function | None = None
    map: Map | None = None
    relations: tuple[Relation, ...] = ()
    derive: Function | None = None
    notes: str = ""

    def __call__(self, **params: Any) -> Model:
        """The system with these parameters."""
        return Model(self, params)

    def __repr__(self) -> str:
        return f"<kreisel system {self.name!r}: {self.title}>"

    def __post_init__(self) -> None:
        letters = "\n".join(f"    {p.letter} ({p.kind}): {p.meaning}" for p in self.parameters)
        told = f"{self.title}: {self.equations}  [{self.source}]\n\nParameters:\n{letters}\n\n{self.scaling}"
        object.__setattr__(self, "__doc__", told)

    @property
    def __signature__(self) -> inspect.Signature:
        keyword = inspect.Parameter.KEYWORD_ONLY
        return inspect.Signature(
            [
                inspect.Parameter(
                    p.letter, keyword, default=inspect.Parameter.empty if p.default is None else p.default
                )
                for p in self.parameters
            ]
        )


@cache
def keywords(function: Function) -> frozenset[str]:
    """The keyword-only arguments that a function names."""
    signature = inspect.signature(function)
    return frozenset(p.name for p in signature.parameters.values() if p.kind is p.KEYWORD_ONLY)


def call(function: Function, state: tuple[Array, ...], available: Mapping[str, Any]) -> Any:
    """`function(*state, ...)` with just the keywords it names."""
    names = keywords(function)
    return function(*state, **{k: v for k, v in available.items() if k in names})


class State(Mapping[str, Array]):
    """Named components of a state, e.g. `x["m"]` or `x.m`; skew matrices are (..., n, n).

    `.axial` gives the same with axial vectors (..., 3) in place of skew 3 x 3 matrices.
    """

    def __init__(self, components: Mapping[str, Array], kinds: Mapping[str, str]):
        self._components, self._kinds = dict(components), dict(kinds)

    def __getitem__(self, letter: str) -> Array:
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
                    f"{system.name} has the parameters {', '.join(known)}; {letter!r} came.{nearest(letter, known)}"
                )
        self.params: dict[str, Array] = {}
        for p in system.parameters:
            value = params.get(p.letter, p.default)
            if value is None:
                raise InputError(
                    f"{system.name} needs the parameter {p.letter} ({p.kind}): {p.meaning}. None came; "
                    f"give {p.letter}=..."
                )
            self.params[p.letter] = _parameter(p, value, system.name)
        self.n = self._dimension()
        for p in system.parameters:
            if p.check is not None:
                p.check(self.params[p.letter], p.letter)
        batches = [
            v.shape[: v.ndim - PARAMETER_AXES[p.kind]]
            for p, v in zip(system.parameters, self.params.values(), strict=True)
        ]
        self.batch = np.broadcast_shapes(*batches)
        spread = {
            k: np.broadcast_to(v, self.batch + v.shape[len(b) :])
            for (k, v), b in zip(self.params.items(), batches, strict=True)
        }
        self.constants: dict[str, Array] = dict(spread)
        if system.derive is not None:
            self.constants.update(call(system.derive, (), spread))
        self.axes = {k: v.ndim - len(self.batch) for k, v in self.constants.items()}

    def _dimension(self) -> int:
        sizes = {p.letter: self.params[p.letter].shape[-1] for p in self.system.parameters if p.kind != "scalar"}
        if len(set(sizes.values())) != 1:
            told = ", ".join(f"{k} has n = {v}" for k, v in sizes.items())
            raise InputError(f"All parameters of {self.system.name} live in the same R^n, but {told}.")
        letter, n = next(iter(sizes.items()))
        if n < 3:
            raise InputError(
                f"{self.system.name} needs n >= 3, but {letter} has length {n}. "
                "A body in the plane has no gyroscopic motion; embed it with n = 3."
            )
        return n

    def __repr__(self) -> str:
        told = ", ".join(f"{k}={v.tolist()}" for k, v in self.params.items())
        return f"{self.system.name}({told})"

    def state(self, **components: Any) -> State:
        """A checked state, e.g. `top.state(m=(0.1, 0.2, 1.5), a=(0.6, 0, 0.8))`.

        Skew components are (..., n, n), or axial (..., 3) when n = 3; vectors (..., n); leading axes
        are batch axes.  Raises `InputError` on unknown or missing components, wrong shapes, matrices
        that are not skew, NaN or infinity, and states off the phase space.
        """
        space = self.system.space
        for letter in components:
            if letter not in space.letters:
                raise InputError(
                    f"A state of {self.system.name} has the components {', '.join(space.letters)} "
                    f"({self.system.frame.value} frame); {letter!r} came.{nearest(letter, space.letters)}"
                )
        parts = {}
        for letter, kind in space.components:
            if letter not in components:
                raise InputError(f"The state of {self.system.name} needs {letter} ({kind}); none came.")
            parts[letter] = _component(letter, kind, components[letter], self.n)
        _on_phase_space(space, parts)
        return State(parts, dict(space.components))

    def call(self, function: Function, *state: Array, **extra: Any) -> Any:
        """A function of the record at a state, with this model's parameters."""
        return call(function, state, {**self.constants, **extra})

    def flow(self, *state: Array) -> tuple[Array, ...]:
        """The right-hand side of the equations of motion."""
        return tuple(self.call(self.system.flow, *state))

    def step(self, *state: Array, eps: Array) -> tuple[Array, ...]:
        """One step of the system's map."""
        return tuple(self.call(self.map.step, *state, eps=eps))

    @property
    def map(self) -> Map:
        """The system's map.  Raises `InputError` where none is known."""
        if self.system.map is None:
            raise InputError(
                f"No integrable discretization of {self.system.name} is known here. "
                "Use method='dop853', or a system with a map (kreisel systems)."
            )
        return self.system.map


def _array(value: Any, name: str) -> Array:
    try:
        array = np.asarray(value)
    except ValueError:
        raise InputError(f"{name} must be an array of numbers; a ragged list came: {value!r}.") from None
    if array.dtype == object and all(hasattr(v, "__mul__") and not isinstance(v, str | list) for v in array.flat):
        return array
    if array.dtype.kind not in "iuf":
        raise InputError(f"{name} must be real numbers; {value!r} came.")
    array = array.astype(np.promote_types(array.dtype, np.float64))
    if not np.isfinite(array).all():
        raise InputError(f"{name} must be finite; {value!r} came. Look for NaN or infinity in the input.")
    return array


def _parameter(p: Parameter, value: Any, system: str) -> Array:
    name = f"{system}'s parameter {p.letter}"
    array = _array(value, name)
    axes = PARAMETER_AXES[p.kind]
    if p.kind == "symmetric" and array.ndim == 1:
        array = array[..., None] * np.eye(array.shape[-1], dtype=np.int8)
    if array.ndim < axes or array.ndim > axes + 1:
        shapes = {"scalar": "a number", "vector": "n numbers", "symmetric": "an n x n matrix or its diagonal"}
        raise InputError(
            f"{name} must be {shapes[p.kind]} (a batch axis may stand in front); shape {array.shape} came."
        )
    if p.kind == "symmetric":
        _check_symmetric(array, name)
    return array


def _check_symmetric(array: Array, name: str) -> None:
    if array.shape[-1] != array.shape[-2]:
        raise InputError(f"{name} must be square; shape {array.shape} came.")
    worst = algebra.magnitude(array - array.mT)
    if worst > SKEW_TOLERANCE * algebra.magnitude(array):
        raise InputError(f"{name} must be symmetric; {name[-1]} - {name[-1]}^T is up to {worst:.3g}.")


def _component(letter: str, kind: str, value: Any, n: int) -> Array:
    name = f"state component {letter}"
    array = _array(value, name)
    if kind == "vector":
        if array.ndim < 1 or array.shape[-1] != n:
            raise InputError(f"{name} must be n = {n} numbers (..., {n}); shape {array.shape} came.")
        return array
    if array.ndim >= 2 and array.shape[-2:] == (n, n):
        off = algebra.magnitude(array + array.mT)
        if off <= SKEW_TOLERANCE * max(algebra.magnitude(array), 1):
            return (array - array.mT) / 2
        if n != 3 or array.ndim == 2:
            raise InputError(
                f"{name} must be skew ({letter}^T = -{letter}); {letter} + {letter}^T is up to {off:.3g}. "
                f"Usual cause: a full matrix where its skew part ({letter} - {letter}^T)/2 was meant."
            )
    if n == 3 and array.ndim >= 1 and array.shape[-1] == 3:
        return algebra.hat(array)
    axial = ", or an axial vector (..., 3)" if n == 3 else ""
    raise InputError(
        f"{name} must be a skew matrix (..., {n}, {n}){axial}, with n = {n} as in the parameters; "
        f"shape {array.shape} came."
    )


def _on_phase_space(space: PhaseSpace, parts: Mapping[str, Array]) -> None:
    batches = [v.shape[: v.ndim - COMPONENT_AXES[k]] for v, k in zip(parts.values(), space.kinds, strict=True)]
    try:
        np.broadcast_shapes(*batches)
    except ValueError:
        raise InputError(f"The batch axes of the components do not fit: {batches}.") from None
    for told, constraint in space.constraints.items():
        off = algebra.magnitude(constraint(*parts.values()))
        if off > SKEW_TOLERANCE:
            raise InputError(
                f"The state must lie on {space.name}: {told} = 0, but it is {off:.3g}. "
                "Normalise x, then take the part of q orthogonal to x."
            )
