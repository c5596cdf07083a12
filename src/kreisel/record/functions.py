"""Functions of a user-defined record, tried at a point: arguments, shapes, and whether flow and energy fit."""

from __future__ import annotations

import inspect
from collections.abc import Iterator, Mapping
from functools import partial
from typing import Any

import numpy as np

from kreisel.algebra import Array, flatten, restore
from kreisel.algebra.reuse import Identity, reused
from kreisel.errors import InputError, doubt
from kreisel.record.calling import Function, call
from kreisel.record.model import Model

FIT = 1e-4  # of the largest entry: differences have errors of 1e-9
STEP = 0.01


def require_functions(model: Model) -> None:
    """Raises `InputError` for functions of a user-defined record that lack arguments or return other shapes.

    `InputWarning` if flow and energy contradict each other.  Once for each record and n; the laws test more.
    """
    system = model.system
    if "_origin" in vars(system) or system.perturbation is not None or system.product or system.numbers == "jax":
        return
    if 0 not in model.batch:
        reused((__name__, Identity(system), model.n), partial(_try, model))


def _try(model: Model) -> bool:
    system, n = model.system, model.n
    constants = {k: v[(0,) * (v.ndim - model.axes[k])] for k, v in model.constants.items()}
    state, kinds = system.space.point(n, np.random.default_rng(1).standard_normal), dict(system.space.components)
    for name, function, shown in _functions(model):
        available = {**constants, "eps": STEP} if name == "map.step" else constants
        _require_arguments(model, name, function, [*available])
        with np.errstate(all="ignore"):
            out = call(function, state, available)
        if shown == "scalar":
            if np.shape(out) != ():
                raise InputError(f"{system.name}: {name}: expected one value, got the shape {np.shape(out)}.")
            continue
        parts = out if isinstance(out, tuple | list) else (out,)
        if len(parts) != len(kinds):
            got = f"{len(parts)} components" if isinstance(out, tuple | list) else f"the shape {np.shape(out)}"
            names = ", ".join(f"{k}'" for k in kinds) if name == "flow" else ", ".join(kinds)
            cause = "" if isinstance(out, tuple | list) else " Usual cause: no comma after a single component."
            raise InputError(f"{system.name}: {name}: expected a tuple ({names},) of {len(kinds)}, got {got}.{cause}")
        for (letter, kind), value, component in zip(kinds.items(), parts, state, strict=True):
            _require_kind(f"{system.name}: {name}: {letter}", kind, np.asarray(value), component.shape)
    if system.flow is not None and system.energy is not None:
        _require_fit(model, state, constants)
    return True


def _functions(model: Model) -> Iterator[tuple[str, Function, str]]:
    system = model.system
    if system.flow is not None:
        yield "flow", system.flow, "state"
    if system.energy is not None:
        yield "energy", system.energy, "scalar"
    if system.map is not None and system.map.rational:
        yield "map.step", system.map.step, "state"


def _require_arguments(model: Model, name: str, function: Function, constants: list[str]) -> None:
    system, letters = model.system, model.system.space.letters
    try:
        parameters = inspect.signature(function).parameters.values()
    except (TypeError, ValueError):
        return
    write = f"Write def {name.split('.')[-1]}({', '.join([*letters, '*', *constants])})."
    if unknown := sorted(
        p.name for p in parameters if p.kind is p.KEYWORD_ONLY and p.default is p.empty and p.name not in constants
    ):
        raise InputError(
            f"{system.name}: {name}: expected keywords among the parameters, {', '.join(constants) or 'none'}, got "
            f"{', '.join(unknown)}. {write}"
        )
    names = [p.name for p in parameters if p.kind in (p.POSITIONAL_ONLY, p.POSITIONAL_OR_KEYWORD)]
    free = any(p.kind is p.VAR_POSITIONAL for p in parameters)
    if not free and (len(names) != len(letters) or (sorted(names) == sorted(letters) and names != list(letters))):
        raise InputError(
            f"{system.name}: {name}: expected the components of the state, {', '.join(letters)}, in order, and "
            f"parameters by keyword, got {', '.join(names) or 'none'}. {write}"
        )


def _require_kind(label: str, kind: str, value: Array, shape: tuple[int, ...]) -> None:
    if value.shape != shape:
        raise InputError(f"{label} ({kind}): expected the shape {shape}, got {value.shape}.")
    sign = {"skew": 1, "symmetric": -1}.get(kind, 0)
    if sign and np.isfinite(value).all() and abs(value + sign * value.T).max() > FIT * abs(value).max():
        raise InputError(
            f"{label}: expected a {kind} matrix, of which only the entries i < j are used, got another. Usual cause: a "
            f"product of matrices; its {kind} part is (X {'-' if sign > 0 else '+'} X.mT) / 2."
        )


def _require_fit(model: Model, state: tuple[Array, ...], constants: Mapping[str, Any]) -> None:
    """Warns unless F' = {H, F} for the coordinates F, at one point."""
    space, n = model.system.space, model.n
    z = flatten(state, space.kinds)

    def energy(z: Array) -> float:
        return float(call(model.system.energy, restore(z, space.kinds, n), constants))

    h = 1e-5
    with np.errstate(all="ignore"):
        slope = np.array([(energy(z + h * e) - energy(z - h * e)) / (2 * h) for e in np.eye(len(z))])
        rate = flatten(call(model.system.flow, state, constants), space.kinds)
        bracket = slope @ np.asarray(call(space.tensor, state, constants), dtype=np.float64)
        off = abs(rate - bracket).max()
    if off > FIT * max(abs(rate).max(), abs(bracket).max()):
        places = [
            k
            for k, x, y in zip(space.letters, *(restore(v, space.kinds, n) for v in (rate, bracket)), strict=True)
            if abs(x - y).max() > FIT * abs(y).max()
        ]
        doubt(
            f"{model.system.name}: expected a flow F' = {{H, F}} of the energy H in the bracket of {space.name}, got "
            f"another {', '.join(f'{k}{chr(39)}' for k in places)}. Usual cause: a sign, a factor, or the other frame. "
            "Methods use one or the other; kreisel.lab.laws.check(system) tests all claims."
        )
