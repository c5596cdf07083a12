"""The command line: run, resume, check, plot, view, systems, methods, verify, bench.

Exit codes: 0; 1 where `check` or `verify` finds something wrong; 2 and one message for bad input; 3 where what a method
conserves is not conserved, the archive being kept; 128 and more for signals.
"""

from __future__ import annotations

import contextlib
import io
import json
import math
import sys
import time
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from kreisel.errors import (
    ConservationWarning,
    InputError,
    Interrupted,
    RunError,
    Stopped,
    brief,
    disk_trouble,
    printable,
    shown,
)

if TYPE_CHECKING:
    import pandas as pd

app = typer.Typer(
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    help="Simulate spinning bodies and keep every first integral to round-off.",
)
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON, for scripts.")]
NOT_CONSERVED = 3  # exit code
TOO_MUCH = "Usual cause: an n or a number of lanes that is too large. Use fewer, or save less often (every)."
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace the archive if it exists.")]


@app.command()
def run(
    config: Annotated[Path, typer.Argument(help="A TOML file; see examples/.")],
    overwrite: Overwrite = False,
    as_json: AsJson = False,
    figure: Annotated[bool, typer.Option("--figure/--no-figure", help="Draw the figure.")] = True,
    project: Annotated[
        bool, typer.Option("--project/--no-project", help="Put the state back on what is conserved.")
    ] = True,
) -> None:
    """Simulate: write the archive, print the drift of every integral, save a figure.

    Exit code 3 says that something which the method conserves is not conserved; the archive is kept.
    """
    from kreisel.runs.config import read
    from kreisel.runs.drift import broken, drift
    from kreisel.runs.own import load
    from kreisel.runs.simulate import simulate

    asked = read(config)
    model = load(asked.name, asked.file)(**asked.parameters)
    if figure:
        _require_figure(asked.figure)
    begun = time.perf_counter()
    with _shouted_here():
        result = simulate(
            model,
            model.state(**asked.state),
            dt=asked.run.dt,
            steps=asked.run.steps,
            every=asked.run.every,
            method=asked.run.method,
            order=asked.run.order,
            tol=asked.run.tol,
            engine=asked.run.engine,
            project=asked.run.project and project,
            orientation=asked.orientation,
            path=asked.path,
            overwrite=overwrite,
        )
    seconds = time.perf_counter() - begun
    table = drift(result)
    told = {
        "archive": str(asked.path),
        "figure": str(asked.figure) if figure else None,
        "system": asked.name,
        "method": result.attrs["method"],
        "options": json.loads(result.attrs["options"]),
        "dt": result.attrs["dt"],
        "steps": result.attrs["steps"],
        "rows": int(result.sizes["time"]),
        "seconds": round(seconds, 3),
    }
    if as_json:
        if figure:
            _save_figure(result, asked.figure)
        _print_json({**told, "drift": _records(table), "broken": broken(table)})
        return _shout(broken(table))
    say(f"{result.attrs['title']}: {model}")
    if told["options"]:
        say(", ".join(f"{name.replace('_', ' ')} {value:g}" for name, value in told["options"].items()))
    say(f"{told['steps']:,} steps of {result.attrs['dt']:g} in {seconds:.2f} s -> {asked.path} ({told['rows']:,} rows)")
    _print_drift(table)
    if figure:
        _save_figure(result, asked.figure)
        say(f"figure: {asked.figure}")
    return _shout(broken(table))


@app.command()
def resume(
    archive: Annotated[Path, typer.Argument(help="The archive, NAME.zarr or NAME.zarr.part.")],
    extend: Annotated[int | None, typer.Option("--extend", help="Lengthen the run to this number of steps.")] = None,
    as_json: AsJson = False,
) -> None:
    """Go on with a run that was interrupted, bit for bit as if it had not been; or lengthen a finished one."""
    from kreisel.runs.drift import broken, drift
    from kreisel.runs.simulate import resume as go_on

    with _shouted_here():
        result = go_on(archive, extend=extend)
    table = drift(result)
    if as_json:
        told = {"archive": str(archive), "steps": result.attrs["steps"], "drift": _records(table)}
        _print_json({**told, "broken": broken(table)})
        return _shout(broken(table))
    say(f"{result.attrs['title']}: {result.attrs['steps']:,} steps, {result.sizes['time']:,} rows")
    _print_drift(table)
    return _shout(broken(table))


@app.command()
def sweep(
    config: Annotated[Path, typer.Argument(help="A TOML file with a section [sweep]; see examples/sweep.toml.")],
    workers: Annotated[
        int | None, typer.Option("--workers", help="Processes here, by default one a core; 0: this one, without Dask.")
    ] = None,
    scheduler: Annotated[str | None, typer.Option("--scheduler", help="The address of a Dask scheduler.")] = None,
    overwrite: Overwrite = False,
    as_json: AsJson = False,
) -> None:
    """Simulate many lanes that differ in parameters, states or settings; the same command goes on after a kill."""
    from kreisel.runs.config import read_sweep
    from kreisel.sweeps.broken_lanes import broken_lanes
    from kreisel.sweeps.sweep import carry_out, failures, open_sweep

    description, file, path = read_sweep(config)
    report = carry_out(description, path, file=file, workers=workers, scheduler=scheduler, overwrite=overwrite)
    result = open_sweep(report.path)
    worst = {str(k): float(v.max()) for k, v in result.data_vars.items() if v.attrs.get("kind") == "drift"}
    largest = {name: _finite(value) for name, value in worst.items() if name.endswith("_drift")}
    lost = broken_lanes(result, file)
    told = {
        "archive": str(path),
        "lanes": report.lanes,
        "failed": report.failed,
        "blocks": report.blocks,
        "blocks_before": report.before,
        "seconds": round(report.seconds, 3),
        "peak_MiB": round(report.peak_MiB),
        "largest": largest,
        "broken": lost,
    }
    if as_json:
        _print_json(told)
        return _shout(lost)
    before = f", {report.before:,} of them done before" if report.before else ""
    say(f"{result.attrs['title']}: {report.blocks:,} blocks{before}, {report.seconds:.2f} s -> {path}")
    for name, value in largest.items():
        say(f"    {name:32}{value:.2e}" if value is not None else f"    {name:32}none")
    if report.failed:
        say(f"{report.failed:,} lanes failed; kr.failures(kr.open_run({str(path)!r})) lists them. The first ones:")
        for lane, row in failures(result).head(3).iterrows():
            say(f"    lane {lane}: {row.message}")
    return _shout(lost)


@app.command()
def check(
    archive: Path,
    as_json: AsJson = False,
    out: Annotated[
        Path | None, typer.Option("--recover", help="Write the rows that are whole to a new archive.")
    ] = None,
) -> None:
    """Check an archive: complete, readable, finite, its integrals those of its states, conserved if they should be."""
    from kreisel.runs.drift import broken, drift
    from kreisel.storage.archive import is_own
    from kreisel.storage.checking import check_archive, recover
    from kreisel.sweeps.broken_lanes import broken_lanes

    result, faults = check_archive(archive)
    if out is not None:
        kept, rows = recover(archive, out)
        say(f"{out}: {kept:,} of {rows:,} rows are whole", file=sys.stderr)
    table = drift(result) if result is not None and "kreisel_sweep" not in result.attrs else None
    if result is not None:
        lost = broken(table) if table is not None else [] if faults else broken_lanes(result)
        faults += lost
    if as_json:
        _print_json({"archive": str(archive), "faults": faults, "drift": _records(table)})
    else:
        if table is not None:
            _print_drift(table)
        for fault in faults:
            say(f"FAULT: {fault}")
        if table is not None and result is not None and is_own(result.attrs):
            say(f"{result.attrs['system']} is a system of your own: its integrals were not computed again")
        say(f"{archive}: {_state(faults)}")
    if faults:
        raise typer.Exit(1)


@app.command()
def export(
    archive: Annotated[Path, typer.Argument(help="An archive of a run or a sweep.")],
    out: Annotated[Path, typer.Argument(help="The file to write: .nc, .h5 or .parquet.")],
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace the file if it exists.")] = False,
) -> None:
    """Write an archive as NetCDF (HDF5) or Parquet."""
    from kreisel.storage.exporting import export as write

    write(archive, out, overwrite=overwrite)
    say(f"{archive} -> {out}")


@app.command()
def plot(
    archive: Path,
    out: Annotated[Path | None, typer.Option("--out", "-o", help="Where to; .png, .pdf or .svg.")] = None,
    compare: Annotated[Path | None, typer.Option("--compare", help="A second archive, drawn in grey.")] = None,
    dark: Annotated[bool, typer.Option("--dark", help="On dark paper.")] = False,
) -> None:
    """Draw the figure of an archive."""
    from kreisel.storage.archive import open_archive
    from kreisel.storage.replacing import settled

    result = open_archive(settled(archive))
    target = out or (archive if archive.name else archive.resolve()).with_suffix(".png")
    _save_figure(result, target, open_archive(settled(compare)) if compare else None, "dark" if dark else "light")
    say(f"figure: {target}")


@app.command()
def view(
    archive: Annotated[Path, typer.Argument(help="The archive, NAME.zarr or NAME.zarr.part.")],
    out: Annotated[Path | None, typer.Option("--out", "-o", help="Where to; .html.")] = None,
    lane: Annotated[int, typer.Option("--lane", help="The trajectory of an ensemble.")] = 0,
    serve: Annotated[bool, typer.Option("--serve", help="Serve the page and follow a run that goes on.")] = False,
    host: Annotated[
        str, typer.Option("--host", help="Address to serve at; others than loopback can be read by anyone there.")
    ] = "127.0.0.1",
    port: Annotated[int, typer.Option("--port", help="0: one that is free.")] = 0,
) -> None:
    """Write the interactive page of an archive: one HTML file that opens offline."""
    from kreisel.storage.archive import open_archive
    from kreisel.storage.replacing import require_file, settled
    from kreisel.viewer.page import view as page_of

    if serve:
        _serve(archive, host, port, lane)
        return
    result = open_archive(settled(archive))
    target = out or (archive if archive.name else archive.resolve()).with_suffix(".html")
    require_file(target)
    page_of(result, lane=lane).save(target)
    say(f"page: {target}")


def _serve(archive: Path, host: str, port: int, lane: int) -> None:
    from kreisel.viewer.serve import LOOPBACK, address, server

    with server(archive, host=host, port=port, lane=lane) as serving:
        if host not in LOOPBACK:
            say(f"kreisel: anyone who reaches {host} can read this page", file=sys.stderr)
        say(f"{address(serving)}  (Ctrl-C ends it)")
        try:
            serving.serve_forever()
        except KeyboardInterrupt:
            print("ended", file=sys.stderr)


@app.command()
def systems(
    name: Annotated[str | None, typer.Argument(help="One system, for its whole record.")] = None,
    as_json: AsJson = False,
) -> None:
    """List the systems, or print the record of one."""
    from kreisel.system import REGISTRY, find
    from kreisel.viewer.record import record, summary, table

    if name is not None:
        system = find(name)
        print(json.dumps(summary(system), indent=1) if as_json else record(system))
    elif as_json:
        _print_json([summary(system) for system in REGISTRY.values()])
    else:
        print(table(REGISTRY.values()))


@app.command()
def methods(
    name: Annotated[str | None, typer.Argument(help="One method, for its whole record.")] = None,
    as_json: AsJson = False,
) -> None:
    """List the methods, or print the record of one."""
    from kreisel.method import METHODS, find
    from kreisel.viewer.record import method_record, method_table

    if name is not None:
        method = find(name)
        print(json.dumps(method.summary(), indent=1) if as_json else method_record(method))
    elif as_json:
        _print_json([method.summary() for method in METHODS.values()])
    else:
        print(method_table(METHODS.values()))


@app.command()
def verify(
    name: Annotated[str | None, typer.Argument(help="A row, or the beginning of names, such as theorem.")] = None,
    listed: Annotated[bool, typer.Option("--list", help="Name the rows without testing them.")] = False,
    as_json: AsJson = False,
    markdown: Annotated[bool, typer.Option("--markdown", help="Print the page of the docs.")] = False,
) -> None:
    """Every theorem and displayed identity of the paper, exactly over Q and in floats, n = 3 to 6."""
    from rich.console import Console

    from kreisel.lab import paper
    from kreisel.lab.paper import rows

    if listed:
        for row in rows.chosen(name):
            say(f"{row.name:32}{row.place}")
        return
    console = Console(stderr=True)
    findings: list[paper.Finding] = []
    asked = rows.chosen(name)
    with console.status("") as status:
        for row in asked:
            status.update(f"{row.name} ({len(findings) + 1} of {len(asked)})")
            findings.append(paper.test(row))
            if not (as_json or markdown):
                _print_finding(findings[-1])
    if as_json:
        _print_json([_told(finding) for finding in findings])
    elif markdown:
        print(rows.markdown(findings), end="")
    failing = [finding.row.name for finding in findings if not finding.holds]
    if not (as_json or markdown):
        errata = sum(finding.row.printed is not None for finding in findings)
        say(f"{len(findings)} rows, {len(findings) - len(failing)} hold; {errata} printed forms fail, as they should")
    if failing:
        raise typer.Exit(1)


@app.command()
def bench(as_json: AsJson = False) -> None:
    """Measure the speed of each map on this machine, n = 3, against C++ where g++ is installed; about a minute."""
    from rich.console import Console

    from kreisel.bench import short

    with Console(stderr=True).status("") as status:
        told = short.bench(lambda name: status.update(f"{name}: kernels are compiled and timed"))
    if as_json:
        _print_json(told)
        return
    _print_bench(told)


BENCH_COLUMNS = {
    "ns_a_step": "ns a step",
    "step_to_cpp": "to C++",
    "ns_a_lane_step": "ns a lane-step",
    "lane_step_to_cpp": "to C++",
    "one_core_to_all": "one core to all",
    "saving": "saving every 100",
}


def _print_bench(told: dict[str, Any]) -> None:
    from rich.console import Console
    from rich.table import Table

    grid = Table(box=None, pad_edge=False, header_style="bold")
    grid.add_column("map, n = 3")
    shown = [name for name in BENCH_COLUMNS if name in next(iter(told["maps"].values()))]
    for name in shown:
        grid.add_column(BENCH_COLUMNS[name], justify="right")
    for label, row in told["maps"].items():
        grid.add_row(label, *(f"{row[name]:.2f}" for name in shown))
    Console(width=None if sys.stdout.isatty() else 110, highlight=False).print(grid)
    known = told["machine"]
    print(
        f"{known['cpu']}, {known['cores']} cores; load average {told['load_average']}; times are medians, of one core"
    )
    if "note" in told:
        print(told["note"])


@app.command()
def investigate(
    what: Annotated[
        str | None, typer.Argument(help="A system, or a Python file with a step, a Lagrangian or a model.")
    ] = None,
    eps: Annotated[str | None, typer.Option("--eps", help="The step, a whole number or a fraction; 1/3.")] = None,
    n: Annotated[int | None, typer.Option("--n", help="The dimension of a system; 3.")] = None,
    constants: Annotated[
        list[str] | None, typer.Option("--set", help="A parameter of a system, such as b=1,2,4; may be repeated.")
    ] = None,
    degree: Annotated[int | None, typer.Option("--degree", help="Of the integrals that are sought.")] = None,
    iterates: Annotated[int | None, typer.Option("--iterates", help="How many degrees.")] = None,
    steps: Annotated[int, typer.Option("--steps", help="Of the orbits for Lyapunov's exponents.")] = 10_000,
    seed: Annotated[int, typer.Option("--seed", help="Of the random points.")] = 0,
    html: Annotated[Path | None, typer.Option("--html", help="Write the page to this file.")] = None,
    as_json: AsJson = False,
    markdown: Annotated[bool, typer.Option("--markdown", help="Every map of the registry, as a table.")] = False,
) -> None:
    """Is this map integrable?  Poisson, reversible, order, degrees, integrals, Lax pair, chaos; with a verdict."""
    from kreisel.lab import investigation, report
    from kreisel.storage.replacing import require_file

    known: dict[str, Any] = {"eps": eps, "n": n, "degree": degree, "iterates": iterates, "steps": steps, "seed": seed}
    if markdown:
        print(report.registry_table(), end="")
        return
    if what is None:
        raise InputError("Name a system (kreisel systems) or a Python file: kreisel investigate clebsch.")
    if html is not None:
        require_file(html)
    given = dict(_parameter_of(told) for told in constants or [])
    file = what.endswith(".py")
    found = (
        investigation.investigate_file(Path(what), **known, **given)
        if file
        else investigation.investigate(what, **known, **given)
    )
    if html is not None:
        found.save(html)
    if as_json:
        _print_json(report.plain(found))
    else:
        print(report.text(found, _width()))
        if html is not None:
            say(f"page: {html}")


def _state(faults: list[str]) -> str:
    """One word for an archive with these faults."""
    cut = [fault for fault in faults if "was interrupted" in fault]
    return "whole" if not faults else "interrupted" if cut == faults else "damaged"


def say(text: str, file: Any = None) -> None:
    """Print a line without its control characters: it may hold names and attributes of somebody else."""
    print(brief(text), file=file, flush=True)


def _width() -> int:
    import shutil

    return max(60, shutil.get_terminal_size((110, 24)).columns) if sys.stdout.isatty() else 110


def _parameter_of(told: str) -> tuple[str, Any]:
    from fractions import Fraction

    name, sign, value = told.partition("=")
    try:
        numbers = [Fraction(part) for part in value.split(",")]
    except (ValueError, ZeroDivisionError):
        numbers = []
    if not sign or not name or not numbers:
        raise InputError(f"--set takes a name and numbers, such as b=1,2,4 or alpha=1/2, got {shown(told)}.")
    return name, numbers[0] if len(numbers) == 1 else numbers


def _print_finding(finding: Any) -> None:
    from kreisel.lab.paper import rows

    n, over_q, floats, verdict = rows.cells(finding)
    row = finding.row
    print(f"{row.name}: {row.place}\n    {row.statement}")
    print(f"    n = {n}   over Q: {over_q}   floats: {floats}   {verdict}", flush=True)


def _told(finding: Any) -> dict[str, Any]:
    row = finding.row
    return {
        "row": row.name,
        "place": row.place,
        "statement": row.statement,
        "erratum": row.erratum,
        "n": finding.dimensions,
        "exact": finding.over_q,
        "float": finding.in_floats,
        "printed": finding.printed,
        "holds": finding.holds,
        "verdict": finding.verdict,
    }


def _save_figure(result: Any, target: Path, compare: Any = None, theme: str = "light") -> None:
    from kreisel.storage.replacing import written
    from kreisel.viewer.plots import plot as draw

    _require_figure(target)
    with written(target) as scratch:
        mark = {".png": "Software", ".pdf": "Creator", ".svg": "Title"}[target.suffix.lower()]
        draw(result, compare=compare, theme=theme).savefig(scratch, metadata={mark: "Kreisel"})


def _require_figure(target: Path) -> None:
    """Raises `InputError` where no figure can be written."""
    from kreisel.runs.config import FIGURES
    from kreisel.storage.replacing import require_file

    require_file(target)
    if target.suffix.lower() not in FIGURES:
        raise InputError(f"Expected the name of a figure that ends in {', '.join(FIGURES)}; got {str(target)!r}.")


@contextlib.contextmanager
def _shouted_here() -> Iterator[None]:
    """What is not conserved is told in the table and by the exit code: no warning beside."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConservationWarning)
        yield


def _shout(sentences: list[str]) -> None:
    """What is not conserved, on stderr; exit code 3."""
    for sentence in sentences:
        say(f"kreisel: {sentence}", file=sys.stderr)
    if sentences:
        raise typer.Exit(NOT_CONSERVED)


def _print_drift(table: pd.DataFrame) -> None:
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


def _records(table: pd.DataFrame | None) -> list[dict[str, Any]]:
    """Rows as plain data; JSON has no infinity, so a change that no rounding explains has the ratio null."""
    if table is None:
        return []
    rows = table.to_dict("index").items()
    return [{"integral": str(name), **{str(k): _finite(v) for k, v in row.items()}} for name, row in rows]


def _finite(value: Any) -> Any:
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _print_json(value: Any) -> None:
    print(json.dumps(value, indent=1, allow_nan=False, default=float))


def main() -> None:
    """The entry point: errors that a user can mend become one message and exit code 2."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # of a terminal that lacks the letter
    try:
        app()
    except (Stopped, Interrupted) as stopped:
        say(f"kreisel: {stopped}", file=sys.stderr)
        sys.exit(128 + stopped.number)
    except (InputError, RunError) as error:
        say(f"kreisel: {error}", file=sys.stderr)
        sys.exit(2)
    except MemoryError as error:
        say(f"kreisel: expected less than the memory that is free, got {error or 'more'}. {TOO_MUCH}", file=sys.stderr)
        sys.exit(2)
    except KeyboardInterrupt:
        say("kreisel: interrupted", file=sys.stderr)
        sys.exit(130)
    except BrokenPipeError:
        sys.stderr.close()
        sys.exit(0)
    except OSError as error:  # a name that is too long, a folder that may not be entered
        say(f"kreisel: {disk_trouble(error, error.filename or 'a file', 'be used', '')}", file=sys.stderr)
        sys.exit(2)
