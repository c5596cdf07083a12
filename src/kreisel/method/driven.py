"""What methods for perturbed bodies share: the work of their forces, and what they need beside the state."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from kreisel.algebra import Array
from kreisel.errors import InputError
from kreisel.forces import kicks
from kreisel.forces.kicks import ORIENTATION, Body
from kreisel.method.scheme import Outcome
from kreisel.record.contract import System
from kreisel.record.model import Model
from kreisel.record.perturbation import TIME

COUNT, WORK, BALANCE = "count", "work", "balance"  # count: of whole steps


def require_orientation(model: Model, oriented: bool) -> None:
    """Raises `InputError` where a force takes the orientation and there is none."""
    record = model.system.perturbation
    if record is not None and record.names(ORIENTATION) and not oriented:
        raise InputError(
            f"{model.system.name}: a force takes the orientation g: expected an initial orientation=..., got none. "
            "Give a rotation matrix or a unit quaternion (w, x, y, z)."
        )


def zero(system: System, state: tuple[Array, ...]) -> Array:
    """The number 0 for each lane of a state."""
    return 0 * (state[0][..., 0, 0] if system.space.kinds[0] in ("skew", "symmetric") else state[0][..., 0])


def power(model: Model, state: tuple[Array, ...], known: Mapping[str, Any]) -> Array:
    """The rate of the work."""
    body = Body(state, known.get(ORIENTATION), known.get(TIME))
    return kicks.rates(model.system, body, known, model.axes)[1]


def outcomes_of_work(meaning: str) -> dict[str, Outcome]:
    """The variables `work`, and `balance` with the meaning."""
    return {
        WORK: Outcome("work", "work of the forces without a potential and of those that depend on time"),
        BALANCE: Outcome("integral", f"energy - work, {meaning}"),
    }


def with_work(outputs: dict[str, Array], work: Array) -> dict[str, Array]:
    """The outputs with the work and the balance of the energy."""
    return {**outputs, WORK: work, **({BALANCE: outputs["energy"] - work} if "energy" in outputs else {})}
