"""The variables of a run, derived from the record: state, orientation, Casimirs, integrals; a scheme of these."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from typing import Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.method.scheme import Components, Motion, Outcome, Scheme
from kreisel.record.calling import call, keywords
from kreisel.record.contract import Frame, Map
from kreisel.record.model import Model
from kreisel.record.perturbation import TIME

State = tuple[Array, ...]
Observed = tuple[Callable[..., dict[str, Array]], dict[str, Outcome]]  # `observe`, and its variables
Only = Collection[str] | None
ORIENTATION = "g"
COUNT, WORK, BALANCE = "_count", "work", "balance"  # of driven bodies; _count: of complete steps


def orientation_component(n: int) -> tuple[str, str]:
    """The orientation g as a unit quaternion for n = 3, as an orthogonal matrix otherwise."""
    return (ORIENTATION, "quaternion" if n == 3 else "matrix")


def scheme_of(
    name: str, model: Model, motion: Motion, observed: Observed, oriented: bool = False, **fields: Any
) -> Scheme:
    """The scheme of a method that steps the variables of the system; `fields`: those of a `Scheme` that differ."""
    observe, outcomes = observed
    usual: dict[str, Any] = {
        "components": with_orientation(model, oriented),
        "constants": dict(model.constants),
        "axes": model.axes,
        "n": model.n,
        "prepare": tuple,
        "observe": observe,
        "reopen": tuple,
        "outcomes": outcomes,
    }
    return Scheme(name, motion=motion, **(usual | fields))


def with_orientation(model: Model, oriented: bool) -> Components:
    """The components of the state, and the orientation."""
    return model.system.space.components + ((orientation_component(model.n),) if oriented else ())


def with_lanes(model: Model, state: State, least: tuple[int, ...] = ()) -> tuple[tuple[int, ...], State]:
    """The batch of a model and a state, of the axes `least` at least, and the components with its axes."""
    axes = [algebra.KINDS[kind].axes for kind in model.system.space.kinds]
    batch = np.broadcast_shapes(least, model.batch, *(z.shape[: z.ndim - k] for z, k in zip(state, axes, strict=True)))
    return batch, tuple(np.broadcast_to(z, batch + z.shape[z.ndim - k :]) for z, k in zip(state, axes, strict=True))


def turned(frame: Frame, X: Array, g: Array) -> Array:
    """The orientation turned by cay(X): from the left in the rest frame, from the right in the moving one."""
    return algebra.turn_left(X, g) if frame is Frame.REST else algebra.turn_right(g, X)


def turned_by_map(
    phi: Map, frame: Frame, old: tuple[Array, ...], new: tuple[Array, ...], constants: Mapping[str, Array], g: Array
) -> Array:
    """The orientation turned along with a step of a map, by its generator."""
    return turned(frame, call(phi.generator, (*old, *new), constants), g)


def turned_by_velocity(model: Model, middle: State, g: Array, eps: Array, constants: Mapping[str, Array]) -> Array:
    """The orientation turned along with a step eps, by the angular velocity at a state in its middle."""
    X = algebra.mat(eps) / 2 * call(model.system.velocity, middle, constants)
    return turned(model.system.frame, X, g)


def as_matrix(model: Model, g: Array) -> Array:
    """The orientation, as `orientation_component` has it, as an orthogonal matrix."""
    return algebra.rotation_matrix(g) if model.n == 3 else g


def functions(
    model: Model,
    eps: float | None = None,
    order: int = 1,
    conserved: Collection[str] = (),
    meanings: Mapping[str, str] | None = None,
) -> dict[str, tuple[Outcome, Callable[..., Array], bool]]:
    """Name -> (outcome, function, whether it needs the variables of the map).

    With `eps`, a step of the map, the integrals that its record names (`Map.conserves`) are conserved; those that need
    `eps` deformed, under names ending in `_eps`, while the undeformed ones change by O(dt^order).
    Without `eps` the names in `conserved` are.  `meanings` replaces the meaning of some names.
    """
    system = model.system
    by_map = eps is not None
    named_by_map = system.map.conserves if by_map and system.map is not None else ()
    out: dict[str, tuple[Outcome, Callable[..., Array], bool]] = {}

    def add(
        name: str, kind: str, meaning: str, function: Any, stays: bool = False, of_map: bool = False, **extra: Any
    ) -> None:
        def value(*state: Array, **constants: Any) -> Array:
            return model.call(function, *state, **extra, **constants)

        out[name] = Outcome(kind, meaning, conserved=stays), value, of_map

    if system.space.casimirs is not None:
        by_this_map = by_map and (system.map is None or system.map.poisson or "casimir" in (named_by_map or ()))
        stays = by_this_map or "casimir" in conserved
        add("casimir", "casimir", f"Casimirs of {system.space.name}", system.space.casimirs, stays)
    named = {"energy": system.energy} if system.energy is not None else {}
    for name, function in {**named, **system.integrals}.items():
        by_this_map = named_by_map is None or name in named_by_map
        meaning = "Hamiltonian H" if name == "energy" else f"{name} of the flow"
        if by_map and "eps" in keywords(function):
            bound = f"O(dt{'' if order == 1 else f'^{order}'})"
            add(name, "integral", f"{meaning}, not conserved by the map: it oscillates by {bound}", function)
            if by_this_map:
                deformed = f"deformed {name}, conserved exactly by the map"
                add(f"{name}_eps", "integral", deformed, function, True, True, eps=eps)
        else:
            stays = by_this_map or name in conserved
            add(name, "integral", (meanings or {}).get(name, meaning), function, stays, True)
    for name, (function, _) in system.invariant.items():
        add(name, "relation", f"{name}: f with f' = k f, so that f = 0 stays; no integral", function)
    return out


def observer(
    model: Model,
    oriented: bool = False,
    eps: float | None = None,
    to_user: Callable[..., State] | None = None,
    conserved: Collection[str] = (),
    meanings: Mapping[str, str] | None = None,
) -> Observed:
    """`observe` and its outcomes, as `functions` has them; `to_user` maps the variables of the map to the user's.

    `observe(z, only)`: if `only` is given, the state and the variables that it names.
    """
    space = model.system.space
    table = functions(model, eps, 1 if to_user is None else 2, conserved, meanings)
    outcomes = {k: Outcome("state", f"{k} ({model.system.frame.value} frame)", kind) for k, kind in space.components}
    carried = "a = g A" if model.system.frame is Frame.REST else "P = g^T p"
    form = "unit quaternion (w, x, y, z), continuous in time" if model.n == 3 else "orthogonal matrix"
    turning = f"orientation g, body to space, {carried}; {form}"
    outcomes |= {name: outcome for name, (outcome, _, _) in table.items()}
    outcomes |= {ORIENTATION: Outcome("orientation", turning, orientation_component(model.n)[1])} if oriented else {}

    def observe(z: tuple[Array, ...], only: Only = None, /, **constants: Array) -> dict[str, Array]:
        state, count = z[: len(space.letters)], len(space.letters)
        batch = np.ndim(state[0]) - algebra.KINDS[space.kinds[0]].axes
        arguments = {k: v for k, v in constants.items() if k in model.constants or k in (ORIENTATION, TIME)}
        user = to_user(*state, **arguments) if to_user is not None else state
        out = dict(zip(space.letters, user, strict=True))
        for name in table if only is None else table.keys() & set(only):
            _, function, takes_own = table[name]
            value = function(*(state if takes_own else user), **arguments)
            if np.ndim(value) == batch + 2:  # a skew block: as an axial vector for n = 3, else by its entries
                value = algebra.axial(value) if value.shape[-1] == 3 else algebra.coordinates(value)
            out[name] = value
        if len(z) > count:
            out[ORIENTATION] = z[count]  # of q and -q a method carries the one that is continuous in time
        return out

    return observe, outcomes


def held_by_orientation(
    model: Model, components: Components, bound: bool = True
) -> Callable[[tuple[Array, ...]], list[Array]] | None:
    """Functions that an orientation g leaves constant: its orthogonality, and carried vectors in the other frame.

    g^T a in the rest frame, g P in the moving frame; g M g^T where nothing is carried but the momentum.  None if the
    method steps other variables than those of the system.  `bound`: whether the method turns g by the rotation of
    the carried vectors; else only its orthogonality stays.
    """
    space = model.system.space
    count, remainder = len(space.letters), model.system.frame is Frame.REST
    if components[:count] != space.components or len(components) == count or components[count][0] != ORIENTATION:
        return None

    def held(z: tuple[Array, ...]) -> list[Array]:
        g = z[count]
        out = [algebra.dot(g, g)] if g.ndim == 1 else [algebra.KINDS["symmetric"].pack(g.mT @ g)]
        if not bound:
            return out
        turn = algebra.rotation_matrix(g) if g.ndim == 1 else g
        turn = turn.mT if remainder else turn
        for i in space.carried or (0,) * (model.system.perturbation is None):
            kind = algebra.KINDS[space.kinds[i]]
            out.append(kind.pack(kind.rotated(turn, z[i])))
        return out

    return held
