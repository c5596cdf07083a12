"""Free bodies by the two periods of their motion, in lanes: states, light and residuals for `fit_light_curve`.

The axes are in the order of `kreisel.exact.rotor`: the motion goes round the third, I_3 is the largest moment in a
short-axis mode and the smallest in a long-axis mode.  With |M| = 1, D = 2T I_3 - 1 is between 0 and I_3/I_2 - 1, and
E = 1 - 2T I_1.  P_psi is the period of the momentum around the third axis in the body, P_phi the mean period of this
axis around the momentum in space.  [Kaasalainen, A&A 376 (2001) 302]
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.kernels.exact.jumps import jumps_of
from kreisel.physical.free_rotation import periods_of, rotation_scheme

ORDERS = {"short-axis": [0, 1, 2], "long-axis": [2, 1, 0]}
UNKNOWNS = (
    "longitude", "latitude", "precession_phase", "rotation_phase",
    "precession_period", "rotation_period", "moment_a", "moment_b",
)  # fmt: skip
PRECESSION, ROTATION = 4, 5
STEP = 1e-6  # of differences: of an angle, a moment, a phase
FAINTEST = 1e-12  # flux, where a magnitude would be infinite
FAR = 35.0  # -log of the distance to the separatrix


def energies(moments: Array, q: Array) -> tuple[Array, ...]:
    """P_psi |M|, 2 pi/(P_phi |M|), amplitudes (..., 3) of M/|M|, and k'^2, at D = (1 - e^-q)(I_3/I_2 - 1)."""
    I1, I2, I3 = (moments[..., i] for i in range(3))
    edge = I3 / I2 - 1
    D = -edge * np.expm1(-q)
    E = (I3 - I1 - D * I1) / I3
    rest = (I3 - I1) * (I2 / I3 * edge * np.exp(-q)) / ((I3 - I2) * E)
    squares = I1 * D / (I3 - I1), I2 * D / (I3 - I2), I3 * E / (I3 - I1)
    return *periods_of(moments, E, rest), np.sqrt(np.stack(squares, -1)), rest


def _separation(moments: Array, ratio: Array) -> tuple[Array, Array]:
    """The q (...) with this ratio of the periods, and whether it exists: by the Illinois rule of false position."""

    def off(q: Array) -> Array:
        period, rate = energies(moments, q)[:2]
        return period * rate / (2 * np.pi * ratio) - 1

    x, y = np.full(ratio.shape, 1e-9), np.full(ratio.shape, FAR)
    u, v = off(x), off(y)
    certain = (u < 0) & (v > 0)
    for _ in range(60):
        q = np.where(certain, y - v * (y - x) / (v - u), 1.0)
        w = off(q)
        crossed = (w > 0) != (v > 0)
        x, u = np.where(crossed, y, x), np.where(crossed, v, u / 2)
        y, v = q, w
        if not (certain & (abs(w) > 1e-14)).any():
            break
    return y, certain & (abs(v) < 1e-11)


def possible(moments: Array) -> Array:
    """Whether a body can have the moments (..., 2) over the largest, with I_a < I_b < 1, some distance apart."""
    a, b = moments[..., 0], moments[..., 1]
    return (a > 1e-3) & (a < b - 1e-6) & (b < 1 - 1e-6) & (a + b > 1 + 1e-3)


def by_periods(x: Array, mode: str) -> tuple[Array, Array, Array]:
    """M (lanes, 3) at the epoch, the attitude (lanes, 3, 3) and the moments (lanes, 3) of unknowns x (lanes, 8).

    NaN where no motion has these periods.  The attitude is that with which the third axis is at the azimuth 0 around M.
    """
    from scipy.special import ellipj, ellipkm1

    order, ratio = ORDERS[mode], x[:, ROTATION] / x[:, PRECESSION]
    moments = np.concatenate([x[:, 6:], np.ones((len(x), 1))], -1)
    good = possible(x[:, 6:]) & (ratio > 0)
    safe = np.where(good[:, None], moments, (0.5, 0.8, 1.0))[:, order]

    with np.errstate(all="ignore"):
        q, certain = _separation(safe, np.where(good, ratio, 1.0))
        good &= certain
        period, _, amplitudes, rest = energies(safe, np.where(good, q, 1.0))
        sn, cn, dn, _ = ellipj(4 * ellipkm1(rest) * x[:, 3] / (2 * np.pi), 1 - rest)
    N = amplitudes * np.stack([cn, sn, dn], -1)
    M = np.empty_like(N)
    M[:, order] = N
    M /= np.linalg.norm(M, axis=-1, keepdims=True)
    across = np.eye(3)[order[2]] - M[:, order[2], None] * M
    across /= np.linalg.norm(across, axis=-1, keepdims=True)
    attitude = np.stack([across, np.cross(M, across), M], -2)
    M = M * np.where(good, period / x[:, ROTATION], np.nan)[:, None]
    return M, attitude, moments


def poles(x: Array) -> Array:
    """The rotation (lanes, 3, 3) of space to the axes of `by_periods`: by the pole and the phase of precession."""
    lon, lat, phi = (x[:, i] for i in range(3))
    cl, sl, cb, sb, cp, sp = np.cos(lon), np.sin(lon), np.cos(lat), np.sin(lat), np.cos(phi), np.sin(phi)
    south, east = np.stack([sb * cl, sb * sl, -cb], -1), np.stack([-sl, cl, 0 * lon], -1)
    u, v = cp[:, None] * south + sp[:, None] * east, cp[:, None] * east - sp[:, None] * south
    return np.stack([u, v, np.stack([cb * cl, cb * sl, sb], -1)], -2)


def turns(M: Array, moments: Array, times: Array) -> Array:
    """The rotations (times, lanes, 3, 3) of the body from time 0 on, along its axes at time 0."""
    z = algebra.flatten((algebra.hat(M), np.tile((1.0, 0, 0, 0), (len(M), 1))), ["skew", "quaternion"])
    out, _ = jumps_of(rotation_scheme(moments), len(M)).at(np.ascontiguousarray(z), times)
    return algebra.rotation_matrix(out[..., 3:])


@dataclass(frozen=True, eq=False)
class Photometry:
    """Magnitudes at times from the epoch on, with errors, vectors to Sun and observer (times, 3), and apparitions.

    light     (s, o, half axes) -> flux, of unit vectors
    axes      the half axes of the ellipsoid, or None: of constant density, by its moments
    """

    time: Array
    magnitude: Array
    sigma: Array
    sun: Array
    observer: Array
    apparition: Array
    light: Callable[[Array, Array, Array | None], Array]
    axes: Array | None = None

    def some(self, which: Any) -> Photometry:
        """The observations `which`."""
        names = ("time", "magnitude", "sigma", "sun", "observer", "apparition")
        return replace(self, **{name: getattr(self, name)[which] for name in names})

    def half_axes(self, moments: Array) -> Array | None:
        """The half axes (..., 3) of the ellipsoid of constant density with these moments (..., 3), the longest 1."""
        if self.axes is not None:
            return self.axes
        squares = moments.sum(-1, keepdims=True) - 2 * moments
        return np.sqrt(np.maximum(squares / squares[..., :1], 1e-6))

    def without_constants(self, r: Array) -> Array:
        """Residuals (times, ...) over sigma, less the best constant of each apparition."""
        out = np.empty_like(r)
        for k in np.unique(self.apparition):
            which = self.apparition == k
            w = 1 / self.sigma[which]
            out[which] = r[which] - np.multiply.outer(w, np.tensordot(w, r[which], 1) / (w @ w))
        return out

    def differences(self, turned: Array, first: Array, moments: Array) -> Array:
        """Residuals (times, lanes) of motions: rotations from the epoch on, and from space to the body there."""
        s, o = (
            np.einsum("tlji,tlj->tli", turned, np.einsum("lij,tj->tli", first, v)) for v in (self.sun, self.observer)
        )
        flux = self.light(s, o, self.half_axes(moments))
        magnitude = -2.5 * np.log10(np.maximum(flux, FAINTEST))
        return self.without_constants((self.magnitude[:, None] - magnitude) / self.sigma[:, None])

    def residuals(self, x: Array, mode: str) -> Array:
        """Residuals (times, lanes) of unknowns x (lanes, 8); NaN if no motion has these periods."""
        M, attitude, moments = by_periods(x, mode)
        return self.differences(turns(M, moments, self.time), attitude.mT @ poles(x), moments)

    def jacobian(self, x: Array, mode: str) -> tuple[Array, Array]:
        """Residuals (lanes, times) and their derivatives (lanes, times, 8), by differences."""
        steps = np.full(x.shape, STEP)
        steps[:, PRECESSION:6] *= x[:, PRECESSION:6] ** 2 / max(np.ptp(self.time), 1e-300)
        out = np.empty((len(x), len(self.time), 8))
        M, attitude, moments = by_periods(x, mode)
        turned = turns(M, moments, self.time)
        r = self.differences(turned, attitude.mT @ poles(x), moments)
        for i in range(8):
            y = x.copy()
            y[:, i] += steps[:, i]
            moved = self.differences(turned, attitude.mT @ poles(y), moments) if i < 3 else self.residuals(y, mode)
            out[..., i] = ((moved - r) / steps[:, i]).T
        return r.T, np.nan_to_num(out)


def refined(seen: Photometry, x: Array, mode: str, iterations: int = 30) -> tuple[Array, Array]:
    """Unknowns (lanes, 8) at the minima of chi^2 next to x, by Levenberg and Marquardt's method, and chi^2."""
    x, damping, live = x.copy(), np.full(len(x), 1e-2), np.arange(len(x))
    chi2 = np.full(len(x), np.inf)
    for _ in range(iterations):
        r, J = seen.jacobian(x[live], mode)
        chi2[live] = np.nan_to_num((r * r).sum(-1), nan=np.inf)
        A, b = J.mT @ J, (J.mT @ r[..., None])[..., 0]
        diagonal = np.einsum("lii->li", A)
        lowered = np.zeros(len(live))
        for _ in range(3):
            floor = 1e-12 * diagonal.max(-1, keepdims=True) + 1e-300
            damped = A + np.eye(8) * (damping[live, None] * diagonal + floor)[..., None]
            trial = x[live] - np.linalg.solve(damped, np.nan_to_num(b)[..., None])[..., 0]
            open_ = lowered == 0
            new = np.full(len(live), np.inf)
            s = seen.residuals(trial[open_], mode)
            new[open_] = np.nan_to_num((s * s).sum(0), nan=np.inf)
            better = open_ & (new < chi2[live])
            lowered[better] = chi2[live[better]] - new[better]
            x[live[better]], chi2[live[better]] = trial[better], new[better]
            damping[live] *= np.where(better, 0.1, np.where(open_, 8.0, 1.0))
            if (lowered > 0).all():
                break
        live = live[(lowered > 1e-3) | ((lowered == 0) & (damping[live] < 1e4) & np.isfinite(chi2[live]))]
        if not len(live):
            break
    return x, chi2
