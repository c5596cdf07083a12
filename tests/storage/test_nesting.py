"""Brackets without end in what a stranger sends: one message on every path that reads JSON, TOML or a header."""

from __future__ import annotations

import gc
import json
import shutil
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import kreisel as kr
from kreisel import files
from kreisel.cli import configuration as config
from kreisel.storage import archive, checking
from kreisel.sweeps.sweep import carry_out, check_archive
from support import ROOT

TOP = kr.LagrangeTop(p=(0, 0, 1))
X0 = {"m": (0.1, 0.2, 1.5), "a": (0.6, 0.0, 0.8)}
DEPTHS = (33, 940, 100_000)  # the second is read on a shallow stack and not on a deep one


def lists(depth: int) -> str:
    return "[" * depth + "]" * depth


def tables(depth: int) -> str:
    return '{"a":' * depth + "1" + "}" * depth


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("stores") / "run.zarr"
    kr.simulate(TOP, X0, dt=0.1, steps=100, path=path)
    return path


@pytest.fixture(scope="module")
def swept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("stores") / "sweep.zarr"
    kr.sweep(TOP, X0, kr.Design(together={"system.alpha": [1.0, 1.2]}), dt=0.1, steps=20, path=path, workers=0)
    return path


def attribute(store: Path, array: str, name: str, nested: str, quoted: bool) -> None:
    """Write a nested value as an attribute, or as the text of one that holds JSON."""
    path = store / "zarr.json"
    metadata = json.loads(path.read_text())
    node = metadata["consolidated_metadata"]["metadata"][array] if array else metadata
    node["attributes"][name] = nested if quoted else "HERE"
    path.write_text(json.dumps(metadata).replace('"HERE"', nested))
    archive.list_all(store)  # as a stranger would


USES: dict[str, Callable[[Path], Any]] = {
    "check": check_archive,
    "resume": lambda store: kr.resume(store, extend=200, progress=False),
    "plot": lambda store: kr.plot(kr.open_run(store)),
    "cite": lambda store: kr.cite(kr.open_run(store)),
    "recover": lambda store: checking.recover(store, store.with_name("recovered.zarr")),
    "export": lambda store: kr.export(store, store.with_suffix(".parquet")),
}
# where the brackets stand, whether in a text of their own, and what reads them
PLACES = [
    *(("", "comment", False, use) for use in USES),
    *(("a", "kind", False, use) for use in USES),
    *(("", "parameters", True, use) for use in ("resume", "plot")),
    *(("", "options", True, use) for use in ("resume", "cite")),
]


@pytest.mark.parametrize("nested", [lists, tables])
@pytest.mark.parametrize("depth", DEPTHS)
def test_metadata_of_a_run(run: Path, nested: Callable[[int], str], depth: int, tmp_path: Path) -> None:
    for array, name, quoted, use in PLACES:
        store = tmp_path / "run.zarr"
        shutil.copytree(run, store)
        attribute(store, array, name, nested(depth), quoted)
        with pytest.raises(kr.InputError, match="nested too deep"):
            USES[use](store)
        shutil.rmtree(store)
        assert list(tmp_path.iterdir()) == []


def test_manifests(run: Path, swept: Path, tmp_path: Path) -> None:
    for original in (run, swept):
        store = tmp_path / original.name
        shutil.copytree(original, store)
        attribute(store, "", "comment", lists(DEPTHS[-1]), True)  # a text like any other
        assert check_archive(store)[1] == []
        good = (store / "engine" / "checksums.sha256").read_text()
        for text in (lists(DEPTHS[-1]), good[:-3], good.upper(), "0" * 64, "\0", good.replace("  ", " ")):
            (store / "engine" / "checksums.sha256").write_text(text)
            for use in (check_archive, kr.open_run):
                try:
                    faults = use(store)[1]
                except kr.InputError as error:
                    faults = [str(error)]
                assert any("damaged" in fault or "added after the run" in fault for fault in faults)
        (store / "engine" / "checksums.sha256").unlink()
        assert "engine/checksums.sha256 is missing" in check_archive(store)[1][-1]


@pytest.mark.parametrize("depth", DEPTHS)
def test_metadata_of_a_sweep(swept: Path, depth: int, tmp_path: Path) -> None:
    store = tmp_path / "sweep.zarr"
    for array in ("", "failed"):
        shutil.copytree(swept, store)
        attribute(store, array, "comment", lists(depth), False)
        for use in (check_archive, kr.open_run):
            with pytest.raises(kr.InputError, match="nested too deep"):
                use(store)
        shutil.rmtree(store)
    shutil.copytree(swept, store)
    attribute(store, "", "sweep", tables(depth), True)
    with pytest.raises(kr.InputError, match="holds another sweep"):
        kr.sweep(TOP, X0, kr.Design(together={"system.alpha": [1.0, 1.2]}), dt=0.1, steps=20, path=store, workers=0)


@pytest.mark.parametrize("depth", DEPTHS)
def test_configurations(depth: int, tmp_path: Path) -> None:
    text = (ROOT / "examples" / "lagrange-top.toml").read_text()
    (tmp_path / "run.toml").write_text(text.replace("a = [0.6, 0.0, 0.8]", f"a = {lists(depth)}"))
    assert lists(depth) in (tmp_path / "run.toml").read_text()
    with pytest.raises(kr.InputError, match=r"nested too deep|not valid TOML"):
        config.read(tmp_path / "run.toml")
    deep: Any = 1.0
    for _ in range(depth):
        deep = [deep]
    description = {
        "system": {"name": "lagrange-top", "p": [0, 0, 1]}, "state": X0, "run": {"dt": 0.1, "steps": 10},
        "sweep": {"list": {"state.a": deep}},
    }  # fmt: skip
    with pytest.raises(kr.InputError, match="The description of the sweep is nested too deep"):
        carry_out(description, tmp_path / "sweep.zarr", workers=0)
    while isinstance(deep, list):  # a deep list is freed level by level
        deep = deep.pop()


def test_the_deepest_that_is_read() -> None:
    assert files.parsed(lists(files.DEEPEST), "it") is not None
    for text in (lists(files.DEEPEST + 1), tables(files.DEEPEST + 1), "[" * 10**6):
        with pytest.raises(kr.InputError, match="it is"):
            files.parsed(text, "it")


@pytest.mark.parametrize("header", ["-" * 9000 + "1", "(" * 9000, "[" * 150 + "]" * 150], ids=["minus", "open", "deep"])
def test_header_of_a_checkpoint(run: Path, header: str, tmp_path: Path) -> None:
    store = tmp_path / "run.zarr"
    shutil.copytree(run, store)
    path = store / "engine" / "checkpoint.npz"
    with zipfile.ZipFile(path) as archive:
        members = {info.filename: archive.read(info) for info in archive.infolist()}
    text = (header + "\n").encode()
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in members.items():
            archive.writestr(name, b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text + data[-8:])
    with pytest.raises(kr.InputError, match=r"checkpoint .* is damaged"):
        kr.resume(store, extend=200, progress=False)


@pytest.mark.parametrize("text", ["{", '{"zarr_format": 3, "node_type": "arra"}', "[]", '{"zarr_format": 3}', "\xff"])
def test_one_message_where_metadata_are_damaged(
    run: Path, text: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """No traceback of the libraries, at once or when what they left is collected."""
    store = tmp_path / "run.zarr"
    shutil.copytree(run, store)
    (store / "zarr.json").write_bytes(text.encode("latin-1"))
    for use in USES.values():
        with pytest.raises(kr.InputError, match=r"zarr\.json"):
            use(store)
    gc.collect()
    assert [record.getMessage() for record in caplog.records] == []


def test_an_axis_without_a_name(run: Path, tmp_path: Path) -> None:
    """Zarr's metadata may leave the name of an axis out; an archive has them all."""
    store = tmp_path / "run.zarr"
    shutil.copytree(run, store)
    metadata = json.loads((store / "zarr.json").read_text())
    metadata["consolidated_metadata"]["metadata"]["a"]["dimension_names"][1] = None
    (store / "zarr.json").write_text(json.dumps(metadata))
    for use in USES.values():
        with pytest.raises(kr.InputError, match=r"zarr\.json is damaged.*dimension_names"):
            use(store)


def test_an_integral_that_does_not_say_whether_it_is_conserved(run: Path, tmp_path: Path) -> None:
    """It counts as one that is not; the check names the change."""
    store = tmp_path / "run.zarr"
    shutil.copytree(run, store)
    metadata = json.loads((store / "zarr.json").read_text())
    attributes = metadata["consolidated_metadata"]["metadata"]["energy"]["attributes"]
    attributes["kepd"] = attributes.pop("conserved")
    (store / "zarr.json").write_text(json.dumps(metadata))
    assert check_archive(store)[1] == ["zarr.json was changed after the run"]
    with pytest.raises(kr.InputError, match=r"zarr\.json was changed"):
        kr.open_run(store)
    archive.list_all(store)
    assert not kr.drift(kr.open_run(store)).loc["energy", "conserved"]
