"""The tools of the documentation: what executes the pages notices what is wrong; typeset equations are the record's."""

from __future__ import annotations

import importlib
import re
import sys
from pathlib import Path

import numpy as np
import pytest

import kreisel as kr
from kreisel.lab import exact
from kreisel.method import METHODS
from kreisel.system import REGISTRY
from support import ROOT

DOCS = ROOT / "docs"

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
    for name in ("pages", "typeset", "methods", "notebooks"):
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


@pytest.mark.parametrize("page", sorted(DOCS.glob("guide-*.md")), ids=lambda page: page.stem)
def test_guides_are_notebooks(tools, page: Path, tmp_path: Path) -> None:
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


@pytest.mark.parametrize("name", [name for name, system in REGISTRY.items() if system.numbers == "any"])
def test_typeset_equations_are_those_of_the_record(tools, name: str) -> None:
    """SymPy's right sides and Hamiltonian at a random point, against the functions in floats."""
    sp = pytest.importorskip("sympy")
    system = REGISTRY[name]
    typeset = tools("typeset")
    symbolic = typeset.typeset(system)
    draw = exact.float_random(np.random.default_rng(3))
    state = exact.random_state(system.space, symbolic.n, draw)
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


def test_every_method_stands_in_every_list_of_them(tools, tmp_path: Path) -> None:
    readme = (DOCS.parent / "README.md").read_text(encoding="utf-8")
    assert "{include} generated/methods-table.md" in (DOCS / "methods.md").read_text(encoding="utf-8")
    tools("methods").write(tmp_path)
    table = (tmp_path / "generated" / "methods-table.md").read_text(encoding="utf-8")
    toml = next(line for line in readme.splitlines() if line.startswith("method = "))
    for name in METHODS:
        for text in (readme, table):
            assert re.search(rf"^\| \[?`{name}`", text, re.MULTILINE), name
        assert f'"{name}"' in toml, name


def test_every_public_name_is_in_the_api_or_has_a_page() -> None:
    from kreisel.record.contract import System

    api = (DOCS / "api.md").read_text(encoding="utf-8")
    for name in kr.__all__:
        documented = isinstance(getattr(kr, name), System) or re.search(rf"kreisel\.{name}\n", api)
        assert documented, name
