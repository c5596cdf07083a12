"""`run.kreisel`: methods of Kreisel, available on the run itself.

A run stays a plain `xarray.Dataset` with xarray's display; in a notebook `run.kreisel` shows the system, the
method and the drift of every integral.  An accessor, unlike a subclass, survives `isel`, `sel` and arithmetic.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import xarray as xr

from kreisel.display import show
from kreisel.errors import InputError
from kreisel.record.model import Model
from kreisel.runs.drift import broken, drift, table_of
from kreisel.runs.run_record import RunRecord, cite

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure


@xr.register_dataset_accessor("kreisel")  # type: ignore[no-untyped-call]
class Kreisel:
    """The accessor of a run.  Raises `InputError` for any other Dataset."""

    def __init__(self, run: xr.Dataset):
        if "kreisel_format" not in run.attrs:
            raise InputError(
                "This Dataset is not a run of Kreisel: it lacks the attributes of one, such as its system."
            )
        self._run = run

    @property
    def model(self) -> Model:
        """The system with its parameters.  Raises `InputError` for a user-defined system."""
        return RunRecord.from_attrs(self._run.attrs).model

    def drift(self) -> pd.DataFrame:
        """`kr.drift(run)`."""
        return drift(self._run)

    def plot(self, **options: Any) -> Figure:
        """`kr.plot(run, **options)`."""
        return show("plot", self._run, **options)

    def view(self, **options: Any) -> Any:
        """`kr.view(run, **options)`."""
        return show("view", self._run, **options)

    def cite(self) -> str:
        """`kr.cite(run)`."""
        return cite(self._run)

    def __repr__(self) -> str:
        record, table = RunRecord.of(self._run, "title", "n", "steps", rows=False), table_of(self._run)
        head = f"<{record.title}, n = {record.n}, {record.pace if record.stepped else 'in closed form'}>"
        return "\n".join([head, table.to_string(), *broken(table)])

    def _repr_html_(self) -> str:
        return str(show("run", self._run))
