"""The house: arrows run one way, the import is light, claims in the README are what the code prints."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from collections import Counter
from collections.abc import Collection
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from pkgutil import resolve_name

import numpy as np
import pytest

import kreisel as kr
from kreisel.lab import exact
from support import ROOT

SOURCE = Path(kr.__file__).parent
RANK = {  # a part imports what stands on its own line or above
    part: rank
    for rank, parts in enumerate(
        (
            ("errors", "display", "files", "process"),
            ("algebra",),
            ("record",),
            ("baecklund", "implicit"),
            ("system", "reduction", "forces", "exact"),
            ("method", "bodies"),
            ("kernels", "graph"),
            ("runs", "units"),
            ("storage",),
            ("sweeps",),
            ("languages",),
            ("lab", "analysis", "physical", "viewer", "bench", "checkcases"),
            ("rebound", "gym"),
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


def modules(source: Path) -> dict[str, Path]:
    """The modules below a folder `kreisel`, by name; a package is its `__init__`."""
    found = {".".join(path.relative_to(source.parent).with_suffix("").parts): path for path in source.rglob("*.py")}
    return {name.removesuffix(".__init__"): path for name, path in found.items()}


def run_by(path: Path, known: Collection[str]) -> set[str]:
    """The modules that code of a file imports, inside functions too; not what only annotations name."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    guards = [node for node in ast.walk(tree) if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)]
    annotations = {each for guard in guards for statement in guard.body for each in ast.walk(statement)}
    names: set[str] = set()
    for node in ast.walk(tree):
        if node in annotations:
            continue
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            inside = {f"{node.module}.{alias.name}" for alias in node.names}
            names |= (inside & set(known)) | ({node.module} if inside - set(known) else set())
    return names & set(known)


def circle(source: Path) -> list[str]:
    """Modules that import each other in a circle, the first again at the end; [] where there is none."""
    known = modules(source)
    graph = {name: run_by(path, known) - {name} for name, path in known.items()}
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        return list(error.args[1])
    return []


def test_no_modules_import_each_other_in_a_circle() -> None:
    assert len(modules(SOURCE)) > 100 and circle(SOURCE) == []


@pytest.mark.parametrize("late", ["    from kreisel.room.b import g", "    from kreisel.room import b"])
def test_a_circle_inside_functions_is_seen(tmp_path: Path, late: str) -> None:
    room = tmp_path / "kreisel" / "room"
    room.mkdir(parents=True)
    (room / "__init__.py").write_text("", encoding="utf-8")
    (room / "b.py").write_text("from kreisel.room.a import f\n\ndef g():\n    return f\n", encoding="utf-8")
    (room / "a.py").write_text(f"def f():\n{late}\n", encoding="utf-8")
    assert set(circle(tmp_path / "kreisel")) == {"kreisel.room.a", "kreisel.room.b"}
    (room / "a.py").write_text(f"if TYPE_CHECKING:\n{late}\ndef f():\n    return 1\n", encoding="utf-8")
    assert circle(tmp_path / "kreisel") == []


def too_long(source: str) -> list[str]:
    """A file of more than 600 lines, functions of more than 60."""
    whole = ["the file"] if len(source.splitlines()) > 600 else []
    functions = [node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.FunctionDef)]
    return whole + [f.name for f in functions if (f.end_lineno or 0) - f.lineno >= 60]


def test_functions_have_at_most_60_lines_and_files_600() -> None:
    found = {path.name: too_long(path.read_text(encoding="utf-8")) for path in SOURCE.rglob("*.py")}
    assert {name: what for name, what in found.items() if what} == {}  # the stub, `__init__.pyi`, is generated


def test_what_is_too_long_is_seen() -> None:
    function = "def f():\n" + "    x = 0\n" * 59
    assert too_long(function) == [] and too_long(function + "    x = 0\n") == ["f"]
    assert too_long("x = 0\n" * 600) == [] and too_long("x = 0\n" * 601) == ["the file"]


def test_arrows_run_one_way() -> None:
    for path in SOURCE.rglob("*.py"):
        part = path.relative_to(SOURCE).parts[0].removesuffix(".py")
        if part == "__init__":
            continue
        for other in imports(path):
            assert RANK[other] <= RANK[part], f"{path.name} ({part}) imports {other}"


def test_import_is_light() -> None:
    heavy = (
        "llvmlite",
        "xarray",
        "zarr",
        "matplotlib",
        "scipy",
        "pandas",
        "flint",
        "jax",
        "mpmath",
        "sympy",
    )
    code = f"import sys, kreisel.cli; print(*(m for m in {heavy} if m in sys.modules))"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=120).stdout
    assert out.split() == []


def loaded(*lines: str) -> list[str]:
    """The modules of kreisel that these lines import in a fresh process."""
    script = [*lines, "import sys", "print(*sorted(name for name in sys.modules if name.split('.')[0] == 'kreisel'))"]
    run = [sys.executable, "-c", "\n".join(script)]
    return subprocess.run(run, capture_output=True, text=True, check=True, timeout=300).stdout.split()


FIRST_RUN = (
    "import kreisel as kr",
    "top = kr.LagrangeTop(p=(0, 0, 1))",
    "x0 = top.state(m=(0.1, 0.2, 1.5), a=(0.6, 0, 0.8))",
    "run = kr.simulate(top, x0, dt=0.05, steps=100, progress=False)",
)


def test_a_run_imports_what_it_uses() -> None:
    """One system and one method of those that there are: no page, closed form or force beside, nor Dask and Pint."""
    names = loaded(*FIRST_RUN, "import sys; assert not {'dask', 'pint'} & {*sys.modules}")
    assert len(names) <= 90, "\n".join(names)
    used = {"kreisel.system.lagrange_top", "kreisel.method.baecklund", "kreisel.baecklund.lagrange_top"}
    rooms = ("kreisel.system.", "kreisel.baecklund.", "kreisel.forces", "kreisel.exact", "kreisel.bodies.")
    makers = {method.maker.partition(":")[0] for method in kr.methods()}
    assert {name for name in names if name.startswith(rooms) or name in makers} == used


def test_a_warm_run_crosses_few_files() -> None:
    """The second of two runs that are alike: files of the package whose functions are called."""
    lines = (
        "files = set()",
        "import sys",
        "sys.setprofile(lambda frame, event, argument: files.add(frame.f_code.co_filename))",
        FIRST_RUN[-1],
        "sys.setprofile(None)",
        "from pathlib import Path",
        "inside = sorted(name for name in files if name.startswith(str(Path(kr.__file__).parent)))",
        "assert 20 < len(inside) <= 60, inside",
    )
    assert loaded(*FIRST_RUN, *lines)


def test_records_import_neither_pages_nor_methods() -> None:
    names = loaded("import kreisel as kr", "kr.systems(), kr.methods(), kr.method.find('suris').order_text")
    makers = {method.maker.partition(":")[0] for method in kr.methods()}
    assert not makers & {*names} and not [name for name in names if name.startswith("kreisel.system.")]


def test_parts_load_when_they_are_asked_for() -> None:
    """`kr.reduction`, which needs JAX, is no part of `from kreisel import *`."""
    code = """
import sys
from kreisel import *
import kreisel as kr
print("jax" in sys.modules, *("kreisel." + part in sys.modules for part in kr._PARTS))
print(kr.reduction.SO(3).n, *(getattr(kr, part).__name__ for part in kr._PARTS))
"""
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=120).stdout
    assert out.splitlines() == [
        "False True True False True True False False True",
        "3 kreisel.analysis kreisel.checkcases kreisel.gym kreisel.lab kreisel.physical kreisel.rebound "
        "kreisel.reduction kreisel.units",
    ]


def test_the_first_step_waits_for_no_more_than_it_needs(tmp_path: Path) -> None:
    """`kreisel run` to disk, up to the first call of the kernel: tables and figures are imported when they are made."""
    heavy = ("xarray", "pandas", "matplotlib", "sympy", "jax", "flint", "dask", "IPython")
    text = (ROOT / "examples" / "lagrange-top.toml").read_text(encoding="utf-8")
    (tmp_path / "run.toml").write_text(text, encoding="utf-8")
    code = f"""
import os, sys
from kreisel.kernels import cpu
def first(self, *_):
    print("first step", *(m for m in {heavy} if m in sys.modules), flush=True)
    os._exit(0)
cpu.CpuEngine.advance = first
sys.argv = ["kreisel", "run", "run.toml"]
from kreisel.cli import main
main()
"""
    run = [sys.executable, "-c", code]
    out = subprocess.run(run, capture_output=True, text=True, check=True, cwd=tmp_path, timeout=120).stdout
    assert out.split() == ["first", "step"]


def test_a_whole_run_with_its_figure_needs_no_dask(tmp_path: Path) -> None:
    """xarray imports dask.array where it makes a scalar of a variable: figures take slices."""
    text = (ROOT / "examples" / "lagrange-top.toml").read_text(encoding="utf-8")
    (tmp_path / "run.toml").write_text(text, encoding="utf-8")
    code = """
import sys
from kreisel.cli import main
sys.argv = ["kreisel", "run", "run.toml", "--set", "run.steps=2000"]
try:
    main()
finally:
    print("matplotlib" in sys.modules, "dask.array" in sys.modules)
"""
    run = [sys.executable, "-c", code]
    out = subprocess.run(run, capture_output=True, text=True, check=True, cwd=tmp_path, timeout=120).stdout
    assert out.splitlines()[-1] == "True False"


def test_every_public_name_exists() -> None:
    assert set(kr.__all__) <= set(dir(kr))
    assert all(getattr(kr, name) is not None for name in dir(kr))
    assert {name for name in dir(kr) if not name.startswith("__")} == set(kr.__all__)


def test_the_package_runs_as_the_command() -> None:
    run = [sys.executable, "-m", "kreisel", "systems"]
    out = subprocess.run(run, capture_output=True, text=True, check=True, timeout=120)
    assert "lagrange-top-moving" in out.stdout


def test_version_stands_in_one_place() -> None:
    from importlib.metadata import version

    assert kr.__version__ == version("kreisel")


def idle(page: str, elsewhere: str, module: str) -> list[str]:
    """Functions of a page of formulas that neither the page nor other code names, such as a misspelt `enrgy`."""
    words = Counter(re.findall(r"\w+", page))
    alone = [node.name for node in ast.parse(page).body if isinstance(node, ast.FunctionDef) and words[node.name] < 2]
    return [name for name in alone if not re.search(rf"\b{module}\.{name}\b|\bimport\b[^\n]*\b{name}\b", elsewhere)]


def test_every_function_of_a_page_is_stated_or_used() -> None:
    package = "\n".join(path.read_text(encoding="utf-8") for path in SOURCE.rglob("*.py"))
    pages = [*(SOURCE / "system").glob("*.py"), *(SOURCE / "baecklund").glob("*.py")]
    found = {path.name: idle(path.read_text(encoding="utf-8"), package, path.stem) for path in pages}
    assert len(pages) > 40 and {name: what for name, what in found.items() if what} == {}


def test_a_function_with_a_wrong_name_is_seen() -> None:
    page = "def energy(M):\n    return halved(M)\n\ndef halved(M):\n    return M / 2\n\nSYSTEM = dict(energy=energy)\n"
    assert idle(page, "", "page") == []
    assert idle(page.replace("def energy", "def enrgy"), "", "page") == ["enrgy"]
    assert idle(page.replace("energy=energy", ""), "energy = other.energy", "page") == ["energy"]
    assert idle(page.replace("energy=energy", ""), "from page import energy", "page") == []


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
    root = ROOT
    for folder in (SOURCE, root / "benchmarks", root / "docs", root / "examples"):
        for path in folder.rglob("*.py"):
            assert not capitalised(path.read_text(encoding="utf-8")), path
    assert "D403" in (root / "pyproject.toml").read_text(encoding="utf-8")  # the rule that made them so
    for line in ("V - s x for a scalar s.", "X + v.", "Mu - X.", "Self * v.", "F on the set", "D s: <d s, v>"):
        assert capitalised(f'def made(self, v, x, f, s):\n    """{line}"""\n    mu = v\n'), line
    for line in ("The sum x + v.", "V(x, s) of a state.", "A sum.", "Name -> x.", "X, where X = hat(u)", "Values of x"):
        assert not capitalised(f'def made(name, v, s, values):\n    """{line}"""\n    X = v\n'), line


HOUSE_WORDS = re.compile(r"\b(told|how still|marcher)\b", re.IGNORECASE)  # that no other house has


def test_private_words_are_not_used() -> None:
    code = [*SOURCE.rglob("*.py"), *(ROOT / "benchmarks").rglob("*.py")]
    pages = [*code, *(ROOT / "docs").glob("*.md"), ROOT / "README.md", ROOT / "CONTRIBUTING.md"]
    used = [f"{page.name}: {word}" for page in pages for word in HOUSE_WORDS.findall(page.read_text(encoding="utf-8"))]
    assert len(pages) > 200 and used == []


def test_private_words_are_seen() -> None:
    assert HOUSE_WORDS.findall("what it told, and how still; a Marcher, untold") == ["told", "how still", "Marcher"]


def test_methods_and_systems_are_found_and_nothing_is_shadowed() -> None:
    import kreisel.method
    import kreisel.system

    assert [m.name for m in kr.methods()] == [*kreisel.method.METHODS]
    assert {"baecklund", "suris", "veselov", "variational", "lagrangian", "exact", "dop853"} <= {
        *kreisel.method.METHODS
    }
    assert kr.systems() == [*kreisel.system.REGISTRY] and kr.LagrangeTopSU2.name == "lagrange-top-su2"
    assert len(kr.systems()) == len([*(SOURCE / "system").glob("*.py")]) - 1  # without __init__
    assert all(kreisel.system.REGISTRY[name].name == name for name in kr.systems())
    assert all(callable(resolve_name(method.maker)) for method in kr.methods())
    assert {*kreisel.system.NAMED} <= {*kr.__all__} and all(hasattr(kr, name) for name in kr.__all__)


def test_defaults_come_from_the_records() -> None:
    """The first that suits a model, and every method refuses what it does not apply to."""
    from kreisel.method import METHODS, default_method
    from kreisel.system import REGISTRY

    draw = exact.float_random(np.random.default_rng(0))
    models = {name: exact.random_model(system, system.n or 3, draw) for name, system in REGISTRY.items()}
    defaults = {name: default_method(model) for name, model in models.items()}
    assert defaults["lagrange-top"] == defaults["clebsch"] == defaults["neumann"] == "baecklund"
    assert defaults["euler-top"] == "exact" and default_method(models["euler-top"], stepped=True) == "veselov"
    assert default_method(kr.EulerTop(J=(1, 2, 3, 4))) == "veselov" and defaults["ratiu-bitop"] == "suris"
    assert defaults["heavy-top"] == "variational"
    model, x0 = kr.HeavyTop(J=(1, 1.3, 0.6), A=(0, 0, 1)), {"M": (0.1, 0.2, 1.5), "P": (0, 0.6, 0.8)}
    for name, method in METHODS.items():
        if not method.applies(model):
            with pytest.raises(kr.InputError, match=rf"method='{name}': expected .*, got heavy-top"):
                kr.simulate(model, x0, dt=0.1, steps=1, method=name)
    with pytest.raises(kr.InputError, match=r"expected one of its orders \(2, 4, 6, 8\), got order=3"):
        kr.simulate(model, x0, dt=0.1, steps=1, method="variational", order=3)


def test_the_stub_is_that_of_the_records() -> None:
    """`make stubs` makes it again."""
    tool = ROOT / "docs" / "tools" / "stubs.py"
    run = [sys.executable, "-c", f"import runpy; print(runpy.run_path({str(tool)!r})['text'](), end='')"]
    made = subprocess.run(run, capture_output=True, text=True, check=True, timeout=120).stdout
    assert (SOURCE / "__init__.pyi").read_text(encoding="utf-8") == made
    for name in ("LagrangeTop", "simulate", "methods", "view"):
        assert re.search(rf"\b{name}\b", made)


FIRST = ("exact.motion", "method.exact", "kernels.cpu", "storage.run_archive", "method.maps", "viewer.page")


def test_a_module_can_be_imported_first() -> None:
    """Each of them into a process without a module of Kreisel; NumPy, which takes longest, is loaded once."""
    code = f"""
import importlib, sys
for first in {FIRST}:
    for name in [name for name in sys.modules if name.split(".")[0] == "kreisel"]:
        del sys.modules[name]
    importlib.import_module("kreisel." + first)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, timeout=120)
    assert done.returncode == 0, done.stderr
