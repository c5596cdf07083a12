"""method="exact" of the gyrostat, n = 3, M' = M x (w M - b): the addition theorem of `kreisel.exact.quadrics`.

A step is a few equal maps, whose coefficients are found once a trajectory in extended precision; long ones are made
shorter by whole periods.  The orientation turns by g z(psi) p, p M(t) = M the shortest turn, z(psi) that about M by

    psi' = L Omega.(M + M(t))/(L^2 + M.M(t)),   Omega = w M(t) - b,

which is integrated by Gauss's rule at points of the motion.  The turn of a map is linear in the state half-way; the
matrix is fitted to those, and a step takes forms for it too.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from fractions import Fraction

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.errors import InputError
from kreisel.exact.nutation import rationals
from kreisel.exact.quadrics import BELOW, FORMS, change, coefficients, curve, forms, invariants, length, moved, quartic
from kreisel.exact.turning import turn
from kreisel.method.observing import observer, with_orientation
from kreisel.method.scheme import Orbits, Scheme, States, Steps
from kreisel.record.calling import call
from kreisel.record.contract import System
from kreisel.record.model import Model

FAR = 6  # maps in a step, beyond which whole periods are left out
CORRECTIONS = 3
NODES, SAMPLES = 8, 64  # of Gauss's rule; points of a motion, 0.4 e-foldings apart at most
MOST_TURN, MOST_MAPS = 6.0, 4096  # radians of a map with orientation; maps of a step
SETTLED = 22.0  # e-foldings, after which a motion without a period stands still
DIGITS = 40  # of a period, beyond those that close roots and long times use up

NODE, WEIGHT = np.polynomial.legendre.leggauss(NODES)
TURN = {"turn_" + k: v for k, v in FORMS.items()}  # of the vector of a quaternion
LEAN = {"lean_" + k: max(0, v - 1) for k, v in FORMS.items()}  # and of its scalar
AXES = {**FORMS, **BELOW, **TURN, **LEAN, "size": 0, "inverse": 0, "still": 0}


def gyrostat(model: Model, dt: float, oriented: bool) -> Scheme:
    """The exact flow of a body with a wheel; see the module."""
    observe, outcomes = observer(model, None, None, ("casimir", "energy"), oriented=oriented)
    letters = [p.letter for p in model.system.parameters]

    def trajectory(x0: tuple[Array, ...]) -> tuple[dict[str, Array], dict[str, Array]]:
        body = Body(algebra.axial(x0[0]), {k: model.constants[k] for k in letters}, model.system, oriented)
        time = np.full(body.L.shape, dt, dtype=np.longdouble)
        if not oriented:
            for lane in np.argwhere(body.speed * dt > FAR):
                (time[tuple(lane)],), _ = body.remainders(tuple(lane), [Fraction(dt)])
        known, stage, maps = body.numbers(time)
        stages = {k: np.repeat(np.expand_dims(v.astype(float), time.ndim), maps, time.ndim) for k, v in stage.items()}
        return {k: v.astype(float) for k, v in known.items()}, stages

    return Scheme(
        name="exact",
        components=with_orientation(model, oriented),
        constants=dict(model.constants),
        axes={**model.axes, **AXES},
        n=3,
        prepare=tuple,
        motion=Steps(step, iterates=Orbits(_orbit(model, oriented))),
        observe=observe,
        reopen=tuple,
        outcomes=outcomes,
        trajectory=trajectory,
    )


def step(M: Array, *g: Array, size: Array, inverse: Array, **known: Array) -> tuple[Array, ...]:
    """The state after one map."""
    x = algebra.axial(M) * algebra.vec(inverse)
    step = change(x, known)
    new = x + step
    return M + algebra.hat(step * algebra.vec(size)), *(turned(x, new, q, known) for q in g)


def turned(x: Array, y: Array, g: Array, known: Mapping[str, Array]) -> Array:
    """The orientation after one map, from x = M/L to y: of what the forms say, the part that carries x to y."""
    squares, products = x * x, x[..., algebra.SECOND] * x[..., algebra.THIRD]
    turn = algebra.act(known["turn_squares"], squares) + algebra.act(known["turn_products"], products)
    turn = turn + algebra.act(known["turn_linear"], x) + known["turn_fixed"]
    lean = algebra.dot(known["lean_squares"], squares) + algebra.dot(known["lean_products"], products)
    q = _quaternion(lean + algebra.dot(known["lean_linear"], x) + known["lean_fixed"], turn)
    shortest, half = lift(x, y), _quaternion(0 * lean, x + y)
    carrying = algebra.vec(algebra.dot(q, shortest)) * shortest + algebra.vec(algebra.dot(q, half)) * half
    q = carrying + algebra.vec(known["still"]) * (q - carrying)
    return algebra.unit(algebra.quaternion_product(g, q))


def _quaternion(scalar: Array, vector: Array) -> Array:
    return np.concatenate([algebra.vec(scalar) + 0 * vector[..., :1], vector], -1)


def lift(x: Array, y: Array) -> Array:
    """The shortest turn q that carries y to x, q y q^-1 = x, of unit vectors; not of unit length."""
    return _quaternion(1 + algebra.dot(x, y), algebra.cross(y, x))


class Body:
    """Motions through M (..., 3), in extended precision; `speed` is the number of maps in a unit of time."""

    def __init__(self, M: Array, parameters: Mapping[str, Array], system: System, oriented: bool):
        self.M, self._parameters, self._system, self._oriented = M, parameters, system, oriented
        wide = {k: np.asarray(v, dtype=np.longdouble) for k, v in parameters.items()}
        self.x, self.w, self.b = np.broadcast_arrays(M.astype(np.longdouble), *call(system.gyrostat, (), wide))
        with np.errstate(all="ignore"):
            self.L, self._K = curve(self.x, self.w, self.b)
            self.speed = length(self._K)
            if oriented:
                fastest = abs(self.w * self.x).sum(-1) + abs(self.b).sum(-1)
                self.speed = 2 * np.maximum(self.speed, fastest / MOST_TURN)
        if not np.isfinite(self.speed).all():
            raise InputError("The powers of the state and the parameters leave the range of doubles. Use other units.")
        self.inverse = 1 / (self.L + (self.L == 0))

    def numbers(self, time: Array) -> tuple[dict[str, Array], dict[str, Array], int]:
        """What `step` takes for these times, constants of the motion and of a map, and the number of maps."""
        most = float(np.max(self.speed * abs(time)))
        if most > MOST_MAPS:
            raise InputError(
                f"Expected a time of at most {MOST_MAPS} maps, got {most:.3g} of them. Usual cause: a long time with "
                "the orientation, where whole periods are not left out. Use shorter times, or no orientation."
            )
        maps = max(1, math.ceil(most))
        part = time / maps
        K = self._K * algebra.mat(part)
        known, stage = {"size": self.L, "inverse": self.inverse}, forms(K)
        if self._oriented:
            known["still"] = 1.0 * (self.L == 0)
            found = coefficients(self._turn(K, part))
            stage |= {f"turn_{k}": v[..., 1:, :] if v.ndim > K.ndim - 1 else v[..., 1:] for k, v in found.items()}
            stage |= {f"lean_{k}": v[..., 0, :] if v.ndim > K.ndim - 1 else v[..., 0] for k, v in found.items()}
        return known, stage, maps

    def _turn(self, K: Array, part: Array) -> Array:
        """Forms of the quaternion of a map: those of the state at half the time, taken to it by a matrix.

        |matrix X|^2 is the form of the denominator; the matrix is fitted to turns along the motion.
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
        want = self._turns(start, K, part) * algebra.vec(np.sqrt(square))
        inverse = np.linalg.pinv(middle.astype(float), rcond=1e-14)
        matrix = np.zeros((*K.shape[:-2], 4, 4), dtype=K.dtype)
        for _ in range(CORRECTIONS):  # corrected by what is left, in more digits than those of the inverse
            matrix = matrix + inverse @ (want - middle @ matrix)
        return (matrix.mT[..., None, None] * half[..., None, :, :, :]).sum(-3)

    def _turns(self, x: Array, K: Array, part: Array) -> Array:
        """The quaternions of a map from each x (..., SAMPLES, 3), by Gauss's rule."""
        size, w, b = (v[..., None, :] for v in (algebra.vec(self.L), self.w, self.b))
        angle = np.zeros(x.shape[:-1], dtype=x.dtype)
        for node, weight in zip((1 + NODE) / 2, WEIGHT / 2, strict=True):
            there = x + change(x, _spread(forms(K * np.longdouble(node))))
            rate = algebra.dot(w * size * there - b, x + there) / (1 + algebra.dot(x, there))
            angle = angle + np.longdouble(weight) * rate
        rest = -b * (size == 0)  # M = 0: the body turns against its wheel
        z = turn((algebra.vec(angle) * x + rest) * part[..., None, None])
        return algebra.unit(algebra.quaternion_product(z, lift(x, x + change(x, _spread(forms(K))))))

    def at_rest(self, M: Array) -> Array:
        """The momentum at rest that is nearest, M x (w M - b) = 0, of one lane."""
        for _ in range(CORRECTIONS):
            Omega = self.w * M - self.b
            slopes = np.concatenate([algebra.hat(M) * self.w - algebra.hat(Omega), M[None]]).astype(float)
            lack = np.append(algebra.cross(M, Omega), (M @ M - self.L**2) / 2)
            M = M - np.linalg.lstsq(slopes, lack.astype(float), rcond=None)[0]
        return M

    def remainders(self, lane: tuple[int, ...], times: list[Fraction]) -> tuple[list[np.longdouble], Array]:
        """`remainders` of one lane, from the numbers as they are given."""
        given = {k: rationals(np.broadcast_to(v, self.x.shape)[lane]) for k, v in self._parameters.items()}
        w, b = call(self._system.gyrostat, (), given)
        return remainders(rationals(self.M[lane]), w, b, times)


def _spread(known: Mapping[str, Array]) -> dict[str, Array]:
    """The same for the samples of a motion."""
    return {k: np.expand_dims(v, v.ndim - FORMS.get(k, 1)) for k, v in known.items()}


def _orbit(model: Model, oriented: bool) -> Callable[..., States]:
    letters = [p.letter for p in model.system.parameters]

    def orbit(z0: tuple[Array, ...], given: Mapping[str, Array], reach: float) -> States:
        body = Body(algebra.axial(z0[0]), {k: given[k] for k in letters}, model.system, oriented)

        def states(mantissa: Array, exponent: Array) -> tuple[Array, ...]:
            times = [Fraction(int(m)) * Fraction(2) ** int(e) for m, e in zip(mantissa, exponent, strict=True)]
            left, ended = [np.longdouble(float(t)) for t in times], [False]
            if not oriented:
                left, ended = body.remainders((), times)
            known, stage, maps = body.numbers(np.array(left))
            z = tuple(v + np.zeros((len(left), *v.shape), dtype=np.longdouble) for v in z0)
            for _ in range(maps):
                z = step(*z, **{**known, **stage})
            M = algebra.axial(z[0])
            for k in np.flatnonzero(ended):
                M[k] = body.at_rest(M[k])
            return algebra.hat(M.astype(float)), *(v.astype(float) for v in z[1:])

        return states

    return orbit


def remainders(M: Array, w: Array, b: Array, times: list[Fraction]) -> tuple[list[np.longdouble], Array]:
    """Times less whole periods, at most half a period in size, from rationals; and where the motion has ended.

    That is where there is no period: such times are made so short that the motion is just about to end.
    """
    import mpmath

    square = algebra.dot(M, M)
    if square == 0:
        return [np.longdouble(0)] * len(times), np.zeros(len(times), dtype=bool)
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
            return clipped, abs(np.array(clipped)) == most
    ctx = mpmath.MPContext()
    longest = max(abs(t) for t in times) ** 4 * max(abs(g2), abs(g3)) + 1
    small = abs(left) / (abs(g2) ** 3 + 27 * g3**2) if left else Fraction(1)
    ctx.dps = DIGITS + sum(len(str(int(x))) for x in (longest, 1 / small))
    g2, g3, left = (ctx.mpf(x.numerator) / x.denominator for x in (g2, g3, left / 27))
    if left >= 0:
        root = ctx.sqrt(g2 / 3) * ctx.cos(ctx.atan2(ctx.sqrt(left), g3) / 3)
    else:
        part = ctx.cbrt((abs(g3) + ctx.sqrt(-left)) / 8) * (1 if g3 >= 0 else -1)
        root = part + g2 / (12 * part)
    apart = ctx.sqrt(g2 - 3 * root * root) / 2 if left > 0 else 1j * ctx.sqrt(abs(3 * root * root - g2)) / 2
    period = 2 * ctx.re(ctx.elliprf(0, 1.5 * root - apart, 1.5 * root + apart))
    exactly = [ctx.mpf(t.numerator) / t.denominator for t in times]
    left = [np.longdouble(ctx.nstr(t - period * ctx.nint(t / period), 25)) for t in exactly]
    return left, np.zeros(len(times), dtype=bool)


def _settled(M: Array, w: Array, b: Array, double: np.longdouble) -> np.longdouble:
    """The time after which a motion on a separatrix stands still: SETTLED e-foldings, and those to leave the start."""
    growth = 2 * np.sqrt(3 * double)
    M, w, b = (np.array([_wide(v) for v in x], dtype=np.longdouble) for x in (M, w, b))
    away = algebra.magnitude(algebra.cross(M, w * M - b)) / (growth * algebra.magnitude(M))
    return (SETTLED + max(0, -np.log(away)) if away else 0 * growth) / growth


def _wide(x: Fraction) -> np.longdouble:
    high = float(x)
    return np.longdouble(high) + np.longdouble(float(x - Fraction(high)))
