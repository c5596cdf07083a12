"""A check case: a body, its start, the exact motion with a certified error."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from kreisel.algebra import Array, floats
from kreisel.algebra.reuse import cached_property
from kreisel.checkcases.exactly import exact, inverse
from kreisel.checkcases.laws import FREE, Law, arrays, dot, rotation, times
from kreisel.checkcases.taylor import Solution
from kreisel.errors import InputError, explained, shown

if TYPE_CHECKING:
    import xarray as xr

    from kreisel.checkcases.grade import Grade

BITS = 112  # of the Taylor series: 33 digits, of which the bound of the error leaves 14 or more
ROWS = 301
UNITS = {
    "angular_velocity": ("rad/s", "angular velocity along the body axes"),
    "angular_velocity_space": ("rad/s", "angular velocity along the axes of space"),
    "attitude": ("1", "attitude, a unit quaternion (w, x, y, z), body to space"),
    "momentum": ("kg m^2/s", "angular momentum along the axes of space"),
    "energy": ("J", "energy"),
    "position": ("m", "position in space"),
    "velocity": ("m/s", "velocity along the body axes"),
}


class Answer(NamedTuple):
    """A number that a case asks for: its meaning, value and unit, and the formula or call that gives it."""

    meaning: str
    value: float
    unit: str
    source: str


@explained
@dataclass(frozen=True, eq=False)
class Case:
    """A motion whose exact course is known.  `kreisel.checkcases.case(NAME)` returns it.

    name, title, about, source   text: a word, a line, the physics, where the values come from
    law              the torque (`kreisel.checkcases.laws`)
    numbers          name -> printed value with its unit: the input of a simulator
    inertia          I about the fixed point or the centre of mass, along the body axes, 3 x 3 rational, kg m^2
    angular_velocity, attitude   the start: rad/s along the body axes; unit quaternion (w, x, y, z), body to space
    duration         s
    parameters, further   of the law, rational
    answers          further values that the case asks for
    bits             of the Taylor series
    """

    name: str
    title: str
    about: str
    source: str
    numbers: Mapping[str, str]
    inertia: list[list[Fraction]]
    angular_velocity: list[Fraction]
    duration: Fraction
    attitude: list[Fraction] = field(default_factory=lambda: [Fraction(k == 0) for k in range(4)])
    law: Law = FREE
    parameters: Mapping[str, Any] = field(default_factory=dict)
    further: list[Fraction] = field(default_factory=list)
    arm: list[Fraction] | None = None
    answers: Callable[[Case], list[Answer]] = lambda case: []
    bits: int = BITS

    @cached_property
    def _motion(self) -> Solution:
        unit = self.inertia[0][0]  # of the moments, so that the values of the series are moderate
        values = {"I": _over(self.inertia, unit), "inverse": _over(inverse(self.inertia), 1 / unit)}
        scale = {**dict.fromkeys(self.law.scaled, unit), "A inverse": 1 / unit}
        values.update({name: _over(v, scale.get(name, 1)) for name, v in self.parameters.items()})
        entries: list[Fraction] = []

        def place(value: Any) -> Any:
            if isinstance(value, list):
                return [place(v) for v in value]
            if value.denominator & (value.denominator - 1) == 0:
                return float(value) if value else 0.0
            entries.append(value)
            return len(entries) - 1

        places = {name: place(value) for name, value in values.items()}

        def flow(z: Any, p: Any) -> list[Any]:
            def put(value: Any) -> Any:
                if isinstance(value, list):
                    return [put(v) for v in value]
                return p[value] if isinstance(value, int) else value

            return self.law.flow(z[:3], z[3:7], z[7:], {name: put(value) for name, value in places.items()})

        start = [*self.angular_velocity, *self.attitude, *self.further]
        return Solution(flow, start, entries, self.duration, self.bits)

    def numeric(self) -> dict[str, Any]:
        """The law's parameters as doubles."""
        values = {"I": self.inertia, "inverse": inverse(self.inertia), **self.parameters}
        return {name: _doubles(value) for name, value in values.items()}

    def exact(self, time: Fraction | float) -> tuple[list[Fraction], Array]:
        """The state (w, q, further) at one time as rationals, and bounds of its errors.  Raises `InputError`."""
        self._check_times(np.array([float(time)]))
        states, bounds = self._motion.at([Fraction(time)])
        return list(states[0]), bounds[0]

    @property
    def digits(self) -> int:
        """The number of decimal digits of w and q that are certain at the end, relative to their largest components."""
        state, bounds = self.exact(self.duration)
        ratios = [max(bounds[s]) / max(abs(float(v)) for v in state[s]) for s in (slice(3), slice(3, 7))]
        return math.floor(-math.log10(max(ratios)))

    def times(self, rows: int = ROWS) -> Array:
        """Equal steps from 0 to the case's duration, s."""
        return np.linspace(0.0, float(self.duration), rows)

    def reference(self, times: Any = None) -> xr.Dataset:
        """The exact motion at times (rows,), s, by default 301 from 0 to the end, rounded to doubles.

        Variables: `angular_velocity` (along the body axes), `attitude` (unit quaternion (w, x, y, z), body to space),
        `angular_velocity_space`, `momentum` (in space), `energy`, `position` if the body moves; units in the attribute
        `units`.  Raises `InputError` for times outside the case.
        """
        import xarray as xr

        rows = self._check_times(self.times() if times is None else floats(times).ravel())
        states, bounds = self._motion.at([Fraction(float(t)) for t in rows])
        values = self.quantities(np.array([[float(v) for v in row] for row in states]))
        data = {
            name: (
                ("time", "component" if array.shape[-1] == 4 else "axis")[: array.ndim],
                array,
                dict(zip(("units", "long_name"), UNITS[name], strict=True)),
            )
            for name, array in values.items()
        }
        attrs = {
            "title": self.title,
            "case": self.name,
            "references": self.source,
            "error_bound": float(bounds[:, :7].max()),
            "certainty": CERTAINTY,
        }
        return xr.Dataset(data, {"time": ("time", rows, {"units": "s"})}, attrs)

    def quantities(self, states: Array) -> dict[str, Array]:
        """The variables of `reference` from states (rows, d)."""
        w, q, x = arrays(states[:, :3]), arrays(states[:, 3:7]), arrays(states[:, 7:])
        p, R = self.numeric(), rotation(q)
        body = [a + b for a, b in zip(times(p["I"], w), self.law.stored(p), strict=True)]
        out = {
            "angular_velocity": states[:, :3],
            "attitude": states[:, 3:7],
            "angular_velocity_space": _columns(times(R, w)),
            "momentum": _columns(times(R, body)),
        }
        if "energy" in self.law.conserved:
            out["energy"] = 0.5 * dot(w, times(p["I"], w)) + self.law.potential(w, q, x, p)
        at = 7
        for name, count in self.law.further:
            if name in UNITS:
                out[name] = states[:, at : at + count]
            at += count
        if self.arm is not None:
            out["position"] = _columns(times(R, [float(v) for v in self.arm]))
        return out

    def _check_times(self, times: Array) -> Array:
        last = float(self.duration)
        if times.size == 0 or not np.isfinite(times).all() or times.min() < 0 or times.max() > last * (1 + 1e-12):
            got = "none" if times.size == 0 else f"{shown(float(times.min()))} to {shown(float(times.max()))}"
            raise InputError(
                f"times: expected times of the case {self.name}, 0 to {last:g} s, got {got}. Usual cause: another unit "
                "of time, or a run that is longer than the case; leave the later rows out."
            )
        return np.minimum(times, last)

    def grade(self, times: Any, *, step: float | None = None, runs: Sequence[Any] = (), **quantities: Any) -> Grade:
        """The errors of a trajectory against the exact motion, and the mistake that explains them.

        times (rows,), s;  angular_velocity (rows, 3), rad/s along the body axes;  attitude (rows, 4), unit quaternions
        (w, x, y, z), body to space;  angular_velocity_space, momentum (rows, 3), energy (rows,), position (rows, 3):
        whichever a simulator has;  step, s, of the simulator, by default from the times;  runs: further trajectories
        with other steps, with `times`, `quantities` and perhaps `step`, as `kreisel.checkcases.reading.read` returns
        them, which measure the order.  Raises `InputError`.
        """
        from kreisel.checkcases.grade import grade

        return grade(self, times, quantities, step, runs)

    def given(self) -> dict[str, Any]:
        """The values that a simulator needs, as doubles in SI, for JSON."""
        return {
            "name": self.name,
            "inertia": _doubles(self.inertia),
            "angular_velocity": _doubles(self.angular_velocity),
            "attitude": _doubles(self.attitude),
            "duration": float(self.duration),
            **({} if self.arm is None else {"arm": _doubles(self.arm)}),
            **{name: _doubles(exact(text)) for name, text in self.numbers.items() if name in ("mass", "gravity")},
        }


CERTAINTY = (
    "Taylor series in fixed point; the error is bounded by the defect of the series and the logarithmic norm of the "
    "Jacobian along it"
)


def _over(value: Any, unit: Fraction | int) -> Any:
    return [_over(v, unit) for v in value] if isinstance(value, list) else value / unit


def _doubles(value: Any) -> Any:
    return [_doubles(v) for v in value] if isinstance(value, list) else float(value)


def _columns(components: Any) -> Array:
    return np.stack(np.broadcast_arrays(*components), -1)
