"""A figure that a notebook displays, with or without pyplot, and that is saved in its style."""

from __future__ import annotations

import io
from typing import Any

import matplotlib as mpl
from matplotlib.figure import Figure

FILES = ("savefig.", "pdf.", "ps.", "svg.")


class ShownFigure(Figure):
    """A figure of matplotlib with a picture for notebooks; settings of files are fixed at its creation."""

    def __init__(self, *args: Any, **options: Any):
        super().__init__(*args, **options)
        self._for_files = {key: value for key, value in mpl.rcParams.items() if key.startswith(FILES)}

    def savefig(self, fname: Any, **options: Any) -> None:
        """Save as matplotlib does."""
        with mpl.rc_context(self._for_files):
            super().savefig(fname, **options)

    def _repr_png_(self) -> bytes:
        out = io.BytesIO()
        self.savefig(out, format="png", dpi=self.dpi)
        return out.getvalue()

    def _repr_mimebundle_(self, include: Any = None, exclude: Any = None) -> dict[str, Any]:
        """The picture only: if pyplot is loaded, IPython would add another one."""
        return {"image/png": self._repr_png_(), "text/plain": repr(self)}
