"""Graphs as statements of other languages: each operation one statement, in the order of the graph."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from kreisel.errors import RunError
from kreisel.graph.graph import (
    FMA,
    IN,
    LOOP,
    MAX,
    MINUS,
    OVER,
    PLUS,
    RESULT,
    SIGN,
    SIZE,
    SQRT,
    TIMES,
    TRANSCENDENTAL,
    WHERE,
    Graph,
    Number,
    Operand,
)
from kreisel.languages.dialects import Dialect

WORD, NUMBER = re.compile(r"[A-Za-z_]\w*"), re.compile(r"\s*(?:const double |const )?(t\d+) = ")
SIGNS = (PLUS, MINUS, TIMES, OVER)
OF_LANGUAGE = (FMA, SQRT, *TRANSCENDENTAL)  # functions that languages have
HELPERS = {MAX: "max", SIGN: "sign", SIZE: "size", WHERE: "where_less"}  # functions that the files bring


class Writer:
    """Statements of a function in a dialect.

    inputs  the expression of an input (letter, index)
    exact   whether sums with a product are rounded once also in JavaScript, which is slow there
    lines   the statements
    """

    def __init__(self, dialect: Dialect, inputs: Callable[[str, int], str], exact: bool = False):
        self.dialect, self.inputs, self.exact = dialect, inputs, exact
        self.lines: list[str] = []
        self.indent = 4
        self._count = 0

    def say(self, line: str) -> None:
        """Add a statement."""
        self.lines.append(" " * self.indent + line)

    def fresh(self, letter: str) -> str:
        """A name that the function does not yet have."""
        self._count += 1
        return f"{letter}{self._count - 1}"

    def once(self, expression: str, letter: str = "t") -> str:
        """The name of a new constant with this value."""
        name = self.fresh(letter)
        self.say(self.dialect.once[0].format(name, expression))
        return name

    def assign(self, name: str, expression: str) -> None:
        """Assign a value to a variable, or to an entry of an array."""
        self.say(f"{name} = {expression}{self.dialect.end}")

    def values(self, graph: Graph, outputs: Sequence[Operand]) -> list[str]:
        """Compute the outputs of a graph; their expressions."""
        names: dict[int, Any] = {}
        self._compute(graph, graph.needed(outputs), names)
        return [self.operand(x, names) for x in outputs]

    def operand(self, x: Operand, names: dict[int, Any]) -> str:
        """A literal, or the name of a variable, with its sign."""
        if not isinstance(x, Number):
            return self.dialect.literal(float(x)) if x >= 0 else f"({self.dialect.literal(float(x))})"
        return f"(-{names[x.at]})" if x.negative else str(names[x.at])

    def _compute(self, graph: Graph, nodes: Sequence[int], names: dict[int, Any]) -> None:
        for at in nodes:
            operation, *operands = graph.nodes[at]
            if operation == IN:
                names[at] = self.once(self.inputs(*operands), operands[0])
            elif operation == LOOP:
                names[at] = self._loop(graph, operands, names)
            elif operation == RESULT:
                names[at] = names[operands[0].at][operands[1]]
            else:
                names[at] = self.once(self.expression(operation, [self.operand(x, names) for x in operands]))

    def expression(self, operation: str, operands: Sequence[str]) -> str:
        """An operation on expressions."""
        if operation in SIGNS:
            return f"{operands[0]} {operation} {operands[1]}"
        if operation in OF_LANGUAGE:
            name = "exact_fma" if operation == FMA and self.exact and self.dialect.name == "js" else operation
        elif operation in HELPERS:
            name = self.dialect.prefix + HELPERS[operation]
        else:
            raise RunError(f"expected operations that {self.dialect.name} has too, got {operation}")
        return f"{name}({', '.join(operands)})"

    def _loop(self, graph: Graph, operands: Sequence[Any], names: dict[int, Any]) -> list[str]:
        loop, d = graph.loops[operands[0]], self.dialect
        variables = [self.fresh("v") for _ in loop.new]
        starts = [*(self.operand(x, names) for x in operands[1 : len(loop.variables) + 1]), d.literal(0.0)]
        for name, x in zip(variables, starts, strict=True):
            self.say(d.starts.format(name, x))
        count = self.fresh("k")
        self.say(d.local[1].format(count))
        with self.block(d.up.format(var=count, start=0, stop=loop.most)):
            inside = dict(names)
            inside.update({x.at: name for x, name in zip(loop.variables, variables, strict=False)})
            self._compute(graph, graph.needed_inside(loop), inside)
            new = [self.once(self.operand(x, inside), "n") for x in loop.new]
            for name, x in zip(variables, new, strict=True):
                self.assign(name, x)
            with self.block(d.condition.format(f"{variables[-1]} <= {d.literal(loop.small)}")):
                self.say(f"break{d.end}")
        return variables

    def function(self, head: str) -> str:
        """The function with these statements, without variables that none of them reads."""
        lines = self.lines
        while True:
            words = Counter(word for line in lines for word in WORD.findall(line))
            kept = [line for line in lines if not (found := NUMBER.match(line)) or words[found[1]] > 1]
            if len(kept) == len(lines):
                return "\n".join([head, *lines, self.dialect.close])
            lines = kept

    def block(self, head: str) -> _Block:
        """A block: with writer.block(head): ..."""
        return _Block(self, head)


class _Block:
    def __init__(self, writer: Writer, head: str):
        self._writer, self._head = writer, head

    def __enter__(self) -> None:
        self._writer.say(self._head)
        self._writer.indent += 4

    def __exit__(self, *_: object) -> None:
        self._writer.indent -= 4
        self._writer.say(self._writer.dialect.close)


# -- loops of the projection, for programs that are too long to be written out -------------------------------


class Index:
    """An expression of an integer."""

    def __init__(self, text: str):
        self.text = text

    def __add__(self, other: Any) -> Index:
        return Index(f"({self.text} + {other})")

    def __radd__(self, other: Any) -> Index:
        return Index(f"({other} + {self.text})")

    def __sub__(self, other: Any) -> Index:
        return Index(f"({self.text} - {other})")

    def __mul__(self, other: Any) -> Index:
        return Index(f"{self.text} * {other}")

    def __rmul__(self, other: Any) -> Index:
        return Index(f"{other} * {self.text}")

    def __str__(self) -> str:
        return self.text


class Looping(Graph):
    """Numbers and loops of `kreisel.graph.project.Projection` as statements, each at its place of recording."""

    def __init__(self, writer: Writer):
        super().__init__()
        self.writer, self._said = writer, dict[int, Any]()

    def node(self, operation: str, *operands: Operand) -> int:
        at = len(self.nodes)
        self.nodes.append((operation, *operands))
        said = operands[0] if operation == IN else None
        expression = said or self.writer.expression(operation, [self.value(x) for x in operands])
        self._said[at] = self.writer.once(str(expression))
        return at

    def value(self, x: Operand) -> str:
        """The expression of a number."""
        return self.writer.operand(x, self._said)

    def number(self, expression: str) -> Number:
        """A number given by an expression."""
        return Number(self, self.node(IN, expression))

    def each(self, first: Any, last: Any, step: int = 1) -> Iterator[Index]:
        """The variable of a loop, whose body is run once, to be written."""
        d, name = self.writer.dialect, self.writer.fresh("i")
        self.writer.say(d.local[1].format(name))
        with self.writer.block((d.up if step > 0 else d.down).format(var=name, start=first, stop=last)):
            yield Index(name)

    def only(self, kind: Any, place: int) -> Iterator[None]:
        with self.writer.block(self.writer.dialect.condition.format(f"{kind} == {place}")):
            yield

    def cell(self, x: Operand) -> Entries:
        name = self.writer.fresh("v")
        self.writer.say(self.writer.dialect.starts.format(name, self.value(x)))
        return Entries(self, name, scalar=True)


class Entries:
    """The entries of an array, also of an array that loops change."""

    def __init__(self, flow: Looping, name: str, scalar: bool = False):
        self._flow, self._name, self._scalar = flow, name, scalar

    def _at(self, i: Any) -> str:
        first = self._flow.writer.dialect.first
        return self._name if self._scalar else f"{self._name}[{i}{f' + {first}' if first else ''}]"

    def __getitem__(self, i: Any) -> Number:
        return self._flow.number(self._at(i))

    def __setitem__(self, i: Any, x: Operand) -> None:
        self._flow.writer.assign(self._at(i), self._flow.value(x))


class Integers:
    """Integers of a table."""

    def __init__(self, dialect: Dialect, name: str):
        self._dialect, self._name = dialect, name

    def __getitem__(self, i: Any) -> Index:
        first = self._dialect.first
        return Index(f"{self._name}[{i}{f' + {first}' if first else ''}]")
