"""The map that the laboratory investigates: a rational map x -> step(x) of R^d, of a record or user-defined."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from functools import partial
from typing import Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.errors import InputError, RunError, shown
from kreisel.lab import exact
from kreisel.lab.exact import Pole, float_random, fraction, independent, slopes
from kreisel.lab.modular import PRIMES, random_residues, residues, residues_at, without_poles
from kreisel.record.calling import call
from kreisel.record.contract import MOVING_SPACE, REST_SPACE, Map, System
from kreisel.record.model import Model

Function = Callable[..., Any]
STARTS = 50
CLOSE = 2.0**24 * float(np.finfo(float).eps)  # relative difference of equal sides in floats


@dataclass(frozen=True)
class Subject:
    """A map in coordinates, with rational constants.

    step(x, **constants)   x an object array (d,) of values of any field -> the new x
    names                  of the d coordinates
    start(draw)            a point, from draw(shape) of random values: where coordinates are not free
    tensor(x)              the brackets {x_i, x_j} (d, d) that it is claimed to preserve
    casimirs(x)            of that bracket, whose common values are its leaves
    lax(x, lam, **constants), conjugator(x, lam, **constants)   L and V with V_k L_(k+1) = L_k V_k
    integrals(x, **constants)   functions that it is claimed to conserve, beyond the spectrum of L
    involution(x, **constants)  R with R step R = step^-1
    energy(x, **constants)   the one that the map conserves
    flow(x, **constants)   the right-hand side that it discretizes with the constant eps as its step
    allowed(x, **constants)   whether the step exists at x in floats
    implicit               why the step cannot be made in exact arithmetic; "" where it can
    """

    name: str
    step: Callable[..., Array]
    names: tuple[str, ...]
    constants: Mapping[str, Any] = field(default_factory=dict)
    start: Callable[[Callable[[tuple[int, ...]], Array]], Array] | None = None
    tensor: Callable[[Array], Array] | None = None
    casimirs: Callable[[Array], Array] | None = None
    lax: Callable[..., Array] | None = None
    conjugator: Callable[..., Array] | None = None
    integrals: Callable[..., Array] | None = None
    involution: Callable[..., Array] | None = None
    flow: Callable[..., Array] | None = None
    energy: Callable[..., Any] | None = None
    allowed: Callable[..., bool] | None = None
    implicit: str = ""
    model: Model | None = None

    def __post_init__(self) -> None:
        if not all(isinstance(name, str) and name.isascii() and name for name in self.names):  # for python-flint
            raise InputError(f'names: expected names in ASCII letters, such as ("x", "phi"), got {shown(self.names)}.')
        if len(set(self.names)) != len(self.names):
            raise InputError(f"names: expected each coordinate once, got {shown(self.names)}.")

    @property
    def dim(self) -> int:
        """The number of coordinates."""
        return len(self.names)

    def modulo(self, p: int) -> dict[str, Any]:
        """The constants as residues modulo p."""
        return {k: residues(v, p)[()] for k, v in self.constants.items()}

    def point(self, draw: Callable[[tuple[int, ...]], Array]) -> Array:
        """A point of random coordinates."""
        return draw((self.dim,)) if self.start is None else self.start(draw)

    def require_rational(self, start: Any = None) -> None:
        """Raises `InputError` for a map that is not a rational function, and for a start that does not fit."""
        if self.implicit:
            raise InputError(
                f"{self.implicit}: its step is a root, not a rational function, and exact experiments need one. "
                "Choose a system with an explicit map."
            )
        if start is not None and np.shape(start) != (self.dim,):
            raise InputError(f"A start has {self.dim} values, {', '.join(self.names)}, got shape {np.shape(start)}.")

    def over(self, p: int) -> Callable[[Array], Array]:
        """The step over residues modulo p, or over values made of them.

        Raises `InputError` if it is not a rational function.
        """
        self.require_rational()
        constants = self.modulo(p)

        def step(x: Array) -> Array:
            try:
                new = np.asarray(self.step(x, **constants), dtype=object)
            except IndexError as error:
                raise InputError(
                    f"names: expected a name for each coordinate of the step of {self.name}, got "
                    f"{', '.join(self.names)}: {error}."
                ) from error
            except (TypeError, AttributeError) as error:
                raise InputError(
                    f"The step of {self.name} failed on residues modulo {p}: {error}. Exact experiments need a "
                    "rational function of the coordinates: + - * / and integer powers, no roots, no functions of "
                    "NumPy. For a float such as 1.4 write fractions.Fraction('1.4')."
                ) from error
            if new.shape != (self.dim,):
                raise InputError(f"The step of {self.name} must return {self.dim} values, got shape {new.shape}.")
            out = np.empty(self.dim, dtype=object)
            for i, v in enumerate(new):
                out[i] = v if isinstance(v, type(x[i])) else x[i] * 0 + v
            return out

        return step

    def stated(self, x: Array) -> Array:
        """The values of `integrals` at x of any field."""
        assert self.integrals is not None
        constants = {k: exact.fractions(v) for k, v in self.constants.items()}
        return np.ravel(np.asarray(self.integrals(x, **constants), dtype=object))

    @property
    def floats(self) -> dict[str, Any]:
        """The constants as floats."""
        return {k: np.vectorize(float, otypes=[float])(v)[()] for k, v in self.constants.items()}

    def some_orbits(self, p: int, seed: int, lanes: int, steps: int) -> Array:
        """`orbits` of a seed that meets no pole.  Raises `InputError` if all that are tried do."""
        return without_poles(self.name, lambda attempt: self.orbits(p, seed + attempt, lanes, steps))

    def orbits(self, p: int, seed: int, lanes: int, steps: int) -> Array:
        """Residues (steps + 1, d, lanes) along orbits from random points."""
        rng = np.random.default_rng([seed, p])
        x, step = self.point(random_residues(rng, p, lanes)), self.over(p)
        out = [stacked(x, lanes)]
        for _ in range(steps):
            x = step(x)
            out.append(stacked(x, lanes))
        return np.stack(out)


def stacked(x: Array, lanes: int) -> Array:
    """Numbers of residues as integers (d, lanes)."""
    return np.stack([np.broadcast_to(number.v, lanes) for number in x])


def float_start(subject: Subject, seed: int = 0, size: float = 1.0) -> Array:
    """A random point of about that size, where coordinates are free, at which the record allows the step."""
    rng = np.random.default_rng(seed)
    draw = float_random(rng)
    for _ in range(STARTS):
        x = np.asarray(subject.point(lambda shape: size * draw(shape)), dtype=np.float64)
        if subject.allowed is None or subject.allowed(x, **subject.floats):
            return x
    raise RunError(f"The step of {subject.name} is too long for {STARTS} random starts. Use a smaller eps.")


def differential(step: Function, x: Array) -> tuple[Array, Array]:
    """The image (d,) of x by a step and the Jacobian (d, d), for residues or floats."""
    new = step(independent(x))
    values, J = algebra.objects(getattr(v, "value", v) for v in new), slopes(new, len(x))
    return (values, J) if x.dtype == object else (values.astype(float), J.astype(float))


def difference(subject: Subject, sides: Function, seed: int, points: int = 8) -> float:
    """The relative difference of two arrays, sides(x, step, constants), at a random point in floats.

    Of a rational map it is 0 or infinite: exact, at random points modulo two primes.
    """
    if subject.implicit:
        constants = subject.floats
        left, right = sides(float_start(subject, seed), lambda x: subject.step(x, **constants), constants)
        return float(abs(left - right).max() / (1 + abs(right).max()))

    def equal(p: int, attempt: int) -> bool:
        x = subject.point(random_residues(np.random.default_rng([seed, attempt, p]), p, points))
        left, right = sides(x, subject.over(p), subject.modulo(p))
        return not residues_at(np.asarray(left - right, dtype=object), points, p).any()

    poles = Pole, ZeroDivisionError
    return 0.0 if all(without_poles(subject.name, partial(equal, p), poles) for p in PRIMES[:2]) else math.inf


def subject(
    candidate: Model | Subject | Callable[..., Any],
    *,
    eps: int | float | str | Fraction | None = None,
    names: tuple[str, ...] | None = None,
    **constants: Any,
) -> Subject:
    """A subject from a model with a map and its step `eps`, or from a function step(x, **constants) and the names.

    Floats count as exact rationals; prefer integers and fractions.
    """
    if isinstance(candidate, Subject):
        return candidate
    if isinstance(candidate, Model):
        return _of_model(candidate, fraction("1/3") if eps is None else fraction(eps))
    if not callable(candidate) or not names:
        raise InputError(
            "Give a model with a map, such as kr.LagrangeTop(p=(0, 0, 1)), or a function step(x) with the names of its "
            f"coordinates, names=('x', 'y'), got {shown(candidate)}."
        )
    return Subject(getattr(candidate, "__name__", "step"), candidate, tuple(names), constants)


def _of_model(model: Model, eps: Any) -> Subject:
    system, n = model.system, model.n
    if model.batch:
        raise InputError(f"{system.name}: expected parameters of one body, got a batch {model.batch}.")
    if eps == 0:
        raise InputError(f"eps: expected a step of {system.name} that is not 0, got 0: every map is the identity then.")
    space, mapped = system.space, model.map
    implicit = f"The map of {system.name} is implicit" if not mapped.rational or system.numbers != "any" else ""
    constants = {k: exact.fractions(v) for k, v in model.constants.items()}

    unpacked, packed = coordinates(space.kinds, n)

    def of_state(function: Any) -> Any:
        return None if function is None else lambda x, **values: call(function, unpacked(x), values)

    def of_lambda(function: Any) -> Any:
        return None if function is None else lambda x, lam, **values: of_state(function)(x, lam=lam, **values)

    def on_coordinates(function: Any) -> Any:
        return None if function is None else lambda x, **values: packed(tuple(of_state(function)(x, **values)))

    def tensor(x: Array) -> Array:
        turn = packed(algebra.restore(np.arange(1, len(x) + 1), space.kinds, n))  # a permutation with signs
        place, sign = abs(turn) - 1, np.sign(turn)
        return (model.call(space.tensor, *unpacked(x)) * (sign[:, None] * sign))[np.ix_(place, place)]

    # the integrals of the map that its Lax matrix does not give
    by_lax, keeps = system.commuting if mapped.lax is not None else (), mapped.conserves
    named = {
        **({"energy": system.energy} if mapped.lax is None and system.energy is not None else {}),
        **system.integrals,
    }
    extra = [f for name, f in named.items() if name not in by_lax and (keeps is None or name in keeps)]

    def integrals(x: Array, **values: Array) -> Array:
        return np.concatenate([np.ravel(call(f, unpacked(x), values)) for f in extra])

    def allowed(x: Array, eps: float, **values: Any) -> bool:  # constants as floats: some have roots
        with np.errstate(all="ignore"):
            return bool(eps < np.min(of_state(mapped.largest_step)(x, **values)))

    return Subject(
        name=system.name,
        step=on_coordinates(mapped.step),
        names=coordinate_names(space.components, n),
        constants={**constants, "eps": eps},
        start=lambda draw: packed(space.point(n, draw)),
        tensor=tensor,
        casimirs=None if space.casimirs is None else lambda x: np.ravel(model.call(space.casimirs, *unpacked(x))),
        lax=of_lambda(mapped.lax),
        conjugator=of_lambda(mapped.conjugator),
        integrals=integrals if extra else None,
        involution=on_coordinates(mapped.involution),
        flow=on_coordinates(system.flow),
        energy=of_state(system.energy),
        allowed=allowed if mapped.largest_step else None,
        implicit=implicit,
        model=model,
    )


def coordinates(names: Sequence[str], n: int) -> tuple[Function, Function]:
    """Of the kinds of that name: coordinates (d,), named as by `coordinate_names`, to components; and back."""
    kinds = [algebra.KINDS[kind] for kind in names]
    shown_kinds = [kind.shown(n).name for kind in kinds]

    def unpacked(x: Array) -> tuple[Array, ...]:
        return tuple(k.from_user(v, n) for k, v in zip(kinds, algebra.restore(x, shown_kinds, n), strict=True))

    def packed(state: tuple[Array, ...]) -> Array:
        return algebra.flatten([kind.for_user(z) for kind, z in zip(kinds, state, strict=True)], shown_kinds)

    return unpacked, packed


def coordinate_names(components: tuple[tuple[str, str], ...], n: int) -> tuple[str, ...]:
    """m1, m2, m3 for an axial vector, m12, m13, ... for n > 3, a1, a2, ... for vectors."""
    return tuple(name for letter, kind in components for name in algebra.KINDS[kind].names(letter, n))


# -- user-defined maps -----------------------------------------------------------------------------
# Functions of the state: step, flow, involution -> a state; lax, conjugator (with lam) -> (k, k); in coordinates also
# tensor -> (d, d) and start(draw) -> a state.  Each needs, after the state, the constants that it names.

OF_LAMBDA = ("lax", "conjugator")
BESIDE = ("flow", "involution", "tensor", *OF_LAMBDA, "start")  # optional data of a step
EXPECTED: dict[str, tuple[type[Exception], ...]] = {  # errors with which the instruments deal
    "step": (TypeError, AttributeError, ArithmeticError),
    **dict.fromkeys(OF_LAMBDA, (ArithmeticError,)),
}
POSITIONAL = (inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD)


def in_coordinates(step: Function, names: Sequence[str], eps: Any, options: Mapping[str, Any]) -> Subject:
    """A step(x) as a subject; `options` has constants and the functions of `BESIDE`.  Raises `InputError`."""
    if not isinstance(names, Sequence) or not all(isinstance(name, str) for name in names):
        raise InputError(f'names: expected names of the coordinates, such as ("x", "y"), got {shown(names)}.')
    functions, constants = _parted(step, options)
    taken = _parameters(step).get("eps")
    if taken is not None and "eps" not in constants:
        stated = None if taken.default is taken.empty else taken.default
        constants["eps"] = fraction(eps or stated or "1/3")
    shapes = {**dict.fromkeys(("flow", "involution", "start"), (len(names),)), "tensor": (len(names),) * 2}

    def of_x(name: str, function: Function) -> Function:
        wrapped = _wrapped(name, function, ["draw" if name == "start" else "x"], constants)

        def of_coordinates(x: Any, *lam: Any, **values: Any) -> Any:
            value = wrapped(x, *lam, **values)
            if name not in shapes:
                return value
            array = np.asarray(value, dtype=getattr(x, "dtype", object))
            if array.shape != shapes[name]:
                raise InputError(f"{name}: expected an array of the shape {shapes[name]}, got {array.shape}.")
            return array

        return of_coordinates

    entries: dict[str, Any] = {name: of_x(name, f) for name, f in functions.items()}
    return Subject(getattr(step, "__name__", "step"), names=tuple(names), constants=constants, **entries)


def on_group(step: Function, n: int, frame: str, eps: Any, options: Mapping[str, Any]) -> Subject:
    """A step(M, P) on e*(n) as a subject; `options` as in `in_coordinates`.  Raises `InputError`."""
    if frame not in ("moving", "rest"):
        raise InputError(f"frame must be 'moving' or 'rest', got {shown(frame)}.")
    functions, constants = _parted(step, options)
    if unwanted := {"tensor", "start"} & functions.keys():
        raise InputError(
            f"{', '.join(sorted(unwanted))}: expected none on e*({n}), whose bracket is known and whose coordinates "
            'are free. For another bracket give the coordinates, names=("M1", ...), and step(x).'
        )
    named = {k: np.asarray(v, dtype=object) for k, v in constants.items()}

    def of_state(name: str, function: Function) -> Any:
        wrapped = _wrapped(name, function, ["M", "P"], {**named, "eps": None})

        def on_state(*state: Array, eps: Any, lam: Any = None) -> Any:
            if name in OF_LAMBDA:
                return wrapped(*state, lam, eps=eps)
            new = wrapped(*state, eps=eps)
            if not isinstance(new, tuple | list) or [np.shape(v) for v in new] != [np.shape(v) for v in state]:
                sizes = ", ".join(map(str, map(np.shape, state)))
                raise InputError(f"{name}: expected M and P, of the shapes {sizes}, got {shown(new)}.")
            return tuple(new)

        return on_state

    parts = {name: of_state(name, f) for name, f in functions.items()}
    flow, name = parts.pop("flow", None), getattr(step, "__name__", "step")
    space, title = MOVING_SPACE if frame == "moving" else REST_SPACE, "a user-defined map"
    mapped = Map(**parts)
    system = System(name, title=title, equations="", source="", scaling="", space=space, flow=flow, map=mapped, n=n)
    return subject(system(), eps=eps)


def _parted(step: Function, options: Mapping[str, Any]) -> tuple[dict[str, Function], dict[str, Any]]:
    """The functions, the step among them, and the constants."""
    functions = {name: options[name] for name in BESIDE if options.get(name) is not None}
    for name, f in functions.items():
        if not callable(f):
            raise InputError(f"{name}: expected a function of the state, as step is, got {shown(f)}.")
    return {"step": step, **functions}, {k: v for k, v in options.items() if k not in BESIDE}


def _parameters(function: Function) -> Mapping[str, inspect.Parameter]:
    try:
        return inspect.signature(function).parameters
    except (TypeError, ValueError):  # built in: without a signature
        return {}


def _wrapped(name: str, function: Function, state: Sequence[str], constants: Mapping[str, Any]) -> Function:
    """The function of the state, and lam, with the constants that it needs by keyword, or other values of them.

    Raises `InputError` for a function that needs no state, and for what a user's code raises.
    """
    state = [*state, *(["lam"] if name in OF_LAMBDA else [])]
    parameters = [*_parameters(function).values()]
    places = [p for p in parameters if p.kind in POSITIONAL]
    many = any(p.kind is p.VAR_POSITIONAL for p in parameters)
    after = [*places[len(state) :], *(p for p in parameters if p.kind is p.KEYWORD_ONLY)]
    missing = [p.name for p in after if p.default is p.empty and p.name not in constants]
    if (parameters and len(places) < len(state) and not many) or (missing and missing[0] in ("P", "lam")):
        raise InputError(
            f"{name}: expected {name}({', '.join(state)}), the state as the step has it, and constants by keyword; "
            f"got {name}{inspect.signature(function)}."
        )
    if missing:
        raise InputError(
            f"{name}{inspect.signature(function)} needs {', '.join(missing)} by keyword: give their values. "
            f"The state is {', '.join(state)}."
        )
    every = any(p.kind is p.VAR_KEYWORD for p in parameters)
    takes = [*constants] if every else [p.name for p in after if p.name in constants]
    expected: tuple[type[Exception], ...] = (InputError, RunError, *EXPECTED.get(name, (Pole,)))

    def wrapped(*arguments: Any, **values: Any) -> Any:
        try:
            return function(*arguments, **{k: values.get(k, constants[k]) for k in takes})
        except expected:
            raise
        except Exception as error:  # whatever a user's code raises
            raise InputError(
                f"{name} failed: {type(error).__name__}: {error}. It gets the state as the step does, of any kind of "
                "number: + - * / and integer powers."
            ) from error

    return wrapped
