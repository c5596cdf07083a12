"""Archives of every shape, small, with blocks and chunks of a few rows, and their compared parts."""

from __future__ import annotations

import datetime as clock
import json
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

CREATED = clock.datetime(2000, 1, 1, tzinfo=clock.UTC)
ROWS = 7  # in a block
OWN = """
import jax.numpy as jnp
from kreisel import reduction as red

def L(Omega, P, *, J=(1.0, 2.0, 3.0)):
    return -jnp.trace(Omega @ (jnp.array(J)[:, None] * Omega)) / 2 - P[2]

TOP = red.system("my-top", group=red.SO(3), lagrangian=L)
"""
OWN_TOML = """
[system]
file = "own.py"
name = "my-top"
[state]
M = [1.0, 0.0, 2.0]
P = [0.0, 0.6, 0.8]
[run]
dt = 0.05
steps = {steps}
every = 3
[output]
path = "run.zarr"
"""


class _Clock(clock.datetime):
    """The time of creation is part of an archive: it is fixed, so that all bytes can be compared."""

    @classmethod
    def now(cls, tz: Any = None) -> clock.datetime:
        return CREATED


def settle(rows: int = ROWS, sharded: bool = True) -> None:
    """Blocks of a few rows, a checkpoint whenever possible, and a stopped clock, in this process."""
    from kreisel.runs import integration
    from kreisel.storage import simulate as runs

    stand_still()
    runs.CHECKPOINT_SECONDS = 0.0
    if sharded:
        integration.SHARDED, integration.CHUNKS = rows, rows
    original = integration.block_rows

    def block_rows(plan: Any) -> int:
        return max(1, min(plan.rows, rows))

    for name, module in list(sys.modules.items()):
        if name.startswith("kreisel") and getattr(module, "block_rows", None) is original:
            module.block_rows = block_rows  # type: ignore[attr-defined]


def stand_still() -> None:
    """Archives that this process makes are created at one time."""
    import kreisel.sweeps.sweep  # noqa: F401

    for name, module in list(sys.modules.items()):
        if name.startswith("kreisel") and getattr(module, "datetime", None) is clock.datetime:
            module.datetime = _Clock  # type: ignore[attr-defined]


def model(name: str, n: int, lanes: int = 0, seed: int = 1) -> tuple[Any, Any]:
    """A system with parameters and a state, both at random inside their ranges."""
    from kreisel.lab import exact
    from kreisel.system import find

    draw = exact.float_random(np.random.default_rng(seed))
    system = exact.random_model(find(name), n, draw)
    parts = [system.system.space.point(n, draw) for _ in range(max(1, lanes))]
    letters = system.system.space.letters
    values = {k: np.stack([p[i] for p in parts]) if lanes else parts[0][i] for i, k in enumerate(letters)}
    return system, system.state(**values)


def run(path: Path | None, name: str, n: int = 3, lanes: int = 0, seed: int = 1, **options: Any) -> None:
    """A run on disk, or in memory."""
    import kreisel as kr

    system, state = model(name, n, lanes, seed)
    settings = {"dt": 0.05, "steps": 85, "every": 3, "progress": False, **options}
    if settings.get("orientation") == "some":
        identity = np.eye(n)
        settings["orientation"] = (1, 0, 0, 0) if n == 3 else identity
    kr.simulate(system, state, path=path, **settings)


def sweep(path: Path, n: int = 3, seed: int = 1, **options: Any) -> None:
    """A sweep of ten lanes over two quantities, two lanes in a block."""
    import kreisel as kr

    system, state = model("lagrange-top", n, 0, seed)
    random = {"state.a": {"sphere": 1.0}}
    design = kr.Design(grid={"system.alpha": [0.9, 1.3]}, random=random, draws=5, rng=seed)
    settings = {"dt": 0.05, "steps": 30, "every": 3, "block": 2, "workers": 0, "save": ["drift", "trajectories"]}
    kr.sweep(system, state, design, path=path, **{**settings, "progress": False, **options})


def contents(store: Path) -> dict[str, str]:
    """Every file below a folder, byte by byte as hexadecimal digits of a hash; folders by their names."""
    import hashlib

    out = {}
    for path in sorted(store.rglob("*")):
        name = path.relative_to(store).as_posix()
        if path.is_symlink() or not (path.is_dir() or path.is_file()):
            out[name] = "no file"
        elif path.is_file():
            out[name] = hashlib.sha256(path.read_bytes()).hexdigest()
    return out


def differences(one: dict[str, str], two: dict[str, str]) -> list[str]:
    """The names of what differs."""
    return sorted(name for name in {**one, **two} if one.get(name) != two.get(name))


def values(path: Path) -> dict[str, np.ndarray]:
    """All that an archive holds, as `kr.open_run(path).load()` gives it."""
    import kreisel as kr

    run = kr.open_run(path).load()
    return {str(name): np.asarray(variable.values) for name, variable in run.variables.items()}


def interrupted(path: Path, make: Callable[[Path], None], after: int) -> None:
    """The archive NAME.part of a run that is stopped after some calls of its engine."""
    from kreisel.runs import integration

    original, count = integration.Integration._advance, iter(range(10**9))

    class Enough(Exception):
        pass

    def advance(self: integration.Integration) -> None:
        if next(count) == after:
            keep = path.with_name(f"{path.name}.kept")
            shutil.copytree(path.with_name(f"{path.name}.part"), keep)
            raise Enough
        self._burst = 1
        original(self)

    integration.Integration._advance = advance  # type: ignore[method-assign]
    try:
        make(path)
    except Enough:
        pass
    finally:
        integration.Integration._advance = original  # type: ignore[method-assign]
    part = path.with_name(f"{path.name}.part")
    shutil.rmtree(part, ignore_errors=True)
    path.with_name(f"{path.name}.kept").rename(part)


def attributes(store: Path) -> dict[str, Any]:
    """The metadata of the root of a store."""
    return dict(json.loads((store / "zarr.json").read_text(encoding="utf-8")))
