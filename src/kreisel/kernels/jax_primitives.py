"""Compiled motions as primitives of JAX: an orbit, its tangent map (`push`) and the transpose of that (`pull`).

Each is linear in what it is differentiated by, so that JAX makes jvp, grad, vmap and scan of them; derivatives of the
second order are those of the same record by XLA.  All arguments are rows of lanes: z (l, d), c (l, constants),
s (l, stages, of a stage); tangents and slopes have a second axis of columns.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import isqrt
from typing import Any

import numpy as np
from jax.core import ShapedArray
from jax.extend.core import Primitive
from jax.interpreters import ad as differentiation
from jax.interpreters import batching, mlir

from kreisel.algebra import Array
from kreisel.kernels.adjoint import Code, Record, part_of
from kreisel.kernels.tape import TRANSCENDENTAL
from kreisel.reduction.double import jax, on_host

jnp = jax.numpy
ad: Any = differentiation
Struct: Any = jax.ShapeDtypeStruct
lax = jax.lax
FUNCTIONS: dict[str, Any] = {
    **{name: getattr(jnp, name) for name in ("sqrt", *TRANSCENDENTAL)},
    "fma": lambda x, y, z: x * y + z,
    "sign": lambda x: jnp.where(x < 0, -1.0, 1.0),
    "max": jnp.maximum,
}


def orbit(code: Code, z: Any, c: Any, s: Any, rows: int, every: int) -> Any:
    """Rows (rows + 1, d) at every so many steps from z (d,), with constants c (count,) and s (stages, count)."""
    found, _ = orbit_p.bind(z[None], c[None], s[None], code=code, rows=rows, every=every, part=every)
    return jnp.concatenate([z[None], found[0]])


def _array(*shape: int) -> ShapedArray:
    return ShapedArray(shape, np.dtype(np.float64))


# -- what they compute -----------------------------------------------------------------------------


def _orbit_shapes(z: Any, c: Any, s: Any, *, code: Code, rows: int, every: int, part: int) -> list[Any]:
    lanes, d = z.shape
    return [_array(lanes, rows, d), _array(lanes, rows * -(-every // part), d)]


def _orbit(z: Any, c: Any, s: Any, *, code: Code, rows: int, every: int, part: int) -> list[Any]:
    def host(z: Any, c: Any, s: Any) -> Any:
        marks = code.marks(z, c, s, rows, every, part)
        parts = marks.shape[1] // rows
        return [np.ascontiguousarray(marks[:, parts - 1 :: parts]), marks]

    shapes = _orbit_shapes(z, c, s, code=code, rows=rows, every=every, part=part)
    return list(on_host(host, [Struct(v.shape, v.dtype) for v in shapes], z, c, s))


def _push_shapes(*args: Any, rows: int, **_: Any) -> list[Any]:
    dz = args[4]
    return [_array(*dz.shape[:2], rows, dz.shape[2])]


def _push(*args: Any, code: Code, rows: int, every: int, part: int, wide: bool) -> list[Any]:
    z, c, s, _, dz, *more = args
    shape = Struct((*dz.shape[:2], rows, code.dim), dz.dtype)

    def host(z: Any, c: Any, s: Any, dz: Any, *more: Any) -> Any:
        dc, ds = more or (np.empty((*dz.shape[:2], 0)), np.empty((*dz.shape[:2], s.shape[1], 0)))
        return [code.pushed(z, c, s, dz, dc, ds, rows, every)]

    return list(on_host(host, [shape], z, c, s, dz, *more))


def _pull_shapes(z: Any, c: Any, s: Any, marks: Any, g: Any, *, wide: bool, **_: Any) -> list[Any]:
    lead = g.shape[:2]
    more = [_array(*lead, c.shape[1]), _array(*lead, *s.shape[1:])] if wide else []
    return [_array(*lead, z.shape[1]), *more]


def _pull(*args: Any, code: Code, rows: int, every: int, part: int, wide: bool) -> list[Any]:
    shapes = [Struct(v.shape, v.dtype) for v in _pull_shapes(*args, wide=wide)]

    def host(z: Any, c: Any, s: Any, marks: Any, g: Any) -> Any:
        return list(code.pulled(z, c, s, marks, g, every, part, wide))[: len(shapes)]

    found = on_host(host, shapes, *args)
    return list(found)


# -- the same by XLA, for derivatives of higher order ---------------------------------------------------


def _on_jax(record: Record, sizes: Sequence[int]) -> Callable[..., Any]:
    """The record as a function of scalars of JAX."""
    names = [f"{letter}{i}" for letter, size in zip("zcs", sizes, strict=True) for i in range(size)]

    def function(*values: Any) -> tuple[Any, ...]:
        known = {**FUNCTIONS, **dict(zip(names, values, strict=True))}
        for line in record.lines:
            exec(line.text, known)
        return tuple(jnp.asarray(eval(v, known), dtype=jnp.float64) for v in record.new)

    return function


def _rows_by_xla(code: Code, z: Any, c: Any, s: Any, rows: int, every: int) -> Any:
    stage = with_jacobian(_on_jax(code.stage, code.sizes))
    close = None if code.close is None else with_jacobian(_on_jax(code.close, (*code.sizes[:2], 0)))

    def step(z: Any, constants: Any) -> Any:
        c, s = constants
        z, _ = lax.scan(lambda z, row: (jnp.stack(stage(*z, *c, *row)), None), z, s)
        return z if close is None else jnp.stack(close(*z, *c))

    return iterated(step, z, (c, s), rows, every)[1:]


def _push_by_xla(*args: Any, code: Code, rows: int, every: int, part: int, wide: bool) -> list[Any]:
    z, c, s, _, *along = args

    def lane(z: Any, c: Any, s: Any, *along: Any) -> Any:
        at, function = _moving(code, z, c, s, rows, every, wide)
        return jax.vmap(lambda *along: jax.jvp(function, at, along)[1])(*along)

    return [jax.vmap(lane)(z, c, s, *along)]


def _pull_by_xla(*args: Any, code: Code, rows: int, every: int, part: int, wide: bool) -> list[Any]:
    def lane(z: Any, c: Any, s: Any, g: Any) -> Any:
        at, function = _moving(code, z, c, s, rows, every, wide)
        return jax.vmap(jax.vjp(function, *at)[1])(g)

    z, c, s, _, g = args
    return list(jax.vmap(lane)(z, c, s, g))


def _moving(code: Code, z: Any, c: Any, s: Any, rows: int, every: int, wide: bool) -> tuple[Any, Callable[..., Any]]:
    """What is differentiated by, and the rows as a function of it: a column of a derivative costs XLA some seconds."""
    if wide:
        return (z, c, s), lambda z, c, s: _rows_by_xla(code, z, c, s, rows, every)
    return (z,), lambda z: _rows_by_xla(code, z, c, s, rows, every)


# -- rules -----------------------------------------------------------------------------------------


def _primitive(name: str, function: Callable[..., Any], shapes: Callable[..., Any], *fixed: str) -> Any:
    made: Any = Primitive(name)
    made.multiple_results = True
    made.def_impl(jax.jit(function, static_argnames=("code", "rows", "every", "part", *fixed)))
    made.def_abstract_eval(shapes)
    mlir.register_lowering(made, mlir.lower_fun(function, multiple_results=True))
    return made


orbit_p = _primitive("kreisel_orbit", _orbit, _orbit_shapes)
push_p = _primitive("kreisel_push", _push, _push_shapes, "wide")
pull_p = _primitive("kreisel_pull", _pull, _pull_shapes, "wide")


def _is_zero(x: Any) -> bool:
    return type(x) is ad.Zero


def _orbit_jvp(at: Sequence[Any], along: Sequence[Any], **known: Any) -> Any:
    known["part"] = part_of(known["every"])
    found, marks = orbit_p.bind(*at, **known)
    wide = not (_is_zero(along[1]) and _is_zero(along[2]))
    columns = [ad.instantiate_zeros(v)[:, None] for v in along[: 3 if wide else 1]]
    (tangent,) = push_p.bind(*at, marks, *columns, wide=wide, **known)
    return [found, marks], [tangent[:, 0], ad.Zero(jax.typeof(marks).to_tangent_aval())]


def _linear_jvp(own: Any, count: int, by_xla: Callable[..., Any]) -> Callable[..., Any]:
    """The rule of a primitive that is linear in its arguments from `count` on; `by_xla` where another moves."""

    def rule(at: Sequence[Any], along: Sequence[Any], **known: Any) -> Any:
        value = own.bind(*at, **known)
        if all(_is_zero(v) for v in along[:3]):
            moving = [ad.instantiate_zeros(v) for v in along[count:]]
            return value, own.bind(*at[:count], *moving, **known)
        moving = [i for i, v in enumerate(along) if not _is_zero(v) and i != 3]

        def by_moving(*x: Any) -> list[Any]:
            found = by_xla(*(x[moving.index(i)] if i in moving else v for i, v in enumerate(at)), **known)
            return list(found)

        return value, jax.jvp(by_moving, tuple(at[i] for i in moving), tuple(along[i] for i in moving))[1]

    return rule


def _push_transpose(slopes: Sequence[Any], *args: Any, **known: Any) -> list[Any]:
    (g,) = slopes
    if _is_zero(g):
        return [None] * len(args)
    found = pull_p.bind(*args[:4], g, **known)
    return [None] * 4 + [v if ad.is_undefined_primal(x) else None for v, x in zip(found, args[4:], strict=True)]


def _pull_transpose(slopes: Sequence[Any], *args: Any, **known: Any) -> list[Any]:
    z, c, s, marks, g = args
    shapes = _pull_shapes(z, c, s, marks, g.aval, **known)
    columns = [jnp.zeros(v.shape) if _is_zero(x) else x for x, v in zip(slopes, shapes, strict=True)]
    return [None] * 4 + push_p.bind(z, c, s, marks, *columns, **known)


def _batched(own: Any, lanes: int) -> Callable[..., Any]:
    """More lanes where one of the first `lanes` arguments is a batch, else more columns."""

    def rule(args: Sequence[Any], places: Sequence[Any], **known: Any) -> Any:
        size = next(x.shape[p] for x, p in zip(args, places, strict=True) if p is not None)
        if any(p is not None for p in places[:lanes]):
            to, chosen = 0, range(len(args))
        else:
            to, chosen = 1, range(lanes, len(args))

        def merged(x: Any, p: Any) -> Any:
            if p is None:
                many = jnp.broadcast_to(jnp.expand_dims(x, to), (*x.shape[:to], size, *x.shape[to:]))
            else:
                many = jnp.moveaxis(x, p, to)
            return many.reshape((*many.shape[:to], size * many.shape[to + 1], *many.shape[to + 2 :]))

        given = [merged(x, p) if i in chosen else x for i, (x, p) in enumerate(zip(args, places, strict=True))]
        out = own.bind(*given, **known)
        return [v.reshape((*v.shape[:to], size, v.shape[to] // size, *v.shape[to + 1 :])) for v in out], [to] * len(out)

    return rule


ad.primitive_jvps[orbit_p] = _orbit_jvp
ad.primitive_jvps[push_p] = _linear_jvp(push_p, 4, _push_by_xla)
ad.primitive_jvps[pull_p] = _linear_jvp(pull_p, 4, _pull_by_xla)
ad.primitive_transposes[push_p] = _push_transpose
ad.primitive_transposes[pull_p] = _pull_transpose
batching.primitive_batchers[orbit_p] = _batched(orbit_p, 3)
batching.primitive_batchers[push_p] = _batched(push_p, 4)
batching.primitive_batchers[pull_p] = _batched(pull_p, 4)


def with_jacobian(function: Callable[..., tuple[Array, ...]]) -> Callable[..., tuple[Array, ...]]:
    """The same function of scalars, differentiated by columns of its Jacobian, forward, scalar by scalar.

    XLA makes one kernel of that and twenty of the reverse sweep: 0.13 and 3.6 us a step of the Lagrange top's gradient.
    """
    wrapped = jax.custom_jvp(function)

    def rule(at: tuple[Array, ...], along: tuple[Any, ...]) -> tuple[tuple[Array, ...], tuple[Array, ...]]:
        moving = [i for i, v in enumerate(along) if not isinstance(v, jax.custom_derivatives.SymbolicZero)]
        value, total = None, None
        for i in moving:
            unit = tuple(jnp.asarray(float(i == j)) for j in range(len(at)))
            value, column = jax.jvp(function, at, unit)
            part = [v * along[i] for v in column]
            total = part if total is None else [a + b for a, b in zip(total, part, strict=True)]
        value = function(*at) if value is None else value
        return value, tuple(jnp.zeros_like(v) for v in value) if total is None else tuple(total)

    wrapped.defjvp(rule, symbolic_zeros=True)
    return wrapped


def iterated(step: Callable[[Array, Any], Array], z: Array, constants: Any, rows: int, every: int) -> Array:
    """Rows (rows + 1, d) of z -> step(z, constants)."""
    once = jax.checkpoint(step, prevent_cse=False)

    def several(z: Array, constants: Any, count: int) -> Array:
        return lax.scan(lambda z, _: (once(z, constants), None), z, length=count)[0]

    part = isqrt(every)
    parts, rest = divmod(every, part)
    block = jax.checkpoint(lambda z, constants: several(z, constants, part), prevent_cse=False)

    def row(z: Array, _: None) -> tuple[Array, Array]:
        new, _ = lax.scan(lambda z, _: (block(z, constants), None), z, length=parts)
        new = several(new, constants, rest) if rest else new
        return new, new

    return jnp.concatenate([z[None], lax.scan(row, z, length=rows)[1]])
