"""Configuration of Sphinx.  `make docs` runs tools/pages.py first: it executes the code on the pages and writes
generated/, the pages made from the records, the gallery and the benchmarks.
"""

import re
import sys
from pathlib import Path

import kreisel

sys.path.insert(0, str(Path(__file__).parent / "tools"))

project, author = "Kreisel", "The Kreisel developers"
release = version = kreisel.__version__
copyright = f"2026, {author}"
extensions = ["myst_parser", "sphinx.ext.autodoc", "mathml"]
html_math_renderer = "mathml"
myst_enable_extensions = ["dollarmath", "amsmath", "deflist", "colon_fence"]
myst_heading_anchors = 3
exclude_patterns = ["tools", "README.md"]
html_theme = "furo"
html_title = f"Kreisel {release}"
html_static_path = ["static"]
html_css_files = ["kreisel.css"]
html_copy_source = html_show_sourcelink = False
html_show_sphinx = False
pygments_style, pygments_dark_style = "friendly", "github-dark"
autodoc_typehints = "signature"
autodoc_member_order = "bysource"
autodoc_preserve_defaults = True
python_maximum_signature_line_length = 80


def as_written(app, what, name, obj, options, lines):
    """The house's docstrings are plain text: the summary as a paragraph, the rest as it stands."""
    end = lines.index("") if "" in lines else len(lines)
    told = re.sub(r"([*_|\\])", r"\\\1", " ".join(lines[:end]).strip())
    told = re.sub(r"`([^`]+)`", lambda m: f"``{m[1]}``".replace("\\", ""), told)
    rest = [f"   {line}" for line in lines[end:]]
    lines[:] = [told, "", *([".. code-block:: text", "", *rest, ""] if any(r.strip() for r in rest) else [])]


def present(app, docname, source):
    """Entries NAME* of the tables of contents whose pages are not there are left out."""
    lines = source[0].split("\n")
    here = Path(app.srcdir) / Path(docname).parent
    source[0] = "\n".join(x for x in lines if not re.fullmatch(r"[\w/-]+\*", x) or any(here.glob(x + ".md")))


def setup(app):
    """Connect what is above."""
    app.connect("source-read", present)
    app.connect("autodoc-process-docstring", as_written)
