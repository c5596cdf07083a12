"""The grade of a trajectory: its errors against the exact motion, the drift of the integrals, a mistake."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from kreisel.algebra import Array, floats
from kreisel.checkcases.laws import FLUID, QUANTITIES, dot, rotation
from kreisel.checkcases.mistakes import SIGNIFICANT, Mistake, body_rates, differences, likely, misfit, size
from kreisel.errors import InputError, shown

if TYPE_CHECKING:
    from kreisel.checkcases.catalogue import Case

NORM = 0.01  # largest error of the norm of the first quaternion
CLOSE = 1e-3  # relative
LARGEST = 1e100  # number
UNNORMALISED = 1e-6
RIGHT = 1e-3  # relative error below which a trajectory is called right
SECOND = 1.5  # order measured above which no mistake is looked for
ROUNDING = 1e-12  # relative: below it the order is not measured
FEWEST, MOST = 4, 12  # digits of values that were printed with few


@dataclass(frozen=True)
class Row:
    """The largest error or drift of a quantity, its time, the value at the end, the largest relative to the size."""

    quantity: str
    largest: float
    time: float
    last: float
    unit: str
    relative: float


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
    drifts: tuple[Row, ...]
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
            return f"{order}Likely cause: {self.mistake}."
        agreed = f"agrees with the exact motion to {self.digits} digits"
        if self.orders and min(self.orders) > 0.5:
            return f"{order}Right: the trajectory {agreed} and converges to it with order {round(self.orders[-1])}."
        if self.relative < SIGNIFICANT:
            return f"{order}Right: the trajectory {agreed}."
        if self.relative < RIGHT:
            return f"{order}Right: the trajectory {agreed}; no listed mistake explains the remaining error."
        constant = bool(self.orders) and max(self.orders) < 0.5
        wrong = " The error does not decrease with the step: the equations or the start differ." * constant
        return f"{order}The trajectory {agreed}; no listed mistake explains the error.{wrong}"

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
        head = f"{'largest':>16}{'at t, s':>18}{'at the end':>13}{'relative':>11}"
        lines = []
        for title, rows in (("error of", self.rows), ("drift of", self.drifts)):
            lines += [f"{title:<26}{head}"] if rows else []
            for row in rows:
                largest, last = f"{row.largest:>16.3e} {row.unit:<9}", f"{row.last:>13.3e}{row.relative:>11.1e}"
                lines.append(f"{row.quantity:<26}{largest}{row.time:>8.6g}{last}")
            lines += [""] if rows else []
        if self.steps:
            orders = ["", *(f"{order:.2f}" for order in self.orders)]
            lines += [f"{'step, s':<26}{'relative error':>16}{'order':>18}"]
            lines += [f"{h:<26.6g}{e:>16.3e}{o:>18}" for (h, e), o in zip(self.steps, orders, strict=False)]
            lines += [""]
        return "\n".join([*lines, *self.notes, self.verdict])


def grade(case: Case, times: Any, quantities: Mapping[str, Any], step: float | None = None, runs: Any = ()) -> Grade:
    """The grade of a trajectory; arguments as in `Case.grade`.  Raises `InputError`."""
    rows, values, exact, units = _compared(case, times, quantities)
    errors = {name: differences(name, value, exact[name]) for name, value in values.items()}
    table = [_row(name, error, rows, units[name], size(name, exact[name])) for name, error in errors.items()]
    relative = max(row.relative for row in table)
    steps = [(_step(rows, step), relative)]
    for run in runs:
        if not (hasattr(run, "times") and hasattr(run, "quantities")):
            raise InputError(
                f"runs: expected trajectories as kreisel.checkcases.reading.read returns, got {shown(run)}."
            )
        instants, its, truth, _ = _compared(case, run.times, run.quantities)
        steps.append((_step(instants, getattr(run, "step", None)), misfit(its, truth, truth)))
    orders = tuple(
        math.log(a[1] / b[1]) / math.log(a[0] / b[0])
        for a, b in pairwise(steps)
        if min(a[1], b[1]) > ROUNDING and a[0] != b[0]
    )
    converges = bool(orders) and min(orders) > SECOND
    mistake = None if converges else _unnormalised(values, relative) or likely(case, rows, values, exact, step)
    return Grade(
        case.name, tuple(table), tuple(_drifts(case, rows, values, units)), tuple(steps) if runs else (), orders, rows,
        errors, relative, mistake, tuple(_notes(values, exact, relative)),
    )  # fmt: skip


def _row(name: str, error: Array, rows: Array, unit: str, scale: float) -> Row:
    at = int(np.argmax(error))
    return Row(name, float(error[at]), float(rows[at]), float(error[-1]), unit, float(error[at]) / (scale or 1.0))


def _compared(
    case: Case, times: Any, quantities: Mapping[str, Any]
) -> tuple[Array, dict[str, Array], dict[str, Array], dict[str, str]]:
    """The times, the quantities, the exact ones, and their units."""
    rows = increasing(floats(times))
    values = {name: checked(name, value, len(rows)) for name, value in quantities.items()}
    reference = case.reference(rows)
    allowed = ", ".join(map(str, reference))
    if not values or (missing := next((name for name in values if name not in reference), "")):
        raise InputError(
            f"grade: expected some of the case's quantities, {allowed}, got {missing if values else 'none'}."
        )
    units = {str(name): "rad" if name == "attitude" else str(reference[name].attrs["units"]) for name in reference}
    return rows, values, {name: reference[name].values for name in units}, units


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
    if name not in QUANTITIES:
        raise InputError(f"grade: expected one of {', '.join(QUANTITIES)}, got {shown(name)}.")
    array, width = floats(value), QUANTITIES[name][2]
    shape = (count, width) if width else (count,)
    if array.shape != shape:
        raise InputError(f"{name}: expected finite values of shape {shape}, got {shown(value)}.")
    if not (finite := np.abs(array) < LARGEST).all():
        at = int(np.argmin(finite.reshape(count, -1).all(-1)))
        raise InputError(
            f"{name}: expected finite values, got {shown(array[at].tolist())} in row {at + 1}. Leave out the rows "
            "from there on, where the simulation failed."
        )
    if name == "attitude":
        norms = np.linalg.norm(array, axis=-1)
        at = int(np.argmin(norms)) if norms.min() < NORM else 0
        if abs(norms[at] - 1) > NORM:
            raise InputError(
                f"attitude: expected unit quaternions, got {shown(array[at].tolist())}, of norm {norms[at]:.6g}, "
                f"in row {at + 1}. Usual cause: columns that are not the quaternion. If they are right, divide "
                "by the norm."
            )
    return array


def _step(rows: Array, step: float | None) -> float:
    spacing = float(rows[-1] - rows[0]) / (len(rows) - 1)
    if step is not None and not (np.ndim(step) == 0 and 0 < floats(step) <= spacing * (1 + CLOSE)):
        raise InputError(
            f"step: expected a step in s of at most {spacing:.6g}, the spacing of the rows, got {shown(step)}."
        )
    return float(step or spacing)


def _unnormalised(values: Mapping[str, Array], error: float) -> Mistake | None:
    if "attitude" not in values:
        return None
    raw = float(abs(np.linalg.norm(values["attitude"], axis=-1) - 1).max())
    if raw < max(UNNORMALISED, 20 * error):
        return None
    return Mistake(f"the quaternion is not normalised: its norm is off by up to {raw:.1e}", error, raw)


def _drifts(case: Case, rows: Array, values: Mapping[str, Array], units: Mapping[str, str]) -> Iterator[Row]:
    """The drifts of the integrals of the case, as far as the trajectory determines them."""
    w, q, law = body_rates(values), values.get("attitude"), case.law
    if w is None or not law.conserved or (q is None and "momentum" not in law.conserved):
        return
    if law is FLUID and "velocity" not in values:
        return
    states = np.array([[float(v) for v in case.exact(t)[0]] for t in rows]) if law.further else np.zeros((len(rows), 7))
    q_rows = np.array([[1.0, 0, 0, 0]]) if q is None else q / np.linalg.norm(q, axis=-1, keepdims=True)
    states[:, :3], states[:, 3:7] = w, q_rows
    if law is FLUID:
        states[:, 7:10] = values["velocity"]
    conserved = case.quantities(states)
    L, unit = conserved["momentum"], units["momentum"]
    length = np.linalg.norm(L, axis=-1)
    yield _drift("energy", conserved["energy"], rows, units["energy"])
    if "momentum" in law.conserved:
        yield _drift("length of the momentum", length, rows, unit)
        if q is not None:
            yield _drift("momentum", L, rows, unit)
    if "vertical momentum" in law.conserved:
        yield _drift("vertical momentum", L[:, 2], rows, unit, float(length[0]))
    if law is FLUID:
        impulse = np.array(case.numeric()["A"]) @ values["velocity"].T
        yield _drift("impulse", np.array([dot(row, impulse) for row in rotation(q_rows.T)]).T, rows, "kg m/s")


def _drift(name: str, value: Array, rows: Array, unit: str, scale: float = 0.0) -> Row:
    return _row(name, differences("", value, value[:1]), rows, unit, scale or size("", value[:1]))


def _notes(values: Mapping[str, Array], exact: Mapping[str, Array], error: float) -> list[str]:
    """Sentences on the start, on the precision and on the digits of the values."""
    notes = []
    for name, value in values.items():
        off = float(differences(name, value[:1], exact[name][:1])[0]) / size(name, exact[name])
        if off > max(CLOSE, CLOSE * error):
            notes.append(
                f"The first row differs: {name} {shown(value[0].tolist())}, exact {shown(exact[name][0].tolist())}."
            )
    numbers = np.concatenate([value.ravel() for value in values.values()])
    with np.errstate(all="ignore"):
        short = numbers.astype(np.float32)
    digits = next((d for d in range(1, MOST + 1) if np.array_equal(np.round(numbers, d), numbers)), None)
    if digits and digits >= FEWEST:
        notes.append(
            f"All values are printed with {digits} decimals: errors up to {0.5 * 10**-digits:.0e} come from printing."
        )
    elif np.array_equal(short.astype(str).astype(float), numbers) or np.array_equal(short, numbers):
        notes.append("All values are in single precision: relative errors of 6e-8 and above come from rounding.")
    return notes
