"""The text of a page: scripts, data and the policy that allows nothing else."""

from __future__ import annotations

import base64
import hashlib
import html
import json
from functools import cache
from importlib import resources
from string import Template
from typing import Any


@cache
def scripts() -> tuple[str, str]:
    """three.js with uPlot, and the page's own script."""
    return _asset("library.min.js"), "\n".join(map(_asset, ("lines.js", "drawing.js", "charts.js", "page.js")))


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
    """The page of a scene.  `follow`: it asks its server for news every so many seconds."""
    return filled(as_json({**data, "follow": follow}), data["title"] or "run", scripts()[0], follow is not None)


def filled(data: str, title: str, library: str, served: bool = False) -> str:
    """The page with its data; the policy names the scripts, `library` stands where three.js does."""
    hashes = " ".join(f"'sha256-{_hash(text)}'" for text in scripts())
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


@cache
def _hash(text: str) -> str:
    return base64.b64encode(hashlib.sha256(text.encode()).digest()).decode("ascii")
