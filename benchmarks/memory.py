"""Peak memory of `kreisel run` over 10^9 steps with every = 1000: archive, drift table and figure.

python benchmarks/memory.py [STEPS]      writes benchmarks/results/memory.json
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

HERE = Path(__file__).parent


def main() -> None:
    steps = int(float(sys.argv[1])) if len(sys.argv) > 1 else 10**9
    text = (HERE.parent / "examples" / "lagrange-top.toml").read_text(encoding="utf-8")
    text = text.replace("steps = 1_000_000", f"steps = {steps}").replace("every = 2", f"every = {steps // 10**6}")
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "run.toml").write_text(text, encoding="utf-8")
        command = [sys.executable, "-c", "from kreisel.cli import main; main()", "run", "run.toml", "--json"]
        told = json.loads(subprocess.run(command, cwd=folder, check=True, capture_output=True, text=True).stdout)
        disk = sum(p.stat().st_size for p in (Path(folder) / "lagrange-top.zarr").rglob("*") if p.is_file())
    peak = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024
    worst = max(row["ratio"] for row in told["drift"] if row["kept"])
    result = {
        "steps": told["steps"],
        "rows": told["rows"],
        "peak_memory_MiB": round(peak),
        "archive_MB": round(disk / 1e6),
        "worst_ratio_to_roundoff": round(worst, 3),
    }
    path = HERE / "results" / "memory.json"
    path.parent.mkdir(exist_ok=True)
    path.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    print(json.dumps(result, indent=1))


if __name__ == "__main__":
    main()
