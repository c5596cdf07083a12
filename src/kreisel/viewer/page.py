"""kr.view, `kreisel view`: a run as one HTML file that needs nothing else, and as a notebook display.

The file holds three.js and uPlot (assets/README.md), Kreisel's script, and the data as JSON in which no markup can
begin.  Text from the archive is set only as text.  Its Content-Security-Policy names the two scripts by their hashes
and allows no request, so nothing else runs in it, for any content of an archive.

In a notebook each cell holds its data, and one cell the scripts.  A cell builds the page in a separate frame, without
the notebook's origin, from its data and the library that the first cell left at `window.kreiselLibrary`.  If the
library is missing, the cell shows a message.

`kreisel view --serve` serves the page of an unfinished run at one address, "/": the page, or for requests of the page
(Accept: application/json) its data, each only if new.  Nothing else is served, nothing is written, and no file is named
by a request.  The server listens on loopback unless another address is given.  On loopback only requests that name the
machine as such are answered: a foreign page cannot read it through another host name.
"""

from __future__ import annotations

import base64
import hashlib
import html
import json
import os
import socket
import sys
import threading
from functools import cache
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib import resources
from pathlib import Path
from string import Template
from typing import Any
from urllib.parse import urlsplit

import xarray as xr

from kreisel.errors import InputError, RunError, explained, require_one_of, shown
from kreisel.files import place_of_page, written
from kreisel.runs.geometry import presented
from kreisel.storage.opening import open_rows
from kreisel.viewer.bodies import SHAPES, read_mesh
from kreisel.viewer.scene import scene

# -- the text of a page: scripts, data and the policy that allows nothing else ---------------------


@cache
def scripts() -> tuple[str, str]:
    """three.js with uPlot, and the script of the page."""
    parts = ("lines.js", "orbit.js", "drawing.js", "charts.js", "page.js")
    return _asset("library.min.js"), "\n".join(map(_asset, parts))


@cache
def _asset(name: str) -> str:
    return resources.files("kreisel.viewer").joinpath("assets", name).read_text(encoding="utf-8")


def as_json(data: Any) -> str:
    """JSON in which no tag, comment or line of script can begin or end."""
    text = json.dumps(data, allow_nan=False, separators=(",", ":"))
    for character in "<>&\u2028\u2029":
        text = text.replace(character, f"\\u{ord(character):04x}")
    return text


def page(data: dict[str, Any], follow: float | None = None) -> str:
    """The page of a scene.  `follow`: seconds between its requests for new data from its server."""
    return filled(as_json({**data, "follow": follow}), data["title"] or "run", scripts()[0], follow is not None)


def filled(data: str, title: str, library: str, served: bool = False) -> str:
    """The page with its data; the policy names the scripts, `library` replaces three.js."""
    digests = (base64.b64encode(hashlib.sha256(text.encode()).digest()).decode("ascii") for text in scripts())
    hashes = " ".join(f"'sha256-{digest}'" for digest in digests)
    # one substitution each, of text that is not searched again
    return Template(_asset("page.html")).substitute(
        policy=f"default-src 'none'; script-src {hashes}; style-src 'unsafe-inline'; img-src data: blob:; "
        f"media-src blob:; connect-src '{'self' if served else 'none'}'; base-uri 'none'; form-action 'none'",
        title=html.escape(title),
        style=_asset("library.css") + _asset("page.css"),
        library=library,
        script=scripts()[1],
        data=data,
    )


# -- cells of a notebook ---------------------------------------------------------------------------


MARK = "\u0001kreisel-library\u0001"  # the placeholder of the library in the page
SANDBOX = "allow-scripts allow-downloads"
WAIT = 10  # seconds for a first cell that is drawn after this one
MISSING = (
    "The script of this page is in an earlier cell, which is not here. Run that cell again, or restart the kernel and "
    "run this one."
)

_carried: dict[str, Any] = {"cell": None, "count": 0}


def cell(data: dict[str, Any]) -> str:
    """The output of a cell.  The first cell of a kernel carries the library, also when it runs again."""
    _carried["count"] += 1
    name = f"kreisel-{_carried['count']}-{abs(hash(data['title'])) % 10**8}"
    fill = {
        "name": as_json(name),
        "page": as_json(filled(as_json({**data, "follow": None}), data["title"] or "run", MARK)),
        "mark": as_json(MARK),
        "lost": as_json(MISSING),
        "version": as_json(version()),
        "sandbox": as_json(SANDBOX),
        "wait": WAIT,
    }
    place = f"(window.kreiselLibrary = window.kreiselLibrary || {{}})[{as_json(version())}]"
    library = f"<script>{place} = {as_json(scripts()[0])};</script>" if _carries() else ""
    script = Template(_asset("cell.js").rstrip("\n")).substitute(fill)
    return f'{library}<div id="{name}">Kreisel: view of a run</div><script>{script}</script>'


def version() -> str:
    """A hash of the scripts: cells of another version do not use them."""
    return hashlib.sha256("".join(scripts()).encode()).hexdigest()[:12]


def _carries() -> bool:
    """Whether this cell is the one that carries the library, or nothing is shared between cells."""
    ask = getattr(sys.modules.get("IPython"), "get_ipython", None)
    try:  # the notebook's name of the running cell, if it gives one
        name = str(ask().get_parent()["metadata"]["cellId"])  # type: ignore[misc]
    except (AttributeError, KeyError, TypeError):
        name = None
    first = _carried["cell"] is None
    if "google.colab" in sys.modules:  # each output is a separate page
        return True
    _carried["cell"] = (name or "the first") if first else _carried["cell"]
    return first or (name is not None and _carried["cell"] == name)


@explained
class View:
    """The page of a run.  A notebook displays it; `save` writes the file; `html` is its text."""

    def __init__(self, run: xr.Dataset, lane: Any = None, **shown: Any):
        self._scene = scene(run, lane, **shown)

    @property
    def html(self) -> str:
        """The complete page."""
        return page(self._scene)

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write the page; a page that Kreisel wrote is replaced.

        Raises `InputError` for other names, and if anything else has that name; `RunError` if the disk refuses.
        """
        target = place_of_page(path)
        with written(target) as scratch:
            scratch.write_text(self.html, encoding="utf-8")
        return target

    def movie(self, path: str | os.PathLike[str], **options: Any) -> Path:
        """Write a film of the first body: .gif, or .mp4 if ffmpeg is installed.

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
    axis: Any = None,
    target: Any = "nadir",
    title: str | None = None,
) -> View:
    """The interactive page of a run: the rotating body, the trace of its axis, the drift of every integral.

    lane      for an ensemble the lane, or up to nine of them; None: up to nine, evenly
    body      "top", "gyroscope", "ellipsoid", "box" or "satellite"; None: the shape that suits the system
    mesh      a file .stl or .obj with the body's shape, in its axes, about its centre of rotation
    section   a result of `kr.analysis.section`, drawn next to it
    axis, target   for a satellite, the axis of the body and the target of the pointing error, as for `kr.plot`
    title     the heading; default: the title of the run

    A notebook displays it; `kr.view(run).save("run.html")` writes a file that opens offline in any browser, and
    `.movie("run.gif")` a film.  The record decides the picture (`kreisel.viewer.scene`).  Give `kr.simulate` an
    orientation to see a body rotate.  It plays evenly in time.  If a body rotates by at most 0.8 rad between saved
    states, the motion between them is interpolated; else it is computed again by the method of the run, and the page
    notes it.  At most 100,000 states of one body are shown, the extremes of the vector among them; each point of a
    drift is the largest change in its stretch of time.  Raises `InputError` for anything but a run, and for a bad mesh.
    """
    if body is not None and mesh is not None:
        raise InputError("expected body= or mesh=, got both.")
    if title is not None and not isinstance(title, str):
        raise InputError(f"title: expected text, got {shown(title)}.")
    run = run if title is None or not hasattr(run, "assign_attrs") else run.assign_attrs(title=title)
    if body is not None:
        require_one_of(SHAPES, body, "body")
    return View(run, lane, body=body if mesh is None else read_mesh(mesh), section=section, axis=axis, target=target)


# -- the page of an unfinished run, served from this machine to this machine -----------------------

LOOPBACK = ("127.0.0.1", "::1", "localhost")
LOOK_EVERY = 2.0  # seconds between two looks
HEADERS = {
    "Cache-Control": "no-store",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Vary": "Accept",
}


class Source:
    """The scene of an archive, computed again when the archive has changed."""

    def __init__(self, path: Path, **options: Any):
        complete = path.with_suffix("") if path.suffix == ".part" else path
        self._complete, self._unfinished, self._options = complete, complete.with_name(complete.name + ".part"), options
        self._lock = threading.Lock()
        self._seen: Any = ()
        self._scene: dict[str, Any] = {}
        self.read()

    def read(self) -> tuple[str, dict[str, Any]]:
        """A tag that changes with the archive, and the scene; the last valid one while the archive is being renamed."""
        with self._lock:
            mark = self._mark()
            if mark != self._seen:
                try:
                    store = self._unfinished if self._unfinished.exists() else self._complete
                    self._scene = view(presented(open_rows(store)), **self._options)._scene
                    self._seen = mark
                except (InputError, RunError, OSError):
                    if not self._scene:
                        raise
            return hashlib.sha256(repr(self._seen).encode()).hexdigest()[:16], self._scene

    def _mark(self) -> Any:
        for store in (self._unfinished, self._complete):
            for name in ("engine/checkpoint", "zarr.json"):
                files = sorted(store.glob(f"{name}*"))
                if files:
                    return [(str(f), f.stat().st_mtime_ns) for f in files if f.exists()]
        return None


class Handler(BaseHTTPRequestHandler):
    """Answers for one page."""

    server: Server
    server_version, sys_version, timeout = "kreisel", "", 30

    def do_GET(self) -> None:
        """The page or its data; for HEAD only their headers."""
        named = urlsplit(f"//{self.headers.get('Host', '')}").hostname
        if self.server.host in LOOPBACK and named not in LOOPBACK:
            return self._send(421, b"", "text/plain")
        if urlsplit(self.path).path != "/":
            return self._send(404, b"Expected the address of the page: /\n", "text/plain")
        tag, data = self.server.source.read()
        wants_data = "application/json" in self.headers.get("Accept", "")
        tag = f'"{tag}-{"data" if wants_data else "page"}"'
        if self.headers.get("If-None-Match") == tag:
            return self._send(304, b"", "text/plain", tag)
        text = as_json({**data, "follow": LOOK_EVERY}) if wants_data else page(data, LOOK_EVERY)
        kind = "application/json" if wants_data else "text/html; charset=utf-8"
        return self._send(200, text.encode(), kind, tag)

    do_HEAD = do_GET

    def _send(self, status: int, text: bytes, kind: str, tag: str = "") -> None:
        self.send_response(status)
        headers = {"Content-Type": kind, "Content-Length": str(len(text)), **HEADERS, **({"ETag": tag} if tag else {})}
        for name, value in headers.items():
            self.send_header(name, value)
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(text)

    def log_message(self, format: str, *args: Any) -> None:
        """Log nothing on the terminal."""


class Server(ThreadingHTTPServer):
    """Serves the page of a source under an address of this machine."""

    daemon_threads = True

    def __init__(self, source: Source, host: str, port: int):
        self.source, self.host = source, host
        self.address_family = socket.AF_INET6 if ":" in host else socket.AF_INET
        super().__init__((host, port), Handler)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Ignore a browser that has disconnected."""


def server(path: Path, *, host: str = "127.0.0.1", port: int = 0, **options: Any) -> Server:
    """A server of one page, with options of `kr.view`, bound but not yet serving.

    Raises `InputError` for no archive or an address in use.
    """
    source = Source(path, **options)
    try:
        return Server(source, host, port)
    except (OSError, OverflowError) as error:
        raise InputError(f"{host}:{port} cannot be served: {error}. Choose another --port or --host.") from error


def address(serving: ThreadingHTTPServer) -> str:
    """The address of the page."""
    host, port = serving.server_address[:2]
    name = f"[{host!s}]" if ":" in str(host) else str(host)
    return f"http://{name}:{port}/"
