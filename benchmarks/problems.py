"""Problems of the work-precision benchmark, and their true end states by Taylor series in 24 digits.

Needs python-flint.
"""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from cases import RESULTS, unit

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

import kreisel as kr
from kreisel import algebra
from taylor import free_body, taylor_solution

REFERENCE = RESULTS / "work_precision_reference.json"
DIGITS = 24
FASTEST = 1.5  # largest rate of the angular momentum, n > 3


@dataclass(frozen=True)
class Problem:
    """A Lagrange top with p = e_n (m' = a ^ p, a' = m a), or Clebsch's body with b (M' = P ^ BP, P' = -MP).

    Or the Euler top with J, n = 3, M' = [M, Omega], which has no vector.
    """

    name: str
    kind: str
    n: int
    skew: np.ndarray
    vector: np.ndarray
    fixed: np.ndarray  # p, b or J

    @property
    def model(self) -> Any:
        """The system with its parameters."""
        if self.kind == "euler-top":
            return kr.EulerTop(J=self.fixed)
        return kr.LagrangeTop(p=self.fixed) if self.kind == "lagrange-top" else kr.Clebsch(b=self.fixed)

    @property
    def state(self) -> dict[str, Any]:
        """The start by letters."""
        return dict(zip(self.model.system.space.letters, (self.skew, self.vector), strict=False))

    @property
    def start(self) -> np.ndarray:
        """The independent entries i < j of the skew matrix, then the vector."""
        return np.concatenate([algebra.coordinates(self.skew), self.vector])

    def rate(self, z: Any, library: Any = np) -> Any:
        """The right-hand side on the entries as a flat array."""
        count = self.n * (self.n - 1) // 2
        rows, columns = algebra.triangle(self.n)
        X = library.zeros((self.n, self.n))
        if library is np:
            X[rows, columns], X[columns, rows] = z[:count], -z[:count]
        else:
            X = X.at[rows, columns].set(z[:count]).at[columns, rows].set(-z[:count])
        if self.kind == "euler-top":
            Omega = X / (self.fixed[:, None] + self.fixed)
            return (X @ Omega - Omega @ X)[rows, columns]
        v = z[count:]
        w, sign = (self.fixed, 1) if self.kind == "lagrange-top" else (self.fixed * v, -1)
        return library.concatenate([v[rows] * w[columns] - w[rows] * v[columns], sign * (X @ v)])

    def end(self, time: float) -> np.ndarray:
        """The true state at `time`, from the file of references or, once, by Taylor series."""
        result = json.loads(REFERENCE.read_text()) if REFERENCE.exists() else {}
        key = f"{self.name}, T = {time:g}"
        if key not in result:
            result[key] = [float(v) for v in self.taylor(time)]
            REFERENCE.write_text(json.dumps(result, indent=1) + "\n")
        return np.array(result[key])

    def taylor(self, time: float) -> list[float]:
        """By Taylor series, `tests/taylor.py`, which knows nothing of a contender."""
        if self.kind == "euler-top":
            moments = self.fixed[[1, 2, 0]] + self.fixed[[2, 0, 1]]
            mu = free_body(algebra.axial(self.skew), moments, time, digits=DIGITS)
            return [float(x) for x in algebra.coordinates(algebra.hat(mu))]
        X, v = taylor_solution(self.skew, self.vector, self.fixed, time, clebsch=self.kind == "clebsch", digits=DIGITS)
        return [float(x) for x in (*algebra.coordinates(X), *v)]


def _random(n: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    draw = np.random.default_rng([seed, n])
    X = draw.standard_normal((n, n))
    X = X - X.T
    return FASTEST / np.linalg.norm(X, 2) * X, unit(draw.standard_normal(n))


def problems() -> list[Problem]:
    """The free body for n = 3; the top and Clebsch's body for n = 3, 5, 10."""
    mu = algebra.hat(np.array([0.9, 0.4, 0.6]))
    out = [Problem("euler-top, n = 3", "euler-top", 3, mu, np.zeros(0), np.array([0.5, 0.75, 1.25]))]
    for n in (3, 5, 10):
        X, v = (algebra.hat(np.array([0.1, 0.2, 1.5])), np.array([0.6, 0, 0.8])) if n == 3 else _random(n, 1)
        out.append(Problem(f"lagrange-top, n = {n}", "lagrange-top", n, X, v, np.eye(n)[-1]))
        b = np.linspace(-0.6, 0.9, n) if n > 3 else np.array([0.3, 0.7, 1.9])
        out.append(Problem(f"clebsch, n = {n}", "clebsch", n, X, v, b))
    return out


def build(folder: Path = RESULTS) -> None:
    """All references, some minutes."""
    folder.mkdir(exist_ok=True)
    for problem in problems():
        for time in (100.0, 1000.0):
            print(problem.name, time, problem.end(time)[:2], flush=True)


if __name__ == "__main__":
    build()
