"""kr.code: one file of C, JavaScript or Julia with a body's step, printed from the recorded step of the kernels."""

from __future__ import annotations

import hashlib
import importlib.metadata
import re
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from kreisel.errors import InputError, explained, hint, shown
from kreisel.graph.graph import Graph, Operand
from kreisel.graph.invariants import Program, written_out
from kreisel.graph.project import Projection, gain_of, recorded_projection
from kreisel.graph.recording import Piece, Recording
from kreisel.languages.contents import Contents, contents
from kreisel.languages.dialects import LANGUAGES, Dialect, filled
from kreisel.languages.writer import Entries, Integers, Looping, Writer
from kreisel.method import find
from kreisel.record.table import require_none
from kreisel.runs.planning import make_plan

if TYPE_CHECKING:
    from kreisel.record.model import Model, OrientationLike, StateLike
    from kreisel.runs.plan import Plan

LICENCE = "BSD-3-Clause, as Kreisel; made by `kreisel code`, Kreisel {}."
NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*", re.ASCII)


@explained
def code(
    system: Model,
    x0: StateLike,
    *,
    dt: float,
    language: str = "c",
    method: str | None = None,
    order: int | None = None,
    orientation: OrientationLike | None = None,
    project: bool = True,
    name: str | None = None,
) -> str:
    """The text of one file, without dependencies, that steps a body as `kr.simulate` does.

    language      "c" (a C99 header), "js" (an ES module) or "julia" (a module)
    system to project  as in `kr.simulate`; methods that make steps, n <= 10: "suris", "baecklund", "veselov",
                  "variational", "kahan".  With "baecklund" the constants of the step belong to the orbit of x0; with
                  the others any state may be given in the language of the file
    name          of the body: prefix of names in C, the module in Julia; letters, digits and _.  Default: the name of
                  the system with eight digits of the content, so the files of two bodies fit into one program

    The file has the step, the step back if known, Casimirs and integrals, the projection onto the invariants of the
    method, the orientation if one is given, and the equations with their source.  In C the step is bitwise equal to the
    kernel; JavaScript has no fused multiply-add and differs by rounding.  Raises `InputError`.
    """
    if language not in LANGUAGES:
        raise InputError(
            f"language: expected one of {', '.join(LANGUAGES)}, got {shown(language)}."
            f"{hint(language, LANGUAGES) if isinstance(language, str) else ''}"
        )
    asked: dict[str, Any] = {"dt": dt, "steps": 1, "method": method, "order": order, "project": project}
    _require_name(name, LANGUAGES[language])
    return text_of(make_plan(system, x0, orientation=orientation, **asked), language, name)


def _require_name(name: str | None, dialect: Dialect) -> None:
    if name is None:
        return
    if not isinstance(name, str) or not NAME.fullmatch(name):
        raise InputError(f"name: expected letters, digits and _, a letter first, such as wheel_1, got {shown(name)}.")
    if dialect.name_of(name) != name or dialect.name_of(_module(name)) != _module(name) or name.startswith("kreisel"):
        raise InputError(f"name: expected one that {dialect.name} and the file do not have already, got {shown(name)}.")


def _module(name: str) -> str:
    return "".join(word[:1].upper() + word[1:] for word in name.split("_"))


def text_of(plan: Plan, language: str, name: str | None = None) -> str:
    """The text of a plan.  Raises `InputError`."""
    require_none(plan.model, "kr.code")
    if plan.model.system.perturbation is not None and plan.model.system.perturbation.control is not None:
        raise InputError(
            f"code: expected a body without control and `wheels`, got {plan.model.system.name}. Call the law in your "
            "program, between steps of the body with its commands as parameters."
        )
    what, dialect = contents(plan), LANGUAGES[language]
    parts = {
        "head": "\n".join(_head(what)),
        "size": what.plan.first.shape[1],
        "given": len(what.names),
        "outputs": len(what.observed.values),
        "every": what.every,
        "names": ", ".join(f'"{place}"' for place in _places(what)),
        "functions": "\n\n".join(_functions(what, dialect)),
    }
    if what.programs:
        parts |= _sizes(what.programs) | {"calls": _calls(dialect, len(what.programs))}
    names = ["head", "helpers", "functions", "projected" if what.programs else "plain"]
    names += [*(["back"] if what.back is not None else []), "end"]
    template = "".join(dialect.templates.get(name, "@functions@\n\n") for name in names)
    text = filled(filled(template, parts), parts)  # twice: there are words in functions and calls
    digest = hashlib.sha256(text.encode()).hexdigest()[:8]
    name = name or f"{plan.model.system.name.replace('-', '_')}_{digest}"
    licence = LICENCE.format(importlib.metadata.version("kreisel"))
    return filled(text, {"name": name, "module": _module(name), "digest": digest, "licence": licence})


def _calls(dialect: Dialect, count: int) -> str:
    arrays = (("targets", "worst"), ("bound", "spare"))
    lines = [dialect.part("call", k=k, targets=arrays[k][0], worst=arrays[k][1]) for k in range(count)]
    return ("\n" + " " * (8 if dialect.name == "js" else 4)).join(lines)


def _places(what: Contents) -> list[str]:
    """The names of the outputs."""
    sizes = {name: (place.stop - place.start, shape) for name, (place, shape) in what.observed.places.items()}
    return [
        f"{name}[{i}]" if count > 1 or name[-1] == "]" else name
        for name, (count, _) in sizes.items()
        for i in range(count)
    ]


def _sizes(programs: Sequence[Program]) -> dict[str, Any]:
    first, second = programs[0], programs[1] if len(programs) > 1 else None
    return {
        "invariants": len(first.outs),
        "bonds": len(second.outs) if second else 0,
        "room": 1 if written_out(programs) else max(program.rows for program in programs),
    }


def _head(what: Contents) -> list[str]:
    """The comment at the top of a file."""
    plan, system = what.plan, what.plan.model.system
    method = find(plan.scheme.name)
    order = plan.scheme.options.get("order")
    params = ", ".join(f"{k} = {np.asarray(v).tolist()}" for k, v in plan.model.params.items())
    conserved = [n for n, o in plan.outcomes.items() if o.conserved]
    lines = [
        f"{system.title}: {system.equations}",
        f"[{system.source}]",
        "",
        f"Method {method.name}: {method.title}{'' if order is None else f', order {order}'}; dt = {plan.dt!r}.",
        f"It conserves {', '.join(conserved) or 'none of the outputs'}.",
        f"{f'Parameters: {params}.  ' if params else ''}{system.scaling}",
        "",
        f"A state is {', '.join(what.names)}.",
        "Skew matrices are axial vectors for n = 3, else the entries above the diagonal, row by row; symmetric ones",
        "those on and above it; g is a unit quaternion (w, x, y, z), body to space, or a matrix.",
        f"Outputs: {', '.join(_places(what))}.",
    ]
    if plan.scheme.name == "baecklund":
        lines += [
            "",
            "The constants of the step belong to the orbit of START: from another one the step is another map.",
        ]
    if what.back is None:
        lines += ["", "No step back of this method is known here."]
    out: list[str] = []
    for line in lines:
        while len(line) > 110:
            cut = line.rfind(" ", 0, 110)
            cut = cut if cut > 0 else 110
            out.append(line[:cut])
            line = line[cut + 1 :]
        out.append(line)
    return out


def _functions(what: Contents, dialect: Dialect) -> list[str]:
    """The tables and the functions of arrays."""
    tables = [
        dialect.numbers(_own(dialect, "START"), what.start.tolist()),
        *_tables(dialect, "", what.step, what.constants, what.stages),
    ]
    out = [
        "\n".join(tables),
        _straight(dialect, "open_state", *what.opened, "x", "z"),
        _step(dialect, "step", "", what.step, what.stages),
    ]
    if what.back is not None:
        out.append("\n".join(_tables(dialect, "BACK_", what.back, what.constants_back, what.stages_back)))
        out.append(_step(dialect, "step_back", "BACK_", what.back, what.stages_back))
    out.append(_straight(dialect, "outputs", what.observed.graph, what.observed.values, "z", "out"))
    gain = gain_of(what.programs)
    return out + [text for k, program in enumerate(what.programs) for text in _projection(dialect, k, program, gain)]


def _own(dialect: Dialect, name: str) -> str:
    """The name of a table, marked if files share names with the files of other bodies."""
    return dialect.mark + name


def _tables(dialect: Dialect, mark: str, record: Recording, constants: Any, stages: Any) -> list[str]:
    out = [dialect.numbers(_own(dialect, f"{mark}CONSTANTS"), constants.tolist())]
    return [*out, dialect.matrix(_own(dialect, f"{mark}STAGES"), stages.tolist())] if stages.size else out


def _straight(dialect: Dialect, name: str, graph: Graph, values: Sequence[Operand], source: str, target: str) -> str:
    """A function from one array to another, in straight-line code."""

    def place(letter: str, i: int) -> str:
        return dialect.entry(source if letter == source else _own(dialect, "CONSTANTS"), i)

    writer = Writer(dialect, place)
    for j, value in enumerate(writer.values(graph, values)):
        writer.assign(dialect.entry(target, j), value)
    return writer.function(dialect.part("def map", function=name, source=source, target=target))


def _step(dialect: Dialect, name: str, mark: str, record: Recording, stages: Any) -> str:
    """The step, in place."""

    def place(letter: str, i: int) -> str:
        if letter == "z":
            return f"state{i}"
        if letter == "c":
            return dialect.entry(_own(dialect, f"{mark}CONSTANTS"), i)
        return dialect.part("def stage", table=_own(dialect, f"{mark}STAGES"), j=i + dialect.first)

    writer, states = Writer(dialect, place), [f"state{i}" for i in range(record.state)]

    def changed(piece: Piece) -> None:
        for state, value in zip(states, writer.values(piece.graph, piece.outputs), strict=True):
            writer.assign(state, value)

    for i, state in enumerate(states):
        writer.say(dialect.starts.format(state, dialect.entry("z", i)))
    first, *others = record.pieces
    if stages.size:
        writer.say(dialect.local[1].format("stage"))
        with writer.block(dialect.up.format(var="stage", start=0, stop=len(stages))):
            changed(first)
    else:
        changed(first)
    for piece in others:
        changed(piece)
    for i, state in enumerate(states):
        writer.assign(dialect.entry("z", i), state)
    return writer.function(dialect.part("def inplace", function=name))


def _projection(dialect: Dialect, k: int, program: Program, gain: float) -> list[str]:
    """The functions that begin and apply the projection of a program, written out unless it is long."""
    if not written_out([program]):
        return _projection_in_loops(dialect, k, program, gain)
    graph, *results = recorded_projection(program, gain)
    arrays = {"z": "z", "t": "targets", "w": "worst", "c": _own(dialect, "CONSTANTS")}
    out = []
    for name, outputs in zip(("begin_projection", "project"), results, strict=True):
        writer = Writer(dialect, lambda letter, i: dialect.entry(arrays[letter], i), exact=True)
        for (letter, i), value in zip(outputs, writer.values(graph, [*outputs.values()]), strict=True):
            writer.assign(dialect.entry(arrays[letter], i), value)
        out.append(writer.function(dialect.part("def project", function=f"{name}_{k}")))
    return out


def _projection_in_loops(dialect: Dialect, k: int, program: Program, gain: float) -> list[str]:
    """The projection in loops, and its tables."""
    (sizes, *tables), names = program.tables, ("OPS", "RUNS", "OUTS", "ENDS", "CONES", "COLUMNS")
    own = [_own(dialect, f"{name}_{k}") for name in names]
    text = [dialect.numbers(name, table.ravel().tolist(), True) for name, table in zip(own, tables, strict=True)]
    text.append(dialect.numbers(_own(dialect, f"LITERALS_{k}"), program.literals.tolist()))
    out = ["\n".join(text)]
    for name in ("begin_projection", "project"):
        writer = Writer(dialect, lambda letter, i: "", exact=True)
        flow = Looping(writer)
        arrays = ("z", _own(dialect, "CONSTANTS"), "targets", "worst", _own(dialect, f"LITERALS_{k}"), "room")
        *rows, literals, room = (Entries(flow, array) for array in arrays)
        integers = [sizes.tolist(), *(Integers(dialect, table) for table in own)]
        projection = Projection(flow, integers, literals, program.first > 0, gain, room, rows)
        projection.values()
        if name == "project":
            projection.gradients()
            projection.correct()
        else:
            projection.begin()
        out.append(writer.function(dialect.part("def project", function=f"{name}_{k}")))
    return out
