"""The page in a browser: it plays evenly, is scrubbed, follows a run, runs nothing of an archive; and notebooks."""

from __future__ import annotations

import sys
import threading
import types

import numpy as np
import pytest

import browser
import kreisel as kr
from kreisel.physical import Orbit, Satellite
from kreisel.viewer import page as page_module
from kreisel.viewer.frames import between
from kreisel.viewer.scene import scene
from scenes import HOSTILE, IDENTITY, array, hostile, tip

needs_browser = pytest.mark.skipif(browser.find() is None, reason=f"no browser: none of {', '.join(browser.NAMES)}")
READY = "document.body && document.body.dataset.ready"
TOPS = """(() => {
    const { camera, lanes } = kreisel.stage, out = [];
    lanes[0].group.traverse((o) => {
        const half = o.scale.y / 2 * camera.projectionMatrix.elements[5];
        if (o.isSprite) out.push(o.position.clone().project(camera).y + half);
    });
    return out;
})()"""
TIP = "kreisel.stage.lanes.map(lane => lane.tip.toArray())"


@pytest.fixture(scope="module")
def chromium():
    window = browser.Browser()
    yield window
    window.close()


@pytest.fixture
def oriented(top, x0):
    return kr.simulate(top, x0, dt=0.05, steps=400, orientation=IDENTITY, progress=False)


def opened(window, view, path):
    window.complaints.clear()
    window.requests.clear()
    window.open("about:blank")
    window.open(view.save(path).as_uri())
    window.wait(READY)


def press(window, key: str) -> None:
    window.run(f"document.dispatchEvent(new KeyboardEvent('keydown', {{key: '{key}'}}))")


def set_to(window, name: str, value: int) -> None:
    window.run(
        f"(s => {{ s.value = {value}; s.dispatchEvent(new Event('input')); }})(document.getElementById('{name}'))"
    )


@needs_browser
def test_the_page_plays_and_is_scrubbed(chromium, oriented, tmp_path):
    opened(chromium, kr.view(hostile(oriented)), tmp_path / "run.html")
    assert chromium.run("document.title") == HOSTILE and chromium.run("document.querySelectorAll('img').length") == 0
    assert chromium.run("document.getElementById('title').textContent") == HOSTILE
    press(chromium, " ")
    chromium.wait("Number(document.body.dataset.frame) > 20")
    press(chromium, " ")
    assert chromium.run("document.body.dataset.playing") == "false"
    time = chromium.run("kreisel.state.time")  # between two states: where the cubic of Python is, and the body turned
    data = scene(oriented)
    place, joined = np.array([time / 0.05]), np.ones(400, dtype=bool)
    chromium.wait("document.getElementById('now').textContent.includes(kreisel.state.time.toPrecision(7))")
    assert np.allclose(chromium.run(TIP)[0], between(tip(data), place, joined)[0], atol=3e-4)
    set_to(chromium, "scrub", 300)
    chromium.wait("document.body.dataset.frame === '300'")
    assert "state 301 of 401" in chromium.run("document.getElementById('now').textContent")
    assert np.allclose(chromium.run(TIP)[0], oriented.a[300], atol=2e-4)
    q = chromium.run("kreisel.stage.lanes[0].mesh.quaternion.toArray()")
    assert abs(np.dot([q[3], *q[:3]], array(data["bodies"][0]["turn"], "i2").reshape(-1, 4)[300] / 32767)) > 1 - 1e-5
    left, width = chromium.run(
        "(b => [document.getElementById('cursor').getBoundingClientRect().left - b.left, b.width])"
        "(kreisel.drift.plot.over.getBoundingClientRect())"
    )
    assert abs(left - 0.75 * width) < 2.5
    box = chromium.run("(r => [r.left, r.top, r.width, r.height])(kreisel.drift.plot.over.getBoundingClientRect())")
    chromium.click(box[0] + 0.25 * box[2], box[1] + box[3] / 2)
    chromium.wait("Math.abs(document.body.dataset.frame - 100) <= 1")
    chromium.dark()
    chromium.wait("document.documentElement.dataset.theme === 'dark' && kreisel.stage.dark")
    chromium.dark(False)
    assert chromium.complaints == []
    assert [r for r in chromium.requests if not r.startswith(("file:", "data:", "blob:", "about:"))] == []


@needs_browser
def test_it_plays_evenly_whatever_was_saved(chromium, top, x0, tmp_path):
    """Rows that grow apart: what a second of playing is in time does not depend on them."""
    run = kr.simulate(top, x0, dt=0.05, steps=2000, orientation=IDENTITY, progress=False)
    kept = np.unique(np.round(np.linspace(0, 50, 400) ** 2 * 0.8).astype(int))
    uneven = run.isel(time=kept[kept <= 2000])
    opened(chromium, kr.view(uneven), tmp_path / "run.html")
    pace = scene(uneven)["pace"]
    seen = chromium.run(
        "new Promise(done => { const all = []; document.getElementById('play').click(); const look = (now) => {"
        "all.push([now, kreisel.state.time]); all.length < 25 ? requestAnimationFrame(look) : done(all); };"
        "requestAnimationFrame(look); })"
    )
    now, time = np.array(seen[2:]).T
    step = np.minimum(np.diff(now), 200) / 1000 * pace
    assert np.allclose(np.diff(time)[1:], step[1:], atol=0.05 * pace) and (np.diff(time) > 0).all()
    assert chromium.complaints == []


@needs_browser
def test_keys_pictures_and_video(chromium, oriented, tmp_path):
    opened(chromium, kr.view(oriented), tmp_path / "run.html")
    for key, fact in (
        ("?", "document.getElementById('helpbox').open"),
        ("f", "kreisel.stage.follow"),
        ("a", "!kreisel.stage.axes"),
        ("d", "kreisel.stage.dark"),
    ):
        assert not chromium.run(fact), key
        press(chromium, key)
        assert chromium.run(fact), key
        press(chromium, key)
    before = chromium.run("kreisel.stage.camera.position.toArray()")
    chromium.run("kreisel.stage.camera.position.multiplyScalar(0.5), kreisel.stage.touched = true")
    press(chromium, "r")
    assert np.allclose(chromium.run("kreisel.stage.camera.position.toArray()"), before, atol=1e-6)
    press(chromium, "ArrowRight")
    chromium.wait("document.body.dataset.frame === '1'")
    press(chromium, "ArrowUp")
    assert chromium.run("document.getElementById('pace').textContent") == "\u00d7 2"
    press(chromium, "s")
    name, kind, size = chromium.wait("document.body.dataset.saved").split()
    assert (name, kind) == ("kreisel.png", "image/png") and int(size) > 10_000
    press(chromium, "v")
    chromium.wait("Number(document.body.dataset.frame) > 100")
    press(chromium, "v")
    name, kind, size = chromium.wait(
        "(document.body.dataset.saved || '').includes('video') && document.body.dataset.saved"
    ).split()
    assert name.startswith("kreisel.") and int(size) > 1_000
    assert chromium.complaints == []


@needs_browser
def test_a_long_legend_fits_a_narrow_phone(chromium, tmp_path):
    """The entry of a target in space was cut: entries did not wrap."""
    body = Satellite.cubesat(Orbit.circular("500 km", "97 deg"))
    run = kr.simulate(body, body.state(), dt="1 min", t_end="1 h", progress=False)
    chromium.ask("Emulation.setDeviceMetricsOverride", width=320, height=568, deviceScaleFactor=1, mobile=True)
    try:
        opened(chromium, kr.view(run, target=(0.125, 0.25, 0.875)), tmp_path / "run.html")
        assert "compared with the target" in chromium.run("document.querySelector('#legend span').textContent")
        rights = "[...document.querySelectorAll('#legend span')].map(e => e.getBoundingClientRect().right)"
        assert max(chromium.run(rights)) <= chromium.run(
            "document.getElementById('scene').getBoundingClientRect().right"
        )
    finally:
        chromium.ask("Emulation.clearDeviceMetricsOverride")


@needs_browser
def test_lanes_stand_side_by_side_and_together_and_nothing_is_cut_on_a_phone(chromium, tmp_path):
    both = kr.LagrangeTop(p=[(0, 0, 1.0), (0, 1.0, 0), (1.0, 0, 0)])
    x0 = both.state(m=(0.1, 0.2, 1.5), a=(0.6, 0, 0.8))
    run = kr.simulate(both, x0, dt=0.05, steps=100, orientation=IDENTITY, progress=False)
    phone = {"width": 390, "height": 844, "deviceScaleFactor": 1, "mobile": True}
    chromium.ask("Emulation.setDeviceMetricsOverride", **phone)
    try:
        opened(chromium, kr.view(run), tmp_path / "run.html")
        assert chromium.run("document.documentElement.scrollWidth") == 390
        edges = chromium.run("[...document.querySelectorAll('td, button')].map(e => e.getBoundingClientRect().right)")
        assert len(edges) > 20 and max(edges) <= 390
        assert chromium.run("document.getElementById('scene').clientWidth") > 340
    finally:
        chromium.ask("Emulation.clearDeviceMetricsOverride")
    places = "kreisel.stage.lanes.map(lane => lane.group.position.toArray())"
    apart = np.array(chromium.run(places))
    assert min(np.linalg.norm(apart[i] - apart[j]) for i in range(3) for j in range(i)) > 2
    press(chromium, "b")
    assert not np.any(chromium.run(places))
    set_to(chromium, "scrub", 70)
    chromium.wait("document.body.dataset.frame === '70'")
    assert np.allclose(np.array(chromium.run(TIP))[:, 2], [run.a[70, k, 2 - k] for k in range(3)], atol=2e-4)
    assert chromium.complaints == []


@needs_browser
def test_states_that_stand_alone_are_shown_one_by_one(chromium, top, x0, tmp_path):
    run = kr.simulate(top, x0, dt=2.0, steps=50, progress=False)
    opened(chromium, kr.view(run), tmp_path / "run.html")
    press(chromium, " ")
    chromium.wait("Number(document.body.dataset.frame) >= 3")
    assert chromium.run("kreisel.state.part") == 0 and chromium.run("kreisel.data.time.includes(kreisel.state.time)")
    assert "one by one" in chromium.run("document.getElementById('note').textContent")
    assert not chromium.run("document.getElementById('callout').hidden")  # how to get the spin
    assert chromium.complaints == []


@needs_browser
def test_a_change_far_below_rounding_is_in_its_strip(chromium, top, x0, tmp_path):
    """Changes of 1e-22 of the scale in one row only: the strips ended at 1e-17, and a line has two points."""
    run = kr.simulate(top, x0, dt=0.05, steps=20, progress=False)
    energy = np.ones(21)
    energy[5] += 2**-52
    run = run.assign(energy=("time", energy, run.energy.attrs | {"evaluation_scale": [1e6]}))
    opened(chromium, kr.view(run), tmp_path / "small.html")
    low, y, points = chromium.run(
        "(({ plot }) => [plot.scales.y.min, Math.max(...plot.data[1]), plot.series[1].points.show(plot, 1)])"
        "(kreisel.drift.strips.find((s) => s.title === 'energy'))"
    )
    assert 1e-24 < low < y < 1e-21 and points
    (axes,) = [axes for axes in kr.plot(run).axes if [text.get_text() for text in axes.texts] == ["energy"]]
    (line,) = [line for line in axes.lines if np.nanmax(line.get_ydata()) < 1e-21]
    place = np.nanargmax(line.get_ydata())
    assert axes.get_ylim()[0] < line.get_ydata()[place] and line.get_markevery()[place] and line.get_marker() == "."


@needs_browser
def test_labels_of_short_times_are_the_times(chromium, tmp_path):
    """Of a tenth of a millisecond; they had three decimals, all of them 0."""
    body = kr.physical.FreeBody((1, 2, 2.5))
    run = kr.simulate(body, body.state((1e4, 2e4, 0)), dt=1e-6, t_end=1e-4, progress=False)
    opened(chromium, kr.view(run), tmp_path / "short.html")
    places, labels = chromium.run(
        "(({ axes }) => [axes[0]._splits, axes[0]._values])(kreisel.drift.strips.at(-1).plot)"
    )
    assert len(places) > 2 and [float(label) for label in labels] == pytest.approx(places, rel=1e-9)


@needs_browser
def test_a_section_stands_beside_and_coordinates_can_be_chosen(chromium, top, x0, tmp_path):
    run = kr.simulate(top, x0, dt=0.05, steps=1000, progress=False)
    opened(chromium, kr.view(run, section=kr.analysis.section(run, "a[2]", 0.5)), tmp_path / "run.html")
    assert chromium.run("kreisel.section.seen") == -1
    set_to(chromium, "scrub", 1000)
    count = chromium.run("kreisel.data.section.time.length")
    assert (
        count > 3 and chromium.wait("kreisel.section.seen >= 0") and chromium.run("kreisel.section.seen") == count - 1
    )
    four = kr.LagrangeTop(p=(0, 0, 0, 1))
    m = np.triu(np.ones((4, 4)), 1)
    run = kr.simulate(four, four.state(m=m - m.T, a=(0.6, 0, 0, 0.8)), dt=0.05, steps=100, progress=False)
    opened(chromium, kr.view(run), tmp_path / "four.html")
    heights = np.array(chromium.run(TOPS))  # of the names of the axes, -1 to 1 from the lower edge to the upper one
    assert len(heights) == 3 and abs(heights).max() < 0.98
    chromium.run("(s => { s.value = 2; s.dispatchEvent(new Event('change')); })(document.getElementById('c0'))")
    set_to(chromium, "scrub", 60)
    chromium.wait("document.body.dataset.frame === '60'")
    assert np.allclose(chromium.run(TIP)[0], run.a[60].values[[2, 1, 3]], atol=1e-6)
    assert chromium.complaints == []


@needs_browser
def test_a_served_page_follows_a_run_that_goes_on(chromium, tmp_path, top, x0, monkeypatch):
    from kreisel.storage.run_archive import reopen

    path = tmp_path / "top.zarr"
    kr.simulate(top, x0, dt=0.05, steps=200, path=path, progress=False)
    reopen(path, extend=400)  # as of a run that has been interrupted: 201 rows of 401, not complete
    monkeypatch.setattr(page_module, "LOOK_EVERY", 0.3)
    serving = page_module.server(path)
    thread = threading.Thread(target=serving.serve_forever, kwargs={"poll_interval": 0.05}, daemon=True)
    thread.start()
    chromium.complaints.clear()
    chromium.open("about:blank")
    chromium.run("1")
    chromium.requests.clear()
    try:
        chromium.open(page_module.address(serving))
        chromium.wait(READY)
        assert chromium.run("document.body.dataset.count") == "201"
        set_to(chromium, "scrub", 200)
        chromium.wait("document.body.dataset.frame === '200'")
        kr.resume(path, progress=False)
        chromium.wait("document.body.dataset.count === '401' && document.body.dataset.frame === '400'")
        assert set(chromium.requests) <= {page_module.address(serving), "about:blank"}
        assert chromium.complaints == []
    finally:
        chromium.open(
            "about:blank"
        )  # a request that the server no longer answers would be a complaint of the next test
        chromium.run("1")
        serving.shutdown()
        thread.join(60)
        serving.server_close()


# -- notebooks ----------------------------------------------------------------------------------------------------


@pytest.fixture
def kernel(monkeypatch):
    """A notebook's kernel: which cell runs can be set."""
    cell = {"id": None}
    shell = types.SimpleNamespace(get_parent=lambda: {"metadata": {"cellId": cell["id"]}})
    monkeypatch.setitem(sys.modules, "IPython", types.SimpleNamespace(get_ipython=lambda: shell))
    monkeypatch.setattr(page_module, "_carried", {"cell": None, "count": 0})
    return cell


def shown(kernel, run, cell: str) -> str:
    kernel["id"] = cell
    return kr.view(run)._repr_html_()


def test_one_cell_of_a_notebook_carries_the_script(kernel, oriented):
    first, second = shown(kernel, oriented, "one"), shown(kernel, oriented, "two")
    assert len(first) < 1.1e6 and len(second) < 1.5e5
    assert len(shown(kernel, oriented, "one")) > 6e5  # it runs again: its output is replaced, so it carries it again
    assert len(shown(kernel, oriented, "three")) < 1.5e5


def test_text_of_an_archive_stays_text_in_a_notebook(kernel, oriented):
    shown(kernel, oriented, "one")
    text = shown(kernel, hostile(oriented), "two")
    assert text.count("<script>") == 1 and text.count("</script>") == 1 and "<img" not in text and "owned" in text


@needs_browser
def test_cells_share_the_script_and_say_where_it_is_missing(kernel, chromium, oriented, tmp_path, monkeypatch):
    monkeypatch.setattr(page_module, "SANDBOX", page_module.SANDBOX + " allow-same-origin")  # to look inside
    monkeypatch.setattr(page_module, "WAIT", 6)
    first, second = shown(kernel, oriented, "one"), shown(kernel, hostile(oriented), "two")
    chromium.complaints.clear()
    for name, cells, frames in (("both.html", second + first, 2), ("lost.html", second, 0)):
        (tmp_path / name).write_text(f"<!DOCTYPE html><meta charset=utf-8><body>{cells}", encoding="utf-8")
        chromium.open((tmp_path / name).as_uri())
        if frames:
            inside = "[...document.querySelectorAll('iframe')].filter(f => f.contentDocument?.body?.dataset.ready)"
            chromium.wait(f"{inside}.length === 2")
            assert chromium.run("document.title") != "owned"
        else:
            chromium.wait("document.body && document.body.textContent.includes('Run that cell again')")
            assert chromium.run("document.querySelectorAll('iframe').length") == 0
    assert chromium.complaints == []
