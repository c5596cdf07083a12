"""kr.code: one file of C, JavaScript or Julia with a body's step, printed from the record that kernels come from."""

from __future__ import annotations

import hashlib
import importlib.metadata
import re
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from kreisel.errors import InputError, explained, hint, shown
from kreisel.graph.invariants import Program
from kreisel.graph.project import FLAT, gain_of
from kreisel.kernels.printing import Line
from kreisel.kernels.projection.corrections import EPS, TAU
from kreisel.kernels.projection.text import block_arrays, block_sizes, projection_block
from kreisel.kernels.recording import Recording
from kreisel.languages.contents import Contents, contents
from kreisel.languages.dialects import LANGUAGES, Dialect, filled
from kreisel.languages.writer import Writer
from kreisel.method import find
from kreisel.runs.planning import make_plan

if TYPE_CHECKING:
    from kreisel.record.model import Model, OrientationLike, StateLike
    from kreisel.runs.plan import Plan

OF_PROGRAM = ("SIZES", "OPS", "RUNS", "OUTS", "ENDS", "CONES", "COLUMNS", "LITERALS")
LICENCE = "BSD-3-Clause, as Kreisel; made by `kreisel code`, Kreisel {}."
PIECE = re.compile(r"def (\w+)\((.*)\):\n")
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
                  the others any state may be given in the file's own language
    name          of the body: what names in C begin with, the module in Julia; letters, digits and _.  By default that
                  of the system with eight digits of the content, so that the files of two bodies go into one program

    The file has the step, the step back where it is known, Casimirs and integrals, the projection onto what the method
    conserves, the orientation if one is given, and the equations with their source.  In C the bits of the step are
    those of the kernel; JavaScript has no fused multiply-add and differs by rounding.  Raises `InputError`.
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
    lines = [
        dialect.part(
            "call",
            tables=", ".join(_own(dialect, f"{table}_{k}") for table in OF_PROGRAM),
            targets=arrays[k][0],
            worst=arrays[k][1],
        )
        for k in range(count)
    ]
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
        "room": max(program.rows for program in programs),
    }


def _head(what: Contents) -> list[str]:
    """What the comment at the top of a file says."""
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
        "Skew matrices are axial vectors for n = 3, else the entries above the diagonal, row by row; g is a unit",
        "quaternion (w, x, y, z), body to space, or a matrix.",
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
    lines, new = what.opened
    out = [
        "\n".join(tables),
        _straight(dialect, "open_state", lines, new, "x", "z", what.constants),
        _step(dialect, "step", "", what.step, what.stages),
    ]
    if what.back is not None:
        out.append("\n".join(_tables(dialect, "BACK_", what.back, what.constants_back, what.stages_back)))
        out.append(_step(dialect, "step_back", "BACK_", what.back, what.stages_back))
    seen = what.observed
    out.append(_straight(dialect, "outputs", seen.lines, seen.values, "z", "out", what.constants))
    if what.programs:
        out += _projection(dialect, what.programs, len(what.constants))
    return out


def _own(dialect: Dialect, name: str) -> str:
    """The name of a table, where files share names with the files of other bodies."""
    return dialect.mark + name


def _tables(dialect: Dialect, mark: str, record: Recording, constants: Any, stages: Any) -> list[str]:
    out = [dialect.numbers(_own(dialect, f"{mark}CONSTANTS"), constants.tolist())]
    return [*out, dialect.matrix(_own(dialect, f"{mark}STAGES"), stages.tolist())] if stages.size else out


def _straight(
    dialect: Dialect, name: str, lines: list[Line], values: list[str], source: str, target: str, constants: Any
) -> str:
    """A function from an array to another, in straight-line code."""
    used = {n for line in lines for n in line.needs} | {v.strip("(-)") for v in values}
    loads = [
        dialect.once[0].format(n, dialect.entry(source if n[0] == source else _own(dialect, "CONSTANTS"), int(n[1:])))
        for n in sorted(
            (n for n in used if n[0] in (source, "c") and n[1:].isdigit()), key=lambda n: (n[0], int(n[1:]))
        )
    ]
    writer = Writer(dialect)
    body = writer.body("\n".join(line.text for line in lines), 4)
    saves = [f"{dialect.entry(target, j)} = {writer.text(v)}{dialect.end}" for j, v in enumerate(values)]
    inside = [*(f"    {line}" for line in loads), *body, *(f"    {line}" for line in saves)]
    return "\n".join([dialect.part("def map", function=name, source=source, target=target), *inside, dialect.close])


def _step(dialect: Dialect, name: str, mark: str, record: Recording, stages: Any) -> str:
    """The step, in place."""
    state, constants = record.state, record.used("c")
    text = [dialect.starts.format(z, dialect.entry("z", i)) for i, z in enumerate(state)]
    text += [dialect.once[0].format(c, dialect.entry(_own(dialect, f"{mark}CONSTANTS"), int(c[1:]))) for c in constants]
    staged, *rest = [Writer(dialect).body(piece.source(state, 0), 0, state) for piece in record.pieces]
    if stages.size:
        table = _own(dialect, f"{mark}STAGES")
        loads = [
            dialect.once[0].format(s, dialect.part("def stage", table=table, j=int(s[1:]) + dialect.first))
            for s in record.used("s")
        ]
        inside = [f"    {line}" for line in (*loads, *staged)]
        head = [dialect.local[1].format("stage"), dialect.up.format(var="stage", start=0, stop=len(stages))]
        staged = [*head, *inside, dialect.close]
    text += [*staged, *(line for lines in rest for line in lines)]
    text += [f"{dialect.entry('z', i)} = {z}{dialect.end}" for i, z in enumerate(state)]
    return "\n".join([dialect.part("def inplace", function=name), *(f"    {line}" for line in text), dialect.close])


def _projection(dialect: Dialect, programs: Sequence[Program], constants: int) -> list[str]:
    """The tables of the programs, and the function that goes through them."""
    out = []
    for k, program in enumerate(programs):
        names = OF_PROGRAM[1:-1]
        tables = [
            dialect.numbers(_own(dialect, f"{n}_{k}"), np.ravel(a).tolist(), True)
            for n, a in zip(names, block_arrays(program), strict=False)
        ]
        tables.append(dialect.numbers(_own(dialect, f"SIZES_{k}"), block_sizes(program, 1, constants), True))
        out.append("\n".join([*tables, dialect.numbers(_own(dialect, f"LITERALS_{k}"), program.literals.tolist())]))
    text = projection_block("", "", "at * d + i", "at * constants + j", 1)
    constants_text = {
        "TAU": TAU,
        "FLAT": FLAT,
        "GAIN": gain_of(programs),
        "EPS": EPS,
        "HUGE": 1e300,
    }
    if dialect.name == "js":
        text = text.replace("fma(", "exact_fma(")
    for word, value in constants_text.items():
        text = re.sub(rf"\b{word}\b", repr(value), text)
    pieces = PIECE.split(text)[1:]
    for name, parameters, body in zip(pieces[::3], pieces[1::3], pieces[2::3], strict=True):
        body = "\n".join(line[4:] for line in body.splitlines())
        signature = dialect.part(f"def {name}")
        integers = re.findall(r"(?:long|int) (\w+)", LANGUAGES["c"].part(f"def {name}"))
        known = [word.strip() for word in parameters.split(",")]
        out.append("\n".join([signature, *Writer(dialect, integers).body(body, 4, known), dialect.close]))
    return out
