"""kr.code: the file of a step, compiled or run by what reads it, against the kernel."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import kreisel as kr
from support import EXAMPLES, configuration

STEPS, DT = 2000, 0.05
TOP = kr.LagrangeTop(p=(0, 0.6, 0.8), alpha=0.5)
TOP_START = TOP.state(m=(0.1, 0.2, 1.5), a=(0.6, 0, 0.8))
BODY = kr.EulerTop(J=(1.0, 2.0, 3.5))
CLEBSCH = kr.Clebsch(b=(1.0, 2.0, 3.5))
OUTER = kr.QuadraticPotential(J=(1.0, 2.0, 2.5))
LIMITED = kr.perturbed(BODY, torque=lambda M: 0.1 * np.where(M[0] < 0.2, M, 0) - np.clip(M, -0.1, 0.2))
CASES: dict[str, tuple[Any, dict[str, Any]]] = {
    "suris 1": ((TOP, TOP_START), {"method": "suris", "order": 1}),
    "baecklund 4, orientation": ((TOP, TOP_START), {"method": "baecklund", "order": 4, "orientation": (1, 0, 0, 0)}),
    "veselov 4": ((BODY, BODY.state(M=(0.3, 0.5, 1.1))), {"method": "veselov", "order": 4}),
    "suris 2, Clebsch": ((CLEBSCH, CLEBSCH.state(M=(0.3, 0.5, 1.1), P=(0.6, 0, 0.8))), {"method": "suris", "order": 2}),
    "a symmetric matrix": (
        (OUTER, OUTER.state(M=(0.3, 0.5, 1.1), P=[[0.5, 0.1, 0.0], [0.1, 0.2, -0.3], [0.0, -0.3, 0.9]])),
        {"method": "veselov", "order": 2},
    ),
    "a motor with limits": ((LIMITED, LIMITED.state(M=(0.3, 0.5, 1.1))), {"method": "splitting", "order": 4}),
    "variational, unprojected": ((TOP, TOP_START), {"method": "variational", "order": 2, "project": False}),
}


def text_and_run(case: str, language: str) -> tuple[str, Any]:
    (model, start), asked = CASES[case]
    name = model.system.name.replace("-", "_")
    text = kr.code(model, start, dt=DT, language=language, name=name, **asked)
    return text, kr.simulate(model, start, dt=DT, steps=STEPS, every=STEPS, **asked)


def state(run: Any, row: int = -1) -> list[float]:
    letters = [n for n in run.data_vars if run[n].attrs["kind"] in ("state", "orientation")]
    values = [run[n].values[row] for n in letters]
    return [float(v) for x in values for v in (x if x.ndim == 1 else x[np.triu_indices(len(x))])]


COMPILERS = [name for name in ("gcc", "clang") if shutil.which(name)] or ["gcc"]


def by_c(folder: Path, text: str, name: str, calls: str, compiler: str = "gcc") -> list[float]:
    """What a C program prints that makes these calls with a `body`."""
    (folder / f"{name}.h").write_text(text)
    program = f"""#include "{name}.h"
#include <stdio.h>
int main(void) {{
    static {name} body;
    static double out[sizeof({name}_START) / sizeof(double) + 100];
    {name}_begin(&body, {name}_START);
    {calls}
    {name}_observe(&body, out);
    for (int i = 0; i < (int)(sizeof({name}_START) / sizeof(double)); i++) printf("%.17g\\n", out[i]);
    return 0;
}}
"""
    (folder / "main.c").write_text(program)
    flags = ["-std=c99", "-O2", "-ffp-contract=off", "-Wall", "-Wextra", "-Werror"]
    subprocess.run([compiler, *flags, "main.c", "-o", "main", "-lm"], cwd=folder, check=True, timeout=120)
    out = subprocess.run(["./main"], cwd=folder, check=True, capture_output=True, text=True, timeout=120).stdout
    return [float(word) for word in out.split()]


@pytest.mark.parametrize("compiler", COMPILERS)
@pytest.mark.parametrize("case", CASES)
def test_c_has_the_bits_of_the_kernel(case: str, compiler: str, tmp_path: Path) -> None:
    text, run = text_and_run(case, "c")
    name = run.attrs["system"].replace("-", "_")
    assert by_c(tmp_path, text, name, f"{name}_advance(&body, {STEPS});", compiler) == state(run)


def test_a_product_that_is_fused_elsewhere_has_other_bits(tmp_path: Path) -> None:
    """The comparison of bits is one that can fail."""
    text, run = text_and_run("suris 1", "c")
    head, mark, body = text.partition("lagrange_top_step(")
    apart = re.sub(r"fma\(([^(),]+), ([^(),]+), ([^(),]+)\)", r"(\1 * \2 + \3)", body)
    assert apart != body
    assert by_c(tmp_path, head + mark + apart, "lagrange_top", f"lagrange_top_advance(&body, {STEPS});") != state(run)


@pytest.mark.parametrize("case", ["baecklund 4, orientation", "veselov 4", "suris 2, Clebsch"])
def test_a_step_back_undoes_a_step(case: str, tmp_path: Path) -> None:
    text, run = text_and_run(case, "c")
    name = run.attrs["system"].replace("-", "_")
    calls = f"{name}_advance(&body, 50); {name}_back(&body, 50);"
    again = by_c(tmp_path, text, name, calls)
    assert np.abs(np.array(again) - state(run, 0)).max() < 1e-12
    there = by_c(tmp_path, text, name, f"{name}_advance(&body, 50); {name}_back(&body, 49);")
    assert np.abs(np.array(there) - state(run, 0)).max() > 1e-3


def test_a_free_body_moves_as_its_closed_form_and_may_be_kicked(tmp_path: Path) -> None:
    start = BODY.state(M=(0.3, 0.5, 1.1))
    text = kr.code(BODY, start, dt=DT, method="exact", orientation=(1, 0, 0, 0), name="euler_top")
    got = by_c(tmp_path, text, "euler_top", "euler_top_advance(&body, 400);")
    later = kr.at(BODY, start, [400 * DT], orientation=(1, 0, 0, 0))
    wanted = np.concatenate([later.M.values[0], later.g.values[0]])
    apart = np.array(got) - wanted
    assert np.abs(apart).max() < 5e-14  # steps and a jump: not the same bits; 2e-15 where docs/code.md was measured
    kick = "double x[7]; euler_top_observe(&body, out); for (int i = 0; i < 7; i++) x[i] = out[i];"
    calls = (
        f"euler_top_advance(&body, 400); {kick} x[2] += 0.5; euler_top_begin(&body, x); euler_top_advance(&body, 100);"
    )
    kicked = by_c(tmp_path, text, "euler_top", calls)
    M = later.M.values[0] + np.array([0, 0, 0.5])
    final = kr.at(BODY, BODY.state(M=M), [100 * DT], orientation=later.g.values[0])
    assert np.abs(np.array(kicked[:3]) - final.M.values[0]).max() < 1e-12


TWO = """#include "one.h"
#include "two.h"
#include <stdio.h>
int main(void) {{
    static {0} one;
    static {1} two;
    double out[100];
    {0}_begin(&one, {0}_START);
    {1}_begin(&two, {1}_START);
    {0}_advance(&one, 200);
    {1}_advance(&two, 200);
    {0}_observe(&one, out);
    printf("%.17g %.17g %.17g ", out[0], out[1], out[2]);
    {1}_observe(&two, out);
    printf("%.17g %.17g %.17g ", out[0], out[1], out[2]);
    return 0;
}}
"""


def test_one_program_has_two_bodies_of_one_system(tmp_path: Path) -> None:
    flags = ["-std=c99", "-O2", "-ffp-contract=off", "-Wall", "-Wextra", "-Werror"]
    words, wanted = [], []
    for file, body in (("one", BODY), ("two", kr.EulerTop(J=(1.0, 2.0, 3.0)))):
        start = body.state(M=(0.3, 0.5, 1.1))
        text = kr.code(body, start, dt=DT, method="veselov", order=4)
        words += re.findall(r"^} (\w+);", text, re.MULTILINE)
        wanted += state(kr.simulate(body, start, dt=DT, steps=200, every=200, method="veselov", order=4))
        (tmp_path / f"{file}.h").write_text(text)
    (tmp_path / "main.c").write_text(TWO.format(*words))
    subprocess.run(["gcc", *flags, "main.c", "-o", "main", "-lm"], cwd=tmp_path, check=True, timeout=120)
    out = subprocess.run(["./main"], cwd=tmp_path, check=True, capture_output=True, text=True, timeout=120).stdout
    assert [float(word) for word in out.split()] == wanted
    assert wanted[:3] != wanted[3:]
    for file, word in zip(("one", "two"), words, strict=True):  # a name for both: said, and not dropped
        (tmp_path / f"{file}.h").write_text((tmp_path / f"{file}.h").read_text().replace(word, "top"))
    (tmp_path / "main.c").write_text(TWO.format("top", "top"))
    done = subprocess.run(["gcc", *flags, "main.c"], cwd=tmp_path, capture_output=True, text=True, timeout=120)
    assert done.returncode != 0
    assert "two bodies are called top" in done.stderr


def test_names_differ_by_content_unless_given() -> None:
    asked: dict[str, Any] = {"dt": DT, "method": "veselov", "order": 4}
    other = kr.EulerTop(J=(1.0, 2.0, 3.0))
    for language, form in (("c", r"^} (\w+);"), ("js", r'"\./(\w+)\.mjs"'), ("julia", r"^module (\w+)")):
        texts = [
            kr.code(body, body.state(M=M), language=language, **asked | changed)
            for body, M, changed in (
                (BODY, (0.3, 0.5, 1.1), {}),
                (BODY, (0.3, 0.5, 1.1), {}),
                (other, (0.3, 0.5, 1.1), {}),
                (BODY, (0.3, 0.5, 1.0), {}),
                (BODY, (0.3, 0.5, 1.1), {"dt": 0.1}),
                (BODY, (0.3, 0.5, 1.1), {"order": 2}),
                (BODY, (0.3, 0.5, 1.1), {"name": "rock_1"}),
            )
        ]
        names = [re.findall(form, text, re.MULTILINE)[0] for text in texts]
        assert texts[0] == texts[1]
        assert len(set(names)) == 6
        assert names[-1] == ("Rock1" if language == "julia" else "rock_1")


@pytest.mark.parametrize("case", CASES)
def test_javascript_differs_by_rounding(case: str, tmp_path: Path) -> None:
    """A step is within 4 units in the last place of the state's scale; 2000 steps apart by rounding alone."""
    node = shutil.which("node")
    if node is None:
        pytest.skip("no Node")
    text, run = text_and_run(case, "js")
    (model, start), asked = CASES[case]
    one = kr.simulate(model, start, dt=DT, steps=1, **asked)
    calls = "const b = new Body(); b.advance(1); const one = Array.from(b.observe());"
    calls += f"b.begin(START); b.advance({STEPS}); console.log(JSON.stringify([one, Array.from(b.observe())]));"
    (tmp_path / "main.mjs").write_text(text + calls)
    out = subprocess.run([node, "main.mjs"], cwd=tmp_path, check=True, capture_output=True, text=True, timeout=120)
    first, last = (np.array(values) for values in json.loads(out.stdout))
    wanted = np.array(state(one))
    ulp = np.spacing(np.abs(wanted).max())
    assert np.abs(first[: len(wanted)] - wanted).max() <= 4 * ulp
    assert np.abs(last[: len(wanted)] - state(run)).max() < 1e-10


# -- Julia, which is not installed: the grammar, and the text read as what it says ------------------


def julia_errors(text: str) -> list[int]:
    tree_sitter, grammar = pytest.importorskip("tree_sitter"), pytest.importorskip("tree_sitter_julia")
    tree = tree_sitter.Parser(tree_sitter.Language(grammar.language())).parse(text.encode())
    found, todo = [], [tree.root_node]
    while todo:
        node = todo.pop()
        todo += node.children
        found += [node.start_point[0]] if node.type == "ERROR" or node.is_missing else []
    return found


class FromOne:
    """An array whose first entry has the index 1."""

    def __init__(self, values: Any):
        self.values = values

    def __getitem__(self, place: Any) -> Any:
        if isinstance(place, tuple):
            return self.values[place[0] - 1][place[1] - 1]
        if place < 1:
            raise IndexError(place)
        return self.values[place - 1]

    def __setitem__(self, place: int, value: float) -> None:
        self.values[place - 1] = value


def fma(x: float, y: float, z: float) -> float:
    return float(Fraction(x) * Fraction(y) + Fraction(z)) or x * y + z


def chosen(words: str) -> str:
    """(x ? y : z), which are not nested, as (y if x else z)."""
    while " ? " in words:
        middle = start = words.index(" ? ")
        depth = 0
        while words[start] != "(" or depth:
            depth += (words[start] == ")") - (words[start] == "(")
            start -= 1
        end, depth = middle, 0
        while words[end] != ")" or depth:
            depth += (words[end] == "(") - (words[end] == ")")
            end += 1
        yes, no = words[middle + 3 : end].split(" : ")
        words = f"{words[: start + 1]}{yes} if {words[start + 1 : middle]} else {no}{words[end:]}"
    return words


def read_julia(text: str) -> dict[str, Any]:
    """The functions and tables of the part of Julia that files are written in, as Python."""
    lines, depth = [], 0
    for line in re.sub(r",\n +", ", ", text).split("module ", 1)[1].splitlines()[1:]:
        words = line.strip().partition("#")[0].strip()
        if re.match(r"(mutable )?struct |function (Body|begin|project|advance|back|observe)[!(]", words):
            depth = -1
        if line == "end" and depth < 0:
            depth = 0
            continue
        if depth < 0 or not words or words.startswith(("export", "Base.@", "Body()")):
            continue
        if table := re.match(r"const (\w+) = (?:Float64|Int)?\[(.*)\]$", words):
            rows = [[float(v) for v in re.split(r"[, ]+", row)] for row in table[2].split("; ")]
            value = rows if ", " not in table[2] and " " in table[2] else rows[0]
            lines.append(f"{table[1]} = FromOne({value})")
            continue
        if short := re.match(r"(kreisel_\w+)\((.*?)\) = (.*)$", words):
            value = re.sub(r"^(.+?) \? (.+) : (.+?)$", r"\2 if \1 else \3", short[3])
            lines += [] if "nothing" in value else [f"{short[1]} = lambda {short[2]}: {value}"]
            continue
        if words == "end":
            depth -= 1
            continue
        words = re.sub(r"(\w)!\(", r"\1_(", words)
        words = chosen(words)
        words = re.sub(r"^for (\w+) in (.+):-1:\((.+) \+ 1\)$", r"for \1 in range(int(\2), int(\3), -1):", words)
        words = re.sub(r"^for (\w+) in (.+):\((.+) - 1\)$", r"for \1 in range(int(\2), int(\3)):", words)
        words = re.sub(r"^function (.*)$", r"def \1:", words)
        words = re.sub(r"^(while|if) (.*)$", r"\1 \2:", words)
        words = "else:" if words == "else" else words
        lines.append("    " * (depth - (words == "else:")) + words)
        depth += words.endswith(":") and words != "else:"
    known: dict[str, Any] = {"FromOne": FromOne, "fma": fma, "sqrt": lambda x: float(np.sqrt(x))}
    for put in ("kreisel_put", "kreisel_set_number"):
        known[put] = lambda array, i, value: array.__setitem__(i + 1, value)
    known["kreisel_set_entry"] = lambda array, i, w, value: array.__setitem__(i + 1, value)
    known["kreisel_get"] = lambda array, i: array[i + 1]
    exec("\n".join(lines), known)
    return known


@pytest.mark.parametrize("case", ["suris 1", "baecklund 4, orientation"])
def test_julia_is_well_formed_and_says_the_same_steps(case: str) -> None:
    (model, start), asked = CASES[case]
    text = kr.code(model, start, dt=DT, language="julia", **asked)
    assert julia_errors(text) == []
    assert julia_errors(text.replace("\nend\n", "\n", 1)) != []
    known = read_julia(text)
    run = kr.simulate(model, start, dt=DT, steps=3, every=3, **asked)
    size = len(state(run))
    z, out = FromOne([0.0] * size), FromOne([0.0] * 100)
    known["open_state_"](known["START"], z)
    for _ in range(3):
        known["step_"](z)
    known["outputs_"](z, out)
    assert out.values[:size] == state(run)
    project(known, z, 1)
    there = [*z.values]
    z[1] += 1e-12  # off the invariants, which the projection undoes but for what is along the orbit
    project(known, z, 0)
    assert 0 < abs(z[1] - there[0]) < 0.99e-12


def project(known: dict[str, Any], z: FromOne, begin: int) -> None:
    numbers = known.setdefault("memory", [FromOne([0.0] * size) for size in (400, 100, 1)])
    known["begin_projection_0_" if begin else "project_0_"](z, *numbers)


# -- the examples ------------------------------------------------------------------------------------


def example(folder: Path, language: str, suffix: str) -> Path:
    words = ("gyroscope.toml", "--method", "exact", "--language", language, "--name", "euler_top")
    text = command(*words, folder=EXAMPLES / "code")
    assert text.returncode == 0, text.stderr
    (folder / f"euler_top{suffix}").write_text(text.stdout)
    return Path(shutil.copy(EXAMPLES / "code" / f"gyroscope{'.c' if language == 'c' else suffix}", folder))


def energies(out: str) -> list[float]:
    return [abs(float(word)) for word in re.findall(r"energy changed by (\S+)", out)]


def test_the_game_in_c_does_not_turn_over(tmp_path: Path) -> None:
    example(tmp_path, "c", ".h")
    flags = ["-std=c99", "-O2", "-ffp-contract=off", "-Wall", "-Wextra", "-Werror"]
    subprocess.run(["gcc", *flags, "gyroscope.c", "-o", "gyroscope", "-lm"], cwd=tmp_path, check=True, timeout=120)
    out = subprocess.run(
        ["./gyroscope", "200000"], cwd=tmp_path, check=True, capture_output=True, text=True, timeout=300
    )
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


def test_the_game_in_julia_is_well_formed() -> None:
    assert julia_errors((EXAMPLES / "code" / "gyroscope.jl").read_text()) == []


# -- the command line, and what cannot be -----------------------------------------------------------


def command(*words: str, folder: Path | None = None) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "kreisel", "code", *words], cwd=folder, capture_output=True, text=True, timeout=300
    )


def test_the_command_prints_a_file(tmp_path: Path) -> None:
    (tmp_path / "run.toml").write_text(
        configuration('method = "suris"\norder = 1\ndt = 0.05\nsteps = 10', 'path = "x.zarr"')
    )
    by_file = command("run.toml", folder=tmp_path)
    assert by_file.returncode == 0, by_file.stderr
    top = kr.LagrangeTop(p=(0, 0, 1))
    start = top.state(m=(0.1, 0.2, 1.5), a=(0.6, 0, 0.8))
    assert by_file.stdout == kr.code(top, start, dt=0.05, method="suris", order=1)
    by_name = command("lagrange-top", "--method", "suris", "--order", "1", "--dt", "0.05", "--no-orientation")
    assert by_name.stdout == by_file.stdout


@pytest.mark.parametrize(
    ("words", "part"),
    [
        (("lagrange-top", "--language", "fortran"), "expected one of c, js, julia, got 'fortran'"),
        (("lagrange-top", "--method", "dop853"), "a method that makes steps"),
        (("euler-top", "--dt", "50"), "Use a smaller dt"),
        (("nobody",), "No system is called 'nobody'"),
        (("absent.toml",), "There is no file absent.toml"),
        (("euler-top", "--set", "J=1,2"), "J"),
        (("euler-top", "--name", "2nd"), "a letter first, such as wheel_1, got '2nd'"),
        (("euler-top", "--name", "double"), "one that c and the file do not have already"),
        (("euler-top", "--name", "body", "--language", "julia"), "one that julia and the file do not have already"),
    ],
)
def test_what_cannot_be_is_said(words: tuple[str, ...], part: str, tmp_path: Path) -> None:
    done = command(*words, folder=tmp_path)
    assert done.returncode == 2
    assert "Traceback" not in done.stderr
    assert part in done.stderr


def test_ensembles_and_long_formulas_are_refused() -> None:
    starts = TOP.state(m=[(0.1, 0.2, 1.5), (0.1, 0.3, 1.0)], a=[(0.6, 0, 0.8), (0, 0, 1)])
    with pytest.raises(kr.InputError, match="an ensemble"):
        kr.code(TOP, starts, dt=0.1, method="suris")
    wide = kr.LagrangeTop(p=np.eye(12)[-1])
    with pytest.raises(kr.InputError, match="n = 12"):
        kr.code(wide, wide.state(m=np.zeros((12, 12)), a=np.eye(12)[0]), dt=0.1, method="suris")
