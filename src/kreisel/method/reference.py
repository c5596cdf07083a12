"""method="dop853": SciPy's Runge-Kutta method of order 8, the reference that preserves nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.forces.kicks import Body, Constants
from kreisel.forces.product import of_bodies
from kreisel.method import driven
from kreisel.method.scheme import (
    ORIENTATION,
    WORK,
    Flow,
    Only,
    Scheme,
    State,
    as_matrix,
    observer,
    scheme_of,
    with_orientation,
)
from kreisel.record.calling import call
from kreisel.record.contract import Frame
from kreisel.record.model import Model
from kreisel.record.perturbation import TIME

RTOL, ATOL = 1e-9, 1e-12


def dop853(model: Model, dt: float, order: int | None, oriented: bool) -> Scheme:
    """The flow, integrated by SciPy's adaptive DOP853 with rtol 1e-9 and atol 1e-12 or as asked, reported every dt.

    For a component below 1e-3 at the start, atol is rtol times its size.  The orientation is carried along: g' = omega
    g in the rest frame, g' = g Omega in the moving frame, for n = 3 as a quaternion, 2 q' = omega q or q Omega.  Of a
    perturbed body also the time, t' = 1, and the work, where its forces need them.
    """
    observe, outcomes = observer(model, oriented)
    space, record = model.system.space, model.system.perturbation
    driven.require_orientation(model, oriented)
    count = len(space.letters)
    end = count + oriented
    timed, works = (False, False) if record is None else (record.names(TIME), record.driven)
    beside = ((TIME, "scalar"),) * timed + ((WORK, "scalar"),) * works

    def prepare(x0: State) -> State:
        return (*x0, *(driven.zero(model.system, x0) for _ in beside))

    def where(z: State) -> dict[str, Array]:
        g = tuple(as_matrix(model, algebra.unit(q) if model.n == 3 else q) for q in z[count:end])
        return dict(zip((ORIENTATION,) * oriented + (TIME,) * timed, (*g, *z[end:]), strict=False))

    def rate(*z: Array, **constants: Array) -> State:
        state, constants = z[:count], {**constants, **where(z)}
        out = tuple(call(model.system.flow, state, constants))
        for g in z[count:end]:
            omega = call(model.system.velocity, state, constants)
            out += (turning(model.system.frame, omega, g),)
        out += (1.0,) * timed
        return (*out, driven.power(model, state, constants)) if works else out

    def observe_all(z: State, only: Only = None, /, **constants: Array) -> dict[str, Array]:
        place = where(z) if record is not None else {}
        out = observe(z[:end], only, **{**constants, **place})
        if oriented and model.n == 3:
            out[ORIENTATION] = algebra.unit(z[count])
        return driven.with_work(out, z[-1]) if works else out

    if works:
        outcomes |= driven.outcomes_of_work("not conserved by this method")
    outcomes |= driven.outcomes_of_totals(model, "not conserved by this method")

    def body(z: State, constants: Constants) -> Body:
        return Body(model.system, z[:count], constants, model.axes, where(z).get(ORIENTATION), where(z).get(TIME))

    coupling = driven.coupling_of(model, body, works)
    return scheme_of(
        "dop853",
        model,
        Flow(rate),
        (observe_all, outcomes),
        components=with_orientation(model, oriented) + beside,
        constants=of_bodies(model),
        prepare=prepare,
        reopen=prepare,
        options={"order": 8, "rtol": RTOL, "atol": ATOL},
        recordable=model.system.numbers != "jax",
        coupling=coupling,
    )


def turning(frame: Frame, omega: Array, g: Array) -> Array:
    """The rate of an orientation, a matrix or for n = 3 a quaternion, from omega or Omega as a matrix."""
    if g.shape[-1] == omega.shape[-1]:
        return omega @ g if frame is Frame.REST else g @ omega
    pure = np.concatenate([0 * g[..., :1], algebra.axial(omega) / 2], -1)
    pair = (pure, g) if frame is Frame.REST else (g, pure)
    return algebra.quaternion_product(*pair)


def with_tolerance(scheme: Scheme, tol: float) -> Scheme:
    """The scheme with rtol = tol and atol = tol/1000; unchanged for the rtol that it has."""
    if tol == RTOL:
        return scheme
    options = {**scheme.options, "rtol": tol, "atol": tol * ATOL / RTOL}
    return replace(scheme, options=options, definition_key=None, kernel_key=None)
