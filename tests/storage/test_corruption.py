"""Every chunk is bound to its place: what is changed, missing, swapped, added or of another archive is found."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import socket
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

import kreisel as kr
from kreisel.files import CHECKSUMS, digest
from kreisel.runs import integration
from kreisel.storage import archive, opening, run_archive
from kreisel.sweeps.sweep import check_archive

OPTIONS: dict[str, Any] = {"dt": 0.1, "steps": 60, "every": 2, "orientation": (1, 0, 0, 0)}
SWEPT: dict[str, Any] = {
    "design": kr.Design(together={"state.m[2]": np.linspace(0.5, 1.5, 6)}),
    "save": ["drift", "extremes", "trajectories"], "block": 2, "workers": 0, "dt": 0.1, "steps": 20,
}  # fmt: skip
TOP = kr.LagrangeTop(p=(0, 0, 1))
START = {"m": (0.1, 0.2, 1.5), "a": (0.6, 0, 0.8)}


@pytest.fixture(scope="module")
def stores(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run, the same of another start, an ensemble and a sweep, of several blocks each."""
    folder = tmp_path_factory.mktemp("stores")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(integration, "BLOCK_BYTES", 10 * 8 * 10)
        kr.simulate(TOP, START, path=folder / "run.zarr", **OPTIONS)
        kr.simulate(TOP, {**START, "a": (0.8, 0, 0.6)}, path=folder / "other.zarr", **OPTIONS)
        two = {"m": [(0.1, 0.2, 1.5), (0.3, 0.2, 1.4)], "a": (0.6, 0, 0.8)}
        kr.simulate(TOP, two, path=folder / "lanes.zarr", **OPTIONS)
        kr.sweep(TOP, START, path=folder / "sweep.zarr", **SWEPT)
    return folder


@pytest.fixture(scope="module")
def right(stores: Path) -> dict[str, xr.Dataset]:
    """What is in each, before any damage, which `check` finds in none."""
    for store in stores.iterdir():
        assert check_archive(store)[1] == []
    return {store.stem: kr.open_run(store).load() for store in stores.iterdir()}


def swap(one: Path, two: Path) -> None:
    data = one.read_bytes(), two.read_bytes()
    assert data[0] != data[1]
    one.write_bytes(data[1])
    two.write_bytes(data[0])


def flip(path: Path, place: int = -5) -> None:
    data = bytearray(path.read_bytes())
    data[place] ^= 1
    path.write_bytes(bytes(data))


def replace_by(path: Path, make: Callable[[Path], Any]) -> None:
    path.unlink()
    make(path)


def listen(path: Path) -> None:
    here = os.getcwd()
    os.chdir(path.parent)  # the name of a socket is short
    try:
        with socket.socket(socket.AF_UNIX) as made:
            made.bind(path.name)
    finally:
        os.chdir(here)


def reworded(path: Path) -> None:
    metadata = json.loads(path.read_text())
    metadata["attributes"]["dt"] = 0.2
    path.write_text(json.dumps(metadata))


def added(store: Path) -> None:
    shutil.copytree(store / "energy", store / "power")


G, A, M = "g/c/1/0", "a/c/1/0", "m/c/1/0"
DAMAGE: dict[str, tuple[str, Callable[[Path], Any]]] = {
    "flipped bit": ("run", lambda s: flip(s / A)),
    "cut": ("run", lambda s: (s / A).write_bytes((s / A).read_bytes()[:-7])),
    "empty": ("run", lambda s: (s / A).write_bytes(b"")),
    "deleted": ("run", lambda s: (s / A).unlink()),
    "chunks of a variable swapped": ("run", lambda s: swap(s / A, s / "a/c/2/0")),
    "orientations swapped": ("run", lambda s: swap(s / G, s / "g/c/2/0")),
    "variables swapped": ("run", lambda s: swap(s / A, s / M)),
    "a chunk of another archive": ("run", lambda s: shutil.copy(s.with_name("other.zarr") / G, s / G)),
    "all chunks of another archive": ("run", lambda s: shutil.copytree(s.with_name("other.zarr") / "g/c", s / "g/c",
                                                                       dirs_exist_ok=True)),
    "times of another place": ("run", lambda s: shutil.copy(s / "time/c/0", s / "time/c/1")),
    "an added array": ("run", added),
    "an added file": ("run", lambda s: (s / "a" / "more").write_text("more")),
    "an added chunk": ("run", lambda s: shutil.copy(s / A, s / "a/c/9")),
    "a deleted array": ("run", lambda s: shutil.rmtree(s / "g")),
    "changed attributes": ("run", lambda s: reworded(s / "zarr.json")),
    "changed checkpoint": ("run", lambda s: flip(s / "engine/checkpoint.npz", 300)),
    "checkpoint of another run": ("run", lambda s: shutil.copy(s.with_name("other.zarr") / "engine/checkpoint.npz",
                                                               s / "engine/checkpoint.npz")),
    "manifest of another run": ("run", lambda s: shutil.copy(s.with_name("other.zarr") / CHECKSUMS,
                                                             s / CHECKSUMS)),
    "no manifest": ("run", lambda s: (s / CHECKSUMS).unlink()),
    "a line less in the manifest": ("run", lambda s: (s / CHECKSUMS).write_text(
        "".join(line for line in (s / CHECKSUMS).read_text().splitlines(True) if A not in line))),
    "pipe": ("run", lambda s: replace_by(s / A, os.mkfifo)),
    "pipe as metadata": ("run", lambda s: replace_by(s / "zarr.json", os.mkfifo)),
    "pipe as manifest": ("run", lambda s: replace_by(s / CHECKSUMS, os.mkfifo)),
    "socket": ("run", lambda s: replace_by(s / A, listen)),
    "link": ("run", lambda s: replace_by(s / A, lambda path: path.symlink_to(s / M))),
    "folder": ("run", lambda s: replace_by(s / A, os.mkdir)),
    "lanes: a chunk swapped": ("lanes", lambda s: swap(s / "g/c/0/0/0", s / "g/c/1/0/0")),
    "lanes: their numbers deleted": ("lanes", lambda s: (s / "lane/c/0").unlink()),
    "sweep: times deleted": ("sweep", lambda s: (s / "time/c/0").unlink()),
    "sweep: blocks swapped": ("sweep", lambda s: swap(s / "m/c/0/0/0", s / "m/c/0/1/0")),
    "sweep: variables swapped": ("sweep", lambda s: swap(s / "energy_drift/c/0", s / "energy_start/c/0")),
    "sweep: deleted": ("sweep", lambda s: (s / "a/c/0/1/0").unlink()),
    "sweep: failures deleted": ("sweep", lambda s: (s / "failed/c/1").unlink()),
    "sweep: an added array": ("sweep", lambda s: shutil.copytree(s / "energy_drift", s / "power_drift")),
    "sweep: a deleted array": ("sweep", lambda s: shutil.rmtree(s / "energy_drift")),
}  # fmt: skip


@pytest.mark.parametrize("what", DAMAGE)
def test_damage_is_found_and_never_read(what: str, stores: Path, right: dict[str, xr.Dataset], tmp_path: Path) -> None:
    """`check` names it; `open_run` gives the true values or an error, and never others."""
    name, damage = DAMAGE[what]
    for copied in (f"{name}.zarr", "other.zarr"):
        shutil.copytree(stores / copied, tmp_path / copied)
    store = tmp_path / f"{name}.zarr"
    damage(store)
    try:
        assert check_archive(store)[1]
    except kr.InputError as error:
        assert len(str(error)) > 40
    with contextlib.suppress(kr.InputError):
        run = kr.open_run(store)
        for variable, before in right[name].variables.items():
            with contextlib.suppress(kr.InputError):
                np.testing.assert_array_equal(run[variable].values, before.values)


def test_damage_below_the_checksums_is_found_by_computing_again(stores: Path, tmp_path: Path) -> None:
    """As if a run had written wrong numbers: orientations, and the summaries of a sweep."""
    for name, one, two in (("run", G, "g/c/2/0"), ("lanes", "g/c/0/0/0", "g/c/1/0/0")):
        store = tmp_path / f"{name}.zarr"
        shutil.copytree(stores / f"{name}.zarr", store)
        swap(store / one, store / two)
        archive.list_all(store)
        (fault,) = check_archive(store)[1]
        assert fault.startswith("g of row") and "does not follow" in fault
    store = tmp_path / "sweep.zarr"
    shutil.copytree(stores / "sweep.zarr", store)
    swap(store / "m/c/0/0/0", store / "m/c/0/1/0")
    archive.list_all(store)
    (fault,) = check_archive(store)[1]
    assert fault.startswith("m of lane 0 differs from the lane computed again")
    store = tmp_path / "run.zarr"
    shutil.copy(stores / "run.zarr" / "time/c/0", store / "time/c/1")
    archive.list_all(store)
    assert "time is not the time of the steps" in check_archive(store)[1]


def test_damage_while_it_is_read(stores: Path, tmp_path: Path) -> None:
    """What is lost between opening and reading is an error, not NaN."""
    for damage in (lambda path: path.unlink(), flip, lambda path: shutil.rmtree(tmp_path / "run.zarr")):
        shutil.copytree(stores / "run.zarr", tmp_path / "run.zarr", dirs_exist_ok=True)
        run = kr.open_run(tmp_path / "run.zarr")
        damage(tmp_path / "run.zarr" / A)
        with pytest.raises(kr.InputError, match="is damaged"):
            run.a.load()


def test_the_manifest_is_read_by_others(stores: Path) -> None:
    """The format of sha256sum: names relative to the archive, every file but itself."""
    store = stores / "run.zarr"
    lines = (store / CHECKSUMS).read_text().splitlines()
    names = [line[66:] for line in lines]
    assert sorted(names) == sorted(
        p.relative_to(store).as_posix() for p in store.rglob("*") if p.is_file() and p != store / CHECKSUMS
    )
    assert all(digest(store / name) == line[:64] for name, line in zip(names, lines, strict=True))


def test_a_folder_that_vanishes_at_any_moment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One message, and never an archive that says that it is complete."""
    monkeypatch.setattr(integration, "BLOCK_BYTES", 10 * 8 * 5)
    monkeypatch.setattr("kreisel.storage.simulate.CHECKPOINT_SECONDS", 0.0)
    places = [(run_archive.RunArchive, "append"), (opening, "write_checkpoint"), (archive, "write_block"),
              (archive, "seal"), (archive, "write_metadata")]  # fmt: skip
    for place, name in places:
        for what in ("", "a", "engine"):
            original, count = getattr(place, name), iter(range(10**6))

            def gone(*args: Any, original: Any = original, count: Any = count, what: str = what, **more: Any) -> Any:
                if next(count) == (1 if name in ("append", "write_checkpoint", "write_block", "write_metadata") else 0):  # noqa: B023
                    shutil.rmtree(tmp_path / "run.zarr.part" / what)
                return original(*args, **more)

            with monkeypatch.context() as patch:
                patch.setattr(place, name, gone)
                try:
                    kr.simulate(TOP, START, path=tmp_path / "run.zarr", **OPTIONS)
                except (kr.RunError, kr.InputError):
                    assert not (tmp_path / "run.zarr").exists()
                else:  # no chunk was there yet, and metadata are written again
                    assert what == "a" and check_archive(tmp_path / "run.zarr")[1] == []
                    shutil.rmtree(tmp_path / "run.zarr")
            shutil.rmtree(tmp_path / "run.zarr.part", ignore_errors=True)
