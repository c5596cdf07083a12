"""The scales of rounding errors in the integrals of a run, measured again from states of the whole run.

The scales that a run carries come from its first block.  A motion that leaves an unstable equilibrium only later has
far smaller states in that block than afterwards.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from kreisel.errors import InputError
from kreisel.kernels import layout
from kreisel.kernels.layout import Floats
from kreisel.method import scheme
from kreisel.method.observing import ORIENTATION
from kreisel.runs.drift import KINDS, read_values
from kreisel.runs.plan import Plan
from kreisel.runs.run_record import RunRecord
from kreisel.runs.settings import Settings

if TYPE_CHECKING:
    import xarray as xr

ROWS = 32


def whole_run(run: xr.Dataset, name: str, lanes: np.ndarray) -> tuple[Floats, Floats] | None:
    """The attributes roundoff_scale and evaluation_scale of a variable for some lanes, from rows of the whole run.

    None where they cannot be measured: a system of the user's own, whose functions an archive has not, or a run without
    its states or its step.
    """
    from kreisel.runs.describing import roundoff_scales

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
