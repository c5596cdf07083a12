"""kr.code: the file of a step, compiled or run by what reads it, against the kernel and against many digits."""

from __future__ import annotations

import copy
import json
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

import kreisel as kr
from compilers import run, syntax_errors
from kreisel.bodies import BODIES
from kreisel.checkcases.catalogue import law_of
from kreisel.cli.checkcases import SYSTEMS as checkcase_systems, files_of
from kreisel.cli.configuration import read
from kreisel.runs import examples
from kreisel.runs.planning import make_plan
from sizes import FULL
from support import EXAMPLES

STEPS, DT = 2000, 0.05
TOP = kr.LagrangeTop(p=(0, 0.6, 0.8), alpha=0.5)
TOP_START = TOP.state(m=(0.1, 0.2, 1.5), a=(0.6, 0, 0.8))
BODY = kr.EulerTop(J=(1.0, 2.0, 3.5))
START = BODY.state(M=(0.3, 0.5, 1.1))
CLEBSCH = kr.Clebsch(b=(1.0, 2.0, 3.5))
OUTER = kr.QuadraticPotential(J=(1.0, 2.0, 2.5))
LIMITED = kr.perturbed(BODY, torque=lambda M: 0.1 * np.where(M[0] < 0.2, M, 0) - np.clip(M, -0.1, 0.2))
DRAGGED = kr.perturbed(TOP, torque=lambda m, *, c: -c * np.sqrt(m @ m) * m, params={"c": 0.3})
MANAKOV, KOMAROV = kr.ManakovTop(a=(1.2, 1.7, 3.1), b=(0.9, 1.3, 2.5)), kr.Komarov(kappa=-0.4, beta=0.3, c=0.9)
CHAIN, HIGHER = kr.HeisenbergChain(n=3), kr.LagrangeTop(p=(0.3, -0.5, 0.8, 0.1))
SPINS = {"Sx": (0.6, 0.0, 0.8), "Sy": (0.8, 0.6, 0.0), "Sz": (0.0, 0.8, 0.6)}
MOMENTUM = np.array([[0, 0.3, -0.5, 1.1], [-0.3, 0, 0.2, 0.7], [0.5, -0.2, 0, -0.4], [-1.1, -0.7, 0.4, 0]])
MASSES = np.array([[1.4, 0.2, 0, 0.1], [0.2, 0.8, -0.1, 0], [0, -0.1, 1.1, 0.3], [0.1, 0, 0.3, 0.9]])
HEAVY, SKEWED = (kr.HeavyTop(J=J, A=(-0.1, 0.5, 0.1, 1.2)) for J in ((1.4, 0.8, 1.1, 0.9), MASSES))
TURNED: dict[str, Any] = {"orientation": (1, 0, 0, 0)}
CASES: dict[str, tuple[Any, dict[str, Any]]] = {
    "suris 1": ((TOP, TOP_START), {"method": "suris", "order": 1}),
    "baecklund 4, orientation": ((TOP, TOP_START), {"method": "baecklund", "order": 4, **TURNED}),
    "veselov 4": ((BODY, START), {"method": "veselov", "order": 4}),
    "suris 2, Clebsch": ((CLEBSCH, CLEBSCH.state(M=(0.3, 0.5, 1.1), P=(0.6, 0, 0.8))), {"method": "suris", "order": 2}),
    "a symmetric matrix": (
        (OUTER, OUTER.state(M=(0.3, 0.5, 1.1), P=[[0.5, 0.1, 0.0], [0.1, 0.2, -0.3], [0.0, -0.3, 0.9]])),
        {"method": "veselov", "order": 2},
    ),
    "a motor with limits": ((LIMITED, LIMITED.state(M=(0.3, 0.5, 1.1))), {"method": "splitting", "order": 4}),
    "variational": ((TOP, TOP_START), {"method": "variational", "order": 2}),
    "sweeps until it is solved": (
        (HIGHER, HIGHER.state(m=MOMENTUM, a=(0.5, -0.1, 0.7, 0.5))),
        {"method": "variational", "order": 2},
    ),
    "heavy top, n = 4": (
        (HEAVY, HEAVY.state(M=MOMENTUM, P=(0.5, -0.1, 0.7, 0.5))),
        {"method": "variational", "order": 2},
    ),
    "not by its axes": ((SKEWED, SKEWED.state(M=MOMENTUM, P=(0.5, -0.1, 0.7, 0.5))), {"method": "kahan", "order": 2}),
    "midpoint 4": ((MANAKOV, MANAKOV.state(M=(0.3, 0.5, 1.1))), {"method": "midpoint", "order": 4}),
    "midpoint, spins": ((CHAIN, CHAIN.state(**SPINS)), {"method": "midpoint", "order": 2}),
    "a parameter c": ((KOMAROV, KOMAROV.state(M=(0.3, 0.5, 1.1), P=(0.6, 0, 0.8))), {"method": "kahan", "order": 2}),
    "a force with c": ((DRAGGED, DRAGGED.state(**TOP_START)), {"method": "splitting", "order": 4}),
}
FLAGS = ["-O2", "-ffp-contract=off", "-Wall", "-Wextra", "-Werror"]
C_PROGRAM = """#include "{name}.h"
#include <stdio.h>
#include <string.h>
int main(void) {{
    static {name}_constants c;
    static {name}_state s;
    {name}_prepare(&c{arguments});
    {start}
    {calls}
    {observe}
    for (int i = 0; i < {size}; i++) printf("%.17g\\n", out[i]);
    return 0;
}}
"""
COMPILED = [(case, "gcc") for case in CASES] + [
    (case, "clang") for case in CASES if shutil.which("clang") and (FULL or case == "baecklund 4, orientation")
]


def defaults(text: str, name: str) -> dict[str, str]:
    """The default values of a file of C: name -> declaration of the array, or "" for a number."""
    return dict(re.findall(rf"^static const double {name}_(\w+?)(\[\d+\])? = ", text, re.MULTILINE))


def counts(text: str) -> list[tuple[str, int]]:
    """The fields of the state of a file of C."""
    fields = re.findall(r"^typedef struct {\n(.*?)^} \w+_state;", text, re.MULTILINE | re.DOTALL)[0]
    return [(name, int(count or 1)) for name, count in re.findall(r"double (\w+)(?:\[(\d+)\])?;", fields)]


def by_c(folder: Path, text: str, name: str, calls: str, compiler: str = "gcc", dt: str | None = None) -> list[float]:
    """The state after these calls of a program in C with constants c and state s, from its default values."""
    known = defaults(text, name)
    arguments = [name for name in known if not name.startswith("start_")]
    state = [field for field, _ in counts(text) if f"start_{field}" in known]
    size = sum(count for field, count in counts(text) if field in state)
    start = " ".join(f"memcpy(&s.{field}, &{name}_start_{field}, sizeof s.{field});" for field in state)
    begin = f" {name}_begin(&c, &s);" if f" {name}_begin(" in text else ""
    given = "".join(f", {dt}" if x == "dt" and dt else f", {name}_{x}" for x in arguments)
    written = re.search(rf" {name}_observe\(.* out\[(\d+)\]", text)  # energies; the state too if it is not in s
    observed = written is not None and int(written[1]) >= size
    observe = f"double out[100]; {name}_observe(&c, &s, out);" if observed else "double *out = (double *)&s;"
    words = {"name": name, "arguments": given, "start": start + begin, "calls": calls, "size": size, "observe": observe}
    program = C_PROGRAM.format(**words)
    (folder / f"{name}.h").write_text(text)
    (folder / "main.c").write_text(program)
    subprocess.run([compiler, "-std=c99", *FLAGS, "main.c", "-o", "main", "-lm"], cwd=folder, check=True, timeout=120)
    out = subprocess.run(["./main"], cwd=folder, check=True, capture_output=True, text=True, timeout=120).stdout
    return [float(word) for word in out.split()]


def state(run: Any, row: int = -1) -> list[float]:
    letters = [n for n in run.data_vars if run[n].attrs["kind"] in ("state", "orientation")]
    values = [run[n].values[row] for n in letters]
    return [
        float(v) for x in values for v in (x if x.ndim == 1 else x[np.triu_indices(len(x), int((x == -x.T).all()))])
    ]


def orbit(model: Any, start: Any, asked: dict[str, Any], dt: float = DT) -> str:
    """The constant of the trajectory of the kernel, which NumPy computes: assignments in C."""
    stages = make_plan(model, start, dt=dt, steps=1, **asked).scheme.stages
    return " ".join(f"s.sigma[{k}] = {float(v).hex()};" for k, v in enumerate(np.ravel(stages.get("sigma", ()))))


@pytest.mark.parametrize(("case", "compiler"), COMPILED)
def test_c_has_the_bits_of_the_kernel(case: str, compiler: str, tmp_path: Path) -> None:
    (model, start), asked = CASES[case]
    text = kr.code(model, start, dt=DT, name="rock", **asked)
    run = kr.simulate(model, start, dt=DT, steps=STEPS, every=STEPS, project=False, **asked)
    found = by_c(tmp_path, text, "rock", f"{orbit(model, start, asked)} rock_advance(&c, &s, {STEPS});", compiler)
    assert found[: len(state(run))] == state(run)


BALLS = {"moments1": [2.7e16] * 3, "moments2": [9.4e12] * 3}
FALL = {"v": (0.0, 0.02, 0.0), "L1": (0.0, 0.0, 1e11), "L2": (0.0, 0.0, 1e7)}
OF_BODIES: dict[str, tuple[dict[str, Any], dict[str, Any], float]] = {  # what differs from the example, and the step
    "satellite": ({}, {"M": (1e-5, 2e-5, 3e-5)}, 60.0),
    "binary": ({}, {}, 1800.0),
    "binary of balls": (BALLS, FALL, 8000.0),  # past each other, in steps for which Newton's method does not settle
    "submerged-body": ({}, {}, 0.02),
}


@pytest.mark.parametrize("name", OF_BODIES)
def test_a_body_with_its_forces(name: str, tmp_path: Path) -> None:
    """Of bodies without tables; orbits solve Kepler's equation, in the kernel until it is solved."""
    record, (parameters, more, dt) = BODIES[name.partition(" ")[0]], OF_BODIES[name]
    case = examples.example(record, 3)
    model = record(**case.parameters | parameters)
    asked = {"method": "splitting", "order": 4, "orientation": case.orientation}
    asked = {k: v for k, v in asked.items() if v is not None}
    start = model.state(**case.state | more)
    text = kr.code(model, start, dt=dt, name="rock", **asked)
    run = kr.simulate(model, start, dt=dt, steps=10, every=10, project=False, **asked)
    moved, found = list[float](), by_c(tmp_path, text, "rock", "rock_advance(&c, &s, 10);")
    for letter, value in run.data_vars.items():
        if value.attrs["kind"] in ("state", "orientation"):
            expected, first = value.values[-1], value.values[0]
            part, found = np.array(found[: expected.size]), found[expected.size :]
            off = abs(part - expected).max() / abs(expected).max()
            assert off < (1e-300 if name == "submerged-body" else 1e-9), (letter, off)
            moved.append(abs(expected - first).max() / abs(expected).max())
    assert max(moved) > 0.001


def test_a_body_whose_force_depends_on_its_attitude(tmp_path: Path) -> None:
    """Without a state: an example.  I omega' = I omega x omega + 0.4 e_1 x g^T e_3, from V = 0.4 g_31, by SciPy."""
    moments = np.array([1.0, 2.0, 2.5])
    body = kr.physical.FreeBody(tuple(moments), potential=lambda g: 0.4 * g[2, 0])
    text = kr.code(body, dt=DT, name="rock")
    start = np.array(by_c(tmp_path, text, "rock", ""))[:7]
    end = np.array(by_c(tmp_path, text, "rock", "rock_advance(&c, &s, 100);"))[:7]
    unit = body.scales()["M"].size

    def rates(_: float, y: np.ndarray) -> np.ndarray:
        M, (w, x, y_, z) = y[:3], y[3:]
        a, b, c = omega = M / moments
        up = np.array([2 * (x * z - w * y_), 2 * (y_ * z + w * x), 1 - 2 * (x * x + y_ * y_)])
        turning = [-x * a - y_ * b - z * c, w * a + y_ * c - z * b, w * b + z * a - x * c, w * c + x * b - y_ * a]
        return np.concatenate([np.cross(M, omega) + 0.4 * np.cross(up, [1.0, 0, 0]), np.array(turning) / 2])

    first = np.concatenate([unit * start[:3], start[3:]])
    wanted = solve_ivp(rates, (0, 100 * DT), first, method="DOP853", rtol=1e-12, atol=1e-12).y[:, -1]
    off = np.concatenate([unit * end[:3], end[3:]]) - wanted
    assert abs(off).max() < 1e-7 and abs(end - start).max() > 0.1


def test_a_file_begins_as_a_run_of_its_body_and_states_axes_and_units(tmp_path: Path) -> None:
    """I omega' = tau(t) - omega x I omega along axes that are not principal, from an attitude, by SciPy."""
    inertia, w, q = [[0.9, 0.1, -0.05], [0.1, 1.3, 0.07], [-0.05, 0.07, 1.6]], [1.0, 2.0, -1.0], [0.8, 0.2, -0.4, 0.4]
    body = kr.physical.FreeBody(inertia, torque=lambda t: 0.1 * np.array([np.sin(3 * t), 0, np.cos(t)]))
    text = kr.code(body, body.state(w, attitude=q), dt=DT, name="rock")
    unit = float(re.findall(r"One unit of M is (\S+) kg", text)[0])
    axes = np.array(json.loads(re.findall(r"R =\s+(\[.*?\]), by\s+rows", text, re.DOTALL)[0]))
    turn = Rotation.from_matrix(axes)

    def moved(calls: str) -> tuple[np.ndarray, Rotation]:
        out = by_c(tmp_path, text, "rock", calls)
        return unit * axes @ out[:3], Rotation.from_quat(out[3:7], scalar_first=True) * turn.inv()

    def rates(t: float, L: np.ndarray) -> np.ndarray:
        return np.cross(L, np.linalg.solve(inertia, L)) + 0.1 * np.array([np.sin(3 * t), 0, np.cos(t)])

    def after(t: float, start: float = 0.0) -> np.ndarray:
        first = inertia @ np.array(w)
        return np.asarray(solve_ivp(rates, (start, start + t), first, method="DOP853", rtol=1e-11, atol=1e-12).y[:, -1])

    M, attitude = moved("")
    assert np.allclose(M, inertia @ np.array(w), rtol=1e-12)
    assert (attitude * Rotation.from_quat(q, scalar_first=True).inv()).magnitude() < 1e-12
    assert abs(moved("rock_advance(&c, &s, 100);")[0] - after(100 * DT)).max() < 1e-7
    later = moved("s._count[0] = 50; rock_advance(&c, &s, 100);")[0]
    assert abs(later - after(100 * DT, 50 * DT)).max() < 1e-7 < abs(later - after(100 * DT)).max()


def test_an_example_of_a_body_with_forces_has_the_attitude_of_its_axis(tmp_path: Path) -> None:
    """a = g e_3 of a gyroscope, P = g^T e_3 of a heavy body."""
    top = kr.physical.Gyroscope.flat(3, 0.17, 0.15, torque=lambda t: np.array([0.0, 0, 0.1 * t]))
    heavy = kr.physical.HeavyBody(0.4, (0.3, 0.2, 0.25), (0, 0.1, 0.2), torque=lambda t: np.array([0.0, 0, 0.1 * t]))
    for body, column in ((top, True), (heavy, False)):
        out = by_c(tmp_path, kr.code(body, dt=DT, name="rock"), "rock", "")
        R = Rotation.from_quat(out[6:10], scalar_first=True).as_matrix()
        assert abs((R[:, 2] if column else R[2]) - out[3:6]).max() < 1e-14
        down = dict(zip(body.in_si().system.space.letters, ((0, 0, 0.1), (0, 0, -1)), strict=True))
        hanging = by_c(tmp_path, kr.code(body, body.in_si().state(**down), dt=DT, name="rock"), "rock", "")
        R = Rotation.from_quat(hanging[6:10], scalar_first=True).as_matrix()  # half a turn from upright
        assert abs((R[:, 2] if column else R[2]) - [0, 0, -1]).max() < 1e-14


ROCK: dict[str, Any] = {"dt": DT, "name": "rock", **TURNED}


def test_the_closed_form_has_the_bits_of_the_kernel(tmp_path: Path) -> None:
    """A splitting whose torque is 0 moves by two half steps."""
    still = kr.perturbed(BODY, torque=lambda M: 0 * M)
    run = kr.simulate(
        still, START, dt=2 * DT, steps=500, every=500, method="splitting", order=(2, 2), project=False, **TURNED
    )
    text = kr.code(BODY, START, method="exact", **ROCK)
    assert by_c(tmp_path, text, "rock", "rock_advance(&c, &s, 1000);") == state(run)
    assert by_c(tmp_path, text, "rock", "rock_advance(&c, &s, 1000);", dt=repr(DT * (1 + 1e-15))) != state(run)


# -- the free body --------------------------------------------------------------------------------------

HELD = """#include "rock.h"
#include <stdio.h>
int main(void) {
    rock_constants c;
    static rock_state s;
    const NUMBER I[3] = {5.5, 4.5, 3.0};
    s.M[0] = (NUMBER)0.3, s.M[1] = (NUMBER)0.5, s.M[2] = (NUMBER)1.1, s.g[0] = 1;
    rock_prepare(&c, I, (NUMBER)(1.0 / 60.0));
    for (int k = 0; k < 200000; k++) {
        if (k % 100000 == 0) s.M[0] += KICK;
        rock_step(&c, &s);
        HOLD
        if (k % 100 == 0 || k % 100000 < 3) printf("%.17g %.17g %.17g\\n", s.M[0], s.M[1], s.M[2]);
    }
    return 0;
}
"""


@pytest.mark.parametrize(("single", "unit"), [(False, 2.0**-52), (True, 2.0**-23)])
def test_momentum_and_energy_of_the_last_kick_are_held(single: bool, unit: float, tmp_path: Path) -> None:
    """In units of the last place; kicked by 250 of them."""

    def change(hold: str) -> tuple[float, float, float]:
        words = {"NUMBER": "float" if single else "double", "HOLD": hold, "KICK": repr(250 * unit)}
        program = HELD
        for word, text in words.items():
            program = program.replace(word, text)
        (tmp_path / "main.c").write_text(program)
        subprocess.run(
            ["gcc", "-std=c99", *FLAGS, "main.c", "-o", "main", "-lm"], cwd=tmp_path, check=True, timeout=120
        )
        out = subprocess.run(["./main"], cwd=tmp_path, check=True, capture_output=True, text=True, timeout=120).stdout
        M = np.array([line.split() for line in out.splitlines()], dtype=np.longdouble).reshape(2, -1, 3)
        momentum, energy = np.sqrt((M * M).sum(-1)), (M * M / np.array([5.5, 4.5, 3.0])).sum(-1)
        changes = (float(abs(x / x[:, :1] - 1).max() / unit) for x in (momentum, energy))
        return (*changes, float((momentum[1, 0] / momentum[0, 0] - 1) / unit))

    (tmp_path / "rock.h").write_text(kr.code(BODY, single=single, name="rock"))
    momentum, energy, kicked = change("" if single else "rock_hold(&c, &s);")
    assert momentum < 4 and energy < 8 and kicked > 16
    if not single:
        assert change("")[1] > 100  # without


LENGTH = """#include "rock.h"
#include <stdio.h>
#include <string.h>
int main(void) {
    static rock_constants c;
    static rock_state s;
    rock_prepare(&c);
    memcpy(s.M, rock_start_M, sizeof s.M), memcpy(s.P, rock_start_P, sizeof s.P), memcpy(s.g, rock_start_g, sizeof s.g);
    rock_advance(&c, &s, 100000);
    for (int i = 0; i < 4; i++) printf("%.17g\\n", s.g[i]);
    return 0;
}
"""


def test_the_attitude_of_a_submerged_body_keeps_its_length_in_32_bits(tmp_path: Path) -> None:
    body = kr.physical.SubmergedBody(1.0, (0.02, 0.03, 0.025), (5.0, 6.0, 26.0, 0.1, 0.2, 0.3))
    start = body.state(angular_velocity=(1.0, 2.0, 0.5), velocity=(0.1, 0.2, 0.3))
    (tmp_path / "rock.h").write_text(kr.code(body, start, dt=0.01, single=True, name="rock"))
    (tmp_path / "main.c").write_text(LENGTH)
    subprocess.run(["gcc", "-std=c99", *FLAGS, "main.c", "-o", "main", "-lm"], cwd=tmp_path, check=True, timeout=120)
    out = subprocess.run(["./main"], cwd=tmp_path, check=True, capture_output=True, text=True, timeout=120).stdout
    assert abs(np.linalg.norm([float(x) for x in out.split()]) - 1) < 2.0**-22


def test_a_file_in_32_bits_states_where_its_clock_ends() -> None:
    last = 2**24
    assert np.float32(last - 1) + np.float32(1) == np.float32(last) + np.float32(1) == last
    driven = kr.perturbed(BODY, torque=lambda t: 0.1 * np.array([np.sin(t), 0 * t, 0 * t]))
    assert [str(last) in kr.code(driven, START, single=single) for single in (True, False)] == [True, False]


CHECKED = """#include "rock.h"
#include "ball.h"
#include <stdio.h>
int main(void) {
    const double I[5][3] = {{1, 2, 2.5}, {1, 2, 3.5}, {1, -2, 2}, {1, NAN, 2}, {1, 2, 3}};
    const double dt[5] = {0.1, 0.0, NAN, INFINITY, -0.1};
    ball_state s = {.M = {0.1, 0.2, 0.3}, .g = {1.0}};
    ball_constants c;
    for (int i = 0; i < 5; i++) printf("%d ", rock_check(I[i], 0.1));
    for (int i = 0; i < 5; i++) printf("%d ", ball_check(I[0], dt[i]));
    ball_prepare(&c, ball_I, ball_dt);
    ball_advance(&c, &s, 3);
    printf("%d %s", s.M[0] == 0.1, rock_message(2));
    return 0;
}
"""


@pytest.mark.parametrize("name", BODIES)
def test_the_earth_the_sun_and_dust_are_bodies(name: str) -> None:
    """Values of an example, some with the mass of the Sun; moments in kg m^2 of a grain, of the Earth, and of none."""
    case, file = examples.example(BODIES[name], 3), dict[str, Any]()
    asked = {"dt": case.dt, "orientation": case.orientation, "language": "python"}
    exec(kr.code(case.model, case.model.state(**case.state), **asked), file)
    values = [k for k in file if k.startswith("default_") and "_start_" not in k]
    assert not values or file["check"](**{k[8:]: file[k] for k in values}) == 0
    exec(kr.code(BODY, dt=DT, language="python"), file)
    unit = np.array([8.0094, 8.0096, 8.0359])
    assert [file["check"]([*(unit * scale)], 60.0) for scale in (1e-30, 1e37, 1e200)] == [0, 0, 1]


def test_impossible_bodies_are_refused_and_two_fit_in_one_program(tmp_path: Path) -> None:
    ball = kr.EulerTop(J=(1.0, 1.0, 1.0))
    for name, body in (("rock", BODY), ("ball", ball)):
        (tmp_path / f"{name}.h").write_text(kr.code(body, name=name))
    (tmp_path / "main.c").write_text(CHECKED)
    gcc = ["gcc", "-std=c99", *FLAGS, "main.c", "-o", "main", "-lm"]
    subprocess.run(gcc, cwd=tmp_path, check=True, timeout=120)
    out = subprocess.run(["./main"], cwd=tmp_path, check=True, capture_output=True, text=True, timeout=120).stdout
    assert out == "0 1 1 1 0 0 2 2 2 0 1 the time step dt is finite and not 0"
    (tmp_path / "ball.h").write_text(kr.code(ball, name="rock"))  # one name for both: stated, not dropped
    done = subprocess.run(gcc, cwd=tmp_path, capture_output=True, text=True, timeout=120)
    assert done.returncode != 0
    assert "two bodies are called rock" in done.stderr


SYSTEMS = [name for name in kr.checkcases.cases() if law_of(name) in checkcase_systems]


@pytest.mark.parametrize("name", SYSTEMS if FULL else ["heavy-top", "gyrostat", "in-water"])
def test_the_file_of_each_check_case_passes_it(name: str, tmp_path: Path) -> None:
    """By the method that `kreisel new checkcase` writes; a step less does not."""
    for path, content in files_of(name, tmp_path / "case.toml", tmp_path / "case.py", "# ").items():
        path.write_text(content)
    config, case = read(tmp_path / "case.toml"), kr.checkcases.case(name)
    dt, steps = config.run.dt, config.run.steps
    asked = {"method": config.run.method, "order": config.run.order, "orientation": config.orientation}
    text = kr.code(config.model, config.state, dt=dt, name="rock", **asked)
    calls = f"{orbit(config.model, config.state, asked, dt)} rock_advance(&c, &s, {steps});"

    places = [
        field for field, count in counts(text) if f"start_{field}" in defaults(text, "rock") for _ in range(count)
    ]

    def attitude(calls: str) -> np.ndarray:
        found = by_c(tmp_path, text, "rock", calls)
        return np.array([found[k] for k, field in enumerate(places) if field == "g"])

    after = attitude(calls)
    grade = case.grade([0.0, dt * steps], attitude=[np.array(case.attitude, float), after])
    # Rounding moves the time of flips: an error 1 of the momentum is 4.9e4 of the attitude at the end (mean over the
    # times of the error, by `exact`), 1.6e-8 for one of 1.1e-16 in each of 3003 steps.
    flips = {"wing-nut": 2e-8, "wing-nut-fine": 2e-6}
    assert grade.relative < flips.get(name, 2e-9)
    shorter = attitude(calls.replace(f", {steps}", f", {steps - 1}"))
    assert min(abs(shorter - after).max(), abs(shorter + after).max()) > 1e-6


@pytest.mark.parametrize(
    ("model", "start", "part"),
    [
        (BODY, {"M": np.ones((4, 3))}, "got an ensemble. .* write it for one lane"),
        (kr.EulerTop(J=np.ones((4, 3))), {"M": (0.3, 0.5, 1.1)}, "got an ensemble"),
        (kr.LagrangeTop(p=np.eye(12)[0]), None, "expected n <= 10, got n = 12"),
    ],
)
def test_ensembles_and_many_dimensions_have_no_file(model: Any, start: Any, part: str) -> None:
    with pytest.raises(kr.InputError, match=part):
        kr.code(model, None if start is None else model.state(**start))


def test_a_method_that_steps_another_body_has_no_file() -> None:
    particle = kr.Neumann(b=(1.0, 2.0, 3.5))
    with pytest.raises(kr.InputError, match="method='exact' of neumann, which steps another body"):
        kr.code(particle, method="exact")
    assert kr.code(particle, method="baecklund")


SIZES = {
    "free-body": (lambda x: kr.EulerTop(J=(1.0, 2.0, 3.5 * x)), {"M": (0.3, 0.5, 1.1)}, {}, 400),
    "veselov": (
        lambda x: kr.EulerTop(J=(1.0, 2.0, 3.5 * x)),
        {"M": (0.3, 0.5, 1.1)},
        {"method": "veselov", "order": 2},
        150,
    ),
    "lagrange-top": (
        lambda x: kr.LagrangeTop(p=(0, 0.6, 0.8 * x), alpha=0.5),
        {"m": (0.1, 0.2, 1.5), "a": (0.6, 0, 0.8)},
        {"method": "suris", "order": 1},
        100,
    ),
    "lagrange-top 2": (
        lambda x: kr.LagrangeTop(p=(0, 0.6, 0.8 * x), alpha=0.5),
        {"m": (0.1, 0.2, 1.5), "a": (0.6, 0, 0.8)},
        {"method": "suris", "order": 2},
        120,
    ),
    "clebsch": (
        lambda x: kr.Clebsch(b=(1.0, 2.0, 3.5 * x)),
        {"M": (0.3, 0.5, 1.1), "P": (0.6, 0, 0.8)},
        {"method": "suris", "order": 2},
        120,
    ),
    "heavy-top": (
        lambda x: kr.HeavyTop(J=(1.0, 2.0, 2.5 * x), A=(0.1, 0.2, 0.3 * x)),
        {"M": (0.3, 0.5, 1.1), "P": (0.6, 0, 0.8)},
        {"method": "kahan"},
        200,
    ),
}


@pytest.mark.parametrize("name", SIZES)
def test_files_are_short_and_their_functions_have_no_number_of_the_body(name: str) -> None:
    """Moments, parameters and dt are arguments: the files of two bodies differ in default values alone."""
    body, start, asked, most = SIZES[name]
    for language in ("c", "js", "julia"):
        text, other = (
            kr.code(body(x), body(x).state(**start), dt=0.1 * x, language=language, **TURNED, **asked)
            for x in (1.0, 1.125)
        )
        assert text.count("\n") <= most
        pairs = zip(text.splitlines(), other.splitlines(), strict=True)
        differ = [one for one, two in pairs if one != two and "FILE" not in one]
        assert 2 <= len(differ) <= 3
        assert all(
            re.match(r"(static const double \w+|export const \w+|const \w+)(\[\d\])? = ", line) for line in differ
        )


def rows_by_python(body: Any, start: Any, dt: float, **asked: Any) -> list[tuple[Any, ...]]:
    """State and outputs at t = 0, 1.4 dt, ..., 40 x 1.4 dt by a file that was generated with dt."""
    file: dict[str, Any] = {}
    text = kr.code(body, start, dt=dt, language="python", **asked)
    exec(compile(text, "rock.py", "exec"), file)
    c, s, out, rows = file["Constants"](), file["State"](), [0.0] * 2, []
    values = {k: v for k, v in file.items() if k.startswith("default_") and "_start_" not in k}
    file["prepare"](c, **{k[8:]: v for k, v in values.items()} | {"dt": 1.4 * dt})
    for name in vars(s):
        setattr(s, name, [*file.get(f"default_start_{name}", [0.0])])
    for k in range(41):
        file["observe"](c, s, out)
        rows.append((k * 1.4 * dt, copy.deepcopy(s), *out))
        file["advance"](c, s, 1)
    return rows


def test_energies_are_those_of_the_dt_of_prepare() -> None:
    """Kahan's map conserves a deformed energy; a satellite has V = 3 n^2 u . I u/2, u from the Earth, in the body."""
    _, _, energy, deformed = zip(*rows_by_python(TOP, TOP_START, DT, method="kahan"), strict=True)
    assert np.ptp(energy) > 1e-6
    assert np.ptp(deformed) < 1e-13
    inertia, n = np.array([0.02, 0.03, 0.04]), np.sqrt(3.986004418e14 / 7e6**3)
    satellite = kr.physical.Satellite(inertia, kr.physical.Orbit(7e6))
    rows = rows_by_python(satellite, satellite.state((2 * n, n, 0.5 * n)), 30.0)
    u = np.array(
        [Rotation.from_quat(s.g, scalar_first=True).inv().apply([np.cos(n * t), np.sin(n * t), 0]) for t, s, *_ in rows]
    )
    M, energy = np.array([s.M for _, s, *_ in rows]), np.array([energy for *_, energy, _ in rows])
    expected = (M**2 / inertia).sum(1) / 2 + 1.5 * n**2 * (inertia * u**2).sum(1)
    assert abs(energy - energy[0] - expected + expected[0]).max() < 1e-9 * np.ptp(expected) + 1e-15


@pytest.mark.parametrize("case", ["suris 1", "veselov 4", "a motor with limits"])
def test_julia_is_well_formed(case: str) -> None:
    (model, start), asked = CASES[case]
    text = kr.code(model, start, dt=DT, language="julia", **asked)
    assert syntax_errors("julia", text) == []
    assert syntax_errors("julia", text.replace("\nend\n", "\n", 1)) != []


# -- the examples ------------------------------------------------------------------------------------


def example(folder: Path, language: str, suffix: str) -> Path:
    (folder / f"rock{suffix}").write_text(kr.code(BODY, language=language, name="rock"))
    return Path(shutil.copy(EXAMPLES / "code" / f"gyroscope{'.c' if language == 'c' else suffix}", folder))


def energies(out: str) -> list[float]:
    return [abs(float(word)) for word in re.findall(r"energy changed by (\S+)", out)]


def test_the_game_in_c_does_not_turn_over(tmp_path: Path) -> None:
    example(tmp_path, "c", ".h")
    subprocess.run(["gcc", "-std=c99", *FLAGS, "gyroscope.c", "-o", "game", "-lm"], cwd=tmp_path, check=True)
    out = subprocess.run(["./game", "200000"], cwd=tmp_path, check=True, capture_output=True, text=True, timeout=300)
    assert len(energies(out.stdout)) == 5
    assert max(energies(out.stdout)) < 1e-11
    assert "kicked: energy 2.25" in out.stdout


def test_the_game_in_javascript(tmp_path: Path) -> None:
    node = shutil.which("node")
    if node is None:
        pytest.skip("no Node")
    example(tmp_path, "js", ".mjs")
    out = subprocess.run([node, "gyroscope.mjs", "200000"], cwd=tmp_path, check=True, capture_output=True, text=True)
    assert len(energies(out.stdout)) == 5
    assert max(energies(out.stdout)) < 1e-11


def test_the_game_in_julia(tmp_path: Path) -> None:
    example(tmp_path, "julia", ".jl")
    out = run(tmp_path, ["julia", "--startup-file=no", "gyroscope.jl", "200000"])
    assert len(energies(out)) == 5
    assert max(energies(out)) < 1e-11
