"""The file of a free body in each language, compiled and run or parsed, graded by the check cases."""

from __future__ import annotations

import json
import re
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import browser
import emitted
import kreisel as kr
from compilers import output, run, syntax_errors

GRADED, ROWS = ("tilted-box", "on-the-separatrix", "prolate", "oblate", "pole"), 12
UNFUSED = ("js", "python", "csharp", "gdscript")  # round x y + z twice
DT_MESSAGE = "the time step dt is finite and not 0"


def text(language: str, **asked: Any) -> str:
    return kr.code(kr.physical.FreeBody((1.0, 2.0, 2.5)), language=language, name="rock", **asked)


def body(name: str, angle: float = 0.5) -> list[float]:
    """Of a case: the tensor (xx, yy, zz, yz, zx, xy), attitude, angular velocity in space, step, steps a row."""
    case = kr.checkcases.case(name)
    I, w, q = (np.array(v, dtype=float) for v in (case.inertia, case.angular_velocity, case.attitude))  # noqa: E741
    between = float(case.duration) / ROWS
    count = int(np.ceil(between * np.linalg.norm(w) / angle))
    in_space = Rotation.from_quat(q, scalar_first=True).apply(w)
    entries = [I[i, j] for i, j in ((0, 0), (1, 1), (2, 2), (1, 2), (2, 0), (0, 1))]
    return [*map(float, entries), *map(float, q), *map(float, in_space), between / count, count]


BODIES = [body(name) for name in GRADED]


@cache
def truth(name: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times, attitudes and angular velocities in space."""
    case = kr.checkcases.case(name)
    times = np.arange(ROWS + 1) * (float(case.duration) / ROWS)
    run = case.reference(times)
    return times, run.attitude.values, run.angular_velocity_space.values


def errors(table: np.ndarray) -> list[float]:
    """The largest relative errors of the cases, by their reference; the grader agrees."""
    out = []
    for name, rows in zip(GRADED, table, strict=True):
        times, q, w = truth(name)
        turned = np.minimum(abs(rows[:, :4] - q).max(-1), abs(rows[:, :4] + q).max(-1)).max()
        out.append(max(turned, abs(rows[:, 4:] - w).max() / np.linalg.norm(w[0])))
        if out[-1] < 1e-11:
            grade = kr.checkcases.case(name).grade
            assert grade(times, attitude=rows[:, :4], angular_velocity_space=rows[:, 4:]).relative < 2e-11
    return out


@cache
def kicked() -> float:
    """The energy of the last body, to whose momentum in space its angular velocity in space is added."""
    _, q, w = truth(GRADED[-1])
    inertia = np.array(kr.checkcases.case(GRADED[-1]).inertia, float)
    turn = Rotation.from_quat(q[-1], scalar_first=True)
    momentum = inertia @ turn.inv().apply(w[-1]) + turn.inv().apply(w[-1])
    return float(momentum @ np.linalg.solve(inertia, momentum)) / 2


def passed(language: str, folder: Path, *, change: tuple[str, str] = ("", ""), **how: Any) -> np.ndarray:
    """Rows of the cases by the file of a language, whose energy and message are right too."""
    asked = {"single": True} if how.get("single") else {}
    source = text(language, **asked).replace(*change)
    rows, energy, message = emitted.moved(language, source, folder, BODIES, ROWS, **how)
    assert message == DT_MESSAGE
    assert energy == pytest.approx(kicked(), rel=1e-4 if asked else 1e-10)
    return rows


@pytest.fixture(scope="module")
def by_c(tmp_path_factory: pytest.TempPathFactory) -> np.ndarray:
    rows = passed("c", tmp_path_factory.mktemp("c"))
    assert max(errors(rows)) < 1e-11
    return rows


@pytest.mark.parametrize(
    "compiler", [x for n, program in emitted.PROGRAMS.items() for x in program.compilers if n != "c"]
)
def test_each_file_passes_the_check_cases(compiler: str, by_c: np.ndarray, tmp_path: Path) -> None:
    """At moments, steps and tensors that the file was not made with: by the bits of C, if there is a fused product."""
    language = next(name for name, program in emitted.PROGRAMS.items() if compiler in program.compilers)
    rows = passed(language, tmp_path, compiler=compiler)
    assert max(errors(rows)) < 1e-11
    assert (rows == by_c).all() == (language not in UNFUSED)


@pytest.fixture(scope="module")
def by_c_in_single(tmp_path_factory: pytest.TempPathFactory) -> np.ndarray:
    rows = passed("c", tmp_path_factory.mktemp("single"), single=True)
    assert 1e-9 < max(errors(rows)) < 1e-3
    return rows


@pytest.mark.parametrize("language", ["cuda", "rust", "julia"])
def test_numbers_of_32_bits_have_the_bits_of_c(language: str, by_c_in_single: np.ndarray, tmp_path: Path) -> None:
    assert (passed(language, tmp_path, single=True) == by_c_in_single).all()


@pytest.mark.parametrize(
    ("language", "change"),
    [("python", ("w[1] = ", "w[1] = -")), ("c", ("0.020833333333333332", "0.020833433333333332"))],
)
def test_a_grade_sees_a_wrong_file(language: str, change: tuple[str, str], tmp_path: Path) -> None:
    rows, *_ = emitted.moved(language, text(language).replace(*change), tmp_path, BODIES, ROWS)
    assert max(errors(rows)) > 1e-11


def test_rust_without_std(tmp_path: Path) -> None:
    """The file in a crate without std, with as much of num-traits as it calls."""
    (tmp_path / "num_traits.rs").write_text("""#![no_std]
pub trait Float: Sized {
    fn mul_add(self, y: f64, z: f64) -> f64;
    fn sqrt(self) -> f64;
    fn abs(self) -> f64;
}
impl Float for f64 {
    fn mul_add(self, y: f64, z: f64) -> f64 { self * y + z }
    fn sqrt(self) -> f64 { self }
    fn abs(self) -> f64 { self }
}
""")
    (tmp_path / "rock.rs").write_text(text("rust"))
    (tmp_path / "lib.rs").write_text("#![no_std]\npub mod rock;\n")
    words = ["rustc", "--edition=2021", "--crate-type=rlib"]
    run(tmp_path, [*words, "num_traits.rs"])
    run(tmp_path, [*words, '--cfg=feature="libm"', "--extern=num_traits=libnum_traits.rlib", "lib.rs"])
    assert (tmp_path / "liblib.rlib").is_file()
    with pytest.raises(AssertionError, match="no method named"):
        run(tmp_path, [*words, "lib.rs"])


@pytest.mark.parametrize("language", ["gdscript", "julia"])
def test_a_grammar_reads_the_file(language: str) -> None:
    """Where there is no Godot and no Julia."""
    source = text(language)
    assert syntax_errors(language, source) == []
    assert syntax_errors(language, source.replace("dt * dt", "dt * * dt")) != []


WEBGPU = ("--enable-unsafe-webgpu", "--use-webgpu-adapter=swiftshader")
SPUN = "".join(  # the first body last: it tumbles
    f"spin(&c, &s, array<f32, 6>({T}), array<f32, 4>({Q}), array<f32, 3>({W}), {dt}, {steps}, {k});\n    "
    for k, (T, Q, W, dt, steps) in reversed(
        [
            *enumerate(
                (*(", ".join(map(repr, row[i:j])) for i, j in ((0, 6), (6, 10), (10, 13))), *row[13:]) for row in BODIES
            )
        ]
    )
)
SIZE = 7 * (ROWS + 1) * len(BODIES)
SHADER = f"""
@group(0) @binding(0) var<storage, read_write> rows: array<f32>;
fn spin(c: ptr<function, rock_constants>, s: ptr<function, rock_state>, T: array<f32, 6>, q0: array<f32, 4>,
        w0: array<f32, 3>, dt: f32, steps: i32, place: i32) {{
    var I: array<f32, 3>;
    var axes: array<f32, 4>;
    var q = q0;
    var w = w0;
    *s = rock_state();
    rock_principal(T, &I, &axes);
    rock_prepare(c, I, dt);
    rock_set_motion(c, s, axes, q, w);
    for (var row = 0; row <= {ROWS}; row++) {{
        if (row > 0) {{ rock_advance(c, s, steps); }}
        rock_get_motion(c, s, axes, &q, &w);
        let k = 7 * ({ROWS + 1} * place + row);
        for (var i = 0; i < 4; i++) {{ rows[k + i] = q[i]; }}
        for (var i = 0; i < 3; i++) {{ rows[k + 4 + i] = w[i]; }}
    }}
}}
@compute @workgroup_size(1) fn main() {{
    var c: rock_constants;
    var s: rock_state;
    {SPUN}for (var i = 0; i < 3; i++) {{ rows[{SIZE} + i] = s.M[i]; rows[{SIZE + 6} + i] = c.inverse[i]; }}
    rock_advance(&c, &s, 50000);
    for (var i = 0; i < 3; i++) {{ rows[{SIZE + 3} + i] = s.M[i]; }}
}}
"""
RUNNER = """(async (code, size) => {
    const device = await (await navigator.gpu.requestAdapter()).requestDevice();
    const module = device.createShaderModule({ code });
    const told = (await module.getCompilationInfo()).messages.map((m) => `${m.lineNum}: ${m.message}`);
    if (told.length) return told;
    const { STORAGE, COPY_SRC, COPY_DST, MAP_READ } = GPUBufferUsage;
    const rows = device.createBuffer({ size, usage: STORAGE | COPY_SRC });
    const read = device.createBuffer({ size, usage: MAP_READ | COPY_DST });
    const compute = { module, entryPoint: "main" };
    const pipeline = await device.createComputePipelineAsync({ layout: "auto", compute });
    const layout = pipeline.getBindGroupLayout(0);
    const group = device.createBindGroup({ layout, entries: [{ binding: 0, resource: { buffer: rows } }] });
    const encoder = device.createCommandEncoder(), pass = encoder.beginComputePass();
    pass.setPipeline(pipeline);
    pass.setBindGroup(0, group);
    pass.dispatchWorkgroups(1);
    pass.end();
    encoder.copyBufferToBuffer(rows, 0, read, 0, size);
    device.queue.submit([encoder.finish()]);
    await read.mapAsync(GPUMapMode.READ);
    return Array.from(new Float32Array(read.getMappedRange()));
})"""


@pytest.mark.skipif(browser.find() is None, reason=f"no browser: none of {', '.join(browser.NAMES)}")
def test_wgsl_runs_in_a_browser(tmp_path: Path) -> None:
    """Compiled and run by WebGPU, on the processor; single precision."""
    (tmp_path / "page.html").write_text("<title>WebGPU</title>")
    chromium = browser.Browser(*WEBGPU)
    try:
        chromium.open((tmp_path / "page.html").as_uri())
        chromium.wait("document.title === 'WebGPU' && !!navigator.gpu")
        wrong = SHADER.replace("&q, &w", "&q, &N")
        told = chromium.run(f"{RUNNER}({json.dumps(text('wgsl') + wrong)}, 4)")
        assert "N" in told[0]
        rows = chromium.run(f"{RUNNER}({json.dumps(text('wgsl') + SHADER)}, {4 * (SIZE + 9)})")
    finally:
        chromium.close()
    assert max(errors(np.reshape(rows[:SIZE], (len(BODIES), ROWS + 1, 7)))) < 1e-3
    first, last, inverse = np.reshape(rows[SIZE:], (3, 3))
    assert abs(np.linalg.norm(last) / np.linalg.norm(first) - 1) < 4 * 2**-23
    assert abs(last @ (inverse * last) / (first @ (inverse * first)) - 1) < 16 * 2**-23
    assert np.abs(last - first).max() > 0.1 * np.linalg.norm(first)


TOP = kr.LagrangeTop(p=(0, 0.6, 0.8), alpha=0.5)
STEPPED: dict[str, tuple[Any, Any, dict[str, Any], str]] = {
    "veselov": (kr.EulerTop(J=(1.0, 2.0, 3.5)), {"M": (0.3, 0.5, 1.1)}, {"method": "veselov", "order": 4}, "I dt"),
    "baecklund": (TOP, {"m": (0.1, 0.2, 1.5), "a": (0.6, 0, 0.8)}, {"method": "baecklund", "order": 4}, ""),
}


@pytest.mark.parametrize("case", STEPPED)
def test_a_method_of_stages_has_the_bits_of_c_in_rust(case: str, tmp_path: Path) -> None:
    """And those of the file in Python to rounding: its products are rounded twice."""
    model, start, asked, arguments = STEPPED[case]
    x0 = model.state(**start)
    texts = {
        language: kr.code(model, x0, dt=0.05, language=language, name="rock", **asked)
        for language in ("c", "rust", "python")
    }
    begins, names = "rock_begin(" in texts["c"], [*start]
    (tmp_path / "rock.h").write_text(texts["c"])
    (tmp_path / "main.c").write_text(f"""#include "rock.h"
#include <stdio.h>
#include <string.h>
int main(void) {{
    rock_constants c;
    static rock_state s;
    rock_prepare(&c{"".join(f", rock_{name}" for name in arguments.split())});
    {" ".join(f"memcpy(s.{name}, rock_start_{name}, sizeof s.{name});" for name in names)}
    {"rock_begin(&c, &s);" * begins}
    rock_advance(&c, &s, 500);
    {" ".join(f'for (int i = 0; i < 3; i++) {{ printf("%.17g ", s.{name}[i]); }}' for name in names)}
    return 0;
}}
""")
    given = "".join(
        f", &rock::default_{name}" if name == "I" else f", rock::default_{name}" for name in arguments.split()
    )
    (tmp_path / "rock.rs").write_text(texts["rust"])
    (tmp_path / "main.rs").write_text(f"""mod rock;
fn main() {{
    let (mut c, mut s) = (rock::Constants::default(), rock::State::default());
    rock::prepare(&mut c{given});
    {" ".join(f"s.{name} = rock::default_start_{name};" for name in names)}
    {"rock::begin(&c, &mut s);" * begins}
    rock::advance(&c, &mut s, 500);
    {" ".join(f'for x in s.{name} {{ print!("{{:e}} ", x); }}' for name in names)}
}}
""")
    by_c = [float(x) for x in output("gcc", tmp_path, "main.c").split()]
    assert [float(x) for x in output("rustc", tmp_path, "main.rs").split()] == by_c
    rock: dict[str, Any] = {}
    exec(texts["python"], rock)
    c, s = rock["Constants"](), rock["State"]()
    rock["prepare"](c, *(rock[f"default_{name}"] for name in arguments.split()))
    for name in names:
        getattr(s, name)[:] = rock[f"default_start_{name}"]
    if begins:
        rock["begin"](c, s)
    rock["advance"](c, s, 500)
    assert np.abs(np.concatenate([getattr(s, name) for name in names]) - by_c).max() < 1e-10
    assert np.abs(np.array(by_c) - np.concatenate([*start.values()])).max() > 0.1


KERNEL = """#include "rock.cuh"
extern "C" __global__ void spin(const rock_constants *c, rock_state *s) { rock_step(c, s + threadIdx.x); }
"""


def test_nvcc_makes_machine_code_and_fuses_nothing_else(tmp_path: Path) -> None:
    (tmp_path / "rock.cuh").write_text(text("cuda"))
    (tmp_path / "main.cu").write_text(KERNEL)
    words = ["nvcc", "-std=c++17", "-arch=sm_90", "main.cu"]
    run(tmp_path, [*words, "--fmad=false", "-cubin", "-o", "main.cubin"])
    assert (tmp_path / "main.cubin").read_bytes()[:4] == b"\x7fELF"
    for flags, fused in ((["--fmad=false"], False), ([], True)):
        run(tmp_path, [*words, *flags, "-ptx", "-o", "main.ptx"])
        operations = re.findall(r"(?:add|mul|sub)[.\w]*f64", (tmp_path / "main.ptx").read_text())
        assert len(operations) > 200
        assert any(x in ("add.f64", "mul.f64", "sub.f64") for x in operations) == fused
