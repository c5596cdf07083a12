"""Rust, C#, GDScript, WGSL and Python: the file of a free body, compiled and run or parsed, graded by a check case."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import browser
import kreisel as kr
from compilers import gdscript_errors, output, run

CASE, DT, ROWS = "tilted-box", 1 / 60, 10
GIVEN = kr.checkcases.case(CASE).given()
TENSOR = [GIVEN["inertia"][i][j] for i, j in ((0, 0), (1, 1), (2, 2), (1, 2), (2, 0), (0, 1))]
RATES, ATTITUDE = [0.1, 0.2, 0.3], [1.0, 0.0, 0.0, 0.0]
STEPS = round(GIVEN["duration"] / DT / ROWS)
T, Q, W = (", ".join(map(repr, values)) for values in (TENSOR, ATTITUDE, RATES))
MAINS = {
    "gcc": f"""#include "rock.h"
#include <stdio.h>
int main(void) {{
    double I[3], axes[4], q[4] = {{{Q}}}, w[3] = {{{W}}};
    const double T[6] = {{{T}}};
    rock_constants c;
    rock_state s;
    rock_principal(T, I, axes);
    if (rock_check(I, {DT!r})) return 1;
    rock_prepare(&c, I, {DT!r});
    rock_set_motion(&c, &s, axes, q, w);
    for (int k = 0; k < {ROWS}; k++) {{
        rock_advance(&c, &s, {STEPS});
        rock_get_motion(&c, &s, axes, q, w);
        for (int i = 0; i < 4; i++) printf("%.17g ", q[i]);
        for (int i = 0; i < 3; i++) printf("%.17g ", w[i]);
    }}
    rock_kick(&s, w);
    printf("%.17g %s", rock_energy(&c, &s), rock_message(rock_check(I, 0.0)));
    return 0;
}}
""",
    "rustc": f"""mod rock;
fn main() {{
    let (mut c, mut s) = (rock::Constants::default(), rock::State::default());
    let (mut moments, mut axes, mut q, mut w) = ([0.0; 3], [0.0; 4], [{Q}], [{W}]);
    rock::principal(&[{T}], &mut moments, &mut axes);
    assert_eq!(rock::check(&moments, {DT!r}), 0);
    rock::prepare(&mut c, &moments, {DT!r});
    rock::set_motion(&c, &mut s, &axes, &q, &w);
    for _ in 0..{ROWS} {{
        rock::advance(&c, &mut s, {STEPS});
        rock::get_motion(&c, &s, &axes, &mut q, &mut w);
        for x in q.iter().chain(&w) {{
            print!("{{:e}} ", x);
        }}
    }}
    rock::kick(&mut s, &w);
    print!("{{:e}} {{}}", rock::energy(&c, &s), rock::message(rock::check(&moments, 0.0)));
}}
""",
    "mcs": f"""public static class Program {{
    static void Print(double x) {{
        System.Console.Write(x.ToString("R", System.Globalization.CultureInfo.InvariantCulture) + " ");
    }}
    public static int Main() {{
        var c = new Rock.Constants();
        var s = new Rock.State();
        double[] I = new double[3], axes = new double[4], T = {{ {T} }}, q = {{ {Q} }}, w = {{ {W} }};
        Rock.principal(T, I, axes);
        if (Rock.check(I, {DT!r}) != 0) return 1;
        Rock.prepare(c, I, {DT!r});
        Rock.set_motion(c, s, axes, q, w);
        for (int k = 0; k < {ROWS}; k++) {{
            Rock.advance(c, s, {STEPS});
            Rock.get_motion(c, s, axes, q, w);
            foreach (var x in q) Print(x);
            foreach (var x in w) Print(x);
        }}
        Rock.kick(s, w);
        Print(Rock.energy(c, s));
        System.Console.Write(Rock.message(Rock.check(I, 0.0)));
        return 0;
    }}
}}
""",
}
LANGUAGE = {"gcc": "c", "rustc": "rust", "mcs": "csharp"}
FILES = {"c": "rock.h", "rust": "rock.rs", "csharp": "rock.cs"}
MAIN = {"gcc": "main.c", "rustc": "main.rs", "mcs": "main.cs"}
DT_MESSAGE = "the time step dt is finite and not 0"


def text(language: str, **asked: Any) -> str:
    return kr.code(kr.physical.FreeBody((1.0, 2.0, 2.5)), language=language, name="rock", **asked)


def printed(compiler: str, folder: Path) -> tuple[np.ndarray, str]:
    """What the program of a compiled language prints: rows of q and w, the energy, and the message for dt = 0."""
    language = LANGUAGE[compiler]
    (folder / FILES[language]).write_text(text(language))
    (folder / MAIN[compiler]).write_text(MAINS[compiler])
    sources = [MAIN[compiler], *([FILES[language]] if compiler == "mcs" else [])]
    *numbers, message = output(compiler, folder, *sources).split(" ", 7 * ROWS + 1)
    return np.array(numbers, float), message


def grade(values: Any) -> kr.checkcases.Grade:
    """The grade of rows of q and w, with the row of the start."""
    rows = np.vstack([[*ATTITUDE, *RATES], np.reshape(values, (-1, 7))])
    times = np.linspace(0, GIVEN["duration"], len(rows))
    return kr.checkcases.case(CASE).grade(times, attitude=rows[:, :4], angular_velocity_space=rows[:, 4:])


@pytest.fixture(scope="module")
def by_c(tmp_path_factory: pytest.TempPathFactory) -> np.ndarray:
    values, message = printed("gcc", tmp_path_factory.mktemp("c"))
    assert message == DT_MESSAGE and grade(values[:-1]).relative < 1e-11
    return values


def test_rust_has_the_bits_of_c(by_c: np.ndarray, tmp_path: Path) -> None:
    values, message = printed("rustc", tmp_path)
    assert values.tolist() == by_c.tolist() and message == DT_MESSAGE


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


def test_csharp_differs_by_rounding(by_c: np.ndarray, tmp_path: Path) -> None:
    values, message = printed("mcs", tmp_path)
    assert np.abs(values / by_c - 1).max() < 1e-10 and message == DT_MESSAGE
    assert grade(values[:-1]).relative < 1e-11


def python_of(source: str) -> dict[str, Any]:
    names: dict[str, Any] = {}
    exec(source, names)
    return names


def moved(rock: dict[str, Any]) -> list[float]:
    """Rows of q and w from a file in Python."""
    c, s, rows = rock["Constants"](), rock["State"](), []
    moments, axes, q, w = [0.0] * 3, [0.0] * 4, [*ATTITUDE], [*RATES]
    rock["principal"](TENSOR, moments, axes)
    assert rock["check"](moments, DT) == 0 and rock["message"](rock["check"](moments, float("nan"))) == DT_MESSAGE
    rock["prepare"](c, moments, DT)
    rock["set_motion"](c, s, axes, q, w)
    for _ in range(ROWS):
        rock["advance"](c, s, STEPS)
        rock["get_motion"](c, s, axes, q, w)
        rows += [*q, *w]
    return rows


def test_python_differs_by_rounding(by_c: np.ndarray) -> None:
    rows = np.array(moved(python_of(text("python"))))
    assert np.abs(rows / by_c[:-1] - 1).max() < 1e-10
    assert grade(rows).relative < 1e-11


def test_a_grade_sees_a_wrong_sign() -> None:
    wrong = text("python").replace("w[1] = ", "w[1] = -")
    assert grade(moved(python_of(wrong))).relative > 0.1


def test_gdscript_is_well_formed_and_says_what_python_says() -> None:
    """Godot is in no package index: the grammar, and the functions read as Python, with the bits of the Python file."""
    source = text("gdscript")
    assert gdscript_errors(source) == []
    assert gdscript_errors(source.replace("dt * dt", "dt * * dt")) != []
    lines = source.split("class_name Rock\n")[1]
    for pattern, by in (
        (r"^static func (\w+)\((.*)\) -> \w+:", r"def \1(\2):"),
        (r"(\w+): (?:float|int|PackedFloat64Array|Constants|State)\b", r"\1"),
        (r"^const (\w+)(?:: Array\[float\])? :?= ", r"\1 = "),
        (r"\bvar (\w+) := ", r"\1 = "),
        (r"^    var (\w+) = ", r"    \1 = "),
        (r"for (\w+) in (\w+):", r"for \1 in range(\2):"),
    ):
        lines = re.sub(pattern, by, lines, flags=re.MULTILINE)
    python = python_of(text("python"))  # has the types
    lines = re.sub(r"^class (\w+):\n(?:    .*\n|\n)+", "", lines, flags=re.MULTILINE)
    rock = {"sqrt": math.sqrt, "absf": abs, "Constants": python["Constants"], "State": python["State"]}
    exec(lines, rock)
    assert moved(rock) == moved(python)


WEBGPU = ("--enable-unsafe-webgpu", "--use-webgpu-adapter=swiftshader")
SHADER = f"""
@group(0) @binding(0) var<storage, read_write> rows: array<f32>;
@compute @workgroup_size(1) fn main() {{
    var c: rock_constants;
    var s: rock_state;
    var I: array<f32, 3>;
    var axes: array<f32, 4>;
    var q = array<f32, 4>({Q});
    var w = array<f32, 3>({W});
    rock_principal(array<f32, 6>({T}), &I, &axes);
    rock_prepare(&c, I, {DT!r});
    rock_set_motion(&c, &s, axes, q, w);
    for (var k = 0; k < {ROWS}; k++) {{
        rock_advance(&c, &s, {STEPS});
        rock_get_motion(&c, &s, axes, &q, &w);
        for (var i = 0; i < 4; i++) {{ rows[7 * k + i] = q[i]; }}
        for (var i = 0; i < 3; i++) {{ rows[7 * k + 4 + i] = w[i]; }}
    }}
    for (var i = 0; i < 3; i++) {{ rows[7 * {ROWS} + i] = s.M[i]; rows[7 * {ROWS} + 6 + i] = c.inverse[i]; }}
    rock_advance(&c, &s, 50000);
    for (var i = 0; i < 3; i++) {{ rows[7 * {ROWS} + 3 + i] = s.M[i]; }}
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
        told = chromium.run(f"{RUNNER}({json.dumps(text('wgsl') + SHADER.replace('&q, &w', '&q, &N'))}, 4)")
        assert "N" in told[0]
        rows = chromium.run(f"{RUNNER}({json.dumps(text('wgsl') + SHADER)}, {4 * (7 * ROWS + 9)})")
    finally:
        chromium.close()
    assert grade(rows[: 7 * ROWS]).relative < 1e-4
    first, last, inverse = np.reshape(rows[7 * ROWS :], (3, 3))
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
    rock = python_of(texts["python"])
    c, s = rock["Constants"](), rock["State"]()
    rock["prepare"](c, *(rock[f"default_{name}"] for name in arguments.split()))
    for name in names:
        getattr(s, name)[:] = rock[f"default_start_{name}"]
    if begins:
        rock["begin"](c, s)
    rock["advance"](c, s, 500)
    assert np.abs(np.concatenate([getattr(s, name) for name in names]) - by_c).max() < 1e-10
    assert np.abs(np.array(by_c) - np.concatenate([*start.values()])).max() > 0.1
