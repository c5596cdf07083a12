"""Graphs as statements of other languages: nested expressions, a name for a value that is used twice.

The operations of a graph are written in its order and never regrouped, so a language with the same arithmetic has its
bits: parentheses keep them, if the compiler fuses nothing (`-ffp-contract=off`).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

from kreisel.errors import RunError
from kreisel.graph.arranging import arranged
from kreisel.graph.graph import IN, LOOP, MINUS, OVER, PLUS, RESULT, TIMES, Graph, Number, Operand, operands_of
from kreisel.languages.dialects import Dialect

WIDTH, NESTED = 116, 72  # columns of a line; the longest expression that is nested in another
SIGNS = (PLUS, MINUS, TIMES, OVER)
ROW, ENTRY = "row", "each"  # letters of the columns of a table, and of the results of its rows


class Rolled(Graph):
    """A graph whose loops over tables stay loops.

    maps    (rows, results) of each loop: its columns are inputs `row`, its results outside inputs `each`
    tables  whether loops over tables stay loops, or are written out
    """

    def __init__(self, tables: bool) -> None:
        super().__init__()
        self._tables = tables
        self.maps: list[tuple[Sequence[Sequence[float]], list[Operand]]] = []

    def for_rows(self, body: Callable[..., Any], rows: Sequence[Sequence[float]]) -> list[Any]:
        """body(*row), recorded once."""
        if not self._tables:
            return super().for_rows(body, rows)
        place = len(self.maps)
        columns = [self.input(f"{ROW}{place}", j) for j in range(len(rows[0]))]
        self.maps.append((rows, [body(*columns)]))
        return [self.input(f"{ENTRY}{place}", k) for k in range(len(rows))]

    def times(self, body: Callable[[list[Any]], Sequence[Any]], start: Sequence[Any], count: int) -> Sequence[Any]:
        """The result of `count` applications of the body to `start`, recorded once."""
        return self.loop(lambda x: (body(x), 0.0), start, -1.0, count)[0]

    def arranged(self, outputs: Sequence[Operand]) -> tuple[Graph, list[Operand], list[Operand]]:
        """The graph made ready: its outputs, and the results of the loops.

        Values that a loop reads count as used often, as they are in a graph without loops.
        """
        results = [x for _, new in self.maps for x in new]
        inside = self.varying(results)
        read = [x for at in inside for x in operands_of(self.nodes[at]) if x.at not in inside]
        graph, values = arranged(self, [*outputs, *results, *({x.at: x.positive for x in read}.values())])
        return graph, values[: len(outputs)], values[len(outputs) : len(outputs) + len(results)]

    def varying(self, outputs: Iterable[Operand]) -> set[int]:
        """The nodes that depend on a row."""
        return varying(self, self.needed(outputs))


def varying(graph: Graph, nodes: Sequence[int]) -> set[int]:
    """The nodes among these that depend on the row of a table."""
    out = set[int]()
    for at in nodes:
        operation, *operands = graph.nodes[at]
        if (operation == IN and operands[0].startswith(ROW)) or any(x.at in out for x in operands_of(graph.nodes[at])):
            out.add(at)
    return out


class Writer:
    """Statements of a function in a dialect.

    inputs  the expression of an input (letter, index)
    copied  whether inputs of a letter may change before they are read, so that they are copied first
    lines   the statements
    """

    def __init__(
        self,
        dialect: Dialect,
        inputs: Callable[[str, int], str] = "{}[{}]".format,
        copied: Callable[[str], bool] = lambda _: False,
    ):
        self.dialect, self.inputs, self.copied = dialect, inputs, copied
        self.lines: list[str] = []
        self.indent, self._open = 1, ""
        self._count = 0

    def say(self, statement: str) -> None:
        """Add a statement."""
        self.lines.append("    " * self.indent + statement)
        self._open = ""

    def _pack(self, kind: str, beginning: str, statement: str, joint: str) -> None:
        """Add a statement to the last line, if it is of that kind and has room."""
        last = self.lines[-1] if self.lines else ""
        if self._open == kind and len(last) + len(statement) < WIDTH:
            self.lines[-1] = f"{last.removesuffix(self.dialect.end)}{joint}{statement}"
        else:
            self.say(beginning + statement)
        self._open = kind

    def fresh(self, letter: str = "t") -> str:
        """A name that the function does not yet have."""
        self._count += 1
        return f"{letter}{self._count}"

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
        """Compute the outputs of a graph; their expressions."""
        new, values, results = graph.arranged(outputs) if isinstance(graph, Rolled) else (graph, list(outputs), [])
        maps = graph.maps if isinstance(graph, Rolled) else []
        block = Block(self, new, [*values, *results])
        read = {new.nodes[at][1] for at in new.needed([*values, *results]) if new.nodes[at][0] == IN}
        for place, ((rows, _), result) in enumerate(zip(maps, results, strict=True)):
            if f"{ENTRY}{place}" in read:
                self._map(block, place, rows, result)
        block.compute(new.needed(values), values)
        return [block.value(x) for x in values]

    def _map(self, block: Block, place: int, rows: Sequence[Sequence[float]], result: Operand) -> None:
        """A loop over the rows of a table."""
        d, graph, table, out = self.dialect, block.graph, f"{ROW}{place}_", f"{ENTRY}{place}"
        nodes = graph.needed([result])
        inside = varying(graph, nodes)
        columns = sorted(graph.nodes[at][2] for at in inside if graph.nodes[at][0] == IN)
        for j in columns:
            body = ", ".join(d.literal(row[j]) for row in rows)
            self.say(d.table.format(name=f"{table}{j}", count=len(rows), body=body))
        self.say(d.room.format(name=out, count=len(rows)))
        read = [x.positive for at in inside for x in operands_of(graph.nodes[at]) if x.at not in inside]
        block.compute([at for at in nodes if at not in inside], read, hoisted=True)
        index = self.fresh("k")
        with self.block(d.up.format(integer="int", var=index, count=len(rows))):
            block.names |= {at: f"{table}{graph.nodes[at][2]}[{index}]" for at in inside if graph.nodes[at][0] == IN}
            block.compute(sorted(inside), [result])
            self.assign(f"{out}[{index}]", block.value(result))

    def function(
        self, name: str, arguments: Mapping[str, tuple[str, int]], words: Mapping[str, str], result: str = ""
    ) -> str:
        """The function with these statements; `arguments`: name -> (kind, count)."""
        d = self.dialect
        listed = ", ".join(d.arguments[kind].format(name=x, count=n, **words) for x, (kind, n) in arguments.items())
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

    def compute(self, nodes: Sequence[int], outputs: Sequence[Operand], hoisted: bool = False) -> None:
        """Write the nodes that are used twice; `hoisted`: the outputs too."""
        uses = self.uses | Counter(x.at for at in nodes for x in operands_of(self.graph.nodes[at]))
        uses.update(x.at for x in outputs for _ in range(1 + hoisted) if isinstance(x, Number))
        uses.update(
            {x.at: 2 for at in nodes if self.graph.nodes[at][0] == LOOP for x in operands_of(self.graph.nodes[at])}
        )
        for at in nodes:
            operation, *operands = self.graph.nodes[at]
            if at in self.names:
                continue
            if operation == IN:
                self.names[at] = self._input(*operands)
            elif operation == LOOP:
                kept = {x[2] for x in map(self.graph.nodes.__getitem__, nodes) if x[0] == RESULT and x[1].at == at}
                self.names[at] = self._loop(operands, kept)
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
        return writer.once(text, letter[-1]) if writer.copied(letter) else text

    def expression(self, operation: str, operands: Sequence[str]) -> str:
        """An operation on expressions."""
        if operation in SIGNS:
            return f"({operands[0]} {operation} {operands[1]})"
        call = self.writer.dialect.calls.get(operation)
        if call is None:
            raise RunError(f"expected operations that {self.writer.dialect.name} has too, got {operation}")
        return call.format(*(map(bare, operands) if "(" in call[1:] else operands))

    def _loop(self, operands: Sequence[Any], results: set[int]) -> dict[int, str]:
        """The variables of a loop that its body or its `results` read."""
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
            inside.compute(members, [loop.new[i] for i in kept])
            new = [writer.once(inside.value(loop.new[i])) for i in kept] if len(kept) > 1 else []
            for i, name in zip(kept, new or [inside.value(loop.new[i]) for i in kept], strict=True):
                writer.assign(variables[i], name)
        return variables
