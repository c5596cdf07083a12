"""An example of every system and body: parameters, a state on its phase space, a step that fits its motion."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from kreisel.bodies import BODIES
from kreisel.errors import InputError, RunError
from kreisel.record.contract import Parameter, System
from kreisel.record.model import Model
from kreisel.runs.planning import make_plan, rate

A_STEP = 0.05  # rad of the motion
TRIED = 400  # combinations of values
SITES = 8  # of a chain
HALVED = 12  # times at most, until a method accepts the step
UNIT = ((0.6, 0.0, 0.8), (0.0, 0.8, 0.6), (0.0, 1.0, 0.0))  # vectors of length 1, to the last bit
SPINS = ((0.6, 0.8, 0.0), (0.0, 0.6, 0.8), (0.8, 0.0, 0.6), (0.0, 0.0, 1.0))
UPRIGHT = [1.0, 0.0, 0.0, 0.0]
SATELLITE = {"moments": [0.00665, 0.03325, 0.03326], "semi_major_axis": 6_878_137.0, "inclination": 1.7}
# Axis 1 away from the Earth, axis 2 ahead, axis 3 along the normal of the orbit: a rotation by its inclination about x.
ON_ORBIT = [0.6599831458849822, 0.7512804051402927, 0.0, 0.0]
AT_REST = "here the rate of the orbit, 1.107e-3 rad/s, about its normal, axis 3: at rest against the orbit"
# Ellipsoids of 400 and 80 m on a circular mutual orbit, the second with one face to the first.
PAIR: dict[str, Any] = {
    "parameters": {
        "m1": 5.4e11,
        "moments1": [2.7e16, 2.8e16, 3.6e16],
        "m2": 4.3e9,
        "moments2": [9.4e12, 9.7e12, 1.32e13],
    },
    "state": {
        "r": [1206.0, 0.0, 0.0],
        "v": [0.0, 0.1736, 0.0],
        "L1": [0.0, 0.0, 2.78e13],
        "q1": UPRIGHT,
        "L2": [0.0, 0.0, 1.9e9],
        "q2": UPRIGHT,
    },
    "meanings": {
        "r": "from body 1 to body 2, in space, m",
        "v": "its rate, m/s",
        "L1": "angular momentum of body 1 about its centre, in space, kg m^2/s",
        "q1": "attitude of body 1, its axes to space, a unit quaternion (w, x, y, z)",
        "L2": "angular momentum of body 2 about its centre, in space, kg m^2/s",
        "q2": "attitude of body 2, its axes to space, a unit quaternion (w, x, y, z)",
    },
    "dt": 1800.0,
}
# Bodies in SI units: parameters, state and its meaning, orientation and step.
OF_BODIES: dict[str, dict[str, Any]] = {
    "satellite": {
        "parameters": SATELLITE,
        "state": {"M": [0.0, 0.0, 3.681e-5]},
        "meanings": {"M": f"I Omega along the principal axes, kg m^2/s; {AT_REST}"},
        "orientation": ON_ORBIT,
        "dt": 60.0,
    },
    "submerged-body": {
        "parameters": {
            "mass_matrix": [[21.0, 0, 0, 0, 0, 0], [0, 38.0, 0, 0, 0, 0], [0, 0, 38.0, 0, 0, 0],
                            [0, 0, 0, 0.108, 0, 0], [0, 0, 0, 0, 3.208, 0], [0, 0, 0, 0, 0, 3.2]],
            "weight": 196.133,
            "buoyancy": 196.133,
            "center_of_mass": [0.02, 0.0, -0.02],
        },
        "state": {"M": [0.0, 0.06, 0.16], "P": [31.46, 0.02, 0.0]},
        "meanings": {
            "M": "angular momentum of body and fluid about the reference point, body axes, kg m^2/s; here 3 deg/s",
            "P": "momentum of body and fluid, body axes, kg m/s; here 1.5 m/s along axis 1",
        },
        "orientation": UPRIGHT,
        "dt": 0.02,
    },
    "binary": PAIR,
    "binary-with-third-body": {
        "parameters": {**PAIR["parameters"], "m3": 1.98841e30},
        "state": {**PAIR["state"], "R": [-29325.0, 0.0, 0.0], "V": [0.0, -2.3e4, 0.0]},
        "meanings": {**PAIR["meanings"], "R": "from the barycentre, 2^23 m", "V": "its velocity, m/s"},
        "dt": 1800.0,
    },
    "binary-with-moon": {
        "parameters": {**PAIR["parameters"], "m3": 1e8, "moments3": [3e10, 4e10, 5e10]},
        "state": {**PAIR["state"], "R": [6e-4, 0.0, 0.0], "V": [0.0, 0.085, 0.0], "L3": [0.0, 3e5, 5e6], "q3": UPRIGHT},
        "meanings": {
            **PAIR["meanings"],
            "R": "of body 3 from the barycentre of the others, 2^23 m",
            "V": "its velocity, m/s",
            "L3": PAIR["meanings"]["L1"].replace("1", "3"),
            "q3": PAIR["meanings"]["q1"].replace("1", "3"),
        },
        "dt": 1800.0,
    },
}  # fmt: skip


@dataclass(frozen=True)
class Example:
    """Plain values: parameters, state, orientation (None without rotation), the step and the method."""

    model: Model
    parameters: dict[str, Any]
    state: dict[str, Any]
    orientation: list[Any] | None
    dt: float
    method: str
    meanings: Mapping[str, str] = field(default_factory=dict)  # of components of the state, if the record has none


def example(system: System, n: int | None = None, values: Mapping[str, Any] | None = None) -> Example:
    """An example of a system, in n dimensions or with n sites.  Raises `InputError` if none is found."""
    body = OF_BODIES.get(system.name) if system is BODIES.get(system.name) else None
    if body is not None:
        parameters = {**body["parameters"], **(values or {})}
        first = [*body["orientation"]] if "orientation" in body else None
        model = system(**parameters)
        if n not in (None, model.n):
            raise InputError(f"{system.name}: expected n = {model.n}, got n = {n}.")
        result = _planned(model, parameters, body["state"], first, body["dt"])
        return replace(result, meanings=body["meanings"])
    size = n or system.n or (SITES if system.space.name.startswith("(so(3)") else 3)
    last: Exception = InputError(f"{system.name}: no example was found.")
    for parameters in itertools.islice(_parameters(system, size, values or {}), TRIED):
        try:
            model = system(**parameters)
        except InputError as error:
            last = error
            continue
        if n not in (None, model.n):
            last = InputError(f"expected n = {model.n}, got n = {n}.")
            continue
        for state in itertools.islice(_states(model), TRIED):
            try:
                model.state(**state)
                turns = model.n == 3 and system.velocity is not None
                return _planned(model, parameters, state, [*UPRIGHT] if turns else None, None)
            except (InputError, RunError) as error:
                last = error
    raise InputError(f"{system.name}: {last}") from last


def _planned(
    model: Model, parameters: dict[str, Any], state: dict[str, Any], orientation: list[Any] | None, dt: float | None
) -> Example:
    """The plan with the longest step that its method accepts, if no step is given."""
    needed = orientation if model.system.perturbation is not None else None
    wanted = dt or rounded(A_STEP / (rate(_plan(model, state, needed, 1e-6)) or 1.0))
    for left in reversed(range(HALVED + 1)):
        try:
            plan = _plan(model, state, needed, wanted)
            break
        except InputError:
            if not left:
                raise
            wanted = rounded(wanted / 2)
    return Example(model, parameters, state, orientation, wanted, plan.scheme.name)


def _plan(model: Model, state: dict[str, Any], orientation: list[Any] | None, dt: float) -> Any:
    return make_plan(model, state, dt=dt, steps=1, orientation=orientation)


def rounded(x: float) -> float:
    """The next smaller one of 1, 2, 5 times a power of ten."""
    power = 10.0 ** math.floor(math.log10(x))
    digit = next(d for d in (5, 2, 1) if d * power <= x * (1 + 1e-9))
    return float(f"{digit * power:.0e}")


def _parameters(system: System, n: int, fixed: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    """Values to try, each parameter's example first."""
    needed = [p for p in system.parameters if (p.default is None or p.kind == "dimension") and p.letter not in fixed]
    for values in itertools.product(*(_values(p, n, place) for place, p in enumerate(needed))):
        yield {**dict(zip((p.letter for p in needed), values, strict=True)), **fixed}


def _values(p: Parameter, n: int, place: int) -> list[Any]:
    upright = [0.0] * (n - 1) + [1.0]
    if p.kind == "dimension":
        return [n]
    if p.kind == "scalar":
        return [[1.0, 1.5, 0.5, 0.8, 1.2, 0.3][(place + k) % 6] for k in range(6)]
    growing = [[1.0 + k, 2.0 * 0.6**k, 0.1 + 0.1 * k][place % 3] for k in range(n)]
    if p.kind == "vector":
        return [upright] if p.fixed else [[round(v, 3) for v in growing], [0.2 + 0.3 * k for k in range(n)]]
    diagonal = [1.0 + 0.2 * k for k in range(n)]
    return [diagonal, [[round((i != j) / (1 + 0.1 * (i + j)), 2) for j in range(n)] for i in range(n)]]


def _states(model: Model) -> Iterator[dict[str, Any]]:
    """States that may lie on the phase space.

    Vectors have length 1; those of the next place are orthogonal to them, and the last of a place has no entry 0.
    """
    n, components = model.n, model.system.space.components
    if model.system.space.name in ("(so(3)*)^n", "(S^2)^(2n)"):
        spins = [SPINS[k % len(SPINS)] for k in range(n)]
        yield {letter: [spin["xyz".index(letter[-1])] for spin in spins] for letter, _ in components}
        return
    choices: list[list[Any]] = []
    for place, (_, kind) in enumerate(components):
        before = [k for _, k in components[:place]].count("vector")
        if kind == "skew":
            few = [[0.1, 0.2, 1.5], [0.8, 0.2, -0.6]] if n == 3 else [_skew(n, place)]
            choices.append([few[(place + k) % len(few)] for k in range(len(few))])
        elif kind == "symmetric":
            choices.append([[[1.0 + 0.3 * i if i == j else 0.1 for j in range(n)] for i in range(n)]])
        else:
            ends, between = ((0.8, -0.6), 0.5) if before else ((0.6, 0.8), 0.0)
            even = [0.48, 0.6, 0.64] if n == 3 else [n**-0.5] * n
            last = [even[1], -even[0], *[0.0] * (n - 2)] if before else even
            first = [list(UNIT[before % 3])] if n == 3 else []
            choices.append([*first, [ends[0], *[between] * (n - 2), ends[1]], last])
    for values in itertools.product(*choices):
        yield dict(zip((letter for letter, _ in components), values, strict=True))


def _skew(n: int, place: int) -> list[list[float]]:
    return [[0.0 if i == j else round((1 if j > i else -1) * (0.2 * (i + j) - 0.3 * place), 3) for j in range(n)]
            for i in range(n)]  # fmt: skip
