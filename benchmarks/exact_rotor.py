"""The free body, n = 3, in closed form: its errors in ulps, against other formulas in many digits, and its cost.

random        bodies and momenta at random, times up to 1e12
beside        such bodies with a momentum or moments moved to within 1e-3 ... 1e-15 of each degenerate case
cost          microseconds of a jump and of a lane, nanoseconds of a row, seconds of a set-up

Each by polynomials ("parts") and by jumps, with how many of these are right; the reference: tests/rotors.py.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mpmath as mp
import numpy as np
from cases import machine, parser, write

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "exact"))
from test_exact_rotor import engine_of, moments, parted

import kreisel as kr
from kreisel.kernels.exact import engine
from kreisel.kernels.exact.jumps import Jumps
from rotors import closed_form

ULP = 2.0**-52
TIMES = np.array([0.37, -11.3, 1e3, -2e6, 1e12])
START = np.array([0.5, -0.7, 0.1, 0.5])


def errors(J: Any, M: Any, got: tuple[np.ndarray, np.ndarray], right: np.ndarray, digits: int) -> tuple[float, float]:
    """Of M, over |M|, and of g up to its sign, in ulps, over the times that are right."""
    state, turn = 0.0, 0.0
    with mp.workdps(digits):
        g = [mp.mpf(float(v)) for v in START / np.linalg.norm(START)]
        for k in np.flatnonzero(right):
            want, q = closed_form(moments(J), [float(v) for v in M], g, float(TIMES[k]), digits)
            state = max(state, *(float(abs(mp.mpf(float(x)) - y)) for x, y in zip(got[0][k], want, strict=True)))
            apart = (max(abs(mp.mpf(float(x)) - s * y) for x, y in zip(got[1][k], q, strict=True)) for s in (1, -1))
            turn = max(turn, float(min(apart)))
    return state / float(np.linalg.norm(M)) / ULP, turn / ULP


def measured(J: np.ndarray, M: np.ndarray, digits: int = 60, parts: int = 1) -> dict[str, Any]:
    """Medians and largest values over bodies; every `parts`-th also by polynomials."""
    form = engine_of(J, M, 1.0)
    rows, right = Jumps(form._scheme, len(form._start)).at(np.ascontiguousarray(form._start), TIMES)
    momenta, turns = parted(rows)
    jumped = [errors(J[k], M[k], (momenta[:, k], turns[:, k]), right[:, k], digits) for k in range(len(J))]
    engine.jumps.TOLERANCE, before = -1.0, engine.jumps.TOLERANCE  # no jump is right
    by_parts = []
    for k in range(0, len(J), parts):
        momenta, turns = parted(engine_of(J[k], M[k], 1e12).at(TIMES))
        by_parts.append(errors(J[k], M[k], (momenta[:, 0], turns[:, 0]), np.ones(len(TIMES), bool), digits))
    engine.jumps.TOLERANCE = before
    found = {"bodies": len(J), "jumps that are right": round(float(right.mean()), 4)}
    for name, all_of in (("jumps", jumped), ("parts", by_parts)):
        for what, values in zip(("state", "orientation"), np.transpose(all_of), strict=True):
            found[f"{name}, {what}"] = [round(float(np.median(values)), 2), round(float(values.max()), 2)]
    print(found, flush=True)
    return found


def beside(draw: np.random.Generator, name: str, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Bodies within 1e-3 ... 1e-15 of a degenerate case."""
    J, M = draw.uniform(0.2, 2, (count, 3)), draw.normal(size=(count, 3))
    near = 10.0 ** -draw.uniform(3, 15, (count, 1))
    if name.startswith("axis"):
        J = np.sort(J, 1)
        M = M * near
        M[:, int(name[-1]) - 1] = 1.0
    elif name == "symmetric":
        J[:, :1] = J[:, 1:2] * (1 + near)
    elif name == "ball":
        J = J[:, :1] * (1 + near * M)
    elif name == "flat":
        J[:, 2:] = near
    elif name == "separatrix":
        J = np.sort(J, 1)
        inertia = J[:, [1, 0, 0]] + J[:, [2, 2, 1]]
        weights = 1 - inertia[:, 1:2] / inertia  # L^2 = 2T I_2: M_1^2 w_1 + M_3^2 w_3 = 0
        M[:, 2:] = M[:, :1] * np.sqrt(-weights[:, :1] / weights[:, 2:]) * (1 + near)
    return J, M


def timed(call: Callable[[], Any], count: int) -> float:
    """The least processor time of a call in seconds, of five times `count`."""
    call()
    best = np.inf
    for _ in range(5):
        begun = time.process_time()
        for _ in range(count):
            call()
        best = min(best, (time.process_time() - begun) / count)
    return float(best)


def cost(draw: np.random.Generator) -> dict[str, float]:
    J, M = draw.uniform(0.2, 2, (4096, 3)), draw.normal(size=(4096, 3))
    found: dict[str, float] = {}
    one, many = (kr.propagator(kr.EulerTop(J=j), method="exact") for j in (J[0], J))
    found["kr.propagator, a state at a time, us"] = 1e6 * timed(lambda: one.at(M[0], 3.1), 2000)
    found["a lane of 4096, us"] = 1e6 * timed(lambda: many.at(M, 3.1), 5) / len(J)
    for name, oriented in (("row, ns", False), ("row with orientation, ns", True)):
        p, x = (
            kr.propagator(kr.EulerTop(J=J[0]), method="exact", dt=0.1, orientation=oriented),
            [*M[0], *[1, 0, 0, 0] * oriented],
        )
        found[name] = 1e9 * timed(lambda p=p, x=x: p.steps(x, 100_000, 1), 3) / 100_000
    found["1000 rows and their set-up, s"] = timed(lambda: p.steps(x, 1000, 1), 3)
    found = {name: float(f"{value:.3g}") for name, value in found.items()}
    print(found, flush=True)
    return found


def main() -> None:
    options = parser(__doc__, "exact_rotor")
    options.add_argument("--bodies", type=int, default=2000)
    options.add_argument("--beside", type=int, default=200)
    given = options.parse_args()
    draw = np.random.default_rng(5)
    J, M = draw.uniform(0.2, 2, (given.bodies, 3)), draw.normal(size=(given.bodies, 3))
    found: dict[str, Any] = {"machine": machine(), "cost": cost(draw)}
    found["random"] = measured(J, M, parts=max(1, given.bodies // 200))
    for name in ("axis 1", "axis 2", "axis 3", "symmetric", "ball", "flat", "separatrix"):
        print(name, flush=True)
        found[name] = measured(*beside(draw, name, given.beside), digits=110, parts=max(1, given.beside // 50))
    write(found, given.output)


if __name__ == "__main__":
    main()
