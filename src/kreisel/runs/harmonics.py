"""The strongest harmonic of evenly spaced samples: the maximum of their Fourier integral under a window.

Z(omega) = sum_k w_k f_k exp(-i omega t_k), where the window w is Hann's to the power `power`.  |Z| has a maximum at the
frequency of each harmonic.  The other harmonics shift it by an amount that falls like T^-(2 power + 2), T the length of
the samples.  A Fourier transform has the resolution 1/T.
[J. Laskar, Icarus 88 (1990) 266; Laskar, Introduction to frequency map analysis, 1999, arXiv math/0305364]
"""

from __future__ import annotations

from typing import Any

import numpy as np

from kreisel.algebra import Array

PADDING = 4  # times as many frequencies as samples: one lies within an eighth of a line's width of the maximum
MOST_STEPS = 40
STILL = 4 * np.finfo(float).eps  # relative: a frequency that moves less has converged


def window(t: Array, power: int) -> Array:
    """Hann's to a power, at times t about 0; its sum is 1."""
    w = np.cos(np.pi * t / (t[-1] - t[0] + (t[1] - t[0]))) ** (2 * power)
    return np.asarray(w / w.sum())


def strongest(t: Array, weighted: Array, *, still: bool = True) -> Array:
    """The frequency of the largest peak of each column of window times samples (rows, columns); >= 0 for real samples.

    With still=False, frequency 0 is left out.
    """
    real = weighted.dtype.kind != "c"
    size = PADDING * len(t)
    heights = abs(np.fft.rfft(weighted, size, axis=0) if real else np.fft.fft(weighted, size, axis=0))
    grid = 2 * np.pi * (np.fft.rfftfreq if real else np.fft.fftfreq)(size, t[1] - t[0])
    if not still:
        heights[0] = 0
    return peaks(t, weighted, grid[heights.argmax(0)])


def peaks(t: Array, weighted: Array, omega: Any) -> Array:
    """The maximum of |Z| next to omega (columns,) in each column, by Newton's method for d|Z|^2/d(omega) = 0.

    The result of a column does not depend on the other columns, to the last bit.
    """
    omega, t = np.array(omega, dtype=float), t[:, None]
    most = float(np.pi / 2 / (t[-1] - t[0])[0])  # a quarter of a width
    moving = np.full(omega.shape, True)
    for _ in range(MOST_STEPS):
        turned = weighted * np.exp(-1j * t * omega)
        Z, Z1, Z2 = turned.sum(0), (-1j * t * turned).sum(0), (-t * t * turned).sum(0)
        slope, curve = (Z1 * Z.conj()).real, (Z2 * Z.conj()).real + abs(Z1) ** 2
        uphill = np.sign(slope) * most
        step = np.clip(np.divide(-slope, curve, out=uphill, where=curve < 0), -most, most)
        omega = np.where(moving, omega + step, omega)
        moving &= abs(step) > STILL * abs(omega)
        if not moving.any():
            break
    return omega
