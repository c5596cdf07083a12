"""Without the modules of POSIX (Windows): runs in memory, archives and sweeps."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

HIDDEN = """
import os, sys
for name in ("fcntl", "pwd", "grp", "termios"):  # psutil for Linux needs resource
    sys.modules[name] = None
for name in ("geteuid", "pread", "pwrite", "O_DIRECTORY", "O_NOFOLLOW", "O_NONBLOCK"):
    if hasattr(os, name):
        delattr(os, name)
"""

RUNS = """
import kreisel as kr
top = kr.LagrangeTop(p=(0, 0, 1))
x0 = top.state(m=(0.1, 0.2, 1.5), a=(0.6, 0, 0.8))
run = kr.simulate(top, x0, dt=0.05, steps=200)
print(bool(kr.drift(run).query("conserved").ulps.max() < 200), kr.at(top, x0, [1.0]).sizes["time"])
from kreisel.graph.machine import cache_folder
print(cache_folder() is not None)
kr.export(run, "run.csv")
disk = kr.simulate(top, x0, dt=0.05, steps=200, path="run.zarr")
print(bool((disk.m == run.m).all()), kr.resume("run.zarr", extend=300).sizes["time"])
lanes = kr.sweep(
    top, x0, kr.Design(grid={"state.m[2]": [1, 2]}), path="sweep.zarr", dt=0.05, steps=20, workers=0, progress=False
)
print(lanes.sizes["state.m[2]"])
"""


def test_runs_without_the_modules_of_posix(tmp_path: Path) -> None:
    """The owner of the cache of kernels cannot be asked for there."""
    run = [sys.executable, "-c", HIDDEN + RUNS]
    done = subprocess.run(run, capture_output=True, text=True, cwd=tmp_path, timeout=300, check=False)
    assert done.stdout.split() == ["True", "1", "True", "True", "301", "2"], done.stderr
    assert sorted(each.name for each in tmp_path.iterdir()) == ["run.csv", "run.zarr", "sweep.zarr"]
