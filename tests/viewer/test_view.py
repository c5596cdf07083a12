"""The page of a run: what it shows, that it runs nothing of an archive's, and how it behaves in a browser."""

from __future__ import annotations

import hashlib
import json
import re
import threading
import urllib.error
import urllib.request
from html.parser import HTMLParser

import numpy as np
import pytest
from PIL import Image

import kreisel as kr
from kreisel.physical import FreeBody, Gyroscope, HeavyBody
from kreisel.viewer import bodies
from kreisel.viewer.frames import coordinates_of, extremes, mixed
from kreisel.viewer.page import Source, address, as_json, page, scripts, server
from kreisel.viewer.scene import scene
from scenes import HOSTILE, IDENTITY, array, hostile, points, tip, turned
from support import ROOT


@pytest.fixture
def oriented(top, x0):
    return kr.simulate(top, x0, dt=0.05, steps=400, orientation=IDENTITY, progress=False)


# -- what is shown, by the record ---------------------------------------------------------------------------------


def test_the_body_turns_with_its_axis(oriented, top, x0):
    """The last ring of the top's profile lies on the axis: it must follow a, with and without an orientation."""
    for run in (oriented, kr.simulate(top, x0, dt=0.05, steps=400, progress=False)):
        data = scene(run)
        ends = turned(data, points(data)[-1:])[:, 0]
        assert data["kind"] == "body" and np.allclose(tip(data), run.a, atol=2e-4)
        assert np.allclose(ends / np.linalg.norm(ends, axis=-1, keepdims=True), run.a.values, atol=2e-4)
        assert np.allclose(np.linalg.norm(points(data)[0]), 0)  # on its point
    assert "not shown" in data["note"] and "orientation=(1, 0, 0, 0)" in data["callout"] and not data["spins"]
    second = bodies.SECOND
    assert second not in array(data["meshes"][0]["colour"], "u1")  # no sectors that would seem to stand still
    assert scene(oriented)["spins"] and second in array(scene(oriented)["meshes"][0]["colour"], "u1")


def test_gravity_points_down_whatever_the_frame_of_the_data():
    top = kr.LagrangeTop(p=(2.0, -1.0, 0.4))
    run = kr.simulate(top, top.state(m=(0.3, 1, 0.2), a=(0.6, 0, 0.8)), dt=0.05, steps=50, progress=False)
    data = scene(run)
    up = np.array((2.0, -1.0, 0.4)) / np.linalg.norm((2.0, -1.0, 0.4))
    assert np.allclose(tip(data)[:, 2], run.a.values @ up, atol=2e-4)
    assert data["up"] == "gravity" and np.allclose(up @ np.array(data["frame"]), (0, 0, 1))  # x, y, z as drawn


def test_forces_leave_gravity_and_the_axis_in_the_picture(tmp_path):
    """A damped body under gravity has its vertical, also in an archive, which holds no code; lanes have theirs."""
    ways = np.array([(0, 0, 1), (0, 0.6, 0.8)])
    top = kr.perturbed(kr.LagrangeTop(p=ways), damping=(0, 0, 0.01))
    x0 = {"m": (0.3, 1, 0.2), "a": (0.6, 0, 0.8)}
    run = kr.simulate(top, x0, dt=0.05, steps=50, path=tmp_path / "top.zarr", orientation=IDENTITY, progress=False)
    for lane, way in enumerate(ways):
        data = scene(run, lane=lane)
        assert data["up"] == "gravity" and np.allclose(tip(data)[:, 2], run.a.values[:, lane] @ way, atol=2e-4)
        assert "gravity" in {text.get_text() for text in kr.plot(run.isel(lane=lane)).subfigs[0].axes[0].texts}
    assert "gravity" not in {text.get_text() for text in kr.plot(run).subfigs[0].axes[0].texts}
    heavy = HeavyBody("2 kg", (0.03, 0.03, 0.035), (0, "3 cm", "4 cm"), damping=0.1)
    run = kr.simulate(heavy, heavy.state((0, 0, 30), attitude=IDENTITY), dt="1 ms", steps=50, progress=False)
    data = scene(run)
    assert data["up"] == "gravity" and np.allclose(tip(data)[:, 2], run.up.values @ (0, 0.6, 0.8), atol=2e-4)


def test_a_body_of_unknown_moments_is_a_ball_by_name():
    free = FreeBody((1.0, 2.0, 2.5), damping=(0.1, 0.1, 0.1))
    run = kr.simulate(free, free.state((0.1, 2, 0)), dt=0.05, steps=50, progress=False)
    data = scene(run)
    assert "as a ball" in data["note"] and data["legend"]["tip"] == "third axis of the body"
    lengths = np.linalg.norm(points(data), axis=-1)
    assert np.ptp(lengths) < 1e-3 * lengths.max()
    assert (
        "ellipsoid"
        in scene(
            kr.simulate(FreeBody((1.0, 2.0, 2.5)), FreeBody((1.0, 2.0, 2.5)).state((0.1, 2, 0)), dt=0.05, steps=50)
        )["note"]
    )


def test_the_moving_frame_shows_the_body_in_space_or_the_vector_from_the_body():
    model = kr.HeavyTop(J=(0.6, 0.9, 1.4), A=(0.3, -0.2, 0.9))
    x0 = model.state(M=(0.5, 1, 2), P=(0.6, 0, 0.8))
    seen = scene(kr.simulate(model, x0, dt=0.05, steps=50, progress=False))
    assert seen["kind"] == "seen" and "seen from the body" in seen["legend"]["tip"]
    assert len(array(seen["bodies"][0]["turn"], "i2")) == 4 and "orientation" in seen["callout"]
    run = kr.simulate(model, x0, dt=0.05, steps=50, orientation=IDENTITY, progress=False)
    data = scene(run)
    axis = np.array((0.3, -0.2, 0.9)) / np.linalg.norm((0.3, -0.2, 0.9))
    # the height of the axis over the vertical is the same seen from space and from the body
    assert np.allclose(tip(data)[:, 2], run.P.values @ axis, atol=2e-4)
    assert np.allclose(turned(data, points(data)[-1:])[:, 0] / 0.94, tip(data), atol=2e-4)


def test_a_body_in_a_fluid_is_its_ellipsoid():
    from kreisel.physical import Ellipsoid

    body = Ellipsoid((0.3, 0.2, 0.1), 25.0, 0.0)  # in a vacuum: the inertia of the body alone
    run = kr.simulate(
        body.model(), body.state((0, 0, 0.1), (1, 2, 0.1)), dt=0.05, steps=20, orientation=IDENTITY, progress=False
    )
    data = scene(run)
    reach = abs(points(data)).max(0)
    assert np.allclose(reach / reach.max(), (1, 2 / 3, 1 / 3), rtol=2e-2)
    assert "ellipsoid" in data["legend"]["tip"]


def test_a_body_in_a_fluid_is_on_its_path(monkeypatch):
    """The third axis of space is the vertical; the nose turns as g does; no path if there are too many rows."""
    from kreisel.viewer import scene as showing

    body = kr.Kirchhoff(C=[[0, 0.5, 0.8], [0.5, 0, 1.2], [0.8, 1.2, 0]], B=(-0.9, -0.7, -0.4))
    start = {"M": (0.3, -0.4, 1.2), "P": (0.5, 0.2, 0.9)}
    run = kr.simulate(body, start, dt=0.1, steps=300, orientation=(0.5, 0.5, 0.5, 0.5), progress=False)
    data, x = scene(run), kr.analysis.path(run).values
    shown, g = tip(data), kr.algebra.rotation_matrix(run.g.values)
    assert data["kind"] == "path" and "third axis of space points up" in data["note"]
    assert np.allclose(shown.max(0), -shown.min(0), atol=1e-5)
    assert np.allclose(np.diff(shown, axis=0), np.diff(x, axis=0), atol=1e-5)
    far = [np.linalg.norm(v - v[:1], axis=-1) for v in (shown, x)]
    assert np.allclose(*far, atol=1e-4)
    nose = np.array(data["bodies"][0]["nose"])
    assert np.allclose(turned(data, nose)[:, 0, 2], (g @ nose)[:, 2], atol=2e-4 * np.linalg.norm(nose))
    with monkeypatch.context() as fewer:
        fewer.setattr(showing, "MOST_PLACED", 300)
        assert scene(run)["kind"] == "body"


def test_a_satellite_has_the_shape_of_its_inertia():
    from kreisel.physical import Orbit, Satellite

    sat = Satellite.cubesat(Orbit.circular("500 km"), units=3)
    run = kr.simulate(sat.model(), sat.state(), dt=60.0, steps=20, orientation=IDENTITY, progress=False)
    data = scene(run)
    assert data["kind"] == "satellite" and data["up"] == ""
    axis, colour = np.array(data["bodies"][0]["axis"]), array(data["meshes"][0]["colour"], "u1")
    assert bodies.PANEL in colour and abs(axis[0]) > 0.97  # the axis of the least moment is the first


def test_an_asteroid_has_no_panels_and_goes_round_the_sun():
    """Moments 1 : 3.09 : 3.22 are of an ellipsoid with axes as sqrt(5.31) : sqrt(1.13) : sqrt(0.87)."""
    from kreisel.physical import Asteroid
    from kreisel.viewer.frames import panels_of

    toutatis = Asteroid.toutatis()
    lengths = np.sqrt([5.31, 1.13, 0.87])
    for body in (toutatis, kr.physical.Ensemble([toutatis, Asteroid((2e19, 6.18e19, 6.44e19), toutatis.orbit)])):
        run = kr.simulate(body, body.state((1e-5, 4e-6, 0)), dt="1 h", steps=30, progress=False)
        data = scene(run)
        reach = np.ptp(points(data), axis=0)
        assert np.allclose(reach / reach[0], lengths / lengths[0], rtol=1e-2)
        assert bodies.PANEL not in array(data["meshes"][0]["colour"], "u1")
        assert [a["name"] for a in data["bodies"][0]["arrows"]] == ["Sun", "velocity"]
        assert data["legend"]["tip"].endswith("Sun") and data["charts"]["panels"][0]["title"].endswith("to Sun")
    lit = kr.physical.Satellite(toutatis.inertia, toutatis.orbit, plates=[((1, 0, 0), (1, 0, 0), 1.0)], light=4.5e-6)
    data = scene(kr.simulate(lit, lit.state((1e-5, 4e-6, 0)), dt="1 h", steps=2, progress=False))
    assert [a["name"] for a in data["bodies"][0]["arrows"]] == ["Sun", "velocity"]
    moon = Asteroid.hyperion()
    run = kr.simulate(moon, moon.state((0, 0, 4e-6)), dt="1 h", steps=30, progress=False)
    assert panels_of(run)[0].title == "angle of the axis to nadir"


def test_a_satellite_has_arrows_to_what_is_around_it_and_a_globe():
    """On a polar orbit from the first axis of space to the third, in the light of the Sun along the first."""
    from kreisel.physical import Orbit, Plate, Satellite

    orbit = Orbit.circular("500 km", inclination="90 deg")
    plate = Plate((0, 0, 1), (0, 0, 0), 0.01)
    body = Satellite((1.0, 2.5, 2.0), orbit, light=4.5e-6, sun=(1, 0, 0), plates=(plate,))
    run = kr.simulate(
        body.model(),
        body.state(),
        dt=30.0,
        steps=50,
        orientation=body.orientation(body.pointing(pitch=0.3)),
        progress=False,
    )
    data = scene(run)
    each = data["bodies"][0]
    arrows = {a["name"]: array(a["to"], "i2").reshape(-1, 3)[0] / 32767 for a in each["arrows"]}
    north = [0, 0, 1]  # the field of the Earth over its equator
    assert {k: v.round(4).tolist() for k, v in arrows.items()} == {
        "nadir": [-1, 0, 0],
        "velocity": [0, 0, 1],
        "Sun": [1, 0, 0],
        "field": north,
    }
    assert data["kind"] == "satellite" and data["globe"]["earth"] and data["up"] == ""
    assert np.isclose(data["globe"]["size"], 6378.137 / 6878.137)
    assert np.allclose(array(each["place"], "f4")[:3], (1, 0, 0))
    error, *_ = data["charts"]["panels"]
    assert (error["unit"], data["clock"]["unit"]) == ("deg", "min")
    assert np.isclose(array(error["values"][0], "f4")[0], np.rad2deg(0.3))
    assert np.isclose(np.arccos(tip(data)[0] @ arrows["nadir"]), 0.3, atol=1e-3)
    named = scene(run, axis=(1, 0, 0), target=(0, 1, 0))
    assert [a["name"] for a in named["bodies"][0]["arrows"]] == ["nadir", "velocity", "Sun", "field", "target"]


@pytest.mark.parametrize("kind", ["box", "ellipsoid", "cylinder", "cubesat", "unknown"])
def test_a_body_is_drawn_in_its_shape_if_it_is_known(kind):
    """Its lengths as they were given; a body of which the inertia alone is known is its ellipsoid of inertia."""
    from kreisel.physical import FreeBody, Orbit, Satellite, SubmergedBody

    body, lengths = {
        "box": lambda: (FreeBody.box(2.0, (0.1, 0.4, 0.2)), (0.1, 0.4, 0.2)),
        "ellipsoid": lambda: (FreeBody.ellipsoid(2.0, (0.1, 0.4, 0.2)), (0.1, 0.4, 0.2)),
        "cylinder": lambda: (SubmergedBody.cylinder(0.1, 1.0, 30.0, 1000.0), (1.0, 0.2, 0.2)),
        "cubesat": lambda: (Satellite.cubesat(Orbit.circular("500 km"), 3), (0.3, 0.1, 0.1)),
        "unknown": lambda: (FreeBody(FreeBody.box(2.0, (0.1, 0.4, 0.2)).inertia), (0.1, 0.4, 0.2)),
    }[kind]()
    start = body.state(angular_velocity=(0.1, 0.3, 0.2)) if kind == "cylinder" else body.state((0.01, 0.03, 0.02))
    data = scene(kr.simulate(body, start, dt=0.1, steps=4, progress=False))
    reach, corners = np.ptp(points(data), axis=0), len(points(data))
    assert np.allclose(reach / reach.max(), np.array(lengths) / max(lengths), rtol=1e-2)
    assert (corners == 8) == (kind in ("box", "cubesat"))
    named = {"unknown": "ellipsoid of inertia", "cubesat": "nadir"}.get(kind, f"the {kind}")
    assert data["legend"]["tip"].endswith(named)


def test_the_axes_of_a_top_are_those_of_the_top_that_is_drawn(oriented):
    """The third along its axis, whatever the axes of its orientation."""
    from scipy.spatial.transform import Rotation

    each = scene(oriented)["bodies"][0]
    third = Rotation.from_quat(each["triad"], scalar_first=True).apply((0, 0, 1))
    assert np.allclose(third, np.array(each["axis"]) / np.linalg.norm(each["axis"]))


def test_no_face_of_a_body_lies_across_two_sectors():
    """The rim of a wheel had a saw-tooth: two triangles of a rectangle in different colours."""
    wheel = bodies.gyroscope(np.array((0, 0, 1.0)), None, 1.0)
    rim = wheel.points[wheel.faces][:, :, 2]
    assert not ((rim.min(1) < 0.55 - 1e-9) & (rim.max(1) > 0.55 + 1e-9) & (wheel.colour != bodies.METAL)).any()


def test_particle_projection_lane_and_own_system():
    neumann = kr.Neumann(b=(0, 1, 2))
    run = kr.simulate(neumann, neumann.state(x=(1, 0, 0), q=(0, 0.8, 1)), dt=0.05, steps=50, progress=False)
    assert scene(run)["kind"] == "particle" and scene(run)["bodies"][0]["mesh"] is None
    with pytest.raises(kr.InputError, match="body, mesh: expected a run drawn with a body, got a particle"):
        scene(run, body="box")
    five = kr.LagrangeTop(p=(0, 0, 3, 0, 1))
    m = np.triu(np.ones((5, 5)), 1)
    run = kr.simulate(five, five.state(m=m - m.T, a=np.eye(5)[1]), dt=0.05, steps=50, progress=False)
    data = scene(run)
    assert (data["kind"], len(data["names"]), data["coordinates"]) == ("projection", 5, [0, 1, 2])
    free = kr.EulerTop(J=(1, 2, 3, 4, 5))
    data = scene(kr.simulate(free, {"M": m - m.T}, dt=0.05, steps=50, progress=False))
    assert data["names"] == "12 13 14 15 23 24 25 34 35 45".split()  # not the zeros of the diagonal, nor twice
    assert np.ptp(tip(data), axis=0).min() > 0.01
    assert coordinates_of(np.zeros((1, 12, 12)))[1][9:13] == ["1,11", "1,12", "2,3", "2,4"]
    both = kr.LagrangeTop(p=[(0, 0, 1.0), (0, 1.0, 0)])
    run = kr.simulate(both, both.state(m=(0.1, 0.2, 1.5), a=(0.6, 0, 0.8)), dt=0.05, steps=50, progress=False)
    assert np.allclose(tip(scene(run, lane=1))[:, 2], run.a[:, 1, 1], atol=2e-4)  # its own gravity points down
    data = scene(run)
    assert [each["name"] for each in data["bodies"]] == ["lane 0", "lane 1"] and "2 of 2 lanes" in data["facts"]
    assert all(np.allclose(tip(data, k)[:, 2], run.a[:, k, 2 - k], atol=2e-4) for k in (0, 1))
    with pytest.raises(kr.InputError, match="different ones"):
        scene(run, lane=[0, 0])
    with pytest.raises(kr.InputError, match="from 0 to 1"):
        scene(run, lane=2)
    own = run.isel(lane=0).assign_attrs(system="a-top-of-ones-own", frame="moving")
    assert scene(own)["kind"] == "seen"
    with pytest.raises(kr.InputError, match="expected a run"):
        scene(run.drop_attrs())
    with pytest.raises(kr.InputError, match="lacks a"):
        scene(run.drop_vars("a"))


def test_the_top_s_disc_follows_the_inertia():
    wide = bodies.top(np.array((0, 0, 1.0)), np.diag((4.0, 1.0, 1.0)), 1.0)
    reach = abs(wide.points).max(0)
    assert np.isclose(reach[0] / reach[1], 2, rtol=1e-2)


@pytest.mark.parametrize("name", bodies.SHAPES)
def test_every_shape_can_be_asked_for(name, oriented):
    data = scene(oriented, body=name)
    assert np.isclose(np.linalg.norm(points(data), axis=-1).max(), 0.94, atol=0.15)
    assert data["meshes"] != scene(oriented)["meshes"] or name == "top"
    faces = array(data["meshes"][0]["faces"], "u2").reshape(-1, 3)
    assert faces.max() < len(points(data)) and len(array(data["meshes"][0]["colour"], "u1")) == len(faces)
    with pytest.raises(kr.InputError, match=r"body: expected one of top, .* Did you mean 'gyroscope'"):
        kr.view(oriented, body="gyroscop")


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
    from kreisel.viewer import frames as part

    monkeypatch.setattr(part.frames, "__defaults__", (2_000,))
    monkeypatch.setattr(part, "BLOCK", 4_096)
    run = kr.simulate(top, x0, dt=0.05, steps=50_000, progress=False)
    spike = run.copy(deep=True)
    spike["a"].values[30_001] = (0.0, 0.0, -5.0)
    spike["energy"].values[40_003] += 1.0
    data = scene(spike)
    assert 1_000 < len(array(data["time"], "f8")) < 3_000
    assert (array(data["time"], "f8") == run.time.values[30_001]).any() and data["radius"] == 5.0
    energy = next(s for s in data["series"] if s["name"] == "energy")
    assert np.isclose(array(energy["change"], "f4").max(), 1.0, atol=1e-6) and np.isclose(energy["most"], 1.0)


# -- nothing of an archive's runs ---------------------------------------------------------------------------------


class Tags(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.found: list[tuple[str, dict]] = []

    def handle_starttag(self, tag, attrs):
        self.found.append((tag, dict(attrs)))


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


def test_the_library_is_the_one_that_is_described():
    """What a release carries is what the script beside makes; its licences are there."""
    assets = ROOT / "src" / "kreisel" / "viewer" / "assets"
    text = (assets / "README.md").read_text(encoding="utf-8")
    for name in ("library.min.js", "library.css"):
        assert f"{hashlib.sha256((assets / name).read_bytes()).hexdigest()}  {name}" in text
    made = (ROOT / "docs" / "tools" / "page_library.sh").read_text(encoding="utf-8")
    for package, version in re.findall(r"(three|uPlot|esbuild)(?:\.js)? ([0-9.]+\d)", text):
        assert f"{package.lower()}@{version}" in made
    licences = (assets / "library.LICENSE.txt").read_text(encoding="utf-8")
    assert "three.js authors" in licences and "Leon Sorokin" in licences and licences.count("Permission is hereby") == 2
    assert "</script" not in scripts()[0] and "</script" not in scripts()[1]


def test_json_is_plain_and_refuses_nan():
    assert json.loads(as_json({"a": "</script>\u2028&"})) == {"a": "</script>\u2028&"}
    with pytest.raises(ValueError, match="JSON"):
        as_json({"a": float("nan")})


def test_what_is_not_finite(oriented):
    broken = oriented.copy(deep=True)
    broken["a"].values[3, 1] = np.nan
    with pytest.raises(kr.InputError, match="expected a run whose state is finite"):
        kr.view(broken)
    odd = oriented.copy(deep=True)
    odd["energy"].values[5] = np.inf
    assert "Infinity" not in page(scene(odd)).split('type="application/json">')[1].split("</script>")[0]


def test_the_command_writes_one_file(tmp_path, top, x0, monkeypatch, capsys):
    from kreisel.cli import app

    kr.simulate(top, x0, dt=0.05, steps=50, path=tmp_path / "top.zarr", progress=False)
    app(["view", str(tmp_path / "top.zarr")], standalone_mode=False)
    assert 5e5 < (tmp_path / "top.html").stat().st_size < 1e6
    assert [p.name for p in tmp_path.iterdir()].count("top.html") == 1
    film = ["--movie", str(tmp_path / "top.gif"), "--seconds", "0.4", "--fps", "10", "--title", "My top"]
    app(["view", str(tmp_path / "top.zarr"), *film], standalone_mode=False)
    with Image.open(tmp_path / "top.gif") as pictures:
        assert pictures.n_frames == 4
    with pytest.raises(kr.InputError, match="--fps: expected a film"):
        app(["view", str(tmp_path / "top.zarr"), "--fps", "10", "--overwrite"], standalone_mode=False)
    with pytest.raises(kr.InputError, match="target: expected a run of a satellite, got one of 'lagrange-top'"):
        app(["view", str(tmp_path / "top.zarr"), "--target", "moon", "--overwrite"], standalone_mode=False)
    for refused in (["--serve", "--out", "t.html"], ["--serve", "--fps", "9"], ["--port", "80"], ["--host", "::1"]):
        with pytest.raises(kr.InputError, match=f"{refused[0]}: expected no|{refused[-2]}: expected a"):
            app(["view", str(tmp_path / "top.zarr"), *refused], standalone_mode=False)
    with pytest.raises(kr.RunError, match=r"could not be written|could not"):
        kr.view(kr.open_run(tmp_path / "top.zarr")).save(tmp_path / "top.html" / "no.html")
    with pytest.raises(kr.InputError, match="no archive"):
        app(["view", str(tmp_path / "none.zarr")], standalone_mode=False)


@pytest.mark.parametrize("damping", [(0, 0, 0), (0, 0, 0.1)])
def test_the_commands_show_a_body_in_seconds_and_joules(tmp_path, damping, monkeypatch):
    """Page, served page and figure of an archive have the clock, the energy and the title of the run in SI."""
    from kreisel.cli import app

    wheel = Gyroscope.flat(mass="3 kg", axial_moment="0.17 kg m^2", lever="15 cm", damping=damping)
    start = wheel.state(tilt="60 deg", spin="400 rpm")
    kr.simulate(wheel, start, dt="10 ms", t_end="2 s", path=tmp_path / "wheel.zarr", progress=False)
    figures = []
    monkeypatch.setattr("kreisel.cli.output.save_picture", lambda picture, *_: figures.append(picture))
    app(["view", str(tmp_path / "wheel.zarr")], standalone_mode=False)
    app(["plot", str(tmp_path / "wheel.zarr")], standalone_mode=False)
    html = (tmp_path / "wheel.html").read_text()
    data = json.loads(html.split('type="application/json">')[1].split("</script>")[0])
    served = Source(tmp_path / "wheel.zarr").read()[1]
    height = 3 * 9.80665 * 0.15 * np.cos(np.radians(60))  # potential energy; the axis is at rest at the start
    energy = height + 0.5 * 0.17 * (400 * 2 * np.pi / 60) ** 2
    for shown in (data, served):
        assert shown["title"].startswith("Gyroscope") and shown["clock"]["unit"] == "s"
        assert np.isclose(array(shown["time"], "f8")[-1] / shown["clock"]["size"], 2.0)
        assert np.isclose(next(s for s in shown["series"] if s["name"] == "energy")["start"], energy)
    assert "Gyroscope" in figures[0].get_suptitle() and "0.01 s" in figures[0].get_suptitle()
    assert np.isclose(figures[0].subfigs[1].axes[-1].get_xlim()[1], 2.0)


def test_the_figure_of_a_sweep_of_bodies_is_in_si(tmp_path, monkeypatch):
    """Lanes of other levers have other units of the state; the momentum in kg m^2/s of each is drawn."""
    from kreisel.cli import app

    wheel = Gyroscope.flat(mass="3 kg", axial_moment="0.17 kg m^2", lever="15 cm")
    spans = {"lever": ["15 cm", "20 cm"], "spin": ["300 rpm", "600 rpm"]}
    options = {"dt": "2 ms", "t_end": "1 s", "path": tmp_path / "tops.zarr", "workers": 0, "progress": False}
    run = kr.sweep(wheel, {"tilt": "20 deg"}, over=spans, **options)
    figures = []
    monkeypatch.setattr("kreisel.cli.output.save_picture", lambda picture, *_: figures.append(picture))
    app(["plot", str(tmp_path / "tops.zarr")], standalone_mode=False)
    with pytest.raises(kr.InputError, match=r"--lane: expected one lane of the sweep .*, got \[0, 1\]"):
        app(["view", str(tmp_path / "tops.zarr"), "--lane", "0", "--lane", "1"], standalone_mode=False)
    titles = {axes.get_title(): axes for axes in figures[0].axes}
    name = next(title for title in titles if title.startswith("momentum["))
    axes, expected = titles[name], (run.momentum_max - run.momentum_min).values[..., int(name[9])]
    drawn = np.asarray(axes.collections[0].get_array()).reshape(2, 2)
    assert np.allclose(np.sort(drawn, axis=None), np.sort(expected, axis=None))


# -- the server ---------------------------------------------------------------------------------------------------


@pytest.fixture
def served(tmp_path, top, x0):
    kr.simulate(top, x0, dt=0.05, steps=200, path=tmp_path / "top.zarr", progress=False)
    serving = server(tmp_path / "top.zarr", title="My top", body="box")
    thread = threading.Thread(target=serving.serve_forever, kwargs={"poll_interval": 0.05}, daemon=True)
    thread.start()
    yield tmp_path / "top.zarr", address(serving)
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
    tag, data = headers["ETag"], json.loads(text)
    assert data["title"] == "My top" and data["meshes"] == scene(kr.open_run(path), body="box")["meshes"]
    assert ask(url, Accept="application/json", If_None_Match=tag)[0] == 304
    kr.resume(path, extend=300, progress=False)
    status, text, headers = ask(url, Accept="application/json", If_None_Match=tag)
    assert status == 200 and len(array(json.loads(text)["time"], "f8")) == 301 and headers["ETag"] != tag


def test_a_bad_address_is_refused(tmp_path, top, x0):
    kr.simulate(top, x0, dt=0.05, steps=20, path=tmp_path / "top.zarr", progress=False)
    with pytest.raises(kr.InputError, match="cannot be served"):
        server(tmp_path / "top.zarr", host="256.0.0.1")
    with pytest.raises(kr.InputError, match="cannot be served"):
        server(tmp_path / "top.zarr", port=-1)
    with pytest.raises(kr.InputError, match="no archive"):
        server(tmp_path / "none.zarr")
