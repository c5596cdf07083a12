"""Maps whose answer is known, and what the laboratory says of each: docs/integrability-known.md, made by `make known`.

A row has the map, the verdicts that are right, and the reason why.  "undecided" is never wrong, and counted.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from fractions import Fraction as F
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from kreisel.algebra import KINDS, cayley_act, hat, solve
from kreisel.lab.investigation import Investigation, investigate

PAGE = Path(__file__).parents[1] / "integrability-known.md"
YES, NO, PERIODIC, LINEAR, OPEN = "integrable", "not integrable", "periodic", "linear", "undecided"
SLOW = 2000  # steps of the orbits in floats


class Known(NamedTuple):
    """A map with its answer."""

    name: str
    formula: str
    names: str
    step: Callable[..., Any]
    answer: str
    why: str
    start: float = 1.0  # size of the starts in floats
    degree: int | None = None  # of integrals, by default that of `investigate`


def column(*entries: Any) -> np.ndarray:
    """An object array."""
    out = np.empty(len(entries), dtype=object)
    out[:] = entries
    return out


def second_order(right: Callable[..., Any]) -> Callable[..., Any]:
    """(x, y) -> (y, right(x, y))."""
    return lambda x: column(x[1], right(x[0], x[1]))


def kahan(flow: Callable[[Sequence[Any]], list[Any]], eps: Any = F(1, 3)) -> Callable[..., Any]:
    """Kahan's step of a quadratic flow: the polarization of x' = f(x), solved for x'."""
    from kreisel.lab.exact import independent, slopes
    from kreisel.method.kahan import eliminate

    def step(x: np.ndarray) -> np.ndarray:
        rates = flow(independent(x))
        J = slopes(column(*rates), len(x))
        matrix = [[(i == j) - eps / 2 * J[i, j] for j in range(len(x))] for i in range(len(x))]
        change, _ = eliminate(matrix, [eps * getattr(v, "value", v) for v in rates])
        return column(*(a + b for a, b in zip(x, change, strict=True)))

    return step


def qrt(x: np.ndarray) -> np.ndarray:
    """Asymmetric: two involutions, each of which keeps one coordinate and the biquadratic of the point."""
    y = (1 - x[1]) / x[0]
    return column(y, (2 + y) / x[1])


def turned(x: np.ndarray, *more: Any) -> np.ndarray:
    """A turn of (x, y) by an angle with the cosine 3/5, beside others."""
    return column((3 * x[0] - 4 * x[1]) / 5, (4 * x[0] + 3 * x[1]) / 5, *more)


def mcmillan(x: np.ndarray) -> list[Any]:
    """McMillan's map."""
    return [x[1], F(3, 2) * x[1] / (1 + x[1] * x[1]) - x[0]]


def planar_field(x: np.ndarray) -> np.ndarray:
    """The map of quadratic fields for n = 2, eps = 2, B = diag(1, 3)."""
    m, (a, b, c), one = x[0], x[1:], np.eye(2, dtype=int).astype(object)
    F, B = (np.array(rows, dtype=object) for rows in ([[a, b], [b, c]], [[1, 0], [0, 3]]))
    X = solve(F @ B + one, F)
    m = m + 2 * (X @ B - B @ X)[0, 1]
    F = KINDS["symmetric"].turned(-m * np.array([[0, 1], [-1, 0]], dtype=object), F)
    return column(m, F[0, 0], F[0, 1], F[1, 1])


def lifted(sign: int = 1, strength: Any = 1) -> Callable[..., Any]:
    """Lagrange's top in the logarithm, eps = 2: P' = cay(-M') P, or a neighbour."""

    def step(x: np.ndarray) -> np.ndarray:
        pull = 2 * strength / (1 - sign * x[3])
        m = x[:3] + pull * column(0 * x[3], x[5], -x[4])
        return column(*m, *cayley_act(-hat(m), x[3:]))

    return step


def kovalevskaya(strength: Any = 1) -> Callable[..., Any]:
    """Kovalevskaya's top, eps = 2: the step of `lifted`, and a rotation about the third axis by cay of M_3."""

    def step(x: np.ndarray) -> np.ndarray:
        y = lifted(1, strength)(x)
        back = hat(column(0 * y[2], 0 * y[2], -y[2]))
        return column(*cayley_act(back, y[:3]), *cayley_act(back, y[3:]))

    return step


TOP = "m' = m + 2 P x e/(1 - P1), P' = cay(-m') P"

MAPS = (
    Known("Lyness, a = 2", "(y, (2 + y)/x)", "xy", second_order(lambda x, y: (2 + y) / x), YES, "QRT"),
    Known("Lyness, a = 1", "(y, (1 + y)/x)", "xy", second_order(lambda x, y: (1 + y) / x), PERIODIC, "period 5"),
    Known(
        "Lyness, order 3",
        "(y, z, (1 + y + z)/x)",
        "xyz",
        lambda x: column(x[1], x[2], (1 + x[1] + x[2]) / x[0]),
        PERIODIC,
        "period 8 (Todd)",
    ),
    Known(
        "Lyness, order 3, a = 2",
        "(y, z, (2 + y + z)/x)",
        "xyz",
        lambda x: column(x[1], x[2], (2 + x[1] + x[2]) / x[0]),
        YES,
        "two integrals and a volume",
    ),
    Known("asymmetric QRT", "y' = (1 - y)/x, x' = (2 + y')/y", "xy", qrt, YES, "QRT"),
    Known("McMillan", "(y, 3y/(2 + 2y^2) - x)", "xy", lambda x: column(*mcmillan(x)), YES, "QRT"),
    Known(
        "McMillan, other sign",
        "(y, 3y/(2 - 2y^2) - x)",
        "xy",
        second_order(lambda x, y: F(3, 2) * y / (1 - y * y) - x),
        YES,
        "QRT",
    ),
    Known(
        "QRT, multiplicative",
        "(y, (y^2 + 2)/(x (1 + 3 y^2)))",
        "xy",
        second_order(lambda x, y: (y * y + 2) / (x * (1 + 3 * y * y))),
        YES,
        "QRT",
    ),
    Known(
        "McMillan, spoiled",
        "(y, 3y/(2 + 2y^4) - x)",
        "xy",
        second_order(lambda x, y: F(3, 2) * y / (1 + y**4) - x),
        NO,
        "degrees grow exponentially",
    ),
    Known(
        "Hénon, dissipative",
        "(1 + y - 7x^2/5, 3x/10)",
        "xy",
        lambda x: column(1 + x[1] - F(7, 5) * x[0] * x[0], F(3, 10) * x[0]),
        NO,
        "entropy log 2",
        0.1,
    ),
    Known(
        "Hénon, its inverse",
        "(10y/3, x - 1 + 140 y^2/9)",
        "xy",
        lambda x: column(F(10, 3) * x[1], x[0] - 1 + F(140, 9) * x[1] * x[1]),
        NO,
        "entropy log 2",
        0.1,
    ),
    Known(
        "Hénon, area-preserving",
        "(y, 1 - 2y^2 - x)",
        "xy",
        second_order(lambda x, y: 1 - 2 * y * y - x),
        NO,
        "entropy log 2",
        0.1,
    ),
    Known(
        "Hietarinta and Viallet",
        "(y, y + 7/y^2 - x)",
        "xy",
        second_order(lambda x, y: y + 7 / (y * y) - x),
        NO,
        "confines, entropy log((3 + sqrt 5)/2)",
    ),
    Known(
        "discrete Painlevé I",
        "(y, n/y + 1 - x - y, n + 1/3)",
        "xyn",
        lambda x: column(x[1], x[2] / x[1] + 1 - x[0] - x[1], x[2] + F(1, 3)),
        OPEN,
        "integrable, but not autonomous: no integral",
    ),
    Known(
        "its autonomous limit", "(y, 2/y + 1 - x - y)", "xy", second_order(lambda x, y: 2 / y + 1 - x - y), YES, "QRT"
    ),
    Known(
        "Kahan, Euler's top",
        "x_i' = a_i x_j x_k, a = (1, -2, 3/2)",
        "xyz",
        kahan(lambda x: [x[1] * x[2], -2 * x[2] * x[0], F(3, 2) * x[0] * x[1]]),
        YES,
        "Hirota, Kimura",
    ),
    Known(
        "Kahan, a cubic Hamiltonian",
        "H = y^2/2 + x^3/3 - x",
        "xy",
        kahan(lambda x: [x[1], 1 - x[0] * x[0]]),
        YES,
        "Celledoni, McLachlan, Owren, Quispel 2013",
    ),
    Known(
        "Kahan, Lotka and Volterra",
        "(x (1 - y), y (x - 1))",
        "xy",
        kahan(lambda x: [x[0] * (1 - x[1]), x[1] * (x[0] - 1)]),
        NO,
        "entropy log 2",
    ),
    Known(
        "Kahan, Lorenz",
        "(10 (y - x), x (28 - z) - y, xy - 8z/3)",
        "xyz",
        kahan(lambda x: [10 * (x[1] - x[0]), x[0] * (28 - x[2]) - x[1], x[0] * x[1] - F(8, 3) * x[2]], F(1, 100)),
        NO,
        "chaotic",
    ),
    Known(
        "Kahan, Volterra's chain",
        "(x (y - z), y (z - x), z (x - y))",
        "xyz",
        kahan(lambda x: [x[0] * (x[1] - x[2]), x[1] * (x[2] - x[0]), x[2] * (x[0] - x[1])]),
        YES,
        "Petrera, Pfadler, Suris 2011",
    ),
    Known(
        "Kahan, the dressing chain",
        "(y^2 - z^2 + 1, z^2 - x^2 + 2, x^2 - y^2 - 3)",
        "xyz",
        kahan(
            lambda x: [
                x[1] * x[1] - x[2] * x[2] + 1,
                x[2] * x[2] - x[0] * x[0] + 2,
                x[0] * x[0] - x[1] * x[1] - 3,
            ]
        ),
        YES,
        "Petrera, Pfadler, Suris 2011",
    ),
    Known(
        "Kahan, Nahm's equations",
        "(2x^2 - y^2, y^2 - 10xy)",
        "xy",
        kahan(lambda x: [2 * x[0] * x[0] - x[1] * x[1], x[1] * x[1] - 10 * x[0] * x[1]]),
        YES,
        "icosahedral: an integral of degree 6",
    ),
    Known(
        "six Hénon maps in turn",
        "x_(n+12) = 1 - 2 x_(n+6)^2 - x_n",
        "abcdefuvwxyz",
        lambda x: column(*x[1:], 1 - 2 * x[6] * x[6] - x[0]),
        NO,
        "entropy log(2)/6",
        start=0.1,
    ),
    Known("linear, elliptic", "a turn with the cosine 3/5", "xy", lambda x: turned(x), YES, "x^2 + y^2"),
    Known(
        "linear, hyperbolic",
        "(2x + y, x + y)",
        "xy",
        lambda x: column(2 * x[0] + x[1], x[0] + x[1]),
        YES,
        "x^2 - xy - y^2",
    ),
    Known("linear, parabolic", "(x + y, y)", "xy", lambda x: column(x[0] + x[1], x[1]), YES, "y"),
    Known("linear, of order 6", "(y, y - x)", "xy", second_order(lambda x, y: y - x), PERIODIC, "period 6"),
    Known("linear, a node", "(2x, 3y)", "xy", lambda x: column(2 * x[0], 3 * x[1]), LINEAR, "no rational integral"),
    Known("linear, a saddle", "(2x, y/2)", "xy", lambda x: column(2 * x[0], x[1] / 2), YES, "xy"),
    Known(
        "skew product over McMillan's",
        "(McMillan, z + x)",
        "xyz",
        lambda x: column(*mcmillan(x), x[2] + x[0]),
        OPEN,
        "growth k^3, entropy 0",
    ),
    Known(
        "skew product with a clock",
        "(x + 1, xy, yz, u + 1, v + x)",
        "xyzuv",
        lambda x: column(x[0] + 1, x[0] * x[1], x[1] * x[2], x[3] + 1, x[4] + x[0]),
        OPEN,
        "no orbit is bounded; leaves move",
    ),
    Known(
        "another",
        "(x + 1/2, y + x^2, z + xy, w + z)",
        "xyzw",
        lambda x: column(x[0] + F(1, 2), x[1] + x[0] * x[0], x[2] + x[0] * x[1], x[3] + x[2]),
        OPEN,
        "no orbit is bounded; leaves move",
    ),
    Known(
        "leaves moved",
        "(turn, z + x^2)",
        "xyz",
        lambda x: turned(x, x[2] + x[0] * x[0]),
        OPEN,
        "a bracket is preserved, its Casimir not",
    ),
    Known("leaves exchanged", "(turn, -z)", "xyz", lambda x: turned(x, -x[2]), YES, "x^2 + y^2 and z^2"),
    Known(
        "triangular, quadratic",
        "(x + y + y^2, y + y^2)",
        "xy",
        lambda x: column(x[0] + x[1] + x[1] * x[1], x[1] + x[1] * x[1]),
        NO,
        "already y -> y + y^2 has entropy log 2",
    ),
    Known(
        "coupled McMillan",
        "x_i'' = 3 x_i'/(2 + 2 |x'|^2) - x_i",
        "xyuv",
        lambda x: column(x[2], x[3], *(F(3, 2) * x[2 + i] / (1 + x[2] * x[2] + x[3] * x[3]) - x[i] for i in (0, 1))),
        YES,
        "McMillan's with a symmetry",
    ),
    Known(
        "quadratic field, n = 2",
        "X = F/(1 + BF), M' = M + 2(XB - BX), F' = cay(-M') F cay(M')",
        "mabc",
        planar_field,
        YES,
        "a theorem",
        0.25,
    ),
    Known("Lagrange, in the logarithm", TOP, "uvwxyz", lifted(), YES, "a theorem", 0.25),
    Known(
        "Lagrange, a neighbour",
        TOP.replace("- P1", "+ P1"),
        "uvwxyz",
        lifted(-1),
        NO,
        "degrees grow exponentially",
        0.25,
    ),
    Known("Kovalevskaya", f"{TOP}, then rotated by cay(m3')", "uvwxyz", kovalevskaya(), YES, "a theorem", 0.25, 6),
    Known(
        "Kovalevskaya, a neighbour",
        "m' = m + P x e/(1 - P1), ...",
        "uvwxyz",
        kovalevskaya(F(1, 2)),
        NO,
        "degrees grow exponentially",
        0.25,
    ),
)


def looked_at(known: Known, steps: int = SLOW) -> tuple[Investigation, float]:
    """The page of a map, and its time in seconds."""
    begun = time.perf_counter()
    found = investigate(
        known.step,
        names=tuple(known.names),
        steps=steps,
        degree=known.degree,
        start=lambda draw: draw((len(known.names),)) * F(known.start),
    )
    return found, time.perf_counter() - begun


HEAD = """# Maps with a known answer

The [laboratory](integrability.md) on {count} maps whose answer is in the literature, elementary or
[a theorem](quadratic-fields.md). It sees the formula of the step and nothing else, and for Kovalevskaya's top
the degree 6 up to which integrals are sought. None of the verdicts is wrong. {undecided} maps are undecided,
because the rule cannot decide them: without a rational integral, with a coordinate that counts the steps,
with leaves that move. Times are for the whole page of a map on one core that others used too.

Made by `make known`.

| map | step | known | because | verdict | reason | s |
|---|---|---|---|---|---|---|
"""


def page(rows: list[tuple[Known, Investigation, float]]) -> str:
    """The page of the docs."""
    undecided = sum(found.verdict == OPEN for _, found, _ in rows)
    lines = []
    for known, found, seconds in rows:
        answer = "none by this rule" if known.answer == OPEN else known.answer
        verdict, time_ = f"**{found.verdict}**", f"{seconds:.1f}"
        cells = [known.name, f"`{known.formula}`", answer, known.why, verdict, found.reason, time_]
        lines.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
    return HEAD.format(count=len(rows), undecided=undecided) + "\n".join(lines) + "\n"


def main() -> None:
    """Look at all and write the page.  Raises `SystemExit` where a verdict is not the answer."""
    rows = [(known, *looked_at(known)) for known in MAPS]
    wrong = [known.name for known, found, _ in rows if found.verdict != known.answer]
    if wrong:
        raise SystemExit(f"Other verdicts than known: {', '.join(wrong)}.")
    PAGE.write_text(page(rows), encoding="utf-8")


if __name__ == "__main__":
    main()
