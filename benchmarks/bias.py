"""Do rounding errors have a mean?  The change of every integral that a method keeps, over many trajectories.

A walk of rounding errors is as often up as down.  Over L trajectories from different states

mean   the mean of the last change over its standard error: normal, and far from 0 if all states share a bias
rms    the root mean square of the last change over that of a walk with the run's own increments: 1, and more if each
       state has a bias of its own

Steps that are short decimals, which users take, are where to look: errors of s x on a grid need not cancel there
(`kreisel.algebra.increment`); constants that are rounded once for all, at any step.  Of each run the integrals with the
largest of the two are told.  Half an hour of one core; rows are written as they come.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from cases import RESULTS, machine

import kreisel as kr
from kreisel.lab import exact
from kreisel.systems import REGISTRY

LANES, ROWS, STEPS_OF_TIME = 128, 50, (0.1, 0.2)
METHODS = {  # orders, steps
    "suris": ((1,), 1_000_000),
    "veselov": ((2, 4), 500_000),
    "baecklund": ((2, 4), 500_000),
    "variational": ((2,), 200_000),
}
SHORTER = {("rosochatius", "variational"): 0.1}  # times the step: its walls, mu^2/x^3, are steep
DECIMAL = {"p": (0.6, 0.0, 0.8), "A": (0.2, -0.3, 0.9), "b": (0.3, 0.7, 1.9), "J": (0.5, 0.75, 1.2)}
MEAN, RMS = 4.5, 1.4  # beyond them, of some hundred numbers each
ZERO = 1e-10  # what stays below is zero, and its rounding errors are no walk
SILENT = 1e-3  # of a band: a walk below is that of the last place of a number that stands still


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
    """The largest |mean| and rms over the integrals kept."""
    start, every = model.state(**starts(model, lanes)), steps // ROWS
    run = kr.simulate(model, start, dt=dt, steps=steps, every=every, method=method, order=order, progress=False)
    found: dict[str, Any] = {"mean": 0.0, "of": "", "rms": 0.0, "rms of": ""}
    for name, values in run.data_vars.items():
        if not values.attrs.get("kept", False):
            continue
        series = np.asarray(values.transpose("time", "lane", ...)).reshape(ROWS + 1, lanes, -1)
        series = series[..., abs(series).max((0, 1)) > ZERO]
        change, walk = series[-1] - series[0], np.diff(series, axis=0).std(0) * ROWS**0.5
        band = np.finfo(float).eps * steps**0.5 * (1e-30 + abs(series).max(0))
        for part in range(series.shape[2]):
            moved = walk[:, part] > SILENT * band[:, part]
            if moved.sum() < lanes // 2:
                continue
            d = change[moved, part]
            mean, rms = d.mean() / d.std() * len(d) ** 0.5, ((d / walk[moved, part]) ** 2).mean() ** 0.5
            if abs(mean) > abs(found["mean"]):
                found |= {"mean": round(float(mean), 1), "of": f"{name}[{part}]"}
            if rms > found["rms"]:
                found |= {"rms": round(float(rms), 2), "rms of": f"{name}[{part}]"}
    return found


def cases(only: str, sizes: list[int]) -> Iterator[tuple[dict[str, Any], kr.Model]]:
    """Every system with a map, by what tells it."""
    for name, system in REGISTRY.items():
        if only not in name or system.map is None:
            continue
        for n in [system.n] if system.n else sizes:
            any_axis = n == 3 and any(p.letter in ("p", "A") for p in system.parameters)
            for axis in (True, False) if any_axis else (False,):
                yield {"system": name, "n": n, "axis": axis}, model_of(name, n, axis)


def biased(row: dict[str, Any]) -> bool:
    """Whether one of the two is more than chance."""
    return abs(row["mean"]) > MEAN or row["rms"] > RMS


def main() -> None:
    """Measure, print a table, write the JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default="", help="only systems whose name contains this; the others keep their rows")
    parser.add_argument("--lanes", type=int, default=LANES)
    parser.add_argument("--n", type=int, nargs="*", default=[3])
    parser.add_argument("--output", type=Path, default=RESULTS / "bias.json")
    asked = parser.parse_args()
    before = json.loads(asked.output.read_text())["rows"] if asked.only and asked.output.exists() else []
    rows = [row for row in before if asked.only not in row["system"]]
    runs = [(m, order, n, dt) for m, (orders, n) in METHODS.items() for order in orders for dt in STEPS_OF_TIME]
    for told, model in cases(asked.only, asked.n):
        for method, order, steps, time_step in runs:
            begun, dt = time.perf_counter(), round(time_step * SHORTER.get((told["system"], method), 1), 6)
            try:
                found = one(model, method, order, dt, asked.lanes, steps)
            except kr.InputError:  # the system has no such method, or the step is too long for a state
                continue
            except kr.RunError as fault:
                print(*told.values(), method, order, dt, "ended:", str(fault)[:80], flush=True)
                continue
            row = told | {"method": method, "order": order, "dt": dt, "steps": steps} | found
            rows.append(row)
            mark = "  <---" * biased(row)
            print(*row.values(), f"{time.perf_counter() - begun:.0f} s{mark}", flush=True)
            result = {"machine": machine(), "lanes": asked.lanes, "mean": MEAN, "rms": RMS, "rows": rows}
            asked.output.write_text(json.dumps(result, indent=1) + "\n")
    print(f"{len(rows)} runs, {sum(map(biased, rows))} with |mean| > {MEAN} or rms > {RMS}")


if __name__ == "__main__":
    main()
