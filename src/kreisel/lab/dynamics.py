"""Orbits of a map in floats: Lyapunov's exponents, SALI and GALI from the tangent map, frequencies, sections.

exponents   lim log |Dphi^k v| / k of k vectors, kept apart by QR     [Benettin et al., Meccanica 15 (1980)]
GALI_j      volume of the box of j unit tangent vectors; SALI the smaller of |v + w|, |v - w| for j = 2.  On a
            regular orbit they fall like a power of the step at most, on a chaotic one like
            exp(-(sum of differences of exponents) k)
            [Skokos, J. Phys. A 34 (2001); Skokos, Bountis, Antonopoulos, Physica D 231 (2007)]
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from kreisel.algebra import Array, floats
from kreisel.errors import InputError, RunError, explained, shown
from kreisel.graph.graph import Graph, TooLong
from kreisel.kernels.adjoint import Code, recorded
from kreisel.lab.subject import Subject, float_start

EVERY = (10, 3, 1)  # steps between two orthogonalizations: fewer if the vectors come too close in them
RESOLVED = 23.0  # logarithm of the ratio of lengths that a QR decomposition resolves to 1e-6
PARTS = 10  # of an orbit, for the uncertainty of an exponent
FEWEST = 100 * PARTS  # steps of an orbit
ALIGNED = 1e-12  # SALI below which two vectors are one, but for rounding
CLEAR = 5.0  # exponents above CLEAR log(T)/T do not belong to a regular orbit
FURTHEST = 1e8  # an orbit beyond it has escaped
MOST_NODES = 20_000  # of a step
NEIGHBOURS = 8  # iterates on each side in the interpolation of a section


@dataclass(frozen=True)
class Dynamics:
    """Exponents and alignment indices of one orbit of `steps` steps from `start`.

    exponents     per step, the largest first; `errors` their spread over the parts of the orbit
    sali          the smallest SALI, and the step at which it was reached
    gali          the last GALI_j, j = 2, 3, ...
    """

    start: Array
    steps: int
    exponents: Array
    errors: Array
    sali: float
    reached: int
    gali: Array

    @property
    def threshold(self) -> float:
        """Exponents of regular orbits are of the order log(T)/T."""
        return CLEAR * math.log(self.steps) / self.steps

    @property
    def chaotic(self) -> bool:
        """Two tangent vectors became one, and the largest exponent is beyond the threshold and its error."""
        first = float(self.exponents[0])
        return self.sali < ALIGNED and first > max(self.threshold, 3 * float(self.errors[0]))

    @property
    def regular(self) -> bool:
        """The largest exponent is as small as for a regular orbit, and the tangent vectors stay apart."""
        return self.sali > ALIGNED and float(self.exponents[0]) < self.threshold

    @property
    def word(self) -> str:
        return "chaotic" if self.chaotic else "regular" if self.regular else "unknown"

    def __str__(self) -> str:
        shown = ", ".join(f"{v:.2g}" for v in self.exponents)
        return (
            f"{self.word}: exponents a step {shown} (+- {self.errors[0]:.1g} of the first) over {self.steps:,} steps, "
            f"SALI {self.sali:.1e} at step {self.reached:,}"
        )


Pushed = Callable[[Array, Array, int, int], tuple[Array, Array]]  # x, vectors, steps, rows -> points, vectors


def _start(subject: Subject, x: Any, seed: int = 0) -> Array:
    """The point x (d,) in floats, a random one for None.  Raises `InputError`."""
    start = float_start(subject, seed) if x is None else floats(x)
    if start.shape != (subject.dim,) or not np.isfinite(start).all():
        raise InputError(f"A start is {subject.dim} finite values, {', '.join(subject.names)}, got {shown(x)}.")
    return start


class CompiledOrbit:
    """A compiled step at a point x (d,), with tangent vectors (k, d) along, which may be set."""

    def __init__(self, subject: Subject, x: Array, vectors: Array | None = None):
        self.subject, start = subject, _start(subject, x)
        self._x, self.vectors = start.copy(), np.zeros((0, subject.dim)) if vectors is None else vectors
        by_jax = subject.model is not None and subject.model.system.numbers == "jax"
        self._pushed = _by_jax(subject) if by_jax else _by_kernels(subject)

    def advance(self, steps: int, rows: int = 1) -> Array:
        """`rows` points (rows, d), `steps` steps apart.  Raises `RunError` where the orbit escapes."""
        points, self.vectors = self._pushed(self._x, self.vectors, steps, rows)
        if not (np.abs(points) < FURTHEST).all():
            raise RunError(f"The orbit of {self.subject.name} escapes, or meets a pole. Choose another start.")
        self._x = points[-1].copy()
        return points


def _by_kernels(subject: Subject) -> Pushed:
    """By the kernels of the recorded step: states, and the tangent map if there are vectors."""
    scalars = {k: float(v) for k, v in subject.floats.items() if np.ndim(v) == 0}
    fixed = {k: v for k, v in subject.floats.items() if np.ndim(v) > 0}
    inputs = zip(scalars, Graph().inputs("c", len(scalars)), strict=True)

    def formula(x: Array, **constants: Array) -> tuple[Array]:
        try:
            return (np.asarray(subject.step(x, **fixed, **constants), dtype=object),)
        except (TypeError, AttributeError) as error:
            raise InputError(
                f"The step of {subject.name} could not be recorded: {error}. It must be a formula in + - * /, whole "
                "powers, sqrt, sin, cos, exp and log, without branches."
            ) from error

    constants = {k: np.array(c, dtype=object) for k, c in inputs}
    try:
        step = recorded(formula, [f"R^{subject.dim}"], 3, constants, MOST_NODES)
    except TooLong:
        step = None
    if step is None or step.graph.loops:
        raise InputError(
            f"The step of {subject.name} could not be recorded: expected a formula of at most {MOST_NODES:,} "
            "operations, without a loop, got a longer one."
        )
    code, values = Code([step], len(scalars), 0), (np.array([[*scalars.values()]]), np.zeros((1, 1, 0)))

    def pushed(x: Array, vectors: Array, steps: int, rows: int) -> tuple[Array, Array]:
        start, count = (x[None], *values), len(vectors)
        points = code.marks(*start, rows, steps, steps)[0]
        if count:
            none = np.zeros((1, count, 0)), np.zeros((1, count, 1, 0))
            vectors = code.pushed(*start, vectors[None], *none, rows, steps)[0, :, -1]
        return points, vectors

    return pushed


def _by_jax(subject: Subject) -> Pushed:
    """By JAX: the step with its derivative along the vectors."""
    from kreisel.reduction.numerics import double

    step, constants = _pushed_by_jax(subject.step), subject.floats

    def pushed(x: Array, vectors: Array, steps: int, rows: int) -> tuple[Array, Array]:
        points = np.empty((rows, len(x)))
        with double():
            for row in range(rows):
                x, vectors = map(np.asarray, step(x, vectors, constants, steps))
                points[row] = x
        return points, vectors

    return pushed


@lru_cache(16)
def _pushed_by_jax(step: Callable[..., Array]) -> Callable[..., tuple[Array, Array]]:
    """Steps from x (d,) with tangent vectors (k, d) along; the function is the same for one step: compiled once."""
    from kreisel.reduction.numerics import jax

    def moved(x: Array, vectors: Array, constants: dict[str, Array]) -> tuple[Array, Array]:
        def formula(y: Array) -> Array:
            return step(y, **constants)

        if not len(vectors):
            return formula(x), vectors
        return jax.vmap(lambda v: jax.jvp(formula, (x,), (v,)), out_axes=(None, 0))(vectors)  # one root for all

    def pushed(x: Array, vectors: Array, constants: dict[str, Array], steps: int) -> tuple[Array, Array]:
        return jax.lax.fori_loop(0, steps, lambda _, state: moved(state[0], state[1], constants), (x, vectors))

    return jax.jit(pushed)


def tangents(subject: Subject, x: Array, count: int | None, seed: int = 0) -> Array:
    """Random orthonormal tangent vectors (k, d) at x: as many as the phase space has dimensions, or `count`."""
    vectors, free = np.random.default_rng([seed, 7]).normal(size=(subject.dim, subject.dim)), subject.dim
    if subject.model is not None and subject.model.system.space.constraints:
        pi = np.asarray(subject.tensor(x), dtype=float) if subject.tensor is not None else np.eye(subject.dim)
        left, sizes, _ = np.linalg.svd(pi)
        basis = left[:, sizes > 1e-9 * sizes[0]]
        vectors, free = (vectors @ basis) @ basis.T, basis.shape[1]
    return np.linalg.qr(vectors.T)[0][:, : min(free, count or free)].T


@explained
def dynamics(
    subject: Subject, x: Array | None = None, steps: int = 10_000, *, count: int | None = None, seed: int = 0
) -> Dynamics:
    """Exponents, SALI and GALI along one orbit from x (by default a random point of size 1).

    Raises `InputError` for a step that cannot be recorded, and `RunError` for orbits that escape.
    """
    if steps < FEWEST:
        raise InputError(f"steps must be {FEWEST} or more, got {steps}.")
    x = _start(subject, x, seed)
    frame = tangents(subject, x, count, seed)
    apart = tangents(subject, x, None if count is None else max(2, count), seed + 1)  # these are only scaled
    vectors = np.concatenate([frame, apart])
    for every in EVERY:
        logs, free, sali, reached = _stretched(CompiledOrbit(subject, x, vectors), len(frame), steps, every)
        if np.ptp(logs[-1]) <= RESOLVED:
            break
    gali = np.full(max(0, len(apart) - 1), np.nan)
    for j in range(2, len(apart) + 1):
        gali[j - 2] = float(np.prod(np.linalg.svd(free[:j], compute_uv=False)))
    logs = logs[len(logs) // 10 :]  # the vectors rotate into place first
    rates = np.array([rows.sum(0) / (every * len(rows)) for rows in np.array_split(logs, PARTS)])
    exponents = logs.sum(0) / (every * len(logs))
    order = np.argsort(-exponents, kind="stable")
    errors = rates.std(0, ddof=1) / math.sqrt(PARTS)
    return Dynamics(x, steps, exponents[order], errors[order], sali, reached, gali)


def _stretched(orbit: CompiledOrbit, k: int, steps: int, every: int) -> tuple[Array, Array, float, int]:
    """Logarithms (times, k) of the lengths of k vectors, orthogonalized each time; the others; SALI and its step.

    Ends early if an orthogonalization lost the shortest vector.
    """
    logs, free, sali, reached = [], orbit.vectors[k:], 2.0, 0
    for done in range(every, steps + 1, every):
        orbit.advance(every)
        lengths = np.linalg.norm(orbit.vectors, axis=1)
        if not (np.isfinite(lengths).all() and lengths.all()):
            raise RunError(
                f"Tangent vectors along the orbit of {orbit.subject.name} vanish or overflow at step {done}. Usual "
                "cause: it ends at a point where the derivative is 0, or comes close to a pole. Choose another start."
            )
        Q, R = np.linalg.qr(orbit.vectors[:k].T)
        logs.append(np.log(np.abs(np.diag(R)) + 1e-300))
        if every > EVERY[-1] and np.ptp(logs[-1]) > RESOLVED:  # the shortest vectors are rounding errors
            break
        free = orbit.vectors[k:] / lengths[k:, None]
        if len(free) > 1:
            near = min(np.linalg.norm(free[0] + free[1]), np.linalg.norm(free[0] - free[1]))
            if near < sali:
                sali, reached = float(near), done
        orbit.vectors = np.concatenate([Q.T, free])
    return np.array(logs), free, sali, reached


def several(subject: Subject, steps: int, orbits: int, seed: int = 0) -> tuple[list[Dynamics], str]:
    """The orbits from random points that do not escape, and why another did."""
    bounded, trouble = [], ""
    slow = subject.model is not None and subject.model.system.numbers == "jax"  # each step a root, found anew
    for k in range(orbits):
        try:
            bounded.append(dynamics(subject, steps=steps, count=1 if slow else None, seed=seed + 10 * k))
        except RunError as error:
            trouble = str(error)
    return bounded, trouble


def points(subject: Subject, x: Array | None = None, steps: int = 4096, seed: int = 0) -> Array:
    """The orbit (steps + 1, d)."""
    x = _start(subject, x, seed)
    return np.concatenate([x[None], CompiledOrbit(subject, x).advance(1, steps)])


@explained
def frequencies(subject: Subject, x: Array | None = None, steps: int = 4096, lines: int = 6, seed: int = 0) -> Any:
    """Angular frequencies a step of a generic function along the orbit: `kreisel.analysis.frequencies.Lines`."""
    from kreisel.analysis.frequencies import lines_of

    orbit = points(subject, x, steps, seed)
    weights = np.random.default_rng([seed, 3]).uniform(0.5, 1.5, subject.dim)
    return lines_of(np.arange(len(orbit), dtype=float), (orbit - orbit.mean(0)) @ weights, lines)


@explained
def section(
    subject: Subject,
    f: Callable[[Array], Array],
    x: Array | None = None,
    steps: int = 4096,
    *,
    rising: bool | None = True,
    seed: int = 0,
) -> tuple[Array, Array]:
    """Poincare's section f = 0 of the curve on which the iterates lie: times (in steps) and points (count, d).

    The curve is that of the interpolating flow of the map itself, not of the system that it discretizes: the
    polynomial through 2 NEIGHBOURS iterates.  f needs points (..., d).  Near-identity maps only: where the iterates
    are so far apart that two polynomials, of NEIGHBOURS and of one fewer on each side, differ, it states so.
    """
    from scipy.interpolate import BarycentricInterpolator
    from scipy.optimize import brentq

    orbit = points(subject, x, steps, seed)
    value = np.asarray(f(orbit))
    if value.shape != (len(orbit),):
        raise InputError(f"f must give one number a point, {(len(orbit),)}, got shape {value.shape}.")
    up, down = (value[:-1] < 0) & (value[1:] >= 0), (value[:-1] > 0) & (value[1:] <= 0)
    wanted = up | down if rising is None else up if rising else down
    times, places, worst = [], [], 0.0
    for k in np.nonzero(wanted)[0]:
        if not NEIGHBOURS <= k < len(orbit) - NEIGHBOURS:
            continue
        nodes = (np.arange(1 - m, m + 1) for m in (NEIGHBOURS, NEIGHBOURS - 1))
        curve, check = (BarycentricInterpolator(near, orbit[k + near]) for near in nodes)
        t = float(brentq(lambda s, curve=curve: float(f(curve(s)[None])[0]), 0.0, 1.0, xtol=1e-15))
        times.append(k + t)
        places.append(curve(t))
        worst = max(worst, float(np.abs(curve(t) - check(t)).max()))
    if worst > 1e-6:
        raise InputError(
            f"The iterates of {subject.name} are too far apart for a curve through them (it is known to {worst:.1g}). "
            "Use a smaller step."
        )
    return np.array(times), np.array(places).reshape(-1, subject.dim)
