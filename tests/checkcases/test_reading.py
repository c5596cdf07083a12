"""Files of any simulator are read: namings, units, conventions; or refused with one message."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

import kreisel as kr
from kreisel.checkcases.reading import read
from kreisel.cli import app

BRICK, TOP = kr.checkcases.case("tumbling-brick"), kr.checkcases.case("kovalevskaya")
ROWS = 31


class Motion:
    """The exact motion as simulators print it."""

    def __init__(self, case: Any):
        truth = case.reference(case.times(ROWS))
        self.t, self.w, self.q = truth.time.values, truth.angular_velocity.values, truth.attitude.values
        self.turn = Rotation.from_quat(np.roll(self.q, -1, -1))
        self.space, self.deg = self.turn.apply(self.w), np.degrees(self.w)
        self.euler = self.turn.as_euler("ZYX", degrees=True)  # yaw, pitch, roll
        self.xyzw, self.matrix = self.turn.as_quat(), self.turn.as_matrix().reshape(-1, 9)
        self.conjugate = self.turn.inv().as_quat()


BODY, SPACE = "angular velocity along the axes of the body", "angular velocity along the axes of space"
NASA = [f"bodyAngularRateWrtEi_deg_s_{name}" for name in ("Roll", "Pitch", "Yaw")]
FORMATS: list[tuple[str, str, Callable[[Motion], list[Any]], list[str]]] = [
    ("t,wx,wy,wz,qw,qx,qy,qz", ",", lambda m: [m.t, m.w, m.q], [f"{BODY}, rad/s", "(w, x, y, z), body to space"]),
    ("time_ms;omega_x [deg/s];omega_y [deg/s];omega_z [deg/s]", ";", lambda m: [m.t * 1000, m.deg], ["deg/s", "ms"]),
    ("Time (s)\tp\tq\tr\tyaw\tpitch\troll", "\t", lambda m: [m.t, m.deg, m.euler], ["deg/s", "(3-2-1), deg"]),
    ("t q0 q1 q2 q3 w1 w2 w3", " ", lambda m: [m.t, m.conjugate, m.w], ["(x, y, z, w), space to body"]),
    ("# t wX wY wZ", " ", lambda m: [m.t, m.w], ["columns wX, wY, wZ"]),
    ("time,gyro_x_dps,gyro_y_dps,gyro_z_dps,orientation.x,orientation.y,orientation.z,orientation.w", ",",
     lambda m: [m.t, m.deg, m.xyzw], ["deg/s", "orientation.w, orientation.x", "(w, x, y, z), body to space"]),
    ("timestamp,\u03c9x (rpm),\u03c9y (rpm),\u03c9z (rpm)", ",", lambda m: [m.t, m.deg / 6], ["rpm"]),
    ("t,wx,wy,wz", ",", lambda m: [m.t, m.deg / 6], ["rpm (recognised by the exact motion)"]),
    ("t,wx_world,wy_world,wz_world", ",", lambda m: [m.t, m.space], [f"{SPACE}, rad/s"]),
    ("t,angvel_x,angvel_y,angvel_z", ",", lambda m: [m.t, m.space], [f"{SPACE}, rad/s (recognised"]),
    ("t,rollRate,pitchRate,yawRate,R11,R12,R13,R21,R22,R23,R31,R32,R33", ",", lambda m: [m.t, m.w, m.matrix],
     [f"{BODY}, rad/s", "rotation matrix, by rows, body to space"]),
    (",".join(["t", *(f'"dcm[{i},{j}]"' for j in range(3) for i in range(3))]), ",", lambda m: [m.t, m.matrix],
     ["rotation matrix, by rows, space to body"]),
    ("time,longitude_deg,latitude_deg,eulerAngle_deg_Yaw,eulerAngle_deg_Pitch,eulerAngle_deg_Roll,"
     + ",".join(NASA), ",", lambda m: [m.t, 0 * m.w[:, :2], m.euler, m.deg], ["left out", f"{NASA[2]}: {BODY}, deg/s"]),
]  # fmt: skip


def written(path: Path, header: str, delimiter: str, columns: list[Any]) -> Path:
    table = np.column_stack(columns).tolist()
    path.write_text("\n".join([header, *(delimiter.join(map(repr, row)) for row in table)]) + "\n", encoding="utf-8")
    return path


@pytest.mark.parametrize("case", [BRICK, TOP], ids=lambda case: case.name)
@pytest.mark.parametrize(("header", "delimiter", "columns", "said"), FORMATS, ids=[f[0][:20] for f in FORMATS])
def test_common_files_are_read(
    case: Any, header: str, delimiter: str, columns: Any, said: list[str], tmp_path: Path
) -> None:
    motion = Motion(case)
    trajectory = read(written(tmp_path / "mine.csv", header, delimiter, columns(motion)), case)
    text = "\n".join(trajectory.reading)
    assert all(words in text for words in said), text
    assert max(row.relative for row in case.grade(trajectory.times, **trajectory.quantities).rows) < 1e-12
    assert np.allclose(trajectory.times, motion.t, 1e-15)


def test_datasets_and_mappings_are_read(tmp_path: Path) -> None:
    truth = BRICK.reference(BRICK.times(ROWS))
    path = tmp_path / "mine.nc"
    truth.to_netcdf(path, engine="h5netcdf")
    for source in (truth, path):
        trajectory = read(source, BRICK)
        assert set(trajectory.quantities) == set(truth.data_vars)
        assert max(row.relative for row in BRICK.grade(trajectory.times, **trajectory.quantities).rows) < 1e-13
    columns = {"t": truth.time, "w": truth.angular_velocity, "q": np.roll(truth.attitude.values, -1, -1)}
    assert "quaternion (x, y, z, w)" in read(columns, BRICK).reading[2]


def test_conventions_can_be_specified(tmp_path: Path) -> None:
    motion = Motion(TOP)
    path = written(tmp_path / "mine.csv", "when,a,b,c,d,e,f,g", ",", [motion.t / 60, motion.deg, motion.conjugate])
    columns = {"time": "when", "rates": ["a", "b", "c"], "attitude": ["d", "e", "f", "g"]}
    options = {"units": "deg/s", "quaternion": "xyzw", "direction": "space to body", "frame": "body", "time": "min"}
    trajectory = read(path, TOP, columns=columns, **options)
    assert max(row.relative for row in TOP.grade(trajectory.times, **trajectory.quantities).rows) < 1e-12
    assert not any("recognised" in sentence for sentence in trajectory.reading)
    wrong = read(path, TOP, columns=columns, **{**options, "quaternion": "wxyz", "direction": "body to space"})
    mistake = TOP.grade(wrong.times, **wrong.quantities).mistake
    assert mistake is None or "quaternion" in mistake.sentence
    wrong = read(path, TOP, columns=columns, **{**options, "direction": "body to space"})
    assert "conjugate" in str(TOP.grade(wrong.times, **wrong.quantities).mistake)


def test_an_energy_with_another_zero_is_left_out(tmp_path: Path) -> None:
    truth = TOP.reference(TOP.times(ROWS))
    for zero, count in ((0.0, 2), (1.0, 1)):
        columns = {"t": truth.time, "w": truth.angular_velocity, "energy": truth.energy + zero}
        trajectory = read(columns, TOP)
        assert len(trajectory.quantities) == count
        assert any("left out" in sentence for sentence in trajectory.reading) == (count == 1)


def test_the_direction_is_recognised_although_the_equations_are_wrong(tmp_path: Path) -> None:
    """Without w x I w the brick rotates steadily; its first rows show that the attitude is space to body."""
    w, t = np.radians([10.0, 20, 30]), BRICK.times(301)
    q = Rotation.from_rotvec(t[:, None] * w).inv().as_quat()
    trajectory = read(written(tmp_path / "mine.csv", "t,qx,qy,qz,qw", ",", [t, q]), BRICK)
    assert "space to body" in trajectory.reading[1]
    assert "w x I w is left out" in str(BRICK.grade(trajectory.times, **trajectory.quantities).mistake)


def test_columns_that_are_not_graded_are_stated(tmp_path: Path) -> None:
    motion = Motion(BRICK)
    columns = [motion.t, motion.w[:, [0, 2]], motion.q, motion.q]
    path = written(tmp_path / "mine.csv", "t,wx,wz,qw,qx,qy,qz,qr,qi,qj,qk", ",", columns)
    reading = read(path, BRICK).reading
    assert any(sentence.startswith("columns wx, wz, qr, qi, qj, qk: left out") for sentence in reading), reading
    bare = written(tmp_path / "bare.csv", "t,qx,qy,qz", ",", [motion.t, motion.q[:, 1:]])
    with pytest.raises(kr.InputError, match="qx, qy, qz: left out"):
        read(bare, BRICK)


HEAD = "t,wx,wy,wz\n"
ROW = "0,0.17453292519943295,0.3490658503988659,0.5235987755982988\n"
BAD = [
    ("", "got an empty file"),
    ("\x00\x01binary", "got a binary file"),
    (HEAD, "expected at least two rows, of increasing times, got 0"),
    (HEAD + ROW, "expected at least two rows, of increasing times, got 1"),
    ("a,b\n0,1\n1,2\n", "expected a column of times, named t or time, got a, b"),
    ("t,height\n0,1\n1,2\n", "expected columns such as wx, wy, wz or qw, qx, qy, qz"),
    ("0,1,2,3\n1,2,3,4\n", "expected names of columns in the first line"),
    (HEAD + ROW + "1,0.2,nan,0.5\n", "mine.csv, line 3, column wy: expected a finite number, got 'nan'"),
    (HEAD + ROW + "1,0.2,fast,0.5\n", "mine.csv, line 3, column wy: expected a finite number, got 'fast'"),
    (HEAD + "s,rad/s,rad/s,rad/s\n" + ROW, "got 's'. Usual cause: a line of units"),
    ("t,wx,wy,wz,wx\n", "expected columns with different names, got wx twice"),
    (HEAD + ROW + "60" + ROW[1:], "0 to 30 s, got 0.0 to 60.0"),  # not 60 ms
    (HEAD + ROW + "1,0.2\n", "mine.csv, line 3: expected 4 columns as in the first line, got 2"),
    (HEAD + ROW + "0" + ROW[1:], "got 0 in row 1 and 0 in row 2. Usual cause: the row is there twice"),
    (HEAD + ROW + "-1" + ROW[1:], "column t: expected increasing times, got 0 in row 1 and -1 in row 2"),
    (HEAD + ROW + "40" + ROW[1:], "expected times of the case tumbling-brick, 0 to 30 s, got 0.0 to 40.0"),
    ("t,wx_deg_s,wy_deg_s,wz_deg_s\n" + ROW + "1" + ROW[1:], "expected deg/s, as the names state, got values of which"),
    (HEAD + "0,0.1,5,0.1\n1,0.1,5,0.1\n", "the start of boxes. Grade the file against that case"),
    ("t,qw,qx,qy,qz\n0,2,0,0,0\n1,2,0,0,0\n", "expected unit quaternions, got [2.0, 0.0, 0.0, 0.0], of norm 2"),
    ("t,R11,R12,R13,R21,R22,R23,R31,R32,R33\n0" + ",1" * 9 + "\n1" + ",1" * 9, "expected rotation matrices"),
    (HEAD.strip() + ",omega_x,omega_y,omega_z\n0,1,2,3,1,2,3\n1,1,2,3,1,2,3\n", "expected one set of columns"),
]  # fmt: skip


@pytest.mark.parametrize(("text", "message"), BAD, ids=[message[:30] for _, message in BAD])
def test_bad_files_are_refused_with_one_message(text: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "mine.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(kr.InputError) as raised:
        read(path, BRICK)
    assert message in str(raised.value)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"units": "deg/h"}, "units: expected one of rad/s"),
        ({"units": "ft"}, "units: expected one of rad/s, deg/s, rpm, rad, deg, got 'ft'"),
        ({"quaternion": "zyxw"}, "quaternion: expected one of wxyz, xyzw"),
        ({"columns": {"rates": ["wx", "wy"]}}, "rates (3)"),
        ({"columns": {"spin": ["wx"]}}, "got ['wx'] for 'spin'"),
        ({"columns": {"rates": ["wx", "wy", "w3"]}}, "expected a column 'w3', got t, wx, wy, wz"),
    ],
)
def test_bad_options_are_refused(options: dict[str, Any], message: str, tmp_path: Path) -> None:
    path = tmp_path / "mine.csv"
    path.write_text(HEAD + ROW + "1" + ROW[1:], encoding="utf-8")
    with pytest.raises(kr.InputError) as raised:
        read(path, BRICK, **options)
    assert message in str(raised.value)


@pytest.mark.parametrize(
    ("source", "message"),
    [
        (None, "expected a path, an xarray Dataset or a mapping"),
        ({"t": [0, 1], "w": np.ones((3, 3))}, "expected 2 rows, as many as times, got 3"),
        ({"t": [0, 1], "w": np.full((2, 3), 1e200)}, "row 1, column w[0]: expected a finite number"),
    ],
)
def test_bad_arrays_are_refused(source: Any, message: str) -> None:
    with pytest.raises(kr.InputError) as raised:
        read(source, BRICK)
    assert message in str(raised.value)


def test_missing_and_damaged_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(kr.InputError, match="expected a file, got none"):
        read(tmp_path / "none.csv", BRICK)
    (tmp_path / "mine.nc").write_bytes(b"\x89HDF\r\n\x1a\n and then nothing")
    with pytest.raises(kr.InputError, match="expected a NetCDF file"):
        read(tmp_path / "mine.nc", BRICK)


@pytest.mark.parametrize("name", ["kovalevskaya", "in-water"])
def test_the_exact_motion_that_the_command_writes_is_read(name: str, tmp_path: Path) -> None:
    path, case = tmp_path / "truth.csv", kr.checkcases.case(name)
    CliRunner().invoke(app, ["checkcase", name, "--csv", str(path), "--rows", "31"])
    trajectory = read(path, case)
    assert set(trajectory.quantities) == set(case.reference([0.0]))
    assert case.grade(trajectory.times, **trajectory.quantities).relative < 1e-15


def test_the_command_grades_files(tmp_path: Path) -> None:
    motion = Motion(BRICK)
    path = written(tmp_path / "mine.csv", "t,wx,wy,wz,qw,qx,qy,qz", ",", [motion.t, motion.w, motion.xyzw])
    out = CliRunner().invoke(app, ["checkcase", "tumbling-brick", "--grade", str(path)])
    assert out.exit_code == 0, out.output
    assert "columns wx, wy, wz: angular velocity along the axes of the body, rad/s" in out.output
    assert "the quaternion is (x, y, z, w), taken for (w, x, y, z)" in out.output


def test_the_command_measures_the_order_of_several_files(tmp_path: Path) -> None:
    """Errors proportional to the cube of the step, which is smaller than the rows' spacing."""
    motion, arguments = Motion(BRICK), list[str]()
    for step in (0.1, 0.05, 0.025):
        wrong = motion.w + step**3 * np.sin(motion.t)[:, None]
        path = written(tmp_path / f"{step}.csv", "t,wx,wy,wz", ",", [motion.t, wrong])
        arguments += ["--grade", str(path), "--step", str(step)]
    out = CliRunner().invoke(app, ["checkcase", "tumbling-brick", *arguments])
    assert out.exit_code == 0, out.output
    assert "Order measured: 3.00, 3.00. Right" in out.output
    data = json.loads(CliRunner().invoke(app, ["checkcase", "tumbling-brick", *arguments, "--json"]).output)
    assert data["orders"] == pytest.approx([3, 3])
    assert len(data["reading"]) == 3
    out = CliRunner().invoke(app, ["checkcase", "tumbling-brick", *arguments[:2], "--step", "-1"])
    assert isinstance(out.exception, kr.InputError | SystemExit)
