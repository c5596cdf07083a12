"""What tests of several rooms need: where the repository is, configurations, and processes that are stopped."""

from __future__ import annotations

import importlib.util
import json
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from kreisel.graph.llvm import Function, Lanes, kind_of
from kreisel.graph.machine import kernel
from kreisel.kernels.cpu import CpuEngine

ROOT = Path(__file__).resolve().parent.parent
DOCS, EXAMPLES = ROOT / "docs", ROOT / "examples"
START = {  # name -> parameters, state
    "lagrange-top": ("p = [0.0, 0.0, 1.0]", "m = [0.1, 0.2, 1.5]\na = [0.6, 0.0, 0.8]"),
    "clebsch": ("b = [1.0, 2.0, 3.5]", "M = [0.1, 0.2, 0.3]\nP = [0.6, 0.0, 0.8]"),
    "neumann": ("b = [1.0, 2.0, 3.5]", "x = [1.0, 0.0, 0.0]\nq = [0.0, 0.3, 0.1]"),
}


def docs_tool(name: str) -> Any:
    """A module of docs/tools."""
    spec = importlib.util.spec_from_file_location(name, ROOT / "docs" / "tools" / f"{name}.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def configuration(run: str, output: str, name: str = "lagrange-top", more: str = "") -> str:
    """The TOML file of a run, by the text of its sections [run] and [output]; `more` sections stand between them."""
    parameters, state = START[name]
    system = f'name = "{name}"\n{parameters}'
    return f"\n[system]\n{system}\n[state]\n{state}\n[run]\n{run}\n{more}[output]\n{output}\n"


def started(folder: Path, code: str, seconds: float) -> subprocess.Popen[str]:
    """A process that is at work since so many seconds."""
    child = subprocess.Popen(
        [sys.executable, "-c", code], cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert child.stdout is not None
    child.stdout.readline()
    time.sleep(seconds)
    return child


def ended(child: subprocess.Popen[str], number: int) -> tuple[int, str, float]:
    """Its exit status, its messages and the seconds that it took to obey."""
    begun = time.monotonic()
    child.send_signal(number)
    try:
        _, message = child.communicate(timeout=60)
    finally:
        child.kill()
    return child.returncode, message, time.monotonic() - begun


def contents(store: Path) -> dict[str, object]:
    """Every file of an archive, byte by byte, without the time of its creation and the checksum of that."""
    out: dict[str, object] = {}
    for path in sorted(p for p in store.rglob("*") if p.is_file()):
        name = path.relative_to(store).as_posix()
        out[name] = path.read_bytes()
        if name == "zarr.json":
            metadata = json.loads(path.read_text())
            metadata["attributes"].pop("created")
            out[name] = metadata
        elif name == "engine/checksums.sha256":
            out[name] = [line for line in path.read_text().splitlines() if not line.endswith("  zarr.json")]
    return out


def compiled_outputs(graph: Any, outputs: list[Any], values: np.ndarray, width: int = 1) -> np.ndarray:
    """The outputs (lanes, count) for inputs x0, x1, ... (lanes, count), by machine code for so many lanes at once."""
    lanes, count = values.shape

    def write(f: Function) -> None:
        source, target, end = f.arguments
        f.vectors(width)
        with f.loop(0, end, width) as lane:
            at = f.lanes(lane, width, end)
            row = Lanes(f.doubles(source), at, count)
            target_rows = Lanes(f.doubles(target), at, len(outputs))
            target_rows.put(f.outputs(graph, outputs, lambda _, i: row[i], kind_of(width)))

    rows, out = np.concatenate([values, values[-1:]]), np.full((lanes + 1, len(outputs)), np.nan)
    code = kernel(("test", graph.digest(outputs), count, width), 3, write)
    code(rows.ctypes.data, out.ctypes.data, lanes)
    assert np.isnan(out[-1]).all()  # nothing is written beyond the last lane
    return out[:-1]


def cross(a: Any, b: Any) -> np.ndarray:
    """a x b of two vectors of R^3: `np.cross` takes ten times as long, most of the right-hand sides of a solver."""
    (x, y, z), (u, v, w) = np.asarray(a).tolist(), np.asarray(b).tolist()
    return np.array((y * w - z * v, z * u - x * w, x * v - y * u))


def rotation_matrix(q: Any) -> np.ndarray:
    """The matrix of a quaternion (w, x, y, z) of any length: SciPy's takes ten times as long."""
    w, x, y, z = (np.asarray(q) / np.linalg.norm(q)).tolist()
    return np.array(
        (
            (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
            (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
            (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
        )
    )


def cpu_engine(*arguments: Any, **options: Any) -> Any:
    """The compiled kernel of a scheme for the CPU and the rows z (lanes, d) that it steps."""
    return CpuEngine(*arguments, **options)
