"""Mass and inertia from files: textbook bodies as meshes, and URDF and SDF links by what MuJoCo reads."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

import kreisel as kr
from kreisel.physical import FreeBody, HeavyBody, SubmergedBody, read_mesh, read_robot

SHIFT, TURN = (3.0, -2.0, 5.0), (0.4, -0.7, 1.9)


def placed(mesh: Any) -> Any:
    """The mesh rotated and moved away from the origin."""
    return mesh.apply_transform(trimesh.transformations.compose_matrix(angles=TURN, translate=SHIFT))


def saved(mesh: Any, folder: Path, suffix: str = "stl") -> Path:
    mesh.export(folder / f"part.{suffix}")
    return folder / f"part.{suffix}"


def box(side: float, along: float = 0.0, inside_out: bool = False) -> Any:
    made = trimesh.creation.box((side, side, side), transform=trimesh.transformations.translation_matrix((along, 0, 0)))
    if inside_out:
        made.invert()
    return made


@pytest.mark.parametrize("suffix", ["stl", "obj", "ply", "glb"])
def test_a_box_of_aluminium_in_millimetres(suffix: str, tmp_path: Path) -> None:
    """Any handbook: m = rho a b c, I = m (b^2 + c^2)/12; it is rotated by a package, about its centre."""
    a, b, c = 0.02, 0.04, 0.06
    part = read_mesh(saved(placed(trimesh.creation.box((20, 40, 60))), tmp_path, suffix), "mm", density="2700 kg/m^3")
    mass = 2700 * a * b * c
    assert part.mass == pytest.approx(mass, rel=1e-6)  # glTF and STL have single precision
    np.testing.assert_allclose(part.center_of_mass, np.array(SHIFT) / 1000, atol=1e-8)
    R = trimesh.transformations.euler_matrix(*TURN)[:3, :3]
    moments = mass / 12 * np.diag([b * b + c * c, a * a + c * c, a * a + b * b])
    np.testing.assert_allclose(part.inertia, R @ moments @ R.T, atol=1e-6 * moments.max())
    assert abs(np.triu(part.inertia, 1)).max() > 0.1 * moments.max()


def test_a_ball_and_a_tetrahedron_by_their_mass(tmp_path: Path) -> None:
    ball = read_mesh(saved(trimesh.creation.icosphere(subdivisions=4, radius=2.0), tmp_path, "ply"), 1.0, mass="3 kg")
    np.testing.assert_allclose(ball.inertia, 2 / 5 * 3 * 4 * np.eye(3), atol=0.005 * 4.8)
    # Corners 0, e1, e2, e3: int x^2 = 1/60, int x y = 1/120, volume 1/6, centre (1, 1, 1)/4; about it by Steiner.
    corners = trimesh.Trimesh(np.vstack([np.zeros(3), np.eye(3)]), [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    part = read_mesh(saved(corners, tmp_path), "m", mass=6.0)
    np.testing.assert_allclose(part.center_of_mass, [0.25, 0.25, 0.25], atol=1e-15)
    about_origin = 36 * (np.eye(3) / 30 - (1 - np.eye(3)) / 120)
    about_centre = about_origin - 6 / 16 * (3 * np.eye(3) - 1)
    np.testing.assert_allclose(part.inertia, about_centre, atol=1e-14)


def test_far_from_the_origin_no_digits_are_lost(tmp_path: Path) -> None:
    near, far = (read_mesh(saved(box(1.0, along), tmp_path, "ply"), "mm", mass=1.0).inertia for along in (0.0, 4096.0))
    np.testing.assert_allclose(far, near, atol=1e-14 * near.max())


def test_cavities_and_separate_bodies(tmp_path: Path) -> None:
    hollow = read_mesh(saved(box(2) + box(1, inside_out=True), tmp_path), "m", density=12.0)
    assert hollow.mass == pytest.approx(12 * 7)
    np.testing.assert_allclose(hollow.inertia, np.eye(3) * 2 * (8 * 4 - 1 * 1), rtol=1e-12)
    pair = read_mesh(saved(box(2, -3) + box(2, 3), tmp_path), "m", density=1.0)
    assert pair.mass == pytest.approx(16) and pair.inertia[1, 1] == pytest.approx(16 * (4 + 4) / 12 + 16 * 9)


def _open(mesh: Any) -> Any:
    mesh.update_faces(np.arange(len(mesh.faces)) != 3)
    return mesh


def _one_turned(mesh: Any) -> Any:
    mesh.faces[3] = mesh.faces[3][::-1].copy()
    return trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: _open(box(1)), "got 3 other edges"),
        (lambda: box(1, inside_out=True), "inside out"),
        (lambda: _one_turned(box(1)), "triangles that disagree"),
        (lambda: box(2) + box(1), "bodies within one another"),
        (lambda: box(2) + box(1, 5, inside_out=True), "one of its surfaces inside out"),
        (lambda: trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]]), "around a volume"),
    ],
)
def test_surfaces_that_bound_no_volume(make: Callable[[], Any], said: str, tmp_path: Path) -> None:
    with pytest.raises(kr.InputError, match=said):
        read_mesh(saved(make(), tmp_path), "mm", density=1000.0)


def test_what_a_mesh_needs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = saved(box(1), tmp_path)
    for options, said in (
        ({"density": 1000.0}, "length: expected the unit"),
        ({"length": "mm"}, "got neither"),
        ({"length": "mm", "density": 1.0, "mass": 1.0}, "got both"),
        ({"length": "kg", "mass": 1.0}, "dimension of m"),
        ({"length": "mm", "mass": "-1 kg"}, "mass must be"),
    ):
        with pytest.raises(kr.InputError, match=said):
            FreeBody.from_mesh(file, **options)
    (tmp_path / "torn.stl").write_bytes(file.read_bytes()[:-20])
    (tmp_path / "part.step").write_text("ISO-10303-21;")
    for name, said in (
        ("torn.stl", "a damaged file"),
        ("part.step", "ends in .stl"),
        ("none.stl", "cannot be read"),
    ):
        with pytest.raises(kr.InputError, match=said):
            read_mesh(tmp_path / name, "mm", mass=1.0)
    monkeypatch.setitem(sys.modules, "trimesh", None)
    with pytest.raises(kr.InputError, match=r"kreisel\[mesh\]"):
        read_mesh(file, "mm", mass=1.0)


def test_bodies_of_a_part(tmp_path: Path) -> None:
    file = saved(placed(trimesh.creation.box((0.02, 0.04, 0.06))), tmp_path, "ply")
    part = read_mesh(file, "m", density=1000.0)
    body = FreeBody.from_mesh(file, length="m", density=1000.0)
    assert (body.inertia == part.inertia).all() and body.mass == part.mass
    top = HeavyBody.about_centre(part.mass, part.inertia, part.center_of_mass)
    weight = top.mass * np.linalg.norm(top.arm)
    assert weight == pytest.approx(0.048 * np.sqrt(38), rel=1e-4)  # single precision, far away
    with pytest.warns(kr.InputWarning, match="centres from different points"):
        submerged = SubmergedBody(**part._asdict())
    assert submerged.mass_matrix[0, 0] == part.mass


# MuJoCo 4.0.0 (2026-11-26), MjModel.from_xml_string of this file: body_mass, body_ipos, and body_inertia along
# body_iquat as a tensor in the axes of the link.
INERTIA = 'ixx="0.031" ixy="-0.004" ixz="0.002" iyy="0.042" iyz="0.003" izz="0.027"'
URDF = f"""<robot name="arm"><link name="base"/><link name="upper"><inertial>
<origin xyz="0.1 -0.2 0.3" rpy="0.4 -0.7 1.9"/><mass value="2.5"/><inertia {INERTIA}/></inertial></link>
<joint name="j" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 0 1"/>
<limit effort="1" velocity="1" lower="-1" upper="1"/></joint></robot>"""
TENSOR = [
    [0.03184227, 0.00854905, -0.00263363],
    [0.00854905, 0.03662777, -0.00107086],
    [-0.00263363, -0.00107086, 0.03152996],
]
TAGS = re.sub(r'(\w+)="([^"]*)"', r"<\1>\2</\1>", INERTIA)
SDF = f"""<sdf version="1.9"><world name="w"><model name="arm"><link name="upper"><inertial>
<pose>POSE</pose><mass>2.5</mass><inertia>{TAGS}</inertia></inertial></link><link name="base"/></model></world></sdf>"""
DEGREES = "0.1 -0.2 0.3 22.918311805232929 -40.107045659157627 108.86198107485641"
QUATERNION = "0.1 -0.2 0.3 {} {} {} {}".format(*np.roll(trimesh.transformations.quaternion_from_euler(*TURN), -1))


@pytest.mark.parametrize(
    "text",
    [
        URDF,
        SDF.replace("POSE", "0.1 -0.2 0.3 0.4 -0.7 1.9"),
        SDF.replace("<pose>", '<pose degrees="true">').replace("POSE", DEGREES),
        SDF.replace("<pose>", '<pose rotation_format="quat_xyzw">').replace("POSE", QUATERNION),
    ],
)
def test_a_link_as_mujoco_reads_it(text: str, tmp_path: Path) -> None:
    (tmp_path / "arm.xml").write_text(text)
    for name in (None, "upper", *(["arm::upper"] if "sdf" in text else [])):
        part = read_robot(tmp_path / "arm.xml", name)
        assert part.mass == 2.5
        np.testing.assert_allclose(part.center_of_mass, [0.1, -0.2, 0.3], rtol=1e-15)
        np.testing.assert_allclose(part.inertia, TENSOR, atol=6e-9)


def test_products_of_inertia_that_sdf_omits_are_zero(tmp_path: Path) -> None:
    """SDFormat 1.9, inertial.sdf: default="0.0"; a moment that is omitted is refused, although its default is 1."""
    diagonal = re.sub(r"<i(xy|xz|yz)>[^<]*</i\1>", "", SDF.replace("POSE", "0 0 0 0 0 0"))
    (tmp_path / "arm.sdf").write_text(diagonal)
    np.testing.assert_allclose(read_robot(tmp_path / "arm.sdf").inertia, np.diag([0.031, 0.042, 0.027]), rtol=1e-15)
    (tmp_path / "arm.sdf").write_text(diagonal.replace("<ixx>0.031</ixx>", ""))
    with pytest.raises(kr.InputError, match="ixx: expected 1 number"):
        read_robot(tmp_path / "arm.sdf")


@pytest.mark.parametrize(
    ("change", "link", "said"),
    [
        (("", ""), "uper", "Did you mean 'upper'"),
        (("", ""), "base", "expected <inertial> in the link base, got none"),
        (('izz="0.027"', ""), None, "izz: expected 1 number, got None"),
        (('"0.027"', '"${m}"'), None, "xacro"),
        (('"0.027"', '"0.27"'), None, "No body has the principal moments"),
        (('"2.5"', '"0"'), None, "mass must be"),
        (("<robot", '<!DOCTYPE r [<!ENTITY a "b">]><robot'), None, "document type"),
        (("</robot>", ""), None, "got no XML"),
        (("robot", "model"), None, "expected <robot> or <sdf>"),
    ],
)
def test_robots_that_cannot_be_read(change: tuple[str, str], link: str | None, said: str, tmp_path: Path) -> None:
    (tmp_path / "arm.urdf").write_text(URDF.replace(*change))
    with pytest.raises(kr.InputError, match=said):
        read_robot(tmp_path / "arm.urdf", link)


@pytest.mark.parametrize("suffix", ["stl", "obj", "ply", "glb"])
def test_damaged_meshes_end_in_one_message(suffix: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """A body that may be, or one message; nothing on stderr, where trimesh logs tracebacks."""
    file, rng = saved(trimesh.creation.icosphere(subdivisions=1), tmp_path, suffix), np.random.default_rng(1)
    whole, refused = file.read_bytes(), 0
    for _ in range(60):
        raw = bytearray(whole)
        at, count = int(rng.integers(len(raw))), int(rng.integers(1, 40))
        raw[at : at + count] = [b"", b"solid x", rng.bytes(count)][rng.integers(3)]
        file.write_bytes(raw)
        try:
            assert np.isfinite(read_mesh(file, "mm", density=1000.0).inertia).all()
        except kr.InputError as error:
            refused += 1
            assert len(str(error)) > 40
    assert refused > 20 and capfd.readouterr().err == ""
