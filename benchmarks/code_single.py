"""Accuracy of a file of `kreisel code --single` over 10^9 frames at 60 Hz (10^8 of some), against the file in 64 bits.

Both files are in one program of C with the same moments, step and state.  In units of the last place, 2^-23: the
largest change of |M| and of the energy; the angle between the two orientations, and between g M and its first value.

    python benchmarks/code_single.py [frames]      writes its results for 10^9 frames, and only prints those for others
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from pathlib import Path

from cases import RESULTS, write

import kreisel as kr

FRAMES = 10**9  # of the committed results
FLAGS = ("-std=gnu99", "-O3", "-march=native", "-ffp-contract=off", "-fno-math-errno")
CASES = {"tumbling": (0.3, 0.5, 1.1), "middle axis": (0.02, 4.5, 0.01)}
PROGRAM = """#include "one.h"
#include "two.h"
#include <stdio.h>
#include <stdlib.h>
static double larger(double x, double y) { return y > x ? y : x; }
static double dot(const double *x, const double *y) { return x[0] * y[0] + x[1] * y[1] + x[2] * y[2]; }
static void in_space(const double *q, const double *M, double *out) {
    double t[3];
    for (int i = 0; i < 3; i++) t[i] = 2 * (q[1 + (i + 1) % 3] * M[(i + 2) % 3] - q[1 + (i + 2) % 3] * M[(i + 1) % 3]);
    for (int i = 0; i < 3; i++)
        out[i] = M[i] + q[0] * t[i] + q[1 + (i + 1) % 3] * t[(i + 2) % 3] - q[1 + (i + 2) % 3] * t[(i + 1) % 3];
}
int main(int count, char **words) {
    const long frames = atol(words[1]);
    const float I[3] = {5.5f, 4.5f, 3.0f}, dt = 1.0f / 60.0f;
    const double wide[3] = {I[0], I[1], I[2]}, unit = ldexp(1.0, -23);
    one_constants c;
    two_constants d;
    one_state s = {{(float)atof(words[2]), (float)atof(words[3]), (float)atof(words[4])}, {1.0f}};
    two_state u = {{s.M[0], s.M[1], s.M[2]}, {1.0}};
    double start[3], m[3], L0 = dot(u.M, u.M), T0 = 0, worst[2] = {0, 0};
    if (count != 5 || one_check(I, dt)) return 1;
    one_prepare(&c, I, dt);
    two_prepare(&d, wide, dt);
    for (int i = 0; i < 3; i++) start[i] = u.M[i], T0 += u.M[i] * u.M[i] * c.inverse[i];
    for (long k = 1, next = 1000; k <= frames; k++) {
        one_step(&c, &s);
        two_step(&d, &u);
        double M[3] = {s.M[0], s.M[1], s.M[2]}, q[4] = {s.g[0], s.g[1], s.g[2], s.g[3]}, T = 0, cosine = 0, apart = 0;
        for (int i = 0; i < 3; i++) T += M[i] * M[i] * c.inverse[i];
        worst[0] = larger(worst[0], fabs(sqrt(dot(M, M) / L0) - 1) / unit);
        worst[1] = larger(worst[1], fabs(T / T0 - 1) / unit);
        if (k < next) continue;
        next *= 10;
        in_space(q, M, m);
        for (int i = 0; i < 4; i++) cosine += q[i] * u.g[i];
        for (int i = 0; i < 4; i++) apart += pow(q[i] - (cosine < 0 ? -u.g[i] : u.g[i]), 2);
        for (int i = 0; i < 3; i++) m[i] -= start[i];
        printf("[%ld, %.3g, %.3g, %.3g, ", k, worst[0], worst[1], 4 * asin(sqrt(apart) / 2));
        printf("%.3g]\\n", sqrt(dot(m, m) / L0));
        fflush(stdout);
    }
    return 0;
}
"""


def measured(start: tuple[float, ...], frames: int) -> list[list[float]]:
    body = kr.EulerTop(J=(1.0, 2.0, 3.5))
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "one.h").write_text(kr.code(body, name="one", single=True))
        (Path(folder) / "two.h").write_text(kr.code(body, name="two"))
        (Path(folder) / "main.c").write_text(PROGRAM)
        subprocess.run(["gcc", *FLAGS, "main.c", "-o", "main", "-lm"], cwd=folder, check=True)
        words = ["./main", str(frames), *map(str, start)]
        out = subprocess.run(words, cwd=folder, check=True, capture_output=True, text=True).stdout
    return [json.loads(line) for line in out.splitlines()]


def main() -> None:
    frames = int(float(sys.argv[1])) if len(sys.argv) > 1 else FRAMES
    rows = {}
    for case, start in CASES.items():
        rows[case] = measured(start, frames if case == "tumbling" else frames // 10)
        print(case, *rows[case], sep="\n  ")
    if frames == FRAMES:
        columns = ["frames", "momentum", "energy", "attitude", "momentum in space"]
        write({"flags": FLAGS, "columns": columns, **rows}, RESULTS / "code-single.json")


if __name__ == "__main__":
    main()
