"""kr.analysis.megno: regular or chaotic, from a neighbouring motion that is brought back beside the first.

    Y(t) = (2/t) int_0^t (d'/d) s ds,   d the distance of two neighbouring motions

Its mean over time goes to 2 for quasiperiodic motions, whose neighbours part like t, to 0 for stable periodic ones, and
grows like lambda t/2 for chaotic ones, lambda Lyapunov's exponent.
[P. M. Cincotta, C. Simo, Astron. Astrophys. Suppl. 147 (2000) 205]
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from kreisel.algebra import Array, axial, dot, unit
from kreisel.errors import InputError, explained
from kreisel.record.model import Model
from kreisel.record.perturbation import TIME
from kreisel.runs.propagation.propagator import propagator
from kreisel.runs.settings import check_model, checked_state, initial_orientation, within

if TYPE_CHECKING:
    import xarray as xr

    from kreisel.record.model import OrientationLike, StateLike

APART = 1e-8  # of the neighbour, relative
MOST, MOST_SEED = 10**9, 2**63
TINY = 1e-300


@explained
def megno(
    system: Model,
    x0: StateLike,
    *,
    dt: float,
    steps: int,
    every: int = 10,
    orientation: OrientationLike | None = None,
    method: str | None = None,
    order: int | None = None,
    seed: int = 0,
) -> xr.Dataset:
    """MEGNO and Lyapunov's exponent of the motion from a state, of each lane, against time.

    system, x0, dt, steps, orientation, method, order   as for `kr.simulate`
    every    steps after which the neighbour is brought back to a distance of 1e-8
    seed     of the direction of the neighbour, whose momentum differs

    Returns a Dataset with megno Y, its mean over time, and lyapunov, ln(d(t)/d(0))/t, each (time,) or (time, lane).
    The system may be one of `kr.perturbed`, whose forces may depend on the orientation and on time; n = 3.
    Raises `InputError` as `kr.simulate` does.
    """
    import xarray as xr

    check_model(system)
    rows = -(-within(steps, "steps", 1, MOST) // within(every, "every", 1, MOST))
    if system.n != 3 or system.system.space.kinds[0] != "skew":
        raise InputError(f"megno: expected a body with n = 3 and its momentum, got {system.system.name}.")
    first, lanes, single = _rows(system, x0, orientation)
    both = system.lanes(np.tile(np.arange(lanes), 2)) if system.batch else system
    p = propagator(both, method=method, order=order, dt=dt, orientation=orientation is not None)
    record = system.system.perturbation
    timed = record is not None and record.names(TIME)
    scale = np.ones_like(first)
    scale[:, :3] = np.maximum(_length(first[:, :3]), TINY)
    change = np.zeros_like(first)
    change[:, :3] = np.random.default_rng(within(seed, "seed", 0, MOST_SEED)).normal(size=(lanes, 3))
    neighbour = first + APART * scale * change / _length(change)
    growth = np.empty((rows, lanes))
    for row in range(rows):
        moved = p.steps(np.concatenate([first, neighbour]), every, time=row * every * p.dt if timed else None)
        first, neighbour = moved[:lanes, : p.size], moved[lanes:, : p.size]
        if orientation is not None:  # q and -q are the same turn
            neighbour[:, -4:] *= np.where(dot(first[:, -4:], neighbour[:, -4:]) < 0, -1, 1)[:, None]
        distance = _length((neighbour - first) / scale)
        growth[row] = np.log(distance[:, 0] / APART)
        neighbour = first + (neighbour - first) * APART / distance
        if orientation is not None:
            neighbour[:, -4:] = unit(neighbour[:, -4:])
    number = np.arange(1, rows + 1)[:, None]
    value, time = 2 / number * np.cumsum(number * growth, 0), number * every * p.dt
    found = {"megno": value, "mean": np.cumsum(value, 0) / number, "lyapunov": np.cumsum(growth, 0) / time}
    dims = ("time",) if single else ("time", "lane")
    return xr.Dataset({k: (dims, v[:, 0] if single else v) for k, v in found.items()}, {"time": time[:, 0]})


def _rows(system: Model, x0: StateLike, orientation: OrientationLike | None) -> tuple[Array, int, bool]:
    """States and orientations as a propagator takes them (lanes, size), how many, and whether it is a single one."""
    state = checked_state(system, x0)
    kinds = system.system.space.kinds
    parts = [axial(z) if kind == "skew" else z for kind, z in zip(kinds, state.values(), strict=True)]
    parts += [] if orientation is None else [initial_orientation(orientation, system)]
    batch = np.broadcast_shapes(system.batch, *(part.shape[:-1] for part in parts))
    flat = np.concatenate([np.broadcast_to(part, (*batch, part.shape[-1])) for part in parts], -1)
    return flat.reshape(-1, flat.shape[-1]).astype(np.float64), int(np.prod(batch)), not batch


def _length(x: Array) -> Array:
    return np.sqrt((x * x).sum(-1, keepdims=True))
