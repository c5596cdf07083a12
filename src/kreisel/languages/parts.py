"""The contents of a file: a body as functions of arrays, which are recorded and written.

A `Body` has parameters (moments, dt), constants that `prepare` computes from them, and a state that `step` changes.
"""

from __future__ import annotations

import hashlib
import re
import textwrap
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from kreisel.graph.graph import IN, Graph
from kreisel.graph.recording import as_operands
from kreisel.languages.dialects import Dialect
from kreisel.languages.writer import WIDTH, Rolled, Writer, bare

Values = Mapping[str, Any]
Arguments = Mapping[str, tuple[str, int]]
HUGE = 1e30
READ, CHANGED = {"c": ("constants", 0), "s": ("state", 0)}, {"c": ("constants", 0), "s": ("changed", 0)}
NEW = {"c": ("new", 0)}


@dataclass(frozen=True)
class Field:
    """A scalar (count 0) or an array: its meaning, default values, how many are of one stage."""

    count: int
    meaning: str = ""
    value: Any = None
    stage: int = 0


@dataclass(frozen=True)
class Function:
    """A function of a file.

    apply      of arguments, constants and state, by keyword -> values by name
    arguments  name -> (kind, count); kinds as in `Dialect.arguments`
    result     "" if it writes `new`, a type or an array; "number", "status"
    """

    name: str
    apply: Callable[..., Any]
    arguments: Arguments
    result: str = ""


@dataclass(frozen=True)
class Body:
    """The contents of a file."""

    head: Sequence[str]
    parameters: Mapping[str, Field]
    constants: Mapping[str, Field]
    state: Mapping[str, Field]
    functions: Sequence[Function]
    messages: Sequence[str] = ()
    start: Mapping[str, Any] = field(default_factory=dict)
    stages: int = 0


def numbers_of(graph: Graph, name: str, fields: Mapping[str, Field], staged: bool = False) -> dict[str, Any]:
    """The fields of a type as inputs of a graph; `staged`: those of one stage."""
    out = {}
    for each, f in fields.items():
        count = f.stage if staged and f.stage else f.count
        out[each] = graph.inputs(f"{name}.{each}", count) if count else graph.input(f"{name}.{each}", 0)
    return out


def text_of(body: Body, function: Function, dialect: Dialect, words: Mapping[str, str]) -> str:
    """A function, written."""
    types = {"constants": body.constants, "new": body.constants, "state": body.state, "changed": body.state}
    graph, given, staged = Rolled(tables=bool(dialect.room)), dict[str, Any](), "k" in function.arguments
    for name, (kind, count) in function.arguments.items():
        if kind in ("constants", "state", "changed"):
            given[name] = numbers_of(graph, name, types[kind], staged)
        elif kind in ("number", "array"):
            given[name] = graph.inputs(name, count) if count else graph.input(name, 0)
    results = function.apply(**given)

    def place(letter: str, i: int) -> str:
        thing, _, name = letter.partition(".")
        kind, count = function.arguments[thing]
        index = str(i + dialect.first)
        if not name:
            return f"{thing}[{index}]" if count else thing
        f = types[kind][name]
        if staged and f.stage:
            index = "k" if f.stage == 1 else f"{f.stage} * k + {index}" if i or dialect.first else f"{f.stage} * k"
        return dialect.members[f.count > 0].format(object=thing, name=name, i=index)

    changed = {name for name, (kind, _) in function.arguments.items() if kind == "changed"}
    writer = Writer(dialect, place, lambda letter: letter.partition(".")[0] in changed)
    if function.result:
        (value,) = writer.values(graph, as_operands([results]))
        number = bare(value) if function.result == "number" else dialect.status.format(bare(value))
        writer.say(dialect.give.format(number))
    else:
        entries = {name: np.ravel(np.asarray(value, dtype=object)) for name, value in results.items()}
        inputs = {name: [graph.node(IN, name, i) for i in range(len(values))] for name, values in entries.items()}
        new = [
            (place(name, i), x)
            for name, values in entries.items()
            for i, x in enumerate(as_operands(list(values)))
            if getattr(x, "key", None) != (inputs[name][i], False)
        ]
        for (target, _), value in zip(new, writer.values(graph, [x for _, x in new]), strict=True):
            writer.assign(target, value)
    unused = [name for name in function.arguments if not re.search(rf"\b{name}\b", "\n".join(writer.lines))]
    writer.lines[:0] = [f"    {dialect.unused.format(name)}" for name in unused if dialect.unused]
    return writer.function(function.name, function.arguments, words, function.result)


def programs(body: Body, dialect: Dialect, words: Mapping[str, str]) -> list[str]:
    """The functions that call others: a step of stages, many steps, and the message of a status."""

    def repeated(writer: Writer, loop: str, names: Sequence[str], objects: str, stage: str = "") -> None:
        with writer.block(loop):
            writer.say(dialect.call.format(name=names[0], arguments=objects + stage, **words))
        writer.lines += ["    " + dialect.call.format(name=name, arguments=objects, **words) for name in names[1:]]

    writers = {name: Writer(dialect) for name in ("step", "advance", "message")}
    if body.stages:
        close = [f.name for f in body.functions if f.name == "close"]
        loop = dialect.up.format(integer="int", var="k", count=body.stages)
        repeated(writers["step"], loop, ["stage", *close], "c, s", ", k")
    before, objects, behind = (x.format(**words) for x in dialect.local)
    writers["advance"].lines += [f"    {before}"] if before else []
    repeated(writers["advance"], dialect.up.format(integer="long", var="k", count="steps"), ["step"], objects)
    writers["advance"].lines += [f"    {behind}"] if behind else []
    if body.messages and "text" in dialect.results:
        for status, text in enumerate(body.messages, 1):
            writers["message"].say(dialect.case.format(status=status, text=text))
        writers["message"].say(dialect.give.format('""'))
    arguments = {"step": CHANGED, "advance": {**CHANGED, "steps": ("count", 0)}, "message": {"status": ("status", 0)}}
    results = {"message": "text"}
    return [w.function(k, arguments[k], words, results.get(k, "")) for k, w in writers.items() if w.lines]


def type_of(name: str, fields: Mapping[str, Field], dialect: Dialect, words: Mapping[str, str]) -> str:
    """A type, declared."""
    head, number, array, end = dialect.types
    lines = [head.format(name=name, Name=name.capitalize(), **words)]
    for each, f in fields.items():
        comment = dialect.note.format(f.meaning) if f.meaning else ""
        lines.append((array if f.count else number).format(name=each, count=f.count, comment=comment, **words))
    return "\n".join([*lines, end.format(name=name, **words)])


def assembled(body: Body, dialect: Dialect, name: str) -> str:
    """The file, named."""
    words = {"type": name, "module": "".join(word[:1].upper() + word[1:] for word in name.split("_"))}
    example = ["", *(f"    {line.format(**words)}" for line in dialect.usage)] if dialect.usage else []
    wrapped, remark = (
        [x for line in lines for x in textwrap.wrap(line, WIDTH) or [""]]
        for lines in (body.head, ["", dialect.remark] if dialect.remark else [])
    )
    head = "\n".join(f"{dialect.mark}{line}".rstrip() for line in [*wrapped, *example, *remark])
    sections = [type_of("constants", body.constants, dialect, words), type_of("state", body.state, dialect, words)]
    values = {name: f.value for name, f in body.parameters.items()} | {f"start_{k}": v for k, v in body.start.items()}
    defaults = [
        dialect.default[np.ndim(v) > 0].format(
            name=each, count=np.size(v), body=", ".join(map(dialect.literal, np.ravel(v).tolist())), **words
        )
        for each, v in values.items()
    ]
    sections.append("\n".join(defaults))
    sections += [text_of(body, function, dialect, words) for function in body.functions]
    sections += programs(body, dialect, words)
    inner = "\n\n".join(section.rstrip("\n") for section in sections)
    inner = dialect.replaced(inner)
    digest = hashlib.sha256(inner.encode()).hexdigest()[:8]
    begin = dialect.replaced(dialect.begin).format(head=head, digest=digest, **words)
    return f"{begin}{inner}\n\n{dialect.finish.format(**words)}".rstrip() + "\n"
