"""Jobs for the adapters, their answers read, and the errors against the exact motion."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple

import numpy as np

import kreisel as kr

__all__ = ["BODIES", "Answer", "Body", "answer", "grade", "job", "jobs", "order"]

ROWS = 40  # at most, of a run
LOST = 1e3  # factor of the rate at the start beyond which a body is too fast
REFINED = (1, 10)  # a step of an engine's users, and a tenth of it
HALVED = "tumbling-brick"  # runs with half the step too, for the order


class Body(NamedTuple):
    """A check case for engines: the longest step that suits it, s, and the mass if the case has none, kg."""

    name: str
    longest: float
    mass: float = 1.0

    def given(self) -> dict[str, Any]:
        """Numbers of the case, the inertia about the centre of mass."""
        numbers = {"mass": self.mass, "arm": None, "gravity": 0.0, **kr.checkcases.case(self.name).given()}
        if numbers["arm"] is not None:
            arm = np.array(numbers["arm"])
            steiner = numbers["mass"] * (arm @ arm * np.eye(3) - np.outer(arm, arm))
            numbers["inertia"] = (np.array(numbers["inertia"]) - steiner).tolist()
        return numbers


BODIES = (
    Body("tumbling-brick", 0.1, 2.267962),
    Body("boxes", 0.02),
    Body("thin-body", 1e-3),
    Body("small-box", 0.01),
    Body("wing-nut", 0.01),
    Body("heavy-top", 1e-3),
)


@dataclass(frozen=True)
class Answer:
    """An adapter's answer: its description, and rows of time, attitude (w, x, y, z) and rates."""

    about: dict[str, Any]
    times: Any
    attitude: Any
    rates: Any


def job(body: Body, dt: float, setting: str, package: str) -> dict[str, Any]:
    """The job for one run.  Raises `ValueError` if the duration is not a number of steps."""
    numbers = body.given()
    duration, arm, rates = numbers["duration"], numbers["arm"], numbers["angular_velocity"]
    steps = round(duration / dt)
    if abs(steps * dt - duration) > 1e-9 * duration:
        raise ValueError(f"{body.name}: expected steps that fill {duration:g} s, got {dt!r} s")
    rows = max(r for r in range(1, ROWS + 1) if steps % r == 0)
    return {
        "case": body.name,
        "mass": numbers["mass"],
        "inertia": numbers["inertia"],
        "attitude": numbers["attitude"],
        "angular_velocity": rates,
        "velocity": [0.0] * 3 if arm is None else np.cross(rates, arm).tolist(),
        "gravity": None if arm is None else [0.0, 0.0, -numbers["gravity"]],
        "arm": arm,
        "dt": dt,
        "steps": steps,
        "every": steps // rows,
        "setting": setting,
        "package": package,
    }


def jobs(body: Body, step: float | None, setting: str, package: str) -> list[dict[str, Any]]:
    """The runs of a body: with the step of the engine's users, or the longest for the body, and with a tenth of it.

    step None: an engine that chooses its steps, one run.
    """
    if step is None:
        return [job(body, body.given()["duration"] / ROWS, setting, package)]
    longest = min(step, body.longest)
    finer = (1, 2, 10) if body.name == HALVED else REFINED
    return [job(body, longest / by, setting, package) for by in finer]


def answer(text: str) -> Answer:
    """An adapter's standard output, after lines that an engine prints.  Raises `ValueError` unless it is complete."""
    lines = text[text.find('# {"version"') :].splitlines()
    about: dict[str, Any] = {}
    for line in lines:
        if line.startswith("#"):
            about |= json.loads(line[1:])
    rows = [[float(x) for x in line.split(",")] for line in lines if line and line[0] not in "#t"]
    if "version" not in about or "seconds" not in about or not rows or {len(row) for row in rows} != {8}:
        raise ValueError(f"expected rows of 8 numbers, a version and seconds, got {text[-200:]!r}")
    table = np.array(rows)
    return Answer(about, table[:, 0], table[:, 1:5], table[:, 5:])


def grade(body: Body, answered: Answer) -> dict[str, Any]:
    """Errors at the end, and the largest change of energy and momentum, relative; of a run that broke off, when."""
    numbers = body.given()
    whole = np.isfinite(answered.attitude).all(1) & np.isfinite(answered.rates).all(1)
    whole &= np.linalg.norm(answered.rates, axis=1) < LOST * np.linalg.norm(numbers["angular_velocity"])
    if not whole.all():
        return {"diverged_s": float(answered.times[whole.argmin()])}
    if abs(answered.times[-1] - numbers["duration"]) > 1e-6 * numbers["duration"]:
        return {"failed": f"the last row is at {answered.times[-1]:g} s, not {numbers['duration']:g} s"}
    q = answered.attitude / np.linalg.norm(answered.attitude, axis=1)[:, None]
    exact, rates = end(body.name)
    apart = min(np.linalg.norm(q[-1] - exact), np.linalg.norm(q[-1] + exact))
    energy, momentum = conserved(numbers, q, answered.rates)
    return {
        "attitude_error": 4 * math.asin(min(1.0, apart / 2)),
        "rates_error": float(np.linalg.norm(answered.rates[-1] - rates) / np.linalg.norm(numbers["angular_velocity"])),
        "energy_change": float(abs(energy - energy[0]).max() / abs(energy[0])),
        "momentum_change": float(np.linalg.norm(momentum - momentum[0], axis=1).max() / np.linalg.norm(momentum[0])),
        "end": q[-1].tolist(),
    }


@cache
def end(name: str) -> tuple[Any, Any]:
    """The exact attitude and rates at the end of a case."""
    case = kr.checkcases.case(name)
    reference = case.reference([0.0, float(case.duration)])
    return reference.attitude.values[-1], reference.angular_velocity.values[-1]


def conserved(numbers: dict[str, Any], q: Any, rates: Any) -> tuple[Any, Any]:
    """The energy (rows,) and the momentum in space (rows, 3), of the heavy top along the vertical (rows, 1)."""
    free = numbers["arm"] is None
    arm = np.zeros(3) if free else np.array(numbers["arm"])
    moments = np.array(numbers["inertia"]) + numbers["mass"] * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    along = rates @ moments
    energy = (rates * along).sum(1) / 2 + numbers["mass"] * numbers["gravity"] * turned(q, arm)[:, 2]
    momentum = turned(q, along)
    return energy, momentum if free else momentum[:, 2:]


def turned(q: Any, v: Any) -> Any:
    """v (rows, 3) along the axes of space, from the axes of a body of attitude q (rows, 4)."""
    w, axis = q[:, :1], q[:, 1:]
    once = 2 * np.cross(axis, v)
    return v + w * once + np.cross(axis, once)


def order(coarse: dict[str, Any], fine: dict[str, Any], floor: float) -> float | None:
    """The order, from the errors of attitude with a step and half of it; None near rounding or beyond 0.5 rad."""
    errors = [row.get("attitude_error", math.inf) for row in (coarse, fine)]
    if errors[0] > 0.5 or errors[1] < floor or errors[1] >= errors[0]:
        return None
    return round(math.log2(errors[0] / errors[1]), 2)
