"""A page for each system, from its record: equations by SymPy, parameters, integrals, Lax pair, maps, a figure."""

from __future__ import annotations

import inspect
from pathlib import Path
from typing import Any

import numpy as np
from typeset import from_text, prose, space, typeset

import kreisel as kr
from kreisel.errors import InputError
from kreisel.lab import exact
from kreisel.method import METHODS, default_method, scheme
from kreisel.record.contract import Map, System
from kreisel.record.spheres import SPINS_SPACE
from kreisel.system import NAMED, REGISTRY
from kreisel.viewer.record import MAP_CLAIMS

KINDS = {"skew": r"\mathfrak{so}(n)", "vector": r"\mathbb{R}^n", "symmetric": r"\operatorname{Sym}(n)"}
EXAMPLES: dict[str, tuple[dict[str, Any], dict[str, Any], float]] = {  # parameters, state, step
    "heavy-top": ({"J": (1.0, 1.3, 0.6), "A": (0.3, 0.2, 0.9)}, {"M": (0.4, 1.0, 1.6), "P": (0.6, 0.0, 0.8)}, 0.05),
    "lagrange-top": ({"p": (0, 0, 1)}, {"m": (0.1, 0.2, 1.5), "a": (0.6, 0, 0.8)}, 0.05),
    "lagrange-top-moving": ({"A": (0, 0, 1), "alpha": 0.6}, {"M": (0.3, 0.5, 1.4), "P": (0.6, 0, 0.8)}, 0.05),
    "symmetric-top": ({"A": (0, 0, 1)}, {"M": (0.3, 0.5, 1.4), "P": (0.6, 0, 0.8)}, 0.05),
    "kirchhoff": (
        {"C": [[0, 0.5, 0.8], [0.5, 0, 1.2], [0.8, 1.2, 0]], "B": (-0.9, -0.7, -0.4)},
        {"M": (0.5, 0.9, 0.4), "P": (0.6, 0.3, 0.9)},
        0.1,
    ),
    "clebsch-general": ({"a": (1, 4, 9), "b": (1, 2, 3)}, {"M": (1.1, -0.6, 2.0), "P": (0.6, 0.3, 0.9)}, 0.1),
    "kirchhoff-revolution": (
        {"a1": 0.8, "a3": 1.7, "c1": 0.5, "c3": 0.9},
        {"M": (0.5, 0.9, 0.4), "P": (0.6, 0.48, 0.64)},
        0.1,
    ),
    "clebsch": ({"b": (0.2, 1.0, 2.1)}, {"M": (0.5, 0.9, 0.4), "P": (0.6, 0.48, 0.64)}, 0.1),
    "zhukovsky-volterra": ({"J": (0.7, 1.1, 1.6), "h": (0.3, -0.5, 0.8)}, {"M": (0.9, -0.4, 1.3)}, 0.05),
    "neumann": ({"b": (0.0, -0.8, -2.1)}, {"x": (0.6, 0.0, 0.8), "q": (0.4, 0.9, -0.3)}, 0.1),
}


def write(docs: Path, one: str = "") -> None:
    """generated/systems/index.md, or the page of one system with its figure."""
    folder = docs / "generated" / "systems"
    (folder / "figures").mkdir(parents=True, exist_ok=True)
    names = {system.name: name for name, system in NAMED.items()}
    if one:
        (folder / f"{one}.md").write_text(page(REGISTRY[one], names[one], folder / "figures"), encoding="utf-8")
        return
    rows = "\n".join(_row(system, names[system.name]) for system in REGISTRY.values())
    head = "| system | equations | default method | Lax pair |\n|---|---|---|---|\n"
    entries = "\n".join(REGISTRY)
    (folder / "index.md").write_text(
        f"# Systems\n\n{INTRODUCTION}\n\n{head}{rows}\n\n```{{toctree}}\n:hidden:\n\n{entries}\n```\n", encoding="utf-8"
    )


INTRODUCTION = """Made from the records: what is here is what the code states of itself, and what `kreisel.lab.laws` \
tests. `kreisel systems NAME` prints the same in a terminal. A system is called with its parameters and gives a model: \
`kr.LagrangeTop(p=(0, 0, 1))`. Any n ≥ 3 is allowed; n is the length of the vectors. The conventions are on \
[a page of their own](../../conventions.md)."""


def _row(system: System, name: str) -> str:
    lax = "yes" if system.lax is not None else "no"
    method = _default(system)
    equations = "<br>".join(f"${from_text(part)}$" for part in system.equations.split(",  "))
    return f"| [`{name}`]({system.name}.md)<br>{system.title} | {equations} | {method} | {lax} |"


def _default(system: System) -> str:
    """The default method, for n = 3 and for more."""
    draw = exact.float_random(np.random.default_rng(1))
    models = [exact.random_model(system, n, draw) for n in ((3, 4) if system.n is None else (system.n,))]
    names = [default_method(model) for model in models]
    return f"`{names[0]}`" if len({*names}) == 1 else f"`{names[0]}` (n = 3), `{names[1]}`"


def _example(system: System) -> tuple[Any, Any, float]:
    """Model, state and step of the figure; random ones for a system that has none here."""
    if system.name in EXAMPLES:
        params, state, dt = EXAMPLES[system.name]
        model = system(**params)
        return model, model.state(**state), dt
    draw = exact.float_random(np.random.default_rng(1))
    model = exact.random_model(system, system.n or 3, draw)
    state = system.space.point(model.n, draw)
    return model, model.state(**dict(zip(system.space.letters, state, strict=True))), 0.02


def page(system: System, name: str, figures: Path) -> str:
    """The page of a system."""
    model, x0, dt = _example(system)
    run = kr.simulate(model, x0, dt=dt, steps=10_000, every=2)
    kr.plot(run).savefig(figures / f"{system.name}.png", dpi=110)
    state = r",\ ".join(rf"{letter} \in {KINDS.get(kind, kind)}" for letter, kind in system.space.components)
    bracket = "plus" if system.space.sign > 0 else "minus"
    parts = [
        f"# {system.title}",
        f"`kr.{name}`, in TOML files `{system.name}`. {system.source}.",
        f"$$\n{from_text(system.equations)}\n$$",
        f"State ${state}$, a point of ${space(system.space.name)}$, in the {system.frame.value} frame. "
        f"{bracket.capitalize()} bracket, $F' = \\{{H, F\\}}$.",
        *(["## Parameters", _parameters(system)] if system.parameters else []),
        prose(system.scaling),
        "## Integrals",
        _integrals(model, dt),
        *([prose(system.notes)] if system.notes else []),
        *_components(system),
        *_lax(system),
        *_map(system),
        *_relations(system),
        "## A run",
        f"`{model!r}`, {run.attrs['steps']:,} steps of {dt:g} by the default method, `{run.attrs['method']}`.",
        f"![Left: the path on the sphere. Right: the change of each integral]({Path('figures') / system.name}.png)",
    ]
    return "\n\n".join(parts) + "\n"


def _parameters(system: System) -> str:
    rows = ["| parameter | kind | meaning | default | range |", "|---|---|---|---|---|"]
    for p in system.parameters:
        default = "none" if p.default is None else f"{p.default:g}" if np.ndim(p.default) == 0 else str(p.default)
        condition = inspect.getdoc(p.check) if p.check is not None else None
        valid = condition or (f"{p.check.__name__.replace('_', ' ')}" if p.check is not None else "any")
        rows.append(f"| `{p.letter}` | {p.kind} | {_math(p.meaning)} | {default} | {_math(valid)} |")
    return "\n".join(rows)


def _math(text: str) -> str:
    """A cell with formulas."""
    return prose(text.replace("\n", " ")).replace("|", r"\|")


def _integrals(model: Any, dt: float) -> str:
    """What is in a run, and which method conserves it, by what each method that takes the system says."""
    variables: dict[str, tuple[str, list[str]]] = {}
    for method in METHODS:
        try:
            outcomes = scheme(model, method, dt, None, False).outcomes
        except InputError:
            continue
        for name, outcome in outcomes.items():
            if outcome.kind in ("casimir", "integral", "relation"):
                variables.setdefault(name, (outcome.meaning, []))[1].extend([f"`{method}`"] * outcome.conserved)
    rows = [
        f"| `{name}` | {_meaning(meaning)} | {', '.join(kept) or 'no method'} |"
        for name, (meaning, kept) in variables.items()
    ]
    return "\n".join(["| variable | meaning | conserved by |", "|---|---|---|", *rows])


def _meaning(text: str) -> str:
    """What a variable of a run means; a phase space in it is typeset."""
    if text.startswith("Casimirs of "):
        name, comma, rest = text.removeprefix("Casimirs of ").partition(", ")
        return f"Casimirs of ${space(name)}${comma}{prose(rest)}"
    return prose(text)


def _components(system: System) -> list[str]:
    """Hamiltonian and equations for n = 3, derived by SymPy from the record's functions."""
    if system.numbers != "any" or system.flow is None:
        return []
    try:
        symbolic = typeset(system)
        lines = [rf"{left} &= {right}" for left, right in symbolic.components()]
        energy = symbolic.energy()
    except InputError:  # a component or a parameter without symbols
        return []
    skew = [letter for letter, kind in system.space.components if kind == "skew"]
    skew = skew if symbolic.n == 3 else []
    axial = f"; ${', '.join(f'{x}_i' for x in skew)}$ are the components of the axial vector" if skew else ""
    vector = next((p.letter for p in system.parameters if p.kind == "vector"), "")
    axis = f" and ${vector} = (0, 0, 1)$" if symbolic.on_axis else ""
    diagonal = [p.letter for p in system.parameters if p.kind == "symmetric"]
    principal = f", principal axes of ${', '.join(diagonal)}$" if diagonal else ""
    rows = " \\\\\n".join(lines)
    return [
        "## In components",
        f"$n = {symbolic.n}${axis}{principal}{axial}.",
        f"$$\nH = {energy}\n$$",
        f"$$\n\\begin{{aligned}}\n{rows}\n\\end{{aligned}}\n$$",
    ]


def _lax(system: System) -> list[str]:
    if system.lax is None:
        return []
    of_pencil = system.map is not None and system.map.pencil is not None
    listed = "values" if of_pencil else "the coefficients"
    note = f"; `spectrum` lists {listed} of $\\det(L(\\lambda) - \\mu)$"
    out = ["## Lax pair", f"$L' = [L, U]${note if 'spectrum' in system.integrals else ''}."]
    if system.numbers == "any":
        try:
            L, U = typeset(system).lax()
        except InputError:
            return out
        out += [f"$$\nL = {L}\n$$", f"$$\nU = {U}\n$$"]
    return out


def _map(system: System) -> list[str]:
    if system.map is None:
        other = "midpoint" if system.space is SPINS_SPACE else "dop853"
        return [
            "## Discretization",
            "No map that conserves its integrals is built here; the default is "
            + ("the variational integrator." if system.inverse_inertia is not None else f'`method="{other}"`.'),
        ]
    phi: Map = system.map
    known = [words for claim, words in MAP_CLAIMS.items() if getattr(phi, claim) is not None]
    out = [
        "## Discretization",
        f"{phi.source}. Order {phi.order}"
        + (', 2 after half a kick (`method="suris"`)' if phi.to_symmetric is not None else "")
        + f". Stated and tested: {', '.join(known)}.",
        "As it stands in the code:",
        f"```python\n{_source(phi.step)}\n```",
    ]
    if system.baecklund is not None:
        out.append(f'`method="baecklund"`: {prose(system.baecklund.source)}; see [its page](../../baecklund.md).')
    return out


def _source(function: Any) -> str:
    try:
        return inspect.getsource(function).strip()
    except OSError:
        return repr(function)


def _relations(system: System) -> list[str]:
    rows = [f"- [`{r.target}`]({r.target}.md): {prose(r.meaning)}" for r in system.relations]
    return ["## Related", "\n".join(rows)] if rows else []
