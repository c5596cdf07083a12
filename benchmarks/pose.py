"""The pose of bodies in a fluid at T = 100: position, orientation and state against heyoka in 80-bit floats.

And the energy of a submerged body with more added mass than mass.

    python benchmarks/pose.py

Errors are relative to the largest position on the way, and to the largest entry of the state.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from cases import machine, parser, write
from perturbed_peers import Functions, by_long_doubles

import kreisel as kr
from kreisel import algebra
from kreisel.physical import SubmergedBody

END = 100.0
M, P = (0.3, -0.4, 1.2), (0.5, 0.2, 0.9)
A, C = (1.3, 0.7, 0.4), (0.9, 0.6, 0.25)  # inverse moments and inverse masses
SAME = (1.0, 1.0, 1.0)
# The system, its inverse moments and inverse masses, and the runs: dt, method, order.
BODIES: dict[str, tuple[Any, tuple[float, ...], tuple[float, ...], list[tuple[float, str, int | None]]]] = {
    "KirchhoffRevolution": (
        kr.KirchhoffRevolution(a1=A[0], a3=A[2], c1=C[0], c3=C[2]),
        (A[0], A[0], A[2]),
        (C[0], C[0], C[2]),
        [(0.2, "baecklund", 8), (0.1, "baecklund", 8), (0.05, "baecklund", 8), (0.5, "exact", None)],
    ),
    "Clebsch": (
        kr.Clebsch(b=tuple(-c for c in C)),
        SAME,
        C,
        [(0.2, "baecklund", 8), (0.1, "baecklund", 8), (0.05, "baecklund", 8), (0.5, "exact", None)],
    ),
    "Kirchhoff": (
        kr.Kirchhoff(C=[[0, A[2], A[1]], [A[2], 0, A[0]], [A[1], A[0], 0]], B=tuple(-c for c in C)),
        A,
        C,
        [(0.1, "variational", 8), (0.05, "variational", 8)],
    ),
}


def equations(a: tuple[float, ...], c: tuple[float, ...]) -> Any:
    """M' = M x Omega + P x U, P' = P x Omega, q' = q Omega/2, x' = g U, of (M, P, q, x)."""

    def rate(t: Any, y: list[Any], f: Functions) -> list[Any]:
        m, p, (w, i, j, k) = y[:3], y[3:6], y[6:10]
        omega, u = [s * v for s, v in zip(a, m, strict=True)], [s * v for s, v in zip(c, p, strict=True)]
        x, z = cross(m, omega), cross(p, u)
        o = omega
        turned = [
            (-i * o[0] - j * o[1] - k * o[2]) * 0.5,
            (w * o[0] + j * o[2] - k * o[1]) * 0.5,
            (w * o[1] + k * o[0] - i * o[2]) * 0.5,
            (w * o[2] + i * o[1] - j * o[0]) * 0.5,
        ]
        v = [i, j, k]
        inner = cross(v, u)
        moved = [n + 2.0 * (w * s + r) for n, s, r in zip(u, inner, cross(v, inner), strict=True)]
        return [*(n + s for n, s in zip(x, z, strict=True)), *cross(p, omega), *turned, *moved]

    return rate


def cross(x: list[Any], y: list[Any]) -> list[Any]:
    return [x[1] * y[2] - x[2] * y[1], x[2] * y[0] - x[0] * y[2], x[0] * y[1] - x[1] * y[0]]


def main(arguments: list[str] | None = None) -> None:
    asked = parser(__doc__, "pose").parse_args(arguments)
    rows: dict[str, Any] = {}
    for name, (model, a, c, runs) in BODIES.items():
        true = by_long_doubles(equations(a, c), np.array([*M, *P, 1.0, 0, 0, 0, 0, 0, 0]), END)
        for dt, method, order in runs:
            run = kr.simulate(
                model,
                {"M": M, "P": P},
                dt=dt,
                steps=round(END / dt),
                method=method,
                order=order,
                orientation=(1, 0, 0, 0),
                progress=False,
            )
            x = kr.analysis.path(run)
            state = np.concatenate([run.M.values[-1], run.P.values[-1]])
            g, q = algebra.rotation_matrix(run.g.values[-1]), algebra.rotation_matrix(true[6:10])
            rows[f"{name}, {method} {order or ''}".strip() + f", dt = {dt:g}"] = {
                "position": _short(abs(x.values[-1] - true[10:]).max() / abs(x.values).max()),
                "orientation": _short(abs(g - q).max()),
                "state": _short(abs(state - true[:6]).max() / abs(true[:6]).max()),
            }
            print(name, dt, method, list(rows.values())[-1], flush=True)
    write({"machine": machine(), "end": END, "figures": rows, "added mass": added_mass()}, asked.output)


def added_mass() -> dict[str, Any]:
    """A body of 1 kg with 26 kg of added mass: the largest relative change of its energy in 10^6 steps of 0.05 s."""
    body, found = SubmergedBody(1.0, (0.02, 0.02, 0.02), (5.0, 5.0, 26.0, 0.1, 0.2, 0.3)), {}
    for order in ((2, 2), (8, 6, 4)):
        run = kr.simulate(
            body.model(),
            body.state((0.2, 0.1, 0.3), (0.5, -0.3, 0.8)),
            dt=0.05,
            steps=10**6,
            every=100,
            order=order,
            orientation=body.orientation(),
            progress=False,
        )
        change = abs(run.energy.values / run.energy.values[0] - 1)
        found[str(order)] = {"first tenth": _short(change[:1000].max()), "all": _short(change.max())}
        print(order, found[str(order)], flush=True)
    return found


def _short(x: Any) -> float:
    return float(f"{float(x):.2g}")


if __name__ == "__main__":
    main()
