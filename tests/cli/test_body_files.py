"""Bodies in TOML files: what `kreisel new` writes, the constructors of Python, and all mistakes in one message."""

from __future__ import annotations

import re
import sys
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

import kreisel as kr
from kreisel import cli
from kreisel.cli.configuration import Reader, kinds, parse, parse_sweep, read
from kreisel.cli.new import samples, text_of_body
from kreisel.errors import Faults
from kreisel.physical import (
    SATURN,
    SUN,
    Asteroid,
    Binary,
    FreeBody,
    GravityBody,
    Gyroscope,
    HeavyBody,
    Orbit,
    Satellite,
    SubmergedBody,
    ThirdBody,
    Wheels,
)
from kreisel.runs.planning import make_plan
from kreisel.sweeps.sweep import check_archive
from support import EXAMPLES

END = '[run]\ndt = "1 s"\nsteps = 10\n[output]\npath = "x.zarr"\n'


def body_of(text: str, folder: Path = Path()) -> Any:
    faults = Faults()
    body = Reader(faults, folder).body(tomllib.loads(text))
    faults.report("text")
    return body


def mistakes(text: str) -> list[str]:
    with pytest.raises(kr.InputError) as caught:
        parse(tomllib.loads(text))
    return str(caught.value).split("\n")


def test_every_body_has_a_file_that_plans() -> None:
    assert kinds().keys() == samples().keys()
    for name in samples():
        text = text_of_body(name, Path("x.toml"))
        assert max(map(len, text.split("\n"))) <= 120
        asked = parse(tomllib.loads(text))
        settings = {"dt": asked.run.dt, "steps": asked.run.steps, "every": asked.run.every, "order": asked.run.order}
        plan = make_plan(asked.model, asked.state, **settings, orientation=asked.orientation)
        assert 500 < plan.rows < 3001 and (asked.orientation is not None or "q1" in asked.state)


@pytest.mark.parametrize("start", ["1.5", '"1.5 s"', '"1500 ms"'])
def test_a_start_is_in_seconds(start: str) -> None:
    """The unit of time of a gyroscope is not 1 s: plain values were multiples of it."""
    text = text_of_body("gyroscope", Path("x.toml"))
    run = re.sub(r"\[run\](.|\n)*\[output\]", f'[run]\ndt = "1 ms"\nt_start = {start}\nt_end = "2 s"\n[output]', text)
    asked = parse(tomllib.loads(run))
    assert (asked.run.t_start * asked.body.time_unit, asked.run.steps) == (pytest.approx(1.5, rel=1e-15), 500)
    assert any("t_start must have the dimension of s" in m for m in mistakes(run.replace(start, '"1 kg"', 1)))


def test_the_states_are_those_that_their_comments_say() -> None:
    def parts(name: str) -> tuple[Any, Any]:
        tables = tomllib.loads(text_of_body(name, Path("x.toml")))
        faults = Faults()
        reader = Reader(faults)
        body = reader.body(tables["body"])
        return body, reader.state(type(body), body, tables["state"])

    top, state = parts("gyroscope")
    assert np.degrees(np.arccos(state.a[2])) == pytest.approx(30)
    assert state.axial["m"] @ state.a * top.momentum_unit == pytest.approx(3.6e-5 * 3000 * 2 * np.pi / 60)
    satellite, state = parts("satellite")
    assert np.degrees(np.linalg.norm(satellite.angular_velocity(state.axial["M"]))) == pytest.approx(5, abs=0.1)
    assert satellite.orbit.period / 60 == pytest.approx(94.6, abs=0.05)
    moon, _ = parts("asteroid")
    assert moon.orbit.period / 86400 == pytest.approx(21.28, abs=0.01)  # Hyperion's


def test_new_and_run_in_a_new_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any) -> None:
    monkeypatch.chdir(tmp_path)
    for words in (("new", "gyroscope"), ("run", "gyroscope.toml", "--set", "run.t_end=20 ms", "--no-figure")):
        monkeypatch.setattr("sys.argv", ["kreisel", *words])
        with pytest.raises(SystemExit) as stopped:
            cli.main()
        assert not stopped.value.code, capsys.readouterr().err
    run = kr.open_run(tmp_path / "gyroscope.zarr")
    top = Gyroscope.flat("100 g", "360 g cm^2", "3 cm")
    start = top.state(tilt="30 deg", spin="3000 rpm")
    same = kr.simulate(top, start, dt="1 ms", t_end="20 ms", every="5 ms", progress=False)
    assert run.time.units == "s" and run.time.values.tolist() == pytest.approx([0, 0.005, 0.01, 0.015, 0.02])
    for name in same.data_vars:
        assert (run[name].values == same[name].values).all(), name


BALL = "{{ mass = {}, inertia = [{}, {}, {}], size = {} }}"
BINARY = f"""
[body]
kind = "binary"
primary = {BALL.format(5e11, 1e16, 1e16, 1e16, 400)}
secondary = {BALL.format(4e9, 1e13, 1e13, 1e13, 80)}
third = {{ mass = 1e3, position = [-2e4, 200, 0], velocity = [2, 0, 0] }}
[state]
separation = 1200
[run]
dt = "5 min"
t_end = "5 h"
[output]
path = "x.zarr"
"""
FIELD = """
[body]
kind = "satellite"
inertia = [1, 1.5, 2]
magnetic_moment = [0, 0, 0.1]
orbit = { semi_major_axis = "7000 km", epoch = "2029-12-31T00:00:00" }
[state]
spin = [0, 0, 0.001]
[run]
dt = "100 s"
t_end = "3 days"
[output]
path = "x.zarr"
"""


@pytest.mark.filterwarnings("default")
@pytest.mark.parametrize(("text", "said"), [(BINARY, "expected bodies apart"), (FIELD, "IGRF-14 holds until 2030")])
def test_a_run_of_a_file_warns_as_in_python(
    text: str, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("x.toml").write_text(text)
    monkeypatch.setattr("sys.argv", ["kreisel", "run", "x.toml", "--no-figure"])
    with pytest.raises(SystemExit) as stopped:
        cli.main()
    assert not stopped.value.code
    assert f"kreisel: warning: {said}" in capsys.readouterr().err


def alike(one: Any, other: Any) -> bool:
    """Whether two bodies have the same type, mass and parameters."""
    params, others = one.model().params, other.model().params
    same = type(one) is type(other) and getattr(one, "mass", None) == getattr(other, "mass", None)
    return same and params.keys() == others.keys() and all(np.array_equal(v, others[k]) for k, v in params.items())


@pytest.mark.parametrize(
    ("text", "make"),
    [
        (
            'kind = "gyroscope"\nshape = "flat"\nmass = 3\naxial_moment = 0.17\nlever = 0.15',
            lambda: Gyroscope.flat(3, 0.17, 0.15),
        ),
        (
            'kind = "free-body"\nmass = 2\ndiameters = ["1 cm", 0.2, "3 cm"]',
            lambda: FreeBody.ellipsoid(2, (0.01, 0.2, 0.03)),
        ),
        (
            'kind = "satellite"\nunits = 6\n[orbit]\naltitude = "6000 km"\nprimary = "saturn"',
            lambda: Satellite.cubesat(Orbit.circular(6e6, primary=SATURN), 6),
        ),
        (
            'kind = "satellite"\ninertia = [[[5, 1, 0], [1, 4, 0], [0, 0, 3]], "kg cm^2"]\n'
            "plates = [{ normal = [1, 0, 0], centre = [0.1, 0, 0], area = 0.03 }]\n"
            '[orbit]\nsemi_major_axis = "7000 km"\neccentricity = 0.01',
            lambda: Satellite(
                ([[5, 1, 0], [1, 4, 0], [0, 0, 3]], "kg cm^2"),
                Orbit(7e6, 0.01),
                plates=(kr.physical.Plate((1, 0, 0), (0.1, 0, 0), 0.03),),
            ),
        ),
        (
            'kind = "satellite"\ninertia = [2, 3, 4]\n[orbit]\nsemi_major_axis = 7e6\n[harmonics]\nmass = 3\n'
            'radius = 1\ncoefficients = { "3,1" = [1e-3, 2e-3] }',
            lambda: Satellite((2, 3, 4), Orbit(7e6), harmonics=kr.physical.Harmonics(3, 1, {(3, 1): (1e-3, 2e-3)})),
        ),
        ('kind = "asteroid"\nshape = "hyperion"', Asteroid.hyperion),
        (
            'kind = "asteroid"\nmass = 3e9\ndiameters = [300, 200, 100]\nlight = 4e-6\n'
            "plates = [{ normal = [1, 0, 0], centre = [0, 1, 0], area = 5 }]\n"
            '[orbit]\nsemi_major_axis = "1 au"\nprimary = "sun"',
            lambda: Asteroid.ellipsoid(
                3e9,
                (300, 200, 100),
                Orbit("1 au", primary=SUN),
                light=4e-6,
                plates=[kr.physical.Plate((1, 0, 0), (0, 1, 0), 5)],
            ),
        ),
        (
            'kind = "binary"\n[primary]\nmass = 3e11\ndiameters = ["0.8 km", 700, 600]\nlove = 1e-5\nlag = "2 min"\n'
            "[secondary]\nmass = 2e9\ninertia = [2e12, 3e12, 4e12]\n"
            "[third]\nmass = 1e13\nposition = [1e5, 0, 0]\nvelocity = [0, 5, 0]",
            lambda: Binary(
                GravityBody.ellipsoid(3e11, (800, 700, 600), 1e-5, 120.0),
                GravityBody(2e9, (2e12, 3e12, 4e12)),
                ThirdBody(1e13, (1e5, 0, 0), (0, 5, 0)),
            ),
        ),
        ('kind = "binary"\nshape = "didymos"\nsun = true\nlove = 1e-5', lambda: Binary.didymos(sun=True, love=1e-5)),
        (
            'kind = "submerged-body"\nshape = "cylinder"\nradius = 0.1\nlength = 2\nmass = 60\nfluid_density = 1000\n'
            "gravity = 9.8",
            lambda: SubmergedBody.cylinder(0.1, 2, 60, 1000, gravity=9.8),
        ),
    ],
)
def test_tables_are_the_arguments_of_python(text: str, make: Any) -> None:
    assert alike(body_of(text), make())


TLE = (
    "1 25544U 98067A   08264.51782528 -.00002182  00000-0 -11606-4 0  2927",
    "2 25544  51.6416 247.4627 0006703 130.5360 325.0288 15.72125391563537",
)


@pytest.mark.parametrize(
    ("table", "make"),
    [
        (f'line1 = "{TLE[0]}"\nline2 = "{TLE[1]}"', lambda: Orbit.from_tle(*TLE)),
        (
            'r = ["7000 km", "0 km", "0 km"]\nv = [0, "5 km/s", "6 km/s"]\nepoch = 2026-03-20T14:46:00',
            lambda: Orbit.from_state((7e6, 0, 0), (0, 5e3, 6e3), epoch="2026-03-20T14:46:00"),
        ),
        (
            'altitude = "500 km"\nmean_anomaly = "30 deg"\nepoch = "2026-03-20"\nJ2 = true',
            lambda: Orbit.circular(5e5, mean_anomaly=np.radians(30), epoch="2026-03-20", J2=True),
        ),
        (
            'semi_major_axis = "7000 km"\neccentricity = 0.1\ntrue_anomaly = "90 deg"\n'
            'primary = { name = "Ball", mu = 4e14, radius = "6000 km" }',
            lambda: Orbit(7e6, 0.1, true_anomaly=np.pi / 2, primary=kr.physical.Primary("Ball", 4e14, 6e6)),
        ),
    ],
)
def test_orbits_by_what_a_person_has(table: str, make: Any) -> None:
    found, orbit = body_of(f'kind = "satellite"\ninertia = [1, 2, 3]\n[orbit]\n{table}').orbit, make()
    assert found.elements == orbit.elements and found.epoch == orbit.epoch


def test_bodies_from_files_next_to_the_configuration(tmp_path: Path) -> None:
    mesh = trimesh.creation.box((20, 40, 60), transform=trimesh.transformations.translation_matrix((0, 0, 50)))
    mesh.export(tmp_path / "part.ply")
    part = kr.physical.read_mesh(tmp_path / "part.ply", "mm", density="2700 kg/m^3")
    lines = 'mesh = "part.ply"\nlength = "mm"\ndensity = "2700 kg/m^3"\n'
    assert alike(body_of(f'kind = "free-body"\n{lines}', tmp_path), FreeBody(part.inertia, part.mass))
    assert alike(
        body_of(f'kind = "heavy-body"\n{lines}', tmp_path),
        HeavyBody.about_centre(part.mass, part.inertia, part.center_of_mass),
    )
    made = body_of(f'kind = "satellite"\n{lines}[orbit]\naltitude = 5e5', tmp_path)
    np.testing.assert_array_equal(made.inertia, part.inertia)
    (tmp_path / "robot.urdf").write_text(
        '<robot name="r"><link name="l"><inertial><mass value="2"/>'
        '<inertia ixx="1" iyy="2" izz="3" ixy="0" ixz="0" iyz="0"/></inertial></link></robot>'
    )
    made = body_of('kind = "submerged-body"\nrobot = "robot.urdf"\nlink = "l"\ngravity = 9.8', tmp_path)
    assert made.mass == 2 and made.gravity == 9.8 and made.inertia[2, 2] == 3
    with pytest.raises(kr.InputError, match="length: expected the unit"):
        body_of('kind = "free-body"\nmesh = "part.ply"\nmass = 3', tmp_path)
    with pytest.raises(kr.InputError, match="such as heavy-body"):
        body_of(f'kind = "gyroscope"\n{lines}', tmp_path)


def test_controllers_and_ready_forces_by_their_names() -> None:
    """In a run of the file a tumbling CubeSat is braked, as by the same controller in Python."""
    text = """
        kind = "satellite"
        units = 3
        torque = [{ kind = "eddy-currents", tensor = [1, 2, 3] }]
        [orbit]
        altitude = "500 km"
        [control]
        kind = "bdot"
        gain = "1e-4 N m s"
        every = "2 s"
        limits = { dipole = 0.2 }
    """
    made = body_of(text)
    control = kr.physical.bdot("1e-4 N m s", every="2 s", limits={"dipole": 0.2})
    assert made.control.law is control.law and made.control.parameters == control.parameters
    assert made.control.limits["dipole"] == 0.2 and made.control.every == 2
    np.testing.assert_array_equal(made.torque[0].tensor, np.diag([1.0, 2.0, 3.0]))
    for change, said in (
        (("bdot", "b-dot"), r"\[body.control\] kind: expected one of .*Did you mean 'bdot'"),
        (("gain", "gian"), "Did you mean 'gain'"),
        (("limits", "limts"), "Did you mean 'limits'"),
        (("every", "seed = -1 #"), "seed: expected"),
    ):
        with pytest.raises(kr.InputError, match=said):
            body_of(text.replace(*change))


def test_wheels_of_a_file_are_those_of_python_and_an_archive_has_them(tmp_path: Path) -> None:
    """The archive of their run is resumed and checked without the body, and their parameters are swept."""
    wheels = "[body.wheels]\naxes = [[0, 0.6, 0.8]]\nmomenta = '2 mN m s'\ntorque = 1e-6\n"
    text = f'[body]\nkind = "free-body"\ninertia = [[5, 1, 0], [1, 6, 0], [0, 0, 7]]\n{wheels}{END}'
    asked = parse(tomllib.loads(text.replace("[run]", "[state]\nspin = [1, 2, 3]\n[run]")))
    body = FreeBody([[5, 1, 0], [1, 6, 0], [0, 0, 7]], wheels=Wheels([[0, 0.6, 0.8]], 2e-3, 1e-6))
    start, settings = body.state((1, 2, 3)), {"dt": "1 s", "progress": False}
    short = kr.simulate(asked.model, asked.state, dt=1.0, steps=10, orientation=asked.orientation, progress=False)
    long = kr.simulate(body, start, **settings, steps=20)
    np.testing.assert_array_equal(short.wheels, long.wheels[:11])
    kr.simulate(body, start, **settings, steps=10, path=tmp_path / "x.zarr")
    resumed = kr.resume(tmp_path / "x.zarr", extend=20, progress=False)
    np.testing.assert_array_equal(resumed.attitude, long.attitude)
    assert check_archive(tmp_path / "x.zarr")[1] == []
    grid = kr.Design(grid={"system.wheel_torque[0]": [0.0, 1e-6]})
    swept = kr.sweep(body, start, grid, **settings, steps=20, path=tmp_path / "s.zarr", save=["extremes"], workers=0)
    assert swept.wheels_max.values[:, 0] == pytest.approx((2e-3, 2e-3 + 20e-6), rel=1e-12)


def test_forces_of_a_file_of_python(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text("def friction(Omega):\n    return -0.01 * Omega\n")
    (tmp_path / "x.toml").write_text(
        f'[body]\nfile = "mine.py"\nkind = "free-body"\ninertia = [1, 2, 3]\ntorque = "friction"\n'
        f'[state]\nspin = [0, 0, "1 rad/s"]\n{END}'
    )
    asked = read(tmp_path / "x.toml")
    run = kr.simulate(asked.model, asked.state, dt=0.1, steps=100, orientation=asked.orientation, progress=False)
    assert run.angular_velocity.values[-1, 2] == pytest.approx(np.exp(-0.01 * 10 / 3), rel=1e-6)


def test_values_of_a_file_of_python(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text("import kreisel as kr\nhigh = kr.physical.Orbit.circular('800 km')\n")
    (tmp_path / "x.toml").write_text(f'[body]\nfile = "mine.py"\nkind = "satellite"\nunits = 3\norbit = "high"\n{END}')
    assert read(tmp_path / "x.toml").model.params["semi_major_axis"] == 7_178_137.0


def test_an_attitude_by_its_angles() -> None:
    text = (
        '[body]\nkind = "satellite"\nunits = 3\n[body.orbit]\naltitude = 5e5\n[state]\nattitude = { pitch = "10 deg" }'
    )
    asked = parse(tomllib.loads(f"{text}\n{END}"))
    satellite = Satellite.cubesat(Orbit.circular(5e5))
    np.testing.assert_array_equal(asked.orientation, satellite.orientation(satellite.pointing(pitch="10 deg")))


def test_values_set_in_inner_tables() -> None:
    asked = read(EXAMPLES / "satellite.toml", ["body.orbit.altitude=600 km", "state.attitude.pitch=5 deg"])
    satellite = Satellite.cubesat(Orbit.circular(6e5, inclination=np.radians(97.4)))
    assert asked.model.params["semi_major_axis"] == 6_978_137.0
    np.testing.assert_allclose(
        asked.orientation, satellite.orientation(satellite.pointing(pitch=np.radians(5))), rtol=1e-14
    )


def test_all_mistakes_in_one_message() -> None:
    found = mistakes("""
        [body]
        kind = "satellite"
        inertia = [[500, 100, -40], [100, 400, 60], [-40, 60, 300]]
        lite = 3
        torque = ["1 mN n", 0, 0]
        [body.orbit]
        altitude = "500 km"
        primary = "earht"
        [state]
        axes = 3
        [run]
        dt = "10 m"
        t_end = -3
        every = 0
        ordre = 3
        method = 3
        [output]
        figure = "x.txt"
    """)
    for words in (
        ("[body]", "'lite'", "'light'"),
        ("[body.torque]", "its unit is not known"),
        ("[body.orbit.primary]", "'earth'"),
        ("[state]", "'axis'"),
        ("[run]", "dt must have the dimension of s"),
        ("[run]", "t_end must be a positive"),
        ("[run]", "every must be"),
        ("[run]", "'order'"),
        ("[run]", "method: expected a name"),
        ("[output]", "path"),
        ("[output]", "'x.txt'"),
    ):
        assert sum(all(word in line for word in words) for line in found) == 1, words
    assert len(found) == 12 and "got 11" in found[0]


def test_all_mistakes_of_a_binary() -> None:
    found = mistakes("""
        [body]
        kind = "binary"
        [body.primary]
        mass = "5.6e11 kgg"
        diameters = [849, 851, 620]
        [body.secondary]
        mas = 3
        diameters = [177, 174, 116]
        [body.third]
        mass = 3
        positon = [1, 2, 3]
        velocity = [1, 2, 3]
        [state]
        semi_major_axs = 4
        [run]
        dt = "1 hour"
        steps = 3
        [output]
        path = "x.zarr"
    """)
    for place, words in (
        ("primary.mass", "its unit is not known"),
        ("secondary", "Did you mean 'mass'"),
        ("secondary", "expected mass too"),
        ("third", "Did you mean 'position'"),
        ("third", "expected position too"),
        ("[state]", "Did you mean 'semi_major_axis'"),
    ):
        assert sum(place in line and words in line for line in found) == 1, words
    assert len(found) == 7


def test_without_pint(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pint", None)
    kr.units.registry.cache_clear()
    found = mistakes(text_of_body("gyroscope", Path("x.toml")))
    assert len(found) == 1 and "pip install 'kreisel[units]'" in found[0]
    monkeypatch.undo()
    kr.units.registry.cache_clear()


def test_a_bad_step_is_one_mistake() -> None:
    """With t_end in seconds, the rows are counted in a step that is not known."""
    text = '[body]\nkind = "free-body"\ninertia = [1, 2, 2.5]\n[state]\nspin = [1, 0, 0]\n[run]\ndt = "1 mm"\n'
    found = mistakes(f'{text}t_end = "1 s"\nevery = 10\n[output]\npath = "x.zarr"\n')
    assert len(found) == 1 and "dt must have the dimension of s" in found[0]


def test_lists_of_values_are_several_bodies() -> None:
    body = '[body]\nkind = "submerged-body"\nmass = [1, 2]\ninertia = [1, 1, 1]\n[state]\nvelocity = [1, 0, 0]\n'
    found = mistakes(f'{body}[run]\ndt = "1 s"\nsteps = 3\n[output]\npath = "x.zarr"\n')
    assert len(found) == 1 and "the values of one body, got lists for 2" in found[0]


def test_impulses_of_no_kind() -> None:
    text = text_of_body("free-body", Path("x.toml")).replace("[run]", "[run]\nimpulses = -1")
    assert "impulses: expected a dict" in mistakes(text)[0]


def test_mistakes_in_a_system_too() -> None:
    found = mistakes(
        '[system]\nname = "lagrange-top"\np = [0, 0, "a"]\n[state]\nm = [1, 2, 3]\n[run]\ndt = -1\nsteps = 3.5\n'
    )
    assert [line.split()[0].strip(":") for line in found[1:]] == ["needs", "[system]", "[run]", "[run]"]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("mass = 3", "kind: expected one of asteroid, binary, ellipsoid, free-body"),
        ('kind = "freebody"', "Did you mean 'free-body'"),
        ('kind = "gyroscope"\nmass = 3\nlever = 1', "expected axial_moment, transverse_moment too"),
        ('kind = "gyroscope"\nmass = 3\nlever = 1\naxial_moment = 1', "one of these needs: shape = flat"),
        ('kind = "free-body"\nshape = "bax"', "Did you mean 'box'"),
        ('kind = "free-body"\nshape = [{}]', "shape: expected one of"),
        ('kind = "satellite"\ninertia = [1, 2, 3]\norbit = 3', "orbit: expected kr.physical.Orbit"),
        ('kind = "satellite"\ninertia = [1, 2, 9]\n[orbit]\naltitude = 5e5', "No body has the principal moments"),
        ('kind = "satellite"\ninertia = [1, 2, 3]\n[orbit]\naltitude = -5e5', "hits the Earth"),
        ('kind = "satellite"\nunits = 3\ninertia = [1, 2, 3]\n[orbit]\naltitude = 5e5', "got 'inertia'"),
    ],
)
def test_tables_of_no_body(text: str, said: str) -> None:
    with pytest.raises(kr.InputError, match=said):
        body_of(text)


def test_a_sweep_begins_from_a_body() -> None:
    text = text_of_body("free-body", Path("x.toml")).replace("# figure", "#")
    description, _, _ = parse_sweep(tomllib.loads(f'{text}\n[sweep.grid]\n"state.M[0]" = [0.1, 0.2]'))
    assert description["system"]["name"] == "euler-top" and description["run"]["dt"] == 0.002
    assert description["body"]["units"]["time"][1] == 1.0 and len(description["state"]["orientation"]) == 4


def test_a_sweep_over_values_of_a_body() -> None:
    text = text_of_body("free-body", Path("x.toml")).replace("# figure", "#")
    table = 'body.mass = ["900 g", "1.8 kg"]\n"state.spin[1]" = ["60 rpm", "120 rpm", "180 rpm"]'
    description, _, _ = parse_sweep(tomllib.loads(f"{text}\n[sweep]\n{table}"))
    spec = description["sweep"]
    assert [axis[:2] for axis in spec["axes"]] == [["body.mass", 2], ["state.spin[1]", 3]]
    assert np.allclose(spec["shown"]["body.mass"], np.repeat([0.9, 1.8], 3))
    assert np.allclose(spec["shown"]["state.spin[1]"], np.tile([2, 4, 6], 2) * np.pi)
    momenta = np.array(spec["list"]["state.M"])[:, 1] * np.ravel(description["body"]["units"]["M"][1])
    middle = 0.9 * (0.03**2 + 0.24**2) / 12 * np.repeat([1, 2], 3) * np.tile([2, 4, 6], 2) * np.pi
    assert np.allclose(momenta, np.ravel(middle))
    with pytest.raises(kr.InputError, match=r"Lane 1: .*mass"):
        parse_sweep(tomllib.loads(f"{text}\n[sweep.grid]\nbody.mass = [1, -2]"))
    with pytest.raises(kr.InputError, match=r"body.sides\[3\]: expected an entry"):
        parse_sweep(tomllib.loads(f'{text}\n[sweep.grid]\n"body.sides[3]" = [1, 2]'))


def test_a_map_over_the_shape_of_a_moon() -> None:
    text = text_of_body("binary", Path("x.toml")).replace("# figure", "#")
    table = '"body.secondary.diameters[0]" = ["180 m", "190 m"]\n'
    table += '"body.secondary.diameters[2]" = ["100 m", "110 m", "120 m"]'
    description, _, _ = parse_sweep(tomllib.loads(f"{text}\n[sweep]\n{table}\nstate.eccentricity = [0, 0.1]"))
    moments = np.array(description["sweep"]["list"]["system.moments2"]).reshape(2, 3, 2, 3)
    a, b, c = np.array([180.0, 190.0])[:, None], 174.0, np.array([100.0, 110.0, 120.0])
    assert np.allclose(
        moments[:, :, 0], 4.3e9 / 20 * np.stack(np.broadcast_arrays(b**2 + c**2, a**2 + c**2, a**2 + b**2), -1)
    )
    speeds = np.array(description["sweep"]["list"]["state.v"]).reshape(2, 3, 2, 3)[..., 1]
    assert np.allclose(speeds[..., 1] / speeds[..., 0], np.sqrt(1.1 / 0.9))  # at the pericentre
