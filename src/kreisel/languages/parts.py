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
        new = [
            (place(name, i), x)
            for name, value in results.items()
            for i, x in enumerate(as_operands(list(np.ravel(np.asarray(value, dtype=object)))))
            if getattr(x, "key", None) != (graph.node(IN, name, i), False)
        ]
        for (target, _), value in zip(new, writer.values(graph, [x for _, x in new]), strict=True):
            writer.assign(target, value)
    unused = [name for name in function.arguments if not re.search(rf"\b{name}\b", "\n".join(writer.lines))]
    writer.lines[:0] = [f"    {dialect.unused.format(name)}" for name in unused if dialect.unused]
    return writer.function(function.name, function.arguments, words, function.result)


def programs(body: Body, dialect: Dialect, words: Mapping[str, str]) -> list[str]:
    """The functions that call others: a step of stages, many steps, and the message of a status."""

    def call(name: str, objects: str) -> str:
        return dialect.call.format(name=name, arguments=objects, **words)

    step, advance, message = (Writer(dialect) for _ in range(3))
    if body.stages:
        with step.block(dialect.up.format(integer="int", var="k", count=body.stages)):
            step.say(call("stage", "c, s, k"))
        step.lines += ["    " + call("close", "c, s") for f in body.functions if f.name == "close"]
    before, objects, behind = (x.format(**words) for x in dialect.local)
    advance.lines += [f"    {before}"] * bool(before)
    with advance.block(dialect.up.format(integer="long", var="k", count="steps")):
        advance.say(call("step", objects))
    advance.lines += [f"    {behind}"] * bool(behind)
    if body.messages and "text" in dialect.results:
        for status, text in enumerate(body.messages, 1):
            message.say(dialect.case.format(status=status, text=text))
        message.say(dialect.give.format('""'))
    many = {**CHANGED, "steps": ("count", 0)}
    return [
        *([step.function("step", CHANGED, words)] if body.stages else []),
        advance.function("advance", many, words),
        *([message.function("message", {"status": ("status", 0)}, words, "text")] if message.lines else []),
    ]


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
    lines = [*body.head, *(line.format(**words) for line in dialect.about)]
    wrapped = [x for line in lines for x in textwrap.wrap(line, WIDTH) or [""]]
    head = "\n".join(f"{dialect.mark}{line}".rstrip() for line in wrapped)
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
