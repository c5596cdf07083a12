"""Languages as data: a `Dialect` is all that `kreisel.languages` knows of one.

A file has a head (a comment), two types, the constants and the state of a body, and functions whose arguments are those
types, arrays and numbers.  A new language is a record here: no other module asks for a language by its name.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from kreisel.errors import InputError

GROUPS = {
    "arguments": ("number", "array", "out", "read", "written", "index", "count", "status"),
    "results": ("", "number", "status", "text"),
    "calls": ("max", "sign", "where", "fma", "sqrt", "size", "nearest", "sin", "cos", "exp", "log"),
}


@dataclass(frozen=True)
class Dialect:
    """Forms of a language: {type} is the name of the body, {module} the name with capital letters."""

    name: str = ""
    begin: str = ""  # the text of a file before its types and functions; {head} is its comment
    finish: str = ""  # and behind them
    about: tuple[str, ...] = ()  # the end of {head}: lines of a program that uses the file, compilers
    mark: str = ""  # the beginning of a line of {head}
    types: tuple[str, ...] = ()  # of a type: its head, a field that is a number, one that is an array, its end
    zeros: tuple[str, ...] = ("", "")  # a field of 0 in the end of a type, as {zeros}
    function: str = ""  # the head of a function, {arguments} joined by commas; {result} is one of `results`
    call: str = ""
    results: Mapping[str, str] = field(default_factory=dict)
    arguments: Mapping[str, str] = field(default_factory=dict)  # by kind; {of}: constants, state
    members: tuple[str, ...] = ()  # a field of a type that is a number, and an entry of one that is an array
    once: str = ""  # a number with its final value
    starts: str = ""  # a number that is assigned to later
    up: str = ""  # a loop over {count} integers {var} of the type {integer}
    leave: str = ""  # the end of a loop if the first number is at most the second
    table: str = ""  # an array of constants
    room: str = ""  # an array that is written later; without, loops over tables are written out
    give: str = "return {};"  # the end of a function with a result
    status: str = ""  # a number as an integer
    calls: Mapping[str, str] = field(default_factory=dict)  # operations that have no sign
    case: str = ""  # the statement that returns {text} for a {status}
    local: tuple[str, ...] = ()  # of a loop over steps: statements before it, arguments, statements behind it
    default: tuple[str, ...] = ()  # a default value of a parameter: a number, an array
    joint: str = ", "  # between declarations on a line, without `end` of the first and the beginning of the second
    end: str = ";"
    close: str = "}"
    note: str = ""  # a comment behind a declaration
    special: str = "NAN INFINITY"
    number: str = "{}"  # a number with its digits
    number32: str = "{}"  # of 32 bits; `words` are replaced then, `renamed` always
    words: Mapping[str, str] = field(default_factory=dict)
    renamed: Mapping[str, str] = field(default_factory=dict)
    unused: str = ""  # a statement that uses an argument, if compilers warn of those that nothing uses
    single: bool = False
    first: int = 0  # the index of the first entry of an array
    reserved: str = ""  # names in small letters that a body cannot have
    keywords: str = ""  # names that its parameters cannot have

    def literal(self, value: float) -> str:
        """A number with all its digits."""
        nan, infinity = self.special.split()
        if not math.isfinite(value):
            return nan if math.isnan(value) else f"{'-' * (value < 0)}{infinity}"
        return self.number.format(str(np.float32(value)) if self.single else repr(float(value)))

    def in_single(self) -> Dialect:
        """The language in numbers of 32 bits.  Raises `InputError` if it has none."""
        if not (self.single or self.words):
            raise InputError(f"single: expected a language with 32-bit floats, got {self.name}.")
        return replace(self, single=True, number=self.number32, renamed={**self.renamed, **self.words})


WORDS = (  # keywords of C and C++
    "auto bool break case catch char class const continue default delete do double else enum explicit export extern "
    "false float for friend goto if inline int long namespace new not operator or private protected public register "
    "return short signed sizeof static struct switch template this throw true try typedef typename union unsigned "
    "using virtual void volatile while "
)
SELECTS = "({1} > {0} ? {1} : {0})|({0} < 0.0 ? -1.0 : 1.0)|({0} < {1} ? {2} : {3})"
FUSED, TWICE = "|fma({0}, {1}, {2})", "|(({0}) * ({1}) + ({2}))"
ROOTS, NAMED = "|sqrt({0})|abs({0})|round({0})", "|sin({0})|cos({0})|exp({0})|log({0})"
HALF = "(({0}) + 6755399441055744.0 - 6755399441055744.0)"  # 1.5 * 2^52: the last place is 1
PYTHONIC = "({1} if {1} > {0} else {0})|(-1.0 if {0} < 0.0 else 1.0)|({2} if {0} < {1} else {3})" + TWICE
ROUNDED = "where C rounds x y + z once, it rounds twice."
COMMENT = "/*\n{head}\n*/\n"
FLAGS = "-ffp-contract=off for the bits, -O2 -march=native -fno-math-errno for speed."


def _language(base: Dialect, forms: Mapping[str, str], **stated: Any) -> Dialect:
    """A language that differs from another one; `forms`: names of fields -> their forms, between bars."""
    fields: dict[str, Any] = {**stated}
    for names, text in forms.items():
        values = text.split("|")
        if names in GROUPS:
            fields[names] = {k: v for k, v in zip(GROUPS[names], values, strict=False) if v or names != "calls"}
        elif " " in names:
            fields |= dict(zip(names.split(), values, strict=True))
        else:
            fields[names] = text if isinstance(getattr(base, names), str) else tuple(values)
    return replace(base, **fields)


C = _language(
    Dialect(),
    {
        "begin": COMMENT
        + """#ifdef {type}_FILE
#if {type}_FILE != 0x{digest}
#error "two bodies are called {type}: give one of the files another name, kreisel code --name"
#endif
#else
#define {type}_FILE 0x{digest}
#include <math.h>

""",
        "about": f"|C99, and C++.  Compile with {FLAGS}",
        "name finish note": "c|#endif\n| /* {} */",
        "types": "typedef struct {{|    double {name};{comment}|    double {name}[{count}];{comment}|}} {type}_{name};",
        "function call": "static inline {result} {type}_{name}({arguments}) {{|{type}_{name}({arguments});",
        "results": "void|double|int|const char *",
        "arguments": "double {name}|const double {name}[{count}]|double {name}[{count}]|const {type}_{of} *{name}|"
        "{type}_{of} *{name}|int {name}|long {name}|int {name}",
        "members": "{object}->{name}|{object}->{name}[{i}]",
        "once starts": "const double {} = {};|double {} = {};",
        "table room": "static const double {name}[{count}] = {{{body}}};|double {name}[{count}];",
        "up": "for ({integer} {var} = 0; {var} < {count}; {var}++) {{",
        "leave": "if ({} <= {}) break;",
        "status case": '(int)({})|if (status == {status}) return "{text}";',
        "local": "const {type}_constants d = *c; {type}_state t = *s; /* copies: 13 % faster */|&d, &t|*s = t;",
        "default": "static const double {type}_{name} = {body};|"
        "static const double {type}_{name}[{count}] = {{{body}}};",
        "number32 unused": "{}f|(void){};",
        "keywords": WORDS,
        "calls": SELECTS + FUSED + "|sqrt({0})|fabs({0})|rint({0})" + NAMED,
    },
    words={"double ": "float ", **{f"{name}(": f"{name}f(" for name in ("fma", "sqrt", "fabs", "rint")}},
)
CPP = replace(C, name="cpp")
CUDA = replace(
    C,
    name="cuda",
    about=("", f"CUDA and HIP.  Compile with --fmad=false or {FLAGS}"),
    renamed={"static inline": "static __host__ __device__ inline", "    static const": "    const"},
)
RUST = _language(
    C,
    {
        "begin": """{head}
#![allow(non_snake_case, non_upper_case_globals, unexpected_cfgs, unused, clippy::all)]
#[cfg(feature = "libm")]
use num_traits::Float as _;

#[inline(always)]
fn fma(x: f64, y: f64, z: f64) -> f64 {{ x.mul_add(y, z) }}

""",
        "about": "|    mod {type};|    let (mut c, mut s) = ({type}::Constants::default(), {type}::State::default());||"
        "Rust 2021.  In a crate without std, enable a feature `libm` that depends on num-traits/libm.  "
        "Compile with -C target-cpu=native for speed; the bits are those of C in any case.",
        "name finish mark note": "rust||//! | // {}",
        "types": "#[derive(Clone, Copy, Debug)]\npub struct {Name} {{|    pub {name}: f64,{comment}|"
        "    pub {name}: [f64; {count}],{comment}|}}\n\n"  # arrays of more than 32 have no Default to derive
        "impl Default for {Name} {{\n    fn default() -> Self {{\n        Self {{ {zeros} }}\n    }}\n}}",
        "zeros": "{name}: 0.0|{name}: [0.0; {count}]",
        "function call": "pub fn {name}({arguments}){result} {{|{name}({arguments});",
        "results": "| -> f64| -> i32| -> &'static str",
        "arguments": "{name}: f64|{name}: &[f64; {count}]|{name}: &mut [f64; {count}]|{name}: &{Of}|{name}: &mut {Of}|"
        "{name}: usize|{name}: u64|{name}: i32",
        "members": "{object}.{name}|{object}.{name}[{i}]",
        "once starts joint": "let {} = {};|let mut {}: f64 = {};|; let ",
        "table room": "static {name}: [f64; {count}] = [{body}];|let mut {name} = [0.0; {count}];",
        "up": "for {var} in 0..{count} {{",
        "leave": "if {} <= {} {{ break; }}",
        "status case": '({}) as i32|if status == {status} {{ return "{text}"; }}',
        "local": "|c, s|",
        "default": "pub const default_{name}: f64 = {body};|pub const default_{name}: [f64; {count}] = [{body}];",
        "number32 unused special": "{}||f64::NAN f64::INFINITY",
        "reserved": "crate self super mod fn let mut pub use impl struct enum type match loop move ref",
        "keywords": WORDS
        + "as async await box crate dyn final fn impl in let loop match mod move mut pub ref self super trait "
        "type unsafe use where yield",
        "calls": "(if {1} > {0} {{ {1} }} else {{ {0} }})|(if {0} < 0.0 {{ -1.0 }} else {{ 1.0 }})|"
        "(if {0} < {1} {{ {2} }} else {{ {3} }})" + FUSED + f"|({{0}}).sqrt()|({{0}}).abs()|{HALF}|"
        "({0}).sin()|({0}).cos()|({0}).exp()|({0}).ln()",
    },
    words={"f64": "f32"},
)
JAVASCRIPT = _language(
    RUST,
    {
        "begin": COMMENT + "const {{ sqrt, abs, sin, cos, exp, log }} = Math;\n\n",
        "about": '|    import {{ Constants, State, prepare, step }} from "./{type}.mjs";|'
        f"    const c = new Constants(), s = new State();||JavaScript has no fused product: {ROUNDED}",
        "name mark case leave": f"js||{C.case}|{C.leave}",
        "types": "export class {Name} {{\n    constructor() {{|        this.{name} = 0;{comment}|"
        "        this.{name} = new Float64Array({count});{comment}|    }}\n}}",
        "function call": "export function {name}({arguments}) {{|{name}({arguments});",
        "results": "|||",
        "once starts joint": "const {} = {};|let {} = {};|, ",
        "room status special reserved": "|{}|NaN Infinity|",
        "keywords": WORDS
        + "arguments await eval extends finally function import in instanceof let null super typeof var",
        "up": "for (let {var} = 0; {var} < {count}; {var}++) {{",
        "default": "export const {name}_default = {body};|export const {name}_default = [{body}];",
        "calls": f"{SELECTS}|({{0}} * {{1}} + {{2}})|sqrt({{0}})|abs({{0}})|{NAMED}",
    },
    arguments=dict.fromkeys(GROUPS["arguments"], "{name}"),
    words={},
)
CSHARP = _language(
    JAVASCRIPT,
    {
        "begin": COMMENT + "using static System.Math;\n\npublic static class {module} {{\n\n",
        "about": "|    var c = new {module}.Constants();|    var s = new {module}.State();||"
        f"C# 6 and later, without unsafe code; a step allocates nothing; {ROUNDED}",
        "name finish": "csharp|}}\n",
        "types": "public sealed class {Name} {{|    public double {name};{comment}|"
        "    public readonly double[] {name} = new double[{count}];{comment}|}}",
        "function": "public static {result} {name}({arguments}) {{",
        "results": "void|double|int|string",
        "arguments": "double {name}|double[] {name}|double[] {name}|{Of} {name}|{Of} {name}|"
        "int {name}|long {name}|int {name}",
        "once starts": "double {} = {};|double {} = {};",
        "up status special": f"{C.up}|{C.status}|double.NaN double.PositiveInfinity",
        "reserved": "system constants state",
        "keywords": WORDS
        + "abstract as base byte decimal event fixed foreach in interface internal is lock null object out "
        "override params readonly ref sealed string",
        "default": "public const double default_{name} = {body};|"
        "public static readonly double[] default_{name} = {{ {body} }};",
        "calls": SELECTS + TWICE + "|Sqrt({0})|Abs({0})|Round({0})|Sin({0})|Cos({0})|Exp({0})|Log({0})",
    },
    renamed={"[] out": "[] values", " out[": " values["},  # `out` is a keyword
)
JULIA = _language(
    JAVASCRIPT,
    {
        "begin": "#=\n{head}\n=#\nmodule {module}\n\n",
        "about": '|    include("{type}.jl"); using .{module}|    c, s = {module}.Constants(), {module}.State()',
        "name finish note": "julia|end\n| # {}",
        "types": "Base.@kwdef mutable struct {Name}|    {name}::Float64 = 0.0{comment}|"
        "    {name}::Vector{{Float64}} = zeros({count}){comment}|end",
        "function call": "function {name}{result}({arguments})|{name}!({arguments})",
        "results": "!|||",
        "once starts joint": "{} = {}|{} = {}|; ",
        "up end close leave": "for {var} in 1:{count}||end|{} <= {} && break",
        "give status case": 'return {}|Int({})|status == {status} && return "{text}"',
        "default": "const {name}_default = {body}|const {name}_default = [{body}]",
        "special number32 reserved": "NaN Inf|Float32({})|base core main constants state",
        "keywords": WORDS + "begin elseif end finally function global import let local macro module quote",
        "calls": SELECTS + FUSED + ROOTS + NAMED,
    },
    words={"Float64": "Float32"},
    first=1,
)
PYTHON = _language(
    JAVASCRIPT,
    {
        "begin": '"""{head}\n"""\n\nfrom math import cos, exp, log, sin, sqrt\n\n',
        "about": "|    import {type}|    c, s = {type}.Constants(), {type}.State()||"
        f"Python without packages; {ROUNDED}",
        "name note": "python|  # {}",
        "types": "class {Name}:\n    def __init__(self):|        self.{name} = 0.0{comment}|"
        "        self.{name} = [0.0] * {count}{comment}|",
        "function call": "def {name}({arguments}):|{name}({arguments})",
        "once starts joint": "{} = {}|{} = {}|; ",
        "up end close leave": "for {var} in range({count}):|||if {} <= {}: break",
        "give status case": 'return {}|int({})|if status == {status}: return "{text}"',
        "default": "default_{name} = {body}|default_{name} = ({body},)",
        "special": "float('nan') float('inf')",
        "reserved": "and as class def del from global import in is lambda not or pass with yield",
        "keywords": "",
        "calls": PYTHONIC + ROOTS + NAMED,
    },
)
GDSCRIPT = _language(
    PYTHON,
    {
        "begin": "{head}\nclass_name {module}\n\n",
        "about": "|    var c := {module}.Constants.new()|    var s := {module}.State.new()||"
        f"GDScript of Godot 4, whose floats have 64 bits; {ROUNDED}",
        "name mark": "gdscript|# ",
        "types": "class {Name}:|    var {name} := 0.0{comment}|"
        "    var {name} := PackedFloat64Array([{zeros}]){comment}|",
        "function": "static func {name}({arguments}) -> {result}:",
        "results": "void|float|int|String",
        "arguments": "{name}: float|{name}: PackedFloat64Array|{name}: PackedFloat64Array|{name}: {Of}|{name}: {Of}|"
        "{name}: int|{name}: int|{name}: int",
        "once starts joint": "var {} := {}|var {} := {}|; var ",
        "up special reserved": "for {var} in {count}:|NAN INF|constants state",
        "keywords": WORDS + "await breakpoint extends func match preload self signal super trait var",
        "default": "const default_{name} := {body}|const default_{name}: Array[float] = [{body}]",
        "calls": f"{PYTHONIC}|sqrt({{0}})|absf({{0}})|{HALF}{NAMED}",
    },
)
WGSL = _language(
    RUST,
    {
        "begin": "{head}\n\n",
        "about": "|    var c: {type}_constants;|    var s: {type}_state;||WGSL, in single precision.",
        "name mark": "wgsl|// ",
        "types": "struct {type}_{name} {{|    {name}: f32,{comment}|    {name}: array<f32, {count}>,{comment}|}}",
        "function call": f"fn {{type}}_{{name}}({{arguments}}){{result}} {{{{|{C.call}",
        "results": "| -> f32| -> i32",  # it has no texts
        "arguments": "{name}: f32|{name}: array<f32, {count}>|{name}: ptr<function, array<f32, {count}>>|"
        "{name}: ptr<function, {type}_{of}>|{name}: ptr<function, {type}_{of}>|{name}: i32|{name}: i32|{name}: i32",
        "members": "(*{object}).{name}|(*{object}).{name}[{i}]",
        "starts special": f"var {{}} = {{}};|{C.special}",
        "table room": "var {name} = array<f32, {count}>({body});|var {name}: array<f32, {count}>;",
        "up status": "for (var {var} = 0; {var} < {count}; {var}++) {{|i32({})",
        "default": "const {type}_{name}: f32 = {body};|const {type}_{name} = array<f32, {count}>({body});",
        "number number32 reserved": "{}f|{}f|",
        "calls": "max({0}, {1})|select(1.0, -1.0, {0} < 0.0)|select({3}, {2}, {0} < {1})" + FUSED + ROOTS + NAMED,
    },
    words={},
    single=True,
)
LANGUAGES = {d.name: d for d in (C, CPP, CUDA, RUST, CSHARP, JAVASCRIPT, JULIA, GDSCRIPT, PYTHON, WGSL)}
