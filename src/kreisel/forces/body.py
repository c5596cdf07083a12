"""kr.perturbed: forces around an integrable motion, as a system like any other."""

from __future__ import annotations

import copy
import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial, reduce
from operator import add
from typing import TYPE_CHECKING, Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.algebra.recorded import run
from kreisel.errors import InputError, explained, hint, shown
from kreisel.forces import kicks
from kreisel.forces.kicks import COUPLING, DAMPING, INERTIA, ORIENTATION, Body
from kreisel.forces.product import constants_of_pairs, parameters_of_pairs, product
from kreisel.forces.records import perturbed_record, surviving_parts
from kreisel.record import table
from kreisel.record.body import as_body
from kreisel.record.calling import Portable, arguments_of, call, keywords, naming
from kreisel.record.contract import Frame, Parameter, System
from kreisel.record.model import Model
from kreisel.record.perturbation import FIELDS, FIRST, PAIRS, SECOND, TIME, Force, Perturbation, together
from kreisel.record.table import Form, form_of, packed_of
from kreisel.record.values import SKEW_TOLERANCE, axes_of, is_vector, numbers, require_body, require_one_reading
from kreisel.system import REGISTRY

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

POSITIONAL = inspect.Parameter.POSITIONAL_OR_KEYWORD
INNER = (2, 4, 6, 8)  # orders
STATED = ("source", "space", "integrals", "derive", "scaling", "body_frame", "n")  # of a body with forces
MOTION = ("M", "Omega", "g", "t")  # momentum, angular velocity, orientation (body to space), time
RATE = "B_rate"  # of the field along the orbit
PLACE = (*(field.symbol for field in FIELDS.values()), RATE)
AXES_OF_LANES = ("body_axis_1", "body_axis_2", "body_axis_3")  # parameters: the columns of `axes`, if lanes differ
UNIT_OF_LANES = "unit_of_momentum"
NEAR = 1.0  # s: a difference over twice this time has the rate of the field to 1e-7


@explained
def perturbed(
    system: Model | Sequence[Model],
    *,
    potential: Callable[..., Any] | None = None,
    torque: Callable[..., Any] | None = None,
    force: Callable[..., Any] | None = None,
    damping: ArrayLike | None = None,
    inertia: ArrayLike | None = None,
    coupling: ArrayLike | None = None,
    pair_potential: Callable[..., Any] | None = None,
    pairs: ArrayLike | None = None,
    inner: int | None = None,
    params: Mapping[str, Any] | None = None,
    name: str | None = None,
) -> Model:
    """A body under additional forces around an integrable system: a system with its parameters, for `kr.simulate`.

        H = H_system + V + M.KP,   M' = {M, H} + tau - damping M,   P' = {P, H} + F

    system     the integrable part, such as `kr.LagrangeTop(p=(0, 0, 1))`; or one with H = T(M) + V(P) and principal
               axes, such as `kr.Kirchhoff(C=..., B=...)`; or a body with forces, to which these are added; or a list of
               different ones that a potential couples, whose letters and parameters end in the number of the body
    potential  V of letters that the body carries (a, P; not the momentum), the orientation g (a matrix, body to
               space), the time t; parameters after `*`.  Its force is derived from it
    torque     tau of the same and the momentum, in the frame of the state; for n = 3 an axial vector
    force      F of the same: the rate of the momentum P of a body in a fluid, a vector in the body frame
    damping    gamma in M' = -gamma M: one value, or one for each axis of the body (for a symmetric body in the rest
               frame the last belongs to its axis).  Exact
    inertia    the principal moments of the body, if they differ from the integrable part; moving frame, n = 3
    coupling   the symmetric matrix K (3, 3) of M.KP in H, of a body in a fluid, or its diagonal
    pair_potential  V of two bodies, of letters and g with 1 or 2 behind: a1, g1 of the first, a2, g2 of the second,
               and t.  The lanes of a run are then the bodies, each with its parameters
    pairs      the interacting bodies: pairs (i, j), as [(0, 1), (1, 2)] for a chain of three
    inner      the integrable motion in a splitting by the map of the system (`method="suris"`), of order 2, 4, 6 or 8;
               default: its closed form, if known for one step, else the map to order 8
    params     the parameters after `*`, by name: a scalar, a vector (n,), or either with an axis of lanes in front (of
               pairs for `pair_potential`); scalars in exactly n lanes as (n, 1); a `kr.Table`, which is called with t
    name       of the system, in archives and TOML files; default: "perturbed-" and the name of the integrable part

    Functions are run once, on values that record the operations: NumPy's +, *, @, sqrt, sin, cos, exp, log; where,
    clip, sign, minimum, maximum, abs for `if`.  Skew components are axial vectors for n = 3.  Without any force the
    system itself is returned.  Raises `InputError` for anything but such a function, for unknown names, and for forces
    that do not suit the system.
    """
    body = _base(system)
    functions = {"potential": potential, "torque": torque, "force": force, "pair_potential": pair_potential}
    matrices = {DAMPING: damping, INERTIA: inertia, COUPLING: coupling}
    if all(value is None for value in (*functions.values(), *matrices.values(), pairs)) and not body.system.product:
        return body
    _require_base(body)
    parameters = _parameters(body, params or {})
    record = _record(body, functions, matrices, parameters, inner)
    _require_suitable(body, record)
    parameters |= _matrices(body, damping, inertia, coupling)
    parameters |= parameters_of_pairs(record, pairs, parameters)
    model = _tried(body, record, list(parameters.values()), name)
    numbers = copy.deepcopy({**matrices, "pairs": pairs, "params": params, "inner": inner, "name": name})
    portable = {kind: Portable(function) for kind, function in functions.items()}
    return Model(_with_own_casimirs(model).remade_by(_system_again, body, portable, numbers), {}, body.body_frame)


def _system_again(body: Model, functions: Mapping[str, Portable], numbers: Mapping[str, Any]) -> System:
    arguments: dict[str, Any] = {kind: function.function for kind, function in functions.items()}
    return perturbed(body, **arguments, **numbers).system


def _base(system: Any) -> Model:
    """The integrable part; for several bodies, their product.  Raises `InputError` for anything but systems."""
    body = product(system) if isinstance(system, Sequence) else system
    if not isinstance(body, Model):
        raise InputError(
            f"perturbed: expected a system with its parameters, such as kr.LagrangeTop(p=(0, 0, 1)), got "
            f"{shown(system)}.{' Give the forces to the body: torque=..., damping=...' if as_body(system) else ''}"
        )
    return body


def _record(
    model: Model,
    functions: Mapping[str, Any],
    matrices: Mapping[str, Any],
    parameters: Mapping[str, Parameter],
    inner: Any,
) -> Perturbation:
    letters = (*model.system.space.letters, ORIENTATION)
    of_two = tuple(letter + mark for letter in letters for mark in (FIRST, SECOND))
    forces = {
        kind: None
        if function is None
        else replace(
            function.of(model),
            tables=_tables(parameters, function.params),
            units=dict.fromkeys(parameters, function.time),
        )
        if isinstance(function, InBody)
        else _force(function, kind, (*(of_two if kind == "pair_potential" else letters), TIME), model, parameters)
        for kind, function in functions.items()
    }
    record = Perturbation(
        base=model.system,
        potential=forces["potential"],
        torque=forces["torque"],
        force=forces["force"],
        damping=matrices[DAMPING] is not None,
        inertia=matrices[INERTIA] is not None,
        coupling=matrices[COUPLING] is not None,
        pair=forces["pair_potential"],
        inner=_inner(model, inner),
    )
    return record if model.system.perturbation is None else _added(model.system, model.system.perturbation, record)


def _added(system: System, old: Perturbation, new: Perturbation) -> Perturbation:
    """The forces of a body and further ones.  Raises `InputError` for pairs, and for a part that it has already."""
    if new.inertia or new.coupling or new.pair or old.pair or new.inner or (new.damping and old.damping):
        raise InputError(
            f"perturbed: expected a potential, a torque, a force or damping for {system.name}, which has forces "
            "already, got others. Give all forces of an integrable system at once."
        )
    sums: dict[str, Any] = {
        kind: together(getattr(old, kind), getattr(new, kind)) for kind in ("potential", "torque", "force")
    }
    return replace(old, damping=old.damping or new.damping, **sums)


def _require_base(model: Model) -> None:
    system = model.system
    for factor in system.product:
        _require_base(Model(factor.system, factor.constants(model.params)))
    if system.flow is None or system.numbers != "any":
        raise InputError(
            f"perturbed: expected a system of Kreisel's with a map or a closed form, got {system.name}; see "
            "kr.systems()."
        )


def _inner(model: Model, inner: Any) -> int | None:
    """An order of the map, or None.  Raises `InputError`."""
    if inner is not None and (isinstance(inner, bool) or inner not in INNER or model.system.map is None):
        orders = ", ".join(map(str, INNER))
        wanted = f"one of {orders}" if model.system.map else f"none, since no map of {model.system.name} is known"
        raise InputError(f"inner: expected {wanted}, got {shown(inner)}.")
    return None if inner is None else int(inner)


def _force(function: Any, label: str, letters: tuple[str, ...], model: Model, params: Mapping[str, Parameter]) -> Force:
    """A function with the names of its arguments.  Raises `InputError`."""
    if not callable(function):
        raise InputError(f"{label}: expected a function, such as lambda a, t, *, k: ..., got {shown(function)}.")
    try:
        signature = inspect.signature(function)
    except (TypeError, ValueError):
        raise InputError(
            f"{label}: expected a Python function that names its arguments, got {shown(function)}."
        ) from None
    constants = (*params, *(p.letter for p in model.system.parameters))
    arguments: list[str] = []
    parameters: list[str] = []
    for parameter in signature.parameters.values():
        place = parameter.kind is POSITIONAL
        names, kind = (letters, "arguments") if place else (constants, "parameters after *")
        if parameter.kind not in (POSITIONAL, inspect.Parameter.KEYWORD_ONLY) or parameter.name not in names:
            raise InputError(
                f"{label}: expected {kind} among {', '.join(names) or 'none'}, got {shown(parameter.name)}."
                f"{hint(parameter.name, names)} Parameters follow * and are in params={{...}}."
            )
        (arguments if place else parameters).append(parameter.name)
    return Force(function, tuple(arguments), tuple(parameters), tables=_tables(params, parameters))


def _tables(params: Mapping[str, Parameter], names: Sequence[str]) -> dict[str, Form]:
    """The forms of the named parameters that are tables."""
    return {name: form_of(params[name].default) for name in names if name in params and params[name].kind == "table"}


def _parameters(model: Model, params: Any) -> dict[str, Parameter]:
    """The parameters of the user's functions, with their values as defaults.  Raises `InputError`."""
    if not isinstance(params, Mapping):
        raise InputError(f"params: expected a dict of names and values, got {shown(params)}.")
    taken = {
        *model.system.space.letters,
        ORIENTATION,
        TIME,
        DAMPING,
        INERTIA,
        COUPLING,
        PAIRS,
        *model.constants,
        *_keywords(model),
    }
    out = {}
    for letter, value in params.items():
        if not isinstance(letter, str) or not letter.isidentifier() or letter[0] == "_" or letter in taken:
            raise InputError(
                "params: expected names that begin with a letter, other than "
                f"{', '.join(sorted(taken))}, got {shown(letter)}."
            )
        packed = packed_of(value)
        kind, default = ("table", packed) if packed is not value else _kind(value, model.n)
        check = partial(table.check, form=form_of(packed)) if kind == "table" else None
        out[letter] = Parameter(letter, kind, "of the forces", check, default)
    return out


def _kind(value: Any, n: int) -> tuple[str, Any]:
    """The kind of parameter of a value, and the value with a single axis of lanes."""
    value = algebra.lanes_in_front(value)
    shape = np.shape(value)
    if is_vector(value, n) and len(shape) <= 2:
        return "vector", value
    return "scalar", np.reshape(value, shape[:1]) if len(shape) == 2 and shape[1] == 1 else value


def _keywords(model: Model) -> set[str]:
    """Keyword arguments of functions of the record, which have a fixed meaning."""
    system = model.system
    records = [r for r in (system, system.map, system.baecklund) if r is not None]
    values = [value for record in records for value in vars(record).values()] + [*system.integrals.values()]
    return {"self", "state", "alpha", *(name for f in values if callable(f) for name in keywords(f))}


def _matrices(model: Model, damping: Any, inertia: Any, coupling: Any) -> dict[str, Parameter]:
    out = {}
    for name, value in ((DAMPING, damping), (INERTIA, inertia), (COUPLING, coupling)):
        if value is not None:
            numbers(value, name)
    if damping is not None:
        kind = "vector" if is_vector(damping, 3) and model.n == 3 else "scalar"
        meaning = "rate of linear damping, M' = -damping M, of all axes or of each"
        check = _alike if kind == "vector" and model.system.frame is Frame.REST else None
        out[DAMPING] = Parameter(DAMPING, kind, meaning, check, damping, diagonal=kind == "vector")
    if inertia is not None:
        check = _moments if model.system.translation is None else _positive
        out[INERTIA] = Parameter(INERTIA, "vector", "principal moments of the body", check, inertia, diagonal=True)
    if coupling is not None:
        out[COUPLING] = Parameter(COUPLING, "symmetric", "K in the term M.KP of H", None, coupling)
    for p in out.values():
        require_one_reading(p, p.default, "kr.perturbed")
    return out


def _alike(value: Array, name: str) -> None:
    if (value[..., 0] != value[..., 1]).any():
        raise InputError(
            f"{name}: in the rest frame expected three rates of which the first two, across the axis of the body, are "
            f"alike, got {shown(value.tolist())}. For a body without that symmetry use the moving frame."
        )


def _moments(value: Array, name: str) -> None:
    _positive(value, name)
    require_body(value.sum(-1, keepdims=True) / 2 - value, name)


def _positive(value: Array, name: str) -> None:
    """Check moments of a body together with the fluid that it moves: they must be positive, no more."""
    if not (value > 0).all():
        raise InputError(f"{name}: expected three moments of inertia > 0, got {shown(value.tolist())}.")


def _by_momenta(record: Perturbation) -> bool:
    """Whether a potential depends on a momentum."""
    space, pair = record.base.space, record.pair
    momenta = [letter for place, letter in enumerate(space.letters) if place not in space.carried]
    alone = record.potential is not None and any(map(record.potential.names, momenta))
    return alone or (pair is not None and any(pair.names(m + mark) for m in momenta for mark in (FIRST, SECOND)))


# Forces (record) that do not suit a system: the condition, and the message, with the names of `_require_suitable`.
UNSUITABLE: tuple[tuple[Callable[[System, Perturbation, int], Any], str], ...] = (
    (
        lambda system, record, n: _by_momenta(record),
        "potential: expected a function of {carried}g, t, got one of the momentum {momenta}. For other moments of "
        "inertia use inertia=..., for drag torque=... or damping=...",
    ),
    (
        lambda system, record, n: (
            system.product and (record.potential is None or record.names(ORIENTATION) or record.beside)
        ),
        "{name}: expected several bodies with one potential, of {carried}t, got none, or other forces. Forces that "
        "depend on g need a single body, or bodies in pairs.",
    ),
    (
        lambda system, record, n: (
            (record.beside or record.names(ORIENTATION)) and (not system.space.of_body or system.velocity is None)
        ),
        "{name}: expected only a potential, since it is not a body that rotates.",
    ),
    (
        lambda system, record, n: record.force and record.pair,
        "force: expected bodies in pairs without one, since the pair potential may depend on P.",
    ),
    (
        lambda system, record, n: (
            (record.coupling and n != 3) or ((record.force or record.coupling) and system.translation is None)
        ),
        "{moving}: expected a body that moves through space, such as kr.Kirchhoff, n = 3, got {name}, n = {n}.",
    ),
    (
        lambda system, record, n: (
            record.inertia and (n != 3 or system.frame is not Frame.MOVING or system.inverse_inertia is None)
        ),
        "inertia: expected a body in its moving frame, n = 3, such as kr.LagrangeTopMoving or kr.EulerTop, got {name}, "
        "n = {n}.",
    ),
    (
        lambda system, record, n: record.damping and system.frame is Frame.REST and not system.space.carried,
        "damping: expected a body with an axis, got {name}.",
    ),
)


def _require_suitable(model: Model, record: Perturbation) -> None:
    """Raises `InputError` for forces that this system cannot have."""
    system, space = model.system, model.system.space
    carried = [space.letters[place] for place in space.carried]
    names = {"carried": "".join(f"{letter}, " for letter in carried), "name": system.name, "n": model.n}
    names["momenta"] = ", ".join(letter for letter in space.letters if letter not in carried)
    names["moving"] = "coupling" if record.coupling else "force"
    for fails, message in UNSUITABLE:
        if fails(system, record, model.n):
            raise InputError(message.format(**names))
    if record.inertia:
        kicks.require_principal(system, model.constants)


def _system(model: Model, record: Perturbation, parameters: list[Parameter], name: str | None) -> System:
    """The record of the perturbed system.  Raises `InputError` for a bad name."""
    base = model.system
    if name is not None and (not isinstance(name, str) or not name.isprintable() or not name.strip()):
        raise InputError(f"name: expected a name, got {shown(name)}.")
    if name in REGISTRY:
        raise InputError(f"name: expected a name that no system of Kreisel has, got {shown(name)}.")
    stated: dict[str, Any] = {}
    if base.perturbation is not None:
        before, after = ({k: f.function for k, f in forces.functions.items()} for forces in (base.perturbation, record))
        checks = base.checks if before == after else replace(base.checks, idle=None)  # may read the air and the light
        stated = {field: getattr(base, field) for field in STATED} | {"checks": checks}
    return perturbed_record(
        record,
        {**model.axes, **{p.letter: axes_of(p, np.asarray(p.default)) for p in parameters}},
        name=name or f"perturbed-{base.name}",
        title=f"{base.title}, perturbed",
        equations=f"{base.equations}; perturbed by {_in_words(record)}",
        parameters=(*(replace(p, default=model.params[p.letter]) for p in base.parameters), *parameters),
        **stated,
    )


def _in_words(record: Perturbation) -> str:
    """The forces, for a line of text."""
    parts = [f"a {kind} of ({', '.join(force.arguments)})" for kind, force in record.functions.items()]
    parts += [f"a pair potential of ({', '.join(record.pair.arguments)})"] if record.pair else []
    parts += ["linear damping"] * record.damping + ["other moments of inertia"] * record.inertia
    parts += ["a coupling of M and P"] * record.coupling
    parts += ["a controller"] * (record.control is not None)
    return ", ".join(parts)


def _with_own_casimirs(model: Model) -> System:
    """The record with only the Casimirs that no force changes."""
    system, space = model.system, model.system.space
    if space.casimirs is None:
        return system
    stated, parts = space.casimirs, surviving_parts(model, space.casimirs)
    if all(parts):
        return system
    chosen = np.flatnonzero(parts)

    def casimirs(*state: Array, **constants: Any) -> Array:
        return stated(*state, **constants)[..., chosen]

    named = naming(casimirs, tuple(keywords(stated))) if len(chosen) else None
    return replace(system, space=replace(space, casimirs=named))


def _tried(body: Model, record: Perturbation, parameters: list[Parameter], name: str | None) -> Model:
    """The model of these forces, which are marked if they choose values by comparisons."""
    model = Model(_system(body, record, parameters, name), {})
    chosen: dict[str, Any] = {k: replace(getattr(record, k), chooses=True) for k in _try(model)}
    return Model(_system(body, replace(record, **chosen), parameters, name), {}) if chosen else model


def _try(model: Model) -> set[str]:
    """Run the functions once: the names of those that choose values by comparisons.

    Raises `InputError` for any exception of theirs.
    """
    space, n, record = model.system.space, model.n, kicks.perturbation_of(model.system)
    rng = np.random.default_rng(0)

    def draw(shape: tuple[int, ...]) -> Array:
        return rng.normal(size=shape)

    state = space.point(n, draw)
    g = algebra.cayley(algebra.skew(draw((n * (n - 1) // 2,)), n))
    constants = {
        letter: v.reshape(-1, *v.shape[v.ndim - model.axes[letter] :])[0] for letter, v in model.constants.items()
    }
    try:
        with np.errstate(all="ignore"):
            body, chosen = Body(model.system, state, constants, model.axes, g, np.float64(0.5)), set[str]()
            if record.pair is not None:
                of_pairs, axes = constants_of_pairs(model)
                member = body._replace(constants={name: v[0] for name, v in of_pairs.items()}, axes=axes)
                kicks.pulls((member, member))
                pair = kicks.seen_by_pair((member, member))
                chosen |= {"pair"} if kicks.chooses(record.pair, pair, member) else set()
            kicks.rates(body)
            tau = kicks.torque(body)
            chosen |= {k for k, force in record.functions.items() if kicks.chooses(force, kicks.seen(body), body)}
    except InputError:
        raise
    except Exception as error:
        raise InputError(
            f"{model.system.name}: a force cannot be computed: {type(error).__name__}: {error}. Usual cause: a "
            "function that does not accept values of every kind; use NumPy's operations, np.where for `if`, no math."
        ) from error
    if tau is not None and algebra.magnitude(tau + tau.mT) > SKEW_TOLERANCE * max(1.0, algebra.magnitude(tau)):
        raise InputError(
            "torque: expected a skew matrix or, for n = 3, an axial vector, got a matrix that is not skew."
        )
    return chosen


# -- forces in SI units along the axes in which a body was given -----------------------------------


@dataclass(frozen=True, eq=False)
class InBody:
    """A torque, N m, or a potential, J: the sum of user-defined functions of quantities of a body in SI.

    functions  with the names of their arguments: quantities, and `params`
    axes       (3, 3), v_body = axes v_state; None if it differs from lane to lane, as the unit of momentum then does
    time, momentum   units of the model, s and N m s
    """

    kind: str
    functions: tuple[tuple[Portable, tuple[str, ...]], ...]
    params: tuple[str, ...]
    axes: Array | None
    time: float
    momentum: float | None

    def of(self, model: Model) -> Force:
        """The force of a model."""
        system, record, moving = model.system, model.system.perturbation, model.system.frame is Frame.MOVING
        names = {name for _, arguments in self.functions for name in arguments} - {*self.params}
        place = record.environment if record is not None and not names.isdisjoint(PLACE) else None
        vectors = {"g", RATE, *(field.symbol for field in FIELDS.values() if field.shape)}
        turned = not moving or bool(vectors & names)
        letters = system.space.letters if {"M", "Omega"} & names else ()
        arguments = (*letters, *(ORIENTATION,) * turned, *(TIME,) * (place is not None or "t" in names))
        constants = [*(place.parameters if place is not None else ())]
        if "Omega" in names:
            base = system if record is None else record.base
            constants += [*sorted(keywords(base.velocity)), *[COUPLING] * (record is not None and record.coupling)]  # type: ignore[arg-type]
        constants += [*AXES_OF_LANES, UNIT_OF_LANES] if self.axes is None else []

        def force(*values: Any, **constants: Any) -> Any:
            by_name = dict(zip(arguments, values, strict=True))
            axes = np.stack([constants[k] for k in AXES_OF_LANES], -1) if self.axes is None else self.axes
            momentum = constants[UNIT_OF_LANES] if self.momentum is None else self.momentum
            body = dict[str, Any]()
            if turned:
                g = body["g"] = by_name[ORIENTATION] @ axes.T
            if TIME in by_name:
                body["t"] = by_name[TIME] * self.time
            if letters:
                body["M"] = momentum * (axes @ by_name[letters[0]] if moving else by_name[letters[0]] @ g)
            if "Omega" in names:
                state = tuple(
                    algebra.hat(by_name[letter]) if kind == "skew" else by_name[letter]
                    for letter, kind in system.space.components
                )
                velocity = (
                    call(system.velocity, state, constants)
                    if record is None
                    else kicks.velocity(Body(system, state, constants, {}))
                )
                Omega = algebra.axial(velocity)
                body["Omega"] = (axes @ Omega if moving else Omega @ g) / self.time
            if place is not None:
                at = partial(run, place.function, **place.named(constants[name] for name in place.parameters))
                result = {FIELDS[name].symbol: value for name, value in at(body["t"]).items()}
                if RATE in names:
                    later, earlier = (at(body["t"] + h)["field"] for h in (NEAR, -NEAR))
                    result[RATE] = (later - earlier) / (2 * NEAR)
                body |= {k: result[k] @ g if k in vectors else result[k] for k in PLACE if k in names}
            parts = []
            for function, wanted in self.functions:
                out = np.asarray(run(function.function, **{k: {**constants, **body}[k] for k in wanted}), dtype=object)
                if self.kind == "torque":
                    if out.shape != (3,):
                        raise InputError(
                            f"torque: expected a vector (3,) along the body axes, N m, got shape {out.shape}."
                        )
                    out = out @ axes if moving else g @ out
                parts.append(out[()] / (momentum / self.time))
            return reduce(add, parts)

        return Force(force, arguments, tuple(dict.fromkeys([*constants, *self.params])))


def in_body(kind: str, function: Any, params: Mapping[str, Any], quantities: tuple[str, ...], **frame: Any) -> Any:
    """A force of these quantities and parameters by name; None without a function.  Raises `InputError`.

    A list of functions is their sum.
    """
    if function is None:
        return None
    several = function if isinstance(function, list | tuple) and function else [function]
    allowed = (*quantities, *(name for name in params if name not in (*MOTION, *PLACE)))
    remedy = "Give other parameters as params={...}, by names that no quantity has."
    functions = [(Portable(function), arguments_of(function, allowed, kind, remedy)) for function in several]
    used = tuple(dict.fromkeys(name for _, names in functions for name in names if name in params))
    return InBody(kind, tuple(functions), used, **frame)
