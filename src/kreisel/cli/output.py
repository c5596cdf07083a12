"""Parts that the commands share: the application, options, and printing of tables, JSON and messages."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable, Iterable, Sequence
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from kreisel.errors import InputError, brief, printable, shown

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
OverwriteFile = Annotated[bool, typer.Option("--overwrite", help="Replace the file if Kreisel wrote it.")]


def opt(text: str, *names: str, default: Any = None, **settings: Any) -> Any:
    """An option, by default with the name of its parameter."""
    return typer.Option(default, *names, help=text, **settings)


def arg(text: str, names: Callable[[], Iterable[str]] | None = None, default: Any = None) -> Any:
    """An argument; the shell completes one of `names`."""

    def begin(begun: str) -> list[str]:
        return [name for name in (names or list)() if name.startswith(begun)]

    return typer.Argument(default, help=text, autocompletion=begin if names else None)


def a_path(text: str, *names: str, default: Any = None) -> Any:
    """An argument, or an option of these names, that is a path, ~ expanded; Kreisel reports whether it can be read."""
    settings: dict[str, Any] = {"readable": False, "callback": _from_home, "help": text}
    return typer.Option(default, *names, **settings) if names else typer.Argument(default, **settings)


SET = r"A value in place of the file's: run.dt=0.01, 'system.p=\[0, 0, 2]'; may be repeated."


def _from_home(path: Any) -> Any:
    """The path, or each of several, with ~ expanded."""
    if isinstance(path, list):
        return [_from_home(entry) for entry in path]
    try:
        return None if path is None else path.expanduser()
    except RuntimeError:
        raise InputError(f"expected a path, got {shown(str(path))}: no such user.") from None


def _version(asked: bool) -> None:
    if asked:
        from importlib.metadata import version

        import kreisel

        packages = ", ".join(f"{name} {version(name)}" for name in ("numpy", "llvmlite", "xarray", "zarr"))
        print(f"kreisel {kreisel.__version__} (Python {sys.version.split()[0]}, {packages})")
        raise typer.Exit


@app.callback()
def common(
    version: bool = opt("Print the versions.", "--version", default=False, is_eager=True, callback=_version),
) -> None:
    """Simulate spinning bodies and keep every first integral to round-off."""


def system_names() -> Iterable[str]:
    """The names of all systems, for the shell."""
    from kreisel.bodies import KNOWN

    return KNOWN


def say(text: str, file: Any = None) -> None:
    """Print a line without its control characters: it may hold names and attributes from a foreign file."""
    print(brief(text), file=file, flush=True)


def parameters_of(texts: Iterable[str]) -> dict[str, Any]:
    """Parameters and their values, each from NAME=NUMBERS."""
    parameters: dict[str, Any] = {}
    for text in texts:
        name, _, value = text.partition("=")
        try:
            numbers = [Fraction(number) for number in value.split(",")]
        except (ValueError, ZeroDivisionError):
            numbers = []
        if not name or not numbers:
            raise InputError(f"--set needs a name and values, such as b=1,2,4 or alpha=1/2, got {shown(text)}.")
        if name in parameters:
            raise InputError(f"--set: expected {name} once, got it again as {shown(text)}.")
        parameters[name] = numbers[0] if len(numbers) == 1 else numbers
    return parameters


def save_picture(picture: Figure, target: Path, overwrite: bool = True) -> None:
    """Save a figure with Kreisel's mark.  Raises `InputError` for another format, and for a file that must stay."""
    from kreisel.files import written

    require_figure(target, overwrite)
    marks = {".png": "Software", ".pdf": "Creator", ".svg": "Title"}  # by which Kreisel recognises its figures
    with written(target, overwrite) as scratch:
        picture.savefig(scratch, metadata={marks[target.suffix.lower()]: "Kreisel"})


def require_figure(target: Path, overwrite: bool = True) -> None:
    """Raises `InputError` if no figure can be written."""
    from kreisel.cli.configuration import FIGURES
    from kreisel.files import require_file

    require_file(target, overwrite)
    if target.suffix.lower() not in FIGURES:
        raise InputError(f"Expected the name of a figure that ends in {', '.join(FIGURES)}; got {str(target)!r}.")


def shout(sentences: list[str]) -> None:
    """Print sentences on quantities that are not conserved to stderr; exit code 3."""
    for sentence in sentences:
        say(f"kreisel: {sentence}", file=sys.stderr)
    if sentences:
        raise typer.Exit(NOT_CONSERVED)


def print_table(columns: Sequence[str], rows: Iterable[Sequence[str]], texts: int = 1) -> None:
    """A table whose first `texts` columns are text, the others figures."""
    from rich.console import Console
    from rich.table import Table

    grid = Table(box=None, pad_edge=False, header_style="bold")
    for number, column in enumerate(columns):
        grid.add_column(column, justify="left" if number < texts else "right")
    for row in rows:
        grid.add_row(*row)
    Console(width=None if sys.stdout.isatty() else 110, highlight=False).print(grid)


def print_drift(table: pd.DataFrame) -> None:
    """The table of `kr.drift`."""
    rows = []
    for label, row in table.iterrows():
        conserved = "[bold red]BROKEN[/]" if row.broken else "yes" if row.conserved else "no"
        figures = f"{row.start:.6g}", f"{row.max_change:.2e}", f"{row.ulps:.2g}", f"{row.slope:.1e}"
        correction = "" if math.isnan(row.correction) else f"{row.correction:.2g}"
        rows.append((printable(label).replace("[", r"\["), conserved, *figures, correction))
    print_table(("integral", "conserved", "start", "max |change|", "ulps", "slope", "correction"), rows, 2)


def records(table: pd.DataFrame | None) -> list[dict[str, Any]]:
    """Rows as plain data; JSON has no infinity, so a change beyond any rounding error has the ratio null."""
    rows = {} if table is None else table.to_dict("index")
    return [{"integral": str(name), **{str(k): finite(v) for k, v in row.items()}} for name, row in rows.items()]


def finite(value: Any) -> Any:
    """The value; None for a value that JSON lacks."""
    return None if isinstance(value, float) and not math.isfinite(value) else value


def print_json(value: Any) -> None:
    """Print JSON for scripts."""
    print(json.dumps(value, indent=1, allow_nan=False, default=float))
