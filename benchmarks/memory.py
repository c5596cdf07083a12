"""Memory of `kreisel run` over 10^9 steps with every = 1000, at each tenth of its way; archive, drift table and figure.

python benchmarks/memory.py [STEPS]      writes benchmarks/results/memory.json for 10^9 steps, else only prints
"""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from cases import RESULTS, write

HERE = Path(__file__).parent
STEPS = 10**9  # of the committed results


def resident(process: int) -> float:
    """MiB of a process, 0 once it is gone."""
    try:
        pages = int(Path(f"/proc/{process}/statm").read_text().split()[1])
    except (OSError, IndexError):
        return 0.0
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20


def main() -> None:
    steps = int(float(sys.argv[1])) if len(sys.argv) > 1 else STEPS
    text = (HERE.parent / "examples" / "lagrange-top.toml").read_text(encoding="utf-8")
    text = text.replace("steps = 1_000_000", f"steps = {steps}").replace(
        "every = 2", f"every = {max(1, steps // 10**6)}"
    )
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "run.toml").write_text(text, encoding="utf-8")
        command = [sys.executable, "-c", "from kreisel.cli import main; main()", "run", "run.toml", "--json"]
        run = subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, text=True)
        part, whole = Path(folder) / "lagrange-top.zarr.part", Path(folder) / "lagrange-top.zarr"
        seen = []  # (blocks that are there, MiB) while the run steps
        while run.poll() is None and not whole.exists():
            try:
                seen.append((len(os.listdir(part / "time" / "c")), resident(run.pid)))
            except FileNotFoundError:
                pass
            time.sleep(0.02)
        out, _ = run.communicate()
        if run.returncode:
            sys.exit(run.returncode)
        said = json.loads(out)
        disk = sum(p.stat().st_size for p in whole.rglob("*") if p.is_file())
    peak = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024
    worst = max(row["ulps"] for row in said["drift"] if row["conserved"])
    blocks = max(there for there, _ in seen)
    tenths = [max((mib for there, mib in seen if there <= blocks * k / 10), default=0.0) for k in range(1, 11)]
    result = {
        "steps": said["steps"],
        "rows": said["rows"],
        "MiB_until_each_tenth": [round(mib) for mib in tenths],
        "growth_MiB": round(tenths[-1] - tenths[1]),
        "peak_memory_MiB": round(peak),
        "archive_MB": round(disk / 1e6),
        "worst_ulps": round(worst, 3),
    }
    print(json.dumps(result, indent=1))
    if steps == STEPS:
        write(result, RESULTS / "memory.json")


if __name__ == "__main__":
    main()
