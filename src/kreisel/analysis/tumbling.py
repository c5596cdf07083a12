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
from kreisel.algebra.invariants import cross, inner
from kreisel.kernels.exact.jumps import jumps_of
from kreisel.physical.free_body import periods_of, rotation_scheme

ORDERS = {"short-axis": [0, 1, 2], "long-axis": [2, 1, 0]}
UNKNOWNS = (
    "longitude", "latitude", "precession_phase", "rotation_phase",
    "precession_period", "rotation_period", "moment_a", "amplitude",
)  # fmt: skip
PHASE, PRECESSION, ROTATION, MOMENT, AMPLITUDE = 3, 4, 5, 6, 7
STEP = 1e-6  # of differences of the moment and the amplitude, and of the precession's rate, relative
FAINTEST = 1e-12  # flux, where a magnitude would be infinite
FAR = 35.0  # -log of the distance to the separatrix
PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
COMPONENTS = np.zeros((5, 6))  # orthonormal, of a tensor without its trace
COMPONENTS[:2, :3] = np.array([[1, -1, 0], [-1, -1, 2]]) / np.sqrt([[2], [6]])
COMPONENTS[2:, 3:] = np.sqrt(2) * np.eye(3)


def energies(moments: Array, q: Array) -> tuple[Array, ...]:
    """P_psi |M|, 2 pi/(P_phi |M|), amplitudes (..., 3) of M/|M|, and k'^2, at D = (1 - e^-q)(I_3/I_2 - 1)."""
    I1, I2, I3 = (moments[..., i] for i in range(3))
    edge = I3 / I2 - 1
    D = -edge * np.expm1(-q)
    E = (I3 - I1 - D * I1) / I3
    remainder = (I3 - I1) * (I2 / I3 * edge * np.exp(-q)) / ((I3 - I2) * E)
    squares = I1 * D / (I3 - I1), I2 * D / (I3 - I2), I3 * E / (I3 - I1)
    return *periods_of(moments, E, remainder), np.sqrt(np.stack(squares, -1)), remainder


def moments_of(a: Array, amplitude: Array, ratio: Array, mode: str) -> Array:
    """The moments (..., 3) over the largest, NaN where a body or a motion with this ratio P_psi/P_phi cannot have them.

    At a small tilt the ratio of a body is r_0 = sqrt(I_1 I_2/((I_3 - I_1)(I_3 - I_2))) + s, s = 1 in a short-axis mode,
    -1 in a long-axis mode.  The amplitude A with (r_0 - s)^2 = (1 - A^2)(ratio - s)^2 grows linearly with the tilt.
    """
    short = mode == "short-axis"
    with np.errstate(all="ignore"):
        square = (1 - amplitude**2) * (ratio - (1 if short else -1)) ** 2 * (1 - a)
        b = square / (a + square) if short else a * square / (square - 1)
        valid = (a > 1e-3) & (a < b - 1e-6) & (b < 1 - 1e-6) & (a + b > 1 + 1e-3) & (ratio > short)
    I = np.stack(np.broadcast_arrays(a, b, 1.0), -1)  # noqa: E741
    return np.where((valid & (amplitude > 1e-4))[..., None], I, np.nan)


def by_periods(x: Array, mode: str) -> tuple[Array, Array, Array]:
    """M (lanes, 3) at the epoch, the attitude (lanes, 3, 3) and the moments (lanes, 3) of unknowns x (lanes, 8).

    NaN where no motion has these periods.  The attitude is that with which the third axis is at the azimuth 0 around M.
    """
    from scipy.special import ellipj, ellipkm1

    order, ratio = ORDERS[mode], x[:, ROTATION] / x[:, PRECESSION]
    moments = moments_of(x[:, MOMENT], x[:, AMPLITUDE], ratio, mode)
    good = np.isfinite(moments[:, 0])
    moments = np.where(good[:, None], moments, (0.5, 0.8, 1.0))

    def off(q: Array) -> Array:
        period, rate = energies(moments[:, order], q)[:2]
        return period * rate / (2 * np.pi * np.where(good, ratio, 1.0)) - 1

    with np.errstate(all="ignore"):  # q with this ratio of the periods, by the Illinois rule of false position
        y, q = np.full(ratio.shape, 1e-9), np.full(ratio.shape, FAR)
        u, v = off(y), off(q)
        certain = (u < 0) & (v > 0)
        for _ in range(60):
            between = np.where(certain, q - v * (q - y) / (v - u), 1.0)
            w = off(between)
            crossed = (w > 0) != (v > 0)
            y, u = np.where(crossed, q, y), np.where(crossed, v, u / 2)
            q, v = between, w
            if not (certain & (abs(w) > 1e-14)).any():
                break
        good &= certain & (abs(v) < 1e-11)
        period, _, amplitudes, remainder = energies(moments[:, order], np.where(good, q, 1.0))
        sn, cn, dn, _ = ellipj(4 * ellipkm1(remainder) * x[:, PHASE] / (2 * np.pi), 1 - remainder)
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


def motion(M: Array, attitude: Array, moments: Array, times: Array) -> tuple[Array, Array]:
    """M (3, times, lanes) along the axes of the body and its quaternions (4, times, lanes), at times from time 0 on."""
    z = algebra.flatten((algebra.hat(M), algebra.unit_quaternion(attitude)), ["skew", "quaternion"])
    out, _ = jumps_of(rotation_scheme(moments), len(M)).at(np.ascontiguousarray(z), times)
    out = np.ascontiguousarray(np.moveaxis(out, -1, 0))
    return out[2::-1] * np.array([-1.0, 1.0, -1.0])[:, None, None], out[3:]


def _to_body(q: Array, v: Array) -> Array:
    """Vectors (3, ...) along the axes of bodies with the quaternions q (4, ...)."""
    t = 2 * _cross(v, q[1:])
    return v + q[0] * t + _cross(t, q[1:])


def _cross(x: Array, y: Array) -> Array:
    return np.stack(cross(x, y))


@dataclass(frozen=True, eq=False)
class Photometry:
    """Magnitudes at times from the epoch on, with errors, vectors to Sun and observer (times, 3), and apparitions.

    ball      about the flux of a ball at these times
    light     (s, o, half axes) -> flux and its slopes, of unit vectors
    axes      the half axes of the ellipsoid, or None: of constant density, by its moments
    """

    time: Array
    magnitude: Array
    sigma: Array
    sun: Array
    observer: Array
    apparition: Array
    ball: Array
    light: Callable[[Array, Array, Array], tuple[Array, Callable[[], tuple[Array, ...]]]]
    axes: Array | None = None

    def some(self, which: Any) -> Photometry:
        """The observations `which`."""
        names = ("time", "magnitude", "sigma", "sun", "observer", "apparition", "ball")
        return replace(self, **{name: getattr(self, name)[which] for name in names})

    def half_axes(self, moments: Array) -> Array:
        """The half axes (..., 3) of the ellipsoid of constant density with these moments (..., 3), the longest 1."""
        if self.axes is not None:
            return self.axes
        squares = moments.sum(-1, keepdims=True) - 2 * moments
        return np.sqrt(squares / squares[..., :1])

    def without_constants(self, r: Array) -> Array:
        """Residuals (times, ...) over sigma, less the best constant of each apparition."""
        out = np.empty_like(r)
        for k in np.unique(self.apparition):
            which = self.apparition == k
            w = 1 / self.sigma[which]
            out[which] = r[which] - np.multiply.outer(w, np.tensordot(w, r[which], 1) / (w @ w))
        return out

    def ways(self, x: Array, q: Array) -> tuple[Array, ...]:
        """Unit vectors (3, times, lanes) to Sun and observer along the axes of bodies with quaternions q."""
        P = poles(x)
        return tuple(_to_body(q, np.ascontiguousarray((P @ v.T).transpose(1, 2, 0))) for v in (self.sun, self.observer))

    def _magnitudes(self, flux: Array) -> Array:
        """Residuals over sigma (times, lanes)."""
        magnitude = -2.5 * np.log10(np.maximum(flux, FAINTEST))
        return self.without_constants((self.magnitude[:, None] - magnitude) / self.sigma[:, None])

    def residuals(self, x: Array, mode: str) -> Array:
        """Residuals (times, lanes) of unknowns x (lanes, 8); NaN if no motion has these periods."""
        M, attitude, moments = by_periods(x, mode)
        s, o = self.ways(x, motion(M, attitude, moments, self.time)[1])
        return self._magnitudes(self.light(np.moveaxis(s, 0, -1), np.moveaxis(o, 0, -1), self.half_axes(moments))[0])

    def jacobian(self, x: Array, mode: str) -> tuple[Array, Array]:
        """Residuals (lanes, times) and their derivatives (lanes, times, 8)."""
        M, attitude, moments = by_periods(x, mode)
        momentum, q = motion(M, attitude, moments, self.time)
        s, o = self.ways(x, q)
        flux, slopes = self.light(np.moveaxis(s, 0, -1), np.moveaxis(o, 0, -1), self.half_axes(moments))
        by_sun, by_view, *by_shape = (np.moveaxis(v, -1, 0) for v in slopes())
        lever = _cross(s, by_sun) + _cross(o, by_view)
        rotations, changes = self._variations(x, mode, (M, attitude, moments), momentum, q)
        rates = [-inner(lever, w) for w in rotations]
        if self.axes is None and by_shape:
            squares = moments.sum(-1, keepdims=True) - 2 * moments
            for k, change in changes.items():
                of_squares = change.sum(-1, keepdims=True) - 2 * change
                of_inverse = (of_squares[:, :1] - squares[:, :1] / squares * of_squares) / squares  # of 1/axes^2
                rates[k] += inner(by_shape[0], of_inverse.T[:, None])
        share = 2.5 / np.log(10) / np.maximum(flux, FAINTEST) / self.sigma[:, None]
        J = [self.without_constants(share * rate).T for rate in rates]
        return self._magnitudes(flux).T, np.nan_to_num(np.stack(J, -1))

    def _variations(
        self, x: Array, mode: str, start: tuple[Array, ...], momentum: Array, q: Array
    ) -> tuple[list[Array], dict[int, Array]]:
        """Rotations (3, times, lanes) of the body along its axes by a change of each unknown; changes of the moments.

        A phase of rotation is a time, less the precession; both periods together are a unit of time.  The shape of the
        motion, by the ratio of the periods, the moment and the amplitude, is varied by differences.
        """
        (M, attitude, moments), P, t = start, poles(x), self.time[:, None]
        along, Omega = momentum / np.sqrt(inner(momentum, momentum)), momentum / moments.T[:, None]
        east = np.stack([-np.sin(x[:, 0]), np.cos(x[:, 0]), 0 * x[:, 0]], -1)
        out = [_to_body(q, v.T[:, None]) for v in (P[:, :, 2], -algebra.act(P, east))] + [along]
        spin = algebra.act(attitude, M / moments)  # at the epoch, the third axis at the azimuth 0
        axis = attitude[:, :, ORDERS[mode][2]]
        rate = spin[:, 2] - spin[:, 0] * axis[:, 2] / axis[:, 0]
        out.append((Omega - rate * along) * (x[:, ROTATION] / (2 * np.pi)))
        changes = {}
        for k in (PRECESSION, MOMENT, AMPLITUDE):
            y, change = x.copy(), -STEP * x[:, k] if k == PRECESSION else np.full(len(x), STEP)
            y[:, k] += change
            N, first, varied = by_periods(y, mode)
            new = motion(N, first, varied, self.time)[1]
            secular = 2 * np.pi * t * (1 / y[:, PRECESSION] - 1 / x[:, PRECESSION])
            w, z = np.cos(secular / 2), np.sin(secular / 2)
            new = w * new + z * np.stack([new[3], new[2], -new[1], -new[0]])  # rotated back about M
            turned = q[0] * new[1:] - new[0] * q[1:] + _cross(new[1:], q[1:])
            side = np.where((q * new).sum(0) < 0, -2.0, 2.0)
            out.append(side * turned / change)
            changes[k] = (varied - moments) / change[:, None]
        out[4] += (-2 * np.pi / x[:, PRECESSION] ** 2) * t * along
        share = x[:, PRECESSION] / x[:, ROTATION]
        out.insert(ROTATION, -t / x[:, ROTATION] * Omega - share * out[4])
        changes[ROTATION] = -share[:, None] * changes[PRECESSION]
        return out, changes


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


class Scan:
    """Approximate chi^2 of motions, of the best attitude of the momentum, by linear least squares.

    (flux/flux of a ball)^2 = c + sum over a, b of W_ab B_a T_b: B the tensor b b of the bisector b in space, T the
    tensor A^-2 of the body along axes of the momentum, without traces; W represents the rotation between the axes.
    """

    def __init__(self, seen: Photometry, mode: str):
        self._seen, self._mode = seen, mode
        b = (seen.sun + seen.observer).T
        b = b / np.sqrt(inner(b, b))
        self._bisector = COMPONENTS @ np.stack([b[i] * b[j] for i, j in PAIRS])
        reduced = seen.magnitude + 2.5 * np.log10(seen.ball)
        square = 10 ** (-0.8 * (reduced - reduced.mean()))
        self._weight = 1 / (0.8 * np.log(10) * seen.sigma * square)
        self._value = self._weight * square

    def _normal(self, x: Array) -> tuple[Array, Array]:
        """The normal equations, (lanes, 26, 26) and (lanes, 26)."""
        M, attitude, moments = by_periods(x, self._mode)
        q = motion(M, attitude, moments, self._seen.time)[1]
        R = np.stack([_to_body(q, e[:, None, None]) for e in np.eye(3)])
        axes = np.broadcast_to(self._seen.half_axes(moments), moments.shape)
        scaled = R * (1 / axes**2).T[:, None]  # R diag(1/axes^2) R^T without its trace, by five components
        T = np.tensordot(COMPONENTS, np.stack([inner(scaled[i], R[j]) for i, j in PAIRS]), 1)
        D = np.empty((26, *T.shape[1:]))
        weighted = self._bisector * self._weight
        np.multiply(weighted[:, None, :, None], T, out=D[:25].reshape(5, 5, *T.shape[1:]))
        D[25] = self._weight[:, None]
        D = np.ascontiguousarray(D.transpose(2, 0, 1))
        return D @ D.mT, D @ self._value

    def least(self, x: Array) -> Array:
        """The least chi^2 (lanes,), of any W."""
        G, h = self._normal(x)
        G += np.eye(26) * (1e-9 * np.trace(G, axis1=1, axis2=2))[:, None, None]
        chi2 = self._value @ self._value - (h * np.linalg.solve(G, h[..., None])[..., 0]).sum(-1)
        return np.nan_to_num(chi2, nan=np.inf)

    def by_views(self, x: Array, views: Array) -> tuple[Array, Array]:
        """The least chi^2 (lanes,) of W by the poles and phases of precession (views, 3), and which of them has it."""
        G, h = self._normal(x)
        basis, P = np.zeros((5, 3, 3)), poles(views)
        for k, (i, j) in enumerate(PAIRS):
            basis[:, i, j] = basis[:, j, i] = COMPONENTS[:, k] / (1 + (i != j))
        W = np.einsum("aij,vki,vlj,bkl->vab", basis, P, P, basis, optimize=True).reshape(len(P), 25)
        total, first = h[:, 25:], G[:, 25:, :25] @ W.T  # of the constant
        share = first[:, 0] / G[:, 25:, 25]
        slope = h[:, :25] @ W.T - share * total
        curvature = ((W @ G[:, :25, :25]) * W).sum(-1) - share * first[:, 0]
        with np.errstate(invalid="ignore"):
            gain = np.nan_to_num(np.where(slope > 0, slope * slope / curvature, 0.0))
        best = gain.argmax(1)
        chi2 = self._value @ self._value - total[:, 0] ** 2 / G[:, 25, 25] - gain[np.arange(len(x)), best]
        return np.nan_to_num(chi2, nan=np.inf), best
