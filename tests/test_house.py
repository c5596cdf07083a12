"""The house: arrows run one way, the import is light, claims in the README are what the code prints."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from pathlib import Path

import kreisel as kr

SOURCE = Path(kr.__file__).parent
RANK = {  # a part imports what stands on its own line or above
    part: rank
    for rank, parts in enumerate(
        (
            ("errors", "display"),
            ("algebra",),
            ("record", "units"),
            ("baecklund", "implicit"),
            ("systems", "reduction"),
            ("methods", "exact"),
            ("physical", "kernels"),
            ("runs", "storage", "sweeps"),
            ("lab", "analysis", "view", "bench"),
            ("cli",),
            ("__main__",),
        )
    )
    for part in parts
}


def imports(path: Path) -> set[str]:
    """Parts of kreisel that a module imports, inside functions too."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
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
from kreisel.kernels import cpu
def first(self, *_):
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


GREEK = "alpha beta gamma delta eps zeta eta theta kappa lam mu nu xi pi rho sigma tau phi chi psi omega".split()


def capitalised(source: str) -> list[str]:
    """Docstrings whose first word is a quantity of the function with another letter: M - s x for m - s x."""
    found = []
    for node in ast.walk(ast.parse(source)):
        if not isinstance(node, ast.FunctionDef | ast.ClassDef):
            continue
        line = (ast.get_docstring(node) or "").partition("\n")[0]
        first = re.match(r"[A-Z][a-z]*(?![A-Za-z0-9(])", line)
        if first is None or first[0] == "A":
            continue
        small, rest = first[0][0].lower() + first[0][1:], line[first.end() :]
        arguments = {each.arg for each in ast.walk(node) if isinstance(each, ast.arg)}
        names = arguments | {each.id for each in ast.walk(node) if isinstance(each, ast.Name)}
        formula = re.match(r" ?([-=+*/^|](?!>))", rest) is not None
        letter = len(small) == 1 and (small in arguments or re.search(rf"(?<!\w){small}(?!\w)", rest) is not None)
        if first[0] not in names and (letter or (small in GREEK and small in names) or (formula and small in names)):
            found.append(f"{node.name}: {line}")
    return found


def test_formulas_in_docstrings_keep_their_letters() -> None:
    root = Path(__file__).parent.parent
    for folder in (SOURCE, root / "benchmarks", root / "docs", root / "examples"):
        for path in folder.rglob("*.py"):
            assert not capitalised(path.read_text(encoding="utf-8")), path
    assert "D403" in (root / "pyproject.toml").read_text(encoding="utf-8")  # the rule that made them so
    for line in ("V - s x for a scalar s.", "X + v.", "Mu - X.", "Self * v.", "F on the set", "D s: <d s, v>"):
        assert capitalised(f'def made(self, v, x, f, s):\n    """{line}"""\n    mu = v\n'), line
    for line in ("The sum x + v.", "V(x, s) of a state.", "A sum.", "Name -> x.", "X, where X = hat(u)", "Values of x"):
        assert not capitalised(f'def made(name, v, s, values):\n    """{line}"""\n    X = v\n'), line
