"""Runs that are killed, stopped, lengthened, damaged or written twice lose nothing."""

from __future__ import annotations

import json
import multiprocessing
import os
import platform
import random
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.linalg

import kreisel as kr
from kreisel import cli
from kreisel.bodies import BODIES
from kreisel.lab import exact
from kreisel.process import Lock
from kreisel.runs import integration
from kreisel.storage import archive, checking, opening, simulate as runs
from kreisel.sweeps.sweep import check_archive
from kreisel.system import REGISTRY
from sizes import FULL, full
from support import ROOT, contents

OPTIONS = {"dt": 0.1, "steps": 160, "every": 3}  # 55 rows in blocks of seven
SMALL = 6 * 8 * 7  # bytes of a block: seven rows of a top
KILLS = int(os.environ.get("KREISEL_KILLS", "6"))  # `make soak` asks for 200


@pytest.fixture(autouse=True)
def small_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(integration, "BLOCK_BYTES", SMALL)
    monkeypatch.setattr(runs, "CHECKPOINT_SECONDS", 0.0)


def slow_run(path: Path, top: object, x0: object, options: dict) -> None:
    kr.simulate(top, x0, path=path, progress=False, **options)


def apart(begun: Any, path: Path, a_top: dict, x0: dict, options: dict) -> None:
    integration.BLOCK_BYTES, runs.CHECKPOINT_SECONDS = SMALL, 0.0
    integration.SHARDED, integration.CHUNKS = 7, 7
    begun.set()
    slow_run(path, kr.LagrangeTop(**a_top), x0, options)


def kill_during(path: Path, after: float, *run: object) -> bool:
    """Start a run in a process of its own and kill it; whether it was still at work."""
    context = multiprocessing.get_context("forkserver")  # this process may hold threads, which no fork survives
    context.set_forkserver_preload(["kreisel.storage.simulate", "kreisel.storage.run_archive", "llvmlite"])
    begun = context.Event()
    child = context.Process(target=apart, args=(begun, path, *run), daemon=True)
    child.start()
    try:
        assert begun.wait(60)
        time.sleep(after)
        working = child.is_alive()
    finally:
        child.kill()
        child.join(60)
    assert not child.is_alive()
    return working


def test_killed_at_random_moments(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(ROOT)  # where the process to be killed finds this file
    monkeypatch.setattr(integration, "SHARDED", 7)
    monkeypatch.setattr(integration, "CHUNKS", 7)
    options, a_top = {**OPTIONS, "steps": 150, "orientation": (1, 0, 0, 0)}, {"p": (0, 0, 1)}
    top, x0 = kr.LagrangeTop(**a_top), {"m": (0.1, 0.2, 1.5), "a": (0.6, 0, 0.8)}
    begun = time.monotonic()
    slow_run(tmp_path / "whole.zarr", top, x0, options)
    took = time.monotonic() - begun
    expected, moments, killed = contents(tmp_path / "whole.zarr"), random.Random(1), 0
    for trial in range(KILLS):
        path = tmp_path / f"{trial}.zarr"
        killed += kill_during(path, moments.uniform(0, 0.9 * took), a_top, x0, options)
        part = path.with_name(path.name + ".part")
        if path.exists():
            pass
        elif (part / "engine" / "checkpoint.npz").exists():
            kept = kr.open_run(part)
            assert kept.sizes["time"] >= 1
            assert all(np.isfinite(v.values).all() for v in kept.data_vars.values())
            kr.resume(path, progress=False)
        else:  # killed before the first step: nothing was done, and it says so
            with pytest.raises(kr.InputError, match=r"no archive|no checkpoint|cannot be read"):
                kr.resume(path, progress=False)
            slow_run(path, top, x0, options)
        assert contents(path) == expected
        assert not part.exists()
    assert killed >= 1


def stop_after(calls: int, monkeypatch: pytest.MonkeyPatch, number: int = signal.SIGTERM) -> None:
    """Stop the run as a signal would, after some calls of the engine."""
    count, original = iter(range(10**9)), integration.Integration._advance

    def advance(self: integration.Integration) -> None:
        original(self)
        if next(count) == calls:
            os.kill(os.getpid(), number)

    monkeypatch.setattr(integration.Integration, "_advance", advance)


def another_processor(monkeypatch: pytest.MonkeyPatch) -> None:
    """LAPACK rounds otherwise, and chooses other vectors where the matrix leaves a choice."""
    eigh, schur = np.linalg.eigh, scipy.linalg.schur

    def turned(A: np.ndarray, **options: str) -> tuple[np.ndarray, np.ndarray]:
        T, Z = schur(A, **options)
        one = np.eye(len(T))
        one[:2, :2] = [[0.8, -0.6], [0.6, 0.8]]  # in the first plane
        return T, Z @ one

    monkeypatch.setattr(np.linalg, "eigh", lambda A: (lambda d, R: (d * (1 + 1e-14), -R))(*eigh(A)))
    monkeypatch.setattr(scipy.linalg, "schur", turned)


def random_start(name: str, n: int) -> tuple[Any, dict[str, np.ndarray]]:
    draw = exact.float_random(np.random.default_rng(1))
    model = exact.random_model(REGISTRY[name], n, draw)
    if name == "heavy-top":  # not diagonal
        g = exact.random_rotation(n, draw)
        model = type(model)(model.system, {**model.params, "J": g @ model.params["J"] @ g.T})
    return model, dict(zip(model.system.space.letters, model.system.space.point(n, draw), strict=True))


@pytest.mark.parametrize(
    ("name", "n", "method", "oriented"),
    [
        ("heavy-top", 4, "variational", True),
        ("heavy-top", 4, "dop853", False),
        ("lagrange-top-moving", 4, "baecklund", True),
        ("lagrange-top", 9, "suris", True),  # engine="large"
    ],
)
def test_resumed_on_another_processor(
    name: str, n: int, method: str, oriented: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What LAPACK gave at the start comes from the checkpoint; a run begun there has other bits."""
    model, x0 = random_start(name, n)
    options = {"dt": 0.02, "steps": 17, "every": 2, "method": method, "progress": False}
    options |= {"orientation": np.eye(n)} if oriented else {}
    kr.simulate(model, x0, path=tmp_path / "whole.zarr", **options)
    with monkeypatch.context() as patch:
        stop_after(3, patch)
        with pytest.raises(kr.RunError, match="stopped by SIGTERM"):
            kr.simulate(model, x0, path=tmp_path / "cut.zarr", **options)
    another_processor(monkeypatch)
    kr.resume(tmp_path / "cut.zarr", progress=False)
    assert contents(tmp_path / "cut.zarr") == contents(tmp_path / "whole.zarr")
    there = kr.simulate(type(model)(model.system, model.params), x0, **options)
    whole = kr.open_run(tmp_path / "whole.zarr")
    assert any((there[key].values != whole[key].values).any() for key in there.data_vars)  # the stand-in does something


@pytest.mark.skipif(platform.machine() not in ("x86_64", "AMD64"), reason="the names are those of x86-64")
def test_resumed_by_the_code_of_another_processor(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """OpenBLAS's for Prescott and for Haswell, whose eigenvectors have other last bits."""
    model, x0 = random_start("heavy-top", 4)
    options = {"dt": 0.02, "steps": 17, "every": 2, "method": "variational", "progress": False}
    kr.simulate(model, x0, path=tmp_path / "whole.zarr", **options)
    with monkeypatch.context() as patch:
        stop_after(3, patch)
        for core in ("Prescott", "Haswell"):
            with pytest.raises(kr.RunError, match="stopped by SIGTERM"):
                kr.simulate(model, x0, path=tmp_path / f"{core}.zarr", **options)
            stop_after(3, patch)
    code = (
        "import sys, numpy, kreisel as kr\n"
        "run = kr.resume(sys.argv[1], progress=False)\n"
        "known = kr.runs.run_record.RunRecord.from_attrs(run.attrs).model.constants\n"
        "print(known['R'].tobytes().hex(), known['c'].tobytes().hex())"
    )
    found = set()
    for core in ("Prescott", "Haswell"):
        done = subprocess.run(
            [sys.executable, "-c", code, str(tmp_path / f"{core}.zarr")],
            env={**os.environ, "OPENBLAS_CORETYPE": core}, capture_output=True, text=True, check=False, timeout=120,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        found.add(done.stdout)
        assert contents(tmp_path / f"{core}.zarr") == contents(tmp_path / "whole.zarr")
    assert len(found) == 2  # the constants would have been others


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_signals_wait_for_a_checkpoint(
    number: int, top: object, x0: object, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, before = tmp_path / "run.zarr", signal.getsignal(number)
    stop_after(2, monkeypatch, number)
    with pytest.raises(kr.RunError, match=rf"stopped by {signal.Signals(number).name}.*kreisel resume"):
        kr.simulate(top, x0, dt=0.01, steps=10**12, every=10**10, path=path, progress=False)
    assert kr.open_run(path.with_name("run.zarr.part")).sizes["time"] == 1
    assert signal.getsignal(number) == before


def call_of_a_row(self: integration.Integration, out: np.ndarray, every: int) -> None:
    """As if every row took its time."""
    self.plan.engine.advance(out, every)
    self._burst = 1


def test_rows_of_an_interrupted_run_are_read_when_asked_for(
    top: object, x0: object, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = kr.simulate(top, x0, **OPTIONS)
    with monkeypatch.context() as patch, pytest.raises(kr.RunError, match="stopped by SIGTERM"):
        patch.setattr(integration.Integration, "_call", call_of_a_row)
        stop_after(34, patch)
        slow_run(tmp_path / "run.zarr", top, x0, OPTIONS)
    kept = kr.open_run(tmp_path / "run.zarr.part")
    border, rows = opening.read_checkpoint(tmp_path / "run.zarr.part").snapshot.flushed, kept.sizes["time"]
    assert 0 < border < rows - 2
    assert not kept.a.variable._in_memory
    choices = [5, border, border - 1, -1, slice(None), slice(border - 2, border + 2), slice(1, None, 3)]
    choices += [
        [0, 3, border - 1],
        [rows - 1],
        [border, border + 1],
        slice(border, None),
        slice(0, border),
        slice(None, None, -2),
        [0, border + 1, border - 1],
        slice(3, 3),
    ]
    for choice in choices:
        part, same = kept.isel(time=choice), whole.isel(time=slice(0, rows)).isel(time=choice)
        np.testing.assert_array_equal(part.a.values, same.a.values)
        np.testing.assert_array_equal(part.energy.values, same.energy.values)
    np.testing.assert_array_equal(kept.a[1::2, 2].values, whole.a[1:rows:2, 2].values)
    assert not kept.a.variable._in_memory


@pytest.mark.parametrize("command", [False, True])
def test_a_stopped_run_of_a_body_is_resumed(command: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """By `kr.resume(path)` and by `kreisel resume`, in SI units, also if it began later."""
    body = kr.physical.FreeBody((0.03, 0.028, 0.012))
    start = body.state((0.1, 0.2, -0.15))
    for t_start in (0.0, 40.0):
        paths = [tmp_path / f"{name}{t_start}.zarr" for name in ("run", "whole")]
        options = {**OPTIONS, "steps": 61, "t_start": t_start}
        with monkeypatch.context() as patch, pytest.raises(kr.RunError, match="stopped by SIGTERM"):
            patch.setattr(integration.Integration, "_call", call_of_a_row)
            stop_after(12, patch)
            slow_run(paths[0], body, start, options)
        assert kr.open_run(f"{paths[0]}.part").sizes["time"] > 1
        if command:
            monkeypatch.setattr(sys, "argv", ["kreisel", "resume", str(paths[0])])
            with pytest.raises(SystemExit) as end:
                cli.main()
            assert not end.value.code
        else:
            kr.resume(paths[0], progress=False)
        slow_run(paths[1], body, start, options)
        assert contents(paths[0]) == contents(paths[1])


UNINTERRUPTED: dict[str, dict[str, object]] = {}


@pytest.mark.parametrize("method", ["suris", "variational", "dop853"])
@pytest.mark.parametrize("calls", [0, 1, 3])
def test_stopped_inside_a_row(
    method: str, calls: int, top: object, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rng = np.random.default_rng(1)
    x0 = top.state(m=rng.standard_normal((2, 3)), a=rng.standard_normal((2, 3)))
    options = {"dt": 0.1, "steps": 2100, "every": 800, "method": method}
    monkeypatch.setattr(integration, "SHORT_STEPS", 400)  # calls of 200, 400, 200 and 800 steps
    path = tmp_path / "run.zarr"
    with monkeypatch.context() as patch, pytest.raises(kr.RunError, match="stopped by SIGTERM"):
        stop_after(calls, patch)
        slow_run(path, top, x0, options)
    kr.resume(path)
    if method not in UNINTERRUPTED:
        slow_run(tmp_path / "whole.zarr", top, x0, options)
        UNINTERRUPTED[method] = contents(tmp_path / "whole.zarr")
    assert contents(path) == UNINTERRUPTED[method]


@pytest.mark.parametrize("first", [10, 12, 100, 158])
def test_extended_equals_longer(first: int, top: object, x0: object, tmp_path: Path) -> None:
    kr.simulate(top, x0, path=tmp_path / "long.zarr", **OPTIONS)
    kr.simulate(top, x0, path=tmp_path / "run.zarr", **{**OPTIONS, "steps": first})
    run = kr.resume(tmp_path / "run.zarr", extend=160)
    assert run.attrs["steps"] == 160
    assert contents(tmp_path / "run.zarr") == contents(tmp_path / "long.zarr")
    assert check_archive(tmp_path / "run.zarr")[1] == []


def test_rows_opened_before_an_extension_ask_to_be_opened_again(top: Any, x0: Any, tmp_path: Path) -> None:
    path = tmp_path / "run.zarr"
    before = kr.simulate(top, x0, dt=0.05, steps=40, every=4, path=path, progress=False)
    kr.resume(path, extend=160, progress=False)
    with pytest.raises(kr.InputError, match="If it was resumed since you opened it, open it again"):
        before.m.load()
    assert kr.open_run(path).m.load().sizes["time"] == 41


def test_extended_with_the_tolerance_of_the_run(top: object, x0: object, tmp_path: Path) -> None:
    asked = {"dt": 0.25, "every": 4, "method": "dop853", "tol": 1e-4, "progress": False}
    kr.simulate(top, x0, path=tmp_path / "long.zarr", steps=60, **asked)
    kr.simulate(top, x0, path=tmp_path / "run.zarr", steps=30, **asked)
    kr.resume(tmp_path / "run.zarr", extend=60)
    assert contents(tmp_path / "run.zarr") == contents(tmp_path / "long.zarr")
    assert check_archive(tmp_path / "run.zarr")[1] == []
    tight = kr.simulate(top, x0, steps=60, **{**asked, "tol": 1e-9})
    assert abs(tight.a.values - kr.open_run(tmp_path / "run.zarr").a.values).max() > 1e-6  # tol makes a difference


def test_extension_that_is_none(top: object, x0: object, tmp_path: Path) -> None:
    path = tmp_path / "run.zarr"
    kr.simulate(top, x0, path=path, **OPTIONS)
    with pytest.raises(kr.InputError, match="is finished"):
        kr.resume(path)
    for wrong in (10, 0, -3, 1.5):
        with pytest.raises(kr.InputError):
            kr.resume(path, extend=wrong)
    with pytest.raises(kr.InputError, match="no archive"):
        kr.resume(tmp_path / "none.zarr")
    assert kr.open_run(path).attrs["complete"] == 1
    assert [p.name for p in tmp_path.iterdir()] == ["run.zarr"]


def test_a_run_without_its_checkpoint_has_no_toml_file(top: object, x0: object, tmp_path: Path) -> None:
    path = tmp_path / "run.zarr"
    kr.simulate(top, x0, path=path, **OPTIONS)
    (path / "engine" / "checkpoint.npz").unlink()
    with pytest.raises(kr.InputError, match=r"has no checkpoint to resume from\. Run it again\.$"):
        kr.resume(path, extend=10**4)


def test_one_writer(top: object, x0: object, tmp_path: Path) -> None:
    path = tmp_path / "run.zarr"
    with Lock(path), pytest.raises(kr.InputError, match=r"written by another process, which holds .*run\.zarr\.lock"):
        kr.simulate(top, x0, path=path, **OPTIONS)
    (tmp_path / "run.zarr.lock").touch()  # left by a process that is gone
    kr.simulate(top, x0, path=path, **OPTIONS)
    assert [p.name for p in tmp_path.iterdir()] == ["run.zarr"]


def chunks(path: Path, name: str) -> list[Path]:
    return sorted((p for p in (path / name / "c").rglob("*") if p.is_file()), key=lambda p: int(p.parts[-2]))


def test_damage_is_named_and_the_rest_recovered(top: object, x0: object, tmp_path: Path) -> None:
    path = tmp_path / "run.zarr"
    whole = kr.simulate(top, x0, path=path, **OPTIONS).load()
    flipped, gone, cut = chunks(path, "a")[2], chunks(path, "m")[4], chunks(path, "casimir")[6]
    data = bytearray(flipped.read_bytes())
    data[len(data) // 2] ^= 1
    flipped.write_bytes(bytes(data))
    gone.unlink()
    cut.write_bytes(cut.read_bytes()[:10])
    faults = check_archive(path)[1]
    assert sorted(fault.split(":")[0] for fault in faults) == [
        "a cannot be read in rows 14 to 20",
        "casimir cannot be read in rows 42 to 48",
        "m cannot be read in rows 28 to 34",
    ]
    kept, rows = checking.recover(path, tmp_path / "rest.zarr")
    assert (kept, rows) == (len(whole.time) - 21, len(whole.time))
    rest = kr.open_run(tmp_path / "rest.zarr")
    assert rest.attrs["complete"] == 0
    assert rest.equals(whole.sel(time=rest.time))


def test_damaged_numbers_of_lanes_are_named_and_the_rest_recovered(top: object, tmp_path: Path) -> None:
    path = tmp_path / "run.zarr"
    start = top.state(m=[[0.1, 0.2, 1.5], [0.3, 0.2, 1.5]], a=(0.6, 0, 0.8))
    whole = kr.simulate(top, start, path=path, **OPTIONS).load()
    chunk = path / "lane" / "c" / "0"
    chunk.write_bytes(chunk.read_bytes() + b"more")
    run, faults = check_archive(path)
    assert [fault.split(":")[0] for fault in faults] == ["lane cannot be read"]
    assert run is not None and (run.a.values == whole.a.values).all()
    assert checking.recover(path, tmp_path / "rest.zarr") == (len(whole.time), len(whole.time))
    assert (kr.open_run(tmp_path / "rest.zarr").a.values == whole.a.values).all()
    with pytest.raises(kr.InputError, match="lane cannot be read"):
        kr.open_run(path)


def test_changed_metadata_are_named(top: object, x0: object, tmp_path: Path) -> None:
    path = tmp_path / "run.zarr"
    kr.simulate(top, x0, path=path, **OPTIONS)
    meta = path / "a" / "zarr.json"
    meta.write_text(meta.read_text().replace('"state"', '"casimir"'))
    assert check_archive(path)[1][0].startswith("a/zarr.json was changed")


def test_a_claim_of_more_than_memory_is_not_read(top: object, x0: object, tmp_path: Path) -> None:
    path = tmp_path / "run.zarr"
    kr.simulate(top, x0, path=path, **OPTIONS)
    metadata = json.loads((path / "zarr.json").read_text())
    for node in archive.arrays_of(metadata).values():
        node["shape"][0] = 10**14
    (path / "zarr.json").write_text(json.dumps(metadata))
    assert any("zarr.json was changed" in fault for fault in check_archive(path)[1])
    archive.list_all(path)
    assert any("rows were expected, 100000000000000 are there" in fault for fault in check_archive(path)[1])


def test_damaged_checkpoint(top: object, x0: object, tmp_path: Path) -> None:
    path = tmp_path / "run.zarr"
    kr.simulate(top, x0, path=path, **OPTIONS)
    file = path / "engine" / "checkpoint.npz"
    data, snapshot = bytearray(file.read_bytes()), opening.read_checkpoint(path).snapshot
    data[data.index(snapshot.engine["z"].tobytes())] ^= 1
    file.write_bytes(bytes(data))
    with pytest.raises(kr.InputError, match=r"checkpoint .* is damaged"):
        kr.resume(path, extend=2000)
    assert kr.open_run(path).attrs["steps"] == OPTIONS["steps"]


TOP, START = kr.LagrangeTop(p=(0, 0, 1)), {"m": (0.1, 0.2, 1.5), "a": (0.6, 0, 0.8)}
LANES = {"m": [(0.1, 0.2, 1.5), (0.3, 0.2, 1.4)], "a": (0.6, 0, 0.8)}
RNG = np.random.default_rng(3)
SHAPES: dict[str, tuple[Any, Any, dict[str, Any]]] = {
    "one": (TOP, START, {}),
    "oriented": (TOP, START, {"orientation": (1, 0, 0, 0)}),
    "lanes": (TOP, LANES, {}),
    "lanes, oriented": (TOP, LANES, {"orientation": (1, 0, 0, 0)}),
    "one lane": (TOP, {"m": [(0.1, 0.2, 1.5)], "a": (0.6, 0, 0.8)}, {}),
    "parameters with lanes": (kr.LagrangeTop(p=(0, 0, 1), alpha=[0.5, 1.0]), START, {"method": "suris"}),
    "the paper's map": (TOP, LANES, {"method": "suris", "order": 1}),
    "exact": (TOP, LANES, {"method": "exact"}),
    "free body": (
        kr.EulerTop(J=(3.5, 2.5, 0.5)),  # one on the separatrix
        {"M": [(0.5, 0.25, 0.5), (0.3, -0.5, 0.7)]},
        {"orientation": (1, 0, 0, 0)},
    ),
    "dop853": (TOP, LANES, {"method": "dop853"}),
    "variational": (TOP, LANES, {"method": "variational"}),
    "kahan": (TOP, LANES, {"method": "kahan", "order": 4, "orientation": (1, 0, 0, 0)}),
    "corrector": (
        BODIES["satellite"](moments=(1.0, 1.6, 2.0), semi_major_axis=7e6),
        {"M": [(0.4, 0.3, 1.5), (0.3, -0.5, 1.7)]},
        {"orientation": (1, 0, 0, 0), "order": (10, 2)},
    ),
    "veselov": (
        kr.EulerTop(J=(1, 2, 2.5)),
        {"M": RNG.standard_normal((2, 3))},
        {"orientation": (1, 0, 0, 0), "method": "veselov"},
    ),
    "n = 4": (
        kr.LagrangeTop(p=(0, 0, 0, 1)),
        {"m": (lambda X: X - X.mT)(RNG.standard_normal((2, 4, 4))), "a": (0.6, 0, 0, 0.8)},
        {},
    ),
    "large": (
        kr.LagrangeTop(p=np.eye(12)[0]),
        {"m": (lambda X: X - X.mT)(RNG.standard_normal((2, 12, 12))), "a": np.eye(12)[1]},
        {},
    ),
}


REPEATED = ("the paper's map", "n = 4")  # as "lanes" of another method, as "large"


@pytest.mark.parametrize("shape", [*(s for s in SHAPES if s not in REPEATED), *full(*REPEATED)])
def test_every_shape_of_an_interrupted_run_opens_and_goes_on(
    shape: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Stopped before the first block is written, within one, at its end and in the last row, which is irregular."""
    system, start, more = SHAPES[shape]
    state = system.state(**start)
    options = {"dt": 0.1, "steps": 28, "every": 3, "progress": False, **more}  # 11 rows in blocks of four
    monkeypatch.setattr(integration, "block_rows", lambda plan: 4)
    for place in ("storage.run_archive", "runs.describing"):
        monkeypatch.setattr(f"kreisel.{place}.block_rows", lambda plan: 4)
    whole = kr.simulate(system, state, path=tmp_path / "whole.zarr", **options).load()
    expected = contents(tmp_path / "whole.zarr")
    made = integration.Integration.__init__

    def slow(self: integration.Integration, *args: Any, **more: Any) -> None:
        made(self, *args, **more)
        self._burst = 1

    few = (16, 27) if shape in ("exact", "corrector", "large") else (16,)
    for calls in (0, 16, 23, 27) if FULL or shape in ("one", "lanes, oriented") else few:  # steps
        path = tmp_path / f"{calls}.zarr"
        with monkeypatch.context() as patch, pytest.raises(kr.RunError, match="stopped by SIGTERM"):
            patch.setattr(integration.Integration, "_call", call_of_a_row)
            patch.setattr(integration.Integration, "__init__", slow)
            stop_after(calls, patch)
            kr.simulate(system, state, path=path, **options)
        part = path.with_name(path.name + ".part")
        kept = kr.open_run(part)
        rows = kept.sizes["time"]
        assert calls // 3 <= rows <= calls // 3 + 2
        for name in whole.variables:
            same = whole.isel(time=slice(0, rows))[name]
            assert kept[name].dims == same.dims
            np.testing.assert_array_equal(kept[name].values, same.values)
        assert [fault[:23] for fault in check_archive(part)[1]] == ["the run was interrupted"]
        assert len(kr.drift(kept)) > 0
        kr.resume(path, progress=False)
        assert contents(path) == expected


@pytest.mark.parametrize(
    "place",
    ["run_archive._fit", "archive.seal", "archive.clear", "archive.take_name"],
)
def test_a_kill_while_it_is_finished(
    place: str, top: object, x0: object, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, part = tmp_path / "run.zarr", tmp_path / "run.zarr.part"
    slow_run(tmp_path / "whole.zarr", top, x0, OPTIONS)
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(f"kreisel.storage.{place}", lambda *_, **__: (_ for _ in ()).throw(KeyboardInterrupt))
        slow_run(path, top, x0, OPTIONS)
    faults = check_archive(part)[1]
    assert [fault[:23] for fault in faults] == (["the run was interrupted"] if "take_name" not in place else [])
    assert kr.open_run(part).sizes["time"] >= 54
    kr.resume(path)
    assert contents(path) == contents(tmp_path / "whole.zarr")


def test_a_kill_while_arrays_are_lengthened(
    top: object, x0: object, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At each file that changes: what was there opens, and the run goes on to the right bytes."""
    slow_run(tmp_path / "whole.zarr", top, x0, OPTIONS)
    short = {**OPTIONS, "steps": 79}
    rows, original, killed = 1 + 79 // 3, archive.replace_file, 0
    slow_run(tmp_path / "short.zarr", top, x0, short)
    for last in range(0, 60, 1 if FULL else 5):
        path, count = tmp_path / f"{last}.zarr", iter(range(10**9))
        shutil.copytree(tmp_path / "short.zarr", path)

        def replace_file(*arguments: Any, count: Any = count, last: int = last, **more: Any) -> None:
            if next(count) == last:
                raise KeyboardInterrupt
            original(*arguments, **more)

        with monkeypatch.context() as patch:
            patch.setattr(archive, "replace_file", replace_file)
            try:
                kr.resume(path, extend=160, progress=False)
            except KeyboardInterrupt:
                killed += 1
        if path.exists():
            assert contents(path) == contents(tmp_path / "whole.zarr")
            break
        kept = kr.open_run(path.with_name(path.name + ".part")).load()
        assert kept.sizes["time"] >= rows, last
        assert all(np.isfinite(v.values).all() for v in kept.data_vars.values())
        kr.resume(path, extend=160, progress=False)
        assert contents(path) == contents(tmp_path / "whole.zarr")
    assert 3 < killed < 60


def test_a_chunk_that_is_not_listed_does_not_stay(
    top: object, x0: object, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    slow_run(tmp_path / "whole.zarr", top, x0, OPTIONS)
    path, part = tmp_path / "run.zarr", tmp_path / "run.zarr.part"
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr("kreisel.storage.archive.seal", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt))
        slow_run(path, top, x0, OPTIONS)
    (part / "a" / "c" / "99").mkdir()
    (part / "a" / "c" / "99" / "0").write_bytes((part / "a" / "c" / "0" / "0").read_bytes())
    kr.resume(path)
    assert contents(path) == contents(tmp_path / "whole.zarr")


def test_a_block_that_is_no_longer_listed_is_neither_left_out_nor_removed(
    top: object, x0: object, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, part = tmp_path / "run.zarr", tmp_path / "run.zarr.part"
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr("kreisel.storage.archive.seal", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt))
        patch.setattr("kreisel.storage.run_archive._fit", lambda *_: None)  # not complete yet
        slow_run(path, top, x0, OPTIONS)
    (part / "engine" / "blocks" / "0.sha256").unlink()
    for act in (lambda: kr.open_run(part), lambda: kr.resume(path)):
        with pytest.raises(kr.InputError, match="blocks before its checkpoint are missing"):
            act()
    assert (part / "a" / "c" / "0" / "0").exists()
