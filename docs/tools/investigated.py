"""Every map of the registry, and the negative controls: docs/integrability-registry.md, by `make investigate`."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from kreisel.algebra import Array, act, cayley_act, wedge
from kreisel.lab.investigation import Investigation, investigate
from kreisel.method.variational import stage
from kreisel.record.contract import Map
from kreisel.record.model import Model
from kreisel.system import REGISTRY, heavy_top

PAGE = Path(__file__).parents[1] / "integrability-registry.md"
HEAD = """# Every map, investigated

`kreisel investigate` on every map of the registry, n = 3 (the bitop: 4), eps = 1/3, small values for other parameters,
and on three negative controls (`docs/tools/investigated.py`): the equations of a heavy top of equal moments by
Euler's method; the map of the Lagrange top in a field that grows with height and breaks its symmetry; and the symmetric
variational step of a heavy top with three unequal moments. The meaning of the columns and the rule of the verdict:
[the laboratory](integrability.md).

Made by `make investigate`.

"""


# -- negative controls: maps that are not integrable, each a good map with one thing wrong -------------


def naive_heavy_top(M: Array, P: Array, *, eps: Any) -> tuple[Array, Array]:
    """The equations of a heavy top of equal moments by Euler's method: M' = A ^ P, P' = -M P."""
    A = 0 * P + _axis(P)
    return M + eps * wedge(A, P), P - eps * act(M, P)


def perturbed_lagrange_top(m: Array, a: Array, *, eps: Any) -> tuple[Array, Array]:
    """Suris's map with gravity that grows with height, V = a_3 + a_3^2/2 + a_1^2/2: Poisson, and no symmetry."""
    force = 0 * a + _axis(a)
    force = force + a * _axis(a) + a * _axis(a)[::-1]
    m = m + eps * wedge(a, force)
    return m, cayley_act(eps / 2 * m, a)


def _axis(x: Array) -> Array:
    out = np.zeros(x.shape[-1], dtype=np.int8)
    out[-1] = 1
    return out


def variational_step(M: Array, P: Array, *, A: Array, R: Array, c: Array, W: Array, eps: Any) -> tuple[Array, Array]:
    """The symmetric variational step of `kreisel.method.variational`: Poisson, of order 2."""
    state, _, _ = stage(heavy_top.SYSTEM, (M, P), eps, {"A": A, "R": R, "c": c, "W": W})
    return state


def variational_heavy_top() -> Model:
    """A heavy top with three unequal moments, its centre of mass off the axes, and that step."""
    rule = Map(step=variational_step, rational=False, order=2)
    system = replace(heavy_top.SYSTEM, name="variational-heavy-top", map=rule)
    return system(J=[0.4, 1.0, 1.7], A=[0.6, 0.3, 0.9])


THIRD = Fraction(1, 3)


def controls() -> list[tuple[str, Any, dict[str, Any]]]:
    """Title, map and options of each."""
    return [
        ("heavy top of equal moments, Euler's method", naive_heavy_top, {"n": 3, "eps": THIRD}),
        ("Lagrange top, perturbed", perturbed_lagrange_top, {"n": 3, "frame": "rest", "eps": THIRD}),
        ("heavy top, variational", variational_heavy_top(), {"eps": THIRD}),
    ]


# -- the page ----------------------------------------------------------------------------------------------


def markdown(results: list[tuple[str, Investigation]]) -> str:
    """A table of the documentation: one row a map."""
    head = "| map | Poisson | reversible | order | degree growth | integrals | Lax pair | Lyapunov | verdict |"
    lines = [head, "|" + "---|" * 9]
    for name, investigation in results:
        cells = [
            investigation[q].answer
            for q in ("Poisson", "reversible", "order", "degree growth", "integrals", "Lax pair")
        ]
        cells += [investigation["Lyapunov"].answer, f"**{investigation.verdict}**: {investigation.reason}"]
        lines.append("| " + " | ".join([name, *(cell.replace("|", "\\|") for cell in cells)]) + " |")
    return "\n".join(lines) + "\n"


def page() -> str:
    """Every map of the registry, n = 3, and the negative controls."""
    asked: list[tuple[str, Any, dict[str, Any]]] = [
        (f"`{name}`", name, {}) for name, system in REGISTRY.items() if system.map is not None
    ]
    asked += controls()
    return HEAD + markdown([(shown, investigate(candidate, **options)) for shown, candidate, options in asked])


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
