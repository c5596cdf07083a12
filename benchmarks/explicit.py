"""The explicit maps of quadratic fields, n = 3: operations of a step, the longest chain of them, time, and its bound.

Time: without projections, from the shortest of many short calls, alternating with the other maps, one trajectory and a
lane of 64; others' work on the machine raises it.  `of_lagrange_top`: of the paper's map, lagrange-top, in the same
run.  Bound of a lane: products (fused ones too) at the clock that a loop of products shows, a
vector in one cycle, and each quotient as long as four.  The chain is in cycles, from the state before to that after.
"""

from __future__ import annotations

import json
import time
from code import LATENCY
from collections import Counter
from typing import Any

import numpy as np
from cases import RESULTS, machine

import kreisel as kr
from kreisel.graph.graph import FMA, IN, OVER, TIMES, Number, operands_of
from kreisel.graph.llvm import DOUBLE, kind_of
from kreisel.graph.machine import address_of, kernel, register_width
from kreisel.graph.recording import Recording, flat_constants, flat_stages
from kreisel.runs.planning import make_plan

STEPS, LANES, CALLS, QUOTIENT, PRODUCTS = 40_000, 64, 300, 4, 64
CASES: dict[str, tuple[Any, str]] = {
    "kovalevskaya-top, two fields": (kr.KovalevskayaTop(n=3), "MPQ"),
    "kovalevskaya-gyrostat": (kr.KovalevskayaGyrostat(n=3, gamma=0.4), "MPQ"),
    "ratiu-top": (kr.RatiuTop(n=3, a=1.0, b=0.7, chi=0.8), "MG"),
    "quadratic-field": (kr.QuadraticField(b=(0.2, 0.5, 1.1)), "MF"),
    "lagrange-top": (kr.LagrangeTop(p=(0, 0, 1)), "ma"),
    "clebsch": (kr.Clebsch(b=(0.2, 0.5, 1.1)), "MP"),
}


def state(letters: str, lanes: tuple[int, ...] = ()) -> dict[str, np.ndarray]:
    draw = np.random.default_rng(1)
    values = {letter: 0.5 * draw.normal(size=(*lanes, 3)) for letter in letters}
    if "F" in letters:
        F = 0.5 * draw.normal(size=(*lanes, 3, 3))
        values["F"] = (F + np.swapaxes(F, -1, -2)) / 2
    return values


def nanoseconds_of_a_product() -> float:
    """Of vectors, by a loop of independent ones."""

    def write(f: Any) -> None:
        f.vectors(register_width())
        kind = kind_of(register_width())
        rooms, x = f.variables(8, kind), f.spread(DOUBLE(0.999), kind)
        for room in rooms:
            room[0] = x
        with f.loop(0, f.arguments[1]):
            for _ in range(PRODUCTS // 8):
                for room in rooms:
                    room[0] = f.intrinsic("fma", room[0], x, x)
        out = f.doubles(f.arguments[0]).of(kind)
        for k, room in enumerate(rooms):
            out[k] = room[0]

    loop, out, best = kernel(("products", PRODUCTS, register_width()), 2, write), np.empty(128), float("inf")
    for _ in range(CALLS):
        begun = time.perf_counter()
        loop(address_of(out), STEPS)
        best = min(best, (time.perf_counter() - begun) / STEPS / PRODUCTS)
    return best * 1e9


def counted(model: Any, letters: str) -> tuple[Counter[str], int]:
    """Operations of a step by their signs, and the longest chain in cycles."""
    scheme = make_plan(model, model.state(**state(letters)), dt=0.05, steps=1, method="suris", order=1).scheme
    record = Recording(scheme, *flat_constants(scheme, 1), flat_stages(scheme, 1)[1])
    (piece,) = record.pieces
    fixed, ends, counts = record.fixed(piece), dict[int, int](), Counter[str]()
    for at in piece.nodes:
        operation = piece.graph.nodes[at][0]
        before = [ends[x.at] for x in operands_of(piece.graph.nodes[at]) if x.at in ends]
        if operation == IN:
            ends |= {} if at in fixed else {at: 0}
        elif at not in fixed:
            counts[operation] += 1
            ends[at] = max(before) + LATENCY.get(operation, 4)
    return counts, max(ends.get(x.at, 0) for x in piece.outputs if isinstance(x, Number))


def least_times() -> dict[str, list[float]]:
    """Nanoseconds of a step of one trajectory and of a lane: calls of many steps less those of one."""
    runs, least = dict[tuple[str, int, bool], Any](), dict[tuple[str, int, bool], float]()
    for name, (model, letters) in CASES.items():
        motion = kr.propagator(model, method="suris", order=1, dt=0.05, project=False)
        for place, lanes in enumerate(((), (LANES,))):
            for steps in (1, STEPS // (10 if lanes else 1)):
                runs[name, place, steps > 1] = motion, state(letters, lanes), steps
    for _ in range(CALLS):
        for key, (motion, x, steps) in runs.items():
            begun = time.perf_counter()
            motion.steps(x, steps)
            least[key] = min(time.perf_counter() - begun, least.get(key, float("inf")))
    units = 1e9 / STEPS, 1e10 / STEPS / LANES
    return {n: [(least[n, i, True] - least[n, i, False]) * unit for i, unit in enumerate(units)] for n in CASES}


def main() -> None:
    product, times, rows = nanoseconds_of_a_product(), least_times(), {}
    for name, (model, letters) in CASES.items():
        (counts, chain), (single, lane) = counted(model, letters), times[name]
        cycles = counts[TIMES] + counts[FMA] + QUOTIENT * counts[OVER]
        rows[name] = {
            "operations": counts.total(),
            "products": counts[TIMES] + counts[FMA],
            "quotients": counts[OVER],
            "chain_cycles": chain,
            "single_ns": round(single, 2),
            "lane_ns": round(lane, 2),
            "lane_bound_ns": round(cycles * product / register_width(), 2),
            "of_lagrange_top": round(lane / times["lagrange-top"][1], 2),
        }
        print(name, rows[name], flush=True)
    out = {"machine": machine(), "ns_of_a_product": round(product, 3), "maps": rows}
    (RESULTS / "explicit.json").write_text(json.dumps(out, indent=1) + "\n")


if __name__ == "__main__":
    main()
