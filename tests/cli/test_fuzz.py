"""Configurations and archives at random: a result, or one message; no traceback, no hang, no silent NaN.

`make test` tries a few hundred; `make soak` 10^5 configurations and 10^4 archives.  A failure tells its seed and case.
"""

from __future__ import annotations

import contextlib
import copy
import json
import os
import random
import re
import shutil
import signal
import tomllib
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, seed, settings, strategies as st

import kreisel as kr
from kreisel.cli import configuration as config
from kreisel.runs import integration
from kreisel.storage import checking, simulate as runs
from kreisel.storage.opening import too_large
from kreisel.sweeps.sweep import carry_out, check_archive
from support import ROOT, configuration

CONFIGURATIONS = int(os.environ.get("KREISEL_FUZZ", "200"))
FIRST = int(os.environ.get("KREISEL_FUZZ_FIRST", "0"))  # case: `make soak` takes them in slices
ARCHIVES = int(os.environ.get("KREISEL_FUZZ_ARCHIVES", "30"))
SEED = int(os.environ.get("KREISEL_FUZZ_SEED", "1"))
MOST_FAILURES = 20  # that are listed together
SECONDS = 240  # that a case may take; kernels may have to be compiled, on a busy machine
EXAMPLES = ROOT / "examples"
MOST_STEPS, MOST_LANES = 60, 40
KNOWN = (kr.InputError, kr.RunError)

BODIES = (
    configuration('method = "suris"\norder = 1\ndt = 0.05\nsteps = 40', 'path = "clebsch.zarr"', "clebsch"),
    configuration("dt = 0.05\nsteps = 40", 'path = "neumann.zarr"', "neumann"),
)
NAMES = ("lagrange-top", "gyroscope", "satellite", "kirchhoff", "sweep")
VALID = [*BODIES, *((EXAMPLES / f"{name}.toml").read_text() for name in NAMES)]
ODD = [
    "nan", "inf", "-inf", "-0.0", "0", "-1", "1e400", "1e308", "1e-320", "1e154", "9" * 400, "1_0", "0x10", "true",
    '"x"', "[]", "{}", "[[]]", "1979-05-27", "07:32:00", '"\\u0000"', '"\\U0001F600"', "[1, 2]", "[1.0, 2.0, 3.0, 4.0]",
    "[[1, 0, 0], [0, 1, 0], [0, 0, 1]]", "{ from = 0, to = 1, count = 3 }", "{ sphere = 1 }", "[" * 2000 + "]" * 2000,
    "[" * 200 + "]" * 200, "24", "4", "3.5", '"dop853"', '"variational"', '"exact"', '"auto"', "9223372036854775808",
    "2", "1e-9",
]  # fmt: skip
KEYS = [
    "tol = 1e-9", 'order = "auto"', "alpha = 2.0", "orientation = [1, 0, 0, 0]", "every = 7", "[sweep]", "draws = 3",
    "rng = 1", "x = 1", "[sweep.list]\nrun.dt = [0.1, 0.2]", "ä = 1", "[[run]]", "a.b.c = 1", "block = 2",
]  # fmt: skip


@contextmanager
def alarm(what: object) -> Iterator[None]:
    """A hang is a failure."""

    def ring(*_: object) -> None:
        raise AssertionError(f"hangs: {what}")

    before = signal.signal(signal.SIGALRM, ring)
    signal.alarm(SECONDS)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def mutated(text: str, rng: random.Random) -> str:
    """A valid file with a few random changes."""
    for _ in range(rng.choice([1, 1, 1, 2, 3, 8])):
        lines = text.split("\n")
        place = rng.randrange(len(lines))
        kind = rng.randrange(9)
        if kind <= 2 and "=" in lines[place]:  # another value
            lines[place] = lines[place].split("=")[0] + "= " + rng.choice(ODD)
        elif kind == 3:
            numbers = [m.span() for m in re.finditer(r"[0-9.]+", lines[place])]
            if numbers:
                a, b = rng.choice(numbers)
                lines[place] = lines[place][:a] + rng.choice([*ODD, str(rng.gauss(0, 10))]) + lines[place][b:]
        elif kind == 4:
            del lines[place]
        elif kind == 5:
            lines.insert(place, rng.choice([*KEYS, *lines]))
        elif kind == 6:
            other = rng.randrange(len(lines))
            lines[place], lines[other] = lines[other], lines[place]
        elif lines[place]:
            at = rng.randrange(len(lines[place]))
            new = rng.choice(["", chr(rng.randrange(32, 127)), chr(rng.randrange(128, 0x2FFF)), "\x00", '"', "]", "="])
            lines[place] = lines[place][:at] + new + lines[place][at + 1 :]
        text = "\n".join(lines) or "\n"
    return text


def small(run: Any) -> dict[str, Any]:
    """The settings of a run with few steps."""
    steps = min(run.steps, MOST_STEPS)
    return {"dt": run.dt, "steps": steps, "every": min(run.every, steps), "method": run.method, "order": run.order}


def carried_out(data: dict[str, Any], folder: Path) -> str:
    """What comes of a configuration: "ran" or "refused"; anything else is a failure of the test."""
    try:
        if "sweep" in data:
            return swept(data, folder)
        asked = config.parse(data)
        model, state = asked.model, asked.state
        if asked.run.steps > MOST_STEPS:  # all that is checked before the first step
            from kreisel.runs.planning import make_plan

            asked_for = {**small(asked.run), "steps": asked.run.steps, "every": asked.run.every}
            make_plan(model, state, **asked_for, orientation=asked.orientation, tol=asked.run.tol)
        result = kr.simulate(model, state, orientation=asked.orientation, tol=asked.run.tol, **small(asked.run))
    except KNOWN as error:
        message = str(error)
        assert len(message) > 20, message
        return "refused"
    for name, variable in result.variables.items():
        assert np.isfinite(variable.values).all(), f"{name} is not finite, and nothing was said"
    return "ran"


def swept(data: dict[str, Any], folder: Path) -> str:
    description, file, _ = config.parse_sweep(data)
    if file is not None:
        return "refused"
    description = copy.deepcopy(description)
    run = description["run"]
    for key in ("steps", "every"):
        if isinstance(run.get(key), int) and not isinstance(run[key], bool):
            run[key] = min(run[key], MOST_STEPS)
    spec = description["sweep"]
    if isinstance(spec.get("draws"), int) and spec["draws"] > 2:
        spec["draws"] = 2
    for table in spec.get("grid", {}).values() if isinstance(spec.get("grid"), dict) else ():
        for value in table.values() if isinstance(table, dict) else ():
            if isinstance(value, dict) and isinstance(value.get("count"), int):
                value["count"] = min(value["count"], 4)
    shutil.rmtree(folder, ignore_errors=True)
    report = carry_out(description, folder / "sweep.zarr", workers=0, progress=False)
    result = kr.open_run(report.path)
    good = result.failed.values == 0
    for name, variable in result.variables.items():
        if "lane" in variable.dims and variable.dtype.kind == "f":
            values = variable.transpose("lane", ...).values[good]
            unknown = np.isnan(values).reshape(len(values), -1).all(1)  # another method does not have it
            methods = "run.method" in result.variables or "run.order" in result.variables
            assert np.isfinite(values[~unknown]).all(), name
            assert methods or not unknown.any(), f"{name} is not finite, and nothing was said"
    return "ran"


@pytest.fixture(autouse=True)
def quiet() -> Iterator[None]:
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore", RuntimeWarning)
        yield


def test_mutated_files(tmp_path: Path) -> None:
    outcomes, failures = {"ran": 0, "refused": 0}, []
    for case in range(FIRST, FIRST + CONFIGURATIONS):
        rng = random.Random(f"{SEED} {case}")
        text = mutated(rng.choice(VALID), rng)
        try:
            with alarm(case):
                (tmp_path / "run.toml").write_text(text, encoding="utf-8", errors="surrogatepass")
                data = tomllib.loads(text) if case % 2 else config._load(tmp_path / "run.toml")
                outcomes[carried_out(data, tmp_path / "made")] += 1
        except (tomllib.TOMLDecodeError, RecursionError, kr.InputError):
            outcomes["refused"] += 1
        except Exception as error:
            failures.append(f"seed {SEED}, case {case}: {type(error).__name__}: {error}\n{text[:3000]}")
            assert len(failures) < MOST_FAILURES, "\n\n".join(failures)
    assert not failures, "\n\n".join(failures)
    assert outcomes["ran"] > CONFIGURATIONS / 20
    assert outcomes["refused"] > CONFIGURATIONS / 20


plain = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(),
    st.floats(),
    st.text(max_size=8),
    st.sampled_from(["suris", "exact", "auto"]),
)
anything = st.recursive(
    plain,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=9,
)
vectors = st.lists(st.floats(-1e3, 1e3), min_size=0, max_size=5)
values = st.one_of(anything, vectors, st.lists(vectors, max_size=4))
SECTION = {
    "system": ["name", "p", "alpha", "b", "J", "A", "C", "B"],
    "state": ["m", "a", "M", "P", "x", "q", "orientation"],
    "run": ["dt", "steps", "every", "method", "order", "tol"],
    "output": ["path", "figure"],
    "sweep": ["grid", "list", "random", "draws", "rng", "save", "block", "memory"],
}


@st.composite
def configurations(draw: Any) -> dict[str, Any]:
    """A valid configuration with some of its values replaced by anything."""
    data = copy.deepcopy(tomllib.loads(draw(st.sampled_from(VALID))))
    for _ in range(draw(st.integers(1, 4))):
        section = draw(st.sampled_from(list(SECTION)))
        if draw(st.integers(0, 9)) == 0:
            data[section] = draw(anything)
        elif isinstance(data.get(section), dict):
            data[section][draw(st.sampled_from(SECTION[section]) | st.text(max_size=4))] = draw(values)
    return data


@seed(SEED * 10**9 + FIRST)
@settings(
    max_examples=max(100, CONFIGURATIONS // 2), deadline=None, database=None,
    suppress_health_check=list(HealthCheck),
)  # fmt: skip
@given(data=configurations())
def test_configurations_of_anything(data: dict[str, Any], tmp_path_factory: pytest.TempPathFactory) -> None:
    with alarm(data):
        assert carried_out(data, tmp_path_factory.getbasetemp() / "anything") in ("ran", "refused")


def damaged(store: Path, rng: random.Random) -> str:
    """Damage a store in a few places; what was done."""
    changes = []
    for _ in range(rng.choice([1, 1, 2, 4])):
        files = sorted(p for p in store.rglob("*") if p.is_file())
        if not files:
            return "nothing is left"
        metadata = [p for p in files if p.suffix in (".json", ".npz")]
        path = rng.choice(metadata if metadata and rng.random() < 0.6 else files)
        kind = rng.choice(["flip", "cut", "grow", "delete", "words", "words", "words", "folder", "link"])
        data = bytearray(path.read_bytes())
        if kind == "flip" and data:
            for _ in range(rng.choice([1, 1, 10])):
                data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
            path.write_bytes(bytes(data))
        elif kind == "cut":
            path.write_bytes(bytes(data[: rng.randrange(len(data) + 1)]))
        elif kind == "grow":
            path.write_bytes(bytes(data) + rng.randbytes(rng.randrange(1, 300)))
        elif kind == "delete":
            path.unlink()
        elif kind == "folder":
            path.unlink()
            path.mkdir()
        elif kind == "link":
            path.unlink()
            path.symlink_to("/etc/hostname")
        elif path.suffix == ".json":
            path.write_text(reworded(data.decode(errors="replace"), rng), encoding="utf-8")
        changes.append(f"{kind} {path.relative_to(store)}")
    return ", ".join(changes)


def reworded(text: str, rng: random.Random) -> str:
    """JSON with a number or a word changed."""
    spans = [m.span() for m in re.finditer(r'-?[0-9][0-9.e+-]*|"[^"]*"|true|false|null', text)]
    if not spans:
        return text
    a, b = rng.choice(spans)
    odd = ["1e18", "-1", "0", "null", "true", "1e400", '""', '"x"', "[]", "{}", "[1e18]", "123456789012345678",
           "NaN", '"/etc/passwd"', '"../../x"', '"float32"', '"|O"', '"object"', '"blosc"', "[" * 3000,
           "[" * 900 + "]" * 900, '{"a":' * 40 + "1" + "}" * 40]  # fmt: skip
    return text[:a] + rng.choice(odd) + text[b:]


@pytest.fixture(scope="module")
def stores(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """A finished run, an interrupted one, one with lanes and an orientation, a sweep."""
    folder = tmp_path_factory.mktemp("stores")
    top = kr.LagrangeTop(p=(0, 0, 1))
    x0 = top.state(m=(0.1, 0.2, 1.5), a=(0.6, 0, 0.8))
    before = integration.BLOCK_BYTES
    integration.BLOCK_BYTES = 6 * 8 * 20
    try:
        kr.simulate(top, x0, dt=0.1, steps=100, every=2, path=folder / "run.zarr")
        two = top.state(m=[[0.1, 0.2, 1.5], [0.3, 0.2, 1.5]], a=(0.6, 0, 0.8))
        kr.simulate(top, two, dt=0.1, steps=100, every=2, path=folder / "lanes.zarr", orientation=(1, 0, 0, 0))
        kr.simulate(top, x0, dt=0.1, steps=100, every=2, path=folder / "cut.zarr")
        (folder / "cut.zarr").rename(folder / "cut.zarr.part")
        text = folder / "cut.zarr.part" / "zarr.json"
        text.write_text(text.read_text().replace('"complete": true', '"complete": false'))
        options = {"save": ["drift", "trajectories"], "block": 2}
        design = kr.Design(together={"system.alpha": [1.0, 0.0, 1.2]})
        kr.sweep(top, x0, design, dt=0.1, steps=20, path=folder / "sweep.zarr", workers=0, **options)
    finally:
        integration.BLOCK_BYTES = before
    return sorted(folder.iterdir())


def used(store: Path, out: Path, rng: random.Random) -> None:
    """A check, and some of what else one does with an archive."""
    uses = [
        lambda: checking.recover(store, out / "recovered.zarr"),
        lambda: kr.export(store, out / "out.parquet"),
        lambda: kr.export(store, out / "out.nc"),
        lambda: kr.drift(kr.open_run(store)),
        lambda: kr.plot(kr.open_run(store)),
        lambda: kr.resume(store, extend=120, progress=False),
        lambda: kr.resume(store, progress=False),
    ]
    for use in (lambda: check_archive(store), *rng.choices(uses, weights=[2, 2, 1, 2, 1, 6, 3], k=2)):
        try:
            use()
        except KNOWN as error:
            assert len(str(error)) > 20, error
    with contextlib.suppress(*KNOWN):
        assert not too_large(kr.open_run(store))


def test_damaged_archives(
    stores: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(runs, "CHECKPOINT_SECONDS", 0.0)
    failures = []
    for case in range(FIRST, FIRST + ARCHIVES):
        rng = random.Random(f"{SEED} {case}")
        original = rng.choice(stores)
        store = tmp_path / original.name
        shutil.copytree(original, store)
        changes = damaged(store, rng)
        try:
            with alarm(changes):
                used(store, tmp_path, rng)
            repeated = [r.getMessage() for r in caplog.records if r.name == "asyncio"]
            caplog.clear()
            assert not repeated, "here or in a case before, a traceback beside the message: " + repeated[0]
        except Exception as error:
            failures.append(f"seed {SEED}, case {case}, {store.name}: {changes}: {type(error).__name__}: {error}")
            assert len(failures) < MOST_FAILURES, "\n".join(failures)
        for path in tmp_path.iterdir():
            shutil.rmtree(path) if path.is_dir() else path.unlink()
    assert not failures, "\n".join(failures)


def test_every_flip_of_a_chunk_is_found(stores: list[Path], tmp_path: Path) -> None:
    rng = random.Random(SEED)
    for original in stores:
        if original.suffix == ".part":
            continue
        files = sorted(p for p in original.rglob("*") if p.is_file() and "c" in p.relative_to(original).parts)
        for path in rng.sample(files, min(3, len(files))):
            store = tmp_path / original.name
            shutil.copytree(original, store)
            here = store / path.relative_to(original)
            data = bytearray(here.read_bytes())
            data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
            here.write_bytes(bytes(data))
            assert check_archive(store)[1], here
            shutil.rmtree(store)


def test_every_change_of_the_attributes_is_found(stores: list[Path], tmp_path: Path) -> None:
    store = tmp_path / "run.zarr"
    shutil.copytree(stores[[p.name for p in stores].index("run.zarr")], store)
    metadata = json.loads((store / "zarr.json").read_text())
    for key, value in metadata["attributes"].items():
        if not isinstance(value, str) or key in ("system", "method", "parameters", "options"):
            continue
        changed = {**metadata, "attributes": {**metadata["attributes"], key: value + " "}}
        (store / "zarr.json").write_text(json.dumps(changed))
        assert check_archive(store)[1] == ["zarr.json was changed after the run"]
