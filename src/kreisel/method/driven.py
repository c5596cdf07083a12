"""Parts that methods for perturbed bodies share: the work of forces, and values carried in addition to the state."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.errors import InputError
from kreisel.forces import kicks
from kreisel.forces.kicks import ORIENTATION, Body
from kreisel.forces.product import constants_of_pairs
from kreisel.forces.records import conserved_totals
from kreisel.method.scheme import BALANCE, WORK, Coupling, Outcome
from kreisel.record.contract import System
from kreisel.record.model import Model
from kreisel.record.perturbation import TIME, pairs_of

TOTAL = "total_"  # prefix of quantities that are sums over coupled bodies


def require_orientation(model: Model, oriented: bool) -> None:
    """Raises `InputError` where a force needs the orientation and there is none."""
    record = model.system.perturbation
    if record is not None and record.names(ORIENTATION) and not oriented:
        raise InputError(
            f"{model.system.name}: a force needs the orientation g: expected an initial orientation=..., got none. "
            "Give a rotation matrix or a unit quaternion (w, x, y, z)."
        )


def zero(system: System, state: tuple[Array, ...]) -> Array:
    """The number 0 for each lane of a state."""
    first = (0,) * algebra.KINDS[system.space.kinds[0]].axes
    return 0 * state[0][(..., *first)]


def power(model: Model, state: tuple[Array, ...], constants: Mapping[str, Any]) -> Array:
    """The rate of the work."""
    where = constants.get(ORIENTATION), constants.get(TIME)
    return kicks.rates(Body(model.system, state, constants, model.axes, *where))[1]


def outcomes_of_work(meaning: str) -> dict[str, Outcome]:
    """The variables `work`, and `balance` with the meaning."""
    return {
        WORK: Outcome("work", "work of the forces without a potential and of those that depend on time"),
        BALANCE: Outcome("integral", f"energy - work, {meaning}"),
    }


def with_work(outputs: dict[str, Array], work: Array) -> dict[str, Array]:
    """The outputs with the work and the balance of the energy."""
    return {**outputs, WORK: work, **({BALANCE: outputs["energy"] - work} if "energy" in outputs else {})}


def outcomes_of_totals(model: Model, meaning: str) -> dict[str, Outcome]:
    """The variables of bodies in pairs that are of all together, each the same in all lanes."""
    if pairs_of(model) is None:
        return {}
    changes = kicks.perturbation_of(model.system).driven
    said = "which changes by the work of all bodies" if changes else meaning
    out = {f"{TOTAL}energy": Outcome("integral", f"energy of all bodies together, {said}")}
    out |= {BALANCE: Outcome("integral", f"{TOTAL}energy - work of all bodies together, {meaning}")} if changes else {}
    return out | {
        TOTAL + name: Outcome("integral", f"sum of {name} over all bodies", conserved=True)
        for name in conserved_totals(model)
    }


def coupling_of(
    model: Model,
    where: Callable[[tuple[Array, ...], Mapping[str, Any]], Body],
    driven: bool,
    at_rows: Mapping[str, Any] | None = None,
) -> Coupling | None:
    """Coupling of the bodies in pairs; None without pairs.

    where(z, constants) -> the body, from what a method steps; `at_rows`: what it needs of `constants` at saved rows.
    What acts on a body are the rates of its state and, if `driven`, of the work.
    """
    pairs = pairs_of(model)
    if pairs is None:
        return None
    constants, axes = constants_of_pairs(model)

    def pull(*z: Array, **constants: Array) -> tuple[Array, ...]:
        left, right = where(z[: len(z) // 2], constants), where(z[len(z) // 2 :], constants)
        first, second, gain = kicks.pulls((left._replace(axes=axes), right._replace(axes=axes)))
        return (*first, *(gain / 2,) * driven, *second, *(gain / 2,) * driven)

    return Coupling(
        pairs=pairs,
        constants=constants,
        axes=axes,
        forces=(*model.system.space.kinds, *("scalar",) * driven),
        pull=pull,
        together=lambda outputs, z: with_totals(model, outputs, where(z, at_rows or {})),
    )


def with_totals(model: Model, outputs: Mapping[str, Array], bodies: Body) -> dict[str, Array]:
    """Outputs of rows (rows, lanes, ...) with those of all bodies together; of V a half goes to each body of a pair."""
    pairs = pairs_of(model)
    if pairs is None:
        return dict(outputs)
    constants, axes = constants_of_pairs(model)
    first, second = (
        bodies._replace(
            state=tuple(z[:, of] for z in bodies.state),
            constants=constants,
            axes=axes,
            g=None if bodies.g is None else bodies.g[:, of],
            t=None if bodies.t is None else bodies.t[:, of],
        )
        for of in pairs.T
    )
    V, _, _ = kicks.potential_of_pair((first, second))
    out = dict(outputs)
    energy = out["energy"].copy()
    shares = np.broadcast_to(np.asarray(V) / 2, (len(energy), len(pairs)))
    for of in pairs.T:
        np.add.at(energy.T, of, shares.T)
    out |= {"energy": energy, f"{TOTAL}energy": _of_all(energy)}
    out |= {TOTAL + name: _of_all(outputs[name]) for name in conserved_totals(model)}
    return out | ({BALANCE: out[f"{TOTAL}energy"] - _of_all(out[WORK])} if WORK in out else {})


def _of_all(values: Array) -> Array:
    """The sum over the lanes, in each lane."""
    return np.broadcast_to(values.sum(1, keepdims=True), values.shape)
