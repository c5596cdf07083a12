"""What a release states in several files is the same in all of them; the paper cites what is in refs.bib."""

from __future__ import annotations

import json
import re
import tomllib

import kreisel as kr
from support import ROOT

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
ENTRY = re.compile(r"@\w+\{(\w+),.*?\n\}\n", re.DOTALL)


def test_the_version_is_the_same_everywhere() -> None:
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    recipe = (ROOT / "conda" / "meta.yaml").read_text(encoding="utf-8")
    changes = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    assert re.search(r"^version: (\S+)$", citation, re.MULTILINE)[1] == kr.__version__
    assert re.search(r'set version = "(\S+)"', recipe)[1] == kr.__version__
    assert re.search(r"^## (\S+)", changes, re.MULTILINE)[1] == kr.__version__


def test_the_recipe_has_the_dependencies_of_the_package() -> None:
    recipe = (ROOT / "conda" / "meta.yaml").read_text(encoding="utf-8")
    run = recipe.split("  run:\n")[1].split("\n\n")[0]
    stated = {tuple(line.strip("- ").split(" >=")) for line in run.splitlines() if "python" not in line}
    wanted = {tuple(each.replace("matplotlib", "matplotlib-base").split(">=")) for each in PROJECT["dependencies"]}
    assert stated == wanted and len(wanted) > 8
    assert PROJECT["scripts"]["kreisel"] in recipe and PROJECT["license"] in recipe


def test_the_authors_are_the_same_everywhere() -> None:
    deposit = json.loads((ROOT / ".zenodo.json").read_text(encoding="utf-8"))
    (author,) = deposit["creators"]
    for file in ("CITATION.cff", "paper/paper.md", "docs/conf.py"):
        assert author["name"] in (ROOT / file).read_text(encoding="utf-8"), file
    assert deposit["title"] in (ROOT / "CITATION.cff").read_text(encoding="utf-8")


def test_the_paper_cites_entries_of_the_bibliography() -> None:
    text = (ROOT / "paper" / "paper.md").read_text(encoding="utf-8")
    cited = set(re.findall(r"@([a-z]+\d{4})", text))
    entries = {m[1]: m[0] for m in ENTRY.finditer((ROOT / "paper" / "paper.bib").read_text(encoding="utf-8"))}
    whole = {m[1]: m[0] for m in ENTRY.finditer((ROOT / "src" / "kreisel" / "refs.bib").read_text(encoding="utf-8"))}
    assert set(entries) == cited and len(cited) > 8
    assert all(entries[key] == whole[key] for key in cited)
    for picture in re.findall(r"\]\((\S+\.png)\)", text):
        assert (ROOT / "paper" / picture).is_file()


def test_every_python_that_is_supported_is_tested_by_the_workflow() -> None:
    stated = [c.rsplit(" ", 1)[1] for c in PROJECT["classifiers"] if re.search(r"Python :: 3\.\d+$", c)]
    assert stated[0] == PROJECT["requires-python"].removeprefix(">=")
    workflow = ROOT / ".github" / "workflows" / "ci.yml"
    if workflow.is_file():  # not in the sdist
        text = workflow.read_text(encoding="utf-8")
        systems = text.split("  systems:")[1].split("  windows:")[0]
        assert re.findall(r'"(3\.\d+)"', systems) == stated
        assert all(name in text for name in ("ubuntu-latest", "macos-latest", "windows-latest"))
