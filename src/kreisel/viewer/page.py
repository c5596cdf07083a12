"""kr.view, `kreisel view`: a run as one HTML file that needs nothing else, and as a notebook display.

The file holds plotly's JavaScript, Kreisel's own, and the data as JSON in which no markup can begin.  Text from the
archive is only ever set as text.  Its Content-Security-Policy names the two scripts by their hashes and allows no
request, so that nothing else runs in it, whatever an archive says.
"""

from __future__ import annotations

import base64
import hashlib
import html
import json
import os
from functools import cache
from importlib import resources
from pathlib import Path
from string import Template
from typing import TYPE_CHECKING, Any

from kreisel.errors import InputError, explained
from kreisel.storage.reading import place
from kreisel.storage.replacing import written
from kreisel.viewer.scene import scene

if TYPE_CHECKING:
    import xarray as xr


class View:
    """The page of a run.  In a notebook it shows itself; `save` writes the file; `html` is its text."""

    def __init__(self, run: xr.Dataset, lane: int = 0):
        self.html = page(scene(run, lane))

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write the page; a page that Kreisel wrote is replaced.

        Raises `InputError` where anything else has that name, and `RunError` where the disk refuses.
        """
        target = place(path, "The page needs a name such as top.html")
        with written(target) as scratch:
            scratch.write_text(self.html, encoding="utf-8")
        return target

    def _repr_html_(self) -> str:
        inside = html.escape(self.html, quote=True)
        frame = 'sandbox="allow-scripts" style="width:100%;height:640px;border:0" title="Kreisel: view of a run"'
        return f'<iframe {frame} srcdoc="{inside}"></iframe>'

    def __repr__(self) -> str:
        return f"<kreisel view, {len(self.html) / 1e6:.1f} MB of HTML; .save('run.html') writes it>"


@explained
def view(run: xr.Dataset, *, lane: int = 0) -> View:
    """The interactive page of a run: the body turning, the trace of its axis, the drift of every integral.

    Shows itself in a notebook; `kr.view(run).save("run.html")` writes a file that opens offline in any browser.  Of an
    ensemble one lane.  Needs plotly (extra `view`).  What is shown is decided by the record (`kreisel.viewer.scene`).
    Give `kr.simulate` an orientation to see a body turn.  At most 100,000 states are shown, the extremes of the vector
    among them; each point of a drift is the largest change in its stretch of time.  Raises `InputError` without plotly
    and for what is no run.
    """
    return View(run, lane)


@cache
def scripts() -> tuple[str, str]:
    """plotly.js and the page's own script.  Raises `InputError` without plotly."""
    try:
        from plotly.offline import get_plotlyjs
    except ImportError as error:
        raise InputError("The page needs plotly: pip install 'kreisel[view]'.") from error
    return str(get_plotlyjs()), _asset("page.js")


def _asset(name: str) -> str:
    return resources.files("kreisel.viewer").joinpath("assets", name).read_text(encoding="utf-8")


def as_json(data: Any) -> str:
    """JSON in which no tag, comment or line of script can begin or end."""
    text = json.dumps(data, allow_nan=False, separators=(",", ":"))
    for character in "<>&\u2028\u2029":
        text = text.replace(character, f"\\u{ord(character):04x}")
    return text


def page(data: dict[str, Any], follow: float | None = None) -> str:
    """The page of a scene.  `follow`: it asks its server for news every so many seconds."""
    library, own = scripts()
    hashes = " ".join(f"'sha256-{_hash(text)}'" for text in (library, own))
    # one substitution each, of text that is not searched again
    return Template(_asset("page.html")).substitute(
        policy=f"default-src 'none'; script-src {hashes}; style-src 'unsafe-inline'; img-src data: blob:; "
        f"connect-src '{'none' if follow is None else 'self'}'; base-uri 'none'; form-action 'none'",
        title=html.escape(data["title"] or "run"),
        style=_asset("page.css"),
        library=library,
        script=own,
        data=as_json({**data, "follow": follow}),
    )


def _hash(text: str) -> str:
    return base64.b64encode(hashlib.sha256(text.encode()).digest()).decode("ascii")
