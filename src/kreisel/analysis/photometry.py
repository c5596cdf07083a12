"""kr.analysis.fit_light_curve: the two periods of a tumbler from its brightness, with all aliases.

1. In the apparition with most observations, a grid of both frequencies, as fine as its length resolves; in each cell
   moments, amplitudes and phases.  The square of the flux over the flux of a ball is about b.A^-2 b, b the bisector
   of the directions to Sun and observer along the axes of the body, so that the best attitude of the momentum follows
   from 26 linear unknowns; the best starts are refined by least squares.
2. Other apparitions, the nearest first: between them cycles may be miscounted, so that each solution continues as a
   lattice of solutions, all within its errors, that are refined by the observations so far.
3. Solutions with chi^2 up to the least plus delta are the aliases.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
import xarray as xr

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.analysis import tumbling
from kreisel.analysis.light import brightness, of_ellipsoid, of_facets, phase_function, weights_of
from kreisel.analysis.tumbling import AMPLITUDE, MOMENT, ORDERS, PHASE, PRECESSION, ROTATION, STEP, UNKNOWNS
from kreisel.errors import InputError, RunError, doubt, explained, shown
from kreisel.physical.free_body import FreeBody
from kreisel.physical.measures import finite_floats, si_number, si_numbers
from kreisel.physical.shapes import Facets
from kreisel.record.units import stated_unit

if TYPE_CHECKING:
    from kreisel.record.model import State

GAP = 100 * 86_400.0  # s, between two apparitions
POINTS = 64  # of an apparition in the scan
CELLS = 20_000  # at most
POLES, PHASES, TURNS = 32, 8, 4  # directions of the momentum, phases of precession and of rotation of the scan
AMPLITUDES, PARTS = (0.2, 0.55, 0.85), (0.3, 0.7)  # and places of the moment among the possible ones
MOTIONS, STARTS = 3, 300  # of a cell whose poles are tried; starts of all cells
PER_CELL, FIRST, BEST = 2, 40, 8  # starts of a cell; minima of some observations, and those whose relatives are tried
WORTH = 40.0  # chi^2 above the least, in units of chi^2 per degree of freedom, of solutions that are continued
MOST, ALL = 40, 1e6  # of them; chi^2 above the least of solutions whose neighbours are tried
SLACK = 5.0  # chi^2 by which further steps may lower a solution in a flat valley
SIGMAS, FINE = 3.5, 4  # of a lattice of cycles: its extent in errors, points to a cycle
ALIKE = 4.0  # chi^2 by which a solution differs from a second one
OFF = 4.0  # chi^2 per degree of freedom, beyond it the motion is a different one; below 1/OFF^2 the sigmas are wrong
BLOCK = 30_000  # observations times motions at a time
Photometry = tumbling.Photometry
Motions = tuple[str, Array, Array]  # the mode, unknowns (k, 8), and chi^2


@dataclass(frozen=True, eq=False)
class TumblerFit:
    """Motions of a tumbler that fit its light; `fit_light_curve` returns it.

    table        one row for each alias, by chi^2: the mode, the unknowns and their standard errors error_NAME.  Periods
                 in s, angles in rad: the pole of the momentum, the azimuth of the axis that the momentum goes round
                 (from the meridian, where the latitude decreases), and the phase of the momentum in the body; moments
                 over the largest, where instead of moment_b the amplitude, from 0 to 1, is the unknown: it grows
                 linearly with a small tilt of the axis
    covariance   of the unknowns, (aliases, 8, 8)
    dof          count of observations minus unknowns and constants
    epoch        the time of the phases, s
    shape        half axes, `Facets`, or None: an ellipsoid of constant density
    """

    table: pd.DataFrame
    covariance: Array
    dof: int
    epoch: float
    shape: Any

    def body(self, alias: int = 0) -> FreeBody:
        """The body of an alias, with the largest moment 1 kg m^2."""
        row = self.table.iloc[alias]
        I = np.array([row["moment_a"], row["moment_b"], 1.0])  # noqa: E741
        squares = I.sum() - 2 * I if self.shape is None else np.square(self.shape)
        body = FreeBody(I, time_unit=row["precession_period"] / (2 * np.pi))
        return body if isinstance(self.shape, Facets) else body.shaped("ellipsoid", np.sqrt(squares / squares.max()))

    def state(self, alias: int = 0) -> State:
        """The state of `body(alias)` at the epoch, with its attitude."""
        row = self.table.iloc[alias]
        x = row[list(UNKNOWNS)].to_numpy(np.float64)[None]
        M, attitude, moments = tumbling.by_periods(x, str(row["mode"]))
        quaternion = algebra.unit_quaternion((tumbling.poles(x).mT @ attitude)[0])
        return self.body(alias).state(M[0] / moments[0], attitude=quaternion)

    def __repr__(self) -> str:
        best = self.table["chi2"].iloc[0]
        periods = [c for n in UNKNOWNS[PRECESSION : ROTATION + 1] for c in (n, f"error_{n}")]
        columns = ["mode", "chi2", *periods, *UNKNOWNS[:2]]
        return (
            f"Fit of a tumbler: {len(self.table)} aliases, least chi^2 = {best:.6g} for {self.dof} degrees of freedom\n"
            f"{self.table[columns].to_string(float_format='{:.7g}'.format)}"
        )


@explained
def fit_light_curve(
    observations: xr.Dataset,
    *,
    precession: Any,
    rotation: Any,
    modes: Sequence[str] = tuple(ORDERS),
    shape: Any = None,
    law: Any = "lommel-seeliger",
    phase: Any = None,
    delta: float = 9.0,
) -> TumblerFit:
    """The motions of a free body, within ranges of its two periods, whose light fits observed magnitudes.

    observations  a Dataset with `time` (s), `magnitude`, `sigma_magnitude`, and `sun`, `observer` (time, xyz): vectors
                  from the body, in space.  Times are of a uniform scale, TDB or TT, in any order, corrected for light
                  time; magnitudes are reduced to unit distances.
                  `apparition`, integers: each has an unknown constant; default: a new one after 100 days without light
    precession    (low, high), s: the mean period of the axis around the momentum, P_phi; solutions are in the ranges
    rotation      (low, high), s: the period of the momentum around the axis in the body, P_psi
    modes         "short-axis", "long-axis" or both
    shape         half axes (3,) or `Facets` along the principal axes, by increasing moment; default: the ellipsoid of
                  constant density with the fitted moments
    law, phase    as for `brightness`
    delta         aliases are solutions with chi^2 up to this above the least

    Raises `InputError` for bad input and ranges with too many cells, `RunError` if no motion is found.
    """
    if shape is not None and not isinstance(shape, Facets):
        shape = si_numbers(shape, "m", "shape", ((3,),))
    seen, epoch = _seen(observations, shape, *_light(shape, law, phase))
    bounds = [si_numbers(v, "s", name, ((2,),)) for v, name in ((precession, "precession"), (rotation, "rotation"))]
    delta = si_number(delta, "1", "delta", positive=True)
    if not all(0 < low < high for low, high in bounds):
        raise InputError(f"expected periods 0 < low < high, got {shown(precession)} and {shown(rotation)}.")
    first = np.argmax(np.bincount(seen.apparition))
    span = float(np.ptp(seen.time[seen.apparition == first]))
    if span < bounds[0][0]:
        raise InputError(
            f"time: expected observations over a period of the precession or more, {bounds[0][0]:g} s, got {span:g} s "
            "in the apparition with most of them. Usual cause: days for seconds."
        )
    modes = [modes] if isinstance(modes, str) else list(modes)
    if not modes or not set(modes) <= set(ORDERS):
        raise InputError(f"modes: expected some of {', '.join(ORDERS)}, got {shown(modes)}.")
    half_turn = not isinstance(shape, Facets)  # of an ellipsoid in the body, which is not seen
    motions = [_scanned(seen.some(seen.apparition == first), mode, bounds, half_turn) for mode in modes]
    now = seen.apparition == first
    middle = {int(k): seen.time[seen.apparition == k].mean() for k in np.unique(seen.apparition)}
    for k in sorted(middle.keys() - {int(first)}, key=lambda k: abs(middle[k] - middle[int(first)])):  # by distance
        motions, now = _pruned(seen.some(now), motions, half_turn), now | (seen.apparition == k)
        motions = [_continued(seen, now, k, half_turn, *motion) for motion in motions if len(motion[1])]
    motions = _pruned(seen, motions, half_turn, delta + SLACK, 10 * MOST)
    motions = [(mode, *_in_blocks(seen, x, mode, 100)) for mode, x, _ in motions]
    motions = _pruned(seen, motions, half_turn, delta, 10 * MOST)
    if not any(len(x) for _, x, _ in motions):
        raise RunError("fit_light_curve: no motion was found. Widen the ranges of the periods, or see the sigmas.")
    return _as_fit(seen, motions, epoch, shape)


def _light(shape: Any, law: Any, phase: Any) -> tuple[Any, Any]:
    """The flux and its slopes, of (s, o, half axes); about the flux of a ball, of (s, o).  Raises `InputError`."""
    brightness((1, 1, 1) if shape is None else shape, law=law, phase=phase)  # raises
    weights, of_phase = weights_of(law), phase_function(phase)
    facets = of_facets(shape, weights) if isinstance(shape, Facets) else None

    def light(s: Array, o: Array, axes: Array) -> tuple[Array, Any]:
        flux, slopes = (facets or of_ellipsoid(axes, weights))(s, o)
        factor = of_phase(s, o)
        return flux * factor, lambda: tuple(np.asarray(factor)[..., None] * v for v in slopes())

    ball = of_ellipsoid(np.ones(3), {"lommel-seeliger": 1.0})
    return light, lambda s, o: ball(s, o)[0] * of_phase(s, o)


def _seen(data: Any, shape: Any, light: Any, ball: Any) -> tuple[Photometry, float]:
    """The observations in the order of time, and their epoch.  Raises `InputError`."""
    names = ("time", "magnitude", "sigma_magnitude", "sun", "observer")
    missing = [n for n in names if n not in getattr(data, "variables", ())]
    if missing:
        raise InputError(f"observations: expected a Dataset with {', '.join(names)}, got none of {', '.join(missing)}.")
    unit = data["time"].attrs.get("units", "s")
    if data["time"].dtype.kind in "mM" or unit != "s":
        raise InputError(
            f"time: expected seconds of a uniform scale, TDB or TT, got {unit if unit != 's' else 'dates'}. From "
            "Julian days: (jd - jd[0]) * 86400. UTC has leap seconds: TT - UTC is 69.184 s since 2017, 67.184 in 2013."
        )
    for name in names[1:3]:
        if (unit := stated_unit(data[name])) not in ("", "mag"):
            raise InputError(f"{name}: expected mag, got {unit}. Convert it and its attribute units.")
    lost = int(np.count_nonzero(~np.isfinite(np.asarray(data["magnitude"].values, dtype=np.float64))))
    if lost:
        raise InputError(
            f"magnitude: expected finite values, got {lost} others. Usual cause: the logarithm of a flux that is not "
            "positive, or gaps. Drop these rows: observations.isel(time=np.isfinite(observations.magnitude.values))."
        )
    time, magnitude, sigma, *ways = (finite_floats(data[n].values, "1", n) for n in names)
    if time.ndim != 1 or magnitude.shape != time.shape or any(v.shape != (len(time), 3) for v in ways):
        raise InputError(
            f"observations: expected magnitude (time,) and sun, observer (time, 3), got the shapes "
            f"{', '.join(str(v.shape) for v in (time, magnitude, *ways))}."
        )
    sigma = np.broadcast_to(sigma, time.shape)
    if len(time) < 4 * len(UNKNOWNS) or sigma.min() <= 0 or not all((v * v).sum(-1).all() for v in ways):
        raise InputError(
            f"observations: expected at least {4 * len(UNKNOWNS)}, with errors > 0 and directions that are not 0, got "
            f"{len(time)}, errors from {sigma.min():g}."
        )
    order = np.argsort(time, kind="stable")
    time = time[order]
    if "apparition" in data.variables:
        apparition = np.unique(np.broadcast_to(data["apparition"], time.shape)[order], return_inverse=True)[1]
    else:
        apparition = np.append(0, np.cumsum(np.diff(time) > GAP))
    most = time[apparition == np.argmax(np.bincount(apparition))]
    epoch = float(most[0] + most[-1]) / 2
    ways = [(v / np.linalg.norm(v, axis=-1, keepdims=True))[order] for v in ways]
    axes = None if isinstance(shape, Facets) else shape
    sun, observer = ways
    flux = ball(sun, observer)
    seen = Photometry(time - epoch, magnitude[order], sigma[order], sun, observer, apparition, flux, light, axes)
    return seen, epoch


# -- the scan of one apparition --------------------------------------------------------------------


def _grid(bounds: Sequence[Array], span: float) -> Array:
    """Periods (cells, 2), by frequencies 1/(2 span) apart.  Raises `InputError` for too many."""
    counts = [max(2, int(np.ceil((1 / low - 1 / high) * 2 * span)) + 1) for low, high in bounds]
    if counts[0] * counts[1] > CELLS:
        raise InputError(
            f"expected ranges of the periods with at most {CELLS:,} cells, got {counts[0]:,} times {counts[1]:,}: one "
            f"for each 1/(2 {span:g} s) of a frequency. Narrow the ranges."
        )
    axes = [1 / np.linspace(1 / high, 1 / low, n) for n, (low, high) in zip(counts, bounds, strict=True)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 2)


def _scanned(seen: Photometry, mode: str, bounds: Sequence[Array], half_turn: bool) -> tuple[str, Array, Array]:
    """The mode, solutions (k, 8) and chi^2 of one apparition."""
    few = seen.some(np.unique(np.linspace(0, len(seen.time) - 1, POINTS).astype(int)))
    starts, chi2, candidates = np.empty((0, len(UNKNOWNS))), np.empty(0), _starts(few, mode, bounds, half_turn)
    cell, ends = 1 / (2 * np.ptp(seen.time)), 1 / np.array(bounds)
    for relatives in (_mirrored, partial(_neighbours, span=float(np.ptp(seen.time))), _mirrored, None):
        candidates, second = _minima((few, seen), candidates, mode, half_turn)
        rates = 1 / candidates[:, PRECESSION : ROTATION + 1]
        inside = ((rates > ends[:, 1] - cell) & (rates < ends[:, 0] + cell)).all(-1)
        motions = [(mode, np.concatenate([starts, candidates[inside]]), np.append(chi2, second[inside]))]
        _, starts, chi2 = _pruned(seen, motions, half_turn, ALL)[0]
        candidates = starts if relatives is None else relatives(starts[np.argsort(chi2)[:BEST]])
    return mode, starts, chi2


def _starts(seen: Photometry, mode: str, bounds: Sequence[Array], half_turn: bool) -> Array:
    """Unknowns (k, 8) whose light is near, of the cells of a grid."""
    periods, turns = _grid(bounds, np.ptp(seen.time)), np.arange(TURNS) * (np.pi if half_turn else 2 * np.pi) / TURNS
    ratio, every = (periods[:, 1] / periods[:, 0])[:, None, None], np.linspace(0.05, 0.95, 37)
    bodies = np.isfinite(tumbling.moments_of(every, np.array(AMPLITUDES)[:, None], ratio, mode)[..., 1])
    places = np.multiply.outer(bodies.sum(-1) - 1, PARTS).astype(int) + bodies.argmax(-1)[..., None]
    shape = (*places.shape, TURNS)
    cells, amplitudes, parts, phases = np.nonzero(np.broadcast_to(bodies.any(-1)[..., None, None], shape))
    x = np.zeros((len(cells), len(UNKNOWNS)))
    x[:, MOMENT], x[:, AMPLITUDE] = every[places[cells, amplitudes, parts]], np.take(AMPLITUDES, amplitudes)
    x[:, PHASE], x[:, PRECESSION : ROTATION + 1] = turns[phases], periods[cells]

    scan, step = tumbling.Scan(seen, mode), max(1, BLOCK // len(seen.time))
    chi2 = np.concatenate([np.empty(0), *(scan.least(x[i : i + step]) for i in range(0, len(x), step))])
    best = _best_of_cells(cells, chi2, MOTIONS)
    x, cells = x[best], cells[best]
    k = np.arange(POLES) + 0.5  # poles spread over the sphere
    directions = zip(np.pi * (1 + 5**0.5) * k % (2 * np.pi), np.arcsin(1 - 2 * k / POLES), strict=True)
    views = np.array([(*p, phi) for p in directions for phi in np.arange(PHASES) * 2 * np.pi / PHASES])
    pairs = [scan.by_views(x[i : i + step], views) for i in range(0, len(x), step)]
    chi2, chosen = (np.concatenate(v) for v in zip((np.empty(0), np.empty(0, int)), *pairs, strict=True))
    x[:, :3] = views[chosen]
    best = _best_of_cells(cells, chi2, PER_CELL)
    return x[best[np.argsort(chi2[best])[:STARTS]]]


def _minima(data: Sequence[Photometry], x: Array, mode: str, half_turn: bool, most: int = FIRST) -> tuple[Array, Array]:
    """The best minima of all observations next to starts x (k, 8), which some of them select, and chi^2."""
    few, seen = data
    for iterations in (3, 8):
        x, chi2 = _in_blocks(few, x, mode, iterations)
        best = np.argsort(chi2)[: max(most, len(chi2) // 5)]
        x, chi2 = x[best], chi2[best]
    _, x, _ = _pruned(few, [(mode, x, chi2)], half_turn, ALL, most)[0]
    x, chi2 = _in_blocks(seen, x, mode, 6)
    close = chi2 <= chi2.min(initial=np.inf) + _worth(seen, chi2)
    x[close], chi2[close] = _in_blocks(seen, x[close], mode, 24)
    return x, chi2


def _neighbours(x: Array, span: float) -> Array:
    """Unknowns (k, 8) with frequencies some half cycles of the apparition away, and two amplitudes."""
    steps, periods = np.arange(-2, 3) / (2 * span), slice(PRECESSION, ROTATION + 1)
    changes = np.array([c for c in product(steps, steps, (1.0, 0.8)) if any(c[:2])])[:, None]
    out = np.tile(x, (len(changes), 1, 1))
    out[..., periods] = 1 / abs(1 / out[..., periods] + changes[..., :2])
    out[..., AMPLITUDE] *= changes[..., 2]
    return out.reshape(-1, len(UNKNOWNS))


def _mirrored(x: Array) -> Array:
    """Unknowns (k, 8) with the pole mirrored, where other minima of nearly the same light are, and other phases."""
    changes = np.array(list(product((0, np.pi), (1, -1), np.arange(4) * np.pi / 2, (1, -1))))[:, None]
    out = np.tile(x, (len(changes), 1, 1))
    out[..., [0, 2]] += changes[..., [0, 2]]
    out[..., [1, 3]] *= changes[..., [1, 3]]
    return out.reshape(-1, len(UNKNOWNS))


def _best_of_cells(cells: Array, chi2: Array, count: int) -> Array:
    order = np.lexsort((chi2, cells))
    rank = np.arange(len(order)) - np.searchsorted(cells[order], cells[order])
    return np.asarray(order[(rank < count) & np.isfinite(chi2[order])])


def _in_blocks(seen: Photometry, x: Array, mode: str, iterations: int) -> tuple[Array, Array]:
    step = max(1, BLOCK // len(seen.time))
    parts = [tumbling.refined(seen, x[i : i + step], mode, iterations) for i in range(0, len(x), step)]
    return np.concatenate([x[:0], *(p[0] for p in parts)]), np.concatenate([np.empty(0), *(p[1] for p in parts)])


# -- solutions, their aliases, further apparitions -------------------------------------------------


def _pruned(
    seen: Photometry, motions: Sequence[Motions], half_turn: bool, delta: float | None = None, most: int = MOST
) -> list[Motions]:
    """Different solutions with chi^2 close to the least of all modes, in its order."""
    every = np.concatenate([chi2 for _, _, chi2 in motions])
    least, above = every.min(initial=np.inf), _worth(seen, every) if delta is None else delta
    out = []
    for mode, x, chi2 in motions:
        order = np.argsort(chi2)[: np.count_nonzero(chi2 <= least + above)]
        x, chi2 = np.array([_usual(solution) for solution in x[order]]).reshape(-1, len(UNKNOWNS)), chi2[order]
        kept, step = np.ones(len(x), bool), max(1, BLOCK // len(seen.time))
        for i in range(0, len(x), step):
            J = seen.jacobian(x[i : i + step], mode)[1]
            for k, A in enumerate(J.mT @ J, i):
                if kept[k] and kept[:k].sum() < most:
                    kept[k + 1 :] &= _apart(x[k + 1 :] - x[k], A, half_turn) > ALIKE
        kept &= np.cumsum(kept) <= most
        out.append((mode, x[kept], chi2[kept]))
    return out


def _worth(seen: Photometry, chi2: Array) -> float:
    """The chi^2 above the least of solutions that are continued."""
    return WORTH * float(max(1.0, chi2.min(initial=np.inf) / len(seen.time)))


def _apart(d: Array, A: Array, half_turn: bool) -> Array:
    """d A d of differences d (k, 8), the angles in their least size."""
    d = d.copy()
    for i, period in ((0, 2 * np.pi), (2, 2 * np.pi), (PHASE, np.pi if half_turn else 2 * np.pi)):
        d[:, i] -= period * np.round(d[:, i] / period)
    return np.asarray(((d @ A) * d).sum(-1))


def _continued(seen: Photometry, now: Array, k: int, half_turn: bool, mode: str, x: Array, _: Array) -> Motions:
    """Solutions of the observations `now`, apparition k among them, from solutions of the others.

    They begin at frequencies within the errors of these solutions, some to a cycle over the distance in time.
    """
    before, after = seen.some(now & (seen.apparition != k)), seen.some(now)
    unit, starts = 1 / (FINE * abs(seen.time[seen.apparition == k]).max()), []
    for start, J in zip(x, before.jacobian(x, mode)[1], strict=True):
        frequencies = np.zeros((2, 8))
        frequencies[[0, 1], [PRECESSION, ROTATION]] = -1 / start[PRECESSION : ROTATION + 1] ** 2
        mixed = _inverse(J) @ frequencies.T
        spread = frequencies @ mixed
        counts = np.minimum(np.ceil(SIGMAS * np.sqrt(np.diag(spread)) / unit), 40).astype(int)
        axes = (unit * np.arange(-n, n + 1) for n in counts)
        lattice = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 2)
        inverse = np.linalg.inv(spread + np.eye(2) * unit**2)
        lattice = lattice[np.einsum("ki,ij,kj->k", lattice, inverse, lattice) <= SIGMAS**2]
        starts.append(start + lattice @ np.linalg.solve(spread, mixed.T))
        starts[-1][:, PRECESSION : ROTATION + 1] = 1 / (1 / start[PRECESSION : ROTATION + 1] + lattice)
    return mode, *_minima((after, after), np.concatenate(starts), mode, half_turn, 4 * MOST)


def _inverse(J: Array) -> Array:
    """(J^T J)^(-1), also of a singular J."""
    size = np.sqrt((J * J).sum(0)) + 1e-150
    return np.asarray(np.linalg.pinv((J / size).T @ (J / size), rcond=1e-13, hermitian=True) / np.outer(size, size))


def _as_fit(seen: Photometry, motions: list[tuple[str, Array, Array]], epoch: float, shape: Any) -> TumblerFit:
    rows, covariances = [], []
    for mode, xs, chi2 in motions:
        for x, value in zip(xs, chi2, strict=True):
            C = _inverse(seen.jacobian(x[None], mode)[1][0])
            errors = {f"error_{n}": e for n, e in zip(UNKNOWNS, np.sqrt(np.diag(C)), strict=True)}
            near = np.tile(x, (9, 1))  # for derivatives of I_b over the largest moment, by differences
            near[1:][np.diag_indices(8)] += STEP * x
            ratio = near[:, ROTATION] / near[:, PRECESSION]
            b, *changed = tumbling.moments_of(near[:, MOMENT], near[:, AMPLITUDE], ratio, mode)[:, 1]
            slope = np.nan_to_num((np.array(changed) - b) / np.where(x, STEP * x, 1.0))
            errors["error_moment_b"] = float(np.sqrt(slope @ C @ slope))
            unknowns = dict(zip(UNKNOWNS, x, strict=True))
            rows.append({"mode": mode, "chi2": value, **unknowns, "moment_b": float(b), **errors})
            covariances.append(C)
    order = np.argsort([row["chi2"] for row in rows])
    table = pd.DataFrame([rows[i] for i in order])
    dof = len(seen.time) - len(UNKNOWNS) - len(np.unique(seen.apparition))
    ratio = table["chi2"].iloc[0] / dof
    if not 1 / OFF**2 < ratio < OFF:
        cause = "sigma_magnitude is too large. Usual cause: mmag, or the errors of a flux."
        if ratio > 1:
            cause = "no motion found fits. Widen the ranges of the periods, or see the sigmas, the shape, and the "
            cause += "directions of Sun and observer."
        doubt(f"fit_light_curve: expected a chi^2 of about {dof}, got {ratio * dof:.4g}: {cause}")
    return TumblerFit(table, np.array(covariances)[order], dof, epoch, shape)


def _usual(x: Array) -> Array:
    """The unknowns with a latitude from -pi/2 to pi/2, other angles from 0 to 2 pi."""
    x = x.copy()
    x[1] = (x[1] + np.pi) % (2 * np.pi) - np.pi
    if abs(x[1]) > np.pi / 2:
        x[:3] = x[0] + np.pi, np.sign(x[1]) * np.pi - x[1], x[2] + np.pi
    x[[0, 2, 3]] %= 2 * np.pi
    return x
