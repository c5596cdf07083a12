"""Are the periods of a tumbler found from its light?  Synthetic light of Apophis in two apparitions eight years apart.

    python benchmarks/tumbler.py [--searches 4] [--fits 100]

Writes results/tumbler.json.  The body has the moments, periods, pole and phases of Apophis [Pravec et al. 2014: a
short-axis mode, P_phi = 27.38 h, P_psi = 263 h, pole (250, -75) degrees]; an ellipsoid of constant density with
Lommel-Seeliger's law.  Orbits of Apophis and the Earth are ellipses that have the approaches of January 2013 and March
2021.  400 magnitudes in 40 nights, 200 in 25 nights eight years later, errors of 2 %, an unknown constant in each.

searches  complete fits, from ranges of both periods: the aliases found, the time, and whether one of the aliases has
          both periods within 3 sigma of the truth
fits      least squares that begin at the truth, with other errors: how often the truth is within 3 sigma of each
          unknown, and of both periods; this does not test the search
"""

from __future__ import annotations

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
TRUTH = np.array([250 * DEGREE, -75 * DEGREE, 152 * DEGREE, 14 * DEGREE, 27.38 * HOUR, 263 * HOUR, 0.61, 0.965])
NIGHTS = ((-12, 108, 40, 10), (2902, 3022, 25, 8))  # first and last day, nights, magnitudes in 5 hours of each
SIGMA = 0.02
RANGES = {"precession": (24 * HOUR, 32 * HOUR), "rotation": (150 * HOUR, 400 * HOUR)}


def apophis() -> TumblerFit:
    """The true motion, in the form of a fit."""
    import pandas as pd

    row = {"mode": "short-axis", "chi2": 0.0, **dict(zip(UNKNOWNS, TRUTH, strict=True))}
    return TumblerFit(pd.DataFrame([row]), np.zeros((1, 8, 8)), 0, 48 * DAY, None)


def observed(draw: np.random.Generator) -> xr.Dataset:
    nights = [(np.linspace(a, b, n), m) for a, b, n, m in NIGHTS]
    days = np.concatenate([(night[:, None] + draw.uniform(0, 5 / 24, (len(night), m))).ravel() for night, m in nights])
    t = np.sort(days) * DAY
    sun, truth = -APOPHIS.at(t)[0], apophis()
    observer = EARTH.at(t)[0] + sun
    states = kr.at(truth.body(), truth.state(), t - truth.epoch)
    magnitude = light_curve(states, sun=sun, observer=observer).magnitude.values + SIGMA * draw.normal(size=len(t))
    data = {"magnitude": ("time", magnitude), "sigma_magnitude": SIGMA}
    return xr.Dataset({**data, "sun": (("time", "xyz"), sun), "observer": (("time", "xyz"), observer)}, {"time": t})


def searched(seed: int, modes: list[str]) -> dict[str, Any]:
    data = observed(np.random.default_rng(seed))
    begin = time.perf_counter(), time.process_time()
    fit = fit_light_curve(data, modes=modes, **RANGES)
    seconds, processor = time.perf_counter() - begin[0], time.process_time() - begin[1]
    print(f"seed {seed}, {seconds:.0f} s, of the processor {processor:.0f} s\n{fit}", flush=True)
    names = UNKNOWNS[4:6]
    off = [abs(fit.table[n] - t) / fit.table[f"error_{n}"] for n, t in zip(names, TRUTH[4:6], strict=True)]
    near = np.maximum(*off)
    return {
        "seed": seed,
        "seconds": round(seconds),
        "processor_seconds": round(processor),
        "chi2": float(fit.table["chi2"].min()),
        "dof": fit.dof,
        "aliases": len(fit.table),
        "sigmas": float(near.min()),
        "alias of the truth": int(near.argmin()),
        "periods_hours": (fit.table[list(names)] / HOUR).round(4).to_numpy().tolist(),
        "chi2 of aliases": fit.table["chi2"].round(2).tolist(),
    }


def fitted(count: int, first: int) -> dict[str, Any]:
    """How often the truth is within 3 standard errors, of fits that begin there."""
    off, chi2 = np.empty((count, 8)), np.empty(count)
    for k in range(count):
        seen, epoch = _seen(observed(np.random.default_rng(first + k)), _light(None, "lommel-seeliger", None), None)
        seen = replace(seen, time=seen.time + epoch - 48 * DAY)
        x, chi2[[k]] = refined(seen, TRUTH[None], "short-axis")
        off[k] = abs(x[0] - TRUTH) / np.sqrt(np.diag(_inverse(seen.jacobian(x, "short-axis")[1][0])))
    inside = {name: int((off[:, i] < 3).sum()) for i, name in enumerate(UNKNOWNS)}
    both = int((off[:, 4:6] < 3).all(1).sum())
    print(f"fits from the truth: {inside}, both periods {both} of {count}, mean chi^2 {chi2.mean():.1f}", flush=True)
    return {"count": count, "within 3 sigma": inside, "both periods": both, "mean chi2": float(chi2.mean())}


def main() -> None:
    options = parser(__doc__, "tumbler")
    options.add_argument("--searches", type=int, default=4)
    options.add_argument("--first", type=int, default=0)
    options.add_argument("--modes", nargs="+", default=["short-axis", "long-axis"])
    options.add_argument("--fits", type=int, default=100)
    args = options.parse_args()
    fits = fitted(args.fits, 1000)
    searches = []
    for k in range(args.searches):
        searches.append(searched(args.first + k, args.modes))
        write({"machine": machine(), "fits": fits, "modes": args.modes, "searches": searches}, args.output)


if __name__ == "__main__":
    main()
