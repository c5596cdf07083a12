"""The exact flow by pairs of Bäcklund maps, and of Goryachev-Chaplygin's top by one: errors, integrals, time.

Also the time of a step of the explicit maps.

error     of the state at T = 50, relative to its largest coordinate, in 160 steps, against Taylor series in 24 digits
ulps      the largest change of an integral at 20 rows of 10^6 steps of 1/4, and ulps_40 that of 40 random states
a step    of the error between steps of 1/4 and 5/16 after that time, relative
set_up    processor time of the points of a trajectory, in ms, and set_up_lane of one of 64: the least of several
ns, lane  processor time of a step of a single trajectory, and of one of 64: the least of several runs
heyoka    where it is installed (peers.txt): to T = 1000 in steps of 1 by a propagator, one trajectory and a lane of 64,
          against heyoka at a tolerance of 1e-12, single and in its batch: processor time in ms, the points of the
          trajectory apart; errors of both against Taylor series in 24 digits at T = 50; single, batch: heyoka's time
          over that with the points
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from cases import machine, parser, steps_of, write

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

import kreisel as kr
from kreisel import algebra
from kreisel.method import scheme
from kreisel.record.calling import call
from taylor import flow_of

LONG, TURNS, OFTEN, LANES, STATES = 1_000_000, 5, 200, 64, 40
FAR, TOLERANCE = 1000, 1e-12
M, P = (0.3, 0.5, 1.1), (0.6, 0.0, 0.8)
F = ((1.0, 0.3, -0.2), (0.3, -0.5, 0.4), (-0.2, 0.4, 0.9))
FOUR = ((0, 0.3, -0.5, 0.7), (-0.3, 0, 1.1, 0.2), (0.5, -1.1, 0, -0.4), (-0.7, -0.2, 0.4, 0))
CASES = (
    (kr.ClebschGeneral(a=(1, 2, -0.7), b=(1, 4, 0.49)), {"M": M, "P": P}),
    (kr.ManakovTop(a=(1, 2.5, 5, 8), b=(1.4, 1.9, 2.4, 3)), {"M": FOUR}),
    (kr.QuadraticPotential(J=(1, 1.6, 2.3)), {"M": M, "P": F}),
    (kr.KovalevskayaTopE3(), {"M": M, "P": P}),
    (kr.KovalevskayaGyrostat(n=3, gamma=0.7), {"M": M, "P": P, "Q": (0.2, 0.7, -0.3)}),
    (kr.ClebschBody(J=(1, 1.6, 2.3)), {"M": M, "P": P}),
    (kr.KovalevskayaTop(n=3), {"M": M, "P": P, "Q": (0.2, 0.7, -0.3)}),
    (kr.Komarov(kappa=-0.4, beta=0.6, gamma=0.3), {"M": M, "P": P}),
    (kr.Komarov(kappa=0.4), {"M": M, "P": P}),
    (kr.Komarov(kappa=0, beta=0.8, c=0), {"M": M, "P": P}),
    (kr.Steklov(b=(0.3, 0.7, 1.9), nu=0.4), {"M": M, "P": P}),
    (kr.Lyapunov(b=(0.3, 0.7, 1.9), nu=0.4), {"M": M, "P": P}),
    (kr.Rubanovskii(b=(0.3, 0.7, 1.9), s=0.4, l=0.7, h=(0.4, -0.3, 0.5)), {"M": M, "P": P}),
    (kr.SteklovLyapunov(b=(0.3, 0.7, 1.9), s=0.4, l=0.7), {"M": M, "P": P}),
    (kr.GoryachevChaplygin(gamma=0.3), {"M": (0.8, 0.5, -0.6), "P": P}),
)
EXPLICIT = (
    (kr.KovalevskayaTopE3(), {"M": M, "P": P}),
    (kr.KovalevskayaTopSP4(), {"M": M, "P": P}),
    (kr.KovalevskayaGyrostat(n=3, gamma=0.7), {"M": M, "P": P, "Q": (0.2, 0.7, -0.3)}),
    (kr.SymmetricTopLogarithmic(A=(1, 0, 0)), {"M": M, "P": P}),
    (kr.RatiuTop(n=3, a=1.2, b=0.8, chi=0.9), {"M": M, "G": P}),
    (kr.QuadraticField(b=(1, 1.6, 2.3)), {"M": M, "F": F}),
)


def end(model: Any, run: Any) -> np.ndarray:
    """The coordinates of the last row."""
    kinds = model.system.space.components
    parts = [algebra.KINDS[kind].from_user(run[k].values[-1], model.n) for k, kind in kinds]
    return algebra.flatten(parts, [kind for _, kind in kinds])


def measured(model: Any, state: dict[str, Any]) -> dict[str, Any]:
    z = model.state(**state)
    options = {"method": "exact", "progress": False}
    run = kr.simulate(model, state, dt=0.3125, steps=160, every=160, **options)
    want = flow_of(model, tuple(z[k] for k in model.system.space.letters), 50.0)
    error = max(abs(float(x - y)) for x, y in zip(want, end(model, run), strict=True)) / max(map(abs, map(float, want)))
    runs = [
        kr.simulate(model, state, dt=dt, steps=n, every=n // 20, **options)
        for dt, n in ((0.25, LONG), (0.3125, LONG * 4 // 5))
    ]
    ends = [end(model, run) for run in runs]
    several = {k: np.stack([np.asarray(z[k])] * LANES) for k in z}
    return {
        "system": repr(model),
        "pairs": scheme(model, "exact", 0.1, None, False).stage_count,
        "error": short(error),
        "ulps": short(float(kr.drift(runs[0]).ulps.max())),
        "a step": short(float(abs(ends[0] - ends[1]).max() / abs(ends[0]).max()) / LONG),
        "ulps_40": ulps_of_many(model),
        **set_up(model, state),
        "ns": timed(model, state),
        "lane": round(timed(model, several) / LANES, 1),
        **(against_heyoka(model, state, want) if find_spec("heyoka") else {}),
    }


def ulps_of_many(model: Any) -> float:
    """The largest change of an integral of 40 normal random states, in ulps, after projections in 10^6 steps."""
    draw, lanes = np.random.default_rng(1), {}
    for letter, kind in model.system.space.components:
        x = draw.normal(size=(STATES, model.n) if kind == "vector" else (STATES, model.n, model.n))
        lanes[letter] = x if kind == "vector" else x + x.mT if kind == "symmetric" else x - x.mT
    if model.system.exact_map is not None:  # on <M, P> = 0
        lanes["M"] = algebra.hat(np.cross(algebra.axial(lanes["M"]), lanes["P"]))
    options = {"method": "exact", "progress": False}
    run = kr.simulate(model, lanes, dt=0.25, steps=LONG, every=LONG // 20, **options)
    return short(float(kr.drift(run).ulps.max()))


def set_up(model: Any, state: dict[str, Any]) -> dict[str, float]:
    """Milliseconds for the points of a trajectory, and of one of 64."""
    made, z = scheme(model, "exact", 0.1, None, False), model.state(**state)
    start = tuple(z[k] for k in model.system.space.letters)
    many = tuple(np.stack([x] * LANES) for x in start)
    single, lanes = (min(least(lambda x=x: made.on(x)) for _ in range(n)) for x, n in ((start, OFTEN), (many, 10)))
    return {"set_up": short(single * 1e3), "set_up_lane": short(lanes / LANES * 1e3)}


def timed(model: Any, state: dict[str, Any], method: str = "exact", order: int | None = None) -> float:
    """Nanoseconds of a further step of all lanes: the difference of two lengths."""
    after, steps = steps_of(model, state, dt=0.1, method=method, order=order), 20_000
    return round((least(lambda: after(2 * steps)) - least(lambda: after(steps))) / steps * 1e9)


def of_map(model: Any, z: dict[str, Any]) -> dict[str, Any]:
    """Times of a step of the explicit map."""
    several = {k: np.stack([np.asarray(z[k])] * LANES) for k in z}
    lane = round(timed(model, several, "suris", 1) / LANES, 1)
    return {"system": repr(model), "ns": timed(model, z, "suris", 1), "lane": lane}


def least(go: Callable[[], Any]) -> float:
    """Processor time in seconds: the least of several."""
    best = np.inf
    for _ in range(TURNS):
        begun = time.process_time()
        go()
        best = min(best, time.process_time() - begun)
    return best


def equations(model: Any, count: int) -> list[Any]:
    """The flow of the record in heyoka's variables."""
    import heyoka as hy

    system, names = model.system, hy.make_vars(*[f"y{i}" for i in range(count)])
    derived = call(system.derive, (), model.params) if system.derive is not None else {}
    state = algebra.restore(np.array(names, object), system.space.kinds, model.n)
    rates = call(system.flow, state, {**model.params, **derived})
    return [(x, 0.0 * names[0] + r) for x, r in zip(names, algebra.flatten(rates, system.space.kinds), strict=True)]


def against_heyoka(model: Any, state: dict[str, Any], want: Any = None) -> dict[str, Any]:
    """Times, and errors if the exact state at T = 50 is known."""
    import heyoka as hy

    z = model.state(**state)
    several = {k: np.stack([np.asarray(z[k])] * LANES) for k in z}
    start = algebra.flatten(tuple(np.asarray(z[k]) for k in model.system.space.letters), model.system.space.kinds)
    wide = hy.recommended_simd_size()
    many = np.repeat(start[:, None], wide, 1)
    one = hy.taylor_adaptive(equations(model, len(start)), start.tolist(), tol=TOLERANCE)
    batch = hy.taylor_adaptive_batch(equations(model, len(start)), many.copy(), tol=TOLERANCE)

    def to(end: float) -> None:
        one.time, one.state[:] = 0.0, start
        one.propagate_until(end)

    def all_to(end: float) -> None:
        batch.set_time(0.0)
        batch.state[:] = many
        batch.propagate_until(end)

    to(50.0)
    error = {}
    if want is not None:
        off = max(abs(float(x) - y) for x, y in zip(want, one.state, strict=True)) / max(map(abs, map(float, want)))
        error["heyoka_error"] = short(off)
    times, ratios = {}, {}  # without the points of the trajectory from the difference of two lengths
    for name, x, times_far, lanes in (("", z, 100, 1), ("_lane", several, 20, LANES)):
        p = kr.propagator(model, dt=1.0, method="exact")
        long, short_one = (least(lambda p=p, x=x, n=n: p.steps(x, n)) for n in (FAR * times_far, FAR))
        times["far" + name] = (long - short_one) / (times_far - 1) / lanes
        times["heyoka" + name] = least(lambda: all_to(FAR)) / wide if name else least(lambda: to(FAR))
        ratios["batch" if name else "single"] = short(times["heyoka" + name] * lanes / short_one)
    return error | {k: short(v * 1e3) for k, v in times.items()} | ratios


def short(value: float) -> float:
    return float(f"{value:.2g}")


def main() -> None:
    arguments = parser(__doc__, "exact_pairs")
    arguments.add_argument(
        "--points", action="store_true", help="only set_up, single and batch, in the results of an earlier run"
    )
    options = arguments.parse_args()
    if options.points:
        results = json.loads(Path(options.output).read_text())
        for row, case in zip(results["rows"], CASES, strict=True):
            against = against_heyoka(*case) if find_spec("heyoka") else {}
            row |= set_up(*case) | {k: against[k] for k in ("single", "batch") if k in against}
            print(row, flush=True)
        write(results, options.output)
        return
    rows = []
    for model, state in CASES:
        rows.append(measured(model, state))
        print(rows[-1], flush=True)
    explicit = [of_map(model, model.state(**state)) for model, state in EXPLICIT]
    write({"machine": machine(), "rows": rows, "explicit": explicit}, options.output)


if __name__ == "__main__":
    main()
