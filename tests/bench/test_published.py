"""The table of published numbers: every figure in its range, the page as the result, some computed again."""

from __future__ import annotations

import json
import re

import pytest

from support import ROOT

RESULT, PAGE = ROOT / "benchmarks" / "results" / "published.json", ROOT / "docs" / "satellites.md"


def agrees(row: dict) -> bool:
    return row["least"] <= row["found"] and (row["most"] is None or row["found"] <= row["most"])


def test_published_numbers(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    import published

    rows = json.loads(RESULT.read_text(encoding="utf-8"))["rows"]
    assert len(rows) >= 9
    assert [row["what"] for row in rows if not agrees(row)] == []
    assert published.table(rows) in PAGE.read_text(encoding="utf-8")
    again = [row for part in (published.mercury, published.disc) for row in part()]
    assert len(again) == 4
    committed = {row["what"]: row["found"] for row in rows}
    for row in again:
        assert agrees(row._asdict()), row
        assert row.found == pytest.approx(committed[row.what], rel=1e-3)
    assert not agrees({**rows[0], "found": 1.0})


def test_the_pages_have_the_figures_of_binaries() -> None:
    result = json.loads((ROOT / "benchmarks" / "results" / "binary.json").read_text(encoding="utf-8"))
    guide, page = ((ROOT / "docs" / name).read_text(encoding="utf-8") for name in ("guide-dimorphos.md", "binaries.md"))
    long, shapes = result["with_sun_and_tides"], result["map"]
    assert f"{round(100 * shapes['tumbling'])} % of them tumble" in guide and shapes["starts"] == 10_000
    century = result["century"]
    assert century["minutes_for_10000_starts"] < 30.5 and century["years"] == 100 and long["years"] == 1000
    assert f"{round(100 * century['tumbling'])} % tumble within a hundred years" in guide
    assert f"need {century['seconds_to_build'] + century['seconds_of_steps']:.0f} s of the processor" in guide
    assert f"take {round(long['seconds'])} s on one core" in page and long["angular_momentum"] < 2e-15
    assert result["with_tides"]["energy_spread"] < 1e-6


def test_the_guides_have_the_figures_of_searches_and_clones() -> None:
    results, pages = ROOT / "benchmarks" / "results", ROOT / "docs"
    searches, clones = (json.loads((results / f"{n}.json").read_text(encoding="utf-8")) for n in ("tumbler", "flyby"))
    light, apophis = ((pages / f"guide-{name}.md").read_text(encoding="utf-8") for name in ("two-periods", "apophis"))
    narrow, (run, half) = searches["narrow"], clones["rows"]
    assert f"in {narrow['truth within 3 sigma']} of {narrow['count']} searches" in light and narrow["count"] == 100
    assert narrow["probability"][0] > 0.96 and f"{narrow['aliases']['1']} of them have" in light
    assert all(each["processor_seconds"] < 600 for each in searches["wide"]["searches"] + narrow["searches"])
    assert run["clones"] == 10**6 and run["seconds"] < 180 and f"{run['processor']:.0f} s of the processor" in apophis
    for name, digits in (("precession", 2), ("rotation", 1)):
        low, middle, high = (f"{x:.{digits}f}" for x in run[name])
        assert f"from {low} to {high} h (median {middle} h)" in apophis and run[name] == half[name]


def told(rows: list[dict]) -> str:
    """A cell of the guide's table."""
    times = [row["lyapunov_days"][1] for row in rows if "lyapunov_days" in row]
    ends = dict.fromkeys(f"{day:.0f}" for day in (min(times), max(times)))
    return f"{sum(r['regular'] for r in rows)} of {sum(r['of'] for r in rows)}, {' to '.join(ends)} days"


def test_the_guide_has_the_figures_of_hyperion() -> None:
    result = json.loads((ROOT / "benchmarks" / "results" / "hyperion.json").read_text(encoding="utf-8"))
    guide = (ROOT / "docs" / "guide-asteroid.md").read_text(encoding="utf-8")
    assert result["orbits"] == 10_000 and result["off_dop853"] < 1e-6
    assert min(result["linked"], key=lambda row: row[-1]) == result["linked"][0]  # the reading of the table
    states = {**result["rows"], **result["flybys"]}
    groups = {"slow": "slow", "fast": "any", "flybys as": r"[\d-]+", "flybys of 2005": r"[\d-]+, corrected"}
    for name, pattern in groups.items():
        (line,) = (line for line in guide.splitlines() if line.startswith(f"| {name}"))
        for cell, shape in zip(line.strip(" |").split(" | ")[1:], ("moments", "Thomas", "symmetric"), strict=True):
            assert cell == told([row for title, row in states.items() if re.fullmatch(f"{shape}: {pattern}", title)])
