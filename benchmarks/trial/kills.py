"""Runs and sweeps that are killed, at random moments and at named ones, and the archives they leave.

Named moments are the events at which files change: before the k-th opening for writing, renaming, removing, making of a
folder, or fsync, counted by an audit hook in the process that is killed; or with the file just emptied that it opened
to write.  After each kill the archive is opened, checked and drawn; in the end the store must have the bytes of a run
that was never killed, and nothing else be in its folder.
"""

from __future__ import annotations

import fcntl
import json
import os
import random
import shutil
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import stores
from forks import apart, begun, ended
from pool import note
from scenarios import NAME, PART, SCENARIOS, complete
from speaking import said

MOST_KILLS = 3  # of one run
EVENTS = ("os.rename", "os.remove", "os.mkdir", "os.rmdir", "shutil.rmtree", "os.truncate")


def warm(base: Path) -> None:
    """Load the kernels, which forked processes then have; no thread starts with that."""
    for scenario in SCENARIOS.values():
        scenario.memory()


def ready(base: Path, name: str) -> Path:
    """The folder of a scenario before it, and its files after it, created once."""
    place = base / "scenarios" / name.replace(" ", "_")
    place.mkdir(parents=True, exist_ok=True)
    with (place / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not (place / "truth.json").exists():
            shutil.rmtree(place / "before", ignore_errors=True)
            (place / "before").mkdir()
            apart(_prepared, name, str(place / "before"))
            shutil.copytree(place / "before", place / "after", dirs_exist_ok=True)
            (place / "truth.json.new").write_text(json.dumps(apart(_uninterrupted, name, str(place / "after"))))
            (place / "truth.json.new").rename(place / "truth.json")
    return place


def _prepared(name: str, folder: str) -> None:
    os.chdir(folder)
    stores.settle(sharded=SCENARIOS[name].sharded)
    SCENARIOS[name].prepare(Path(folder))


def _uninterrupted(name: str, folder: str) -> dict[str, Any]:
    os.chdir(folder)
    stores.settle(sharded=SCENARIOS[name].sharded)
    SCENARIOS[name].act(Path(folder))  # once more, for the kernels are compiled now
    after = stores.contents(Path(folder))
    shutil.rmtree(folder)
    shutil.copytree(Path(folder).with_name("before"), folder)
    os.chdir(folder)
    count = watched(None, False)
    begun = time.monotonic()
    SCENARIOS[name].act(Path(folder))
    took, events = time.monotonic() - begun, count()
    if after != stores.contents(Path(folder)):
        raise AssertionError(f"{name}: two runs differ in {stores.differences(after, stores.contents(Path(folder)))}")
    return {"contents": after, "events": events, "seconds": took}


def watched(last: int | None, torn: bool) -> Callable[[], int]:
    """Count the events at which files change; kill this process at the event number `last`."""
    count = 0

    def event(path: Any = None, emptied: bool = False) -> None:
        nonlocal count
        if count == last:
            if emptied and torn:
                os.close(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o644))
            os.kill(os.getpid(), signal.SIGKILL)
            time.sleep(60)
        count += 1

    def hook(name: str, args: tuple[Any, ...]) -> None:
        if name in EVENTS:
            event()
        elif name == "open" and isinstance(args[0], str | os.PathLike):
            path, mode, flags = args
            writes = any(c in (mode or "") for c in "wax+") if mode else flags & (os.O_WRONLY | os.O_RDWR | os.O_CREAT)
            if writes and str(os.path.abspath(path)).startswith(here) and count_of_opening.take():
                event(path, mode is not None and "w" in mode)
                count_of_opening.give()

    class _Once:
        """Opening within the hook is not an event."""

        free = True

        def take(self) -> bool:
            was, self.free = self.free, False
            return was

        def give(self) -> None:
            self.free = True

    here, count_of_opening, fsync = os.getcwd(), _Once(), os.fsync

    def fsynced(handle: int) -> None:
        event()
        fsync(handle)

    os.fsync = fsynced
    sys.addaudithook(hook)
    return lambda: count


def _killed(name: str, again: bool, last: int | None, torn: bool) -> None:
    """In the process that is killed."""
    scenario = SCENARIOS[name]
    stores.settle(sharded=scenario.sharded)
    watched(last, torn)
    (scenario.again if again else scenario.act)(Path.cwd())


def case(rng: random.Random, folder: Path) -> str:
    """One scenario killed, looked at, gone on with, perhaps killed again, and finished."""
    name = rng.choices(list(SCENARIOS), [s.weight for s in SCENARIOS.values()])[0]
    place = ready(folder.parent.parent, name)
    expected = json.loads((place / "truth.json").read_text())
    shutil.copytree(place / "before", folder, dirs_exist_ok=True)
    os.chdir(folder)
    kills, moments, faults = 0, [], []
    for trial in range(rng.choice([1, 1, 2, MOST_KILLS])):
        aimed, torn = rng.random() < 0.8, rng.random() < 0.2
        last = rng.randrange(expected["events"]) if aimed else None
        pid = begun(_killed, name, trial > 0, last, torn)
        if aimed:
            status = ended(pid)
        else:
            moments.append(rng.uniform(0, 1.2 * expected["seconds"]))
            time.sleep(moments[-1])
            status = ended(pid, signal.SIGKILL)
        moments[len(moments) - (not aimed) :] = [f"event {last}{' torn' * torn}" if aimed else f"{moments[-1]:.3f} s"]
        note(f"{name}, {', '.join(moments)}")
        if status not in (0, -signal.SIGKILL):
            raise AssertionError("it ends in an error, which is on stderr")
        kills += status != 0
        faults += apart(_looked_at, name, str(place), str(folder), trial == 0)
        if status == 0:
            break
    apart(_finished, name, str(folder))
    wrong = stores.differences(stores.contents(folder), expected["contents"])
    if wrong:
        faults.append(f"in the end it differs in {', '.join(wrong[:6])}")
    if faults:
        raise AssertionError("; ".join(dict.fromkeys(faults)))
    return f"killed: {name}" if kills else "ended before the kill"


def _finished(name: str, folder: str) -> None:
    os.chdir(folder)
    stores.settle(sharded=SCENARIOS[name].sharded)
    SCENARIOS[name].again(Path(folder))


def _looked_at(name: str, place: str, folder: str, drawn: bool) -> list[str]:
    """Faults of an archive that a kill left."""
    os.chdir(folder)
    stores.settle(sharded=SCENARIOS[name].sharded)
    faults, whole = [], 0
    known = [stores.values(p) for p in (Path(place) / "before" / NAME, Path(place) / "after" / NAME) if p.exists()]
    for path in (Path(folder) / NAME, Path(folder) / PART):
        if path.exists():
            before = stores.contents(path)
            faults += [f"{path.name}: {fault}" for fault in _wrong(path, known, drawn)]
            whole += complete(path)
            if stores.contents(path) != before:
                faults.append(f"{path.name}: looking at it changed it")
    if "overwrite" in name and not whole:
        faults.append(f"neither {NAME} nor {PART} holds a whole archive: {sorted(os.listdir(folder))}")
    return faults


def _wrong(path: Path, known: list[dict[str, np.ndarray]], drawn: bool) -> list[str]:
    """Open, check and draw an archive, complete or in part."""
    import kreisel as kr

    whole, sweep = complete(path), False
    try:
        run = kr.open_run(path)
        sweep = "kreisel_sweep" in run.attrs
        found = {str(k): np.asarray(v.values) for k, v in run.load().variables.items()}
    except kr.InputError as error:
        checkpoint = (path / "engine" / "checkpoint.npz").exists()
        return [f"open_run: {error}"[:300]] if whole or checkpoint else []
    except Exception as error:
        return [f"open_run raises {type(error).__name__}: {str(error)[:200]}"]
    wrong = []
    if not any(_belongs(found, values, whole, sweep) for values in known):
        wrong.append("open_run gives other values")
    if not whole and not sweep and "time" in found:
        with np.load(path / "engine" / "checkpoint.npz") as saved:
            rows = int(saved["flushed"]) + len(saved["rows"])
        if len(found["time"]) < rows and "my-" not in str(run.attrs["system"]):
            wrong.append(f"open_run gives {len(found['time'])} of {rows} rows")
    for words in [("check",)] + ([] if sweep or not drawn else [("plot", "--out", "../figure.png")]):
        code, out, err = said([words[0], path.name, *words[1:]])
        expected = [line for line in out.splitlines() if line.startswith("FAULT") and "interrupted" not in line]
        good = code == 0 if whole or words[0] == "plot" else code == 1 and not expected
        if not good and not ("no row" in err or "time" not in found):
            wrong.append(f"{words[0]} ends with {code}: {(' '.join(expected) + err)[:300]}")
    Path("../figure.png").unlink(missing_ok=True)
    return wrong


def _belongs(found: dict[str, np.ndarray], known: dict[str, np.ndarray], complete: bool, sweep: bool) -> bool:
    """Whether values are those known, or of an interrupted run the first of them, of a sweep those that are done."""
    if set(found) != set(known):
        return not found or (not complete and set(found) < {*known})
    if complete or not sweep:
        rows = len(found["time"]) if "time" in found and not sweep else 0
        cut = {k: v[:rows] if rows and k != "lane" else v for k, v in known.items()}
        return all(np.array_equal(found[k], cut[k], equal_nan=cut[k].dtype.kind == "f") for k in cut)
    done = found["failed"] != 255
    for name, value in found.items():
        lanes = {len(done)} & set(value.shape)
        if not lanes:
            continue
        axis = 1 if name in ("time",) or (value.ndim > 1 and value.shape[0] != len(done)) else 0
        mine, theirs = np.moveaxis(value, axis, 0)[done], np.moveaxis(known[name], axis, 0)[done]
        if not np.array_equal(mine, theirs, equal_nan=value.dtype.kind == "f"):
            return False
    return True
