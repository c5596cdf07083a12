"""kr.lab.investigate: every instrument of the laboratory on one map, and what their evidence carries."""

from __future__ import annotations

import inspect
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from kreisel.errors import InputError, explained, shown
from kreisel.lab import report
from kreisel.lab.fields import fraction
from kreisel.lab.own_maps import BESIDE, in_coordinates, on_group
from kreisel.lab.questions import QUESTIONS, Clues, Finding
from kreisel.lab.subject import Subject, subject
from kreisel.lab.verdicts import verdict
from kreisel.record.contract import Parameter, System
from kreisel.record.model import Model
from kreisel.runs.config import executed, own_systems
from kreisel.runs.settings import within

OF_A_FILE = ("names", "n", "frame", "eps", *BESIDE)


@dataclass(frozen=True)
class Investigation:
    """What was found.  `print` it, or `.save("page.html")`; in a notebook it shows itself."""

    name: str
    about: str
    verdict: str
    reason: str
    findings: tuple[Finding, ...]
    degrees: tuple[int, ...] = ()

    def __getitem__(self, question: str) -> Finding:
        return next(f for f in self.findings if f.question == question)

    def __str__(self) -> str:
        return report.terminal_table(self)

    @property
    def html(self) -> str:
        """One page that needs nothing else."""
        return report.report_page(self)

    def _repr_html_(self) -> str:
        return report.table_html(self)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the page."""
        report.save(self, path)


RANGES = {"n": (1, 64), "degree": (0, 12), "iterates": (0, 40), "steps": (1, 10**9), "seed": (0, 2**63)}


@explained
def investigate(
    what: Model | System | str | Subject | Callable[..., Any],
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

    what       a model with a map, `kr.Clebsch(b=(1, 2, 4))`; a system or its name, with parameters chosen here; a
               Lagrangian of your own (`kreisel.reduction.system`, with its parameters); or a function:
               step(M, P) on e*(n) with n given, in the frame "moving" or "rest", or step(x) with the names of its
               coordinates
    eps        the step of the map, a whole number or a fraction, by default 1/3; a function takes it if it names it
    degree     of the integrals that are sought, by default 4 or as far as the number of monomials allows
    iterates   whose degrees are computed;  steps  of the orbits for Lyapunov's exponents
    options    constants of a function, by keyword; `flow`, `involution`, `lax`, `conjugator`, of a step(x) also
               `tensor` and `start`: functions that take the state as the step does, see `kreisel.lab.own_maps`

    Raises `InputError` for what is no map, or not one of rational functions.
    """
    for name, value in {"n": n, "degree": degree, "iterates": iterates, "steps": steps, "seed": seed}.items():
        if value is not None or name in ("steps", "seed"):
            within(value, name, *RANGES[name])
    x = _subject(what, n, frame, eps, names, options)
    clues = Clues(x, degree, iterates, steps, seed)
    findings = tuple(question(clues) for question in QUESTIONS)
    stated = x.constants if x.model is None or not x.model.params else {**x.model.params, "eps": x.constants["eps"]}
    shown = ", ".join(f"{k} = {_plain_text(v)}" for k, v in stated.items())
    return Investigation(
        x.name,
        f"{x.dim} coordinates {', '.join(x.names)}{'; ' + shown if shown else ''}",
        *verdict(clues),
        findings,
        clues.growth.degrees if clues.growth else (),
    )


def _plain_text(v: Any) -> str:
    array = np.vectorize(_rational_text, otypes=[object])(v)
    return str(array[()]) if np.ndim(v) == 0 else "(" + ", ".join(map(str, np.ravel(array))) + ")"


def _rational_text(v: Any) -> str:
    q = fraction(v)
    return str(q) if q.denominator < 10_000 else f"{float(q):g}"


def investigate_file(file: Path, /, **options: Any) -> Investigation:
    """Look at what a Python file defines: a function step, or a system or model of your own; see the docs.

    Of a function `step` the file's own names, n, frame, eps, constants, tensor, lax, conjugator, involution, flow and
    start are taken.  The file is run.  Raises `InputError` where it defines nothing to look at.
    """
    if not file.is_file():
        raise InputError(f"There is no file {file}.")
    defined = executed(file)
    options = {k: v for k, v in options.items() if v is not None}
    if callable(defined.get("step")):
        own = {k: defined[k] for k in OF_A_FILE if k in defined}
        constants = constants_of(defined.get("constants", {}), f"{file}: constants")
        return investigate(defined["step"], **{**own, **constants, **options})
    models = [v for v in defined.values() if isinstance(v, Model)]
    found: list[Any] = models or list(own_systems(defined).values())
    if len(found) != 1:
        raise InputError(
            f"{file}: expected one thing to investigate at its top level, got {len(found)}. Write where the map lives "
            'and a function step, such as the two lines `names = ("x", "y")` and `def step(x): return x[1], 2 - x[0] - '
            "x[1] ** 2`; on e*(3) `n = 3` and `def step(M, P): ...`; or one model or system of your own."
        )
    return investigate(found[0], **options)


def constants_of(constants: Any, place: str) -> Mapping[str, Any]:
    """Constants of a map by name, none of which is a setting.  Raises `InputError` with the place where they are."""
    reserved = {*inspect.signature(investigate).parameters, *BESIDE} - {"eps"}
    if not isinstance(constants, Mapping) or not all(isinstance(k, str) for k in constants):
        raise InputError(f"{place}: expected names and values, such as {{'a': 2}}, got {shown(constants)}.")
    if both := reserved & constants.keys():
        raise InputError(
            f"{place}: expected parameters, got {', '.join(sorted(both))}, which the investigation has as a setting: "
            "give it as that, --n or n=, or name the parameter otherwise."
        )
    return constants


# -- what is looked at ------------------------------------------------------------------------------


def _subject(
    what: Any, n: int | None, frame: str, eps: Any, names: tuple[str, ...] | None, options: dict[str, Any]
) -> Subject:
    if isinstance(what, str):
        from kreisel.system import find

        what = find(what)
    if isinstance(what, System):
        what = typical(what, n or what.n or 3, options)
        options = {}
    if isinstance(what, Model | Subject):
        if options:
            raise InputError(f"A model has its parameters, got {', '.join(options)} besides.")
        return subject(what, eps=eps)
    if not callable(what):
        raise InputError(
            "A model, a system, its name, or a function step was expected, such as kr.lab.investigate('clebsch'), "
            f"got {shown(what)}."
        )
    if names:
        return in_coordinates(what, names, eps, options)
    if n is None:
        raise InputError("Say where the step lives: n=3 for step(M, P) on e*(3), or names=('x', 'y') for step(x).")
    return on_group(what, n, frame, eps, options)


def typical(system: System, n: int = 3, given: Mapping[str, Any] | None = None) -> Model:
    """A system with parameters that are small whole numbers, but for those `given`."""
    if system.map is None:
        raise InputError(
            f"{system.name} has no map to investigate. Systems with one: see `kreisel systems`; or give a map of yours."
        )
    given = dict(given or {})
    known = {p.letter: given.pop(p.letter, _typical(p, n, i)) for i, p in enumerate(system.parameters)}
    return system(**known, **given)


def _typical(p: Parameter, n: int, place: int) -> Any:
    if p.kind == "dimension":
        return n
    if p.kind == "array" or (p.default is not None and p.kind != "scalar"):
        return p.default
    if p.kind == "scalar":
        return Fraction(place + 1, place + 2)  # two are not equal
    if p.fixed:
        return (0,) * (n - 1) + (1,)
    return tuple(2**i if place == 0 else Fraction(i + 1, 8) for i in range(n))


__all__ = ["Finding", "Investigation", "investigate", "investigate_file", "typical"]


def registry_table() -> str:
    """Every map of the registry, n = 3, and the negative controls, as a page of the documentation."""
    from kreisel.lab.controls import controls
    from kreisel.system import REGISTRY

    asked: list[tuple[str, Any, dict[str, Any]]] = [
        (f"`{name}`", name, {}) for name, system in REGISTRY.items() if system.map is not None
    ]
    asked += controls()
    return report.HEAD + report.markdown([(shown, investigate(what, **options)) for shown, what, options in asked])
