"""The public functions that are called, with the kinds of their arguments and how often."""

from __future__ import annotations

from typing import Any

from arguments import Around, Call, Function, value
from calls import ignored
from surface import calls_of_surface


def _of(path: str) -> Function:
    """A function by its name, looked up when it is called."""

    def get(here: Around) -> Function:
        import kreisel

        found: Any = kreisel
        for part in path.split("."):
            found = getattr(found, part)
        return found

    return get


def call(name: str, *given: str, **options: Any) -> Call:
    """A call; keywords that end in _ say more of it, the others are kinds of keyword arguments."""
    more = {k[:-1]: v for k, v in options.items() if k.endswith("_")}
    keywords = {k: v for k, v in options.items() if not k.endswith("_")}
    function = more.pop("function", None) or _of(name)
    optional = tuple(more.pop("optional", "").split())
    return Call(name, function, given, keywords, optional, **more)


RUN = {"dt": "dt", "steps": "steps", "every": "every", "method": "method", "order": "order", "tol": "tol"}
MORE = {"orientation": "orientation", "engine": "engine", "progress": "progress"}
MAY = "every method order tol orientation engine path overwrite"


def _made(here: Around) -> Function:
    """A system by name, with parameters of which some are odd."""
    from kreisel.system import find

    return lambda name, parameters: find(name)(**parameters)


def _state_of(here: Around) -> Function:
    return lambda model, parts: model.state(**parts)


def _flow(here: Around) -> Function:
    return lambda model, parts: model.flow(*model.state(**parts).values())


def _shown(here: Around) -> Function:
    return lambda model, parts: [
        repr(model),
        model._repr_html_(),
        (x := model.state(**parts)).axial,
        repr(x),
        x._repr_html_(),
    ]


def _component(here: Around) -> Function:
    return lambda model, parts, name: getattr(model.state(**parts), name)


def _accessor(name: str) -> Function:
    return lambda here: lambda run, **more: getattr(run.kreisel, name)(**more)


def _text(here: Around) -> Function:
    return lambda run: [repr(run.kreisel), run.kreisel._repr_html_(), run.kreisel.cite()]


def _ensemble(here: Around) -> Function:
    import kreisel as kr

    def ensemble(model: Any, parts: Any, **options: Any) -> Any:
        varied = {name: options.pop(name) for name in ("grid", "together", "random", "draws", "rng") if name in options}
        return kr.sweep(model, parts, kr.Design(**varied), path=here.folder / "s.zarr", workers=0, **options).load()

    return ensemble


def _chart(name: str, analysis: str) -> Function:
    def get(here: Around) -> Function:
        from kreisel import analysis as of
        from kreisel.viewer import charts

        def draw(run: Any, *given: Any, theme: str = "light") -> None:
            getattr(charts, name)(getattr(of, analysis)(run, *given), theme=theme)

        return draw

    return get


def _law(here: Around) -> Function:
    from kreisel.lab import laws

    return lambda model, seed: laws.check(model, dimensions=(model.n,), numbers=("float",), seeds=(seed,))


def _parameters(here: Around, rng: Any, options: dict[str, Any]) -> Any:
    import grammar

    from kreisel.system import REGISTRY

    name = options.get("name") or "lagrange-top"
    system = REGISTRY.get(name, REGISTRY["lagrange-top"])
    good = grammar.parameters(system, grammar.dimension(system, rng), rng)
    out = {k: grammar.maybe_python(v, rng, 0.3) for k, v in good.items()}
    if rng.random() < 0.05:
        out[rng.choice(["x", "P", "alpha", "b"])] = grammar.odd(rng, True)
    return out


def _system_name(here: Around, rng: Any, options: dict[str, Any]) -> Any:
    from kreisel.system import REGISTRY

    options["name"] = rng.choice(list(REGISTRY))
    return options["name"]


def kinds() -> None:
    """Kinds that are only needed here."""
    from arguments import KINDS

    KINDS.update({"system name": _system_name, "parameters": _parameters})


def _stepped(model: Any, state: Any, steps: Any, **options: Any) -> Any:
    from kreisel.runs.propagation.propagator import propagator

    return propagator(model, **options).steps(state, steps)


def _placed(model: Any, state: Any, times: Any, **options: Any) -> Any:
    from kreisel.runs.propagation.propagator import propagator

    return propagator(model, **options).at(state, times)


def _arrays(found: Any) -> list[Any]:
    return list(found.values()) if isinstance(found, dict) else [found]


def calls() -> list[Call]:
    """Every function that is called."""
    return [
        *calls_of_surface(),
        call("model", "system name", "parameters", function_=_made, then_=ignored, weight_=14),
        call("model.state", "model", "parts", function_=_state_of, weight_=14),
        call("model.flow", "model", "parts", function_=_flow, weight_=4, infinite_=True),
        call("model.repr", "model", "parts", function_=_shown, then_=ignored, weight_=2),
        call("model.component", "model", "parts", "name", function_=_component, weight_=1, attribute_=True),
        call("simulate", "model", "state", **RUN, **MORE, optional_=MAY, weight_=10),
        call("simulate", "model", "state", **RUN, **MORE, path="path", overwrite="flag", optional_=MAY, weight_=2),
        call("at", "model", "state", "times", method="method", dt="dt", order="order", orientation="orientation",
             optional_="method dt order orientation", weight_=6),
        call("propagator", "model", "state", "steps", dt="dt", method="method", order="order", project="flag",
             function_=_stepped, then_=_arrays, optional_="dt method order project", weight_=2),
        call("propagator", "model", "state", "times", dt="dt", method="method", order="order", function_=_placed,
             then_=_arrays, optional_="dt method order", weight_=1),
        call("drift", "run", weight_=3, infinite_=True),
        call("cite", "run"),
        call("cite", "anything"),
        call("plot", "run", compare="run", theme="theme", optional_="compare theme", then_=ignored, weight_=0.3),
        call("open_run", "store", then_=lambda run: run.load(), weight_=2, infinite_=True),
        call("open_run", "anything", then_=ignored, weight_=2),
        call("resume", "copy", extend="extend", progress="progress", weight_=0.6),
        call("resume", "anything", extend="extend", progress="progress", weight_=1),
        call("export", "run", "file", overwrite="flag", optional_="overwrite", weight_=0.7),
        call("export", "store", "file", overwrite="flag", optional_="overwrite", weight_=0.5),
        call("failures", "run"),
        call("systems"),
        call("view", "run", lane="lane", optional_="lane", then_=ignored, weight_=0.5),
        call("sweep", "model", "state", dt="dt", steps="steps", every="every", grid="grid", together="listed",
             random="random", draws="count", rng="seed", save="save", function_=_ensemble, weight_=0.8,
             infinite_=True, optional_="every grid together random draws rng save"),
        call("accessor.plot", "dataset", function_=_accessor("plot"), then_=ignored, weight_=0.1),
        call("accessor.view", "dataset", function_=_accessor("view"), then_=ignored, weight_=0.2),
        call("accessor.drift", "dataset", function_=_accessor("drift"), infinite_=True),
        call("accessor.text", "dataset", function_=_text, then_=ignored, weight_=0.5),
        call("charts.series", "run", theme="theme", function_=_chart("plot_series", "euler_angles"), weight_=0.1),
        call("charts.lines", "run", "quantity", function_=_chart("plot_lines", "frequencies"), weight_=0.1),
        call("charts.comparison", "run", "run", function_=_chart("plot_comparison", "compare"), weight_=0.1),
        call("lab.laws.check", "model", "seed", function_=_law, weight_=0.05, then_=ignored),
    ]  # fmt: skip


__all__ = ["calls", "kinds", "value"]
