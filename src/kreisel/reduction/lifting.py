"""Functions of JAX arrays in the form of a record: NumPy in and out, any batch axes, dual values of the laws."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from typing import Any

import numpy as np

from kreisel.algebra import Array, objects
from kreisel.algebra.reuse import cached_property
from kreisel.errors import InputError, RunError
from kreisel.record.calling import Function
from kreisel.reduction.double import double, is_jax, jax, require_double

jnp = jax.numpy
LONGEST = 512  # lanes at once: batches are padded to 1 or to this, so that few shapes are compiled


def lifted(
    core: Callable[..., Any],
    axes: Sequence[int],
    keywords: Mapping[str, int | None],
    defaults: Mapping[str, Any] | None = None,
    trouble: str = "The result is not finite.",
) -> Function:
    """`core(*arrays, **keywords)` of JAX arrays, for the kinds of number of a record.

    axes       of each positional argument, without its batch
    keywords   letter -> axes without a batch axis, or None for a keyword that has no batch
    trouble    the message of the `RunError` for a result that is not finite although the input is

    JAX arrays are passed on unchanged, so `jax.grad`, `jax.vmap` and `jax.jit` see a pure function.
    """
    run = _Batched(core, tuple(axes), dict(keywords), trouble)
    absent = dict(defaults or {})

    def function(*args: Any, **options: Any) -> Any:
        constants = {**absent, **options}
        with double():
            if is_jax(*args, *constants.values()):
                require_double(*args, *constants.values())
                return core(*args, **constants)
            if any(np.asarray(a).dtype == object for a in args):
                return _on_duals(run, args, constants)
            return run(args, constants)

    kind, positional = inspect.Parameter.KEYWORD_ONLY, inspect.Parameter.POSITIONAL_ONLY
    wanted = [inspect.Parameter(f"z{i}", positional) for i in range(len(axes))]
    wanted += [inspect.Parameter(k, kind, default=absent.get(k, inspect.Parameter.empty)) for k in keywords]
    function.__signature__ = inspect.Signature(wanted)  # type: ignore[attr-defined]  # read by `contract.keywords`
    function.__doc__ = core.__doc__
    return function


class _Batched:
    def __init__(self, core: Callable[..., Any], axes: tuple[int, ...], keywords: dict[str, int | None], trouble: str):
        self.core, self.axes, self.keywords, self.trouble = core, axes, keywords, trouble
        self.compiled = cache(self._compiled)

    def _compiled(self, spread: frozenset[str]) -> Callable[..., Any]:
        def at_lane(args: Sequence[Array], constants: Mapping[str, Array]) -> Any:
            return self.core(*args, **constants)

        return jax.jit(jax.vmap(at_lane, in_axes=(0, {k: 0 if k in spread else None for k in self.keywords})))

    @cached_property
    def pushed(self) -> Callable[..., Any]:
        """Value and derivatives along each of the directions (count, size of all arguments)."""

        def along(values: Sequence[Array], constants: Mapping[str, Array], directions: Array) -> Any:
            edges, shapes = np.cumsum([v.size for v in values])[:-1], [v.shape for v in values]

            def push(direction: Array) -> Any:
                parts = [p.reshape(s) for p, s in zip(jnp.split(direction, edges), shapes, strict=True)]
                return jax.jvp(lambda *z: self.core(*z, **constants), tuple(values), tuple(parts))

            return jax.vmap(push, out_axes=(None, -1))(directions)

        return jax.jit(along)

    def __call__(self, args: Sequence[Any], constants: Mapping[str, Any]) -> Any:
        args = [np.asarray(a, dtype=np.float64) for a in args]
        constants = {k: np.asarray(v, dtype=np.float64) for k, v in constants.items()}
        axes = {k: v.ndim if self.keywords[k] is None else self.keywords[k] for k, v in constants.items()}
        batch = np.broadcast_shapes(
            *(a.shape[: a.ndim - n] for a, n in zip(args, self.axes, strict=True)),
            *(v.shape[: v.ndim - axes[k]] for k, v in constants.items()),
        )
        lanes = [_as_lanes(a, n, batch) for a, n in zip(args, self.axes, strict=True)]
        spread = frozenset(k for k, v in constants.items() if v.ndim > axes[k])
        constants = {k: _as_lanes(v, axes[k], batch) if k in spread else v for k, v in constants.items()}
        count, out = int(np.prod(batch)), []
        size = 1 if count == 1 else LONGEST
        for start in range(0, count, size):
            places = np.minimum(np.arange(start, start + size), count - 1)
            piece = {k: v[places] if k in spread else v for k, v in constants.items()}
            out.append(jax.tree.map(np.asarray, self.compiled(spread)([a[places] for a in lanes], piece)))
        result = jax.tree.map(lambda *parts: np.concatenate(parts)[:count].reshape(batch + parts[0].shape[1:]), *out)
        if not all(np.isfinite(v).all() for v in jax.tree.leaves(result)) and all(np.isfinite(a).all() for a in args):
            raise RunError(self.trouble)
        return jax.tree.map(lambda v: v[()] if v.ndim == 0 else v, result)


def _as_lanes(a: Array, axes: Any, batch: tuple[int, ...]) -> Array:
    shape = a.shape[a.ndim - axes :]
    return np.broadcast_to(a, batch + shape).reshape((-1, *shape))


def _on_duals(run: _Batched, args: Sequence[Any], constants: Mapping[str, Any]) -> Any:
    """The chain rule: values and derivatives by JAX, slopes from the dual values."""
    flat = np.concatenate([np.asarray(a, dtype=object).ravel() for a in args])
    some = next((v for v in flat if hasattr(v, "slope")), None)
    if not all(isinstance(getattr(v, "value", v), int | float | np.number) for v in flat):
        raise InputError(
            "Functions of kreisel.reduction accept floats, got rationals. Use numbers=('float',) in the laws."
        )
    values = [np.vectorize(lambda v: getattr(v, "value", v), otypes=[float])(a) for a in args]
    if some is None:
        return run(values, constants)
    slopes = np.array([getattr(v, "slope", 0 * some.slope) for v in flat], dtype=np.float64)
    constants = {k: np.asarray(v, dtype=np.float64) for k, v in constants.items()}
    out, rates = run.pushed(values, constants, slopes.T)

    def duals(value: Any, rate: Any) -> Any:
        value, rate = np.asarray(value), np.asarray(rate).astype(object)
        pairs = (type(some)(float(value[place]), rate[place]) for place in np.ndindex(value.shape))
        return objects(pairs, value.shape)[()]

    return jax.tree.map(duals, out, rates)
