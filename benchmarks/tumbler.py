"""Are the periods of a tumbler found from its light?  Synthetic light of Apophis in two apparitions eight years apart.

    python benchmarks/tumbler.py [--narrow 100] [--wide 10] [--fits 100]

Writes results/tumbler.json after each search, and continues with the seeds that it lacks.  The body has the moments and
periods of Apophis [Pravec et al. 2014: a short-axis mode, P_phi = 27.38 h, P_psi = 263 h]; an ellipsoid of constant
density with Lommel-Seeliger's law.  Orbits of Apophis and the Earth are ellipses that have the approaches of January
2013 and March 2021.  400 magnitudes in 40 nights, 200 in 25 nights eight years later, errors of 2 %, an unknown
constant in each.

wide      complete fits of other data each, of both modes, from ranges of 24 to 32 and of 150 to 400 hours: the aliases
          found, the time, and whether one of them has both periods within 3 sigma of the truth.  Even seeds have the
          pole and the phases of Apophis, pole (250, -75) degrees, odd seeds others; the ends of the ranges vary by 3 %
narrow    the short-axis mode, from ranges as the Fourier analysis of one apparition gives: 26 to 29, 220 to 320 hours
fits      least squares that begin at the truth, with other errors: how often the truth is within 3 sigma of each
          unknown, and of both periods; this does not test the search
"""

from __future__ import annotations

import json
import time
from dataclasses import replace
from typing import Any

import numpy as np
import xarray as xr
from cases import machine, parser, write

import kreisel as kr
from kreisel.analysis import fit_light_curve, light_curve
from kreisel.analysis.photometry import UNKNOWNS, TumblerFit, _inverse, _light, _seen
from kreisel.analysis.tumbling import refined
from kreisel.physical import SUN, Orbit

AU, DAY, HOUR, DEGREE = 1.495978707e11, 86_400.0, 3600.0, np.pi / 180
APOPHIS = Orbit(0.9224 * AU, 0.1912, 3.34 * DEGREE, 204.1 * DEGREE, 126.5 * DEGREE, SUN, 118 * DEGREE)  # 2013-01-01
EARTH = Orbit(AU, 0.0167, perigee=102.94 * DEGREE, mean_anomaly=-1 * DEGREE, primary=SUN)
MOMENTS = (0.61, 0.965)
AMPLITUDE = np.sqrt(1 - 0.61 * 0.965 / (0.39 * 0.035) / (263 / 27.38 - 1) ** 2)  # `kreisel.analysis.tumbling`
TRUTH = np.array(
    [250 * DEGREE, -75 * DEGREE, 152 * DEGREE, 14 * DEGREE, 27.38 * HOUR, 263 * HOUR, MOMENTS[0], AMPLITUDE]
)
NIGHTS = ((-12, 108, 40, 10), (2902, 3022, 25, 8))  # first and last day, nights, magnitudes in 5 hours of each
SIGMA = 0.02
RANGES = {
    "wide": {"precession": (24 * HOUR, 32 * HOUR), "rotation": (150 * HOUR, 400 * HOUR)},
    "narrow": {"precession": (26 * HOUR, 29 * HOUR), "rotation": (220 * HOUR, 320 * HOUR)},
}
MODES = {"wide": ["short-axis", "long-axis"], "narrow": ["short-axis"]}


def drawn(seed: int, kind: str) -> tuple[Any, dict[str, Any]]:
    """The true unknowns of a seed, and ranges of the periods."""
    draw, truth = np.random.default_rng((seed, 1)), TRUTH.copy()
    if seed % 2:
        truth[:4] = *draw.uniform(0, 2 * np.pi, 1), np.arcsin(draw.uniform(-1, 1)), *draw.uniform(0, 2 * np.pi, 2)
    return truth, {name: tuple(np.array(v) * draw.uniform(0.97, 1.03, 2)) for name, v in RANGES[kind].items()}


def motion(unknowns: Any) -> TumblerFit:
    """The true motion, in the form of a fit."""
    import pandas as pd

    row = {"mode": "short-axis", "chi2": 0.0, **dict(zip(UNKNOWNS, unknowns, strict=True)), "moment_b": MOMENTS[1]}
    return TumblerFit(pd.DataFrame([row]), np.zeros((1, 8, 8)), 0, 48 * DAY, None)


def observed(draw: np.random.Generator, unknowns: Any = TRUTH) -> xr.Dataset:
    nights = [(np.linspace(a, b, n), m) for a, b, n, m in NIGHTS]
    days = np.concatenate([(night[:, None] + draw.uniform(0, 5 / 24, (len(night), m))).ravel() for night, m in nights])
    t = np.sort(days) * DAY
    sun, truth = -APOPHIS.at(t)[0], motion(unknowns)
    observer = EARTH.at(t)[0] + sun
    states = kr.at(truth.body(), truth.state(), t - truth.epoch)
    magnitude = light_curve(states, sun=sun, observer=observer).magnitude.values + SIGMA * draw.normal(size=len(t))
    data = {"magnitude": ("time", magnitude), "sigma_magnitude": SIGMA}
    return xr.Dataset({**data, "sun": (("time", "xyz"), sun), "observer": (("time", "xyz"), observer)}, {"time": t})


def searched(seed: int, kind: str) -> dict[str, Any]:
    truth, ranges = drawn(seed, kind)
    data = observed(np.random.default_rng(seed), truth)
    begin = time.perf_counter(), time.process_time()
    fit = fit_light_curve(data, modes=MODES[kind], **ranges)
    seconds, processor = time.perf_counter() - begin[0], time.process_time() - begin[1]
    names = UNKNOWNS[4:6]
    off = [abs(fit.table[n] - t) / fit.table[f"error_{n}"] for n, t in zip(names, truth[4:6], strict=True)]
    near = np.maximum(*off)
    out = {
        "seed": seed,
        "seconds": round(seconds),
        "processor_seconds": round(processor, 1),
        "chi2": round(float(fit.table["chi2"].min()), 2),
        "aliases": len(fit.table),
        "sigmas": round(float(near.min()), 2),
        "alias of the truth": int(near.argmin()),
        "periods_hours": (fit.table[list(names)] / HOUR).round(4).to_numpy().tolist(),
        "chi2 above the least": (fit.table["chi2"] - fit.table["chi2"].min()).round(2).tolist(),
        "modes": fit.table["mode"].tolist(),
    }
    print(out, flush=True)
    return out


def summary(searches: list[dict[str, Any]]) -> dict[str, Any]:
    """How often the truth was found, and the interval of its probability, of 95 % [Clopper, Pearson 1934]."""
    from scipy.stats import binomtest

    found = sum(each["sigmas"] < 3 for each in searches)
    interval = binomtest(found, len(searches)).proportion_ci(0.95)
    return {
        "count": len(searches),
        "truth within 3 sigma": found,
        "probability": [round(interval.low, 3), round(interval.high, 3)],
        "aliases": {k: sum(each["aliases"] == k for each in searches) for k in {e["aliases"] for e in searches}},
        "processor_seconds": float(np.median([each["processor_seconds"] for each in searches])),
    }


def fitted(count: int, first: int) -> dict[str, Any]:
    """How often the truth is within 3 standard errors, of fits that begin there."""
    off, chi2 = np.empty((count, 8)), np.empty(count)
    for k in range(count):
        seen, epoch = _seen(observed(np.random.default_rng(first + k)), None, *_light(None, "lommel-seeliger", None))
        seen = replace(seen, time=seen.time + epoch - 48 * DAY)
        x, chi2[[k]] = refined(seen, TRUTH[None], "short-axis")
        off[k] = abs(x[0] - TRUTH) / np.sqrt(np.diag(_inverse(seen.jacobian(x, "short-axis")[1][0])))
    inside = {name: int((off[:, i] < 3).sum()) for i, name in enumerate(UNKNOWNS)}
    both = int((off[:, 4:6] < 3).all(1).sum())
    print(f"fits from the truth: {inside}, both periods {both} of {count}, mean chi^2 {chi2.mean():.1f}", flush=True)
    return {"count": count, "within 3 sigma": inside, "both periods": both, "mean chi2": float(chi2.mean())}


def main() -> None:
    options = parser(__doc__, "tumbler")
    options.add_argument("--narrow", type=int, default=100)
    options.add_argument("--wide", type=int, default=10)
    options.add_argument("--fits", type=int, default=100)
    args = options.parse_args()
    result: dict[str, Any] = json.loads(args.output.read_text()) if args.output.exists() else {}
    result |= {"machine": machine()}
    if args.fits:
        result["fits"] = fitted(args.fits, 1000)
    for kind in MODES:
        before = result.get(kind, {}).get("searches", [])
        for seed in sorted(set(range(getattr(args, kind))) - {each["seed"] for each in before}):
            before.append(searched(seed, kind))
            result[kind] = summary(before) | {"searches": before}
            write(result, args.output)
    write(result, args.output)


if __name__ == "__main__":
    main()
