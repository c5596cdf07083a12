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
    roundoff    eps_machine * sensitivity * sqrt(steps): the width of a random walk of rounding errors, with
                sensitivity = sqrt(sum_i (z_i dI/dz_i)^2) at the start
    ratio       max_change / roundoff: about 1 or less for an integral that is kept
    slope       least-squares slope of the change against time

    In an ensemble each row is the worst lane.
    """
    import pandas as pd

    time = np.asarray(run["time"].values)
    steps = run.attrs["steps"]
    rows = {name: {"kind": kind, **_row(series, time, scale, steps)} for name, kind, series, scale in _all_series(run)}
    return pd.DataFrame.from_dict(rows, orient="index")


def kept_series(run: xr.Dataset, every_kind: bool = False) -> Iterator[tuple[str, np.ndarray, float]]:
    """Name, values against time and sensitivity of each scalar that the method keeps (or of all)."""
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
        for part, scale in enumerate(np.atleast_1d(variable.attrs["roundoff_scale"])):
            series = parts[..., part].reshape(len(values), -1)
            worst = int(abs(series - series[0]).max(0).argmax())
            label = f"{name}[{part}]" if values.ndim > 1 + lanes else str(name)
            yield label, kind, series[:, worst], float(scale)


def _row(series: np.ndarray, time: np.ndarray, scale: float, steps: int) -> dict[str, float]:
    change = series - series[0]
    centred = time - time.mean()
    slope = float(centred @ change / (centred @ centred)) if len(time) > 1 else 0.0
    largest, band = float(abs(change).max()), MACHINE_EPSILON * scale * np.sqrt(steps)
    return {
        "start": float(series[0]) + 0.0,
        "max_change": largest,
        "roundoff": band,
        "ratio": largest / band if band > 0 else (0.0 if largest == 0 else np.inf),
        "slope": slope,
    }
