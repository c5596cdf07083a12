"""The bits of runs, before and after a change that may not change them.

    python tests/golden.py make FILE            on the code before
    python tests/golden.py compare FILE         on the code after
    python tests/golden.py make tests/golden.json --few

Every method, some orders, n = 3, 4 and 10, single runs and ensembles with and without orientation, an archive that is
interrupted and resumed, a sweep.  Digests hold for one processor and one set of libraries, which stand in the table as
`machine`.  `tests/golden.json` has `few` of the runs, which `tests/runs/test_golden.py` compares on that machine: a
change that is meant to change bits makes it anew by the last line, and says why in its message.
"""

from __future__ import annotations

import hashlib
import json
import platform
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterator
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

import kreisel as kr
from kreisel.graph.machine import processor
from kreisel.lab import exact
from kreisel.method import METHODS
from kreisel.system import REGISTRY

LARGE = ("lagrange-top", "clebsch", "neumann", "euler-top")
ORDERS = (None, 2, 4)
THOROUGH = ("lagrange-top", "clebsch", "euler-top", "heisenberg-chain", "kirchhoff")  # with all runs among the few
BRIEF = ("dop853", "exact", "midpoint")  # methods whose ensembles are quickly compiled
PRIVILEGED = ("pku", "wbnoinvd")  # keys of memory pages, caches: hypervisors hide these; no kernel has them


def machine() -> str:
    """All that bits depend on beside the code of Kreisel: processor and versions."""
    triple, name, features = processor()
    features = ",".join(flag for flag in features.split(",") if flag[1:] not in PRIVILEGED)
    versions = [f"{package} {metadata.version(package)}" for package in ("numpy", "scipy", "llvmlite")]
    return " ".join([triple, name, features, *versions, *platform.libc_ver()])


def few(name: str) -> bool:
    """Whether a run is in the small table: n = 3, all of some systems, of others what is compiled quickly."""
    system, n, method, option = name.split() if " " in name else (name, "3", "", "")
    if n != "3" or method == "brickwork":
        return False
    quick = (option == "None" and method != "variational") or (option == "lanes" and method in BRIEF)
    return quick or system in (*THOROUGH, "archive", "sweep")


def digest(run: xr.Dataset) -> str:
    """Of all numbers."""
    found = hashlib.sha256()
    for name in sorted(map(str, run.variables)):
        found.update(name.encode())
        found.update(np.ascontiguousarray(run[name].values).tobytes())
    return found.hexdigest()[:16]


def starts(name: str, n: int) -> tuple[Any, dict[str, np.ndarray]]:
    system, draw = REGISTRY[name], exact.float_random(np.random.default_rng([1, n]))
    model = exact.random_model(system, n, draw)
    return model, dict(zip(system.space.letters, system.space.point(n, draw), strict=True))


def cases() -> Iterator[tuple[str, Any]]:
    """Names, and what makes the run."""
    for name, system in REGISTRY.items():
        for n in (3, 4, 10):
            if system.n not in (None, n) or (n == 10 and name not in LARGE):
                continue
            model, state = starts(name, n)
            options: dict[str, Any] = {"dt": 0.02, "steps": 300, "every": 100, "progress": False}
            for method in METHODS:
                for order in ORDERS:
                    settings = options | {"method": method, "order": order}
                    if n == 10 and order == 4:
                        continue
                    yield f"{name} {n} {method} {order}", lambda m=model, s=state, t=settings: kr.simulate(m, s, **t)
                settings = options | {"method": method}
                many = {k: np.stack([v, v * (1 + 1e-3)]) for k, v in state.items()}
                yield f"{name} {n} {method} lanes", lambda m=model, s=many, t=settings: kr.simulate(m, s, **t)
                oriented = settings | {"orientation": (1, 0, 0, 0) if n == 3 else np.eye(n)}
                yield f"{name} {n} {method} oriented", lambda m=model, s=state, t=oriented: kr.simulate(m, s, **t)


def stored(folder: Path) -> Iterator[tuple[str, Any]]:
    """An archive, extended; a sweep."""
    model, state = starts("lagrange-top", 3)
    options: dict[str, Any] = {"dt": 0.02, "every": 10, "progress": False}

    def extended() -> xr.Dataset:
        kr.simulate(model, state, steps=500, path=folder / "run.zarr", **options)
        return kr.resume(folder / "run.zarr", extend=900)

    def swept() -> xr.Dataset:
        values = {"state.m": [(0.1, 0.2, 1.5), (0.3, 0.2, 1.1), (0.0, 0.2, 0.5)]}
        settings: dict[str, Any] = {"dt": 0.02, "steps": 500, "every": 100, "workers": 0}
        return kr.sweep(model, model.state(**state), kr.Design(together=values), path=folder / "sweep.zarr", **settings)

    yield "archive", extended
    yield "sweep", swept


def digests(wanted: Callable[[str], bool]) -> dict[str, str]:
    """By name those of the runs that are wanted, and the machine."""
    found = {"machine": machine()}
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings(action="ignore"):
        for name, make in [*cases(), *stored(Path(folder))]:
            if wanted(name):
                try:
                    found[name] = digest(make())
                except kr.InputError:
                    found[name] = "InputError"
                except kr.RunError:
                    found[name] = "RunError"
    return found


def main(what: str, file: str, *options: str) -> int:
    if what == "make":
        found = digests(few if "--few" in options else bool)
        if "--few" in options:
            found = {name: value for name, value in found.items() if value != "InputError"}
        Path(file).write_text(json.dumps(found, indent=0) + "\n")
        print(f"{len(found) - 1} runs, {sum(len(v) == 16 for v in found.values())} with numbers")
        return 0
    before = json.loads(Path(file).read_text())
    found = digests(before.__contains__)
    bad = sorted(name for name in before if before[name] != found.get(name))
    print(*(f"{name}: {before[name]} {found.get(name)}" for name in bad), f"{len(bad)} of {len(before)}", sep="\n")
    return int(bool(bad))


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
