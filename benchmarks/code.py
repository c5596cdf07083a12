"""What `kreisel code` writes against the kernel: time of a step of the compiled file over that of the propagator.

One trajectory, projections included, n = 3.  C by gcc -O2 -march=native, JavaScript by Node; calls in turn, the best of
seven of each; ratios of one run.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import tempfile
import time
from pathlib import Path
from typing import Any

from cases import RESULTS

import kreisel as kr

STEPS, CALLS, DT = 2_000_000, 7, 0.05
TOP = kr.LagrangeTop(p=(0, 0, 1))
BODY = kr.EulerTop(J=(1.0, 2.0, 3.5))
CASES: dict[str, tuple[Any, dict[str, Any], dict[str, Any]]] = {
    "lagrange-top, suris 1": (TOP, {"m": (0.1, 0.2, 1.5), "a": (0.6, 0, 0.8)}, {"method": "suris", "order": 1}),
    "lagrange-top, baecklund 2": (TOP, {"m": (0.1, 0.2, 1.5), "a": (0.6, 0, 0.8)}, {"method": "baecklund", "order": 2}),
    "lagrange-top, baecklund 8": (TOP, {"m": (0.1, 0.2, 1.5), "a": (0.6, 0, 0.8)}, {"method": "baecklund", "order": 8}),
    "euler-top, veselov 2": (BODY, {"M": (0.3, 0.5, 1.1)}, {"method": "veselov", "order": 2}),
    "clebsch, suris 2": (
        kr.Clebsch(b=(0.2, 0.5, 1.1)),
        {"M": (0.3, 0.5, 1.1), "P": (0.6, 0, 0.8)},
        {"method": "suris", "order": 2},
    ),
}
C = """#include "{name}.h"
#include <stdio.h>
#include <time.h>
int main(void) {{
    static {name} body;
    struct timespec a, b;
    {name}_begin(&body, {name}_START);
    {name}_advance(&body, {steps} / 10);
    clock_gettime(CLOCK_MONOTONIC, &a);
    {name}_advance(&body, {steps});
    clock_gettime(CLOCK_MONOTONIC, &b);
    volatile double seen = body.z[0];
    printf("%.9g\\n", ((b.tv_sec - a.tv_sec) * 1e9 + (b.tv_nsec - a.tv_nsec)) / {steps}.0 + 0.0 * seen);
    return 0;
}}
"""
JS = """
const body = new Body();
body.advance({steps} / 10);
const begun = performance.now();
body.advance({steps});
console.log((performance.now() - begun) * 1e6 / {steps});
"""
FLAGS = ("-std=gnu99", "-O2", "-march=native", "-ffp-contract=off")


def nanoseconds(words: list[str], folder: Path) -> float:
    out = subprocess.run(words, cwd=folder, check=True, capture_output=True, text=True).stdout
    return float(out)


def measured(name: str, folder: Path) -> dict[str, float]:
    model, start, asked = CASES[name]
    state, word = model.state(**start), model.system.name.replace("-", "_")
    motion = kr.propagator(model, dt=DT, **asked)
    (folder / f"{word}.h").write_text(kr.code(model, state, dt=DT, name=word, **asked))
    (folder / "main.c").write_text(C.format(name=word, steps=STEPS))
    subprocess.run(["gcc", *FLAGS, "main.c", "-o", "main", "-lm"], cwd=folder, check=True)
    (folder / "main.mjs").write_text(kr.code(model, state, dt=DT, language="js", **asked) + JS.format(steps=STEPS))
    best = dict.fromkeys(("kernel", "c", "js"), float("inf"))
    motion.steps(state, STEPS)
    for _ in range(CALLS):
        begun = time.perf_counter()
        motion.steps(state, STEPS)
        best["kernel"] = min(best["kernel"], (time.perf_counter() - begun) / STEPS * 1e9)
        best["c"] = min(best["c"], nanoseconds(["./main"], folder))
        if shutil.which("node"):
            best["js"] = min(best["js"], nanoseconds(["node", "main.mjs"], folder))
    return {key: round(ns, 2) for key, ns in best.items()}


if __name__ == "__main__":
    found = {}
    for case in CASES:
        with tempfile.TemporaryDirectory() as scratch:
            found[case] = measured(case, Path(scratch))
        print(case, found[case], f"c/kernel {found[case]['c'] / found[case]['kernel']:.2f}")
    (RESULTS / "code.json").write_text(json.dumps({"flags": FLAGS, "ns_a_step": found}, indent=1) + "\n")
