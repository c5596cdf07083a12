"""method="exact" of the gyrostat, n = 3, M' = M x (w M - b): the addition theorem of `kreisel.exact.quadrics`.

A step is a few equal maps, whose coefficients are found once a trajectory in extended precision; long times are made
shorter by complete periods.  The orientation rotates by g z(psi) p, p M(t) = M the shortest rotation, z(psi) that
about M by

    psi' = L Omega.(M + M(t))/(L^2 + M.M(t)),   Omega = w M(t) - b,

which is integrated by Gauss's rule at points of the motion.  The rotation of a map is linear in the state half-way; the
matrix is fitted to those, and a step needs forms for it too.  Over a period it is a rotation about M, by a mean of psi'
in many digits, with any e L in place of the first M.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from fractions import Fraction
from typing import Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.baecklund.conjugate import legendre
from kreisel.errors import InputError
from kreisel.exact.nutation import mp_number, rationals
from kreisel.exact.quadrics import (
    BELOW,
    FORMS,
    NEAR,
    change,
    coefficients,
    curve,
    curve_of,
    forms,
    invariants,
    length,
    lift,
    motion,
    moved,
    quartic,
    rate,
)
from kreisel.record.calling import call
from kreisel.record.contract import System

FAR = 6  # maps in a step, beyond which complete periods are left out
CORRECTIONS = 3
NODES, SAMPLES = 8, 64  # of Gauss's rule; points of a motion, 0.4 e-foldings apart at most
MOST_TURN, MOST_MAPS = 6.0, 4096  # radians of a map with orientation; maps of a step
SETTLED = 22.0  # e-foldings, after which a motion without a period is still
DIGITS = 40  # of a period, beyond those that close roots and long times use up
TWICE = 16 * np.arctan(np.longdouble(1))  # two rotations, after which a quaternion is the same
FEWEST, TURN_DIGITS = 16, 22  # points of a period; digits of its rotation, beyond those that long times use up
DIRECTIONS = np.array([e for e in np.ndindex(3, 3, 3) if e != (1, 1, 1)]) - 1
HALF, SHARES = legendre(NODES)
NODE, WEIGHT = np.concatenate([1 - HALF[::-1], 1 + HALF]) / 2, np.concatenate([SHARES[::-1], SHARES]) / 2  # of [0, 1]
TURN = {"turn_" + k: v for k, v in FORMS.items()}  # of the vector of a quaternion
LEAN = {"lean_" + k: max(0, v - 1) for k, v in FORMS.items()}  # and of its scalar
AXES = {**FORMS, **BELOW, **TURN, **LEAN, "size": 0, "inverse": 0, "still": 0}


def step(M: Array, *g: Array, size: Array, inverse: Array, **constants: Array) -> tuple[Array, ...]:
    """The state after one map."""
    x = algebra.axial(M) * algebra.vec(inverse)
    step = change(x, constants)
    new = x + step
    return M + algebra.hat(step * algebra.vec(size)), *(turned(x, new, q, constants) for q in g)


def turned(x: Array, y: Array, g: Array, constants: Mapping[str, Array]) -> Array:
    """The orientation after one map, from x = M/L to y: of what the forms say, the part that carries x to y."""
    squares, products = x * x, x[..., algebra.SECOND] * x[..., algebra.THIRD]
    turn = algebra.act(constants["turn_squares"], squares) + algebra.act(constants["turn_products"], products)
    turn = turn + algebra.act(constants["turn_linear"], x) + constants["turn_fixed"]
    lean = algebra.dot(constants["lean_squares"], squares) + algebra.dot(constants["lean_products"], products)
    q = algebra.quaternion(lean + algebra.dot(constants["lean_linear"], x) + constants["lean_fixed"], turn)
    shortest, half = lift(x, y), algebra.quaternion(0 * lean, x + y)
    carrying = algebra.vec(algebra.dot(q, shortest)) * shortest + algebra.vec(algebra.dot(q, half)) * half
    q = carrying + algebra.vec(constants["still"]) * (q - carrying)
    return algebra.unit(algebra.quaternion_product(g, q))


class Body:
    """Motions through M (..., 3), in extended precision; `speed` is the number of maps in a unit of time."""

    def __init__(self, M: Array, parameters: Mapping[str, Array], system: System, oriented: bool):
        self.M, self._parameters, self._system, self._oriented = M, parameters, system, oriented
        wide = {k: np.asarray(v, dtype=np.longdouble) for k, v in parameters.items()}
        self.x, self.w, self.b = np.broadcast_arrays(
            M.astype(np.longdouble), *call(system.closed_form.gyrostat, (), wide)
        )
        with np.errstate(all="ignore"):
            self.L, self._K = curve(self.x, self.w, self.b)
            self.speed = length(self._K)
            self._pace = self.speed * (1 + oriented)  # no map is too long for its rotations, which are integrated
            if oriented:
                fastest = abs(self.w * self.x).sum(-1) + abs(self.b).sum(-1)
                self.speed = 2 * np.maximum(self.speed, fastest / MOST_TURN)
        if not np.isfinite(self.speed).all():
            raise InputError("The powers of the state and the parameters leave the range of doubles. Use other units.")
        self.inverse = 1 / (self.L + (self.L == 0))

    def numbers(self, time: Array) -> tuple[dict[str, Array], dict[str, Array], int]:
        """Constants of the motion and of a map, for `step` and these times, and the number of maps."""
        most = float(np.max(self.speed * abs(time)))
        if most > MOST_MAPS:
            raise InputError(
                f"Expected a step of at most {MOST_MAPS} maps, got {most:.3g} of them. Usual cause: a long step with "
                "the orientation, where complete periods are not left out. Use a shorter dt, kr.at, or no orientation."
            )
        maps = max(1, math.ceil(most))
        span = time / maps
        K = self._K * algebra.mat(span)
        constants, stage = {"size": self.L, "inverse": self.inverse}, forms(K)
        if self._oriented:
            constants["still"] = 1.0 * (self.L == 0)
            result = coefficients(self._turn(K, span))
            stage |= {f"turn_{k}": v[..., 1:, :] if v.ndim > K.ndim - 1 else v[..., 1:] for k, v in result.items()}
            stage |= {f"lean_{k}": v[..., 0, :] if v.ndim > K.ndim - 1 else v[..., 0] for k, v in result.items()}
        return constants, stage, maps

    def _turn(self, K: Array, span: Array) -> Array:
        """Forms of the quaternion of a map: those of the state at half the time, taken to it by a matrix.

        |matrix X|^2 is the form of the denominator; the matrix is fitted to rotations along the motion.
        """
        spaced = forms(self._K / algebra.mat(self.speed + (self.speed == 0)))
        x = [self.x * algebra.vec(self.inverse)]
        for _ in range(SAMPLES - 1):
            x.append(x[-1] + change(x[-1], spaced))
        start = np.stack(x, -2)
        half, length = moved(K / 2)
        middle = start + change(start, _spread(forms(K / 2)))
        middle = np.concatenate([middle, np.ones_like(middle[..., :1])], -1)
        square = (middle[..., None, :] @ length[..., None, :, :] @ middle[..., None])[..., 0, 0]
        want = self._turns(start, K, span) * algebra.vec(np.sqrt(square))
        inverse = np.linalg.pinv(middle.astype(float), rcond=1e-14)
        matrix = np.zeros((*K.shape[:-2], 4, 4), dtype=K.dtype)
        for _ in range(CORRECTIONS):  # corrected by the residual, in more digits than the inverse has
            matrix = matrix + inverse @ (want - middle @ matrix)
        return (matrix.mT[..., None, None] * half[..., None, :, :, :]).sum(-3)

    def _turns(self, x: Array, K: Array, span: Array) -> Array:
        """The quaternions of a map from each x (..., SAMPLES, 3)."""
        return self._turned(x, [_spread(k) for k in _nodes(K)], span, self.w)

    def _turned(self, x: Array, nodes: list[dict[str, Array]], span: Array, w: Array) -> Array:
        """The quaternions of a map from each x (..., SAMPLES, 3), by Gauss's rule."""
        size, w, b = (v[..., None, :] for v in (algebra.vec(self.L), w, self.b))
        angle = np.zeros(x.shape[:-1], dtype=x.dtype)
        for constants, weight in zip(nodes[:-1], WEIGHT, strict=True):
            angle = angle + weight * rate(x, x + change(x, constants), size, w, b)
        remainder = -b * (size == 0)  # M = 0: the body rotates against its wheel
        z = algebra.turn(algebra.vec(angle) * span[..., None, None] * x + remainder * span[..., None, None])
        return algebra.unit(algebra.quaternion_product(z, lift(x, x + change(x, nodes[-1]))))

    def after(self, times: list[Fraction], g: tuple[Array, ...]) -> tuple[Array, ...]:
        """M (times, 3) and the orientation, if any, of one lane.

        All but one w is in common: without it M moves the same way, with it the body also rotates evenly about M.
        """
        start, (w, b) = rationals(self.M), self._exactly(())
        common, w = w[0], w - w[0]
        left, angle, ended = remainders(start, w, b, times, self._oriented)
        time, w = np.array(left, dtype=np.longdouble), _wides(w)
        maps = max(1, math.ceil(float(np.max(self._pace * abs(time)))))
        span = time / maps
        _, K = curve(self.x, w, _wides(b))
        nodes = _nodes(K * algebra.mat(span)) if g else [forms(K * algebra.mat(span))]
        M = self.x + np.zeros((len(times), 1), dtype=np.longdouble)
        x = M * self.inverse
        q = algebra.turn(algebra.vec(angle) * x)
        if g:
            q = algebra.quaternion_product(q, algebra.turn(algebra.vec(evenly(start, common, times)) * x))
        spread = [_spread(k) for k in nodes]
        for _ in range(maps):
            if g:
                q = algebra.quaternion_product(q, self._turned(x[:, None], spread, span, w)[:, 0])
            step = change(x, nodes[-1])
            M, x = M + step * self.L, x + step
        for k in np.flatnonzero(ended):
            M[k] = self.at_rest(M[k])
            end = M[k] * self.inverse
            beyond = algebra.dot(w * M[k] - self.b, end) * (_wide(times[k]) - time[k])
            beyond = beyond - TWICE * np.rint(beyond / TWICE)
            last = algebra.quaternion_product(algebra.unit(lift(x[k], end)), algebra.turn(beyond * end))
            q[k] = algebra.quaternion_product(q[k], last)
        return M, *(algebra.unit(algebra.quaternion_product(v, q)) for v in g)

    def at_rest(self, M: Array) -> Array:
        """The momentum at rest that is nearest, M x (w M - b) = 0, of one lane."""
        for _ in range(CORRECTIONS):
            Omega = self.w * M - self.b
            slopes = np.concatenate([algebra.hat(M) * self.w - algebra.hat(Omega), M[None]]).astype(float)
            lack = np.append(algebra.cross(M, Omega), (M @ M - self.L**2) / 2)
            M = M - np.linalg.lstsq(slopes, lack.astype(float), rcond=None)[0]
        return M

    def remainders(self, lane: tuple[int, ...], times: list[Fraction]) -> tuple[list[np.longdouble], Array, Array]:
        """`remainders` of one lane, from the values as they are given."""
        return remainders(rationals(self.M[lane]), *self._exactly(lane), times, self._oriented)

    def _exactly(self, lane: tuple[int, ...]) -> tuple[Array, Array]:
        """w and b of one lane as rationals."""
        values = {k: rationals(np.broadcast_to(v, self.x.shape)[lane]) for k, v in self._parameters.items()}
        w, b = call(self._system.closed_form.gyrostat, (), values)
        return w, b


def _nodes(K: Array) -> list[dict[str, Array]]:
    """The forms at the nodes of Gauss's rule and after the complete map."""
    return [forms(K * node) for node in [*NODE, 1]]


def _spread(constants: Mapping[str, Array]) -> dict[str, Array]:
    """Remainders for the samples of a motion."""
    return {k: np.expand_dims(v, v.ndim - FORMS.get(k, 1)) for k, v in constants.items()}


def remainders(
    M: Array, w: Array, b: Array, times: list[Fraction], oriented: bool
) -> tuple[list[np.longdouble], Array, Array]:
    """Times minus complete periods, at most half a period in size, from rationals; the rotation about M in these, if
    asked for; and where the motion has ended.

    That is if there is no period: such times are made so short that the motion is just about to end.
    """
    import mpmath

    ctx, never = mpmath.MPContext(), np.zeros(len(times), dtype=bool)
    square, Omega, none = algebra.dot(M, M), w * M - b, np.zeros(len(times), dtype=np.longdouble)
    longest = max(abs(t) for t in times)
    if not algebra.cross(M, Omega).any():  # it is still in the body, which rotates evenly
        spin = algebra.dot(Omega, Omega) if oriented else Fraction(0)
        ctx.dps = DIGITS + _figures(longest**2 * spin + 1)
        period = 4 * ctx.pi / ctx.sqrt(mp_number(ctx, spin)) if spin else None
        left = [_without(ctx, mp_number(ctx, t), period)[0] if spin else np.longdouble(0) for t in times]
        return left, none, never
    K = np.diag([*w, (algebra.dot(M, w * M) - 2 * algebra.dot(b, M)) / square])
    K[:3, 3], K[3, :3] = -b, b / square
    K = K - np.diag([K.trace() / 4] * 4)
    g2, g3 = invariants(*quartic(K))
    g2, g3 = g2 * square**2, g3 * square**3
    left = g2**3 - 27 * g3**2
    if left == 0:
        double = -3 * g3 / (2 * g2) if g2 else Fraction(0)
        if double >= 0:
            most = _settled(M, w, b, _wide(double)) if double else np.longdouble(np.inf)
            clipped = [np.clip(_wide(t), -most, most) for t in times]
            return clipped, none, abs(np.array(clipped)) == most
    small = abs(left) / (abs(g2) ** 3 + 27 * g3**2) if left else Fraction(1)
    ctx.dps = DIGITS + _figures(longest**4 * max(abs(g2), abs(g3)) + 1) + _figures(1 / small)
    g2, g3, left = (mp_number(ctx, x) for x in (g2, g3, left / 27))
    if left >= 0:
        root = ctx.sqrt(g2 / 3) * ctx.cos(ctx.atan2(ctx.sqrt(left), g3) / 3)
    else:
        cube_root = ctx.cbrt((abs(g3) + ctx.sqrt(-left)) / 8) * (1 if g3 >= 0 else -1)
        root = cube_root + g2 / (12 * cube_root)
    apart = ctx.sqrt(g2 - 3 * root * root) / 2 if left > 0 else 1j * ctx.sqrt(abs(3 * root * root - g2)) / 2
    period = 2 * ctx.re(ctx.elliprf(0, 1.5 * root - apart, 1.5 * root + apart))
    parts = [_without(ctx, mp_number(ctx, t), period) for t in times]
    counts = [count for _, count in parts]
    if oriented and any(counts):
        fastest = max(abs(g2 / 3) ** 0.25, abs(g3) ** (1 / ctx.mpf(6)))
        digits = TURN_DIGITS + _figures(max(abs(n) for n in counts))
        angle = turn_of_a_period(ctx, M, w, b, fastest, period, digits)
        none = np.array([_without(ctx, n * angle, 4 * ctx.pi)[0] for n in counts])
    return [remainder for remainder, _ in parts], none, never


def evenly(M: Array, w: Fraction, times: list[Fraction]) -> Array:
    """w |M| t minus complete rotations, two by two."""
    import mpmath

    ctx, square = mpmath.MPContext(), algebra.dot(M, M) * w * w
    ctx.dps = DIGITS + _figures(max(abs(t) for t in times) ** 2 * square)
    speed = ctx.sqrt(mp_number(ctx, square)) * (-1 if w < 0 else 1)
    return np.array([_without(ctx, speed * mp_number(ctx, t), 4 * ctx.pi)[0] for t in times])


def turn_of_a_period(ctx: Any, M: Array, w: Array, b: Array, fastest: Any, period: Any, digits: int) -> Any:
    """The rotation about M in a period, to so many digits: a mean over points of the period, doubled until it settles.

    The error falls exponentially with the points, so that of the next mean is the square of the last change.  Points
    lie around few of them; `fastest` is sqrt(max |e_i|).
    """
    M, w, b = (np.array([[mp_number(ctx, v) for v in x]], dtype=object) for x in (M, w, b))
    size = np.array([ctx.sqrt(algebra.dot(M, M)[0])], dtype=object)
    starts = max(3, math.ceil(float(period * fastest) / NEAR))
    falls = 9 * (2 * NEAR * starts / float(period * fastest)) ** 2  # of the terms of the series half-way between two
    orders = 4 + math.ceil(ctx.dps * math.log(10) / math.log(falls))
    curve = curve_of(M / algebra.vec(size), size, period / starts, w, b, orders)
    points = [curve.x]
    for _ in range(starts - 1):
        points.append(motion(curve._replace(x=points[-1]))(ctx.mpf(1)))
    x = np.concatenate(points)
    at = motion(curve._replace(x=x))

    ends = x.astype(float)
    e = max(DIRECTIONS, key=lambda e: (ends @ e).min() / math.sqrt(e @ e))
    e = e / ctx.sqrt(int(e @ e))

    def mean(first: int) -> Any:
        """Over `few` points about each start."""
        times = [[ctx.mpf(2 * k + first) / (2 * few) - 0.5] for k in range(few)]
        x = at(np.array(times, dtype=object)).reshape(-1, 3)
        return rate(e, x, algebra.vec(size), w, b).sum() / len(x)

    few = max(2, FEWEST // starts)
    coarse = mean(0)
    while True:
        fine = (coarse + mean(1)) / 2
        if abs(fine - coarse) * period < ctx.mpf(10) ** (-digits / 2 - 1):
            return fine * period
        few, coarse = 2 * few, fine


def _figures(x: Any) -> int:
    return len(str(int(x)))


def _without(ctx: Any, x: Any, period: Any) -> tuple[np.longdouble, int]:
    """x minus complete periods, and their number."""
    count = ctx.nint(x / period)
    return np.longdouble(ctx.nstr(x - period * count, 25)), int(count)


def _settled(M: Array, w: Array, b: Array, double: np.longdouble) -> np.longdouble:
    """The time after which a motion on a separatrix is still: SETTLED e-foldings, and those to leave the start."""
    growth = 2 * np.sqrt(3 * double)
    M, w, b = (_wides(x) for x in (M, w, b))
    away = algebra.magnitude(algebra.cross(M, w * M - b)) / (growth * algebra.magnitude(M))
    return (SETTLED + max(0, -np.log(away)) if away else 0 * growth) / growth


def _wide(x: Fraction) -> np.longdouble:
    high = float(x)
    return np.longdouble(high) + np.longdouble(float(x - Fraction(high)))


def _wides(x: Array) -> Array:
    return np.array([_wide(v) for v in x], dtype=np.longdouble)
