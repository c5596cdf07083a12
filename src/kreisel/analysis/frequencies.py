"""kr.analysis.frequencies: the lines of a quasi-periodic motion, far beyond the resolution of a Fourier transform.

Laskar's numerical analysis of fundamental frequencies: a line is a maximum of the windowed Fourier integral
(`kreisel.runs.harmonics`).  Then all amplitudes are fitted together, and each line is sought again in what the others
leave, until the frequencies no longer change.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from kreisel.algebra import Array
from kreisel.analysis.quantities import Quantity, label, series
from kreisel.errors import InputError, explained, shown
from kreisel.runs import harmonics
from kreisel.runs.run_record import a_run
from kreisel.runs.settings import whole_number

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr
    from matplotlib.figure import Figure

FEWEST = 16  # samples
SWEEPS = 40


@explained
@dataclass(frozen=True)
class Lines:
    """f(t) = sum of amplitude_j exp(i frequency_j t) + a rest, the largest |amplitude| first.

    frequency   (lines,) angular, in radians and the run's unit of time; of a real signal those >= 0
    amplitude   (lines,) complex, for t counted from time 0; of a real signal f = sum of
                Re(amplitude_j exp(i omega_j t))
    rest        root mean square of what the lines leave of the signal
    change      largest |change| of a frequency in the last sweep, a measure of how constant they are
    """

    frequency: Array
    amplitude: Array
    rest: float
    change: float
    time: Array
    values: Array
    quantity: str

    @property
    def table(self) -> pd.DataFrame:
        """frequency, amplitude and phase of each line."""
        import pandas as pd

        return pd.DataFrame(
            {"frequency": self.frequency, "amplitude": np.abs(self.amplitude), "phase": np.angle(self.amplitude)}
        )

    def plot(self, theme: str = "light") -> Figure:
        """The power spectrum with the lines on it."""
        from kreisel.viewer.charts import plot_lines

        return plot_lines(self, theme=theme)


@explained
def frequencies(run: xr.Dataset, quantity: Quantity, lines: int = 8, *, power: int = 3) -> Lines:
    """The strongest lines of a quantity, real or complex, of one trajectory.

    quantity   "a[0]", "energy", or a function of the stored components, `lambda m, a: a[..., 0] + 1j * a[..., 1]`
    lines      how many at most; fewer are returned where the rest is round-off
    power      of the window of Hann: higher ones leak less and need lines farther apart, (power + 1) 2 pi/T

    Measured on sums of lines: 1e-11 relative or better where they are ten widths 2 pi/T apart.  The frequencies are
    those of the saved states; for a map, those of its interpolating flow.  Beyond pi/(dt every) they are folded.
    Raises `InputError` for ensembles, for rows not evenly spaced and for fewer than 16.
    """
    if "lane" in a_run(run).dims:
        raise InputError("frequencies takes one trajectory: choose a lane, run.isel(lane=0).")
    return lines_of(np.asarray(run["time"].values), series(run, quantity), lines, power=power, quantity=label(quantity))


def lines_of(time: Array, values: Array, lines: int = 8, *, power: int = 3, quantity: str = "f") -> Lines:
    """The same for any evenly spaced samples `values` (time,) at `time`."""
    time, values = _even(time, values)
    lines = whole_number(lines, "lines")
    if not (isinstance(power, int) and power == 0) and whole_number(power, "power") > 8:
        raise InputError(f"power: expected 0 to 8, got {shown(power)}.")
    real = values.dtype.kind != "c"
    centre = (time[0] + time[-1]) / 2
    finder = _Finder(time - centre, power)
    found: list[float] = []
    change = 0.0
    rest = values.astype(complex)
    floor = 4 * np.finfo(float).eps * np.sqrt((np.abs(values) ** 2).mean())
    for _ in range(lines):
        if np.sqrt((np.abs(rest) ** 2).mean()) <= floor:
            break
        new = finder.strongest(rest, real)
        if min((abs(new - old) for old in found), default=np.inf) < finder.width:
            break  # what is left of a line that is there
        found, change = _settled(finder, [*found, new], values, real)
        rest = values - finder.model(found, finder.fit(found, values, real), real)
    amplitude = finder.fit(found, values, real)
    rest = values - finder.model(found, amplitude, real)
    omega = np.array(found)
    amplitude = amplitude * np.exp(-1j * omega * centre)
    order = np.argsort(-np.abs(amplitude), kind="stable")
    return Lines(
        omega[order], amplitude[order], float(np.sqrt((np.abs(rest) ** 2).mean())), change, time, values, quantity
    )


def _even(time: Array, values: Array) -> tuple[Array, Array]:
    time, values = np.asarray(time, dtype=float), np.asarray(values)
    if time.ndim != 1 or values.shape != time.shape or len(time) < FEWEST:
        raise InputError(
            f"At least {FEWEST} samples of one number were expected, got shapes {time.shape}, {values.shape}."
        )
    gaps = np.diff(time)
    if len(gaps) > 1 and gaps[-1] < gaps[0] * (1 - 1e-6):
        time, values, gaps = time[:-1], values[:-1], gaps[:-1]  # the last row of a run may stand closer
    if gaps.min() < gaps.max() * (1 - 1e-6) or gaps.min() <= 0 or not _finite_squares(values):
        raise InputError(
            "expected values with finite squares at evenly spaced times, as kr.simulate saves them, got others."
        )
    return time, values.astype(complex if values.dtype.kind == "c" else float)


def _finite_squares(values: Array) -> bool:
    with np.errstate(all="ignore"):
        return bool(np.isfinite((np.abs(values) ** 2).sum()))


def _settled(finder: _Finder, found: list[float], values: Array, real: bool) -> tuple[list[float], float]:
    """Each line sought again in what the others leave, until none changes any more."""
    change, small = np.inf, 4 * np.finfo(float).eps * max(map(abs, found))
    for _ in range(SWEEPS):
        before, last = list(found), change
        for j in range(len(found)):
            amplitude = finder.fit(found, values, real)
            others = [k for k in range(len(found)) if k != j]
            mirrored = finder.mirror(found[j], amplitude[j], real)
            own = values - finder.model([found[k] for k in others], amplitude[others], real) - mirrored
            found[j] = finder.peak(own, found[j])
        change = max(abs(a - b) for a, b in zip(found, before, strict=True))
        if change <= small or last <= change < 1e-9 * finder.width:  # only rounding moves them
            break
    return found, change


class _Finder:
    """Peaks of the windowed transform of samples at times t, |t| <= T/2, centred."""

    def __init__(self, t: Array, power: int):
        self.t, self.step, self.width = t, t[1] - t[0], 2 * np.pi / (t[-1] - t[0])
        self.window = harmonics.window(t, power)
        self.power = power

    def strongest(self, f: Array, real: bool) -> float:
        """The largest peak."""
        return float(harmonics.strongest(self.t, (self.window * (f.real if real else f))[:, None])[0])

    def peak(self, f: Array, guess: float) -> float:
        """The maximum of |Z| next to a guess."""
        return float(harmonics.peaks(self.t, (self.window * f)[:, None], [guess])[0])

    def _waves(self, found: list[float]) -> Array:
        return np.exp(1j * np.outer(self.t, found))

    def fit(self, found: list[float], values: Array, real: bool) -> Array:
        """The amplitudes of least squares under the window."""
        root, waves = np.sqrt(self.window)[:, None], self._waves(found)
        if not real:
            return np.linalg.lstsq(root * waves, root[:, 0] * values, rcond=None)[0]
        columns = np.concatenate([waves.real, -waves.imag], 1)
        both = np.linalg.lstsq(root * columns, root[:, 0] * values, rcond=None)[0]
        return both[: len(found)] + 1j * both[len(found) :]

    def model(self, found: list[float], amplitude: Array, real: bool) -> Array:
        total = self._waves(found) @ amplitude if len(found) else np.zeros(len(self.t), dtype=complex)
        return total.real if real else total

    def mirror(self, omega: float, amplitude: complex, real: bool) -> Array:
        """The half of a real line at -omega, which leaks into its peak at omega."""
        if not real or abs(omega) < 0.5 * self.width:
            return np.zeros(len(self.t))
        return np.conj(amplitude) / 2 * np.exp(-1j * omega * self.t)


@explained
def power_spectrum(run: xr.Dataset, quantity: Quantity) -> xr.Dataset:
    """The power spectral density of a quantity against the angular frequency, with the window of Hann.

    By `scipy.signal.periodogram`, as a density over the angular frequency: its integral is the mean square of the
    quantity about its mean.  A real quantity has its power at frequencies >= 0.  Returns a Dataset with `power` along
    `frequency`, and lane for ensembles.  Raises `InputError` as `frequencies` does.
    """
    import xarray as xr
    from scipy.signal import periodogram

    values, time = series(a_run(run), quantity), np.asarray(run["time"].values)
    flat = values.reshape(len(values), -1)
    columns: list[Any] = []
    for column in flat.T:
        even, signal = _even(time, column)
        columns.append(periodogram(signal, fs=2 * np.pi / (even[1] - even[0]), window="hann", detrend="constant"))
    frequency = np.fft.fftshift(columns[0][0]) if columns[0][0].min() < 0 else columns[0][0]
    power = [np.fft.fftshift(p) if f.min() < 0 else p for f, p in columns]
    dims = ("frequency",) if values.ndim == 1 else ("frequency", "lane")
    data = power[0] if values.ndim == 1 else np.stack(power, -1)
    return xr.Dataset({"power": (dims, data)}, {"frequency": frequency}, {"quantity": label(quantity)})
