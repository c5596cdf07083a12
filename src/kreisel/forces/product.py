"""Several bodies: different ones as one system, and the pairs of bodies that act on each other.

Of bodies of different systems letters and parameters end in the index of the body.  Phase space and equations are
products; integrals and Casimirs belong to each body; the interaction of the bodies is a potential of `kr.perturbed`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.errors import InputError, shown
from kreisel.forces.kicks import perturbation_of
from kreisel.record.calling import call, naming
from kreisel.record.contract import Checks, Parameter, PhaseSpace, System
from kreisel.record.model import Model
from kreisel.record.perturbation import PAIRS, Perturbation, pairs_of

TOTAL = "total_"  # prefix of the integrals of all bodies together
MOST_BODIES = 8  # their step is a piece of straight-line code
MOST_IN_PAIRS = 10**6

State = tuple[Array, ...]


@dataclass(frozen=True)
class Factor:
    """A body of a product: its system, the place of its components, the index behind its letters, its constants."""

    system: System
    place: slice
    mark: str
    names: tuple[str, ...]

    def constants(self, constants: Mapping[str, Any]) -> dict[str, Any]:
        """The constants of this body by its letters."""
        return {name: constants[name + self.mark] for name in self.names if name + self.mark in constants}

    def call(self, function: Any, state: State, constants: Mapping[str, Any]) -> Any:
        """A function of its record at the state of all bodies."""
        return call(function, state[self.place], {**constants, **self.constants(constants)})


def product(models: Sequence[Any]) -> Model:
    """The product of the bodies.  Raises `InputError` for unsuitable bodies."""
    if not 2 <= len(models) <= MOST_BODIES or not all(isinstance(m, Model) for m in models):
        raise InputError(
            f"perturbed: expected 2 to {MOST_BODIES} systems with their parameters, got {shown(list(models))}. For "
            "more bodies of one system use pair_potential=..., pairs=..."
        )
    if len({m.n for m in models}) > 1:
        raise InputError(f"perturbed: expected bodies of one dimension n, got {', '.join(str(m.n) for m in models)}.")
    if forced := [m.system.name for m in models if m.system.perturbation is not None]:
        raise InputError(
            f"perturbed: expected an integrable system for each of several bodies, got {forced[0]}, which has forces. "
            "Give its forces for all bodies."
        )
    factors, first = [], 0
    for i, m in enumerate(models, 1):
        count = len(m.system.space.letters)
        factors.append(Factor(m.system, slice(first, first + count), str(i), tuple(m.constants)))
        first += count
    return Model(_record(models, factors).remade_by(_system_again, list(models)), {})


def _system_again(models: Sequence[Model]) -> System:
    return product(models).system


def _record(models: Sequence[Model], factors: list[Factor]) -> System:
    names = tuple(name + f.mark for f in factors for name in f.names)
    parameters = [
        replace(p, letter=p.letter + f.mark, default=m.params[p.letter], meaning=f"{p.meaning}, of body {f.mark}")
        for m, f in zip(models, factors, strict=True)
        for p in f.system.parameters
    ]

    def flow(*state: Array, **constants: Any) -> State:
        return tuple(rate for f in factors for rate in f.call(f.system.flow, state, constants))

    def energy(*state: Array, **constants: Any) -> Any:
        return sum(f.call(f.system.energy, state, constants) for f in factors)

    def derive(**constants: Any) -> dict[str, Any]:
        result = [(f, call(f.system.derive, (), f.constants(constants))) for f in factors if f.system.derive]
        return {name + f.mark: value for f, values in result for name, value in values.items()}

    def check_parameters(**constants: Any) -> None:
        for f in factors:
            if f.system.checks.parameters is not None:
                call(f.system.checks.parameters, (), f.constants(constants))

    checks_of_state = {k + f.mark: check for f in factors for k, check in f.system.checks.state.items()}
    return System(
        name="-and-".join(f.system.name for f in factors),
        title=" and ".join(f.system.title for f in factors),
        equations="; ".join(f"body {f.mark}: {f.system.equations}" for f in factors),
        source="; ".join(dict.fromkeys(f.system.source for f in factors)),
        space=_space(factors, names),
        parameters=tuple(parameters),
        flow=naming(flow, names),
        energy=naming(energy, names),
        scaling="that of each body",
        integrals={name: naming(function, names) for name, function in _integrals(models, factors).items()},
        derive=naming(derive, tuple(p.letter for p in parameters)),
        checks=Checks(naming(check_parameters, tuple(p.letter for p in parameters)), checks_of_state),
        n=models[0].n,
        product=tuple(factors),
    )


def _integrals(models: Sequence[Model], factors: list[Factor]) -> dict[str, Callable[..., Any]]:
    """Integrals of each body, and the sums of integrals that all bodies have, in one shape."""

    def of_one(f: Factor, name: str) -> Callable[..., Any]:
        return lambda *state, **constants: f.call(f.system.integrals[name], state, constants)

    def of_all(name: str) -> Callable[..., Any]:
        return lambda *state, **constants: sum(of_one(f, name)(*state, **constants) for f in factors)

    def shape(m: Model, name: str) -> tuple[int, ...]:
        kinds = m.system.space.kinds
        point = algebra.restore(np.ones(algebra.coordinate_count(kinds, m.n)), kinds, m.n)
        return np.shape(m.call(m.system.integrals[name], *point))

    result = {name + f.mark: of_one(f, name) for f in factors for name in f.system.integrals}
    shared = [name for name in factors[0].system.integrals if all(name in f.system.integrals for f in factors)]
    return result | {TOTAL + name: of_all(name) for name in shared if len({shape(m, name) for m in models}) == 1}


def block_diagonal(blocks: Sequence[Array]) -> Array:
    """The matrix (..., n, n) with these blocks (..., k, k) on its diagonal."""
    rows = []
    for i, block in enumerate(blocks):
        zeros = [0 * block[..., :1] + np.zeros(column_block.shape[-1], dtype=int) for column_block in blocks]
        rows.append(np.concatenate([*zeros[:i], block, *zeros[i + 1 :]], -1))
    return np.concatenate(rows, -2)


def _space(factors: list[Factor], names: tuple[str, ...]) -> PhaseSpace:
    spaces = [(f, f.system.space) for f in factors]

    def tensor(*state: Array, **constants: Any) -> Array:
        return block_diagonal([f.call(space.tensor, state, constants) for f, space in spaces])

    def casimirs(*state: Array, **constants: Any) -> Array:
        return np.concatenate([f.call(s.casimirs, state, constants) for f, s in spaces if s.casimirs is not None], -1)

    def draw(n: int, numbers: Callable[..., Array]) -> State:
        return tuple(z for f, s in spaces for z in s.point(n, numbers))

    return PhaseSpace(
        name=" x ".join(s.name for _, s in spaces),
        components=tuple((letter + f.mark, kind) for f, s in spaces for letter, kind in s.components),
        tensor=naming(tensor, names),
        casimirs=naming(casimirs, names) if any(s.casimirs for _, s in spaces) else None,
        sign=spaces[0][1].sign,
        constraints={
            f"{name} of body {f.mark}": (lambda *state, f=f, g=g: g(*state[f.place]))
            for f, s in spaces
            for name, g in s.constraints.items()
        },
        carried=tuple(f.place.start + place for f, s in spaces for place in s.carried),
        draw=draw if any(s.draw for _, s in spaces) else None,
    )


# -- bodies that act on each other in pairs: the pairs, and their parameters -----------------------


def parameters_of_pairs(record: Perturbation, pairs: Any, parameters: Mapping[str, Parameter]) -> dict[str, Parameter]:
    """`pairs` as a parameter, and parameters of the pair potential that differ between pairs.  Raises `InputError`."""
    if (record.pair is None) != (pairs is None):
        raise InputError(
            f"perturbed: expected pair_potential and pairs=[(0, 1), ...] together, got {'no ' * (pairs is None)}pairs."
        )
    if record.pair is None:
        return {}
    result = _checked(pairs)
    out = {PAIRS: Parameter(PAIRS, "array", "the bodies that act on each other, (pairs, 2)", _check_pairs, result)}
    of_one = {name for force in record.functions.values() for name in force.parameters}
    for name in record.pair.parameters:
        if name not in parameters:
            raise InputError(
                f"pair_potential: expected parameters of params={{...}}, got {name}, which belongs to a body. Give its "
                "value as a parameter of another name."
            )
        value, vector = np.asarray(parameters[name].default), parameters[name].kind == "vector"
        if value.ndim == vector:
            if vector and len(value) == len(result):
                raise InputError(
                    f"params: expected one {name}, or one for each pair, got {len(value)} values, where n is "
                    f"{len(value)} and there are {len(result)} pairs. Give ({len(result)}, 1) values for one of each, "
                    f"or ({len(result)}, {len(value)}) for vectors."
                )
            continue
        if name in of_one:
            raise InputError(
                f"params: expected one {name} for all, since forces on one body and on pairs use it, got "
                f"{shown(parameters[name].default)}."
            )
        if len(value) != len(result):
            raise InputError(f"params: expected one {name}, or {len(result)}, one for each pair, got {len(value)}.")
        out[name] = Parameter(name, "array", parameters[name].meaning, None, value)
    return out


def _checked(pairs: Any) -> Array:
    try:
        result = np.asarray(pairs)
    except ValueError:
        result = np.empty(0)
    if result.ndim != 2 or result.shape[1:] != (2,) or not len(result) or result.dtype.kind not in "iu":
        raise InputError(f"pairs: expected pairs of integers, such as [(0, 1), (1, 2)], got {shown(pairs)}.")
    _check_pairs(result, PAIRS)
    return result


def _check_pairs(value: Array, name: str) -> None:
    if value.ndim != 2 or value.shape[1:] != (2,) or (value % 1 != 0).any():
        raise InputError(f"{name}: expected pairs of integers, got {shown(value.tolist())}.")
    if value.min() < 0 or value.max() >= MOST_IN_PAIRS or (value[:, 0] == value[:, 1]).any():
        raise InputError(
            f"{name}: expected two different bodies in each, from 0 to {MOST_IN_PAIRS - 1:,}, got "
            f"{shown(value.tolist())}."
        )


def constants_of_pairs(model: Model) -> tuple[dict[str, Array], dict[str, int]]:
    """The parameters of the pair potential, (pairs, ...), and their axes without the axis of pairs."""
    force, count = perturbation_of(model.system).pair, len(model.params[PAIRS])
    values, axes = {}, {}
    for p in model.system.parameters:
        if force is not None and p.letter in force.parameters:
            value = model.params[p.letter]
            by_pair = p.kind == "array" and value.ndim > 0
            if by_pair and len(value) != count:
                raise InputError(
                    f"{model.system.name}: expected one {p.letter}, or {count}, one for each pair, got {len(value)}."
                )
            values[p.letter] = value if by_pair else np.broadcast_to(value, (count, *value.shape))
            axes[p.letter] = value.ndim - by_pair
    return values, axes


def of_bodies(model: Model) -> dict[str, Array]:
    """The constants of the bodies, without the constants of pairs."""
    of_pairs = {p.letter for p in model.system.parameters if p.kind == "array"} if pairs_of(model) is not None else ()
    return {name: value for name, value in model.constants.items() if name not in of_pairs}
