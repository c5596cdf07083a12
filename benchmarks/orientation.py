"""method="baecklund" over many steps: how the errors of the state and of the orientation grow.

The difference between two runs of order 12 to the same time, with steps of 0.5 and 0.4, whose truncation is far below
round-off; and how far g is from orthogonal.
"""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np
from cases import unit

import kreisel as kr
from kreisel import algebra

ORDER, STEPS = 12, (0.5, 0.4)


def body(name: str, n: int) -> tuple[Any, dict[str, np.ndarray]]:
    draw = np.random.default_rng([1, n])
    X = draw.standard_normal((n, n))
    X = X - X.T
    X, v, axis = 1.5 / np.linalg.norm(X, 2) * X, unit(draw.standard_normal(n)), np.eye(n)[-1]
    if name == "lagrange-top":
        return kr.LagrangeTop(p=axis, alpha=0.6), {"m": X, "a": v}
    if name == "lagrange-top-moving":
        return kr.LagrangeTopMoving(A=axis, alpha=0.6), {"M": X, "P": v}
    return kr.Clebsch(b=np.linspace(-0.6, 0.9, n)), {"M": X, "P": v}


def end(model: Any, state: dict[str, np.ndarray], dt: float, steps: int) -> tuple[np.ndarray, np.ndarray]:
    """The state and the rotation matrix after n steps."""
    options = {"method": "baecklund", "order": ORDER, "orientation": np.eye(model.n), "progress": False}
    run = kr.simulate(model, state, dt=dt, steps=steps, every=steps, observe=[], **options)
    g = run.g.values[-1]
    return np.concatenate([run[k].values[-1].ravel() for k in state]), algebra.rotation_matrix(g) if model.n == 3 else g


def main() -> None:
    """A line for each body and n."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--most", type=int, default=6, help="steps as a power of ten")
    asked = parser.parse_args()
    for name in ("lagrange-top", "lagrange-top-moving", "clebsch"):
        for n in (3, 4, 5, 6):
            model, state = body(name, n)
            for steps in (10**k for k in range(3, asked.most + 1)):
                one, other = (end(model, state, dt, round(steps * STEPS[0] / dt)) for dt in STEPS)
                result = f"state {abs(one[0] - other[0]).max():.1e}  g {abs(one[1] - other[1]).max():.1e}"
                off = abs(one[1].T @ one[1] - np.eye(n)).max()
                print(f"{name:<21}n = {n}  {steps:.0e} steps  {result}  g g^T - 1: {off:.1e}", flush=True)


if __name__ == "__main__":
    main()
