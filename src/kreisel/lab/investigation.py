"""kr.lab.investigate: every instrument of the laboratory on one map, and the page of the verdict."""

from __future__ import annotations

import inspect
import io
import math
import os
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from fractions import Fraction
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from kreisel.bodies import find
from kreisel.errors import InputError, explained, shown
from kreisel.files import place_of_page, written
from kreisel.lab.dynamics import FEWEST
from kreisel.lab.exact import fraction
from kreisel.lab.integrals import TooLarge
from kreisel.lab.questions import QUESTIONS, Answer, Clues, verdict
from kreisel.lab.subject import BESIDE, Subject, in_coordinates, on_group, subject
from kreisel.record.contract import System
from kreisel.record.model import Model
from kreisel.runs.operations import executed, own_systems
from kreisel.runs.settings import within

OF_A_FILE = ("names", "n", "frame", "eps", *BESIDE)


@dataclass(frozen=True)
class Finding:
    """A question, the answer and the evidence."""

    question: str
    answer: str
    evidence: str


@dataclass(frozen=True)
class Investigation:
    """Findings and verdict on a map.  `print` it, or `.save("page.html")`; in a notebook it shows itself."""

    name: str
    about: str
    verdict: str
    reason: str
    findings: tuple[Finding, ...]
    degrees: tuple[int, ...] = ()

    def __getitem__(self, question: str) -> Finding:
        return next(f for f in self.findings if f.question == question)

    def __str__(self) -> str:
        return self.table()

    def table(self, width: int = 110) -> str:
        """A table for the terminal."""
        from rich.console import Console
        from rich.table import Table

        grid = Table(box=None, pad_edge=False, show_header=False)
        for style in ("bold", "", "dim"):
            grid.add_column(style=style)
        for f in self.findings:
            grid.add_row(f.question, _literal(f.answer), _literal(f.evidence))
        console = Console(file=io.StringIO(), width=width, highlight=False, no_color=True)
        console.print(f"{_literal(self.name)}: {_literal(self.about)}\n")
        console.print(grid)
        console.print(f"\n[bold]{self.verdict}[/bold]: {_literal(self.reason)}")
        return str(console.file.getvalue()).rstrip()  # type: ignore[attr-defined]

    @property
    def html(self) -> str:
        """One page that needs nothing else: no script, nothing from elsewhere."""
        return (
            '<!doctype html><html lang="en"><head><meta charset="utf-8"><meta name="generator" content="Kreisel">'
            '<meta name="viewport" content="width=device-width, initial-scale=1">'
            "<meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; style-src 'unsafe-inline'\">"
            f"<title>{escape(self.name)}: {escape(self.verdict)}</title><style>{STYLE}</style></head><body>"
            f'{self._repr_html_()}{_degree_chart(self.degrees)}<p class="about">{RULE}</p></body></html>\n'
        )

    def _repr_html_(self) -> str:
        rows = "".join(
            f"<tr><th>{escape(f.question)}</th><td>{escape(f.answer)}</td><td>{escape(f.evidence)}</td></tr>"
            for f in self.findings
        )
        return (
            f'<h1>{escape(self.name)}</h1><p class="about">{escape(self.about)}</p>'
            f'<p class="verdict">{escape(self.verdict)}</p><p>{escape(self.reason)}</p><table>{rows}</table>'
        )

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the page; a page that Kreisel wrote is replaced.

        Raises `InputError` for other names, and if anything else has that name; `RunError` if the disk refuses.
        """
        with written(place_of_page(path)) as scratch:
            scratch.write_text(self.html, encoding="utf-8")


def _literal(text: str) -> str:
    return text.replace("[", r"\[")


RANGES = {"n": (1, 64), "degree": (0, 12), "iterates": (0, 40), "steps": (FEWEST, 10**9), "seed": (0, 2**63)}


@explained
def investigate(
    candidate: Model | System | str | Subject | Callable[..., Any],
    *,
    n: int | None = None,
    frame: str = "moving",
    eps: int | float | str | Fraction | None = None,
    names: tuple[str, ...] | None = None,
    degree: int | None = None,
    iterates: int | None = None,
    steps: int = 10_000,
    seed: int = 0,
    **options: Any,
) -> Investigation:
    """Look at a map from every side.

    candidate       a model with a map, `kr.Clebsch(b=(1, 2, 4))`; a system or its name, with parameters chosen here; a
               user-defined Lagrangian (`kreisel.reduction.system`, with its parameters); or a function:
               step(M, P) on e*(n) with n given, in the frame "moving" or "rest", or step(x) with the names of its
               coordinates
    eps        the step of the map, an integer or a fraction, by default 1/3; a function gets it if it names it
    degree     of the integrals that are sought, by default 4 or as far as the number of monomials allows
    iterates   whose degrees are computed;  steps  of the orbits for Lyapunov's exponents
    options    constants of a function, by keyword; `flow`, `involution`, `lax`, `conjugator`, of a step(x) also
               `tensor` and `start`: functions that need the state as the step does, see `kreisel.lab.subject`

    Raises `InputError` for anything but a map of rational functions.
    """
    for name, value in {"n": n, "degree": degree, "iterates": iterates, "steps": steps, "seed": seed}.items():
        if value is not None or name in ("steps", "seed"):
            within(value, name, *RANGES[name])
    x = _subject(candidate, n, frame, eps, names, options)
    clues = Clues(x, degree, iterates, steps, seed)
    findings = tuple(Finding(label, *_answered(question, clues)) for label, question in QUESTIONS.items())
    stated = x.constants if x.model is None or not x.model.params else {**x.model.params, "eps": x.constants["eps"]}
    listed = []
    for k, v in stated.items():
        exact = [fraction(x) for x in np.ravel(np.asarray(v, dtype=object))]
        texts = [str(q) if q.denominator < 10_000 else f"{float(q):g}" for q in exact]
        listed.append(f"{k} = {texts[0] if np.ndim(v) == 0 else '(' + ', '.join(texts) + ')'}")
    return Investigation(
        x.name,
        f"{x.dim} coordinates {', '.join(x.names)}{'; ' + ', '.join(listed) if listed else ''}",
        *verdict(clues),
        findings,
        clues.growth.degrees if clues.growth else (),
    )


def investigate_file(file: Path, /, **options: Any) -> Investigation:
    """Look at the definitions of a Python file: a function step, or a user-defined system or model; see the docs.

    Of a function `step` the file's own names, n, frame, eps, constants, tensor, lax, conjugator, involution, flow and
    start are taken.  The file is run.  Raises `InputError` where it defines nothing to look at.
    """
    if not file.is_file():
        raise InputError(f"No file {file}: expected a Python file with a function step, or the name of a system.")
    defined = executed(file)
    options = {k: v for k, v in options.items() if v is not None}
    if callable(defined.get("step")):
        settings = {k: defined[k] for k in OF_A_FILE if k in defined}
        constants = constants_of(defined.get("constants", {}), f"{file}: constants")
        return investigate(defined["step"], **{**settings, **constants, **options})
    models = [v for v in defined.values() if isinstance(v, Model)]
    candidates: list[Any] = models or list(own_systems(defined).values())
    if len(candidates) != 1:
        raise InputError(
            f"{file}: expected one thing to investigate at its top level, got {len(candidates)}. Write where the map "
            'lives and a function step, such as `names = ("x", "y")` and `def step(x): return x[1], 2 - x[0] - '
            "x[1] ** 2`; on e*(3) `n = 3` and `def step(M, P): ...`; or one user-defined model or system."
        )
    return investigate(candidates[0], **options)


def constants_of(constants: Any, place: str) -> Mapping[str, Any]:
    """Constants of a map by name, none of which is a setting.  Raises `InputError` with the place if they are."""
    reserved = {*inspect.signature(investigate).parameters, *BESIDE} - {"eps"}
    if not isinstance(constants, Mapping) or not all(isinstance(k, str) for k in constants):
        raise InputError(f"{place}: expected names and values, such as {{'a': 2}}, got {shown(constants)}.")
    if settings := reserved & constants.keys():
        raise InputError(
            f"{place}: expected parameters, got {', '.join(sorted(settings))}, which the investigation has as a "
            "setting: give it as that, --n or n=, or name the parameter otherwise."
        )
    return constants


def _answered(question: Callable[[Clues], Answer], clues: Clues) -> Answer:
    """The answer, "unknown" if its coefficients are too large; other questions may have one."""
    try:
        return question(clues)
    except TooLarge as error:
        return "unknown", str(error)


# -- the subject ------------------------------------------------------------------------------------


def _subject(
    candidate: Any, n: int | None, frame: str, eps: Any, names: tuple[str, ...] | None, options: dict[str, Any]
) -> Subject:
    candidate = find(candidate) if isinstance(candidate, str) else candidate
    if isinstance(candidate, System):
        candidate = typical(candidate, n or candidate.n or 3, options)
        options = {}
    if isinstance(candidate, Model | Subject):
        if options:
            raise InputError(f"A model has its parameters, got {', '.join(options)} besides.")
        return subject(candidate, eps=eps)
    if not callable(candidate):
        raise InputError(
            "A model, a system, its name, or a function step was expected, such as kr.lab.investigate('clebsch'), "
            f"got {shown(candidate)}."
        )
    if names:
        return in_coordinates(candidate, names, eps, options)
    if n is None:
        raise InputError("Say where the step lives: n=3 for step(M, P) on e*(3), or names=('x', 'y') for step(x).")
    return on_group(candidate, n, frame, eps, options)


def typical(system: System, n: int = 3, values: Mapping[str, Any] | None = None) -> Model:
    """A system with parameters that are small integers, but for those `values`."""
    if system.map is None:
        raise InputError(
            f"{system.name} has no map to investigate. Systems with one: see `kreisel systems`; or give a map of yours."
        )
    parameters: dict[str, Any] = {}
    for k, p in enumerate(system.parameters):
        if p.kind == "dimension":
            parameters[p.letter] = n
        elif p.kind == "array" or (p.default is not None and p.kind != "scalar"):
            parameters[p.letter] = p.default
        elif p.kind == "scalar":
            parameters[p.letter] = Fraction(k + 1, k + 2)  # two are not equal
        elif p.fixed:
            parameters[p.letter] = (0,) * (n - 1) + (1,)
        else:
            parameters[p.letter] = tuple(2**i if k == 0 else Fraction(i + 1, 8) for i in range(n))
    return system(**{**parameters, **(values or {})})


# -- the page, for the terminal and as one HTML file ---------------------------------------------------

STYLE = """
:root { color-scheme: light dark; --ink: #111; --paper: #fff; --line: #d8d8d8; --faint: #666; --accent: #0072B2; }
@media (prefers-color-scheme: dark) {
  :root { --ink: #f0f0f0; --paper: #16181d; --line: #3a3e46; --faint: #a5aab3; --accent: #56B4E9; } }
body { margin: 2rem auto; max-width: 62rem; padding: 0 1rem; font: 15px/1.5 system-ui, sans-serif;
  color: var(--ink); background: var(--paper); }
h1 { font-size: 1.3rem; margin: 0; }
.about, figcaption { color: var(--faint); font-size: .9rem; overflow-wrap: anywhere; }
.verdict { font-size: 1.15rem; font-weight: 600; margin: 1.2rem 0 0; }
table { border-collapse: collapse; width: 100%; margin: 1.2rem 0; }
th, td { text-align: left; vertical-align: top; padding: .35rem .8rem .35rem 0; border-top: 1px solid var(--line); }
th { white-space: nowrap; font-weight: 600; }
td:last-child { overflow-wrap: anywhere; font-size: .9rem; }
figure { margin: 0; }
svg { max-width: 26rem; height: auto; }
svg text { fill: var(--faint); font-size: 11px; }
"""
RULE = (
    "“Integrable” needs a Poisson bracket that the map preserves with its leaves and a complete set of integrals "
    "(Liouville, or superintegrable), or all integrals but one and a volume. “Periodic” is a map with an iterate "
    "that is the identity, “linear” one of degree 1. “Not integrable” needs exponential growth of degrees, or a "
    "chaotic orbit, which is a float experiment. Everything else is undecided. Exact statements are identities at "
    "random points modulo primes."
)


def _degree_chart(degrees: tuple[int, ...]) -> str:
    """The degrees against the iterate, both on logarithmic scales: a power is a straight line."""
    positive = [(k, d) for k, d in enumerate(degrees) if k and d > 0]
    if len(positive) < 3:
        return ""
    across, up = math.log(positive[-1][0]), max(math.log(max(d for _, d in positive)), 1e-9)

    def place(k: int, d: int) -> tuple[float, float]:
        return 50 + 330 * math.log(k) / across, 190 - 170 * math.log(d) / up

    points = [place(k, d) for k, d in positive]
    line = " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
    dots = "".join(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="3" fill="var(--accent)"/>' for x, y in points)
    (x0, _), (x1, y1) = points[0], points[-1]
    labels = (
        f'<text x="{x0:.0f}" y="206" text-anchor="middle">1</text>'
        f'<text x="{x1:.0f}" y="206" text-anchor="middle">{positive[-1][0]}</text>'
        f'<text x="{x1 + 6:.0f}" y="{y1 + 4:.0f}">{positive[-1][1]}</text>'
    )
    return (
        '<figure><svg viewBox="0 0 430 214" role="img" aria-label="Degrees of the iterates">'
        '<path d="M50 20V190H385" fill="none" stroke="var(--line)"/>'
        f'<polyline points="{line}" fill="none" stroke="var(--accent)" stroke-width="1.2"/>{dots}{labels}</svg>'
        "<figcaption>Degree against iterate, both logarithmic: a power of k is a straight line.</figcaption></figure>"
    )


def plain_data(investigation: Investigation) -> dict[str, Any]:
    """An investigation as plain data."""
    data = {**asdict(investigation), "degrees": list(investigation.degrees)}
    return {"map": data.pop("name"), **data, "findings": list(data.pop("findings"))}
