"""Commands on systems, methods and claims: systems, methods, code, verify, bench, investigate."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from kreisel.cli.output import (
    AsJson,
    a_path,
    app,
    finding_data,
    method_names,
    parameter_of,
    print_finding,
    print_json,
    say,
    system_names,
    width,
)
from kreisel.errors import InputError, shown


@app.command()
def systems(
    name: Annotated[
        str | None, typer.Argument(help="One system, for its complete record.", autocompletion=system_names)
    ] = None,
    as_json: AsJson = False,
) -> None:
    """List the systems, or print the record of one."""
    from kreisel.bodies import BODIES, KNOWN, find
    from kreisel.cli.bodies import SAMPLES
    from kreisel.viewer.record import record, summary, table

    if name is not None:
        system = find(name)
        print(json.dumps(summary(system), indent=1) if as_json else record(system))
    elif as_json:
        print_json([summary(system) for system in KNOWN.values()])
    else:
        print(table(KNOWN.values()))
        print(f"\nThe last {len(BODIES)} are bodies under forces, in SI units and in axes that suit the equations.")
        print(f"Bodies of kr.physical, for `kreisel new NAME` and [body] of a TOML file: {', '.join(SAMPLES)}.")


@app.command()
def methods(
    name: Annotated[
        str | None, typer.Argument(help="One method, for its complete record.", autocompletion=method_names)
    ] = None,
    as_json: AsJson = False,
) -> None:
    """List the methods, or print the record of one."""
    from kreisel.method import METHODS, find
    from kreisel.viewer.record import method_record, method_table

    if name is not None:
        method = find(name)
        print(json.dumps(method.summary(), indent=1) if as_json else method_record(method))
    elif as_json:
        print_json([method.summary() for method in METHODS.values()])
    else:
        print(method_table(METHODS.values()))


@app.command()
def verify(
    name: Annotated[str | None, typer.Argument(help="A statement, or the beginning of names, such as theorem.")] = None,
    listed: Annotated[bool, typer.Option("--list", help="Name the statements without testing them.")] = False,
    as_json: AsJson = False,
    seed: Annotated[int, typer.Option(min=0, help="Of the random points, steps and parameters.")] = 0,
) -> None:
    """Every theorem and displayed identity of the paper, exactly over Q and in floats, n = 3 to 6."""
    from rich.console import Console

    from kreisel.lab import paper
    from kreisel.lab.paper import statements

    if listed:
        for statement in statements.chosen(name):
            say(f"{statement.name:32}{statement.place}")
        return
    console = Console(stderr=True)
    findings: list[paper.StatementResult] = []
    asked = statements.chosen(name)
    with console.status("") as status:
        for statement in asked:
            status.update(f"{statement.name} ({len(findings) + 1} of {len(asked)})")
            findings.append(paper.tested(statement, seed=seed))
            if not as_json:
                print_finding(findings[-1])
    if as_json:
        print_json([finding_data(finding) for finding in findings])
    failing = [finding.statement.name for finding in findings if not finding.holds]
    if not as_json:
        errata = sum(finding.statement.printed is not None for finding in findings)
        holding = len(findings) - len(failing)
        say(f"{len(findings)} statements, {holding} hold; {errata} printed forms fail, as they should")
    if failing:
        raise typer.Exit(1)


@app.command()
def bench(as_json: AsJson = False) -> None:
    """Measure the speed of each map on this machine, n = 3, against C++ if g++ is installed; about a minute."""
    from rich.console import Console

    from kreisel.bench import bench as measured

    with Console(stderr=True).status("") as status:
        result = measured(lambda name: status.update(f"{name}: kernels are compiled and timed"))
    if as_json:
        print_json(result)
        return
    _print_bench(result)


BENCH_COLUMNS = {
    "ns_a_step": "ns a step",
    "step_to_cpp": "to C++",
    "ns_a_lane_step": "ns a lane-step",
    "lane_step_to_cpp": "to C++",
    "one_core_to_all": "one core to all",
    "saving": "saving every 100",
}


def _print_bench(result: dict[str, Any]) -> None:
    from rich.console import Console
    from rich.table import Table

    grid = Table(box=None, pad_edge=False, header_style="bold")
    grid.add_column("map, n = 3")
    shown = [name for name in BENCH_COLUMNS if name in next(iter(result["maps"].values()))]
    for name in shown:
        grid.add_column(BENCH_COLUMNS[name], justify="right")
    for label, row in result["maps"].items():
        grid.add_row(label, *(f"{row[name]:.2f}" for name in shown))
    Console(width=None if sys.stdout.isatty() else 110, highlight=False).print(grid)
    machine = result["machine"]
    load = f"load average {result['load_average']}"
    print(f"{machine['cpu']}, {machine['cores']} cores; {load}; times are medians, of one core")
    if "note" in result:
        print(result["note"])


@app.command()
def investigate(
    subject: Annotated[
        str | None, typer.Argument(help="A system, or a Python file with a step, a Lagrangian or a model.")
    ] = None,
    eps: Annotated[str | None, typer.Option("--eps", help="The step, an integer or a fraction; 1/3.")] = None,
    n: Annotated[int | None, typer.Option("--n", help="The dimension of a system; 3.")] = None,
    constants: Annotated[
        list[str] | None, typer.Option("--set", help="A parameter of a system, such as b=1,2,4; may be repeated.")
    ] = None,
    degree: Annotated[int | None, typer.Option("--degree", help="Of the integrals that are sought.")] = None,
    iterates: Annotated[int | None, typer.Option("--iterates", help="How many degrees.")] = None,
    steps: Annotated[int, typer.Option("--steps", help="Of the orbits for Lyapunov's exponents.")] = 10_000,
    seed: Annotated[int, typer.Option("--seed", help="Of the random points.")] = 0,
    html: Annotated[Path | None, a_path("Write the page to this file.", "--html")] = None,
    as_json: AsJson = False,
) -> None:
    """Is this map integrable?  Poisson, reversible, order, degrees, integrals, Lax pair, chaos; with a verdict."""
    from kreisel.files import require_file
    from kreisel.lab import investigation

    settings: dict[str, Any] = {
        "eps": eps,
        "n": n,
        "degree": degree,
        "iterates": iterates,
        "steps": steps,
        "seed": seed,
    }
    if subject is None:
        raise InputError("Name a system (kreisel systems) or a Python file: kreisel investigate clebsch.")
    if html is not None:
        require_file(html)
    values = investigation.constants_of(dict(parameter_of(text) for text in constants or []), "--set")
    file = subject.endswith(".py")
    report = (
        investigation.investigate_file(Path(subject).expanduser(), **{**settings, **values})
        if file
        else investigation.investigate(subject, **{**settings, **values})
    )
    if html is not None:
        report.save(html)
    if as_json:
        print_json(investigation.plain_data(report))
    else:
        print(investigation.terminal_table(report, width()))
        if html is not None:
            say(f"page: {html}")


# -- code ------------------------------------------------------------------------------------------


@app.command()
def code(
    subject: Annotated[
        str,
        typer.Argument(
            help="free-body, a URDF, SDF, STL, OBJ, PLY or glTF file of one, a system, the TOML file of a run.",
            autocompletion=system_names,
        ),
    ],
    language: Annotated[
        str, typer.Option(help="c, cpp, cuda, rust, csharp, js, julia, gdscript, python, wgsl or fmu.")
    ] = "c",
    convention: Annotated[str | None, typer.Option(help="ros, unity, unreal, godot, bevy or three.")] = None,
    method: Annotated[str | None, typer.Option(help=r"As in \[run]; one that makes steps, or exact.")] = None,
    order: Annotated[int | None, typer.Option(help=r"As in \[run].")] = None,
    dt: Annotated[float | None, typer.Option(help="Default value of the step.")] = None,
    n: Annotated[int, typer.Option("--n", help="The dimension, for a system by name.")] = 3,
    values: Annotated[
        list[str] | None, typer.Option("--set", help="A default value of a parameter: p=0,0,1; once for each.")
    ] = None,
    orientation: Annotated[
        bool, typer.Option("--orientation/--no-orientation", help="Carry the orientation, for a system by name.")
    ] = True,
    single: Annotated[bool, typer.Option("--single", help="Single precision, 32 bits.")] = False,
    name: Annotated[str | None, typer.Option(help="Name of the body, with which names in C begin.")] = None,
    link: Annotated[str | None, typer.Option(help="The link of a robot.")] = None,
    length: Annotated[str | None, typer.Option(help="The unit of the coordinates of a mesh: mm.")] = None,
    density: Annotated[str | None, typer.Option(help="Density of a mesh, kg/m^3.")] = None,
    mass: Annotated[str | None, typer.Option(help="Mass of a mesh, kg, instead of the density.")] = None,
) -> None:
    """Print one short file, without dependencies, with the step of a body: kreisel code free-body --name rock > rock.h.

    Parameters, step and state are arguments of its functions; a TOML file or --set give default values.
    """
    from kreisel.languages.source import code as text_of

    given = dict(parameter_of(text) for text in values or ())
    shape = {"link": link, "length": length, "density": density, "mass": mass}
    free = _free_body(subject, given, {k: v for k, v in shape.items() if v is not None})
    asked: dict[str, Any] = {"dt": dt, "method": method, "order": order, "name": name, "single": single}
    if free is None:
        free, asked["x0"] = _example_or_run(subject, given, asked, n, orientation)
    asked["dt"] = 1 / 60 if asked["dt"] is None else asked["dt"]
    if language != "fmu":
        print(text_of(free, language=language, convention=convention, **asked), end="")
        return
    if "x0" in asked or convention or method or order or single:
        raise InputError("--language fmu: expected a free body in SI units, and of the options --set, --dt, --name.")
    if sys.stdout.isatty():
        raise InputError("--language fmu: expected a file for the archive: kreisel code ... > rock.fmu")
    from kreisel.languages.fmu import fmu

    sys.stdout.buffer.write(fmu(name or "free_body", text_of(free, **asked), free.inertia, asked["dt"]))


def _example_or_run(subject: str, values: dict[str, Any], asked: dict[str, Any], n: int, oriented: bool) -> Any:
    """The model and the state of a system by name, or of a TOML file, whose settings complete `asked`."""
    from kreisel.bodies import find
    from kreisel.cli.configuration import read
    from kreisel.runs.examples import example

    if not subject.endswith(".toml"):
        sample = example(find(subject), n, values)
        if oriented and sample.model.system.velocity is not None:
            asked["orientation"] = (
                [1.0, 0.0, 0.0, 0.0] if n == 3 else [[float(i == j) for j in range(n)] for i in range(n)]
            )
        return sample.model, sample.model.state(**sample.state)
    if values:
        raise InputError("--set: expected a system by name, got a TOML file, which has its parameters itself.")
    file = read(Path(subject).expanduser())
    asked |= {"orientation": file.orientation, "method": asked["method"] or file.run.method}
    asked["order"] = file.run.order if asked["order"] is None and isinstance(file.run.order, int) else asked["order"]
    asked["dt"] = file.run.dt if asked["dt"] is None else asked["dt"]
    return file.model, file.state


def _free_body(subject: str, values: dict[str, Any], shape: dict[str, str]) -> Any:
    """The free body of a name with moments I, or of a file with a shape or a robot; None for another subject."""
    from kreisel.physical import FreeBody
    from kreisel.physical.shapes import SUFFIXES, read_mesh, read_robot

    suffix, file = Path(subject).suffix.lower(), str(Path(subject).expanduser())
    kinds = {"link": (".urdf", ".sdf"), **dict.fromkeys(("length", "density", "mass"), SUFFIXES)}
    wrong = [f"--{k}" for k in shape if suffix not in kinds[k]] + ["--set"] * bool(
        values and suffix in (*SUFFIXES, ".urdf", ".sdf")
    )
    if wrong:
        raise InputError(f"{wrong[0]}: not for {shown(subject)}; see kreisel code --help.")
    if suffix in kinds["link"]:
        return FreeBody(read_robot(file, **shape).inertia)
    if suffix in SUFFIXES:
        return FreeBody(read_mesh(file, **shape).inertia)
    if subject != "free-body":
        return None
    if values.keys() - {"I"}:
        raise InputError(f"--set: expected I=1,2,2.5, the principal moments of a free body, got {', '.join(values)}.")
    moments = values.get("I", (1, 2, 2.5))
    return FreeBody([float(x) for x in moments] if isinstance(moments, list | tuple) else moments)
