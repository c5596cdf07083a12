"""The examples for engines: run where the engine is at hand, else compiled against as much of it as they call."""

from __future__ import annotations

import ast
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import kreisel as kr
from compilers import output, run, syntax_errors
from support import EXAMPLES, ROOT, cross, rotation_matrix

ENGINES, STUBS = EXAMPLES / "engines", Path(__file__).parent / "stubs"
BODY = kr.physical.FreeBody((1.0, 2.0, 2.5))
RATE, TIME = (0.001, 3.0, 0.0), 10.0
LIBRARY = ROOT / "src" / "kreisel" / "viewer" / "assets" / "library.min.js"


def text(language: str, convention: str | None = None) -> str:
    return kr.code(BODY, language=language, convention=convention, name="rock")


def attitude() -> np.ndarray:
    """The exact attitude after the time, x, y, z, w."""
    later = kr.at(BODY.model(), BODY.state(RATE), [BODY.dt(TIME)], orientation=BODY.orientation())
    return np.asarray(BODY.attitude(later.g.values[0]))[[1, 2, 3, 0]]


def apart(one: Any, two: Any) -> float:
    return float(min(np.abs(np.array(one) - two).max(), np.abs(np.array(one) + two).max()))


def test_examples_have_at_most_60_lines() -> None:
    files = [path for path in ENGINES.iterdir() if path.is_file()]
    assert len(files) == 5
    assert all(len(path.read_text(encoding="utf-8").splitlines()) <= 60 for path in files)


def test_bevy(tmp_path: Path) -> None:
    """The system of Bevy rotates an entity, compiled against a stub with Bevy's signatures.

    By hand it ran with the crates of Bevy 0.18.1 and printed this quaternion; no package index of the tests has crates.
    """
    (tmp_path / "rock.rs").write_text(text("rust", "bevy"))
    (tmp_path / "spin.rs").write_text((ENGINES / "bevy.rs").read_text())
    (tmp_path / "main.rs").write_text("""mod rock;
mod spin;
use bevy::prelude::*;
fn main() {
    let rest = Quat::from_xyzw(0.0, 0.0, 0.0, 1.0);
    assert!(spin::Spin::new([1.0, 2.0, 9.0], [0.0; 3], rest, 0.015625).is_err());
    let spin = spin::Spin::new([1.0, 2.0, 2.5], [0.001, 3.0, 0.0], rest, 0.015625).ok().unwrap();
    let mut rows = [(spin, Transform { rotation: rest })];
    for _ in 0..640 {
        spin::rotate(Query(&mut rows));
    }
    println!("{:?}", rows[0].1.rotation.to_array());
}
""")
    words = ["rustc", "--edition=2021"]
    run(tmp_path, [*words, "--crate-type=proc-macro", str(STUBS / "component.rs")])
    run(tmp_path, [*words, "--crate-type=rlib", "--extern=component=libcomponent.so", str(STUBS / "bevy.rs")])
    run(tmp_path, [*words, "-O", "-L.", "--extern=bevy=libbevy.rlib", "main.rs"])
    assert apart(ast.literal_eval(run(tmp_path, ["./main"])), attitude()) < 1e-6


THREE = """import { readFileSync } from "node:fs";
import vm from "node:vm";
import { Spin } from "./three.mjs";
const any = new Proxy(function () {}, { get: (_, k) => (k === Symbol.toPrimitive ? () => 0 : any), apply: () => any });
globalThis.navigator ??= { language: "en" };
Object.assign(globalThis, { window: globalThis, self: globalThis, document: any, matchMedia: () => any });
Object.assign(globalThis, { addEventListener() {}, dispatchEvent() {}, CustomEvent: class {}, devicePixelRatio: 1 });
const { Mesh } = vm.runInThisContext(readFileSync(process.argv[2], "utf8") + ";Library");
const mesh = new Mesh(), spin = new Spin(mesh, [1, 2, 2.5], [0.001, 3, 0]);
for (let k = 0; k < 640; k++) spin.update(1 / 64 + (k % 2 ? -1e-3 : 1e-3));
spin.update(1e-9);
console.log(JSON.stringify(mesh.quaternion.toArray()));
let refused = false;
try { new Spin(mesh, [1, 2, 9], [0, 0, 0]); } catch (error) { refused = error instanceof RangeError; }
console.log(refused);
"""


def test_three(tmp_path: Path) -> None:
    """A mesh of three.js, which the page of a run brings, in Node; pictures that are not even."""
    (tmp_path / "rock.mjs").write_text(text("js", "three"))
    (tmp_path / "three.mjs").write_text((ENGINES / "three.mjs").read_text())
    (tmp_path / "main.mjs").write_text(THREE)
    quaternion, refused = output("node", tmp_path, "main.mjs", str(LIBRARY)).split()
    assert apart(ast.literal_eval(quaternion), attitude()) < 1e-6 and refused == "true"


LAMMPS = """#include "fix_kreisel.cpp"
#include <cstdio>
using namespace LAMMPS_NS;
int main() {
    Atom atom;
    Update update;
    AtomVecEllipsoid ellipsoids;
    LAMMPS lammps{&atom, &update};
    AtomVecEllipsoid::Bonus bonus{{0.5, 1.0, 1.5}, {0.5, 0.5, -0.1, 0.7}, 0};
    int mask = 1, place = 0;
    double mass = 2.0, L[3] = {0.3, 1.0, 0.5}, torque[3] = {0.1, -0.2, 0.3}, *momentum = L, *moment = torque;
    ellipsoids.bonus = &bonus;
    atom.nlocal = 1, atom.mask = &mask, atom.ellipsoid = &place, atom.rmass = &mass;
    atom.angmom = &momentum, atom.torque = &moment, atom.avec = &ellipsoids, update.dt = 0.002;
    FixKreisel fix(&lammps, 0, nullptr);
    for (int k = 0; k < 1000; k++) fix.initial_integrate(0), fix.final_integrate();
    for (double x : bonus.quat) std::printf("%.17g ", x);
}
"""


def test_lammps(tmp_path: Path) -> None:
    """The fix, compiled against a stub of LAMMPS's classes, against Euler's equations of the ellipsoid by SciPy.

    By hand it ran in LAMMPS of 2022-01-06: it agreed with fix nve/asphere within 5e-7, with this torque and without.
    """
    (tmp_path / "rock.h").write_text(text("c"))
    (tmp_path / "main.cpp").write_text(LAMMPS)
    got = output("g++", tmp_path, f"-I{STUBS / 'lammps'}", f"-I{ENGINES}", "-I.", "main.cpp").split()
    a, b, c = (2.0 / 5 * r * r for r in (0.5, 1.0, 1.5))
    inertia, L, torque = np.array([b + c, a + c, a + b]), np.array([0.3, 1.0, 0.5]), np.array([0.1, -0.2, 0.3])

    def rates(t: float, q: Any) -> Any:
        w = (L + t * torque) @ rotation_matrix(q) / inertia
        return [-q[1:] @ w / 2, *(q[0] * w + cross(q[1:], w)) / 2]

    wanted = solve_ivp(rates, (0, 2), [0.5, 0.5, -0.1, 0.7], method="DOP853", rtol=1e-11, atol=1e-12).y[:, -1]
    assert apart([float(x) for x in got], wanted) < 1e-5


GODOT = """extends SceneTree
func _initialize() -> void:
    var free: Node3D = load("res://godot.gd").new()
    var pushed: Node3D = load("res://godot.gd").new()
    pushed.spin = Vector3.ZERO
    pushed.torque = Vector3(0.0, 0.02, 0.0)
    for node in [free, pushed]:
        root.add_child(node)
    for k in 641: # the signal comes before the step
        await physics_frame
    for q in [free.quaternion, pushed.quaternion]:
        print([q.x, q.y, q.z, q.w])
    quit()
"""
PROJECT = "config_version=5\n[physics]\ncommon/physics_ticks_per_second=64\n"
CLASSES = """list=[{"base": &"RefCounted", "class": &"Rock", "icon": "", "is_abstract": false, "is_tool": false,
"language": &"GDScript", "path": "res://rock.gd"}]
"""


def test_godot(tmp_path: Path) -> None:
    """A node in a project of Godot, whose editor writes the list of classes."""
    (tmp_path / ".godot").mkdir()
    files = {"main.gd": GODOT, "project.godot": PROJECT, ".godot/global_script_class_cache.cfg": CLASSES}
    files |= {"rock.gd": text("gdscript", "godot"), "godot.gd": (ENGINES / "godot.gd").read_text()}
    for name, content in files.items():
        (tmp_path / name).write_text(content)
    words = ["godot", "--headless", "--no-header", "--fixed-fps", "64", "--quit-after", "1000", "--script", "main.gd"]
    free, pushed = map(ast.literal_eval, run(tmp_path, words).splitlines())
    assert apart(free, attitude()) < 1e-5
    angle = 0.02 / 2.0 * TIME**2 / 2  # rad: torque / moment * t^2 / 2
    assert apart(pushed, [0, np.sin(angle / 2), 0, np.cos(angle / 2)]) < 1e-5


def test_godot_is_well_formed() -> None:
    assert syntax_errors("gdscript", (ENGINES / "godot.gd").read_text()) == []


def test_mujoco(monkeypatch: pytest.MonkeyPatch) -> None:
    """A free joint of MuJoCo, whose rotation the file replaces; then under a torque about a principal axis."""
    mujoco = pytest.importorskip("mujoco")
    rock, names = ModuleType("rock"), dict[str, Any]()
    exec(text("python"), rock.__dict__)
    monkeypatch.setitem(sys.modules, "rock", rock)
    exec((ENGINES / "mujoco_free_joint.py").read_text(), names)
    model = mujoco.MjModel.from_xml_string(names["MODEL"].replace("0.002", "0.01"))
    data = mujoco.MjData(model)
    data.qvel[3:] = RATE
    body = names["FreeRotation"](model, data, names["MOMENTS"])
    for _ in range(round(TIME / 0.01)):
        body.step(model, data)
    assert apart(data.qpos[3:], attitude()[[3, 0, 1, 2]]) < 1e-9
    mujoco.mj_resetData(model, data)
    data.qfrc_applied[4] = 0.02
    body.read(data)
    for _ in range(round(TIME / 0.01)):
        body.step(model, data)
    angle = 0.02 / 2.0 * TIME**2 / 2
    assert apart(data.qpos[3:], [np.cos(angle / 2), 0, np.sin(angle / 2), 0]) < 1e-9
