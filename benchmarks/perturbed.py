"""What a given error costs for perturbed bodies: splittings against `variational` and DOP853, all as a user calls them.

    python benchmarks/perturbed.py [--long STEPS]

Writes results/perturbed.json and its table on docs/perturbed.md; with --long, instead of the rest, what the energy and
the Casimirs do over so many steps.  Each contender runs over a time of 100 with steps (or
tolerances) that halve; counted are evaluations of the force and, of calls of kr.propagator(...).steps (of DOP853: of
kr.simulate with one row), microseconds, the least of several calls, warm, on one core.  The truth is the splitting of
order 8 with short steps, which DOP853 with rtol = 1e-13 confirms.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

os.environ.setdefault("NUMBA_NUM_THREADS", "1")

import numpy as np
from scipy.integrate import solve_ivp

import kreisel as kr
from kreisel import algebra
from kreisel.method.composition import symmetric_composition
from kreisel.method.splitting_coefficients import splitting

RESULT = Path(__file__).parent / "results" / "perturbed.json"
PAGE = Path(__file__).parents[1] / "docs" / "perturbed.md"
TIME, TARGETS = 100.0, (1e-4, 1e-6, 1e-9)
STEPS = tuple(round(TIME * f) for f in (0.5, 0.75, 1, 1.5, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64))
TOLERANCES = tuple(10.0**-k for k in range(3, 14))
ORDERS = ((8, 2), (8, 6, 4), (10, 6, 4), 8)
AGREE = 1e-9
MARK = "<!-- the table of results/perturbed.json -->"


class Problem(NamedTuple):
    """A perturbed body, its state as a mapping, and the same body as a system of its own, for other methods."""

    name: str
    body: Any
    start: dict[str, Any]
    same: Any = None


def problems() -> Iterator[Problem]:
    for d in (1e-2, 1e-5):
        moments = np.array([1, 1 + d, 0.5])
        body = kr.perturbed(
            kr.LagrangeTopMoving(A=(0, 0, 1), alpha=0.5),
            inertia=moments,
            potential=lambda P, *, d: d * P[0],
            params={"d": d},
        )
        heavy = kr.HeavyTop(J=moments.sum() / 2 - moments, A=(d, 0, 1))
        yield Problem(f"a top, d = {d:g}", body, {"M": (0.3, 0.2, 1.1), "P": (0.6, 0.0, 0.8)}, heavy)
    moments = np.array([1.0, 1.6, 2.0])

    def gravity(g: Any, t: Any, *, n: Any) -> Any:
        r = np.array([np.cos(n * t), np.sin(n * t), 0 * t]) @ g
        return 1.5 * n * n * ((r * r) @ moments)

    satellite = kr.perturbed(kr.EulerTop(J=moments.sum() / 2 - moments), potential=gravity, params={"n": 0.03})
    yield Problem("a satellite, n = 0.03", satellite, {"M": (0.4, 0.3, 1.5), "g": np.array([1.0, 0, 0, 0])})


def took(call: Callable[[], Any], repetitions: int = 5) -> float:
    """Microseconds, the least of some calls."""
    call()
    best = np.inf
    for _ in range(repetitions):
        begun = time.perf_counter()
        call()
        best = min(best, time.perf_counter() - begun)
    return 1e6 * best


def off(got: Any, truth: Any) -> float:
    return float(max(abs(np.asarray(got[k]) - np.asarray(v)).max() for k, v in truth.items() if k in ("M", "P")))


def stepped(system: Any, problem: Problem, method: str, order: Any, evaluations: int) -> list[dict[str, float]]:
    """Error, evaluations and time for each number of steps."""
    out, more = [], {"time": 0.0} if "g" in problem.start else {}
    for n in STEPS:
        p = kr.propagator(system, method=method, order=order, dt=TIME / n, orientation="g" in problem.start)
        try:
            error = off(p.steps(problem.start, n, **more), truth(problem))
        except kr.RunError:  # a step that is too long
            continue
        x = np.concatenate([np.ravel(v) for v in problem.start.values()]).astype(float)
        out.append(
            {"error": error, "evaluations": n * evaluations, "us": took(lambda p=p, x=x, n=n: p.steps(x, n, **more))}
        )
    return out


def by_dop853(problem: Problem) -> list[dict[str, float]]:
    """The same for each tolerance; evaluations are counted by SciPy on the flow itself."""
    out, system = [], problem.same or problem.body
    orientation = problem.start.get("g")
    state = {k: v for k, v in problem.start.items() if k != "g"}
    for tol in TOLERANCES:

        def run(tol: float = tol) -> Any:
            return kr.simulate(
                system, state, dt=TIME, steps=1, method="dop853", tol=tol, orientation=orientation, observe=()
            )

        found = run().isel(time=-1)
        error = off({k: found[k].values for k in state}, truth(problem))
        out.append({"error": error, "evaluations": evaluations_of_dop853(problem, tol), "us": took(run)})
    return out


def evaluations_of_dop853(problem: Problem, tol: float) -> int:
    system = problem.same or problem.body
    start = [algebra.hat(np.array(problem.start["M"], dtype=float)).ravel()]
    start += [np.array(problem.start["P"], dtype=float)] if "P" in problem.start else [np.eye(3).ravel()]

    def rate(t: float, x: np.ndarray) -> np.ndarray:
        M, rest = x[:9].reshape(3, 3), x[9:]
        if "P" in problem.start:
            dM, dP = system.flow(M, rest)
            return np.concatenate([dM.ravel(), dP])
        g = rest.reshape(3, 3)
        (dM,) = system.call(system.system.flow, M, g=g, t=t)
        return np.concatenate([dM.ravel(), (g @ system.call(system.system.velocity, M)).ravel()])

    done = solve_ivp(rate, (0, TIME), np.concatenate(start), "DOP853", rtol=tol, atol=tol / 1000)
    return int(done.nfev)


KNOWN: dict[str, dict[str, np.ndarray]] = {}


def truth(problem: Problem) -> dict[str, np.ndarray]:
    if problem.name not in KNOWN:
        state = {k: v for k, v in problem.start.items() if k != "g"}
        more = {"orientation": problem.start.get("g"), "observe": ()}
        n = 4 * STEPS[-1]
        run = kr.simulate(problem.body, state, dt=TIME / n, steps=n, every=n, order=8, **more).isel(time=-1)
        other = kr.simulate(problem.body, state, dt=TIME, steps=1, method="dop853", tol=1e-13, **more).isel(time=-1)
        KNOWN[problem.name] = {k: run[k].values for k in state}
        apart = off({k: other[k].values for k in state}, KNOWN[problem.name])
        if apart > AGREE:
            raise RuntimeError(f"{problem.name}: DOP853 says another thing, by {apart:g}")
    return KNOWN[problem.name]


def measure() -> dict[str, Any]:
    found: dict[str, Any] = {}
    for problem in problems():
        rows: dict[str, Any] = {}
        for order in ORDERS:
            parts = 3 if isinstance(order, tuple) and order[-1] > 2 and problem.same else 1
            label = f"splitting {order}"
            rows[label] = stepped(problem.body, problem, "splitting", order, parts * len(splitting(order).b))
        for order in (4, 8) if problem.same else ():
            stages = len(symmetric_composition(order))
            rows[f"variational {order}"] = stepped(problem.same, problem, "variational", order, stages + 1)
        rows["dop853"] = by_dop853(problem)
        found[problem.name] = rows
        print(problem.name, flush=True)
    return {"time": TIME, "load": os.getloadavg()[0], "problems": found}


def long_run(steps: int) -> dict[str, Any]:
    """Balance and Casimirs of the satellite and of a top in a field that is not vertical, dt = 1 and 0.5."""
    top = kr.perturbed(kr.LagrangeTop(p=(0, 0, 1)), potential=lambda a: 0.01 * a[0] ** 2)
    satellite = list(problems())[-1]
    runs = {
        satellite.name: (satellite.body, {"M": satellite.start["M"]}, 1.0, (8, 2), satellite.start["g"]),
        "a top, 0.01 a_1^2": (top, {"m": (0.1, 0.2, 1.5), "a": (0.6, 0.0, 0.8)}, 0.5, (8, 6, 4), None),
    }
    out = {}
    for name, (body, state, dt, order, g) in runs.items():
        run = kr.simulate(body, state, dt=dt, steps=steps, every=steps // 1000, order=order, orientation=g)
        energy = run["balance" if "balance" in run else "energy"]
        off = abs(energy - energy[0]).values
        ulps = kr.drift(run).query("conserved and kind == 'casimir'")["ulps"]
        out[name] = {
            "steps": steps,
            "dt": dt,
            "energy, first tenth": float(off[: len(off) // 10].max()),
            "energy, last tenth": float(off[-len(off) // 10 :].max()),
            "Casimirs, ulps": float(ulps.max()) if len(ulps) else None,
        }
        print(name, out[name], flush=True)
    return out


def cheapest(rows: list[dict[str, float]], target: float, what: str) -> float | None:
    """The least of what reaches the error."""
    return min((row[what] for row in rows if row["error"] <= target), default=None)


def table(result: dict[str, Any]) -> str:
    """Evaluations of the force and microseconds, both a unit of time, for each error."""
    head = ["", *(f"error {target:g}" for target in TARGETS)]
    lines = ["| " + " | ".join(head) + " |", "|---" * len(head) + "|"]
    for name, rows in result["problems"].items():
        lines.append(f"| **{name}** |" + " |" * len(TARGETS))
        for label, found in rows.items():
            cells = []
            for target in TARGETS:
                count, us = (cheapest(found, target, what) for what in ("evaluations", "us"))
                cells.append("-" if count is None else f"{count / TIME:.3g}, {us / TIME:.2g} µs")
            lines.append(f"| `{label}` | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--long", type=int)
    steps = parser.parse_args().long
    before = json.loads(RESULT.read_text(encoding="utf-8")) if RESULT.exists() else {}
    if steps is not None:
        RESULT.write_text(json.dumps({**before, "long": long_run(steps)}, indent=1) + "\n", encoding="utf-8")
        return
    result = {**before, **measure()}
    RESULT.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    text = PAGE.read_text(encoding="utf-8")
    if MARK in text:
        before, _, after = text.partition(MARK)
        PAGE.write_text(f"{before}{MARK}\n{table(result)}\n{MARK}{after.partition(MARK)[2]}", encoding="utf-8")
    print(table(result))


if __name__ == "__main__":
    main()
