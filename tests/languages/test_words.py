"""Files of bodies under forces in each language: names of parameters, and the motion by a textbook's equations."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import kreisel as kr
from compilers import output
from support import cross

STEPS, DT, M0, P0 = 400, 0.05, (0.3, 0.2, 1.1), (0.6, 0.0, 0.8)
K, T = 0.02, 0.03
PROGRAMS = {  # compiler, file of the body, file and text of the program
    "c": (
        "gcc",
        "rock.h",
        "main.c",
        """#include "rock.h"
#include <stdio.h>
int main(void) {
    rock_constants c;
    rock_state s = {.M = {0.3, 0.2, 1.1}, .P = {0.6, 0.0, 0.8}};
    if (rock_check(rock_A, rock_alpha, rock_k, rock_t1, rock_dt)) return 1;
    rock_prepare(&c, rock_A, rock_alpha, rock_k, rock_t1, rock_dt);
    rock_advance(&c, &s, 400);
    for (int i = 0; i < 3; i++) printf("%.17g %.17g ", s.M[i], s.P[i]);
    return rock_start_M[0] == rock_start_P[0];
}
""",
    ),
    "rust": (
        "rustc",
        "rock.rs",
        "main.rs",
        """mod rock;
fn main() {
    let (mut c, mut s) = (rock::Constants::default(), rock::State::default());
    (s.M, s.P) = ([0.3, 0.2, 1.1], [0.6, 0.0, 0.8]);
    let (alpha, k, t1, dt) = (rock::default_alpha, rock::default_k, rock::default_t1, rock::default_dt);
    assert!(rock::check(&rock::default_A, alpha, k, t1, dt) == 0);
    rock::prepare(&mut c, &rock::default_A, alpha, k, t1, dt);
    rock::advance(&c, &mut s, 400);
    for i in 0..3 { print!("{} {} ", s.M[i], s.P[i]); }
}
""",
    ),
    "csharp": (
        "mcs",
        "rock.cs",
        "main.cs",
        """class Program {
    static void Main() {
        var c = new Rock.Constants();
        var s = new Rock.State();
        new double[] {0.3, 0.2, 1.1}.CopyTo(s.M, 0);
        new double[] {0.6, 0.0, 0.8}.CopyTo(s.P, 0);
        var alpha = Rock.default_alpha;
        if (Rock.check(Rock.default_A, alpha, Rock.default_k, Rock.default_t1, Rock.default_dt) != 0) return;
        Rock.prepare(c, Rock.default_A, Rock.default_alpha, Rock.default_k, Rock.default_t1, Rock.default_dt);
        Rock.advance(c, s, 400);
        var dot = System.Globalization.CultureInfo.InvariantCulture;
        for (int i = 0; i < 3; i++)
            System.Console.Write(s.M[i].ToString("R", dot) + " " + s.P[i].ToString("R", dot) + " ");
    }
}
""",
    ),
    "js": (
        "node",
        "rock.mjs",
        "main.mjs",
        """import * as rock from "./rock.mjs";
const c = new rock.Constants(), s = new rock.State();
s.M.set([0.3, 0.2, 1.1]);
s.P.set([0.6, 0.0, 0.8]);
const values = [rock.A_default, rock.alpha_default, rock.k_default, rock.t1_default, rock.dt_default];
if (rock.check(...values) !== 0) throw "check";
rock.prepare(c, ...values);
rock.advance(c, s, 400);
for (let i = 0; i < 3; i++) console.log(s.M[i], s.P[i]);
""",
    ),
    "python": (
        "python",
        "rock.py",
        "main.py",
        """import rock
c, s = rock.Constants(), rock.State()
s.M[:], s.P[:] = (0.3, 0.2, 1.1), (0.6, 0.0, 0.8)
values = rock.default_A, rock.default_alpha, rock.default_k, rock.default_t1, rock.default_dt
assert rock.check(*values) == 0
rock.prepare(c, *values)
rock.advance(c, s, 400)
print(*(x for pair in zip(s.M, s.P) for x in pair))
""",
    ),
    "julia": (
        "julia",
        "rock.jl",
        "main.jl",
        """include("rock.jl")
c, s = Rock.Constants(), Rock.State()
s.M .= [0.3, 0.2, 1.1]
s.P .= [0.6, 0.0, 0.8]
values = (Rock.A_default, Rock.alpha_default, Rock.k_default, Rock.t1_default, Rock.dt_default)
@assert Rock.check(values...) == 0
Rock.prepare!(c, values...)
Rock.advance!(c, s, 400)
for i in 1:3
    print(s.M[i], " ", s.P[i], " ")
end
""",
    ),
}


def body(**params: float) -> Any:
    """A Lagrange top with moments (1, 1, 1/2) in the potential of parameters times squares of P."""
    scope: dict[str, Any] = {}
    terms = " + ".join(f"{name} * P[{i}]**2" for i, name in enumerate(params))
    exec(f"def potential(P, *, {', '.join(params)}): return {terms}", scope)
    top = kr.LagrangeTopMoving(A=(0, 0, 1), alpha=0.5)
    return kr.perturbed(top, potential=scope["potential"], params=params)


@cache
def truth() -> Sequence[float]:
    """M' = M x Omega + P x (A + grad V), P' = P x Omega."""

    def equations(t: float, z: np.ndarray) -> np.ndarray:
        M, P = z[:3], z[3:]
        Omega = M / (1.0, 1.0, 0.5)
        slope = np.array([2 * K * P[0], 2 * T * P[1], 1.0])
        return np.concatenate([cross(M, Omega) + cross(P, slope), cross(P, Omega)])

    return tuple(solve_ivp(equations, (0, STEPS * DT), [*M0, *P0], "DOP853", rtol=1e-12, atol=1e-13).y[:, -1])


@pytest.mark.parametrize("language", PROGRAMS)
def test_parameters_called_like_variables_of_the_file(language: str, tmp_path: Path) -> None:
    """`k` is also an index of loops, `t1` the first temporary value; C# has the keyword `out`."""
    compiler, file, main, program = PROGRAMS[language]
    top = body(k=K, t1=T)
    text = kr.code(top, top.state(M=M0, P=P0), dt=DT, order=8, language=language, name="rock")
    (tmp_path / file).write_text(text)
    (tmp_path / main).write_text(program)
    sources = [main, file] if language == "csharp" else [main]
    printed = np.array(output(compiler, tmp_path, *sources).split(), dtype=float).reshape(3, 2).T.ravel()
    assert abs(printed - truth()).max() < 1e-9


@pytest.mark.parametrize(
    ("language", "name"),
    [
        ("c", "default"),
        ("cpp", "new"),
        ("rust", "ref"),
        ("csharp", "out"),
        ("js", "var"),
        ("julia", "end"),
        ("gdscript", "func"),
        ("wgsl", "loop"),
        ("python", "stage"),
        ("c", "step"),
        ("c", "dt"),
    ],
)
def test_parameters_called_like_keywords_and_functions_are_refused(language: str, name: str) -> None:
    top = body(**{name: K})
    asked: dict[str, Any] = {"x0": top.state(M=M0, P=P0), "dt": DT}
    with pytest.raises(kr.InputError, match=f"params: expected names .* got {name}. Give other names"):
        kr.code(top, language=language, **asked)
    assert kr.code(body(other=K), language=language, **asked)


def test_a_satellite_in_rust(tmp_path: Path) -> None:
    """Its constants have arrays of more than 32 entries, which have no Default in Rust; they begin with 0."""
    orbit = kr.physical.Orbit.circular("500 km", "97 deg", epoch="2026-03-20T12:00:00")
    cubesat = kr.physical.Satellite.cubesat(orbit, magnetic_moment=(0, 0, 1e-4))
    text = kr.code(cubesat, cubesat.state(("1 deg/s", 0, 0)), dt=30.0, language="rust", name="rock")
    (tmp_path / "rock.rs").write_text(text)
    (tmp_path / "main.rs").write_text("""mod rock;
fn main() {
    let (c, s) = (rock::Constants::default(), rock::State::default());
    println!("{} {} {:?}", c.dt, c.moments[2], s.M);
}
""")
    assert output("rustc", tmp_path, "main.rs").strip() == "0 0 [0.0, 0.0, 0.0]"
