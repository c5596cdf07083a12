"""Effects of rounding on a run: integrals and states after 10^5 to 10^9 steps, with and without the projection.

maps        the same of the paper's maps, as they are timed
integrals   the largest change of anything conserved, in units in the last place of its scale (`kr.drift`, ulps), at a
            hundred rows just after a projection; and the largest correction; of every system by its default
            method
states      the largest error of the state, over the number of steps, of random Lagrange tops, against the closed form
            of the iterates of the same map (`kr.at`), which makes no step
against     the same over |z| of other maps and orders, n = 3, against the map itself in double-double (`reference.py`)
condition   of the same problems: by how much a random change of the initial state by half a unit in the last place
            changes the state at the end
longest     the first of `maps` for a hundred times the steps
            (each run of these three needs at most `--seconds` of the processor, by fewer steps)
picture     docs/round-off.png: one top by RK4, by DOP853, by the map without projection and by the projected map

    python benchmarks/roundoff.py [--steps 1e8] [--lanes 100] [--seconds 60] [--part NAME]
"""

from __future__ import annotations

import json
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from cases import cases, machine, parser, write
from reference import Reference

import kreisel as kr
from kreisel import algebra
from kreisel.kernels.cpu import CpuEngine
from kreisel.lab import exact
from kreisel.method import default_method
from kreisel.method.scheme import Steps, observer, scheme_of
from kreisel.record.calling import call
from kreisel.runs.planning import make_plan
from kreisel.system import REGISTRY

ROWS = 100
PARTS = ("integrals", "maps", "states", "against", "condition", "brickwork", "longest", "picture")
PICTURE = Path(__file__).parents[1] / "docs" / "round-off.png"
DT = 0.1
CHANGE = 1e-10  # of a state, relative, whose effect is measured; that of half a unit in the last place is in proportion
# A record of the map, and the share of the steps that its cost in double-double allows.
MAPS = (
    ("lagrange-top", "suris", 1, 1.0),
    ("lagrange-top", "baecklund", 2, 1.0),
    ("lagrange-top", "baecklund", 8, 0.1),
    ("lagrange-top", "baecklund", 24, 0.1),
    ("clebsch", "suris", 1, 1.0),
    ("clebsch", "baecklund", 2, 1.0),
    ("neumann", "suris", 1, 1.0),
    ("neumann", "baecklund", 2, 1.0),
    ("euler-top", "veselov", None, 1.0),
)
START = {"m": (0.1, 0.2, 1.5), "a": (0.6, 0.0, 0.8)}


# n, and the share of the steps that its cost allows.
DIMENSIONS = {3: 1.0, 4: 0.1, 5: 0.1, 10: 0.1, 100: 0.01}
LARGE = ("lagrange-top", "lagrange-top-moving", "clebsch")
# Of the Lagrange top with p = (0, 0, 1): an equilibrium, states close to one, and motions with fewer frequencies.
DEGENERATE = {
    "hanging": {"m": (0.0, 0.0, 0.0), "a": (0.0, 0.0, -1.0)},
    "sleeping": {"m": (0.0, 0.0, 2.5), "a": (0.0, 0.0, 1.0)},
    "1e-8 beside sleeping": {"m": (1e-8, 0.0, 2.5), "a": (0.0, 1e-8, 1.0)},
    "steady precession": {"m": (0.6, 0.0, 1 / 0.6 + 0.8), "a": (0.6, 0.0, 0.8)},
    "plane pendulum": {"m": (0.0, 0.9, 0.0), "a": (0.6, 0.0, 0.8)},
}


def integrals(steps: int, seconds: float, result: dict[str, Any], save: Callable[[], None]) -> None:
    """For each system and n the worst change and correction, by its default method; the tops' maps with suris too.

    Results go into `result`; runs that it has already are not repeated.
    """
    for what, model, state, method, dt, count in _cases(steps):
        if what in result and result[what].get("asked") == count:
            continue
        try:
            result[what] = _still(model, state, method, dt, count, seconds)
        except (kr.RunError, kr.InputError) as error:
            result[what] = {"not run": str(error)}
        result[what]["asked"] = count
        print(f"{what}: {result[what]}", flush=True)
        save()


def _cases(steps: int) -> Iterator[tuple[str, Any, Any, str, float, int]]:
    for n, share in DIMENSIONS.items():
        for name, system in REGISTRY.items():
            if system.n not in (None, n) or (n > 5 and name not in LARGE):
                continue
            draw = exact.float_random(np.random.default_rng([7, n]))
            model = exact.random_model(system, n, draw)
            state = dict(zip(system.space.letters, system.space.point(n, draw), strict=True))
            methods = {default_method(model, stepped=True)} | (
                {"suris"} if system.map and not system.map.symmetric else set()
            )
            dt = {"rosochatius": 0.02}.get(name, DT) * (1 if n < 100 else 0.01)
            for method in sorted(methods - {"dop853", "exact"}):
                yield f"{name}, n = {n}, {method}", model, state, method, dt, int(steps * share)
    for kind, state in DEGENERATE.items():
        for method in ("suris", "baecklund"):
            yield f"lagrange-top, {kind}, {method}", kr.LagrangeTop(p=(0, 0, 1)), state, method, DT, steps // 10


def _still(model: Any, state: Any, method: str, dt: float, steps: int, longest: float) -> dict[str, Any]:
    """After about a hundredth of the steps and after all of them, or as many as `longest` seconds allow.

    Rows are saved just after a projection, if there were enough projections.
    """
    row: dict[str, Any] = {"dt": dt, "ulps": {}}
    count, seconds = max(steps // 100, ROWS), 0.0
    short = kr.simulate(model, state, dt=dt, steps=ROWS, every=1, method=method, progress=False)  # compiles
    often = int(short.attrs.get("projection", 1))
    while True:
        begun = time.process_time()
        every = count // ROWS if count < often * ROWS else round(count / ROWS / often) * often
        settings = {"dt": dt, "steps": every * ROWS, "every": every, "method": method}
        run = kr.simulate(model, state, **settings, progress=False)
        seconds = time.process_time() - begun
        table = kr.drift(run)
        table = table[table.conserved & (table.ulps < np.inf)]
        row["ulps"][f"{count:.0e}"] = round(float(table.ulps.max()), 1)
        more = steps // count
        while more > 1 and seconds * more > longest:
            more //= 10
        if more <= 1:
            break
        count *= more
    correction = float(table.correction.max())
    return row | {
        "steps": every * ROWS,
        "correction": None if np.isnan(correction) else round(correction, 1),
        "every": run.attrs["projection"],
        "ns": round(1e9 * seconds / (every * ROWS), 1),
    }


def states(steps: int, lanes: int) -> dict[str, Any]:
    """Errors over the number of steps, of the map of order 1 and of its iterates in closed form."""
    draw = np.random.default_rng(5)
    top = kr.LagrangeTop(p=draw.normal(size=(lanes, 3)))
    a = draw.normal(size=(lanes, 3))
    x0 = top.state(m=draw.normal(size=(lanes, 3)), a=a / np.sqrt((a * a).sum(-1, keepdims=True)))
    out: dict[str, Any] = {"lanes": lanes, "dt": DT}
    for project in (True, False):
        rows = {}
        for count in [10**k for k in range(5, 10) if 10**k <= steps]:
            true = kr.at(top, x0, float(count), method="suris", dt=DT, order=1)
            settings = {"dt": DT, "steps": count, "every": count, "method": "suris", "order": 1, "project": project}
            end = kr.simulate(top, x0, progress=False, **settings).isel(time=-1)
            error = np.max([abs(end[k].values - true[k].values).max(-1) for k in "ma"], 0) / count
            rows[f"{count:.0e}"] = {"median": float(f"{np.median(error):.2g}"), "worst": float(f"{error.max():.2g}")}
            print(f"project = {project}, {count:.0e} steps: {rows[f'{count:.0e}']}", flush=True)
        out["projected" if project else "raw"] = rows
    return out


def against(steps: int, lanes: int, names: list[str] | None) -> dict[str, Any]:
    """Errors of the state over |z| and the number of steps, of random problems; the slope in N of log10 error."""
    out = {}
    for name, method, order, share in MAPS:
        if names and named(name, method, order) not in names:
            continue
        counts, every = [10**k for k in range(4, 10) if 10**k <= steps * share], 0
        if len(counts) < 2:
            continue
        error = {project: np.empty((lanes, len(counts))) for project in (True, False)}
        with tempfile.TemporaryDirectory() as folder:
            for lane in range(lanes):
                model, state = problem(name, lane)
                true = None
                for project, found in error.items():
                    settings = {"dt": DT, "steps": counts[-1], "every": 1, "orientation": None}
                    plan = make_plan(model, state, **settings, method=method, order=order, project=project)
                    every = plan.engine.projection.every if project else every
                    true = Reference(plan).states(counts, Path(folder)) if true is None else true
                    for row, count in enumerate(counts):
                        plan.engine.advance(np.empty((1, 1, true.shape[1])), count - (counts[row - 1] if row else 0))
                        off = (plan.engine.z[0] - true[row, :, 0]) - true[row, :, 1]
                        found[lane, row] = abs(off).max() / abs(true[row, :, 0]).max() / count
        rows = {}
        for project, found in error.items():
            slope = np.polyfit(np.log10(counts), np.log10(np.median(found, 0)) + np.log10(counts), 1)[0]
            result = [{"median": float(f"{np.median(e):.2g}"), "worst": float(f"{e.max():.2g}")} for e in found.T]
            kind = "projected" if project else "raw"
            rows[kind] = {f"{n:.0e}": row for n, row in zip(counts, result, strict=True)} | {"slope": round(slope, 2)}
        out[named(name, method, order)] = rows | {"problems": lanes, "every": every}
        print(name, method, order, rows, flush=True)
    return out


def condition(steps: int, lanes: int) -> dict[str, Any]:
    """That over |z| and the number of steps, the largest of three changes of each problem."""
    out = {}
    for name, method, order, share in MAPS:
        count, found = int(steps * share), []
        for lane in range(lanes):
            model, state = problem(name, lane)

            def end(z: dict[str, Any], model: Any = model, case: Any = (count, method, order)) -> np.ndarray:
                asked = {"dt": DT, "steps": case[0], "every": 1, "orientation": None}
                plan = make_plan(model, z, **asked, method=case[1], order=case[2])
                plan.engine.advance(np.empty((1, 1, plan.engine.z.shape[1])), case[0])
                return np.array(plan.engine.z[0])

            draw, there = np.random.default_rng([12, lane]), end(state)
            off = [abs(end(moved(state, draw)) - there).max() for _ in range(3)]
            found.append(max(off) / CHANGE * np.finfo(float).eps / 2 / abs(there).max() / count)
        row = {"steps": count, "median": float(f"{np.median(found):.2g}"), "worst": float(f"{max(found):.2g}")}
        out[named(name, method, order)] = row
        print(name, method, order, row, flush=True)
    return out


def brickwork(steps: int) -> list[dict[str, Any]]:
    """Change of the integrals in a step without projection, five random states, n = 3.

    cos 2t and (sin 2t)/s of the gate obey C^2 + D S^2 = 1.  Rounded, they do so to half a unit, the same in each step.
    """
    rows = []
    for D, dt, exact_constants in ((3.0, 1.0, True), (15.0, 1.0, True), (3.0, 0.1, False), (0.7, 0.1, False)):
        found = []
        for lane in range(5):
            spins = np.random.default_rng([13, lane]).normal(size=(2, 3, 3))
            S, T = spins / np.linalg.norm(spins, axis=1, keepdims=True)
            model = kr.LatticeLandauLifshitz(n=3, D=D)
            state = model.state(Sx=S[0], Sy=S[1], Sz=S[2], Tx=T[0], Ty=T[1], Tz=T[2])
            settings = {"dt": dt, "steps": steps, "every": steps // ROWS, "method": "brickwork", "project": False}
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", kr.AccuracyWarning)  # dt = 1 is far beyond the motion
                table = kr.drift(kr.simulate(model, state, progress=False, **settings))
            found.append(table[table.conserved].ulps.max() / steps)
        row = {"D": D, "dt": dt, "constants": "exact" if exact_constants else "rounded", "steps": steps}
        rows.append(row | {"ulps_a_step": [float(f"{x:.2g}") for x in sorted(found)]})
        print(rows[-1], flush=True)
    return rows


def named(name: str, method: str, order: int | None) -> str:
    return f"{name}, {method} {order or ''}".strip()


def problem(name: str, lane: int) -> tuple[Any, dict[str, Any]]:
    """A random system of that name, n = 3, and a state."""
    draw = exact.float_random(np.random.default_rng([11, lane]))
    model = exact.random_model(REGISTRY[name], 3, draw)
    space = model.system.space
    return model, dict(zip(space.letters, space.point(3, draw), strict=True))


def moved(state: dict[str, Any], draw: np.random.Generator) -> dict[str, Any]:
    """A state that differs by about CHANGE of the largest entry of each component; particles stay on their sphere."""
    out = {}
    for letter, z in state.items():
        change = draw.normal(size=z.shape)
        out[letter] = z + CHANGE * abs(z).max() * ((change - change.T) / 2 if z.ndim == 2 else change)
    if "x" in out:
        x = out["x"] / np.linalg.norm(out["x"])
        out |= {"x": x, "q": out["q"] - x * (x @ out["q"])}
    return out


def picture(steps: int) -> dict[str, Any]:
    """Change of the energy and error of the state against steps, by four methods."""
    import matplotlib.pyplot as plt

    top = kr.LagrangeTop(p=(0, 0, 1))
    counts = np.unique(np.geomspace(10, steps, 33).astype(np.int64))
    curves: dict[str, Any] = {}
    reference = {
        kind: kr.at(
            top, START, counts * (1.0 if dt else DT), **({"method": "suris", "dt": dt, "order": 1} if dt else {})
        )
        for kind, dt in (("map", DT), ("flow", None))
    }
    for label, kind in (
        ("RK4", "flow"),
        ("DOP853", "flow"),
        ("the map as it is", "map"),
        ("the map, projected", "map"),
    ):
        true, most = reference[kind], 10**5 if label == "DOP853" else steps
        rows = [_row(top, label, int(count), true.isel(time=k)) for k, count in enumerate(counts) if count <= most]
        curves[label] = {
            "steps": counts[: len(rows)].tolist(),
            "integral": [r[0] for r in rows],
            "state": [r[1] for r in rows],
        }
        print(label, curves[label]["integral"][-1], curves[label]["state"][-1], flush=True)
    figure, axes = plt.subplots(1, 2, figsize=(9.6, 3.8), layout="constrained")
    for axis, what, title in zip(
        axes, ("integral", "state"), ("change of the energy", "error of the state"), strict=True
    ):
        for label, curve in curves.items():
            axis.loglog(curve["steps"], np.maximum(curve[what], 1e-17), label=label, marker=".", lw=1.2)
        axis.set(xlabel="steps of 0.1", title=title, ylim=(5e-18, 30))
        axis.grid(alpha=0.3)
    axes[0].legend(frameon=False)
    figure.savefig(PICTURE, dpi=150, metadata={"Software": "Kreisel"})
    return curves


def _row(top: Any, label: str, count: int, true: Any) -> tuple[float, float]:
    """The largest change of the energy (deformed, of the map) over the last thousandth, and the error of the state."""
    options: dict[str, Any] = {"dt": DT, "steps": count, "every": count, "progress": False}
    if label == "RK4":
        m, a = runge_kutta(top, count)
        energy = float(abs(m @ m / 2 + a[2] - (np.dot(START["m"], START["m"]) / 2 + START["a"][2])))
        return energy, float(max(abs(m - true.m.values).max(), abs(a - true.a.values).max()))
    if label == "DOP853":
        run, name = kr.simulate(top, START, method="dop853", **options), "energy"
    else:
        project = label.endswith("projected")
        run, name = kr.simulate(top, START, method="suris", order=1, project=project, **options), "energy_eps"
    end = run.isel(time=-1)
    error = max(float(abs(end[k].values - true[k].values).max()) for k in "ma")
    return float(abs(end[name] - run[name][0])), error


def runge_kutta(top: Any, steps: int) -> tuple[Any, Any]:
    """m and a after steps of RK4, compiled as the maps are."""

    def step(*z: Any, eps: Any, **constants: Any) -> Any:
        def moved(factor: Any, rates: Any) -> Any:
            return [x + factor * y for x, y in zip(z, rates, strict=True)]

        def rate(x: Any) -> Any:
            return call(top.system.flow, x, constants)

        k1 = rate(z)
        k2 = rate(moved(eps / 2, k1))
        k3 = rate(moved(eps / 2, k2))
        k4 = rate(moved(eps, k3))
        return tuple(moved(eps / 6, [a + 2 * b + 2 * c + d for a, b, c, d in zip(k1, k2, k3, k4, strict=True)]))

    constants, axes = {**top.constants, "eps": np.asarray(DT)}, {**top.axes, "eps": 0}
    scheme = scheme_of("rk4", top, Steps(step), observer(top), constants=constants, axes=axes)
    engine = CpuEngine(scheme, algebra.flatten([*top.state(**START).values()], scheme.kinds)[None])
    engine.advance(np.empty((1, *engine.z.shape)), steps)
    m, a = algebra.restore(engine.z[0], scheme.kinds, 3)
    return algebra.axial(m), a


def main(arguments: list[str] | None = None) -> None:
    options = parser(__doc__, "roundoff")
    options.add_argument("--steps", type=float, default=1e8)
    options.add_argument("--lanes", type=int, default=100)
    options.add_argument("--seconds", type=float, default=60.0)
    options.add_argument("--part", action="append", choices=PARTS)
    options.add_argument("--map", action="append", choices=[named(*row[:3]) for row in MAPS], help="of part against")
    asked = options.parse_args(arguments)
    steps, parts = int(asked.steps), asked.part or PARTS
    result: dict[str, Any] = {}
    if asked.part and asked.output.exists():
        result = json.loads(asked.output.read_text())
    result |= {"machine": machine(), "steps": steps}
    if "integrals" in parts:
        integrals(steps, asked.seconds, result.setdefault("integrals", {}), lambda: write(result, asked.output))
    if "maps" in parts:
        result["maps"] = {
            case.name: _still(case.model, case.states["standard"], "suris", DT, steps, asked.seconds)
            for case in cases()
        }
    if "states" in parts:
        result["states"] = states(min(steps, 10**8), asked.lanes)
    if "against" in parts:
        result.setdefault("against", {}).update(against(min(steps, 10**7), asked.lanes, asked.map))
    if "condition" in parts:
        result["condition"] = condition(min(steps, 10**6), asked.lanes)
    if "brickwork" in parts:
        result["brickwork"] = brickwork(min(steps, 10**6))
    if "longest" in parts:
        case = cases()[0]
        result["longest"] = _still(case.model, case.states["standard"], "suris", DT, 100 * steps, 60 * asked.seconds)
    if "picture" in parts:
        result["picture"] = picture(steps)
    write(result, asked.output)


if __name__ == "__main__":
    main()
