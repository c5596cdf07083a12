"""Time of a step against n, single trajectories without saving, with fitted exponents.

    OPENBLAS_NUM_THREADS=1 python benchmarks/dimension.py      # only the time of this thread is read

Calls of `p.steps`, and of `kr.simulate` where the engine is prescribed: the time of many steps less the time of one.

The engine that a run chooses ("chosen": structured code of O(n) a step from n = 9 on, of O(n^2) from n = 11 on, where
the step has that form, else straight-line code up to n = 10 and the definition on arrays beyond), and the other ones
for comparison.  Exponents are those of the least squares line through the logarithms, from n = 10 and from n = 100 on:
at n = 1000 the rows of O(n) kernels no longer stay in the first cache.  Processor time of the thread, the least of
several.

Accuracy: a million steps at n = 10 with the structured and with the dense kernel, worst of the energy and the Casimirs
in units in the last place.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from cases import machine, parser, write

import kreisel as kr

SIZES = (3, 4, 6, 10, 30, 100, 300, 1000)
FROM = (10, 100)  # of the fits
LARGE = 100  # from here on orders of baecklund too
DENSE = {"lagrange-top": (10, 100), "clebsch": (100,)}  # where the dense kernel is compared
STRAIGHT = {"clebsch": 10}  # up to which n a run chooses straight-line code; 8 for the others
COMPARED = {
    "lagrange-top": (("suris", 1), ("baecklund", 4)),
    "lagrange-top-moving": (("suris", 1),),
    "clebsch": (("suris", 1), ("baecklund", 2)),
    "neumann": (("suris", 1),),
}
ORIENTED = "lagrange-top, with orientation"
SECONDS, CALLS = 0.1, 5


def models(n: int) -> dict[str, tuple[Any, dict[str, Any]]]:
    draw = np.random.default_rng(n)
    X, v, b = draw.normal(size=(n, n)) / np.sqrt(n), draw.normal(size=n), draw.uniform(0.1, 2, n)
    v /= np.sqrt(v @ v)
    q = draw.normal(size=n)
    return {
        "lagrange-top": (kr.LagrangeTop(p=np.eye(n)[-1]), {"m": X - X.T, "a": v}),
        "lagrange-top-moving": (kr.LagrangeTopMoving(A=np.eye(n)[-1], alpha=0.7), {"M": X - X.T, "P": v}),
        "clebsch": (kr.Clebsch(b=b), {"M": X - X.T, "P": v}),
        "neumann": (kr.Neumann(b=b), {"x": v, "q": q - v * (v @ q)}),
    }


def nanoseconds(steps: Callable[[int], Any]) -> float:
    """Nanoseconds a step: a call of many steps, which need half as long as its set-up or longer, less a call of one."""
    count, single = 1, _least(steps, 1, CALLS)
    while True:
        if _least(steps, 1 + count, 2) > single + max(SECONDS, single / 2):
            spent = [(_least(steps, 1, 1), _least(steps, 1 + count, 1)) for _ in range(CALLS)]
            single, many = (min(seconds) for seconds in zip(*spent, strict=True))
            if many > single + max(SECONDS, single / 2) / 2:  # else other work was timed
                return (many - single) / count * 1e9
        count *= 2


def _least(steps: Callable[[int], Any], count: int, calls: int) -> float:
    """Processor seconds of a call of that many steps."""
    spent = []
    for _ in range(calls):
        begun = time.thread_time()
        steps(count)
        spent.append(time.thread_time() - begun)
    return min(spent)


def call_of(model: Any, state: dict[str, Any], method: str, order: int, engine: str | None) -> Callable[[int], Any]:
    """A call of a number of steps: `p.steps`, or `kr.simulate` by a prescribed engine."""
    if engine is None:
        p = kr.propagator(model, dt=0.01, method=method, order=order, orientation="g" in state)
        return lambda count: p.steps(state, count)
    start = model.state(**state)
    return lambda count: kr.simulate(
        model, start, dt=0.01, steps=count, every=count, method=method, order=order, engine=engine
    )


def asked(n: int) -> list[tuple[str, str, int, str, str | None]]:
    """(name of the row, system, order, method, engine) for this n."""
    rows: list[tuple[str, str, int, str, str | None]] = []
    for system in models(4):
        rows.append((system, system, 1, "suris", None))
        if 3 < n <= STRAIGHT.get(system, 8):
            rows.append((f"{system}, large", system, 1, "suris", "large"))
        if n in DENSE.get(system, ()):
            rows.append((f"{system}, dense", system, 1, "suris", "cpu"))
    if 10 <= n <= 300:  # beyond, constants in extended precision need minutes
        rows.append(("clebsch, baecklund of order 2", "clebsch", 2, "baecklund", None))
    if n >= 10:
        rows.append((ORIENTED, "lagrange-top", 1, "suris", None))
    if LARGE <= n <= 300:
        rows.append(("lagrange-top, baecklund of order 8", "lagrange-top", 8, "baecklund", None))
    return rows


def fitted(measured: dict[str, dict[str, float]], first: int) -> dict[str, float]:
    """Exponents of the cost from n = `first` on."""
    out = {}
    for name, row in measured.items():
        far = [(int(n), ns) for n, ns in row.items() if int(n) >= first]
        if len(far) > 2:
            n, ns = np.array(far).T
            out[name] = round(float(np.polyfit(np.log(n), np.log(ns), 1)[0]), 2)
    return out


def accuracy(steps: int, n: int = 10) -> dict[str, dict[str, float]]:
    """Worst of the kept energy and the Casimirs, |a|^2 among them, over `steps` steps, in ulps, of both kernels."""
    out: dict[str, dict[str, float]] = {}
    for name, (model, state) in models(n).items():
        for method, order in COMPARED.get(name, ()):
            row = out[f"{name}, {method} of order {order}"] = {}
            for engine in ("large", "cpu"):
                run = kr.simulate(
                    model,
                    model.state(**state),
                    dt=0.1,
                    steps=steps,
                    every=steps // 100,
                    method=method,
                    order=order,
                    engine=engine,
                )
                table = kr.drift(run)
                moving = table[table.conserved & table.index.str.match("energy|casimir")]
                row[engine] = round(float(moving.ulps.max()), 2)
            print(f"{name}, {method}: {row}", flush=True)
    return out


def main(arguments: list[str] | None = None) -> None:
    """Measure, print, write the JSON."""
    asking = parser(__doc__, "dimension")
    asking.add_argument("--largest", type=int, default=SIZES[-1])
    asking.add_argument("--steps", type=int, default=1_000_000, help="for the accuracy; 0: do without")
    options = asking.parse_args(arguments)
    load = round(os.getloadavg()[0], 1)
    measured: dict[str, dict[str, float]] = {}
    for n in (n for n in SIZES if n <= options.largest):
        systems = models(n)
        for name, system, order, method, engine in asked(n):
            model, state = systems[system]
            state = {**state, "g": np.eye(n)} if name == ORIENTED else state
            ns = nanoseconds(call_of(model, state, method, order, engine))
            measured.setdefault(name, {})[str(n)] = round(ns, 1)
            print(f"n = {n:<5}{name:<36}{ns:14,.0f} ns", flush=True)
    exponents = {str(first): fitted(measured, first) for first in FROM}
    for first, row in exponents.items():
        print(f"exponents from n = {first} on: {row}")
    ulps = accuracy(options.steps) if options.steps else {}
    result = {
        "machine": machine(),
        "load_average_before": load,
        "ns": measured,
        "exponents": exponents,
        "accuracy": {"steps": options.steps, "n": 10, "ulps": ulps},
    }
    write(result, options.output)


if __name__ == "__main__":
    main()
