"""Configuration of Sphinx.  `make docs` runs tools/pages.py first: it executes the code on the pages and writes
generated/, the pages made from the records, the gallery and the benchmarks.
"""

import html
import importlib.metadata
import itertools
import re
import shutil
import subprocess
import sys
import textwrap
from pathlib import Path

from docutils import nodes

import kreisel

sys.path.insert(0, str(Path(__file__).parent / "tools"))

project, author = "Kreisel", "The Kreisel developers"
release = version = kreisel.__version__
copyright = f"2026, {author}"
extensions = ["myst_parser", "sphinx.ext.autodoc", "mathml"]
html_math_renderer = "mathml"
myst_enable_extensions = ["dollarmath", "amsmath", "deflist", "colon_fence"]
myst_heading_anchors = 3
exclude_patterns = ["tools", "generated/extra", "generated/commands.md", "generated/check-cases.md"]
smartquotes = False
html_theme = "furo"
html_title = f"Kreisel {release}"
html_static_path = ["static"]
html_extra_path = ["generated/extra"]
html_css_files, html_js_files, html_favicon = ["kreisel.css"], ["copy.js"], "static/favicon.svg"
html_show_search_summary = False  # summaries are requested from a server: the site opens as files too
html_copy_source = html_show_sourcelink = False
html_show_sphinx = False
links = dict(line.split(", ", 1) for line in importlib.metadata.metadata("kreisel").get_all("Project-URL", []))


def address_of_repository():
    """The address that pyproject.toml states, else the https address that the clone came from, else None."""
    if "Repository" in links:
        return links["Repository"]
    command = ["git", "-C", Path(__file__).parent, "config", "--get", "remote.origin.url"]
    if shutil.which("git") is None:
        return None
    address = subprocess.run(command, capture_output=True, text=True, check=False).stdout.strip()
    return address.removesuffix(".git") if re.fullmatch(r"https://[^@\s]+", address) else None


repository = address_of_repository()
if repository:
    html_theme_options = {"footer_icons": [{"name": "Repository", "url": repository, "html": "repository"}]}
pygments_style, pygments_dark_style = "friendly", "github-dark"
autodoc_typehints = "signature"
autodoc_member_order = "bysource"
autodoc_preserve_defaults = True
python_maximum_signature_line_length = 80


ROW = re.compile(r"(\S.{0,44}?[^.\s]|\S)\s{2,}(\S.*)")


def inline(text):
    """A line of plain text as reStructuredText: `code` as code, all else as it stands."""
    parts = re.split(r"`([^`]+)`", text)
    return "".join(f"``{p}``" if i % 2 else re.sub(r"([*_|\\])", r"\\\1", p) for i, p in enumerate(parts))


def paragraph(lines):
    """Rows "name   meaning" become a definition list, indented formulas stay as they are, the rest is text."""
    heads = [line for line in lines if not line.startswith(" ")]
    if not heads:
        return [".. code-block:: text", "", *(f"   {line}" for line in lines), ""]
    if not all(ROW.fullmatch(line) for line in heads):
        return [inline(" ".join(line.strip() for line in lines)), ""]
    out = []
    for line in lines:
        row = ROW.fullmatch(line) if not line.startswith(" ") else None
        out += [f"``{row[1]}``", f"   {inline(row[2])}"] if row else [f"   {inline(line.strip())}"]
    return [*out, ""]


def as_written(app, what, name, obj, options, lines):
    """The house's docstrings are plain text."""
    groups = [list(group) for filled, group in itertools.groupby(lines, key=bool) if filled]
    lines[:] = [line for group in groups for line in paragraph(group)]


def present(app, docname, source):
    """Entries NAME* of the tables of contents whose pages are not there are left out."""
    lines = source[0].split("\n")
    here = Path(app.srcdir) / Path(docname).parent
    source[0] = "\n".join(x for x in lines if not re.fullmatch(r"[\w/-]+\*", x) or any(here.glob(x + ".md")))


def described(app, docname, template, context, doctree):
    """The first paragraph of a page is its description for search engines and previews."""
    paragraph = next(iter(doctree.findall(nodes.paragraph)), None) if doctree is not None else None
    if paragraph is not None:
        text = textwrap.shorten(paragraph.astext(), 200, placeholder=" ...")
        context["metatags"] += f'\n<meta name="description" content="{html.escape(text)}">'


def setup(app):
    """Connect the functions above."""
    app.connect("html-page-context", described)
    app.connect("source-read", present)
    app.connect("autodoc-process-docstring", as_written)
