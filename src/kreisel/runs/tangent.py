"""kr.tangent: the Jacobian of the end state of a run by its initial state."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.errors import InputError, RunError, explained
from kreisel.method.observing import ORIENTATION, as_matrix
from kreisel.record.contract import Frame
from kreisel.runs.differentiable import attitude_near, differentiable
from kreisel.runs.geometry import model_for
from kreisel.runs.run_record import RunRecord

if TYPE_CHECKING:
    import xarray as xr

    from kreisel.record.model import Model

ON_STEP = 1e-6  # of a step: times so close to it are its own


@explained
def tangent(run: xr.Dataset, *, system: Model | None = None) -> Array:
    """J (d, d) = d(end state)/d(initial state) of a run of one trajectory, in independent coordinates.

    Those of the Poisson tensor: entries i < j of a skew matrix, then the vectors; J T(start) J^T = T(end) where the
    method is Poisson.  Of a run with orientation then the entries i < j of the skew X with dg = g X (moving frame) or
    dg = X g (rest frame).  `system`: that of the run, if it is of your own.  By `kr.differentiable` along the
    definition, without projections.  Of a part of a run, `run.isel(time=slice(...))`, from its first row to its last.
    Needs the extra `reduction`.  Raises `InputError` for ensembles, for runs with impulses, events or times of their
    own, for one row, and as `differentiable`; `RunError` where J is not finite.
    """
    record = RunRecord.of(run)
    if "lane" in run.dims or not record.stepped or record.broken or record.at_times:
        raise InputError(
            "tangent: expected a run of one trajectory by equal steps, got an ensemble, or one with impulses, events "
            "or times of its own. Use kr.differentiable, with jax.vmap for ensembles."
        )
    model, steps = model_for(run, system), _steps_of(run, record.dt)
    f = differentiable(model, method=record.method, order=record.order, orientation=ORIENTATION in run)
    from kreisel.kernels import jax_numbers as by
    from kreisel.reduction.double import double, jax

    jnp = jax.numpy

    space, n = model.system.space, model.n
    start = [np.asarray(run[letter].values[0], dtype=np.float64) for letter in space.letters]
    shown = [algebra.hat(x) if k == "skew" and n == 3 else x for k, x in zip(space.kinds, start, strict=True)]
    flat = [algebra.coordinates_of(k, x) for k, x in zip(space.kinds, shown, strict=True)]
    flat += [np.zeros(n * (n - 1) // 2)] * (ORIENTATION in run)
    edges = np.cumsum([len(x) for x in flat])[:-1]

    def coordinates_of_turn(g: Array) -> Array:
        """Of X, 0 where it is differentiated."""
        R = as_matrix(model, g)
        back = jax.lax.stop_gradient(R).mT
        turn = back @ R if model.system.frame is Frame.MOVING else R @ back
        return algebra.coordinates((turn - turn.mT) / 2)

    def end(x: Array) -> Array:
        state, pieces = {}, jnp.split(x, edges)
        for (letter, kind), piece in zip(space.components, pieces, strict=False):
            X = algebra.skew(piece, n) if kind == "skew" else piece
            X = algebra.symmetric(piece, n) if kind == "symmetric" else X
            state[letter] = algebra.axial(X) if kind == "skew" and n == 3 else X
        if ORIENTATION in run:
            state[ORIENTATION] = attitude_near(by, model, pieces[-1], run.g.values[0])
        out = f(state, dt=record.dt, steps=steps, time=float(run["time"][0]))
        whole = [algebra.hat(out[k]) if kind == "skew" and n == 3 else out[k] for k, kind in space.components]
        parts = [algebra.coordinates_of(k, v) for k, v in zip(space.kinds, whole, strict=True)]
        return jnp.concatenate(parts + ([coordinates_of_turn(out[ORIENTATION])] if ORIENTATION in run else []))

    with double():
        J = np.asarray(jax.jit(jax.jacfwd(end))(jnp.asarray(np.concatenate(flat))))
    if not np.isfinite(J).all():
        raise RunError("tangent: the Jacobian is not finite. Usual cause: dt too long, or a run too long for doubles.")
    return J


def _steps_of(run: xr.Dataset, dt: float) -> int:
    """How many steps lie between the first row and the last one.  Raises `InputError`."""
    steps = float(run["time"][-1] - run["time"][0]) / dt
    if round(steps) < 1 or abs(steps - round(steps)) > ON_STEP:
        raise InputError(f"tangent: expected rows with some steps of {dt:g} from the first to the last, got {steps:g}.")
    return round(steps)
