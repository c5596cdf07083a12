"""Configurations from a grammar, through the command line: a run, or one message and the documented code.

The folder of a case holds files of a user's: a thesis, data, a FIFO, links.  They must be as they were, whatever the
configuration names as its output.
"""

from __future__ import annotations

import os
import random
import re
import shutil
import stat
from pathlib import Path
from typing import Any

import numpy as np
from grammar import (
    ENGINES,
    METHODS,
    ODD,
    TEXTS,
    dimension,
    key,
    never_long,
    odd,
    orientation,
    parameters,
    plain,
    scaled,
    state as state_of,
    toml,
)
from pool import note
from speaking import said

CONTROL = re.compile("[\x00-\x08\x0b-\x1f\x7f\x80-\x9f]")
LONGEST = 2000  # characters of a message
CODES = {"check": {0, 1, 2}, "verify": {0, 1, 2}, "run": {0, 2, 3}, "resume": {0, 2, 3}, "sweep": {0, 2, 3}}
THESIS = ("thesis", "thesis/chapter.tex", "data.csv", "pipe", "link", "link.csv", "thesis.zarr.part")
NAMES = ["run.zarr", "run", "deep/er/run.zarr", "./run.zarr", "run.zarr/", "räume.zarr", "run 1.zarr", "a.b.c.zarr"]
IN_THE_WAY = ["thesis", "thesis/chapter.tex", "data.csv", "pipe", "link", "link.csv", "thesis.zarr", "old.zarr",
              ".", "..", "", "/", "thesis/..", "../{case}", "~", "~/run.zarr", "link/run.zarr", "x" * 300, "\x00",
              "data.csv/run.zarr", "run.toml", "old.zarr/a", "old.zarr/inner.zarr", "/dev/null",
              "/dev/full"]  # fmt: skip


def furnish(folder: Path, old: bool) -> None:
    """The files of a user's."""
    (folder / "thesis").mkdir()
    (folder / "thesis" / "chapter.tex").write_text("years\n")
    (folder / "thesis.zarr.part").mkdir()
    (folder / "thesis.zarr.part" / "notes.txt").write_text("more years\n")
    (folder / "data.csv").write_text("1,2,3\n")
    os.mkfifo(folder / "pipe")
    (folder / "link").symlink_to(folder.parent.parent / "sentinel", target_is_directory=True)
    (folder / "link.csv").symlink_to("data.csv")
    if old:
        shutil.copytree(folder.parent.parent / "stores" / "true" / "single.zarr", folder / "old.zarr")


def theirs(folder: Path) -> list[Any]:
    """Files that must not change."""
    out: list[Any] = []
    for name in (*THESIS, "thesis.zarr.part/notes.txt"):
        path = folder / name
        status = os.lstat(path) if os.path.lexists(path) else None
        words = path.read_text() if status and stat.S_ISREG(status.st_mode) else ""
        out.append((name, status and stat.S_IFMT(status.st_mode), status and status.st_ino, words))
    return out


def case(rng: random.Random, folder: Path) -> str:
    """A configuration, or odd words, to the command line."""
    furnish(folder, rng.random() < 0.3)
    if rng.random() < 0.82:
        words = with_file(rng, folder)
    else:
        words = odd_words(rng, folder)
    before, there = theirs(folder), set(os.listdir(folder))
    code, out, err = said(words)
    faults = judged(words, code, out, err)
    after = theirs(folder)
    if after != before:
        faults.append(f"changed what was not Kreisel's: {[a[0] for a, b in zip(before, after, strict=True) if a != b]}")
    new = set(os.listdir(folder)) - there
    scratch = [n for n in new if re.search(r"\.lock$|\.old|^\.|\.new$", n) or (n.endswith(".part") and not kept(err))]
    if scratch:
        faults.append(f"left {scratch}")
    if code == 0 and words[0] in ("run", "sweep") and not faults:
        faults += infinite(folder, new)
    if faults:
        raise AssertionError("; ".join(faults))
    return f"{words[0]}: {({0: 'carried out', 1: 'damaged', 2: 'refused', 3: 'not conserved'}).get(code, code)}"


def kept(err: str) -> bool:
    """Whether a message states that an archive was kept, which can be resumed."""
    return "kept" in err or "resume" in err or "goes on" in err


def judged(words: list[str], code: int, out: str, err: str) -> list[str]:
    """Faults of the output of the command line."""
    faults = []
    if code not in CODES.get(words[0], {0, 2}) or (code == 3 and "conserve" not in err):
        faults.append(f"exit code {code}")
    if "Traceback" in out + err:
        faults.append(f"a traceback: {(out + err)[-400:]}")
    if code == 2 and "Usage:" not in err:
        messages = [line for line in err.splitlines() if line.startswith("kreisel: ")]
        if len(messages) != 1 or not err.startswith("kreisel: "):
            faults.append(f"{len(messages)} messages: {err[:300]!r}")
        elif len(err) > LONGEST:
            faults.append(f"a message of {len(err)} characters: {err[:200]!r}")
        elif len(err) < 30:
            faults.append(f"a message that says nothing: {err!r}")
    if code == 0 and err.strip() and "rows are whole" not in err:
        faults.append(f"warnings: {err[:300]!r}")
    control = CONTROL.search(err) or CONTROL.search(out)
    if control:
        faults.append(f"control characters in the output: {(out + err)[max(0, control.start() - 60) :][:120]!r}")
    return faults


def infinite(folder: Path, new: set[str]) -> list[str]:
    """Values of a new archive that are not finite, without a message."""
    import kreisel as kr

    faults = []
    for name in new:
        if not (folder / name / "zarr.json").exists():
            continue
        run = kr.open_run(folder / name)
        good = run["failed"].values == 0 if "failed" in run else slice(None)
        for label, variable in run.variables.items():
            if variable.dtype.kind != "f":
                continue
            values = variable.transpose("lane", ...).values[good] if "lane" in variable.dims else variable.values
            varied = any(k in run for k in ("run.method", "run.order"))
            lost = ~np.isfinite(values)
            if lost.any() and not (varied and "lane" in variable.dims):
                faults.append(f"{label} is not finite in {name}, and nothing was said")
    return faults


def with_file(rng: random.Random, folder: Path) -> list[str]:
    """A TOML file and the command that reads it."""
    sweeping = rng.random() < 0.25
    data = configuration(rng, folder, sweeping)
    text = rendered(data, rng)
    note(text)
    raw = text.encode("utf-8", errors="surrogatepass")
    if rng.random() < 0.02:
        raw = rng.choice(
            [b"\xef\xbb\xbf" + raw, raw.replace(b"\n", b"\r\n"), raw[: len(raw) // 2], b"\xff" + raw, raw + raw]
        )
    (folder / "run.toml").write_bytes(raw)
    right = "sweep" if sweeping else "run"
    words = [right if rng.random() < 0.97 else ("run" if sweeping else "sweep"), "run.toml"]
    if words[0] == "run" and rng.random() < 0.97:
        words.append("--no-figure")
    if words[0] == "sweep":
        words += ["--workers", "0"]
    words += [flag for flag, share in (("--overwrite", 0.5), ("--json", 0.2)) if rng.random() < share]
    return words


def maybe(good: Any, rng: random.Random, share: float = ODD) -> Any:
    """A good value, or one that is odd."""
    if rng.random() >= share:
        return good
    if isinstance(good, list | float) and rng.random() < 0.5:
        return scaled(good, rng)
    return plain(rng)


def configuration(rng: random.Random, folder: Path, sweeping: bool) -> dict[str, Any]:
    """Sections and their keys."""
    from kreisel.system import REGISTRY

    names = list(REGISTRY)
    name = rng.choice(["lagrange-top"] * 40 + ["clebsch"] * 10 + names)  # others need a second to compile
    system = REGISTRY[name]
    n = dimension(system, rng)
    lanes = rng.choice([0, 0, 0, 0, 0, 2]) if not sweeping else 0
    table: dict[str, Any] = {"name": maybe(name, rng, 0.02)}
    table |= {k: maybe(v, rng) for k, v in parameters(system, n, rng).items()}
    start = {k: maybe(v, rng) for k, v in state_of(system, n, rng, lanes).items()}
    if rng.random() < 0.15:
        start["orientation"] = maybe(orientation(n, rng), rng, 0.4)
    data = {"system": table, "state": start, "run": settings(rng), "output": output(rng, folder)}
    if sweeping:
        if rng.random() < 0.9:
            data["output"].pop("figure", None)
        data["sweep"] = sweep(data, rng)
    for section in list(data):
        if rng.random() < 0.015:
            del data[section]
        elif rng.random() < 0.02:
            data[section][rng.choice(["x", "p", "stps", "größe", *TEXTS])] = plain(rng)
        elif rng.random() < 0.01:
            data[section] = plain(rng)
        elif data[section] and rng.random() < 0.04:
            del data[section][rng.choice(list(data[section]))]
    if rng.random() < 0.02:
        data[rng.choice(["sytem", "sweep", "Run", *TEXTS[:4]])] = rng.choice([{}, {"a": 1}, 3])
    return data


def settings(rng: random.Random) -> dict[str, Any]:
    """[run]: at most some hundred possible steps."""
    steps = rng.choice([1, 5, 20, 40, 100])
    out = {"dt": maybe(rng.choice([0.05, 0.1, 0.02]), rng), "steps": never_long(maybe(steps, rng))}
    if rng.random() < 0.6:
        out["every"] = maybe(rng.choice([1, 2, 3, 7]), rng)
    if rng.random() < 0.3:
        out["method"] = maybe(rng.choice(METHODS), rng)
    if rng.random() < 0.2:
        out["order"] = maybe(rng.choice([1, 2, 2, 4, 6]), rng)
    if rng.random() < 0.06:
        out |= {"order": "auto", "tol": maybe(rng.choice([1e-3, 1e-6, 1e-9]), rng, 0.3)}
    if rng.random() < 0.06:
        out["tol"] = maybe(1e-6, rng)
    if rng.random() < 0.06:
        out["engine"] = maybe(rng.choice(ENGINES), rng)
    return out


def output(rng: random.Random, folder: Path) -> dict[str, Any]:
    """[output]: a good name, or one with another meaning."""
    share = rng.random()
    path: Any = rng.choice(NAMES) if share < 0.75 else rng.choice(IN_THE_WAY)
    path = plain(rng) if share > 0.97 else path.replace("{case}", folder.name)
    if isinstance(path, str) and path.startswith("/dev") and Path("/dev/tty").exists():
        path = "run.zarr"  # these are the machine's devices
    out = {"path": path}
    if rng.random() < 0.05:
        out["figure"] = maybe(rng.choice(["f.png", "f.pdf", "thesis", "data.csv", "pipe", "link.csv", "f.exe"]), rng)
    return out


def sweep(data: dict[str, Any], rng: random.Random) -> dict[str, Any]:
    """[sweep]: grid, list and random over parameters, states and settings."""
    names = [f"{s}.{k}" for s in ("system", "state", "run") for k in data[s] if k != "name"]
    names += ["state.m[2]", "system.p[0]", "state.a[7]", "run.dt", "system.none", "state.orientation", "x", *TEXTS[:3]]
    good = [k for k in names if k.split(".")[-1] in ("alpha", "dt", "gamma", "nu", "every", "steps")] or ["run.dt"]
    out: dict[str, Any] = {}
    for _ in range(rng.choice([1, 1, 2])):
        name = rng.choice(good) if rng.random() < 0.7 else rng.choice(names)
        kind = rng.choice(["grid", "list", "random"])
        if kind == "random" and name.startswith("run.") and rng.random() < 0.9:
            kind = "grid"
        values: Any = [round(rng.uniform(0.05, 0.3), 3) for _ in range(rng.choice([1, 2, 3]))]
        if name in ("run.steps", "run.every"):
            values = [rng.choice([1, 2, 5]) for _ in values]
        if kind == "grid" and rng.random() < 0.4:
            values = {"from": 0.1, "to": 0.3, "count": maybe(rng.choice([2, 3]), rng)}
        if kind == "random":
            law = rng.choice(["uniform", "loguniform", "normal", "normal", "sphere"])
            values = {law: maybe(1.0 if law == "sphere" else [0.1, 0.4], rng)}
        values = maybe(values, rng)
        if name in ("run.steps", "run.every"):
            values = [never_long(v) for v in values] if isinstance(values, list) else never_long(values)
        out.setdefault(kind, {})[name] = values
    if "random" in out or rng.random() < 0.03:
        out |= {"draws": maybe(rng.choice([1, 2, 3]), rng, 0.05), "rng": maybe(1, rng)}
    if rng.random() < 0.3:
        out["save"] = maybe([rng.choice(["drift", "drift", "extremes", "trajectories", "frequencies"])], rng)
    if rng.random() < 0.3:
        out["block"] = maybe(rng.choice([1, 2, 100]), rng)
    if isinstance(out.get("draws"), int) and 100 < out["draws"] < 10**9:
        out["draws"] = 3
    return out


def rendered(data: dict[str, Any], rng: random.Random) -> str:
    """TOML, its sections in any order."""
    lines: list[str] = []
    sections = list(data.items())
    rng.shuffle(sections)
    tops = [(k, v) for k, v in sections if not isinstance(v, dict)]
    for name, value in tops:
        lines.append(f"{key(name)} = {toml(value)}")
    for name, table in sections:
        if not isinstance(table, dict):
            continue
        lines.append(f"[{key(name)}]")
        later = []
        for k, v in table.items():
            if isinstance(v, dict) and name == "sweep" and rng.random() < 0.7:
                later.append((k, v))
            else:
                lines.append(f"{key(k)} = {toml(v)}" + rng.choice(["", "", "  # so"]))
        for k, v in later:
            lines += [f"[{key(name)}.{key(k)}]", *(f"{key(a)} = {toml(b)}" for a, b in v.items())]
    if rng.random() < 0.01:
        lines.insert(
            rng.randrange(len(lines) + 1), rng.choice(["[run]", "= 3", "[[run]]", "x", "a.b.c = 1", '"', "[" * 2000])
        )
    return "\n".join(lines) + "\n"


def odd_words(rng: random.Random, folder: Path) -> list[str]:
    """Other commands with good and odd arguments."""
    store = folder / "old.zarr"
    if not store.exists():
        shutil.copytree(folder.parent.parent / "stores" / "true" / "single.zarr", store)
    things = ["old.zarr"] * 6 + [
        "none.zarr",
        "thesis",
        "data.csv",
        "pipe",
        "link",
        "link.csv",
        "",
        ".",
        "..",
        "~",
        "x" * 300,
    ]
    what = rng.choice(things)
    outs = [
        "out.nc",
        "out.parquet",
        "out.h5",
        "out.txt",
        "thesis",
        "data.csv",
        "pipe",
        "link.csv",
        "link",
        "",
        ".",
        "deep/x.nc",
    ]
    out = rng.choice(outs)
    some = [w for w in (["--overwrite"], ["--json"], ["--nothing"], ["--lane", "7"]) if rng.random() < 0.1 for w in w]
    figures = ["f.png", "f.html", "f.svg", *outs]
    commands: list[list[str]] = [
        ["check", what],
        ["check", what, "--recover", rng.choice(["new.zarr", *IN_THE_WAY[:8]])],
        ["plot", what, "--out", rng.choice(figures)],
        ["view", what, "--out", rng.choice(figures)],
        ["view", what, "--lane", rng.choice(["0", "-1", "9999", "x", "1e3", "9" * 30]), "--out", "f.html"],
        ["export", what, out],
        ["export", what, out, "--overwrite"],
        ["resume", what],
        ["resume", what, "--extend", rng.choice(["90", "0", "-1", "x", "1e3", "9" * 30, "9" * 5000, "86", "nan"])],
        ["systems", rng.choice(["lagrange-top", "clebsch", "lagrangetop", "", *TEXTS]).replace("\x00", "") or "x"],
        ["verify", "--list"],
        ["run", what.replace("pipe", "data.csv")],  # of a FIFO they wait for what is written, as all programs do
        ["sweep", what.replace("pipe", "data.csv"), "--workers", rng.choice(["0", "-1", "x", "9" * 30])],
        ["investigate", rng.choice(["none", "data.csv", "x.py", ""]), "--eps", rng.choice(["x", "0", "1/0"])],
        ["investigate", "clebsch", "--set", rng.choice(["b=1,2", "b=x", "=", "b=1,1,1", "c=3", "b=1/0,1,2"])],
        [rng.choice(["runn", "", "--help", "--version", "-x", *TEXTS[:5]])],
        [],
    ]  # fmt: skip
    words = [*rng.choice(commands), *some]
    note(repr(words)[:500])
    return words or ["--help"]


__all__ = ["case", "odd"]
