"""Definitions on JAX: a number that stands in NumPy's object arrays as the recorded ones of `kreisel.kernels.tape` do.

A loop until an improvement has settled becomes one of JAX; derivatives through it come from the implicit function
theorem.  Exact zeros and ones fold away as they do on a tape.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction
from typing import Any, ClassVar

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.algebra.complex import Ring
from kreisel.errors import InputError
from kreisel.kernels import adjoint, jax_primitives
from kreisel.kernels.jax_primitives import iterated, with_jacobian
from kreisel.kernels.tape import whole_power
from kreisel.reduction import linear
from kreisel.reduction.double import jax, on_host, require_double

jnp = jax.numpy
lax = jax.lax


class Number(Ring):
    """A scalar of JAX, `value`."""

    __slots__ = ("value",)
    inexact: ClassVar[bool] = True

    def __init__(self, value: Any):
        self.value = value

    def __neg__(self) -> Number:
        return Number(-self.value)

    def __add__(self, other: Any) -> Any:
        if not _is_number(other):
            return NotImplemented
        return self if _is(other, 0) else Number(self.value + plain(other))

    def __mul__(self, other: Any) -> Any:
        if not _is_number(other):
            return NotImplemented
        if _is(other, 0) or _is(other, 1) or _is(other, -1):
            return 0.0 if other == 0 else (self if other == 1 else -self)
        return Number(self.value * plain(other))

    def __truediv__(self, other: Any) -> Any:
        return Number(self.value / plain(other)) if _is_number(other) else NotImplemented

    def __rtruediv__(self, other: Any) -> Any:
        if not _is_number(other):
            return NotImplemented
        return 0.0 if _is(other, 0) else Number(plain(other) / self.value)

    def __pow__(self, exponent: int) -> Any:
        return whole_power(self, exponent)

    def sqrt(self) -> Number:
        return Number(jnp.sqrt(self.value))

    def sin(self) -> Number:
        return Number(jnp.sin(self.value))

    def cos(self) -> Number:
        return Number(jnp.cos(self.value))

    def exp(self) -> Number:
        return Number(jnp.exp(self.value))

    def log(self) -> Number:
        return Number(jnp.log(self.value))

    def sign(self) -> Number:
        return Number(jnp.where(self.value < 0, -1.0, 1.0))

    def maximum(self, other: Any) -> Number:
        return Number(jnp.maximum(self.value, plain(other)))

    def record_loop(
        self, body: Callable[..., tuple[Any, Any]], start: Any, small: float, most: int
    ) -> tuple[Any, Number]:
        """`x, defect = body(x)`, repeated until defect <= small, at most `most` times, for an array x (d,)."""

        def improved(x: Array) -> tuple[Array, Array]:
            new, defect = body(numbers(x))
            return values(new), jnp.asarray(plain(defect))

        def found(_: Any, x: Array) -> Array:
            def going(carry: tuple[Array, Array, Array]) -> Array:
                return (carry[2] < most) & ~(carry[1] <= small)

            def once(carry: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
                return *improved(carry[0]), carry[2] + 1

            return lax.while_loop(going, once, (x, jnp.asarray(jnp.inf), 0))[0]

        def tangent(slope: Callable[[Array], Array], y: Array) -> Array:
            return linear.solve(jax.jacfwd(slope)(jnp.zeros_like(y)), y[:, None])[:, 0]

        x = lax.custom_root(lambda x: x - improved(x)[0], lax.stop_gradient(values(start)), found, tangent)
        return numbers(x), Number(lax.stop_gradient(improved(lax.stop_gradient(x))[1]))


def _is_number(x: Any) -> bool:
    return isinstance(x, Number | int | float | Fraction | np.integer | np.floating)


def _is(x: Any, value: int) -> bool:
    return not isinstance(x, Number) and x == value


def plain(x: Any) -> Any:
    """The scalar of JAX, or a float."""
    return x.value if isinstance(x, Number) else float(x)


def numbers(x: Array) -> Any:
    """An array of JAX as an object array of its numbers; one number as itself."""
    out = np.empty(x.shape, dtype=object)
    for place in np.ndindex(x.shape):
        out[place] = Number(x[place])
    return out[()]


def values(x: Any) -> Array:
    """The inverse of `numbers`; plain numbers may be among them."""
    entries = np.asarray(x, dtype=object)
    flat = [jnp.asarray(plain(v), dtype=jnp.float64) for v in entries.flat]
    return jnp.stack(flat).reshape(entries.shape) if flat else jnp.zeros(entries.shape)


# -- values that JAX may trace -----------------------------------------------------------------------


def is_traced(x: Any) -> bool:
    """Whether JAX traces it."""
    return isinstance(x, jax.core.Tracer)


def array(value: Any, name: str) -> Array:
    """An array in float64.  Raises `InputError` for single precision and for what is no array of real numbers."""
    try:
        found = value if isinstance(value, jax.Array) else np.asarray(value)
    except ValueError:
        found = np.asarray(None)
    if found.dtype == np.float32:
        raise InputError(f"{name}: expected float64, got an array in float32. Convert it where it is made.")
    if found.dtype.kind not in "iuf":
        raise InputError(f"{name}: expected an array of real numbers, got {found.dtype}.")
    require_double(found)
    return jnp.asarray(found, dtype=jnp.float64)


def mixed(x: Any) -> Any:
    """Arrays of JAX as their numbers; others as they are."""
    return numbers(x) if isinstance(x, jax.Array) else x


def first_of(first: Callable[[], Any], second: Callable[[], Any], what: str) -> Any:
    """What the first can make of arrays of JAX, else the second of numbers.  Raises `InputError` where neither can."""
    try:
        return first()
    except (TypeError, AttributeError):
        try:
            return second()
        except (TypeError, AttributeError) as error:
            raise InputError(f"{what} cannot be differentiated: {error}") from error


def from_host(function: Callable[..., Array], size: int, *args: Any) -> Array:
    """A function of NumPy arrays, whose value (size,) has no derivative."""
    shape: Any = jnp.zeros(size)
    return on_host(function, shape, *lax.stop_gradient(args), vmap_method="sequential")


def half_turn(K: Any, dt: Any) -> Array:
    """V with cay(V) = exp(dt K/2): by Taylor's series of exp - 1 for a small part of it, doubled eight times."""
    if not any(isinstance(v, Number) for v in np.asarray(K, dtype=object).flat):
        K = np.asarray(K, dtype=np.float64)
        if not K.any():
            return K
    part, one = values(K) * dt / 512, jnp.eye(K.shape[-1])
    E = part
    for k in range(9, 1, -1):
        E = part @ (one + E / k) if k < 9 else part
    for _ in range(8):
        E = 2 * E + E @ E
    return linear.solve((E + 2 * one).T, E.T).T


# -- orbits --------------------------------------------------------------------------------------------


def orbit(
    take: Callable[..., tuple[Any, ...]],
    close: Callable[..., tuple[Any, ...]] | None,
    kinds: Sequence[str],
    n: int,
    z: Array,
    known: Mapping[str, Any],
    stages: Mapping[str, Any],
    rows: int,
    every: int,
) -> Array:
    """States (rows + 1, d) at every so many steps: `take` once for each stage, then `close`.

    The reverse sweep keeps the states at the ends of about sqrt(every) parts, and those of one part, made again.
    """
    found = compiled_orbit(take, close, kinds, n, z, known, stages, rows, every)
    if found is not None:
        return found
    moving = {k: x for k, x in known.items() if any(isinstance(v, Number) for v in np.asarray(x, dtype=object).flat)}
    fixed = {k: v for k, v in known.items() if k not in moving}
    count = max((np.shape(v)[0] for v in stages.values()), default=1)
    constants = _scalars(moving)  # one by one: those without a tangent then cost nothing
    of_stages = [_scalars({k: v[i] for k, v in stages.items()}) for i in range(count)]
    shapes = {k: np.shape(v) for k, v in moving.items()}, {k: np.shape(v)[1:] for k, v in stages.items()}

    def on_scalars(function: Callable[..., tuple[Any, ...]], staged: bool) -> Callable[..., Array]:
        def scalars(*numbered: Array) -> tuple[Array, ...]:
            rest = [Number(v) for v in numbered]
            state, rest = rest[: len(z)], rest[len(z) :]
            more, rest = _shaped(rest, shapes[0])
            of_stage = _shaped(rest, shapes[1])[0] if staged else {}
            parts = algebra.restore(_objects(state), kinds, n)
            new = algebra.flatten(function(*parts, **fixed, **more, **of_stage), kinds)
            return tuple(jnp.asarray(plain(v), dtype=jnp.float64) for v in new)

        made = with_jacobian(scalars)
        return lambda z, constants, of_stage: jnp.stack(made(*z, *constants, *(of_stage if staged else ())))

    stage, end = on_scalars(take, True), None if close is None else on_scalars(close, False)
    along = [jnp.stack(v) for v in zip(*of_stages, strict=True)]

    def step(z: Array, constants: Any) -> Array:
        if count == 1:
            z = stage(z, constants, of_stages[0])
        else:
            z, _ = lax.scan(lambda z, s: (stage(z, constants, s), None), z, along)
        return z if end is None else end(z, constants, ())

    return iterated(step, z, constants, rows, every)


def compiled_orbit(
    take: Callable[..., tuple[Any, ...]],
    close: Callable[..., tuple[Any, ...]] | None,
    kinds: Sequence[str],
    n: int,
    z: Array,
    known: Mapping[str, Any],
    stages: Mapping[str, Any],
    rows: int,
    every: int,
) -> Array | None:
    """The same by compiled kernels, None where the step has a loop or is too long for them, or JAX not on the CPU."""
    if jax.default_backend() != "cpu":
        return None
    names, constants = _named("c", known)
    count = max((np.shape(v)[0] for v in stages.values()), default=1)
    each = [_named("s", {k: _entries(v)[i] for k, v in stages.items()}, fold=False) for i in range(count)]
    stage = adjoint.recorded(take, kinds, n, {**names, **each[0][0]})
    end = None if close is None else adjoint.recorded(close, kinds, n, names)
    if stage is None or (close is not None and end is None):
        return None
    code = adjoint.code_of(stage, end, len(constants), len(each[0][1]))
    s = jnp.stack([values(np.array(row, dtype=object)) for _, row in each])
    return jax_primitives.orbit(code, z, values(np.array(constants, dtype=object)), s, rows, every)


def _named(letter: str, known: Mapping[str, Any], fold: bool = True) -> tuple[dict[str, Any], list[Any]]:
    """Names in place of entries, and the entries; 0, 1, -1 stay if they may `fold`, and what is no array."""
    names: dict[str, Any] = {}
    found: list[Any] = []
    for key, value in known.items():
        entries = _entries(value)
        if entries.dtype.kind not in "fO":
            names[key] = value
            continue
        named = np.empty(entries.shape, dtype=object)
        for place in np.ndindex(entries.shape):
            entry = entries[place]
            if fold and not isinstance(entry, Number) and float(entry) in adjoint.PLAIN:
                named[place] = float(entry)
            else:
                named[place] = f"{letter}{len(found)}"
                found.append(entry)
        names[key] = named
    return names, found


def _entries(x: Any) -> Array:
    return np.asarray(numbers(x) if isinstance(x, jax.Array) else x)


def orbit_of_arrays(
    take: Callable[..., tuple[Array, ...]],
    kinds: Sequence[str],
    n: int,
    z: Array,
    known: Mapping[str, Any],
    rows: int,
    every: int,
) -> Array:
    """The same for a step of arrays of JAX."""
    constants = {k: values(v) for k, v in known.items()}

    def step(z: Array, constants: Mapping[str, Array]) -> Array:
        return algebra.flatten(take(*algebra.restore(z, kinds, n), **constants), kinds)

    return iterated(step, z, constants, rows, every)


def _scalars(known: Mapping[str, Any]) -> list[Array]:
    return [v for x in known.values() for v in jnp.ravel(values_of(x))]


def values_of(x: Any) -> Array:
    """An array of JAX, of numbers or of NumPy, as one of JAX."""
    return jnp.asarray(x, dtype=jnp.float64) if isinstance(x, jax.Array) else values(x)


def _shaped(rest: list[Number], shapes: Mapping[str, tuple[int, ...]]) -> tuple[dict[str, Any], list[Number]]:
    out = {}
    for name, shape in shapes.items():
        size = int(np.prod(shape))
        out[name], rest = _objects(rest[:size]).reshape(shape)[()], rest[size:]
    return out, rest


def _objects(entries: list[Number]) -> Any:
    out = np.empty(len(entries), dtype=object)
    out[:] = entries
    return out
