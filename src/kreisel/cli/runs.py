"""Commands on runs and archives: run, resume, sweep, check, export, plot, view."""

from __future__ import annotations

import json
import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any
from warnings import catch_warnings

import typer

from kreisel.cli import output
from kreisel.cli.output import SET, AsJson, Overwrite, OverwriteFile, a_path, app, opt, print_json, say
from kreisel.errors import ConservationWarning, InputError, counted, doubt
from kreisel.process import SPENT

if TYPE_CHECKING:
    import xarray as xr

ARCHIVE = "The archive, NAME.zarr or NAME.zarr.part."
MAY_BE_LONG = 1_000_000  # steps times n: from here on a pilot estimates the time
LONG_SECONDS, LARGE = 20.0, 1e9  # beyond these an estimate is printed before the run

SWEEP_HELP = """\
Simulate many lanes that differ in parameters, states or settings.

The same command resumes after a kill.

\b
\\[sweep]                  next to \\[system], \\[state], \\[run], \\[output] of a run
rng = 1                  the seed of the random draws
draws = 50               how many of them
save = \\["drift", "extremes"]   also "frequencies", "trajectories"
block, memory            lanes in a block, MiB of arrays in a worker (256)
\\[sweep.grid]             every combination
system.alpha = { from = 0.2, to = 1.8, count = 20 }   or a list; spacing = "log"
\\[sweep.list]             values that go together, as many of each
run.dt = \\[0.1, 0.05]
\\[sweep.random]           uniform, loguniform = \\[a, b], normal = \\[mean, deviation], sphere = radius
state."m\\[2]" = { uniform = \\[1.0, 3.0] }
"""


@app.command()
def run(
    config: Path = a_path("A TOML file; `kreisel new` writes one.", default=...),
    overwrite: Overwrite = False,
    changes: list[str] | None = opt(SET, "--set"),
    as_json: AsJson = False,
    figure: bool = opt("Draw the figure.", default=True),
    project: bool = opt("Project the state back onto its integrals.", default=True),
) -> None:
    """Simulate: write the archive, print the drift of every integral, save a figure.

    Exit code 3: an invariant of the method is not conserved; the archive is kept.
    """
    from kreisel.cli.configuration import read
    from kreisel.runs.planning import estimate, make_plan
    from kreisel.runs.run_record import RunRecord
    from kreisel.storage.simulate import doubted, simulate

    asked = read(config, changes or ())
    for sentence in asked.doubts:
        doubt(sentence)
    if figure:
        output.require_figure(asked.figure)
    begun = time.perf_counter()
    settings = asked.run.but(project=asked.run.project and project).keywords()
    settings["orientation"] = asked.orientation
    SPENT.clear()
    if asked.run.steps * asked.model.n >= MAY_BE_LONG and asked.run.order != "auto":
        duration = estimate(make_plan(asked.model, asked.state, **settings), asked.path)
        if duration.seconds > LONG_SECONDS or duration.bytes > LARGE:
            say(f"{duration.text}; Ctrl-C stops it, `kreisel resume {asked.path}` goes on", file=sys.stderr)
    with catch_warnings(action="ignore", category=ConservationWarning):  # the table and the exit code report it
        result = simulate(asked.model, asked.state, **settings, path=asked.path, overwrite=overwrite)
        doubted(asked.body, result)
    seconds, record = time.perf_counter() - begun, RunRecord.from_attrs(result.attrs)
    summary = {
        "archive": str(asked.path),
        "figure": str(asked.figure) if figure else None,
        "system": asked.name,
        "method": record.method,
        "options": json.loads(record.options),
        "dt": result.attrs["dt"],  # of a body in s
        "asked_dt": result.attrs.get("asked_dt"),
        "steps": record.steps,
        "rows": int(result.sizes["time"]),
        "seconds": round(seconds, 3),
        "seconds_of_kernels": round(SPENT["kernels"], 3),
        "seconds_of_steps": round(SPENT["steps"], 3),
    }
    if figure:
        from kreisel.viewer.plots import plot as drawn

        output.save_picture(drawn(result), asked.figure)
    title = record.title if asked.body is not None else f"{record.title}: {asked.model}"
    _report(result, summary, [title, *_what_was_done(summary, record.pace)], as_json)


def _what_was_done(summary: dict[str, Any], pace: str) -> list[str]:
    def text(value: Any) -> str:
        return f"({', '.join(map(text, value))})" if isinstance(value, list) else f"{value:g}"

    options = ", ".join(f"{name.replace('_', ' ')} {text(value)}" for name, value in summary["options"].items())
    seconds, kernels, steps = summary["seconds"], summary["seconds_of_kernels"], summary["seconds_of_steps"]
    uses = {"compile or load": kernels, "stepping": steps, "integrals and output": seconds - kernels - steps}
    shares = (f"{name} {f'{share:.2f}' if share >= 0.01 else '< 0.01'} s" for name, share in uses.items())
    done = f"{pace} -> {summary['archive']} ({summary['rows']:,} rows)"
    return [*filter(None, [options]), done, f"Took {seconds:.2f} s: {', '.join(shares)}"]


def _report(result: xr.Dataset, summary: dict[str, Any], lines: list[str], as_json: bool) -> None:
    """Print a run and its drift; exit code 3 if an invariant is not conserved."""
    from kreisel.runs.drift import broken, table_of

    table = table_of(result)
    if as_json:
        print_json({**summary, "drift": output.records(table), "broken": broken(table)})
    else:
        for line in lines:
            say(line)
        output.print_drift(table)
        if summary.get("figure"):
            say(f"figure: {summary['figure']}")
    output.shout(broken(table))


@app.command()
def resume(
    archive: Path = a_path(ARCHIVE, default=...),
    extend: str | None = opt("Lengthen the run to this number of steps; of a body also to '2 h'."),
    config: Path | None = a_path("The TOML file of a run with a controller or a Python file.", "--config"),
    changes: list[str] | None = opt(SET, "--set"),
    as_json: AsJson = False,
) -> None:
    """Resume an interrupted run, bit for bit as if it had not been interrupted; or extend a finished run."""
    from kreisel.cli.configuration import read
    from kreisel.runs.run_record import RunRecord
    from kreisel.storage.simulate import resume as go_on

    end: Any = extend
    with suppress(TypeError, ValueError):  # of None and "2 h"
        end = float(end)
    if changes and config is None:
        raise InputError("--set: expected the file that it changes, --config NAME.toml, got none.")
    system = None
    if config is not None:
        asked = read(config, changes or ())
        system = asked.body or asked.model
    with catch_warnings(action="ignore", category=ConservationWarning):  # the table and the exit code report it
        result = go_on(archive, extend=end, system=system)
    record = RunRecord.from_attrs(result.attrs)
    line = f"{record.title}: {counted(record.steps, 'step')}, {counted(result.sizes['time'], 'row')}"
    _report(result, {"archive": str(archive), "steps": record.steps}, [line], as_json)


@app.command(help=SWEEP_HELP)
def sweep(
    config: Path = a_path(r"A TOML file with a section \[sweep]; `kreisel new NAME --sweep` writes one.", default=...),
    workers: int | None = opt("Processes here, by default one a core; 0: this one, without Dask."),
    scheduler: str | None = opt("The address of a Dask scheduler."),
    overwrite: Overwrite = False,
    as_json: AsJson = False,
    changes: list[str] | None = opt(SET, "--set"),
) -> None:
    """`SWEEP_HELP`."""
    from kreisel.cli.configuration import read_sweep
    from kreisel.storage.opening import open_lanes
    from kreisel.sweeps.sweep import broken_lanes, carry_out, failures

    description, source, path = read_sweep(config, changes or ())
    report = carry_out(description, path, source=source, workers=workers, scheduler=scheduler, overwrite=overwrite)
    result = open_lanes(report.path)
    worst = {str(k): float(v.max()) for k, v in result.data_vars.items() if v.attrs.get("kind") == "drift"}
    largest = {name: output.finite(value) for name, value in worst.items() if name.endswith("_drift")}
    lost = broken_lanes(result, source)
    summary = {
        "archive": str(path),
        "lanes": report.lanes,
        "failed": report.failed,
        "blocks": report.blocks,
        "blocks_before": report.before,
        "seconds": round(report.seconds, 3),
        "memory_MiB": round(report.memory_MiB),
        "largest": largest,
        "broken": lost,
    }
    if as_json:
        print_json(summary)
        return output.shout(lost)
    before = f", {report.before:,} of them done before" if report.before else ""
    say(f"{result.attrs['title']}: {report.blocks:,} blocks{before}, {report.seconds:.2f} s -> {path}")
    for name, value in largest.items():
        say(f"    {name:32}{value:.2e}" if value is not None else f"    {name:32}none")
    if report.failed:
        say(f"{report.failed:,} lanes failed; kr.failures(kr.open_run({str(path)!r})) lists them. The first ones:")
        for lane, row in failures(result).head(3).iterrows():
            say(f"    lane {lane}: {row.message}")
    return output.shout(lost)


@app.command()
def check(
    archive: Path = a_path(ARCHIVE, default=...),
    as_json: AsJson = False,
    out: Path | None = a_path("Write the complete rows to a new archive.", "--recover"),
) -> None:
    """Check an archive: complete, readable, finite, integrals equal to its states', and conserved if they should be."""
    from kreisel.runs.drift import broken, table_of
    from kreisel.runs.run_record import RunRecord
    from kreisel.storage.checking import recover
    from kreisel.sweeps.sweep import broken_lanes, check_archive

    result, faults = check_archive(archive)
    if out is not None:
        kept, rows = recover(archive, out)
        say(f"{out}: {kept:,} of {rows:,} rows are complete", file=sys.stderr)
    table = table_of(result) if result is not None and "kreisel_sweep" not in result.attrs else None
    if result is not None:
        lost = broken(table) if table is not None else [] if faults else broken_lanes(result)
        faults += lost
    if as_json:
        print_json({"archive": str(archive), "faults": faults, "drift": output.records(table)})
    else:
        if table is not None:
            output.print_drift(table)
        for fault in faults:
            say(f"FAULT: {fault}")
        if table is not None and result is not None and (record := RunRecord.from_attrs(result.attrs)).is_own:
            say(f"{record.system} is a user-defined system: its integrals were not computed again")
        cut = ["was interrupted" in fault for fault in faults]
        say(f"{archive}: {'whole' if not faults else 'interrupted' if all(cut) else 'damaged'}")
    if faults:
        raise typer.Exit(1)


@app.command()
def export(
    archive: Path = a_path("An archive of a run or a sweep.", default=...),
    out: Path = a_path("The file to write: .nc, .h5, .parquet, .csv, .npz, .aem, .oem or .bc.", default=...),
    overwrite: bool = opt("Replace the file if it exists.", "--overwrite", default=False),
    epoch: str | None = opt("The date of time 0, for .aem, .oem and .bc."),
    angles: str | None = opt("Add pitch, roll and yaw: orbit, lvlh, inertial or ground."),
    frame: str | None = opt("The frame of space, for .aem, .oem and .bc, such as EME2000."),
    center: str | None = opt("The primary, for .oem, such as SUN."),
    time_system: str | None = opt("Of --epoch, for .aem, .oem and .bc; default UTC."),
    time_unit: float | None = opt("In s, for .aem and .bc, for other runs than of a body."),
    name: str | None = opt("The name of the body, for .aem, .oem and .bc."),
    identifier: str | None = opt("Its international designator, for .aem and .oem, such as 1998-067A."),
    originator: str | None = opt("The creator of the file, for .aem and .oem."),
    spacecraft: int | None = opt("NAIF's number of the spacecraft, for .bc; default -999."),
) -> None:
    """Write an archive as NetCDF (HDF5), Parquet, CSV, NPZ; attitude or orbit as .aem, .oem (CCSDS) or .bc (SPICE)."""
    from kreisel.storage.exporting import export as write
    from kreisel.storage.messages import date_of

    date = None if epoch is None else date_of(epoch, "--epoch")
    labels: dict[str, Any] = {"frame": frame, "center": center, "time_system": time_system, "time_unit": time_unit}
    labels |= {"name": name, "identifier": identifier, "originator": originator, "spacecraft": spacecraft}
    labels = {key: label for key, label in labels.items() if label is not None}
    write(archive, out, overwrite=overwrite, epoch=date, angles=angles, **labels)
    say(f"{archive} -> {out}")


@app.command()
def plot(
    archive: Path = a_path(ARCHIVE, default=...),
    out: Path | None = a_path("Where to; .png, .pdf or .svg.", "--out", "-o"),
    compare: Path | None = a_path("A second archive, drawn in grey.", "--compare"),
    dark: bool = opt("On dark paper.", "--dark", default=False),
    style: str = opt("house, or journal: 183 mm wide, 8 points, a serif face.", default="house"),
    overwrite: OverwriteFile = False,
    show: str | None = opt("The variable of a sweep to draw, a_max[2]."),
) -> None:
    """Draw the figure of an archive; for a sweep, a summary of its lanes over one or two varied quantities."""
    from kreisel.runs.geometry import presented
    from kreisel.storage.archive import settled
    from kreisel.storage.opening import is_sweep, open_lanes, open_rows
    from kreisel.viewer.plots import plot as drawn, sweep_figure

    target = out or (archive if archive.name else archive.resolve()).with_suffix(".png")
    where, theme = settled(archive), "dark" if dark else "light"
    swept = is_sweep(where)
    output.require_figure(target, overwrite)
    if swept and compare:
        raise InputError(f"--compare: expected archives of two runs, got the sweep {archive}. Leave it out.")
    if not swept and show is not None:
        raise InputError(f"--show: expected a sweep, got the run {archive}. Leave it out.")
    second = presented(open_rows(settled(compare))) if compare else None
    picture = (
        sweep_figure(presented(open_lanes(where)), show, theme)
        if swept
        else drawn(presented(open_rows(where)), compare=second, theme=theme, style=style)
    )
    output.save_picture(picture, target, overwrite)
    say(f"figure: {target}")


@app.command()
def view(
    archive: Path = a_path(ARCHIVE, default=...),
    out: Path | None = a_path("Where to; .html.", "--out", "-o"),
    lane: list[int] | None = opt("A trajectory of an ensemble; may be given up to nine times."),
    body: str | None = opt("Its shape: top, gyroscope, ellipsoid, box or satellite."),
    mesh: Path | None = a_path("A file with its shape, .stl or .obj.", "--mesh"),
    title: str | None = opt("A heading in place of the run's."),
    target: str = opt("The target of a satellite: nadir, velocity or sun.", default="nadir", show_default=False),
    movie: Path | None = a_path("Write a film instead: .gif, or .mp4 with ffmpeg.", "--movie"),
    seconds: float | None = opt("The length of the film; default 8."),
    fps: int | None = opt("Pictures per second of the film; default 20."),
    speed: float | None = opt("Of the film, as on the page; default 1."),
    serve: bool = opt("Serve the page and follow an unfinished run.", "--serve", default=False),
    host: str | None = opt("Address of --serve, default 127.0.0.1; others than loopback can be read by anyone there."),
    port: int | None = opt("The port of --serve; 0, the default, selects any free one."),
    overwrite: OverwriteFile = False,
) -> None:
    """Write the interactive page of an archive: one HTML file that opens offline; for a sweep, of one lane."""
    from kreisel.files import require_file
    from kreisel.runs.geometry import presented
    from kreisel.storage.archive import settled
    from kreisel.storage.opening import is_sweep, open_rows
    from kreisel.sweeps.sweep import one_lane
    from kreisel.viewer.page import view as page_of

    where = settled(archive)
    swept = is_sweep(where)
    film = {k: v for k, v in (("seconds", seconds), ("fps", fps), ("speed", speed)) if v is not None}
    options: dict[str, Any] = {"lane": lane or None, "body": body, "mesh": mesh, "title": title, "target": target}
    if film and movie is None:
        raise InputError(f"--{next(iter(film))}: expected a film, --movie NAME.gif, got none.")
    at: dict[str, Any] = {k: v for k, v in (("host", host), ("port", port)) if v is not None}
    if at and not serve:
        raise InputError(f"--{next(iter(at))}: expected an unfinished run to serve, --serve, got none.")
    if serve:
        if out or movie or overwrite:
            raise InputError("--serve: expected no --out, --movie and --overwrite, since it writes no file.")
        if swept:
            raise InputError(f"--serve: expected a run, got the sweep {archive}. `kreisel view` shows a lane.")
        return _serve(archive, **at, **options)
    place = movie or out or (archive if archive.name else archive.resolve()).with_suffix(".html")
    require_file(place, overwrite)
    if swept and len(lane or ()) > 1:
        raise InputError(f"--lane: expected one lane of the sweep {archive}, got {lane}.")
    shown = presented(one_lane(where, lane[0] if lane else 0) if swept else open_rows(where))
    lanes = shown.sizes.get("lane", 1)
    if not swept and not all(0 <= index < lanes for index in lane or ()):
        raise InputError(f"--lane: expected integers from 0 to {lanes - 1}, got {lane}.")
    page = page_of(shown, **options | {"lane": None} if swept else options)
    if movie is not None:
        page.movie(movie, **film)
        say(f"film: {movie}")
        return
    page.save(place)
    say(f"page: {place}")


def _serve(archive: Path, **options: Any) -> None:
    from kreisel.viewer.page import LOOPBACK, address, server

    with server(archive, **options) as serving:
        if serving.host not in LOOPBACK:
            say(f"kreisel: anyone who reaches {serving.host} can read this page", file=sys.stderr)
        say(f"{address(serving)}  (Ctrl-C ends it)")
        try:
            serving.serve_forever()
        except KeyboardInterrupt:
            print("ended", file=sys.stderr)
