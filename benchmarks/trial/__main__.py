"""A hard trial: kills, corruptions, configurations and calls, in a separate place.

    python benchmarks/trial [--minutes 30] [--workers 2] [--seed 1] [--part NAME ...] [--case N] [--out FILE]

Writes benchmarks/results/trial.json, and its table on docs/promises.md, where all parts were asked for; prints a table,
and ends with 1 if anything did not hold.  --minutes scales the counts and the time of every part.  --part NAME --case N
repeats one case of a seed.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import subprocess
import sys
import tempfile
import time
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent))

import sandbox
import telling

RESULT = Path(__file__).parents[1] / "results" / "trial.json"
PAGE = Path(__file__).parents[2] / "docs" / "promises.md"
FULL = 30.0  # minutes
CASES = 0.94  # of the time; the remainder is for the preparation of the parts
PACKAGES = ("kreisel", "numpy", "scipy", "llvmlite", "xarray", "zarr", "jax", "distributed")


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python benchmarks/trial", description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, default=FULL)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--part", action="append")
    parser.add_argument("--case", type=int)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--inside", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--private", action="store_true", help=argparse.SUPPRESS)
    return parser.parse_args()


def inside(asked: argparse.Namespace) -> int:
    """The parts, in the namespace; the result goes to stdout."""
    place = sandbox.enter(asked.inside, asked.private)
    sandbox.sentinel(asked.inside)
    import parts
    import pool

    chosen = [part for part in parts.PARTS if not asked.part or part.name in asked.part]
    if asked.case is not None:
        part = chosen[0]
        part.before(asked.inside)
        part.warm(asked.inside)
        folder = asked.inside / "cases" / str(asked.case)
        print(json.dumps(pool.carried_out(part, asked.case, asked.seed, folder), indent=1))
        return 0
    scale, found, spare = asked.minutes / FULL, {}, 0.0
    for part in chosen:
        count = max(1, round(part.count * scale))
        seconds = spare + 60 * asked.minutes * (CASES * part.share if not asked.part else 1)
        got = pool.carry_out(part, count, seconds, asked.seed, asked.inside, asked.workers)
        spare = max(0.0, seconds - got.seconds) if not asked.part else 0.0  # for the next part
        outcomes = dict(sorted(got.outcomes.items()))
        slow = ", ".join(f"{name} {seconds:.0f} s" for name, seconds in got.slow.most_common(6))
        print(f"{part.name}: {slow}", file=sys.stderr, flush=True)
        found[part.name] = {"asked": count, "done": got.done, "do_not_hold": got.failed, "seconds": got.seconds}
        found[part.name] |= {"outcomes": outcomes, "faults": got.faults}
        print(
            f"{part.name}: {json.dumps({**found[part.name], 'faults': len(got.faults)})}", file=sys.stderr, flush=True
        )
    print(json.dumps({"place": place, "parts": found}))
    return 0


def machine() -> dict[str, Any]:
    names = [line.split(":")[1].strip() for line in _lines("/proc/cpuinfo") if line.startswith("model name")]
    return {
        "processor": names[0] if names else platform.processor(),
        "cores": os.cpu_count(),
        "system": platform.platform(),
    }


def _lines(path: str) -> list[str]:
    try:
        return Path(path).read_text(encoding="utf-8").splitlines()
    except OSError:
        return []


def main() -> int:
    asked = arguments()
    if asked.inside:
        return inside(asked)
    begun = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="kreisel-trial-") as folder:
        words = [sys.executable, str(Path(__file__).parent), *sys.argv[1:], "--inside", folder]
        done = subprocess.run(sandbox.command(words), stdout=subprocess.PIPE, text=True, check=False)
    if done.returncode or asked.case is not None:
        print(done.stdout, end="")
        return done.returncode
    answer = json.loads(done.stdout)
    result = {
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "seed": asked.seed,
        "minutes": asked.minutes,
        "seconds": round(time.monotonic() - begun, 1),
        "workers": asked.workers,
        "as_root": os.geteuid() == 0,
        "machine": machine(),
        "versions": {"python": platform.python_version(), **{name: version(name) for name in PACKAGES}},
        **answer,
    }
    out = asked.out or (None if asked.part else RESULT)
    if out is not None:
        out.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    if out == RESULT:
        PAGE.write_text(telling.entered(PAGE.read_text(encoding="utf-8"), result), encoding="utf-8")
    print(f"{telling.text(answer['parts'])}\nin {answer['place']}")
    return int(any(part["do_not_hold"] for part in answer["parts"].values()))


if __name__ == "__main__":
    sys.exit(main())
