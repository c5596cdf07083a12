"""Scenarios for kills: runs by every engine and of every shape, resumed, lengthened, replacing others, and sweeps."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import stores
from speaking import said

NAME, PART = "run.zarr", "run.zarr.part"


@dataclass(frozen=True)
class Scenario:
    """A scenario: a folder is prepared, then `act` is called in it; `again` resumes until it is complete."""

    prepare: Callable[[Path], None]
    act: Callable[[Path], None]
    again: Callable[[Path], None]
    sharded: bool = True
    weight: int = 4
    memory: Callable[[], None] = lambda: None  # the same without a disk: its kernels are then at hand


def _nothing(folder: Path) -> None:
    pass


def go_on(act: Callable[[Path], None]) -> Callable[[Path], None]:
    """Resume what can be resumed; what never began is begun."""

    def again(folder: Path) -> None:
        import kreisel as kr

        part = folder / PART
        if (
            not part.exists()
            and (folder / NAME).exists()
            and stores.attributes(folder / NAME)["attributes"]["complete"]
        ):
            return
        try:
            kr.resume(folder / NAME, progress=False)
        except kr.InputError:
            if (part / "engine" / "checkpoint.npz").exists():
                raise
            act(folder)

    return again


def single(name: str, sharded: bool = True, weight: int = 4, **options: Any) -> Scenario:
    """A run that begins with an empty folder."""

    def act(folder: Path) -> None:
        stores.run(folder / NAME, name, **options)

    return Scenario(_nothing, act, go_on(act), sharded, weight, lambda: stores.run(None, name, **options))


def overwriting() -> Scenario:
    """A run in the place of another one."""

    def prepare(folder: Path) -> None:
        stores.run(folder / NAME, "lagrange-top", seed=2)

    def act(folder: Path) -> None:
        stores.run(folder / NAME, "lagrange-top", overwrite=True)

    def again(folder: Path) -> None:
        import kreisel as kr

        if (folder / PART / "engine" / "checkpoint.npz").exists() and os.getpid() % 2:
            kr.resume(folder / NAME, progress=False)
        else:
            act(folder)

    return Scenario(prepare, act, again, weight=10)


def resuming(**options: Any) -> Scenario:
    """A run that was interrupted is resumed."""

    def whole(path: Path) -> None:
        stores.run(path, "lagrange-top", **options)

    def prepare(folder: Path) -> None:
        stores.interrupted(folder / NAME, whole, 9)

    def act(folder: Path) -> None:
        import kreisel as kr

        kr.resume(folder / NAME, progress=False)

    return Scenario(prepare, act, go_on(act), weight=6)


def extending() -> Scenario:
    """A finished run is lengthened."""

    def prepare(folder: Path) -> None:
        stores.run(folder / NAME, "lagrange-top", orientation="some", steps=43)

    def act(folder: Path) -> None:
        import kreisel as kr

        kr.resume(folder / NAME, extend=85, progress=False)

    def again(folder: Path) -> None:
        if (folder / PART).exists():
            go_on(act)(folder)
        if stores.attributes(folder / NAME)["attributes"]["steps"] != 85:  # killed before the new length was written
            act(folder)

    return Scenario(prepare, act, again, weight=8)


def swept(over: bool = False, weight: int = 6, **options: Any) -> Scenario:
    """A sweep; an equal call resumes it."""

    def prepare(folder: Path) -> None:
        if over:
            stores.sweep(folder / NAME, seed=2)

    def act(folder: Path) -> None:
        stores.sweep(folder / NAME, **options, overwrite=over)

    return Scenario(prepare, act, act, weight=weight)


def own() -> Scenario:
    """A user-defined Lagrangian: it cannot be resumed, as the archive holds no code; it is run again."""

    def prepare(folder: Path) -> None:
        (folder / "own.py").write_text(stores.OWN, encoding="utf-8")
        (folder / "run.toml").write_text(stores.OWN_TOML.format(steps=85), encoding="utf-8")

    def act(folder: Path) -> None:
        code, out, err = said(["run", "run.toml", "--overwrite", "--no-figure"])
        if code:
            raise RuntimeError(out + err)

    return Scenario(prepare, act, act, weight=2)


SCENARIOS = {
    "single": single("lagrange-top", orientation="some"),
    "chunks that are blocks": single("lagrange-top", sharded=False),
    "ensemble": single("lagrange-top", lanes=3),
    "64 lanes": single("lagrange-top", lanes=64),
    "ensemble with orientations": single("lagrange-top", lanes=2, orientation="some"),
    "n = 4": single("lagrange-top", n=4, orientation="some"),
    "order 4": single("clebsch", order=4),
    "suris": single("lagrange-top", method="suris", order=1),
    "veselov": single("euler-top", method="veselov"),
    "variational": single("heavy-top", lanes=2),
    "exact": single("lagrange-top", method="exact"),
    "exact, Euler": single("euler-top", method="exact"),
    "dop853": single("heavy-top", method="dop853", lanes=2),
    "large": single("lagrange-top", n=9, engine="large", weight=2),
    "large ensemble": single("neumann", n=9, lanes=3, engine="large", weight=2),
    "own Lagrangian": own(),
    "overwrite": overwriting(),
    "resume": resuming(),
    "resume an ensemble": resuming(lanes=3, orientation="some"),
    "extend": extending(),
    "sweep": swept(),
    "sweep, n = 4": swept(n=4, save=["drift", "extremes"], weight=3),
    "sweep that overwrites": swept(over=True),
}


def complete(path: Path) -> bool:
    """Whether an archive is complete by its attributes and by its manifest."""
    try:
        return bool(stores.attributes(path)["attributes"]["complete"]) and (path / "engine/checksums.sha256").exists()
    except (OSError, ValueError, KeyError):
        return False
