"""The bits of runs, before and after a change that may not change them.

    python tests/golden.py make FILE        on the code before
    python tests/golden.py compare FILE     on the code after

Every method, some orders, n = 3, 4 and 10, single runs and ensembles with and without orientation, an archive that is
interrupted and resumed, a sweep.  Digests hold for one processor and one set of libraries, so none are committed.
"""

from __future__ import annotations

import hashlib
import json
import sys
import tempfile
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

import kreisel as kr
from kreisel.lab import exact
from kreisel.method import METHODS
from kreisel.system import REGISTRY

LARGE = ("lagrange-top", "clebsch", "neumann", "euler-top")
ORDERS = (None, 2, 4)


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
                oriented = settings | {"orientation": "identity"}
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


def main(what: str, file: str) -> int:
    found: dict[str, str] = {}
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings(action="ignore"):
        for name, make in [*cases(), *stored(Path(folder))]:
            try:
                found[name] = digest(make())
            except kr.InputError:
                found[name] = "InputError"
            except kr.RunError:
                found[name] = "RunError"
    if what == "make":
        Path(file).write_text(json.dumps(found, indent=0))
        print(f"{len(found)} runs, {sum(len(v) == 16 for v in found.values())} with numbers")
        return 0
    before = json.loads(Path(file).read_text())
    bad = sorted(name for name in before.keys() | found.keys() if before.get(name) != found.get(name))
    print(*(f"{name}: {before.get(name)} {found.get(name)}" for name in bad), f"{len(bad)} of {len(before)}", sep="\n")
    return int(bool(bad))


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
