"""Where a satellite points: its angles, its target, its shadow; the figure has them in units."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import kreisel as kr
from kreisel.physical import FreeBody, Gyroscope, Orbit, Plate, Satellite, Wheels
from kreisel.runs.geometry import pointing_error
from kreisel.viewer.frames import clock_of, panels_of, shadows_of
from kreisel.viewer.scene import scene
from scenes import array

AXES = Rotation.from_rotvec([0.3, -0.5, 0.9]).as_matrix()
TENSOR = AXES @ np.diag([1.0, 2.5, 2.0]) @ AXES.T
EQUATORIAL = Orbit.circular("500 km")  # from the first axis of space to the second


def run_of(satellite, attitude, steps=30, dt=60.0, **state):
    start = satellite.state(attitude=attitude, **state)
    return kr.simulate(satellite, start, dt=dt, t_end=steps * dt, progress=False)


def test_a_satellite_that_is_tilted_misses_its_target_by_the_tilt():
    body = Satellite(TENSOR, EQUATORIAL)
    for tilt in ({"pitch": 0.2}, {"roll": -0.2}):
        run = run_of(body, body.pointing(**tilt), steps=1)
        assert np.isclose(pointing_error(run)[0], 0.2)
        assert np.isclose(pointing_error(run, target="velocity")[0], np.pi / 2 + tilt.get("pitch", 0.0))
        named = kr.analysis.pointing(run, axis=AXES[:, 0])  # of the least moment, up or down
        assert np.isclose(abs(np.cos(named["error"][0])), np.cos(0.2))
    steady = run_of(body, body.pointing())
    assert np.abs(pointing_error(steady)).max() < 1e-8  # at rest in the frame of a circular orbit


def test_angles_against_space_and_ground_are_those_of_scipy():
    """Over the equator at the first axis of space, north is the third axis, east the second, down minus the first."""
    body = Satellite(TENSOR, EQUATORIAL)
    yaw, pitch, roll = 0.4, -0.3, 1.1
    turn = Rotation.from_euler("ZYX", [yaw, pitch, roll])
    ground = Rotation.from_matrix(np.array([[0, 0, -1], [0, 1, 0], [1, 0, 0]]))
    for frame, g in (("inertial", turn), ("ground", ground * turn)):
        run = run_of(body, g.as_quat(scalar_first=True), steps=1, spin=(0, 0, 0.001))
        angles = kr.analysis.pointing(run, frame=frame).isel(time=0)
        assert np.allclose([angles[k] for k in ("yaw", "pitch", "roll")], [yaw, pitch, roll]), frame


def test_the_shadow_of_a_low_orbit_lasts_36_minutes():
    """The Sun in the plane of the orbit: the Earth's cylinder hides it for 2 asin(R/r) of 2 pi, 35.8 min of 94.6."""
    sun = np.array([0.6, 0.8, 0.0])
    panel = Plate((0, 0, 1), (0, 0, 0), 0.01)  # without a lever
    body = Satellite(TENSOR, EQUATORIAL, light=4.5e-6, sun=sun, plates=(panel,), eclipse=True)
    run = run_of(body, body.pointing(), dt=10.0, steps=560)
    ((begin, end),) = shadows_of(run)
    assert abs(end - begin - 35.8 * 60) < 25
    middle = EQUATORIAL.at((begin + end) / 2)[0]
    assert middle @ sun / np.linalg.norm(middle) < -0.999  # behind the Earth
    assert np.isclose(pointing_error(run, target="sun")[0], np.arccos(-0.6))  # nadir is minus the first axis


def test_the_figure_has_panels_with_units():
    body = Satellite(TENSOR, EQUATORIAL, wheels=Wheels([[0, 1, 0]], 0.002))
    run = run_of(body, body.pointing(pitch=0.1))
    panels = {panel.title: panel for panel in panels_of(run)}
    assert [panel.unit for panel in panels.values()] == ["deg", "deg", "deg/s", "N m s"]
    assert np.isclose(panels["angle of the axis to nadir"].values[0, 0], np.rad2deg(0.1))
    rate = np.linalg.norm(panels["angular velocity in the body"].values[0])
    assert np.isclose(rate, 360 / EQUATORIAL.period)  # at rest in the frame of the orbit
    assert np.allclose(panels["momenta of the wheels"].values, 0.002)
    figure = kr.plot(run)
    figure.draw_without_rendering()
    left = figure.subfigs[0].axes
    assert len(left) == 4 and left[-1].get_xlabel() == "time (min)"
    assert np.isclose(left[0].get_xlim()[1], 30.0) and "steps of 60 s" in figure.get_suptitle()


def test_the_clock_suits_the_length_of_a_run(top, x0):
    body = FreeBody((1.0, 2.0, 2.5), time_unit=60.0)
    for minutes, unit, size in ((1, "s", 1 / 60), (20, "min", 1.0), (300, "h", 60.0), (7200, "d", 1440.0)):
        run = kr.simulate(body.model(), body.state((0, 0, 0.1)), dt=minutes, steps=1, progress=False)
        clock = clock_of(run)
        assert clock.unit == unit and np.isclose(clock.size, size)
    assert clock_of(kr.simulate(top, x0, dt=1.0, steps=1, progress=False)) == ("", 1.0, 1.0)


def test_a_gyroscope_is_shown_in_seconds_joules_and_words():
    """The strips of the page end where the run does, whatever the unit of time of its kernel; m g l cos(tilt) + ..."""
    wheel = Gyroscope.flat(mass=3.0, axial_moment=0.17, lever=0.15)
    run = kr.simulate(
        wheel, wheel.state(tilt="60 deg", spin=0.0), dt="1 ms", t_end="2 s", every="10 ms", progress=False
    )
    data = scene(run)
    clock, edges = data["clock"], array(data["edges"], "f8")
    assert clock["label"] == "time (s)" and np.isclose(array(data["time"], "f8")[-1] / clock["size"], 2.0)
    assert np.isclose(edges[-1] / clock["size"], 2.0) and np.isclose(data["steps"], 2000)
    energy = next(each for each in data["series"] if each["name"] == "energy")
    assert energy["unit"] == "J" and np.isclose(energy["start"], 3.0 * 9.80665 * 0.15 * 0.5)
    assert data["legend"]["tip"] == "axis of the body" and data["title"].startswith("Gyroscope")
    figure = kr.plot(run)
    titles = [axes.get_title() for axes in figure.subfigs[0].axes]
    assert titles == ["tip of the axis on its sphere, to 2 s"]
    assert figure.subfigs[1].axes[-1].get_xlabel() == "time (s)"


def test_two_bodies_are_compared_in_seconds():
    """Tops whose units of time differ by a factor of 3 run for 12 s, also as a model with its unit of time."""
    tops = [Gyroscope(0.1, k * 1e-4, k * 4e-4, 0.05) for k in (1, 9)]
    runs = [kr.simulate(top, top.state(0.3, 60.0), dt=2e-3, t_end=12.0, method="dop853", every=20) for top in tops]
    for strip in kr.plot(runs[0], compare=runs[1]).subfigs[1].axes:
        lines = [line for line in strip.lines if "sqrt" not in line.get_label()]
        assert len(lines) == 2 and np.allclose([line.get_xdata()[-1] for line in lines], 12.0, atol=0.2)
    system = kr.LagrangeTop(p=(0, 0, 1))
    bare = kr.simulate(system, system.state(m=(0.1, 0.2, 1.5), a=(0.6, 0, 0.8)), dt=0.05, steps=10)
    with pytest.raises(kr.InputError, match=r"^compare: expected two runs of bodies in SI"):
        kr.plot(runs[0], compare=bare)


BAD = {
    "frame": (lambda run: kr.analysis.pointing(run, frame="orbt"), "Did you mean 'orbit'"),
    "target": (lambda run: kr.plot(run, target="nadr"), "Did you mean 'nadir'"),
    "direction": (lambda run: kr.plot(run, target=(0, 0, 0)), r"target: expected a vector \(3,\)"),
    "axis": (lambda run: kr.plot(run, axis=(0, 1)), r"axis: expected a vector \(3,\)"),
    "sun": (lambda run: kr.plot(run, target="sun"), "a satellite in sunlight"),
    "no satellite": (lambda run: kr.analysis.pointing(run.assign_attrs(parameters="{}")), "the run of a satellite"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_input(name):
    body = Satellite(TENSOR, EQUATORIAL)
    call, words = BAD[name]
    with pytest.raises(kr.InputError, match=words):
        call(run_of(body, body.pointing(), steps=1))


def test_a_page_reads_its_archive_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from xarray.backends.zarr import ZarrArrayWrapper

    satellite = Satellite((1.0, 2.0, 2.5), Orbit.circular("500 km"))
    start = satellite.state(("4 deg/s", "2 deg/s", 0))
    kr.simulate(satellite, start, dt=10.0, steps=300, every=5, path=tmp_path / "a.zarr", progress=False)
    run, reads, read = kr.open_run(tmp_path / "a.zarr"), [], ZarrArrayWrapper.__getitem__
    monkeypatch.setattr(ZarrArrayWrapper, "__getitem__", lambda array, key: reads.append(key) or read(array, key))
    kr.view(run)
    assert len(reads) < run.sizes["time"]
