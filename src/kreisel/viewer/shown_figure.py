"""A figure that shows itself in a notebook, whether or not pyplot is loaded."""

from __future__ import annotations

import io
from typing import Any

from matplotlib.figure import Figure


class ShownFigure(Figure):
    """A figure of matplotlib with a picture for notebooks."""

    def _repr_png_(self) -> bytes:
        out = io.BytesIO()
        self.savefig(out, format="png", dpi=self.dpi)
        return out.getvalue()

    def _repr_mimebundle_(self, include: Any = None, exclude: Any = None) -> dict[str, Any]:
        """The picture and nothing else: where pyplot is loaded, IPython would add its own."""
        return {"image/png": self._repr_png_(), "text/plain": repr(self)}
