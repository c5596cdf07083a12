"""Gradients, tangent maps and Hessians by kr.differentiable: processor time relative to the motion, and memory.

compile_s, hessian_compile_s   the first call less a later one: recording, and compiling by JAX and for kernels

With KREISEL_CACHE in an empty folder, kernels are compiled as on a new machine.

python benchmarks/derivatives.py [--steps 1000000]      # writes results/derivatives.json
"""

from __future__ import annotations

import time
from typing import Any

import jax
import numpy as np
from cases import machine, parser, write

import kreisel as kr
from kreisel import algebra, reduction as red

REPEAT = 9
START = {"m": (0.1, 0.2, 1.5), "a": (0.6, 0, 0.8)}
BODY = {"M": (0.1, 0.2, 1.5), "P": (0.6, 0, 0.8)}
M4 = algebra.skew(np.array([0.3, -0.2, 0.5, 0.1, 0.4, -0.3]), 4)
SPLIT = kr.perturbed(kr.LagrangeTop(p=(0, 0, 1)), potential=lambda a, *, k: k * a[0] ** 3, params={"k": 0.1})
CASES: list[tuple[Any, dict[str, Any], str, Any]] = [
    (kr.LagrangeTop(p=(0, 0, 1)), START, "suris", 1),
    (kr.LagrangeTop(p=(0, 0, 1)), START, "baecklund", 2),
    (kr.EulerTop(J=(1, 2, 3)), {"M": (0.3, 0.4, 0.5)}, "veselov", 2),
    (kr.LagrangeTop(p=(0, 0, 1)), START, "kahan", 2),
    (kr.EulerTop(J=(1, 2, 3)), {"M": (0.3, 0.4, 0.5)}, "exact", None),
    (kr.Clebsch(b=(1, 2, 3.5)), BODY, "baecklund", 4),
    (SPLIT, START, "splitting", (2, 2)),
    (kr.LagrangeTop(p=(0, 0, 0, 1)), {"m": M4, "a": (0.6, 0, 0, 0.8)}, "suris", 1),
]


def seconds(function: Any, state: Any) -> tuple[float, float]:
    """Of the processor: the first call, which compiles, and the least of some others."""
    times = []
    for _ in range(REPEAT + 1):
        begun = time.process_time()
        jax.block_until_ready(function(state))
        times.append(time.process_time() - begun)
    return times[0], min(times[1:])


def main() -> None:
    options = parser(__doc__, "derivatives")
    options.add_argument("--steps", type=int, default=1_000_000)
    asked, rows = options.parse_args(), []
    steps = asked.steps
    for model, start, method, order in CASES:
        x0 = dict(model.state(**start).axial)
        f = kr.differentiable(model, method=method, order=order)
        with red.double():
            count = steps if model.n == 3 else steps // 10
            letter = list(x0)[-1]
            forward = jax.jit(lambda s, f=f, count=count: f(s, dt=0.1, steps=count))
            gradient = jax.jit(
                jax.grad(lambda s, f=f, count=count, letter=letter: f(s, dt=0.1, steps=count)[letter][0])
            )
            jacobian = jax.jit(jax.jacfwd(lambda s, f=f, count=count: f(s, dt=0.1, steps=count)))
            once, again, columns = (seconds(made, x0) for made in (forward, gradient, jacobian))
            hessian = jax.jit(jax.hessian(lambda s, f=f, letter=letter: f(s, dt=0.1, steps=100)[letter][0]))
            second = seconds(hessian, x0)
            room = gradient.lower(x0).compile().memory_analysis().temp_size_in_bytes
        rows.append({"system": model.system.name, "n": model.n, "method": method, "order": order, "steps": count,
                     "ns_a_step": 1e9 * once[1] / count, "gradient_over_motion": again[1] / once[1],
                     "tangent_over_motion": columns[1] / once[1],
                     "compile_s": again[0] - again[1], "hessian_compile_s": second[0] - second[1],
                     "room_bytes": room})  # fmt: skip
        print(rows[-1], flush=True)
    write({"machine": machine(), "jax": jax.__version__, "rows": rows}, asked.output)


if __name__ == "__main__":
    main()
