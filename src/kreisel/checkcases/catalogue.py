"""A check case: a body, its start, the exact motion with a certified error; the cases of catalogue.toml."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cache
from importlib.resources import files
from typing import TYPE_CHECKING, Any, NamedTuple

import mpmath
import numpy as np

from kreisel.algebra import Array, floats
from kreisel.algebra.reuse import cached_property
from kreisel.checkcases import laws
from kreisel.checkcases.laws import FREE, QUANTITIES, Law, arrays, dot, exact, inverse, real, rotated, rotation, times
from kreisel.checkcases.taylor import Solution
from kreisel.errors import InputError, explained, shown

if TYPE_CHECKING:
    import xarray as xr

    from kreisel.checkcases.grade import Grade

ABOUT = ("title", "about", "source", "law", "duration", "bits")
Numbers = Mapping[str, Any]  # rational, in SI
BITS = 112  # of the Taylor series: 33 digits, of which the bound of the error leaves 14 or more
ROWS = 301


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
                dict(zip(("units", "long_name"), QUANTITIES[name][:2], strict=True)),
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
            if name in QUANTITIES:
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
                "of time, times that are not 0 at the start, or a run longer than the case; leave the later rows out."
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
        """The values that a simulator needs, as doubles in SI, for JSON; gravity is along -z of space."""
        numbers = {k: _doubles(exact(text)) for k, text in self.numbers.items() if not k.startswith("tilt_")}
        return {
            "name": self.name,
            **numbers,
            "inertia": _doubles(self.inertia),
            "attitude": _doubles(self.attitude),
            "duration": float(self.duration),
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


# -- the cases of catalogue.toml, and the formulas of the further values that they ask for ---------


def records() -> dict[str, Case]:
    """All cases, by name."""
    return {name: _case(name, record) for name, record in _printed().items()}


@cache
def _printed() -> dict[str, dict[str, Any]]:
    return tomllib.loads(files("kreisel.checkcases").joinpath("catalogue.toml").read_text(encoding="utf-8"))


def law_of(name: str) -> str:
    """The name of the law of a case, as in catalogue.toml."""
    return str(_printed()[name]["law"])


def _case(name: str, record: dict[str, Any]) -> Case:
    printed = {key: value for key, value in record.items() if key not in ABOUT}
    numbers = {key: exact(text) for key, text in printed.items()}
    law, parameters, further = LAWS[record["law"]](numbers)
    tilt = next(
        (rotated(axis, numbers[f"tilt_{axis + 1}"]) for axis in range(3) if f"tilt_{axis + 1}" in numbers), None
    )
    return Case(
        name, record["title"], " ".join(record["about"].split()), record["source"], printed, _tensor(numbers),
        numbers["angular_velocity"], exact(record["duration"]), tilt or [Fraction(k == 0) for k in range(4)], law,
        parameters, further, numbers.get("arm"), _answers(name, record["law"], numbers), record.get("bits", BITS),
    )  # fmt: skip


def _tensor(numbers: Numbers) -> list[list[Fraction]]:
    """The inertia tensor along the body axes, about the centre of mass or the fixed point."""
    if "sides" in numbers:
        squares = [numbers["mass"] * s * s / 12 for s in numbers["sides"]]
        moments = [sum(squares) - s for s in squares]
    else:
        moments = numbers.get("inertia") or numbers["central_inertia"]
    if "principal_axes" in numbers:
        R = [numbers["principal_axes"][k : k + 3] for k in (0, 3, 6)]
        return [[sum(R[i][k] * moments[k] * R[j][k] for k in range(3)) for j in range(3)] for i in range(3)]
    tensor = _diagonal(moments)
    if "central_inertia" in numbers:  # Steiner
        mass, arm = numbers["mass"], numbers["arm"]
        square = sum(a * a for a in arm)
        tensor = [[tensor[i][j] + mass * (square * (i == j) - arm[i] * arm[j]) for j in range(3)] for i in range(3)]
    return tensor


def _diagonal(moments: list[Fraction]) -> list[list[Fraction]]:
    return [[moments[i] if i == j else Fraction(0) for j in range(3)] for i in range(3)]


Parts = tuple[Law, dict[str, Any], list[Fraction]]  # the law, its parameters, its further variables at the start


def _field(numbers: Numbers) -> Parts:
    if "torque" in numbers:
        return laws.FIELD, {"k": numbers["torque"]}, []
    return laws.FIELD, {"k": [-numbers["mass"] * numbers["gravity"] * a for a in numbers["arm"]]}, []


def _gyromagnetic(numbers: Numbers) -> Parts:
    gamma, steady = numbers["gyromagnetic_ratio"], numbers["steady_field"]
    parameters = {"gamma": gamma, "B": steady, "b": numbers["rotating_field"], "n": -gamma * steady}
    return laws.GYROMAGNETIC, parameters, [Fraction(1), Fraction(0)]


def _orbit(numbers: Numbers) -> Parts:
    return laws.ORBIT, {"n": exact("360 deg") / numbers["orbital_period"]}, [Fraction(1), Fraction(0)]


def _fluid(numbers: Numbers) -> Parts:
    A = _diagonal(numbers["effective_mass"])
    return laws.FLUID, {"A": A, "A inverse": inverse(A)}, [*numbers["velocity"], *[Fraction(0)] * 3]


def _air(numbers: Numbers) -> Parts:
    """Constants of WGS 84 and of the US Standard Atmosphere 1976."""
    a, mu, J2, spin = (Fraction(v) for v in ("6378137", "398600441800000", "0.00108262982", "0.00007292115"))
    r0, lapse, sea = Fraction(6356766), Fraction("0.0065"), Fraction("288.15")
    h = numbers["altitude"]
    R0, temperature = a + h, sea - lapse * r0 * h / (r0 + h)
    exponent = Fraction("9.80665") * Fraction("28.9644") / (Fraction("8314.32") * lapse) - 1
    density = Fraction("1.225") * real(lambda ratio, power: ratio**power, temperature / sea, exponent)
    parameters = {
        "S": numbers["area"],
        "l": numbers["lengths"],
        "C": numbers["coefficients"],
        "gravity": mu / R0**2,
        "centrifugal": spin**2 * R0,
        "oblateness": Fraction(3, 2) * J2 * mu * a**2 / R0**4,
        "1/R0": 1 / R0,
        "1/r0": 1 / r0,
        "lapse": lapse / temperature,
        "exponent": exponent,
    }
    return laws.AIR, parameters, [Fraction(1), Fraction(0), r0 / (r0 + h), Fraction(1), density]


LAWS: dict[str, Callable[[Numbers], Parts]] = {
    "free": lambda numbers: (laws.FREE, {}, []),
    "field": _field,
    "wheel": lambda numbers: (laws.GYROSTAT, {"h": numbers["wheel_momentum"]}, []),
    "damped": lambda numbers: (laws.DAMPED, {"c": numbers["damping"]}, []),
    "orbit": _orbit,
    "gyromagnetic": _gyromagnetic,
    "fluid": _fluid,
    "air": _air,
}


def _answers(name: str, law: str, numbers: Numbers) -> Callable[[Case], list[Answer]]:
    if name == "on-the-separatrix":
        return _of_separatrix
    if law == "field" and "mass" in numbers and numbers["arm"][:2] == [0, 0]:
        return _of_top
    others = {"free": _of_free, "orbit": _of_libration, "gyromagnetic": _of_rabi, "damped": _of_damping}
    return others.get(law, lambda case: [])


def _of_free(case: Case) -> list[Answer]:
    from kreisel.physical import FreeBody

    body = case.given()
    motion, call = FreeBody(body["inertia"]).rotation(body["angular_velocity"]), "kr.physical.FreeBody(I).rotation(w)"
    flips = motion.flips(float(case.duration))
    answers = [
        Answer("period of the momentum in the body", motion.period, "s", f"{call}.period"),
        Answer("mean precession about the momentum", motion.precession, "rad/s", f"{call}.precession"),
        *(Answer(f"flip {k}", float(t), "s", f"{call}.flips(duration)") for k, t in enumerate(flips[:3], 1)),
    ]
    return [answer for answer in answers if math.isfinite(answer.value)]


def _of_top(case: Case) -> list[Answer]:
    from kreisel.physical import Gyroscope
    from kreisel.runs.closed_form import nutation

    body = case.given()
    moments, R = np.array(body["inertia"]), np.array(laws.rotation(body["attitude"]))
    top = Gyroscope(body["mass"], moments[2, 2], moments[0, 0], body["arm"][2], body["gravity"])
    m = R @ moments @ np.array(body["angular_velocity"]) / top.momentum_unit
    motion, call = nutation(top.model(), top.model().state(m=m, a=R[:, 2])), "kr.nutation, times in Gyroscope.time_unit"
    return [
        Answer("period of the nutation", motion.period * top.time_unit, "s", call),
        Answer("mean precession", motion.precession / top.time_unit, "rad/s", call),
    ]


def _of_separatrix(case: Case) -> list[Answer]:
    I1, I2, I3 = (float(case.inertia[k][k]) for k in range(3))
    w = [float(v) for v in case.angular_velocity]
    rate = math.hypot(I1 * w[0], I2 * w[1], I3 * w[2]) / I2
    growth = rate * math.sqrt((I2 - I1) * (I3 - I2) / (I1 * I3))
    return [
        Answer("rotation about the middle axis that is approached", rate, "rad/s", "L/I2"),
        Answer("growth rate", growth, "1/s", "(L/I2) sqrt((I2 - I1)(I3 - I2)/(I1 I3)), w2 = (L/I2) tanh"),
        Answer("time at which w2 = 0", math.atanh(abs(w[1]) / rate) / growth, "s", "atanh(|w2| I2/L)/growth"),
    ]


def _of_libration(case: Case) -> list[Answer]:
    I1, I2, I3 = (float(case.inertia[k][k]) for k in range(3))
    pitch = 2 * math.atan2(float(case.attitude[3]), float(case.attitude[0]))
    rate = float(case.parameters["n"]) * math.sqrt(3 * (I2 - I1) / I3)
    period = 4 * float(mpmath.ellipk(math.sin(pitch) ** 2)) / rate
    return [Answer("period of the libration", period, "s", "4 K(k)/(n sqrt(3 (I2 - I1)/I3)), k = sin(40 deg)")]


def _of_rabi(case: Case) -> list[Answer]:
    p = case.parameters
    return [Answer("first inversion of the momentum", math.pi / float(p["gamma"] * p["b"]), "s", "pi/(gamma b)")]


def _of_damping(case: Case) -> list[Answer]:
    c, end = float(case.parameters["c"]), float(case.duration)
    return [
        Answer("|L| at the end by |L| at the start", math.exp(-c * end), "1", "exp(-c t)"),
        Answer("time of the free motion that is reached", -math.expm1(-c * end) / c, "s", "(1 - exp(-c t))/c"),
    ]
