"""Programs that move bodies by the file of a free body, in each language that can be run.

Each program has a table of bodies: the tensor (xx, yy, zz, yz, zx, xy), attitude, angular velocity in space, step,
steps a row.  It prints rows of q and w, then the energy after a kick by w, and the message for the step 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import compilers


@dataclass(frozen=True)
class Program:
    """Compilers, names of the two files, the program around {table} and {rows}, brackets of an array."""

    compilers: tuple[str, ...]
    file: str
    main: str
    text: str
    brackets: str = "[]"
    numbers: tuple[str, str] = ("", "")  # types of 64 and 32 bits


C = """#include "rock.h"
#include <stdio.h>
static const double X[][15] = {table};
int main(void) {
    rock_constants c;
    rock_state s;
    NUMBER T[6], q[4], w[3], I[3], axes[4];
    for (unsigned k = 0; k < sizeof X / sizeof X[0]; k++) {
        const double *x = X[k];
        for (int i = 0; i < 6; i++) T[i] = (NUMBER)x[i];
        for (int i = 0; i < 4; i++) q[i] = (NUMBER)x[6 + i];
        for (int i = 0; i < 3; i++) w[i] = (NUMBER)x[10 + i];
        rock_principal(T, I, axes);
        if (rock_check(I, (NUMBER)x[13])) return 1;
        rock_prepare(&c, I, (NUMBER)x[13]);
        rock_set_motion(&c, &s, axes, q, w);
        for (int row = 0; row <= {rows}; row++) {
            if (row) rock_advance(&c, &s, (long)x[14]);
            if (rock_reach(&c, &s) > 1) return 2;
            rock_get_motion(&c, &s, axes, q, w);
            printf("%.17g %.17g %.17g %.17g %.17g %.17g %.17g\\n", q[0], q[1], q[2], q[3], w[0], w[1], w[2]);
        }
    }
    rock_kick(&s, w);
    printf("%.17g %s\\n", rock_energy(&c, &s), rock_message(rock_check(I, 0)));
    return 0;
}
"""
JAVASCRIPT = """import * as rock from "./rock.mjs";
const c = new rock.Constants(), s = new rock.State(), I = [0, 0, 0], axes = [0, 0, 0, 0];
let q, w;
for (const x of {table}) {
    q = x.slice(6, 10), w = x.slice(10, 13);
    rock.principal(x.slice(0, 6), I, axes);
    if (rock.check(I, x[13])) throw new Error(rock.message(rock.check(I, x[13])));
    rock.prepare(c, I, x[13]);
    rock.set_motion(c, s, axes, q, w);
    for (let row = 0; row <= {rows}; row++) {
        if (row) rock.advance(c, s, x[14]);
        if (rock.reach(c, s) > 1) throw new Error("reach");
        rock.get_motion(c, s, axes, q, w);
        console.log(...q, ...w);
    }
}
rock.kick(s, w);
console.log(rock.energy(c, s), rock.message(rock.check(I, 0)));
"""
PYTHON = """import rock
c, s, I, axes = rock.Constants(), rock.State(), [0.0] * 3, [0.0] * 4
for x in {table}:
    q, w = x[6:10], x[10:13]
    rock.principal(x[:6], I, axes)
    assert rock.check(I, x[13]) == 0
    rock.prepare(c, I, x[13])
    rock.set_motion(c, s, axes, q, w)
    for row in range({rows} + 1):
        if row:
            rock.advance(c, s, int(x[14]))
        assert rock.reach(c, s) <= 1
        rock.get_motion(c, s, axes, q, w)
        print(*q, *w)
rock.kick(s, w)
print(rock.energy(c, s), rock.message(rock.check(I, 0.0)))
"""
RUST = """mod rock;
fn main() {
    let (mut c, mut s) = (rock::Constants::default(), rock::State::default());
    let (mut moments, mut axes) = ([0.0; 3], [0.0; 4]);
    let (mut q, mut w): ([NUMBER; 4], [NUMBER; 3]) = ([0.0; 4], [0.0; 3]);
    for x in {table} {
        let x = x.map(|y: f64| y as NUMBER);
        q.copy_from_slice(&x[6..10]);
        w.copy_from_slice(&x[10..13]);
        rock::principal(x[..6].try_into().unwrap(), &mut moments, &mut axes);
        assert_eq!(rock::check(&moments, x[13]), 0);
        rock::prepare(&mut c, &moments, x[13]);
        rock::set_motion(&c, &mut s, &axes, &q, &w);
        for row in 0..={rows} {
            if row > 0 {
                rock::advance(&c, &mut s, x[14] as u64);
            }
            assert!(rock::reach(&c, &s) <= 1.0);
            rock::get_motion(&c, &s, &axes, &mut q, &mut w);
            for x in q.iter().chain(&w) {
                print!("{:e} ", *x as f64);
            }
            println!();
        }
    }
    rock::kick(&mut s, &w);
    println!("{:e} {}", rock::energy(&c, &s), rock::message(rock::check(&moments, 0.0)));
}
"""
CSHARP = """public static class Program {
    static string Text(double x) { return x.ToString("R", System.Globalization.CultureInfo.InvariantCulture) + " "; }
    public static int Main() {
        var c = new Rock.Constants();
        var s = new Rock.State();
        double[] I = new double[3], axes = new double[4], T = new double[6], q = new double[4], w = new double[3];
        double[,] X = {table};
        for (int k = 0; k < X.GetLength(0); k++) {
            for (int i = 0; i < 6; i++) T[i] = X[k, i];
            for (int i = 0; i < 4; i++) q[i] = X[k, 6 + i];
            for (int i = 0; i < 3; i++) w[i] = X[k, 10 + i];
            Rock.principal(T, I, axes);
            if (Rock.check(I, X[k, 13]) != 0) return 1;
            Rock.prepare(c, I, X[k, 13]);
            Rock.set_motion(c, s, axes, q, w);
            for (int row = 0; row <= {rows}; row++) {
                if (row > 0) Rock.advance(c, s, (long)X[k, 14]);
                if (Rock.reach(c, s) > 1) return 2;
                Rock.get_motion(c, s, axes, q, w);
                foreach (var y in q) System.Console.Write(Text(y));
                foreach (var y in w) System.Console.Write(Text(y));
                System.Console.WriteLine();
            }
        }
        Rock.kick(s, w);
        System.Console.WriteLine(Text(Rock.energy(c, s)) + Rock.message(Rock.check(I, 0.0)));
        return 0;
    }
}
"""
JULIA = """include("rock.jl")
using .Rock
function main()
    c, s = Rock.Constants(), Rock.State()
    moments, axes, q, w = zeros(NUMBER, 3), zeros(NUMBER, 4), zeros(NUMBER, 4), zeros(NUMBER, 3)
    for x in {table}
        x = NUMBER.(x)
        q .= x[7:10]
        w .= x[11:13]
        Rock.principal!(x[1:6], moments, axes)
        Rock.check(moments, x[14]) == 0 || error("check")
        Rock.prepare!(c, moments, x[14])
        Rock.set_motion!(c, s, axes, q, w)
        for row in 0:{rows}
            row > 0 && Rock.advance!(c, s, Int(x[15]))
            Rock.reach(c, s) <= 1 || error("reach")
            Rock.get_motion!(c, s, axes, q, w)
            println(join(Float64.([q; w]), " "))
        end
    end
    Rock.kick!(s, w)
    println(Rock.energy(c, s), " ", Rock.message(Rock.check(moments, zero(NUMBER))))
end
main()
"""
GDSCRIPT = """extends SceneTree
const Rock = preload("res://rock.gd")

# Godot prints 15 digits of a number.
func text(values: PackedFloat64Array) -> String:
    return values.to_byte_array().hex_encode()

func _initialize() -> void:
    var c := Rock.Constants.new()
    var s := Rock.State.new()
    var I := PackedFloat64Array([0, 0, 0])
    var axes := PackedFloat64Array([0, 0, 0, 0])
    var q := PackedFloat64Array()
    var w := PackedFloat64Array()
    for body in {table}:
        var x := PackedFloat64Array(body)
        q = x.slice(6, 10)
        w = x.slice(10, 13)
        Rock.principal(x.slice(0, 6), I, axes)
        if Rock.check(I, x[13]) != 0:
            quit(1)
            return
        Rock.prepare(c, I, x[13])
        Rock.set_motion(c, s, axes, q, w)
        for row in {rows} + 1:
            if row > 0:
                Rock.advance(c, s, int(x[14]))
            if Rock.reach(c, s) > 1:
                quit(2)
                return
            Rock.get_motion(c, s, axes, q, w)
            print(text(q + w))
    Rock.kick(s, w)
    print(text(PackedFloat64Array([Rock.energy(c, s)])), " ", Rock.message(Rock.check(I, 0.0)))
    quit()
"""
PROGRAMS = {
    "c": Program(("gcc", "clang"), "rock.h", "main.c", C, "{}", ("double", "float")),
    "cpp": Program(("g++", "clang++"), "rock.h", "main.cpp", C, "{}", ("double", "float")),
    "cuda": Program(("g++ for CUDA",), "rock.h", "main.cpp", C, "{}", ("double", "float")),
    "js": Program(("node",), "rock.mjs", "main.mjs", JAVASCRIPT),
    "python": Program(("python",), "rock.py", "main.py", PYTHON),
    "rust": Program(("rustc",), "rock.rs", "main.rs", RUST, "[]", ("f64", "f32")),
    "csharp": Program(("mcs",), "rock.cs", "main.cs", CSHARP, "{}"),
    "julia": Program(("julia",), "rock.jl", "main.jl", JULIA, "[]", ("Float64", "Float32")),
    "gdscript": Program(("godot",), "rock.gd", "main.gd", GDSCRIPT),
}


def moved(
    language: str,
    text: str,
    folder: Path,
    bodies: Sequence[Sequence[float]],
    rows: int,
    compiler: str = "",
    single: bool = False,
) -> tuple[np.ndarray, float, str]:
    """Rows of q and w (bodies, rows + 1, 7), the energy after the kick and the message, by the text of a file."""
    program = PROGRAMS[language]
    opens, closes = program.brackets
    listed = ", ".join(opens + ", ".join(map(repr, map(float, body))) + closes for body in bodies)
    main = program.text.replace("{table}", f"{opens}{listed}{closes}").replace("{rows}", str(rows))
    (folder / program.file).write_text(text)
    (folder / program.main).write_text(main.replace("NUMBER", program.numbers[single]))
    sources = [program.main, *([program.file] if language == "csharp" else [])]
    *lines, last = compilers.output(compiler or program.compilers[0], folder, *sources).splitlines()
    energy, message = last.split(" ", 1)

    def values(words: str) -> list[float]:
        return np.frombuffer(bytes.fromhex(words)).tolist() if language == "gdscript" else [*map(float, words.split())]

    return np.reshape([values(line) for line in lines], (len(bodies), rows + 1, 7)), values(energy)[0], message
