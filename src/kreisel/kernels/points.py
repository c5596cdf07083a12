"""Constants rho of trajectories, compiled for double-doubles: the same for every processor and number of lanes."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.algebra.complex import Complex
from kreisel.algebra.reuse import reused
from kreisel.graph.double import DoubleDouble
from kreisel.graph.graph import Graph, TooLong
from kreisel.graph.machine import Kernel, address_of
from kreisel.graph.recording import as_operands, count_of, flat_constants, operation_count, recorded_arguments
from kreisel.kernels.stepped import SteppedEngine
from kreisel.kernels.steps import outputs_by_rows
from kreisel.method.scheme import Scheme

MOST = 4000  # operations; of a pair of the Lagrange top, n = 3: 2300
FOLDED = (0.0, 1.0, -1.0)  # into the code of a step


def compiled_point(scheme: Scheme, columns: Mapping[str, slice], pair: bool) -> Kernel | None:
    """kernel(mu, z, c, out, points, lanes): mu and rho (points, lanes, 4 or 2) by mu (points, lanes, 2 or 1).

    None if the definition cannot be recorded, or is too long.
    """

    def make() -> tuple[Kernel | None]:
        point: Any = scheme.point
        graph, wide = Graph(4 * MOST), np.frompyfunc(DoubleDouble, 1, 1)
        state, constants = recorded_arguments(scheme, graph, {"c": columns})
        mu = graph.inputs("s", 1 + pair)
        x = Complex(*map(DoubleDouble, mu)) if pair else DoubleDouble(*mu)
        try:
            rho = point(*map(wide, state), mu=x, **{name: wide(value) for name, value in constants.items()})
            outputs = as_operands([*mu, *(v.upper for v in ((rho.re, rho.im) if pair else (rho,)))])
        except (TypeError, AttributeError, ValueError, TooLong):  # by LAPACK
            return (None,)
        if operation_count(graph, outputs) > MOST:
            return (None,)
        count = algebra.coordinate_count(scheme.kinds, scheme.n)
        inputs = {"s": (1 + pair, True), "z": (count, False), "c": (count_of(columns), False)}
        return (outputs_by_rows(graph, outputs, inputs),)

    return reused(None if scheme.kernel_key is None else (compiled_point, scheme.kernel_key, pair), make)[0]


def points(scheme: Scheme, x0: tuple[Array, ...], mus: Array) -> Array | None:
    """rho (..., points) from states and orientations x0, not finite if there is none; None if it is not compiled."""
    z = np.ascontiguousarray(algebra.flatten(x0, scheme.kinds), dtype=np.float64)
    lead, lanes = z.shape[:-1], math.prod(z.shape[:-1])
    c, columns = flat_constants(scheme, lanes)
    kernel = compiled_point(scheme, columns, np.iscomplexobj(mus))
    if kernel is None:
        return None
    mu = np.repeat(mus, lanes)
    out = np.empty((len(mus), lanes, 2), mus.dtype)
    numbers = (x.view(np.float64) for x in (mu, z, c, out))
    kernel(*map(address_of, numbers), len(mus), lanes)
    return np.moveaxis(out[..., 1].reshape(len(mus), *lead), 0, -1)


def bound_points(scheme: Scheme, engine: SteppedEngine) -> Callable[[], bool] | None:
    """The call that puts the constants of an engine's only trajectory where its steps read them.

    It tells whether they are finite.  None if other constants depend on the trajectory, for code into which a rho
    is folded, and for code that is not compiled.
    """
    rows = [(True, engine.stages[0])] if engine.stages.size else []
    if "mu" in engine.columns:
        start = engine.columns["mu"].start
        rows.append((False, engine.constants[:, start : start + 2]))  # mu and, behind it, rho
    columns = {name: engine.columns[name] for name in scheme.constants}
    calls, mus = list[Callable[[], None]](), [out[:, : out.shape[1] // 2].copy() for _, out in rows]
    for (pair, out), mu in zip(rows, mus, strict=True):
        kernel = compiled_point(scheme, columns, pair)
        if kernel is None or not {*engine.columns} - {*scheme.constants} <= {"mu", "rho"}:
            return None
        words = [*map(address_of, (mu, engine.z, engine.constants, out)), len(out), 1]
        calls.append(partial(kernel.call, *map(ctypes.c_int64, words)))
    places = [out.ravel() for _, out in rows]
    if places[-1][-1] in FOLDED:
        return None

    def put(held: Any = mus) -> bool:
        for call in calls:
            call()
        return math.isfinite(sum(sum(place.tolist()) for place in places))

    return put
