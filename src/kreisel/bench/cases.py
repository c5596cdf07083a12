"""What is measured: the five maps, their starts, and the machine it is measured on."""

from __future__ import annotations

import os
import platform
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

import kreisel as kr
from kreisel.algebra import Array

SEEDS = (1, 2, 3)


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

    `generic` turns the constant vector away from the axes, so that no parameter is 0 or 1 and a kernel
    has nothing to fold; otherwise the standard top is among the states.
    """
    axis = unit([0.3, -0.2, 0.9]) if generic else np.eye(n)[-1]
    b = np.array([0.3, 0.7, 1.9, 1.1])[:n]
    tops = [BenchCase("lagrange-top", kr.LagrangeTop(p=axis), _start_states("m", "a", n))]
    if n == 3:
        tops += [
            BenchCase("lagrange-top-moving", kr.LagrangeTopMoving(A=axis, alpha=0.7), _start_states("M", "P", n)),
            BenchCase("symmetric-top", kr.SymmetricTop(A=axis), _start_states("M", "P", n)),
        ]
    tops += [BenchCase("clebsch", kr.Clebsch(b=b), _start_states("M", "P", n))]
    if n == 3:
        tops += [BenchCase("neumann", kr.Neumann(b=b), _sphere_states(n))]
    return tops


def _start_states(skew: str, vector: str, n: int) -> dict[str, dict[str, Any]]:
    out: dict[str, dict[str, Any]] = {"standard": {skew: (0.1, 0.2, 1.5), vector: (0.6, 0.0, 0.8)}} if n == 3 else {}
    for seed in SEEDS:
        rng = np.random.default_rng(seed)
        X = rng.standard_normal((n, n))
        out[f"seed {seed}"] = {skew: X - X.T, vector: unit(rng.standard_normal(n))}
    return out


def _sphere_states(n: int) -> dict[str, dict[str, Any]]:
    out: dict[str, dict[str, Any]] = {"standard": {"x": (0.6, 0.0, 0.8), "q": (0.8, 0.5, -0.6)}}
    for seed in SEEDS:
        rng = np.random.default_rng(seed)
        x, q = unit(rng.standard_normal(n)), rng.standard_normal(n)
        out[f"seed {seed}"] = {"x": x, "q": q - x * (x @ q)}
    return out


def machine() -> dict[str, Any]:
    """Processor, system and versions."""
    return {
        "cpu": _cpu(),
        "cores": os.cpu_count(),
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        **{package: version(package) for package in ("numpy", "numba", "llvmlite", "scipy", "xarray")},
        "kreisel": kr.__version__,
    }


def _cpu() -> str:
    try:
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    except OSError:
        pass
    return platform.processor()
