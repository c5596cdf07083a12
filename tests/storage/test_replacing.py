"""What stands on disk is replaced only if Kreisel made it: archives, stores, figures, pages, exports."""

from __future__ import annotations

import contextlib
import os
import shutil
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import kreisel as kr
from kreisel.cli import configuration as config
from kreisel.files import require_file
from kreisel.process import Lock
from kreisel.storage import archive, checking
from kreisel.sweeps.sweep import check_archive
from sizes import FULL
from support import configuration

OPTIONS: dict[str, Any] = {"dt": 0.1, "steps": 30}
SWEPT: dict[str, Any] = {
    "design": kr.Design(together={"system.alpha": [0.5, 1.0, 1.5]}),
    "block": 2,
    "workers": 0,
    **OPTIONS,
}
TOML = configuration("dt = 0.1\nsteps = 30", 'path = "{path}"\nfigure = "{figure}"')


def everything(folder: Path) -> dict[str, Any]:
    """Names, kinds and contents of all that is there."""
    out: dict[str, Any] = {}
    for path in sorted(folder.rglob("*")):
        mode = os.lstat(path).st_mode
        plain = path.is_file() and not path.is_symlink()
        out[str(path)] = (mode, path.read_bytes() if plain else os.readlink(path) if path.is_symlink() else None)
    return out


def thesis(path: Path) -> None:
    path.mkdir()
    (path / "thesis.tex").write_text("three years")


def thesis_in_an_archive(path: Path) -> None:
    made = path.with_name("made.zarr")
    kr.simulate(kr.LagrangeTop(p=(0, 0, 1)), {"m": (0.1, 0.2, 1.5), "a": (0.6, 0, 0.8)}, path=made, **OPTIONS)
    (made / "engine" / "notes.txt").write_text("mine")
    made.rename(path)


def link_to_a_thesis(path: Path) -> None:
    thesis(path.with_name("elsewhere"))
    path.symlink_to("elsewhere")


def foreign_group(path: Path) -> None:
    import zarr

    zarr.create_group(str(path)).create_array("mine", shape=(3,), dtype="f8")


STANDING = {
    "thesis": thesis,
    "thesis in an archive": thesis_in_an_archive,
    "link": link_to_a_thesis,
    "dangling link": lambda path: path.symlink_to("nowhere"),
    "zarr group of somebody else": foreign_group,
    "csv": lambda path: path.write_text("1,2,3\n"),
    "pipe": os.mkfifo,
}


@pytest.mark.parametrize("place", ["run.zarr", "run.zarr.part", "run.zarr.lock"])
@pytest.mark.parametrize("what", STANDING)
def test_nothing_of_a_users_is_replaced(what: str, place: str, top: Any, x0: Any, tmp_path: Path) -> None:
    STANDING[what](tmp_path / place)
    before = everything(tmp_path)
    for overwrite in (False, True):
        for act in (
            lambda overwrite=overwrite: kr.simulate(
                top, x0, path=tmp_path / "run.zarr", overwrite=overwrite, progress=False, **OPTIONS
            ),
            lambda overwrite=overwrite: kr.sweep(
                top, x0, path=tmp_path / "run.zarr", overwrite=overwrite, progress=False, **SWEPT
            ),
        ):
            with pytest.raises(kr.InputError):
                act()
            assert everything(tmp_path) == before
    if what == "thesis in an archive" and not place.endswith(".lock"):
        return  # that archive can be lengthened, and the file in it stays
    with pytest.raises((kr.InputError, kr.RunError)):
        kr.resume(tmp_path / "run.zarr", extend=60, progress=False)
    assert everything(tmp_path) == before


def test_the_working_folder_is_not_replaced(top: Any, x0: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "inner"
    kr.simulate(top, x0, path=path, **OPTIONS)
    (path / "a").chmod(0o755)
    before = everything(tmp_path)
    for folder in (path, path / "a"):
        monkeypatch.chdir(folder)
        for name in (path, Path("..") / "inner" if folder == path else Path("../../inner")):
            with pytest.raises(kr.InputError, match="working folder"):
                kr.simulate(top, x0, path=name, overwrite=True, **OPTIONS)
    assert everything(tmp_path) == before


def test_what_kreisel_made_is_replaced(top: Any, x0: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "run.zarr"
    kr.simulate(top, x0, path=path, **OPTIONS)
    kr.sweep(top, x0, path=path, overwrite=True, **SWEPT)
    assert "failed" in kr.open_run(path)
    path.with_name("run.zarr.part").mkdir()  # a kill right after it was made
    kr.simulate(top, x0, path=path, overwrite=True, **OPTIONS)
    shutil.copytree(path, path.with_name("run.zarr.part"))  # a kill before it took its name
    shutil.rmtree(path / "a")  # damaged
    kr.simulate(top, x0, path=path, overwrite=True, **OPTIONS)
    assert check_archive(path)[1] == []
    assert [p.name for p in tmp_path.iterdir()] == ["run.zarr"]


def test_what_comes_to_stand_there_during_a_run_is_left(
    top: Any, x0: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, original = tmp_path / "run.zarr", archive.take_name
    for overwrite in (False, True):

        def late(*args: Any) -> None:
            thesis(path)
            original(*args)

        monkeypatch.setattr(archive, "take_name", late)
        with pytest.raises(kr.RunError, match="unchanged"):
            kr.simulate(top, x0, path=path, overwrite=overwrite, **OPTIONS)
        monkeypatch.undo()
        assert (path / "thesis.tex").read_text() == "three years"
        shutil.rmtree(path)
        kr.resume(path)
        assert check_archive(path)[1] == []
        shutil.rmtree(path)


class Killed(BaseException):
    """A kill, at a call."""


def killed_at(monkeypatch: pytest.MonkeyPatch, call: int) -> Iterator[int]:
    """From then on every change of names and every removal is as if the process were gone; counts the calls."""
    calls = iter(range(10**6))

    def after(original: Any) -> Any:
        def run(*args: Any, **options: Any) -> Any:
            if next(calls) >= call:
                raise Killed
            return original(*args, **options)

        return run

    for name in ("replace", "unlink", "rmdir"):
        monkeypatch.setattr(os, name, after(getattr(os, name)))
    return calls


@pytest.mark.parametrize("swept", [False, True])
def test_a_kill_at_any_rename_leaves_the_old_or_the_new(
    swept: bool,
    top: Any,
    x0: Any,
    tmp_path: Path,
    tmp_path_factory: pytest.TempPathFactory,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Whatever the moment: one of the two opens, the next command ends the rest, and nothing is left beside it."""
    make, options = (kr.sweep, SWEPT) if swept else (kr.simulate, {**OPTIONS, "observe": []})
    path, states = tmp_path / "run.zarr", set()

    def killed(call: int) -> int:
        with monkeypatch.context() as patch:
            calls = killed_at(patch, call)
            with contextlib.suppress(Killed):
                make(top, x0, path=path, overwrite=True, **{**options, "steps": 60})
            return next(calls)

    make(top, x0, path=path, **options)
    old = shutil.copytree(path, tmp_path_factory.mktemp("old") / path.name)
    total = killed(10**6)
    renames = total - sum(1 for _ in path.rglob("*")) - 6  # before all that removes the old one
    far, near = (11, 1) if FULL else (97, 2) if swept else (37, 1)
    for call in [*range(0, renames, far), *range(renames, renames + 12, near), total - 1]:
        shutil.rmtree(path)
        shutil.copytree(old, path)
        killed(call)
        path.with_name("run.zarr.lock").unlink(missing_ok=True)  # the system takes a lock away from a dead process
        states.add(tuple(sorted(p.name for p in tmp_path.iterdir())))
        kr.open_run(path)
        assert check_archive(path)[1] == []
        assert not archive.replaced(path).exists()
        make(top, x0, path=path, overwrite=True, **options)
        assert [p.name for p in tmp_path.iterdir()] == ["run.zarr"]
    assert (".run.zarr.replaced", "run.zarr.part") in states
    assert (".run.zarr.replaced", "run.zarr") in states


def test_resume_ends_a_replacement_that_was_cut(top: Any, x0: Any, tmp_path: Path) -> None:
    """Killed between the renames, when nothing else was left to do."""
    path = tmp_path / "run.zarr"
    kr.simulate(top, x0, path=path, **OPTIONS)
    kr.simulate(top, x0, path=tmp_path / "new.zarr", **{**OPTIONS, "steps": 60})
    path.rename(archive.replaced(path))
    (tmp_path / "new.zarr").rename(archive.part_of(path))
    run = kr.resume(path)
    assert run.attrs["steps"] == 60 and [p.name for p in tmp_path.iterdir()] == ["run.zarr"]
    with pytest.raises(kr.InputError, match="is finished"):
        kr.resume(path)


def test_a_backup_with_a_likely_name_stays(top: Any, x0: Any, tmp_path: Path) -> None:
    path = tmp_path / "run.zarr"
    kr.simulate(top, x0, path=path, **OPTIONS)
    for name in ("run.zarr.old", "run.zarr.bak", "run.zarr.old-123"):
        shutil.copytree(path, tmp_path / name)
    kr.simulate(top, x0, path=path, overwrite=True, **OPTIONS)
    assert len(list(tmp_path.iterdir())) == 4


@pytest.mark.parametrize("name", ["top.png", "top.pdf", "top.svg"] if FULL else ["top.pdf"])
def test_figures(name: str, tmp_path: Path, kreisel: Any) -> None:
    (tmp_path / "run.toml").write_text(TOML.format(path="run.zarr", figure=name))
    command = "run", "run.toml", "--overwrite"
    (tmp_path / name).write_text("drawn by hand: Kreisel")
    before = everything(tmp_path)
    refused = kreisel(*command)
    assert refused.returncode == 2
    assert "unchanged" in refused.stderr
    assert everything(tmp_path) == before  # before the first step
    (tmp_path / name).unlink()
    for _ in range(2):
        assert kreisel(*command).returncode == 0
    require_file(tmp_path / name)  # has the mark


def test_pages(top: Any, x0: Any, tmp_path: Path) -> None:
    run, page = kr.simulate(top, x0, **OPTIONS), tmp_path / "top.html"
    page.write_text("<!doctype html><p>My thesis on Kreisel")
    with pytest.raises(kr.InputError, match="unchanged"):
        kr.view(run).save(page)
    assert "thesis" in page.read_text()
    page.unlink()
    for _ in range(2):
        kr.view(run).save(page)
    with pytest.raises(kr.InputError, match=r"ends in \.html, got 'top\.png'"):
        kr.view(run).save(tmp_path / "top.png")
    assert [p.name for p in tmp_path.iterdir()] == ["top.html"]


def test_no_message_advises_to_replace_a_file_without_a_mark(top: Any, x0: Any, tmp_path: Path) -> None:
    run, table = kr.simulate(top, x0, **OPTIONS), tmp_path / "top.csv"  # of plain text, which has no room for a mark
    kr.export(run, table)
    for overwrite in (False, True):
        with pytest.raises(kr.InputError, match=r"CSV have no mark\. Choose another name, or move it away"):
            kr.export(run, table, overwrite=overwrite)


def test_a_reader_does_not_settle_what_a_writer_does(top: Any, x0: Any, tmp_path: Path) -> None:
    path = tmp_path / "run.zarr"
    kr.simulate(top, x0, path=path, **OPTIONS)
    path.rename(archive.replaced(path))
    with Lock(path), pytest.raises(kr.InputError, match="no archive"):
        kr.open_run(path)
    assert kr.open_run(path).sizes["time"] == 31


def test_an_archive_holds_one_run_and_nothing_else(top: Any, x0: Any, tmp_path: Path) -> None:
    path = tmp_path / "run.zarr"
    run = kr.simulate(top, x0, path=path, **OPTIONS)
    acts = (
        lambda inner: kr.simulate(top, x0, path=inner / "b.zarr", overwrite=True, **OPTIONS),
        lambda inner: kr.sweep(top, x0, path=inner / "b.zarr", **SWEPT),
        lambda inner: kr.export(run, inner / "run.nc"),
        lambda inner: kr.view(run).save(inner / "run.html"),
        lambda inner: checking.recover(path, inner / "rest.zarr"),
    )
    for inner in (path, path / "a"):
        for act in acts:
            with pytest.raises(kr.InputError, match="within the archive"):
                act(inner)
    for figure in ("run.zarr", "run.zarr/top.png", "run.zarr/a/top.png"):
        with pytest.raises(kr.InputError, match=r"next to the archive|must end in"):
            config.parse(tomllib.loads(TOML.format(path="run.zarr", figure=figure)))
    assert check_archive(path)[1] == []
    assert [p.name for p in tmp_path.iterdir()] == ["run.zarr"]


@pytest.mark.parametrize("swept", [False, True])
def test_a_replacement_that_was_interrupted_goes_on(
    swept: bool, top: Any, x0: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With the consent of --overwrite, and for the archive that stood there then alone."""
    path, longer = tmp_path / "run.zarr", {**(SWEPT if swept else OPTIONS), "steps": 60}
    make = kr.sweep if swept else kr.simulate
    kr.simulate(top, x0, path=path, **OPTIONS)
    sealed = "kreisel.storage.archive.seal"
    for _ in range(2):
        with monkeypatch.context() as patch, pytest.raises(Killed):
            patch.setattr(sealed, lambda *_, **__: (_ for _ in ()).throw(Killed))
            make(top, x0, path=path, overwrite=True, **longer)
        path.with_name("run.zarr.lock").unlink(missing_ok=True)
        assert "failed" not in kr.open_run(path)
        if swept:
            made = len(list((path.with_name("run.zarr.part") / "engine" / "blocks").iterdir()))
            assert made == 2  # and a second time none of them is computed again
            monkeypatch.setattr("kreisel.sweeps.workers.compute", None)
    if swept:
        kr.sweep(top, x0, path=path, overwrite=True, **longer)
        assert kr.open_run(path).sizes["lane"] == 3
    else:
        kept = path.rename(tmp_path / "kept.zarr")
        kr.simulate(top, x0, path=tmp_path / "other.zarr", dt=0.2, steps=10)
        (tmp_path / "other.zarr").rename(path)
        with pytest.raises(kr.InputError, match="was not to be replaced"):
            kr.resume(path)
        shutil.rmtree(path)
        kept.rename(path)
        assert kr.resume(path).attrs["steps"] == 60
    assert check_archive(path)[1] == []
    assert not path.with_name("run.zarr.part").exists()


def test_a_name_of_what_is_being_made_is_refused(top: Any, x0: Any, tmp_path: Path) -> None:
    for make, options in ((kr.simulate, OPTIONS), (kr.sweep, SWEPT)):
        with pytest.raises(kr.InputError, match=r"does not end in \.part"):
            make(top, x0, path=tmp_path / "run.part", **options)
    with pytest.raises(kr.InputError, match="no archive"):
        kr.open_run(tmp_path / "run.zarr.part")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("overwrite", [False, True])
def test_a_sweep_killed_before_its_metadata_are_listed(
    overwrite: bool, top: Any, x0: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, options = tmp_path / "run.zarr", {**SWEPT, "save": ["trajectories"], "overwrite": overwrite}
    if overwrite:
        kr.simulate(top, x0, path=path, **OPTIONS)
    with monkeypatch.context() as patch, pytest.raises(Killed):
        patch.setattr("kreisel.storage.archive.write_metadata", lambda *_: (_ for _ in ()).throw(Killed))
        kr.sweep(top, x0, path=path, **options)
    path.with_name("run.zarr.lock").unlink(missing_ok=True)
    kr.sweep(top, x0, path=path, **options)
    assert kr.open_run(path).sizes["lane"] == 3
    assert check_archive(path)[1] == []
    assert [p.name for p in tmp_path.iterdir()] == ["run.zarr"]
