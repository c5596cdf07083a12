"""The tables of docs/performance.md, from the committed results: `python benchmarks/tables.py`."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

RESULTS = Path(__file__).parent / "results"
IDLE = 0.5  # load average below which a time by the clock is meaningful for two cores


def speed_and_stillness() -> str:
    """One line for each map, n = 3: times of a step, ratios to C++ in one run, worst integral after the most steps."""
    single, many, still = _result("single")["maps"], _result("ensemble")["maps"], _result("roundoff")["maps"]
    steps = max((k for row in still.values() for k in row["ulps"]), key=float)
    power = str(round(math.log10(float(steps)))).translate(str.maketrans("6789", "⁶⁷⁸⁹"))
    head = [
        "map, n = 3",
        "ns a step",
        "to C++",
        "ns a lane-step",
        "to C++",
        f"worst integral after 10{power} steps, ulps",
    ]
    rows = [
        [f"`{name}`", f"{row['kernel']['ns']:.1f}", f"{row['kernel/cpp']:.2f}", f"{many[name]['kernel']['ns']:.2f}",
         f"{many[name]['kernel/cpp']:.2f}", f"{still[name]['ulps'][steps]:.0f}"]
        for name, row in single.items()
    ]  # fmt: skip
    return _table(head, rows)


def _result(name: str) -> dict[str, Any]:
    result: dict[str, Any] = json.loads((RESULTS / f"{name}.json").read_text())
    return result


def _table(head: list[str], rows: list[list[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def ensembles() -> str:
    """Time of a lane-step on one core, to C++, the part of the instruction bound, and all cores against one."""
    result = _result("ensemble")
    rows = []
    for name, row in result["maps"].items():
        part = f"{row['bound']['fraction_reached']:.2f}" if "bound" in row else "-"
        cores = [
            f"{row[key]:.2f}" if result["load_average_before"] < IDLE else "not measured"
            for key in ("one/all_cores", "one/all_cores, cpp")
        ]
        rows.append([f"`{name}`", f"{row['kernel']['ns']:.1f}", f"{row['kernel/cpp']:.2f}",
                     part, *cores])  # fmt: skip
    head = ["map, n = 3", "ns a lane-step, one core", "to C++",
            "part of the instruction bound", "both cores to one", "the same for C++"]  # fmt: skip
    return _table(head, rows)


def saving_cost() -> str:
    """Time with saving and all integrals over time without."""
    result = _result("saving")["runs"]
    every = [key for key in next(iter(result.values())) if key.startswith("every")]
    rows = [[f"`{name}`", *(f"{row[key]['ratio']:.2f}" for key in every)] for name, row in result.items()]
    return _table(["system, method; n = 3", *every], rows)


def dimensions() -> str:
    """Time of a step against n, and the exponents."""
    result = _result("dimension")
    sizes = list(dict.fromkeys(n for row in result["ns"].values() for n in row))
    rows = []
    for name, row in result["ns"].items():
        fits = [f"{fit[name]:.2f}" if name in fit else "-" for fit in result["exponents"].values()]
        rows.append([name, *(_time(row[n]) if n in row else "-" for n in sizes), *fits])
    head = ["system; n =", *sizes, *(f"exponent, n ≥ {first}" for first in result["exponents"])]
    return _table(head, rows)


def _time(ns: float) -> str:
    """Nanoseconds in a unit that is easy to read."""
    for unit, size in (("ns", 1.0), ("µs", 1e3), ("ms", 1e6)):
        if ns < 1000 * size or unit == "ms":
            return f"{ns / size:.3g} {unit}"
    raise AssertionError


def startup() -> str:
    """Seconds of fresh processes."""
    result = _result("startup")
    rows = [
        [f"`{name}`", *(f"{row[k][v]:.2f}" for k in ("processor", "wall") for v in ("least", "median")),
         f"{row['to import numpy']:.1f}", str(row.get("goal", "-"))]
        for name, row in result["starts"].items()
    ]  # fmt: skip
    head = ["", "processor s, least", "median", "clock s, least", "median", "times `import numpy`", "goal, s"]
    return _table(head, rows)


def gpu_code() -> str:
    """The kernels of the GPU: registers, instructions of a step and the bound that they are."""
    result = _result("gpu_code")
    rows = []
    for name, row in result["kernels"].items():
        kernel, _, precision = name.rpartition(", ")
        step = f"{row['passes']} stages of {row['arithmetic']}" if row["passes"] > 1 else str(row["arithmetic"])
        registers = str(row["registers"]) + f", {row['spilled_bytes']} bytes spilled" * bool(row["spilled_bytes"])
        rows.append([kernel, precision, step, str(row["others"]), registers, f"{row['steps_per_second']:.2g}"])
    head = ["kernel", "precision", "arithmetic instructions a step", "others", "registers", "bound, steps/s"]
    return _table(head, rows)


def gpu_calls() -> str:
    """Calls of `kr.simulate` on a GPU, and on one core."""
    rows = []
    for name, row in _result("gpu")["calls"].items():
        difference = f"{row['apart']:.0e}" if row["apart"] else "0"
        rows.append([name, f"{row['gpu']:.2g}", f"{row['core']:.2g}", f"{row['ratio']:.0f}", difference])
    return _table(["system, method", "GPU, steps/s", "one core, steps/s", "ratio", "difference"], rows)


def gpu_diffrax() -> str:
    """Kreisel and diffrax on one GPU: seconds of a call, and errors."""
    rows = [[row["method"], f"{row['seconds']:.2f}", f"{row['error']:.0e}"] for row in _result("gpu")["diffrax"]]
    return _table(["10⁵ tops to T = 100", "seconds", "largest error"], rows)


def satellite_day() -> str:
    """Satellites after a day at default settings, against their equations."""
    names = {"gravity": "gravity, 1.5 degrees per second", "fast": "gravity, 8 degrees per second",
             "eccentric": "gravity, e = 0.7", "dipole": "magnetic dipole, e = 0.02",
             "light": "sunlight from a fixed direction", "air": "air of 5·10⁻¹³ kg/m³"}  # fmt: skip
    rows = [
        [
            names[name],
            f"{row['dt']:.2g} s",
            f"{row['off']:.0e} rad",
            f"{row['expected']:.0e}",
            f"{row['seconds']:.2g} s",
        ]
        for name, row in _result("satellite_day")["cases"].items()
    ]
    head = ["box or 3U CubeSat, 500 km", "dt", "off after a day", "`expected_error`", "CPU time with the search"]
    return _table(head, rows)


def calls() -> str:
    """Microseconds of a call of `kr.propagator`, one state and a lane of an ensemble."""
    rows = []
    for name, row in _result("propagator")["figures"].items():
        one, lane = (row.get(f"{what}{each}") for what in _CALLS[:1] for each in ("", " a lane"))
        one, lane = (one, lane) if one is not None else (row.get(_CALLS[1]), row.get(f"{_CALLS[1]} a lane"))
        if one is not None and lane is not None:
            further = row.get("further step us")
            rows.append([name, f"{one:.1f}", f"{lane:.2f}", "" if further is None else f"{1e3 * further:.0f}"])
    head = ["`kr.propagator`", "one state, µs", "one of 4,096 lanes, µs", "each further step, ns"]
    return _table(head, rows)


_CALLS = ("one step us", "a state at a time us")


def code() -> str:
    """Files of `kreisel code` next to the kernel."""
    found = _result("code")["ns_a_step"].items()
    rows = [
        [
            f"`{name.replace(', ', '`, `')}`",
            *(f"{row[k]:.0f}" if k in row else "" for k in ("kernel", "gcc", "clang", "js", "lines")),
        ]
        for name, row in found
    ]
    return _table(["method, order", "kernel, ns", "gcc, ns", "clang, ns", "JavaScript, ns", "lines of C"], rows)


def pose() -> str:
    """Errors of the pose of bodies in a fluid."""
    figures = _result("pose")["figures"]
    rows = []
    for name, row in figures.items():
        *body, dt = name.replace("dt = ", "").split(", ")
        rows.append([f"`{'`, `'.join(body)}`", dt, *(f"{error:.1e}" for error in row.values())])
    return _table(["body", "dt", *next(iter(figures.values()))], rows)


def code_single() -> str:
    """Files in floats of 32 bits, after many frames."""
    found = _result("code-single")
    rows = [
        [name, f"{row[0]:.0e}", *(f"{v:.2g}" for v in row[1:])]
        for name, frames in found.items()
        if name not in ("flags", "columns")
        for row in (frames[0], frames[3], frames[-1])
    ]
    head = ["motion", "frames", "momentum, units", "energy, units", "attitude, rad", "momentum in space, rad"]
    return _table(head, rows)


TABLES = (
    speed_and_stillness,
    ensembles,
    saving_cost,
    dimensions,
    startup,
    gpu_code,
    gpu_calls,
    gpu_diffrax,
    calls,
    code,
    code_single,
    pose,
    satellite_day,
)

if __name__ == "__main__":
    for table in TABLES:
        print(table(), end="\n\n")
