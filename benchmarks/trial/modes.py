"""Archives some of whose files or folders may not be read or written, by somebody for whom modes count.

Whatever is done gives the true values or one message; and once the modes are back, all is as it would have been.
"""

from __future__ import annotations

import os
import random
import shutil
import stat
from pathlib import Path

import corruptions
import numpy as np
import sandbox
import stores
from forks import apart
from pool import note
from speaking import said

MODES = (0o000, 0o200, 0o400, 0o444, 0o100, 0o555, 0o333)


def case(rng: random.Random, folder: Path) -> str:
    """One archive, with some modes changed."""
    base = folder.parent.parent
    path = rng.choice(sorted((base / "stores" / "true").iterdir()))
    shutil.copytree(path, folder / path.name)
    whole = base / "stores" / "whole.zarr"
    places = [folder / path.name, *sorted((folder / path.name).rglob("*"))]
    chosen = rng.sample(places, rng.choice([1, 1, 3]))
    modes = [rng.choice(MODES) for _ in chosen]
    note(f"{path.name}: {', '.join(f'{p.relative_to(folder)} {m:o}' for p, m in zip(chosen, modes, strict=True))}")
    before = {str(p): stat.S_IMODE(p.stat().st_mode) for p in chosen}
    for place, mode in zip(chosen, modes, strict=True):
        place.chmod(mode)
    truth = base / "stores" / f"{path.name}.npz"
    wrong = apart(_judged, str(folder), path.name, str(truth), before, str(whole))
    if wrong:
        raise AssertionError("; ".join(wrong))
    return "a folder" if any(p.is_dir() for p in chosen) else "a file"


def _judged(folder: str, name: str, truth: str, before: dict[str, int], whole: str) -> list[str]:
    os.chdir(folder)
    with np.load(truth) as file:  # before the privileges go
        known = dict(file)
    aim = stores.contents(Path(whole))
    sandbox.drop()
    stores.settle()
    import kreisel as kr

    path, wrong = Path(folder) / name, []
    begun = path.suffix == ".part"
    for words in (["check", name], ["plot", name, "--out", "f.png"], ["export", name, "f.nc"]):
        code, out, err = said(words)
        if code not in (0, 1, 2) or "Traceback" in out + err or (code == 2 and not err.startswith("kreisel: ")):
            wrong.append(f"{words[0]} ends with {code}: {err[-200:]!r}")
    try:
        found = stores.values(path)
    except (kr.InputError, kr.RunError):
        pass
    except Exception as error:
        wrong.append(f"open_run(...).load() raises {type(error).__name__}: {str(error)[:200]}")
    else:
        wrong += corruptions.compared(found, known)
    if begun:
        wrong += _resumed(path, before, aim)
    return wrong


def _resumed(path: Path, before: dict[str, int], aim: dict[str, str]) -> list[str]:
    """Whether it resumes, at once or with the previous modes, to the right bytes."""
    import kreisel as kr

    done = path.with_suffix("")
    try:
        kr.resume(path, progress=False)
    except (kr.InputError, kr.RunError):
        pass
    except Exception as error:
        return [f"resume raises {type(error).__name__}: {str(error)[:200]}"]
    for place, mode in sorted(before.items(), key=lambda item: len(item[0])):
        for where in (Path(place), done / Path(place).relative_to(path)):
            if where.exists():
                where.chmod(mode)
    if not done.exists():
        try:
            kr.resume(path, progress=False)
        except Exception as error:
            return [f"with the modes as they were, resume raises {type(error).__name__}: {str(error)[:200]}"]
    wrong = stores.differences(stores.contents(done), aim)
    return [f"resumed, it differs in {', '.join(wrong[:5])}"] if wrong else []
