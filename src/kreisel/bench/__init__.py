"""`kreisel bench`: the speed of each map on this machine, against C++ of the same formula where g++ is installed.

The scripts of benchmarks/ measure more with the same contests.  A map is timed as a user calls it, projections and the
call included; parameters are known to neither side before the run.
"""

from __future__ import annotations

import ctypes
import os
import platform
import re
import shutil
import subprocess
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

import kreisel as kr
from kreisel import algebra
from kreisel.algebra import Array

SEEDS = (1, 2, 3)
DT, TURNS = 0.05, 5
SINGLE_STEPS, ENSEMBLE_STEPS = 300_000, 5_000
WHOLE = 96  # lanes that are complete blocks of 8 for every number of chains
LANES, CHAINS = 64 * WHOLE, (1, 2, 3, 4)
LONGER = 8  # times as many steps where the clock counts, against the start of the threads
BY_THE_CLOCK = " by the clock"
SAVED = {1: 500_000, 10: 3_000_000, 100: 10_000_000, 1000: 10_000_000}  # steps between two rows -> steps of a run
EVERY, SHARE = 100, 10  # of `SAVED`: a row every so many steps, and one step in ten
FLAGS = ["-O3", "-march=native", "-std=c++17", "-shared", "-fPIC"]
MISSING = "g++ is not on the PATH, or does not work: no comparison with C++ (install it, as the package g++ of Debian)"
SOURCES = Path(__file__).parent  # of the C++


@dataclass(frozen=True)
class BenchCase:
    """A system with parameters, and named initial states."""

    name: str
    model: Any
    states: dict[str, dict[str, Any]]

    @property
    def n(self) -> int:
        """The dimension of space."""
        return int(self.model.n)


def unit(v: Any) -> Array:
    """v / |v|."""
    v = np.asarray(v, dtype=float)
    return v / np.sqrt(v @ v)


def cases(n: int = 3, generic: bool = False) -> list[BenchCase]:
    """The five maps for n = 3, two of them beyond.

    `generic` rotates the constant vector away from the axes, so that no parameter is 0 or 1 and a kernel
    has nothing to fold; otherwise the standard top is among the states.
    """
    axis = unit([0.3, -0.2, 0.9]) if generic else np.eye(n)[-1]
    b = np.array([0.3, 0.7, 1.9, 1.1])[:n]
    models = [kr.LagrangeTop(p=axis), kr.Clebsch(b=b)]
    if n == 3:
        models[1:1] = kr.LagrangeTopMoving(A=axis, alpha=0.7), kr.SymmetricTop(A=axis)
        models.append(kr.Neumann(b=b))
    out = []
    for model in models:
        (first, kind), (second, _) = model.system.space.components
        on_sphere = kind == "vector"  # x, q of T*S^(n-1)
        pair = ((0.6, 0.0, 0.8), (0.8, 0.5, -0.6)) if on_sphere else ((0.1, 0.2, 1.5), (0.6, 0.0, 0.8))
        states: dict[str, dict[str, Any]] = {"standard": {first: pair[0], second: pair[1]}} if n == 3 else {}
        for seed in SEEDS:
            rng = np.random.default_rng(seed)
            if on_sphere:
                x, q = unit(rng.standard_normal(n)), rng.standard_normal(n)
                states[f"seed {seed}"] = {first: x, second: q - x * (x @ q)}
            else:
                X = rng.standard_normal((n, n))
                states[f"seed {seed}"] = {first: X - X.T, second: unit(rng.standard_normal(n))}
        out.append(BenchCase(model.system.name, model, states))
    return out


def machine() -> dict[str, Any]:
    """Processor, system and versions."""
    info = Path("/proc/cpuinfo")
    cpu = re.search(r"model name\s*: (.*)", info.read_text() if info.is_file() else "")
    return {
        "cpu": cpu[1] if cpu else platform.processor(),
        "cores": os.cpu_count(),
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        **{package: version(package) for package in ("numpy", "llvmlite", "scipy", "xarray")},
        "kreisel": kr.__version__,
    }


# -- C++ by hand, compiled on the spot ------------------------------------------------------------------


def compiler() -> str | None:
    """The path of g++, None if there is none that compiles a library with these flags that can be loaded."""
    path = shutil.which("g++")
    return _working(path) if path else None


@cache
def _working(path: str) -> str | None:
    with tempfile.TemporaryDirectory() as folder:
        source, target = Path(folder) / "one.cpp", Path(folder) / "one.so"
        source.write_text('extern "C" double one() { return 1; }')
        try:
            subprocess.run([path, *FLAGS, str(source), "-o", str(target)], check=True, capture_output=True, timeout=60)
            ctypes.CDLL(str(target))
        except (OSError, subprocess.SubprocessError):
            return None
    return path


def build(source: str | Path, folder: Path) -> ctypes.CDLL:
    """The library of a C++ file, "single", "ensemble" or a path, made in `folder`.

    Raises `FileNotFoundError` without g++.
    """
    path = compiler()
    if path is None:
        raise FileNotFoundError(MISSING)
    source = Path(source) if Path(source).suffix else SOURCES / f"{source}.cpp"
    target = folder / f"{source.stem}.so"
    subprocess.run([path, *FLAGS, f"-I{SOURCES}", str(source), "-o", str(target)], check=True)
    return ctypes.CDLL(str(target))


# -- contests -------------------------------------------------------------------------------------------


class Contest:
    """The contenders for one map from the same start: `steppers` make a number of steps and return the states.

    One trajectory, or with `lanes` an ensemble: C++ with one to four chains of vectors ("cpp 1", ...), and all cores.
    """

    def __init__(self, case: BenchCase, library: ctypes.CDLL | None, lanes: int | None = None):
        if lanes is not None and lanes % WHOLE:  # C++ would write beyond its arrays
            raise ValueError(f"expected a multiple of {WHOLE} lanes, got {lanes}")
        self.lanes, self._propagator = lanes, kr.propagator(case.model, method="suris", order=1, dt=DT)
        shape = () if lanes is None else (lanes, 1)
        state = case.model.state(**case.states["standard"]).axial
        row = np.concatenate([state[letter] for letter in case.model.system.space.letters])
        self.start, self._entries = np.tile(row, shape), _entries(case)
        constants = np.concatenate([np.ravel(v) for v in (*case.model.params.values(), DT)])
        self.constants = np.tile(constants, shape)
        self.steppers: dict[str, Callable[[int], Array]] = {"kernel": self._on_one_core}
        symbol = case.name.replace("-", "_")
        names = {"cpp": symbol} if lanes is None else {f"cpp {k}": f"{symbol}_{k}" for k in CHAINS}
        if lanes is not None:
            self.steppers["all cores"] = self._on_all_cores
        if library is not None:
            self.steppers |= {name: self._by_hand(library[function]) for name, function in names.items()}

    def _on_one_core(self, steps: int) -> Array:
        before = dict(os.environ)
        os.environ["KREISEL_NUM_THREADS"] = "1"
        try:
            return self._on_all_cores(steps)
        finally:
            del os.environ["KREISEL_NUM_THREADS"]
            os.environ.update(before)

    def _on_all_cores(self, steps: int) -> Array:
        return np.asarray(self._propagator.steps(self.start, steps))

    def rows(self) -> Array:
        """The start as C++ has it, with the entries of skew matrices above the diagonal."""
        return self.start @ self._entries

    def states(self, rows: Array) -> Array:
        """The states of the propagator of rows of C++."""
        return np.asarray(rows @ self._entries.T)

    def _by_hand(self, function: Any) -> Callable[[int], Array]:
        function.restype = None
        pointers, count = [ctypes.c_void_p] * 2, () if self.lanes is None else (self.lanes,)
        function.argtypes = pointers + [ctypes.c_long] * (1 + len(count))

        def advance(steps: int) -> Array:
            rows = self.rows()
            function(rows.ctypes.data, self.constants.ctypes.data, *count, steps)
            return self.states(rows)

        return advance

    def agreement(self, steps: int, tolerance: float = 1e-12) -> float:
        """Largest difference of any contender from the kernel after some steps; raises if they are different maps."""
        end = self.steppers["kernel"](steps)
        apart = {name: float(abs(advance(steps) - end).max()) for name, advance in self.steppers.items()}
        if apart.get("all cores", 0) != 0 or not max(apart.values()) < tolerance:
            raise AssertionError(f"after {steps} steps the contenders are {apart} apart from the kernel")
        return max(apart.values())

    def timed(self, turns: int, steps: int) -> dict[str, Array]:
        """Nanoseconds a step and lane, one for each rotation: of the thread's time, of all cores by the clock."""
        twice = [name for name in ("kernel", "cpp 2") if self.lanes is not None and name in self.steppers]
        names = {name: name for name in self.steppers} | {name + BY_THE_CLOCK: name for name in twice}
        ns: dict[str, list[float]] = {name: [] for name in names}
        for stepper in self.steppers.values():
            stepper(max(steps // 10, 1))
        for turn in range(turns):
            for name in [*names][turn % 3 :] + [*names][: turn % 3]:
                clock = time.perf_counter if name.endswith(BY_THE_CLOCK) or "all cores" in name else time.thread_time
                count = steps * (LONGER if clock is time.perf_counter else 1)
                begun = clock()
                self.steppers[names[name]](count)
                ns[name].append((clock() - begun) / count / (self.lanes or 1) * 1e9)
        return {name: np.array(values) for name, values in ns.items()}


def _entries(case: BenchCase) -> Array:
    """The matrix Q with row Q the row in entries (0, 1), (0, 2), (1, 2) of skew matrices, n = 3."""
    kinds = case.model.system.space.kinds
    vectors = [algebra.KINDS[kind].shown(3).name for kind in kinds]
    rows = algebra.restore(np.eye(algebra.coordinate_count(vectors, 3)), vectors, 3)
    components = [algebra.KINDS[kind].from_user(v, 3) for kind, v in zip(kinds, rows, strict=True)]
    return np.asarray(algebra.flatten(components, kinds))


def summary(ns: dict[str, Array]) -> dict[str, Any]:
    """Medians, quartiles and ratios; of C++ the number of chains that is fastest."""
    by_hand = [name for name in ns if name.startswith("cpp") and not name.endswith(BY_THE_CLOCK)]
    best = min(by_hand, key=lambda name: np.median(ns[name]), default="")
    row: dict[str, Any] = {}
    for label, name in {"kernel": "kernel", "cpp": best, "all_cores": "all cores"}.items():
        if name in ns:
            low, middle, high = (round(q, 2) for q in np.percentile(ns[name], [25, 50, 75]))
            row[label] = {"ns": middle, "quartiles": [low, high], "least": round(min(ns[name]), 2)}
    if best and best != "cpp":
        row["chains"] = int(best[-1])
    for label, over, under in (
        ("kernel/cpp", "kernel", best),
        ("one/all_cores", "kernel" + BY_THE_CLOCK, "all cores"),
        ("one/all_cores, cpp", "cpp 2" + BY_THE_CLOCK, "all cores, cpp"),
    ):
        if over in ns and under in ns:
            low, middle, high = (round(float(q), 3) for q in np.percentile(ns[over] / ns[under], [25, 50, 75]))
            row |= {label: middle, f"{label} quartiles": [low, high]}
    return row


# -- saving ---------------------------------------------------------------------------------------------


def saving_ratios(
    case: BenchCase, method: str, turns: int, share: int, everies: Sequence[int] = tuple(SAVED)
) -> dict[str, Any]:
    """Time of a step with saving over the time without, for each `every`; one in `share` of the steps of `SAVED`."""
    ratios: dict[int, list[float]] = {every: [] for every in everies}
    base, start = [], case.states["standard"]
    p = kr.propagator(case.model, method=method, order=2, dt=DT)

    def seconds(move: Callable[[int], Any], steps: int) -> float:  # a step
        move(10)  # compiled and loaded
        begun = time.thread_time()
        move(steps)
        return (time.thread_time() - begun) / steps

    def saved(steps: int, every: int) -> Any:  # in memory, rows and integrals with them
        asked: dict[str, Any] = {"dt": DT, "method": method, "order": 2, "progress": False}
        return kr.simulate(case.model, start, steps=steps, every=min(every, steps), **asked)

    for _ in range(turns):
        for every in everies:
            base.append(seconds(lambda steps: p.steps(start, steps), SAVED[100] // share))
            ratios[every].append(seconds(partial(saved, every=every), SAVED[every] // share) / base[-1])
    row: dict[str, Any] = {"ns a step without saving": round(float(np.median(base)) * 1e9, 2)}
    for every, values in ratios.items():
        low, middle, high = np.percentile(values, [25, 50, 75])
        row[f"every {every}"] = {"ratio": round(middle, 3), "quartiles": [round(low, 3), round(high, 3)]}
    return row


def bench(tell: Callable[[str], None] = lambda name: None) -> dict[str, Any]:
    """The five maps for n = 3, each timed in revolutions with C++ of the same formula where g++ is installed.

    ns a step of one trajectory, and of a lane of an ensemble, on one core; their ratios to C++; one core over all
    cores; time with a row saved every 100 steps over time without.  `tell` is called with the name of each map.
    """
    maps: dict[str, dict[str, float]] = {}
    with tempfile.TemporaryDirectory() as folder:
        single, ensemble = (build(name, Path(folder)) if compiler() else None for name in ("single", "ensemble"))
        for case in cases(generic=True):
            tell(case.name)
            step = summary(Contest(case, single).timed(TURNS, SINGLE_STEPS))
            lanes = summary(Contest(case, ensemble, LANES).timed(TURNS, ENSEMBLE_STEPS))
            saved = saving_ratios(case, "suris", 3, SHARE, (EVERY,))
            row = {"ns_a_step": step["kernel"]["ns"], "ns_a_lane_step": lanes["kernel"]["ns"]}
            if single is not None:
                row |= {"step_to_cpp": step["kernel/cpp"], "lane_step_to_cpp": lanes["kernel/cpp"]}
            row |= {"one_core_to_all": lanes["one/all_cores"], "saving": saved[f"every {EVERY}"]["ratio"]}
            maps[case.name] = row
    note = {} if compiler() else {"note": MISSING}
    return {"machine": machine(), "load_average": round(os.getloadavg()[0], 1), **note, "maps": maps}
