"""The machine code of the GPU's kernels, which needs no GPU: registers, and the instructions of a step.

    make gpu-code

LLVM makes PTX, ptxas code for compute capability 9.0, nvdisasm lists it; counted are the arithmetic instructions of
the innermost loop, a step or one stage of it.  A multiprocessor of an H100 or H200 does 64 of them a cycle, for as
many threads, in float64, 128 in float32 [NVIDIA, CUDA C++ Programming Guide, arithmetic instructions]; the bound is for
132 multiprocessors at 1.98 GHz, an H200's largest clock.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import tempfile
from collections import Counter
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from cases import BenchCase, cases, machine, parser, write

from kreisel.graph.recording import flat_constants, flat_stages
from kreisel.kernels.gpu import ARGUMENTS, PRECISIONS, ptx, recorded_for_gpu, steps_of_a_lane
from kreisel.method.scheme import Scheme
from kreisel.runs.planning import make_plan

CAPABILITY = "90"
RATES = {"cuda": 64, "cuda-float32": 128}  # instructions a cycle and multiprocessor
MULTIPROCESSORS, HERTZ = 132, 1.98e9
ARITHMETIC = {"cuda": ("DFMA", "DMUL", "DADD"), "cuda-float32": ("FFMA", "FMUL", "FADD")}
OPCODE = re.compile(r"^\s+/\*[0-9a-f]+\*/\s+(?:@!?U?P[0-9T]+ )?([A-Z][A-Z0-9]+)", re.MULTILINE)
LABEL, BRANCH = re.compile(r"^(\.L_x_\d+):"), re.compile(r"BRA .*`\((\.L_x_\d+)\)")


def tool(name: str) -> str:
    """The path of a program of CUDA: on the path, or in the packages of NVIDIA."""
    package = find_spec("nvidia")
    places = [Path(folder) for folder in (package and package.submodule_search_locations) or ()]
    own = [str(file) for folder in places for file in folder.glob(f"*/bin/{name}")]
    found = shutil.which(name) or next(iter(own), None)
    if found is None:
        raise SystemExit(f"{name} was not found: make gpu-code installs it, and so does CUDA itself")
    return found


def scheme_of(case: BenchCase, method: str, order: int) -> Scheme:
    """The scheme from the first of the case's states."""
    state = case.model.state(**next(iter(case.states.values())))
    return make_plan(case.model, state, dt=0.05, steps=1, every=1, method=method, order=order, orientation=None).scheme


def listing(plan: Scheme, engine: str, capability: str) -> tuple[str, str]:
    """Report of ptxas on a kernel, and its machine code."""
    (constants, columns), (_, stages) = flat_constants(plan, 1), flat_stages(plan, 1)
    body = steps_of_a_lane(recorded_for_gpu(plan, constants, columns, stages), PRECISIONS[engine])
    with tempfile.TemporaryDirectory() as folder:
        text, code = Path(folder, "kernel.ptx"), Path(folder, "kernel.cubin")
        text.write_text(ptx(ARGUMENTS, body, capability))
        said = _run(tool("ptxas"), f"-arch=sm_{capability}", "-v", "-o", str(code), str(text)).stderr
        return said, _run(tool("nvdisasm"), "-c", str(code)).stdout


def _run(*command: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(command, capture_output=True, text=True, check=True, timeout=120)


def innermost(code: str) -> list[Counter[str]]:
    """The instructions of each loop that holds no other."""
    lines = code.splitlines()
    labels = {m[1]: i for i, line in enumerate(lines) if (m := LABEL.match(line))}
    jumps = [(labels.get(m[1], len(lines)), i) for i, line in enumerate(lines) if (m := BRANCH.search(line))]
    back = [(first, last) for first, last in jumps if first < last]
    inner = [(a, b) for a, b in back if not any(a <= c and d <= b and (c, d) != (a, b) for c, d in back)]
    return [Counter(OPCODE.findall("\n".join(lines[a : b + 1]))) for a, b in inner]


def counted(plan: Scheme, engine: str, capability: str = CAPABILITY) -> dict[str, Any]:
    """Figures of a kernel: registers, spilled bytes, instructions of the inner loop, and how often a step passes it."""
    said, code = listing(plan, engine, capability)
    kinds = ARITHMETIC[engine]
    loop = max(innermost(code), key=lambda count: sum(count[k] for k in kinds))
    (registers,) = re.findall(r"Used (\d+) registers", said)
    spilled = sum(map(int, re.findall(r"(\d+) bytes spill", said)))
    found = {k: loop[k] for k in kinds}
    return {"registers": int(registers), "spilled_bytes": spilled, "passes": max(1, plan.stage_count), **found,
            "arithmetic": sum(found.values()), "others": loop.total() - sum(found.values())}  # fmt: skip


def bound(count: dict[str, Any], engine: str, multiprocessors: int = MULTIPROCESSORS, hertz: float = HERTZ) -> float:
    """Steps a second that the arithmetic instructions allow."""
    return multiprocessors * RATES[engine] * hertz / (count["arithmetic"] * count["passes"])


def main() -> None:
    """Compile, print, write the JSON."""
    options = parser(__doc__, "gpu_code").parse_args()
    kernels = [(case, "suris", 1) for case in cases(3, generic=True)]
    kernels += [(case, "baecklund", 8) for case in cases(3, generic=True)]
    kernels += [(case, "suris", 1) for case in cases(4)]
    result: dict[str, Any] = {}
    print(
        f"{'kernel':<38}{'precision':<10}{'registers':>9}{'spilled':>8}{'arithmetic':>11}{'others':>7}{'bound/s':>10}"
    )
    for case, method, order in kernels:
        plan, name = scheme_of(case, method, order), f"{case.name}, n = {case.n}, {method} {order}"
        for engine in RATES:
            count = counted(plan, engine)
            count["steps_per_second"] = float(f"{bound(count, engine):.3g}")
            result[f"{name}, {PRECISIONS[engine]}"] = count
            print(
                f"{name:<38}{PRECISIONS[engine]:<10}{count['registers']:>9}"
                f"{count['spilled_bytes']:>8}{count['passes']:>5} x {count['arithmetic']:<3}{count['others']:>7}"
                f"{count['steps_per_second']:>10.2e}"
            )
    versions = {name: _run(tool(name), "--version").stdout.split("\n")[-3] for name in ("ptxas", "nvdisasm")}
    results = {"machine": machine(), "capability": CAPABILITY, "multiprocessors": MULTIPROCESSORS, "hertz": HERTZ}
    write(results | versions | {"kernels": result}, options.output)


if __name__ == "__main__":
    main()
