"""A user's Lagrangian as a record that `kr.simulate`, the laws and the command line read."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from typing import Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array, invariants, objects
from kreisel.algebra.reuse import cached_property
from kreisel.errors import InputError, RunError, explained, shown
from kreisel.record.calling import Function, Portable, naming
from kreisel.record.contract import Checks, Frame, Map, Parameter, PhaseSpace, System
from kreisel.reduction.equations import Continuous, Discrete, as_frame, symmetric_rule
from kreisel.reduction.groups import Group, Representation, quadratic_casimirs, standard
from kreisel.reduction.numerics import double, is_jax, jax, require_double

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


# -- requirements on a Lagrangian, checked before the first step ------------------------------------

SAMPLE_STEP = 0.01
SINGULAR = 1e-12
TRACING = (
    jax.errors.TracerArrayConversionError,
    jax.errors.TracerBoolConversionError,
    jax.errors.ConcretizationTypeError,
    jax.errors.TracerIntegerConversionError,
)


def check_lagrangian(record: Any, constants: Mapping[str, Any]) -> None:
    """Real, scalar, differentiable and with an invertible Legendre transform at a random point; else `InputError`."""
    rng = np.random.default_rng(3)
    with double():
        P = jnp.asarray(rng.uniform(0.2, 1, record.rep.dim))
        zero = jnp.zeros(record.group.dim)
        if record.continuous_lagrangian is not None:
            inner = record.continuous(constants)
            _check(inner.value, inner.momentum, zero, P, "L(Omega, P)", "Omega = 0")
        if record.discrete_lagrangian is not None:
            inner = record.discrete({**constants, "eps": SAMPLE_STEP})

            def value(x: Array, P: Array) -> Array:
                return inner.value(record.group.retract(x), P)

            def before(x: Array, P: Array) -> Array:
                return inner.before(record.group.retract(x), P)

            _check(value, before, zero, P, "Lambda(W, P)", "W = I")


def _check(value: Callable[..., Any], momentum: Callable[..., Any], x: Array, P: Array, name: str, where: str) -> None:
    out = _tried(lambda: jax.eval_shape(value, x, P), name)
    shape = getattr(out, "shape", None)
    if shape != () or not jnp.issubdtype(out.dtype, jnp.floating):
        got = f"shape {shape}, {out.dtype}" if shape is not None else repr(out)
        raise InputError(
            f"The Lagrangian {name} must give one real number, got {got}. Usual cause: a missing sum, trace or .real."
        )
    M, slope = _tried(jax.jit(lambda: (momentum(x, P), jax.jacfwd(momentum)(x, P))), name)
    if not (np.isfinite(M).all() and np.isfinite(slope).all()):
        raise InputError(
            f"The Lagrangian {name} must be twice differentiable; its derivatives are not finite at {where}. "
            "Usual cause: a norm or a square root at 0, a logarithm of 0, or 1/eps without eps."
        )
    values = np.linalg.svd(np.asarray(slope), compute_uv=False)
    if not values[-1] > SINGULAR * max(values[0], 1e-300):
        raise InputError(
            f"The Legendre transform of {name} is singular at {where}: the second derivatives have the singular values "
            f"{np.array2string(values, precision=3)}. Usual cause: a direction without kinetic energy (a moment of "
            "inertia that is 0), or values that JAX does not see (plain NumPy, round, sign)."
        )


def _tried(function: Callable[[], Any], name: str) -> Any:
    try:
        return function()
    except TRACING as error:
        raise InputError(
            f"The Lagrangian {name} cannot be differentiated: {str(error).splitlines()[0]} "
            "Usual cause: numpy for jax.numpy, float(...), or an `if` on a value; use jax.numpy and jnp.where."
        ) from error
    except (TypeError, ValueError, IndexError, AttributeError, ZeroDivisionError) as error:
        raise InputError(
            f"The Lagrangian {name} failed: {error} "
            "Usual cause: shapes that do not fit, or a wrong number of arguments; constants are keyword-only."
        ) from error


# -- records ---------------------------------------------------------------------------------------

BRANCH = (
    "The implicit equation of the step has no solution on the branch with the continuous limit. "
    "Usual cause: dt too long for this state, or a Legendre transform that is singular there. Use a smaller dt."
)
LEGENDRE = (
    "The Legendre transform M = grad_Omega L(Omega, P) has no inverse on the branch of Omega = 0 at this state. "
    "Usual cause: a kinetic energy that is not convex in Omega, or a momentum out of its range."
)


@explained
def system(
    name: str,
    *,
    group: Group,
    lagrangian: Callable[..., Any] | None = None,
    discrete: Callable[..., Any] | None = None,
    representation: Representation | None = None,
    frame: str | Frame = Frame.MOVING,
    parameters: Sequence[Parameter] = (),
    integrals: Mapping[str, Function] | None = None,
    conserved: Sequence[str] = (),
    order: int | None = None,
    title: str = "",
    source: str = "a user-defined Lagrangian",
) -> System:
    """A system from a continuous Lagrangian, a discrete one, or both.

    lagrangian      L(Omega, P) in the moving frame, L(omega, a) in the rest frame: an algebra element (N, N) and a
                    point of V; constants of the system are keyword-only: `def L(Omega, P, *, J, A)`
    discrete        Lambda(W, P) or Lambda(w, a), W a group element (N, N); constants and the step `eps` keyword-only.
                    Without it `symmetric_rule` discretizes the continuous Lagrangian (order 2)
    group           `SO(3)`, `SU2()`, `SE3()`, `product(...)`, `matrix_group(basis)`
    representation  on V: `standard(group)` (default), `adjoint(group)`, `trivial(group)` (then a Lagrangian of only
                    Omega or W), `representation(group, Phi, dim)`
    frame           "moving": state (M, P), plus bracket; "rest": state (m, a), minus bracket
    parameters      `Parameter` records, for more than a letter; other parameters may be arrays of any shape
    integrals       name -> function(*state, *, constants) in JAX, watched along a run; names in `conserved` are claims
                    of conservation by the map, tested by `kr.drift` and the laws
    order           of the discrete Lagrangian, tested by a law if both Lagrangians are given

    Lagrangians are written with jax.numpy and must be real, scalar and differentiable.  A call of the record with
    parameters checks this.  Raises `InputError`.
    """
    stated: dict[str, Any] = dict(locals())
    stated |= {"lagrangian": Portable(lagrangian), "discrete": Portable(discrete)}
    stated["integrals"] = {key: Portable(function) for key, function in dict(integrals or {}).items()}
    if lagrangian is None and discrete is None:
        raise InputError("A system needs a Lagrangian: give lagrangian=L(Omega, P), discrete=Lambda(W, P), or both.")
    rep = standard(group) if representation is None else representation
    if not rep.group.same(group):
        raise InputError(
            f"representation: expected one of the group {group.name}, got one of {rep.group.name}, whose basis or "
            f"retraction is another. Make both from the same group: red.standard(G), red.trivial(G), group=G."
        )
    if odd := [key for key, function in dict(integrals or {}).items() if not callable(function)]:
        raise InputError(
            f"integrals: expected functions of the state, got {shown((integrals or {})[odd[0]])} as {odd[0]}."
        )
    if strange := [p for p in parameters if not isinstance(p, Parameter)]:
        raise InputError(
            f"parameters: expected records such as red.Parameter('J', 'vector', '...'), got {shown(strange[0])}."
        )
    if lagrangian is not None and "eps" in inspect.signature(lagrangian).parameters:
        raise InputError("lagrangian: expected L(Omega, P) without eps, the step: only discrete=Lambda(W, P) has one.")
    record = _Record(rep, as_frame(frame), lagrangian, discrete, {p.letter: p for p in parameters})
    result = record.system(name, title or name, source, dict(integrals or {}), tuple(conserved), order)
    return result.remade_by(_again, stated)


def _again(stated: Mapping[str, Any]) -> System:
    plain = {key: value.function if isinstance(value, Portable) else value for key, value in stated.items()}
    return system(**{**plain, "integrals": {key: f.function for key, f in stated["integrals"].items()}})


def lagrangian_constants(function: Callable[..., Any] | None) -> dict[str, Any]:
    """The keyword-only arguments of a Lagrangian and their defaults, without eps."""
    if function is None:
        return {}
    listed = inspect.signature(function).parameters.values()
    return {p.name: p.default for p in listed if p.kind is p.KEYWORD_ONLY and p.name != "eps"}


class _Record:
    """Group, representation and Lagrangians, which the functions of the record share."""

    def __init__(
        self,
        rep: Representation,
        frame: Frame,
        lagrangian: Callable[..., Any] | None,
        discrete: Callable[..., Any] | None,
        stated: Mapping[str, Parameter],
    ):
        self.rep, self.frame, self.continuous_lagrangian, self.discrete_lagrangian = rep, frame, lagrangian, discrete
        self.group = rep.group
        self.rotations = rep.group.skew and rep.name == "standard"  # e(n): the orientation can also be integrated
        self.spaces = (self.group.dual, rep.space)[: 2 if rep.dim else 1]
        defaults = {**lagrangian_constants(lagrangian), **lagrangian_constants(discrete)}
        meaning, absent = "a constant of the Lagrangian", inspect.Parameter.empty
        arrays = {k: None if v is absent else np.asarray(v) for k, v in defaults.items()}
        self.parameters = tuple(stated.get(k, Parameter(k, "array", meaning, default=v)) for k, v in arrays.items())
        for letter in stated:
            if letter not in defaults:
                raise InputError(
                    f"No Lagrangian has the parameter {shown(letter)}; their parameters are "
                    f"{', '.join(defaults) or 'none'}."
                )
        self.axes = [algebra.KINDS[s.kind].axes for s in self.spaces]
        self.keywords = {p.letter: p.axes for p in self.parameters}

    # the Lagrangians with their constants filled in

    def _bound(self, function: Callable[..., Any], constants: Mapping[str, Any]) -> Callable[..., Any]:
        mine = lagrangian_constants(function)
        if "eps" in inspect.signature(function).parameters:
            mine["eps"] = None
        constants = {k: jnp.asarray(constants[k]) for k in mine}
        if self.rep.dim:
            return lambda first, P: function(first, P, **constants)
        return lambda first, P: function(first, **constants)

    def continuous(self, constants: Mapping[str, Any]) -> Continuous:
        if self.continuous_lagrangian is None:
            raise InputError("Only a discrete Lagrangian was given; this needs the continuous one: lagrangian=...")
        return Continuous(self._bound(self.continuous_lagrangian, constants), self.rep, self.frame)

    def discrete(self, constants: Mapping[str, Any]) -> Discrete:
        if self.discrete_lagrangian is None:
            return symmetric_rule(self.continuous(constants), constants["eps"])
        return Discrete(self._bound(self.discrete_lagrangian, constants), self.rep, self.frame)

    # states in the user's form, and as coordinates

    def coordinates(self, state: Sequence[Array]) -> list[Array]:
        parts = [s.coordinates(z) for s, z in zip(self.spaces, state, strict=True)]
        return parts if self.rep.dim else [*parts, jnp.zeros(0)]

    def shown(self, parts: Sequence[Array]) -> tuple[Array, ...]:
        return tuple(s.array(z) for s, z in zip(self.spaces, parts, strict=False))

    # the functions of the record

    def of(self, side: Callable[..., Any], name: str, shown: Callable[[Any], Any]) -> Callable[..., Any]:
        """A function of `continuous` or `discrete`, of states in the user's form."""
        return lambda *state, **constants: shown(getattr(side(constants), name)(*self.coordinates(state)))

    def generator(self, *old_and_new: Array, **constants: Any) -> Array:
        """X with W = cay(X), from the old state."""
        W = self.discrete(constants).turn(*self.coordinates(old_and_new[: len(self.spaces)]))
        unit = jnp.eye(self.group.size)
        X = algebra.solve(W + unit, W - unit)
        return (X - X.T) / 2

    def unreduced(self, g: Array, h: Array, carried: Array, **constants: Any) -> Array:
        """LL(g, h; p or A) = Lambda(g^-1 h, Phi(g^-1) p), Lambda(h g^-1, Phi(g) A)."""
        inner, inverse = self.discrete(constants), self.group.inverse(g)
        v = self.rep.space.coordinates(carried) if self.rep.dim else jnp.zeros(0)
        moving = self.frame is Frame.MOVING
        return inner.value(inverse @ h if moving else h @ inverse, self.rep.act(inverse if moving else g, v))

    def regularity(self, *state: Array, **constants: Any) -> Array:
        inner, (_, P) = self.discrete(constants), self.coordinates(state)
        slope = jax.jacfwd(lambda x: inner.before(self.group.retract(x), P))(jnp.zeros(self.group.dim))
        values = jnp.linalg.svd(slope, compute_uv=False)
        return values[-1] / jnp.maximum(values[0], 1e-300)

    def check(self, **constants: Any) -> None:
        """Check the Lagrangians at these constants, for the first lane of an ensemble."""
        axes = self.keywords
        # every constant has an axis of lanes
        lanes = max((v.ndim - axes[k] for k, v in constants.items() if axes[k] is not None), default=0)
        first = {k: v[(0,) * lanes] for k, v in constants.items()}
        check_lagrangian(self, first)

    def lift(
        self, core: Callable[..., Any], axes: Sequence[int] | None = None, eps: bool = False, **options: Any
    ) -> Any:
        keywords = {**self.keywords, **({"eps": None} if eps else {})}
        return lifted(core, self.axes if axes is None else axes, keywords, **options)

    def space(self) -> PhaseSpace:
        letters = ("M", "P") if self.frame is Frame.MOVING else ("m", "a")
        sign = 1 if self.frame is Frame.MOVING else -1
        rep = self.rep

        def tensor(*state: Array) -> Array:
            parts = [s.coordinates(z) for s, z in zip(self.spaces, state, strict=True)]
            return sign * rep.tensor(parts[0], parts[1] if rep.dim else parts[0][..., :0])

        Q: Any = [] if self.rotations else quadratic_casimirs(rep)  # found numerically

        def casimirs(*state: Array) -> Array:
            library = np if isinstance(state[0], np.ndarray) else jnp
            z = library.concatenate([s.coordinates(x) for s, x in zip(self.spaces, state, strict=True)], -1)
            return library.stack([((z @ form) * z).sum(-1) for form in Q], -1)

        dual = f"{self.group.name.lower()}*" if not rep.dim else f"({self.group.name.lower()} <x V)*, dim V = {rep.dim}"
        return PhaseSpace(
            name=f"e*({self.group.n})" if self.rotations else dual,
            components=tuple((k, s.kind) for k, s in zip(letters, self.spaces, strict=False)),
            tensor=tensor,
            casimirs=invariants.casimirs if self.rotations else casimirs if len(Q) else None,
            sign=sign,
            carried=tuple(range(1, len(self.spaces))),
        )

    def map(self, source: str, conserved: tuple[str, ...], order: int | None) -> Map:
        axes, carried = [*self.axes, *self.axes], [algebra.KINDS[self.rep.space.kind].axes]
        step: dict[str, Any] = {"eps": True, "trouble": BRANCH}
        inverse = self.lift(self.of(self.discrete, "inverse", self.shown), **step)
        return Map(
            step=self.lift(self.of(self.discrete, "step", self.shown), **step),
            inverse=inverse,
            generator=self.lift(self.generator, axes, **step) if self.rotations else None,
            lagrangian=self.lift(self.unreduced, [2, 2, *carried], eps=True) if self.rotations else None,
            regularity=self.lift(self.regularity, eps=True),
            conserves=conserved,
            order=order if order is not None else (1 if self.discrete_lagrangian is not None else 2),
            source=source if self.discrete_lagrangian is not None else f"{source}, by the symmetric rule",
        )

    def system(
        self,
        name: str,
        title: str,
        source: str,
        integrals: dict[str, Function],
        conserved: tuple[str, ...],
        order: int | None,
    ) -> System:
        has_flow = self.continuous_lagrangian is not None
        for k in conserved:
            if k not in ("energy", *integrals):
                raise InputError(f"conserved: expected names of {', '.join(('energy', *integrals))}, got {shown(k)}.")
        moving = self.frame is Frame.MOVING
        flow = (
            "M' = ad*_Omega M + grad_P L <> P, P' = -phi(Omega) P",
            "m' = -ad*_omega m - grad_a L <> a, a' = phi(omega) a",
        )
        step = (
            "Ad*_(W^-1) M_(k+1) = M_k + grad_P Lambda <> P_k, P_(k+1) = Phi(W^-1) P_k",
            "Ad*_w m_(k+1) = m_k - grad_a Lambda <> a_k, a_(k+1) = Phi(w) a_k",
        )
        wrapped = {k: self.lift(self._integral(f)) for k, f in integrals.items()}

        def lift(name: str, shown: Callable[[Any], Any]) -> Any:
            return self.lift(self.of(self.continuous, name, shown), trouble=LEGENDRE) if has_flow else None

        return System(
            name=name,
            title=title,
            equations=(flow if has_flow else step)[0 if moving else 1],
            source=source,
            space=self.space(),
            parameters=self.parameters,
            flow=lift("flow", self.shown),
            energy=lift("energy", lambda H: H),
            velocity=lift("velocity", self.group.matrix) if self.rotations else None,
            scaling="As in the Lagrangian.",
            integrals=wrapped,
            map=self.map(source, conserved, order),
            checks=Checks(naming(lambda **constants: self.check(**constants), self.keywords)),
            n=self.group.n,
            numbers="jax",
            notes=f"Group {self.group.name}, {self.rep.name} representation on R^{self.rep.dim}; "
            f"retraction: {self.group.retraction}.",
        )

    def _integral(self, function: Callable[..., Any]) -> Callable[..., Any]:
        mine = lagrangian_constants(function)
        unknown = [k for k in mine if k not in self.keywords]
        if unknown:
            raise InputError(f"An integral names {shown(unknown[0])}, which is not a parameter of any Lagrangian.")
        return lambda *state, **constants: function(*state, **{k: constants[k] for k in mine})
