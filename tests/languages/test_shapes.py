"""`kreisel code` for the inertia in files of shapes and robots."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import kreisel as kr
from kreisel.cli import app

ROBOT = """<robot name="arm"><link name="base"/><link name="wheel"><inertial><origin xyz="0 0 0.1"/><mass value="2"/>
<inertia ixx="0.02" ixy="0.001" ixz="0.002" iyy="0.03" iyz="-0.003" izz="0.04"/></inertial></link></robot>"""


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def code(*words: str) -> str:
    """What the command prints, or its error."""
    done = CliRunner().invoke(app, ["code", *words])
    assert done.exception is None or isinstance(done.exception, (kr.InputError, SystemExit))
    return done.output + str(done.exception or "")


def values(text: str, name: str) -> list[float]:
    return [float(x) for x in re.findall(rf"rock_{name}\[\d\] = {{(.*)}};", text)[0].split(",")]


def test_a_robot_gives_its_tensor(folder: Path) -> None:
    (folder / "arm.urdf").write_text(ROBOT)
    text = code("arm.urdf", "--link", "wheel", "--name", "rock")
    assert values(text, "T") == [0.02, 0.03, 0.04, -0.003, 0.002, 0.001]
    unreal = values(code("arm.urdf", "--name", "rock", "--convention", "unreal"), "T")
    assert np.allclose(unreal, [200, 300, 400, 30, 20, -10], rtol=1e-12)  # kg cm^2; y to the right: xy and yz change


def test_a_mesh_gives_moments_of_its_homogeneous_body(folder: Path) -> None:
    """A box of 100 x 200 x 300 mm and 2 kg: m (b^2 + c^2)/12."""
    trimesh = pytest.importorskip("trimesh")
    for suffix in ("stl", "glb", "obj"):
        trimesh.creation.box(extents=(100, 200, 300)).export(folder / f"box.{suffix}")
    for suffix in ("stl", "glb", "obj"):
        text = code(f"box.{suffix}", "--length", "mm", "--mass", "2 kg", "--name", "rock")
        assert np.allclose(values(text, "I"), [2 * 0.13 / 12, 2 * 0.10 / 12, 2 * 0.05 / 12], rtol=1e-6)


@pytest.mark.parametrize(
    ("words", "part"),
    [
        (("arm.urdf", "--link", "whel"), "Did you mean 'wheel'"),
        (("arm.urdf", "--length", "mm"), "--length: not for 'arm.urdf'"),
        (("arm.urdf", "--set", "I=1,2,2.5"), "--set: not for 'arm.urdf'"),
        (("absent.stl", "--length", "mm", "--mass", "1"), "absent.stl cannot be read"),
        (("free-body", "--link", "wheel"), "--link: not for 'free-body'"),
        (("free-body", "--set", "J=1,2,2.5"), "expected I=1,2,2.5"),
        (("free-body", "--set", "I=1,2,9"), "the largest exceeds the sum"),
        (("free-body", "--convention", "unitty"), "Did you mean 'unity'"),
        (("free-body", "--language", "gdscript", "--single"), "expected a language with 32-bit floats"),
        (("lagrange-top", "--language", "fmu"), "expected free-body, or a file of its shape"),
        (("lagrange-top", "--language", "fmi"), "wgsl, fmu, got 'fmi'. Did you mean 'fmu'?"),
        (("free-body", "--language", "csharp", "--name", "State"), "that csharp and the file do not have already"),
    ],
)
def test_bad_input_is_named(words: tuple[str, ...], part: str, folder: Path) -> None:
    (folder / "arm.urdf").write_text(ROBOT)
    assert part in code(*words)


def test_a_name_instead_of_a_body_is_named() -> None:
    with pytest.raises(kr.InputError, match="A system with its parameters was expected"):
        kr.code("free-body")  # type: ignore[arg-type]


def test_a_body_of_a_toml_file_is_in_si(folder: Path) -> None:
    """The units of its state are stated, those of a free body are SI; --dt is in s, as in the file."""
    assert CliRunner().invoke(app, ["new", "gyroscope"]).exit_code == 0
    text = code("gyroscope.toml", "--dt", "0.002", "--name", "rock")
    assert "One unit of m is" in text
    unit, step = (float(re.findall(p, text)[0]) for p in (r"One unit of time is (\S+) s", r"rock_dt = (.*);"))
    assert np.isclose(unit * step, 0.002, rtol=1e-12)
    (folder / "box.toml").write_text(BOX)
    text = code("box.toml", "--dt", "0.002", "--name", "rock")
    assert "Units: SI" in text
    assert "rock_dt = 0.002;" in text
    assert np.allclose(values(text, "I"), [0.9 * (0.17**2 + 0.24**2) / 12, 0.9 * 0.0585 / 12, 0.9 * 0.0298 / 12])
    momentum = values(text, "start_M")
    assert np.allclose(momentum, np.array(values(text, "I")) * [0, 2, 0.5])


BOX = """[body]
kind = "free-body"
mass = 0.9
sides = [0.03, 0.17, 0.24]
[state]
spin = [0, 2, 0.5]
[run]
dt = 0.01
t_end = 1.0
[output]
path = "box.zarr"
"""
