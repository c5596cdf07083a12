"""kr.drift: how still the integrals stand, against what round-off allows."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

from kreisel.errors import InputError

MACHINE_EPSILON = float(np.finfo(np.float64).eps)


KINDS = ("casimir", "integral", "relation")


def _place(variable: xr.DataArray) -> tuple[bool, int]:
    attrs = variable.attrs
    return not attrs.get("kept", False), KINDS.index(attrs["kind"]) if attrs.get("kind") in KINDS else -1


def read(variable: xr.DataArray) -> np.ndarray:
    """The values of a variable.  Raises `InputError` where they cannot be read from its archive."""
    try:
        return np.asarray(variable.values)
    except Exception as error:  # whatever a damaged chunk makes the libraries raise
        raise InputError(
            f"{variable.name} cannot be read: {error or type(error).__name__}. `kreisel check` says what is damaged."
        ) from error


def drift(run: xr.Dataset) -> pd.DataFrame:
    """One row for each Casimir, integral and invariant relation of a run.

    kind        "casimir", "integral", or "relation": f of an invariant relation f = 0, which stays 0 if it starts so
    kept        whether the method keeps it; a map keeps its deformed integrals, names ending in _eps
    start       value at the first saved time
    max_change  largest |change| since then
    roundoff    eps_machine * (sensitivity * sqrt(steps) + size): the width of a random walk of rounding errors,
                and of the error of computing the integral once; the sensitivity is what a relative error of 1
                in the state does to it
    ratio       max_change / roundoff: about 1 or less for an integral that is kept
    slope       least-squares slope of the change against time

    `steps` are those from the first to the last saved time.  In an ensemble each row is the worst lane.
    """
    import pandas as pd

    if "kreisel_sweep" in run.attrs:
        raise InputError("A sweep has the drift of each lane in its variables NAME_drift; kr.drift takes a run.")
    run = run if "time" in run.dims else run.expand_dims("time")
    time = read(run["time"])
    # those that are there: a run may be cut short; `kr.at` makes none
    steps = float(time[-1] - time[0]) / run.attrs["dt"] if "dt" in run.attrs else 0.0
    rows = {
        series.name: {"kind": series.kind, "kept": series.kept, **_row(series, time, steps)}
        for series in all_series(run)
    }
    return pd.DataFrame.from_dict(rows, orient="index")


@dataclass(frozen=True)
class Series:
    """One scalar of a run against time; in an ensemble its worst lane.  Scales as in the attributes."""

    name: str
    family: str
    kind: str
    kept: bool
    values: np.ndarray
    step_scale: float
    value_scale: float


def all_series(run: xr.Dataset) -> Iterator[Series]:
    """Every component of every Casimir and integral, what is kept first."""
    for name, variable in sorted(run.data_vars.items(), key=lambda item: _place(item[1])):
        attrs = variable.attrs
        if attrs.get("kind") not in KINDS:
            continue
        family = variable.ndim > 1 + ("lane" in variable.dims)
        scales = zip(np.atleast_1d(attrs["roundoff_scale"]), np.atleast_1d(attrs["evaluation_scale"]), strict=True)
        for part, (step_scale, value_scale) in enumerate(scales):
            # one part at a time: an archive may be longer than memory
            series = read(variable[..., part] if family else variable)
            series = series.reshape(len(series), -1)
            worst = int(abs(series - series[0]).max(0).argmax()) if series.shape[1] > 1 else 0
            label = f"{name}[{part}]" if family else str(name)
            kept = bool(attrs["kept"])
            yield Series(label, str(name), attrs["kind"], kept, series[:, worst], float(step_scale), float(value_scale))


def _row(series: Series, time: np.ndarray, steps: float) -> dict[str, float]:
    change = series.values - series.values[0]
    centred = time - time.mean()
    slope = float(centred @ change / (centred @ centred)) if len(time) > 1 else 0.0
    largest = float(abs(change).max())
    band = MACHINE_EPSILON * (series.step_scale * float(np.sqrt(steps)) + series.value_scale)
    return {
        "start": float(series.values[0]) + 0.0,
        "max_change": largest,
        "roundoff": band,
        "ratio": largest / band if band > 0 else (0.0 if largest == 0 else np.inf),
        "slope": slope,
    }
