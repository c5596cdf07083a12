"""C, JavaScript and Julia as data for `kreisel.languages.writer`."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from typing import Any

from kreisel.algebra.reuse import cached_property

SECTION = re.compile(r"^@@ (.+)\n", re.MULTILINE)
WORD = re.compile(r"@(\w+?)@")


def filled(template: str, words: Mapping[str, Any]) -> str:
    """A template with @words@ replaced, except words that are not yet known."""
    return WORD.sub(lambda match: str(words.get(match[1], match[0])), template)


@dataclass(frozen=True)
class Dialect:
    """A language, in templates.

    local     declares a float, or an integer, that is assigned to later
    once      declares one with its final value
    starts    declares a float that is assigned to later, with its first value
    up, down  a loop over integers {var} from {start} to {stop}, exclusive, with step 1 and -1
    table     declares constant floats; `rows` several rows of them, `row` each
    prefix    of the helpers that all files share, if other names may clash with them
    mark      of the other names of a file, if they would clash with names of other files
    reserved  reserved words of the language
    first     the index of the first entry of an array
    """

    name: str
    suffix: str
    end: str
    local: tuple[str, str]
    once: tuple[str, str]
    starts: str
    up: str
    down: str
    loop_while: str
    condition: str
    otherwise: str
    close: str
    either: str
    table: tuple[str, str]
    rows: str
    row: str
    between: str
    space: str
    no: str
    yes: str
    special: tuple[str, str]
    prefix: str
    mark: str = ""
    reserved: frozenset[str] = frozenset()
    first: int = 0

    @cached_property
    def templates(self) -> dict[str, str]:
        """The constant texts of every file: its head, its helpers, the type with a state, the heads of functions."""
        folder = resources.files("kreisel.languages").joinpath("templates")
        text = folder.joinpath(f"{self.name}{self.suffix}").read_text(encoding="utf-8")
        names_and_texts = SECTION.split(text)[1:]
        return dict(zip(names_and_texts[::2], names_and_texts[1::2], strict=True))

    def part(self, name: str, **words: Any) -> str:
        """A template of one statement, filled."""
        return filled(self.templates[name].rstrip("\n"), words)

    def name_of(self, word: str) -> str:
        """A name that is not a reserved word of the language."""
        return f"{word}_" if word in self.reserved else word

    def entry(self, array: str, i: int) -> str:
        """An entry of an array."""
        return f"{array}[{i + self.first}]"

    def numbers(self, name: str, values: Sequence[float], whole: bool = False) -> str:
        """A declaration of constant floats."""
        body = ", ".join(self.literal(v, whole) for v in values) or "0"
        return self.table[whole].format(name=name, count=max(len(values), 1), body=body)

    def matrix(self, name: str, values: Sequence[Sequence[float]]) -> str:
        """A declaration of rows of constant floats."""
        rows = [self.row.format(self.space.join(self.literal(v) for v in row)) for row in values]
        return self.rows.format(name=name, count=len(values), width=len(values[0]), body=self.between.join(rows))

    def literal(self, value: float, whole: bool = False) -> str:
        """A float or an integer with all its digits."""
        if whole:
            return str(int(value))
        nan, infinity = self.special
        return (
            repr(float(value))
            if math.isfinite(value)
            else nan
            if math.isnan(value)
            else f"{'-' * (value < 0)}{infinity}"
        )


BRACES: dict[str, Any] = {
    "end": ";",
    "up": "for ({var} = {start}; {var} < {stop}; {var}++) {{",
    "down": "for ({var} = {start}; {var} > {stop}; {var}--) {{",
    "loop_while": "while ({}) {{",
    "condition": "if ({}) {{",
    "otherwise": "}} else {{",
    "close": "}",
    "either": "({} ? {} : {})",
    "between": ", ",
    "space": ", ",
    "no": "!{}",
    "yes": "{}",
}
C = Dialect(
    name="c",
    suffix=".h",
    local=("double {} = 0.0;", "long {} = 0;"),
    once=("const double {} = {};", "const long {} = {};"),
    starts="double {} = {};",
    table=("static const double {name}[{count}] = {{{body}}};", "static const int {name}[{count}] = {{{body}}};"),
    rows="static const double {name}[{count}][{width}] = {{{body}}};",
    row="{{{}}}",
    special=("NAN", "INFINITY"),
    prefix="kreisel_",
    mark="@name@_",
    reserved=frozenset(
        "auto break case char const continue default do double else enum extern float for goto if inline int long main "
        "register restrict return short signed sizeof static struct switch typedef union unsigned void volatile while "
        "fma fabs sqrt sin cos exp log".split()
    ),
    **BRACES,
)
JAVASCRIPT = Dialect(
    name="js",
    suffix=".mjs",
    local=("let {} = 0.0;", "let {} = 0;"),
    once=("const {} = {};", "const {} = {};"),
    starts="let {} = {};",
    table=("const {name} = Float64Array.of({body});", "const {name} = Int32Array.of({body});"),
    rows="const {name} = [{body}];",
    row="Float64Array.of({})",
    special=("NaN", "Infinity"),
    prefix="",
    **BRACES,
)
JULIA = Dialect(
    name="julia",
    suffix=".jl",
    end="",
    local=("{} = 0.0", "{} = 0"),
    once=("{} = {}", "{} = {}"),
    starts="{} = {}",
    up="for {var} in {start}:({stop} - 1)",
    down="for {var} in {start}:-1:({stop} + 1)",
    loop_while="while {}",
    condition="if {}",
    otherwise="else",
    close="end",
    either="({} ? {} : {})",
    table=("const {name} = Float64[{body}]", "const {name} = Int[{body}]"),
    rows="const {name} = [{body}]",
    row="{}",
    between="; ",
    space=" ",
    no="({} == 0)",
    yes="({} != 0)",
    special=("NaN", "Inf"),
    prefix="kreisel_",
    reserved=frozenset({"begin", "end", "local", "function", "module", "quote", "let", "Body", "Base", "Core", "Main"}),
    first=1,
)
LANGUAGES = {dialect.name: dialect for dialect in (C, JAVASCRIPT, JULIA)}
