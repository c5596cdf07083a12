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

    `steps` are those from the first to the last saved time.  In an ensemble each row is the worst lane: that of the
    largest ratio to its own roundoff, or in more than some hundred lanes to the largest of theirs.
    """
    import pandas as pd

    if "kreisel_sweep" in run.attrs:
        raise InputError("A sweep has the drift of each lane in its variables NAME_drift; kr.drift takes a run.")
    run = run if "time" in run.dims else run.expand_dims("time")
    time = read(run["time"])
    rows = {
        series.name: {"kind": series.kind, "kept": series.kept, **_row(series, time, _steps(run, time))}
        for series in all_series(run)
    }
    return pd.DataFrame.from_dict(rows, orient="index")


@dataclass(frozen=True)
class Series:
    """One scalar of a run against time; in an ensemble its worst lane, with the scales of that lane."""

    name: str
    family: str
    kind: str
    kept: bool
    values: np.ndarray
    step_scale: float
    value_scale: float


def all_series(run: xr.Dataset) -> Iterator[Series]:
    """Every component of every Casimir and integral, what is kept first."""
    steps = _steps(run, read(run["time"])) if "lane" in run.dims else 0.0
    for name, variable in sorted(run.data_vars.items(), key=lambda item: _place(item[1])):
        attrs = variable.attrs
        if attrs.get("kind") not in KINDS:
            continue
        family = variable.ndim > 1 + ("lane" in variable.dims)
        scales = [lane_scales(variable, key) for key in ("roundoff_scale", "evaluation_scale")]
        for part in range(scales[0].shape[1]):
            # one part at a time: an archive may be longer than memory
            series = read(variable[..., part] if family else variable)
            series = series.reshape(len(series), -1)
            step_scale, value_scale = (np.broadcast_to(scale[:, part], series.shape[1]) for scale in scales)
            worst = 0
            if series.shape[1] > 1:
                band = step_scale * np.sqrt(steps) + value_scale
                worst = int(_ratio(abs(series - series[0]).max(0), band).argmax())
            label = f"{name}[{part}]" if family else str(name)
            at = float(step_scale[worst]), float(value_scale[worst])
            yield Series(label, str(name), attrs["kind"], bool(attrs.get("kept", False)), series[:, worst], *at)


def lane_scales(variable: xr.DataArray, key: str) -> np.ndarray:
    """An attribute of scales (lanes or 1, parts), for the lanes that the variable still has.

    Raises `InputError` where it does not belong to the variable.
    """
    parts = variable.shape[-1] if variable.ndim > 1 + ("lane" in variable.dims) else 1
    try:
        told = np.atleast_1d(np.asarray(variable.attrs[key], dtype=np.float64)).reshape(-1, parts)
    except (KeyError, TypeError, ValueError):
        raise InputError(f"{variable.name} is damaged: its attribute {key} does not belong to it.") from None
    if len(told) == 1 or "lane" not in variable.coords:
        return told.max(0, keepdims=True)
    lanes = np.atleast_1d(variable["lane"].values)
    fits = lanes.dtype.kind in "iu" and (lanes >= 0).all() and (lanes < len(told)).all()
    return told[lanes] if fits else told.max(0, keepdims=True)


def _steps(run: xr.Dataset, time: np.ndarray) -> float:
    """Those that are there: a run may be cut short; `kr.at` makes none."""
    return float(time[-1] - time[0]) / run.attrs["dt"] if "dt" in run.attrs else 0.0


def _ratio(change: np.ndarray, band: np.ndarray) -> np.ndarray:
    return np.divide(change, band, out=np.where(change > 0, np.inf, 0.0), where=band > 0)


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
        "ratio": float(_ratio(np.array(largest), np.array(band))),
        "slope": slope,
    }
