"""Conventions of engines against their documentation, and as maps of one physical motion."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

import kreisel as kr
from compilers import output
from kreisel.languages.bodies import CONVENTIONS as STATED, Convention
from support import cross


class Engine(Convention):
    """What a program converts between Kreisel and its engine."""

    def axial(self, vector: Any, power: int = 0) -> Any:
        """An axial vector (..., 3): an angular velocity; with `power` 2, a momentum or a torque in its units."""
        return self.handed * np.asarray(vector) @ self.matrix.T / self.length**power

    def quaternion(self, q: Any) -> Any:
        """(x, y, z, w) of the engine from a unit quaternion (..., 4) = (w, x, y, z)."""
        return np.concatenate([self.axial(q[..., 1:]), q[..., :1]], axis=-1)


CONVENTIONS = {name: Engine(x.axes, x.source, x.length) for name, x in STATED.items()}
# Facts as the engines document them: handedness; up, and forward, along their axes; how their own bridges write the
# components of forward, left, up: Unity ROS-TCP-Connector, `FLU.ConvertToRUF`: (-y, z, x), a quaternion (-y, z, x, -w);
# MathWorks and Epic for Unreal: (x, -y, z) in cm; Godot and Bevy: Vector3.UP = (0, 1, 0), FORWARD = (0, 0, -1).
FACTS = {
    "ros": (1, (0, 0, 1), (1, 0, 0), lambda x, y, z: (x, y, z)),
    "unity": (-1, (0, 1, 0), (0, 0, 1), lambda x, y, z: (-y, z, x)),
    "unreal": (-1, (0, 0, 1), (1, 0, 0), lambda x, y, z: (x, -y, z)),
    "godot": (1, (0, 1, 0), (0, 0, -1), lambda x, y, z: (-y, z, -x)),
    "bevy": (1, (0, 1, 0), (0, 0, -1), lambda x, y, z: (-y, z, -x)),
    "three": (1, (0, 1, 0), (0, 0, -1), lambda x, y, z: (-y, z, -x)),
}
TENSOR = np.array([[2.0, 0.3, -0.2], [0.3, 3.0, 0.4], [-0.2, 0.4, 4.0]])  # kg m^2
START = np.array([0.5, 0.5, -0.1, 0.7])
SPIN = np.array([0.3, 2.0, 0.5])  # rad/s along the body axes
FORCE, AT = np.array([1.0, -0.5, 0.3]), np.array([0.2, 0.1, -0.4])  # N along the body axes, at a point of it, m
POINTS = np.array([[1.0, 0, 0], [0, 1, 0], [0, 0, 1], [0.3, -0.4, 0.8]])  # m, fixed in the body
TIME = 3.0  # s


@pytest.mark.parametrize("name", CONVENTIONS)
def test_axes_are_those_of_the_documentation(name: str) -> None:
    handed, up, forward, written = FACTS[name]
    engine = CONVENTIONS[name]
    assert engine.handed == handed
    assert tuple(engine.matrix @ (0, 0, 1)) == up and tuple(engine.matrix @ (1, 0, 0)) == forward
    assert np.allclose(engine.matrix @ (1, 2, 3), written(1, 2, 3))


def test_a_quaternion_of_unity_is_that_of_its_bridge_to_ros() -> None:
    """FLU.ConvertToRUF of ROSGeometry makes (-y, z, x, -w) of (x, y, z, w): -q, the same rotation."""
    w, x, y, z = START
    assert np.allclose(CONVENTIONS["unity"].quaternion(START), -np.array([-y, z, x, -w]))


@pytest.mark.parametrize(
    ("name", "axis"), [("ros", (0, 0, -1)), ("unity", (0, 1, 0)), ("unreal", (0, 0, 1)), ("godot", (0, -1, 0))]
)
def test_a_right_turn_is_as_documented(name: str, axis: Any) -> None:
    """Unity: Euler(0, 90, 0) turns forward to the right, as a yaw of 90 in Unreal; in Godot and ROS it is negative."""
    engine, half = CONVENTIONS[name], np.sqrt(0.5)
    q = engine.quaternion(np.array([half, 0, 0, -half]))
    assert np.allclose(q, [*(half * np.array(axis)), half])
    assert np.allclose(rotated(q, engine.matrix @ (1, 0, 0)), engine.matrix @ (0, -1, 0))


def rotated(q: Any, v: Any) -> Any:
    """Vectors (k, 3) rotated by (x, y, z, w), with the components that every engine computes."""
    t = 2 * np.cross(q[:3], v)
    return v + q[3] * t + np.cross(q[:3], t)


def points_in_engine(engine: Engine) -> Any:
    """The points at the end, m: the engine integrates the equations with its own components of everything."""
    inertia, S = engine.tensor(TENSOR), engine.matrix / engine.length
    torque = cross(S @ AT, S @ FORCE)  # as a user of the engine computes it

    def rates(t: float, y: Any) -> Any:
        q, w = y[:4], y[4:]
        turned = np.append(q[3] * w + cross(q[:3], w), -q[:3] @ w) / 2
        return np.append(turned, np.linalg.solve(inertia, torque - cross(w, inertia @ w)))

    first = np.append(engine.quaternion(START), engine.axial(SPIN))
    last = solve_ivp(rates, (0, TIME), first, method="DOP853", rtol=1e-11, atol=1e-11).y[:, -1]
    return rotated(last[:4], POINTS @ S.T) * engine.length


def points_in_space() -> Any:
    """The points at the end, m, in right-handed axes: L' = R (r x F), R' = (R I^-1 R^T L) x R."""

    def rates(t: float, y: Any) -> Any:
        R, L = y[:9].reshape(3, 3), y[9:]
        w = R @ np.linalg.solve(TENSOR, R.T @ L)
        return np.append(np.stack([cross(w, r) for r in R.T], -1), R @ cross(AT, FORCE))

    R = Rotation.from_quat(START, scalar_first=True).as_matrix()
    first = np.append(R.ravel(), R @ TENSOR @ SPIN)
    last = solve_ivp(rates, (0, TIME), first, method="DOP853", rtol=1e-11, atol=1e-11).y[:, -1]
    return POINTS @ last[:9].reshape(3, 3).T


@pytest.mark.parametrize("name", CONVENTIONS)
def test_the_motion_is_one_physical_motion(name: str) -> None:
    engine = CONVENTIONS[name]
    wanted = points_in_space() @ engine.matrix.T
    assert np.abs(points_in_engine(engine) - wanted).max() < 1e-8


class Unmirrored(Engine):
    """A mutant: axial vectors as if the axes were right-handed."""

    handed = 1


class Conjugate(Engine):
    """A mutant: the quaternion from space to body."""

    def quaternion(self, q: Any) -> Any:
        return super().quaternion(q * (1, -1, -1, -1))


@pytest.mark.parametrize(
    "mutant",
    [
        Unmirrored(CONVENTIONS["unity"].axes, ""),
        Conjugate(CONVENTIONS["unity"].axes, ""),
        Conjugate(CONVENTIONS["godot"].axes, ""),
    ],
)
def test_a_wrong_hand_and_a_conjugate_are_seen(mutant: Engine) -> None:
    wanted = points_in_space() @ mutant.matrix.T
    assert np.abs(points_in_engine(mutant) - wanted).max() > 0.1


def test_centimetres_are_seen() -> None:
    """The torque of a force in kg cm/s^2 at a point in cm moves a tensor in kg cm^2, and no other."""
    unreal = CONVENTIONS["unreal"]
    assert np.allclose(unreal.tensor(TENSOR), unreal.matrix @ TENSOR @ unreal.matrix.T * 1e4)
    assert np.allclose(
        unreal.axial(np.cross(AT, FORCE), power=2), np.cross(*(100 * unreal.matrix @ v for v in (AT, FORCE)))
    )


def test_an_engine_without_a_convention_is_named() -> None:
    with pytest.raises(kr.InputError, match=r"expected one of ros, unity.*Did you mean 'godot'"):
        kr.code(kr.physical.FreeBody(TENSOR), convention="godott")


def points_by_file(name: str) -> Any:
    """The points at the end, m, by the file of the engine: a blow in the middle, of a force in the axes of space."""
    engine, rock = CONVENTIONS[name], dict[str, Any]()
    exec(kr.code(kr.physical.FreeBody(TENSOR), language="python", convention=name, name="rock"), rock)
    S, c, s = engine.matrix / engine.length, rock["Constants"](), rock["State"]()
    moments, axes, q, w = [0.0] * 3, [0.0] * 4, engine.quaternion(START).tolist(), [0.0] * 3
    rock["principal"](rock["default_T"], moments, axes)
    rock["prepare"](c, moments, 0.05)
    rock["set_motion"](c, s, axes, q, rotated(np.array(q), engine.axial(SPIN)).tolist())
    rock["advance"](c, s, 30)
    rock["kick"](s, np.cross(S @ AT, S @ FORCE).tolist())
    rock["advance"](c, s, 30)
    rock["get_motion"](c, s, axes, q, w)
    return rotated(np.array(q), POINTS @ S.T) * engine.length


def test_files_for_engines_make_one_physical_motion() -> None:
    """Their default tensors, units, quaternions and kicks; the first is right-handed and judged by Kreisel's bodies."""
    body = kr.physical.FreeBody(TENSOR)
    half = body.dt(30 * 0.05)
    middle = kr.at(body.model(), body.state(SPIN), [half], orientation=body.orientation(START))
    attitude = body.attitude(middle.g.values[0])
    R = Rotation.from_quat(attitude, scalar_first=True)
    spin = body.angular_velocity(middle.M.values[0]) + np.linalg.solve(TENSOR, R.inv().apply(np.cross(AT, FORCE)))
    last = kr.at(body.model(), body.state(spin), [half], orientation=body.orientation(attitude))
    points = Rotation.from_quat(body.attitude(last.g.values[0]), scalar_first=True).apply(POINTS)
    for name, engine in CONVENTIONS.items():
        assert np.abs(points_by_file(name) - points @ engine.matrix.T).max() < 1e-11, name


def test_what_has_no_convention_is_refused() -> None:
    top = kr.physical.Gyroscope(0.5, 1e-4, 5e-3, 0.03)
    for body in (top, kr.EulerTop(J=(1, 2, 3.5))):
        with pytest.raises(kr.InputError, match="expected a free body"):
            kr.code(body, convention="unity")


LINES = {  # of the page: language, compiler, names of the files, a program around the lines with as much of the engine
    "C++, Unreal": ("cpp", "g++", "rock.hpp", "main.cpp", """#include "rock.hpp"
#include <cstdio>
struct FQuat { FQuat(double a, double b, double c, double d) { printf("%.9g %.9g %.9g %.9g", a, b, c, d); } };
void SetActorRotation(FQuat) {}
int main() {
LINES}"""),
    "C#, Unity": ("csharp", "mcs", "rock.cs", "main.cs", """struct Quaternion {
    public float[] q;
    public Quaternion(float a, float b, float c, float d) { q = new float[] { a, b, c, d }; }
}
static class Time { public const float fixedDeltaTime = 1f / 60; }
class Transform { public Quaternion rotation; }
static class Program {
    static void Main() {
        var transform = new Transform();
LINES
        foreach (var x in transform.rotation.q) System.Console.Write("{0:R} ", x);
    }
}"""),
    "GDScript, Godot": ("gdscript", "godot", "rock.gd", "main.gd", """extends SceneTree
const Rock = preload("res://rock.gd")
func _initialize() -> void:
    var quaternion: Quaternion
LINES
    print(quaternion.x, " ", quaternion.y, " ", quaternion.z, " ", quaternion.w)
    quit()
"""),
    "Rust, Bevy": ("rust", "rustc", "rock.rs", "main.rs", """mod rock;
struct Quat([f32; 4]);
impl Quat { fn from_array(a: [f32; 4]) -> Quat { Quat(a) } }
struct Transform { rotation: Quat }
fn main() {
    let mut transform = Transform { rotation: Quat([0.0; 4]) };
LINES
    for x in transform.rotation.0 { print!("{} ", x); }
}"""),
    "JavaScript, three.js": ("js", "node", "rock.mjs", "main.mjs", """import * as rock from "./rock.mjs";
const mesh = { quaternion: { fromArray(q) { console.log(...q); } } };
LINES"""),
}  # fmt: skip


@pytest.mark.parametrize("title", LINES)
def test_the_lines_of_the_page_rotate_a_body(title: str, tmp_path: Path) -> None:
    """One step at 3 rad/s about the second axis: 60 steps a second, in Bevy 64."""
    language, compiler, file, main, program = LINES[title]
    page = (Path(__file__).parents[2] / "docs" / "engines.md").read_text()
    lines = page.split(f"{title}:\n\n")[1].split("\n\n")[0]
    engine = title.split(", ")[1].split(".")[0].lower()
    body = kr.physical.FreeBody((1, 2, 2.5))
    (tmp_path / file).write_text(kr.code(body, language=language, convention=engine, name="rock"))
    (tmp_path / main).write_text(program.replace("LINES", lines))
    got = output(compiler, tmp_path, main, *([file] if language == "csharp" else [])).split()
    angle = 1.5 / (64 if engine == "bevy" else 60)
    assert [float(x) for x in got] == pytest.approx([0, np.sin(angle), 0, np.cos(angle)], abs=1e-6)


OWN = """
#include <stdio.h>
int main(void) {
    Body b = {0};
    const double T[6] = {2, 3, 4, 0.4, -0.2, 0.3}, still[6] = {0}, torque[3] = {0.1, -0.2, 0.3};
    b.q[0] = 1, b.w[0] = 0.3, b.w[1] = 2, b.w[2] = 0.5;
    if (!body_set(&b, still, 0.01) || body_set(&b, T, 0.01)) return 1;
    for (int k = 0; k < 1000; k++) {
        body_step(&b, torque);
        if (k == 499) rock_kick(&b.s, torque); /* a contact */
    }
    for (int i = 0; i < 4; i++) printf("%.17g ", b.q[i]);
    for (int i = 0; i < 3; i++) printf("%.17g ", b.w[i]);
    return 0;
}
"""


def test_the_lines_of_the_page_for_another_engine(tmp_path: Path) -> None:
    """The angular momentum in space is that of the start, the torque's for 10 s and the contact's."""
    page = (Path(__file__).parents[2] / "docs" / "engines.md").read_text()
    lines = re.search(r"\n    (#include.*?\n    }\n)\nBegin", page, re.DOTALL)
    assert lines
    (tmp_path / "rock.h").write_text(kr.code(kr.physical.FreeBody((1, 2, 2.5)), name="rock"))
    (tmp_path / "main.c").write_text(lines[1] + OWN)
    out = np.array(output("gcc", tmp_path, "main.c").split(), float)
    R = Rotation.from_quat(out[:4], scalar_first=True).as_matrix()
    wanted = TENSOR @ [0.3, 2.0, 0.5] + 11 * np.array([0.1, -0.2, 0.3])
    assert np.allclose(R @ TENSOR @ R.T @ out[4:], wanted, rtol=1e-12)
    assert np.abs(out[4:] - [0.3, 2.0, 0.5]).max() > 0.1
