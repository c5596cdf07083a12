"""The GPU: speed of a call there and on one core, of diffrax on the same GPU, and of the kernel without the call.

    make bench-gpu

`kernel`: steps a second of 10^4 ... 10^7 trajectories, n = 3, rest-frame Lagrange top, the paper's map, by the clock
of the device.  The bound counts the arithmetic instructions of a step in the machine code (gpu_code.py) against the
rate at which the multiprocessors issue them, at the largest clock that the driver names.

`calls`: `kr.simulate`, the last row kept, set-up, copies and projections included, compiling not; steps of all lanes a
second of the wall, the best of `--turns`, with engine="cuda" and, for fewer lanes, with engine="cpu" on one core
of the machine that holds the GPU.  `apart`: the largest difference of a component, without projections.

`diffrax`: Dopri8 with a PID controller, compiled by JAX for the same GPU, `vmap` over the same lanes, and `baecklund`:
seconds of a call and the largest error at T = 100, relative to the largest component, against the closed form, `kr.at`.

Needs an NVIDIA GPU and `pip install 'kreisel[cuda]'`; writes benchmarks/results/gpu.json.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import gpu_code
import numpy as np
from cases import RESULTS, machine
from problems import problems

import kreisel as kr
from kreisel.kernels.gpu import device
from kreisel.runs.planning import make_plan

COUNTS = (10**4, 10**5, 10**6, 10**7)
CHECKED = 100
LANES, STEPS = 10**6, 50_000  # of a call
CORE_LANES, CORE_STEPS = 10**4, 1000  # of a call on one core
TIME, BATCH = 100.0, 10**5
TOLERANCES = (1e-6, 1e-8, 1e-10, 1e-12)
COMPOSITIONS = ((8, 0.5), (8, 0.25), (12, 0.5), (12, 0.25), (16, 0.5), (24, 0.5))  # order and step of baecklund


def plan_of(engine: str, lanes: int) -> Any:
    draw = np.random.default_rng(1)
    top = kr.LagrangeTop(p=draw.normal(size=(lanes, 3)))
    state = top.state(m=draw.normal(size=(lanes, 3)), a=draw.normal(size=(lanes, 3)))
    return make_plan(top, state, dt=0.05, steps=1, every=1, method="suris", order=1, orientation=None, engine=engine)


def speed(engine: str, lanes: int, turns: int) -> dict[str, float]:
    """Steps a second of the kernel, without the call, by the clock of the device."""
    import cupy

    work = plan_of(engine, lanes).engine
    steps = max(100, 2 * 10**10 // lanes // 10)
    rows = cupy.empty((1, *work.z.shape[::-1]), dtype=work._real)

    def launch(steps: int) -> None:
        arrays = work._state, work._constants, work._stages, rows
        work._device.launch(work._kernel, lanes, *arrays, 1, steps, work._stage_count)

    launch(10)
    alone = []
    for _ in range(turns):
        before, after = cupy.cuda.Event(), cupy.cuda.Event()
        before.record()
        launch(steps)
        after.record()
        after.synchronize()
        alone.append(steps * lanes / (cupy.cuda.get_elapsed_time(before, after) * 1e-3))
    low, middle, high = np.percentile(alone, [25, 50, 75])
    return {"steps": steps, "per_second": float(middle), "quartiles": [float(low), float(high)]}


def subjects(lanes: int) -> dict[str, tuple[Any, Any, dict[str, Any]]]:
    """Systems with `lanes` states, and the method."""
    draw = np.random.default_rng(1)

    def vectors(count: int = 3) -> Any:
        return draw.normal(size=(lanes, count))

    top, heavy = kr.LagrangeTop(p=(0, 0, 1)), kr.LagrangeTopMoving(A=(0, 0, 1), alpha=0.7)
    body, clebsch = kr.EulerTop(J=(0.5, 0.75, 1.25)), kr.Clebsch(b=(0.3, 0.7, 1.9))
    kovalevskaya = kr.KovalevskayaTopSO3()
    forced = kr.perturbed(
        body, potential=lambda g, t, *, k: k * np.sin(t) * g[2, 2] ** 2, damping=0.01, params={"k": 0.1}
    )
    attitude = {"orientation": (1, 0, 0, 0)}
    return {
        "LagrangeTop, suris": (top, top.state(m=vectors(), a=vectors()), {"method": "suris"}),
        "LagrangeTop, baecklund 8": (top, top.state(m=vectors(), a=vectors()), {"method": "baecklund", "order": 8}),
        "LagrangeTopMoving with attitude, suris": (
            heavy,
            heavy.state(M=vectors(), P=vectors()),
            {"method": "suris"} | attitude,
        ),
        "EulerTop, veselov 2": (body, body.state(M=vectors()), {"method": "veselov", "order": 2}),
        "Clebsch, suris": (clebsch, clebsch.state(M=vectors(), P=vectors()), {"method": "suris"}),
        "KovalevskayaTopSO3, suris": (
            kovalevskaya,
            kovalevskaya.state(M=vectors(), P=vectors(), Q=vectors()),
            {"method": "suris"},
        ),
        "EulerTop with a torque, splitting": (
            forced,
            forced.state(M=vectors()),
            {"method": "splitting", "order": (2, 2)} | attitude,
        ),
    }


def seconds(call: Callable[[], Any], turns: int) -> float:
    """The least time of a call, after one that compiles."""
    call()
    times = []
    for _ in range(turns):
        begun = time.perf_counter()
        call()
        times.append(time.perf_counter() - begun)
    return min(times)


def call(subject: tuple[Any, Any, dict[str, Any]], steps: int, engine: str, **options: Any) -> Any:
    """A run of which the last row is kept."""
    model, start, method = subject
    asked = method | options | {"dt": 0.05, "steps": steps, "every": steps, "progress": False}
    return kr.simulate(model, start, engine=engine, **asked)


def calls(turns: int) -> dict[str, dict[str, float]]:
    """Lane-steps a second of `kr.simulate`, on the GPU and on one core, and the difference of their states."""
    result: dict[str, dict[str, float]] = {}
    few, cores = subjects(CORE_LANES), os.sched_getaffinity(0)
    for name, subject in subjects(LANES).items():
        gpu = LANES * STEPS / seconds(partial(call, subject, STEPS, "cuda"), turns)
        os.sched_setaffinity(0, {min(cores)})
        core = CORE_LANES * CORE_STEPS / seconds(partial(call, few[name], CORE_STEPS, "cpu"), turns)
        os.sched_setaffinity(0, cores)
        ends = [call(few[name], CHECKED, engine, project=False) for engine in ("cuda", "cpu")]
        letters = few[name][0].system.space.letters
        difference = max(float(abs(ends[0][x].values - ends[1][x].values).max()) for x in letters)
        result[name] = {"gpu": gpu, "core": core, "ratio": gpu / core, "apart": difference}
        print(f"{name:42s} {gpu:.3g} steps/s, {gpu / core:.0f} times one core, {difference:.1e} apart")
    return result


def against_diffrax(turns: int) -> list[dict[str, Any]]:
    """Seconds and errors of `BATCH` tops to `TIME` on this GPU, by baecklund and by diffrax."""
    (problem,) = (p for p in problems() if p.name == "lagrange-top, n = 3")
    draw = np.random.default_rng(2)
    model, start = problem.model, {x: draw.normal(size=(BATCH, 3)) for x in ("m", "a")}
    truth = kr.at(model, start, TIME)
    true = np.concatenate([truth[x].values.reshape(BATCH, 3) for x in ("m", "a")], axis=1)

    def error(m: Any, a: Any) -> float:
        state = np.concatenate([np.reshape(m, (BATCH, 3)), np.reshape(a, (BATCH, 3))], axis=1)
        return float(abs(state - true).max() / abs(true).max())

    rows = []
    for order, dt in COMPOSITIONS:
        steps = round(TIME / dt)
        asked = {"method": "baecklund", "order": order, "dt": dt, "steps": steps, "every": steps, "progress": False}
        run = kr.simulate(model, start, engine="cuda", **asked)
        took = seconds(partial(kr.simulate, model, start, engine="cuda", **asked), turns)
        rows.append({"method": f"kreisel baecklund {order}, dt = {dt:g}", "seconds": took,
                     "error": error(run.m.values[-1], run.a.values[-1])})  # fmt: skip
    return rows + (_diffrax(problem, start, error, turns) if find_spec("diffrax") else [])


def _diffrax(problem: Any, start: dict[str, Any], error: Callable[..., float], turns: int) -> list[dict[str, Any]]:
    os.environ.setdefault("XLA_PYTHON_CLIENT_PREALLOCATE", "false")  # CuPy needs memory too
    import diffrax
    import jax

    jax.config.update("jax_enable_x64", True)
    entries = start["m"] @ SKEW
    z0 = jax.numpy.asarray(np.concatenate([entries, start["a"]], axis=1))
    rows = []
    for tolerance in TOLERANCES:

        def to(y0: Any, tolerance: float = tolerance) -> Any:
            return diffrax.diffeqsolve(
                diffrax.ODETerm(lambda t, y, args: problem.rate(y, jax.numpy)), diffrax.Dopri8(), t0=0.0, t1=TIME,
                dt0=None, y0=y0, stepsize_controller=diffrax.PIDController(rtol=tolerance, atol=tolerance),
                saveat=diffrax.SaveAt(t1=True), max_steps=10**6, throw=False,
            ).ys[0]  # fmt: skip

        solve = jax.jit(jax.vmap(to))
        end = np.asarray(solve(z0))
        took = seconds(lambda solve=solve: np.asarray(solve(z0)), turns)
        rows.append({"method": f"diffrax Dopri8, tolerance {tolerance:.0e}", "seconds": took,
                     "error": error(end[:, :3] @ SKEW.T, end[:, 3:])})  # fmt: skip
    return rows


SKEW = np.array([[0, 0, -1], [0, 1, 0], [-1, 0, 0.0]])  # entries (1,2), (1,3), (2,3) of hat(m) are m @ SKEW


def bound(engine: str) -> dict[str, Any]:
    """Steps a second that the arithmetic instructions allow."""
    device()  # refused if there is none
    import cupy

    gpu = cupy.cuda.Device()
    count = gpu_code.counted(plan_of(engine, 1).scheme, engine, gpu.compute_capability)
    processors, hertz = gpu.attributes["MultiProcessorCount"], 1e3 * gpu.attributes["ClockRate"]
    most = gpu_code.bound(count, engine, processors, hertz)
    return count | {"multiprocessors": processors, "clock_hz": hertz, "steps_per_second": most}


def driver() -> str:
    asked = ["nvidia-smi", "--query-gpu=name,driver_version", "--format=csv,noheader"]
    return subprocess.run(asked, capture_output=True, text=True, check=True).stdout.strip()


def kernels(turns: int) -> dict[str, Any]:
    """Steps a second of the kernel, against the bound."""
    result: dict[str, Any] = {}
    for engine in gpu_code.RATES:
        limit = bound(engine)
        rows = {str(count): speed(engine, count, turns) for count in COUNTS}
        best = max(row["per_second"] for row in rows.values())
        result[engine] = {"bound": limit, "fraction": best / limit["steps_per_second"], "lanes": rows}
        print(f"{engine}: {best:.3g} steps/s, {best / limit['steps_per_second']:.2f} of the bound")
    return result


def main(arguments: list[str] | None = None) -> None:
    """Measure, print, write the JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--turns", type=int, default=3)
    parser.add_argument("--output", type=Path, default=RESULTS / "gpu.json")
    options = parser.parse_args(arguments)
    try:
        device()
    except kr.InputError as error:
        sys.exit(str(error))
    result = {"machine": machine(), "gpu": driver(), "turns": options.turns, "kernel": kernels(options.turns)}
    result |= {"calls": calls(options.turns), "diffrax": against_diffrax(options.turns)}
    for row in result["diffrax"]:
        print(f"{row['method']:40s} {row['seconds']:.4f} s, error {row['error']:.1e}")
    options.output.write_text(json.dumps(result, indent=1) + "\n")
    print(f"Written: {options.output}")


if __name__ == "__main__":
    main()
