"""Definitions on JAX: compiled motions as primitives, a number that is in NumPy's object arrays, and orbits of steps.

The primitives are an orbit, its tangent map (`push`), the transpose of that (`pull`), and products with the Hessian of
<g, rows> (`hvp`).  Each is linear in the arguments of its derivative, so JAX makes jvp, grad, vmap and scan of them.
Derivatives of higher order come from the orbit of a state and its tangent.  All arguments are rows of lanes:
z (l, d), c (l, constants), s (l, stages, of a stage); tangents and slopes have a second axis of columns.

Exact zeros and ones of numbers fold away as they do in a graph; a step, which may have a loop, is recorded as one.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction
from functools import partial
from math import isqrt
from typing import Any

import numpy as np
from jax.core import ShapedArray
from jax.extend.core import Primitive
from jax.interpreters import ad as differentiation, batching, mlir

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.algebra.backend import Ring
from kreisel.algebra.recorded import Recorded
from kreisel.errors import InputError
from kreisel.graph import graph as ops
from kreisel.graph.graph import Graph, array_of, evaluated, integer_power
from kreisel.kernels import adjoint
from kreisel.kernels.adjoint import Code, Part
from kreisel.method.scheme import Steps
from kreisel.reduction import numerics
from kreisel.reduction.numerics import jax, on_host, require_double

jnp = jax.numpy
ad: Any = differentiation
Struct: Any = jax.ShapeDtypeStruct
lax = jax.lax


def compiled_orbit(code: Code, z: Any, c: Any, s: Any, rows: int, every: int) -> Any:
    """Rows (rows + 1, d) at every `every` steps from z (d,), with constants c (count,) and s (stages, count)."""
    result, _ = orbit_p.bind(z[None], c[None], s[None], code=code, rows=rows, every=every, length=every)
    return jnp.concatenate([z[None], result[0]])


def _array(*shape: int) -> ShapedArray:
    return ShapedArray(shape, np.dtype(np.float64))


# -- their values, on the host -----------------------------------------------------------------------


def _orbit(z: Any, c: Any, s: Any, *, code: Code, rows: int, every: int, length: int) -> list[Any]:
    marks = code.marks(z, c, s, rows, every, length)
    parts = marks.shape[1] // rows
    return [marks[:, parts - 1 :: parts], marks]


def _orbit_shapes(z: Any, c: Any, s: Any, *, rows: int, every: int, length: int, **_: Any) -> list[Any]:
    lanes, d = z.shape
    return [_array(lanes, rows, d), _array(lanes, rows * -(-every // length), d)]


def _push(z: Any, c: Any, s: Any, dz: Any, *tangents: Any, code: Code, rows: int, every: int, **_: Any) -> list[Any]:
    dc, ds = tangents or (np.empty((*dz.shape[:2], 0)), np.empty((*dz.shape[:2], s.shape[1], 0)))
    return [code.pushed(z, c, s, dz, dc, ds, rows, every)]


def _push_shapes(*args: Any, rows: int, **_: Any) -> list[Any]:
    dz = args[4]
    return [_array(*dz.shape[:2], rows, dz.shape[2])]


def _pull(
    z: Any, c: Any, s: Any, marks: Any, g: Any, *, code: Code, every: int, length: int, wide: bool, **_: Any
) -> list[Any]:
    return list(code.pulled(z, c, s, marks, g, every, length, wide))[: 3 if wide else 1]


def _pull_shapes(z: Any, c: Any, s: Any, marks: Any, g: Any, *, wide: bool, **_: Any) -> list[Any]:
    lead = g.shape[:2]
    shapes = [_array(*lead, c.shape[1]), _array(*lead, *s.shape[1:])] if wide else []
    return [_array(*lead, z.shape[1]), *shapes]


# -- the same by XLA, for long steps ------------------------------------------------------------


def _looped(body: Callable[[Any], Sequence[Any]], start: Sequence[Any], small: float, most: int) -> list[Any]:
    """A loop until an improvement has settled; derivatives through it come from the implicit function theorem."""

    def improved(x: Any) -> tuple[Any, Any]:
        *new, defect = body([*x])
        return _stacked(new), jnp.asarray(defect)

    def settled(_: Any, x: Any) -> Any:
        def going(carry: tuple[Any, Any, Any]) -> Any:
            return (carry[2] < most) & ~(carry[1] <= small)

        def once(carry: tuple[Any, Any, Any]) -> tuple[Any, Any, Any]:
            return *improved(carry[0]), carry[2] + 1

        return lax.while_loop(going, once, (x, jnp.asarray(jnp.inf), 0))[0]

    def tangent(slope: Callable[[Any], Any], y: Any) -> Any:
        return numerics.solve(jax.jacfwd(slope)(jnp.zeros_like(y)), y[:, None])[:, 0]

    x = lax.custom_root(lambda x: x - improved(x)[0], lax.stop_gradient(_stacked(start)), settled, tangent)
    return [*x, lax.stop_gradient(improved(lax.stop_gradient(x))[1])]


def _stacked(values: Sequence[Any]) -> Any:
    return jnp.stack([jnp.asarray(v, dtype=jnp.float64) for v in values])


def _entry(*_: Any) -> Any:
    raise InputError(
        "kr.Table: expected derivatives of compiled steps, got a step that is too long for kernels. "
        "Write the values as a formula of t, or difference first derivatives."
    )


OPERATIONS: dict[str, Any] = ops.APPLIED | {
    **{name: getattr(jnp, name) for name in (ops.SQRT, *ops.TRANSCENDENTAL)},
    ops.FMA: lambda x, y, z: x * y + z,
    ops.SIGN: lambda x: jnp.where(x < 0, -1.0, 1.0),
    ops.MAX: jnp.maximum,
    ops.WHERE: lambda x, y, yes, no: jnp.where(x < y, yes, no),
    ops.NEAREST: jnp.round,
    ops.ENTRY: _entry,
    ops.LOOP: _looped,
}


def _on_jax(part: Part, places: Sequence[tuple[str, int]], fixed: Mapping[tuple[str, int], float]) -> Any:
    def function(*values: Any) -> tuple[Any, ...]:
        inputs = {**fixed, **dict(zip(places, values, strict=True))}
        new = evaluated(*part, lambda *place: inputs[place], OPERATIONS)
        return tuple(jnp.asarray(v, dtype=jnp.float64) for v in new)

    return with_jacobian(function)


def rows_by_xla(code: Code, z: Any, c: Sequence[Any], s: Any, rows: int, every: int) -> Any:
    """Rows (rows + 1, d).  Numbers c that are floats have no derivatives; s (stages, of a stage)."""
    fixed = {("c", i): v for i, v in enumerate(c) if isinstance(v, float)}
    moving = [("c", i) for i in range(len(c)) if ("c", i) not in fixed]
    letters = [*(("z", i) for i in range(code.dim)), *moving]
    stage, *close = (
        _on_jax(part, [*letters, *extra], fixed)
        for part, extra in zip(code.higher, ([("s", i) for i in range(s.shape[1])], []), strict=False)
    )

    def step(z: Any, constants: Any) -> Any:
        c, s = constants
        if len(s) == 1:
            z = jnp.stack(stage(*z, *c, *s[0]))
        else:
            z, _ = lax.scan(lambda z, row: (jnp.stack(stage(*z, *c, *row)), None), z, s)
        return jnp.stack(close[0](*z, *c)) if close else z

    return iterated(step, z, ([c[i] for _, i in moving], s), rows, every)


# -- second derivatives, by the code of a state and its tangent -----------------------------------------------


def _with_tangents(start: Sequence[Any], along: Sequence[Any]) -> list[Any]:
    """Rows (z, dz), and (c, dc) and (s, ds) if they have tangents."""
    return [jnp.concatenate([x, v], -1) for x, v in zip(start, along, strict=False)] + [*start[len(along) :]]


def _push_by_orbit(z: Any, c: Any, s: Any, _: Any, *along: Any, code: Code, wide: bool, **constants: Any) -> list[Any]:
    lanes, count = along[0].shape[:2]
    start = [jnp.repeat(x, count, axis=0) for x in (z, c, s)]
    start = _with_tangents(start, [v.reshape(lanes * count, *v.shape[2:]) for v in along])
    rows, _ = orbit_p.bind(*start, code=code.with_tangent(wide), **constants)
    return [rows[..., code.dim :].reshape(lanes, count, -1, code.dim)]


def _hvp_by_pull(z: Any, c: Any, s: Any, g: Any, *along: Any, code: Code, wide: bool, **constants: Any) -> list[Any]:
    """Slopes of <g, J v>, g (l, rows, d), by z, and by c and s if they have tangents in v: (l, ...)."""
    start, constants["code"] = _with_tangents((z, c, s), along), code.with_tangent(wide)
    _, marks = orbit_p.bind(*start, **constants)
    g = jnp.concatenate([jnp.zeros_like(g), g], -1)[:, None]
    slopes = pull_p.bind(*start, marks, g, wide=wide, **constants)
    return [v[:, 0, ..., : v.shape[-1] // 2] for v in slopes]


def _hvp_shapes(*args: Any, **_: Any) -> list[Any]:
    return [_array(*v.shape) for v in args[4:]]


# -- rules -----------------------------------------------------------------------------------------


def _by_host(host: Callable[..., list[Any]], shapes: Callable[..., Any], unread: int | None = None) -> Any:
    """A function of JAX by a function of NumPy arrays, which does not read the argument at the place `unread`."""

    def function(*args: Any, **constants: Any) -> list[Any]:
        read = [x for i, x in enumerate(args) if i != unread]
        out = [Struct(v.shape, v.dtype) for v in shapes(*args, **constants)]
        return list(on_host(lambda *arrays: host(*arrays, **constants), out, *read))

    return function


def _primitive(name: str, function: Callable[..., list[Any]], shapes: Callable[..., Any], *fixed: str) -> Any:
    primitive: Any = Primitive(name)
    primitive.multiple_results = True
    primitive.def_impl(jax.jit(function, static_argnames=("code", "rows", "every", "length", *fixed)))
    primitive.def_abstract_eval(shapes)
    mlir.register_lowering(primitive, mlir.lower_fun(function, multiple_results=True))
    return primitive


orbit_p = _primitive("kreisel_orbit", _by_host(_orbit, _orbit_shapes), _orbit_shapes)
push_p = _primitive("kreisel_push", _by_host(_push, _push_shapes, unread=3), _push_shapes, "wide")
pull_p = _primitive("kreisel_pull", _by_host(_pull, _pull_shapes), _pull_shapes, "wide")
hvp_p = _primitive("kreisel_hvp", _hvp_by_pull, _hvp_shapes, "wide")


def _is_zero(x: Any) -> bool:
    return type(x) is ad.Zero


def _orbit_jvp(at: Sequence[Any], along: Sequence[Any], **constants: Any) -> Any:
    constants["length"] = max(1, isqrt(constants["every"]))  # steps between two states that the reverse sweep keeps
    result, marks = orbit_p.bind(*at, **constants)
    wide = not (_is_zero(along[1]) and _is_zero(along[2]))
    columns = [ad.instantiate_zeros(v)[:, None] for v in along[: 3 if wide else 1]]
    (tangent,) = push_p.bind(*at, marks, *columns, wide=wide, **constants)
    return [result, marks], [tangent[:, 0], ad.Zero(jax.typeof(marks).to_tangent_aval())]


def _push_jvp(at: Sequence[Any], along: Sequence[Any], **constants: Any) -> Any:
    if all(_is_zero(v) for v in along[:3]):
        moving = [ad.instantiate_zeros(v) for v in along[4:]]
        return push_p.bind(*at, **constants), push_p.bind(*at[:4], *moving, **constants)
    moving = [i for i, v in enumerate(along) if not _is_zero(v) and i != 3]

    def by_orbit(*x: Any) -> list[Any]:
        return _push_by_orbit(*(x[moving.index(i)] if i in moving else v for i, v in enumerate(at)), **constants)

    return jax.jvp(by_orbit, tuple(at[i] for i in moving), tuple(along[i] for i in moving))


def _pull_jvp(at: Sequence[Any], along: Sequence[Any], *, wide: bool, **constants: Any) -> Any:
    value, terms = pull_p.bind(*at, wide=wide, **constants), []
    if not _is_zero(along[4]):
        terms.append(pull_p.bind(*at[:4], along[4], wide=wide, **constants))
    moving = [i for i in range(3) if not _is_zero(along[i])]
    if moving:
        wide = wide or moving != [0]
        *start, _, g = at
        columns = [ad.instantiate_zeros(v) for v in along[: 3 if wide else 1]]
        spread = [jnp.repeat(x, g.shape[1], axis=0) for x in (*start, *columns)]
        slopes = hvp_p.bind(*spread[:3], g.reshape(-1, *g.shape[2:]), *spread[3:], wide=wide, **constants)
        terms.append([v.reshape(x.shape) for v, x in zip(slopes, value, strict=False)])
    return value, [sum(slopes) for slopes in zip(*terms, strict=True)]


def _hvp_jvp(at: Sequence[Any], along: Sequence[Any], **constants: Any) -> Any:
    moving = [ad.instantiate_zeros(v) for v in along]
    if all(_is_zero(v) for v in along[:4]):
        return hvp_p.bind(*at, **constants), hvp_p.bind(*at[:4], *moving[4:], **constants)
    return jax.jvp(partial(_hvp_by_pull, **constants), tuple(at), tuple(moving))


def _hvp_transpose(slopes: Sequence[Any], *args: Any, **constants: Any) -> list[Any]:
    """Second derivatives are symmetric."""
    if all(map(_is_zero, slopes)):
        return [None] * len(args)
    result = hvp_p.bind(*args[:4], *map(ad.instantiate_zeros, slopes), **constants)
    return [None] * 4 + [v if ad.is_undefined_primal(x) else None for v, x in zip(result, args[4:], strict=True)]


def _push_transpose(slopes: Sequence[Any], *args: Any, **constants: Any) -> list[Any]:
    (g,) = slopes
    if _is_zero(g):
        return [None] * len(args)
    result = pull_p.bind(*args[:4], g, **constants)
    return [None] * 4 + [v if ad.is_undefined_primal(x) else None for v, x in zip(result, args[4:], strict=True)]


def _pull_transpose(slopes: Sequence[Any], *args: Any, **constants: Any) -> list[Any]:
    z, c, s, marks, g = args
    shapes = _pull_shapes(z, c, s, marks, g.aval, **constants)
    columns = [jnp.zeros(v.shape) if _is_zero(x) else x for x, v in zip(slopes, shapes, strict=True)]
    return [None] * 4 + push_p.bind(z, c, s, marks, *columns, **constants)


def _batched(primitive: Any, lanes: int) -> Callable[..., Any]:
    """More lanes where one of the first `lanes` arguments is a batch, else more columns."""

    def rule(args: Sequence[Any], places: Sequence[Any], **constants: Any) -> Any:
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

        arguments = [merged(x, p) if i in chosen else x for i, (x, p) in enumerate(zip(args, places, strict=True))]
        first, place = args[chosen[0]], places[chosen[0]]
        width = first.shape[to if place is None or place > to else to + 1]
        out = primitive.bind(*arguments, **constants)
        return [v.reshape((*v.shape[:to], size, width, *v.shape[to + 1 :])) for v in out], [to] * len(out)

    return rule


ad.primitive_jvps[orbit_p] = _orbit_jvp
ad.primitive_jvps[push_p] = _push_jvp
ad.primitive_jvps[pull_p] = _pull_jvp
ad.primitive_jvps[hvp_p] = _hvp_jvp
ad.primitive_transposes[push_p] = _push_transpose
ad.primitive_transposes[pull_p] = _pull_transpose
ad.primitive_transposes[hvp_p] = _hvp_transpose
batching.primitive_batchers[orbit_p] = _batched(orbit_p, 3)
batching.primitive_batchers[push_p] = _batched(push_p, 4)
batching.primitive_batchers[pull_p] = _batched(pull_p, 4)
batching.primitive_batchers[hvp_p] = _batched(hvp_p, 7)


def with_jacobian(function: Callable[..., tuple[Array, ...]]) -> Callable[..., tuple[Array, ...]]:
    """The function of scalars, differentiated by columns of its Jacobian, forward, scalar by scalar.

    XLA makes one kernel of that and twenty of the reverse sweep: 0.13 and 3.6 us a step of the Lagrange top's gradient.
    """
    wrapped = jax.custom_jvp(function)

    def rule(at: tuple[Array, ...], along: tuple[Any, ...]) -> tuple[tuple[Array, ...], tuple[Array, ...]]:
        moving = [i for i, v in enumerate(along) if not isinstance(v, jax.custom_derivatives.SymbolicZero)]
        value, total = None, None
        for i in moving:
            unit = tuple(jnp.asarray(float(i == j)) for j in range(len(at)))
            value, column = jax.jvp(function, at, unit)
            term = [v * along[i] for v in column]
            total = term if total is None else [a + b for a, b in zip(total, term, strict=True)]
        value = function(*at) if value is None else value
        return value, tuple(jnp.zeros_like(v) for v in value) if total is None else tuple(total)

    wrapped.defjvp(rule, symbolic_zeros=True)
    return wrapped


def iterated(step: Callable[[Array, Any], Array], z: Array, constants: Any, rows: int, every: int) -> Array:
    """Rows (rows + 1, d) of z -> step(z, constants)."""
    once = jax.checkpoint(step, prevent_cse=False)

    def several(z: Array, constants: Any, count: int) -> Array:
        return lax.scan(lambda z, _: (once(z, constants), None), z, length=count)[0]

    length = isqrt(every)
    parts, remainder = divmod(every, length)
    block = jax.checkpoint(lambda z, constants: several(z, constants, length), prevent_cse=False)

    def row(z: Array, _: None) -> tuple[Array, Array]:
        new, _ = lax.scan(lambda z, _: (block(z, constants), None), z, length=parts)
        new = several(new, constants, remainder) if remainder else new
        return new, new

    return jnp.concatenate([z[None], lax.scan(row, z, length=rows)[1]])


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
    return numerics.solve((E + 2 * unit).T, E.T).T


# -- orbits --------------------------------------------------------------------------------------------


def orbit(
    motion: Steps,
    kinds: Sequence[str],
    n: int,
    z: Array,
    constants: Mapping[str, Any],
    stages: Mapping[str, Any],
    rows: int,
    every: int,
    higher: Steps | None = None,
) -> Array:
    """States (rows + 1, d) at every `every` steps: `step` for each stage, then `close`; second derivatives by `higher`.

    By compiled kernels; by XLA where the step is too long for them, or JAX not on the CPU.
    The reverse sweep keeps the states at the ends of about sqrt(every) parts, and the states of one part, made again.
    """
    names, entries = _named("c", constants)
    count = max((np.shape(v)[0] for v in stages.values()), default=1)
    pairs = [_named("s", {k: _entries(v)[i] for k, v in stages.items()}, fold=False) for i in range(count)]

    def parts(steps: Steps) -> list[Part]:
        stage = adjoint.recorded(steps.step, kinds, n, {**names, **pairs[0][0]})
        return [stage] if steps.close is None else [stage, adjoint.recorded(steps.close, kinds, n, names)]

    code = adjoint.Code(parts(motion), len(entries), len(pairs[0][1]), partial(parts, higher) if higher else None)
    s = jnp.stack([values(row) for _, row in pairs])
    if code.compiled and jax.default_backend() == "cpu":
        return compiled_orbit(code, z, values(entries), s, rows, every)
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
