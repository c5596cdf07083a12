"""Commands on systems, methods and claims: systems, methods, code, verify, bench, investigate."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import typer

import kreisel
from kreisel.cli import output
from kreisel.cli.new import samples, system_named
from kreisel.cli.output import AsJson, a_path, app, arg, opt, print_json, say, system_names
from kreisel.errors import InputError, require_one_of, shown


@app.command()
def systems(
    name: str | None = arg("One system, for its complete record.", system_names), as_json: AsJson = False
) -> None:
    """List the systems, or print the record of one."""
    from kreisel.bodies import BODIES, KNOWN
    from kreisel.viewer.record import record, summary, table

    _records(name, as_json, system_named, KNOWN.values(), summary, record, table)
    if name is None and not as_json:
        print(f"\nThe last {len(BODIES)} are bodies under forces, in SI units and in axes that suit the equations.")
        print(f"Bodies of kr.physical, for `kreisel new NAME` and [body] of a TOML file: {', '.join(samples())}.")


def _records(
    name: str | None, as_json: bool, find: Any, records: Iterable[Any], summary: Any, record: Any, table: Any
) -> None:
    """Print a record, or a list of all, as text or JSON."""
    if as_json:
        print_json([summary(entry) for entry in records] if name is None else summary(find(name)))
    else:
        print(table(records) if name is None else record(find(name)))


@app.command()
def methods(
    name: str | None = arg("One method, for its complete record.", lambda: [m.name for m in kreisel.methods()]),
    as_json: AsJson = False,
) -> None:
    """List the methods, or print the record of one."""
    from kreisel.method import METHODS, find
    from kreisel.viewer.record import method_record, method_table

    _records(name, as_json, find, METHODS.values(), lambda method: method.summary(), method_record, method_table)


@app.command()
def verify(
    name: str | None = arg("A statement, or the beginning of names, such as theorem."),
    listed: bool = opt("Name the statements without testing them.", "--list", default=False),
    as_json: AsJson = False,
    seed: int = opt("Of the random points, steps and parameters.", default=0, min=0),
) -> None:
    """Every theorem and displayed identity of the paper, exactly over Q and in floats, n = 3 to 6."""
    from rich.console import Console

    from kreisel.lab import paper
    from kreisel.lab.paper import statements

    if listed:
        places = {statement.name: statement.place for statement in statements.chosen(name)}
        if as_json:
            return print_json(places)
        for row, place in places.items():
            say(f"{row:32}{place}")
        return None
    console = Console(stderr=True)
    findings: list[paper.StatementResult] = []
    asked = statements.chosen(name)
    with console.status("") as status:
        for statement in asked:
            status.update(f"{statement.name} ({len(findings) + 1} of {len(asked)})")
            findings.append(paper.tested(statement, seed=seed))
            if not as_json:
                n, over_q, floats, verdict = statements.cells(findings[-1])
                print(f"{statement.name}: {statement.place}\n    {statement.text}")
                print(f"    n = {n}   over Q: {over_q}   floats: {floats}   {verdict}", flush=True)
    failing = [finding.statement.name for finding in findings if not finding.holds]
    if as_json:
        print_json([_as_data(finding) for finding in findings])
    else:
        errata = sum(finding.statement.printed is not None for finding in findings)
        holding = len(findings) - len(failing)
        say(f"{len(findings)} statements, {holding} hold; {errata} printed forms fail, as they should")
    if failing:
        raise typer.Exit(1)


def _as_data(finding: Any) -> dict[str, Any]:
    statement, verdict = finding.statement, {"holds": finding.holds, "verdict": finding.verdict}
    text = {"row": statement.name, "place": statement.place, "statement": statement.text, "erratum": statement.erratum}
    results = {"n": finding.dimensions, "exact": finding.over_q, "float": finding.in_floats, "printed": finding.printed}
    return text | results | verdict


@app.command()
def bench(as_json: AsJson = False) -> None:
    """Measure the speed of each map on this machine, n = 3, against C++ if g++ is installed; about a minute."""
    from rich.console import Console

    from kreisel.bench import bench as measured

    with Console(stderr=True).status("") as status:
        result = measured(lambda name: status.update(f"{name}: kernels are compiled and timed"))
    print_json(result) if as_json else _print_bench(result)


def _print_bench(result: dict[str, Any]) -> None:
    names = [name for name in BENCH_COLUMNS if name in next(iter(result["maps"].values()))]
    rows = [(label, *(f"{row[name]:.2f}" for name in names)) for label, row in result["maps"].items()]
    output.print_table(("map, n = 3", *(BENCH_COLUMNS[name] for name in names)), rows)
    machine, load = result["machine"], f"load average {result['load_average']}"
    print(f"{machine['cpu']}, {machine['cores']} cores; {load}; times are medians, of one core")
    if "note" in result:
        print(result["note"])


BENCH_COLUMNS = {
    "ns_a_step": "ns a step",
    "step_to_cpp": "to C++",
    "ns_a_lane_step": "ns a lane-step",
    "lane_step_to_cpp": "to C++",
    "one_core_to_all": "one core to all",
    "saving": "saving every 100",
}


@app.command()
def investigate(
    subject: str | None = arg("A system, or a Python file with a step, a Lagrangian or a model."),
    eps: str | None = opt("The step, an integer or a fraction; 1/3."),
    n: int | None = opt("The dimension of a system; 3."),
    constants: list[str] | None = opt("A parameter of a system, such as b=1,2,4; may be repeated.", "--set"),
    degree: int | None = opt("Of the integrals that are sought."),
    iterates: int | None = opt("How many degrees."),
    steps: int = opt("Of the orbits for Lyapunov's exponents.", default=10_000),
    seed: int = opt("Of the random points.", default=0),
    html: Path | None = a_path("Write the page to this file, .html.", "--html"),
    as_json: AsJson = False,
) -> None:
    """Is this map integrable?  Poisson, reversible, order, degrees, integrals, Lax pair, chaos; with a verdict."""
    from kreisel.files import place_of_page, require_file
    from kreisel.lab import investigation

    settings: dict[str, Any] = {"eps": eps, "n": n, "degree": degree, "iterates": iterates}
    settings |= {"steps": steps, "seed": seed}
    if subject is None:
        raise InputError("Name a system (kreisel systems) or a Python file: kreisel investigate clebsch.")
    if html is not None:
        require_file(place_of_page(html))
    values = investigation.constants_of(output.parameters_of(constants or ()), "--set")
    settings |= values
    if subject.endswith(".py"):
        report = investigation.investigate_file(Path(subject).expanduser(), **settings)
    else:
        report = investigation.investigate(system_named(subject), **settings)
    if html is not None:
        report.save(html)
    if as_json:
        print_json(investigation.plain_data(report))
    else:
        columns = shutil.get_terminal_size((110, 24)).columns if sys.stdout.isatty() else 110
        print(report.table(max(60, columns)))
        if html is not None:
            say(f"page: {html}")


# -- code ------------------------------------------------------------------------------------------


@app.command()
def code(
    subject: str = arg(
        "free-body, a URDF, SDF, STL, OBJ, PLY or glTF file of one, a system, the TOML file of a run.",
        system_names,
        default=...,
    ),
    language: str = opt("c, cpp, cuda, rust, csharp, js, julia, gdscript, python, wgsl or fmu.", default="c"),
    convention: str | None = opt("ros, unity, unreal, godot, bevy or three."),
    method: str | None = opt(r"As in \[run]; one that makes steps, or exact."),
    order: int | None = opt(r"As in \[run]."),
    dt: float | None = opt("Default value of the step."),
    n: int | None = opt("The dimension, for a system by name; 3."),
    values: list[str] | None = opt("A default value of a parameter: p=0,0,1; once for each.", "--set"),
    orientation: bool = opt("Carry the orientation, for a system by name.", default=True),
    single: bool = opt("Single precision, 32 bits.", "--single", default=False),
    name: str | None = opt("Name of the body, with which names in C begin."),
    link: str | None = opt("The link of a robot."),
    length: str | None = opt("The unit of the coordinates of a mesh: mm."),
    density: str | None = opt("Density of a mesh, kg/m^3."),
    mass: str | None = opt("Mass of a mesh, kg, instead of the density."),
) -> None:
    """Print one short file, without dependencies, with the step of a body: kreisel code free-body --name rock > rock.h.

    Parameters, step and state are arguments of its functions; a TOML file or --set give default values.
    """
    from kreisel.languages.dialects import LANGUAGES
    from kreisel.languages.source import code as text_of

    require_one_of((*LANGUAGES, "fmu"), language, "--language")
    parameters = output.parameters_of(values or ())
    shape = {"link": link, "length": length, "density": density, "mass": mass}
    free = _free_body(subject, parameters, {k: v for k, v in shape.items() if v is not None})
    asked: dict[str, Any] = {"dt": dt, "method": method, "order": order, "name": name, "single": single}
    if n is not None and (free is not None or subject.endswith(".toml")):
        raise InputError(f"--n: not for {shown(subject)}; see kreisel code --help.")
    if not orientation and (free is not None or subject.endswith(".toml")):
        raise InputError(f"--no-orientation: not for {shown(subject)}; see kreisel code --help.")
    if free is None:
        free, asked["x0"] = _example_or_run(subject, parameters, asked, 3 if n is None else n, orientation)
    asked["dt"] = 1 / 60 if asked["dt"] is None else asked["dt"]
    if language != "fmu":
        print(text_of(free, language=language, convention=convention, **asked), end="")
        return
    if "x0" in asked or convention or method or order or single:
        raise InputError("--language fmu: expected free-body, or a file of its shape, and only --set, --dt, --name.")
    if sys.stdout.isatty():
        raise InputError("--language fmu: expected a file for the archive: kreisel code ... > rock.fmu")
    from kreisel.languages.source import fmu

    sys.stdout.buffer.write(fmu(name or "free_body", text_of(free, **asked), free.inertia, asked["dt"]))


def _example_or_run(subject: str, values: dict[str, Any], asked: dict[str, Any], n: int, oriented: bool) -> Any:
    """The model and the state of a system by name, or of a TOML file, whose settings complete `asked`."""
    from kreisel.cli.configuration import read
    from kreisel.runs.examples import example

    if not subject.endswith(".toml"):
        sample = example(system_named(subject), n, values)
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
    asked["dt"] = file.run.dt if asked["dt"] is None else asked["dt"] / file.model.body_frame.size("time")
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
