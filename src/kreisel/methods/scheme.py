"""What a method hands to the engines: pure functions, and the layout of what they work on."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from kreisel.algebra import Array

Components = tuple[tuple[str, str], ...]  # (letter, kind): "skew", "vector", "matrix", "quaternion"


@dataclass(frozen=True)
class Outcome:
    """One variable that `observe` returns: its kind and what it means.

    kind: "state", "orientation", "casimir" or "integral"; `kept` says of the last two that this method
    keeps them constant up to round-off.
    """

    kind: str
    meaning: str
    axes: str = ""  # the kind of component ("skew", ...) of a state; "" for a scalar or a family
    kept: bool = False


# (M, e) -> z: the states at times M 2^e, Python integers in object arrays and small integers, both (times,)
Orbit = Callable[[Array, Array], tuple[Array, ...]]


@dataclass(frozen=True)
class Scheme:
    """A method for one model.

    prepare(x0)            -> z0        once
    step(*z, **constants)  -> z         the map, compiled by an engine; None for a flow
    rate(*z, **constants)  -> z'        the right-hand side, for methods of a library; None for a map
    orbit(z0, consts, reach) -> Orbit   the states at any |time| <= reach in closed form, for one lane; a map, which
                                        also states its step, has whole times and counts steps
    observe(z)             -> outputs   at saved steps; batch axes (time, lane) in front
    reopen(x)              -> z         from an observed state back to the method's own variables
    explain(z, constants)  -> text      why the step from z gave NaN, for implicit maps
    """

    name: str
    components: Components
    constants: Mapping[str, Array]  # what step or rate takes by keyword; a lane axis may stand in front
    axes: Mapping[str, int]  # of each constant, without the lane axis
    n: int
    prepare: Callable[[tuple[Array, ...]], tuple[Array, ...]]
    observe: Callable[[tuple[Array, ...]], dict[str, Array]]
    outcomes: Mapping[str, Outcome]
    reopen: Callable[[tuple[Array, ...]], tuple[Array, ...]]
    step: Callable[..., tuple[Array, ...]] | None = None
    rate: Callable[..., tuple[Array, ...]] | None = None
    orbit: Callable[[tuple[Array, ...], Mapping[str, Array], float], Orbit] | None = None
    options: Mapping[str, Any] | None = None
    numbers: str = "any"  # as in the record: what step and rate work on
    explain: Callable[[tuple[Array, ...], Mapping[str, Array]], str] | None = None
