"""Files of other languages: a body as functions of arrays, whose graphs become nested expressions and statements.

The operations of a graph are written in its order and never regrouped, so a language with the same arithmetic has its
bits: parentheses keep them, if the compiler fuses nothing (`-ffp-contract=off`).
"""

from __future__ import annotations

import hashlib
import re
import textwrap
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from kreisel.errors import InputError, RunError
from kreisel.graph.arranging import ENTRY, ROW, Rolled, of_a_row
from kreisel.graph.graph import (
    BRANCH,
    IN,
    LOOP,
    MINUS,
    NEVER,
    OVER,
    PLUS,
    RESULT,
    TIMES,
    WHERE,
    Graph,
    Number,
    Operand,
    depending,
    operands_of,
)
from kreisel.graph.recording import as_operands
from kreisel.languages.dialects import Dialect

Values = Mapping[str, Any]
Arguments = Mapping[str, tuple[str, int]]
WIDTH, NESTED = 116, 72  # columns of a line; the longest expression that is nested in another
SIGNS = (PLUS, MINUS, TIMES, OVER)


class Writer:
    """Statements of a function in a dialect.

    inputs  the expression of an input (letter, index)
    copied  objects whose inputs may change before they are read, so that they are copied first
    taken   names of arguments, which no other name may equal
    lines   the statements
    """

    def __init__(self, dialect: Dialect, inputs: Callable[[str, int], str] | None = None, copied: Sequence[str] = ()):
        self.dialect, self.inputs, self.copied, self.taken = dialect, inputs or "{}[{}]".format, copied, set[str]()
        self.lines, self.indent, self._open, self._count = list[str](), 1, "", 0

    def say(self, statement: str) -> None:
        self.lines.append("    " * self.indent + statement)
        self._open = ""

    def _pack(self, kind: str, beginning: str, statement: str, joint: str) -> None:
        last = self.lines[-1] if self.lines else ""
        if self._open == kind and len(last) + len(statement) < WIDTH:
            self.lines[-1] = f"{last.removesuffix(self.dialect.end)}{joint}{statement}"
        else:
            self.say(beginning + statement)
        self._open = kind

    def fresh(self, letter: str = "t") -> str:
        """A name that the function does not yet have."""
        self._count += 1
        name = f"{letter}{self._count}"
        return self.fresh(letter) if name in self.taken else name

    def once(self, expression: str, letter: str = "t") -> str:
        """The name of a new constant with this value."""
        name = self.fresh(letter)
        beginning, brace, form = self.dialect.once.partition("{")
        self._pack("once", beginning, (brace + form).format(name, bare(expression)), self.dialect.joint)
        return name

    def assign(self, name: str, expression: str) -> None:
        """Assign a value to a variable, or to an entry of an array."""
        end = self.dialect.end
        self._pack("assign", "", f"{name} = {bare(expression)}{end}", f"{end or ';'} ")

    def values(self, graph: Graph, outputs: Sequence[Operand]) -> list[str]:
        rolled = graph if isinstance(graph, Rolled) else None
        new, values, results = rolled.arranged(outputs) if rolled else (graph, list(outputs), [])
        block = Block(self, new, [*values, *results])
        read = {new.nodes[at][1] for at in new.needed([*values, *results]) if new.nodes[at][0] == IN}
        for place, ((rows, _), result) in enumerate(zip(rolled.maps if rolled else [], results, strict=True)):
            if f"{ENTRY}{place}" in read:
                self._map(block, place, rows, result)
        block.compute(new.needed(values), values)
        return [block.value(x) for x in values]

    def _map(self, block: Block, place: int, rows: Sequence[Sequence[float]], result: Operand) -> None:
        d, graph, table, out = self.dialect, block.graph, f"{ROW}{place}_", f"{ENTRY}{place}"
        nodes = graph.needed([result])
        inside = depending(graph, nodes, of_a_row)
        for j in sorted(graph.nodes[at][2] for at in inside if graph.nodes[at][0] == IN):
            body = ", ".join(d.literal(row[j]) for row in rows)
            self.say(d.table.format(name=f"{table}{j}", count=len(rows), body=body))
        self.say(d.room.format(name=out, count=len(rows)))
        read = [x.positive for at in inside for x in operands_of(graph.nodes[at]) if x.at not in inside]
        block.compute([at for at in nodes if at not in inside], [*read, *read])  # each before the loop
        index = self.fresh("k")
        with self.block(d.up.format(integer="int", var=index, count=len(rows))):
            block.names |= {at: f"{table}{graph.nodes[at][2]}[{index}]" for at in inside if graph.nodes[at][0] == IN}
            block.compute(sorted(inside), [result])
            self.assign(f"{out}[{index}]", block.value(result))

    def function(self, name: str, arguments: Arguments, words: Mapping[str, str], result: str = "") -> str:
        """The function with these statements; `arguments`: name -> (kind, count)."""
        d = self.dialect
        kinds = [(x, n, *kind.partition(" ")[::2]) for x, (kind, n) in arguments.items()]
        listed = ", ".join(
            d.arguments[kind].format(name=x, count=n, of=of, Of=of.capitalize(), **words) for x, n, kind, of in kinds
        )
        head = d.function.format(name=name, arguments=listed, result=d.results[result], **words)
        return "\n".join([head, *self.lines, *([d.close] if d.close else [])])

    @contextmanager
    def block(self, head: str) -> Iterator[None]:
        """A block: with writer.block(head): ..."""
        self.say(head)
        self.indent += 1
        yield
        self.indent -= 1
        self._open = ""
        if self.dialect.close:
            self.say(self.dialect.close)


def bare(text: str) -> str:
    """An expression without parentheses around all of it."""
    depth = 0
    for i, letter in enumerate(text):
        depth += (letter == "(") - (letter == ")")
        if not depth:
            return text[1:-1] if i == len(text) - 1 and i else text
    return text


class Block:
    """Expressions of the nodes of a graph, by their places: a name, or an expression for the only use."""

    def __init__(self, writer: Writer, graph: Graph, outputs: Sequence[Operand] = ()):
        self.writer, self.graph, self.names = writer, graph, dict[int, Any]()
        self.uses = Counter(x.at for at in graph.needed(outputs) for x in operands_of(graph.nodes[at]))

    def value(self, x: Operand) -> str:
        """A literal, or the expression of a number with its sign."""
        d = self.writer.dialect
        if not isinstance(x, Number):
            return d.literal(float(x)) if x >= 0 else f"({d.literal(float(x))})"
        name = str(self.names[x.at])
        return f"(-{name})" if x.negative else name

    def compute(self, nodes: Sequence[int], outputs: Sequence[Operand]) -> None:
        """Write the nodes that are used twice."""
        graph = self.graph.nodes
        uses = self.uses | Counter(x.at for at in nodes for x in operands_of(graph[at]))
        uses.update(x.at for x in outputs if isinstance(x, Number))
        uses.update({x.at: 2 for at in nodes if graph[at][0] in (LOOP, BRANCH) for x in operands_of(graph[at])})
        for at in nodes:
            operation, *operands = graph[at]
            if at in self.names:
                continue
            if operation == IN:
                self.names[at] = self._input(*operands)
            elif operation == LOOP:
                kept = {graph[k][2] for k in nodes if graph[k][0] == RESULT and graph[k][1].at == at}
                self.names[at] = self._loop(operands, kept)
            elif operation == BRANCH:
                self.names[at] = self._branch(*operands)
            elif operation == RESULT:
                self.names[at] = self.names[operands[0].at][operands[1]]
            else:
                text = self.expression(operation, [self.value(x) for x in operands])
                self.names[at] = self.writer.once(text) if uses[at] > 1 or len(text) > NESTED else text

    def _input(self, letter: str, index: int) -> str:
        writer = self.writer
        if letter.startswith(ENTRY):
            return f"{letter}[{index + writer.dialect.first}]"
        text = writer.inputs(letter, index)
        prefix = letter.rstrip("0123456789")[-1]  # a name in every language begins with a letter
        return writer.once(text, prefix) if letter.partition(".")[0] in writer.copied else text

    def expression(self, operation: str, operands: Sequence[str]) -> str:
        if operation in SIGNS:
            return f"({operands[0]} {operation} {operands[1]})"
        call = self.writer.dialect.calls.get(operation)
        if call is None:
            raise RunError(f"expected operations that {self.writer.dialect.name} has too, got {operation}")
        return call.format(*(map(bare, operands) if "(" in call[1:] else operands))

    def _branch(self, place: int, test: Number, *values: Operand) -> list[str]:
        """Both sides, and a choice between them."""
        branch, inside = self.graph.branches[place], Block(self.writer, self.graph)
        inside.names = dict(self.names)
        inside.compute(self.graph.needed_inside(branch), branch.new)
        zero, condition, expression = self.value(0.0), self.value(test), self.expression
        choices = [(inside.value(new), self.value(old)) for new, old in zip(branch.new, values, strict=False)]
        return [self.writer.once(expression(WHERE, [zero, condition, new, old])) for new, old in choices]

    def _loop(self, operands: Sequence[Any], results: set[int]) -> dict[int, str]:
        writer, loop, d = self.writer, self.graph.loops[operands[0]], self.writer.dialect
        members = self.graph.needed_inside(loop)
        read = {x.at for at in members for x in operands_of(self.graph.nodes[at])}
        kept = [i for i, x in enumerate(loop.variables) if i in results or x.at in read]
        variables = {i: writer.fresh("v") for i in kept}
        for i, name in variables.items():
            writer.say(d.starts.format(name, self.value(operands[1 + i])))
        count = writer.fresh("k")
        with writer.block(d.up.format(integer="int", var=count, count=loop.most)):
            inside = Block(writer, self.graph)
            inside.names = self.names | {loop.variables[i].at: name for i, name in variables.items()}
            ends = loop.small != NEVER
            values = [loop.new[i] for i in kept] + [loop.new[-1]] * ends
            inside.compute(members, values)
            new = [inside.value(x) for x in values]
            new = [writer.once(x) for x in new] if len(new) > 1 else new
            for i, value in zip(kept, new, strict=False):
                writer.assign(variables[i], value)
            if ends:
                writer.say(d.leave.format(new[-1], self.value(loop.small)))
        return variables


HUGE = {False: 1e75, True: 1e30}  # of parameters, by whether in 32 bits: the fourth power of 1e75 is finite
READ = {"c": ("read constants", 0), "s": ("read state", 0)}
NEW, CHANGED = {"c": ("written constants", 0)}, READ | {"s": ("written state", 0)}


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
    arguments  name -> (kind, count); kinds as in `Dialect.arguments`, with the type of an object: "read state"
    result     "" if it writes an object or an array; "number", "status"
    """

    name: str
    apply: Callable[..., Any]
    arguments: Arguments
    result: str = ""


@dataclass(frozen=True)
class Body:
    """The contents of a file; `last`: quaternions whose w is the last entry."""

    head: Sequence[str]
    parameters: Mapping[str, Field]
    constants: Mapping[str, Field]
    state: Mapping[str, Field]
    functions: Sequence[Function]
    messages: Sequence[str] = ()
    start: Mapping[str, Any] = field(default_factory=dict)
    stages: int = 0
    last: Sequence[str] = ()


def numbers_of(graph: Graph, name: str, fields: Mapping[str, Field], staged: bool = False) -> dict[str, Any]:
    """The fields of a type as inputs of a graph; `staged`: fields of one stage."""
    out = {}
    for entry, f in fields.items():
        count = f.stage if staged and f.stage else f.count
        out[entry] = graph.inputs(f"{name}.{entry}", count) if count else graph.input(f"{name}.{entry}", 0)
    return out


def text_of(body: Body, function: Function, dialect: Dialect, words: Mapping[str, str]) -> str:
    """A function, written."""
    types = {"constants": body.constants, "state": body.state}
    graph, values = Rolled(tables=bool(dialect.room)), dict[str, Any]()
    staged = ("k", ("index", 0)) in function.arguments.items()  # `k` may be a parameter of a body
    for name, (kind, count) in function.arguments.items():
        if kind.endswith(("state", "read constants")):
            values[name] = numbers_of(graph, name, types[kind.split()[1]], staged)
        elif kind in ("number", "array"):
            values[name] = graph.inputs(name, count) if count else graph.input(name, 0)
    results = function.apply(**values)

    def place(letter: str, i: int) -> str:
        owner, _, name = letter.partition(".")
        kind, count = function.arguments[owner]
        index = str((i - 1) % 4 + dialect.first if letter in body.last else i + dialect.first)
        if not name:
            return f"{owner}[{index}]" if count else owner
        f = types[kind.split()[1]][name]
        if staged and f.stage:
            index = "k" if f.stage == 1 else f"{f.stage} * k + {i + dialect.first * (1 - f.stage)}"
        return dialect.members[f.count > 0].format(object=owner, name=name, i=index)

    changed = [name for name, (kind, _) in function.arguments.items() if kind == "written state"]
    writer = Writer(dialect, place, changed)
    writer.taken |= {*function.arguments}
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
    out = [step.function("step", CHANGED, words)] if body.stages else []
    out.append(advance.function("advance", {**CHANGED, "steps": ("count", 0)}, words))
    last = [message.function("message", {"status": ("status", 0)}, words, "text")] if message.lines else []
    return out + last


def type_of(name: str, fields: Mapping[str, Field], dialect: Dialect, words: Mapping[str, str]) -> str:
    """A type, declared."""
    head, number, array, end = dialect.types
    lines = [head.format(name=name, Name=name.capitalize(), **words)]
    for entry, f in fields.items():
        words_of_field = {
            "comment": dialect.note.format(f.meaning) if f.meaning else "",
            "zeros": ", ".join(["0.0"] * f.count),
        }
        lines.append((array if f.count else number).format(name=entry, count=f.count, **words_of_field, **words))
    zeros = ", ".join(dialect.zeros[f.count > 0].format(name=entry, count=f.count) for entry, f in fields.items())
    return "\n".join([*lines, end.format(name=name, Name=name.capitalize(), zeros=zeros, **words)])


def assembled(body: Body, dialect: Dialect, name: str) -> str:
    """The file, named.  Raises `InputError` for names of parameters that it cannot have."""
    functions = ("step", "advance", "message", *(function.name for function in body.functions))
    if taken := [k for k in body.parameters if k in (*functions, *dialect.keywords.split())]:
        raise InputError(
            f"params: expected names that {dialect.name} and the functions of the file do not have already, got "
            f"{', '.join(taken)}. Give other names to parameters of the forces."
        )
    words = {"type": name, "module": "".join(word[:1].upper() + word[1:] for word in name.split("_"))}
    lines = [*body.head, *(line.format(**words) for line in dialect.about)]
    wrapped = [x for line in lines for x in textwrap.wrap(line, WIDTH) or [""]]
    head = "\n".join(f"{dialect.mark}{line}".rstrip() for line in wrapped)
    sections = [type_of("constants", body.constants, dialect, words), type_of("state", body.state, dialect, words)]
    values = {name: f.value for name, f in body.parameters.items()} | {f"start_{k}": v for k, v in body.start.items()}
    defaults = [
        dialect.default[np.ndim(v) > 0].format(
            name=label, count=np.size(v), body=", ".join(map(dialect.literal, np.ravel(v).tolist())), **words
        )
        for label, v in values.items()
    ]
    sections += ["\n".join(defaults), *(text_of(body, function, dialect, words) for function in body.functions)]
    sections += programs(body, dialect, words)
    text = "\n\n".join(section.rstrip("\n") for section in sections)
    begin = dialect.begin.format(head="{head}", digest=hashlib.sha256(text.encode()).hexdigest()[:8], **words)
    text = f"{begin}{text}\n\n{dialect.finish.format(**words)}".rstrip() + "\n"
    for old, new in dialect.renamed.items():
        text = text.replace(old, new)
    return text.replace("{head}", head, 1)
