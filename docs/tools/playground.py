"""The playground: one page, without a server, whose tops are stepped by what `kr.code` writes in JavaScript."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np

import kreisel as kr
from kreisel import algebra
from kreisel.graph.recording import recorded_function
from kreisel.languages.dialects import JAVASCRIPT
from kreisel.languages.writer import Writer
from kreisel.record.calling import call
from kreisel.record.model import Model

TOP = kr.LagrangeTop(p=(0.0, 0.0, 1.25), alpha=0.75)  # numbers other than 0 and 1, which would be folded into the code
BODY = kr.EulerTop(J=(1.25, 2.25, 3.25))
SYSTEMS = {
    "top": (TOP, TOP.state(m=(0.1, 0.2, 1.5), a=(0.6, 0, 0.8))),
    "body": (BODY, BODY.state(M=(0.03, 2.0, 0.04))),
}


BODY_OF = """
const START = {start}, CONSTANTS = {constants}, NAMES = {names};
class Body {{
  constructor(x = START) {{
    this.c = new Constants(); this.s = new State();
    {prepare}
    {set}
  }}
  advance(steps) {{ advance(this.c, this.s, steps); }}
  observe(out = []) {{ {observe} return out; }}
}}"""


def module(name: str, text: str, flow: str) -> str:
    """A module as one object, whose bodies read their constants in CONSTANTS, as the flow does."""
    body, model, state = text.replace("export ", ""), *SYSTEMS[name]
    constants = [float(v) for value in model.constants.values() for v in np.ravel(value)] + [0.05]
    start = [float(v) for letter in model.system.space.letters for v in state.axial[letter]]
    if name == "top":
        (names,) = re.findall(r"^Outputs: (.*?)\.$", text.replace(",\n", ", "), re.MULTILINE | re.DOTALL)
        parts = {
            "names": [*(f"{letter}[{i}]" for letter in "ma" for i in range(3)), *names.split(", ")],
            "prepare": "prepare(this.c, CONSTANTS.slice(0, 3), CONSTANTS[3], CONSTANTS[4]);",
            "set": "this.s.m.set(x.slice(0, 3)); this.s.a.set(x.slice(3));",
            "observe": "const e = []; observe(this.c, this.s, e); "
            "[...this.s.m, ...this.s.a, ...e].forEach((v, i) => { out[i] = v; });",
        }
    else:
        parts = {
            "names": ["M[0]", "M[1]", "M[2]", "energy"],
            "prepare": "prepare(this.c, [1, 2, 0].map((k) => CONSTANTS[k] + CONSTANTS[(k + 1) % 3]), CONSTANTS[12]);",
            "set": "this.s.M.set(x); this.s.g[0] = 1;",
            "observe": "out[3] = energy(this.c, this.s); this.s.M.forEach((v, i) => { out[i] = v; });",
        }
    kept = BODY_OF.format(start=start, constants=constants, **parts)
    return f"(() => {{\n{body}\n{kept}\n{flow}\nreturn {{ Body, START, CONSTANTS, NAMES, flow }};\n}})()"


def flow_of(model: Model) -> str:
    """The right-hand side of a system as a function of JavaScript, for a Runge-Kutta method beside."""

    def rates(**x: Any) -> Any:
        own = tuple(algebra.hat(x[n]) if kind == "skew" else x[n] for n, kind in model.system.space.components)
        found = call(model.system.flow, own, {n: x[n] for n in model.constants})
        flat = [
            algebra.axial(v) if kind == "skew" else v for v, kind in zip(found, model.system.space.kinds, strict=True)
        ]
        return np.concatenate(flat)

    inputs = {letter: (3,) for letter in model.system.space.letters}
    constants = {name: np.shape(value) for name, value in model.constants.items()}
    graph, outputs, _ = recorded_function(rates, inputs, constants)
    writer = Writer(JAVASCRIPT, lambda letter, i: f"{'z' if letter == 'z' else 'CONSTANTS'}[{i}]")
    for i, value in enumerate(writer.values(graph, outputs)):
        writer.assign(f"out[{i}]", value)
    return writer.function("flow", {"z": ("array", 3), "out": ("out", 3)}, {}).removeprefix("export ")


def write(docs: Path) -> None:
    """generated/extra/live/playground.html."""
    systems = {
        name: module(name, kr.code(model, state, language="js", method="exact"), flow_of(model))
        for name, (model, state) in SYSTEMS.items()
    }
    page = (docs / "static" / "playground.html").read_text(encoding="utf-8")
    for name, text in systems.items():
        page = page.replace(f"/*@{name}@*/", text)
    target = docs / "generated" / "extra" / "live" / "playground.html"
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_text(page, encoding="utf-8")
