"""Corruptions of every kind: none may pass `kreisel check`, and an opened archive has the true values or is refused.

The interrupted archive is always reported by `kreisel check`; there a corruption has to be named in addition to the
interruption, or not to matter: the values are the true ones, and so are the bytes after `kreisel resume`.
"""

from __future__ import annotations

import random
import re
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import stores
from damages import DAMAGES
from forks import apart
from pool import note
from speaking import said


def make(base: Path) -> None:
    """The archives that are damaged, each with another one of the same shapes, and their values."""
    place = base / "stores"
    if not place.exists():
        place.mkdir()
        apart(_made, str(place))


def _made(place: str) -> None:
    stores.settle()
    for seed, folder in ((1, Path(place) / "true"), (2, Path(place) / "other")):
        folder.mkdir()
        makers: dict[str, Callable[[Path], None]] = {
            "single": lambda path, seed=seed: stores.run(path, "lagrange-top", seed=seed),
            "ensemble": lambda path, seed=seed: stores.run(path, "lagrange-top", lanes=3, seed=seed),
            "orientation": lambda path, seed=seed: stores.run(path, "lagrange-top", seed=seed, orientation="some"),
            "four": lambda path, seed=seed: stores.run(path, "clebsch", n=4, seed=seed),
            "sweep": lambda path, seed=seed: stores.sweep(path, seed=seed),
        }
        for name, maker in makers.items():
            maker(folder / f"{name}.zarr")
        begun = lambda path, seed=seed: stores.run(path, "lagrange-top", lanes=2, seed=seed, orientation="some")  # noqa: E731
        stores.interrupted(folder / "begun.zarr", begun, 20)
        if folder.name == "true":
            begun(Path(place) / "whole.zarr")
            for path in folder.iterdir():
                np.savez(Path(place) / f"{path.name}.npz", **stores.values(path))


def case(rng: random.Random, folder: Path) -> str:
    """One archive, damaged once, checked, opened and read; the interrupted one resumed."""
    place = folder.parent.parent / "stores"
    path = rng.choice(sorted((place / "true").iterdir()))
    store = folder / path.name
    shutil.copytree(path, store, symlinks=True)
    before = stores.contents(store)
    for _ in range(100):
        name, damage = rng.choice(list(DAMAGES.items()))
        done = damage(store, place / "other" / path.name, rng)
        if done and stores.contents(store) != before:
            break
        shutil.rmtree(store)
        shutil.copytree(path, store, symlinks=True)
    note(f"{path.name}: {name} {done}")
    truth = place / f"{path.name}.npz"
    wrong = _judged(str(store), str(truth), str(place / "whole.zarr"))
    if wrong:
        raise AssertionError("; ".join(wrong))
    return name


def _judged(store: str, truth: str, whole: str) -> list[str]:
    """Promises that a damaged archive breaks."""
    stores.settle()
    import kreisel as kr

    wrong, path = [], Path(store)
    code, out, err = said(["check", path.name])
    if "Traceback" in out + err:
        wrong.append(f"check ends in a traceback: {(out + err)[-300:]}")
    faults = re.findall(r"^FAULT: (.*)$", out, re.MULTILINE)
    begun = path.suffix == ".part"
    accepted = code == 0 or (begun and code == 1 and all("interrupted" in fault for fault in faults))
    if accepted and not begun:
        wrong.append("check accepts it")
    if code not in (0, 1, 2):
        wrong.append(f"check ends with {code}")
    try:
        found = stores.values(path)
    except kr.InputError as error:
        if len(str(error)) > 2000:
            wrong.append(f"a message of {len(str(error))} characters")
    except Exception as error:
        wrong.append(f"open_run(...).load() raises {type(error).__name__}: {str(error)[:200]}")
    else:
        with np.load(truth) as known:
            wrong += compared(found, dict(known))
    if begun and not wrong and accepted:
        wrong += _resumed(path, whole)
    return wrong


def _resumed(path: Path, whole: str) -> list[str]:
    """A damaged archive that was interrupted: after `resume` the right bytes, or a message."""
    import kreisel as kr

    try:
        kr.resume(path, progress=False)
    except (kr.InputError, kr.RunError):
        return []
    except Exception as error:
        return [f"resume raises {type(error).__name__}: {str(error)[:200]}"]
    wrong = stores.differences(stores.contents(path.with_suffix("")), stores.contents(Path(whole)))
    return [f"resumed, it differs in {', '.join(wrong[:5])}"] if wrong else []


def compared(found: dict[str, np.ndarray], known: dict[str, np.ndarray]) -> list[str]:
    """Differences between the values read and the true ones."""
    other = [
        name
        for name, value in known.items()
        if name in found and not np.array_equal(found[name], value, equal_nan=value.dtype.kind == "f")
    ]
    lost, more = sorted(set(known) - set(found)), sorted(set(found) - set(known))
    words = [("lacks", lost), ("has beside", more), ("has other values in", other)]
    return [f"open_run {word} {', '.join(names)}" for word, names in words if names]
