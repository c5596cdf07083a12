"""kr.analysis.fit_light_curve: the two periods of a tumbler from its brightness, with all aliases.

1. In the apparition with most observations, a grid of both frequencies, as fine as its length resolves; in each cell
   poles, phases and moments; the best starts are refined by least squares.
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

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.analysis.light import brightness, of_ellipsoid, phase_function, weights_of
from kreisel.analysis.tumbling import (
    ORDERS,
    PRECESSION,
    ROTATION,
    UNKNOWNS,
    Photometry,
    by_periods,
    energies,
    poles,
    possible,
    refined,
    turns,
)
from kreisel.errors import InputError, RunError, doubt, explained, shown
from kreisel.physical.free_body import FreeBody
from kreisel.physical.measures import finite_floats, si_number, si_numbers
from kreisel.physical.shapes import Facets

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

    from kreisel.record.model import State

GAP = 100 * 86_400.0  # s, between two apparitions
POINTS = 80  # of an apparition in the scan
CELLS = 20_000  # at most
POLES, PHASES = 16, 6  # directions of the momentum, phases of precession and of rotation of the scan
MOMENTS_A, PARTS_B = (0.35, 0.55, 0.75), (0.3, 0.8)  # I_a over the largest; I_b between its bounds
PER_CELL, FIRST, BEST = 2, 60, 12  # starts that are refined in a cell, by all observations, with mirrored poles
WORTH = 40.0  # chi^2 above the least, in units of chi^2 per degree of freedom, of solutions that are continued
MOST, ALL = 40, 1e6  # of them; chi^2 above the least of solutions whose neighbours are tried
SLACK = 5.0  # chi^2 by which further steps may lower a solution in a flat valley
SIGMAS, FINE = 3.5, 4  # of a lattice of cycles: its extent in errors, points to a cycle
ALIKE = 4.0  # chi^2 by which a solution differs from a second one
OFF = 4.0  # chi^2 per degree of freedom, beyond it the motion is a different one
BLOCK = 60_000  # observations times motions at a time


@dataclass(frozen=True, eq=False)
class TumblerFit:
    """Motions of a tumbler that fit its light; `fit_light_curve` returns it.

    table        one row for each alias, by chi^2: the mode, the unknowns and their standard errors error_NAME.  Periods
                 in s, angles in rad: the pole of the momentum, the azimuth of the axis that the momentum goes round
                 (from the meridian, where the latitude decreases), and the phase of the momentum in the body; moments
                 over the largest
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
        M, attitude, moments = by_periods(x, str(row["mode"]))
        quaternion = algebra.unit_quaternion((poles(x).mT @ attitude)[0])
        return self.body(alias).state(M[0] / moments[0], attitude=quaternion)

    def __repr__(self) -> str:
        best = self.table["chi2"].iloc[0]
        columns = ["mode", "chi2", *(c for n in UNKNOWNS[PRECESSION:6] for c in (n, f"error_{n}")), *UNKNOWNS[:2]]
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
                  from the body, in space.  Times are corrected for light time, magnitudes reduced to unit distances.
                  `apparition`, integers: each has an unknown constant; default: a new one after 100 days without light
    precession    (low, high), s: the mean period of the axis around the momentum, P_phi
    rotation      (low, high), s: the period of the momentum around the axis in the body, P_psi
    modes         "short-axis", "long-axis" or both
    shape         half axes (3,) or `Facets` along the principal axes, by increasing moment; default: the ellipsoid of
                  constant density with the fitted moments
    law, phase    as for `brightness`
    delta         aliases are solutions with chi^2 up to this above the least

    Raises `InputError` for bad input and ranges with too many cells, `RunError` if no motion is found.
    """
    seen, epoch = _seen(observations, _light(shape, law, phase), shape)
    bounds = [si_numbers(v, "s", name, ((2,),)) for v, name in ((precession, "precession"), (rotation, "rotation"))]
    delta = si_number(delta, "1", "delta", positive=True)
    if not all(0 < low < high for low, high in bounds):
        raise InputError(f"expected periods 0 < low < high, got {shown(precession)} and {shown(rotation)}.")
    modes = [modes] if isinstance(modes, str) else list(modes)
    if not modes or not set(modes) <= set(ORDERS):
        raise InputError(f"modes: expected some of {', '.join(ORDERS)}, got {shown(modes)}.")
    first = np.argmax(np.bincount(seen.apparition))
    half_turn = not isinstance(shape, Facets)  # of an ellipsoid in the body, which is not seen
    found = [_scanned(seen.some(seen.apparition == first), mode, bounds, half_turn) for mode in modes]
    now = seen.apparition == first
    for k in _by_distance(seen, first):
        found, now = _pruned(seen.some(now), found, half_turn), now | (seen.apparition == k)
        found = [_continued(seen, now, k, *each) for each in found if len(each[1])]
    found = _pruned(seen, found, half_turn, delta + SLACK)
    found = _pruned(seen, [(mode, *_in_blocks(seen, x, mode, 100)) for mode, x, _ in found], half_turn, delta)
    if not any(len(x) for _, x, _ in found):
        raise RunError("fit_light_curve: no motion was found. Widen the ranges of the periods, or see the sigmas.")
    return _as_fit(seen, found, epoch, shape)


def _light(shape: Any, law: Any, phase: Any) -> Any:
    """The flux (s, o, half axes).  Raises `InputError`."""
    if shape is not None:
        known = brightness(shape, law=law, phase=phase)
        return lambda s, o, axes: known(s, o)
    brightness((1, 1, 1), law=law, phase=phase)  # raises
    weights, of_phase = weights_of(law), phase_function(phase)
    return lambda s, o, axes: of_ellipsoid(axes, weights)(s, o) * of_phase(s, o)


def _seen(data: Any, light: Any, shape: Any) -> tuple[Photometry, float]:
    """The observations in the order of time, and their epoch.  Raises `InputError`."""
    names = ("time", "magnitude", "sigma_magnitude", "sun", "observer")
    missing = [n for n in names if n not in getattr(data, "variables", ())]
    if missing:
        raise InputError(f"observations: expected a Dataset with {', '.join(names)}, got none of {', '.join(missing)}.")
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
        apparition = np.unique(np.asarray(data["apparition"].values)[order], return_inverse=True)[1]
    else:
        apparition = np.append(0, np.cumsum(np.diff(time) > GAP))
    most = time[apparition == np.argmax(np.bincount(apparition))]
    epoch = float(most[0] + most[-1]) / 2
    ways = [(v / np.linalg.norm(v, axis=-1, keepdims=True))[order] for v in ways]
    axes = None if shape is None or isinstance(shape, Facets) else np.asarray(shape, dtype=np.float64)
    sun, observer = ways
    seen = Photometry(time - epoch, magnitude[order], sigma[order], sun, observer, apparition, light, axes)
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


def _moments(ratio: float, mode: str) -> Array:
    """Moments (k, 2) of bodies that can move with this ratio of the periods."""
    out = []
    for a in MOMENTS_A:
        b = np.linspace(max(a, 1 - a), 1, 66)[1:-1]
        I = np.stack([np.full_like(b, a), b, np.ones_like(b)], -1)  # noqa: E741
        period, rate = energies(I[:, ORDERS[mode]], np.full_like(b, 1e-6))[:2]
        b = b[possible(I[:, :2]) & (period * rate / (2 * np.pi) < ratio)]
        out += [(a, b[int(part * (len(b) - 1))]) for part in PARTS_B if len(b)]
    return np.array(sorted(set(out))).reshape(-1, 2)


def _directions(count: int) -> Array:
    """Longitudes and latitudes (count, 2), spread over the sphere."""
    k = np.arange(count) + 0.5
    return np.stack([np.pi * (1 + 5**0.5) * k % (2 * np.pi), np.arcsin(1 - 2 * k / count)], -1)


def _scanned(seen: Photometry, mode: str, bounds: Sequence[Array], half_turn: bool) -> tuple[str, Array, Array]:
    """The mode, solutions (k, 8) and chi^2 of one apparition."""
    few = seen.some(np.unique(np.linspace(0, len(seen.time) - 1, POINTS).astype(int)))
    phases = np.arange(PHASES) * 2 * np.pi / PHASES
    views = np.array([(*p, phi) for p in _directions(POLES) for phi in phases])
    to_views = poles(views)
    psi = phases / 2 if half_turn else np.append(phases, phases + np.pi / PHASES)
    motions = [
        (cell, (0, 0, 0, turn, *periods, *pair))
        for cell, periods in enumerate(_grid(bounds, np.ptp(seen.time)))
        for pair in _moments(periods[1] / periods[0], mode)
        for turn in psi
    ]
    if not motions:
        return mode, np.empty((0, 8)), np.empty(0)
    cells, x = (np.array(v) for v in zip(*motions, strict=True))
    chi2: Array = np.empty((len(x), len(views)))
    step = max(1, BLOCK // len(few.time))
    for i in range(0, len(x), step):
        M, attitude, moments = by_periods(x[i : i + step], mode)
        turned = turns(M, moments, few.time)
        for j, view in enumerate(to_views):
            chi2[i : i + step, j] = np.square(few.differences(turned, attitude.mT @ view, moments)).sum(0)
    chosen = _best_of_cells(cells, np.nan_to_num(chi2, nan=np.inf))
    starts = x[chosen[0]]
    starts[:, :3] = views[chosen[1]]
    starts, chi2 = _in_blocks(seen, _narrowed(few, starts, mode, FIRST), mode, 30)
    for relatives in (_mirrored, partial(_neighbours, span=float(np.ptp(seen.time))), _mirrored):
        more = _narrowed(few, relatives(starts[np.argsort(chi2)[:BEST]]), mode, FIRST)
        more, second = _in_blocks(seen, more, mode, 30)
        starts, chi2 = np.concatenate([starts, more]), np.append(chi2, second)
        _, starts, chi2 = _pruned(seen, [(mode, starts, chi2)], half_turn, ALL)[0]
    return mode, starts, chi2


def _narrowed(seen: Photometry, x: Array, mode: str, count: int) -> Array:
    """The best starts (count, 8) of x (k, 8), by some steps of least squares."""
    for iterations, part in ((3, 0.2), (8, 0.0)):
        x, chi2 = _in_blocks(seen, x, mode, iterations)
        x = x[np.argsort(chi2)[: max(count, int(part * len(chi2)))]]
    return x


def _neighbours(x: Array, span: float) -> Array:
    """Unknowns (k, 8) with frequencies some half cycles of the apparition away, and two sets of moments."""
    steps = np.arange(-2, 3) / (2 * span)
    changes = [c for c in product(steps, steps, (1.0, 1.15)) if any(c[:2])]
    out = np.tile(x, (len(changes), 1, 1))
    for new, (of_precession, of_rotation, part) in zip(out, changes, strict=True):
        new[:, PRECESSION] = 1 / abs(1 / new[:, PRECESSION] + of_precession)
        new[:, ROTATION] = 1 / abs(1 / new[:, ROTATION] + of_rotation)
        new[:, 7] = 1 - part * (1 - new[:, 7])
    return out.reshape(-1, len(UNKNOWNS))


def _mirrored(x: Array) -> Array:
    """Unknowns (k, 8) with the pole mirrored, where other minima of nearly the same light are, and other phases."""
    changes = list(product((0, np.pi), (1, -1), np.arange(4) * np.pi / 2, (1, -1)))
    out = np.tile(x, (len(changes), 1, 1))
    for new, (lon, lat, phi, psi) in zip(out, changes, strict=True):
        new[:, [0, 2]] += lon, phi
        new[:, [1, 3]] *= lat, psi
    return out.reshape(-1, len(UNKNOWNS))


def _best_of_cells(cells: Array, chi2: Array) -> tuple[Array, Array]:
    """The motions and views with the least chi^2 (motions, views) in each cell, one view of a motion."""
    view = chi2.argmin(1)
    least = chi2[np.arange(len(chi2)), view]
    order = np.lexsort((least, cells))
    rank = np.arange(len(order)) - np.searchsorted(cells[order], cells[order])
    motion = order[(rank < PER_CELL) & np.isfinite(least[order])]
    return motion, view[motion]


def _in_blocks(seen: Photometry, x: Array, mode: str, iterations: int) -> tuple[Array, Array]:
    step = max(1, BLOCK // len(seen.time))
    parts = [refined(seen, x[i : i + step], mode, iterations) for i in range(0, len(x), step)]
    if not parts:
        return x, np.empty(0)
    return np.concatenate([p[0] for p in parts]), np.concatenate([p[1] for p in parts])


# -- solutions, their aliases, further apparitions -------------------------------------------------


def _by_distance(seen: Photometry, first: Any) -> list[int]:
    """The other apparitions, the nearest in time first."""
    middle = {int(k): seen.time[seen.apparition == k].mean() for k in np.unique(seen.apparition)}
    return sorted((k for k in middle if k != first), key=lambda k: abs(middle[k] - middle[int(first)]))


def _pruned(
    seen: Photometry, found: Sequence[tuple[str, Array, Array]], half_turn: bool, delta: float | None = None
) -> list[tuple[str, Array, Array]]:
    """Different solutions with chi^2 close to the least of all modes, in its order."""
    least = min((chi2.min() for _, _, chi2 in found if len(chi2)), default=np.inf)
    above = delta if delta is not None else WORTH * max(1.0, least / len(seen.time))
    out = []
    for mode, x, chi2 in found:
        x, order = np.array([_usual(each) for each in x]).reshape(-1, len(UNKNOWNS)), np.argsort(chi2)
        order = order[chi2[order] <= least + above]
        kept, shapes = list[int](), list[Array]()
        for i in order:
            if len(kept) == (10 * MOST if delta else MOST):
                break
            if all(_apart(x[i] - x[k], A, half_turn) > ALIKE for k, A in zip(kept, shapes, strict=True)):
                kept.append(int(i))
                J = seen.jacobian(x[[i]], mode)[1][0]
                shapes.append(J.T @ J)
        out.append((mode, x[kept], chi2[kept]))
    return out


def _apart(d: Array, A: Array, half_turn: bool) -> float:
    """d A d, the angles of d in their least size."""
    d = d.copy()
    for i, period in ((0, 2 * np.pi), (2, 2 * np.pi), (3, np.pi if half_turn else 2 * np.pi)):
        d[i] -= period * np.round(d[i] / period)
    return float(d @ A @ d)


def _continued(seen: Photometry, now: Array, k: int, mode: str, x: Array, _: Array) -> tuple[str, Array, Array]:
    """Solutions of the observations `now`, apparition k among them, from solutions of the others."""
    before, after = seen.some(now & (seen.apparition != k)), seen.some(now)
    starts = [_lattice(before, each, mode, abs(seen.time[seen.apparition == k]).max()) for each in x]
    return mode, *_in_blocks(after, _narrowed(after, np.concatenate(starts), mode, 4 * MOST), mode, 30)


def _lattice(seen: Photometry, x: Array, mode: str, distance: float) -> Array:
    """Unknowns (k, 8) with frequencies within their errors, some to a cycle over a distance in time."""
    J = seen.jacobian(x[None], mode)[1][0]
    C = _inverse(J)
    frequencies = np.zeros((2, 8))
    frequencies[[0, 1], [PRECESSION, ROTATION]] = -1 / x[PRECESSION:6] ** 2
    mixed = C @ frequencies.T
    spread = frequencies @ mixed
    unit, sizes = 1 / (FINE * distance), np.sqrt(np.diag(spread))
    counts = np.minimum(np.ceil(SIGMAS * sizes / unit), 40).astype(int)
    lattice = np.stack(np.meshgrid(*(unit * np.arange(-n, n + 1) for n in counts), indexing="ij"), -1).reshape(-1, 2)
    inverse = np.linalg.inv(spread + np.eye(2) * unit**2)
    lattice = lattice[np.einsum("ki,ij,kj->k", lattice, inverse, lattice) <= SIGMAS**2]
    out = x + lattice @ np.linalg.solve(spread, mixed.T)
    out[:, PRECESSION:6] = 1 / (1 / x[PRECESSION:6] + lattice)
    return out


def _inverse(J: Array) -> Array:
    """(J^T J)^(-1), also of a singular J."""
    size = np.sqrt((J * J).sum(0)) + 1e-300
    return np.asarray(np.linalg.pinv((J / size).T @ (J / size), rcond=1e-13, hermitian=True) / np.outer(size, size))


def _as_fit(seen: Photometry, found: list[tuple[str, Array, Array]], epoch: float, shape: Any) -> TumblerFit:
    import pandas as pd

    rows, covariances = [], []
    for mode, xs, chi2 in found:
        for x, value in zip(xs, chi2, strict=True):
            C = _inverse(seen.jacobian(x[None], mode)[1][0])
            errors = {f"error_{n}": e for n, e in zip(UNKNOWNS, np.sqrt(np.diag(C)), strict=True)}
            rows.append({"mode": mode, "chi2": value, **dict(zip(UNKNOWNS, x, strict=True)), **errors})
            covariances.append(C)
    order = np.argsort([row["chi2"] for row in rows])
    table = pd.DataFrame([rows[i] for i in order])
    dof = len(seen.time) - len(UNKNOWNS) - len(np.unique(seen.apparition))
    if table["chi2"].iloc[0] > OFF * dof:
        doubt(
            f"fit_light_curve: expected a chi^2 of about {dof}, got {table['chi2'].iloc[0]:.4g}: no motion found fits. "
            "Widen the ranges of the periods, or see the sigmas, the shape, and the directions of Sun and observer."
        )
    return TumblerFit(table, np.array(covariances)[order], dof, epoch, shape)


def _usual(x: Array) -> Array:
    """The unknowns with a latitude from -pi/2 to pi/2, other angles from 0 to 2 pi."""
    x = x.copy()
    x[1] = (x[1] + np.pi) % (2 * np.pi) - np.pi
    if abs(x[1]) > np.pi / 2:
        x[:3] = x[0] + np.pi, np.sign(x[1]) * np.pi - x[1], x[2] + np.pi
    x[[0, 2, 3]] %= 2 * np.pi
    return x
