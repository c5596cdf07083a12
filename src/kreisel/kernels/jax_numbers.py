"""Definitions on JAX: a number that is in NumPy's object arrays, and the orbits of steps.

Exact zeros and ones fold away as they do in a graph; a step, which may have a loop, is recorded as one.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction
from typing import Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.algebra.complex import Ring
from kreisel.algebra.recorded import Recorded
from kreisel.errors import InputError
from kreisel.graph.graph import Graph, array_of, integer_power
from kreisel.kernels import adjoint, jax_primitives
from kreisel.kernels.jax_primitives import iterated, rows_by_xla
from kreisel.reduction import linear
from kreisel.reduction.double import jax, on_host, require_double

jnp = jax.numpy
lax = jax.lax


def _function(name: str) -> Any:
    return lambda x: Number(getattr(jnp, name)(x.value))


class Number(Ring, Recorded):
    """A scalar of JAX, `value`."""

    __slots__ = ("value",)

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

    __pow__ = integer_power
    sqrt, sin, cos, exp, log = map(_function, ("sqrt", "sin", "cos", "exp", "log"))

    def sign(self) -> Number:
        return Number(jnp.where(self.value < 0, -1.0, 1.0))

    @staticmethod
    def where_less(x: Any, y: Any, yes: Any, no: Any) -> Number:
        return Number(jnp.where(plain(x) < plain(y), plain(yes), plain(no)))

    def maximum(self, operand: Any) -> Number:
        return Number(jnp.maximum(self.value, plain(operand)))


def _is_number(x: Any) -> bool:
    return isinstance(x, Number | int | float | Fraction | np.integer | np.floating)


def _is(x: Any, value: int) -> bool:
    return not isinstance(x, Number) and x == value


def plain(x: Any) -> Any:
    """The scalar of JAX, or a float."""
    return x.value if isinstance(x, Number) else float(x)


def numbers(x: Array) -> Any:
    """An array of JAX as an object array of its scalars; one number as itself."""
    out = np.empty(x.shape, dtype=object)
    for place in np.ndindex(x.shape):
        out[place] = Number(x[place])
    return out[()]


def values(x: Any) -> Array:
    """The inverse of `numbers`; plain scalars may be among them, and an array of JAX or NumPy may be there already."""
    if isinstance(x, jax.Array):
        return jnp.asarray(x, dtype=jnp.float64)
    entries = np.asarray(x, dtype=object)
    flat = [jnp.asarray(plain(v), dtype=jnp.float64) for v in entries.flat]
    return jnp.stack(flat).reshape(entries.shape) if flat else jnp.zeros(entries.shape)


# -- values that JAX may trace -----------------------------------------------------------------------


def is_traced(x: Any) -> bool:
    """Whether JAX traces it."""
    return isinstance(x, jax.core.Tracer)


def array(value: Any, name: str) -> Array:
    """An array in float64.  Raises `InputError` for single precision and for anything but an array of real values."""
    try:
        result = value if isinstance(value, jax.Array) else np.asarray(value)
    except ValueError:
        result = np.asarray(None)
    if result.dtype == np.float32:
        raise InputError(f"{name}: expected float64, got an array in float32. Convert it at its source.")
    if result.dtype.kind not in "iuf":
        raise InputError(f"{name}: expected an array of real values, got {result.dtype}.")
    require_double(result)
    return jnp.asarray(result, dtype=jnp.float64)


def mixed(x: Any) -> Any:
    """Arrays of JAX as their scalars; others as they are."""
    return numbers(x) if isinstance(x, jax.Array) else x


def first_of(first: Callable[[], Any], second: Callable[[], Any], label: str) -> Any:
    """The result of the first, on arrays of JAX, else of the second, on scalars.  Raises `InputError` if both fail."""
    try:
        return first()
    except (TypeError, AttributeError):
        try:
            return second()
        except (TypeError, AttributeError) as error:
            raise InputError(f"{label} cannot be differentiated: {error}") from error


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
    fraction, unit = values(K) * dt / 512, jnp.eye(K.shape[-1])
    E = fraction
    for k in range(9, 1, -1):
        E = fraction @ (unit + E / k) if k < 9 else fraction
    for _ in range(8):
        E = 2 * E + E @ E
    return linear.solve((E + 2 * unit).T, E.T).T


# -- orbits --------------------------------------------------------------------------------------------


def orbit(
    take: Callable[..., tuple[Any, ...]],
    close: Callable[..., tuple[Any, ...]] | None,
    kinds: Sequence[str],
    n: int,
    z: Array,
    constants: Mapping[str, Any],
    stages: Mapping[str, Any],
    rows: int,
    every: int,
) -> Array:
    """States (rows + 1, d) at every `every` steps: `take` once for each stage, then `close`.

    By compiled kernels; by XLA where the step has a loop or is too long for them, or JAX not on the CPU.
    The reverse sweep keeps the states at the ends of about sqrt(every) parts, and the states of one part, made again.
    """
    names, entries = _named("c", constants)
    count = max((np.shape(v)[0] for v in stages.values()), default=1)
    pairs = [_named("s", {k: _entries(v)[i] for k, v in stages.items()}, fold=False) for i in range(count)]
    stage = adjoint.recorded(take, kinds, n, {**names, **pairs[0][0]})
    end = None if close is None else adjoint.recorded(close, kinds, n, names)
    code = adjoint.Code(stage, end, len(entries), len(pairs[0][1]))
    s = jnp.stack([values(row) for _, row in pairs])
    if code.straight and jax.default_backend() == "cpu":
        return jax_primitives.orbit(code, z, values(entries), s, rows, every)
    return rows_by_xla(code, z, [plain(v) for v in entries], s, rows, every)


def _named(letter: str, constants: Mapping[str, Any], fold: bool = True) -> tuple[dict[str, Any], list[Any]]:
    """Inputs of a graph in place of entries, and the entries; 0, 1, -1 and other kinds stay if they may `fold`."""
    names: dict[str, Any] = {}
    result: list[Any] = []
    graph = Graph()

    def named(entry: Any) -> Any:
        if fold and not isinstance(entry, Number) and float(entry) in adjoint.PLAIN:
            return float(entry)
        result.append(entry)
        return graph.input(letter, len(result) - 1)

    for key, value in constants.items():
        entries = _entries(value)
        numeric = not fold or entries.dtype.kind in "fO"
        names[key] = array_of([*map(named, entries.flat)]).reshape(entries.shape) if numeric else value
    return names, result


def _entries(x: Any) -> Array:
    return np.asarray(numbers(x) if isinstance(x, jax.Array) else x)


def orbit_of_arrays(
    take: Callable[..., tuple[Array, ...]],
    kinds: Sequence[str],
    n: int,
    z: Array,
    constants: Mapping[str, Any],
    rows: int,
    every: int,
) -> Array:
    """States (rows + 1, d) of a step of arrays of JAX."""
    arrays = {k: values(v) for k, v in constants.items()}

    def step(z: Array, constants: Mapping[str, Array]) -> Array:
        return algebra.flatten(take(*algebra.restore(z, kinds, n), **constants), kinds)

    return iterated(step, z, arrays, rows, every)
