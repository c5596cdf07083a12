"""The problems of perturbed.py as plain equations, for values of every kind, and the peers that integrate them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from importlib.util import find_spec
from typing import Any, NamedTuple

import numpy as np

MOST = 10**7  # steps of diffrax


class Functions(NamedTuple):
    """sin and cos of a kind of number."""

    sin: Callable[[Any], Any]
    cos: Callable[[Any], Any]


class Solved(NamedTuple):
    """A peer at one tolerance: a run to the end, of `lanes` trajectories, and the evaluations that it needs."""

    label: str
    go: Callable[[], np.ndarray]
    lanes: int
    evaluations: Callable[[], int | None]


Rate = Callable[[Any, list[Any], Functions], list[Any]]


def cross(x: Any, y: Any) -> list[Any]:
    return [x[1] * y[2] - x[2] * y[1], x[2] * y[0] - x[0] * y[2], x[0] * y[1] - x[1] * y[0]]


def added(*vectors: list[Any]) -> list[Any]:
    return [sum(entries[1:], entries[0]) for entries in zip(*vectors, strict=True)]


def heavy_top(moments: Any, axis: Any) -> Rate:
    """M' = M x W + P x A, P' = P x W, W = M/I."""

    def rate(t: Any, y: list[Any], f: Functions) -> list[Any]:
        M, P = y[:3], y[3:]
        W = [m / float(i) for m, i in zip(M, moments, strict=True)]
        return [*added(cross(M, W), cross(P, [float(a) for a in axis])), *cross(P, W)]

    return rate


def in_orbit(moments: Any, rate_of_orbit: float, e: float) -> Rate:
    """M' = M x W + 3 (n^2/r^5) r x I r, q' = q W/2, with the direction r of the planet in the body, (7,) = (M, q)."""
    inertia = [float(i) for i in moments]

    def rate(t: Any, y: list[Any], f: Functions) -> list[Any]:
        M, (w, a, b, c) = y[:3], y[3:]
        W = [m / i for m, i in zip(M, inertia, strict=True)]
        u = t * rate_of_orbit
        if e:
            E = u + e * f.sin(u)
            for _ in range(3):
                E = E - (E - e * f.sin(E) - u) / (1 - e * f.cos(E))
            x, z, far = f.cos(E) - e, (1 - e * e) ** 0.5 * f.sin(E), 1 - e * f.cos(E)
        else:
            x, z, far = f.cos(u), f.sin(u), 1.0
        first = [1 - 2 * (b * b + c * c), 2 * (a * b - w * c), 2 * (a * c + w * b)]  # rows of g
        second = [2 * (a * b + w * c), 1 - 2 * (a * a + c * c), 2 * (b * c - w * a)]
        r = [x * p + z * q for p, q in zip(first, second, strict=True)]
        size = 3 * rate_of_orbit**2 / (far * far * far * far * far)
        turn = [size * v for v in cross(r, [i * v for i, v in zip(inertia, r, strict=True)])]
        X, Y, Z = (v / 2 for v in W)
        spin = [-a * X - b * Y - c * Z, w * X + b * Z - c * Y, w * Y + c * X - a * Z, w * Z + a * Y - b * X]
        return [*added(cross(M, W), turn), *spin]

    return rate


def coupled_tops(k: float) -> Rate:
    """m_i' = p x a_i + k a_i x a_j, a_i' = m_i x a_i, (12,) = (m_1, a_1, m_2, a_2)."""

    def rate(t: Any, y: list[Any], f: Functions) -> list[Any]:
        out = []
        for here, there in ((0, 6), (6, 0)):
            m, a, b = y[here : here + 3], y[here + 3 : here + 6], y[there + 3 : there + 6]
            out += [*added([-a[1], a[0], 0 * a[0]], [k * v for v in cross(a, b)]), *cross(m, a)]
        return out

    return rate


def peers(rate: Rate, start: np.ndarray, end: float, tolerances: tuple[float, ...], batches: bool) -> Iterator[Solved]:
    """Those that are installed, at every tolerance."""
    for tolerance in tolerances:
        if find_spec("heyoka"):
            yield heyoka_single(rate, start, end, tolerance)
            if batches:
                yield heyoka_batch(rate, start, end, tolerance)
        if find_spec("diffrax"):
            yield diffrax(rate, start, end, tolerance)


def _equations(rate: Rate, start: np.ndarray) -> Any:
    import heyoka as hy

    names = hy.make_vars(*[f"y{i}" for i in range(len(start))])
    rates = rate(hy.time, list(names), Functions(hy.sin, hy.cos))
    return [(name, value + 0.0 * names[0]) for name, value in zip(names, rates, strict=True)]


def heyoka_single(rate: Rate, start: np.ndarray, end: float, tolerance: float) -> Solved:
    import heyoka as hy

    engine = hy.taylor_adaptive(_equations(rate, start), start.tolist(), tol=tolerance)

    def go() -> np.ndarray:
        engine.time, engine.state[:] = 0.0, start
        engine.propagate_until(end)
        return engine.state.copy()

    return Solved("heyoka", go, 1, lambda: None)


def by_long_doubles(rate: Rate, start: np.ndarray, end: float) -> np.ndarray:
    """The state at the end by heyoka in 80-bit floats."""
    import heyoka as hy

    wide = np.longdouble
    engine = hy.taylor_adaptive(_equations(rate, start), start.astype(wide), fp_type=wide, tol=wide(1e-19))
    engine.propagate_until(wide(end))
    return np.array(engine.state, dtype=np.float64)


def heyoka_batch(rate: Rate, start: np.ndarray, end: float, tolerance: float) -> Solved:
    import heyoka as hy

    lanes = hy.recommended_simd_size()
    many = np.repeat(start[:, None], lanes, 1)
    engine = hy.taylor_adaptive_batch(_equations(rate, start), many.copy(), tol=tolerance)

    def go() -> np.ndarray:
        engine.set_time(0.0)
        engine.state[:] = many
        engine.propagate_until(end)
        return engine.state[:, 0].copy()

    return Solved("heyoka batch", go, lanes, lambda: None)


def diffrax(rate: Rate, start: np.ndarray, end: float, tolerance: float) -> Solved:
    """Dopri8 with a PID controller: 13 evaluations a step."""
    import diffrax as dfx
    import jax

    jax.config.update("jax_enable_x64", True)
    np_of_jax = jax.numpy

    def field(t: Any, y: Any, _: Any) -> Any:
        return np_of_jax.stack(rate(t, list(y), Functions(np_of_jax.sin, np_of_jax.cos)))

    @jax.jit
    def solve(y0: Any) -> Any:
        found = dfx.diffeqsolve(
            dfx.ODETerm(field),
            dfx.Dopri8(),
            t0=0.0,
            t1=end,
            dt0=None,
            y0=y0,
            stepsize_controller=dfx.PIDController(rtol=tolerance, atol=tolerance),
            saveat=dfx.SaveAt(t1=True),
            max_steps=MOST,
            throw=False,
        )
        return found.ys[0], found.stats["num_steps"]

    return Solved("diffrax Dopri8", lambda: np.asarray(solve(start)[0]), 1, lambda: 13 * int(solve(start)[1]))
