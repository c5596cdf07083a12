"""Bodies that act on each other in pairs: the pairs, and their parameters."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from kreisel.algebra import Array
from kreisel.errors import InputError, shown
from kreisel.forces.kicks import perturbation_of
from kreisel.record.contract import Parameter
from kreisel.record.model import Model
from kreisel.record.perturbation import PAIRS, Perturbation, pairs_of

MOST_BODIES = 10**6


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
    if value.min() < 0 or value.max() >= MOST_BODIES or (value[:, 0] == value[:, 1]).any():
        raise InputError(
            f"{name}: expected two different bodies in each, from 0 to {MOST_BODIES - 1:,}, got "
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
