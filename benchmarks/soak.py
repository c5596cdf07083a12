"""The long faults: kills, fuzzed input, a sweep of a million lanes that loses a worker, memory over 10^9 steps.

python benchmarks/soak.py [--part NAME ...] [--share 1.0] [--again]      writes benchmarks/results/soak.json

The result has the request of each part, its work, the seconds and whether it passed; the other parts
stay unchanged.  `--share 0.1` asks for a tenth of the cases, and the result states this.  Fuzzing goes in slices, and
the result states after each how many cases are done; it has passed when all have.  `--again` resumes such a
result: the slices that failed, and those that are missing.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
RESULT = HERE / "results" / "soak.json"
LONGEST = 4 * 3600  # seconds of one process
LANES, BLOCKS_BEFORE_THE_KILL, SLICES = 10**6, 20, 20
SWEEP = """
[system]
name = "lagrange-top"
p = [0.0, 0.0, 1.0]
[state]
m = [0.0, 0.0, 2.0]
a = [0.6, 0.0, 0.8]
[run]
dt = 0.05
steps = 100
every = 10
[sweep]
rng = 1
draws = {lanes}
[sweep.random]
system.alpha = {{ uniform = [0.2, 1.8] }}
state.a = {{ sphere = 1.0 }}
[output]
path = "sweep.zarr"
"""


def tests(files: str, chosen: str, **counts: int) -> dict[str, Any]:
    """Tests with larger counts in their environment."""
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *files.split(), "-k", chosen]
    env = {**os.environ, "KREISEL_FULL": "1", **{k: str(v) for k, v in counts.items()}}
    done = subprocess.run(
        command, cwd=HERE.parent, env=env, capture_output=True, text=True, check=False, timeout=LONGEST
    )
    last = done.stdout.strip().splitlines()[-1] if done.stdout.strip() else done.stderr[-200:]
    if done.returncode:
        errors = [line for line in done.stdout.splitlines() if line.startswith("E  ")]
        print("\n".join(errors[:20]) or done.stdout[-6000:], file=sys.stderr)
    return {"passed": done.returncode == 0, "pytest": last.strip("= "), **{k.lower(): v for k, v in counts.items()}}


def fuzzed(chosen: str, name: str, count: int, before: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """Cases of tests/cli/test_fuzz.py in slices, each in a separate process; the state after each.

    With an earlier result, only its failed and its missing slices.
    """
    width = max(1, -(-count // SLICES))
    done, failed = (before["done"], before["failed_slices"]) if before.get("asked") == count else (0, [])
    for first in [*(first for first, _ in failed), *range(done, count, width)]:
        stop = min(first + width, count)
        found = tests("tests/cli/test_fuzz.py", chosen, **{name: stop - first, "KREISEL_FUZZ_FIRST": first})
        failed = [f for f in failed if f[0] != first] + ([] if found["passed"] else [[first, stop]])
        done = max(done, stop)
        passed = done == count and not failed
        yield {"passed": passed, "asked": count, "done": done, "failed_slices": failed, "pytest": found["pytest"]}


def million(share: float) -> dict[str, Any]:
    """A sweep on two local workers, one of them killed on the way; the same without faults on one worker."""
    lanes = max(1000, int(LANES * share))
    with tempfile.TemporaryDirectory() as name:
        folders = [Path(name) / "killed", Path(name) / "whole"]
        found = []
        for folder, workers in zip(folders, (2, 1), strict=True):
            folder.mkdir()
            (folder / "sweep.toml").write_text(SWEEP.format(lanes=lanes), encoding="utf-8")
            command = [sys.executable, "-m", "kreisel", "sweep", "sweep.toml", "--json", "--workers", str(workers)]
            client = subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
            killed = workers == 2 and kill_a_worker(client, folder)
            out, err = client.communicate(timeout=LONGEST)
            if client.returncode:
                return {"passed": False, "error": err[-500:]}
            found.append({**json.loads(out), "workers": workers, "killed": bool(killed)})
        same = contents(folders[0] / "sweep.zarr") == contents(folders[1] / "sweep.zarr")
        size = sum(p.stat().st_size for p in (folders[0] / "sweep.zarr").rglob("*") if p.is_file())
    keys = ("workers", "killed", "lanes", "failed", "blocks", "seconds", "memory_MiB")
    runs = [{k: t[k] for k in keys} for t in found]
    passed = same and runs[0]["killed"] and not runs[0]["failed"]
    return {"passed": passed, "same_bytes": same, "store_MB": round(size / 1e6), "runs": runs}


def kill_a_worker(client: subprocess.Popen[str], folder: Path) -> int:
    """Kill one of the two workers with SIGKILL after some blocks; its process id."""
    done = folder / "sweep.zarr.part" / "failed" / "c"
    while client.poll() is None and (not done.exists() or len(os.listdir(done)) < BLOCKS_BEFORE_THE_KILL):
        time.sleep(0.05)
    for place in Path("/proc").iterdir():
        try:
            parent = int((place / "stat").read_text().rsplit(")", 1)[1].split()[1])
            if parent == client.pid and b"spawn_main" in (place / "cmdline").read_bytes():
                os.kill(int(place.name), signal.SIGKILL)
                return int(place.name)
        except (OSError, IndexError, ValueError):
            continue
    return 0


def contents(store: Path) -> dict[str, Any]:
    """Every file of a store; without the time of its creation, and the hash of that."""
    out: dict[str, Any] = {}
    for path in sorted(p for p in store.rglob("*") if p.is_file()):
        name = path.relative_to(store).as_posix()
        out[name] = path.read_bytes()
        if name == "zarr.json":
            found = json.loads(path.read_text())
            found["attributes"].pop("created")
            out[name] = found
        elif name == "engine/checksums.sha256":
            out[name] = [line for line in path.read_text().splitlines() if not line.endswith("  zarr.json")]
    return out


def memory(share: float) -> dict[str, Any]:
    """benchmarks/memory.py: the memory of a run at each tenth of its way."""
    command = [sys.executable, str(HERE / "memory.py"), str(int(10**9 * share))]
    done = subprocess.run(command, check=False, timeout=LONGEST, stdout=subprocess.PIPE, text=True)
    result = json.loads(done.stdout[: done.stdout.rindex("}") + 1]) if done.returncode == 0 else {}
    return {"passed": bool(result) and result["growth_MiB"] < 32, **result}


FUZZED = {
    "fuzzed configurations": ("mutated or anything", "KREISEL_FUZZ", 67_000),
    "fuzzed archives": ("archives", "KREISEL_FUZZ_ARCHIVES", 10_000),
}  # of the configurations half as many again come from Hypothesis: 10^5 together
RESUME, SWEEP = "tests/storage/test_resume.py", "tests/sweeps/test_sweep.py"
PARTS: dict[str, Callable[[float], dict[str, Any]]] = {
    "kills of a run": lambda share: tests(RESUME, "killed", KREISEL_KILLS=int(200 * share)),
    "kills of a sweep": lambda share: tests(SWEEP, "killed_at_random", KREISEL_KILLS=int(200 * share)),
    "killed schedulers and workers": lambda share: tests(SWEEP, "scheduler or two_workers or own"),
    "faults": lambda share: tests("tests/storage/test_faults.py", ""),
    "a million lanes": million,
    "memory": memory,
}


def known() -> dict[str, Any]:
    """The results so far."""
    return dict(json.loads(RESULT.read_text(encoding="utf-8"))) if RESULT.exists() else {}


def note(name: str, found: dict[str, Any]) -> None:
    """Write the result of a part, next to the other ones."""
    when = datetime.now(UTC).isoformat(timespec="seconds")
    made = {"kreisel": version("kreisel"), "python": platform.python_version(), "cores": os.cpu_count()}
    result = known()
    result[name] = {**found, "when": when, **made}
    RESULT.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    print(f"{name}: {json.dumps(result[name])}", flush=True)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--part", action="append", choices=[*PARTS, *FUZZED])
    parser.add_argument("--again", action="store_true")
    parser.add_argument("--share", type=float, default=1.0)
    asked = parser.parse_args()
    good = True
    for name in asked.part or [*PARTS, *FUZZED]:
        begun, before = time.perf_counter(), known().get(name, {}) if asked.again else {}
        found = {"passed": before.get("passed", False)}
        if name in FUZZED:
            chosen, count, most = FUZZED[name]
            steps = fuzzed(chosen, count, int(most * asked.share), before)
        else:
            steps = (PARTS[name](asked.share) for _ in range(1))
        for found in steps:
            seconds = round(before.get("seconds", 0) + time.perf_counter() - begun, 1)
            note(name, {"share": asked.share, **found, "seconds": seconds})
        good = good and found["passed"]
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
