"""Do rounding errors walk at random?  Every integral of every map over decades of steps.

A random walk of N rounding errors stays within a few bands eps_machine * (sensitivity * sqrt(N) + size), the
unit of `kr.drift`; a bias, however small, grows through the band like sqrt(N).  For each run and each integral:

ratio  max |change| in bands; the requirement is 2 or less
z      last change over what the run's own 1000 increments make of a random walk: about normal, |z| < 4, without bias
slope  last change over N, the bias a step if there is one

and for each map over all its runs, of the first Casimir (|a|^2, |P|^2) and the deformed energy:

rms z     1 for a random walk, growing like sqrt(N) for a bias
exponent  of N in the root mean square of the last change: 1/2 for a walk, 1 for a bias
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from cases import RESULTS, Case, cases, machine

import kreisel as kr

STEPS_OF_TIME = (0.05, 0.2, 0.33, 1.0)  # 0.2: short decimals are where a bias shows
DECADES = (10**6, 10**7, 10**8)

DECADES_QUICK = (10**5, 10**6, 10**7)
LONGEST = (10**8, 10**9, 10**10)  # of 0.2
SAVED = 1000
ALLOWED, SIGNIFICANT = 2.0, 4.0


def runs_of(
    case: Case, states: dict[str, dict[str, Any]], dt: float, steps: int, method: str = "suris", order: int = 1
) -> list[dict[str, dict[str, float]]]:
    """For each state, per kept integral: ratio, z, slope and last change in bands.

    All states run as lanes of one ensemble, which has the bits of single runs.
    """
    each = [case.model.state(**state) for state in states.values()]
    start = {letter: np.stack([state[letter] for state in each]) for letter in each[0]}
    options = {"dt": dt, "steps": steps, "every": steps // SAVED, "method": method, "order": order}
    ensemble = kr.simulate(case.model, case.model.state(**start), progress=False, **options)
    return [_rows(ensemble.isel(lane=lane), steps) for lane in range(len(states))]


def _rows(run: Any, steps: int) -> dict[str, dict[str, float]]:
    table = kr.drift(run)
    rows = {}
    for name, told in table[table["conserved"]].iterrows():
        series = _series(run, str(name))
        increments, last = np.diff(series), float(series[-1] - series[0])
        spread = float(increments.std() * np.sqrt(len(increments)))
        rows[str(name)] = {
            "ratio": _short(told["ratio"]),
            "z": _short(last / spread) if spread > 0 else 0.0,
            "slope": _short(last / steps),
            "bands": _short(last / told["roundoff"]) if told["roundoff"] > 0 else 0.0,
        }
    return rows


def _short(x: float) -> float:
    return float(f"{x:.4g}")


def _series(run: Any, label: str) -> np.ndarray:
    """The values of "energy_eps" or "spectrum_eps[1]", a row of `kr.drift`, against time."""
    name, _, part = label.rstrip("]").partition("[")
    values = np.asarray(run[name].values)
    return values[:, int(part)] if part else values


def one_map(case: Case, decades: tuple[int, ...], times: tuple[float, ...] = STEPS_OF_TIME) -> dict[str, Any]:
    """All runs of a map, and what they say together."""
    runs = [
        {"state": label, "dt": dt, "steps": steps, "integrals": rows}
        for steps in decades
        for dt in times
        for label, rows in zip(case.states, runs_of(case, case.states, dt, steps), strict=True)
    ]
    return {"n": case.n, "worst_ratio": _worst(runs, decades), "trend": _trends(runs, decades), "runs": runs}


def _worst(runs: list[dict[str, Any]], decades: tuple[int, ...]) -> dict[str, dict[str, float]]:
    out: dict[str, dict[str, float]] = {}
    for run in runs:
        for name, row in run["integrals"].items():
            worst = out.setdefault(name, {f"{steps:.0e}": 0.0 for steps in decades})
            worst[f"{run['steps']:.0e}"] = max(worst[f"{run['steps']:.0e}"], round(row["ratio"], 3))
    return out


def _trends(runs: list[dict[str, Any]], decades: tuple[int, ...]) -> dict[str, dict[str, Any]]:
    out = {}
    for name in ("casimir[0]", "energy_eps"):
        z, rms = {}, []
        for steps in decades:
            rows = [run["integrals"][name] for run in runs if run["steps"] == steps]
            z[f"{steps:.0e}"] = np.array([row["z"] for row in rows])
            rms.append(np.sqrt(steps * np.mean([row["bands"] ** 2 for row in rows])))
        slopes = [abs(run["integrals"][name]["slope"]) for run in runs if run["steps"] == decades[-1]]
        out[name] = {
            "rms_z": {k: round(float(np.sqrt((v**2).mean())), 2) for k, v in z.items()},
            "max_abs_z": {k: round(float(abs(v).max()), 2) for k, v in z.items()},
            "exponent": round(float(np.polyfit(np.log(decades), np.log(rms), 1)[0]), 2),
            "largest_slope": max(slopes),
        }
    return out


def verdict(result: dict[str, Any]) -> list[str]:
    """The integrals beyond the requirement, and the Casimirs with a trend, at the longest runs."""
    told = []
    for name, found in result.items():
        for integral, ratios in found["worst_ratio"].items():
            last = list(ratios.values())[-1]
            if last > ALLOWED:
                told.append(f"{name}: {integral} at {last:.2f} bands")
        for integral, trend in found["trend"].items():
            z = list(trend["max_abs_z"].values())[-1]
            if z > SIGNIFICANT:
                told.append(f"{name}: {integral} has a trend, |z| = {z:.1f}")
    return told


def measure(
    sizes: Sequence[tuple[int, tuple[int, ...]]],
    times: tuple[float, ...] = STEPS_OF_TIME,
    only: str = "",
    output: Path | None = None,
) -> dict[str, Any]:
    """The maps of each (n, decades), as written to results/roundoff.json, which grows map by map.

    Maps without `only` in their name keep what the file has of them.
    """
    there = only and output is not None and output.exists()
    maps: dict[str, Any] = json.loads(output.read_text())["maps"] if there and output else {}
    result = {"machine": machine(), "dt": times, "saved": SAVED, "verdict": verdict(maps), "maps": maps}
    _head()
    for n, decades in sizes:
        for case in cases(n):
            begun = time.perf_counter()
            label = f"{case.name}, n = {n}"
            if only not in label:
                continue
            maps[label] = one_map(case, decades, times)
            _print(label, maps[label], time.perf_counter() - begun)
            result["verdict"] = verdict(maps)
            if output is not None:
                output.parent.mkdir(exist_ok=True)
                output.write_text(json.dumps(result, indent=1, default=float) + "\n")
    print("\nBeyond 2 bands or with a trend (|z| > 4):", *(result["verdict"] or ["nothing"]), sep="\n  ")
    return result


def _head() -> None:
    print("Worst ratio to the band of kr.drift over all states and steps; trends of the first Casimir and the energy.")
    print(
        f"\n{'map':<28}{'steps':>7}{'casimirs':>10}{'energy':>8}{'others':>8}   "
        f"{'rms z (Casimir, energy)':<25}{'exponents':<13}seconds"
    )


def _print(label: str, found: dict[str, Any], seconds: float) -> None:
    worst, trend = found["worst_ratio"], found["trend"]
    sizes = list(next(iter(worst.values())))
    for steps in sizes:
        groups = [
            max([ratios[steps] for name, ratios in worst.items() if group(name)], default=0.0)
            for group in (_is_casimir, _is_energy, lambda name: not (_is_casimir(name) or _is_energy(name)))
        ]
        z = ", ".join(f"{row['rms_z'][steps]:.2f}" for row in trend.values())
        line = f"{label:<28}{steps:>7}{groups[0]:>10.2f}{groups[1]:>8.2f}{groups[2]:>8.2f}   {z:<25}"
        if steps == sizes[-1]:
            line += f"{', '.join(str(row['exponent']) for row in trend.values()):<13}{seconds:.0f}"
        print(line, flush=True)


def _is_casimir(name: str) -> bool:
    return name.startswith("casimir")


def _is_energy(name: str) -> bool:
    return name.startswith("energy")


def main(arguments: list[str] | None = None) -> None:
    """Measure, print a table, write the JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    form = parser.add_mutually_exclusive_group()
    form.add_argument("--long", action="store_true", help="another decade, 1e9 steps for n = 3 (some ten minutes)")
    form.add_argument(
        "--longest",
        action="store_true",
        help="1e8, 1e9 and 1e10 steps of 0.2 for n = 3, to results/roundoff_longest.json (an hour of one core)",
    )
    form.add_argument("--quick", action="store_true", help="a decade less (about half a minute)")
    parser.add_argument("--only", default="", help="only maps whose name contains this; the others keep their results")
    parser.add_argument("--output", type=Path)
    options = parser.parse_args(arguments)
    name = "roundoff_longest.json" if options.longest else "roundoff.json"
    output = options.output or RESULTS / name
    if options.longest:
        sizes, times = [(3, LONGEST)], (0.2,)
    else:
        decades = DECADES_QUICK if options.quick else (*DECADES, 10**9) if options.long else DECADES
        sizes, times = [(3, decades), (4, DECADES_QUICK[:-1] if options.quick else DECADES)], STEPS_OF_TIME
    measure(sizes, times, options.only, output)
    print(f"\nWritten: {output}")


if __name__ == "__main__":
    main()
