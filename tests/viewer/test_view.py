"""The page of a run: what it shows, that it runs nothing of an archive's, and how it behaves in a browser."""

from __future__ import annotations

import base64
import json
import re
import threading
import urllib.error
import urllib.request
from html.parser import HTMLParser

import numpy as np
import pytest

import browser
import kreisel as kr
from kreisel.viewer import bodies, serve
from kreisel.viewer.page import as_json, page, scripts
from kreisel.viewer.scene import MOVING_PATH, scene
from kreisel.viewer.thinning import extremes, mixed

IDENTITY = (1.0, 0.0, 0.0, 0.0)
HOSTILE = "</script><script>document.title='owned'</script><img src=x onerror=\"document.title='owned'\"><!-- $data"


def array(text: str, kind: str) -> np.ndarray:
    return np.frombuffer(base64.b64decode(text), dtype=f"<{kind}")


def tip(data: dict) -> np.ndarray:
    return array(data["tip"], "f4").reshape(-1, data["n"])


def turned(data: dict, points: np.ndarray) -> np.ndarray:
    from scipy.spatial.transform import Rotation

    g = Rotation.from_quat(array(data["turn"], "f4").reshape(-1, 4), scalar_first=True)
    return np.stack([g.apply(p) for p in points], 1)


@pytest.fixture
def oriented(top, x0):
    return kr.simulate(top, x0, dt=0.05, steps=400, orientation=IDENTITY, progress=False)


# -- what is shown, by the record ---------------------------------------------------------------------------------


def test_the_body_turns_with_its_axis(oriented, top, x0):
    """The last ring of the top's profile lies on the axis: it must follow a, with and without an orientation."""
    for run in (oriented, kr.simulate(top, x0, dt=0.05, steps=400, progress=False)):
        data = scene(run)
        points = np.array(data["body"]["points"])
        ends = turned(data, points[-1:])[:, 0]
        assert data["kind"] == "body" and np.allclose(tip(data), run.a, atol=1e-6)
        assert np.allclose(ends / np.linalg.norm(ends, axis=-1, keepdims=True), run.a.values, atol=1e-5)
        assert np.allclose(np.linalg.norm(points[0]), 0)  # on its point
    assert "not shown" in data["note"]


def test_gravity_points_up_whatever_the_frame_of_the_data():
    top = kr.LagrangeTop(p=(2.0, -1.0, 0.4))
    run = kr.simulate(top, top.state(m=(0.3, 1, 0.2), a=(0.6, 0, 0.8)), dt=0.05, steps=50, progress=False)
    data = scene(run)
    height = run.a.values @ (np.array((2.0, -1.0, 0.4)) / np.linalg.norm((2.0, -1.0, 0.4)))
    assert np.allclose(tip(data)[:, 2], height, atol=1e-6) and data["arrow"][2] > 1


def test_the_moving_frame_shows_the_body_in_space_or_the_vector_from_the_body():
    model = kr.HeavyTop(J=(0.6, 0.9, 1.4), A=(0.3, -0.2, 0.9))
    x0 = model.state(M=(0.5, 1, 2), P=(0.6, 0, 0.8))
    seen = scene(kr.simulate(model, x0, dt=0.05, steps=50, progress=False))
    assert "seen from the body" in seen["legend"]["tip"] and len(array(seen["turn"], "f4")) == 4
    run = kr.simulate(model, x0, dt=0.05, steps=50, orientation=IDENTITY, progress=False)
    data = scene(run)
    axis = np.array((0.3, -0.2, 0.9)) / np.linalg.norm((0.3, -0.2, 0.9))
    # the height of the axis over the vertical is the same seen from space and from the body
    assert np.allclose(tip(data)[:, 2], run.P.values @ axis, atol=1e-6)
    ends = turned(data, np.array(data["body"]["points"])[-1:])[:, 0]
    assert np.allclose(ends / 0.94, tip(data), atol=1e-5)


def test_a_body_in_a_fluid_is_its_ellipsoid():
    from kreisel.physical import Ellipsoid

    body = Ellipsoid((0.3, 0.2, 0.1), 25.0, 0.0)  # in a vacuum: the inertia of the body alone
    run = kr.simulate(
        body.model(), body.state((0, 0, 0.1), (1, 2, 0.1)), dt=0.05, steps=20, orientation=IDENTITY, progress=False
    )
    data = scene(run)
    reach = abs(np.array(data["body"]["points"])).max(0)
    assert np.allclose(reach / reach.max(), (1, 2 / 3, 1 / 3), rtol=2e-2)
    assert "ellipsoid" in data["legend"]["tip"]


def test_a_body_in_a_fluid_is_on_its_path(monkeypatch):
    """Its momentum is the vertical; its nose turns as g does; no path where there are too many rows."""
    from kreisel.viewer import scene as part

    body = kr.Kirchhoff(C=[[0, 0.5, 0.8], [0.5, 0, 1.2], [0.8, 1.2, 0]], B=(-0.9, -0.7, -0.4))
    start = {"M": (0.3, -0.4, 1.2), "P": (0.5, 0.2, 0.9)}
    run = kr.simulate(body, start, dt=0.1, steps=300, orientation=(0.5, 0.5, 0.5, 0.5), progress=False)
    data, x = scene(run), kr.analysis.path(run).values
    shown, g = tip(data), kr.algebra.rotation_matrix(run.g.values)
    p = g[0] @ run.P.values[0] / np.linalg.norm(run.P.values[0])
    assert data["kind"] == "path" and "momentum points up" in data["note"]
    assert np.allclose(shown.max(0), -shown.min(0), atol=1e-5)
    assert np.allclose(np.diff(shown[:, 2]), np.diff(x @ p), atol=1e-5)
    far = [np.linalg.norm(v - v[:1], axis=-1) for v in (shown, x)]
    assert np.allclose(*far, atol=1e-4)
    nose = np.array(data["nose"])
    assert np.allclose(turned(data, nose[None])[:, 0, 2], g @ nose @ p, atol=1e-5)
    with monkeypatch.context() as fewer:
        fewer.setattr(part, "MOST_PLACED", 300)
        assert scene(run)["kind"] == "body"


def test_particle_projection_lane_and_own_system():
    neumann = kr.Neumann(b=(0, 1, 2))
    run = kr.simulate(neumann, neumann.state(x=(1, 0, 0), q=(0, 0.8, 1)), dt=0.05, steps=50, progress=False)
    assert scene(run)["kind"] == "particle" and scene(run)["body"] is None
    five = kr.LagrangeTop(p=(0, 0, 3, 0, 1))
    m = np.triu(np.ones((5, 5)), 1)
    run = kr.simulate(five, five.state(m=m - m.T, a=np.eye(5)[1]), dt=0.05, steps=50, progress=False)
    data = scene(run)
    assert (data["kind"], data["n"], data["coordinates"]) == ("projection", 5, [0, 1, 2])
    both = kr.LagrangeTop(p=[(0, 0, 1.0), (0, 1.0, 0)])
    run = kr.simulate(both, both.state(m=(0.1, 0.2, 1.5), a=(0.6, 0, 0.8)), dt=0.05, steps=50, progress=False)
    assert np.allclose(tip(scene(run, lane=1))[:, 2], run.a[:, 1, 1], atol=1e-6)  # its own gravity points up
    with pytest.raises(kr.InputError, match="from 0 to 1"):
        scene(run, lane=2)
    own = run.isel(lane=0).assign_attrs(system="a-top-of-ones-own", frame="moving")
    assert scene(own)["kind"] == "body"
    with pytest.raises(kr.InputError, match="expected a run"):
        scene(run.drop_attrs())
    with pytest.raises(kr.InputError, match="lacks a"):
        scene(run.drop_vars("a"))


def test_the_top_s_disc_follows_the_inertia():
    wide = bodies.top(np.array((0, 0, 1.0)), np.diag((4.0, 1.0, 1.0)), 1.0)
    reach = abs(np.array(wide["points"])).max(0)
    assert np.isclose(reach[0] / reach[1], 2, rtol=1e-2)


# -- decimation ---------------------------------------------------------------------------------------------------


def test_decimation_keeps_extremes():
    rng = np.random.default_rng(0)
    values = rng.normal(size=(123_457, 2)) * 1e-3
    values[77_777, 0], values[4_321, 1], values[50, 0] = 5.0, -7.0, np.nan
    rows = extremes(values, 2_000)
    assert {0, 123_456, 77_777, 4_321} <= set(rows) and len(rows) <= 2_100 and (np.diff(rows) > 0).all()
    assert np.nanmax(values[rows]) == 5.0 and np.nanmin(values[rows]) == -7.0
    assert {77_777, 4_321} <= set(mixed(values, 2_000)) and len(mixed(values, 2_000)) <= 2_100
    assert list(extremes(values[:10], 2_000)) == list(range(10))


def test_a_long_run_is_shown_by_its_extremes(monkeypatch, top, x0):
    from kreisel.viewer import scene as part

    monkeypatch.setattr(part, "MOST_FRAMES", 2_000)
    monkeypatch.setattr(part, "BLOCK", 4_096)
    run = kr.simulate(top, x0, dt=0.05, steps=50_000, progress=False)
    spike = run.copy(deep=True)
    spike["a"].values[30_001] = (0.0, 0.0, -5.0)
    spike["energy"].values[40_003] += 1.0
    data = scene(spike)
    assert 1_000 < len(array(data["time"], "f8")) < 2_600
    assert tip(data)[:, 2].min() == -5.0
    energy = next(s for s in data["series"] if s["name"] == "energy")
    assert np.isclose(array(energy["change"], "f4").max(), 1.0, atol=1e-6) and np.isclose(energy["most"], 1.0)


# -- nothing of an archive's runs ---------------------------------------------------------------------------------


class Tags(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.found: list[tuple[str, dict]] = []

    def handle_starttag(self, tag, attrs):
        self.found.append((tag, dict(attrs)))


def hostile(run):
    attrs = {k: HOSTILE if isinstance(v, str) else v for k, v in run.attrs.items()}
    keep = ("system", "components", "frame", "parameters", "method")
    return run.rename(energy=HOSTILE).assign_attrs({**attrs, **{k: run.attrs[k] for k in keep}})


def test_text_of_an_archive_stays_text(oriented):
    text = kr.view(hostile(oriented)).html
    tags = Tags()
    tags.feed(text)
    names = [tag for tag, _ in tags.found]
    assert names.count("script") == 3 and "img" not in names and "iframe" not in names
    assert not any(key.startswith("on") for _, attrs in tags.found for key in attrs)
    assert HOSTILE not in text and "owned" in text  # it is there, as text
    data = re.search(r'<script id="data" type="application/json">(.*?)</script>', text, re.S)[1]
    assert not set("<>&\u2028\u2029") & set(data)
    assert json.loads(data)["title"] == HOSTILE


def test_the_policy_names_the_scripts_and_allows_no_request(oriented):
    text = kr.view(oriented).html
    policy = re.search(r'http-equiv="Content-Security-Policy" content="([^"]*)"', text)[1]
    assert "default-src 'none'" in policy and "connect-src 'none'" in policy and "script-src 'sha256-" in policy
    assert not {"unsafe-eval", "script-src 'unsafe-inline'"} & set(policy.split("; ")) and "http" not in policy
    assert "src=" not in re.sub(r"<script>.*?</script>", "", text, flags=re.S).replace("-src", "")


def test_json_is_plain_and_refuses_nan():
    assert json.loads(as_json({"a": "</script>\u2028&"})) == {"a": "</script>\u2028&"}
    with pytest.raises(ValueError, match="JSON"):
        as_json({"a": float("nan")})


def test_a_notebook_shows_it_in_a_frame_of_its_own(oriented):
    shown = kr.view(hostile(oriented))._repr_html_()
    assert shown.startswith('<iframe sandbox="allow-scripts" ') and "allow-same-origin" not in shown
    assert shown.count("<") == 2 and shown.count('"') == shown.count("=", 0, shown.index("srcdoc")) * 2 + 2


def test_what_is_not_finite_and_what_is_missing(oriented, monkeypatch):
    broken = oriented.copy(deep=True)
    broken["a"].values[3, 1] = np.nan
    with pytest.raises(kr.InputError, match="expected a run whose state is finite"):
        kr.view(broken)
    odd = oriented.copy(deep=True)
    odd["energy"].values[5] = np.inf
    assert "Infinity" not in page(scene(odd)).split('type="application/json">')[1].split("</script>")[0]
    monkeypatch.setitem(__import__("sys").modules, "plotly.offline", None)
    scripts.cache_clear()
    with pytest.raises(kr.InputError, match="needs plotly"):
        kr.view(oriented)
    scripts.cache_clear()


def test_the_command_writes_one_file(tmp_path, top, x0, monkeypatch, capsys):
    from kreisel.cli import app

    kr.simulate(top, x0, dt=0.05, steps=50, path=tmp_path / "top.zarr", progress=False)
    app(["view", str(tmp_path / "top.zarr")], standalone_mode=False)
    assert (tmp_path / "top.html").stat().st_size > 1e6
    assert [p.name for p in tmp_path.iterdir()].count("top.html") == 1
    with pytest.raises(kr.RunError, match=r"could not be written|could not"):
        kr.view(kr.open_run(tmp_path / "top.zarr")).save(tmp_path / "top.html" / "no.html")
    with pytest.raises(kr.InputError, match="no archive"):
        app(["view", str(tmp_path / "none.zarr")], standalone_mode=False)


# -- the server ---------------------------------------------------------------------------------------------------


@pytest.fixture
def served(tmp_path, top, x0):
    kr.simulate(top, x0, dt=0.05, steps=200, path=tmp_path / "top.zarr", progress=False)
    serving = serve.server(tmp_path / "top.zarr")
    thread = threading.Thread(target=serving.serve_forever, kwargs={"poll_interval": 0.05}, daemon=True)
    thread.start()
    yield tmp_path / "top.zarr", serve.address(serving)
    serving.shutdown()
    thread.join(60)
    serving.server_close()


def ask(url: str, method: str = "GET", **headers: str):
    request = urllib.request.Request(url, headers={k.replace("_", "-"): v for k, v in headers.items()}, method=method)
    try:
        with urllib.request.urlopen(request, timeout=60) as answer:
            return answer.status, answer.read(), answer.headers
    except urllib.error.HTTPError as error:
        with error:
            return error.code, error.read(), error.headers


def test_one_page_is_served_to_this_machine_and_nothing_else(served):
    _, url = served
    assert url.startswith("http://127.0.0.1:")
    status, text, headers = ask(url)
    assert status == 200 and text.startswith(b"<!DOCTYPE html>") and b"connect-src 'self'" in text
    for other in ("top.zarr/zarr.json", "..%2f..%2fetc/passwd", "../etc/passwd", "favicon.ico", "index.html"):
        assert ask(url + other)[0] == 404, other
    assert ask(url, "POST")[0] == ask(url, "PUT")[0] == 501
    assert ask(url, Host="evil.example")[0] == 421
    assert ask(url, "HEAD")[1] == b"" and headers["X-Frame-Options"] == "DENY"
    assert "Access-Control-Allow-Origin" not in headers


def test_the_data_is_sent_once_until_it_changes(served):
    path, url = served
    status, text, headers = ask(url, Accept="application/json")
    assert status == 200 and len(array(json.loads(text)["time"], "f8")) == 201
    tag = headers["ETag"]
    assert ask(url, Accept="application/json", If_None_Match=tag)[0] == 304
    kr.resume(path, extend=300, progress=False)
    status, text, headers = ask(url, Accept="application/json", If_None_Match=tag)
    assert status == 200 and len(array(json.loads(text)["time"], "f8")) == 301 and headers["ETag"] != tag


def test_a_bad_address_is_refused(tmp_path, top, x0):
    kr.simulate(top, x0, dt=0.05, steps=20, path=tmp_path / "top.zarr", progress=False)
    with pytest.raises(kr.InputError, match="cannot be served"):
        serve.server(tmp_path / "top.zarr", host="256.0.0.1")
    with pytest.raises(kr.InputError, match="cannot be served"):
        serve.server(tmp_path / "top.zarr", port=-1)
    with pytest.raises(kr.InputError, match="no archive"):
        serve.server(tmp_path / "none.zarr")


# -- in a browser -------------------------------------------------------------------------------------------------

needs_browser = pytest.mark.skipif(browser.find() is None, reason=f"no browser: none of {', '.join(browser.NAMES)}")


@pytest.fixture
def chromium():
    window = browser.Browser()
    yield window
    window.close()


@needs_browser
def test_the_page_plays_and_is_scrubbed(chromium, oriented, tmp_path):
    page = kr.view(hostile(oriented)).save(tmp_path / "run.html")
    chromium.open(page.as_uri())
    chromium.wait("document.body && document.body.dataset.ready")
    assert chromium.run("document.title") == HOSTILE and chromium.run("document.querySelectorAll('img').length") == 0
    assert chromium.run("document.getElementById('title').textContent") == HOSTILE
    body = "JSON.stringify(document.getElementById('scene').data[5].x)"
    before = chromium.run(body)
    chromium.run("document.getElementById('play').click()")
    chromium.wait("Number(document.body.dataset.frame) > 20")
    chromium.run("document.getElementById('play').click()")
    assert chromium.run(body) != before and chromium.run("document.body.dataset.playing") == "false"
    chromium.run("(s => { s.value = 300; s.dispatchEvent(new Event('input')); })(document.getElementById('scrub'))")
    chromium.wait("document.body.dataset.frame === '300'")
    assert "state 301 of 401" in chromium.run("document.getElementById('now').textContent")
    place = "(c => [c.getBoundingClientRect().left, c.offsetParent.getBoundingClientRect().left])"
    left, chart = chromium.run(f"{place}(document.getElementById('cursor'))")
    width = chromium.run("document.getElementById('drift').getBoundingClientRect().width")
    assert abs(left - chart - (62 + 0.75 * (width - 74))) < 2
    tip = np.array(chromium.run("['x','y','z'].map(k => document.getElementById('scene').data[3][k][1])"))
    assert np.allclose(tip, oriented.a[300], atol=1e-6)
    box = chromium.run(
        "(r => [r.left, r.top, r.width, r.height])(document.getElementById('drift').getBoundingClientRect())"
    )
    chromium.click(box[0] + 62 + 0.25 * (box[2] - 74), box[1] + box[3] / 2)
    chromium.wait("Math.abs(document.body.dataset.frame - 100) <= 1")
    chromium.dark()
    chromium.wait("document.getElementById('scene').layout.paper_bgcolor === '#16181d'")
    assert chromium.complaints == []
    assert [r for r in chromium.requests if not r.startswith(("file:", "data:", "blob:"))] == []


@needs_browser
def test_a_long_path_is_thinned_while_it_moves_and_whole_at_rest(chromium, top, x0, tmp_path):
    run = kr.simulate(top, x0, dt=0.05, steps=20_000)
    data = scene(run)
    few, tip = np.frombuffer(base64.b64decode(data["few"]), "<i4"), run.a.values
    assert len(few) <= MOVING_PATH + 12
    assert all(tip[few, k].min() == tip[:, k].min() and tip[few, k].max() == tip[:, k].max() for k in range(3))
    page = kr.view(run).save(tmp_path / "run.html")
    chromium.open(page.as_uri())
    chromium.wait("document.body && document.body.dataset.ready")
    points = "document.getElementById('scene').data[1].x.length"
    whole = chromium.run(points)
    assert whole > 3000
    chromium.run("document.getElementById('play').click()")
    chromium.wait(f"{points} === {len(few)}")
    chromium.run("document.getElementById('play').click()")
    chromium.wait(f"{points} === {whole}")
    assert chromium.complaints == []


@needs_browser
def test_a_served_page_follows_a_run_that_goes_on(chromium, tmp_path, top, x0, monkeypatch):
    from kreisel.storage.archive import reopen

    path = tmp_path / "top.zarr"
    kr.simulate(top, x0, dt=0.05, steps=200, path=path, progress=False)
    reopen(path, extend=400)  # as of a run that has been interrupted: 201 rows of 401, not complete
    monkeypatch.setattr(serve, "EVERY", 0.3)
    serving = serve.server(path)
    thread = threading.Thread(target=serving.serve_forever, kwargs={"poll_interval": 0.05}, daemon=True)
    thread.start()
    try:
        chromium.open(serve.address(serving))
        chromium.wait("document.body && document.body.dataset.ready")
        assert chromium.run("document.body.dataset.count") == "201"
        chromium.run(
            "(s => { s.value = s.max; s.dispatchEvent(new Event('input')); })(document.getElementById('scrub'))"
        )
        chromium.wait("document.body.dataset.frame === '200'")
        kr.resume(path, progress=False)
        chromium.wait("document.body.dataset.count === '401' && document.body.dataset.frame === '400'")
        assert set(chromium.requests) == {serve.address(serving)}
        assert chromium.complaints == []
    finally:
        serving.shutdown()
        thread.join(60)
        serving.server_close()
