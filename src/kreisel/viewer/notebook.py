"""The page of a run in a notebook: each cell holds its data, one cell of a notebook the scripts.

A cell builds the page in a frame of its own, without the notebook's origin, from its data and the library that the
first cell has left at `window.kreiselLibrary`.  Where that is missing, the cell says so.
"""

from __future__ import annotations

import sys
from typing import Any

from kreisel.viewer.document import as_json, filled, scripts

MARK = "\u0001kreisel-library\u0001"  # stands in the page for the library
SANDBOX = "allow-scripts allow-downloads"
WAIT = 10  # seconds for a first cell that is drawn after this one
MISSING = (
    "The script of this page is in an earlier cell, which is not here. Run that cell again, or restart the kernel and "
    "run this one."
)
SCRIPT = """(() => {
const box = document.getElementById(%(name)s), page = %(page)s, mark = %(mark)s, lost = %(lost)s, version = %(version)s;
const begun = Date.now();
const show = () => {
  const library = window.kreiselLibrary && window.kreiselLibrary[version];
  if (library) {
    const frame = document.createElement("iframe");
    frame.setAttribute("sandbox", %(sandbox)s); frame.title = "Kreisel: view of a run";
    frame.style.cssText = "width:100%%;height:660px;border:0"; frame.srcdoc = page.split(mark).join(library);
    box.replaceChildren(frame);
  } else if (Date.now() - begun > 1000 * %(wait)d) box.textContent = lost;
  else setTimeout(show, 100);
};
show();
})();"""

_carried: dict[str, Any] = {"cell": None, "count": 0}


def cell(data: dict[str, Any]) -> str:
    """The output of a cell.  The first of a kernel carries the library; so does that cell when it runs again."""
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
    library = f"<script>{_library()}</script>" if _carries() else ""
    return f'{library}<div id="{name}">Kreisel: view of a run</div><script>{SCRIPT % fill}</script>'


def version() -> str:
    """What the scripts are: cells made by another version do not take them."""
    import hashlib

    return hashlib.sha256("".join(scripts()).encode()).hexdigest()[:12]


def _library() -> str:
    at = f"(window.kreiselLibrary = window.kreiselLibrary || {{}})[{as_json(version())}]"
    return f"{at} = {as_json(scripts()[0])};"


def _carries() -> bool:
    """Whether this cell is the one that carries the library, or nothing is shared between cells."""
    here = _cell_id()
    if "google.colab" in sys.modules:  # each output is a page of its own
        return True
    if _carried["cell"] is None:
        _carried["cell"] = here or "the first"
        return True
    return here is not None and _carried["cell"] == here


def _cell_id() -> str | None:
    """The notebook's name of the cell that runs, if it gives one."""
    ask = getattr(sys.modules.get("IPython"), "get_ipython", None)
    shell = ask() if ask is not None else None
    try:
        return str(shell.get_parent()["metadata"]["cellId"])  # type: ignore[union-attr]
    except (AttributeError, KeyError, TypeError):
        return None
