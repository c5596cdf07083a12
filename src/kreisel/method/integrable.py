"""The integrable part of a splitting: its flow for a short time, with integrals that change from step to step."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import reduce
from typing import Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.errors import InputError
from kreisel.exact import gyrostat_step, rotor_step, top_step
from kreisel.forces.kicks import WHEEL, inverse_inertia_columns, perturbation_of, require_principal
from kreisel.forces.product import Factor
from kreisel.method.composition import symmetric_composition
from kreisel.method.observing import turned_by_map
from kreisel.record.calling import call
from kreisel.record.contract import Frame, Map, System
from kreisel.record.model import Model

State = tuple[Array, ...]
Constants = Mapping[str, Array]
ORDER = 8  # of a map, composed, where none is asked for


@dataclass(frozen=True)
class Integrable:
    """name; move(state, orientation, h, constants) -> both after the time h; reach(state, h, constants): at most 1
    where the step is precise to rounding, None where there is no bound; left(state, constants): the rates of the state
    by what the motion leaves to the kicks, None for nothing.
    """

    name: str
    move: Callable[[State, State, Any, Constants], tuple[State, State]]
    reach: Callable[[State, Any, Constants], Any] | None = None
    left: Callable[[State, Constants], State] | None = None


def integrable(model: Model) -> Integrable:
    """Of the base of a perturbed system, the best that is known.  Raises `InputError` where none is.

    Where H = T(M) + V has neither a map nor a closed form it is the free body, and V is left to the kicks.
    """
    record = perturbation_of(model.system)
    if record.base.product:
        return _side_by_side(
            [
                (factor, _integrable(factor.system, record.inner, model.n, factor.known(model.constants)))
                for factor in record.base.product
            ]
        )
    if record.wheel:
        return _with_wheel(record.base)
    return _integrable(record.base, record.inner, model.n, model.constants)


def _integrable(base: System, inner: int | None, n: int, known: Constants) -> Integrable:
    closed = closed_form(base, n) if inner is None else None
    if closed is not None:
        return closed
    if base.map is not None:
        return _composed(base, base.map, inner or ORDER)
    if separable(base, n):
        require_principal(base, known)
        return _carrying_rotor(base)
    raise InputError(
        f"perturbed: no map and no closed form of {base.name}, n = {n}, is known here. Use method='dop853'."
    )


def _side_by_side(parts: list[tuple[Factor, Integrable]]) -> Integrable:
    """Bodies of different systems, each with its own motion."""

    def move(own: State, g: State, h: Any, known: Constants) -> tuple[State, State]:
        return tuple(z for f, part in parts for z in part.move(own[f.place], (), h, f.known(known))[0]), g

    def reach(own: State, h: Any, known: Constants) -> Any:
        found = [part.reach(own[f.place], h, f.known(known)) for f, part in parts if part.reach is not None]
        return reduce(algebra.maximum, found)

    def left(own: State, known: Constants) -> State:
        return tuple(
            z
            for f, part in parts
            for z in (part.left(own[f.place], f.known(known)) if part.left else [0 * x for x in own[f.place]])
        )

    return Integrable(
        " and ".join(dict.fromkeys(part.name for _, part in parts)),
        move,
        reach if any(part.reach for _, part in parts) else None,
        left if any(part.left for _, part in parts) else None,
    )


def closed_form(base: System, n: int) -> Integrable | None:
    """Of a free body, a gyrostat or a Lagrange top, n = 3; None where none of one short step is known."""
    if n == 3 and base.closed_form.moments is not None:
        return _free_body(base)
    if n == 3 and base.closed_form.gyrostat is not None and base.space.kinds == ("skew",):
        return _gyrostat(lambda known: call(base.closed_form.gyrostat, (), known), lambda known: 0)
    return _top(base) if n == 3 and base.closed_form.top is not None else None


def _free_body(base: System) -> Integrable:
    def moments(known: Constants) -> Array:
        return np.asarray(call(base.closed_form.moments, (), known))

    def move(own: State, g: State, h: Any, known: Constants) -> tuple[State, State]:
        M = algebra.axial(own[0])
        start = g[0] if g else np.concatenate([1 + 0 * M[..., :1], 0 * M], -1)
        N, q = rotor_step.step(M, start, h=h, **rotor_step.constants(moments(known)))
        return (algebra.hat(N),), (q,) * len(g)

    def reach(own: State, h: Any, known: Constants) -> Any:
        return rotor_step.reach(algebra.axial(own[0]), h, **rotor_step.constants(moments(known)))

    return Integrable("the closed form of a free body", move, reach)


def _with_wheel(base: System) -> Integrable:
    """A free body with a wheel, whose momentum is h: M + h is that of a gyrostat."""

    def inverse(known: Constants) -> Array:
        return 1 / np.asarray(call(base.closed_form.moments, (), known))

    return _gyrostat(lambda known: (inverse(known), inverse(known) * known[WHEEL]), lambda known: known[WHEEL])


def _gyrostat(numbers: Callable[[Constants], tuple[Array, Array]], beside: Callable[[Constants], Any]) -> Integrable:
    """M' = M x (w M - b), with w and b by `numbers`, of M less what `beside` says."""

    def move(own: State, g: State, h: Any, known: Constants) -> tuple[State, State]:
        M, (w, b) = algebra.axial(own[0]) + beside(known), numbers(known)
        start = g[0] if g else np.concatenate([1 + 0 * M[..., :1], 0 * M], -1)
        N, q = gyrostat_step.step(M, start, h=h, w=w, b=b)
        return (algebra.hat(N - beside(known)),), (q,) * len(g)

    def reach(own: State, h: Any, known: Constants) -> Any:
        w, b = numbers(known)
        return gyrostat_step.reach(algebra.axial(own[0]) + beside(known), h, w=w, b=b)

    return Integrable("the closed form of a gyrostat", move, reach)


def _top(base: System) -> Integrable:
    """In the rest frame (m, a, p), in the moving frame (M, A, P) of the record."""
    rest, unequal = base.frame is Frame.REST, any(p.letter == "alpha" for p in base.parameters)

    def of(own: State, known: Constants) -> tuple[Array, Array, Array, Array]:
        m, a, p = call(base.closed_form.top, own, known)
        return algebra.axial(m), a, p, known["alpha"] if unequal else 1.0

    def move(own: State, g: State, h: Any, known: Constants) -> tuple[State, State]:
        m, a, p, alpha = of(own, known)
        if rest:
            m, b, *turned = top_step.step(m, a, *g, p=p, alpha=alpha, h=h)
        else:
            m, b, *turned = top_step.step_inside(m, p, *g, A=a, alpha=alpha, h=h)
        return (algebra.hat(m), b), tuple(turned)

    def reach(own: State, h: Any, known: Constants) -> Any:
        m, a, p, alpha = of(own, known)
        return top_step.reach(m, a, p=p, alpha=alpha, h=h)

    return Integrable("the closed form of a Lagrange top", move, reach)


def separable(base: System, n: int) -> bool:
    """Whether H = T(M) + V(vectors), of a body in its own frame with n = 3: turns of a free body, and kicks."""
    turning = base.frame is Frame.MOVING and base.inverse_inertia is not None and base.spin is None
    return n == 3 and turning and set(base.space.kinds) == {"skew", "vector"}


def _carrying_rotor(base: System) -> Integrable:
    """The free body with the vectors that it carries, in closed form; V(vectors) is left to the kicks."""

    def constants(own: State, known: Constants) -> Constants:
        columns = inverse_inertia_columns(base, known, own[1])
        return rotor_step.constants(1 / np.stack([column[..., i] for i, column in enumerate(columns)], -1))

    def move(own: State, g: State, h: Any, known: Constants) -> tuple[State, State]:
        M = algebra.axial(own[0])
        one = np.concatenate([1 + 0 * M[..., :1], 0 * M], -1)
        N, q = rotor_step.step(M, one, h=h, **constants(own, known))
        W = algebra.rotation_matrix(q)
        carried = (algebra.act(W.mT, v) for v in own[1:])
        return (algebra.hat(N), *carried), tuple(algebra.quaternion_product(x, q) for x in g)

    def reach(own: State, h: Any, known: Constants) -> Any:
        return rotor_step.reach(algebra.axial(own[0]), h, **constants(own, known))

    def left(own: State, known: Constants) -> State:
        return tuple(call(base.flow, (0 * own[0], *own[1:]), known))

    return Integrable("the closed form of a free body", move, reach, left)


def _composed(base: System, phi: Map, order: int) -> Integrable:
    """The map of the system, made symmetric, in a composition of that order."""
    fractions = symmetric_composition(order)

    def move(own: State, g: State, h: Any, known: Constants) -> tuple[State, State]:
        for fraction in fractions:
            more = {**known, "eps": float(fraction) * h}
            old = own if phi.symmetric else call(phi.from_symmetric, own, more)
            new = call(phi.step, old, more)
            g = tuple(turned_by_map(phi, base.frame, old, new, more, h) for h in g)
            own = new if phi.symmetric else call(phi.to_symmetric, new, more)
        return tuple(own), g

    return Integrable("its map", move)
