"""Cost of a given error for perturbed bodies: splittings, `variational` and peers, all as a user calls them.

    python benchmarks/perturbed.py [--splittings | --long STEPS | --cost]   with peers where peers.txt is installed

Writes results/perturbed.json and its table on docs/perturbed.md; with --splittings only the rows of these, next to the
stored ones; with --long, instead, the changes of the energy and the Casimirs over STEPS steps; with
--cost, the time of a step, of its integrable motions and of its kicks.  Each contender runs over a time of
100, and of 1e5 if stated, with steps (or tolerances) that halve; counted are evaluations of the force, those
of a corrector and its inverse included, and, of calls of kr.propagator(...).steps (of DOP853: of kr.simulate with one
row), microseconds of processor time, the least of several calls, warm, on one core.  Batches: 64 lanes of a splitting,
and heyoka's batch of the width of the machine's vectors, time of a trajectory.  The truth is DOP853 with rtol = 1e-13,
which the splitting of order 8 with short steps confirms to 1e-9; for T = 1e5 heyoka in 80-bit floats.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

os.environ.setdefault("KREISEL_NUM_THREADS", "1")

import numpy as np
from cases import machine
from perturbed_peers import Functions, Rate, by_long_doubles, coupled_tops, heavy_top, in_orbit, peers
from scipy.integrate import solve_ivp

import kreisel as kr
from kreisel import algebra
from kreisel.method.composition import corrector, splitting, symmetric_composition
from kreisel.method.scheme import Steps
from kreisel.method.splitting import Splitting
from kreisel.runs.planning import make_plan

RESULT = Path(__file__).parent / "results" / "perturbed.json"
PAGE = Path(__file__).parents[1] / "docs" / "perturbed.md"
TIME, LATE, TARGETS = 100.0, 1e5, (1e-4, 1e-6, 1e-9)
RATES = (
    0.5,
    0.75,
    1,
    1.25,
    1.5,
    1.75,
    2,
    2.25,
    2.5,
    2.75,
    3,
    3.5,
    4,
    6,
    8,
    12,
    16,
    24,
    32,
    48,
    64,
)  # steps in a unit of time
LANES, MOST_LATE, SECONDS = 64, 8, 0.1
TOLERANCES = tuple(10.0**-k for k in range(3, 14))
ORDERS = ((8, 2), (10, 2), (18, 2), (8, 6, 4), (10, 6, 4), 8)
ALONE = (8, 6, 4)  # of which the parts of a step are timed
AGREE = 1e-9
UNSEEN = 1e-300  # of a momentum: a sum with it is rounded to the other term
SATELLITE, TILTED = "a satellite, n = 0.03", "a top, 0.01 a_1^2"
MARK = "<!-- the table of results/perturbed.json -->"


class Problem(NamedTuple):
    """A perturbed body, its state as a mapping, its equations, and this body as a separate system, if there is one.

    `end`: the time.
    """

    name: str
    body: Any
    start: dict[str, Any]
    rate: Rate
    same: Any = None
    end: float = TIME

    @property
    def row(self) -> np.ndarray:
        """The start in the form of `kr.propagator`."""
        return np.concatenate([np.asarray(v, dtype=float) for v in self.start.values()], -1)


def problems() -> Iterator[Problem]:
    for d in (1e-2, 1e-5, 1e-7):
        moments = np.array([1, 1 + d, 0.5])
        body = kr.perturbed(
            kr.LagrangeTopMoving(A=(0, 0, 1), alpha=0.5),
            inertia=moments,
            potential=lambda P, *, d: d * P[0],
            params={"d": d},
        )
        heavy = kr.HeavyTop(J=moments.sum() / 2 - moments, A=(d, 0, 1))
        start, axis = {"M": (0.3, 0.2, 1.1), "P": (0.6, 0.0, 0.8)}, (d, 0, 1)
        yield Problem(f"a top, d = {d:g}", body, start, heavy_top(moments, axis), heavy)
        if d == 1e-5:
            yield Problem(f"a top, d = {d:g}, T = 1e5", body, start, heavy_top(moments, axis), heavy, LATE)
    moments = np.array([1.0, 1.6, 2.0])

    def gravity(g: Any, t: Any, *, n: Any) -> Any:
        r = np.array([np.cos(n * t), np.sin(n * t), 0 * t]) @ g
        return 1.5 * n * n * ((r * r) @ moments)

    satellite = kr.perturbed(kr.EulerTop(J=moments.sum() / 2 - moments), potential=gravity, params={"n": 0.03})
    start = {"M": (0.4, 0.3, 1.5), "g": np.array([1.0, 0, 0, 0])}
    yield Problem(SATELLITE, satellite, start, in_orbit(moments, 0.03, 0.0))
    yield Problem(f"{SATELLITE}, T = 1e5", satellite, start, in_orbit(moments, 0.03, 0.0), end=LATE)
    yield Problem("Hyperion, e = 0.1", *hyperion())
    k = 0.001
    pair = kr.perturbed(
        kr.LagrangeTop(p=(0, 0, 1)), pair_potential=lambda a1, a2, *, k: -k * (a1 @ a2), pairs=[(0, 1)], params={"k": k}
    )
    start = {
        "m": np.array([(0.1, 0.2, 1.5), (0.3, -0.2, 1.1)]),
        "a": np.array([(0.6, 0, 0.8), (0, 0.6, 0.8)]),
    }
    yield Problem("two coupled tops, k = 0.001", pair, start, coupled_tops(k))


def hyperion() -> tuple[Any, dict[str, Any], Rate]:
    """A moon that tumbles on its elliptic orbit, as in the gallery."""
    axes = np.array([190.0, 145.0, 114.0]) ** 2
    moments, e = (axes.sum() - axes) / (axes[0] + axes[1]), 0.1

    def potential(g: Any, t: Any) -> Any:
        E = t + e * np.sin(t)
        for _ in range(3):
            E = E - (E - e * np.sin(E) - t) / (1 - e * np.cos(E))
        r = (np.cos(E) - e) * g[0] + np.sqrt(1 - e * e) * np.sin(E) * g[1]
        return 1.5 * (moments @ (r * r)) / (1 - e * np.cos(E)) ** 5

    moon = kr.perturbed(kr.EulerTop(J=moments.sum() / 2 - moments), potential=potential)
    start = {"M": (0.1, 0.2, 3.0), "g": np.array([1.0, 0, 0, 0])}
    return moon, start, in_orbit(moments, 1.0, e)


def took(call: Callable[[], Any], repetitions: int = 5) -> float:
    """Microseconds of processor time, the least of some calls, of short ones those in `SECONDS`."""
    call()
    first, durations = time.process_time(), list[float]()
    while len(durations) < repetitions or time.process_time() - first < SECONDS:
        begun = time.process_time()
        call()
        durations.append(time.process_time() - begun)
    return 1e6 * min(durations)


def off(got: Any, truth: Any) -> float:
    return float(
        max(abs(np.asarray(got[k]) - np.asarray(v)).max() for k, v in truth.items() if k in ("M", "P", "m", "a"))
    )


def stepped(
    system: Any, problem: Problem, method: str, order: Any, evaluations: int, lanes: int = 1, beside: int = 0
) -> list[dict[str, float]]:
    """Error, evaluations (of a step, and `beside` of a call) and time for each number of steps."""
    out, more = [], {"time": 0.0} if "g" in problem.start else {}
    for n in (round(problem.end * each) for each in RATES if each <= (RATES[-1] if problem.end == TIME else MOST_LATE)):
        p = kr.propagator(system, method=method, order=order, dt=problem.end / n, orientation="g" in problem.start)
        try:
            error = off(p.steps(problem.start, n, **more), truth(problem))
        except kr.RunError:  # a step that is too long
            continue
        x = np.tile(problem.row, (lanes, 1)) if lanes > 1 else problem.row
        us = took(lambda p=p, x=x, n=n: p.steps(x, n, **more), 20 if problem.end == TIME else 2) / lanes
        out.append({"error": error, "evaluations": n * evaluations + beside, "us": us})
        if error < TARGETS[-1]:
            break
    return out


def by_peers(problem: Problem) -> dict[str, list[dict[str, float]]]:
    """Errors and costs of heyoka and diffrax, if they are installed."""
    out: dict[str, list[dict[str, float]]] = {}
    bodies = problem.row if problem.row.ndim > 1 else problem.row[None]
    start = bodies.ravel()
    tolerances = TOLERANCES if problem.end == TIME else TOLERANCES[::3]
    for peer in peers(problem.rate, start, problem.end, tolerances, batches=True):
        if peer.label.startswith("diffrax") and problem.end > TIME:
            continue
        z = peer.go().reshape(bodies.shape)
        size = [3] * (len(problem.start) - ("g" in problem.start))
        parts = np.split(z if problem.row.ndim > 1 else z[0], np.cumsum(size), axis=-1)
        error = off(dict(zip(problem.start, parts, strict=False)), truth(problem))
        us = took(peer.go, 20 if problem.end == TIME else 2) / peer.lanes
        out.setdefault(peer.label, []).append({"error": error, "evaluations": peer.evaluations(), "us": us})
    return out


def by_dop853(problem: Problem) -> list[dict[str, float]]:
    """Errors and costs for each tolerance; evaluations are counted by SciPy on the flow itself."""
    out: list[dict[str, float]] = []
    system = problem.same or problem.body
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
    if problem.row.ndim > 1:
        return evaluations_of_equations(problem, tol)
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


def evaluations_of_equations(problem: Problem, tol: float) -> int:
    def rate(t: float, y: np.ndarray) -> list[float]:
        return problem.rate(t, list(y), Functions(np.sin, np.cos))

    return int(solve_ivp(rate, (0, TIME), problem.row.ravel(), "DOP853", rtol=tol, atol=tol / 1000).nfev)


KNOWN: dict[str, dict[str, np.ndarray]] = {}


def truth(problem: Problem) -> dict[str, np.ndarray]:
    if problem.name not in KNOWN:
        state = {k: v for k, v in problem.start.items() if k != "g"}
        more = {"orientation": problem.start.get("g"), "observe": ()}
        if problem.end > TIME:
            found = by_long_doubles(problem.rate, problem.row, problem.end)
            KNOWN[problem.name] = {k: found[3 * i : 3 * i + 3] for i, k in enumerate(state)}
            return KNOWN[problem.name]
        n = 4 * round(TIME * RATES[-1])
        run = kr.simulate(problem.body, state, dt=TIME / n, steps=n, every=n, order=8, **more).isel(time=-1)
        other = kr.simulate(problem.body, state, dt=TIME, steps=1, method="dop853", tol=1e-13, **more).isel(time=-1)
        KNOWN[problem.name] = {k: other[k].values for k in state}
        apart = off({k: run[k].values for k in state}, KNOWN[problem.name])
        if apart > AGREE:
            raise RuntimeError(f"{problem.name}: the splitting says another thing, by {apart:g}")
    return KNOWN[problem.name]


def by_splittings(problem: Problem) -> dict[str, list[dict[str, float]]]:
    """Errors and costs of each order, of single runs and of batches."""
    rows: dict[str, list[dict[str, float]]] = {}
    for order in ORDERS:
        parts = 3 if isinstance(order, tuple) and order[-1] > 2 and problem.same else 1
        count, C = parts * len(splitting(order).b), corrector(order)
        asked = "splitting", order, count
        beside = 0 if C is None else 2 * len(C.b)
        rows[f"splitting {order}"] = stepped(problem.body, problem, *asked, beside=beside)
        if problem.row.ndim == 1 and problem.end == TIME:
            rows[f"splitting {order} batch"] = stepped(problem.body, problem, *asked, LANES, beside)
    return rows


def measure(only: list[str], splittings: bool) -> dict[str, Any]:
    """Results of these problems; `splittings`: of splittings only."""
    found: dict[str, Any] = {}
    for problem in problems():
        if problem.name not in only or (problem.end > TIME and not find_spec("heyoka")):
            continue
        rows: dict[str, Any] = by_splittings(problem)
        found[problem.name] = rows
        print(problem.name, flush=True)
        if splittings:
            continue
        for order in (4, 8) if problem.same and problem.end == TIME else ():
            stages = len(symmetric_composition(order))
            rows[f"variational {order}"] = stepped(problem.same, problem, "variational", order, stages + 1)
        if problem.end == TIME:
            rows["dop853"] = by_dop853(problem)
        rows |= by_peers(problem)
    ends = {problem.name: problem.end for problem in problems()}
    where = {"machine": machine(), "load": os.getloadavg()[0]}
    return {"ends": ends, "problems": found, **({"splittings": where} if splittings else where)}


def long_run(steps: int, only: list[str]) -> dict[str, Any]:
    """Balance and Casimirs of the satellite and of a top in a field that is not vertical, dt = 1 and 0.5."""
    top = kr.perturbed(kr.LagrangeTop(p=(0, 0, 1)), potential=lambda a: 0.01 * a[0] ** 2)
    satellite = next(problem for problem in problems() if problem.name == SATELLITE)
    runs: dict[str, tuple[Any, ...]] = {
        satellite.name: (satellite.body, {"M": satellite.start["M"]}, 1.0, (8, 2), satellite.start["g"]),
        TILTED: (top, {"m": (0.1, 0.2, 1.5), "a": (0.6, 0.0, 0.8)}, 0.5, (8, 6, 4), None),
    }
    out = {}
    for name, (body, state, dt, order, g) in runs.items():
        if name not in only:
            continue
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


def nudged(z: tuple[Any, ...]) -> tuple[Any, ...]:
    """Kicks between short rotations: after a kick only, a compiler would evaluate the next, equal force once."""
    first, *rest = z
    return (first, *(part + UNSEEN * first[0, 1] for part in rest))


def costs(only: list[str], steps: int = 20_000, repetitions: int = 7) -> dict[str, Any]:
    """Microseconds of processor time of a step, of its integrable motions and of its kicks."""
    out: dict[str, Any] = {}
    for problem in (p for p in problems() if p.name in only and p.end == TIME and p.row.ndim == 1):
        oriented, dt = "g" in problem.start, 0.1
        state = {k: v for k, v in problem.start.items() if k != "g"}
        asked = {"dt": dt, "steps": steps, "order": ALONE, "method": "splitting", "project": False}
        plan = make_plan(problem.body, state, orientation=problem.start.get("g"), **asked)
        body, whole = Splitting(problem.body, dt, ALONE, oriented, all_turns=False), plan.scheme
        motions = {
            "step": whole.motion,
            "motions": Steps(body.drift, body.close),
            "kicks": Steps(lambda *z, body=body, **known: nudged(body.kick(*z, **known)), None),
        }
        alone = {name: replace(whole, motion=m, kernel_key=None, definition_key=None) for name, m in motions.items()}
        best = dict.fromkeys(alone, np.inf)
        for _ in range(repetitions):
            for name, scheme in alone.items():
                engine = replace(plan, scheme=scheme).engine
                engine.advance(np.empty((1, *plan.first.shape)), 10)
                begun = time.process_time()
                engine.advance(np.empty((1, *plan.first.shape)), steps)
                best[name] = min(best[name], 1e6 * (time.process_time() - begun) / steps)
        out[problem.name] = best | {"ratio": best["step"] / (best["motions"] + best["kicks"])}
        print(problem.name, out[problem.name], flush=True)
    return out


def without(rows: dict[str, Any], others: dict[str, Any]) -> dict[str, Any]:
    return {label: found for label, found in rows.items() if label not in others}


def cheapest(rows: list[dict[str, float]], target: float, what: str) -> float | None:
    """The least of what reaches the error."""
    return min((row[what] for row in rows if row["error"] <= target and row[what] is not None), default=None)


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
                end = result["ends"][name]
                counted = "" if count is None else f"{count / end:.3g}, "
                cells.append("-" if us is None else f"{counted}{us / end:.2g} µs")
            lines.append(f"| `{label}` | " + " | ".join(cells) + " |")
    if "splittings" in result:
        one, other = (place["machine"]["cpu"] for place in (result["splittings"], result))
        lines += ["", f"Times of splittings are those of another processor ({one}) than those of the rest ({other})."]
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--long", type=int, help="steps of the long run")
    parser.add_argument("--splittings", action="store_true", help="these alone, beside the rows that are there")
    parser.add_argument("--cost", action="store_true", help="of the parts of a step, order (8, 6, 4)")
    parser.add_argument(
        "--only", nargs="*", default=[TILTED, *(problem.name for problem in problems())], help="problems"
    )
    asked = parser.parse_args()
    steps = asked.long
    before = json.loads(RESULT.read_text(encoding="utf-8")) if RESULT.exists() else {}
    if steps is not None:
        found = {**before.get("long", {}), **long_run(steps, asked.only)}
        RESULT.write_text(json.dumps({**before, "long": found}, indent=1) + "\n", encoding="utf-8")
        return
    if asked.cost:
        RESULT.write_text(json.dumps({**before, "cost": costs(asked.only)}, indent=1) + "\n", encoding="utf-8")
        return
    found, old = measure(asked.only, asked.splittings), before.get("problems", {})
    if not asked.splittings:
        before.pop("splittings", None)  # all rows are of one machine again
    else:
        found["problems"] = {k: rows | without(old.get(k, {}), rows) for k, rows in found["problems"].items()}
    result = {**before, **found, "problems": {**old, **found["problems"]}}
    RESULT.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    text = PAGE.read_text(encoding="utf-8")
    if MARK in text:
        before, _, after = text.partition(MARK)
        PAGE.write_text(f"{before}{MARK}\n{table(result)}\n{MARK}{after.partition(MARK)[2]}", encoding="utf-8")
    print(table(result))


if __name__ == "__main__":
    main()
