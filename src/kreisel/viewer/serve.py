"""`kreisel view --serve`: the page of an unfinished run, from this machine to this machine.

One address, "/": the page, or for requests of the page (Accept: application/json) its data, each only if new.  Nothing
else is served, nothing is written, and no file is named by a request.  The server listens on loopback unless another
address is given.  On loopback only requests that name the machine as such are answered: a foreign page cannot read it
through another host name.
"""

from __future__ import annotations

import hashlib
import socket
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from kreisel.errors import InputError, RunError
from kreisel.storage.opening import open_rows
from kreisel.viewer.page import as_json, page
from kreisel.viewer.scene import scene

LOOPBACK = ("127.0.0.1", "::1", "localhost")
EVERY = 2.0  # seconds between two looks
HEADERS = {
    "Cache-Control": "no-store",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Vary": "Accept",
}


class Source:
    """The scene of an archive, computed again when the archive has changed."""

    def __init__(self, path: Path, lane: Any = None):
        complete = path.with_suffix("") if path.suffix == ".part" else path
        self._complete, self._unfinished, self._lane = complete, complete.with_name(complete.name + ".part"), lane
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
                    self._scene = scene(
                        open_rows(self._unfinished if self._unfinished.exists() else self._complete), self._lane
                    )
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
        text = as_json({**data, "follow": EVERY}) if wants_data else page(data, EVERY)
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


def server(path: Path, *, host: str = "127.0.0.1", port: int = 0, lane: Any = None) -> Server:
    """A server of one page, bound but not yet serving.  Raises `InputError` for no archive or an address in use."""
    source = Source(path, lane)
    try:
        return Server(source, host, port)
    except (OSError, OverflowError) as error:
        raise InputError(f"{host}:{port} cannot be served: {error}. Choose another --port or --host.") from error


def address(serving: ThreadingHTTPServer) -> str:
    """The address of the page."""
    host, port = serving.server_address[:2]
    name = f"[{host!s}]" if ":" in str(host) else str(host)
    return f"http://{name}:{port}/"
