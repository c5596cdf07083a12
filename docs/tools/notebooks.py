"""Tutorials and guides as notebooks: text, code, and what it prints and draws.

Written after the pages are executed, whose code they have, block by block: each notebook was run from top to bottom.
"""

from __future__ import annotations

import base64
import re
from pathlib import Path

import nbformat
from nbformat import v4
from pages import FENCE, FIGURES

PICTURE = re.compile(r"^!\[[^\]]*\]\(generated/figures/([\w-]+\.png)\)\n?", re.MULTILINE)
LINK = re.compile(r"\[([^\]]+)\]\((?!http)[^)]*\)")  # to other pages, which a notebook does not have
DOWNLOAD = re.compile(r"\s*<a href=\"notebooks/.*?</a>\.")
KINDS = ("tutorial-*.md", "guide-*.md")
KERNEL = {"kernelspec": {"name": "python3", "display_name": "Python 3", "language": "python"}}


def notebook(text: str, figures: Path = FIGURES) -> nbformat.NotebookNode:
    """A page as a notebook: python blocks are cells of code, the text blocks after them what these print."""
    cells: list[nbformat.NotebookNode] = []
    place = 0
    for fence in (found for found in FENCE.finditer(text) if found[1] in ("python", "text")):
        _words(cells, text[place : fence.start()], figures)
        place = fence.end()
        if fence[1] == "python":
            cells.append(v4.new_code_cell(fence[2].rstrip("\n"), id=f"cell-{len(cells)}"))
        elif cells and cells[-1].cell_type == "code":
            cells[-1].outputs.append(v4.new_output("stream", name="stdout", text=fence[2]))
    _words(cells, text[place:], figures)
    made = v4.new_notebook(cells=cells, metadata=KERNEL)
    nbformat.validate(made)
    return made


def _words(cells: list[nbformat.NotebookNode], text: str, figures: Path) -> None:
    """Text, as a cell of its own; its pictures belong to the code before."""
    for picture in PICTURE.findall(text):
        data = base64.b64encode((figures / picture).read_bytes()).decode("ascii")
        cells[-1].outputs.append(v4.new_output("display_data", data={"image/png": data}))
    words = LINK.sub(r"\1", DOWNLOAD.sub("", PICTURE.sub("", text))).strip()
    if words:
        cells.append(v4.new_markdown_cell(words, id=f"cell-{len(cells)}"))


def write(docs: Path) -> None:
    """generated/extra/notebooks/*.ipynb."""
    folder = docs / "generated" / "extra" / "notebooks"
    folder.mkdir(parents=True, exist_ok=True)
    for page in sorted(page for kind in KINDS for page in docs.glob(kind)):
        made = notebook(page.read_text(encoding="utf-8"))
        (folder / f"{page.stem}.ipynb").write_text(nbformat.writes(made), encoding="utf-8")
