"""The command code: a step as a file of C, JavaScript or Julia."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from kreisel.cli.output import app, parameter_of, system_names
from kreisel.errors import InputError


@app.command()
def code(
    subject: Annotated[
        str, typer.Argument(help="A system by name, or the TOML file of a run.", autocompletion=system_names)
    ],
    language: Annotated[str, typer.Option(help="c, js or julia.")] = "c",
    method: Annotated[str | None, typer.Option(help=r"As in \[run]; one that makes steps, or exact.")] = None,
    order: Annotated[int | None, typer.Option(help=r"As in \[run].")] = None,
    dt: Annotated[float | None, typer.Option(help="The step; 0.01 for a system by name.")] = None,
    n: Annotated[int, typer.Option("--n", help="The dimension, for a system by name.")] = 3,
    given: Annotated[
        list[str] | None, typer.Option("--set", help="A parameter of a system by name: p=0,0,1; once for each.")
    ] = None,
    orientation: Annotated[
        bool, typer.Option("--orientation/--no-orientation", help="Carry the orientation, for a system by name.")
    ] = True,
    project: Annotated[
        bool, typer.Option("--project/--no-project", help="Put the state back on what is conserved.")
    ] = True,
    name: Annotated[
        str | None, typer.Option(help="Of the body, which names in C begin with; by default of the content.")
    ] = None,
) -> None:
    """Print one file, without dependencies, with the step of a body: kreisel code euler-top --name rock > rock.h.

    A TOML file says the parameters, the state, the step and the method; for a system by name they are examples, but for
    what is set.
    """
    from kreisel.bodies import find
    from kreisel.languages.source import code as text_of
    from kreisel.runs.config import load_system, read
    from kreisel.runs.examples import example

    g: Any = None
    if subject.endswith(".toml"):
        if given:
            raise InputError("--set: expected a system by name, got a TOML file, which has its parameters itself.")
        asked = read(Path(subject).expanduser())
        model = load_system(asked.name, asked.file)(**asked.parameters)
        state, g, run = asked.state, asked.orientation, asked.run
        method, project = method or run.method, project and run.project
        order = order if order is not None or not isinstance(run.order, int) else run.order
        dt = run.dt if dt is None else dt
    else:
        made = example(find(subject), n, dict(parameter_of(text) for text in given or ()))
        model, state = made.model, made.state
        if orientation and model.system.velocity is not None:
            g = [1.0, 0.0, 0.0, 0.0] if model.n == 3 else [[float(i == j) for j in range(n)] for i in range(n)]
        dt = 0.01 if dt is None else dt
    body = model.state(**state)
    settings: dict[str, Any] = {"method": method, "order": order, "orientation": g, "project": project, "name": name}
    print(text_of(model, body, dt=dt, language=language, **settings), end="")
