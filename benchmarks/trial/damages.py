"""Damages of every kind to an archive: (store, another store, rng) -> a description, or "" if it does not apply."""

from __future__ import annotations

import json
import os
import random
import re
import shutil
import stat
from collections.abc import Callable
from pathlib import Path
from typing import Any

MOSTLY_CHUNKS = 7  # of ten


def chunks(store: Path) -> list[Path]:
    """Files that hold values."""
    return sorted(p for p in store.rglob("*") if p.is_file() and "c" in p.relative_to(store).parts)


def _any(store: Path, rng: random.Random) -> Path:
    """A chunk most of the time, else any file but those that hold nothing that counts."""
    if rng.randrange(10) < MOSTLY_CHUNKS:
        return rng.choice(chunks(store))
    return rng.choice(sorted(p for p in store.rglob("*") if p.is_file()))


def _named(store: Path, path: Path) -> str:
    return path.relative_to(store).as_posix()


def flip(store: Path, other: Path, rng: random.Random) -> str:
    """A bit turned over."""
    path = _any(store, rng)
    data = bytearray(path.read_bytes())
    if not data:
        return ""
    data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    path.write_bytes(bytes(data))
    return _named(store, path)


def cut(store: Path, other: Path, rng: random.Random) -> str:
    """The end lost."""
    path = _any(store, rng)
    data = path.read_bytes()
    path.write_bytes(data[: rng.choice([0, 1, len(data) // 2, len(data) - 1])])
    return _named(store, path)


def grown(store: Path, other: Path, rng: random.Random) -> str:
    """Bytes added."""
    path = _any(store, rng)
    path.write_bytes(path.read_bytes() + rng.choice([b"\0", b"x" * 100, path.read_bytes()]))
    return _named(store, path)


def zeroed(store: Path, other: Path, rng: random.Random) -> str:
    """Zeros in the place of a file, or of a part of it."""
    path = _any(store, rng)
    data = bytearray(path.read_bytes())
    first = rng.randrange(len(data)) if data and rng.random() < 0.5 else 0
    data[first:] = bytes(len(data) - first)
    path.write_bytes(bytes(data))
    return _named(store, path)


def deleted(store: Path, other: Path, rng: random.Random) -> str:
    """A file gone."""
    path = _any(store, rng)
    path.unlink()
    return _named(store, path)


def time_deleted(store: Path, other: Path, rng: random.Random) -> str:
    """The times gone."""
    places = [p for p in chunks(store) if _named(store, p).startswith("time/")]
    if not places:
        return ""
    path = rng.choice(places)
    path.unlink()
    return _named(store, path)


def array_deleted(store: Path, other: Path, rng: random.Random) -> str:
    """A variable gone."""
    path = rng.choice(sorted(p.parent for p in store.glob("*/zarr.json")))
    shutil.rmtree(path)
    return _named(store, path)


def _swap(one: Path, two: Path) -> None:
    first = one.read_bytes()
    one.write_bytes(two.read_bytes())
    two.write_bytes(first)


def chunks_swapped(store: Path, other: Path, rng: random.Random) -> str:
    """Two chunks of one variable in each other's place."""
    path = rng.choice(chunks(store))
    same = [p for p in chunks(store) if p.relative_to(store).parts[0] == path.relative_to(store).parts[0] and p != path]
    if not same:
        return ""
    second = rng.choice(same)
    _swap(path, second)
    return f"{_named(store, path)} and {_named(store, second)}"


def orientations_swapped(store: Path, other: Path, rng: random.Random) -> str:
    """Two chunks of the orientation."""
    places = [p for p in chunks(store) if _named(store, p).startswith("g/")]
    if len(places) < 2:
        return ""
    one, two = rng.sample(places, 2)
    _swap(one, two)
    return f"{_named(store, one)} and {_named(store, two)}"


def duplicated(store: Path, other: Path, rng: random.Random) -> str:
    """A chunk in the place of another one."""
    one, two = rng.sample(chunks(store), 2)
    shutil.copyfile(one, two)
    return f"{_named(store, one)} in {_named(store, two)}"


def variables_swapped(store: Path, other: Path, rng: random.Random) -> str:
    """Two variables in each other's place, with their metadata or without."""
    one, two = rng.sample(sorted(p.parent for p in store.glob("*/zarr.json") if (p.parent / "c").exists()), 2)
    part = rng.choice(["", "c"])
    scratch = store.parent / "scratch"
    (one / part).rename(scratch)
    (two / part).rename(one / part)
    scratch.rename(two / part)
    return f"{one.name} and {two.name}, {part or 'whole'}"


def transplanted(store: Path, other: Path, rng: random.Random) -> str:
    """A chunk, a variable, or all values of another archive with the same shapes."""
    names = sorted(p.name for p in store.iterdir() if (p / "c").is_dir())
    kind = rng.choice(["chunk", "variable", "row", "all"])
    if kind == "chunk":
        path = rng.choice(chunks(store))
        where = [path.relative_to(store)]
    elif kind == "row":  # the same rows of every variable
        where = [p.relative_to(store) for p in chunks(store) if p.relative_to(store).parts[2:3] == ("1",)]
    else:
        chosen = [rng.choice(names)] if kind == "variable" else names
        where = [p.relative_to(store) for p in chunks(store) if p.relative_to(store).parts[0] in chosen]
    for place in where:
        if (other / place).is_file():
            shutil.copyfile(other / place, store / place)
    return f"{kind} {where[0] if where else ''}"


def array_added(store: Path, other: Path, rng: random.Random) -> str:
    """A variable that the run has not."""
    path = rng.choice(sorted(p.parent for p in store.glob("*/zarr.json") if (p.parent / "c").exists()))
    new = path.with_name(rng.choice(["added", "energy2", f"{path.name}_copy"]))
    shutil.copytree(path, new)
    return new.name


def file_added(store: Path, other: Path, rng: random.Random) -> str:
    """A file that no array has."""
    names = ["more", "c", "zarr.json.bak", ".hidden", "engine/more", "time/c/99", "energy/c/0/0/0", "a/c/99/0"]
    path = store / rng.choice(names)
    if path.exists() or any(p.is_file() for p in path.parents):
        return ""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(rng.randbytes(50))
    return _named(store, path)


def attributes_edited(store: Path, other: Path, rng: random.Random) -> str:
    """A value among the attributes, or the shape, type or codec of an array."""
    path = rng.choice(sorted(store.rglob("zarr.json")))
    contents = json.loads(path.read_text(encoding="utf-8"))
    places: list[tuple[Any, Any]] = []

    def look(at: Any) -> None:
        for key, value in at.items() if isinstance(at, dict) else enumerate(at):
            if isinstance(value, dict | list) and value:
                look(value)
            else:
                places.append((at, key))

    look({k: v for k, v in contents.items() if k != "consolidated_metadata"})
    if not places:
        return ""
    at, key = rng.choice(places)
    before = at[key]
    at[key] = _edited(before, rng)
    path.write_text(json.dumps(contents), encoding="utf-8")
    return f"{_named(store, path)}: {key} from {before!r} to {at[key]!r}"[:300] if at[key] != before else ""


def _edited(value: Any, rng: random.Random) -> Any:
    if isinstance(value, bool):
        return not value
    if isinstance(value, int):
        return rng.choice([value + 1, value - 1, 2 * value, -value, 10**18, float(value), str(value)])
    if isinstance(value, float):
        return rng.choice([value * (1 + 1e-9), -value, 2 * value, 0.0, 1e300])
    if isinstance(value, str):
        options = [value + " ", value.upper(), "", "\x1b[31m" + value, value[:-1], "../../x"]
        number = re.search(r"\d", value)
        if number:
            digit = str((int(number[0]) + 1) % 10)
            options += 3 * [value[: number.start()] + digit + value[number.end() :]]
        return rng.choice(options)
    return rng.choice([0, "x", [], {}])


def checksums_edited(store: Path, other: Path, rng: random.Random) -> str:
    """Damage to the files that list the other files."""
    places = sorted(p for p in (store / "engine").rglob("*.sha256") if p.is_file())
    if not places:
        return ""
    path = rng.choice(places)
    text = path.read_text(encoding="utf-8", errors="replace")
    digits = [m.start() for m in re.finditer(r"[0-9a-f]", text)]
    kind = rng.choice(["digit", "digit", "empty", "list", "gone", "other", "line"])
    if kind == "gone":
        path.unlink()
    elif kind == "other" and (other / _named(store, path)).is_file():
        shutil.copyfile(other / _named(store, path), path)
    elif kind == "line" and "\n" in text:
        lines = text.split("\n")
        del lines[rng.randrange(len(lines))]
        path.write_text("\n".join(lines), encoding="utf-8")
    elif kind == "digit" and digits:
        at = rng.choice(digits)
        path.write_text(text[:at] + ("1" if text[at] != "1" else "2") + text[at + 1 :], encoding="utf-8")
    else:
        path.write_text({"list": "[]"}.get(kind, ""), encoding="utf-8")
    return f"{_named(store, path)} {kind}"


def _replaced(kind: str) -> Callable[[Path, Path, random.Random], str]:
    def damage(store: Path, other: Path, rng: random.Random) -> str:
        path = _any(store, rng)
        if kind in ("device", "folder", "fifo", "socket", "link"):
            path.unlink()
        if kind == "folder":
            path.mkdir()
        elif kind == "fifo":
            os.mkfifo(path)
        elif kind == "link":
            path.symlink_to(
                rng.choice([other / path.relative_to(store), store.parent.parent.parent / "sentinel", path])
            )
        elif kind == "socket":
            os.mknod(path, 0o600 | stat.S_IFSOCK)
        elif kind == "device":
            if os.geteuid() or Path("/dev/full").stat().st_rdev != os.makedev(1, 7) or Path("/dev/tty").exists():
                return ""  # no private devices here
            os.mknod(path, 0o666 | stat.S_IFCHR, os.makedev(1, rng.choice([3, 5, 7, 9])))
        return _named(store, path)

    return damage


DAMAGES: dict[str, Callable[[Path, Path, random.Random], str]] = {
    "bit flipped": flip,
    "truncated": cut,
    "lengthened": grown,
    "zeroed": zeroed,
    "file deleted": deleted,
    "times deleted": time_deleted,
    "variable deleted": array_deleted,
    "chunks swapped": chunks_swapped,
    "orientations swapped": orientations_swapped,
    "chunk duplicated": duplicated,
    "variables swapped": variables_swapped,
    "transplanted": transplanted,
    "array added": array_added,
    "file added": file_added,
    "attributes edited": attributes_edited,
    "checksums edited": checksums_edited,
    **{f"{kind} in a place": _replaced(kind) for kind in ("folder", "fifo", "link", "socket", "device")},
}
