"""The house: arrows run one way, the import is light, claims in the README are what the code prints."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import kreisel as kr

SOURCE = Path(kr.__file__).parent
RANK = {
    "errors": 0,
    "algebra": 1,
    "invariants": 2,
    "contract": 3,
    "model": 4,
    "systems": 5,
    "methods": 5,
    "reduction": 5,
    "units": 4,
    "physical": 6,
    "engines": 6,
    "runs": 7,
    "lab": 8,
    "analysis": 8,
    "view": 8,
    "bench": 8,
    "cli": 9,
    "__main__": 10,
}


def imports(path: Path) -> set[str]:
    """Parts of kreisel that a module imports at its head."""
    found = set()
    for node in ast.parse(path.read_text()).body:
        if isinstance(node, ast.ImportFrom) and node.module and node.module.split(".")[0] == "kreisel":
            names = [node.module] if "." in node.module else [f"kreisel.{alias.name}" for alias in node.names]
            found |= {name.split(".")[1] for name in names}
    return found


def test_arrows_run_one_way() -> None:
    for path in SOURCE.rglob("*.py"):
        part = path.relative_to(SOURCE).parts[0].removesuffix(".py")
        if part == "__init__":
            continue
        for other in imports(path):
            assert RANK[other] <= RANK[part], f"{path.name} ({part}) imports {other}"


def test_import_is_light() -> None:
    heavy = (
        "numba",
        "xarray",
        "zarr",
        "matplotlib",
        "scipy",
        "pandas",
        "flint",
        "jax",
        "mpmath",
        "sympy",
        "plotly",
    )
    code = f"import sys, kreisel; print(*(m for m in {heavy} if m in sys.modules))"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=120).stdout
    assert out.split() == []


def test_the_first_step_waits_for_no_more_than_it_needs(tmp_path: Path) -> None:
    """`kreisel run` to disk, up to the first call of the kernel: tables and figures are imported when they are made."""
    heavy = ("xarray", "pandas", "matplotlib", "sympy", "jax", "flint", "dask", "IPython")
    text = (Path(__file__).parent.parent / "examples" / "lagrange-top.toml").read_text(encoding="utf-8")
    (tmp_path / "run.toml").write_text(text, encoding="utf-8")
    code = f"""
import os, sys
from kreisel.engines import cpu
def first(self, out, every):
    print("first step", *(m for m in {heavy} if m in sys.modules), flush=True)
    os._exit(0)
cpu.Kernel.advance = first
sys.argv = ["kreisel", "run", "run.toml"]
from kreisel.cli import main
main()
"""
    run = [sys.executable, "-c", code]
    out = subprocess.run(run, capture_output=True, text=True, check=True, cwd=tmp_path, timeout=120).stdout
    assert out.split() == ["first", "step"]


def test_every_public_name_exists() -> None:
    assert set(kr.__all__) <= set(dir(kr))
    assert all(getattr(kr, name) is not None for name in dir(kr))


def test_the_package_runs_as_the_command() -> None:
    run = [sys.executable, "-m", "kreisel", "systems"]
    out = subprocess.run(run, capture_output=True, text=True, check=True, timeout=120)
    assert "lagrange-top-moving" in out.stdout


def test_version_stands_in_one_place() -> None:
    from importlib.metadata import version

    assert kr.__version__ == version("kreisel")
