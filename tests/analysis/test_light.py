"""Brightness against published phase functions of spheres, and facts about rotating ellipsoids."""

import numpy as np
import pytest

import kreisel as kr
from kreisel.analysis import brightness, light_curve
from kreisel.errors import InputError, InputWarning
from kreisel.physical import Asteroid, Facets, FreeBody, Orbit

ALPHA = np.linspace(0.01, 3.1, 12)
SUN = np.tile([1.0, 0.0, 0.0], (12, 1))
OBSERVER = np.stack([np.cos(ALPHA), np.sin(ALPHA), 0 * ALPHA], -1)
LOMMEL_SEELIGER = 1 - np.sin(ALPHA / 2) * np.tan(ALPHA / 2) * np.log(1 / np.tan(ALPHA / 4))
LAMBERT = (np.sin(ALPHA) + (np.pi - ALPHA) * np.cos(ALPHA)) / np.pi
AXES = (3.0, 2.0, 1.3)
CUBE = """8 12
0 0 0
0 0 1
0 1 0
0 1 1
1 0 0
1 0 1
1 1 0
1 1 1
1 2 4
1 4 3
5 7 8
5 8 6
1 5 6
1 6 2
3 4 8
3 8 7
1 3 7
1 7 5
2 6 8
2 8 4
"""


def test_phase_functions_of_spheres():  # [Lester, McCall, Tatum, J. R. Astron. Soc. Can. 73 (1979) 233]
    ball = brightness((1, 1, 1))(SUN, OBSERVER)
    assert np.allclose(ball, np.pi / 2 * LOMMEL_SEELIGER, rtol=1e-12)
    facets = Facets.ellipsoid((1, 1, 1), 4000)
    for law, zero, expected in (("lommel-seeliger", np.pi / 2, LOMMEL_SEELIGER), ("lambert", 2 * np.pi / 3, LAMBERT)):
        flux = brightness(facets, law=law)(SUN, OBSERVER) / zero
        assert abs(flux - expected).max() < 2e-3
    assert abs(brightness(facets, law="lambert")(SUN, OBSERVER) / (2 * np.pi / 3) - LOMMEL_SEELIGER).max() > 0.05


@pytest.mark.parametrize("law", ["lommel-seeliger", "geometric"])
def test_facets_converge_to_the_ellipsoid(law):
    s, o = np.random.default_rng(0).normal(size=(2, 200, 3))
    exact = brightness(AXES, law=law)(s, o)
    off = [abs(brightness(Facets.ellipsoid(AXES, n), law=law)(s, o) - exact).mean() for n in (500, 4000)]
    assert off[1] < exact.mean() * 3e-3 and off[0] / off[1] > 4  # of order 1/n, but for facets at the terminator


def test_the_long_axis_is_seen_where_the_attitude_turns_it():
    body = FreeBody.ellipsoid(1.0, (6.0, 2.0, 2.0))
    turned = body.state((0, 0, 1e-3), attitude=(np.cos(np.pi / 8), 0, 0, np.sin(np.pi / 8)))  # x to (1, 1, 0)
    rows = kr.at(body, turned, [0.0])
    for view, area in (((1, 1, 0), np.pi), ((1, -1, 0), 3 * np.pi)):
        assert np.allclose(light_curve(rows, sun=view, observer=view, law="geometric").flux, area)


def test_a_rotator_has_two_maxima_in_a_rotation_and_the_amplitude_of_its_axes():
    body = FreeBody.ellipsoid(1.0, (6.0, 4.0, 2.6))
    run = kr.simulate(body, body.state((0, 0, 2 * np.pi / 40)), dt="1 s", t_end="40 s")
    bright = light_curve(run, sun=(1, 0, 0), observer=(1, 0, 0), law="geometric")
    assert np.ptp(bright.magnitude.values) == pytest.approx(2.5 * np.log10(3 / 2), rel=1e-9)
    for shape in (None, Facets.ellipsoid(AXES)):
        light = light_curve(run, shape, sun=(1, 0.4, 0.3), observer=(1, -0.2, 0.1)).flux.values
        assert np.allclose(light[20:], light[:21], rtol=3e-3) and np.ptp(light) > 0.2 * light.mean()
        rising = np.diff(np.append(light[:-1], light[0])) > 0
        assert (rising & ~np.roll(rising, -1)).sum() == 2


def test_tables_lanes_light_time_and_the_phase_function():
    body = FreeBody.ellipsoid(1.0, (6.0, 4.0, 2.6))
    times = np.linspace(0.0, 30.0, 7)
    states = kr.at(body, body.state([(0, 0.1, 0.2), (0.3, 0, 0.1)]), times)
    way = np.stack([np.cos(times / 50), np.sin(times / 50), 0 * times], -1) * 1.495978707e11
    light = light_curve(states, sun=kr.Table(times, way), observer=way, law="geometric", light_time=True)
    assert light.flux.dims == ("time", "lane") and np.allclose(light.phase_angle, 0, atol=1e-6)
    assert np.allclose(light.arrival - light.time, 499.005, atol=1e-3)  # an astronomical unit
    one = kr.at(body, body.state((0.3, 0, 0.1)), times)
    assert np.allclose(light_curve(one, sun=way, observer=way, law="geometric").flux, light.flux[:, 1])
    bright = light_curve(one, sun=way, observer=way, law="geometric", phase=(0.5, 0.1, -1.0))
    assert np.allclose(bright.flux / light.flux[:, 1], 1.5)


def test_a_run_in_units_of_the_state_has_the_times_of_the_run_in_si():
    body = FreeBody.ellipsoid(1e10, (450.0, 321.0, 308.0), time_unit=10.0)
    turned = (0.5, 0.5, -0.5, 0.5)
    start, times = body.state((1e-3, 2e-4, 1e-2), attitude=turned), np.linspace(0, 4000, 9)
    way = kr.Table(times, np.stack([np.cos(times / 2000), np.sin(times / 2000), 0.1 + 0 * times], -1) * 1.495978707e11)
    seen = {"sun": (1, 0, 0), "observer": way, "light_time": True}
    scaled = kr.simulate(body.model(), start, dt=0.5, steps=800, every=100, orientation=body.orientation(turned))
    expected = light_curve(kr.simulate(body, start, dt="5 s", t_end="4000 s", every="500 s"), **seen)
    light = light_curve(scaled, (225, 160.5, 154), **seen)
    assert np.allclose(light.flux, expected.flux, rtol=1e-9) and np.ptp(light.flux.values) > 1e3
    assert np.allclose(light.arrival - times, 499.005 * 1.01**0.5, atol=0.01)


def test_vectors_with_units():
    moon = Asteroid.ellipsoid(1e13, (4000, 2000, 1900), Orbit("2 au", 0.1, primary=kr.physical.SUN))
    run = kr.simulate(moon, moon.state((1e-5, 1e-6, 2e-5)), dt="1 h", t_end="2 d", every=24)
    light = light_curve(run, sun=-run.position, observer=("-1.8 au", "0 au", "0 au"), light_time=True)
    assert np.allclose(light.arrival - light.time, 1.8 * 499.005, atol=0.01)
    x, y, _ = run.position.values.T  # of a body that is seen from the line to the perihelion
    assert np.allclose(light.phase_angle, np.arctan2(y, x), atol=1e-9) and light.phase_angle[-1] > 0.01
    orbits = [Orbit("2 au", 0.1, node=node, primary=kr.physical.SUN) for node in (0.0, 1.0)]
    both = Asteroid.ellipsoid(1e13, (4000, 2000, 1900), orbits)
    lanes = kr.simulate(both, both.state((1e-5, 1e-6, 2e-5)), dt="1 h", t_end="2 d", every=24)
    seen = light_curve(lanes, sun=-lanes.position, observer=("-1.8 au", "0 au", "0 au"), light_time=True)
    assert seen.phase_angle.dims == seen.arrival.dims == ("time", "lane")
    assert np.allclose(seen.isel(lane=0).flux, light.flux) and np.allclose(seen.arrival[:, 1], light.arrival)
    assert np.allclose(seen.phase_angle[:, 1], np.arctan2(y, x) + 1.0)  # of the orbit rotated by 1 rad
    assert "units" not in light_curve(run, Facets.ellipsoid(AXES), sun=(1, 0, 0), observer=(1, 0, 0)).flux.attrs


def test_a_shape_in_the_format_of_damit(tmp_path):
    file = tmp_path / "shape.txt"
    file.write_text(CUBE)
    cube = Facets.from_damit(file)
    assert np.allclose(cube.areas, 0.5) and len(cube.faces) == 12
    flux = brightness(cube, law={"lommel-seeliger": 1, "lambert": 0.1})((1, 1, 0), (1, -0.5, 0))
    sun, view = 0.5**0.5, 1 / 1.25**0.5  # the side x = 1, lit and seen, of area 1
    assert flux == pytest.approx(sun * view / (sun + view) + 0.1 * sun * view)
    assert brightness(cube, law="damit")((1, 1, 0), (1, -0.5, 0)) == pytest.approx(flux)
    for text, message in (
        (CUBE.replace("1 2 4", "1 4 2"), "closed"),
        (CUBE.replace("8 12", "8 13"), "expected two counts"),
        (CUBE.replace("1 2 4", "1 2 9"), "indices"),
        (CUBE.replace("8 12", "eight 12"), "expected two counts"),
    ):
        file.write_text(text)
        with pytest.raises(InputError, match=message):
            Facets.from_damit(file)
    with pytest.raises(InputError, match="clockwise"):
        Facets(cube.vertices, cube.faces[:, ::-1])
    with pytest.warns(InputWarning, match="convex"):
        pit = [[1, 5, 8], [5, 7, 8], [7, 3, 8], [3, 1, 8]]
        Facets(np.append(cube.vertices, [[0.5, 0.5, 0.2]], 0), [*cube.faces[:-2].tolist(), *pit])


def test_derivatives():
    jax = pytest.importorskip("jax")
    from kreisel.reduction.numerics import double

    s, o, h = np.array([1.0, 0.1, 0.2]), np.array([1.0, 0.0, 0.3]), 1e-6
    light = brightness(AXES, phase=(0.5, 0.1, -0.5))
    slope = [(light(s + h * e, o) - light(s - h * e, o)) / (2 * h) for e in np.eye(3)]
    with double():
        slopes = jax.jit(jax.vmap(jax.grad(light), (0, None)))(jax.numpy.stack([s, o, -o]), o)
    assert np.allclose(slopes[0], slope, rtol=1e-6) and np.isfinite(slopes).all()  # at opposition, behind the body
    facets = brightness(Facets.ellipsoid(AXES, 300), law="damit")
    with double():
        assert np.allclose(jax.jit(facets)(s, o), facets(s, o))


def test_the_flux_of_a_thin_crescent_falls_with_its_square():  # [Lester et al.], near 180 degrees
    crescent = np.array([0.03, 2.1e-3, 1.9e-3, 1e-4, 1e-7, 1e-12])  # 180 degrees - phase angle, rad
    turn = np.linalg.qr(np.ones((3, 3)) + np.eye(3))[0]
    o = np.stack([-np.cos(crescent), np.sin(crescent), 0 * crescent], -1) @ turn
    assert brightness((1, 1, 1))(turn[0], o) / crescent**2 == pytest.approx(np.pi / 12 * np.ones(6), rel=1e-3)
    flux = brightness(AXES)(turn[0], o) / crescent**2
    assert flux[1] == pytest.approx(flux[2], rel=1e-3) and np.ptp(flux[2:]) < 1e-3 * flux[2]
    assert 0 <= brightness(AXES)(turn[0], -turn[0]) < 1e-100


def test_bad_input():
    body = FreeBody((1, 2, 2.5))
    run, toutatis = kr.at(body, body.state((0, 0, 1)), [0.0, 1.0]), Asteroid.toutatis()
    unsized = kr.simulate(toutatis, toutatis.state((0, 0, 1e-6)), dt="1 h", steps=1)
    view, early = {"sun": (1, 0, 0), "observer": (1, 0, 0)}, kr.Table([0.0, 0.5], np.eye(3)[:2])
    for call, message in (
        (lambda: light_curve(run, **view), "without a shape"),
        (lambda: light_curve(unsized, **view), "without a shape or its size"),
        (lambda: light_curve(run, AXES, law="lambert", **view), "no closed form"),
        (lambda: light_curve(run, AXES, law="hapke", **view), "expected one of"),
        (lambda: light_curve(run, (1, 2, 0), **view), "half axes > 0"),
        (lambda: light_curve(run, AXES, sun=(0, 0, 0), observer=(1, 0, 0)), "zero vector"),
        (lambda: light_curve(run, AXES, sun=(1, 0), observer=(1, 0, 0)), "the shape"),
        (
            lambda: light_curve(run, AXES, sun=(1, 0, 0), observer=(-1, 0.2, 0), phase=(0.5, 0.1, -0.5)),
            "f > 0, got .* f = -0.472 at the phase angle 2.94",
        ),
        (
            lambda: light_curve(run, AXES, sun=(1, 0, 0), observer=early),
            "observer: Table: expected times from 0 to 0.5",
        ),
        (
            lambda: light_curve(run, AXES, sun=(1, 0, 0), observer=(1, 0, 0), law=np.ones(2)),
            "law: expected one of lommel-seeliger",
        ),
    ):
        with pytest.raises(InputError, match=message):
            call()


def test_distances_in_au_for_light_time():
    body = FreeBody((1, 2, 2.5))
    run = kr.at(body, body.state((0, 0, 1)), [0.0, 1.0])
    with pytest.warns(InputWarning, match="got 0.9 m, inside the body. Usual cause: au for m"):
        light_curve(run, AXES, sun=(1, 0, 0), observer=(0.9, 0, 0), light_time=True)


def test_degrees_for_radians():
    with pytest.warns(InputWarning, match="phase: expected D below pi, got 10 rad"):
        brightness(AXES, phase=(0.5, 10.0, -0.01))
