"""A figure that shows itself in a notebook, whether or not pyplot is loaded, and is saved in its own style."""

from __future__ import annotations

import io
from typing import Any

import matplotlib as mpl
from matplotlib.figure import Figure

FILES = ("savefig.", "pdf.", "ps.", "svg.")


class ShownFigure(Figure):
    """A figure of matplotlib with a picture for notebooks; settings of files are those when it was made."""

    def __init__(self, *args: Any, **options: Any):
        super().__init__(*args, **options)
        self._for_files = {key: value for key, value in mpl.rcParams.items() if key.startswith(FILES)}

    def savefig(self, fname: Any, **options: Any) -> None:
        """As of matplotlib."""
        with mpl.rc_context(self._for_files):
            super().savefig(fname, **options)

    def _repr_png_(self) -> bytes:
        out = io.BytesIO()
        self.savefig(out, format="png", dpi=self.dpi)
        return out.getvalue()

    def _repr_mimebundle_(self, include: Any = None, exclude: Any = None) -> dict[str, Any]:
        """The picture and nothing else: where pyplot is loaded, IPython would add its own."""
        return {"image/png": self._repr_png_(), "text/plain": repr(self)}
