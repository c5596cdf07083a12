"""Do rounding errors have a mean?  The change of every integral that a method keeps, averaged over many trajectories.

A walk of rounding errors is as often up as down, so over L trajectories from different states the mean of the last
change is zero up to its standard error: z = mean/(deviation/sqrt(L)) is normal.  This sees a bias a thousand times
smaller than one trajectory shows, and steps that are short decimals, which users take, are where to look: errors of
s x on a grid need not cancel there (`kreisel.algebra.impulse`).

z_worst   the largest |z| over the integrals;  bands  the mean change there after 1e9 steps, in bands of round-off
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
from cases import RESULTS, machine

import kreisel as kr
from kreisel.lab import exact
from kreisel.systems import REGISTRY

LANES, STEPS, STEPS_OF_TIME = 1024, 20_000, (0.05, 0.1, 0.2)
METHODS = {"suris": (1,), "veselov": (2, 4), "baecklund": (2, 4, 8), "variational": (2, 4)}
DECIMAL = {"p": (0.6, 0.0, 0.8), "A": (0.2, -0.3, 0.9), "b": (0.3, 0.7, 1.9), "J": (0.5, 0.75, 1.2)}
FAR = 1e9  # steps for which the mean is told
SIGNIFICANT = 4.5  # of some hundred numbers


def model_of(name: str, n: int, axis: bool) -> kr.Model:
    """The system with short decimals as parameters, or with the axis e_3 for a vector that may be any."""
    system = REGISTRY[name]
    draw = exact.float_random(np.random.default_rng([7, n]))
    params = dict(exact.random_model(system, n, draw).params)
    for letter in params:
        if n == 3 and letter in DECIMAL:
            params[letter] = np.eye(3)[2] if axis and letter in ("p", "A") else np.array(DECIMAL[letter])
    return system(**params)


def starts(model: kr.Model, lanes: int) -> dict[str, np.ndarray]:
    """States of the size of 1, all different."""
    seeds = (exact.float_random(np.random.default_rng([seed, model.n])) for seed in range(lanes))
    states = [exact.random_state(model.system.space, model.n, draw) for draw in seeds]
    letters = model.system.space.letters
    return {letter: np.stack([state[k] for state in states]) for k, letter in enumerate(letters)}


def one(model: kr.Model, method: str, order: int, dt: float, lanes: int, steps: int) -> dict[str, Any]:
    """The largest z over the integrals kept, and the mean change there after FAR steps."""
    start = model.state(**starts(model, lanes))
    run = kr.simulate(model, start, dt=dt, steps=steps, every=steps, method=method, order=order, progress=False)
    worst: dict[str, Any] = {"z": 0.0}
    for name, values in run.data_vars.items():
        if not values.attrs.get("kept", False):
            continue
        ends = np.moveaxis(np.asarray(values), values.dims.index("time"), 0)
        change = (ends[-1] - ends[0]).reshape(lanes, -1)
        size = abs(ends).max(0).reshape(lanes, -1).max(0)
        for part in range(change.shape[1]):
            mean, error = change[:, part].mean(), change[:, part].std() / np.sqrt(lanes)
            if error > 0 and abs(mean / error) > abs(worst["z"]):
                band = np.finfo(float).eps * np.sqrt(FAR) * size[part]
                worst = {"z": round(float(mean / error), 1), "of": f"{name}[{part}]",
                         "bands": float(f"{mean / steps * FAR / band:.2g}")}  # fmt: skip
    return worst


def cases(only: str, sizes: list[int]) -> Iterator[tuple[dict[str, Any], kr.Model]]:
    """Every system with a map, by what tells it."""
    for name, system in REGISTRY.items():
        if only not in name or system.map is None:
            continue
        for n in (n for n in sizes if system.n in (None, n)):
            any_axis = n == 3 and any(p.letter in ("p", "A") for p in system.parameters)
            for axis in (True, False) if any_axis else (False,):
                yield {"system": name, "n": n, "axis": axis}, model_of(name, n, axis)


def main() -> None:
    """Measure, print a table, write the JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default="", help="only systems whose name contains this; no result is written")
    parser.add_argument("--lanes", type=int, default=LANES)
    parser.add_argument("--steps", type=int, default=STEPS)
    parser.add_argument("--n", type=int, nargs="*", default=[3])
    asked = parser.parse_args()
    rows = []
    runs = [(method, order, dt) for method, orders in METHODS.items() for order in orders for dt in STEPS_OF_TIME]
    for told, model in cases(asked.only, asked.n):
        for method, order, dt in runs:
            begun = time.perf_counter()
            try:
                found = one(model, method, order, dt, asked.lanes, asked.steps)
            except kr.InputError:  # the system has no such method, or the step is too long for a state
                continue
            row = told | {"method": method, "order": order, "dt": dt} | found
            rows.append(row)
            mark = "  <---" * (abs(row["z"]) > SIGNIFICANT)
            print(*row.values(), f"{time.perf_counter() - begun:.0f} s{mark}", flush=True)
    biased = [row for row in rows if abs(row["z"]) > SIGNIFICANT]
    print(f"{len(rows)} runs, {len(biased)} with a mean, |z| > {SIGNIFICANT}")
    if not asked.only:
        result = {"machine": machine(), "lanes": asked.lanes, "steps": asked.steps, "rows": rows}
        (RESULTS / "bias.json").write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
