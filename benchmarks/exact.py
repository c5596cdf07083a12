"""The exact flow of the Lagrange top, n = 3: errors against independent references, and cost.

taylor    kr.at in both frames, orientation included, at one random time each, against Taylor series in 20 digits
jumps     kr.at after 1 to 10^12 nutation periods and 0.12 more, against quadrature and Taylor in 50 digits
phase     the paper's map, stepped, against its iterates in closed form: what round-off does to the phase
rows      every step saved, after up to 10^12 steps, against the closed form in many digits
cost      set-up of a motion, a state from it, a row of a run; the plain map's step, in one run

Errors are the largest of any component, relative to 1 or the largest entry, whichever is larger.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from pathlib import Path
from typing import Any

import flint
import mpmath
import numpy as np
from cases import RESULTS, machine

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

import kreisel as kr
from kreisel import algebra
from kreisel.exact.motion import TopMotion
from kreisel.runs.planning import make_plan
from taylor import quadrature, taylor

STATES = {  # m, b or a, p
    "generic": ((0.1, 0.2, 1.5), (0.6, 0, 0.8), (0, 0, 1)),
    "fast, hanging": ((0.3, -0.2, 4), (0.6, 0, -0.8), (0, 0, 1)),
    "E J c < 0": ((0.3, -0.7, -1.1), (0.2, 0.5, -0.4), (0.3, -0.8, 0.5)),
}
IDENTITY = (1, 0, 0, 0)
TOPS = 1000  # against Taylor series; 4 % of them in jumps


def tops(count: int) -> list[Any]:
    draw = np.random.default_rng(7)
    return [draw.normal(size=(3, 3)) * [[2], [1], [1]] for _ in range(count)]


def turned(axis: Any, angle: float) -> Any:
    """The rotation about an axis of any length, as a unit quaternion."""
    return np.concatenate([[np.cos(angle / 2)], np.sin(angle / 2) * algebra.unit(axis)])


def off(got: Any, want: Any) -> float:
    worst = max(float(abs(w - float(g))) for g, w in zip(got.flat, want.flat, strict=True))
    return worst / max(1.0, float(abs(got).max()))


def off_turn(got: Any, want: Any) -> float:
    return min(off(got, want), off(got, -want))


def against_taylor(count: int) -> dict[str, Any]:
    draw = np.random.default_rng(8)
    errors: dict[str, list[float]] = {"state": [], "orientation": [], "moving": []}
    for m, b, p in tops(count):
        when, alpha = draw.uniform(-5, 5), draw.uniform(0.2, 2)
        m1, b1, q = taylor(m, b, p, when, alpha=alpha, digits=20)
        rest = kr.at(kr.LagrangeTop(p=p, alpha=alpha), {"m": m, "a": b}, when, orientation=IDENTITY)
        body = kr.at(kr.LagrangeTopMoving(A=b, alpha=alpha), {"M": m, "P": p}, when)
        flint.ctx.prec = 70
        back = algebra.rotation_matrix(q).T
        down = np.array([flint.arb(v) for v in p], dtype=object)
        m2, p2 = back @ m1, back @ down
        flint.ctx.prec = 53
        errors["state"].append(max(off(rest.m.values, m1), off(rest.a.values, b1)))
        errors["orientation"].append(off_turn(rest.g.values, q))
        errors["moving"].append(max(off(body.M.values, m2), off(body.P.values, p2)))
    return {"tops": count} | {k: spread(v) for k, v in errors.items()}


def spread(errors: list[float]) -> dict[str, float]:
    return {k: float(f"{v:.2g}") for k, v in (("median", np.median(errors)), ("worst", max(errors)))}


def jumps(count: int) -> list[dict[str, Any]]:
    rows: dict[int, dict[str, list[float]]] = {d: {"state": [], "orientation": []} for d in (0, 3, 6, 9, 12)}
    skipped = 0
    for m, b, p in tops(count):
        try:
            figures = quadrature(m, b, p)
        except kr.RunError:  # too near the vertical for the midpoint rule
            skipped += 1
            continue
        for decade, found in rows.items():
            with mpmath.workdps(50):
                when = float((10**decade + mpmath.mpf("0.12")) * figures[0])
                periods = int(mpmath.nint(when / figures[0]))
                rest = mpmath.mpf(when) - periods * figures[0]
                angles = [float(mpmath.fmod(periods * angle, 4 * mpmath.pi)) for angle in figures[1:]]
            flint.ctx.prec = 180
            left_over = flint.arb(mpmath.nstr(rest, 40))
            flint.ctx.prec = 53
            m1, b1, q1 = (v.astype(float) for v in taylor(m, b, p, left_over, digits=20))
            run = kr.at(kr.LagrangeTop(p=p), {"m": m, "a": b}, when, orientation=IDENTITY)
            about_p, about_b = (turned(v, angle) for v, angle in zip((p, b), angles, strict=True))
            R = algebra.rotation_matrix(about_p)
            want = algebra.quaternion_product(about_p, algebra.quaternion_product(q1, about_b))
            found["state"].append(max(off(run.m.values, R @ m1), off(run.a.values, R @ b1)))
            found["orientation"].append(off_turn(run.g.values, want))
    return [
        {"periods": f"1e{d}", "tops": count - skipped} | {k: spread(v) for k, v in found.items()}
        for d, found in rows.items()
    ]


def phase(most: int) -> list[dict[str, Any]]:
    rows = []
    for name, (m, a, p) in STATES.items():
        top = kr.LagrangeTop(p=p)
        for eps in (0.1, 0.33, 1.0):
            row: dict[str, Any] = {"state": name, "dt": eps}
            for decade in range(4, most + 1):
                steps = 10**decade
                run = kr.simulate(top, {"m": m, "a": a}, dt=eps, steps=steps, every=steps, method="suris", order=1)
                true = kr.at(top, {"m": m, "a": a}, steps, method="suris", dt=eps, order=1)
                worst = max(abs(run[k].values[-1] - true[k].values).max() for k in ("m", "a"))
                row[f"1e{decade}"] = float(f"{worst:.2g}")
            rows.append(row)
            print(row, flush=True)
    return rows


def rows(counts: tuple[int, ...]) -> list[dict[str, Any]]:
    """Each of the last 200 steps of a run, against the closed form in 40 digits at the exact times."""
    out = []
    for name, (m, b, p) in STATES.items():
        for dt in (0.1, 0.33, 1.0):
            row: dict[str, Any] = {"state": name, "dt": dt}
            start = {"m": m, "a": b}
            plan = make_plan(kr.LagrangeTop(p=p), start, **OPTIONS | {"dt": dt, "steps": 10**15}, orientation=IDENTITY)
            here = TopMotion(m, b, p, reach=dt * counts[-1])
            for count in counts:
                plan.engine.restore({"steps": np.asarray(float(count - 200)), "z": plan.engine.z})
                found = np.empty((200, 1, 10))
                plan.engine.advance(found, 1)
                seen, worst = plan.observe(found), [0.0, 0.0]
                for i in range(19, 200, 20):
                    state, turn = in_digits(here, here.ctx.mpf(dt) * (count - 199 + i))
                    got = np.concatenate([seen["m"][i], seen["a"][i]])
                    worst = [max(worst[0], off(got, state)), max(worst[1], off_turn(seen["g"][i], turn))]
                row[f"{count:.0e}"] = [float(f"{v:.2g}") for v in worst]
            out.append(row)
            print(row, flush=True)
    return out


def in_digits(here: TopMotion, time: Any) -> tuple[Any, Any]:
    """The m and b, and the orientation from time 0, at a time in the digits of the motion."""
    ctx, period = here.ctx, 2 * here.nutation.half_period
    m, b, q = here.jump(time - ctx.nint(time / period) * period)
    left, right = (
        here._about(
            np.array([ctx.convert(float(x)) for x in axis]), 2 * ctx.pi * (rate * time - ctx.floor(rate * time))
        )
        for axis, rate in ((here.p, here.means[0]), (here.b, -here.means[1]))
    )
    R = algebra.rotation_matrix(left)
    turned = algebra.quaternion_product(left, algebra.quaternion_product(q, right))
    return np.concatenate([R @ m, R @ b]), turned


FIRST = 200_000  # rows of a run of a top that are jumps
OPTIONS = {"every": 1, "method": "exact", "order": None}


def cost() -> dict[str, Any]:
    """Times of one core, by the processor time of the thread, of kr.simulate and of a propagator.

    Medians.  First rows are jumps, later ones share a set-up in many digits: differences of runs, as the set-up is.
    """
    os.environ["KREISEL_NUM_THREADS"] = "1"
    m, b, p = STATES["generic"]
    top, state, steps, count = kr.LagrangeTop(p=p), {"m": m, "a": b}, 10**6, 40_000
    body, inside = kr.LagrangeTopMoving(A=b), {"M": m, "P": p}
    map_: dict[str, Any] = {"method": "suris", "order": 1}
    closed, plain = kr.propagator(top, method="exact"), kr.propagator(top, dt=0.1, **map_)
    times = np.random.default_rng(1).uniform(-1e9, 1e9, count)

    def seconds(call: Any) -> float:
        begun = time.thread_time()
        call()
        return time.thread_time() - begun

    def rows(rows: int, model: Any = top, start: Any = state, observe: Any = (), g: Any = None) -> float:
        options: dict[str, Any] = {"dt": 0.1, "steps": rows, "method": "exact", "observe": observe, "orientation": g}
        return seconds(lambda: kr.simulate(model, start, **options))

    cases: dict[str, dict[str, Any]] = {
        "row": {},
        "row with integrals": {"observe": None},
        "row with orientation": {"g": IDENTITY},
        "row in the moving frame": {"model": body, "start": inside},
    }
    took: dict[str, list[float]] = {}
    for _ in range(12):
        plain_rows = [
            seconds(lambda k=k: kr.simulate(top, state, dt=0.1, steps=k, observe=(), **map_)) for k in (1, FIRST)
        ]
        values = {
            "row of the plain map ns": (plain_rows[1] - plain_rows[0]) / FIRST * 1e9,
            "state at any time us": seconds(lambda: closed.at(state, times)) / count * 1e6,
            "plain map ns a step": seconds(lambda: plain.steps(state, steps)) / steps * 1e9,
        }
        for name, case in cases.items():
            first, last, later, latest = (rows(k, **case) for k in (1, FIRST, 2 * FIRST, 4 * FIRST))
            each = (latest - later) / (2 * FIRST)
            values[f"first {name} ns"] = (last - first) / FIRST * 1e9
            values[f"later {name} ns"] = each * 1e9
            values[f"set-up, {name} ms"] = (later - last - FIRST * each) * 1e3
        for name, value in values.items():
            took.setdefault(name, []).append(value)
    return {name: float(f"{np.median(vs[1:]):.3g}") for name, vs in took.items()}


PARTS = {
    "taylor": lambda quick: against_taylor(40 if quick else TOPS),
    "jumps": lambda quick: jumps(5 if quick else max(5, TOPS // 25)),
    "phase": lambda quick: phase(6 if quick else 8),
    "rows": lambda quick: rows((10**4, 10**6) if quick else (10**4, 10**5, 10**6, 10**7, 10**8, 10**12)),
    "cost": lambda quick: cost(),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="40 tops, 10^6 steps: half a minute; nothing is written")
    parser.add_argument("--part", choices=PARTS, action="append", help="only this part; the others keep their results")
    asked = parser.parse_args()
    target = RESULTS / "exact.json"
    for name in asked.part or PARTS:
        found = PARTS[name](asked.quick)
        print(json.dumps({name: found}, indent=1), flush=True)
        if not asked.quick:
            result = json.loads(target.read_text()) if target.exists() else {}
            target.write_text(json.dumps(result | {"machine": machine(), name: found}, indent=1) + "\n")


if __name__ == "__main__":
    main()
