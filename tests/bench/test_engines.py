"""The scorecard of engines: adapters, their protocol, grades, and the page that is made from the result."""

from __future__ import annotations

import importlib
import json
import subprocess
import sys
import tomllib

import numpy as np
import pytest

import kreisel as kr
from support import ROOT

ENGINES = ROOT / "benchmarks" / "engines"
RESULT = ROOT / "benchmarks" / "results" / "engines.json"
CATALOGUE = tomllib.loads((ENGINES / "engines.toml").read_text(encoding="utf-8"))
BRICK = "tumbling-brick"


@pytest.fixture
def scorecard(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.syspath_prepend(str(ENGINES))
    yield importlib.import_module("scorecard")
    sys.modules.pop("scorecard", None)


@pytest.fixture
def page(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.syspath_prepend(str(ROOT / "docs" / "tools"))
    yield importlib.import_module("engines")
    sys.modules.pop("engines", None)


def body(scorecard, name=BRICK):
    return next(body for body in scorecard.BODIES if body.name == name)


def written(times, q, w, **about) -> str:
    """What an adapter writes."""
    rows = [",".join(repr(float(x)) for x in (t, *a, *b)) for t, a, b in zip(times, q, w, strict=True)]
    told = {"version": "1", "seconds": 0.5, **about}
    return "\n".join([f"# {json.dumps(told)}", "time_s,qw,qx,qy,qz,wx_rad_s,wy_rad_s,wz_rad_s", *rows]) + "\n"


def exact(rows=3):
    reference = kr.checkcases.case(BRICK).reference(np.linspace(0, 30, rows))
    return reference.time.values, reference.attitude.values, reference.angular_velocity.values


def test_adapters_are_short_and_each_engine_has_one() -> None:
    adapters = {path.name: path for path in (ENGINES / "adapters").iterdir() if path.name.startswith("with_")}
    assert {f"with_{engine['adapter']}" for engine in CATALOGUE.values() if "adapter" in engine} == {*adapters}
    for path in adapters.values():
        assert len(path.read_text(encoding="utf-8").splitlines()) <= 60, path.name


def test_versions_are_pinned_without_addresses() -> None:
    pins = tomllib.loads((ENGINES / "pins.toml").read_text(encoding="utf-8"))
    assert {*pins} == {name for name, e in CATALOGUE.items() if e["index"] != "here" and "adapter" in e}
    for name, packages in pins.items():
        assert packages and all("/" not in p.removeprefix("@").partition("/")[2] and ":" not in p for p in packages), (
            name
        )
        assert any(p.lower().startswith(CATALOGUE[name]["package"].lower()) for p in packages), name


def test_jobs_fill_the_duration(scorecard) -> None:
    for case in scorecard.BODIES:
        for step in (1 / 60, 1 / 240, 0.002, 0.1, None):
            for job in scorecard.jobs(case, step, "x", "y"):
                assert job["steps"] % job["every"] == 0 and job["steps"] // job["every"] <= scorecard.ROWS
                assert job["steps"] * job["dt"] == pytest.approx(case.given()["duration"], rel=1e-12)
    top = scorecard.jobs(body(scorecard, "heavy-top"), 1e-3, "x", "y")[0]
    assert np.allclose(np.diag(top["inertia"]), (0.234375, 0.46875, 0.234375)) and top["gravity"] == [0, 0, -9.81]
    assert np.allclose(top["velocity"], (4.61538, 0, 0))  # w x arm
    with pytest.raises(ValueError, match="steps that fill 30 s"):
        scorecard.job(body(scorecard), 0.7, "x", "y")


def test_answers_are_read_or_refused(scorecard) -> None:
    times, q, w = exact()
    text = written(times, q, w, summary="an engine")
    read = scorecard.answer(text)
    assert read.about == {"version": "1", "seconds": 0.5, "summary": "an engine"}
    assert scorecard.answer("Failed to import what is optional\n" + text).about == read.about
    assert np.array_equal(read.times, times) and np.array_equal(read.attitude, q) and np.array_equal(read.rates, w)
    for broken in ("", text.replace('"seconds": 0.5, ', ""), text + "1,2,3\n", "Traceback: no engine"):
        with pytest.raises(ValueError, match=r"expected|could not convert"):
            scorecard.answer(broken)


def test_grades(scorecard) -> None:
    times, q, w = exact()
    good = scorecard.grade(body(scorecard), scorecard.answer(written(times, -q, w)))  # a quaternion of either sign
    assert good["attitude_error"] < 1e-14 and good["rates_error"] < 1e-14
    assert good["energy_change"] < 1e-14 and good["momentum_change"] < 1e-14
    turned = np.array(q)
    turned[-1] = [-q[-1, 1], q[-1, 0], -q[-1, 3], q[-1, 2]]  # half a turn about the first axis of space
    bad = scorecard.grade(body(scorecard), scorecard.answer(written(times, turned, w)))
    assert bad["attitude_error"] == pytest.approx(np.pi) and bad["rates_error"] < 1e-14
    assert bad["energy_change"] < 1e-14 and bad["momentum_change"] > 0.1
    still = scorecard.grade(body(scorecard), scorecard.answer(written(times, q, 0 * w + w[0])))
    assert still["rates_error"] > 0.5 and still["energy_change"] < 1e-14  # without w x I w the energy stays
    lost = np.where(np.arange(3)[:, None] == 1, np.nan, w)
    assert scorecard.grade(body(scorecard), scorecard.answer(written(times, q, lost))) == {"diverged_s": 15.0}
    assert "last row" in scorecard.grade(body(scorecard), scorecard.answer(written(times[:2], q[:2], w[:2])))["failed"]


def test_orders(scorecard) -> None:
    assert scorecard.order({"attitude_error": 0.4}, {"attitude_error": 0.1}, 1e-10) == 2.0
    assert scorecard.order({"attitude_error": 4e-12}, {"attitude_error": 1e-12}, 1e-10) is None
    assert scorecard.order({"attitude_error": 2.0}, {"attitude_error": 1.0}, 1e-10) is None
    assert scorecard.order({"attitude_error": 1e-3}, {"attitude_error": 2e-3}, 1e-10) is None
    assert scorecard.order({"diverged_s": 2.0}, {"attitude_error": 1e-3}, 1e-10) is None


def test_kreisel_answers_as_the_other_engines(scorecard) -> None:
    for case, setting in (("heavy-top", "exact"), (BRICK, "kahan 2")):
        job = scorecard.job(body(scorecard, case), 0.01, setting, "kreisel")
        done = subprocess.run([sys.executable, "-B", ENGINES / "adapters" / "with_kreisel.py"], input=json.dumps(job),
                              capture_output=True, text=True, timeout=300, check=True)  # fmt: skip
        read = scorecard.answer(done.stdout)
        assert read.about["version"] == kr.__version__ and len(read.times) == job["steps"] // job["every"] + 1
        graded = scorecard.grade(body(scorecard, case), read)
        assert graded["attitude_error"] < (1e-12 if setting == "exact" else 1e-2)
        assert graded["attitude_error"] > (0 if setting == "exact" else 1e-6)
        assert graded["energy_change"] < 1e-6 and graded["momentum_change"] < 1e-6


def test_at_least_fifteen_engines_are_graded(page) -> None:
    catalogue, result = page.read()
    graded = {
        name for name, record in result["engines"].items() if any("attitude_error" in r for r in record.get("rows", ()))
    }
    others = {catalogue[name]["title"].partition(" (")[0] for name in graded if catalogue[name]["index"] != "here"}
    assert len(others) >= 15 and "kreisel" in graded and {*result["engines"]} == {*catalogue}
    assert all(
        record["date"] > "2026" and ("not_installed" in record or record["version"])
        for record in result["engines"].values()
    )


def test_the_page_has_the_result(page, tmp_path) -> None:
    page.write(tmp_path)
    catalogue, result = page.read()
    text = (tmp_path / "generated" / "engines-errors.md").read_text(encoding="utf-8")
    row = page.runs(result["engines"]["mujoco"], "Euler", BRICK)[0]
    line = next(line for line in text.splitlines() if line.startswith("| MuJoCo | Euler"))
    assert f"{page.number(row['attitude_error'])} / " in line.split("|")[4]
    assert text.count("\n") == 2 + sum(
        len(e["settings"]) for n, e in catalogue.items() if "rows" in result["engines"][n]
    )
    brick = (tmp_path / "generated" / f"engines-{BRICK}.md").read_text(encoding="utf-8")
    assert brick.count("\n") == 2 + sum(
        r["case"] == BRICK for e in result["engines"].values() for r in e.get("rows", ())
    )
    words = (ROOT / "docs" / "check-cases-engines.md").read_text(encoding="utf-8")
    for name in ("errors", "list", "missing", *page.CASES):
        assert f"generated/engines-{name}.md" in words and (tmp_path / "generated" / f"engines-{name}.md").exists()
    assert (tmp_path / "generated" / "figures" / "engines.png").stat().st_size > 20_000
    assert page.number(0.0123) == "0.012" and page.number(3.4e-9) == "3.4e-9" and page.step(1 / 600) == "1/600"


def test_the_picture_shows_the_sides_that_are_seen(page) -> None:
    seen = page.faces(np.array([1.0, 0, 0, 0]))
    assert [colour for _, colour, _ in seen] == list(page.FACES) and [side for _, _, side in seen] == [1, -1, 1]
    flipped = page.faces(np.array([0.0, 0, 0, 1]))  # half a turn about the third axis
    assert [side for _, _, side in flipped] == [-1, 1, 1]


def test_the_hour_of_the_page_is_the_one_measured() -> None:
    """Five engines and the file in C: what docs/engines.md states; the file flips within 5 ms of the exact motion."""
    records = json.loads((RESULT.parent / "hour.json").read_text(encoding="utf-8"))
    text = (ROOT / "docs" / "engines.md").read_text(encoding="utf-8")
    assert len(records) == 6 and f"after {records['mujoco']['default_not_finite_s']:.0f} s" in text
    case = kr.checkcases.case("wing-nut").given()
    body = kr.physical.FreeBody(case["inertia"])
    times = 3600 - 0.1 * np.arange(600)[::-1]
    M = kr.at(body.model(), body.state(case["angular_velocity"]), body.dt(1.0) * times).M.values
    exact = M[:, 1] / np.linalg.norm(M, axis=1)
    off = {name: np.abs(np.array(record["middle"], float) - exact).max() for name, record in records.items()}
    assert off["kreisel"] < 0.02 < 1 < off["jolt"] and abs(records["kreisel"]["energy"][-1] - 1) < 1e-11
