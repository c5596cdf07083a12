"""Work and precision: error at T = 100 and 1000 against time of computing, for every method here and four peers.

    make work-precision            installs the peers of peers.txt, measures, writes results and figures

One trajectory on one core, from time 0 to T, only the end state kept; compiling is not counted.  Time is
that of the processor, so that other work on the machine does not count.  All run in one process, alternating; a
figure is the median over the rounds, and `ratio` the median of the ratios, in each round, to heyoka at its full
precision.  `error` is the largest error of a component of the state, relative to the largest component, against Taylor
series in 24 digits (problems.py).  Peers that are not installed are left out, and the result states this.

    kreisel    suris 1, 2; baecklund 2 ... 24; variational 2 ... 8; exact, n = 3: steps of the flow, of the tops at
               each of them the closed form, of Clebsch's case copies of a conjugate pair; exact jump: the end state
               alone; each run as a user calls it, by kr.propagator's `steps` and `at`, with its set-up and checks;
               of the free body veselov 2 ... 8 in the place of the first two
    heyoka     Taylor series, compiled for the problem; its tolerance from 1e-6 to the last bit
    diffrax    Dopri8 and Tsit5 with a PID controller, compiled by JAX
    scipy      DOP853, the right-hand side compiled
    mujoco     RK4 on the engine's model of the top, n = 3

Batches: 64 lanes of kreisel, and heyoka's batch of the width of the machine's vectors, time of a trajectory.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from importlib.metadata import version
from importlib.util import find_spec
from typing import Any

import numpy as np
from cases import RESULTS, machine
from problems import Problem, problems

import kreisel as kr
from kreisel import algebra
from kreisel.graph.recording import flat_constants
from kreisel.kernels.cpu import compiled_rate
from kreisel.method import scheme

TIMES = (100.0, 1000.0)
TOLERANCES = tuple(float(f"1e-{k}") for k in range(6, 16))
ORDERS = {"suris": (1, 2), "variational": (2, 4, 6, 8), "baecklund": (2, 4, 6, 8, 12, 16, 20, 24)}
FREE_ORDERS = {"veselov": (2, 4, 6, 8), "variational": (2, 4, 6, 8)}
BATCHES = {"baecklund": (8, 16, 24), "veselov": (4, 8)}
LANES = 64
FLOOR = 1e-9  # below it a ladder ends where a finer step no longer halves the error
LEAST = 2e-3  # seconds of one measurement
TURNS = 5
PEERS = ("heyoka", "diffrax", "mujoco", "scipy")
BASE = ("heyoka", 1e-16)  # its full precision, whatever it calls that


@dataclass
class Run:
    """`go()` computes the end state, for one trajectory in `lanes` of them."""

    method: str
    setting: float
    go: Callable[[], np.ndarray]
    lanes: int = 1
    error: float = 0.0
    seconds: list[float] = field(default_factory=list)

    def once(self) -> float:
        """Seconds of one run."""
        begun = time.process_time()
        self.go()
        return time.process_time() - begun

    def prime(self) -> float:
        """The first time, which tells how often to repeat; the shorter of two."""
        self.seconds = [max(min(self.once(), self.once()), 1e-7)]
        return self.seconds[0]

    def measure(self) -> None:
        """Seconds of one trajectory, over as many runs as fill LEAST."""
        count = max(1, int(LEAST / self.seconds[0]))
        begun = time.process_time()
        for _ in range(count):
            self.go()
        self.seconds.append((time.process_time() - begun) / count / self.lanes)


def kernel(problem: Problem, method: str, order: int | None, end: float, steps: int, lanes: int = 1) -> Run:
    """A map of kreisel, `steps` steps to the end as a user calls them; no order for the exact flow."""
    p = kr.propagator(problem.model, method=method, order=order, dt=end / steps)
    x = row_of(problem, lanes)
    return _own(Run(method if order is None else f"{method} {order}", end / steps, lambda: p.steps(x, steps), lanes),
                problem, end)  # fmt: skip


def rows(problem: Problem, end: float, steps: int) -> Run:
    """The closed form at every one of the steps, all of them returned; set up anew in each run."""
    p, x = kr.propagator(problem.model, method="exact"), row_of(problem)
    times = end / steps * np.arange(1, steps + 1)
    return _own(Run("exact", end / steps, lambda: p.at(x, times)[-1]), problem, end)


def jump(problem: Problem, end: float, lanes: int = 1) -> Run:
    """The end state from the closed form, which is set up anew in each run."""
    p, x = kr.propagator(problem.model, method="exact"), row_of(problem, lanes)
    return _own(Run("exact jump" + " batch" * (lanes > 1), end, lambda: p.at(x, end), lanes), problem, end)


def row_of(problem: Problem, lanes: int = 1) -> np.ndarray:
    """The start in the form of `kr.propagator`, (size,) or (lanes, size)."""
    x = np.concatenate([algebra.axial(problem.skew), problem.vector]) if problem.n == 3 else problem.start
    return np.tile(x, (lanes, 1)) if lanes > 1 else x


def _own(run: Run, problem: Problem, end: float) -> Run:
    """With the error of a run that returns a state of the propagator."""
    x = run.go().reshape(run.lanes, -1)[0]
    entries = np.concatenate([algebra.coordinates(algebra.hat(x[:3])), x[3:]]) if problem.n == 3 else x
    run.error = off(entries, problem.end(end))
    return run


def heyoka_field(problem: Problem) -> tuple[Any, Any]:
    """The equations for heyoka, all entries in order."""
    import heyoka as hy

    count = len(problem.start)
    if problem.kind == "euler-top":  # in axial vectors, as one would write them; M_12, M_13, M_23 = -z, y, -x
        a, b, c = (float(1 / v) for v in problem.fixed[[1, 2, 0]] + problem.fixed[[2, 0, 1]])
        z, y, x = names = hy.make_vars("z0", "z1", "z2")
        return names, [(z, (b - a) * x * y), (y, (a - c) * x * z), (x, (c - b) * y * z)]
    names = hy.make_vars(*[f"z{i}" for i in range(count)])
    size = count - problem.n
    rows, columns = algebra.triangle(problem.n)
    X = {}
    for x, i, j in zip(names[:size], rows, columns, strict=True):
        X[i, j], X[j, i] = x, -x
    v, w = names[size:], problem.fixed
    if problem.kind == "lagrange-top":
        turn = [v[i] * w[j] - v[j] * w[i] for i, j in zip(rows, columns, strict=True)]
    else:
        turn = [(w[j] - w[i]) * v[i] * v[j] for i, j in zip(rows, columns, strict=True)]
    sign = 1.0 if problem.kind == "lagrange-top" else -1.0
    move = [sign * hy.sum([X[i, j] * v[j] for j in range(problem.n) if j != i]) for i in range(problem.n)]
    return names, list(zip(names, [*turn, *move], strict=True))


def heyoka_single(problem: Problem, tolerance: float) -> Callable[[float], Run]:
    import heyoka as hy

    _, equations = heyoka_field(problem)
    option = {} if tolerance == BASE[1] else {"tol": tolerance}
    engine = hy.taylor_adaptive(equations, problem.start.tolist(), **option)

    def to(end: float) -> Run:
        def go() -> np.ndarray:
            engine.time = 0.0
            engine.state[:] = problem.start
            engine.propagate_until(end)
            return engine.state

        return _with_error(Run("heyoka", tolerance, go), problem, end)

    return to


def heyoka_batch(problem: Problem, tolerance: float) -> Callable[[float], Run]:
    import heyoka as hy

    lanes = hy.recommended_simd_size()
    _, equations = heyoka_field(problem)
    option = {} if tolerance == BASE[1] else {"tol": tolerance}
    start = np.repeat(problem.start[:, None], lanes, 1)
    engine = hy.taylor_adaptive_batch(equations, start.copy(), **option)

    def to(end: float) -> Run:
        def go() -> np.ndarray:
            engine.set_time(0.0)
            engine.state[:] = start
            engine.propagate_until(end)
            return engine.state[:, 0]

        return _with_error(Run("heyoka batch", tolerance, go, lanes), problem, end)

    return to


def diffrax_solver(problem: Problem, name: str, tolerance: float) -> Callable[[float], Run]:
    import diffrax
    import jax

    jax.config.update("jax_enable_x64", True)

    @jax.jit
    def solve(y0: Any, end: Any) -> Any:
        return diffrax.diffeqsolve(
            diffrax.ODETerm(lambda t, y, args: problem.rate(y, jax.numpy)),
            getattr(diffrax, name)(),
            t0=0.0,
            t1=end,
            dt0=None,
            y0=y0,
            stepsize_controller=diffrax.PIDController(rtol=tolerance, atol=tolerance),
            saveat=diffrax.SaveAt(t1=True),
            max_steps=10**8,
            throw=False,
        ).ys[0]

    def to(end: float) -> Run:
        return _with_error(
            Run(f"diffrax {name}", tolerance, lambda: np.asarray(solve(problem.start, end))), problem, end
        )

    return to


def scipy_solver(problem: Problem, tolerance: float) -> Callable[[float], Run]:
    from scipy.integrate import solve_ivp

    plan = scheme(problem.model, "dop853", 1.0, None, False)
    rate, (constants,) = compiled_rate(plan), flat_constants(plan, 1)[0]

    def to(end: float) -> Run:
        def go() -> np.ndarray:
            options = {"method": "DOP853", "rtol": tolerance, "atol": tolerance}
            return solve_ivp(lambda t, y: rate(t, y, constants), (0, end), problem.start, **options).y[:, -1]

        return _with_error(Run("scipy DOP853", tolerance, go), problem, end)

    return to


def mujoco_top(problem: Problem, end: float, steps: int) -> Run:
    """A body on a ball joint: mass 0.1 at distance 1 from the pivot, gravity 10, unit moments about the pivot."""
    import mujoco

    model = mujoco.MjModel.from_xml_string(
        f"""<mujoco><option timestep="{end / steps!r}" gravity="0 0 -10" integrator="RK4"/><worldbody><body>
        <joint type="ball" damping="0" armature="0"/>
        <inertial pos="0 0 1" mass="0.1" diaginertia="0.9 0.9 1"/></body></worldbody></mujoco>"""
    )
    data = mujoco.MjData(model)
    a, m = problem.vector, algebra.axial(problem.skew)
    half = np.arctan2(np.hypot(a[0], a[1]), a[2]) / 2
    turn = np.array([np.cos(half), *(np.sin(half) * np.cross([0, 0, 1], a / np.hypot(a[0], a[1])))])

    def go() -> np.ndarray:
        data.time, data.qpos[:] = 0.0, turn
        data.qvel[:] = algebra.rotation_matrix(turn).T @ m  # in the frame of the body; the inertia is 1
        mujoco.mj_step(model, data, nstep=steps)
        R = algebra.rotation_matrix(data.qpos)
        return np.concatenate([algebra.coordinates(algebra.hat(R @ data.qvel)), R[:, 2]])

    return _with_error(Run("mujoco RK4", end / steps, go), problem, end)


def off(got: np.ndarray, want: np.ndarray) -> float:
    """The largest error of a component, relative to the largest component."""
    return float(abs(got - want).max() / abs(want).max())


def _with_error(run: Run, problem: Problem, end: float) -> Run:
    run.error = off(run.go(), problem.end(end))
    return run


def ladder(make: Callable[[int], Run], first: int, factor: float, limit: float) -> Iterator[Run]:
    """Finer and finer steps, until round-off or the limit of time."""
    steps, last = float(first), np.inf
    while True:
        try:
            run = make(int(steps))
        except (kr.InputError, kr.RunError):  # beyond the domain, or not solved
            steps *= factor
            if steps > 1e9:
                return
            continue
        if run.prime() > limit or (run.error < FLOOR and run.error > last / 2):
            return
        if np.isfinite(run.error) and run.error < 0.1:
            yield run
        steps, last = steps * factor, run.error


def contenders(problem: Problem, end: float, limit: float) -> Iterator[Run]:
    """Everything there is for a problem, each run once."""
    methods = FREE_ORDERS if problem.kind == "euler-top" else ORDERS
    for method, orders in methods.items():
        for order in orders:
            longest = 0.25 if order < 4 or method == "variational" else 0.25 * order
            factor = 2.0 if order < 8 or method == "variational" else 2**0.5
            yield from ladder(
                lambda steps, m=method, o=order: kernel(problem, m, o, end, steps), int(end / longest), factor, limit
            )
    for method, order in ((m, o) for m in methods for o in BATCHES.get(m, ())):
        for run in ladder(
            lambda steps, m=method, o=order: kernel(problem, m, o, end, steps, LANES),
            int(end / (0.25 * order)),
            2**0.5,
            limit * LANES,
        ):
            run.method += " batch"
            yield run
    if problem.kind == "clebsch" and problem.n == 3:
        for dt, lanes in ((dt, lanes) for lanes in (1, LANES) for dt in (20.0, 10.0, 5.0, 2.5, 1.0)):
            run = kernel(problem, "exact", None, end, int(end / dt), lanes)
            run.method += " batch" * (lanes > 1)
            run.prime()
            yield run
    if problem.kind != "clebsch" and problem.n == 3:
        for lanes in (1, LANES):
            run = jump(problem, end, lanes)
            run.prime()
            yield run
        for dt in (1.0, 0.5, 0.125):
            run = rows(problem, end, round(end / dt))
            run.prime()
            yield run
        if problem.kind == "lagrange-top" and find_spec("mujoco"):
            yield from ladder(lambda steps: mujoco_top(problem, end, steps), int(end / 0.1), 2.0, limit * 10)


def adaptive(problem: Problem) -> Iterator[Callable[[float], Run]]:
    """The peers with a tolerance; each is compiled once for all times."""
    if find_spec("heyoka"):
        for tolerance in (*TOLERANCES, BASE[1]):
            yield heyoka_single(problem, tolerance)
            yield heyoka_batch(problem, tolerance)
    for tolerance in TOLERANCES[1:]:
        yield scipy_solver(problem, max(tolerance, 3e-14))
        if find_spec("diffrax"):
            yield diffrax_solver(problem, "Dopri8", tolerance)
            if tolerance >= 1e-10:
                yield diffrax_solver(problem, "Tsit5", tolerance)


def measure(problem: Problem, makers: list[Callable[[float], Run]], end: float, turns: int) -> list[dict[str, Any]]:
    """All runs to one time, alternating."""
    runs = [*contenders(problem, end, 0.05 * (end / 100) ** 0.7)]
    for make in makers:
        runs.append(make(end))
        runs[-1].prime()
    for _ in range(turns):
        for run in runs:
            run.measure()
    base = next((np.array(r.seconds[1:]) for r in runs if (r.method, r.setting) == BASE), None)
    rows = []
    for run in runs:
        seconds = np.array(run.seconds[1:])
        row = {"method": run.method, "setting": run.setting, "error": run.error, "us": np.median(seconds) / end * 1e6}
        rows.append(row | ({} if base is None else {"ratio": np.median(seconds / base)}))
    return [{k: float(f"{v:.4g}") if isinstance(v, float) else v for k, v in row.items()} for row in rows]


def cheapest(rows: list[dict[str, Any]], ours: bool, error: float, batch: bool) -> dict[str, Any] | None:
    """The cheapest run at or below an error, of kreisel's steps or of the peers."""
    own = ("suris", "variational", "baecklund", "veselov", "exact")
    fit = [
        r
        for r in rows
        if r["error"] <= error and r["method"].startswith(own) is ours and r["method"].endswith("batch") is batch
    ]
    return min(fit, key=lambda r: r["us"], default=None)


def verdict(result: dict[str, Any]) -> list[str]:
    """For each problem, time and error: the best of each side, and who wins."""
    lines = []
    for key, rows in result.items():
        for batch in (False, True):
            for error in (1e-6, 1e-9, 1e-12, 1e-13, 1e-14):
                ours, theirs = (cheapest(rows, side, error, batch) for side in (True, False))
                if ours is None and theirs is None:
                    continue
                line = f"{key}{', batch' * batch}, error {error:g}: "
                for run in (ours, theirs):
                    line += f"{run['method']} {run['us']:.3g} us; " if run else "not reached; "
                line += "" if not (ours and theirs) else f"kreisel {theirs['us'] / ours['us']:.2f} times as fast"
                lines.append(line)
    return lines


def main(arguments: list[str] | None = None) -> None:
    """Measure, print the verdict, write JSON and figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--turns", type=int, default=TURNS)
    parser.add_argument(
        "--only", default="", help="only problems whose name contains this; the others keep their results"
    )
    options = parser.parse_args(arguments)
    target = RESULTS / "work_precision.json"
    before = json.loads(target.read_text()) if target.exists() else {}
    result: dict[str, Any] = before.get("runs", {})
    measured: dict[str, Any] = before.get("measured", {})
    there = {p: version(p) if find_spec(p) else "not installed: left out" for p in PEERS}
    for problem in problems():
        if options.only not in problem.name:
            continue
        begun, load = time.perf_counter(), os.getloadavg()[0]
        makers = list(adaptive(problem))
        for end in TIMES:
            result[f"{problem.name}, T = {end:g}"] = measure(problem, makers, end, options.turns)
        measured[problem.name] = {
            "turns": options.turns,
            "load_average": [round(v, 1) for v in (load, os.getloadavg()[0])],
        }
        text = {"machine": machine(), "peers": there, "measured": measured, "verdict": verdict(result)}
        target.write_text(json.dumps(text | {"runs": result}, indent=1) + "\n")
        print(f"{problem.name}: {time.perf_counter() - begun:.0f} s", flush=True)
    print(*verdict(result), sep="\n")
    if len(result) == len(TIMES) * len(problems()):
        import work_precision_figures

        work_precision_figures.main()


if __name__ == "__main__":
    main()
