"""The playground: one page, without a server, whose tops are stepped by what `kr.code` writes in JavaScript."""

from __future__ import annotations

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


def module(text: str, flow: str) -> str:
    """A module as one object."""
    body = text.replace("export ", "")
    return f"(() => {{\n{body}\n{flow}\nreturn {{ Body, START, CONSTANTS, NAMES, flow }};\n}})()"


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
    return writer.function("function flow(z, out) {")


def write(docs: Path) -> None:
    """generated/extra/live/playground.html."""
    states = {
        "top": (TOP, TOP.state(m=(0.1, 0.2, 1.5), a=(0.6, 0, 0.8))),
        "body": (BODY, BODY.state(M=(0.03, 2.0, 0.04))),
    }
    systems = {
        name: module(kr.code(model, state, dt=0.05, language="js", method="exact"), flow_of(model))
        for name, (model, state) in states.items()
    }
    page = (docs / "static" / "playground.html").read_text(encoding="utf-8")
    for name, text in systems.items():
        page = page.replace(f"/*@{name}@*/", text)
    target = docs / "generated" / "extra" / "live" / "playground.html"
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_text(page, encoding="utf-8")
