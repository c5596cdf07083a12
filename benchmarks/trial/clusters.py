"""Sweeps on worker processes and on a separate scheduler: clients, workers and schedulers killed on the way."""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import stores
from forks import apart
from pool import note

BLOCKS = 12
START, PATIENCE = 60.0, 90.0  # seconds
TOML = """
[system]
name = "lagrange-top"
p = [0.0, 0.0, 1.0]
[state]
m = [0.1, 0.2, 1.5]
a = [0.6, 0.0, 0.8]
[run]
dt = 0.01
steps = 4_000_000
every = 400_000
[sweep]
block = 1
draws = 12
rng = 1
save = ["drift", "trajectories"]
[sweep.random]
system.alpha = { uniform = [0.5, 1.5] }
[output]
path = "sweep.zarr"
"""
# The command with a stopped clock, so that all bytes can be compared.
COMMAND = """
import sys
sys.path.insert(0, {here!r})
import stores
stores.stand_still()
from kreisel.cli import main
main()
"""


def command(*words: str) -> list[str]:
    """The words that start a sweep."""
    code = COMMAND.format(here=str(Path(__file__).parent))
    return [sys.executable, "-c", code, "sweep", "sweep.toml", "--json", *words]


@contextmanager
def process(words: list[str], folder: Path, quiet: bool = False) -> Iterator[subprocess.Popen[str]]:
    """A process in that folder, ended if it is still there."""
    pipe = subprocess.DEVNULL if quiet else subprocess.PIPE
    started = subprocess.Popen(words, cwd=folder, stdout=pipe, stderr=pipe, text=True)
    try:
        yield started
    finally:
        with suppress(ProcessLookupError):
            started.kill()
        started.communicate()


def blocks_done(folder: Path) -> int:
    """Blocks that are in the store."""
    with suppress(OSError):
        return len(os.listdir(folder / "sweep.zarr.part" / "failed" / "c"))
    return BLOCKS if (folder / "sweep.zarr").exists() else 0


def until(folder: Path, count: int, client: subprocess.Popen[str]) -> None:
    """Wait until n blocks are there, or the client has ended."""
    end = time.monotonic() + START
    while blocks_done(folder) < count and client.poll() is None:
        if time.monotonic() > end:
            raise TimeoutError(f"{blocks_done(folder)} of {count} blocks after {START:g} s")
        time.sleep(0.02)


def children(parent: int) -> list[int]:
    """Worker processes of Dask below a process."""
    found = []
    for place in Path("/proc").iterdir():
        with suppress(OSError, IndexError, ValueError):
            above = int((place / "stat").read_text().rsplit(")", 1)[1].split()[1])
            if above == parent and b"spawn_main" in (place / "cmdline").read_bytes():
                found.append(int(place.name))
    return found


def make(base: Path) -> None:
    """The store of the sweep that nothing disturbs."""
    place = base / "clusters"
    if place.exists():
        return
    place.mkdir()
    (place / "sweep.toml").write_text(TOML, encoding="utf-8")
    done = subprocess.run(
        command("--workers", "0"), cwd=place, check=False, capture_output=True, text=True, timeout=300
    )
    if done.returncode:
        raise AssertionError(f"the sweep that nothing disturbs fails: {done.stderr[-2000:]}")
    (place / "truth.json").write_text(json.dumps(stores.contents(place)))


def case(rng: random.Random, folder: Path) -> str:
    """One of the disturbances; then the same command in this process completes the sweep."""
    name = rng.choice(list(DISTURBED))
    (folder / "sweep.toml").write_text(TOML, encoding="utf-8")
    count = rng.randrange(1, BLOCKS - 3)
    note(f"{name}, after {count} blocks")
    DISTURBED[name](folder, count)
    apart(_looked_at, str(folder))
    done = subprocess.run(
        command("--workers", "0"), cwd=folder, capture_output=True, text=True, timeout=120, check=False
    )
    if done.returncode:
        raise AssertionError(f"the same command does not go on: {done.stderr[-400:]}")
    truth = json.loads((folder.parent.parent / "clusters" / "truth.json").read_text())
    wrong = stores.differences(stores.contents(folder), truth)
    if wrong:
        raise AssertionError(f"in the end it differs in {', '.join(wrong[:6])}")
    return name


def _looked_at(folder: str) -> None:
    import kreisel as kr

    for path in Path(folder).glob("sweep.zarr*"):
        if path.is_dir() and (path / "failed" / "zarr.json").exists():
            run = kr.open_run(path).load()
            done = run["failed"].values != 255
            if not all(abs(run["energy_drift"].values[done]) < 1e-9):
                raise AssertionError("lanes that are done have no values")


def _said(client: subprocess.Popen[str], codes: tuple[int, ...], words: str) -> None:
    out, err = client.communicate(timeout=PATIENCE)
    if client.returncode not in codes or words not in out + err or "Traceback" in err:
        raise AssertionError(f"it ends with {client.returncode}: {err[-600:]}")


def killed_worker(folder: Path, count: int) -> None:
    """One of two local workers."""
    with process(command("--workers", "2"), folder) as client:
        until(folder, count, client)
        for worker in children(client.pid)[:1]:
            os.kill(worker, signal.SIGKILL)
        _said(client, (0,), "")


def killed_client(folder: Path, count: int) -> None:
    """The client of two local workers; they must not stay."""
    with process(command("--workers", "2"), folder) as client:
        until(folder, count, client)
        hands = children(client.pid)
        client.kill()
        client.wait(PATIENCE)
    end = time.monotonic() + PATIENCE
    while any(_alive(hand) for hand in hands):
        if time.monotonic() > end:
            raise AssertionError(f"workers stay {PATIENCE:g} s after their client was killed")
        time.sleep(0.1)


def _alive(pid: int) -> bool:
    with suppress(OSError):
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    return False


def signalled_client(folder: Path, count: int) -> None:
    """SIGTERM to a client with two local workers."""
    with process(command("--workers", "2"), folder) as client:
        until(folder, count, client)
        client.terminate()
        _said(client, (0, 128 + signal.SIGTERM), "")


@contextmanager
def scheduler(folder: Path) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """A Dask scheduler on a loopback port, and its address."""
    words = [sys.executable, "-m", "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0"]
    file = folder / "scheduler.json"
    with process([*words, "--no-dashboard", "--scheduler-file", str(file)], folder, quiet=True) as started:
        end = time.monotonic() + START
        while not file.exists() or not file.read_text().rstrip().endswith("}"):
            if time.monotonic() > end:
                raise TimeoutError("no scheduler")
            time.sleep(0.05)
        address = json.loads(file.read_text())["address"]
        file.unlink()
        yield started, address


def worker(folder: Path, address: str) -> Any:
    """A Dask worker of that scheduler, without a nanny."""
    words = [sys.executable, "-m", "distributed.cli.dask_worker", address, "--nthreads", "1", "--no-dashboard"]
    place = folder.parent.parent / "tmp"
    more = ["--no-nanny", "--death-timeout", "10", "--local-directory", str(place), "--host", "127.0.0.1"]
    return process([*words, *more], folder, quiet=True)


def worker_of_a_scheduler(folder: Path, count: int) -> None:
    """The only worker of somebody's scheduler is killed, and another one comes."""
    with scheduler(folder) as (_, address), process(command("--scheduler", address), folder) as client:
        with worker(folder, address):
            until(folder, count, client)
        with worker(folder, address):
            _said(client, (0,), "")


def client_of_a_scheduler(folder: Path, count: int) -> None:
    """The client is killed; workers of somebody else continue their work."""
    with scheduler(folder) as (_, address), worker(folder, address):
        with process(command("--scheduler", address), folder) as client:
            until(folder, count, client)
        with process(command("--scheduler", address), folder) as client:
            _said(client, (0,), "")


def killed_scheduler(folder: Path, count: int) -> None:
    """The scheduler is killed: one message, and finished blocks are kept."""
    with scheduler(folder) as (started, address), worker(folder, address):
        with process(command("--scheduler", address), folder) as client:
            until(folder, count, client)
            started.kill()
            started.wait(PATIENCE)
            _said(client, (0, 2), "")


DISTURBED = {
    "local worker killed": killed_worker,
    "client of local workers killed": killed_client,
    "client of local workers stopped": signalled_client,
    "worker of a scheduler killed": worker_of_a_scheduler,
    "client of a scheduler killed": client_of_a_scheduler,
    "scheduler killed": killed_scheduler,
}
