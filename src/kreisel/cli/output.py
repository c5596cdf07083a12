"""Parts that the commands share: the application, options, and printing of tables, JSON and messages."""

from __future__ import annotations

import contextlib
import json
import math
import sys
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from kreisel.errors import ConservationWarning, InputError, brief, printable, shown

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

app = typer.Typer(
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    help="Simulate spinning bodies and keep every first integral to round-off.",
)
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON, for scripts.")]
NOT_CONSERVED = 3  # exit code
TOO_MUCH = "Usual cause: an n or a number of lanes that is too large. Use fewer, or save less often (every)."
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace the archive if it exists.")]


Set = Annotated[
    list[str] | None,
    typer.Option("--set", help=r"A value in place of the file's: run.dt=0.01, 'system.p=\[0, 0, 2]'; may be repeated."),
]
OverwriteFile = Annotated[bool, typer.Option("--overwrite", help="Replace the file if Kreisel wrote it.")]


def a_path(text: str, *names: str) -> Any:
    """An argument, or an option of these names, that is a path, ~ expanded; Kreisel reports whether it can be read."""
    settings: dict[str, Any] = {"readable": False, "callback": _from_home, "help": text}
    return typer.Option(*names, **settings) if names else typer.Argument(**settings)


def _from_home(path: Any) -> Any:
    """The path, or each of several, with ~ expanded."""
    if isinstance(path, list):
        return [_from_home(each) for each in path]
    try:
        return None if path is None else path.expanduser()
    except RuntimeError:
        raise InputError(f"expected a path, got {shown(str(path))}: no such user.") from None


def _version(asked: bool) -> None:
    if not asked:
        return
    from importlib.metadata import version

    import kreisel

    beside = ", ".join(f"{name} {version(name)}" for name in ("numpy", "llvmlite", "xarray", "zarr"))
    print(f"kreisel {kreisel.__version__} (Python {sys.version.split()[0]}, {beside})")
    raise typer.Exit


@app.callback()
def common(
    version: Annotated[
        bool, typer.Option("--version", is_eager=True, callback=_version, help="Print the versions.")
    ] = False,
) -> None:
    """Simulate spinning bodies and keep every first integral to round-off."""


def system_names(begun: str) -> list[str]:
    """The systems whose names begin with `begun`, for the shell."""
    from kreisel.bodies import KNOWN

    return [name for name in KNOWN if name.startswith(begun)]


def method_names(begun: str) -> list[str]:
    """The methods whose names begin with `begun`, for the shell."""
    from kreisel.method import METHODS

    return [name for name in METHODS if name.startswith(begun)]


def condition(faults: list[str]) -> str:
    """One word for an archive with these faults."""
    cut = [fault for fault in faults if "was interrupted" in fault]
    return "whole" if not faults else "interrupted" if cut == faults else "damaged"


def say(text: str, file: Any = None) -> None:
    """Print a line without its control characters: it may hold names and attributes from a foreign file."""
    print(brief(text), file=file, flush=True)


def width() -> int:
    """Letters in a line of the terminal."""
    import shutil

    return max(60, shutil.get_terminal_size((110, 24)).columns) if sys.stdout.isatty() else 110


def parameter_of(text: str) -> tuple[str, Any]:
    """A parameter and its values, from NAME=NUMBERS."""
    from fractions import Fraction

    name, sign, value = text.partition("=")
    try:
        numbers = [Fraction(number) for number in value.split(",")]
    except (ValueError, ZeroDivisionError):
        numbers = []
    if not sign or not name or not numbers:
        raise InputError(f"--set needs a name and values, such as b=1,2,4 or alpha=1/2, got {shown(text)}.")
    return name, numbers[0] if len(numbers) == 1 else numbers


def print_finding(finding: Any) -> None:
    """The result for one statement of `kreisel verify`."""
    from kreisel.lab.paper import statements

    n, over_q, floats, verdict = statements.cells(finding)
    statement = finding.statement
    print(f"{statement.name}: {statement.place}\n    {statement.text}")
    print(f"    n = {n}   over Q: {over_q}   floats: {floats}   {verdict}", flush=True)


def finding_data(finding: Any) -> dict[str, Any]:
    """The result for one statement as plain data."""
    statement = finding.statement
    return {
        "row": statement.name,
        "place": statement.place,
        "statement": statement.text,
        "erratum": statement.erratum,
        "n": finding.dimensions,
        "exact": finding.over_q,
        "float": finding.in_floats,
        "printed": finding.printed,
        "holds": finding.holds,
        "verdict": finding.verdict,
    }


def save_figure(
    result: Any,
    target: Path,
    compare: Any = None,
    theme: str = "light",
    style: str = "house",
    overwrite: bool = True,
) -> None:
    """Draw a run, and a second run if given, into a file."""
    from kreisel.viewer.plots import plot as draw

    require_figure(target, overwrite)
    save_picture(draw(result, compare=compare, theme=theme, style=style), target, overwrite)


def save_picture(picture: Figure, target: Path, overwrite: bool = True) -> None:
    """Save a figure with Kreisel's mark.  Raises `InputError` for another format, and for a file that must stay."""
    from kreisel.files import written

    require_figure(target, overwrite)
    with written(target, overwrite) as scratch:
        picture.savefig(scratch, metadata=_mark(target))


def save_sweep_figure(store: Path, target: Path, show: str | None, theme: str, overwrite: bool) -> None:
    """Draw the summaries of a sweep into a file."""
    from kreisel.files import written
    from kreisel.storage.opening import open_lanes
    from kreisel.viewer.plots import sweep_figure

    with written(target, overwrite) as scratch:
        sweep_figure(open_lanes(store), show, theme).savefig(scratch, metadata=_mark(target))


def _mark(target: Path) -> dict[str, str]:
    """The mark by which Kreisel recognises its figures."""
    return {{".png": "Software", ".pdf": "Creator", ".svg": "Title"}[target.suffix.lower()]: "Kreisel"}


def require_figure(target: Path, overwrite: bool = True) -> None:
    """Raises `InputError` if no figure can be written."""
    from kreisel.cli.configuration import FIGURES
    from kreisel.files import require_file

    require_file(target, overwrite)
    if target.suffix.lower() not in FIGURES:
        raise InputError(f"Expected the name of a figure that ends in {', '.join(FIGURES)}; got {str(target)!r}.")


@contextlib.contextmanager
def warnings_in_the_table() -> Iterator[None]:
    """A context without `ConservationWarning`, since the table and the exit code report it."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConservationWarning)
        yield


def shout(sentences: list[str]) -> None:
    """Print sentences on quantities that are not conserved to stderr; exit code 3."""
    for sentence in sentences:
        say(f"kreisel: {sentence}", file=sys.stderr)
    if sentences:
        raise typer.Exit(NOT_CONSERVED)


def print_drift(table: pd.DataFrame) -> None:
    """The table of `kr.drift`."""
    from rich.console import Console
    from rich.table import Table

    grid = Table(box=None, pad_edge=False, header_style="bold")
    grid.add_column("integral")
    grid.add_column("conserved")
    for column in ("start", "max |change|", "ulps", "slope", "correction"):
        grid.add_column(column, justify="right")
    for label, row in table.iterrows():
        name = printable(label)
        numbers = (
            f"{row.start:.6g}",
            f"{row.max_change:.2e}",
            f"{row.ulps:.2g}",
            f"{row.slope:.1e}",
            "" if math.isnan(row.correction) else f"{row.correction:.2g}",
        )
        conserved = "[bold red]BROKEN[/]" if row.broken else "yes" if row.conserved else "no"
        grid.add_row(name.replace("[", r"\["), conserved, *numbers)
    Console(width=None if sys.stdout.isatty() else 110, highlight=False).print(grid)


def records(table: pd.DataFrame | None) -> list[dict[str, Any]]:
    """Rows as plain data; JSON has no infinity, so a change beyond any rounding error has the ratio null."""
    if table is None:
        return []
    rows = table.to_dict("index").items()
    return [{"integral": str(name), **{str(k): finite(v) for k, v in row.items()}} for name, row in rows]


def finite(value: Any) -> Any:
    """The value; None for a value that JSON lacks."""
    return None if isinstance(value, float) and not math.isfinite(value) else value


def print_json(value: Any) -> None:
    """Print JSON for scripts."""
    print(json.dumps(value, indent=1, allow_nan=False, default=float))
