"""Rust, C#, GDScript, WGSL and Python as data."""

from __future__ import annotations

from dataclasses import replace

from kreisel.languages.dialects import JAVASCRIPT, SELECTS, C, Dialect

PYTHONIC = {
    "max": "({1} if {1} > {0} else {0})",
    "sign": "(-1.0 if {0} < 0.0 else 1.0)",
    "where": "({2} if {0} < {1} else {3})",
    "fma": "(({0}) * ({1}) + ({2}))",
}
HALF = "6755399441055744.0"  # 1.5 * 2^52: the last place is 1
FUNCTIONS = ("sin", "cos", "exp", "log")
ROUNDED = "Where C rounds x y + z once, it rounds twice."
RUST = Dialect(
    name="rust",
    suffix=".rs",
    mark="//! ",
    begin="""{head}
//!
//!     mod {type};
//!     let (mut c, mut s) = ({type}::Constants::default(), {type}::State::default());
//!
//! Rust 2021.  In a crate without std, enable a feature `libm` that depends on num-traits/libm.  Compile with
//! -C target-cpu=native for speed; the bits are those of C in any case.
#![allow(non_snake_case, non_upper_case_globals, unexpected_cfgs, unused, clippy::all)]
#[cfg(feature = "libm")]
use num_traits::Float as _;

#[inline(always)]
fn fma(x: f64, y: f64, z: f64) -> f64 {{
    x.mul_add(y, z)
}}

""",
    finish="",
    types=(
        "#[derive(Clone, Copy, Debug, Default)]\npub struct {Name} {{",
        "    pub {name}: f64,{comment}",
        "    pub {name}: [f64; {count}],{comment}",
        "}}",
    ),
    function="pub fn {name}({arguments}){result} {{",
    results={"": "", "number": " -> f64", "status": " -> i32"},
    arguments={
        "number": "{name}: f64",
        "array": "{name}: &[f64; {count}]",
        "out": "{name}: &mut [f64; {count}]",
        "constants": "{name}: &Constants",
        "new": "{name}: &mut Constants",
        "state": "{name}: &State",
        "changed": "{name}: &mut State",
        "index": "{name}: usize",
    },
    members=("{object}.{name}", "{object}.{name}[{i}]"),
    once="let {} = {};",
    starts="let mut {}: f64 = {};",
    joint="; let ",
    up="for {var} in 0..{count} {{",
    table="static {name}: [f64; {count}] = [{body}];",
    room="let mut {name} = [0.0; {count}];",
    give={"number": "return {};", "status": "return ({}) as i32;"},
    calls={
        "max": "(if {1} > {0} {{ {1} }} else {{ {0} }})",
        "sign": "(if {0} < 0.0 {{ -1.0 }} else {{ 1.0 }})",
        "where": "(if {0} < {1} {{ {2} }} else {{ {3} }})",
        "fma": "fma({0}, {1}, {2})",
        "sqrt": "({0}).sqrt()",
        "size": "({0}).abs()",
        "nearest": f"(({{0}}) + {HALF} - {HALF})",
        "log": "({0}).ln()",
    }
    | {name: f"({{0}}).{name}()" for name in ("sin", "cos", "exp")},
    staged="""pub fn step(c: &Constants, s: &mut State) {{
    for k in 0..{stages} {{
        stage(c, s, k);
    }}{close}
}}
""",
    closing="\n    close(c, s);",
    more="""pub fn advance(c: &Constants, s: &mut State, steps: u64) {{
    for _ in 0..steps {{
        step(c, s);
    }}
}}
""",
    default=("pub const default_{name}: f64 = {body};", "pub const default_{name}: [f64; {count}] = [{body}];"),
    case='        {status} => "{text}",\n',
    message="""pub fn message(status: i32) -> &'static str {{
    match status {{
{cases}        _ => "",
    }}
}}
""",
    note=" // {}",
    special=("f64::NAN", "f64::INFINITY"),
    reserved=frozenset("crate self super mod fn let mut pub use impl struct enum type match loop move ref".split()),
    words={"f64": "f32"},
)
CSHARP = replace(
    JAVASCRIPT,
    name="csharp",
    suffix=".cs",
    begin=f"""/*
{{head}}

    var c = new {{module}}.Constants();
    var s = new {{module}}.State();

C# 6 and later, without unsafe code; a step allocates nothing.  {ROUNDED}
*/
public static class {{module}} {{{{

""",
    finish="}}\n",
    types=(
        "public sealed class {Name} {{",
        "    public double {name};{comment}",
        "    public readonly double[] {name} = new double[{count}];{comment}",
        "}}",
    ),
    function="public static {result} {name}({arguments}) {{",
    results=C.results,
    arguments={
        **dict.fromkeys(("array", "out"), "double[] {name}"),
        **dict.fromkeys(("constants", "new"), "Constants {name}"),
        **dict.fromkeys(("state", "changed"), "State {name}"),
        "number": "double {name}",
        "index": "int {name}",
    },
    once="double {} = {};",
    starts="double {} = {};",
    up=C.up,
    give=C.give,
    calls={
        **SELECTS,
        "fma": "(({0}) * ({1}) + ({2}))",
        "size": "System.Math.Abs({0})",
        "nearest": "System.Math.Round({0})",
        **{name: f"System.Math.{name.capitalize()}({{0}})" for name in ("sqrt", *FUNCTIONS)},
    },
    staged=JAVASCRIPT.staged.replace(
        "export function step(c, s)", "public static void step(Constants c, State s)"
    ).replace("let k", "int k"),
    more="""public static void advance(Constants c, State s, long steps) {{
    for (long i = 0; i < steps; i++) step(c, s);
}}
""",
    default=(
        "public const double default_{name} = {body};",
        "public static readonly double[] default_{name} = {{ {body} }};",
    ),
    message=JAVASCRIPT.message.replace("export function message(status)", "public static string message(int status)"),
    special=("double.NaN", "double.PositiveInfinity"),
    words={},
    reserved=frozenset("base checked class decimal event fixed lock namespace object params string unsafe".split()),
)
PYTHON = replace(
    JAVASCRIPT,
    name="python",
    suffix=".py",
    begin=f'''"""{{head}}

    import {{type}}
    c, s = {{type}}.Constants(), {{type}}.State()

Python without packages.  {ROUNDED}
"""

from math import cos, exp, log, sin, sqrt

''',
    types=(
        "class {Name}:\n    def __init__(self):",
        "        self.{name} = 0.0{comment}",
        "        self.{name} = [0.0] * {count}{comment}",
        "",
    ),
    function="def {name}({arguments}):",
    once="{} = {}",
    starts="{} = {}",
    up="for {var} in range({count}):",
    give={"number": "return {}", "status": "return int({})"},
    calls={**PYTHONIC, "sqrt": "sqrt({0})", "size": "abs({0})", "nearest": "round({0})"}
    | {name: f"{name}({{0}})" for name in FUNCTIONS},
    staged="""def step(c, s):
    for k in range({stages}):
        stage(c, s, k){close}
""",
    closing="\n    close(c, s)",
    more="""def advance(c, s, steps):
    for _ in range(steps):
        step(c, s)
""",
    default=("default_{name} = {body}", "default_{name} = ({body},)"),
    case='    if status == {status}:\n        return "{text}"\n',
    message="""def message(status):
{cases}    return ""
""",
    note="  # {}",
    joint="; ",
    end="",
    close="",
    special=("float('nan')", "float('inf')"),
    words={},
    reserved=frozenset("and as class def del from global import in is lambda not or pass with yield".split()),
)
GDSCRIPT = replace(
    PYTHON,
    name="gdscript",
    suffix=".gd",
    mark="# ",
    begin="""{head}
#
#     var c := {module}.Constants.new()
#     var s := {module}.State.new()
#
# GDScript of Godot 4, whose floats have 64 bits.  Where C rounds x y + z once, it rounds twice.
class_name {module}

""",
    types=(
        "class {Name}:",
        "    var {name} := 0.0{comment}",
        "    var {name}: PackedFloat64Array = zeros({count}){comment}",
        """
    static func zeros(count: int) -> PackedFloat64Array:
        var out := PackedFloat64Array()
        out.resize(count)
        return out
""",
    ),
    function="static func {name}({arguments}) -> {result}:",
    results={"": "void", "number": "float", "status": "int"},
    arguments={
        **dict.fromkeys(("array", "out"), "{name}: PackedFloat64Array"),
        **dict.fromkeys(("constants", "new"), "{name}: Constants"),
        **dict.fromkeys(("state", "changed"), "{name}: State"),
        "number": "{name}: float",
        "index": "{name}: int",
    },
    once="var {} := {}",
    starts="var {} := {}",
    joint="; var ",
    up="for {var} in {count}:",
    calls={**PYTHONIC, "sqrt": "sqrt({0})", "size": "absf({0})", "nearest": f"(({{0}}) + {HALF} - {HALF})"}
    | {name: f"{name}({{0}})" for name in FUNCTIONS},
    staged="""static func step(c: Constants, s: State) -> void:
    for k in {stages}:
        stage(c, s, k){close}
""",
    more="""static func advance(c: Constants, s: State, steps: int) -> void:
    for i in steps:
        step(c, s)
""",
    default=("const default_{name} := {body}", "const default_{name}: Array[float] = [{body}]"),
    message="""static func message(status: int) -> String:
{cases}    return ""
""",
    special=("NAN", "INF"),
    reserved=frozenset("and as class extends func in is not or pass self signal static super var".split()),
)
WGSL = Dialect(
    name="wgsl",
    suffix=".wgsl",
    mark="// ",
    begin="""{head}
//
//     var c: {type}_constants;
//     var s: {type}_state;
//
// WGSL, in single precision.

""",
    finish="",
    types=("struct {type}_{name} {{", "    {name}: f32,{comment}", "    {name}: array<f32, {count}>,{comment}", "}}"),
    function="fn {type}_{name}({arguments}){result} {{",
    results={"": "", "number": " -> f32", "status": " -> i32"},
    arguments={
        "number": "{name}: f32",
        "array": "{name}: array<f32, {count}>",
        "out": "{name}: ptr<function, array<f32, {count}>>",
        **dict.fromkeys(("constants", "new"), "{name}: ptr<function, {type}_constants>"),
        **dict.fromkeys(("state", "changed"), "{name}: ptr<function, {type}_state>"),
        "index": "{name}: i32",
    },
    members=("(*{object}).{name}", "(*{object}).{name}[{i}]"),
    once="let {} = {};",
    starts="var {} = {};",
    joint="; let ",
    up="for (var {var} = 0; {var} < {count}; {var}++) {{",
    table="var {name} = array<f32, {count}>({body});",
    room="var {name}: array<f32, {count}>;",
    give={"number": "return {};", "status": "return i32({});"},
    calls={
        "max": "max({0}, {1})",
        "sign": "select(1.0, -1.0, {0} < 0.0)",
        "where": "select({3}, {2}, {0} < {1})",
        "fma": "fma({0}, {1}, {2})",
        "sqrt": "sqrt({0})",
        "size": "abs({0})",
        "nearest": "round({0})",
    }
    | {name: f"{name}({{0}})" for name in FUNCTIONS},
    staged="""fn {type}_step(c: ptr<function, {type}_constants>, s: ptr<function, {type}_state>) {{
    for (var k = 0; k < {stages}; k++) {{ {type}_stage(c, s, k); }}{close}
}}
""",
    closing="\n    {type}_close(c, s);",
    more="""fn {type}_advance(c: ptr<function, {type}_constants>, s: ptr<function, {type}_state>, steps: i32) {{
    for (var i = 0; i < steps; i++) {{ {type}_step(c, s); }}
}}
""",
    default=("const {type}_{name}: f32 = {body};", "const {type}_{name} = array<f32, {count}>({body});"),
    case="",
    message="",
    note=" // {}",
    number="{}f",
    single=True,
    reserved=frozenset("fn let var struct loop switch discard enable override ptr array".split()),
)
LANGUAGES = {dialect.name: dialect for dialect in (RUST, CSHARP, GDSCRIPT, PYTHON, WGSL)}
