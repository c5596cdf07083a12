"""Every script of the gallery, with fewer steps: its claims hold, and it writes its picture."""

from __future__ import annotations

import ast
import runpy
from typing import Any

import pytest
from matplotlib.figure import Figure

from kreisel.viewer.charts import ShownFigure
from support import ROOT

SCRIPTS = sorted((ROOT / "examples" / "gallery").glob("*.py"))


def test_there_is_a_gallery():
    assert len(SCRIPTS) >= 12


def coarse(figure: ShownFigure, name: str, **options: Any) -> None:
    """Saved with few pixels: most of the time of a picture is theirs."""
    Figure.savefig(figure, name, **(options | {"dpi": 50}))


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.stem)
def test_the_claims_of_the_gallery_hold(script, tmp_path, monkeypatch, capsys):
    source = ast.parse(script.read_text())
    title, *rest = ast.get_docstring(source).split("\n\n")
    assert title.count("\n") == 0 and title.endswith(".") and rest[-1].startswith("Source:")
    assert any(isinstance(node, ast.Assert) for node in ast.walk(source))
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("KREISEL_SMALL", "1")
    monkeypatch.setattr(ShownFigure, "savefig", coarse)
    runpy.run_path(str(script), run_name="__main__")
    assert (tmp_path / f"{script.stem}.png").stat().st_size > 10_000
    assert [p.name for p in tmp_path.iterdir()] == [f"{script.stem}.png"]
