"""The scales of rounding errors in the integrals of a run, from its first block and from states of the whole run.

The scales that a run carries come from its first block.  A motion that leaves an unstable equilibrium only later has
far smaller states in that block than afterwards.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from kreisel import algebra
from kreisel.algebra import Array
from kreisel.errors import InputError
from kreisel.kernels import layout
from kreisel.kernels.layout import MACHINE_EPSILON, Floats
from kreisel.method import scheme
from kreisel.method.observing import ORIENTATION
from kreisel.method.scheme import KINDS
from kreisel.runs.plan import Plan
from kreisel.runs.run_record import RunRecord
from kreisel.runs.settings import Settings
from kreisel.storage.reading import read_values

if TYPE_CHECKING:
    import xarray as xr

ROWS = 32


def whole_run(run: xr.Dataset, name: str, lanes: np.ndarray) -> tuple[Floats, Floats] | None:
    """The attributes roundoff_scale and evaluation_scale of a variable for some lanes, from rows of the whole run.

    None where they cannot be measured: a system of the user's own, whose functions an archive has not, or a run without
    its states or its step.
    """
    record = RunRecord.from_attrs(run.attrs)
    if "system" not in run.attrs or record.is_own or not record.stepped:
        return None
    rows = np.unique(np.linspace(0, run.sizes["time"] - 1, ROWS).astype(int))
    some = run.isel(time=rows, lane=lanes) if "lane" in run.dims else run.isel(time=rows)
    try:
        model = record.model.lanes(some["lane"].values) if "lane" in run.coords else record.model
        made = scheme(model, record.method, record.dt, record.order, ORIENTATION in run)
        states = {k: read_values(some[k]) for k, outcome in made.outcomes.items() if outcome.kind not in KINDS}
    except (InputError, KeyError):
        return None
    width = sum(layout.coordinate_count(kind, model.n) for _, kind in made.components)
    plan = Plan(
        model=model,
        scheme=made,
        settings=Settings(dt=record.dt, steps=len(rows)),
        first=np.zeros((len(lanes), width)),
        batched="lane" in run.dims,
        start={},
    )
    with np.errstate(all="ignore"):
        scales = roundoff_scales(plan, states)[name]
    return np.array(scales["roundoff_scale"]), np.array(scales["evaluation_scale"])


MOST_SCALES = 4096  # numbers in an attribute
MANY_SAMPLES_N = 16  # beyond, there are fewer
MANY_LANES = 4096  # beyond, there are fewer: the largest over the lanes counts
SAMPLES = 16  # perturbations of a state that measure how an integral feels them
NUDGE, HAIR = 1e-6, 1e-12  # relative: far above round-off, and so small that only noise is left


def roundoff_scales(plan: Plan, first: Mapping[str, Array]) -> dict[str, dict[str, list[float]]]:
    """How much rounding errors change each Casimir and integral, in units of eps_machine.

    roundoff_scale    in one step.  Every coordinate of a component is moved by the component's largest one, with random
                      signs; the scale is the root mean square of the change, over up to 32 states of a lane in the
                      first block
    evaluation_scale  in one evaluation from a state: the size of the value, or its noise if that is larger
    """
    z = _sampled_rows(plan, first)
    n = plan.model.n
    samples = SAMPLES if n <= MANY_SAMPLES_N else max(2, 16 * SAMPLES // n)  # every coordinate counts
    samples = max(1, min(samples, SAMPLES * MANY_LANES // plan.lanes))
    directions = _signs(samples, z.shape) * _largest(plan, z)
    by = np.concatenate([factor * directions for factor in (NUDGE, -NUDGE, HAIR, -HAIR)] + [0 * directions[:1]])
    every = plan.observe((z + by).reshape(-1, *z.shape[1:]))
    out = {}
    for name, outcome in plan.outcomes.items():
        if outcome.kind in KINDS:
            values = every[name].reshape((*by.shape[:2], *every[name].shape[1:]))
            up, down, a_bit_up, a_bit_down = values[:-1].reshape(4, samples, *values.shape[1:])
            here = values[-1]
            felt = np.sqrt((((up - down) / (2 * NUDGE)) ** 2).mean((0, 1)))
            noise = abs(a_bit_up + a_bit_down - 2 * here) / (2 * MACHINE_EPSILON)
            if n > MANY_SAMPLES_N and noise.shape[-1] == layout.coordinate_count("skew", n):
                noise = np.broadcast_to(noise.max(-1, keepdims=True), noise.shape)  # entries of one matrix
            computed = np.maximum(noise.max((0, 1)), abs(here).max(0))
            out[name] = {"roundoff_scale": _listed(felt, plan), "evaluation_scale": _listed(computed, plan)}
    return out


@lru_cache(4)
def _signs(samples: int, shape: tuple[int, ...]) -> Floats:
    """Random signs, the same in every run."""
    return np.random.default_rng(0).choice([-1.0, 1.0], (samples, *shape))


def _listed(scale: Array, plan: Plan) -> list[float]:
    """A scale for each part of an integral, lane after lane; the largest over the lanes if those are too many."""
    if plan.batched and scale.size > MOST_SCALES:
        scale = scale.max(0)
    return [float(v) for v in np.ravel(scale)]


def _largest(plan: Plan, z: Floats) -> Floats:
    """For each coordinate the largest of its component, in the shape of z."""
    parts = zip(layout.restore(z, plan.kinds, plan.model.n), plan.kinds, strict=True)
    flat = [abs(layout.flatten((part,), (kind,))) for part, kind in parts]
    return np.concatenate([f.max(-1, keepdims=True).repeat(f.shape[-1], -1) for f in flat], -1)


def _sampled_rows(plan: Plan, first: Mapping[str, Array]) -> Floats:
    """Up to 32 rows of the first block, evenly spread, in the method's own variables (rows, lanes, d).

    Of more than 64 lanes, and for n > 16, fewer rows, down to one: some thousand numbers are enough.
    """
    count = min(32, max(1, 2048 // plan.lanes), max(1, 512 // plan.model.n))
    rows = np.unique(np.linspace(0, len(next(iter(first.values()))) - 1, count).astype(int))
    parts = []
    for letter, outcome in plan.outcomes.items():
        if outcome.kind not in ("state", "orientation"):
            continue
        value = np.asarray(first[letter])[rows].astype(np.float64)
        value = value.reshape((len(rows), plan.lanes, *value.shape[1 + plan.batched :]))
        axial = outcome.axes == "skew" and plan.model.n == 3
        parts.append(algebra.hat(value) if axial else value)
    return np.asarray(layout.flatten(plan.scheme.reopen(tuple(parts)), plan.kinds))
