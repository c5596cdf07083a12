"""kr.analysis.frequencies: the lines of a quasi-periodic motion, far beyond the resolution of a Fourier transform.

Laskar's numerical analysis of fundamental frequencies: a line is a maximum of the windowed Fourier integral
(`kreisel.runs.harmonics`).  Then all amplitudes are fitted together, and each line is sought again in the remainder of
the others, until the frequencies no longer change.

kr.analysis.megno: regular or chaotic, from a neighbouring motion that is rescaled to the first.

    Y(t) = (2/t) int_0^t (d'/d) s ds,   d the distance of two neighbouring motions

Its mean over time goes to 2 for quasiperiodic motions, whose neighbours separate like t, to 0 for stable periodic
motions, and grows like lambda t/2 for chaotic motions, lambda Lyapunov's exponent.
[P. M. Cincotta, C. Simo, Astron. Astrophys. Suppl. 147 (2000) 205]
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
import xarray as xr

from kreisel import algebra
from kreisel.algebra import Array, dot, unit
from kreisel.analysis.quantities import Quantity, label, series
from kreisel.errors import InputError, explained
from kreisel.method.scheme import ORIENTATION
from kreisel.record.body import Body, as_body
from kreisel.record.model import Model
from kreisel.record.perturbation import TIME
from kreisel.record.units import BodyFrame
from kreisel.runs import harmonics
from kreisel.runs.in_si import scaled
from kreisel.runs.propagation.propagator import propagator
from kreisel.runs.run_record import a_run
from kreisel.runs.settings import check_model, checked_state, initial_orientation, within

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from kreisel.record.model import OrientationLike, StateLike


FEWEST = 16  # samples
SWEEPS = 40


@explained
@dataclass(frozen=True)
class Lines:
    """f(t) = sum of amplitude_j exp(i frequency_j t) + remainder, the largest |amplitude| first.

    frequency   (lines,) angular, in radians and the run's unit of time; >= 0 for a real signal
    amplitude   (lines,) complex, for t counted from time 0; for a real signal f = sum of
                Re(amplitude_j exp(i omega_j t))
    remainder        root mean square of the signal minus the lines
    change      largest |change| of a frequency in the last sweep, a measure of how constant they are
    """

    frequency: Array
    amplitude: Array
    remainder: float
    change: float
    time: Array
    values: Array
    quantity: str

    @property
    def table(self) -> pd.DataFrame:
        """frequency, amplitude and phase of each line."""
        amplitude = {"amplitude": np.abs(self.amplitude), "phase": np.angle(self.amplitude)}
        return pd.DataFrame({"frequency": self.frequency, **amplitude})

    def plot(self, theme: str = "light") -> Figure:
        """The power spectrum with the lines on it."""
        from kreisel.viewer.charts import plot_lines

        return plot_lines(self, theme=theme)


@explained
def frequencies(run: xr.Dataset, quantity: Quantity, lines: int = 8, *, power: int = 3) -> Lines:
    """The strongest lines of a quantity, real or complex, of one trajectory.

    quantity   "a[0]", "energy", or a function of the stored components, `lambda m, a: a[..., 0] + 1j * a[..., 1]`
    lines      maximal count; fewer are returned if the remainder is round-off
    power      of the window of Hann: higher powers leak less and need lines farther apart, (power + 1) 2 pi/T

    Measured on sums of lines: 1e-11 relative or better if they are ten widths 2 pi/T apart.  The frequencies are
    frequencies of the saved states; for a map, of its interpolating flow.  Beyond pi/(dt every) they are folded.
    Raises `InputError` for ensembles, for rows not evenly spaced and for fewer than 16.
    """
    if "lane" in a_run(run).dims:
        raise InputError("frequencies needs one trajectory: choose a lane, run.isel(lane=0).")
    return lines_of(np.asarray(run["time"].values), series(run, quantity), lines, power=power, quantity=label(quantity))


def lines_of(time: Array, values: Array, lines: int = 8, *, power: int = 3, quantity: str = "f") -> Lines:
    """The strongest lines of evenly spaced samples `values` (time,) at `time`."""
    time, values = _even(time, values)
    within(power, "power", 0, 8)
    centre = (time[0] + time[-1]) / 2
    finder, floor = _Finder(time - centre, values, power), 4 * np.finfo(float).eps * _root_mean_square(values)
    omegas: list[float] = []
    change, amplitude, remainder = 0.0, np.zeros(0, dtype=complex), values
    for _ in range(within(lines, "lines")):
        if _root_mean_square(remainder) <= floor:
            break
        new = finder.strongest(remainder)
        if min((abs(new - old) for old in omegas), default=np.inf) < finder.width:
            break  # the remainder of a line that exists
        omegas, change = finder.settled([*omegas, new])
        amplitude = finder.fit(omegas)
        remainder = values - finder.model(omegas, amplitude)
    omega = np.array(omegas)
    amplitude = amplitude * np.exp(-1j * omega * centre)
    order = np.argsort(-np.abs(amplitude), kind="stable")
    return Lines(omega[order], amplitude[order], _root_mean_square(remainder), change, time, values, quantity)


def _root_mean_square(values: Array) -> float:
    return float(np.sqrt((np.abs(values) ** 2).mean()))


def _even(time: Array, values: Array) -> tuple[Array, Array]:
    time, values = np.asarray(time, dtype=float), np.asarray(values)
    if time.ndim != 1 or values.shape != time.shape or len(time) < FEWEST:
        raise InputError(
            f"At least {FEWEST} samples of one number were expected, got shapes {time.shape}, {values.shape}."
        )
    gaps = np.diff(time)
    if len(gaps) > 1 and gaps[-1] < gaps[0] * (1 - 1e-6):
        time, values, gaps = time[:-1], values[:-1], gaps[:-1]  # the last row of a run may be closer
    with np.errstate(all="ignore"):
        finite = np.isfinite((np.abs(values) ** 2).sum())
    if gaps.min() < gaps.max() * (1 - 1e-6) or gaps.min() <= 0 or not finite:
        raise InputError(
            "expected values with finite squares at evenly spaced, rising times, as of kr.simulate, got others. Usual "
            "cause: rows chosen by isel or sel, or kr.at at other times; give it np.arange(count) * step."
        )
    return time, values.astype(complex if values.dtype.kind == "c" else float)


class _Finder:
    """Peaks of the windowed transform of a signal at times t, |t| <= T/2, centred."""

    def __init__(self, t: Array, signal: Array, power: int):
        self.t, self.signal, self.width = t, signal, 2 * np.pi / (t[-1] - t[0])
        self.window, self.real = harmonics.window(t, power), signal.dtype.kind != "c"

    def strongest(self, f: Array) -> float:
        return float(harmonics.strongest(self.t, (self.window * f)[:, None])[0])

    def fit(self, omegas: list[float]) -> Array:
        """The amplitudes of least squares under the window."""
        root, waves = np.sqrt(self.window)[:, None], np.exp(1j * np.outer(self.t, omegas))
        columns = np.concatenate([waves.real, -waves.imag], 1) if self.real else waves
        amplitude = np.linalg.lstsq(root * columns, root[:, 0] * self.signal, rcond=None)[0]
        return amplitude[: len(omegas)] + 1j * amplitude[len(omegas) :] if self.real else amplitude

    def model(self, omegas: list[float], amplitude: Array) -> Array:
        total = np.exp(1j * np.outer(self.t, omegas)) @ amplitude  # 0 without lines
        return total.real if self.real else total

    def settled(self, omegas: list[float]) -> tuple[list[float], float]:
        """Each line sought again in the remainder of the others, until none changes any more."""
        change, small = np.inf, 4 * np.finfo(float).eps * max(map(abs, omegas))
        for _ in range(SWEEPS):
            before, last = list(omegas), change
            for j, omega in enumerate(before):
                amplitude = self.fit(omegas)
                others = [k for k in range(len(omegas)) if k != j]
                line = self.signal - self.model([omegas[k] for k in others], amplitude[others])
                if self.real and abs(omega) >= 0.5 * self.width:  # its half at -omega leaks into the peak at omega
                    line = line - np.conj(amplitude[j]) / 2 * np.exp(-1j * omega * self.t)
                omegas[j] = float(harmonics.peaks(self.t, (self.window * line)[:, None], [omega])[0])
            change = max(abs(a - b) for a, b in zip(omegas, before, strict=True))
            if change <= small or last <= change < 1e-9 * self.width:  # only rounding moves them
                break
        return omegas, change


@explained
def power_spectrum(run: xr.Dataset, quantity: Quantity) -> xr.Dataset:
    """The power spectral density of a quantity against the angular frequency, with the window of Hann.

    By `scipy.signal.periodogram`, as a density over the angular frequency: its integral is the mean square of the
    quantity about its mean.  A real quantity has its power at frequencies >= 0.  Returns a Dataset with `power` along
    `frequency`, and lane for ensembles.  Raises `InputError` as `frequencies` does.
    """
    from scipy.signal import periodogram

    values, time = series(a_run(run), quantity), np.asarray(run["time"].values)
    flat = values.reshape(len(values), -1)
    power: list[Array] = []
    for column in flat.T:
        even, signal = _even(time, column)
        rate = 2 * np.pi / (even[1] - even[0])
        frequency, density = periodogram(signal, fs=rate, window="hann", detrend="constant")
        order = np.argsort(frequency, kind="stable")
        power.append(density[order])
    dims, data = (("frequency",), power[0]) if values.ndim == 1 else (("frequency", "lane"), np.stack(power, -1))
    return xr.Dataset({"power": (dims, data)}, {"frequency": frequency[order]}, {"quantity": label(quantity)})


# -- regular or chaotic ----------------------------------------------------------------------------


APART = 1e-8  # of the neighbour, relative
FEW = 1000  # rows, at most, in which the least momentum rotates the body by a radian
MOST, MOST_SEED = 10**9, 2**63
TINY = 1e-300


@explained
def megno(
    system: Model | Body,
    x0: StateLike,
    *,
    dt: Any,
    steps: int,
    every: Any = 10,
    orientation: OrientationLike | None = None,
    method: str | None = None,
    order: int | None = None,
    seed: int = 0,
) -> xr.Dataset:
    """MEGNO and Lyapunov's exponent of the motion from a state, for each lane, against time.

    system, x0, dt, steps, orientation, method, order   as for `kr.simulate`
    every    steps after which the neighbour is brought back to a distance of 1e-8
    seed     of the direction of the neighbour, whose momentum differs; of several bodies, the momentum of each

    For a body of `kr.physical`, dt and times are in s and lyapunov in 1/s.
    Returns a Dataset with megno Y, its mean over time, and lyapunov, ln(d(t)/d(0))/t, each (time,) or (time, lane).
    The system may come from `kr.perturbed`, whose forces may depend on the orientation and on time; n = 3.  Raises
    `InputError` as `kr.simulate` does.
    """
    model, x0, orientation, dt, every, frame = _in_form_of_state(system, x0, orientation, dt, every)
    check_model(model)
    rows = -(-within(steps, "steps", 1, MOST) // within(every, "every", 1, MOST))
    momenta, vectors, attitudes = _places(model)
    if model.n != 3 or not momenta:
        raise InputError(f"megno: expected a body with n = 3 and its momentum, got {model.system.name}.")
    attitudes += [] if orientation is None else [slice(-4, None)]
    first, lanes, single = _rows(model, x0, orientation)
    pair = model.lanes(np.tile(np.arange(lanes), 2)) if model.batch else model
    p = propagator(pair, method=method, order=order, dt=dt, orientation=orientation is not None)
    record = model.system.perturbation
    timed = record is not None and record.names(TIME)
    change, rng = np.zeros_like(first), np.random.default_rng(within(seed, "seed", 0, MOST_SEED))
    for place in momenta:
        change[:, place] = rng.normal(size=(lanes, 3))
    scale = _scales(model, first, change, vectors, min(rows, FEW) * every * p.dt)
    neighbour = first + APART * scale * change / _length(change)
    growth = np.empty((rows, lanes))
    for row in range(rows):
        moved = p.steps(np.concatenate([first, neighbour]), every, time=row * every * p.dt if timed else None)
        first, neighbour = moved[:lanes, : p.size], moved[lanes:, : p.size]
        for q in attitudes:  # q and -q are the same rotation
            neighbour[:, q] *= np.where(dot(first[:, q], neighbour[:, q]) < 0, -1, 1)[:, None]
        distance = _length((neighbour - first) / scale)
        growth[row] = np.log(distance[:, 0] / APART)
        neighbour = first + (neighbour - first) * APART / distance
        for q in attitudes:
            neighbour[:, q] = unit(neighbour[:, q])
    number = np.arange(1, rows + 1)[:, None]
    value, time = 2 / number * np.cumsum(number * growth, 0), number * every * p.dt * frame.time_unit
    results = {"megno": value, "mean": np.cumsum(value, 0) / number, "lyapunov": np.cumsum(growth, 0) / time}
    dims = ("time",) if single else ("time", "lane")
    return xr.Dataset({k: (dims, v[:, 0] if single else v) for k, v in results.items()}, {"time": time[:, 0]})


def _places(system: Model) -> tuple[list[slice], list[slice], list[slice]]:
    """The places in a row of momenta, of vectors that are compared with their length, and of attitudes."""
    space = system.system.space
    sizes = [4 if kind == "quaternion" else 3 for _, kind in space.components]
    places = [slice(end - size, end) for size, end in zip(sizes, itertools.accumulate(sizes), strict=True)]
    if space.of_body:
        return places[:1], places[:1], []
    attitudes = [place for place, size in zip(places, sizes, strict=True) if size == 4]
    before = {place.start for place in attitudes}  # of several bodies: L, then q
    return [p for p in places if p.stop in before], [p for p in places if p not in attitudes], attitudes


def _scales(model: Model, first: Array, change: Array, vectors: list[slice], duration: float) -> Array:
    """Lengths (lanes, size) by which distances are divided.

    The momentum of a body is counted as at least the momentum along `change` that rotates it by a radian.
    """
    scale = np.ones_like(first)
    for place in vectors:
        scale[:, place] = np.maximum(_length(first[:, place]), TINY)
    if not model.system.space.of_body or model.system.velocity is None:
        return scale
    kinds = [kind for _, kind in model.system.space.components]
    size = algebra.slices(kinds, 3)[-1].stop
    model = model.lanes(np.arange(len(first)))
    before, after = (
        algebra.axial(model.call(model.system.velocity, *algebra.restore(z[:, :size], kinds, 3)))
        for z in (first, first + change)
    )
    scale[:, vectors[0]] = np.maximum(scale[:, vectors[0]], _length(change) / _length(after - before) / duration)
    return scale


def _in_form_of_state(system: Any, x0: Any, orientation: Any, dt: Any, every: Any) -> tuple[Any, ...]:
    """Model, start, orientation, step, steps between rows, and units; `system` may be a body."""
    if (body := as_body(system)) is None:
        return system, x0, orientation, dt, every, BodyFrame()
    model, x0, begun, when, _ = scaled(body, x0, orientation, {"dt": dt, "every": every})
    forces = model.system.perturbation
    oriented = orientation is not None or (forces is not None and bool(forces.names(ORIENTATION)))
    return model, x0, begun if oriented else None, when["dt"], when["every"], model.body_frame


def _rows(system: Model, x0: StateLike, orientation: OrientationLike | None) -> tuple[Array, int, bool]:
    """States and orientations for a propagator (lanes, size), their number, and whether there is a single lane."""
    parts = list(checked_state(system, x0).axial.values())
    parts += [] if orientation is None else [initial_orientation(orientation, system)]
    batch = np.broadcast_shapes(system.batch, *(component.shape[:-1] for component in parts))
    flat = np.concatenate([np.broadcast_to(component, (*batch, component.shape[-1])) for component in parts], -1)
    return flat.reshape(-1, flat.shape[-1]).astype(np.float64), int(np.prod(batch)), not batch


def _length(x: Array) -> Array:
    return np.sqrt((x * x).sum(-1, keepdims=True))
