"""The grade of a trajectory: its errors against the exact motion, the drift of what is conserved, a mistake."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from kreisel.algebra import Array, floats
from kreisel.checkcases.laws import FLUID, dot, rotation
from kreisel.checkcases.mistakes import SIGNIFICANT, Mistake, differences, likely, misfit, size
from kreisel.errors import InputError, shown

if TYPE_CHECKING:
    from kreisel.checkcases.motion import Case

WIDTHS = {
    "angular_velocity": 3,
    "angular_velocity_space": 3,
    "attitude": 4,
    "momentum": 3,
    "position": 3,
    "velocity": 3,
    "energy": 0,
}
NORM = 0.01  # largest error of the norm of the first quaternion
UNNORMALISED = 1e-6
RIGHT = 1e-3  # relative error below which a trajectory is called right
ROUNDING = 1e-12  # relative: below it the order is not measured
FEWEST, MOST = 4, 12  # digits of numbers that were printed with few


@dataclass(frozen=True)
class Row:
    """The largest error of a quantity, when it occurs, the error at the end, and the largest relative to the size."""

    quantity: str
    largest: float
    time: float
    last: float
    unit: str
    relative: float


@dataclass(frozen=True)
class Drift:
    """The largest change of a conserved quantity, relative to its size, and when it occurs."""

    quantity: str
    largest: float
    time: float
    last: float


@dataclass(frozen=True)
class Grade:
    """The errors of a trajectory.  `str(grade)` is the table that `kreisel checkcase NAME --grade FILE` prints.

    rows      of the table
    drifts    of energy and momentum, from the trajectory's angular velocity and attitude with the inertia of the case
    steps     (step, relative error) of each run, if several were given, and `orders` between them
    times, errors   errors against time, s, in the units of `rows`
    relative  the largest relative error;  `digits` that agree
    mistake   the mistake that explains the error, or None
    notes, verdict   sentences
    """

    case: str
    rows: tuple[Row, ...]
    drifts: tuple[Drift, ...]
    steps: tuple[tuple[float, float], ...]
    orders: tuple[float, ...]
    times: Array
    errors: Mapping[str, Array]
    relative: float
    mistake: Mistake | None
    notes: tuple[str, ...]

    @property
    def digits(self) -> int:
        """The number of decimal digits that agree."""
        return max(0, math.floor(-math.log10(max(self.relative, 1e-15))))

    @property
    def verdict(self) -> str:
        """Sentences: the order, whether the trajectory is right, the likely mistake."""
        order = f"Order measured: {', '.join(f'{v:.2f}' for v in self.orders)}. " if self.orders else ""
        if self.mistake:
            return f"{order}Likely mistake: {self.mistake}."
        agreed = f"agrees with the exact motion to {self.digits} digits"
        if self.orders and min(self.orders) > 0.5:
            return f"{order}Right: the trajectory {agreed} and converges to it with order {round(self.orders[-1])}."
        if self.relative < SIGNIFICANT:
            return f"{order}Right: the trajectory {agreed}."
        if self.relative < RIGHT:
            return f"{order}Right: the trajectory {agreed}; no listed mistake explains the remaining error."
        return f"{order}The trajectory {agreed}; no listed mistake explains the error."

    def data(self) -> dict[str, Any]:
        """The table as data for JSON."""
        return {
            "case": self.case,
            "relative": self.relative,
            "digits": self.digits,
            "verdict": self.verdict,
            "mistake": None if self.mistake is None else self.mistake._asdict(),
            "notes": list(self.notes),
            "errors": [asdict(row) for row in self.rows],
            "drifts": [asdict(drift) for drift in self.drifts],
            "steps": [list(pair) for pair in self.steps],
            "orders": list(self.orders),
        }

    def __str__(self) -> str:
        lines = [f"{'quantity':<24}{'largest error':>16}{'at t, s':>11}{'at the end':>12}{'relative':>11}"]
        lines += [
            f"{row.quantity:<24}{f'{row.largest:.3e} {row.unit}':>16}{row.time:>11.6g}{row.last:>12.3e}"
            f"{row.relative:>11.1e}"
            for row in self.rows
        ]
        if self.drifts:
            lines += ["", f"{'drift':<24}{'largest, relative':>16}{'at t, s':>10}{'at the end':>12}"]
            lines += [f"{d.quantity:<24}{d.largest:>16.3e}{d.time:>11.6g}{d.last:>12.3e}" for d in self.drifts]
        if self.steps:
            lines += ["", f"{'step, s':<24}{'relative error':>16}{'order':>11}"]
            orders = ["", *(f"{order:.2f}" for order in self.orders)]
            lines += [f"{h:<24.6g}{e:>16.3e}{o:>11}" for (h, e), o in zip(self.steps, orders, strict=False)]
        return "\n".join([*lines, "", *self.notes, self.verdict])


def grade(case: Case, times: Any, quantities: Mapping[str, Any], step: float | None = None, runs: Any = ()) -> Grade:
    """The grade of a trajectory; arguments as in `Case.grade`.  Raises `InputError`."""
    rows, values, exact = _compared(case, times, quantities)
    errors = {name: differences(name, value, exact[name]) for name, value in values.items()}
    units = case.reference(rows[:1])
    table = []
    for name, error in errors.items():
        at = int(np.argmax(error))
        unit = "rad" if name == "attitude" else str(units[name].attrs["units"])
        relative = float(error[at]) / size(name, exact[name])
        table.append(Row(name, float(error[at]), float(rows[at]), float(error[-1]), unit, relative))
    steps = [(_step(rows, step), misfit(values, exact, exact))]
    for run in runs:
        other, its, truth = _compared(case, run.times, run.quantities)
        steps.append((_step(other, getattr(run, "step", None)), misfit(its, truth, truth)))
    orders = _orders(steps)
    converges = bool(orders) and min(orders) > 1.5
    mistake = None if converges else _unnormalised(values, steps[0][1]) or likely(case, rows, values, exact, step)
    return Grade(
        case.name, tuple(table), _drifts(case, rows, values), tuple(steps) if runs else (), orders, rows, errors,
        steps[0][1], mistake, tuple(_notes(values, exact, steps[0][1])),
    )  # fmt: skip


def _compared(
    case: Case, times: Any, quantities: Mapping[str, Any]
) -> tuple[Array, dict[str, Array], dict[str, Array]]:
    """The times, the quantities, and the exact ones."""
    rows = increasing(floats(times))
    allowed = {**WIDTHS}
    if not quantities:
        raise InputError(f"grade: expected at least one of {', '.join(allowed)}, got none.")
    values = {name: checked(name, value, len(rows)) for name, value in quantities.items()}
    reference = case.reference(rows)
    if missing := [name for name in values if name not in reference]:
        raise InputError(
            f"grade: expected quantities of the case {case.name}, {', '.join(map(str, reference))}, got {missing[0]}."
        )
    return rows, values, {str(name): reference[name].values for name in reference}


def increasing(times: Array, source: str = "times") -> Array:
    """The times themselves.  Raises `InputError` unless they are two or more, finite and increasing."""
    if times.ndim != 1 or len(times) < 2:
        count = len(times) if times.ndim == 1 else shown(times)
        raise InputError(f"{source}: expected at least two rows, of increasing times, got {count}.")
    if not np.isfinite(times).all():
        at = int(np.argmin(np.isfinite(times)))
        raise InputError(f"{source}: expected finite times, got {times[at]} in row {at + 1}.")
    if (np.diff(times) <= 0).any():
        at = int(np.argmax(np.diff(times) <= 0))
        cause = "the row is there twice" if times[at] == times[at + 1] else "several runs in one file"
        raise InputError(
            f"{source}: expected increasing times, got {times[at]:.10g} in row {at + 1} and {times[at + 1]:.10g} in "
            f"row {at + 2}. Usual cause: {cause}; leave one out."
        )
    return times


def checked(name: str, value: Any, count: int) -> Array:
    """The array of a quantity.  Raises `InputError`."""
    if name not in WIDTHS:
        raise InputError(f"grade: expected one of {', '.join(WIDTHS)}, got {shown(name)}.")
    array, shape = floats(value), (count, WIDTHS[name]) if WIDTHS[name] else (count,)
    if array.shape != shape:
        raise InputError(f"{name}: expected finite numbers of shape {shape}, got {shown(value)}.")
    if not np.isfinite(array).all():
        at = int(np.argmin(np.isfinite(array).reshape(count, -1).all(-1)))
        raise InputError(
            f"{name}: expected finite numbers, got {shown(array[at].tolist())} in row {at + 1}. Leave out the rows "
            "from there on, where the simulation failed."
        )
    if name == "attitude" and abs(norm := float(np.linalg.norm(array[0])) - 1) > NORM:
        raise InputError(
            f"attitude: expected unit quaternions, got {shown(array[0].tolist())}, of norm {norm + 1:.6g}, in row 1. "
            "Usual cause: other columns than those of the quaternion; divide by the norm if they are right."
        )
    return array


def _step(rows: Array, step: float | None) -> float:
    return float(step) if step else float(rows[-1] - rows[0]) / (len(rows) - 1)


def _orders(steps: Sequence[tuple[float, float]]) -> tuple[float, ...]:
    """The orders between successive runs whose errors are above rounding."""
    return tuple(
        math.log(a[1] / b[1]) / math.log(a[0] / b[0])
        for a, b in pairwise(steps)
        if min(a[1], b[1]) > ROUNDING and a[0] != b[0] and math.isfinite(a[1] * b[1])
    )


def _unnormalised(values: Mapping[str, Array], error: float) -> Mistake | None:
    if "attitude" not in values:
        return None
    raw = float(abs(np.linalg.norm(values["attitude"], axis=-1) - 1).max())
    if raw < max(UNNORMALISED, 20 * error):
        return None
    return Mistake(f"the quaternion is not normalised: its norm is off by up to {raw:.1e}", error, raw)


def _drifts(case: Case, rows: Array, values: Mapping[str, Array]) -> tuple[Drift, ...]:
    """The drifts of what the case conserves, as far as the trajectory determines them."""
    w, q, law = values.get("angular_velocity"), values.get("attitude"), case.law
    attitude = np.broadcast_to([1.0, 0, 0, 0], (len(rows), 4)) if q is None else q / np.linalg.norm(q, axis=-1)[:, None]
    if w is None and q is not None and "angular_velocity_space" in values:
        w = np.einsum("jir,rj->ri", np.array(rotation(attitude.T)), values["angular_velocity_space"])
    if w is None or not law.conserved or (q is None and "momentum" not in law.conserved):
        return ()
    further = (
        np.array([[float(v) for v in case.exact(t)[0][7:]] for t in rows]) if law.further else np.empty((len(rows), 0))
    )
    if law is FLUID:
        if "velocity" not in values:
            return ()
        further = np.concatenate([values["velocity"], further[:, 3:]], -1)
    found = case.quantities(np.concatenate([w, attitude, further], -1))
    L = found["momentum"]
    length = np.linalg.norm(L, axis=-1)
    series = {"energy": (found["energy"], 0.0)}
    if "momentum" in law.conserved:
        series["length of the momentum"] = length, 0.0
        if q is not None:
            series["momentum"] = L, 0.0
    if "vertical momentum" in law.conserved:
        series["vertical momentum"] = L[:, 2], float(length[0])
    if law is FLUID:
        impulse = np.array(case.numeric()["A"]) @ values["velocity"].T
        series["impulse"] = np.array([dot(row, impulse) for row in rotation(attitude.T)]).T, 0.0
    drifts = []
    for name, (value, scale) in series.items():
        change = differences("", value, value[:1])
        at, unit = int(np.argmax(change)), scale or size("", value[:1])
        drifts.append(Drift(name, float(change[at] / unit), float(rows[at]), float(change[-1] / unit)))
    return tuple(drifts)


def _notes(values: Mapping[str, Array], exact: Mapping[str, Array], error: float) -> list[str]:
    """Sentences on the start, on the precision and on the digits of the numbers."""
    notes = []
    for name, value in values.items():
        off = float(differences(name, value[:1], exact[name][:1])[0]) / size(name, exact[name])
        if off > max(1e-3, 1e-3 * error):
            notes.append(
                f"The first row differs: {name} {shown(value[0].tolist())}, exact {shown(exact[name][0].tolist())}."
            )
    numbers = np.concatenate([value.ravel() for value in values.values()])
    with np.errstate(all="ignore"):
        short = numbers.astype(np.float32)
    digits = next((d for d in range(1, MOST + 1) if np.array_equal(np.round(numbers, d), numbers)), None)
    if digits and digits >= FEWEST:
        notes.append(
            f"All numbers are printed with {digits} decimals: errors up to {0.5 * 10**-digits:.0e} are of printing."
        )
    elif np.array_equal(short.astype(str).astype(float), numbers) or np.array_equal(short, numbers):
        notes.append("All numbers are of single precision: relative errors of 6e-8 and above are of rounding.")
    return notes
