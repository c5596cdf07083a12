"""Steps of JAX: compiled loops, one trajectory a lane, and the right-hand side for a library's integrator."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.algebra.reuse import reused
from kreisel.errors import RunError
from kreisel.graph.invariants import recordable
from kreisel.graph.project import Projected
from kreisel.kernels.layout import Floats, Look
from kreisel.kernels.projection import InDoubles, gauss_newton, led, scales
from kreisel.method.scheme import ORIENTATION, Flow, JaxSteps, Scheme
from kreisel.reduction.numerics import double, jax

jnp = jax.numpy
lax = jax.lax
ROWS = 256  # saved rows in one call of the compiled loop
EVERY = 1000  # steps between two projections, of about 0.1 ms; steps need some microseconds


@lru_cache(64)
def _compiled_loop(
    step: Callable[..., tuple[Array, ...]], kinds: tuple[str, ...], n: int, names: frozenset[str], lanes: frozenset[str]
) -> Callable[..., Any]:
    """The loop for a step, compiled at its first call and kept for further runs; `lanes` are constants with lanes."""

    def new_state(z: Array, constants: Mapping[str, Array]) -> Array:
        return algebra.flatten(step(*algebra.restore(z, kinds, n), **constants), kinds)

    every_lane = jax.vmap(new_state, in_axes=(0, {k: 0 if k in lanes else None for k in names}))

    def loop(z: Array, constants: Mapping[str, Array], rows: Array, every: Array) -> Any:
        def advance(_: Array, carry: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
            z, alive, count = carry
            new = every_lane(z, constants)
            alive = alive & jnp.isfinite(new).all(-1)
            return jnp.where(alive[:, None], new, z), alive, count + alive

        def fill(row: Array, carry: Any) -> Any:
            out, *remainder = carry
            remainder = lax.fori_loop(0, every, advance, tuple(remainder))
            return (out.at[row].set(remainder[0]), *remainder)

        alive, count = jnp.ones(len(z), bool), jnp.zeros(len(z), jnp.int64)
        return lax.fori_loop(0, rows, fill, (jnp.zeros((ROWS, *z.shape)), z, alive, count))

    return jax.jit(loop)


def _projection(
    scheme: Scheme, constants: Mapping[str, Floats], lanes: frozenset[str]
) -> tuple[Callable[..., Any], ...]:
    """Compiled: the values of the invariants by name, and a corrected state with its correction; kept for further runs.

    They depend on the record, whose step is a single function, and on eps.
    """
    kinds, n = tuple(scheme.kinds), scheme.n
    count = sum(letter != ORIENTATION for letter, _ in scheme.components)
    key = _projection, steps_of(scheme).step, kinds, n, lanes, repr(scheme.constants.get("eps"))

    def invariants(z: Array, constants: Mapping[str, Array]) -> dict[str, Array]:
        result = scheme.observe(algebra.restore(z, kinds, n)[:count], **constants)
        names = sorted(
            name for name in result if scheme.outcomes[name].conserved
        )  # the order in which JAX returns them
        return {name: jnp.ravel(result[name]) for name in names}

    def values(z: Array, constants: Mapping[str, Array]) -> Array:
        return jnp.concatenate([jnp.zeros(0), *invariants(z, constants).values()])

    def correction(
        z: Array, constants: Mapping[str, Array], targets: Array, worst: Array
    ) -> tuple[Array, Array, Array]:
        start, _, size, lead = targets.T
        J, lack = jax.jacrev(values)(z, constants), values(z, constants) - start
        finite = jnp.isfinite(J).all(-1) & jnp.isfinite(lack)
        J, lack, lead = jnp.where(finite[:, None], J, 0), jnp.where(finite, lack, 0), jnp.where(finite, lead, 0)
        scale, unit = scales(z, J, size)
        worst, lead = led(lack, lead, unit, worst)
        return gauss_newton(z, J, lack + lead, scale), worst, lead

    axes_of_constants = {k: 0 if k in lanes else None for k in constants}
    pair = (invariants, (0, axes_of_constants)), (correction, (0, axes_of_constants, 0, 0))
    return reused(key, lambda: tuple(jax.jit(jax.vmap(function, in_axes=axes)) for function, axes in pair))


class JaxProjection(InDoubles):
    """The projection of a step of JAX."""

    def __init__(self, scheme: Scheme, z: Floats, constants: Mapping[str, Floats], lanes: frozenset[str]):
        self._family, self._correct = _projection(scheme, constants, lanes)
        self._z, self._constants = z, constants
        self._begin({name: value.shape[1] for name, value in self._values(z).items()}, EVERY)
        if self.labels:
            with double():
                jax.eval_shape(self._correct, z, constants, self.targets, self.worst)  # fails without a derivative

    def _values(self, z: Floats) -> dict[str, Floats]:
        with double():
            return {name: np.asarray(value) for name, value in self._family(z, self._constants).items()}

    def _corrected(self, z: Floats) -> tuple[Floats, Floats, Floats]:
        with double():
            new, worst, lead = map(np.array, self._correct(z, self._constants, self.targets, self.worst))
        return new, worst, lead


def _projected(
    scheme: Scheme, z: Floats, constants: Mapping[str, Floats], lanes: frozenset[str]
) -> JaxProjection | None:
    """None if nothing is conserved, and, with a warning, for user-defined integrals that JAX cannot trace."""
    projection = recordable(lambda: JaxProjection(scheme, z, constants, lanes), "arrays of JAX")
    return projection if projection and projection.labels else None


def steps_of(scheme: Scheme) -> JaxSteps:
    """The step of JAX that a scheme states.  Raises `TypeError` where it states none."""
    if not isinstance(scheme.motion, JaxSteps):
        raise TypeError(f"the scheme {scheme.name} states no step of JAX")
    return scheme.motion


class JaxEngine(Projected):
    """A step of JAX in a compiled loop.  A lane whose step gives NaN stays where it was, and its step is named."""

    def __init__(self, scheme: Scheme, z0: Floats, dt: float, project: bool = False):
        self.z = np.array(z0, dtype=np.float64)
        self._scheme, self._dt, self._done = scheme, dt, 0
        self._kinds = scheme.kinds
        self._constants = {k: np.asarray(v, dtype=np.float64) for k, v in scheme.constants.items()}
        self._steps = steps_of(scheme)
        lanes = frozenset(k for k, v in self._constants.items() if v.ndim > scheme.axes[k])
        self._loop = _compiled_loop(self._steps.step, tuple(self._kinds), scheme.n, frozenset(self._constants), lanes)
        self.projection = _projected(scheme, self.z, self._constants, lanes) if project else None

    def _advance(self, out: Floats, every: int, look: Look) -> None:
        for start in range(0, len(out), ROWS):
            look()
            rows = min(ROWS, len(out) - start)
            with double():
                filled, z, alive, count = map(np.asarray, self._loop(self.z, self._constants, rows, every))
            out[start : start + rows] = filled[:rows]
            self.z[:] = z
            if not alive.all():
                self._fail(int(np.argmin(alive)), int(count[np.argmin(alive)]), len(alive))
            self._done += rows * every

    def snapshot(self) -> dict[str, Floats]:
        return {"steps": np.asarray(self._done, dtype=np.float64), **super().snapshot()}

    def restore(self, snapshot: Mapping[str, Floats]) -> None:
        super().restore(snapshot)
        self._done = int(snapshot["steps"])

    def _fail(self, lane: int, count: int, lanes: int) -> None:
        step = self._done + count + 1
        state = algebra.restore(self.z[lane], self._kinds, self._scheme.n)
        constants = {k: v[lane] if v.ndim > self._scheme.axes[k] else v for k, v in self._constants.items()}
        where = f" of lane {lane}" if lanes > 1 else ""
        guard = self._scheme.guard
        why = "The step is not finite." if guard is None else guard.text(state, constants)
        raise RunError(f"Step {step}{where} (time {step * self._dt:g}) could not be made. {why}")


def compiled_rate(scheme: Scheme) -> Callable[[float, Floats, Floats], Floats]:
    """The right-hand side y' = f(t, y, constants) of a scheme whose rate is of JAX arrays."""
    kinds = scheme.kinds
    shapes = {k: np.shape(v)[np.ndim(v) - scheme.axes[k] :] for k, v in scheme.constants.items()}
    if not isinstance(scheme.motion, Flow):
        raise TypeError(f"the scheme {scheme.name} states no rate")
    function = scheme.motion.rate

    def rate(y: Array, row: Array) -> Array:
        constants, start = {}, 0
        for k, shape in shapes.items():
            size = int(np.prod(shape))
            constants[k] = row[start : start + size].reshape(shape)
            start += size
        return algebra.flatten(function(*algebra.restore(y, kinds, scheme.n), **constants), kinds)

    with double():
        compiled = jax.jit(rate)

    def call(t: float, y: Floats, row: Floats) -> Floats:
        with double():
            return np.asarray(compiled(y, row))

    return call
