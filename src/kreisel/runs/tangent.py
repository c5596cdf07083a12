"""kr.tangent: the Jacobian of the end state of a run by its initial state."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.errors import InputError, RunError, explained
from kreisel.runs.differentiable import differentiable
from kreisel.runs.run_record import RunRecord

if TYPE_CHECKING:
    import xarray as xr


@explained
def tangent(run: xr.Dataset) -> Array:
    """J (d, d) = d(end state)/d(initial state) of a run of one trajectory, in independent coordinates.

    Those of the Poisson tensor: entries i < j of a skew matrix, then the vectors; J T(start) J^T = T(end) where the
    method is Poisson.  By `kr.differentiable` along the definition, without projections.  Needs the extra `reduction`.
    Raises `InputError` for ensembles, for runs with impulses, events or times of their own, and as `differentiable`;
    `RunError` where J is not finite.
    """
    record = RunRecord.of(run)
    if "lane" in run.dims or not record.stepped or record.broken or record.at_times:
        raise InputError(
            "tangent: expected a run of one trajectory by equal steps, got an ensemble, or one with impulses, events "
            "or times of its own. Use kr.differentiable, with jax.vmap for ensembles."
        )
    model = record.model
    f = differentiable(model, method=record.method, order=record.order)
    from kreisel.reduction.double import double, jax

    jnp = jax.numpy

    space, n = model.system.space, model.n
    start = [np.asarray(run[letter].values[0]) for letter in space.letters]
    shown = [algebra.hat(x) if k == "skew" and n == 3 else x for k, x in zip(space.kinds, start, strict=True)]
    flat = [algebra.coordinates_of(k, x) for k, x in zip(space.kinds, shown, strict=True)]
    edges = np.cumsum([len(x) for x in flat])[:-1]

    def end(x: Array) -> Array:
        state = {}
        for letter, kind, piece in zip(space.letters, space.kinds, jnp.split(x, edges), strict=True):
            X = algebra.skew(piece, n) if kind == "skew" else piece
            X = algebra.symmetric(piece, n) if kind == "symmetric" else X
            state[letter] = algebra.axial(X) if kind == "skew" and n == 3 else X
        out = f(state, dt=record.dt, steps=record.steps)
        whole = [
            algebra.hat(v) if k == "skew" and n == 3 else v for k, v in zip(space.kinds, out.values(), strict=True)
        ]
        return jnp.concatenate([algebra.coordinates_of(k, v) for k, v in zip(space.kinds, whole, strict=True)])

    with double():
        J = np.asarray(jax.jit(jax.jacfwd(end))(jnp.asarray(np.concatenate(flat))))
    if not np.isfinite(J).all():
        raise RunError("tangent: the Jacobian is not finite. Usual cause: dt too long, or a run too long for doubles.")
    return J
