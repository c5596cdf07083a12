"""Orbit and attitude for other programs, read back by SPICE and by a reader of CCSDS messages."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from scipy.spatial.transform import Rotation, Slerp

import kreisel as kr
from kreisel.physical import Asteroid, FreeBody, Orbit, Satellite

try:
    import spiceypy as spice
except ImportError:
    spice = None
needs_spice = pytest.mark.skipif(spice is None, reason="no spiceypy")
EPOCH = "2026-03-20T14:45:53"
AXES = Rotation.from_rotvec([0.3, -0.5, 0.9]).as_matrix()
ATTITUDE = (0.5, 0.5, -0.5, 0.5)


@pytest.fixture(autouse=True)
def unloaded():
    yield
    if spice is not None:
        spice.kclear()


def leap_seconds(folder: Path) -> str:
    """The leap second kernel, with the table of astropy and the constants of NAIF's."""
    from astropy.utils.iers import LeapSeconds

    months = "JAN FEB MAR APR MAY JUN JUL AUG SEP OCT NOV DEC".split()
    rows = [f"{int(r['tai_utc'])}, @{r['year']}-{months[r['month'] - 1]}-1" for r in LeapSeconds.auto_open()]
    rows = [row for row in rows if int(row.split("@")[1][:4]) >= 1972]
    text = "KPL/LSK\n\\begindata\nDELTET/DELTA_T_A = 32.184\nDELTET/K = 1.657D-3\nDELTET/EB = 1.671D-2\n"
    text += f"DELTET/M = ( 6.239996 1.99096871D-7 )\nDELTET/DELTA_AT = (\n{chr(10).join(rows)} )\n"
    (folder / "naif.tls").write_text(text)
    return str(folder / "naif.tls")


@pytest.fixture(scope="module")
def spinning() -> xr.Dataset:
    """A body given along other axes than its principal axes, 0.3 rad from row to row."""
    body = FreeBody(AXES @ np.diag([1.0, 2.0, 2.5]) @ AXES.T)
    start = body.state((0.4, -0.3, 0.2))
    return kr.simulate(body.model(), start, dt=0.5, steps=40, orientation=body.orientation(ATTITUDE), progress=False)


@needs_spice
def test_the_rotation_that_the_documentation_of_spice_turns(tmp_path: Path) -> None:
    """SPICE's `axisar`: a matrix that turns vectors by pi/2 about z maps x to y; a C-matrix maps space to the body."""
    body, quarter = FreeBody((1.0, 1.0, 1.0)), np.pi / 2
    run = kr.simulate(
        body.model(), body.state((0, 0, quarter)), dt=0.125, steps=8, orientation=(1, 0, 0, 0), progress=False
    )
    kr.export(run, tmp_path / "turn.bc", epoch=EPOCH)
    spice.furnsh(str(tmp_path / "turn.bc"))
    C, rate, _ = spice.ckgpav(-999000, 2e6, 0, "J2000")
    assert np.allclose(spice.axisar([0, 0, 1], quarter) @ [1, 0, 0], [0, 1, 0], atol=1e-15)
    assert np.allclose(C, spice.axisar([0, 0, 1], quarter).T, atol=1e-12)  # the body has turned by pi/2 in 1 s
    assert np.allclose(rate, [0, 0, quarter])


@pytest.mark.parametrize("system", ["UTC", "utc", "TAI"])
def test_dates_count_leap_seconds_as_astropy_does(spinning: xr.Dataset, tmp_path: Path, system: str) -> None:
    """Rows every half second from 10 s before the end of 2016, when UTC had a second 60."""
    from astropy.time import Time

    kr.export(spinning, tmp_path / "leap.aem", epoch="2016-12-31T23:59:50", time_system=system)
    data = (tmp_path / "leap.aem").read_text().split("DATA_START\n")[1].split("DATA_STOP")[0]
    dates = [line.split()[0] for line in data.splitlines()]
    times = Time(dates, scale=system.lower())
    assert np.allclose((times - times[0]).to_value("s"), spinning.time, rtol=0, atol=1e-6)
    kr.export(spinning, tmp_path / "zone.aem", epoch="2017-01-01T01:59:50+02:00", time_system=system)  # no warning
    assert (tmp_path / "zone.aem").read_text().split("DATA_START\n")[1].startswith(dates[0])
    assert ("2016-12-31T23:59:60.500000" in dates) == (system != "TAI")


@needs_spice
def test_a_kernel_that_starts_after_a_leap_second(spinning: xr.Dataset, tmp_path: Path) -> None:
    kr.export(spinning, tmp_path / "whole.aem", epoch="2016-12-31T23:59:50")
    kr.export(spinning.isel(time=slice(21, None)), tmp_path / "late.bc", epoch="2016-12-31T23:59:50")
    for file in (leap_seconds(tmp_path), tmp_path / "late.bc", tmp_path / "late.tsc"):
        spice.furnsh(str(file))
    line = (tmp_path / "whole.aem").read_text().split("DATA_START\n")[1].splitlines()[21]
    date, *q = line.split()
    C = spice.pxform("J2000", "BODY_BODY", spice.str2et(date))
    assert date.endswith(":60.500000")
    assert np.allclose(C, Rotation.from_quat([float(x) for x in q]).as_matrix().T, rtol=0, atol=1e-9)


@needs_spice
def test_spice_has_the_attitudes_at_their_dates(spinning: xr.Dataset, tmp_path: Path) -> None:
    kr.export(spinning, tmp_path / "body.bc", epoch=EPOCH, name="My body")
    for file in (leap_seconds(tmp_path), tmp_path / "body.bc", tmp_path / "body.tsc"):
        spice.furnsh(str(file))
    g, begin = kr.analysis.rotations(spinning), spice.str2et(EPOCH)
    times = np.array([1e-6, 0.5, 3.7, 11.1, 19.99])  # near rows, and between them
    for t, want in zip(times, Slerp(spinning.time.values, g)(times).as_matrix(), strict=True):
        assert np.allclose(spice.pxform("J2000", "MY_BODY_BODY", begin + t), want.T, atol=3e-6)
    for row in (0, 17, 40):
        _, rate, _ = spice.ckgpav(-999000, 1e6 + 0.5e6 * row, 0, "J2000")
        assert np.allclose(rate, kr.analysis.angular_velocity(spinning, frame="space")[row], atol=1e-12)
    with pytest.raises(kr.InputError, match="exists already"):
        kr.export(spinning, tmp_path / "body.bc", epoch=EPOCH)
    kr.export(spinning, tmp_path / "body.bc", epoch=EPOCH, overwrite=True)


@needs_spice
def test_spice_does_not_interpolate_over_half_a_turn(spinning: xr.Dataset, tmp_path: Path) -> None:
    """Rows 3 s apart at 0.54 rad/s are interpolated, rows 10 s apart are not."""
    for every, is_found in ((6, True), (20, False)):
        kr.export(spinning.isel(time=slice(None, None, every)), tmp_path / f"{every}.bc", epoch=EPOCH)
        spice.furnsh(str(tmp_path / f"{every}.bc"))
        try:
            spice.ckgp(-999000, 1.5e6, 0, "J2000")
            assert is_found
        except spice.utils.exceptions.NotFoundError:
            assert not is_found
        spice.kclear()


def test_orbit_message(tmp_path: Path) -> None:
    """Kilometres; the speed of a circular orbit at 500 km, 7.6126 km/s; over the node it goes north and east."""
    from ccsds_ndm.ndm_io import NdmIo

    orbit = Orbit.circular("500 km", inclination="51.6 deg", node="90 deg")
    satellite = Satellite((1.0, 2.0, 2.5), orbit)
    run = kr.simulate(satellite.model(), satellite.state(), dt=60.0, steps=10, orientation=(1, 0, 0, 0), progress=False)
    kr.export(run, tmp_path / "a.oem", epoch=EPOCH, frame="TOD")
    segment = NdmIo().from_path(tmp_path / "a.oem").body.segment[0]
    assert (segment.metadata.ref_frame, segment.metadata.center_name) == ("TOD", "EARTH")
    rows = segment.data.state_vector
    assert (rows[0].epoch, rows[10].epoch) == (f"{EPOCH}.000000", "2026-03-20T14:55:53.000000")
    r, v = (
        np.array([[float(getattr(row, k).value) for k in names] for row in rows])
        for names in (("x", "y", "z"), ("x_dot", "y_dot", "z_dot"))
    )
    assert np.allclose(np.linalg.norm(r, axis=-1), 6878.137) and np.allclose(
        np.linalg.norm(v, axis=-1), 7.6126, atol=1e-4
    )
    assert np.allclose(r[0], [0, 6878.137, 0]) and v[0, 2] > 0 and np.cross(r[0], v[0])[2] > 0
    assert np.allclose((r[2:] - r[:-2]) / 120, v[1:-1], atol=5e-3)  # km/s


def test_an_orbit_around_the_sun_names_it(tmp_path: Path) -> None:
    kr.export(around_the_sun(), tmp_path / "a.oem", epoch=EPOCH, frame="ICRF", center="SUN")
    text = (tmp_path / "a.oem").read_text()
    assert "CENTER_NAME = SUN\nREF_FRAME = ICRF\n" in text
    row = [float(x) for x in text.splitlines()[-1].split()[1:]]
    assert np.linalg.norm(row[:3]) == pytest.approx(2.5321 * (1 - 0.6288) * 149_597_870.7, rel=1e-4)  # km


def test_an_orbit_with_a_date_is_written_in_the_frame_of_j2000(tmp_path: Path) -> None:
    """The rows by the date of the orbit, rotated by the precession that ERFA has for it."""
    import erfa
    from astropy.time import Time
    from ccsds_ndm.ndm_io import NdmIo

    orbit = Orbit.circular("500 km", inclination="51.6 deg", epoch=EPOCH)
    satellite = Satellite((1.0, 2.0, 2.5), orbit, magnetic_field="dipole")
    run = kr.simulate(satellite, satellite.state(), dt=60.0, steps=2, progress=False)
    for end, more in (("oem", {}), ("aem", {}), ("bc", {}) if spice else ("aem", {"overwrite": True})):
        kr.export(run, tmp_path / f"a.{end}", **more)
    date = Time(EPOCH).tt
    to_j2000 = erfa.pmat76(date.jd1, date.jd2).T
    segment = NdmIo().from_path(tmp_path / "a.oem").body.segment[0]
    row = segment.data.state_vector[2]
    assert segment.metadata.ref_frame == "EME2000"
    assert row.epoch == "2026-03-20T14:47:53.000000"
    place = np.array([float(getattr(row, k).value) for k in ("x", "y", "z")])
    assert np.allclose(place, to_j2000 @ orbit.at(120.0)[0] / 1000, atol=1e-5)
    g = to_j2000 @ kr.analysis.rotations(run)[2].as_matrix()
    states = NdmIo().from_path(tmp_path / "a.aem").body.segment[0].data.attitude_state
    q = [float(getattr(states[2].quaternion_state.quaternion, k)) for k in ("qc", "q1", "q2", "q3")]
    assert np.allclose(Rotation.from_quat(q, scalar_first=True).as_matrix(), g, atol=1e-9)
    if spice:
        spice.furnsh(str(tmp_path / "a.bc"))
        C, rate, _ = spice.ckgpav(-999000, 121e6, 0, "J2000")
        assert np.allclose(C, g.T, atol=1e-9)
        assert np.allclose(C @ rate, run.angular_velocity[2], atol=1e-12)
    with pytest.raises(kr.InputError, match="epoch: expected 2026-03-20T14:45:53"):
        kr.export(run, tmp_path / "b.oem", epoch="2026-03-21")


def test_a_table_has_units_and_the_angles_that_are_asked_for(tmp_path: Path) -> None:
    """A satellite that rests in space turns backwards against its orbit, at the rate of the orbit."""
    import pandas as pd

    orbit = Orbit.circular("500 km")
    satellite = Satellite((1.0, 2.0, 2.5), orbit)
    upright = {"attitude": (1, 0, 0, 0), "spin": (0, 0, 1e-12)}  # the principal axes are up, ahead and the normal
    run = kr.simulate(satellite, satellite.state(**upright), dt=1.0, steps=2, progress=False)
    for frame in ("orbit", "inertial", "ground"):
        kr.export(run, tmp_path / f"{frame}.csv", angles=frame)
    found = {frame: pd.read_csv(tmp_path / f"{frame}.csv") for frame in ("orbit", "inertial", "ground")}
    assert {"time (s)", "momentum[0] (kg m^2/s)", "energy (J)", "attitude[0]", "pitch (deg)"} <= set(found["orbit"])
    assert np.allclose(found["orbit"]["pitch (deg)"], -360 / orbit.period * np.arange(3), atol=1e-4)
    assert np.allclose(found["inertial"][["pitch (deg)", "roll (deg)", "yaw (deg)"]], 0, atol=1e-4)
    assert np.allclose(found["ground"]["pitch (deg)"][0], 90)  # its first axis, which points up, against north
    with pytest.raises(kr.InputError, match=r"angles: expected a file that ends in \.nc"):
        kr.export(run, tmp_path / "a.oem", epoch=EPOCH, angles="orbit")
    with pytest.raises(kr.InputError, match="Did you mean 'ground'"):
        kr.export(run, tmp_path / "a.csv", angles="grund")


@pytest.mark.parametrize(("angle", "axis"), [("pitch", 1), ("roll", 0), ("yaw", 2)])
def test_lvlh_angles_have_the_signs_of_pilots(angle: str, axis: int) -> None:
    """Pitch is nose up, roll is right wing down, yaw is nose right."""
    cos, sin = np.cos(0.1), np.sin(0.1)
    up, ahead, right = np.array([1.0, 0, 0]), np.array([0, 1.0, 0]), np.array([0, 0, -1.0])
    nose, wing = {
        "pitch": (cos * ahead + sin * up, right),
        "roll": (ahead, cos * right - sin * up),
        "yaw": (cos * ahead + sin * right, cos * right - sin * ahead),
    }[angle]
    g = Rotation.from_matrix(np.column_stack([nose, wing, np.cross(nose, wing)])).as_quat(scalar_first=True)
    satellite = Satellite((1.0, 2.0, 2.5), Orbit.circular("500 km"))
    run = kr.simulate(satellite, satellite.state(attitude=g), dt=1.0, steps=2, progress=False)
    angles = kr.analysis.pointing(run, frame="lvlh").isel(time=0)
    values = [float(angles[name]) for name in ("roll", "pitch", "yaw")]
    assert np.allclose(values, 0.1 * np.eye(3)[axis], atol=1e-12)


def around_the_sun() -> xr.Dataset:
    body = Asteroid.toutatis()
    return kr.simulate(body, body.state((1e-5, 0, 1e-6)), dt="1 h", steps=2, progress=False)


def dated() -> xr.Dataset:
    body = Satellite((1.0, 2.0, 2.5), Orbit.circular("500 km", epoch=EPOCH))
    return kr.simulate(body, body.state(), dt=60.0, steps=2, progress=False)


BAD = {
    "no date": (lambda run: kr.export(run, "x.oem"), "epoch: expected the date"),
    "Unix time": (lambda run: kr.export(run, "x.aem", epoch=1_700_000_000), "epoch: expected the date of time 0"),
    "no satellite": (lambda run: kr.export(run, "x.oem", epoch=EPOCH), "the run of a satellite"),
    "of the Sun": (lambda run: kr.export(around_the_sun(), "x.oem", epoch=EPOCH, frame="ICRF"), "frame, center: .*SUN"),
    "its space": (lambda run: kr.export(around_the_sun(), "x.aem", epoch=EPOCH), "frame, center: expected the frame"),
    "label": (lambda run: kr.export(run, "x.bc", epoch=EPOCH, nmae="a"), "got nmae. Did you mean 'name'"),
    "label of a table": (lambda run: kr.export(run, "x.csv", name="a"), r"name: expected a file that ends in \.aem"),
    "frame": (
        lambda run: kr.export(run, "x.bc", epoch=EPOCH, frame="TOD"),
        "SPICE refuses the kernel: The ref.*J2000 is EME2000",
    ),
    "unit": (lambda run: kr.export(run, "x.aem", epoch=EPOCH, time_unit=60), "time_unit: expected none"),
    "spacecraft": (lambda run: kr.export(run, "x.bc", epoch=EPOCH, spacecraft=7), "below 0, got 7"),
    "scale": (
        lambda run: kr.export(run, "x.bc", epoch=EPOCH, time_system="GPS"),
        "expected UTC, TAI or TT",
    ),
    "backwards": (
        lambda run: kr.export(run.isel(time=[1, 0]), "x.aem", epoch=EPOCH),
        "times increase by micro.*got others",
    ),
    "same dates": (
        lambda run: kr.export(run.assign_coords(time=run.time * 1e-7), "x.aem", epoch=EPOCH),
        "times increase by micro.*got others",
    ),
    "no row": (lambda run: kr.export(run.isel(time=[]), "x.aem", epoch=EPOCH), "times increase by micro.*got others"),
    "in minutes": (
        lambda run: kr.export(kr.units.measured(run, time="min"), "x.aem", epoch=EPOCH),
        "such as one of units.measured",
    ),
    "scale of the orbit": (lambda run: kr.export(dated(), "x.oem", time_system="TAI"), "expected UTC.*got 'TAI'"),
    "not ASCII": (lambda run: kr.export(run, "x.bc", epoch=EPOCH, name="été"), "name: expected a word in ASCII"),
    "one row": (lambda run: kr.export(run.isel(time=0), "x.aem", epoch=EPOCH), r"single row is run.isel\(time=\[0"),
    "before UTC": (lambda run: kr.export(run, "x.bc", epoch="1957-10-04"), "from 1972 on"),
}


@needs_spice
@pytest.mark.parametrize("name", BAD)
def test_bad_input(name: str, spinning: xr.Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    call, words = BAD[name]
    with pytest.raises(kr.InputError, match=words):
        call(spinning)
    assert not list(tmp_path.iterdir())
