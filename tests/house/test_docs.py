"""The tools of the documentation: what executes the pages notices what is wrong; typeset equations are the record's."""

from __future__ import annotations

import fnmatch
import importlib
import inspect
import re
import runpy
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest

import kreisel as kr
from kreisel.lab import exact
from kreisel.method import METHODS
from kreisel.system import REGISTRY
from sizes import FULL, PAPER
from support import ROOT

DOCS = ROOT / "docs"
PARTS = [
    "Tutorials",
    "Satellites",
    "Asteroids and moons",
    "Other bodies",
    "Runs",
    "Other programs",
    "Your own system",
    "Concepts",
    "Reference",
    "Notes",
]

PAGE = """# A page

```python
x = 1.5
print("x is", 2 * x)
```

```text
{shown}
```

Text.

```python
{code}
```
"""


@pytest.fixture
def tools(monkeypatch: pytest.MonkeyPatch) -> object:
    monkeypatch.syspath_prepend(str(DOCS / "tools"))
    yield importlib.import_module
    for name in ("pages", "typeset", "methods", "notebooks", "mathml", "commands"):
        sys.modules.pop(name, None)


@pytest.mark.parametrize(
    ("shown", "code", "complaints"),
    [
        ("x is 3.0", "assert x == 1.5", 0),
        ("x is 3.00000001", "x", 0),
        ("x is 3.1", "x", 1),
        ("y is 3.0", "x", 1),
        ("x is", "x", 1),
        ("x is 3.0 and 4", "x", 1),
        ("x is 3.0", "assert x == 2", 1),
        ("x is 3.0", "import warnings; warnings.warn('old')", 1),
        ("x is 3.0", "x +", 1),
    ],
)
def test_what_is_wrong_on_a_page_is_noticed(tools, tmp_path: Path, shown: str, code: str, complaints: int) -> None:
    page = tmp_path / "page.md"
    page.write_text(PAGE.format(shown=shown, code=code))
    message = tools("pages").execute(page)
    assert len(message) == complaints
    if message:
        line = 15 if shown == "x is 3.0" else 4
        assert f"page.md:{line}" in message[0]


def test_round_off_may_differ(tools) -> None:
    same = tools("pages").same
    assert same("drift 3e-14", "drift 8.1e-15") and not same("drift 3e-8", "drift 8e-8")
    assert same("1,000 steps", "1,000   steps") and not same("1,000 steps", "1,001 steps")


def test_every_python_block_is_executed_or_says_why_not(tools) -> None:
    """Blocks with other headings than exactly python would be overlooked."""
    for page in DOCS.glob("*.md"):
        text = page.read_text(encoding="utf-8")
        there = len(re.findall(r"^[ \t]*```[^\w\n]*py", text, re.MULTILINE)) - text.count("<!-- not run: ")
        hidden = text.count("<!-- python\n")
        assert there + hidden == len(tools("pages").blocks(text)), page.name


def test_hidden_and_skipped_blocks(tools) -> None:
    text = "<!-- python\nx = 1\n-->\n\n<!-- not run: a cluster -->\n```python\n1 / 0\n```\n\n```python\nprint(x)\n```\n"
    assert [block.code for block in tools("pages").blocks(text)] == ["x = 1\n", "print(x)\n"]


NOTEBOOKS = sorted(page for kind in ("tutorial-*.md", "guide-*.md") for page in DOCS.glob(kind))


def test_there_are_six_notebooks_and_more() -> None:
    assert len(NOTEBOOKS) >= 6 and len({page.stem.split("-")[0] for page in NOTEBOOKS}) == 2


@pytest.mark.parametrize("page", NOTEBOOKS, ids=lambda page: page.stem)
def test_tutorials_and_guides_are_notebooks(tools, page: Path, tmp_path: Path) -> None:
    """The code of the page, which is executed; its picture, what it prints; no link to a page."""
    pytest.importorskip("nbformat")
    text = page.read_text(encoding="utf-8")
    assert text.startswith("# ") and text.split("\n", 1)[0].endswith("?")
    assert f'<a href="notebooks/{page.stem}.ipynb" download>' in text
    (picture,) = re.findall(r"generated/figures/([\w-]+\.png)", text)
    (tmp_path / picture).write_bytes(b"a picture")
    made = tools("notebooks").notebook(text, tmp_path)
    blocks = tools("pages").blocks(text)
    code = [cell for cell in made.cells if cell.cell_type == "code"]
    assert [cell.source for cell in code] == [block.code.rstrip("\n") for block in blocks] and len(code) > 1
    streams = ["".join(o.text for o in cell.outputs if o.output_type == "stream") or None for cell in code]
    assert streams == [block.shown for block in blocks]
    pictures = [o for cell in code for o in cell.outputs if o.output_type == "display_data"]
    assert [o.data["image/png"] for o in pictures] == ["YSBwaWN0dXJl"]
    words = "\n".join(cell.source for cell in made.cells if cell.cell_type == "markdown")
    assert ".md" not in words and "<a " not in words and page.stem not in words


OF_EVERY_KIND = [*PAPER, "rubanovskii", "ratiu-bitop", "quadratic-field", "lagrange-top-su2", "rosochatius"]
TYPESET = [name for name in (REGISTRY if FULL else OF_EVERY_KIND) if REGISTRY[name].numbers == "any"]


@pytest.mark.parametrize("name", TYPESET)
def test_typeset_equations_are_those_of_the_record(tools, name: str) -> None:
    """SymPy's right sides and Hamiltonian at a random point, against the functions in floats."""
    sp = pytest.importorskip("sympy")
    system = REGISTRY[name]
    typeset = tools("typeset")
    symbolic = typeset.typeset(system)
    draw = exact.float_random(np.random.default_rng(3))
    state = system.space.point(symbolic.n, draw)
    flat = [typeset.flat(kind, z) for z, kind in zip(state, system.space.kinds, strict=True)]
    values = dict(zip(symbolic.names, np.concatenate(flat), strict=True))
    numbers, params = {}, {}
    for letter, entries in symbolic.params.items():
        free = sorted(set().union(*(sp.sympify(e).free_symbols for e in np.ravel(entries))), key=str)
        numbers |= {symbol: float(i + 1.3) for i, symbol in enumerate(free)}
        params[letter] = np.array([sp.sympify(e).subs(numbers) for e in np.ravel(entries)], dtype=float).reshape(
            np.shape(entries)
        )
    model = system(**params)
    rates = model.flow(*state)
    wanted = np.concatenate([typeset.flat(kind, z) for z, kind in zip(rates, system.space.kinds, strict=True)])
    found = [float(rate.subs(values | numbers)) for _, rate in symbolic.rates()]
    assert np.allclose(found, wanted, rtol=1e-12, atol=1e-13)
    energy = float(symbolic.hamiltonian().subs(values | numbers))
    assert energy == pytest.approx(float(model.call(system.energy, *state)), rel=1e-12)


def test_the_plain_equations_become_latex(tools) -> None:
    from_text = tools("typeset").from_text
    assert from_text("m' = a ^ p,  a' = m a") == r"m' = a \wedge p,\quad a' = m a"
    assert from_text("<x, Bx> + |q|^2") == r"\langle x, Bx \rangle + \lvert q\rvert^2"
    assert from_text("Omega_jk = c_jk M_jk") == r"\Omega_{jk} = c_{jk} M_{jk}"


def formulas() -> set[str]:
    """All sentences of the records that have formulas, and their equations."""
    out = set()
    for system in REGISTRY.values():
        parts = [p.meaning for p in system.parameters] + [r.meaning for r in system.relations]
        checks = [inspect.getdoc(p.check) or "" for p in system.parameters if p.check is not None]
        out |= {*parts, *checks, system.scaling, system.notes}
    return out


def test_no_formula_of_a_record_stays_in_plain_text(tools) -> None:
    """All of them are LaTeX that can be drawn; between them are words only."""
    typeset, mathml = tools("typeset"), tools("mathml").mathml
    equations = [typeset.from_text(system.equations) for system in REGISTRY.values()]
    sentences = [typeset.prose(text) for text in formulas()]
    drawn = equations + [each for text in sentences for each in re.findall(r"\$([^$]+)\$", text)]
    assert len(drawn) > 150
    for tex in drawn:
        assert mathml(tex).startswith("<math")
        assert not re.search(r"(?<![\\{])\b(sqrt|sum|tr|log|alpha|Omega|pi)\b|(?<!=) x [A-Z\\]", tex), tex
    rest = [re.sub(r"\$[^$]+\$|`[^`]+`|\[[^\]]*\](\([^)]*\))?", "", text) for text in sentences]
    assert not [text for text in rest if re.search(r"[=^|]|\w_\w|sqrt|<", text.replace("&lt;", "<"))]


def test_formulas_among_words(tools) -> None:
    prose = tools("typeset").prose
    assert prose("take the time unit sqrt(I1/(M g l)), and |a| = |p| = 1.") == (
        r"take the time unit $\sqrt{I_{1}/(M g l)}$, and $\lvert a\rvert = \lvert p\rvert = 1$."
    )
    assert prose("a step of A map: H has -<P, BP>/2") == r"a step of A map: $H$ has $-\langle P, BP \rangle/2$"
    assert prose("See clebsch-body (n = 3).") == "See [`clebsch-body`](clebsch-body.md) ($n = 3$)."


def test_a_cross_product_is_no_letter(tools) -> None:
    from_text = tools("typeset").from_text
    assert from_text("M' = M x Omega + P x dH/dP") == r"M' = M \times \Omega + P \times \partial H/\partial P"
    assert from_text("sum m x x^T") == r"\sum m x x^T" and from_text("f_i = b_i x_i") == "f_i = b_i x_i"


def test_brackets_of_a_matrix_are_drawn_by_the_style_sheet(tools) -> None:
    mathml = tools("mathml").mathml
    markup = mathml(r"L = \begin{pmatrix}a & b \\ c & d\end{pmatrix}", True)
    assert markup.count('<mtable class="matrix">') == 1 and "<mo>(</mo>" not in markup
    assert "mtable.matrix" in (DOCS / "static" / "kreisel.css").read_text(encoding="utf-8")
    assert "(</mo>" in mathml("f(x)")


def test_the_key_of_a_page_changes_with_the_page_and_the_sources(tools, tmp_path: Path, monkeypatch) -> None:
    pages = tools("pages")
    monkeypatch.setattr(pages, "DOCS", tmp_path / "docs")
    (tmp_path / "docs").mkdir()
    (tmp_path / "src" / "kreisel").mkdir(parents=True)
    (tmp_path / "benchmarks").mkdir()
    for name in ("tables.py", "history.py", "history.jsonl"):
        (tmp_path / "benchmarks" / name).write_text("")
    found = []
    for page, source in (("a", "x"), ("b", "x"), ("b", "y"), ("a", "x")):
        (tmp_path / "docs" / "page.md").write_text(page)
        (tmp_path / "src" / "kreisel" / "step.py").write_text(source)
        pages._sources.cache_clear()
        found.append(pages.key("page.md"))
    assert found[0] == found[3] and len({*found}) == 3


def test_every_command_has_its_help(tools, tmp_path: Path) -> None:
    import typer

    from kreisel.cli import app

    tools("commands").write(tmp_path)
    text = (tmp_path / "generated" / "commands.md").read_text(encoding="utf-8")
    names = [name for name, each in typer.main.get_command(app).commands.items() if not each.hidden]
    assert re.findall(r"^## kreisel (\S+)$", text, re.MULTILINE) == names and len(names) > 10
    assert text.count("Usage: kreisel") == len(names) and "--help" in text


def test_every_page_is_in_a_part_of_the_site() -> None:
    """And every part but the notes has at most seven pages."""
    index = (DOCS / "index.md").read_text(encoding="utf-8")
    parts = re.findall(r":caption: (.+)\n\n((?:.+\n)+)```", index)
    assert [name for name, _ in parts] == PARTS and all(text.count("\n") <= 7 for _, text in parts[:-1])
    texts = [page.read_text(encoding="utf-8") for page in DOCS.glob("*.md")]
    listed = "\n".join(block for text in texts for block in re.findall(r"```\{toctree\}(.*?)```", text, re.DOTALL))
    entries = [re.sub(r".*<(.*)>", r"\1", line).strip() for line in listed.splitlines() if line and line[0] != ":"]
    for page in DOCS.glob("*.md"):
        assert page.stem == "index" or any(fnmatch.fnmatch(page.stem, entry) for entry in entries), page.name


def test_the_history_has_what_was_measured_last(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    history = importlib.import_module("history")
    found = history.lines()
    assert len(found) > 10 and [row["date"] for row in found] == sorted(row["date"] for row in found)
    (tmp_path / "history.jsonl").write_text((ROOT / "benchmarks" / "history.jsonl").read_text())
    history.append(tmp_path / "history.jsonl")
    added = history.lines(tmp_path / "history.jsonl")
    assert added[:-1] == found and {*added[-1]["ns a step"]} == {*found[-1]["ns a step"]}
    assert len(history.figure().axes) == 2


def test_every_method_stands_in_every_list_of_them(tools, tmp_path: Path) -> None:
    page = (DOCS / "cli.md").read_text(encoding="utf-8")
    assert "{include} generated/methods-table.md" in (DOCS / "methods.md").read_text(encoding="utf-8")
    tools("methods").write(tmp_path)
    table = (tmp_path / "generated" / "methods-table.md").read_text(encoding="utf-8")
    toml = next(line for line in page.splitlines() if line.startswith("method = "))
    for name in METHODS:
        assert re.search(rf"^\| \[?`{name}`", table, re.MULTILINE), name
        assert f'"{name}"' in toml, name


def test_every_public_name_is_in_the_api_or_has_a_page() -> None:
    from kreisel.record.contract import System

    api = (DOCS / "api.md").read_text(encoding="utf-8")
    for name in kr.__all__:
        documented = isinstance(getattr(kr, name), System) or re.search(rf"kreisel\.{name}\n", api)
        assert documented, name
    for part in kr._PARTS:
        module = importlib.import_module(f"kreisel.{part}")
        whole = re.search(rf"automodule:: kreisel\.{part}\n   :members:\n", api)  # all that is in __all__
        for name in [] if whole else getattr(module, "__all__", []):
            assert re.search(rf"\b{name}\b", api), f"kreisel.{part}.{name}"


@pytest.mark.parametrize(
    ("origin", "address"),
    [
        ("https://example.org/kreisel.git", "https://example.org/kreisel"),
        ("https://name:secret@example.org/kreisel.git", None),  # a token never gets onto a page
        ("/somewhere/kreisel", None),
    ],
)
def test_the_site_links_to_the_repository_that_its_clone_came_from(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, origin: str, address: str | None
) -> None:
    (tmp_path / "git").write_text(f"#!/bin/sh\necho {origin}\n")  # in place of git, which may not be installed
    (tmp_path / "git").chmod(0o700)
    monkeypatch.setenv("PATH", str(tmp_path))
    (tmp_path / "docs").mkdir()
    shutil.copy(ROOT / "docs" / "conf.py", tmp_path / "docs")
    settings = runpy.run_path(str(tmp_path / "docs" / "conf.py"))
    icons = settings.get("html_theme_options", {}).get("footer_icons", [{"url": None}])
    assert [icon["url"] for icon in icons] == [address]
