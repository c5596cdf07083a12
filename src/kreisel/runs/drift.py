"""kr.drift: how still the integrals stand, against what round-off allows."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

MACHINE_EPSILON = float(np.finfo(np.float64).eps)


KINDS = ("casimir", "integral", "function")


def _place(variable: xr.DataArray) -> int:
    kind = variable.attrs.get("kind")
    return KINDS.index(kind) if kind in KINDS else -1


def drift(run: xr.Dataset) -> pd.DataFrame:
    """One row for each Casimir and integral of a run.

    kind        "casimir", "integral" (kept by the method) or "function" (an integral of the flow that the
                method does not keep)
    start       value at the first saved time
    max_change  largest |change| since then
    roundoff    eps_machine * (sensitivity * sqrt(steps) + size): the width of a random walk of rounding errors,
                and of the error of computing the integral once; the sensitivity is what a relative error of 1
                in the state does to it
    ratio       max_change / roundoff: about 1 or less for an integral that is kept
    slope       least-squares slope of the change against time

    In an ensemble each row is the worst lane.
    """
    import pandas as pd

    time = np.asarray(run["time"].values)
    rows = {name: {"kind": kind, **_row(series, time, scale)} for name, kind, series, scale in _all_series(run)}
    return pd.DataFrame.from_dict(rows, orient="index")


def kept_series(run: xr.Dataset, every_kind: bool = False) -> Iterator[tuple[str, np.ndarray, float]]:
    """Name, values and round-off over the run / eps_machine of each scalar that the method keeps (or of all)."""
    for name, kind, series, scale in _all_series(run):
        if every_kind or kind != "function":
            yield name, series, scale


def _all_series(run: xr.Dataset) -> Iterator[tuple[str, str, np.ndarray, float]]:
    """Every component of every Casimir and integral, the worst lane of each."""
    for name, variable in sorted(run.data_vars.items(), key=lambda item: _place(item[1])):
        kind = variable.attrs.get("kind")
        if kind not in KINDS:
            continue
        values = np.asarray(variable.values)
        lanes = "lane" in variable.dims
        parts = values.reshape((*values.shape[: 1 + lanes], -1))
        scales = np.atleast_1d(variable.attrs["roundoff_scale"]) * np.sqrt(run.attrs["steps"])
        for part, scale in enumerate(scales + np.atleast_1d(variable.attrs["evaluation_scale"])):
            series = parts[..., part].reshape(len(values), -1)
            worst = int(abs(series - series[0]).max(0).argmax())
            label = f"{name}[{part}]" if values.ndim > 1 + lanes else str(name)
            yield label, kind, series[:, worst], float(scale)


def _row(series: np.ndarray, time: np.ndarray, scale: float) -> dict[str, float]:
    change = series - series[0]
    centred = time - time.mean()
    slope = float(centred @ change / (centred @ centred)) if len(time) > 1 else 0.0
    largest, band = float(abs(change).max()), MACHINE_EPSILON * scale
    return {
        "start": float(series[0]) + 0.0,
        "max_change": largest,
        "roundoff": band,
        "ratio": largest / band if band > 0 else (0.0 if largest == 0 else np.inf),
        "slope": slope,
    }
