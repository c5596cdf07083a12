"""The check cases of catalogue.toml, and the formulas of the further values that they ask for."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Callable, Mapping
from fractions import Fraction
from functools import cache
from importlib.resources import files
from typing import Any

import mpmath
import numpy as np

from kreisel.checkcases import laws
from kreisel.checkcases.exactly import exact, inverse, real, rotated
from kreisel.checkcases.laws import Law
from kreisel.checkcases.motion import BITS, Answer, Case

ABOUT = ("title", "about", "source", "law", "duration", "bits")
Numbers = Mapping[str, Any]  # rational, in SI


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
