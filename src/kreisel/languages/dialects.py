"""Languages as data: a `Dialect` is all that `kreisel.languages` knows of one.

A file has a head (a comment), two types, the constants and the state of a body, and functions whose arguments are those
types, arrays and numbers.  A new language is a record here: no other module asks for a language by its name.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from dataclasses import fields as dataclass_fields
from typing import Any

import numpy as np

from kreisel.errors import InputError

KEPT = ("name", "suffix", "words", "reserved", "special", "single", "number", "number32", "first")


@dataclass(frozen=True)
class Dialect:
    """Templates of a language: {type} is the name of the body, {module} the same with capital letters.

    begin, finish  the text of a file before and behind its types and functions; {head} and {usage} are lines
    mark           what a line of {head} begins with
    types          of a type: its head, a field that is a number, one that is an array, its end
    function       the head of a function, its {arguments} joined by commas; {result} is one of `results`
    arguments      by kind: number, array, out (an array that is written), constants, new (constants), state, changed
    members        a field of a type that is a number, and an entry of one that is an array
    once, starts   a number with its final value, one that is assigned to later
    up             a loop over {count} integers {var}, {first} to {last}
    table, room    an array of constants, an array that is written later; without, loops over tables are written out
    give           the end of a function with a result, by its kind
    calls          operations that have no sign
    staged         the function of a step of several {stages}; `closing` in it calls its end
    more           the functions that are the same for all bodies, such as `advance`
    default        a default value of a parameter
    case, message  of {cases}: a text for each status of `check`
    joint          between declarations on one line, without `end` of the first and the beginning of the second
    note           a comment behind a declaration
    number         a number with its digits {}
    words          replaced for numbers of 32 bits, whose `number` is `number32`
    unused         a statement that uses an argument, if compilers warn of those that nothing uses
    """

    name: str
    suffix: str
    begin: str
    finish: str
    types: tuple[str, str, str, str]
    function: str
    results: Mapping[str, str]
    arguments: Mapping[str, str]
    members: tuple[str, str]
    once: str
    starts: str
    up: str
    table: str
    room: str
    give: Mapping[str, str]
    calls: Mapping[str, str]
    staged: str
    closing: str
    more: str
    default: tuple[str, str]
    case: str
    message: str
    mark: str = ""
    note: str = " /* {} */"
    joint: str = ", "
    end: str = ";"
    close: str = "}"
    special: tuple[str, str] = ("NAN", "INFINITY")
    number: str = "{}"
    number32: str = "{}"
    words: Mapping[str, str] = field(default_factory=dict)
    unused: str = ""
    single: bool = False
    first: int = 0
    reserved: frozenset[str] = field(default_factory=frozenset)

    def literal(self, value: float) -> str:
        """A number with all its digits."""
        nan, infinity = self.special
        if not math.isfinite(value):
            return nan if math.isnan(value) else f"{'-' * (value < 0)}{infinity}"
        return self.number.format(str(np.float32(value)) if self.single else repr(float(value)))

    def spelled(self, words: Mapping[str, str], **fields: Any) -> Dialect:
        """The language with words replaced in all templates."""

        def changed(x: Any) -> Any:
            if isinstance(x, str):
                for old, new in words.items():
                    x = x.replace(old, new)
                return x
            return {k: changed(v) for k, v in x.items()} if isinstance(x, Mapping) else tuple(map(changed, x))

        names = [f.name for f in dataclass_fields(self) if f.name not in KEPT]
        return replace(self, **({name: changed(getattr(self, name)) for name in names} | fields))

    def in_single(self) -> Dialect:
        """The language in numbers of 32 bits.  Raises `InputError` if it has none."""
        if self.single:
            return self
        if not self.words:
            raise InputError(f"single: expected a language with 32-bit floats, got {self.name}.")
        return self.spelled(self.words, single=True, number=self.number32)


SELECTS = {
    "max": "({1} > {0} ? {1} : {0})",
    "sign": "({0} < 0.0 ? -1.0 : 1.0)",
    "where": "({0} < {1} ? {2} : {3})",
}
C = Dialect(
    name="c",
    suffix=".h",
    begin="""/*
{head}

C99, and C++.  Compile with -ffp-contract=off, which keeps the bits, and -march=native -fno-math-errno for speed.
*/
#ifdef {type}_FILE
#if {type}_FILE != 0x{digest}
#error "two bodies are called {type}: give one of the files another name, kreisel code --name"
#endif
#else
#define {type}_FILE 0x{digest}
#include <math.h>

""",
    finish="#endif\n",
    types=(
        "typedef struct {{",
        "    double {name};{comment}",
        "    double {name}[{count}];{comment}",
        "}} {type}_{name};",
    ),
    function="static inline {result} {type}_{name}({arguments}) {{",
    results={"": "void", "number": "double", "status": "int"},
    arguments={
        "number": "double {name}",
        "array": "const double {name}[{count}]",
        "out": "double {name}[{count}]",
        "constants": "const {type}_constants *{name}",
        "new": "{type}_constants *{name}",
        "state": "const {type}_state *{name}",
        "changed": "{type}_state *{name}",
        "index": "int {name}",
    },
    members=("{object}->{name}", "{object}->{name}[{i}]"),
    once="const double {} = {};",
    starts="double {} = {};",
    up="for (int {var} = 0; {var} < {count}; {var}++) {{",
    table="static const double {name}[{count}] = {{{body}}};",
    room="double {name}[{count}];",
    give={"number": "return {};", "status": "return (int)({});"},
    calls={**SELECTS, "fma": "fma({0}, {1}, {2})", "sqrt": "sqrt({0})", "size": "fabs({0})", "nearest": "rint({0})"}
    | {name: f"{name}({{0}})" for name in ("sin", "cos", "exp", "log")},
    staged="""static inline void {type}_step(const {type}_constants *c, {type}_state *s) {{
    for (int k = 0; k < {stages}; k++) {type}_stage(c, s, k);{close}
}}
""",
    closing="\n    {type}_close(c, s);",
    more="""static inline void {type}_advance(const {type}_constants *c, {type}_state *s, long steps) {{
    const {type}_constants d = *c; /* copies that nothing else changes: 13 % faster */
    {type}_state t = *s;
    for (long i = 0; i < steps; i++) {type}_step(&d, &t);
    *s = t;
}}
""",
    unused="(void){};",
    number32="{}f",
    words={"double": "float", **{f"{name}(": f"{name}f(" for name in ("fma", "sqrt", "fabs", "rint")}},
    default=("static const double {type}_{name} = {body};", "static const double {type}_{name}[{count}] = {{{body}}};"),
    case='status == {status} ? "{text}" :\n        ',
    message="""static inline const char *{type}_message(int status) {{
    return {cases}"";
}}
""",
    reserved=frozenset(
        "auto break case char const continue default do double else enum extern float for goto if inline int long main "
        "register restrict return short signed sizeof static struct switch typedef union unsigned void volatile while "
        "fma fabs sqrt sin cos exp log".split()
    ),
)
CPP = replace(C, name="cpp", suffix=".hpp")
CUDA = C.spelled(
    {
        "static inline": "static __host__ __device__ inline",
        "static const double {name}": "const double {name}",
        "C99, and C++.  Compile with": "CUDA and HIP.  Compile with --fmad=false or",
    },
    name="cuda",
    suffix=".cuh",
)
JAVASCRIPT = Dialect(
    name="js",
    suffix=".mjs",
    begin="""/*
{head}

    import {{ Constants, State, prepare, step }} from "./{type}.mjs";
    const c = new Constants(), s = new State();

JavaScript has no fused product: where C rounds x y + z once, it rounds twice.
*/
""",
    finish="",
    types=(
        "export class {Name} {{\n    constructor() {{",
        "        this.{name} = 0;{comment}",
        "        this.{name} = new Float64Array({count});{comment}",
        "    }}\n}}",
    ),
    function="export function {name}({arguments}) {{",
    results={"": "", "number": "", "status": ""},
    arguments=dict.fromkeys(C.arguments, "{name}"),
    members=("{object}.{name}", "{object}.{name}[{i}]"),
    once="const {} = {};",
    starts="let {} = {};",
    up="for (let {var} = 0; {var} < {count}; {var}++) {{",
    table="const {name} = [{body}];",
    room="",
    give={"number": "return {};", "status": "return {};"},
    calls={**SELECTS, "fma": "({0} * {1} + {2})", "sqrt": "Math.sqrt({0})", "size": "Math.abs({0})"}
    | {name: f"Math.{name}({{0}})" for name in ("sin", "cos", "exp", "log")},
    staged="""export function step(c, s) {{
    for (let k = 0; k < {stages}; k++) stage(c, s, k);{close}
}}
""",
    closing="\n    close(c, s);",
    more="""export function advance(c, s, steps) {{
    for (let i = 0; i < steps; i++) step(c, s);
}}
""",
    default=("export const {name}_default = {body};", "export const {name}_default = [{body}];"),
    case=C.case,
    message="""export function message(status) {{
    return {cases}"";
}}
""",
    note=" // {}",
    special=("NaN", "Infinity"),
)
JULIA = Dialect(
    name="julia",
    suffix=".jl",
    begin="""#=
{head}

    include("{type}.jl"); using .{module}
    c, s = {module}.Constants(), {module}.State()
=#
module {module}

""",
    finish="end\n",
    types=(
        "Base.@kwdef mutable struct {Name}",
        "    {name}::Float64 = 0.0{comment}",
        "    {name}::Vector{{Float64}} = zeros({count}){comment}",
        "end",
    ),
    function="function {name}{result}({arguments})",
    results={"": "!", "number": "", "status": ""},
    arguments=dict.fromkeys(C.arguments, "{name}"),
    members=("{object}.{name}", "{object}.{name}[{i}]"),
    once="{} = {}",
    starts="{} = {}",
    up="for {var} in 1:{count}",
    table="{name} = ({body})",
    room="",
    give={"number": "return {}", "status": "return Int({})"},
    calls={**C.calls, "size": "abs({0})", "nearest": "round({0})"},
    staged="""function step!(c, s)
    for k in 1:{stages}
        stage!(c, s, k)
    end{close}
end
""",
    closing="\n    close!(c, s)",
    more="""function advance!(c, s, steps)
    for _ in 1:steps
        step!(c, s)
    end
    return s
end
""",
    default=("const {name}_default = {body}", "const {name}_default = [{body}]"),
    case=C.case,
    message="""function message(status)
    return {cases}""
end
""",
    note=" # {}",
    joint="; ",
    end="",
    close="end",
    special=("NaN", "Inf"),
    number32="Float32({})",
    words={"Float64": "Float32"},
    first=1,
    reserved=frozenset("begin end local function module quote let Base Core Main".split()),
)
LANGUAGES = {dialect.name: dialect for dialect in (C, CPP, CUDA, JAVASCRIPT, JULIA)}
