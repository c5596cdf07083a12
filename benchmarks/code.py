"""The step of what `kreisel code` writes against the kernel's, without projections, n = 3, with the orientation.

C by gcc and clang with the flags that the files name, JavaScript by Node; processor time, alternating calls, the best
of fifteen of each; ratios of one run.  The kernel of a free body in closed form is the kernel of a splitting without
torque, of two such steps.
"""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from cases import RESULTS

import kreisel as kr
from kreisel.graph.arranging import arranged
from kreisel.graph.graph import IN, Graph, operands_of
from kreisel.graph.recording import as_operands
from kreisel.languages.source import contents
from kreisel.languages.writer import numbers_of
from kreisel.runs.planning import make_plan

STEPS, CALLS, DT = 1_000_000, 15, 0.05
TURNED: dict[str, Any] = {"orientation": (1, 0, 0, 0)}
TOP = kr.LagrangeTop(p=(0, 0, 1))
SPUN = {"m": (0.1, 0.2, 1.5), "a": (0.6, 0, 0.8)}
BODY = kr.EulerTop(J=(1.0, 2.0, 3.5))
STILL = kr.perturbed(BODY, torque=lambda M: 0 * M)
CLEBSCH = kr.Clebsch(b=(0.2, 0.5, 1.1))
TUMBLING = {"M": (0.3, 0.5, 1.1)}
CASES: dict[str, tuple[Any, dict[str, Any], dict[str, Any]]] = {
    "euler-top, exact": (BODY, TUMBLING, {"method": "exact"}),
    "euler-top, exact, 32 bits": (BODY, TUMBLING, {"method": "exact", "single": True}),
    "euler-top, veselov 2": (BODY, TUMBLING, {"method": "veselov", "order": 2}),
    "euler-top, veselov 2, 32 bits": (BODY, TUMBLING, {"method": "veselov", "order": 2, "single": True}),
    "lagrange-top, exact": (TOP, SPUN, {"method": "exact"}),
    "lagrange-top, suris 1": (TOP, SPUN, {"method": "suris", "order": 1}),
    "lagrange-top, baecklund 8": (TOP, SPUN, {"method": "baecklund", "order": 8}),
    "clebsch, suris 2": (CLEBSCH, {**TUMBLING, "P": (0.6, 0, 0.8)}, {"method": "suris", "order": 2}),
}
C = """#include "rock.h"
#include <stdio.h>
#include <string.h>
#include <time.h>
int main(void) {{
    static rock_constants c;
    static rock_state s;
    struct timespec a, b;
    rock_prepare(&c{arguments});
    {start}
    rock_advance(&c, &s, {steps} / 10);
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &a);
    rock_advance(&c, &s, {steps});
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &b);
    volatile double seen = s.{first}[0];
    printf("%.9g\\n", ((b.tv_sec - a.tv_sec) * 1e9 + (b.tv_nsec - a.tv_nsec)) / {steps}.0 + 0.0 * seen);
    return 0;
}}
"""
JS = """
const c = new Constants(), s = new State();
prepare(c{arguments});
{start}
advance(c, s, {steps} / 10);
const begun = process.cpuUsage().user;
advance(c, s, {steps});
console.log((process.cpuUsage().user - begun) * 1e3 / {steps});
"""
FLAGS = ("-std=gnu99", "-O2", "-march=native", "-ffp-contract=off", "-fno-math-errno")
LATENCY = {"+": 3, "-": 3, "*": 3, "fma": 4, "/": 13, "sqrt": 21}  # cycles of Zen 4  [uops.info]
COMPILERS = {"gcc": ("gcc", *FLAGS, "-fschedule-insns"), "clang": ("clang", *FLAGS)}


def program(text: str, js: bool) -> str:
    """A program that steps the body of a file from its default values."""
    form = r"^export const (\w+)_default = " if js else r"^static const (?:double|float) rock_(\w+?)(?:\[\d+\])? = "
    names = re.findall(form, text, re.MULTILINE)
    fields = [name.removeprefix("start_") for name in names if name.startswith("start_")]
    set_field = "s.{0}.set(start_{0}_default);" if js else "memcpy(s.{0}, rock_start_{0}, sizeof s.{0});"
    start = " ".join(set_field.format(field) for field in fields)
    if re.search(r"\b(rock_)?begin\(", text):
        start += " begin(c, s);" if js else " rock_begin(&c, &s);"
    given = [name for name in names if not name.startswith("start_")]
    arguments = "".join(f", {name}_default" if js else f", rock_{name}" for name in given)
    return (JS if js else C).format(arguments=arguments, start=start, steps=STEPS, first=fields[0])


def chain(name: str) -> int:
    """Cycles from the momentum before a step to the momentum after it, by the operations of a file."""
    model, start, asked = CASES[name]
    asked = dict(asked)
    single = asked.pop("single", False)
    body = contents(make_plan(model, model.state(**start), dt=DT, steps=1, **asked), single=single)
    step = next(f for f in body.functions if f.name in ("step", "stage"))
    graph = Graph()
    c, s = (numbers_of(graph, letter, fields) for letter, fields in (("c", body.constants), ("s", body.state)))
    momentum = f"s.{next(iter(start))}"
    new, outputs = arranged(graph, as_operands(list(np.ravel(step.apply(c=c, s=s)[momentum]))))
    ends: dict[int, int] = {}
    for at in new.needed(outputs):
        operation, *operands = new.nodes[at]
        before = [ends[x.at] for x in operands_of(new.nodes[at]) if x.at in ends]
        if operation == IN and operands[0] == momentum:
            ends[at] = 0
        elif before:
            ends[at] = max(before) + LATENCY.get(operation, 4)
    return max(ends[x.at] for x in outputs)


def nanoseconds(words: list[str], folder: Path) -> float:
    out = subprocess.run(words, cwd=folder, check=True, capture_output=True, text=True).stdout
    return float(out)


def measured(name: str, folder: Path) -> dict[str, Any]:
    model, start, asked = CASES[name][0], CASES[name][1], dict(CASES[name][2])
    text = kr.code(model, start, dt=DT, name="rock", **TURNED, **asked)
    (folder / "rock.h").write_text(text)
    (folder / "main.c").write_text(program(text, False))
    compilers = [name for name in COMPILERS if shutil.which(name)]
    for compiler in compilers:
        words = [*COMPILERS[compiler], "main.c", "-o", compiler, "-lm"]
        subprocess.run(words, cwd=folder, check=True)
    commands, single = {name: [f"./{name}"] for name in compilers}, asked.pop("single", False)
    if shutil.which("node") and not single:
        text_js = kr.code(model, start, dt=DT, language="js", **TURNED, **asked)
        (folder / "main.mjs").write_text(text_js + program(text_js, True))
        commands["js"] = ["node", "main.mjs"]
    halves = asked["method"] == "exact" and model is BODY
    if halves:
        model, asked = STILL, {"method": "splitting", "order": (2, 2)}
    motion = None
    if halves or asked["method"] != "exact":
        motion = kr.propagator(model, dt=DT * (1 + halves), project=False, orientation=True, **asked)
    state = {**start, "g": TURNED["orientation"]}
    best = dict.fromkeys([*commands, *(["kernel"] if motion else [])], float("inf"))
    for _ in range(CALLS):
        for key, words in commands.items():
            best[key] = min(best[key], nanoseconds(words, folder))
        if motion is not None:
            begun = time.process_time()
            motion.steps(state, STEPS // (1 + halves))
            best["kernel"] = min(best["kernel"], (time.process_time() - begun) / STEPS * 1e9)
    cycles = {"chain": chain(name)} if name.startswith("euler-top") else {}
    return {key: round(ns, 1) for key, ns in best.items()} | {"lines": text.count("\n")} | cycles


if __name__ == "__main__":
    found = {}
    for case in CASES:
        with tempfile.TemporaryDirectory() as scratch:
            found[case] = measured(case, Path(scratch))
        print(case, found[case], flush=True)
    (RESULTS / "code.json").write_text(json.dumps({"commands": COMPILERS, "ns_a_step": found}, indent=1) + "\n")
