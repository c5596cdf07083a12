"""What the laboratory investigates: a rational map x -> step(x) of R^d, of a record or of your own."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.errors import InputError, shown
from kreisel.lab import exact
from kreisel.lab.fields import Pole, fraction, random_residues, residues
from kreisel.record.calling import call
from kreisel.record.contract import Map, System
from kreisel.record.model import Model

ATTEMPTS = 5


@dataclass(frozen=True)
class Subject:
    """A map in coordinates, with rational constants.

    step(x, **constants)   x an object array (d,) of numbers of any field -> the new x
    names                  of the d coordinates
    start(draw)            a point, from draw(shape) of random numbers: where coordinates are not free
    tensor(x)              the brackets {x_i, x_j} (d, d) that it is claimed to preserve
    casimirs(x)            of that bracket, whose common values are its leaves
    lax(x, lam, **constants), conjugator(x, lam, **constants)   L and V with V_k L_(k+1) = L_k V_k
    integrals(x, **constants)   functions that it is claimed to conserve, beyond the spectrum of L
    involution(x, **constants)  R with R step R = step^-1
    energy(x, **constants)   the one that the map conserves
    flow(x, **constants)   the right-hand side that it discretizes with the constant eps as its step
    allowed(x, **constants)   whether the step exists at x in floats
    implicit               why the step cannot be made in exact numbers; "" where it can
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

    @property
    def dim(self) -> int:
        """The number of coordinates."""
        return len(self.names)

    def known(self, p: int) -> dict[str, Any]:
        """The constants as residues modulo p."""
        return {k: residues(v, p)[()] for k, v in self.constants.items()}

    def point(self, draw: Callable[[tuple[int, ...]], Array]) -> Array:
        """A point made of random numbers."""
        return draw((self.dim,)) if self.start is None else self.start(draw)

    def over(self, p: int) -> Callable[[Array], Array]:
        """The step over residues modulo p, or over numbers made of them.

        Raises `InputError` where it is not a rational function.
        """
        if self.implicit:
            raise InputError(
                f"{self.implicit}: its step is a root, not a rational function, and exact experiments need one. "
                "Choose a system with an explicit map."
            )
        known = self.known(p)

        def step(x: Array) -> Array:
            try:
                new = np.asarray(self.step(x, **known), dtype=object)
            except (TypeError, AttributeError) as error:
                raise InputError(
                    f"The step of {self.name} failed on residues modulo {p}: {error}. Exact experiments need a "
                    "rational function of the coordinates: + - * / and whole powers, no roots, no functions of NumPy."
                ) from error
            if new.shape != (self.dim,):
                raise InputError(f"The step of {self.name} must return {self.dim} numbers, got shape {new.shape}.")
            out = np.empty(self.dim, dtype=object)
            for i, v in enumerate(new):
                out[i] = v if isinstance(v, type(x[i])) else x[i] * 0 + v
            return out

        return step

    @property
    def floats(self) -> dict[str, Any]:
        """The constants as floats."""
        return {k: np.vectorize(float, otypes=[float])(v)[()] for k, v in self.constants.items()}

    def some_orbits(self, p: int, seed: int, lanes: int, steps: int) -> Array:
        """`orbits` of a seed that meets no pole.  Raises `InputError` where all that are tried do."""
        for attempt in range(ATTEMPTS):
            try:
                return self.orbits(p, seed + attempt, lanes, steps)
            except Pole as error:
                trouble = error
        raise InputError(f"{self.name} divides by 0 from {ATTEMPTS} random starts ({trouble}).")

    def orbits(self, p: int, seed: int, lanes: int, steps: int) -> Array:
        """Residues (steps + 1, d, lanes) along orbits from random points."""
        rng = np.random.default_rng([seed, p])
        x, step = self.point(random_residues(rng, p, lanes)), self.over(p)
        out = [_stacked(x, lanes)]
        for _ in range(steps):
            x = step(x)
            out.append(_stacked(x, lanes))
        return np.stack(out)


def _stacked(x: Array, lanes: int) -> Array:
    return np.stack([np.broadcast_to(number.v, lanes) for number in x])


def subject(
    what: Model | Subject | Callable[..., Any],
    *,
    eps: int | float | str | Fraction | None = None,
    names: tuple[str, ...] | None = None,
    **constants: Any,
) -> Subject:
    """A subject from a model with a map and its step `eps`, or from a function step(x, **constants) and the names.

    Floats count as the rational numbers that they are; prefer whole numbers and fractions.
    """
    if isinstance(what, Subject):
        return what
    if isinstance(what, Model):
        return _of_model(what, fraction("1/3") if eps is None else fraction(eps))
    if not callable(what) or not names:
        raise InputError(
            "Give a model with a map, such as kr.LagrangeTop(p=(0, 0, 1)), or a function step(x) with the names of its "
            f"coordinates, names=('x', 'y'), got {shown(what)}."
        )
    return Subject(getattr(what, "__name__", "step"), what, tuple(names), constants)


def _of_model(model: Model, eps: Any) -> Subject:
    system, n = model.system, model.n
    space, mapped = system.space, model.map
    implicit = f"The map of {system.name} is implicit" if not mapped.rational or system.numbers != "any" else ""
    constants = {k: _fractions(v) for k, v in model.constants.items()}

    def unpacked(x: Array) -> tuple[Array, ...]:
        return algebra.restore(_axial(x, space.kinds, n), space.kinds, n)

    def packed(state: tuple[Array, ...]) -> Array:
        return _axial(algebra.flatten(state, space.kinds), space.kinds, n)

    def on_coordinates(function: Any) -> Any:
        return None if function is None else lambda x, **known: packed(tuple(call(function, unpacked(x), known)))

    def start(draw: Callable[[tuple[int, ...]], Array]) -> Array:
        return packed(exact.random_state(space, n, draw))

    def tensor(x: Array) -> Array:
        turn = _axial(np.arange(1, len(x) + 1), space.kinds, n)  # a permutation with signs
        place, sign = abs(turn) - 1, np.sign(turn)
        return (model.call(space.tensor, *unpacked(x)) * (sign[:, None] * sign))[np.ix_(place, place)]

    def of_record(function: Any) -> Any:
        return None if function is None else lambda x, lam, **known: call(function, unpacked(x), {**known, "lam": lam})

    extra = _beyond_the_spectrum(system, mapped)

    def integrals(x: Array, **known: Array) -> Array:
        return np.concatenate([np.ravel(call(f, unpacked(x), known)) for f in extra])

    def casimirs(x: Array) -> Array:
        return np.ravel(call(space.casimirs, unpacked(x), {}))

    def allowed(x: Array, **known: Any) -> bool:
        return bool(known["eps"] < call(mapped.largest_step, unpacked(x), known))

    return Subject(
        name=system.name,
        step=on_coordinates(mapped.step),
        names=coordinate_names(space.components, n),
        constants={**constants, "eps": eps},
        start=start,
        tensor=tensor,
        casimirs=casimirs if space.casimirs is not None else None,
        lax=of_record(mapped.lax),
        conjugator=of_record(mapped.conjugator),
        integrals=integrals if extra else None,
        involution=on_coordinates(mapped.involution),
        flow=on_coordinates(system.flow),
        energy=None if system.energy is None else lambda x, **known: call(system.energy, unpacked(x), known),
        allowed=allowed if mapped.largest_step is not None else None,
        implicit=implicit,
        model=model,
    )


def _beyond_the_spectrum(system: System, mapped: Map) -> list[Callable[..., Any]]:
    """The integrals of the map that are not among those of its Lax matrix."""
    by_lax = system.commuting if mapped.lax is not None else ()
    keeps = mapped.conserves
    extra = [f for name, f in system.integrals.items() if name not in by_lax and (keeps is None or name in keeps)]
    if mapped.lax is None and system.energy is not None and (keeps is None or "energy" in keeps):
        return [system.energy, *extra]
    return extra


def _fractions(v: Any) -> Any:
    return np.vectorize(fraction, otypes=[object])(v)[()]


def _axial(flat: Array, kinds: tuple[str, ...], n: int) -> Array:
    """Skew components by their axial vectors for n = 3, and back: the same change both ways."""
    if n != 3:
        return flat
    place, sign = np.arange(flat.shape[-1]), np.ones(flat.shape[-1], dtype=np.int8)
    start = 0
    for kind in kinds:
        if kind == "skew":
            place[start : start + 3], sign[start : start + 3] = place[start : start + 3][::-1], (-1, 1, -1)
        start += algebra.KINDS[kind].count(n)
    return flat[..., place] * sign


def coordinate_names(components: tuple[tuple[str, str], ...], n: int) -> tuple[str, ...]:
    """m1, m2, m3 for an axial vector, m12, m13, ... for n > 3, a1, a2, ... for vectors."""
    names: list[str] = []
    for letter, kind in components:
        if kind == "skew" and n > 3:
            names += [f"{letter}{i + 1}{j + 1}" for i, j in zip(*algebra.triangle(n), strict=True)]
        else:
            names += [f"{letter}{i + 1}" for i in range(algebra.KINDS[kind].count(n))]
    return tuple(names)
