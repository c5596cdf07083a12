"""kr.view, `kreisel view`: a run as one HTML file that needs nothing else, and as a notebook display.

The file holds three.js and uPlot (assets/README.md), Kreisel's own script, and the data as JSON in which no markup can
begin.  Text from the archive is only ever set as text.  Its Content-Security-Policy names the two scripts by their
hashes and allows no request, so that nothing else runs in it, whatever an archive says.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kreisel.errors import InputError, explained
from kreisel.files import place, written
from kreisel.viewer.bodies import known_shape
from kreisel.viewer.document import page
from kreisel.viewer.notebook import cell
from kreisel.viewer.scene import scene

if TYPE_CHECKING:
    import xarray as xr


@explained
class View:
    """The page of a run.  In a notebook it shows itself; `save` writes the file; `html` is its text."""

    def __init__(self, run: xr.Dataset, lane: Any = None, **shown: Any):
        self._scene = scene(run, lane, **shown)

    @property
    def html(self) -> str:
        """The page, whole."""
        return page(self._scene)

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write the page; a page that Kreisel wrote is replaced.

        Raises `InputError` where anything else has that name, and `RunError` where the disk refuses.
        """
        target = place(path, "The page needs a name such as top.html")
        with written(target) as scratch:
            scratch.write_text(self.html, encoding="utf-8")
        return target

    def movie(self, path: str | os.PathLike[str], **options: Any) -> Path:
        """Write a film of the first body: .gif, or .mp4 where ffmpeg is installed.

        Options: seconds=8.0, fps=20, speed=1.0 (as on the page), theme="light".  Raises `InputError` for other names
        and for a run whose saved states are too far apart.
        """
        from kreisel.viewer.movie import movie

        return movie(self._scene, path, **options)

    def _repr_html_(self) -> str:
        return cell(self._scene)

    def __repr__(self) -> str:
        return f"<kreisel view, {len(self.html) / 1e6:.1f} MB of HTML; .save('run.html') writes it>"


@explained
def view(
    run: xr.Dataset,
    *,
    lane: Any = None,
    body: str | None = None,
    mesh: str | os.PathLike[str] | None = None,
    section: xr.Dataset | None = None,
) -> View:
    """The interactive page of a run: the body turning, the trace of its axis, the drift of every integral.

    lane      of an ensemble the lane, or up to nine of them; None: up to nine, evenly
    body      "top", "gyroscope", "ellipsoid", "box" or "satellite"; None: what suits the system
    mesh      a file .stl or .obj with the body's shape, in its axes, about the point that it turns about
    section   what `kr.analysis.section` returns, drawn beside

    Shows itself in a notebook; `kr.view(run).save("run.html")` writes a file that opens offline in any browser, and
    `.movie("run.gif")` a film.  What is shown is decided by the record (`kreisel.viewer.showing`).  Give `kr.simulate`
    an orientation to see a body turn.  It plays evenly in time.  Where a body turns by at most 0.8 rad between saved
    states, the motion between them is interpolated; where more, it is computed again from them by the run's own method,
    and the page says so.  At most 100,000 states of one body are shown, the extremes of the vector among them; each
    point of a drift is the largest change in its stretch of time.  Raises `InputError` for what is no run and for a bad
    mesh.
    """
    from kreisel.viewer.meshes import read_mesh

    if body is not None and mesh is not None:
        raise InputError("expected body= or mesh=, got both.")
    shape = None if body is None else known_shape(body)
    return View(run, lane, body=shape if mesh is None else read_mesh(mesh), section=section)
